// SPDX-License-Identifier: Apache-2.0
/// @file Images of the room.
#pragma once

#include <Eigen/Geometry>

#include <cstdint>
#include <functional>
#include <vector>

#include "examples/sequence/generated/room.hpp"
#include "examples/sequence/generated/view.hpp"
#include "examples/sequence/types.hpp"

namespace seq::generated {

/// Quantiles of the normal distribution; a uniform index gives a normal variate.
std::vector<float> normal_table();

/// Surfaces, and where they are.
struct placed_surfaces {
  std::vector<surface> const* surfaces;
  Eigen::Isometry3d T_camera_surfaces;
};

/// Grey level of the surface that each pixel sees, 0 outside the lens' range.
std::vector<float> trace(view const& v, std::vector<placed_surfaces> const& all);
/// The same of rows that are seen at times of their own.
/// @param at where the surfaces are for a row
std::vector<float> trace_rows(view const& v,
                              std::function<std::vector<placed_surfaces>(int row)> const& at);

/// An image of what was traced. @param sigma of the noise, grey levels @param normal normal_table()
image expose(view const& v, std::vector<float> const& radiance, float gain, float sigma,
             std::vector<float> const& normal, std::uint64_t noise_key);

}  // namespace seq::generated
