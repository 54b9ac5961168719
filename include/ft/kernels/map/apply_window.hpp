// SPDX-License-Identifier: Apache-2.0
/// @file Stage: brings the result of an adjustment into the map.
#pragma once

#include "ft/containers/odometry_map.hpp"
#include "ft/containers/window_problem.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/geometry.hpp"
#include "ft/kernels/map/gather_window.hpp"

namespace ft {
inline namespace FT_ABI {

/// Brings the results of the batch entries whose flag is set into the map.
template <typename Exec>
void apply_window(Exec const& exec, int const* flags, window_problem_view const& problem,
                  window_sources_view const& sources, odometry_map_view const& map,
                  rigid<double>* T_cw);

}  // namespace FT_ABI
}  // namespace ft
