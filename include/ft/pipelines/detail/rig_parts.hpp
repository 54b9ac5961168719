// SPDX-License-Identifier: Apache-2.0
/// @file What of an odometry depends on the kind of its rig: how images come in, and how keypoints
/// get their depth.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/cameras/multi_rig.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/images/undistort.hpp"
#include "ft/kernels/keypoints/order.hpp"
#include "ft/pipelines/detail/extraction.hpp"
#include "ft/pipelines/detail/frame_images.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "ft/pipelines/stereo_matcher.hpp"
#include "ft/types/images.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The images of the next frame of a batch of rigs, used as they are.
template <typename Exec, typename Rig>
class rig_input {
public:
  using images_type = std::conditional_t<Rig::images == 2, stereo_images, rig_images<Rig::images>>;
  /// Whether pyramids may be computed while images still arrive.
  static constexpr bool overlaps_pyramid = true;

  rig_input() = default;
  rig_input(Exec const&, Rig const& rig, pyramid_geometry const& geometry, int batch)
      : images_(geometry, absent_images_of(rig), batch) {}

  frame_images<Exec> const& images() const { return images_; }
  allocated_bytes allocated() const { return images_.allocated(); }
  /// @throws bad_argument for an image that is null or of another size; of a rig of several cameras
  ///   null means that the camera has none
  void take(int b, images_type const& given) {
    if constexpr (Rig::images > 2) {
      take_some(images_, b, Rig::images, given);
    } else {
      for (int i = 0; i < Rig::images; ++i) {
        if (!images_.absent(images_.number(b, i))) { images_.take(b, i, given[i]); }
      }
    }
  }
  /// Enqueues the copy of the images into level 0 of the pyramids.
  void upload(Exec const& exec, extraction<Exec> const& to) const {
    to.upload(exec, images_.sources(), {}, {});
  }

private:
  frame_images<Exec> images_;
};

/// Depth images that cameras of rig b miss in the frame that was taken, see
/// tracking::missing_depths.
template <typename Input>
std::uint32_t missing_depths_of(Input const&, int /*b*/) {
  return 0;
}

/// The parts of a rig. This one is that of the rigs whose images are searched as they come.
template <typename Rig>
struct rig_parts {
  using searched_rig = Rig;  ///< what searches, poses and adjustments know of the rig
  template <typename Exec>
  using input = rig_input<Exec, Rig>;
  template <typename Exec>
  using matcher = stereo_matcher<Exec, Rig>;
  /// Whether keypoints are moved before they are searched.
  static constexpr bool undistorts = false;
  /// Whether keypoints lie between pixels.
  static constexpr bool refines_positions = true;
  /// Of pose_params.
  static constexpr double disparity_weight = 0;
  /// Whether maps begin from the motion of the camera.
  static constexpr bool starts_from_motion = false;

  static Rig const& searched(Rig const& rig) { return rig; }
  static absent_images absent(Rig const& rig) { return absent_images_of(rig); }
  template <typename Exec>
  static matcher<Exec> make_matcher(Rig const& rig, orb_extractor<Exec> const& extractor,
                                    input<Exec> const&) {
    return {rig, extractor, column_rule::least_squares};
  }
  /// Where the search may find keypoints, pixels.
  static image_bounds bounds(Rig const&, int width, int height) {
    return {0, 0, static_cast<float>(width), static_cast<float>(height)};
  }
};

/// The grids that are filled while keypoints are ordered.
template <typename Exec, typename Rig>
keypoint_grids<Rig::rectified> grids_of(stereo_matcher<Exec, Rig> const& matcher,
                                        feature_grid_view const& cells) {
  return {cells, matcher.right_rows()};
}

/// Null but of rigs whose depths are all those of rectified pairs.
template <typename Exec, typename Rig>
row_facts row_facts_of(stereo_matcher<Exec, Rig> const& matcher) {
  return matcher.rows();
}
template <typename Matcher>
row_facts row_facts_of(Matcher const&) {
  return {};
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
