// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "examples/sequence/report_markup.hpp"
#include "examples/sequence/report_sections.hpp"

namespace seq::detail {
namespace {

using positions = std::vector<std::pair<std::int64_t, Eigen::Vector3d>>;

positions finite_positions(trajectory const& poses, Eigen::Isometry3d const& transform) {
  positions out;
  out.reserve(poses.size());
  for (stamped_pose const& p : poses) {
    Eigen::Vector3d const at = transform * p.T_world_camera.translation();
    if (at.allFinite()) { out.emplace_back(p.time_ns, at); }
  }
  return out;
}

/// Longest time step that a line bridges: tracking was lost during anything longer.
std::int64_t bridged_gap(positions const& points) {
  std::vector<std::int64_t> steps;
  for (std::size_t i = 1; i < points.size(); ++i) {
    steps.push_back(points[i].first - points[i - 1].first);
  }
  if (steps.empty()) { return 0; }
  auto const middle = steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2);
  std::nth_element(steps.begin(), middle, steps.end());
  return *middle * 5 / 2;
}

/// The part of the truth that the run covers; all of it if the run has no frames.
trajectory covered(trajectory const& truth, std::vector<frame_record> const& records) {
  if (records.empty()) { return truth; }
  auto const [first, last] = std::minmax_element(
      records.begin(), records.end(),
      [](frame_record const& a, frame_record const& b) { return a.time_ns < b.time_ns; });
  trajectory out;
  for (stamped_pose const& p : truth) {
    if (p.time_ns >= first->time_ns && p.time_ns <= last->time_ns) { out.push_back(p); }
  }
  return out.empty() ? truth : out;
}

/// One axis of the world, possibly reversed.
struct signed_axis {
  int index = 0;
  double sign = 1;

  double of(Eigen::Vector3d const& p) const { return sign * p[index]; }
  std::string name() const {
    return (sign < 0 ? "\xe2\x88\x92" : "") + std::string(1, static_cast<char>('x' + index));
  }
};

struct view_plane {
  signed_axis across, up;
};

/// The two axes of largest extent. Without ground truth the world is the first camera's frame (y
/// down), so "from above" is x-z with z upwards on paper, and y is drawn reversed. A tall shape is
/// rotated clockwise by a quarter turn, because paper and screens are wide.
view_plane choose_plane(positions const& points, bool truth) {
  Eigen::Vector3d low = points.front().second, high = low;
  for (auto const& p : points) {
    low = low.cwiseMin(p.second);
    high = high.cwiseMax(p.second);
  }
  Eigen::Vector3d const extent = high - low;
  // for equal extents drop the axis that is vertical by convention
  int drop = truth ? 2 : 1;
  for (int a = 0; a < 3; ++a) {
    if (extent[a] < extent[drop]) { drop = a; }
  }
  view_plane v;
  if (drop == 2) { v = {{0, 1.0}, {1, truth ? 1.0 : -1.0}}; }
  if (drop == 1) { v = {{0, 1.0}, {2, 1.0}}; }
  if (drop == 0) { v = truth ? view_plane{{1, 1.0}, {2, 1.0}} : view_plane{{2, 1.0}, {1, -1.0}}; }
  if (extent[v.up.index] > 1.5 * extent[v.across.index]) {
    v = {v.up, {v.across.index, -v.across.sign}};
  }
  return v;
}

}  // namespace

std::string trajectory_section(run_report const& r, run_figures const& f) {
  bool const has_truth = !r.truth.empty();
  positions const estimate = finite_positions(
      r.estimate, has_truth ? r.error.T_truth_estimate : Eigen::Isometry3d::Identity());
  positions const truth =
      finite_positions(covered(r.truth, r.records), Eigen::Isometry3d::Identity());
  positions const& reference = truth.empty() ? estimate : truth;
  if (reference.empty()) {
    return section_open("Trajectory", "") + nothing("No pose was estimated.") + "</section>\n";
  }
  view_plane const plane = choose_plane(reference, !truth.empty());
  auto const across = [&](Eigen::Vector3d const& p) { return plane.across.of(p); };
  auto const up = [&](Eigen::Vector3d const& p) { return plane.up.of(p); };

  chart c;
  constexpr double huge = std::numeric_limits<double>::max();
  c.x = {huge, -huge};
  c.y = {huge, -huge};
  for (positions const* points : {&estimate, &truth}) {
    for (auto const& p : *points) {
      c.x = {std::min(c.x.low, across(p.second)), std::max(c.x.high, across(p.second))};
      c.y = {std::min(c.y.low, up(p.second)), std::max(c.y.high, up(p.second))};
    }
  }
  // equal scale: the height follows the shape within bounds, then the shorter axis is extended
  double const margin = 0.05 * std::max({c.x.span(), c.y.span(), 0.2});
  c.x = {c.x.low - margin, c.x.high + margin};
  c.y = {c.y.low - margin, c.y.high + margin};
  double const inner = std::clamp(c.inner_width() * c.y.span() / c.x.span(), 240.0, 520.0);
  c.height = inner + c.top + c.bottom;
  double const scale = std::max(c.x.span() / c.inner_width(), c.y.span() / c.inner_height());
  auto const widen = [scale](range axis, double length) {
    double const centre = (axis.low + axis.high) / 2, half = scale * length / 2;
    return range{centre - half, centre + half};
  };
  c.x = widen(c.x, c.inner_width());
  c.y = widen(c.y, c.inner_height());

  auto const line = [&](positions const& points) {
    std::int64_t const gap = bridged_gap(points);
    pen p;
    for (std::size_t i = 0; i < points.size(); ++i) {
      if (i > 0 && points[i].first - points[i - 1].first > gap) { p.cut(); }
      p.to(c.px(across(points[i].second)), c.py(up(points[i].second)));
    }
    return p.take();
  };

  bool const above = truth.empty() && plane.across.index != 1 && plane.up.index != 1;
  std::string caption = std::string("Seen ") +
                        (above ? "from above" : "along the axis of least extent") +
                        ", equal scale on both axes. ";
  caption += has_truth
                 ? "The estimate is moved onto the ground truth by the rigid alignment of the "
                   "absolute error; gaps are lost frames."
                 : "World frame: the first camera's, x right, y down, z forward; gaps are lost "
                   "frames.";
  std::string out = section_open("Trajectory", caption);
  out += "<div class=\"legend\">\n";
  if (!truth.empty()) { out += legend_entry("truth", mark::line, "ground truth"); }
  if (!estimate.empty()) {
    out += legend_entry("estimate", mark::line, f.ate_rmse_m ? "estimate, aligned" : "estimate");
    out += legend_entry("start", mark::dot, "start");
    out += legend_entry("end", mark::dot, "end");
  } else {
    out += "<span class=\"key\">no pose was estimated</span>\n";
  }
  out += "</div>\n" + c.open("Trajectory");
  out += c.axes(plane.across.name() + " [m]", plane.up.name() + " [m]", false, false);
  out += path("truth", line(truth)) + path("estimate", line(estimate));
  if (!estimate.empty()) {
    auto const dot = [&](char const* style, Eigen::Vector3d const& p) {
      return std::string("<circle class=\"") + style + '"' + attribute("cx", c.px(across(p))) +
             attribute("cy", c.py(up(p))) + " r=\"6\"/>";
    };
    out += dot("start", estimate.front().second) + dot("end", estimate.back().second);
  }
  return out + chart::close() + "</section>\n";
}

std::string error_section(run_report const& r, run_figures const& f) {
  if (r.truth.empty()) { return {}; }
  std::string const title = "Position error over time";
  std::vector<std::pair<std::int64_t, double>> errors;
  for (stamped_pose const& p : r.estimate) {
    auto const truth = interpolate(r.truth, p.time_ns);
    if (!truth) { continue; }
    double const e =
        (r.error.T_truth_estimate * p.T_world_camera.translation() - truth->translation()).norm();
    if (std::isfinite(e)) { errors.emplace_back(p.time_ns, e); }
  }
  if (errors.empty()) {
    return section_open(title, "") + nothing("No estimated pose has ground truth.") +
           "</section>\n";
  }
  std::int64_t const origin = r.records.empty() ? errors.front().first : r.records.front().time_ns;
  auto const seconds = [origin](std::int64_t t) { return static_cast<double>(t - origin) * 1e-9; };
  std::vector<double> sorted;
  positions stamps;
  for (auto const& e : errors) {
    sorted.push_back(e.second);
    stamps.emplace_back(e.first, Eigen::Vector3d::Zero());
  }
  std::sort(sorted.begin(), sorted.end());

  chart c;
  c.height = 230;
  c.x = {seconds(errors.front().first), seconds(errors.back().first)};
  if (!r.records.empty()) {
    c.x.low = std::min(c.x.low, 0.0);
    c.x.high = std::max(c.x.high, seconds(r.records.back().time_ns));
  }
  if (!(c.x.span() > 0)) { c.x.high = c.x.low + 1; }
  c.y = {0, std::max(sorted.back() * 1.08, 1e-3)};

  std::int64_t const gap = bridged_gap(stamps);
  // buckets keep their largest error, so that no peak is lost
  std::size_t const size =
      std::max<std::size_t>(1, (errors.size() + most_points - 1) / most_points);
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
    return i > 0 && errors[i].first - errors[i - 1].first > gap;
  };
  for (std::size_t i = 0, end = 0; i < errors.size(); i = end) {
    end = i + 1;
    while (end < errors.size() && end - i < size && !lost_before(end)) { ++end; }
    auto const worst =
        *std::max_element(errors.begin() + static_cast<std::ptrdiff_t>(i),
                          errors.begin() + static_cast<std::ptrdiff_t>(end),
                          [](auto const& a, auto const& b) { return a.second < b.second; });
    if (lost_before(i)) {
      line.cut();
      close_area();
    }
    double const x = c.px(seconds(worst.first)), y = c.py(worst.second);
    if (points.empty()) { area_begin = x; }
    area_end = x;
    points += 'L' + coordinate(x) + ' ' + coordinate(y);
    line.to(x, y);
  }
  close_area();

  std::string out = section_open(
      title,
      "Distance between the aligned estimate and the ground truth at the same instant. Median " +
          fixed(percentile(sorted, 50), 3) + " m, largest " + fixed(sorted.back(), 3) + " m.");
  out += "<div class=\"legend\">\n" + legend_entry("estimate", mark::line, "error");
  if (f.ate_rmse_m) {
    out += legend_entry("level", mark::line, "RMSE " + fixed(*f.ate_rmse_m, 3) + " m");
  }
  out += "</div>\n" + c.open(title) + c.axes("time [s]", "error [m]", false, false);
  out += path("wash", area) + path("estimate", line.take());
  if (f.ate_rmse_m && *f.ate_rmse_m <= c.y.high) {
    out += path("level", 'M' + coordinate(c.left) + ' ' + coordinate(c.py(*f.ate_rmse_m)) + 'H' +
                             coordinate(c.width - c.right));
  }
  return out + chart::close() + "</section>\n";
}

}  // namespace seq::detail
