// SPDX-License-Identifier: Apache-2.0
/// @file Masks of the cameras of a recording.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "examples/sequence/image_io.hpp"
#include "examples/sequence/reader.hpp"
#include "tests/support/sequence.hpp"

namespace reader_masks_test {

using seq_test::contains;
using seq_test::message_of;
using seq_test::put;
using seq_test::temp_folder;

constexpr int mask_width = 64, mask_height = 48;

/// Two cameras of three frames, named by their times. @param distortion of both, k1
void write_pair(temp_folder const& folder, double distortion) {
  std::string chain;
  for (int c = 0; c < 2; ++c) {
    std::string const name = "cam" + std::to_string(c);
    chain += name + ":\n  camera_model: pinhole\n  distortion_model: radtan\n" +
             "  distortion_coeffs: [" + std::to_string(distortion) + ", 0, 0, 0]\n" +
             "  intrinsics: [40, 40, 32, 24]\n  resolution: [64, 48]\n";
    for (int i = 0; i < 3; ++i) {
      put(folder, name + "/" + std::to_string(100 + i) + ".5.png", 10 * c + i);
    }
  }
  folder.write(
      "camchain.yaml",
      chain + "  T_cn_cnm1: [[1, 0, 0, -0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n");
}

/// A mask that leaves out the columns from `from` on. @param allowed value of the others
void put_mask(temp_folder const& folder, std::string const& name, int from, int allowed = 255) {
  namespace fs = std::filesystem;
  fs::create_directories(fs::path(folder.path(name)).parent_path());
  seq::image mask{mask_width, mask_height, std::vector<std::uint8_t>(mask_width * mask_height)};
  for (int i = 0; i < mask_width * mask_height; ++i) {
    mask.pixels[static_cast<std::size_t>(i)] =
        static_cast<std::uint8_t>(i % mask_width < from ? allowed : 0);
  }
  seq::write_png(folder.path(name), mask);
}

/// Columns of the middle row that a mask allows; -1 = there is no mask.
int columns_of(std::shared_ptr<seq::image const> const& mask) {
  if (mask == nullptr) { return -1; }
  auto const row = mask->pixels.begin() + mask_width * (mask_height / 2);
  return static_cast<int>(std::count(row, row + mask_width, std::uint8_t{255}));
}

TEST(reader_masks, an_image_holds_for_all_frames_and_a_folder_has_one_for_each) {
  temp_folder const folder;
  write_pair(folder, 0);
  EXPECT_FALSE(seq::sequence::open(folder.path()).masked());
  EXPECT_TRUE(seq::sequence::open(folder.path()).load(0).masks.empty());
  put_mask(folder, "left.png", 20, 1);
  put_mask(folder, "right/100.5.png", 30);
  put_mask(folder, "right/102.5.png.png", 40);
  seq::open_options options;
  options.masks = {folder.path("left.png"), folder.path("right")};
  seq::sequence const s = seq::sequence::open(folder.path(), options);
  EXPECT_TRUE(s.masked());
  int const wanted[3] = {30, -1, 40};
  for (int i = 0; i < 3; ++i) {
    auto const masks = s.load(i).masks;
    ASSERT_EQ(masks.size(), 2U);
    EXPECT_EQ(columns_of(masks[0]), 20);
    EXPECT_EQ(masks[0], s.load(0).masks[0]) << "shared";
    EXPECT_EQ(columns_of(masks[1]), wanted[i]) << i;
  }
  ASSERT_EQ(s.warnings().size(), 1U);
  EXPECT_TRUE(contains(s.warnings()[0], "right: 1 of 3 frames have no mask"));
  EXPECT_TRUE(contains(seq::describe(s)[1].text, "; masks"));
  options.masks = {"", folder.path("left.png")};
  auto const second = seq::sequence::open(folder.path(), options).load(1).masks;
  EXPECT_EQ(columns_of(second[0]), -1);
  EXPECT_EQ(columns_of(second[1]), 20);
}

TEST(reader_masks, are_rectified_with_their_images) {
  temp_folder const folder;
  write_pair(folder, -0.3);
  put_mask(folder, "left.png", 48);
  seq::open_options options;
  options.masks = {folder.path("left.png")};
  seq::sequence const s = seq::sequence::open(folder.path(), options);
  put_mask(folder, "cam0/100.5.png", 48);  // the same as an image
  auto const frame = s.load(0);
  ASSERT_EQ(frame.left.pixels.size(), frame.masks[0]->pixels.size());
  int allowed = 0, left_out = 0;
  for (std::size_t i = 0; i < frame.left.pixels.size(); ++i) {
    EXPECT_EQ(frame.masks[0]->pixels[i], frame.left.pixels[i] == 255 ? 255 : 0) << i;
    ++(frame.left.pixels[i] == 255 ? allowed : left_out);
  }
  EXPECT_GT(allowed, 1000);
  EXPECT_GT(left_out, 300);
}

TEST(reader_masks, that_do_not_fit_are_refused) {
  temp_folder const folder;
  write_pair(folder, 0);
  put_mask(folder, "left.png", 20);
  seq::open_options options;
  auto const refused = [&](std::vector<std::string> const& masks, char const* words) {
    options.masks = masks;
    std::string const said = message_of([&] { seq::sequence::open(folder.path(), options); });
    EXPECT_TRUE(contains(said, words)) << said;
  };
  std::string const left = folder.path("left.png");
  refused({left, left, left}, "3 masks, for 2 cameras");
  refused({folder.path("none.png")}, "none.png");
  std::filesystem::create_directories(folder.path("empty"));
  refused({folder.path("empty")}, "such as 100.5.png");
  seq::write_png(folder.path("small.png"), {32, 48, std::vector<std::uint8_t>(32 * 48, 255)});
  refused({folder.path("small.png")}, "32 x 48");
  put_mask(folder, "nothing.png", 0);
  refused({folder.path("nothing.png")}, "nothing.png: the mask is 0 everywhere");
  put_mask(folder, "little.png", 3);
  options.masks = {folder.path("little.png")};
  auto const warnings = seq::sequence::open(folder.path(), options).warnings();
  ASSERT_EQ(warnings.size(), 1U);
  EXPECT_TRUE(contains(warnings[0], "little.png: the mask is 0")) << warnings[0];
  EXPECT_TRUE(contains(warnings[0], "95 % of the image")) << warnings[0];
  options.rig = seq::camera_kind::mono;
  refused({left, left}, "2 masks, for 1 camera");
}

}  // namespace reader_masks_test
