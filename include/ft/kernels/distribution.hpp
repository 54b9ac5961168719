// SPDX-License-Identifier: Apache-2.0
/// @file Stage: even distribution of corners over a level by a quadtree. Source: specification
/// section 3.
///
/// The rule is sequential (a list of nodes, children pushed to its front); here a whole round is
/// done at once. In a round every node with more than one point is split, so with C children in
/// creation order the new list is: child C-1, ..., child 0, then the nodes that were not split, in
/// their old order. When nodes are split one by one until enough are there, a prefix sum over the
/// splitting order tells how many splits are made. Points never move: each remembers its node.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/corners.hpp"

namespace ft {
inline namespace FT_ABI {

/// How many corners each level should keep and how much memory that takes.
struct distribution_layout {
  int levels = 0;
  int wanted[max_levels] = {};  ///< features of a level
  int roots[max_levels] = {};
  int width[max_levels] = {};  ///< of the work area
  int height[max_levels] = {};
  int capacity[max_levels] = {};  ///< nodes, and kept corners, of a level
  int first[max_levels] = {};     ///< of a level among an image's
  int total = 0;                  ///< of an image

  /// @param features wanted in all levels together, 1 to 2^20. Source: specification section 2.
  static distribution_layout make(pyramid_geometry const& g, int features) {
    detail::require_range("features", features, 1, 1 << 20);
    distribution_layout d;
    d.levels = g.levels;
    float const factor = 1.0f / g.scale_factor;
    float n = static_cast<float>(features) * (1.0f - factor) /
              (1.0f - static_cast<float>(
                          std::pow(static_cast<double>(factor), static_cast<double>(g.levels))));
    int sum = 0;
    for (int l = 0; l < g.levels; ++l) {
      bool const last = l + 1 == g.levels;
      d.wanted[l] = last ? max_of(features - sum, 0) : static_cast<int>(std::lrint(n));
      sum += d.wanted[l];
      n *= factor;
      d.width[l] = max_of(g.width[l] - 2 * corner_border, 0);
      d.height[l] = max_of(g.height[l] - 2 * corner_border, 0);
      bool const empty = d.width[l] < corner_cell_size || d.height[l] < corner_cell_size;
      d.roots[l] = empty ? 0
                         : max_of(1, static_cast<int>(std::round(static_cast<float>(d.width[l]) /
                                                                 static_cast<float>(d.height[l]))));
      // One unconditional round makes at most four nodes of a root; from n-1 nodes a split makes
      // n+2.
      d.capacity[l] = empty ? 0 : max_of(d.wanted[l] + 3, 4 * d.roots[l]);
      d.first[l] = d.total;
      d.total += d.capacity[l];
    }
    return d;
  }
};

/// A quadtree node: [x0, x1) x [y0, y1) and how many points it holds.
struct quad_node {
  std::int32_t x0, y0, x1, y1;
  std::int32_t count;
};

/// Kept corners and the workspace of the quadtree, for a batch of images.
struct distribution_view {
  distribution_layout layout;
  int batch = 0;
  corner* kept = nullptr;     ///< [batch][total], per level in list order
  int* kept_count = nullptr;  ///< [batch][levels]
  quad_node* nodes[2] = {};   ///< [batch][total]
  int* quadrant = nullptr;  ///< [batch][total][4], points per quadrant, then the place of the child
  int* place = nullptr;     ///< [batch][total], scan of children; then the place of an unsplit node
  int* order = nullptr;     ///< [batch][total], nodes in splitting order
  unsigned long long* keys = nullptr;  ///< [batch][total], sort keys, then the best point of a node
  int* node_of = nullptr;              ///< [batch][total_slots], list position of each point's node
};

inline void carve(carver& c, distribution_view& v, distribution_layout const& layout,
                  corner_layout const& corners, int batch) {
  auto const b = static_cast<std::size_t>(batch);
  std::size_t const total = detail::checked_mul(b, static_cast<std::size_t>(layout.total));
  v.layout = layout;
  v.batch = batch;
  v.kept = c.take<corner>(total);
  v.kept_count = c.take<int>(b * static_cast<std::size_t>(layout.levels));
  v.nodes[0] = c.take<quad_node>(total);
  v.nodes[1] = c.take<quad_node>(total);
  v.quadrant = c.take<int>(4 * total);
  v.place = c.take<int>(total);
  v.order = c.take<int>(total);
  v.keys = c.take<unsigned long long>(total);
  v.node_of = c.take<int>(b * static_cast<std::size_t>(corners.total_slots));
}

/// The quadtree of one level of one image.
struct distribute_level {
  /// Levels of up to so many nodes keep them in block scratch, others in the workspace.
  static constexpr int scratch_nodes = 512;
  struct scratch {
    quad_node nodes[2][scratch_nodes];
    int quadrant[4 * scratch_nodes];
    int place[scratch_nodes];
    int order[scratch_nodes];
    unsigned long long keys[scratch_nodes];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, corners_view const& corners,
                                 distribution_view const& v) const {
    distribution_layout const& layout = v.layout;
    int const image = item / layout.levels;
    int const l = item % layout.levels;
    int const points = corners.list_count[item];
    if (points == 0 || layout.capacity[l] == 0) {
      if (g.rank() == 0) { v.kept_count[item] = 0; }
      return;
    }
    int const at = image * layout.total + layout.first[l];
    tree t;
    t.points = corners.level_list(image, l);
    t.point_count = points;
    t.node_of = v.node_of + image * corners.layout.total_slots + corners.layout.first_slot[l];
    bool const in_scratch = layout.capacity[l] <= scratch_nodes;
    t.nodes = in_scratch ? s.nodes[0] : v.nodes[0] + at;
    t.next = in_scratch ? s.nodes[1] : v.nodes[1] + at;
    t.quadrant = in_scratch ? s.quadrant : v.quadrant + 4 * static_cast<std::ptrdiff_t>(at);
    t.place = in_scratch ? s.place : v.place + at;
    t.order = in_scratch ? s.order : v.order + at;
    t.keys = in_scratch ? s.keys : v.keys + at;

    int size = make_roots(g, t, layout.roots[l], layout.width[l], layout.height[l]);
    int const wanted = layout.wanted[l];
    int children = 0;
    bool one_by_one = false;
    for (;;) {
      int const before = size;
      int const splits =
          one_by_one ? choose_splits(g, t, children, size, wanted) : choose_all(g, t, size);
      int multiple = 0;
      size = split(g, t, size, splits, children, multiple);
      if (size >= wanted || size <= before) { break; }
      one_by_one = one_by_one || size + 3 * multiple > wanted;
    }

    // Each node yields its strongest point, the first of equals.
    for (int i = g.rank(); i < size; i += g.size()) { t.keys[i] = 0; }
    g.sync();
    for (int i = g.rank(); i < points; i += g.size()) {
      unsigned long long const key =
          static_cast<unsigned long long>(static_cast<unsigned>(t.points[i].response)) << 32 |
          (0xffffffffu - static_cast<unsigned>(i));
      atomic_max(t.keys + t.node_of[i], key);
    }
    g.sync();
    for (int i = g.rank(); i < size; i += g.size()) {
      unsigned const index = 0xffffffffu - static_cast<unsigned>(t.keys[i] & 0xffffffffu);
      v.kept[at + i] = t.points[index];
    }
    if (g.rank() == 0) { v.kept_count[item] = size; }
  }

private:
  struct tree {
    corner const* points;
    int point_count;
    int* node_of;
    quad_node* nodes;  ///< the list, front first
    quad_node* next;
    int* quadrant;
    int* place;
    int* order;
    unsigned long long* keys;
  };

  FT_HOST_DEVICE static int split_x(quad_node const& n) { return n.x0 + (n.x1 - n.x0 + 1) / 2; }
  FT_HOST_DEVICE static int split_y(quad_node const& n) { return n.y0 + (n.y1 - n.y0 + 1) / 2; }
  FT_HOST_DEVICE static int quadrant_of(quad_node const& n, corner const& p) {
    return static_cast<int>(p.x >= split_x(n)) + 2 * static_cast<int>(p.y >= split_y(n));
  }
  FT_HOST_DEVICE static int children_of(int const* quadrant) {
    return static_cast<int>(quadrant[0] > 0) + static_cast<int>(quadrant[1] > 0) +
           static_cast<int>(quadrant[2] > 0) + static_cast<int>(quadrant[3] > 0);
  }

  /// The non-empty root nodes side by side; returns their number.
  template <typename Group>
  FT_HOST_DEVICE static int make_roots(Group g, tree& t, int roots, int width, int height) {
    float const root_width = detail::div(static_cast<float>(width), static_cast<float>(roots));
    for (int i = g.rank(); i < roots; i += g.size()) {
      t.next[i] = {static_cast<int>(detail::mul(root_width, static_cast<float>(i))), 0,
                   static_cast<int>(detail::mul(root_width, static_cast<float>(i + 1))), height, 0};
    }
    g.sync();
    for (int i = g.rank(); i < t.point_count; i += g.size()) {
      int const r = min_of(
          static_cast<int>(detail::div(static_cast<float>(t.points[i].x), root_width)), roots - 1);
      t.node_of[i] = r;
      atomic_add(&t.next[r].count, 1);
    }
    g.sync();
    for (int i = g.rank(); i < roots; i += g.size()) {
      t.place[i] = static_cast<int>(t.next[i].count > 0);
    }
    g.sync();
    int const size = g.exclusive_scan_array(t.place, roots);
    for (int i = g.rank(); i < roots; i += g.size()) {
      if (t.next[i].count > 0) { t.nodes[t.place[i]] = t.next[i]; }
    }
    for (int i = g.rank(); i < t.point_count; i += g.size()) {
      t.node_of[i] = t.place[t.node_of[i]];
    }
    g.sync();
    return size;
  }

  /// Points per quadrant of every node that could be split.
  template <typename Group>
  FT_HOST_DEVICE static void count_quadrants(Group g, tree& t, int size) {
    for (int i = g.rank(); i < 4 * size; i += g.size()) { t.quadrant[i] = 0; }
    g.sync();
    for (int i = g.rank(); i < t.point_count; i += g.size()) {
      int const n = t.node_of[i];
      quad_node const& node = t.nodes[n];
      if (node.count > 1) { atomic_add(t.quadrant + 4 * n + quadrant_of(node, t.points[i]), 1); }
    }
    g.sync();
  }

  /// A whole round: every node with more than one point, in list order. Returns how many.
  template <typename Group>
  FT_HOST_DEVICE static int choose_all(Group g, tree& t, int size) {
    count_quadrants(g, t, size);
    int splits = 0;
    for (int base = 0; base < size; base += g.size()) {
      int const i = base + g.rank();
      bool const chosen = i < size && t.nodes[i].count > 1;
      int total = 0;
      int const at = g.exclusive_scan(static_cast<int>(chosen), total);
      if (chosen) { t.order[splits + at] = i; }
      splits += total;
    }
    g.sync();
    return splits;
  }

  /// Node by node: of the nodes made last (the first `children` of the list) those with more than
  /// one point, the fullest first, among equals the one furthest right, among these the one made
  /// last; as many as it takes to reach `wanted` nodes. Returns how many.
  template <typename Group>
  FT_HOST_DEVICE static int choose_splits(Group g, tree& t, int children, int size, int wanted) {
    count_quadrants(g, t, size);
    int candidates = 0;
    for (int base = 0; base < children; base += g.size()) {
      int const i = base + g.rank();
      bool const chosen = i < children && t.nodes[i].count > 1;
      int total = 0;
      int const at = g.exclusive_scan(static_cast<int>(chosen), total);
      if (chosen) {  // 26 bits of count, 14 of column, 24 of place: a node made later is nearer to
                     // the front
        t.keys[candidates + at] =
            static_cast<unsigned long long>(0x3ffffffu - static_cast<unsigned>(t.nodes[i].count))
                << 38 |
            static_cast<unsigned long long>(0x3fffu - static_cast<unsigned>(t.nodes[i].x0)) << 24 |
            static_cast<unsigned long long>(i);
      }
      candidates += total;
    }
    g.sync();
    g.sort(t.keys, candidates);
    g.sync();
    int nodes = size;
    int splits = 0;
    for (int base = 0; base < candidates && nodes < wanted; base += g.size()) {
      int const m = base + g.rank();
      int const n = m < candidates ? static_cast<int>(t.keys[m] & 0xffffffu) : 0;
      int const gain = m < candidates ? children_of(t.quadrant + 4 * n) - 1 : 0;
      int total = 0;
      int const before = g.exclusive_scan(gain, total);
      bool const made = m < candidates && nodes + before < wanted;
      if (made) { t.order[m] = n; }
      int const made_here = g.reduce(static_cast<int>(made), sum_op{});
      splits += made_here;
      nodes += total;
    }
    g.sync();
    return splits;
  }

  /// Splits the nodes t.order[0, splits) in that order. Returns the size of the new list;
  /// `children` gets the number of nodes made, `multiple` that of those with more than one point.
  template <typename Group>
  FT_HOST_DEVICE static int split(Group g, tree& t, int size, int splits, int& children,
                                  int& multiple) {
    for (int i = g.rank(); i < size; i += g.size()) { t.place[i] = 0; }
    g.sync();
    // Places of the children, in creation order.
    int made = 0;
    int made_multiple = 0;
    for (int base = 0; base < splits; base += g.size()) {
      int const m = base + g.rank();
      int const n = m < splits ? t.order[m] : 0;
      int const mine = m < splits ? children_of(t.quadrant + 4 * n) : 0;
      int total = 0;
      int created = made + g.exclusive_scan(mine, total);
      if (m < splits) {
        t.place[n] = -1;
        for (int q = 0; q < 4; ++q) {
          int& points = t.quadrant[4 * n + q];
          made_multiple += static_cast<int>(points > 1);
          if (points > 0) {
            quad_node const parent = t.nodes[n];
            int const sx = split_x(parent);
            int const sy = split_y(parent);
            bool const right = (q & 1) != 0;
            bool const bottom = (q & 2) != 0;
            // Written to the end of the new list first; turned around below, where their number is
            // known.
            t.next[created] = {right ? sx : parent.x0, bottom ? sy : parent.y0,
                               right ? parent.x1 : sx, bottom ? parent.y1 : sy, points};
            points = created++;
          }
        }
      }
      made += total;
    }
    multiple = g.reduce(made_multiple, sum_op{});
    children = made;
    g.sync();
    // Children in reverse order of creation.
    for (int i = g.rank(); i < made / 2; i += g.size()) {
      quad_node const a = t.next[i];
      t.next[i] = t.next[made - 1 - i];
      t.next[made - 1 - i] = a;
    }
    // Then the nodes that were not split, in their old order.
    int kept = 0;
    for (int base = 0; base < size; base += g.size()) {
      int const i = base + g.rank();
      bool const stays = i < size && t.place[i] == 0;
      int total = 0;
      int const at = g.exclusive_scan(static_cast<int>(stays), total);
      if (stays) {
        t.place[i] = made + kept + at;
        t.next[made + kept + at] = t.nodes[i];
      }
      kept += total;
    }
    g.sync();
    for (int i = g.rank(); i < t.point_count; i += g.size()) {
      int const n = t.node_of[i];
      t.node_of[i] = t.place[n] >= 0
                         ? t.place[n]
                         : made - 1 - t.quadrant[4 * n + quadrant_of(t.nodes[n], t.points[i])];
    }
    g.sync();
    quad_node* const swap = t.nodes;
    t.nodes = t.next;
    t.next = swap;
    return made + kept;
  }
};

/// Thins the corners of every level of every image to about the wanted number. Asynchronous on
/// `exec`; allocates nothing; one launch.
template <typename Exec>
void distribute_corners(Exec const& exec, corners_view const& corners,
                        distribution_view const& out) {
  for_each_item<per_block<512>>(exec, out.batch * out.layout.levels, distribute_level{}, corners,
                                out);
}

}  // namespace FT_ABI
}  // namespace ft
