// SPDX-License-Identifier: Apache-2.0
/// @file What the units that include ORB-SLAM3 and those that include the device share: plain
/// structures, the same for every compiler, and the interface of the device.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "ft/core/config.hpp"
#include "ft/types/images.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/orb_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/relocalization.hpp"

namespace ft::orbslam3 {

/// What a stage returns instead of its answer if its input is refused.
inline constexpr int call_refused = -1;

enum class lens { pinhole, kannala_brandt };

/// fx, fy, cx, cy and, for kannala_brandt, k1 to k4; pixels.
struct camera_parameters {
  lens kind = lens::pinhole;
  float values[8] = {};
};

/// Parameters of the pipelines, fixed at construction. Images given to extract() have the size of
/// orb_params; keypoints have the order of a build with libstdc++.
struct settings : orb_params {
  settings() { ties = tie_rule::std_sort; }

  int images = 2;  ///< 2: stereo; 1: monocular and RGB-D
  camera_parameters left;
  camera_parameters right;       ///< of a kannala_brandt pair
  pose T_rl = pose::identity();  ///< left camera to right camera, of a kannala_brandt pair
  float bf = 0;  ///< baseline times fx, Frame::mbf; virtual for RGB-D, 0 for monocular
  /// First and last column of the left and of the right image that see the same part of the scene;
  /// only for pairs of kannala_brandt cameras.
  float overlap[2][2] = {{0, 1e9f}, {0, 1e9f}};
  /// Most keypoints per image of a frame that was extracted elsewhere; 0: as many as extract()
  /// yields. Monocular initialisation extracts five times as many.
  int most_keypoints = 0;
  /// Map points on the device at a time: those of recent local maps and those that mapping has
  /// created since. With more, the memory grows.
  int map_points = 1 << 15;
  /// Points of a local map that there is memory for; a call with more takes more.
  int local_points = 1 << 14;
  /// Threads that share the host's part of a call: copies of images, filling a frame, counting
  /// points in view. They sleep between calls. -1: a quarter of the machine's, 3 at most.
  int helpers = -1;
  /// Reproduces two errors of the original's searches: it projects into the right fisheye camera
  /// with the left one's model, and it searches points rejected in this frame at their positions in
  /// an earlier frame.
  bool reference_quirks = true;
  /// Levels of the vocabulary above the deepest one at which keypoints are grouped, 0 to 10.
  int levels_up = 4;
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
  gray_view left;
  gray_view right;  ///< of a pair
};

/// Arrays of a frame in host memory, a copy of those on the device. Keypoint k of image c is at c *
/// capacity + k, which is also its number in `partner` and `holder`.
struct frame_arrays {
  int capacity = 0;
  int* count = nullptr;                 ///< [2]
  int* mono = nullptr;                  ///< [2] keypoints before those in the stereo overlap
  float* x = nullptr;                   ///< [2][capacity] pixels: as extracted, or as searched
  float* y = nullptr;                   ///< likewise
  float* angle = nullptr;               ///< likewise, degrees
  float* response = nullptr;            ///< likewise; filled by extract() only
  int* octave = nullptr;                ///< likewise
  std::uint32_t* descriptor = nullptr;  ///< [2][capacity][8]
  float* right_x = nullptr;             ///< [capacity] pixels, -1 = none
  float* depth = nullptr;               ///< [capacity] metres, -1 = none; filled by extract() only
  int* partner = nullptr;               ///< [2][capacity] -1 = none
  vec3<float>* point = nullptr;         ///< [capacity] fisheye stereo, left camera's frame, metres
  int* holder = nullptr;                ///< [2][capacity] slot of the map point held, -1 = none
};

/// Parts of a frame that are sent together.
enum class frame_part { keypoints, positions, octaves, right_x, partner, holder };

/// How the left and the right camera see the points of a local map; the latter only of a
/// kannala_brandt pair. A point that is not in view has level -1.
struct local_sights {
  visibility const* by[2] = {};  ///< [points]
};

/// A point that is searched at its position from an earlier test.
struct recorded_sight {
  int index;   ///< in the local map
  int camera;  ///< 0 left, 1 right, or not_right_alone
  int slot;
  visibility seen;

  /// Instead of a camera: the point is tested, and not searched if only the right camera sees it.
  static constexpr int not_right_alone = 2;
};

/// What a search or a pose starts from, uploaded as it is.
struct search_inputs {
  rigid<double> start = rigid<double>::identity();  ///< T_cw of a pose that is optimised
  pose T_cw = pose::identity();                     ///< of the frame: predicted, or `start`
  pose T_lw = pose::identity();                     ///< of the last frame
  vec3<float> centres[2] = {};  ///< of the left and the right camera in the world, metres
  quaternion<float> rotation{0, 0, 0, 1};  ///< of T_cw
  int slots = 0;                           ///< of a local map, in local_slots(); -1 = not tested
};

/// Of all three searches; what the others do not read is said.
struct search_request {
  int buffer = 0;  ///< of the frame
  /// Of the last frame, or with counts and angles of the keyframe and what is searched as holders.
  int other = 0;
  search_inputs inputs;
  bounds image{};
  /// Half side of a window at scale 1, pixels; of a local map a factor, for the left camera.
  float window = 1;
  bool ignore_motion_direction = false;  ///< last frame
  int max_hamming = 100;                 ///< keyframe: largest Hamming distance of a match, bits
  bool slots_changed = true;             ///< local map: since the last request
  int recorded = 0;                      ///< local map: entries in recorded_sights()
  float max_distance = 0;  ///< local map: points beyond are not searched; 0 = no limit, metres
};

struct pose_result {
  rigid<double> T_cw = rigid<double>::identity();
  int inliers = 0;
};

/// Numbers of records in a map change, by field. They follow each other in this order as 32-bit
/// words: slot, then the values.
struct map_change {
  enum field {
    position,    ///< x, y, z
    view,        ///< normal, lowest distance, highest distance
    descriptor,  ///< 8 words
    observed,    ///< 1 or 0: whether the point is observed
    fields
  };
  int count[fields] = {};

  /// Words of a record, slot included.
  FT_HOST_DEVICE static constexpr int words_of(int f) {
    return f == position ? 4 : f == view ? 6 : f == descriptor ? 9 : 2;
  }
  static constexpr std::size_t value_bytes(int f) {
    return sizeof(std::uint32_t) * static_cast<std::size_t>(words_of(f) - 1);
  }
  static constexpr int point_words = 4 + 6 + 9 + 2;
  int records() const { return count[0] + count[1] + count[2] + count[3]; }
  std::size_t words() const {
    std::size_t n = 0;
    for (int f = 0; f < fields; ++f) { n += static_cast<std::size_t>(count[f] * words_of(f)); }
    return n;
  }
};

/// Uploaded as it is.
struct inertial_request {
  int buffer = 0;
  int from_last_frame = 0;  ///< 0: from the last keyframe
  imu_mount mount{pose::identity(), pose::identity()};
  stored_inertial_state first{};   ///< of the last keyframe or the last frame
  stored_inertial_state start{};   ///< of the frame, predicted
  preintegrated integral{};        ///< from `first` to the frame
  preintegrated since_keyframe{};  ///< likewise from the last keyframe
  inertial_prior prior{};          ///< of the last frame, if from there
};

struct inertial_result {
  bool refused = false;  ///< integrals of nothing, or numbers that are not finite
  int tracked = 0;       ///< observations without outliers
  stored_inertial_state state{};
  inertial_prior prior{};  ///< for the next frame
};

/// Descriptors of a frame: rows of 32 bytes.
struct descriptor_rows {
  unsigned char const* data = nullptr;
  std::size_t step = 0;  ///< bytes from row to row
  int count = 0;
};

/// What a vocabulary says about a frame: BowVector and FeatureVector of DBoW2 as arrays, which stay
/// until the next transform.
struct word_lists {
  int words = 0;
  std::uint32_t const* word = nullptr;  ///< [words] ascending
  double const* value = nullptr;        ///< [words]
  int groups = 0;
  std::uint32_t const* node = nullptr;  ///< [groups] ascending
  int const* start = nullptr;           ///< [groups + 1] first of a group in `keypoint`
  int const* keypoint = nullptr;
};

/// The two sides of a search by words.
enum class word_side { keyframe, frame };

/// Arrays of one side in host memory, to be filled in by the caller. Of two cameras the left
/// keypoints come first.
struct word_arrays {
  int capacity = 0;   ///< keypoints
  int keypoints = 0;  ///< at most capacity
  /// First keypoint of the right camera, -1 = there is one camera. Of the frame.
  int first_right = -1;
  int groups = 0;                       ///< at most capacity
  std::uint32_t* descriptor = nullptr;  ///< [keypoints][8]
  float* angle = nullptr;               ///< [keypoints] degrees
  int* holder = nullptr;          ///< [keypoints] of the keyframe: -1 = not to be searched, or what
                                  ///< a match is to say, such as the keypoint's own number
  std::uint32_t* node = nullptr;  ///< [groups] ascending
  int* start = nullptr;           ///< [groups + 1] first of a group in `keypoint`; start[0] is 0
  int* keypoint = nullptr;        ///< each at most once
};

struct word_matches {
  int count = 0;               ///< keypoints of the frame that are matched
  int const* match = nullptr;  ///< [keypoints of the frame] the keyframe's holder, -1 = none
};

class helper_threads;

/// Two frames and a map on an executor, and the stages over them. Independent of ORB-SLAM3: its
/// implementation is executor_tracker.hpp, compiled by the executor's compiler (nvcc for CUDA).
///
/// Calls that return results wait for them; send() and change_map() are asynchronous. Arrays from
/// frame(), local_slots(), recorded_sights() and point_distances() may be written while nothing is
/// enqueued, which is between a call that waits and the next send(). One thread at a time, except
/// for what says otherwise. All throw ft::error (bad_argument, cuda_error).
///
/// The calls about words depend on no frame here.
class device_tracker {
public:
  static constexpr int buffers = 2;

  device_tracker() = default;
  device_tracker(device_tracker const&) = delete;
  device_tracker& operator=(device_tracker const&) = delete;
  virtual ~device_tracker() = default;

  /// Threads that share the host's work in a call; only the calling thread may use them.
  virtual helper_threads& helpers() = 0;
  /// Most keypoints per image of a frame.
  virtual int capacity() const = 0;
  /// Cameras whose keypoints are searched: 2 for a kannala_brandt pair.
  virtual int cameras() const = 0;
  virtual frame_arrays const& frame(int buffer) = 0;

  /// Enqueues the extraction of images into frame(buffer). wait_for_features() must follow. Of two
  /// images stereo is enqueued as well: the device then owns frame(buffer).right_x, depth, partner
  /// and point until settle(). The images may be reused on return.
  virtual void extract(extraction_request const& request) = 0;
  /// Waits for the keypoints of the last extract().
  virtual void wait_for_features() = 0;
  /// Waits for work that an earlier call left in flight.
  virtual void settle() = 0;

  /// Enqueues the upload of a part of frame(buffer).
  virtual void send(int buffer, frame_part part) = 0;

  /// Makes room for `slots` map points and keeps the current ones. Allocates.
  virtual void reserve_map(int slots) = 0;
  /// Enqueues changes of map points.
  /// @param words in the format of map_change; may be reused on return
  virtual void change_map(map_change const& change, std::uint32_t const* words) = 0;
  /// Slots of a local map of up to `points`, to be filled in by the caller. They keep the values of
  /// the last request. Allocates for more points than ever before.
  virtual int* local_slots(int points) = 0;
  /// Room for `count` recorded sights, of points in local_slots().
  virtual recorded_sight* recorded_sights(int count) = 0;

  /// Starts without holders; fills frame(request.buffer).holder. Returns the number of matches.
  virtual int search_last_frame(search_request const& request) = 0;
  /// Starts from the holders in the buffer. Returns how the points are seen while the search is
  /// still in flight; local_matches() must follow.
  virtual local_sights search_local_map(search_request const& request) = 0;
  /// Waits for the search, which fills the holders. Returns the number of matches.
  virtual int local_matches() = 0;
  /// Starts from the holders in the buffer; those of outliers become -1.
  virtual pose_result optimize_pose(int buffer, rigid<double> const& T_cw) = 0;

  /// Starts from the holders in both buffers; fills frame(request.buffer).holder. Returns the
  /// number of keypoints that take a point.
  virtual int search_keyframe(search_request const& request) = 0;

  /// By keypoint number: distances of the points held, metres. Of points beyond 10 m an observation
  /// without a right column may err less.
  virtual float* point_distances() = 0;
  /// Starts from the holders in the buffer and point_distances(); the holders of outliers become
  /// -1, unless the request is refused.
  virtual inertial_result optimize_inertial_pose(inertial_request const& request) = 0;

  /// Reads a vocabulary, as ft::read_vocabulary(). For set-up: allocates.
  virtual void load_vocabulary(std::string const& path) = 0;
  virtual bool has_vocabulary() const = 0;
  /// Words of a frame's descriptors and the groups of its keypoints; without a vocabulary none.
  /// From any thread, one at a time, beside all other calls but load_vocabulary().
  virtual word_lists transform_words(descriptor_rows const& rows) = 0;
  /// What the next search_by_words() reads: up to cameras() * capacity() keypoints.
  virtual word_arrays& words_of(word_side side) = 0;
  virtual word_matches search_by_words(words_search_params const& params) = 0;
};

}  // namespace ft::orbslam3
