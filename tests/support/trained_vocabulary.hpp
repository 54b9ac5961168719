// SPDX-License-Identifier: Apache-2.0
/// @file A vocabulary made from descriptors, by clustering them level by level.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "ft/containers/keypoints.hpp"
#include "tests/support/plain_vocabulary.hpp"
#include "tests/support/random.hpp"

namespace test {

namespace detail {

/// The bits that most of the members have.
inline ft::descriptor median_of(std::vector<ft::descriptor> const& all,
                                std::vector<int> const& members) {
  int ones[256] = {};
  for (int const m : members) {
    for (int bit = 0; bit < 256; ++bit) {
      ones[bit] += static_cast<int>(all[at(m)].words[bit / 32] >> bit % 32 & 1u);
    }
  }
  ft::descriptor d{};
  for (int bit = 0; bit < 256; ++bit) {
    if (2 * ones[bit] > static_cast<int>(members.size())) { d.words[bit / 32] |= 1u << bit % 32; }
  }
  return d;
}

/// Adds a node for each of up to k clusters of the members, and what is below it.
inline void add_clusters(plain_vocabulary& v, std::vector<ft::descriptor> const& all,
                         std::vector<int> const& members, int parent, int level,
                         generator& random) {
  std::vector<ft::descriptor> centres;
  for (int i = 0; i < v.header.branching; ++i) {
    centres.push_back(all[at(members[at(random.below(static_cast<int>(members.size())))])]);
  }
  std::vector<std::vector<int>> clusters;
  for (int round = 0; round < 4; ++round) {
    clusters.assign(centres.size(), {});
    for (int const m : members) {
      auto const nearer = [&](ft::descriptor const& a, ft::descriptor const& b) {
        return ft::hamming(all[at(m)], a) < ft::hamming(all[at(m)], b);
      };
      auto const nearest = std::min_element(centres.begin(), centres.end(), nearer);
      clusters[static_cast<std::size_t>(nearest - centres.begin())].push_back(m);
    }
    for (std::size_t c = 0; c < centres.size(); ++c) {
      if (!clusters[c].empty()) { centres[c] = median_of(all, clusters[c]); }
    }
  }
  for (std::size_t c = 0; c < centres.size(); ++c) {
    if (clusters[c].empty()) { continue; }
    int const node = v.add(parent, centres[c]);
    if (level < v.header.levels) { add_clusters(v, all, clusters[c], node, level + 1, random); }
  }
}

}  // namespace detail

/// A vocabulary of k children a node and some levels, whose words all have the weight 1.
/// @param descriptors one or more
inline plain_vocabulary trained_vocabulary(std::vector<ft::descriptor> const& descriptors, int k,
                                           int levels) {
  plain_vocabulary v;
  v.header = {k, levels, ft::word_scoring::l1, ft::word_weighting::tf};
  std::vector<int> members(descriptors.size());
  for (std::size_t i = 0; i < members.size(); ++i) { members[i] = static_cast<int>(i); }
  generator random(1);
  detail::add_clusters(v, descriptors, members, 0, 1, random);
  std::vector<bool> inner(v.parent.size());
  for (int const p : v.parent) {
    if (p >= 0) { inner[at(p)] = true; }
  }
  int words = 0;
  for (std::size_t node = 1; node < v.parent.size(); ++node) {
    if (inner[node]) { continue; }
    v.word[node] = words++;
    v.weight[node] = 1;
  }
  return v;
}

}  // namespace test
