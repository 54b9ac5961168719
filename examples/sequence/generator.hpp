// SPDX-License-Identifier: Apache-2.0
/// @file A generated stereo sequence: a textured room seen from a moving pair, with exact ground
/// truth.
///
/// World frame: z up, metres, gravity (0, 0, -9.81). Camera frame: x right, y down, z forward.
/// Pixel centres have integer coordinates. One lap of the route takes 19.2 s, starts from rest,
/// stops twice, turns at about 90 deg/s, and passes a wall at about 0.8 m. Longer sequences repeat
/// the lap.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "examples/sequence/types.hpp"

namespace seq {

/// Where the camera goes.
enum class scene_kind {
  room,      ///< laps through a room
  corridor,  ///< straight along a corridor, 5 m wide and 3 m high
};

enum class rig_kind {
  pinhole,  ///< rectified pair, 752 x 480, fx = fy = 435, baseline 0.11 m
  fisheye,  ///< two Kannala-Brandt cameras, 512 x 512, fx about 190, slightly rotated; black past
            ///< 86 deg
};

/// A time of the sequence, seconds from its first frame: from_s <= t < to_s.
struct time_span {
  double from_s = 0;
  double to_s = 0;
};

/// A turn of the camera about the vertical and back again, on top of the route's. The rate is
/// highest at a quarter and at three quarters of its time, pi * degrees / length.
struct fast_turn {
  time_span when;      ///< at least 0.2 s
  double degrees = 0;  ///< to the left; -360 to 360
};

/// What hides parts of the pinhole rig's left images; 0 = nothing. Shares in percent of the image,
/// 0 to 80.
struct hiding_things {
  double bonnet = 0;     ///< fixed to the cameras: the lower edge, 0.6 m away
  double dirt = 0;       ///< fixed to the cameras: patches all over the image, 0.5 m away
  double companion = 0;  ///< in the middle, 2 m ahead: goes where the camera goes, does not turn
  double crossing = 0;   ///< a band across the middle, 2 m ahead: crosses from right to left
  double crossing_speed = 0.5;  ///< m/s, 0 to 10
};

/// A camera beside the pair.
struct further_camera {
  camera_intrinsics camera;                                       ///< a pinhole or Kannala-Brandt
  Eigen::Isometry3d T_left_this = Eigen::Isometry3d::Identity();  ///< its points to the left camera
  int right_of = -1;       ///< it is the right one of a pair whose left one is this further camera
  bool has_depth = false;  ///< it has depth images
};
struct further_image {
  image grey;
  depth_image depth;  ///< millimetres, of a camera that has them; 0 = none, or above 65 m
};

struct generator_options {
  rig_kind rig = rig_kind::pinhole;
  /// Pixels, 32 to 4096; 0 = the rig's own, or computed from the other side with the rig's aspect
  /// ratio. The focal length scales with the width.
  int width = 0;
  int height = 0;
  int frames = 300;        ///< 1 to 100000
  double fps = 20;         ///< 1 to 1000
  std::uint64_t seed = 1;  ///< determines textures, details of route and room, noise
  double noise_sigma = 2;  ///< grey levels, 0 to 50
  bool exposure_change =
      true;                ///< gain between 0.8 and 1.2, smooth over time, equal left and right
  bool vignetting = true;  ///< image corners 20 % darker
  double baseline = 0;     ///< metres, 0.02 to 0.3; 0 = the rig's own (0.11 and 0.101)
  double exposure_s = 0;   ///< images are means over this time about their stamp, 0 to 0.1
  /// Of rolling shutters: from the first row to the last one, 0 to 0.1 s. The stamp is the time of
  /// the image's middle.
  double readout_s = 0;
  std::vector<time_span> blind;       ///< black images, with noise: a covered lens
  std::vector<time_span> dropped;     ///< frames that write_asl leaves out
  std::vector<fast_turn> fast_turns;  ///< they blur images that have an exposure
  scene_kind scene = scene_kind::room;
  double speed = 2;       ///< in the corridor, after 2 s, m/s, 0 (at rest) to 40
  double look_aside = 0;  ///< in the corridor: degrees to the left of the way, -180 to 180
  double repeat = 0;  ///< the corridor looks the same after so many metres, 0.2 to 100; 0 = never
  hiding_things hiding;
  std::vector<further_camera> further;  ///< at most 14
  double imu_rate = 200;                ///< Hz, 10 to 10000
  imu_noise imu;                        ///< densities, at most 1 (gyro) and 10 (accelerometer)
  double gyro_bias = 0.005;    ///< standard deviation of each axis' first bias, rad/s, 0 to 1
  double accel_bias = 0.03;    ///< likewise, m/s^2, 0 to 10
  double imu_noise_scale = 1;  ///< times densities and first biases, 0 to 100; 0 = ideal samples
  int threads = 0;             ///< for building the textures, 1 to 256; 0 = all of the machine
};

/// A rig of six cameras of one size: two fisheye pairs, of which the second looks aside, a pinhole
/// that looks half aside, and a pinhole with depth images that looks to the other side.
/// @param options of the sequence; its rig, size and further cameras are set
void use_mixed_rig(generator_options& options);

/// State of the body (IMU) at an instant.
struct body_state {
  std::int64_t time_ns = 0;
  Eigen::Isometry3d T_world_body = Eigen::Isometry3d::Identity();
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();    ///< m/s, world frame
  Eigen::Vector3d gyro_bias = Eigen::Vector3d::Zero();   ///< rad/s
  Eigen::Vector3d accel_bias = Eigen::Vector3d::Zero();  ///< m/s^2
};

/// The whole sequence, rendered on demand. Everything is a function of the options (except
/// `threads`): the same bytes on every run. Immutable after construction: all members may be called
/// from several threads at once. Movable.
class generator {
public:
  /// Builds room, textures (about 50 MB for the default size) and route.
  /// @throws seq::error for an option outside its range, with value and limit
  explicit generator(generator_options const& options = {});
  generator(generator&&) noexcept;
  generator& operator=(generator&&) noexcept;
  ~generator();

  /// As given, with the defaults (0) of width, height and baseline filled in.
  generator_options const& options() const;
  stereo_rig const& rig() const;
  int size() const;  ///< frames

  /// @pre (this and below) 0 <= i < size(). @throws seq::error
  std::int64_t time_ns(int i) const;
  /// Left camera.
  Eigen::Isometry3d T_world_camera(int i) const;
  /// Renders both images of frame i on the calling thread.
  stereo_frame render(int i) const;
  /// The same of another pair of such cameras on the same body. @param T_left_other its left camera
  /// to that of render(i)
  stereo_frame render(int i, Eigen::Isometry3d const& T_left_other) const;

  /// Image k of frame i is that of options().further[k].
  further_image render_further(int i, int k) const;

  /// One pose of the left camera per frame.
  trajectory ground_truth() const;
  /// Body states at every IMU and every frame time, sorted.
  std::vector<body_state> body_ground_truth() const;
  /// From the first frame's time to the last one's. Angular rate and specific force are exact
  /// derivatives of the motion that the images are rendered from; to them come biases that walk at
  /// random and white noise.
  std::vector<imu_sample> imu() const;
  /// Whether frame i is in a span of options().dropped. It can be rendered nevertheless.
  bool dropped(int i) const;

  /// (This and below) hiding_things are not there.
  /// The surface seen at pixel (u, v) of a camera (0 left, 1 right), in that camera's frame at the
  /// time of the row, metres; nothing outside the lens' range.
  std::optional<Eigen::Vector3d> surface_point(int i, int camera, double u, double v) const;
  /// z of the surface seen at (u, v) of the left camera, metres; -1 outside the lens' range.
  double depth(int i, double u, double v) const;
  /// Pixel of a point in a camera's own frame; nothing behind the camera or outside the lens'
  /// range. The pixel may lie outside the image.
  std::optional<Eigen::Vector2d> project(int camera, Eigen::Vector3d const& point) const;
  /// Distance of the closer of the two cameras to the nearest surface, metres.
  double clearance(int i) const;

private:
  struct impl;
  std::unique_ptr<impl> impl_;
};

}  // namespace seq
