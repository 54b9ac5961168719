// SPDX-License-Identifier: Apache-2.0
/// @file Runs to report of, and the files that are written of them.
#pragma once

#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>

#include "examples/sequence/report.hpp"

namespace report_test {

constexpr double nan_value = std::numeric_limits<double>::quiet_NaN();
constexpr double inf_value = std::numeric_limits<double>::infinity();

inline std::string read_text(std::string const& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

/// Pixels that a JPEG cannot compress well.
inline seq::image noisy(int width, int height, std::uint32_t seed) {
  seq::image out;
  out.width = width;
  out.height = height;
  out.pixels.resize(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
  for (std::uint8_t& p : out.pixels) {
    seed = seed * 1664525U + 1013904223U;
    p = static_cast<std::uint8_t>(seed >> 24U);
  }
  return out;
}

inline seq::run_report filled(int frames, bool truth) {
  seq::run_report r;
  r.title = "Run";
  r.sequence = "room";
  r.backend = "host";
  r.device = "processor";
  r.options = {{"levels", "8"}, {"output", "here"}};
  r.image_width = 64;
  r.image_height = 48;
  r.frames = frames;
  r.map_points = 1234;
  r.stages = {"fast", "match", "total"};
  for (int i = 0; i < frames; ++i) {
    seq::frame_record f;
    f.index = i;
    f.time_ns = 1'403'636'579'763'555'584LL + i * 50'000'000LL;
    f.tracked = i % 10 != 7;
    f.keyframe = i % 5 == 0;
    f.keypoints = 1000;
    f.stereo_matches = 600;
    f.inliers = f.tracked ? 200 + i % 3 : 0;
    f.local_points = 800;
    f.stage_ms = {1.0 + i % 2, 2.0, i == 3 ? 400.0 : 4.0 + i % 2};
    seq::stamped_pose p;
    p.time_ns = f.time_ns;
    p.T_world_camera.translation() = Eigen::Vector3d(std::cos(i * 0.01), 0.1, std::sin(i * 0.01));
    if (truth) { r.truth.push_back(p); }
    if (f.tracked) {
      p.T_world_camera.translation().x() += 0.01 * (i % 4);
      r.estimate.push_back(p);
      ++r.tracked;
    } else {
      ++r.lost;
    }
    if (f.keyframe) { ++r.keyframes; }
    r.records.push_back(f);
  }
  r.error.path_m = 12.5;
  if (truth) {
    r.error.pairs = r.tracked;
    r.error.truth_path_m = 12.25;
    r.error.estimate_path_m = 12.5;
    r.error.ate_rmse_m = 0.05;
    r.error.rpe_rmse_m = 0.025;
    r.error.ate_rotation_rmse_deg = 1.5;
    r.error.rpe_rotation_rmse_deg = 0.75;
    r.error.rpe_span = 20;
  }
  return r;
}

/// Points on the walls of a room around the path.
inline void add_cloud(seq::run_report& r, int points) {
  for (int i = 0; i < points; ++i) {
    auto const t = static_cast<float>(i);
    r.cloud.emplace_back(3 * std::cos(t), std::sin(0.37F * t), 3 * std::sin(t));
  }
}

inline void add_sample(seq::run_report& r, int width, int height, int keypoints) {
  seq::sample_frame s;
  s.index = static_cast<int>(r.samples.size()) * 10;
  s.picture = noisy(width, height, static_cast<std::uint32_t>(s.index + 1));
  for (int i = 0; i < keypoints; ++i) {
    seq::sample_frame::keypoint k;
    k.x = static_cast<float>((i * 7919) % width) + 0.5F;
    k.y = static_cast<float>((i * 104729) % height) + 0.25F;
    k.octave = i % 8;
    k.size = 31.0F * std::pow(1.2F, static_cast<float>(k.octave));
    if (i % 3 != 0) { k.depth = 1.0F + static_cast<float>(i % 40); }
    k.matched = i % 2 == 0;
    if (i % 4 == 0) {
      k.from_x = k.x + 2;
      k.from_y = k.y + 1;
    }
    s.keypoints.push_back(k);
  }
  r.samples.push_back(std::move(s));
}

class report : public ::testing::Test {
protected:
  void SetUp() override {
    auto const* const info = ::testing::UnitTest::GetInstance()->current_test_info();
    auto const stamp = std::chrono::steady_clock::now().time_since_epoch().count();
    folder_ = std::filesystem::path(::testing::TempDir()) /
              (std::string("ft_report_") + info->name() + '_' + std::to_string(stamp));
    std::filesystem::create_directories(folder_);
  }
  void TearDown() override {
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
  }
  std::string file(std::string const& name) const { return (folder_ / name).string(); }

  nlohmann::json summary(seq::run_report const& r) const {
    seq::write_summary_json(file("summary.json"), r);
    return nlohmann::json::parse(read_text(file("summary.json")));
  }
  std::string html(seq::run_report const& r) const {
    seq::write_html(file("report.html"), r);
    return read_text(file("report.html"));
  }

  std::filesystem::path folder_;
};

}  // namespace report_test
