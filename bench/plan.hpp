// SPDX-License-Identifier: Apache-2.0
/// @file The plan of a run: sections, repetitions, and the trackers of each thread.
#pragma once

#include <algorithm>
#include <cstddef>
#include <set>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace bench {

inline std::vector<std::string> const& all_sections() {
  static std::vector<std::string> const names{"cameras",  "frame",     "fisheye",  "stages",
                                              "batch",    "streams",   "graph",    "kernels",
                                              "ablation", "tie_rules", "odometry", "map_stages",
                                              "gpus",     "inertial",  "words",    "host_stages"};
  return names;
}

/// Names, in several strings or one with commas, to a set; none = all.
/// @throws std::runtime_error for an unknown name, with the list of known ones
inline std::set<std::string> parse_sections(std::vector<std::string> const& given) {
  auto const& all = all_sections();
  if (given.empty()) { return {all.begin(), all.end()}; }
  std::set<std::string> chosen;
  for (std::string const& list : given) {
    for (std::size_t begin = 0; begin <= list.size();) {
      std::size_t const end = std::min(list.find(',', begin), list.size());
      std::string const name = list.substr(begin, end - begin);
      if (std::find(all.begin(), all.end(), name) == all.end()) {
        std::string known;
        for (auto const& n : all) { known += (known.empty() ? "" : ", ") + n; }
        throw std::runtime_error("no section '" + name + "'; there are " + known);
      }
      chosen.insert(name);
      begin = end + 1;
    }
  }
  return chosen;
}

/// Number of calls that time a batch: those of one pair for small batches, fewer for large ones, so
/// that the frames stay within 16 times those of one pair. At least 24, unless one pair has fewer.
inline int calls_of_batch(int calls_of_one, int batch) {
  int const fair = static_cast<int>(16LL * calls_of_one / std::max(1, batch));
  return std::max(1, std::min(calls_of_one, std::max(24, fair)));
}

/// First item of part `part` of `parts`, and the first after it: sizes differ by at most one.
inline std::pair<int, int> share_of(int items, int parts, int part) {
  auto const at = [&](int p) {
    return static_cast<int>(static_cast<long long>(items) * p / parts);
  };
  return {at(part), at(part + 1)};
}

/// One frame of many trackers: its end and its duration, microseconds.
struct finished_frame {
  double end = 0;
  double took = 0;
};

/// The rate of frames that trackers finished one after the other, and the duration of each. Omits
/// the first fifth as warm-up.
/// @param[in,out] frames gets sorted by their ends
/// @return frames per second; 0 if fewer than two frames are left
inline double steady_rate(std::vector<finished_frame>& frames, std::vector<double>& took) {
  std::sort(frames.begin(), frames.end(),
            [](finished_frame const& a, finished_frame const& b) { return a.end < b.end; });
  took.clear();
  std::size_t const first = frames.size() / 5;
  for (std::size_t i = first; i < frames.size(); ++i) { took.push_back(frames[i].took); }
  if (took.size() < 2) { return 0; }
  double const span = frames.back().end - frames[first].end;
  return span > 0 ? 1e6 * static_cast<double>(took.size() - 1) / span : 0;
}

}  // namespace bench
