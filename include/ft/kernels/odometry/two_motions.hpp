// SPDX-License-Identifier: Apache-2.0
/// @file Two poses that many of a frame's matches agree with each.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/counter_draws.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/odometry/match_without_window.hpp"
#include "ft/kernels/pnp/draw_pose.hpp"
#include "ft/kernels/pose/optimize_pose.hpp"
#include "ft/kernels/pose/pose_problem.hpp"
#include "ft/types/poses.hpp"

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
  pyramid_geometry geometry{};   ///< of the images
  float const* moves = nullptr;  ///< as in frames_in_map, which made the observations
};

namespace detail {

/// How many matches make a motion, and which ones agree with it: squared errors, in eighths of a
/// variance.
struct motion_limits {
  static constexpr int least = 20;       ///< matches of a motion
  static constexpr int near = 4;         ///< of a match that agrees
  static constexpr int distant = 2 * 8;  ///< and of one that does not
  static constexpr int most = 6 * 8;     ///< of one that may belong to a motion
};

/// Which parts of an image two sets of matches are in.
struct two_places {
  static constexpr int columns = 8, rows = 6;
  static constexpr int blocks = columns * rows;
  static constexpr int one = 1024;  ///< of nearness
  int matches[2][blocks];
  int nearness[2][blocks];  ///< sums of their inverse distances, in 1 / one of the map's unit

  FT_HOST_DEVICE static int block_of(float u, float v, int width, int height) {
    int const column = clamp(static_cast<int>(u) * columns / max_of(width, 1), 0, columns - 1);
    int const row = clamp(static_cast<int>(v) * rows / max_of(height, 1), 0, rows - 1);
    return row * columns + column;
  }
  /// Whether a set has most matches of a block.
  FT_HOST_DEVICE bool leads(int set, int block) const {
    return matches[set][block] > matches[1 - set][block];
  }
  /// Adds a match. Of several threads at once. @param distance from the camera
  FT_HOST_DEVICE void add(int set, int block, strict_double distance) {
    constexpr int most = 32 * one;
    strict_double const inverse = strict_double(one) / distance;
    bool const fits = inverse < strict_double(most);
    atomic_add(&matches[set][block], 1);
    atomic_add(&nearness[set][block], fits ? static_cast<int>(inverse.value) : most);
  }
  /// Which set is behind the other one: the other one's matches are nearer where both sets meet, in
  /// three times as many places as the other way round, and in three at least. What moves before
  /// the scene hides it. @return -1: neither is
  FT_HOST_DEVICE int behind() const {
    int places[2] = {};  // where a set is in front
    for (int i = 0; i < blocks; ++i) {
      bool const right = i % columns + 1 < columns, below = i + columns < blocks;
      for (int k = 0; k < 2; ++k) {
        places[k] += static_cast<int>(is_nearer(k, i, i));
        places[k] += static_cast<int>(right && is_nearer(k, i, i + 1));
        places[k] += static_cast<int>(right && is_nearer(k, i + 1, i));
        places[k] += static_cast<int>(below && is_nearer(k, i, i + columns));
        places[k] += static_cast<int>(below && is_nearer(k, i + columns, i));
      }
    }
    int const front = places[1] > places[0] ? 1 : 0;
    return places[front] >= max_of(3, 3 * places[1 - front]) ? 1 - front : -1;
  }

private:
  /// Whether a set's matches of a part are nearer by an eighth than the other one's of another.
  FT_HOST_DEVICE bool is_nearer(int set, int block, int other) const {
    int const mine = matches[set][block], theirs = matches[1 - set][other];
    return min_of(mine, theirs) >= 2 && 8 * std::int64_t{nearness[set][block]} * theirs >
                                            9 * std::int64_t{nearness[1 - set][other]} * mine;
  }
};

/// The observations of a camera.
template <typename Rig>
struct frame_observations {
  using matches_of_camera = seen_matches<Rig, 64 * 8>;

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
    matches_of_camera const m{in.rig, Rig::rectified ? o.camera : camera, nullptr, 0};
    auto const T_cw = m.of_camera(T_bw.template cast<strict_double>());
    return m.error(T_cw.template cast<strict_float>(), o);
  }
  /// Distance of a match's point from the camera, in the map's unit.
  FT_HOST_DEVICE strict_double distance(rigid<double> const& T_bw, observation const& o) const {
    matches_of_camera const m{in.rig, Rig::rectified ? o.camera : camera, nullptr, 0};
    auto const T_cw = m.of_camera(T_bw.template cast<strict_double>());
    auto const p = T_cw * o.point.template cast<strict_double>();
    return scalar::sqrt(dot(p, p));
  }
  /// Which observation an entry of the list is. The search without a window is over.
  FT_HOST_DEVICE int& place(int listed) const {
    return work.keypoint_of[static_cast<std::ptrdiff_t>(b) * in.frame.numbers() + listed];
  }
  /// Whether the keypoint of a listed observation was moved to its point's patch.
  FT_HOST_DEVICE bool is_aligned(int listed) const {
    return in.moves != nullptr && in.moves[static_cast<std::ptrdiff_t>(b) * in.frame.numbers() +
                                           in.observations.number[first() + place(listed)]] >= 0;
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
      int const next = n + g.exclusive_count(is, here);
      if (is) {
        list()[next] = at(i);
        place(next) = i;
      }
      n += here;
    }
    g.sync();
    return n;
  }
};

/// Looks for two motions in the matches of a camera.
template <typename Rig>
struct motion_search {
  /// Working memory, shared by the threads.
  struct scratch {
    pose_scratch pose;
    two_places places;
    rigid<double> T[2];  ///< of the body
  };
  pose_params params;
  pose_limits limits = pose_limits::of(params);

  using of_frame = frame_observations<Rig>;

  /// Finds two poses, and counts by parts of the image what agrees with one of them only.
  /// @param seed of the draws @return number of the camera's matches; 0: there are no two
  template <typename Group>
  FT_HOST_DEVICE int find_two(Group g, scratch& s, of_frame const& of, std::uint64_t seed) const {
    int const n = of.keep(g, [](observation const&) { return true; });
    if (!find(g, s, of, n, {mixed_bits(seed + 2)}, 0)) { return 0; }
    int const left =
        of.keep(g, [&](observation const& o) { return !(of.error(s.T[0], o) < limit::distant); });
    if (!find(g, s, of, left, {mixed_bits(seed + 3)}, 1) || !part(g, s, of)) { return 0; }
    count_places(g, s, of);
    return n;
  }

  /// Optimises s.T[k] by the n listed matches; of.refined() has it, too.
  /// @param information as in pose_problem, of the frame's pose, whose last round has a robust loss
  /// for keypoints that were moved; null: of a pose that is compared
  template <typename Group>
  FT_HOST_DEVICE void improve(Group g, scratch& s, of_frame const& of, int n, int k,
                              float* information = nullptr) const {
    proposal_refinement& to = of.refined();
    if (g.rank() == 0) { to.start = s.T[k].template cast<float>(); }
    g.sync();
    unsigned char* const outlier =
        of.work.outlier + static_cast<std::ptrdiff_t>(of.b) * of.in.frame.numbers();
    bool const last = information != nullptr;
    pose_problem const problem{of.list(),   n,           &to.start, &to.T_cw, outlier,
                               &to.inliers, information, nullptr,   nullptr,  last};
    pose_solver<Group, Rig> const solver{g, s.pose, of.in.rig, problem, params, limits};
    FT_NO_UNROLL
    for (int i = g.rank(); i < n; i += g.size()) {
      solver.prepare(i, problem.observations[i], last && of.is_aligned(i));
    }
    solver.solve();
    g.sync();
    if (g.rank() == 0) {
      s.T[k] = to.T_cw.template cast<strict_double>().orthonormalized().template cast<double>();
    }
    g.sync();
  }

private:
  using limit = motion_limits;
  using drawn = seen_matches<Rig, limit::near>;
  static constexpr int steps = 4;

  /// Finds the pose that most of the n listed matches agree with closely, and optimises it by
  /// these. @param k which of s.T gets it
  template <typename Group>
  FT_HOST_DEVICE bool find(Group g, scratch& s, of_frame const& of, int n,
                           counter_draws const& draws, int k) const {
    if (n < limit::least) { return false; }
    if (!draw_pose(g, drawn{of.in.rig, of.camera, of.list(), n}, draws, s.T[k])) { return false; }
    auto const others = [&](observation const& o) {
      return k == 0 || !(of.error(s.T[0], o) < limit::distant);
    };
    int const agree = of.keep(
        g, [&](observation const& o) { return others(o) && of.error(s.T[k], o) < limit::near; });
    if (agree < limit::least) { return false; }
    improve(g, s, of, agree, k);
    return true;
  }

  /// Improves both poses, each by the matches that agree with it better than with the other one: a
  /// pose between two motions agrees with many matches of both.
  template <typename Group>
  FT_HOST_DEVICE bool part(Group g, scratch& s, of_frame const& of) const {
    FT_NO_UNROLL
    for (int step = 0; step < 2 * steps; ++step) {
      int const k = step % 2 == 0 ? 1 : 0;
      int const n = of.keep(g, [&](observation const& o) {
        int const e = of.error(s.T[k], o);
        return e < limit::most && e < of.error(s.T[1 - k], o);
      });
      if (n < limit::least) { return false; }
      improve(g, s, of, n, k);
    }
    return true;
  }

  /// Counts the matches that agree with one motion and not with the other, by parts of the image.
  template <typename Group>
  FT_HOST_DEVICE static void count_places(Group g, scratch& s, of_frame const& of) {
    for (int i = g.rank(); i < 2 * two_places::blocks; i += g.size()) {
      s.places.matches[i / two_places::blocks][i % two_places::blocks] = 0;
      s.places.nearness[i / two_places::blocks][i % two_places::blocks] = 0;
    }
    g.sync();
    for (int i = g.rank(); i < of.count(); i += g.size()) {
      observation const o = of.at(i);
      if (o.camera != of.camera) { continue; }
      int const e[2] = {of.error(s.T[0], o), of.error(s.T[1], o)};
      for (int k = 0; k < 2; ++k) {
        if (e[k] < 2 * limit::near && !(e[1 - k] < limit::distant)) {
          int const block =
              two_places::block_of(o.u, o.v, of.in.geometry.width[0], of.in.geometry.height[0]);
          s.places.add(k, block, of.distance(s.T[k], o));
        }
      }
    }
    g.sync();
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
