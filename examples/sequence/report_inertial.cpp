// SPDX-License-Identifier: Apache-2.0
// The IMU in the report: figures, printed lines, and charts of velocity and biases.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>
#include <vector>

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

std::string whether_known(imu_figures const& f) {
  std::string const at_end = f.last_state.empty() || f.last_state == "used"
                                 ? ""
                                 : "; at the end " + f.last_state + ": " + f.last_why;
  if (!f.known_from) { return "never known" + at_end; }
  return "known from frame " + std::to_string(*f.known_from) + ", " + std::to_string(f.optimized) +
         " poses optimised with it, " + std::to_string(f.bridged) +
         " frames without a match bridged" + at_end;
}

void add_state(imu_figures& f, frame_record const& r) {
  if (r.imu_state.empty()) { return; }
  auto at = std::find_if(f.states.begin(), f.states.end(), [&](imu_figures::state const& s) {
    return s.name == r.imu_state && s.reason == r.imu_reason;
  });
  if (at == f.states.end()) {
    at = f.states.insert(at, {r.imu_state, r.imu_reason, r.imu_why, r.index, 0});
  }
  ++at->frames;
  f.last_state = r.imu_state;
  f.last_why = r.imu_why;
}

}  // namespace

std::optional<imu_figures> imu_figures_of(run_report const& report) {
  if (!report.with_imu) { return std::nullopt; }
  imu_figures f;
  for (frame_record const& r : report.records) {
    add_state(f, r);
    if (!r.imu) { continue; }
    if (!f.known_from) { f.known_from = r.index; }
    f.optimized += static_cast<int>(r.imu->optimized);
    f.bridged += static_cast<int>(!r.tracked);
    f.last = *r.imu;
  }
  return f;
}

std::vector<std::string> imu_state_sentences(imu_figures const& f, std::size_t frames) {
  std::vector<std::string> out;
  for (imu_figures::state const& s : f.states) {
    out.push_back(s.name + (s.reason.empty() ? "" : " (" + s.reason + ")") + " in " +
                  std::to_string(s.frames) + " of " + std::to_string(frames) +
                  " frames, first in frame " + std::to_string(s.first) +
                  (s.why.empty() ? "" : ": " + s.why));
  }
  return out;
}

std::string imu_lines(run_report const& report) {
  auto const f = imu_figures_of(report);
  if (!f) { return {}; }
  std::string text = "  IMU               " + whether_known(*f) + '\n';
  for (std::string const& said : imu_state_sentences(*f, report.records.size())) {
    text += "  IMU state         " + said + '\n';
  }
  if (!f->known_from) { return text; }
  return text + "  gyro bias         " + three(f->last.gyro_bias, 5) +
         " rad/s\n  accel bias        " + three(f->last.accel_bias, 4) + " m/s^2\n";
}

std::string imu_section(run_report const& r) {
  auto const f = imu_figures_of(r);
  if (!f) { return {}; }
  std::string states;
  for (std::string const& said : imu_state_sentences(*f, r.records.size())) {
    states += "<li>" + escape(said) + "</li>\n";
  }
  if (!states.empty()) { states = "<ul class=\"list\">\n" + states + "</ul>\n"; }
  std::string out = section_open("IMU", "Gravity and biases: " + whether_known(*f) + ".") + states;
  if (!f->known_from) { return out + "</section>\n"; }
  static constexpr vector_series all[] = {
      {"Velocity in the world", "m/s", 0.1, &imu_record::velocity},
      {"Bias of the gyroscope", "rad/s", 1e-3, &imu_record::gyro_bias},
      {"Bias of the accelerometer", "m/s\xc2\xb2", 0.02, &imu_record::accel_bias},
  };
  out += "<div class=\"legend\">\n" + legend_entry("c0", mark::line, "x") +
         legend_entry("c1", mark::line, "y") + legend_entry("c3", mark::line, "z") + "</div>\n";
  for (vector_series const& series : all) { out += chart_of(series, r); }
  return out + "</section>\n";
}

}  // namespace seq::detail
