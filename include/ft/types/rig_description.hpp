// SPDX-License-Identifier: Apache-2.0
/// @file A rig as passive data, the same in every compiler.
#pragma once

#include <cstddef>
#include <initializer_list>
#include <limits>
#include <string>

#include "ft/core/config.hpp"
#include "ft/types/errors.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace v0 {

enum class camera_kind : int {
  pinhole,
  radtan4,
  radtan5,
  radtan8,
  kannala_brandt,
  double_sphere,
  unified,
  extended_unified,
  field_of_view,
};

/// The camera model as a word, such as "pinhole".
inline char const* name_of(camera_kind kind) {
  constexpr char const* names[] = {"pinhole", "radtan4",          "radtan5",
                                   "radtan8", "kannala_brandt",   "double_sphere",
                                   "unified", "extended_unified", "field_of_view"};
  constexpr int count = sizeof names / sizeof *names;
  static_assert(count == static_cast<int>(camera_kind::field_of_view) + 1, "one a model");
  int const i = static_cast<int>(kind);
  return i >= 0 && i < count ? names[i] : "unknown";
}

constexpr int most_cameras = 16;            ///< of a rig
constexpr int most_camera_parameters = 16;  ///< of a camera

struct camera_description {
  camera_kind kind = camera_kind::pinhole;
  /// fx, fy, cx, cy, then the model's other parameters in its own order; pixels. What is not given
  /// is 0.
  double parameters[most_camera_parameters] = {};
  double baseline = 0;  ///< of the left camera of a rectified pair, metres; 0 = a single camera
  rigid<double> T_camera_body = rigid<double>::identity();  ///< metres
  int right = -1;  ///< of a multi rig: number of the right camera of its pair; -1 = none
  bool has_depth_image = false;  ///< of a multi rig; `baseline` is that of its virtual pair
  /// Of a rolling shutter: seconds from the exposure of the first row to that of the last one, 0 to
  /// 0.1; 0 = a global shutter. Both cameras of a pair have the same, but in a multi rig. The time
  /// of a frame is then that of the image's middle row, and so is the pose: keypoints are moved to
  /// where they would be seen at that time, by the motion since the last frame. Stamps of the first
  /// row are half a read-out early; add it.
  double readout_s = 0;

  /// @throws bad_argument for more than 16 numbers
  static camera_description make(camera_kind kind, std::initializer_list<double> parameters) {
    if (parameters.size() > static_cast<std::size_t>(most_camera_parameters)) {
      throw bad_argument("ft: a camera has " + std::to_string(parameters.size()) +
                         " parameters, must have at most " +
                         std::to_string(most_camera_parameters));
    }
    camera_description c;
    c.kind = kind;
    double* to = c.parameters;
    for (double const v : parameters) { *to++ = v; }
    return c;
  }
};

enum class rig_kind : int {
  rectified_pair,  ///< rectified_rig
  distorted_pair,  ///< distorted_pair
  fisheye_pair,    ///< stereo_rig
  rgbd,            ///< rgbd_rig
  monocular,       ///< monocular_rig
  multi,           ///< multi_rig; mixed_rig if its cameras are not all pinholes or pairs of them
};

/// The kind as a word, such as "rectified_pair".
inline char const* name_of(rig_kind kind) {
  constexpr char const* names[] = {"rectified_pair", "distorted_pair", "fisheye_pair",
                                   "rgbd",           "monocular",      "multi"};
  constexpr int count = sizeof names / sizeof *names;
  static_assert(count == static_cast<int>(rig_kind::multi) + 1, "one a kind");
  int const i = static_cast<int>(kind);
  return i >= 0 && i < count ? names[i] : "unknown";
}

/// A rig of any kind; see the type named with each kind. A pair that is not rectified has two
/// cameras, the left one first, which is the body: its T_camera_body is the identity. Other kinds
/// but multi have one camera.
struct rig_description {
  rig_kind kind = rig_kind::rectified_pair;
  int cameras = 1;
  camera_description camera[most_cameras];
  double rectified[4] = {};  ///< distorted_pair: fx, fy, cx, cy of both rectified cameras
  int raw_width = 0;         ///< distorted_pair: of its images, if not as odometry_params::orb
  int raw_height = 0;        ///< likewise
  double depth_scale = 0;    ///< rgbd, multi: metres per unit; 0 = depth images are float, metres
  double min_depth = 0;      ///< likewise, metres; smaller depths are none
  double max_depth = std::numeric_limits<double>::infinity();  ///< likewise; larger ones, too

  /// @param baseline metres
  static rig_description rectified_pair(double fx, double fy, double cx, double cy,
                                        double baseline) {
    return single(rig_kind::rectified_pair,
                  camera_description::make(camera_kind::pinhole, {fx, fy, cx, cy}), baseline);
  }
  static rig_description monocular(camera_description const& camera) {
    return single(rig_kind::monocular, camera, 0);
  }
  /// @param baseline of the virtual pair, metres @param depth_scale metres per unit
  static rig_description rgbd(camera_description const& camera, double baseline,
                              double depth_scale = 0) {
    rig_description rig = single(rig_kind::rgbd, camera, baseline);
    rig.depth_scale = depth_scale;
    return rig;
  }
  /// @param T_right_left left-camera points to the right camera, metres
  static rig_description fisheye_pair(camera_description const& left,
                                      camera_description const& right,
                                      rigid<double> const& T_right_left) {
    rig_description rig = single(rig_kind::fisheye_pair, left, 0);
    rig.cameras = 2;
    rig.camera[1] = right;
    rig.camera[1].T_camera_body = T_right_left;
    return rig;
  }

private:
  static rig_description single(rig_kind kind, camera_description const& camera, double baseline) {
    rig_description rig;
    rig.kind = kind;
    rig.camera[0] = camera;
    rig.camera[0].baseline = baseline;
    return rig;
  }
};

}  // namespace v0
}  // namespace ft
