// SPDX-License-Identifier: Apache-2.0
/// @file Orientation check: drops matches whose rotation differs from that of most others.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/frame.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/search/last_frame_windows.hpp"
#include "ft/kernels/search/workspace.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Histogram of the rotations of matched keypoints between the last frame and the current one.
///
/// A bin is 30 degrees wide, as in the reference, so only the first 13 of the 30 bins fill.
struct rotations {
  static constexpr int bins = 30;

  /// Angle of the keypoint of the last frame that window i belongs to.
  /// @param left_count number of its keypoints in the left image
  FT_HOST_DEVICE static float last_angle(last_frame_view const& last, int left_count, int b,
                                         int i) {
    bool const left = i < left_count;
    auto const from = last.keypoints.slice(last.keypoint_step * b + (left ? 0 : 1));
    return from.angle(left ? i : i - left_count);
  }
  FT_HOST_DEVICE static int bin(float before, float now) {
    float rotation = before - now;
    if (rotation < 0.0f) { rotation += 360.0f; }
    int const r = round_away(mul(rotation, 1.0f / static_cast<float>(bins)));
    return r == bins ? 0 : clamp(r, 0, bins - 1);
  }

  /// The three fullest bins; ties go to the lower index. Bins with less than a tenth of the fullest
  /// one do not count.
  struct most_frequent {
    int bin[3];   ///< -1 = none
    int matches;  ///< in all three bins

    FT_HOST_DEVICE bool has(int r) const { return r == bin[0] || r == bin[1] || r == bin[2]; }
  };
  /// Every warp computes the result, which is faster than a broadcast.
  template <typename Part>
  FT_HOST_DEVICE static most_frequent of(Part w, int const* histogram) {
    most_frequent top{{-1, -1, -1}, 0};
    int first = 0;
    int below = 0x7fffffff;
    FT_UNROLL
    for (int t = 0; t < 3; ++t) {
      int best = 0;  // of keys (count, 31 - index)
      for (int i = w.rank(); i < bins; i += w.size()) {
        int const key = histogram[i] * 32 + 31 - i;
        if (histogram[i] > 0 && key < below) { best = max_of(best, key); }
      }
      below = w.reduce(best, max_op{});
      int const size = below / 32;
      if (t == 0) { first = size; }
      // A float in the reference; of whole numbers a double would tell no other.
      if (size == 0 || static_cast<float>(size) < mul(0.1f, static_cast<float>(first))) { break; }
      top.bin[t] = 31 - below % 32;
      top.matches += size;
    }
    return top;
  }
};

/// Item: a frame. Drops the matches whose rotation is not among the three most frequent.
struct check_orientation {
  static constexpr int scratch_size = 4096;  ///< windows whose bins are kept in scratch
  struct scratch {
    int histogram[rotations::bins];
    std::uint8_t bin[scratch_size];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, frame_view const& frame,
                                 last_frame_view const& last, search_buffers const& buffers) const {
    search_workspace const& work = buffers.work;
    for (int i = g.rank(); i < rotations::bins; i += g.size()) { s.histogram[i] = 0; }
    g.sync();
    int const n = buffers.windows.count[b];
    int const left_count = last.keypoints.count[last.keypoint_step * b];
    bool const kept = frame.cameras * n <= scratch_size;
    constexpr std::uint8_t no_match = 255;
    auto const bin = [&](int c, int i, int k) {
      return rotations::bin(rotations::last_angle(last, left_count, b, i),
                            frame.camera(b, c).angle(k));
    };
    for (int c = 0; c < frame.cameras; ++c) {
      for (int i = g.rank(); i < n; i += g.size()) {
        int const k = work.match[work.window(c, b, i)];
        int const r = k >= 0 ? bin(c, i, k) : no_match;
        if (k >= 0) { atomic_add(s.histogram + r, 1); }
        if (kept) { s.bin[c * n + i] = static_cast<std::uint8_t>(r); }
      }
    }
    g.sync();
    auto const most = rotations::of(g.part(), s.histogram);
    for (int c = 0; c < frame.cameras; ++c) {
      for (int i = g.rank(); i < n; i += g.size()) {
        if (kept && s.bin[c * n + i] == no_match) { continue; }
        int& k = work.match[work.window(c, b, i)];
        if (k < 0) { continue; }
        int const r = kept ? s.bin[c * n + i] : bin(c, i, k);
        if (most.has(r)) { continue; }
        frame.holder[static_cast<std::ptrdiff_t>(b) * frame.numbers() + c * frame.capacity() + k] =
            -1;
        k = -1;
      }
    }
    if (g.rank() == 0) { work.matches[b] = most.matches; }
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
