// SPDX-License-Identifier: Apache-2.0
/// @file The calls of device_tracker that depend on no frame there: words and the search by them,
/// their memory and launches.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>

#include "ft/containers/keypoints.hpp"
#include "ft/containers/soa.hpp"
#include "ft/containers/vocabulary.hpp"
#include "ft/containers/vocabulary_text.hpp"
#include "ft/containers/words.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/words/search_by_words.hpp"
#include "ft/kernels/words/transform.hpp"
#include "integration/orbslam3/executor_calls.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft::orbslam3 {
inline namespace FT_ABI {

/// One thread at a time, any thread.
template <typename Exec>
class device_bags : public own_calls<Exec> {
  using own_calls<Exec>::exec;

public:
  /// Allocates memory, waits. @param keypoints of a frame, of both cameras
  /// @throws bad_argument for levels_up out of range
  device_bags(Exec const& beside, int keypoints, int levels_up)
      : own_calls<Exec>(beside), capacity_(keypoints) {
    detail::require_range("levels_up", levels_up, 0, max_vocabulary_levels);
    params_.levels_up = levels_up;
    auto const n = static_cast<std::size_t>(capacity_);
    auto const layout = [&](carver& c) {
      carve(c, in_, capacity_, 1);
      carve(c, out_, 1, capacity_);
      carve(c, work_, 1, capacity_);
    };
    auto const host_layout = [&](carver& c) {
      c.place(n, staged_orb_, word_, value_, node_, keypoint_);
      c.place(n + 1, start_);
      c.place(3, counts_);
    };
    this->allocate(layout, host_layout);
  }

  /// For set-up: allocates. @throws as read_vocabulary()
  void load(std::string const& path) {
    auto const read = read_vocabulary(path);
    this->enter();
    vocabulary_ = upload(exec(), read.view());
  }
  bool loaded() const { return vocabulary_.view().nodes > 0; }

  /// Waits. @throws bad_argument for more descriptors than there is room for; cuda_error
  word_lists transform(descriptor_rows const& rows) {
    detail::require_range("number of descriptors", rows.count, 0, capacity_);
    if (rows.count == 0) { return {}; }
    this->enter();
    for (int i = 0; i < rows.count; ++i) {
      std::memcpy(static_cast<void*>(staged_orb_ + i),
                  rows.data + static_cast<std::size_t>(i) * rows.step, sizeof(descriptor));
    }
    counts_[0] = rows.count;
    int const n = rows.count;
    this->call(
        [&](auto& up) {
          up.add(exec(), array_of<field::orb>(in_), staged_orb_, n);
          up.add(exec(), in_.count, counts_, 1);
        },
        [&] {
          descriptors_view in = in_;
          in.capacity = n;
          transform_to_words(exec(), vocabulary_.view(), in, params_, out_, work_);
        },
        [&](auto& down) { fetch(down, n); });
    return {counts_[1], word_, value_, counts_[2], node_, start_, keypoint_};
  }

private:
  /// As much as n descriptors can have; what is past the counts has no meaning.
  void fetch(word_mover<Exec>& down, int n) const {
    down.add(exec(), counts_ + 1, out_.bag.count, 1);
    down.add(exec(), counts_ + 2, out_.groups.count, 1);
    down.add(exec(), word_, out_.bag.word, n);
    down.add(exec(), value_, out_.bag.value, n);
    down.add(exec(), node_, out_.groups.node, n);
    down.add(exec(), start_, out_.groups.start, n + 1);
    down.add(exec(), keypoint_, out_.groups.keypoint, n);
  }

  int capacity_;
  transform_params params_;
  vocabulary<Exec::space> vocabulary_;
  descriptors_view in_;
  frame_words_view out_;
  transform_workspace work_;
  descriptor* staged_orb_ = nullptr;
  std::uint32_t* word_ = nullptr;
  double* value_ = nullptr;
  std::uint32_t* node_ = nullptr;
  int* start_ = nullptr;
  int* keypoint_ = nullptr;
  int* counts_ = nullptr;  ///< descriptors, words, groups
};

/// A keyframe and a frame.
template <typename Exec>
class device_word_search : public own_calls<Exec> {
  using own_calls<Exec>::exec;

public:
  /// Allocates memory, waits. @param keypoints of a frame, of both cameras
  device_word_search(Exec const& beside, int keypoints)
      : own_calls<Exec>(beside), capacity_(keypoints) {
    auto const n = static_cast<std::size_t>(capacity_);
    auto const layout = [&](carver& c) {
      for (side& s : sides_) {
        carve(c, s.groups, 1, capacity_);
        c.place(n, s.orb, s.angle);
      }
      c.place(n, holder_);
      c.place(1, first_right_);
      carve(c, matches_, 1, capacity_);
      carve(c, work_, 1, capacity_);
    };
    auto const host_layout = [&](carver& c) {
      for (side& s : sides_) { carve_staged(c, s); }
      c.place(n, staged_match_);
      c.place(1, staged_count_);
    };
    this->allocate(layout, host_layout);
  }

  word_arrays& arrays(word_side which) { return of(which).staged; }

  /// Searches what arrays() hold. Waits. @throws bad_argument, cuda_error
  word_matches search(words_search_params const& params) {
    side const& keyframe = of(word_side::keyframe);
    side const& frame = of(word_side::frame);
    check(keyframe.staged);
    check(frame.staged);
    int const n = frame.staged.keypoints;
    if (n == 0) { return {}; }
    word_matches_view out = matches_;
    out.capacity = n;
    this->call([&](auto& up) { send(up); },
               [&] {
                 words_search search;
                 search.keyframes = view_of(keyframe, nullptr);
                 search.holder = holder_;
                 search.frames =
                     view_of(frame, frame.staged.first_right < 0 ? nullptr : first_right_);
                 search_by_words(exec(), search, params, out, work_);
               },
               [&](auto& down) {
                 down.add(exec(), staged_count_, out.count, 1);
                 down.add(exec(), staged_match_, out.match, n);
               });
    return {*staged_count_, staged_match_};
  }

private:
  struct side {
    node_groups_view groups;
    descriptor* orb = nullptr;
    float* angle = nullptr;
    word_arrays staged;
    int* staged_numbers = nullptr;  ///< groups, first_right
  };

  side& of(word_side which) { return sides_[static_cast<int>(which)]; }

  void carve_staged(carver& c, side& s) const {
    word_arrays& a = s.staged;
    a.capacity = capacity_;
    c.place(capacity_, a.angle, a.holder, a.node, a.keypoint);
    c.place({capacity_, 8}, a.descriptor);
    c.place(capacity_ + 1, a.start);
    c.place(2, s.staged_numbers);
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
  void send(word_mover<Exec>& up) {
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
  }

  int capacity_;
  side sides_[2];
  int* holder_ = nullptr;
  int* first_right_ = nullptr;
  word_matches_view matches_;
  words_search_workspace work_;
  int* staged_match_ = nullptr;
  int* staged_count_ = nullptr;
};

}  // namespace FT_ABI
}  // namespace ft::orbslam3
