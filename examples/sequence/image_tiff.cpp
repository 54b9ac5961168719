// SPDX-License-Identifier: Apache-2.0
// TIFF by libtiff. Samples of 8 and 16 bits, grey or RGB, are taken as they are stored; what else
// libtiff knows (palettes, JPEG, single bits) as the colours that it makes of it. Cameras write
// strips.
#include <algorithm>
#include <cstdarg>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "examples/sequence/grey.hpp"
#include "examples/sequence/image_codecs.hpp"

#if FT_SEQUENCE_TIFF
#include <tiffio.h>
#endif

namespace seq::detail {

bool is_tiff(std::vector<std::uint8_t> const& b) {  // 43: BigTIFF
  return b.size() > 4 && ((b[0] == 'I' && b[1] == 'I' && (b[2] == 42 || b[2] == 43) && b[3] == 0) ||
                          (b[0] == 'M' && b[1] == 'M' && b[2] == 0 && (b[3] == 42 || b[3] == 43)));
}

#if FT_SEQUENCE_TIFF

bool reads_tiff() { return true; }

namespace {

/// A file in memory, as libtiff reads it.
struct tiff_memory {
  std::vector<std::uint8_t> const& bytes;
  std::size_t at = 0;
  std::string complaint = {};  ///< libtiff's first one
};

tiff_memory& memory_of(thandle_t handle) { return *static_cast<tiff_memory*>(handle); }

tmsize_t read_some(thandle_t handle, void* to, tmsize_t wanted) {
  tiff_memory& m = memory_of(handle);
  std::size_t const left = m.at < m.bytes.size() ? m.bytes.size() - m.at : 0;
  std::size_t const count = std::min(left, static_cast<std::size_t>(std::max<tmsize_t>(wanted, 0)));
  std::copy_n(m.bytes.data() + (left == 0 ? 0 : m.at), count, static_cast<std::uint8_t*>(to));
  m.at += count;
  return static_cast<tmsize_t>(count);
}

tmsize_t write_nothing(thandle_t, void*, tmsize_t) { return 0; }

toff_t seek_in(thandle_t handle, toff_t to, int from) {
  tiff_memory& m = memory_of(handle);
  m.at = static_cast<std::size_t>(to) + (from == SEEK_CUR   ? m.at
                                         : from == SEEK_END ? m.bytes.size()
                                                            : 0);
  return m.at;
}

int close_nothing(thandle_t) { return 0; }
toff_t size_of(thandle_t handle) { return memory_of(handle).bytes.size(); }

struct closer {
  void operator()(TIFF* file) const { TIFFClose(file); }
};
using tiff_file = std::unique_ptr<TIFF, closer>;

[[noreturn]] void fail_damaged(std::string const& path, tiff_memory const& m) {
  fail(path, "damaged or truncated TIFF" + (m.complaint.empty() ? "" : ": " + m.complaint));
}

#if TIFFLIB_VERSION >= 20221213  // 4.5.0; older ones print to stderr what they complain of
int keep_complaint(TIFF*, void* handle, char const*, char const* format, va_list arguments) {
  tiff_memory& m = *static_cast<tiff_memory*>(handle);
  char text[200];
  std::vsnprintf(text, sizeof text, format, arguments);
  if (m.complaint.empty()) { m.complaint = text; }
  return 1;  // and nobody else says it
}
int say_nothing(TIFF*, void*, char const*, char const*, va_list) { return 1; }
#endif

tiff_file open_tiff(std::string const& path, tiff_memory& m) {
  constexpr char const* mode = "rm";  // not mapped
#if TIFFLIB_VERSION >= 20221213
  std::unique_ptr<TIFFOpenOptions, void (*)(TIFFOpenOptions*)> const options(TIFFOpenOptionsAlloc(),
                                                                             TIFFOpenOptionsFree);
  TIFFOpenOptionsSetErrorHandlerExtR(options.get(), keep_complaint, &m);
  TIFFOpenOptionsSetWarningHandlerExtR(options.get(), say_nothing, &m);
  tiff_file file(TIFFClientOpenExt(path.c_str(), mode, &m, read_some, write_nothing, seek_in,
                                   close_nothing, size_of, nullptr, nullptr, options.get()));
#else
  tiff_file file(TIFFClientOpen(path.c_str(), mode, &m, read_some, write_nothing, seek_in,
                                close_nothing, size_of, nullptr, nullptr));
#endif
  if (!file) { fail_damaged(path, m); }
  return file;
}

template <typename T>
T tiff_value(tiff_file const& file, std::uint32_t tag, T otherwise) {
  T v{};
  return TIFFGetFieldDefaulted(file.get(), tag, &v) == 1 ? v : otherwise;
}

struct tiff_layout {
  std::uint32_t width = 0, height = 0;
  std::uint16_t samples = 1, bits = 1, colours = PHOTOMETRIC_MINISBLACK;
  bool planes = false;

  bool grey() const { return colours <= PHOTOMETRIC_MINISBLACK; }
  /// Whether rows of samples are taken as they are stored.
  bool as_stored() const {
    bool const known = grey() || (colours == PHOTOMETRIC_RGB && samples >= 3);
    return known && (bits == 8 || bits == 16);
  }
};

tiff_layout read_tiff_layout(std::string const& path, tiff_memory const& m, tiff_file const& file) {
  tiff_layout l;
  l.width = tiff_value<std::uint32_t>(file, TIFFTAG_IMAGEWIDTH, 0);
  l.height = tiff_value<std::uint32_t>(file, TIFFTAG_IMAGELENGTH, 0);
  check_side(path, l.width, l.height);
  l.samples = tiff_value<std::uint16_t>(file, TIFFTAG_SAMPLESPERPIXEL, 1);
  l.bits = tiff_value<std::uint16_t>(file, TIFFTAG_BITSPERSAMPLE, 1);
  l.colours = tiff_value<std::uint16_t>(file, TIFFTAG_PHOTOMETRIC, PHOTOMETRIC_MINISBLACK);
  l.planes = tiff_value<std::uint16_t>(file, TIFFTAG_PLANARCONFIG, 1) == PLANARCONFIG_SEPARATE;
  auto const refuse = [&](std::string const& what) {
    fail(path,
         "TIFF " + what + "; must have strips of whole numbers of at most 16 bits, grey or colour");
  };
  if (TIFFIsTiled(file.get()) != 0) { refuse("of tiles"); }
  std::uint16_t const format = tiff_value<std::uint16_t>(file, TIFFTAG_SAMPLEFORMAT, 1);
  if (format != SAMPLEFORMAT_UINT && format != SAMPLEFORMAT_VOID) {
    refuse("of numbers with signs or fractions");
  }
  if (l.samples == 0 || l.samples > 16) { refuse("of " + std::to_string(l.samples) + " samples"); }
  if (l.bits > 8 && !l.as_stored()) {
    refuse("of " + std::to_string(l.bits) + " bits, colours of type " + std::to_string(l.colours));
  }
  char reason[1024] = "";
  if (!l.as_stored() && TIFFRGBAImageOK(file.get(), reason) == 0) { refuse(std::string(reason)); }
  // Strips that overlap, or a size out of nowhere, would grow a short file without bound.
  std::uint64_t all = 0;
  std::uint32_t const pieces = TIFFNumberOfStrips(file.get());
  for (std::uint32_t i = 0; i < pieces && all <= m.bytes.size(); ++i) {
    all += TIFFGetStrileByteCount(file.get(), i);
  }
  constexpr std::uint64_t most_of_byte = 16384;  // pixels; black ones take Deflate half as many
  bool const enough = std::uint64_t{l.width} * l.height / most_of_byte <= m.bytes.size();
  if (pieces == 0 || all == 0 || all > m.bytes.size() || !enough) { fail_damaged(path, m); }
  return l;
}

/// The first channel of a grey image, the first three of a colour one; others are alpha.
tiff_samples read_stored(std::string const& path, tiff_memory const& m, tiff_file const& file,
                         tiff_layout const& l) {
  tiff_samples out;
  out.width = static_cast<int>(l.width);
  out.height = static_cast<int>(l.height);
  out.channels = l.grey() ? 1 : 3;
  out.bits = l.bits;
  auto const channels = static_cast<std::size_t>(out.channels);
  std::size_t const stored = l.planes ? 1 : l.samples;  // of a pixel in a row
  auto const bytes = static_cast<std::size_t>(TIFFScanlineSize64(file.get()));
  if (bytes < l.width * stored * (l.bits / 8U)) { fail_damaged(path, m); }
  std::vector<std::uint16_t> row(bytes / 2 + 1);
  auto const sample = [&](std::size_t i) -> unsigned {
    return l.bits == 16 ? row[i] : reinterpret_cast<std::uint8_t const*>(row.data())[i];
  };
  unsigned const brightest = (1U << l.bits) - 1;
  for (std::uint16_t plane = 0; plane < (l.planes ? channels : 1); ++plane) {
    for (std::uint32_t y = 0; y < l.height; ++y) {
      if (TIFFReadScanline(file.get(), row.data(), y, plane) != 1) { fail_damaged(path, m); }
      if (plane == 0) { out.values.resize(out.values.size() + l.width * channels); }
      std::uint16_t* const to = out.values.data() + std::size_t{y} * l.width * channels;
      for (std::size_t x = 0; x < l.width; ++x) {
        for (std::size_t c = plane; c < (l.planes ? plane + 1U : channels); ++c) {
          unsigned const v = sample(x * stored + (l.planes ? 0 : c));
          bool const inverted = l.colours == PHOTOMETRIC_MINISWHITE;
          to[x * channels + c] = static_cast<std::uint16_t>(inverted ? brightest - v : v);
        }
      }
    }
  }
  return out;
}

/// Three channels of 8 bits, as libtiff makes them.
tiff_samples read_converted(std::string const& path, tiff_memory const& m, tiff_file const& file,
                            tiff_layout const& l) {
  std::size_t const pixels = std::size_t{l.width} * l.height;
  std::vector<std::uint32_t> colours(pixels);
  if (TIFFReadRGBAImageOriented(file.get(), l.width, l.height, colours.data(), ORIENTATION_TOPLEFT,
                                1) != 1) {
    fail_damaged(path, m);
  }
  tiff_samples out{static_cast<int>(l.width), static_cast<int>(l.height), 3, 8, {}};
  out.values.reserve(3 * pixels);
  for (std::uint32_t const c : colours) {
    for (unsigned const v : {TIFFGetR(c), TIFFGetG(c), TIFFGetB(c)}) {
      out.values.push_back(static_cast<std::uint16_t>(v));
    }
  }
  return out;
}

}  // namespace

void read_tiff_size(std::string const& path, std::vector<std::uint8_t> const& bytes, int& width,
                    int& height) {
  tiff_memory m{bytes};
  tiff_layout const l = read_tiff_layout(path, m, open_tiff(path, m));
  width = static_cast<int>(l.width);
  height = static_cast<int>(l.height);
}

tiff_samples read_tiff_samples(std::string const& path, std::vector<std::uint8_t> const& bytes) {
  tiff_memory m{bytes};
  tiff_file const file = open_tiff(path, m);
  tiff_layout const l = read_tiff_layout(path, m, file);
  return l.as_stored() ? read_stored(path, m, file, l) : read_converted(path, m, file, l);
}

#else  // without libtiff

bool reads_tiff() { return false; }

namespace {
[[noreturn]] void refuse_tiff(std::string const& path) {
  fail(path,
       "TIFF, and this build has no libtiff: install it (libtiff-dev) and build again, or convert "
       "the images to PNG; read here are PNG, JPEG, binary PGM and PPM, and BMP");
}
}  // namespace

void read_tiff_size(std::string const& path, std::vector<std::uint8_t> const&, int&, int&) {
  refuse_tiff(path);
}
tiff_samples read_tiff_samples(std::string const& path, std::vector<std::uint8_t> const&) {
  refuse_tiff(path);
}

#endif

image read_tiff(std::string const& path, std::vector<std::uint8_t> const& bytes) {
  tiff_samples const s = read_tiff_samples(path, bytes);
  image out{s.width, s.height, {}};
  auto const channels = static_cast<std::size_t>(s.channels);
  auto const byte = [&](std::size_t i) {
    return static_cast<std::uint8_t>(s.bits == 16 ? s.values[i] >> 8 : s.values[i]);
  };
  for (std::size_t i = 0; i < s.values.size(); i += channels) {
    out.pixels.push_back(channels == 1 ? byte(i) : grey_of(byte(i), byte(i + 1), byte(i + 2)));
  }
  return out;
}

}  // namespace seq::detail
