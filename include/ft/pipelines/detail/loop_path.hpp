// SPDX-License-Identifier: Apache-2.0
/// @file The path of a camera by its keyframes, and its loops.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ft/containers/loop_archive.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/loops/match_keyframes.hpp"
#include "ft/math/positive_definite.hpp"
#include "ft/types/loops.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

inline similarity<double> with_scale(rigid<double> const& T, double scale = 1) {
  return {T.R, T.t, scale};
}
/// The pose of what has a unit of its own.
inline rigid<double> without_scale(similarity<double> const& T) { return {T.R, T.t}; }

/// A keyframe on the path.
struct path_keyframe {
  int row = 0;   ///< of the archive
  int map = 0;   ///< number of the map that it was tracked in
  int part = 0;  ///< that of the first map that loops have joined with it
  std::int64_t time_ns = 0;
  /// Length of the way from the keyframe before, in the odometry's unit; 0 to the first of a map.
  double step = 0;
  rigid<double> T_odom_camera = rigid<double>::identity();
  /// Its scale is that of the odometry's unit there.
  similarity<double> T_world_camera = similarity<double>::identity();
  double information[21] = {};  ///< of the edge from the keyframe before, if that has its map
  int steps = 1;                ///< that the edge takes the place of: each is as uncertain
  bool loaded = false;          ///< it came with a file
  bool again = false;           ///< it sees what an older one saw first
};

/// A keyframe seen from another one.
struct path_loop {
  int from = 0;  ///< index of a keyframe
  int to = 0;    ///< index of a later one
  similarity<double> T_from_to = similarity<double>::identity();
  double information[21] = {};   ///< of rotation and translation
  double scale_information = 0;  ///< of the logarithm of the scale
  int inliers = 0;               ///< matches that agree with it
};

/// Keyframes in the order of their time, and loops between them. Copies allocate nothing between
/// two that have reserved as much.
struct loop_path {
  bool scaled = false;  ///< the odometry's unit drifts; else all scales are 1
  std::vector<path_keyframe> keyframes;
  std::vector<path_loop> loops;
  std::vector<path_loop> joints;  ///< to other parts, that wait for another one that agrees
  vec3<double> gravity{0, 0, 0};  ///< in the world, of any length; 0 = not known
  /// Of the next step of an optimisation that goes on, as pose_graph_params::first_damping; 0 = it
  /// has ended.
  double damping = 0;
  int beside = -1;  ///< keyframe that the next one is to be tied to; -1 = it follows the newest one

  /// @param most keyframes @param found loops to a keyframe, at most
  void reserve(int most, int found) {
    keyframes.reserve(static_cast<std::size_t>(most));
    loops.reserve(static_cast<std::size_t>(most) *
                  static_cast<std::size_t>(std::max(found, most_thinned)));
    joints.reserve(most_joints);
    now_.reserve(static_cast<std::size_t>(most));
    held_.reserve(static_cast<std::size_t>(most));
  }
  void clear() {
    keyframes.clear();
    loops.clear();
    joints.clear();
    gravity = {0, 0, 0};
    damping = 0;
    beside = -1;
  }
  int size() const { return static_cast<int>(keyframes.size()); }
  int most_loops() const { return static_cast<int>(loops.capacity()); }  ///< that are reserved
  path_keyframe const& at(int i) const { return keyframes[static_cast<std::size_t>(i)]; }
  /// From the frame of the odometry to the world, as the newest keyframe says.
  similarity<double> T_world_odom() const {
    return keyframes.empty() ? similarity<double>::identity() : T_world_odom(size() - 1);
  }
  /// The same as keyframe i says.
  similarity<double> T_world_odom(int i) const {
    auto const& k = at(i);
    return (k.T_world_camera * with_scale(k.T_odom_camera.inverse())).orthonormalized();
  }

  /// What a caller is told of it.
  void list(std::vector<placed_keyframe>& to) const {
    for (path_keyframe const& k : keyframes) {
      to.push_back({k.time_ns, k.part, k.T_odom_camera, without_scale(k.T_world_camera),
                    k.T_world_camera.scale, k.loaded});
    }
  }
  void list(std::vector<closed_loop>& to) const {
    for (path_loop const& l : loops) {
      to.push_back({l.from, l.to, at(l.from).time_ns, at(l.to).time_ns, without_scale(l.T_from_to),
                    l.T_from_to.scale, l.inliers});
    }
  }

  /// Length of the way from a keyframe to a later one, metres, as scales are known now.
  double way(int from, int to) const {
    double sum = 0;
    for (int i = from + 1; i <= to; ++i) { sum += at(i).T_world_camera.scale * at(i).step; }
    return sum;
  }
  /// Whether a loop fits the path: what it corrects is no more than the odometry may have drifted
  /// since, and as much more as a scale that has drifted explains. @param baseline of the rig,
  /// metres, which a loop may correct anyway
  bool fits(path_loop const& loop, loop_params const& params, double baseline) const {
    path_keyframe const& from = at(loop.from);
    path_keyframe const& to = at(loop.to);
    if (from.part != to.part || !is_scale(loop)) { return false; }
    auto const off = to.T_world_camera.inverse() * (from.T_world_camera * loop.T_from_to);
    double const way = this->way(loop.from, loop.to);
    double const scaled_by = std::abs(std::log(off.scale));
    double const drift = static_cast<double>(params.max_drift) + scaled_by;
    return to.T_world_camera.scale * length(off.t) <= drift * way + baseline &&
           scaled_by <= static_cast<double>(params.max_scale_drift) &&
           angle(off.R) <= static_cast<double>(params.max_turn) + 0.01 * way;
  }
  /// Whether a loop tells where a keyframe of the same map is better than the odometry does: so
  /// much as that may have drifted. Views from far apart, and few matches, do not on a short way.
  /// Of another map, or the one of a file, the odometry knows nothing.
  bool tells(path_loop const& loop, loop_params const& params) const {
    path_keyframe const& from = at(loop.from);
    path_keyframe const& to = at(loop.to);
    if (from.map != to.map || from.loaded != to.loaded) { return true; }
    double covariance[36];  // of translation, then rotation
    if (!invert_6(loop.information, covariance)) { return false; }
    double const drift = static_cast<double>(params.max_drift) +
                         (scaled ? static_cast<double>(params.max_scale_drift) : 0.0);
    double const variance = covariance[0] + covariance[7] + covariance[14];
    return to.T_world_camera.scale * std::sqrt(optimism * variance) <=
           drift * way(loop.from, loop.to);
  }
  /// Whether a loop is between views that differ by no more than `most_turned`, rad, of what they
  /// see: matches of others err alike, by more than the loop's information says.
  static bool is_alike(path_loop const& loop) {
    auto const apart = loop.T_from_to.inverse().t;
    double const(&I)[21] = loop.information;
    // A turn moves a point as its distance times the turn does.
    double const shifted = I[0] + I[6] + I[11], turned = (I[15] + I[18] + I[20]) / 4;
    return dot(apart, apart) * shifted <= most_turned * most_turned * turned;
  }
  /// What the path knows of the motion between two keyframes of a part: it is off by no more than
  /// fits() lets a loop correct. Not of a scaled one, in whose units rows are.
  loop_bound bound(int from, int to, loop_params const& params, double baseline) const {
    double const way = this->way(from, to);
    auto const T = (at(to).T_world_camera.inverse() * at(from).T_world_camera).orthonormalized();
    return {without_scale(T).template cast<float>(),
            static_cast<float>(static_cast<double>(params.max_drift) * way + baseline),
            static_cast<float>(static_cast<double>(params.max_turn) + 0.01 * way)};
  }
  /// Units of the first map that one of another map is at most, and the same of their inverse: each
  /// begins with a median depth of 1, and scenes are not 100 times as deep as others.
  static constexpr double most_scale = 100;
  /// Whether the keyframe that a loop leads to has such a unit.
  bool is_scale(path_loop const& loop) const {
    double const scale = at(loop.from).T_world_camera.scale * loop.T_from_to.scale;
    return scale >= 1 / most_scale && scale <= most_scale;
  }
  /// The newest keyframes of the part of the last one, at most so many.
  int newest(int most) const {
    int n = 0;
    while (n < most && n < size() && at(size() - 1 - n).part == keyframes.back().part) { ++n; }
    return n;
  }
  /// Whether two loops to a keyframe cannot both be right: they place it farther apart than the
  /// path may have drifted in between, with as much more as their scales differ by, and than half
  /// the distance between the keyframes that they are from; or turned so, or with such a scale. Of
  /// different parts it is not known.
  bool contradict(path_loop const& a, path_loop const& b, loop_params const& params,
                  double baseline) const {
    path_keyframe const& from_a = at(a.from);
    path_keyframe const& from_b = at(b.from);
    if (from_a.part != from_b.part) { return false; }
    double const way = this->way(std::min(a.from, b.from), std::max(a.from, b.from));
    auto const placed_a = from_a.T_world_camera * a.T_from_to;
    auto const placed_b = from_b.T_world_camera * b.T_from_to;
    double const scaled_by = std::abs(std::log(placed_a.scale / placed_b.scale));
    double const drift = static_cast<double>(params.max_drift) + scaled_by;
    double const apart = length(from_a.T_world_camera.t - from_b.T_world_camera.t);
    double const turned = angle(from_a.T_world_camera.R.transposed() * from_b.T_world_camera.R);
    return length(placed_a.t - placed_b.t) > std::max(drift * way + baseline, 0.5 * apart) ||
           scaled_by > static_cast<double>(params.max_scale_drift) ||
           angle(placed_a.R.transposed() * placed_b.R) >
               std::max(static_cast<double>(params.max_turn) + 0.01 * way, 0.5 * turned);
  }
  /// Whether two loops say the same of the pose of the part that they lead to, which is that of one
  /// of its keyframes where they lead to the same: their difference is likely with
  /// `optimism` times the covariance of either.
  bool agree(path_loop const& a, path_loop const& b) const {
    auto const from_a = at(a.from).T_world_camera * a.T_from_to;
    auto const from_b = at(b.from).T_world_camera * b.T_from_to *
                        at(b.to).T_world_camera.inverse() * at(a.to).T_world_camera;
    auto const off = from_a.inverse() * from_b;
    double const log_scale = std::log(off.scale);
    auto const chi2 = [&](path_loop const& of) {
      double e[6];
      edge_error(without_scale(off), e);
      double sum = of.scale_information * log_scale * log_scale;
      for (int i = 0, k = 0; i < 6; ++i) {
        for (int j = i; j < 6; ++j) { sum += (i == j ? 1 : 2) * of.information[k++] * e[i] * e[j]; }
      }
      return sum / optimism;
    };
    double const likely = scaled ? 24.32 : 22.46;  // 99.9 % of 7 and 6 degrees of freedom
    return chi2(a) < likely && chi2(b) < likely;
  }

  /// Adds a loop: the keyframe that it leads to sees a place again.
  void add(path_loop const& loop) {
    keyframes[static_cast<std::size_t>(loop.to)].again = true;
    loops.push_back(loop);
  }
  /// Ties a keyframe that follows to keyframe `beside`, beside which its place is known: as of the
  /// newest one nothing is known of their motion. @param inliers of its pose
  void tie(int inliers, path_keyframe& k) {
    path_loop l;
    l.from = beside;
    l.to = size();
    l.inliers = inliers;
    l.T_from_to = (at(beside).T_world_camera.inverse() * k.T_world_camera).orthonormalized();
    std::copy(k.information, k.information + 21, l.information);
    l.scale_information = 1e4;  // 1 %
    loops.push_back(l);
    k.part = at(beside).part;
    k.step = 0;
    k.again = true;
    for (int i = 0, n = 0; i < 6; ++i) {
      for (int j = i; j < 6; ++j) { k.information[n++] = i == j ? 1e-6 : 0; }
    }
    beside = -1;
  }

  /// A loop to another part waits until one of another keyframe agrees with it; then the parts are
  /// joined: the later one moves to where they say, and both loops are kept.
  /// @return how many loops are kept
  int join(path_loop const& loop) {
    if (!is_scale(loop)) { return 0; }
    int const from = at(loop.from).part, to = at(loop.to).part;
    auto const of_both = [&](path_loop const& l) {
      return at(l.from).part == from && at(l.to).part == to;
    };
    for (path_loop const& other : joints) {
      if (!of_both(other) || other.to == loop.to || !agree(loop, other)) { continue; }
      path_loop const first = other;
      auto const moved =
          at(loop.from).T_world_camera * loop.T_from_to * at(loop.to).T_world_camera.inverse();
      for (path_keyframe& k : keyframes) {
        if (k.part != to) { continue; }
        k.part = from;
        k.T_world_camera = (moved * k.T_world_camera).orthonormalized();
      }
      joints.clear();
      add(first);
      add(loop);
      return 2;
    }
    if (joints.size() == most_joints) { joints.erase(joints.begin()); }
    joints.push_back(loop);
    return 0;
  }

  /// Of the older three quarters every second keyframe of a map leaves, of those that see a place
  /// again: what is new later stays tied to what saw a place first, else errors would add up lap by
  /// lap. Where an eighth would not leave so, every second of all; where that is not enough, for
  /// maps have one keyframe each, the older half. Loops of one that leaves become those of the
  /// keyframe before it, of which each keeps four. Allocates nothing. @param freed gets the rows of
  /// those that leave
  template <typename Freed>
  void thin(Freed const& freed) {
    joints.clear();
    note_what_sees_again();
    if (8 * number_those_that_stay(true) > 7 * size() &&
        8 * number_those_that_stay(false) > 7 * size()) {
      for (int i = 0; i < size(); ++i) {
        now_[static_cast<std::size_t>(i)] = std::max(i - size() / 2, -1);
      }
    }
    move_loops();
    if (beside >= 0) { beside = number(beside); }
    move_keyframes(freed);
  }

private:
  /// Those between two of their map that see a place again, next to them or one farther, do so,
  /// too: a search may find nothing, and runs for the newest one alone.
  void note_what_sees_again() {
    for (int i = 0; i < size(); ++i) {
      auto const sees = [&](int k) {
        return k >= 0 && k < size() && at(k).again && at(k).map == at(i).map;
      };
      bool const between = (sees(i - 1) || sees(i - 2)) && (sees(i + 1) || sees(i + 2));
      if (between) { keyframes[static_cast<std::size_t>(i)].again = true; }
    }
  }
  /// @param again those that leave see a place again @return how many stay
  int number_those_that_stay(bool again) {
    now_.assign(keyframes.size(), 0);
    int kept = 0;
    bool left = false;
    for (int i = 0; i < size(); ++i) {
      left = (at(i).again || !again) && i > 0 && i < size() * 3 / 4 && !left &&
             at(i).map == at(i - 1).map;
      now_[static_cast<std::size_t>(i)] = left ? kept - 1 : kept;
      kept += left ? 0 : 1;
    }
    return kept;
  }
  /// Loops of keyframes that leave become those of the keyframe that stands for them.
  void move_loops() {
    for (path_loop& l : loops) {
      if (number(l.from) < 0 || number(l.to) < 0) { continue; }
      l.T_from_to = motion(stand_in(l.from), l.from) * l.T_from_to * motion(l.to, stand_in(l.to));
    }
    for (path_loop& l : loops) {
      l.from = number(l.from);
      l.to = number(l.to);
    }
    held_.assign(keyframes.size(), 0);
    loops.erase(std::remove_if(loops.begin(), loops.end(),
                               [this](path_loop const& l) {
                                 return l.from < 0 || l.to < 0 || l.from == l.to ||
                                        ++held_[static_cast<std::size_t>(l.to)] > most_thinned;
                               }),
                loops.end());
  }
  template <typename Freed>
  void move_keyframes(Freed const& freed) {
    int kept = 0, steps = 0, map = -1;
    double step = 0;  ///< in the unit of `map`
    for (int i = 0; i < size(); ++i) {
      if (!stays(i)) {
        freed(at(i).row);
        steps = number(i) < 0 ? 0 : at(i).steps;
        step = number(i) < 0 ? 0 : at(i).step;
        map = at(i).map;
        continue;
      }
      path_keyframe k = at(i);
      k.steps += steps;
      if (k.map == map) { k.step += step; }
      steps = 0;
      step = 0;
      keyframes[static_cast<std::size_t>(kept++)] = k;
    }
    keyframes.resize(static_cast<std::size_t>(kept));
  }
  /// Of keyframe i, or of the one that stands for it, afterwards; -1 = none does.
  int number(int i) const { return now_[static_cast<std::size_t>(i)]; }
  bool stays(int i) const { return number(i) >= 0 && (i == 0 || number(i) != number(i - 1)); }

  /// Times its covariance a loop is uncertain: matches err alike where it is seen from elsewhere.
  static constexpr double optimism = 8;
  static constexpr double most_turned = 0.4;
  static constexpr std::size_t most_joints = 32;
  static constexpr int most_thinned = 4;  ///< loops to a keyframe that others were joined with

  static double length(vec3<double> const& v) { return std::sqrt(dot(v, v)); }
  static double angle(mat3<double> const& R) {
    return std::acos(std::clamp((R.m[0] + R.m[4] + R.m[8] - 1) / 2, -1.0, 1.0));
  }
  /// Translation, and half the vector of a small rotation.
  static void edge_error(rigid<double> const& T, double (&e)[6]) {
    e[0] = T.t.x;
    e[1] = T.t.y;
    e[2] = T.t.z;
    e[3] = (T.R.m[7] - T.R.m[5]) / 4;
    e[4] = (T.R.m[2] - T.R.m[6]) / 4;
    e[5] = (T.R.m[3] - T.R.m[1]) / 4;
  }
  /// The keyframe that stands for keyframe i afterwards: itself, or the one before.
  int stand_in(int i) const { return stays(i) ? i : i - 1; }
  /// As the path has it in the world: between keyframes that are far apart the odometry has
  /// drifted.
  similarity<double> motion(int from, int to) const {
    return at(from).T_world_camera.inverse() * at(to).T_world_camera;
  }

  std::vector<int> now_, held_;  ///< of thin()
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
