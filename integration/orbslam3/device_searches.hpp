// SPDX-License-Identifier: Apache-2.0
/// @file Searches and pose optimisation over an executor's frames and map: their memory and their
/// launches.
#pragma once

#include <cstddef>

#include "ft/containers/frame.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/pose/optimize_frame.hpp"
#include "ft/kernels/search/assignment.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/keyframe.hpp"
#include "ft/kernels/search/last_frame.hpp"
#include "ft/kernels/search/local_map.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "integration/orbslam3/device_frames.hpp"
#include "integration/orbslam3/device_map.hpp"
#include "integration/orbslam3/executor_calls.hpp"
#include "integration/orbslam3/rigs.hpp"

namespace ft::orbslam3 {
inline namespace FT_ABI {

/// Writes the windows of recorded sights to their places.
struct place_recorded_window {
  using scratch = no_scratch;

  /// @param radius_factor of the left camera @param right_column whether right columns are searched
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, recorded_sight const* recorded,
                                 visibility const* seen, float radius_factor, bool right_column,
                                 pyramid_geometry const& geometry,
                                 search_windows_view const& windows) const {
    recorded_sight const& r = recorded[item];
    bool const right_alone = r.camera == recorded_sight::not_right_alone;
    if (right_alone && seen[r.index].level >= 0) { return; }
    int const camera = right_alone ? 1 : r.camera;
    windows.windows[static_cast<std::ptrdiff_t>(camera) * windows.capacity + r.index] =
        right_alone
            ? search_window::none()
            : window_of(r.seen, r.slot, camera == 0 ? radius_factor : 1.0f, right_column, geometry);
  }
};

/// Excludes points from both cameras if the left camera sees them beyond the limit.
struct leave_out_far_point {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, visibility const* seen,
                                 float max_distance, search_windows_view const& windows) const {
    if (seen[item].level >= 0 && seen[item].distance > max_distance) {
      windows.windows[item] = search_window::none();
      windows.windows[windows.capacity + item] = search_window::none();
    }
  }
};

/// @tparam Rig rectified_rig or fisheye_rig
template <typename Exec, typename Rig>
class device_searches {
  static constexpr memory_space space = Exec::space;
  static constexpr memory_space staging = staging_space<Exec>;
  static constexpr int searched = searched_cameras<Rig>;
  static_assert(sizeof(search_inputs) % 8 == 0, "moved as words");

public:
  /// Further arguments of a call.
  struct context {
    frame_view frame;
    map_points_view map;
    pyramid_geometry geometry;
  };

  /// Allocates memory and enqueues its initial values. @param keypoints per image
  device_searches(Exec const& exec, Rig const& rig, settings const& s, int keypoints)
      : settings_(s), rig_(rig), keypoints_(keypoints), local_(keypoints, searched) {
    memory_ = arena<space>([&](carver& c) {
      carve(c, observations_, 2 * keypoints, 1);
      c.place(1, inputs_, optimized_, rounded_);
    });
    host_memory_ = arena<staging>([&](carver& c) {
      c.place(1, staged_, staged_optimized_);
      c.place(2, found_);
    });
    fill_bytes(exec, memory_.data(), 0, memory_.bytes());
    local_.reserve(exec, s.local_points);
  }

  /// Memory for local maps.
  local_memory<Exec>& local() { return local_; }
  /// As of device_tracker.
  recorded_sight* recorded_sights(int count) {
    detail::require_range("recorded sights", count, 0, searched * local_->capacity);
    return local_->staged_recorded;
  }

  // ---- inputs: staged here, uploaded by the first launch of a call

  void set(search_inputs const& inputs) { *staged_ = inputs; }
  /// Of a local map also adds slots and recorded sights to `up`, which precedes the search.
  void set_local_map(Exec const& exec, word_mover<Exec>& up, search_request const& r) {
    set(r.inputs);
    if (r.slots_changed) { up.add(exec, local_->slots, local_->staged_slots, r.inputs.slots); }
    up.add(exec, local_->recorded, local_->staged_recorded, r.recorded);
  }
  void upload(Exec const& exec) {
    word_mover<Exec> up;
    up.add(exec, inputs_, staged_, 1);
    up.flush(exec);
  }

  // ---- stages, enqueued after upload()

  void queue_last_frame(Exec const& exec, context const& c, search_request const& r,
                        device_frame const& last) {
    last_search<Rig> search;
    search.rig = rig_;
    search.T_cw = &inputs_->T_cw;
    search.last_T_cw = &inputs_->T_lw;
    search.rotations = &inputs_->rotation;
    search.last = {last.keypoints, 2, searched, last.holder};
    search.geometry = c.geometry;
    search.params.window_radius = r.window;
    search.params.ignore_motion_direction = r.ignore_motion_direction;
    search.params.reference_quirks = settings_.reference_quirks;
    search.params.min_x = r.image.min_x;
    search.params.min_y = r.image.min_y;
    search.params.max_x = r.image.max_x;
    search.params.max_y = r.image.max_y;
    local_->buffers.windows.capacity = searched * keypoints_;
    ft::search_last_frame(exec, search, c.frame, c.map, local_->buffers);
  }

  void queue_keyframe(Exec const& exec, context const& c, search_request const& r,
                      device_frame const& keyframe) {
    keyframe_search<left_camera_of<Rig>, searched> search;
    search.camera = detail::left_camera(rig_);
    search.T_cw = &inputs_->T_cw;
    search.keyframe = {keyframe.keypoints, 2, searched, keyframe.holder};
    search.frustum = frustum_of(r.image);
    search.geometry = c.geometry;
    search.params = {r.window, r.max_hamming};
    local_->buffers.windows.capacity = searched * keypoints_;
    ft::search_keyframe(exec, search, c.frame, c.map, local_->buffers);
  }

  /// Enqueues the frustum test, the candidates, and the download of how the points are seen.
  void queue_local_lists(Exec const& exec, context const& c, search_request const& r) {
    local_->buffers.windows.capacity = local_.size_of(r.inputs.slots);
    if (r.recorded == 0 && !by_both(r)) {
      list_local_map(exec, search_of(r, c.geometry), c.frame, c.map, local_->buffers);
    } else {
      find_visible_points(exec, search_of(r, c.geometry), c.map, local_->buffers.windows);
    }
    word_mover<Exec> down;
    down.add(exec, local_->staged_sights, local_->seen,
             searched * local_->buffers.windows.capacity);
    down.flush(exec);
  }
  /// Enqueues the rest of the search.
  void queue_local_choice(Exec const& exec, context const& c, search_request const& r) {
    local_->buffers.windows.capacity = local_.size_of(r.inputs.slots);
    if (r.recorded == 0 && !by_both(r)) {
      assign_candidates(exec, c.frame, c.map, search_params{}, local_->buffers);
      return;
    }
    if (by_both(r)) {
      for_each_item<per_thread>(exec, r.inputs.slots, leave_out_far_point{},
                                static_cast<visibility const*>(local_->seen), r.max_distance,
                                local_->buffers.windows);
    }
    for_each_item<per_thread>(exec, r.recorded, place_recorded_window{},
                              static_cast<recorded_sight const*>(local_->recorded),
                              static_cast<visibility const*>(local_->seen), r.window,
                              bool{Rig::rectified}, c.geometry, local_->buffers.windows);
    search_by_projection(exec, c.frame, c.map, search_params{}, local_->buffers);
  }

  void queue_pose(Exec const& exec, context const& c) {
    pose_params exact;
    exact.small_step = 0;  // every step that the CPU takes
    optimize_frame_poses(
        exec, rig_, {c.frame, c.map, c.geometry},
        {&inputs_->T_cw, rounded_, observations_, nullptr, &inputs_->start, optimized_}, exact);
  }

  // ---- results: downloaded by the last launch, valid after exec.wait()

  void download_matches(Exec const& exec, int* holder, frame_view const& frame) {
    word_mover<Exec> down;
    down.add(exec, found_, local_->buffers.work.matches, 1);
    down.add(exec, holder, frame.holder, frame.numbers());
    down.flush(exec);
  }
  void download_pose(Exec const& exec, int* holder, frame_view const& frame) {
    word_mover<Exec> down;
    down.add(exec, staged_optimized_, optimized_, 1);
    down.add(exec, found_ + 1, observations_.inliers, 1);
    down.add(exec, holder, frame.holder, frame.numbers());
    down.flush(exec);
  }
  int matches() const { return found_[0]; }
  pose_result optimized() const { return {*staged_optimized_, found_[1]}; }
  local_sights sights(int points) const {
    visibility const* const seen = local_->staged_sights;
    return {{seen, seen + (searched - 1) * local_.size_of(points)}};
  }

private:
  static bool by_both(search_request const& r) { return !Rig::rectified && r.max_distance > 0; }

  frustum_params frustum_of(bounds const& image) const {
    frustum_params f{image.min_x, image.min_y, image.max_x, image.max_y};
    f.log_scale_factor = log_rounded(settings_.scale_factor);
    f.levels = settings_.levels;
    return f;
  }
  local_search<Rig> search_of(search_request const& r, pyramid_geometry const& geometry) const {
    local_search<Rig> search;
    search.rig = rig_;
    search.T_cw = &inputs_->T_cw;
    search.slots = local_->slots;
    search.slot_count = &inputs_->slots;
    search.frustum = frustum_of(r.image);
    search.geometry = geometry;
    search.params.radius_factor = r.window;
    search.params.max_distance = Rig::rectified ? r.max_distance : 0;
    search.seen = local_->seen;
    search.centres = inputs_->centres;
    return search;
  }

  settings settings_;
  Rig rig_;
  int keypoints_ = 0;
  observations_view observations_;
  search_inputs* inputs_ = nullptr;
  rigid<double>* optimized_ = nullptr;
  pose* rounded_ = nullptr;  ///< the same
  search_inputs* staged_ = nullptr;
  rigid<double>* staged_optimized_ = nullptr;
  int* found_ = nullptr;  ///< matches, inliers
  arena<space> memory_;
  arena<staging> host_memory_;
  local_memory<Exec> local_;  ///< its buffers also serve the other searches
};

}  // namespace FT_ABI
}  // namespace ft::orbslam3
