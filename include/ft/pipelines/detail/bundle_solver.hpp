// SPDX-License-Identifier: Apache-2.0
/// @file The steps of a bundle's adjustment on an executor, and their memory.
#pragma once

#include <algorithm>
#include <cstddef>
#include <numeric>
#include <utility>
#include <vector>

#include "ft/containers/bundle.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/bundle/conjugate_gradients.hpp"
#include "ft/kernels/bundle/linearize.hpp"
#include "ft/kernels/bundle/step.hpp"
#include "ft/kernels/bundle/system.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The order of a bundle's observations: by view, in a view by point, equal ones as given.
struct bundle_order {
  std::vector<int> camera, place, moving_view, view_begin, view, point, point_begin, sighting;
  std::vector<std::size_t> given;  ///< index of each observation in the bundle

  template <typename Camera>
  explicit bundle_order(bundle<Camera> const& map) {
    std::size_t const views = map.T_cw.size();
    camera = map.camera_of_view;
    camera.resize(views, 0);
    bool const anchored =
        std::any_of(map.fixed.begin(), map.fixed.end(), [](unsigned char f) { return f != 0; });
    for (std::size_t v = 0; v < views; ++v) {
      bool const stays = anchored ? map.fixed[v] != 0 : v == 0;
      place.push_back(stays ? -1 : static_cast<int>(moving_view.size()));
      if (!stays) { moving_view.push_back(static_cast<int>(v)); }
    }
    std::vector<std::size_t> all(map.observing_view.size());
    std::iota(all.begin(), all.end(), std::size_t{0});
    std::vector<int> begin;
    given = sorted(sorted(all, map.observed_point, map.position.size(), begin), map.observing_view,
                   views, view_begin);
    for (std::size_t const o : given) {
      view.push_back(map.observing_view[o]);
      point.push_back(map.observed_point[o]);
    }
    for (std::size_t const o : sorted(all, point, map.position.size(), point_begin)) {
      sighting.push_back(static_cast<int>(o));
    }
  }

private:
  /// A stable counting sort of indices by their keys.
  static std::vector<std::size_t> sorted(std::vector<std::size_t> const& from,
                                         std::vector<int> const& keys, std::size_t range,
                                         std::vector<int>& begin) {
    begin.assign(range + 1, 0);
    for (std::size_t const i : from) { ++begin[static_cast<std::size_t>(keys[i]) + 1]; }
    std::partial_sum(begin.begin(), begin.end(), begin.begin());
    std::vector<int> next = begin;
    std::vector<std::size_t> to(from.size());
    for (std::size_t const i : from) {
      to[static_cast<std::size_t>(next[static_cast<std::size_t>(keys[i])]++)] = i;
    }
    return to;
  }
};

struct bundle_rules {
  observation_rule observation;
  gradient_limits gradients;
};

/// A bundle's system, views and points in executor memory. Functions enqueue, but for those that
/// return something: they wait.
template <typename Exec, typename Camera>
class bundle_solver {
public:
  /// Allocates.
  bundle_solver(Exec const& exec, bundle<Camera> const& map, bundle_rules const& rules)
      : bundle_solver(exec, map, rules, bundle_order(map)) {}

  std::size_t bytes() const { return memory_.bytes(); }
  /// Of conjugate gradients, since the start.
  long long solver_steps() const { return solver_steps_; }
  void download(bundle<Camera>& map) const {
    copy(exec_, map.T_cw.data(), memory_->T_cw[current_], map.T_cw.size());
    copy(exec_, map.position.data(), memory_->position[current_], map.position.size());
    exec_.wait();
  }

  /// Cost of the current estimate.
  bundle_verdict measure() { return judge(current_, 0); }

  void linearize() {
    bundle_system_view const& A = memory_->system;
    for_each_item<block>(exec_, A.views, linearize_view<camera>{rules_.observation}, A, cameras(),
                         T_cw(), position());
    for_each_item<per_thread>(exec_, A.points, linearize_point{}, A);
  }

  /// Solves the linear system, and measures where the step leads.
  bundle_verdict try_step(double damping) {
    memory const& m = memory_.view();
    bundle_system_view const& A = m.system;
    for_each_item<per_thread>(exec_, A.points, factor_point{damping}, A);
    for_each_item<block>(exec_, A.moving, reduce_view{damping}, A, position());
    for_each_item<block>(exec_, 1, start_gradients{}, A);
    solve(damping);
    for_each_item<per_thread>(exec_, A.moving, move_view{damping}, A, T_cw(), m.T_cw[1 - current_]);
    for_each_item<per_thread>(exec_, A.points, move_point<camera>{damping}, A, cameras(),
                              static_cast<rigid<double> const*>(m.T_cw[1 - current_]), position(),
                              m.position[1 - current_]);
    auto const verdict = judge(1 - current_, A.moving + A.points);
    solver_steps_ += verdict.solver_steps;
    return verdict;
  }
  /// Makes the estimate that was tried the current one.
  void accept() { current_ = 1 - current_; }

private:
  using block = per_block<sum_lanes>;
  using camera = decltype(std::declval<Camera const&>().template cast<real64>());
  /// Steps of conjugate gradients between two looks of the host at their state.
  static constexpr int steps_at_once = 8;

  struct memory {
    bundle_system_view system;
    Camera* cameras = nullptr;
    rigid<double>* T_cw[2] = {nullptr, nullptr};
    vec3<double>* position[2] = {nullptr, nullptr};
    bundle_verdict* verdict = nullptr;
  };

  bundle_solver(Exec const& exec, bundle<Camera> const& map, bundle_rules const& rules,
                bundle_order const& order)
      : exec_(exec),
        rules_(rules),
        memory_([&](carver& c, memory& m) { lay_out(c, m, map, order); }) {
    upload(map, order);
  }

  static void lay_out(carver& c, memory& m, bundle<Camera> const& map, bundle_order const& order) {
    bundle_system_view& A = m.system;
    A.views = static_cast<int>(map.T_cw.size());
    A.moving = static_cast<int>(order.moving_view.size());
    A.points = static_cast<int>(map.position.size());
    A.observations = static_cast<int>(order.view.size());
    for_each_array(order, A, [&](std::vector<int> const& from, int const*& to) {
      to = c.take<int>(from.size());
    });
    c.place({A.observations}, A.pixel, A.weight);
    if (!map.right_x.empty()) { c.place({A.observations}, A.right_x); }
    c.place({map.baseline.size()}, A.baseline);
    c.place({A.observations, 6}, A.curvature);
    c.place({A.observations, 3}, A.gradient);
    c.place({A.views}, A.centre);
    c.place({A.points, 3}, A.point_right, A.point_start, A.point_answer);
    c.place({A.points, 6}, A.point_matrix, A.point_factor);
    c.place({A.moving, 36}, A.block_factor);
    c.place({A.moving, 6}, A.view_diagonal, A.view_right, A.right, A.solution, A.residual,
            A.direction, A.product);
    c.place({1}, A.state, m.verdict);
    c.place({A.views, 3}, A.cost);
    c.place({A.moving + A.points}, A.promise);
    c.place({map.cameras.size()}, m.cameras);
    for (auto& T : m.T_cw) { c.place({A.views}, T); }
    for (auto& X : m.position) { c.place({A.points}, X); }
  }

  /// Calls take(array of the order, pointer of the view) for each array.
  template <typename Take>
  static void for_each_array(bundle_order const& order, bundle_system_view& A, Take const& take) {
    take(order.camera, A.camera);
    take(order.place, A.place);
    take(order.moving_view, A.moving_view);
    take(order.view_begin, A.view_begin);
    take(order.view, A.view);
    take(order.point, A.point);
    take(order.point_begin, A.point_begin);
    take(order.sighting, A.sighting);
  }

  void upload(bundle<Camera> const& map, bundle_order const& order) {
    memory const& m = memory_.view();
    bundle_system_view A = m.system;
    for_each_array(order, A, [&](std::vector<int> const& from, int const*& to) {
      copy(exec_, const_cast<int*>(to), from.data(), from.size());
    });
    std::vector<vec2<double>> pixel;
    std::vector<double> weight;
    std::vector<double> right_x;
    for (std::size_t const o : order.given) {
      if (!map.right_x.empty()) { right_x.push_back(map.right_x[o]); }
      pixel.push_back(map.pixel[o]);
      double const sigma = map.sigma.empty() ? 1 : map.sigma[o];
      weight.push_back(1 / (sigma * sigma));
    }
    copy(exec_, A.pixel, pixel.data(), pixel.size());
    copy(exec_, A.weight, weight.data(), weight.size());
    copy(exec_, A.right_x, right_x.data(), right_x.size());
    copy(exec_, A.baseline, map.baseline.data(), map.baseline.size());
    copy(exec_, m.cameras, map.cameras.data(), map.cameras.size());
    // Both: views that stay are not written.
    for (auto* const T : m.T_cw) { copy(exec_, T, map.T_cw.data(), map.T_cw.size()); }
    for (auto* const X : m.position) { copy(exec_, X, map.position.data(), map.position.size()); }
    exec_.wait();
  }

  /// Moves the solution until the conjugate gradients end.
  void solve(double damping) {
    bundle_system_view const& A = memory_->system;
    for (int step = 0; step < rules_.gradients.steps; ++step) {
      if (step % steps_at_once == 0) {
        gradient_state state{};
        copy(exec_, &state, A.state, 1);
        exec_.wait();
        if (state.running == 0) { return; }
      }
      for_each_item<per_thread>(exec_, A.points, multiply_points{}, A, position());
      for_each_item<block>(exec_, A.moving, multiply_views{damping}, A, position());
      for_each_item<block>(exec_, 1, advance_gradients{rules_.gradients}, A);
    }
  }

  bundle_verdict judge(int at, int promises) {
    memory const& m = memory_.view();
    bundle_system_view const& A = m.system;
    for_each_item<block>(exec_, A.views, measure_view<camera>{rules_.observation}, A, cameras(),
                         static_cast<rigid<double> const*>(m.T_cw[at]),
                         static_cast<vec3<double> const*>(m.position[at]));
    for_each_item<block>(exec_, 1, judge_bundle{promises}, A, m.verdict);
    bundle_verdict verdict{};
    copy(exec_, &verdict, m.verdict, 1);
    exec_.wait();
    return verdict;
  }

  Camera const* cameras() const { return memory_->cameras; }
  rigid<double> const* T_cw() const { return memory_->T_cw[current_]; }
  vec3<double> const* position() const { return memory_->position[current_]; }

  Exec exec_;
  bundle_rules rules_;
  int current_ = 0;
  long long solver_steps_ = 0;
  owner<memory, Exec::space> memory_;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
