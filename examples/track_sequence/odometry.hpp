// SPDX-License-Identifier: Apache-2.0
/// @file Visual odometry behind an interface of plain types, so that one program can have the host
/// and the CUDA version.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <iosfwd>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace app {

/// x -> R x + t, row-major R; metres.
struct rigid_pose {
  std::array<double, 9> R{1, 0, 0, 0, 1, 0, 0, 0, 1};
  std::array<double, 3> t{};

  std::array<double, 3> operator*(std::array<double, 3> const& p) const {
    std::array<double, 3> q = t;
    for (std::size_t i = 0; i < 3; ++i) {
      q[i] += R[3 * i] * p[0] + R[3 * i + 1] * p[1] + R[3 * i + 2] * p[2];
    }
    return q;
  }
};

/// An IMU, as its calibration has it; see ft::imu_params.
struct imu_options {
  rigid_pose T_imu_left;  ///< left-camera points to the IMU
  double gyro_noise = 0, accel_noise = 0, gyro_walk = 0, accel_walk = 0;  ///< densities
  double rate_hz = 0;
};

struct odometry_options {
  int width = 0, height = 0;
  double fx = 0, fy = 0, cx = 0, cy = 0;  ///< of the rectified pair, pixels
  double baseline = 0;                    ///< metres; with depth images of the virtual pair
  bool monocular = false;                 ///< the left camera alone
  bool rgbd = false;                      ///< the left camera with depth images:
  double depth_unit = 0;                  ///< metres per unit
  double min_depth = 0;                   ///< metres; smaller depths are none
  double max_depth = std::numeric_limits<double>::infinity();  ///< metres; larger depths are none
  bool fisheye = false;                   ///< Kannala-Brandt cameras, not rectified:
  std::array<double, 8> left{}, right{};  ///< fx fy cx cy k1 k2 k3 k4
  rigid_pose T_right_left;                ///< left-camera points to the right camera
  int features = 1200;
  int levels = 8;
  double scale_factor = 1.2;
  int ini_threshold = 20;
  int min_threshold = 7;
  double near_depth = 50;  ///< baselines: see ft::tracking_rules
  double fps = 20;
  std::optional<imu_options> imu;
  int threads = 0;              ///< of the host version; 0 = all
  bool measure_stages = false;  ///< fills all of frame_outcome::stage_ms, not only the last
  int prefetch = 0;             ///< frames that prefetch() may take ahead; 0 for one camera
};

/// The images of a frame, width x height pixels without padding. A camera pair has left and right,
/// one camera left alone, one with depth images left and depth; what is not used is not read.
struct frame_pixels {
  std::uint8_t const* left = nullptr;
  std::uint8_t const* right = nullptr;
  std::uint16_t const* depth = nullptr;
};

/// One left keypoint of the last processed frame, for drawing.
struct seen_keypoint {
  float x, y;
  int octave;
  float depth;   ///< metres, -1 = none
  int point;     ///< map point held, -1 = none
  bool matched;  ///< matched to a map point from before this frame
};

/// What the IMU said about a frame.
struct imu_outcome {
  bool known = false;      ///< gravity, velocity and biases are known
  bool optimized = false;  ///< the pose was optimised with the IMU
  std::array<double, 3> velocity{}, gyro_bias{}, accel_bias{}, gravity{};
  std::vector<std::string> warnings;  ///< what is likely wrong with its samples, a sentence each
};

struct frame_outcome {
  bool tracked = false;
  bool keyframe = false;
  bool metric = true;  ///< lengths are in metres
  rigid_pose T_wc;     ///< left camera to world
  int keypoints = 0;
  int stereo_matches = 0;
  int inliers = 0;  ///< matched map points, without this frame's new ones
  int local_points = 0;
  imu_outcome imu;
  std::vector<double> stage_ms;  ///< one per stage_names(); see odometry_options::measure_stages
  double images_to_pose_ms = 0;  ///< from handing the images over to having the pose
  std::string reason;            ///< why it is not tracked, or to be doubted; empty = neither
  std::string why;               ///< the same as a sentence
};

/// Tracks a camera pair, or one camera, also with depth images; the world is the first tracked
/// frame's left camera.
class odometry {
public:
  virtual ~odometry() = default;
  /// @param time_ns when the pair was taken; the time since the last pair scales the predicted
  ///   motion
  virtual frame_outcome track(std::int64_t time_ns, frame_pixels const& images) = 0;
  /// Gives a pair that a later track_prefetched() tracks. It stays as it is until then, or until
  /// forget_prefetched(). At most odometry_options::prefetch are given and not yet tracked.
  virtual void prefetch(frame_pixels const& images) = 0;
  /// Forgets the pairs that were given; they may go then.
  virtual void forget_prefetched() = 0;
  /// track() of the pair that was given first.
  virtual frame_outcome track_prefetched(std::int64_t time_ns) = 0;
  /// A sample of the IMU, before the frame that it belongs to. @param accel m/s^2 @param gyro rad/s
  virtual void add_imu(std::int64_t time_ns, std::array<double, 3> const& accel,
                       std::array<double, 3> const& gyro) = 0;
  virtual std::vector<std::string> const& stage_names() const = 0;  ///< the last one is "total"
  virtual std::vector<seen_keypoint> keypoints() const = 0;         ///< of the last frame
  /// Writes the points of the map as PLY. @param T_file_world maps them to the file's world
  virtual void write_map(std::ostream& to, rigid_pose const& T_file_world) const = 0;
  virtual int keyframes() const = 0;
  virtual int map_points() const = 0;
  virtual int maps() const = 0;  ///< maps begun: more than one if the camera was lost for long
  virtual std::string device() const = 0;
  /// Sentences about a calibration that looks wrong.
  virtual std::vector<std::string> calibration_warnings() const = 0;
};

std::unique_ptr<odometry> make_host_odometry(odometry_options const& options);
/// That of one camera.
std::unique_ptr<odometry> make_host_monocular(odometry_options const& options);
/// That of one camera with depth images.
std::unique_ptr<odometry> make_host_rgbd(odometry_options const& options);

/// Name of the CUDA device; empty if there is no usable one.
std::string cuda_device_name();
std::unique_ptr<odometry> make_cuda_odometry(odometry_options const& options);
/// That of one camera, and of one with depth images; only in a program with CUDA.
std::unique_ptr<odometry> make_cuda_monocular(odometry_options const& options);
std::unique_ptr<odometry> make_cuda_rgbd(odometry_options const& options);

}  // namespace app
