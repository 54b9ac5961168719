// SPDX-License-Identifier: Apache-2.0
/// @file The files that a run leaves, and what it prints at its end.
#pragma once

#include <Eigen/Geometry>
#include <functional>
#include <iosfwd>
#include <string>

#include "examples/sequence/reader.hpp"
#include "examples/sequence/report.hpp"
#include "examples/track_sequence/options.hpp"
#include "ft/any_odometry.hpp"

namespace app {

/// Makes the folder for the files.
/// @throws seq::error where it or the file for a map cannot be written, or where it is the folder
///   of the run's sequence or of another one, whose ground truth has the name of an output
void make_output_folder(arguments const& a);

/// Writes the map that the next run may load. An older file stays until all is written.
/// @throws seq::error
void save_map(std::string const& path, ft::any_odometry const& odometry);

/// Writes the points of the map as PLY. @param T_file_world what moves them first
using map_writer = std::function<void(std::ostream&, Eigen::Isometry3d const& T_file_world)>;

/// Moves the poses and the map to the frame asked for, compares them with the ground truth, writes
/// the files and prints the summary.
/// @throws seq::error
void finish(arguments const& a, seq::sequence const& sequence, map_writer const& map,
            seq::run_report& report);

}  // namespace app
