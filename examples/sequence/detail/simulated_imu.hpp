// SPDX-License-Identifier: Apache-2.0
/// @file Bias and noise of a simulated IMU. Not API.
///
/// Source of the model, and of the discrete variances: Crassidis, "Sigma-point Kalman filtering for
/// integrated GPS and inertial navigation", 2006.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "examples/sequence/detail/random.hpp"
#include "examples/sequence/types.hpp"

namespace seq::detail {

struct imu_biases {
  Eigen::Vector3d gyro;   ///< rad/s
  Eigen::Vector3d accel;  ///< m/s^2
};

/// White noise and biases that walk at random. The same numbers on every run.
struct simulated_imu {
  imu_noise noise;
  double rate_hz;
  double gyro_bias;   ///< standard deviation of an axis' first bias, rad/s
  double accel_bias;  ///< likewise, m/s^2
  std::uint64_t seed;

  /// At each of `count` samples.
  std::vector<imu_biases> biases(std::size_t count) const {
    random_stream random(key(seed, 101));
    double const root = std::sqrt(1.0 / rate_hz);
    imu_biases now;
    now.gyro = gyro_bias * draw(random);
    now.accel = accel_bias * draw(random);
    std::vector<imu_biases> out;
    for (std::size_t i = 0; i < count; ++i) {
      out.push_back(now);
      now.gyro += noise.gyro_walk * root * draw(random);
      now.accel += noise.accel_walk * root * draw(random);
    }
    return out;
  }

  /// Adds biases and noise to ideal samples.
  void add_to(std::vector<imu_sample>& samples) const {
    auto const b = biases(samples.size());
    random_stream random(key(seed, 102));
    double const root = std::sqrt(rate_hz);
    for (std::size_t i = 0; i < samples.size(); ++i) {
      samples[i].gyro += b[i].gyro + noise.gyro * root * draw(random);
      samples[i].accel += b[i].accel + noise.accel * root * draw(random);
    }
  }

private:
  static Eigen::Vector3d draw(random_stream& random) {
    double const x = random.gaussian();
    double const y = random.gaussian();
    double const z = random.gaussian();
    return {x, y, z};
  }
};

}  // namespace seq::detail
