// SPDX-License-Identifier: Apache-2.0
/// @file The search by words on an executor: its memory and its launches.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "ft/containers/keypoints.hpp"
#include "ft/containers/words.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/words/search_by_words.hpp"
#include "integration/orbslam3/call_clock.hpp"
#include "integration/orbslam3/own_stream.hpp"
#include "integration/orbslam3/word_mover.hpp"
#include "integration/orbslam3/word_types.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

/// A keyframe and a frame. On a stream of its own: what tracking has started for the next call goes
/// on.
template <typename Exec>
class device_word_search {
public:
  /// Allocates memory, waits. @param keypoints of a frame, of both cameras
  device_word_search(Exec const& beside, int keypoints) : stream_(beside), capacity_(keypoints) {
    auto const n = static_cast<std::size_t>(capacity_);
    memory_ = arena<Exec::space>([&](carver& c) {
      for (side& s : sides_) {
        carve(c, s.groups, 1, capacity_);
        s.orb = c.take<descriptor>(n);
        s.angle = c.take<float>(n);
      }
      holder_ = c.take<int>(n);
      first_right_ = c.take<int>(1);
      carve(c, matches_, 1, capacity_);
      carve(c, work_, 1, capacity_);
    });
    host_memory_ = arena<staging_space<Exec>>([&](carver& c) {
      for (side& s : sides_) { carve_staged(c, s); }
      staged_match_ = c.take<int>(n);
      staged_count_ = c.take<int>(1);
    });
    std::memset(host_memory_.data(), 0, host_memory_.bytes());
    fill_bytes(exec(), memory_.data(), 0, memory_.bytes());
    exec().wait();
  }

  word_arrays& arrays(word_side which) { return of(which).staged; }
  void measure(bool on) { clock_.measure(on); }

  /// Searches what arrays() hold. Waits. @throws bad_argument, cuda_error
  word_matches search(word_search_request const& r) {
    side const& keyframe = of(word_side::keyframe);
    side const& frame = of(word_side::frame);
    check(keyframe.staged);
    check(frame.staged);
    int const n = frame.staged.keypoints;
    if (n == 0) { return {}; }
    clock_.mark(exec(), 0);
    send();
    clock_.mark(exec(), 1);
    words_search search;
    search.keyframes = view_of(keyframe, nullptr);
    search.holder = holder_;
    search.frames = view_of(frame, frame.staged.first_right < 0 ? nullptr : first_right_);
    words_search_params params;
    params.ratio = r.ratio;
    params.orientation_check = r.orientation_check;
    word_matches_view out = matches_;
    out.capacity = n;
    search_by_words(exec(), search, params, out, work_);
    clock_.mark(exec(), 2);
    word_mover<Exec> down;
    down.add(exec(), staged_count_, out.count, 1);
    down.add(exec(), staged_match_, out.match, n);
    down.flush(exec());
    clock_.mark(exec(), 3);
    exec().wait();
    return {*staged_count_, staged_match_, clock_.read()};
  }

private:
  struct side {
    node_groups_view groups;
    descriptor* orb = nullptr;
    float* angle = nullptr;
    word_arrays staged;
    int* staged_numbers = nullptr;  ///< groups, first_right
  };

  Exec const& exec() const { return stream_.exec(); }
  side& of(word_side which) { return sides_[static_cast<int>(which)]; }

  void carve_staged(carver& c, side& s) const {
    auto const n = static_cast<std::size_t>(capacity_);
    s.staged.capacity = capacity_;
    s.staged.descriptor = c.take<std::uint32_t>(8 * n);
    s.staged.angle = c.take<float>(n);
    s.staged.holder = c.take<int>(n);
    s.staged.node = c.take<std::uint32_t>(n);
    s.staged.start = c.take<int>(n + 1);
    s.staged.keypoint = c.take<int>(n);
    s.staged_numbers = c.take<int>(2);
  }
  void check(word_arrays const& a) const {
    detail::require_range("keypoints of a search by words", a.keypoints, 0, capacity_);
    detail::require_range("groups of a search by words", a.groups, 0, a.keypoints);
    detail::require_range("grouped keypoints", a.start[a.groups], 0, a.keypoints);
  }
  word_keypoints_view view_of(side const& s, int const* first_right) const {
    return {s.groups, s.orb, s.angle, first_right};
  }
  /// Enqueues the upload of both sides: a row of keypoints each, as long as there are keypoints.
  void send() {
    word_mover<Exec> up;
    for (side& s : sides_) {
      word_arrays const& a = s.staged;
      s.groups.capacity = a.keypoints;
      s.staged_numbers[0] = a.groups;
      s.staged_numbers[1] = a.first_right;
      up.add(exec(), s.orb, reinterpret_cast<descriptor const*>(a.descriptor), a.keypoints);
      up.add(exec(), s.angle, a.angle, a.keypoints);
      up.add(exec(), s.groups.count, s.staged_numbers, 1);
      up.add(exec(), s.groups.node, a.node, a.groups);
      up.add(exec(), s.groups.start, a.start, a.groups + 1);
      up.add(exec(), s.groups.keypoint, a.keypoint, a.start[a.groups]);
    }
    side const& keyframe = of(word_side::keyframe);
    up.add(exec(), holder_, keyframe.staged.holder, keyframe.staged.keypoints);
    up.add(exec(), first_right_, of(word_side::frame).staged_numbers + 1, 1);
    up.flush(exec());
  }

  own_stream<Exec> stream_;
  int capacity_;
  call_clock<Exec> clock_;
  side sides_[2];
  int* holder_ = nullptr;
  int* first_right_ = nullptr;
  word_matches_view matches_;
  words_search_workspace work_;
  int* staged_match_ = nullptr;
  int* staged_count_ = nullptr;
  arena<Exec::space> memory_;
  arena<staging_space<Exec>> host_memory_;
};

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
