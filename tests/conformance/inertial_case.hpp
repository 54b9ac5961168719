// SPDX-License-Identifier: Apache-2.0
/// @file Reads the folders of golden_inertial: chains of frames with an IMU, and cases of
/// preintegration. Names and layouts are those of FORMAT.md there.
#pragma once

#include <cstddef>
#include <cstdint>
#include <fstream>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ft/containers/inertial.hpp"
#include "ft/types/poses.hpp"
#include "tests/support/npy.hpp"

namespace test {

namespace inertial_detail {

inline ft::vec3<float> vector_at(float const* p) { return {p[0], p[1], p[2]}; }
template <typename T>
ft::mat3<T> matrix_at(T const* p) {
  ft::mat3<T> m;
  for (std::size_t i = 0; i < 9; ++i) { m.m[i] = p[i]; }
  return m;
}
/// The first number of a row.
template <typename T>
T const* row(npy<T> const& array, int r) {
  return &array(r, 0);
}

}  // namespace inertial_detail

/// What params.json says, and the single-precision values that the reference derives from it.
struct inertial_calibration {
  std::string family;  ///< stereo, mono or fisheye; empty for cases of preintegration
  std::string kind;
  ft::imu_noise noise;
  ft::imu_variances variances{};  ///< derived
  ft::rigid<double> T_bc = ft::rigid<double>::identity();
  ft::imu_mount mount{};                                 ///< derived
  ft::rigid<float> T_rl = ft::rigid<float>::identity();  ///< derived; of two cameras
  std::vector<float> camera;  ///< parameters of a camera, or of two; a Kannala-Brandt one has 8
  float bf = 0;

  explicit inertial_calibration(std::string const& folder) {
    std::ifstream file(folder + "/params.json");
    auto const json = nlohmann::json::parse(file);
    std::vector<float> const densities = json["noise"];
    noise = {densities.at(0), densities.at(1), densities.at(2), densities.at(3),
             json["imu_frequency"]};
    std::vector<float> const derived = json["nga_walk_f32"];
    for (std::size_t i = 0; i < 6; ++i) {
      variances.measured[i] = derived.at(i);
      variances.walk[i] = derived.at(6 + i);
    }
    if (!json.contains("family")) { return; }
    family = json["family"];
    kind = json["kind"];
    bf = json["bf"];
    camera = json["cam_params"].get<std::vector<float>>();
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t j = 0; j < 3; ++j) { T_bc.R.m[3 * i + j] = json["T_bc"][i][j]; }
    }
    T_bc.t = {json["T_bc"][0][3], json["T_bc"][1][3], json["T_bc"][2][3]};
    std::vector<float> const m = json["R_cb_t_cb_R_bc_t_bc_f32"];
    mount.T_cb = {inertial_detail::matrix_at(&m.at(0)), inertial_detail::vector_at(&m.at(9))};
    mount.T_bc = {inertial_detail::matrix_at(&m.at(12)), inertial_detail::vector_at(&m.at(21))};
    if (json.contains("R_rl_t_rl_f32")) {
      std::vector<float> const r = json["R_rl_t_rl_f32"];
      T_rl = {inertial_detail::matrix_at(&r.at(0)), inertial_detail::vector_at(&r.at(9))};
    }
  }
};

/// Recorded integrals: the arrays pf_* (from the last frame) or pk_* (from the last keyframe).
class recorded_integrals {
public:
  recorded_integrals(std::string const& folder, std::string const& prefix)
      : dT_(read_npy<float>(folder + "/" + prefix + "_dT.npy")),
        dR_(read_npy<float>(folder + "/" + prefix + "_dR.npy")),
        dV_(read_npy<float>(folder + "/" + prefix + "_dV.npy")),
        dP_(read_npy<float>(folder + "/" + prefix + "_dP.npy")),
        J_(read_npy<float>(folder + "/" + prefix + "_J.npy")),
        C9_(read_npy<float>(folder + "/" + prefix + "_C9.npy")),
        Cw_(read_npy<float>(folder + "/" + prefix + "_Cw.npy")),
        bias_(read_npy<float>(folder + "/" + prefix + "_bias.npy")),
        avg_(read_npy<float>(folder + "/" + prefix + "_avg.npy")) {}

  int count() const { return dT_.rows(); }
  ft::imu_bias bias(int i) const {
    float const* const b = inertial_detail::row(bias_, i);
    return {inertial_detail::vector_at(b), inertial_detail::vector_at(b + 3)};
  }
  /// @param steps of which the integral was made; 0: its status is no_steps
  ft::preintegrated at(int i, int steps) const {
    using inertial_detail::matrix_at;
    using inertial_detail::row;
    using inertial_detail::vector_at;
    ft::preintegrated out{};
    out.dT = dT_(i);
    out.dR = matrix_at(row(dR_, i));
    out.dV = vector_at(row(dV_, i));
    out.dP = vector_at(row(dP_, i));
    ft::mat3<float>* const jacobians[] = {&out.JRg, &out.JVg, &out.JVa, &out.JPg, &out.JPa};
    for (int k = 0; k < 5; ++k) { *jacobians[k] = matrix_at(row(J_, i) + 9 * k); }
    for (int k = 0; k < 81; ++k) { out.C[k] = C9_(i, k); }
    for (int k = 0; k < 6; ++k) { out.walk[k] = Cw_(i, k); }
    out.bias = bias(i);
    out.mean_accel = vector_at(row(avg_, i));
    out.mean_gyro = vector_at(row(avg_, i) + 3);
    out.steps = steps;
    out.status = steps > 0 ? ft::integration_status::integrated : ft::integration_status::no_steps;
    return out;
  }

private:
  npy<float> dT_, dR_, dV_, dP_, J_, C9_, Cw_, bias_, avg_;
};

/// A recorded sample: one row of imu.
inline ft::imu_sample sample_at(npy<double> const& imu, int i) {
  auto const f = [&](int k) { return static_cast<float>(imu(i, k)); };
  return {imu(i, 0), {f(1), f(2), f(3)}, {f(4), f(5), f(6)}};
}

/// A state as it was recorded: the body's, and what the frame stores.
struct recorded_state {
  ft::inertial_state<float> body;
  ft::stored_inertial_state stored;
};
inline recorded_state state_at(npy<float> const& array, int r) {
  using inertial_detail::vector_at;
  float const* const s = inertial_detail::row(array, r);
  recorded_state out;
  out.body = {inertial_detail::matrix_at(s), vector_at(s + 9), vector_at(s + 12), vector_at(s + 15),
              vector_at(s + 18)};
  out.stored = {
      {s[21], s[22], s[23], s[24]}, vector_at(s + 25), out.body.v, {out.body.bg, out.body.ba}};
  return out;
}
/// The 21 numbers of a state in double precision.
inline ft::inertial_state<double> wide_state_at(double const* s) {
  return {inertial_detail::matrix_at(s),
          {s[9], s[10], s[11]},
          {s[12], s[13], s[14]},
          {s[15], s[16], s[17]},
          {s[18], s[19], s[20]}};
}

/// One keypoint that holds a map point.
struct recorded_observation {
  int camera;
  float u, v, right_u;  ///< right_u is -1 where there is none
  float inverse_sigma2;
  ft::vec3<float> point;  ///< world, metres
  float depth;            ///< metres
};

/// A chain of frames. Step s brings frame s + 1.
struct inertial_chain {
  std::string folder;
  inertial_calibration calibration;
  npy<double> imu = array<double>("imu");
  npy<double> times = array<double>("times");
  npy<std::int32_t> map_updated = array<std::int32_t>("map_updated");
  npy<std::int32_t> new_kf = array<std::int32_t>("new_kf");
  npy<std::int32_t> mode = array<std::int32_t>("mode");  ///< 0 from keyframe, 1 from last frame
  npy<float> steps = array<float>("steps");
  npy<std::int32_t> steps_start = array<std::int32_t>("steps_start");
  recorded_integrals from_frame{folder, "pf"};
  recorded_integrals from_keyframe{folder, "pk"};
  npy<float> lf_state = array<float>("lf_state");
  npy<float> kf_state = array<float>("kf_state");
  npy<float> pred_state = array<float>("pred_state");
  npy<float> obs = array<float>("obs");
  npy<std::int32_t> obs_start = array<std::int32_t>("obs_start");
  npy<double> prior_in_state = array<double>("prior_in_state");
  npy<double> prior_in_H = array<double>("prior_in_H");
  npy<double> prior_out_state = array<double>("prior_out_state");
  npy<double> prior_out_H = array<double>("prior_out_H");
  npy<float> out_state = array<float>("out_state");
  npy<std::uint8_t> outlier = array<std::uint8_t>("outlier");
  npy<std::int32_t> ret = array<std::int32_t>("ret");
  npy<std::int32_t> rounds = array<std::int32_t>("rounds");
  npy<double> round_state = array<double>("round_state");
  npy<float> chi2 = array<float>("chi2");

  explicit inertial_chain(std::string where) : folder(std::move(where)), calibration(folder) {}

  int count() const { return mode.rows(); }
  int first_step(int s) const { return steps_start(s); }
  int step_count(int s) const { return steps_start(s + 1) - steps_start(s); }
  /// The first step since the last keyframe that step s goes on from.
  int first_since_keyframe(int s) const {
    while (s > 0 && new_kf(s - 1) == 0) { --s; }
    return s;
  }
  ft::preintegrated frame_integral(int s) const { return from_frame.at(s, step_count(s)); }
  ft::preintegrated keyframe_integral(int s) const {
    return from_keyframe.at(s, steps_start(s + 1) - steps_start(first_since_keyframe(s)));
  }
  int observation_count(int s) const { return obs_start(s + 1) - obs_start(s); }
  /// @param i row of obs: those of step s begin at obs_start(s)
  recorded_observation observation(int i) const {
    return {static_cast<int>(obs(i, 0)),       obs(i, 1), obs(i, 2), obs(i, 3), obs(i, 4),
            {obs(i, 5), obs(i, 6), obs(i, 7)}, obs(i, 8)};
  }
  /// The prior of the last frame at step s, or with `out` the one that step s leaves.
  ft::inertial_prior prior(int s, bool out = false) const {
    npy<double> const& state = out ? prior_out_state : prior_in_state;
    npy<double> const& H = out ? prior_out_H : prior_in_H;
    ft::inertial_prior p{};
    p.known = static_cast<int>(state(s, 0) == state(s, 0));  // NaN: none
    if (p.known == 0) { return p; }
    p.state = wide_state_at(inertial_detail::row(state, s));
    for (int k = 0; k < 225; ++k) { p.information[k] = H(s, k); }
    return p;
  }

private:
  template <typename T>
  npy<T> array(std::string const& name) const {
    return read_npy<T>(folder + "/" + name + ".npy");
  }
};

/// The cases of preintegration alone, each with a queue and an interval of its own.
struct preintegration_cases {
  std::string folder;
  inertial_calibration calibration;
  npy<double> imu;
  npy<std::int32_t> imu_start;
  npy<double> t;
  npy<float> bias;  ///< of the last frame, of the keyframe's integral, and a new one
  npy<std::int32_t> status;
  npy<float> steps;
  npy<std::int32_t> steps_start;
  recorded_integrals from_frame;
  recorded_integrals from_keyframe;
  npy<float> upd;
  npy<double> info;

  explicit preintegration_cases(std::string const& where)
      : folder(where),
        calibration(where),
        imu(read_npy<double>(where + "/imu.npy")),
        imu_start(read_npy<std::int32_t>(where + "/imu_start.npy")),
        t(read_npy<double>(where + "/t.npy")),
        bias(read_npy<float>(where + "/bias.npy")),
        status(read_npy<std::int32_t>(where + "/status.npy")),
        steps(read_npy<float>(where + "/steps.npy")),
        steps_start(read_npy<std::int32_t>(where + "/steps_start.npy")),
        from_frame(where, "pf"),
        from_keyframe(where, "pk"),
        upd(read_npy<float>(where + "/upd.npy")),
        info(read_npy<double>(where + "/info.npy")) {}

  int count() const { return t.rows(); }
  int step_count(int i) const { return steps_start(i + 1) - steps_start(i); }
  /// @param which 0: of the last frame, 1: of the keyframe's integral, 2: a new one
  ft::imu_bias bias_of(int i, int which) const {
    float const* const b = inertial_detail::row(bias, i) + 6 * which;
    return {inertial_detail::vector_at(b), inertial_detail::vector_at(b + 3)};
  }
};

/// Whether a folder is one of golden_inertial: a chain, or the cases of preintegration.
inline bool is_inertial(std::string const& folder) { return exists(folder + "/pf_dT.npy"); }
inline bool is_inertial_chain(std::string const& folder) { return exists(folder + "/mode.npy"); }

}  // namespace test
