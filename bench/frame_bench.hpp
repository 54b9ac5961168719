// SPDX-License-Identifier: Apache-2.0
/// @file A stereo frame against a map of known size, over rotating images, on either executor.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <random>
#include <string>
#include <vector>

#include "bench/scene.hpp"
#include "ft/pipelines/frame_tracker.hpp"

namespace bench {

inline ft::pose pose_of(plain_pose const& p) {
  ft::pose T;
  for (int i = 0; i < 9; ++i) { T.R.m[i] = p.R[i]; }
  T.t = {p.t[0], p.t[1], p.t[2]};
  return T;
}

inline double now_us() {
  return std::chrono::duration<double, std::micro>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

/// Batch of cameras that see the scene's frames, each camera a frame further on than the one before
/// it.
template <typename Exec>
class frame_bench {
public:
  frame_bench(Exec const& exec, scene const& s, int batch, bool optimize)
      : exec_(exec),
        scene_(s),
        batch_(batch),
        tracker_(exec, ft::rectified_rig::make({s.fx, s.fy, s.cx, s.cy}, s.baseline),
                 params_of(s, optimize), batch) {
    build_map();
  }

  /// Tracks `frames` frames and returns what each took, microseconds, images staged to result read.
  /// @param split with the host between the two halves, as where it chooses the local map
  std::vector<double> run(int warm_up, int frames, bool split) {
    std::vector<double> times;
    for (int i = 0; i < warm_up + frames; ++i) {
      prepare(i);
      double const start = now_us();
      if (split) {
        tracker_.track_motion(exec_);
        exec_.wait();
        tracker_.track_local(exec_);
      } else {
        tracker_.track(exec_);
      }
      exec_.wait();
      if (i >= warm_up) { times.push_back(now_us() - start); }
      remember();
    }
    return times;
  }

  ft::frame_tracker<Exec>& tracker() { return tracker_; }
  int mean_inliers() const { return inliers_ / std::max(1, tracked_); }
  void prepare(int i) {
    for (int b = 0; b < batch_; ++b) {
      int const k = frame_of(i, b);
      auto const& f = scene_.frames[static_cast<std::size_t>(k)];
      int const w = scene_.width;
      tracker_.set_image(b, 0, {f.left.data(), w, scene_.height, w});
      tracker_.set_image(b, 1, {f.right.data(), w, scene_.height, w});
      // The prediction is off by a little, as a motion model's is.
      ft::pose T = pose_of(f.T_cw);
      T.t.x += 0.01f;
      T.t.z -= 0.01f;
      tracker_.predicted()[b] = T;
      tracker_.last_pose()[b] =
          pose_of(scene_.frames[static_cast<std::size_t>(frame_of(i - 1, b))].T_cw);
      tracker_.stamp()[b] = ++stamp_;
    }
    std::copy(holder_.begin(), holder_.end(), tracker_.last_holder());
  }
  void remember() {
    auto const& r = tracker_.result();
    std::copy(r.holder, r.holder + holder_.size(), holder_.begin());
    inliers_ += r.inliers[0];
    ++tracked_;
  }

private:
  static ft::tracker_params params_of(scene const& s, bool optimize) {
    ft::tracker_params p;
    p.orb.width = s.width;
    p.orb.height = s.height;
    p.orb.features = s.features;
    p.local_points = 4096;
    p.map_slots = 8192;
    p.optimize_last = p.optimize_local = optimize;
    return p;
  }
  /// Back and forth over the scene, so that consecutive frames are neighbours.
  int frame_of(int i, int b) const {
    int const n = static_cast<int>(scene_.frames.size());
    int const period = 2 * n - 2;
    int const k = ((i + b) % period + period) % period;
    return k < n ? k : period - k;
  }

  /// Points seen with depth in all of the scene's frames, up to the wanted number, shared out
  /// evenly.
  void build_map() {
    holder_.assign(static_cast<std::size_t>(batch_) * static_cast<std::size_t>(tracker_.capacity()),
                   -1);
    std::vector<ft::point_update> points;
    std::vector<ft::descriptor> orb(static_cast<std::size_t>(tracker_.capacity()));
    auto const n = static_cast<int>(scene_.frames.size());
    for (int k = 0; k < n; ++k) {
      auto const& f = scene_.frames[static_cast<std::size_t>(k)];
      int const w = scene_.width;
      for (int b = 0; b < batch_; ++b) {
        tracker_.set_image(b, 0, {f.left.data(), w, scene_.height, w});
        tracker_.set_image(b, 1, {f.right.data(), w, scene_.height, w});
      }
      tracker_.extract(exec_);
      exec_.wait();
      auto const& r = tracker_.result();
      tracker_.download_descriptors(exec_, 0, orb.data(), r.keypoints[0]);
      exec_.wait();
      ft::pose const T_wc = pose_of(f.T_cw).inverse();
      int const share = scene_.local_points / n + (k < scene_.local_points % n ? 1 : 0);
      int taken = 0;
      for (int i = 0; i < r.keypoints[0] && taken < share; ++i) {
        if (!(r.depth[i] > 0)) { continue; }
        ++taken;
        ft::vec3<float> const P = T_wc * r.point[i];
        ft::vec3<float> const view = P - T_wc.t;
        float const distance = std::sqrt(ft::dot(view, view));
        ft::point_update u;
        u.slot = static_cast<int>(points.size());
        u.observations = 3;
        u.position = P;
        u.normal = {view.x / distance, view.y / distance, view.z / distance};
        u.max_distance = distance * tracker_.geometry().scale[r.octave[i]];
        u.min_distance = u.max_distance / tracker_.geometry().scale[tracker_.geometry().levels - 1];
        u.orb = orb[static_cast<std::size_t>(i)];
        points.push_back(u);
      }
    }
    for (int b = 0; b < batch_; ++b) {
      tracker_.update_map(exec_, b, points.data(), static_cast<int>(points.size()));
      exec_.wait();
      tracker_.local_count()[b] = static_cast<int>(points.size());
      for (int i = 0; i < static_cast<int>(points.size()); ++i) {
        tracker_.local_slots()[b * tracker_.params().local_points + i] = i;
      }
    }
    map_points_ = static_cast<int>(points.size());
  }

  Exec exec_;
  scene const& scene_;
  int batch_;
  ft::frame_tracker<Exec> tracker_;
  std::vector<int> holder_;
  int stamp_ = 0;
  int inliers_ = 0;
  int tracked_ = 0;

public:
  int map_points_ = 0;
};

}  // namespace bench
