// SPDX-License-Identifier: Apache-2.0
/// @file Drives of KITTI's raw data, as they are when they are downloaded.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "examples/sequence/reader.hpp"
#include "tests/support/sequence.hpp"

namespace reader_kitti_raw_test {

namespace fs = std::filesystem;
using seq_test::contains;
using seq_test::message_of;
using seq_test::put;
using seq_test::temp_folder;
using seq_test::times_of;

using time_list = std::vector<std::int64_t>;

std::string refusal_of(std::string const& folder) {
  return message_of([&] { seq::sequence::open(folder); });
}

/// A drive of two rectified pairs; `date`/drive, and the calibration in `date`.
std::string write_raw_drive(temp_folder const& date, int left) {
  std::string const drive = "2011_09_26_drive_0001_sync/";
  for (int side = 0; side < 2; ++side) {
    std::string const camera = drive + "image_0" + std::to_string(left + side) + "/";
    for (int i = 0; i < 2; ++i) {
      put(date, camera + "data/000000000" + std::to_string(i) + ".png", 100 * side + i);
    }
    date.write(camera + "timestamps.txt",
               "2011-09-26 13:02:25.964389445\n2011-09-26 13:02:26.067000001\n");
  }
  std::string cameras = "calib_time: 09-Jan-2012 13:57:47\ncorner_dist: 9.95e-02\n";
  for (int n = 0; n < 4; ++n) {
    std::string const number = "0" + std::to_string(n) + ": ";
    cameras += "S_" + number + "99 77\nS_rect_" + number + "64 48\nR_rect_" + number +
               "1 0 0 0 1 0 0 0 1\nP_rect_" + number + "40 0 32 " + std::to_string(-20 * n) +
               " 0 40 24 0 0 0 1 0\n";
  }
  date.write("calib_cam_to_cam.txt", cameras);
  // The camera looks along the IMU's x; its x is the IMU's -y.
  date.write("calib_velo_to_cam.txt", "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 0 -0.25\n");
  date.write("calib_imu_to_velo.txt", "R: 1 0 0 0 1 0 0 0 1\nT: -0.75 0 0\n");
  std::string const rest = " 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 4 10 4 4 0\n";
  date.write(drive + "oxts/data/0000000000.txt", "49 8 100 0 0 0" + rest);
  date.write(drive + "oxts/data/0000000001.txt",
             "49.00001 8.00002 101 0 0 1.5707963267948966" + rest);
  date.write(drive + "oxts/timestamps.txt",
             "2011-09-26 13:02:25.951199337\n2011-09-26 13:02:26.051383360\n");
  return date.path(drive);
}

TEST(reader_kitti_raw, dates_calibration_around_it_and_oxts) {
  for (int const left : {0, 2}) {
    temp_folder const date;
    std::string const drive = write_raw_drive(date, left);
    seq::sequence const s = seq::sequence::open(drive);
    EXPECT_EQ(s.layout(), "kitti_raw");
    EXPECT_EQ(s.kind(), seq::camera_kind::stereo);
    // date -u -d '2011-09-26 13:02:25' +%s
    EXPECT_EQ(times_of(s), (time_list{1'317'042'145'964'389'445, 1'317'042'146'067'000'001}));
    EXPECT_NEAR(s.rig().baseline(), 0.5, 1e-12);
    EXPECT_EQ(s.load(1).right.pixels[0], 101);
    EXPECT_EQ(s.warnings(), std::vector<std::string>{});
    ASSERT_EQ(s.ground_truth().size(), 2U);
    EXPECT_TRUE(s.ground_truth_has_orientation());
    EXPECT_EQ(s.ground_truth()[0].time_ns, 1'317'042'145'951'199'337);
    // Camera 0 is 1 m in front of the IMU; the left camera is 0.5 m a number to the right of it.
    double const aside = -0.5 * left;
    Eigen::Isometry3d const first = s.ground_truth()[0].T_world_camera;
    EXPECT_LT((first.translation() - Eigen::Vector3d(1, aside, 0)).norm(), 1e-12);
    EXPECT_LT((first.linear() * Eigen::Vector3d::UnitZ() - Eigen::Vector3d::UnitX()).norm(), 1e-12);
    // 1e-5 degrees are 1.113 m along a meridian, 2e-5 along the parallel of 49 degrees 1.461 m.
    Eigen::Isometry3d const second = s.ground_truth()[1].T_world_camera;
    EXPECT_LT((second.translation() - Eigen::Vector3d(1.4606 - aside, 1.1132 + 1, 1)).norm(), 1e-3);
    EXPECT_LT((second.linear() * Eigen::Vector3d::UnitZ() - Eigen::Vector3d::UnitY()).norm(),
              1e-12);
  }
}

TEST(reader_kitti_raw, says_what_is_missing_or_wrong) {
  temp_folder const date;
  std::string const drive = write_raw_drive(date, 0);
  std::string const inside = "2011_09_26_drive_0001_sync/";
  fs::remove(date.path("calib_imu_to_velo.txt"));
  seq::sequence const s = seq::sequence::open(drive);
  EXPECT_FALSE(s.ground_truth_has_orientation());
  EXPECT_EQ(s.ground_truth()[1].T_world_camera.linear(), Eigen::Matrix3d::Identity());
  ASSERT_EQ(s.warnings().size(), 1U);
  EXPECT_TRUE(contains(s.warnings()[0], "calib_imu_to_velo.txt")) << s.warnings()[0];
  for (char const* wrong :
       {"2011-13-26 13:02:25.9", "2011-09-26 24:02:25.9", "noon", "2011-09-26",
        "2011-09-26 13:02:2x.9", "2200-09-26 13:02:46e8", "2011-02-29 13:02:25.9",
        "2012-02-30 13:02:25.9", "2100-02-29 13:02:25.9", "2011-04-31 13:02:25.9",
        "2011-01-32 13:02:25.9"}) {
    date.write(inside + "image_00/timestamps.txt", std::string(wrong) + "\n");
    std::string const refused = refusal_of(drive);
    EXPECT_TRUE(contains(refused, "timestamps.txt:1: ")) << refused;
  }
  date.write(inside + "image_00/timestamps.txt", "2012-02-29 00:00:00\n2012-03-01 00:00:00.5\n");
  time_list const leap = times_of(seq::sequence::open(drive));
  EXPECT_EQ(leap[1] - leap[0], 86'400'500'000'000);
  // The same files as plain folders: with times that are named.
  seq::open_options options;
  options.times = date.path(inside + "image_00/timestamps.txt");
  options.calibration = date.path("calib_cam_to_cam.txt");
  EXPECT_EQ(times_of(seq::sequence::open(drive, options)), leap);
  std::string cameras = "S_rect_00: 99 77\nP_rect_00: 40 0 32 0 0 40 24 0 0 0 1 0\n";
  date.write("calib_cam_to_cam.txt", cameras + "P_rect_01: 40 0 32 -9 0 40 24 0 0 0 1 0\n");
  EXPECT_TRUE(contains(refusal_of(drive), "S_rect_00 is 99 x 77, the images are 64 x 48"));
  EXPECT_TRUE(contains(refusal_of(drive), "a drive named _sync"));
  date.write("calib_cam_to_cam.txt", "S_rect_00: 1e300 48.5\n");
  EXPECT_TRUE(contains(refusal_of(drive), "S_rect_00 is 1e+300 x 48.5"));
  fs::remove(date.path("calib_cam_to_cam.txt"));
  std::string const missing = refusal_of(drive);
  EXPECT_TRUE(contains(missing, "calib_cam_to_cam.txt: no such file; accepted are")) << missing;
}

}  // namespace reader_kitti_raw_test
