// SPDX-License-Identifier: Apache-2.0
/// @file Counts of answers that are identical, by stage.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <string>

namespace test {

struct stage_result {
  long items = 0;
  long identical = 0;
  double max_abs_diff = 0;

  void add(bool same, double difference = 0) {
    ++items;
    identical += static_cast<long>(same);
    max_abs_diff = std::max(max_abs_diff, std::abs(difference));
  }
  double share() const {
    return items == 0 ? 1.0 : static_cast<double>(identical) / static_cast<double>(items);
  }
};
using conformance_table = std::map<std::string, stage_result>;

inline void print(conformance_table const& table, std::string const& title) {
  std::printf("%s\n%-22s %10s %10s %10s %14s\n", title.c_str(), "stage", "items", "identical",
              "share", "max diff");
  for (auto const& [name, r] : table) {
    std::printf("%-22s %10ld %10ld %9.4f%% %14.3g\n", name.c_str(), r.items, r.identical,
                100 * r.share(), r.max_abs_diff);
  }
}

}  // namespace test
