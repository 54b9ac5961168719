// SPDX-License-Identifier: Apache-2.0
/// @file The odometry runner, instantiated once per executor, for a rectified pair and for two.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "bench/frame_runner.hpp"
#include "bench/owned_executor.hpp"
#include "bench/runner.hpp"
#include "bench/scene_images.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/pipelines/odometry.hpp"

namespace bench {
inline namespace FT_ABI {

using four_camera_rig = ft::multi_rig<2>;

/// Two pairs. The body's frame is that of the first camera.
inline four_camera_rig four_cameras_of(scene const& s) {
  auto const pair = rig_of<ft::rectified_rig>(s);
  return {{{pair.camera, pair.baseline, ft::pose::identity()},
           {pair.camera, pair.baseline, pose_of(s.T_al)}}};
}

inline ft::odometry_params odometry_params_of(scene const& s, frame_options const& how) {
  ft::odometry_params p;
  p.orb.width = s.width;
  p.orb.height = s.height;
  p.orb.features = s.features;
  p.use_graphs = how.use_graphs;
  p.measure_stages = how.measure_stages;
  p.prefetch = how.prefetch;
  if (how.imu) {
    scene_imu const& imu = s.imu;
    p.imu.present = true;
    for (std::size_t i = 0; i < 9; ++i) { p.imu.T_bc.R.m[i] = double{imu.T_imu_left.R[i]}; }
    p.imu.T_bc.t = {double{imu.T_imu_left.t[0]}, double{imu.T_imu_left.t[1]},
                    double{imu.T_imu_left.t[2]}};
    p.imu.noise = {imu.gyro_noise, imu.accel_noise, imu.gyro_walk, imu.accel_walk, imu.rate_hz};
  }
  return p;
}

template <typename Exec, typename Rig>
class odometry_runner_of final : public odometry_runner {
public:
  odometry_runner_of(scene const& s, Rig const& rig, frame_options const& how)
      : batch_(how.batch),
        owned_(how.host_threads),
        scene_(s, Rig::images),
        odometry_(made(owned_.exec, rig, odometry_params_of(s, how), how.batch)),
        images_(static_cast<std::size_t>(how.batch)),
        times_(images_.size()) {
    if (how.imu) { samples_ = s.imu.samples; }
  }

  void prepare(int i) override {
    frame_ = i;
    times_.assign(times_.size(), static_cast<std::int64_t>(i + 1) * scene::period_ns);
    if (odometry_.params().prefetch == 0) { take_images(i); }
    for (; next_ < samples_.size(); ++next_) {
      scene_imu_sample const& from = samples_[next_];
      std::int64_t const at = from.time_ns + scene::period_ns;
      if (at > times_[0]) { break; }
      auto const vector = [](float const(&v)[3]) { return ft::vec3<float>{v[0], v[1], v[2]}; };
      for (int b = 0; b < batch_; ++b) {
        odometry_.add_imu({at, vector(from.accel), vector(from.gyro)}, b);
      }
    }
  }
  void track() override {
    ft::tracking const* const t = odometry_.params().prefetch > 0
                                      ? track_prefetched()
                                      : odometry_.track(images_.data(), times_.data());
    last_ = {};
    for (int b = 0; b < batch_; ++b) {
      last_.tracked += t[b].state == ft::tracking_state::tracking ? 1 : 0;
      last_.keyframes += t[b].keyframe ? 1 : 0;
      last_.by_imu += t[b].imu.optimized ? 1 : 0;
    }
    last_.inliers = t[0].inliers;
    last_.map_points = t[0].map_points;
    last_.maps = t[0].maps;
    last_.local_points = t[0].local_points;
  }
  odometry_counts last() const override { return last_; }
  std::vector<stage_us> stage_times() const override {
    std::vector<stage_us> all;
    for (auto const& t : odometry_.stage_times()) { all.push_back({t.name, t.us}); }
    return all;
  }
  double memory_bytes() const override {
    return static_cast<double>(odometry_.memory_bytes().executor);
  }

private:
  ft::tracking const* track_prefetched() {
    for (; given_ < frame_ + odometry_.params().prefetch; ++given_) {
      take_images(given_);
      odometry_.prefetch(images_.data());
    }
    return odometry_.track_prefetched(times_.data());
  }
  static ft::odometry<Exec, Rig> made(Exec const& exec, Rig const& rig,
                                      ft::odometry_params const& p, int batch) {
    using odometry = ft::odometry<Exec, Rig>;
    return p.imu.present ? odometry(exec, rig, p, batch, ft::inertial{})
                         : odometry(exec, rig, p, batch);
  }
  void take_images(int i) {
    for (int b = 0; b < batch_; ++b) {
      auto const k = static_cast<std::size_t>(b);
      int const f = scene_.frame_of(i, b);
      if constexpr (Rig::images == 2) {
        images_[k] = {scene_.view(f, 0), scene_.view(f, 1)};
      } else {
        images_[k] = {scene_.view(f, 0), scene_.view(f, 1), scene_.view(f, 2), scene_.view(f, 3)};
      }
    }
  }

  int batch_;
  owned_executor<Exec> owned_;
  scene_images<Exec> scene_;
  ft::odometry<Exec, Rig> odometry_;
  std::vector<typename ft::odometry<Exec, Rig>::images_type> images_;
  std::vector<std::int64_t> times_;
  std::vector<scene_imu_sample> samples_;
  std::size_t next_ = 0;  ///< sample to hand over
  int frame_ = 0;         ///< that is tracked next
  int given_ = 0;         ///< frames given early
  odometry_counts last_;
};

template <typename Exec>
std::unique_ptr<odometry_runner> make_odometry_runner_of(scene const& s, frame_options const& how) {
  return made_in_memory([&]() -> std::unique_ptr<odometry_runner> {
    if (s.rig == rig_type::four_cameras) {
      return std::make_unique<odometry_runner_of<Exec, four_camera_rig>>(s, four_cameras_of(s),
                                                                         how);
    }
    auto const rig = rig_of<ft::rectified_rig>(s);
    return std::make_unique<odometry_runner_of<Exec, ft::rectified_rig>>(s, rig, how);
  });
}

}  // namespace FT_ABI

std::unique_ptr<odometry_runner> make_host_odometry(scene const& s, frame_options const& how);
std::unique_ptr<odometry_runner> make_cuda_odometry(scene const& s, frame_options const& how);

}  // namespace bench
