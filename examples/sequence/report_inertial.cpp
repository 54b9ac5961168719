// SPDX-License-Identifier: Apache-2.0
// The IMU in the report: figures, printed lines, and charts of velocity and biases.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>

#include "examples/sequence/report_figures.hpp"
#include "examples/sequence/report_markup.hpp"
#include "examples/sequence/report_sections.hpp"

namespace seq::detail {
namespace {

/// One of the vectors over time.
struct vector_series {
  char const* title;
  char const* unit;
  double least_height;  ///< of the axis, from the middle
  Eigen::Vector3d imu_record::*field;
};

double seconds_of(run_report const& r, frame_record const& record) {
  return 1e-9 * static_cast<double>(record.time_ns - r.records.front().time_ns);
}

std::string chart_of(vector_series const& series, run_report const& r) {
  static constexpr char const* styles[] = {"c0", "c1", "c3"};
  chart c;
  c.height = 200;
  c.x = {0, std::max(seconds_of(r, r.records.back()), 1e-3)};
  double largest = series.least_height;
  for (frame_record const& record : r.records) {
    if (!record.imu) { continue; }
    double const v = ((*record.imu).*series.field).cwiseAbs().maxCoeff();
    if (std::isfinite(v)) { largest = std::max(largest, 1.08 * v); }
  }
  c.y = {-largest, largest};
  std::string out = std::string("<h3>") + series.title + "</h3>\n" + c.open(series.title) +
                    c.axes("time [s]", series.unit, false, false);
  std::size_t const step =
      std::max<std::size_t>(1, (r.records.size() + most_points - 1) / most_points);
  for (int axis = 0; axis < 3; ++axis) {
    pen line;
    for (std::size_t i = 0; i < r.records.size(); i += step) {
      frame_record const& record = r.records[i];
      if (!record.imu) {
        line.cut();
        continue;
      }
      line.to(c.px(seconds_of(r, record)), c.py(((*record.imu).*series.field)[axis]));
    }
    out += path(styles[axis], line.take());
  }
  return out + chart::close();
}

std::string three(Eigen::Vector3d const& v, int digits) {
  return fixed(v.x(), digits) + ' ' + fixed(v.y(), digits) + ' ' + fixed(v.z(), digits);
}

std::string what_it_did(imu_figures const& f) {
  return std::to_string(f.optimized) + " poses optimised with it, " + std::to_string(f.bridged) +
         " frames without a match bridged";
}

}  // namespace

std::optional<imu_figures> imu_figures_of(run_report const& report) {
  if (!report.with_imu) { return std::nullopt; }
  imu_figures f;
  for (frame_record const& r : report.records) {
    if (!r.imu) { continue; }
    if (!f.known_from) { f.known_from = r.index; }
    f.optimized += static_cast<int>(r.imu->optimized);
    f.bridged += static_cast<int>(!r.tracked);
    f.last = *r.imu;
  }
  return f;
}

std::string imu_lines(run_report const& report) {
  auto const f = imu_figures_of(report);
  if (!f) { return {}; }
  if (!f->known_from) { return "  IMU               gravity and biases were never known\n"; }
  return "  IMU               known from frame " + std::to_string(*f->known_from) + ", " +
         what_it_did(*f) + "\n  gyro bias         " + three(f->last.gyro_bias, 5) +
         " rad/s\n  accel bias        " + three(f->last.accel_bias, 4) + " m/s^2\n";
}

std::string imu_section(run_report const& r) {
  auto const f = imu_figures_of(r);
  if (!f) { return {}; }
  if (!f->known_from) {
    return section_open("IMU", "") + nothing("Gravity and biases were never known.") +
           "</section>\n";
  }
  static constexpr vector_series all[] = {
      {"Velocity in the world", "m/s", 0.1, &imu_record::velocity},
      {"Bias of the gyroscope", "rad/s", 1e-3, &imu_record::gyro_bias},
      {"Bias of the accelerometer", "m/s\xc2\xb2", 0.02, &imu_record::accel_bias},
  };
  std::string out = section_open(
      "IMU", "Known from frame " + std::to_string(*f->known_from) + "; " + what_it_did(*f) + ".");
  out += "<div class=\"legend\">\n" + legend_entry("c0", mark::line, "x") +
         legend_entry("c1", mark::line, "y") + legend_entry("c3", mark::line, "z") + "</div>\n";
  for (vector_series const& series : all) { out += chart_of(series, r); }
  return out + "</section>\n";
}

}  // namespace seq::detail
