// SPDX-License-Identifier: Apache-2.0
/// @file Writes a generated sequence to disk in the layout of the EuRoC data sets (ASL).
#pragma once

#include <functional>
#include <string>

#include "examples/sequence/generator.hpp"

namespace seq {

struct asl_options {
  int threads = 0;          ///< threads that render and write, 1 to 256; 0 = all of the machine
  int png_compression = 1;  ///< zlib level 0 to 9
  bool imu = true;          ///< writes imu0
};

/// Renders every frame and writes
/// @code
///   directory/generated.txt                                 the options used
///   directory/mav0/cam0/{data.csv,sensor.yaml,data/<time in ns>.png}, likewise cam1
///   directory/mav0/imu0/{data.csv,sensor.yaml}
///   directory/mav0/state_groundtruth_estimate0/{data.csv,sensor.yaml}
/// @endcode
/// A pinhole pair is described as radial-tangential with zero coefficients, a fisheye pair as
/// equidistant. T_BS maps sensor points to the body (IMU) frame; ground truth is the body's, one
/// line per IMU sample and frame. Dropped frames have no image and are in no list. imu0/sensor.yaml
/// has the noise densities of the samples; for ideal samples, those of imu_noise_scale 1.
///
/// The files come into being in `directory`.partial, cam0/data.csv last, and the folder gets its
/// name when all is written: what carries the name is whole. A .partial folder left by an
/// interrupted run is replaced. On error it is removed.
/// @param directory must not exist, or be empty
/// @param progress called with the number of frames done (dropped ones too), one call at a time,
/// from any of the threads
/// @throws seq::error naming the file or option; what `progress` throws
void write_asl(generator const& source, std::string const& directory,
               asl_options const& options = {}, std::function<void(int done)> const& progress = {});

}  // namespace seq
