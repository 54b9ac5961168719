// SPDX-License-Identifier: Apache-2.0
/// @file Parameters and working memory of a search.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/frame.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/search/windows.hpp"

namespace ft {
inline namespace FT_ABI {

// Stage: clears the holders of keypoints.

namespace detail {

/// Item: a keypoint. Clears its holder.
struct clear_holder {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, frame_view const& frame) const {
    frame.holder[item] = -1;
  }
};

}  // namespace detail

/// Clears the holders of all frames. Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec>
void clear_holders(Exec const& exec, frame_view const& frame) {
  for_each_item<per_thread>(exec, frame.batch * frame.numbers(), detail::clear_holder{}, frame);
}

enum class search_kind {
  /// No ratio test. The right camera is searched only if the left window contains a keypoint.
  last_frame,
  /// With the ratio test. A point that fails it in the left camera is not searched in the right
  /// one. The stereo partner of a matched keypoint is matched, too.
  local_map,
};

/// How descriptors are matched.
struct search_params {
  search_kind kind = search_kind::local_map;
  /// Largest Hamming distance of a match, bits.
  int max_hamming = 100;
  /// Ratio test: largest distance of the best candidate over that of the second best, applied if
  /// both have the same octave. Local map only.
  float ratio = 0.8f;
  /// Ignores and overwrites the holders of the frame before the search.
  bool from_empty = false;
  /// Every point keeps its keypoints, as if all were observed; see search_workspace.
  bool all_observed = false;
};

/// Four candidates of a window, each packed as distance << 23 | keypoint. Loaded at once.
struct alignas(16) candidate_quad {
  std::uint32_t entry[4];
};

/// Candidate lists of a search and the state of its assignment.
///
/// A map point is *observed* if its number of observations is positive. Only observed points keep
/// their keypoints. A keypoint of an unobserved point may be taken over by a later point.
struct search_workspace {
  /// Candidates listed per window. A window that exhausts its list rescans the grid.
  static constexpr int list_size = 16;
  /// [cameras][batch][capacity][list_size / 4] candidates by distance, ties in grid order. The last
  /// quad is padded with ~0.
  candidate_quad* list = nullptr;

  // Bits of list_count.
  static constexpr int observed = 1 << 30;      ///< the window's point is observed
  static constexpr int left_out = 1 << 29;      ///< held candidates were omitted; two cameras only
  static constexpr int unlisted = 1 << 28;      ///< more candidates exist than the list holds
  static constexpr int counted = unlisted - 1;  ///< mask: number of listed candidates
  /// [cameras][batch][capacity] number of listed candidates and the bits above. The number is 0 if
  /// even the nearest candidate is too far.
  int* list_count = nullptr;
  /// [cameras][batch][capacity] keypoint matched to each window, -1 = none. In a search of the
  /// local map, the listing stores the choice that the window would make without the others.
  int* match = nullptr;
  /// [batch][capacity] points that have candidates.
  int* open = nullptr;
  /// [batch][numbers] owner of a keypoint, or its writers.
  int* writer = nullptr;
  /// [batch][links] a second such table, or the links of chains of writers.
  int* before = nullptr;
  /// [batch][numbers] 1 = held by an observed point since before the search.
  std::uint8_t* held = nullptr;
  /// [batch] number of keypoints matched to a map point.
  int* matches = nullptr;
  int capacity = 0;  ///< windows per camera and batch entry
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

/// Outputs of a search, except the holders of the frame.
struct search_buffers {
  search_windows_view windows;
  search_workspace work;
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
  // One link per possible write of a search, and at least one entry per keypoint.
  v.links = max_of(2 * cameras * windows, cameras * keypoints);
  v.before = c.take<int>(detail::checked_mul(b, static_cast<std::size_t>(v.links)));
  v.held = c.take<std::uint8_t>(numbers);
  v.matches = c.take<int>(b);
}

}  // namespace FT_ABI
}  // namespace ft
