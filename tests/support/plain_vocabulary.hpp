// SPDX-License-Identifier: Apache-2.0
/// @file Vocabularies as plain arrays, and those that a rule makes.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <numeric>
#include <random>
#include <vector>

#include "ft/containers/vocabulary.hpp"
#include "ft/core/counter_draws.hpp"
#include "tests/support/random.hpp"

namespace test {

/// The arrays that a vocabulary is made of, over the ids of its nodes.
struct plain_vocabulary {
  ft::vocabulary_header header;
  std::vector<int> parent{-1};
  std::vector<ft::descriptor> orb{ft::descriptor{}};
  std::vector<double> weight{0.0};
  std::vector<int> word{-1};

  int nodes() const { return static_cast<int>(parent.size()); }
  ft::vocabulary_arrays arrays() const {
    return {header,
            {parent.data(), nodes()},
            {orb.data(), static_cast<int>(orb.size())},
            {weight.data(), static_cast<int>(weight.size())},
            {word.data(), static_cast<int>(word.size())}};
  }
  /// Appends a node without a word. @return its id
  int add(int below, ft::descriptor const& d) {
    parent.push_back(below);
    orb.push_back(d);
    weight.push_back(0.0);
    word.push_back(-1);
    return nodes() - 1;
  }
};

/// A full vocabulary whose descriptors and weights are drawn from counters: with k = 10 and L = 6
/// that which golden_words calls synth_k10_L6. Siblings at depth l differ from their parent in each
/// bit with a chance of 1 / 2^l.
inline plain_vocabulary drawn_vocabulary(int k, int levels) {
  ft::counter_draws const draws{12345};
  plain_vocabulary v;
  v.header = {k, levels, ft::word_scoring::l1, ft::word_weighting::tf_idf};
  int inner = 0;  // nodes above the last level
  int level = 1;
  for (int l = 0; l < levels; ++l, level *= k) { inner += level; }
  auto const n = static_cast<std::size_t>(inner + level);
  v.parent.resize(n);
  v.orb.resize(n);
  v.weight.assign(n, 0.0);
  v.word.assign(n, -1);
  int depth = 0;
  int level_end = 0;  // last node of this depth
  int width = 1;
  for (int node = 1; node < inner + level; ++node) {
    if (node > level_end) {
      ++depth;
      width *= k;
      level_end += width;
    }
    auto const i = static_cast<std::size_t>(node);
    auto const number = static_cast<std::uint64_t>(node);
    v.parent[i] = (node - 1) / k;
    std::uint64_t words[4];
    std::memcpy(words, v.orb[static_cast<std::size_t>(v.parent[i])].words, sizeof words);
    for (int w = 0; w < 4; ++w) {
      std::uint64_t flips = ~std::uint64_t{0};
      for (int j = 0; j < depth; ++j) { flips &= draws.bits(number, 8 * w + j); }
      words[w] ^= flips;
    }
    std::memcpy(v.orb[i].words, words, sizeof words);
    if (node < inner) { continue; }
    std::uint64_t const r = draws.bits(number, 63);
    v.word[i] = node - inner;
    v.weight[i] = r % 97 == 0 ? 0.0 : static_cast<double>(1 + (r >> 32) % 1024) / 128.0;
  }
  return v;
}

/// Nodes get other ids, the root keeps 0.
inline plain_vocabulary with_shuffled_ids(plain_vocabulary const& v, unsigned seed) {
  std::vector<int> id(v.parent.size());
  std::iota(id.begin(), id.end(), 0);
  std::shuffle(id.begin() + 1, id.end(), std::mt19937(seed));
  plain_vocabulary shuffled = v;
  for (std::size_t i = 0; i < id.size(); ++i) {
    std::size_t const to = at(id[i]);
    shuffled.parent[to] = i == 0 ? -1 : id[at(v.parent[i])];
    shuffled.orb[to] = v.orb[i];
    shuffled.weight[to] = v.weight[i];
    shuffled.word[to] = v.word[i];
  }
  return shuffled;
}

/// A vocabulary with leaves at all depths, siblings that are equal, words in any order, and weights
/// that are zero or negative. Parents have lower ids than their children.
/// @param leaves chance of a node above the last level to be one, percent
inline plain_vocabulary random_vocabulary(generator& random, int k, int levels, int leaves) {
  plain_vocabulary v;
  v.header = {k, levels, ft::word_scoring::l1, ft::word_weighting::tf_idf};
  std::vector<int> depth{0};
  std::vector<int> words;
  for (int node = 0; node < v.nodes(); ++node) {
    bool const leaf = depth[at(node)] == levels || (node > 0 && random.chance(leaves));
    int const children = leaf ? 0 : random.from_to(1, k);
    for (int c = 0; c < children; ++c) {
      bool const equal = c > 0 && random.chance(15);
      auto const d = equal ? v.orb.back() : random.flipped(v.orb[at(node)], 90);
      v.add(node, d);
      depth.push_back(depth[at(node)] + 1);
    }
    if (children == 0 && node > 0) { words.push_back(node); }
  }
  std::shuffle(words.begin(), words.end(), std::mt19937(static_cast<unsigned>(v.nodes())));
  for (std::size_t w = 0; w < words.size(); ++w) {
    v.word[at(words[w])] = static_cast<int>(w);
    double const weight = static_cast<double>(random.real(0.01f, 9.0f));
    v.weight[at(words[w])] = random.chance(10) ? 0.0 : random.chance(5) ? -weight : weight;
  }
  return v;
}

}  // namespace test
