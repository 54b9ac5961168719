// SPDX-License-Identifier: Apache-2.0
/// @file Poses with an IMU as plain structures, the same for every compiler.
#pragma once

#include "integration/orbslam3/plain_types.hpp"

namespace ft {
namespace orbslam3 {

/// A body's motion as a frame stores it, and the biases of its IMU.
struct imu_state {
  float rotation[4];    ///< of T_cw, as a unit quaternion: x, y, z, w
  float t_cw[3];        ///< metres
  float velocity[3];    ///< of the body in the world, m/s
  float gyro_bias[3];   ///< rad/s
  float accel_bias[3];  ///< m/s^2
};

/// IMU::Preintegrated; matrices row-major.
struct imu_integral {
  float dT;  ///< seconds
  float dR[9];
  float dV[3];
  float dP[3];
  float JRg[9], JVg[9], JVa[9], JPg[9], JPa[9];
  float C[81];    ///< the first nine rows and columns of the original's C
  float walk[6];  ///< the other six numbers of its diagonal
  float gyro_bias[3];
  float accel_bias[3];
  float mean_accel[3];
  float mean_gyro[3];
  int steps;  ///< 0: nothing was integrated
};

/// ConstraintPoseImu: a body's state and its information, row-major in the order rotation,
/// position, velocity, gyro bias, accelerometer bias.
struct imu_prior {
  double R[9];  ///< body to world
  double p[3];  ///< metres
  double v[3];
  double gyro_bias[3];
  double accel_bias[3];
  double information[225];
};

struct inertial_request {
  int buffer = 0;
  bool from_last_frame = false;  ///< otherwise from the last keyframe
  transform T_bc;                ///< left camera to body
  transform T_cb;
  imu_state first{};              ///< of the last keyframe or the last frame
  imu_state start{};              ///< of the frame, predicted
  imu_integral integral{};        ///< from `first` to the frame
  imu_integral since_keyframe{};  ///< likewise from the last keyframe
  imu_prior prior{};              ///< of the last frame, if from there
};

struct inertial_result {
  bool refused = false;  ///< integrals of nothing, or numbers that are not finite
  int tracked = 0;       ///< observations without outliers
  imu_state state{};
  imu_prior prior{};  ///< for the next frame
};

}  // namespace orbslam3
}  // namespace ft
