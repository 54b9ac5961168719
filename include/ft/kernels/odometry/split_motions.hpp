// SPDX-License-Identifier: Apache-2.0
/// @file Stage: frames whose matches agree with two motions, and the choice of one.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/odometry/match_without_window.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/kernels/odometry/two_motions.hpp"
#include "ft/kernels/pose/optimize_pose.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Item: a camera.
template <typename Rig>
struct split_motions_of_frame {
  /// Parameters that functions refer to. References to those of a kernel would make each thread of
  /// each launch copy them.
  struct inputs {
    motions_of_frames<Rig> frames;
    windowless_workspace work;
  };
  struct scratch {
    typename motion_search<Rig>::scratch motions;
    alignas(inputs) unsigned char parameters[sizeof(inputs)];
  };
  motion_search<Rig> search;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, motions_of_frames<Rig> const& frames,
                                 odometry_state_view const& state,
                                 windowless_workspace const& work) const {
    camera_track& t = state.tracks[b];
    bool const wanted = is_wanted(t) && frames.observations.count[b] >= 2 * limit::least;
    g.sync();
    if (g.rank() == 0) { t.facts.apart = 0; }
    if (!wanted) { return; }
    inputs& kept = *reinterpret_cast<inputs*>(s.parameters);
    if (g.rank() == 0) { kept = {frames, work}; }
    g.sync();
    motions_of_frames<Rig> const& in = kept.frames;
    of_frame const of{in, b, busiest(g, b, in), kept.work};
    int const asked = search.find_two(g, s.motions, of, static_cast<std::uint64_t>(t.time_ns));
    int const chosen = asked > 0 ? weigh(s.motions.places, asked) : -1;
    if (chosen >= 0) {
      if (choose(g, s.motions, of, chosen)) { forget_depths(g, s.motions.places, of, chosen); }
      if (g.rank() == 0) { note(s.motions.places, of, t, chosen); }
      return;
    }
    if (!is_lately(t)) { return; }
    int const free = count_free(g, b, in, t);
    g.sync();
    if (g.rank() == 0 && free > 0) {
      t.facts.apart = free;
      t.apart_ns = t.time_ns;
    }
  }

private:
  using two = typename motion_search<Rig>::scratch;
  using of_frame = frame_observations<Rig>;
  using limit = motion_limits;
  /// Errors that neighbours share, in 1 / 1024 of their variance: three eighths of where a pose is
  /// in doubt (warning_limits::common_errors). Of 596 frames of clean recordings one in 30 has
  /// more, none 160; generated images have less than 40 (bench/lab_notes.md).
  static constexpr int shared = 96;
  static constexpr std::int64_t lasting_ns = 1000000000;

  FT_HOST_DEVICE static bool is_wanted(camera_track const& t) {
    if (t.plan == search_plan::nothing || t.lost_frames > 0) { return false; }
    return is_lately(t) || t.facts.common > shared;
  }
  FT_HOST_DEVICE static bool is_lately(camera_track const& t) {
    return t.apart != 0 && t.time_ns - t.apart_ns <= lasting_ns;
  }

  /// What later frames need to know. A thread's part.
  FT_HOST_DEVICE static void note(two_places const& places, of_frame const& of, camera_track& t,
                                  int chosen) {
    t.facts.apart = 0;
    t.apart_blocks = 0;
    for (int i = 0; i < two_places::blocks; ++i) {
      t.facts.apart += places.matches[1 - chosen][i];
      t.apart_blocks |= static_cast<std::uint64_t>(places.leads(1 - chosen, i)) << i;
    }
    t.apart = 1;
    t.apart_camera = of.camera;
    t.apart_ns = t.time_ns;
  }

  /// Where the other motion was, what has a depth holds no point while it goes on: the number of
  /// such keypoints. @return 0: most of them hold a point again, or there are few
  template <typename Group>
  FT_HOST_DEVICE static int count_free(Group g, int b, motions_of_frames<Rig> const& in,
                                       camera_track const& t) {
    int const camera = t.apart_camera;
    if (is_monocular_v<Rig> || in.depth == nullptr || camera >= in.depth_cameras) { return 0; }
    frame_view const& frame = in.frame;
    keypoints_view const kp = frame.camera(b, camera);
    int const first = camera * frame.capacity();
    int const* const holder =
        frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers() + first;
    float const* const depth =
        in.depth + static_cast<std::ptrdiff_t>(b) * in.depth_cameras * frame.capacity() + first;
    int held = 0, free = 0;
    for (int k = g.rank(); k < *kp.count; k += g.size()) {
      if (!(depth[k] > 0) || (t.apart_blocks >> block_of(in, kp, k) & 1u) == 0) { continue; }
      (holder[k] >= 0 ? held : free) += 1;
    }
    held = g.reduce(held, sum_op{});
    free = g.reduce(free, sum_op{});
    return free >= limit::least && free > 2 * held ? free : 0;
  }

  /// The part of the image that a keypoint is in.
  FT_HOST_DEVICE static int block_of(motions_of_frames<Rig> const& in, keypoints_view const& kp,
                                     int k) {
    int const octave = kp.octave(k);
    return two_places::block_of(in.geometry.column(kp.x(k), octave),
                                in.geometry.row(kp.y(k), octave), in.geometry.width[0],
                                in.geometry.height[0]);
  }

  /// The camera with most observations. Of two cameras that are not rectified the left one.
  template <typename Group>
  FT_HOST_DEVICE static int busiest(Group g, int b, motions_of_frames<Rig> const& in) {
    constexpr int cameras = Rig::rectified ? Rig::cameras : 1;
    int best = 0, largest = -1;
    for (int c = 0; cameras > 1 && c < cameras; ++c) {
      int mine = 0;
      for (int i = g.rank(); i < in.observations.count[b]; i += g.size()) {
        std::ptrdiff_t const at = static_cast<std::ptrdiff_t>(b) * in.observations.capacity + i;
        mine += static_cast<int>(in.observations.items[at].camera == c);
      }
      int const all = g.reduce(mine, sum_op{});
      best = all > largest ? c : best;
      largest = max_of(all, largest);
    }
    return best;
  }

  /// Which motion is that of the camera: the one that is behind the other, else the one whose
  /// matches lie in more parts of the image. A motion is one that has parts of the image for
  /// itself: matches that agree with nothing else are scattered where they come from errors.
  /// @param n matches @return -1: too few are where one motion leads and agree with it alone
  FT_HOST_DEVICE static int weigh(two_places const& places, int n) {
    int own[2] = {}, blocks[2] = {};
    for (int i = 0; i < two_places::blocks; ++i) {
      for (int k = 0; k < 2; ++k) {
        bool const leads = places.leads(k, i);
        own[k] += leads ? places.matches[k][i] : 0;
        blocks[k] += static_cast<int>(leads);
      }
    }
    if (min_of(own[0], own[1]) < max_of(limit::least, n / 16)) { return -1; }
    int const behind = places.behind();
    if (behind >= 0) { return behind; }
    return blocks[1] > blocks[0] || (blocks[1] == blocks[0] && own[1] > own[0]) ? 1 : 0;
  }

  /// The frame's pose is that of the chosen motion, by the matches that agree with it better than
  /// with the other one. The others release their points. @return false, and nothing is changed,
  /// where most of the chosen ones were left out for the pose before, so that their points are
  /// held no more
  template <typename Group>
  FT_HOST_DEVICE bool choose(Group g, two& s, of_frame const& of, int chosen) const {
    motions_of_frames<Rig> const& in = of.in;
    rigid<double> const& T = s.T[chosen];
    rigid<double> const& other = s.T[1 - chosen];
    auto const agrees_better = [&](observation const& o) {
      int const e = of.error(T, o);
      return e < limit::most && e < of.error(other, o);
    };
    int held = 0;
    for (int i = g.rank(); i < of.count(); i += g.size()) {
      observation const o = of.at(i);
      bool const is = o.camera == of.camera && in.observations.outlier[of.first() + i] == 0;
      held += static_cast<int>(is && agrees_better(o));
    }
    held = g.reduce(held, sum_op{});
    int const n = of.keep(g, agrees_better);
    if (held < max_of(limit::least, n / 2)) { return false; }
    search.improve(g, s, of, n, chosen, in.information + of.b * information_terms);
    if (g.rank() == 0) { in.T_cw[of.b] = of.refined().T_cw; }
    int* const holder = in.frame.holder + static_cast<std::ptrdiff_t>(of.b) * in.frame.numbers();
    int kept = 0;
    for (int i = g.rank(); i < of.count(); i += g.size()) {
      std::ptrdiff_t const at = of.first() + i;
      observation const o = of.at(i);
      int const e = of.error(T, o);
      // What is far agrees with both. Of two cameras that are not rectified the other one is not
      // asked.
      bool const asked = Rig::rectified || o.camera == of.camera;
      bool const agrees =
          !asked || e < limit::distant || (e < limit::most && e < of.error(other, o));
      if (!agrees) {
        in.observations.outlier[at] = 1;
        holder[in.observations.number[at]] = -1;
      }
      kept += static_cast<int>(in.observations.outlier[at] == 0);
    }
    kept = g.reduce(kept, sum_op{});
    if (g.rank() == 0) { in.observations.inliers[of.b] = kept; }
    return true;
  }

  /// Where the other motion has most matches, keypoints that hold no point become none.
  template <typename Group>
  FT_HOST_DEVICE static void forget_depths(Group g, two_places const& places, of_frame const& of,
                                           int chosen) {
    motions_of_frames<Rig> const& in = of.in;
    int const b = of.b, camera = of.camera;
    if (is_monocular_v<Rig> || in.depth == nullptr || camera >= in.depth_cameras) { return; }
    g.sync();
    frame_view const& frame = in.frame;
    keypoints_view const kp = frame.camera(b, camera);
    std::ptrdiff_t const numbers = static_cast<std::ptrdiff_t>(b) * frame.numbers();
    int const first = camera * frame.capacity();
    float* const depth =
        in.depth + static_cast<std::ptrdiff_t>(b) * in.depth_cameras * frame.capacity() + first;
    for (int k = g.rank(); k < *kp.count; k += g.size()) {
      if (frame.holder[numbers + first + k] >= 0) { continue; }
      if (places.leads(1 - chosen, block_of(in, kp, k))) { depth[k] = -1.0f; }
    }
  }
};

}  // namespace detail

/// Of frames that follow one whose errors neighbours shared, or that had two motions within a
/// second: looks for two poses that many matches agree with each, and not with the other one. The
/// frame keeps the one that is behind the other: things that move, and what is fixed to the camera,
/// hide the scene. Where they do not meet it keeps the one whose matches lie in more parts of the
/// image. Where the other one was, it is told of until most of what has a depth holds points
/// again. Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec, typename Rig>
void split_motions(Exec const& exec, motions_of_frames<Rig> const& in,
                   odometry_state_view const& state, windowless_workspace const& work,
                   pose_params const& params = {}) {
  for_each_item<per_block<sum_lanes>>(
      exec, in.frame.batch, detail::split_motions_of_frame<Rig>{{params}}, in, state, work);
}

}  // namespace FT_ABI
}  // namespace ft
