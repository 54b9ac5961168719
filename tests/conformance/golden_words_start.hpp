// SPDX-License-Identifier: Apache-2.0
/// @file Runs the start with one camera over recorded frames, and compares it with the recorded
/// matches and reconstructions of golden_words.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "ft/pipelines/monocular_start.hpp"
#include "tests/conformance/golden_sequence.hpp"
#include "tests/conformance/golden_words_input.hpp"
#include "tests/conformance/golden_words_searches.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/npy.hpp"

namespace test {

/// A sequence of frames: the first one, and those that are tried with it.
template <typename Exec>
class golden_start {
public:
  /// @param sequence as in the names of two_view @param tried frames after the first one
  golden_start(Exec const& exec, std::string root, std::string sequence, int tried)
      : exec_(exec), root_(std::move(root)), sequence_(std::move(sequence)) {
    for (int k = 0; k <= tried; ++k) {
      frames_.emplace_back(root_, sequence_ + "_mono_ini_" + std::to_string(k));
      capacity_ = std::max(capacity_, frames_.back().size());
    }
  }

  void run(stage_result& r) const {
    auto const K = read_npy<float>(case_of(1) + "/K.npy");
    ft::monocular_start_params params;
    // Attempts count from the seed of the first one, as in the recorded cases.
    params.rules.seed = read_npy<std::uint64_t>(case_of(1) + "/seed.npy")(0);
    ft::monocular_start<Exec> start(exec_, params, {{K(0, 0), K(1, 1), K(0, 2), K(1, 2)}},
                                    words_grid(frames_[0].set), capacity_);
    for (int k = 0; k < static_cast<int>(frames_.size()); ++k) {
      add(start, k);
      auto const report = from_exec(exec_, start.reports(), 1)[0];
      if (k == 0) {
        r.add(report.outcome == ft::start_outcome::took_first);
      } else {
        compare(r, start, report, case_of(k));
      }
    }
  }

private:
  std::string case_of(int k) const {
    return root_ + "/two_view/" + sequence_ + "_0_" + std::to_string(k);
  }

  void add(ft::monocular_start<Exec>& start, int k) const {
    words_frame const& f = frames_[static_cast<std::size_t>(k)];
    auto const undistorted =
        k == 0 ? read_npy<float>(case_of(1) + "/p1.npy") : read_npy<float>(case_of(k) + "/p2.npy");
    ft::keypoints<Exec::space> const keypoints(capacity_);
    ft::pixels<Exec::space> const pixels(capacity_);
    auto const to = keypoints.view();
    fill(exec_, to, 0);
    set_pixels(exec_, to, f.x, f.y, {f.size()});
    auto const n = static_cast<std::size_t>(f.size());
    ft::copy(exec_, ft::array_of<ft::field::angle>(to), f.angle.data(), n);
    ft::copy(exec_, ft::array_of<ft::field::octave>(to), f.octave.data(), n);
    ft::copy(exec_, ft::array_of<ft::field::orb>(to), f.orb.data(), n);
    std::vector<float> x;
    std::vector<float> y;
    for (int i = 0; i < undistorted.rows(); ++i) {
      x.push_back(undistorted(i, 0));
      y.push_back(undistorted(i, 1));
    }
    set_pixels(exec_, pixels.view(), x, y, {f.size()});
    start.add(exec_, {to, pixels.view(), nullptr});
    exec_.wait();
  }

  void compare(stage_result& r, ft::monocular_start<Exec> const& start,
               ft::start_report const& report, std::string const& want) const {
    bool const made = read_npy<std::int32_t>(want + "/ok_useH.npy")(0) != 0;
    r.add(report.outcome == (made ? ft::start_outcome::started : ft::start_outcome::no_motion));
    auto const n = static_cast<std::size_t>(frames_[0].size());
    auto const recorded = read_npy<std::int32_t>(want + "/matches.npy");
    std::vector<int> match(n, -1);
    for (int i = 0; i < recorded.rows(); ++i) {
      match.at(static_cast<std::size_t>(recorded(i, 0))) = recorded(i, 1);
    }
    if (made) {  // drops what is not triangulated
      auto const triangulated = read_npy<std::uint8_t>(want + "/triangulated.npy");
      for (std::size_t i = 0; i < n; ++i) {
        if (triangulated.data.at(i) == 0) { match[i] = -1; }
      }
    }
    auto const got = from_exec(exec_, start.matches().match, n);
    int differing = 0;
    for (std::size_t i = 0; i < n; ++i) { differing += static_cast<int>(got[i] != match[i]); }
    r.add(differing <= (made ? 1 : 0), differing);
    r.add(report.matches ==
          static_cast<int>(std::count_if(got.begin(), got.end(), [](int m) { return m >= 0; })));
    if (!made) { return; }
    auto const T = read_npy<float>(want + "/T21.npy");
    ft::pose const m = from_exec(exec_, start.reconstructions().result, 1)[0].T_21;
    float const t[3] = {m.t.x, m.t.y, m.t.z};
    double turned = 0;
    double moved = 0;
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        turned = std::max(turned, std::abs(static_cast<double>(m.R.m[3 * i + j] - T(i, j))));
      }
      moved = std::max(moved, std::abs(static_cast<double>(t[i] - T(i, 3))));
    }
    r.add(turned <= 1e-5, turned);
    r.add(moved <= 1e-4, moved);
  }

  Exec exec_;
  std::string root_;
  std::string sequence_;
  std::vector<words_frame> frames_;
  int capacity_ = 1;
};

/// All recorded starts.
template <typename Exec>
void compare_starts(Exec const& exec, std::string const& root, stage_result& r) {
  golden_start<Exec>(exec, root, "euroc", 2).run(r);
  golden_start<Exec>(exec, root, "kb8", 1).run(r);
  golden_start<Exec>(exec, root, "kitti", 1).run(r);
  golden_start<Exec>(exec, root, "t265", 1).run(r);
}

}  // namespace test
