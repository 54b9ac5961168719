// SPDX-License-Identifier: Apache-2.0
/// @file Layouts of known data sets, as they are when they are downloaded.
#include <gtest/gtest.h>

#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include "examples/sequence/image_io.hpp"
#include "examples/sequence/reader.hpp"
#include "tests/support/sequence.hpp"

namespace reader_layouts_test {

namespace fs = std::filesystem;
using seq_test::contains;
using seq_test::message_of;
using seq_test::put;
using seq_test::temp_folder;
using seq_test::times_of;

using time_list = std::vector<std::int64_t>;

std::string refusal_of(std::string const& folder, seq::open_options const& options = {}) {
  return message_of([&] { seq::sequence::open(folder, options); });
}

seq::open_options as(seq::camera_kind kind) {
  seq::open_options options;
  options.rig = kind;
  return options;
}

/// A depth image of 64 x 48 pixels, all of one value but the first.
void put_depth(temp_folder const& folder, std::string const& name, std::uint16_t value,
               std::uint16_t first) {
  fs::create_directories(fs::path(folder.path(name)).parent_path());
  seq::depth_image depth{64, 48, std::vector<std::uint16_t>(64 * 48, value)};
  depth.pixels[0] = first;
  seq::write_depth_png(folder.path(name), depth);
}

/// "frame-000012", as 7-Scenes names it.
std::string scene_frame(int number) {
  char text[32];
  std::snprintf(text, sizeof text, "frame-%06d", number);
  return text;
}

void write_scene(temp_folder const& folder) {
  folder.write("camera.txt", "58.5 58.5 32 24\n");
  for (int i : {0, 1, 2, 4}) {
    std::string const name = scene_frame(i);
    put(folder, name + ".color.png", i);
    put_depth(folder, name + ".depth.png", 1500, 65535);
    // A quarter turn about z: the camera's x is the world's y.
    folder.write(name + ".pose.txt",
                 "0 -1 0 " + std::to_string(i) + " \n1 0 0 0.5\n0 0 1 -2\n0 0 0 1\n");
  }
}

TEST(reader_seven_scenes, colour_depth_and_poses_go_together) {
  temp_folder const folder;
  write_scene(folder);
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_EQ(s.layout(), "7scenes");
  EXPECT_EQ(s.kind(), seq::camera_kind::rgbd);
  ASSERT_EQ(times_of(s), (time_list{0, 33'333'333, 66'666'667, 133'333'333}));
  EXPECT_EQ(s.depth_unit(), 0.001);
  EXPECT_EQ(s.depth_unit_from(), "as 7-Scenes has it");
  seq::stereo_frame const last = s.load(3);
  EXPECT_EQ(last.left.pixels[0], 4);
  EXPECT_EQ(last.depth.pixels[0], 0);  // 65535
  EXPECT_EQ(last.depth.pixels[1], 1500);
  ASSERT_EQ(s.ground_truth().size(), 4U);
  EXPECT_EQ(s.ground_truth()[3].time_ns, s.time_ns(3));
  Eigen::Vector3d const x(1, 0, 0);
  EXPECT_LT((s.ground_truth()[3].T_world_camera * x - Eigen::Vector3d(4, 1.5, -2)).norm(), 1e-12);
  ASSERT_EQ(s.warnings().size(), 1U);
  EXPECT_TRUE(contains(s.warnings()[0], "30 images a second are assumed")) << s.warnings()[0];
  EXPECT_TRUE(contains(seq::describe(s)[0].text, "7-Scenes; calibration camera.txt"));

  seq::open_options options;
  options.fps = 10;
  EXPECT_EQ(times_of(seq::sequence::open(folder.path(), options)).back(), 400'000'000);
  EXPECT_TRUE(seq::sequence::open(folder.path(), options).warnings().empty());
  EXPECT_EQ(seq::sequence::open(folder.path(), as(seq::camera_kind::mono)).kind(),
            seq::camera_kind::mono);
  put(folder, "frame-999999999.color.png", 0);
  put_depth(folder, "frame-999999999.depth.png", 1500, 0);
  options.fps = 1e-3;
  EXPECT_TRUE(contains(refusal_of(folder.path(), options), "beyond the limit"));
  options.fps = 0;
  options.times = folder.write("elsewhere/stamps.txt", "0\n1\n2\n3\n");
  EXPECT_TRUE(contains(refusal_of(folder.path(), options), "times of their own"));
}

TEST(reader_seven_scenes, says_what_is_missing_or_wrong) {
  temp_folder const folder;
  write_scene(folder);
  fs::remove(folder.path("frame-000001.depth.png"));
  fs::remove(folder.path("frame-000002.color.png"));
  folder.write("frame-000004.pose.txt", "nan 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n");
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_EQ(times_of(s), (time_list{0, 133'333'333}));
  EXPECT_EQ(s.unpaired().left, 1);
  EXPECT_EQ(s.unpaired().right, 1);
  EXPECT_EQ(s.ground_truth().size(), 3U);
  ASSERT_EQ(s.warnings().size(), 2U);
  EXPECT_TRUE(contains(s.warnings()[1], "1 of 4 poses left out")) << s.warnings()[1];

  folder.write("frame-000004.pose.txt", "1 0 0\n");
  EXPECT_TRUE(contains(refusal_of(folder.path()), "3 numbers, must have 16"));
  folder.write("frame-000004.pose.txt", "2 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n");
  EXPECT_TRUE(contains(refusal_of(folder.path()), "frame-000004.pose.txt:4: not a rotation"));
  folder.write("frame-000004.pose.txt", "0 1 0 0\n-1 0 0 0\n0 0 1 0\n4 0.5 -2 1\n");  // transposed
  EXPECT_TRUE(contains(refusal_of(folder.path()), "the fourth row is not 0 0 0 1"));
  folder.write("frame-000004.pose.txt", "x 0 0 0\n");
  EXPECT_TRUE(contains(refusal_of(folder.path()), "'x' is not a number"));
  fs::remove(folder.path("frame-000004.pose.txt"));
  EXPECT_TRUE(
      contains(refusal_of(folder.path(), as(seq::camera_kind::stereo)), "no second camera"));
  seq::write_png(folder.path("other-0.color.png"), {64, 48, std::vector<std::uint8_t>(64 * 48)});
  EXPECT_TRUE(contains(refusal_of(folder.path()), "same frame number"));
  fs::remove(folder.path("other-0.color.png"));
  fs::remove(folder.path("camera.txt"));
  std::string const missing = refusal_of(folder.path());
  EXPECT_TRUE(contains(missing, "accepted are Kalibr's")) << missing;
  EXPECT_TRUE(contains(missing, "585 585 320 240")) << missing;
  for (int i : {0, 4}) { fs::remove(folder.path(scene_frame(i) + ".depth.png")); }
  fs::remove(folder.path("frame-000002.depth.png"));
  EXPECT_TRUE(contains(refusal_of(folder.path(), as(seq::camera_kind::rgbd)), "7-Scenes"));
}

/// A recording of the TUM RGB-D benchmark, of two frames, in a folder of that name.
std::string write_benchmark(temp_folder const& parent, std::string const& name) {
  std::string rgb = "# color images\n# file: 'x.bag'\n# timestamp filename\n";
  std::string depth = "# depth maps\n";
  for (int i = 0; i < 2; ++i) {
    std::string const file = "130503110" + std::to_string(i) + ".175304.png";
    fs::create_directories(parent.path(name + "/rgb"));
    seq::write_png(parent.path(name + "/rgb/" + file),
                   {640, 480, std::vector<std::uint8_t>(640 * 480, 50)});
    fs::create_directories(parent.path(name + "/depth"));
    seq::write_depth_png(parent.path(name + "/depth/" + file),
                         {640, 480, std::vector<std::uint16_t>(640 * 480, 10000)});
    rgb += "130503110" + std::to_string(i) + ".175304 rgb/" + file + "\n";
    depth += "130503110" + std::to_string(i) + ".160407 depth/" + file + "\n";
  }
  parent.write(name + "/rgb.txt", rgb);
  parent.write(name + "/depth.txt", depth);
  parent.write(name + "/accelerometer.txt", "# timestamp ax ay az\n1305031100.1 0 0 9.81\n");
  parent.write(name + "/groundtruth.txt",
               "1305031100.1758 1.3 0.6 1.6 0.6132 0.5962 -0.3311 -0.3986\n");
  return parent.path(name);
}

TEST(reader_tum, the_benchmarks_own_recordings_have_its_calibration) {
  temp_folder const folder;
  struct camera_case {
    std::string name;
    double fx, cy;
    seq::lens model;
  };
  for (camera_case const& c :
       {camera_case{"rgbd_dataset_freiburg1_xyz", 517.3, 255.3, seq::lens::radial_tangential},
        camera_case{"rgbd_dataset_freiburg2_desk", 520.9, 249.7, seq::lens::radial_tangential},
        camera_case{"rgbd_dataset_freiburg3_long_office_household", 535.4, 247.6,
                    seq::lens::pinhole}}) {
    std::string const at = write_benchmark(folder, c.name);
    seq::sequence const s = seq::sequence::open(at);
    EXPECT_EQ(s.kind(), seq::camera_kind::rgbd);
    EXPECT_EQ(s.raw_rig().left.fx, c.fx);
    EXPECT_EQ(s.raw_rig().left.cy, c.cy);
    EXPECT_EQ(s.raw_rig().left.model, c.model);
    if (c.model == seq::lens::radial_tangential) {
      EXPECT_EQ(s.raw_rig().left.distortion.size(), 5U);
    }
    ASSERT_EQ(s.warnings().size(), 1U);
    EXPECT_TRUE(contains(s.warnings()[0], "TUM publishes of freiburg" + c.name.substr(21, 1)))
        << s.warnings()[0];
    EXPECT_TRUE(contains(seq::describe(s)[0].text, "as TUM publishes it"));
    folder.write(c.name + "/camera.txt", "500 500 320 240\n");
    EXPECT_EQ(seq::sequence::open(at).raw_rig().left.fx, 500);
    EXPECT_TRUE(seq::sequence::open(at).warnings().empty());
  }
  for (char const* other : {"desk", "rgbd_dataset_freiburg4_desk", "rgbd_dataset_freiburg"}) {
    std::string const refused = refusal_of(write_benchmark(folder, other));
    EXPECT_TRUE(contains(refused, "camera.txt: no such file; accepted are Kalibr's")) << refused;
  }
}

TEST(reader_tum_vi, fisheye_of_16_bits_with_the_imu) {
  temp_folder const folder;
  constexpr std::int64_t first = 1'520'530'308'199'447'626;
  for (std::string const camera : {"mav0/cam0/", "mav0/cam1/"}) {
    std::string list = "#timestamp [ns],filename\n";
    for (int i = 0; i < 3; ++i) {
      std::string const time = std::to_string(first + i * 50'000'000LL);
      put_depth(folder, camera + "data/" + time + ".png", 40'000,
                static_cast<std::uint16_t>(256 * (200 + i) + 7));
      list += time + "," + time + ".png\n";
    }
    folder.write(camera + "data.csv", list);
  }
  std::string samples = "#timestamp [ns],w,a\n";
  std::string poses = "#timestamp [ns],p,q\n";
  for (int i = 0; i < 30; ++i) {
    std::string const time = std::to_string(first + i * 5'000'000LL);
    samples += time + ",0,0,0,0,0,9.81\n";
    poses += time + ",1,2,3,1,0,0,0\n";
  }
  folder.write("mav0/imu0/data.csv", samples);
  folder.write("mav0/mocap0/data.csv", poses);
  std::string const rows = "  - [0, 1, 0, 0]\n  - [0, 0, 1, 0]\n  - [0, 0, 0, 1]\n";
  std::string const camera =
      "  camera_model: pinhole\n  distortion_coeffs: [0.003, 0.0007, -0.002, 0.0002]\n"
      "  distortion_model: equidistant\n  intrinsics: [19, 19, 32, 24]\n  resolution: [64, 48]\n";
  folder.write("dso/camchain.yaml", "cam0:\n" + camera + "  T_cam_imu:\n  - [1, 0, 0, 0.05]\n" +
                                        rows + "cam1:\n" + camera +
                                        "  T_cam_imu:\n  - [1, 0, 0, -0.05]\n" + rows +
                                        "  T_cn_cnm1:\n  - [1, 0, 0, -0.1]\n" + rows);
  folder.write("dso/imu_config.yaml",
               "rostopic: /imu0\nupdate_rate: 200.0\naccelerometer_noise_density: 0.0028\n"
               "accelerometer_random_walk: 0.00086\ngyroscope_noise_density: 0.00016\n"
               "gyroscope_random_walk: 0.000022\n");
  seq::open_options options;
  options.read_imu = true;
  seq::sequence const s = seq::sequence::open(folder.path(), options);
  EXPECT_EQ(s.kind(), seq::camera_kind::stereo);
  EXPECT_TRUE(s.fisheye());
  EXPECT_NEAR(s.rig().baseline(), 0.1, 1e-12);
  EXPECT_EQ(s.load(2).right.pixels[0], 202);
  EXPECT_EQ(s.load(2).left.pixels[1], 40'000 / 256);
  EXPECT_EQ(s.warnings(), std::vector<std::string>{});
  ASSERT_TRUE(s.imu());
  EXPECT_EQ(s.imu()->samples.size(), 30U);
  EXPECT_EQ(s.imu()->calibration.noise.gyro, 0.00016);
  EXPECT_EQ(s.imu()->calibration.rate_hz, 200);
  EXPECT_LT((s.imu()->T_imu_left.translation() - Eigen::Vector3d(-0.05, 0, 0)).norm(), 1e-12);
  EXPECT_EQ(s.ground_truth().size(), 30U);
}

TEST(reader_open_loris, colour_and_aligned_depth) {
  temp_folder const folder;
  std::string colours = "#Time Path\n";
  std::string depths = colours;
  for (int i = 0; i < 3; ++i) {
    std::string const time = "1560004885." + std::to_string(100 + 33 * i);
    put(folder, "color/" + time + ".png", i);
    put_depth(folder, "aligned_depth/" + time + ".png", 2000, 65535);
    put_depth(folder, "depth/" + time + ".png", 9, 9);
    colours += time + " color/" + time + ".png\n";
    depths += time + " aligned_depth/" + time + ".png\n";
  }
  folder.write("color.txt", colours);
  folder.write("aligned_depth.txt", depths);
  folder.write("depth.txt", "1560004885.100 depth/1560004885.100.png\n");
  folder.write("camera.txt", "40 40 32 24\n");
  // The base turns by 90 degrees about z, which points up.
  folder.write("groundtruth.txt",
               "1560004885.1 1 2 0 0 0 0 1\n1560004885.15 3 2 0 0 0 0.70710678 0.70710678\n");
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_EQ(s.layout(), "openloris");
  EXPECT_EQ(s.kind(), seq::camera_kind::rgbd);
  ASSERT_EQ(s.size(), 3);
  EXPECT_EQ(s.time_ns(1), 1'560'004'885'133'000'000);
  EXPECT_EQ(s.load(2).left.pixels[0], 2);
  EXPECT_EQ(s.load(2).depth.pixels[1], 2000);
  EXPECT_EQ(s.depth_unit(), 0.001);
  EXPECT_EQ(s.depth_unit_from(), "as OpenLORIS has it");
  // The truth is of the robot's base, whose axes and place are not the camera's.
  ASSERT_EQ(s.warnings().size(), 1U);
  EXPECT_TRUE(contains(s.warnings()[0], "robot's base (base_link)")) << s.warnings()[0];
  ASSERT_EQ(s.ground_truth().size(), 2U);
  EXPECT_FALSE(s.ground_truth_has_orientation());
  Eigen::Isometry3d const turned = s.ground_truth()[1].T_world_camera;
  EXPECT_EQ(turned.translation(), Eigen::Vector3d(3, 2, 0));
  EXPECT_EQ(turned.linear(), Eigen::Matrix3d::Identity());
  EXPECT_EQ(seq::sequence::open(folder.path(), as(seq::camera_kind::mono)).kind(),
            seq::camera_kind::mono);
  EXPECT_TRUE(contains(refusal_of(folder.path(), as(seq::camera_kind::stereo)),
                       "the layout OpenLORIS has no second camera"));
  fs::remove(folder.path("camera.txt"));
  EXPECT_TRUE(contains(refusal_of(folder.path()), "accepted are Kalibr's"));
}

void write_icl(temp_folder const& folder) {
  std::string pairs;
  std::string poses;
  for (int i = 0; i < 4; ++i) {
    std::string const n = std::to_string(i);
    put(folder, "rgb/" + n + ".png", i);
    put_depth(folder, "depth/" + n + ".png", 10000, 10000);
    pairs += n + " depth/" + n + ".png " + n + " rgb/" + n + ".png\n";
    // A turn about x, by 2 atan(0.75), and one step a frame.
    if (i > 0) { poses += n + " 0.5 " + n + " -2.25 0.6 0 0 0.8\n"; }
  }
  folder.write("associations.txt", pairs);
  folder.write("livingRoom2.gt.freiburg", poses);
  folder.write("camera.txt", "48.12 -48 31.95 23.95\n");
}

TEST(reader_icl_nuim, its_y_axis_points_up_and_its_stamps_count_frames) {
  temp_folder const folder;
  write_icl(folder);
  std::string const refused = refusal_of(folder.path());
  EXPECT_TRUE(contains(refused, "associations.txt: the time stamps count frames")) << refused;
  EXPECT_TRUE(contains(refused, "--fps 30")) << refused;
  seq::open_options options;
  options.fps = 30;
  seq::sequence const s = seq::sequence::open(folder.path(), options);
  EXPECT_EQ(s.layout(), "tum");
  EXPECT_EQ(times_of(s), (time_list{0, 33'333'333, 66'666'667, 100'000'000}));
  EXPECT_EQ(s.raw_rig().left.fy, 48);
  EXPECT_EQ(s.load(3).left.pixels[0], 3);
  EXPECT_EQ(s.depth_unit(), 1.0 / 5000);
  ASSERT_EQ(s.warnings().size(), 1U);
  EXPECT_TRUE(contains(s.warnings()[0], "fy is -48, as ICL-NUIM has it")) << s.warnings()[0];
  ASSERT_EQ(s.ground_truth().size(), 3U);
  EXPECT_EQ(s.ground_truth()[1].time_ns, s.time_ns(2));
  // A point that the files' camera sees at a pixel is seen there by ours, its world mirrored.
  Eigen::Isometry3d theirs = Eigen::Isometry3d::Identity();
  theirs.linear() = Eigen::Quaterniond(0.8, 0.6, 0, 0).toRotationMatrix();
  theirs.translation() = Eigen::Vector3d(0.5, 2, -2.25);
  Eigen::Vector3d const seen = theirs * Eigen::Vector3d(0.3, 0.4, 2);
  Eigen::Vector3d const mirrored(seen.x(), -seen.y(), seen.z());
  Eigen::Vector3d const ours = s.ground_truth()[1].T_world_camera.inverse() * mirrored;
  EXPECT_LT((ours - Eigen::Vector3d(0.3, -0.4, 2)).norm(), 1e-12);

  folder.write("camera.txt", "48.12 48 31.95 23.95\n");  // its poses are the same ones
  seq::sequence const same = seq::sequence::open(folder.path(), options);
  EXPECT_TRUE(same.warnings().empty());
  EXPECT_EQ(same.ground_truth()[1].T_world_camera.matrix(),
            s.ground_truth()[1].T_world_camera.matrix());
  folder.write("camera.txt", "48.12 -48 31.95 23.95 0.1 0 0 0\n");
  EXPECT_TRUE(contains(refusal_of(folder.path(), options), "fy = -48: must be above 0"));
  fs::remove(folder.path("camera.txt"));
  EXPECT_TRUE(contains(refusal_of(folder.path(), options), "481.2 -480 319.5 239.5"));
}

TEST(reader_folders, one_number_of_two_images_is_refused) {
  seq::open_options options;
  options.fps = 30;
  for (auto const& [a, b] : std::vector<std::pair<std::string, std::string>>{
           {"rgb_0001.png", "depth_0001.png"},
           {"left 12.png", "right 12.png"},
           {"1305031102.1753_rgb.png", "1305031102.1753_d.png"}}) {
    temp_folder const folder;
    folder.write("camera.txt", "40 40 32 24\n");
    put(folder, "images/" + a, 1);
    put(folder, "images/" + b, 2);
    for (double const fps : {30.0, 0.0}) {
      options.fps = fps;
      std::string const message = refusal_of(folder.path(), options);
      EXPECT_TRUE(contains(message, "have one number")) << message;
      EXPECT_TRUE(contains(message, "accepted are one image of each number")) << message;
    }
  }
  temp_folder const folder;  // dates, then what tells images apart
  folder.write("camera.txt", "40 40 32 24\n");
  put(folder, "images/20230101_120000_7.png", 1);
  put(folder, "images/20230101_120000_8.png", 2);
  options.fps = 30;
  EXPECT_EQ(seq::sequence::open(folder.path(), options).size(), 2);
}

}  // namespace reader_layouts_test
