// SPDX-License-Identifier: Apache-2.0
/// @file A frame that is to be relocalised with a keyframe.
#pragma once

#include <algorithm>
#include <cstddef>

#include "ft/containers/image_pyramid.hpp"
#include "integration/orbslam3/frame_fields.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/two_views.hpp"

namespace orbslam3_test {

struct lost_frame : two_views {
  explicit lost_frame(sensor kind, unsigned seed = 3) : two_views(kind, seed) {
    auto const& s = settings;
    ft::orbslam3::fill_scale_tables(
        ft::pyramid_geometry::make(s.width, s.height, s.levels, s.scale_factor), s.scale_factor,
        frame);
  }
  /// Keypoints that hold a point.
  int held() const {
    auto const& all = frame.mvpMapPoints;
    return static_cast<int>(all.size() -
                            static_cast<std::size_t>(std::count(all.begin(), all.end(), nullptr)));
  }
};

}  // namespace orbslam3_test
