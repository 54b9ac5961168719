// SPDX-License-Identifier: Apache-2.0
/// @file Checks of settings. Each throws bad_argument that names the value and the limit; settings
/// of single stages are checked where these are, by functions of the same name.
#pragma once

#include <limits>
#include <string>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keyframes.hpp"
#include "ft/containers/vocabulary.hpp"
#include "ft/containers/window_problem.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/kernels/inertial/initialization.hpp"
#include "ft/kernels/inertial/stored_state.hpp"
#include "ft/kernels/monocular/initial_matches.hpp"
#include "ft/kernels/monocular/start_rules.hpp"
#include "ft/kernels/pnp/problem.hpp"
#include "ft/kernels/two_view/problem.hpp"
#include "ft/kernels/window/workspace.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/orb_params.hpp"
#include "ft/types/relocalization.hpp"

namespace ft {
inline namespace FT_ABI {

/// @throws bad_argument also for levels that would have no pixel
inline void check(orb_params const& p) {
  detail::require_range("width", p.width, 1, max_image_side);
  detail::require_range("height", p.height, 1, max_image_side);
  detail::require_range("levels", p.levels, 1, max_levels);
  detail::require_range("scale_factor", p.scale_factor, 1.01f, 4.0f);
  detail::require_range("features", p.features, 1, 1 << 20);
  if (p.start_features != 0) {
    detail::require_range("start_features", p.start_features, p.features, 1 << 20);
  }
  detail::require_range("ini_threshold", p.ini_threshold, 0, 255);
  detail::require_range("min_threshold (at most ini_threshold)", p.min_threshold, 0,
                        p.ini_threshold);
  detail::require_range("mask_width", p.mask_width, 0, max_image_side);
  detail::require_range("mask_height", p.mask_height, 0, max_image_side);
  detail::require_range("corner_ratio", p.corner_ratio, 0.0f, 1.0f);
  if ((p.mask_width == 0) != (p.mask_height == 0)) {
    throw bad_argument("ft: mask_width is " + std::to_string(p.mask_width) +
                       " and mask_height is " + std::to_string(p.mask_height) +
                       ", must be both 0 or both above it");
  }
  pyramid_geometry::make(p.width, p.height, p.levels, p.scale_factor);
}

namespace detail {

inline void check_overlaps(stereo_overlap const (&overlap)[2]) {
  for (int i = 0; i < 2; ++i) {
    if (!(overlap[i].left <= overlap[i].right)) {  // also rejects NaN
      throw bad_argument("ft: overlap[" + std::to_string(i) + "] is [" +
                         number_text(overlap[i].left) + ", " + number_text(overlap[i].right) +
                         "], its left end must not be above its right end");
    }
  }
}

}  // namespace detail

inline void check(tracker_params const& p) {
  detail::check_member("orb.", [&] { check(p.orb); });
  detail::require_range("map_slots", p.map_slots, 1, 1 << 26);
  detail::require_range("local_points", p.local_points, 1, 1 << 24);
  detail::require_range("updates", p.updates, 1, 1 << 24);
  detail::require_range("window_radius", p.window_radius, 0.1f, 1000.0f);
  detail::require_range("enough_matches", p.enough_matches, 0, 1 << 24);
  detail::check_overlaps(p.overlap);
}

inline void check(monocular_start_params const& p) {
  detail::check_member("rules.", [&] { check(p.rules); });
  detail::check_member("matching.", [&] { check(p.matching); });
  detail::check_member("two_views.", [&] { check(p.two_views); });
}

inline void check(tracking_rules const& r) {
  detail::require_range("rules.min_stereo_points", r.min_stereo_points, 1, 1 << 24);
  detail::require_range("rules.min_inliers", r.min_inliers, 3, 1 << 24);
  detail::require_range("rules.min_motion_inliers", r.min_motion_inliers, 3, 1 << 24);
  detail::require_range("rules.min_recovered", r.min_recovered, 3, 1 << 24);
  detail::require_range("rules.min_evidence", r.min_evidence, 0, 1 << 20);
  // A pose is drawn from four.
  detail::require_range("rules.min_support", r.min_support, 4, 1 << 24);
  detail::require_range("rules.doubtful_share", r.doubtful_share, 0.0f, 1.0f);
  detail::require_range("rules.matched_search", r.matched_search, 0.1f, 1000.0f);
  detail::require_range("rules.patience", r.patience, 1, 1 << 30);
  detail::require_range("rules.first_wide_search", r.first_wide_search, 0.1f, 1000.0f);
  detail::require_range("rules.later_wide_search", r.later_wide_search, 0.1f, 1000.0f);
  detail::require_range("rules.wanted_near_points", r.wanted_near_points, 0, 1 << 24);
  detail::require_range("rules.new_near_points", r.new_near_points, 0, 1 << 24);
  detail::require_range("rules.keep_share", r.keep_share, 0.0f, 1.0f);
  detail::require_range("rules.unrectified_keep_share", r.unrectified_keep_share, 0.0f, 1.0f);
  detail::require_range("rules.keyframe_period_s", r.keyframe_period_s, 0.0, 1e6);
  detail::require_range("rules.near_depth", r.near_depth, 1e-3f, 1e6f);
  detail::require_range("rules.far_depth", r.far_depth, 0.0f, 1e6f);
  detail::require_range("rules.motion.even", r.motion.even, 0.0, 1.0);
  detail::require_range("rules.motion.longest", r.motion.longest, 1.0, 1e6);
  detail::require_range("rules.motion.memory", r.motion.memory, 1e-3, 1e6);
}

inline void check(imu_params const& imu) {
  mount_of(imu.T_bc);
  variances_of(imu.noise);
  detail::require_range("imu.samples", imu.samples, 2, 1 << 20);
  detail::require_range("imu.waiting", imu.waiting, 2, 1 << 24);
  detail::require_range("imu.max_accel", imu.max_accel, 1e-3f, 1e9f);
  detail::require_range("imu.max_gyro", imu.max_gyro, 1e-3f, 1e9f);
  detail::require_range("imu.accel_sigma", imu.accel_sigma, 0.0f, 100.0f);
  detail::require_range("imu.time_offset_s", imu.time_offset_s, -imu_params::max_time_offset_s,
                        imu_params::max_time_offset_s);
  detail::require_range("imu.keyframe_period_s", imu.keyframe_period_s, 1e-3, 1e6);
  detail::require_range("imu.selection.early_s", imu.selection.early_s, 0.0, 1.0);
  detail::require_range("imu.selection.longest_gap_s", imu.selection.longest_gap_s, 1e-6,
                        std::numeric_limits<double>::infinity());
  detail::require_range("imu.selection.rate_hz", imu.selection.rate_hz, 0.0f, 1e5f);
  detail::check_member("imu.initialization.", [&] { check(imu.initialization); });
  detail::require_range("imu.scale_position_sigma", imu.scale_position_sigma, 1e-9f, 1.0f);
  detail::require_range("imu.scale_keyframes", imu.scale_keyframes, 1, max_keyframes);
  detail::require_range("imu.scale_sigma", imu.scale_sigma, 0.0f, 1.0f);
}

/// @throws bad_argument naming the value and the limit
inline void check(loop_params const& p) {
  detail::require_range("loops.keyframes", p.keyframes, 128, 1 << 16);
  detail::require_range("loops.points", p.points, 16, 1 << 12);
  detail::require_range("loops.recent", p.recent, 2, p.keyframes / 2);
  detail::require_range("loops.groups", p.groups, 1, 16);
  detail::require_range("loops.votes", p.votes, 8, 1 << 12);
  detail::require_range("loops.min_votes", p.min_votes, 1, p.votes < p.points ? p.votes : p.points);
  detail::require_range("loops.min_inliers", p.min_inliers, 8, p.points);
  detail::require_range("loops.min_share", p.min_share, 0.0f, 1.0f);
  detail::require_range("loops.max_drift", p.max_drift, 0.0f, 10.0f);
  detail::require_range("loops.max_turn", p.max_turn, 0.0f, 3.2f);
  detail::require_range("loops.max_scale_drift", p.max_scale_drift, 0.0f, 10.0f);
}

/// What does not depend on the rig and the parts; of the IMU and of loops only where they are
/// present.
inline void check(odometry_params const& p) {
  detail::check_member("orb.", [&] { check(p.orb); });
  detail::require_range("map_slots", p.map_slots, 1, 1 << 24);
  detail::require_range("keyframes", p.keyframes, 2, max_keyframes);
  detail::require_range("local_points", p.local_points, 1, 1 << 24);
  detail::require_range("local_map.keyframes", p.local_map.keyframes, 1, 64);
  detail::require_range("local_map.neighbours", p.local_map.neighbours, 0, 32);
  detail::require_range("window_radius", p.window_radius, 0.1f, 1000.0f);
  detail::require_range("enough_matches", p.enough_matches, 0, 1 << 24);
  detail::require_range("window.moving", p.window.moving, 1, max_window_views);
  detail::require_range("window.fixed", p.window.fixed, 0, max_window_views - p.window.moving);
  detail::require_range("window.moving + window.fixed (at most keyframes)",
                        p.window.moving + p.window.fixed, 1, p.keyframes);
  detail::require_range("window_points", p.window_points, 1, 1 << 20);
  detail::check_member("adjustment.", [&] { check(p.adjustment); });
  detail::require_range("adjustment_delay", p.adjustment_delay, 1, 1000);
  detail::check_member("start.", [&] { check(p.start); });
  detail::require_range("prefetch", p.prefetch, 0, 64);
  detail::check_overlaps(p.overlap);
  check(p.rules);
  if (p.loops.present) { check(p.loops); }
  if (!p.imu.present) { return; }
  check(p.imu);
  if (p.rules.keyframe_period_s != 0) {  // two answers to one question
    detail::require_range("rules.keyframe_period_s (imu.keyframe_period_s holds with an IMU)",
                          p.rules.keyframe_period_s, p.imu.keyframe_period_s,
                          p.imu.keyframe_period_s);
  }
  detail::require_range("imu.initialization.least_keyframes", p.imu.initialization.least_keyframes,
                        3, p.window.moving + p.window.fixed);
}

inline void check(place_recovery const& p) {
  detail::require_range("levels_up", p.levels_up, 0, max_vocabulary_levels);
  detail::require_range("candidates", p.candidates, 1, max_keyframes);
  check(p.relocalization.pnp);
}

}  // namespace FT_ABI
}  // namespace ft
