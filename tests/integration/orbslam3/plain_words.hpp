// SPDX-License-Identifier: Apache-2.0
/// @file Words and the search by words as plain loops over the stand-in types, written from the
/// specification.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <fstream>
#include <iomanip>
#include <string>
#include <utility>
#include <vector>

#include "ft/containers/keypoints.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/support/plain_vocabulary.hpp"

namespace orbslam3_test {

inline int plain_distance(ft::descriptor const& a, ft::descriptor const& b) {
  int bits = 0;
  for (int w = 0; w < 8; ++w) {
    for (auto x = a.words[w] ^ b.words[w]; x != 0; x &= x - 1) { ++bits; }
  }
  return bits;
}
inline ft::descriptor row_of(stand_in::matrix const& m, std::size_t i) {
  ft::descriptor d;
  std::memcpy(d.words, m.data + i * static_cast<std::size_t>(m.step), sizeof d.words);
  return d;
}

/// DBoW2's text form, without a newline at the end.
inline void write_text(std::string const& path, test::plain_vocabulary const& v) {
  std::ofstream out(path);
  out << v.header.branching << " " << v.header.levels << " " << static_cast<int>(v.header.scoring)
      << " " << static_cast<int>(v.header.weighting) << std::setprecision(17);
  for (std::size_t i = 1; i < v.parent.size(); ++i) {
    out << "\n" << v.parent[i] << " " << (v.word[i] < 0 ? 0 : 1);
    unsigned char bytes[32];
    std::memcpy(bytes, v.orb[i].words, sizeof bytes);
    for (unsigned char const b : bytes) { out << " " << static_cast<int>(b); }
    out << " " << v.weight[i];
  }
}

/// Transforms by TF-IDF with the L1 norm.
class plain_words {
public:
  explicit plain_words(test::plain_vocabulary const& v) : v_(v), children_(v.parent.size()) {
    for (std::size_t i = 1; i < v.parent.size(); ++i) {
      children_[static_cast<std::size_t>(v.parent[i])].push_back(i);
    }
  }

  template <typename Frame>
  void transform(Frame& f, int up) const {
    for (std::size_t i = 0; i < static_cast<std::size_t>(f.mDescriptors.rows); ++i) {
      std::size_t node = 0;
      std::size_t group = 0;
      ft::descriptor const mine = row_of(f.mDescriptors, i);
      for (int depth = 1; !children_[node].empty(); ++depth) {
        node = *std::min_element(
            children_[node].begin(), children_[node].end(), [&](std::size_t a, std::size_t b) {
              return plain_distance(mine, v_.orb[a]) < plain_distance(mine, v_.orb[b]);
            });
        if (depth <= v_.header.levels - up) { group = node; }
      }
      if (!(v_.weight[node] > 0)) { continue; }
      f.mBowVec[static_cast<unsigned>(v_.word[node])] += v_.weight[node];
      f.mFeatVec[static_cast<unsigned>(group)].push_back(static_cast<unsigned>(i));
    }
    double sum = 0;
    for (auto const& entry : f.mBowVec) { sum += std::abs(entry.second); }
    for (auto& entry : f.mBowVec) { entry.second /= sum; }
  }

private:
  test::plain_vocabulary v_;
  std::vector<std::vector<std::size_t>> children_;
};

/// ORBmatcher::SearchByBoW of a keyframe and a frame.
class plain_word_search {
public:
  plain_word_search(stand_in::key_frame const& keyframe, stand_in::frame const& frame, float ratio,
                    bool check)
      : keyframe_(keyframe), frame_(frame), ratio_(ratio), check_(check) {}

  int run(std::vector<stand_in::map_point*>& matches) {
    auto const points = keyframe_.GetMapPointMatches();
    from_.assign(static_cast<std::size_t>(frame_.mDescriptors.rows), -1);
    for (auto const& [node, wanted] : keyframe_.mFeatVec) {
      auto const there = frame_.mFeatVec.find(node);
      if (there == frame_.mFeatVec.end()) { continue; }
      for (unsigned const i : wanted) {
        if (points[i] == nullptr || points[i]->isBad()) { continue; }
        choose(i, there->second);
      }
    }
    auto const kept = kept_bins();
    matches.assign(from_.size(), nullptr);
    int n = 0;
    for (std::size_t k = 0; k < from_.size(); ++k) {
      if (from_[k] < 0 || !kept[bin_of(k)]) { continue; }
      matches[k] = points[static_cast<std::size_t>(from_[k])];
      ++n;
    }
    return n;
  }

private:
  struct nearest {
    int best = 256, second = 256;
    std::size_t at = 0;
    void add(int d, std::size_t k) {
      if (d < best) {
        second = best;
        best = d;
        at = k;
      } else if (d < second) {
        second = d;
      }
    }
  };
  void choose(unsigned i, std::vector<unsigned> const& candidates) {
    ft::descriptor const mine = row_of(keyframe_.mDescriptors, i);
    nearest left, right;
    for (unsigned const k : candidates) {
      if (from_[k] >= 0) { continue; }
      bool const in_right = frame_.Nleft >= 0 && static_cast<int>(k) >= frame_.Nleft;
      (in_right ? right : left).add(plain_distance(mine, row_of(frame_.mDescriptors, k)), k);
    }
    if (left.best > 50) { return; }
    if (static_cast<float>(left.best) < ratio_ * static_cast<float>(left.second)) {
      from_[left.at] = static_cast<int>(i);
    }
    if (frame_.Nleft >= 0 && right.best <= 50) { from_[right.at] = static_cast<int>(i); }
  }
  template <typename Frame>
  static float angle_of(Frame const& f, int left, std::size_t i) {
    if (left < 0) { return f.mvKeysUn[i].angle; }
    auto const n = static_cast<std::size_t>(left);
    return i < n ? f.mvKeys[i].angle : f.mvKeysRight[i - n].angle;
  }
  std::size_t bin_of(std::size_t k) const {
    float turn = angle_of(keyframe_, keyframe_.NLeft, static_cast<std::size_t>(from_[k])) -
                 angle_of(frame_, frame_.Nleft, k);
    if (turn < 0) { turn += 360.0f; }
    auto const bin = static_cast<std::size_t>(std::round(turn * (1.0f / 30)));
    return bin == 30 ? 0 : bin;
  }
  std::array<bool, 31> kept_bins() const {
    std::array<bool, 31> kept{};
    if (!check_) {
      kept.fill(true);
      return kept;
    }
    std::array<int, 31> size{};
    for (std::size_t k = 0; k < from_.size(); ++k) {
      if (from_[k] >= 0) { ++size[bin_of(k)]; }
    }
    std::array<std::size_t, 31> order{};
    for (std::size_t b = 0; b < order.size(); ++b) { order[b] = b; }
    std::stable_sort(order.begin(), order.end(),
                     [&](std::size_t a, std::size_t b) { return size[a] > size[b]; });
    auto const count = [&](int k) {
      return static_cast<float>(size[order[static_cast<std::size_t>(k)]]);
    };
    kept[order[0]] = count(0) > 0;
    if (count(1) < 0.1f * count(0)) { return kept; }
    kept[order[1]] = count(1) > 0;
    if (count(2) < 0.1f * count(0)) { return kept; }
    kept[order[2]] = count(2) > 0;
    return kept;
  }

  stand_in::key_frame const& keyframe_;
  stand_in::frame const& frame_;
  float ratio_;
  bool check_;
  std::vector<int> from_;
};

/// A keyframe made of a frame.
inline stand_in::key_frame keyframe_of(stand_in::frame const& f) {
  stand_in::key_frame k;
  k.mnFrameId = f.mnId;
  k.NLeft = f.Nleft;
  k.mvKeys = f.mvKeys;
  k.mvKeysUn = f.mvKeysUn;
  k.mvKeysRight = f.mvKeysRight;
  k.mDescriptors = f.mDescriptors;
  k.mBowVec = f.mBowVec;
  k.mFeatVec = f.mFeatVec;
  k.points = f.mvpMapPoints;
  return k;
}

}  // namespace orbslam3_test
