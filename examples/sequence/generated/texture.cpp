// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/generated/texture.hpp"

#include <Eigen/Core>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "examples/sequence/detail/random.hpp"
#include "examples/sequence/generated/constants.hpp"

namespace seq::generated {
namespace {

using detail::random_stream;

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

// Shapes of one size: how much of the area they cover, and how much they hide.
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

void draw_shapes(mip_level& base, random_stream& random, octave const& o, double width_m,
                 double height_m, double texels_per_m) {
  double const size = o.size_m * texels_per_m;
  // drawn from a stream of its own, so that the coarse picture does not depend on the resolution
  random_stream shapes(random.next());
  if (size < 3.5) { return; }
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

// Uneven light and dirt, and [1 2 1] both ways, which smooths the stairs of the polygons' edges.
mip_level lit_and_smoothed(mip_level const& base, random_stream& random, double texels_per_m,
                           double brightness) {
  value_noise const light(random, base.width, base.height, static_cast<float>(1.6 * texels_per_m));
  value_noise const dirt(random, base.width, base.height,
                         std::max(2.0f, static_cast<float>(0.09 * texels_per_m)));
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
  return smooth;
}

mip_level halved(mip_level const& from) {
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
  return to;
}

}  // namespace

four texture::sample(four x, four y, footprint const& f) const {
  four sum{};
  float const halved = 0.5f * static_cast<float>(f.taps - 1);
  float const scale = 1.0f / static_cast<float>(1 << f.level);
  auto const level = static_cast<std::size_t>(f.level);
  for (int i = 0; i < f.taps; ++i) {
    float const offset = static_cast<float>(i) - halved;
    four const tx = (x + offset * f.step_x) * scale;
    four const ty = (y + offset * f.step_y) * scale;
    four value = levels[level].bilinear(tx - 0.5f, ty - 0.5f);
    if (f.blend > 0.0f) {
      value += f.blend * (levels[level + 1].bilinear(0.5f * tx - 0.5f, 0.5f * ty - 0.5f) - value);
    }
    sum += value;
  }
  return sum / static_cast<float>(f.taps);
}

footprint texture::measure(float ax, float ay, float bx, float by) const {
  float const a2 = ax * ax + ay * ay;
  float const b2 = bx * bx + by * by;
  bool const a_longer = a2 > b2;
  float const major = std::sqrt(std::max(a_longer ? a2 : b2, 1e-12f));
  float const minor = std::max(std::abs(ax * by - ay * bx) / major, 1e-6f);
  footprint f;
  if (major > 1.0f) { f.taps = static_cast<int>(std::min(std::ceil(major / minor - 0.1f), 4.0f)); }
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
  for (auto const& o : octaves) { draw_shapes(base, random, o, width_m, height_m, texels_per_m); }
  out.levels.push_back(lit_and_smoothed(base, random, texels_per_m, brightness));
  while (out.levels.back().width > 2 && out.levels.back().height > 2) {
    mip_level to = halved(out.levels.back());
    out.levels.push_back(std::move(to));
  }
  return out;
}

}  // namespace seq::generated
