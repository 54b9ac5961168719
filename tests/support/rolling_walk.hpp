// SPDX-License-Identifier: Apache-2.0
/// @file What cameras with rolling shutters see of the rendered room of room.hpp, on ways from
/// rest.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "ft/any_odometry.hpp"
#include "ft/cameras/any_camera.hpp"
#include "ft/types/poses.hpp"
#include "tests/support/random.hpp"
#include "tests/support/room.hpp"

namespace test::rolling {

using test::at;
using test::room::height;
using test::room::width;
using any = ft::any_camera<float>;
using motion = ft::rigid<double>;
using matrix = ft::mat3<double>;
using vector = ft::vec3<double>;
constexpr double readout = 0.033;               ///< s
constexpr double focal = 300, baseline = 0.25;  ///< of a rectified pair, pixels and metres

inline motion pose_of(double yaw, double pitch, vector const& place) {
  double const c = std::cos(yaw), s = std::sin(yaw), cp = std::cos(pitch), sp = std::sin(pitch);
  return {matrix{{c, 0, s, 0, 1, 0, -s, 0, c}} * matrix{{1, 0, 0, 0, cp, -sp, 0, sp, cp}}, place};
}

/// Where a body goes from rest, and how often it is seen.
struct way {
  motion (*pose)(double);  ///< body to world at a time in frames
  int frames;
  double rate_hz;

  std::int64_t time_ns(int i) const {
    return static_cast<std::int64_t>(std::llround(1e9 / rate_hz)) * (i + 1);
  }
  /// Of the body, in its first frame.
  motion truth(int i) const { return pose(0).inverse() * pose(i); }
};
/// Up to 1.2 m/s and 1.2 rad/s. @param side 1 or -1
inline motion sway(double t, double side) {
  return pose_of(0.18 * side * (1 - std::cos(0.33 * t)), 0.08 * (1 - std::cos(0.4 * t)),
                 {0.15 * side * (1 - std::cos(0.35 * t)), -0.03 * (1 - std::cos(0.5 * t)),
                  0.4 * (1 - std::cos(0.15 * t))});
}
inline way const swaying{[](double t) { return sway(t, 1); }, 20, 20};
inline way const swaying_back{[](double t) { return sway(t, -1); }, 20, 20};
/// To the side from the start, as one camera needs it, and turning as soon as it has a map.
inline way const beginning{[](double t) {
                             double const on = t > 12 ? t - 12 : 0;
                             return pose_of(0.1 * (1 - std::cos(0.5 * on)),
                                            0.05 * (1 - std::cos(0.4 * on)),
                                            {0.03 * t, -0.01 * t, 0.02 * t});
                           },
                           50, 20};
/// Round a circle of 1.2 m, looking outwards, as in the tests of loops.
constexpr int lap = 42, start = 8;
inline way const circle{
    [](double t) {
      double const on = t < start ? t * t / (2 * start) : t - start / 2;
      double const yaw = 6.283185307179586 * on / lap;
      return pose_of(yaw, 0.1 * std::sin(2 * yaw),
                     {0.6 * std::sin(yaw), 0.1 * std::sin(3 * yaw), 1.2 + 0.6 * std::cos(yaw)});
    },
    lap + start / 2 + 12, 10};

/// A camera on a body.
struct mounted {
  any camera;
  motion T_cb = motion::identity();
  double readout_s = readout;
  bool depth = false;  ///< it has depth images
};

struct picture {
  test::room::image grey;
  std::vector<float> depth;
};
using pictures = std::vector<picture>;  ///< of a frame's cameras

/// What a camera sees whose rows are read one after the other.
inline picture see(mounted const& m, way const& along, int frame) {
  static auto const walls = test::room::make_walls(0);
  constexpr double texels = 50;
  picture out{test::room::image(at(width) * at(height)), {}};
  for (int v = 0; v < height; ++v) {
    double const late = m.readout_s * (v / (height - 1.0) - 0.5) * along.rate_hz;
    motion const T_cw = m.T_cb * along.pose(frame + late).inverse();
    ft::pose const T_wc = T_cw.inverse().cast<float>();
    for (int u = 0; u < width; ++u) {
      auto const h = test::room::look(m.camera, T_wc, static_cast<float>(u), static_cast<float>(v));
      double const p[3] = {h.point.x, h.point.y, h.point.z};
      out.grey[at(v) * at(width) + at(u)] = test::texture_at(
          walls[at(h.wall)], test::room::wall_side, (p[(h.wall / 2 + 1) % 3] + 20) * texels,
          (p[(h.wall / 2 + 2) % 3] + 20) * texels);
      if (m.depth) { out.depth.push_back(static_cast<float>((T_cw * h.point).z)); }
    }
  }
  return out;
}
inline std::vector<pictures> walk_of(std::vector<mounted> const& cameras,
                                     way const& along = swaying) {
  std::vector<pictures> all;
  for (int i = 0; i < along.frames; ++i) {
    pictures now;
    for (mounted const& m : cameras) { now.push_back(see(m, along, i)); }
    all.push_back(std::move(now));
  }
  return all;
}
inline ft::any_images images_of(pictures const& now) {
  ft::any_images images;
  int depths = 0;
  for (std::size_t i = 0; i < now.size(); ++i) {
    images.gray[i] = test::room::view(now[i].grey);
    if (now[i].depth.empty()) { continue; }
    ft::image_view<float const> const depth{now[i].depth.data(), width, height, width};
    images.depth = depth;
    images.depths[depths++] = depth;
  }
  return images;
}

/// How far tracked frames are from their places, metres: root of the mean square.
class error_of_path {
public:
  void add(motion const& found, motion const& truth) {
    found_.push_back(found);
    truth_.push_back(truth);
  }
  std::size_t frames() const { return found_.size(); }
  double metric() const {
    double sum = 0;
    for (std::size_t i = 0; i < frames(); ++i) { sum += squared(found_[i].t - truth_[i].t); }
    return root_of_mean(sum);
  }
  /// From the first one on, in the best unit.
  double scaled() const {
    auto const first = [](std::vector<motion> const& path, std::size_t i) {
      return (path[0].inverse() * path[i]).t;
    };
    double up = 0, down = 0, sum = 0;
    for (std::size_t i = 0; i < frames(); ++i) {
      up += ft::dot(first(found_, i), first(truth_, i));
      down += squared(first(found_, i));
    }
    for (std::size_t i = 0; i < frames(); ++i) {
      sum += squared(ft::scaled(first(found_, i), up / down) - first(truth_, i));
    }
    return root_of_mean(sum);
  }

private:
  static double squared(vector const& v) { return ft::dot(v, v); }
  double root_of_mean(double sum) const { return std::sqrt(sum / static_cast<double>(frames())); }
  std::vector<motion> found_, truth_;
};

/// Points on the walls, each with a descriptor of its own, as a rolling shutter sees them.
class marks {
public:
  marks() {
    test::generator random(3);
    for (int i = 0; i < 500; ++i) {
      double const side = i % 2 == 0 ? -1 : 1;
      auto const real = [&](float low, float high) {
        return static_cast<double>(random.real(low, high));
      };
      points_.push_back(i % 3 == 0   ? vector{3 * side, real(-1.5f, 1.5f), real(0, 6)}
                        : i % 3 == 1 ? vector{real(-3, 3), 1.5 * side, real(0, 6)}
                                     : vector{real(-3, 3), real(-1.5f, 1.5f), 6});
      for (int k = 0; k < 32; ++k) {
        bits_.push_back(static_cast<std::uint8_t>(random.below(256)));
      }
    }
  }
  struct seen {
    std::vector<float> positions, right_x, depth;
    std::vector<std::uint8_t> bits;
    ft::image_features view() const {
      ft::image_features f;
      f.count = static_cast<int>(depth.size());
      f.positions = positions.data();
      f.descriptors = bits.data();
      return f;
    }
  };
  seen by(any const& camera, motion const& T_cb, way const& along, int frame) const {
    seen s;
    auto const exact = camera.cast<double>();
    for (std::size_t i = 0; i < points_.size(); ++i) {
      vector p{};
      ft::projection<double> at_row{};
      double late = 0;
      for (int step = 0; step < 8; ++step) {
        p = T_cb * (along.pose(frame + late * along.rate_hz).inverse() * points_[i]);
        at_row = exact.project(p);
        late = readout * (at_row.pixel.y / (height - 1.0) - 0.5);
      }
      double const x = at_row.pixel.x, y = at_row.pixel.y;
      if (!at_row.valid || !(p.z > 0.3 && x > 3 && x < width - 4 && y > 3 && y < height - 4)) {
        continue;
      }
      s.positions.insert(s.positions.end(), {static_cast<float>(x), static_cast<float>(y)});
      s.depth.push_back(static_cast<float>(p.z));
      s.right_x.push_back(static_cast<float>(x - focal * baseline / p.z));
      s.bits.insert(s.bits.end(), bits_.begin() + static_cast<std::ptrdiff_t>(32 * i),
                    bits_.begin() + static_cast<std::ptrdiff_t>(32 * i + 32));
    }
    return s;
  }

private:
  std::vector<vector> points_;
  std::vector<std::uint8_t> bits_;
};

}  // namespace test::rolling
