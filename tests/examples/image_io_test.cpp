// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/image_io.hpp"

#include <gtest/gtest.h>

#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>

#include <png.h>

#include <jpeglib.h>

#include "examples/sequence/grey.hpp"

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

struct jpeg_options {
  int restart_rows = 0;  ///< rows of blocks between restart markers, 0 = none
  bool progressive = false;
};

/// Colour, three bytes a pixel, through libjpeg.
bytes colour_jpeg(int width, int height, bytes const& rgb, jpeg_options const& options = {}) {
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
  info.restart_in_rows = options.restart_rows;
  if (options.progressive) { jpeg_simple_progression(&info); }
  jpeg_start_compress(&info, TRUE);
  for (int y = 0; y < height; ++y) {
    bytes row(rgb.begin() + 3 * y * width, rgb.begin() + 3 * (y + 1) * width);
    JSAMPROW rows[1] = {row.data()};
    jpeg_write_scanlines(&info, rows, 1);
  }
  jpeg_finish_compress(&info);
  jpeg_destroy_compress(&info);
  bytes out(data, data + size);
  std::free(data);
  return out;
}

/// The pixels as libjpeg decodes them, three bytes each.
bytes decoded_rgb(bytes const& file) {
  jpeg_decompress_struct info;
  jpeg_error_mgr errors;
  info.err = jpeg_std_error(&errors);
  jpeg_create_decompress(&info);
  jpeg_mem_src(&info, file.data(), static_cast<unsigned long>(file.size()));
  jpeg_read_header(&info, TRUE);
  info.out_color_space = JCS_RGB;
  jpeg_start_decompress(&info);
  std::size_t const stride = std::size_t{3} * info.output_width;
  bytes out(stride * info.output_height);
  while (info.output_scanline < info.output_height) {
    JSAMPROW row = out.data() + stride * info.output_scanline;
    jpeg_read_scanlines(&info, &row, 1);
  }
  jpeg_finish_decompress(&info);
  jpeg_destroy_decompress(&info);
  return out;
}

/// Where the marker 0xff `code` is for the first time.
std::ptrdiff_t marker_at(bytes const& file, std::uint8_t code) {
  std::array<std::uint8_t, 2> const marker = {0xff, code};
  auto const at = std::search(file.begin(), file.end(), marker.begin(), marker.end());
  EXPECT_NE(at, file.end());
  return at - file.begin();
}

bytes with_bytes(bytes file, std::ptrdiff_t at, bytes const& extra) {
  file.insert(file.begin() + at, extra.begin(), extra.end());
  return file;
}

constexpr std::uint8_t start_of_frame = 0xc0, huffman_table = 0xc4, first_restart = 0xd0,
                       end_of_image = 0xd9, start_of_scan = 0xda, quantization_table = 0xdb;

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
}

// Red, green, blue and the grey that OpenCV 4 makes of it. Weights of 14 bits (OpenCV 3) give
// another value for the first five, weights in thousands for the last nine.
TEST_F(image_io, grey_is_that_of_opencv) {
  std::vector<std::array<std::uint8_t, 4>> const colours = {
      {195, 110, 216, 147}, {0, 0, 250, 28},      {0, 1, 201, 23},     {0, 2, 152, 18},
      {0, 4, 168, 21},      {0, 5, 119, 16},      {0, 8, 86, 14},      {119, 248, 3, 182},
      {111, 130, 0, 110},   {127, 159, 221, 156}, {163, 99, 225, 132}, {35, 67, 129, 64},
      {255, 255, 255, 255}, {0, 0, 0, 0}};
  bytes rgb, grey;
  for (auto const& c : colours) {
    rgb.insert(rgb.end(), {c[0], c[1], c[2]});
    grey.push_back(c[3]);
    EXPECT_EQ(seq::grey_of(c[0], c[1], c[2]), c[3]);
  }
  auto const width = static_cast<int>(colours.size());
  auto const file = store("a.png", foreign_png(PNG_FORMAT_RGB, width, 1, rgb.data()));
  EXPECT_EQ(seq::read_image(file).pixels, grey);
}

// The luma that the file holds is another: it is rounded before the colours are, and not clipped.
TEST_F(image_io, colour_jpeg_is_decoded_to_rgb_first) {
  for (bool const progressive : {false, true}) {
    bytes const file =
        colour_jpeg(40, 30, noise(3 * 40, 30, 11).pixels, jpeg_options{0, progressive});
    bytes const rgb = decoded_rgb(file);
    auto const read = seq::read_image(store("a.jpg", file));
    ASSERT_EQ(read.pixels.size(), 1200u);
    for (std::size_t i = 0; i < read.pixels.size(); ++i) {
      unsigned const r = rgb[3 * i], g = rgb[3 * i + 1], b = rgb[3 * i + 2];
      ASSERT_EQ(read.pixels[i], (9798 * r + 19235 * g + 3735 * b + (1 << 14)) >> 15) << i;
    }
  }
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

TEST_F(image_io, harmless_extra_bytes_in_a_jpeg_are_skipped) {
  for (bool const progressive : {false, true}) {
    bytes const good =
        colour_jpeg(40, 30, noise(3 * 40, 30, 12).pixels, jpeg_options{0, progressive});
    auto const expected = seq::read_image(store("good.jpg", good)).pixels;
    auto const end = static_cast<std::ptrdiff_t>(good.size());
    ASSERT_EQ(good[good.size() - 1], end_of_image);
    bytes const odd = {0x00, 0x17, 0xd9, 0x2a, 0x00, 0x01};
    for (bytes const& extra : {bytes{0}, odd, bytes(64, 0), bytes(3000, 0x55)}) {
      for (std::ptrdiff_t const at :
           {std::ptrdiff_t{2}, marker_at(good, quantization_table), marker_at(good, huffman_table),
            marker_at(good, start_of_scan), end - 2, end}) {
        auto const file = store("extra.jpg", with_bytes(good, at, extra));
        EXPECT_EQ(seq::read_image(file).pixels, expected) << extra.size() << " bytes at " << at;
        int width = 0, height = 0;
        seq::read_image_size(file, width, height);
        EXPECT_EQ(width, 40);
        EXPECT_EQ(height, 30);
      }
    }
    // a second picture behind the first, as some cameras write
    EXPECT_EQ(seq::read_image(store("two.jpg", with_bytes(good, end, good))).pixels, expected);
  }
}

TEST_F(image_io, damage_that_leaves_image_data_over_is_an_error) {
  bytes const good = colour_jpeg(64, 64, noise(3 * 64, 64, 13).pixels);
  auto const head = static_cast<std::size_t>(marker_at(good, start_of_frame));
  ASSERT_EQ(good[head + 6], 64);
  bytes lower = good;
  lower[head + 6] = 32;  // half of the rows
  bytes narrower = good;
  narrower[head + 8] = 48;
  for (bytes const& bad : {lower, narrower}) {
    auto const file = store("bad.jpg", bad);
    expect_error([&] { seq::read_image(file); }, file);
  }
}

TEST_F(image_io, damage_between_restart_markers_is_an_error) {
  bytes const good = colour_jpeg(64, 64, noise(3 * 64, 64, 14).pixels, jpeg_options{1, false});
  EXPECT_EQ(seq::read_image(store("good.jpg", good)).width, 64);
  auto const restart = marker_at(good, first_restart);
  bytes missing = good;  // half of the data before the marker
  missing.erase(missing.begin() + restart - 200, missing.begin() + restart - 100);
  bytes no_marker = good;
  no_marker.erase(no_marker.begin() + restart, no_marker.begin() + restart + 2);
  for (bytes const& bad : {missing, no_marker, with_bytes(good, restart, bytes(16, 0x55))}) {
    auto const file = store("bad.jpg", bad);
    expect_error([&] { seq::read_image(file); }, file);
  }
}

TEST_F(image_io, a_jpeg_without_its_end_is_an_error) {
  for (bool const progressive : {false, true}) {
    bytes const good =
        colour_jpeg(40, 30, noise(3 * 40, 30, 15).pixels, jpeg_options{0, progressive});
    for (std::size_t count = 0; count < good.size(); count += count + 2 < good.size() ? 7 : 1) {
      auto const file = store("cut.jpg", good, count);
      expect_error([&] { seq::read_image(file); }, file);
    }
    // the data stops, the end of the image is there
    bytes short_of_data = good;
    short_of_data.erase(short_of_data.end() - 200, short_of_data.end() - 2);
    auto const file = store("short.jpg", short_of_data);
    expect_error([&] { seq::read_image(file); }, file);
  }
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
