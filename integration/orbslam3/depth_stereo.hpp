// SPDX-License-Identifier: Apache-2.0
/// @file Depths of a frame's keypoints from an RGB-D camera's depth image.
#pragma once

#include <cstddef>

#include "ft/core/execution.hpp"
#include "ft/kernels/images/depth_association.hpp"

namespace ft {
namespace orbslam3 {

/// Frame::ComputeStereoFromRGBD: mvuRight and mvDepth.
/// @param depth metres, CV_32F @param bf virtual baseline times fx, metres
template <typename Frame, typename Image>
void fill_stereo_from_depth(Frame& frame, Image const& depth, float bf) {
  int const n = static_cast<int>(frame.mvKeys.size());
  frame.mvuRight.assign(frame.mvKeys.size(), -1.0f);
  frame.mvDepth.assign(frame.mvKeys.size(), -1.0f);
  if (n == 0) { return; }
  using columns = soa<memory_space::host, field::x, field::y>;
  columns raw(n);
  columns undistorted(n);
  stereo_matches<memory_space::host> found(n);
  auto const put = [n](columns const& to, auto const& keys) {
    for (int i = 0; i < n; ++i) {
      get<field::x>(to.view(), i) = keys[static_cast<std::size_t>(i)].pt.x;
      get<field::y>(to.view(), i) = keys[static_cast<std::size_t>(i)].pt.y;
    }
    *to.view().count = n;
  };
  put(raw, frame.mvKeys);
  put(undistorted, frame.mvKeysUn);
  depth_images_view<float> const image{
      reinterpret_cast<float const*>(depth.data),
      depth.cols,
      depth.rows,
      static_cast<std::ptrdiff_t>(static_cast<std::size_t>(depth.step)),
      0,
      1};
  depth_params params;
  params.bf = bf;
  associate_depth(host_exec(1), raw.view(), undistorted.view(), image, params, found.view());
  for (int i = 0; i < n; ++i) {
    frame.mvuRight[static_cast<std::size_t>(i)] = get<field::right_x>(found.view(), i);
    frame.mvDepth[static_cast<std::size_t>(i)] = get<field::depth>(found.view(), i);
  }
}

}  // namespace orbslam3
}  // namespace ft
