// SPDX-License-Identifier: Apache-2.0
/// @file Stage: the pose that most of a frame's matches agree with.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/counter_draws.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/motion/constant_velocity.hpp"
#include "ft/kernels/odometry/match_without_window.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/kernels/pnp/draw_pose.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Item: a camera.
template <typename Rig>
struct propose_pose {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, windowless_search<Rig> const& in,
                                 tracking_rules const& rules, odometry_state_view const& state,
                                 windowless_workspace const& work) const {
    camera_track const& t = state.tracks[b];
    pose_proposal& out = work.proposals[b];
    bool const wanted = is_doubtful(t, rules, in.inliers[b]);
    g.sync();
    if (g.rank() == 0) {
      out.matches = out.support = out.first_support = out.adopted = 0;
      out.search_factor = rules.matched_search;
    }
    if (!wanted) { return; }
    observation* const list = work.matches + static_cast<std::ptrdiff_t>(b) * in.frame.numbers();
    int const camera = busiest(g, b, in, work);
    int const n = list_matches(g, b, camera, in, anchors::of(in, t, b), work, list);
    g.sync();
    if (n < rules.min_support) { return; }

    auto const matches = seen_matches<Rig>{in.rig, camera, list, n};
    counter_draws const draws{mixed_bits(static_cast<std::uint64_t>(t.time_ns) + 1)};
    if (!draw_pose(g, matches, draws, out.T_cw)) { return; }
    int support = 0, first_support = 0;
    int const cost = cost_of_pose(g, matches, out.T_cw, support);
    int const first = cost_of_pose(g, matches, in.T_cw[b].template cast<double>(), first_support);
    if (g.rank() != 0) { return; }
    out.matches = n;
    out.camera = camera;
    out.support = support;
    out.first_support = first_support;
    out.first_cost = first;
    // A lost camera has no other pose to go on from.
    bool const better =
        t.lost_frames > 0 || 10.0f * static_cast<float>(cost) < 9.0f * static_cast<float>(first);
    out.adopted = support >= rules.min_support && better ? 1 : 0;
  }

private:
  FT_HOST_DEVICE static bool is_mutual(int b, int i, windowless_search<Rig> const& in,
                                       windowless_workspace const& work) {
    std::ptrdiff_t const first = static_cast<std::ptrdiff_t>(b) * in.frame.numbers();
    int const k = work.keypoint_of[first + i];
    return k >= 0 && work.anchor_of[first + k] == i;
  }

  /// The camera with most mutual matches.
  template <typename Group>
  FT_HOST_DEVICE static int busiest(Group g, int b, windowless_search<Rig> const& in,
                                    windowless_workspace const& work) {
    constexpr int cameras = Rig::rectified ? Rig::cameras : 1;
    int best = 0, most = -1;
    for (int c = 0; cameras > 1 && c < cameras; ++c) {
      int mine = 0;
      for (int i = g.rank(); i < in.frame.capacity(); i += g.size()) {
        mine += static_cast<int>(is_mutual(b, c * in.frame.capacity() + i, in, work));
      }
      int const all = g.reduce(mine, sum_op{});
      best = all > most ? c : best;
      most = max_of(all, most);
    }
    return best;
  }

  /// Lists a camera's mutual matches in the order of the anchors. @return their number
  template <typename Group>
  FT_HOST_DEVICE static int list_matches(Group g, int b, int camera,
                                         windowless_search<Rig> const& in, anchors const& from,
                                         windowless_workspace const& work, observation* list) {
    int const capacity = in.frame.capacity();
    keypoints_view const keypoints = in.frame.camera(b, camera);
    auto const points = in.map.points.slice(b);
    int n = 0;
    for (int base = 0; base < capacity; base += g.size()) {
      int const i = camera * capacity + base + g.rank();
      bool const there = base + g.rank() < capacity && is_mutual(b, i, in, work);
      int here = 0;
      int const place = n + g.exclusive_count(there, here);
      n += here;
      if (!there) { continue; }
      int const k = work.keypoint_of[static_cast<std::ptrdiff_t>(b) * in.frame.numbers() + i] -
                    camera * capacity;
      int const octave = keypoints.octave(k);
      list[place] = {
          points.position(from.slot(i)),           in.geometry.column(keypoints.x(k), octave),
          in.geometry.row(keypoints.y(k), octave), -1.0f,
          in.geometry.inv_sigma2[octave],          camera};
    }
    return n;
  }
};

}  // namespace detail

/// Draws 256 poses, each from three matches of match_without_window(), and keeps the one with the
/// least sum of truncated squared errors. It is adopted if at least `min_support` matches agree
/// with it and, of a camera that was not lost, its sum is below nine tenths of the first pose's: of
/// poses from three matches the best one has a sum up to a tenth above that of the optimum. Draws
/// depend on the time of the frame alone. Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec, typename Rig>
void propose_poses(Exec const& exec, windowless_search<Rig> const& in, tracking_rules const& rules,
                   odometry_state_view const& state, windowless_workspace const& work) {
  for_each_item<per_block<256>>(exec, in.frame.batch, detail::propose_pose<Rig>{}, in, rules, state,
                                work);
}

}  // namespace FT_ABI
}  // namespace ft
