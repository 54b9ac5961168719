// SPDX-License-Identifier: Apache-2.0
/// @file Vocabularies as files: the text form of DBoW2, and a binary form that loads faster.
///
/// The text form: a line "k L scoring weighting", then a line a node, ids 1, 2, ... by line,
/// parents first: "parent leaf b0 ... b31 weight". Nodes with leaf above 0 are words, numbered by
/// line.
///
/// The binary form, version 1, little-endian, without padding:
/// - 16 bytes "ft vocabulary" and zeros; uint32 version; uint32 0x01020304;
/// - int32 branching, levels, scoring, weighting, nodes;
/// - of all nodes in the order of vocabulary_view: the numbers of children, a byte each; ids,
///   uint32; words, uint32; weights, double; descriptors, 32 bytes;
/// - uint64 checksum of all bytes before it, see detail::checksum.
#pragma once

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <istream>
#include <limits>
#include <locale>
#include <memory>
#include <ostream>
#include <sstream>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "ft/containers/keypoints.hpp"
#include "ft/containers/vocabulary.hpp"
#include "ft/containers/words.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

struct file_bytes {
  std::unique_ptr<char[]> data;  // a vector would write it twice
  std::size_t size = 0;
};

/// Bytes of a stream from where it is to its end; 0 if it cannot tell.
inline std::size_t bytes_left(std::istream& from) {
  auto const here = from.tellg();
  std::size_t left = 0;
  if (here != std::istream::pos_type(-1) && from.seekg(0, std::ios::end)) {
    auto const bytes = static_cast<std::streamoff>(from.tellg() - here);
    left = bytes > 0 ? static_cast<std::size_t>(bytes) : 0;
    from.seekg(here);
  }
  from.clear();
  return left;
}

/// The rest of a stream. @throws error if it cannot be read; std::bad_alloc
inline file_bytes read_all(std::istream& from) {
  if (!from) { throw error("ft: the vocabulary cannot be read from this stream"); }
  // One more, so that the end is met without another block.
  std::size_t room = max_of(bytes_left(from), std::size_t{1} << 12) + 1;
  file_bytes file{std::unique_ptr<char[]>(new char[room]), 0};
  while (true) {
    from.read(file.data.get() + file.size, static_cast<std::streamsize>(room - file.size));
    file.size += static_cast<std::size_t>(from.gcount());
    if (file.size < room) { break; }
    std::unique_ptr<char[]> larger(new char[2 * room]);
    std::memcpy(larger.get(), file.data.get(), file.size);
    file.data = std::move(larger);
    room *= 2;
  }
  if (from.bad()) { throw error("ft: the vocabulary cannot be read from this stream"); }
  return file;
}

/// Reads the numbers of a text line by line.
class number_lines {
public:
  number_lines(char const* begin, char const* end) : at_(begin), end_(end) {}

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

private:
  static bool is_space(char c) {
    return c == ' ' || c == '\t' || c == '\r' || c == '\v' || c == '\f';
  }
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
  int line_ = 1;
};

/// A vocabulary's arrays, filled line by line.
struct vocabulary_lines {
  vocabulary_header header;
  std::vector<int> parent{-1};
  std::vector<descriptor> orb{descriptor{}};
  std::vector<double> weight{0.0};
  std::vector<int> word{-1};
  int words = 0;

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
    std::memcpy(orb.back().words, bytes, sizeof bytes);
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
  detail::vocabulary_lines lines;
  {
    detail::file_bytes const file = detail::read_all(from);
    detail::number_lines in(file.data.get(), file.data.get() + file.size);
    if (!in.next()) { throw error("ft: the vocabulary's text is empty"); }
    lines.read_header(in);
    while (in.next()) { lines.read_node(in); }
  }
  return make_vocabulary(lines.arrays());
}

namespace detail {

/// A hash of bytes as that of Fowler, Noll and Vo (FNV-1a, 64 bits), of little-endian words of
/// eight bytes, the last one filled with zeros; the upper half is folded into the lower one after
/// each, because a product passes nothing down.
inline std::uint64_t checksum(char const* data, std::size_t bytes) {
  std::uint64_t hash = 0xcbf29ce484222325u;
  for (std::size_t at = 0; at < bytes; at += sizeof hash) {
    std::uint64_t word = 0;
    std::memcpy(&word, data + at, min_of(sizeof word, bytes - at));
    hash = (hash ^ word) * 0x100000001b3u;
    hash ^= hash >> 32;
  }
  return hash;
}

struct vocabulary_file_head {
  char magic[16] = "ft vocabulary";
  std::uint32_t version = 1;
  std::uint32_t order = 0x01020304;
  std::int32_t branching = 0, levels = 0, scoring = 0, weighting = 0, nodes = 0;
};
static_assert(sizeof(vocabulary_file_head) == 44, "without padding");
inline constexpr std::size_t vocabulary_node_bytes = 1 + 4 + 4 + 8 + sizeof(descriptor);

/// Fills in the children of a breadth-first order from their numbers.
/// @throws error unless they make one tree within the header's limits
inline void place_children(vocabulary_view const& v, unsigned char const* counts) {
  std::int64_t next = 1;
  int depth = 0;
  std::int64_t level_end = 1;
  for (int at = 0; at < v.nodes; ++at) {
    if (at == level_end) {
      level_end = next;
      ++depth;
    }
    int const count = counts[at];
    bool const fits = next > at && next + count <= v.nodes && count <= v.header.branching &&
                      (count == 0 || depth < v.header.levels);
    if (!fits) { throw error("ft: the nodes of the vocabulary file are not a tree"); }
    v.children[at] = {static_cast<int>(next), count};
    next += count;
  }
  if (next != v.nodes) { throw error("ft: the nodes of the vocabulary file are not a tree"); }
}

/// @throws error unless ids and words are permutations, the root is node 0, siblings ascend and
///   weights are finite
inline void check_loaded_vocabulary(vocabulary_view const& v) {
  std::vector<bool> seen(static_cast<std::size_t>(v.nodes));
  std::vector<bool> taken(static_cast<std::size_t>(v.words));
  bool good = v.node[0] == 0;
  for (int at = 0; good && at < v.nodes; ++at) {
    std::uint32_t const node = v.node[at];
    std::uint32_t const word = v.word[at];
    node_children const& c = v.children[at];
    bool const leaf = at > 0 && c.count == 0;
    good = node < seen.size() && !seen[node] && std::isfinite(v.weight[at]) &&
           (leaf ? word < taken.size() && !taken[word] : word == no_word);
    if (!good) { break; }
    seen[node] = true;
    if (leaf) { taken[word] = true; }
    for (int k = 1; k < c.count; ++k) {
      good = good && v.node[c.first + k - 1] < v.node[c.first + k];
    }
  }
  if (!good) { throw error("ft: the vocabulary file has numbers out of range"); }
}

/// The head of a file whose size and checksum fit. @throws error
inline vocabulary_file_head check_vocabulary_file(char const* bytes, std::size_t size) {
  vocabulary_file_head const ours;
  vocabulary_file_head head;
  if (size < sizeof head || std::memcmp(bytes, ours.magic, sizeof ours.magic) != 0) {
    throw error("ft: this is not a vocabulary file");
  }
  std::memcpy(&head, bytes, sizeof head);
  if (head.version != ours.version || head.order != ours.order) {
    throw error("ft: the vocabulary file has another version or byte order");
  }
  std::uint64_t sum = 0;
  std::size_t const tail = sizeof head + sizeof sum;
  if (head.nodes < 1 || size < tail ||
      size - tail != checked_mul(static_cast<std::size_t>(head.nodes), vocabulary_node_bytes)) {
    throw error("ft: the vocabulary file is truncated, or has bytes after its end");
  }
  std::memcpy(&sum, bytes + size - sizeof sum, sizeof sum);
  if (checksum(bytes, size - sizeof sum) != sum) {
    throw error("ft: the vocabulary file is damaged");
  }
  return head;
}

}  // namespace detail

/// Writes the binary form. @param v a vocabulary that was made, in host memory
/// @throws bad_argument for an empty one; error if the stream cannot be written; std::bad_alloc
inline void save_vocabulary(std::ostream& to, vocabulary_view const& v) {
  detail::require(v.nodes >= 1, "the vocabulary to be saved was never made");
  detail::vocabulary_file_head head;
  head.branching = v.header.branching;
  head.levels = v.header.levels;
  head.scoring = static_cast<int>(v.header.scoring);
  head.weighting = static_cast<int>(v.header.weighting);
  head.nodes = v.nodes;
  auto const n = static_cast<std::size_t>(v.nodes);
  std::string file;
  file.reserve(sizeof head + n * detail::vocabulary_node_bytes);
  auto const put = [&](auto const* data, std::size_t count) {
    file.append(reinterpret_cast<char const*>(data), count * sizeof *data);
  };
  put(&head, 1);
  for (std::size_t i = 0; i < n; ++i) { file += static_cast<char>(v.children[i].count); }
  put(v.node, n);
  put(v.word, n);
  put(v.weight, n);
  put(v.orb, n);
  std::uint64_t const sum = detail::checksum(file.data(), file.size());
  to.write(file.data(), static_cast<std::streamsize>(file.size()));
  to.write(reinterpret_cast<char const*>(&sum), sizeof sum);
  to.flush();
  if (!to) { throw error("ft: the vocabulary could not be written"); }
}

/// Reads the binary form, to the end of the stream. For set-up: allocates.
/// @throws error for a file that is truncated, damaged, of another version, or no vocabulary;
///   bad_argument for a header out of range; std::bad_alloc
inline vocabulary<memory_space::host> load_vocabulary(std::istream& from) {
  detail::file_bytes const file = detail::read_all(from);
  auto const head = detail::check_vocabulary_file(file.data.get(), file.size);
  vocabulary_header const header{head.branching, head.levels,
                                 static_cast<word_scoring>(head.scoring),
                                 static_cast<word_weighting>(head.weighting)};
  char const* at = file.data.get() + sizeof head;
  auto const* const counts = reinterpret_cast<unsigned char const*>(at);
  auto const words = std::count(counts + 1, counts + head.nodes, 0);
  vocabulary<memory_space::host> made(header, head.nodes, static_cast<int>(words));
  vocabulary_view const& v = made.view();
  auto const n = static_cast<std::size_t>(v.nodes);
  detail::place_children(v, counts);
  at += n;
  auto const take = [&](auto* to) {
    std::memcpy(static_cast<void*>(to), at, n * sizeof *to);
    at += n * sizeof *to;
  };
  take(v.node);
  take(v.word);
  take(v.weight);
  take(v.orb);
  detail::check_loaded_vocabulary(v);
  return made;
}

}  // namespace FT_ABI
}  // namespace ft
