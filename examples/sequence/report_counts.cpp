// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstddef>
#include <limits>
#include <string>

#include "examples/sequence/report_markup.hpp"
#include "examples/sequence/report_sections.hpp"

namespace seq::detail {
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
  bool lost = false, keyframes = false, maps = false;
  for (frame_record const& record : r.records) {
    for (series const& s : all) { largest = std::max(largest, record.*s.field); }
    lost = lost || !record.tracked;
    keyframes = keyframes || record.keyframe;
    maps = maps || record.map_begun;
  }
  chart c;
  c.height = 280;
  c.x = index_range(r.records);
  c.y = {0, largest * 1.06};

  std::string out = section_open(
      title, merged ? "Lines are means of " +
                          std::to_string(buckets.front().end - buckets.front().begin) +
                          " frames a point, bands reach from their least to their most."
                    : std::string(r.one_camera || r.depth_images ? "" : "Left image; ") +
                          "inliers are the map points that the final pose agrees with.");
  out += "<div class=\"legend\">\n";
  for (series const& s : all) { out += legend_entry(s.style, mark::line, s.name); }
  if (lost) { out += legend_entry("lost", mark::area, "lost"); }
  if (keyframes) { out += legend_entry("key-tick", mark::tick, "keyframe"); }
  if (maps) { out += legend_entry("level", mark::tick, "a map begins"); }
  out += "</div>\n" + c.open(title) + c.axes("frame", "count", true, true);

  double const floor_y = c.top + c.inner_height();
  std::string key_data;
  for (frame_record const& record : r.records) {
    if (!record.keyframe) { continue; }
    key_data += 'M' + coordinate(c.px(record.index)) + ' ' + coordinate(floor_y) + "v-7";
  }
  out += path("lost", spans(c, r.records, c.top, floor_y,
                            [](frame_record const& record) { return !record.tracked; }));
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
  out += path("key-tick", key_data) + map_borders(c, r.records);
  return out + chart::close() + warning_strips(r) + "</section>\n";
}

}  // namespace seq::detail
