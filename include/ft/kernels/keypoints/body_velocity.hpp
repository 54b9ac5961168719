// SPDX-License-Identifier: Apache-2.0
/// @file Stages: how fast the bodies of rigs move, by which keypoints of rolling shutters are
/// moved.
#pragma once

#include <cstdint>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/math/se3.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// How a body moves in its own frame: T_cw at t seconds after a frame is exp(t * (w, u)) times that
/// of the frame. rad/s and m/s.
struct body_velocity {
  vec3<double> w, u;
};
/// By what the keypoints of a frame are moved.
struct shutter_motion {
  body_velocity before;  ///< by which they have been moved already
  body_velocity now;     ///< by which they are to be moved in all
};

/// What the search from the last frame has found.
struct first_poses {
  pose const* T_cw;    ///< [batch]
  int const* inliers;  ///< [batch]
  int min_inliers;     ///< with fewer, a pose says nothing
};

namespace detail {

/// Mean velocity from a pose to another one. At rest where that is no number.
FT_HOST_DEVICE inline body_velocity velocity_between(rigid<strict_double> const& from,
                                                     rigid<strict_double> const& to,
                                                     std::int64_t interval_ns) {
  using real = strict_double;
  twist const all = log_se3((to * from.inverse()).orthonormalized());
  real const by = real(1e9) / real(static_cast<double>(interval_ns));
  vec3<real> const w = scaled(all.w, by);
  vec3<real> const u = scaled(all.u, by);
  if (!scalar::is_finite(dot(w, w) + dot(u, u))) { return {{0, 0, 0}, {0, 0, 0}}; }
  return {w.template cast<double>(), u.template cast<double>()};
}

/// Item: a camera of the odometry. How it moves, by its prediction.
struct find_body_velocity {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int b, odometry_input const* inputs,
                                 odometry_state_view const& state, shutter_motion* out) const {
    using real = strict_double;
    camera_track const& t = state.tracks[b];
    body_velocity const rest{{0, 0, 0}, {0, 0, 0}};
    out[b] = {rest, rest};
    // Where the last pose is not known, the caller's prediction says nothing about the motion.
    bool const lost = t.state != tracking_state::tracking;
    if (!t.has_map() || t.interval_ns <= 0 || (lost && inputs[b].predicted != 0)) { return; }
    out[b].now = velocity_between(state.T_cw[b].template cast<real>(),
                                  t.predicted.template cast<real>(), t.interval_ns);
  }
};

/// Item: a camera of the odometry. How it moves, by the first pose of the frame.
struct refine_body_velocity {
  using scratch = no_scratch;
  using real = strict_double;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int b, first_poses const& found,
                                 odometry_state_view const& state, shutter_motion* out) const {
    camera_track const& t = state.tracks[b];
    out[b].before = out[b].now;
    bool const knows = t.state == tracking_state::tracking && t.interval_ns > 0 &&
                       found.inliers[b] >= found.min_inliers;
    if (!knows) { return; }
    body_velocity v = velocity_between(state.T_cw[b].template cast<real>(),
                                       found.T_cw[b].template cast<real>(), t.interval_ns);
    if (t.velocity.known()) {
      // Both are means over an interval; what is wanted is that at the end of the later one.
      body_velocity const last = velocity_between(
          rigid<real>::identity(), t.velocity.motion.template cast<real>(), t.velocity.interval_ns);
      real const mine = real(static_cast<double>(t.interval_ns));
      real const share = mine / (mine + real(static_cast<double>(t.velocity.interval_ns)));
      v = {further(last.w, v.w, share), further(last.u, v.u, share)};
    }
    out[b].now = v;
  }

private:
  FT_HOST_DEVICE static vec3<double> further(vec3<double> const& a, vec3<double> const& b,
                                             real share) {
    auto const from = a.template cast<real>();
    auto const to = b.template cast<real>();
    return (to + scaled(to - from, share)).template cast<double>();
  }
};

}  // namespace detail

/// How cameras move at their current frames, by predict_frames(): as from the last frame to the
/// prediction. At rest where there is no motion yet. Asynchronous on `exec`; allocates nothing; one
/// launch.
/// @param inputs [batch] host memory that the executor's threads can read
/// @param out [batch]
template <typename Exec>
void find_body_velocities(Exec const& exec, odometry_input const* inputs,
                          odometry_state_view const& state, shutter_motion* out) {
  for_each_item<per_thread>(exec, state.batch, detail::find_body_velocity{}, inputs, state, out);
}

/// How they move by the first poses of the frames: the mean velocity since the last frame, and its
/// change since the motion before, give that of the frame. Where too few agree with a pose, as it
/// was. Asynchronous on `exec`; allocates nothing; one launch.
/// @param out [batch] of find_body_velocities()
template <typename Exec>
void refine_body_velocities(Exec const& exec, first_poses const& found,
                            odometry_state_view const& state, shutter_motion* out) {
  for_each_item<per_thread>(exec, state.batch, detail::refine_body_velocity{}, found, state, out);
}

}  // namespace FT_ABI
}  // namespace ft
