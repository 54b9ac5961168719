// SPDX-License-Identifier: Apache-2.0
/// @file A keyframe and a frame of a random scene.
#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>

#include "ft/containers/image_pyramid.hpp"
#include "integration/orbslam3/frame_fields.hpp"
#include "integration/orbslam3/plain_types.hpp"
#include "tests/integration/orbslam3/constructors.hpp"
#include "tests/integration/orbslam3/plain_words.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"

namespace orbslam3_test {

/// A scene whose last frame is the keyframe; two cameras have both images' descriptors in one
/// matrix, as ORB-SLAM3's have after the frame's constructor.
struct two_views {
  static constexpr int up = 2;  ///< levels of a vocabulary above its deepest one

  std::shared_ptr<scene> made;
  scene& world;
  ft::orbslam3::settings settings;
  stand_in::frame frame;
  stand_in::key_frame keyframe;

  explicit two_views(sensor kind, unsigned seed = 3)
      : made(std::make_shared<scene>(kind, seed, 500)), world(*made) {
    settings = world.settings;
    settings.most_keypoints = 2000;
    settings.levels_up = up;
    for (auto* const f : {&world.last, &world.current}) {
      if (f->Nleft >= 0) {
        f->mDescriptors = stand_in::joined(f->mDescriptors, f->mDescriptorsRight);
      }
    }
    frame = world.current;
    keyframe = keyframe_of(world.last);
  }
  void transform(plain_words const& by) {
    by.transform(frame, settings.levels_up);
    by.transform(keyframe, settings.levels_up);
  }
};

/// Its frame is to be relocalised with the keyframe.
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
