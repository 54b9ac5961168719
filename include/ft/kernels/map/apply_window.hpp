// SPDX-License-Identifier: Apache-2.0
/// @file Stage: brings the result of an adjustment into the map.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/odometry_map.hpp"
#include "ft/containers/window_problem.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/map/detail/describe_point.hpp"
#include "ft/kernels/map/gather_window.hpp"
#include "ft/kernels/map/point_masks.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// The result of a batch entry's adjustment, and where it belongs.
struct window_result {
  using motion = rigid<strict_double>;
  window_problem_view const& problem;
  window_sources_view const& sources;
  odometry_map_view const& map;
  int b;

  FT_HOST_DEVICE keyframes_view const& keyframes() const { return map.keyframes; }
  FT_HOST_DEVICE int keyframe(int v) const { return sources.keyframe[problem.view(b, v)]; }
  /// Number of the newest keyframe of the window.
  FT_HOST_DEVICE int last() const { return keyframe(problem.view_count[b] - 1); }
  /// Whether there is a result, and the keyframes that it is for.
  FT_HOST_DEVICE bool holds(int flag) const {
    return flag != 0 && problem.view_count[b] >= 1 && problem.outcome[b].valid != 0 &&
           keyframes().holds(b, last());
  }
  FT_HOST_DEVICE rigid<double>& T_cw(int number) const {
    return keyframes().T_cw[keyframes().at(b, keyframes().position(number))];
  }
  FT_HOST_DEVICE motion of_view(int v) const {
    return problem.T_cw[problem.view(b, v)].template cast<strict_double>().orthonormalized();
  }
};

/// Item: a batch entry. Moves keyframes and the camera.
struct apply_to_keyframes {
  using motion = window_result::motion;
  struct scratch {
    rigid<double> correction;
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, int const* flags,
                                 window_problem_view const& problem,
                                 window_sources_view const& sources, odometry_map_view const& map,
                                 rigid<double>* T_cw) const {
    window_result const r{problem, sources, map, b};
    if (!r.holds(flags[b])) {
      if (g.rank() == 0) { sources.correction[b] = rigid<double>::identity(); }
      return;
    }
    int const last = r.last();
    if (g.rank() == 0) {
      motion const before = r.T_cw(last).template cast<strict_double>();
      motion const correction = before.inverse() * r.of_view(problem.view_count[b] - 1);
      s.correction = correction.template cast<double>();
      sources.correction[b] = s.correction;
      T_cw[b] = moved(T_cw[b], correction);
    }
    g.sync();
    motion const correction = s.correction.template cast<strict_double>();
    int const views = problem.view_count[b];
    for (int v = problem.fixed_count[b] + g.rank(); v < views; v += g.size()) {
      int const number = r.keyframe(v);
      if (!map.keyframes.holds(b, number)) { continue; }
      r.T_cw(number) = r.of_view(v).template cast<double>();
    }
    for (int number = last + 1 + g.rank(); number <= map.keyframes.made[b]; number += g.size()) {
      r.T_cw(number) = moved(r.T_cw(number), correction);
    }
  }

private:
  FT_HOST_DEVICE static rigid<double> moved(rigid<double> const& T_cw, motion const& correction) {
    return (T_cw.template cast<strict_double>() * correction)
        .orthonormalized()
        .template cast<double>();
  }
};

/// Item: some points of a batch entry's window, or some of its map's slots. After
/// apply_to_keyframes. A warp has a point of the window, or 32 slots.
struct apply_to_points {
  using scratch = no_scratch;
  using motion = window_result::motion;
  static constexpr int own_points = 16;      ///< of the window, of an item
  static constexpr int own_slots = 32 * 16;  ///< of the map, of an item

  /// Items of a batch entry.
  FT_HOST_DEVICE static int items(window_problem_view const& problem,
                                  odometry_map_view const& map) {
    return ceil_div(problem.points, own_points) + ceil_div(map.records.slots, own_slots);
  }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, int const* flags,
                                 window_problem_view const& problem,
                                 window_sources_view const& sources,
                                 odometry_map_view const& map) const {
    int const b = item / items(problem, map);
    int const i = item % items(problem, map);
    window_result const r{problem, sources, map, b};
    if (!r.holds(flags[b])) { return; }
    position_set newer;
    newer.assign(map.keyframes, r.last() + 1, map.keyframes.made[b]);
    int const of_window = ceil_div(problem.points, own_points);
    if (i < of_window) {
      int const end = min_of(problem.point_count[b], own_points * (i + 1));
      for (int p = own_points * i + g.part_index(); p < end; p += g.parts()) {
        apply_point(g.part(), r, p, newer);
      }
    } else if (map.keyframes.made[b] > r.last()) {
      int const end = min_of(map.records.used[b], own_slots * (i - of_window + 1));
      for (int slot = own_slots * (i - of_window) + g.rank(); slot < end; slot += g.size()) {
        bool const is = map.records.holds_point(b, slot) && !of_the_window(r, slot);
        if (is) { move_newer_point(r, slot, newer); }
      }
    }
  }

private:
  /// Whether the window has the point of a slot.
  FT_HOST_DEVICE static bool of_the_window(window_result const& r, int slot) {
    std::ptrdiff_t const record = r.map.records.at(r.b, slot);
    int const p = r.sources.point_of_slot[record];
    return p >= 0 && r.sources.number[r.problem.point(r.b, p)] == r.map.records.number[record];
  }

  /// A point that only newer keyframes see moves with these.
  FT_HOST_DEVICE static void move_newer_point(window_result const& r, int slot,
                                              position_set const& newer) {
    point_records_view const& records = r.map.records;
    if (!newer.contains(position_set::of(records.mask(r.b, slot), records.words))) { return; }
    motion const to = r.sources.correction[r.b].template cast<strict_double>().inverse();
    map_points_view const points = r.map.points.slice(r.b);
    auto& position = get<field::position>(points, slot);
    auto& normal = get<field::normal>(points, slot);
    position = narrowed(to * widened(position));
    normal = narrowed(unit_vector(to.R * widened(normal)));
  }

  /// Applies the result of a point of the window, by a warp.
  template <typename Part>
  FT_HOST_DEVICE static void apply_point(Part part, window_result const& r, int p,
                                         position_set const& newer) {
    int const slot = r.sources.slot[r.problem.point(r.b, p)];
    std::ptrdiff_t const record = r.map.records.at(r.b, slot);
    if (r.map.records.number[record] != r.sources.number[r.problem.point(r.b, p)]) { return; }
    position_set seen = position_set::of(r.map.records.mask(r.b, slot), r.map.records.words);
    part.sync();
    if (part.rank() == 0) {
      if (r.keyframes().made[r.b] > r.last()) { move_newer_point(r, slot, newer); }
      move_point(r, p, slot, seen);
    }
    if (!drop_outliers(part, r, p, seen) || part.rank() != 0) { return; }
    seen.write(r.map.records.mask(r.b, slot), r.map.records.words);
    get<field::observations>(r.map.points.slice(r.b), slot) = seen.count();
    if (seen.count() == 0) {
      free_slot(r.map, r.b, slot);
      atomic_add(r.map.records.alive + r.b, -1);
    }
  }

  /// Moves a point, unless its distance from its oldest keyframe changes beyond belief.
  FT_HOST_DEVICE static void move_point(window_result const& r, int p, int slot,
                                        position_set const& seen) {
    map_points_view const points = r.map.points.slice(r.b);
    vec3<double> const to = r.problem.position[r.problem.point(r.b, p)];
    vec3<float> const next = {static_cast<float>(to.x), static_cast<float>(to.y),
                              static_cast<float>(to.z)};
    keyframes_view const& keyframes = r.keyframes();
    int const oldest = seen.first(keyframes.position(keyframes.oldest(r.b)));
    auto const centre =
        keyframes.T_cw[keyframes.at(r.b, oldest)].template cast<strict_double>().centre();
    auto const distance = [&](vec3<float> at) {
      auto const view = widened(at) - centre;
      return scalar::sqrt(dot(view, view));
    };
    auto& position = get<field::position>(points, slot);
    strict_double const factor = distance(next) / distance(position);
    if (!(factor > 0.5 && factor < 2.0)) { return; }  // not a number either
    strict_float const scale = static_cast<float>(factor.value);
    auto& least = get<field::min_distance>(points, slot);
    auto& most = get<field::max_distance>(points, slot);
    position = next;
    least = (strict_float(least) * scale).value;
    most = (strict_float(most) * scale).value;
  }

  /// Drops the observations of a point that are outliers, a view a thread.
  /// @param[in,out] seen keyframes that see the point @return whether there were any
  template <typename Part>
  FT_HOST_DEVICE static bool drop_outliers(Part part, window_result const& r, int p,
                                           position_set& seen) {
    keyframes_view const& keyframes = r.keyframes();
    int const views = r.problem.view_count[r.b];
    bool dropped = false;
    for (int first = 0; first < views; first += part.size()) {
      int const v = first + part.rank();
      int const number = v < views ? r.keyframe(v) : 0;
      bool const there = v < views && keyframes.holds(r.b, number);
      dropped_observations const of_view =
          there ? drop_from_view(r, p, v, number) : dropped_observations{};
      dropped = part.any(of_view.any) || dropped;
      int const position = of_view.all ? keyframes.position(number) : 0;
      for (unsigned rest = part.ballot(of_view.all); rest != 0; rest &= rest - 1) {
        seen.remove(part.shuffle(position, trailing_zeros(rest)));
      }
    }
    return dropped;
  }

  struct dropped_observations {
    bool any = false;
    bool all = false;  ///< the keyframe does not see the point any more
  };

  /// Of one whose right column alone is far off, the keypoint stays an observation of its left
  /// pixel.
  FT_HOST_DEVICE static dropped_observations drop_from_view(window_result const& r, int p, int v,
                                                            int number) {
    keyframes_view const& keyframes = r.keyframes();
    int const position = keyframes.position(number);
    int seen = 0;
    int outliers = 0;
    for (int c = 0; c < r.problem.cameras; ++c) {
      std::ptrdiff_t const at = r.problem.sighting(r.b, p, v, c);
      if (!(r.problem.seen[at].inv_sigma2 > 0)) { continue; }
      ++seen;
      unsigned const outlier = r.problem.outlier[at];
      if (outlier == 0) { continue; }
      std::ptrdiff_t const keypoint = keyframes.at(r.b, position, r.sources.keypoint[at]);
      if ((outlier & outlying_pixel) != 0) {
        keyframes.holder[keypoint] = -1;
        keyframes.holder_number[keypoint] = 0;
        ++outliers;
      } else if ((outlier & outlying_right) != 0) {
        keyframes.right_x[keypoint] = -1.0f;
      }
    }
    return {outliers > 0, outliers > 0 && outliers == seen};
  }
};

}  // namespace detail

/// Brings the results of the batch entries whose flag is set into the map, as far as the keyframes
/// and points are still there.
///
/// - Moving keyframes get their new poses, with orthonormal rotations.
/// - The newest keyframe of the window moved by C = T_old^-1 T_new. The camera's last pose,
/// keyframes
///   that are newer than the window (T_cw C), and points that only these see (C^-1 p) follow it.
/// - Points get their new positions. One whose distance from the oldest keyframe that sees it
/// changes
///   to less than half or more than twice stays; that is chance, not knowledge. The limits of
///   distance are scaled with the distance.
/// - Outlying observations are dropped, and so are points that lose their last one. Of one whose
///   right column alone is far off only that is dropped.
///
/// Where `outcome.valid` is 0, or the window's newest keyframe has gone, nothing is changed.
/// `sources.correction` is C, or the identity where nothing is.
/// Asynchronous on `exec`; allocates nothing; two launches.
/// @param flags [batch] 1 = apply
/// @param T_cw [batch] last pose of the camera, world to left camera, metres; in and out
template <typename Exec>
void apply_window(Exec const& exec, int const* flags, window_problem_view const& problem,
                  window_sources_view const& sources, odometry_map_view const& map,
                  rigid<double>* T_cw) {
  for_each_item<per_block<64>>(exec, problem.batch, detail::apply_to_keyframes{}, flags, problem,
                               sources, map, T_cw);
  int const items = problem.batch * detail::apply_to_points::items(problem, map);
  for_each_item<per_block<256>>(exec, items, detail::apply_to_points{}, flags, problem, sources,
                                map);
}

}  // namespace FT_ABI
}  // namespace ft
