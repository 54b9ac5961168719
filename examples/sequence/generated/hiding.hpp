// SPDX-License-Identifier: Apache-2.0
/// @file What hides parts of the images: things fixed to the cameras, and things that move.
#pragma once

#include <Eigen/Geometry>

#include <cstdint>
#include <vector>

#include "examples/sequence/generated/render.hpp"
#include "examples/sequence/generated/room.hpp"
#include "examples/sequence/generator.hpp"

namespace seq::generated {

/// Surfaces without their textures, in the frame of the left camera at the time 0 (crossing: then).
struct hiding_surfaces {
  std::vector<surface> fixed;      ///< to the cameras
  std::vector<surface> companion;  ///< moves with the left camera, does not turn
  std::vector<surface> crossing;   ///< likewise, and to the left

  std::vector<std::vector<surface>*> all() { return {&fixed, &companion, &crossing}; }
  bool empty() const { return fixed.empty() && companion.empty() && crossing.empty(); }
};

/// @param duration_s that the crossing thing has to be long enough for
hiding_surfaces hide(std::uint64_t seed, hiding_things const& things,
                     camera_intrinsics const& camera, double duration_s);

/// Adds them to what is traced. @param t seconds @param T_world_start left camera at the time 0
/// @param T_world_left at t @param T_left_camera of the camera that sees them
void place(hiding_surfaces const& surfaces, hiding_things const& things, double t,
           Eigen::Isometry3d const& T_world_start, Eigen::Isometry3d const& T_world_left,
           Eigen::Isometry3d const& T_left_camera, std::vector<placed_surfaces>& to);

}  // namespace seq::generated
