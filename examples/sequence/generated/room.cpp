// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/generated/room.hpp"

#include <Eigen/Geometry>

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "examples/sequence/detail/random.hpp"
#include "examples/sequence/generated/constants.hpp"

namespace seq::generated {
namespace {

using detail::random_stream;

constexpr double half_x = 5.5;
constexpr double half_y = 4.5;
constexpr double room_height = 3.2;

void add_surface(std::vector<surface>& to, Eigen::Vector3d const& origin,
                 Eigen::Vector3d const& along, double width, Eigen::Vector3d const& up,
                 double height, double texels_per_m, double brightness) {
  surface s;
  s.origin = origin;
  s.along = along.normalized();
  s.up = up.normalized();
  s.normal = s.along.cross(s.up);
  s.width = width;
  s.height = height;
  s.texels_per_m = texels_per_m;
  s.brightness = brightness;
  to.push_back(std::move(s));
}

void add_box(std::vector<surface>& to, random_stream& random, double x, double y, double size_x,
             double size_y, double height, double degrees) {
  size_x *= random.uniform(0.93, 1.07);
  size_y *= random.uniform(0.93, 1.07);
  height *= random.uniform(0.93, 1.07);
  double const turn = radians(degrees + random.uniform(-6, 6));
  Eigen::Vector3d const a(std::cos(turn), std::sin(turn), 0);
  Eigen::Vector3d const b(-std::sin(turn), std::cos(turn), 0);
  Eigen::Vector3d const z = Eigen::Vector3d::UnitZ();
  Eigen::Vector3d const corner = Eigen::Vector3d(x, y, 0) - 0.5 * size_x * a - 0.5 * size_y * b;
  Eigen::Vector3d const opposite = corner + size_x * a + size_y * b;
  auto const bright = [&] { return random.uniform(0.75, 1.05); };
  add_surface(to, corner, a, size_x, z, height, 320, bright());
  add_surface(to, corner + size_x * a, b, size_y, z, height, 320, bright());
  add_surface(to, opposite, -a, size_x, z, height, 320, bright());
  add_surface(to, opposite - size_x * a, -b, size_y, z, height, 320, bright());
  add_surface(to, corner + height * z, a, size_x, b, size_y, 320, bright());
}

void add_panel(std::vector<surface>& to, random_stream& random, double x, double y, double width,
               double bottom, double top, double degrees) {
  double const turn = radians(degrees + random.uniform(-6, 6));
  Eigen::Vector3d const a(std::cos(turn), std::sin(turn), 0);
  Eigen::Vector3d const z = Eigen::Vector3d::UnitZ();
  Eigen::Vector3d const left = Eigen::Vector3d(x, y, bottom) - 0.5 * width * a;
  add_surface(to, left, a, width, z, top - bottom, 320, random.uniform(0.8, 1.05));
  add_surface(to, left + width * a, -a, width, z, top - bottom, 320, random.uniform(0.8, 1.05));
}

}  // namespace

std::vector<surface> furnish(std::uint64_t seed) {
  random_stream random(seed);
  std::vector<surface> out;
  // nearer surfaces first: the renderer rejects hidden ones sooner
  add_panel(out, random, 0.4, -1.5, 1.2, 0.0, 1.8, 8);
  add_panel(out, random, -1.8, 0.5, 1.1, 0.0, 2.0, 78);
  add_panel(out, random, 1.9, 1.2, 1.1, 0.0, 1.9, 130);
  add_panel(out, random, -0.4, 0.1, 0.9, 2.0, 2.8, 30);
  add_box(out, random, 0.6, 0.2, 1.0, 0.8, 0.9, 20);
  add_box(out, random, -0.9, -0.7, 0.6, 0.6, 1.6, 40);
  add_box(out, random, 1.6, -0.6, 0.5, 0.7, 1.2, 65);
  add_box(out, random, -0.5, 1.3, 0.5, 0.5, 2.2, 10);
  add_box(out, random, 4.9, -3.9, 0.7, 0.7, 1.1, 5);
  add_box(out, random, -4.9, -3.9, 0.6, 0.7, 1.7, 0);
  add_box(out, random, -4.9, 3.9, 0.7, 0.6, 0.8, -4);
  add_box(out, random, 4.9, 3.9, 0.6, 0.6, 2.4, 3);

  using vec = Eigen::Vector3d;
  vec const x = vec::UnitX();
  vec const y = vec::UnitY();
  vec const z = vec::UnitZ();
  // the normals (along x up) point into the room; the north wall is the one passed closely
  add_surface(out, vec(half_x, half_y, 0), -x, 2 * half_x, z, room_height, 512, 1.0);
  out.back().normal = -y;
  add_surface(out, vec(-half_x, -half_y, 0), x, 2 * half_x, z, room_height, 320, 0.95);
  out.back().normal = y;
  add_surface(out, vec(half_x, -half_y, 0), y, 2 * half_y, z, room_height, 320, 0.9);
  out.back().normal = -x;
  add_surface(out, vec(-half_x, half_y, 0), -y, 2 * half_y, z, room_height, 320, 1.03);
  out.back().normal = x;
  add_surface(out, vec(-half_x, -half_y, 0), x, 2 * half_x, y, 2 * half_y, 256, 0.85);
  out.back().normal = z;
  add_surface(out, vec(-half_x, half_y, room_height), x, 2 * half_x, -y, 2 * half_y, 256, 1.05);
  out.back().normal = -z;
  return out;
}

std::vector<surface> build_corridor(std::uint64_t seed, double length_m, double repeat_m) {
  using vec = Eigen::Vector3d;
  constexpr double begin = -5;
  constexpr double half_width = 2.5;
  constexpr double height = 3;
  vec const x = vec::UnitX();
  vec const y = vec::UnitY();
  vec const z = vec::UnitZ();
  random_stream random(seed);
  std::vector<surface> out;
  double const piece = repeat_m > 0 ? repeat_m : length_m - begin;
  std::array<double, 4> const bright = {random.uniform(0.85, 1.05), random.uniform(0.85, 1.05),
                                        random.uniform(0.75, 0.9), random.uniform(0.95, 1.05)};
  auto const add = [&](int paint, vec const& origin, vec const& along, double width, vec const& up,
                       double tall) {
    add_surface(out, origin, along, width, up, tall, 200, bright[static_cast<std::size_t>(paint)]);
    out.back().paint = paint;
  };
  for (double from = begin; from < length_m - 1e-9; from += piece) {
    double const to = from + piece;
    add(0, vec(from, half_width, 0), x, piece, z, height);
    add(1, vec(to, -half_width, 0), -x, piece, z, height);
    add(2, vec(from, -half_width, 0), x, piece, y, 2 * half_width);
    add(3, vec(from, half_width, height), x, piece, -y, 2 * half_width);
  }
  add_surface(out, vec(length_m, half_width, 0), -y, 2 * half_width, z, height, 200, 1.0);
  add_surface(out, vec(begin, -half_width, 0), y, 2 * half_width, z, height, 200, 1.0);
  return out;
}

double distance(surface const& s, Eigen::Vector3d const& point) {
  Eigen::Vector3d const d = point - s.origin;
  double const a = std::clamp(d.dot(s.along), 0.0, s.width);
  double const b = std::clamp(d.dot(s.up), 0.0, s.height);
  return (d - a * s.along - b * s.up).norm();
}

}  // namespace seq::generated
