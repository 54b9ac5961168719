// SPDX-License-Identifier: Apache-2.0
/// @file The shim's settings from the members of ORB-SLAM3's Tracking, in one call.
#pragma once

#include <string>

#include "ft/core/error.hpp"
#include "integration/orbslam3/conversions.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft {
namespace orbslam3 {

/// A system's types, for the template parameter `Types` of the shim.
template <typename Frame, typename MapPoint, typename FisheyeCamera>
struct types_of {
  using frame = Frame;
  using map_point = MapPoint;
  using fisheye_camera = FisheyeCamera;
};

/// The arguments that Tracking gives to the constructor of ORBextractor, in the same order.
struct extractor_parameters {
  int features = 0;
  float scale_factor = 0;
  int levels = 0;
  int ini_threshold = 0;
  int min_threshold = 0;
  std::string vocabulary = {};  ///< the file given to System, for front_end; empty: none
};

/// System::eSensor without the inertial variants; Tracking keeps it as mSensor.
enum class sensor_kind { monocular, stereo, rgbd };

/// @throws bad_argument for a number other than the six
inline sensor_kind sensor_of(int number) {
  detail::require_range("sensor", number, 0, 5);  // the inertial ones follow in the same order
  return static_cast<sensor_kind>(number % 3);
}

/// Tracking's mpCamera, mpCamera2 and mTlr. The last two are used only for two fisheye cameras.
template <typename Camera, typename Pose>
struct tracking_cameras {
  Camera* left;
  Camera* right;
  Pose const& T_lr;  ///< right camera to left

  tracking_cameras(Camera* a, Camera* b, Pose const& b_to_a) : left(a), right(b), T_lr(b_to_a) {}
};

/// @param image the first one, for its size
/// @param sensor System::eSensor as a number
/// @param bf Tracking's mbf, unused for monocular
/// @tparam Types with fisheye_camera: ORB_SLAM3::KannalaBrandt8
/// @throws bad_argument
template <typename Types, typename Image, typename Camera, typename Pose>
settings settings_of(extractor_parameters const& features, int sensor, Image const& image, float bf,
                     tracking_cameras<Camera, Pose> const& cameras) {
  detail::require(cameras.left != nullptr, "there is no camera yet");
  settings s;
  s.width = image.cols;
  s.height = image.rows;
  s.features = features.features;
  s.scale_factor = features.scale_factor;
  s.levels = features.levels;
  s.ini_threshold = features.ini_threshold;
  s.min_threshold = features.min_threshold;
  s.left = parameters_of(*cameras.left);
  sensor_kind const kind = sensor_of(sensor);
  s.images = kind == sensor_kind::stereo ? 2 : 1;
  if (kind == sensor_kind::monocular) {
    s.most_keypoints =
        6 * features.features;  // initial frames, extracted by the CPU, have five times as many
    return s;
  }
  s.bf = bf;
  if (kind == sensor_kind::rgbd || s.left.kind == lens::pinhole) { return s; }
  detail::require(cameras.right != nullptr, "a fisheye pair needs its second camera");
  s.right = parameters_of(*cameras.right);
  s.T_rl = transform_of(cameras.T_lr.inverse());
  for (int i = 0; i < 2; ++i) {
    auto const& fisheye =
        static_cast<typename Types::fisheye_camera const&>(i == 0 ? *cameras.left : *cameras.right);
    for (unsigned end = 0; end < 2; ++end) {
      s.overlap[i][end] = static_cast<float>(fisheye.mvLappingArea.at(end));
    }
  }
  return s;
}

}  // namespace orbslam3
}  // namespace ft
