// SPDX-License-Identifier: Apache-2.0
/// @file Stage: drops rectified stereo matches whose score is too far above the median of their
/// pair. Source: specification section 5.
#pragma once

#include "ft/containers/keypoints.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Item: a pair. Drops the matches whose score is too far above the median.
///
/// The median is selected with two histograms, not a sort: scores are below 2^16 and their number
/// is known at run time only.
struct cut_stereo_outliers {
  static constexpr int fine_bits = 6;
  static constexpr int fine_bins = 1 << fine_bits;
  static constexpr int coarse_bins = 1 << (16 - fine_bits);  ///< scores are below 2^16
  static constexpr int kept = 3;                             ///< scores per thread in registers
  struct scratch {
    int coarse[coarse_bins];
    int fine[fine_bins];
    int bin;   ///< coarse bin of the median
    int rank;  ///< of the median within its bin
  };

  /// Clears the bins.
  template <typename Group>
  FT_HOST_DEVICE void prologue(Group g, scratch& s, int /*pair*/,
                               stereo_matches_view const& /*matches*/) const {
    FT_NO_UNROLL
    for (int b = g.rank(); b < coarse_bins; b += g.size()) { s.coarse[b] = 0; }
    FT_NO_UNROLL
    for (int b = g.rank(); b < fine_bins; b += g.size()) { s.fine[b] = 0; }
    g.sync();
  }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int pair,
                                 stereo_matches_view const& matches) const {
    stereo_matches_view const m = matches.slice(pair);
    int first[kept];  // in flight together with the count
    FT_UNROLL
    for (int k = 0; k < kept; ++k) {
      int const i = g.rank() + k * g.size();
      first[k] = i < m.capacity ? m.score(i) : -1;
    }
    int const n = *m.count;
    FT_UNROLL
    for (int k = 0; k < kept; ++k) {
      if (g.rank() + k * g.size() >= n) { first[k] = -1; }
    }
    auto const each_score = [&](auto const& visit) {
      FT_UNROLL
      for (int k = 0; k < kept; ++k) {
        if (first[k] >= 0) { visit(g.rank() + k * g.size(), first[k]); }
      }
      FT_NO_UNROLL
      for (int i = g.rank() + kept * g.size(); i < n; i += g.size()) {
        int const score = m.score(i);
        if (score >= 0) { visit(i, score); }
      }
    };
    each_score([&](int, int score) { atomic_add(s.coarse + (score >> fine_bits), 1); });
    g.sync();

    // The score of rank found / 2: first its coarse bin, then the fine one.
    static_assert(coarse_bins % Group::max_threads == 0, "equal shares");
    int const chunk = coarse_bins / g.size();
    int const begin = g.rank() * chunk;
    int mine = 0;
    for (int b = begin; b < begin + chunk; ++b) { mine += s.coarse[b]; }
    int found = 0;
    int before = g.exclusive_scan(mine, found);
    if (found == 0) { return; }
    if (before <= found / 2 && found / 2 < before + mine) {
      int b = begin;
      for (; before + s.coarse[b] <= found / 2; ++b) { before += s.coarse[b]; }
      s.bin = b;
      s.rank = found / 2 - before;
    }
    g.sync();
    int const bin = s.bin;
    each_score([&](int, int score) {
      if (score >> fine_bits == bin) { atomic_add(s.fine + (score & (fine_bins - 1)), 1); }
    });
    g.sync();
    int const median = bin << fine_bits | place_of(g.part(), s.fine, s.rank);

    // In double the same scores, whole numbers, would be above it.
    float const limit = mul(mul(1.5f, 1.4f), static_cast<float>(median));
    each_score([&](int i, int score) {
      if (static_cast<float>(score) >= limit) {
        m.right_x(i) = -1;
        m.depth(i) = -1;
        m.score(i) = -1;
      }
    });
  }

private:
  /// The bin that holds a rank; computed by each warp on its own.
  template <typename Part>
  FT_HOST_DEVICE static int place_of(Part part, int const* bins, int rank) {
    int const chunk = ceil_div(fine_bins, part.size());
    int const begin = part.rank() * chunk;
    int mine = 0;
    for (int b = begin; b < begin + chunk; ++b) { mine += bins[b]; }
    int total = 0;
    int before = part.exclusive_scan(mine, total);
    bool const here = before <= rank && rank < before + mine;
    int b = begin;
    for (; here && before + bins[b] <= rank; ++b) { before += bins[b]; }
    return part.shuffle(b, trailing_zeros(part.ballot(here)));
  }
};

}  // namespace detail

/// Drops the outliers of every pair: the last step of match_stereo_rectified(). Asynchronous on
/// `exec`; allocates nothing; one launch.
template <typename Exec>
void cut_outliers(Exec const& exec, keypoints_view const& keypoints,
                  stereo_matches_view const& out) {
  for_each_item<per_block<512>>(exec, keypoints.batch / 2, detail::cut_stereo_outliers{}, out);
}

}  // namespace FT_ABI
}  // namespace ft
