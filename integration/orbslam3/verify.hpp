// SPDX-License-Identifier: Apache-2.0
/// @file CPU and GPU side by side on each frame, and every difference between them.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <functional>
#include <ostream>
#include <type_traits>
#include <utility>
#include <vector>

#include "integration/orbslam3/accelerator.hpp"
#include "integration/orbslam3/keypoint_sets.hpp"

namespace ft {
namespace orbslam3 {

/// One value that differs, or the number of keypoints of a set that have other places.
struct difference {
  stage where;
  unsigned long frame;  ///< Frame::mnId
  char const* what;     ///< such as "map point", "octave"
  long index;           ///< of the keypoint or the local map's point; -1 = of the frame
  double cpu;           ///< map points by mnId, -1 = none
  double gpu;
  bool number = false;  ///< `gpu` alone says it
};

inline std::ostream& operator<<(std::ostream& out, difference const& d) {
  out << "frame " << d.frame << ", " << name_of(d.where) << ": " << d.what;
  if (d.number) { return out << ": " << d.gpu; }
  if (d.index >= 0) { out << " " << d.index; }
  return out << ": CPU " << d.cpu << ", GPU " << d.gpu;
}

/// Differences that are none: the two round differently.
struct tolerances {
  double pixels = 4e-3;  ///< of projections and right columns
  double depth = 1e-3;   ///< metres, and relative to a depth
  double cosine = 1e-5;  ///< of viewing angles
  double pose = 1e-4;    ///< of each entry
};

/// Makes each call by the CPU's own code and, from the same state, by the accelerator, whose answer
/// stays. For finding faults, not for speed.
///
/// Mapping changes points meanwhile. What reads the map is therefore run by the CPU once more after
/// the accelerator, and only what differs from both of the CPU's answers counts.
template <typename Types>
class verifier {
public:
  using frame_type = typename Types::frame;
  using map_point = typename Types::map_point;
  using report = std::function<void(difference const&)>;

  /// @param to called with every difference; may be empty
  verifier(accelerator<Types>& gpu, report to, tolerances const& t = {})
      : gpu_(&gpu), report_(std::move(to)), tolerances_(t) {}

  long differences() const { return differences_; }
  /// A line for each frame from now on, with the first difference of each stage.
  void print_frames(std::ostream& out) { lines_ = &out; }

  /// Ends the last frame's line; frames and calls so far, and those with differences.
  void summary(std::ostream& out) {
    end_frame();
    out << "verify: " << frames_ << " frames, " << frames_that_differ_ << " with differences\n";
    for (int i = 0; i < stage_count; ++i) {
      tally const& t = tallies_[static_cast<std::size_t>(i)];
      if (t.calls == 0) { continue; }
      out << "verify: " << name_of(static_cast<stage>(i)) << ": " << t.calls << " calls, "
          << t.calls_that_differ << " with differences, " << t.differences << " in all\n";
    }
  }

  /// Image features of a frame: compared as sets first, then in order. @param cpu fills the frame
  /// as Frame::ExtractORB of all images does
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
    compare(frame, "keypoints outside of the overlap", -1, mono, frame.monoLeft);
    compare_features(frame, "left keypoints: same set, other order", left, frame.mvKeys, left_rows,
                     frame.mDescriptors);
    if (sizeof...(images) < 2) { return; }
    compare_features(frame, "right keypoints: same set, other order", right, frame.mvKeysRight,
                     right_rows, frame.mDescriptorsRight);
  }

  /// @param cpu Frame::ComputeStereoMatches or ComputeStereoFishEyeMatches, @param gpu the
  /// accelerator's call of that name
  template <typename Cpu, typename Gpu>
  void stereo(frame_type& frame, Cpu const& cpu, Gpu const& gpu) {
    begin(frame, stage::stereo);
    cpu();
    auto const right_x = frame.mvuRight;
    auto const depth = frame.mvDepth;
    auto const left_to_right = frame.mvLeftToRightMatch;
    auto const right_to_left = frame.mvRightToLeftMatch;
    gpu();
    compare_numbers(frame, "right column", right_x, frame.mvuRight, tolerances_.pixels, 0);
    compare_numbers(frame, "depth", depth, frame.mvDepth, tolerances_.depth, tolerances_.depth);
    compare_numbers(frame, "right partner of left keypoint", left_to_right,
                    frame.mvLeftToRightMatch, 0, 0);
    compare_numbers(frame, "left partner of right keypoint", right_to_left,
                    frame.mvRightToLeftMatch, 0, 0);
  }

  /// @param cpu ORBmatcher::SearchByProjection of the same arguments; returns its matches
  template <typename Cpu>
  int search_by_projection(frame_type& current, frame_type const& last, float th, bool mono,
                           Cpu const& cpu) {
    begin(current, stage::search_last_frame);
    auto const before = current.mvpMapPoints;
    auto const run = [&](auto const& call) {
      int const matches = call();
      return matched{matches, std::exchange(current.mvpMapPoints, before)};
    };
    matched const cpu_first = run(cpu);
    matched gpu = run([&] { return gpu_->search_by_projection(current, last, th, mono); });
    matched const cpu_again = run(cpu);
    current.mvpMapPoints = gpu.points;
    compare_matches(current, cpu_first, cpu_again, gpu);
    return gpu.matches;
  }

  /// @param cpu the frustum test of all points and ORBmatcher::SearchByProjection; returns matches
  template <typename Cpu>
  int search_local_points(frame_type& frame, std::vector<map_point*> const& points, float th,
                          bool far_points, float far_threshold, Cpu const& cpu) {
    begin(frame, stage::search_local_map);
    std::vector<bool> tested;
    for (map_point* const p : points) {
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
    local_state const cpu_first = run(cpu);
    local_state const gpu = run(
        [&] { return gpu_->search_local_points(frame, points, th, far_points, far_threshold); });
    local_state const cpu_again = run(cpu);
    put(gpu);
    count_visible(gpu, 1);
    compare_matches(frame, cpu_first.held, cpu_again.held, gpu.held);
    for (std::size_t i = 0; i < points.size(); ++i) {
      compare_tracked(frame, static_cast<long>(i), cpu_first.seen[i], cpu_again.seen[i],
                      gpu.seen[i]);
    }
    return gpu.held.matches;
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
    auto const cpu_first = run(cpu);
    auto const gpu = run([&] { return gpu_->pose_optimization(frame, which); });
    auto const cpu_again = run(cpu);
    frame.SetPose(gpu.pose);
    frame.mvbOutlier = gpu.outliers;
    compare(frame, "inliers", -1, cpu_first.inliers, cpu_again.inliers, gpu.inliers);
    for (std::size_t i = 0; i < outliers.size(); ++i) {
      if (frame.mvpMapPoints[i] == nullptr) { continue; }
      compare(frame, "outlier", static_cast<long>(i), cpu_first.outliers[i], cpu_again.outliers[i],
              gpu.outliers[i]);
    }
    transform const a = transform_of(cpu_first.pose);
    transform const b = transform_of(cpu_again.pose);
    transform const g = transform_of(gpu.pose);
    for (int i = 0; i < 9; ++i) {
      compare(frame, "rotation entry", i, a.R[i], b.R[i], g.R[i], tolerances_.pose);
    }
    for (int i = 0; i < 3; ++i) {
      compare(frame, "translation entry", i, a.t[i], b.t[i], g.t[i], tolerances_.pose);
    }
    return gpu.inliers;
  }

private:
  /// What the frustum test writes into a map point.
  struct tracked {
    bool in_view, in_view_right;
    int level, level_right;
    float x, y, depth, cosine, right_x, right_y, depth_right, cosine_right;

    explicit tracked(map_point const& p)
        : in_view(p.mbTrackInView),
          in_view_right(p.mbTrackInViewR),
          level(p.mnTrackScaleLevel),
          level_right(p.mnTrackScaleLevelR),
          x(p.mTrackProjX),
          y(p.mTrackProjY),
          depth(p.mTrackDepth),
          cosine(p.mTrackViewCos),
          right_x(p.mTrackProjXR),
          right_y(p.mTrackProjYR),
          depth_right(p.mTrackDepthR),
          cosine_right(p.mTrackViewCosR) {}
    void restore(map_point& p) const {
      p.mbTrackInView = in_view;
      p.mbTrackInViewR = in_view_right;
      p.mnTrackScaleLevel = level;
      p.mnTrackScaleLevelR = level_right;
      p.mTrackProjX = x;
      p.mTrackProjY = y;
      p.mTrackDepth = depth;
      p.mTrackViewCos = cosine;
      p.mTrackProjXR = right_x;
      p.mTrackProjYR = right_y;
      p.mTrackDepthR = depth_right;
      p.mTrackViewCosR = cosine_right;
    }
  };
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
  struct tally {
    long calls = 0;
    long calls_that_differ = 0;
    long differences = 0;
  };

  // ---- frames

  void begin(frame_type const& frame, stage s) {
    if (!in_frame_ || frame.mnId != frame_) {
      end_frame();
      in_frame_ = true;
      frame_ = frame.mnId;
      ++frames_;
      before_frame_ = differences_;
    }
    stage_ = s;
    ++tallies_[static_cast<std::size_t>(s)].calls;
    before_call_ = differences_;
  }
  void end_frame() {
    if (!in_frame_) { return; }
    in_frame_ = false;
    long const n = differences_ - before_frame_;
    frames_that_differ_ += static_cast<long>(n > 0);
    if (lines_ == nullptr) { return; }
    *lines_ << "verify: frame " << frame_ << ": " << n << " differences";
    for (difference const& d : first_) { *lines_ << "; " << d; }
    *lines_ << "\n";
    first_.clear();
  }
  void add(difference const& d) {
    tally& t = tallies_[static_cast<std::size_t>(stage_)];
    if (differences_ == before_call_) {
      ++t.calls_that_differ;
      if (lines_ != nullptr) { first_.push_back(d); }
    }
    ++t.differences;
    ++differences_;
    if (report_) { report_(d); }
  }

  // ---- values

  static bool near(double a, double b, double allowed) {
    return std::abs(a - b) <= allowed || (std::isnan(a) && std::isnan(b));
  }
  /// Reports a value that is further from both than allowed; a NaN equals a NaN.
  template <typename A, typename B>
  void compare(frame_type const& frame, char const* what, long index, A cpu, A cpu_again, B gpu,
               double allowed = 0) {
    auto const a = static_cast<double>(cpu);
    auto const b = static_cast<double>(gpu);
    if (near(a, b, allowed) || near(static_cast<double>(cpu_again), b, allowed)) { return; }
    add({stage_, frame.mnId, what, index, a, b});
  }
  template <typename A, typename B>
  void compare(frame_type const& frame, char const* what, long index, A cpu, B gpu) {
    compare(frame, what, index, cpu, cpu, gpu);
  }
  template <typename T>
  void compare_numbers(frame_type const& frame, char const* what, std::vector<T> const& cpu,
                       std::vector<T> const& gpu, double allowed, double relative) {
    compare(frame, what, -1, cpu.size(), gpu.size());
    for (std::size_t i = 0; i < cpu.size() && i < gpu.size(); ++i) {
      auto const size = static_cast<double>(cpu[i]);
      // A match against none is no matter of rounding.
      double const limit = (cpu[i] < 0) != (gpu[i] < 0) ? 0 : allowed + relative * std::abs(size);
      compare(frame, what, static_cast<long>(i), cpu[i], cpu[i], gpu[i], limit);
    }
  }
  template <typename Keypoint, typename Matrix>
  void compare_features(frame_type const& frame, char const* order,
                        std::vector<Keypoint> const& cpu, std::vector<Keypoint> const& gpu,
                        Matrix const& cpu_rows, Matrix const& gpu_rows) {
    compare(frame, "number of keypoints", -1, cpu.size(), gpu.size());
    keypoint_pairs const pairs = pair_keypoints(cpu, gpu);
    for (std::size_t const i : pairs.first_alone) {
      compare(frame, "keypoint of the CPU alone", static_cast<long>(i), 1, 0);
    }
    for (std::size_t const i : pairs.second_alone) {
      compare(frame, "keypoint of the GPU alone", static_cast<long>(i), 0, 1);
    }
    long moved = 0;
    for (auto const& [i, j] : pairs.common) {
      auto const at = static_cast<long>(i);
      moved += static_cast<long>(i != j);
      compare(frame, "angle of keypoint", at, cpu[i].angle, gpu[j].angle);
      compare(frame, "response of keypoint", at, cpu[i].response, gpu[j].response);
      compare(frame, "descriptor bits of keypoint", at, 0, other_bits(cpu_rows, i, gpu_rows, j));
    }
    bool const same_set = pairs.first_alone.empty() && pairs.second_alone.empty();
    if (same_set && moved > 0) {
      add({stage_, frame.mnId, order, -1, 0, static_cast<double>(moved), true});
    }
  }
  void compare_matches(frame_type const& frame, matched const& cpu, matched const& again,
                       matched const& gpu) {
    auto const id = [](map_point const* p) {
      return p == nullptr ? -1.0 : static_cast<double>(p->mnId);
    };
    compare(frame, "matches", -1, cpu.matches, again.matches, gpu.matches);
    for (std::size_t i = 0; i < cpu.points.size(); ++i) {
      compare(frame, "map point of keypoint", static_cast<long>(i), id(cpu.points[i]),
              id(again.points[i]), id(gpu.points[i]));
    }
  }
  void compare_tracked(frame_type const& frame, long at, tracked const& a, tracked const& b,
                       tracked const& g) {
    double const pixels = tolerances_.pixels;
    bool const two_cameras = frame.Nleft != -1;
    compare(frame, "point in view", at, a.in_view, b.in_view, g.in_view);
    compare(frame, "point in right view", at, a.in_view_right, b.in_view_right, g.in_view_right);
    if (a.in_view && g.in_view) {
      compare(frame, "octave of point", at, a.level, b.level, g.level);
      compare(frame, "x of point", at, a.x, b.x, g.x, pixels);
      compare(frame, "y of point", at, a.y, b.y, g.y, pixels);
      compare(frame, "distance of point", at, a.depth, b.depth, g.depth, tolerances_.depth);
      compare(frame, "cosine of point", at, a.cosine, b.cosine, g.cosine, tolerances_.cosine);
      if (!two_cameras) {
        compare(frame, "right column of point", at, a.right_x, b.right_x, g.right_x, pixels);
      }
    }
    if (a.in_view_right && g.in_view_right) {
      compare(frame, "right octave of point", at, a.level_right, b.level_right, g.level_right);
      compare(frame, "right x of point", at, a.right_x, b.right_x, g.right_x, pixels);
      compare(frame, "right y of point", at, a.right_y, b.right_y, g.right_y, pixels);
      compare(frame, "right distance of point", at, a.depth_right, b.depth_right, g.depth_right,
              tolerances_.depth);
      compare(frame, "right cosine of point", at, a.cosine_right, b.cosine_right, g.cosine_right,
              tolerances_.cosine);
    }
  }

  accelerator<Types>* gpu_;
  report report_;
  tolerances tolerances_;
  std::ostream* lines_ = nullptr;
  std::array<tally, stage_count> tallies_{};
  std::vector<difference> first_;  ///< of this frame's calls
  stage stage_ = stage::extract;
  unsigned long frame_ = 0;
  bool in_frame_ = false;
  long frames_ = 0;
  long frames_that_differ_ = 0;
  long differences_ = 0;
  long before_frame_ = 0;
  long before_call_ = 0;
};

}  // namespace orbslam3
}  // namespace ft
