// SPDX-License-Identifier: Apache-2.0
/// @file From the command line and a sequence to an odometry.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "examples/sequence/reader.hpp"
#include "examples/track_sequence/odometry.hpp"
#include "examples/track_sequence/options.hpp"

namespace app {

/// @throws seq::error for a folder that is no sequence, or does not fit the options
seq::sequence open_sequence(arguments const& a);

/// The settings file's values where the command line has none.
odometry_options options_of(arguments const& a, seq::sequence const& sequence);

/// @param backend gets "host" or "cuda"
/// @throws seq::error for a GPU that is asked for and not there, or options that contradict each
///   other
std::unique_ptr<odometry> make_odometry(arguments const& a, odometry_options const& options,
                                        std::string& backend);

/// Pairs to read ahead where the command line has no number: with a GPU as many as all cores can
/// read; beside the host's tracking, which needs the cores, as many as keep up with it.
int usual_read_ahead(std::string const& backend);

rigid_pose plain_pose(Eigen::Isometry3d const& T);
/// @param T camera to world
seq::stamped_pose stamped(std::int64_t time_ns, rigid_pose const& T);

}  // namespace app
