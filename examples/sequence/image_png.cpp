// SPDX-License-Identifier: Apache-2.0
#include <csetjmp>
#include <cstddef>
#include <cstdio>
#include <cstring>
#include <new>

#include <png.h>
#include <zlib.h>

#include "examples/sequence/grey.hpp"
#include "examples/sequence/image_codecs.hpp"

// libpng reports errors by longjmp. Every function here that calls setjmp therefore contains plain
// data only. The vectors live in its caller and are passed as pointers, so that no destructor is
// skipped.

namespace seq::detail {
namespace {

constexpr std::size_t message_size = 256;

// ---- in

struct png_source {
  png_structp png = nullptr;
  png_infop info = nullptr;
  std::uint8_t const* data = nullptr;
  std::size_t size = 0;
  std::size_t position = 0;
  char message[message_size] = {};

  png_source() = default;
  png_source(png_source const&) = delete;
  png_source& operator=(png_source const&) = delete;
  ~png_source() {
    if (png != nullptr) { png_destroy_read_struct(&png, &info, nullptr); }
  }
};

extern "C" {

static void ft_seq_png_error(png_structp png, png_const_charp text) {
  // both sides keep the message as the error pointer
  auto* message = static_cast<char*>(png_get_error_ptr(png));
  if (message != nullptr) { std::snprintf(message, message_size, "%s", text); }
  png_longjmp(png, 1);
}

static void ft_seq_png_warning(png_structp, png_const_charp) {}

static void ft_seq_png_read(png_structp png, png_bytep out, std::size_t count) {
  auto* source = static_cast<png_source*>(png_get_io_ptr(png));
  if (count > source->size - source->position) { png_error(png, "file is truncated"); }
  std::memcpy(out, source->data + source->position, count);
  source->position += count;
}

}  // extern "C"

bool png_open(png_source* s) {
  s->png = png_create_read_struct(PNG_LIBPNG_VER_STRING, s->message, ft_seq_png_error,
                                  ft_seq_png_warning);
  if (s->png == nullptr) { return false; }
  if (setjmp(png_jmpbuf(s->png)) != 0) { return false; }
  s->info = png_create_info_struct(s->png);
  if (s->info == nullptr) { return false; }
  png_set_user_limits(s->png, 0x7fffffff, 0x7fffffff);  // check_side() checks the sides
  png_set_read_fn(s->png, s, ft_seq_png_read);
  png_read_info(s->png, s->info);
  return true;
}

// Requests 8 bits a sample, no palette, no alpha.
bool png_prepare(png_source* s, int* passes, int* channels, std::size_t* row_bytes) {
  if (setjmp(png_jmpbuf(s->png)) != 0) { return false; }
  int const depth = png_get_bit_depth(s->png, s->info);
  int const colour = png_get_color_type(s->png, s->info);
  if (colour == PNG_COLOR_TYPE_PALETTE) { png_set_palette_to_rgb(s->png); }
  if (colour == PNG_COLOR_TYPE_GRAY && depth < 8) { png_set_expand_gray_1_2_4_to_8(s->png); }
  if (depth == 16) { png_set_strip_16(s->png); }
  png_set_strip_alpha(s->png);
  *passes = png_set_interlace_handling(s->png);
  png_read_update_info(s->png, s->info);
  *channels = png_get_channels(s->png, s->info);
  *row_bytes = png_get_rowbytes(s->png, s->info);
  return true;
}

bool png_next_row(png_source* s, png_bytep row) {
  if (setjmp(png_jmpbuf(s->png)) != 0) { return false; }
  png_read_row(s->png, row, nullptr);
  return true;
}

bool png_rows_grey(png_source* s, png_bytep first, std::size_t stride, int height) {
  if (setjmp(png_jmpbuf(s->png)) != 0) { return false; }
  for (int y = 0; y < height; ++y) {
    png_read_row(s->png, first + static_cast<std::size_t>(y) * stride, nullptr);
  }
  return true;
}

bool png_finish(png_source* s) {
  if (setjmp(png_jmpbuf(s->png)) != 0) { return false; }
  png_read_end(s->png, nullptr);
  return true;
}

void open_png(std::string const& path, std::vector<std::uint8_t> const& bytes, png_source& source) {
  source.data = bytes.data();
  source.size = bytes.size();
  if (!png_open(&source)) { fail(path, std::string("broken PNG: ") + source.message); }
  check_side(path, png_get_image_width(source.png, source.info),
             png_get_image_height(source.png, source.info));
}

// Keeps 16 bits a sample, in the byte order of this machine.
bool png_prepare_depth(png_source* s, int* passes) {
  if (setjmp(png_jmpbuf(s->png)) != 0) { return false; }
  std::uint16_t const one = 1;
  unsigned char first = 0;
  std::memcpy(&first, &one, 1);
  if (first == 1) { png_set_swap(s->png); }
  *passes = png_set_interlace_handling(s->png);
  png_read_update_info(s->png, s->info);
  return true;
}

// deflate shrinks by at most 1032, so a short file that claims a huge image is rejected before
// memory is allocated
void check_length(std::string const& path, png_source const& source, std::size_t file_size) {
  std::size_t const height = png_get_image_height(source.png, source.info);
  if (png_get_rowbytes(source.png, source.info) * height / 1040 > file_size) {
    fail(path, "broken PNG: file is too short for its size of " +
                   std::to_string(png_get_image_width(source.png, source.info)) + " x " +
                   std::to_string(height));
  }
}

// ---- out

struct png_sink {
  png_structp png = nullptr;
  png_infop info = nullptr;
  std::vector<std::uint8_t>* bytes = nullptr;
  char message[message_size] = {};

  png_sink() = default;
  png_sink(png_sink const&) = delete;
  png_sink& operator=(png_sink const&) = delete;
  ~png_sink() {
    if (png != nullptr) { png_destroy_write_struct(&png, &info); }
  }
};

bool append(std::vector<std::uint8_t>& bytes, std::uint8_t const* data,
            std::size_t count) noexcept {
  try {
    bytes.insert(bytes.end(), data, data + count);
  } catch (std::bad_alloc const&) { return false; }
  return true;
}

extern "C" {

static void ft_seq_png_write(png_structp png, png_bytep data, std::size_t count) {
  auto* sink = static_cast<png_sink*>(png_get_io_ptr(png));
  if (!append(*sink->bytes, data, count)) { png_error(png, "out of memory"); }
}

static void ft_seq_png_flush(png_structp) {}

}  // extern "C"

bool png_encode(png_sink* s, std::uint8_t const* pixels, int width, int height, int bits,
                int compression) {
  s->png = png_create_write_struct(PNG_LIBPNG_VER_STRING, s->message, ft_seq_png_error,
                                   ft_seq_png_warning);
  if (s->png == nullptr) { return false; }
  if (setjmp(png_jmpbuf(s->png)) != 0) { return false; }
  s->info = png_create_info_struct(s->png);
  if (s->info == nullptr) { return false; }
  png_set_write_fn(s->png, s, ft_seq_png_write, ft_seq_png_flush);
  png_set_IHDR(s->png, s->info, static_cast<png_uint_32>(width), static_cast<png_uint_32>(height),
               bits, PNG_COLOR_TYPE_GRAY, PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
               PNG_FILTER_TYPE_DEFAULT);
  png_set_compression_level(s->png, compression);
  if (compression <= 2) {
    // camera pictures are noisy: string matching costs time and finds almost nothing
    png_set_filter(s->png, PNG_FILTER_TYPE_BASE, PNG_FILTER_SUB);
    png_set_compression_strategy(s->png, Z_RLE);
  } else if (compression < 6) {
    png_set_filter(s->png, PNG_FILTER_TYPE_BASE, PNG_FILTER_SUB);
  }
  png_set_compression_buffer_size(s->png, std::size_t(1) << 16);
  png_write_info(s->png, s->info);
  std::size_t const row = static_cast<std::size_t>(width) * (bits == 16 ? 2 : 1);
  for (int y = 0; y < height; ++y) {
    png_write_row(s->png, pixels + static_cast<std::size_t>(y) * row);
  }
  png_write_end(s->png, nullptr);
  return true;
}

}  // namespace

bool is_png(std::vector<std::uint8_t> const& bytes) {
  return bytes.size() >= 8 && png_sig_cmp(bytes.data(), 0, 8) == 0;
}

void read_png_size(std::string const& path, std::vector<std::uint8_t> const& bytes, int& width,
                   int& height) {
  png_source source;
  open_png(path, bytes, source);
  width = static_cast<int>(png_get_image_width(source.png, source.info));
  height = static_cast<int>(png_get_image_height(source.png, source.info));
}

image read_png(std::string const& path, std::vector<std::uint8_t> const& bytes) {
  png_source source;
  open_png(path, bytes, source);
  auto const broken = [&] { fail(path, std::string("broken PNG: ") + source.message); };

  image out;
  out.width = static_cast<int>(png_get_image_width(source.png, source.info));
  out.height = static_cast<int>(png_get_image_height(source.png, source.info));
  auto const width = static_cast<std::size_t>(out.width);
  auto const height = static_cast<std::size_t>(out.height);
  check_length(path, source, bytes.size());

  int passes = 1;
  int channels = 0;
  std::size_t row_bytes = 0;
  if (!png_prepare(&source, &passes, &channels, &row_bytes)) { broken(); }
  if ((channels != 1 && channels != 3) || row_bytes != width * static_cast<std::size_t>(channels)) {
    fail(path, "PNG with an unexpected pixel format (" + std::to_string(channels) + " channels)");
  }

  out.pixels.assign(width * height, 0);
  if (channels == 1) {
    for (int pass = 0; pass < passes; ++pass) {
      if (!png_rows_grey(&source, out.pixels.data(), row_bytes, out.height)) { broken(); }
    }
  } else {
    // one row is enough, except for interlaced files, whose passes fill rows gradually
    std::vector<std::uint8_t> rows(passes > 1 ? row_bytes * height : row_bytes);
    for (int pass = 0; pass < passes; ++pass) {
      for (int y = 0; y < out.height; ++y) {
        std::uint8_t* row =
            rows.data() + (passes > 1 ? static_cast<std::size_t>(y) * row_bytes : 0);
        if (!png_next_row(&source, row)) { broken(); }
        if (pass + 1 < passes) { continue; }
        grey_of_rgb(row, width, out.row(y));
      }
    }
  }
  if (!png_finish(&source)) { broken(); }
  return out;
}

std::vector<std::uint8_t> write_png(std::string const& name, image const& picture,
                                    int compression) {
  check_picture(name, picture);
  if (compression < 0 || compression > 9) {
    fail(name, "PNG compression level " + std::to_string(compression) + "; must be 0 to 9");
  }
  std::vector<std::uint8_t> bytes;
  bytes.reserve(picture.pixels.size() + picture.pixels.size() / 8 + 1024);
  png_sink sink;
  sink.bytes = &bytes;
  if (!png_encode(&sink, picture.pixels.data(), picture.width, picture.height, 8, compression)) {
    fail(name, std::string("cannot encode PNG: ") + sink.message);
  }
  return bytes;
}

bool is_png_of_16_bits(std::vector<std::uint8_t> const& bytes) {
  constexpr std::size_t bits = 24;  // in the first chunk, and then the kind of colour
  return is_png(bytes) && bytes.size() > bits + 1 && bytes[bits] == 16 && bytes[bits + 1] == 0;
}

depth_image read_png_depth(std::string const& path, std::vector<std::uint8_t> const& bytes) {
  png_source source;
  open_png(path, bytes, source);
  auto const broken = [&] { fail(path, std::string("broken PNG: ") + source.message); };
  int const bits = png_get_bit_depth(source.png, source.info);
  int const channels = png_get_channels(source.png, source.info);
  if (bits != 16 || channels != 1) {
    fail(path, "PNG of " + std::to_string(channels) + " channels with " + std::to_string(bits) +
                   " bits; a depth image must have 1 with 16");
  }
  check_length(path, source, bytes.size());
  depth_image out;
  out.width = static_cast<int>(png_get_image_width(source.png, source.info));
  out.height = static_cast<int>(png_get_image_height(source.png, source.info));
  auto const width = static_cast<std::size_t>(out.width);
  out.pixels.assign(width * static_cast<std::size_t>(out.height), 0);
  int passes = 1;
  if (!png_prepare_depth(&source, &passes)) { broken(); }
  auto* const rows = reinterpret_cast<png_bytep>(out.pixels.data());
  for (int pass = 0; pass < passes; ++pass) {
    if (!png_rows_grey(&source, rows, 2 * width, out.height)) { broken(); }
  }
  if (!png_finish(&source)) { broken(); }
  return out;
}

std::vector<std::uint8_t> write_png_depth(std::string const& name, depth_image const& depth) {
  std::size_t const pixels =
      static_cast<std::size_t>(depth.width) * static_cast<std::size_t>(depth.height);
  if (depth.width < 1 || depth.height < 1 || depth.pixels.size() != pixels) {
    fail(name, "depth image holds " + std::to_string(depth.pixels.size()) + " pixels in place of " +
                   std::to_string(depth.width) + " x " + std::to_string(depth.height));
  }
  std::vector<std::uint8_t> big_endian;
  for (std::uint16_t const value : depth.pixels) {
    big_endian.push_back(static_cast<std::uint8_t>(value >> 8));
    big_endian.push_back(static_cast<std::uint8_t>(value & 255));
  }
  std::vector<std::uint8_t> bytes;
  png_sink sink;
  sink.bytes = &bytes;
  if (!png_encode(&sink, big_endian.data(), depth.width, depth.height, 16, 1)) {
    fail(name, std::string("cannot encode PNG: ") + sink.message);
  }
  return bytes;
}

}  // namespace seq::detail
