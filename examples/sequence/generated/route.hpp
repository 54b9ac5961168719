// SPDX-License-Identifier: Apache-2.0
/// @file The way that the camera of a generated sequence goes.
#pragma once

#include <Eigen/Geometry>

#include <cstdint>
#include <utility>
#include <vector>

#include "examples/sequence/generator.hpp"

namespace seq::generated {

using vec6 = Eigen::Matrix<double, 6, 1>;  ///< x y z yaw pitch roll

/// Uniform cubic B-spline over time: continuous acceleration, and constant where its control points
/// are.
class spline {
public:
  spline() = default;
  explicit spline(std::vector<vec6> controls) : controls_(std::move(controls)) {}

  /// @param order 0 value, 1 first, 2 second derivative by time
  vec6 at(double t, int order) const;

private:
  std::vector<vec6> controls_;
};

/// Laps through the room from 0 on. @param duration_s that are needed
spline plan_route(std::uint64_t seed, double duration_s, std::vector<fast_turn> const& fast);

/// Straight along x from the origin, 1.5 m high: at rest for half a second, then faster.
/// @param speed m/s, after 2 s @param look_aside degrees to the left of x
spline plan_drive(std::uint64_t seed, double duration_s, double speed, double look_aside,
                  std::vector<fast_turn> const& fast);
/// How far plan_drive() gets, metres.
double driven(double t, double speed);

struct motion {
  Eigen::Isometry3d T_world_camera = Eigen::Isometry3d::Identity();
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();      ///< world, of the camera
  Eigen::Vector3d acceleration = Eigen::Vector3d::Zero();  ///< world, of the camera
  Eigen::Vector3d turning = Eigen::Vector3d::Zero();       ///< angular velocity, world
  Eigen::Vector3d spin_up = Eigen::Vector3d::Zero();       ///< angular acceleration, world
};

/// @param t seconds
motion motion_at(spline const& route, double t);

}  // namespace seq::generated
