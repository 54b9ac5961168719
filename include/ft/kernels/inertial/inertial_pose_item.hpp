// SPDX-License-Identifier: Apache-2.0
/// @file What the optimisation of a state and its marginalisation have in common.
#pragma once

#include <cstddef>

#include "ft/containers/inertial.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/kernels/inertial/inertial_problem.hpp"
#include "ft/kernels/inertial/inertial_residual.hpp"
#include "ft/kernels/inertial/inertial_solver.hpp"
#include "ft/kernels/inertial/information.hpp"
#include "ft/kernels/inertial/stored_state.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Numbers that a structure of nothing else begins with, for checks that threads share.
template <typename T>
struct leading_numbers {
  T const* first;
  int count;

  template <typename Group>
  FT_HOST_DEVICE bool finite(Group g) const {
    bool good = true;
    for (int k = g.rank(); k < count; k += g.size()) { good = good && scalar::is_finite(first[k]); }
    return good;
  }
};

/// A problem and its working memory.
template <typename Rig>
struct inertial_pose_item {
  using scratch = inertial_scratch;
  Rig rig;
  imu_mount mount;
  inertial_pose_params params;

protected:
  FT_HOST_DEVICE static inertial_observations observations_of(int b, inertial_poses const& in) {
    auto const at = static_cast<std::ptrdiff_t>(b) * in.capacity;
    return {in.observations + at, in.distance == nullptr ? nullptr : in.distance + at,
            in.outlier + at, clamp(in.count[b], 0, in.capacity)};
  }
  /// The integral whose walk counts.
  FT_HOST_DEVICE preintegrated const& walk_of(int b, inertial_poses const& in, bool both) const {
    bool const slip = params.reference_quirks && both && in.since_keyframe != nullptr;
    return slip ? in.since_keyframe[b] : in.integral[b];
  }
  FT_HOST_DEVICE static leading_numbers<float> numbers(preintegrated const& v) {
    static_assert(offsetof(preintegrated, steps) == 160 * sizeof(float), "160 floats");
    return {&v.dT, 160};
  }
  FT_HOST_DEVICE static leading_numbers<float> numbers(stored_inertial_state const& v) {
    static_assert(sizeof(stored_inertial_state) == 16 * sizeof(float), "16 floats");
    return {&v.q_cw.x, 16};
  }
  FT_HOST_DEVICE static leading_numbers<double> numbers(inertial_prior const& v) {
    static_assert(offsetof(inertial_prior, known) == 246 * sizeof(double), "246 doubles");
    return {&v.state.R.m[0], 246};
  }

  /// Fills scratch, but for the states, which are written before. Ends with a sync.
  template <typename Group, typename Solver>
  FT_HOST_DEVICE void load_terms(Group g, scratch& s, int b, inertial_poses const& in,
                                 Solver const& solver) const {
    preintegrated const& integral = in.integral[b];
    if (solver.is_thread(0)) { s.mount = pose_mount::of(mount); }
    if (solver.is_thread(1)) {
      s.link =
          inertial_link::of(integral, in.gravity == nullptr ? standard_gravity() : in.gravity[b]);
    }
    if (solver.is_thread(2)) {
      s.prior_weight = 1.0;
      if (solver.both) { s.prior = cast_state<wide>(in.prior[b].state); }
    }
    for (int k = g.rank(); solver.both && k < 225; k += g.size()) {
      s.prior_H[k] = in.prior[b].information[k];
    }
    preintegrated const& walked = walk_of(b, in, solver.both);
    for (int k = g.rank(); k < 6; k += g.size()) {
      s.walk[k] = scalar::reciprocal(wide(static_cast<double>(walked.walk[k])));
    }
    s.rows.clear(g);
    information_of(g, s.matrices, integral, params.reference_quirks, s.omega);
  }

  /// Writes what the states in scratch leave to the next frame. Ends with a sync.
  /// @return whether all of it is finite
  template <typename Group, typename Solver>
  FT_HOST_DEVICE bool write_prior(Group g, scratch const& s, inertial_prior& next,
                                  Solver const& solver) const {
    solver.marginalize(next.information);
    if (g.rank() == 0) {
      next.state = cast_state<double>(s.frame);
      next.known = 1;
    }
    g.sync();
    return !g.any(!numbers(next).finite(g));
  }
};

inline void require_finite_pose(rigid<float> const& T) {
  for (float const v : T.R.m) { require_finite("imu mount rotation", v); }
  require_finite("imu mount x", T.t.x);
  require_finite("imu mount y", T.t.y);
  require_finite("imu mount z", T.t.z);
}
/// @throws bad_argument
inline void require_inertial_poses(inertial_poses const& in, imu_mount const& mount) {
  require(in.problems >= 0 && in.capacity >= 0, "a number of problems or a capacity < 0");
  require_finite_pose(mount.T_bc);
  require_finite_pose(mount.T_cb);
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
