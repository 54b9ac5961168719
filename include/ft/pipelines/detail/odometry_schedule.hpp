// SPDX-License-Identifier: Apache-2.0
/// @file The order of launches of a frame of an odometry; see frame_schedule.hpp.
///
/// The end of an adjustment and the prediction need no keypoints, so a branch has them, and another
/// one what parts have beside it: the integration of an IMU's samples. After the last pose each
/// stage needs what the one before it has decided, but for the weighing of matches; what only the
/// next frame needs of parts is on a branch again. The host waits for the outputs; what follows
/// them is the map's. Without parts that launch there is no branch of theirs.
/// How the images changed is found beside their keypoints, of a batch in parts beside its searches.
#pragma once

#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"
#include "ft/pipelines/detail/frame_schedule.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Reads the inputs, ends an adjustment and predicts the pose.
template <typename Exec, typename Stages>
void queue_prediction(Exec const& exec, Stages& s) {
  using part = typename Stages::part_type;
  bool const parts = s.parts_launch();
  s.read_inputs(exec);
  if (parts) {
    s.launch_parts(exec, &part::after_inputs);
    s.launch_parts(s.part_branch().fork(exec), &part::beside_adjusted_map);
  }
  s.apply_adjustment(exec);
  if (parts) { s.launch_parts(exec, &part::after_adjusted_map); }
  s.predict(exec);
  if (parts) {
    s.part_branch().join(exec);
    s.launch_parts(exec, &part::after_prediction);
  }
  if (s.rolls()) { s.find_velocities(exec); }
}

/// Which stages a frame has.
enum class frame_extent {
  whole,       ///< all
  prefetched,  ///< those that follow frame_features::queue()
  given        ///< those of features that the caller gives; see own_features
};

/// The search from the last frame and its pose, of features that are there.
template <typename Line, typename Stages>
void queue_last_frame(Line& line, Stages& s) {
  s.list_last_frame(line.then("search last frame"));
  s.mark_fixed(line.fork(s.result_branch()));
  s.assign_last_frame(line.then("search last frame"));
  line.join(s.result_branch());
  s.optimize_last(line.then("pose last frame"));
}

/// The same of rolling shutters, whose keypoints and partners have to be moved before.
template <typename Line, typename Stages>
void queue_moved_last_frame(Line& line, Stages& s) {
  if constexpr (Stages::has_partners) { s.refine_partners(line.then("stereo")); }
  s.move_to_middle_rows(line.then("rolling shutter"));
  queue_last_frame(line, s);
}

/// Inputs, images, keypoints, stereo, the search from the last frame and its pose.
template <typename Line, typename Stages>
void queue_odometry_motion(Line& line, Stages& s) {
  line.beside(
      s.beginning_branch(), "motion", [&](auto const& exec) { queue_prediction(exec, s); },
      [&](Line& l) {
        queue_images(l, s, false, [&] { s.watch_images(l.fork(s.result_branch())); });
      });
  if constexpr (Stages::undistorts) { s.undistort(line.then("undistort")); }
  if (s.rolls()) {
    s.match_stereo(line.then(Stages::starts_from_motion ? "start" : "stereo"));
    queue_moved_last_frame(line, s);
  } else if constexpr (Stages::rectified) {
    // One camera has no depths.
    char const* const stereo = Stages::starts_from_motion ? "start" : "stereo";
    line.both([&](Line& l) { s.list_last_frame(l.then("search last frame")); },
              [&](Line& l) { s.match_stereo(l.with(stereo)); });
    s.mark_fixed(line.fork(s.result_branch()));
    s.assign_last_frame(line.then("search last frame"));
    line.join(s.result_branch());
    s.optimize_last(line.then("pose last frame"));
    if constexpr (Stages::has_partners) { s.refine_partners(line.then("stereo")); }
  } else {
    s.list_last_frame(line.then("search last frame"));
    line.beside(
        s.stereo_branch(), "stereo", [&](auto const& exec) { s.match_stereo(exec); },
        [&](Line& l) {
          s.mark_fixed(l.fork(s.result_branch()));
          s.assign_last_frame(l.then("search last frame"));
          l.join(s.result_branch());
          s.optimize_last(l.then("pose last frame"));
        });
    s.refine_partners(line.then("stereo"));
  }
}

/// The same as queue_odometry_motion() of a frame whose features were prefetched.
template <typename Line, typename Stages>
void queue_prefetched_motion(Line& line, Stages& s) {
  s.watch_images(line.fork(s.result_branch()));
  queue_prediction(line.then("motion"), s);
  if (s.rolls()) {
    queue_moved_last_frame(line, s);
    return;
  }
  queue_last_frame(line, s);
  if constexpr (Stages::has_partners) { s.refine_partners(line.then("stereo")); }
}

/// The same of a frame whose features the caller gives. There are no images.
template <typename Line, typename Stages>
void queue_given_motion(Line& line, Stages& s) {
  using part = typename Stages::part_type;
  line.beside(
      s.beginning_branch(), "motion", [&](auto const& exec) { queue_prediction(exec, s); },
      [&](Line& l) { s.launch_parts(l.then("features"), &part::queue_features); });
  if (s.rolls()) { s.move_to_middle_rows(line.then("rolling shutter")); }
  queue_last_frame(line, s);
}

/// A frame.
template <typename Line, typename Stages>
void queue_odometry(Line& line, Stages& s, frame_extent extent) {
  using part = typename Stages::part_type;
  bool const parts = s.parts_launch();
  if (extent == frame_extent::given) { queue_given_motion(line, s); }
  if constexpr (describes_images) {
    if (extent == frame_extent::whole) { queue_odometry_motion(line, s); }
    if (extent == frame_extent::prefetched) { queue_prefetched_motion(line, s); }
  }
  s.search_without_window(line.then("pose last frame"));
  if (s.rolls()) { s.move_again(line.then("rolling shutter")); }
  s.plan_search(line.then("update local map"));
  s.choose_local(line.then("update local map"));
  s.list_local_map(line.then("search local map"));
  auto const branch = line.fork(s.result_branch());
  s.pack_keypoints(branch);
  s.pack_depths(branch);
  s.count_chances(branch);
  s.assign_local_map(line.then("search local map"));
  if (s.aligns()) { s.align_matches(line.then("search local map")); }
  s.optimize_local(line.then("pose local map"));
  line.join(s.result_branch());  // its stages read depths and points, which those below write
  s.split_motions(line.then("pose local map"));
  if (parts) {
    s.launch_parts(line.then("pose local map"), &part::after_pose);
    s.launch_parts(line.fork(s.part_branch()), &part::beside_decision);
  }
  if constexpr (Stages::starts_from_motion) { s.look_for_start(line.then("start")); }
  s.judge(line.then("result"));
  s.weigh(line.with("result"));
  if (parts) { s.launch_parts(line.then("result"), &part::before_outputs); }
  s.pack_outputs(line.then("result"));
  s.count_points(line.with("keyframe"));
  if constexpr (Stages::starts_from_motion) {
    s.insert_first(line.then("keyframe"));
    s.triangulate(line.then("keyframe"));
  }
  s.insert(line.then("keyframe"));
  if constexpr (Stages::starts_from_motion) { s.enter_new_points(line.then("keyframe")); }
  if (parts) { s.launch_parts(line.fork(s.part_branch()), &part::beside_window); }
  s.gather(line.then("keyframe"));
  if (parts) { s.launch_parts(line.fork(s.part_branch()), &part::beside_result); }
  s.keep_counts(line.then("keyframe"));
  s.pack_matches(line.then("keyframe"), s.outcome_of_local());
  if (parts) { line.join(s.part_branch()); }
  line.end();
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
