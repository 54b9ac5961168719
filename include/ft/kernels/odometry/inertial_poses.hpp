// SPDX-License-Identifier: Apache-2.0
/// @file Stages: what surrounds the pose of a frame from its map points and its IMU.
#pragma once

#include <cstddef>

#include "ft/containers/frame.hpp"
#include "ft/containers/inertial.hpp"
#include "ft/containers/observations.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/geometry.hpp"
#include "ft/core/group.hpp"
#include "ft/core/group_copy.hpp"
#include "ft/kernels/odometry/begin_inertial.hpp"
#include "ft/kernels/odometry/inertial_track.hpp"
#include "ft/kernels/odometry/state.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Item: a camera. Makes the problem of its pose.
struct prepare_inertial_pose {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, observations_view const& seen,
                                 odometry_state_view const& state, inertial_view const& v) const {
    inertial_track& t = v.tracks[b];
    inertial_inputs const& in = v.inputs;
    // A camera that was lost has been searched for with a wide radius: too many wrong matches.
    bool const optimizes =
        t.source != inertial_source::none && state.tracks[b].plan == search_plan::follow;
    bool const from_last = t.source == inertial_source::last_frame;
    int const n = optimizes ? seen.count[b] : 0;
    auto const at = static_cast<std::ptrdiff_t>(b) * seen.capacity;
    vec3<strict_double> const centre = camera_centre(t.predicted);
    for (int i = g.rank(); i < n; i += g.size()) {
      vec3<float> const p = seen.items[at + i].point;
      vec3<strict_double> const d =
          vec3<strict_double>{static_cast<double>(p.x), static_cast<double>(p.y),
                              static_cast<double>(p.z)} -
          centre;
      in.distance[at + i] = static_cast<float>(scalar::sqrt(dot(d, d)).value);
    }
    copy_object(g, in.integral[b], from_last ? v.from_last(b) : v.from_keyframe(b));
    copy_object(g, in.first[b], from_last ? t.last : t.keyframe);
    copy_object(g, in.start[b], t.predicted);
    g.sync();
    if (g.rank() != 0) { return; }
    t.optimizes = optimizes ? 1 : 0;
    in.count[b] = n;
    in.from_last_frame[b] = from_last ? 1 : 0;
    in.gravity[b] = t.gravity;
    if (!optimizes) { in.integral[b].status = integration_status::no_samples; }
  }

private:
  FT_HOST_DEVICE static vec3<strict_double> camera_centre(stored_inertial_state const& state) {
    using real = strict_double;
    auto const widen = [](float x) { return real(static_cast<double>(x)); };
    quaternion<real> const q{widen(state.q_cw.x), widen(state.q_cw.y), widen(state.q_cw.z),
                             widen(state.q_cw.w)};
    return rigid<real>{rotation_of(q),
                       {widen(state.t_cw.x), widen(state.t_cw.y), widen(state.t_cw.z)}}
        .centre();
  }
};

/// Item: a camera. Takes the pose over where it was optimised.
struct take_inertial_pose {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, observations_view const& seen,
                                 frame_view const& frame, pose* T_cw,
                                 inertial_view const& v) const {
    inertial_track& t = v.tracks[b];
    inertial_pose_result const& result = v.poses.result[b];
    bool const optimizes = t.optimizes != 0;
    bool const optimized = optimizes && result.status == inertial_pose_status::optimised;
    auto const at = static_cast<std::ptrdiff_t>(b) * seen.capacity;
    int* const holder = frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers();
    int const n = optimized ? seen.count[b] : 0;
    // What the visual optimisation has released stays so.
    int inliers = 0;
    for (int i = g.rank(); i < n; i += g.size()) {
      bool const holds = holder[seen.number[at + i]] >= 0;
      inliers += static_cast<int>(holds && v.poses.outlier[at + i] == 0);
    }
    inliers = g.reduce(inliers, sum_op{});
    bool const agrees = 2 * inliers >= seen.inliers[b];
    g.sync();
    if (!optimized || !agrees) {
      if (g.rank() != 0 || !optimizes) { return; }
      t.optimizes = 0;
      if (!agrees) { t.moves = t.keyframe_moves = 0; }
      return;
    }
    for (int i = g.rank(); i < n; i += g.size()) {
      if (v.poses.outlier[at + i] != 0) { holder[seen.number[at + i]] = -1; }
    }
    if (g.rank() != 0) { return; }
    seen.inliers[b] = inliers;
    T_cw[b] = pose_of(result.stored).template cast<float>();
  }
};

}  // namespace detail

/// Makes the problems of optimize_inertial_poses() from the observations of optimize_frame_poses().
/// Cameras whose IMU says nothing, or that are searched for, get one that is refused. Asynchronous
/// on `exec`; allocates nothing; one launch.
template <typename Exec>
void prepare_inertial_poses(Exec const& exec, observations_view const& seen,
                            odometry_state_view const& state, inertial_view const& v) {
  for_each_item<per_block<256>>(exec, v.batch, detail::prepare_inertial_pose{}, seen, state, v);
}

/// Replaces poses and inliers by those of optimize_inertial_poses(), where that was not refused and
/// at least half of the visual inliers agree. Keypoints that are outliers release their points.
/// Asynchronous on `exec`; allocates nothing; one launch.
/// @param T_cw [batch]
template <typename Exec>
void take_inertial_poses(Exec const& exec, observations_view const& seen, frame_view const& frame,
                         pose* T_cw, inertial_view const& v) {
  for_each_item<per_block<256>>(exec, v.batch, detail::take_inertial_pose{}, seen, frame, T_cw, v);
}

}  // namespace FT_ABI
}  // namespace ft
