// SPDX-License-Identifier: Apache-2.0
/// @file Runs the pose optimisation with an IMU on the recorded inputs of a folder of
/// golden_inertial, step by step and chained on its own results, and counts what is within the
/// tolerances of its specification.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/inertial.hpp"
#include "ft/kernels/inertial/optimize_inertial_pose.hpp"
#include "tests/conformance/golden_sequence.hpp"
#include "tests/conformance/inertial_case.hpp"
#include "tests/conformance/inertial_steps.hpp"
#include "tests/support/inertial_poses.hpp"
#include "tests/support/memory.hpp"

namespace test {

/// The optimisations of a chain on one executor.
template <typename Exec>
class golden_inertial_pose {
public:
  golden_inertial_pose(Exec const& exec, inertial_chain const& chain)
      : exec_(exec), chain_(chain) {}

  void run(conformance_table& table) const {
    auto const& p = chain_.calibration.camera;
    if (chain_.calibration.family == "fisheye") {
      using camera = ft::kannala_brandt<float>;
      auto const at = [&](std::size_t k) {
        return camera{p.at(k),     p.at(k + 1), p.at(k + 2), p.at(k + 3),
                      p.at(k + 4), p.at(k + 5), p.at(k + 6), p.at(k + 7)};
      };
      run_rig(table, ft::stereo_rig<camera, camera>{at(0), at(8), chain_.calibration.T_rl});
    } else {
      ft::pinhole<float> const camera{p.at(0), p.at(1), p.at(2), p.at(3)};
      double const bf = static_cast<double>(chain_.calibration.bf);
      run_rig(table, ft::rectified_rig{camera, bf / static_cast<double>(camera.fx)});
    }
  }

private:
  template <typename Rig>
  void run_rig(conformance_table& table, Rig const& rig) const {
    inertial_pose_batch all;
    for (int s = 0; s < chain_.count(); ++s) { add_recorded_step(all, chain_, s); }
    optimize(exec_, rig, chain_.calibration.mount, quirks(), all);
    for (int s = 0; s < chain_.count(); ++s) { compare_step(table, all, s); }
    run_chained(table["inertial_pose_chained"], rig);
  }
  static ft::inertial_pose_params quirks() {
    ft::inertial_pose_params params;
    params.reference_quirks = true;
    return params;
  }

  /// Whether a round judged observation i of step s by an error within 0.1 % of a limit.
  bool is_close(int s, int i) const {
    constexpr double limits[] = {5.991, 7.5,         7.815,     9.8,        12.0,
                                 15.6,  1.5 * 5.991, 1.5 * 7.5, 1.5 * 12.0, 24.0};
    for (int r = 0; r < chain_.rounds(s); ++r) {
      for (double const limit : limits) {
        double const c = static_cast<double>(chain_.chi2(chain_.obs_start(s) + i, r));
        if (std::abs(c - limit) < 1e-3 * limit) { return true; }
      }
    }
    return false;
  }

  /// Flags, numbers and rounds. Those that an error at its limit decides may differ.
  void compare_decisions(stage_result& r, inertial_pose_batch const& got, std::size_t b,
                         int s) const {
    int differ = 0;
    for (int i = 0; i < got.count[b]; ++i) {
      bool const same = got.outlier[got.at(b, i)] == chain_.outlier(chain_.obs_start(s) + i);
      differ += static_cast<int>(!same);
      r.add(same || is_close(s, i));
    }
    auto const& result = got.result[b];
    r.add(std::abs(result.tracked - chain_.ret(s)) <= differ);
    r.add(result.rounds == chain_.rounds(s));
    r.add(result.status == ft::inertial_pose_status::optimised);
  }

  static void compare_states(stage_result& r, ft::inertial_state<double> const& got,
                             ft::inertial_state<double> const& want,
                             inertial_state_distance const& limit) {
    auto const d = distance_between(got, want);
    add_difference(r, d.turn, limit.turn);
    add_difference(r, d.position, limit.position);
    add_difference(r, d.velocity, limit.velocity);
    add_difference(r, d.gyro_bias, limit.gyro_bias);
    add_difference(r, d.accel_bias, limit.accel_bias);
  }
  /// A difference that is not a number is outside any tolerance.
  static void add_difference(stage_result& r, double difference, double tolerance) {
    r.add(difference <= tolerance, difference);
  }
  ft::inertial_state<double> widened(ft::stored_inertial_state const& s) const {
    return wide_state_of(s, chain_.calibration.mount);
  }

  void compare_step(conformance_table& table, inertial_pose_batch const& got, int s) const {
    auto const b = static_cast<std::size_t>(s);
    compare_decisions(table["inertial_pose_flags"], got, b, s);
    auto const& result = got.result[b];
    auto& states = table["inertial_pose"];
    inertial_state_distance const limit{2e-6, 2e-6, 1e-5, 1e-8, 3e-6};
    for (int r = 0; r < std::min(result.rounds, chain_.rounds(s)); ++r) {
      compare_states(states, result.round_state[r], wide_state_at(&chain_.round_state(s, 21 * r)),
                     limit);
      for (int i = 0; i < got.count[b]; ++i) {
        double const want = static_cast<double>(chain_.chi2(chain_.obs_start(s) + i, r));
        double const apart = std::abs(static_cast<double>(got.chi2_of(b, r, i)) - want);
        add_difference(states, apart / (1 + want), 1e-3);
      }
    }
    compare_states(states, widened(result.stored), widened(state_at(chain_.out_state, s).stored),
                   limit);
    auto const want = chain_.prior(s, true);
    auto const& prior = got.next_prior[b];
    compare_states(states, prior.state, want.state, limit);
    // Of an integral of one step the information about velocity and position is rounding errors.
    if (got.integral[b].steps == 1) { return; }
    double worst = 0;
    for (int i = 0; i < 15; ++i) {
      for (int j = 0; j < 15; ++j) {
        double const d = std::abs(prior.information[15 * i + j] - want.information[15 * i + j]);
        double const size = std::sqrt(want.information[16 * i] * want.information[16 * j]);
        if (d != 0) { worst = std::max(worst, d / size); }
      }
    }
    add_difference(table["inertial_prior"], worst, 2e-6);
  }

  /// Each step from the results of the one before it.
  template <typename Rig>
  void run_chained(stage_result& r, Rig const& rig) const {
    ft::stored_inertial_state last{};
    ft::inertial_prior prior{};
    for (int s = 0; s < chain_.count(); ++s) {
      inertial_pose_batch one;
      add_recorded_step(one, chain_, s);
      if (s > 0 && chain_.mode(s) != 0) {
        one.first[0] = last;
        one.prior[0] = prior;
      }
      optimize(exec_, rig, chain_.calibration.mount, quirks(), one);
      compare_decisions(r, one, 0, s);
      last = one.result[0].stored;
      prior = one.next_prior[0];
      compare_states(r, widened(last), widened(state_at(chain_.out_state, s).stored),
                     {3e-5, 2e-4, 1e-3, 1e-6, 1e-3});
    }
  }

  Exec exec_;
  inertial_chain const& chain_;
};

struct invert_covariance {
  using scratch = ft::detail::information_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int i, ft::preintegrated const* integrals,
                                 ft::strict_double* out) const {
    ft::detail::information_of(g, s, integrals[i], true, out + 81 * i);
  }
};

/// Information matrices of recorded covariances.
template <typename Exec>
void compare_information(Exec const& exec, stage_result& r, preintegration_cases const& cases) {
  std::vector<ft::preintegrated> integrals;
  std::vector<int> numbers;
  for (int i = 0; i < cases.count(); ++i) {
    if (cases.step_count(i) == 0 || !std::isfinite(cases.info(i, 0))) { continue; }
    integrals.push_back(cases.from_frame.at(i, cases.step_count(i)));
    numbers.push_back(i);
  }
  auto const d_integrals = to_exec(exec, integrals);
  ft::buffer<ft::strict_double, Exec::space> out(81 * integrals.size());
  ft::for_each_item<ft::per_block<ft::sum_lanes>>(
      exec, static_cast<int>(integrals.size()), invert_covariance{},
      static_cast<ft::preintegrated const*>(d_integrals.data()), out.data());
  auto const got = from_exec(exec, out.data(), 81 * integrals.size());
  for (std::size_t k = 0; k < numbers.size(); ++k) {
    double worst = 0;
    for (int e = 0; e < 81; ++e) {
      double const want = cases.info(numbers[k], e);
      double const size =
          std::sqrt(cases.info(numbers[k], e / 9 * 10) * cases.info(numbers[k], e % 9 * 10));
      double const d = std::abs(got[81 * k + static_cast<std::size_t>(e)].value - want);
      if (d != 0) { worst = std::max(worst, d / size); }
    }
    // Three eigenvalues of a single step's covariance are rounding errors. Where they are negative,
    // the reference's matrix with a condition number of 1e20 has errors of 1e-4 of its own.
    bool const one_step = integrals[k].steps == 1;
    r.add(worst <= (one_step ? 1e-3 : 1e-9), one_step ? 0 : worst);
  }
}

/// What a folder of golden_inertial has of information matrices and optimised poses.
template <typename Exec>
void run_inertial_poses(Exec const& exec, std::string const& folder, conformance_table& table) {
  if (is_inertial_chain(folder)) {
    inertial_chain const chain(folder);
    golden_inertial_pose<Exec>(exec, chain).run(table);
  } else {
    compare_information(exec, table["imu_information"], preintegration_cases(folder));
  }
}

}  // namespace test
