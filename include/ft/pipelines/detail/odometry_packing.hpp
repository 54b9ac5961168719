// SPDX-License-Identifier: Apache-2.0
/// @file Writes what an odometry tells of a frame to host memory.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
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

/// What pack_tracking reads. Executor memory, [batch] each.
struct tracking_facts {
  int const* inliers;
  float const* depth;        ///< [batch][depth_cameras * capacity] metres
  int const* rival;          ///< likewise, field::rival; null = no pairs are rectified
  float const* information;  ///< [batch][information_terms]
  int const* local_count;
  int const* local_left_out;
  int const* held;               ///< as in keyframe_result
  int const* keyframe_left_out;  ///< likewise
  int const* window_left_out;
  int const* map_points;
  int depth_cameras = 1;                ///< the first cameras, whose keypoints may have a depth
  float distant = 0;                    ///< depth of distant points, metres
  start_report const* start = nullptr;  ///< of one camera, or null
};

/// Of the images of camera b, grey values of the one with the least contrast. Ties go to the first.
FT_HOST_DEVICE inline light_sums least_contrast(image_changes_view const& changes, int images,
                                                absent_images const& absent, int b) {
  light_sums least;
  std::int64_t smallest = 0;
  for (int i = 0; i < images; ++i) {
    if (absent.has(b * images + i)) { continue; }
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
    if (absent.has(b * images + i)) { continue; }
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
                                 int images, absent_images const& absent,
                                 odometry_output* outputs) const {
    outputs[b].light = least_contrast(changes, images, absent, b);
    outputs[b].changes = count_changes(changes, images, absent, b);
  }
};

/// Item: a camera. Keeps the number of a new keyframe's points for later frames.
struct pack_tracking {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, frame_view const& frame,
                                 odometry_state_view const& state, tracking_facts const& facts,
                                 odometry_output* outputs) const {
    odometry_output& out = outputs[b];
    for (int i = g.rank(); i < information_terms; i += g.size()) {
      out.information[i] = facts.information[b * information_terms + i];
    }
    int left = 0;
    int with_depth = 0;
    int distant = 0;
    int ambiguous = 0;
    for (int c = 0; c < facts.depth_cameras; ++c) {
      int const count = *frame.camera(b, c).count;
      std::ptrdiff_t const first =
          (static_cast<std::ptrdiff_t>(b) * facts.depth_cameras + c) * frame.capacity();
      float const* const depth = facts.depth + first;
      for (int i = g.rank(); i < count; i += g.size()) {
        with_depth += static_cast<int>(depth[i] > 0);
        distant += static_cast<int>(depth[i] > facts.distant);
        if (facts.rival != nullptr && depth[i] > 0) { ambiguous += facts.rival[first + i]; }
      }
      left += count;
    }
    with_depth = g.reduce(with_depth, sum_op{});
    distant = g.reduce(distant, sum_op{});
    ambiguous = g.reduce(ambiguous, sum_op{});
    if (g.rank() != 0) { return; }
    camera_track& t = state.tracks[b];
    bool const inserted = state.order[b] != keyframe_order::none;
    if (inserted) { t.reference_tracked = facts.held[b]; }
    out.T_cw = state.T_cw[b];
    out.state = t.state;
    out.begins_map = t.begins;
    out.begins_first_map = state.order[b] == keyframe_order::begin_map && t.maps == 1 ? 1 : 0;
    out.keyframe = inserted ? 1 : 0;
    out.gathered = state.gather[b];
    out.inliers = facts.inliers[b];
    out.keypoints = left;
    out.with_depth = with_depth;
    out.distant = distant;
    out.ambiguous = ambiguous;
    out.agreed = t.agreed;
    out.facts = t.facts;
    out.start = facts.start == nullptr ? start_report{} : facts.start[b];
    // Before its first map a camera that was reset searches its old one, for nothing.
    bool const searched = t.plan != search_plan::nothing;
    out.local_points = searched ? facts.local_count[b] : 0;
    out.left_out = (searched ? facts.local_left_out[b] : 0) +
                   (inserted ? facts.keyframe_left_out[b] : 0) +
                   (state.gather[b] != 0 ? facts.window_left_out[b] : 0);
    out.map_points = t.has_map() ? facts.map_points[b] : 0;
    out.maps = t.maps;
    out.keyframes = t.keyframes;
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
