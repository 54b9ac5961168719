// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <locale>
#include <sstream>
#include <string>

#include "examples/sequence/report.hpp"
#include "examples/sequence/report_figures.hpp"

namespace seq {
namespace {

/// RFC 4180: quoted where the text holds a separator, a quote or a line break.
std::string csv_field(std::string const& text) {
  if (text.find_first_of(",\"\r\n") == std::string::npos) { return text; }
  std::string quoted = "\"";
  for (char const c : text) {
    if (c == '"') { quoted += '"'; }
    quoted += c;
  }
  return quoted + '"';
}

/// All nine decimals, which a double would lose for times since 1970.
std::string seconds(std::int64_t time_ns) {
  bool const negative = time_ns < 0;
  std::uint64_t const ns =
      negative ? 0 - static_cast<std::uint64_t>(time_ns) : static_cast<std::uint64_t>(time_ns);
  std::string fraction = std::to_string(ns % 1'000'000'000U);
  fraction.insert(0, 9 - fraction.size(), '0');
  return (negative ? "-" : "") + std::to_string(ns / 1'000'000'000U) + '.' + fraction;
}

/// The columns of an IMU, empty while nothing is known.
std::string imu_columns(frame_record const& r) {
  if (!r.imu) { return std::string(10, ','); }
  std::string text = r.imu->optimized ? ",1" : ",0";
  for (Eigen::Vector3d const* const v : {&r.imu->velocity, &r.imu->gyro_bias, &r.imu->accel_bias}) {
    for (int i = 0; i < 3; ++i) { text += ',' + detail::fixed((*v)[i], 6); }
  }
  return text;
}

std::string imu_state_columns(frame_record const& r) {
  std::string text = ',' + csv_field(r.imu_state) + ',' + csv_field(r.imu_reason) + ',';
  if (r.imu_clock_offset_s) { text += detail::fixed(*r.imu_clock_offset_s, 6); }
  for (int i = 0; i < 3; ++i) {
    text += ',';
    if (r.imu_turn) { text += detail::fixed((*r.imu_turn)[i], 6); }
  }
  return text;
}

constexpr std::size_t covariance_columns = 21;  // the upper triangle of 6 x 6

std::string covariance_heads() {
  std::string text;
  for (int row = 0; row < 6; ++row) {
    for (int column = row; column < 6; ++column) {
      text += ",covariance_" + std::to_string(row) + std::to_string(column);
    }
  }
  return text;
}

/// Empty where it is not known.
std::string covariance_of(frame_record const& r) {
  if (r.covariance.size() != covariance_columns) { return std::string(covariance_columns, ','); }
  std::ostringstream out;
  out.imbue(std::locale::classic());
  out.precision(9);
  for (double const value : r.covariance) { out << ',' << value; }
  return out.str();
}

}  // namespace

void write_times_csv(std::string const& path, run_report const& report) {
  std::string text = "index,time_s,tracked,keyframe,keypoints,stereo_matches,inliers,local_points";
  for (std::string const& stage : report.stages) { text += ',' + csv_field(stage + "_ms"); }
  if (report.with_imu) {
    text +=
        ",imu_optimized,velocity_x,velocity_y,velocity_z,gyro_bias_x,gyro_bias_y,gyro_bias_z,"
        "accel_bias_x,accel_bias_y,accel_bias_z";
  }
  bool const covariances = std::any_of(report.records.begin(), report.records.end(),
                                       [](frame_record const& r) { return !r.covariance.empty(); });
  if (covariances) { text += covariance_heads(); }
  if (report.with_imu) {
    text += ",imu_state,imu_reason,imu_clock_offset_s,imu_turn_x,imu_turn_y,imu_turn_z";
  }
  text += ",images_to_pose_ms,reason,map_id,map_begun,warnings\n";
  for (frame_record const& r : report.records) {
    text += std::to_string(r.index) + ',' + seconds(r.time_ns);
    text += r.tracked ? ",1" : ",0";
    text += r.keyframe ? ",1" : ",0";
    for (int const count : {r.keypoints, r.stereo_matches, r.inliers, r.local_points}) {
      text += ',' + std::to_string(count);
    }
    for (std::size_t s = 0; s < report.stages.size(); ++s) {
      text += ',';
      if (auto const ms = detail::stage_time(r, s)) { text += detail::fixed(*ms, 6); }
    }
    if (report.with_imu) { text += imu_columns(r); }
    if (covariances) { text += covariance_of(r); }
    if (report.with_imu) { text += imu_state_columns(r); }
    text += ',';
    if (r.images_to_pose_ms >= 0) { text += detail::fixed(r.images_to_pose_ms, 6); }
    text +=
        ',' + csv_field(r.reason) + ',' + std::to_string(r.map_id) + (r.map_begun ? ",1," : ",0,");
    std::string names;
    for (std::string const& name : detail::warning_names(r)) {
      names += (names.empty() ? "" : " ") + name;
    }
    text += csv_field(names) + '\n';
  }
  detail::write_text(path, text);
}

}  // namespace seq
