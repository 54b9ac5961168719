// SPDX-License-Identifier: Apache-2.0
/// @file From the command line and a sequence to an odometry.
#pragma once

#include <cstdint>
#include <string>

#include "examples/sequence/reader.hpp"
#include "examples/track_sequence/options.hpp"
#include "ft/any_odometry.hpp"

namespace app {

/// @throws seq::error for a folder that is no sequence, or does not fit the options
seq::sequence open_sequence(arguments const& a);

struct odometry_setup {
  ft::rig_description rig;
  ft::odometry_params params;
  int threads = 0;            ///< of the host; 0 = all
  double scale_factor = 1.2;  ///< as params has it, in double
  double near_depth = 50;     ///< likewise
};

/// The settings file's values where the command line has none.
odometry_setup setup_of(arguments const& a, seq::sequence const& sequence);

/// @param backend gets "host" or "cuda" @param device gets the name of the processor or the GPU
/// @throws seq::error for a GPU that is asked for and not there, options that contradict each
///   other, or a map that cannot be loaded
ft::any_odometry make_odometry(arguments const& a, odometry_setup const& setup,
                               std::string& backend, std::string& device);

/// Pairs to read ahead where the command line has no number: with a GPU as many as all cores can
/// read; beside the host's tracking, which needs the cores, as many as keep up with it.
int usual_read_ahead(std::string const& backend);

/// Threads of the host that track.
int threads_of(odometry_setup const& setup);

}  // namespace app
