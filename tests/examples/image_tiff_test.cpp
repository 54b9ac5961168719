// SPDX-License-Identifier: Apache-2.0
/// @file TIFF: files written here, byte by byte; and images of 10 to 16 bits.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "examples/sequence/grey.hpp"
#include "examples/sequence/image_codecs.hpp"
#include "examples/sequence/image_io.hpp"
#include "examples/sequence/reader.hpp"
#include "tests/support/sequence.hpp"

namespace {

using seq_test::contains;
using seq_test::message_of;
using seq_test::temp_folder;

using bytes = std::vector<std::uint8_t>;
constexpr char const* no_libtiff = "this build has no libtiff";

/// What a file is written with.
struct tiff {
  unsigned width = 0, height = 0;
  unsigned bits = 8, channels = 1, photometric = 1, compression = 1, predictor = 1;
  unsigned rows = 0;  ///< of a strip; 0 = all
  bool big_endian = false;
  std::map<unsigned, unsigned> more = {};  ///< other tags
  unsigned planes = 1;                     ///< one behind the other, a channel each
};

std::string number(tiff const& t, std::size_t value, int size) {
  std::string text;
  for (int i = 0; i < size; ++i) {
    int const shift = 8 * (t.big_endian ? size - 1 - i : i);
    text += static_cast<char>(value >> shift & 255);
  }
  return text;
}

/// PackBits of runs and of single bytes, each row by itself.
std::string packed(bytes const& data, std::size_t row) {
  std::string out;
  for (std::size_t i = 0; i < data.size();) {
    std::size_t run = 1;
    while ((i + run) % row != 0 && data[i + run] == data[i] && run < 128) { ++run; }
    out += static_cast<char>(run > 1 ? 257 - run : 0);
    out += static_cast<char>(data[i]);
    i += run;
  }
  return out;
}

/// LZW as the specification's encoder writes it.
std::string lzw(bytes const& data) {
  std::string out;
  unsigned held = 0;
  int bits = 0;
  int width = 9;
  auto const put = [&](unsigned code) {
    held = held << width | code;
    bits += width;
    for (; bits >= 8; bits -= 8) { out += static_cast<char>(held >> (bits - 8) & 255); }
  };
  std::map<std::string, unsigned> table;
  auto const begin = [&] {
    put(256);
    table.clear();
    for (unsigned i = 0; i < 256; ++i) { table[std::string(1, static_cast<char>(i))] = i; }
    width = 9;
  };
  unsigned next = 258;
  begin();
  std::string seen;
  for (std::uint8_t const byte : data) {
    std::string const longer = seen + static_cast<char>(byte);
    if (table.count(longer) != 0) {
      seen = longer;
      continue;
    }
    put(table[seen]);
    table[longer] = next++;
    if (next == 512 || next == 1024 || next == 2048) { ++width; }
    if (next == 4095) {
      begin();
      next = 258;
    }
    seen = std::string(1, static_cast<char>(byte));
  }
  put(table[seen]);
  ++next;
  if (next == 512 || next == 1024 || next == 2048) { ++width; }
  put(257);
  if (bits > 0) { out += static_cast<char>(held << (8 - bits) & 255); }
  return out;
}

/// Deflate, as blocks that are stored.
std::string deflated(tiff const& t, bytes const& data) {
  std::string out = "\x78\x01";
  unsigned a = 1;
  unsigned b = 0;
  for (std::size_t i = 0; i < data.size(); i += 60000) {
    std::size_t const n = std::min<std::size_t>(60000, data.size() - i);
    tiff little = t;
    little.big_endian = false;
    out += static_cast<char>(i + n == data.size());
    out += number(little, n, 2) + number(little, ~n & 0xffff, 2);
    for (std::size_t k = i; k < i + n; ++k) {
      out += static_cast<char>(data[k]);
      a = (a + data[k]) % 65521;
      b = (b + a) % 65521;
    }
  }
  tiff big = t;
  big.big_endian = true;
  return out + number(big, std::size_t{b} << 16 | a, 4);
}

/// @param samples of the rows, as stored: with predictor 2 differences
std::string file_of(tiff const& t, std::vector<unsigned> const& samples) {
  unsigned const rows = t.rows == 0 ? t.height : t.rows;
  std::size_t const row = std::size_t{t.width} * t.channels / t.planes;
  std::string data;
  std::vector<std::size_t> offsets, sizes;
  for (unsigned y = 0; y < t.height * t.planes; y += rows) {
    std::size_t const last = row * std::min(y + rows, t.height * t.planes);
    std::string strip;
    for (std::size_t i = row * y; i < last; ++i) {
      strip += number(t, samples[i], static_cast<int>(t.bits) / 8);
    }
    bytes const plain(strip.begin(), strip.end());
    if (t.compression == 5) { strip = lzw(plain); }
    if (t.compression == 8) { strip = deflated(t, plain); }
    if (t.compression == 32773) { strip = packed(plain, row); }
    offsets.push_back(8 + data.size());
    sizes.push_back(strip.size());
    data += strip;
  }
  std::map<unsigned, std::vector<std::size_t>> tags = {
      {256, {t.width}},       {257, {t.height}},   {258, {}},           {259, {t.compression}},
      {262, {t.photometric}}, {273, offsets},      {277, {t.channels}}, {278, {rows}},
      {279, sizes},           {317, {t.predictor}}};
  tags[258].assign(t.channels, t.bits);
  if (t.more.count(322) != 0) {
    for (unsigned const of_strips : {273U, 278U, 279U}) { tags.erase(of_strips); }
  }
  for (auto const& [tag, value] : t.more) { tags[tag] = {value}; }
  std::size_t const at = 8 + data.size();
  std::string directory = number(t, tags.size(), 2);
  std::string behind;
  std::size_t const first_behind = at + 2 + 12 * tags.size() + 4;
  for (auto const& [tag, values] : tags) {
    directory += number(t, tag, 2) + number(t, 4, 2) + number(t, values.size(), 4);
    if (values.size() == 1) {
      directory += number(t, values[0], 4);
      continue;
    }
    directory += number(t, first_behind + behind.size(), 4);
    for (std::size_t const value : values) { behind += number(t, value, 4); }
  }
  return std::string(t.big_endian ? "MM" : "II") + number(t, 42, 2) + number(t, at, 4) + data +
         directory + number(t, 0, 4) + behind;
}

seq::image read(temp_folder const& folder, tiff const& t, std::vector<unsigned> const& samples,
                int bits = 16) {
  return seq::read_image(folder.write("a.tiff", file_of(t, samples)), bits);
}

TEST(image_tiff, plain_samples_of_either_byte_order) {
  if (!seq::detail::reads_tiff()) { GTEST_SKIP() << no_libtiff; }
  temp_folder const folder;
  for (bool const big : {false, true}) {
    tiff t{3, 2};
    t.big_endian = big;
    EXPECT_EQ(read(folder, t, {0, 1, 2, 10, 13, 255}).pixels, (bytes{0, 1, 2, 10, 13, 255}));
    t.rows = 1;
    EXPECT_EQ(read(folder, t, {0, 1, 2, 10, 13, 255}).pixels, (bytes{0, 1, 2, 10, 13, 255}));
    t.photometric = 0;  // white is zero
    EXPECT_EQ(read(folder, t, {0, 1, 2, 10, 13, 255}).pixels, (bytes{255, 254, 253, 245, 242, 0}));
    tiff wide{2, 1, 16};
    wide.big_endian = big;
    EXPECT_EQ(read(folder, wide, {0x12ff, 0xfe01}).pixels, (bytes{0x12, 0xfe}));
  }
  tiff colour{1, 2, 8, 3, 2};
  EXPECT_EQ(read(folder, colour, {10, 20, 30, 7, 7, 7}).pixels,
            (bytes{seq::grey_of(10, 20, 30), 7}));
  tiff alpha{1, 1, 16, 4, 2};
  EXPECT_EQ(read(folder, alpha, {2560, 5120, 7680, 0}).pixels, (bytes{seq::grey_of(10, 20, 30)}));
  int width = 0;
  int height = 0;
  seq::read_image_size(folder.write("a.tiff", file_of(tiff{7, 5}, std::vector<unsigned>(35))),
                       width, height);
  EXPECT_EQ(width, 7);
  EXPECT_EQ(height, 5);
}

TEST(image_tiff, packed_samples_are_those_that_were_packed) {
  if (!seq::detail::reads_tiff()) { GTEST_SKIP() << no_libtiff; }
  temp_folder const folder;
  // Long enough for codes of 12 bits and a second table; smooth, so that codes are long.
  tiff t{320, 150};
  std::vector<unsigned> samples;
  unsigned state = 1;
  for (unsigned i = 0; i < t.width * t.height; ++i) {
    state = state * 1664525U + 1013904223U;
    samples.push_back(i % 97 < 60 ? 7 : state >> 30);
  }
  bytes const all(samples.begin(), samples.end());
  for (unsigned const compression : {1U, 5U, 8U, 32773U}) {
    for (unsigned const rows : {0U, 1U, 17U}) {
      t.compression = compression;
      t.rows = rows;
      EXPECT_EQ(read(folder, t, samples).pixels, all) << compression << " " << rows;
    }
  }
  // Differences to the sample on the left, modulo the range; each row begins anew.
  tiff of_differences{3, 2, 8, 1, 1, 5, 2};
  EXPECT_EQ(read(folder, of_differences, {10, 255, 5, 3, 0, 1}).pixels,
            (bytes{10, 9, 14, 3, 3, 4}));
  tiff colours{2, 1, 8, 3, 2, 5, 2};
  EXPECT_EQ(read(folder, colours, {9, 9, 9, 1, 1, 1}).pixels, (bytes{9, 10}));
}

TEST(image_tiff, planes_and_what_libtiff_makes_colours_of) {
  if (!seq::detail::reads_tiff()) { GTEST_SKIP() << no_libtiff; }
  temp_folder const folder;
  tiff planes{2, 1, 16, 3, 2};
  planes.more = {{284, 2}};
  planes.planes = 3;
  EXPECT_EQ(read(folder, planes, {10 << 8, 40 << 8, 20 << 8, 50 << 8, 30 << 8, 60 << 8}).pixels,
            (bytes{seq::grey_of(10, 20, 30), seq::grey_of(40, 50, 60)}));
  tiff const mono_chrome{2, 1, 8, 2};  // the second sample is alpha
  EXPECT_EQ(read(folder, mono_chrome, {7, 255, 9, 0}).pixels, (bytes{7, 9}));
  tiff one_bit{8, 1};
  one_bit.more = {{258, 1}};  // its first byte is a row
  EXPECT_EQ(read(folder, one_bit, {0x9f, 0, 0, 0, 0, 0, 0, 0}).pixels,
            (bytes{255, 0, 0, 255, 255, 255, 255, 255}));
}

TEST(image_tiff, a_build_without_libtiff_says_so) {
  if (seq::detail::reads_tiff()) { GTEST_SKIP() << "this build has libtiff"; }
  temp_folder const folder;
  std::string const path = folder.write("a.tif", file_of({2, 1}, {1, 2}));
  std::string const message = message_of([&] { seq::read_image(path); });
  EXPECT_TRUE(contains(message, "libtiff-dev") && contains(message, path)) << message;
  EXPECT_TRUE(contains(message, "read here are PNG, JPEG")) << message;
}

TEST(image_tiff, says_what_is_taken) {
  if (!seq::detail::reads_tiff()) { GTEST_SKIP() << no_libtiff; }
  temp_folder const folder;
  auto const refused = [&](tiff const& t, std::string const& reason) {
    std::string const path = folder.write("a.tiff", file_of(t, std::vector<unsigned>(64)));
    std::string const message = message_of([&] { seq::read_image(path); });
    EXPECT_TRUE(contains(message, reason) && contains(message, path)) << reason << ": " << message;
  };
  refused({2, 2, 32}, "of 32 bits, colours of type 1; must have");
  refused({1, 1, 16, 4, 5}, "of 16 bits, colours of type 5; must have");
  refused({2, 2, 16, 1, 1, 1, 1, 0, false, {{322, 16}, {323, 16}, {324, 8}, {325, 512}}},
          "of tiles");
  refused({2, 2, 8, 1, 1, 1, 1, 0, false, {{339, 2}}}, "signs");
  refused({2, 2, 8, 1, 4}, "; must have");
  refused({2, 2, 8, 1, 1, 34712}, "damaged");  // JPEG 2000
  refused({2, 2, 8, 1, 1, 1, 1, 0, false, {{273, 99999}}}, "damaged");
  refused({0, 2}, "is zero");
  std::string const whole = file_of({4, 4, 8, 1, 1, 5}, std::vector<unsigned>(16, 3));
  for (std::size_t n = 5; n < whole.size() - 4; n += 5) {  // nothing is behind this directory
    std::string const path = folder.write("a.tiff", whole.substr(0, n));
    EXPECT_NE(message_of([&] { seq::read_image(path); }), "") << n;
  }
}

TEST(image_bits, a_range_below_16_bits_is_asked_for) {
  temp_folder const folder;
  auto const write = [&](int i, unsigned largest) {
    seq::depth_image samples{64, 48, std::vector<std::uint16_t>(64 * 48, 160)};
    samples.pixels[0] = static_cast<std::uint16_t>(largest);
    std::string const name = folder.path(std::to_string(1000 + 50 * i) + ".png");
    seq::write_depth_png(name, samples);
    return name;
  };
  folder.write("camera.txt", "40 40 32 24\n");
  for (int i = 0; i < 12; ++i) { write(i, 3000); }
  std::string const one = folder.path("1000.png");
  EXPECT_EQ(seq::largest_sample_of_16_bits(one), 3000);
  EXPECT_EQ(seq::read_image(one).pixels[1], 0);
  EXPECT_EQ(seq::read_image(one, 12).pixels[1], 10);
  EXPECT_EQ(seq::read_image(one, 10).pixels[0], 255);  // beyond its range

  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_EQ(s.load(3).left.pixels[0], 3000 >> 8);  // as long as nobody says another range
  auto const said = [](seq::sequence const& of) {
    std::string all;
    for (std::string const& text : of.warnings()) { all += text + "\n"; }
    return all;
  };
  EXPECT_TRUE(contains(said(s), "of 6 of them is 3000; does the camera have 12 bits?")) << said(s);
  seq::open_options asked;
  asked.image_bits = 12;
  seq::sequence const as_12 = seq::sequence::open(folder.path(), asked);
  EXPECT_EQ(as_12.load(3).left.pixels[0], 3000 >> 4);
  EXPECT_EQ(as_12.load(3).left.pixels[1], 10);
  EXPECT_FALSE(contains(said(as_12), "bits")) << said(as_12);
  asked.image_bits = 16;
  seq::sequence const as_16 = seq::sequence::open(folder.path(), asked);
  EXPECT_EQ(as_16.load(3).left.pixels[0], 3000 >> 8);
  EXPECT_FALSE(contains(said(as_16), "bits")) << said(as_16);
  asked.image_bits = 17;
  EXPECT_TRUE(
      contains(message_of([&] { seq::sequence::open(folder.path(), asked); }), "image_bits"));

  folder.write("1200.png", "no image");  // load() says it
  EXPECT_TRUE(contains(said(seq::sequence::open(folder.path())), "of 5 of them is 3000"));
  write(4, 3000);
  asked.image_bits = 0;
  asked.max_frames = 4;
  write(6, 40000);  // one image that has all 16, which is not among the first
  EXPECT_TRUE(contains(said(seq::sequence::open(folder.path(), asked)), "of 4 of them is 3000"));
  seq::sequence const full = seq::sequence::open(folder.path());
  EXPECT_EQ(full.load(3).left.pixels[0], 3000 >> 8);
  EXPECT_FALSE(contains(said(full), "bits")) << said(full);
}

TEST(image_bits, depth_images_may_be_tiff) {
  if (!seq::detail::reads_tiff()) { GTEST_SKIP() << no_libtiff; }
  temp_folder const folder;
  tiff const t{2, 1, 16};
  auto const depth = seq::read_depth_image(folder.write("a.tiff", file_of(t, {1234, 65535})));
  EXPECT_EQ(depth.pixels, (std::vector<std::uint16_t>{1234, 65535}));
  std::string const path = folder.write("b.tiff", file_of({2, 1}, {1, 2}));
  EXPECT_TRUE(contains(message_of([&] { seq::read_depth_image(path); }), "no PNG or TIFF"));
  EXPECT_EQ(seq::largest_sample_of_16_bits(path), -1);
}

}  // namespace
