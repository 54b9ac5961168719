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
#include "tests/end_to_end/loops/trials.hpp"

namespace loop_cases {

constexpr pair_of_cameras start_pair{640, 480};
constexpr double step_m = 0.08;
constexpr int mapped_frames = 100;

/// @param localize_only the map stays as it is
inline ft::odometry_params start_params(bool localize_only = false) {
  ft::odometry_params p;
  p.rules.localize_only = localize_only;
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

/// How far a pose is from another one.
struct difference {
  double m = 0, rad = 0;

  difference() = default;
  explicit difference(motion const& T) {
    double const cosine = (T.R.m[0] + T.R.m[4] + T.R.m[8] - 1) / 2;
    m = std::sqrt(ft::dot(T.t, T.t));
    rad = std::acos(std::clamp(cosine, -1.0, 1.0));
  }
  bool is_small() const { return m <= 0.02 && rad <= 0.0174533; }
};

struct start_result {
  bool found = false;  ///< within three frames
  difference off;      ///< from the truth: the drift of the mapped path is in it
  difference in_map;   ///< seen from the nearest mapped keyframe
};

/// Frame n of those that made the map.
inline motion mapped_place(int n) { return camera_at(step_m * n, 0, 0, {}); }

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
  motion const& truth = places.back();
  r.off = difference(truth.inverse() * told.T_world_camera);
  double nearest = 1e9;
  for (ft::placed_keyframe const& k : all) {
    int const frame = static_cast<int>(k.time_ns / period_ns) - 1;
    if (frame >= mapped_frames) { continue; }
    motion const seen_from = mapped_place(frame).inverse() * truth;
    if (difference(seen_from).m > nearest) { continue; }
    nearest = difference(seen_from).m;
    r.in_map = difference(seen_from.inverse() * (k.T_world_camera.inverse() * told.T_world_camera));
  }
  return r;
}

/// Prints a row. @return starts that were not found in three frames, or elsewhere
template <typename MakeExec>
int run_starts(int count, int jobs, MakeExec const& make_exec, bool localize_only,
               unsigned first_seed = 0) {
  wall const scene{7};
  std::string map;
  make_exec([&](auto const& exec) {
    ft::odometry odometry(exec, start_pair.rig(), start_params(), 1, ft::loops{});
    for (int i = 0; i < mapped_frames; ++i) { track_at(odometry, scene, mapped_place(i), i + 1); }
    std::stringstream file;
    odometry.save_map(file);
    map = file.str();
  });
  std::vector<start_result> results(static_cast<std::size_t>(count));
  in_parallel(count, jobs, make_exec, [&](auto const& exec, int i) {
    ft::odometry odometry(exec, start_pair.rig(), start_params(localize_only), 1, ft::loops{});
    results[static_cast<std::size_t>(i)] =
        start(odometry, scene, map, first_seed + static_cast<unsigned>(i));
  });
  int found = 0, exact = 0, exact_in_map = 0, wrong = 0;
  std::vector<double> off, in_map;
  for (std::size_t i = 0; i < results.size(); ++i) {
    start_result const& r = results[i];
    found += static_cast<int>(r.found);
    exact += static_cast<int>(r.found && r.off.is_small());
    exact_in_map += static_cast<int>(r.found && r.in_map.is_small());
    wrong += static_cast<int>(r.found && (r.off.m > 0.2 || r.off.rad > 0.1));
    if (r.found) {
      off.push_back(r.off.m);
      in_map.push_back(r.in_map.m);
    }
    if (!r.found || !r.off.is_small()) {
      std::fprintf(stderr, "start %zu: %s, off by %.1f mm, %.2f degrees, in the map %.1f, %.2f\n",
                   i, r.found ? "found" : "not found", 1e3 * r.off.m, 57.29578 * r.off.rad,
                   1e3 * r.in_map.m, 57.29578 * r.in_map.rad);
    }
  }
  auto const median_mm = [](std::vector<double>& v) {
    std::sort(v.begin(), v.end());
    return v.empty() ? 0.0 : 1e3 * v[v.size() / 2];
  };
  std::printf(
      "{\"starts\": %d, \"found_in_3\": %d, \"within_2cm_1deg\": %d, \"within_in_map\": %d, "
      "\"wrong\": %d, \"median_mm\": %.2f, \"median_in_map_mm\": %.2f}\n",
      count, found, exact, exact_in_map, wrong, median_mm(off), median_mm(in_map));
  return count - found + wrong;
}

/// Starts in one of two stretches that are the same, after both were mapped: which one it is cannot
/// be told. Prints a row. @return starts at the wrong one
template <typename MakeExec>
int run_alike_starts(int count, int jobs, MakeExec const& make_exec, bool localize_only,
                     unsigned first_seed = 0) {
  std::vector<start_result> results(static_cast<std::size_t>(count));
  in_parallel(count, jobs, make_exec, [&](auto const& exec, int i) {
    unsigned const seed = first_seed + static_cast<unsigned>(i);
    trial const t = make_trial(trial_kind::lost_alike, seed);
    ft::odometry_params p = small_map(512);
    std::stringstream file;
    {
      ft::odometry maps(exec, small_pair.rig(), p, 1, ft::loops{});
      for (int n = 0; n < t.black_from; ++n) {
        auto const f = t.scene.see(small_pair, t.places[static_cast<std::size_t>(n)],
                                   t.scene.seed + static_cast<unsigned>(n));
        maps.track({small_pair.view(f.left), small_pair.view(f.right)}, (n + 1) * period_ns);
      }
      maps.save_map(file);
    }
    p.rules.localize_only = localize_only;
    ft::odometry odometry(exec, small_pair.rig(), p, 1, ft::loops{});
    odometry.load_map(file);
    motion const first = t.places[0];
    for (std::size_t n = static_cast<std::size_t>(t.black_to); n < t.places.size(); ++n) {
      auto const f = t.scene.see(small_pair, t.places[n], t.scene.seed + static_cast<unsigned>(n));
      ft::tracking const told = odometry.track({small_pair.view(f.left), small_pair.view(f.right)},
                                               static_cast<int>(n + 1) * period_ns);
      if (told.state != ft::tracking_state::tracking || told.map_id != 1) { continue; }
      start_result& r = results[static_cast<std::size_t>(i)];
      difference const off((first.inverse() * t.places[n]).inverse() * told.T_world_camera);
      r.found = true;
      if (off.m > r.off.m) { r.off = off; }
    }
  });
  int found = 0, wrong = 0;
  for (std::size_t i = 0; i < results.size(); ++i) {
    start_result const& r = results[i];
    found += static_cast<int>(r.found);
    wrong += static_cast<int>(r.found && r.off.m > 1);  // its twin is 8 m away, and more
    if (r.found) { std::fprintf(stderr, "alike %zu: found, off by %.2f m\n", i, r.off.m); }
  }
  std::printf("{\"alike_starts\": %d, \"found\": %d, \"wrong\": %d}\n", count, found, wrong);
  return wrong;
}

}  // namespace loop_cases
