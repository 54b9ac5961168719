// SPDX-License-Identifier: Apache-2.0
/// @file The tracker for the cameras of the settings.
#pragma once

#include <memory>

#include "integration/orbslam3/executor_tracker.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

/// The tracker for the kind of cameras in the settings.
template <typename Exec>
std::unique_ptr<device_tracker> make_tracker_on(Exec const& exec, settings const& s) {
  if (s.left.kind == lens::pinhole) {
    return std::make_unique<executor_tracker<Exec, rectified_rig>>(exec, s);
  }
  return std::make_unique<executor_tracker<Exec, fisheye_rig>>(exec, s);
}

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
