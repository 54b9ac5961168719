// SPDX-License-Identifier: Apache-2.0
/// @file Plain folders of images, with times from names, files or a rate, and any calibration.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <string>
#include <tuple>
#include <vector>

#include "examples/sequence/image_io.hpp"
#include "examples/sequence/reader.hpp"
#include "tests/support/sequence.hpp"

namespace {

namespace fs = std::filesystem;
using seq_test::contains;
using seq_test::message_of;
using seq_test::put;
using seq_test::replaced;
using seq_test::temp_folder;
using seq_test::times_of;

std::string const stereo_yaml =
    "%YAML:1.0\n---\nK1: [[40, 0, 32], [0, 40, 24], [0, 0, 1]]\nD1: [0, 0, 0, 0, 0]\nK2: [[40, 0, "
    "32], [0, 40, 24], [0, 0, 1]]\nD2: [0, 0, 0, 0, 0]\nR: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nT: "
    "[-0.1, 0, 0]\n";

/// First pixels of left and right, or of one camera twice.
std::vector<std::pair<int, int>> pixels_of(seq::sequence const& s) {
  std::vector<std::pair<int, int>> all;
  for (int i = 0; i < s.size(); ++i) {
    auto const frame = s.load(i);
    bool const pair = s.kind() == seq::camera_kind::stereo;
    all.emplace_back(frame.left.pixels[0], (pair ? frame.right : frame.left).pixels[0]);
  }
  return all;
}

using pixel_pairs = std::vector<std::pair<int, int>>;
using time_list = std::vector<std::int64_t>;

TEST(reader_folders, pairs_of_any_usual_names_with_the_calibration_beside) {
  for (auto const& [left, right] :
       std::vector<std::pair<std::string, std::string>>{{"left", "right"},
                                                        {"cam0", "cam1"},
                                                        {"image_0", "image_1"},
                                                        {"left/data", "right/data"}}) {
    temp_folder const folder;
    folder.write("stereo.yaml", stereo_yaml);
    for (int i = 0; i < 3; ++i) {
      std::string const ns = "/14036365" + std::to_string(70 + i) + "763555584.png";
      put(folder, left + ns, i);
      put(folder, right + ns, 100 + i);
    }
    if (left == "image_0") {
      seq::open_options options;
      options.fps = 10;
      EXPECT_EQ(times_of(seq::sequence::open(folder.path(), options)),
                (time_list{0, 100'000'000, 200'000'000}));
      continue;
    }
    seq::sequence const s = seq::sequence::open(folder.path());
    EXPECT_EQ(s.layout(), "folders") << left;
    EXPECT_EQ(s.kind(), seq::camera_kind::stereo);
    EXPECT_NEAR(s.rig().baseline(), 0.1, 1e-12);
    EXPECT_EQ(pixels_of(s), (pixel_pairs{{0, 100}, {1, 101}, {2, 102}}));
    EXPECT_EQ(s.time_ns(1), 1'403'636'571'763'555'584);
    EXPECT_TRUE(s.warnings().empty());
    EXPECT_TRUE(contains(s.source().calibration, "stereo.yaml"));
    EXPECT_EQ(s.source().stamps, "file names, nanoseconds");
  }
}

TEST(reader_folders, names_of_pairs_in_any_case_and_by_their_last_word) {
  for (auto const& [left, right] : std::vector<std::pair<std::string, std::string>>{
           {"LEFT", "RIGHT"},
           {"Left", "right"},
           {"Cam0", "Cam1"},
           {"cam_left", "cam_right"},
           {"camera_left", "camera_right"},
           {"RGB_Left", "RGB_Right"},
           {"stereo-left/data", "stereo-right/data"}}) {
    temp_folder const folder;
    folder.write("stereo.yaml", stereo_yaml);
    put(folder, left + "/1.5.png", 1);
    put(folder, right + "/1.5.png", 2);
    seq::sequence const s = seq::sequence::open(folder.path());
    EXPECT_EQ(s.kind(), seq::camera_kind::stereo) << left;
    EXPECT_EQ(pixels_of(s), (pixel_pairs{{1, 2}})) << left;
  }
  temp_folder const folder;
  folder.write("stereo.yaml", stereo_yaml);
  for (char const* name : {"ir_left", "ir_right", "rgb_left", "rgb_right"}) {
    put(folder, std::string(name) + "/1.5.png", 1);
  }
  std::string const refused = message_of([&] { seq::sequence::open(folder.path()); });
  EXPECT_TRUE(contains(refused, "several pairs of folders, such as ir_left and rgb_left"))
      << refused;
  put(folder, "left/1.5.png", 1);
  put(folder, "right/1.5.png", 2);
  EXPECT_EQ(pixels_of(seq::sequence::open(folder.path())), (pixel_pairs{{1, 2}}));
  fs::remove_all(folder.path("left"));
  fs::remove_all(folder.path("ir_left"));
  fs::remove_all(folder.path("rgb_left"));  // a right camera alone
  EXPECT_TRUE(
      contains(message_of([&] { seq::sequence::open(folder.path()); }), "no sequence found"));
}

TEST(reader_folders, names_that_differ_in_case_alone_are_refused) {
  for (auto const& [left, right, same] :
       std::vector<std::tuple<std::string, std::string, std::string>>{
           {"left", "right", "LEFT and left"},
           {"right", "left", "RIGHT and right"},
           {"ir_left", "ir_right", "IR_LEFT and ir_left"}}) {
    temp_folder const folder;
    folder.write("stereo.yaml", stereo_yaml);
    std::string const upper = same.substr(0, left.size());
    put(folder, left + "/1.5.png", 1);
    put(folder, right + "/1.5.png", 2);
    put(folder, "Notes/1.5.png", 3);  // of no camera
    put(folder, "notes/1.5.png", 3);
    fs::create_directories(folder.path(upper));  // without images
    if (fs::equivalent(folder.path(upper), folder.path(left))) {
      GTEST_SKIP() << "the disk takes upper and lower case for the same";
    }
    EXPECT_EQ(seq::sequence::open(folder.path()).kind(), seq::camera_kind::stereo);
    put(folder, upper + "/1.5.png", 1);
    std::string const refused = message_of([&] { seq::sequence::open(folder.path()); });
    EXPECT_TRUE(contains(refused, same + " differ in upper and lower case")) << refused;
    EXPECT_TRUE(contains(refused, "accepted is one folder")) << refused;
  }
}

TEST(reader_folders, times_in_names_have_their_unit_told_apart) {
  struct unit_case {
    std::string first, second, unit;
    std::int64_t first_ns, step_ns;
  };
  for (unit_case const& c : std::vector<unit_case>{
           {"1403636579", "1403636580", "seconds", 1'403'636'579'000'000'000, 1'000'000'000},
           {"1403636579763", "1403636579813", "milliseconds", 1'403'636'579'763'000'000,
            50'000'000},
           {"1403636579763555", "1403636579813555", "microseconds", 1'403'636'579'763'555'000,
            50'000'000},
           {"1403636579763555584", "1403636579813555584", "nanoseconds", 1'403'636'579'763'555'584,
            50'000'000},
           {"1305031102.175304", "1305031102.275304", "seconds", 1'305'031'102'175'304'000,
            100'000'000},
           {"4500000000", "4550000000", "whole numbers", 4'500'000'000,
            50'000'000},                                                           // ns since boot
           {"35200123", "35250123", "whole numbers", 35'200'123'000, 50'000'000},  // us since boot
           {"frame_100", "frame_133", "whole numbers", 100'000'000, 33'000'000},   // ms
       }) {
    temp_folder const folder;
    folder.write("camera.txt", "40 40 32 24\n");
    put(folder, "images/" + c.first + ".png", 1);
    put(folder, "images/" + c.second + ".png", 2);
    seq::sequence const s = seq::sequence::open(folder.path());
    EXPECT_EQ(s.kind(), seq::camera_kind::mono);
    EXPECT_EQ(times_of(s), (time_list{c.first_ns, c.first_ns + c.step_ns})) << c.first;
    EXPECT_EQ(s.source().stamps, "file names, " + c.unit);
    EXPECT_EQ(pixels_of(s), (pixel_pairs{{1, 1}, {2, 2}}));
  }
}

TEST(reader_folders, numbers_need_a_rate_or_a_file_of_times) {
  temp_folder const folder;
  folder.write("calib.txt", "P0: 40 0 32 0 0 40 24 0 0 0 1 0\nP1: 40 0 32 -4 0 40 24 0 0 0 1 0\n");
  for (int i : {8, 9, 10, 12}) {  // not padded: 10 comes after 9
    put(folder, "left/frame" + std::to_string(i) + "_l.png", i);
    put(folder, "right/frame" + std::to_string(i) + "_r.png", 100 + i);
  }
  put(folder, "left/frame11_l.png", 11);  // without a partner
  std::string const message = message_of([&] { seq::sequence::open(folder.path()); });
  EXPECT_TRUE(contains(message, "--fps")) << message;
  EXPECT_TRUE(contains(message, "frame8_l.png")) << message;

  seq::open_options options;
  options.fps = 20;
  seq::sequence const s = seq::sequence::open(folder.path(), options);
  EXPECT_EQ(times_of(s), (time_list{0, 50'000'000, 100'000'000, 200'000'000}));
  EXPECT_EQ(pixels_of(s), (pixel_pairs{{8, 108}, {9, 109}, {10, 110}, {12, 112}}));
  EXPECT_EQ(s.unpaired().left, 1);
  EXPECT_EQ(s.unpaired().right, 0);

  folder.write("times.txt", "# seconds\n0.5\n0.6\n0.7\n0.8\n0.9\n");
  seq::sequence const listed = seq::sequence::open(folder.path());
  EXPECT_EQ(times_of(listed), (time_list{500'000'000, 600'000'000, 700'000'000, 900'000'000}));
  folder.write("times.txt", "0\n0.05\n0.1\n1\n1.05\n");
  EXPECT_EQ(times_of(seq::sequence::open(folder.path())),
            (time_list{0, 50'000'000, 100'000'000, 1'050'000'000}));
  folder.write("times.txt", "0\n1\n2\n2.5\n3\n");
  EXPECT_EQ(times_of(seq::sequence::open(folder.path())),
            (time_list{0, 1'000'000'000, 2'000'000'000, 3'000'000'000}));
  folder.write("times.txt", "0.5\n0.6\n");
  EXPECT_TRUE(contains(message_of([&] { seq::sequence::open(folder.path()); }),
                       "2 times, must have one for each of 5 images"));
  folder.write("times.txt", "0.5\n7\n0.6\n0.7\n0.8\n");
  EXPECT_TRUE(contains(message_of([&] { seq::sequence::open(folder.path()); }), "times.txt:2"));
  // More lines than images: the images' numbers say which.
  std::string many;
  for (int i = 0; i < 20; ++i) { many += std::to_string(1000 * i) + ".0\n"; }
  options.fps = 0;
  options.times = folder.write("stamps.csv", many);
  EXPECT_EQ(seq::sequence::open(folder.path(), options).time_ns(3), 12'000'000'000'000);
  options.fps = 20;
  EXPECT_TRUE(contains(message_of([&] { seq::sequence::open(folder.path(), options); }),
                       "must be one of them"));
  options.times.clear();
  for (double const fps : {-1.0, 1e6, std::nan("")}) {
    options.fps = fps;
    EXPECT_TRUE(
        contains(message_of([&] { seq::sequence::open(folder.path(), options); }), "fps = "));
  }
}

TEST(reader_folders, names_without_numbers_are_paired_by_order) {
  temp_folder const folder;
  folder.write("stereo.yaml", stereo_yaml);
  for (char const* name : {"a", "b", "c"}) {
    put(folder, std::string("left/") + name + ".png", name[0]);
    put(folder, std::string("right/") + name + ".png", name[0] + 20);
  }
  seq::open_options options;
  options.fps = 1;
  seq::sequence const s = seq::sequence::open(folder.path(), options);
  EXPECT_EQ(pixels_of(s), (pixel_pairs{{'a', 'u'}, {'b', 'v'}, {'c', 'w'}}));
  fs::remove(folder.path("right/b.png"));
  EXPECT_TRUE(contains(message_of([&] { seq::sequence::open(folder.path(), options); }),
                       "3 left and 2 right images"));
}

TEST(reader_folders, stamps_of_the_cameras_are_paired_by_the_nearest) {
  temp_folder const folder;
  folder.write("stereo.yaml", stereo_yaml);
  for (int i = 0; i < 4; ++i) {
    std::string const second = "140363657" + std::to_string(i);
    put(folder, "left/" + second + ".100000.png", i);
    put(folder, "right/" + second + (i == 2 ? ".200000.png" : ".100400.png"), 100 + i);
  }
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_EQ(pixels_of(s), (pixel_pairs{{0, 100}, {1, 101}, {3, 103}}));
  EXPECT_EQ(s.unpaired().left, 1);
  EXPECT_EQ(s.unpaired().right, 1);
  seq::open_options options;
  options.rig = seq::camera_kind::mono;
  EXPECT_EQ(seq::sequence::open(folder.path(), options).size(), 4);
}

TEST(reader_folders, says_what_is_missing) {
  temp_folder const folder;
  put(folder, "left/1.0.png", 1);
  put(folder, "right/1.0.png", 1);
  std::string const message = message_of([&] { seq::sequence::open(folder.path()); });
  EXPECT_TRUE(contains(message, "holds no calibration")) << message;
  EXPECT_TRUE(contains(message, "Kalibr")) << message;
  EXPECT_THROW(seq::sequence::open(folder.path()), seq::missing_calibration);
  temp_folder const elsewhere;
  seq::open_options options;
  options.calibration = elsewhere.write("stereo.yaml", stereo_yaml);
  EXPECT_EQ(seq::sequence::open(folder.path(), options).size(), 1);
  fs::remove_all(folder.path("right"));
  options.rig = seq::camera_kind::stereo;
  EXPECT_TRUE(contains(message_of([&] { seq::sequence::open(folder.path(), options); }),
                       "not a stereo sequence"));
  options.rig = seq::camera_kind::rgbd;
  EXPECT_TRUE(contains(message_of([&] { seq::sequence::open(folder.path(), options); }), "depth"));
}

TEST(reader_folders, imu_is_read_with_kalibrs_chain) {
  std::string const camera =
      "  camera_model: pinhole\n  distortion_coeffs: [0, 0, 0, 0]\n  distortion_model: radtan\n"
      "  intrinsics: [40, 40, 32, 24]\n  resolution: [64, 48]\n";
  std::string const rows = "  - [0, 1, 0, 0]\n  - [0, 0, 1, 0]\n  - [0, 0, 0, 1]\n";
  temp_folder const folder;
  folder.write("camchain.yaml", "cam0:\n  T_cam_imu:\n  - [1, 0, 0, 0.05]\n" + rows +
                                    "  timeshift_cam_imu: 0.0125\n" + camera +
                                    "cam1:\n  T_cn_cnm1:\n  - [1, 0, 0, -0.1]\n" + rows + camera);
  put(folder, "cam0/1.00.png", 1);
  put(folder, "cam1/1.00.png", 2);
  folder.write("imu.csv", "#t,w,a\n900000000,0,0,0,0,0,9.81\n1100000000,0,0,0,0,0,9.81\n");
  seq::open_options options;
  options.read_imu = true;
  seq::sequence s = seq::sequence::open(folder.path(), options);
  EXPECT_FALSE(s.imu());
  EXPECT_TRUE(contains(s.source().imu_left_out, "noise")) << s.source().imu_left_out;
  folder.write(
      "imu.yaml",
      "accelerometer_noise_density: 1.86e-03\naccelerometer_random_walk: 4.33e-04\n"
      "gyroscope_noise_density: 1.87e-04\ngyroscope_random_walk: 2.66e-05\nrostopic: /imu\n"
      "update_rate: 200.0\n");
  s = seq::sequence::open(folder.path(), options);
  ASSERT_TRUE(s.imu());
  EXPECT_EQ(s.imu()->samples.size(), 2U);
  EXPECT_EQ(s.imu()->calibration.time_offset_s, 0.0125);
  EXPECT_LT((s.imu()->T_imu_left.translation() - Eigen::Vector3d(-0.05, 0, 0)).norm(), 1e-12);
  auto const lines = seq::describe(s);
  ASSERT_EQ(lines.size(), 5U);
  EXPECT_TRUE(contains(lines[0].text, "folders of images; calibration camchain.yaml"));
  EXPECT_TRUE(contains(lines[1].text, "stereo pair, 64x48, pinhole, baseline 0.1 m"));
  EXPECT_EQ(lines[2].text, "1 frame; times: file names, seconds");
  EXPECT_EQ(lines[3].text, "2 samples, 200 Hz, its clock is 12.5 ms ahead of the images'");
  EXPECT_EQ(lines[4].text, "none");
}

TEST(reader_kitti, colour_cameras_alone_and_the_trees_poses) {
  temp_folder const tree;
  std::string const at = "sequences/07/";
  tree.write(at + "calib.txt",
             "P2: 40 0 32 4 0 40 24 0 0 0 1 0\nP3: 40 0 32 -16 0 40 24 0 0 0 1 0\n");
  tree.write(at + "times.txt", "0.0\n0.1\n");
  for (int i = 0; i < 2; ++i) {
    put(tree, at + "image_2/00000" + std::to_string(i) + ".png", i);
    put(tree, at + "image_3/00000" + std::to_string(i) + ".png", 100 + i);
  }
  tree.write("poses/07.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n0 -1 0 0 1 0 0 0 0 0 1 2\n");
  seq::sequence const s = seq::sequence::open(tree.path("sequences/07"));
  EXPECT_EQ(s.layout(), "kitti");
  EXPECT_NEAR(s.rig().baseline(), 0.5, 1e-12);
  EXPECT_EQ(pixels_of(s), (pixel_pairs{{0, 100}, {1, 101}}));
  ASSERT_EQ(s.ground_truth().size(), 2U);
  // The poses are camera 0's; camera 2 lies at x = -4 / 40 m of it.
  EXPECT_LT((s.ground_truth()[1].T_world_camera.translation() - Eigen::Vector3d(0, -0.1, 2)).norm(),
            1e-12);
  seq::open_options options;
  options.fps = 10;
  EXPECT_TRUE(contains(message_of([&] { seq::sequence::open(tree.path("sequences/07"), options); }),
                       "times of their own"));
}

}  // namespace
