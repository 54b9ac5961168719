// SPDX-License-Identifier: Apache-2.0
/// @file track_sequence with one camera, with depth images, and with recordings whose time stamps,
/// units or calibrations are not as they should be. All on the host executor.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <random>
#include <string>
#include <vector>

#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/image_io.hpp"
#include "examples/sequence/rectify.hpp"
#include "tests/end_to_end/process.hpp"
#include "tests/end_to_end/track_support.hpp"
#include "tests/support/sequence.hpp"

namespace {

using namespace app_test;

json summary_of(temp_folder const& folder) {
  return json::parse(read_file(folder.path("out/summary.json")));
}

// ---- one camera

TEST(OneCamera, WithoutTheOtherIsTrackedAsWithIt) {
  spoilt_sequence const s(many);
  temp_folder const both;
  ASSERT_TRUE(succeeded(track(s.path(), both.path("out"), {"--rig", "mono"})));
  fs::remove_all(s.path("cam1"));
  temp_folder const one;
  outcome const o = track(s.path(), one.path("out"));
  ASSERT_TRUE(succeeded(o));
  EXPECT_TRUE(contains(o.out, "cameras   one camera, "));
  EXPECT_EQ(read_file(one.path("out/trajectory.txt")), read_file(both.path("out/trajectory.txt")));
  EXPECT_GE(summary_of(one).at("tracked").get<int>(), many / 3);
}

// ---- rolling shutters

/// Rows of 33 ms, walking: the calibration says it, --readout 0 says otherwise.
TEST(RollingShutter, TreatedHasAtMostHalfTheError) {
  std::string const sequence = generated(70, {"--width", "376", "--readout", "33"});
  temp_folder const treated;
  temp_folder const untreated;
  ASSERT_TRUE(succeeded(track(sequence, treated.path("out"), {"--imu", "off", "--timing"})));
  ASSERT_TRUE(
      succeeded(track(sequence, untreated.path("out"), {"--imu", "off", "--readout", "0"})));
  auto const error_of = [](temp_folder const& run) {
    json const s = summary_of(run);
    EXPECT_EQ(s.at("tracked").get<int>(), 70);
    return s.at("ate_rmse_m").get<double>();
  };
  EXPECT_LT(error_of(treated), 0.5 * error_of(untreated));
}

// ---- depth images

constexpr int plane_frames = 8;
constexpr int plane_width = 640;
constexpr int plane_height = 480;

/// A camera that moves by 0.02 m a frame along x before a wall 2 m away: 4 pixels a frame.
void write_wall(temp_folder const& folder, std::string const& unit) {
  constexpr int side = 4;  // of a square of one grey, pixels
  constexpr int step = 4;
  std::mt19937 bits(7);
  std::vector<std::uint8_t> squares(400 * 300);
  for (auto& grey : squares) { grey = static_cast<std::uint8_t>(bits() >> 24); }
  seq::depth_image const depth{plane_width, plane_height,
                               std::vector<std::uint16_t>(plane_width * plane_height, 2000)};
  fs::create_directories(folder.path("rgb"));
  fs::create_directories(folder.path("depth"));
  std::string rgb;
  std::string depths;
  std::string truth;
  for (int i = 0; i < plane_frames; ++i) {
    seq::image grey = plain(0, plane_width, plane_height);
    for (int y = 0; y < plane_height; ++y) {
      for (int x = 0; x < plane_width; ++x) {
        auto const at = (y / side) * 400 + (x + step * i) / side;
        grey.row(y)[x] = squares[static_cast<std::size_t>(at)];
      }
    }
    std::string const name = std::to_string(i) + ".png";
    seq::write_png(folder.path("rgb/" + name), grey);
    seq::write_depth_png(folder.path("depth/" + name), depth);
    char line[96];
    std::snprintf(line, sizeof line, "%.6f rgb/%s\n", 100 + i / 30.0, name.c_str());
    rgb += line;
    std::snprintf(line, sizeof line, "%.6f depth/%s\n", 100.004 + i / 30.0, name.c_str());
    depths += line;
    std::snprintf(line, sizeof line, "%.6f %.6f 0 0 0 0 0 1\n", 100 + i / 30.0, 0.02 * i);
    truth += line;
  }
  folder.write("rgb.txt", rgb);
  folder.write("depth.txt", depths);
  folder.write("groundtruth.txt", truth);
  folder.write("camera.txt", unit + "400 400 320 240\n");
}

double last_x(temp_folder const& folder) {
  return seq::read_tum(folder.path("out/trajectory.txt")).back().T_world_camera.translation().x();
}

TEST(DepthCamera, PathIsInMetres) {
  temp_folder const folder;
  write_wall(folder, "# depth in units of 1 mm\n");
  outcome const o = track(folder.path(), folder.path("out"));
  ASSERT_TRUE(succeeded(o));
  EXPECT_TRUE(contains(o.out, "cameras   one camera with depth images, 640x480") &&
              contains(o.out, "images    8 frames, "));
  EXPECT_TRUE(contains(o.out, "0.001 m a unit, as the calibration says"));
  json const summary = summary_of(folder);
  EXPECT_EQ(summary.at("tracked"), plane_frames);
  EXPECT_TRUE(summary.at("scale").is_null());
  EXPECT_LT(summary.at("ate_rmse_m").get<double>(), 0.002);
  EXPECT_EQ(summary.at("warnings").get<strings>(), strings{});
  EXPECT_NEAR(last_x(folder), 0.02 * (plane_frames - 1), 0.003);
  // Reading ahead and prefetching change nothing.
  std::string const path = read_file(folder.path("out/trajectory.txt"));
  ASSERT_TRUE(succeeded(track(folder.path(), folder.path("out"), {"--read-ahead", "0"})));
  EXPECT_EQ(read_file(folder.path("out/trajectory.txt")), path);
}

TEST(DepthCamera, UnitAndRangeAreOptions) {
  temp_folder const folder;
  write_wall(folder, "");
  outcome const o = track(folder.path(), folder.path("out"));
  ASSERT_TRUE(succeeded(o));
  EXPECT_TRUE(contains(o.out, "0.0002 m a unit, assumed, as TUM RGB-D has it"));
  EXPECT_NEAR(last_x(folder), 0.2 * 0.02 * (plane_frames - 1), 0.001);
  json const assumed = summary_of(folder);
  strings const said = assumed.at("warnings").get<strings>();
  auto const is_said = [&](char const* words) {
    return std::any_of(said.begin(), said.end(),
                       [&](std::string const& w) { return contains(w, words); });
  };
  EXPECT_TRUE(is_said("--depth-unit 0.001")) << o;
  EXPECT_TRUE(is_said("the path has the ground truth's shape, not its scale")) << o;
  EXPECT_NEAR(assumed.at("scale_to_truth").get<double>(), 5, 0.3);
  ASSERT_TRUE(succeeded(track(folder.path(), folder.path("out"), {"--depth-unit", "0.002"})));
  EXPECT_NEAR(last_x(folder), 2 * 0.02 * (plane_frames - 1), 0.006);
  for (strings const& range : {strings{"--min-depth", "2.1"}, strings{"--max-depth", "1.9"}}) {
    strings options = {"--depth-unit", "0.001"};
    options.insert(options.end(), range.begin(), range.end());
    outcome const none = track(folder.path(), folder.path("out"), options);
    EXPECT_EQ(none.status, 1) << none;
    EXPECT_TRUE(contains(none.err, "too few corners have a depth")) << none;
  }
  strings const whole = {"--depth-unit", "0.001", "--min-depth", "1.9", "--max-depth", "2.1"};
  EXPECT_TRUE(succeeded(track(folder.path(), folder.path("out"), whole)));
}

TEST(DepthCamera, OptionsThatDoNotFit) {
  temp_folder const folder;
  write_wall(folder, "");
  std::string const out = folder.path("out");
  EXPECT_TRUE(complained_of(track(folder.path(), out, {"--rig", "stereo"}), "no second camera"));
  EXPECT_TRUE(complained_of(track(folder.path(), out, {"--rig", "mono", "--depth-unit", "0.001"}),
                            "--depth-unit"));
  EXPECT_TRUE(complained_of(track(generated(few), out, {"--rig", "rgbd"}), "no depth images"));
  EXPECT_TRUE(complained_of(track(generated(few), out, {"--max-depth", "4"}), "--max-depth"));
  fs::remove(folder.path("camera.txt"));
  EXPECT_TRUE(complained_of(track(folder.path(), out), "--calibration"));
}

// ---- rigs

constexpr int rig_frames = 16;

seq::camera_intrinsics rig_camera(int k) {
  seq::camera_intrinsics camera;
  camera.width = 320;
  camera.height = 240;
  camera.fx = camera.fy = 200;
  camera.cx = 160;
  camera.cy = 120;
  if (k == 1) {
    camera.model = seq::lens::kannala_brandt;
    camera.distortion = {0.01, -0.02, 0.01, 0};
  }
  if (k == 2) {
    camera.model = seq::lens::radial_tangential;
    camera.distortion = {-0.02, 0.01, 0.0005, -0.0005};
  }
  return camera;
}

/// A pinhole, a fisheye 0.1 m beside it and a distorted camera 0.05 m below, before a wall 2 m away
/// of squares of 0.02 m; they move by 0.02 m a frame along x. A pixel is the mean of four rays, and
/// no ray meets the edge of a square: a camera whose rays did would see all edges half a pixel
/// aside, the others not.
void write_rig(temp_folder const& folder) {
  constexpr int side = 800;
  std::mt19937 bits(7);
  std::vector<std::uint8_t> squares(side * 600);
  for (auto& grey : squares) { grey = static_cast<std::uint8_t>(bits() >> 24); }
  std::string chain;
  for (int k = 0; k < 3; ++k) {
    seq::camera_intrinsics const camera = rig_camera(k);
    seq::lens_projection const lens(camera);
    Eigen::Vector2d const place(k == 1 ? 0.1 : 0, k == 2 ? 0.05 : 0);
    std::vector<Eigen::Vector2d> rays;  // four a pixel
    for (int i = 0; i < 4 * camera.width * camera.height; ++i) {
      int const x = i / 4 % camera.width;
      int const y = i / 4 / camera.width;
      rays.push_back(lens.unproject({x - 0.25 + i % 2 * 0.5, y - 0.25 + i / 2 % 2 * 0.5}).pixel);
    }
    std::string const name = "cam" + std::to_string(k);
    fs::create_directories(folder.path(name));
    for (int f = 0; f < rig_frames; ++f) {
      seq::image grey = plain(0, camera.width, camera.height);
      Eigen::Vector2d const at = place + Eigen::Vector2d(8.0017 + 0.02 * f, 6.0017);
      for (std::size_t i = 0; i < grey.pixels.size(); ++i) {
        int sum = 2;
        for (std::size_t r = 4 * i; r < 4 * i + 4; ++r) {
          Eigen::Vector2d const on = (2 * rays[r] + at) / 0.02;
          sum += squares[static_cast<std::size_t>(std::floor(on.y())) * side +
                         static_cast<std::size_t>(std::floor(on.x()))];
        }
        grey.pixels[i] = static_cast<std::uint8_t>(sum / 4);
      }
      seq::write_png(folder.path(name + "/" + std::to_string(100 + 0.05 * f) + ".png"), grey);
    }
    chain += name + ":\n  camera_model: pinhole\n  intrinsics: [200, 200, 160, 120]\n" +
             "  resolution: [320, 240]\n  distortion_model: " +
             (k == 0   ? "none"
              : k == 1 ? "equidistant"
                       : "radtan") +
             "\n  distortion_coeffs: " +
             (k == 0   ? "[]"
              : k == 1 ? "[0.01, -0.02, 0.01, 0]"
                       : "[-0.02, 0.01, 0.0005, -0.0005]") +
             "\n";
    if (k > 0) {
      chain += std::string("  T_cn_cnm1: [[1, 0, 0, ") + (k == 1 ? "-0.1" : "0.1") +
               "], [0, 1, 0, " + (k == 1 ? "0" : "-0.05") + "], [0, 0, 1, 0], [0, 0, 0, 1]]\n";
    }
  }
  folder.write("camchain.yaml", chain);
}

/// What the camera looks at moves along the wall as it should. Before a wall a turn looks like a
/// step, so the camera's own place is known less well; more frames do not add to that.
void expect_path_along_wall(temp_folder const& folder) {
  auto const last = seq::read_tum(folder.path("out/trajectory.txt")).back().T_world_camera;
  double const moved = 0.02 * (rig_frames - 1);
  EXPECT_NEAR((last * Eigen::Vector3d(0, 0, 2)).x(), moved, 0.03 * moved);
  EXPECT_NEAR(last.translation().x(), moved, 0.1 * moved);
}

TEST(Rigs, CamerasOfDifferentLensesHaveOnePath) {
  temp_folder const folder;
  write_rig(folder);
  outcome const o = track(folder.path(), folder.path("out"),
                          {"--rig", "mixed", "--record", folder.path("recorded")});
  ASSERT_TRUE(succeeded(o));
  EXPECT_TRUE(contains(o.out, "3 cameras, 320x240; cam0 pinhole and cam1 Kannala-Brandt, 0.1 m"));
  json const summary = summary_of(folder);
  EXPECT_EQ(summary.at("tracked"), rig_frames);
  EXPECT_EQ(summary.at("options").at("rig"), "mixed");
  json const header = json::parse(lines_of(read_file(folder.path("recorded/recording.jsonl")))[0]);
  EXPECT_EQ(header.at("model"), "Pinhole");
  expect_path_along_wall(folder);
}

TEST(Rigs, MasksKeepKeypointsAwayAndCamerasMayMissImages) {
  temp_folder const folder;
  write_rig(folder);
  // Of the left camera the right half, from the 6th frame on the left half. Pixels of the coarsest
  // level have 3.6 of the image, and positions are refined by up to one.
  fs::create_directories(folder.path("masks"));
  std::vector<std::string> names;
  for (auto const& entry : fs::directory_iterator(folder.path("cam0"))) {
    names.push_back(entry.path().filename().string());
  }
  std::sort(names.begin(), names.end());
  for (std::size_t f = 0; f < names.size(); ++f) {
    seq::image mask{320, 240, std::vector<std::uint8_t>(320 * 240)};
    for (std::size_t i = 0; i < mask.pixels.size(); ++i) {
      mask.pixels[i] = (i % 320 < 160) == (f < 5) ? 255 : 0;
    }
    seq::write_png(folder.path("masks/" + names[f]), mask);
  }
  fs::remove(folder.path("cam2/" + names[7]));
  outcome const o = track(
      folder.path(), folder.path("out"),
      {"--rig", "mixed", "--mask", folder.path("masks"), "--record", folder.path("recorded")});
  ASSERT_TRUE(succeeded(o));
  EXPECT_TRUE(contains(o.out, "; masks"));
  EXPECT_TRUE(contains(o.out + o.err, "1 of 16 frames have no image of cam2")) << o;
  EXPECT_EQ(summary_of(folder).at("tracked"), rig_frames);
  EXPECT_FALSE(contains(read_file(folder.path("out/times.csv")), "dark"));
  strings const lines = lines_of(read_file(folder.path("recorded/recording.jsonl")));
  ASSERT_EQ(lines.size(), names.size() + 1);
  for (std::size_t f = 0; f < names.size(); ++f) {
    auto const columns = json::parse(lines[f + 1]).at("x").get<std::vector<double>>();
    EXPECT_GT(columns.size(), 50U);
    for (double const x : columns) {
      EXPECT_TRUE(f < 5 ? x < 166 : x > 154) << "frame " << f << ": " << x;
    }
  }
  EXPECT_EQ(track(folder.path(), folder.path("out"), {"--mask", folder.path("none.png")}).status,
            1);
}

TEST(Rigs, ADepthCameraAmongThem) {
  temp_folder const folder;
  write_rig(folder);
  fs::create_directories(folder.path("depth0"));
  for (auto const& entry : fs::directory_iterator(folder.path("cam0"))) {
    std::vector<std::uint16_t> const wall(320 * 240, 2000);
    seq::write_depth_png(folder.path("depth0/" + entry.path().filename().string()),
                         {320, 240, wall});
  }
  outcome const o =
      track(folder.path(), folder.path("out"), {"--rig", "mixed", "--depth-unit", "0.001"});
  ASSERT_TRUE(succeeded(o));
  EXPECT_TRUE(contains(o.out, "cam0 pinhole with depth images; cam1 Kannala-Brandt and cam2"));
  EXPECT_TRUE(contains(o.out, "depth     taken from 0 to inf m"));
  EXPECT_EQ(summary_of(folder).at("tracked"), rig_frames);
  expect_path_along_wall(folder);
}

// ---- stamps

TEST(Stamps, CamerasThatDifferByMicroseconds) {
  spoilt_sequence const s(few);
  std::string const before = read_file(s.path("cam1/data.csv"));
  std::ofstream later(s.path("cam1/data.csv"));
  for (std::string const& line : lines_of(before)) {
    std::size_t const comma = line.find(',');
    if (line[0] == '#') { continue; }
    later << std::stoll(line.substr(0, comma)) + 12'000 << line.substr(comma) << "\n";
  }
  later.close();
  outcome const o = track(s.path(), s.out());
  ASSERT_TRUE(succeeded(o));
  EXPECT_TRUE(contains(o.out, "cameras   stereo pair, ") &&
              contains(o.out, "images    6 frames, "));
  EXPECT_TRUE(contains(o.out, "warning: the cameras' time stamps differ"));
  EXPECT_TRUE(complained_of(track(s.path(), s.out(), {"--max-time-difference", "0.01"}),
                            "0.012 ms apart, at most 0.01 ms"));
}

TEST(Stamps, ADoubledLineEndsNothing) {
  spoilt_sequence const s(few);
  for (char const* name : {"cam0/data.csv", "imu0/data.csv"}) {
    if (!fs::exists(s.path(name))) { continue; }
    strings lines = lines_of(read_file(s.path(name)));
    lines.insert(lines.begin() + 3, lines[3]);
    std::ofstream out(s.path(name));
    for (std::string const& line : lines) { out << line << "\n"; }
  }
  outcome const o = track(s.path(), s.out());
  ASSERT_TRUE(succeeded(o));
  EXPECT_TRUE(contains(o.out, "cam0/data.csv: 1 line of 7 images left out"));
}

// ---- recordings

/// One plain command: frames tracked of all, and the error as the summary has it.
void expect_recorded(std::string const& name, int tracked, double most_m, bool scale_known,
                     strings const& options = {}) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  std::string const sequence = shared + "/data/" + name;
  if (!fs::exists(sequence)) { GTEST_SKIP() << "no " << sequence; }
  temp_folder const folder;
  strings all = {"--threads", "0"};
  all.insert(all.end(), options.begin(), options.end());
  outcome const o = track(sequence, folder.path("out"), all);
  ASSERT_TRUE(succeeded(o));
  json const summary = summary_of(folder);
  EXPECT_GE(summary.at("tracked").get<int>(), tracked);
  EXPECT_EQ(summary.at("scale").is_null(), scale_known);
  EXPECT_LT(summary.at("ate_rmse_m").get<double>(), most_m);
}

TEST(Recorded, EurocByItsOneCamera) { expect_recorded("euroc_mh05_mono", 65, 0.03, false); }
TEST(Recorded, KitchenWithDepth) {
  expect_recorded("rgbd_7scenes_kitchen", 60, 0.04, true, {"--frames", "60"});
}
TEST(Recorded, RenderedWithDepth) { expect_recorded("rgbd_tartanair", 50, 0.5, true); }

}  // namespace
