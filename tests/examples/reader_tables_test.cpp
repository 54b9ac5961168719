// SPDX-License-Identifier: Apache-2.0
/// @file Tables and lists as people's programs write them: separators, headings, columns by name,
/// lines that are cut or not finite, a locale with a decimal comma.
#include <gtest/gtest.h>

#include <clocale>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/image_io.hpp"
#include "examples/sequence/reader.hpp"
#include "tests/support/sequence.hpp"

namespace reader_tables_test {

namespace fs = std::filesystem;
using seq_test::contains;
using seq_test::message_of;
using seq_test::replaced;
using seq_test::temp_folder;

std::string const camera_text =
    "%YAML:1.0\nT_BS:\n  cols: 4\n  rows: 4\n"
    "  data: [1, 0, 0, X, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\nrate_hz: 20\n"
    "resolution: [64, 48]\ncamera_model: pinhole\nintrinsics: [40.5, 40.5, 31.5, 23.5]\n"
    "distortion_model: radial-tangential\ndistortion_coefficients: [0, 0, 0, 0]\n";

void put(temp_folder const& folder, std::string const& name) {
  fs::create_directories(fs::path(folder.path(name)).parent_path());
  seq::write_png(folder.path(name), {64, 48, std::vector<std::uint8_t>(64 * 48, 40)});
}

/// A pair in EuRoC's layout, of three frames. @param csv of each camera
void write_pair(temp_folder const& folder, std::string const& csv) {
  for (std::string const name : {"mav0/cam0/", "mav0/cam1/"}) {
    folder.write(name + "data.csv", csv);
    folder.write(name + "sensor.yaml", replaced(camera_text, "X", name[8] == '1' ? "0.1" : "0"));
    for (char const* file : {"a.png", "b.png", "c.png"}) { put(folder, name + "data/" + file); }
  }
}

std::string const plain = "1000000000,a.png\n1050000000,b.png\n1100000000,c.png\n";

bool said(std::vector<std::string> const& warnings, std::string const& part) {
  for (std::string const& warning : warnings) {
    if (contains(warning, part)) { return true; }
  }
  return false;
}

/// Programs with Qt or GTK set the locale that the system asks for, and so may those of Python.
TEST(reader_tables, numbers_have_points_in_a_locale_of_commas) {
  temp_folder const folder;
  write_pair(folder, "1.00,a.png\n1.05,b.png\n1.10,c.png\n");
  if (std::setlocale(LC_NUMERIC, "de_DE.UTF-8") == nullptr) {
    GTEST_SKIP() << "the locale de_DE.UTF-8 is not installed";
  }
  std::string const file = folder.path("poses.txt");
  seq::stamped_pose pose;
  pose.time_ns = 1'500'000'000;
  pose.T_world_camera = Eigen::Translation3d(0.25, -1.5, 2);
  EXPECT_NO_THROW(EXPECT_EQ(seq::sequence::open(folder.path()).time_ns(1), 1'050'000'000));
  seq::write_tum(file, {pose});
  EXPECT_NO_THROW(EXPECT_EQ(seq::read_tum(file)[0].T_world_camera.translation().x(), 0.25));
  folder.write("poses.txt", "1,5 0 0 0 0 0 0 1\n");
  EXPECT_TRUE(contains(message_of([&] { seq::read_tum(file); }), "not a time in seconds"));
  seq::write_kitti_poses(file, {pose});
  std::setlocale(LC_NUMERIC, "C");
  std::ifstream in(file);
  std::string const written{std::istreambuf_iterator<char>(in), {}};
  EXPECT_EQ(written.find(','), std::string::npos) << written;
  EXPECT_TRUE(contains(written, "2.500000000e-01")) << written;
}

}  // namespace reader_tables_test
