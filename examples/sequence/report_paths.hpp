// SPDX-License-Identifier: Apache-2.0
/// @file Paths as the report draws them. Not API: included by the report's parts only.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "examples/sequence/report.hpp"

namespace seq::detail {

/// Times and places, metres.
using positions = std::vector<std::pair<std::int64_t, Eigen::Vector3d>>;

/// The places of the poses, transformed; without those that are not finite.
positions finite_positions(trajectory const& poses, Eigen::Isometry3d const& transform);

/// Longest time step that a line bridges: tracking was lost during anything longer.
std::int64_t bridged_gap(positions const& points);

/// The part of the truth that the run covers; all of it if the run has no frames.
trajectory covered(trajectory const& truth, std::vector<frame_record> const& records);

}  // namespace seq::detail
