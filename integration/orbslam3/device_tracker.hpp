// SPDX-License-Identifier: Apache-2.0
/// @file The device's side of the shim, as the units that include ORB-SLAM3 see it.
#pragma once

#include <cstddef>
#include <cstdint>

#include "integration/orbslam3/helper_threads.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft {
namespace orbslam3 {

/// Two frames and a map on an executor, and the stages over them. Knows nothing of ORB-SLAM3: its
/// implementation is executor_tracker.hpp, compiled where the executor is (by nvcc for CUDA).
///
/// Calls that return results wait for them; send() and change_map() queue. Arrays from frame(),
/// local_slots() and recorded_sights() may be written whenever no call is queued, which is between
/// a call that waits and the next send(). One thread at a time, but for prepare_map(). All throw
/// ft::error (bad_argument, cuda_error) where it goes wrong.
class device_tracker {
public:
  static constexpr int buffers = 2;

  device_tracker() = default;
  device_tracker(device_tracker const&) = delete;
  device_tracker& operator=(device_tracker const&) = delete;
  virtual ~device_tracker() = default;

  /// Threads that share the host's work in a call; they belong to the thread that makes calls.
  virtual helper_threads& helpers() = 0;
  /// Keypoints that an image of a frame may have.
  virtual int capacity() const = 0;
  /// Cameras whose keypoints are searched: 2 for a kannala_brandt pair.
  virtual int cameras() const = 0;
  virtual frame_arrays const& frame(int buffer) = 0;

  /// Images up, keypoints down into frame(buffer). Where the settings ask for it stereo is queued
  /// as well: frame(buffer).right_x, depth, partner and point belong to the device until
  /// match_stereo() or settle().
  virtual void extract(int buffer, grey_image const& left, grey_image const& right) = 0;
  /// The pyramids of two images, for match_stereo() of keypoints that were extracted elsewhere.
  virtual void build_pyramids(grey_image const& left, grey_image const& right) = 0;
  /// Stereo of the keypoints in a buffer by the pyramids at hand, down into frame(buffer). Waits
  /// for it where extract() has queued it.
  virtual void match_stereo(int buffer) = 0;
  /// Waits for what an earlier call has left in flight.
  virtual void settle() = 0;
  /// A level of an image's pyramid down. @param to rows of `stride` bytes
  virtual void download_level(int image, int level, unsigned char* to, std::size_t stride) = 0;
  virtual int level_width(int level) const = 0;
  virtual int level_height(int level) const = 0;

  /// Queues a part of frame(buffer) for the device.
  virtual void send(int buffer, frame_part part) = 0;

  /// Takes the memory that reserve_map(slots) will use. From any thread.
  virtual void prepare_map(int slots) = 0;
  /// Makes room for `slots` map points; those there stay. Takes memory where it was not prepared.
  virtual void reserve_map(int slots) = 0;
  /// Queues changes of map points. @param words as map_change says; free on return
  virtual void change_map(map_change const& change, std::uint32_t const* words) = 0;
  /// Slots of a local map of up to `points`, to be filled in by the caller: those of the last
  /// request until then; grows where necessary.
  virtual int* local_slots(int points) = 0;
  /// Room for `count` of them.
  virtual recorded_sight* recorded_sights(int count) = 0;

  /// From empty holders; fills frame(current).holder. Returns the number of matches.
  virtual int search_last_frame(last_frame_request const& request) = 0;
  /// From the holders in the buffer. Returns the points in view while the search goes on:
  /// local_matches() follows.
  virtual points_in_view search_local_map(local_map_request const& request) = 0;
  /// Waits for the search, which fills the holders. Returns the number of matches.
  virtual int local_matches() = 0;
  /// From the holders in the buffer; those of outliers become -1.
  virtual pose_result optimize_pose(int buffer, transform const& T_cw) = 0;

  virtual traffic bytes() const = 0;
  virtual void reset_bytes() = 0;
  /// Measure device times from now on. Off, nothing is measured.
  virtual void measure(bool on) = 0;
  /// Of the last call that waited.
  virtual device_times times() const = 0;
};

}  // namespace orbslam3
}  // namespace ft
