// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/image_io.hpp"

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstdio>
#include <cstring>
#include <memory>
#include <utility>

#include "examples/sequence/image_codecs.hpp"

namespace seq {

namespace detail {

void fail(std::string const& path, std::string const& reason) { throw error(path + ": " + reason); }

void check_side(std::string const& path, unsigned long width, unsigned long height) {
  if (width == 0 || height == 0 || width > max_side || height > max_side) {
    fail(path, "image of " + std::to_string(width) + " x " + std::to_string(height) +
                   " pixels; sides must be 1 to " + std::to_string(max_side));
  }
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

}  // namespace detail

namespace {

using detail::fail;

struct file_closer {
  void operator()(std::FILE* f) const {
    if (f != nullptr) { std::fclose(f); }
  }
};
using file_ptr = std::unique_ptr<std::FILE, file_closer>;

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

[[noreturn]] void fail_unknown(std::string const& path, std::vector<std::uint8_t> const& bytes) {
  fail(path, bytes.empty() ? "empty file" : "neither PNG, JPEG, binary PGM or PPM, BMP, nor TIFF");
}

/// The samples of a PNG or TIFF of one channel with 16 bits. False for any other image.
bool read_16_bits(std::string const& path, std::vector<std::uint8_t> const& bytes,
                  depth_image& out) {
  if (detail::is_png_of_16_bits(bytes)) {
    out = detail::read_png_depth(path, bytes);
    return true;
  }
  if (!detail::is_tiff(bytes)) { return false; }
  detail::tiff_samples samples = detail::read_tiff_samples(path, bytes);
  if (samples.bits != 16 || samples.channels != 1) { return false; }
  out = {samples.width, samples.height, std::move(samples.values)};
  return true;
}

image high_bits(depth_image const& samples, int bits) {
  image out{samples.width, samples.height, {}};
  out.pixels.reserve(samples.pixels.size());
  for (std::uint16_t const value : samples.pixels) {
    out.pixels.push_back(static_cast<std::uint8_t>(std::min(value >> (bits - 8), 255)));
  }
  return out;
}

}  // namespace

image read_image(std::string const& path, int bits) {
  std::vector<std::uint8_t> const bytes = read_file(path);
  depth_image samples;
  if (bits < 16 && read_16_bits(path, bytes, samples)) { return high_bits(samples, bits); }
  if (detail::is_png(bytes)) { return detail::read_png(path, bytes); }
  if (detail::is_jpeg(bytes)) { return detail::read_jpeg(path, bytes); }
  if (detail::is_pnm(bytes)) { return detail::read_pnm(path, bytes); }
  if (detail::is_bmp(bytes)) { return detail::read_bmp(path, bytes); }
  if (detail::is_tiff(bytes)) { return detail::read_tiff(path, bytes); }
  fail_unknown(path, bytes);
}

int largest_sample_of_16_bits(std::string const& path) {
  depth_image samples;
  if (!read_16_bits(path, read_file(path), samples)) { return -1; }
  return *std::max_element(samples.pixels.begin(), samples.pixels.end());
}

depth_image read_depth_image(std::string const& path) {
  std::vector<std::uint8_t> const bytes = read_file(path);
  depth_image depth;
  if (detail::is_png(bytes)) { return detail::read_png_depth(path, bytes); }
  if (read_16_bits(path, bytes, depth)) { return depth; }
  fail(path, bytes.empty() ? "empty file"
                           : "no PNG or TIFF of one channel with 16 bits, which depth images are");
}

void write_depth_png(std::string const& path, depth_image const& depth) {
  write_file(path, detail::write_png_depth(path, depth));
}

void read_image_size(std::string const& path, int& width, int& height) {
  std::vector<std::uint8_t> const bytes = read_file(path);
  if (detail::is_png(bytes)) { return detail::read_png_size(path, bytes, width, height); }
  if (detail::is_jpeg(bytes)) { return detail::read_jpeg_size(path, bytes, width, height); }
  if (detail::is_pnm(bytes)) { return detail::read_pnm_size(path, bytes, width, height); }
  if (detail::is_bmp(bytes)) { return detail::read_bmp_size(path, bytes, width, height); }
  if (detail::is_tiff(bytes)) { return detail::read_tiff_size(path, bytes, width, height); }
  fail_unknown(path, bytes);
}

void write_png(std::string const& path, image const& picture, int compression) {
  write_file(path, detail::write_png(path, picture, compression));
}

std::vector<std::uint8_t> encode_png(image const& picture, int compression) {
  return detail::write_png("PNG", picture, compression);
}

std::vector<std::uint8_t> encode_jpeg(image const& picture, int quality) {
  return detail::write_jpeg("JPEG", picture, quality);
}

}  // namespace seq
