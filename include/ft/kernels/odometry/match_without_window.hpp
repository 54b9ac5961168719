// SPDX-License-Identifier: Apache-2.0
/// @file Stage: matches between map points and a frame's keypoints, wherever they are in the image.
#pragma once

#include <cstddef>

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/containers/odometry_map.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/kernels/pose/optimize_frame.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

/// A pose that was found without a search window.
struct pose_proposal {
  rigid<double> T_cw;   ///< undefined unless `matches` is above 0
  int matches;          ///< that it was chosen by; 0 = none was looked for, or too few
  int support;          ///< of these, how many agree with it
  int first_support;    ///< and how many with the pose of the search from the last frame
  int adopted;          ///< 1 = the frame goes on from it
  int first_cost;       ///< sum of the errors with the pose of the search from the last frame
  int camera;           ///< whose matches these are
  float search_factor;  ///< on the search radius around it
};

/// Working memory of the optimisation of a proposal.
struct proposal_refinement {
  pose start, T_cw;
  int inliers;
  float information[information_terms];
};

/// Inputs of the search without a window, in executor memory.
template <typename Rig>
struct windowless_search {
  Rig rig;
  frame_view frame;
  odometry_map_view map;
  int const*
      last_holder;  ///< [batch][cameras * capacity] slots that the last frame held, -1 = none
  pyramid_geometry geometry;
  int const* inliers;  ///< [batch] of the first pose
  pose const* T_cw;    ///< [batch] the first pose: after the search from the last frame
  unsigned char const* fixed = nullptr;  ///< as in frames_in_map
};

/// Working memory and outputs, in executor memory. Nothing has to be initialised.
struct windowless_workspace {
  int* keypoint_of = nullptr;        ///< [batch][numbers] keypoint nearest to an anchor, -1 = none
  int* anchor_of = nullptr;          ///< [batch][numbers] anchor nearest to a keypoint, -1 = none
  observation* matches = nullptr;    ///< [batch][numbers]
  unsigned char* outlier = nullptr;  ///< [batch][numbers] of matches
  proposal_refinement* refined = nullptr;  ///< [batch]
  pose_proposal* proposals = nullptr;      ///< [batch]
};

inline void carve(carver& c, windowless_workspace& v, int numbers, int batch) {
  c.place({batch, numbers}, v.keypoint_of, v.anchor_of, v.matches, v.outlier);
  c.place({batch}, v.refined, v.proposals);
}

namespace detail {

/// Whether the pose of a frame is looked for without a window: of a camera that was lost, one whose
/// motion is not known, and one that found much less than the last frame held.
FT_HOST_DEVICE inline bool is_doubtful(camera_track const& t, tracking_rules const& rules,
                                       int inliers) {
  if (!rules.matches_without_window || !t.has_map() || t.guided != 0) { return false; }
  return t.lost_frames > 0 || !t.velocity.known() ||
         static_cast<float>(inliers) < mul(rules.doubtful_share, static_cast<float>(t.held));
}

/// The map points that a frame's keypoints are matched to: those that the last frame held, or, of a
/// lost camera, those that a keyframe holds, in each frame another one of the newest.
struct anchors {
  int const* holder;  ///< [numbers] slots
  int const* number;  ///< [numbers] of the points that the slots must have; null = any
  int const* there;   ///< [slots] numbers of the map's points, 0 = none
  int slots;

  template <typename Rig>
  FT_HOST_DEVICE static anchors of(windowless_search<Rig> const& in, camera_track const& t, int b) {
    keyframes_view const& k = in.map.keyframes;
    point_records_view const& records = in.map.records;
    bool const by_keyframe = t.lost_frames > 0 && k.count[b] > 0;
    constexpr int newest = 5;
    int const back = by_keyframe ? t.lost_with_features % min_of(newest, k.count[b]) : 0;
    std::ptrdiff_t const of_frame = static_cast<std::ptrdiff_t>(b) * in.frame.numbers();
    std::ptrdiff_t const of_keyframe = by_keyframe ? k.at(b, k.position(k.made[b] - back), 0) : 0;
    return {by_keyframe ? k.holder + of_keyframe : in.last_holder + of_frame,
            by_keyframe ? k.holder_number + of_keyframe : nullptr,
            records.number + records.at(b, 0), records.slots};
  }
  /// The slot of an anchor, -1 if there is none.
  FT_HOST_DEVICE int slot(int i) const {
    int const s = holder[i];
    if (s < 0 || s >= slots || there[s] == 0) { return -1; }
    return number == nullptr || there[s] == number[i] ? s : -1;
  }
};

/// Item: an anchor, or a keypoint. Finds the nearest one of the others.
template <typename Rig>
struct match_anywhere {
  static constexpr bool wide_on_host = true;
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, windowless_search<Rig> const& in,
                                 tracking_rules const& rules, odometry_state_view const& state,
                                 windowless_workspace const& out) const {
    int const numbers = in.frame.numbers();
    int const b = item / (2 * numbers);
    camera_track const& t = state.tracks[b];
    if (!is_doubtful(t, rules, in.inliers[b])) { return; }
    int const side = item / numbers % 2;
    int const i = item % numbers;
    int const first = i / in.frame.capacity() * in.frame.capacity();  // of its camera
    keypoints_view const keypoints = in.frame.camera(b, first / in.frame.capacity());
    auto const points = in.map.points.slice(b);
    anchors const from = anchors::of(in, t, b);
    int found = -1;
    if (side == 0) {
      int const slot = from.slot(i);
      if (slot >= 0) {
        found =
            nearest(g, points.orb(slot), *keypoints.count, [&](int k) { return keypoints.orb(k); });
      }
    } else if (i - first < *keypoints.count && !is_fixed(in, b, i)) {
      descriptor const mine = keypoints.orb(i - first);
      two_nearest best;
      for (int a = g.rank(); a < in.frame.capacity(); a += g.size()) {
        int const slot = from.slot(first + a);
        best.add(slot >= 0 ? search_distance_by_adders(mine, points.orb(slot)) : best.none, a);
      }
      best = best.merged(g);
      found = best.first < best.none ? best.index : -1;
    }
    if (g.rank() == 0) {
      int* const to = side == 0 ? out.keypoint_of : out.anchor_of;
      to[static_cast<std::ptrdiff_t>(b) * numbers + i] = found < 0 ? -1 : first + found;
    }
  }

private:
  FT_HOST_DEVICE static bool is_fixed(windowless_search<Rig> const& in, int b, int i) {
    return in.fixed != nullptr &&
           in.fixed[static_cast<std::ptrdiff_t>(b) * in.frame.numbers() + i] != 0;
  }
  /// The nearest of n descriptors if it is near, and nearer than the second by the ratio.
  template <typename Group, typename At>
  FT_HOST_DEVICE static int nearest(Group g, descriptor const& mine, int n, At const& at) {
    constexpr int most = descriptor_scale::limit(80);
    two_nearest best;
    for (int k = g.rank(); k < n; k += g.size()) {
      best.add(search_distance_by_adders(mine, at(k)), k);
    }
    best = best.merged(g);
    return best.first <= most && 10 * best.first < 9 * best.second ? best.index : -1;
  }
};

}  // namespace detail

/// Matches the map points that the last frame held with all keypoints of the frame, in cameras that
/// are in doubt about their pose (see tracking_rules::matches_without_window); a lost camera's
/// keypoints with the points of one of the newest keyframes. propose_poses() follows. Asynchronous
/// on `exec`; allocates nothing; one launch.
template <typename Exec, typename Rig>
void match_without_window(Exec const& exec, windowless_search<Rig> const& in,
                          tracking_rules const& rules, odometry_state_view const& state,
                          windowless_workspace const& out) {
  for_each_item<per_warp>(exec, 2 * in.frame.batch * in.frame.numbers(),
                          detail::match_anywhere<Rig>{}, in, rules, state, out);
}

}  // namespace FT_ABI
}  // namespace ft
