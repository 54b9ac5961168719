// SPDX-License-Identifier: Apache-2.0
/// @file The parts of an RGB-D rig.
#pragma once

#include <cstddef>
#include <type_traits>

#include "ft/cameras/rgbd_rig.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/images/depth_association.hpp"
#include "ft/kernels/images/undistort.hpp"
#include "ft/kernels/keypoints/order.hpp"
#include "ft/pipelines/detail/depth_input.hpp"
#include "ft/pipelines/detail/frame_images.hpp"
#include "ft/pipelines/detail/frame_memory.hpp"
#include "ft/pipelines/detail/rig_parts.hpp"
#include "ft/types/images.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The images of the next frame of a batch of RGB-D cameras.
template <typename Exec, typename Camera>
class rig_input<Exec, rgbd_rig<Camera>> {
public:
  using images_type = rgbd_images;
  static constexpr bool overlaps_pyramid = true;

  rig_input() = default;
  rig_input(Exec const&, rgbd_rig<Camera> const& rig, pyramid_geometry const& geometry, int batch)
      : scaled_(rig.depth_scale != 0),
        images_(geometry, {0, 1}, batch),
        depths_(geometry.width[0], geometry.height[0], batch, batch) {}

  frame_images<Exec> const& images() const { return images_; }
  depth_sources_view depths() const { return depths_.view(); }
  /// @throws bad_argument for an image that is null or of another size
  void take(int b, rgbd_images const& given) {
    depths_.require_depth(given.depth, scaled_);
    images_.take(b, 0, given.gray);
    depths_.take(b, b, given.depth);
  }
  /// Enqueues the copy of the images, and of the places of the depth images.
  void upload(Exec const& exec, extraction<Exec> const& to) const {
    to.upload(exec, images_.sources(), depths_.source(), {});
  }

  allocated_bytes allocated() const { return images_.allocated() + depths_.allocated(); }

private:
  bool scaled_ = false;  ///< the unit of depth images is known
  frame_images<Exec> images_;
  depth_input<Exec> depths_;
};

/// Depths and virtual right columns of the keypoints of RGB-D cameras: a stereo_matcher of theirs.
template <typename Exec, typename Camera>
class depth_matcher {
public:
  static constexpr bool undistorts = !std::is_same<Camera, pinhole<float>>::value;

  depth_matcher() = default;
  depth_matcher(rgbd_rig<Camera> const& rig, orb_extractor<Exec> const& extractor,
                depth_sources_view const& depths)
      : rig_(rig), depths_(depths) {
    params_.bf = rig.pair().bf();
    params_.scale = rig.depth_scale != 0 ? rig.depth_scale : 1;
    params_.min_depth = rig.min_depth;
    params_.max_depth = rig.max_depth;
    memory_ = owner<memory, Exec::space>([&](carver& c, memory& m) {
      carve(c, m.matches, extractor.capacity(), extractor.batch());
      if (undistorts) { carve(c, m.undistorted, extractor.capacity(), extractor.batch()); }
    });
  }

  void match_sorted(Exec const& exec, orb_extractor<Exec> const& extractor) const {
    pixels_view const raw = extractor.keypoints();
    associate_depth(exec, raw, undistorts ? memory_->undistorted : raw, depths_, params_,
                    memory_->matches);
  }
  /// Moves keypoints to where the undistorted camera sees them, and sorts them into grids.
  void undistort(Exec const& exec, orb_extractor<Exec> const& extractor,
                 feature_grid_view const& cells) const {
    undistort_keypoints(exec, rig_.camera, rig_.undistorted(), extractor.keypoints(),
                        {memory_->undistorted, nullptr});
    build_grid<nearest_cell>(exec, keypoints(extractor), 0, 1, extractor.batch(), cells);
  }
  /// The keypoints that are searched.
  keypoints_view keypoints(orb_extractor<Exec> const& extractor) const {
    keypoints_view const raw = extractor.keypoints();
    return undistorts ? with_columns(raw, memory_->undistorted) : raw;
  }
  std::size_t bytes() const { return memory_.bytes(); }  ///< of executor memory
  depth_params const& params() const { return params_; }
  stereo_matches_view matches() const { return memory_->matches; }
  float const* depth() const { return array_of<field::depth>(memory_->matches); }
  static fisheye_matches_view fisheye_matches() { return {}; }

private:
  struct memory {
    stereo_matches_view matches;
    pixels_view undistorted;
  };
  rgbd_rig<Camera> rig_{};
  depth_sources_view depths_;
  depth_params params_;
  owner<memory, Exec::space> memory_;
};

template <typename Exec, typename Camera>
auto grids_of(depth_matcher<Exec, Camera> const&, feature_grid_view const& cells) {
  if constexpr (depth_matcher<Exec, Camera>::undistorts) {
    static_cast<void>(cells);
    return no_grids{};
  } else {
    return keypoint_grids<false>{cells, {}};
  }
}

template <typename Camera>
struct rig_parts<rgbd_rig<Camera>> {
  using searched_rig = rectified_rig;
  template <typename Exec>
  using input = rig_input<Exec, rgbd_rig<Camera>>;
  template <typename Exec>
  using matcher = depth_matcher<Exec, Camera>;
  static constexpr bool undistorts = matcher<host_exec>::undistorts;
  static constexpr bool refines_positions = true;
  /// A depth is as exact as a quarter of a pixel of disparity where a keypoint moves by a pixel.
  static constexpr double disparity_weight = 16;
  static constexpr bool starts_from_motion = false;

  static rectified_rig searched(rgbd_rig<Camera> const& rig) { return rig.pair(); }
  static absent_images absent(rgbd_rig<Camera> const&) { return {}; }
  template <typename Exec>
  static matcher<Exec> make_matcher(rgbd_rig<Camera> const& rig,
                                    orb_extractor<Exec> const& extractor, input<Exec> const& in) {
    return {rig, extractor, in.depths()};
  }
  static image_bounds bounds(rgbd_rig<Camera> const& rig, int width, int height) {
    if (undistorts) { return undistorted_bounds(rig.camera, rig.undistorted(), width, height); }
    return {0, 0, static_cast<float>(width), static_cast<float>(height)};
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
