// SPDX-License-Identifier: Apache-2.0
/// @file Whether samples of an IMU are what its calibration says. Not API.
#pragma once

#include <string>
#include <vector>

#include "examples/sequence/reader.hpp"

namespace seq::detail {

/// Says in `warnings` where the rate is not the calibration's, or the units are unlikely: a median
/// specific force that is not near gravity, a median angular rate above 3 rad/s.
void check_imu(imu_recording const& imu, std::string const& path,
               std::vector<std::string>& warnings);

}  // namespace seq::detail
