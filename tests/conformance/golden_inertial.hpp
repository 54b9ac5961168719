// SPDX-License-Identifier: Apache-2.0
/// @file Runs the stages from the samples of an IMU to a predicted state on the recorded inputs of
/// a folder of golden_inertial, and counts what is within the tolerances of its specification.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "ft/containers/inertial.hpp"
#include "ft/kernels/inertial/predict.hpp"
#include "ft/kernels/inertial/preintegrate.hpp"
#include "ft/kernels/inertial/select_samples.hpp"
#include "ft/kernels/inertial/stored_state.hpp"
#include "tests/conformance/golden_sequence.hpp"
#include "tests/conformance/inertial_case.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/npy.hpp"

namespace test {

// ---- differences --------------------------------------------------------------------------------

inline double distance(ft::vec3<float> a, ft::vec3<float> b) {
  auto const d = a.cast<double>() - b.cast<double>();
  return std::sqrt(dot(d, d));
}
/// Angle between two rotations, rad.
inline double angle_between(ft::mat3<float> const& a, ft::mat3<float> const& b) {
  auto const& m = (a.cast<double>().transposed() * b.cast<double>()).m;
  ft::vec3<double> const axis{m[7] - m[5], m[2] - m[6], m[3] - m[1]};
  return std::atan2(std::sqrt(dot(axis, axis)), m[0] + m[4] + m[8] - 1);
}
/// |a - b| / |b|, of `n` numbers; 0 where both are 0.
inline double relative_distance(float const* a, float const* b, int n) {
  double apart = 0;
  double size = 0;
  for (int i = 0; i < n; ++i) {
    double const d = static_cast<double>(a[i]) - static_cast<double>(b[i]);
    apart += d * d;
    size += static_cast<double>(b[i]) * static_cast<double>(b[i]);
  }
  return apart == 0 ? 0 : std::sqrt(apart / size);
}
/// Largest difference of n x n covariances, each element by the deviations of its row and column.
template <typename T>
double covariance_distance(T const* a, T const* b, int n) {
  double worst = 0;
  for (int r = 0; r < n; ++r) {
    for (int c = 0; c < n; ++c) {
      auto const at = [&](T const* m, int i, int j) { return static_cast<double>(m[n * i + j]); };
      double const d = std::abs(at(a, r, c) - at(b, r, c));
      if (d != 0) { worst = std::max(worst, d / std::sqrt(at(b, r, r) * at(b, c, c))); }
    }
  }
  return worst;
}

/// Counts an item; one that is not a number is outside any tolerance.
inline void add_within(stage_result& r, double difference, double tolerance) {
  r.add(difference <= tolerance, difference);
}

struct change_recorded_bias {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, ft::preintegrated const* integrals,
                                 ft::imu_bias const* biases, ft::preintegrated_motion* out) const {
    out[i] = ft::change_bias(integrals[i], biases[i]);
  }
};

// ---- one folder ---------------------------------------------------------------------------------

/// A folder of golden_inertial on one executor: selection, integration, another bias, prediction.
template <typename Exec>
class golden_inertial {
public:
  golden_inertial(Exec const& exec, std::string folder) : exec_(exec), folder_(std::move(folder)) {}

  void run(conformance_table& table) const {
    if (is_inertial_chain(folder_)) {
      run_chain(table, inertial_chain(folder_));
    } else {
      run_cases(table, preintegration_cases(folder_));
    }
  }

private:
  /// As the reference: however long samples are missing.
  static ft::selection_params any_gap() {
    ft::selection_params params;
    params.longest_gap_s = HUGE_VAL;
    return params;
  }
  static ft::imu_step step_at(npy<float> const& steps, int i) {
    return {{steps(i, 0), steps(i, 1), steps(i, 2)},
            {steps(i, 3), steps(i, 4), steps(i, 5)},
            steps(i, 6)};
  }
  static std::vector<ft::imu_sample> samples_of(npy<double> const& imu) {
    std::vector<ft::imu_sample> samples;
    for (int i = 0; i < imu.rows(); ++i) { samples.push_back(sample_at(imu, i)); }
    return samples;
  }

  struct selected {
    ft::imu_selection chosen;
    std::vector<ft::imu_step> steps;
  };
  /// Selects the samples of one interval.
  selected select(std::vector<ft::imu_sample> const& samples,
                  ft::imu_interval const& interval) const {
    int const capacity = std::max(interval.count, 1);
    auto const queue = to_exec(exec_, samples);
    auto const between = to_exec(exec_, std::vector<ft::imu_interval>{interval});
    ft::buffer<ft::imu_selection, Exec::space> chosen(1);
    ft::buffer<ft::imu_step, Exec::space> steps(static_cast<std::size_t>(capacity));
    ft::select_samples(exec_, queue.data(), between.data(), any_gap(),
                       {1, capacity, chosen.data(), steps.data()});
    selected out;
    out.chosen = from_exec(exec_, chosen.data(), 1)[0];
    out.steps = from_exec(exec_, steps.data(), static_cast<std::size_t>(out.chosen.steps));
    return out;
  }

  /// Integrals of recorded steps. @param before integrals that run on
  std::vector<ft::preintegrated> integrate(npy<float> const& steps, int first, int count,
                                           std::vector<ft::integral_start> const& starts,
                                           std::vector<ft::preintegrated> const& before,
                                           ft::imu_variances const& noise) const {
    std::vector<ft::imu_step> list;
    for (int i = 0; i < count; ++i) { list.push_back(step_at(steps, first + i)); }
    auto const status =
        count > 0 ? ft::integration_status::integrated : ft::integration_status::no_steps;
    auto const chosen =
        to_exec(exec_, std::vector<ft::imu_selection>{{0, count + 1, count, count, status}});
    auto const d_steps = to_exec(exec_, list);
    auto const d_starts = to_exec(exec_, starts);
    auto const integrals = to_exec(exec_, before);
    ft::preintegrate(exec_, {1, count, chosen.data(), d_steps.data()},
                     {d_starts.data(), static_cast<int>(starts.size())}, noise, integrals.data());
    return from_exec(exec_, integrals.data(), before.size());
  }

  static void compare_steps(stage_result& r, selected const& got, npy<float> const& want, int first,
                            int count) {
    r.add(got.chosen.steps == count);
    for (int i = 0; i < std::min(count, got.chosen.steps); ++i) {
      ft::imu_step const a = got.steps[static_cast<std::size_t>(i)];
      ft::imu_step const b = step_at(want, first + i);
      add_within(r,
                 std::max({distance(a.accel, b.accel), distance(a.gyro, b.gyro),
                           std::abs(static_cast<double>(a.dt - b.dt))}),
                 1e-6);
    }
  }

  static void compare_integral(conformance_table& table, ft::preintegrated const& got,
                               ft::preintegrated const& want) {
    auto& motion = table["preintegration"];
    add_within(motion, std::abs(static_cast<double>(got.dT - want.dT)), 1e-6);
    add_within(motion, angle_between(got.dR, want.dR), 1e-5);
    add_within(motion, distance(got.dV, want.dV), 3e-5);
    add_within(motion, distance(got.dP, want.dP), 1e-5);
    add_within(motion, distance(got.mean_accel, want.mean_accel), 1e-4);
    add_within(motion, distance(got.mean_gyro, want.mean_gyro), 1e-4);
    auto& derivatives = table["integral_derivatives"];
    for (auto const J : {&ft::preintegrated::JRg, &ft::preintegrated::JVg, &ft::preintegrated::JVa,
                         &ft::preintegrated::JPg, &ft::preintegrated::JPa}) {
      add_within(derivatives, relative_distance((got.*J).m, (want.*J).m, 9), 2e-4);
    }
    auto& covariance = table["integral_covariance"];
    add_within(covariance, covariance_distance(got.C, want.C, 9), 1e-5);
    add_within(covariance, relative_distance(got.walk, want.walk, 6), 1e-5);
  }

  void run_chain(conformance_table& table, inertial_chain const& chain) const {
    auto const samples = samples_of(chain.imu);
    int front = 0;
    std::vector<ft::preintegrated> integrals(2);
    for (int s = 0; s < chain.count(); ++s) {
      int end = front;
      while (end < chain.imu.rows() && chain.imu(end, 0) <= chain.times(s + 1) + 0.02) { ++end; }
      auto const got = select(samples, {chain.times(s), chain.times(s + 1), front, end - front});
      front += got.chosen.removed;
      compare_steps(table["imu_samples"], got, chain.steps, chain.first_step(s),
                    chain.step_count(s));

      int const anew = static_cast<int>(chain.first_since_keyframe(s) == s);
      integrals =
          integrate(chain.steps, chain.first_step(s), chain.step_count(s),
                    {{0, 1, chain.from_frame.bias(s)}, {0, anew, chain.from_keyframe.bias(s)}},
                    integrals, chain.calibration.variances);
      compare_integral(table, integrals[0], chain.frame_integral(s));
      compare_integral(table, integrals[1], chain.keyframe_integral(s));
    }
    compare_predictions(table["imu_prediction"], chain);
  }

  void compare_predictions(stage_result& r, inertial_chain const& chain) const {
    auto const count = static_cast<std::size_t>(chain.count());
    std::vector<ft::prediction_start> starts;
    std::vector<ft::preintegrated> integrals;
    for (int s = 0; s < chain.count(); ++s) {
      bool const from_keyframe = chain.mode(s) == 0;
      starts.push_back({state_at(from_keyframe ? chain.kf_state : chain.lf_state, s).stored, s});
      integrals.push_back(from_keyframe ? chain.keyframe_integral(s) : chain.frame_integral(s));
    }
    auto const d_starts = to_exec(exec_, starts);
    auto const d_integrals = to_exec(exec_, integrals);
    ft::buffer<ft::predicted_state, Exec::space> out(count);
    auto const& mount = chain.calibration.mount;
    ft::predict_states(exec_, {d_starts.data(), chain.count()}, d_integrals.data(), mount,
                       out.data());
    auto const got = from_exec(exec_, out.data(), count);
    for (int s = 0; s < chain.count(); ++s) {
      auto const& predicted = got[static_cast<std::size_t>(s)];
      auto const body = ft::body_state(predicted.frame, mount);
      auto const want = state_at(chain.pred_state, s).body;
      r.add(predicted.status == ft::integration_status::integrated);
      add_within(r, angle_between(body.R, want.R), 3e-6);
      add_within(r, distance(body.p, want.p), 3e-6);
      add_within(r, distance(body.v, want.v), 5e-6);
      r.add(distance(body.bg, want.bg) == 0 && distance(body.ba, want.ba) == 0);
    }
  }

  void run_cases(conformance_table& table, preintegration_cases const& cases) const {
    auto const samples = samples_of(cases.imu);
    auto const& noise = cases.calibration.variances;
    for (int i = 0; i < cases.count(); ++i) {
      int const queued = cases.imu_start(i + 1) - cases.imu_start(i);
      auto const got = select(samples, {cases.t(i, 0), cases.t(i, 1), cases.imu_start(i), queued});
      auto& r = table["imu_samples"];
      compare_steps(r, got, cases.steps, cases.steps_start(i), cases.step_count(i));
      bool const made =
          usable(got.chosen.status) || got.chosen.status == ft::integration_status::no_steps;
      r.add(got.chosen.taken == cases.status(i, 0));
      r.add(queued - got.chosen.removed == cases.status(i, 1));
      r.add(static_cast<int>(made) == cases.status(i, 2));
      r.add(static_cast<int>(got.chosen.marks_frame()) == cases.status(i, 3));
      if (cases.status(i, 2) == 0) { continue; }
      int const steps = cases.step_count(i);
      auto const integrals = integrate(cases.steps, cases.steps_start(i), steps,
                                       {{0, 1, cases.bias_of(i, 0)}, {0, 1, cases.bias_of(i, 1)}},
                                       std::vector<ft::preintegrated>(2), noise);
      auto const from_frame = cases.from_frame.at(i, steps);
      compare_integral(table, integrals[0], from_frame);
      compare_integral(table, integrals[1], cases.from_keyframe.at(i, steps));
      compare_bias(table["changed_bias"], from_frame, cases, i);
    }
  }

  void compare_bias(stage_result& r, ft::preintegrated const& integral,
                    preintegration_cases const& cases, int i) const {
    auto const d_integral = to_exec(exec_, std::vector<ft::preintegrated>{integral});
    auto const d_bias = to_exec(exec_, std::vector<ft::imu_bias>{cases.bias_of(i, 2)});
    ft::buffer<ft::preintegrated_motion, Exec::space> out(1);
    ft::for_each_item<ft::per_thread>(exec_, 1, change_recorded_bias{},
                                      static_cast<ft::preintegrated const*>(d_integral.data()),
                                      static_cast<ft::imu_bias const*>(d_bias.data()), out.data());
    auto const got = from_exec(exec_, out.data(), 1)[0];
    float const* const want = inertial_detail::row(cases.upd, i);
    add_within(r, angle_between(got.dR, inertial_detail::matrix_at(want)), 1e-5);
    add_within(r, distance(got.dV, inertial_detail::vector_at(want + 9)), 3e-5);
    add_within(r, distance(got.dP, inertial_detail::vector_at(want + 12)), 1e-5);
  }

  Exec exec_;
  std::string folder_;
};

}  // namespace test
