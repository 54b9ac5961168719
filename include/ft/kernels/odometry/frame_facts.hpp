// SPDX-License-Identifier: Apache-2.0
/// @file What the matches of a frame say about its pose, in numbers that all executors share.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/odometry/recovery_evidence.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/kernels/pose/detail/reprojection.hpp"
#include "ft/kernels/pose/optimize_frame.hpp"
#include "ft/kernels/pose/pose_problem.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Points of a frame's local map, and what a wrong pose would match of them.
struct chance_counts {
  int points = 0;   ///< that a camera sees, once per camera
  int sampled = 0;  ///< of these, those around which keypoints were counted
  /// Of the sampled, as many as a wrong pose would match, in 1 / 65536. Without a sign for
  /// atomic_add().
  unsigned long long by_chance = 0;

  /// The evidence of so many inliers, in 1 / 65536 bits.
  FT_HOST_DEVICE std::int64_t bits(int inliers) const {
    if (points < 1) { return 0; }
    auto const p = static_cast<std::int64_t>(by_chance) / max_of(sampled, 1);
    return binomial_evidence(
        inliers, points,
        max_of(static_cast<int>(min_of(p, std::int64_t{evidence_one})), least_chance));
  }
};

/// About as many points of a list, evenly spread, are enough to know a chance.
inline constexpr int most_sampled = 256;

/// Errors of the inliers of a frame, summed over parts of the images.
struct error_blocks {
  static constexpr int columns = 8, rows = 6;
  static constexpr int sets = 4;  ///< a camera has one; above 4 cameras share them
  static constexpr int blocks = sets * columns * rows;
  int x[blocks], y[blocks];  ///< sums of errors, 1 / 16 standard deviations
  int squares[blocks];       ///< sum of their squares, of both directions
  int moves[blocks];         ///< sum of the squares of how far keypoints were moved
  int count[blocks];

  template <typename Group>
  FT_HOST_DEVICE void clear(Group g) {
    for (int i = g.rank(); i < blocks; i += g.size()) {
      x[i] = y[i] = squares[i] = moves[i] = count[i] = 0;
    }
    g.sync();
  }
  /// @param e error in standard deviations @param o where @param move square of the keypoint's
  FT_HOST_DEVICE void add(observation const& o, strict_float ex, strict_float ey, float move,
                          int width, int height) {
    int const column = clamp(static_cast<int>(o.u) * columns / max_of(width, 1), 0, columns - 1);
    int const row = clamp(static_cast<int>(o.v) * rows / max_of(height, 1), 0, rows - 1);
    int const i = (o.camera % sets * rows + row) * columns + column;
    int const dx = sixteenths(ex), dy = sixteenths(ey);
    atomic_add(x + i, dx);
    atomic_add(y + i, dy);
    atomic_add(squares + i, dx * dx + dy * dy);
    if (move > 0) { atomic_add(moves + i, static_cast<int>(256.0f * move)); }
    atomic_add(count + i, 1);
  }
  /// How much of the errors' variance is common to neighbours: the mean of the products of the
  /// errors of two inliers of a block, by the mean of their squares, in 1 / 1024. The squares are
  /// those where corners were found: of keypoints that were moved since, what little is left may be
  /// common. The errors of a right pose are those of keypoints, of which each has its own: 0, give
  /// or take one by the root of the number of pairs. 0 where there are too few pairs to tell a
  /// quarter with four standard deviations. After a barrier behind add(); `g` may be a part of the
  /// group that has added.
  template <typename Group>
  FT_HOST_DEVICE int common(Group g) const {
    std::int64_t products = 0, all = 0, pairs = 0;
    for (int i = g.rank(); i < blocks; i += g.size()) {
      std::int64_t const sx = x[i], sy = y[i], n = count[i], moved = moves[i];
      products += sx * sx + sy * sy - squares[i];
      all += (n - 1) * (squares[i] + moved);
      pairs += n * (n - 1) / 2;
    }
    products = g.reduce(products, sum_op{});
    all = g.reduce(all, sum_op{});
    pairs = g.reduce(pairs, sum_op{});
    return pairs < 256 || all < 1 ? 0 : static_cast<int>(1024 * products / all);
  }

private:
  FT_HOST_DEVICE static int sixteenths(strict_float v) {
    float const e = 16.0f * v.value;
    return e > -256.0f && e < 256.0f ? static_cast<int>(e) : 0;
  }
};

struct facts_scratch {
  error_blocks errors[2];  ///< in the image, and of the disparity
  int common[2];
};

/// What the observations of the last pose say. All threads of a group call.
/// @param last pose of the last frame @param uncorrected T_cw as it would be without the adjustment
/// that ended with this frame @param geometry of the images
/// @param disparity_root as in pose_limits @param moves of the keypoints, as in weighed_frames
template <typename Group, typename Rig>
FT_HOST_DEVICE frame_facts weigh_observations(Group g, facts_scratch& s, int b, Rig const& rig,
                                              observations_view const& in, pose const& T_cw,
                                              pose const& last, pose const& uncorrected,
                                              pyramid_geometry const& geometry,
                                              float disparity_root, float const* moves) {
  using real = strict_float;  // an eighth of a pixel is wanted
  auto const now = T_cw.template cast<real>();
  auto const before = last.template cast<real>();
  auto const elsewhere = uncorrected.template cast<real>();
  constexpr int longest = 256;      // pixels
  auto const whole = [&](real v) {  // in eighths; a NaN is the longest
    float const e = 8.0f * v.value;
    return e > -8.0f * longest && e < 8.0f * longest ? static_cast<int>(e) : 8 * longest;
  };
  auto const misfit = [](real chi2) {  // a NaN is the largest
    return chi2.value < frame_facts::most_misfit
               ? static_cast<int>(mul(chi2.value, float{frame_facts::misfit_one}))
               : frame_facts::most_misfit * frame_facts::misfit_one;
  };
  auto const length_of = [](int x, int y) { return (x < 0 ? -x : x) + (y < 0 ? -y : y); };
  s.errors[0].clear(g);
  s.errors[1].clear(g);
  frame_facts n;
  for (int i = g.rank(); i < in.count[b]; i += g.size()) {
    std::ptrdiff_t const at = static_cast<std::ptrdiff_t>(b) * in.capacity + i;
    observation const o = in.items[at];
    reprojection<Rig, real> const r(rig, now, o);
    int const x = whole(r.error[0]), y = whole(r.error[1]);
    float const move = moves == nullptr ? -1.0f : moves[in.number[at]];
    real const weight = move >= 0 ? real(o.inv_sigma2) / weight_of_aligned : real(o.inv_sigma2);
    if (in.outlier[at] == 0) {
      reprojection<Rig, real> const since(rig, before, o);
      int const dx = whole(since.error[0]), dy = whole(since.error[1]);
      n.flowing += static_cast<int>(length_of(dx, dy) >= 16);
      reprojection<Rig, real> const there(rig, elsewhere, o);
      int const sx = whole(there.error[0]) - x, sy = whole(there.error[1]) - y;
      n.shifted += static_cast<int>(sx * sx + sy * sy >= 64);
      reprojection<Rig, real> weighted = r;
      if (disparity_root > 0) { weighted.take_disparity(real(disparity_root)); }
      real chi2 = 0.0f;
      for (int row = 0; row < r.rows; ++row) {
        chi2 = chi2 + weighted.error[row] * weighted.error[row];
      }
      n.misfit +=
          misfit(chi2 * real(o.inv_sigma2) * (move >= 0 ? real(aligned_at_last) : real(1.0f)));
      n.rows += r.rows;
      n.resting += static_cast<int>(length_of(dx - x, dy - y) <= 2);
      real const root = scalar::sqrt(weight);
      int const width = geometry.width[0], height = geometry.height[0];
      // One that had been farther off would have been no inlier.
      s.errors[0].add(o, r.error[0] * root, r.error[1] * root, move < 5.991f ? move : 0.0f, width,
                      height);
      if (r.rows == 3) {
        // Of the disparity: what the columns in both images do not share.
        s.errors[1].add(o, (r.error[0] - r.error[2]) * root, real(0), 0.0f, width, height);
      }
    }
    // Of a pair that is not rectified, what the right camera sees tells of its time and place.
    if constexpr (!Rig::rectified) {
      n.with_disparity += static_cast<int>(o.camera != 0);
      n.off_disparity += static_cast<int>(o.camera != 0 && in.outlier[at] != 0);
    }
    if (r.rows == 3 && r.valid) {
      bool const agrees = (r.error[0] * r.error[0] + r.error[1] * r.error[1]) * weight < 5.991f;
      n.with_disparity += static_cast<int>(agrees);
      n.off_disparity += static_cast<int>(agrees && !(r.error[2] * r.error[2] * weight < 7.815f));
    }
  }
  four_sums const a =
      g.reduce(four_sums{{n.flowing, n.with_disparity, n.off_disparity, n.resting}}, sum_op{});
  four_sums const of_errors = g.reduce(four_sums{{n.misfit, n.rows, n.shifted, 0}}, sum_op{});
  g.sync();
  for (int k = g.part_index(); k < 2; k += g.parts()) {
    int const common = s.errors[k].common(g.part());
    if (g.part().rank() == 0) { s.common[k] = common; }
  }
  g.sync();
  n.matches = in.count[b];
  n.misfit = of_errors.of[0];
  n.rows = of_errors.of[1];
  n.shifted = of_errors.of[2];
  n.common = s.common[0];
  n.common_disparity = s.common[1];
  n.flowing = a.of[0];
  n.with_disparity = a.of[1];
  n.off_disparity = a.of[2];
  n.resting = a.of[3];
  return n;
}

/// What weigh_frames() reads. Executor memory.
template <typename Rig>
struct weighed_frames {
  Rig rig;
  observations_view observations;             ///< of the last pose
  pose const* T_cw = nullptr;                 ///< [batch] that pose
  pose const* last = nullptr;                 ///< [batch] of the last frame
  rigid<double> const* correction = nullptr;  ///< [batch] of apply_window()
  pyramid_geometry geometry{};                ///< of the images
  float disparity_root = 0;                   ///< as in pose_limits
  /// [batch][numbers] as in frames_to_align; null = no keypoint was moved
  float const* moves = nullptr;
};

/// Item: a camera.
struct weigh_frame {
  using scratch = facts_scratch;

  template <typename Group, typename Rig>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, weighed_frames<Rig> const& in,
                                 camera_track const* tracks, frame_facts* out) const {
    frame_facts facts{};
    if (tracks[b].plan != search_plan::nothing) {
      auto const back = in.correction[b].template cast<strict_double>().inverse();
      auto const now = in.T_cw[b].template cast<strict_double>();
      auto const before = now * back;
      facts = weigh_observations(g, s, b, in.rig, in.observations, in.T_cw[b], in.last[b],
                                 before.template cast<float>(), in.geometry, in.disparity_root,
                                 in.moves == nullptr ? nullptr
                                                     : in.moves + static_cast<std::ptrdiff_t>(b) *
                                                                      in.observations.capacity);
      auto const step = now.centre() - before.centre();
      facts.stepped = static_cast<float>(scalar::sqrt(dot(step, step)).value);
    }
    if (g.rank() == 0) { out[b] = facts; }
  }
};

/// Item: a sample of a camera's list. A group, since the keypoints around a point are many and a
/// single thread would wait for each of them.
struct count_frame_chances {
  using scratch = no_scratch;

  template <typename Group, typename Rig>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, frame_view const& frame,
                                 local_search<Rig> const& in, int capacity,
                                 map_points_view const& map, chance_counts* out) const {
    int const b = item / (frame.cameras * most_sampled);
    int const c = item / most_sampled % frame.cameras;
    int const sample = item % most_sampled;
    std::ptrdiff_t const of_list = static_cast<std::ptrdiff_t>(b) * capacity;
    int const* const slots = in.slots + of_list;
    int const listed = in.slot_count[b];
    visibility const* const seen =
        in.seen + static_cast<std::ptrdiff_t>(c) * frame.batch * capacity + of_list;
    int points = 0;
    for (int i = sample + most_sampled * g.rank(); i < listed; i += most_sampled * g.size()) {
      points += static_cast<int>(seen[i].level >= 0 ||
                                 (c == 0 && in.stamps.stamped(b, map.capacity, slots[i])));
    }
    searched_evidence around;
    int const i = sample * max_of(1, ceil_div(listed, most_sampled));
    if (i < listed && seen[i].level >= 0) {
      search_window const w = window_of(seen[i], slots[i], 1.0f, false, in.geometry);
      weigh_point(g, w, get<field::orb>(map.slice(b), w.slot), frame, frame.image(b, c),
                  frame.cameras * b + c, in.params, in.geometry, around);
    }
    points = g.reduce(points, sum_op{});
    around.points = g.reduce(around.points, sum_op{});
    around.by_chance = g.reduce(around.by_chance, sum_op{});
    if (g.rank() != 0 || points + around.points == 0) { return; }
    atomic_add(&out[b].points, points);
    atomic_add(&out[b].sampled, around.points);
    atomic_add(&out[b].by_chance, static_cast<unsigned long long>(around.by_chance));
  }
};

}  // namespace detail

/// What of a frame may be matched by chance, once its local map is listed. Asynchronous on `exec`;
/// allocates nothing; a fill and a launch.
/// @param in the search in the local map, with `seen`; its pose is not used. A point that the
///   search from the last frame matched is not searched again, and counts as seen
/// @param capacity of the lists @param out [batch]
template <typename Exec, typename Rig>
void count_chances_of_frames(Exec const& exec, frame_view const& frame, local_search<Rig> const& in,
                             int capacity, map_points_view const& map, detail::chance_counts* out) {
  fill_bytes(exec, out, 0, static_cast<std::size_t>(frame.batch) * sizeof *out);
  for_each_item<per_warp>(exec, frame.batch * frame.cameras * detail::most_sampled,
                          detail::count_frame_chances{}, frame, in, capacity, map, out);
}

/// What the matches of frames say about their last pose: what of frame_facts observations tell, the
/// others are 0. Does not need the judgement of the frames, and may run beside it. Asynchronous on
/// `exec`; allocates nothing; one launch.
/// @param tracks [batch] `plan` is read @param out [batch]
template <typename Exec, typename Rig>
void weigh_frames(Exec const& exec, int batch, detail::weighed_frames<Rig> const& in,
                  camera_track const* tracks, frame_facts* out) {
  for_each_item<per_block<512>>(exec, batch, detail::weigh_frame{}, in, tracks, out);
}

}  // namespace FT_ABI
}  // namespace ft
