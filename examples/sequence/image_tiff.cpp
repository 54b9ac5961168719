// SPDX-License-Identifier: Apache-2.0
// TIFF as cameras and OpenCV write it: strips, without compression, or with LZW or PackBits.
// Source: TIFF, revision 6.0, Adobe, 1992, sections 2 to 9, 13, 14.
#include <algorithm>
#include <cstddef>
#include <string>

#include "examples/sequence/grey.hpp"
#include "examples/sequence/image_codecs.hpp"

namespace seq::detail {
namespace {

using bytes_of = std::vector<std::uint8_t>;

enum tag : unsigned {
  wide = 256,
  high = 257,
  bits_of_samples = 258,
  compression = 259,
  photometric = 262,
  fill_order = 266,
  strip_offsets = 273,
  samples_of_pixel = 277,
  rows_of_strip = 278,
  strip_bytes = 279,
  planar = 284,
  predictor = 317,
  tile_width = 322,
  sample_format = 339,
};
enum scheme : unsigned { plain = 1, lzw = 5, pack_bits = 32773 };

/// The numbers of a file's first directory.
class directory {
public:
  directory(std::string const& path, bytes_of const& b) : path_(path), b_(b), little_(b[0] == 'I') {
    if (b.size() < 8) { damaged(); }
    std::size_t const at = number(4, 4);
    require(at, 2);
    count_ = number(at, 2);
    first_ = at + 2;
    require(first_, 12 * count_);
  }

  bool little() const { return little_; }
  std::vector<std::size_t> values(unsigned wanted) const {
    for (std::size_t i = 0; i < count_; ++i) {
      std::size_t const at = first_ + 12 * i;
      if (number(at, 2) != wanted) { continue; }
      std::size_t const type = number(at + 2, 2);  // 1 byte, 3 short, 4 long
      int const size = type == 1 ? 1 : type == 3 ? 2 : type == 4 ? 4 : 0;
      std::size_t const n = number(at + 4, 4);
      if (size == 0 || n == 0 || n > b_.size()) { damaged(); }
      std::size_t const bytes = n * static_cast<std::size_t>(size);
      std::size_t from = at + 8;
      if (bytes > 4) { from = number(at + 8, 4); }
      require(from, bytes);
      std::vector<std::size_t> all;
      for (std::size_t k = 0; k < n; ++k) {
        all.push_back(number(from + k * static_cast<std::size_t>(size), size));
      }
      return all;
    }
    return {};
  }
  std::size_t value(unsigned wanted, std::size_t otherwise) const {
    std::vector<std::size_t> const all = values(wanted);
    return all.empty() ? otherwise : all[0];
  }
  [[noreturn]] void damaged() const { fail(path_, "damaged or truncated TIFF"); }

private:
  void require(std::size_t from, std::size_t bytes) const {
    if (from > b_.size() || b_.size() - from < bytes) { damaged(); }
  }
  /// @pre the bytes are there
  std::size_t number(std::size_t at, int bytes) const {
    std::size_t value = 0;
    for (int i = 0; i < bytes; ++i) {
      int const k = little_ ? bytes - 1 - i : i;
      value = value << 8 | b_[at + static_cast<std::size_t>(k)];
    }
    return value;
  }

  std::string const& path_;
  bytes_of const& b_;
  bool little_;
  std::size_t count_ = 0, first_ = 0;
};

struct layout {
  std::size_t width = 0, height = 0, channels = 0, bits = 0, rows = 0;
  std::size_t packing = plain;
  bool differences = false;  ///< a sample is the difference to the one on its left
  bool white_is_zero = false;
  std::vector<std::size_t> offsets, bytes;

  std::size_t row_bytes() const { return width * channels * (bits / 8); }
};

layout read_layout(std::string const& path, directory const& d) {
  layout l;
  l.width = d.value(wide, 0);
  l.height = d.value(high, 0);
  check_side(path, l.width, l.height);
  auto const refuse = [&](std::string const& what) {
    fail(path, "TIFF " + what +
                   "; must have strips of 1, 3 or 4 samples of 8 or 16 bits, side by side, grey or "
                   "RGB, and no compression, LZW or PackBits");
  };
  std::size_t const colours = d.value(photometric, 1);
  std::vector<std::size_t> const bits = d.values(bits_of_samples);
  l.bits = bits.empty() ? 1 : bits[0];
  l.channels = d.value(samples_of_pixel, 1);
  l.packing = d.value(compression, plain);
  l.white_is_zero = colours == 0;
  l.differences = d.value(predictor, 1) == 2;
  bool const grey = colours <= 1 && l.channels == 1;
  bool const colour = colours == 2 && (l.channels == 3 || l.channels == 4);
  if (!grey && !colour) {
    refuse("of " + std::to_string(l.channels) + " samples a pixel, colours of type " +
           std::to_string(colours));
  }
  bool const equal = std::all_of(bits.begin(), bits.end(), [&](auto n) { return n == l.bits; });
  if ((l.bits != 8 && l.bits != 16) || !equal) { refuse("of " + std::to_string(l.bits) + " bits"); }
  if (l.packing != plain && l.packing != lzw && l.packing != pack_bits) {
    refuse("with compression " + std::to_string(l.packing));
  }
  if (d.value(tile_width, 0) != 0) { refuse("of tiles"); }
  if (l.channels > 1 && d.value(planar, 1) != 1) { refuse("with planes"); }
  if (d.value(predictor, 1) > 2) { refuse("with predictor 3"); }
  if (l.differences && l.packing != lzw) { refuse("with a predictor and no LZW"); }
  if (d.value(fill_order, 1) != 1) { refuse("with the lowest bit first"); }
  if (d.value(sample_format, 1) != 1) { refuse("of numbers with signs or fractions"); }
  l.rows = std::min(d.value(rows_of_strip, l.height), l.height);
  l.offsets = d.values(strip_offsets);
  l.bytes = d.values(strip_bytes);
  std::size_t const strips = l.rows == 0 ? 0 : (l.height + l.rows - 1) / l.rows;
  if (strips == 0 || l.offsets.size() != strips || l.bytes.size() != strips) { d.damaged(); }
  return l;
}

/// Appends what the bytes hold, up to `most` in all. False where they are damaged.
bool unpack_bits(std::uint8_t const* from, std::uint8_t const* end, std::size_t most,
                 bytes_of& out) {
  while (out.size() < most && from < end) {
    int const n = *from++;
    if (n == 128) { continue; }
    std::size_t const count = static_cast<std::size_t>(n < 128 ? n + 1 : 257 - n);
    if (n < 128) {
      if (static_cast<std::size_t>(end - from) < count) { return false; }
      out.insert(out.end(), from, from + count);
      from += count;
    } else {
      if (from == end) { return false; }
      out.insert(out.end(), count, *from++);
    }
  }
  return out.size() >= most;
}

/// LZW with codes of 9 to 12 bits, the highest bit first; the width grows a code early.
class lzw_decoder {
public:
  bool unpack(std::uint8_t const* from, std::uint8_t const* end, std::size_t most, bytes_of& out) {
    constexpr unsigned clear = 256, last = 257;
    unsigned held = 0;  // bits that were read and not used
    int bits = 0;
    int width = 9;
    unsigned before = none;
    while (out.size() < most) {
      while (bits < width) {
        if (from == end) { return false; }
        held = held << 8 | *from++;
        bits += 8;
      }
      bits -= width;
      unsigned const code = held >> bits & ((1U << width) - 1);
      held &= (1U << bits) - 1;
      if (code == last) { return false; }
      if (code == clear) {
        next_ = 258;
        width = 9;
        before = none;
        continue;
      }
      std::size_t const begin = out.size();
      if (!append(code, before, out)) { return false; }
      if (before != none && next_ < codes) {
        start_[next_] = last_begin_;  // the string before, and the first byte of this one behind it
        length_[next_++] = begin - last_begin_ + 1;
      }
      last_begin_ = begin;
      before = code;
      if (next_ + 1 >= 1U << width && width < 12) { ++width; }
    }
    return true;
  }

private:
  static constexpr unsigned codes = 4096;
  static constexpr unsigned none = codes;

  bool append(unsigned code, unsigned before, bytes_of& out) const {
    if (code < 256) {
      out.push_back(static_cast<std::uint8_t>(code));
      return true;
    }
    bool const known = code < next_;
    if (before == none || (!known && (code != next_ || next_ >= codes))) { return false; }
    std::size_t const from = known ? start_[code] : last_begin_;
    std::size_t const length = known ? length_[code] : out.size() - last_begin_ + 1;
    for (std::size_t i = 0; i < length; ++i) { out.push_back(out[from + i]); }
    return true;
  }

  std::size_t start_[codes] = {};  ///< in the output, of a code's string
  std::size_t length_[codes] = {};
  std::size_t last_begin_ = 0;
  unsigned next_ = 258;
};

/// The bytes of all rows.
bytes_of unpacked(bytes_of const& b, layout const& l, directory const& d) {
  bytes_of out;
  std::size_t left = b.size();  // strips that overlap would grow a short file without bound
  for (std::size_t s = 0; s < l.offsets.size(); ++s) {
    if (l.bytes[s] > left) { d.damaged(); }
    left -= l.bytes[s];
    std::size_t const rows = std::min(l.rows, l.height - s * l.rows);
    std::size_t const most = out.size() + rows * l.row_bytes();
    if (l.offsets[s] > b.size() || b.size() - l.offsets[s] < l.bytes[s]) { d.damaged(); }
    std::uint8_t const* const from = b.data() + l.offsets[s];
    std::uint8_t const* const end = from + l.bytes[s];
    bool whole = false;
    if (l.packing == plain) {
      whole = l.bytes[s] >= most - out.size();
      if (whole) { out.insert(out.end(), from, from + (most - out.size())); }
    } else if (l.packing == pack_bits) {
      whole = unpack_bits(from, end, most, out);
    } else {
      whole = lzw_decoder().unpack(from, end, most, out);
    }
    if (!whole) { d.damaged(); }
    out.resize(most);
  }
  return out;
}

}  // namespace

bool is_tiff(bytes_of const& b) {
  return b.size() > 4 && ((b[0] == 'I' && b[1] == 'I' && b[2] == 42 && b[3] == 0) ||
                          (b[0] == 'M' && b[1] == 'M' && b[2] == 0 && b[3] == 42));
}

void read_tiff_size(std::string const& path, bytes_of const& bytes, int& width, int& height) {
  layout const l = read_layout(path, directory(path, bytes));
  width = static_cast<int>(l.width);
  height = static_cast<int>(l.height);
}

tiff_samples read_tiff_samples(std::string const& path, bytes_of const& bytes) {
  directory const d(path, bytes);
  layout const l = read_layout(path, d);
  bytes_of const packed = unpacked(bytes, l, d);
  tiff_samples out;
  out.width = static_cast<int>(l.width);
  out.height = static_cast<int>(l.height);
  out.channels = static_cast<int>(l.channels);
  out.bits = static_cast<int>(l.bits);
  std::size_t const count = l.width * l.channels * l.height;
  out.values.resize(count);
  unsigned const largest = (1U << l.bits) - 1;
  for (std::size_t i = 0; i < count; ++i) {
    unsigned value = packed[i];
    if (l.bits == 16) {
      unsigned const first = packed[2 * i];
      unsigned const second = packed[2 * i + 1];
      value = d.little() ? second << 8 | first : first << 8 | second;
    }
    bool const has_left = i % (l.width * l.channels) >= l.channels;
    if (l.differences && has_left) { value = (value + out.values[i - l.channels]) & largest; }
    out.values[i] = static_cast<std::uint16_t>(value);
  }
  if (l.white_is_zero) {
    for (std::uint16_t& value : out.values) { value = static_cast<std::uint16_t>(largest - value); }
  }
  return out;
}

image read_tiff(std::string const& path, bytes_of const& bytes) {
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
