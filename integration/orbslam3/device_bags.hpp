// SPDX-License-Identifier: Apache-2.0
/// @file Bags of words on an executor: the vocabulary, the memory of a transform and its launches.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>

#include "ft/containers/keypoints.hpp"
#include "ft/containers/soa.hpp"
#include "ft/containers/vocabulary.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/words/transform.hpp"
#include "integration/orbslam3/call_clock.hpp"
#include "integration/orbslam3/own_stream.hpp"
#include "integration/orbslam3/stream_mark.hpp"
#include "integration/orbslam3/vocabulary_file.hpp"
#include "integration/orbslam3/word_mover.hpp"
#include "integration/orbslam3/word_types.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

/// One thread at a time, any thread.
template <typename Exec>
class device_bags {
public:
  /// Allocates memory, waits. @param keypoints of a frame, of both cameras
  /// @throws bad_argument for levels_up out of range
  device_bags(Exec const& beside, int keypoints, int levels_up)
      : stream_(beside), capacity_(keypoints) {
    detail::require_range("levels_up", levels_up, 0, max_vocabulary_levels);
    params_.levels_up = levels_up;
    auto const n = static_cast<std::size_t>(capacity_);
    memory_ = arena<Exec::space>([&](carver& c) {
      carve(c, in_, capacity_, 1);
      carve(c, out_, 1, capacity_);
      carve(c, work_, 1, capacity_);
    });
    host_memory_ = arena<staging_space<Exec>>([&](carver& c) {
      staged_orb_ = c.take<descriptor>(n);
      word_ = c.take<std::uint32_t>(n);
      value_ = c.take<double>(n);
      node_ = c.take<std::uint32_t>(n);
      start_ = c.take<int>(n + 1);
      keypoint_ = c.take<int>(n);
      counts_ = c.take<int>(3);
    });
    std::memset(host_memory_.data(), 0, host_memory_.bytes());
    fill_bytes(exec(), memory_.data(), 0, memory_.bytes());
    exec().wait();
  }

  /// For set-up: allocates. @throws as read_vocabulary() and require_same()
  void load(std::string const& path, vocabulary_facts const* expected) {
    auto const read = read_vocabulary(path);
    if (expected != nullptr) { require_same(path, facts_of(read.view()), *expected); }
    device_.enter();
    vocabulary_ = upload(exec(), read.view());
  }
  bool loaded() const { return vocabulary_.view().nodes > 0; }
  void measure(bool on) { clock_.measure(on); }

  /// Waits. @throws bad_argument for more descriptors than there is room for; cuda_error
  word_lists transform(descriptor_rows const& rows) {
    detail::require_range("number of descriptors", rows.count, 0, capacity_);
    if (rows.count == 0) { return {}; }
    device_.enter();
    for (int i = 0; i < rows.count; ++i) {
      std::memcpy(static_cast<void*>(staged_orb_ + i),
                  rows.data + static_cast<std::size_t>(i) * rows.step, sizeof(descriptor));
    }
    counts_[0] = rows.count;
    clock_.mark(exec(), 0);
    send(rows.count);
    clock_.mark(exec(), 1);
    descriptors_view in = in_;
    in.capacity = rows.count;
    transform_to_words(exec(), vocabulary_.view(), in, params_, out_, work_);
    clock_.mark(exec(), 2);
    fetch(rows.count);
    clock_.mark(exec(), 3);
    exec().wait();
    return {counts_[1], word_, value_, counts_[2], node_, start_, keypoint_, clock_.read()};
  }

private:
  Exec const& exec() const { return stream_.exec(); }

  void send(int n) const {
    word_mover<Exec> up;
    up.add(exec(), array_of<field::orb>(in_), staged_orb_, n);
    up.add(exec(), in_.count, counts_, 1);
    up.flush(exec());
  }
  /// As much as n descriptors can have; what is past the counts has no meaning.
  void fetch(int n) const {
    word_mover<Exec> down;
    down.add(exec(), counts_ + 1, out_.bag.count, 1);
    down.add(exec(), counts_ + 2, out_.groups.count, 1);
    down.add(exec(), word_, out_.bag.word, n);
    down.add(exec(), value_, out_.bag.value, n);
    down.add(exec(), node_, out_.groups.node, n);
    down.add(exec(), start_, out_.groups.start, n + 1);
    down.add(exec(), keypoint_, out_.groups.keypoint, n);
    down.flush(exec());
  }

  own_stream<Exec> stream_;
  thread_device<Exec> device_;
  int capacity_;
  transform_params params_;
  call_clock<Exec> clock_;
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
  arena<Exec::space> memory_;
  arena<staging_space<Exec>> host_memory_;
};

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
