// SPDX-License-Identifier: Apache-2.0
/// @file Stage: what the optimised states of frames leave to the next frames.
#pragma once

#include "ft/containers/inertial.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/inertial/inertial_pose_item.hpp"
#include "ft/kernels/inertial/inertial_problem.hpp"
#include "ft/kernels/inertial/inertial_residual.hpp"
#include "ft/kernels/inertial/inertial_solver.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Item: a problem.
template <typename Rig>
struct marginalize_inertial_pose : inertial_pose_item<Rig> {
  using item = inertial_pose_item<Rig>;
  using typename item::scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, inertial_poses const& in) const {
    inertial_pose_result const& result = in.result[b];
    inertial_prior& next = in.next_prior[b];
    if (result.rounds == 0) {  // refused
      if (g.rank() == 0) { next.known = 0; }
      return;
    }
    inertial_solver<Group, Rig> const solver{
        g, s, this->rig, item::observations_of(b, in), in.from_last_frame[b] != 0, 0.0};
    if (solver.is_thread(0)) {
      s.frame = cast_state<real64>(result.round_state[result.rounds - 1]);
      s.T_cw = pose_mount::of(this->mount).pose_of(s.frame);
    }
    if (solver.is_thread(1)) { s.first = cast_state<real64>(result.first); }
    this->load_terms(g, s, b, in, solver);
    bool const finite = this->write_prior(g, s, next, solver);
    if (!finite && g.rank() == 0) { next.known = 0; }
  }
};

}  // namespace detail

/// Writes `in.next_prior` of problems that optimize_inertial_poses() has solved without it
/// (inertial_pose_params::marginalizes = false), with the same bits; of refused ones, and of those
/// whose prior is not finite, it is not known. Inputs and results are those of that call.
/// Asynchronous on `exec`; allocates nothing; one launch with a block for each problem.
/// @throws bad_argument for a negative number of problems, or a mount that is not finite
template <typename Exec, typename Rig>
void marginalize_inertial_poses(Exec const& exec, Rig const& rig, imu_mount const& mount,
                                inertial_poses const& in, inertial_pose_params const& params = {}) {
  detail::require_inertial_poses(in, mount);
  for_each_item<per_block<sum_lanes>>(
      exec, in.problems, detail::marginalize_inertial_pose<Rig>{{rig, mount, params}}, in);
}

}  // namespace FT_ABI
}  // namespace ft
