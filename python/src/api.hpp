// SPDX-License-Identifier: Apache-2.0
/// @file What the bindings call, in plain types: units of the C++ compiler and of nvcc implement it
/// for their executors. Arrays are row-major; metres, pixels, nanoseconds.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ft/pipelines/explain.hpp"
#include "ft/pipelines/tracking_warnings.hpp"
#include "ft/types/errors.hpp"
#include "ft/types/images.hpp"
#include "ft/types/orb_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/rig_description.hpp"
#include "ft/types/tracking.hpp"

namespace ftpy {

/// A mistake of the caller: ValueError.
struct argument_error : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// fx, fy, cx, cy and 0, 4, 5 or 8 coefficients in OpenCV's order become 12 numbers: the others are
/// 0. @param of whose they are, for a message @throws argument_error for another number of them
inline void complete_radtan(std::vector<double>& values, std::string const& of) {
  std::size_t const n = values.size();
  if (n != 4 && n != 8 && n != 9 && n != 12) {
    throw argument_error(of + " has " + std::to_string(n) +
                         " parameters, must have 4, 8, 9 or 12: fx, fy, cx, cy, then k1, k2, p1, "
                         "p2, then k3, then k4, k5, k6");
  }
  values.resize(12);
}

/// The parameters of a camera whose model has `most`. Distortion may be left out, and is 0 then.
/// @throws argument_error for another number of them
inline void complete(std::vector<double>& values, std::size_t most, std::string const& which) {
  if (most == 12) { complete_radtan(values, "the " + which + " camera"); }
  if (values.size() != 4 && values.size() != most) {
    throw argument_error("the " + which + " camera has " + std::to_string(values.size()) +
                         " parameters, must have 4" +
                         (most > 4 ? " or " + std::to_string(most) : ": fx, fy, cx, cy"));
  }
  values.resize(most);
}

/// Grey, 8 bits.
struct image {
  std::uint8_t const* data = nullptr;
  int width = 0, height = 0, stride = 0;
};
struct depth_image {
  void const* data = nullptr;
  int width = 0, height = 0;
  std::ptrdiff_t pitch = 0;  ///< bytes
  bool is_float = false;     ///< or 16 bits
};
/// A 4 x 4 matrix.
using pose = std::array<double, 16>;

/// A camera of a rig of several: the left one of a rectified pair, of a pair of two cameras, one
/// with depth images, or a single one.
struct rig_camera {
  std::string model;           ///< a word of ft::camera_kind
  std::vector<double> camera;  ///< fx, fy, cx, cy, and the model's other parameters
  double baseline = 0;
  int right = -1;          ///< number of the right camera of its pair; -1 = none
  bool has_depth = false;  ///< a depth image; `baseline` is that of its virtual pair
  double readout_s = 0;    ///< as ft::camera_description::readout_s
  pose T_camera_body{};
};
struct rig {
  std::string kind;  ///< rectified, distorted, fisheye, rgbd, monocular, monocular_fisheye, multi
  std::vector<double> left, right;  ///< fx, fy, cx, cy, and the model's other parameters
  std::vector<rig_camera> cameras;  ///< multi
  std::vector<double> wanted;       ///< distorted: fx, fy, cx, cy of both rectified cameras
  pose T_right_left{};
  double baseline = 0;
  double readout_s = 0;                 ///< of all cameras; of a multi rig each has its own
  std::optional<double> depth_scale;    ///< rgbd, multi: metres per unit
  double min_depth = 0, max_depth = 0;  ///< rgbd, multi, metres
  int raw_width = 0, raw_height = 0;    ///< distorted
};

/// How many cameras a rig of several has. @throws argument_error for none, or too many
inline std::size_t cameras_of(rig const& r) {
  std::size_t const n = r.cameras.size();
  if (n < 1 || n > static_cast<std::size_t>(ft::most_cameras)) {
    throw argument_error("the rig has " + std::to_string(n) + " cameras, must have 1 to " +
                         std::to_string(ft::most_cameras));
  }
  return n;
}

/// The rig as make_odometry() takes it. @throws argument_error
ft::rig_description description_of(rig const& r);

struct feature_options {
  int width = 0, height = 0;
  int features = 1200, levels = 8;
  double scale_factor = 1.2;
  int ini_threshold = 20, min_threshold = 7;
  double corner_ratio = 0;
  int mask_width = 0, mask_height = 0;
  bool std_sort = false;  ///< the order of ORB-SLAM3 with libstdc++
  int threads = 0;        ///< of the host; 0 = all
};

/// What f() returns; mistakes of the caller as argument_error.
template <typename F>
auto translated(F&& f) {
  try {
    return f();
  } catch (ft::bad_argument const& e) {
    std::string const text = e.what();
    throw argument_error(text.rfind("ft: ", 0) == 0 ? text.substr(4) : text);
  }
}

inline float narrow(double v) { return static_cast<float>(v); }

inline ft::gray_view to_ft(image const& v) { return {v.data, v.width, v.height, v.stride}; }

inline ft::rigid<double> to_ft(pose const& m) {
  ft::rigid<double> T;
  for (std::size_t r = 0; r < 3; ++r) {
    for (std::size_t c = 0; c < 3; ++c) { T.R.m[3 * r + c] = m[4 * r + c]; }
  }
  T.t = {m[3], m[7], m[11]};
  return T;
}
inline pose from_ft(ft::rigid<double> const& T) {
  pose m{};
  for (std::size_t r = 0; r < 3; ++r) {
    for (std::size_t c = 0; c < 3; ++c) { m[4 * r + c] = T.R.m[3 * r + c]; }
  }
  m[3] = T.t.x;
  m[7] = T.t.y;
  m[11] = T.t.z;
  m[15] = 1;
  return m;
}

inline ft::orb_params orb_params_of(feature_options const& o) {
  ft::orb_params p;
  p.width = o.width;
  p.height = o.height;
  p.features = o.features;
  p.levels = o.levels;
  p.scale_factor = narrow(o.scale_factor);
  p.ini_threshold = o.ini_threshold;
  p.min_threshold = o.min_threshold;
  p.corner_ratio = narrow(o.corner_ratio);
  p.mask_width = o.mask_width;
  p.mask_height = o.mask_height;
  p.ties = o.std_sort ? ft::tie_rule::std_sort : ft::tie_rule::stable;
  return p;
}

/// A frame's result, with what is said of it.
struct tracking {
  ft::tracking of;
  ft::tracking_explanation why;
  std::vector<std::string> imu_warnings;
  std::vector<ft::tracking_notice> warnings;
  std::optional<ft::imu_explanation> imu;  ///< nothing without an IMU
};
/// Empty without a reason.
inline std::string reason_of(tracking const& t) {
  bool const none = t.why.reason == ft::tracking_reason::none;
  return none ? std::string() : ft::name_of(t.why.reason);
}

/// Keypoints of an image.
struct keypoint_arrays {
  std::vector<float> x, y, angle, response;
  std::vector<int> octave;
  std::vector<std::uint8_t> descriptors;  ///< [n][32]
};
struct stereo_arrays {
  keypoint_arrays left, right;
  std::vector<float> right_x, depth;  ///< of the left keypoints, -1 = none
};

class features {
public:
  virtual ~features() = default;
  /// Later calls wait for the work on a CUDA stream so far, which wrote images on the device.
  virtual void wait_for(std::uintptr_t stream) = 0;
  virtual void set_mask(int i, image const& mask) = 0;
  virtual std::vector<keypoint_arrays> extract(std::vector<image> const& images) = 0;
  /// Images 2 b and 2 b + 1 are pair b. Needs a rig
  virtual std::vector<stereo_arrays> match(std::vector<image> const& images) = 0;
  virtual int capacity() const = 0;
};

/// A map of OpenCV's fixed-point form, and how the camera is turned.
struct rectification {
  std::vector<std::int16_t> position;   ///< [height][width][2]
  std::vector<std::uint16_t> fraction;  ///< [height][width]
  std::array<double, 9> R{};            ///< camera to rectified camera
};
struct rectified_image {
  std::uint8_t* data = nullptr;
  int stride = 0;
};

class rectifier {
public:
  virtual ~rectifier() = default;
  virtual void wait_for(std::uintptr_t stream) = 0;  ///< see features
  /// Waits until the pixels are there. @param out on the host, or where the executor works
  virtual void rectify(image const (&given)[2], rectified_image const (&out)[2],
                       std::uint8_t border) = 0;
  /// Memory of the executor for a rectified image.
  virtual std::shared_ptr<std::uint8_t> make_image() const = 0;
  virtual rectification map(int camera) const = 0;
  virtual double baseline() const = 0;
  virtual int device() const = 0;  ///< number of the GPU
};

struct place_options {
  std::string vocabulary;  ///< a file: DBoW2's text form, or ft's binary one
  int keyframes = 5000, features = 2000, levels_up = 4;
};
/// A keyframe that is like the frame.
struct place {
  std::int64_t keyframe = 0;
  double score = 0;
};

class places {
public:
  virtual ~places() = default;
  /// @param descriptors [n][32]
  virtual void describe(std::uint8_t const* descriptors, int n) = 0;
  virtual std::int64_t add(int map) = 0;
  virtual void erase(std::int64_t keyframe) = 0;
  virtual std::vector<place> query(int map) = 0;
  virtual std::vector<std::pair<std::uint32_t, double>> words() const = 0;
  virtual int size() const = 0;
};

// Factories of a device: `host`, and `cuda` where there is one.
#define FTPY_FACTORIES(where)                                                                \
  namespace where {                                                                          \
  std::unique_ptr<features> make_features(feature_options const&, int, rig const&);          \
  std::unique_ptr<rectifier> make_rectifier(rig const&, int width, int height, int threads); \
  std::unique_ptr<places> make_places(place_options const&);                                 \
  }
FTPY_FACTORIES(host)
FTPY_FACTORIES(cuda)
#undef FTPY_FACTORIES

}  // namespace ftpy
