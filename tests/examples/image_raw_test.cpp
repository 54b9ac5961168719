// SPDX-License-Identifier: Apache-2.0
/// @file PGM, PPM and BMP: bytes written here, pixel by pixel.
#include <gtest/gtest.h>

#include <cstdint>
#include <string>
#include <vector>

#include "examples/sequence/grey.hpp"
#include "examples/sequence/image_io.hpp"
#include "tests/support/sequence.hpp"

namespace {

using seq_test::contains;
using seq_test::message_of;
using seq_test::temp_folder;

using pixels = std::vector<std::uint8_t>;

std::string text_of(std::vector<int> const& values) {
  std::string text;
  for (int const v : values) { text += static_cast<char>(v); }
  return text;
}

std::string little(long value, int count) {
  std::string text;
  for (int i = 0; i < count; ++i) { text += static_cast<char>((value >> (8 * i)) & 255); }
  return text;
}

/// A BMP's two headers. @param height below 0: rows from the top
std::string bmp_head(int width, int height, int bits, int colours) {
  int const data = 54 + 4 * colours;
  return "BM" + little(0, 4) + little(0, 4) + little(data, 4) + little(40, 4) + little(width, 4) +
         little(height, 4) + little(1, 2) + little(bits, 2) + little(0, 4) + little(0, 4) +
         little(0, 8) + little(colours, 4) + little(0, 4);
}

TEST(image_raw, pgm_of_any_range_is_scaled_to_8_bits) {
  temp_folder const folder;
  auto const read = [&](std::string const& text) {
    return seq::read_image(folder.write("a.pgm", text));
  };
  EXPECT_EQ(read("P5\n3 2\n255\n" + text_of({0, 1, 2, 10, 13, 255})).pixels,
            (pixels{0, 1, 2, 10, 13, 255}));
  EXPECT_EQ(read("P5 # comment 9\n# another\n 2\t1 65535 " + text_of({255, 255, 18, 200})).pixels,
            (pixels{255, 18}));
  EXPECT_EQ(read("P5 4 1 1023\n" + text_of({3, 255, 2, 0, 0, 0, 255, 255})).pixels,
            (pixels{255, 128, 0, 255}));  // 1023, 512, 0, beyond
  EXPECT_EQ(read("P5\r\n# Windows\r\n2 1\r\n255\r\n" + text_of({10, 13})).pixels, (pixels{10, 13}));
  EXPECT_EQ(read("P5 3 1 15\n" + text_of({15, 0, 5})).pixels, (pixels{255, 0, 85}));
  EXPECT_EQ(read("P6 2 1 255\n" + text_of({10, 20, 30, 255, 255, 255})).pixels,
            (pixels{seq::grey_of(10, 20, 30), 255}));
  int width = 0;
  int height = 0;
  seq::read_image_size(folder.write("a.pgm", "P5 7 5 255\n"), width, height);
  EXPECT_EQ(width, 7);
  EXPECT_EQ(height, 5);
}

TEST(image_raw, bmp_rows_palette_and_colour) {
  temp_folder const folder;
  auto const read = [&](std::string const& text) {
    return seq::read_image(folder.write("a.bmp", text));
  };
  // 8 bits: rows of 4 bytes from the bottom; a palette of blue, green, red.
  std::string const palette = text_of({0, 0, 0, 0, 255, 255, 255, 0, 30, 20, 10, 0});
  std::string const rows = text_of({0, 1, 2, 9, 1, 1, 0, 9});
  std::uint8_t const mixed = seq::grey_of(10, 20, 30);
  EXPECT_EQ(read(bmp_head(3, 2, 8, 3) + palette + rows).pixels,
            (pixels{255, 255, 0, 0, 255, mixed}));
  EXPECT_EQ(read(bmp_head(3, -2, 8, 3) + palette + rows).pixels,
            (pixels{0, 255, mixed, 255, 255, 0}));
  EXPECT_EQ(read(bmp_head(1, 2, 24, 0) + text_of({30, 20, 10, 9, 7, 7, 7, 9})).pixels,
            (pixels{7, mixed}));
  EXPECT_EQ(read(bmp_head(2, 1, 32, 0) + text_of({30, 20, 10, 9, 7, 7, 7, 9})).pixels,
            (pixels{mixed, 7}));
}

TEST(image_raw, rejects_damaged_files) {
  temp_folder const folder;
  struct bad_case {
    std::string text, expected;
  };
  for (bad_case const& c : std::vector<bad_case>{
           {"P5 3 2 255\n" + text_of({1, 2, 3, 4, 5}), "truncated: 5 bytes of pixels, must have 6"},
           {"P5 3 2 256\n" + text_of({1, 2, 3, 4, 5, 6}), "must have 12"},
           {"P5 0 2 255\n", "image of 0 x 2"},
           {"P5 99999 2 255\n", "sides must be 1 to 16384"},
           {"P5 999999999999 2 255\n", "16384"},
           {"P5 3 2 70000\n", "largest value 70000"},
           {"P5 3 2 0\n", "largest value 0"},
           {"P5 3\n", "damaged"},
           {"P2 1 1 255\n7", "neither PNG"},
           {"BM", "neither PNG"},
           {"BMx", "damaged"},
           {bmp_head(3, 2, 8, 0), "truncated"},
           {bmp_head(3, 2, 4, 0), "4 bits"},
           {bmp_head(-3, 2, 24, 0), "image of 0 x 2"},
           {bmp_head(2, 1, 8, 300) + std::string(1204, 0), "more than 256 colours"},
       }) {
    std::string const path = folder.write("a.bin", c.text);
    std::string const message = message_of([&] { seq::read_image(path); });
    EXPECT_TRUE(contains(message, c.expected)) << message;
    EXPECT_TRUE(contains(message, path)) << message;
  }
}

}  // namespace
