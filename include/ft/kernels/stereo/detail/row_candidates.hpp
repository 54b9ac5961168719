// SPDX-License-Identifier: Apache-2.0
/// @file The right keypoints that may be the partner of a left one: those of its rows and octave.
/// Source: specification section 5.
#pragma once

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/core/views.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// A left keypoint.
struct row_feature {
  float x, y;
  int octave;
  descriptor orb;
};

/// Largest distance in rows of a matching right keypoint.
FT_HOST_DEVICE inline int row_reach(pyramid_geometry const& geometry, int octave) {
  return static_cast<int>(2.0f * geometry.scale[min_of(octave + 1, geometry.levels - 1)]) + 2;
}

/// Whether a right keypoint is a candidate: by column, octave and row.
struct candidate_band {
  float lowest_u, u;
  int octave, row;
  float finer, same, coarser;  ///< half height of a right keypoint's band, by its octave

  FT_HOST_DEVICE candidate_band(pyramid_geometry const& geometry, row_feature const& mine,
                                int at_row, float max_disparity)
      : lowest_u(mine.x - max_disparity),
        u(mine.x),
        octave(mine.octave),
        row(at_row),
        finer(2.0f * geometry.scale[max_of(octave - 1, 0)]),
        same(2.0f * geometry.scale[octave]),
        coarser(2.0f * geometry.scale[min_of(octave + 1, geometry.levels - 1)]) {}
  /// Without branches, so that no load waits for the value of another.
  FT_HOST_DEVICE bool operator()(float x, float y, int o) const {
    float const b = o == octave ? same : (o < octave ? finer : coarser);
    bool const on_octave = (o >= octave - 1) & (o <= octave + 1);
    bool const off_columns = (x < lowest_u) | (x > u);
    // The row, an integer, is in [floor(y - b), ceil(y + b)].
    bool const on_rows =
        (y - b < static_cast<float>(row + 1)) & (y + b > static_cast<float>(row - 1));
    return on_octave & !off_columns & on_rows;
  }
};

/// A right keypoint and the distance of its descriptor.
struct row_candidate {
  int keypoint;  ///< -1 = none
  int distance;
};

/// The listed right keypoint with the nearest descriptor, the first of equals; none if none is near
/// enough.
template <typename Group>
FT_HOST_DEVICE row_candidate nearest_in_rows(Group g, descriptor const& mine,
                                             candidate_band const& is_candidate,
                                             keypoints_view const& right, span<int const> listed,
                                             int hamming_limit) {
  // Candidates per thread whose loads are in flight together. The last one may be loaded again.
  constexpr int together = Group::max_threads == 1 ? 1 : 3;
  unsigned long long best = ~0ull;
  for (int k = 0; k < listed.size; k += together * g.size()) {
    int j[together];
    bool near[together];
    descriptor theirs[together];
    FT_UNROLL
    for (int n = 0; n < together; ++n) {
      j[n] = listed[min_of(k + n * g.size() + g.rank(), listed.size - 1)];
    }
    g.sync();  // keeps the compiler from making some of these loads wait for others
    float x[together];
    float y[together];
    int o[together];
    FT_UNROLL
    for (int n = 0; n < together; ++n) {
      x[n] = right.x(j[n]);
      y[n] = right.y(j[n]);
      o[n] = right.octave(j[n]);
    }
    g.sync();
    FT_UNROLL
    for (int n = 0; n < together; ++n) { near[n] = is_candidate(x[n], y[n], o[n]); }
    FT_UNROLL
    for (int n = 0; n < together; ++n) {
      if (near[n]) { theirs[n] = right.orb(j[n]); }
    }
    FT_UNROLL
    for (int n = 0; n < together; ++n) {
      if (!near[n]) { continue; }
      int const distance = search_distance(mine, theirs[n]);
      best = min_of(best,
                    static_cast<unsigned long long>(distance) << 32 | static_cast<unsigned>(j[n]));
    }
  }
  best = g.reduce(best, min_op{});
  int const distance = static_cast<int>(best >> 32);
  return {distance < hamming_limit && best != ~0ull ? static_cast<int>(best & 0xffffffffu) : -1,
          distance};
}

/// Two distances of one pattern, seen by two cameras, differ by so much: the standard deviation of
/// the difference of two numbers of 24 to 40 independent bits of 256, those of right partners.
inline constexpr int as_near = descriptor_scale::limit(7);

/// Whether another listed right keypoint is as near as the one that was found, at least 11 pixels
/// of the level away from it, where windows have no pixel in common: the image repeats along the
/// row.
template <typename Group>
FT_HOST_DEVICE bool has_rival(Group g, row_feature const& mine, candidate_band const& is_candidate,
                              pyramid_geometry const& geometry, keypoints_view const& right,
                              span<int const> listed, row_candidate const& found,
                              int hamming_limit) {
  float const apart = mul(11.0f, geometry.scale[mine.octave]);
  float const x = right.x(found.keypoint);
  int const most = min_of(found.distance + as_near, hamming_limit - 1);
  int rivals = 0;
  for (int k = g.rank(); k < listed.size; k += g.size()) {
    int const j = listed[k];
    float const away = right.x(j) - x;
    if ((away < apart) & (away > -apart)) { continue; }
    if (!is_candidate(right.x(j), right.y(j), right.octave(j))) { continue; }
    rivals += static_cast<int>(search_distance(mine.orb, right.orb(j)) <= most);
  }
  return g.reduce(rivals, sum_op{}) > 0;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
