// SPDX-License-Identifier: Apache-2.0
/// @file The order of launches of a frame of an odometry; see frame_schedule.hpp.
///
/// The end of an adjustment and the prediction need no keypoints, so a branch has them, and another
/// one the integration of the IMU's samples. After the last pose each stage needs what the one
/// before it has decided; what only the next pose with the IMU needs is on a branch again.
#pragma once

#include "ft/core/config.hpp"
#include "ft/pipelines/detail/frame_schedule.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Inputs, images, keypoints, stereo, the search from the last frame and its pose.
template <typename Line, typename Stages>
void queue_odometry_motion(Line& line, Stages& s) {
  auto const branch = line.fork(s.beginning_branch());
  s.read_inputs(branch);
  if (s.has_imu()) {
    s.begin_inertial(branch);
    s.integrate(s.inertial_branch().fork(branch));
  }
  s.apply_adjustment(branch);
  s.predict(line.on(branch));
  if (s.has_imu()) {
    s.inertial_branch().join(branch);
    s.predict_inertial(branch);
  }
  line.end_of_branch(branch, "motion");
  queue_images(line, s, false);
  line.join(s.beginning_branch());
  if constexpr (Stages::undistorts) { s.undistort(line.then("undistort")); }
  if constexpr (Stages::rectified) {
    // One camera has no depths.
    char const* const stereo = Stages::starts_from_motion ? "start" : "stereo";
    line.both([&](Line& l) { s.list_last_frame(l.then("search last frame")); },
              [&](Line& l) { s.match_stereo(l.with(stereo)); });
    s.assign_last_frame(line.then("search last frame"));
  } else {
    s.list_last_frame(line.then("search last frame"));
    auto const stereo = line.fork(s.stereo_branch());
    s.match_stereo(line.on(stereo));
    line.end_of_branch(stereo, "stereo");
    s.assign_last_frame(line.then("search last frame"));
  }
  s.optimize_last(line.then("pose last frame"));
  if constexpr (!Stages::rectified) {
    line.join(s.stereo_branch());
    s.refine_partners(line.then("stereo"));
  }
}

/// A whole frame.
template <typename Line, typename Stages>
void queue_odometry(Line& line, Stages& s) {
  queue_odometry_motion(line, s);
  s.plan_search(line.then("update local map"));
  s.choose_local(line.then("update local map"));
  s.list_local_map(line.then("search local map"));
  auto const branch = line.fork(s.result_branch());
  s.pack_keypoints(branch);
  s.assign_local_map(line.then("search local map"));
  s.optimize_local(line.then("pose local map"));
  if (s.has_imu()) {
    s.optimize_inertial(line.then("pose local map"));
    s.marginalize(line.fork(s.inertial_branch()));
  }
  if constexpr (Stages::starts_from_motion) { s.look_for_start(line.then("start")); }
  s.judge(line.then("keyframe"));
  s.count_points(line.then("keyframe"));
  if constexpr (Stages::starts_from_motion) {
    s.insert_first(line.then("keyframe"));
    s.triangulate(line.then("keyframe"));
  }
  s.insert(line.then("keyframe"));
  if constexpr (Stages::starts_from_motion) { s.enter_new_points(line.then("keyframe")); }
  if (s.has_imu()) { s.keep_inertial(line.fork(s.inertial_branch())); }
  s.gather(line.then("keyframe"));
  if (s.has_imu()) { s.gather_inertial(line.fork(s.inertial_branch())); }
  line.join(s.result_branch());
  s.pack_matches(line.then("result"), s.outcome_of_local());
  s.pack_outputs(line.with("result"));
  if (s.has_imu()) { line.join(s.inertial_branch()); }
  line.end();
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
