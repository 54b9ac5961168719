// SPDX-License-Identifier: Apache-2.0
/// @file Stages: the points of frames that are being relocalised.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/pnp/problem.hpp"
#include "ft/kernels/words/search_by_words.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

// Stage: from the matches of a search by words to pose problems.

/// Frames and the matches of their keypoints. Keypoint k of the left camera is number k of a row of
/// `matches`.
struct matched_frames {
  frame_view frame;
  map_points_view map;
  pyramid_geometry geometry;
  word_matches_view matches;
  int const* frame_of = nullptr;  ///< [pairs] batch entry of frame and map; null: entry 0
  int min_matches = 15;           ///< a pair with fewer, in both cameras, is no problem
  float chi2 = 5.991f;            ///< limit of the squared error of an inlier over sigma^2
  std::uint64_t seed = 0;         ///< of the first problem; each further one has the next number
};

namespace detail {

/// Item: a pair, and the pose problem with its number.
struct gather_problem {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int p, matched_frames const& in,
                                 pnp_problems_view const& out, int* active) const {
    int const b = in.frame_of != nullptr ? in.frame_of[p] : 0;
    keypoints_view const kp = in.frame.camera(b, 0);
    map_points_view const points = in.map.slice(b);
    int const* const match =
        in.matches.match + static_cast<std::ptrdiff_t>(p) * in.matches.capacity;
    int const n = min_of(*kp.count, in.matches.capacity);
    int placed = 0;
    for (int base = 0; base < n; base += g.size()) {
      int const k = base + g.rank();
      int const slot = k < n ? match[k] : -1;
      bool const there = slot >= 0 && slot < points.capacity;
      int here = 0;
      int const place = placed + g.exclusive_count(there, here);
      placed += here;
      if (!there) { continue; }
      std::ptrdiff_t const at = out.at(p) + place;
      int const octave = kp.octave(k);
      out.pixel[at] = {in.geometry.column(kp.x(k), octave), in.geometry.row(kp.y(k), octave)};
      out.point[at] = points.position(slot);
      out.max_error2[at] = mul(in.geometry.sigma2[octave], in.chi2);
      out.keypoint[at] = k;
    }
    if (g.rank() != 0) { return; }
    out.count[p] = placed;
    out.seed[p] = in.seed + static_cast<std::uint64_t>(p);
    active[p] = static_cast<int>(in.matches.count[p] >= in.min_matches);
  }
};

}  // namespace detail

/// The pose problems of matched frames: a correspondence for each matched keypoint of the left
/// camera, in order. Writes all of `out` but its rays. Asynchronous on `exec`; allocates nothing;
/// one launch.
/// @param out a problem for each pair
/// @param active [pairs] 1 for pairs with enough matches, else 0; for pnp_problems_view::active
/// @throws bad_argument if the problems are fewer than the pairs, or smaller than a frame
template <typename Exec>
void gather_correspondences(Exec const& exec, matched_frames const& in,
                            pnp_problems_view const& out, int* active) {
  detail::require_range("pose problems", out.problems, in.matches.pairs, 1 << 30);
  detail::require_range("correspondences of a pose problem", out.capacity, in.frame.capacity(),
                        1 << 30);
  for_each_item<per_block<256>>(exec, in.matches.pairs, detail::gather_problem{}, in, out, active);
}

/// What is kept of frames while they are relocalised, besides their holders.
struct relocalization_view {
  int batch = 0;
  int numbers = 0;           ///< of a frame: keypoints of all cameras
  int slots = 0;             ///< of the map
  pose* T_cw = nullptr;      ///< [batch]
  int* held = nullptr;       ///< [batch][numbers] holders before an optimisation
  int* found_now = nullptr;  ///< [batch] number of the set of points found last
  int* found_in = nullptr;   ///< [batch][slots] number of the last set that had the point
  /// [batch][numbers] 1 = outlier in the last optimisation in which the keypoint held a point
  unsigned char* outlier = nullptr;

  /// The points found last.
  point_stamps found() const { return {found_now, found_in}; }
};
static_assert(std::is_trivially_copyable<relocalization_view>::value, "passed to kernels");

inline void carve(carver& c, relocalization_view& v, int numbers, int slots, int batch) {
  v.batch = batch;
  v.numbers = numbers;
  v.slots = slots;
  c.place({batch}, v.T_cw);
  c.place({batch, numbers}, v.held);
  c.place({batch}, v.found_now);
  c.place({batch, slots}, v.found_in);
  c.place({batch, numbers}, v.outlier);
}

/// Nothing is found, no keypoint is an outlier. Asynchronous if the executor is; allocates nothing.
template <typename Exec>
void clear(Exec const& exec, relocalization_view const& v) {
  auto const b = static_cast<std::size_t>(v.batch);
  fill_bytes(exec, v.found_now, 0, b * sizeof(int));
  fill_bytes(exec, v.found_in, 0xff, b * static_cast<std::size_t>(v.slots) * sizeof(int));
  fill_bytes(exec, v.outlier, 0, b * static_cast<std::size_t>(v.numbers));
}

/// Poses of problems, as gather_correspondences() makes these, and the problem of each frame.
struct solved_frames {
  pnp_problems_view problems;
  pnp_results_view results;
  word_matches_view matches;
  int const* problem = nullptr;  ///< [batch] of the frame whose pose is taken; -1 = none
};

namespace detail {

/// Item: a frame. Takes the pose of a problem and the points of its inliers.
struct hold_inliers {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, frame_view const& frame,
                                 solved_frames const& in, relocalization_view const& to) const {
    int const p = in.problem[b];
    if (p < 0 || p >= in.problems.problems) { return; }
    int* const holder = frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers();
    int const set = to.found_now[b] + 1;
    for (int k = g.rank(); k < frame.numbers(); k += g.size()) { holder[k] = -1; }
    g.sync();
    std::ptrdiff_t const first = in.problems.at(p);
    int const count = in.problems.of(p).count;
    for (int i = g.rank(); i < count; i += g.size()) {
      if (in.results.inlier[first + i] == 0) { continue; }
      int const k = in.problems.keypoint[first + i];
      int const slot = in.matches.match[static_cast<std::ptrdiff_t>(p) * in.matches.capacity + k];
      holder[k] = slot;
      to.found_in[static_cast<std::ptrdiff_t>(b) * to.slots + slot] = set;
    }
    if (g.rank() == 0) {
      to.found_now[b] = set;
      to.T_cw[b] = in.results.result[p].T_cw;
    }
  }
};

/// Item: a frame. The points found are those that its keypoints hold.
struct find_held {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, frame_view const& frame,
                                 relocalization_view const& to) const {
    int const* const holder = frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers();
    int const set = to.found_now[b] + 1;
    g.sync();
    for (int k = g.rank(); k < frame.numbers(); k += g.size()) {
      int const slot = holder[k];
      if (slot >= 0 && slot < to.slots) {
        to.found_in[static_cast<std::ptrdiff_t>(b) * to.slots + slot] = set;
      }
    }
    if (g.rank() == 0) { to.found_now[b] = set; }
  }
};

/// Item: a frame. Notes the outliers of an optimisation, whose keypoints hold their points again.
struct keep_outliers {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, frame_view const& frame,
                                 observations_view const& seen,
                                 relocalization_view const& to) const {
    std::ptrdiff_t const first = static_cast<std::ptrdiff_t>(b) * frame.numbers();
    std::ptrdiff_t const row = static_cast<std::ptrdiff_t>(b) * seen.capacity;
    for (int i = g.rank(); i < seen.count[b]; i += g.size()) {
      int const number = seen.number[row + i];
      to.outlier[first + number] = seen.outlier[row + i];
      frame.holder[first + number] = to.held[first + number];
    }
  }
};

/// Item: a keypoint. Releases its point if it is an outlier.
struct release_outlier {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, frame_view const& frame,
                                 relocalization_view const& in) const {
    if (in.outlier[item] != 0) { frame.holder[item] = -1; }
  }
};

inline void require_relocalization(frame_view const& frame, relocalization_view const& v) {
  require_range("frames of a relocalisation", v.batch, frame.batch, frame.batch);
  require_range("keypoints of a relocalisation", v.numbers, frame.numbers(), frame.numbers());
}

}  // namespace detail

/// Every frame takes the pose of its problem, and its keypoints hold the points of the inliers and
/// no others. These points are the ones found. Frames without a problem stay as they are.
/// Asynchronous on `exec`; allocates nothing; one launch.
/// @pre every frame's problem has a pose
/// @throws bad_argument for views of different shapes, likewise below
template <typename Exec>
void hold_inliers(Exec const& exec, frame_view const& frame, solved_frames const& in,
                  relocalization_view const& to) {
  detail::require_relocalization(frame, to);
  for_each_item<per_block<512>>(exec, frame.batch, detail::hold_inliers{}, frame, in, to);
}

/// The points found become those that keypoints hold. Asynchronous on `exec`; allocates nothing;
/// one launch.
template <typename Exec>
void find_held_points(Exec const& exec, frame_view const& frame, relocalization_view const& to) {
  detail::require_relocalization(frame, to);
  for_each_item<per_block<512>>(exec, frame.batch, detail::find_held{}, frame, to);
}

/// After optimize_frame_poses(): notes the outliers among the keypoints that held a point; they
/// hold their points again. Asynchronous on `exec`; allocates nothing; one launch.
/// @param to `held` has the holders from before the optimisation
template <typename Exec>
void keep_outliers(Exec const& exec, frame_view const& frame, observations_view const& seen,
                   relocalization_view const& to) {
  detail::require_relocalization(frame, to);
  for_each_item<per_block<512>>(exec, frame.batch, detail::keep_outliers{}, frame, seen, to);
}

/// Keypoints noted as outliers hold no point. Asynchronous on `exec`; allocates nothing; one
/// launch.
template <typename Exec>
void release_outliers(Exec const& exec, frame_view const& frame, relocalization_view const& in) {
  detail::require_relocalization(frame, in);
  for_each_item<per_thread>(exec, frame.batch * frame.numbers(), detail::release_outlier{}, frame,
                            in);
}

}  // namespace FT_ABI
}  // namespace ft
