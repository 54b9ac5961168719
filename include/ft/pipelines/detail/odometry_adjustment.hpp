// SPDX-License-Identifier: Apache-2.0
/// @file Adjustments of an odometry beside its tracking, and the frames with which they end.
#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>
#include <vector>

#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/recording.hpp"
#include "ft/kernels/window/adjust_window.hpp"
#include "ft/pipelines/detail/odometry_memory.hpp"
#include "ft/pipelines/detail/odometry_part.hpp"
#include "ft/pipelines/detail/rig_parts.hpp"
#include "ft/pipelines/detail/work_beside.hpp"
#include "ft/types/odometry_params.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// One adjustment of the windows of some cameras.
template <typename Exec, typename Rig>
struct adjustment_work {
  typename rig_parts<Rig>::searched_rig rig{};
  window_problem_view window;
  window_workspace workspace;
  window_params params;
  int* selected = nullptr;               ///< [batch] executor memory
  int const* staged_selected = nullptr;  ///< [runs][batch] staging memory
  int runs = 1;
  odometry_part_list<Exec, Rig> const* parts = nullptr;
  recording<Exec> graph;

  void enqueue(Exec const& exec, int run) {
    auto const n = static_cast<std::size_t>(window.batch);
    copy(exec, selected, staged_selected + static_cast<std::size_t>(run % runs) * n, n);
    graph.replay(exec, [&](Exec const& e) { adjust(e); });
  }
  void adjust(Exec const& exec) const {
    adjust_window(exec, rig, window, selected, params, workspace);
    for (auto const& p : *parts) { p->after_adjustment(exec, selected, window); }
  }
};

/// Launches adjustments and tells with which frame each one ends, by numbers of frames alone: a run
/// that begins after frame k ends with frame k + delay.
template <typename Exec, typename Rig>
class odometry_adjustments {
  using work_type = adjustment_work<Exec, Rig>;

public:
  /// @param delay frames, 1 or more
  odometry_adjustments(Exec const& exec, odometry_memory<Exec> const& memory,
                       odometry_part_list<Exec, Rig> const& parts,
                       typename rig_parts<Rig>::searched_rig const& rig,
                       odometry_params const& params)
      : memory_(memory), runs_(static_cast<std::size_t>(params.adjustment_delay), -1) {
    work_type work;
    work.rig = rig;
    work.parts = &parts;
    work.window = memory.window;
    work.workspace = memory.window_work;
    work.params = params.adjustment;
    work.selected = memory.selected;
    work.staged_selected = memory.staged_selected;
    work.runs = params.adjustment_delay;
    if (params.use_graphs) {
      work.graph.record(exec, [&](Exec const& e) { work.adjust(e); });
    }
    beside_ = std::make_unique<work_beside<Exec, work_type>>(exec, std::move(work),
                                                             params.adjustment_delay);
  }

  /// Before a frame: makes it wait for the adjustment that ends with it, and sets the inputs of its
  /// cameras.
  void end_before(Exec const& exec, long long frame) {
    int const batch = memory_.window.batch;
    int& run = runs_[index(frame)];
    for (int b = 0; b < batch; ++b) { memory_.inputs[b].window = 0; }
    if (run < 0) { return; }
    beside_->finish(exec, run);
    int const* const flags = selected_by(run);
    for (int b = 0; b < batch; ++b) { memory_.inputs[b].window = flags[b]; }
    run = -1;
  }
  /// After a frame whose outputs are complete: launches the adjustment of the cameras that gathered
  /// one. @param end of the frame
  void begin_after(long long frame, work_mark<Exec> const& end) {
    int const batch = memory_.window.batch;
    bool any = false;
    for (int b = 0; b < batch; ++b) { any = any || memory_.outputs[b].gathered != 0; }
    if (!any) { return; }
    int* const flags = selected_by(next_);
    for (int b = 0; b < batch; ++b) { flags[b] = memory_.outputs[b].gathered; }
    ++next_;
    beside_->begin_after(end);
    runs_[index(frame)] = beside_->begin();
  }

private:
  std::size_t index(long long frame) const {
    return static_cast<std::size_t>(frame) % runs_.size();
  }
  int* selected_by(int run) const {
    auto const n = static_cast<std::size_t>(memory_.window.batch);
    return memory_.staged_selected + static_cast<std::size_t>(run) % runs_.size() * n;
  }

  odometry_memory<Exec> const& memory_;
  std::vector<int> runs_;  ///< by frame number modulo the delay; -1 = none
  int next_ = 0;
  std::unique_ptr<work_beside<Exec, work_type>> beside_;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
