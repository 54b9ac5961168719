// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <csetjmp>
#include <cstddef>
#include <cstdio>
#include <cstdlib>

#include <jpeglib.h>
// after jpeglib.h
#include <jerror.h>

#include "examples/sequence/grey.hpp"
#include "examples/sequence/image_codecs.hpp"

// libjpeg reports errors by longjmp. Every function here that calls setjmp therefore contains plain
// data only. The vectors live in its caller and are passed as pointers, so that no destructor is
// skipped.

namespace seq::detail {
namespace {

// ---- in

struct jpeg_errors {
  jpeg_error_mgr base;  // first, because libjpeg returns a pointer to it
  std::jmp_buf jump;
  char message[JMSG_LENGTH_MAX];
  std::size_t size;  // of the input file
};

// For the bytes reported by JWRN_EXTRANEOUS_DATA: whether the decoder should have used them. A
// restart marker follows its interval at once, and only image data contain a 0xff followed by a 0.
bool jpeg_skips_image_data(j_decompress_ptr info) {
  int const marker = info->err->msg_parm.i[1];
  if (marker >= 0xd0 && marker <= 0xd7) { return true; }
  auto const* errors = reinterpret_cast<jpeg_errors const*>(info->err);
  std::size_t const read = errors->size - info->src->bytes_in_buffer;
  std::size_t const skipped = std::min(static_cast<std::size_t>(info->err->msg_parm.i[0]), read);
  JOCTET const* const end = info->src->next_input_byte;
  JOCTET const stuffed[] = {0xff, 0};
  return std::search(end - skipped, end, stuffed, stuffed + 2) != end;
}

extern "C" {

static void ft_seq_jpeg_exit(j_common_ptr info) {
  auto* errors = reinterpret_cast<jpeg_errors*>(info->err);
  (*info->err->format_message)(info, errors->message);
  std::longjmp(errors->jump, 1);
}

// Most warnings mean that decoded pixels are invented (premature end, bad codes, lost markers): the
// picture is rejected. Harmless are two warnings about unused header fields, and bytes skipped
// before a marker, with which some cameras pad, unless they belong to the image data.
static void ft_seq_jpeg_message(j_common_ptr info, int level) {
  if (level >= 0) { return; }
  int const code = info->err->msg_code;
  if (code == JWRN_ADOBE_XFORM || code == JWRN_JFIF_MAJOR) { return; }
  if (code == JWRN_EXTRANEOUS_DATA && info->is_decompressor &&
      !jpeg_skips_image_data(reinterpret_cast<j_decompress_ptr>(info))) {
    return;
  }
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
  s->errors.size = size;
  jpeg_mem_src(&s->info, data, static_cast<unsigned long>(size));
  jpeg_read_header(&s->info, TRUE);
  return true;
}

// @param rgb room for a row of three bytes a pixel, null for a grey file
bool jpeg_decode(jpeg_source* s, std::uint8_t* out, std::size_t stride, std::uint8_t* rgb) {
  if (setjmp(s->errors.jump) != 0) { return false; }
  s->info.out_color_space = rgb != nullptr ? JCS_RGB : JCS_GRAYSCALE;
  jpeg_start_decompress(&s->info);
  while (s->info.output_scanline < s->info.output_height) {
    std::uint8_t* const grey = out + static_cast<std::size_t>(s->info.output_scanline) * stride;
    JSAMPROW row = rgb != nullptr ? rgb : grey;
    jpeg_read_scanlines(&s->info, &row, 1);
    if (rgb != nullptr) { grey_of_rgb(rgb, stride, grey); }
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

// ---- out

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

bool is_jpeg(std::vector<std::uint8_t> const& bytes) {
  return bytes.size() >= 2 && bytes[0] == 0xff && bytes[1] == 0xd8;
}

void read_jpeg_size(std::string const& path, std::vector<std::uint8_t> const& bytes, int& width,
                    int& height) {
  jpeg_source source;
  open_jpeg(path, bytes, source);
  width = static_cast<int>(source.info.image_width);
  height = static_cast<int>(source.info.image_height);
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
  std::vector<std::uint8_t> rgb(space == JCS_GRAYSCALE ? 0 : 3 * width);
  if (!jpeg_decode(&source, out.pixels.data(), width, rgb.empty() ? nullptr : rgb.data())) {
    fail(path, std::string("broken JPEG: ") + source.errors.message);
  }
  return out;
}

std::vector<std::uint8_t> write_jpeg(std::string const& name, image const& picture, int quality) {
  check_picture(name, picture);
  if (quality < 1 || quality > 100) {
    fail(name, "quality " + std::to_string(quality) + "; must be 1 to 100");
  }
  jpeg_sink sink;
  if (!jpeg_encode(&sink, picture.pixels.data(), picture.width, picture.height, quality)) {
    fail(name, std::string("cannot encode: ") + sink.errors.message);
  }
  return {sink.bytes, sink.bytes + sink.size};
}

}  // namespace seq::detail
