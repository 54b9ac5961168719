// SPDX-License-Identifier: Apache-2.0
/// @file The interface of the device, for the units that include ORB-SLAM3.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "integration/orbslam3/helper_threads.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft::orbslam3 {

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
  /// and point until match_stereo() or settle(). The images may be reused on return. Keypoints of a
  /// single image are undistorted and sorted into their search grid. The first
  /// request with another distortion records its launches.
  virtual void extract(extraction_request const& request) = 0;
  /// Waits for the keypoints of the last extract().
  virtual void wait_for_features() = 0;
  /// Builds the pyramids of two images, for match_stereo() of keypoints that were extracted
  /// elsewhere.
  virtual void build_pyramids(gray_view const& left, gray_view const& right) = 0;
  /// Matches the keypoints of a buffer in the current pyramids and downloads the result into
  /// frame(buffer). If extract() has enqueued that, only waits.
  virtual void match_stereo(int buffer) = 0;
  /// Waits for work that an earlier call left in flight.
  virtual void settle() = 0;
  /// Downloads a level of an image's pyramid. @param to rows of `stride` bytes
  virtual void download_level(int image, int level, unsigned char* to, std::size_t stride) = 0;

  /// Enqueues the upload of a part of frame(buffer).
  virtual void send(int buffer, frame_part part) = 0;

  /// Allocates the memory that reserve_map(slots) will use. From any thread.
  virtual void prepare_map(int slots) = 0;
  /// Makes room for `slots` map points and keeps the current ones. Allocates unless prepared.
  virtual void reserve_map(int slots) = 0;
  /// Enqueues changes of map points.
  /// @param words in the format of map_change; may be reused on return
  virtual void change_map(map_change const& change, std::uint32_t const* words) = 0;
  /// Points of a local map that memory is allocated for. From any thread.
  virtual int local_room() const = 0;
  /// Allocates the memory for a local map of `points`. From any thread.
  virtual void prepare_local(int points) = 0;
  /// Slots of a local map of up to `points`, to be filled in by the caller. They keep the values of
  /// the last request. Allocates unless prepared.
  virtual int* local_slots(int points) = 0;
  /// Room for `count` recorded sights, of points in local_slots().
  virtual recorded_sight* recorded_sights(int count) = 0;

  /// Starts without holders; fills frame(current).holder. Returns the number of matches.
  virtual int search_last_frame(last_frame_request const& request) = 0;
  /// Starts from the holders in the buffer. Returns the points in view while the search is still in
  /// flight; local_matches() must follow.
  virtual points_in_view search_local_map(local_map_request const& request) = 0;
  /// Waits for the search, which fills the holders. Returns the number of matches.
  virtual int local_matches() = 0;
  /// Starts from the holders in the buffer; those of outliers become -1.
  virtual pose_result optimize_pose(int buffer, rigid<double> const& T_cw) = 0;

  /// Starts from the holders in both buffers; fills frame(request.frame).holder. Returns the number
  /// of keypoints that take a point.
  virtual int search_keyframe(keyframe_search_request const& request) = 0;

  /// By keypoint number: distances of the points held, metres. Of points beyond 10 m an observation
  /// without a right column may err less.
  virtual float* point_distances() = 0;
  /// Starts from the holders in the buffer and point_distances(); the holders of outliers become
  /// -1, unless the request is refused.
  virtual inertial_result optimize_inertial_pose(inertial_request const& request) = 0;

  /// Reads a vocabulary, as ft::read_vocabulary(). For set-up: allocates.
  /// @param expected as require_same() of vocabulary_facts.hpp; nullptr: anything
  virtual void load_vocabulary(std::string const& path, vocabulary_facts const* expected) = 0;
  virtual bool has_vocabulary() const = 0;
  /// Words of a frame's descriptors and the groups of its keypoints; without a vocabulary none.
  /// From any thread, one at a time, beside all other calls but load_vocabulary().
  virtual word_lists transform_words(descriptor_rows const& rows) = 0;
  /// What the next search_by_words() reads: up to cameras() * capacity() keypoints.
  virtual word_arrays& words_of(word_side side) = 0;
  virtual word_matches search_by_words(word_search_request const& request) = 0;
};

}  // namespace ft::orbslam3
