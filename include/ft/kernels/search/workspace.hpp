// SPDX-License-Identifier: Apache-2.0
/// @file What a search is asked for, and its working memory.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/core/config.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

enum class search_kind {
  last_frame,  ///< no ratio test; the right camera only where the left window held a keypoint
  local_map,   ///< ratio test; a refusal on the left ends the point; stereo partners are taken too
};

struct search_params {
  search_kind kind = search_kind::local_map;
  int max_distance = 100;   ///< descriptors differ in at most this many bits
  float ratio = 0.8f;       ///< best over second best, same octave; local map only
  bool from_empty = false;  ///< nobody holds a keypoint: holders are cleared first
  /// The candidates are listed while frame.right_x is not there yet: it is looked at when they are
  /// chosen from. Last frame only.
  bool right_later = false;
  /// The candidates are listed while frame.holder and the points' stamps are not there yet:
  /// leave_out() follows. Local map only.
  bool holders_later = false;
};

/// Four candidates of a window, each distance << 23 | keypoint.
struct alignas(16) candidate_quad {
  std::uint32_t entry[4];
};

/// Candidates of one search and the state of the assignment.
struct search_workspace {
  /// The best candidates of a window are listed; who needs more walks the grid again.
  static constexpr int list_size = 16;
  /// [cameras][batch][capacity][list_size / 4], the nearest first, of equals the first in the grid;
  /// filled up with ~0 to whole quads
  candidate_quad* list = nullptr;
  static constexpr int observed = 1 << 30;
  static constexpr int left_out = 1 << 29;
  static constexpr int unlisted = 1 << 28;
  static constexpr int counted = unlisted - 1;
  /// [cameras][batch][capacity] how many are listed, 0 where a window can take none of them; plus
  /// `unlisted` where there are farther ones, `observed` where the point looked for is that, and
  /// `left_out` where candidates are not listed since they are taken
  int* list_count = nullptr;
  /// [cameras][batch][capacity] keypoint taken by each window, -1 = none. Who lists the candidates
  /// begins with what a window of the local map would take if it were alone.
  int* match = nullptr;
  int* open = nullptr;    ///< [batch][capacity] points that have candidates
  int* writer = nullptr;  ///< [batch][numbers] who owns or writes a keypoint
  int* before = nullptr;  ///< [batch][links] a second such table, or links of chains of writers
  std::uint8_t* held = nullptr;  ///< [batch][numbers] 1 = taken before the search
  int* matches = nullptr;        ///< [batch] keypoints that were given a point
  int capacity = 0;              ///< windows
  int links = 0;
  int batch = 0;
  int cameras = 1;

  FT_HOST_DEVICE std::ptrdiff_t window(int camera, int b, int i) const {
    return (static_cast<std::ptrdiff_t>(camera) * batch + b) * capacity + i;
  }
  std::size_t list_bytes() const {
    return static_cast<std::size_t>(window(cameras, 0, 0)) * (list_size / 4) *
           sizeof(candidate_quad);
  }
};

inline void carve(carver& c, search_workspace& v, int windows, int keypoints, int batch,
                  int cameras) {
  v.capacity = windows;
  v.batch = batch;
  v.cameras = cameras;
  std::size_t const b = static_cast<std::size_t>(batch);
  std::size_t const per_camera = detail::checked_mul(b, static_cast<std::size_t>(windows));
  std::size_t const n = detail::checked_mul(static_cast<std::size_t>(cameras), per_camera);
  std::size_t const numbers =
      b * static_cast<std::size_t>(cameras) * static_cast<std::size_t>(keypoints);
  v.list = c.take<candidate_quad>(detail::checked_mul(n, search_workspace::list_size / 4));
  v.list_count = c.take<int>(n);
  v.match = c.take<int>(n);
  v.open = c.take<int>(per_camera);
  v.writer = c.take<int>(numbers);
  // As many as there are writes in a search, and at least one a keypoint.
  v.links = max_of(2 * cameras * windows, cameras * keypoints);
  v.before = c.take<int>(detail::checked_mul(b, static_cast<std::size_t>(v.links)));
  v.held = c.take<std::uint8_t>(numbers);
  v.matches = c.take<int>(b);
}

}  // namespace FT_ABI
}  // namespace ft
