// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

#include "examples/sequence/report_markup.hpp"
#include "examples/sequence/report_sections.hpp"

namespace seq::detail {
namespace {

std::string stage_style(std::size_t s) { return "s" + std::to_string(s); }

/// Upper end of the time axis: the maximum, unless a few outliers would flatten the rest.
double time_limit(std::vector<double> const& sorted) {
  double const largest = sorted.back(), median = percentile(sorted, 50);
  if (largest <= 3 * median) { return largest * 1.08; }
  double const tail = percentile(sorted, 95);
  double const limit = std::max(tail * 1.4, median * 2.5);
  return std::min(largest * 1.08, std::min(limit, median * 8));
}

}  // namespace

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
    stage_figures const& stage = f.stages[s];
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
  std::vector<bucket> const buckets = buckets_of(r.records, most_points / 2);

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
  if (total == 0) {
    caption = merged ? "The slowest frame of " +
                           std::to_string(buckets.front().end - buckets.front().begin) + " a point."
              : r.prefetch > 0 ? "Calls of the frame, without its keypoints and stereo, which were "
                                 "computed beside the frames before."
                               : "The whole frame.";
    caption += " Stages are measured with --timing.";
  }
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
    out += path(stage_style(s), data + 'Z');
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

}  // namespace seq::detail
