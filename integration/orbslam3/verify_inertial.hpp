// SPDX-License-Identifier: Apache-2.0
/// @file Poses with an IMU by CPU and GPU from the same state, and their comparison.
#pragma once

#include <cmath>
#include <cstddef>
#include <limits>
#include <memory>
#include <type_traits>
#include <utility>
#include <vector>

#include "integration/orbslam3/inertial_poses.hpp"
#include "integration/orbslam3/verify_report.hpp"

namespace ft {
namespace orbslam3 {

/// What an inertial optimisation changes in a frame and in the last one, so that it can be made
/// several times from the same state.
template <typename Frame>
class inertial_trials {
  using constraint = std::remove_pointer_t<decltype(Frame::mpcpi)>;
  using pose = std::decay_t<decltype(std::declval<Frame&>().GetPose())>;
  using velocity = std::decay_t<decltype(std::declval<Frame&>().GetVelocity())>;

public:
  /// What an optimisation left.
  struct outcome {
    int tracked = 0;
    pose T_cw;
    velocity v;
    decltype(Frame::mImuBias) bias;
    std::vector<bool> outliers;
    std::unique_ptr<constraint> prior;
    bool last_prior_used = false;
    imu_state state{};
  };

  explicit inertial_trials(Frame& frame)
      : frame_(&frame),
        last_(frame.mpPrevFrame),
        last_prior_(last_ == nullptr ? nullptr : last_->mpcpi),
        before_(outcome_of(0)) {}

  /// Makes an optimisation and puts all back.
  template <typename Call>
  outcome run(Call const& call) {
    if (last_prior_ != nullptr) { last_->mpcpi = new constraint(*last_prior_); }
    constraint* const own = std::exchange(frame_->mpcpi, nullptr);
    outcome result = outcome_of(call());
    result.prior.reset(std::exchange(frame_->mpcpi, own));
    put(before_);
    if (last_prior_ != nullptr) {
      result.last_prior_used = last_->mpcpi == nullptr;
      delete std::exchange(last_->mpcpi, last_prior_);
    }
    return result;
  }
  /// Leaves in the frames what an optimisation left.
  void keep(outcome& o) {
    put(o);
    if (o.prior != nullptr) { frame_->mpcpi = o.prior.release(); }
    if (o.last_prior_used) { delete std::exchange(last_->mpcpi, nullptr); }
  }

private:
  outcome outcome_of(int tracked) {
    outcome o;
    o.tracked = tracked;
    o.T_cw = frame_->GetPose();
    o.v = frame_->GetVelocity();
    o.bias = frame_->mImuBias;
    o.outliers = frame_->mvbOutlier;
    o.state = state_of(*frame_);
    return o;
  }
  void put(outcome const& o) {
    frame_->SetPose(o.T_cw);
    frame_->SetVelocity(o.v);
    frame_->mImuBias = o.bias;
    frame_->mvbOutlier = o.outliers;
  }

  Frame* frame_;
  std::decay_t<decltype(Frame::mpPrevFrame)> last_;
  constraint* last_prior_;
  outcome before_;
};

/// Adds what differs between two answers of the CPU and one of the accelerator.
template <typename Outcome>
class inertial_comparison {
public:
  inertial_comparison(difference_log& log, tolerances const& t, Outcome const& cpu,
                      Outcome const& again, Outcome const& gpu)
      : log_(&log), t_(t), cpu_(cpu), again_(again), gpu_(gpu) {}

  /// @param points of the keypoints @param steps of the integral. Of a single one the information
  /// about velocity and position is rounding errors.
  template <typename MapPoint>
  void add(std::vector<MapPoint*> const& points, int steps) const {
    log_->compare("observations without outliers", -1, cpu_.tracked, again_.tracked, gpu_.tracked);
    for (std::size_t i = 0; i < points.size(); ++i) {
      if (points[i] == nullptr) { continue; }
      log_->compare("outlier", static_cast<long>(i), cpu_.outliers[i], again_.outliers[i],
                    gpu_.outliers[i]);
    }
    transform const a = transform_of(cpu_.T_cw);
    transform const b = transform_of(again_.T_cw);
    transform const g = transform_of(gpu_.T_cw);
    add_numbers("rotation entry", a.R, b.R, g.R, t_.turn);
    add_numbers("translation entry", a.t, b.t, g.t, t_.position);
    imu_state const& x = cpu_.state;
    imu_state const& y = again_.state;
    imu_state const& z = gpu_.state;
    add_numbers("velocity entry", x.velocity, y.velocity, z.velocity, t_.velocity);
    add_numbers("gyro bias entry", x.gyro_bias, y.gyro_bias, z.gyro_bias, t_.gyro_bias);
    add_numbers("accelerometer bias entry", x.accel_bias, y.accel_bias, z.accel_bias,
                t_.accel_bias);
    log_->compare("prior for the next frame", -1, cpu_.prior != nullptr, again_.prior != nullptr,
                  gpu_.prior != nullptr);
    if (steps != 1 && cpu_.prior && again_.prior && gpu_.prior) { add_information(); }
  }

private:
  template <int N>
  void add_numbers(char const* what, float const (&cpu)[N], float const (&again)[N],
                   float const (&gpu)[N], double allowed) const {
    constexpr double roundings = 2 * std::numeric_limits<float>::epsilon();
    for (int i = 0; i < N; ++i) {
      double const size = std::abs(static_cast<double>(cpu[i]));
      log_->compare(what, i, cpu[i], again[i], gpu[i], allowed + roundings * size);
    }
  }
  void add_information() const {
    imu_prior const a = prior_of(*cpu_.prior);
    imu_prior const b = prior_of(*again_.prior);
    imu_prior const g = prior_of(*gpu_.prior);
    for (int i = 0; i < 225; ++i) {
      double const size = std::sqrt(a.information[i / 15 * 16] * a.information[i % 15 * 16]);
      log_->compare("information entry", i, a.information[i], b.information[i], g.information[i],
                    t_.information * size);
    }
  }

  difference_log* log_;
  tolerances t_;
  Outcome const& cpu_;
  Outcome const& again_;
  Outcome const& gpu_;
};

}  // namespace orbslam3
}  // namespace ft
