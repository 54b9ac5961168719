// SPDX-License-Identifier: Apache-2.0
/// @file A device that answers from memory: what is left of a call is the shim's own work.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <utility>
#include <vector>

#include "integration/orbslam3/device_tracker.hpp"

namespace bench {

/// Passes calls on to a device and notes the answers, frame by frame; from replay() on gives those
/// of the last `period` frames again, in turn, and computes nothing: caches are as the shim leaves
/// them, not as kernels on this processor would. `period` is even, since frames use two buffers in
/// turn.
class replaying_device final : public ft::orbslam3::device_tracker {
public:
  replaying_device(std::unique_ptr<ft::orbslam3::device_tracker> device, std::size_t period)
      : device_(std::move(device)), frames_(period) {}

  void replay() { replaying_ = true; }

  int capacity() const override { return device_->capacity(); }
  int cameras() const override { return device_->cameras(); }
  ft::orbslam3::frame_arrays const& frame(int buffer) override { return device_->frame(buffer); }

  void extract(int buffer, ft::orbslam3::grey_image const& left,
               ft::orbslam3::grey_image const& right) override {
    at_ = (at_ + 1) % frames_.size();
    next_ = 0;
    if (replaying_) { return; }  // frames take turns like buffers: the arrays are still there
    frames_[at_].clear();
    device_->extract(buffer, left, right);
  }
  void build_pyramids(ft::orbslam3::grey_image const& left,
                      ft::orbslam3::grey_image const& right) override {
    device_->build_pyramids(left, right);
  }
  void match_stereo(int buffer) override { device_->match_stereo(buffer); }
  void download_level(int image, int level, unsigned char* to, std::size_t stride) override {
    device_->download_level(image, level, to, stride);
  }
  int level_width(int level) const override { return device_->level_width(level); }
  int level_height(int level) const override { return device_->level_height(level); }

  void send(int buffer, ft::orbslam3::frame_part part) override {
    if (!replaying_) { device_->send(buffer, part); }
  }
  void reserve_map(int slots) override { device_->reserve_map(slots); }
  void change_map(ft::orbslam3::map_change const& change, std::uint32_t const* words) override {
    if (!replaying_) { device_->change_map(change, words); }
  }
  int* local_slots(int points) override { return device_->local_slots(points); }
  ft::orbslam3::recorded_sight* recorded_sights(int count) override {
    return device_->recorded_sights(count);
  }

  int search_last_frame(ft::orbslam3::last_frame_request const& r) override {
    return answer(r.current, [&] { return counted(device_->search_last_frame(r)); }).inliers;
  }
  int search_local_map(ft::orbslam3::local_map_request const& r) override {
    int const matches =
        answer(r.buffer, [&] { return counted(device_->search_local_map(r)); }).inliers;
    auto& sights = frames_[at_][next_ - 1].sights;
    auto const count = static_cast<std::size_t>(r.points * cameras());
    if (!replaying_) { sights.assign(device_->sights(), device_->sights() + count); }
    sights_ = sights;
    return matches;
  }
  ft::orbslam3::sight const* sights() const override { return sights_.data(); }
  ft::orbslam3::pose_result optimize_pose(int buffer,
                                          ft::orbslam3::transform const& T_cw) override {
    return answer(buffer, [&] { return device_->optimize_pose(buffer, T_cw); });
  }

  ft::orbslam3::traffic bytes() const override { return device_->bytes(); }
  void reset_bytes() override { device_->reset_bytes(); }
  void measure(bool on) override { device_->measure(on); }
  ft::orbslam3::device_times times() const override {
    return replaying_ ? ft::orbslam3::device_times{} : device_->times();
  }

private:
  struct noted {
    ft::orbslam3::pose_result result;
    std::vector<int> holder;
    std::vector<ft::orbslam3::sight> sights;
  };

  static ft::orbslam3::pose_result counted(int n) { return {{}, n}; }

  /// The next answer of this frame: computed and noted, or from memory.
  template <typename Compute>
  ft::orbslam3::pose_result answer(int buffer, Compute const& compute) {
    ft::orbslam3::frame_arrays const& a = device_->frame(buffer);
    auto const numbers = static_cast<std::size_t>(2 * a.capacity);
    auto& all = frames_[at_];
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
  std::vector<std::vector<noted>> frames_;
  std::vector<ft::orbslam3::sight> sights_;
  std::size_t at_ = 0;
  std::size_t next_ = 0;
  bool replaying_ = false;
};

}  // namespace bench
