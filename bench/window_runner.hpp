// SPDX-License-Identifier: Apache-2.0
/// @file The window runner, instantiated once per executor: bundle adjustments of a batch.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory>
#include <vector>

#include "bench/camera_runner.hpp"
#include "bench/clock.hpp"
#include "bench/owned_executor.hpp"
#include "bench/runner.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/window_problem.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/recording.hpp"
#include "ft/kernels/window/adjust_window.hpp"

namespace bench {
inline namespace FT_ABI {

/// A rectified pair that moves sideways in front of points, each seen by 2 to 8 views in a row,
/// with noise of a pixel. Adjusted again and again from the same start.
template <typename Exec>
class window_runner_of final : public window_runner {
public:
  explicit window_runner_of(window_case const& what)
      : owned_(what.host_threads),
        what_(what),
        here_([&](ft::carver& c) { ft::carve(c, host_, capacity(), what_.batch); }),
        there_([&](ft::carver& c) {
          ft::carve(c, start_, capacity(), what_.batch);
          ft::carve(c, problem_, capacity(), what_.batch);
          ft::carve(c, work_, problem_, what_.views - what_.fixed);
        }) {
    params_.steps = what.steps;
    params_.enough = 0;
    for (int b = 0; b < what_.batch; ++b) { draw(b); }
    copy(start_, host_);
    copy(problem_, host_);
    owned_.exec.wait();
    graph_.record(owned_.exec, [&](auto const& exec) { queue(exec); });
  }

  double run() override {
    reset();
    time_.begin(owned_.exec);
    graph_.replay(owned_.exec, [&](auto const& exec) { queue(exec); });
    return time_.end(owned_.exec);
  }
  double gained() override {
    std::vector<ft::window_outcome> outcome(static_cast<std::size_t>(what_.batch));
    ft::copy(owned_.exec, outcome.data(), static_cast<ft::window_outcome const*>(problem_.outcome),
             outcome.size());
    owned_.exec.wait();
    double least = 1;
    for (auto const& o : outcome) {
      least = std::min(least, o.valid == 1 ? 1 - o.last_cost / o.first_cost : 0.0);
    }
    return least;
  }

private:
  ft::window_capacity capacity() const { return {what_.views, what_.points, 1}; }
  std::size_t count(int each) const {
    return static_cast<std::size_t>(what_.batch) * static_cast<std::size_t>(each);
  }
  void reset() {
    ft::copy(owned_.exec, problem_.T_cw, static_cast<ft::rigid<double> const*>(start_.T_cw),
             count(what_.views));
    ft::copy(owned_.exec, problem_.position, static_cast<ft::vec3<double> const*>(start_.position),
             count(what_.points));
  }
  void copy(ft::window_problem_view const& to, ft::window_problem_view const& from) {
    auto const& exec = owned_.exec;
    ft::copy(exec, to.view_count, static_cast<int const*>(from.view_count), count(1));
    ft::copy(exec, to.fixed_count, static_cast<int const*>(from.fixed_count), count(1));
    ft::copy(exec, to.point_count, static_cast<int const*>(from.point_count), count(1));
    ft::copy(exec, to.T_cw, static_cast<ft::rigid<double> const*>(from.T_cw), count(what_.views));
    ft::copy(exec, to.position, static_cast<ft::vec3<double> const*>(from.position),
             count(what_.points));
    ft::copy(exec, to.seen, static_cast<ft::window_observation const*>(from.seen),
             count(what_.points) * static_cast<std::size_t>(what_.views));
  }
  void draw(int b) {
    host_.view_count[b] = what_.views;
    host_.fixed_count[b] = what_.fixed;
    host_.point_count[b] = what_.points;
    for (int v = 0; v < what_.views; ++v) {
      auto& T = host_.T_cw[host_.view(b, v)];
      T = ft::rigid<double>::identity();
      T.t.x = -0.1 * v + (v < what_.fixed ? 0 : 0.02 * noise(b, v, 0));
    }
    for (int p = 0; p < what_.points; ++p) { draw_point(b, p); }
  }
  void draw_point(int b, int p) {
    auto const camera = rig_.camera.template cast<double>();
    int const length = 2 + static_cast<int>(7 * uniform(key(b, p), 1));
    int const first =
        static_cast<int>(uniform(key(b, p), 2) * std::max(1, what_.views - length + 1));
    double const depth = 3 + 5 * uniform(key(b, p), 3);
    double const middle = 0.1 * (first + 0.5 * length);
    ft::vec3<double> const X{middle + 0.5 * depth * noise(b, p, 4), 0.4 * depth * noise(b, p, 5),
                             depth};
    host_.position[host_.point(b, p)] = {X.x, X.y, X.z + 0.05 * noise(b, p, 6)};
    for (int v = 0; v < what_.views; ++v) {
      auto& o = host_.seen[host_.sighting(b, p, v, 0)];
      o = {0, 0, -1, 0};
      if (v < first || v >= first + length) { continue; }
      auto const at = camera.project({X.x - 0.1 * v, X.y, X.z}).pixel;
      double const x = at.x + noise(b, p, 10 + 2 * v);
      double const right = x - static_cast<double>(rig_.bf()) / X.z;
      o = {static_cast<float>(x), static_cast<float>(at.y + noise(b, p, 11 + 2 * v)),
           p % 3 == 0 || right < 0 ? -1.0f : static_cast<float>(right), 1.0f};
    }
  }
  static std::uint64_t key(int b, int i) {
    return static_cast<std::uint64_t>(b) << 32 | static_cast<std::uint64_t>(i);
  }
  /// Uniform in [-1, 1).
  static double noise(int b, int i, int number) {
    return 2 * uniform(key(b, i), static_cast<std::uint64_t>(number)) - 1;
  }
  template <typename E>
  void queue(E const& exec) const {
    ft::adjust_window(exec, rig_, problem_, nullptr, params_, work_);
  }

  owned_executor<Exec> owned_;
  window_case what_;
  ft::rectified_rig rig_ = ft::rectified_rig::make({435.0f, 435.0f, 367.2f, 252.2f}, 0.11);
  ft::window_params params_;
  ft::window_problem_view host_, start_, problem_;
  ft::window_workspace work_;
  ft::arena<ft::memory_space::host> here_;
  ft::arena<Exec::space> there_;
  ft::recording<Exec> graph_;
  interval<Exec> time_;
};

}  // namespace FT_ABI

std::unique_ptr<window_runner> make_host_windows(window_case const& what);
std::unique_ptr<window_runner> make_cuda_windows(window_case const& what);

}  // namespace bench
