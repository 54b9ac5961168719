// SPDX-License-Identifier: Apache-2.0
/// @file Sums of the times of stages.
#pragma once

#include <chrono>
#include <cstddef>
#include <map>
#include <string>
#include <vector>

namespace app {

/// Sums of milliseconds by stage, for one frame at a time.
class stage_sums {
public:
  explicit stage_sums(std::vector<std::string> const& names)
      : names_(names), ms_(names.size(), 0.0) {
    for (std::size_t i = 0; i < names.size(); ++i) { index_[names[i]] = i; }
  }
  void reset() { ms_.assign(ms_.size(), 0.0); }
  void add(std::string const& stage, double ms) { ms_[index_.at(stage)] += ms; }
  std::vector<double> const& ms() const { return ms_; }
  std::vector<std::string> const& names() const { return names_; }

private:
  std::vector<std::string> names_;
  std::map<std::string, std::size_t> index_;
  std::vector<double> ms_;
};

inline double now_ms() {
  return std::chrono::duration<double, std::milli>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

}  // namespace app
