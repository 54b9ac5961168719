// SPDX-License-Identifier: Apache-2.0
/// @file The device's part of the shim on an executor: ft's stages over two frames and a map.
///
/// Compiled by nvcc for CUDA, else by the host compiler; includes nothing of ORB-SLAM3.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/recording.hpp"
#include "integration/orbslam3/device_extraction.hpp"
#include "integration/orbslam3/device_frames.hpp"
#include "integration/orbslam3/device_inertial.hpp"
#include "integration/orbslam3/device_map.hpp"
#include "integration/orbslam3/device_searches.hpp"
#include "integration/orbslam3/device_words.hpp"
#include "integration/orbslam3/executor_calls.hpp"
#include "integration/orbslam3/helper_threads.hpp"
#include "integration/orbslam3/plain_types.hpp"
#include "integration/orbslam3/rigs.hpp"

namespace ft::orbslam3 {
inline namespace FT_ABI {

/// Calls of every frame are recorded the first time and then replayed, one graph launch each.
/// @tparam Rig rectified_rig: one pinhole camera, or a rectified pair; fisheye_rig: kannala_brandt
template <typename Exec, typename Rig>
class executor_tracker : public device_tracker {
  static constexpr int searched = searched_cameras<Rig>;

public:
  /// Allocates all memory, waits. @throws bad_argument naming the setting
  executor_tracker(Exec const& beside, settings const& s)
      : stream_(beside),
        exec_(stream_.exec()),
        settings_(checked<Rig>(s)),
        helpers_(helper_threads::chosen(s.helpers)),
        extraction_(exec_, rig_of<Rig>(s), s, helpers_),
        frames_(exec_, s, extraction_.capacity()),
        searches_(exec_, rig_of<Rig>(s), s, extraction_.capacity()),
        inertial_(exec_, rig_of<Rig>(s), s, extraction_.capacity()),
        bags_(exec_, cameras() * capacity(), s.levels_up),
        word_search_(exec_, cameras() * capacity()) {
    map_.reserve(exec_, s.map_points);
    sights_there_.make();
    exec_.wait();
    extraction_.record(exec_, frames_);
  }
  /// Waits, because enqueued work uses memory of this object.
  ~executor_tracker() override {
    try {
      exec_.wait();
    } catch (error const&) {  // the device is lost, and so is the work on it
    }
  }

  helper_threads& helpers() override { return helpers_; }
  int capacity() const override { return frames_.capacity(); }
  int cameras() const override { return settings_.images == 2 ? searched : 1; }
  frame_arrays const& frame(int buffer) override { return frames_.arrays(buffer); }

  void settle() override {
    if (in_flight_) { wait(); }
  }
  void extract(extraction_request const& request) override {
    settle();
    extraction_.extract(exec_, frames_, request);
    in_flight_ = true;
  }

  void wait_for_features() override {
    extraction_.wait_for_features();
    in_flight_ = extraction_.pair();
  }

  void send(int buffer, frame_part part) override { frames_.send(exec_, up_, buffer, part); }

  void reserve_map(int slots) override {
    if (change_queued_) { wait(); }
    settle();
    if (map_.reserve(exec_, slots)) { graphs_.clear(); }
  }
  void change_map(map_change const& change, std::uint32_t const* words) override {
    if (change.records() == 0) { return; }
    if (change_queued_) { wait(); }
    settle();
    map_.change(exec_, change, words);
    change_queued_ = true;
  }

  int* local_slots(int points) override {
    if (searches_.local().reserve(exec_, points)) { graphs_.clear(); }
    return searches_.local()->staged_slots;
  }
  recorded_sight* recorded_sights(int count) override { return searches_.recorded_sights(count); }

  int search_last_frame(search_request const& r) override {
    searches_.set(r.inputs);
    begin();
    frames_.make_grid(exec_, r.buffer, r.image);
    auto const call = context_of(r.buffer);
    graphs_.replay(
        exec_,
        call_key::of(1, r.buffer, 0, r.image, r.window, r.ignore_motion_direction ? 1.0f : 0.0f),
        [&](Exec const& exec) {
          searches_.upload(exec);
          searches_.queue_last_frame(exec, call, r, frames_[r.other]);
          searches_.download_matches(exec, frames_.arrays(r.buffer).holder, call.frame);
        });
    wait();
    return searches_.matches();
  }

  local_sights search_local_map(search_request const& r) override {
    searches_.set_local_map(exec_, up_, r);
    begin();
    frames_.make_grid(exec_, r.buffer, r.image);
    auto const call = context_of(r.buffer);
    auto const lists = [&](Exec const& exec) {
      searches_.upload(exec);
      searches_.queue_local_lists(exec, call, r);
    };
    auto const choice = [&](Exec const& exec) {
      searches_.queue_local_choice(exec, call, r);
      searches_.download_matches(exec, frames_.arrays(r.buffer).holder, call.frame);
    };
    if (r.recorded == 0) {
      int const size = searches_.local().size_of(r.inputs.slots);
      graphs_.replay(exec_, call_key::of(2, r.buffer, size, r.image, r.window, r.max_distance),
                     lists);
      sights_there_.set(exec_);
      graphs_.replay(exec_, call_key::of(3, r.buffer, size, r.image, r.window, r.max_distance),
                     choice);
    } else {
      lists(exec_);
      sights_there_.set(exec_);
      choice(exec_);
    }
    sights_there_.wait();
    in_flight_ = true;
    return searches_.sights(r.inputs.slots);
  }
  int local_matches() override {
    wait();
    return searches_.matches();
  }

  pose_result optimize_pose(int buffer, rigid<double> const& T_cw) override {
    search_inputs inputs;
    inputs.start = T_cw;
    inputs.T_cw = T_cw.cast<float>();
    searches_.set(inputs);
    begin();
    auto const call = context_of(buffer);
    graphs_.replay(exec_, call_key::of(4, buffer, 0, {}, 0, 0), [&](Exec const& exec) {
      searches_.upload(exec);
      searches_.queue_pose(exec, call);
      searches_.download_pose(exec, frames_.arrays(buffer).holder, call.frame);
    });
    wait();
    return searches_.optimized();
  }

  int search_keyframe(search_request const& r) override {
    searches_.set(r.inputs);
    begin();
    frames_.make_grid(exec_, r.buffer, r.image);
    auto const call = context_of(r.buffer);
    searches_.upload(exec_);
    searches_.queue_keyframe(exec_, call, r, frames_[r.other]);
    searches_.download_matches(exec_, frames_.arrays(r.buffer).holder, call.frame);
    wait();
    return searches_.matches();
  }

  float* point_distances() override { return inertial_.distances(); }
  inertial_result optimize_inertial_pose(inertial_request const& r) override {
    int const mount = inertial_.set(r);
    begin();
    auto const call = context_of(r.buffer);
    graphs_.replay(exec_, call_key::of(5, r.buffer, mount, {}, 0, 0), [&](Exec const& exec) {
      inertial_.upload(exec);
      inertial_.queue(exec, {call.frame, call.map, call.geometry});
      inertial_.download(exec, frames_.arrays(r.buffer).holder, call.frame);
    });
    wait();
    return inertial_.result();
  }

  void load_vocabulary(std::string const& path) override { bags_.load(path); }
  bool has_vocabulary() const override { return bags_.loaded(); }
  word_lists transform_words(descriptor_rows const& rows) override { return bags_.transform(rows); }
  word_arrays& words_of(word_side side) override { return word_search_.arrays(side); }
  word_matches search_by_words(words_search_params const& params) override {
    return word_search_.search(params);
  }

private:
  using context = typename device_searches<Exec, Rig>::context;

  context context_of(int buffer) const {
    return {frames_.view(buffer), map_.view(), extraction_.geometry()};
  }
  /// Uploads the collected data.
  void begin() {
    settle();
    up_.flush(exec_);
  }
  void wait() {
    exec_.wait();
    change_queued_ = false;
    in_flight_ = false;
  }

  own_stream<Exec> stream_;
  Exec exec_;
  word_mover<Exec> up_;
  settings settings_;
  helper_threads helpers_;
  device_extraction<Exec, Rig> extraction_;
  device_frames<Exec, Rig> frames_;
  device_map<Exec> map_;
  device_searches<Exec, Rig> searches_;
  device_inertial<Exec, Rig> inertial_;
  device_bags<Exec> bags_;
  device_word_search<Exec> word_search_;
  call_graphs<Exec> graphs_;
  work_mark<Exec> sights_there_;
  bool in_flight_ = false;  ///< the last call left work that it did not wait for
  bool change_queued_ = false;
};

/// The tracker for the kind of cameras in the settings; on a device with a stream of its own.
template <typename Exec>
std::unique_ptr<device_tracker> make_tracker_beside(Exec const& beside, settings const& s) {
  if (s.left.kind == lens::pinhole) {
    return std::make_unique<executor_tracker<Exec, rectified_rig>>(beside, s);
  }
  return std::make_unique<executor_tracker<Exec, fisheye_rig>>(beside, s);
}

/// For machines without a GPU, and for tests.
/// @param threads as in host_exec; 0 = all
/// @throws bad_argument for invalid settings
inline std::unique_ptr<device_tracker> make_host_tracker(settings const& s, int threads = 0) {
  return make_tracker_beside(host_exec(threads), s);
}

#if defined(__CUDACC__)
/// On the current device. @throws bad_argument for invalid settings, cuda_error without a device or
/// memory
inline std::unique_ptr<device_tracker> make_cuda_tracker(settings const& s) {
  return make_tracker_beside(cuda_exec(nullptr), s);
}
#endif

}  // namespace FT_ABI
}  // namespace ft::orbslam3
