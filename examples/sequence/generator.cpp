// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/generator.hpp"

#include "examples/sequence/detail/random.hpp"
#include "examples/sequence/detail/simulated_imu.hpp"
#include "examples/sequence/parallel.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <sstream>
#include <utility>

namespace seq {
namespace {

using detail::key;
using detail::mix;
using detail::random_stream;

constexpr double pi = 3.14159265358979323846;
constexpr double gravity = 9.81;
constexpr std::int64_t first_time_ns = 1'600'000'000'000'000'000;

double radians(double degrees) { return degrees * pi / 180.0; }

// ---- textures

struct mip_level {
  int width = 0;
  int height = 0;
  std::size_t stride = 0;  // width + 1: last column and row are repeated for bilinear reads
  std::vector<std::uint8_t> texels;

  std::uint8_t* row(int y) { return texels.data() + static_cast<std::size_t>(y) * stride; }
  std::uint8_t const* row(int y) const {
    return texels.data() + static_cast<std::size_t>(y) * stride;
  }
  void resize(int w, int h) {
    width = w;
    height = h;
    stride = static_cast<std::size_t>(w) + 1;
    texels.assign(stride * (static_cast<std::size_t>(h) + 1), 0);
  }
  void double_borders() {
    for (int y = 0; y < height; ++y) { row(y)[width] = row(y)[width - 1]; }
    std::memcpy(row(height), row(height - 1), stride);
  }
  // texel centres at integer coordinates
  float bilinear(float x, float y) const {
    x = std::min(std::max(x, 0.0f), static_cast<float>(width - 1));
    y = std::min(std::max(y, 0.0f), static_cast<float>(height - 1));
    int const ix = static_cast<int>(x);
    int const iy = static_cast<int>(y);
    float const fx = x - static_cast<float>(ix);
    float const fy = y - static_cast<float>(iy);
    std::uint8_t const* p = texels.data() + static_cast<std::size_t>(iy) * stride + ix;
    std::uint8_t const* q = p + stride;
    float const top = static_cast<float>(p[0]) + fx * static_cast<float>(p[1] - p[0]);
    float const bottom = static_cast<float>(q[0]) + fx * static_cast<float>(q[1] - q[0]);
    return top + fy * (bottom - top);
  }
};

// Position and width of a texture read; computed once for a few neighbouring pixels.
struct footprint {
  int level = 0;
  float blend = 0;  // towards level + 1
  int taps = 1;     // along the longer axis
  float step_x = 0, step_y = 0;
};

struct texture {
  float texels_per_m = 0;
  std::vector<mip_level> levels;

  // x, y in texels of level 0, from the texture's corner
  float sample(float x, float y, footprint const& f) const {
    float sum = 0;
    float const halved = 0.5f * static_cast<float>(f.taps - 1);
    float const scale = 1.0f / static_cast<float>(1 << f.level);
    for (int i = 0; i < f.taps; ++i) {
      float const offset = static_cast<float>(i) - halved;
      float const tx = (x + offset * f.step_x) * scale;
      float const ty = (y + offset * f.step_y) * scale;
      auto const level = static_cast<std::size_t>(f.level);
      float value = levels[level].bilinear(tx - 0.5f, ty - 0.5f);
      if (f.blend > 0.0f) {
        value += f.blend * (levels[level + 1].bilinear(0.5f * tx - 0.5f, 0.5f * ty - 0.5f) - value);
      }
      sum += value;
    }
    return sum / static_cast<float>(f.taps);
  }

  // (ax, ay), (bx, by): texels moved per pixel to the right and down
  footprint measure(float ax, float ay, float bx, float by) const {
    float const a2 = ax * ax + ay * ay;
    float const b2 = bx * bx + by * by;
    bool const a_longer = a2 > b2;
    float const major = std::sqrt(std::max(a_longer ? a2 : b2, 1e-12f));
    float const minor = std::max(std::abs(ax * by - ay * bx) / major, 1e-6f);
    footprint f;
    if (major > 1.0f) {
      f.taps = static_cast<int>(std::min(std::ceil(major / minor - 0.1f), 4.0f));
    }
    f.taps = std::max(f.taps, 1);
    f.step_x = (a_longer ? ax : bx) / static_cast<float>(f.taps);
    f.step_y = (a_longer ? ay : by) / static_cast<float>(f.taps);
    // a little sharper than the usual choice, which blurs
    float const lod = std::log2(major / static_cast<float>(f.taps)) - 0.3f;
    float const top = static_cast<float>(levels.size() - 1);
    float const clamped = std::min(std::max(lod, 0.0f), top);
    f.level = static_cast<int>(clamped);
    f.blend = clamped - static_cast<float>(f.level);
    if (f.blend < 0.03f || f.level + 1 >= static_cast<int>(levels.size())) { f.blend = 0; }
    return f;
  }
};

// Blends a convex polygon into the level.
template <std::size_t N>
void fill(mip_level& to, std::array<Eigen::Vector2f, N> const& corners, int grey, int weight_256) {
  float top = corners[0].y();
  float bottom = top;
  for (auto const& c : corners) {
    top = std::min(top, c.y());
    bottom = std::max(bottom, c.y());
  }
  int const first = std::max(0, static_cast<int>(std::ceil(top)));
  int const last = std::min(to.height - 1, static_cast<int>(std::floor(bottom)));
  for (int y = first; y <= last; ++y) {
    auto const fy = static_cast<float>(y);
    float left = std::numeric_limits<float>::max();
    float right = -left;
    for (std::size_t i = 0; i < N; ++i) {
      Eigen::Vector2f const& p = corners[i];
      Eigen::Vector2f const& q = corners[(i + 1) % N];
      if ((p.y() < fy && q.y() < fy) || (p.y() > fy && q.y() > fy) || p.y() == q.y()) { continue; }
      float const x = p.x() + (fy - p.y()) / (q.y() - p.y()) * (q.x() - p.x());
      left = std::min(left, x);
      right = std::max(right, x);
    }
    if (left > right) { continue; }
    int const begin = std::max(0, static_cast<int>(std::ceil(left)));
    int const end = std::min(to.width - 1, static_cast<int>(std::floor(right)));
    std::uint8_t* row = to.row(y);
    for (int x = begin; x <= end; ++x) {
      row[x] = static_cast<std::uint8_t>(row[x] + (((grey - row[x]) * weight_256) >> 8));
    }
  }
}

// Smooth random surface between 0 and 1, cells of `size` texels.
class value_noise {
public:
  value_noise(random_stream& random, int width, int height, float size) : inverse_(1.0f / size) {
    columns_ = static_cast<int>(static_cast<float>(width) * inverse_) + 2;
    int const rows = static_cast<int>(static_cast<float>(height) * inverse_) + 2;
    for (int i = 0; i < columns_ * rows; ++i) {
      lattice_.push_back(static_cast<float>(random.uniform()));
    }
  }
  float operator()(int x, int y) const {
    float const fx = static_cast<float>(x) * inverse_;
    float const fy = static_cast<float>(y) * inverse_;
    int const ix = static_cast<int>(fx);
    int const iy = static_cast<int>(fy);
    float const ux = ease(fx - static_cast<float>(ix));
    float const uy = ease(fy - static_cast<float>(iy));
    float const* p = lattice_.data() + static_cast<std::ptrdiff_t>(iy) * columns_ + ix;
    float const a = p[0] + ux * (p[1] - p[0]);
    float const b = p[columns_] + ux * (p[columns_ + 1] - p[columns_]);
    return a + uy * (b - a);
  }

private:
  static float ease(float t) { return t * t * (3.0f - 2.0f * t); }
  float inverse_;
  int columns_ = 0;
  std::vector<float> lattice_;
};

// Rectangles and triangles from a metre down to two centimetres, the smaller ones on top, so that
// corners are visible from every distance.
texture paint(std::uint64_t seed, double width_m, double height_m, double texels_per_m,
              double brightness) {
  random_stream random(seed);
  texture out;
  out.texels_per_m = static_cast<float>(texels_per_m);
  mip_level base;
  base.resize(std::max(2, static_cast<int>(std::lround(width_m * texels_per_m))),
              std::max(2, static_cast<int>(std::lround(height_m * texels_per_m))));
  std::fill(base.texels.begin(), base.texels.end(),
            static_cast<std::uint8_t>(random.uniform(90, 150)));

  struct octave {
    double size_m, cover;
    int weight;
  };
  constexpr std::array<octave, 8> octaves = {{{1.1, 0.55, 235},
                                              {0.55, 0.45, 230},
                                              {0.28, 0.32, 225},
                                              {0.14, 0.20, 215},
                                              {0.07, 0.11, 205},
                                              {0.036, 0.09, 195},
                                              {0.020, 0.07, 185},
                                              {0.011, 0.05, 165}}};
  for (auto const& o : octaves) {
    double const size = o.size_m * texels_per_m;
    // drawn from a stream of its own, so that the coarse picture does not depend on the resolution
    random_stream shapes(random.next());
    if (size < 3.5) { continue; }
    int const count =
        std::max(2, static_cast<int>(o.cover * width_m * height_m / (o.size_m * o.size_m)));
    for (int i = 0; i < count; ++i) {
      auto const centre_x = static_cast<float>(shapes.uniform(0, width_m) * texels_per_m);
      auto const centre_y = static_cast<float>(shapes.uniform(0, height_m) * texels_per_m);
      auto const w = static_cast<float>(size * shapes.uniform(0.5, 1.5) * 0.5);
      auto const h = static_cast<float>(size * shapes.uniform(0.5, 1.5) * 0.5);
      int const kind = shapes.below(10);
      double const turn = kind < 4 ? 0.0 : shapes.uniform(0, 2 * pi);
      auto const c = static_cast<float>(std::cos(turn));
      auto const s = static_cast<float>(std::sin(turn));
      // dark or light, rarely in between: strong edges
      int const grey = static_cast<int>(shapes.below(5) == 0   ? shapes.uniform(80, 150)
                                        : shapes.below(2) == 0 ? shapes.uniform(15, 85)
                                                               : shapes.uniform(145, 215));
      auto const at = [&](float x, float y) -> Eigen::Vector2f {
        return {centre_x + c * x - s * y, centre_y + s * x + c * y};
      };
      if (kind < 7) {
        fill<4>(base, {at(-w, -h), at(w, -h), at(w, h), at(-w, h)}, grey, o.weight);
      } else {
        fill<3>(base, {at(-w, -h), at(w, -0.6f * h), at(-0.2f * w, h)}, grey, o.weight);
      }
    }
  }

  value_noise const light(random, base.width, base.height, static_cast<float>(1.6 * texels_per_m));
  value_noise const dirt(random, base.width, base.height,
                         std::max(2.0f, static_cast<float>(0.09 * texels_per_m)));
  // [1 2 1] both ways: smooths the stairs of the polygons' edges
  mip_level smooth;
  smooth.resize(base.width, base.height);
  std::vector<int> line(static_cast<std::size_t>(base.width) + 2);
  auto const gain = static_cast<float>(brightness / 16.0);
  for (int y = 0; y < base.height; ++y) {
    std::uint8_t const* above = base.row(std::max(y - 1, 0));
    std::uint8_t const* here = base.row(y);
    std::uint8_t const* below = base.row(std::min(y + 1, base.height - 1));
    for (int x = 0; x < base.width; ++x) {
      line[static_cast<std::size_t>(x) + 1] = above[x] + 2 * here[x] + below[x];
    }
    line.front() = line[1];
    line.back() = line[static_cast<std::size_t>(base.width)];
    std::uint8_t* to = smooth.row(y);
    float tint = 0;
    for (int x = 0; x < base.width; ++x) {
      if ((x & 3) == 0) { tint = gain * (0.72f + 0.22f * light(x, y) + 0.16f * dirt(x, y)); }
      auto const i = static_cast<std::size_t>(x);
      float const value = static_cast<float>(line[i] + 2 * line[i + 1] + line[i + 2]) * tint;
      to[x] = static_cast<std::uint8_t>(std::min(value + 0.5f, 235.0f));
    }
  }
  smooth.double_borders();
  out.levels.push_back(std::move(smooth));

  while (out.levels.back().width > 2 && out.levels.back().height > 2) {
    mip_level const& from = out.levels.back();
    mip_level to;
    to.resize((from.width + 1) / 2, (from.height + 1) / 2);
    for (int y = 0; y < to.height; ++y) {
      std::uint8_t const* p = from.row(2 * y);  // the repeated borders make odd sizes safe
      std::uint8_t const* q = from.row(2 * y + 1);
      std::uint8_t* t = to.row(y);
      for (int x = 0; x < to.width; ++x) {
        t[x] =
            static_cast<std::uint8_t>((p[2 * x] + p[2 * x + 1] + q[2 * x] + q[2 * x + 1] + 2) >> 2);
      }
    }
    to.double_borders();
    out.levels.push_back(std::move(to));
  }
  return out;
}

// ---- the room

// A rectangle seen from its front: origin + s * along + t * up, 0 <= s <= width, 0 <= t <= height.
struct surface {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  Eigen::Vector3d along = Eigen::Vector3d::UnitX();
  Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitY();
  double width = 0;
  double height = 0;
  double texels_per_m = 0;
  double brightness = 1;
  texture skin;
};

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

double distance(surface const& s, Eigen::Vector3d const& point) {
  Eigen::Vector3d const d = point - s.origin;
  double const a = std::clamp(d.dot(s.along), 0.0, s.width);
  double const b = std::clamp(d.dot(s.up), 0.0, s.height);
  return (d - a * s.along - b * s.up).norm();
}

// ---- the route

using vec6 = Eigen::Matrix<double, 6, 1>;  // x y z yaw pitch roll

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

// Uniform cubic B-spline over time: continuous acceleration, and constant where its control points
// are.
class spline {
public:
  spline() = default;
  explicit spline(std::vector<vec6> controls) : controls_(std::move(controls)) {}

  // order: 0 value, 1 first, 2 second derivative by time
  vec6 at(double t, int order) const {
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

private:
  std::vector<vec6> controls_;
};

// Part of a turn's whole angle, there and back, at a share of its time. Smooth at both ends.
double there_and_back(double share) {
  double const s = std::sin(pi * std::clamp(share, 0.0, 1.0));
  return s * s;
}

spline plan_route(std::uint64_t seed, double duration_s, std::vector<fast_turn> const& fast) {
  random_stream random(seed);
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
  loop_curve const curve(points);
  std::array<dash, 3> const dashes = {{{0.8, 4.8, 0.0, curve.start_of(3)},
                                       {5.6, 11.5, curve.start_of(3), curve.start_of(9)},
                                       {12.3, lap_s, curve.start_of(9), curve.length()}}};
  struct turn {
    double begin_s, end_s, degrees;
  };
  std::array<turn, 5> const turns = {
      {{0.8, 4.5, 15}, {5.7, 7.8, 90}, {8.1, 9.7, -40}, {12.4, 15.8, 160}, {15.9, 19.0, 135}}};
  constexpr double first_yaw = 20;

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
    double yaw = first_yaw + 360 * lap;
    for (auto const& r : turns) {
      yaw += r.degrees * ease5((u - r.begin_s) / (r.end_s - r.begin_s));
    }
    for (auto const& f : fast) {
      yaw += f.degrees * there_and_back((t - f.when.from_s) / (f.when.to_s - f.when.from_s));
    }
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

// Axes of a frame that looks along x, y left, z up, to those of a camera.
Eigen::Matrix3d camera_axes() {
  Eigen::Matrix3d out;
  out << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  return out;
}

struct motion {
  Eigen::Isometry3d T_world_camera = Eigen::Isometry3d::Identity();
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();      // world, of the camera
  Eigen::Vector3d acceleration = Eigen::Vector3d::Zero();  // world, of the camera
  Eigen::Vector3d turning = Eigen::Vector3d::Zero();       // angular velocity, world
  Eigen::Vector3d spin_up = Eigen::Vector3d::Zero();       // angular acceleration, world
};

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

// ---- cameras

constexpr double fisheye_fade = 1.42;   // rad: darkening starts
constexpr double fisheye_limit = 1.50;  // rad: black from here

double kannala_brandt(std::vector<double> const& k, double angle) {
  double const a2 = angle * angle;
  return angle * (1 + a2 * (k[0] + a2 * (k[1] + a2 * (k[2] + a2 * k[3]))));
}

std::optional<Eigen::Vector3d> unproject(camera_intrinsics const& c, double u, double v) {
  double const x = (u - c.cx) / c.fx;
  double const y = (v - c.cy) / c.fy;
  if (c.model == lens::pinhole) { return Eigen::Vector3d(x, y, 1); }
  double const radius = std::hypot(x, y);
  if (radius < 1e-12) { return Eigen::Vector3d(0, 0, 1); }
  double angle = std::min(radius, fisheye_limit);
  for (int i = 0; i < 20; ++i) {
    double const a2 = angle * angle;
    auto const& k = c.distortion;
    double const slope = 1 + a2 * (3 * k[0] + a2 * (5 * k[1] + a2 * (7 * k[2] + a2 * 9 * k[3])));
    double const step = (kannala_brandt(k, angle) - radius) / slope;
    angle -= step;
    if (std::abs(step) < 1e-14) { break; }
  }
  if (!(angle < fisheye_limit)) { return std::nullopt; }
  double const side = std::sin(angle) / radius;
  return Eigen::Vector3d(side * x, side * y, std::cos(angle));
}

// Rays of a block of pixels lie between four planes through the camera.
struct tile {
  int x0 = 0, x1 = 0, y0 = 0, y1 = 0;  // pixels, end excluded
  bool any = false;
  std::array<Eigen::Vector3f, 4> outward;
};

struct view {
  camera_intrinsics camera;
  Eigen::Isometry3d T_left_this = Eigen::Isometry3d::Identity();
  std::vector<Eigen::Vector3f> rays;  // any length; zero outside the lens' range
  std::vector<float> light;           // factor by vignetting; 0 outside the lens' range
  std::vector<tile> tiles;
};

view make_view(camera_intrinsics const& camera, Eigen::Isometry3d const& T_left_this,
               bool vignetting) {
  constexpr int side = 16;
  view out;
  out.camera = camera;
  out.T_left_this = T_left_this;
  int const w = camera.width;
  int const h = camera.height;
  auto const count = static_cast<std::size_t>(w) * static_cast<std::size_t>(h);
  out.rays.assign(count, Eigen::Vector3f::Zero());
  out.light.assign(count, 0.0f);
  double const corner = std::hypot(0.5 * w, 0.5 * h);
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      auto const ray = unproject(camera, x, y);
      if (!ray) { continue; }
      auto const i =
          static_cast<std::size_t>(y) * static_cast<std::size_t>(w) + static_cast<std::size_t>(x);
      out.rays[i] = ray->cast<float>();
      double light = 1;
      if (vignetting) {
        double const r = std::hypot(x - camera.cx, y - camera.cy) / corner;
        light = 1 - 0.2 * r * r;
      }
      if (camera.model == lens::kannala_brandt) {
        double const angle = std::atan2(ray->head<2>().norm(), ray->z());
        double const f =
            std::clamp((fisheye_limit - angle) / (fisheye_limit - fisheye_fade), 0.0, 1.0);
        light *= f * f * (3 - 2 * f);
      }
      out.light[i] = static_cast<float>(light);
    }
  }
  for (int y = 0; y < h; y += side) {
    for (int x = 0; x < w; x += side) {
      tile t;
      t.x0 = x;
      t.x1 = std::min(x + side, w);
      t.y0 = y;
      t.y1 = std::min(y + side, h);
      Eigen::Vector3d axis = Eigen::Vector3d::Zero();
      auto const each = [&](auto const& use) {
        for (int v = t.y0; v < t.y1; ++v) {
          for (int u = t.x0; u < t.x1; ++u) {
            auto const& ray = out.rays[static_cast<std::size_t>(v) * static_cast<std::size_t>(w) +
                                       static_cast<std::size_t>(u)];
            if (ray.squaredNorm() > 0) { use(Eigen::Vector3d(ray.cast<double>().normalized())); }
          }
        }
      };
      each([&](Eigen::Vector3d const& ray) {
        axis += ray;
        t.any = true;
      });
      if (t.any) {
        axis.normalize();
        Eigen::Vector3d const right = axis.unitOrthogonal();
        Eigen::Vector3d const down = axis.cross(right);
        std::array<double, 4> limit = {1e9, -1e9, 1e9, -1e9};
        each([&](Eigen::Vector3d const& ray) {
          double const a = ray.dot(axis);
          limit[0] = std::min(limit[0], ray.dot(right) / a);
          limit[1] = std::max(limit[1], ray.dot(right) / a);
          limit[2] = std::min(limit[2], ray.dot(down) / a);
          limit[3] = std::max(limit[3], ray.dot(down) / a);
        });
        // half a pixel more on each side, for the samples between pixels
        double const slack = std::max({limit[1] - limit[0], limit[3] - limit[2], 1e-3}) / 8;
        t.outward[0] = ((limit[0] - slack) * axis - right).cast<float>();
        t.outward[1] = (right - (limit[1] + slack) * axis).cast<float>();
        t.outward[2] = ((limit[2] - slack) * axis - down).cast<float>();
        t.outward[3] = (down - (limit[3] + slack) * axis).cast<float>();
      }
      out.tiles.push_back(t);
    }
  }
  return out;
}

// ---- rendering

// A surface in the camera's frame. A ray r meets the plane at r / (inverse . r).
struct facing {
  Eigen::Vector3f inverse;
  Eigen::Vector3f along, up;
  float s0 = 0, t0 = 0;
  float width = 0, height = 0;
  std::array<Eigen::Vector3f, 4> corners;
  texture const* skin = nullptr;
};

struct hit {
  int id = -1;  // into the list of facing surfaces
  float s = 0, t = 0;
};

hit nearest(std::vector<facing> const& surfaces, std::vector<int> const& candidates,
            Eigen::Vector3f const& ray) {
  hit best;
  float best_inverse = 0;
  for (int id : candidates) {
    facing const& f = surfaces[static_cast<std::size_t>(id)];
    float const inverse = f.inverse.dot(ray);
    if (!(inverse > best_inverse)) { continue; }
    float const depth = 1.0f / inverse;
    float const s = depth * f.along.dot(ray) - f.s0;
    float const t = depth * f.up.dot(ray) - f.t0;
    if (s < 0 || t < 0 || s > f.width || t > f.height) { continue; }
    best_inverse = inverse;
    best = {id, s, t};
  }
  return best;
}

footprint measure(facing const& f, Eigen::Vector3f const& ray, Eigen::Vector3f const& right,
                  Eigen::Vector3f const& down) {
  float const k = f.skin->texels_per_m;
  auto const at = [&](Eigen::Vector3f const& r, float& s, float& t) {
    float const depth = k / std::max(f.inverse.dot(r), 1e-4f);
    s = depth * f.along.dot(r);
    t = depth * f.up.dot(r);
  };
  float s = 0, t = 0, sr = 0, tr = 0, sd = 0, td = 0;
  at(ray, s, t);
  at(right, sr, tr);
  at(down, sd, td);
  return f.skin->measure(sr - s, tr - t, sd - s, td - t);
}

float shade(facing const& f, hit const& h, footprint const& width) {
  float const k = f.skin->texels_per_m;
  return f.skin->sample(h.s * k, h.t * k, width);
}

std::vector<facing> face(std::vector<surface> const& surfaces,
                         Eigen::Isometry3d const& T_world_camera) {
  Eigen::Isometry3d const T_camera_world = T_world_camera.inverse();
  Eigen::Matrix3d const R = T_camera_world.linear();
  std::vector<facing> out;
  for (surface const& s : surfaces) {
    Eigen::Vector3d const origin = T_camera_world * s.origin;
    Eigen::Vector3d const normal = R * s.normal;
    double const offset = normal.dot(origin);
    if (offset > -1e-6) { continue; }  // seen from behind
    facing f;
    f.inverse = (normal / offset).cast<float>();
    Eigen::Vector3d const along = R * s.along;
    Eigen::Vector3d const up = R * s.up;
    f.along = along.cast<float>();
    f.up = up.cast<float>();
    f.s0 = static_cast<float>(along.dot(origin));
    f.t0 = static_cast<float>(up.dot(origin));
    f.width = static_cast<float>(s.width);
    f.height = static_cast<float>(s.height);
    f.corners = {origin.cast<float>(), (origin + s.width * along).cast<float>(),
                 (origin + s.width * along + s.height * up).cast<float>(),
                 (origin + s.height * up).cast<float>()};
    f.skin = &s.skin;
    out.push_back(f);
  }
  return out;
}

void find_candidates(std::vector<facing> const& surfaces, tile const& t, std::vector<int>& out) {
  out.clear();
  for (std::size_t i = 0; i < surfaces.size(); ++i) {
    bool outside = false;
    for (auto const& plane : t.outward) {
      bool all = true;
      for (auto const& c : surfaces[i].corners) { all = all && plane.dot(c) > 0; }
      outside = outside || all;
    }
    if (!outside) { out.push_back(static_cast<int>(i)); }
  }
}

// Quantiles of the normal distribution; a uniform index gives a normal variate.
std::vector<float> normal_table() {
  constexpr int size = 4096;
  std::vector<float> out(size);
  for (int i = size / 2; i < size; ++i) {
    double const p = (i + 0.5) / size;
    double low = 0;
    double high = 6;
    for (int k = 0; k < 30; ++k) {
      double const middle = 0.5 * (low + high);
      (1 - 0.5 * std::erfc(middle / std::sqrt(2.0)) < p ? low : high) = middle;
    }
    out[static_cast<std::size_t>(i)] = static_cast<float>(low);
    out[static_cast<std::size_t>(size - 1 - i)] = static_cast<float>(-low);
  }
  return out;
}

image expose(view const& v, std::vector<float> const& radiance, float gain, float sigma,
             std::vector<float> const& normal, std::uint64_t noise_key) {
  image out;
  out.width = v.camera.width;
  out.height = v.camera.height;
  out.pixels.resize(radiance.size());
  std::uint64_t bits = 0;
  for (std::size_t i = 0; i < radiance.size(); ++i) {
    if ((i & 3u) == 0) { bits = mix(noise_key + i * 0x9e3779b97f4a7c15ULL); }
    float const noise = sigma * normal[bits & 4095u];
    bits >>= 16;
    float const rounded = radiance[i] * (gain * v.light[i]) + noise + 0.5f;
    out.pixels[i] = static_cast<std::uint8_t>(std::min(std::max(rounded, 0.0f), 255.0f));
  }
  return out;
}

std::vector<float> trace(view const& v, std::vector<surface> const& surfaces,
                         Eigen::Isometry3d const& T_world_camera) {
  std::vector<facing> const visible = face(surfaces, T_world_camera);
  int const w = v.camera.width;
  int const h = v.camera.height;
  auto const at = [w](int x, int y) {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(w) + static_cast<std::size_t>(x);
  };
  // one pixel away in x and y, inwards at the border of the image and of the lens
  auto const neighbour = [&](int x, int y, int dx, int dy) {
    Eigen::Vector3f const& here = v.rays[at(x, y)];
    if (x + dx < w && y + dy < h && v.rays[at(x + dx, y + dy)].squaredNorm() > 0) {
      return v.rays[at(x + dx, y + dy)];
    }
    if (x >= dx && y >= dy && v.rays[at(x - dx, y - dy)].squaredNorm() > 0) {
      return Eigen::Vector3f(2.0f * here - v.rays[at(x - dx, y - dy)]);
    }
    return here;
  };

  std::vector<float> out(v.rays.size(), 0.0f);
  std::vector<std::int16_t> ids(v.rays.size(), -1);
  std::vector<int> candidates;
  for (tile const& t : v.tiles) {
    if (!t.any) { continue; }
    find_candidates(visible, t, candidates);
    for (int y = t.y0; y < t.y1; ++y) {
      int measured = -1;
      footprint width;
      for (int x = t.x0; x < t.x1; ++x) {
        if ((x & 3) == 0) { measured = -1; }
        std::size_t const i = at(x, y);
        if (v.light[i] <= 0.0f) { continue; }
        hit const found = nearest(visible, candidates, v.rays[i]);
        if (found.id < 0) { continue; }
        facing const& f = visible[static_cast<std::size_t>(found.id)];
        if (found.id != measured) {
          width = measure(f, v.rays[i], neighbour(x, y, 1, 0), neighbour(x, y, 0, 1));
          measured = found.id;
        }
        out[i] = shade(f, found, width);
        ids[i] = static_cast<std::int16_t>(found.id);
      }
    }
  }

  // outlines: four samples a pixel if neighbours see different surfaces
  for (tile const& t : v.tiles) {
    bool ready = false;
    for (int y = t.y0; y < t.y1; ++y) {
      for (int x = t.x0; x < t.x1; ++x) {
        std::size_t const i = at(x, y);
        std::int16_t const id = ids[i];
        if (id < 0) { continue; }
        bool const edge = (x > 0 && ids[i - 1] != id) || (x + 1 < w && ids[i + 1] != id) ||
                          (y > 0 && ids[at(x, y - 1)] != id) ||
                          (y + 1 < h && ids[at(x, y + 1)] != id);
        if (!edge) { continue; }
        if (!ready) {
          find_candidates(visible, t, candidates);
          ready = true;
        }
        Eigen::Vector3f const ray = v.rays[i];
        Eigen::Vector3f const right = neighbour(x, y, 1, 0);
        Eigen::Vector3f const down = neighbour(x, y, 0, 1);
        float sum = 0;
        int samples = 0;
        for (int k = 0; k < 4; ++k) {
          float const du = (k & 1) != 0 ? 0.25f : -0.25f;
          float const dv = (k & 2) != 0 ? 0.25f : -0.25f;
          Eigen::Vector3f const shifted = ray + du * (right - ray) + dv * (down - ray);
          hit const found = nearest(visible, candidates, shifted);
          if (found.id < 0) { continue; }
          facing const& f = visible[static_cast<std::size_t>(found.id)];
          sum += shade(f, found, measure(f, ray, right, down));
          ++samples;
        }
        if (samples > 0) { out[i] = sum / static_cast<float>(samples); }
      }
    }
  }
  return out;
}

// ---- options

template <typename Value>
void check(char const* name, Value value, Value low, Value high, bool zero_is_default = false) {
  if (zero_is_default && value == Value(0)) { return; }
  if (value >= low && value <= high) { return; }  // NaN fails
  std::ostringstream text;
  text << "generator: " << name << " is " << value << "; must be " << low << " to " << high;
  if (zero_is_default) { text << ", or 0 for the default"; }
  throw error(text.str());
}

void check_span(char const* name, time_span const& s) {
  check((std::string(name) + ": from_s").c_str(), s.from_s, 0.0, 1e6);
  if (!(s.to_s > s.from_s && s.to_s <= 1e6)) {
    std::ostringstream text;
    text << "generator: " << name << ": to_s is " << s.to_s << "; must be above " << s.from_s
         << " and at most 1e+06";
    throw error(text.str());
  }
}

generator_options complete(generator_options o) {
  check("width", o.width, 32, 4096, true);
  check("height", o.height, 32, 4096, true);
  check("frames", o.frames, 1, 100000);
  check("fps", o.fps, 1.0, 1000.0);
  check("noise_sigma", o.noise_sigma, 0.0, 50.0);
  check("baseline", o.baseline, 0.02, 0.3, true);
  check("imu_rate", o.imu_rate, 10.0, 10000.0);
  check("imu_noise_scale", o.imu_noise_scale, 0.0, 100.0);
  check("imu.gyro", o.imu.gyro, 0.0, 1.0);
  check("imu.accel", o.imu.accel, 0.0, 10.0);
  check("imu.gyro_walk", o.imu.gyro_walk, 0.0, 1.0);
  check("imu.accel_walk", o.imu.accel_walk, 0.0, 10.0);
  check("gyro_bias", o.gyro_bias, 0.0, 1.0);
  check("accel_bias", o.accel_bias, 0.0, 10.0);
  check("exposure_s", o.exposure_s, 0.0, 0.1);
  for (auto const& s : o.blind) { check_span("blind", s); }
  for (auto const& s : o.dropped) { check_span("dropped", s); }
  for (auto const& f : o.fast_turns) {
    check_span("fast_turns", f.when);
    check("fast_turns: degrees", f.degrees, -360.0, 360.0);
    // the spline's knots must resolve it
    check("fast_turns: length in seconds", f.when.to_s - f.when.from_s, 0.2, 1e6);
  }
  check("threads", o.threads, 1, 256, true);
  if (o.rig != rig_kind::pinhole && o.rig != rig_kind::fisheye) {
    throw error("generator: unknown rig " + std::to_string(static_cast<int>(o.rig)));
  }
  bool const fisheye = o.rig == rig_kind::fisheye;
  int const width = fisheye ? 512 : 752;
  int const height = fisheye ? 512 : 480;
  if (o.width == 0 && o.height == 0) {
    o.width = width;
    o.height = height;
  } else if (o.height == 0) {
    o.height = std::max(32, (o.width * height + width / 2) / width);
  } else if (o.width == 0) {
    o.width = std::min(4096, (o.height * width + height / 2) / height);
  }
  if (o.baseline == 0) { o.baseline = fisheye ? 0.101 : 0.11; }
  return o;
}

Eigen::Matrix3d small_rotation(double x, double y, double z) {
  Eigen::Vector3d const r(radians(x), radians(y), radians(z));
  return Eigen::AngleAxisd(r.norm(), r.normalized()).toRotationMatrix();
}

stereo_rig make_rig(generator_options const& o) {
  stereo_rig rig;
  rig.fps = o.fps;
  auto const lens_of = [&](double fx, double fy, double shift_x, double shift_y, lens model,
                           std::vector<double> distortion) {
    camera_intrinsics c;
    c.model = model;
    c.width = o.width;
    c.height = o.height;
    c.fx = fx;
    c.fy = fy;
    c.cx = 0.5 * (o.width - 1) + shift_x;
    c.cy = 0.5 * (o.height - 1) + shift_y;
    c.distortion = std::move(distortion);
    return c;
  };
  if (o.rig == rig_kind::pinhole) {
    double const scale = o.width / 752.0;
    rig.left = lens_of(435 * scale, 435 * scale, -8.3 * scale, 12.4 * scale, lens::pinhole, {});
    rig.right = rig.left;
    rig.T_left_right.translation() = Eigen::Vector3d(o.baseline, 0, 0);
  } else {
    double const scale = o.width / 512.0;
    rig.left = lens_of(190.98 * scale, 190.97 * scale, -0.57 * scale, 1.39 * scale,
                       lens::kannala_brandt, {0.0034, 0.0007, -0.0020, 0.0002});
    rig.right = lens_of(190.44 * scale, 190.43 * scale, -2.91 * scale, -0.36 * scale,
                        lens::kannala_brandt, {0.0031, 0.0011, -0.0023, 0.0003});
    rig.T_left_right.linear() = small_rotation(-0.25, 1.1, 0.4);
    rig.T_left_right.translation() =
        o.baseline * Eigen::Vector3d(0.101, -0.0021, -0.0012).normalized();
  }
  rig.T_body_left.linear() =
      Eigen::AngleAxisd(pi / 2, Eigen::Vector3d::UnitZ()).toRotationMatrix() *
      small_rotation(1.4, 0.3, -0.8);
  rig.T_body_left.translation() = Eigen::Vector3d(-0.021, -0.064, 0.0098);
  return rig;
}

}  // namespace

struct generator::impl {
  generator_options options;
  stereo_rig rig;
  std::vector<surface> surfaces;
  spline route;
  std::array<view, 2> views;
  std::vector<float> normal;
  std::vector<std::int64_t> imu_times;
  double gain_phase = 0;

  void check_frame(int i) const {
    if (i < 0 || i >= options.frames) {
      throw error("generator: frame " + std::to_string(i) + "; must be 0 to " +
                  std::to_string(options.frames - 1));
    }
  }
  void check_camera(int c) const {
    if (c != 0 && c != 1) {
      throw error("generator: camera " + std::to_string(c) + "; must be 0 or 1");
    }
  }
  std::int64_t time_ns(int i) const {
    return first_time_ns + static_cast<std::int64_t>(std::llround(i * 1e9 / options.fps));
  }
  static double seconds(std::int64_t time) {
    return static_cast<double>(time - first_time_ns) * 1e-9;
  }
  motion camera_motion(std::int64_t time) const { return motion_at(route, seconds(time)); }
  Eigen::Isometry3d pose(int i, int camera) const {
    return camera_motion(time_ns(i)).T_world_camera *
           views[static_cast<std::size_t>(camera)].T_left_this;
  }
  /// @param T_left_other see generator::render @param first_noise number of the first image's noise
  stereo_frame render(int i, Eigen::Isometry3d const& T_left_other, std::size_t first_noise) const;
  bool within(std::vector<time_span> const& spans, int i) const {
    double const t = seconds(time_ns(i));
    return std::any_of(spans.begin(), spans.end(), [t](time_span const& s) {
      return t >= s.from_s - 1e-9 && t < s.to_s - 1e-9;
    });
  }
  // Instants that an image is the mean of, no more than about a pixel apart; 1 without exposure.
  int exposure_steps(double t) const {
    motion const m = motion_at(route, t);
    double const nearest_m = 0.8;
    double const pixels_per_s = rig.left.fx * (m.turning.norm() + m.velocity.norm() / nearest_m);
    return static_cast<int>(std::clamp(std::ceil(pixels_per_s * options.exposure_s), 1.0, 64.0));
  }
  // Mean light at each pixel of a camera during the exposure of frame i.
  std::vector<float> collect_light(int i, view const& v,
                                   Eigen::Isometry3d const& T_left_other) const;
  // Gyro and accelerometer without bias and noise, body frame.
  imu_sample ideal_imu(std::int64_t time) const {
    motion const m = camera_motion(time);
    Eigen::Isometry3d const T_world_body = m.T_world_camera * rig.T_body_left.inverse();
    Eigen::Matrix3d const R_body_world = T_world_body.linear().transpose();
    Eigen::Vector3d const arm = T_world_body.translation() - m.T_world_camera.translation();
    Eigen::Vector3d const acceleration =
        m.acceleration + m.spin_up.cross(arm) + m.turning.cross(m.turning.cross(arm));
    return {time, R_body_world * m.turning,
            R_body_world * (acceleration + Eigen::Vector3d(0, 0, gravity))};
  }
  detail::simulated_imu imu_errors() const {
    imu_noise n = options.imu;
    for (double* d : {&n.gyro, &n.accel, &n.gyro_walk, &n.accel_walk}) {
      *d *= options.imu_noise_scale;
    }
    return {n, options.imu_rate, options.gyro_bias * options.imu_noise_scale,
            options.accel_bias * options.imu_noise_scale, options.seed};
  }
};

generator::generator(generator_options const& options) : impl_(std::make_unique<impl>()) {
  impl& m = *impl_;
  m.options = complete(options);
  auto const& o = m.options;
  m.rig = make_rig(o);
  m.surfaces = furnish(key(o.seed, 1));
  double const duration = (o.frames - 1) / o.fps;
  m.route = plan_route(key(o.seed, 2), duration + 0.1, o.fast_turns);
  m.views[0] = make_view(m.rig.left, Eigen::Isometry3d::Identity(), o.vignetting);
  m.views[1] = make_view(m.rig.right, m.rig.T_left_right, o.vignetting);
  m.normal = normal_table();
  m.gain_phase = random_stream(key(o.seed, 3)).uniform(0, 2 * pi);
  std::int64_t const last = m.time_ns(o.frames - 1);
  for (std::int64_t i = 0;; ++i) {
    auto const time = first_time_ns + static_cast<std::int64_t>(
                                          std::llround(static_cast<double>(i) * 1e9 / o.imu_rate));
    if (time > last) { break; }
    m.imu_times.push_back(time);
  }

  // small pictures need no fine textures
  double const detail = std::clamp(m.rig.left.fx / 435.0, 0.2, 1.5);
  int const count = static_cast<int>(m.surfaces.size());
  parallel_for(count, o.threads, [&](int k) {
    // the largest surfaces come last in the list: start with them
    auto const i = static_cast<std::size_t>(count - 1 - k);
    surface& s = m.surfaces[i];
    s.skin = paint(key(o.seed, 4, i), s.width, s.height, s.texels_per_m * detail, s.brightness);
  });
}

generator::generator(generator&&) noexcept = default;
generator& generator::operator=(generator&&) noexcept = default;
generator::~generator() = default;

generator_options const& generator::options() const { return impl_->options; }
stereo_rig const& generator::rig() const { return impl_->rig; }
int generator::size() const { return impl_->options.frames; }

std::int64_t generator::time_ns(int i) const {
  impl_->check_frame(i);
  return impl_->time_ns(i);
}

Eigen::Isometry3d generator::T_world_camera(int i) const {
  impl_->check_frame(i);
  return impl_->pose(i, 0);
}

stereo_frame generator::render(int i) const {
  return impl_->render(i, Eigen::Isometry3d::Identity(), 0);
}

stereo_frame generator::render(int i, Eigen::Isometry3d const& T_left_other) const {
  return impl_->render(i, T_left_other, 2);
}

bool generator::dropped(int i) const {
  impl_->check_frame(i);
  return impl_->within(impl_->options.dropped, i);
}

std::vector<float> generator::impl::collect_light(int i, view const& v,
                                                  Eigen::Isometry3d const& T_left_other) const {
  if (within(options.blind, i)) { return std::vector<float>(v.rays.size(), 0.0f); }
  double const t = seconds(time_ns(i));
  auto const at = [&](double when) {
    return trace(
        v, surfaces,
        motion_at(route, std::max(when, 0.0)).T_world_camera * T_left_other * v.T_left_this);
  };
  int const count = exposure_steps(t);
  std::vector<float> sum = at(t + options.exposure_s * (0.5 / count - 0.5));
  for (int k = 1; k < count; ++k) {
    auto const more = at(t + options.exposure_s * ((k + 0.5) / count - 0.5));
    for (std::size_t p = 0; p < sum.size(); ++p) { sum[p] += more[p]; }
  }
  for (float& value : sum) { value /= static_cast<float>(count); }
  return sum;
}

stereo_frame generator::impl::render(int i, Eigen::Isometry3d const& T_left_other,
                                     std::size_t first_noise) const {
  impl const& m = *this;
  m.check_frame(i);
  double const t = impl::seconds(m.time_ns(i));
  double const gain =
      m.options.exposure_change ? 1.0 + 0.2 * std::sin(2 * pi * t / 6.5 + m.gain_phase) : 1.0;
  stereo_frame out;
  out.time_ns = m.time_ns(i);
  for (std::size_t c = 0; c < 2; ++c) {
    view const& v = m.views[c];
    auto const radiance = m.collect_light(i, v, T_left_other);
    (c == 0 ? out.left : out.right) = expose(
        v, radiance, static_cast<float>(gain), static_cast<float>(m.options.noise_sigma), m.normal,
        key(m.options.seed, 1000 + static_cast<std::uint64_t>(i), first_noise + c));
  }
  return out;
}

trajectory generator::ground_truth() const {
  trajectory out;
  for (int i = 0; i < size(); ++i) { out.push_back({impl_->time_ns(i), impl_->pose(i, 0)}); }
  return out;
}

std::vector<body_state> generator::body_ground_truth() const {
  impl const& m = *impl_;
  auto const biases = m.imu_errors().biases(m.imu_times.size());
  std::vector<std::int64_t> times = m.imu_times;
  for (int i = 0; i < size(); ++i) { times.push_back(m.time_ns(i)); }
  std::sort(times.begin(), times.end());
  times.erase(std::unique(times.begin(), times.end()), times.end());

  std::vector<body_state> out;
  std::size_t imu = 0;
  for (std::int64_t time : times) {
    while (imu + 1 < m.imu_times.size() && m.imu_times[imu + 1] <= time) { ++imu; }
    motion const at = m.camera_motion(time);
    body_state s;
    s.time_ns = time;
    s.T_world_body = at.T_world_camera * m.rig.T_body_left.inverse();
    s.velocity = at.velocity +
                 at.turning.cross(s.T_world_body.translation() - at.T_world_camera.translation());
    s.gyro_bias = biases[imu].gyro;
    s.accel_bias = biases[imu].accel;
    out.push_back(s);
  }
  return out;
}

std::vector<imu_sample> generator::imu() const {
  std::vector<imu_sample> out;
  for (std::int64_t const time : impl_->imu_times) { out.push_back(impl_->ideal_imu(time)); }
  impl_->imu_errors().add_to(out);
  return out;
}

std::optional<Eigen::Vector3d> generator::surface_point(int i, int camera, double u,
                                                        double v) const {
  impl const& m = *impl_;
  m.check_frame(i);
  m.check_camera(camera);
  auto const ray = unproject(m.views[static_cast<std::size_t>(camera)].camera, u, v);
  if (!ray) { return std::nullopt; }
  Eigen::Isometry3d const pose = m.pose(i, camera);
  Eigen::Vector3d const start = pose.translation();
  Eigen::Vector3d const direction = pose.linear() * *ray;
  double best = std::numeric_limits<double>::max();
  for (surface const& s : m.surfaces) {
    double const towards = s.normal.dot(direction);
    if (towards >= 0) { continue; }
    double const far = s.normal.dot(s.origin - start) / towards;
    if (far <= 0 || far >= best) { continue; }
    Eigen::Vector3d const d = start + far * direction - s.origin;
    double const a = d.dot(s.along);
    double const b = d.dot(s.up);
    if (a >= 0 && b >= 0 && a <= s.width && b <= s.height) { best = far; }
  }
  if (best == std::numeric_limits<double>::max()) { return std::nullopt; }
  return Eigen::Vector3d(best * *ray);
}

double generator::depth(int i, double u, double v) const {
  auto const point = surface_point(i, 0, u, v);
  return point ? point->z() : -1.0;
}

std::optional<Eigen::Vector2d> generator::project(int camera, Eigen::Vector3d const& point) const {
  impl_->check_camera(camera);
  camera_intrinsics const& c = impl_->views[static_cast<std::size_t>(camera)].camera;
  if (!(point.z() > 1e-9)) { return std::nullopt; }
  if (c.model == lens::pinhole) {
    return Eigen::Vector2d(c.fx * point.x() / point.z() + c.cx,
                           c.fy * point.y() / point.z() + c.cy);
  }
  double const side = point.head<2>().norm();
  double const angle = std::atan2(side, point.z());
  if (!(angle < fisheye_limit)) { return std::nullopt; }
  double const scale = side > 1e-12 ? kannala_brandt(c.distortion, angle) / side : 1.0 / point.z();
  return Eigen::Vector2d(c.fx * scale * point.x() + c.cx, c.fy * scale * point.y() + c.cy);
}

double generator::clearance(int i) const {
  impl const& m = *impl_;
  m.check_frame(i);
  double best = std::numeric_limits<double>::max();
  for (int c = 0; c < 2; ++c) {
    Eigen::Vector3d const centre = m.pose(i, c).translation();
    for (surface const& s : m.surfaces) { best = std::min(best, distance(s, centre)); }
  }
  return best;
}

}  // namespace seq
