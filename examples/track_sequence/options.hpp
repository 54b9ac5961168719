// SPDX-License-Identifier: Apache-2.0
/// @file The command line of track_sequence.
#pragma once

#include <limits>
#include <optional>
#include <string>
#include <vector>

namespace app {

/// How the program ends.
enum exit_status {
  exit_done = 0,
  exit_failed = 1,   ///< nothing was written, or no frame could be tracked
  exit_refused = 2,  ///< the command line has a mistake
  exit_stopped = 3,  ///< stopped early; what was tracked until then is written
};

struct arguments {
  std::string sequence;
  std::string calibration;
  std::string times;               ///< file, or empty
  std::vector<std::string> masks;  ///< of the cameras
  std::string backend = "auto";
  std::string rig = "auto";
  std::string frame = "camera";
  std::string poses = "tum";
  std::string imu = "auto";
  std::optional<double> imu_time_offset_s;  ///< else as the calibration has it
  std::string out = "track_sequence_out";
  std::string record;    ///< folder, or empty
  std::string load_map;  ///< file, or empty
  std::string save_map;  ///< likewise
  int features = 0;
  int threads = 0;
  int frames = 0;
  std::optional<int> read_ahead;  ///< else as usual_read_ahead() says
  double near_depth = 0;
  double corner_ratio = 0;
  double fps = 0;                                ///< images a second; 0 = the recording has times
  std::optional<double> max_time_difference_ms;  ///< else as the reader has it
  int image_bits = 0;                            ///< of 16-bit images; 0 = 16
  double depth_unit = 0;                         ///< metres; 0 = as the recording says
  double min_depth = 0;                          ///< metres
  std::optional<double> readout_ms;              ///< else as the calibration has it
  double max_depth = std::numeric_limits<double>::infinity();  ///< metres
  bool loops = false;
  bool localize_only = false;
  bool realtime = false;
  bool timing = false;
  bool quiet = false;
};

/// @return -1 to go on, else the status to exit with: help, the version or a mistake was printed
int parse(int argc, char** argv, arguments& a);

}  // namespace app
