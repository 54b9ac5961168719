// SPDX-License-Identifier: Apache-2.0
/// @file The odometry runner, instantiated once per executor, for a rectified pair.
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
#include "ft/pipelines/odometry.hpp"

namespace bench {
inline namespace FT_ABI {

template <typename Exec>
class odometry_runner_of final : public odometry_runner {
public:
  odometry_runner_of(scene const& s, frame_options const& how)
      : scene_(s),
        batch_(how.batch),
        owned_(how.host_threads),
        odometry_(owned_.exec, rig_of<ft::rectified_rig>(s), params_of(s, how), how.batch),
        images_(static_cast<std::size_t>(how.batch)),
        times_(images_.size()) {
    lay_out_images();
  }

  void prepare(int i) override {
    for (int b = 0; b < batch_; ++b) {
      auto const k = static_cast<std::size_t>(b);
      images_[k] = {view(2 * frame_of(i, b)), view(2 * frame_of(i, b) + 1)};
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
    pixels_ = ft::buffer<std::uint8_t, ft::staging_space<Exec>>(2 * bytes * scene_.frames.size());
    std::fill(pixels_.data(), pixels_.data() + pixels_.size(), std::uint8_t{0});
    for (std::size_t k = 0; k < 2 * scene_.frames.size(); ++k) {
      auto const& f = scene_.frames[k / 2];
      auto const& from = k % 2 == 0 ? f.left : f.right;
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
  ft::buffer<std::uint8_t, ft::staging_space<Exec>> pixels_;  ///< [frames][2][height][stride_]
  int stride_ = 0;
  ft::odometry<Exec> odometry_;
  std::vector<ft::stereo_images> images_;
  std::vector<std::int64_t> times_;
  odometry_counts last_;
};

template <typename Exec>
std::unique_ptr<odometry_runner> make_odometry_runner_of(scene const& s, frame_options const& how) {
  try {
    return std::make_unique<odometry_runner_of<Exec>>(s, how);
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
