// SPDX-License-Identifier: Apache-2.0
/// @file The odometry runner, instantiated once per executor, for a rectified pair and for two.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "bench/frame_runner.hpp"
#include "bench/owned_executor.hpp"
#include "bench/runner.hpp"
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

template <typename Exec, typename Rig>
class odometry_runner_of final : public odometry_runner {
public:
  odometry_runner_of(scene const& s, Rig const& rig, frame_options const& how)
      : scene_(s),
        batch_(how.batch),
        owned_(how.host_threads),
        odometry_(owned_.exec, rig, params_of(s, how), how.batch),
        images_(static_cast<std::size_t>(how.batch)),
        times_(images_.size()) {
    lay_out_images();
  }

  void prepare(int i) override {
    for (int b = 0; b < batch_; ++b) {
      auto const k = static_cast<std::size_t>(b);
      int const first = Rig::images * frame_of(i, b);
      if constexpr (Rig::images == 2) {
        images_[k] = {view(first), view(first + 1)};
      } else {
        images_[k] = {view(first), view(first + 1), view(first + 2), view(first + 3)};
      }
      times_[k] = static_cast<std::int64_t>(i + 1) * 50'000'000;
    }
  }
  void track() override {
    ft::tracking const* const t = odometry_.track(images_.data(), times_.data());
    last_ = {};
    for (int b = 0; b < batch_; ++b) {
      last_.tracked += t[b].state == ft::tracking_state::tracking ? 1 : 0;
      last_.keyframes += t[b].keyframe ? 1 : 0;
    }
    last_.inliers = t[0].inliers;
    last_.map_points = t[0].map_points;
    last_.maps = t[0].maps;
    last_.local_points = t[0].local_points;
  }
  odometry_counts last() const override { return last_; }

private:
  static ft::odometry_params params_of(scene const& s, frame_options const& how) {
    ft::odometry_params p;
    p.orb.width = s.width;
    p.orb.height = s.height;
    p.orb.features = s.features;
    p.use_graphs = how.use_graphs;
    return p;
  }
  /// Back and forth over the scene, so that consecutive frames are neighbours.
  int frame_of(int i, int b) const {
    int const n = static_cast<int>(scene_.frames.size());
    int const period = std::max(1, 2 * n - 2);
    int const k = (i + b) % period;
    return k < n ? k : period - k;
  }
  ft::gray_view view(int image) const {
    auto const bytes = static_cast<std::ptrdiff_t>(stride_) * scene_.height;
    return {pixels_.data() + image * bytes, scene_.width, scene_.height, stride_};
  }
  /// All frames in memory that an executor reads, rows padded.
  void lay_out_images() {
    stride_ = (scene_.width + 63) / 64 * 64;
    auto const bytes = static_cast<std::size_t>(stride_) * static_cast<std::size_t>(scene_.height);
    std::size_t const images = Rig::images * scene_.frames.size();
    pixels_ = ft::buffer<std::uint8_t, ft::staging_space<Exec>>(images * bytes);
    std::fill(pixels_.data(), pixels_.data() + pixels_.size(), std::uint8_t{0});
    for (std::size_t k = 0; k < images; ++k) {
      auto const& f = scene_.frames[k / Rig::images];
      std::size_t const i = k % Rig::images;
      auto const& from = i == 0 ? f.left : i == 1 ? f.right : f.aside[i - 2];
      auto const width = static_cast<std::size_t>(scene_.width);
      for (std::size_t y = 0; y < static_cast<std::size_t>(scene_.height); ++y) {
        std::copy_n(from.data() + y * width, width,
                    pixels_.data() + k * bytes + y * static_cast<std::size_t>(stride_));
      }
    }
  }

  scene const& scene_;
  int batch_;
  owned_executor<Exec> owned_;
  ft::buffer<std::uint8_t, ft::staging_space<Exec>> pixels_;  ///< [frames][images][height][stride_]
  int stride_ = 0;
  ft::odometry<Exec, Rig> odometry_;
  std::vector<typename ft::odometry<Exec, Rig>::images_type> images_;
  std::vector<std::int64_t> times_;
  odometry_counts last_;
};

template <typename Exec>
std::unique_ptr<odometry_runner> make_odometry_runner_of(scene const& s, frame_options const& how) {
  try {
    if (s.rig == rig_type::four_cameras) {
      return std::make_unique<odometry_runner_of<Exec, four_camera_rig>>(s, four_cameras_of(s),
                                                                         how);
    }
    auto const rig = rig_of<ft::rectified_rig>(s);
    return std::make_unique<odometry_runner_of<Exec, ft::rectified_rig>>(s, rig, how);
  } catch (std::bad_alloc const&) {
    throw no_memory("host memory is short");
  } catch (ft::cuda_error const& e) {
    if (std::string(e.what()).find("cudaErrorMemoryAllocation") == std::string::npos) { throw; }
    throw no_memory("device or pinned memory is short");
  }
}

}  // namespace FT_ABI

std::unique_ptr<odometry_runner> make_host_odometry(scene const& s, frame_options const& how);
std::unique_ptr<odometry_runner> make_cuda_odometry(scene const& s, frame_options const& how);

}  // namespace bench
