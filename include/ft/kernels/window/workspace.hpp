// SPDX-License-Identifier: Apache-2.0
/// @file Parameters, state and working memory of an adjustment of windows.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/containers/window_problem.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// @throws bad_argument naming the value and the limit
inline void check(window_params const& p) {
  detail::require_range("steps", p.steps, 0, 1000);
  detail::require_range("huber2", p.huber2, 1e-9, 1e50);
  detail::require_range("outlier2", p.outlier2, 1e-9, 1e50);
  detail::require_range("no_image", p.no_image, 0.0, 1e50);
  detail::require_range("disparity_weight", p.disparity_weight, 0.0, 1e9);
  detail::require_range("first_damping", p.first_damping, 0.0, 1e9);
  detail::require_range("enough", p.enough, 0.0, 1.0);
}

namespace detail {

/// Where a problem's descent is. Written by the launches themselves.
struct window_state {
  double cost;  ///< at the current estimate
  double first_cost;
  double damping;
  int steps;   ///< tried
  int buffer;  ///< which of two buffers holds the current estimate; the other one has the trial
  int running;
  int valid;
};

/// Part of a problem's cost.
struct window_cost_part {
  double cost;
  double linked;  ///< number of points that a moving view sees
};

/// Numbers that a linearisation keeps for a point and a moving view: the curvature by the point's
/// position (upper triangle by rows) and the gradient, both along the axes of the world.
inline constexpr int window_terms = 9;

/// Points of a block.
inline constexpr int window_group = 32;

}  // namespace detail

/// Working memory of adjust_window(), in executor memory. Nothing has to be initialised, and
/// nothing is kept between calls.
struct window_workspace {
  int views = 0, points = 0, batch = 0;  ///< of the problems
  int moving = 0;                        ///< most views of a problem that are not fixed

  detail::window_state* state = nullptr;  ///< [2][batch], turn by turn
  int* solved = nullptr;                  ///< [batch] 1 = there is a trial
  rigid<double>* T_cw = nullptr;          ///< [2][batch][views]
  vec3<double>* position = nullptr;       ///< [2][batch][points]
  double* by_view = nullptr;      ///< [2][batch][moving][window_terms][points], of points in `mask`
  double* by_point = nullptr;     ///< [2][batch][window_terms][points] sums over all views
  std::uint64_t* mask = nullptr;  ///< [2][batch][points] moving views that see the point
  detail::window_cost_part* part = nullptr;  ///< [batch][groups] costs at the newest trial
  double* matrix = nullptr;  ///< [batch][side * side] reduced system, then its factors
  double* step = nullptr;    ///< [batch][moving][6] rotation, translation of a view

  FT_HOST_DEVICE int groups() const { return ceil_div(points, detail::window_group); }
  /// Rows and columns of the largest reduced system with its right-hand side.
  FT_HOST_DEVICE int side() const { return 6 * moving + 1; }
  FT_HOST_DEVICE int pairs() const { return moving * (moving + 1) / 2; }

  FT_HOST_DEVICE detail::window_state& state_of(int turn, int b) const {
    return state[(turn & 1) * batch + b];
  }
  FT_HOST_DEVICE rigid<double>* views_of(int buffer, int b) const {
    return T_cw + (static_cast<std::ptrdiff_t>(buffer) * batch + b) * views;
  }
  FT_HOST_DEVICE vec3<double>* points_of(int buffer, int b) const {
    return position + (static_cast<std::ptrdiff_t>(buffer) * batch + b) * points;
  }
  FT_HOST_DEVICE double* terms_of_view(int buffer, int b, int v) const {
    return by_view + ((static_cast<std::ptrdiff_t>(buffer) * batch + b) * moving + v) *
                         detail::window_terms * points;
  }
  FT_HOST_DEVICE double* terms_of_points(int buffer, int b) const {
    return by_point +
           (static_cast<std::ptrdiff_t>(buffer) * batch + b) * detail::window_terms * points;
  }
  FT_HOST_DEVICE std::uint64_t* masks_of(int buffer, int b) const {
    return mask + (static_cast<std::ptrdiff_t>(buffer) * batch + b) * points;
  }
  FT_HOST_DEVICE detail::window_cost_part* parts_of(int b) const {
    return part + static_cast<std::ptrdiff_t>(b) * groups();
  }
  FT_HOST_DEVICE double* matrix_of(int b) const {
    return matrix + static_cast<std::ptrdiff_t>(b) * side() * side();
  }
  FT_HOST_DEVICE double* steps_of(int b) const {
    return step + static_cast<std::ptrdiff_t>(b) * moving * 6;
  }
};
static_assert(std::is_trivially_copyable<window_workspace>::value, "passed to kernels");

/// Places the working memory for a batch of problems into an arena: 8 * 2 * 9 * points * (moving +
/// 1) bytes and little more for each.
/// @param moving most views of a problem that are not fixed, 1 to `problems.views`. A problem with
///   more is not valid.
/// @throws bad_argument for `moving` out of range
inline void carve(carver& c, window_workspace& w, window_problem_view const& problems, int moving) {
  detail::require_range("moving views of a window", moving, 1, problems.views);
  w.views = problems.views;
  w.points = problems.points;
  w.batch = problems.batch;
  w.moving = moving;
  int const terms = detail::window_terms;
  c.place({2, w.batch}, w.state);
  c.place({w.batch}, w.solved);
  c.place({2, w.batch, w.views}, w.T_cw);
  c.place({2, w.batch, w.points}, w.position);
  c.place({2, w.batch, w.points, terms, moving}, w.by_view);
  c.place({2, w.batch, w.points, terms}, w.by_point);
  c.place({2, w.batch, w.points}, w.mask);
  c.place({w.batch, w.groups()}, w.part);
  c.place({w.batch, w.side(), w.side()}, w.matrix);
  c.place({w.batch, moving, 6}, w.step);
}

namespace detail {

/// Levenberg-Marquardt after an evaluation: the state of the next turn.
/// @param trial sum over the parts; the evaluation is that of the start, or of the trial
/// @param solved whether there was a trial
FT_HOST_DEVICE inline window_state judge_window(window_state s, bool start, window_cost_part trial,
                                                bool solved, window_params const& params) {
  using real = strict_double;
  if (!s.running) { return s; }
  if (start) {
    s.cost = s.first_cost = trial.cost;
    s.valid = s.running = scalar::is_finite(trial.cost) && trial.linked > 0 ? 1 : 0;
    return s;
  }
  ++s.steps;
  if (!solved) {
    s.running = 0;
    if (!(s.cost < s.first_cost)) { s.valid = 0; }
  } else if (trial.cost < s.cost) {
    bool const done = s.cost - trial.cost < (real(params.enough) * real(s.cost)).value;
    s.running = done ? 0 : 1;
    s.cost = trial.cost;
    s.buffer = 1 - s.buffer;
    s.damping = max_of((real(s.damping) * real(0.1)).value, 1e-8);
  } else {
    s.damping = (real(s.damping) * real(10.0)).value;
  }
  return s;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
