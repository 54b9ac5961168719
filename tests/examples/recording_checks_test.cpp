// SPDX-License-Identifier: Apache-2.0
/// @file Recordings in which something is missing, unused or in another unit: what is said of them.
#include <gtest/gtest.h>

#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/image_io.hpp"
#include "examples/sequence/reader.hpp"
#include "tests/support/sequence.hpp"

namespace recording_checks_test {

namespace fs = std::filesystem;
using seq_test::contains;
using seq_test::message_of;
using seq_test::temp_folder;

void put(temp_folder const& folder, std::string const& name, int w = 64, int h = 48) {
  fs::create_directories(fs::path(folder.path(name)).parent_path());
  auto const pixels = static_cast<std::size_t>(w) * static_cast<std::size_t>(h);
  seq::write_png(folder.path(name), {w, h, std::vector<std::uint8_t>(pixels, 40)});
}

/// A recording in TUM's layout whose depth pixels all have one value.
void write_tum(temp_folder const& folder, std::uint16_t depth, std::string const& comment = "") {
  std::string rgb = comment;
  std::string depths = comment;
  for (int i = 0; i < 3; ++i) {
    std::string const file = std::to_string(i) + ".png";
    std::string const time = std::to_string(100 + 0.1 * i);
    put(folder, "rgb/" + file);
    fs::create_directories(folder.path("depth"));
    seq::write_depth_png(folder.path("depth/" + file),
                         {64, 48, std::vector<std::uint16_t>(64 * 48, depth)});
    rgb += time + " rgb/" + file + "\n";
    depths += time + " depth/" + file + "\n";
  }
  folder.write("rgb.txt", rgb);
  folder.write("depth.txt", depths);
  folder.write("camera.txt", "40 40 31.5 23.5\n");
}

std::vector<std::string> warnings_of(std::string const& folder, seq::open_options const& o = {}) {
  return seq::sequence::open(folder, o).warnings();
}

/// The one warning; empty, and a failure, where there is another number of them.
std::string warning_of(std::string const& folder, seq::open_options const& options = {}) {
  auto const all = warnings_of(folder, options);
  EXPECT_EQ(all.size(), 1U);
  return all.empty() ? std::string() : all.front();
}

seq::open_options as(seq::camera_kind kind) {
  seq::open_options options;
  options.rig = kind;
  return options;
}

TEST(RecordingChecks, ADepthUnitThatNobodySaysIsAGuess) {
  temp_folder const folder;
  write_tum(folder, 2000);  // 2 m in millimetres
  std::string const said = warning_of(folder.path());
  EXPECT_TRUE(contains(said, "--depth-unit 0.001")) << said;
  EXPECT_TRUE(contains(said, "0.0002 m is assumed")) << said;
  EXPECT_TRUE(contains(said, "the median depth is 0.4 m")) << said;
  seq::open_options given;
  given.depth_unit = 0.001;
  EXPECT_TRUE(warnings_of(folder.path(), given).empty());
  folder.write("camera.txt", "# depth in units of 1 mm\n40 40 31.5 23.5\n");
  EXPECT_TRUE(warnings_of(folder.path()).empty());
}

TEST(RecordingChecks, TheBenchmarksOwnRecordingsHaveItsUnit) {
  std::string const comment = "# depth maps\n# file: 'rgbd_dataset_freiburg1_xyz.bag'\n";
  temp_folder const folder;
  write_tum(folder, 10000, comment);  // 2 m
  EXPECT_TRUE(warnings_of(folder.path()).empty());
  write_tum(folder, 1000, comment);  // 0.2 m: of another camera
  EXPECT_TRUE(contains(warning_of(folder.path()), "--depth-unit 0.001"));
  write_tum(folder, 10000, "# freiburg\n");
  EXPECT_TRUE(contains(warning_of(folder.path()), "--depth-unit 0.001"));
  fs::rename(folder.path(), folder.path() + "_rgbd_dataset_freiburg2_desk");
  EXPECT_TRUE(warnings_of(folder.path() + "_rgbd_dataset_freiburg2_desk").empty());
  fs::remove_all(folder.path() + "_rgbd_dataset_freiburg2_desk");
}

TEST(RecordingChecks, AListThatIsMissingIsNamed) {
  temp_folder const folder;
  write_tum(folder, 10000);
  fs::rename(folder.path("depth.txt"), folder.path("kept"));
  EXPECT_TRUE(contains(warning_of(folder.path()), "depth.txt: no such file"));
  EXPECT_TRUE(warnings_of(folder.path(), as(seq::camera_kind::mono)).empty());
  fs::rename(folder.path("kept"), folder.path("depth.txt"));
  fs::rename(folder.path("rgb.txt"), folder.path("kept"));
  seq::open_options rate;
  rate.fps = 10;
  std::string const refused = message_of([&] { seq::sequence::open(folder.path(), rate); });
  EXPECT_TRUE(contains(refused, "rgb.txt: no such file")) << refused;
  rate.rig = seq::camera_kind::mono;
  EXPECT_TRUE(warnings_of(folder.path(), rate).empty());
  fs::remove(folder.path("depth.txt"));
  rate.rig = seq::camera_kind::any;
  EXPECT_TRUE(contains(warning_of(folder.path(), rate), "depth: depth images that are not used"));
}

TEST(RecordingChecks, StampsInTwoUnitsAreToldApart) {
  temp_folder const folder;
  write_tum(folder, 10000);
  folder.write("depth.txt", "0 depth/0.png\n100000000 depth/1.png\n200000000 depth/2.png\n");
  std::string const said = message_of([&] { seq::sequence::open(folder.path()); });
  EXPECT_TRUE(contains(said, "images are 0.1 s apart by rgb.txt and 1e+08 s by depth.txt")) << said;
  EXPECT_TRUE(contains(said, "in one unit?")) << said;
  folder.write("depth.txt", "0 depth/0.png\n0.2 depth/1.png\n");  // late, in the same unit
  EXPECT_FALSE(
      contains(message_of([&] { seq::sequence::open(folder.path()); }), "are both in one unit?"));
}

std::string const pair_yaml =
    "%YAML:1.0\n---\nK1: [[40, 0, 32], [0, 40, 24], [0, 0, 1]]\nD1: [0, 0, 0, 0, 0]\nK2: [[40, 0, "
    "32], [0, 40, 24], [0, 0, 1]]\nD2: [0, 0, 0, 0, 0]\nR: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nT: "
    "[-0.1, 0, 0]\nimage_width: 64\nimage_height: 48\n";
std::string const chain_camera =
    "  camera_model: pinhole\n  distortion_coeffs: [0, 0, 0, 0]\n  distortion_model: radtan\n"
    "  intrinsics: [40, 40, 32, 24]\n  resolution: [64, 48]\n";
std::string const chain_step =
    "  T_cn_cnm1:\n  - [1, 0, 0, -0.1]\n  - [0, 1, 0, 0]\n  - [0, 0, 1, 0]\n  - [0, 0, 0, 1]\n";

TEST(RecordingChecks, ASecondCameraWithoutImagesIsNamed) {
  struct pair_of {
    std::string left, missing, file, text, alone;
  };
  for (pair_of const& p : {
           pair_of{"left/", "right", "stereo.yml", pair_yaml, ""},
           pair_of{"cam0/", "cam1", "camchain.yaml",
                   "cam0:\n" + chain_camera + "cam1:\n" + chain_step + chain_camera,
                   "cam0:\n" + chain_camera},
           pair_of{"image_0/", "image_1", "calib.txt",
                   "P0: 40 0 32 0 0 40 24 0 0 0 1 0\nP1: 40 0 32 -4 0 40 24 0 0 0 1 0\n",
                   "P0: 40 0 32 0 0 40 24 0 0 0 1 0\n"},
       }) {
    SCOPED_TRACE(p.left);
    temp_folder const folder;
    put(folder, p.left + "000000.png");
    put(folder, p.left + "000001.png");
    folder.write("times.txt", "0.0\n0.1\n");
    folder.write(p.file, p.text);
    std::string const said = warning_of(folder.path());
    EXPECT_TRUE(contains(said, "no images of the second one")) << said;
    EXPECT_TRUE(contains(said, p.missing)) << said;
    EXPECT_TRUE(warnings_of(folder.path(), as(seq::camera_kind::mono)).empty());
    if (p.alone.empty()) { continue; }
    folder.write(p.file, p.alone);
    EXPECT_TRUE(warnings_of(folder.path()).empty()) << "a calibration of one camera";
  }
}

TEST(RecordingChecks, WhatIsSaidOfBothCamerasIsSaidOnce) {
  temp_folder const folder;
  put(folder, "left/1.0.png");
  put(folder, "right/1.0.png");
  std::string text = pair_yaml;
  for (char const* name : {"D1", "D2"}) {
    text = seq_test::replaced(text, std::string(name) + ": [0, 0, 0, 0, 0]",
                              std::string(name) + ": [0.01, 0, 0, 0]");
  }
  folder.write("stereo.yml", text);
  EXPECT_TRUE(contains(warning_of(folder.path()), "stereo.yml: D1 and D2: four numbers"));
  text = seq_test::replaced(pair_yaml, "D1: [0, 0, 0, 0, 0]\n", "");
  folder.write("stereo.yml", seq_test::replaced(text, "D2: [0, 0, 0, 0, 0]\n", ""));
  EXPECT_TRUE(contains(warning_of(folder.path()), "beside K1 and K2: taken for a pinhole"));
}

TEST(RecordingChecks, AWordAmongTheNumbersOfACameraIsNamed) {
  temp_folder const folder;
  put(folder, "images/1.00.png");
  seq::open_options options;
  for (char const* text : {"fx 40 40 32 24\n", "40 40 32 24 pixels\n"}) {
    options.calibration = folder.write("mine.txt", std::string("# a camera\n") + text);
    std::string const said = message_of([&] { seq::sequence::open(folder.path(), options); });
    EXPECT_TRUE(contains(said, "mine.txt:2: '")) << said;
    EXPECT_TRUE(contains(said, "is not a number; must be fx fy cx cy")) << said;
  }
  options.calibration = folder.write("mine.txt", "no camera at all\n");
  EXPECT_TRUE(contains(message_of([&] { seq::sequence::open(folder.path(), options); }),
                       "no 'key: value' pairs"));
}

/// What a person may have in place of a recording or a calibration, and what the refusal names.
struct refused_case {
  std::string file;  ///< that is written, with `text`; empty = none
  std::string text;
  std::string open;  ///< what is named
  std::string accepted;
};

TEST(RecordingChecks, EveryRefusedCalibrationSaysWhatIsAccepted) {
  std::string const all = "accepted are Kalibr's chain";
  std::string const chain = "cam0:\n  camera_model: pinhole\n";
  for (refused_case const& c :
       std::vector<refused_case>{{"", "", "gone.yaml", all},
                                 {"a.yaml", "", "a.yaml", all},
                                 {"a.yaml", "one\n", "a.yaml", all},
                                 {"a.yaml", "foo: 1\n", "a.yaml", all},
                                 {"a.yaml", "foo: [1\n", "a.yaml", all},
                                 {"a.yaml", "a: 1\na: 2\n", "a.yaml", all},
                                 {"a.yaml", std::string("\x00\x01\x02", 3), "a.yaml", all},
                                 {"a.yaml", "T_BS: 1\n", "a.yaml", all},
                                 {"a.yaml", chain, "a.yaml", all},
                                 {"a.xml", "<html></html>\n", "a.xml", all},
                                 {"a.xml", "<a\n", "a.xml", all},
                                 {"a.json", "{\"value0\": {\"T_i_c\": []}}\n", "a.json", all},
                                 {"a.json", "{\"cameraData\": []}\n", "a.json", all},
                                 {"a.json", "{\"foo\": ", "a.json", all},
                                 {"folder/b.txt", "text\n", "folder", all},
                                 {"folder/a.yaml", chain, "folder", all}}) {
    temp_folder const folder;
    if (!c.file.empty()) { folder.write(c.file, c.text); }
    if (c.open == "folder" && c.text == chain) { folder.write("folder/b.yaml", chain); }
    std::string const refused =
        message_of([&] { seq::read_calibration(folder.path(c.open), 64, 48); });
    EXPECT_TRUE(contains(refused, c.accepted)) << c.text << ": " << refused;
    EXPECT_TRUE(contains(refused, folder.path(c.open))) << refused;
  }
}

TEST(RecordingChecks, EveryRefusedFolderSaysWhatIsAccepted) {
  std::string const layouts = "accepted are folders with mav0/cam0";
  using kind = seq::camera_kind;
  struct folder_case {
    std::vector<std::string> images;
    std::vector<std::pair<std::string, std::string>> files;
    std::string open;
    kind rig;
    std::string accepted;
  };
  std::pair<std::string, std::string> const one = {"camera.txt", "40 40 32 24\n"};
  std::string const depths = "accepted are rgb.txt with depth.txt";
  for (folder_case const& c : std::vector<folder_case>{
           {{}, {}, "gone", kind::any, layouts},
           {{}, {{"a.avi", ""}}, "a.avi", kind::any, layouts},
           {{}, {{"a.txt", ""}}, "", kind::any, layouts},
           {{}, {{"mav0/a.txt", ""}}, "", kind::any, "accepted are cam0 alone"},
           {{"1.png"}, {one}, "", kind::any, "a rate (--fps) or a file with times"},
           {{"1.0.png"}, {}, "", kind::any, "accepted are Kalibr's chain"},
           {{"1.0.png"}, {one}, "", kind::stereo, "--rig mono"},
           {{"1.0.png"}, {one}, "", kind::mixed, "--rig mono"},
           {{"1.0.png"}, {one}, "", kind::rgbd, depths},
           {{"image_0/0.png"}, {one, {"times.txt", "noon\n"}}, "", kind::any, "accepted is a line"},
           {{"image_0/0.png"}, {one, {"times.txt", "1.0\n"}}, "", kind::stereo, "--rig mono"},
           {{"image_0/0.png"}, {one, {"times.txt", "1.0\n"}}, "", kind::rgbd, depths},
           {{"0.png", "1.png"},
            {one, {"times.txt", "noon\n9\n"}},
            "",
            kind::any,
            "accepted is a line"},
           {{"0.png", "1.png"},
            {one, {"times.txt", "1.5\n9x\n"}},
            "",
            kind::any,
            "accepted is a line"},
           {{"0.png"}, {one, {"rgb.txt", "1.0 0.png\n"}}, "", kind::rgbd, depths},
           {{"0.png"}, {{"rgb.txt", "1.0 0.png\n"}}, "", kind::any, "accepted are Kalibr's chain"},
           {{"0.color.png"}, {one}, "", kind::rgbd, depths}}) {
    temp_folder const folder;
    for (std::string const& image : c.images) { put(folder, image); }
    for (auto const& [name, text] : c.files) { folder.write(name, text); }
    std::string const at = c.open.empty() ? folder.path() : folder.path(c.open);
    std::string const refused = message_of([&] { seq::sequence::open(at, as(c.rig)); });
    EXPECT_TRUE(contains(refused, c.accepted)) << refused;
  }
}

TEST(RecordingChecks, AnImuThatIsNotUsedIsAWarning) {
  temp_folder const folder;
  put(folder, "images/1.00.png");
  folder.write("camchain.yaml", "cam0:\n" + chain_camera);
  folder.write("imu.csv", "#t,w,a\n900000000,0,0,0,0,0,9.81\n1100000000,0,0,0,0,0,9.81\n");
  seq::open_options options;
  EXPECT_TRUE(warnings_of(folder.path(), options).empty()) << "it was not asked for";
  options.read_imu = true;
  std::string const said = warning_of(folder.path(), options);
  EXPECT_TRUE(contains(said, "imu.csv: the samples of the IMU are not used: ")) << said;
  EXPECT_TRUE(contains(said, "does not say where the IMU is")) << said;
  fs::remove(folder.path("imu.csv"));
  EXPECT_TRUE(warnings_of(folder.path(), options).empty());
  folder.write("imu0/sensor.yaml", "");
  std::string const missing = warning_of(folder.path(), options);
  EXPECT_TRUE(contains(missing, "imu0/data.csv: no such file: the samples of the IMU")) << missing;
}

TEST(RecordingChecks, ImagesSideBySideAreToBeSplit) {
  struct row {
    int w, h;
    std::string words;
  };
  for (row const& r :
       {row{128, 48, "crop=iw/2:ih:0:0 left.mp4"}, row{64, 96, "crop=iw:ih/2:0:0 left.mp4"}}) {
    temp_folder const folder;
    put(folder, "images/1.00.png", r.w, r.h);
    folder.write("camchain.yaml", "cam0:\n" + chain_camera);
    std::string const said = message_of([&] { seq::sequence::open(folder.path()); });
    EXPECT_TRUE(contains(said, r.words)) << said;
    put(folder, "images/1.00.png", r.w / 2 + 64, r.h / 2 + 48);
    std::string const other = message_of([&] { seq::sequence::open(folder.path()); });
    EXPECT_FALSE(contains(other, "crop=")) << other;
  }
}

}  // namespace recording_checks_test
