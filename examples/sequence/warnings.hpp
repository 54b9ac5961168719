// SPDX-License-Identifier: Apache-2.0
/// @file Signs that the result of a run is likely wrong, in words.
#pragma once

#include <string>
#include <vector>

#include "examples/sequence/report.hpp"

namespace seq {

/// Least share of keypoints with a stereo match that is no cause for a warning.
constexpr double least_stereo_share = 0.1;
/// Longest time without a pose that is no cause for a warning, seconds.
constexpr double longest_loss_s = 1.0;

/// Fastest motion between two frames that is no cause for a warning, m/s.
constexpr double largest_speed = 50;

/// Farthest that the scale of a metric path may be from the one that fits the ground truth, as a
/// part of 1. Wrong units are factors; a good run over a short path is off by 2 % or so.
constexpr double most_off_scale = 0.05;

/// A sentence for each reason for which frames were not tracked, or are to be doubted, with their
/// number and the first one's words.
std::vector<std::string> reasons_of(run_report const& report);

/// A sentence for each warning that frames have, with their number and the first one's words. Not
/// for those that reasons_of() names.
std::vector<std::string> frame_warnings_of(run_report const& report);

/// What frames say of the IMU's samples, each sentence once, with the first frame that says it. Of
/// those that differ in numbers alone, the first one, but the last count of samples left out.
/// Without the IMU's rate where the report's warnings have it already.
std::vector<std::string> imu_warnings_of(run_report const& report);

/// A sentence for each of: a run that was stopped, few stereo matches, images without a partner,
/// more than one map begun, tracking lost for long, a calibration that looks wrong, the reasons for
/// frames without a pose, warnings of frames, what is wrong with samples of the IMU, an impossible
/// speed, a scale that is not the
/// ground truth's. Reads the report's figures, and its warnings only to say nothing twice.
std::vector<std::string> warnings_of(run_report const& report);

}  // namespace seq
