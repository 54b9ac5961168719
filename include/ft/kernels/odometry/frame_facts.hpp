// SPDX-License-Identifier: Apache-2.0
/// @file What the matches of a frame say about its pose, in numbers that all executors share.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/odometry/recovery_evidence.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/kernels/pose/detail/reprojection.hpp"
#include "ft/kernels/pose/pose_problem.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Points and keypoints of a frame that may have been matched by chance.
struct chance_counts {
  int points = 0;          ///< that a camera sees, once per camera
  int keypoints = 0;       ///< of all cameras
  std::int64_t area = 0;   ///< of their inlier circles, 1 / 16 pixels^2
  std::int64_t image = 0;  ///< area of all images, pixels^2

  /// The evidence of so many inliers, in 1 / 65536 bits. The fewer ones of points and keypoints are
  /// the trials. One of them finds a keypoint by chance where a circle is, if descriptor and octave
  /// fit, which is one case in four.
  FT_HOST_DEVICE std::int64_t bits(int inliers) const {
    if (points < 1 || keypoints < 1 || image < 1) { return 0; }
    std::int64_t const all = area / 4 * max_of(points, keypoints) / keypoints;
    std::int64_t const p = min_of(all * (evidence_one / 16) / image, std::int64_t{evidence_one});
    return binomial_evidence(inliers, min_of(points, keypoints),
                             max_of(static_cast<int>(p), least_chance));
  }
};

/// Counts them. All threads of a group call.
/// @param in the search in the local map, with `seen`. A point that the search from the last frame
///   matched is not searched again, and counts as seen
/// @param capacity of its lists @param slots of the map
template <typename Group, typename Rig>
FT_HOST_DEVICE chance_counts count_chances(Group g, int b, frame_view const& frame,
                                           local_search<Rig> const& in, int capacity, int slots) {
  constexpr float circle = 3.14159265f * 5.991f * 16;
  pyramid_geometry const& geometry = in.geometry;
  chance_counts n;
  std::int64_t area = 0;  // in large octaves above an int
  for (int c = 0; c < frame.cameras; ++c) {
    std::ptrdiff_t const of_list = static_cast<std::ptrdiff_t>(b) * capacity;
    visibility const* const seen =
        in.seen + static_cast<std::ptrdiff_t>(c) * frame.batch * capacity + of_list;
    for (int i = g.rank(); i < in.slot_count[b]; i += g.size()) {
      bool const there =
          seen[i].level >= 0 || (c == 0 && in.stamps.stamped(b, slots, in.slots[of_list + i]));
      n.points += static_cast<int>(there);
    }
    keypoints_view const kp = frame.camera(b, c);
    for (int i = g.rank(); i < *kp.count; i += g.size()) {
      area += static_cast<std::int64_t>(mul(circle, geometry.sigma2[kp.octave(i)]));
    }
    n.keypoints += *kp.count;
  }
  n.points = g.reduce(n.points, sum_op{});
  n.area = g.reduce(area, sum_op{});
  n.image = static_cast<std::int64_t>(frame.cameras) * geometry.width[0] * geometry.height[0];
  return n;
}

/// What the observations of the last pose say. All threads of a group call.
/// @param last pose of the last frame
template <typename Group, typename Rig>
FT_HOST_DEVICE frame_facts weigh_observations(Group g, int b, Rig const& rig,
                                              observations_view const& in, pose const& T_cw,
                                              rigid<double> const& last) {
  using real = strict_float;  // an eighth of a pixel is wanted
  auto const now = T_cw.template cast<real>();
  auto const before = last.template cast<real>();
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
  frame_facts n;
  for (int i = g.rank(); i < in.count[b]; i += g.size()) {
    std::ptrdiff_t const at = static_cast<std::ptrdiff_t>(b) * in.capacity + i;
    observation const o = in.items[at];
    reprojection<Rig, real> const r(rig, now, o);
    int const x = whole(r.error[0]), y = whole(r.error[1]);
    int const length = (x < 0 ? -x : x) + (y < 0 ? -y : y);
    ++n.matches;
    if (in.outlier[at] != 0) {
      n.rejected_x += x;
      n.rejected_y += y;
      n.rejected_length += length;
    } else {
      reprojection<Rig, real> const since(rig, before, o);
      int const dx = whole(since.error[0]), dy = whole(since.error[1]);
      n.flowing += static_cast<int>((dx < 0 ? -dx : dx) + (dy < 0 ? -dy : dy) >= 16);
      real chi2 = 0.0f;
      for (int row = 0; row < r.rows; ++row) { chi2 = chi2 + r.error[row] * r.error[row]; }
      n.misfit += misfit(chi2 * real(o.inv_sigma2));
      n.rows += r.rows;
    }
    if (r.rows == 3 && r.valid) {
      real const weight = o.inv_sigma2;
      bool const agrees = (r.error[0] * r.error[0] + r.error[1] * r.error[1]) * weight < 5.991f;
      n.with_disparity += static_cast<int>(agrees);
      n.off_disparity += static_cast<int>(agrees && !(r.error[2] * r.error[2] * weight < 7.815f));
    }
  }
  four_sums const a =
      g.reduce(four_sums{{n.matches, n.rejected_x, n.rejected_y, n.rejected_length}}, sum_op{});
  four_sums const c =
      g.reduce(four_sums{{n.flowing, n.with_disparity, n.off_disparity, n.misfit}}, sum_op{});
  n.rows = g.reduce(n.rows, sum_op{});
  n.matches = a.of[0];
  n.rejected_x = a.of[1];
  n.rejected_y = a.of[2];
  n.rejected_length = a.of[3];
  n.flowing = c.of[0];
  n.with_disparity = c.of[1];
  n.off_disparity = c.of[2];
  n.misfit = c.of[3];
  return n;
}

/// What report_frames() reads. Executor memory.
template <typename Rig>
struct reported_frames {
  Rig rig;
  observations_view observations;          ///< of the last pose
  chance_counts const* chances = nullptr;  ///< [batch]
  int const* inliers = nullptr;            ///< [batch] of the judged frame
};

/// Item: a camera.
struct report_frame {
  using scratch = no_scratch;

  template <typename Group, typename Rig>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, reported_frames<Rig> const& in,
                                 odometry_state_view const& state) const {
    camera_track& t = state.tracks[b];
    if (t.plan == search_plan::nothing) { return; }
    weighed_poses const at = state.weighed[b];
    frame_facts facts = weigh_observations(g, b, in.rig, in.observations, at.T_cw, at.last);
    if (g.rank() != 0) { return; }
    facts.fixed = t.facts.fixed;
    facts.held_before = t.facts.held_before;
    facts.moving = t.facts.moving;
    facts.evidence = static_cast<int>(in.chances[b].bits(in.inliers[b]) / evidence_one);
    t.facts = facts;
    bool const found = state.counts[b] != sightings::none;
    t.moved = found && 2 * facts.flowing > in.inliers[b] ? 1 : 0;
  }
};

/// Item: a camera.
struct count_frame_chances {
  using scratch = no_scratch;

  template <typename Group, typename Rig>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, frame_view const& frame,
                                 local_search<Rig> const& in, int capacity, int slots,
                                 chance_counts* out) const {
    chance_counts const n = count_chances(g, b, frame, in, capacity, slots);
    if (g.rank() == 0) { out[b] = n; }
  }
};

}  // namespace detail

/// What of a frame may be matched by chance, once its local map is listed. Asynchronous on `exec`;
/// allocates nothing; one launch.
/// @param capacity of the lists @param slots of the map @param out [batch]
template <typename Exec, typename Rig>
void count_chances_of_frames(Exec const& exec, frame_view const& frame, local_search<Rig> const& in,
                             int capacity, int slots, detail::chance_counts* out) {
  for_each_item<per_block<256>>(exec, frame.batch, detail::count_frame_chances{}, frame, in,
                                capacity, slots, out);
}

/// What the matches of judged frames say: camera_track::facts and `moved`. Nothing in the frame
/// waits for it. Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec, typename Rig>
void report_frames(Exec const& exec, detail::reported_frames<Rig> const& in,
                   odometry_state_view const& state) {
  for_each_item<per_block<256>>(exec, state.batch, detail::report_frame{}, in, state);
}

}  // namespace FT_ABI
}  // namespace ft
