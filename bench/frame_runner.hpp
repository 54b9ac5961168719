// SPDX-License-Identifier: Apache-2.0
/// @file The frame runner, instantiated once per executor and rig.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "bench/graph_facts.hpp"
#include "bench/owned_executor.hpp"
#include "bench/runner.hpp"
#include "bench/scene_images.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/pipelines/frame_tracker.hpp"

namespace bench {
inline namespace FT_ABI {

using fisheye_rig = ft::stereo_rig<ft::kannala_brandt<float>, ft::kannala_brandt<float>>;

inline ft::pose pose_of(plain_pose const& p) {
  ft::pose T;
  for (int i = 0; i < 9; ++i) { T.R.m[i] = p.R[i]; }
  T.t = {p.t[0], p.t[1], p.t[2]};
  return T;
}

template <typename Rig>
Rig rig_of(scene const& s) {
  auto const& l = s.left;
  if constexpr (Rig::rectified) {
    return Rig::make({l.fx, l.fy, l.cx, l.cy}, s.baseline);
  } else {
    auto const& r = s.right;
    return {{l.fx, l.fy, l.cx, l.cy, l.k[0], l.k[1], l.k[2], l.k[3]},
            {r.fx, r.fy, r.cx, r.cy, r.k[0], r.k[1], r.k[2], r.k[3]},
            pose_of(s.T_rl)};
  }
}

template <typename Exec, typename Rig>
class frame_runner_of final : public frame_runner {
public:
  frame_runner_of(scene const& s, frame_options const& how)
      : scene_(s),
        batch_(how.batch),
        owned_(how.host_threads),
        tracker_(exec(), rig_of<Rig>(s), params_of(s, how), how.batch),
        inputs_(static_cast<std::size_t>(how.batch)),
        images_(s, 2) {
    build_map();
    begin_walk();
  }
  ~frame_runner_of() override {
    try {
      exec().wait();  // the tracker's memory may be in use
    } catch (...) {}
  }

  void prepare(int i) override {
    for (int b = 0; b < batch_; ++b) {
      set_images(b, images_.frame_of(i, b));
      // The prediction has a small error, like that of a motion model.
      ft::pose T = pose_of(frame(images_.frame_of(i, b)).T_cw);
      T.t.x += 0.01f;
      T.t.z -= 0.01f;
      inputs_[static_cast<std::size_t>(b)] = {T, slots_};
    }
  }

  void borrow_images(bool borrow) override { borrow_ = borrow; }

  void launch(call_type how) override {
    switch (how) {
      case call_type::whole:
        tracker_.track(exec(), inputs_.data());
        break;
      case call_type::two_halves:
        track_motion();
        exec().wait();
        track_local();
        break;
    }
  }
  bool done() override { return owned_.done(); }
  void wait() override { exec().wait(); }

  void update_map(int count) override {
    tracker_.update_map(exec(), 0, points_.data(), std::min(count, map_points()));
  }
  void update_positions(int count) override {
    auto const n = static_cast<std::size_t>(std::min(count, map_points()));
    if (positions_.size() == 0) { positions_ = staged<ft::vec3<float>>(points_.size()); }
    for (std::size_t i = 0; i < n; ++i) { positions_.data()[i] = points_[i].position; }
    // Slots are the numbers of the points, so the positions are contiguous.
    ft::copy(exec(), ft::array_of<ft::field::position>(tracker_.map()),
             static_cast<ft::vec3<float> const*>(positions_.data()), n);
  }
  int map_points() const override { return static_cast<int>(points_.size()); }

  frame_counts counts() override {
    frame_counts c;
    c.map_points = map_points();
    auto const frames = static_cast<int>(scene_.frames.size());
    for (int i = 0; i < frames; ++i) {
      prepare(i);
      auto const& r = tracker_.result();
      track_motion();
      wait();
      c.last_matches += r.matches[0];
      c.last_inliers += r.inliers[0];
      track_local();
      wait();
      c.keypoints += r.keypoints[0];
      c.local_matches += r.matches[0];
      c.inliers += r.inliers[0];
      for (int k = 0; k < r.keypoints[0]; ++k) { c.stereo_matches += r.depth[k] > 0 ? 1 : 0; }
      ft::vec3<float> const off =
          r.T_cw[0].centre() - pose_of(frame(images_.frame_of(i, 0)).T_cw).centre();
      c.position_error += static_cast<double>(std::sqrt(ft::dot(off, off)));
    }
    for (double* v : {&c.keypoints, &c.stereo_matches, &c.last_matches, &c.last_inliers,
                      &c.local_matches, &c.inliers, &c.position_error}) {
      *v /= frames;
    }
    return c;
  }

  std::vector<stage_us> stage_times(int i) override {
    prepare(i);
    launch(call_type::whole);
    wait();
    std::vector<stage_us> times;
    for (auto const& s : tracker_.stage_times()) { times.push_back({s.name, s.us}); }
    return times;
  }

  graph_counts graph() override {
    graph_counts c;
#if defined(__CUDACC__)
    if constexpr (Exec::asynchronous) {
      c = capture().counts();
      auto const& r = tracker_.result();
      auto const b = static_cast<std::size_t>(batch_);
      auto const n = b * static_cast<std::size_t>(r.capacity);
      c.bytes_up += tracker_.input_bytes();
      c.result_bytes =
          b * (sizeof(int) * static_cast<std::size_t>(r.cameras) + sizeof(ft::pose) +
               2 * sizeof(int) + static_cast<std::size_t>(r.local_points)) +
          n * static_cast<std::size_t>(r.cameras) * (2 * sizeof(float) + 3 * sizeof(int)) +
          n * (sizeof(float) + sizeof(ft::vec3<float>));
    }
#endif
    return c;
  }
  std::vector<kernel_facts> kernels() override {
#if defined(__CUDACC__)
    if constexpr (Exec::asynchronous) { return capture().kernels(); }
#endif
    return {};
  }

private:
  template <typename T>
  using staged = ft::buffer<T, ft::staging_space<Exec>>;

  Exec const& exec() const { return owned_.exec; }
  scene_frame const& frame(int k) const { return scene_.frames[static_cast<std::size_t>(k)]; }

#if defined(__CUDACC__)
  captured capture() {
    wait();
    return captured([this](ft::cuda_exec const& e) { tracker_.track(e, inputs_.data()); });
  }
#endif

  void track_motion() {
    std::vector<ft::pose> T;
    for (auto const& in : inputs_) { T.push_back(in.T_predicted); }
    tracker_.track_motion(exec(), T.data());
  }
  void track_local() {
    std::vector<ft::slot_list> const slots(inputs_.size(), slots_);
    tracker_.track_local(exec(), slots.data());
  }
  /// State before the first frame: the cameras have the pose of the preceding frame, and no map
  /// point is held.
  void begin_walk() {
    std::vector<int> const none(
        static_cast<std::size_t>(decltype(tracker_)::cameras * tracker_.capacity()), -1);
    for (int b = 0; b < batch_; ++b) {
      tracker_.set_last(exec(), b, pose_of(frame(images_.frame_of(-1, b)).T_cw), none);
    }
    wait();
  }

  static ft::tracker_params params_of(scene const& s, frame_options const& how) {
    ft::tracker_params p;
    p.orb.width = s.width;
    p.orb.height = s.height;
    p.orb.features = s.features;
    p.orb.ties = how.std_sort_ties ? ft::tie_rule::std_sort : ft::tie_rule::stable;
    p.local_points = 4096;
    p.map_slots = 8192;
    p.updates = 4096;
    p.optimize_last = how.optimize_last;
    p.optimize_local = how.optimize_local;
    p.use_graphs = how.use_graphs;
    p.measure_stages = how.measure_stages;
    return p;
  }

  void set_images(int b, int k) {
    for (int c = 0; c < 2; ++c) {
      if (borrow_) {
        tracker_.borrow_image(b, c, images_.view(k, c));
      } else {
        auto const& pixels = c == 0 ? frame(k).left : frame(k).right;
        tracker_.set_image(b, c, {pixels.data(), scene_.width, scene_.height, scene_.width});
      }
    }
  }

  /// Points seen with depth in all of the scene's frames, up to the wanted number. Each frame gives
  /// its share; frames with more points make up for those with fewer.
  void build_map() {
    std::vector<ft::descriptor> orb(static_cast<std::size_t>(tracker_.capacity()));
    auto const n = static_cast<int>(scene_.frames.size());
    std::vector<std::vector<ft::point_update>> seen(scene_.frames.size());
    for (int k = 0; k < n; ++k) {
      for (int b = 0; b < batch_ && (b == 0 || k == 0); ++b) { set_images(b, k); }
      tracker_.extract(exec());
      wait();
      auto const& r = tracker_.result();
      tracker_.download_descriptors(exec(), 0, orb.data(), r.keypoints[0]);
      wait();
      ft::pose const T_wc = pose_of(frame(k).T_cw).inverse();
      for (int i = 0; i < r.keypoints[0]; ++i) {
        if (!(r.depth[i] > 0)) { continue; }
        ft::vec3<float> const P = T_wc * r.point[i];
        ft::vec3<float> const view = P - T_wc.t;
        float const distance = std::sqrt(ft::dot(view, view));
        auto const& g = tracker_.geometry();
        ft::point_update u;
        u.slot = -1;
        u.observations = 3;
        u.position = P;
        u.normal = {view.x / distance, view.y / distance, view.z / distance};
        u.max_distance = distance * g.scale[r.octave[i]];
        u.min_distance = u.max_distance / g.scale[g.levels - 1];
        u.orb = orb[static_cast<std::size_t>(i)];
        seen[static_cast<std::size_t>(k)].push_back(u);
      }
    }
    std::vector<std::size_t> order(seen.size());
    for (std::size_t k = 0; k < order.size(); ++k) { order[k] = k; }
    std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
      return seen[a].size() != seen[b].size() ? seen[a].size() < seen[b].size() : a < b;
    });
    std::vector<std::size_t> take(seen.size());
    auto left = static_cast<std::size_t>(scene_.local_points);
    for (std::size_t k = 0; k < order.size(); ++k) {
      take[order[k]] = std::min(seen[order[k]].size(), left / (order.size() - k));
      left -= take[order[k]];
    }
    for (std::size_t k = 0; k < seen.size(); ++k) {
      for (std::size_t i = 0; i < take[k]; ++i) {
        points_.push_back(seen[k][i]);
        points_.back().slot = map_points() - 1;
      }
    }
    for (int b = 0; b < batch_; ++b) {
      tracker_.update_map(exec(), b, points_.data(), map_points());
      wait();
    }
    slots_.resize(points_.size());
    for (int i = 0; i < map_points(); ++i) { slots_[static_cast<std::size_t>(i)] = i; }
  }

  scene const& scene_;
  int batch_;
  bool borrow_ = true;
  owned_executor<Exec> owned_;
  ft::frame_tracker<Exec, Rig> tracker_;
  std::vector<ft::frame_input> inputs_;
  scene_images<Exec> images_;
  std::vector<int> slots_;  ///< of the map, in order
  std::vector<ft::point_update> points_;
  staged<ft::vec3<float>> positions_;
};

template <typename Exec, typename Rig>
std::unique_ptr<frame_runner> make_runner_of(scene const& s, frame_options const& how) {
  return made_in_memory([&] { return std::make_unique<frame_runner_of<Exec, Rig>>(s, how); });
}

}  // namespace FT_ABI

// One function per unit, for its instantiations: see *_rectified.* and *_fisheye.*.
std::unique_ptr<frame_runner> make_host_rectified(scene const& s, frame_options const& how);
std::unique_ptr<frame_runner> make_host_fisheye(scene const& s, frame_options const& how);
std::unique_ptr<frame_runner> make_cuda_rectified(scene const& s, frame_options const& how);
std::unique_ptr<frame_runner> make_cuda_fisheye(scene const& s, frame_options const& how);

}  // namespace bench
