// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <limits>
#include <utility>
#include <vector>

#include "examples/sequence/report_markup.hpp"
#include "examples/sequence/report_paths.hpp"
#include "examples/sequence/report_sections.hpp"

namespace seq::detail {
namespace {

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

/// Axes of equal scale that hold all paths; the height follows their shape within bounds.
chart chart_of(std::initializer_list<positions const*> shown, view_plane const& plane) {
  chart c;
  constexpr double huge = std::numeric_limits<double>::max();
  c.x = {huge, -huge};
  c.y = {huge, -huge};
  for (positions const* points : shown) {
    for (auto const& p : *points) {
      c.x = {std::min(c.x.low, plane.across.of(p.second)),
             std::max(c.x.high, plane.across.of(p.second))};
      c.y = {std::min(c.y.low, plane.up.of(p.second)), std::max(c.y.high, plane.up.of(p.second))};
    }
  }
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
  return c;
}

/// Loops as lines of two places each.
struct edge_lines {
  std::vector<positions> closed;  ///< on the corrected path
  std::vector<positions> open;    ///< on the path that no loop has corrected
};

edge_lines lines_of(loop_record const& loops, positions const& tracked,
                    Eigen::Isometry3d const& T_drawn) {
  edge_lines lines;
  auto const at = [&](std::int64_t time_ns) {
    return std::lower_bound(tracked.begin(), tracked.end(), time_ns,
                            [](auto const& p, std::int64_t t) { return p.first < t; });
  };
  for (loop_edge const& e : loops.edges) {
    positions const line = finite_positions({e.from, e.to}, T_drawn);
    if (line.size() == 2) { lines.closed.push_back(line); }
    auto const from = at(e.from.time_ns), to = at(e.to.time_ns);
    if (!e.loaded && from != tracked.end() && to != tracked.end()) {
      lines.open.push_back({*from, *to});
    }
  }
  return lines;
}

}  // namespace

std::string trajectory_section(run_report const& r, run_figures const& f) {
  bool const has_truth = !r.truth.empty();
  Eigen::Isometry3d const T_drawn =
      has_truth ? r.error.T_truth_estimate : Eigen::Isometry3d::Identity();
  positions const estimate = finite_positions(r.estimate, T_drawn);
  positions const truth =
      finite_positions(covered(r.truth, r.records), Eigen::Isometry3d::Identity());
  positions const& reference = truth.empty() ? estimate : truth;
  if (reference.empty()) {
    return section_open("Trajectory", "") + nothing("No pose was estimated.") + "</section>\n";
  }
  view_plane const plane = choose_plane(reference, !truth.empty());
  auto const across = [&](Eigen::Vector3d const& p) { return plane.across.of(p); };
  auto const up = [&](Eigen::Vector3d const& p) { return plane.up.of(p); };

  positions const tracked = r.loops ? finite_positions(r.loops->tracked, T_drawn) : positions();
  chart const c = chart_of({&estimate, &truth, &tracked}, plane);
  auto const line = [&](positions const& points) {
    std::int64_t const gap = bridged_gap(points);
    pen p;
    for (std::size_t i = 0; i < points.size(); ++i) {
      if (i > 0 && points[i].first - points[i - 1].first > gap) { p.cut(); }
      p.to(c.px(across(points[i].second)), c.py(up(points[i].second)));
    }
    return p.take();
  };

  edge_lines const edges = r.loops ? lines_of(*r.loops, tracked, T_drawn) : edge_lines();
  auto const apart = [&](std::vector<positions> const& lines) {
    std::string all;
    for (positions const& of : lines) {
      pen p;
      for (auto const& at : of) { p.to(c.px(across(at.second)), c.py(up(at.second))); }
      all += p.take();
    }
    return all;
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
    if (!tracked.empty()) { out += legend_entry("tracked", mark::line, "without its loops"); }
    if (!edges.closed.empty()) {
      out += legend_entry("loop", mark::line, "loop: two keyframes at one place");
      out += legend_entry("open-loop", mark::line, "the same two without the loops");
    }
    out += legend_entry("start", mark::dot, "start");
    out += legend_entry("end", mark::dot, "end");
  } else {
    out += "<span class=\"key\">no pose was estimated</span>\n";
  }
  out += "</div>\n" + c.open("Trajectory");
  out += c.axes(plane.across.name() + " [m]", plane.up.name() + " [m]", false, false);
  out += path("truth", line(truth)) + path("open-loop", apart(edges.open)) +
         path("tracked", line(tracked)) + path("estimate", line(estimate)) +
         path("loop", apart(edges.closed));
  if (!estimate.empty()) {
    auto const dot = [&](char const* style, Eigen::Vector3d const& p) {
      return std::string("<circle class=\"") + style + '"' + attribute("cx", c.px(across(p))) +
             attribute("cy", c.py(up(p))) + " r=\"6\"/>";
    };
    out += dot("start", estimate.front().second) + dot("end", estimate.back().second);
  }
  return out + chart::close() + "</section>\n";
}

}  // namespace seq::detail
