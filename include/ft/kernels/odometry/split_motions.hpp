// SPDX-License-Identifier: Apache-2.0
/// @file Stage: frames whose matches agree with two motions, and the choice of one.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/counter_draws.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/odometry/match_without_window.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/kernels/pnp/draw_pose.hpp"
#include "ft/kernels/pose/optimize_pose.hpp"
#include "ft/kernels/pose/pose_problem.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

/// Inputs and results of split_motions(), in executor memory.
template <typename Rig>
struct motions_of_frames {
  Rig rig;
  frame_view frame;                ///< keypoints of the motion that was not chosen release points
  observations_view observations;  ///< of the last pose; `outlier` and `inliers` are written
  pose* T_cw = nullptr;            ///< [batch] that pose; replaced
  float* information = nullptr;    ///< [batch][information_terms] likewise
  float* depth = nullptr;  ///< [batch][depth_cameras * capacity] metres; where the other motion is,
                           ///< keypoints lose theirs
  int depth_cameras = 1;
  pyramid_geometry geometry{};  ///< of the images
};

namespace detail {

/// Which parts of an image two sets of matches are in.
struct two_places {
  static constexpr int columns = 8, rows = 6;
  static constexpr int blocks = columns * rows;
  int matches[2][blocks];

  FT_HOST_DEVICE static int block_of(float u, float v, int width, int height) {
    int const column = clamp(static_cast<int>(u) * columns / max_of(width, 1), 0, columns - 1);
    int const row = clamp(static_cast<int>(v) * rows / max_of(height, 1), 0, rows - 1);
    return row * columns + column;
  }
  /// Whether a set has most matches of a block.
  FT_HOST_DEVICE bool leads(int set, int block) const {
    return matches[set][block] > matches[1 - set][block];
  }
};

/// Item: a camera.
template <typename Rig>
struct split_motions_of_frame {
  static constexpr bool wide_on_host = true;
  /// Parameters that functions refer to. References to those of a kernel would make each thread of
  /// each launch copy them.
  struct inputs {
    motions_of_frames<Rig> frames;
    windowless_workspace work;
  };
  struct scratch {
    pose_scratch pose;
    two_places places;
    rigid<double> T[2];
    alignas(inputs) unsigned char parameters[sizeof(inputs)];
  };
  pose_params params;
  pose_limits limits = pose_limits::of(params);

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, motions_of_frames<Rig> const& frames,
                                 odometry_state_view const& state,
                                 windowless_workspace const& work) const {
    camera_track& t = state.tracks[b];
    bool const wanted = is_wanted(t) && frames.observations.count[b] >= 2 * least;
    g.sync();
    if (g.rank() == 0) { t.facts.apart = 0; }
    if (!wanted) { return; }
    inputs& kept = *reinterpret_cast<inputs*>(s.parameters);
    if (g.rank() == 0) { kept = {frames, work}; }
    g.sync();
    motions_of_frames<Rig> const& in = kept.frames;
    frame_observations const of{in, b, busiest(g, b, in), kept.work};
    int const chosen = find_two(g, s, of, t);
    if (chosen >= 0) {
      if (choose(g, s, of, chosen)) { forget_depths(g, s, of, chosen); }
      if (g.rank() == 0) { note(s, of, t, chosen); }
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
  static constexpr int least = 20;       ///< matches of a motion
  static constexpr int near = 4;         ///< squared error, in eighths of a variance, of a match
                                         ///< that agrees with a motion
  static constexpr int distant = 2 * 8;  ///< and of one that does not
  static constexpr int most = 6 * 8;     ///< of one that may belong to a motion
  /// Errors that neighbours share, in 1 / 1024 of their variance: from where a pose is in doubt
  /// (warning_limits::common_errors). Depths that are off in a part of the images share less.
  static constexpr int shared = 256;
  static constexpr int steps = 4;
  static constexpr std::int64_t lasting_ns = 1000000000;

  using drawn = seen_matches<Rig, near>;
  using distant_matches = seen_matches<Rig, 64 * 8>;

  FT_HOST_DEVICE static bool is_wanted(camera_track const& t) {
    if (t.plan == search_plan::nothing || t.lost_frames > 0) { return false; }
    return is_lately(t) || t.facts.common > shared;
  }
  FT_HOST_DEVICE static bool is_lately(camera_track const& t) {
    return t.apart != 0 && t.time_ns - t.apart_ns <= lasting_ns;
  }

  /// The observations of a camera.
  struct frame_observations {
    motions_of_frames<Rig> const& in;
    int b;
    int camera;
    windowless_workspace const& work;

    FT_HOST_DEVICE int count() const { return in.observations.count[b]; }
    FT_HOST_DEVICE std::ptrdiff_t first() const {
      return static_cast<std::ptrdiff_t>(b) * in.observations.capacity;
    }
    FT_HOST_DEVICE observation const& at(int i) const { return in.observations.items[first() + i]; }
    FT_HOST_DEVICE observation* list() const {
      return work.matches + static_cast<std::ptrdiff_t>(b) * in.frame.numbers();
    }
    FT_HOST_DEVICE proposal_refinement& refined() const { return work.refined[b]; }
    /// Squared error of a pose of the body, in eighths of a variance.
    FT_HOST_DEVICE int error(rigid<double> const& T_bw, observation const& o) const {
      distant_matches const m{in.rig, Rig::rectified ? o.camera : camera, nullptr, 0};
      auto const T_cw = m.of_camera(T_bw.template cast<strict_double>());
      return m.error(T_cw.template cast<strict_float>(), o);
    }
    /// Lists those of the camera that are wanted, in their order. @return their number
    template <typename Group, typename Wanted>
    FT_HOST_DEVICE int keep(Group g, Wanted const& wanted) const {
      g.sync();
      int n = 0;
      for (int base = 0; base < count(); base += g.size()) {
        int const i = base + g.rank();
        bool const is = i < count() && at(i).camera == camera && wanted(at(i));
        int here = 0;
        int const place = n + g.exclusive_count(is, here);
        if (is) { list()[place] = at(i); }
        n += here;
      }
      g.sync();
      return n;
    }
  };

  /// What later frames need to know. A thread's part.
  FT_HOST_DEVICE static void note(scratch const& s, frame_observations const& of, camera_track& t,
                                  int chosen) {
    t.facts.apart = 0;
    t.apart_blocks = 0;
    for (int i = 0; i < two_places::blocks; ++i) {
      t.facts.apart += s.places.matches[1 - chosen][i];
      t.apart_blocks |= static_cast<std::uint64_t>(s.places.leads(1 - chosen, i)) << i;
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
    return free >= least && free > 2 * held ? free : 0;
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

  /// Finds two motions. @return which of s.T is that of the camera; -1: there is one motion
  template <typename Group>
  FT_HOST_DEVICE int find_two(Group g, scratch& s, frame_observations const& of,
                              camera_track const& t) const {
    auto const seed = static_cast<std::uint64_t>(t.time_ns);
    int const n = of.keep(g, [](observation const&) { return true; });
    if (!find(g, s, of, n, {mixed_bits(seed + 2)}, 0)) { return -1; }
    int const left =
        of.keep(g, [&](observation const& o) { return !(of.error(s.T[0], o) < distant); });
    bool const found = find(g, s, of, left, {mixed_bits(seed + 3)}, 1) && part(g, s, of);
    return found ? weigh(g, s, of, n) : -1;
  }

  /// Which motion is that of the camera: the one whose matches lie in more parts of the image. A
  /// motion is one that has parts of the image for itself: matches that agree with nothing else are
  /// scattered where they come from errors.
  /// @param n matches @return -1: too few are where one motion leads and agree with it alone
  template <typename Group>
  FT_HOST_DEVICE static int weigh(Group g, scratch& s, frame_observations const& of, int n) {
    count_places(g, s, of);
    int own[2] = {}, blocks[2] = {};
    for (int i = 0; i < two_places::blocks; ++i) {
      for (int k = 0; k < 2; ++k) {
        bool const leads = s.places.leads(k, i);
        own[k] += leads ? s.places.matches[k][i] : 0;
        blocks[k] += static_cast<int>(leads);
      }
    }
    if (min_of(own[0], own[1]) < max_of(least, n / 16)) { return -1; }
    return blocks[1] > blocks[0] || (blocks[1] == blocks[0] && own[1] > own[0]) ? 1 : 0;
  }

  /// Finds the pose that most of the n listed matches agree with closely, and optimises it by
  /// these. @param k which of s.T gets it
  template <typename Group>
  FT_HOST_DEVICE bool find(Group g, scratch& s, frame_observations const& of, int n,
                           counter_draws const& draws, int k) const {
    if (n < least) { return false; }
    if (!draw_pose(g, drawn{of.in.rig, of.camera, of.list(), n}, draws, s.T[k])) { return false; }
    auto const others = [&](observation const& o) {
      return k == 0 || !(of.error(s.T[0], o) < distant);
    };
    int const agree =
        of.keep(g, [&](observation const& o) { return others(o) && of.error(s.T[k], o) < near; });
    if (agree < least) { return false; }
    optimize(g, s, of, agree, s.T[k], nullptr);
    if (g.rank() == 0) {
      s.T[k] = of.refined()
                   .T_cw.template cast<strict_double>()
                   .orthonormalized()
                   .template cast<double>();
    }
    g.sync();
    return true;
  }

  /// Improves both poses, each by the matches that agree with it better than with the other one: a
  /// pose between two motions agrees with many matches of both.
  template <typename Group>
  FT_HOST_DEVICE bool part(Group g, scratch& s, frame_observations const& of) const {
    FT_NO_UNROLL
    for (int step = 0; step < 2 * steps; ++step) {
      int const k = step % 2 == 0 ? 1 : 0;
      int const n = of.keep(g, [&](observation const& o) {
        int const e = of.error(s.T[k], o);
        return e < most && e < of.error(s.T[1 - k], o);
      });
      if (n < least) { return false; }
      optimize(g, s, of, n, s.T[k], nullptr);
      if (g.rank() == 0) {
        s.T[k] = of.refined()
                     .T_cw.template cast<strict_double>()
                     .orthonormalized()
                     .template cast<double>();
      }
      g.sync();
    }
    return true;
  }

  /// Optimises a pose by the n listed matches; of.refined() has it.
  template <typename Group>
  FT_HOST_DEVICE void optimize(Group g, scratch& s, frame_observations const& of, int n,
                               rigid<double> const& from, float* information) const {
    proposal_refinement& to = of.refined();
    if (g.rank() == 0) { to.start = from.template cast<float>(); }
    g.sync();
    unsigned char* const outlier =
        of.work.outlier + static_cast<std::ptrdiff_t>(of.b) * of.in.frame.numbers();
    pose_problem const problem{of.list(), n,           &to.start,  &to.T_cw,
                               outlier,   &to.inliers, information};
    pose_solver<Group, Rig> const solver{g, s.pose, of.in.rig, problem, params, limits};
    FT_NO_UNROLL
    for (int i = g.rank(); i < n; i += g.size()) { solver.prepare(i, problem.observations[i]); }
    solver.solve();
    g.sync();
  }

  /// Counts the matches that agree with one motion and not with the other, by parts of the image.
  template <typename Group>
  FT_HOST_DEVICE static void count_places(Group g, scratch& s, frame_observations const& of) {
    for (int i = g.rank(); i < 2 * two_places::blocks; i += g.size()) {
      s.places.matches[i / two_places::blocks][i % two_places::blocks] = 0;
    }
    g.sync();
    for (int i = g.rank(); i < of.count(); i += g.size()) {
      observation const o = of.at(i);
      if (o.camera != of.camera) { continue; }
      int const e[2] = {of.error(s.T[0], o), of.error(s.T[1], o)};
      for (int k = 0; k < 2; ++k) {
        if (e[k] < 2 * near && !(e[1 - k] < distant)) {
          atomic_add(&s.places.matches[k][two_places::block_of(o.u, o.v, of.in.geometry.width[0],
                                                               of.in.geometry.height[0])],
                     1);
        }
      }
    }
    g.sync();
  }

  /// The frame's pose is that of the chosen motion, by the matches that agree with it better than
  /// with the other one. The others release their points. @return false, and nothing is changed,
  /// where most of the chosen ones were left out for the pose before, so that their points are
  /// held no more
  template <typename Group>
  FT_HOST_DEVICE bool choose(Group g, scratch& s, frame_observations const& of, int chosen) const {
    motions_of_frames<Rig> const& in = of.in;
    rigid<double> const& T = s.T[chosen];
    rigid<double> const& other = s.T[1 - chosen];
    auto const agrees_better = [&](observation const& o) {
      int const e = of.error(T, o);
      return e < most && e < of.error(other, o);
    };
    int held = 0;
    for (int i = g.rank(); i < of.count(); i += g.size()) {
      observation const o = of.at(i);
      bool const is = o.camera == of.camera && in.observations.outlier[of.first() + i] == 0;
      held += static_cast<int>(is && agrees_better(o));
    }
    held = g.reduce(held, sum_op{});
    int const n = of.keep(g, agrees_better);
    if (held < max_of(least, n / 2)) { return false; }
    optimize(g, s, of, n, T, in.information + of.b * information_terms);
    if (g.rank() == 0) {
      in.T_cw[of.b] = of.refined().T_cw;
      s.T[chosen] = of.refined()
                        .T_cw.template cast<strict_double>()
                        .orthonormalized()
                        .template cast<double>();
    }
    g.sync();
    int* const holder = in.frame.holder + static_cast<std::ptrdiff_t>(of.b) * in.frame.numbers();
    int kept = 0;
    for (int i = g.rank(); i < of.count(); i += g.size()) {
      std::ptrdiff_t const at = of.first() + i;
      observation const o = of.at(i);
      int const e = of.error(s.T[chosen], o);
      // What is far agrees with both. Of two cameras that are not rectified the other one is not
      // asked.
      bool const asked = Rig::rectified || o.camera == of.camera;
      bool const agrees = !asked || e < distant || (e < most && e < of.error(other, o));
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
  FT_HOST_DEVICE static void forget_depths(Group g, scratch const& s, frame_observations const& of,
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
      if (s.places.leads(1 - chosen, block_of(in, kp, k))) { depth[k] = -1.0f; }
    }
  }
};

}  // namespace detail

/// Of frames that follow one whose errors neighbours shared, or that had two motions within a
/// second: looks for two poses that many matches agree with each, and not with the other one. The
/// frame keeps the one whose matches lie in more parts of the image. Where the other one was, it
/// is told of until most of what has a depth holds points again. Asynchronous on `exec`;
/// allocates nothing; one launch.
template <typename Exec, typename Rig>
void split_motions(Exec const& exec, motions_of_frames<Rig> const& in,
                   odometry_state_view const& state, windowless_workspace const& work,
                   pose_params const& params = {}) {
  for_each_item<per_block<sum_lanes>>(exec, in.frame.batch,
                                      detail::split_motions_of_frame<Rig>{params}, in, state, work);
}

}  // namespace FT_ABI
}  // namespace ft
