// SPDX-License-Identifier: Apache-2.0
/// @file Recordings of rigs of several cameras, with depth images among them.
#include <gtest/gtest.h>

#include <cstdint>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "examples/sequence/image_io.hpp"
#include "examples/sequence/reader.hpp"
#include "tests/support/sequence.hpp"

namespace {

using seq_test::contains;
using seq_test::message_of;
using seq_test::put;
using seq_test::replaced;
using seq_test::temp_folder;
using seq_test::times_of;

using time_list = std::vector<std::int64_t>;

/// A camera of Kalibr's chain; the others are `x`, `y` from the one before. @param rest lines
std::string chained(int k, std::string const& distortion, double x, double y,
                    std::string const& size = "[64, 48]", bool turned = false) {
  std::string const t = ", " + std::to_string(-x) + "]\n", u = ", " + std::to_string(-y) + "]\n";
  std::string const rows = turned ? "  - [-1, 0, 0" + t + "  - [0, 1, 0" + u + "  - [0, 0, -1, 0]\n"
                                  : "  - [1, 0, 0" + t + "  - [0, 1, 0" + u + "  - [0, 0, 1, 0]\n";
  return "cam" + std::to_string(k) +
         ":\n  camera_model: pinhole\n  distortion_coeffs: [0, 0, 0, 0]\n" +
         "  distortion_model: " + distortion +
         "\n  intrinsics: [40, 40, 32, 24]\n  resolution: " + size + "\n" +
         (k == 0 ? "" : "  T_cn_cnm1:\n" + rows + "  - [0, 0, 0, 1]\n");
}

/// A depth image of 64 x 48 pixels of one value.
void put_depth(temp_folder const& folder, std::string const& name, int value) {
  namespace fs = std::filesystem;
  fs::create_directories(fs::path(folder.path(name)).parent_path());
  std::vector<std::uint16_t> const all(64 * 48, static_cast<std::uint16_t>(value));
  seq::write_depth_png(folder.path(name), {64, 48, all});
}

std::vector<int> rights_of(seq::sequence const& s) {
  std::vector<int> all;
  for (seq::rig_camera const& c : seq::rig_cameras(s.rig())) { all.push_back(c.right); }
  return all;
}

TEST(reader_rigs, cameras_of_different_lenses_are_taken_as_they_are) {
  temp_folder const folder;
  std::string const pair = chained(0, "radtan", 0, 0) + chained(1, "equidistant", 0.1, 0);
  std::string const four =
      pair + chained(2, "equidistant", 0, 0.05, "[64, 48]", true) + chained(3, "none", 0.1, 0);
  folder.write("camchain.yaml", four);
  for (int camera = 0; camera < 4; ++camera) {
    for (int i = 0; i < 4; ++i) {
      if (camera == 2 && i == 1) { continue; }
      put(folder, "cam" + std::to_string(camera) + "/" + std::to_string(100 + i) + ".5.png",
          10 * camera + i);
    }
  }
  seq::open_options options;
  options.rig = seq::camera_kind::mixed;
  seq::sequence s = seq::sequence::open(folder.path(), options);
  ASSERT_TRUE(s.mixed());
  EXPECT_EQ(s.kind(), seq::camera_kind::stereo);
  EXPECT_FALSE(s.fisheye());
  EXPECT_EQ(s.rig().left.model, seq::lens::pinhole);
  EXPECT_EQ(rights_of(s), (std::vector<int>{1, -1, 3, -1}));  // the last two look back
  Eigen::Vector3d const last = seq::rig_cameras(s.rig())[3].T_left_this.translation();
  EXPECT_LT((last - Eigen::Vector3d(0, 0.05, 0)).norm(), 1e-12) << last;
  EXPECT_EQ(times_of(s),
            (time_list{100'500'000'000, 101'500'000'000, 102'500'000'000, 103'500'000'000}));
  ASSERT_EQ(s.warnings().size(), 1U);
  EXPECT_TRUE(
      contains(s.warnings()[0], "1 of 4 frames have no image of cam2 within 1 ms: it misses them"));
  EXPECT_TRUE(s.load(1).more[0].pixels.empty());
  seq::stereo_frame const frame = s.load(2);
  ASSERT_EQ(frame.more.size(), 2U);
  EXPECT_EQ(frame.left.pixels[0], 2);
  EXPECT_EQ(frame.right.pixels[0], 12);
  EXPECT_EQ(frame.more[1].pixels[0], 32);
  EXPECT_EQ(seq::describe(s)[1].text,
            "4 cameras, 64x48; cam0 pinhole and cam1 Kannala-Brandt, 0.1 m apart; cam2 "
            "Kannala-Brandt and cam3 pinhole, 0.1 m apart");
  // Where it is not asked for: the first pair, rectified.
  s = seq::sequence::open(folder.path());
  EXPECT_TRUE(!s.mixed() && s.rig().rectified() && s.size() == 4 && s.load(0).more.empty());
  ASSERT_EQ(s.warnings().size(), 1U);
  EXPECT_TRUE(
      contains(s.warnings()[0], "cameras after cam1 are not taken: --rig mixed takes them"));

  folder.write("camchain.yaml", pair);
  EXPECT_TRUE(seq::sequence::open(folder.path()).warnings().empty());
  s = seq::sequence::open(folder.path(), options);
  EXPECT_TRUE(s.mixed() && s.size() == 4);
  ASSERT_EQ(s.warnings().size(), 1U);
  EXPECT_EQ(s.warnings()[0], "cam2 and those after it are not taken: it has no calibration");
}

TEST(reader_rigs, counted_images_have_the_times_of_the_pair) {
  temp_folder const folder;
  folder.write("camchain.yaml",
               chained(0, "none", 0, 0) + chained(1, "none", 0.1, 0) + chained(2, "none", 0.1, 0));
  folder.write("times.txt", "1.0\n1.1\n1.1\n1.3\n");
  for (int i = 0; i < 4; ++i) {
    std::string const name = "/" + std::to_string(i) + ".png";
    put(folder, "cam0" + name, i);
    put(folder, "cam1" + name, i);
    if (i != 0) { put(folder, "cam2" + name, 20 + i); }
  }
  seq::open_options options;
  options.rig = seq::camera_kind::mixed;
  seq::sequence const s = seq::sequence::open(folder.path(), options);
  EXPECT_EQ(times_of(s), (time_list{1'000'000'000, 1'100'000'000, 1'300'000'000}));
  EXPECT_EQ(s.load(2).more[0].pixels[0], 23);
  put(folder, "cam2/odd.png", 1);
  put(folder, "cam2/other.png", 1);
  std::string const more = message_of([&] { seq::sequence::open(folder.path(), options); });
  EXPECT_TRUE(contains(more, "4 left and 5 cam2 images, and their names do not say")) << more;
}

TEST(reader_rigs, says_which_rigs_are_none) {
  temp_folder const folder;
  seq::open_options options;
  options.rig = seq::camera_kind::mixed;
  auto const refused = [&](std::string const& chain) {
    folder.write("camchain.yaml", chain);
    return message_of([&] { seq::sequence::open(folder.path(), options); });
  };
  for (char const* name : {"cam0/1.5.png", "cam1/1.5.png", "cam2/1.5.png"}) {
    put(folder, name, 1);
  }
  std::string const pair = chained(0, "equidistant", 0, 0) + chained(1, "equidistant", 0.1, 0);
  std::string message = refused(pair + chained(2, "none", 0.1, 0, "[80, 48]"));
  EXPECT_TRUE(contains(message, "cam2 is 80 x 48 pixels, cam0 64 x 48")) << message;
  message = refused(chained(0, "none", 0, 0) + chained(1, "equidistant", 0.1, 0, "[80, 48]"));
  EXPECT_TRUE(contains(message, "left camera is 64 x 48, right camera 80 x 48")) << message;
  message = refused(chained(0, "none", 0, 0) + chained(1, "equidistant", 0.1, 0, "[64, 48]", true));
  EXPECT_TRUE(contains(message, "no two of the 2 cameras look the same way")) << message;
  // One camera above the other: no rows correspond.
  folder.write("camchain.yaml", chained(0, "none", 0, 0) + chained(1, "none", 0, 0.1));
  EXPECT_TRUE(seq::sequence::open(folder.path(), options).mixed());
  folder.write("camchain.yaml", pair + replaced(chained(2, "none", 0, 0), "[40, 40", "[-40, 40"));
  seq::sequence const s = seq::sequence::open(folder.path(), options);
  EXPECT_TRUE(s.mixed());
  ASSERT_FALSE(s.warnings().empty());
  EXPECT_TRUE(contains(s.warnings().back(), "cam2 and those after it are not taken: "))
      << s.warnings().back();
}

TEST(reader_rigs, a_camera_has_the_depth_images_beside_it) {
  temp_folder const folder;
  folder.write("camchain.yaml",
               chained(0, "none", 0, 0) + chained(1, "none", 0.1, 0) + chained(2, "none", 0.1, 0));
  for (int i = 0; i < 3; ++i) {
    std::string const stamp = "/" + std::to_string(100 + i);
    for (std::string const camera : {"cam0", "cam1", "cam2"}) {
      put(folder, camera + stamp + ".5.png", i);
    }
    if (i == 1) { continue; }
    put_depth(folder, "depth2" + stamp + ".51.png", 2000 + i);  // 10 ms later
  }
  seq::open_options options;
  options.rig = seq::camera_kind::mixed;
  seq::sequence s = seq::sequence::open(folder.path(), options);
  EXPECT_EQ(s.rig().depth_cameras, (std::vector<int>{2}));
  EXPECT_EQ(rights_of(s), (std::vector<int>{1, -1, -1}));
  EXPECT_TRUE(seq::rig_cameras(s.rig())[2].has_depth);
  ASSERT_EQ(s.load(2).depths.size(), 1U);
  EXPECT_EQ(s.load(2).depths[0].pixels[5], 2002);
  EXPECT_TRUE(s.load(1).depths[0].pixels.empty());
  ASSERT_EQ(s.warnings().size(), 2U);
  EXPECT_TRUE(contains(s.warnings()[0],
                       "1 of 3 frames have no image of depth2 within 20 ms: its camera has no "
                       "depths in them"));
  EXPECT_TRUE(contains(s.warnings()[1], "nothing says the unit of the depth images"));
  EXPECT_FALSE(contains(s.warnings()[1], "camera.txt"));
  options.depth_unit = 1e-3;
  s = seq::sequence::open(folder.path(), options);
  EXPECT_EQ(s.warnings().size(), 1U);
  EXPECT_EQ(seq::describe(s)[1].text,
            "3 cameras, 64x48; cam0 pinhole and cam1 pinhole, 0.1 m apart; cam2 pinhole with depth "
            "images; depth 0.001 m a unit, as asked for");
  // In a pair each camera has its depths from the other; with depth images from those.
  put_depth(folder, "depth0/100.5.png", 1500);
  s = seq::sequence::open(folder.path(), options);
  EXPECT_EQ(s.rig().depth_cameras, (std::vector<int>{0, 2}));
  EXPECT_EQ(rights_of(s), (std::vector<int>{-1, -1, -1}));
  EXPECT_EQ(s.load(0).depths[0].pixels[0], 1500);
  // Names are taken in any case.
  for (auto const& [name, other] : std::vector<std::pair<std::string, std::string>>{
           {"cam0", "Cam0"}, {"cam1", "CAM1"}, {"cam2", "Cam2"}, {"depth2", "Depth2"}}) {
    std::filesystem::rename(folder.path(name), folder.path(other));
  }
  s = seq::sequence::open(folder.path(), options);
  EXPECT_EQ(s.rig().depth_cameras, (std::vector<int>{0, 2}));
  EXPECT_EQ(s.load(2).more[0].pixels[0], 2);
  std::filesystem::rename(folder.path("Depth2"), folder.path("depth2"));
  // Where nobody asks for a rig.
  s = seq::sequence::open(folder.path());
  EXPECT_TRUE(!s.mixed() && s.load(0).depths.empty());
  EXPECT_TRUE(
      contains(s.warnings().front(), "depth0: depth images that are not used: --rig mixed"));
  seq::depth_image const wide{32, 48, std::vector<std::uint16_t>(32 * 48, 900)};
  seq::write_depth_png(folder.path("depth2/100.51.png"), wide);
  std::string const message = message_of([&] { seq::sequence::open(folder.path(), options); });
  EXPECT_TRUE(contains(message, "depth image is 32 x 48") && contains(message, "registered"))
      << message;
}

TEST(reader_rigs, a_depth_camera_makes_a_rig_of_cameras_that_see_nothing_in_common) {
  temp_folder const folder;
  folder.write("mav0/camchain.yaml",
               chained(0, "none", 0, 0) + chained(1, "equidistant", 0.1, 0, "[64, 48]", true));
  auto const camera = [&](std::string const& name) {
    folder.write("mav0/" + name + "/data.csv", "#time,file\n1000000000,a.png\n1100000000,b.png\n");
    for (std::string const file : {"a.png", "b.png"}) {
      std::string const path = "mav0/" + name + "/data/" + file;
      name == "depth0" ? put_depth(folder, path, 1000) : put(folder, path, 9);
    }
  };
  camera("cam0");
  camera("cam1");
  seq::open_options options;
  options.rig = seq::camera_kind::mixed;
  options.depth_unit = 1e-3;
  std::string const message = message_of([&] { seq::sequence::open(folder.path(), options); });
  EXPECT_TRUE(contains(message, "look the same way") && contains(message, "depth0, depth1 ..."))
      << message;
  camera("depth0");
  seq::sequence const s = seq::sequence::open(folder.path(), options);
  EXPECT_EQ(s.rig().depth_cameras, (std::vector<int>{0}));
  EXPECT_EQ(s.load(1).depths[0].pixels[7], 1000);
  EXPECT_TRUE(s.warnings().empty());
}

}  // namespace
