// SPDX-License-Identifier: Apache-2.0
/// @file What tells the vocabulary of a file from the one that ORB-SLAM3 is started with.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "ft/containers/vocabulary.hpp"
#include "ft/containers/vocabulary_files.hpp"
#include "ft/core/error.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft::orbslam3 {
inline namespace FT_ABI {

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

}  // namespace FT_ABI
}  // namespace ft::orbslam3
