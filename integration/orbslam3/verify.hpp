// SPDX-License-Identifier: Apache-2.0
/// @file Compares CPU and GPU on each frame.
#pragma once

#include <cstddef>
#include <ostream>
#include <type_traits>
#include <utility>
#include <vector>

#include "integration/orbslam3/accelerator.hpp"
#include "integration/orbslam3/verify_features.hpp"
#include "integration/orbslam3/verify_report.hpp"
#include "integration/orbslam3/verify_states.hpp"

namespace ft::orbslam3 {

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

  /// @param cpu Frame::ComputeStereoMatches or ComputeStereoFishEyeMatches
  template <typename Cpu>
  void stereo(frame_type& frame, Cpu const& cpu) {
    begin(frame, stage::stereo);
    auto const read = [&] {
      readings r;
      r.add("right column", frame.mvuRight, tolerances_.pixels);
      r.add("depth", frame.mvDepth, tolerances_.depth, tolerances_.depth);
      r.add("right partner of left keypoint", frame.mvLeftToRightMatch);
      r.add("left partner of right keypoint", frame.mvRightToLeftMatch);
      return r;
    };
    cpu();
    readings const by_cpu = read();
    gpu_->compute_stereo(frame);
    log_.compare(by_cpu, read());
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
    local_state const before(frame, points);
    auto const count_visible = [&](local_state const& state, int n) {
      for (std::size_t i = 0; i < points.size(); ++i) {
        if (tested[i] && is_in_view(state.seen[i])) { points[i]->IncreaseVisible(n); }
      }
    };
    auto const put = [&](local_state const& state) {
      frame.mvpMapPoints = state.held;
      frame.mmProjectPoints = state.drawn;
      for (std::size_t i = 0; i < points.size(); ++i) {
        tracked_members(*points[i]) = state.seen[i];
      }
    };
    auto const run = [&](auto const& call) {
      int const matches = call();
      outcome<local_state> result{matches, {frame, points}, {}};
      add_matches(result.seen, matches, frame.mvpMapPoints);
      for (std::size_t i = 0; i < points.size(); ++i) {
        add_tracked(result.seen, result.left.seen[i], static_cast<long>(i), frame.Nleft != -1,
                    tolerances_);
      }
      count_visible(result.left, -1);
      put(before);
      return result;
    };
    auto const kept = trial(outcome<local_state>{0, before, {}}, run, cpu, [&] {
      return gpu_->search_local_points(frame, points, th, far_points, far_threshold);
    });
    put(kept.left);
    count_visible(kept.left, 1);
    return kept.answer;
  }

  /// @param cpu Optimizer::PoseOptimization; returns its inliers
  template <typename Cpu>
  int pose_optimization(frame_type& frame, stage which, Cpu const& cpu) {
    begin(frame, which);
    auto const before = std::make_pair(frame.GetPose(), frame.mvbOutlier);
    using left = std::decay_t<decltype(before)>;
    auto const put = [&](left const& state) {
      frame.SetPose(state.first);
      frame.mvbOutlier = state.second;
    };
    auto const run = [&](auto const& call) {
      int const inliers = call();
      outcome<left> result{inliers, {frame.GetPose(), frame.mvbOutlier}, {}};
      readings& r = result.seen;
      r.add("inliers", -1, inliers);
      for (std::size_t i = 0; i < frame.mvbOutlier.size(); ++i) {
        if (frame.mvpMapPoints[i] == nullptr) { continue; }
        r.add("outlier", static_cast<long>(i), frame.mvbOutlier[i]);
      }
      pose const T_cw = transform_of(result.left.first);
      r.add("rotation entry", T_cw.R, tolerances_.pose);
      r.add("translation entry", T_cw.t, tolerances_.pose);
      put(before);
      return result;
    };
    auto const kept = trial(outcome<left>{0, before, {}}, run, cpu,
                            [&] { return gpu_->pose_optimization(frame, which); });
    put(kept.left);
    return kept.answer;
  }

  /// @param cpu Optimizer::PoseInertialOptimizationLastFrame or ...LastKeyFrame
  template <typename Cpu>
  int inertial_pose_optimization(frame_type& frame, stage which, Cpu const& cpu) {
    begin(frame, which);
    bool const from_last = which == stage::pose_inertial_last_frame;
    int const steps =
        has_inertial_start(frame, from_last, true) ? inertial_steps(frame, from_last) : 0;
    inertial_trials<frame_type> trials(frame, steps, tolerances_);
    auto kept = trial(
        typename inertial_trials<frame_type>::outcome{},
        [&](auto const& call) { return trials.run(call); }, cpu,
        [&] { return gpu_->inertial_pose_optimization(frame, which); });
    trials.keep(kept);
    return kept.answer;
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
      outcome<std::vector<map_point*>> result{n, matches, {}};
      add_matches(result.seen, n, matches);
      return result;
    };
    auto const kept = trial(outcome<std::vector<map_point*>>{}, run, cpu, [&] {
      return gpu_->search_by_bow(keyframe, frame, matches, ratio, orientation_check);
    });
    matches = kept.left;
    return kept.answer;
  }

private:
  /// What a call returned, what it left, and what is compared of that.
  template <typename Left>
  struct outcome {
    int answer;
    Left left;
    readings seen;
  };
  struct local_state {
    std::vector<map_point*> held;
    std::vector<tracked_values> seen;
    decltype(frame_type::mmProjectPoints) drawn;

    local_state(frame_type const& frame, std::vector<map_point*> const& points)
        : held(frame.mvpMapPoints), drawn(frame.mmProjectPoints) {
      for (map_point const* const p : points) { seen.emplace_back(tracked_members(*p)); }
    }
  };

  /// @param kept an outcome to begin with @param run makes a call, and starts from the same state
  /// each time @return the accelerator's outcome; where it refuses, the CPU's
  template <typename Outcome, typename Run, typename Cpu, typename Gpu>
  Outcome trial(Outcome kept, Run const& run, Cpu const& cpu, Gpu const& on_gpu) {
    log_.make([&] {
      Outcome cpu_first = run(cpu);
      kept = run(on_gpu);
      if (kept.answer == call_refused) {
        kept = std::move(cpu_first);
        return log_.add_refusal();
      }
      log_.compare(cpu_first.seen, run(cpu).seen, kept.seen);
    });
    return kept;
  }
  /// A search that changes the points of a frame.
  template <typename Cpu, typename Gpu>
  int search(frame_type& frame, Cpu const& cpu, Gpu const& on_gpu) {
    auto const before = frame.mvpMapPoints;
    auto const run = [&](auto const& call) {
      int const matches = call();
      outcome<std::vector<map_point*>> result{
          matches, std::exchange(frame.mvpMapPoints, before), {}};
      add_matches(result.seen, matches, result.left);
      return result;
    };
    auto const kept = trial(outcome<std::vector<map_point*>>{}, run, cpu, on_gpu);
    frame.mvpMapPoints = kept.left;
    return kept.answer;
  }
  static void add_matches(readings& to, int matches, std::vector<map_point*> const& points) {
    to.add("matches", -1, matches);
    to.add("keypoints of the search", -1, points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
      to.add("map point of keypoint", static_cast<long>(i),
             points[i] == nullptr ? -1.0 : static_cast<double>(points[i]->mnId));
    }
  }
  void begin(frame_type const& frame, stage s) {
    log_.begin(frame.mnId, s);
    elsewhere_.add_to(log_);
  }

  accelerator<Types>* gpu_;
  difference_log log_;
  calls_elsewhere elsewhere_;
  hook_watch<map_point> hooks_;
  tolerances tolerances_;
};

}  // namespace ft::orbslam3
