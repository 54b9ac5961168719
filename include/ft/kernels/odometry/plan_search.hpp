// SPDX-License-Identifier: Apache-2.0
/// @file Stage: what a frame of an odometry searches in the local map, and from which pose.
#pragma once

#include <cstddef>

#include "ft/containers/frame.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/odometry/fixed_keypoints.hpp"
#include "ft/kernels/odometry/image_changes.hpp"
#include "ft/kernels/odometry/match_without_window.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// Result of the search from the last frame, and the start of the search in the local map.
template <typename Rig>
struct search_start {
  Rig rig;
  int const* inliers = nullptr;  ///< [batch] of the first pose
  pose* T_cw = nullptr;  ///< [batch] the first pose; replaced for a camera that is searched for
  int* stamp = nullptr;  ///< [batch] number of the frame; another one for such a camera, so that no
                         ///< point counts as matched
  pose_proposal const* proposals = nullptr;  ///< [batch] of refine_proposals(), or null
  unsigned char const* fixed = nullptr;      ///< as in frames_in_map
  float* depth = nullptr;  ///< [batch][depth_cameras * capacity] metres; these lose theirs
  int depth_cameras = 1;
  image_changes const* changes = nullptr;  ///< [images] of the batch, by frame_view::image()
};

namespace detail {

/// Item: a camera.
struct plan_camera_search {
  using scratch = no_scratch;

  template <typename Group, typename Rig>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, tracking_rules const& rules,
                                 frame_view const& frame, odometry_state_view const& state,
                                 search_start<Rig> const& start) const {
    camera_track const& t = state.tracks[b];
    bool const adopts = start.proposals != nullptr && start.proposals[b].adopted != 0;
    bool const frozen = is_frozen(g, b, t, frame, start, state.T_cw[b]);
    bool const waits = t.lost_frames > 0 && t.looked_up != 0 && t.guided == 0;
    search_plan const plan = frozen || waits                ? search_plan::nothing
                             : adopts && t.lost_frames == 0 ? search_plan::rejoin
                             : adopts                       ? search_plan::recover
                                                            : plan_of(t, rules, start.inliers[b]);
    g.sync();
    if (plan != search_plan::follow) {
      int* const holder = frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers();
      for (int i = g.rank(); i < frame.numbers(); i += g.size()) { holder[i] = -1; }
    }
    fixed_counts fixed;
    if (start.fixed != nullptr) { fixed = forget_fixed(g, b, frame, start, state.T_cw[b]); }
    if (g.rank() != 0) { return; }
    state.tracks[b].frozen = frozen ? 1 : 0;
    state.tracks[b].facts.fixed = fixed.all;
    state.tracks[b].facts.dragged = fixed.dragged;
    // A frame without points was no attempt.
    int const attempt = t.lost_with_features % recovery_attempts;
    bool const recovers = plan == search_plan::recover || plan == search_plan::rejoin;
    state.mode[b] = recovers ? local_map_mode::newest : local_map_mode::by_votes;
    // Without a motion to go on from, the camera may be far from each of the places.
    bool const guided = t.guided != 0;
    bool const first =
        guided ? attempt % 2 == 0 : (attempt < recovery_places) == t.velocity.known();
    state.radius_factor[b] = !recovers ? 1.0f
                             : adopts  ? start.proposals[b].search_factor
                             : first   ? rules.first_wide_search
                                       : rules.later_wide_search;
    if (recovers) {
      int const place = guided ? 0 : attempt % recovery_places;
      rigid<double> const T = adopts       ? start.proposals[b].T_cw
                              : place == 0 ? t.predicted
                              : place == 1 ? state.T_cw[b]
                                           : t.keyframe;
      start.T_cw[b] = T.template cast<float>();
      start.stamp[b] += 1;
    }
    state.tracks[b].plan = plan;
  }

private:
  struct fixed_counts {
    int all = 0;
    int dragged = 0;  ///< that the scene would have moved, and that are sure
  };
  /// Keypoints of what is fixed to a camera become no points of the map. A camera that turns about
  /// a point in view, or hardly moves, has such, too.
  /// @param last pose of the last frame
  /// @return the near ones
  template <typename Group, typename Rig>
  FT_HOST_DEVICE static fixed_counts forget_fixed(Group g, int b, frame_view const& frame,
                                                  search_start<Rig> const& start,
                                                  rigid<double> const& last) {
    auto const T_cw = start.T_cw[b].template cast<strict_float>();
    auto const last_T_cw = last.template cast<strict_float>();
    int const with_depth = start.depth_cameras * frame.capacity();
    float* const depth = start.depth + static_cast<std::ptrdiff_t>(b) * with_depth;
    unsigned char const* const is_fixed =
        start.fixed + static_cast<std::ptrdiff_t>(b) * frame.numbers();
    fixed_counts n;
    for (int i = g.rank(); i < with_depth; i += g.size()) {
      if (is_fixed[i] == 0 || !(depth[i] > 0)) { continue; }
      ++n.all;
      n.dragged += static_cast<int>(is_fixed[i] == fixed_for_long &&
                                    flows(start.rig, frame, b, i, T_cw, last_T_cw, depth[i], 2.0f));
      depth[i] = -1.0f;
    }
    return {g.reduce(n.all, sum_op{}), g.reduce(n.dragged, sum_op{})};
  }
  /// Whether all images that have keypoints are those of the frame before although the IMU says
  /// that most of what has a depth has moved by a pixel since: a camera's driver repeats them. It
  /// stays so while they do.
  /// @param last pose of the last frame
  template <typename Group, typename Rig>
  FT_HOST_DEVICE static bool is_frozen(Group g, int b, camera_track const& t,
                                       frame_view const& frame, search_start<Rig> const& start,
                                       rigid<double> const& last) {
    if (!all_same(frame, b, start.changes)) { return false; }
    if (t.frozen != 0) { return true; }  // also where its IMU says nothing any more
    if (t.guided == 0) { return false; }
    auto const T_cw = t.predicted.template cast<strict_float>();
    auto const last_T_cw = last.template cast<strict_float>();
    int const with_depth = start.depth_cameras * frame.capacity();
    float const* const depth = start.depth + static_cast<std::ptrdiff_t>(b) * with_depth;
    int all = 0, moved = 0;
    for (int i = g.rank(); i < with_depth; i += g.size()) {
      if (!(depth[i] > 0)) { continue; }
      ++all;
      moved += static_cast<int>(flows(start.rig, frame, b, i, T_cw, last_T_cw, depth[i], 1.0f));
    }
    return 2 * g.reduce(moved, sum_op{}) > g.reduce(all, sum_op{});
  }
  FT_HOST_DEVICE static bool all_same(frame_view const& frame, int b, image_changes const* of) {
    int textured = 0;
    for (int c = 0; c < frame.cameras; ++c) {
      image_changes const& image = of[frame.image(b, c)];
      if (image.textured > 0 && image.same == 0) { return false; }
      textured += image.textured;
    }
    return textured > 0;
  }
  /// Whether what a camera sees at keypoint i was `least` pixels from there before, if it is of the
  /// scene.
  template <typename Rig>
  FT_HOST_DEVICE static bool flows(Rig const& rig, frame_view const& frame, int b, int i,
                                   rigid<strict_float> const& T_cw,
                                   rigid<strict_float> const& last_T_cw, float depth, float least) {
    int const c = i / frame.capacity(), k = i - c * frame.capacity();
    keypoints_view const kp = frame.camera(b, c);
    vec2<float> const at{kp.x(k), kp.y(k)};
    auto const moved = [&](auto const& camera, rigid<strict_float> const& to,
                           rigid<strict_float> const& from) {
      auto const model = camera.template cast<strict_float>();
      auto const ray = model.unproject({strict_float(at.x), strict_float(at.y)});
      if (!ray.valid || !(ray.direction.z > 0.0f)) { return false; }
      strict_float const scale = strict_float(depth) / ray.direction.z;
      auto const d = ray.direction;
      auto const point = to.inverse() * vec3<strict_float>{d.x * scale, d.y * scale, d.z * scale};
      auto const before = model.project(from * point);
      float const x = ::fabsf((before.pixel.x - strict_float(at.x)).value);
      float const y = ::fabsf((before.pixel.y - strict_float(at.y)).value);
      return before.valid && !(x + y < least);
    };
    if constexpr (Rig::rectified) {
      return moved(rig.pair(c).camera, rig.to_camera(c, T_cw), rig.to_camera(c, last_T_cw));
    } else {
      return moved(rig.left, T_cw, last_T_cw);
    }
  }
  FT_HOST_DEVICE static search_plan plan_of(camera_track const& t, tracking_rules const& rules,
                                            int inliers) {
    if (!t.has_map()) { return search_plan::nothing; }
    return t.lost_frames == 0 && inliers >= rules.min_motion_inliers ? search_plan::follow
                                                                     : search_plan::recover;
  }
};

}  // namespace detail

/// Decides after the first pose of a frame how its search in the local map goes on. A camera with
/// too few inliers, or that was lost before, is searched for near one of several poses with a wide
/// radius, among the newest keyframes' points; one that adopts a proposal near that pose. Its
/// keypoints release what they hold. One that is looked up after the frame is searched for only
/// where an IMU says where. One whose images repeat while its IMU moves is as without
/// keypoints, and goes on by its IMU. Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec, typename Rig>
void plan_searches(Exec const& exec, tracking_rules const& rules, frame_view const& frame,
                   odometry_state_view const& state, search_start<Rig> const& start) {
  for_each_item<per_block<256>>(exec, state.batch, detail::plan_camera_search{}, rules, frame,
                                state, start);
}

}  // namespace FT_ABI
}  // namespace ft
