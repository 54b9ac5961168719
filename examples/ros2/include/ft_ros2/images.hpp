// SPDX-License-Identifier: Apache-2.0
/// @file What sensor_msgs/Image and CameraInfo hold, as the tracker takes it.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

#include "ft_ros2/tracker.hpp"

namespace ft_ros2 {

/// What is taken of a sensor_msgs/CameraInfo: the size, pixels, of the images whose projection
/// matrix P (3 x 4, row-major) is.
struct projection_info {
  int width = 0, height = 0;
  std::array<double, 12> P{};
};

inline std::string size_text(int width, int height) {
  return std::to_string(width) + "x" + std::to_string(height);
}

/// @param width,height of the images
/// @throws std::runtime_error where these are not of a rectified pair of that size
inline rectified_pair pair_of(int width, int height, projection_info const& left_info,
                              projection_info const& right_info) {
  for (projection_info const& info : {left_info, right_info}) {
    if (info.width != width || info.height != height) {
      throw std::runtime_error("CameraInfo is of " + size_text(info.width, info.height) +
                               " images, these are " + size_text(width, height) +
                               ": it must be that of the rectified images, without binning");
    }
  }
  auto const& left = left_info.P;
  auto const& right = right_info.P;
  rectified_pair p{width, height, left[0], left[5], left[2], left[6], 0};
  if (!(p.fx > 0 && p.fy > 0)) { throw std::runtime_error("the left CameraInfo has no P"); }
  for (std::size_t i : {0u, 5u, 2u, 6u}) {
    if (!(std::abs(left[i] - right[i]) < 1e-3)) {
      throw std::runtime_error("the P of both CameraInfo differ: the images are not rectified");
    }
  }
  p.baseline = -right[3] / right[0];
  if (!(p.baseline > 0)) {
    throw std::runtime_error("the right CameraInfo has no baseline: P[3] must be -fx * baseline");
  }
  return p;
}

/// The data of a sensor_msgs/Image.
struct message_image {
  std::uint8_t const* data = nullptr;
  std::size_t bytes = 0;
  int width = 0, height = 0;
  std::size_t step = 0;  ///< bytes from row to row
};

/// Where red, green and blue are in a pixel.
struct pixel_layout {
  std::size_t bytes = 0, red = 0, green = 0, blue = 0;
};

/// @throws std::runtime_error for an encoding that is not one of 8 bits, grey or colour
inline pixel_layout layout_of(std::string const& encoding) {
  if (encoding == "mono8" || encoding == "8UC1") { return {1, 0, 0, 0}; }
  if (encoding == "rgb8") { return {3, 0, 1, 2}; }
  if (encoding == "bgr8" || encoding == "8UC3") { return {3, 2, 1, 0}; }
  if (encoding == "rgba8") { return {4, 0, 1, 2}; }
  if (encoding == "bgra8" || encoding == "8UC4") { return {4, 2, 1, 0}; }
  throw std::runtime_error(
      "images of encoding '" + encoding +
      "' are not taken: mono8, rgb8, bgr8, rgba8, bgra8, 8UC1, 8UC3, 8UC4 are");
}

/// Grey without padding, by the weights of ITU-R BT.601. @param grey gets width * height bytes
/// @throws std::runtime_error for another encoding, or fewer bytes than the size needs
inline void to_grey(message_image const& from, std::string const& encoding,
                    std::vector<std::uint8_t>& grey) {
  pixel_layout const at = layout_of(encoding);
  auto const width = static_cast<std::size_t>(from.width);
  auto const height = static_cast<std::size_t>(from.height);
  if (from.width < 1 || from.height < 1 || from.step < width * at.bytes ||
      from.bytes < (height - 1) * from.step + width * at.bytes) {
    throw std::runtime_error("an image has fewer bytes than its size needs");
  }
  grey.resize(width * height);
  for (std::size_t y = 0; y < height; ++y) {
    std::uint8_t const* row = from.data + y * from.step;
    for (std::size_t x = 0; x < width; ++x, row += at.bytes) {
      grey[y * width + x] = static_cast<std::uint8_t>(
          (9798u * row[at.red] + 19235u * row[at.green] + 3735u * row[at.blue] + 16384u) >> 15);
    }
  }
}

}  // namespace ft_ros2
