// SPDX-License-Identifier: Apache-2.0
/// @file Figures and text helpers that the writers of the report share. Not API: included by
/// report.cpp and report_html.cpp only.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "examples/sequence/report.hpp"

namespace seq::detail {

/// Statistics of one stage; `count` is the number of frames with a time for it.
struct stage_figures {
  std::string name;
  int count = 0;
  double sum_ms = 0;
  statistics ms;
};

/// The printed figures, derived once from a report; optionals are empty if nothing was measured.
struct run_figures {
  bool has_truth = false;
  double path_m = 0;
  std::optional<double> ate_rmse_m, rpe_rmse_m;
  std::optional<double> ate_rotation_rmse_deg, rpe_rotation_rmse_deg;
  std::optional<double> tracked_ratio;  ///< tracked / frames
  int without_scale = 0;  ///< tracked, and not in the path: of one camera before its scale is known
  std::optional<double> processing_s;    ///< sum of the last stage; nothing of prefetched frames
  std::optional<double> fps;             ///< timed frames / processing_s
  std::optional<double> wall_fps;        ///< frames / run_report::wall_s
  std::optional<double> mean_keypoints;  ///< over all records
  std::optional<double> mean_stereo_matches;
  std::optional<double> mean_inliers;       ///< over tracked records
  std::optional<double> mean_local_points;  ///< over tracked records
  std::vector<stage_figures> stages;        ///< same order as run_report::stages
  stage_figures images_to_pose;             ///< frame_record::images_to_pose_ms
};

run_figures figures_of(run_report const& report);
/// Rounded down, so that 100 means all of them; "n/a" without frames.
std::string tracked_percent(run_figures const& f);

/// What an IMU did in a run.
struct imu_figures {
  std::optional<int> known_from;  ///< index of the first frame with gravity, velocity and biases
  int optimized = 0;              ///< frames whose pose was optimised with the IMU
  int bridged = 0;  ///< frames that were not found, whose pose the IMU alone predicted
  imu_record last;  ///< of the last frame with known values
  struct state {
    std::string name, reason, why;  ///< as frame_record::imu_state, imu_reason, imu_why
    int first = 0;                  ///< index of the first frame with it
    int frames = 0;
  };
  std::vector<state> states;  ///< in the order of their first frames
  std::string last_state, last_why;
};
/// Nothing without an IMU.
std::optional<imu_figures> imu_figures_of(run_report const& report);
/// A sentence for each state of the IMU and its reason: in how many frames, and from which one on.
std::vector<std::string> imu_state_sentences(imu_figures const& f, std::size_t frames);
/// Lines of the printed summary; empty without an IMU.
std::string imu_lines(run_report const& report);

/// Names of all that a frame is warned of; "imu" stands for frame_record::imu_warnings.
std::vector<std::string> warning_names(frame_record const& r);

/// A command that gives one of the figures, in the folder with trajectory.txt and groundtruth.txt.
struct evo_command {
  std::string figure;
  std::string command;
  bool exact = true;  ///< to the figure's last digit; otherwise about
};

/// Commands of evo, https://github.com/MichaelGrupp/evo, for the translation errors there are. evo
/// counts poses in place of seconds: without a pose for each frame the relative error is another.
std::vector<evo_command> evo_commands(run_report const& report, run_figures const& f);

/// Milliseconds of stage `s`; nothing if the record has no such entry or it is not a finite number.
std::optional<double> stage_time(frame_record const& record, std::size_t s);

/// Nearest rank: the smallest sample that at least `percent` of all samples do not exceed.
/// @pre sorted is not empty and ascending
double percentile(std::vector<double> const& sorted, double percent);

/// Decimal number with a point in any locale; "n/a" if it is not finite.
std::string fixed(double value, int digits);
std::string fixed(std::optional<double> const& value, int digits, char const* unit = "");

/// @throws seq::error naming the file and the reason
void write_text(std::string const& path, std::string const& text);

}  // namespace seq::detail
