// SPDX-License-Identifier: Apache-2.0
/// @file The parts of a pair whose images are rectified first.
#pragma once

#include "ft/cameras/distorted_pair.hpp"
#include "ft/cameras/image_domain.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/remap_table.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/images/build_remap.hpp"
#include "ft/kernels/images/rectify.hpp"
#include "ft/kernels/images/undistort.hpp"
#include "ft/kernels/upload.hpp"
#include "ft/pipelines/detail/extraction.hpp"
#include "ft/pipelines/detail/rig_parts.hpp"
#include "ft/pipelines/stereo_matcher.hpp"
#include "ft/types/images.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The raw images of the next frame of a batch of pairs, and their rectification.
template <typename Exec, typename Left, typename Right>
class rig_input<Exec, distorted_pair<Left, Right>> {
  using rig_type = distorted_pair<Left, Right>;

public:
  using images_type = stereo_images;
  static constexpr bool overlaps_pyramid = false;  ///< rectification needs rows from anywhere

  rig_input() = default;
  /// @param geometry of the rectified images' pyramids
  /// @throws bad_argument for a lens that does not fit its image, as require_invertible; a quarter
  /// of
  ///   the pixels must have a ray
  rig_input(Exec const& exec, rig_type const& rig, pyramid_geometry const& geometry, int batch) {
    int const width = rig.width > 0 ? rig.width : geometry.width[0];
    int const height = rig.height > 0 ? rig.height : geometry.height[0];
    require_invertible(rig.left, width, height, 0.25);
    require_invertible(rig.right, width, height, 0.25);
    images_ = frame_images<Exec>(pyramid_geometry::make(width, height, 1, 2.0f), {0, 2}, batch);
    raw_ = image_pyramid<Exec::space>(pyramid_geometry::make(width, height, 1, 2.0f), 2 * batch);
    table_ = remap_table<Exec::space>({geometry.width[0], geometry.height[0], width, height}, 2);
    auto const& wanted = rig.target.camera;
    build_remap(exec, rig.left, rig.R_left.transposed(), wanted, table_.view(), 0);
    build_remap(exec, rig.right, rig.R_right.transposed(), wanted, table_.view(), 1);
  }

  frame_images<Exec> const& images() const { return images_; }
  /// @throws bad_argument for an image that is null or of another size
  void take(int b, stereo_images const& given) {
    for (int i = 0; i < 2; ++i) { images_.take(b, i, given[i]); }
  }
  /// Enqueues the copy of the images, and their rectification into level 0 of the pyramids.
  void upload(Exec const& exec, extraction<Exec> const& to) const {
    receive_images(exec, images_.sources(), raw_.view());
    rectify(with_order(exec, launch_order::serial), level_images(raw_.view(), 0), table_.view(),
            level_images(to.pyramid, 0));
  }

  allocated_bytes allocated() const {
    return images_.allocated() + allocated_bytes{raw_.bytes() + table_.bytes(), 0};
  }

private:
  frame_images<Exec> images_;
  image_pyramid<Exec::space> raw_;  ///< [batch][2] of one level
  remap_table<Exec::space> table_;  ///< left, right
};

template <typename Left, typename Right>
struct rig_parts<distorted_pair<Left, Right>> : rig_parts<rectified_rig> {
  using rig_type = distorted_pair<Left, Right>;
  template <typename Exec>
  using input = rig_input<Exec, rig_type>;

  static rectified_rig const& searched(rig_type const& rig) { return rig.target; }
  static absent_images absent(rig_type const&) { return {}; }
  template <typename Exec>
  static stereo_matcher<Exec> make_matcher(rig_type const& rig,
                                           orb_extractor<Exec> const& extractor,
                                           input<Exec> const&) {
    return {rig.target, extractor, column_rule::least_squares};
  }
  static image_bounds bounds(rig_type const& rig, int width, int height) {
    return rig_parts<rectified_rig>::bounds(rig.target, width, height);
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
