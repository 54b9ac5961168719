// SPDX-License-Identifier: Apache-2.0
/// @file A device whose calls a test sees, and may fail.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "integration/orbslam3/plain_types.hpp"

namespace orbslam3_test {

/// What calls have given to the device.
struct traffic {
  int images = 0;                               ///< extractions
  std::vector<ft::orbslam3::frame_part> parts;  ///< of frames
  int slots = 0;                                ///< of local maps
  std::size_t map = 0;                          ///< bytes of changes of map points
};

/// Passes calls on; on_call is called with the name of each that queues work or waits.
class watched_device : public ft::orbslam3::device_tracker {
public:
  std::function<void(std::string const&)> on_call = [](std::string const&) {};
  traffic sent;

  explicit watched_device(std::unique_ptr<device_tracker> to) : to_(std::move(to)) {}

  ft::orbslam3::helper_threads& helpers() override { return to_->helpers(); }
  int capacity() const override { return to_->capacity(); }
  int cameras() const override { return to_->cameras(); }
  ft::orbslam3::frame_arrays const& frame(int b) override { return to_->frame(b); }
  void extract(ft::orbslam3::extraction_request const& r) override {
    on_call("extract");
    ++sent.images;
    to_->extract(r);
  }
  void wait_for_features() override {
    on_call("wait_for_features");
    to_->wait_for_features();
  }
  void send(int b, ft::orbslam3::frame_part part) override {
    on_call("send");
    sent.parts.push_back(part);
    to_->send(b, part);
  }
  void settle() override {
    on_call("settle");
    to_->settle();
  }
  void reserve_map(int slots) override {
    on_call("reserve_map");
    to_->reserve_map(slots);
  }
  void change_map(ft::orbslam3::map_change const& change, std::uint32_t const* words) override {
    on_call("change_map");
    sent.map += sizeof *words * change.words();
    to_->change_map(change, words);
  }
  int* local_slots(int points) override {
    on_call("local_slots");
    return to_->local_slots(points);
  }
  ft::orbslam3::recorded_sight* recorded_sights(int n) override { return to_->recorded_sights(n); }
  int search_last_frame(ft::orbslam3::search_request const& r) override {
    on_call("search_last_frame");
    return to_->search_last_frame(r);
  }
  ft::orbslam3::local_sights search_local_map(ft::orbslam3::search_request const& r) override {
    on_call("search_local_map");
    sent.slots += r.slots_changed ? r.inputs.slots : 0;
    return to_->search_local_map(r);
  }
  int local_matches() override {
    on_call("local_matches");
    return to_->local_matches();
  }
  ft::orbslam3::pose_result optimize_pose(int b, ft::rigid<double> const& T) override {
    on_call("optimize_pose");
    return to_->optimize_pose(b, T);
  }
  int search_keyframe(ft::orbslam3::search_request const& r) override {
    on_call("search_keyframe");
    return to_->search_keyframe(r);
  }
  float* point_distances() override { return to_->point_distances(); }
  ft::orbslam3::inertial_result optimize_inertial_pose(
      ft::orbslam3::inertial_request const& r) override {
    on_call("optimize_inertial_pose");
    return to_->optimize_inertial_pose(r);
  }
  void load_vocabulary(std::string const& path) override { to_->load_vocabulary(path); }
  bool has_vocabulary() const override { return to_->has_vocabulary(); }
  ft::orbslam3::word_lists transform_words(ft::orbslam3::descriptor_rows const& rows) override {
    on_call("transform_words");
    return to_->transform_words(rows);
  }
  ft::orbslam3::word_arrays& words_of(ft::orbslam3::word_side side) override {
    return to_->words_of(side);
  }
  ft::orbslam3::word_matches search_by_words(ft::words_search_params const& r) override {
    on_call("search_by_words");
    return to_->search_by_words(r);
  }

private:
  std::unique_ptr<device_tracker> to_;
};

}  // namespace orbslam3_test
