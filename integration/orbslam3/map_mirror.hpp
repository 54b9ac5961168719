// SPDX-License-Identifier: Apache-2.0
/// @file The map points that the device knows: which slot each has, what was sent of it, what has
/// changed since.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <iterator>
#include <limits>
#include <unordered_map>
#include <vector>

#include "integration/orbslam3/change_queue.hpp"
#include "integration/orbslam3/device_tracker.hpp"

namespace ft {
namespace orbslam3 {

/// How changes of map points are found.
enum class change_detection {
  compare,  ///< every point of a call is read and compared with what was sent
  hooks,    ///< points pushed into the change_queue are read, others not
};

/// The float that gives `scaled` when multiplied by `factor`, where there is one near
/// scaled / factor; that quotient otherwise.
///
/// MapPoint shows its limits of distance times 0.8 and 1.2. Range tests multiply again and get
/// exactly what it shows. Two limits next to each other may be shown as one number (for 1.2 where
/// the product passes a power of two; there, the lower is taken), so what is recovered is the
/// stored one or its neighbour: 2^-23 off at most.
inline float unscaled(float scaled, float factor) {
  float const quotient = scaled / factor;
  if (!std::isfinite(quotient)) { return quotient; }
  float candidate = quotient;
  for (int step = 0; step < 2; ++step) {
    candidate = std::nextafter(candidate, -std::numeric_limits<float>::infinity());
  }
  for (int step = 0; step < 5; ++step) {
    float const product = candidate * factor;
    if (product == scaled) { return candidate; }
    candidate = std::nextafter(candidate, std::numeric_limits<float>::infinity());
  }
  return quotient;
}

/// A map point's fields as they were sent.
struct point_fields {
  float position[3];
  float normal[3];
  float limits[2];  ///< lowest and highest distance, raw, metres
  std::uint32_t descriptor[8];
  bool observed;
};

/// For one tracking thread; reads map points through their own locked functions. Map points live
/// until clear(): ORB-SLAM3 takes bad ones off its lists and keeps them in memory.
template <typename MapPoint>
class map_mirror {
public:
  map_mirror(device_tracker& device, change_detection detection, int capacity)
      : device_(&device), detection_(detection) {
    grow(capacity);
  }

  change_queue<MapPoint>& changes() { return changes_; }

  /// Before the points of a call are visited. With hooks: reads those that have changed.
  void begin_call() {
    ++call_;
    if (detection_ != change_detection::hooks) { return; }
    changes_.take(taken_);
    for (MapPoint* const point : taken_) {
      // By address: what is not known yet may still be under construction, and is left alone.
      auto const known = slot_by_address_.find(point);
      if (known == slot_by_address_.end()) { continue; }
      // Pushed twice: read once.
      if (records_[index(known->second)].read_in != call_) { refresh(known->second); }
    }
  }

  /// The slot of a point of this call; what has changed of it is noted for flush().
  /// @param likely a slot that it may have
  int visit(MapPoint* point, int likely = -1) {
    int slot = holds(likely, point) ? likely : find(point);
    if (slot < 0) {
      slot = add(point);
    } else if (detection_ == change_detection::compare && records_[index(slot)].read_in != call_) {
      refresh(slot);
    }
    entries_[index(slot)].used_in = call_;
    return slot;
  }
  /// After visit(): whether the point was bad when it was read.
  bool bad(int slot) const { return entries_[index(slot)].bad; }
  MapPoint* owner(int slot) const { return entries_[index(slot)].owner; }
  bool holds(int slot, MapPoint const* point) const {
    if (slot < 0 || slot >= capacity()) { return false; }
    // By number as well: another point may live where one was deleted.
    entry const& e = entries_[index(slot)];
    return e.owner == point && e.id == point->mnId;
  }

  /// Queues what has changed for the device.
  void flush() {
    change_.positions = count(positions_, map_change::position_words);
    change_.views = count(views_, map_change::view_words);
    change_.descriptors = count(descriptors_, map_change::descriptor_words);
    change_.observations = count(observations_, map_change::observation_words);
    if (change_.records() == 0) { return; }
    words_.clear();
    for (auto* part : {&positions_, &views_, &descriptors_, &observations_}) {
      words_.insert(words_.end(), part->begin(), part->end());
      part->clear();
    }
    device_->change_map(change_, words_.data());
  }

  /// Takes what memory `points` new ones need now, rather than in visit(); may wait for the device.
  void make_room_for(int points) {
    auto const enough = static_cast<std::size_t>(points);
    if (free_.size() < enough) { evict(); }
    if (free_.size() < enough) { grow(capacity() + std::max(capacity(), points)); }
  }

  /// Forgets a point that is about to be deleted.
  void forget(MapPoint const* point) {
    auto const known = slot_by_address_.find(point);
    if (known != slot_by_address_.end()) { release(known->second); }
  }

  /// Forgets all points, for a system that was reset.
  void clear() {
    changes_.take(taken_);
    for (int slot = capacity() - 1; slot >= 0; --slot) {
      if (owner(slot) != nullptr) { release(slot); }
    }
    for (auto* part : {&positions_, &views_, &descriptors_, &observations_}) { part->clear(); }
  }

  int capacity() const { return static_cast<int>(entries_.size()); }
  int size() const { return capacity() - static_cast<int>(free_.size()); }

private:
  /// What every call looks at: small, so that those of a local map stay in a cache.
  struct entry {
    MapPoint* owner = nullptr;
    std::size_t id = 0;
    std::uint32_t used_in = 0;  ///< call
    bool bad = false;
  };
  /// What is looked at where a point is read.
  struct record {
    std::uint32_t read_in = 0;  ///< call
    float shown[2] = {};        ///< the limits as the map point shows them
    point_fields sent{};
  };
  static constexpr std::uint32_t keep_unused = 1000;  ///< calls

  static std::size_t index(int slot) { return static_cast<std::size_t>(slot); }
  static int count(std::vector<std::uint32_t> const& words, int each) {
    return static_cast<int>(words.size()) / each;
  }

  int find(MapPoint const* point) const {
    std::size_t const id = point->mnId;
    int const slot = id < slot_of_.size() ? slot_of_[id] : -1;
    return holds(slot, point) ? slot : -1;
  }

  int add(MapPoint* point) {
    if (free_.empty()) { make_room(); }
    int const slot = free_.back();
    free_.pop_back();
    std::size_t const id = point->mnId;
    if (id >= slot_of_.size()) { slot_of_.resize(id + id / 2 + 1024, -1); }
    slot_of_[id] = slot;
    slot_by_address_[point] = slot;
    entries_[index(slot)].owner = point;
    entries_[index(slot)].id = id;
    record const& r = records_[index(slot)];
    read(slot);
    send_position(slot, r.sent);
    send_view(slot, r.sent);
    send_descriptor(slot, r.sent);
    send_observed(slot, r.sent);
    return slot;
  }

  void refresh(int slot) {
    point_fields const before = records_[index(slot)].sent;
    read(slot);
    point_fields const& now = records_[index(slot)].sent;
    if (differ(before.position, now.position)) { send_position(slot, now); }
    if (differ(before.normal, now.normal) || differ(before.limits, now.limits)) {
      send_view(slot, now);
    }
    if (differ(before.descriptor, now.descriptor)) { send_descriptor(slot, now); }
    if (before.observed != now.observed) { send_observed(slot, now); }
  }

  /// By the functions that the system's own code calls, each with its lock.
  void read(int slot) {
    MapPoint& p = *owner(slot);
    record& r = records_[index(slot)];
    point_fields& f = r.sent;
    auto const position = p.GetWorldPos();
    auto const normal = p.GetNormal();
    for (int i = 0; i < 3; ++i) {
      f.position[i] = position(i);
      f.normal[i] = normal(i);
    }
    float const lowest = p.GetMinDistanceInvariance();
    float const highest = p.GetMaxDistanceInvariance();
    // Divided again only where it has changed.
    float const shown[2] = {lowest, highest};
    if (differ(r.shown, shown)) {
      r.shown[0] = lowest;
      r.shown[1] = highest;
      f.limits[0] = unscaled(lowest, 0.8f);
      f.limits[1] = unscaled(highest, 1.2f);
    }
    auto const descriptor = p.GetDescriptor();
    if (descriptor.rows * descriptor.cols == 32) {
      std::memcpy(f.descriptor, descriptor.data, sizeof f.descriptor);
    }
    f.observed = p.Observations() > 0;
    entries_[index(slot)].bad = p.isBad();
    r.read_in = call_;
  }

  void send_position(int slot, point_fields const& f) {
    positions_.push_back(static_cast<std::uint32_t>(slot));
    push_bits(positions_, f.position);
  }
  void send_view(int slot, point_fields const& f) {
    views_.push_back(static_cast<std::uint32_t>(slot));
    push_bits(views_, f.normal);
    push_bits(views_, f.limits);
  }
  void send_descriptor(int slot, point_fields const& f) {
    descriptors_.push_back(static_cast<std::uint32_t>(slot));
    descriptors_.insert(descriptors_.end(), std::begin(f.descriptor), std::end(f.descriptor));
  }
  void send_observed(int slot, point_fields const& f) {
    observations_.push_back(static_cast<std::uint32_t>(slot));
    observations_.push_back(f.observed ? 1u : 0u);
  }
  template <std::size_t N>
  static void push_bits(std::vector<std::uint32_t>& words, float const (&values)[N]) {
    std::uint32_t bits[N];
    std::memcpy(bits, values, sizeof bits);
    words.insert(words.end(), bits, bits + N);
  }
  /// In any bit: a NaN that stays is no change.
  template <typename T, std::size_t N>
  static bool differ(T const (&a)[N], T const (&b)[N]) {
    return std::memcmp(a, b, sizeof a) != 0;
  }

  void release(int slot) {
    entry& e = entries_[index(slot)];
    int& listed = slot_of_[e.id];
    if (listed == slot) { listed = -1; }
    auto const known = slot_by_address_.find(e.owner);
    if (known != slot_by_address_.end() && known->second == slot) { slot_by_address_.erase(known); }
    e.owner = nullptr;
    e.bad = false;
    free_.push_back(slot);
  }

  /// Frees the slots of bad points and of those that no call has used for long. Never one of this
  /// call.
  void evict() {
    for (int slot = 0; slot < capacity(); ++slot) {
      entry const& e = entries_[index(slot)];
      bool const idle = e.used_in != call_ && records_[index(slot)].read_in != call_;
      if (e.owner != nullptr && idle && (e.bad || e.used_in + keep_unused < call_)) {
        release(slot);
      }
    }
  }
  void make_room() {
    evict();
    if (free_.size() < entries_.size() / 8 + 1) { grow(2 * capacity()); }
  }

  void grow(int capacity) {
    // What is noted goes to the slots there are.
    flush();
    device_->reserve_map(capacity);
    int const first = this->capacity();
    entries_.resize(index(capacity));
    records_.resize(index(capacity));
    for (int slot = capacity - 1; slot >= first; --slot) { free_.push_back(slot); }
  }

  device_tracker* device_;
  change_detection detection_;
  change_queue<MapPoint> changes_;
  std::vector<MapPoint*> taken_;
  std::vector<entry> entries_;   ///< by slot
  std::vector<record> records_;  ///< likewise
  std::vector<int> free_;
  std::vector<int> slot_of_;  ///< by MapPoint::mnId; -1 = none
  std::unordered_map<MapPoint const*, int> slot_by_address_;
  std::uint32_t call_ = 0;
  map_change change_;
  std::vector<std::uint32_t> positions_;
  std::vector<std::uint32_t> views_;
  std::vector<std::uint32_t> descriptors_;
  std::vector<std::uint32_t> observations_;
  std::vector<std::uint32_t> words_;
};

}  // namespace orbslam3
}  // namespace ft
