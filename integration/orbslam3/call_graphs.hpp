// SPDX-License-Identifier: Apache-2.0
/// @file Recordings of calls that are repeated with the same parameters.
#pragma once

#include <array>
#include <cstddef>
#include <cstring>

#include "ft/core/config.hpp"
#include "ft/core/recording.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

/// The parameters of a call's launches, apart from data in memory.
struct call_key {
  int call = 0;
  int buffer = 0;
  int size = 0;  ///< of the launches
  float values[6] = {};

  static call_key of(int call, int buffer, int size, bounds const& image, float a, float b) {
    return {call, buffer, size, {image.min_x, image.min_y, image.max_x, image.max_y, a, b}};
  }
  friend bool operator==(call_key const& a, call_key const& b) {
    return a.call == b.call && a.buffer == b.buffer && a.size == b.size &&
           std::memcmp(a.values, b.values, sizeof a.values) == 0;
  }
};

/// Replays the call of a key, and records it when the key is new. If there are more keys than
/// entries, which does not happen in tracking, calls are enqueued launch by launch.
template <typename Exec>
class call_graphs {
public:
  template <typename Queue>
  void replay(Exec const& exec, call_key const& key, Queue const& queue) {
    for (std::size_t i = 0; i < count_; ++i) {
      if (entries_[i].key == key) {
        entries_[i].graph.replay(exec, queue);
        return;
      }
    }
    if (!Exec::asynchronous || count_ == entries_.size()) {
      queue(exec);
      return;
    }
    entry& e = entries_[count_];
    e.graph.record(exec, queue);
    e.key = key;
    ++count_;
    e.graph.replay(exec, queue);
  }
  /// To be called when the memory that the calls use has moved.
  void clear() { count_ = 0; }

private:
  struct entry {
    call_key key;
    recording<Exec> graph;
  };
  std::array<entry, 64> entries_;
  std::size_t count_ = 0;
};

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
