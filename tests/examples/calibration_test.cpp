// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/calibration.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "tests/support/sequence.hpp"

namespace {

using seq_test::bad_text;
using seq_test::contains;
using seq_test::expect_refused;
using seq_test::message_of;
using seq_test::replaced;
using seq_test::temp_folder;

std::string const left_sensor = R"(%YAML:1.0
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [0, -1, 0, 0.5,
         1, 0, 0, -0.25,
         0, 0, 1, 0.125,
         0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.654, 457, 3.67215e+02, 248.375] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
)";
// The left camera's x is the body's y: this camera lies 0.1 m to its right.
std::string const right_sensor = replaced(replaced(left_sensor, "1, 0, 0, -0.25", "1, 0, 0, -0.15"),
                                          "458.654, 457", "458, 456.5");

std::string write_euroc(temp_folder const& folder, std::string const& left,
                        std::string const& right) {
  folder.write("mav0/cam0/sensor.yaml", left);
  folder.write("mav0/cam1/sensor.yaml", right);
  return folder.path("mav0");
}

std::string const kitti_text =
    "P0: 7.188560000000e+02 0 6.071928e+02 0 0 718.856 1.852157e+02 0 0 0 1 0\n"
    "P1: 7.188560000000e+02 0 6.071928e+02 -3.861448000000e+02 0 718.856 185.2157 0 0 0 1 0\n"
    "P2: 718.856 0 607.1928 45.38225 0 718.856 185.2157 -0.1130887 0 0 1 0.003779761\n"
    "P3: 718.856 0 607.1928 -337.2877 0 718.856 185.2157 2.369057 0 0 1 0.004915215\n"
    "Tr: 0 -1 0 0 0 0 -1 0 1 0 0 0\n";

std::string const new_settings = R"(%YAML:1.0
# comment
File.version: "1.0"
Camera.type: "PinHole"
Camera1.fx: 458.654
Camera1.fy: 457
Camera1.cx: 367.215
Camera1.cy: 248.375
Camera1.k1: -0.28340811
Camera1.k2: 0.07395907
Camera1.p1: 0.00019359
Camera1.p2: 1.76187114e-05
Camera2.fx: 457.587
Camera2.fy: 456.134
Camera2.cx: 379.999
Camera2.cy: 255.238
Camera2.k1: -0.28368365
Camera2.k2: 0.07451284
Camera2.p1: -0.00010473
Camera2.p2: -3.55590700e-05
Camera2.k3: 0.125
Camera.width: 752
Camera.height: 480.0
Camera.fps: 20
Stereo.ThDepth: 60.0
Stereo.T_c1_c2: !!opencv-matrix
  rows: 4
  cols: 4
  dt: f
  data: [1,0.,0,1.1e-1,
         0,1.,0,0,
         0,0,1,0,
         0,0,0,1.000000000000000]
IMU.T_b_c1: !!opencv-matrix
  rows: 4
  cols: 4
  dt: f
  data: [0, -1, 0, 0.5, 1, 0, 0, 0.25, 0, 0, 1, 0.125, 0, 0, 0, 1]
ORBextractor.nFeatures: 1200.0
ORBextractor.scaleFactor: 1.2
ORBextractor.nLevels: 8
ORBextractor.iniThFAST: 20
ORBextractor.minThFAST: 7
)";

std::string const fisheye_settings = R"(%YAML:1.0
---
Camera.type: "KannalaBrandt8"
Camera.fx: 190.978477
Camera.fy: 190.973307
Camera.cx: 254.931706
Camera.cy: 256.897442
Camera.k1: 0.003482389402
Camera.k2: 0.000715034845
Camera.k3: -0.002053236141
Camera.k4: 0.000202936736
Camera2.fx: 190.442369
Camera2.fy: 190.4344384
Camera2.cx: 252.59949716835982
Camera2.cy: 254.91723064636983
Camera2.k1: 0.0034003170790442797
Camera2.k2: 0.001766278153469831
Camera2.k3: -0.00266312569781606
Camera2.k4: 0.0003299517423931039
Tlr: !!opencv-matrix
  rows: 3
  cols: 4
  dt: f
  data: [ 1.0, 0.0, 0.0, 0.101, 0.0, 1.0, 0.0, 0.002, 0.0, 0.0, 1.0, -0.001]
Tbc: !!opencv-matrix
  rows: 4
  cols: 4
  dt: f
  data: [1,0,0,0.5, 0,1,0,0, 0,0,1,0, 0,0,0,1]
Camera.width: 512
Camera.height: 512
Camera.bf: 19.3079
ThDepth: 40.0
)";

TEST(calibration_euroc, reads_values_of_any_format) {
  temp_folder const folder;
  seq::calibration const c =
      seq::read_euroc_calibration(write_euroc(folder, left_sensor, right_sensor));
  seq::stereo_rig const& rig = c.rig;
  EXPECT_TRUE(c.has_body_frame);
  EXPECT_EQ(rig.left.model, seq::lens::radial_tangential);
  EXPECT_EQ(rig.left.width, 752);
  EXPECT_EQ(rig.right.height, 480);
  EXPECT_EQ(rig.left.fx, 458.654);
  EXPECT_EQ(rig.left.fy, 457);
  EXPECT_EQ(rig.left.cx, 367.215);
  EXPECT_EQ(rig.right.fx, 458);
  EXPECT_EQ(rig.left.distortion,
            (std::vector<double>{-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05}));
  EXPECT_EQ(rig.fps, 20);
  EXPECT_LT((rig.T_left_right.translation() - Eigen::Vector3d(0.1, 0, 0)).norm(), 1e-12);
  EXPECT_LT((rig.T_left_right.linear() - Eigen::Matrix3d::Identity()).norm(), 1e-12);
  EXPECT_LT((rig.T_body_left.translation() - Eigen::Vector3d(0.5, -0.25, 0.125)).norm(), 1e-12);
  EXPECT_FALSE(rig.rectified());
}

TEST(calibration_euroc, knows_equidistant_none_and_zero_distortion) {
  auto const read = [](std::string const& from, std::string const& to) {
    temp_folder const folder;
    return seq::read_euroc_calibration(write_euroc(folder, replaced(left_sensor, from, to),
                                                   replaced(right_sensor, from, to)))
        .rig;
  };
  std::string const model = "distortion_model: radial-tangential";
  EXPECT_EQ(read(model, "distortion_model: equidistant").left.model, seq::lens::kannala_brandt);
  std::string const whole =
      model + "\ndistortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]";
  for (std::string const& ideal :
       {std::string("distortion_model: none"), std::string("comment: absent"),
        model + "\ndistortion_coefficients: [0, 0.0, 0e3, -0.]"}) {
    seq::stereo_rig const rig = read(whole, ideal);
    EXPECT_EQ(rig.left.model, seq::lens::pinhole) << ideal;
    EXPECT_TRUE(rig.left.distortion.empty()) << ideal;
  }
}

TEST(calibration_euroc, two_equal_pinholes_are_rectified) {
  temp_folder const folder;
  std::string const ideal =
      replaced(left_sensor, "-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05", "0, 0, 0, 0");
  std::string const right = replaced(ideal, "1, 0, 0, -0.25", "1, 0, 0, -0.15");
  EXPECT_TRUE(seq::read_euroc_calibration(write_euroc(folder, ideal, right)).rig.rectified());
}

TEST(calibration_euroc, rejects_bad_values_by_file_key_and_value) {
  struct bad_case {
    std::string from, to, expected;
  };
  std::vector<bad_case> const cases = {
      {"458.654", "0", "intrinsics[0] (fu) = 0: must be above 0"},
      {"458.654", "-458", "intrinsics[0] (fu) = -458: must be above 0"},
      {"458.654", "nan", "intrinsics[0] = nan: must be finite"},
      {"458.654", ".inf", "intrinsics[0] = .inf: not a number"},
      {"458.654", "inf", "intrinsics[0] = inf: must be finite"},
      {"458.654, ", "", "intrinsics has 3 numbers"},
      {"458.654", "4e9", "at most 100000"},
      {"458.654", "abc", "intrinsics[0] = abc: not a number"},
      {"752, 480", "0, 480", "resolution[0] = 0: must be at least 1"},
      {"752, 480", "752, 99999", "resolution[1] = 99999"},
      {"752, 480", "752", "resolution has 1 numbers"},
      {"resolution", "resolutio", "resolution is missing"},
      {"3.67215e+02", "5000", "left camera: cx = 5000"},
      {"-0.28340811", "nan", "distortion_coefficients[0] = nan"},
      {"-0.28340811, ", "", "3 distortion coefficients"},
      {"radial-tangential", "fov", "distortion_model = fov"},
      {"radial-tangential", "none", "distortion_coefficients are not zero"},
      {"camera_model: pinhole", "camera_model: omni", "camera_model = omni"},
      {"0, -1, 0, 0.5", "0, -2, 0, 0.5", "T_BS: not a rotation"},
      {"0, -1, 0, 0.5", "0, 1, 0, 0.5", "T_BS: not a rotation"},
      {"0, -1, 0, 0.5", "0, -1, 0, nan", "T_BS.data[3] = nan"},
      {"0, -1, 0, 0.5,", "0, -1, 0,", "T_BS.data has 15 numbers"},
      {"0.0, 1.0]", "0.5, 1.0]", "T_BS: last row"},
      {"rows: 4", "rowz: 4", "T_BS.rows is missing"},
      {"rate_hz: 20", "rate_hz: -1", "rate_hz = -1"},
      {"T_BS:", "T_BS: [", "not valid YAML"},
  };
  for (bad_case const& c : cases) {
    temp_folder const folder;
    std::string const mav0 = write_euroc(folder, replaced(left_sensor, c.from, c.to), right_sensor);
    std::string const message = message_of([&] { seq::read_euroc_calibration(mav0); });
    EXPECT_TRUE(contains(message, c.expected)) << c.expected << "\n" << message;
    EXPECT_TRUE(contains(message, "cam0/sensor.yaml")) << message;
  }
}

TEST(calibration_euroc, rejects_zero_baseline_unequal_sizes_and_missing_files) {
  temp_folder const folder;
  std::string const mav0 = write_euroc(folder, left_sensor, left_sensor);
  EXPECT_TRUE(contains(message_of([&] { seq::read_euroc_calibration(mav0); }), "baseline = 0 m"));
  write_euroc(folder, left_sensor, replaced(right_sensor, "752, 480", "640, 480"));
  std::string const message = message_of([&] { seq::read_euroc_calibration(mav0); });
  EXPECT_TRUE(contains(message, "left camera is 752 x 480, right camera 640 x 480")) << message;
  std::filesystem::remove(folder.path("mav0/cam1/sensor.yaml"));
  EXPECT_TRUE(contains(message_of([&] { seq::read_euroc_calibration(mav0); }),
                       "cam1/sensor.yaml: no such file"));
}

TEST(calibration_kitti, reads_the_odometry_form) {
  temp_folder const folder;
  seq::stereo_rig const rig =
      seq::read_kitti_calibration(folder.write("calib.txt", kitti_text), 1241, 376).rig;
  EXPECT_TRUE(rig.rectified());
  EXPECT_EQ(rig.left.width, 1241);
  EXPECT_EQ(rig.left.fx, 718.856);
  EXPECT_EQ(rig.left.cy, 185.2157);
  EXPECT_NEAR(rig.baseline(), 386.1448 / 718.856, 1e-12);
  EXPECT_GT(rig.T_left_right.translation().x(), 0);
}

TEST(calibration_kitti, rejects_bad_files) {
  std::vector<bad_text> const cases = {
      {"P1: 7.18", "Q1: 7.18", "P1: line is missing"},
      {"P1: 7.188560000000e+02 0", "P1: 7.188560000000e+02", "P1 has 11 numbers"},
      {"P0: 7.188560000000e+02", "P0: 0", "P0[0] (fx) = 0"},
      {"P0: 7.188560000000e+02", "P0: nan", "'nan' is not finite"},
      {"P0: 7.188560000000e+02", "P0: x", "'x' is not a number"},
      {"-3.861448000000e+02", "0", "baseline = 0 m"},
      {"P0: 7.188560000000e+02 0", "P0: 7.188560000000e+02 3", "not of the form"},
      {"P2:", "P0:", "P0 is given twice"},
  };
  expect_refused("calib.txt", kitti_text, cases,
                 [](std::string const& path) { seq::read_kitti_calibration(path, 1241, 376); });
  temp_folder const folder;
  std::string const path = folder.write("calib.txt", kitti_text);
  EXPECT_TRUE(contains(message_of([&] { seq::read_kitti_calibration(path, 0, 376); }), "width"));
}

TEST(calibration_orb_slam3, reads_the_new_pinhole_format) {
  temp_folder const folder;
  seq::calibration const c =
      seq::read_orb_slam3_settings(folder.write("settings.yaml", new_settings));
  EXPECT_EQ(c.rig.left.model, seq::lens::radial_tangential);
  EXPECT_EQ(c.rig.left.distortion.size(), 4U);
  EXPECT_EQ(c.rig.right.distortion,
            (std::vector<double>{-0.28368365, 0.07451284, -0.00010473, -3.55590700e-05, 0.125}));
  EXPECT_EQ(c.rig.right.cx, 379.999);
  EXPECT_EQ(c.rig.left.height, 480);
  EXPECT_EQ(c.rig.fps, 20);
  EXPECT_NEAR(c.rig.T_left_right.translation().x(), 0.11, 1e-15);
  EXPECT_TRUE(c.has_body_frame);
  EXPECT_EQ(c.rig.T_body_left.translation(), Eigen::Vector3d(0.5, 0.25, 0.125));
  EXPECT_EQ(c.settings.features, 1200);
  EXPECT_EQ(c.settings.levels, 8);
  EXPECT_EQ(c.settings.scale_factor, 1.2);
  EXPECT_EQ(c.settings.ini_threshold, 20);
  EXPECT_EQ(c.settings.min_threshold, 7);
  EXPECT_EQ(c.settings.depth_threshold, 60.0);
}

std::string const imu_keys =
    "IMU.NoiseGyro: 1.7e-4\nIMU.NoiseAcc: 2.0e-3\nIMU.GyroWalk: 1.9393e-05\n"
    "IMU.AccWalk: 3.0000e-03\nIMU.Frequency: 200.0\n";

TEST(calibration_orb_slam3, reads_the_imu_of_either_format) {
  temp_folder const folder;
  EXPECT_FALSE(seq::read_orb_slam3_settings(folder.write("none.yaml", new_settings)).imu);
  for (std::string const& text : {new_settings, fisheye_settings}) {
    auto const imu =
        seq::read_orb_slam3_settings(folder.write("settings.yaml", text + imu_keys)).imu;
    ASSERT_TRUE(imu);
    EXPECT_EQ(imu->noise.gyro, 1.7e-4);
    EXPECT_EQ(imu->noise.accel, 2e-3);
    EXPECT_EQ(imu->noise.gyro_walk, 1.9393e-5);
    EXPECT_EQ(imu->noise.accel_walk, 3e-3);
    EXPECT_EQ(imu->rate_hz, 200);
    EXPECT_TRUE(imu->T_body_imu.matrix().isIdentity(0));
  }
}

TEST(calibration_orb_slam3, refuses_an_imu_that_is_not_whole) {
  struct bad_case {
    std::string from, to, expected;
  };
  std::vector<bad_case> const cases = {
      {"IMU.NoiseGyro: 1.7e-4\n", "", "IMU.NoiseGyro is missing"},
      {"IMU.NoiseAcc: 2.0e-3\n", "", "IMU.NoiseAcc is missing"},
      {"IMU.GyroWalk: 1.9393e-05\n", "", "IMU.GyroWalk is missing"},
      {"IMU.AccWalk: 3.0000e-03\n", "", "IMU.AccWalk is missing"},
      {"IMU.Frequency: 200.0\n", "", "IMU.Frequency is missing"},
      {"200.0", "0.5", "IMU.Frequency = 0.5: must be at least 1"},
      {"1.7e-4", "0", "IMU.NoiseGyro = 0: must be above 0"},
      {"3.0000e-03", ".nan", "IMU.AccWalk = .nan: "},
      {"2.0e-3", "[1]", "IMU.NoiseAcc: must be a single number"},
  };
  for (bad_case const& c : cases) {
    temp_folder const folder;
    std::string const path =
        folder.write("settings.yaml", new_settings + replaced(imu_keys, c.from, c.to));
    std::string const message = message_of([&] { seq::read_orb_slam3_settings(path); });
    EXPECT_TRUE(contains(message, path + ": " + c.expected)) << message;
  }
  temp_folder const folder;
  std::string const path = folder.write(
      "settings.yaml", replaced(new_settings, "IMU.T_b_c1", "Elsewhere.T_b_c1") + imu_keys);
  EXPECT_TRUE(contains(message_of([&] { seq::read_orb_slam3_settings(path); }),
                       "IMU.T_b_c1 (or Tbc) is missing"));
}

TEST(calibration_orb_slam3, reads_the_new_rectified_format) {
  temp_folder const folder;
  seq::calibration const c = seq::read_orb_slam3_settings(
      folder.write("settings.yaml",
                   "%YAML:1.0\nCamera.type: Rectified\nCamera1.fx: 230\nCamera1.fy: 230.5\n"
                   "Camera1.cx: 163.7\nCamera1.cy: 97.7\nStereo.b: 8e-2\n"),
      320, 200);
  EXPECT_TRUE(c.rig.rectified());
  EXPECT_EQ(c.rig.left.width, 320);
  EXPECT_EQ(c.rig.right.fy, 230.5);
  EXPECT_EQ(c.rig.baseline(), 0.08);
  EXPECT_FALSE(c.has_body_frame);
  EXPECT_FALSE(c.settings.features.has_value());
}

TEST(calibration_orb_slam3, reads_the_old_fisheye_format) {
  temp_folder const folder;
  seq::calibration const c =
      seq::read_orb_slam3_settings(folder.write("settings.yaml", fisheye_settings));
  EXPECT_EQ(c.rig.left.model, seq::lens::kannala_brandt);
  EXPECT_EQ(c.rig.right.distortion.at(1), 0.001766278153469831);
  EXPECT_EQ(c.rig.T_left_right.translation(), Eigen::Vector3d(0.101, 0.002, -0.001));
  EXPECT_EQ(c.rig.T_body_left.translation(), Eigen::Vector3d(0.5, 0, 0));
  EXPECT_EQ(c.settings.depth_threshold, 40.0);
}

TEST(calibration_orb_slam3, reads_the_old_rectified_format) {
  temp_folder const folder;
  std::string const text =
      "%YAML:1.0\nCamera.type: \"PinHole\"\nCamera.fx: 718.856\nCamera.fy: 718.856\n"
      "Camera.cx: 607.1928\nCamera.cy: 185.2157\nCamera.k1: 0.0\nCamera.k2: 0.0\n"
      "Camera.p1: 0.0\nCamera.p2: 0.0\nCamera.width: 1241\nCamera.height: 376\n"
      "Camera.bf: 386.1448\nThDepth: 35\n";
  seq::stereo_rig const rig = seq::read_orb_slam3_settings(folder.write("settings.yaml", text)).rig;
  EXPECT_TRUE(rig.rectified());
  EXPECT_NEAR(rig.baseline(), 386.1448 / 718.856, 1e-12);
}

TEST(calibration_orb_slam3, reads_the_old_raw_format) {
  // A pair of which the left camera is turned by 2 and the right by -3 degrees about y.
  Eigen::Matrix3d const R_left =
      Eigen::AngleAxisd(0.035, Eigen::Vector3d::UnitY()).toRotationMatrix();
  Eigen::Matrix3d const R_right =
      Eigen::AngleAxisd(-0.052, Eigen::Vector3d::UnitY()).toRotationMatrix();
  auto const matrix = [](std::string const& key, int rows, int cols, std::vector<double> values) {
    std::string text = key + ": !!opencv-matrix\n   rows: " + std::to_string(rows) +
                       "\n   cols: " + std::to_string(cols) + "\n   dt: d\n   data: [";
    for (double const v : values) {
      char number[40];
      std::snprintf(number, sizeof number, "%.17g, ", v);
      text += number;
    }
    text.resize(text.size() - 2);
    return text + "]\n";
  };
  auto const flat = [](Eigen::Matrix3d const& m) {
    std::vector<double> v;
    for (int i = 0; i < 9; ++i) { v.push_back(m(i / 3, i % 3)); }
    return v;
  };
  std::string text =
      "%YAML:1.0\nCamera.type: PinHole\nCamera.fx: 435\nCamera.width: 752\n"
      "Camera.height: 480\nCamera.bf: 47.9\n";
  text += matrix("LEFT.K", 3, 3, {458, 0, 367, 0, 457, 248, 0, 0, 1});
  text += matrix("LEFT.D", 1, 5, {-0.28, 0.07, 0.0002, 1.8e-5, 0});
  text += matrix("LEFT.R", 3, 3, flat(R_left));
  text += matrix("RIGHT.K", 3, 3, {457, 0, 380, 0, 456, 255, 0, 0, 1});
  text += matrix("RIGHT.D", 1, 5, {-0.28, 0.07, -0.0001, -3.6e-5, 0});
  text += matrix("RIGHT.R", 3, 3, flat(R_right));
  text += matrix("RIGHT.P", 3, 4, {435, 0, 367, -47.85, 0, 435, 252, 0, 0, 0, 1, 0});
  temp_folder const folder;
  std::string const path = folder.write("settings.yaml", text);
  seq::stereo_rig const rig = seq::read_orb_slam3_settings(path).rig;
  EXPECT_EQ(rig.left.fx, 458);
  EXPECT_EQ(rig.right.distortion.size(), 5U);
  EXPECT_NEAR(rig.baseline(), 0.11, 1e-12);
  // A point of the right camera seen in both rectified frames differs by the baseline along x.
  Eigen::Vector3d const point(0.3, -0.2, 4);
  Eigen::Vector3d const shift = R_left * (rig.T_left_right * point) - R_right * point;
  EXPECT_LT((shift - Eigen::Vector3d(0.11, 0, 0)).norm(), 1e-12);
  folder.write("settings.yaml", replaced(text, "-47.85", "47.85"));
  EXPECT_TRUE(contains(message_of([&] { seq::read_orb_slam3_settings(path); }), "RIGHT.P"));
}

TEST(calibration_orb_slam3, rejects_bad_files) {
  std::vector<bad_text> const cases = {
      {"Camera1.fx: 458.654", "Camera1.fx: 0.0", "Camera1.fx = 0.0: must be above 0"},
      {"Camera1.fx: 458.654", "Camera1.fx: -1", "Camera1.fx = -1: must be above 0"},
      {"Camera1.fx: 458.654", "Camera1.fx: nan", "Camera1.fx = nan: must be finite"},
      {"Camera1.fx: 458.654", "Camera1.fx: 4,5", "Camera1.fx = 4,5: not a number"},
      {"Camera1.fx: 458.654", "Camera1.fx: [1]", "Camera1.fx: must be a single number"},
      {"Camera1.fx: 458.654", "other: 1", "not an ORB-SLAM3 settings file"},
      {"Camera1.cy", "Camera1.cz", "Camera1.cy is missing"},
      {"Camera1.p1", "Camera1.pp", "Camera1.p1 is missing"},
      {"Camera2.fx: 457.587", "other: 1", "Camera2.fx is missing"},
      {"Camera.width: 752", "Camera.width: 0", "Camera.width = 0"},
      {"Camera.width: 752", "Camera.width: 75.5", "Camera.width = 75.5: must be a whole number"},
      {"Camera.fps: 20", "Camera.fps: -20", "Camera.fps = -20"},
      {"\"PinHole\"", "\"Omni\"", "Camera.type = Omni"},
      {"1,0.,0,1.1e-1", "1,0.,0,0", "baseline = 0 m"},
      {"1,0.,0,1.1e-1", "1,0.,0,1000", "baseline = 1000 m"},
      {"1,0.,0,1.1e-1", "1,0.,0,nan", "Stereo.T_c1_c2.data[3] = nan"},
      {"1,0.,0,1.1e-1", "1,0.2,0,0.1", "Stereo.T_c1_c2: not a rotation"},
      {"Stereo.T_c1_c2", "Stereo.T_c1_cc", "Stereo.T_c1_c2 is missing"},
      {"nFeatures: 1200.0", "nFeatures: 0", "ORBextractor.nFeatures = 0"},
      {"scaleFactor: 1.2", "scaleFactor: 1", "ORBextractor.scaleFactor = 1: must be above 1"},
      {"nLevels: 8", "nLevels: 99", "ORBextractor.nLevels = 99"},
      {"iniThFAST: 20", "iniThFAST: 300", "ORBextractor.iniThFAST = 300"},
      {"Stereo.ThDepth: 60.0", "Stereo.ThDepth: 0", "Stereo.ThDepth = 0"},
  };
  expect_refused("s.yaml", new_settings, cases,
                 [](std::string const& path) { seq::read_orb_slam3_settings(path); });
  temp_folder const folder;
  for (char const* text : {"", "just text", "[1, 2]", "a: [", "\t\x01\xff", "%YAML:1.0\n"}) {
    std::string const path = folder.write("s.yaml", text);
    EXPECT_TRUE(contains(message_of([&] { seq::read_orb_slam3_settings(path); }), path));
  }
  EXPECT_TRUE(contains(message_of([&] { seq::read_orb_slam3_settings(folder.path("none")); }),
                       "no such file"));
}

TEST(calibration_any, tells_files_apart) {
  temp_folder const folder;
  std::string const mav0 = write_euroc(folder, left_sensor, right_sensor);
  for (std::string const& path : {mav0, folder.path(), mav0 + "/cam0/sensor.yaml"}) {
    EXPECT_EQ(seq::read_calibration(path).rig.left.fx, 458.654) << path;
  }
  std::string const kitti = folder.write("kitti/calib.txt", kitti_text);
  for (std::string const& path : {kitti, folder.path("kitti")}) {
    EXPECT_EQ(seq::read_calibration(path, 1241, 376).rig.left.fx, 718.856) << path;
  }
  std::string const settings = folder.write("orb.yaml", new_settings);
  EXPECT_TRUE(seq::read_calibration(settings).settings.features.has_value());
  std::filesystem::create_directories(folder.path("empty"));
  EXPECT_TRUE(contains(message_of([&] { seq::read_calibration(folder.path("empty")); }),
                       "holds no calibration"));
  EXPECT_TRUE(
      contains(message_of([&] { seq::read_calibration(folder.path("none")); }), "no such file"));
}

TEST(calibration_rig, rectified_needs_equal_pinholes_along_x) {
  seq::stereo_rig rig;
  rig.left.width = 640;
  rig.left.height = 480;
  rig.left.fx = rig.left.fy = 400;
  rig.right = rig.left;
  rig.T_left_right.translation() = Eigen::Vector3d(0.1, 0, 0);
  ASSERT_TRUE(rig.rectified());
  auto const after = [&](auto const& change) {
    seq::stereo_rig other = rig;
    change(other);
    return other.rectified();
  };
  EXPECT_TRUE(after([](seq::stereo_rig& r) {
    r.right.model = seq::lens::radial_tangential;
    r.right.distortion = {0, 0, 0, 0};
  }));
  EXPECT_FALSE(after([](seq::stereo_rig& r) { r.right.fx += 0.01; }));
  EXPECT_FALSE(after([](seq::stereo_rig& r) { r.right.cy += 0.01; }));
  EXPECT_FALSE(after([](seq::stereo_rig& r) { r.right.width = 639; }));
  EXPECT_FALSE(after([](seq::stereo_rig& r) { r.left.model = seq::lens::kannala_brandt; }));
  EXPECT_FALSE(after([](seq::stereo_rig& r) { r.T_left_right.translation().x() = -0.1; }));
  EXPECT_FALSE(after([](seq::stereo_rig& r) { r.T_left_right.translation().y() = 1e-4; }));
  EXPECT_FALSE(after([](seq::stereo_rig& r) {
    r.T_left_right.linear() = Eigen::AngleAxisd(1e-3, Eigen::Vector3d::UnitX()).toRotationMatrix();
  }));
}

TEST(calibration_any, damaged_files_throw_nothing_but_seq_error) {
  temp_folder const folder;
  std::mt19937 random(17);
  auto const below = [&](std::size_t n) { return static_cast<std::size_t>(random()) % n; };
  std::string const symbols = "0123456789.-+eE,:[]{}#&*!|>'\"%@` \t\n\r~nafi\xff\x01";
  int rejected = 0;
  for (int i = 0; i < 300; ++i) {
    std::string const* const texts[] = {&new_settings, &fisheye_settings, &kitti_text,
                                        &left_sensor};
    std::size_t const which = below(4);
    std::string text = *texts[which];
    for (std::size_t edits = 1 + below(4); edits > 0; --edits) {
      std::size_t const at = below(text.size());
      switch (below(4)) {
        case 0:
          text[at] = symbols[below(symbols.size())];
          break;
        case 1:
          text.erase(at, 1 + below(20));
          break;
        case 2:
          text.insert(at, 1, symbols[below(symbols.size())]);
          break;
        default:
          text.insert(at, text.substr(below(text.size()), below(40)));
          break;
      }
      if (text.empty()) { text = "x"; }
    }
    std::string const mav0 = folder.path("mav0");
    try {
      if (which == 3) {
        write_euroc(folder, text, right_sensor);
        seq::check_rig(seq::read_calibration(mav0).rig, mav0);
      } else {
        std::string const path = folder.write("file", text);
        seq::check_rig(seq::read_calibration(path, 1241, 376).rig, path);
      }
    } catch (seq::error const&) { ++rejected; } catch (std::exception const& e) {
      FAIL() << e.what() << "\n" << text;
    }
  }
  EXPECT_GT(rejected, 30);
}

TEST(calibration_golden, every_settings_file_is_read) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  namespace fs = std::filesystem;
  int files = 0;
  for (fs::directory_entry const& entry : fs::directory_iterator(fs::path(shared) / "golden")) {
    fs::path const path = entry.path() / "settings.yaml";
    if (!fs::is_regular_file(path)) { continue; }
    ++files;
    seq::calibration const c = seq::read_calibration(path.string());
    // The reference's own reading of the same file.
    std::ifstream in(entry.path() / "params.json");
    std::string const json{std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
    auto const value = [&](std::string const& key) {
      std::size_t const at = json.find("\"" + key + "\":");
      return at == std::string::npos ? std::nan("")
                                     : std::strtod(json.c_str() + at + key.size() + 3, nullptr);
    };
    EXPECT_NEAR(c.rig.baseline(), value("b_settings"), 1e-6) << path;
    EXPECT_EQ(c.settings.features, static_cast<int>(value("nfeatures"))) << path;
    EXPECT_EQ(c.settings.ini_threshold, static_cast<int>(value("iniThFAST"))) << path;
    EXPECT_EQ(c.rig.left.width, static_cast<int>(value("width"))) << path;
    EXPECT_EQ(c.rig.left.height, static_cast<int>(value("height"))) << path;
    EXPECT_NEAR(c.settings.depth_threshold.value() * c.rig.baseline(), value("thDepth_m"), 1e-4)
        << path;
    if (c.rig.rectified() || c.rig.left.model == seq::lens::kannala_brandt) {
      EXPECT_NEAR(c.rig.left.fx, value("fx"), 1e-4) << path;
      EXPECT_NEAR(c.rig.left.cy, value("cy"), 1e-4) << path;
    }
  }
  EXPECT_GE(files, 11);
}

TEST(calibration_real, euroc_settings_and_sensor_files_agree) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  seq::stereo_rig const a = seq::read_calibration(shared + "/data/euroc_v101_stereo_start").rig;
  seq::stereo_rig const b =
      seq::read_calibration(shared + "/golden/euroc_v101_flight/settings.yaml").rig;
  EXPECT_EQ(a.left.fx, b.left.fx);
  EXPECT_EQ(a.right.distortion, b.right.distortion);
  EXPECT_LT((a.T_left_right.matrix() - b.T_left_right.matrix()).norm(), 1e-6);
  EXPECT_NEAR(a.baseline(), 0.110078, 1e-6);
}

std::string const opencv_settings = R"(%YAML:1.0
Camera.type:"PinHole"
Camera.fx:380.5
Camera.bf: 45.66
Camera.width: 640#px
Camera.height: 480
Camera.fps: 30#fps
Camera.RGB: 1 # colour
LEFT.D: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data:[-0.1, 0.02, 0.0003, -0.0001, 0.005]
LEFT.K: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data:[390.0, 0.0, 320.0, 0.0, 391.0, 240.0, 0.0, 0.0, 1.0]#K
LEFT.R:!!opencv-matrix
   rows:3
   cols:3
   dt:d
   data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
RIGHT.D:[-0.1, 0.02, 0.0003, -0.0001, 0.25]
RIGHT.K: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [390.0, 0.0, 320.0,
          0.0, 390.0, 240.0,#second row
          0.0, 0.0, 1.0]
RIGHT.R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
RIGHT.P: !!opencv-matrix
   rows: 3
   cols: 4
   dt: d
   data: [380.5, 0.0, 321.5, -45.66, 0.0, 380.5, 239.75, 0.0, 0.0, 0.0, 1.0, 0.0]
)";

TEST(calibration_opencv_yaml, is_read_as_opencv_reads_it) {
  temp_folder const folder;
  for (char const* head : {"%YAML:1.0", "YAML:1.0", "%YAML 1.0\n---"}) {
    seq::calibration const c = seq::read_orb_slam3_settings(
        folder.write("s.yaml", replaced(opencv_settings, "%YAML:1.0", head)));
    EXPECT_EQ(c.rig.left.distortion, (std::vector<double>{-0.1, 0.02, 0.0003, -0.0001, 0.005}))
        << head;
    EXPECT_EQ(c.rig.right.distortion.back(), 0.25) << head;
    EXPECT_EQ(c.rig.left.fy, 391) << head;
    EXPECT_EQ(c.rig.left.width, 640) << head;
    EXPECT_EQ(c.rig.fps, 30) << head;
    EXPECT_NEAR(c.rig.baseline(), 0.12, 1e-12) << head;
    EXPECT_EQ(c.warnings, std::vector<std::string>{}) << head;
  }
}

TEST(calibration_opencv_yaml, a_hash_inside_quotes_is_no_comment) {
  temp_folder const folder;
  std::string const path =
      folder.write("s.yaml", replaced(opencv_settings, "\"PinHole\"", "\"Pin1#Hole\""));
  EXPECT_TRUE(
      contains(message_of([&] { seq::read_orb_slam3_settings(path); }), "Camera.type = Pin1#Hole"));
}

TEST(calibration_orb_slam3, a_key_with_two_values_is_refused) {
  temp_folder const folder;
  std::string const twice = new_settings + "Camera1.fx: 500\n";
  EXPECT_TRUE(
      contains(message_of([&] { seq::read_orb_slam3_settings(folder.write("s.yaml", twice)); }),
               "Camera1.fx is given twice: 458.654 and 500"));
  std::string const same = new_settings + "Camera1.fx: 458.654\n";
  EXPECT_EQ(seq::read_orb_slam3_settings(folder.write("s.yaml", same)).rig.left.fx, 458.654);
}

TEST(calibration_orb_slam3, all_eight_coefficients_are_taken) {
  temp_folder const folder;
  std::string const text =
      replaced(new_settings, "Camera2.k3: 0.125",
               "Camera1.k3: 0.1\nCamera1.k4: 0.02\nCamera1.k5: 0.03\nCamera1.k6: 0.04\n"
               "Camera2.k3: 0.125");
  seq::calibration const c = seq::read_orb_slam3_settings(folder.write("s.yaml", text));
  EXPECT_EQ(c.rig.left.distortion, (std::vector<double>{-0.28340811, 0.07395907, 0.00019359,
                                                        1.76187114e-05, 0.1, 0.02, 0.03, 0.04}));
  EXPECT_EQ(c.rig.right.distortion.size(), 5U);
  std::string const hole = replaced(text, "Camera1.k5: 0.03\n", "");
  EXPECT_TRUE(
      contains(message_of([&] { seq::read_orb_slam3_settings(folder.write("s.yaml", hole)); }),
               "Camera1.k5 is missing"));
}

TEST(calibration_orb_slam3, says_what_it_does_not_take) {
  temp_folder const folder;
  auto const warnings = [&](std::string const& text) {
    return seq::read_orb_slam3_settings(folder.write("s.yaml", new_settings + text)).warnings;
  };
  EXPECT_EQ(warnings("Viewer.PointSize: 2\nSystem.LoadAtlasFromFile: \"x\"\nCamera.RGB: 1\n"),
            std::vector<std::string>{});
  for (char const* key :
       {"Camera1.k9", "Camera.newWidth", "IMU.TimeShift", "ORBextractor.nCells", "Stereo.Offset"}) {
    auto const said = warnings(std::string(key) + ": 600\n");
    ASSERT_EQ(said.size(), 1U) << key;
    EXPECT_TRUE(contains(said[0], key)) << said[0];
  }
}

std::string const rgbd_settings =
    "%YAML:1.0\nCamera.type: \"PinHole\"\nCamera1.fx: 535.4\nCamera1.fy: 539.2\n"
    "Camera1.cx: 320.1\nCamera1.cy: 247.6\nCamera1.k1: 0.1\nCamera1.k2: -0.2\n"
    "Camera1.p1: 0.001\nCamera1.p2: 0.002\nCamera1.k3: 0.3\nCamera.width: 640\n"
    "Camera.height: 480\nCamera.fps: 30\nStereo.ThDepth: 40.0\nStereo.b: 0.07732\n"
    "RGBD.DepthMapFactor: 5208.0\n";

TEST(calibration_orb_slam3, one_camera_and_depth) {
  temp_folder const folder;
  using seq::camera_kind;
  std::string const path = folder.write("s.yaml", rgbd_settings);
  seq::calibration const rgbd = seq::read_calibration(path, 0, 0, 0, camera_kind::rgbd);
  EXPECT_EQ(rgbd.rig.left.fy, 539.2);
  EXPECT_EQ(rgbd.rig.left.distortion.back(), 0.3);
  EXPECT_NEAR(rgbd.rig.baseline(), 0.07732, 1e-15);
  EXPECT_NEAR(rgbd.depth_unit.value(), 1 / 5208.0, 1e-15);
  EXPECT_EQ(rgbd.warnings, std::vector<std::string>{});
  seq::calibration const mono = seq::read_calibration(path, 0, 0, 0, camera_kind::mono);
  EXPECT_EQ(mono.rig.left.fx, 535.4);
  EXPECT_EQ(mono.rig.baseline(), 0);
  EXPECT_EQ(
      seq::read_calibration(folder.write("pair.yaml", new_settings), 0, 0, 0, camera_kind::mono)
          .rig.left.fx,
      458.654);
  EXPECT_TRUE(contains(message_of([&] { seq::read_calibration(path); }), "Camera2.fx is missing"));
  // the older format
  std::string const old =
      "%YAML:1.0\nCamera.fx: 500\nCamera.fy: 501\nCamera.cx: 320\nCamera.cy: 240\n"
      "Camera.width: 640\nCamera.height: 480\nCamera.bf: 40.0\nDepthMapFactor: 1000.0\n";
  seq::calibration const older =
      seq::read_calibration(folder.write("old.yaml", old), 0, 0, 0, camera_kind::rgbd);
  EXPECT_NEAR(older.rig.baseline(), 0.08, 1e-15);
  EXPECT_EQ(older.depth_unit.value(), 0.001);
  for (char const* factor : {"0", "-1", "nan", "1e12"}) {
    std::string const bad = folder.write("bad.yaml", replaced(rgbd_settings, "5208.0", factor));
    EXPECT_TRUE(
        contains(message_of([&] { seq::read_calibration(bad, 0, 0, 0, camera_kind::rgbd); }),
                 std::string("RGBD.DepthMapFactor = ") + factor))
        << factor;
  }
}

TEST(calibration_tum, reads_camera_txt) {
  temp_folder const folder;
  auto const read = [&](std::string const& text) {
    return seq::read_calibration(folder.write("camera.txt", text), 640, 480, 0,
                                 seq::camera_kind::rgbd);
  };
  seq::calibration const c =
      read("# fx fy cx cy; depth in units of 1 mm, 0 = none\n525 524 319 239\n");
  EXPECT_EQ(c.rig.left.model, seq::lens::pinhole);
  EXPECT_EQ(c.rig.left.fy, 524);
  EXPECT_EQ(c.rig.left.width, 640);
  EXPECT_EQ(c.rig.baseline(), seq::usual_virtual_baseline);
  EXPECT_EQ(c.depth_unit.value(), 0.001);
  EXPECT_EQ(read("# depth in units of 0.2 mm\n525 525 319 239\n").depth_unit.value(), 0.2 * 1e-3);
  EXPECT_EQ(read("# depth in units of 0.01 m\n525 525 319 239\n").depth_unit.value(), 0.01);
  EXPECT_FALSE(read("525 525 319 239\n").depth_unit);
  EXPECT_EQ(read("525 525 319 239 0.1 0.2 0.3 0.4 0.5\n").rig.left.distortion.size(), 5U);
  EXPECT_EQ(read("525 525 319 239 0.1 0.2 0.3 0.4 0.5 6 7 8\n").rig.left.distortion.back(), 8);
  struct bad_case {
    std::string text, expected;
  };
  for (bad_case const& b : std::vector<bad_case>{
           {"", "camera.txt: "},
           {"525 525 319\n", "camera.txt:1: 3 numbers"},
           {"525 525 319 239\n1 2 3 4\n", "camera.txt:2: a second camera"},
           {"0 525 319 239\n", "fx = 0: must be above 0"},
           {"525 525 319 1e9\n", "cy = 1e+09"},
           {"# depth in units of 1 furlong\n525 525 319 239\n", "'furlong': must be m, cm"},
           {"# depth in units of 0 mm\n525 525 319 239\n", "depth unit = 0"},
           {"# depth in units of -1 mm\n525 525 319 239\n", "depth unit = -0.001"},
           {"# depth in units of nan mm\n525 525 319 239\n", "'nan' is not finite"},
       }) {
    std::string const message = message_of([&] { read(b.text); });
    EXPECT_TRUE(contains(message, b.expected)) << message;
  }
}

TEST(calibration_euroc, one_camera_needs_no_second_file) {
  temp_folder const folder;
  folder.write("mav0/cam0/sensor.yaml", left_sensor + "rolling_shutter: 0.02\n");
  seq::calibration const c =
      seq::read_euroc_calibration(folder.path("mav0"), seq::camera_kind::mono);
  EXPECT_EQ(c.rig.left.fx, 458.654);
  EXPECT_EQ(c.rig.baseline(), 0);
  EXPECT_TRUE(c.has_body_frame);
  ASSERT_EQ(c.warnings.size(), 1U);
  EXPECT_TRUE(contains(c.warnings[0], "rolling_shutter"));
  std::string const kitti = folder.write("calib.txt", kitti_text.substr(0, kitti_text.find("P1:")));
  EXPECT_EQ(seq::read_kitti_calibration(kitti, 1241, 376, 0, seq::camera_kind::mono).rig.left.fx,
            718.856);
}

TEST(calibration_real, files_that_were_refused_or_cut) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  std::string const cases = shared + "/cases/";
  std::string const dialect = cases + "opencv_yaml_dialect/02_left_right_nospace.yaml";
  std::string const rational = cases + "rational_k456_dropped/settings.yaml";
  if (!std::filesystem::exists(dialect)) { GTEST_SKIP() << "no " << dialect; }
  EXPECT_EQ(seq::read_calibration(dialect).rig.left.distortion,
            (std::vector<double>{-0.1, 0.02, 0.0003, -0.0001, 0.0}));
  EXPECT_EQ(seq::read_calibration(rational).rig.left.distortion,
            (std::vector<double>{-0.05, 0.01, 0.0002, -0.0001, 0.1, 0.02, 0.03, 0.04}));
}

}  // namespace
