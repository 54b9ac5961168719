// SPDX-License-Identifier: Apache-2.0
/// @file Stage: poses of frames from the map points that their keypoints hold.
#pragma once

#include <cstddef>

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/containers/soa.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/pose/optimize_pose.hpp"
#include "ft/kernels/pose/pose_problem.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/relocalization.hpp"

namespace ft {
inline namespace FT_ABI {

/// A batch of frames and the map points that their keypoints hold.
struct frames_in_map {
  frame_view frame;
  map_points_view map;
  pyramid_geometry geometry;  ///< position and weight of a keypoint depend on its octave
  /// [batch][cameras * capacity] not 0 = the keypoint releases its point: it is of what is fixed to
  /// a camera. Null: none does
  unsigned char const* fixed = nullptr;
  /// [batch][cameras * capacity] 0 or more = the keypoint is where its point's patch is, and counts
  /// `weight_of_aligned` times. Null: none is
  float const* moves = nullptr;
};

/// Inputs and outputs of optimize_frame_poses(), in the executor's memory.
struct frame_poses {
  pose const* start;               ///< [batch] T_cw
  pose* result;                    ///< [batch] T_cw; may be `start`
  observations_view observations;  ///< written; capacity at least frame.numbers()
  /// [batch][information_terms] as in pose_problem; may be null
  float* information = nullptr;
  /// [batch] as in pose_problem; may be null
  rigid<double> const* exact_start = nullptr;
  rigid<double>* exact_result = nullptr;
};

namespace detail {

/// One item: a frame. Gathers the observations, optimises the pose and releases outliers.
template <typename Rig>
struct optimize_frame {
  struct scratch {
    pose_scratch pose;
    int number[prepared_observations::size];  ///< keypoint number of an observation
  };
  Rig rig;
  pose_params params;
  pose_limits limits = pose_limits::of(params);

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, frames_in_map const& in,
                                 frame_poses const& poses) const {
    frame_view const& frame = in.frame;
    map_points_view const points = in.map.slice(b);
    observations_view const& out = poses.observations;
    int* const holder = frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers();
    std::ptrdiff_t const at = static_cast<std::ptrdiff_t>(b) * out.capacity;
    int const n = list_observations(g, s, b, in, out.number + at);
    float* const information =
        poses.information == nullptr
            ? nullptr
            : poses.information + static_cast<std::ptrdiff_t>(b) * information_terms;
    pose_problem const problem{out.items + at,
                               n,
                               poses.start + b,
                               poses.result + b,
                               out.outlier + at,
                               out.inliers + b,
                               information,
                               poses.exact_start == nullptr ? nullptr : poses.exact_start + b,
                               poses.exact_result == nullptr ? nullptr : poses.exact_result + b,
                               in.moves != nullptr};
    pose_solver<Group, Rig> const solver{g, s.pose, rig, problem, params, limits};
    auto const number_of = [&](int i) {
      return i < prepared_observations::size ? s.number[i] : out.number[at + i];
    };
    FT_NO_UNROLL
    for (int i = g.rank(); i < n; i += g.size()) {
      int const number = number_of(i);
      int const c = camera_of(frame, number);
      int const k = number - c * frame.capacity();
      keypoints_view const kp = frame.camera(b, c);
      std::ptrdiff_t const first =
          static_cast<std::ptrdiff_t>(b) * (Rig::cameras * frame.capacity());
      float const right =
          Rig::rectified && frame.right_x != nullptr ? frame.right_x[first + number] : -1.0f;
      int const octave = kp.octave(k);
      bool const aligned = in.moves != nullptr && in.moves[first + number] >= 0;
      float const weight = in.geometry.inv_sigma2[octave];
      observation const o{points.position(holder[number]),
                          in.geometry.column(kp.x(k), octave),
                          in.geometry.row(kp.y(k), octave),
                          right < 0 ? right : in.geometry.column(right, octave),
                          aligned ? mul(weight_of_aligned, weight) : weight,
                          c};
      out.items[at + i] = o;
      solver.prepare(i, o, aligned);
    }
    if (g.rank() == 0) { out.count[b] = n; }
    solver.solve();
    FT_NO_UNROLL
    for (int i = g.rank(); i < n; i += g.size()) {
      if (solver.is_outlier(i)) { holder[number_of(i)] = -1; }
    }
  }

private:
  /// Camera of a keypoint.
  FT_HOST_DEVICE static int camera_of(frame_view const& frame, int number) {
    int c = 0;
    FT_UNROLL
    for (int next = 1; next < Rig::cameras; ++next) {
      c += static_cast<int>(number >= next * frame.capacity());
    }
    return c;
  }
  /// Lists the numbers of the keypoints that hold a point, in scratch and in `listed`. Returns
  /// their number. Fixed ones release it first.
  template <typename Group>
  FT_HOST_DEVICE static int list_observations(Group g, scratch& s, int b, frames_in_map const& in,
                                              int* listed) {
    frame_view const& frame = in.frame;
    std::ptrdiff_t const first = static_cast<std::ptrdiff_t>(b) * frame.numbers();
    int* const holder = frame.holder + first;
    unsigned char const* const fixed = in.fixed == nullptr ? nullptr : in.fixed + first;
    // Keypoint numbers without the gaps between the cameras': `before` of those precede camera c.
    int before[Rig::cameras];
    int all = 0;
    FT_UNROLL
    for (int c = 0; c < Rig::cameras; ++c) {
      before[c] = all;
      all += c < frame.cameras ? *frame.camera(b, c).count : 0;
    }
    // Each part of the group takes a run of keypoints, so one scan over the parts gives all places.
    auto const part = g.part();
    int const run = ceil_div(all, g.size()) * part.size();
    int const from = g.part_index() * run;
    int const to = min_of(from + run, all);
    auto const number_of = [&](int k) {
      int number = k;
      FT_UNROLL
      for (int c = 1; c < Rig::cameras; ++c) {
        number = k < before[c] ? number : k - before[c] + c * frame.capacity();
      }
      return number;
    };
    auto const holds = [&](int k) { return k < to && holder[number_of(k)] >= 0; };
    if (fixed != nullptr) {
      // Each thread looks at the keypoints that it will count.
      for (int k = from + part.rank(); k < to; k += part.size()) {
        int const number = number_of(k);
        if (fixed[number] != 0) { holder[number] = -1; }
      }
    }
    int mine = 0;
    constexpr int at_once = 4;  // loads
    FT_NO_UNROLL
    for (int k = from + part.rank(); k < to; k += at_once * part.size()) {
      FT_UNROLL
      for (int j = 0; j < at_once; ++j) { mine += static_cast<int>(holds(k + j * part.size())); }
    }
    int n = 0;
    int place = part.shuffle(g.exclusive_scan(mine, n), 0);
    FT_NO_UNROLL
    for (int k = from + part.rank(); k - part.rank() < to; k += part.size()) {
      bool const held = holds(k);
      int count = 0;
      int const i = place + part.exclusive_count(held, count);
      if (held) {
        listed[i] = number_of(k);
        if (i < prepared_observations::size) { s.number[i] = number_of(k); }
      }
      place += count;
    }
    g.sync();
    return n;
  }
};

}  // namespace detail

/// Pose of every frame from the map points that its keypoints hold. A keypoint releases its point
/// if it is an outlier. Asynchronous on `exec`; allocates nothing; one launch.
/// @param in `holder` of the frame is read and written
template <typename Exec, typename Rig>
void optimize_frame_poses(Exec const& exec, Rig const& rig, frames_in_map const& in,
                          frame_poses const& poses, pose_params const& params = {}) {
  for_each_item<per_block<sum_lanes>>(exec, in.frame.batch,
                                      detail::optimize_frame<Rig>{rig, params}, in, poses);
}

}  // namespace FT_ABI
}  // namespace ft
