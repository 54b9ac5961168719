// SPDX-License-Identifier: Apache-2.0
/// @file Vocabularies in a binary form of ft's own, which loads ten times faster than text. Version
/// 1, little-endian, without padding:
/// - 16 bytes "ft vocabulary" and zeros; uint32 version; uint32 0x01020304;
/// - int32 branching, levels, scoring, weighting, nodes;
/// - of all nodes in the order of vocabulary_view: the numbers of children, a byte each; ids,
///   uint32; words, uint32; weights, double; descriptors, 32 bytes;
/// - uint64 detail::checksum of the parts before it, of the head and of each array.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <istream>
#include <ostream>
#include <sstream>
#include <string>
#include <vector>

#include "ft/containers/keypoints.hpp"
#include "ft/containers/vocabulary.hpp"
#include "ft/containers/words.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/detail/read_stream.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// A hash of the parts of a file. Its words of eight bytes go to four hashes in turn, each as that
/// of Fowler, Noll and Vo (FNV-1a, 64 bits), whose upper half is folded into the lower one after
/// each word: a product passes nothing down. The last words of a part are filled with zeros.
class checksum {
public:
  /// Adds a part, or a piece of one that is not its last and has a multiple of 32 bytes.
  void add(void const* data, std::size_t bytes) {
    auto const* const from = static_cast<char const*>(data);
    std::uint64_t hash[4] = {hash_[0], hash_[1], hash_[2], hash_[3]};  // in registers
    std::size_t at = 0;
    for (; bytes - at >= sizeof hash; at += sizeof hash) { add_words(hash, from + at); }
    if (at < bytes) {
      char last[sizeof hash] = {};
      std::memcpy(last, from + at, bytes - at);
      add_words(hash, last);
    }
    std::memcpy(hash_, hash, sizeof hash);
  }
  std::uint64_t value() const {
    std::uint64_t sum = start;
    for (std::uint64_t const h : hash_) { sum = added(sum, h); }
    return sum;
  }

private:
  static constexpr std::uint64_t start = 0xcbf29ce484222325u;
  static std::uint64_t added(std::uint64_t hash, std::uint64_t word) {
    hash = (hash ^ word) * 0x100000001b3u;
    return hash ^ hash >> 32;
  }
  static void add_words(std::uint64_t (&hash)[4], char const* from) {
    std::uint64_t words[4];
    std::memcpy(words, from, sizeof words);
    for (int k = 0; k < 4; ++k) { hash[k] = added(hash[k], words[k]); }
  }

  std::uint64_t hash_[4] = {start, start, start, start};
};

struct vocabulary_file_head {
  char magic[16] = "ft vocabulary";
  std::uint32_t version = 1;
  std::uint32_t order = 0x01020304;
  std::int32_t branching = 0, levels = 0, scoring = 0, weighting = 0, nodes = 0;
};
static_assert(sizeof(vocabulary_file_head) == 44, "without padding");
inline constexpr std::size_t vocabulary_node_bytes = 1 + 4 + 4 + 8 + sizeof(descriptor);

inline vocabulary_header header_of(vocabulary_file_head const& head) {
  return {head.branching, head.levels, static_cast<word_scoring>(head.scoring),
          static_cast<word_weighting>(head.weighting)};
}

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

/// Reads the parts of a file and adds them to a checksum.
struct checked_reader {
  std::istream& from;
  checksum sum;

  /// @throws error if there are fewer bytes
  void read(void* to, std::size_t bytes) {
    constexpr std::size_t piece = std::size_t{1} << 17;  // added while it is in a cache
    for (std::size_t at = 0; at < bytes; at += piece) {
      char* const part = static_cast<char*>(to) + at;
      std::size_t const size = min_of(piece, bytes - at);
      from.read(part, static_cast<std::streamsize>(size));
      if (static_cast<std::size_t>(from.gcount()) != size) {
        throw error("ft: the vocabulary file cannot be read to its end");
      }
      sum.add(part, size);
    }
  }
};

/// Reads a head, and refuses it before anything of what it says is allocated.
/// @throws error; bad_argument for numbers out of range
inline vocabulary_file_head read_vocabulary_head(std::istream& from) {
  vocabulary_file_head const ours;
  vocabulary_file_head head;
  from.read(reinterpret_cast<char*>(&head), sizeof head);
  if (static_cast<std::size_t>(from.gcount()) != sizeof head ||
      std::memcmp(head.magic, ours.magic, sizeof ours.magic) != 0) {
    throw error("ft: this is not a vocabulary file");
  }
  if (head.version != ours.version || head.order != ours.order) {
    throw error("ft: the vocabulary file has another version or byte order");
  }
  header_of(head).check();
  if (head.nodes < 1) {
    throw error("ft: the vocabulary file has " + std::to_string(head.nodes) +
                " nodes, is damaged or truncated");
  }
  return head;
}

/// @throws error unless as many bytes as a head says follow it
inline void require_vocabulary_bytes(std::size_t there, std::size_t wanted) {
  if (there == wanted) { return; }
  throw error("ft: the vocabulary file is truncated, or has bytes after its end: " +
              std::to_string(there) + " bytes follow its head, must be " + std::to_string(wanted));
}

/// Reads what follows a head.
inline vocabulary<memory_space::host> load_vocabulary_arrays(vocabulary_file_head const& head,
                                                             std::istream& from) {
  checked_reader in{from, {}};
  in.sum.add(&head, sizeof head);
  std::vector<unsigned char> counts(static_cast<std::size_t>(head.nodes));
  in.read(counts.data(), counts.size());
  auto const words = std::count(counts.begin() + 1, counts.end(), 0);
  vocabulary<memory_space::host> made(header_of(head), head.nodes, static_cast<int>(words));
  vocabulary_view const& v = made.view();
  auto const read = [&](auto* to) { in.read(to, counts.size() * sizeof *to); };
  read(v.node);
  read(v.word);
  read(v.weight);
  read(v.orb);
  std::uint64_t const sum = in.sum.value();
  std::uint64_t stored = 0;
  in.read(&stored, sizeof stored);
  if (stored != sum) { throw error("ft: the vocabulary file is damaged"); }
  place_children(v, counts.data());
  check_loaded_vocabulary(v);
  return made;
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
  std::vector<unsigned char> counts(n);
  for (std::size_t i = 0; i < n; ++i) {
    counts[i] = static_cast<unsigned char>(v.children[i].count);
  }
  detail::checksum sum;
  auto const put = [&](auto const* data, std::size_t count) {
    sum.add(data, count * sizeof *data);
    to.write(reinterpret_cast<char const*>(data),
             static_cast<std::streamsize>(count * sizeof *data));
  };
  put(&head, 1);
  put(counts.data(), n);
  put(v.node, n);
  put(v.word, n);
  put(v.weight, n);
  put(v.orb, n);
  std::uint64_t const value = sum.value();
  to.write(reinterpret_cast<char const*>(&value), sizeof value);
  to.flush();
  if (!to) { throw error("ft: the vocabulary could not be written"); }
}

/// Reads the binary form: as many bytes as its head says. For set-up: allocates.
/// @throws error for a file that is truncated, damaged, of another version, or no vocabulary, or
/// for
///   bytes after its end in a stream that can be positioned; bad_argument for a header out of
///   range; std::bad_alloc
inline vocabulary<memory_space::host> load_vocabulary(std::istream& from) {
  if (!from) { throw error("ft: the vocabulary cannot be read from this stream"); }
  auto const head = detail::read_vocabulary_head(from);
  std::size_t const wanted =
      sizeof(std::uint64_t) +
      detail::checked_mul(static_cast<std::size_t>(head.nodes), detail::vocabulary_node_bytes);
  if (std::size_t const left = detail::bytes_left(from)) {
    detail::require_vocabulary_bytes(left, wanted);
    return detail::load_vocabulary_arrays(head, from);
  }
  detail::file_bytes const file = detail::read_up_to(from, wanted);
  detail::require_vocabulary_bytes(file.size, wanted);
  std::istringstream copy(std::string(file.data.get(), file.size));
  return detail::load_vocabulary_arrays(head, copy);
}

}  // namespace FT_ABI
}  // namespace ft
