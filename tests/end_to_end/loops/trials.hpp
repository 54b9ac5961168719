// SPDX-License-Identifier: Apache-2.0
/// @file Walls that invite wrong loops: how many are closed, and how many true revisits are found.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "ft/pipelines/detail/loop_files.hpp"
#include "tests/end_to_end/loops/jobs.hpp"
#include "tests/end_to_end/loops/scenes.hpp"

namespace loop_cases {

enum class trial_kind {
  facade,       ///< that repeats: to and fro
  rooms_alike,  ///< a stretch and its twin 8 to 11 m away: to and fro
  lost,         ///< a wall that does not repeat: to, black images, then somewhere in what was seen
  lost_alike  ///< past a stretch and its twin, black images, then in one of them: which one cannot
              ///< be told
};
constexpr char const* name_of[] = {"facade that repeats", "rooms alike", "lost and found",
                                   "lost, not to be told apart"};

struct trial {
  wall scene;
  std::vector<motion> places;
  int black_from = 0, black_to = 0;  ///< images
  int revisit_from = 0;              ///< first image of what was seen before
};

inline trial make_trial(trial_kind kind, unsigned seed) {
  std::mt19937 random(1000 * static_cast<unsigned>(kind) + seed);
  auto const any = [&](double from, double to) {
    return std::uniform_real_distribution<double>(from, to)(random);
  };
  trial t;
  t.scene.seed = static_cast<unsigned>(random());
  double begin = 0, end = 8;
  if (kind == trial_kind::facade) { t.scene.repeats = any(1.5, 4); }
  if (kind == trial_kind::rooms_alike || kind == trial_kind::lost_alike) {
    t.scene.alike_after = any(8, 11);
    t.scene.alike_begin = -4;
    t.scene.alike_end = 4;
    end = t.scene.alike_after + 1;
  }
  if (kind == trial_kind::lost_alike) {
    begin = -1.5;
    end = t.scene.alike_after + 9;
  }
  double const step = any(0.08, 0.12);
  int const there = static_cast<int>((end - begin) / step);
  for (int i = 0; i < there; ++i) { t.places.push_back(camera_at(begin + step * i, 0, 0, {})); }
  // What is seen again is seen from elsewhere.
  double const z = any(-0.3, 0.3), yaw = any(-0.1, 0.1);
  if (kind == trial_kind::facade || kind == trial_kind::rooms_alike) {
    for (int i = 0; i < there; ++i) {
      double const share = std::min(1.0, i / 15.0);
      t.places.push_back(camera_at(step * (there - 1 - i), 0, share * z, {0, share * yaw, 0}));
    }
    t.revisit_from = there + there / 2;
    return t;
  }
  t.black_from = there;
  t.revisit_from = t.black_to = there + 8;
  for (int i = there; i < t.black_to; ++i) { t.places.push_back(t.places.back()); }
  bool const alike = kind == trial_kind::lost_alike;
  double const twin = alike && random() % 2 == 0 ? t.scene.alike_after : 0;
  double const first = alike ? twin - 1.2 : any(0, 4);
  for (int i = 0; i < (alike ? 20 : 40); ++i) {
    t.places.push_back(camera_at(first + step * i, 0, z, {0, yaw, 0}));
  }
  return t;
}

struct trial_result {
  int loops = 0, wrong = 0;
  int revisits = 0;          ///< loops to images of a revisit that are right
  int lost = 0;              ///< images that are not black and were not tracked
  std::uint64_t digest = 0;  ///< of its loops
};

/// The loops of an odometry, as its file tells them.
template <typename Odometry>
ft::detail::saved_loops<ft::memory_space::host> loops_of(Odometry const& odometry) {
  std::stringstream file;
  odometry.save_map(file);
  std::string const bytes = file.str();
  auto const at = bytes.rfind("ft loop archive");
  std::istringstream from(bytes.substr(at));
  ft::loop_params const& p = odometry.params().loops;
  // Rows beyond the limit, for keyframes during a search.
  int const most = 2 * p.keyframes + 128;
  ft::owner<ft::loop_archive_view, ft::memory_space::host> like(
      [&](ft::carver& c, ft::loop_archive_view& v) { carve(c, v, most, p.points); });
  return ft::detail::read_loops<ft::host_exec>(like.view(), {most, 1 << 20, 1, false}, from);
}

template <typename Exec>
trial_result run_trial(Exec const& exec, trial const& t) {
  ft::odometry<Exec> odometry(exec, small_pair.rig(), small_map(512), 1, ft::loops{});
  trial_result r;
  wall::frame const black{image(small_pair.pixels()), image(small_pair.pixels())};
  for (std::size_t i = 0; i < t.places.size(); ++i) {
    int const n = static_cast<int>(i);
    bool const dark = n >= t.black_from && n < t.black_to;
    auto const f =
        dark ? black
             : t.scene.see(small_pair, t.places[i], t.scene.seed + static_cast<unsigned>(n));
    auto const told =
        odometry.track({small_pair.view(f.left), small_pair.view(f.right)}, (n + 1) * period_ns);
    r.lost += static_cast<int>(!dark && told.state != ft::tracking_state::tracking);
  }
  auto const saved = loops_of(odometry);
  auto const image_of = [&](int k) {
    return static_cast<std::size_t>(
        saved.keyframes[static_cast<std::size_t>(k)].time_ns / period_ns - 1);
  };
  soak_scene::digest digest;
  for (auto const& l : saved.loops) {
    digest.add(&l.T_from_to, 1);
    auto const from = t.places[image_of(l.from)], to = t.places[image_of(l.to)];
    auto const off = (from.inverse() * to).t - l.T_from_to.t;
    bool const wrong = std::sqrt(ft::dot(off, off)) > 0.2;
    if (wrong) {
      auto const apart = (from.inverse() * to).t;
      std::fprintf(stderr, "  image %zu to %zu, %.2f m apart: off by %.2f m\n", image_of(l.from),
                   image_of(l.to), std::sqrt(ft::dot(apart, apart)), std::sqrt(ft::dot(off, off)));
    }
    ++r.loops;
    r.wrong += static_cast<int>(wrong);
    r.revisits += static_cast<int>(!wrong && static_cast<int>(image_of(l.to)) >= t.revisit_from);
  }
  r.digest = digest.value();
  return r;
}

/// Prints a row of each kind. @param count trials in all @param only this kind, or -1 @param seed
/// of the first one
/// @return what is not as wanted: wrong loops, and kinds whose revisits are missed or that lose
/// more than ten images a trial
template <typename MakeExec>
int run_trials(int count, int jobs, MakeExec const& make_exec, int only = -1, unsigned seed = 0) {
  int all_faults = 0;
  for (int kind = 0; kind < 4; ++kind) {
    if (only >= 0 && only != kind) { continue; }
    int const n = count / 3 / (kind < 2 ? 1 : 2);
    std::vector<trial_result> results(static_cast<std::size_t>(n));
    in_parallel(n, jobs, make_exec, [&](auto const& exec, int i) {
      results[static_cast<std::size_t>(i)] = run_trial(
          exec, make_trial(static_cast<trial_kind>(kind), seed + static_cast<unsigned>(i)));
    });
    soak_scene::digest digest;
    int loops = 0, wrong = 0, with_wrong = 0, found = 0, lost = 0;
    for (int i = 0; i < n; ++i) {
      trial_result const& r = results[static_cast<std::size_t>(i)];
      digest.add(&r.digest, 1);
      loops += r.loops;
      wrong += r.wrong;
      with_wrong += static_cast<int>(r.wrong > 0);
      found += static_cast<int>(r.revisits > 0);
      lost += r.lost;
      if (r.wrong > 0 || r.revisits == 0) {
        std::fprintf(stderr, "%s %u: %d loops, %d wrong, %d of the revisit, %d lost\n",
                     name_of[kind], seed + static_cast<unsigned>(i), r.loops, r.wrong, r.revisits,
                     r.lost);
      }
    }
    std::printf(
        "{\"what\": \"%s\", \"trials\": %d, \"loops\": %d, \"wrong_loops\": %d, "
        "\"trials_with_wrong\": %d, \"revisits_found\": %d, \"frames_lost\": %d, "
        "\"digest\": \"%016llx\"}\n",
        name_of[kind], n, loops, wrong, with_wrong, found, lost,
        static_cast<unsigned long long>(digest.value()));
    std::fflush(stdout);
    all_faults += wrong;
    bool const can_be_found = kind != static_cast<int>(trial_kind::lost_alike);
    if (can_be_found && n > 0 && found == 0) {
      std::fprintf(stderr, "%s: no revisit was found\n", name_of[kind]);
      ++all_faults;
    }
    if (lost > 10 * n) {  // the shortest revisit is twice as long
      std::fprintf(stderr, "%s: %d images lost in %d trials\n", name_of[kind], lost, n);
      ++all_faults;
    }
  }
  return all_faults;
}

}  // namespace loop_cases
