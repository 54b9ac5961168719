// SPDX-License-Identifier: Apache-2.0
/// @file The first stages of a frame of an odometry, on its memory.
#pragma once

#include <utility>

#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/recording.hpp"
#include "ft/kernels/map/apply_window.hpp"
#include "ft/kernels/odometry/begin_frame.hpp"
#include "ft/kernels/odometry/fixed_keypoints.hpp"
#include "ft/kernels/odometry/image_changes.hpp"
#include "ft/kernels/stereo/refine_partners.hpp"
#include "ft/pipelines/detail/frame_features.hpp"
#include "ft/pipelines/detail/frame_stages.hpp"
#include "ft/pipelines/detail/odometry_memory.hpp"
#include "ft/pipelines/detail/odometry_packing.hpp"
#include "ft/pipelines/detail/rolling_parts.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The stages of a frame beside images and keypoints, and before what searches. All are
/// asynchronous on their executor and allocate nothing.
template <typename Exec, typename Rig>
class odometry_first_stages : public frame_stages<Exec, Rig> {
  using base = frame_stages<Exec, Rig>;

public:
  using base::memory;

  odometry_params settings;
  odometry_memory<Exec> own;
  typename rig_parts<Rig>::template input<Exec> input;

  side_branch<Exec>& beginning_branch() { return beginning_branch_; }
  void read_inputs(Exec const& exec) const { read_odometry_inputs(exec, own.inputs, own.state); }
  void apply_adjustment(Exec const& exec) const {
    apply_window(exec, own.state.apply, own.window, own.sources, own.map, own.state.T_cw);
  }
  void predict(Exec const& exec) const {
    predict_frames(exec, own.inputs, settings.rules, own.state, predictions());
  }
  /// Images alone: the other inputs come with read_inputs().
  void upload_part(Exec const& exec, extraction<Exec> const& to, bool /*with_local*/) const {
    input.upload(exec, to);
  }
  void upload(Exec const& exec, bool with_local) const {
    upload_part(exec, this->extractor.stages(), with_local);
  }
  /// A rectification needs all images.
  int parts() const { return input.overlaps_pyramid ? base::parts() : 1; }
  bool pyramid_overlaps_upload() const {
    return input.overlaps_pyramid && base::pyramid_overlaps_upload();
  }

  /// The frame's features, and memory of its images, change places with others.
  void exchange_features(frame_features<Exec, Rig>& other) {
    std::swap(input, other.input);
    std::swap(this->extractor, other.extractor);
    std::swap(this->matcher, other.matcher);
    std::swap(memory.frame.grids, other.grids);
    std::swap(grid_memory_, other.grid_memory);
    std::swap(features_graph_, other.graph);
    std::swap(features_number_, other.number);
    this->point_frame_at_features();
  }

  /// Which set of features they are; 0 without others.
  int features_number() const { return features_number_; }

  /// Of two cameras that are not rectified, after match_stereo().
  void refine_partners(Exec const& exec) const {
    if constexpr (is_mixed_v<Rig>) {
      this->matcher.refine_partners(exec, this->extractor);
    } else {
      ft::refine_partners(exec, this->rig, this->extractor.pyramid(), this->extractor.keypoints(),
                          this->matcher.fisheye_matches());
    }
  }
  static constexpr bool has_partners = !base::rectified || is_mixed_v<Rig>;

  // ---- rolling shutters

  rolling_keypoints<Exec, Rig> rolling;
  bool rolls() const { return rolling.present(); }
  void find_velocities(Exec const& exec) const {
    rolling.find_velocities(exec, own.inputs, own.state);
  }
  /// After the first pose, whose motion is that of the frame, and which tells the depths of matched
  /// keypoints that have none of their own: three launches.
  void move_again(Exec const& exec) const {
    first_poses const first{memory.poses, memory.observations.inliers,
                            settings.rules.min_motion_inliers};
    rolling.refine_velocities(exec, first, own.state);
    move_to_middle_rows(exec, memory.frame.keypoints, {memory.map, first});
  }
  /// After depths and partners, before what searches: two launches.
  void move_to_middle_rows(Exec const& exec) const {
    move_to_middle_rows(exec, this->unmoved_keypoints(), {});
  }
  /// @param from keypoints where they are
  void move_to_middle_rows(Exec const& exec, keypoints_view const& from,
                           held_depths const& held) const {
    typename rolling_keypoints<Exec, Rig>::template frames<typename base::searched_rig> in{};
    in.rig = this->rig;
    in.geometry = this->geometry();
    in.frame = memory.frame;
    in.frame.keypoints = from;
    in.raw = this->extractor.keypoints();
    // The matcher's own memory: nothing else reads it at that time.
    in.depth = const_cast<float*>(this->matcher.depth());
    in.right_x = const_cast<float*>(memory.frame.right_x);
    in.point = this->matcher.fisheye_matches().point;
    in.held = held;
    if constexpr (is_mixed_v<Rig>) { in.frame.partner = this->matcher.partners(); }
    rolling.move(exec, in);
  }

  predicted_frames predictions() const {
    return {memory.motion.device.predicted, memory.last.T_cw, memory.motion.device.stamp};
  }

  // ---- how images change, and depths

  /// Beside the frame's features.
  void watch_images(Exec const& exec) const {
    image_pyramid_view const images = this->extractor.pyramid();
    ft::watch_images(exec, images, own.changes);
    for_each_item<per_thread>(exec, own.state.batch, pack_changes{}, own.changes, images_of_rig(),
                              images.absent, own.seen);
  }
  /// Beside the search from the last frame, after watch_images().
  void mark_fixed(Exec const& exec) const {
    mark_fixed_keypoints(exec, {memory.frame, this->extractor.keypoints(), this->geometry(),
                                own.changes, fixed_disparity_, own.fixed});
  }
  /// Beside the search in the local map.
  void pack_depths(Exec const& exec) const {
    depths_of_frames in{memory.frame, this->matcher.depth(), row_facts_of(this->matcher),
                        memory.result.depth_cameras};
    in.distant = (this->rig.baseline_length() * distant_baselines).value;
    for_each_item<per_block<256>>(exec, own.state.batch, detail::pack_depths{}, in, own.seen);
  }

protected:
  int images_of_rig() const { return this->extractor.pyramid().batch / this->batch; }

  arena<Exec::space> grid_memory_;  ///< empty while the frame's grids are the first ones
  recording<Exec> features_graph_;
  int features_number_ = 0;
  float fixed_disparity_ = 0;  ///< of mark_fixed_keypoints()
  side_branch<Exec> beginning_branch_;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
