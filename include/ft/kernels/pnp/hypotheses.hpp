// SPDX-License-Identifier: Apache-2.0
/// @file Hypotheses of poses, many at once: samples, their poses, and how many correspondences
/// agree with each.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/counter_draws.hpp"
#include "ft/core/group.hpp"
#include "ft/core/stage.hpp"
#include "ft/kernels/pnp/linear_pose.hpp"
#include "ft/kernels/pnp/problem.hpp"
#include "ft/kernels/pnp/refine_pose.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/relocalization.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

template <typename Camera>
FT_HOST_DEVICE projection<typename Camera::scalar_type> project_any_side(
    Camera const& camera, vec3<typename Camera::scalar_type> p) {
  return camera.project(p);
}
/// As in the reference also behind the camera, where a point has the pixel of its mirror image.
template <typename Scalar>
FT_HOST_DEVICE projection<Scalar> project_any_side(pinhole<Scalar> const& camera, vec3<Scalar> p) {
  return {{camera.fx * p.x / p.z + camera.cx, camera.fy * p.y / p.z + camera.cy}, true};
}

/// Whether a pose moves a point to where its pixel is: in double to the camera, from there in
/// float.
/// @param camera of strict_float
template <typename Camera>
FT_HOST_DEVICE bool is_inlier(Camera const& camera, rigid<wide> const& T, pnp_problem const& from,
                              int i) {
  wide_vec3 const seen = T * from.point[i].template cast<double>().template cast<wide>();
  auto const at =
      project_any_side(camera, seen.template cast<float>().template cast<strict_float>());
  strict_float const x = at.pixel.x - strict_float(from.pixel[i].x);
  strict_float const y = at.pixel.y - strict_float(from.pixel[i].y);
  return at.valid && x * x + y * y < strict_float(from.max_error2[i]);
}

template <typename Group, typename Camera>
FT_HOST_DEVICE int count_inliers(Group g, Camera const& camera, rigid<wide> const& T,
                                 pnp_problem const& from) {
  int count = 0;
  FT_NO_UNROLL
  for (int i = g.rank(); i < from.count; i += g.size()) {
    count += static_cast<int>(is_inlier(camera, T, from, i));
  }
  return g.reduce(count, sum_op{});
}

/// First number behind the hypotheses that the next call may need.
FT_HOST_DEVICE inline int needed_hypotheses(pnp_state const& state, pnp_limits const& limits,
                                            pnp_params const& params) {
  return max_of(limits.iterations, state.done + params.iterations_of_call);
}

/// Item: a hypothesis that the next call of a problem may need, and that is not known yet.
template <typename Camera>
struct evaluate_hypothesis {
  struct scratch {
    mlpnp_scratch solver;
    int sample[pnp_sample];
  };
  Camera camera;  ///< of strict_float
  pnp_params params;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, pnp_problems_view const& problems,
                                 pnp_workspace const& work) const {
    int const b = item / work.hypotheses;
    if (!problems.is_active(b)) { return; }
    pnp_problem const from = problems.of(b);
    pnp_limits const limits = pnp_limits_of(from.count, params);
    pnp_state const& state = work.state[b];
    int const h = state.evaluated + (item - b * work.hypotheses);
    if (from.count < limits.inliers || h >= needed_hypotheses(state, limits, params)) { return; }
    if (g.rank() == 0) {
      counter_draws const draws{problems.seed[b]};
      draws.distinct(from.count, static_cast<std::uint64_t>(h), s.sample);
    }
    g.sync();
    pnp_pose const found = mlpnp(g, s.solver, {from.ray, from.point, s.sample, pnp_sample});
    int count = 0;
    if (found.valid) { count = count_inliers(g, camera, found.T_cw.template cast<wide>(), from); }
    if (g.rank() == 0) {
      std::ptrdiff_t const slot = work.slot(b, h);
      work.T_cw[slot] = found.T_cw;
      work.inliers[slot] = count;
    }
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
