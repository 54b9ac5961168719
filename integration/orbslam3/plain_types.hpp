// SPDX-License-Identifier: Apache-2.0
/// @file Types shared by the units that include ORB-SLAM3 and those that include the device: plain
/// structures, the same for every compiler.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

namespace ft {
namespace orbslam3 {

enum class lens { pinhole, kannala_brandt };

/// fx, fy, cx, cy and, for kannala_brandt, k1 to k4; pixels.
struct camera_parameters {
  lens kind = lens::pinhole;
  float values[8] = {};
};

/// x -> R x + t; R row-major, metres.
struct transform {
  float R[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  float t[3] = {};
};

/// Parameters of the pipelines, fixed at construction.
struct settings {
  int width = 0;  ///< of every image given to extract(), pixels
  int height = 0;
  int features = 1200;  ///< wanted per image
  int levels = 8;
  float scale_factor = 1.2f;
  int ini_threshold = 20;  ///< corner threshold, grey levels
  int min_threshold = 7;
  int images = 2;  ///< 2: stereo; 1: monocular and RGB-D
  camera_parameters left;
  camera_parameters right;  ///< of a kannala_brandt pair
  transform T_rl;           ///< left camera to right camera, of a kannala_brandt pair
  float bf = 0;             ///< baseline times fx, Frame::mbf; virtual for RGB-D, 0 for monocular
  /// First and last column of the left and of the right image that see the same part of the scene;
  /// only for pairs of kannala_brandt cameras.
  float overlap[2][2] = {{0, 1e9f}, {0, 1e9f}};
  /// For monocular images (one image and bf 0): keypoints from the first to the last column come
  /// last, in reverse, and Frame::monoLeft counts the others. The default is the value of the
  /// original's monocular constructor; RGB-D has none.
  float monocular_overlap[2] = {0, 1000};
  /// Keypoints in the order of a build with libstdc++ (tie_rule::std_sort); false:
  /// tie_rule::stable.
  bool std_sort_ties = true;
  /// Most keypoints per image of a frame that was extracted elsewhere; 0: as many as extract()
  /// yields. Monocular initialisation extracts five times as many.
  int most_keypoints = 0;
  /// Map points on the device at a time: those of recent local maps and those that mapping has
  /// created since. With more, the memory grows.
  int map_points = 1 << 15;
  /// Points of a local map. When more than half are used, another thread doubles the memory.
  int local_points = 1 << 14;
  /// Threads that share the host's part of a call: copies of images, filling a frame, counting
  /// points in view. They sleep between calls. -1: a quarter of the machine's, 3 at most.
  int helpers = -1;
  /// Reproduces two errors of the original's searches: it projects into the right fisheye camera
  /// with the left one's model, and it searches points rejected in this frame at their positions in
  /// an earlier frame.
  bool reference_quirks = true;
  /// Enqueues stereo with the extraction, without a wait in between.
  bool stereo_with_extraction = true;
  bool orientation_check = true;  ///< of the searches from the last frame and a keyframe
  /// Starts pose optimisation behind each search, before it is asked for (pose_ahead.hpp).
  bool poses_ahead = true;
  /// Levels of the vocabulary above the deepest one at which keypoints are grouped, 0 to 10.
  int levels_up = 4;
};

/// Radial-tangential distortion of a pinhole camera in OpenCV's notation, and its camera matrix,
/// which is also the one of the undistorted positions. As in ORB-SLAM3, k1 = 0 means that there is
/// no distortion.
struct lens_distortion {
  float fx = 0, fy = 0, cx = 0, cy = 0;  ///< pixels
  float k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0;

  bool any() const { return k1 != 0; }
  friend bool operator==(lens_distortion const& a, lens_distortion const& b) {
    return std::memcmp(&a, &b, sizeof a) == 0;
  }
};

/// An 8-bit grey image; stride in bytes.
struct grey_image {
  unsigned char const* data = nullptr;
  int width = 0;
  int height = 0;
  int stride = 0;
};

/// Frame's bounds after undistortion, pixels.
struct bounds {
  float min_x, min_y, max_x, max_y;

  bool have_area() const { return min_x < max_x && min_y < max_y; }
  friend bool operator==(bounds const& a, bounds const& b) {
    return a.min_x == b.min_x && a.min_y == b.min_y && a.max_x == b.max_x && a.max_y == b.max_y;
  }
};

struct extraction_request {
  int buffer = 0;
  grey_image left;
  grey_image right;        ///< of a pair
  lens_distortion lens{};  ///< of a single image: keypoints get their undistorted positions
  /// Of a single image: where its keypoints will be searched; without area, this is not known yet.
  bounds searched{};
};

/// Arrays of a frame in host memory, a copy of those on the device. Keypoint k of image c is at c *
/// capacity + k, which is also its number in `partner` and `holder`.
struct frame_arrays {
  int capacity = 0;
  int* count = nullptr;                 ///< [2]
  int* mono = nullptr;                  ///< [2] keypoints before those in the stereo overlap
  float* x = nullptr;                   ///< [2][capacity] pixels, without distortion
  float* y = nullptr;                   ///< likewise
  float* raw_x = nullptr;               ///< [capacity] as extracted; only by extract() of one image
  float* raw_y = nullptr;               ///< likewise
  float* angle = nullptr;               ///< likewise, degrees
  float* response = nullptr;            ///< likewise; filled by extract() only
  int* octave = nullptr;                ///< likewise
  std::uint32_t* descriptor = nullptr;  ///< [2][capacity][8]
  float* right_x = nullptr;             ///< [capacity] pixels, -1 = none
  float* depth = nullptr;               ///< [capacity] metres, -1 = none; filled by stereo only
  int* partner = nullptr;               ///< [2][capacity] -1 = none
  float* point = nullptr;  ///< [capacity][3] fisheye stereo, left camera's frame, metres
  int* holder = nullptr;   ///< [2][capacity] slot of the map point held, -1 = none
};

/// Parts of a frame that are sent together.
enum class frame_part { keypoints, positions, octaves, right_x, partner, holder };

/// Result of the frustum test of a point in a camera.
struct sight {
  float x, y;      ///< pixels
  float right_x;   ///< pixels
  float cosine;    ///< of the viewing angle
  float distance;  ///< metres
  int level;       ///< predicted octave; -1 = not in view
};

/// The points of a local map that a camera sees, in the order of the map.
struct points_in_view {
  int count = 0;
  int const* index = nullptr;  ///< [count] in the local map
  /// [count] seen by the left and the right camera; the latter only for kannala_brandt pairs.
  sight const* by[2] = {};
};

/// A point that is searched at its position from an earlier test.
struct recorded_sight {
  int index;   ///< in the local map
  int camera;  ///< 0 left, 1 right, or not_right_alone
  int slot;
  sight seen;

  /// Instead of a camera: the point is tested, and not searched if only the right camera sees it.
  static constexpr int not_right_alone = 2;
};

struct last_frame_request {
  int current = 0;  ///< buffers
  int last = 0;
  transform T_cw;          ///< predicted
  float rotation[4] = {};  ///< of T_cw, as a unit quaternion: x, y, z, w
  transform T_lw;
  bounds image{};
  float window_radius = 7;  ///< half side of a window at scale 1, pixels
  bool ignore_motion_direction = false;
};

struct local_map_request {
  int buffer = 0;
  transform T_cw;
  float centres[2][3] = {};  ///< of the left and the right camera in the world, metres
  bounds image{};
  int points = 0;             ///< slots in local_slots(), -1 = not tested
  bool slots_changed = true;  ///< since the last request
  int recorded = 0;           ///< entries in recorded_sights()
  float radius_factor = 1;    ///< of the windows of the left camera
  float max_distance = 0;     ///< points beyond are not searched; 0 = no limit, metres
};

struct pose_result {
  transform T_cw;
  int inliers = 0;
};

/// Numbers of records in a map change. They follow each other in this order as 32-bit words: slot,
/// then the values.
struct map_change {
  int positions = 0;     ///< slot, x, y, z
  int views = 0;         ///< slot, normal, lowest distance, highest distance
  int descriptors = 0;   ///< slot, 8 words
  int observations = 0;  ///< slot, 1 or 0: whether the point is observed

  static constexpr int position_words = 4;
  static constexpr int view_words = 6;
  static constexpr int descriptor_words = 9;
  static constexpr int observation_words = 2;
  static constexpr int point_words =
      position_words + view_words + descriptor_words + observation_words;

  int records() const { return positions + views + descriptors + observations; }
  std::size_t words() const {
    return static_cast<std::size_t>(positions) * position_words +
           static_cast<std::size_t>(views) * view_words +
           static_cast<std::size_t>(descriptors) * descriptor_words +
           static_cast<std::size_t>(observations) * observation_words;
  }
};

/// Bytes over the bus since the last reset.
struct traffic {
  std::size_t images = 0;   ///< up
  std::size_t frame = 0;    ///< up: keypoints, stereo, holders, poses, requests
  std::size_t map = 0;      ///< up: map points
  std::size_t results = 0;  ///< down
  int uploads = 0;          ///< copies and launches that upload something
  int downloads = 0;
};

/// Times of one call, microseconds.
struct device_times {
  double transfer = 0;
  double kernel = 0;
};

}  // namespace orbslam3
}  // namespace ft
