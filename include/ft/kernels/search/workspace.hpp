// SPDX-License-Identifier: Apache-2.0
/// @file Parameters and working memory of a search.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "ft/containers/feature_grid.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/grid.hpp"

namespace ft {
inline namespace FT_ABI {

// Search windows: the part of an image in which a map point is searched.

/// A square in the image and a range of octaves.
struct search_window {
  float x, y;        ///< centre, pixels
  float radius;      ///< half side, and tolerance of the right column, pixels
  float right_x;     ///< predicted column in the right image
  int min_level;     ///< 0 or below: no lower limit
  int max_level;     ///< below 0: no upper limit
  int slot;          ///< map point; -1 = the window is not searched
  bool check_right;  ///< compare columns in the right image, for keypoints that have one

  FT_HOST_DEVICE static search_window none() { return {0, 0, 0, 0, 0, 0, -1, false}; }
};

/// The windows of a map point in both cameras.
struct window_pair {
  search_window of[2] = {search_window::none(), search_window::none()};

  /// Returned by value: a run-time index into `of` would move both windows to local memory.
  FT_HOST_DEVICE search_window camera(int c) const { return c == 0 ? of[0] : of[1]; }
};

/// The windows of a search, in search order.
struct search_windows_view {
  search_window* windows = nullptr;  ///< [cameras][batch][capacity]
  int* count = nullptr;              ///< [batch]
  int capacity = 0;
  int batch = 0;
  int cameras = 1;

  FT_HOST_DEVICE search_window& at(int camera, int b, int i) const {
    return windows[(static_cast<std::ptrdiff_t>(camera) * batch + b) * capacity + i];
  }
  /// Both windows of a point; the second is none() if there is one camera.
  FT_HOST_DEVICE window_pair pair(int b, int i) const {
    window_pair both;
    both.of[0] = at(0, b, i);
    if (cameras == 2) { both.of[1] = at(1, b, i); }
    return both;
  }
};

inline void carve(carver& c, search_windows_view& v, int capacity, int batch, int cameras) {
  v.capacity = capacity;
  v.batch = batch;
  v.cameras = cameras;
  c.place({batch, cameras, capacity}, v.windows);
  c.place({batch}, v.count);
}

namespace detail {

/// Writes the windows of point i of batch entry b.
template <int Cameras>
FT_HOST_DEVICE void store(search_windows_view const& to, int b, int i, window_pair const& pair) {
  to.at(0, b, i) = pair.of[0];
  if constexpr (Cameras == 2) { to.at(1, b, i) = pair.of[1]; }
}

/// Computes the windows of an item's point, and writes them to `to`.
/// @tparam Windows see list_point
/// @param item b * capacity + i for point i of batch entry b
/// @return false, with nothing written, if the frame has fewer points
template <typename Windows, typename Group>
FT_HOST_DEVICE bool find_windows(Group g, int item, typename Windows::search const& search,
                                 map_points_view const& map, search_windows_view const& to,
                                 window_pair& pair) {
  int const b = item / to.capacity;
  int const i = item % to.capacity;
  int const count = Windows::count(search, b);
  bool const writes = g.rank() == 0;
  if (i == 0 && writes) { to.count[b] = count; }
  if (i >= count) { return false; }
  // All threads compute the same windows, which is faster than a broadcast.
  pair = Windows::find(search, map, b, i, to, writes);
  if (writes) { store<Windows::cameras>(to, b, i, pair); }
  return true;
}

}  // namespace detail

/// Calls visit(k) for every keypoint k in the grid cells of a window, in grid order. All threads of
/// the group make every call. A thread without a keypoint in a step passes -1.
/// @tparam Group one thread or a warp
template <typename Group, typename Visit>
FT_HOST_DEVICE FT_INLINE void visit_cells(Group g, search_window const& w,
                                          feature_grid_view const& grid, Visit const& visit) {
  cell_window const cells = cell_window::of(grid.geometry, w.x, w.y, w.radius);
  if (cells.y0 > cells.y1) { return; }
  int const columns = cells.x1 - cells.x0 + 1;
  for (int first = 0; first < columns; first += g.size()) {
    // The cells of a grid column are contiguous, so a column contributes one run of indices. Each
    // thread looks up one column, then all threads walk the concatenated runs.
    int const here = min_of(columns - first, g.size());
    int const column = (cells.x0 + first + min_of(g.rank(), here - 1)) * grid.geometry.rows;
    int const begin = grid.start[column + cells.y0];
    int const length = g.rank() < here ? grid.start[column + cells.y1 + 1] - begin : 0;
    int total = 0;
    int const before = g.exclusive_scan(length, total);
    for (int base = 0; base < total; base += g.size()) {
      int const at = base + g.rank();
      int run = 0;  // last run that begins at or before `at`
      int run_before = 0;
      for (int c = 0; c < here; ++c) {
        int const that = g.shuffle(before, c);
        if (that <= at) {
          run = c;
          run_before = that;
        }
      }
      int const run_begin = g.shuffle(begin, run);
      visit(at < total ? grid.indices[run_begin + at - run_before] : -1);
    }
  }
}

/// Whether a keypoint lies strictly inside the square and has one of the window's octaves.
FT_HOST_DEVICE inline bool inside(search_window const& w, keypoints_view const& kp, int k) {
  int const octave = kp.octave(k);
  return octave >= w.min_level && (w.max_level < 0 || octave <= w.max_level) &&
         ::fabsf(kp.x(k) - w.x) < w.radius && ::fabsf(kp.y(k) - w.y) < w.radius;
}

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
  /// Largest Hamming distance of a match, bits; of another descriptor see detail::search_scale.
  int max_hamming = detail::descriptor_scale::limit(100);
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
  // One link per possible write of a search, and at least one entry per keypoint.
  v.links = max_of(2 * cameras * windows, cameras * keypoints);
  c.place({batch, cameras, windows, search_workspace::list_size / 4}, v.list);
  c.place({batch, cameras, windows}, v.list_count, v.match);
  c.place({batch, windows}, v.open);
  c.place({batch, cameras, keypoints}, v.writer);
  c.place({batch, v.links}, v.before);
  c.place({batch, cameras, keypoints}, v.held);
  c.place({batch}, v.matches);
}

}  // namespace FT_ABI
}  // namespace ft
