// SPDX-License-Identifier: Apache-2.0
/// @file Dialects of calibration files: all those of ORB-SLAM3's settings, and that of basalt's
/// beginnings.
#include <gtest/gtest.h>

#include <cstddef>
#include <string>
#include <vector>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/reader.hpp"
#include "examples/sequence/rectify.hpp"
#include "tests/support/sequence.hpp"

namespace calibration_dialects_test {

using seq::camera_kind;
using seq::lens;
using seq_test::contains;
using seq_test::message_of;
using seq_test::replaced;
using seq_test::temp_folder;

/// Lines "PREFIXfx: 380.5" of a camera. @param terms names and values behind them
std::string camera_lines(std::string const& prefix, std::vector<std::string> const& terms) {
  std::string lines = "\n# calibration\n" + prefix + "fx: 380.5\n" + prefix + "fy: 381.25\n" +
                      prefix + "cx: 321.5\n" + prefix + "cy: 239.75\n\n";
  for (std::string const& term : terms) { lines += prefix + term + "\n"; }
  return lines;
}
/// A 4 x 4 matrix as OpenCV writes it, whose rotation was rounded to six digits.
std::string matrix_lines(std::string const& key, double x) {
  return "\n# from one frame to another\n" + key +
         ": !!opencv-matrix\n   rows: 4\n   cols: 4\n   dt: f\n   data: [0.999983,   0.00445005, "
         "0.00385861,  " +
         std::to_string(x) + ",\n         -0.00443664, 0.999984,  -0.00347621, -0.000252,\n" +
         "         -0.00387402, 0.00345903, 0.999986,   -8.87895e-05,\n" +
         "          0.0,0.0,0.0,1.0]\n";
}
std::string plain_matrix(std::string const& key, int rows, int cols, std::string const& data) {
  return key + ": !!opencv-matrix\n   rows: " + std::to_string(rows) +
         "\n   cols: " + std::to_string(cols) + "\n   dt: d\n   data: [" + data + "]\n";
}

std::vector<std::string> const no_terms;
std::vector<std::string> const zeros = {"k1: 0.0", "k2: 0.0", "p1: 0.0", "p2: 0.0"};
std::vector<std::string> const four = {"k1: -0.1", "k2: 0.02", "p1: 0.0002", "p2: -0.0001"};
std::vector<std::string> const five = {"k1: -0.1", "k2: 0.02", "p1: 0.0002", "p2: -0.0001",
                                       "k3: 0.005"};
std::vector<std::string> const eight = {"k1: -0.1",  "k2: 0.02",  "p1: 0.0002", "p2: -0.0001",
                                        "k3: 0.005", "k4: 0.001", "k5: 0.002",  "k6: 0.0003"};
std::vector<std::string> const fisheye = {"k1: 0.0035", "k2: 0.0007", "k3: -0.002", "k4: 0.0002"};

std::string const size = "\n# Camera resolution\nCamera.width: 640\nCamera.height: 480\n";
std::string const rate = "Camera.fps: 30\nCamera.RGB: 1\n";
std::string const head = "%YAML:1.0\n\n#------------\n# Camera Parameters. Adjust them!\n#------\n";
std::string const version = head + "File.version: \"1.0\"\n\n";
std::string const overlap =
    "Camera1.overlappingBegin: 0\nCamera1.overlappingEnd: 639\nCamera2.overlappingBegin: 0\n"
    "Camera2.overlappingEnd: 639\n";
std::string const old_overlap =
    "Camera.lappingBegin: 0\nCamera.lappingEnd: 639\nCamera2.lappingBegin: 0\n"
    "Camera2.lappingEnd: 639\n";
std::string const orb =
    "\nORBextractor.nFeatures: 1250 # Tested with 1000\nORBextractor.scaleFactor: 1.2\n"
    "ORBextractor.nLevels: 8\nORBextractor.iniThFAST: 20\nORBextractor.minThFAST: 7\n"
    "Viewer.KeyFrameSize: 0.05\nViewer.ViewpointF: 500.0\nViewer.imageViewScale: 2.0\n"
    "System.thFarPoints: 20.0\nthFarPoints: 20.0\nloopClosing: 0\n";
std::string const noise =
    "\n# IMU noise\nIMU.NoiseGyro: 1e-3 # 0.000005 # rad/s^0.5 \nIMU.NoiseAcc: 1e-2\n"
    "IMU.GyroWalk: 0.000000499999999\nIMU.AccWalk: 0.000099999997474\nIMU.Frequency: 200.0\n"
    "IMU.InsertKFsWhenLost: 0\n";

std::string type(std::string const& name) { return "Camera.type: \"" + name + "\"\n"; }
std::string new_imu() { return matrix_lines("IMU.T_b_c1", 0.0107) + noise; }
std::string old_imu() { return matrix_lines("Tbc", 0.0107) + noise; }
std::string depth(std::string const& key) { return key + ": 5000.0 # 1.0 for ROS_bag\n"; }
std::string raw_pair() {
  std::string text;
  for (std::string const side : {"LEFT", "RIGHT"}) {
    text += side + ".width: 640\n" + side + ".height: 480\n" +
            plain_matrix(side + ".D", 1, 5, "-0.1, 0.02, 0.0002, -0.0001, 0.0") +
            plain_matrix(side + ".K", 3, 3, "380.5, 0.0, 321.5, 0.0, 381.25, 239.75, 0, 0, 1") +
            plain_matrix(side + ".R", 3, 3, "1, 0, 0, 0, 1, 0, 0, 0, 1") +
            plain_matrix(side + ".P", 3, 4,
                         side == "LEFT" ? "380, 0, 320, 0, 0, 380, 240, 0, 0, 0, 1, 0"
                                        : "380, 0, 320, -38, 0, 380, 240, 0, 0, 0, 1, 0");
  }
  return text;
}

struct dialect {
  char const* name;
  std::string text;
  camera_kind kind;
  lens model;
  std::size_t terms;
  double baseline;  ///< metres; 0 = of one camera
  bool has_imu = false;
};

std::vector<dialect> all_dialects() {
  auto const pinhole = lens::pinhole, radial = lens::radial_tangential;
  auto const kb = lens::kannala_brandt;
  auto const mono = camera_kind::mono, stereo = camera_kind::stereo, rgbd = camera_kind::rgbd;
  std::string const pin = version + type("PinHole");
  std::string const fish = version + type("KannalaBrandt8");
  std::string const rectified = version + type("Rectified");
  std::string const from_right = matrix_lines("Stereo.T_c1_c2", 0.1);
  std::string const b = "Stereo.ThDepth: 40.0\nStereo.b: 0.1\n";
  std::string const two_pin = camera_lines("Camera1.", four) + camera_lines("Camera2.", four);
  std::string const two_fish =
      camera_lines("Camera1.", fisheye) + camera_lines("Camera2.", fisheye);
  std::string const old_pin = head + type("PinHole");
  std::string const old_fish = head + type("KannalaBrandt8");
  std::string const bf = "Camera.bf: 38.05\nThDepth: 40.0\n";
  auto const one = [](std::vector<std::string> const& t) { return camera_lines("Camera1.", t); };
  auto const old = [](std::vector<std::string> const& t) { return camera_lines("Camera.", t); };
  return {
      {"mono", pin + one(four) + size + rate, mono, radial, 4, 0},
      {"mono without distortion", pin + one(no_terms) + size + rate, mono, pinhole, 0, 0},
      {"mono of zeros", pin + one(zeros) + rate + size, mono, pinhole, 0, 0},
      {"mono with k3", pin + one(five) + size + rate, mono, radial, 5, 0},
      {"mono with k3 to k6", pin + one(eight) + size + rate, mono, radial, 8, 0},
      {"mono fisheye", fish + one(fisheye) + size + rate, mono, kb, 4, 0},
      {"mono, inertial", pin + one(four) + size + rate + new_imu(), mono, radial, 4, 0, true},
      {"mono fisheye, inertial", fish + one(fisheye) + size + rate + new_imu(), mono, kb, 4, 0,
       true},
      {"depth", pin + one(five) + size + rate + b + depth("RGBD.DepthMapFactor"), rgbd, radial, 5,
       0.1},
      {"depth, inertial",
       pin + one(zeros) + size + rate + b + depth("RGBD.DepthMapFactor") + new_imu(), rgbd, pinhole,
       0, 0.1, true},
      {"rectified", rectified + one(no_terms) + b + size + rate, stereo, pinhole, 0, 0.1},
      {"rectified, inertial", rectified + one(no_terms) + b + size + rate + new_imu(), stereo,
       pinhole, 0, 0.1, true},
      {"raw pair", pin + two_pin + size + rate + b.substr(0, b.find('\n') + 1) + from_right, stereo,
       radial, 4, 0.1},
      {"raw pair, inertial", pin + two_pin + size + rate + from_right + new_imu(), stereo, radial,
       4, 0.1, true},
      {"raw pair with k3 to k6",
       pin + camera_lines("Camera1.", eight) + camera_lines("Camera2.", eight) + size + rate +
           from_right,
       stereo, radial, 8, 0.1},
      {"fisheye pair", fish + two_fish + from_right + overlap + size + rate, stereo, kb, 4, 0.1},
      {"fisheye pair, inertial", fish + two_fish + from_right + overlap + size + rate + new_imu(),
       stereo, kb, 4, 0.1, true},
      {"old mono", old_pin + old(four) + size + rate, mono, radial, 4, 0},
      {"old mono without a type", head + old(five) + rate, mono, radial, 5, 0},
      {"old mono of zeros", old_pin + old(zeros) + rate, mono, pinhole, 0, 0},
      {"old mono fisheye", old_fish + old(fisheye) + size + rate, mono, kb, 4, 0},
      {"old mono, inertial", old_pin + old(four) + size + rate + old_imu(), mono, radial, 4, 0,
       true},
      {"old mono fisheye, inertial", old_fish + old(fisheye) + size + rate + old_imu(), mono, kb, 4,
       0, true},
      {"old depth", old_pin + old(five) + size + rate + bf + depth("DepthMapFactor"), rgbd, radial,
       5, 0.1},
      {"old rectified", old_pin + old(zeros) + size + rate + bf, stereo, pinhole, 0, 0.1},
      {"old rectified, inertial", old_pin + old(zeros) + size + rate + bf + old_imu(), stereo,
       pinhole, 0, 0.1, true},
      {"old raw pair", old_pin + old(zeros) + size + rate + bf + raw_pair(), stereo, radial, 5,
       0.1},
      {"old raw pair, inertial", old_pin + old(zeros) + size + rate + bf + old_imu() + raw_pair(),
       stereo, radial, 5, 0.1, true},
      {"old fisheye pair",
       old_fish + old(fisheye) + camera_lines("Camera2.", fisheye) + matrix_lines("Tlr", 0.1) +
           old_overlap + size + rate + bf,
       stereo, kb, 4, 0.1},
      {"old fisheye pair, inertial",
       old_fish + old(fisheye) + camera_lines("Camera2.", fisheye) + matrix_lines("Tlr", 0.1) +
           old_overlap + size + rate + bf + old_imu(),
       stereo, kb, 4, 0.1, true},
  };
}

TEST(calibration_dialects, no_settings_of_orb_slam3_are_refused) {
  temp_folder const folder;
  for (dialect const& d : all_dialects()) {
    SCOPED_TRACE(d.name);
    std::string const path = folder.write("settings.yaml", d.text + orb);
    seq::calibration c;
    ASSERT_NO_THROW(c = seq::read_orb_slam3_settings(path, 640, 480, d.kind));
    EXPECT_EQ(c.rig.left.model, d.model);
    EXPECT_EQ(c.rig.left.distortion.size(), d.terms);
    EXPECT_EQ(c.rig.left.fx, 380.5);
    EXPECT_EQ(c.rig.left.width, 640);
    if (d.baseline > 0) { EXPECT_NEAR(c.rig.baseline(), d.baseline, 1e-4); }
    EXPECT_EQ(c.imu.has_value(), d.has_imu);
    EXPECT_EQ(c.has_body_frame, d.has_imu);
    EXPECT_EQ(c.settings.features, 1250);
    if (d.kind == camera_kind::rgbd) { EXPECT_EQ(c.depth_unit, 1.0 / 5000); }
    for (std::string const& warning : c.warnings) { ADD_FAILURE() << warning; }
  }
}

TEST(calibration_visnav, numbers_of_each_model_are_read) {
  std::string const text = R"({"value0": {
    "cam.T_i_c": [
      {"px": 0.0, "py": 0.0, "pz": 0.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0},
      {"px": 0.11, "py": -0.0003, "pz": 0.0002, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0}],
    "cam.intrinsics": [
      {"cam_type": "TYPE", "fx": 351.0, "fy": 350.0, "cx": 365.9, "cy": 249.3, "p1": 0.25,
       "p2": 0.5, "p3": 0.125, "p4": 0.0625, "width": 752, "height": 480},
      {"cam_type": "kb4", "fx": 363.0, "fy": 362.0, "cx": 379.4, "cy": 256.0, "p1": 0.01,
       "p2": 0.02, "p3": 0.03, "p4": 0.04, "width": 752, "height": 480}]}})";
  temp_folder const folder;
  struct model_case {
    char const* type;
    lens model;
    std::vector<double> numbers;
  };
  for (model_case const& m : {model_case{"ds", lens::double_sphere, {0.25, 0.5}},
                              {"eucm", lens::extended_unified, {0.25, 0.5}},
                              {"kb4", lens::kannala_brandt, {0.25, 0.5, 0.125, 0.0625}},
                              {"pinhole", lens::pinhole, {}}}) {
    std::string const path = folder.write("calib.json", replaced(text, "TYPE", m.type));
    seq::calibration const c = seq::read_calibration(path);
    EXPECT_EQ(c.rig.left.model, m.model);
    EXPECT_EQ(c.rig.left.distortion, m.numbers);
    EXPECT_EQ(c.rig.right.distortion, (std::vector<double>{0.01, 0.02, 0.03, 0.04}));
    EXPECT_EQ(c.rig.left.width, 752);
    EXPECT_LT((c.rig.T_left_right.translation() - Eigen::Vector3d(0.11, -0.0003, 0.0002)).norm(),
              1e-12);
    EXPECT_FALSE(c.has_body_frame) << "the frame i is the left camera";
    EXPECT_EQ(seq::read_calibration(path, 0, 0, 0, camera_kind::mono).rig.left.fx, 351);
  }
  std::string const path = folder.write("calib.json", replaced(text, "TYPE", "fov"));
  EXPECT_TRUE(contains(message_of([&] { seq::read_calibration(path); }),
                       "cam_type = fov: must be pinhole, kb4, ds or eucm"));
  folder.write("calib.json",
               replaced(replaced(text, "TYPE", "ds"), "\"pz\": 0.0,", "\"pz\": 0.5,"));
  seq::calibration const moved = seq::read_calibration(path);
  EXPECT_TRUE(moved.has_body_frame);
  EXPECT_NEAR(moved.rig.T_left_right.translation().z(), -0.4998, 1e-12);
}

TEST(calibration_visnav, files_of_one_rig_agree) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  std::string const folder = shared + "/data/euroc_v101_stereo_sparse";
  seq::stereo_rig const own = seq::read_calibration(folder).rig;
  for (char const* name : {"gt_calib_ds", "gt_calib_eucm", "gt_calib_kb4"}) {
    std::string const file = folder + "/calib_visnav/" + name + ".json";
    seq::stereo_rig const rig = seq::read_calibration(file).rig;
    EXPECT_NEAR(rig.baseline(), own.baseline(), 5e-4) << name;
    seq::open_options options;
    options.calibration = file;
    seq::sequence const s = seq::sequence::open(folder, options);
    EXPECT_EQ(s.size(), 25);
    EXPECT_EQ(s.load(24).left.width, 752);
    // Directions of rays as EuRoC's own calibration has them.
    seq::lens_projection const lens_of_file(rig.left), lens_of_own(own.left);
    for (double x : {150.0, 376.0, 600.0}) {
      auto const a = lens_of_file.unproject({x, 200.0}), b = lens_of_own.unproject({x, 200.0});
      ASSERT_TRUE(a.valid && b.valid);
      EXPECT_LT((a.pixel - b.pixel).norm(), 0.01) << name << " " << x;
    }
  }
}

}  // namespace calibration_dialects_test
