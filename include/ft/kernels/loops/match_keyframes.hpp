// SPDX-License-Identifier: Apache-2.0
/// @file Stages: which kept keyframes look like one of them, and from where it was seen.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/cameras/monocular_rig.hpp"
#include "ft/containers/loop_archive.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/counter_draws.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/pnp/draw_pose.hpp"
#include "ft/kernels/pose/optimize_pose.hpp"
#include "ft/math/log.hpp"
#include "ft/math/sim3.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/relocalization.hpp"

namespace ft {
inline namespace FT_ABI {

/// What is known of the motion between a row and the query: where a row's point may be seen.
struct loop_bound {
  pose T_query_row;  ///< as it is known
  float shift = 0;   ///< metres that it may be off by, in [0, inf)
  float turn = 0;    ///< rad that it may be off by, in [0, inf)

  /// Whether a point of the row may be one of the query's: it is so near to the ray of that, in the
  /// frame of the query's pose, as the motion is known, and as much farther as a turn takes it. The
  /// depth of the query's point says nothing, for those of far points are not well known.
  /// @param row, query metres, each in the frame of its pose
  FT_HOST_DEVICE bool allows(vec3<float> const& row, vec3<float> const& query) const {
    auto const p = T_query_row.template cast<strict_float>() * row.template cast<strict_float>();
    auto const ray = query.template cast<strict_float>();
    strict_float const distance2 = dot(p, p);
    strict_float const reach = strict_float(shift) + strict_float(turn) * scalar::sqrt(distance2);
    auto const off = cross(ray, p);
    strict_float const reach2 = reach * reach;
    return dot(off, off) <= reach2 * dot(ray, ray) &&
           (strict_float(0.0f) < dot(ray, p) || distance2 <= reach2);
  }
};

/// Rows of an archive, in executor memory.
struct loop_rows {
  int query = 0;             ///< row that is looked for
  int const* row = nullptr;  ///< [count] among which
  int count = 0;
  /// Of one camera: whether the depths of the query's points are known.
  bool query_has_depths = true;
  /// [count] of each row; null: nothing is known of any. A point of a row that the bound does not
  /// allow is neither a match nor a rival of one: so what repeats is told apart where the motion is
  /// known well enough, and only there.
  loop_bound const* bound = nullptr;
};

/// Working memory of match_keyframes(), in executor memory. Nothing has to be initialised.
struct loop_workspace {
  int capacity = 0;                  ///< rows at a time
  int points = 0;                    ///< of a row
  int* nearest_in_row = nullptr;     ///< [capacity][points] of the query's points, -1 = none
  int* nearest_in_query = nullptr;   ///< [capacity][points] of the row's points, -1 = none
  observation* matches = nullptr;    ///< [capacity][points]
  int* matched = nullptr;            ///< [capacity][points] the query's point of each match
  int* ratio = nullptr;              ///< [capacity][points] of the depths of both
  unsigned char* outlier = nullptr;  ///< [capacity][points]
  pose* T = nullptr;                 ///< [capacity]
  int* inliers = nullptr;            ///< [capacity]
};

inline void carve(carver& c, loop_workspace& v, int capacity, int points) {
  v.capacity = capacity;
  v.points = points;
  c.place({capacity, points}, v.nearest_in_row, v.nearest_in_query, v.matches, v.matched, v.ratio,
          v.outlier);
  c.place({capacity}, v.T, v.inliers);
}

namespace detail {

/// The nearest of a row's descriptors that may be there if it is near, and nearer than the second
/// by the ratio; else -1. By all threads of a group.
template <typename Group, typename MayBe>
FT_HOST_DEVICE int nearest_in(Group g, descriptor const& mine, loop_archive_view const& a, int row,
                              MayBe const& may_be) {
  constexpr int most = descriptor_scale::near;
  descriptor const* const all = a.orb + a.at(row);
  two_nearest best;
  for (int k = g.rank(); k < a.count[row]; k += g.size()) {
    if (!may_be(a.at(row) + k)) { continue; }
    best.add(search_distance_by_adders(mine, all[k]), k);
  }
  best = best.merged(g);
  return best.first <= most && 10 * best.first < 9 * best.second ? best.index : -1;
}

struct may_be_any {
  FT_HOST_DEVICE bool operator()(std::ptrdiff_t) const { return true; }
};
/// Whether a point of an archive may be the one at `mine`, which is the query's or the row's.
struct may_be_within {
  loop_bound const* bound;  ///< null: it may be
  vec3<float> const* point;
  std::ptrdiff_t mine;
  bool of_query;

  FT_HOST_DEVICE bool operator()(std::ptrdiff_t other) const {
    return bound == nullptr ||
           bound->allows(point[of_query ? other : mine], point[of_query ? mine : other]);
  }
};

/// Item: a descriptor of the query, and a row.
struct vote_for_row {
  static constexpr bool wide_on_host = true;
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, loop_archive_view const& a,
                                 loop_rows const& rows, int asked, int* votes) const {
    int const n = min_of(asked, a.count[rows.query]);
    int const at = item % asked;
    if (at >= n) { return; }
    int const k = static_cast<int>(static_cast<long long>(at) * a.count[rows.query] / n);
    int const found =
        nearest_in(g, a.orb[a.at(rows.query) + k], a, rows.row[item / asked], may_be_any{});
    if (g.rank() == 0 && found >= 0) { atomic_add(votes + item / asked, 1); }
  }
};

/// Item: a point of the query or of a row. Finds the nearest one in the other.
struct match_row {
  static constexpr bool wide_on_host = true;
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, loop_archive_view const& a,
                                 loop_rows const& rows, loop_workspace const& out) const {
    int const r = item / (2 * a.points);
    bool const of_query = item / a.points % 2 == 0;
    int const i = item % a.points;
    int const mine = of_query ? rows.query : rows.row[r];
    int const other = of_query ? rows.row[r] : rows.query;
    if (i >= a.count[mine]) { return; }
    may_be_within const may_be{rows.bound == nullptr ? nullptr : rows.bound + r, a.point,
                               a.at(mine) + i, of_query};
    int const found = nearest_in(g, a.orb[a.at(mine) + i], a, other, may_be);
    int* const to = of_query ? out.nearest_in_row : out.nearest_in_query;
    if (g.rank() == 0) { to[static_cast<std::ptrdiff_t>(r) * a.points + i] = found; }
  }
};

/// Item: a row. The pose of the query against it.
template <typename Rig>
struct place_query {
  static constexpr int least = 8;  ///< matches, to look for a pose
  using scratch = pose_scratch;
  Rig rig;
  pose_params params;
  pose_limits limits = pose_limits::of(params);

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int r, loop_archive_view const& a,
                                 loop_rows const& rows, std::uint64_t seed,
                                 loop_workspace const& work, loop_match* matches) const {
    loop_match& out = matches[r];
    std::ptrdiff_t const first = static_cast<std::ptrdiff_t>(r) * a.points;
    observation* const list = work.matches + first;
    int const n = list_matches(g, r, a, rows, work, list);
    if (g.rank() == 0) {
      out.matches = n;
      out.inliers = 0;
      out.scale = 1;
      out.scale_sigma = 0;
    }
    g.sync();
    if (n < least) { return; }
    seen_matches<Rig> const seen = of_busiest(list, n);
    if (seen.n < least || !draw_pose(g, seen, {mixed_bits(seed)}, out.T_query_row)) { return; }
    if (g.rank() == 0) { work.T[r] = out.T_query_row.template cast<float>(); }
    g.sync();
    pose_problem const problem{
        list, n, work.T + r, work.T + r, work.outlier + first, work.inliers + r, out.information};
    pose_solver<Group, Rig> const solver{g, s, rig, problem, params, limits};
    for (int i = g.rank(); i < n; i += g.size()) { solver.prepare(i, list[i]); }
    solver.solve();
    g.sync();
    bool const compares = is_monocular_v<Rig> && rows.query_has_depths;
    if constexpr (is_monocular_v<Rig>) {
      if (compares) { compare_depths(g, r, a, rows, work, n, out); }
      if (!compares && g.rank() == 0) { out.scale_sigma = 1; }
    }
    if (g.rank() != 0) { return; }
    out.T_query_row = work.T[r].template cast<double>();
    if (!compares) { out.inliers = work.inliers[r]; }
  }

private:
  /// The scale that the depths of the points tell which agree with the pose: the median of their
  /// ratios. A pose of the query against the row's points has the row's units, whatever the
  /// query's are, and does not suffer from the error of the query's depths. Points are inliers if
  /// their ratios are that of the scale within a fifth, too.
  template <typename Group>
  FT_HOST_DEVICE static void compare_depths(Group g, int r, loop_archive_view const& a,
                                            loop_rows const& rows, loop_workspace const& work,
                                            int n, loop_match& out) {
    constexpr double unit = 1.0 / 4096;  // of logarithms of ratios
    constexpr int fifth = 747;           // log 1.2
    constexpr int none = 1 << 30;
    std::ptrdiff_t const first = static_cast<std::ptrdiff_t>(r) * a.points;
    int* const ratio = work.ratio + first;
    auto const T = work.T[r].template cast<strict_double>();
    int mine = 0;
    for (int i = g.rank(); i < n; i += g.size()) {
      auto const p = T * work.matches[first + i].point.template cast<strict_double>();
      strict_double const z =
          static_cast<double>(a.point[a.at(rows.query) + work.matched[first + i]].z);
      bool const known =
          work.outlier[first + i] == 0 && p.z > strict_double(0) && z > strict_double(0);
      ratio[i] = known ? static_cast<int>((strict_log(z / p.z) / strict_double(unit)).value) : none;
      mine += static_cast<int>(known);
    }
    g.sync();
    int const known = g.reduce(mine, sum_op{});
    if (known == 0) { return; }
    int const median = in_order(g, ratio, n, (known - 1) / 2);
    g.sync();
    mine = 0;
    for (int i = g.rank(); i < n; i += g.size()) {
      if (ratio[i] == none) { continue; }
      ratio[i] = ratio[i] < median ? median - ratio[i] : ratio[i] - median;
      mine += static_cast<int>(ratio[i] <= fifth);
    }
    g.sync();
    int const spread = in_order(g, ratio, n, (known - 1) / 2);
    int const inliers = g.reduce(mine, sum_op{});
    if (g.rank() != 0) { return; }
    out.inliers = inliers;
    out.scale = strict_exp(strict_double(median) * strict_double(unit)).value;
    // Of a median of errors with that median of their sizes, if they were normal.
    strict_double const error = strict_double(1.4826 * 1.2533) * strict_double(max_of(spread, 1));
    out.scale_sigma = (error * strict_double(unit) / scalar::sqrt(strict_double(known))).value;
  }
  /// Of n numbers the one at place k of their ascending order. By all threads of a group.
  template <typename Group>
  FT_HOST_DEVICE static int in_order(Group g, int const* numbers, int n, int k) {
    int found = 1 << 30;
    for (int i = g.rank(); i < n; i += g.size()) {
      int below = 0, same = 0;
      for (int j = 0; j < n; ++j) {
        below += static_cast<int>(numbers[j] < numbers[i]);
        same += static_cast<int>(numbers[j] == numbers[i]);
      }
      if (below <= k && k < below + same) { found = numbers[i]; }
    }
    return g.reduce(found, min_op{});
  }
  /// The matches of the camera that has most of them, the first one of equals.
  FT_HOST_DEVICE seen_matches<Rig> of_busiest(observation const* list, int n) const {
    seen_matches<Rig> best{rig, 0, list, n};
    if constexpr (Rig::rectified && Rig::cameras > 1) {
      best.n = 0;
      for (int begin = 0, end = 0; begin < n; begin = end) {
        while (end < n && list[end].camera == list[begin].camera) { ++end; }
        if (end - begin > best.n) {
          best.camera = list[begin].camera;
          best.list = list + begin;
          best.n = end - begin;
        }
      }
    }
    return best;
  }
  /// Lists the matches that are each other's nearest, in the order of the query's points.
  template <typename Group>
  FT_HOST_DEVICE static int list_matches(Group g, int r, loop_archive_view const& a,
                                         loop_rows const& rows, loop_workspace const& work,
                                         observation* list) {
    std::ptrdiff_t const first = static_cast<std::ptrdiff_t>(r) * a.points;
    std::ptrdiff_t const query = a.at(rows.query), row = a.at(rows.row[r]);
    int n = 0;
    for (int base = 0; base < a.count[rows.query]; base += g.size()) {
      int const i = base + g.rank();
      int const k = i < a.count[rows.query] ? work.nearest_in_row[first + i] : -1;
      bool const there = k >= 0 && work.nearest_in_query[first + k] == i;
      int here = 0;
      int const place = n + g.exclusive_count(there, here);
      n += here;
      if (!there) { continue; }
      work.matched[first + place] = i;
      list[place] = {a.point[row + k],     a.x[query + i],          a.y[query + i],
                     a.right_x[query + i], a.inv_sigma2[query + i], a.camera[query + i]};
    }
    return n;
  }
};

}  // namespace detail

/// How many of the query's descriptors find an alike one in each row: one that differs in at most
/// 64 bits, and in less than nine tenths of what the second best does. Asynchronous on `exec`;
/// allocates nothing; a fill and a launch.
/// @param asked descriptors of the query, spread evenly over its points
/// @param votes [rows.count] executor memory
template <typename Exec>
void vote_for_rows(Exec const& exec, loop_archive_view const& archive, loop_rows const& rows,
                   int asked, int* votes) {
  fill_bytes(exec, votes, 0, static_cast<std::size_t>(rows.count) * sizeof(int));
  for_each_item<per_warp>(exec, rows.count * asked, detail::vote_for_row{}, archive, rows, asked,
                          votes);
}

/// Matches the query's keypoints with each row's points, all with all that loop_rows::bound allows;
/// finds the pose that most
/// matches agree with, among 256 poses from three matches each of the camera with most; optimises
/// it; and of one camera alone compares the depths. Asynchronous on `exec`; allocates nothing; two
/// launches.
/// @param seed of the draws @param out [rows.count] executor memory
/// @throws bad_argument for more rows, or larger ones, than there is working memory for
template <typename Exec, typename Rig>
void match_keyframes(Exec const& exec, Rig const& rig, loop_archive_view const& archive,
                     loop_rows const& rows, std::uint64_t seed, pose_params const& params,
                     loop_workspace const& work, loop_match* out) {
  detail::require_range("rows to be matched", rows.count, 0, work.capacity);
  detail::require_range("points of a row", archive.points, work.points, work.points);
  for_each_item<per_warp>(exec, 2 * rows.count * archive.points, detail::match_row{}, archive, rows,
                          work);
  for_each_item<per_block<sum_lanes>>(exec, rows.count, detail::place_query<Rig>{rig, params},
                                      archive, rows, seed, work, out);
}

}  // namespace FT_ABI
}  // namespace ft
