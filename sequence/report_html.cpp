// SPDX-License-Identifier: Apache-2.0
#include "sequence/report.hpp"

#include "sequence/image_io.hpp"
#include "sequence/report_figures.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>

// The report is one HTML file without scripts: figures are inline SVG, pictures base64 JPEG.
// Colours of charts are CSS classes, so that dark mode and print only redefine variables. The
// markup is written so that every element but <meta> and <br> is closed, which the test checks.

namespace seq {
namespace {

using detail::fixed;
using detail::run_figures;
using detail::stage_time;

// ------------------------------------------------------------------------------------------- text

std::string escape(std::string const& text) {
  std::string out;
  out.reserve(text.size());
  for (char const c : text) {
    switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      case '\'':
        out += "&#39;";
        break;
      default:
        // control characters are not allowed in HTML
        out += static_cast<unsigned char>(c) < 0x20 || c == 0x7f ? ' ' : c;
    }
  }
  return out;
}

/// One decimal, the shortest text; what is not finite becomes 0, so no attribute can hold "nan".
std::string coordinate(double value) {
  if (!std::isfinite(value)) { return "0"; }
  std::int64_t const tenths = std::llround(std::clamp(value, -1e6, 1e6) * 10);
  std::int64_t const magnitude = std::abs(tenths);
  std::string text = std::to_string(magnitude / 10);
  if (magnitude % 10 != 0) { text += '.' + std::to_string(magnitude % 10); }
  return tenths < 0 ? '-' + text : text;
}

std::string attribute(char const* name, double value) {
  return std::string(" ") + name + "=\"" + coordinate(value) + '"';
}

/// Integer with a thin space between thousands.
std::string grouped(long long value) {
  std::string text = std::to_string(value);
  std::ptrdiff_t const first = value < 0 ? 1 : 0;
  for (std::ptrdiff_t i = static_cast<std::ptrdiff_t>(text.size()) - 3; i > first; i -= 3) {
    text.insert(static_cast<std::size_t>(i), "\xe2\x80\xaf");
  }
  return text;
}

/// Three or four significant digits, for figures whose magnitude is not known in advance.
std::string significant(double value) {
  double const size = std::abs(value);
  return fixed(value, size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : size >= 0.1 ? 3 : 4);
}

std::string base64(std::vector<std::uint8_t> const& bytes) {
  static constexpr char digits[] =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  out.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    std::size_t const n = std::min<std::size_t>(3, bytes.size() - i);
    std::uint32_t word = std::uint32_t{bytes[i]} << 16U;
    if (n > 1) { word |= std::uint32_t{bytes[i + 1]} << 8U; }
    if (n > 2) { word |= std::uint32_t{bytes[i + 2]}; }
    out += digits[word >> 18U & 63U];
    out += digits[word >> 12U & 63U];
    out += n > 1 ? digits[word >> 6U & 63U] : '=';
    out += n > 2 ? digits[word & 63U] : '=';
  }
  return out;
}

// ----------------------------------------------------------------------------------------- charts

struct range {
  double low = 0, high = 1;
  double span() const { return high - low; }
};

/// 1, 2 or 5 times a power of ten, so that about `count` steps fill `span`.
double nice_step(double span, double count) {
  double const raw = span / std::max(count, 1.0);
  if (!(raw > 0) || !std::isfinite(raw)) { return 1; }
  double const power = std::pow(10.0, std::floor(std::log10(raw)));
  double const mantissa = raw / power;
  return power * (mantissa <= 1.0001 ? 1 : mantissa <= 2.0001 ? 2 : mantissa <= 5.0001 ? 5 : 10);
}

std::string tick_text(double value, double step) {
  int const digits = step >= 1 ? 0 : static_cast<int>(std::ceil(-std::log10(step) - 1e-9));
  return fixed(value, std::min(digits, 6));
}

std::string path(char const* style, std::string const& data) {
  if (data.empty()) { return {}; }
  return std::string("<path class=\"") + style + "\" d=\"" + data + "\"/>\n";
}

/// Multiples of `step` within the axis. At most a hundred: an axis far from zero and short (a run
/// that diverged) may be below the resolution of its numbers.
std::vector<double> ticks(range const& axis, double step) {
  std::vector<double> out;
  double const first = std::ceil(axis.low / step - 1e-9) * step;
  for (int i = 0; i < 100; ++i) {
    double const t = first + i * step;
    if (!(t <= axis.high + step * 1e-6)) { break; }
    out.push_back(t);
  }
  return out;
}

/// A drawing area with linear axes; everything in units of the SVG's view box.
class chart {
public:
  double width = 1000, height = 300;
  double left = 62, right = 14, top = 14, bottom = 42;
  range x, y;

  double inner_width() const { return width - left - right; }
  double inner_height() const { return height - top - bottom; }
  double px(double value) const { return left + (value - x.low) / x.span() * inner_width(); }
  double py(double value) const { return top + (y.high - value) / y.span() * inner_height(); }
  double py_clipped(double value) const { return py(std::clamp(value, y.low, y.high)); }

  std::string open(std::string const& label) const {
    return "<div class=\"scroll\"><svg class=\"chart\" viewBox=\"0 0 " + coordinate(width) + ' ' +
           coordinate(height) + "\" role=\"img\" aria-label=\"" + escape(label) + "\">\n";
  }
  static std::string close() { return "</svg></div>\n"; }

  /// Grid lines, tick labels and axis titles. @param whole_x @param whole_y ticks at integers only
  std::string axes(std::string const& x_title, std::string const& y_title, bool whole_x,
                   bool whole_y) const {
    std::string grid, labels;
    double const floor_y = top + inner_height();
    double step = nice_step(x.span(), inner_width() / 95);
    if (whole_x) { step = std::max(step, 1.0); }
    for (double const t : ticks(x, step)) {
      grid += 'M' + coordinate(px(t)) + ' ' + coordinate(top) + 'V' + coordinate(floor_y);
      labels += text(px(t), floor_y + 17, "tick mid", tick_text(t, step));
    }
    step = nice_step(y.span(), inner_height() / 36);
    if (whole_y) { step = std::max(step, 1.0); }
    for (double const t : ticks(y, step)) {
      grid += 'M' + coordinate(left) + ' ' + coordinate(py(t)) + 'H' + coordinate(width - right);
      labels += text(left - 8, py(t) + 4, "tick end", tick_text(t, step));
    }
    std::string out = path("grid", grid) + labels;
    out += text(left + inner_width() / 2, height - 6, "axis mid", x_title);
    double const middle = top + inner_height() / 2;
    out += "<text class=\"axis mid\" transform=\"translate(14 " + coordinate(middle) +
           ") rotate(-90)\">" + escape(y_title) + "</text>\n";
    return out;
  }

  static std::string text(double at_x, double at_y, char const* style, std::string const& content) {
    return std::string("<text class=\"") + style + '"' + attribute("x", at_x) +
           attribute("y", at_y) + '>' + escape(content) + "</text>";
  }
};

/// Path data of lines; starts a new one after cut(), and leaves out points closer than half a unit.
class pen {
public:
  void to(double x, double y) {
    if (!std::isfinite(x) || !std::isfinite(y)) { return cut(); }
    if (down_ && std::abs(x - x_) < 0.5 && std::abs(y - y_) < 0.5) {
      skipped_ = true;
      skipped_x_ = x;
      skipped_y_ = y;
      return;
    }
    skipped_ = false;
    put(x, y);
  }
  void cut() {
    if (skipped_) { put(skipped_x_, skipped_y_); }
    skipped_ = false;
    down_ = false;
  }
  std::string take() {
    cut();
    return std::exchange(data_, {});
  }

private:
  void put(double x, double y) {
    data_ += (down_ ? 'L' : 'M') + coordinate(x) + ' ' + coordinate(y);
    down_ = true;
    x_ = x;
    y_ = y;
  }

  std::string data_;
  bool down_ = false, skipped_ = false;
  double x_ = 0, y_ = 0, skipped_x_ = 0, skipped_y_ = 0;
};

enum class mark { line, area, dot, tick };

/// One entry of a legend: a sample of the class's colour, then the words.
std::string legend_entry(std::string const& style, mark shape, std::string const& words) {
  std::string out = "<span class=\"key\"><svg class=\"swatch\" viewBox=\"0 0 22 12\">";
  switch (shape) {
    case mark::line:
      out += "<path class=\"" + style + "\" d=\"M1 6H21\"/>";
      break;
    case mark::area:
      out += "<rect class=\"" + style + "\" x=\"5\" y=\"0\" width=\"12\" height=\"12\" rx=\"2\"/>";
      break;
    case mark::tick:
      out += "<path class=\"" + style + "\" d=\"M11 2V10\"/>";
      break;
    case mark::dot:
      out += "<circle class=\"" + style + "\" cx=\"11\" cy=\"6\" r=\"4.5\"/>";
      break;
  }
  return out + "</svg>" + escape(words) + "</span>\n";
}

std::string section_open(std::string const& title, std::string const& caption) {
  std::string out = "<section>\n<h2>" + escape(title) + "</h2>\n";
  if (!caption.empty()) { out += "<p class=\"caption\">" + escape(caption) + "</p>\n"; }
  return out;
}

std::string nothing(std::string const& words) {
  return "<p class=\"nothing\">" + escape(words) + "</p>\n";
}

// ----------------------------------------------------------------------------- stages and buckets

constexpr int stage_colours = 10;

std::string stage_style(std::size_t s) {
  return "s" + std::to_string(s % static_cast<std::size_t>(stage_colours));
}

/// Consecutive records drawn as one point, so that long sequences stay small.
struct bucket {
  std::size_t begin = 0, end = 0;
  double x = 0;  ///< mean frame index
};

std::vector<bucket> buckets_of(std::vector<frame_record> const& records, std::size_t most) {
  std::vector<bucket> out;
  std::size_t const size = std::max<std::size_t>(1, (records.size() + most - 1) / most);
  for (std::size_t i = 0; i < records.size(); i += size) {
    bucket b;
    b.begin = i;
    b.end = std::min(i + size, records.size());
    double sum = 0;
    for (std::size_t k = b.begin; k < b.end; ++k) { sum += records[k].index; }
    b.x = sum / static_cast<double>(b.end - b.begin);
    out.push_back(b);
  }
  return out;
}

constexpr std::size_t most_points = 900;

range index_range(std::vector<frame_record> const& records) {
  range r{std::numeric_limits<double>::max(), std::numeric_limits<double>::lowest()};
  for (frame_record const& f : records) {
    r.low = std::min(r.low, static_cast<double>(f.index));
    r.high = std::max(r.high, static_cast<double>(f.index));
  }
  if (!(r.span() > 0)) { r = {r.low - 0.5, r.low + 0.5}; }
  return r;
}

// ------------------------------------------------------------------------------------------ parts

std::string card(std::string const& name, std::string const& value, std::string const& unit,
                 std::string const& note, char const* style = "") {
  std::string out = std::string("<div class=\"card ") + style + "\"><div class=\"name\">" +
                    escape(name) + "</div><div class=\"value\">" + escape(value);
  if (!unit.empty() && value != "n/a") {
    out += "<span class=\"unit\"> " + escape(unit) + "</span>";
  }
  return out + "</div><div class=\"note\">" + escape(note) + "</div></div>\n";
}

std::string length_text(double metres) {
  return std::isfinite(metres) ? significant(metres) : "n/a";
}

std::string cards(run_report const& r, run_figures const& f) {
  std::string out = "<div class=\"cards\">\n";
  char const* state = !f.tracked_ratio          ? ""
                      : *f.tracked_ratio > 0.98 ? "good"
                      : *f.tracked_ratio > 0.8  ? "fair"
                                                : "bad";
  // rounded down: 100 % is for all of them
  std::string const share =
      f.tracked_ratio ? fixed(std::floor(*f.tracked_ratio * 1000) / 10, 1) : "n/a";
  out += card("Tracked", share, "%",
              grouped(r.tracked) + " of " + grouped(r.frames) + " frames, " + grouped(r.lost) +
                  " lost" + (r.dropped > 0 ? ", " + grouped(r.dropped) + " dropped" : ""),
              state);
  std::string const no_truth = "no ground truth";
  out += card("Absolute error", f.ate_rmse_m ? significant(*f.ate_rmse_m) : "n/a", "m",
              f.ate_rmse_m  ? "ATE RMSE over " + grouped(r.error.pairs) + " poses"
              : f.has_truth ? "too few poses with ground truth"
                            : no_truth);
  out += card("Relative error", f.rpe_rmse_m ? significant(*f.rpe_rmse_m) : "n/a", "m",
              f.rpe_rmse_m  ? "RPE RMSE, translation"
              : f.has_truth ? "too few poses with ground truth"
                            : no_truth);
  std::string path_note = "estimated";
  if (f.has_truth && std::isfinite(r.error.truth_path_m) && r.error.truth_path_m > 0) {
    path_note += "; ground truth " + length_text(r.error.truth_path_m) + " m";
  }
  out += card("Path", r.estimate.empty() && f.path_m <= 0 ? "n/a" : length_text(f.path_m), "m",
              path_note);
  bool const timed = !f.stages.empty() && f.stages.back().count > 0;
  out += card("Time per frame", timed ? significant(f.stages.back().ms.p50) : "n/a", "ms",
              timed ? "median; p99 " + significant(f.stages.back().ms.p99) + " ms" : "not timed");
  out += card("Throughput", f.fps ? significant(*f.fps) : "n/a", "frames/s",
              f.processing_s ? fixed(*f.processing_s, 1) + " s of processing" : "not timed");
  out +=
      card("Inliers", f.mean_inliers ? fixed(*f.mean_inliers, 0) : "n/a", "",
           f.mean_keypoints ? "mean, of " + grouped(std::llround(*f.mean_keypoints)) + " keypoints"
                            : "mean per tracked frame");
  out += card("Map", grouped(r.map_points), "points", grouped(r.keyframes) + " keyframes");
  return out + "</div>\n";
}

// -------------------------------------------------------------------------------------- trajectory

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

/// Longest step in time that a line still bridges: tracking was lost across anything longer.
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

/// The part of the truth that the run covers; all of it where the run has no frames.
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

/// One axis of the world, maybe against its direction.
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
/// down), so "from above" is x-z with z upwards on paper, and y is drawn against its sign. A tall
/// shape is turned by a quarter, clockwise, because paper and screens are wide.
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
  // equal scale: the height follows the shape within bounds, then the shorter axis is widened
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
          fixed(detail::percentile(sorted, 50), 3) + " m, largest " + fixed(sorted.back(), 3) +
          " m.");
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

// ------------------------------------------------------------------------------------------ times

std::string stage_table(run_figures const& f) {
  std::string out = section_open("Time per stage",
                                 "Milliseconds over all frames; percentiles by "
                                 "nearest rank, share of the mean total.");
  if (f.stages.empty()) { return out + nothing("No stage was timed.") + "</section>\n"; }
  out += "<div class=\"scroll\"><table class=\"figures\">\n<thead><tr><th>stage</th>";
  for (char const* head : {"mean", "std", "p50", "p99", "max"}) {
    out += std::string("<th class=\"number\">") + head + "</th>";
  }
  out += "<th class=\"share\">share</th></tr></thead>\n<tbody>\n";
  double const whole = f.stages.back().sum_ms;
  for (std::size_t s = 0; s < f.stages.size(); ++s) {
    detail::stage_figures const& stage = f.stages[s];
    bool const total = s + 1 == f.stages.size();
    out += total ? "<tr class=\"total\"><td>" : "<tr><td>";
    std::string const style = total ? std::string("sum") : stage_style(s);
    out += "<svg class=\"chip\" viewBox=\"0 0 10 10\"><rect class=\"" + style +
           "\" width=\"10\" height=\"10\" rx=\"2\"/></svg>" + escape(stage.name) + "</td>";
    for (double const v : {stage.ms.mean, stage.ms.std, stage.ms.p50, stage.ms.p99, stage.ms.max}) {
      out += "<td class=\"number\">" + (stage.count > 0 ? fixed(v, 3) : "n/a") + "</td>";
    }
    double const share = whole > 0 ? std::clamp(stage.sum_ms / whole, 0.0, 1.0) : 0;
    out += "<td class=\"share\">";
    if (stage.count > 0 && whole > 0 && !total) {
      out +=
          "<svg class=\"bar\" viewBox=\"0 0 120 10\"><rect class=\"track\" width=\"120\" "
          "height=\"10\" rx=\"2\"/><rect class=\"" +
          style + "\" width=\"" + coordinate(120 * share) +
          "\" height=\"10\" rx=\"2\"/></svg><span>" + fixed(100 * share, 1) + " %</span>";
    }
    out += "</td></tr>\n";
  }
  return out + "</tbody></table></div></section>\n";
}

/// Upper end of the time axis: all of it, unless a few outliers would flatten the rest.
double time_limit(std::vector<double> const& sorted) {
  double const largest = sorted.back(), median = detail::percentile(sorted, 50);
  if (largest <= 3 * median) { return largest * 1.08; }
  double const tail = detail::percentile(sorted, 95);
  double const limit = std::max(tail * 1.4, median * 2.5);
  return std::min(largest * 1.08, std::min(limit, median * 8));
}

std::string time_section(run_report const& r, run_figures const& f) {
  std::string const title = "Time per frame";
  std::size_t const total = r.stages.empty() ? 0 : r.stages.size() - 1;
  std::vector<double> sorted;
  for (frame_record const& record : r.records) {
    if (auto const ms = stage_time(record, total); ms && !r.stages.empty()) {
      sorted.push_back(*ms);
    }
  }
  if (sorted.empty()) {
    return section_open(title, "") + nothing("No frame was timed.") + "</section>\n";
  }
  std::sort(sorted.begin(), sorted.end());
  std::vector<bucket> const buckets = buckets_of(r.records, most_points);

  chart c;
  c.height = 300;
  c.right = 74;
  c.x = index_range(r.records);
  c.y = {0, std::max(time_limit(sorted), 1e-3)};
  auto const above = static_cast<std::size_t>(
      sorted.end() - std::upper_bound(sorted.begin(), sorted.end(), c.y.high));

  // stacked means of the stages, lowest first: layer s lies between sums[s - 1] and sums[s]
  std::vector<std::vector<double>> sums(total, std::vector<double>(buckets.size(), 0));
  std::vector<double> largest(buckets.size(), 0);
  for (std::size_t b = 0; b < buckets.size(); ++b) {
    auto const n = static_cast<double>(buckets[b].end - buckets[b].begin);
    double sum = 0;
    for (std::size_t s = 0; s < total; ++s) {
      for (std::size_t i = buckets[b].begin; i < buckets[b].end; ++i) {
        sum += std::max(stage_time(r.records[i], s).value_or(0), 0.0) / n;
      }
      sums[s][b] = sum;
    }
    for (std::size_t i = buckets[b].begin; i < buckets[b].end; ++i) {
      largest[b] = std::max(largest[b], stage_time(r.records[i], total).value_or(0));
    }
  }
  bool const merged = buckets.size() < r.records.size();
  std::string caption = merged ? "Stages stacked, means of " +
                                     std::to_string(buckets.front().end - buckets.front().begin) +
                                     " frames a point; the line is the slowest frame of each."
                               : "Stages stacked; the line is the whole frame.";
  if (above > 0) {
    caption += " The axis is cut: " + grouped(static_cast<long long>(above)) +
               (above == 1 ? " frame reaches" : " frames reach") +
               " beyond it (triangles), up to " + significant(sorted.back()) + " ms.";
  }
  std::string out = section_open(title, caption) + "<div class=\"legend\">\n";
  for (std::size_t s = total; s-- > 0;) {
    out += legend_entry(stage_style(s), mark::area, r.stages[s]);
  }
  out += legend_entry("outline", mark::line, r.stages[total]) + "</div>\n";
  out += c.open(title) + c.axes("frame", "time [ms]", true, false);

  for (std::size_t s = 0; s < total; ++s) {
    std::string data;
    auto const point = [&](double x, double ms) {
      data += (data.empty() ? 'M' : 'L') + coordinate(c.px(x)) + ' ' + coordinate(c.py_clipped(ms));
    };
    // a single frame becomes a column as wide as the chart
    if (buckets.size() == 1) { point(c.x.low, sums[s][0]); }
    for (std::size_t b = 0; b < buckets.size(); ++b) { point(buckets[b].x, sums[s][b]); }
    if (buckets.size() == 1) { point(c.x.high, sums[s][0]); }
    auto const floor_of = [&](std::size_t b) { return s == 0 ? 0.0 : sums[s - 1][b]; };
    if (buckets.size() == 1) { point(c.x.high, floor_of(0)); }
    for (std::size_t b = buckets.size(); b-- > 0;) { point(buckets[b].x, floor_of(b)); }
    if (buckets.size() == 1) { point(c.x.low, floor_of(0)); }
    out += path(stage_style(s).c_str(), data + 'Z');
  }
  pen line;
  if (buckets.size() == 1) { line.to(c.px(c.x.low), c.py_clipped(largest[0])); }
  for (std::size_t b = 0; b < buckets.size(); ++b) {
    line.to(c.px(buckets[b].x), c.py_clipped(largest[b]));
  }
  if (buckets.size() == 1) { line.to(c.px(c.x.high), c.py_clipped(largest[0])); }
  out += path("outline", line.take());
  std::string triangles;
  for (std::size_t b = 0; b < buckets.size(); ++b) {
    if (largest[b] <= c.y.high) { continue; }
    triangles += 'M' + coordinate(c.px(buckets[b].x)) + ' ' + coordinate(c.top - 9) + "l5 9h-10z";
  }
  out += path("beyond", triangles);
  statistics const& ms = f.stages[total].ms;
  std::pair<char const*, double> const levels[] = {{"p50", ms.p50}, {"p99", ms.p99}};
  double label_below = std::numeric_limits<double>::max();
  for (auto const& [name, value] : levels) {
    if (value > c.y.high) { continue; }
    double const y = c.py(value);
    double const label = std::min(y + 4, label_below - 29);
    out += path("level", 'M' + coordinate(c.left) + ' ' + coordinate(y) + 'H' +
                             coordinate(c.width - c.right));
    out += chart::text(c.width - c.right + 6, label - 4, "tick strong", name);
    out += chart::text(c.width - c.right + 6, label + 9, "tick", significant(value) + " ms");
    label_below = label;
  }
  return out + chart::close() + "</section>\n";
}

// ----------------------------------------------------------------------------------------- counts

std::string counts_section(run_report const& r) {
  std::string const title = "Keypoints and inliers per frame";
  if (r.records.empty()) {
    return section_open(title, "") + nothing("No frame was processed.") + "</section>\n";
  }
  struct series {
    char const* name;
    char const* style;
    char const* band;
    int frame_record::*field;
  };
  static constexpr series all[] = {
      {"keypoints", "c0", "c0 band", &frame_record::keypoints},
      {"stereo matches", "c1", "c1 band", &frame_record::stereo_matches},
      {"local map points", "c2", "c2 band", &frame_record::local_points},
      {"inliers", "c3", "c3 band", &frame_record::inliers},
  };
  std::vector<bucket> const buckets = buckets_of(r.records, most_points);
  bool const merged = buckets.size() < r.records.size();
  int largest = 1;
  bool lost = false, keyframes = false;
  for (frame_record const& record : r.records) {
    for (series const& s : all) { largest = std::max(largest, record.*s.field); }
    lost = lost || !record.tracked;
    keyframes = keyframes || record.keyframe;
  }
  chart c;
  c.height = 280;
  c.x = index_range(r.records);
  c.y = {0, largest * 1.06};

  std::string out = section_open(
      title, merged ? "Lines are means of " +
                          std::to_string(buckets.front().end - buckets.front().begin) +
                          " frames a point, bands reach from their least to their most."
                    : "Left image; inliers are the map points that the final pose agrees with.");
  out += "<div class=\"legend\">\n";
  for (series const& s : all) { out += legend_entry(s.style, mark::line, s.name); }
  if (lost) { out += legend_entry("lost", mark::area, "lost"); }
  if (keyframes) { out += legend_entry("key-tick", mark::tick, "keyframe"); }
  out += "</div>\n" + c.open(title) + c.axes("frame", "count", true, true);

  double const floor_y = c.top + c.inner_height();
  std::string lost_data, key_data;
  for (std::size_t i = 0; i < r.records.size(); ++i) {
    double const x = r.records[i].index;
    if (r.records[i].keyframe) {
      key_data += 'M' + coordinate(c.px(x)) + ' ' + coordinate(floor_y) + "v-7";
    }
    if (r.records[i].tracked) { continue; }
    std::size_t last = i;
    while (last + 1 < r.records.size() && !r.records[last + 1].tracked) {
      ++last;
      if (r.records[last].keyframe) {
        key_data +=
            'M' + coordinate(c.px(r.records[last].index)) + ' ' + coordinate(floor_y) + "v-7";
      }
    }
    double const from = std::max(c.px(x - 0.5), c.left);
    double const to = std::min(c.px(r.records[last].index + 0.5), c.width - c.right);
    lost_data += 'M' + coordinate(from) + ' ' + coordinate(c.top) + 'H' +
                 coordinate(std::max(to, from + 1)) + 'V' + coordinate(floor_y) + 'H' +
                 coordinate(from) + 'Z';
    i = last;
  }
  out += path("lost", lost_data);
  for (series const& s : all) {
    pen line;
    std::string upper, lower;
    for (bucket const& b : buckets) {
      double sum = 0;
      int low = std::numeric_limits<int>::max(), high = 0;
      for (std::size_t i = b.begin; i < b.end; ++i) {
        int const v = r.records[i].*s.field;
        sum += v;
        low = std::min(low, v);
        high = std::max(high, v);
      }
      double const x = c.px(b.x);
      line.to(x, c.py_clipped(sum / static_cast<double>(b.end - b.begin)));
      if (merged) {
        upper += (upper.empty() ? 'M' : 'L') + coordinate(x) + ' ' + coordinate(c.py_clipped(high));
        lower = 'L' + coordinate(x) + ' ' + coordinate(c.py_clipped(low)) + lower;
      }
    }
    if (merged) { out += path(s.band, upper + lower + 'Z'); }
    if (buckets.size() == 1) {  // one point has no line
      double const v = r.records.front().*s.field;
      line.to(c.px(buckets[0].x) + 10, c.py_clipped(v));
    }
    out += path(s.style, line.take());
  }
  out += path("key-tick", key_data);
  return out + chart::close() + "</section>\n";
}

// ---------------------------------------------------------------------------------------- samples

constexpr int depth_colours = 24;

/// Near is red, far is blue: the polynomial approximation of the "turbo" map (A. Mikhailov,
/// Google), run backwards and without its dark ends. @param t 0 (near) to 1 (far)
std::string depth_colour(double t) {
  double const x = 0.92 - 0.84 * std::clamp(t, 0.0, 1.0);
  auto const poly = [x](std::array<double, 6> const& k) {
    double v = 0;
    for (std::size_t i = k.size(); i-- > 0;) { v = v * x + k[i]; }
    return static_cast<int>(std::lround(255 * std::clamp(v, 0.0, 1.0)));
  };
  int const red =
      poly({0.13572138, 4.61539260, -42.66032258, 132.13108234, -152.94239396, 59.28637943});
  int const green =
      poly({0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604});
  int const blue =
      poly({0.10667330, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973});
  return "rgb(" + std::to_string(red) + ',' + std::to_string(green) + ',' + std::to_string(blue) +
         ')';
}

/// Logarithmic, because stereo depth is proportional to one over disparity.
struct depth_scale {
  double near = 1, far = 10;
  double at(double depth) const { return std::log(depth / near) / std::log(far / near); }
  int bin(double depth) const {
    return std::clamp(static_cast<int>(std::clamp(at(depth), 0.0, 1.0) * depth_colours), 0,
                      depth_colours - 1);
  }
};

bool has_depth(sample_frame::keypoint const& k) { return std::isfinite(k.depth) && k.depth > 0; }

bool usable(sample_frame const& s) {
  return s.picture.width > 0 && s.picture.height > 0 &&
         s.picture.pixels.size() ==
             static_cast<std::size_t>(s.picture.width) * static_cast<std::size_t>(s.picture.height);
}

/// One scale for all samples, from the 2nd to the 98th percentile of their depths.
depth_scale scale_of(std::vector<sample_frame> const& samples) {
  std::vector<double> depths;
  for (sample_frame const& s : samples) {
    for (auto const& k : s.keypoints) {
      if (has_depth(k)) { depths.push_back(static_cast<double>(k.depth)); }
    }
  }
  depth_scale scale;
  if (depths.empty()) { return scale; }
  std::sort(depths.begin(), depths.end());
  scale.near = detail::percentile(depths, 2);
  scale.far = std::max(detail::percentile(depths, 98), scale.near * 1.5);
  return scale;
}

image halved(image const& in) {
  image out;
  out.width = in.width / 2;
  out.height = in.height / 2;
  out.pixels.resize(static_cast<std::size_t>(out.width) * static_cast<std::size_t>(out.height));
  for (int y = 0; y < out.height; ++y) {
    std::uint8_t const* a = in.row(2 * y);
    std::uint8_t const* b = in.row(2 * y + 1);
    for (int x = 0; x < out.width; ++x) {
      int const sum = a[2 * x] + a[2 * x + 1] + b[2 * x] + b[2 * x + 1];
      out.row(y)[x] = static_cast<std::uint8_t>((sum + 2) / 4);
    }
  }
  return out;
}

/// A JPEG of at most `budget` bytes where a quality above poor allows it.
std::vector<std::uint8_t> jpeg_within(image const& picture, std::size_t budget) {
  constexpr int widest = 1600;
  image small;
  image const* source = &picture;
  while (source->width > widest && source->height > 1) {
    small = halved(*source);
    source = &small;
  }
  std::vector<std::uint8_t> bytes;
  for (int const quality : {82, 70, 55, 40, 25}) {
    bytes = encode_jpeg(*source, quality);
    if (bytes.size() <= budget) { break; }
  }
  return bytes;
}

std::string depth_bar(depth_scale const& scale) {
  constexpr double width = 240, cell = width / depth_colours;
  std::string out =
      "<svg class=\"depth-bar\" viewBox=\"0 0 240 28\" role=\"img\" "
      "aria-label=\"depth scale\">";
  for (int i = 0; i < depth_colours; ++i) {
    out += "<rect" + attribute("x", i * cell) + " width=\"10.5\" height=\"10\" fill=\"" +
           depth_colour((i + 0.5) / depth_colours) + "\"/>";
  }
  std::array<char const*, 3> const anchors = {"tick", "tick mid", "tick end"};
  for (std::size_t i = 0; i < anchors.size(); ++i) {
    double const t = 0.5 * static_cast<double>(i);
    double const depth = scale.near * std::pow(scale.far / scale.near, t);
    std::string const unit = i == 2 ? " m" : "";
    out += chart::text(width * t, 24, anchors[i], fixed(depth, depth < 10 ? 1 : 0) + unit);
  }
  return out + "</svg>";
}

/// @param zoom size of marks: 1 for a picture as wide as the page
std::string sample_figure(sample_frame const& s, depth_scale const& scale, double zoom,
                          std::size_t budget) {
  double const width = s.picture.width, height = s.picture.height;
  // marks keep about the same size on paper, whatever the picture's
  double const unit = zoom * std::clamp(width / 1000, 0.2, 4.0);
  float least_size = std::numeric_limits<float>::max();
  for (auto const& k : s.keypoints) {
    if (std::isfinite(k.size) && k.size > 0) { least_size = std::min(least_size, k.size); }
  }
  auto const radius = [&](sample_frame::keypoint const& k) {
    double const growth = std::isfinite(k.size) && k.size > 0
                              ? static_cast<double>(k.size / least_size)
                              : std::pow(1.2, std::clamp(k.octave, 0, 12));
    return unit * std::min(2.4 * growth, 16.0);
  };

  std::string unmatched, no_stereo;
  std::array<std::string, depth_colours> stereo, tracked;
  pen tracks;
  int total = 0, with_depth = 0, inliers = 0;
  for (auto const& k : s.keypoints) {
    if (!std::isfinite(k.x) || !std::isfinite(k.y)) { continue; }
    double const x = static_cast<double>(k.x), y = static_cast<double>(k.y);
    std::string const circle =
        "<circle" + attribute("cx", x) + attribute("cy", y) + attribute("r", radius(k)) + "/>";
    ++total;
    if (k.matched) { ++inliers; }
    if (has_depth(k)) {
      ++with_depth;
      auto const bin = static_cast<std::size_t>(scale.bin(static_cast<double>(k.depth)));
      (k.matched ? tracked : stereo)[bin] += circle;
    } else {
      (k.matched ? no_stereo : unmatched) += circle;
    }
    if (k.from_x >= 0 && k.from_y >= 0 && std::isfinite(k.from_x) && std::isfinite(k.from_y)) {
      tracks.cut();
      tracks.to(static_cast<double>(k.from_x), static_cast<double>(k.from_y));
      tracks.to(x, y);
    }
  }

  std::string out = "<figure>\n<svg class=\"sample\" viewBox=\"0 0 " + coordinate(width) + ' ' +
                    coordinate(height) + "\" role=\"img\" aria-label=\"frame " +
                    std::to_string(s.index) + "\">\n<image width=\"" + coordinate(width) +
                    "\" height=\"" + coordinate(height) + "\" preserveAspectRatio=\"none\" " +
                    "href=\"data:image/jpeg;base64," + base64(jpeg_within(s.picture, budget)) +
                    "\"/>\n<rect class=\"shade\" width=\"" + coordinate(width) + "\" height=\"" +
                    coordinate(height) + "\"/>\n";
  auto const group = [&](std::string const& circles, std::string const& colour, double stroke,
                         double opacity) {
    if (circles.empty()) { return; }
    out += "<g fill=\"none\" stroke=\"" + colour + "\" stroke-width=\"" + fixed(stroke * unit, 2) +
           "\" stroke-opacity=\"" + fixed(opacity, 2) + "\">" + circles + "</g>\n";
  };
  group(unmatched, "#b9c0ca", 1.0, 0.75);
  for (std::size_t i = 0; i < stereo.size(); ++i) {
    group(stereo[i], depth_colour((static_cast<double>(i) + 0.5) / depth_colours), 0.9, 0.8);
  }
  if (std::string const data = tracks.take(); !data.empty()) {
    out +=
        "<path fill=\"none\" stroke=\"#ff5cf0\" stroke-opacity=\"0.9\" stroke-linecap=\"round\" "
        "stroke-width=\"" +
        fixed(1.3 * unit, 2) + "\" d=\"" + data + "\"/>\n";
  }
  group(no_stereo, "#ffffff", 2.0, 1.0);
  for (std::size_t i = 0; i < tracked.size(); ++i) {
    group(tracked[i], depth_colour((static_cast<double>(i) + 0.5) / depth_colours), 2.0, 1.0);
  }
  out += "</svg>\n<figcaption><b>Frame " + std::to_string(s.index) + "</b> " + grouped(total) +
         " keypoints, " + grouped(with_depth) + " with stereo depth, " + grouped(inliers) +
         " inliers</figcaption>\n</figure>\n";
  return out;
}

std::string sample_section(run_report const& r) {
  std::vector<sample_frame const*> frames;
  for (sample_frame const& s : r.samples) {
    if (usable(s)) { frames.push_back(&s); }
  }
  if (frames.empty()) { return {}; }
  depth_scale const scale = scale_of(r.samples);
  std::string out =
      section_open("Keypoints and tracks",
                   "Left image. A ring's size is its pyramid level's, its colour the "
                   "stereo depth; a line leads from where the same map point was seen "
                   "in the frame before.");
  // the rings are drawn on dark: their colours are made for the pictures, not for the page
  out += "<div class=\"legend\">\n<span class=\"key\">depth " + depth_bar(scale) + "</span>\n";
  auto const ring = [&](char const* colour, char const* stroke, char const* words) {
    out += std::string(
               "<span class=\"key\"><svg class=\"swatch\" viewBox=\"0 0 22 12\"><rect "
               "width=\"22\" height=\"12\" rx=\"2\" fill=\"#3a3f47\"/><circle cx=\"11\" "
               "cy=\"6\" r=\"4\" fill=\"none\" stroke=\"") +
           colour + "\" stroke-width=\"" + stroke + "\"/></svg>" + words + "</span>\n";
  };
  std::string const example = depth_colour(0.45);
  ring(example.c_str(), "2", "inlier map point");
  ring(example.c_str(), "0.8", "stereo match only");
  ring("#ffffff", "2", "inlier without stereo");
  ring("#b9c0ca", "1", "unmatched");
  out +=
      "<span class=\"key\"><svg class=\"swatch\" viewBox=\"0 0 22 12\"><rect width=\"22\" "
      "height=\"12\" rx=\"2\" fill=\"#3a3f47\"/><path d=\"M3 9L19 3\" stroke=\"#ff5cf0\" "
      "stroke-width=\"1.6\"/></svg>track</span>\n</div>\n";
  constexpr std::size_t picture_bytes = 2'600'000;
  bool const narrow = std::all_of(frames.begin(), frames.end(), [](sample_frame const* s) {
    return s->picture.width < 2 * s->picture.height;
  });
  bool const pairs = narrow && frames.size() > 1;
  out += pairs ? "<div class=\"samples pairs\">\n" : "<div class=\"samples\">\n";
  for (sample_frame const* s : frames) {
    out += sample_figure(*s, scale, pairs ? 1.6 : 1.0, picture_bytes / frames.size());
  }
  return out + "</div></section>\n";
}

// ---------------------------------------------------------------------------------------- options

std::string table_row(std::string const& name, std::string const& value) {
  return "<tr><th>" + escape(name) + "</th><td>" + escape(value.empty() ? "n/a" : value) +
         "</td></tr>\n";
}

std::string options_section(run_report const& r) {
  std::string out = section_open("Run", "");
  out += "<div class=\"columns\">\n<div><h3>Environment</h3><table class=\"plain\"><tbody>\n";
  out += table_row("sequence", r.sequence);
  out += table_row("backend", r.backend);
  out += table_row("device", r.device);
  out += table_row("image size", r.image_width > 0 && r.image_height > 0
                                     ? std::to_string(r.image_width) + " \xc3\x97 " +
                                           std::to_string(r.image_height)
                                     : "n/a");
  out += table_row("frames", grouped(r.frames));
  out += table_row("lost", grouped(r.lost));
  out += table_row("dropped", grouped(r.dropped));
  out += "</tbody></table></div>\n<div><h3>Options</h3>";
  if (r.options.empty()) {
    out += nothing("No options were recorded.");
  } else {
    out += "<table class=\"plain\"><tbody>\n";
    for (auto const& [name, value] : r.options) { out += table_row(name, value); }
    out += "</tbody></table>";
  }
  return out + "</div>\n</div></section>\n";
}

// ------------------------------------------------------------------------------------------ style

char const* const style_sheet = R"css(
:root { color-scheme: light dark;
  --page: #f4f6f9; --panel: #ffffff; --ink: #18202c; --soft: #5b6676; --line: #dfe4eb;
  --grid: #e7ebf1;
  --accent: #2b62d9; --wash: rgba(43, 98, 217, .12); --truth: #b9c0cb; --good: #1f8f52;
  --fair: #c98a10;
  --bad: #cc3b30; --level: #39424f;
  --s0: #4269d0; --s1: #efb118; --s2: #ff725c; --s3: #6cc5b0; --s4: #3ca951; --s5: #ff8ab7;
  --s6: #a463f2;
  --s7: #97bbf5; --s8: #9c6b4e; --s9: #9498a0; }
@media screen and (prefers-color-scheme: dark) { :root {
  --page: #0f131a; --panel: #181e27; --ink: #e6eaf1; --soft: #97a3b4; --line: #2a3240;
  --grid: #262e3a;
  --accent: #77a3ff; --wash: rgba(119, 163, 255, .16); --truth: #566070; --good: #4cc583;
  --fair: #e5b04a;
  --bad: #f0766b; --level: #c5cedb; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--ink);
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif;
  -webkit-print-color-adjust: exact; print-color-adjust: exact; }
main { max-width: 1120px; margin: 0 auto; padding: 32px 20px 48px; }
header { margin-bottom: 22px; }
h1 { font-size: 26px; line-height: 1.25; margin: 0 0 6px; letter-spacing: -.01em;
  overflow-wrap: anywhere; }
h2 { font-size: 17px; margin: 0 0 2px; }
h3 { font-size: 12px; margin: 0 0 6px; color: var(--soft); text-transform: uppercase;
  letter-spacing: .06em; }
.lead { margin: 0; color: var(--soft); display: flex; flex-wrap: wrap; gap: 4px 8px; }
.lead span { background: var(--panel); border: 1px solid var(--line); border-radius: 999px;
  padding: 1px 11px; font-size: 13px; overflow-wrap: anywhere; }
.cards { display: grid; grid-template-columns: repeat(4, 1fr); gap: 12px; margin-bottom: 16px; }
.card, section { background: var(--panel); border: 1px solid var(--line); border-radius: 10px; }
.card { padding: 13px 16px 12px; }
.card .name { font-size: 12px; color: var(--soft); text-transform: uppercase;
  letter-spacing: .05em; }
.card .value { font-size: 27px; font-weight: 650; line-height: 1.3;
  font-variant-numeric: tabular-nums;
  white-space: nowrap; }
.card .unit { font-size: 14px; font-weight: 400; color: var(--soft); }
.card .note { font-size: 12.5px; color: var(--soft); line-height: 1.4; }
.card.good .value { color: var(--good); } .card.fair .value { color: var(--fair); }
.card.bad .value { color: var(--bad); }
section { padding: 18px 20px 16px; margin-bottom: 16px; }
.caption { margin: 0 0 10px; color: var(--soft); font-size: 13px; max-width: 125ch; }
.nothing { margin: 6px 0 4px; color: var(--soft); font-style: italic; }
.scroll { overflow-x: auto; }
.legend { display: flex; flex-wrap: wrap; gap: 4px 18px; margin: 0 0 8px; font-size: 13px; }
.key { display: inline-flex; align-items: center; gap: 7px; }
.swatch { width: 22px; height: 12px; flex: none; }
svg.chart { display: block; width: 100%; min-width: 620px; height: auto; }
svg text { font-family: inherit; }
.tick { font-size: 12px; fill: var(--soft); font-variant-numeric: tabular-nums; }
.strong { font-weight: 650; fill: var(--ink); }
.axis { font-size: 12.5px; fill: var(--soft); }
.mid { text-anchor: middle; } .end { text-anchor: end; }
.grid { stroke: var(--grid); fill: none; }
.estimate { stroke: var(--accent); stroke-width: 2; fill: none; stroke-linejoin: round; }
.truth { stroke: var(--truth); stroke-width: 5; fill: none; stroke-linejoin: round; }
.wash { fill: var(--wash); }
.level { stroke: var(--level); stroke-width: 1.2; stroke-dasharray: 5 4; fill: none; }
.outline { stroke: var(--ink); stroke-width: .9; fill: none; stroke-linejoin: round; }
.beyond { fill: var(--bad); }
circle.start { fill: var(--good); stroke: var(--panel); stroke-width: 1.5; }
circle.end { fill: var(--bad); stroke: var(--panel); stroke-width: 1.5; }
.s0 { fill: var(--s0); } .s1 { fill: var(--s1); } .s2 { fill: var(--s2); } .s3 { fill: var(--s3); }
.s4 { fill: var(--s4); } .s5 { fill: var(--s5); } .s6 { fill: var(--s6); } .s7 { fill: var(--s7); }
.s8 { fill: var(--s8); } .s9 { fill: var(--s9); } .sum { fill: var(--ink); }
  .track { fill: var(--grid); }
.c0, .c1, .c2, .c3 { fill: none; stroke-width: 1.6; stroke-linejoin: round; }
.c0 { stroke: var(--s9); } .c1 { stroke: var(--s1); } .c2 { stroke: var(--s6); }
.c3 { stroke: var(--accent); stroke-width: 2; }
.band { stroke: none; opacity: .16; }
.c0.band { fill: var(--s9); } .c1.band { fill: var(--s1); } .c2.band { fill: var(--s6); }
.c3.band { fill: var(--accent); }
.lost { fill: var(--bad); opacity: .22; }
.key-tick { stroke: var(--ink); stroke-width: 1; fill: none; opacity: .7; }
table { border-collapse: collapse; width: 100%; font-size: 14px; }
.figures th { color: var(--soft); font-weight: 500; font-size: 12.5px; }
.figures th, .figures td { text-align: left; padding: 6px 10px;
  border-bottom: 1px solid var(--line);
  white-space: nowrap; }
.figures th:first-child, .figures td:first-child { padding-left: 0; }
.figures .number { text-align: right; font-variant-numeric: tabular-nums; }
.figures .share { padding-left: 28px; width: 235px; }
.figures .share span { display: inline-block; width: 58px; text-align: right;
  font-variant-numeric: tabular-nums; color: var(--soft); }
.figures .total td { font-weight: 650; border-bottom: 0; border-top: 2px solid var(--line); }
.chip { width: 10px; height: 10px; margin-right: 9px; }
.bar { width: 120px; height: 10px; }
.samples { display: grid; gap: 16px; margin-top: 18px; }
  .samples.pairs { grid-template-columns: 1fr 1fr; }
figure { margin: 0; }
svg.sample { display: block; width: 100%; height: auto; border-radius: 6px; background: #22262d; }
.shade { fill: #10141a; opacity: .28; }
figcaption { font-size: 13px; color: var(--soft); margin-top: 5px; }
figcaption b { color: var(--ink); margin-right: 6px; }
.depth-bar { width: 240px; height: 28px; margin-bottom: -8px; overflow: visible; }
.columns { display: grid; grid-template-columns: 1fr 1fr; gap: 8px 36px; margin-top: 8px; }
.plain th, .plain td { text-align: left; vertical-align: top; padding: 4px 12px 4px 0;
  font-size: 13.5px;
  border-bottom: 1px solid var(--line); overflow-wrap: anywhere; }
.plain th { font-weight: 400; color: var(--soft); width: 38%; }
.plain td { font-family: ui-monospace, SFMono-Regular, Menlo, Consolas, monospace;
  font-size: 12.5px; }
footer { color: var(--soft); font-size: 12.5px; }
@media screen and (max-width: 760px) { .cards, .columns { grid-template-columns: 1fr 1fr; }
  .columns, .samples.pairs { grid-template-columns: 1fr; } main { padding: 18px 10px; } }
@media print { body { background: none; font-size: 12px; } main { max-width: none; padding: 0; }
  .cards { gap: 6px; } .card { padding: 8px 10px; } .card .value { font-size: 19px; }
  .card .name, .card .note { font-size: 10px; } section { padding: 10px 12px; margin-bottom: 8px; }
  .figures th, .figures td { padding: 3px 6px; font-size: 12px; }
  .card, section, figure { break-inside: avoid; }
  svg.chart { min-width: 0; } .scroll { overflow: visible; } }
)css";

}  // namespace

void write_html(std::string const& path, run_report const& report) {
  run_figures const f = detail::figures_of(report);
  std::string const title = report.title.empty() ? "Tracking report" : report.title;
  std::string out =
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n";
  out += "<title>" + escape(title) + "</title>\n<style>" + style_sheet + "</style>\n</head>\n";
  out += "<body>\n<main>\n<header>\n<h1>" + escape(title) + "</h1>\n<p class=\"lead\">";
  std::string const size =
      report.image_width > 0 && report.image_height > 0
          ? std::to_string(report.image_width) + " \xc3\x97 " + std::to_string(report.image_height)
          : "";
  for (std::string const& fact : {report.sequence, report.backend, report.device, size}) {
    if (!fact.empty()) { out += "<span>" + escape(fact) + "</span>"; }
  }
  out += "</p>\n</header>\n";
  out += cards(report, f);
  out += trajectory_section(report, f);
  out += error_section(report, f);
  out += time_section(report, f);
  out += stage_table(f);
  out += counts_section(report);
  out += sample_section(report);
  out += options_section(report);
  out +=
      "<footer>Written by FastTrack. Self-contained: no script, nothing loaded from "
      "elsewhere.</footer>"
      "\n</main>\n</body>\n</html>\n";
  detail::write_text(path, out);
}

}  // namespace seq
