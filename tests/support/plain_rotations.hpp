// SPDX-License-Identifier: Apache-2.0
/// @file The orientation check of searches, told plainly.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

namespace test {

/// A match's angles in the two frames, degrees.
struct turned_match {
  float before, now;
};

/// Which matches have one of the three most frequent rotations.
inline std::vector<bool> kept_rotations(std::vector<turned_match> const& matches) {
  std::vector<int> bins;
  int filled[30] = {};
  for (auto const& m : matches) {
    float turn = m.before - m.now;
    if (turn < 0) { turn += 360.0f; }
    float const in_bins = turn * (1.0f / 30);
    int bin = static_cast<int>(std::round(in_bins));
    if (bin == 30) { bin = 0; }
    bins.push_back(bin);
    ++filled[bin];
  }
  int place[3] = {-1, -1, -1};
  int most[3] = {};
  for (int bin = 0; bin < 30; ++bin) {
    for (int rank = 0; rank < 3; ++rank) {
      if (filled[bin] <= most[rank]) { continue; }
      for (int lower = 2; lower > rank; --lower) {
        most[lower] = most[lower - 1];
        place[lower] = place[lower - 1];
      }
      most[rank] = filled[bin];
      place[rank] = bin;
      break;
    }
  }
  float const tenth = 0.1f * static_cast<float>(most[0]);
  if (static_cast<float>(most[1]) < tenth) {
    place[1] = place[2] = -1;
  } else if (static_cast<float>(most[2]) < tenth) {
    place[2] = -1;
  }
  std::vector<bool> kept;
  for (int const bin : bins) {
    kept.push_back(bin == place[0] || bin == place[1] || bin == place[2]);
  }
  return kept;
}

}  // namespace test
