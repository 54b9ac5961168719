// SPDX-License-Identifier: Apache-2.0
/// @file How many corners each level keeps, and the memory of the quadtree. Source: specification
/// sections 2 and 3.
#pragma once

#include <cmath>
#include <cstddef>

#include "ft/containers/columns.hpp"
#include "ft/containers/corners.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

/// The number of corners that each level should keep, and its share of the memory.
struct distribution_layout {
  int levels = 0;
  int wanted[max_levels] = {};    ///< features of a level
  int more[max_levels] = {};      ///< likewise, in images of which more are wanted
  int roots[max_levels] = {};     ///< root nodes, next to each other in x
  int width[max_levels] = {};     ///< of the work area, pixels
  int height[max_levels] = {};    ///< likewise
  int capacity[max_levels] = {};  ///< most nodes, and so most kept corners, of a level
  int first[max_levels] = {};     ///< slot of a level's first corner among those of an image
  int total = 0;                  ///< slots of an image

  /// Level of the corner in a slot of an image.
  FT_HOST_DEVICE int level_of(int slot) const {
    int l = 0;
    while (l + 1 < levels && slot >= first[l + 1]) { ++l; }
    return l;
  }
  /// Most nodes of a level, of which so many features are wanted.
  FT_HOST_DEVICE int most_nodes(int l, int features) const {
    // One unconditional round makes at most four nodes of a root. Later a split of one of n - 1
    // nodes leaves at most n + 2.
    return roots[l] == 0 ? 0 : max_of(features + 3, 4 * roots[l]);
  }
  /// @param features wanted on all levels together, 1 to 2^20
  /// @param more_features likewise, in images of which more are wanted; 0 = there are none
  /// @throws bad_argument for another number of features
  static distribution_layout make(pyramid_geometry const& g, int features, int more_features = 0) {
    detail::require_range("features", features, 1, 1 << 20);
    more_features = more_features == 0 ? features : more_features;
    detail::require_range("features of images with more", more_features, features, 1 << 20);
    distribution_layout d;
    d.levels = g.levels;
    share_features(g, features, d.wanted);
    share_features(g, more_features, d.more);
    for (int l = 0; l < g.levels; ++l) {
      d.width[l] = max_of(g.width[l] - 2 * corner_border, 0);
      d.height[l] = max_of(g.height[l] - 2 * corner_border, 0);
      bool const empty = d.width[l] < corner_cell_size || d.height[l] < corner_cell_size;
      d.roots[l] = empty ? 0
                         : max_of(1, static_cast<int>(std::round(static_cast<float>(d.width[l]) /
                                                                 static_cast<float>(d.height[l]))));
      d.capacity[l] = d.most_nodes(l, max_of(d.wanted[l], d.more[l]));
      d.first[l] = d.total;
      d.total += d.capacity[l];
    }
    return d;
  }

private:
  static void share_features(pyramid_geometry const& g, int features, int (&wanted)[max_levels]) {
    float const factor = 1.0f / g.scale_factor;
    float n = static_cast<float>(features) * (1.0f - factor) /
              (1.0f - static_cast<float>(
                          std::pow(static_cast<double>(factor), static_cast<double>(g.levels))));
    int sum = 0;
    for (int l = 0; l < g.levels; ++l) {
      bool const last = l + 1 == g.levels;
      wanted[l] = last ? max_of(features - sum, 0) : static_cast<int>(std::lrint(n));
      sum += wanted[l];
      n *= factor;
    }
  }
};

/// A node of the quadtree: the points [begin, end) in the order of their codes.
template <typename Index>
struct node_range {
  Index begin, end;
};

/// The kept corners of a batch of images, and the workspace of the quadtree.
struct distribution_view {
  distribution_layout layout;
  std::ptrdiff_t total_slots = 0;  ///< corner_layout::total_slots
  int batch = 0;
  corner* kept = nullptr;     ///< [batch][total], per level in list order
  int* kept_count = nullptr;  ///< [batch][levels]
  int* wants_more = nullptr;  ///< [batch] 1 = layout.more, not layout.wanted; or null
  // Workspace of the levels that do not fit into shared memory.
  static constexpr int key_pad = 32;        ///< keys of a level beyond its points: whole words
  unsigned long long* keys = nullptr;       ///< [batch][total_slots + levels * key_pad]
  unsigned* order = nullptr;                ///< [batch][total_slots]
  node_range<int>* list[2] = {};            ///< [batch][total]
  unsigned long long* node_keys = nullptr;  ///< [batch][total]
  int* splits_before = nullptr;             ///< [batch][total]
  int* gain_before = nullptr;               ///< [batch][total]

  /// All but `wants_more`.
  template <typename Visit>
  void columns(Visit&& each) {
    each({batch, max_of(layout.total, 1)}, kept);  // ordering always reads the first
    each({batch, layout.levels}, kept_count);
    each({batch, total_slots + layout.levels * key_pad}, keys);
    each({batch, total_slots}, order);
    each({batch, layout.total}, list[0], list[1], node_keys, splits_before, gain_before);
  }
  /// Features that are wanted of a level of an image.
  FT_HOST_DEVICE int wanted(int image, int l) const {
    bool const more = wants_more != nullptr && wants_more[image] != 0;
    return more ? layout.more[l] : layout.wanted[l];
  }
};

/// Places the arrays into an arena, but for `wants_more`.
inline void carve(carver& c, distribution_view& v, distribution_layout const& layout,
                  corner_layout const& corners, int batch) {
  v.layout = layout;
  v.total_slots = corners.total_slots;
  v.batch = batch;
  detail::place_columns(c, v);
}

}  // namespace FT_ABI
}  // namespace ft
