// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/report.hpp"

#include "examples/sequence/report_figures.hpp"

#include <nlohmann/json.hpp>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <ctime>
#include <fstream>
#include <locale>
#include <sstream>
#include <utility>

namespace seq {
namespace detail {

double percentile(std::vector<double> const& sorted, double percent) {
  double const rank = std::ceil(percent / 100.0 * static_cast<double>(sorted.size()) - 1e-9);
  auto const index = static_cast<std::size_t>(std::max(rank, 1.0)) - 1;
  return sorted[std::min(index, sorted.size() - 1)];
}

std::string fixed(double value, int digits) {
  if (!std::isfinite(value)) { return "n/a"; }
  std::ostringstream out;
  out.imbue(std::locale::classic());
  out.setf(std::ios::fixed, std::ios::floatfield);
  out.precision(digits);
  out << value;
  std::string text = out.str();
  // writes "-0.00" as "0.00"
  if (text.front() == '-' && text.find_first_not_of("-0.") == std::string::npos) {
    text.erase(0, 1);
  }
  return text;
}

std::string fixed(std::optional<double> const& value, int digits, char const* unit) {
  if (!value || !std::isfinite(*value)) { return "n/a"; }
  return fixed(*value, digits) + unit;
}

void write_text(std::string const& path, std::string const& text) {
  errno = 0;
  std::ofstream out(path, std::ios::binary | std::ios::trunc);
  if (out) {
    out.write(text.data(), static_cast<std::streamsize>(text.size()));
    out.close();  // flushes the buffer, so that the check sees all errors
  }
  if (!out) {
    std::string const reason =
        errno != 0 ? std::string(": ") + std::strerror(errno) : std::string();
    throw error(path + ": cannot write" + reason);
  }
}

std::optional<double> stage_time(frame_record const& record, std::size_t s) {
  if (s >= record.stage_ms.size() || !std::isfinite(record.stage_ms[s])) { return std::nullopt; }
  return record.stage_ms[s];
}

namespace {

std::optional<double> finite(std::optional<double> const& value) {
  return value && std::isfinite(*value) ? value : std::nullopt;
}

double path_length(trajectory const& poses) {
  double length = 0;
  for (std::size_t i = 1; i < poses.size(); ++i) {
    double const step =
        (poses[i].T_world_camera.translation() - poses[i - 1].T_world_camera.translation()).norm();
    if (std::isfinite(step)) { length += step; }
  }
  return length;
}

/// Mean of an integer field over the records that `use` accepts.
template <typename Use>
std::optional<double> mean_of(run_report const& report, int frame_record::*field, Use use) {
  double sum = 0;
  int count = 0;
  for (frame_record const& r : report.records) {
    if (!use(r)) { continue; }
    sum += r.*field;
    ++count;
  }
  if (count == 0) { return std::nullopt; }
  return sum / count;
}

}  // namespace

run_figures figures_of(run_report const& report) {
  run_figures f;
  f.has_truth = !report.truth.empty() || report.error.pairs > 0;
  bool const path_known = std::isfinite(report.error.path_m) && report.error.path_m > 0;
  f.path_m = path_known ? report.error.path_m : path_length(report.estimate);
  if (f.has_truth) {
    f.ate_rmse_m = finite(report.error.ate_rmse_m);
    f.rpe_rmse_m = finite(report.error.rpe_rmse_m);
    f.ate_rotation_rmse_deg = finite(report.error.ate_rotation_rmse_deg);
    f.rpe_rotation_rmse_deg = finite(report.error.rpe_rotation_rmse_deg);
  }
  if (report.metric) {
    f.without_scale = static_cast<int>(
        std::count_if(report.records.begin(), report.records.end(),
                      [](frame_record const& r) { return r.tracked && !r.metric; }));
  }
  if (report.frames > 0) { f.tracked_ratio = static_cast<double>(report.tracked) / report.frames; }

  auto const all = [](frame_record const&) { return true; };
  auto const tracked = [](frame_record const& r) { return r.tracked; };
  f.mean_keypoints = mean_of(report, &frame_record::keypoints, all);
  f.mean_stereo_matches = mean_of(report, &frame_record::stereo_matches, all);
  f.mean_inliers = mean_of(report, &frame_record::inliers, tracked);
  f.mean_local_points = mean_of(report, &frame_record::local_points, tracked);

  for (std::size_t s = 0; s < report.stages.size(); ++s) {
    std::vector<double> samples;
    samples.reserve(report.records.size());
    stage_figures stage;
    stage.name = report.stages[s];
    for (frame_record const& r : report.records) {
      std::optional<double> const ms = stage_time(r, s);
      if (!ms) { continue; }
      samples.push_back(*ms);
      stage.sum_ms += *ms;
    }
    stage.count = static_cast<int>(samples.size());
    stage.ms = summarise(std::move(samples));
    f.stages.push_back(std::move(stage));
  }
  std::vector<double> to_pose;
  for (frame_record const& r : report.records) {
    if (!(r.images_to_pose_ms >= 0)) { continue; }
    to_pose.push_back(r.images_to_pose_ms);
    f.images_to_pose.sum_ms += r.images_to_pose_ms;
  }
  f.images_to_pose.count = static_cast<int>(to_pose.size());
  f.images_to_pose.ms = summarise(std::move(to_pose));
  // What is computed ahead is in no stage: their sum is not the time of the frames.
  if (report.prefetch == 0 && !f.stages.empty() && f.stages.back().count > 0) {
    f.processing_s = f.stages.back().sum_ms / 1000.0;
    if (*f.processing_s > 0) { f.fps = f.stages.back().count / *f.processing_s; }
  }
  if (report.wall_s && *report.wall_s > 0) { f.wall_fps = report.frames / *report.wall_s; }
  return f;
}

std::vector<evo_command> evo_commands(run_report const& report, run_figures const& f) {
  std::string const files = " tum groundtruth.txt trajectory.txt";
  std::vector<evo_command> out;
  std::string const scaled = report.scale ? " --correct_scale" : "";
  if (f.ate_rmse_m) { out.push_back({"ATE RMSE", "evo_ape" + files + " --align" + scaled, true}); }
  if (!f.rpe_rmse_m) { return out; }
  // Where poses are missing or intervals vary, a number of poses is not always a second.
  double span = report.error.rpe_span.value_or(0);
  if (!report.error.rpe_span && report.estimate.size() > 1) {
    double const s = 1e-9 * static_cast<double>(report.estimate.back().time_ns -
                                                report.estimate.front().time_ns);
    span = std::max(1.0, std::round(static_cast<double>(report.estimate.size() - 1) / s));
  }
  std::string const compared = f.rpe_rotation_rmse_deg ? "" : " --pose_relation point_distance";
  out.push_back({"RPE RMSE over 1 s",
                 "evo_rpe" + files + scaled + compared + " --delta " + fixed(span, 0) +
                     " --delta_unit f --all_pairs",
                 report.error.rpe_span.has_value()});
  return out;
}

std::string tracked_percent(run_figures const& f) {
  return f.tracked_ratio ? fixed(std::floor(*f.tracked_ratio * 1000) / 10, 1) : "n/a";
}

}  // namespace detail

std::string utc_now() {
  std::time_t const now = std::time(nullptr);
  std::tm parts{};
  gmtime_r(&now, &parts);
  char text[32];
  return {text, std::strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%SZ", &parts)};
}

std::string command_line(std::vector<std::string> const& words) {
  constexpr char const* plain =
      "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789%+,-./:=@_";
  std::string line;
  for (std::string const& word : words) {
    if (!line.empty()) { line += ' '; }
    if (!word.empty() && word.find_first_not_of(plain) == std::string::npos) {
      line += word;
      continue;
    }
    line += '\'';
    for (char const c : word) { line += c == '\'' ? std::string("'\\''") : std::string(1, c); }
    line += '\'';
  }
  return line;
}

statistics summarise(std::vector<double> samples) {
  samples.erase(
      std::remove_if(samples.begin(), samples.end(), [](double v) { return !std::isfinite(v); }),
      samples.end());
  statistics s;
  if (samples.empty()) { return s; }
  std::sort(samples.begin(), samples.end());
  auto const n = static_cast<double>(samples.size());
  for (double const v : samples) { s.mean += v / n; }
  double variance = 0;  // second pass: the one-pass formula cancels for a large mean
  for (double const v : samples) { variance += (v - s.mean) * (v - s.mean) / n; }
  s.std = std::sqrt(variance);
  s.p50 = detail::percentile(samples, 50);
  s.p99 = detail::percentile(samples, 99);
  s.max = samples.back();
  return s;
}

namespace {

using json = nlohmann::ordered_json;

json number(std::optional<double> const& v) {
  return v && std::isfinite(*v) ? json(*v) : json(nullptr);
}

json evo_of(run_report const& report, detail::run_figures const& f) {
  json evo = json::object();
  for (detail::evo_command const& c : detail::evo_commands(report, f)) {
    evo[c.figure] = {{"command", c.command}, {"exact", c.exact}};
  }
  return evo;
}

json times_of(detail::stage_figures const& stage) {
  auto const ms = [&](double v) { return stage.count > 0 ? number(v) : json(nullptr); };
  return {{"mean_ms", ms(stage.ms.mean)},
          {"std_ms", ms(stage.ms.std)},
          {"p50_ms", ms(stage.ms.p50)},
          {"p99_ms", ms(stage.ms.p99)},
          {"max_ms", ms(stage.ms.max)}};
}

json stages_of(detail::run_figures const& f) {
  json stages = json::object();
  for (auto const& stage : f.stages) { stages[stage.name] = times_of(stage); }
  return stages;
}

json warning_counts_of(run_report const& report) {
  json counts = json::object();
  for (frame_record const& r : report.records) {
    for (auto const& [name, said] : r.warnings) { counts[name] = counts.value(name, 0) + 1; }
  }
  return counts;
}

json reason_counts_of(run_report const& report) {
  json reasons = json::object();
  for (frame_record const& r : report.records) {
    if (!r.reason.empty()) { reasons[r.reason] = reasons.value(r.reason, 0) + 1; }
  }
  return reasons;
}

json vector_of(Eigen::Vector3d const& v) {
  return json::array({number(v.x()), number(v.y()), number(v.z())});
}

json imu_of(run_report const& report) {
  auto const imu = detail::imu_figures_of(report);
  if (!imu) { return nullptr; }
  json out = json::object();
  out["known_from"] = imu->known_from ? json(*imu->known_from) : json(nullptr);
  out["optimized"] = imu->optimized;
  out["bridged"] = imu->bridged;
  json states = json::object();
  for (detail::imu_figures::state const& s : imu->states) {
    if (s.reason.empty()) {
      states[s.name] = s.frames;
    } else {
      states[s.name][s.reason] = s.frames;
    }
  }
  out["states"] = states;
  if (imu->known_from) {
    out["velocity"] = vector_of(imu->last.velocity);
    out["gyro_bias"] = vector_of(imu->last.gyro_bias);
    out["accel_bias"] = vector_of(imu->last.accel_bias);
    out["gravity"] = vector_of(imu->last.gravity);
  }
  return out;
}

}  // namespace

void write_summary_json(std::string const& path, run_report const& report) {
  detail::run_figures const f = detail::figures_of(report);
  auto const with_truth = [&](double v) { return f.has_truth ? number(v) : json(nullptr); };

  json root = json::object();
  root["title"] = report.title;
  root["sequence"] = report.sequence;
  root["version"] = report.version;
  root["command"] = report.command;
  root["date"] = report.date;
  root["threads"] = report.threads;
  root["backend"] = report.backend;
  root["device"] = report.device;
  root["image_width"] = report.image_width;
  root["image_height"] = report.image_height;
  root["frames"] = report.frames;
  root["tracked"] = report.tracked;
  root["lost"] = report.lost;
  root["dropped"] = report.dropped;
  root["keyframes"] = report.keyframes;
  root["map_points"] = report.map_points;
  root["maps"] = report.maps;
  root["path_m"] = number(f.path_m);
  root["truth_path_m"] = with_truth(report.error.truth_path_m);
  root["estimate_path_m"] = with_truth(report.error.estimate_path_m);
  root["pairs"] = report.error.pairs;
  root["scale"] = number(report.scale);
  root["scale_to_truth"] = report.fit ? number(report.fit->scale) : json(nullptr);
  root["without_scale"] = f.without_scale;
  root["ate_rmse_m"] = number(f.ate_rmse_m);
  if (report.loops) {
    json edges = json::array();
    for (loop_edge const& e : report.loops->edges) {
      edges.push_back(
          {{"from_time_ns", e.from.time_ns}, {"to_time_ns", e.to.time_ns}, {"inliers", e.inliers}});
    }
    root["loops"] = {{"closed", report.loops->closed},
                     {"corrections", report.loops->corrections},
                     {"online_ate_rmse_m", number(report.loops->online_ate_m)},
                     {"edges", edges}};
  }
  if (report.loaded_map) {
    int const after = report.loaded_map->found_after;
    root["loaded_map"] = {{"file", report.loaded_map->file},
                          {"found_after", after > 0 ? json(after) : json(nullptr)}};
  }
  root["ate_axes_m"] =
      report.error.ate_axes_m ? vector_of(*report.error.ate_axes_m) : json(nullptr);
  root["drift_percent"] = number(report.error.drift_percent);
  root["rpe_rmse_m"] = number(f.rpe_rmse_m);
  root["ate_rotation_rmse_deg"] = number(f.ate_rotation_rmse_deg);
  root["rpe_rotation_rmse_deg"] = number(f.rpe_rotation_rmse_deg);
  root["ate_rotation_missing"] = report.error.ate_rotation_missing.empty()
                                     ? json(nullptr)
                                     : json(report.error.ate_rotation_missing);
  root["frame"] = report.frame;
  root["evo"] = evo_of(report, f);
  root["warnings"] = report.warnings;
  root["stopped_at"] = report.stopped_at ? json(*report.stopped_at) : json(nullptr);
  root["stopped_by"] = report.stopped_at ? json(report.stopped_by) : json(nullptr);
  root["unpaired_left"] = report.unpaired_left;
  root["unpaired_right"] = report.unpaired_right;
  root["mean_keypoints"] = number(f.mean_keypoints);
  root["mean_stereo_matches"] = number(f.mean_stereo_matches);
  root["mean_inliers"] = number(f.mean_inliers);
  root["mean_local_points"] = number(f.mean_local_points);
  root["reasons"] = reason_counts_of(report);
  root["frame_warnings"] = warning_counts_of(report);
  root["images_to_pose"] = f.images_to_pose.count > 0 ? times_of(f.images_to_pose) : json(nullptr);
  root["prefetch"] = report.prefetch;
  root["processing_s"] = number(f.processing_s);
  root["fps"] = number(f.fps);
  root["wall_s"] = number(report.wall_s);
  root["wall_fps"] = number(f.wall_fps);
  root["stages"] = stages_of(f);
  root["imu"] = imu_of(report);
  root["options"] = report.options;
  // names come from the command line: bytes that are not UTF-8 must not prevent the summary
  detail::write_text(path, root.dump(2, ' ', false, json::error_handler_t::replace) + '\n');
}

}  // namespace seq
