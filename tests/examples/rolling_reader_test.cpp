// SPDX-License-Identifier: Apache-2.0
/// @file Recordings of rolling shutters with distorting lenses: read as a pair, they are rectified,
/// and a rectified row shows rows of several times. What is lost by taking one of them is small.
#include <gtest/gtest.h>

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "examples/sequence/image_io.hpp"
#include "examples/sequence/odometry_input.hpp"
#include "examples/sequence/reader.hpp"
#include "ft/any_odometry.hpp"
#include "ft/cameras/radtan.hpp"
#include "tests/support/rolling_walk.hpp"
#include "tests/support/sequence.hpp"

namespace {

namespace rolling = test::rolling;

/// Two cameras, the second canted by 2 degrees, with rows read in 33 ms.
std::vector<rolling::mounted> canted_pair() {
  auto const lens = rolling::any::of(
      ft::radtan8<float>{290, 290, 239.5f, 170, {-0.28f, 0.07f, 2e-4f, -1e-4f, 0, 0, 0, 0}});
  return {{lens}, {lens, rolling::pose_of(0, 0.035, {-0.25, 0, 0})}};
}
void write_recording(seq_test::temp_folder const& folder) {
  auto const cameras = canted_pair();
  auto const walk = rolling::walk_of(cameras);
  std::string chain;
  for (std::size_t c = 0; c < cameras.size(); ++c) {
    std::string const name = "cam" + std::to_string(c);
    std::filesystem::create_directories(folder.path(name));
    for (std::size_t i = 0; i < walk.size(); ++i) {
      auto const time = rolling::swaying.time_ns(static_cast<int>(i)) + 1'600'000'000'000'000'000;
      seq::write_png(folder.path(name + "/" + std::to_string(time) + ".png"),
                     {rolling::width, rolling::height, walk[i][c].grey});
    }
    chain += name +
             ":\n  camera_model: pinhole\n  intrinsics: [290, 290, 239.5, 170]\n  resolution: "
             "[480, 360]\n  distortion_model: radtan\n  distortion_coeffs: [-0.28, 0.07, 0.0002, "
             "-0.0001]\n  line_delay: " +
             std::to_string(rolling::readout / (rolling::height - 1)) + "\n";
    if (c == 0) { continue; }
    chain += "  T_cn_cnm1:\n";
    auto const& T = cameras[c].T_cb;
    double const t[] = {T.t.x, T.t.y, T.t.z};
    for (int r = 0; r < 3; ++r) {
      chain += "  - [";
      for (int k = 0; k < 3; ++k) { chain += std::to_string(T.R.m[3 * r + k]) + ", "; }
      chain += std::to_string(t[r]) + "]\n";
    }
    chain += "  - [0, 0, 0, 1]\n";
  }
  folder.write("camchain.yaml", chain);
}

/// Root of the mean square, metres.
double error_of(seq_test::temp_folder const& folder, seq::camera_kind kind, bool ignored) {
  seq::open_options options;
  options.rig = kind;
  auto const recording = seq::sequence::open(folder.path(), options);
  auto rig = seq::odometry_rig(recording);
  for (int c = 0; c < rig.cameras; ++c) {
    EXPECT_NEAR(rig.camera[c].readout_s, rolling::readout, 0.3 * rolling::readout);
    if (ignored) { rig.camera[c].readout_s = 0; }
  }
  auto const params = seq::odometry_settings(recording, 600);
  auto odometry = ft::make_odometry({}, rig, params);
  // The camera whose pose is told may be turned by the rectification.
  auto const T_loaded_raw = seq::odometry_pose(recording.rig().T_body_left.inverse());
  rolling::error_of_path error;
  for (int i = 0; i < recording.size(); ++i) {
    auto const frame = recording.load(i);
    auto const t = odometry.track(seq::odometry_images(frame), frame.time_ns);
    EXPECT_EQ(t.state, ft::tracking_state::tracking) << i;
    error.add(t.T_world_camera, T_loaded_raw * rolling::swaying.truth(i) * T_loaded_raw.inverse());
  }
  return error.metric();
}

TEST(rolling_reader, rectified_images_lose_little) {
  seq_test::temp_folder const folder;
  write_recording(folder);
  double const rectified = error_of(folder, seq::camera_kind::stereo, false);
  double const as_they_are = error_of(folder, seq::camera_kind::mixed, false);
  double const ignored = error_of(folder, seq::camera_kind::stereo, true);
  EXPECT_LT(as_they_are, 0.015);
  EXPECT_LT(rectified, 0.02);
  EXPECT_LT(rectified, 0.2 * ignored) << ignored;
}

}  // namespace
