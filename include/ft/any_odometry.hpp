// SPDX-License-Identifier: Apache-2.0
/// @file An odometry whose executor and rig are chosen at run time. No kernel, no CUDA header: any
/// C++17 compiler compiles it in a second, and makes the same interface of it as any other one.
#pragma once

#include <cstdint>
#include <istream>
#include <memory>
#include <ostream>
#include <string>
#include <utility>
#include <vector>

#include "ft/types/errors.hpp"
#include "ft/types/features.hpp"
#include "ft/types/images.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/loops.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/rig_description.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace v0 {

/// Where an odometry works.
struct device {
  static constexpr int host = -1;
  static constexpr int current_gpu = -2;  ///< that of the calling thread

  int gpu = host;          ///< number of the GPU, or one of the above
  int threads = 0;         ///< of the host, including the caller's; 0 = all
  void* stream = nullptr;  ///< the GPU's cudaStream_t, which outlives the odometry; null: its own
};

/// The images of a frame of any rig, see odometry: a pair has the left and the right one; a multi
/// rig those of each camera in turn, of its pairs the left one and then the right one; an rgbd one
/// the grey and the depth image. Of a multi rig of several cameras those that one misses in a frame
/// are null, in their place.
struct any_images {
  gray_view gray[2 * most_cameras];
  depth_view depth = {};
  depth_view depths[most_cameras] = {};  ///< of a multi rig: of the cameras that have one, in order
};

/// With what make_odometry() finds lost cameras by words; see places.
struct place_options {
  std::string vocabulary;  ///< a file, as read_vocabulary() takes it; empty: not by words
  int candidates = 16;     ///< keyframes tried
};

/// The descriptors by which make_odometry() has keypoints compared.
enum class descriptor_kind {
  orb,  ///< 256 bits
  /// Keypoints of the caller with 512 bits, 64 bytes; shorter rows end with zeros. Of two rows of
  /// one point usually up to 128 bits differ: AKAZE's 61 bytes, BRISK, FREAK.
  bits_512,
  /// Keypoints of the caller with 128 numbers of int8; of two rows of one point the squared
  /// distance is usually up to 62 500: OpenCV's SIFT, each number less 128.
  int8_128
};

/// An odometry behind one interface. Members are those of odometry, with the same errors, and what
/// is said there holds. One that was never made, or was moved from, refuses every call with
/// bad_argument.
class any_odometry {
public:
  /// What erase() and make_odometry() implement.
  class interface {
  public:
    virtual ~interface() = default;
    virtual tracking const* track(any_images const* images, std::int64_t const* time_ns) = 0;
    virtual tracking const* track_features(given_features const* features,
                                           std::int64_t const* time_ns) = 0;
    virtual void prefetch(any_images const* images) = 0;
    virtual void forget_prefetched() = 0;
    virtual tracking const* track_prefetched(std::int64_t const* time_ns) = 0;
    virtual void wait_for(void* stream) = 0;
    virtual void add_imu(imu_measurement const& sample, int b) = 0;
    virtual void predict(rigid<double> const& T_world_camera, int b) = 0;
    virtual void reset(int b) = 0;
    virtual void set_mask(int b, int camera, gray_view mask) = 0;
    virtual tracking const& last(int b) const = 0;
    virtual tracked_frame_view const& keypoints() const = 0;
    virtual unsigned char const* matched() const = 0;
    virtual odometry_map download_map(int b) const = 0;
    virtual std::vector<placed_keyframe> placed_keyframes(int b) const = 0;
    virtual std::vector<closed_loop> closed_loops(int b) const = 0;
    virtual map_snapshot snapshot_map(int b) const = 0;
    virtual void load_map(std::istream& from, int b) = 0;
    virtual std::vector<stage_time> stage_times() const = 0;
    virtual allocated_bytes memory_bytes() const = 0;
    virtual int batch() const = 0;
    virtual int capacity() const = 0;
    virtual odometry_params const& params() const = 0;
    virtual std::vector<std::string> calibration_warnings() const = 0;
  };

  any_odometry() = default;
  explicit any_odometry(std::unique_ptr<interface> of) : of_(std::move(of)) {}

  /// @param images [batch] @param time_ns [batch] @return [batch] valid until the next call
  tracking const* track(any_images const* images, std::int64_t const* time_ns) {
    return made().track(images, time_ns);
  }
  tracking track(any_images const& images, std::int64_t time_ns) {
    return *single().track(&images, &time_ns);
  }
  /// Of keypoints of the caller, with odometry_params::own_features.
  /// @param features [batch] @param time_ns [batch] @return [batch] valid until the next call
  tracking const* track(given_features const* features, std::int64_t const* time_ns) {
    return made().track_features(features, time_ns);
  }
  tracking track(given_features const& features, std::int64_t time_ns) {
    return *single().track_features(&features, &time_ns);
  }
  /// @param images [batch]
  void prefetch(any_images const* images) { made().prefetch(images); }
  void prefetch(any_images const& images) { single().prefetch(&images); }
  void forget_prefetched() { made().forget_prefetched(); }
  tracking const* track_prefetched(std::int64_t const* time_ns) {
    return made().track_prefetched(time_ns);
  }
  tracking track_prefetched(std::int64_t time_ns) { return *single().track_prefetched(&time_ns); }
  /// Later calls wait for what a cudaStream_t has queued so far, such as a kernel that writes
  /// images. Asynchronous; nothing to be done on the host.
  void wait_for(void* stream) { made().wait_for(stream); }
  void add_imu(imu_measurement const& sample, int b = 0) { made().add_imu(sample, b); }
  void predict(rigid<double> const& T_world_camera, int b = 0) {
    made().predict(T_world_camera, b);
  }
  void reset(int b = 0) { made().reset(b); }
  void set_mask(int b, int camera, gray_view mask) { made().set_mask(b, camera, mask); }

  tracking const& last(int b = 0) const { return made().last(b); }
  tracked_frame_view const& keypoints() const { return made().keypoints(); }
  unsigned char const* matched() const { return made().matched(); }
  odometry_map download_map(int b = 0) const { return made().download_map(b); }
  std::vector<placed_keyframe> placed_keyframes(int b = 0) const {
    return made().placed_keyframes(b);
  }
  std::vector<closed_loop> closed_loops(int b = 0) const { return made().closed_loops(b); }
  map_snapshot snapshot_map(int b = 0) const { return made().snapshot_map(b); }
  void save_map(std::ostream& to, int b = 0) const { snapshot_map(b).write(to); }
  void load_map(std::istream& from, int b = 0) { made().load_map(from, b); }
  std::vector<stage_time> stage_times() const { return made().stage_times(); }
  allocated_bytes memory_bytes() const { return made().memory_bytes(); }
  int batch() const { return made().batch(); }
  int capacity() const { return made().capacity(); }
  odometry_params const& params() const { return made().params(); }
  /// What check_calibration() finds in the rig: "principal_point: ...", one string for each.
  std::vector<std::string> calibration_warnings() const { return made().calibration_warnings(); }

private:
  interface& made() const {
    if (of_ == nullptr) {
      throw bad_argument("ft: the odometry was never made, or was moved from");
    }
    return *of_;
  }
  interface& single() const {
    if (made().batch() != 1) {
      throw bad_argument("ft: an odometry of " + std::to_string(made().batch()) +
                         " camera pairs needs arrays of images and times");
    }
    return *of_;
  }

  std::unique_ptr<interface> of_;
};

/// Makes an odometry of a rig that the library ft::odometry has: rectified pairs of pinholes;
/// distorted pairs of radtan8; fisheye pairs of kannala_brandt; rgbd of pinhole or radtan8;
/// monocular of pinhole or kannala_brandt; multi rigs. For other camera models: erase().
/// Has the part inertial if odometry_params::imu is present, loops if odometry_params::loops are,
/// places if a vocabulary is named, and own_features if odometry_params::own_features is true.
/// @param descriptors others than ORB's need odometry_params::own_features, and have rectified
/// pairs
///   and rgbd of pinholes, without an IMU and words, where the library was built with them
/// @throws error for a vocabulary that cannot be read; bad_argument as odometry's constructor, for
/// a rig that is not in the library, for a GPU
///   that is not there, or any GPU if the library was built without CUDA; std::bad_alloc,
///   cuda_error
FT_VISIBLE any_odometry make_odometry(device const& where, rig_description const& rig,
                                      odometry_params const& params, int batch = 1,
                                      place_options const& places = {},
                                      descriptor_kind descriptors = descriptor_kind::orb);

/// Names of the GPUs that the library ft::odometry can use, in the order of their numbers; none if
/// it was built without CUDA.
FT_VISIBLE std::vector<std::string> gpu_names();

}  // namespace v0
}  // namespace ft
