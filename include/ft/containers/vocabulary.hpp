// SPDX-License-Identifier: Apache-2.0
/// @file A vocabulary of binary words: a tree of descriptors whose leaves are the words. Source:
/// Gálvez-López and Tardós, "Bags of binary words for fast place recognition in image sequences",
/// T-RO 2012.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <type_traits>
#include <vector>

#include "ft/containers/columns.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/words.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/views.hpp"

namespace ft {
inline namespace FT_ABI {

inline constexpr int max_branching = 20;
inline constexpr int max_vocabulary_levels = 10;

/// What a vocabulary's file says about it.
struct vocabulary_header {
  int branching = 10;  ///< most children of a node, 0 to 20; k in the paper
  int levels = 6;      ///< largest depth, 1 to 10; the root's is 0; L in the paper
  word_scoring scoring = word_scoring::l1;
  word_weighting weighting = word_weighting::tf_idf;

  /// @throws bad_argument naming the value and the limit
  void check() const {
    detail::require_range("branching of a vocabulary", branching, 0, max_branching);
    detail::require_range("levels of a vocabulary", levels, 1, max_vocabulary_levels);
    detail::require_range("scoring of a vocabulary", static_cast<int>(scoring), 0, 5);
    detail::require_range("weighting of a vocabulary", static_cast<int>(weighting), 0, 3);
  }
};

/// Children of a node: `count` consecutive ones.
struct alignas(8) node_children {
  int first;
  int count;
};

/// A tree whose nodes lie in breadth-first order, siblings in ascending order of their ids: the
/// children of a node lie side by side. Node 0 is the root. A node without children is a word; the
/// root alone has none.
struct vocabulary_view {
  vocabulary_header header;
  int nodes = 0;                      ///< 0: a vocabulary that was never made; it finds nothing
  int words = 0;                      ///< nodes without children but the root
  node_children* children = nullptr;  ///< [nodes]
  descriptor* orb = nullptr;          ///< [nodes]
  double* weight = nullptr;           ///< [nodes] of a word; one that is not positive stops it
  std::uint32_t* word = nullptr;      ///< [nodes] 0 to words - 1, or no_word
  std::uint32_t* node = nullptr;      ///< [nodes] id in the arrays or the file it was made from

  template <typename Visit>
  void columns(Visit&& each) {
    each({nodes}, children, orb, weight, word, node);
  }
};
static_assert(std::is_trivially_copyable<vocabulary_view>::value, "passed to kernels");

/// Places a vocabulary's arrays into an arena. @throws bad_argument below 1 node
inline void carve(carver& c, vocabulary_view& v, int nodes) {
  detail::require(nodes >= 1, "a vocabulary has 1 node or more");
  v.nodes = nodes;
  detail::place_columns(c, v);
}

/// Owner of a vocabulary; move-only. Arrays are not initialised; make_vocabulary(),
/// load_vocabulary() and upload() fill them.
template <memory_space Space>
class vocabulary : public owner<vocabulary_view, Space> {
public:
  vocabulary() = default;
  /// @throws bad_argument below 1 node, or for a header out of range; std::bad_alloc, cuda_error
  vocabulary(vocabulary_header const& header, int nodes, int words)
      : owner<vocabulary_view, Space>([&](carver& c, vocabulary_view& v) {
          header.check();
          carve(c, v, nodes);
          v.header = header;
          v.words = words;
        }) {}
};

/// A copy in an executor's memory. For set-up: allocates, and waits until it is copied.
/// @param from a vocabulary that was made, in any memory
/// @throws bad_argument, std::bad_alloc, cuda_error
template <typename Exec>
vocabulary<Exec::space> upload(Exec const& exec, vocabulary_view const& from) {
  vocabulary<Exec::space> to(from.header, from.nodes, from.words);
  detail::copy_columns(exec, to.view(), from);
  exec.wait();
  return to;
}

/// A vocabulary as arrays over the ids of its nodes, in host memory. Node 0 is the root.
struct vocabulary_arrays {
  vocabulary_header header;
  span<int const> parent;      ///< -1 of the root; parents may have higher ids than their children
  span<descriptor const> orb;  ///< the root's is not used
  span<double const> weight;   ///< finite; those of nodes with children are not used
  span<int const> word;  ///< of nodes without children a permutation of 0, 1, ...; -1 of the others
};

namespace detail {

[[noreturn]] inline void refuse_node(int node, std::string const& why) {
  throw bad_argument("ft: node " + std::to_string(node) + " of the vocabulary " + why);
}

/// Children of every node, ascending: those of node n are listed[first[n]] to
/// listed[first[n + 1] - 1].
struct children_lists {
  std::vector<int> first;
  std::vector<int> listed;

  /// @throws bad_argument for parents out of range, or for more children than a node may have
  children_lists(span<int const> parent, int branching) {
    auto const n = static_cast<std::size_t>(parent.size);
    first.assign(n + 1, 0);
    if (parent[0] != -1) {
      refuse_node(0, "has parent " + std::to_string(parent[0]) + ", the root's must be -1");
    }
    for (int i = 1; i < parent.size; ++i) {
      int const p = parent[i];
      if (p < 0 || p >= parent.size) {
        refuse_node(i, "has parent " + std::to_string(p) + ", must be in [0, " +
                           std::to_string(parent.size - 1) + "]");
      }
      if (++first[static_cast<std::size_t>(p) + 1] > branching) {
        refuse_node(p, "has more than " + std::to_string(branching) + " children");
      }
    }
    for (std::size_t i = 0; i < n; ++i) { first[i + 1] += first[i]; }
    std::vector<int> next(first.begin(), first.end() - 1);
    listed.resize(n - 1);
    for (int i = 1; i < parent.size; ++i) {
      listed[static_cast<std::size_t>(next[static_cast<std::size_t>(parent[i])]++)] = i;
    }
  }
  int begin(int node) const { return first[static_cast<std::size_t>(node)]; }
  int count(int node) const { return first[static_cast<std::size_t>(node) + 1] - begin(node); }
  int child(int at) const { return listed[static_cast<std::size_t>(at)]; }
};

/// The nodes by their depth, siblings in ascending order.
/// @throws bad_argument for nodes that are too deep, or not below the root
inline std::vector<int> breadth_first(children_lists const& lists, int nodes, int levels) {
  std::vector<int> order{0};
  order.reserve(static_cast<std::size_t>(nodes));
  std::size_t level_end = 1;
  int depth = 0;
  for (std::size_t at = 0; at < order.size(); ++at) {
    if (at == level_end) {
      level_end = order.size();
      ++depth;
    }
    int const node = order[at];
    int const begin = lists.begin(node);
    int const count = lists.count(node);
    if (count > 0 && depth == levels) {
      refuse_node(lists.child(begin), "lies " + std::to_string(depth + 1) +
                                          " below the root, the vocabulary has " +
                                          std::to_string(levels) + " levels");
    }
    for (int c = 0; c < count; ++c) { order.push_back(lists.child(begin + c)); }
  }
  if (order.size() < static_cast<std::size_t>(nodes)) {
    std::vector<bool> reached(static_cast<std::size_t>(nodes));
    for (int const node : order) { reached[static_cast<std::size_t>(node)] = true; }
    int lost = 0;
    while (reached[static_cast<std::size_t>(lost)]) { ++lost; }
    refuse_node(lost, "is not below the root: its parents form a cycle");
  }
  return order;
}

/// The number of words. @throws bad_argument unless each leaf has a word of its own, and no other
/// node has one
inline int check_words(children_lists const& lists, span<int const> word) {
  int words = 0;
  for (int i = 1; i < word.size; ++i) { words += static_cast<int>(lists.count(i) == 0); }
  std::vector<bool> taken(static_cast<std::size_t>(words));
  for (int i = 0; i < word.size; ++i) {
    bool const leaf = i > 0 && lists.count(i) == 0;
    std::string const has = "has word ";
    if (!leaf && word[i] != -1) {
      refuse_node(i, has + std::to_string(word[i]) + ", but is the root or has children");
    }
    if (!leaf) { continue; }
    if (word[i] < 0 || word[i] >= words) {
      refuse_node(i, has + std::to_string(word[i]) + ", must be in [0, " +
                         std::to_string(words - 1) + "], because it has no children");
    }
    auto const w = static_cast<std::size_t>(word[i]);
    if (taken[w]) { refuse_node(i, has + std::to_string(word[i]) + ", as another node has"); }
    taken[w] = true;
  }
  return words;
}

}  // namespace detail

/// Makes a vocabulary of arrays. For set-up: allocates.
/// @throws bad_argument for a header out of range, arrays of different lengths or without a node, a
///   parent out of range, a cycle, more children or levels than the header says, words that are not
///   a permutation, a weight that is not finite
inline vocabulary<memory_space::host> make_vocabulary(vocabulary_arrays const& from) {
  from.header.check();
  int const nodes = from.parent.size;
  detail::require(nodes >= 1, "a vocabulary has 1 node or more");
  detail::require(from.orb.size == nodes && from.weight.size == nodes && from.word.size == nodes,
                  "the arrays of a vocabulary have different lengths");
  for (int i = 0; i < nodes; ++i) {
    if (!std::isfinite(from.weight[i])) {
      detail::refuse_node(i,
                          "has weight " + detail::number_text(from.weight[i]) + ", must be finite");
    }
  }
  detail::children_lists const lists(from.parent, from.header.branching);
  std::vector<int> const order = detail::breadth_first(lists, nodes, from.header.levels);
  int const words = detail::check_words(lists, from.word);

  vocabulary<memory_space::host> made(from.header, nodes, words);
  vocabulary_view const& v = made.view();
  int next = 1;
  for (int at = 0; at < nodes; ++at) {
    int const node = order[static_cast<std::size_t>(at)];
    v.children[at] = {next, lists.count(node)};
    v.orb[at] = from.orb[node];
    v.weight[at] = from.weight[node];
    v.word[at] = static_cast<std::uint32_t>(from.word[node]);
    v.node[at] = static_cast<std::uint32_t>(node);
    next += v.children[at].count;
  }
  return made;
}

}  // namespace FT_ABI
}  // namespace ft
