// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/detail/stamps.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "examples/sequence/detail/text.hpp"

namespace seq::detail {
namespace {

constexpr std::int64_t largest = std::numeric_limits<std::int64_t>::max();

std::string lines_text(std::size_t count) {
  return std::to_string(count) + (count == 1 ? " line" : " lines");
}

/// Indices of a longest strictly ascending subsequence; of equal numbers the first.
std::vector<std::size_t> longest_ascending(std::vector<std::int64_t> const& times) {
  std::vector<std::size_t> last;  // of the subsequence of each length that ends lowest
  std::vector<std::size_t> before(times.size());
  for (std::size_t i = 0; i < times.size(); ++i) {
    auto const found =
        std::lower_bound(last.begin(), last.end(), times[i],
                         [&](std::size_t k, std::int64_t time) { return times[k] < time; });
    before[i] = found == last.begin() ? i : *(found - 1);
    if (found == last.end()) {
      last.push_back(i);
    } else if (times[*found] != times[i]) {
      *found = i;
    }
  }
  std::vector<std::size_t> kept(last.size());
  for (std::size_t n = kept.size(), i = last.empty() ? 0 : last.back(); n > 0; i = before[i]) {
    kept[--n] = i;
  }
  return kept;
}

}  // namespace

std::int64_t median_step(std::vector<std::int64_t> const& times) {
  std::vector<std::int64_t> steps;
  for (std::size_t i = 1; i < times.size(); ++i) {
    if (times[i] > times[i - 1]) { steps.push_back(times[i] - times[i - 1]); }
  }
  if (steps.empty()) { return 0; }
  auto const middle = steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2);
  std::nth_element(steps.begin(), middle, steps.end());
  return *middle;
}

double median(std::vector<double> values) {
  if (values.empty()) { return 0; }
  auto const middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

stamp_text read_stamp(std::string const& text, std::string const& path, int line) {
  bool const whole = text.find_first_of(".eE") == std::string::npos;
  return {whole ? nanoseconds(text, path, line) : seconds_to_ns(text, path, line), whole, line};
}

bool whole_seconds(std::vector<stamp_text>& stamps, std::string const& path) {
  if (std::all_of(stamps.begin(), stamps.end(), [](auto const& s) { return s.whole; })) {
    return false;
  }
  constexpr std::int64_t second = 1'000'000'000, most = 4'600'000'000, longest_gap = 3600 * second;
  std::vector<std::int64_t> ns;  // -1 = is not in seconds
  for (stamp_text const& s : stamps) {
    ns.push_back(!s.whole ? s.value : s.value <= most ? s.value * second : -1);
  }
  for (std::size_t i = 0; i < stamps.size(); ++i) {
    if (!stamps[i].whole) { continue; }
    std::int64_t const before = i > 0 ? ns[i] - ns[i - 1] : largest;
    std::int64_t const after = i + 1 < ns.size() ? ns[i + 1] - ns[i] : largest;
    if (ns[i] < 0 || before < 0 || after < 0 || std::min(before, after) > longest_gap) {
      fail_at(path, stamps[i].line,
              "time stamp " + std::to_string(stamps[i].value) +
                  " has no decimal point, unlike others, and is not between its neighbours: "
                  "seconds or nanoseconds?");
    }
  }
  for (std::size_t i = 0; i < stamps.size(); ++i) { stamps[i] = {ns[i], false, stamps[i].line}; }
  return true;
}

std::vector<std::int64_t> stamp_column::times_ns(std::vector<std::string>& warnings) const {
  std::vector<stamp_text> stamps = stamps_;
  bool const seconds = whole_seconds(stamps, path_);
  std::vector<std::int64_t> values(stamps.size());
  std::transform(stamps.begin(), stamps.end(), values.begin(),
                 [](stamp_text const& s) { return s.value; });
  std::int64_t const step = seconds ? 0 : median_step(values);
  if (step == 0 || step > finest_ns_) { return values; }
  struct unit {
    char const* name;
    std::int64_t ns;
  };
  unit taken{};
  for (unit const& u : {unit{"microseconds", 1'000}, unit{"milliseconds", 1'000'000},
                        unit{"seconds", 1'000'000'000}}) {
    taken = u;
    if (step > finest_ns_ / u.ns) { break; }
  }
  std::vector<std::int64_t> times = values;
  for (std::int64_t& time : times) {
    if (time > largest / taken.ns) { return values; }  // nanoseconds of a fast camera
    time *= taken.ns;
  }
  warnings.push_back(path_ + ": time stamps were read as " + taken.name +
                     ": their median step is " + std::to_string(step) +
                     ", too short for nanoseconds");
  return times;
}

std::vector<std::size_t> ordered_lines(std::vector<std::int64_t> const& times, disordered rule,
                                       std::string const& path, std::string const& what,
                                       std::vector<std::string>& warnings) {
  std::vector<std::size_t> kept;
  std::size_t moved = 0;
  if (rule == disordered::sorted) {
    std::vector<std::size_t> all(times.size());
    std::iota(all.begin(), all.end(), std::size_t{0});
    std::stable_sort(all.begin(), all.end(),
                     [&](std::size_t a, std::size_t b) { return times[a] < times[b]; });
    for (std::size_t const i : all) {
      if (kept.empty() || times[kept.back()] != times[i]) { kept.push_back(i); }
    }
    for (std::size_t i = 1; i < times.size(); ++i) {
      moved += static_cast<std::size_t>(times[i] < times[i - 1]);
    }
  } else {
    kept = longest_ascending(times);
  }
  if (kept.size() < times.size()) {
    std::vector<bool> taken(times.size());
    for (std::size_t const i : kept) { taken[i] = true; }
    auto const first =
        static_cast<std::size_t>(std::find(taken.begin(), taken.end(), false) - taken.begin());
    warnings.push_back(path + ": " + lines_text(times.size() - kept.size()) + " of " +
                       std::to_string(times.size()) + " " + what +
                       " left out: a time stamp that is there already" +
                       (rule == disordered::sorted ? "" : ", or before that of an earlier line") +
                       " (the first is " + std::to_string(times[first]) + " ns)");
  }
  if (moved > 0) {
    warnings.push_back(path + ": " + lines_text(moved) + " of " + std::to_string(times.size()) +
                       " " + what + " out of order, sorted by time");
  }
  return kept;
}

std::vector<std::pair<std::size_t, std::size_t>> nearest_pairs(std::vector<std::int64_t> const& a,
                                                               std::vector<std::int64_t> const& b,
                                                               std::int64_t most_ns) {
  auto const nearest = [](std::vector<std::int64_t> const& list, std::int64_t time) {
    auto const after = std::lower_bound(list.begin(), list.end(), time);
    if (after == list.begin()) { return std::size_t{0}; }
    bool const later = after != list.end() && *after - time < time - *(after - 1);
    return static_cast<std::size_t>(after - list.begin()) - (later ? 0 : 1);
  };
  std::vector<std::pair<std::size_t, std::size_t>> pairs;
  for (std::size_t i = 0; i < a.size() && !b.empty(); ++i) {
    std::size_t const k = nearest(b, a[i]);
    std::int64_t const distance = a[i] < b[k] ? b[k] - a[i] : a[i] - b[k];
    if (distance <= most_ns && nearest(a, b[k]) == i) { pairs.emplace_back(i, k); }
  }
  return pairs;
}

std::int64_t smallest_distance(std::vector<std::int64_t> const& a,
                               std::vector<std::int64_t> const& b) {
  std::int64_t smallest = largest;
  for (std::size_t i = 0, k = 0; i < a.size() && k < b.size();) {
    smallest = std::min(smallest, a[i] < b[k] ? b[k] - a[i] : a[i] - b[k]);
    (a[i] < b[k] ? i : k) += 1;
  }
  return smallest;
}

std::int64_t time_of_frame(double frames, double rate, std::string const& path) {
  double const seconds = frames / rate;
  constexpr double most = 4.6e9;
  if (!(std::fabs(seconds) <= most)) {
    throw error(path + ": frame " + to_text(frames) + " at " + to_text(rate) +
                " images a second is beyond the limit of " + to_text(most) + " seconds");
  }
  return std::llround(frames * 1e9 / rate);
}

bool is_date(std::string const& text) {
  std::string const word = trim(text);
  return word.size() >= 19 && word[4] == '-' && word[7] == '-' && word[13] == ':' &&
         word[16] == ':';
}

std::int64_t date_to_ns(std::string const& text, std::string const& path, int line) {
  std::string const word = trim(text);
  auto const require = [&](bool holds) {
    if (holds) { return; }
    fail_at(path, line, "'" + word + "' is not a date such as 2011-09-26 13:02:25.964");
  };
  auto const number = [&](std::size_t at, std::size_t digits, int low, int high) {
    int value = 0;
    for (std::size_t i = at; i < at + digits; ++i) {
      value = is_digit(word[i]) ? 10 * value + (word[i] - '0') : high + 1;
      if (value > high) { break; }
    }
    require(value >= low && value <= high);
    return value;
  };
  require(is_date(word));
  int const year = number(0, 4, 1970, 2200);
  int const month = number(5, 2, 1, 12);
  int const hour = number(11, 2, 0, 23);
  int const minute = number(14, 2, 0, 59);
  number(17, 2, 0, 60);
  constexpr int days_before[] = {0, 31, 59, 90, 120, 151, 181, 212, 243, 273, 304, 334, 365};
  auto const leap_days = [](int years) { return years / 4 - years / 100 + years / 400; };
  bool const leap = leap_days(year) > leap_days(year - 1);
  int const in_month = days_before[month] - days_before[month - 1] + (leap && month == 2 ? 1 : 0);
  int const day = number(8, 2, 1, in_month);
  std::int64_t const days = 365 * (year - 1970) + leap_days(year - 1) - leap_days(1969) +
                            days_before[month - 1] + (leap && month > 2 ? 1 : 0) + day - 1;
  std::int64_t const minutes = (days * 24 + hour) * 60 + minute;
  constexpr std::int64_t in_minute = 60'000'000'000;
  std::int64_t const seconds = seconds_to_ns(word.substr(17), path, line);
  require(seconds >= 0 && seconds <= in_minute + in_minute / 60);
  return minutes * in_minute + seconds;
}

std::string milliseconds(std::int64_t ns) { return to_text(1e-6 * static_cast<double>(ns)); }

}  // namespace seq::detail
