// SPDX-License-Identifier: Apache-2.0
/// @file Stage: chooses the local map, the map points that a frame probably sees.
#pragma once

#include <cstddef>

#include "ft/containers/frame.hpp"
#include "ft/containers/odometry_map.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

struct local_map_params {
  int keyframes = 30;   ///< with most votes, 1 to 64
  int neighbours = 10;  ///< of these the best ones whose neighbours are added, 0 to 32
};

/// Which keyframes a local map is made of.
enum class local_map_mode : int {
  by_votes = 0,  ///< those that share points with the frame
  newest = 1,    ///< the newest ones: the camera is being recovered
};

/// Inputs of choose_local_map, apart from the map.
struct local_map_input {
  frame_view frame;                      ///< its counts and holders are read
  local_map_mode const* mode = nullptr;  ///< [batch]
  local_map_params params;
};

/// A local map of each batch entry, the output of choose_local_map.
struct local_map_view {
  int capacity = 0;         ///< points of a local map
  int* slots = nullptr;     ///< [batch][capacity] ascending
  int* count = nullptr;     ///< [batch]
  int* left_out = nullptr;  ///< [batch] points for which there was no room
};

struct local_map_workspace {
  unsigned* chosen = nullptr;  ///< [batch][2][rows] a bit for each slot
  int rows = 0;                ///< words of 32 slots
};

/// Places the arrays into an arena.
inline void carve(carver& c, local_map_workspace& v, int slots, int batch) {
  v.rows = (slots + 31) / 32;
  v.chosen = c.take<unsigned>(
      2 * detail::checked_mul(static_cast<std::size_t>(batch), static_cast<std::size_t>(v.rows)));
}

/// Chooses the points that the search in the local map looks for.
///
/// Each keypoint that holds a point votes for the keyframes that see the point. Keyframes are
/// taken in this order: the newest one; those with votes, most votes first, newer ones first among
/// equals, at most `params.keyframes`; the neighbours of the first `params.neighbours` of these. In
/// the mode `newest`: the newest `params.keyframes`. Each point that one of them sees is chosen
/// once. If there are more than `out.capacity`, points of earlier keyframes are preferred, then
/// lower slots, and the others are counted in `out.left_out`.
///
/// Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec>
void choose_local_map(Exec const& exec, local_map_input const& in, odometry_map_view const& map,
                      local_map_view const& out, local_map_workspace const& work);

}  // namespace FT_ABI
}  // namespace ft
