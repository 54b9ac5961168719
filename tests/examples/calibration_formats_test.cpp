// SPDX-License-Identifier: Apache-2.0
/// @file Calibrations as their makers write them: Kalibr, OpenCV, ROS, basalt.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <string>
#include <vector>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/rectify.hpp"
#include "tests/support/sequence.hpp"

namespace {

using seq_test::bad_text;
using seq_test::contains;
using seq_test::expect_refused;
using seq_test::message_of;
using seq_test::replaced;
using seq_test::temp_folder;

/// What camchain-imucam-NAME.yaml has after kalibr_calibrate_imu_camera.
std::string const camchain = R"(cam0:
  T_cam_imu:
  - [0.0, 1.0, 0.0, 0.07]
  - [-1.0, 0.0, 0.0, 0.02]
  - [0.0, 0.0, 1.0, -0.01]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, 1.8e-05]
  distortion_model: radtan
  intrinsics: [458.654, 457.296, 367.215, 248.375]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
  timeshift_cam_imu: -0.0041
cam1:
  T_cam_imu:
  - [0.0, 1.0, 0.0, -0.04]
  - [-1.0, 0.0, 0.0, 0.02]
  - [0.0, 0.0, 1.0, -0.01]
  - [0.0, 0.0, 0.0, 1.0]
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [-0.27, 0.06, 0.0001, 1.0e-05]
  distortion_model: radtan
  intrinsics: [457.587, 456.134, 379.999, 255.238]
  resolution: [752, 480]
  rostopic: /cam1/image_raw
  timeshift_cam_imu: -0.0041
)";

/// Kalibr's imu.yaml.
std::string const imu_yaml = R"(#Accelerometers
accelerometer_noise_density: 1.86e-03   #Noise density (continuous-time)
accelerometer_random_walk:   4.33e-04   #Bias random walk
#Gyroscopes
gyroscope_noise_density:     1.87e-04   #Noise density (continuous-time)
gyroscope_random_walk:       2.66e-05   #Bias random walk
rostopic:                    /imu0      #the IMU ROS topic
update_rate:                 200.0      #Hz (for discretization of the values above)
)";

TEST(calibration_kalibr, reads_a_chain_and_the_imu_beside_it) {
  temp_folder const folder;
  std::string const path = folder.write("camchain-imucam-run.yaml", camchain);
  seq::calibration c = seq::read_calibration(path);
  EXPECT_FALSE(c.imu);
  EXPECT_EQ(c.imu_time_offset_s, -0.0041);
  EXPECT_TRUE(c.warnings.empty()) << c.warnings.front();
  EXPECT_EQ(c.rig.left.model, seq::lens::radial_tangential);
  EXPECT_EQ(c.rig.left.distortion, (std::vector<double>{-0.28, 0.07, 0.0002, 1.8e-05}));
  EXPECT_EQ(c.rig.left.width, 752);
  EXPECT_EQ(c.rig.right.fy, 456.134);
  EXPECT_LT((c.rig.T_left_right.translation() - Eigen::Vector3d(0.11, 0, 0)).norm(), 1e-12);
  // A point of the IMU's frame in the camera: T_cam_imu.
  ASSERT_TRUE(c.has_body_frame);
  Eigen::Vector3d const in_camera = c.rig.T_body_left.inverse() * Eigen::Vector3d(1, 2, 3);
  EXPECT_LT((in_camera - Eigen::Vector3d(2.07, -0.98, 2.99)).norm(), 1e-12);

  folder.write("imu-run.yaml", imu_yaml);
  folder.write("imu.yaml", replaced(imu_yaml, "200.0", "400.0"));
  c = seq::read_calibration(folder.path());  // found in the folder; the IMU's file by its name
  ASSERT_TRUE(c.imu);
  EXPECT_EQ(c.imu->rate_hz, 200);
  EXPECT_EQ(c.imu->noise.gyro, 1.87e-4);
  EXPECT_EQ(c.imu->noise.accel, 1.86e-3);
  EXPECT_EQ(c.imu->noise.gyro_walk, 2.66e-5);
  EXPECT_EQ(c.imu->noise.accel_walk, 4.33e-4);
  EXPECT_TRUE(c.imu->T_body_imu.isApprox(Eigen::Isometry3d::Identity()));
}

TEST(calibration_kalibr, reads_each_model) {
  struct model_case {
    std::string model, intrinsics, distortion, coefficients;
    seq::lens expected;
    std::vector<double> numbers;
  };
  using seq::lens;
  std::vector<model_case> const cases = {
      {"pinhole",
       "[400, 401, 320, 240]",
       "equidistant",
       "[0.01, 0.02, 0.03, 0.04]",
       lens::kannala_brandt,
       {0.01, 0.02, 0.03, 0.04}},
      {"pinhole", "[400, 401, 320, 240]", "none", "[]", lens::pinhole, {}},
      {"pinhole", "[400, 401, 320, 240]", "fov", "[0.9]", lens::field_of_view, {0.9}},
      {"omni",
       "[1.5, 400, 401, 320, 240]",
       "radtan",
       "[0.1, 0.2, 0.3, 0.4]",
       lens::unified,
       {1.5, 0.1, 0.2, 0.3, 0.4}},
      {"omni", "[0, 400, 401, 320, 240]", "none", "[]", lens::unified, {0, 0, 0, 0, 0}},
      {"ds", "[-0.2, 0.6, 400, 401, 320, 240]", "none", "[]", lens::double_sphere, {-0.2, 0.6}},
      {"eucm", "[0.6, 1.1, 400, 401, 320, 240]", "none", "[]", lens::extended_unified, {0.6, 1.1}},
  };
  temp_folder const folder;
  for (model_case const& m : cases) {
    std::string text = replaced(camchain, "camera_model: pinhole", "camera_model: " + m.model);
    text = replaced(text, "[458.654, 457.296, 367.215, 248.375]", m.intrinsics);
    text = replaced(text, "distortion_model: radtan", "distortion_model: " + m.distortion);
    text = replaced(text, "[-0.28, 0.07, 0.0002, 1.8e-05]", m.coefficients);
    seq::calibration const c =
        seq::read_calibration(folder.write("chain.yaml", text), 0, 0, 0, seq::camera_kind::mono);
    EXPECT_EQ(c.rig.left.model, m.expected) << m.model;
    EXPECT_EQ(c.rig.left.distortion, m.numbers) << m.model;
    EXPECT_EQ(c.rig.left.fx, 400);
    EXPECT_EQ(c.rig.left.cy, 240);
  }
}

TEST(calibration_kalibr, mounts_say_where_the_right_camera_is) {
  // OpenVINS: T_imu_cam of each camera, the inverse of Kalibr's, and no T_cn_cnm1.
  std::string text = camchain;
  std::size_t const chain = text.find("  T_cn_cnm1");
  text.erase(chain, text.find("  cam_overlaps: [0]") - chain);
  temp_folder const folder;
  seq::calibration const c =
      seq::read_calibration(folder.write("chain.yaml", "%YAML:1.0\n" + text));
  EXPECT_LT((c.rig.T_left_right.translation() - Eigen::Vector3d(0.11, 0, 0)).norm(), 1e-12);
  std::string const inverse =
      replaced(replaced(text, "T_cam_imu:\n  - [0.0, 1.0, 0.0, 0.07]\n  - [-1.0, 0.0, 0.0, 0.02]",
                        "T_imu_cam:\n  - [0.0, -1.0, 0.0, 0.02]\n  - [1.0, 0.0, 0.0, -0.07]"),
               "[0.0, 0.0, 1.0, -0.01]", "[0.0, 0.0, 1.0, 0.01]");
  seq::calibration const d = seq::read_calibration(folder.write("chain.yaml", inverse));
  EXPECT_TRUE(c.rig.T_body_left.isApprox(d.rig.T_body_left, 1e-12));
}

TEST(calibration_kalibr, a_line_delay_is_in_seconds_or_nanoseconds) {
  temp_folder const folder;
  auto const read = [&](std::string const& left, std::string const& right) {
    auto text = replaced(camchain, "cam0:\n", "cam0:\n" + left);
    text = replaced(text, "cam1:\n", "cam1:\n" + right);
    return seq::read_calibration(folder.write("chain.yaml", text));
  };
  for (char const* delay : {"  line_delay: 4.0e-05\n", "  line_delay: 40000\n"}) {
    seq::calibration const c = read(delay, delay);
    EXPECT_NEAR(c.rig.left.readout_s, 479 * 4e-5, 1e-12);
    EXPECT_EQ(c.rig.left.readout_s, c.rig.right.readout_s);
    EXPECT_TRUE(c.warnings.empty());
  }
  EXPECT_EQ(read("", "").rig.left.readout_s, 0);
  EXPECT_EQ(read("  line_delay: 0\n", "").rig.left.readout_s, 0);
  EXPECT_TRUE(contains(message_of([&] { read("  line_delay: 4.0e-05\n", ""); }),
                       "those of the right one in 0 s: must be equal"));
  for (char const* delay : {"  line_delay: 0.01\n", "  line_delay: -1\n", "  line_delay: nan\n"}) {
    EXPECT_TRUE(contains(message_of([&] { read(delay, delay); }), "line_delay")) << delay;
  }
}

TEST(calibration_kalibr, rejects_bad_files) {
  std::vector<bad_text> const cases = {
      {"[458.654,", "[0,", "cam0: intrinsics[0] (fu) = 0: must be above 0"},
      {"[458.654,", "[1, 458.654,", "intrinsics has 5 numbers, must have 4"},
      {"camera_model: pinhole", "camera_model: fov", "must be pinhole, omni, ds or eucm"},
      {"distortion_model: radtan", "distortion_model: atan", "equidistant (fisheye), fov or none"},
      {"distortion_model: radtan", "distortion_model: fov", "4 numbers, must have 1"},
      {"[752, 480]", "[752]", "resolution has 1 numbers, must have 2"},
      {"-0.0041", "nan", "timeshift_cam_imu = nan: must be finite"},
      {"[1.0, 0.0, 0.0, -0.11]", "[1.0, 0.0, -0.11]", "rows have 3 and 4 numbers"},
      {"[1.0, 0.0, 0.0, -0.11]", "[1.0, 0.3, 0.0, -0.11]", "T_cn_cnm1: not a rotation"},
      {"[1.0, 0.0, 0.0, -0.11]", "[1.0, 0.0, 0.0, -110.0]", "millimetres"},
      {"-0.28, 0.07,", "", "2 numbers, must have 4, 5 or 8"},
  };
  temp_folder const folder;
  expect_refused("chain.yaml", camchain, cases,
                 [](std::string const& path) { seq::read_calibration(path); });
  std::string const one = folder.write("chain.yaml", camchain.substr(0, camchain.find("cam1:")));
  EXPECT_TRUE(contains(message_of([&] { seq::read_calibration(one); }), "cam1 is missing"));
  EXPECT_EQ(seq::read_calibration(one, 0, 0, 0, seq::camera_kind::mono).rig.left.fx, 458.654);
}

/// As cv::FileStorage writes it: samples/cpp/stereo_calib.cpp's intrinsics.yml.
std::string const intrinsics_yml = R"(%YAML:1.0
---
M1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.3480e+02, 0., 3.3400e+02, 0., 5.3481e+02, 2.4100e+02,
       0., 0., 1. ]
D1: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -2.9e-01, 1.0e-01, 1.0e-03, -2.0e-04, 1.4e-02 ]
M2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.3580e+02, 0., 3.3500e+02, 0., 5.3581e+02, 2.4200e+02, 0., 0., 1. ]
D2: !!opencv-matrix
   rows: 1
   cols: 14
   dt: d
   data: [ 0.1, 0.2, 1.0e-03, 2.0e-03, 0.3, 0.4, 0.5, 0.6, 0., 0., 0., 0., 0., 0. ]
)";
std::string const extrinsics_yml = R"(%YAML:1.0
---
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 0., -1., 0., 1., 0., 0., 0., 0., 1. ]
T: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -0.12, 0.01, 0.02 ]
)";

void expect_opencv_pair(seq::calibration const& c) {
  EXPECT_EQ(c.rig.left.fx, 534.80);
  EXPECT_EQ(c.rig.left.cy, 241);
  EXPECT_EQ(c.rig.left.width, 640);
  EXPECT_EQ(c.rig.left.distortion, (std::vector<double>{-0.29, 0.1, 1e-3, -2e-4, 1.4e-2}));
  EXPECT_EQ(c.rig.right.fx, 535.80);
  EXPECT_EQ(c.rig.right.distortion,
            (std::vector<double>{0.1, 0.2, 1e-3, 2e-3, 0.3, 0.4, 0.5, 0.6}));
  // OpenCV's R and T map points of camera 1 into camera 2.
  Eigen::Vector3d const right = c.rig.T_left_right.inverse() * Eigen::Vector3d(1, 2, 3);
  EXPECT_LT((right - Eigen::Vector3d(-2.12, 1.01, 3.02)).norm(), 1e-12);
}

TEST(calibration_opencv, reads_a_pair_in_two_files) {
  temp_folder const folder;
  std::string const in = folder.write("intrinsics.yml", intrinsics_yml);
  EXPECT_TRUE(
      contains(message_of([&] { seq::read_calibration(in, 640, 480); }), "R and T are missing"));
  std::string const out = folder.write("extrinsics.yml", extrinsics_yml);
  for (std::string const& path : {in, out, folder.path()}) {
    expect_opencv_pair(seq::read_calibration(path, 640, 480));
  }
  EXPECT_TRUE(contains(message_of([&] { seq::read_calibration(in); }), "image_width is missing"));
}

TEST(calibration_opencv, reads_a_pair_in_one_file_and_as_xml_and_json) {
  temp_folder const folder;
  std::string const both = intrinsics_yml + extrinsics_yml.substr(14) + "imageSize: [ 640, 480 ]\n";
  expect_opencv_pair(seq::read_calibration(folder.write("stereo.yaml", both)));
  auto const matrix = [](char const* name, char const* rows, char const* cols, char const* data) {
    return std::string("<") + name + " type_id=\"opencv-matrix\">\n  <rows>" + rows +
           "</rows>\n  <cols>" + cols + "</cols>\n  <dt>d</dt>\n  <data>\n    " + data +
           "</data></" + name + ">\n";
  };
  std::string const xml =
      "<?xml version=\"1.0\"?>\n<opencv_storage>\n<!-- a comment -->\n<imageSize>\n  640 "
      "480</imageSize>\n" +
      matrix("K1", "3", "3", "5.348e+02 0. 334. 0. 534.81\n    241. 0. 0. 1.") +
      matrix("D1", "1", "5", "-0.29 0.1 1e-3 -2e-4 1.4e-02") +
      matrix("K2", "3", "3", "535.8 0. 335. 0. 535.81 242. 0. 0. 1.") +
      matrix("D2", "1", "8", "0.1 0.2 1e-3 2e-3 0.3 0.4 0.5 0.6") +
      matrix("R", "3", "3", "0. -1. 0. 1. 0. 0. 0. 0. 1.") +
      matrix("T", "3", "1", "-0.12 0.01 0.02") +
      "<cameraName>\"a b\"</cameraName>\n</opencv_storage>\n";
  expect_opencv_pair(seq::read_calibration(folder.write("stereo.xml", xml)));
  std::string const json = R"({
    "imageSize": [ 640, 480 ],
    "cameraMatrix1": { "type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d",
        "data": [ 534.8, 0.0, 334.0, 0.0, 534.81, 241.0, 0.0, 0.0, 1.0 ] },
    "distCoeffs1": { "type_id": "opencv-matrix", "rows": 1, "cols": 5, "dt": "d",
        "data": [ -0.29, 0.1, 0.001, -0.0002, 0.014 ] },
    "cameraMatrix2": [ [ 535.8, 0, 335 ], [ 0, 535.81, 242 ], [ 0, 0, 1 ] ],
    "distCoeffs2": [ 0.1, 0.2, 0.001, 0.002, 0.3, 0.4, 0.5, 0.6 ],
    "R": [ [ 0, -1, 0 ], [ 1, 0, 0 ], [ 0, 0, 1 ] ],
    "T": [ -0.12, 0.01, 0.02 ]
})";
  expect_opencv_pair(seq::read_calibration(folder.write("stereo.json", json)));
  EXPECT_TRUE(contains(message_of([&] { seq::read_calibration(folder.path(), 640, 480); }),
                       "several calibrations: stereo.json, stereo.xml, stereo.yaml"));
}

TEST(calibration_opencv, rejects_what_it_cannot_know) {
  std::string const both = intrinsics_yml + extrinsics_yml.substr(14) + "imageSize: [ 640, 480 ]\n";
  std::vector<bad_text> const cases = {
      {"[ -0.12, 0.01", "[ -120., 10.", "millimetres"},
      {"0.6, 0.,", "0.6, 0.01,", "thin prism"},
      {"5.3480e+02, 0.,", "5.3480e+02, 3.,", "M1: not of the form"},
      {"5.3480e+02,", "-5.3480e+02,", "M1[0] (fx) = -534.8: must be above 0"},
      {"0., -1., 0., 1.", "0., -1., 0., 2.", "R: not a rotation"},
      {"[ 640, 480 ]", "[ 640 ]", "imageSize has 1 numbers"},
      {"M2:", "N2:", "M2 (or K2"},
  };
  temp_folder const folder;
  expect_refused("stereo.yaml", both, cases,
                 [](std::string const& path) { seq::read_calibration(path); });
  for (char const* xml :
       {"<opencv_storage>", "<opencv_storage><a>1</b></opencv_storage>", "<a>1</a>",
        "<opencv_storage><a>1</a><a>2</a></opencv_storage>", "<opencv_storage/>",
        "<opencv_storage><_>1</_><a>2</a></opencv_storage>", "<!DOCTYPE x><opencv_storage/>",
        "<opencv_storage><a>1<b>2</b></a></opencv_storage>",
        "<opencv_storage></opencv_storage>x"}) {
    std::string const path = folder.write("bad.xml", xml);
    EXPECT_TRUE(contains(message_of([&] { seq::read_calibration(path); }), path)) << xml;
  }
  std::string deep = "<opencv_storage>";
  for (int i = 0; i < 100000; ++i) { deep += "<a>"; }
  std::string const path = folder.write("deep.xml", deep);
  EXPECT_TRUE(contains(message_of([&] { seq::read_calibration(path); }), "in each other"));
}

TEST(calibration_opencv, four_coefficients_without_a_model_are_doubted) {
  temp_folder const folder;
  std::string const one =
      "image_width: 640\nimage_height: 480\ncamera_matrix: {rows: 3, cols: 3, data: [500, 0, 320, "
      "0, "
      "500, 240, 0, 0, 1]}\ndistortion_coefficients: {rows: 4, cols: 1, data: [0.01, 0.02, 0.03, "
      "0.04]}\n";
  auto const read = [&](std::string const& text) {
    return seq::read_calibration(folder.write("one.yaml", text), 0, 0, 0, seq::camera_kind::mono);
  };
  seq::calibration const c = read(one);
  EXPECT_EQ(c.rig.left.model, seq::lens::radial_tangential);
  ASSERT_EQ(c.warnings.size(), 1U);
  EXPECT_TRUE(contains(c.warnings[0], "distortion_model: equidistant"));
  for (char const* says : {"fisheye_model: 1\n", "distortion_model: equidistant\n"}) {
    seq::calibration const fisheye = read(one + says);
    EXPECT_EQ(fisheye.rig.left.model, seq::lens::kannala_brandt);
    EXPECT_TRUE(fisheye.warnings.empty());
  }
  EXPECT_EQ(read(one + "fisheye_model: 0\n").rig.left.model, seq::lens::radial_tangential);
}

/// What camera_calibration of ROS saves.
std::string ros_camera(char const* name, char const* rectification, double tx) {
  return std::string("image_width: 640\nimage_height: 480\ncamera_name: ") + name +
         "\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [430.0, 0.0, 307.0, 0.0, 431.0, 227.0, "
         "0.0, "
         "0.0, 1.0]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n "
         " "
         "data: [-0.33, 0.12, 0.0003, -0.0011, 0.0]\nrectification_matrix:\n  rows: 3\n  cols: 3\n "
         " "
         "data: " +
         rectification +
         "\nprojection_matrix:\n  rows: 3\n  cols: 4\n  data: [400.0, 0.0, 320.0, " +
         std::to_string(tx) + ", 0.0, 400.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]\n";
}

TEST(calibration_ros, reads_a_pair_of_camera_info) {
  char const* const level = "[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]";
  char const* const turned = "[0.8, 0.0, -0.6, 0.0, 1.0, 0.0, 0.6, 0.0, 0.8]";
  temp_folder const folder;
  std::string const left = folder.write("left.yaml", ros_camera("left", turned, 0));
  EXPECT_TRUE(contains(message_of([&] { seq::read_calibration(left); }), "no such partner"));
  EXPECT_EQ(seq::read_calibration(left, 0, 0, 0, seq::camera_kind::mono).rig.left.fy, 431);
  std::string const right = folder.write("right.yaml", ros_camera("right", level, -48));
  for (std::string const& path : {left, right, folder.path()}) {
    seq::calibration const c = seq::read_calibration(path);
    EXPECT_EQ(c.rig.left.fx, 430);
    EXPECT_EQ(c.rig.left.distortion.size(), 5U);
    // With x_rectified = R x_raw of either camera, their points differ by the baseline along x.
    Eigen::Matrix3d R_left;
    R_left << 0.8, 0, -0.6, 0, 1, 0, 0.6, 0, 0.8;
    Eigen::Vector3d const point(0.3, -0.2, 4);  // of the right camera
    Eigen::Vector3d const shift = R_left * (c.rig.T_left_right * point) - point;
    EXPECT_LT((shift - Eigen::Vector3d(0.12, 0, 0)).norm(), 1e-12);
  }
  folder.write("right.yaml", ros_camera("right", level, 0));
  EXPECT_TRUE(contains(message_of([&] { seq::read_calibration(left); }), "no baseline"));
}

TEST(calibration_ros, reads_a_printed_message) {
  std::string const text =
      "header:\n  frame_id: camera\nheight: 480\nwidth: 640\ndistortion_model: "
      "rational_polynomial\n"
      "D: [0.1, 0.2, 0.001, 0.002, 0.3, 0.4, 0.5, 0.6]\nK: [430.0, 0.0, 307.0, 0.0, 431.0, 227.0, "
      "0.0, 0.0, 1.0]\nR: [1, 0, 0, 0, 1, 0, 0, 0, 1]\nP: [400, 0, 320, 0, 0, 400, 240, 0, 0, 0, "
      "1, "
      "0]\n";
  temp_folder const folder;
  folder.write("cam0_info.yaml", text);
  folder.write("cam1_info.yaml", replaced(text, "320, 0,", "320, -20,"));
  seq::calibration const c = seq::read_calibration(folder.path());
  EXPECT_EQ(c.rig.left.distortion.size(), 8U);
  EXPECT_NEAR(c.rig.baseline(), 0.05, 1e-12);
}

TEST(calibration_basalt, reads_cameras_and_imu) {
  std::string const json = R"({
  "value0": {
    "T_imu_cam": [
      {"px": 0.04, "py": -0.07, "pz": -0.05, "qx": 0.0, "qy": 0.0, "qz": 0.6, "qw": 0.8},
      {"px": 0.04, "py": 0.03, "pz": -0.05, "qx": 0.0, "qy": 0.0, "qz": 0.6, "qw": 0.8}],
    "intrinsics": [
      {"camera_type": "ds", "intrinsics": {"fx": 158.3, "fy": 158.2, "cx": 254.9, "cy": 256.9,
       "xi": -0.17, "alpha": 0.59}},
      {"camera_type": "kb4", "intrinsics": {"fx": 190.3, "fy": 190.2, "cx": 254.0, "cy": 255.0,
       "k1": 0.003, "k2": 0.0007, "k3": -0.002, "k4": 0.0002}}],
    "resolution": [[512, 512], [512, 512]],
    "calib_accel_bias": [0.1, 0, 0, 0, 0, 0, 0, 0, 0],
    "calib_gyro_bias": [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
    "imu_update_rate": 200.0,
    "accel_noise_std": [0.016, 0.016, 0.017],
    "gyro_noise_std": [0.000282, 0.000282, 0.000282],
    "accel_bias_std": [0.001, 0.001, 0.001],
    "gyro_bias_std": [0.0001, 0.0001, 0.0001],
    "cam_time_offset_ns": 2000000
  }
})";
  temp_folder const folder;
  std::string const path = folder.write("calib.json", json);
  seq::calibration const c = seq::read_calibration(path);
  EXPECT_EQ(c.rig.left.model, seq::lens::double_sphere);
  EXPECT_EQ(c.rig.left.distortion, (std::vector<double>{-0.17, 0.59}));
  EXPECT_EQ(c.rig.right.model, seq::lens::kannala_brandt);
  EXPECT_LT((c.rig.T_left_right.translation() - Eigen::Vector3d(0.096, 0.028, 0)).norm(), 1e-12);
  EXPECT_LT(
      (c.rig.T_body_left * Eigen::Vector3d::UnitX() - Eigen::Vector3d(0.32, 0.89, -0.05)).norm(),
      1e-12);
  ASSERT_TRUE(c.imu);
  EXPECT_EQ(c.imu->noise.accel, 0.017);
  EXPECT_EQ(c.imu->noise.gyro_walk, 0.0001);
  EXPECT_EQ(c.imu_time_offset_s, 0.002);
  ASSERT_EQ(c.warnings.size(), 1U);
  EXPECT_TRUE(contains(c.warnings[0], "calib_accel_bias is not applied"));
  folder.write("calib.json", replaced(json, "\"ds\"", "\"fov\""));
  EXPECT_TRUE(contains(message_of([&] { seq::read_calibration(path); }), "must be pinhole"));
  folder.write("calib.json", replaced(json, "[512, 512], [512, 512]", "[512, 512]"));
  EXPECT_TRUE(contains(message_of([&] { seq::read_calibration(path); }), "resolution is 1 x 2"));
}

TEST(calibration_any, refusals_name_what_is_accepted) {
  temp_folder const folder;
  for (char const* text :
       {"a: 1\n", "{\"rows\": 3}", "<opencv_storage><a>1</a></opencv_storage>"}) {
    std::string const path = folder.write("some.yaml", text);
    std::string const message = message_of([&] { seq::read_calibration(path); });
    for (char const* name : {"Kalibr", "OpenCV", "ROS", "basalt", "rs-enumerate-devices", "DepthAI",
                             "COLMAP", "ORB-SLAM3", "KITTI"}) {
      EXPECT_TRUE(contains(message, name)) << message;
    }
  }
  std::string const path = folder.write("camera.txt", "400 400 320 240\n");
  EXPECT_TRUE(contains(message_of([&] { seq::read_calibration(path, 640, 480); }), "one camera"));
}

}  // namespace
