// SPDX-License-Identifier: Apache-2.0
// Times in names of images and in files beside them.
#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "examples/sequence/detail/stamps.hpp"
#include "examples/sequence/detail/text.hpp"

namespace seq::detail {
namespace {

constexpr char const* accepted_times =
    "accepted is a line for each image: seconds, one with a decimal point, or whole seconds, "
    "milli-, "
    "micro- or nanoseconds, or dates such as 2011-09-26 13:02:25.964";

/// Whole numbers, as nanoseconds: seconds to nanoseconds since 1970 by their size, others by their
/// step.
std::vector<std::int64_t> whole_times(std::vector<std::int64_t> const& values,
                                      std::string const& path, std::string& unit,
                                      std::vector<std::string>& warnings) {
  auto const [low, high] = std::minmax_element(values.begin(), values.end());
  std::int64_t const step = median_step(values);
  struct unit_of {
    char const* name;
    std::int64_t ns;
  };
  for (unit_of const& u : {unit_of{"seconds", 1'000'000'000}, unit_of{"milliseconds", 1'000'000},
                           unit_of{"microseconds", 1'000}, unit_of{"nanoseconds", 1}}) {
    std::int64_t const second = 1'000'000'000 / u.ns;
    bool const since_1970 = *low >= 1'000'000'000 * second && *high / 4 < 1'000'000'000 * second;
    if (!since_1970 || step > 10 * second) { continue; }
    unit = u.name;
    std::vector<std::int64_t> times;
    for (std::int64_t const value : values) { times.push_back(value * u.ns); }
    return times;
  }
  stamp_column column(path, finest_frame_step_ns);
  for (std::size_t i = 0; i < values.size(); ++i) {
    column.add(std::to_string(values[i]), static_cast<int>(i) + 1);
  }
  unit = "whole numbers";
  return column.times_ns(warnings);
}

}  // namespace

std::vector<std::int64_t> times_of_texts(std::vector<std::pair<int, std::string>> const& texts,
                                         std::string const& path, std::string& unit,
                                         std::vector<std::string>& warnings) {
  std::vector<stamp_text> stamps;
  for (auto const& [line, text] : texts) { stamps.push_back(read_stamp(text, path, line)); }
  bool const seconds = whole_seconds(stamps, path);
  std::vector<std::int64_t> values;
  for (stamp_text const& s : stamps) { values.push_back(s.value); }
  unit = "seconds";
  return seconds ? values : whole_times(values, path, unit, warnings);
}

std::vector<std::int64_t> times_of_lines(std::vector<std::pair<int, std::string>> const& lines,
                                         std::string const& path, std::string& unit,
                                         std::vector<std::string>& warnings) {
  try {
    if (is_date(lines.front().second)) {
      std::vector<std::int64_t> dates;
      for (auto const& [line, text] : lines) { dates.push_back(date_to_ns(text, path, line)); }
      unit = "dates";
      return dates;
    }
    return times_of_texts(lines, path, unit, warnings);
  } catch (error const& e) { throw error(std::string(e.what()) + "; " + accepted_times); }
}

}  // namespace seq::detail
