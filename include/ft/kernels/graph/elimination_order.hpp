// SPDX-License-Identifier: Apache-2.0
/// @file The order in which the poses of a graph are eliminated, and what it makes of the matrix.
/// On the host, with integers alone.
#pragma once

#include <algorithm>
#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include "ft/containers/pose_graph.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/kernels/graph/system.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Eliminates vertices of a graph in rounds. Those of a round are not neighbours, so they can be
/// eliminated at once: each second pose of a chain, then each second of those that are left, and so
/// on. Source: Liu, "Modification of the minimum-degree algorithm by multiple elimination", 1985;
/// the graph is kept as cliques ("elements"), see George and Liu, "The evolution of the minimum
/// degree ordering algorithm", 1989.
class elimination_rounds {
public:
  /// Most vertices that stay for the dense part.
  static constexpr std::size_t most_dense = 1536;
  static constexpr int least_of_round = 8;       ///< vertices, where so many can be found
  static constexpr std::size_t few = 32;         ///< vertices that are dense in any case
  static constexpr std::size_t dense_share = 2;  ///< 1 / share of the neighbours that there can be

  std::vector<int> order;                ///< eliminated vertices, then those that are left
  std::vector<int> round_begin;          ///< [rounds + 1] into order
  std::vector<std::vector<int>> clique;  ///< neighbours of a vertex when it was eliminated

  /// @param neighbours of each vertex, ascending, without itself
  explicit elimination_rounds(std::vector<std::vector<int>> neighbours)
      : clique(neighbours.size()),
        vertices_(std::move(neighbours)),
        elements_(vertices_.size()),
        degree_(vertices_.size()),
        seen_(vertices_.size(), 0),
        touched_(vertices_.size(), 0),
        state_(vertices_.size(), alive) {
    int const n = static_cast<int>(vertices_.size());
    std::vector<int> left(vertices_.size());
    for (int v = 0; v < n; ++v) {
      left[index(v)] = v;
      degree_[index(v)] = static_cast<int>(vertices_[index(v)].size());
    }
    round_begin.push_back(0);
    while (!is_dense(left)) {
      run_round(left);
      round_begin.push_back(static_cast<int>(order.size()));
      left.erase(std::remove_if(left.begin(), left.end(),
                                [&](int v) { return state_[index(v)] != alive; }),
                 left.end());
    }
    order.insert(order.end(), left.begin(), left.end());
  }
  int eliminated() const { return round_begin.back(); }

private:
  enum : char { alive, element, absorbed };

  static std::size_t index(int v) { return static_cast<std::size_t>(v); }

  /// Whether what is left should be solved as a dense matrix: where at least a share of it would be
  /// filled anyway.
  bool is_dense(std::vector<int> const& left) const {
    std::size_t const n = left.size();
    if (n <= few) { return true; }
    if (n > most_dense) { return false; }
    std::size_t neighbours = 0;
    for (int const v : left) { neighbours += index(degree_[index(v)]); }
    return neighbours * dense_share >= n * n;
  }

  /// Eliminates vertices with few neighbours, and more than that if they would be too few for a
  /// round.
  void run_round(std::vector<int> const& left) {
    int least = degree_[index(left.front())];
    for (int const v : left) { least = std::min(least, degree_[index(v)]); }
    candidates_.clear();
    for (int const v : left) {
      if (degree_[index(v)] <= 2 * least + 2) { candidates_.push_back({degree_[index(v)], v}); }
    }
    std::sort(candidates_.begin(), candidates_.end());
    ++round_;
    neighbourhood_.clear();
    int eliminated = 0;
    for (auto const& c : candidates_) {
      if (c.first > least + least / 4 + 1 && eliminated >= least_of_round) { break; }
      if (touched_[index(c.second)] == round_) { continue; }
      eliminate(c.second);
      ++eliminated;
    }
    for (int const u : neighbourhood_) { degree_[index(u)] = degree_of(u); }
  }

  void eliminate(int v) {
    std::vector<int>& reached = clique[index(v)];
    ++stamp_;
    seen_[index(v)] = stamp_;
    auto const add = [&](std::vector<int> const& from) {
      for (int const u : from) {
        if (state_[index(u)] == alive && seen_[index(u)] != stamp_) {
          seen_[index(u)] = stamp_;
          reached.push_back(u);
        }
      }
    };
    add(vertices_[index(v)]);
    for (int const e : elements_[index(v)]) {
      if (state_[index(e)] != element) { continue; }
      add(clique[index(e)]);
      state_[index(e)] = absorbed;
    }
    state_[index(v)] = element;
    order.push_back(v);
    for (int const u : reached) {
      if (touched_[index(u)] != round_) {
        touched_[index(u)] = round_;
        neighbourhood_.push_back(u);
      }
      auto& elements = elements_[index(u)];
      elements.erase(std::remove_if(elements.begin(), elements.end(),
                                    [&](int e) { return state_[index(e)] != element; }),
                     elements.end());
      elements.push_back(v);
      // What the clique says need not be said again.
      auto& others = vertices_[index(u)];
      others.erase(std::remove_if(others.begin(), others.end(),
                                  [&](int w) {
                                    return state_[index(w)] != alive || seen_[index(w)] == stamp_;
                                  }),
                   others.end());
    }
    std::vector<int>().swap(vertices_[index(v)]);
    std::vector<int>().swap(elements_[index(v)]);
  }

  int degree_of(int v) {
    ++stamp_;
    seen_[index(v)] = stamp_;
    int count = 0;
    auto const add = [&](std::vector<int> const& from) {
      for (int const u : from) {
        if (state_[index(u)] == alive && seen_[index(u)] != stamp_) {
          seen_[index(u)] = stamp_;
          ++count;
        }
      }
    };
    add(vertices_[index(v)]);
    for (int const e : elements_[index(v)]) { add(clique[index(e)]); }
    return count;
  }

  std::vector<std::vector<int>> vertices_;  ///< neighbours that are in no common element
  std::vector<std::vector<int>> elements_;  ///< eliminated vertices whose clique it is in
  std::vector<int> degree_;
  std::vector<int> seen_;
  std::vector<int> touched_;  ///< the round in which a neighbour was eliminated
  std::vector<char> state_;
  std::vector<std::pair<int, int>> candidates_;
  std::vector<int> neighbourhood_;
  int stamp_ = 0;
  int round_ = 0;
};

/// The plan of a graph's system, in host memory.
class elimination_order {
public:
  std::vector<int> position;     ///< of a pose; -1: fixed
  std::vector<int> pose;         ///< at a position
  std::vector<int> round_begin;  ///< [rounds + 1] sparse columns
  std::vector<int> column_begin, block_row, block_column, row_begin, row_column, row_block;
  std::vector<int> term_begin, term;
  int dense = 0;

  /// @param graph valid @throws bad_argument for a system with too many blocks
  template <typename Motion>
  explicit elimination_order(motion_graph<Motion> const& graph) {
    std::vector<int> vertex = free_vertices(graph);
    elimination_rounds rounds(neighbours_of(graph, vertex));
    round_begin = rounds.round_begin;
    int const n = static_cast<int>(rounds.order.size());
    int const columns = rounds.eliminated();
    dense = n - columns;
    std::vector<int> at(rounds.order.size());  // position of a vertex
    for (int p = 0; p < n; ++p) { at[index(rounds.order[index(p)])] = p; }
    position.assign(vertex.size(), -1);
    pose.resize(at.size());
    for (std::size_t i = 0; i < vertex.size(); ++i) {
      if (vertex[i] < 0) { continue; }
      position[i] = at[index(vertex[i])];
      pose[index(position[i])] = static_cast<int>(i);
    }
    make_blocks(rounds, at);
    make_terms(graph);
  }

  int columns() const { return static_cast<int>(column_begin.size()) - 1; }
  int positions() const { return static_cast<int>(pose.size()); }
  int rounds() const { return static_cast<int>(round_begin.size()) - 1; }
  int blocks() const { return static_cast<int>(block_row.size()); }
  int sparse_blocks() const { return column_begin.back(); }

private:
  static std::size_t index(int v) { return static_cast<std::size_t>(v); }

  /// Numbers the free poses; the lowest of each part of the graph without a fixed one is fixed.
  template <typename Motion>
  static std::vector<int> free_vertices(motion_graph<Motion> const& graph) {
    std::size_t const poses = graph.T_world_pose.size();
    std::vector<int> root(poses);
    for (std::size_t i = 0; i < poses; ++i) { root[i] = static_cast<int>(i); }
    auto const find = [&](int v) {
      while (root[index(v)] != v) { v = root[index(v)] = root[index(root[index(v)])]; }
      return v;
    };
    for (auto const& e : graph.edges) {
      int const a = find(e.from);
      int const b = find(e.to);
      root[index(std::max(a, b))] = std::min(a, b);
    }
    auto const is_fixed = [&](std::size_t i) {
      return !graph.fixed.empty() && graph.fixed[i] != 0;
    };
    std::vector<char> held(poses, 0);
    for (std::size_t i = 0; i < poses; ++i) {
      if (is_fixed(i)) { held[index(find(static_cast<int>(i)))] = 1; }
    }
    std::vector<int> vertex(poses, -1);
    int next = 0;
    for (std::size_t i = 0; i < poses; ++i) {
      bool const anchor = find(static_cast<int>(i)) == static_cast<int>(i) && held[i] == 0;
      if (!is_fixed(i) && !anchor) { vertex[i] = next++; }
    }
    return vertex;
  }

  template <typename Motion>
  static std::vector<std::vector<int>> neighbours_of(motion_graph<Motion> const& graph,
                                                     std::vector<int> const& vertex) {
    int const n = vertex.empty() ? 0 : *std::max_element(vertex.begin(), vertex.end()) + 1;
    std::vector<std::vector<int>> neighbours(index(n));
    for (auto const& e : graph.edges) {
      int const a = vertex[index(e.from)];
      int const b = vertex[index(e.to)];
      if (a < 0 || b < 0) { continue; }
      neighbours[index(a)].push_back(b);
      neighbours[index(b)].push_back(a);
    }
    for (auto& list : neighbours) {
      std::sort(list.begin(), list.end());
      list.erase(std::unique(list.begin(), list.end()), list.end());
    }
    return neighbours;
  }

  void make_blocks(elimination_rounds const& rounds, std::vector<int> const& at) {
    int const columns = rounds.eliminated();
    std::size_t count = index(dense) * index(dense + 1) / 2 + index(columns);
    for (int c = 0; c < columns; ++c) {
      count += rounds.clique[index(rounds.order[index(c)])].size();
    }
    require_items("blocks of a pose graph's system", count, 1);
    block_row.reserve(count);
    block_column.reserve(count);
    column_begin.reserve(index(columns) + 1);
    std::vector<int> in_row(pose.size() + 1, 0);
    std::vector<int> rows;
    for (int c = 0; c < columns; ++c) {
      column_begin.push_back(static_cast<int>(block_row.size()));
      block_row.push_back(c);
      block_column.push_back(c);
      rows.clear();
      for (int const v : rounds.clique[index(rounds.order[index(c)])]) {
        rows.push_back(at[index(v)]);
      }
      std::sort(rows.begin(), rows.end());
      for (int const r : rows) {
        block_row.push_back(r);
        block_column.push_back(c);
        ++in_row[index(r) + 1];
      }
    }
    column_begin.push_back(static_cast<int>(block_row.size()));
    for (int a = 0; a < dense; ++a) {
      for (int b = 0; b <= a; ++b) {
        block_row.push_back(columns + a);
        block_column.push_back(columns + b);
      }
    }
    for (std::size_t r = 1; r < in_row.size(); ++r) { in_row[r] += in_row[r - 1]; }
    row_begin = in_row;
    row_column.resize(index(in_row.back()));
    row_block.resize(index(in_row.back()));
    for (int b = 0; b < column_begin.back(); ++b) {
      int const r = block_row[index(b)];
      if (r == block_column[index(b)]) { continue; }
      int const to = in_row[index(r)]++;
      row_column[index(to)] = block_column[index(b)];
      row_block[index(to)] = b;
    }
  }

  /// Block of a row and a column at or left of the diagonal.
  int block_at(int row, int column) const {
    int const sparse = columns();
    if (column >= sparse) {
      int const a = row - sparse;
      return column_begin.back() + a * (a + 1) / 2 + (column - sparse);
    }
    auto const begin = block_row.begin() + column_begin[index(column)];
    auto const end = block_row.begin() + column_begin[index(column) + 1];
    return static_cast<int>(std::lower_bound(begin, end, row) - block_row.begin());
  }

  /// Sorts the terms of edges by block, those of a block by edge (a counting sort).
  template <typename Motion>
  void make_terms(motion_graph<Motion> const& graph) {
    struct entry {
      int block, term;
    };
    std::vector<entry> entries;
    entries.reserve(3 * graph.edges.size());
    for (std::size_t e = 0; e < graph.edges.size(); ++e) {
      int const i = position[index(graph.edges[e].from)];
      int const j = position[index(graph.edges[e].to)];
      int const code = 4 * static_cast<int>(e);
      if (i >= 0) { entries.push_back({block_at(i, i), code + first_pose}); }
      if (j >= 0) { entries.push_back({block_at(j, j), code + second_pose}); }
      if (i >= 0 && j >= 0) {
        entries.push_back({block_at(std::max(i, j), std::min(i, j)),
                           code + (i > j ? between : between_transposed)});
      }
    }
    std::vector<int> next(block_row.size() + 1, 0);
    for (auto const& e : entries) { ++next[index(e.block) + 1]; }
    for (std::size_t b = 1; b < next.size(); ++b) { next[b] += next[b - 1]; }
    term_begin = next;
    term.resize(entries.size());
    for (auto const& e : entries) { term[index(next[index(e.block)]++)] = e.term; }
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
