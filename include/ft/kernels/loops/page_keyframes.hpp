// SPDX-License-Identifier: Apache-2.0
/// @file Stage: a map of some of the keyframes that are kept for loops.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/loop_archive.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/containers/odometry_map.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/map/detail/describe_point.hpp"
#include "ft/kernels/map/point_masks.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

/// A kept keyframe that enters a map.
struct paged_keyframe {
  int row;                       ///< of the archive
  std::int64_t time_ns;          ///< of its frame
  rigid<double> T_cw;            ///< map to camera, or to a multi_rig's body, in the map's unit
  similarity<double> T_map_row;  ///< points of the row to the map; its scale is that of their units
};

namespace detail {

/// Item: a slot of the map, for a keypoint of a keyframe or for nothing.
template <typename Rig>
struct page_slot {
  using scratch = no_scratch;
  Rig rig;
  pyramid_geometry levels;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int slot, loop_archive_view const& from,
                                 paged_keyframe const* keyframes, int count,
                                 odometry_map_view const& to) const {
    int const position = slot / from.points;
    int const i = slot % from.points;
    bool const there = position < count && i < from.count[keyframes[position].row];
    if (position < count && i == 0) { write_keyframe(keyframes[position], position, to.keyframes); }
    if (slot == 0) { write_counts(from, keyframes, count, to); }
    write_record(slot, there ? position : -1, to);
    if (there) {
      write_point(keyframes[position], from, from.at(keyframes[position].row) + i, slot, to);
    }
  }

private:
  FT_HOST_DEVICE static void write_counts(loop_archive_view const& from,
                                          paged_keyframe const* keyframes, int count,
                                          odometry_map_view const& to) {
    int alive = 0;
    for (int k = 0; k < count; ++k) { alive += from.count[keyframes[k].row]; }
    *to.keyframes.made = *to.keyframes.count = count;
    *to.records.made = *to.records.used = count * from.points;
    *to.records.alive = alive;
  }
  FT_HOST_DEVICE static void write_keyframe(paged_keyframe const& k, int position,
                                            keyframes_view const& to) {
    to.T_cw[position] = k.T_cw;
    to.time_ns[position] = k.time_ns;
    to.neighbour[position] = to.shared[position] = 0;
    for (int c = 0; c < to.cameras; ++c) { to.keypoints[position * to.cameras + c] = 0; }
  }
  /// @param position of the keyframe that sees the point; -1 = the slot is free
  FT_HOST_DEVICE static void write_record(int slot, int position, odometry_map_view const& to) {
    free_slot(to, 0, slot);
    point_records_view const& r = to.records;
    r.found_frame[slot] = 0;
    if (position < 0) { return; }
    r.number[slot] = slot + 1;
    r.visible[slot] = r.found[slot] = r.described[slot] = 1;
    r.mask(0, slot)[position / 64] = std::uint64_t{1} << (position % 64);
    get<field::observations>(to.points, slot) = 1;
  }
  FT_HOST_DEVICE void write_point(paged_keyframe const& k, loop_archive_view const& from,
                                  std::ptrdiff_t at, int slot, odometry_map_view const& to) const {
    vec3<strict_double> const in_row = widened(from.point[at]);
    auto const T = k.T_map_row.template cast<strict_double>();
    vec3<strict_double> const in_map = T * in_row;
    vec3<strict_double> seen = in_row;
    if constexpr (Rig::rectified) { seen = rig.to_camera(from.camera[at], in_row); }
    strict_float const distance =
        static_cast<float>((scalar::sqrt(dot(seen, seen)) * T.scale).value);
    strict_float const most = distance * levels.scale[octave(from.inv_sigma2[at])];
    map_points_view const& points = to.points;
    get<field::position>(points, slot) = narrowed(in_map);
    get<field::normal>(points, slot) = narrowed(unit_vector(in_map - T.t));
    get<field::max_distance>(points, slot) = most.value;
    get<field::min_distance>(points, slot) = (most / levels.scale[levels.levels - 1]).value;
    array_of<field::orb>(points)[slot] = from.orb[at];
    to.records.recent[static_cast<std::ptrdiff_t>(slot) * point_descriptors] = from.orb[at];
  }
  /// The first one with that variance, or with a larger one.
  FT_HOST_DEVICE int octave(float inv_sigma2) const {
    int l = 0;
    while (l + 1 < levels.levels && levels.inv_sigma2[l] > inv_sigma2) { ++l; }
    return l;
  }
};

}  // namespace detail

/// Replaces a map by the points of kept keyframes, each seen by its own alone: the keyframes get
/// the numbers 1, 2, ... in their order, and have no keypoints. Asynchronous on `exec`; allocates
/// nothing; one launch.
/// @param keyframes [count] executor memory @param map of batch 1
/// @throws bad_argument for more keyframes than the map has positions, or slots for
template <typename Exec, typename Rig>
void page_keyframes(Exec const& exec, Rig const& rig, pyramid_geometry const& levels,
                    loop_archive_view const& archive, paged_keyframe const* keyframes, int count,
                    odometry_map_view const& map) {
  detail::require_range("batch of a map of kept keyframes", map.keyframes.batch, 1, 1);
  detail::require_range("keyframes of a map of kept ones", count, 0,
                        min_of(map.keyframes.positions, map.records.slots / archive.points));
  for_each_item<per_thread>(exec, map.records.slots, detail::page_slot<Rig>{rig, levels}, archive,
                            keyframes, count, map);
}

}  // namespace FT_ABI
}  // namespace ft
