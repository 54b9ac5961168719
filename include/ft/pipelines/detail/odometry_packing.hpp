// SPDX-License-Identifier: Apache-2.0
/// @file Writes what an odometry tells of a frame to host memory.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/map/insert_keyframe.hpp"
#include "ft/kernels/monocular/start_rules.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/pipelines/detail/odometry_memory.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// What pack_depths reads. Executor memory.
struct depths_of_frames {
  frame_view frame;
  float const* depth;     ///< [batch][depth_cameras * capacity] metres
  row_facts rows;         ///< likewise
  int depth_cameras = 1;  ///< the first cameras, whose keypoints may have a depth
  float distant = 0;      ///< depth of distant points, metres
};

/// What pack_tracking reads. Executor memory, [batch] each.
struct tracking_facts {
  int const* inliers;
  float const* information;  ///< [batch][information_terms]
  int const* local_count;
  int const* local_left_out;
  int const* map_points;
  seen_counts const* seen;
  chance_counts const* chances;
  frame_facts const* weighed;           ///< of weigh_frames()
  start_report const* start = nullptr;  ///< of one camera, or null
};

/// Of the images of camera b, grey values of the one with the least contrast. Ties go to the first.
FT_HOST_DEVICE inline light_sums least_contrast(image_changes_view const& changes, int images,
                                                absent_images const& absent, int b) {
  light_sums least;
  std::int64_t smallest = 0;
  for (int i = 0; i < images; ++i) {
    if (absent.has(b * images + i) || changes.is_missing(b * images + i)) { continue; }
    image_changes const& of = changes.of[b * images + i];
    auto const spread =
        std::int64_t{light_sums::samples} * of.squares - std::int64_t{of.sum} * of.sum;
    if (least.image < 0 || spread < smallest) {
      least = {i, of.sum, of.squares};
      smallest = spread;
    }
  }
  return least;
}

FT_HOST_DEVICE inline change_counts count_changes(image_changes_view const& changes, int images,
                                                  absent_images const& absent, int b) {
  change_counts n;
  for (int i = 0; i < images; ++i) {
    if (absent.has(b * images + i) || changes.is_missing(b * images + i)) { continue; }
    image_changes const& of = changes.of[b * images + i];
    ++n.images;
    n.same += of.same;
    n.textured += of.textured;
    n.moved += of.moved;
    n.streaked += of.streaked;
  }
  return n;
}

/// Item: a camera.
struct pack_changes {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int b, image_changes_view const& changes,
                                 int images, absent_images const& absent, seen_counts* out) const {
    out[b].light = least_contrast(changes, images, absent, b);
    out[b].changes = count_changes(changes, images, absent, b);
  }
};

/// Item: a camera. Its keypoints, and which of them have a depth.
struct pack_depths {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, depths_of_frames const& in,
                                 seen_counts* to) const {
    int all = 0;
    four_sums n{};  // with a depth, distant, ambiguous, differences of rows
    for (int c = 0; c < in.depth_cameras; ++c) {
      int const count = *in.frame.camera(b, c).count;
      std::ptrdiff_t const first =
          (static_cast<std::ptrdiff_t>(b) * in.depth_cameras + c) * in.frame.capacity();
      float const* const depth = in.depth + first;
      for (int i = g.rank(); i < count; i += g.size()) {
        n.of[0] += static_cast<int>(depth[i] > 0);
        n.of[1] += static_cast<int>(depth[i] > in.distant);
        if (in.rows.rival == nullptr || !(depth[i] > 0)) { continue; }
        n.of[2] += in.rows.rival[first + i];
        n.of[3] += round_away(mul(float{seen_counts::row_one}, in.rows.row_difference[first + i]));
      }
      all += count;
    }
    n = g.reduce(n, sum_op{});
    if (g.rank() != 0) { return; }
    seen_counts& out = to[b];
    out.keypoints = all;
    out.with_depth = n.of[0];
    out.distant = n.of[1];
    out.ambiguous = n.of[2];
    out.rows_apart = n.of[3];
  }
};

/// Item: a camera. The flag comes last, and all that the host reads with it is written here: put
/// together first, since single words take long to cross the bus.
struct pack_tracking {
  struct scratch {
    alignas(odometry_output) unsigned char output[sizeof(odometry_output)];
    int evidence;
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, odometry_state_view const& state,
                                 tracking_facts const& facts, odometry_output* outputs) const {
    odometry_output& out = *reinterpret_cast<odometry_output*>(s.output);
    camera_track& t = state.tracks[b];
    bool const judged = facts.weighed != nullptr && t.plan != search_plan::nothing;
    for (int i = g.rank(); i < information_terms; i += g.size()) {
      out.information[i] = facts.information[b * information_terms + i];
    }
    if (judged && g.rank() == g.size() / 2) {  // another warp than that of the first thread
      s.evidence = static_cast<int>(facts.chances[b].bits(facts.inliers[b]) / evidence_one);
    }
    if (g.rank() == 0) { fill(out, b, t, state, facts, outputs[b]); }
    g.sync();
    if (judged && g.rank() == 0) {
      out.facts.evidence = s.evidence;
      t.facts = out.facts;
    }
    g.sync();
    copy_object(g, outputs[b], out);
    g.sync();
    if (g.rank() == 0) { set_flag(&outputs[b].complete); }
  }

private:
  /// All but the evidence. @param before what was packed of this frame, if it was
  FT_HOST_DEVICE static void fill(odometry_output& out, int b, camera_track& t,
                                  odometry_state_view const& state, tracking_facts const& facts,
                                  odometry_output const& before) {
    // Before its first map a camera that was reset searches its old one, for nothing.
    bool const searched = t.plan != search_plan::nothing;
    out.complete = 0;
    out.T_cw = state.T_cw[b];
    out.state = t.state;
    out.begins_map = t.begins;
    out.begins_first_map = state.order[b] == keyframe_order::begin_map && t.maps == 1 ? 1 : 0;
    out.keyframe = state.order[b] != keyframe_order::none ? 1 : 0;
    out.gathered = state.gather[b];
    out.inliers = facts.inliers[b];
    out.agreed = t.agreed;
    out.seen = facts.seen[b];
    out.start = facts.start == nullptr ? start_report{} : facts.start[b];
    out.local_points = searched ? facts.local_count[b] : 0;
    out.left_out = (searched ? facts.local_left_out[b] : 0) + t.left_out;
    // Not once more, when the keyframe is in the map. A map that begins has no points yet.
    bool const counts = facts.weighed != nullptr || t.begins != 0;
    bool const has_points = t.has_map() && t.begins == 0;
    out.map_points = !counts ? before.map_points : has_points ? facts.map_points[b] : 0;
    out.maps = t.maps;
    out.keyframes = t.keyframes;
    out.facts = t.facts;
    if (facts.weighed == nullptr || !searched) { return; }
    take_facts(out.facts, facts.weighed[b]);
    bool const found = state.counts[b] != sightings::none;
    t.moved = found && 2 * out.facts.flowing > out.inliers ? 1 : 0;
  }
  /// What the matches say, of a judged frame, beside what is known of its keypoints.
  FT_HOST_DEVICE static void take_facts(frame_facts& to, frame_facts facts) {
    facts.fixed = to.fixed;
    facts.dragged = to.dragged;
    facts.apart = to.apart;
    facts.held_before = to.held_before;
    facts.moving = to.moving;
    facts.frozen = to.frozen;
    to = facts;
  }
};

/// Item: a camera. Its pose, and what later frames need to know of a new keyframe and of an
/// adjustment.
struct keep_map_counts {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int b, odometry_state_view const& state,
                                 keyframe_result const& keyframe, int const* window_left_out,
                                 pose* T_cw) const {
    T_cw[b] = state.T_cw[b].template cast<float>();
    camera_track& t = state.tracks[b];
    bool const inserted = state.order[b] != keyframe_order::none;
    if (inserted) { t.reference_tracked = keyframe.held[b]; }
    t.new_left_out =
        (inserted ? keyframe.left_out[b] : 0) + (state.gather[b] != 0 ? window_left_out[b] : 0);
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
