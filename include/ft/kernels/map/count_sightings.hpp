// SPDX-License-Identifier: Apache-2.0
/// @file Stage: counts in how many frames map points were in view, and in how many they were found.
#pragma once

#include "ft/containers/frame.hpp"
#include "ft/containers/odometry_map.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/map/choose_local_map.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

/// What count_sightings counts of a frame.
enum class sightings : int {
  none = 0,        ///< nothing: the frame was not tracked
  all = 1,         ///< points in view, and points found
  found_only = 2,  ///< points found: the camera was recovered, and what is in view is a guess's
  not_kept = 3,    ///< nothing: the frame was tracked in a map that is not changed
};

/// Inputs of count_sightings, apart from the frame and the map.
struct sightings_input {
  sightings const* kind = nullptr;   ///< [batch]
  visibility const* seen = nullptr;  ///< [cameras][batch][local.capacity] of the local map's search
  local_map_view local;
  point_stamps stamps;  ///< points matched from the last frame; its `seen` is not null
};

namespace detail {

/// Item: a slot, an entry of the local map or a keypoint number, of a batch entry.
struct count_sighting {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, frame_view const& frame,
                                 sightings_input const& in,
                                 point_records_view const& records) const {
    int const each = records.slots + in.local.capacity + frame.numbers();
    int const b = item / each;
    int i = item % each;
    if (in.kind[b] == sightings::none || in.kind[b] == sightings::not_kept) { return; }
    bool const in_view = in.kind[b] == sightings::all;
    if (i < records.slots) {
      bool const matched = in_view && in.stamps.stamped(b, records.slots, i);
      if (matched && records.holds_point(b, i)) {
        atomic_add(records.visible + records.at(b, i), 1);
      }
      return;
    }
    i -= records.slots;
    if (i < in.local.capacity) {
      if (in_view) { count_local(b, i, frame, in, records); }
      return;
    }
    count_found(b, i - in.local.capacity, frame, in.stamps.frame[b], records);
  }

private:
  FT_HOST_DEVICE static void count_local(int b, int i, frame_view const& frame,
                                         sightings_input const& in,
                                         point_records_view const& records) {
    if (i >= in.local.count[b]) { return; }
    std::ptrdiff_t const at = static_cast<std::ptrdiff_t>(b) * in.local.capacity + i;
    bool seen = false;
    for (int c = 0; c < frame.cameras; ++c) {
      std::ptrdiff_t const camera = static_cast<std::ptrdiff_t>(c) * frame.batch;
      seen = seen || in.seen[camera * in.local.capacity + at].level >= 0;
    }
    int const slot = in.local.slots[at];
    if (seen && records.holds_point(b, slot)) {
      atomic_add(records.visible + records.at(b, slot), 1);
    }
  }

  FT_HOST_DEVICE static void count_found(int b, int number, frame_view const& frame, int stamp,
                                         point_records_view const& records) {
    int const c = number / frame.capacity();
    if (number % frame.capacity() >= *frame.camera(b, c).count) { return; }
    int const slot = frame.holder[static_cast<std::ptrdiff_t>(b) * frame.numbers() + number];
    if (!records.holds_point(b, slot)) { return; }
    std::ptrdiff_t const at = records.at(b, slot);
    // Of the keypoints that hold the point one counts, whichever is first.
    if (atomic_exchange(records.found_frame + at, stamp) != stamp) {
      atomic_add(records.found + at, 1);
    }
  }
};

}  // namespace detail

/// Counts for each map point the frames that had it in view, which are those that matched it from
/// the last frame or that see it in the local map, and the frames with a keypoint that holds it.
/// Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec>
void count_sightings(Exec const& exec, frame_view const& frame, sightings_input const& in,
                     odometry_map_view const& map) {
  int const each = map.records.slots + in.local.capacity + frame.numbers();
  for_each_item<per_thread>(exec, frame.batch * each, detail::count_sighting{}, frame, in,
                            map.records);
}

}  // namespace FT_ABI
}  // namespace ft
