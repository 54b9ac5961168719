// SPDX-License-Identifier: Apache-2.0
/// @file Compares CPU and GPU on each frame.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <ostream>
#include <type_traits>
#include <utility>
#include <vector>

#include "integration/orbslam3/accelerator.hpp"
#include "integration/orbslam3/keypoint_sets.hpp"
#include "integration/orbslam3/verify_grid.hpp"
#include "integration/orbslam3/verify_inertial.hpp"
#include "integration/orbslam3/verify_recovery.hpp"
#include "integration/orbslam3/verify_report.hpp"
#include "integration/orbslam3/verify_tracked.hpp"
#include "integration/orbslam3/verify_words.hpp"

namespace ft {
namespace orbslam3 {

/// Makes each call in the CPU's own code and, from the same state, on the accelerator, whose result
/// is kept. For finding errors, not for speed.
///
/// Mapping changes points concurrently. Stages that read the map are therefore run by the CPU once
/// more after the accelerator. Only values that differ from both of the CPU's results count, if
/// they do so again: see difference_log::make(). What the accelerator refuses is no difference, but
/// the CPU's, and counted apart. With hooks, points of the local map that changed without one are
/// told.
template <typename Types>
class verifier {
public:
  using frame_type = typename Types::frame;
  using map_point = typename Types::map_point;
  using report = difference_log::report;

  /// @param to called with every difference; may be empty
  verifier(accelerator<Types>& gpu, report to, tolerances const& t = {})
      : gpu_(&gpu), log_(std::move(to)), tolerances_(t) {}

  long differences() const { return log_.differences(); }
  /// Prints a line for each later frame, with the first difference of each stage.
  void print_frames(std::ostream& out) { log_.print_frames(out); }
  /// Ends the last frame's line and prints the number of frames and calls, and of those with
  /// differences.
  void summary(std::ostream& out) {
    elsewhere_.add_to(log_);
    log_.summary(out);
  }

  /// Image features of a frame: compared as sets first, then in order.
  /// @param cpu fills the frame as Frame::ExtractORB of all images does
  template <typename Cpu, typename... Images>
  void extract(frame_type& frame, Cpu const& cpu, Images const&... images) {
    begin(frame, stage::extract);
    cpu();
    auto const left = frame.mvKeys;
    auto const right = frame.mvKeysRight;
    auto const left_rows = frame.mDescriptors.clone();
    auto const right_rows = frame.mDescriptorsRight.clone();
    int const mono = frame.monoLeft;
    gpu_->extract(images..., frame);
    log_.compare("keypoints outside of the overlap", -1, mono, frame.monoLeft);
    compare_features(log_, "left keypoints: same set, other order", left, frame.mvKeys, left_rows,
                     frame.mDescriptors);
    if (sizeof...(images) < 2) { return; }
    compare_features(log_, "right keypoints: same set, other order", right, frame.mvKeysRight,
                     right_rows, frame.mDescriptorsRight);
  }

  /// Positions without distortion, compared to the bit. @param cpu Frame::UndistortKeyPoints
  template <typename Cpu>
  void undistort(frame_type& frame, Cpu const& cpu) {
    begin(frame, stage::undistort);
    cpu();
    auto const want = frame.mvKeysUn;
    gpu_->undistort(frame);
    log_.compare("number of undistorted keypoints", -1, want.size(), frame.mvKeysUn.size());
    for (std::size_t i = 0; i < want.size() && i < frame.mvKeysUn.size(); ++i) {
      auto const at = static_cast<long>(i);
      log_.compare("x of undistorted keypoint", at, want[i].pt.x, frame.mvKeysUn[i].pt.x);
      log_.compare("y of undistorted keypoint", at, want[i].pt.y, frame.mvKeysUn[i].pt.y);
    }
  }

  /// The keypoints of each cell, in order; cells are numbered column by column.
  /// @param cpu Frame::AssignFeaturesToGrid
  template <typename Cpu>
  void assign_to_grid(frame_type& frame, Cpu const& cpu) {
    begin(frame, stage::grid);
    cpu();
    auto const left = cells_of(frame.mGrid);
    auto const right = cells_of(frame.mGridRight);
    clear_cells(frame.mGrid);
    clear_cells(frame.mGridRight);
    gpu_->assign_to_grid(frame);
    compare_cells(log_, "cell of the grid", left, cells_of(frame.mGrid));
    compare_cells(log_, "cell of the right grid", right, cells_of(frame.mGridRight));
  }

  /// @param cpu Frame::ComputeStereoMatches or ComputeStereoFishEyeMatches
  /// @param gpu the accelerator's function for the same
  template <typename Cpu, typename Gpu>
  void stereo(frame_type& frame, Cpu const& cpu, Gpu const& gpu) {
    begin(frame, stage::stereo);
    cpu();
    auto const right_x = frame.mvuRight;
    auto const depth = frame.mvDepth;
    auto const left_to_right = frame.mvLeftToRightMatch;
    auto const right_to_left = frame.mvRightToLeftMatch;
    gpu();
    compare_numbers("right column", right_x, frame.mvuRight, tolerances_.pixels, 0);
    compare_numbers("depth", depth, frame.mvDepth, tolerances_.depth, tolerances_.depth);
    compare_numbers("right partner of left keypoint", left_to_right, frame.mvLeftToRightMatch, 0,
                    0);
    compare_numbers("left partner of right keypoint", right_to_left, frame.mvRightToLeftMatch, 0,
                    0);
  }

  /// @param cpu ORBmatcher::SearchByProjection with the same arguments; returns its matches
  template <typename Cpu>
  int search_by_projection(frame_type& current, frame_type const& last, float th, bool mono,
                           Cpu const& cpu) {
    begin(current, stage::search_last_frame);
    return search(current, cpu,
                  [&] { return gpu_->search_by_projection(current, last, th, mono); });
  }

  /// @param cpu ORBmatcher::SearchByProjection with the same arguments; returns its matches
  template <typename KeyFrame, typename Found, typename Cpu>
  int search_keyframe(frame_type& frame, KeyFrame& keyframe, Found const& found, float th,
                      int max_distance, Cpu const& cpu) {
    begin(frame, stage::search_keyframe);
    return search(frame, cpu,
                  [&] { return gpu_->search_keyframe(frame, keyframe, found, th, max_distance); });
  }

  /// The solver of the CPU goes on with each call, so it is called once.
  /// @param to the variables that `cpu` writes to, too
  /// @param cpu MLPnPsolver::iterate(); returns whether there is a pose
  template <typename Cpu>
  bool solve_pnp(frame_type const& frame, std::vector<map_point*> const& matches,
                 pnp_progress& progress, pnp_answer const& to, Cpu const& cpu) {
    begin(frame, stage::solve_pnp);
    pnp_trial const by_cpu(cpu() ? 1 : 0, to);
    pnp_trial const by_gpu(gpu_->solve_pnp(frame, matches, progress, to), to);
    bool const refused = by_gpu.found == recovery_refused;
    if (refused) {
      log_.add_refusal();
    } else {
      compare_pnp(log_, tolerances_, by_cpu, by_gpu, matches);
    }
    pnp_trial const& kept = refused ? by_cpu : by_gpu;
    kept.keep(to);
    return kept.found == 1;
  }

  /// @param cpu the frustum test of all points and ORBmatcher::SearchByProjection; returns matches
  template <typename Cpu>
  int search_local_points(frame_type& frame, std::vector<map_point*> const& points, float th,
                          bool far_points, float far_threshold, Cpu const& cpu) {
    begin(frame, stage::search_local_map);
    std::vector<bool> tested;
    for (map_point* const p : points) {
      hooks_.add(log_, gpu_->mirror(), *p, frame.mnId);
      tested.push_back(p->mnLastFrameSeen != frame.mnId && !p->isBad());
    }
    local_state const before(0, frame, points);
    auto const count_visible = [&](local_state const& state, int n) {
      for (std::size_t i = 0; i < points.size(); ++i) {
        tracked const& t = state.seen[i];
        if (tested[i] && (t.in_view || t.in_view_right)) { points[i]->IncreaseVisible(n); }
      }
    };
    auto const put = [&](local_state const& state) {
      frame.mvpMapPoints = state.held.points;
      frame.mmProjectPoints = state.drawn;
      for (std::size_t i = 0; i < points.size(); ++i) { state.seen[i].restore(*points[i]); }
    };
    auto const run = [&](auto const& call) {
      int const matches = call();
      local_state state(matches, frame, points);
      count_visible(state, -1);
      put(before);
      return state;
    };
    local_state kept = before;
    log_.make([&] {
      local_state const cpu_first = run(cpu);
      kept = run(
          [&] { return gpu_->search_local_points(frame, points, th, far_points, far_threshold); });
      local_state const cpu_again = run(cpu);
      compare_matches(cpu_first.held, cpu_again.held, kept.held);
      for (std::size_t i = 0; i < points.size(); ++i) {
        compare_tracked<map_point>(log_, tolerances_, static_cast<long>(i), frame.Nleft != -1,
                                   {cpu_first.seen[i], cpu_again.seen[i], kept.seen[i]});
      }
    });
    put(kept);
    count_visible(kept, 1);
    return kept.held.matches;
  }

  /// @param cpu Optimizer::PoseOptimization; returns its inliers
  template <typename Cpu>
  int pose_optimization(frame_type& frame, stage which, Cpu const& cpu) {
    begin(frame, which);
    auto const start = frame.GetPose();
    auto const outliers = frame.mvbOutlier;
    auto const run = [&](auto const& call) {
      int const inliers = call();
      posed<std::decay_t<decltype(start)>> result{inliers, frame.GetPose(),
                                                  std::exchange(frame.mvbOutlier, outliers)};
      frame.SetPose(start);
      return result;
    };
    posed<std::decay_t<decltype(start)>> kept{0, start, outliers};
    log_.make([&] {
      auto const cpu_first = run(cpu);
      kept = run([&] { return gpu_->pose_optimization(frame, which); });
      compare_poses(frame, cpu_first, run(cpu), kept);
    });
    frame.SetPose(kept.pose);
    frame.mvbOutlier = kept.outliers;
    return kept.inliers;
  }

  /// @param cpu Optimizer::PoseInertialOptimizationLastFrame or ...LastKeyFrame
  template <typename Cpu>
  int inertial_pose_optimization(frame_type& frame, stage which, Cpu const& cpu) {
    begin(frame, which);
    inertial_trials<frame_type> trials(frame);
    typename inertial_trials<frame_type>::outcome kept;
    log_.make([&] {
      auto cpu_first = trials.run(cpu);
      kept = trials.run([&] { return gpu_->inertial_pose_optimization(frame, which); });
      if (kept.tracked == inertial_refused) {
        kept = std::move(cpu_first);
        return log_.add_refusal();
      }
      auto const cpu_again = trials.run(cpu);
      inertial_comparison(log_, tolerances_, cpu_first, cpu_again, kept)
          .add(frame.mvpMapPoints, inertial_steps(frame, which == stage::pose_inertial_last_frame));
    });
    trials.keep(kept);
    return kept.tracked;
  }

  /// @param cpu Frame::ComputeBoW
  template <typename Cpu>
  void compute_bow(frame_type& frame, Cpu const& cpu) {
    begin(frame, stage::transform);
    verify_words(log_, frame, cpu, [&] { gpu_->compute_bow(frame); });
  }
  /// From any thread. What differs is added to the line of the frame that tracking is at.
  /// @param cpu KeyFrame::ComputeBoW
  template <typename KeyFrame, typename Cpu>
  void compute_bow(KeyFrame& keyframe, Cpu const& cpu) {
    elsewhere_.make(keyframe.mnFrameId, stage::transform, [&](difference_log& log) {
      verify_words(log, keyframe, cpu, [&] { gpu_->compute_bow(keyframe); });
    });
  }

  /// @param cpu ORBmatcher::SearchByBoW with the same arguments; returns its matches
  template <typename KeyFrame, typename Cpu>
  int search_by_bow(KeyFrame& keyframe, frame_type const& frame, std::vector<map_point*>& matches,
                    float ratio, bool orientation_check, Cpu const& cpu) {
    begin(frame, stage::search_by_bow);
    auto const run = [&](auto const& call) {
      matches.clear();
      int const n = call();
      return matched{n, matches};
    };
    matched const kept = compared_matches(run, cpu, [&] {
      return gpu_->search_by_bow(keyframe, frame, matches, ratio, orientation_check);
    });
    matches = kept.points;
    return kept.matches;
  }

private:
  using tracked = tracked_values<map_point>;
  static std::vector<tracked> tracked_of(std::vector<map_point*> const& points) {
    std::vector<tracked> all;
    all.reserve(points.size());
    for (map_point const* const p : points) { all.emplace_back(*p); }
    return all;
  }
  struct matched {
    int matches;
    std::vector<map_point*> points;
  };
  /// A search that changes the points of a frame.
  template <typename Cpu, typename Gpu>
  int search(frame_type& frame, Cpu const& cpu, Gpu const& on_gpu) {
    auto const before = frame.mvpMapPoints;
    auto const run = [&](auto const& call) {
      int const matches = call();
      return matched{matches, std::exchange(frame.mvpMapPoints, before)};
    };
    matched const kept = compared_matches(run, cpu, on_gpu);
    frame.mvpMapPoints = kept.points;
    return kept.matches;
  }
  /// @param run makes a call, and starts from the same state each time
  template <typename Run, typename Cpu, typename Gpu>
  matched compared_matches(Run const& run, Cpu const& cpu, Gpu const& on_gpu) {
    matched kept{};
    log_.make([&] {
      matched const cpu_first = run(cpu);
      kept = run(on_gpu);
      if (kept.matches == recovery_refused) {
        kept = cpu_first;
        return log_.add_refusal();
      }
      compare_matches(cpu_first, run(cpu), kept);
    });
    return kept;
  }
  struct local_state {
    matched held;
    std::vector<tracked> seen;
    decltype(frame_type::mmProjectPoints) drawn;

    local_state(int matches, frame_type const& frame, std::vector<map_point*> const& points)
        : held{matches, frame.mvpMapPoints},
          seen(tracked_of(points)),
          drawn(frame.mmProjectPoints) {}
  };
  template <typename Pose>
  struct posed {
    int inliers;
    Pose pose;
    std::vector<bool> outliers;
  };
  template <typename Pose>
  void compare_poses(frame_type const& frame, posed<Pose> const& cpu, posed<Pose> const& again,
                     posed<Pose> const& gpu) {
    log_.compare("inliers", -1, cpu.inliers, again.inliers, gpu.inliers);
    for (std::size_t i = 0; i < gpu.outliers.size(); ++i) {
      if (frame.mvpMapPoints[i] == nullptr) { continue; }
      log_.compare("outlier", static_cast<long>(i), cpu.outliers[i], again.outliers[i],
                   gpu.outliers[i]);
    }
    transform const a = transform_of(cpu.pose);
    transform const b = transform_of(again.pose);
    transform const g = transform_of(gpu.pose);
    for (int i = 0; i < 9; ++i) {
      log_.compare("rotation entry", i, a.R[i], b.R[i], g.R[i], tolerances_.pose);
    }
    for (int i = 0; i < 3; ++i) {
      log_.compare("translation entry", i, a.t[i], b.t[i], g.t[i], tolerances_.pose);
    }
  }
  void begin(frame_type const& frame, stage s) {
    log_.begin(frame.mnId, s);
    elsewhere_.add_to(log_);
  }

  template <typename T>
  void compare_numbers(char const* what, std::vector<T> const& cpu, std::vector<T> const& gpu,
                       double allowed, double relative) {
    log_.compare(what, -1, cpu.size(), gpu.size());
    for (std::size_t i = 0; i < cpu.size() && i < gpu.size(); ++i) {
      auto const size = static_cast<double>(cpu[i]);
      // A value that only one of them has is not a rounding difference.
      double const limit = (cpu[i] < 0) != (gpu[i] < 0) ? 0 : allowed + relative * std::abs(size);
      log_.compare(what, static_cast<long>(i), cpu[i], cpu[i], gpu[i], limit);
    }
  }
  void compare_matches(matched const& cpu, matched const& again, matched const& gpu) {
    auto const id = [](map_point const* p) {
      return p == nullptr ? -1.0 : static_cast<double>(p->mnId);
    };
    log_.compare("matches", -1, cpu.matches, again.matches, gpu.matches);
    if (gpu.points.size() != cpu.points.size()) {
      log_.compare("keypoints of the search", -1, cpu.points.size(), gpu.points.size());
      return;
    }
    for (std::size_t i = 0; i < cpu.points.size(); ++i) {
      log_.compare("map point of keypoint", static_cast<long>(i), id(cpu.points[i]),
                   id(again.points[i]), id(gpu.points[i]));
    }
  }

  accelerator<Types>* gpu_;
  difference_log log_;
  calls_elsewhere elsewhere_;
  hook_watch<map_point> hooks_;
  tolerances tolerances_;
};

}  // namespace orbslam3
}  // namespace ft
