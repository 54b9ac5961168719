// SPDX-License-Identifier: Apache-2.0
/// @file Stages: which frame of one camera a map starts from. Source: Mur-Artal, Montiel and
/// Tardos, "ORB-SLAM: a versatile and accurate monocular SLAM system", T-RO 2015, section IV.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/keypoints.hpp"
#include "ft/containers/two_views.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/images/undistort.hpp"
#include "ft/kernels/monocular/initial_matches.hpp"
#include "ft/kernels/two_view/problem.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

/// @throws bad_argument naming the value and the limit
inline void check(start_rules const& p) {
  detail::require_range("min_keypoints", p.min_keypoints, 0, 1 << 23);
  detail::require_range("min_matches", p.min_matches, 0, 1 << 23);
  detail::require_range("longest_gap_s", p.longest_gap_s, 0.0, 1e9);
}

/// What came of a frame.
struct start_report {
  start_outcome outcome;
  int keypoints;  ///< of the frame
  int matches;    ///< with the first frame; after a start, those with a triangulated point
  two_view_status two_views;  ///< of few_matches and the outcomes above it: too_few_matches
};

/// Frames of a batch of cameras, one each.
struct start_frames {
  keypoints_view keypoints;  ///< undistorted, except of very wide lenses
  /// The same keypoints projected into the pinhole cameras of two views. Equal to the keypoints'
  /// positions, except for very wide lenses.
  pixels_view pixels;
  double const* time_s = nullptr;  ///< [batch], executor memory; may be null if not inertial
};

namespace detail {

/// Progress of a camera.
struct start_progress {
  int has_first;
  int attempts;  ///< to reconstruct
  double first_time_s;
};

/// Memory of a batch of starts.
struct start_memory {
  keypoints_view first;
  pixels_view first_pixels;
  int* active = nullptr;  ///< [batch] keypoints of a first frame that is searched, else 0
  start_progress* progress = nullptr;  ///< [batch]
  start_report* report = nullptr;      ///< [batch]
  std::uint64_t* seed = nullptr;       ///< [batch]
  initial_matches_view matches;
};

/// Item: a camera. What its frame is for.
struct open_start_frame {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int b, start_frames const& frames,
                                 start_rules const& rules, start_memory const& m) const {
    start_progress& p = m.progress[b];
    int const n = clamp(frames.keypoints.count[b], 0, frames.keypoints.capacity);
    bool const enough = n > rules.min_keypoints;
    double const now = frames.time_s == nullptr ? 0.0 : frames.time_s[b];
    start_report r{start_outcome::waiting, n, 0, two_view_status::too_few_matches};
    m.active[b] = 0;
    if (p.has_first != 0) {
      // written so that a NaN is too late
      bool const late = rules.inertial && !(now - p.first_time_s <= rules.longest_gap_s);
      bool const searched = enough && !late;
      p.has_first = static_cast<int>(searched);
      m.active[b] = searched ? m.first.count[b] : 0;
      r.outcome = searched ? start_outcome::no_motion : start_outcome::forgot_first;
    } else if (enough) {
      p.has_first = 1;
      p.first_time_s = now;
      m.first.count[b] = n;
      r.outcome = start_outcome::took_first;
    }
    m.report[b] = r;
  }
};

/// Item: a keypoint. Keeps those of new first frames.
struct keep_first_keypoint {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, start_frames const& frames,
                                 start_memory const& m) const {
    int const b = item / m.first.capacity;
    if (m.report[b].outcome != start_outcome::took_first ||
        item % m.first.capacity >= m.first.count[b]) {
      return;
    }
    keypoints_view const& from = frames.keypoints;
    m.first.x(item) = from.x(item);
    m.first.y(item) = from.y(item);
    m.first.angle(item) = from.angle(item);
    m.first.response(item) = from.response(item);
    m.first.octave(item) = from.octave(item);
    m.first.orb(item) = from.orb(item);
    m.first_pixels.x(item) = frames.pixels.x(item);
    m.first_pixels.y(item) = frames.pixels.y(item);
    m.matches.previous[item] = {from.x(item), from.y(item)};
  }
};

/// Item: a camera. Whether its matches are enough for two views.
struct judge_initial_matches {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int b, start_rules const& rules,
                                 start_memory const& m) const {
    m.seed[b] = rules.seed + static_cast<std::uint64_t>(m.progress[b].attempts);
    if (m.report[b].outcome != start_outcome::no_motion) { return; }
    m.report[b].matches = m.matches.count[b];
    if (m.matches.count[b] >= rules.min_matches) {
      ++m.progress[b].attempts;
      return;
    }
    m.report[b].outcome = start_outcome::few_matches;
    m.progress[b].has_first = 0;
    m.active[b] = 0;
  }
};

/// Item: a camera. Keeps the matches with triangulated points of a start.
struct finish_start {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, two_view_reconstructions const& views,
                                 start_memory const& m) const {
    if (m.active[b] == 0) { return; }
    two_view_status const status = views.result[b].status;
    bool const started = status == two_view_status::reconstructed;
    int kept = 0;
    for (int i = g.rank(); started && i < m.active[b]; i += g.size()) {
      std::ptrdiff_t const at = static_cast<std::ptrdiff_t>(b) * m.matches.capacity + i;
      if ((views.flags[at] & two_view_flag::triangulated) == 0) { m.matches.match[at] = -1; }
      kept += static_cast<int>(m.matches.match[at] >= 0);
    }
    kept = g.reduce(kept, sum_op{});
    if (g.rank() == 0) {
      m.report[b].two_views = status;
      if (started) {
        m.report[b].outcome = start_outcome::started;
        m.report[b].matches = m.matches.count[b] = kept;
        m.progress[b].has_first = 0;
      }
    }
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
