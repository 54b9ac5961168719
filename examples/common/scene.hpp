// SPDX-License-Identifier: Apache-2.0
/// @file Images for the examples: a textured room with three boxes in it, seen from a moving stereo
/// pair. Each pixel is a ray to the nearest surface. It needs nothing but the standard library.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

namespace demo {

struct grey_image {
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> pixels;  ///< row-major, no padding
};

struct image_pair {
  grey_image left, right;
};

/// Where a second pair is, in the frame of the first one's left camera.
struct mounting {
  double turn = 0;                 ///< to the right, about the y axis, radians
  std::array<double, 3> centre{};  ///< of its left camera, metres
};

/// Grey values that repeat after 512 x 512: soft noise of two sizes, and tiles with edges, which
/// have the corners.
class texture {
public:
  texture() : grey_(size * size) {
    for (int v = 0; v < size; ++v) {
      for (int u = 0; u < size; ++u) {
        double const soft = 40 * noise(u, v, 32, 1) + 20 * noise(u, v, 4, 2);
        double const tiles = 30 * draw(u / 32, v / 32, 3) + (draw(u / 8, v / 8, 4) > 0.6 ? -50 : 0);
        grey_[static_cast<std::size_t>(v * size + u)] = static_cast<float>(128 + soft + tiles);
      }
    }
  }
  /// Between four pixels.
  float at(double u, double v) const {
    double const u0 = std::floor(u), v0 = std::floor(v);
    auto const a = static_cast<float>(u - u0), b = static_cast<float>(v - v0);
    int const i = static_cast<int>(u0), j = static_cast<int>(v0);
    return (1 - b) * ((1 - a) * pixel(i, j) + a * pixel(i + 1, j)) +
           b * ((1 - a) * pixel(i, j + 1) + a * pixel(i + 1, j + 1));
  }

private:
  static constexpr int size = 512;

  float pixel(int i, int j) const {  // sizes are powers of two, so negative numbers wrap, too
    return grey_[static_cast<std::size_t>((j & (size - 1)) * size + (i & (size - 1)))];
  }
  /// -1 to 1, smooth between the corners of cells
  static double noise(int u, int v, int cell, std::uint32_t seed) {
    double const a = smooth(u % cell, cell), b = smooth(v % cell, cell);
    int const i = u / cell, j = v / cell;
    return (1 - b) * ((1 - a) * draw(i, j, seed) + a * draw(i + 1, j, seed)) +
           b * ((1 - a) * draw(i, j + 1, seed) + a * draw(i + 1, j + 1, seed));
  }
  static double smooth(int rest, int cell) {
    double const t = static_cast<double>(rest) / cell;
    return t * t * (3 - 2 * t);
  }
  static double draw(int i, int j, std::uint32_t seed) {
    std::uint32_t h = static_cast<std::uint32_t>(i) * 0x9E3779B1u ^
                      static_cast<std::uint32_t>(j) * 0x85EBCA77u ^ seed * 0xC2B2AE3Du;
    h = (h ^ h >> 15) * 0x2C1B3C6Du;
    h = (h ^ h >> 12) * 0x297A2D39u;
    return static_cast<double>((h ^ h >> 15) & 0xFFFF) / 32767.5 - 1;
  }

  std::vector<float> grey_;
};

/// A rectified pair of cameras that moves through the room: x to the right, y down, z ahead; the
/// world is the first frame's left camera. The same images on every run.
class scene {
public:
  /// @param frames at 20 Hz, rendered on demand @param width pixels; the height follows
  explicit scene(int frames, int width = 752) : frames_(frames), width_(width) {}

  int frames() const { return frames_; }
  int width() const { return width_; }
  int height() const { return width_ * 480 / 752; }
  /// fx, fy, cx, cy, pixels
  std::array<float, 4> intrinsics() const {
    auto const focal = static_cast<float>(435.0 * width_ / 752);
    return {focal, focal, 0.5f * static_cast<float>(width_ - 1),
            0.5f * static_cast<float>(height() - 1)};
  }
  float baseline() const { return 0.11f; }  ///< metres
  image_pair render(int frame) const { return render(frame, mounting{}); }
  /// Of a second pair of the same cameras that moves with the first one.
  image_pair render(int frame, mounting const& other) const {
    camera left = at(frame);
    for (std::size_t k = 0; k < 3; ++k) { left.centre[k] += rotated(left.yaw, other.centre)[k]; }
    left.yaw += other.turn;
    camera right = left;
    for (std::size_t k = 0; k < 3; ++k) {
      right.centre[k] += rotated(left.yaw, {static_cast<double>(baseline()), 0, 0})[k];
    }
    return {image_of(left), image_of(right)};
  }
  /// True depth of the surface that the left camera sees at (u, v), metres.
  double depth(int frame, double u, double v) const { return hit_of(at(frame), u, v).depth; }
  /// True centre of the left camera, metres.
  std::array<double, 3> centre(int frame) const { return at(frame).centre; }

private:
  using vector = std::array<double, 3>;
  struct camera {
    vector centre;
    double yaw;  ///< to the right
  };
  struct hit {
    double depth = std::numeric_limits<double>::infinity();
    double u = 0, v = 0;  ///< of the texture
  };
  struct box {
    vector low, high;
  };
  static constexpr std::array<box, 4> boxes{{{{-3, -1.4, -3}, {3, 1.3, 7}},  // the room
                                             {{-1.6, 0.3, 2.6}, {-0.7, 1.3, 3.4}},
                                             {{0.9, -0.4, 3.6}, {1.6, 1.3, 4.3}},
                                             {{-0.4, 0.6, 4.8}, {0.5, 1.3, 5.6}}}};

  static camera at(int frame) {
    double const t = frame / 20.0;  // seconds
    return {{0.5 * std::sin(0.9 * t), 0.1 * std::sin(1.3 * t), 0.3 * t}, 0.25 * std::sin(0.7 * t)};
  }
  static vector rotated(double yaw, vector const& d) {
    double const c = std::cos(yaw), s = std::sin(yaw);
    return {c * d[0] + s * d[2], d[1], c * d[2] - s * d[0]};
  }
  /// The nearest face that the ray through a pixel meets, from inside of the room and outside of
  /// the others.
  hit hit_of(camera const& from, double u, double v) const {
    auto const k = intrinsics();
    vector const ray =
        rotated(from.yaw, {(u - static_cast<double>(k[2])) / static_cast<double>(k[0]),
                           (v - static_cast<double>(k[3])) / static_cast<double>(k[1]), 1});
    hit nearest;
    for (std::size_t b = 0; b < boxes.size(); ++b) {
      for (std::size_t axis = 0; axis < 3; ++axis) {
        bool const upper = (ray[axis] > 0) == (b == 0);
        double const to = upper ? boxes[b].high[axis] : boxes[b].low[axis];
        double const depth = (to - from.centre[axis]) / ray[axis];
        std::size_t const first = (axis + 1) % 3, second = (axis + 2) % 3;
        double const p = from.centre[first] + depth * ray[first],
                     q = from.centre[second] + depth * ray[second];
        bool const on = p >= boxes[b].low[first] && p <= boxes[b].high[first] &&
                        q >= boxes[b].low[second] && q <= boxes[b].high[second];
        if (!on || !(depth > 0 && depth < nearest.depth)) { continue; }
        double const face = static_cast<double>(6 * b + 2 * axis + (upper ? 1 : 0));
        nearest = {depth, p * texels_per_metre + 97 * face, q * texels_per_metre + 61 * face};
      }
    }
    return nearest;
  }
  grey_image image_of(camera const& from) const {
    grey_image image{width_, height(), {}};
    image.pixels.reserve(static_cast<std::size_t>(width_) * static_cast<std::size_t>(height()));
    for (int v = 0; v < height(); ++v) {
      for (int u = 0; u < width_; ++u) {
        hit const h = hit_of(from, u, v);
        image.pixels.push_back(
            static_cast<std::uint8_t>(std::clamp(surface_.at(h.u, h.v), 0.0f, 255.0f)));
      }
    }
    return image;
  }

  static constexpr double texels_per_metre = 80;

  int frames_;
  int width_;
  texture surface_;
};

}  // namespace demo
