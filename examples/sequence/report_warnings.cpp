// SPDX-License-Identifier: Apache-2.0
// Warnings of frames: one strip for each name, on the frames' axis.
#include <algorithm>
#include <cstddef>
#include <string>
#include <vector>

#include "examples/sequence/report_figures.hpp"
#include "examples/sequence/report_markup.hpp"
#include "examples/sequence/report_sections.hpp"

namespace seq::detail {
namespace {

constexpr double strip_height = 30, bar_top = 18, bar_height = 8;

struct strip {
  std::string name;
  int first = 0;   ///< index of the first frame that has it
  int frames = 0;  ///< that have it
};

bool has(frame_record const& r, std::string const& name) {
  auto const names = warning_names(r);
  return std::find(names.begin(), names.end(), name) != names.end();
}

/// In the order of their first frames.
std::vector<strip> strips_of(std::vector<frame_record> const& records) {
  std::vector<strip> all;
  for (frame_record const& r : records) {
    for (std::string const& name : warning_names(r)) {
      auto at =
          std::find_if(all.begin(), all.end(), [&](strip const& s) { return s.name == name; });
      if (at == all.end()) { at = all.insert(all.end(), {name, r.index, 0}); }
      ++at->frames;
    }
  }
  return all;
}

}  // namespace

std::vector<std::string> warning_names(frame_record const& r) {
  std::vector<std::string> names;
  for (auto const& [name, said] : r.warnings) { names.push_back(name); }
  if (!r.imu_warnings.empty()) { names.emplace_back("imu"); }
  return names;
}

std::string map_borders(chart const& c, std::vector<frame_record> const& records) {
  std::string data;
  double last = c.left - 1;
  for (frame_record const& r : records) {
    double const x = std::max(c.px(r.index - 0.5), c.left);
    if (!r.map_begun || x < last + 1) { continue; }
    data +=
        'M' + coordinate(x) + ' ' + coordinate(c.top) + 'V' + coordinate(c.top + c.inner_height());
    last = x;
  }
  return path("level", data);
}

std::string warning_strips(run_report const& r) {
  std::vector<strip> const strips = strips_of(r.records);
  if (strips.empty()) { return {}; }
  chart c;
  c.top = 6;
  c.height = c.top + c.bottom + strip_height * static_cast<double>(strips.size());
  c.x = index_range(r.records);
  std::string out = "<h3>Warnings</h3>\n" + c.open("Warnings per frame") + c.x_axis("frame", true);
  double top = c.top;
  for (strip const& s : strips) {
    out += chart::text(c.left + 5, top + bar_top - 4, "tick",
                       s.name + ": " + grouped(s.frames) + " of " +
                           grouped(static_cast<long long>(r.records.size())) +
                           " frames, first in frame " + std::to_string(s.first));
    out += "<rect class=\"track\"" + attribute("x", c.left) + attribute("y", top + bar_top) +
           attribute("width", c.inner_width()) + attribute("height", bar_height) + "/>\n";
    out += path("warned", spans(c, r.records, top + bar_top, top + bar_top + bar_height,
                                [&](frame_record const& f) { return has(f, s.name); }));
    top += strip_height;
  }
  return out + map_borders(c, r.records) + chart::close();
}

}  // namespace seq::detail
