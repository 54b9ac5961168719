// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/reader.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <iterator>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "examples/sequence/asl_writer.hpp"
#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/generator.hpp"
#include "examples/sequence/image_io.hpp"
#include "examples/sequence/rectify.hpp"
#include "tests/support/sequence.hpp"

namespace {

namespace fs = std::filesystem;
using seq_test::contains;
using seq_test::message_of;
using seq_test::replaced;
using seq_test::temp_folder;

constexpr int image_width = 64;
constexpr int image_height = 48;

/// Pixel values that tell images and places apart.
seq::image picture(int seed, int w = image_width, int h = image_height) {
  seq::image result;
  result.width = w;
  result.height = h;
  for (int i = 0; i < w * h; ++i) {
    result.pixels.push_back(static_cast<std::uint8_t>((i * 7 + seed * 31) % 251));
  }
  return result;
}

std::string sensor_text(double y, std::string const& distortion = "[0, 0, 0, 0]",
                        std::string const& model = "radial-tangential") {
  // The camera's x is the body's y, its y the body's -x.
  return "%YAML:1.0\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n"
         "  data: [0, -1, 0, 0.5, 1, 0, 0, " +
         std::to_string(y) +
         ", 0, 0, 1, 0.25, 0, 0, 0, 1]\nrate_hz: 20\nresolution: [64, 48]\n"
         "camera_model: pinhole\nintrinsics: [40, 40, 31.5, 23.5]\ndistortion_model: " +
         model + "\ndistortion_coefficients: " + distortion + "\n";
}

std::int64_t stamp(int i) { return 1'403'715'273'262'142'976 + i * std::int64_t{50'000'000}; }

/// A rectified EuRoC sequence of `count` pairs; ground truth with 200 Hz from the second frame on.
void write_euroc(temp_folder const& folder, int count, std::string const& name = "mav0/") {
  std::string csv = "#timestamp [ns],filename\r\n";
  for (int i = 0; i < count; ++i) {
    csv += std::to_string(stamp(i)) + "," + std::to_string(stamp(i)) + ".png\r\n";
  }
  for (int camera = 0; camera < 2; ++camera) {
    std::string const base = name + "cam" + std::to_string(camera) + "/";
    folder.write(base + "data.csv", csv);
    folder.write(base + "sensor.yaml", sensor_text(0.1 * camera));
    fs::create_directories(folder.path(base + "data"));
    for (int i = 0; i < count; ++i) {
      seq::write_png(folder.path(base + "data/" + std::to_string(stamp(i)) + ".png"),
                     picture(2 * i + camera));
    }
  }
}

void write_euroc_truth(temp_folder const& folder,
                       std::string const& sensor = "state_groundtruth_estimate0") {
  std::string text = "#timestamp, p_RS_R_x [m], ...\n";
  for (int i = 10; i < 40; ++i) {  // a body that moves along x, turned by 90 degrees about z
    text += std::to_string(stamp(0) + i * 5'000'000) + "," + std::to_string(0.01 * i) +
            ",2,3,0.70710678,0,0,0.70710678,0,0,0,0,0,0,0,0,0\n";
  }
  folder.write("mav0/" + sensor + "/data.csv", text);
}

std::string const kitti_calib =
    "P0: 4e1 0 31.5 0 0 40 23.5 0 0 0 1 0\nP1: 40 0 31.5 -4.0 0 40 23.5 0 0 0 1 0\n";

void write_kitti(temp_folder const& folder, int count) {
  std::string times;
  for (int i = 0; i < count; ++i) {
    char name[32];
    std::snprintf(name, sizeof name, "%06d.png", i);
    for (int camera = 0; camera < 2; ++camera) {
      std::string const base = "image_" + std::to_string(camera) + "/";
      fs::create_directories(folder.path(base));
      seq::write_png(folder.path(base + name), picture(2 * i + camera));
    }
    char time[32];
    std::snprintf(time, sizeof time, "%.6e\n", 0.1 * i);
    times += time;
  }
  folder.write("times.txt", times);
  folder.write("calib.txt", kitti_calib);
}

std::string open_error(std::string const& path, seq::open_options const& options = {}) {
  return message_of([&] { seq::sequence::open(path, options); });
}

void truncate_file(std::string const& path) { fs::resize_file(path, fs::file_size(path) / 2); }

TEST(reader_euroc, opens_a_rectified_pair_untouched) {
  temp_folder const folder;
  write_euroc(folder, 3);
  write_euroc_truth(folder);
  for (std::string const& path : {folder.path(), folder.path() + "/", folder.path("mav0")}) {
    seq::sequence const s = seq::sequence::open(path);
    EXPECT_EQ(s.name(), fs::path(folder.path()).filename().string());
    EXPECT_EQ(s.layout(), "euroc");
    EXPECT_FALSE(s.fisheye());
    ASSERT_EQ(s.size(), 3);
    EXPECT_TRUE(s.rig().rectified());
    EXPECT_EQ(s.rig().left.model, seq::lens::pinhole);
    EXPECT_EQ(s.rig().left.fx, 40);
    EXPECT_NEAR(s.rig().baseline(), 0.1, 1e-12);
    EXPECT_EQ(s.rig().fps, 20);
    for (int i = 0; i < 3; ++i) {
      seq::stereo_frame const frame = s.load(i);
      EXPECT_EQ(frame.time_ns, stamp(i));
      EXPECT_EQ(s.time_ns(i), stamp(i));
      EXPECT_EQ(frame.left.pixels, picture(2 * i).pixels);
      EXPECT_EQ(frame.right.pixels, picture(2 * i + 1).pixels);
    }
    EXPECT_THROW(s.load(3), seq::error);
    EXPECT_THROW(s.load(-1), seq::error);
    EXPECT_FALSE(s.settings().features.has_value());
  }
}

TEST(reader_euroc, ground_truth_of_the_body_becomes_the_cameras) {
  temp_folder const folder;
  write_euroc(folder, 3);
  write_euroc_truth(folder);
  seq::sequence const s = seq::sequence::open(folder.path());
  ASSERT_EQ(s.ground_truth().size(), 30U);
  EXPECT_TRUE(s.ground_truth_has_orientation());
  Eigen::Isometry3d body = Eigen::Isometry3d::Identity();
  body.linear() = Eigen::AngleAxisd(std::acos(0.0), Eigen::Vector3d::UnitZ()).toRotationMatrix();
  body.translation() = Eigen::Vector3d(0.1, 2, 3);
  Eigen::Isometry3d camera = Eigen::Isometry3d::Identity();
  camera.linear() << 0, -1, 0, 1, 0, 0, 0, 0, 1;
  camera.translation() = Eigen::Vector3d(0.5, 0, 0.25);
  seq::stamped_pose const first = s.ground_truth().front();
  EXPECT_EQ(first.time_ns, stamp(1));  // after the first image
  EXPECT_LT((first.T_world_camera.matrix() - (body * camera).matrix()).norm(), 1e-7);
}

std::string const imu_sensor_text =
    "%YAML:1.0\nsensor_type: imu\nT_BS:\n  cols: 4\n  rows: 4\n"
    "  data: [1, 0, 0, 0.5, 0, 1, 0, -0.25, 0, 0, 1, 1, 0, 0, 0, 1]\nrate_hz: 200\n"
    "gyroscope_noise_density: 1.6968e-04     # [ rad / s / sqrt(Hz) ]\n"
    "gyroscope_random_walk: 1.9393e-05\naccelerometer_noise_density: 2.0000e-3\n"
    "accelerometer_random_walk: 3.0000e-3\n";

std::string const imu_text =
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y,w_RS_S_z,a_RS_S_x,a_RS_S_y,a_RS_S_z\r\n"
    "1403715273262142976,-0.1,0.2,0.3,9.81,-0.5,-3.25\r\n"
    "1403715273267143168,-1e-1,0.25,0.3,9.80,-0.5,-3.0\r\n";

std::optional<seq::imu_recording> imu_of(temp_folder const& folder,
                                         std::string const& calibration = {}) {
  seq::open_options options;
  options.read_imu = true;
  options.calibration = calibration;
  return seq::sequence::open(folder.path(), options).imu();
}

TEST(reader_imu, reads_samples_noise_and_place) {
  temp_folder const folder;
  write_euroc(folder, 3);
  EXPECT_FALSE(imu_of(folder));
  folder.write("mav0/imu0/data.csv", imu_text);
  EXPECT_FALSE(imu_of(folder)) << "noise and place are not known";
  folder.write("mav0/imu0/sensor.yaml", imu_sensor_text);
  EXPECT_FALSE(seq::sequence::open(folder.path()).imu()) << "not asked for";
  auto const imu = imu_of(folder);
  ASSERT_TRUE(imu);
  EXPECT_EQ(imu->calibration.rate_hz, 200);
  EXPECT_EQ(imu->calibration.noise.gyro, 1.6968e-4);
  EXPECT_EQ(imu->calibration.noise.gyro_walk, 1.9393e-5);
  EXPECT_EQ(imu->calibration.noise.accel, 2e-3);
  EXPECT_EQ(imu->calibration.noise.accel_walk, 3e-3);
  ASSERT_EQ(imu->samples.size(), 2U);
  EXPECT_EQ(imu->samples[1].time_ns, 1403715273267143168);
  EXPECT_EQ(imu->samples[1].gyro, Eigen::Vector3d(-0.1, 0.25, 0.3));
  EXPECT_EQ(imu->samples[0].accel, Eigen::Vector3d(9.81, -0.5, -3.25));
  // The camera is at (0.5, 0, 0.25) of the body, turned by 90 degrees; the IMU at (0.5, -0.25, 1).
  Eigen::Matrix4d expected;
  expected << 0, -1, 0, 0, 1, 0, 0, 0.25, 0, 0, 1, -0.75, 0, 0, 0, 1;
  EXPECT_LT((imu->T_imu_left.matrix() - expected).norm(), 1e-12);
}

TEST(reader_imu, takes_noise_and_place_from_a_named_settings_file) {
  temp_folder const folder;
  write_euroc(folder, 2);
  folder.write("mav0/imu0/data.csv", imu_text);
  folder.write("mav0/imu0/sensor.yaml", imu_sensor_text);
  std::string const settings =
      "%YAML:1.0\nCamera.type: Rectified\nCamera1.fx: 40\nCamera1.fy: 40\nCamera1.cx: 31.5\n"
      "Camera1.cy: 23.5\nStereo.b: 0.1\nIMU.NoiseGyro: 1e-3\nIMU.NoiseAcc: 2e-2\n"
      "IMU.GyroWalk: 3e-4\nIMU.AccWalk: 4e-3\nIMU.Frequency: 100.0\n"
      "IMU.T_b_c1: !!opencv-matrix\n   rows: 4\n   cols: 4\n   dt: f\n"
      "   data: [1, 0, 0, 0.5, 0, 1, 0, 0.25, 0, 0, 1, 0.125, 0, 0, 0, 1]\n";
  auto const imu = imu_of(folder, folder.write("settings.yaml", settings));
  ASSERT_TRUE(imu);
  EXPECT_EQ(imu->calibration.rate_hz, 100);
  EXPECT_EQ(imu->calibration.noise.accel, 2e-2);
  EXPECT_EQ(imu->T_imu_left.translation(), Eigen::Vector3d(0.5, 0.25, 0.125));
  EXPECT_EQ(imu->samples.size(), 2U);
}

TEST(reader_imu, refuses_damaged_files_with_file_and_line) {
  struct bad_case {
    std::string from, to, expected;
  };
  std::vector<bad_case> const samples = {
      {"1403715273267143168", "soon", "data.csv:3: 'soon' is not a time stamp"},
      {"9.81", "9.8l", "data.csv:2: '9.8l' is not a number"},
      {"0.2,0.3", "0.3", "data.csv:2: 6 fields, must have 7"},
  };
  for (bad_case const& c : samples) {
    temp_folder const folder;
    write_euroc(folder, 2);
    folder.write("mav0/imu0/data.csv", replaced(imu_text, c.from, c.to));
    folder.write("mav0/imu0/sensor.yaml", imu_sensor_text);
    std::string const message = message_of([&] { imu_of(folder); });
    EXPECT_TRUE(contains(message, c.expected)) << message;
    EXPECT_TRUE(contains(message, folder.path())) << message;
    EXPECT_EQ(seq::sequence::open(folder.path()).size(), 2) << "not asked for";
  }
  std::vector<bad_case> const sensors = {
      {"rate_hz: 200", "rate_hz: 0", "rate_hz = 0: must be at least 1"},
      {"rate_hz: 200", "", "rate_hz is missing"},
      {"1.6968e-04", "0", "gyroscope_noise_density = 0: must be above 0"},
      {"1.9393e-05", "-1", "gyroscope_random_walk = -1"},
      {"2.0000e-3", "much", "accelerometer_noise_density = much: not a number"},
      {"accelerometer_random_walk", "walk", "accelerometer_random_walk is missing"},
      {"[1, 0, 0, 0.5", "[2, 0, 0, 0.5", "T_BS: not a rotation"},
      {"rate_hz: 200", "rate_hz: [", "sensor.yaml:"},
  };
  for (bad_case const& c : sensors) {
    temp_folder const folder;
    write_euroc(folder, 2);
    folder.write("mav0/imu0/data.csv", imu_text);
    folder.write("mav0/imu0/sensor.yaml", replaced(imu_sensor_text, c.from, c.to));
    std::string const message = message_of([&] { imu_of(folder); });
    EXPECT_TRUE(contains(message, c.expected)) << message;
    EXPECT_TRUE(contains(message, folder.path("mav0/imu0/sensor.yaml"))) << message;
  }
  temp_folder const folder;
  write_euroc(folder, 2);
  folder.write("mav0/imu0/sensor.yaml", imu_sensor_text);
  folder.write("mav0/imu0/data.csv", "#timestamp\n\n");
  EXPECT_TRUE(contains(message_of([&] { imu_of(folder); }), "data.csv: no samples"));
}

TEST(reader_euroc, keeps_pairs_with_both_files_and_equal_times_only) {
  temp_folder const folder;
  write_euroc(folder, 4);
  std::ofstream(folder.path("mav0/cam1/data.csv"), std::ios::app)
      << stamp(9) << "," << stamp(9) << ".png\n\n";
  std::ofstream(folder.path("mav0/cam0/data.csv"), std::ios::app)
      << stamp(9) << "," << stamp(9) << ".png\n";
  fs::remove(folder.path("mav0/cam1/data/" + std::to_string(stamp(1)) + ".png"));
  seq::sequence const s = seq::sequence::open(folder.path());
  ASSERT_EQ(s.size(), 3);
  EXPECT_EQ(s.time_ns(1), stamp(2));
  EXPECT_EQ(s.load(1).right.pixels, picture(5).pixels);
  seq::open_options options;
  options.max_frames = 2;
  EXPECT_EQ(seq::sequence::open(folder.path(), options).size(), 2);
  options.max_frames = -1;
  EXPECT_TRUE(contains(open_error(folder.path(), options), "max_frames"));
}

TEST(reader_euroc, takes_jpeg_files) {
  temp_folder const folder;
  write_euroc(folder, 1);
  for (int camera = 0; camera < 2; ++camera) {
    std::string const base =
        "mav0/cam" + std::to_string(camera) + "/data/" + std::to_string(stamp(0));
    fs::remove(folder.path(base + ".png"));
    std::vector<std::uint8_t> const jpeg = seq::encode_jpeg(picture(camera), 95);
    folder.write(base + ".jpg", std::string(jpeg.begin(), jpeg.end()));
  }
  EXPECT_EQ(seq::sequence::open(folder.path()).load(0).left.width, image_width);
}

TEST(reader_euroc, rectifies_distorted_pairs_and_their_ground_truth) {
  temp_folder const folder;
  write_euroc(folder, 1);
  write_euroc_truth(folder);
  folder.write("mav0/cam0/sensor.yaml", sensor_text(0, "[-0.2, 0.02, 0.001, 0.0005]"));
  std::string const tilted =
      replaced(sensor_text(0.1, "[-0.2, 0.02, 0, 0]"), "0, 0, 1, 0.25", "0, 0, 1, 0.26");
  folder.write("mav0/cam1/sensor.yaml", tilted);
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_TRUE(s.rig().rectified());
  EXPECT_EQ(s.rig().left.model, seq::lens::pinhole);
  EXPECT_NEAR(s.rig().baseline(), std::hypot(0.1, 0.01), 1e-9);
  EXPECT_EQ(s.load(0).left.width, image_width);
  EXPECT_NE(s.load(0).left.pixels, picture(0).pixels);
  // The rig is turned by atan(0.01 / 0.1) about the camera's y; its centre stays.
  Eigen::Isometry3d body = Eigen::Isometry3d::Identity();
  body.linear() = Eigen::AngleAxisd(std::acos(0.0), Eigen::Vector3d::UnitZ()).toRotationMatrix();
  body.translation() = Eigen::Vector3d(0.1, 2, 3);
  Eigen::Isometry3d const pose = s.ground_truth().front().T_world_camera;
  EXPECT_LT((pose.matrix() - (body * s.rig().T_body_left).matrix()).norm(), 1e-7);
  EXPECT_LT((s.rig().T_body_left.translation() - Eigen::Vector3d(0.5, 0, 0.25)).norm(), 1e-9);
  Eigen::Vector3d const x_axis = s.rig().T_body_left.linear().col(0);
  EXPECT_LT((x_axis - Eigen::Vector3d(0, 0.1, 0.01).normalized()).norm(), 1e-9);
}

TEST(reader_euroc, fisheye_pairs_stay_or_become_pinholes) {
  temp_folder const folder;
  write_euroc(folder, 1);
  for (int camera = 0; camera < 2; ++camera) {
    folder.write("mav0/cam" + std::to_string(camera) + "/sensor.yaml",
                 sensor_text(0.1 * camera, "[0.01, 0.001, 0, 0]", "equidistant"));
  }
  seq::sequence const kept = seq::sequence::open(folder.path());
  EXPECT_TRUE(kept.fisheye());
  EXPECT_EQ(kept.rig().left.model, seq::lens::kannala_brandt);
  EXPECT_EQ(kept.load(0).left.pixels, picture(0).pixels);
  seq::open_options options;
  options.keep_fisheye = false;
  seq::sequence const rectified = seq::sequence::open(folder.path(), options);
  EXPECT_FALSE(rectified.fisheye());
  EXPECT_TRUE(rectified.rig().rectified());
}

TEST(reader_euroc, takes_camera_ground_truth_files) {
  temp_folder const folder;
  write_euroc(folder, 2);
  folder.write("poses.txt", "1 0 0 1 0 1 0 2 0 0 1 3\n1 0 0 2 0 0 -1 2 0 1 0 3\n");
  seq::sequence const poses = seq::sequence::open(folder.path());
  ASSERT_EQ(poses.ground_truth().size(), 2U);
  EXPECT_EQ(poses.ground_truth()[1].time_ns, stamp(1));
  EXPECT_TRUE(poses.ground_truth_has_orientation());
  folder.write("groundtruth.txt", "1 5 6 7 0 0 0 1\n2 5 6 8 0 0 0 1\n3 5 6 8 0 0 0 1\n");
  seq::sequence const tum = seq::sequence::open(folder.path("mav0"));
  ASSERT_EQ(tum.ground_truth().size(), 3U);
  EXPECT_FALSE(tum.ground_truth_has_orientation());
  EXPECT_EQ(tum.ground_truth()[0].T_world_camera.translation(), Eigen::Vector3d(5, 6, 7));
  write_euroc_truth(folder);
  EXPECT_EQ(seq::sequence::open(folder.path()).ground_truth().size(), 30U);
  folder.write("mav0/state_groundtruth_estimate0/data.csv", "#\n1,2,3\n");
  EXPECT_TRUE(contains(open_error(folder.path()), "data.csv:2: 3 fields"));
}

TEST(reader_euroc, motion_capture_of_the_body_is_ground_truth_as_well) {
  temp_folder const folder;
  write_euroc(folder, 3);
  write_euroc_truth(folder);
  seq::trajectory const euroc = seq::sequence::open(folder.path()).ground_truth();
  fs::remove_all(folder.path("mav0/state_groundtruth_estimate0"));
  write_euroc_truth(folder, "mocap0");
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_TRUE(s.ground_truth_has_orientation());
  ASSERT_EQ(s.ground_truth().size(), 30U);
  ASSERT_EQ(euroc.size(), 30U);
  for (std::size_t i = 0; i < euroc.size(); ++i) {
    EXPECT_EQ(s.ground_truth()[i].T_world_camera.matrix(), euroc[i].T_world_camera.matrix());
  }
}

TEST(reader_euroc, another_calibration_replaces_the_folders) {
  temp_folder const folder;
  write_euroc(folder, 1);
  write_euroc_truth(folder);
  seq::open_options options;
  options.calibration = folder.write(
      "orb.yaml",
      "%YAML:1.0\nCamera.type: Rectified\nCamera1.fx: 50\nCamera1.fy: 50\nCamera1.cx: 31\n"
      "Camera1.cy: 23\nStereo.b: 0.2\nCamera.width: 64\nCamera.height: 48\nCamera.fps: 20\n"
      "ORBextractor.nFeatures: 700\n");
  seq::sequence const s = seq::sequence::open(folder.path(), options);
  EXPECT_EQ(s.rig().left.fx, 50);
  EXPECT_EQ(s.rig().baseline(), 0.2);
  EXPECT_EQ(s.settings().features, 700);
  // The body frame comes from the folder: the file does not give it.
  EXPECT_EQ(s.rig().T_body_left.translation(), Eigen::Vector3d(0.5, 0, 0.25));
  options.calibration = folder.path("none.yaml");
  EXPECT_TRUE(contains(open_error(folder.path(), options), "none.yaml: no such file"));
  temp_folder const kitti;
  options.calibration = kitti.write("calib.txt", kitti_calib);
  EXPECT_EQ(seq::sequence::open(folder.path(), options).rig().left.fx, 40);
}

TEST(reader_kitti, opens_and_loads) {
  temp_folder const folder;
  write_kitti(folder, 4);
  folder.write("groundtruth.txt", "0.1 5 6 7 0 0 0 1\n0.0 5 6 8 0 0 0 1\n");
  seq::sequence s = seq::sequence::open(folder.path());
  EXPECT_EQ(s.layout(), "kitti");
  ASSERT_EQ(s.size(), 4);
  EXPECT_EQ(s.time_ns(3), 300'000'000);
  EXPECT_TRUE(s.rig().rectified());
  EXPECT_EQ(s.rig().left.width, image_width);
  EXPECT_NEAR(s.rig().baseline(), 0.1, 1e-12);
  EXPECT_EQ(s.load(2).right.pixels, picture(5).pixels);
  ASSERT_EQ(s.ground_truth().size(), 2U);
  EXPECT_EQ(s.ground_truth()[0].time_ns, 0);
  EXPECT_FALSE(s.ground_truth_has_orientation());
  seq::sequence moved = std::move(s);
  EXPECT_EQ(moved.size(), 4);
}

TEST(reader_kitti, poses_belong_to_frame_numbers) {
  temp_folder const folder;
  write_kitti(folder, 3);
  folder.write("poses.txt",
               "1 0 0 0 0 1 0 0 0 0 1 0\n0 0 1 1 0 1 0 0 -1 0 0 0\n1 0 0 2 0 1 0 0 0 0 1 0\n");
  fs::remove(folder.path("image_0/000001.png"));
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_EQ(s.size(), 2);
  EXPECT_EQ(s.time_ns(1), 200'000'000);
  ASSERT_EQ(s.ground_truth().size(), 3U);
  EXPECT_EQ(s.ground_truth()[2].time_ns, 200'000'000);
  EXPECT_TRUE(s.ground_truth_has_orientation());
  folder.write("poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n");
  EXPECT_TRUE(contains(open_error(folder.path()), "1 poses, must have one for each of 3"));
  folder.write("poses.txt", "1 0 0 0 0 1 0 0 0 0 1\n");
  EXPECT_TRUE(contains(open_error(folder.path()), "poses.txt:1: 11 numbers"));
  folder.write("poses.txt", "2 0 0 0 0 1 0 0 0 0 1 0\n");
  EXPECT_TRUE(contains(open_error(folder.path()), "poses.txt:1: not a rotation"));
}

// Colour cameras: 0.06 and 0.16 m to the right of the reference, which poses.txt is about.
TEST(reader_kitti, colour_images_have_their_own_projections) {
  temp_folder const folder;
  write_kitti(folder, 3);
  fs::rename(folder.path("image_0"), folder.path("image_2"));
  fs::rename(folder.path("image_1"), folder.path("image_3"));
  EXPECT_TRUE(contains(open_error(folder.path()), "P2"));
  folder.write("calib.txt", kitti_calib +
                                "P2: 50 0 31.5 -3.0 0 50 23.5 0 0 0 1 0\n"
                                "P3: 50 0 31.5 -8.0 0 50 23.5 0 0 0 1 0\n");
  folder.write("poses.txt",
               "1 0 0 0 0 1 0 0 0 0 1 0\n0 0 1 1 0 1 0 0 -1 0 0 0\n1 0 0 2 0 1 0 0 0 0 1 0\n");
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_EQ(s.layout(), "kitti");
  EXPECT_EQ(s.rig().left.fx, 50);
  EXPECT_NEAR(s.rig().baseline(), 0.1, 1e-12);
  EXPECT_EQ(s.load(2).right.pixels, picture(5).pixels);
  std::vector<Eigen::Vector3d> const expected{{0.06, 0, 0}, {1, 0, -0.06}, {2.06, 0, 0}};
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_LT((s.ground_truth()[i].T_world_camera.translation() - expected[i]).norm(), 1e-12);
  }
  // grey images are taken where there are both
  fs::create_directories(folder.path("image_0"));
  EXPECT_TRUE(contains(open_error(folder.path()), "image_0: no images"));
}

TEST(reader, counts_images_without_a_partner) {
  temp_folder const euroc;
  write_euroc(euroc, 6);
  EXPECT_EQ(seq::sequence::open(euroc.path()).unpaired().left, 0);
  EXPECT_EQ(seq::sequence::open(euroc.path()).unpaired().right, 0);
  auto const file = [&](int camera, int i) {
    return euroc.path("mav0/cam" + std::to_string(camera) + "/data/" + std::to_string(stamp(i)) +
                      ".png");
  };
  fs::remove(file(1, 1));  // listed by both
  fs::remove(file(0, 2));
  fs::remove(file(0, 3));
  fs::remove(file(1, 3));  // no image at all: nothing to count
  std::string const later = std::to_string(stamp(9));
  std::ofstream(euroc.path("mav0/cam1/data.csv"), std::ios::app)
      << later << "," << later << ".png\n";
  EXPECT_EQ(seq::sequence::open(euroc.path()).unpaired().right, 1);  // its file is not there
  fs::copy_file(file(1, 5), file(1, 9));
  seq::sequence const s = seq::sequence::open(euroc.path());
  EXPECT_EQ(s.size(), 3);
  EXPECT_EQ(s.unpaired().left, 1);
  EXPECT_EQ(s.unpaired().right, 2);

  temp_folder const kitti;
  write_kitti(kitti, 5);
  fs::remove(kitti.path("image_0/000001.png"));
  fs::remove(kitti.path("image_0/000002.png"));
  fs::remove(kitti.path("image_1/000003.png"));
  EXPECT_EQ(seq::sequence::open(kitti.path()).unpaired().left, 1);
  EXPECT_EQ(seq::sequence::open(kitti.path()).unpaired().right, 2);
}

TEST(reader, tells_a_missing_calibration_from_a_bad_one) {
  temp_folder const kitti;
  write_kitti(kitti, 1);
  kitti.write("calib.txt", "nonsense\n");
  try {
    seq::sequence::open(kitti.path());
    ADD_FAILURE() << "opened";
  } catch (seq::missing_calibration const& e) {
    ADD_FAILURE() << e.what();
  } catch (seq::error const& e) { EXPECT_TRUE(contains(e.what(), "P0")); }
  fs::remove(kitti.path("calib.txt"));
  EXPECT_THROW(seq::sequence::open(kitti.path()), seq::missing_calibration);
  EXPECT_TRUE(contains(open_error(kitti.path()), "calib.txt"));
  temp_folder const euroc;
  write_euroc(euroc, 1);
  EXPECT_TRUE(seq::sequence::open(euroc.path()).has_body_frame());
  fs::remove(euroc.path("mav0/cam1/sensor.yaml"));
  EXPECT_THROW(seq::sequence::open(euroc.path()), seq::missing_calibration);
  seq::open_options named;
  named.calibration = kitti.write("calib.txt", kitti_calib);
  EXPECT_EQ(seq::sequence::open(euroc.path(), named).size(), 1);
  EXPECT_FALSE(seq::sequence::open(kitti.path()).has_body_frame());
}

// Decoding and rectification: every thread gets what one thread alone gets.
TEST(reader, frames_are_loaded_by_several_threads) {
  constexpr int frames = 12;
  temp_folder const folder;
  write_euroc(folder, frames);
  folder.write("mav0/cam0/sensor.yaml", sensor_text(0, "[-0.2, 0.02, 0.001, 0.0005]"));
  seq::sequence const s = seq::sequence::open(folder.path());
  std::vector<seq::stereo_frame> expected;
  for (int i = 0; i < frames; ++i) { expected.push_back(s.load(i)); }
  std::vector<int> wrong(4, 0);
  std::vector<std::thread> threads;
  for (std::size_t t = 0; t < wrong.size(); ++t) {
    threads.emplace_back([&, t] {
      for (int i = 0; i < frames; ++i) {
        seq::stereo_frame const frame = s.load(i);
        auto const& e = expected[static_cast<std::size_t>(i)];
        wrong[t] += static_cast<int>(frame.left.pixels != e.left.pixels ||
                                     frame.right.pixels != e.right.pixels);
      }
    });
  }
  for (auto& thread : threads) { thread.join(); }
  EXPECT_EQ(wrong, std::vector<int>(4, 0));
}

TEST(reader, one_frame_is_enough) {
  temp_folder const kitti;
  write_kitti(kitti, 1);
  EXPECT_EQ(seq::sequence::open(kitti.path()).size(), 1);
  EXPECT_EQ(seq::sequence::open(kitti.path()).load(0).left.height, image_height);
  temp_folder const euroc;
  write_euroc(euroc, 1);
  EXPECT_EQ(seq::sequence::open(euroc.path()).size(), 1);
  EXPECT_TRUE(seq::sequence::open(euroc.path()).ground_truth().empty());
  EXPECT_FALSE(seq::sequence::open(euroc.path()).ground_truth_has_orientation());
}

TEST(reader, rejects_folders_that_hold_no_sequence) {
  temp_folder const folder;
  EXPECT_TRUE(contains(open_error(folder.path("none")), "none: no such folder"));
  EXPECT_TRUE(
      contains(open_error(folder.write("file", "x")), "file: a file; accepted are folders"));
  EXPECT_TRUE(contains(open_error(folder.write("a.mcap", "x")), "read by python -m ft track"));
  EXPECT_TRUE(contains(open_error(""), "no such folder"));
  EXPECT_TRUE(contains(open_error(folder.path()), "no sequence found; accepted"));
  folder.write("left/1.webp", "x");
  EXPECT_TRUE(contains(open_error(folder.path()), "no sequence found: images of the kind .webp"));
  fs::create_directories(folder.path("mav0"));
  EXPECT_TRUE(contains(open_error(folder.path()), "cam0: no such folder"));
}

TEST(reader, rejects_missing_cameras_and_images) {
  seq::open_options stereo;
  stereo.rig = seq::camera_kind::stereo;
  temp_folder const euroc;
  write_euroc(euroc, 2);
  fs::remove_all(euroc.path("mav0/cam1/data"));
  EXPECT_TRUE(contains(open_error(euroc.path()), "cam1 lists 2 images, 0 of them there"));
  euroc.write("mav0/cam1/data.csv", "#timestamp\n");
  EXPECT_TRUE(contains(open_error(euroc.path()), "lists no images"));
  euroc.write("mav0/cam1/data.csv", std::to_string(stamp(0) + 1) + ",a.png\n");
  EXPECT_TRUE(contains(open_error(euroc.path()), "no pair of images"));
  euroc.write("mav0/cam1/data.csv", "12.5s,a.png\n");
  EXPECT_TRUE(contains(open_error(euroc.path()), "data.csv:1: '12.5s'"));
  euroc.write("mav0/cam1/data.csv", "99999999999999999999,a.png\n");
  EXPECT_TRUE(contains(open_error(euroc.path()), "not a time stamp"));
  euroc.write("mav0/cam1/data.csv", "12\n");
  EXPECT_TRUE(contains(open_error(euroc.path()), "1 fields"));
  fs::remove(euroc.path("mav0/cam1/data.csv"));
  EXPECT_TRUE(contains(open_error(euroc.path()), "data.csv: no such file"));
  fs::remove_all(euroc.path("mav0/cam1"));
  EXPECT_TRUE(contains(open_error(euroc.path(), stereo), "not a stereo sequence"));

  temp_folder const kitti;
  write_kitti(kitti, 3);
  kitti.write("times.txt", "0\n0.1\n");
  EXPECT_TRUE(contains(open_error(kitti.path()), "2 times, none for"));
  kitti.write("times.txt", "0\n0.1\nnan\n");
  EXPECT_TRUE(contains(open_error(kitti.path()), "times.txt:3"));
  fs::remove(kitti.path("times.txt"));
  EXPECT_TRUE(contains(open_error(kitti.path()), "times.txt: no such file"));
  write_kitti(kitti, 3);
  for (char const* name : {"000000.png", "000001.png", "000002.png"}) {
    fs::remove(kitti.path(std::string("image_1/") + name));
  }
  EXPECT_TRUE(contains(open_error(kitti.path()), "image_1: no images"));
  seq::write_png(kitti.path("image_1/000077.png"), picture(0));
  EXPECT_TRUE(contains(open_error(kitti.path()), "no stereo pair"));
  fs::remove_all(kitti.path("image_1"));
  EXPECT_TRUE(contains(open_error(kitti.path(), stereo), "not a stereo sequence"));
}

TEST(reader, rejects_absurd_calibrations) {
  temp_folder const euroc;
  write_euroc(euroc, 1);
  struct bad_case {
    std::string from, to, expected;
  };
  for (bad_case const& c : std::vector<bad_case>{
           {"[40, 40,", "[0, 40,", "must be above 0"},
           {"[40, 40,", "[nan, 40,", "must be finite"},
           {"0.100000", "0", "baseline = 0 m"},
           {"0.100000", "-0.1", "swapped"},
           {"[64, 48]", "[64, 47]", "must be equal"},
       }) {
    euroc.write("mav0/cam1/sensor.yaml", replaced(sensor_text(0.1), c.from, c.to));
    std::string const message = open_error(euroc.path());
    EXPECT_TRUE(contains(message, c.expected)) << message;
    EXPECT_TRUE(contains(message, euroc.path())) << message;
  }
  for (int camera = 0; camera < 2; ++camera) {
    euroc.write("mav0/cam" + std::to_string(camera) + "/sensor.yaml",
                replaced(sensor_text(0.1 * camera), "[64, 48]", "[640, 480]"));
  }
  EXPECT_TRUE(contains(open_error(euroc.path()),
                       ".png: image is 64 x 48 pixels, the calibration has 640 x 480"));
  fs::remove(euroc.path("mav0/cam0/sensor.yaml"));
  EXPECT_TRUE(contains(open_error(euroc.path()), "cam0/sensor.yaml: no such file"));

  temp_folder const kitti;
  write_kitti(kitti, 1);
  kitti.write("calib.txt", replaced(kitti_calib, "-4.0", "0"));
  EXPECT_TRUE(contains(open_error(kitti.path()), "baseline = 0 m"));
  kitti.write("calib.txt", replaced(kitti_calib, "-4.0", "4.0"));
  EXPECT_TRUE(contains(open_error(kitti.path()), "swapped"));
  kitti.write("calib.txt", replaced(kitti_calib, "4e1", "-40"));
  EXPECT_TRUE(contains(open_error(kitti.path()), "must be above 0"));
  fs::remove(kitti.path("calib.txt"));
  EXPECT_TRUE(contains(open_error(kitti.path()), "calib.txt: no such file"));
}

TEST(reader, names_broken_and_changing_images) {
  temp_folder const folder;
  write_kitti(folder, 3);
  seq::write_png(folder.path("image_1/000001.png"), picture(0, 60, 48));
  truncate_file(folder.path("image_0/000002.png"));
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_NO_THROW(s.load(0));
  EXPECT_TRUE(contains(message_of([&] { s.load(1); }),
                       "image_1/000001.png: image is 60 x 48 pixels, the calibration has 64 x 48"));
  EXPECT_TRUE(contains(message_of([&] { s.load(2); }), "image_0/000002.png"));
  fs::remove(folder.path("image_0/000000.png"));
  EXPECT_TRUE(contains(message_of([&] { s.load(0); }), "image_0/000000.png"));
  folder.write("image_0/000000.png", "");
  EXPECT_TRUE(contains(open_error(folder.path()), "image_0/000000.png"));
  seq::write_png(folder.path("image_0/000000.png"), picture(0));
  seq::write_png(folder.path("image_1/000000.png"), picture(0, 64, 40));
  EXPECT_TRUE(contains(open_error(folder.path()), "image is 64 x 40"));
}

TEST(reader_generated, a_written_sequence_is_read_back) {
  for (seq::rig_kind const kind : {seq::rig_kind::pinhole, seq::rig_kind::fisheye}) {
    seq::generator_options options;
    options.rig = kind;
    options.width = 96;
    options.frames = 3;
    options.threads = 1;
    seq::generator const source(options);
    temp_folder const folder;
    seq::write_asl(source, folder.path("generated"));
    seq::sequence const s = seq::sequence::open(folder.path("generated"));
    ASSERT_EQ(s.size(), 3);
    EXPECT_EQ(s.fisheye(), kind == seq::rig_kind::fisheye);
    EXPECT_NEAR(s.rig().baseline(), source.rig().baseline(), 1e-9);
    EXPECT_NEAR(s.rig().left.fx, source.rig().left.fx, 1e-6);
    EXPECT_EQ(s.rig().left.model, source.rig().left.model);
    for (int i = 0; i < 3; ++i) {
      EXPECT_EQ(s.time_ns(i), source.time_ns(i));
      seq::stereo_frame const written = source.render(i);
      seq::stereo_frame const read = s.load(i);
      EXPECT_EQ(read.left.pixels, written.left.pixels);
      EXPECT_EQ(read.right.pixels, written.right.pixels);
      bool found = false;
      for (seq::stamped_pose const& pose : s.ground_truth()) {
        if (pose.time_ns == s.time_ns(i)) {
          found = true;
          EXPECT_LT((pose.T_world_camera.matrix() - source.T_world_camera(i).matrix()).norm(),
                    1e-5);
        }
      }
      EXPECT_TRUE(found);
    }
  }
}

TEST(reader_real, kitti_drive) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  seq::sequence const s = seq::sequence::open(shared + "/data/kitti_0926_stereo/");
  EXPECT_EQ(s.name(), "kitti_0926_stereo");
  EXPECT_EQ(s.layout(), "kitti");
  EXPECT_EQ(s.size(), 60);
  EXPECT_TRUE(s.rig().rectified());
  EXPECT_NEAR(s.rig().baseline(), 0.53717, 1e-4);
  EXPECT_EQ(s.ground_truth().size(), 60U);
  EXPECT_FALSE(s.ground_truth_has_orientation());
  EXPECT_EQ(s.time_ns(59), 5'900'000'000);
  seq::stereo_frame const frame = s.load(59);
  EXPECT_EQ(frame.left.width, 1392);
  EXPECT_EQ(frame.right.height, 512);
}

TEST(reader_real, euroc_pairs) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  seq::sequence const s = seq::sequence::open(shared + "/data/euroc_v101_stereo_start");
  EXPECT_EQ(s.size(), 16);
  EXPECT_TRUE(s.rig().rectified());
  EXPECT_EQ(s.rig().fps, 20);
  EXPECT_EQ(s.ground_truth().size(), 593U);
  EXPECT_TRUE(s.ground_truth_has_orientation());
  EXPECT_EQ(s.load(15).left.width, 752);
  // The camera is 7 cm from the body's origin.
  Eigen::Vector3d const position = s.ground_truth().front().T_world_camera.translation();
  EXPECT_LT((position - Eigen::Vector3d(0.878612, 2.142470, 0.947262)).norm(), 0.08);

  seq::sequence const sparse = seq::sequence::open(shared + "/data/euroc_v101_stereo_sparse");
  EXPECT_EQ(sparse.size(), 25);
  EXPECT_FALSE(sparse.ground_truth().empty());
  EXPECT_EQ(sparse.load(24).right.height, 480);
  seq::open_options pair;
  pair.rig = seq::camera_kind::stereo;
  std::string const flight = shared + "/data/euroc_v101_mono_flight";
  EXPECT_TRUE(contains(open_error(flight, pair), "not a stereo sequence"));
  EXPECT_EQ(seq::sequence::open(flight).kind(), seq::camera_kind::mono);
}

TEST(reader_real, euroc_imu) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  seq::open_options options;
  options.read_imu = true;
  seq::sequence const s = seq::sequence::open(shared + "/data/euroc_v101_stereo_start", options);
  ASSERT_TRUE(s.imu());
  seq::imu_recording const& imu = *s.imu();
  EXPECT_EQ(imu.samples.size(), 751U);
  EXPECT_EQ(imu.calibration.noise.gyro, 1.6968e-4);
  // Seen in the world, the mean specific force of a slow flight points up.
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  int count = 0;
  std::size_t next = 0;
  for (auto const& pose : s.ground_truth()) {
    while (next < imu.samples.size() && imu.samples[next].time_ns < pose.time_ns) { ++next; }
    if (next == imu.samples.size()) { break; }
    sum += pose.T_world_camera.linear() * imu.T_imu_left.linear().transpose() *
           imu.samples[next].accel;
    ++count;
  }
  EXPECT_GT(count, 500);
  EXPECT_LT((sum / count - Eigen::Vector3d(0, 0, 9.81)).norm(), 0.5);
}

TEST(reader_real, fisheye_pairs_with_a_settings_file) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  seq::open_options options;
  options.calibration = shared + "/golden/t265_kb8/settings.yaml";
  std::string const folder = shared + "/data/t265_kapture_stereo";
  seq::sequence const s = seq::sequence::open(folder, options);
  EXPECT_TRUE(s.fisheye());
  EXPECT_EQ(s.size(), 3);
  EXPECT_EQ(s.settings().features, 1000);
  EXPECT_EQ(s.load(2).left.width, 848);
  EXPECT_TRUE(contains(open_error(folder), "cam0/sensor.yaml: no such file"));
  options.keep_fisheye = false;
  EXPECT_TRUE(seq::sequence::open(folder, options).rig().rectified());
  options.calibration = shared + "/golden/kb8_overlap/settings.yaml";
  EXPECT_TRUE(contains(open_error(folder, options), "the calibration has 512 x 512"));
}

/// Whether one of the sentences has all parts.
bool said(std::vector<std::string> const& warnings, std::vector<std::string> const& parts) {
  return std::any_of(warnings.begin(), warnings.end(), [&](std::string const& warning) {
    return std::all_of(parts.begin(), parts.end(),
                       [&](std::string const& part) { return contains(warning, part); });
  });
}

/// A list of EuRoC images named by their number.
std::string image_list(std::vector<std::string> const& stamps) {
  std::string csv = "#timestamp [ns],filename\n";
  for (std::size_t i = 0; i < stamps.size(); ++i) {
    csv += stamps[i] + "," + std::to_string(stamp(static_cast<int>(i))) + ".png\n";
  }
  return csv;
}

TEST(reader_one_camera, euroc_without_the_second_one) {
  temp_folder const folder;
  write_euroc(folder, 3);
  write_euroc_truth(folder);
  seq::open_options one;
  one.rig = seq::camera_kind::mono;
  seq::sequence const of_pair = seq::sequence::open(folder.path(), one);
  fs::remove_all(folder.path("mav0/cam1"));
  seq::sequence const s = seq::sequence::open(folder.path());
  for (seq::sequence const* q : {&of_pair, &s}) {
    EXPECT_EQ(q->kind(), seq::camera_kind::mono);
    ASSERT_EQ(q->size(), 3);
    EXPECT_EQ(q->load(1).left.pixels, picture(2).pixels);
    EXPECT_TRUE(q->load(1).right.pixels.empty());
    EXPECT_EQ(q->rig().left.fx, 40);
    EXPECT_EQ(q->rig().baseline(), 0);
    EXPECT_EQ(q->warnings(), std::vector<std::string>{});
    EXPECT_TRUE(q->ground_truth_has_orientation());
  }
  one.rig = seq::camera_kind::rgbd;
  EXPECT_TRUE(contains(open_error(folder.path(), one), "no depth images"));
  fs::remove(folder.path("mav0/cam0/data/" + std::to_string(stamp(1)) + ".png"));
  seq::sequence const hole = seq::sequence::open(folder.path());
  EXPECT_EQ(hole.size(), 2);
  EXPECT_TRUE(said(hole.warnings(), {"cam0", "1 of the listed images are not there"}));
}

TEST(reader_one_camera, its_distortion_goes_on_load) {
  temp_folder const folder;
  write_euroc(folder, 1);
  fs::remove_all(folder.path("mav0/cam1"));
  folder.write("mav0/cam0/sensor.yaml", sensor_text(0, "[-0.2, 0.02, 0.001, 0.0005]"));
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_EQ(s.rig().left.model, seq::lens::pinhole);
  EXPECT_EQ(s.load(0).left.width, image_width);
  // A point that the raw camera sees is where the pinhole of the loaded images sees it.
  seq::camera_intrinsics raw = s.rig().left;
  raw.model = seq::lens::radial_tangential;
  raw.distortion = {-0.2, 0.02, 0.001, 0.0005};
  raw.fx = raw.fy = 40;
  raw.cx = 31.5;
  raw.cy = 23.5;
  seq::image dot{image_width, image_height,
                 std::vector<std::uint8_t>(image_width * image_height, 0)};
  Eigen::Vector3d const point(0.35, -0.2, 1);
  auto const at = seq::lens_projection(raw)(point).pixel;
  dot.row(static_cast<int>(std::lround(at.y())))[std::lround(at.x())] = 255;
  seq::write_png(folder.path("mav0/cam0/data/" + std::to_string(stamp(0)) + ".png"), dot);
  seq::image const loaded = s.load(0).left;
  auto const brightest = std::max_element(loaded.pixels.begin(), loaded.pixels.end());
  auto const i = static_cast<int>(brightest - loaded.pixels.begin());
  auto const expected = seq::lens_projection(s.rig().left)(point).pixel;
  EXPECT_NEAR(i % image_width, expected.x(), 1.2);
  EXPECT_NEAR(i / image_width, expected.y(), 1.2);
}

TEST(reader_one_camera, fisheye_stays_or_becomes_a_pinhole) {
  temp_folder const folder;
  write_euroc(folder, 1);
  fs::remove_all(folder.path("mav0/cam1"));
  folder.write("mav0/cam0/sensor.yaml",
               sensor_text(0, "[0.01, 0.002, 0.001, 0.0005]", "equidistant"));
  EXPECT_TRUE(seq::sequence::open(folder.path()).fisheye());
  seq::open_options pinhole;
  pinhole.keep_fisheye = false;
  seq::sequence const s = seq::sequence::open(folder.path(), pinhole);
  EXPECT_FALSE(s.fisheye());
  EXPECT_EQ(s.rig().left.model, seq::lens::pinhole);
}

TEST(reader_one_camera, kitti) {
  temp_folder const folder;
  write_kitti(folder, 3);
  fs::remove_all(folder.path("image_1"));
  folder.write("calib.txt", kitti_calib.substr(0, kitti_calib.find("P1:")));
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_EQ(s.kind(), seq::camera_kind::mono);
  ASSERT_EQ(s.size(), 3);
  EXPECT_EQ(s.load(2).left.pixels, picture(4).pixels);
  EXPECT_EQ(s.unpaired().left, 0);
}

TEST(reader_stamps, cameras_are_paired_by_the_nearest_time) {
  temp_folder const folder;
  write_euroc(folder, 6);
  auto const shifted = [](std::vector<std::int64_t> const& by_ns) {
    std::vector<std::string> stamps;
    for (std::size_t i = 0; i < by_ns.size(); ++i) {
      stamps.push_back(std::to_string(stamp(static_cast<int>(i)) + by_ns[i]));
    }
    return image_list(stamps);
  };
  auto const open = [&](std::vector<std::int64_t> const& by_ns) {
    folder.write("mav0/cam1/data.csv", shifted(by_ns));
    return seq::sequence::open(folder.path());
  };
  for (auto const& by_ns : {std::vector<std::int64_t>(6, 12'000),
                            std::vector<std::int64_t>{0, 1'000, 2'000, 0, -1'000, -2'000},
                            std::vector<std::int64_t>(6, 1'000'000)}) {
    seq::sequence const s = open(by_ns);
    ASSERT_EQ(s.size(), 6);
    EXPECT_EQ(s.time_ns(3), stamp(3));
    EXPECT_EQ(s.load(3).right.pixels, picture(7).pixels);
    EXPECT_TRUE(said(s.warnings(), {"time stamps differ"}));
  }
  EXPECT_TRUE(said(open(std::vector<std::int64_t>(6, 12'000)).warnings(), {"0.012 ms after cam0"}));
  EXPECT_EQ(open(std::vector<std::int64_t>(6, 0)).warnings(), std::vector<std::string>{});
  seq::sequence const some = open({0, 1'000'001, 0, 0, 0, -3'000'000});
  EXPECT_EQ(some.size(), 4);
  EXPECT_EQ(some.unpaired().left, 2);
  EXPECT_EQ(some.unpaired().right, 2);
  folder.write("mav0/cam1/data.csv", shifted(std::vector<std::int64_t>(6, 5'000'000)));
  std::string const message = open_error(folder.path());
  EXPECT_TRUE(contains(message, "5 ms apart, at most 1 ms")) << message;
  seq::open_options wide;
  wide.max_time_difference_ns = 5'000'000;
  EXPECT_EQ(seq::sequence::open(folder.path(), wide).size(), 6);
  wide.max_time_difference_ns = 10'000'000'000;  // no image is in two pairs
  EXPECT_EQ(seq::sequence::open(folder.path(), wide).size(), 6);
  wide.max_time_difference_ns = -1;
  EXPECT_TRUE(contains(open_error(folder.path(), wide), "max_time_difference_ns = -1"));
  wide.max_time_difference_ns = 0;
  EXPECT_TRUE(contains(open_error(folder.path(), wide), "at most 0 ms"));
}

TEST(reader_stamps, doubled_and_disordered_images) {
  temp_folder const folder;
  write_euroc(folder, 4);
  auto const at = [](int i) { return std::to_string(stamp(i)); };
  folder.write("mav0/cam0/data.csv", image_list({at(0), at(1), at(1), at(3)}));
  seq::sequence const doubled = seq::sequence::open(folder.path());
  ASSERT_EQ(doubled.size(), 3);
  EXPECT_EQ(doubled.load(1).left.pixels, picture(2).pixels) << "the first of two lines";
  EXPECT_TRUE(said(doubled.warnings(), {"cam0/data.csv: 1 line of 4 images left out", at(1)}));
  EXPECT_EQ(doubled.unpaired().right, 1);
  std::string const csv = image_list({at(0), at(1), at(2), at(3)});
  std::string const line1 = at(1) + "," + at(1) + ".png\n";
  folder.write("mav0/cam0/data.csv", replaced(csv, line1, "") + line1);
  seq::sequence const moved = seq::sequence::open(folder.path());
  ASSERT_EQ(moved.size(), 4);
  EXPECT_EQ(moved.time_ns(1), stamp(1));
  EXPECT_EQ(moved.load(1).left.pixels, picture(2).pixels);
  EXPECT_TRUE(said(moved.warnings(), {"1 line of 4 images out of order"}));

  temp_folder const kitti;
  write_kitti(kitti, 4);
  kitti.write("times.txt", "0\n0.1\n0.1\n0.3\n");
  kitti.write("poses.txt",
              "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n"
              "1 0 0 2 0 1 0 0 0 0 1 0\n1 0 0 3 0 1 0 0 0 0 1 0\n");
  seq::sequence const s = seq::sequence::open(kitti.path());
  ASSERT_EQ(s.size(), 3);
  EXPECT_EQ(s.load(2).left.pixels, picture(6).pixels);
  ASSERT_EQ(s.ground_truth().size(), 3U);
  EXPECT_EQ(s.ground_truth()[2].T_world_camera.translation().x(), 3);
  EXPECT_TRUE(said(s.warnings(), {"times.txt: 1 line of 4 frames left out"}));
}

TEST(reader_stamps, doubled_and_disordered_truth) {
  temp_folder const folder;
  write_euroc(folder, 3);
  folder.write("groundtruth.txt",
               "1403715273.2 0 0 0 0 0 0 1\n1403715273.3 1 0 0 0 0 0 1\n"
               "1403715273.3 9 0 0 0 0 0 1\n1403715273.2500 0.5 0 0 0 0 0 1\n");
  seq::sequence const s = seq::sequence::open(folder.path());
  ASSERT_EQ(s.ground_truth().size(), 3U);
  EXPECT_EQ(s.ground_truth()[1].T_world_camera.translation().x(), 0.5);
  EXPECT_EQ(s.ground_truth()[2].T_world_camera.translation().x(), 1);
  EXPECT_TRUE(said(s.warnings(), {"groundtruth.txt: 1 line of 4 poses left out"}));
  EXPECT_TRUE(said(s.warnings(), {"1 line of 4 poses out of order"}));
  fs::remove(folder.path("groundtruth.txt"));
  write_euroc_truth(folder);
  std::ofstream(folder.path("mav0/state_groundtruth_estimate0/data.csv"), std::ios::app)
      << stamp(0) + 100'000'000 << ",7,7,7,1,0,0,0\n";
  seq::sequence const again = seq::sequence::open(folder.path());
  EXPECT_EQ(again.ground_truth().size(), 30U);
  EXPECT_TRUE(said(again.warnings(), {"1 line of 31 poses left out"}));
}

TEST(reader_stamps, units_are_told_apart) {
  temp_folder const folder;
  write_euroc(folder, 3);
  struct unit {
    std::string name;
    std::int64_t ns;
  };
  for (unit const& u : {unit{"microseconds", 1'000}, unit{"milliseconds", 1'000'000}}) {
    std::vector<std::string> stamps;
    for (int i = 0; i < 3; ++i) { stamps.push_back(std::to_string(stamp(i) / u.ns)); }
    for (int camera = 0; camera < 2; ++camera) {
      folder.write("mav0/cam" + std::to_string(camera) + "/data.csv", image_list(stamps));
    }
    seq::sequence const s = seq::sequence::open(folder.path());
    ASSERT_EQ(s.size(), 3);
    EXPECT_EQ(s.time_ns(2), stamp(2) / u.ns * u.ns) << u.name;
    EXPECT_TRUE(said(s.warnings(), {"cam0/data.csv", "read as " + u.name})) << u.name;
  }
  std::string const in_seconds =
      image_list({"1403715273.262142976", "1403715273.312142976", "1403715273.362142976"});
  folder.write("mav0/cam0/data.csv", in_seconds);
  folder.write("mav0/cam1/data.csv", in_seconds);
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_EQ(s.time_ns(1), stamp(1));
  EXPECT_EQ(s.warnings(), std::vector<std::string>{});
  for (char const* other : {"1403715273262142976", "5", "1403715273262"}) {
    folder.write("mav0/cam0/data.csv", image_list({"1403715273.262142976", other}));
    EXPECT_TRUE(contains(open_error(folder.path()), "data.csv:3: time stamp " + std::string(other) +
                                                        " has no decimal point, unlike others"));
  }
  folder.write("mav0/cam0/data.csv", image_list({"1403715273262.5"}));
  EXPECT_TRUE(contains(open_error(folder.path()), "beyond the limit of 4.6e9 seconds"));
}

TEST(reader_stamps, whole_seconds_stand_among_decimals) {
  temp_folder const folder;
  write_euroc(folder, 4);
  for (auto const& stamps : {std::vector<std::string>{"0", "0.05", "0.1", "1"},
                             {"0", "5e-2", "1e-1", "1"},
                             {"0.0", "0.05", "1E-1", "1"}}) {
    for (char const* camera : {"cam0", "cam1"}) {
      folder.write("mav0/" + std::string(camera) + "/data.csv", image_list(stamps));
    }
    seq::sequence const s = seq::sequence::open(folder.path());
    ASSERT_EQ(s.size(), 4);
    EXPECT_EQ(s.time_ns(0), 0);
    EXPECT_EQ(s.time_ns(1), 50'000'000);
    EXPECT_EQ(s.time_ns(2), 100'000'000);
    EXPECT_EQ(s.time_ns(3), 1'000'000'000);
    for (std::string const& said : s.warnings()) { EXPECT_FALSE(contains(said, "read as")); }
  }
}

TEST(reader_stamps, times_that_are_not_those_of_the_images_are_said) {
  temp_folder const folder;
  write_euroc(folder, 3);
  folder.write("groundtruth.txt", "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n");
  EXPECT_TRUE(said(seq::sequence::open(folder.path()).warnings(),
                   {"ground truth and images have no time in common: the former ends ",
                    " s before the first image"}));
  temp_folder const kitti;
  write_kitti(kitti, 3);
  kitti.write("times.txt", "0\n103\n207\n");
  EXPECT_TRUE(said(seq::sequence::open(kitti.path()).warnings(),
                   {"frames are 104 s apart", "another unit"}));
}

/// 100 samples at a rate, from the first image on.
std::string imu_at(double rate_hz, double accel, double gyro = 0.01) {
  std::string text = "#timestamp [ns],w,w,w,a,a,a\n";
  for (int i = 0; i < 100; ++i) {
    text += std::to_string(stamp(0) + std::llround(1e9 * i / rate_hz)) + "," +
            std::to_string(gyro) + ",0,0,0,0," + std::to_string(accel) + "\n";
  }
  return text;
}

TEST(reader_imu, rate_and_units_are_checked) {
  temp_folder const folder;
  write_euroc(folder, 3);
  folder.write("mav0/imu0/sensor.yaml", imu_sensor_text);
  seq::open_options options;
  options.read_imu = true;
  auto const warnings = [&](std::string const& samples) {
    folder.write("mav0/imu0/data.csv", samples);
    return seq::sequence::open(folder.path(), options).warnings();
  };
  EXPECT_EQ(warnings(imu_at(200, 9.8)), std::vector<std::string>{});
  EXPECT_EQ(warnings(imu_at(190, 9.8)), std::vector<std::string>{});
  EXPECT_TRUE(said(warnings(imu_at(50, 9.8)), {"come at 50 Hz, rate_hz says 200"}));
  EXPECT_TRUE(said(warnings(imu_at(1000, 9.8)), {"come at 1000 Hz, rate_hz says 200"}));
  EXPECT_TRUE(said(warnings(imu_at(200, 0.99)), {"measures 0.99 m/s^2", "in g?"}));
  EXPECT_TRUE(said(warnings(imu_at(200, 9810)), {"measures 9810 m/s^2"}));
  EXPECT_TRUE(said(warnings(imu_at(200, 9.8, 20)), {"20 rad/s", "degrees per second?"}));
}

TEST(reader_imu, doubled_and_disordered_lines_are_left_out) {
  temp_folder const folder;
  std::string const text = imu_at(200, 9.8);
  std::vector<std::string> warnings;
  auto const read = [&](std::string const& samples) {
    warnings.clear();
    return seq::read_imu_samples(folder.write("data.csv", samples), &warnings);
  };
  EXPECT_EQ(read(text).size(), 100U);
  EXPECT_EQ(warnings, std::vector<std::string>{});
  auto const line = [&](int i) {
    std::string const key = std::to_string(stamp(0) + i * std::int64_t{5'000'000}) + ",";
    std::size_t const at = text.find(key);
    return text.substr(at, text.find('\n', at) + 1 - at);
  };
  auto const check = [&](std::string const& samples, std::size_t expected) {
    auto const taken = read(samples);
    EXPECT_EQ(taken.size(), expected);
    EXPECT_TRUE(said(warnings, {"data.csv: ", "left out"}));
    for (std::size_t i = 1; i < taken.size(); ++i) {
      EXPECT_LT(taken[i - 1].time_ns, taken[i].time_ns);
    }
  };
  check(replaced(text, line(30), line(30) + line(30)), 100);
  check(replaced(text, line(30) + line(31), line(31) + line(30)), 99);
  check(text + line(3), 100);
  // one stamp far ahead costs one line, not all that follow
  check(replaced(text, line(30), "9000000000000000000" + line(30).substr(19)), 99);
  EXPECT_EQ(seq::read_imu_samples(folder.write("data.csv", text + line(3))).size(), 100U);
}

// ---- TUM RGB-D

seq::depth_image depth_picture(int seed) {
  seq::depth_image depth{image_width, image_height, {}};
  for (int i = 0; i < image_width * image_height; ++i) {
    depth.pixels.push_back(static_cast<std::uint16_t>(1500 + (i * 7 + seed * 31) % 1000));
  }
  return depth;
}

/// Colour and depth images at 30 Hz, the depth ones 5 ms later.
void write_tum(temp_folder const& folder, int count) {
  std::string rgb = "# timestamp filename\n";
  std::string depth = rgb;
  fs::create_directories(folder.path("rgb"));
  fs::create_directories(folder.path("depth"));
  for (int i = 0; i < count; ++i) {
    char time[32];
    std::snprintf(time, sizeof time, "%.6f", 1311868229.5 + i / 30.0);
    rgb += std::string(time) + " rgb/" + std::to_string(i) + ".png\n";
    std::snprintf(time, sizeof time, "%.6f", 1311868229.505 + i / 30.0);
    depth += std::string(time) + " depth/" + std::to_string(i) + ".png\n";
    seq::write_png(folder.path("rgb/" + std::to_string(i) + ".png"), picture(i));
    seq::write_depth_png(folder.path("depth/" + std::to_string(i) + ".png"), depth_picture(i));
  }
  folder.write("rgb.txt", rgb);
  folder.write("depth.txt", depth);
  folder.write("camera.txt", "# depth in units of 1 mm\n40 40 31.5 23.5\n");
  folder.write("groundtruth.txt", "1311868229.5 0 0 0 0 0 0 1\n1311868229.6 1 0 0 0 0 0.6 0.8\n");
}

TEST(reader_tum, opens_colour_and_depth) {
  temp_folder const folder;
  write_tum(folder, 4);
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_EQ(s.layout(), "tum");
  EXPECT_EQ(s.kind(), seq::camera_kind::rgbd);
  ASSERT_EQ(s.size(), 4);
  EXPECT_EQ(s.depth_unit(), 0.001);
  EXPECT_EQ(s.rig().baseline(), 0.08);
  EXPECT_EQ(s.load(2).left.pixels, picture(2).pixels);
  EXPECT_EQ(s.load(2).depth.pixels, depth_picture(2).pixels);
  EXPECT_TRUE(s.load(2).right.pixels.empty());
  EXPECT_EQ(s.ground_truth().size(), 2U);
  EXPECT_TRUE(s.ground_truth_has_orientation());
  EXPECT_EQ(s.warnings(), std::vector<std::string>{});
  seq::open_options one;
  one.rig = seq::camera_kind::mono;
  EXPECT_EQ(seq::sequence::open(folder.path(), one).kind(), seq::camera_kind::mono);
  EXPECT_EQ(seq::sequence::open(folder.path(), one).depth_unit(), 0);
  fs::remove(folder.path("depth.txt"));
  EXPECT_EQ(seq::sequence::open(folder.path()).kind(), seq::camera_kind::mono);
  one.rig = seq::camera_kind::rgbd;
  EXPECT_TRUE(contains(open_error(folder.path(), one), "accepted are rgb.txt with depth.txt"));
  one.rig = seq::camera_kind::stereo;
  EXPECT_TRUE(contains(open_error(folder.path(), one), "no second camera"));
}

TEST(reader_tum, pairs_within_20_ms) {
  temp_folder const folder;
  write_tum(folder, 3);
  std::ofstream(folder.path("rgb.txt"), std::ios::app) << "1311868230.0 rgb/0.png\n";
  std::ofstream(folder.path("depth.txt"), std::ios::app) << "1311868230.025 depth/0.png\n";
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_EQ(s.size(), 3);
  EXPECT_EQ(s.unpaired().left, 1);
  EXPECT_EQ(s.unpaired().right, 1);
  seq::open_options options;
  options.max_time_difference_ns = 25'000'000;
  EXPECT_EQ(seq::sequence::open(folder.path(), options).size(), 4);
  options.max_time_difference_ns = 1'000'000;
  EXPECT_TRUE(contains(open_error(folder.path(), options), "5 ms apart, at most 1 ms"));
}

TEST(reader_tum, associations_are_taken_in_either_order) {
  temp_folder const folder;
  write_tum(folder, 3);
  for (char const* text : {"10.0 rgb/0.png 10.0 depth/1.png\n10.1 rgb/2.png 10.11 depth/2.png\n",
                           "10.0 depth/1.png 10.0 rgb/0.png\n10.11 depth/2.png 10.1 rgb/2.png\n"}) {
    folder.write("associations.txt", text);
    seq::sequence const s = seq::sequence::open(folder.path());
    ASSERT_EQ(s.size(), 2);
    EXPECT_EQ(s.time_ns(1), 10'100'000'000);
    EXPECT_EQ(s.load(0).left.pixels, picture(0).pixels);
    EXPECT_EQ(s.load(0).depth.pixels, depth_picture(1).pixels);
  }
  folder.write("associations.txt",
               "10.0 rgb/0.png 10.0 depth/0.png\n10.1 rgb/1.png 10.2 depth/1.png\n"
               "10.0 rgb/2.png 10.0 depth/2.png\n10.3 rgb/9.png 10.3 depth/2.png\n");
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_EQ(s.size(), 1);
  EXPECT_TRUE(said(s.warnings(), {"1 pairs left out: up to 100 ms apart, at most 20 ms"}));
  EXPECT_TRUE(said(s.warnings(), {"1 line of 3 pairs left out"}));
  EXPECT_EQ(s.unpaired().right, 1);
  folder.write("associations.txt", "10.0 rgb/0.png 10.0\n");
  EXPECT_TRUE(contains(open_error(folder.path()), "associations.txt:1: 3 words, must have 4"));
  folder.write("associations.txt", "1e300 rgb/0.png 10.0 depth/0.png\n");
  EXPECT_TRUE(contains(open_error(folder.path()), "beyond the limit"));
}

TEST(reader_tum, the_depth_unit_is_given_or_assumed_or_doubted) {
  temp_folder const folder;
  write_tum(folder, 2);
  seq::open_options options;
  options.depth_unit = 0.0005;
  EXPECT_EQ(seq::sequence::open(folder.path(), options).depth_unit(), 0.0005);
  EXPECT_EQ(seq::sequence::open(folder.path(), options).depth_unit_from(), "as asked for");
  folder.write("camera.txt", "40 40 31.5 23.5\n");
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_EQ(s.depth_unit(), 1.0 / 5000);
  EXPECT_TRUE(contains(s.depth_unit_from(), "assumed"));
  for (double const unit : {1.0, 1e-6}) {
    options.depth_unit = unit;
    EXPECT_TRUE(said(seq::sequence::open(folder.path(), options).warnings(),
                     {"the median depth is", "is the unit another one?"}));
  }
  for (double const unit : {-1.0, 1e-12, 1e6, std::nan("")}) {
    options.depth_unit = unit;
    EXPECT_TRUE(contains(open_error(folder.path(), options), "depth_unit = "));
  }
  options = {};
  options.calibration = folder.write(
      "elsewhere/s.yaml",
      "%YAML:1.0\nCamera.type: PinHole\nCamera1.fx: 40\nCamera1.fy: 40\nCamera1.cx: 31.5\n"
      "Camera1.cy: 23.5\nStereo.b: 0.1\nRGBD.DepthMapFactor: 2000\n");
  EXPECT_EQ(seq::sequence::open(folder.path(), options).depth_unit(), 1.0 / 2000);
  EXPECT_EQ(seq::sequence::open(folder.path(), options).rig().baseline(), 0.1);
  fs::remove(folder.path("camera.txt"));
  EXPECT_THROW(seq::sequence::open(folder.path()), seq::missing_calibration);
}

TEST(reader_tum, depth_images_of_another_kind_are_named) {
  temp_folder const folder;
  write_tum(folder, 2);
  seq::write_png(folder.path("depth/0.png"), picture(0));
  EXPECT_TRUE(contains(open_error(folder.path()), "1 channels with 8 bits"));
  seq::write_depth_png(folder.path("depth/0.png"), {2, 2, {1, 2, 3, 4}});
  EXPECT_TRUE(contains(open_error(folder.path()), "2 x 2 pixels, the camera's images 64 x 48"));
  seq::write_depth_png(folder.path("depth/0.png"), depth_picture(0));
  truncate_file(folder.path("depth/1.png"));
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_TRUE(contains(message_of([&] { s.load(1); }), "depth/1.png"));
  seq::write_depth_png(
      folder.path("depth/0.png"),
      {image_width, image_height, std::vector<std::uint16_t>(image_width * image_height, 0)});
  EXPECT_TRUE(said(seq::sequence::open(folder.path()).warnings(), {"no pixel has a depth"}));
}

TEST(reader_tum, depth_moves_with_a_distorted_image) {
  temp_folder const folder;
  write_tum(folder, 1);
  folder.write("camera.txt", "# depth in units of 1 mm\n40 40 31.5 23.5 -0.2 0.02 0.001 0.0005\n");
  // Grey and depth have an edge at the same column, which stays the same after the lens is undone.
  seq::image grey{image_width, image_height, {}};
  seq::depth_image depth{image_width, image_height, {}};
  for (int i = 0; i < image_width * image_height; ++i) {
    bool const right = i % image_width >= 50;
    grey.pixels.push_back(right ? 200 : 0);
    depth.pixels.push_back(right ? 3000 : 1000);
  }
  seq::write_png(folder.path("rgb/0.png"), grey);
  seq::write_depth_png(folder.path("depth/0.png"), depth);
  seq::sequence const s = seq::sequence::open(folder.path());
  seq::stereo_frame const frame = s.load(0);
  int wrong = 0;
  for (std::size_t i = 0; i < frame.depth.pixels.size(); ++i) {
    std::uint16_t const d = frame.depth.pixels[i];
    EXPECT_TRUE(d == 1000 || d == 3000) << "no mean of two depths: " << d;
    wrong += static_cast<int>((frame.left.pixels[i] > 100) != (d == 3000));
  }
  EXPECT_LE(wrong, image_height);
  EXPECT_NE(frame.depth.pixels, depth.pixels);
}

TEST(reader_real, ground_truth_with_a_doubled_stamp) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  std::string const file = shared + "/cases/tum_duplicate_stamp/groundtruth.txt";
  if (!fs::exists(file)) { GTEST_SKIP() << "no " << file; }
  std::vector<std::string> warnings;
  EXPECT_EQ(seq::read_tum(file, &warnings).size(), 15U);
  EXPECT_TRUE(said(warnings, {"1 line of 16 poses left out"}));
}

TEST(reader_real, one_camera_and_depth) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  struct recording {
    std::string name;
    seq::camera_kind kind;
    int frames;
  };
  for (recording const& r : {recording{"euroc_mh05_mono", seq::camera_kind::mono, 75},
                             recording{"rgbd_7scenes_kitchen", seq::camera_kind::rgbd, 190},
                             recording{"rgbd_hololens_office", seq::camera_kind::rgbd, 140},
                             recording{"rgbd_tartanair", seq::camera_kind::rgbd, 50}}) {
    std::string const folder = shared + "/data/" + r.name;
    if (!fs::exists(folder)) { GTEST_SKIP() << "no " << folder; }
    seq::sequence const s = seq::sequence::open(folder);
    EXPECT_EQ(s.kind(), r.kind) << r.name;
    EXPECT_EQ(s.size(), r.frames) << r.name;
    EXPECT_EQ(s.depth_unit(), r.kind == seq::camera_kind::rgbd ? 0.001 : 0) << r.name;
    EXPECT_TRUE(s.ground_truth_has_orientation()) << r.name;
    EXPECT_EQ(s.warnings(), std::vector<std::string>{}) << r.name;
  }
}

}  // namespace
