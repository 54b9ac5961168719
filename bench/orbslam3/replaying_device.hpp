// SPDX-License-Identifier: Apache-2.0
/// @file A device that returns recorded answers, so that only the shim's own work remains in a
/// call.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "integration/orbslam3/device_tracker.hpp"

namespace bench {

/// Passes calls on to a device and records the answers, frame by frame. After replay() it repeats
/// those of the last `period` frames, in turn, and computes nothing, so that the caches are as the
/// shim leaves them and not as kernels on this processor would. `period` is even, since frames use
/// two buffers in turn.
class replaying_device final : public ft::orbslam3::device_tracker {
public:
  replaying_device(std::unique_ptr<ft::orbslam3::device_tracker> device, std::size_t period)
      : device_(std::move(device)), frames_(period) {}

  void replay() { replaying_ = true; }

  ft::orbslam3::helper_threads& helpers() override { return device_->helpers(); }
  int capacity() const override { return device_->capacity(); }
  int cameras() const override { return device_->cameras(); }
  ft::orbslam3::frame_arrays const& frame(int buffer) override { return device_->frame(buffer); }

  void extract(ft::orbslam3::extraction_request const& request) override {
    at_ = (at_ + 1) % frames_.size();
    next_ = 0;
    if (replaying_) { return; }  // frames alternate like buffers: the arrays are still valid
    frames_[at_] = {};
    device_->extract(request);
  }
  void wait_for_features() override {
    if (!replaying_) { device_->wait_for_features(); }
  }
  void build_pyramids(ft::gray_view const& left, ft::gray_view const& right) override {
    device_->build_pyramids(left, right);
  }
  void match_stereo(int buffer) override {
    if (!replaying_) { device_->match_stereo(buffer); }
  }
  void download_level(int image, int level, unsigned char* to, std::size_t stride) override {
    device_->download_level(image, level, to, stride);
  }

  void send(int buffer, ft::orbslam3::frame_part part) override {
    if (!replaying_) { device_->send(buffer, part); }
  }
  void settle() override { device_->settle(); }
  void prepare_map(int slots) override { device_->prepare_map(slots); }
  void reserve_map(int slots) override { device_->reserve_map(slots); }
  void change_map(ft::orbslam3::map_change const& change, std::uint32_t const* words) override {
    if (!replaying_) { device_->change_map(change, words); }
  }
  int local_room() const override { return device_->local_room(); }
  void prepare_local(int points) override { device_->prepare_local(points); }
  int* local_slots(int points) override { return device_->local_slots(points); }
  ft::orbslam3::recorded_sight* recorded_sights(int count) override {
    return device_->recorded_sights(count);
  }

  int search_last_frame(ft::orbslam3::last_frame_request const& r) override {
    return answer(r.current, [&] { return counted(device_->search_last_frame(r)); }).inliers;
  }
  ft::orbslam3::points_in_view search_local_map(ft::orbslam3::local_map_request const& r) override {
    local_buffer_ = r.buffer;
    auto& in_view = frames_[at_].in_view;
    if (!replaying_) {
      auto const seen = device_->search_local_map(r);
      in_view.index.assign(seen.index, seen.index + seen.count);
      for (int c = 0; c < cameras(); ++c) {
        in_view.by[c].assign(seen.by[c], seen.by[c] + seen.count);
      }
    }
    return {static_cast<int>(in_view.index.size()),
            in_view.index.data(),
            {in_view.by[0].data(), in_view.by[1].data()}};
  }
  int local_matches() override {
    return answer(local_buffer_, [&] { return counted(device_->local_matches()); }).inliers;
  }
  ft::orbslam3::pose_result optimize_pose(int buffer, ft::pose const& T_cw) override {
    return answer(buffer, [&] { return device_->optimize_pose(buffer, T_cw); });
  }
  float* point_distances() override { return device_->point_distances(); }
  ft::orbslam3::inertial_result optimize_inertial_pose(
      ft::orbslam3::inertial_request const& r) override {
    return device_->optimize_inertial_pose(r);
  }

  void load_vocabulary(std::string const& path,
                       ft::orbslam3::vocabulary_facts const* expected) override {
    device_->load_vocabulary(path, expected);
  }
  bool has_vocabulary() const override { return device_->has_vocabulary(); }
  ft::orbslam3::word_lists transform_words(ft::orbslam3::descriptor_rows const& rows) override {
    return device_->transform_words(rows);
  }
  ft::orbslam3::word_arrays& words_of(ft::orbslam3::word_side side) override {
    return device_->words_of(side);
  }
  ft::orbslam3::word_matches search_by_words(ft::orbslam3::word_search_request const& r) override {
    return device_->search_by_words(r);
  }
  int search_keyframe(ft::orbslam3::keyframe_search_request const& r) override {
    return device_->search_keyframe(r);
  }
  ft::orbslam3::pnp_arrays& correspondences() override { return device_->correspondences(); }
  ft::orbslam3::pnp_found solve_pnp(ft::orbslam3::pnp_progress& progress) override {
    return device_->solve_pnp(progress);
  }

  ft::orbslam3::traffic bytes() const override { return device_->bytes(); }
  void reset_bytes() override { device_->reset_bytes(); }
  void measure() override { device_->measure(); }
  ft::orbslam3::device_times times() const override {
    return replaying_ ? ft::orbslam3::device_times{} : device_->times();
  }

private:
  struct noted {
    ft::orbslam3::pose_result result;
    std::vector<int> holder;
  };
  struct noted_view {
    std::vector<int> index;
    std::vector<ft::visibility> by[2];
  };
  struct noted_frame {
    std::vector<noted> answers;
    noted_view in_view;
  };

  static ft::orbslam3::pose_result counted(int n) { return {{}, n}; }

  /// The next answer of this frame: computed and recorded, or replayed.
  template <typename Compute>
  ft::orbslam3::pose_result answer(int buffer, Compute const& compute) {
    ft::orbslam3::frame_arrays const& a = device_->frame(buffer);
    auto const numbers = static_cast<std::size_t>(2 * a.capacity);
    auto& all = frames_[at_].answers;
    if (!replaying_) {
      noted n;
      n.result = compute();
      n.holder.assign(a.holder, a.holder + numbers);
      all.push_back(std::move(n));
    } else {
      std::memcpy(a.holder, all[next_].holder.data(), numbers * sizeof(int));
    }
    return all[next_++].result;
  }

  std::unique_ptr<ft::orbslam3::device_tracker> device_;
  std::vector<noted_frame> frames_;
  int local_buffer_ = 0;
  std::size_t at_ = 0;
  std::size_t next_ = 0;
  bool replaying_ = false;
};

}  // namespace bench
