// SPDX-License-Identifier: Apache-2.0
/// @file Memory of an executor for the search of a local map. Its size depends on the number of
/// points.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <mutex>
#include <utility>

#include "ft/containers/map_points.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/workspace.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

/// A window computed by the host.
struct recorded_window {
  int index;
  int camera;
  search_window window;
};

/// Memory of one size.
template <typename Exec>
struct local_blocks {
  int capacity = 0;  ///< points
  search_buffers buffers;
  int* slots = nullptr;
  visibility* seen = nullptr;
  int* listed = nullptr;  ///< points in view
  recorded_window* recorded = nullptr;
  int* staged_slots = nullptr;
  int* staged_index = nullptr;
  visibility* staged_sights = nullptr;
  recorded_window* staged_windows = nullptr;

  local_blocks() = default;
  /// @param windows least number of search windows @param keypoints per image
  local_blocks(int points, int windows, int keypoints, int cameras) : capacity(points) {
    auto const all = static_cast<std::size_t>(points);
    auto const sights = static_cast<std::size_t>(cameras) * all;
    int const room = std::max(points, windows);
    memory = arena<Exec::space>([&](carver& c) {
      slots = c.take<int>(all);
      seen = c.take<visibility>(sights);
      listed = c.take<int>(all);
      recorded = c.take<recorded_window>(sights);
      carve(c, buffers.windows, room, 1, cameras);
      carve(c, buffers.work, room, keypoints, 1, cameras);
    });
    staging = arena<staging_space<Exec>>([&](carver& c) {
      staged_slots = c.take<int>(all);
      staged_index = c.take<int>(all);
      staged_sights = c.take<visibility>(sights);
      staged_windows = c.take<recorded_window>(sights);
    });
    std::fill_n(staged_slots, points, no_slot_yet);
  }

  static constexpr int no_slot_yet = -2;  ///< differs from every value that callers write
  arena<Exec::space> memory;
  arena<staging_space<Exec>> staging;
};

/// The blocks in use, and larger ones that another thread may allocate.
template <typename Exec>
class local_memory {
public:
  /// @param keypoints per image
  local_memory(int keypoints, int cameras) : keypoints_(keypoints), cameras_(cameras) {}

  local_blocks<Exec>* operator->() { return &blocks_; }
  local_blocks<Exec> const* operator->() const { return &blocks_; }

  /// Points that reserve() need not allocate for. From any thread.
  int room() const { return room_; }
  /// Allocates memory for `points`. The next reserve() that needs more memory than is in use takes
  /// it. From any thread.
  void prepare(int points) {
    int const n = size_of(points);
    if (n <= room_) { return; }
    local_blocks<Exec> taken(n, cameras_ * keypoints_, keypoints_, cameras_);
    std::lock_guard<std::mutex> const lock(mutex_);
    retired_ = {};
    if (n <= room_) { return; }
    next_ = std::move(taken);
    room_ = n;
  }
  /// Makes room for `points`. Waits if less is in use, and allocates unless prepared. The old
  /// memory is freed by the next prepare(). @return whether the memory has moved
  bool reserve(Exec const& exec, int points) {
    if (points <= blocks_.capacity) { return false; }
    prepare(points);
    exec.wait();
    std::lock_guard<std::mutex> const lock(mutex_);
    retired_ = std::exchange(blocks_, std::exchange(next_, local_blocks<Exec>{}));
    // Candidates are prefetched before their count is known.
    fill_bytes(exec, blocks_.buffers.work.list, 0xff, blocks_.buffers.work.list_bytes());
    return true;
  }

  /// Items of the launches for a local map of `points`: rounded up to a power of two, so that one
  /// recording serves many frames.
  static int size_of(int points) {
    int n = 1024;
    while (n < points) { n *= 2; }
    return n;
  }

private:
  int keypoints_;
  int cameras_;
  local_blocks<Exec> blocks_;  ///< used by the thread that calls reserve()
  std::mutex mutex_;
  local_blocks<Exec> next_;
  local_blocks<Exec> retired_;
  std::atomic<int> room_{0};
};

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
