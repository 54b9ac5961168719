// SPDX-License-Identifier: Apache-2.0
// Images without compression: PGM and PPM (binary), BMP.
#include <algorithm>
#include <array>
#include <cstddef>
#include <string>

#include "examples/sequence/grey.hpp"
#include "examples/sequence/image_codecs.hpp"

namespace seq::detail {
namespace {

using bytes_of = std::vector<std::uint8_t>;

struct pnm_header {
  bool colour = false;
  unsigned long width = 0, height = 0, largest = 0;
  std::size_t data = 0;  ///< offset
};

bool is_blank(std::uint8_t c) { return c == ' ' || (c >= 9 && c <= 13); }

/// The next number of a header; blanks and comments before it are skipped.
unsigned long header_number(std::string const& path, bytes_of const& b, std::size_t& at) {
  while (at < b.size() && (is_blank(b[at]) || b[at] == '#')) {
    if (b[at] == '#') {
      while (at < b.size() && b[at] != '\n') { ++at; }
    } else {
      ++at;
    }
  }
  unsigned long value = 0;
  std::size_t const first = at;
  for (; at < b.size() && b[at] >= '0' && b[at] <= '9' && at - first < 9; ++at) {
    value = 10 * value + (b[at] - '0');
  }
  if (at == first) { fail(path, "damaged PGM or PPM header"); }
  return value;
}

pnm_header read_header(std::string const& path, bytes_of const& b) {
  pnm_header h;
  h.colour = b[1] == '6';
  std::size_t at = 2;
  h.width = header_number(path, b, at);
  h.height = header_number(path, b, at);
  check_side(path, h.width, h.height);
  h.largest = header_number(path, b, at);
  if (h.largest == 0 || h.largest > 65535) {
    fail(path, "largest value " + std::to_string(h.largest) + ", must be 1 to 65535");
  }
  if (at >= b.size() || !is_blank(b[at])) { fail(path, "damaged PGM or PPM header"); }
  h.data = at + 1;
  return h;
}

void check_bytes(std::string const& path, bytes_of const& b, std::size_t from, std::size_t wanted) {
  if (from > b.size() || b.size() - from < wanted) {
    fail(path, "truncated: " + std::to_string(b.size() - std::min(from, b.size())) +
                   " bytes of pixels, must have " + std::to_string(wanted));
  }
}

std::uint32_t little(bytes_of const& b, std::size_t at, int count) {
  std::uint32_t value = 0;
  for (int i = count - 1; i >= 0; --i) { value = value << 8 | b[at + static_cast<std::size_t>(i)]; }
  return value;
}

struct bmp_header {
  std::int64_t width = 0, height = 0;
  bool top_down = false;
  unsigned bits = 0;
  std::size_t data = 0, palette = 0, colours = 0;
};

bmp_header read_bmp_header(std::string const& path, bytes_of const& b) {
  if (b.size() < 54) { fail(path, "damaged BMP header"); }
  bmp_header h;
  std::size_t const size = little(b, 14, 4);
  if (size < 40 || size > 124) {
    fail(path, "BMP header of " + std::to_string(size) + " bytes, must be 40 to 124");
  }
  h.data = little(b, 10, 4);
  h.width = static_cast<std::int32_t>(little(b, 18, 4));
  h.height = static_cast<std::int32_t>(little(b, 22, 4));
  h.top_down = h.height < 0;
  if (h.top_down) { h.height = -h.height; }
  if (h.width < 0) { h.width = 0; }
  check_side(path, static_cast<unsigned long>(h.width), static_cast<unsigned long>(h.height));
  h.bits = little(b, 28, 2);
  std::uint32_t const compression = little(b, 30, 4);
  bool const plain = compression == 0 || (compression == 3 && h.bits == 32);
  if (!plain || (h.bits != 8 && h.bits != 24 && h.bits != 32)) {
    fail(path, "BMP of " + std::to_string(h.bits) + " bits with compression " +
                   std::to_string(compression) + ", must be 8, 24 or 32 bits without");
  }
  h.palette = 14 + size;
  h.colours = little(b, 46, 4);
  if (h.colours == 0) { h.colours = 256; }
  return h;
}

/// Grey of each colour of an 8-bit BMP.
std::array<std::uint8_t, 256> read_palette(std::string const& path, bytes_of const& b,
                                           bmp_header const& h) {
  if (h.colours > 256) { fail(path, "more than 256 colours in a BMP of 8 bits"); }
  check_bytes(path, b, h.palette, 4 * h.colours);
  std::array<std::uint8_t, 256> grey{};
  for (std::size_t i = 0; i < h.colours; ++i) {
    std::uint8_t const* const c = b.data() + h.palette + 4 * i;
    grey[i] = grey_of(c[2], c[1], c[0]);
  }
  return grey;
}

}  // namespace

bool is_pnm(bytes_of const& b) {
  return b.size() > 2 && b[0] == 'P' && (b[1] == '5' || b[1] == '6') &&
         (is_blank(b[2]) || b[2] == '#');
}
bool is_bmp(bytes_of const& b) { return b.size() > 2 && b[0] == 'B' && b[1] == 'M'; }

void read_pnm_size(std::string const& path, bytes_of const& bytes, int& width, int& height) {
  pnm_header const h = read_header(path, bytes);
  width = static_cast<int>(h.width);
  height = static_cast<int>(h.height);
}

void read_bmp_size(std::string const& path, bytes_of const& bytes, int& width, int& height) {
  bmp_header const h = read_bmp_header(path, bytes);
  width = static_cast<int>(h.width);
  height = static_cast<int>(h.height);
}

image read_pnm(std::string const& path, bytes_of const& bytes) {
  pnm_header const h = read_header(path, bytes);
  std::size_t const count = h.width * h.height;
  std::size_t const channels = h.colour ? 3 : 1;
  bool const wide = h.largest > 255;
  std::size_t const size = count * channels * (wide ? 2 : 1);
  check_bytes(path, bytes, h.data, size);
  std::uint8_t const* from = bytes.data() + h.data;
  // A header whose lines end as those of Windows.
  if (from[-1] == '\r' && from[0] == '\n' && bytes.size() - h.data == size + 1) { ++from; }
  auto const sample = [&]() -> std::uint8_t {
    unsigned value = *from++;
    if (wide) { value = value << 8 | *from++; }
    if (h.largest == 65535) { return static_cast<std::uint8_t>(value >> 8); }
    if (h.largest == 255) { return static_cast<std::uint8_t>(value); }
    auto const largest = static_cast<unsigned>(h.largest);
    return static_cast<std::uint8_t>((std::min(value, largest) * 255U + largest / 2) / largest);
  };
  image out{static_cast<int>(h.width), static_cast<int>(h.height), bytes_of(count)};
  for (std::uint8_t& pixel : out.pixels) {
    std::uint8_t const first = sample();
    if (h.colour) {
      std::uint8_t const green = sample();
      std::uint8_t const blue = sample();
      pixel = grey_of(first, green, blue);
    } else {
      pixel = first;
    }
  }
  return out;
}

image read_bmp(std::string const& path, bytes_of const& bytes) {
  bmp_header const h = read_bmp_header(path, bytes);
  auto const width = static_cast<std::size_t>(h.width);
  auto const height = static_cast<std::size_t>(h.height);
  std::size_t const stride = (width * h.bits + 31) / 32 * 4;
  check_bytes(path, bytes, h.data, stride * height);
  std::array<std::uint8_t, 256> palette{};
  if (h.bits == 8) { palette = read_palette(path, bytes, h); }
  image out{static_cast<int>(width), static_cast<int>(height), bytes_of(width * height)};
  for (std::size_t y = 0; y < height; ++y) {
    std::size_t const line = h.top_down ? y : height - 1 - y;
    std::uint8_t const* from = bytes.data() + h.data + stride * line;
    std::uint8_t* const to = out.pixels.data() + width * y;
    for (std::size_t x = 0; x < width; ++x, from += h.bits / 8) {
      to[x] = h.bits == 8 ? palette[from[0]] : grey_of(from[2], from[1], from[0]);
    }
  }
  return out;
}

}  // namespace seq::detail
