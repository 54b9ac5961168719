// SPDX-License-Identifier: Apache-2.0
/// @file The map points on the device: the slot of each, the values that were sent, and the changes
/// since.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <mutex>
#include <thread>
#include <unordered_map>
#include <unordered_set>
#include <vector>

#include "ft/core/error.hpp"
#include "integration/orbslam3/change_queue.hpp"
#include "integration/orbslam3/options.hpp"
#include "integration/orbslam3/plain_types.hpp"
#include "integration/orbslam3/point_fields.hpp"

namespace ft::orbslam3 {

/// Reads map points under their own locks. With hooks, a thread of the mirror does so
/// while tracking does other work, also for points that tracking has not met yet. Each call of
/// tracking, from begin_call() to flush(), reads the remaining ones.
///
/// Map points live until forget() or clear(). Only the tracking thread may make calls; changes()
/// and forget() may be called from any thread.
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
    if (detection != change_detection::hooks) { changes_->close(); }
  }
  map_mirror(map_mirror const&) = delete;
  map_mirror& operator=(map_mirror const&) = delete;
  ~map_mirror() {
    changes_->stop();
    if (reader_.joinable()) { reader_.join(); }
    changes_->close();  // maps still have it
  }

  change_queue<MapPoint>& changes() { return *changes_; }
  /// For maps, which may outlive this.
  std::shared_ptr<change_queue<MapPoint>> const& shared_changes() const { return changes_; }

  /// Ends a call whose flush() was not reached.
  class call_end {
  public:
    explicit call_end(map_mirror& mirror) : mirror_(&mirror) {}
    call_end(call_end const&) = delete;
    call_end& operator=(call_end const&) = delete;
    ~call_end() { mirror_->end_call(); }

  private:
    map_mirror* mirror_;
  };

  /// To be called before the points of a call are visited. With hooks: reads the changed points.
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

  /// The slot of a point of this call. Its changes are noted for flush().
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
  /// Whether a point of this call needs no visit(), because it is in `slot` and hooks tell of its
  /// changes. Several threads may ask at once.
  bool keep(int slot, MapPoint const* point) {
    if (detection_ != change_detection::hooks || !holds(slot, point)) { return false; }
    entries_[index(slot)].used_in = call_;
    return true;
  }
  /// After visit(): the point's mnId.
  std::size_t id(int slot) const { return entries_[index(slot)].id; }
  /// After visit(): whether the point was bad when it was read.
  bool bad(int slot) const { return entries_[index(slot)].bad; }
  /// The point in a slot that the last call has visited.
  MapPoint* owner(int slot) const { return entries_[index(slot)].owner; }

  /// With hooks, between calls: copies what the device has, or is about to get, of a point after
  /// all that was pushed. Returns whether it has the point.
  bool copy(MapPoint const* point, point_fields& fields, bool& bad) {
    auto const lock = lock_first();
    if (detection_ != change_detection::hooks) { return false; }
    ++round_;
    look_at_changes(std::numeric_limits<std::size_t>::max());
    auto const known = slot_by_address_.find(point);
    if (known == slot_by_address_.end()) { return false; }
    fields = records_[index(known->second)].sent;
    bad = entries_[index(known->second)].bad;
    return true;
  }

  /// Enqueues the upload of the changes, and ends the call.
  void flush() {
    if (on_device_ < capacity_) {
      device_->reserve_map(capacity_);
      on_device_ = capacity_;
    }
    noted_.flush(*device_);
    end_call();
  }

  /// Forgets a point that is about to be deleted. Must not be called under its locks. The point is
  /// not read after the return.
  void forget(MapPoint const* point) {
    auto const lock = lock_first();
    changes_->forget(point);
    pushed_once_.erase(point);
    auto const known = slot_by_address_.find(point);
    if (known != slot_by_address_.end()) { release(known->second); }
  }

  /// Forgets all points; for a system reset.
  void clear() {
    auto const lock = lock_first();
    changes_->take(taken_, std::numeric_limits<std::size_t>::max());
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

  /// Read by every call: small, so that the entries of a local map stay in a cache.
  struct entry {
    MapPoint* owner = nullptr;
    std::size_t id = no_id;  ///< mnId; no_id until tracking meets the point
    shared_number used_in;   ///< last call
    bool bad = false;
  };
  /// Read when a point is read.
  struct record {
    std::uint32_t read_in = 0;  ///< round
    point_fields sent{};
  };
  /// A slot is freed if the last so many calls have not used its point; the first of these limits
  /// that frees enough slots is taken.
  static constexpr std::uint32_t keep_unused[] = {1000, 100, 12};
  /// Most points that the reader thread reads while tracking waits for the lock.
  static constexpr std::size_t at_a_time = 16;

  static std::size_t index(int slot) { return static_cast<std::size_t>(slot); }

  void end_call() {
    if (in_call_.owns_lock()) { in_call_.unlock(); }
  }
  /// Takes the lock before the reader thread, which otherwise might take it again and again.
  std::unique_lock<std::mutex> lock_first() {
    ++wanted_;
    std::unique_lock<std::mutex> lock(mutex_);
    --wanted_;
    return lock;
  }

  bool holds(int slot, MapPoint const* point) const {
    if (slot < 0 || slot >= capacity_) { return false; }
    // Compares the number, too: another point may have the address of a deleted one.
    entry const& e = entries_[index(slot)];
    return e.owner == point && e.id == point->mnId;
  }
  int find(MapPoint const* point) {
    std::size_t const id = point->mnId;
    int const slot = id < ids_.size() ? ids_[id] : -1;
    if (holds(slot, point)) { return slot; }
    // The reader thread knows the point by its address.
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
    noted_.note(slot, r.sent, nullptr);
    return slot;
  }
  void refresh(int slot) {
    record& r = records_[index(slot)];
    point_fields const before = r.sent;
    entries_[index(slot)].bad = read_fields(*owner(slot), r.sent);
    r.read_in = round_;
    noted_.note(slot, r.sent, &before);
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

  /// Reads the first `most` pushed points.
  void look_at_changes(std::size_t most) {
    changes_->take(taken_, most);
    for (MapPoint* const point : taken_) {
      auto const known = slot_by_address_.find(point);
      if (known != slot_by_address_.end()) {
        // Points that were pushed twice are read once.
        if (records_[index(known->second)].read_in != round_) { refresh(known->second); }
      } else if (!pushed_once_.insert(point).second) {
        // The first push may come from the constructor, before the point is complete. A later one
        // comes from the same thread after construction, or from a thread that was given the point.
        pushed_once_.erase(point);
        add(point);
      }
    }
  }
  /// The reader thread.
  void read_changes() {
    while (changes_->await()) {
      {
        std::lock_guard<std::mutex> const lock(mutex_);
        ++round_;
        look_at_changes(at_a_time);
      }
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
  /// Frees the slots of bad points and of points unused for long, never those of this call. Where
  /// that frees few, adds more; the device's memory then grows in flush().
  void make_room() {
    for (std::uint32_t const keep : keep_unused) {
      for (int slot = 0; slot < capacity_; ++slot) {
        entry const& e = entries_[index(slot)];
        if (e.owner == nullptr || e.used_in == call_) { continue; }
        if (e.bad || e.used_in + keep < call_) { release(slot); }
      }
      if (free_.size() > index(capacity_) / 8) { return; }
    }
    add_slots(capacity_);
  }

  device_tracker* device_;
  change_detection detection_;
  std::shared_ptr<change_queue<MapPoint>> changes_ = std::make_shared<change_queue<MapPoint>>();
  mutable std::mutex mutex_;  ///< guards all members below; taken before the locks of map points
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

}  // namespace ft::orbslam3
