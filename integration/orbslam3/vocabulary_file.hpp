// SPDX-License-Identifier: Apache-2.0
/// @file The vocabulary that ORB-SLAM3 is started with, from its file.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iomanip>
#include <istream>
#include <sstream>
#include <string>
#include <system_error>
#include <vector>

#include "ft/containers/vocabulary.hpp"
#include "ft/containers/vocabulary_files.hpp"
#include "ft/containers/vocabulary_text.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

namespace vocabulary_detail {

/// The name of the binary form of a text: with its size and the hash of all of it, so that another
/// text has another name, whatever the files' dates. Reads `text` to its end, and goes back.
inline std::string name_beside(std::string const& path, std::istream& text) {
  detail::checksum hash;
  std::size_t size = 0;
  std::vector<char> part(std::size_t{1} << 20);
  do {
    text.read(part.data(), static_cast<std::streamsize>(part.size()));
    auto const n = static_cast<std::size_t>(text.gcount());
    size += n;
    hash.add(part.data(), n);
  } while (text);
  text.clear();
  text.seekg(0);
  std::ostringstream name;
  name << path << "." << size << "-" << std::hex << std::setw(16) << std::setfill('0')
       << hash.value() << ".ft";
  return name.str();
}
/// Where it cannot be written, the next start reads the text again. Several processes may write.
inline void write_beside(std::string const& file, vocabulary_view const& v) {
  auto const now = std::chrono::steady_clock::now().time_since_epoch().count();
  std::string const part = file + "." + std::to_string(now);
  std::error_code failed;
  try {
    std::ofstream to(part, std::ios::binary);
    if (!to) { return; }
    save_vocabulary(to, v);
    to.close();
    if (to) { std::filesystem::rename(part, file, failed); }
  } catch (error const&) {  // no room
  }
  std::filesystem::remove(part, failed);
}

}  // namespace vocabulary_detail

/// `facts` with the hashes of its words, but for those of weight 0 at the end.
/// @param weight,descriptor of a word: a double; 32 bytes, any type without padding
template <typename Weight, typename Descriptor>
vocabulary_facts facts_of(vocabulary_facts facts, Weight const& weight,
                          Descriptor const& descriptor) {
  while (facts.words > 0 && weight(facts.words - 1) == 0) { --facts.words; }
  detail::checksum weights;
  detail::checksum descriptors;
  for (std::size_t w = 0; w < facts.words; ++w) {
    double const value = weight(w);
    weights.add(&value, sizeof value);
    auto const& bits = descriptor(w);
    descriptors.add(&bits, 32);
  }
  facts.weights = weights.value();
  facts.descriptors = descriptors.value();
  return facts;
}

/// Of a vocabulary in host memory. Words of weight 0 at the end are left out: ORB-SLAM3's reader
/// makes one of the empty line at the end of a file.
inline vocabulary_facts facts_of(vocabulary_view const& v) {
  std::vector<int> node(static_cast<std::size_t>(v.words));
  for (int i = 0; i < v.nodes; ++i) {
    if (v.word[i] != no_word) { node[v.word[i]] = i; }
  }
  return facts_of(
      {v.header.branching, v.header.levels, static_cast<int>(v.header.scoring),
       static_cast<int>(v.header.weighting), node.size(), 0, 0},
      [&](std::size_t w) { return v.weight[node[w]]; },
      [&](std::size_t w) { return v.orb[node[w]]; });
}

/// @throws error naming the file and what differs, with both values
inline void require_same(std::string const& path, vocabulary_facts const& got,
                         vocabulary_facts const& want) {
  auto const same = [&](char const* name, auto a, auto b) {
    if (a == b) { return; }
    throw error("ft: the vocabulary '" + path + "' is not the System's: " + name + " " +
                std::to_string(a) + ", the System's " + std::to_string(b));
  };
  same("branching", got.branching, want.branching);
  same("levels", got.levels, want.levels);
  same("scoring", got.scoring, want.scoring);
  same("weighting", got.weighting, want.weighting);
  same("number of words", got.words, want.words);
  same("hash of the words' descriptors", got.descriptors, want.descriptors);
  same("hash of the words' weights", got.weights, want.weights);
}

/// Reads DBoW2's text form, or ft's binary form. Of a text the binary form is written beside it,
/// as "<path>.<size>-<hash>.ft", and read instead of a text of that size and hash.
/// @throws error for a file that cannot be opened or is no vocabulary; bad_argument, std::bad_alloc
inline vocabulary<memory_space::host> read_vocabulary(std::string const& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) { throw error("ft: the vocabulary '" + path + "' cannot be opened"); }
  char first[sizeof "ft vocabulary"] = {};
  file.read(first, sizeof first);
  file.clear();
  file.seekg(0);
  if (std::memcmp(first, "ft vocabulary", sizeof first) == 0) { return load_vocabulary(file); }
  std::string const beside = vocabulary_detail::name_beside(path, file);
  std::ifstream binary(beside, std::ios::binary);
  if (binary) {
    try {
      return load_vocabulary(binary);
    } catch (error const&) {  // damaged, or of another version: made again
    }
  }
  auto made = read_vocabulary_text(file);
  vocabulary_detail::write_beside(beside, made.view());
  return made;
}

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
