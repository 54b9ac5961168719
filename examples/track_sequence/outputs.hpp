// SPDX-License-Identifier: Apache-2.0
/// @file The files that a run leaves, and what it prints at its end.
#pragma once

#include "examples/sequence/reader.hpp"
#include "examples/sequence/report.hpp"
#include "examples/track_sequence/odometry.hpp"
#include "examples/track_sequence/options.hpp"

namespace app {

/// Makes the folder for the files.
/// @throws seq::error where it is the folder of a sequence, whose ground truth has the name of an
///   output
void make_output_folder(arguments const& a);

/// Moves the poses and the map to the frame asked for, compares them with the ground truth, writes
/// the files and prints the summary.
/// @throws seq::error
void finish(arguments const& a, seq::sequence const& sequence, odometry const& odometry,
            seq::run_report& report);

}  // namespace app
