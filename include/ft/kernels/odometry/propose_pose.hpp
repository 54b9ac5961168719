// SPDX-License-Identifier: Apache-2.0
/// @file Stage: the pose that most of a frame's matches agree with.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/counter_draws.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/motion/constant_velocity.hpp"
#include "ft/kernels/odometry/match_without_window.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Item: a camera.
template <typename Rig>
struct propose_pose {
  static constexpr bool wide_on_host = true;
  static constexpr int hypotheses = 256;
  static constexpr int none = 1 << 30;  ///< cost of a hypothesis that there is not
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, windowless_search<Rig> const& in,
                                 tracking_rules const& rules, odometry_state_view const& state,
                                 windowless_workspace const& work) const {
    camera_track const& t = state.tracks[b];
    pose_proposal& out = work.proposals[b];
    bool const wanted = is_doubtful(t, rules, in.inliers[b]);
    g.sync();
    if (g.rank() == 0) { out.matches = out.support = out.first_support = out.adopted = 0; }
    if (!wanted) { return; }
    observation* const list = work.matches + static_cast<std::ptrdiff_t>(b) * in.frame.numbers();
    int const camera = busiest(g, b, in, work);
    int const n = list_matches(g, b, camera, in, anchors::of(in, t, b), work, list);
    g.sync();
    if (n < rules.min_support) { return; }

    auto const matches = seen_matches{in.rig, camera, list, n};
    counter_draws const draws{mixed_bits(static_cast<std::uint64_t>(t.time_ns) + 1)};
    rigid<strict_double> T, best_T = rigid<strict_double>::identity();
    int best = none, best_number = none;
    for (int h = g.rank(); h < hypotheses; h += g.size()) {
      if (!hypothesis(matches, draws, h, T)) { continue; }
      int const cost = matches.cost(T, best);
      if (cost < best) {
        best = cost;
        best_number = h;
        best_T = T;
      }
    }
    int const least = g.reduce(best, min_op{});
    int const number = g.reduce(best == least ? best_number : none, min_op{});
    if (number == none) { return; }
    if (best_number == number && best == least) {
      out.T_cw = matches.of_body(best_T).template cast<double>();
      out.matches = n;
    }
    g.sync();
    auto const cost_of = [&](rigid<strict_double> const& T_bw, int& support) {
      auto const T_cw = matches.of_camera(T_bw);
      int cost = 0, agree = 0;
      for (int i = g.rank(); i < n; i += g.size()) {
        int const e = matches.error(T_cw, i);
        cost += e;
        agree += static_cast<int>(e < seen_matches::limit);
      }
      support = g.reduce(agree, sum_op{});
      return g.reduce(cost, sum_op{});
    };
    int support = 0, first_support = 0;
    int const cost = cost_of(out.T_cw.template cast<strict_double>(), support);
    int const first = cost_of(in.T_cw[b].template cast<strict_double>(), first_support);
    if (g.rank() != 0) { return; }
    out.support = support;
    out.first_support = first_support;
    // A lost camera has no other pose to go on from.
    bool const better =
        t.lost_frames > 0 || 10.0f * static_cast<float>(cost) < 9.0f * static_cast<float>(first);
    out.adopted = support >= rules.min_support && better ? 1 : 0;
  }

private:
  /// Matches of one camera, and how well poses agree with them. Poses are of that camera.
  struct seen_matches {
    /// Squared errors in units of the keypoint's variance, with room for that of a pose from three
    /// points: four times the 95 % limit of two degrees of freedom.
    static constexpr int limit = 24 * 8;

    Rig const& rig;
    int camera;
    observation const* list;
    int n;

    FT_HOST_DEVICE auto const& model() const {
      if constexpr (Rig::rectified) {
        return rig.pair(camera).camera;
      } else {
        return rig.left;
      }
    }
    FT_HOST_DEVICE rigid<strict_double> of_camera(rigid<strict_double> const& T_bw) const {
      if constexpr (Rig::rectified) {
        return rig.to_camera(camera, T_bw);
      } else {
        return T_bw;
      }
    }
    FT_HOST_DEVICE rigid<strict_double> of_body(rigid<strict_double> const& T_cw) const {
      if constexpr (!Rig::rectified) {
        return T_cw;
      } else {
        // What turns derivatives turns the columns of a rotation.
        return rigid<strict_double>{
            rig.derivative_in_body(camera, T_cw.R.transposed()).transposed(),
            rig.to_body(camera, T_cw.t)}
            .orthonormalized();
      }
    }
    /// Squared error of match i in eighths of its variance, at most `limit`.
    FT_HOST_DEVICE int error(rigid<strict_double> const& T, int i) const {
      return error(T.template cast<strict_float>(), i);
    }
    FT_HOST_DEVICE int error(rigid<strict_float> const& T, int i) const {
      observation const o = list[i];
      auto const p = T * o.point.template cast<strict_float>();
      auto const seen = model().template cast<strict_float>().project(p);
      strict_float const dx = seen.pixel.x - strict_float(o.u);
      strict_float const dy = seen.pixel.y - strict_float(o.v);
      strict_float const e = (dx * dx + dy * dy) * strict_float(8.0f * o.inv_sigma2);
      return seen.valid && e < strict_float(static_cast<float>(limit)) ? static_cast<int>(e.value)
                                                                       : limit;
    }
    /// Sum of the errors; a number that is not below `enough` as soon as it is known.
    FT_HOST_DEVICE int cost(rigid<strict_double> const& T_cw, int enough) const {
      auto const T = T_cw.template cast<strict_float>();
      int sum = 0;
      for (int i = 0; i < n && sum < enough; ++i) { sum += error(T, i); }
      return sum;
    }
  };

  FT_HOST_DEVICE static bool is_mutual(int b, int i, windowless_search<Rig> const& in,
                                       windowless_workspace const& work) {
    std::ptrdiff_t const first = static_cast<std::ptrdiff_t>(b) * in.frame.numbers();
    int const k = work.keypoint_of[first + i];
    return k >= 0 && work.anchor_of[first + k] == i;
  }

  /// The camera with most mutual matches.
  template <typename Group>
  FT_HOST_DEVICE static int busiest(Group g, int b, windowless_search<Rig> const& in,
                                    windowless_workspace const& work) {
    constexpr int cameras = Rig::rectified ? Rig::cameras : 1;
    int best = 0, most = -1;
    for (int c = 0; cameras > 1 && c < cameras; ++c) {
      int mine = 0;
      for (int i = g.rank(); i < in.frame.capacity(); i += g.size()) {
        mine += static_cast<int>(is_mutual(b, c * in.frame.capacity() + i, in, work));
      }
      int const all = g.reduce(mine, sum_op{});
      best = all > most ? c : best;
      most = max_of(all, most);
    }
    return best;
  }

  /// Lists a camera's mutual matches in the order of the anchors. @return their number
  template <typename Group>
  FT_HOST_DEVICE static int list_matches(Group g, int b, int camera,
                                         windowless_search<Rig> const& in, anchors const& from,
                                         windowless_workspace const& work, observation* list) {
    int const capacity = in.frame.capacity();
    keypoints_view const keypoints = in.frame.camera(b, camera);
    auto const points = in.map.points.slice(b);
    int n = 0;
    for (int base = 0; base < capacity; base += g.size()) {
      int const i = camera * capacity + base + g.rank();
      bool const there = base + g.rank() < capacity && is_mutual(b, i, in, work);
      int here = 0;
      int const place = n + g.exclusive_count(there, here);
      n += here;
      if (!there) { continue; }
      int const k = work.keypoint_of[static_cast<std::ptrdiff_t>(b) * in.frame.numbers() + i] -
                    camera * capacity;
      int const octave = keypoints.octave(k);
      list[place] = {
          points.position(from.slot(i)),           in.geometry.column(keypoints.x(k), octave),
          in.geometry.row(keypoints.y(k), octave), -1.0f,
          in.geometry.inv_sigma2[octave],          camera};
    }
    return n;
  }

  /// Pose h: from three matches, the one of its solutions that a fourth match agrees with most.
  FT_HOST_DEVICE static bool hypothesis(seen_matches const& in, counter_draws const& draws, int h,
                                        rigid<strict_double>& T) {
    int drawn[4];
    draws.distinct(in.n, static_cast<std::uint64_t>(h), drawn);
    auto const camera = in.model().template cast<strict_double>();
    vec3<strict_double> ray[3], point[3];
    for (int i = 0; i < 3; ++i) {
      observation const& o = in.list[drawn[i]];
      auto const seen = camera.unproject(
          {strict_double(static_cast<double>(o.u)), strict_double(static_cast<double>(o.v))});
      if (!seen.valid) { return false; }
      auto const length = scalar::sqrt(dot(seen.direction, seen.direction));
      ray[i] = scaled(seen.direction, strict_double(1) / length);
      point[i] = o.point.template cast<strict_double>();
    }
    three_point_poses const all = three_point_solver(ray, point).solve();
    observation const& fourth = in.list[drawn[3]];
    int best = -1;
    strict_double least = 0;
    for (int i = 0; i < all.count; ++i) {
      auto const seen = camera.project(all.T_cw[i] * fourth.point.template cast<strict_double>());
      strict_double const dx = seen.pixel.x - strict_double(static_cast<double>(fourth.u));
      strict_double const dy = seen.pixel.y - strict_double(static_cast<double>(fourth.v));
      strict_double const e = dx * dx + dy * dy;
      if (seen.valid && (best < 0 || e < least)) {
        best = i;
        least = e;
      }
    }
    if (best < 0) { return false; }
    T = all.T_cw[best];
    return true;
  }
};

}  // namespace detail

/// Draws 256 poses, each from three matches of match_without_window(), and keeps the one with the
/// least sum of truncated squared errors. It is adopted if at least `min_support` matches agree
/// with it and, of a camera that was not lost, its sum is below nine tenths of the first pose's: of
/// poses from three matches the best one has a sum up to a tenth above that of the optimum. Draws
/// depend on the time of the frame alone. Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec, typename Rig>
void propose_poses(Exec const& exec, windowless_search<Rig> const& in, tracking_rules const& rules,
                   odometry_state_view const& state, windowless_workspace const& work) {
  for_each_item<per_block<256>>(exec, in.frame.batch, detail::propose_pose<Rig>{}, in, rules, state,
                                work);
}

}  // namespace FT_ABI
}  // namespace ft
