// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "examples/sequence/report_markup.hpp"
#include "examples/sequence/report_paths.hpp"
#include "examples/sequence/report_sections.hpp"

// The drawing is an SVG in one projection, which needs no script. The script has the same points as
// integers, and projects them anew where the drawing is dragged.

namespace seq::detail {
namespace {

constexpr std::size_t most_cloud = 6000;
constexpr std::size_t most_path = 600;  ///< points of a path
constexpr double view_width = 1000, view_height = 560, unit = 250;
constexpr double first_yaw = 0.6, first_pitch = 0.7;  ///< radians

/// Right, forward, up: thousandths of half the drawn extent.
using place = std::array<int, 3>;
using strokes = std::vector<std::vector<place>>;

/// Axes of the world and the box that is drawn.
class space {
public:
  /// @param y_down the world is like a camera's: x right, y down, z forward; else z is up
  space(bool y_down, positions const& path, std::vector<Eigen::Vector3d> const& cloud)
      : y_down_(y_down) {
    constexpr double huge = std::numeric_limits<double>::max();
    Eigen::Vector3d low = Eigen::Vector3d::Constant(huge), high = -low;
    for (auto const& p : path) {
      low = low.cwiseMin(turned(p.second));
      high = high.cwiseMax(turned(p.second));
    }
    // a few wrong points far away leave the rest in view
    for (int axis = 0; axis < 3 && !cloud.empty(); ++axis) {
      std::vector<double> values;
      for (auto const& p : cloud) { values.push_back(turned(p)[axis]); }
      std::sort(values.begin(), values.end());
      low[axis] = std::min(low[axis], percentile(values, 3));
      high[axis] = std::max(high[axis], percentile(values, 97));
    }
    centre_ = low / 2 + high / 2;
    half_ = std::max((high / 2 - low / 2).maxCoeff(), 1e-3);
  }
  place of(Eigen::Vector3d const& p) const {
    Eigen::Vector3d const at = (turned(p) - centre_) / half_ * 1000;
    place out;
    for (int axis = 0; axis < 3; ++axis) {
      double const value = std::isfinite(at[axis]) ? std::clamp(at[axis], -9999.0, 9999.0) : 0.0;
      out[static_cast<std::size_t>(axis)] = static_cast<int>(std::lround(value));
    }
    return out;
  }
  bool contains(place const& p) const {
    return std::all_of(p.begin(), p.end(), [](int v) { return std::abs(v) <= 1100; });
  }
  /// Metres that 1000 units are.
  double half() const { return half_; }

private:
  Eigen::Vector3d turned(Eigen::Vector3d const& p) const {
    return y_down_ ? Eigen::Vector3d(p.x(), p.z(), -p.y()) : p;
  }

  bool y_down_;
  Eigen::Vector3d centre_;
  double half_ = 1;
};

/// A camera's world has its path in x and z; one with z up has it in x and y.
bool is_y_down(positions const& path, bool truth) {
  if (!truth) { return true; }
  Eigen::Vector3d low = path.front().second, high = low;
  for (auto const& p : path) {
    low = low.cwiseMin(p.second);
    high = high.cwiseMax(p.second);
  }
  Eigen::Vector3d const extent = high - low;
  return extent.y() < extent.z() && extent.y() < extent.x();
}

strokes strokes_of(positions const& points, space const& s) {
  strokes out;
  std::int64_t const gap = bridged_gap(points);
  std::size_t const step = points.size() / most_path + 1;
  std::vector<place> line;
  for (std::size_t i = 0; i < points.size(); ++i) {
    bool const lost_before = i > 0 && points[i].first - points[i - 1].first > gap;
    bool const lost_after = i + 1 == points.size() || points[i + 1].first - points[i].first > gap;
    if (lost_before && !line.empty()) { out.push_back(std::exchange(line, {})); }
    if (i % step == 0 || lost_before || lost_after) { line.push_back(s.of(points[i].second)); }
  }
  if (!line.empty()) { out.push_back(std::move(line)); }
  return out;
}

/// A pixel of the first projection, as text.
std::string pixel(place const& p) {
  double const u = p[0] * std::cos(first_yaw) - p[1] * std::sin(first_yaw);
  double const v = p[0] * std::sin(first_yaw) + p[1] * std::cos(first_yaw);
  double const up = p[2] * std::cos(first_pitch) + v * std::sin(first_pitch);
  return std::to_string(std::lround(view_width / 2 + u * unit / 1000)) + ' ' +
         std::to_string(std::lround(view_height / 2 - up * unit / 1000));
}

std::string drawn(strokes const& lines) {
  std::string out;
  for (auto const& line : lines) {
    for (std::size_t i = 0; i < line.size(); ++i) { out += (i == 0 ? 'M' : 'L') + pixel(line[i]); }
  }
  return out;
}

/// [[x,y,z,x,y,z],[..]]
std::string listed(strokes const& lines) {
  std::string out = "[";
  for (auto const& line : lines) {
    out += out.size() > 1 ? ",[" : "[";
    for (std::size_t i = 0; i < line.size(); ++i) {
      for (std::size_t axis = 0; axis < 3; ++axis) {
        out += (i + axis > 0 ? "," : "") + std::to_string(line[i][axis]);
      }
    }
    out += ']';
  }
  return out + ']';
}

std::string circle(char const* style, place const& p) {
  std::string const at = pixel(p);
  std::size_t const blank = at.find(' ');
  return std::string("<circle class=\"") + style + "\" cx=\"" + at.substr(0, blank) + "\" cy=\"" +
         at.substr(blank + 1) + "\" r=\"6\"/>\n";
}

/// Turns the drawing: a drag to the side about the vertical axis, one up or down tilts it.
char const* const turning = R"js(
var svg=document.querySelector("svg.space"),yaw=first[0],pitch=first[1],held=null;
function at(p,i){
  var c=Math.cos(yaw),s=Math.sin(yaw),u=p[i]*c-p[i+1]*s,v=p[i]*s+p[i+1]*c;
  var up=p[i+2]*Math.cos(pitch)+v*Math.sin(pitch);
  return [Math.round(500+u/4),Math.round(280-up/4)];
}
function put(name,lines,dots){
  var e=svg.querySelector("path."+name),d="";
  if(!e){return;}
  lines.forEach(function(p){
    for(var i=0;i!==p.length;i+=3){d+=(dots||i===0?"M":"L")+at(p,i).join(" ")+(dots?"h0":"");}
  });
  e.setAttribute("d",d);
}
function mark(name,p){
  var e=svg.querySelector("circle."+name);
  if(!e||!p){return;}
  var q=at(p,0);
  e.setAttribute("cx",q[0]);e.setAttribute("cy",q[1]);
}
function draw(){
  put("cloud",cloud,true);put("truth",truth,false);put("estimate",estimate,false);
  mark("start",ends[0]);mark("end",ends[1]);
}
svg.addEventListener("pointerdown",function(e){held=[e.clientX,e.clientY];svg.setPointerCapture(e.pointerId);});
svg.addEventListener("pointermove",function(e){
  if(!held){return;}
  yaw+=(e.clientX-held[0])/150;
  pitch=Math.max(-1.57,Math.min(1.57,pitch+(e.clientY-held[1])/150));
  held=[e.clientX,e.clientY];draw();
});
svg.addEventListener("pointerup",function(){held=null;});
svg.addEventListener("pointercancel",function(){held=null;});
svg.addEventListener("dblclick",function(){yaw=first[0];pitch=first[1];draw();});
)js";

}  // namespace

std::string space_section(run_report const& r) {
  bool const has_truth = !r.truth.empty();
  Eigen::Isometry3d const T = has_truth ? r.error.T_truth_estimate : Eigen::Isometry3d::Identity();
  positions const estimate = finite_positions(r.estimate, T);
  positions const truth =
      finite_positions(covered(r.truth, r.records), Eigen::Isometry3d::Identity());
  if (estimate.empty()) { return {}; }
  positions both = estimate;
  both.insert(both.end(), truth.begin(), truth.end());
  std::vector<Eigen::Vector3d> cloud;
  std::size_t const step = r.cloud.size() / most_cloud + 1;
  for (std::size_t i = 0; i < r.cloud.size(); i += step) {
    Eigen::Vector3d const p = T * r.cloud[i].cast<double>();
    if (p.allFinite()) { cloud.push_back(p); }
  }
  space const s(is_y_down(truth.empty() ? estimate : truth, !truth.empty()), both, cloud);

  strokes dots(1);
  std::string drawn_dots;
  for (auto const& p : cloud) {
    place const at = s.of(p);
    if (!s.contains(at)) { continue; }
    dots[0].push_back(at);
    drawn_dots += 'M' + pixel(at) + "h0";
  }
  strokes const estimate_lines = strokes_of(estimate, s), truth_lines = strokes_of(truth, s);
  strokes const ends{{estimate_lines.front().front()}, {estimate_lines.back().back()}};

  std::string out =
      section_open("Path and map in space",
                   "Drag to turn, double-click for the first view. The points are where "
                   "map points were when they were made; the drawing is about " +
                       significant(2 * s.half()) + " m wide.");
  out += "<div class=\"legend\">\n";
  if (!truth_lines.empty()) { out += legend_entry("truth", mark::line, "ground truth"); }
  out += legend_entry("estimate", mark::line, "estimate") +
         legend_entry("start", mark::dot, "start") + legend_entry("end", mark::dot, "end");
  if (!dots[0].empty()) { out += legend_entry("cloud-key", mark::dot, "map point"); }
  out += "</div>\n<div class=\"scroll\"><svg class=\"chart space\" viewBox=\"0 0 " +
         coordinate(view_width) + ' ' + coordinate(view_height) +
         "\" role=\"img\" aria-label=\"Path and map in space\">\n";
  out += path("cloud", drawn_dots) + path("truth", drawn(truth_lines)) +
         path("estimate", drawn(estimate_lines));
  out += circle("start", ends[0][0]) + circle("end", ends[1][0]) + "</svg></div>\n";
  out += "<script>(function(){\nvar first=[" + fixed(first_yaw, 2) + ',' + fixed(first_pitch, 2) +
         "],\ncloud=" + listed(dots) + ",\ntruth=" + listed(truth_lines) +
         ",\nestimate=" + listed(estimate_lines) + ",\nends=" + listed(ends) + ";" + turning +
         "})();</script>\n";
  return out + "</section>\n";
}

}  // namespace seq::detail
