// SPDX-License-Identifier: Apache-2.0
/// @file The inertial runner, instantiated once per executor: poses with an IMU, and integrals.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "bench/camera_runner.hpp"
#include "bench/clock.hpp"
#include "bench/owned_executor.hpp"
#include "bench/runner.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/inertial.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/recording.hpp"
#include "ft/kernels/inertial/optimize_inertial_pose.hpp"
#include "ft/kernels/inertial/preintegrate.hpp"
#include "ft/kernels/inertial/stored_state.hpp"

namespace bench {
inline namespace FT_ABI {

/// Problems of one frame each: a rectified pair that moves with an IMU in front of points, seen
/// with noise of a pixel and a tenth of them wrongly. Solved again and again from the same start.
template <typename Exec>
class inertial_runner_of final : public inertial_runner {
public:
  explicit inertial_runner_of(inertial_case const& what)
      : owned_(what.host_threads),
        what_(what),
        here_([&](ft::carver& c) { carve(c, from_); }),
        there_([&](ft::carver& c) {
          carve(c, to_);
          result_ = c.take<ft::inertial_pose_result>(problems());
          next_ = c.take<ft::inertial_prior>(problems());
          outlier_ = c.take<unsigned char>(places());
          chi2_ = c.take<float>(places() * ft::inertial_rounds);
        }) {
    for (int b = 0; b < what_.problems; ++b) { draw(b); }
    copy();
    graph_.record(owned_.exec, [&](auto const& exec) { queue(exec); });
  }

  double run() override {
    time_.begin(owned_.exec);
    graph_.replay(owned_.exec, [&](auto const& exec) { queue(exec); });
    return time_.end(owned_.exec);
  }
  double inlier_share() override {
    if (what_.observations == 0) { return 1; }
    std::vector<ft::inertial_pose_result> results(problems());
    ft::copy(owned_.exec, results.data(), static_cast<ft::inertial_pose_result const*>(result_),
             problems());
    owned_.exec.wait();
    double least = 1;
    for (auto const& r : results) {
      bool const good = r.status == ft::inertial_pose_status::optimised;
      least = std::min(least, good ? static_cast<double>(r.tracked) / what_.observations : 0.0);
    }
    return least;
  }

private:
  static constexpr float step_s = 0.005f;

  struct arrays {
    int* from_last_frame;
    int* count;
    ft::stored_inertial_state *first, *start;
    ft::preintegrated* integral;
    ft::inertial_prior* prior;
    ft::observation* observations;
    float* distance;
    ft::imu_selection* chosen;
    ft::imu_step* steps;
    ft::integral_start* starts;
  };
  std::size_t problems() const { return static_cast<std::size_t>(what_.problems); }
  std::size_t places() const { return problems() * static_cast<std::size_t>(what_.observations); }
  std::size_t all_steps() const { return problems() * static_cast<std::size_t>(what_.steps); }

  void carve(ft::carver& c, arrays& a) const {
    a.from_last_frame = c.take<int>(problems());
    a.count = c.take<int>(problems());
    a.first = c.take<ft::stored_inertial_state>(problems());
    a.start = c.take<ft::stored_inertial_state>(problems());
    a.integral = c.take<ft::preintegrated>(problems());
    a.prior = c.take<ft::inertial_prior>(problems());
    a.observations = c.take<ft::observation>(places());
    a.distance = c.take<float>(places());
    a.chosen = c.take<ft::imu_selection>(problems());
    a.steps = c.take<ft::imu_step>(all_steps());
    a.starts = c.take<ft::integral_start>(problems());
  }
  void copy() {
    auto const move = [&](auto* to, auto const* from, std::size_t n) {
      ft::copy(owned_.exec, to, from, n);
    };
    move(to_.from_last_frame, from_.from_last_frame, problems());
    move(to_.count, from_.count, problems());
    move(to_.first, from_.first, problems());
    move(to_.start, from_.start, problems());
    move(to_.integral, from_.integral, problems());
    move(to_.prior, from_.prior, problems());
    move(to_.observations, from_.observations, places());
    move(to_.distance, from_.distance, places());
    move(to_.chosen, from_.chosen, problems());
    move(to_.steps, from_.steps, all_steps());
    move(to_.starts, from_.starts, problems());
    owned_.exec.wait();
  }

  void draw(int b) {
    int const n = what_.steps;
    ft::imu_step* const steps = from_.steps + static_cast<std::ptrdiff_t>(b) * n;
    for (int i = 0; i < n; ++i) {
      auto const f = [&](int k) { return 0.2f * static_cast<float>(noise(b, i, k)); };
      steps[i] = {{f(1), f(2), 9.81f + f(3)}, {f(4), f(5), f(6)}, step_s};
    }
    from_.chosen[b] = {0, n + 1, n, n, ft::integration_status::integrated};
    from_.starts[b] = {b, 1, {{0, 0, 0}, {0, 0, 0}}};
    ft::integral_start const alone{0, 1, {{0, 0, 0}, {0, 0, 0}}};
    ft::preintegrate(ft::host_exec(1), {1, n, from_.chosen + b, steps}, {&alone, 1}, variances(),
                     from_.integral + b);
    ft::preintegrated const& integral = from_.integral[b];
    // The body begins at rest, upright, in the world's origin; its camera looks along y.
    ft::vec3<float> const fall{0, 0, -9.81f * integral.dT * integral.dT / 2};
    ft::inertial_state<float> first{
        ft::mat3<float>::identity(), {0, 0, 0}, {0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
    ft::inertial_state<float> frame = first;
    frame.R = integral.dR;
    frame.p = integral.dP + fall;
    frame.v = integral.dV + ft::vec3<float>{0, 0, -9.81f * integral.dT};
    from_.first[b] = ft::stored_state(first, mount_);
    observe(b, ft::stored_state(frame, mount_));
    frame.p = frame.p + ft::vec3<float>{0.01f, -0.01f, 0.01f};
    from_.start[b] = ft::stored_state(frame, mount_);
    from_.from_last_frame[b] = what_.from_last_frame ? 1 : 0;
    from_.count[b] = what_.observations;
    ft::inertial_prior& prior = from_.prior[b];
    prior = {};
    prior.known = 1;
    prior.state.R = ft::mat3<double>::identity();
    prior.state.p = prior.state.v = prior.state.bg = prior.state.ba = {0, 0, 0};
    constexpr double deviation[5] = {2e-3, 5e-3, 2e-2, 1e-3, 2e-2};
    for (int k = 0; k < 15; ++k) {
      prior.information[16 * k] = 1 / (deviation[k / 3] * deviation[k / 3]);
    }
  }
  void observe(int b, ft::stored_inertial_state const& at) {
    auto const camera = rig_.camera.template cast<double>();
    ft::quaternion<double> const q{at.q_cw.x, at.q_cw.y, at.q_cw.z, at.q_cw.w};
    ft::rigid<double> const T_cw{ft::detail::rotation_of(q), at.t_cw.template cast<double>()};
    for (int i = 0; i < what_.observations; ++i) {
      double const z = 2 + 12 * uniform(key(b, i), 1);
      ft::vec3<double> const p{0.7 * z * noise(b, i, 12), 0.45 * z * noise(b, i, 13), z};
      auto const pixel = camera.project(p).pixel;
      double const wrong = i % 10 == 0 ? 25 : 0;
      double const u = pixel.x + noise(b, i, 14) + wrong;
      double const right = u - static_cast<double>(rig_.bf()) / z;
      auto const k = static_cast<std::ptrdiff_t>(b) * what_.observations + i;
      from_.observations[k] = {(T_cw.inverse() * p).template cast<float>(),
                               static_cast<float>(u),
                               static_cast<float>(pixel.y + noise(b, i, 15)),
                               i % 3 == 0 || right < 0 ? -1.0f : static_cast<float>(right),
                               1.0f,
                               0};
      from_.distance[k] = static_cast<float>(std::sqrt(dot(p, p)));
    }
  }
  static std::uint64_t key(int b, int i) {
    return static_cast<std::uint64_t>(b) << 32 | static_cast<std::uint64_t>(i);
  }
  /// Uniform in [-1, 1).
  static double noise(int b, int i, int number) {
    return 2 * uniform(key(b, i), static_cast<std::uint64_t>(number)) - 1;
  }
  static ft::imu_variances variances() {
    ft::imu_variances v{};
    for (int k = 0; k < 3; ++k) {
      v.measured[k] = 5.8e-6f;
      v.measured[3 + k] = 8e-4f;
      v.walk[k] = 1.9e-12f;
      v.walk[3 + k] = 4.5e-8f;
    }
    return v;
  }

  template <typename E>
  void queue(E const& exec) const {
    if (what_.observations == 0) {
      ft::preintegrate(exec, {what_.problems, what_.steps, to_.chosen, to_.steps},
                       {to_.starts, what_.problems}, variances(), to_.integral);
      return;
    }
    ft::optimize_inertial_poses(
        exec, rig_, mount_,
        {what_.problems, what_.observations, to_.from_last_frame, to_.first, to_.start,
         to_.integral, nullptr, to_.integral, to_.prior, to_.observations, to_.distance, to_.count,
         result_, next_, outlier_, chi2_});
  }

  owned_executor<Exec> owned_;
  inertial_case what_;
  ft::rectified_rig rig_ = ft::rectified_rig::make({435.0f, 435.0f, 367.2f, 252.2f}, 0.11);
  /// The camera looks along the body's y axis; its y axis points down.
  ft::imu_mount mount_{{{{1, 0, 0, 0, 0, 1, 0, -1, 0}}, {0.05f, 0.02f, 0}},
                       {{{1, 0, 0, 0, 0, -1, 0, 1, 0}}, {-0.05f, 0, -0.02f}}};
  arrays from_, to_;
  ft::inertial_pose_result* result_;
  ft::inertial_prior* next_;
  unsigned char* outlier_;
  float* chi2_;
  ft::arena<ft::memory_space::host> here_;
  ft::arena<Exec::space> there_;
  ft::recording<Exec> graph_;
  interval<Exec> time_;
};

}  // namespace FT_ABI

std::unique_ptr<inertial_runner> make_host_inertial(inertial_case const& what);
std::unique_ptr<inertial_runner> make_cuda_inertial(inertial_case const& what);

}  // namespace bench
