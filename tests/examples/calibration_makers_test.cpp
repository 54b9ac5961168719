// SPDX-License-Identifier: Apache-2.0
/// @file Calibrations as makers of cameras and of reconstructions write them: RealSense, DepthAI,
/// COLMAP. Units, frames and row orders differ, and the numbers show each mistake.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <string>
#include <vector>

#include "examples/sequence/calibration.hpp"
#include "tests/support/sequence.hpp"

namespace {

using seq_test::contains;
using seq_test::message_of;
using seq_test::replaced;
using seq_test::temp_folder;

std::string refusal(std::string const& path, int width = 0, int height = 0,
                    seq::camera_kind kind = seq::camera_kind::stereo) {
  return message_of([&] { seq::read_calibration(path, width, height, 0, kind); });
}

/// What rs-enumerate-devices -c prints. The right camera is turned by asin(0.6) about z.
std::string const listing =
    "Device info: \n"
    "    Name                          : \tIntel RealSense D435I\n\n"
    "Stream Profiles supported by Stereo Module\n"
    " Supported modes:\n"
    "    STREAM      RESOLUTION  FPS       FORMAT\n"
    "    Infrared 1  1280x800    @ 30Hz    Y8\n\n"
    "Intrinsic Parameters:\n\n"
    " Intrinsic of \"Color\" / 848x480 / {YUYV/RGB8/Y8}\n"
    "  Width:      \t848\n"
    "  Height:     \t480\n"
    "  PPX:        \t421.5\n"
    "  PPY:        \t241.25\n"
    "  Fx:         \t605.5\n"
    "  Fy:         \t604.5\n"
    "  Distortion: \tInverse Brown Conrady\n"
    "  Coeffs:     \t-0.05  \t0.06  \t-0.0007  \t0.0002  \t-0.02  \n"
    "  FOV (deg):  \t69.99 x 43.29\n\n"
    " Intrinsic of \"Infrared 1\" / 848x480 / {Y16}\n"
    "  Width:      \t848\n"
    "  Height:     \t480\n"
    "  PPX:        \t400.5\n"
    "  PPY:        \t230.5\n"
    "  Fx:         \t430.5\n"
    "  Fy:         \t430.5\n"
    "  Distortion: \tModified Brown Conrady\n"
    "  Coeffs:     \t0.1  \t0  \t0  \t0  \t0  \n\n"
    " Intrinsic of \"Infrared 1\" / 848x480 / {UYVY/Y8}\n"
    "  Width:      \t848\n"
    "  Height:     \t480\n"
    "  PPX:        \t422.357269287109\n"
    "  PPY:        \t233.807525634766\n"
    "  Fx:         \t427.259765625\n"
    "  Fy:         \t427.5\n"
    "  Distortion: \tBrown Conrady\n"
    "  Coeffs:     \t0  \t0  \t0  \t0  \t0  \n"
    "  FOV (deg):  \t89.56 x 58.64\n\n"
    " Intrinsic of \"Infrared 1\" / 1280x720 / {Y8}\n"
    "  Width:      \t1280\n"
    "  Height:     \t720\n"
    "  PPX:        \t637.5\n"
    "  PPY:        \t350.5\n"
    "  Fx:         \t644.5\n"
    "  Fy:         \t644.75\n"
    "  Distortion: \tBrown Conrady\n"
    "  Coeffs:     \t0  \t0  \t0  \t0  \t0  \n\n"
    " Intrinsic of \"Infrared 2\" / 848x480 / {Y8}\n"
    "  Width:      \t848\n"
    "  Height:     \t480\n"
    "  PPX:        \t421.5\n"
    "  PPY:        \t232.5\n"
    "  Fx:         \t426.5\n"
    "  Fy:         \t426.5\n"
    "  Distortion: \tBrown Conrady\n"
    "  Coeffs:     \t0  \t0  \t0  \t0  \t0  \n\n"
    "Motion Intrinsic Parameters:\n\n"
    "Motion Intrinsic of \"Gyro\"\t  MOTION_XYZ32F\n"
    "Bias Variances: \t0.1  0.2  0.3  \n"
    "Sensitivity : \n     1.000000       0.000000  \n\n"
    "Extrinsic Parameters:\n"
    "Extrinsic from \"Infrared 1\"\t  To\t  \"Infrared 1\" :\n"
    " Rotation Matrix:\n"
    "   1               0               0            \n"
    "   0               1               0            \n"
    "   0               0               1            \n\n"
    " Translation Vector: 0  0  0  \n\n"
    "Extrinsic from \"Infrared 1\"\t  To\t  \"Infrared 2\" :\n"
    " Rotation Matrix:\n"
    "   0.8            -0.6             0            \n"
    "   0.6             0.8             0            \n"
    "   0               0               1            \n\n"
    " Translation Vector: -0.05  0  0  \n\n"
    "Extrinsic from \"Infrared 1\"\t  To\t  \"Gyro\" :\n"
    " Rotation Matrix:\n"
    "   1               0               0            \n"
    "   0               1               0            \n"
    "   0               0               1            \n\n"
    " Translation Vector: 0.00552  -0.0051  -0.01174  \n\n";

TEST(calibration_realsense, reads_the_pair_at_the_size_of_the_images) {
  temp_folder const folder;
  std::string const path = folder.write("d435i.txt", listing);
  seq::calibration const c = seq::read_calibration(folder.path(), 848, 480);  // found there
  EXPECT_EQ(c.rig.left.model, seq::lens::pinhole);
  EXPECT_EQ(c.rig.left.fx, 427.259765625);  // of Y8, not of the raw Y16
  EXPECT_EQ(c.rig.left.cy, 233.807525634766);
  EXPECT_EQ(c.rig.right.fx, 426.5);
  EXPECT_EQ(c.rig.right.width, 848);
  // The right camera's centre in the left frame: -R^T t, with R in rows as printed.
  Eigen::Vector3d const centre = c.rig.T_left_right.translation();
  EXPECT_LT((centre - Eigen::Vector3d(0.04, -0.03, 0)).norm(), 1e-12) << centre.transpose();
  ASSERT_TRUE(c.has_body_frame);
  EXPECT_LT((c.rig.T_body_left.translation() - Eigen::Vector3d(0.00552, -0.0051, -0.01174)).norm(),
            1e-12);
  EXPECT_TRUE(c.warnings.empty());
  seq::calibration const mono = seq::read_calibration(path, 1280, 720, 0, seq::camera_kind::mono);
  EXPECT_EQ(mono.rig.left.fy, 644.75);
  seq::calibration const rgbd = seq::read_calibration(path, 848, 480, 0, seq::camera_kind::rgbd);
  EXPECT_EQ(rgbd.rig.left.fx, 605.5);
  EXPECT_EQ(rgbd.rig.left.distortion, (std::vector<double>{-0.05, 0.06, -0.0007, 0.0002, -0.02}));
  ASSERT_EQ(rgbd.warnings.size(), 2U);
  EXPECT_TRUE(contains(rgbd.warnings[0], "Inverse Brown Conrady"));
  EXPECT_TRUE(contains(rgbd.warnings[1], "\"Color\""));
}

TEST(calibration_realsense, refusals_name_sizes_lenses_and_streams) {
  temp_folder const folder;
  std::string const path = folder.write("d435i.txt", listing);
  EXPECT_TRUE(contains(refusal(path, 640, 480), "at 640x480; it has 848x480, 1280x720"));
  EXPECT_TRUE(contains(refusal(path), "size is not known"));
  folder.write("d435i.txt", replaced(listing, "\tInverse Brown Conrady", "\tFtheta"));
  EXPECT_TRUE(contains(refusal(path, 848, 480, seq::camera_kind::rgbd),
                       "Distortion is Ftheta: must be Brown Conrady"));
  folder.write("d435i.txt", replaced(listing, "To\t  \"Infrared 2\" :", "To\t  \"Depth\" :"));
  EXPECT_TRUE(contains(refusal(path, 848, 480), "To \"Infrared 2\" is missing"));
  folder.write("d435i.txt", replaced(listing, "-0.05  0  0", "-50  0  nan"));
  EXPECT_TRUE(contains(refusal(path, 848, 480), "not finite"));
}

/// What eepromToJsonFile writes of an OAK-D: left 1 to right 2, right 2 to colour 0.
std::string const eeprom = R"({
  "batchName": "", "boardName": "BW1098OBC", "boardRev": "R0M0E0", "version": 7,
  "cameraData": [
    [2, {"cameraType": 0, "width": 1280, "height": 800, "lensPosition": 0, "specHfovDeg": 71.86,
      "intrinsicMatrix": [[790.5, 0.0, 640.5], [0.0, 791.5, 401.5], [0.0, 0.0, 1.0]],
      "distortionCoeff": [-1.5, 2.5, 0.001, -0.002, 0.5, -1.25, 2.25, 0.75, 0, 0, 0, 0, 0, 0],
      "extrinsics": {"rotationMatrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "toCameraSocket": 0,
        "specTranslation": {"x": 3.75, "y": 0, "z": 0}, "translation": {"x": 3.8, "y": 0, "z": 0}}}],
    [1, {"cameraType": 0, "width": 1280, "height": 800, "lensPosition": 0, "specHfovDeg": 71.86,
      "intrinsicMatrix": [[800.5, 0.0, 650.5], [0.0, 801.5, 410.5], [0.0, 0.0, 1.0]],
      "distortionCoeff": [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
      "extrinsics": {"rotationMatrix": [[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]],
        "toCameraSocket": 2, "specTranslation": {"x": -7.5, "y": 0, "z": 0},
        "translation": {"x": -7.5, "y": 0, "z": 0}}}],
    [0, {"cameraType": 0, "width": 1920, "height": 1080, "lensPosition": 135, "specHfovDeg": 68.8,
      "intrinsicMatrix": [[1480.5, 0.0, 950.5], [0.0, 1481.5, 530.5], [0.0, 0.0, 1.0]],
      "distortionCoeff": [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
      "extrinsics": {"rotationMatrix": [], "toCameraSocket": -1,
        "specTranslation": {"x": 0, "y": 0, "z": 0}, "translation": {"x": 0, "y": 0, "z": 0}}}]],
  "imuExtrinsics": {"rotationMatrix": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], "toCameraSocket": 0,
    "specTranslation": {"x": 0, "y": 0, "z": 0}, "translation": {"x": 1, "y": 2, "z": 3}},
  "stereoRectificationData": {"leftCameraSocket": 1, "rightCameraSocket": 2,
    "rectifiedRotationLeft": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "rectifiedRotationRight": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}
})";

TEST(calibration_depthai, reads_the_pair_in_centimetres_and_the_imu) {
  temp_folder const folder;
  std::string const path = folder.write("oak.json", eeprom);
  seq::calibration const c = seq::read_calibration(folder.path());
  EXPECT_EQ(c.rig.left.fx, 800.5);
  EXPECT_EQ(c.rig.left.cy, 410.5);
  EXPECT_EQ(c.rig.left.model, seq::lens::pinhole);
  EXPECT_EQ(c.rig.right.distortion,
            (std::vector<double>{-1.5, 2.5, 0.001, -0.002, 0.5, -1.25, 2.25, 0.75}));
  // x_right = R x_left + t, t in centimetres: the right camera is at -R^T t.
  Eigen::Vector3d const centre = c.rig.T_left_right.translation();
  EXPECT_LT((centre - Eigen::Vector3d(0.06, -0.045, 0)).norm(), 1e-12) << centre.transpose();
  // The IMU's origin is at (1, 2, 3) cm of the colour camera, the left camera's origin at (-3.7, 0,
  // 0) cm; so the left camera is at R_imu^T ((-3.7, 0, 0) - (1, 2, 3)) in the IMU's frame.
  ASSERT_TRUE(c.has_body_frame);
  Eigen::Vector3d const at = c.rig.T_body_left.translation();
  EXPECT_LT((at - Eigen::Vector3d(0.02, -0.047, -0.03)).norm(), 1e-12) << at.transpose();
  EXPECT_TRUE(c.warnings.empty());
}

TEST(calibration_depthai, scales_to_the_images_and_takes_the_colour_camera_with_depth) {
  temp_folder const folder;
  std::string const path = folder.write("oak.json", eeprom);
  // 1280x800 to 640x360: by 0.5 to 640x400, then 20 rows less at the top.
  seq::calibration const c = seq::read_calibration(path, 640, 360);
  EXPECT_EQ(c.rig.left.height, 360);
  EXPECT_NEAR(c.rig.left.fx, 400.25, 1e-12);
  EXPECT_NEAR(c.rig.left.cx, 325, 1e-12);
  EXPECT_NEAR(c.rig.left.cy, 185, 1e-12);
  ASSERT_EQ(c.warnings.size(), 1U);
  EXPECT_TRUE(contains(c.warnings[0], "calibrated at 1280x800, scaled to 640x360"));
  seq::calibration const rgbd = seq::read_calibration(path, 1920, 1080, 0, seq::camera_kind::rgbd);
  EXPECT_EQ(rgbd.rig.left.fy, 1481.5);
  seq::calibration const mono = seq::read_calibration(path, 1280, 800, 0, seq::camera_kind::mono);
  EXPECT_EQ(mono.rig.left.fy, 801.5);
}

TEST(calibration_depthai, reads_fisheyes_and_refuses_the_rest) {
  temp_folder const folder;
  std::string const path =
      folder.write("oak.json", replaced(eeprom, "\"translation\": {\"x\": -7.5",
                                        "\"lengthUnit\": 2, "
                                        "\"translation\": {\"x\": -7.5"));
  EXPECT_NEAR(seq::read_calibration(path).rig.baseline(), 0.075, 1e-12)
      << "DepthAI ignores the unit";
  folder.write("oak.json", replaced(eeprom, "[2, {\"cameraType\": 0", "[2, {\"cameraType\": 2"));
  EXPECT_TRUE(contains(refusal(path), "must be 0 (perspective) or 1 (fisheye)"));
  folder.write("oak.json", replaced(eeprom, "2.25, 0.75, 0,", "2.25, 0.75, 0.1,"));
  EXPECT_TRUE(contains(refusal(path), "thin prism"));
  folder.write("oak.json", replaced(eeprom, "\"leftCameraSocket\": 1", "\"leftCameraSocket\": -1"));
  EXPECT_TRUE(contains(refusal(path), "names no pair"));
  folder.write("oak.json", replaced(eeprom, "[], \"toCameraSocket\": -1",
                                    "[[1,0,0],[0,1,0],[0,0,1]], \"toCameraSocket\": 1"));
  EXPECT_NEAR(seq::read_calibration(path).rig.baseline(), 0.075, 1e-12) << "a circle of extrinsics";
  folder.write("oak.json", replaced(eeprom, "\"leftCameraSocket\": 1, ", ""));
  EXPECT_TRUE(contains(refusal(path), "leftCameraSocket"));
  std::string fisheye = replaced(eeprom, "[2, {\"cameraType\": 0", "[2, {\"cameraType\": 1");
  fisheye = replaced(fisheye, "-1.5, 2.5, 0.001, -0.002, 0.5, -1.25, 2.25, 0.75",
                     "0.1, 0.2, 0.3, 0.4, 0, 0, 0, 0");
  folder.write("oak.json", fisheye);
  seq::camera_intrinsics const right = seq::read_calibration(path).rig.right;
  EXPECT_EQ(right.model, seq::lens::kannala_brandt);
  EXPECT_EQ(right.distortion, (std::vector<double>{0.1, 0.2, 0.3, 0.4}));
}

std::string const cameras =
    "# Camera list with one line of data per camera:\n"
    "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
    "# Number of cameras: 2\n"
    "1 OPENCV 752 480 458.5 457.5 367.75 248.25 -0.28 0.07 0.0002 1e-05\n"
    "2 SIMPLE_RADIAL 752 480 457.25 380.5 255.5 -0.2\n";
std::string const rigs =
    "# Rig calib list with one line of data per calib:\n"
    "1 2 CAMERA 1 CAMERA 2 1 0.8 0 0 0.6 -0.1 0 0\n";

TEST(calibration_colmap, reads_a_rig_and_moves_the_centre_of_pixels) {
  temp_folder const folder;
  std::string const path = folder.write("cameras.txt", cameras);
  folder.write("rigs.txt", rigs);
  seq::calibration const c = seq::read_calibration(folder.path());
  EXPECT_EQ(c.rig.left.cx, 367.25);  // half a pixel less than COLMAP's
  EXPECT_EQ(c.rig.left.cy, 247.75);
  EXPECT_EQ(c.rig.left.fy, 457.5);
  EXPECT_EQ(c.rig.left.distortion, (std::vector<double>{-0.28, 0.07, 0.0002, 1e-05}));
  EXPECT_EQ(c.rig.right.fy, 457.25);
  EXPECT_EQ(c.rig.right.cx, 380);
  EXPECT_EQ(c.rig.right.distortion, (std::vector<double>{-0.2, 0, 0, 0}));
  // QW first: the turn from left to right is by 2 acos(0.8), cos 0.28, about z.
  Eigen::Vector3d const centre = c.rig.T_left_right.translation();
  EXPECT_LT((centre - Eigen::Vector3d(0.028, -0.096, 0)).norm(), 1e-12) << centre.transpose();
  ASSERT_EQ(c.warnings.size(), 1U);
  EXPECT_TRUE(contains(c.warnings[0], "0.1 is taken for metres"));
  seq::calibration const one = seq::read_calibration(path, 0, 0, 0, seq::camera_kind::mono);
  EXPECT_EQ(one.rig.left.fx, 458.5);
  ASSERT_EQ(one.warnings.size(), 1U);
  EXPECT_TRUE(contains(one.warnings[0], "has 2 cameras; the first, 1, is taken"));
}

TEST(calibration_realsense, a_key_that_is_missing_is_named) {
  temp_folder const folder;
  for (char const* key : {"PPX", "Fy", "Coeffs", "Distortion"}) {
    std::string cut = listing;
    for (std::size_t at = cut.find(key); at != std::string::npos; at = cut.find(key)) {
      cut.erase(at, cut.find('\n', at) + 1 - at);
    }
    std::string const path = folder.write("rs.txt", cut);
    EXPECT_TRUE(contains(refusal(path, 848, 480), std::string(key) + " is missing"))
        << refusal(path, 848, 480);
  }
}

TEST(calibration_files, listings_count_where_there_is_nothing_else) {
  temp_folder const folder;
  folder.write("rs.txt", listing);
  folder.write("oak.json", eeprom);
  EXPECT_TRUE(contains(seq::find_calibration_file(folder.path()), "oak.json"));
}

TEST(calibration_colmap, reads_each_model_and_refuses_others_by_name) {
  struct row {
    char const* text;
    seq::lens model;
    double fy;
    std::vector<double> distortion;
  };
  using seq::lens;
  row const rows[] = {
      {"SIMPLE_PINHOLE 640 480 500 320 240", lens::pinhole, 500, {}},
      {"PINHOLE 640 480 500 501 320 240", lens::pinhole, 501, {}},
      {"RADIAL 640 480 500 320 240 0.1 0.2", lens::radial_tangential, 500, {0.1, 0.2, 0, 0}},
      {"FULL_OPENCV 640 480 500 501 320 240 0.1 0.2 0.3 0.4 0.5 0.6 0.7 0.8",
       lens::radial_tangential,
       501,
       {0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8}},
      {"OPENCV_FISHEYE 640 480 500 501 320 240 0.1 0.2 0.3 0.4",
       lens::kannala_brandt,
       501,
       {0.1, 0.2, 0.3, 0.4}},
      {"SIMPLE_RADIAL_FISHEYE 640 480 500 320 240 0.1", lens::kannala_brandt, 500, {0.1, 0, 0, 0}},
      {"RADIAL_FISHEYE 640 480 500 320 240 0.1 0.2", lens::kannala_brandt, 500, {0.1, 0.2, 0, 0}}};
  temp_folder const folder;
  std::string path;
  for (row const& r : rows) {
    path = folder.write("cameras.txt", std::string("7 ") + r.text + "\n");
    seq::calibration const c = seq::read_calibration(path, 0, 0, 0, seq::camera_kind::mono);
    EXPECT_EQ(c.rig.left.model, r.model) << r.text;
    EXPECT_EQ(c.rig.left.fy, r.fy) << r.text;
    EXPECT_EQ(c.rig.left.cx, 319.5) << r.text;
    EXPECT_EQ(c.rig.left.distortion, r.distortion) << r.text;
  }
  EXPECT_TRUE(contains(refusal(path), "rigs.txt"));
  folder.write("cameras.txt", "1 FOV 640 480 500 501 320 240 0.9\n");
  std::string const message = refusal(path, 0, 0, seq::camera_kind::mono);
  EXPECT_TRUE(contains(message, "FOV: must be one of SIMPLE_PINHOLE, PINHOLE")) << message;
  folder.write("cameras.txt", "1 PINHOLE 640 480 500 320 240\n");
  EXPECT_TRUE(contains(refusal(path), "has 3 parameters, must have 4"));
  folder.write("cameras.txt", cameras);
  folder.write("rigs.txt", "1 1 CAMERA 1\n");
  EXPECT_TRUE(contains(refusal(path), "has no rig of two cameras"));
  folder.write("rigs.txt", "1 1 CAMERA 1\n" + rigs.substr(rigs.find("\n") + 1));
  EXPECT_NEAR(seq::read_calibration(path).rig.baseline(), 0.1, 1e-12);
  folder.write("rigs.txt", rigs + "2" + rigs.substr(rigs.find("\n") + 2));
  EXPECT_TRUE(contains(refusal(path), "a second rig of two cameras"));
  folder.write("rigs.txt", rigs);
  folder.write("cameras.txt", cameras + cameras.substr(cameras.find("\n2 ") + 1));
  EXPECT_TRUE(contains(refusal(path), "camera 2 is there twice"));
}

}  // namespace
