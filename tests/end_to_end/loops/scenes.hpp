// SPDX-License-Identifier: Apache-2.0
/// @file Walls that repeat or do not, and what a rectified pair sees of them.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ft/math/se3.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/end_to_end/soak_scene.hpp"

namespace loop_cases {

using image = std::vector<std::uint8_t>;
using motion = ft::rigid<double>;

constexpr std::int64_t period_ns = 50'000'000;

/// A rectified pair, 0.2 m wide, of 77 degrees.
struct pair_of_cameras {
  int width, height;

  ft::rectified_rig rig() const {
    float const f = 0.625f * static_cast<float>(width);
    return ft::rectified_rig::make(
        {f, f, 0.5f * static_cast<float>(width) - 0.5f, 0.5f * static_cast<float>(height) - 0.5f},
        0.2f);
  }
  ft::gray_view view(image const& i) const { return {i.data(), width, height, width}; }
  std::size_t pixels() const { return static_cast<std::size_t>(width) * height; }
};

/// Where a camera is: metres along the wall, down, nearer to it; turned by so many rad about an
/// axis.
inline motion camera_at(double x, double y, double z, ft::vec3<double> const& turn) {
  double const d[6] = {turn.x, turn.y, turn.z, 0, 0, 0};
  motion T = ft::detail::exp_se3<double>(d).orthonormalized();
  T.t = {x, y, z};
  return T;
}

/// A facade 3 m away, of which some parts are 0.4 m deeper.
struct wall {
  unsigned seed = 1;
  double repeats = 0;  ///< looks the same after so many metres; 0: never
  /// So does what lies that far to the right of a stretch, metres; 0: nothing does.
  double alike_begin = 0, alike_end = 0, alike_after = 0;

  /// A place that looks the same.
  double as(double x) const {
    if (repeats > 0) { return x - repeats * std::floor(x / repeats); }
    double const twin = x - alike_after;
    return alike_after > 0 && twin >= alike_begin && twin < alike_end ? twin : x;
  }
  bool is_deep(double x) const {
    auto const cell = static_cast<unsigned>(static_cast<int>(std::floor((as(x) + 1000) * 1.25)));
    unsigned const h = (cell * 2654435761u) ^ (seed * 40503u);
    return (h >> 7) % 3 == 0;
  }
  std::uint8_t grey(double x, double y) const {
    return soak_scene::texture((as(x) + 200 + 300 * (seed % 997)) * 90, (y + 100) * 90);
  }

  /// @param right metres of the camera to the right of T @param noise seed of it
  image render(pair_of_cameras const& by, motion const& T, double right, unsigned noise) const {
    auto const camera = by.rig().camera.cast<double>();
    auto const eye = T * ft::vec3<double>{right, 0, 0};
    image out(by.pixels());
    std::uint8_t* to = out.data();
    unsigned random = noise * 2246822519u + 1;
    for (int v = 0; v < by.height; ++v) {
      for (int u = 0; u < by.width; ++u) {
        auto const d = T.R * camera.unproject({1.0 * u, 1.0 * v}).direction;
        random = random * 1664525u + 1013904223u;
        int level = 128;
        if (d.z > 0.05) {
          double depth = (3 - eye.z) / d.z;
          if (is_deep(eye.x + depth * d.x)) { depth = (3.4 - eye.z) / d.z; }
          level = grey(eye.x + depth * d.x, eye.y + depth * d.y) +
                  static_cast<int>((random >> 16) % 7) - 3;
        }
        *to++ = static_cast<std::uint8_t>(std::clamp(level, 0, 255));
      }
    }
    return out;
  }
  struct frame {
    image left, right;
  };
  frame see(pair_of_cameras const& by, motion const& T, unsigned noise) const {
    return {render(by, T, 0, 2 * noise), render(by, T, 0.2, 2 * noise + 1)};
  }
};

constexpr pair_of_cameras small_pair{320, 240};

/// A map that forgets soon, so that what is recognised is so by loops.
/// @param kept keyframes for loops, at most; 0: no loops
inline ft::odometry_params small_map(int kept) {
  ft::odometry_params p;
  p.orb.width = small_pair.width;
  p.orb.height = small_pair.height;
  p.orb.features = 400;
  p.orb.levels = 6;
  p.map_slots = 1500;
  p.local_points = 1024;
  p.keyframes = 8;
  p.window_points = 1024;
  p.window = {4, 2};
  p.local_map.keyframes = 6;
  p.loops.present = kept > 0;
  p.loops.keyframes = std::max(kept, 128);
  p.loops.recent = 8;
  return p;
}

}  // namespace loop_cases
