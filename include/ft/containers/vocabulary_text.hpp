// SPDX-License-Identifier: Apache-2.0
/// @file Vocabularies in the text form of DBoW2: a line "k L scoring weighting", then a line a
/// node, ids 1, 2, ... by line, parents first: "parent leaf b0 ... b31 weight". Nodes with leaf
/// above 0 are words, numbered by line.
#pragma once

#include <charconv>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <istream>
#include <limits>
#include <locale>
#include <sstream>
#include <string>
#include <system_error>
#include <vector>

#include "ft/containers/keypoints.hpp"
#include "ft/containers/vocabulary.hpp"
#include "ft/containers/vocabulary_files.hpp"
#include "ft/containers/words.hpp"
#include "ft/core/config.hpp"
#include "ft/core/detail/read_stream.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Reads the numbers of a text line by line.
class number_lines {
public:
  /// @param line number of the first one
  number_lines(char const* begin, char const* end, int line = 1)
      : at_(begin), end_(end), line_(line) {}

  /// Goes to the next line that is not blank. @return false at the end
  bool next() {
    while (at_ != end_ && (*at_ == '\n' || is_space(*at_))) {
      line_ += static_cast<int>(*at_++ == '\n');
    }
    return at_ != end_;
  }
  /// @throws error unless an integer of [low, high] follows in this line
  int integer(char const* name, int low, int high) {
    skip_spaces();
    char const* const start = at_;
    bool const negative = at_ != end_ && *at_ == '-';
    if (negative) { ++at_; }
    std::int64_t value = 0;
    char const* const digits = at_;
    for (; at_ != end_ && *at_ >= '0' && *at_ <= '9' && at_ - digits < 18; ++at_) {
      value = 10 * value + (*at_ - '0');
    }
    if (at_ == digits || !at_space()) { refuse(start, std::string("an integer, ") + name); }
    if (negative) { value = -value; }
    if (value < low || value > high) {
      refuse(start, std::string(name) + ", must be in [" + std::to_string(low) + ", " +
                        std::to_string(high) + "]");
    }
    return static_cast<int>(value);
  }
  /// @throws error unless a finite number follows in this line
  double real(char const* name) {
    skip_spaces();
    char const* const start = at_;
    while (!at_space()) { ++at_; }
    double value = 0;
    if (!parse(start, at_, value) || !std::isfinite(value)) {
      refuse(start, std::string("a finite number, ") + name);
    }
    return value;
  }
  /// @throws error unless the line ends here
  void end_line() {
    skip_spaces();
    if (at_ != end_ && *at_ != '\n') { refuse(at_, "the end of the line"); }
  }

  static bool is_space(char c) {
    return c == ' ' || c == '\t' || c == '\r' || c == '\v' || c == '\f';
  }

private:
  bool at_space() const { return at_ == end_ || *at_ == '\n' || is_space(*at_); }
  void skip_spaces() {
    while (at_ != end_ && is_space(*at_)) { ++at_; }
  }
  static bool parse(char const* begin, char const* end, double& value) {
#if defined(__cpp_lib_to_chars)
    auto const result = std::from_chars(begin, end, value);
    return result.ec == std::errc() && result.ptr == end;
#else
    std::istringstream text(std::string(begin, end));
    text.imbue(std::locale::classic());
    return static_cast<bool>(text >> value) && text.eof();
#endif
  }
  [[noreturn]] void refuse(char const* start, std::string const& expected) const {
    char const* end = start;
    while (end != end_ && end - start < 40 && *end != '\n' && !is_space(*end)) { ++end; }
    throw error("ft: line " + std::to_string(line_) + " of the vocabulary has '" +
                std::string(start, end) + "' instead of " + expected);
  }

  char const* at_;
  char const* end_;
  int line_;
};

/// A vocabulary's arrays, filled line by line.
struct vocabulary_lines {
  vocabulary_header header;
  std::vector<int> parent{-1};
  std::vector<descriptor> orb{descriptor{}};
  std::vector<double> weight{0.0};
  std::vector<int> word{-1};
  int words = 0;

  /// Reads the first line that is not blank, at most, and refuses it before the rest is read.
  /// @return number of the next line
  int read_header(std::istream& from) {
    constexpr std::size_t longest = 256;
    std::string text;
    int line = 1;
    for (int c = from.get(); c != std::istream::traits_type::eof(); c = from.get()) {
      if (c == '\n' && !text.empty()) { break; }
      line += static_cast<int>(c == '\n');
      bool const blank = c == '\n' || number_lines::is_space(static_cast<char>(c));
      if (!blank || !text.empty()) { text += static_cast<char>(c); }
      if (text.size() > longest) {
        throw error("ft: line " + std::to_string(line) +
                    " of the vocabulary, with its branching, has more than " +
                    std::to_string(longest) + " characters");
      }
    }
    if (text.empty()) { throw error("ft: the vocabulary's text is empty"); }
    number_lines in(text.data(), text.data() + text.size(), line);
    read_header(in);
    return line + 1;
  }
  void read_header(number_lines& in) {
    header.branching = in.integer("the branching", 0, max_branching);
    header.levels = in.integer("the levels", 1, max_vocabulary_levels);
    header.scoring = static_cast<word_scoring>(in.integer("the scoring", 0, 5));
    header.weighting = static_cast<word_weighting>(in.integer("the weighting", 0, 3));
    in.end_line();
  }
  void read_node(number_lines& in) {
    constexpr int most = std::numeric_limits<int>::max();
    if (parent.size() >= static_cast<std::size_t>(most)) {
      throw error("ft: the vocabulary has too many nodes");
    }
    parent.push_back(
        in.integer("the parent, a line above", 0, static_cast<int>(parent.size()) - 1));
    word.push_back(in.integer("whether the node is a leaf", -most, most) > 0 ? words++ : -1);
    unsigned char bytes[sizeof(descriptor)];
    for (unsigned char& byte : bytes) {
      byte = static_cast<unsigned char>(in.integer("a byte of the descriptor", 0, 255));
    }
    orb.emplace_back();
    std::memcpy(static_cast<void*>(&orb.back()), bytes, sizeof bytes);
    weight.push_back(in.real("the weight"));
    in.end_line();
  }
  vocabulary_arrays arrays() const {
    int const n = static_cast<int>(parent.size());
    return {header, {parent.data(), n}, {orb.data(), n}, {weight.data(), n}, {word.data(), n}};
  }
};

}  // namespace detail

/// Reads the text form of DBoW2. Blank lines are skipped. For set-up: allocates.
/// @throws error naming the line, for what is not such a file; bad_argument for a tree that
///   make_vocabulary() refuses; std::bad_alloc
inline vocabulary<memory_space::host> read_vocabulary_text(std::istream& from) {
  if (!from) { throw error("ft: the vocabulary cannot be read from this stream"); }
  detail::vocabulary_lines lines;
  int const second = lines.read_header(from);
  {
    detail::file_bytes const file = detail::read_up_to(
        from, static_cast<std::size_t>(std::numeric_limits<std::streamsize>::max()));
    if (from.bad()) { throw error("ft: the vocabulary cannot be read from this stream"); }
    detail::number_lines in(file.data.get(), file.data.get() + file.size, second);
    while (in.next()) { lines.read_node(in); }
  }
  return make_vocabulary(lines.arrays());
}

/// Reads a file of either form: DBoW2's text begins with a number, ft's binary one does not. For
/// set-up: allocates.
/// @throws bad_argument if the file cannot be opened; error, naming the file, as
///   read_vocabulary_text() and load_vocabulary(); std::bad_alloc
inline vocabulary<memory_space::host> read_vocabulary(std::string const& file) {
  std::ifstream from(file, std::ios::binary);
  if (!from) { throw bad_argument("ft: vocabulary '" + file + "': cannot be opened"); }
  int const first = from.peek();
  try {
    bool const text = first >= '0' && first <= '9';
    return text ? read_vocabulary_text(from) : load_vocabulary(from);
  } catch (error const& e) { throw error("vocabulary '" + file + "': " + e.what()); }
}

}  // namespace FT_ABI
}  // namespace ft
