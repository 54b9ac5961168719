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
#include "ft/core/geometry.hpp"
#include "ft/kernels/map/describe_point.hpp"
#include "ft/kernels/map/gather_window.hpp"
#include "ft/kernels/map/point_masks.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Item: a batch entry.
struct apply_result {
  using motion = rigid<strict_double>;
  struct scratch {
    rigid<double> correction;  ///< old to new camera frame of the window's newest keyframe, inverse
    position_set newer;        ///< keyframes newer than the window
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, int const* flags,
                                 window_problem_view const& problem,
                                 window_sources_view const& sources, odometry_map_view const& map,
                                 rigid<double>* T_cw) const {
    if (flags[b] == 0 || problem.view_count[b] < 1 || problem.outcome[b].valid == 0) { return; }
    int const last = sources.keyframe[problem.view(b, problem.view_count[b] - 1)];
    keyframes_view const& keyframes = map.keyframes;
    if (!keyframes.holds(b, last)) { return; }
    task const t{problem, sources, map, b};
    if (g.rank() == 0) {
      motion const before = pose_of(keyframes, b, last);
      motion const after = result(t, problem.view_count[b] - 1);
      motion const correction = before.inverse() * after;
      s.correction = correction.template cast<double>();
      s.newer.assign(keyframes, last + 1, keyframes.made[b]);
      T_cw[b] = moved(T_cw[b], correction);
    }
    g.sync();
    motion const correction = s.correction.template cast<strict_double>();
    move_keyframes(g, t, last, correction);
    if (keyframes.made[b] > last) { move_newer_points(g, t, s.newer, correction.inverse()); }
    g.sync();
    for (int p = g.rank(); p < problem.point_count[b]; p += g.size()) {
      int const slot = sources.slot[problem.point(b, p)];
      if (map.records.number[map.records.at(b, slot)] != sources.number[problem.point(b, p)]) {
        continue;
      }
      move_point(t, p, slot);
      drop_outliers(t, p, slot);
    }
  }

private:
  struct task {
    window_problem_view const& problem;
    window_sources_view const& sources;
    odometry_map_view const& map;
    int b;
  };

  FT_HOST_DEVICE static motion pose_of(keyframes_view const& keyframes, int b, int number) {
    return keyframes.T_cw[keyframes.at(b, keyframes.position(number))]
        .template cast<strict_double>();
  }
  FT_HOST_DEVICE static motion result(task const& t, int v) {
    return t.problem.T_cw[t.problem.view(t.b, v)].template cast<strict_double>().orthonormalized();
  }
  FT_HOST_DEVICE static rigid<double> moved(rigid<double> const& T_cw, motion const& correction) {
    return (T_cw.template cast<strict_double>() * correction)
        .orthonormalized()
        .template cast<double>();
  }

  template <typename Group>
  FT_HOST_DEVICE static void move_keyframes(Group g, task const& t, int last,
                                            motion const& correction) {
    keyframes_view const& keyframes = t.map.keyframes;
    int const views = t.problem.view_count[t.b];
    int const made = keyframes.made[t.b];
    for (int v = t.problem.fixed_count[t.b] + g.rank(); v < views; v += g.size()) {
      int const number = t.sources.keyframe[t.problem.view(t.b, v)];
      if (!keyframes.holds(t.b, number)) { continue; }
      keyframes.T_cw[keyframes.at(t.b, keyframes.position(number))] =
          result(t, v).template cast<double>();
    }
    for (int number = last + 1 + g.rank(); number <= made; number += g.size()) {
      auto& T = keyframes.T_cw[keyframes.at(t.b, keyframes.position(number))];
      T = moved(T, correction);
    }
  }

  /// Points that only newer keyframes see move with these.
  template <typename Group>
  FT_HOST_DEVICE static void move_newer_points(Group g, task const& t, position_set const& newer,
                                               motion const& to) {
    point_records_view const& r = t.map.records;
    map_points_view const points = t.map.points.slice(t.b);
    for (int slot = g.rank(); slot < r.used[t.b]; slot += g.size()) {
      if (!r.holds_point(t.b, slot) || !newer.contains(r.mask(t.b, slot), r.words)) { continue; }
      auto& position = get<field::position>(points, slot);
      auto& normal = get<field::normal>(points, slot);
      position = narrowed(to * widened(position));
      normal = narrowed(unit_vector(to.R * widened(normal)));
    }
  }

  /// Moves a point, unless its distance from its oldest keyframe changes beyond belief.
  FT_HOST_DEVICE static void move_point(task const& t, int p, int slot) {
    map_points_view const points = t.map.points.slice(t.b);
    vec3<double> const to = t.problem.position[t.problem.point(t.b, p)];
    vec3<float> const next = {static_cast<float>(to.x), static_cast<float>(to.y),
                              static_cast<float>(to.z)};
    keyframes_view const& keyframes = t.map.keyframes;
    int oldest = -1;
    each_observer(keyframes, t.b, t.map.records.mask(t.b, slot),
                  [&](int position) { oldest = oldest < 0 ? position : oldest; });
    auto const centre =
        keyframes.T_cw[keyframes.at(t.b, oldest)].template cast<strict_double>().centre();
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

  /// Drops the observations of a point that are outliers, and the point with the last of them.
  FT_HOST_DEVICE static void drop_outliers(task const& t, int p, int slot) {
    window_problem_view const& problem = t.problem;
    std::uint64_t* const mask = t.map.records.mask(t.b, slot);
    bool dropped = false;
    for (int v = 0; v < problem.view_count[t.b]; ++v) {
      int seen = 0;
      int outliers = 0;
      for (int c = 0; c < problem.cameras; ++c) {
        std::ptrdiff_t const at = problem.sighting(t.b, p, v, c);
        bool const is_seen = problem.seen[at].inv_sigma2 > 0;
        bool const is_outlier = is_seen && (problem.outlier[at] & outlying_pixel) != 0;
        bool const drops_right = is_seen && (problem.outlier[at] & outlying_right) != 0;
        seen += static_cast<int>(is_seen);
        outliers += static_cast<int>(is_outlier);
        if (is_outlier) {
          drop_observation(t, v, t.sources.keypoint[at]);
        } else if (drops_right) {
          drop_right_column(t, v, t.sources.keypoint[at]);
        }
      }
      int const number = t.sources.keyframe[problem.view(t.b, v)];
      if (outliers == 0 || !t.map.keyframes.holds(t.b, number)) { continue; }
      dropped = true;
      int const position = t.map.keyframes.position(number);
      if (outliers == seen) { mask[position / 64] &= ~(std::uint64_t{1} << (position % 64)); }
    }
    if (!dropped) { return; }
    int const left = t.map.records.observers(t.b, slot);
    get<field::observations>(t.map.points.slice(t.b), slot) = left;
    if (left == 0) {
      free_slot(t.map, t.b, slot);
      atomic_add(t.map.records.alive + t.b, -1);
    }
  }

  /// The keypoint stays an observation, of its left pixel alone.
  FT_HOST_DEVICE static void drop_right_column(task const& t, int v, int keypoint) {
    keyframes_view const& keyframes = t.map.keyframes;
    int const number = t.sources.keyframe[t.problem.view(t.b, v)];
    if (!keyframes.holds(t.b, number)) { return; }
    keyframes.right_x[keyframes.at(t.b, keyframes.position(number), keypoint)] = -1.0f;
  }

  FT_HOST_DEVICE static void drop_observation(task const& t, int v, int keypoint) {
    keyframes_view const& keyframes = t.map.keyframes;
    int const number = t.sources.keyframe[t.problem.view(t.b, v)];
    if (!keyframes.holds(t.b, number)) { return; }
    std::ptrdiff_t const at = keyframes.at(t.b, keyframes.position(number), keypoint);
    keyframes.holder[at] = -1;
    keyframes.holder_number[at] = 0;
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
/// Asynchronous on `exec`; allocates nothing; one launch.
/// @param flags [batch] 1 = apply
/// @param T_cw [batch] last pose of the camera, world to left camera, metres; in and out
template <typename Exec>
void apply_window(Exec const& exec, int const* flags, window_problem_view const& problem,
                  window_sources_view const& sources, odometry_map_view const& map,
                  rigid<double>* T_cw) {
  for_each_item<per_block<512>>(exec, problem.batch, detail::apply_result{}, flags, problem,
                                sources, map, T_cw);
}

}  // namespace FT_ABI
}  // namespace ft
