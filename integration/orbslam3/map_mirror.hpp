// SPDX-License-Identifier: Apache-2.0
/// @file The map points that the device knows: which slot each has, what was sent of it, what has
/// changed since.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <limits>
#include <memory>
#include <mutex>
#include <thread>
#include <unordered_map>
#include <unordered_set>
#include <vector>

#include "ft/core/error.hpp"
#include "integration/orbslam3/change_queue.hpp"
#include "integration/orbslam3/device_tracker.hpp"
#include "integration/orbslam3/point_fields.hpp"

namespace ft {
namespace orbslam3 {

/// How changes of map points are found.
enum class change_detection {
  compare,  ///< every point of a call is read and compared with what was sent
  hooks,    ///< points pushed into the change_queue are read, others not
};

/// An array that grows by blocks: what it has stays where it is.
template <typename T>
class block_array {
public:
  block_array() { blocks_.reserve(most / per_block); }
  /// At least `size` elements from now on. @param initial of new ones
  void reserve(std::size_t size, T const& initial) {
    detail::require(size <= most, "more map points than the shim can number");
    while (this->size() < size) {
      blocks_.push_back(std::make_unique<T[]>(per_block));
      std::fill_n(blocks_.back().get(), per_block, initial);
    }
  }
  std::size_t size() const { return blocks_.size() * per_block; }
  T& operator[](std::size_t i) { return blocks_[i / per_block][i % per_block]; }
  T const& operator[](std::size_t i) const { return blocks_[i / per_block][i % per_block]; }

private:
  static constexpr std::size_t per_block = 1 << 12;
  static constexpr std::size_t most = std::size_t{1} << 28;
  std::vector<std::unique_ptr<T[]>> blocks_;
};

/// Reads map points through their own locked functions. With hooks a thread of the mirror does so
/// while tracking is elsewhere, also for points that tracking has not met yet; it makes room
/// for more as well. A call of tracking, begin_call() to flush(), reads what is left.
///
/// Map points live until forget() or clear(). Calls of tracking are for one thread; changes() and
/// forget() for any.
template <typename MapPoint>
class map_mirror {
public:
  map_mirror(device_tracker& device, change_detection detection, int capacity)
      : device_(&device), detection_(detection) {
    detail::require_range("map_points", capacity, 1, 1 << 26);
    add_slots(capacity);
    ids_.reserve(1, -1);
    on_device_ = capacity_;
    device_->reserve_map(capacity_);
    if (detection != change_detection::hooks) { changes_.close(); }
  }
  map_mirror(map_mirror const&) = delete;
  map_mirror& operator=(map_mirror const&) = delete;
  ~map_mirror() {
    changes_.stop();
    if (reader_.joinable()) { reader_.join(); }
  }

  change_queue<MapPoint>& changes() { return changes_; }

  /// Ends a call that flush() has not ended.
  class call_end {
  public:
    explicit call_end(map_mirror& mirror) : mirror_(&mirror) {}
    call_end(call_end const&) = delete;
    call_end& operator=(call_end const&) = delete;
    ~call_end() { mirror_->end_call(); }

  private:
    map_mirror* mirror_;
  };

  /// Before the points of a call are visited. With hooks: reads those that have changed.
  void begin_call() {
    in_call_ = lock_first();
    ++call_;
    ++round_;
    if (detection_ != change_detection::hooks) { return; }
    look_at_changes(std::numeric_limits<std::size_t>::max());
    if (!reader_.joinable()) {
      reader_ = std::thread([this] { read_changes(); });
    }
  }

  /// The slot of a point of this call; what has changed of it is noted for flush().
  /// @param likely a slot that it may have
  int visit(MapPoint* point, int likely = -1) {
    int slot = holds(likely, point) ? likely : find(point);
    if (slot < 0) {
      slot = add(point);
      name(slot, point->mnId);
    } else if (detection_ == change_detection::compare && records_[index(slot)].read_in != round_) {
      refresh(slot);
    }
    entries_[index(slot)].used_in = call_;
    return slot;
  }
  /// After visit(): whether the point was bad when it was read.
  bool bad(int slot) const { return entries_[index(slot)].bad; }
  /// Of a slot that the last call has visited.
  MapPoint* owner(int slot) const { return entries_[index(slot)].owner; }

  /// Queues what has changed for the device, and ends the call.
  void flush() {
    if (on_device_ < capacity_) {
      device_->reserve_map(capacity_);
      on_device_ = capacity_;
    }
    noted_.flush(*device_);
    end_call();
  }

  /// Forgets a point that is about to be deleted; not under its locks. It is not read any more when
  /// this returns.
  void forget(MapPoint const* point) {
    auto const lock = lock_first();
    changes_.forget(point);
    pushed_once_.erase(point);
    auto const known = slot_by_address_.find(point);
    if (known != slot_by_address_.end()) { release(known->second); }
  }

  /// Forgets all points, for a system that was reset.
  void clear() {
    auto const lock = lock_first();
    changes_.take(taken_, std::numeric_limits<std::size_t>::max());
    pushed_once_.clear();
    for (int slot = capacity_ - 1; slot >= 0; --slot) {
      if (owner(slot) != nullptr) { release(slot); }
    }
    noted_.clear();
  }

  int capacity() const {
    std::lock_guard<std::mutex> const lock(mutex_);
    return capacity_;
  }
  int size() const {
    std::lock_guard<std::mutex> const lock(mutex_);
    return capacity_ - static_cast<int>(free_.size());
  }

private:
  static constexpr std::size_t no_id = std::numeric_limits<std::size_t>::max();

  /// What every call looks at: small, so that those of a local map stay in a cache.
  struct entry {
    MapPoint* owner = nullptr;
    std::size_t id = no_id;     ///< mnId; no_id until tracking meets the point
    std::uint32_t used_in = 0;  ///< call
    bool bad = false;
  };
  /// What is looked at where a point is read.
  struct record {
    std::uint32_t read_in = 0;  ///< round
    point_fields sent{};
  };
  /// Of calls that a point was in none of, before its slot is given away: the first one that yields
  /// enough slots.
  static constexpr std::uint32_t keep_unused[] = {1000, 100, 12};
  /// Points that the reader reads while tracking waits for it at most.
  static constexpr std::size_t at_a_time = 16;
  static constexpr int evicted_at_a_time = 2048;  ///< slots looked at

  static std::size_t index(int slot) { return static_cast<std::size_t>(slot); }

  void end_call() {
    if (in_call_.owns_lock()) { in_call_.unlock(); }
  }
  /// Before the reader, which else might take the lock again and again.
  std::unique_lock<std::mutex> lock_first() {
    ++wanted_;
    std::unique_lock<std::mutex> lock(mutex_);
    --wanted_;
    return lock;
  }

  bool holds(int slot, MapPoint const* point) const {
    if (slot < 0 || slot >= capacity_) { return false; }
    // By number as well: another point may live where one was deleted.
    entry const& e = entries_[index(slot)];
    return e.owner == point && e.id == point->mnId;
  }
  int find(MapPoint const* point) {
    std::size_t const id = point->mnId;
    int const slot = id < ids_.size() ? ids_[id] : -1;
    if (holds(slot, point)) { return slot; }
    // The reader knows it by its address.
    auto const known = slot_by_address_.find(point);
    if (known == slot_by_address_.end()) { return -1; }
    if (entries_[index(known->second)].id != no_id) {  // that one was deleted
      release(known->second);
      return -1;
    }
    name(known->second, id);
    return known->second;
  }
  void name(int slot, std::size_t id) {
    ids_.reserve(id + 1, -1);
    ids_[id] = slot;
    entries_[index(slot)].id = id;
  }

  int add(MapPoint* point) {
    if (free_.empty()) { make_room(); }
    int const slot = free_.back();
    free_.pop_back();
    slot_by_address_[point] = slot;
    entry& e = entries_[index(slot)];
    e.owner = point;
    e.used_in = call_;
    record& r = records_[index(slot)];
    r = {};
    r.read_in = round_;
    e.bad = read_fields(*point, r.sent);
    noted_.note_all(slot, r.sent);
    return slot;
  }
  void refresh(int slot) {
    record& r = records_[index(slot)];
    point_fields const before = r.sent;
    entries_[index(slot)].bad = read_fields(*owner(slot), r.sent);
    r.read_in = round_;
    point_fields const& now = r.sent;
    if (differ(before.position, now.position)) { noted_.note_position(slot, now); }
    if (differ(before.normal, now.normal) || differ(before.limits, now.limits)) {
      noted_.note_view(slot, now);
    }
    if (differ(before.descriptor, now.descriptor)) { noted_.note_descriptor(slot, now); }
    if (before.observed != now.observed) { noted_.note_observed(slot, now); }
  }
  void release(int slot) {
    entry& e = entries_[index(slot)];
    if (e.id != no_id && ids_[e.id] == slot) { ids_[e.id] = -1; }
    auto const known = slot_by_address_.find(e.owner);
    if (known != slot_by_address_.end() && known->second == slot) { slot_by_address_.erase(known); }
    e = {};
    free_.push_back(slot);
  }

  // ---- changes

  /// Reads the first `most` points that were pushed.
  void look_at_changes(std::size_t most) {
    changes_.take(taken_, most);
    for (MapPoint* const point : taken_) {
      auto const known = slot_by_address_.find(point);
      if (known != slot_by_address_.end()) {
        // Pushed twice: read once.
        if (records_[index(known->second)].read_in != round_) { refresh(known->second); }
      } else if (!pushed_once_.insert(point).second) {
        // The first push may come from the constructor, which is still at work then. One after it
        // comes from the same thread once it is done, or from one that was given the point.
        pushed_once_.erase(point);
        add(point);
      }
    }
  }
  /// The reader thread.
  void read_changes() {
    while (changes_.await()) {
      {
        std::lock_guard<std::mutex> const lock(mutex_);
        ++round_;
        look_at_changes(at_a_time);
      }
      keep_room();
      while (wanted_ > 0) { std::this_thread::yield(); }
    }
  }

  // ---- room

  void add_slots(int count) {
    int const first = capacity_;
    capacity_ += count;
    entries_.reserve(index(capacity_), {});
    records_.reserve(index(capacity_), {});
    noted_.reserve(capacity_);
    free_.reserve(index(capacity_));
    slot_by_address_.reserve(index(capacity_));
    for (int slot = capacity_ - 1; slot >= first; --slot) { free_.push_back(slot); }
  }
  /// Gives slots in [first, last) away: of bad points and of those that no call had for long. Never
  /// one of this call.
  void evict(int first, int last, std::uint32_t keep) {
    for (int slot = first; slot < last; ++slot) {
      entry const& e = entries_[index(slot)];
      if (e.owner == nullptr || e.used_in == call_) { continue; }
      if (e.bad || e.used_in + keep < call_) { release(slot); }
    }
  }
  bool has_room(int share) const { return free_.size() > entries() / index(share); }
  std::size_t entries() const { return index(capacity_); }
  /// Within a call. The device's memory grows with flush().
  void make_room() {
    for (std::uint32_t const keep : keep_unused) {
      evict(0, capacity_, keep);
      if (has_room(8)) { return; }
    }
    add_slots(capacity_);
  }
  /// By the reader: a quarter of all slots is free, or will be. Little at a time under the lock.
  void keep_room() {
    for (std::uint32_t const keep : keep_unused) {
      for (int first = 0;; first += evicted_at_a_time) {
        while (wanted_ > 0) { std::this_thread::yield(); }
        std::lock_guard<std::mutex> const lock(mutex_);
        if (has_room(4)) { return; }
        if (first >= capacity_) { break; }
        evict(first, std::min(first + evicted_at_a_time, capacity_), keep);
      }
    }
    int wanted = 0;
    {
      std::lock_guard<std::mutex> const lock(mutex_);
      wanted = 2 * capacity_;
    }
    try {
      device_->prepare_map(wanted);
      std::lock_guard<std::mutex> const lock(mutex_);
      if (capacity_ < wanted) { add_slots(wanted - capacity_); }
    } catch (std::exception const&) {  // the call that needs the memory tries again, and says so
    }
  }

  device_tracker* device_;
  change_detection detection_;
  change_queue<MapPoint> changes_;
  mutable std::mutex mutex_;  ///< of all that follows; taken before map points' own
  std::unique_lock<std::mutex> in_call_;
  std::atomic<int> wanted_{0};
  std::vector<MapPoint*> taken_;
  block_array<entry> entries_;   ///< by slot
  block_array<record> records_;  ///< likewise
  block_array<int> ids_;         ///< slot by MapPoint::mnId; -1 = none
  std::vector<int> free_;
  std::unordered_map<MapPoint const*, int> slot_by_address_;
  std::unordered_set<MapPoint const*> pushed_once_;
  noted_changes noted_;
  int capacity_ = 0;
  int on_device_ = 0;  ///< slots
  std::uint32_t call_ = 0;
  std::uint32_t round_ = 0;
  std::thread reader_;
};

}  // namespace orbslam3
}  // namespace ft
