// SPDX-License-Identifier: Apache-2.0
/// @file Signs that files of a recording do not belong together, or are in another unit. Not API.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "examples/sequence/detail/layout.hpp"
#include "examples/sequence/reader.hpp"

namespace seq::detail {

std::string seconds_text(std::int64_t ns);

/// Says where the times of a file, `first` to `last`, are not those of the images.
void check_overlap(std::vector<frame_files> const& frames, std::int64_t first, std::int64_t last,
                   char const* what, std::vector<std::string>& warnings);

/// Says where frames are not as far apart as those of a camera.
void check_frame_times(std::vector<frame_files> const& frames, std::vector<std::string>& warnings);

/// The unit of a recording's depth images.
struct depth_unit {
  double metres = 0;
  std::string from;            ///< for people
  bool assumed = false;        ///< nobody says it
  bool known_to_suit = false;  ///< the recording is one of those that have the assumed unit
  bool camera_txt = true;      ///< a camera.txt may say it
};

/// That which was asked for, that of the calibration, of the layout, or else the one of TUM RGB-D.
depth_unit depth_unit_of(layout_of_files const& layout, calibration const& calib,
                         open_options const& options);

/// Says where the first frame's depths are not those of a scene, and where their unit is a guess.
/// @param path of the image @param baseline of the virtual pair, metres
void check_depths(depth_image const& depth, depth_unit const& unit, std::string const& path,
                  double baseline, std::vector<std::string>& warnings);

}  // namespace seq::detail
