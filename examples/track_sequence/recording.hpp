// SPDX-License-Identifier: Apache-2.0
/// @file A run on disk, for a viewer: `python -m ft view FOLDER`. The format is described there, in
/// python/ft/view.py.
#pragma once

#include <fstream>
#include <optional>
#include <string>
#include <vector>

#include "examples/sequence/reader.hpp"
#include "examples/sequence/report.hpp"
#include "examples/track_sequence/timed_odometry.hpp"
#include "ft/types/loops.hpp"

namespace app {

/// What loops have made of the path.
struct corrected_keyframes {
  std::vector<ft::placed_keyframe> keyframes;
  std::vector<ft::closed_loop> loops;
};

/// recording.jsonl, a line a frame, and the left images as tracked, left/<number>.png.
class recording {
public:
  /// Makes the folder and writes the first line; of an older recording there only images stay.
  /// @param stages names of frame_record::stage_ms
  /// @throws seq::error
  recording(std::string const& folder, seq::sequence const& sequence,
            std::vector<std::string> const& stages);

  /// Adds a frame. @param T_wc left camera to world @param left the image @param corrected where a
  /// correction entered with the frame @throws seq::error
  void add(seq::frame_record const& frame, ft::rigid<double> const& T_wc, seq::image const& left,
           std::vector<seen_keypoint> const& keypoints,
           std::optional<corrected_keyframes> const& corrected);

private:
  void write_line(std::string const& line);

  std::string folder_;
  std::ofstream lines_;
};

}  // namespace app
