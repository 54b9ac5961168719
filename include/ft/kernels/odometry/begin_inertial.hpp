// SPDX-License-Identifier: Apache-2.0
/// @file Stages: the beginning of a frame of an odometry with an IMU, which tells what is to be
/// integrated, and predicts the frame's state.
#pragma once

#include <cstdint>

#include "ft/containers/inertial.hpp"
#include "ft/containers/keyframes.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/inertial/predict.hpp"
#include "ft/kernels/inertial/preintegrate.hpp"
#include "ft/kernels/inertial/stored_state.hpp"
#include "ft/kernels/odometry/begin_frame.hpp"
#include "ft/kernels/odometry/inertial_track.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// What a prediction with the IMU reads besides its own state.
struct inertial_prediction {
  odometry_input const* inputs;  ///< [batch]
  imu_mount mount;
  keyframes_view keyframes;  ///< an adjustment may have moved them
};

/// Longest time for which the IMU alone tells where a camera is, and over which a state is
/// predicted from the newest keyframe. Later the camera is searched for as without an IMU.
inline constexpr std::int64_t longest_bridge_ns = 5'000'000'000;

namespace detail {

/// A state at another pose of the camera.
FT_HOST_DEVICE inline stored_inertial_state at_pose(stored_inertial_state state,
                                                    rigid<double> const& T_cw) {
  auto const T = T_cw.cast<strict_double>();
  quaternion<strict_double> const q = quaternion_of(T.R);
  auto const narrow = [](strict_double v) { return static_cast<float>(v.value); };
  state.q_cw = {narrow(q.x), narrow(q.y), narrow(q.z), narrow(q.w)};
  state.t_cw = {narrow(T.t.x), narrow(T.t.y), narrow(T.t.z)};
  return state;
}
/// The camera's pose of a state.
FT_HOST_DEVICE inline rigid<double> pose_of(stored_inertial_state const& state) {
  using real = strict_double;
  auto const widen = [](float v) { return real(static_cast<double>(v)); };
  quaternion<real> const q{widen(state.q_cw.x), widen(state.q_cw.y), widen(state.q_cw.z),
                           widen(state.q_cw.w)};
  rigid<real> const T{rotation_of(q),
                      {widen(state.t_cw.x), widen(state.t_cw.y), widen(state.t_cw.z)}};
  return T.orthonormalized().cast<double>();
}

/// By how much the rotation of an integral grows with the offset of its clock: that at the end less
/// that at the begin, rad/s, in the body's frame at the end.
/// A rate that is unknown is the integral's mean one; where both are, the body begins at rest.
/// @param from, to rates of turning at its begin and end, in the body's frame there; NaN = unknown
FT_HOST_DEVICE inline vec3<strict_float> turn_by_clock(preintegrated const& p, vec3<float> from,
                                                       vec3<float> to) {
  using real = strict_float;
  auto const known = [](vec3<float> v) {
    return scalar::is_finite(v.x) && scalar::is_finite(v.y) && scalar::is_finite(v.z);
  };
  vec3<real> const mean = p.mean_gyro.cast<real>() + p.bias.gyro.cast<real>();
  vec3<real> const end = known(to) ? to.cast<real>() : mean;
  if (!known(from) && !known(to)) { return end; }
  vec3<real> const begin = known(from) ? from.cast<real>() : mean;
  return end - p.dR.cast<real>().transposed() * begin;
}

/// Item: a camera. Copies its samples, and says what is integrated up to its next frame.
struct begin_inertial_frame {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, odometry_input const* inputs,
                                 inertial_input const* spans, imu_sample const* samples,
                                 inertial_view const& v) const {
    inertial_input const in = spans[b];
    int const first = b * v.steps.capacity;
    for (int i = g.rank(); i < in.samples; i += g.size()) {
      v.samples[first + i] = samples[first + i];
    }
    for (int i = g.rank(); in.anew != 0 && i < v.positions; i += g.size()) {
      v.between[v.at(b, i)].status = integration_status::no_samples;
    }
    if (g.rank() != 0) { return; }
    inertial_track& t = v.tracks[b];
    if (in.anew != 0) {
      t.begin_anew();
      v.prior[b].known = 0;
    }
    if (inputs[b].reset != 0) {
      t = inertial_track::initial();
      v.prior[b].known = 0;
    }
    v.intervals[b] = {in.from_s, in.to_s, first, in.samples};
    double const newest_s = in.samples > 0 ? samples[first + in.samples - 1].time_s : in.to_s;
    t.clock_sigma = in.clock_sigma_s;
    t.unseen_s = static_cast<float>(max_of(in.to_s - newest_s, 0.0));
    v.starts[2 * b] = {b, 1, t.last.bias};
    v.starts[2 * b + 1] = {b, t.restarts, t.keyframe.bias};
    t.restarts = 0;
  }
};

/// Item: a camera. Predicts its state, where the IMU says one, and makes the problem of its pose.
struct predict_inertial_frame {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, inertial_prediction const& in,
                                 odometry_state_view const& state, predicted_frames const& out,
                                 inertial_view const& v) const {
    if (g.rank() == 0) { predict(b, in, state, out, v); }
    g.sync();
    make_problem(g, v.tracks[b], b, v);
  }

private:
  template <typename Group>
  FT_HOST_DEVICE static void make_problem(Group g, inertial_track const& t, int b,
                                          inertial_view const& v) {
    inertial_inputs const& to = v.inputs;
    bool const from_last = t.source == inertial_source::last_frame;
    copy_object(g, to.integral[b], from_last ? v.from_last(b) : v.from_keyframe(b));
    copy_object(g, to.first[b], from_last ? t.last : t.keyframe);
    copy_object(g, to.start[b], t.predicted);
    g.sync();
    if (g.rank() != 0) { return; }
    to.from_last_frame[b] = from_last ? 1 : 0;
    to.gravity[b] = t.gravity;
    if (t.source == inertial_source::none) {
      to.integral[b].status = integration_status::no_samples;
    }
    preintegrated& p = to.integral[b];
    loosen(p, v.accel_sigma, t.unseen_s);
    loosen_clock(p, turn_by_clock(p, from_last ? t.last_rate : t.keyframe_rate, t.rate),
                 t.clock_sigma);
  }
  /// More than 6 g all the time between two images is no motion of a camera, m/s^2.
  static constexpr float most_accel = 60;

  FT_HOST_DEVICE static bool is_no_motion(preintegrated const& p) {
    using real = strict_float;
    vec3<real> const dV = p.dV.template cast<real>();
    real const most = real(most_accel) * real(p.dT);
    return usable(p.status) && !(dot(dV, dV) <= most * most);
  }
  /// How fast motion may change where samples are still to come: usual for a hand, m/s^3, rad/s^2.
  static constexpr float usual_jerk = 30, usual_turn = 10;

  /// Adds what gravity and the accelerometer's bias may be off by together: an unknown
  /// acceleration; and what the motion may have done since the last sample.
  /// @param unseen time since then, s
  FT_HOST_DEVICE static void loosen(preintegrated& p, float sigma, float unseen) {
    using real = strict_float;
    real const dv = real(sigma) * real(p.dT);
    real const dp = real(0.5f) * dv * real(p.dT);
    real const late = unseen;
    real const half = real(0.5f) * late * late;
    real const late_dr = real(usual_turn) * half;
    real const late_dv = real(usual_jerk) * half;
    real const late_dp = late_dv * late * real(1.0f / 3);
    auto const add = [&](int row, int column, real value) {
      float& c = p.C[9 * row + column];
      c = (real(c) + value).value;
    };
    for (int i = 0; i < 3; ++i) {
      add(i, i, late_dr * late_dr);
      add(3 + i, 3 + i, dv * dv + late_dv * late_dv);
      add(6 + i, 6 + i, dp * dp + late_dp * late_dp);
      add(3 + i, 6 + i, dv * dp + late_dv * late_dp);
      add(6 + i, 3 + i, dv * dp + late_dv * late_dp);
    }
  }
  /// Adds what an offset of the clocks may turn more. What it changes of velocities is less than
  /// what gravity and bias do.
  FT_HOST_DEVICE static void loosen_clock(preintegrated& p, vec3<strict_float> turn, float sigma) {
    using real = strict_float;
    real const d[3] = {turn.x * real(sigma), turn.y * real(sigma), turn.z * real(sigma)};
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        float& c = p.C[9 * i + j];
        c = (real(c) + d[i] * d[j]).value;
      }
    }
  }
  /// Until all is known, the gyroscope says how the camera has turned. Where it is, its motion
  /// says.
  FT_HOST_DEVICE static void predict_turn(int b, inertial_prediction const& in,
                                          predicted_frames const& out, inertial_view const& v,
                                          camera_track& track, rigid<double> const& last) {
    inertial_track const& t = v.tracks[b];
    if (t.gyro_agrees == 0 || t.given != 0 || !usable(v.from_last(b).status)) { return; }
    using real = strict_double;
    mat3<real> const R_cb = in.mount.T_cb.R.template cast<real>();
    mat3<real> const dR =
        change_bias(v.from_last(b), t.last.bias).dR.template cast<real>().transposed();
    mat3<real> const R = R_cb * dR * R_cb.transposed() * last.R.template cast<real>();
    vec3<real> const centre = track.predicted.template cast<real>().centre();
    rigid<real> const T = rigid<real>{R, R * vec3<real>{-centre.x, -centre.y, -centre.z}};
    track.predicted = T.orthonormalized().template cast<double>();
    out.T_cw[b] = track.predicted.template cast<float>();
  }
  FT_HOST_DEVICE static void predict(int b, inertial_prediction const& in,
                                     odometry_state_view const& state, predicted_frames const& out,
                                     inertial_view const& v) {
    inertial_track& t = v.tracks[b];
    t.source = inertial_source::none;
    t.given = in.inputs[b].predicted;
    t.status = v.from_last(b).status;
    t.last_rate = t.rate;
    int const steps = usable(t.status) ? v.from_last(b).steps : 0;
    t.rate = steps > 0 ? v.steps.of(b)[steps - 1].gyro : inertial_track::no_rate();
    camera_track& track = state.tracks[b];
    track.guided = 0;
    bool const blind = saturated_difference(track.time_ns, track.seen_ns) >= longest_bridge_ns;
    if (is_no_motion(v.from_last(b))) {
      t.status = v.from_last(b).status = integration_status::contradicted;
      v.from_keyframe(b).status = integration_status::contradicted;
      t.keyframe_moves = t.follows = 0;
    }
    if (!track.has_map() || blind) { return; }
    if (!t.known()) {
      predict_turn(b, in, out, v, track, state.T_cw[b]);
      return;
    }
    if (state.apply[b] != 0) { follow_map(t, b, in.keyframes); }
    bool const follows = t.follows != 0 && state.apply[b] == 0;
    if (follows && usable(v.from_last(b).status)) {
      t.source = inertial_source::last_frame;
    } else if (t.keyframe_moves != 0 && usable(v.from_keyframe(b).status) &&
               saturated_difference(track.time_ns, track.keyframe_ns) < longest_bridge_ns) {
      t.source = inertial_source::last_keyframe;
    } else {
      return;
    }
    bool const from_last = t.source == inertial_source::last_frame;
    preintegrated const& integral = from_last ? v.from_last(b) : v.from_keyframe(b);
    inertial_state<float> const start = body_state(from_last ? t.last : t.keyframe, in.mount);
    t.predicted = stored_state(predict_state(start, integral, t.gravity), in.mount);
    if (!is_finite(t.predicted)) {
      t.source = inertial_source::none;
      return;
    }
    if (t.given != 0) { return; }
    track.guided = 1;
    track.predicted = pose_of(t.predicted);
    out.T_cw[b] = track.predicted.template cast<float>();
  }
  /// The newest keyframe is where the map has it now.
  FT_HOST_DEVICE static void follow_map(inertial_track& t, int b, keyframes_view const& keyframes) {
    int const made = keyframes.made[b];
    if (made == 0) { return; }
    t.keyframe = at_pose(t.keyframe, keyframes.T_cw[keyframes.at(b, keyframes.position(made))]);
  }
};

}  // namespace detail

/// Copies the samples of every camera that lie before its next frame, and says which integrals they
/// enter. Asynchronous on `exec`; allocates nothing; one launch.
/// @param inputs, spans [batch] host memory that the executor's threads can read
/// @param samples [batch][v.steps.capacity] likewise
template <typename Exec>
void begin_inertial_frames(Exec const& exec, odometry_input const* inputs,
                           inertial_input const* spans, imu_sample const* samples,
                           inertial_view const& v) {
  for_each_item<per_warp>(exec, v.batch, detail::begin_inertial_frame{}, inputs, spans, samples, v);
}

/// Predicts the states of cameras with their IMUs, after predict_frames(), whose prediction is
/// replaced unless it is the caller's. From the last frame; where the map has changed since, or
/// that was not optimised with the IMU, from the newest keyframe. Makes the problems of their
/// poses; those of cameras whose IMU says nothing will be refused. Asynchronous on `exec`;
/// allocates nothing; one launch.
template <typename Exec>
void predict_inertial_frames(Exec const& exec, inertial_prediction const& in,
                             odometry_state_view const& state, predicted_frames const& out,
                             inertial_view const& v) {
  for_each_item<per_warp>(exec, v.batch, detail::predict_inertial_frame{}, in, state, out, v);
}

}  // namespace FT_ABI
}  // namespace ft
