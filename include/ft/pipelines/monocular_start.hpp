// SPDX-License-Identifier: Apache-2.0
/// @file Pipeline: the start of a map with one camera, for a batch of cameras, in memory allocated
/// once.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "ft/cameras/pinhole.hpp"
#include "ft/containers/feature_grid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/two_views.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/images/undistort.hpp"
#include "ft/kernels/monocular/initial_matches.hpp"
#include "ft/kernels/monocular/start_rules.hpp"
#include "ft/kernels/two_view/reconstruct.hpp"
#include "ft/pipelines/check_params.hpp"
#include "ft/types/odometry_params.hpp"

namespace ft {
inline namespace FT_ABI {

/// Looks for two frames of each camera that a map can start from. A frame with enough keypoints is
/// the first one; later ones are matched with it, until a pair has a reconstruction, or a frame has
/// too few keypoints or matches. add() is asynchronous on the executor, allocates nothing and never
/// waits. Not thread-safe; instances are independent. Move-only. A moved-from start refuses every
/// call with bad_argument.
///
/// Frames are extracted with more features than are tracked, in the original five times as many.
/// A start is a reconstruction of scale 1: bundle adjustment and the choice of a scale are the
/// caller's.
template <typename Exec>
class monocular_start {
public:
  static constexpr memory_space space = Exec::space;

  monocular_start() = default;
  /// Waits for the upload of its tables.
  /// @param cameras one each, of the pixels of start_frames
  /// @param grid over the bounds of undistorted keypoints
  /// @param capacity of the keypoints of a frame
  /// @throws bad_argument naming the value and the limit; std::bad_alloc or cuda_error if memory is
  ///   short
  monocular_start(Exec const& exec, monocular_start_params const& params,
                  std::vector<pinhole<float>> const& cameras, grid_geometry const& grid,
                  int capacity)
      : params_(params) {
    check(params);
    detail::require_range("cameras", cameras.size(), std::size_t{1}, std::size_t{4096});
    detail::require_range("capacity", capacity, 1, (1 << 23) - 1);
    detail::require_range("columns of the grid", grid.cols, 1, 1 << 14);
    detail::require_range("rows of the grid", grid.rows, 1, 1 << 14);
    for (auto const& c : cameras) { c.check(); }
    int const batch = static_cast<int>(cameras.size());
    detail::require_items("keypoints of a batch", cameras.size(),
                          static_cast<std::size_t>(capacity));
    memory_ = owner<memory, space>([&](carver& c, memory& m) {
      carve(c, m.start.first, capacity, batch);
      carve(c, m.start.first_pixels, capacity, batch);
      m.start.active = c.take<int>(cameras.size());
      m.start.progress = c.take<detail::start_progress>(cameras.size());
      m.start.report = c.take<start_report>(cameras.size());
      m.start.seed = c.take<std::uint64_t>(cameras.size());
      carve(c, m.start.matches, capacity, batch);
      carve(c, m.grids, grid, capacity, batch);
      carve(c, m.search, capacity, capacity, batch);
      carve(c, m.reconstructions, batch, capacity);
      carve(c, m.two_views, batch, capacity, params.two_views.samples);
      m.cameras = c.take<pinhole<float>>(cameras.size());
    });
    copy(exec, memory_->cameras, cameras.data(), cameras.size());
    restart(exec);
    exec.wait();
  }

  /// Enqueues that no camera has a first frame, nor made an attempt.
  void restart(Exec const& exec) {
    memory_.require_made("start");
    auto const& m = memory_->start;
    auto const batch = static_cast<std::size_t>(m.first.batch);
    fill_bytes(exec, m.progress, 0, batch * sizeof *m.progress);
    fill_bytes(exec, m.report, 0, batch * sizeof *m.report);
    fill(exec, m.first, 0);
  }

  /// Enqueues the next frame of every camera.
  /// @throws bad_argument for null views, another shape than the constructor's, or no times though
  ///   the start is inertial
  void add(Exec const& exec, start_frames const& frames) {
    memory_.require_made("start");
    detail::start_memory const& m = memory_->start;
    detail::require_pixels("keypoints", frames.keypoints);
    detail::require_pixels("pixels of two views", frames.pixels);
    detail::require(array_of<field::orb>(frames.keypoints) != nullptr,
                    "the keypoints' descriptors are null");
    detail::require_same_shape("keypoints of a frame and of the start", frames.keypoints, m.first);
    detail::require_same_shape("pixels of two views and the start", frames.pixels, m.first);
    detail::require(!params_.rules.inertial || frames.time_s != nullptr,
                    "the frames of an inertial start have no times");
    int const batch = m.first.batch;
    for_each_item<per_thread>(exec, batch, detail::open_start_frame{}, frames, params_.rules, m);
    for_each_item<per_thread>(exec, batch * m.first.capacity, detail::keep_first_keypoint{}, frames,
                              m);
    build_grid<nearest_cell>(exec, frames.keypoints, 0, 1, batch, memory_->grids);
    keypoints_view searched = m.first;
    searched.count = m.active;
    search_initial_matches(exec, {searched, frames.keypoints, memory_->grids}, params_.matching,
                           m.matches, memory_->search);
    for_each_item<per_thread>(exec, batch, detail::judge_initial_matches{}, params_.rules, m);
    pixels_view first = m.first_pixels;
    first.count = m.active;
    pixels_view second = frames.pixels;
    second.count = frames.keypoints.count;
    reconstruct_two_views(exec, {first, second, m.matches.match, memory_->cameras, m.seed},
                          params_.two_views, memory_->reconstructions, memory_->two_views);
    for_each_item<per_block<256>>(exec, batch, detail::finish_start{}, memory_->reconstructions, m);
  }

  // Views into executor memory, valid as long as the start. Contents are those of the last add().
  start_report const* reports() const { return memory_->start.report; }  ///< [cameras]
  /// [cameras] whether each has a first frame, and the attempts since; all 0 = it begins anew
  detail::start_progress* progress() const { return memory_->start.progress; }
  /// First frames; also those of the last start.
  keypoints_view first() const { return memory_->start.first; }
  /// Matches of the first frames' keypoints with the last frames. Of few_matches, and of no_motion:
  /// all; of started: those with a triangulated point.
  initial_matches_view matches() const { return memory_->start.matches; }
  two_view_reconstructions reconstructions() const { return memory_->reconstructions; }

  monocular_start_params const& params() const { return params_; }
  int batch() const { return memory_->start.first.batch; }
  int capacity() const { return memory_->start.first.capacity; }
  std::size_t bytes() const { return memory_.bytes(); }  ///< of executor memory

private:
  struct memory {
    detail::start_memory start;
    feature_grid_view grids;
    initial_match_workspace search;
    two_view_reconstructions reconstructions;
    two_view_workspace two_views;
    pinhole<float>* cameras = nullptr;
  };

  monocular_start_params params_;
  owner<memory, space> memory_;
};

}  // namespace FT_ABI
}  // namespace ft
