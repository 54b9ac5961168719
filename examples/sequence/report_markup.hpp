// SPDX-License-Identifier: Apache-2.0
/// @file Text, markup and charts of the HTML report. Not API: included by the report's parts only.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "examples/sequence/report.hpp"

namespace seq::detail {

/// Text as HTML: markup characters are escaped, control characters become spaces.
std::string escape(std::string const& text);

/// One decimal, the shortest text. Numbers that are not finite become 0, so that no attribute
/// contains "nan".
std::string coordinate(double value);

std::string attribute(char const* name, double value);

/// Integer with a thin space between thousands.
std::string grouped(long long value);

/// Three or four significant digits, for figures whose magnitude is not known in advance.
std::string significant(double value);

std::string base64(std::vector<std::uint8_t> const& bytes);

struct range {
  double low = 0, high = 1;
  double span() const { return high - low; }
};

/// An SVG path; nothing without data.
std::string path(std::string const& style, std::string const& data);

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
                   bool whole_y) const;
  /// Of these, what belongs to x.
  std::string x_axis(std::string const& title, bool whole) const;

  static std::string text(double at_x, double at_y, char const* style, std::string const& content) {
    return std::string("<text class=\"") + style + '"' + attribute("x", at_x) +
           attribute("y", at_y) + '>' + escape(content) + "</text>";
  }
};

/// Path data of lines. Starts a new line after cut(), and omits points closer than half a unit.
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

/// One entry of a legend: a sample of the class's colour, then the text.
std::string legend_entry(std::string const& style, mark shape, std::string const& words);

std::string section_open(std::string const& title, std::string const& caption);

/// A sentence instead of a chart.
std::string nothing(std::string const& words);

/// Consecutive records drawn as one point, so that long sequences stay small.
struct bucket {
  std::size_t begin = 0, end = 0;
  double x = 0;  ///< mean frame index
};

std::vector<bucket> buckets_of(std::vector<frame_record> const& records, std::size_t most);

constexpr std::size_t most_points = 900;

range index_range(std::vector<frame_record> const& records);

/// Path data of a bar over each run of frames that `holds` accepts, from half a frame before its
/// first one to half a frame after its last; at least one unit wide. Bars that are less than half a
/// unit apart become one.
/// @param c with index_range() as its x @param top @param floor of the bars
template <typename Condition>
std::string spans(chart const& c, std::vector<frame_record> const& records, double top,
                  double floor, Condition const& holds) {
  std::string data;
  double from = 0, to = -1;
  auto const draw = [&] {
    if (to < from) { return; }
    data += 'M' + coordinate(from) + ' ' + coordinate(top) + 'H' + coordinate(to) + 'V' +
            coordinate(floor) + 'H' + coordinate(from) + 'Z';
  };
  for (std::size_t i = 0; i < records.size(); ++i) {
    if (!holds(records[i])) { continue; }
    double const begin = std::max(c.px(records[i].index - 0.5), c.left);
    bool const goes_on = to >= from && (begin < to + 0.5 || holds(records[i - 1]));
    if (!goes_on) {
      draw();
      from = begin;
    }
    to = std::max(std::min(c.px(records[i].index + 0.5), c.width - c.right), from + 1);
  }
  draw();
  return data;
}

/// A line where each map begins, over all of a chart with index_range() as its x; one a unit at
/// most.
std::string map_borders(chart const& c, std::vector<frame_record> const& records);

}  // namespace seq::detail
