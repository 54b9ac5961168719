// SPDX-License-Identifier: Apache-2.0
/// @file Map points in executor memory, by slot, and memory for the search of a local map.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <utility>

#include "ft/containers/map_points.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft::orbslam3 {
inline namespace FT_ABI {

/// Writes one record of a map change.
struct apply_map_change {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, map_change const& change,
                                 std::uint32_t const* at, map_points_view const& map) const {
    int field = 0;
    for (; item >= change.count[field]; ++field) {
      item -= change.count[field];
      at += change.count[field] * map_change::words_of(field);
    }
    at += item * map_change::words_of(field);
    auto const slot = static_cast<int>(*at++);
    switch (field) {
      case map_change::position:
        map.position(slot) = {number(at[0]), number(at[1]), number(at[2])};
        break;
      case map_change::view:
        map.normal(slot) = {number(at[0]), number(at[1]), number(at[2])};
        map.min_distance(slot) = number(at[3]);
        map.max_distance(slot) = number(at[4]);
        break;
      case map_change::descriptor:
        for (int w = 0; w < 8; ++w) { map.orb(slot).words[w] = at[w]; }
        break;
      default:
        map.observations(slot) = static_cast<int>(*at);
    }
  }

private:
  FT_HOST_DEVICE static float number(std::uint32_t bits) {
    float v;
    memcpy(&v, &bits, sizeof v);
    return v;
  }
};

/// Memory of a map, and of one change of all its points.
template <typename Exec>
class device_map {
public:
  map_points_view const& view() const { return used_.map; }

  /// Makes room for `slots` points and keeps the current ones: allocates, waits. Returns whether
  /// view() has changed.
  bool reserve(Exec const& exec, int slots) {
    if (slots <= used_.capacity) { return false; }
    detail::require_range("map points", slots, 1, 1 << 26);
    blocks larger(slots);
    if (used_.capacity > 0) {
      map_points_view first = larger.map;
      first.capacity = used_.capacity;
      copy(exec, first, used_.map);
    }
    exec.wait();
    used_ = std::move(larger);
    return true;
  }

  /// Enqueues a change. Two changes need an exec.wait() in between.
  void change(Exec const& exec, map_change const& change, std::uint32_t const* words) {
    std::size_t const n = change.words();
    detail::require(n <= used_.staged.size(), "a change has one record a field and slot at most");
    std::memcpy(used_.staged.data(), words, n * sizeof *words);
    std::uint32_t const* const staged = used_.staged.data();
    copy(exec, used_.words.data(), staged, n);
    std::uint32_t const* const there = used_.words.data();
    for_each_item<per_thread>(exec, change.records(), apply_map_change{}, change, there, view());
  }

private:
  struct blocks {
    blocks() = default;
    explicit blocks(int slots)
        : capacity(slots),
          memory([&](carver& c) { carve(c, map, slots, 1); }),
          staged(static_cast<std::size_t>(slots) * map_change::point_words),
          words(static_cast<std::size_t>(slots) * map_change::point_words) {}

    int capacity = 0;
    map_points_view map;
    arena<Exec::space> memory;
    buffer<std::uint32_t, staging_space<Exec>> staged;
    buffer<std::uint32_t, Exec::space> words;
  };
  blocks used_;
};

/// Memory of one size.
template <typename Exec>
struct local_blocks {
  int capacity = 0;  ///< points
  search_buffers buffers;
  int* slots = nullptr;
  visibility* seen = nullptr;
  recorded_sight* recorded = nullptr;
  int* staged_slots = nullptr;
  visibility* staged_sights = nullptr;
  recorded_sight* staged_recorded = nullptr;

  local_blocks() = default;
  /// @param windows least number of search windows @param keypoints per image
  local_blocks(int points, int windows, int keypoints, int cameras) : capacity(points) {
    int const room = std::max(points, windows);
    memory = arena<Exec::space>([&](carver& c) {
      c.place(points, slots);
      c.place({cameras, points}, seen, recorded);
      carve(c, buffers.windows, room, 1, cameras);
      carve(c, buffers.work, room, keypoints, 1, cameras);
    });
    staging = arena<staging_space<Exec>>([&](carver& c) {
      c.place(points, staged_slots);
      c.place({cameras, points}, staged_sights, staged_recorded);
    });
    std::fill_n(staged_slots, points, no_slot_yet);
  }

  static constexpr int no_slot_yet = -2;  ///< differs from every value that callers write
  arena<Exec::space> memory;
  arena<staging_space<Exec>> staging;
};

/// That of a local map.
template <typename Exec>
class local_memory {
public:
  /// @param keypoints per image
  local_memory(int keypoints, int cameras) : keypoints_(keypoints), cameras_(cameras) {}

  local_blocks<Exec>* operator->() { return &used_; }
  local_blocks<Exec> const* operator->() const { return &used_; }

  /// Makes room for `points`. Waits and allocates if there is less.
  /// @return whether the memory has moved
  bool reserve(Exec const& exec, int points) {
    if (points <= used_.capacity) { return false; }
    local_blocks<Exec> larger(size_of(points), cameras_ * keypoints_, keypoints_, cameras_);
    exec.wait();
    used_ = std::move(larger);
    // Candidates are prefetched before their count is known.
    auto const& work = used_.buffers.work;
    fill_bytes(exec, work.list, 0xff, work.list_bytes());
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
  local_blocks<Exec> used_;
  int keypoints_;
  int cameras_;
};

}  // namespace FT_ABI
}  // namespace ft::orbslam3
