// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/generated/route.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "examples/sequence/detail/random.hpp"
#include "examples/sequence/generated/constants.hpp"

namespace seq::generated {
namespace {

using detail::random_stream;

constexpr double lap_s = 19.2;
constexpr double knot_s = 0.05;

double ease5(double t) {
  t = std::clamp(t, 0.0, 1.0);
  return t * t * t * (10.0 + t * (6.0 * t - 15.0));
}

// From rest to rest: cubic ramps of `ramp` seconds, constant speed in between.
struct dash {
  double begin_s, end_s, from_m, to_m;
  static constexpr double ramp = 0.7;

  double top_speed() const { return (to_m - from_m) / (end_s - begin_s - ramp); }
  double speed(double t) const {
    double const edge = std::min(t - begin_s, end_s - t) / ramp;
    if (edge <= 0) { return 0; }
    double const e = std::min(edge, 1.0);
    return top_speed() * e * e * (3.0 - 2.0 * e);
  }
  double position(double t) const {
    double const length = end_s - begin_s;
    double const s = std::clamp(t - begin_s, 0.0, length);
    auto const ramped = [](double r) { return ramp * (r * r * r - 0.5 * r * r * r * r); };
    double travelled = 0;
    if (s < ramp) {
      travelled = ramped(s / ramp);
    } else if (s < length - ramp) {
      travelled = 0.5 * ramp + (s - ramp);
    } else {
      travelled = length - ramp - ramped((length - s) / ramp);
    }
    return from_m + top_speed() * travelled;
  }
};

// A closed Catmull-Rom curve by arc length.
class loop_curve {
public:
  explicit loop_curve(std::vector<Eigen::Vector3d> points) : points_(std::move(points)) {
    std::size_t const n = points_.size();
    double length = 0;
    Eigen::Vector3d last = points_[0];
    for (std::size_t i = 0; i < n; ++i) {
      starts_.push_back(length);
      for (int k = 0; k < steps; ++k) {
        Eigen::Vector3d const p = curve(i, static_cast<double>(k) / steps);
        length += (p - last).norm();
        last = p;
        table_.push_back(length);
      }
    }
    length += (points_[0] - last).norm();
    table_.push_back(length);
  }
  double length() const { return table_.back(); }
  double start_of(int point) const { return starts_[static_cast<std::size_t>(point)]; }
  Eigen::Vector3d at(double s) const {
    s = std::fmod(s, length());
    auto const next = std::upper_bound(table_.begin() + 1, table_.end() - 1, s);
    auto const cell = static_cast<std::size_t>(next - table_.begin()) - 1;
    double const inside = (s - table_[cell]) / std::max(table_[cell + 1] - table_[cell], 1e-12);
    double const t = (static_cast<double>(cell % steps) + std::clamp(inside, 0.0, 1.0)) / steps;
    return curve(cell / steps, t);
  }

private:
  static constexpr int steps = 200;
  Eigen::Vector3d curve(std::size_t i, double t) const {
    std::size_t const n = points_.size();
    auto const& a = points_[(i + n - 1) % n];
    auto const& b = points_[i % n];
    auto const& c = points_[(i + 1) % n];
    auto const& d = points_[(i + 2) % n];
    return 0.5 * (2.0 * b + (c - a) * t + (2.0 * a - 5.0 * b + 4.0 * c - d) * t * t +
                  (3.0 * b - a - 3.0 * c + d) * t * t * t);
  }
  std::vector<Eigen::Vector3d> points_;
  std::vector<double> starts_;
  std::vector<double> table_;
};

// Part of a turn's whole angle, there and back, at a share of its time. Smooth at both ends.
double there_and_back(double share) {
  double const s = std::sin(pi * std::clamp(share, 0.0, 1.0));
  return s * s;
}

std::vector<Eigen::Vector3d> waypoints(random_stream& random) {
  std::vector<Eigen::Vector3d> points = {{-3.8, -2.9, 1.40}, {-1.3, -3.2, 1.55}, {1.4, -3.1, 1.30},
                                         {3.6, -2.7, 1.50},  {4.3, -0.6, 1.75},  {4.1, 1.7, 1.50},
                                         {2.9, 3.3, 1.40},   {1.2, 3.7, 1.50},   {-1.2, 3.7, 1.60},
                                         {-2.4, 3.6, 1.50},  {-4.0, 2.6, 1.30},  {-4.4, 0.6, 1.40},
                                         {-3.0, -0.6, 1.60}, {-4.3, -1.8, 1.50}};
  for (std::size_t i = 0; i < points.size(); ++i) {
    bool const close = i >= 6 && i <= 9;  // the pass along the north wall keeps its distance
    points[i].x() += random.uniform(-0.1, 0.1);
    points[i].y() += close ? 0.0 : random.uniform(-0.1, 0.1);
    points[i].z() += random.uniform(-0.08, 0.08);
  }
  return points;
}

struct turn {
  double begin_s, end_s, degrees;
};
constexpr std::array<turn, 5> turns = {
    {{0.8, 4.5, 15}, {5.7, 7.8, 90}, {8.1, 9.7, -40}, {12.4, 15.8, 160}, {15.9, 19.0, 135}}};

double fast_yaw(double t, std::vector<fast_turn> const& fast) {
  double yaw = 0;
  for (auto const& f : fast) {
    yaw += f.degrees * there_and_back((t - f.when.from_s) / (f.when.to_s - f.when.from_s));
  }
  return yaw;
}

// Degrees, in the u-th second of a lap.
double yaw_at(double t, double u, double lap, std::vector<fast_turn> const& fast) {
  constexpr double first_yaw = 20;
  double yaw = first_yaw + 360 * lap;
  for (auto const& r : turns) { yaw += r.degrees * ease5((u - r.begin_s) / (r.end_s - r.begin_s)); }
  return yaw + fast_yaw(t, fast);
}

// Axes of a frame that looks along x, y left, z up, to those of a camera.
Eigen::Matrix3d camera_axes() {
  Eigen::Matrix3d out;
  out << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  return out;
}

}  // namespace

vec6 spline::at(double t, int order) const {
  double const knots = t / knot_s;
  auto const last = static_cast<double>(controls_.size() - 4);
  double const cell = std::clamp(std::floor(knots), 0.0, last);
  double const u = knots - cell;
  auto const k = static_cast<std::size_t>(cell);
  double const r = 1.0 - u;
  std::array<double, 4> w{};
  if (order == 0) {
    w = {r * r * r, 3 * u * u * u - 6 * u * u + 4, -3 * u * u * u + 3 * u * u + 3 * u + 1,
         u * u * u};
  } else if (order == 1) {
    w = {-3 * r * r, 9 * u * u - 12 * u, -9 * u * u + 6 * u + 3, 3 * u * u};
  } else {
    w = {6 * r, 18 * u - 12, -18 * u + 6, 6 * u};
  }
  double const scale =
      (order == 0 ? 1.0 : (order == 1 ? 1.0 / knot_s : 1.0 / (knot_s * knot_s))) / 6.0;
  return scale * (w[0] * controls_[k] + w[1] * controls_[k + 1] + w[2] * controls_[k + 2] +
                  w[3] * controls_[k + 3]);
}

spline plan_route(std::uint64_t seed, double duration_s, std::vector<fast_turn> const& fast) {
  random_stream random(seed);
  loop_curve const curve(waypoints(random));
  std::array<dash, 3> const dashes = {{{0.8, 4.8, 0.0, curve.start_of(3)},
                                       {5.6, 11.5, curve.start_of(3), curve.start_of(9)},
                                       {12.3, lap_s, curve.start_of(9), curve.length()}}};
  std::array<double, 8> phase{};
  for (auto& p : phase) { p = random.uniform(0, 2 * pi); }

  int const count = static_cast<int>(std::ceil(duration_s / knot_s)) + 6;
  std::vector<vec6> controls;
  for (int i = 0; i < count; ++i) {
    double const t = std::max(0, i - 1) * knot_s;
    double const lap = std::floor(t / lap_s);
    double const u = t - lap * lap_s;
    double s = 0;
    double speed = 0;
    for (auto const& d : dashes) {
      if (u >= d.begin_s) {
        s = d.position(u);
        speed = d.speed(u);
      }
    }
    double const yaw = yaw_at(t, u, lap, fast);
    // shaking of a hand-held camera, none at rest
    double const shake = speed / 2.0;
    auto const wave = [&](std::size_t n, double hertz) {
      return shake * std::sin(2 * pi * hertz * t + phase[n]);
    };
    Eigen::Vector3d const p = curve.at(s);
    vec6 c;
    c << p.x(), p.y(), p.z() + 0.035 * wave(0, 1.1) + 0.02 * wave(1, 1.9),
        radians(yaw + 1.5 * wave(2, 0.8)), radians(-6 + 5.0 * wave(3, 0.55) + 1.0 * wave(4, 1.7)),
        radians(5.0 * wave(5, 0.45) + 0.8 * wave(6, 2.1));
    controls.push_back(c);
  }
  return spline(std::move(controls));
}

double driven(double t, double speed) {
  constexpr double begin = 0.5;
  constexpr double ramp = 1.5;
  double const s = std::clamp((t - begin) / ramp, 0.0, 1.0);
  return speed * (ramp * (s * s * s - 0.5 * s * s * s * s) + std::max(t - begin - ramp, 0.0));
}

spline plan_drive(std::uint64_t seed, double duration_s, double speed, double look_aside,
                  std::vector<fast_turn> const& fast) {
  random_stream random(seed);
  std::array<double, 5> phase{};
  for (auto& p : phase) { p = random.uniform(0, 2 * pi); }
  int const count = static_cast<int>(std::ceil(duration_s / knot_s)) + 6;
  std::vector<vec6> controls;
  for (int i = 0; i < count; ++i) {
    double const t = std::max(0, i - 1) * knot_s;
    double const x = driven(t, speed);
    // it sways by what it has gone, not at rest
    double const sway = std::min(x, 1.0);
    auto const wave = [&](std::size_t n, double hertz) {
      return sway * std::sin(2 * pi * hertz * t + phase[n]);
    };
    vec6 c;
    c << x, 0.1 * wave(0, 0.4), 1.5 + 0.015 * wave(1, 1.3),
        radians(look_aside + fast_yaw(t, fast) + 1.5 * wave(2, 0.4)), radians(0.8 * wave(3, 1.1)),
        radians(0.6 * wave(4, 0.7));
    controls.push_back(c);
  }
  return spline(std::move(controls));
}

motion motion_at(spline const& route, double t) {
  vec6 const p = route.at(t, 0);
  vec6 const v = route.at(t, 1);
  vec6 const a = route.at(t, 2);
  using axis = Eigen::AngleAxisd;
  Eigen::Matrix3d const yaw = axis(p[3], Eigen::Vector3d::UnitZ()).toRotationMatrix();
  Eigen::Matrix3d const yaw_pitch = yaw * axis(-p[4], Eigen::Vector3d::UnitY()).toRotationMatrix();
  Eigen::Matrix3d const all = yaw_pitch * axis(p[5], Eigen::Vector3d::UnitX()).toRotationMatrix();
  motion m;
  m.T_world_camera.linear() = all * camera_axes();
  m.T_world_camera.translation() = p.head<3>();
  m.velocity = v.head<3>();
  m.acceleration = a.head<3>();
  Eigen::Vector3d const by_yaw = v[3] * Eigen::Vector3d::UnitZ();
  Eigen::Vector3d const by_both = by_yaw - v[4] * yaw.col(1);
  m.turning = by_both + v[5] * yaw_pitch.col(0);
  // the axes of pitch and roll are turned by what comes before them
  m.spin_up = a[3] * Eigen::Vector3d::UnitZ() - a[4] * yaw.col(1) + a[5] * yaw_pitch.col(0) -
              v[4] * by_yaw.cross(yaw.col(1)) + v[5] * by_both.cross(yaw_pitch.col(0));
  return m;
}

}  // namespace seq::generated
