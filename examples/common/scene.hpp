// SPDX-License-Identifier: Apache-2.0
/// @file Images for the examples: a textured room seen from a moving stereo pair, rendered by
/// examples/sequence/generator.hpp. Plain types only, so that units of any compiler can use it.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace demo {

struct grey_image {
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> pixels;
};

struct image_pair {
  grey_image left, right;
};

/// Where a second pair is, in the frame of the first one's left camera.
struct mounting {
  double turn = 0;               ///< to the right, about the y axis, radians
  std::array<double, 3> centre;  ///< of its left camera, metres
};

/// A rectified pair of cameras that moves through a room. The same images on every run.
class scene {
public:
  /// @param frames rendered on demand @param width pixels; the height follows
  explicit scene(int frames, int width = 752);
  scene(scene&&) noexcept;
  scene& operator=(scene&&) noexcept;
  ~scene();

  int frames() const;
  int width() const;
  int height() const;
  std::array<float, 4> intrinsics() const;  ///< fx, fy, cx, cy, pixels
  float baseline() const;                   ///< metres
  image_pair render(int frame) const;
  /// Of a second pair of the same cameras that moves with the first one.
  image_pair render(int frame, mounting const& other) const;
  /// True depth of the surface that the left camera sees at (u, v), metres.
  double depth(int frame, double u, double v) const;
  /// True centre of the left camera in the frame of the first one, metres.
  std::array<double, 3> centre(int frame) const;

private:
  struct impl;
  std::unique_ptr<impl> impl_;
};

/// A PNG or JPEG file as 8-bit grey. @throws std::runtime_error naming the file
grey_image read_image(std::string const& path);

}  // namespace demo
