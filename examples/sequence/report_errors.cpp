// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "examples/sequence/report_markup.hpp"
#include "examples/sequence/report_paths.hpp"
#include "examples/sequence/report_sections.hpp"

namespace seq::detail {
namespace {

/// One error over time.
struct error_series {
  char const* title;
  char const* what;  ///< for the caption
  char const* unit;
  double least_height;         ///< of the axis
  std::optional<double> rmse;  ///< as printed elsewhere
  std::vector<std::pair<std::int64_t, double>> values;
};

chart chart_of(error_series const& series, run_report const& r, double largest) {
  auto const& values = series.values;
  std::int64_t const origin = r.records.empty() ? values.front().first : r.records.front().time_ns;
  auto const seconds = [origin](std::int64_t t) { return static_cast<double>(t - origin) * 1e-9; };
  chart c;
  c.height = 230;
  c.x = {seconds(values.front().first), seconds(values.back().first)};
  if (!r.records.empty()) {
    c.x.low = std::min(c.x.low, 0.0);
    c.x.high = std::max(c.x.high, seconds(r.records.back().time_ns));
  }
  if (!(c.x.span() > 0)) { c.x.high = c.x.low + 1; }
  c.y = {0, std::max(largest * 1.08, series.least_height)};
  return c;
}

/// The line and the area below it, interrupted where tracking was lost.
std::string curve(error_series const& series, chart const& c, std::int64_t origin) {
  auto const& values = series.values;
  positions stamps;
  for (auto const& e : values) { stamps.emplace_back(e.first, Eigen::Vector3d::Zero()); }
  std::int64_t const gap = bridged_gap(stamps);
  // buckets keep their largest error, so that no peak is lost
  std::size_t const size =
      std::max<std::size_t>(1, (values.size() + most_points - 1) / most_points);
  pen line;
  std::string area;
  double area_begin = 0, area_end = 0;
  std::string points;
  auto const close_area = [&] {
    if (!points.empty()) {
      area += 'M' + coordinate(area_begin) + ' ' + coordinate(c.py(0)) + points + 'L' +
              coordinate(area_end) + ' ' + coordinate(c.py(0)) + 'Z';
    }
    points.clear();
  };
  auto const lost_before = [&](std::size_t i) {
    return i > 0 && values[i].first - values[i - 1].first > gap;
  };
  for (std::size_t i = 0, end = 0; i < values.size(); i = end) {
    end = i + 1;
    while (end < values.size() && end - i < size && !lost_before(end)) { ++end; }
    auto const worst =
        *std::max_element(values.begin() + static_cast<std::ptrdiff_t>(i),
                          values.begin() + static_cast<std::ptrdiff_t>(end),
                          [](auto const& a, auto const& b) { return a.second < b.second; });
    if (lost_before(i)) {
      line.cut();
      close_area();
    }
    double const x = c.px(static_cast<double>(worst.first - origin) * 1e-9);
    double const y = c.py(worst.second);
    if (points.empty()) { area_begin = x; }
    area_end = x;
    points += 'L' + coordinate(x) + ' ' + coordinate(y);
    line.to(x, y);
  }
  close_area();
  return path("wash", area) + path("estimate", line.take());
}

std::string section_of(error_series const& series, run_report const& r) {
  std::vector<double> sorted;
  for (auto const& e : series.values) { sorted.push_back(e.second); }
  std::sort(sorted.begin(), sorted.end());
  chart const c = chart_of(series, r, sorted.back());
  std::int64_t const origin =
      r.records.empty() ? series.values.front().first : r.records.front().time_ns;
  std::string const unit = std::string(" ") + series.unit;
  std::string out = section_open(
      series.title, std::string(series.what) + " Median " + fixed(percentile(sorted, 50), 3) +
                        unit + ", largest " + fixed(sorted.back(), 3) + unit + ".");
  out += "<div class=\"legend\">\n" + legend_entry("estimate", mark::line, "error");
  if (series.rmse) {
    out += legend_entry("level", mark::line, "RMSE " + fixed(*series.rmse, 3) + unit);
  }
  out += "</div>\n" + c.open(series.title);
  out += c.axes("time [s]", std::string("error [") + series.unit + "]", false, false);
  out += curve(series, c, origin);
  if (series.rmse && *series.rmse <= c.y.high) {
    out += path("level", 'M' + coordinate(c.left) + ' ' + coordinate(c.py(*series.rmse)) + 'H' +
                             coordinate(c.width - c.right));
  }
  return out + chart::close() + "</section>\n";
}

}  // namespace

std::string error_section(run_report const& r, run_figures const& f) {
  if (r.truth.empty()) { return {}; }
  error_series place{"Position error over time",
                     "Distance between the aligned estimate and the ground truth at the same "
                     "instant.",
                     "m",
                     1e-3,
                     f.ate_rmse_m,
                     {}};
  error_series turn{"Rotation error over time",
                    "Angle between the aligned estimate's orientation and the ground truth's at "
                    "the same instant.",
                    "deg",
                    1e-2,
                    f.ate_rotation_rmse_deg,
                    {}};
  for (stamped_pose const& p : r.estimate) {
    auto const truth = interpolate(r.truth, p.time_ns);
    if (!truth) { continue; }
    Eigen::Isometry3d const aligned = r.error.T_truth_estimate * p.T_world_camera;
    double const e = (aligned.translation() - truth->translation()).norm();
    if (std::isfinite(e)) { place.values.emplace_back(p.time_ns, e); }
    double const angle = angle_deg(truth->linear().transpose() * aligned.linear());
    if (std::isfinite(angle)) { turn.values.emplace_back(p.time_ns, angle); }
  }
  if (place.values.empty()) {
    return section_open(place.title, "") + nothing("No estimated pose has ground truth.") +
           "</section>\n";
  }
  std::string out = section_of(place, r);
  if (turn.rmse && !turn.values.empty()) { out += section_of(turn, r); }
  return out;
}

}  // namespace seq::detail
