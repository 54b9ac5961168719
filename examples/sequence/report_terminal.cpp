// SPDX-License-Identifier: Apache-2.0
#include <Eigen/Core>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <ostream>
#include <string>
#include <utility>

#include "examples/sequence/report.hpp"
#include "examples/sequence/report_figures.hpp"

namespace seq {

namespace {

/// Columns that a terminal needs for UTF-8 text, one per code point.
std::size_t columns(std::string const& text) {
  return static_cast<std::size_t>(std::count_if(text.begin(), text.end(), [](char c) {
    return (static_cast<unsigned char>(c) & 0xC0U) != 0x80U;
  }));
}

std::string left(std::string const& text, std::size_t width) {
  std::size_t const used = columns(text);
  return used < width ? text + std::string(width - used, ' ') : text;
}

std::string right(std::string const& text, std::size_t width) {
  std::size_t const used = columns(text);
  return used < width ? std::string(width - used, ' ') + text : text;
}

std::string or_na(std::string const& text) { return text.empty() ? "n/a" : text; }

}  // namespace

namespace {

/// A line "  name   value" of the summary.
std::string line(std::string const& name, std::string const& value) {
  return "  " + left(name, 18) + value + '\n';
}

std::string stage_lines(detail::run_figures const& f) {
  using detail::fixed;
  if (f.stages.empty()) { return "  no stage was timed\n"; }
  std::size_t name_width = 5;
  for (auto const& s : f.stages) { name_width = std::max(name_width, columns(s.name)); }
  constexpr std::size_t cell = 11;
  std::string const rule = "  " + std::string(name_width + 5 * cell, '-') + '\n';
  std::string text = "  " + left("stage", name_width);
  for (char const* head : {"mean ms", "std ms", "p50 ms", "p99 ms", "max ms"}) {
    text += right(head, cell);
  }
  text += '\n' + rule;
  for (std::size_t s = 0; s < f.stages.size(); ++s) {
    detail::stage_figures const& stage = f.stages[s];
    if (s > 0 && s + 1 == f.stages.size()) { text += rule; }
    text += "  " + left(stage.name, name_width);
    for (double const v : {stage.ms.mean, stage.ms.std, stage.ms.p50, stage.ms.p99, stage.ms.max}) {
      text += right(stage.count > 0 ? fixed(v, 3) : "n/a", cell);
    }
    text += '\n';
  }
  return text;
}

/// The time that a user waits for, first.
std::string pose_time_lines(run_report const& report, detail::run_figures const& f) {
  using detail::fixed;
  if (f.images_to_pose.count == 0) { return {}; }
  statistics const& ms = f.images_to_pose.ms;
  std::string text =
      line("images to pose", "p50 " + fixed(ms.p50, 3) + " ms, mean " + fixed(ms.mean, 3) +
                                 ", p99 " + fixed(ms.p99, 3) + ", max " + fixed(ms.max, 3));
  if (report.prefetch > 0) {
    text += line("", "up to " + std::to_string(report.prefetch) +
                         " frames are given ahead, and wait for their turn; keypoints and stereo") +
            line("", "are computed meanwhile and are not in `total`; alone: --read-ahead 0");
  }
  return text;
}

std::string found_text(loaded_map_record const& map) {
  if (map.found_after == 0) { return "the camera was not found in it"; }
  return "found after " + std::to_string(map.found_after) +
         (map.found_after == 1 ? " frame" : " frames");
}

std::string count_lines(run_report const& report, detail::run_figures const& f) {
  using detail::fixed;
  std::string const share = f.tracked_ratio ? " (" + detail::tracked_percent(f) + " %)" : "";
  std::string text =
      line("frames", std::to_string(report.frames)) +
      line("tracked", std::to_string(report.tracked) + share) +
      (f.without_scale > 0 ? line("without scale", std::to_string(f.without_scale) +
                                                       " of the tracked, before the IMU told it: "
                                                       "not in the trajectory")
                           : std::string()) +
      line("lost", std::to_string(report.lost)) + line("dropped", std::to_string(report.dropped)) +
      line("keyframes", std::to_string(report.keyframes)) +
      line("map points", std::to_string(report.map_points)) +
      line("maps begun", std::to_string(report.maps)) +
      (report.loops ? line("loops", std::to_string(report.loops->closed) + " closed, in " +
                                        std::to_string(report.loops->corrections) + " frames")
                    : std::string()) +
      (report.loaded_map ? line("loaded map", found_text(*report.loaded_map)) : std::string()) +
      line("mean keypoints", fixed(f.mean_keypoints, 1)) +
      line("mean inliers", fixed(f.mean_inliers, 1));
  if (report.prefetch == 0) {
    text += line("throughput", fixed(f.fps, 1, " frames/s") + ", tracking alone");
  }
  if (report.wall_s) {
    text += line("wall clock", fixed(report.wall_s, 1, " s, ") + fixed(f.wall_fps, 1, " frames/s") +
                                   ", reading and decoding included");
  }
  return text;
}

std::string error_lines(run_report const& report, detail::run_figures const& f) {
  using detail::fixed;
  std::string text;
  if (report.scale) {
    text += line("scale", "unknown; fitted to the ground truth: x " + fixed(report.scale, 4));
  } else if (!report.metric) {
    text += line("scale", "unknown");
  } else if (report.fit) {
    text += line("scale to truth",
                 "x " + fixed(report.fit->scale, 4) + " would fit best; errors are without it");
  }
  text += line("path", fixed(f.path_m, 3) + (report.metric || report.scale ? " m" : ""));
  if (f.has_truth) {
    text += line("truth pairs", std::to_string(report.error.pairs));
    text += line("truth path", fixed(report.error.truth_path_m, 3) + " m");
  }
  std::string const why = f.has_truth ? "" : " (no ground truth)";
  text += line("ATE RMSE", fixed(f.ate_rmse_m, 4, " m") + why);
  if (report.loops) {
    text += line("ATE online", fixed(report.loops->online_ate_m, 4, " m") +
                                   ", of the poses as each frame told them");
  }
  if (report.error.ate_axes_m) {
    Eigen::Vector3d const& axes = *report.error.ate_axes_m;
    text += line("ATE along axes", "x " + fixed(axes.x(), 4) + ", y " + fixed(axes.y(), 4) +
                                       ", z " + fixed(axes.z(), 4) + " m, of the truth's world");
  }
  if (report.error.drift_percent) {
    text += line("drift", fixed(*report.error.drift_percent, 2) + " % of " +
                              fixed(report.error.truth_path_m / 10, 2) + " m");
  }
  text += line("RPE RMSE over 1 s", fixed(f.rpe_rmse_m, 4, " m") + why);
  if (f.ate_rotation_rmse_deg) {
    text += line("ATE rotation", fixed(f.ate_rotation_rmse_deg, 3, " deg"));
  } else if (!report.error.ate_rotation_missing.empty()) {
    text += line("ATE rotation", "n/a (" + report.error.ate_rotation_missing + ")");
  }
  if (f.rpe_rotation_rmse_deg) {
    text += line("RPE rotation", fixed(f.rpe_rotation_rmse_deg, 3, " deg over 1 s"));
  }
  for (detail::evo_command const& c : detail::evo_commands(report, f)) {
    text += "  " + c.figure + (c.exact ? "" : " (about)") + " by evo, in that folder:\n    " +
            c.command + '\n';
  }
  return text;
}

}  // namespace

void print_summary(std::ostream& out, run_report const& report) {
  detail::run_figures const f = detail::figures_of(report);
  std::string text;
  if (!report.title.empty()) { text += report.title + "\n\n"; }
  text += line("sequence", or_na(report.sequence));
  text +=
      line("backend", or_na(report.backend) + (report.device.empty() ? "" : ", " + report.device));
  text += line("image", report.image_width > 0 && report.image_height > 0
                            ? std::to_string(report.image_width) + " x " +
                                  std::to_string(report.image_height)
                            : "n/a");
  text += '\n' + pose_time_lines(report, f) + stage_lines(f) + '\n' + count_lines(report, f) +
          error_lines(report, f) + detail::imu_lines(report);
  for (std::string const& warning : report.warnings) { text += "  warning: " + warning + '\n'; }
  out << text << std::flush;
}

namespace {

constexpr double redraw_interval_s = 0.1;

double now_s() {
  using clock = std::chrono::steady_clock;
  return std::chrono::duration<double>(clock::now().time_since_epoch()).count();
}

std::string duration_text(double s) {
  if (s < 100) { return detail::fixed(std::ceil(s), 0) + " s"; }
  if (s < 6000) { return detail::fixed(std::ceil(s / 60), 0) + " min"; }
  return detail::fixed(s / 3600, 1) + " h";
}

}  // namespace

progress::progress(std::ostream& out, bool terminal, std::string label, int total)
    : out_(out), terminal_(terminal), label_(std::move(label)), total_(total), start_s_(now_s()) {}

void progress::step(int done, std::string const& note) {
  double const now = now_s();
  bool const complete = total_ > 0 && done >= total_;
  if (terminal_) {
    bool const first = last_decile_ < 0;
    if (!first && !complete && now - last_draw_s_ < redraw_interval_s) { return; }
    last_decile_ = 0;
    last_draw_s_ = now;
  } else {
    // without a total there is no 10 %: a line every hundred steps
    int const decile =
        total_ > 0 ? static_cast<int>(10LL * std::clamp(done, 0, total_) / total_) : done / 100;
    if (decile <= std::max(last_decile_, 0)) { return; }
    last_decile_ = decile;
  }

  std::string text = label_ + "  " + std::to_string(done);
  if (total_ > 0) {
    text += '/' + std::to_string(total_) + "  " +
            std::to_string(100LL * std::clamp(done, 0, total_) / total_) + " %";
  }
  double const elapsed = now - start_s_;
  if (done > 0 && elapsed > 1e-6) {
    double const rate = done / elapsed;
    text += "  " + detail::fixed(rate, rate < 1000 ? 1 : 0) + " frames/s";
    if (total_ > done) { text += "  ETA " + duration_text((total_ - done) / rate); }
  }
  if (!note.empty()) { text += "  " + note; }
  if (terminal_) {
    out_ << '\r' << text << "\x1b[K" << std::flush;  // erases the rest of a longer line
  } else {
    out_ << text << '\n' << std::flush;
  }
}

void progress::finish() {
  if (terminal_ && last_decile_ >= 0) { out_ << '\n'; }
  if (terminal_) { last_decile_ = -1; }
  out_ << std::flush;
}

}  // namespace seq
