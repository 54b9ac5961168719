// SPDX-License-Identifier: Apache-2.0
/// @file CPU and GPU side by side on each frame, and every difference between them.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstring>
#include <functional>
#include <ostream>
#include <type_traits>
#include <utility>
#include <vector>

#include "integration/orbslam3/accelerator.hpp"

namespace ft {
namespace orbslam3 {

/// One value that differs.
struct difference {
  stage where;
  unsigned long frame;  ///< Frame::mnId
  char const* what;     ///< such as "map point", "octave"
  long index;           ///< of the keypoint or the local map's point; -1 = of the frame
  double cpu;           ///< map points by mnId, -1 = none
  double gpu;
};

inline std::ostream& operator<<(std::ostream& out, difference const& d) {
  out << "frame " << d.frame << ", " << name_of(d.where) << ": " << d.what;
  if (d.index >= 0) { out << " " << d.index; }
  return out << ": CPU " << d.cpu << ", GPU " << d.gpu;
}

/// Differences that are none: the two round differently.
struct tolerances {
  double pixels = 4e-3;  ///< of projections and right columns
  double depth = 1e-3;   ///< metres, and relative to a depth
  double pose = 1e-4;    ///< of each entry
};

/// Makes each call twice: by the CPU's own code, then, from the same state, by the accelerator,
/// whose answer stays. For finding faults, not for speed. Map points that another thread changes
/// between the two calls show as differences; ORB-SLAM3 holds the map's update lock in Track(),
/// which keeps their positions.
template <typename Types>
class verifier {
public:
  using frame_type = typename Types::frame;
  using map_point = typename Types::map_point;
  using report = std::function<void(difference const&)>;

  /// @param to called with every difference
  verifier(accelerator<Types>& gpu, report to, tolerances const& t = {})
      : gpu_(&gpu), report_(std::move(to)), tolerances_(t) {}

  long differences() const { return differences_; }

  /// Image features of a frame. @param cpu fills the frame as Frame::ExtractORB of all images does
  template <typename Cpu, typename... Images>
  void extract(frame_type& frame, Cpu const& cpu, Images const&... images) {
    cpu();
    auto const left = frame.mvKeys;
    auto const right = frame.mvKeysRight;
    auto const left_rows = frame.mDescriptors.clone();
    auto const right_rows = frame.mDescriptorsRight.clone();
    gpu_->extract(images..., frame);
    compare_keypoints(frame, "left", left, frame.mvKeys);
    compare_rows(frame, "left descriptor", left_rows, frame.mDescriptors);
    if (sizeof...(images) < 2) { return; }
    compare_keypoints(frame, "right", right, frame.mvKeysRight);
    compare_rows(frame, "right descriptor", right_rows, frame.mDescriptorsRight);
  }

  /// @param cpu Frame::ComputeStereoMatches or ComputeStereoFishEyeMatches, @param gpu the
  /// accelerator's call of that name
  template <typename Cpu, typename Gpu>
  void stereo(frame_type& frame, Cpu const& cpu, Gpu const& gpu) {
    cpu();
    auto const right_x = frame.mvuRight;
    auto const depth = frame.mvDepth;
    auto const left_to_right = frame.mvLeftToRightMatch;
    auto const right_to_left = frame.mvRightToLeftMatch;
    gpu();
    compare_numbers(frame, stage::stereo, "right column", right_x, frame.mvuRight,
                    tolerances_.pixels, 0);
    compare_numbers(frame, stage::stereo, "depth", depth, frame.mvDepth, tolerances_.depth,
                    tolerances_.depth);
    compare_numbers(frame, stage::stereo, "right partner of left keypoint", left_to_right,
                    frame.mvLeftToRightMatch, 0, 0);
    compare_numbers(frame, stage::stereo, "left partner of right keypoint", right_to_left,
                    frame.mvRightToLeftMatch, 0, 0);
  }

  /// @param cpu ORBmatcher::SearchByProjection of the same arguments; returns its matches
  template <typename Cpu>
  int search_by_projection(frame_type& current, frame_type const& last, float th, bool mono,
                           Cpu const& cpu) {
    auto const before = current.mvpMapPoints;
    int const cpu_matches = cpu();
    auto const wanted = std::exchange(current.mvpMapPoints, before);
    int const matches = gpu_->search_by_projection(current, last, th, mono);
    compare(current, stage::search_last_frame, "matches", -1, cpu_matches, matches);
    compare_points(current, stage::search_last_frame, wanted);
    return matches;
  }

  /// @param cpu the frustum test of all points and ORBmatcher::SearchByProjection; returns matches
  template <typename Cpu>
  int search_local_points(frame_type& frame, std::vector<map_point*> const& points, float th,
                          bool far_points, float far_threshold, Cpu const& cpu) {
    std::vector<tracked> const values = tracked_of(points);
    auto const held = frame.mvpMapPoints;
    auto const drawn = frame.mmProjectPoints;
    int const cpu_matches = cpu();
    std::vector<tracked> const wanted = tracked_of(points);
    auto const wanted_points = std::exchange(frame.mvpMapPoints, held);
    frame.mmProjectPoints = drawn;
    for (std::size_t i = 0; i < points.size(); ++i) {
      bool const tested = points[i]->mnLastFrameSeen != frame.mnId && !points[i]->isBad();
      if (tested && (wanted[i].in_view || wanted[i].in_view_right)) {
        points[i]->IncreaseVisible(-1);
      }
      values[i].restore(*points[i]);
    }
    int const matches = gpu_->search_local_points(frame, points, th, far_points, far_threshold);
    compare(frame, stage::search_local_map, "matches", -1, cpu_matches, matches);
    compare_points(frame, stage::search_local_map, wanted_points);
    compare_tracked(frame, wanted, tracked_of(points));
    return matches;
  }

  /// @param cpu Optimizer::PoseOptimization; returns its inliers
  template <typename Cpu>
  int pose_optimization(frame_type& frame, stage which, Cpu const& cpu) {
    auto const start = frame.GetPose();
    auto const outliers = frame.mvbOutlier;
    int const cpu_inliers = cpu();
    auto const wanted = std::exchange(frame.mvbOutlier, outliers);
    transform const wanted_pose = transform_of(frame.GetPose());
    frame.SetPose(start);
    int const inliers = gpu_->pose_optimization(frame, which);
    compare(frame, which, "inliers", -1, cpu_inliers, inliers);
    for (std::size_t i = 0; i < wanted.size(); ++i) {
      if (frame.mvpMapPoints[i] == nullptr) { continue; }
      compare(frame, which, "outlier", static_cast<long>(i), wanted[i], frame.mvbOutlier[i]);
    }
    transform const pose = transform_of(frame.GetPose());
    for (int i = 0; i < 9; ++i) {
      compare(frame, which, "rotation entry", i, wanted_pose.R[i], pose.R[i], tolerances_.pose);
    }
    for (int i = 0; i < 3; ++i) {
      compare(frame, which, "translation entry", i, wanted_pose.t[i], pose.t[i], tolerances_.pose);
    }
    return inliers;
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

  /// Reports two values that are further apart than allowed; a NaN equals a NaN.
  template <typename A, typename B>
  void compare(frame_type const& frame, stage where, char const* what, long index, A cpu, B gpu,
               double allowed = 0) {
    auto const a = static_cast<double>(cpu);
    auto const b = static_cast<double>(gpu);
    if (std::abs(a - b) <= allowed || (std::isnan(a) && std::isnan(b))) { return; }
    ++differences_;
    if (report_) { report_({where, frame.mnId, what, index, a, b}); }
  }
  template <typename T>
  void compare_numbers(frame_type const& frame, stage where, char const* what,
                       std::vector<T> const& cpu, std::vector<T> const& gpu, double allowed,
                       double relative) {
    compare(frame, where, what, -1, cpu.size(), gpu.size());
    for (std::size_t i = 0; i < cpu.size() && i < gpu.size(); ++i) {
      auto const size = static_cast<double>(cpu[i]);
      // A match against none is no matter of rounding.
      double const limit = (cpu[i] < 0) != (gpu[i] < 0) ? 0 : allowed + relative * std::abs(size);
      compare(frame, where, what, static_cast<long>(i), cpu[i], gpu[i], limit);
    }
  }
  template <typename Keypoint>
  void compare_keypoints(frame_type const& frame, char const* what,
                         std::vector<Keypoint> const& cpu, std::vector<Keypoint> const& gpu) {
    compare(frame, stage::extract, what, -1, cpu.size(), gpu.size());
    for (std::size_t i = 0; i < cpu.size() && i < gpu.size(); ++i) {
      auto const at = static_cast<long>(i);
      compare(frame, stage::extract, "x of keypoint", at, cpu[i].pt.x, gpu[i].pt.x);
      compare(frame, stage::extract, "y of keypoint", at, cpu[i].pt.y, gpu[i].pt.y);
      compare(frame, stage::extract, "octave of keypoint", at, cpu[i].octave, gpu[i].octave);
      compare(frame, stage::extract, "angle of keypoint", at, cpu[i].angle, gpu[i].angle);
      compare(frame, stage::extract, "response of keypoint", at, cpu[i].response, gpu[i].response);
    }
  }
  template <typename Matrix>
  void compare_rows(frame_type const& frame, char const* what, Matrix const& cpu,
                    Matrix const& gpu) {
    for (int i = 0; i < cpu.rows && i < gpu.rows; ++i) {
      auto const row = static_cast<std::size_t>(i);
      unsigned char const* const a = cpu.data + row * static_cast<std::size_t>(cpu.step);
      unsigned char const* const b = gpu.data + row * static_cast<std::size_t>(gpu.step);
      for (int byte = 0; byte < 32; ++byte) {
        if (a[byte] == b[byte]) { continue; }
        compare(frame, stage::extract, what, i, a[byte], b[byte]);
        break;
      }
    }
  }
  void compare_points(frame_type const& frame, stage where, std::vector<map_point*> const& wanted) {
    auto const id = [](map_point const* p) {
      return p == nullptr ? -1.0 : static_cast<double>(p->mnId);
    };
    for (std::size_t i = 0; i < wanted.size(); ++i) {
      compare(frame, where, "map point of keypoint", static_cast<long>(i), id(wanted[i]),
              id(frame.mvpMapPoints[i]));
    }
  }
  void compare_tracked(frame_type const& frame, std::vector<tracked> const& cpu,
                       std::vector<tracked> const& gpu) {
    stage const s = stage::search_local_map;
    for (std::size_t i = 0; i < cpu.size(); ++i) {
      auto const at = static_cast<long>(i);
      compare(frame, s, "point in view", at, cpu[i].in_view, gpu[i].in_view);
      compare(frame, s, "point in right view", at, cpu[i].in_view_right, gpu[i].in_view_right);
      if (cpu[i].in_view && gpu[i].in_view) {
        compare(frame, s, "octave of point", at, cpu[i].level, gpu[i].level);
        compare(frame, s, "x of point", at, cpu[i].x, gpu[i].x, tolerances_.pixels);
        compare(frame, s, "y of point", at, cpu[i].y, gpu[i].y, tolerances_.pixels);
        compare(frame, s, "distance of point", at, cpu[i].depth, gpu[i].depth, tolerances_.depth);
      }
      if (cpu[i].in_view_right && gpu[i].in_view_right) {
        compare(frame, s, "right octave of point", at, cpu[i].level_right, gpu[i].level_right);
        compare(frame, s, "right x of point", at, cpu[i].right_x, gpu[i].right_x,
                tolerances_.pixels);
        compare(frame, s, "right y of point", at, cpu[i].right_y, gpu[i].right_y,
                tolerances_.pixels);
      }
    }
  }

  accelerator<Types>* gpu_;
  report report_;
  tolerances tolerances_;
  long differences_ = 0;
};

}  // namespace orbslam3
}  // namespace ft
