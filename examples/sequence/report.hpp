// SPDX-License-Identifier: Apache-2.0
/// @file The results of a tracking run: printed table, summary.json, times.csv, report.html.
#pragma once

#include <iosfwd>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/types.hpp"

namespace seq {

struct statistics {
  double mean = 0, std = 0, p50 = 0, p99 = 0, max = 0;
};
/// Population standard deviation; percentiles by nearest rank. All zero without samples.
statistics summarise(std::vector<double> samples);

/// What the IMU says about a frame, once gravity, velocity and biases are known.
struct imu_record {
  bool optimized = false;                                ///< the pose was optimised with the IMU
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();    ///< m/s, in the world
  Eigen::Vector3d gyro_bias = Eigen::Vector3d::Zero();   ///< rad/s
  Eigen::Vector3d accel_bias = Eigen::Vector3d::Zero();  ///< m/s^2
  Eigen::Vector3d gravity = Eigen::Vector3d::Zero();     ///< m/s^2, in the world
};

/// One processed frame.
struct frame_record {
  int index = 0;
  std::int64_t time_ns = 0;
  bool tracked = false;
  bool keyframe = false;
  bool metric = true;  ///< the scale of its pose is known
  int keypoints = 0;   ///< left image
  int stereo_matches = 0;
  int inliers = 0;  ///< keypoints matched to map points from before this frame
  int local_points = 0;
  std::vector<double> stage_ms;  ///< same order as run_report::stages
  std::optional<imu_record> imu;
  /// Of the pose, as ft::tracking::covariance: rows of its upper triangle. Empty = unknown.
  std::vector<double> covariance;
  double images_to_pose_ms =
      -1;              ///< from handing the images over to having the pose; < 0 = unknown
  std::string reason;  ///< why it is not tracked, or to be doubted; empty = neither
  std::string why;     ///< the same as a sentence
  std::vector<std::string> imu_warnings;  ///< sentences about the samples of the IMU until then
  std::vector<std::pair<std::string, std::string>> warnings;  ///< names and sentences
  int map_id = 0;          ///< of the map that the pose is in, from 1 on; 0 = none
  bool map_begun = false;  ///< the frame begins a map
  std::string imu_state;   ///< initialising, known or used; empty without an IMU
  std::string imu_reason;  ///< why it is not used, a word
  std::string imu_why;     ///< the same as a sentence; empty if it is used
  /// By which the IMU's clock is ahead of that of the images, as found, seconds.
  std::optional<double> imu_clock_offset_s;
  /// How the IMU is turned from where its calibration says, as found: rotation vector, rad.
  std::optional<Eigen::Vector3d> imu_turn;
};

/// A frame drawn in the report.
struct sample_frame {
  int index = 0;
  image picture;  ///< left image
  struct keypoint {
    float x = 0, y = 0, size = 0;
    int octave = 0;
    float depth = -1;      ///< metres, -1 = no stereo match
    bool matched = false;  ///< one of frame_record::inliers
    float from_x = -1,
          from_y = -1;  ///< position of the same map point in the preceding frame, -1 = none
  };
  std::vector<keypoint> keypoints;
};

/// A map of an earlier run, in which the camera is searched for.
struct loaded_map_record {
  std::string file;
  int found_after = 0;  ///< frames, the one with which it is found included; 0 = it is not
};

/// A loop as an edge between two keyframes, where all loops have placed them.
struct loop_edge {
  stamped_pose from;    ///< the one that was recognised
  stamped_pose to;      ///< the later one
  int inliers = 0;      ///< matches that agree with it
  bool loaded = false;  ///< `from` is of a loaded map
};

/// What loops did to a path.
struct loop_record {
  int closed = 0;
  int maps = 1;         ///< of the run's keyframes, after loops have joined some
  int corrections = 0;  ///< frames with which some entered
  trajectory tracked;   ///< poses that no loop has corrected
  trajectory online;    ///< poses as each frame told them; those of the run are corrected by all
  std::vector<loop_edge> edges;
  std::optional<double> online_ate_m;
};

struct run_report {
  std::string title;
  std::string sequence;
  std::string backend;                         ///< "host" or "cuda"
  std::string device;                          ///< processor or GPU name
  std::map<std::string, std::string> options;  ///< as given on the command line
  std::string version;                         ///< of ft
  std::string command;                         ///< that was run
  std::string date;                            ///< utc_now() at its begin
  int threads = 0;                             ///< of the host; 0: a GPU, or not known
  int image_width = 0, image_height = 0;
  int frames = 0, tracked = 0, lost = 0, dropped = 0, keyframes = 0, map_points = 0;
  std::optional<loop_record> loops;  ///< where they were looked for
  std::optional<loaded_map_record> loaded_map;
  int maps = 0;                     ///< maps begun; more than one after a long loss
  bool one_camera = false;          ///< the left images alone were used
  bool depth_images = false;        ///< one camera with depth images was used
  bool with_imu = false;            ///< the sequence's IMU was used
  std::vector<std::string> stages;  ///< names; the last one is "total"
  std::vector<frame_record> records;
  trajectory estimate;  ///< tracked frames only; of one camera, those whose scale is known if any
  bool metric = true;   ///< the scale of `estimate` is known
  std::optional<double> scale;  ///< otherwise: what fits it to the ground truth, where there is one
  std::optional<scale_fit> fit;  ///< of a metric one, where there is ground truth; not applied
  trajectory truth;              ///< may be empty
  trajectory_error error;
  std::vector<sample_frame> samples;
  std::vector<Eigen::Vector3f> cloud;  ///< map points in the world of `estimate`, metres

  std::optional<int> stopped_at;              ///< the frame that was next; empty for a whole run
  std::string stopped_by;                     ///< why it was stopped
  int unpaired_left = 0, unpaired_right = 0;  ///< images without a partner
  std::optional<double> wall_s;               ///< from the first frame's reading to the last pose
  std::string frame = "camera";               ///< whose poses `estimate` and `truth` are
  std::vector<std::string> warnings;          ///< see warnings.hpp
  int prefetch =
      0;  ///< frames given before they are tracked; `stages` leave out what that computes
  std::vector<std::string> calibration;  ///< sentences about a calibration that looks wrong
};

/// Date and time, ISO 8601, UTC.
std::string utc_now();
/// Words of a command in a line, quoted where a shell needs it.
std::string command_line(std::vector<std::string> const& words);

/// Per-stage table (mean, std, p50, p99, max in ms) and the figures, for a terminal.
void print_summary(std::ostream& out, run_report const& report);
/// Machine-readable: frames, tracked, lost, dropped, path_m, ate_rmse_m, rpe_rmse_m (null without
/// ground truth), ate_axes_m, drift_percent, version, command, date, threads, scale (null where it
/// is known or there is no ground truth), scale_to_truth (what would fit a path of known scale;
/// else null), without_scale (tracked frames whose scale was not known yet: not in the path),
/// keyframes, map_points, backend, stages = name -> mean_ms std_ms p50_ms p99_ms max_ms, imu (null
/// without one; its states = initialising, known, used -> frames, or reason -> frames), warnings,
/// images_to_pose = mean_ms ... from handing a frame's images over to having its pose, prefetch =
/// frames given ahead (then fps is null: the stages leave their keypoints and stereo out), reasons
/// = name -> frames that were not tracked or are doubted, ate_rotation_missing, stopped_at (null
/// for a whole run), evo = figure -> command, loops = closed, corrections, online_ate_rmse_m, edges
/// = from_time_ns, to_time_ns, inliers (only with --loops), loaded_map = file, found_after (null
/// where it is not found; only with --load-map), and the rest.
void write_summary_json(std::string const& path, run_report const& report);
void write_times_csv(std::string const& path, run_report const& report);
/// One self-contained file: no script, style or picture from elsewhere.
/// @throws seq::error if it cannot be written, or for more stages than colours (report_palette.hpp)
void write_html(std::string const& path, run_report const& report);

/// A one-line progress display ("track  132/300  44 %  31.2 frames/s  ETA 5 s"); a plain line every
/// 10 % if `out` is not a terminal.
class progress {
public:
  progress(std::ostream& out, bool terminal, std::string label, int total);
  void step(int done, std::string const& note = {});
  void finish();

private:
  std::ostream& out_;
  bool terminal_;
  std::string label_;
  int total_;
  int last_decile_ = -1;
  double start_s_;
  double last_draw_s_ = 0;
};

}  // namespace seq
