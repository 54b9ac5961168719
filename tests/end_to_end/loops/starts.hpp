// SPDX-License-Identifier: Apache-2.0
/// @file Starts in a loaded map: up to 0.5 m and 30 degrees off the path that made it.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "tests/end_to_end/loops/jobs.hpp"
#include "tests/end_to_end/loops/scenes.hpp"

namespace loop_cases {

constexpr pair_of_cameras start_pair{640, 480};
constexpr double step_m = 0.08;
constexpr int mapped_frames = 100;

inline ft::odometry_params start_params() {
  ft::odometry_params p;
  p.orb.width = start_pair.width;
  p.orb.height = start_pair.height;
  p.orb.features = 1000;
  p.loops.present = true;
  return p;
}

inline ft::vec3<double> any_direction(std::mt19937& random, double length) {
  std::normal_distribution<double> normal;
  ft::vec3<double> const v{normal(random), normal(random), normal(random)};
  double const by = length / std::sqrt(ft::dot(v, v));
  return {by * v.x, by * v.y, by * v.z};
}

/// Three frames, moving on by 2 cm each.
inline std::vector<motion> start_places(unsigned seed) {
  std::mt19937 random(seed + 1);
  auto const any = [&] { return std::uniform_real_distribution<double>(0, 1)(random); };
  double const x = (0.05 + 0.9 * any()) * step_m * mapped_frames;
  auto const off = any_direction(random, 0.5 * any());
  auto const turn = any_direction(random, 0.5235987756 * any());
  auto const way = any_direction(random, 0.02);
  std::vector<motion> places;
  for (int i = 0; i < 3; ++i) {
    places.push_back(camera_at(x + off.x + i * way.x, off.y + i * way.y, off.z + i * way.z, turn));
  }
  return places;
}

struct start_result {
  bool found = false;  ///< within three frames
  double off_m = 0, off_rad = 0;
};

template <typename Odometry>
ft::tracking track_at(Odometry& odometry, wall const& scene, motion const& T, int n) {
  auto const f = scene.see(start_pair, T, static_cast<unsigned>(n));
  return odometry.track({start_pair.view(f.left), start_pair.view(f.right)}, n * period_ns);
}

template <typename Odometry>
start_result start(Odometry& odometry, wall const& scene, std::string const& map, unsigned seed) {
  std::istringstream file(map);
  odometry.load_map(file);
  start_result r;
  ft::tracking told;
  auto const places = start_places(seed);
  int n = 1000;
  for (motion const& T : places) { told = track_at(odometry, scene, T, n++); }
  auto const all = odometry.placed_keyframes();
  r.found = told.state == ft::tracking_state::tracking && !all.empty() && all.back().map == 1;
  auto const off = places.back().inverse() * told.T_world_camera;
  double const cosine = (off.R.m[0] + off.R.m[4] + off.R.m[8] - 1) / 2;
  r.off_m = std::sqrt(ft::dot(off.t, off.t));
  r.off_rad = std::acos(std::clamp(cosine, -1.0, 1.0));
  return r;
}

/// Prints a row. @return starts that were not found in three frames, or elsewhere
template <typename MakeExec>
int run_starts(int count, int jobs, MakeExec const& make_exec) {
  wall const scene{7};
  std::string map;
  make_exec([&](auto const& exec) {
    ft::odometry odometry(exec, start_pair.rig(), start_params(), 1, ft::loops{});
    for (int i = 0; i < mapped_frames; ++i) {
      track_at(odometry, scene, camera_at(step_m * i, 0, 0, {}), i + 1);
    }
    std::stringstream file;
    odometry.save_map(file);
    map = file.str();
  });
  std::vector<start_result> results(static_cast<std::size_t>(count));
  in_parallel(count, jobs, make_exec, [&](auto const& exec, int i) {
    ft::odometry odometry(exec, start_pair.rig(), start_params(), 1, ft::loops{});
    results[static_cast<std::size_t>(i)] = start(odometry, scene, map, static_cast<unsigned>(i));
  });
  int found = 0, exact = 0, wrong = 0;
  std::vector<double> off;
  for (std::size_t i = 0; i < results.size(); ++i) {
    start_result const& r = results[i];
    bool const good = r.found && r.off_m <= 0.02 && r.off_rad <= 0.0174533;
    found += static_cast<int>(r.found);
    exact += static_cast<int>(good);
    wrong += static_cast<int>(r.found && (r.off_m > 0.2 || r.off_rad > 0.1));
    if (r.found) { off.push_back(r.off_m); }
    if (!good) {
      std::fprintf(stderr, "start %zu: %s, off by %.1f mm, %.2f degrees\n", i,
                   r.found ? "found" : "not found", 1e3 * r.off_m, 57.29578 * r.off_rad);
    }
  }
  std::sort(off.begin(), off.end());
  std::printf(
      "{\"starts\": %d, \"found_in_3\": %d, \"within_2cm_1deg\": %d, \"wrong\": %d, "
      "\"median_mm\": %.2f}\n",
      count, found, exact, wrong, off.empty() ? 0.0 : 1e3 * off[off.size() / 2]);
  return count - found + wrong;
}

}  // namespace loop_cases
