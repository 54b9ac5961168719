// SPDX-License-Identifier: Apache-2.0
/// @file Two extractions of one image as sets of keypoints: those in both, and those in only one.
#pragma once

#include <algorithm>
#include <bitset>
#include <cstddef>
#include <numeric>
#include <tuple>
#include <utility>
#include <vector>

#include "integration/orbslam3/verify_report.hpp"

namespace ft {
namespace orbslam3 {

struct keypoint_pairs {
  std::vector<std::pair<std::size_t, std::size_t>> common;  ///< index pairs, sorted by the first
  std::vector<std::size_t> first_alone;
  std::vector<std::size_t> second_alone;
};

/// Keypoints are the same if position and octave are.
template <typename Keypoint>
keypoint_pairs pair_keypoints(std::vector<Keypoint> const& first,
                              std::vector<Keypoint> const& second) {
  auto const key = [](Keypoint const& k) { return std::make_tuple(k.octave, k.pt.y, k.pt.x); };
  auto const sorted = [&](std::vector<Keypoint> const& all) {
    std::vector<std::size_t> order(all.size());
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::stable_sort(order.begin(), order.end(),
                     [&](std::size_t a, std::size_t b) { return key(all[a]) < key(all[b]); });
    return order;
  };
  auto const a = sorted(first);
  auto const b = sorted(second);
  keypoint_pairs pairs;
  std::size_t i = 0;
  std::size_t j = 0;
  while (i < a.size() && j < b.size()) {
    if (key(first[a[i]]) < key(second[b[j]])) {
      pairs.first_alone.push_back(a[i++]);
    } else if (key(second[b[j]]) < key(first[a[i]])) {
      pairs.second_alone.push_back(b[j++]);
    } else {
      pairs.common.emplace_back(a[i++], b[j++]);
    }
  }
  pairs.first_alone.insert(pairs.first_alone.end(), a.begin() + static_cast<std::ptrdiff_t>(i),
                           a.end());
  pairs.second_alone.insert(pairs.second_alone.end(), b.begin() + static_cast<std::ptrdiff_t>(j),
                            b.end());
  std::sort(pairs.common.begin(), pairs.common.end());
  return pairs;
}

/// Number of differing bits of two descriptors: row `i` of one matrix and row `j` of another.
template <typename Matrix>
int other_bits(Matrix const& a, std::size_t i, Matrix const& b, std::size_t j) {
  unsigned char const* const p = a.data + i * static_cast<std::size_t>(a.step);
  unsigned char const* const q = b.data + j * static_cast<std::size_t>(b.step);
  std::size_t bits = 0;
  for (int byte = 0; byte < 32; ++byte) {
    bits += std::bitset<8>(static_cast<unsigned char>(p[byte] ^ q[byte])).count();
  }
  return static_cast<int>(bits);
}

/// Adds what differs: as sets first, then of each keypoint.
template <typename Keypoint, typename Matrix>
void compare_features(difference_log& log, char const* order, std::vector<Keypoint> const& cpu,
                      std::vector<Keypoint> const& gpu, Matrix const& cpu_rows,
                      Matrix const& gpu_rows) {
  log.compare("number of keypoints", -1, cpu.size(), gpu.size());
  keypoint_pairs const pairs = pair_keypoints(cpu, gpu);
  for (std::size_t const i : pairs.first_alone) {
    log.compare("keypoint of the CPU alone", static_cast<long>(i), 1, 0);
  }
  for (std::size_t const i : pairs.second_alone) {
    log.compare("keypoint of the GPU alone", static_cast<long>(i), 0, 1);
  }
  long moved = 0;
  for (auto const& [i, j] : pairs.common) {
    auto const at = static_cast<long>(i);
    moved += static_cast<long>(i != j);
    log.compare("angle of keypoint", at, cpu[i].angle, gpu[j].angle);
    log.compare("response of keypoint", at, cpu[i].response, gpu[j].response);
    log.compare("descriptor bits of keypoint", at, 0, other_bits(cpu_rows, i, gpu_rows, j));
  }
  bool const same_set = pairs.first_alone.empty() && pairs.second_alone.empty();
  if (same_set && moved > 0) { log.add_number(order, moved); }
}

}  // namespace orbslam3
}  // namespace ft
