// SPDX-License-Identifier: Apache-2.0
/// @file Map points in executor memory, by slot: changes and growth.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <mutex>
#include <utility>

#include "ft/containers/map_points.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

/// Writes one record of a map change.
struct apply_map_change {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, map_change const& change,
                                 std::uint32_t const* words, map_points_view const& map) const {
    std::uint32_t const* at = words;
    if (item < change.positions) {
      at += item * map_change::position_words;
      map.position(slot(at)) = {number(at[1]), number(at[2]), number(at[3])};
      return;
    }
    item -= change.positions;
    at += change.positions * map_change::position_words;
    if (item < change.views) {
      at += item * map_change::view_words;
      map.normal(slot(at)) = {number(at[1]), number(at[2]), number(at[3])};
      map.min_distance(slot(at)) = number(at[4]);
      map.max_distance(slot(at)) = number(at[5]);
      return;
    }
    item -= change.views;
    at += change.views * map_change::view_words;
    if (item < change.descriptors) {
      at += item * map_change::descriptor_words;
      for (int w = 0; w < 8; ++w) { map.orb(slot(at)).words[w] = at[1 + w]; }
      return;
    }
    item -= change.descriptors;
    at += change.descriptors * map_change::descriptor_words + item * map_change::observation_words;
    map.observations(slot(at)) = static_cast<int>(at[1]);
  }

private:
  FT_HOST_DEVICE static int slot(std::uint32_t const* at) { return static_cast<int>(at[0]); }
  FT_HOST_DEVICE static float number(std::uint32_t bits) {
    float v;
    memcpy(&v, &bits, sizeof v);
    return v;
  }
};

/// Memory of a map, and of one change of all its points.
template <typename Exec>
class device_map {
  static constexpr memory_space space = Exec::space;
  static constexpr memory_space staging = staging_space<Exec>;

public:
  map_points_view const& view() const { return blocks_.map; }
  int capacity() const { return blocks_.map.capacity; }

  /// Allocates the memory for `slots` points that the next reserve() will use. From any thread.
  void prepare(int slots) {
    detail::require_range("map points", slots, 1, 1 << 26);
    blocks taken(slots);
    std::lock_guard<std::mutex> const lock(mutex_);
    retired_ = {};
    if (slots > next_.map.capacity) { next_ = std::move(taken); }
  }
  /// Makes room for `slots` points and keeps the current ones. Enqueues their copy. The old memory
  /// stays until the next prepare() or reserve(). Returns whether view() has changed.
  bool reserve(Exec const& exec, int slots) {
    if (slots <= capacity()) { return false; }
    std::unique_lock<std::mutex> lock(mutex_);
    if (next_.map.capacity < slots) {
      lock.unlock();
      prepare(slots);
      lock.lock();
    }
    blocks old = std::exchange(blocks_, std::exchange(next_, blocks{}));
    if (old.map.capacity > 0) { copy_map(exec, old.map, blocks_.map); }
    retired_ = std::move(old);
    return true;
  }

  /// Enqueues a change. Two changes need an exec.wait() in between.
  void change(Exec const& exec, map_change const& change, std::uint32_t const* words) {
    std::size_t const n = change.words();
    detail::require(n <= blocks_.staged.size(), "a change has one record a field and slot at most");
    std::memcpy(blocks_.staged.data(), words, n * sizeof *words);
    copy(exec, blocks_.words.data(), static_cast<std::uint32_t const*>(blocks_.staged.data()), n);
    for_each_item<per_thread>(exec, change.records(), apply_map_change{}, change,
                              static_cast<std::uint32_t const*>(blocks_.words.data()), blocks_.map);
  }

private:
  struct blocks {
    blocks() = default;
    explicit blocks(int slots)
        : memory([&](carver& c) { carve(c, map, slots, 1); }),
          staged(static_cast<std::size_t>(slots) * map_change::point_words),
          words(static_cast<std::size_t>(slots) * map_change::point_words) {}

    map_points_view map;
    arena<space> memory;
    buffer<std::uint32_t, staging> staged;
    buffer<std::uint32_t, space> words;
  };

  static void copy_map(Exec const& exec, map_points_view const& from, map_points_view const& to) {
    auto const n = static_cast<std::size_t>(from.capacity);
    auto const column = [&](auto* target, auto const* source) { copy(exec, target, source, n); };
    column(array_of<field::position>(to), array_of<field::position>(from));
    column(array_of<field::normal>(to), array_of<field::normal>(from));
    column(array_of<field::min_distance>(to), array_of<field::min_distance>(from));
    column(array_of<field::max_distance>(to), array_of<field::max_distance>(from));
    column(array_of<field::orb>(to), array_of<field::orb>(from));
    column(array_of<field::observations>(to), array_of<field::observations>(from));
  }

  blocks blocks_;
  std::mutex mutex_;
  blocks next_;
  blocks retired_;
};

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
