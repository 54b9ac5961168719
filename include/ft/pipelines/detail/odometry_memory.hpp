// SPDX-License-Identifier: Apache-2.0
/// @file The memory that an odometry has besides that of a frame: map, states, window, results.
#pragma once

#include <cstddef>
#include <cstring>

#include "ft/containers/odometry_map.hpp"
#include "ft/containers/point_patches.hpp"
#include "ft/containers/window_problem.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/images/undistort.hpp"
#include "ft/kernels/map/choose_local_map.hpp"
#include "ft/kernels/map/gather_window.hpp"
#include "ft/kernels/map/insert_keyframe.hpp"
#include "ft/kernels/monocular/start_rules.hpp"
#include "ft/kernels/odometry/frame_facts.hpp"
#include "ft/kernels/odometry/image_changes.hpp"
#include "ft/kernels/odometry/match_without_window.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/kernels/pose/pose_problem.hpp"
#include "ft/kernels/window/workspace.hpp"
#include "ft/pipelines/detail/frame_memory.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Sums over grey values of the samples of an image.
struct light_sums {
  static constexpr int samples = image_changes_view::sampled;
  int image = -1;  ///< of the rig; -1 = none was looked at
  int sum = 0;
  int squares = 0;
};

/// How the images of a rig changed.
struct change_counts {
  int images = 0;    ///< that were compared
  int same = 0;      ///< of these, those with the pixels of the frame before
  int textured = 0;  ///< cells of all
  int moved = 0;     ///< of these, cells with another content
  int streaked = 0;  ///< images that are sharp in one direction only
};

/// What a frame's images and keypoints are like, of a camera.
struct seen_counts {
  light_sums light;
  change_counts changes;
  int keypoints;
  int with_depth;
  int distant;     ///< of with_depth, those beyond distant_baselines
  int ambiguous;   ///< of with_depth, those with a field::rival
  int rows_apart;  ///< of with_depth, the sum of field::row_difference, 1 / row_one pixels
  static constexpr int row_one = 16;
};

/// What the host reads of a camera after a frame.
struct odometry_output {
  int complete;  ///< the host sets 0, and the executor 1 when the others are written
  rigid<double> T_cw;
  tracking_state state;
  int begins_map;
  int begins_first_map;
  int keyframe;
  int gathered;  ///< 1 = an adjustment begins with this frame
  int inliers;
  int agreed;  ///< with the pose that was tried last
  seen_counts seen;
  frame_facts facts;
  start_report start;  ///< of one camera
  int local_points;
  int left_out;
  int map_points;
  int maps;
  int keyframes;
  float information[information_terms];
};

/// Owns the memory. Executor memory, unless said otherwise.
template <typename Exec>
struct odometry_memory {
  static constexpr memory_space space = Exec::space;
  static constexpr memory_space staging = staging_space<Exec>;

  odometry_map_view map;
  point_patches_view patches;  ///< of its points
  odometry_state_view state;
  local_map_workspace local_work;
  int* local_left_out = nullptr;  ///< [batch]
  keyframe_workspace keyframe_work;
  keyframe_result keyframe_out;
  window_problem_view window;
  window_sources_view sources;
  window_workspace window_work;
  windowless_workspace windowless;
  image_changes_view changes;
  unsigned char* fixed = nullptr;      ///< [batch][numbers] as in frames_in_map
  chance_counts* chances = nullptr;    ///< [batch]
  seen_counts* seen = nullptr;         ///< [batch]
  pixels_view aligned;                 ///< as in frames_to_align
  float* aligned_right_x = nullptr;    ///< [batch][numbers] likewise
  float* moves = nullptr;              ///< [batch][numbers] as in frames_to_align
  frame_facts* weighed = nullptr;      ///< [batch] of weigh_frames()
  int* selected = nullptr;             ///< [batch] cameras of the adjustment that runs
  float* information = nullptr;        ///< [batch][information_terms]
  odometry_input* inputs = nullptr;    ///< [batch] staging memory, which a device reads
  unsigned* missing = nullptr;         ///< [batch] likewise; bit i: image i of the rig
  odometry_output* outputs = nullptr;  ///< [batch] staging memory, which a device writes
  unsigned char* matched = nullptr;    ///< [batch][numbers] staging memory, likewise
  int* staged_selected = nullptr;      ///< [runs][batch] staging memory
  allocated_bytes bytes() const { return {memory_.bytes(), staging_memory_.bytes()}; }

  /// @param runs adjustments in flight, at most @throws bad_argument, std::bad_alloc, cuda_error
  void take(frame_shape const& shape, odometry_params const& p, int runs) {
    int const batch = shape.batch;
    images_ = shape.images;
    auto const b = static_cast<std::size_t>(batch);
    auto const numbers = b * static_cast<std::size_t>(shape.numbers());
    odometry_map_capacity const size{p.map_slots, {p.keyframes, shape.cameras, shape.capacity}};
    window_capacity const views{p.window.moving + p.window.fixed, p.window_points, shape.cameras,
                                p.imu.present};
    memory_ = arena<space>([&](carver& c) {
      carve(c, map, size, batch);
      carve(c, patches, p.map_slots, batch);
      carve(c, state, batch);
      carve(c, local_work, p.map_slots, batch);
      local_left_out = c.take<int>(b);
      carve(c, keyframe_work, p.map_slots, shape.capacity, shape.cameras, batch);
      keyframe_out.held = c.take<int>(b);
      keyframe_out.left_out = c.take<int>(b);
      carve(c, window, views, batch);
      carve(c, sources, views, p.map_slots, batch);
      carve(c, window_work, window, p.window.moving);
      selected = c.take<int>(b);
      information = c.take<float>(b * information_terms);
      carve(c, windowless, shape.numbers(), batch);
      carve(c, changes, shape.images * batch);
      chances = c.take<chance_counts>(b);
      seen = c.take<seen_counts>(b);
      weighed = c.take<frame_facts>(b);
      fixed = c.take<unsigned char>(numbers);
      moves = c.take<float>(numbers);
      aligned_right_x = c.take<float>(numbers);
      carve(c, aligned, shape.capacity, shape.images * batch);
    });
    staging_memory_ = arena<staging>([&](carver& c) {
      inputs = c.take<odometry_input>(b);
      missing = c.take<unsigned>(b);
      outputs = c.take<odometry_output>(b);
      matched = c.take<unsigned char>(numbers);
      staged_selected = c.take<int>(b * static_cast<std::size_t>(runs));
      staged_T_cw_ = c.take<rigid<double>>(b);
      staged_tracks_ = c.take<camera_track>(b);
    });
    std::memset(staging_memory_.data(), 0, staging_memory_.bytes());
  }

  /// From now on frames may miss images: `missing` says which.
  void may_miss_images() {
    changes.missing = missing;
    changes.images_of_rig = images_;
  }
  /// Empty maps, and cameras that have seen nothing.
  void initialize(Exec const& exec) {
    auto const b = static_cast<std::size_t>(state.batch);
    clear(exec, map);
    clear(exec, patches);
    for (std::size_t i = 0; i < b; ++i) {
      staged_T_cw_[i] = rigid<double>::identity();
      staged_tracks_[i] = camera_track::initial();
    }
    copy(exec, state.T_cw, static_cast<rigid<double> const*>(staged_T_cw_), b);
    copy(exec, state.tracks, static_cast<camera_track const*>(staged_tracks_), b);
    static_assert(sizeof(local_map_mode) == sizeof(int) && sizeof(sightings) == sizeof(int) &&
                      sizeof(keyframe_order) == sizeof(int),
                  "cleared as such");
    void* const all[] = {state.mode,        state.counts,          state.order,
                         state.gather,      state.apply,           local_left_out,
                         keyframe_out.held, keyframe_out.left_out, selected,
                         sources.left_out,  window.view_count,     window.fixed_count,
                         window.point_count};
    fill_bytes(exec, seen, 0, b * sizeof *seen);
    fill_bytes(exec, changes.begun, 0, b * static_cast<std::size_t>(images_) * sizeof(int));
    for (void* const flags : all) { fill_bytes(exec, flags, 0, b * sizeof(int)); }
  }

private:
  int images_ = 0;  ///< of a rig
  rigid<double>* staged_T_cw_ = nullptr;
  camera_track* staged_tracks_ = nullptr;
  arena<space> memory_;
  arena<staging> staging_memory_;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
