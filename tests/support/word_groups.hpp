// SPDX-License-Identifier: Apache-2.0
/// @file Groups of keypoints by the node of a vocabulary, made from the node of each keypoint.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <vector>

#include "ft/containers/words.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"

namespace test {

/// The groups of one frame, as rows of node_groups_view.
struct words_groups {
  std::vector<std::uint32_t> node;
  std::vector<int> start, keypoint;
  int count = 0;

  /// @param of node of each keypoint, -1 = in no group
  words_groups(std::vector<int> const& of, int capacity) {
    std::map<int, std::vector<int>> sorted;
    for (std::size_t i = 0; i < of.size(); ++i) {
      if (of[i] >= 0) { sorted[of[i]].push_back(static_cast<int>(i)); }
    }
    start.push_back(0);
    for (auto const& [n, members] : sorted) {
      node.push_back(static_cast<std::uint32_t>(n));
      keypoint.insert(keypoint.end(), members.begin(), members.end());
      start.push_back(static_cast<int>(keypoint.size()));
    }
    count = static_cast<int>(sorted.size());
    auto const wide = static_cast<std::size_t>(capacity);
    node.resize(wide, 0xdeadu);
    keypoint.resize(wide, -12345);
    start.resize(wide + 1, -12345);
  }
};

/// Groups of a batch of frames in an executor's memory.
template <typename Exec>
class uploaded_groups {
public:
  uploaded_groups() = default;
  uploaded_groups(Exec const& exec, std::vector<words_groups> const& frames, int capacity)
      : memory_(
            [&](ft::carver& c) { carve(c, view_, static_cast<int>(frames.size()), capacity); }) {
    for (std::size_t f = 0; f < frames.size(); ++f) {
      int const row = static_cast<int>(f);
      ft::copy(exec, view_.count + row, &frames[f].count, 1);
      ft::copy(exec, view_.node + view_.at(row), frames[f].node.data(), frames[f].node.size());
      ft::copy(exec, view_.start + view_.start_at(row), frames[f].start.data(),
               frames[f].start.size());
      ft::copy(exec, view_.keypoint + view_.at(row), frames[f].keypoint.data(),
               frames[f].keypoint.size());
    }
    exec.wait();
  }
  ft::node_groups_view const& view() const { return view_; }

private:
  ft::node_groups_view view_;
  ft::arena<Exec::space> memory_;
};

}  // namespace test
