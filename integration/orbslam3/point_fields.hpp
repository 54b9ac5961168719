// SPDX-License-Identifier: Apache-2.0
/// @file The fields of a map point on the device: read under the point's own locks, noted for
/// the next upload.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <mutex>
#include <vector>

#include "ft/core/error.hpp"
#include "ft/interop/eigen.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft::orbslam3 {

/// The limits of distance that a MapPoint stores; it shows them multiplied, and two adjacent floats
/// may have the same product. A derived class may name the protected members.
template <typename MapPoint>
struct stored_limits : MapPoint {
  /// @param limits lowest and highest distance, metres
  static void read(MapPoint& p, float (&limits)[2]) {
    std::lock_guard<std::mutex> const lock(p.*(&stored_limits::mMutexPos));
    limits[0] = p.*(&stored_limits::mfMinDistance);
    limits[1] = p.*(&stored_limits::mfMaxDistance);
  }
};

/// A map point's values, as map_change has them: field after field.
struct point_fields {
  vec3<float> position;
  vec3<float> normal;
  float limits[2];  ///< lowest and highest distance, raw, metres
  std::uint32_t descriptor[8];
  std::uint32_t observed;  ///< 1 or 0

  /// The words of a field. @param which as in map_change
  unsigned char const* words(int which) const {
    auto const* at = reinterpret_cast<unsigned char const*>(this);
    for (int f = 0; f < which; ++f) { at += map_change::value_bytes(f); }
    return at;
  }
};
static_assert(sizeof(point_fields) == 4 * (map_change::point_words - map_change::fields),
              "without padding");

/// Whether any bit differs, so that an unchanged NaN does not count.
template <typename T>
bool differ(T const& a, T const& b) {
  return std::memcmp(&a, &b, sizeof a) != 0;
}

/// Reads a point by the functions that the system's own code calls, each with its lock, and its
/// stored limits.
/// @param f previous values, or zeros @return whether the point is bad
template <typename MapPoint>
bool read_fields(MapPoint& p, point_fields& f) {
  f.position = vec3_from_eigen(p.GetWorldPos());
  f.normal = vec3_from_eigen(p.GetNormal());
  stored_limits<MapPoint>::read(p, f.limits);
  auto const descriptor = p.GetDescriptor();
  if (descriptor.rows * descriptor.cols == 32) {
    std::memcpy(f.descriptor, descriptor.data, sizeof f.descriptor);
  }
  f.observed = p.Observations() > 0 ? 1 : 0;
  return p.isBad();
}

/// Records of the next map change, by field. Of several records of a slot the last one counts.
class noted_changes {
public:
  /// Allocates memory for all of `slots`.
  void reserve(int slots) {
    for (int f = 0; f < map_change::fields; ++f) {
      field_records& field = fields_[f];
      field.each = static_cast<std::size_t>(map_change::words_of(f));
      field.place.resize(static_cast<std::size_t>(slots), -1);
      field.words.reserve(static_cast<std::size_t>(slots) * field.each);
    }
  }
  /// Notes the fields of a point that have changed. @param before nullptr: all have
  void note(int slot, point_fields const& now, point_fields const* before) {
    for (int f = 0; f < map_change::fields; ++f) {
      std::size_t const n = map_change::value_bytes(f);
      if (before == nullptr || std::memcmp(now.words(f), before->words(f), n) != 0) {
        std::memcpy(record_of(fields_[f], slot), now.words(f), n);
      }
    }
  }
  /// Sends the noted changes to the device.
  void flush(device_tracker& device) {
    map_change change;
    for (int f = 0; f < map_change::fields; ++f) { change.count[f] = fields_[f].count(); }
    if (change.records() == 0) { return; }
    all_.clear();
    for (field_records const& field : fields_) {
      all_.insert(all_.end(), field.words.begin(), field.words.end());
    }
    clear();
    device.change_map(change, all_.data());
  }
  void clear() {
    for (field_records& field : fields_) {
      for (std::size_t at = 0; at < field.words.size(); at += field.each) {
        field.place[field.words[at]] = -1;
      }
      field.words.clear();
    }
  }

private:
  struct field_records {
    std::size_t each = 0;              ///< words of a record, slot included
    std::vector<std::uint32_t> words;  ///< records
    std::vector<int> place;            ///< by slot: first word of its record, -1 = none

    int count() const { return static_cast<int>(words.size() / each); }
  };

  /// The words after the slot.
  static std::uint32_t* record_of(field_records& field, int slot) {
    int& place = field.place[static_cast<std::size_t>(slot)];
    if (place < 0) {
      place = static_cast<int>(field.words.size());
      field.words.resize(field.words.size() + field.each);
      field.words[static_cast<std::size_t>(place)] = static_cast<std::uint32_t>(slot);
    }
    return &field.words[static_cast<std::size_t>(place) + 1];
  }

  field_records fields_[map_change::fields];
  std::vector<std::uint32_t> all_;
};

/// A number that threads may set to the same value at once.
class shared_number {
public:
  shared_number() = default;
  shared_number(shared_number const& other) : value_(other) {}
  shared_number& operator=(shared_number const& other) { return *this = std::uint32_t{other}; }
  shared_number& operator=(std::uint32_t value) {
    value_.store(value, std::memory_order_relaxed);
    return *this;
  }
  operator std::uint32_t() const { return value_.load(std::memory_order_relaxed); }

private:
  std::atomic<std::uint32_t> value_{0};
};

/// An array that grows by blocks: its elements never move.
template <typename T>
class block_array {
public:
  block_array() { blocks_.reserve(most / per_block); }
  /// Grows to at least `size` elements. @param initial value of new ones
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

}  // namespace ft::orbslam3
