// SPDX-License-Identifier: Apache-2.0
/// @file Frames of the stand-in types made in the order in which ORB-SLAM3's constructors give
/// values to the members: what a step reads must have been written by one before it.
#pragma once

#include <cstddef>
#include <cstring>
#include <functional>

#include "tests/integration/orbslam3/stand_in.hpp"

namespace stand_in {

enum class sensor { stereo, rgbd, monocular, fisheye_stereo, fisheye_monocular };

/// The steps of a constructor that are the CPU's or the shim's.
struct steps {
  std::function<void(frame&)> calibrate;  ///< mK and mDistCoef; by default there is no distortion
  std::function<void(frame&)> features;   ///< keypoints, descriptors, monoLeft, monoRight
  std::function<void(frame&)> undistort;  ///< mvKeysUn; by default the keypoints as they are
  std::function<void(frame&)> stereo;     ///< none for monocular
  std::function<void(frame&)> grid;       ///< mGrid, mGridRight; by default they stay empty
};

/// "Set no stereo fisheye information", which is done last.
inline void set_no_pair(frame& f) {
  f.Nleft = f.Nright = -1;
  f.monoLeft = f.monoRight = -1;
}
/// cv::vconcat of both images' descriptors.
inline matrix joined(matrix const& above, matrix const& below) {
  matrix all;
  all.create(above.rows + below.rows, 32, 0);
  auto const bytes = [](matrix const& m) { return static_cast<std::size_t>(m.rows) * 32; };
  if (above.rows > 0) { std::memcpy(all.data, above.data, bytes(above)); }
  if (below.rows > 0) { std::memcpy(all.data + bytes(above), below.data, bytes(below)); }
  return all;
}

inline frame construct(sensor kind, unsigned long id, steps const& by) {
  frame f;
  f.mnId = id;
  if (by.calibrate) { by.calibrate(f); }
  by.features(f);
  auto const undistort = [&] {
    f.mvKeysUn = f.mvKeys;
    if (by.undistort) { by.undistort(f); }
  };
  if (kind == sensor::fisheye_stereo) {
    f.Nleft = static_cast<int>(f.mvKeys.size());
    f.Nright = static_cast<int>(f.mvKeysRight.size());
    f.N = f.Nleft + f.Nright;
    by.stereo(f);
    f.mDescriptors = joined(f.mDescriptors, f.mDescriptorsRight);
  } else {
    f.N = static_cast<int>(f.mvKeys.size());
    undistort();
    if (by.stereo) {
      by.stereo(f);
    } else {
      f.mvuRight.assign(f.mvKeys.size(), -1.0f);
      f.mvDepth.assign(f.mvKeys.size(), -1.0f);
      f.mnCloseMPs = 0;
    }
  }
  f.mvpMapPoints.assign(static_cast<std::size_t>(f.N), nullptr);
  f.mvbOutlier.assign(static_cast<std::size_t>(f.N), false);
  f.mnMaxX = 640;  // of the first frame; static in the original
  f.mnMaxY = 480;
  auto const grid = [&] {
    if (by.grid) { by.grid(f); }
  };
  if (kind == sensor::fisheye_stereo) {
    grid();
    undistort();
  } else {
    set_no_pair(f);
    grid();
  }
  return f;
}

}  // namespace stand_in
