// SPDX-License-Identifier: Apache-2.0
/// @file Times of frames beside maps of 100 and of many keyframes, which are made up.
#pragma once

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <random>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "tests/end_to_end/loops/scenes.hpp"
#include "tests/end_to_end/loops/trials.hpp"

namespace loop_cases {

/// A saved map with keyframes of another place before its own, with descriptors by chance: in one
/// chain, 0.1 m from each to the next.
template <typename Exec>
std::string enlarge(Exec const& exec, ft::odometry<Exec> const& odometry, int keyframes) {
  auto const own = loops_of(odometry);
  ft::loop_params const& p = odometry.params().loops;
  ft::host_exec const host(1);
  ft::owner<ft::loop_archive_view, ft::memory_space::host> archive(
      [&](ft::carver& c, ft::loop_archive_view& v) { carve(c, v, p.keyframes, p.points); });
  ft::loop_archive_view const& a = archive.view();
  ft::loop_archive_view const& b = own.archive.view();
  ft::detail::loop_path path;
  std::mt19937 random(5);
  int const n_own = static_cast<int>(own.keyframes.size());
  for (int i = 0; i < keyframes; ++i) {
    bool const made_up = i < keyframes - n_own;
    ft::detail::path_keyframe k;
    if (!made_up) { k = own.keyframes[static_cast<std::size_t>(i - keyframes + n_own)]; }
    int const from = k.row;
    k.row = i;
    a.count[i] = made_up ? p.points : b.count[from];
    for (int q = 0; q < a.count[i]; ++q) {
      auto const to = a.at(i) + q;
      auto const like = made_up ? b.at(0) + q % b.count[0] : b.at(from) + q;
      a.point[to] = b.point[like];
      a.x[to] = b.x[like];
      a.y[to] = b.y[like];
      a.right_x[to] = b.right_x[like];
      a.inv_sigma2[to] = b.inv_sigma2[like];
      a.camera[to] = 0;
      a.orb[to] = b.orb[like];
      if (!made_up) { continue; }
      for (auto& word : a.orb[to].words) { word = static_cast<std::uint32_t>(random()); }
    }
    if (made_up) {
      k.map = k.part = 0;
      k.time_ns = 1 + i;
      k.step = i == 0 ? 0 : 0.1;
      k.T_odom_camera = camera_at(0.1 * i, 0, -1000, {});
      k.T_world_camera = ft::detail::with_scale(k.T_odom_camera);
      std::copy(own.keyframes.back().information, own.keyframes.back().information + 21,
                k.information);
    } else {
      k.map = k.part = 1;
    }
    path.keyframes.push_back(k);
  }
  std::stringstream file;
  odometry.save_map(file);
  std::string bytes = file.str();
  bytes.resize(bytes.rfind("ft loop archive"));
  std::ostringstream loops;
  ft::detail::loop_writer(host, a, path)(loops);
  exec.wait();
  return bytes + loops.str();
}

/// Prints a row. A frame begins `ms` milliseconds after the one before.
/// @param keyframes of the map at the start; 0: without loops
template <typename Exec>
void run_flat(Exec const& exec, int keyframes, int frames, int ms) {
  wall const scene{3};
  constexpr int half = 60;
  auto const place = [](int i) {
    return camera_at(2.5 * (1 - std::cos(3.14159265 * i / half)), 0, 0, {});
  };
  std::vector<wall::frame> seen;
  for (int i = 0; i <= half; ++i) {
    seen.push_back(scene.see(small_pair, place(i), static_cast<unsigned>(i)));
  }
  auto odometry = [&] {
    auto const p = small_map(keyframes == 0 ? 0 : keyframes + 1000);
    if (keyframes == 0) { return ft::odometry<Exec>(exec, small_pair.rig(), p); }
    return ft::odometry<Exec>(exec, small_pair.rig(), p, 1, ft::loops{});
  }();
  int n = 0;
  auto const track = [&] {
    int const i = n % (2 * half);
    auto const& f = seen[static_cast<std::size_t>(std::min(i, 2 * half - i))];
    return odometry.track({small_pair.view(f.left), small_pair.view(f.right)}, ++n * period_ns);
  };
  for (int i = 0; i < half; ++i) { track(); }
  if (keyframes > 0) {
    std::istringstream file(enlarge(exec, odometry, keyframes));
    odometry.load_map(file);
  }
  int loops = 0, tracked = 0;
  std::vector<double> all, closing;
  for (int k = 0; k < frames; ++k) {
    auto const begin = std::chrono::steady_clock::now();
    auto const told = track();
    std::chrono::duration<double, std::micro> const took = std::chrono::steady_clock::now() - begin;
    std::this_thread::sleep_until(begin + std::chrono::milliseconds(ms));
    tracked += static_cast<int>(told.state == ft::tracking_state::tracking);
    loops += told.loops_closed;
    if (k < 20) { continue; }
    all.push_back(took.count());
    if (told.loops_closed > 0) { closing.push_back(took.count()); }
  }
  std::sort(all.begin(), all.end());
  std::sort(closing.begin(), closing.end());
  auto const part = [](std::vector<double> const& v, std::size_t percent) {
    return v.empty() ? 0.0 : v[(v.size() - 1) * percent / 100];
  };
  std::printf(
      "{\"keyframes\": %d, \"ms_apart\": %d, \"frames\": %d, \"tracked\": %d, \"loops\": %d, "
      "\"p50_us\": %.0f, \"p99_us\": %.0f, \"max_us\": %.0f, \"closing_frames\": %zu, "
      "\"closing_p50_us\": %.0f, \"closing_max_us\": %.0f, \"device_mb\": %.1f}\n",
      keyframes, ms, frames, tracked, loops, part(all, 50), part(all, 99), part(all, 100),
      closing.size(), part(closing, 50), part(closing, 100),
      1e-6 * static_cast<double>(odometry.memory_bytes().executor));
  std::fflush(stdout);
}

}  // namespace loop_cases
