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

/// A sentence for each of: a run that was stopped, few stereo matches, images without a partner,
/// more than one map begun, tracking lost for long. Reads the report's figures, not its warnings.
std::vector<std::string> warnings_of(run_report const& report);

}  // namespace seq
