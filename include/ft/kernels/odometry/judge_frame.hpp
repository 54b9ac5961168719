// SPDX-License-Identifier: Apache-2.0
/// @file Stages: whether a frame of an odometry is tracked, which state follows, and whether it
/// becomes a keyframe.
#pragma once

#include <cstddef>

#include "ft/cameras/monocular_rig.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/map/keyframe_input.hpp"
#include "ft/kernels/monocular/begin_map.hpp"
#include "ft/kernels/odometry/recovery_evidence.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

/// Result of a frame's searches. Executor memory.
template <typename Rig>
struct searched_frames {
  /// The first cameras, whose keypoints may have a depth.
  static constexpr int depth_cameras = Rig::rectified ? Rig::cameras : 1;
  Rig rig;
  frame_view frame;
  /// [batch][depth_cameras * capacity] of left keypoints, metres; not above 0 = none
  float const* depth;
  int* inliers;      ///< [batch] of the last pose; 0 is written for a frame that is not tracked
  pose const* T_cw;  ///< [batch] the last pose
  unsigned char* matched;   ///< output, [batch][cameras * capacity] 1 = the keypoint was matched to
                            ///< a map point from before the frame
  local_search<Rig> local;  ///< in which points were searched; its pose is not used
  int local_capacity = 0;   ///< of its slots
  map_points_view map;
  map_beginnings begins;    ///< of a monocular_rig
  bool begins_maps = true;  ///< false: a lost camera begins no new map
};

namespace detail {

/// Left keypoints of a frame.
struct keypoint_counts {
  int with_depth = 0, held = 0, near_held = 0, near_free = 0;
};

/// The frame is tracked at pose T.
FT_HOST_DEVICE inline void keep_pose(camera_track& t, rigid<double>& T_cw, pose const& T) {
  rigid<double> const now = T.cast<strict_double>().orthonormalized().cast<double>();
  if (t.lost_frames == 0) {
    t.velocity.observe(T_cw, now, t.interval_ns);
  } else {
    t.velocity.rest();
  }
  T_cw = now;
  t.seen_ns = t.time_ns;
  t.lost_frames = 0;
  t.lost_with_features = 0;
  t.state = tracking_state::tracking;
}

/// The frame begins a new map.
FT_HOST_DEVICE inline void begin_map(camera_track& t) {
  t.leave_map();
  t.velocity.rest();
  t.seen_ns = t.time_ns;
  t.lost_frames = 0;
  t.lost_with_features = 0;
  t.state = tracking_state::tracking;
  ++t.maps;
  t.begins = 1;
}

/// The frame becomes a keyframe.
FT_HOST_DEVICE inline void note_keyframe(camera_track& t, rigid<double> const& T_cw) {
  t.keyframe = T_cw;
  t.keyframe_ns = t.time_ns;
  t.new_keyframe = 1;
  ++t.map_keyframes;
  ++t.keyframes;
}

/// Item: a camera.
struct judge_camera_frame {
  using scratch = no_scratch;

  template <typename Group, typename Rig>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, tracking_rules const& rules,
                                 searched_frames<Rig> const& in,
                                 odometry_state_view const& state) const {
    search_plan const plan = state.tracks[b].plan;
    int const inliers = in.inliers[b];
    bool const found = plan == search_plan::follow   ? inliers >= rules.min_inliers
                       : plan == search_plan::rejoin ? inliers >= rules.min_recovered
                       : plan == search_plan::recover
                           ? inliers >= rules.min_recovered && is_evident(g, b, rules, in)
                           : false;
    keypoint_counts const counts = release_and_count(g, b, in, rules.near_depth, found);
    g.sync();
    // In place: a copy would be local memory, of every thread that the device can hold.
    if (g.rank() == 0) { decide(state.tracks[b], b, found, counts, rules, in, state); }
  }

private:
  /// A thread's part.
  template <typename Rig>
  FT_HOST_DEVICE static void decide(camera_track& t, int b, bool found,
                                    keypoint_counts const& counts, tracking_rules const& rules,
                                    searched_frames<Rig> const& in,
                                    odometry_state_view const& state) {
    int const inliers = in.inliers[b];
    search_plan const plan = t.plan;
    t.begins = 0;
    t.left_out = t.new_left_out;
    frame_facts facts{};
    facts.fixed = t.facts.fixed;
    facts.dragged = t.facts.dragged;
    facts.apart = t.facts.apart;
    facts.held_before = t.held;
    facts.moving = t.moved;
    facts.frozen = t.frozen;
    t.facts = facts;
    t.agreed = plan == search_plan::nothing ? 0 : inliers;
    bool const follows = plan == search_plan::follow;
    // The local map of a lost camera is seen from a guessed pose. A point that it does not find
    // there may be anywhere.
    state.counts[b] = !found                ? sightings::none
                      : rules.localize_only ? sightings::not_kept
                      : follows             ? sightings::all
                                            : sightings::found_only;
    state.order[b] = keyframe_order::none;
    t.moved = 0;
    if (found) {
      keep_pose(t, state.T_cw[b], in.T_cw[b]);
      t.held = counts.held;
      state.order[b] =
          needs_keyframe<Rig>(t, counts, rules) ? keyframe_order::add : keyframe_order::none;
    } else {
      in.inliers[b] = 0;
      if constexpr (is_monocular_v<Rig>) {
        miss_one_camera(t, b, counts, rules, in.begins, state);
      } else {
        miss(t, b, counts, rules, in.begins_maps, state);
      }
    }
    if (state.order[b] != keyframe_order::none) { note_keyframe(t, state.T_cw[b]); }
    bool const gathers = t.adjusting == 0 && t.new_keyframe != 0 && t.map_keyframes > 1;
    state.gather[b] = gathers ? 1 : 0;
    if (gathers) {
      t.adjusting = 1;
      t.new_keyframe = 0;
    }
    if constexpr (is_monocular_v<Rig>) {
      bool const looks = !rules.localize_only && looks_for_start(t, in.begins.patience);
      in.begins.wants_more[b] = looks ? 1 : 0;
    }
  }
  /// Whether a lost camera's matches are more than a wrong pose would find.
  template <typename Group, typename Rig>
  FT_HOST_DEVICE static bool is_evident(Group g, int b, tracking_rules const& rules,
                                        searched_frames<Rig> const& in) {
    searched_evidence const of = weigh_points(g, b, in.local, in.local_capacity, in.frame, in.map);
    int const inliers = in.inliers[b];
    return is_enough(of.bits(inliers), rules);
  }

  template <typename Group, typename Rig>
  FT_HOST_DEVICE static keypoint_counts release_and_count(Group g, int b,
                                                          searched_frames<Rig> const& in,
                                                          float near_depth, bool found) {
    frame_view const& frame = in.frame;
    auto const first = static_cast<std::ptrdiff_t>(b) * frame.numbers();
    float const* const depth =
        in.depth + static_cast<std::ptrdiff_t>(b) * in.depth_cameras * frame.capacity();
    keypoint_counts n;
    for (int i = g.rank(); i < frame.numbers(); i += g.size()) {
      if (!found) { frame.holder[first + i] = -1; }
      int const c = i / frame.capacity();
      bool const there = i - c * frame.capacity() < *frame.camera(b, c).count;
      bool const held = there && frame.holder[first + i] >= 0;
      in.matched[first + i] = held ? 1 : 0;
      if (!there || c >= in.depth_cameras) { continue; }
      bool const is_near = depth[i] > 0 && depth[i] <= near_limit(in.rig, c, near_depth);
      n.with_depth += static_cast<int>(is_monocular_v<Rig> || depth[i] > 0);
      n.held += static_cast<int>(held);
      n.near_held += static_cast<int>(is_near && held);
      n.near_free += static_cast<int>(is_near && !held);
    }
    four_sums const all =
        g.reduce(four_sums{{n.with_depth, n.held, n.near_held, n.near_free}}, sum_op{});
    return {all.of[0], all.of[1], all.of[2], all.of[3]};
  }

  /// The frame is not tracked. The motion goes on, slower and slower, until the camera is found or
  /// a new map is begun where it is thought to be. Where an IMU tells, the map goes on there.
  FT_HOST_DEVICE static void miss(camera_track& t, int b, keypoint_counts const& counts,
                                  tracking_rules const& rules, bool begins_maps,
                                  odometry_state_view const& state) {
    bool const had_map = t.has_map();
    bool const usable = is_usable(t, counts, rules);
    if (had_map) { drift(t, b, usable, rules, state); }
    if (!usable || rules.localize_only) { return; }
    if (had_map && t.lost_with_features < rules.patience) { return; }
    if (t.guided != 0) {
      t.lost_frames = 0;
      t.lost_with_features = 0;
      t.state = tracking_state::tracking;
      state.order[b] = keyframe_order::add;
    } else if (begins_maps || !had_map) {
      begin_map(t);
      state.order[b] = keyframe_order::begin_map;
    }
  }
  FT_HOST_DEVICE static bool is_usable(camera_track const& t, keypoint_counts const& counts,
                                       tracking_rules const& rules) {
    return t.frozen == 0 && counts.with_depth >= rules.min_stereo_points;
  }
  /// The camera goes on as it is thought to.
  FT_HOST_DEVICE static void drift(camera_track& t, int b, bool usable, tracking_rules const& rules,
                                   odometry_state_view const& state) {
    state.T_cw[b] = t.predicted;
    t.velocity.slow_down(t.interval_ns, rules.motion);
    ++t.lost_frames;
    t.lost_with_features = usable ? t.lost_with_features + 1 : 0;
    t.state = t.lost_frames < recovery_attempts ? tracking_state::recovering : tracking_state::lost;
  }
  /// The same for one camera without depths: a map begins with two keyframes when its motion is
  /// known. The first one is where the camera is thought to have been, or the origin.
  FT_HOST_DEVICE static void miss_one_camera(camera_track& t, int b, keypoint_counts const& counts,
                                             tracking_rules const& rules,
                                             map_beginnings const& begins,
                                             odometry_state_view const& state) {
    if (t.has_map()) { drift(t, b, is_usable(t, counts, rules), rules, state); }
    if (rules.localize_only || begins.report[b].outcome != start_outcome::started) { return; }
    begin_map(t);
    begins.order[b] = keyframe_order::begin_map;
    begins.first_T_cw[b] = state.T_cw[b];
    note_keyframe(t, state.T_cw[b]);
    rigid<double> const now = (begins.T_21[b].template cast<strict_double>() *
                               state.T_cw[b].template cast<strict_double>())
                                  .orthonormalized()
                                  .template cast<double>();
    t.velocity.observe(state.T_cw[b], now, saturated_difference(t.time_ns, begins.first_ns[b]));
    state.T_cw[b] = now;
    state.order[b] = keyframe_order::add;
  }

  template <typename Rig>
  FT_HOST_DEVICE static bool needs_keyframe(camera_track const& t, keypoint_counts const& n,
                                            tracking_rules const& rules) {
    if (rules.localize_only) { return false; }
    bool const short_of_near =
        n.near_held < rules.wanted_near_points && n.near_free > rules.new_near_points;
    float const share = Rig::rectified ? rules.keep_share : rules.unrectified_keep_share;
    auto const kept = mul(share, static_cast<float>(t.reference_tracked));
    auto const age = mul(static_cast<double>(saturated_difference(t.time_ns, t.keyframe_ns)), 1e-9);
    bool const old = rules.keyframe_period_s > 0 && !(age < rules.keyframe_period_s);
    if constexpr (is_monocular_v<Rig>) {
      return old || n.held < rules.wanted_near_points || static_cast<float>(n.held) < kept;
    }
    return short_of_near || old || static_cast<float>(n.held) < kept;
  }
};

}  // namespace detail

/// Decides which state follows from a frame's searches, whether the frame becomes a keyframe,
/// whether a new map is begun and whether an adjustment begins; keeps the pose and the motion.
/// Keypoints of a frame that is not tracked release what they hold. Asynchronous on `exec`;
/// allocates nothing; one launch.
template <typename Exec, typename Rig>
void judge_frames(Exec const& exec, tracking_rules const& rules, searched_frames<Rig> const& in,
                  odometry_state_view const& state) {
  searched_frames<Rig> judged = in;
  judged.local.T_cw = in.T_cw;
  judged.local.seen = nullptr;
  for_each_item<per_block<512>>(exec, state.batch, detail::judge_camera_frame{}, rules, judged,
                                state);
}

}  // namespace FT_ABI
}  // namespace ft
