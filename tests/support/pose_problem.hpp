// SPDX-License-Identifier: Apache-2.0
/// @file The pose stage on one list of observations.
#pragma once

#include "ft/core/config.hpp"
#include "ft/kernels/pose/optimize_pose.hpp"

namespace test {

template <typename Rig>
struct solve_pose_problem {
  using scratch = typename ft::optimize_pose<Rig>::scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int, Rig const& rig,
                                 ft::pose_problem const& problem,
                                 ft::pose_params const& params) const {
    ft::optimize_pose<Rig>{}(g, s, rig, problem, params);
  }
};

}  // namespace test
