// SPDX-License-Identifier: Apache-2.0
/// @file Stage: takes over the pose of a frame from its map points and its IMU.
#pragma once

#include <cstddef>

#include "ft/containers/frame.hpp"
#include "ft/containers/inertial.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/odometry/begin_inertial.hpp"
#include "ft/kernels/odometry/inertial_track.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// A frame of which a smaller share than one in so many keypoints agrees with its pose tells little
/// of it.
inline constexpr int few_inliers = 10;
/// After so many frames whose map points it contradicts, and none between where both agree, it is
/// the IMU's state that is wrong.
inline constexpr int most_contradictions = 3;
/// So many matches that agree with one another are no accident: where the IMU is against more than
/// one in eight of them, its samples or its state are wrong.
inline constexpr int outvoting_matches = 80;

/// @param with inliers of the pose with the IMU @param without of the pose of the images alone
FT_HOST_DEVICE inline bool images_allow(int with, int without) {
  return without >= outvoting_matches ? 8 * with >= 7 * without : 2 * with >= without;
}

/// Item: a camera. Takes the pose over where it was optimised.
struct take_inertial_pose {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, observations_view const& seen,
                                 odometry_state_view const& state, frame_view const& frame,
                                 pose* T_cw, inertial_view const& v) const {
    inertial_track& t = v.tracks[b];
    inertial_pose_result const& result = v.poses.result[b];
    // A camera that was lost has been searched for with a wide radius: too many wrong matches.
    bool const optimizes =
        t.source != inertial_source::none && state.tracks[b].plan == search_plan::follow;
    bool const optimized = optimizes && result.status == inertial_pose_status::optimised;
    bool const is_last = g.rank() == g.size() - 1;
    pose T{};
    if (is_last && optimized) { T = pose_of(result.stored).template cast<float>(); }
    auto const at = static_cast<std::ptrdiff_t>(b) * seen.capacity;
    int* const holder = frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers();
    int const n = optimized ? seen.count[b] : 0;
    // What the visual optimisation has released stays so.
    int inliers = 0;
    for (int i = g.rank(); i < n; i += g.size()) {
      bool const holds = holder[seen.number[at + i]] >= 0;
      inliers += static_cast<int>(holds && seen.outlier[at + i] == 0);
    }
    inliers = g.reduce(inliers, sum_op{});
    bool const taken = optimized && images_allow(inliers, seen.inliers[b]);
    g.sync();
    for (int i = g.rank(); taken && i < n; i += g.size()) {
      if (seen.outlier[at + i] != 0) { holder[seen.number[at + i]] = -1; }
    }
    if (!is_last) { return; }
    t.optimized = taken ? 1 : 0;
    if (taken) {
      t.contradicted = 0;
      seen.inliers[b] = inliers;
      T_cw[b] = T;
    } else if (optimizes) {
      contradict(t, optimized, seen.inliers[b], v.from_keyframe(b));
    }
    int keypoints = 0;
    for (int c = 0; c < frame.cameras; ++c) { keypoints += *frame.camera(b, c).count; }
    t.weak = few_inliers * seen.inliers[b] < keypoints ? 1 : 0;
  }

private:
  /// Map points and IMU contradict each other. A blurred image has wrong matches that agree with
  /// one another, so the IMU is right, but not again and again, nor against many matches. Of these
  /// the pose stays, and what was integrated enters nothing.
  FT_HOST_DEVICE static void contradict(inertial_track& t, bool optimized, int& inliers,
                                        preintegrated& from_keyframe) {
    ++t.contradicted;
    bool const outvoted = optimized && inliers >= outvoting_matches;
    if (outvoted) {
      t.status = from_keyframe.status = integration_status::contradicted;
    } else if (optimized && t.contradicted < most_contradictions) {
      inliers = 0;
      return;
    }
    t.contradicted = 0;
    t.keyframe_moves = 0;
    t.source = inertial_source::none;
  }
};

}  // namespace detail

/// Replaces poses and inliers by those of optimize_inertial_poses(), where that was not refused, at
/// least half of the visual inliers agree, or seven in eight of 80 or more, and the camera is not
/// searched for. Keypoints that are outliers release their points. Where fewer agree, and there are
/// fewer than 80, the frame has no inliers, so that it is not tracked. The third such frame, if
/// none in between agreed, and any with more keep their visual pose, and the IMU says nothing until
/// an estimate gives velocities anew; with more, the integral from the newest keyframe is dropped
/// as `contradicted`. Asynchronous on `exec`; allocates nothing; one launch.
/// @param T_cw [batch]
template <typename Exec>
void take_inertial_poses(Exec const& exec, observations_view const& seen,
                         odometry_state_view const& state, frame_view const& frame, pose* T_cw,
                         inertial_view const& v) {
  for_each_item<per_block<1024>>(exec, v.batch, detail::take_inertial_pose{}, seen, state, frame,
                                 T_cw, v);
}

}  // namespace FT_ABI
}  // namespace ft
