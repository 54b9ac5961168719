// SPDX-License-Identifier: Apache-2.0
/// @file Stage: a map whose keyframes are in another order.
#pragma once

#include "ft/containers/odometry_map.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/map/point_masks.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Item: a position of the keyframe ring.
struct order_keyframe {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int position, keyframes_view const& from,
                                 int const* place, keyframes_view const& to) const {
    int const now = place[position];
    if (now < 0) { return; }
    for (int i = g.rank(); i < from.numbers(); i += g.size()) {
      auto const a = from.at(0, position, i), b = to.at(0, now, i);
      to.x[b] = from.x[a];
      to.y[b] = from.y[a];
      to.right_x[b] = from.right_x[a];
      to.octave[b] = from.octave[a];
      to.holder[b] = from.holder[a];
      to.holder_number[b] = from.holder_number[a];
      to.aligned[b] = from.aligned[a];
    }
    if (g.rank() != 0) { return; }
    to.T_cw[now] = from.T_cw[position];
    to.time_ns[now] = from.time_ns[position];
    for (int c = 0; c < from.cameras; ++c) {
      to.keypoints[now * from.cameras + c] = from.keypoints[position * from.cameras + c];
    }
    int const neighbour = from.neighbour[position];
    bool const there = neighbour > 0 && from.holds(0, neighbour);
    to.neighbour[now] = there ? number_at(from, place[from.position(neighbour)]) : 0;
    to.shared[now] = there ? from.shared[position] : 0;
  }

private:
  /// Of the keyframe at a position that is in use.
  FT_HOST_DEVICE static int number_at(keyframes_view const& k, int position) {
    int const newest = k.position(*k.made);
    return *k.made - (newest - position + k.positions) % k.positions;
  }
};

/// Item: a slot of the map.
struct order_mask {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int slot, point_records_view const& from,
                                 int const* place, point_records_view const& to) const {
    position_set now;
    now.clear();
    each_position(from.mask(0, slot), from.words, [&](int p) { now.add(place[p]); });
    now.write(to.mask(0, slot), to.words);
  }
};

}  // namespace detail

/// Gives the keyframes of a map other numbers, of the same ones: so those become the newest ones
/// that an adjustment takes, and the last ones that leave. Points stay. Asynchronous on `exec`;
/// allocates nothing; two launches.
/// @param from, map the same map of batch 1, in other memory; of `map` the keyframes and the masks
///   of points are written
/// @param place [positions] executor memory: the position that each keyframe gets, among those that
///   are in use; -1 = there is none
/// @throws bad_argument for a batch, or for maps of another shape
template <typename Exec>
void order_keyframes(Exec const& exec, odometry_map_view const& from, int const* place,
                     odometry_map_view const& map) {
  detail::require_range("batch of a map whose keyframes are ordered", map.keyframes.batch, 1, 1);
  detail::require(from.keyframes.positions == map.keyframes.positions &&
                      from.keyframes.cameras == map.keyframes.cameras &&
                      from.keyframes.capacity == map.keyframes.capacity &&
                      from.records.slots == map.records.slots && from.keyframes.batch == 1,
                  "a map in another order has another shape");
  for_each_item<per_warp>(exec, map.keyframes.positions, detail::order_keyframe{}, from.keyframes,
                          place, map.keyframes);
  for_each_item<per_thread>(exec, map.records.slots, detail::order_mask{}, from.records, place,
                            map.records);
}

}  // namespace FT_ABI
}  // namespace ft
