// SPDX-License-Identifier: Apache-2.0
#include "sequence/image_io.hpp"

#include <gtest/gtest.h>

#include <unistd.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>

#include <png.h>

#include <jpeglib.h>

namespace {

namespace fs = std::filesystem;
using bytes = std::vector<std::uint8_t>;

class image_io : public ::testing::Test {
protected:
  void SetUp() override {
    auto const* test = ::testing::UnitTest::GetInstance()->current_test_info();
    folder_ = fs::temp_directory_path() /
              (std::string("ft_image_io_") + test->name() + "_" + std::to_string(::getpid()));
    fs::create_directories(folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }

  std::string path(std::string const& name) const { return (folder_ / name).string(); }

  std::string store(std::string const& name, bytes const& content, std::size_t count) const {
    std::ofstream out(path(name), std::ios::binary);
    out.write(reinterpret_cast<char const*>(content.data()), static_cast<std::streamsize>(count));
    return path(name);
  }
  std::string store(std::string const& name, bytes const& content) const {
    return store(name, content, content.size());
  }

private:
  fs::path folder_;
};

seq::image noise(int width, int height, unsigned seed) {
  seq::image out;
  out.width = width;
  out.height = height;
  std::mt19937 random(seed);
  for (int i = 0; i < width * height; ++i) {
    out.pixels.push_back(static_cast<std::uint8_t>(random() & 255u));
  }
  return out;
}

seq::image slope(int width, int height) {
  seq::image out;
  out.width = width;
  out.height = height;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      out.pixels.push_back(static_cast<std::uint8_t>((x * 200 / width + y * 50 / height)));
    }
  }
  return out;
}

// Writes through libpng's simplified interface, another path than the library's own writer.
bytes foreign_png(png_uint_32 format, int width, int height, void const* pixels,
                  void const* colours = nullptr, unsigned entries = 0) {
  png_image picture{};
  picture.version = PNG_IMAGE_VERSION;
  picture.width = static_cast<png_uint_32>(width);
  picture.height = static_cast<png_uint_32>(height);
  picture.format = format;
  picture.colormap_entries = entries;
  png_alloc_size_t size = 0;
  EXPECT_NE(png_image_write_to_memory(&picture, nullptr, &size, 0, pixels, 0, colours), 0);
  bytes out(size);
  EXPECT_NE(png_image_write_to_memory(&picture, out.data(), &size, 0, pixels, 0, colours), 0);
  out.resize(size);
  return out;
}

bytes interlaced_png(int width, int height, int colour_type, std::vector<bytes>& rows) {
  struct sink {
    bytes data;
    static void write(png_structp png, png_bytep from, std::size_t count) {
      auto& to = static_cast<sink*>(png_get_io_ptr(png))->data;
      to.insert(to.end(), from, from + count);
    }
    static void flush(png_structp) {}
  } out;
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
  png_infop info = png_create_info_struct(png);
  png_set_write_fn(png, &out, sink::write, sink::flush);
  png_set_IHDR(png, info, static_cast<png_uint_32>(width), static_cast<png_uint_32>(height), 8,
               colour_type, PNG_INTERLACE_ADAM7, PNG_COMPRESSION_TYPE_DEFAULT,
               PNG_FILTER_TYPE_DEFAULT);
  std::vector<png_bytep> pointers;
  for (auto& row : rows) { pointers.push_back(row.data()); }
  png_set_rows(png, info, pointers.data());
  png_write_png(png, info, PNG_TRANSFORM_IDENTITY, nullptr);
  png_destroy_write_struct(&png, &info);
  return out.data;
}

bytes colour_jpeg(int width, int height, std::array<std::uint8_t, 3> colour) {
  jpeg_compress_struct info;
  jpeg_error_mgr errors;
  info.err = jpeg_std_error(&errors);
  jpeg_create_compress(&info);
  unsigned char* data = nullptr;
  unsigned long size = 0;
  jpeg_mem_dest(&info, &data, &size);
  info.image_width = static_cast<JDIMENSION>(width);
  info.image_height = static_cast<JDIMENSION>(height);
  info.input_components = 3;
  info.in_color_space = JCS_RGB;
  jpeg_set_defaults(&info);
  jpeg_set_quality(&info, 100, TRUE);
  jpeg_start_compress(&info, TRUE);
  bytes row;
  for (int x = 0; x < width; ++x) { row.insert(row.end(), colour.begin(), colour.end()); }
  for (int y = 0; y < height; ++y) {
    JSAMPROW rows[1] = {row.data()};
    jpeg_write_scanlines(&info, rows, 1);
  }
  jpeg_finish_compress(&info);
  jpeg_destroy_compress(&info);
  bytes out(data, data + size);
  std::free(data);
  return out;
}

// The message must name the file.
template <typename Call>
void expect_error(Call&& call, std::string const& path) {
  try {
    call();
    ADD_FAILURE() << "no error for " << path;
  } catch (seq::error const& e) {
    EXPECT_NE(std::string(e.what()).find(path), std::string::npos) << e.what();
  }
}

TEST_F(image_io, png_round_trip_at_every_level) {
  for (auto const& picture : {noise(37, 23, 1), slope(64, 48), noise(1, 1, 2), slope(1, 300)}) {
    for (int level : {0, 1, 2, 3, 6, 9}) {
      seq::write_png(path("a.png"), picture, level);
      auto const back = seq::read_image(path("a.png"));
      EXPECT_EQ(back.width, picture.width);
      EXPECT_EQ(back.height, picture.height);
      EXPECT_EQ(back.pixels, picture.pixels) << "level " << level;
      int width = 0;
      int height = 0;
      seq::read_image_size(path("a.png"), width, height);
      EXPECT_EQ(width, picture.width);
      EXPECT_EQ(height, picture.height);
    }
  }
}

TEST_F(image_io, jpeg_comes_back_close) {
  auto const picture = slope(120, 90);
  auto const file = store("picture.png", seq::encode_jpeg(picture, 95));  // told apart by content
  auto const back = seq::read_image(file);
  ASSERT_EQ(back.width, 120);
  ASSERT_EQ(back.height, 90);
  for (std::size_t i = 0; i < picture.pixels.size(); ++i) {
    ASSERT_NEAR(back.pixels[i], picture.pixels[i], 6);
  }
  int width = 0;
  int height = 0;
  seq::read_image_size(file, width, height);
  EXPECT_EQ(width, 120);
  EXPECT_EQ(height, 90);
}

TEST_F(image_io, sixteen_bits_keep_the_high_byte) {
  std::vector<std::uint16_t> const samples = {0x0000, 0x00ff, 0x0100, 0x7fff, 0x8000, 0xffff};
  auto const file = store("a.png", foreign_png(PNG_FORMAT_LINEAR_Y, 3, 2, samples.data()));
  EXPECT_EQ(seq::read_image(file).pixels, (bytes{0x00, 0x00, 0x01, 0x7f, 0x80, 0xff}));
}

TEST_F(image_io, colour_becomes_grey) {
  bytes const rgb = {255, 0, 0, 0, 255, 0, 0, 0, 255, 10, 20, 30};
  bytes const grey = {76, 150, 29, 18};
  EXPECT_EQ(seq::read_image(store("a.png", foreign_png(PNG_FORMAT_RGB, 2, 2, rgb.data()))).pixels,
            grey);

  bytes const rgba = {255, 0, 0, 0, 0, 255, 0, 1, 0, 0, 255, 128, 10, 20, 30, 255};
  EXPECT_EQ(seq::read_image(store("b.png", foreign_png(PNG_FORMAT_RGBA, 2, 2, rgba.data()))).pixels,
            grey);

  bytes const with_alpha = {7, 0, 200, 255};
  EXPECT_EQ(
      seq::read_image(store("c.png", foreign_png(PNG_FORMAT_GA, 2, 1, with_alpha.data()))).pixels,
      (bytes{7, 200}));

  bytes const indices = {0, 1, 1, 0};
  bytes const palette = {255, 0, 0, 0, 0, 255};
  EXPECT_EQ(seq::read_image(store("d.png", foreign_png(PNG_FORMAT_RGB_COLORMAP, 2, 2,
                                                       indices.data(), palette.data(), 2)))
                .pixels,
            (bytes{76, 29, 29, 76}));

  auto const jpeg = seq::read_image(store("e.jpg", colour_jpeg(16, 16, {200, 100, 50})));
  ASSERT_EQ(jpeg.pixels.size(), 256u);
  EXPECT_NEAR(jpeg.pixels[100], 0.299 * 200 + 0.587 * 100 + 0.114 * 50, 2);
}

TEST_F(image_io, interlaced_png) {
  auto const picture = noise(21, 17, 3);
  std::vector<bytes> grey;
  std::vector<bytes> colour;
  for (int y = 0; y < picture.height; ++y) {
    grey.emplace_back(picture.row(y), picture.row(y) + picture.width);
    colour.emplace_back();
    for (std::uint8_t value : grey.back()) { colour.back().insert(colour.back().end(), 3, value); }
  }
  EXPECT_EQ(
      seq::read_image(store("a.png", interlaced_png(21, 17, PNG_COLOR_TYPE_GRAY, grey))).pixels,
      picture.pixels);
  EXPECT_EQ(
      seq::read_image(store("b.png", interlaced_png(21, 17, PNG_COLOR_TYPE_RGB, colour))).pixels,
      picture.pixels);
}

TEST_F(image_io, every_truncation_is_an_error) {
  auto const png = seq::encode_png(noise(40, 30, 4), 1);
  auto const jpeg = seq::encode_jpeg(noise(40, 30, 5), 60);
  for (auto const* content : {&png, &jpeg}) {
    for (std::size_t count = 0; count < content->size(); ++count) {
      auto const file = store("cut", *content, count);
      expect_error([&] { seq::read_image(file); }, file);
    }
    EXPECT_EQ(seq::read_image(store("whole", *content)).width, 40);
  }
}

TEST_F(image_io, flipped_bits_in_a_png_are_an_error) {
  auto const good = seq::encode_png(noise(24, 18, 6), 1);
  std::mt19937 random(7);
  for (int i = 0; i < 400; ++i) {
    auto bad = good;
    bad[random() % bad.size()] ^= static_cast<std::uint8_t>(1u << (random() % 8));
    auto const file = store("bad.png", bad);
    expect_error([&] { seq::read_image(file); },
                 file);  // every byte is under a CRC or the signature
  }
}

TEST_F(image_io, flipped_bits_in_a_jpeg_do_not_crash) {
  auto const good = seq::encode_jpeg(noise(24, 18, 8), 60);
  std::mt19937 random(9);
  int errors = 0;
  for (int i = 0; i < 600; ++i) {
    auto bad = good;
    bad[random() % bad.size()] ^= static_cast<std::uint8_t>(1u << (random() % 8));
    auto const file = store("bad.jpg", bad);
    try {
      seq::read_image(file);  // entropy-coded data has no checksum: some flips cannot be seen
    } catch (seq::error const& e) {
      ++errors;
      EXPECT_NE(std::string(e.what()).find(file), std::string::npos);
    }
  }
  EXPECT_GT(errors, 0);
}

TEST_F(image_io, refuses_what_is_not_an_image) {
  expect_error([&] { seq::read_image(path("missing.png")); }, path("missing.png"));
  expect_error([&] { seq::read_image(path("")); }, path(""));  // a folder
  auto const text = store("text.png", bytes{'h', 'e', 'l', 'l', 'o', ' ', 't', 'h', 'e', 'r', 'e'});
  expect_error([&] { seq::read_image(text); }, text);
  int width = 0;
  int height = 0;
  expect_error([&] { seq::read_image_size(text, width, height); }, text);
}

TEST_F(image_io, refuses_absurd_sizes) {
  // 16385 wide: one row past the limit, small as a file
  seq::image wide;
  wide.width = 16385;
  wide.height = 1;
  wide.pixels.assign(16385, 9);
  expect_error([&] { seq::write_png(path("w.png"), wide); }, path("w.png"));
  auto const file = store("wide.png", foreign_png(PNG_FORMAT_GRAY, 16385, 1, wide.pixels.data()));
  expect_error([&] { seq::read_image(file); }, file);
  int width = 0;
  int height = 0;
  expect_error([&] { seq::read_image_size(file, width, height); }, file);
}

TEST_F(image_io, refuses_bad_arguments_and_places) {
  auto const good = slope(8, 8);
  auto broken = good;
  broken.pixels.pop_back();
  expect_error([&] { seq::write_png(path("a.png"), broken); }, path("a.png"));
  expect_error([&] { seq::write_png(path("a.png"), seq::image{}); }, path("a.png"));
  expect_error([&] { seq::write_png(path("a.png"), good, 10); }, path("a.png"));
  expect_error([&] { seq::write_png(path("no/such/folder.png"), good); },
               path("no/such/folder.png"));
  EXPECT_THROW(seq::encode_png(good, -1), seq::error);
  EXPECT_THROW(seq::encode_jpeg(good, 0), seq::error);
  EXPECT_THROW(seq::encode_jpeg(good, 101), seq::error);
  EXPECT_THROW(seq::encode_jpeg(broken), seq::error);
}

}  // namespace
