// SPDX-License-Identifier: Apache-2.0
/// @file Conversions to and from OpenCV's types; the only header that includes OpenCV. Host memory
/// only.
#pragma once

#include <cstddef>
#include <cstring>
#include <opencv2/core.hpp>
#include <vector>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/views.hpp"

namespace ft {
inline namespace FT_ABI {

/// A view of the pixels of an 8-bit grey matrix. @throws bad_argument for another type
inline gray_view as_view(cv::Mat const& image) {
  detail::require(image.type() == CV_8UC1 && image.dims == 2, "an 8-bit grey cv::Mat is needed");
  return {image.data, image.cols, image.rows, static_cast<int>(image.step)};
}

/// The keypoints of one image as cv::KeyPoint. @param keypoints one batch entry, host memory
inline std::vector<cv::KeyPoint> to_opencv(keypoints_view const& keypoints,
                                           pyramid_geometry const& geometry) {
  std::vector<cv::KeyPoint> all;
  for (int i = 0; i < *keypoints.count; ++i) {
    int const octave = keypoints.octave(i);
    all.emplace_back(keypoints.x(i), keypoints.y(i),
                     static_cast<float>(geometry.patch_size(octave)), keypoints.angle(i),
                     keypoints.response(i), octave);
  }
  return all;
}

/// The descriptors of one image, a row of bytes each, ORB's of 32. @param keypoints one batch
/// entry, host memory
inline cv::Mat descriptors_to_opencv(keypoints_view const& keypoints) {
  cv::Mat rows(*keypoints.count, static_cast<int>(sizeof(descriptor)), CV_8UC1);
  for (int i = 0; i < *keypoints.count; ++i) {
    std::memcpy(rows.ptr(i), &keypoints.orb(i), sizeof(descriptor));
  }
  return rows;
}

/// Writes OpenCV's keypoints into one batch entry: position, angle, response and octave unchanged,
/// and the count. Does not write descriptors.
/// @param to host memory
/// @throws bad_argument for more keypoints than its capacity
inline void from_opencv(std::vector<cv::KeyPoint> const& keypoints, keypoints_view const& to) {
  detail::require_range("number of keypoints", keypoints.size(), std::size_t{0},
                        static_cast<std::size_t>(to.capacity));
  *to.count = static_cast<int>(keypoints.size());
  for (int i = 0; i < *to.count; ++i) {
    auto const& k = keypoints[static_cast<std::size_t>(i)];
    to.x(i) = k.pt.x;
    to.y(i) = k.pt.y;
    to.angle(i) = k.angle;
    to.response(i) = k.response;
    to.octave(i) = k.octave;
  }
}

}  // namespace FT_ABI
}  // namespace ft
