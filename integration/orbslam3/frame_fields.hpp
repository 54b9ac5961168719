// SPDX-License-Identifier: Apache-2.0
/// @file Values of a frame, and what the CPU has changed of them, beside the host's copy of the
/// device's arrays.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstring>
#include <vector>

#include "ft/containers/image_pyramid.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft::orbslam3 {

/// Fills in the number of a frame's levels, their scales and variances.
template <typename Frame>
void fill_scale_tables(pyramid_geometry const& levels, float scale_factor, Frame& frame) {
  int const n = levels.levels;
  frame.mnScaleLevels = n;
  frame.mfScaleFactor = scale_factor;
  frame.mfLogScaleFactor = std::log(scale_factor);
  frame.mvScaleFactors.assign(levels.scale, levels.scale + n);
  frame.mvInvScaleFactors.assign(levels.inv_scale, levels.inv_scale + n);
  frame.mvLevelSigma2.assign(levels.sigma2, levels.sigma2 + n);
  frame.mvInvLevelSigma2.assign(levels.inv_sigma2, levels.inv_sigma2 + n);
}

/// Replaces a value. @param changed set if the value was different
template <typename T>
inline void replace(T& value, T const& now, bool& changed) {
  if (std::memcmp(&value, &now, sizeof now) == 0) { return; }
  value = now;
  changed = true;
}

/// Takes the positions of a camera's keypoints over. @param changed set if one was different
template <typename Keypoints>
void replace_positions(frame_arrays const& a, int camera, Keypoints const& keypoints,
                       bool& changed) {
  for (int i = 0; i < a.count[camera]; ++i) {
    int const at = camera * a.capacity + i;
    auto const& pt = keypoints[static_cast<std::size_t>(i)].pt;
    replace(a.x[at], pt.x, changed);
    replace(a.y[at], pt.y, changed);
  }
}

/// Takes Frame::mvuRight over. @return whether a column was different
inline bool replace_right_columns(frame_arrays const& a, std::vector<float> const& columns) {
  bool changed = false;
  for (int i = 0; i < a.count[0]; ++i) {
    auto const at = static_cast<std::size_t>(i);
    replace(a.right_x[i], at < columns.size() ? columns[at] : -1.0f, changed);
  }
  return changed;
}

/// Takes Frame::mvLeftToRightMatch and mvRightToLeftMatch over. @return whether a partner was
/// different
inline bool replace_partners(frame_arrays const& a, std::vector<int> const& left_to_right,
                             std::vector<int> const& right_to_left) {
  bool changed = false;
  auto const of = [](std::vector<int> const& partners, int i) {
    auto const at = static_cast<std::size_t>(i);
    return at < partners.size() ? partners[at] : -1;
  };
  for (int i = 0; i < a.capacity; ++i) {
    int const j = i < a.count[0] ? of(left_to_right, i) : -1;
    int const back = i < a.count[1] ? of(right_to_left, i) : -1;
    replace(a.partner[i], j < 0 ? -1 : a.capacity + j, changed);
    replace(a.partner[a.capacity + i], back, changed);
  }
  return changed;
}

}  // namespace ft::orbslam3
