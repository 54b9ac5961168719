// SPDX-License-Identifier: Apache-2.0
/// @file What the bindings call, in plain types: units of the C++ compiler and of nvcc implement it
/// for their executors. Arrays are row-major; metres, pixels, nanoseconds.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

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

/// A camera of a rig of several: the left one of a rectified pair or, with a baseline of 0, a
/// single one.
struct rig_camera {
  std::vector<double> camera;  ///< fx, fy, cx, cy
  double baseline = 0;
  pose T_camera_body{};
};
struct rig {
  std::string kind;  ///< rectified, distorted, fisheye, rgbd, monocular, monocular_fisheye, multi
  std::vector<double> left, right;  ///< fx, fy, cx, cy, and the model's other parameters
  std::vector<rig_camera> cameras;  ///< multi
  std::vector<double> wanted;       ///< distorted: fx, fy, cx, cy of both rectified cameras
  pose T_right_left{};
  double baseline = 0;
  std::optional<double> depth_scale;    ///< rgbd: metres per unit
  double min_depth = 0, max_depth = 0;  ///< rgbd, metres
  int raw_width = 0, raw_height = 0;    ///< distorted
};

struct imu {
  pose T_imu_camera{};
  double gyro_noise = 0, accel_noise = 0, gyro_walk = 0, accel_walk = 0, rate_hz = 0;
  double time_offset_s = 0;
};

struct feature_options {
  int width = 0, height = 0;
  int features = 1200, levels = 8;
  double scale_factor = 1.2;
  int ini_threshold = 20, min_threshold = 7;
  int mask_width = 0, mask_height = 0;
  bool std_sort = false;  ///< the order of ORB-SLAM3 with libstdc++
  int threads = 0;        ///< of the host; 0 = all
};

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

struct odometry_options {
  rig of;
  feature_options orb;
  std::optional<imu> inertial;
  int batch = 1;
  double near_depth = 50;
  int map_slots = 1 << 14, keyframes = 128, local_points = 1 << 13;
  int window_moving = 10, window_fixed = 5, window_points = 1 << 12;
  bool measure_stages = false;
};
struct frame_images {
  std::vector<image> grey;  ///< of each camera in turn; of a pair the left one, then the right one
  depth_image depth;        ///< rgbd
};
struct tracking {
  pose T_world_camera{};
  std::string state;
  std::string reason, explanation;  ///< a word and a sentence; empty without
  bool metric = true;
  bool keyframe = false;
  int inliers = 0, keypoints = 0, stereo_points = 0, local_points = 0, left_out = 0;
  int map_points = 0, maps = 0, keyframes = 0;
  std::array<double, 36> covariance{};
  bool imu_known = false, imu_optimized = false;
  bool imu_predicted = false;
  std::array<double, 3> velocity{}, gravity{}, gyro_bias{}, accel_bias{};
  double imu_rate_hz = 0, imu_newest_s = 0, imu_time_offset_s = 0;
  std::optional<std::array<double, 2>> imu_clock;  ///< offset and standard deviation, s
  std::map<std::string, long long> imu_left_out;   ///< why -> samples
  std::vector<std::string> imu_warnings;
};
/// Keypoints of the last frame, those of the left images.
struct tracked_keypoints {
  std::vector<float> x, y, depth;
  std::vector<int> camera, octave;
  std::vector<int> point;  ///< slot of the map point held, -1 = none
  std::vector<std::uint8_t> matched;
};
struct map_arrays {
  std::vector<float> position, normal;  ///< [points][3]
  std::vector<int> number, seen;
  std::vector<std::int64_t> keyframe_time_ns;
  std::vector<double> keyframe_pose;  ///< [keyframes][4][4]
};

class odometry {
public:
  virtual ~odometry() = default;
  virtual void wait_for(std::uintptr_t stream) = 0;  ///< see features
  virtual std::vector<tracking> track(std::vector<frame_images> const& images,
                                      std::vector<std::int64_t> const& time_ns) = 0;
  virtual void add_imu(int b, std::int64_t time_ns, std::array<double, 3> const& accel,
                       std::array<double, 3> const& gyro) = 0;
  virtual void predict(int b, pose const& T_world_camera) = 0;
  virtual void reset(int b) = 0;
  virtual void set_mask(int b, int camera, image const& mask) = 0;
  virtual void recognize_places(std::string const& vocabulary, int candidates) = 0;
  virtual tracked_keypoints keypoints(int b) const = 0;
  virtual map_arrays map(int b) const = 0;
  /// Milliseconds of the last frame by stage, in order. Needs measure_stages
  virtual std::vector<std::pair<std::string, double>> stage_times() const = 0;
  virtual std::string save_map(int b) const = 0;
  virtual void load_map(int b, std::string const& bytes) = 0;
  virtual std::size_t memory_bytes() const = 0;
  /// track() of several frames in turn, [frames * batch]. @return what ft::odometry::track alone
  /// took, nanoseconds, [frames]: for the bench
  virtual std::vector<std::int64_t> track_timed(std::vector<frame_images> const& images,
                                                std::vector<std::int64_t> const& time_ns) = 0;
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

/// Names of the GPUs that can be used; none without CUDA.
std::vector<std::string> cuda_devices();

// Factories of a device: `host`, and `cuda` where there is one.
#define FTPY_FACTORIES(where)                                                                \
  namespace where {                                                                          \
  std::unique_ptr<features> make_features(feature_options const&, int, rig const&);          \
  std::unique_ptr<odometry> make_rectified_odometry(odometry_options const&);                \
  std::unique_ptr<odometry> make_distorted_odometry(odometry_options const&);                \
  std::unique_ptr<odometry> make_fisheye_odometry(odometry_options const&);                  \
  std::unique_ptr<odometry> make_rgbd_odometry(odometry_options const&);                     \
  std::unique_ptr<odometry> make_monocular_odometry(odometry_options const&);                \
  std::unique_ptr<odometry> make_multi_odometry(odometry_options const&);                    \
  std::unique_ptr<rectifier> make_rectifier(rig const&, int width, int height, int threads); \
  std::unique_ptr<places> make_places(place_options const&);                                 \
  }
FTPY_FACTORIES(host)
FTPY_FACTORIES(cuda)
#undef FTPY_FACTORIES

}  // namespace ftpy
