// SPDX-License-Identifier: Apache-2.0
/// @file The fields of a map point on the device: read through the point's own functions, noted for
/// the next upload.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <iterator>
#include <limits>
#include <mutex>
#include <vector>

#include "integration/orbslam3/device_tracker.hpp"

namespace ft {
namespace orbslam3 {

/// The float near scaled / factor whose product with `factor` is `scaled`; without one, that
/// quotient.
///
/// MapPoint returns its distance limits times 0.8f and 1.2f. Range tests multiply again and get
/// exactly these values. Two adjacent limits may have the same product (for 1.2f, where it passes a
/// power of two; the lower limit is taken). So the result is the stored limit or its neighbour: at
/// most 2^-23 off.
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

/// The limit that octaves are predicted from, which MapPoint returns only as a product: one float
/// beside it gives another octave where limit / distance is a power of the scale factor, as it is
/// for a camera that stands still. A derived class may name the protected members.
template <typename MapPoint>
class stored_limit : MapPoint {
public:
  /// @param shown GetMaxDistanceInvariance()
  static float of(MapPoint& p, float shown) { return of<stored_limit>(p, shown, 0); }

private:
  template <typename Self>
  static auto of(MapPoint& p, float shown, int)
      -> decltype(static_cast<void>(&Self::mMutexPos), p.*(&Self::mfMaxDistance) * 1.0f) {
    float stored = 0;
    {
      std::lock_guard<std::mutex> const lock(p.*(&Self::mMutexPos));
      stored = p.*(&Self::mfMaxDistance);
    }
    return 1.2f * stored == shown ? stored : unscaled(shown, 1.2f);
  }
  /// A system whose map points have other members.
  template <typename Self>
  static float of(MapPoint& /*p*/, float shown, long) {
    return unscaled(shown, 1.2f);
  }
};

/// A map point's fields.
struct point_fields {
  float position[3];
  float normal[3];
  float limits[2];  ///< lowest and highest distance, raw, metres
  std::uint32_t descriptor[8];
  bool observed;
};

/// Whether any bit differs, so that an unchanged NaN does not count.
template <typename T, std::size_t N>
bool differ(T const (&a)[N], T const (&b)[N]) {
  return std::memcmp(a, b, sizeof a) != 0;
}

/// Reads a point by the functions that the system's own code calls, each with its lock.
/// @param f previous values, or zeros @return whether the point is bad
template <typename MapPoint>
bool read_fields(MapPoint& p, point_fields& f) {
  auto const position = p.GetWorldPos();
  auto const normal = p.GetNormal();
  for (int i = 0; i < 3; ++i) {
    f.position[i] = position(i);
    f.normal[i] = normal(i);
  }
  f.limits[0] = unscaled(p.GetMinDistanceInvariance(), 0.8f);
  f.limits[1] = stored_limit<MapPoint>::of(p, p.GetMaxDistanceInvariance());
  auto const descriptor = p.GetDescriptor();
  if (descriptor.rows * descriptor.cols == 32) {
    std::memcpy(f.descriptor, descriptor.data, sizeof f.descriptor);
  }
  f.observed = p.Observations() > 0;
  return p.isBad();
}

/// Records of the next map change, by field. Of several records of a slot the last one counts.
class noted_changes {
public:
  /// Allocates memory for all of `slots`.
  void reserve(int slots) {
    for (field_records& field : fields_) {
      field.place.resize(static_cast<std::size_t>(slots), -1);
      field.words.reserve(static_cast<std::size_t>(slots) * field.each);
    }
  }
  void note_position(int slot, point_fields const& f) { put(0, slot, f.position, 3); }
  void note_view(int slot, point_fields const& f) {
    float const values[5] = {f.normal[0], f.normal[1], f.normal[2], f.limits[0], f.limits[1]};
    put(1, slot, values, 5);
  }
  void note_descriptor(int slot, point_fields const& f) { put(2, slot, f.descriptor, 8); }
  void note_observed(int slot, point_fields const& f) {
    std::uint32_t const observed = f.observed ? 1u : 0u;
    put(3, slot, &observed, 1);
  }
  void note_all(int slot, point_fields const& f) {
    note_position(slot, f);
    note_view(slot, f);
    note_descriptor(slot, f);
    note_observed(slot, f);
  }

  /// Sends the noted changes to the device.
  void flush(device_tracker& device) {
    map_change change;
    change.positions = fields_[0].count();
    change.views = fields_[1].count();
    change.descriptors = fields_[2].count();
    change.observations = fields_[3].count();
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
    std::size_t each;                  ///< words of a record, slot included
    std::vector<std::uint32_t> words;  ///< records
    std::vector<int> place;            ///< by slot: first word of its record, -1 = none

    int count() const { return static_cast<int>(words.size() / each); }
  };

  void put(int which, int slot, void const* values, std::size_t n) {
    field_records& field = fields_[which];
    int& place = field.place[static_cast<std::size_t>(slot)];
    if (place < 0) {
      place = static_cast<int>(field.words.size());
      field.words.resize(field.words.size() + field.each);
      field.words[static_cast<std::size_t>(place)] = static_cast<std::uint32_t>(slot);
    }
    std::memcpy(&field.words[static_cast<std::size_t>(place) + 1], values,
                n * sizeof(std::uint32_t));
  }

  field_records fields_[4] = {{map_change::position_words, {}, {}},
                              {map_change::view_words, {}, {}},
                              {map_change::descriptor_words, {}, {}},
                              {map_change::observation_words, {}, {}}};
  std::vector<std::uint32_t> all_;
};

}  // namespace orbslam3
}  // namespace ft
