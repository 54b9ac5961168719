// SPDX-License-Identifier: Apache-2.0
/// @file The inputs and outputs of a search in one frame, shared by its steps.
#pragma once

#include <cstddef>

#include "ft/containers/frame.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/search/workspace.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

struct frame_search {
  int b;  ///< batch entry
  frame_view const& frame;
  map_points_view const& map;  ///< of all rigs
  search_params const& params;
  search_buffers const& buffers;
  /// Whether this step compares columns in the right image. Only one step of a search does: for the
  /// local map the listing, from the last frame the assignment, so that its listing needs no stereo
  /// matches.
  bool compares_columns;
  int searches = 1;  ///< of a rig, whose batch entries share a map

  /// The map's points.
  FT_HOST_DEVICE map_points_view points() const { return map.slice(b / searches); }
  /// Holders of this frame.
  FT_HOST_DEVICE int* holder() const {
    return frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers();
  }
  /// Columns in the right image of this frame's left keypoints; null if they are not compared.
  FT_HOST_DEVICE float const* right_x() const {
    return compares_columns && frame.right_x != nullptr
               ? frame.right_x + static_cast<std::ptrdiff_t>(b) * frame.capacity()
               : nullptr;
  }
  /// Whether the stereo partner of a matched keypoint is matched, too.
  FT_HOST_DEVICE bool partners() const {
    return frame.partner != nullptr && params.kind == search_kind::local_map;
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
