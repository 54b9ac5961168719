// SPDX-License-Identifier: Apache-2.0
/// @file Words by CPU and GPU and their comparison, for frames of tracking and keyframes of
/// mapping.
#pragma once

#include <algorithm>
#include <cstddef>
#include <mutex>
#include <utility>
#include <vector>

#include "integration/orbslam3/verify_report.hpp"

namespace ft {
namespace orbslam3 {

namespace word_detail {

/// Words that only one of both has count as 0 of the other.
template <typename Bag>
void compare_bags(difference_log& log, Bag const& cpu, Bag const& gpu) {
  for (auto const& [word, value] : cpu) {
    auto const other = gpu.find(word);
    log.compare("value of word", static_cast<long>(word), value,
                other == gpu.end() ? 0.0 : other->second);
  }
  for (auto const& [word, value] : gpu) {
    if (cpu.count(word) == 0) { log.compare("value of word", static_cast<long>(word), 0.0, value); }
  }
}
/// The sizes of a group, or the first two keypoints that differ.
template <typename Groups>
void compare_groups(difference_log& log, Groups const& cpu, Groups const& gpu) {
  typename Groups::mapped_type const none{};
  auto const group = [&](Groups const& all, auto node) -> auto const& {
    auto const found = all.find(node);
    return found == all.end() ? none : found->second;
  };
  auto const compare = [&](auto node) {
    auto const& a = group(cpu, node);
    auto const& b = group(gpu, node);
    char const* const what = "keypoints of node";
    if (a.size() != b.size()) {
      log.compare(what, static_cast<long>(node), a.size(), b.size());
      return;
    }
    auto const other = std::mismatch(a.begin(), a.end(), b.begin());
    if (other.first != a.end()) {
      log.compare(what, static_cast<long>(node), *other.first, *other.second);
    }
  };
  for (auto const& entry : cpu) { compare(entry.first); }
  for (auto const& entry : gpu) {
    if (cpu.count(entry.first) == 0) { compare(entry.first); }
  }
}

}  // namespace word_detail

/// Fills a frame's words by `cpu`, then by `gpu`, whose answer stays.
template <typename Frame, typename Cpu, typename Gpu>
void verify_words(difference_log& log, Frame& frame, Cpu const& cpu, Gpu const& gpu) {
  cpu();
  auto const bag = std::exchange(frame.mBowVec, {});
  auto const groups = std::exchange(frame.mFeatVec, {});
  gpu();
  word_detail::compare_bags(log, bag, frame.mBowVec);
  word_detail::compare_groups(log, groups, frame.mFeatVec);
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

}  // namespace orbslam3
}  // namespace ft
