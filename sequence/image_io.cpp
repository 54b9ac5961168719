// SPDX-License-Identifier: Apache-2.0
#include "sequence/image_io.hpp"

#include <cerrno>
#include <csetjmp>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>

#include <png.h>
#include <zlib.h>

#include <jpeglib.h>
// after jpeglib.h
#include <jerror.h>

// Both libraries report errors by longjmp. Every function here that calls setjmp therefore holds
// plain data only: the vectors live in its caller and are handed over as pointers, so that no
// destructor is jumped over.

namespace seq {
namespace {

constexpr int max_side = 16384;
constexpr std::size_t message_size = 256;

struct file_closer {
  void operator()(std::FILE* f) const {
    if (f != nullptr) { std::fclose(f); }
  }
};
using file_ptr = std::unique_ptr<std::FILE, file_closer>;

[[noreturn]] void fail(std::string const& path, std::string const& reason) {
  throw error(path + ": " + reason);
}

std::vector<std::uint8_t> read_file(std::string const& path) {
  file_ptr file(std::fopen(path.c_str(), "rb"));
  if (!file) { fail(path, std::string("cannot open: ") + std::strerror(errno)); }
  std::vector<std::uint8_t> bytes;
  std::size_t used = 0;
  std::size_t room = std::size_t(1) << 18;
  for (;;) {
    bytes.resize(used + room);
    std::size_t const got = std::fread(bytes.data() + used, 1, room, file.get());
    used += got;
    if (got < room) { break; }
    room = used;
    if (used > (std::size_t(1) << 31)) { fail(path, "file larger than 2 GiB"); }
  }
  if (std::ferror(file.get()) != 0) {
    fail(path, std::string("cannot read: ") + std::strerror(errno));
  }
  bytes.resize(used);
  return bytes;
}

void write_file(std::string const& path, std::vector<std::uint8_t> const& bytes) {
  file_ptr file(std::fopen(path.c_str(), "wb"));
  if (!file) { fail(path, std::string("cannot create: ") + std::strerror(errno)); }
  bool ok = std::fwrite(bytes.data(), 1, bytes.size(), file.get()) == bytes.size();
  ok = std::fclose(file.release()) == 0 && ok;
  if (!ok) {
    std::string const reason = std::strerror(errno);
    std::remove(path.c_str());
    fail(path, "cannot write: " + reason);
  }
}

bool is_png(std::vector<std::uint8_t> const& bytes) {
  return bytes.size() >= 8 && png_sig_cmp(bytes.data(), 0, 8) == 0;
}

bool is_jpeg(std::vector<std::uint8_t> const& bytes) {
  return bytes.size() >= 3 && bytes[0] == 0xff && bytes[1] == 0xd8 && bytes[2] == 0xff;
}

void check_side(std::string const& path, unsigned long width, unsigned long height) {
  if (width == 0 || height == 0 || width > max_side || height > max_side) {
    fail(path, "image of " + std::to_string(width) + " x " + std::to_string(height) +
                   " pixels; sides must be 1 to " + std::to_string(max_side));
  }
}

std::uint8_t to_grey(unsigned red, unsigned green, unsigned blue) {
  return static_cast<std::uint8_t>((red * 299u + green * 587u + blue * 114u + 500u) / 1000u);
}

void check_picture(std::string const& name, image const& picture) {
  if (picture.width < 1 || picture.height < 1 || picture.width > max_side ||
      picture.height > max_side) {
    fail(name, "cannot write an image of " + std::to_string(picture.width) + " x " +
                   std::to_string(picture.height) + " pixels; sides must be 1 to " +
                   std::to_string(max_side));
  }
  auto const expected =
      static_cast<std::size_t>(picture.width) * static_cast<std::size_t>(picture.height);
  if (picture.pixels.size() != expected) {
    fail(name, "image holds " + std::to_string(picture.pixels.size()) + " pixels in place of " +
                   std::to_string(expected));
  }
}

// ---- PNG in

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
  png_set_user_limits(s->png, 0x7fffffff, 0x7fffffff);  // sides are checked by check_side
  png_set_read_fn(s->png, s, ft_seq_png_read);
  png_read_info(s->png, s->info);
  return true;
}

// Asks for 8 bits a sample, no palette, no alpha.
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

image read_png(std::string const& path, std::vector<std::uint8_t> const& bytes) {
  png_source source;
  open_png(path, bytes, source);
  auto const broken = [&] { fail(path, std::string("broken PNG: ") + source.message); };

  image out;
  out.width = static_cast<int>(png_get_image_width(source.png, source.info));
  out.height = static_cast<int>(png_get_image_height(source.png, source.info));
  auto const width = static_cast<std::size_t>(out.width);
  auto const height = static_cast<std::size_t>(out.height);
  // deflate cannot shrink by more than 1032, so a short file that claims a huge image is caught
  // before its memory is taken
  if (png_get_rowbytes(source.png, source.info) * height / 1040 > bytes.size()) {
    fail(path, "broken PNG: file is too short for its size of " + std::to_string(out.width) +
                   " x " + std::to_string(out.height));
  }

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
        std::uint8_t* grey = out.row(y);
        for (std::size_t x = 0; x < width; ++x) {
          grey[x] = to_grey(row[3 * x], row[3 * x + 1], row[3 * x + 2]);
        }
      }
    }
  }
  if (!png_finish(&source)) { broken(); }
  return out;
}

// ---- JPEG in

struct jpeg_errors {
  jpeg_error_mgr base;  // first: libjpeg hands back a pointer to it
  std::jmp_buf jump;
  char message[JMSG_LENGTH_MAX];
};

extern "C" {

static void ft_seq_jpeg_exit(j_common_ptr info) {
  auto* errors = reinterpret_cast<jpeg_errors*>(info->err);
  (*info->err->format_message)(info, errors->message);
  std::longjmp(errors->jump, 1);
}

// Warnings say that decoded pixels are made up (premature end, bad codes, lost markers), except two
// that concern header fields nothing here depends on.
static void ft_seq_jpeg_message(j_common_ptr info, int level) {
  if (level >= 0) { return; }
  int const code = info->err->msg_code;
  if (code == JWRN_ADOBE_XFORM || code == JWRN_JFIF_MAJOR) { return; }
  ft_seq_jpeg_exit(info);
}

static void ft_seq_jpeg_silent(j_common_ptr) {}

}  // extern "C"

void set_handlers(jpeg_errors* errors) {
  jpeg_std_error(&errors->base);
  errors->base.error_exit = ft_seq_jpeg_exit;
  errors->base.emit_message = ft_seq_jpeg_message;
  errors->base.output_message = ft_seq_jpeg_silent;
  errors->message[0] = '\0';
}

struct jpeg_source {
  jpeg_errors errors;
  jpeg_decompress_struct info;

  jpeg_source() : errors(), info() { set_handlers(&errors); }
  jpeg_source(jpeg_source const&) = delete;
  jpeg_source& operator=(jpeg_source const&) = delete;
  ~jpeg_source() { jpeg_destroy_decompress(&info); }
};

bool jpeg_open(jpeg_source* s, std::uint8_t const* data, std::size_t size) {
  s->info.err = &s->errors.base;
  if (setjmp(s->errors.jump) != 0) { return false; }
  jpeg_create_decompress(&s->info);
  jpeg_mem_src(&s->info, data, static_cast<unsigned long>(size));
  jpeg_read_header(&s->info, TRUE);
  return true;
}

bool jpeg_decode(jpeg_source* s, std::uint8_t* out, std::size_t stride) {
  if (setjmp(s->errors.jump) != 0) { return false; }
  s->info.out_color_space = JCS_GRAYSCALE;
  jpeg_start_decompress(&s->info);
  while (s->info.output_scanline < s->info.output_height) {
    JSAMPROW row = out + static_cast<std::size_t>(s->info.output_scanline) * stride;
    jpeg_read_scanlines(&s->info, &row, 1);
  }
  jpeg_finish_decompress(&s->info);
  return true;
}

void open_jpeg(std::string const& path, std::vector<std::uint8_t> const& bytes,
               jpeg_source& source) {
  if (!jpeg_open(&source, bytes.data(), bytes.size())) {
    fail(path, std::string("broken JPEG: ") + source.errors.message);
  }
  check_side(path, source.info.image_width, source.info.image_height);
}

image read_jpeg(std::string const& path, std::vector<std::uint8_t> const& bytes) {
  jpeg_source source;
  open_jpeg(path, bytes, source);
  J_COLOR_SPACE const space = source.info.jpeg_color_space;
  if (space == JCS_CMYK || space == JCS_YCCK) {
    fail(path, "JPEG in CMYK colours is not supported");
  }
  image out;
  out.width = static_cast<int>(source.info.image_width);
  out.height = static_cast<int>(source.info.image_height);
  auto const width = static_cast<std::size_t>(out.width);
  out.pixels.assign(width * static_cast<std::size_t>(out.height), 0);
  if (!jpeg_decode(&source, out.pixels.data(), width)) {
    fail(path, std::string("broken JPEG: ") + source.errors.message);
  }
  return out;
}

// ---- PNG out

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

bool png_encode(png_sink* s, std::uint8_t const* pixels, int width, int height, int compression) {
  s->png = png_create_write_struct(PNG_LIBPNG_VER_STRING, s->message, ft_seq_png_error,
                                   ft_seq_png_warning);
  if (s->png == nullptr) { return false; }
  if (setjmp(png_jmpbuf(s->png)) != 0) { return false; }
  s->info = png_create_info_struct(s->png);
  if (s->info == nullptr) { return false; }
  png_set_write_fn(s->png, s, ft_seq_png_write, ft_seq_png_flush);
  png_set_IHDR(s->png, s->info, static_cast<png_uint_32>(width), static_cast<png_uint_32>(height),
               8, PNG_COLOR_TYPE_GRAY, PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
               PNG_FILTER_TYPE_DEFAULT);
  png_set_compression_level(s->png, compression);
  if (compression <= 2) {
    // camera pictures are noisy: string matches cost time and find next to nothing
    png_set_filter(s->png, PNG_FILTER_TYPE_BASE, PNG_FILTER_SUB);
    png_set_compression_strategy(s->png, Z_RLE);
  } else if (compression < 6) {
    png_set_filter(s->png, PNG_FILTER_TYPE_BASE, PNG_FILTER_SUB);
  }
  png_set_compression_buffer_size(s->png, std::size_t(1) << 16);
  png_write_info(s->png, s->info);
  for (int y = 0; y < height; ++y) {
    png_write_row(s->png, pixels + static_cast<std::size_t>(y) * static_cast<std::size_t>(width));
  }
  png_write_end(s->png, nullptr);
  return true;
}

std::vector<std::uint8_t> encode_png_named(std::string const& name, image const& picture,
                                           int compression) {
  check_picture(name, picture);
  if (compression < 0 || compression > 9) {
    fail(name, "PNG compression level " + std::to_string(compression) + "; must be 0 to 9");
  }
  std::vector<std::uint8_t> bytes;
  bytes.reserve(picture.pixels.size() + picture.pixels.size() / 8 + 1024);
  png_sink sink;
  sink.bytes = &bytes;
  if (!png_encode(&sink, picture.pixels.data(), picture.width, picture.height, compression)) {
    fail(name, std::string("cannot encode PNG: ") + sink.message);
  }
  return bytes;
}

// ---- JPEG out

struct jpeg_sink {
  jpeg_errors errors;
  jpeg_compress_struct info;
  unsigned char* bytes = nullptr;
  unsigned long size = 0;

  jpeg_sink() : errors(), info() { set_handlers(&errors); }
  jpeg_sink(jpeg_sink const&) = delete;
  jpeg_sink& operator=(jpeg_sink const&) = delete;
  ~jpeg_sink() {
    jpeg_destroy_compress(&info);
    std::free(bytes);
  }
};

bool jpeg_encode(jpeg_sink* s, std::uint8_t const* pixels, int width, int height, int quality) {
  s->info.err = &s->errors.base;
  if (setjmp(s->errors.jump) != 0) { return false; }
  jpeg_create_compress(&s->info);
  jpeg_mem_dest(&s->info, &s->bytes, &s->size);
  s->info.image_width = static_cast<JDIMENSION>(width);
  s->info.image_height = static_cast<JDIMENSION>(height);
  s->info.input_components = 1;
  s->info.in_color_space = JCS_GRAYSCALE;
  jpeg_set_defaults(&s->info);
  jpeg_set_quality(&s->info, quality, TRUE);
  jpeg_start_compress(&s->info, TRUE);
  while (s->info.next_scanline < s->info.image_height) {
    JSAMPROW row = const_cast<JSAMPROW>(pixels + static_cast<std::size_t>(s->info.next_scanline) *
                                                     static_cast<std::size_t>(width));
    jpeg_write_scanlines(&s->info, &row, 1);
  }
  jpeg_finish_compress(&s->info);
  return true;
}

}  // namespace

image read_image(std::string const& path) {
  std::vector<std::uint8_t> const bytes = read_file(path);
  if (is_png(bytes)) { return read_png(path, bytes); }
  if (is_jpeg(bytes)) { return read_jpeg(path, bytes); }
  fail(path, bytes.empty() ? "empty file" : "neither PNG nor JPEG");
}

void read_image_size(std::string const& path, int& width, int& height) {
  std::vector<std::uint8_t> const bytes = read_file(path);
  if (is_png(bytes)) {
    png_source source;
    open_png(path, bytes, source);
    width = static_cast<int>(png_get_image_width(source.png, source.info));
    height = static_cast<int>(png_get_image_height(source.png, source.info));
  } else if (is_jpeg(bytes)) {
    jpeg_source source;
    open_jpeg(path, bytes, source);
    width = static_cast<int>(source.info.image_width);
    height = static_cast<int>(source.info.image_height);
  } else {
    fail(path, bytes.empty() ? "empty file" : "neither PNG nor JPEG");
  }
}

void write_png(std::string const& path, image const& picture, int compression) {
  write_file(path, encode_png_named(path, picture, compression));
}

std::vector<std::uint8_t> encode_png(image const& picture, int compression) {
  return encode_png_named("PNG", picture, compression);
}

std::vector<std::uint8_t> encode_jpeg(image const& picture, int quality) {
  check_picture("JPEG", picture);
  if (quality < 1 || quality > 100) {
    fail("JPEG", "quality " + std::to_string(quality) + "; must be 1 to 100");
  }
  jpeg_sink sink;
  if (!jpeg_encode(&sink, picture.pixels.data(), picture.width, picture.height, quality)) {
    fail("JPEG", std::string("cannot encode: ") + sink.errors.message);
  }
  return {sink.bytes, sink.bytes + sink.size};
}

}  // namespace seq
