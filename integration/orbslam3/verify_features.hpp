// SPDX-License-Identifier: Apache-2.0
/// @file Features and words of CPU and GPU, compared.
#pragma once

#include <algorithm>
#include <bitset>
#include <cstddef>
#include <map>
#include <mutex>
#include <tuple>
#include <utility>
#include <vector>

#include "integration/orbslam3/recovery_stages.hpp"
#include "integration/orbslam3/verify_report.hpp"

namespace ft::orbslam3 {

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

/// Adds what differs: as sets first, then of each keypoint. Keypoints are the same if position and
/// octave are.
template <typename Keypoint, typename Matrix>
void compare_features(difference_log& log, char const* order, std::vector<Keypoint> const& cpu,
                      std::vector<Keypoint> const& gpu, Matrix const& cpu_rows,
                      Matrix const& gpu_rows) {
  log.compare("number of keypoints", -1, cpu.size(), gpu.size());
  auto const key = [](Keypoint const& k) { return std::make_tuple(k.octave, k.pt.y, k.pt.x); };
  std::multimap<std::tuple<int, float, float>, std::size_t> alone;
  for (std::size_t j = 0; j < gpu.size(); ++j) { alone.emplace(key(gpu[j]), j); }
  std::vector<std::size_t> partner(cpu.size(), gpu.size());
  for (std::size_t i = 0; i < cpu.size(); ++i) {
    auto const same = alone.lower_bound(key(cpu[i]));
    if (same == alone.end() || same->first != key(cpu[i])) {
      log.compare("keypoint of the CPU alone", static_cast<long>(i), 1, 0);
      continue;
    }
    partner[i] = same->second;
    alone.erase(same);
  }
  for (auto const& other : alone) {
    log.compare("keypoint of the GPU alone", static_cast<long>(other.second), 0, 1);
  }
  long moved = 0;
  bool same_set = alone.empty();
  for (std::size_t i = 0; i < cpu.size(); ++i) {
    std::size_t const j = partner[i];
    same_set = same_set && j < gpu.size();
    if (j == gpu.size()) { continue; }
    auto const at = static_cast<long>(i);
    moved += static_cast<long>(i != j);
    log.compare("angle of keypoint", at, cpu[i].angle, gpu[j].angle);
    log.compare("response of keypoint", at, cpu[i].response, gpu[j].response);
    log.compare("descriptor bits of keypoint", at, 0, other_bits(cpu_rows, i, gpu_rows, j));
  }
  if (same_set && moved > 0) { log.add_number(order, moved); }
}

/// Adds the sizes of two lists, or the first two entries that differ.
template <typename List>
void compare_lists(difference_log& log, char const* what, long at, List const& cpu,
                   List const& gpu) {
  if (cpu.size() != gpu.size()) { return log.compare(what, at, cpu.size(), gpu.size()); }
  auto const other = std::mismatch(cpu.begin(), cpu.end(), gpu.begin());
  if (other.first != cpu.end()) { log.compare(what, at, *other.first, *other.second); }
}

/// Calls compare(key, value of the CPU, value of the GPU) for each key of one of them; the other's
/// value is then 0, or empty.
template <typename Map, typename Compare>
void compare_maps(Map const& cpu, Map const& gpu, Compare const& compare) {
  typename Map::mapped_type const none{};
  for (auto const& [key, value] : cpu) {
    auto const other = gpu.find(key);
    compare(static_cast<long>(key), value, other == gpu.end() ? none : other->second);
  }
  for (auto const& [key, value] : gpu) {
    if (cpu.count(key) == 0) { compare(static_cast<long>(key), none, value); }
  }
}

/// Fills a frame's words by `cpu`, then by `gpu`, whose answer stays.
template <typename Frame, typename Cpu, typename Gpu>
void verify_words(difference_log& log, Frame& frame, Cpu const& cpu, Gpu const& gpu) {
  cpu();
  auto const bag = std::exchange(frame.mBowVec, {});
  auto const groups = std::exchange(frame.mFeatVec, {});
  gpu();
  compare_maps(bag, frame.mBowVec,
               [&](long word, double a, double b) { log.compare("value of word", word, a, b); });
  compare_maps(groups, frame.mFeatVec, [&](long node, auto const& a, auto const& b) {
    compare_lists(log, "keypoints of node", node, a, b);
  });
}

/// Calls of other threads than the log's, which adds them when it comes to it.
class calls_elsewhere {
public:
  /// Makes a call of stage `s`, from any thread. @param call void(difference_log&)
  template <typename Call>
  void make(unsigned long frame, stage s, Call const& call) {
    std::vector<difference> found;
    difference_log log([&](difference const& d) { found.push_back(d); });
    log.begin(frame, s);
    call(log);
    std::lock_guard<std::mutex> const lock(mutex_);
    calls_.emplace_back(s, std::move(found));
  }
  /// From the log's thread.
  void add_to(difference_log& log) {
    std::vector<std::pair<stage, std::vector<difference>>> calls;
    {
      std::lock_guard<std::mutex> const lock(mutex_);
      calls.swap(calls_);
    }
    for (auto const& [s, found] : calls) { log.add_call(s, found); }
  }

private:
  std::mutex mutex_;
  std::vector<std::pair<stage, std::vector<difference>>> calls_;
};

}  // namespace ft::orbslam3
