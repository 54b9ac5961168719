// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/generated/render.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <utility>

#include "examples/sequence/detail/random.hpp"

namespace seq::generated {
namespace {

// A surface in the camera's frame. A ray r meets the plane at r / (inverse . r).
struct facing {
  Eigen::Vector3f inverse;
  Eigen::Vector3f along, up;
  float s0 = 0, t0 = 0;
  float width = 0, height = 0;
  std::array<Eigen::Vector3f, 4> corners;
  texture const* skin = nullptr;
};

// What N pixels see. N = 16 is a row of a tile.
template <std::size_t N>
struct rays {
  std::array<float, N> x, y, z;
};
template <std::size_t N>
struct hits {
  std::array<int, N> id;  // into the list of facing surfaces; -1 = nothing
  std::array<float, N> s, t;
};

float dot(Eigen::Vector3f const& a, float x, float y, float z) {
  return a.x() * x + (a.y() * y + a.z() * z);
}

template <std::size_t N>
hits<N> nearest(std::vector<facing> const& surfaces, std::vector<int> const& candidates,
                rays<N> const& r) {
  hits<N> best;
  std::array<float, N> best_inverse;
  for (std::size_t k = 0; k < N; ++k) {
    best.id[k] = -1;
    best.s[k] = best.t[k] = best_inverse[k] = 0;
  }
  for (int id : candidates) {
    facing const f = surfaces[static_cast<std::size_t>(id)];
    for (std::size_t k = 0; k < N; ++k) {
      float const inverse = dot(f.inverse, r.x[k], r.y[k], r.z[k]);
      float const depth = 1.0f / inverse;
      float const s = depth * dot(f.along, r.x[k], r.y[k], r.z[k]) - f.s0;
      float const t = depth * dot(f.up, r.x[k], r.y[k], r.z[k]) - f.t0;
      bool const nearer =
          (inverse > best_inverse[k]) & !(s < 0) & !(t < 0) & !(s > f.width) & !(t > f.height);
      best_inverse[k] = nearer ? inverse : best_inverse[k];
      best.id[k] = nearer ? id : best.id[k];
      best.s[k] = nearer ? s : best.s[k];
      best.t[k] = nearer ? t : best.t[k];
    }
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

template <std::size_t N>
four four_from(std::array<float, N> const& all, std::size_t first) {
  four out;
  std::memcpy(&out, all.data() + first, sizeof out);
  return out;
}

// The grey levels of four of the pixels, from the one numbered `first`.
// @param measure_at the width of a read at one of the four; of one surface it is that of its first.
template <std::size_t N, typename Measure>
four shade(std::vector<facing> const& surfaces, hits<N> const& found, std::size_t first,
           Measure const& measure_at) {
  four out{};
  four seen{};
  int measured = -1;
  for (std::size_t i = 0; i < 4; ++i) {
    int const id = found.id[first + i];
    if (id < 0) { continue; }
    if (id != measured) {
      facing const& f = surfaces[static_cast<std::size_t>(id)];
      float const k = f.skin->texels_per_m;
      seen = f.skin->sample(k * four_from(found.s, first), k * four_from(found.t, first),
                            measure_at(f, i));
      measured = id;
    }
    out[i] = seen[i];
  }
  return out;
}

void face(placed_surfaces const& placed, std::vector<facing>& out) {
  Eigen::Matrix3d const R = placed.T_camera_surfaces.linear();
  for (surface const& s : *placed.surfaces) {
    Eigen::Vector3d const origin = placed.T_camera_surfaces * s.origin;
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
}

std::vector<facing> face(std::vector<placed_surfaces> const& all) {
  std::vector<facing> out;
  for (placed_surfaces const& placed : all) { face(placed, out); }
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

// Pixels of one image.
class tracer {
public:
  // @param visible for each row, or once for all
  tracer(view const& v, std::vector<std::vector<facing>> visible)
      : v_(v),
        visible_(std::move(visible)),
        w_(v.camera.width),
        h_(v.camera.height),
        out_(v.rays.size(), 0.0f),
        ids_(v.rays.size(), -1) {}

  std::vector<float> run() {
    for (tile const& t : v_.tiles) {
      if (t.any) { trace_centres(t); }
    }
    for (tile const& t : v_.tiles) { refine_outlines(t); }
    return std::move(out_);
  }

private:
  std::size_t at(int x, int y) const {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(w_) + static_cast<std::size_t>(x);
  }
  // One pixel away in x and y, inwards at the border of the image and of the lens.
  Eigen::Vector3f neighbour(int x, int y, int dx, int dy) const {
    Eigen::Vector3f const& here = v_.rays[at(x, y)];
    if (x + dx < w_ && y + dy < h_ && v_.rays[at(x + dx, y + dy)].squaredNorm() > 0) {
      return v_.rays[at(x + dx, y + dy)];
    }
    if (x >= dx && y >= dy && v_.rays[at(x - dx, y - dy)].squaredNorm() > 0) {
      return Eigen::Vector3f(2.0f * here - v_.rays[at(x - dx, y - dy)]);
    }
    return here;
  }
  std::vector<facing> const& visible(int y) const {
    return visible_[visible_.size() > 1 ? static_cast<std::size_t>(y) : 0];
  }
  void trace_centres(tile const& t) {
    for (int y = t.y0; y < t.y1; ++y) {
      if (y == t.y0 || visible_.size() > 1) { find_candidates(visible(y), t, candidates_); }
      auto const found = nearest(visible(y), candidates_, row_of(t, y));
      for (int x = t.x0; x < t.x1; x += 4) { shade_four(found, x, y, t); }
    }
  }
  rays<tile_side> row_of(tile const& t, int y) const {
    rays<tile_side> out{};
    for (int x = t.x0; x < t.x1; ++x) {
      std::size_t const i = at(x, y);
      if (v_.light[i] <= 0.0f) { continue; }
      auto const k = static_cast<std::size_t>(x - t.x0);
      out.x[k] = v_.rays[i].x();
      out.y[k] = v_.rays[i].y();
      out.z[k] = v_.rays[i].z();
    }
    return out;
  }
  void shade_four(hits<tile_side> const& found, int x, int y, tile const& t) {
    auto const first = static_cast<std::size_t>(x - t.x0);
    four const grey = shade(visible(y), found, first, [&](facing const& f, std::size_t k) {
      int const u = x + static_cast<int>(k);
      return measure(f, v_.rays[at(u, y)], neighbour(u, y, 1, 0), neighbour(u, y, 0, 1));
    });
    for (int k = 0; k < std::min(4, t.x1 - x); ++k) {
      out_[at(x + k, y)] = grey[static_cast<std::size_t>(k)];
      ids_[at(x + k, y)] = static_cast<std::int16_t>(found.id[first + static_cast<std::size_t>(k)]);
    }
  }
  // Four samples a pixel where neighbours see different surfaces.
  void refine_outlines(tile const& t) {
    bool ready = false;
    for (int y = t.y0; y < t.y1; ++y) {
      if (!has_outline(t, y)) { continue; }
      for (int x = t.x0; x < t.x1; ++x) {
        if (!is_outline(x, y)) { continue; }
        if (!ready) {
          find_candidates(visible(y), t, candidates_);
          ready = visible_.size() == 1;
        }
        sample_four(x, y);
      }
    }
  }
  // Whether a pixel of the tile's row may be one: most rows have none.
  bool has_outline(tile const& t, int y) const {
    std::int16_t const* const row = ids_.data() + at(0, y);
    std::int16_t const* const above = ids_.data() + at(0, std::max(y - 1, 0));
    std::int16_t const* const below = ids_.data() + at(0, std::min(y + 1, h_ - 1));
    bool differ = false;
    for (int x = t.x0; x < t.x1; ++x) { differ |= (row[x] != above[x]) | (row[x] != below[x]); }
    for (int x = std::max(t.x0, 1); x < std::min(t.x1 + 1, w_); ++x) {
      differ |= row[x] != row[x - 1];
    }
    return differ;
  }
  bool is_outline(int x, int y) const {
    std::size_t const i = at(x, y);
    std::int16_t const id = ids_[i];
    if (id < 0) { return false; }
    return (x > 0 && ids_[i - 1] != id) || (x + 1 < w_ && ids_[i + 1] != id) ||
           (y > 0 && ids_[at(x, y - 1)] != id) || (y + 1 < h_ && ids_[at(x, y + 1)] != id);
  }
  void sample_four(int x, int y) {
    Eigen::Vector3f const ray = v_.rays[at(x, y)];
    Eigen::Vector3f const right = neighbour(x, y, 1, 0);
    Eigen::Vector3f const down = neighbour(x, y, 0, 1);
    rays<4> around;
    for (std::size_t k = 0; k < 4; ++k) {
      float const du = (k & 1u) != 0 ? 0.25f : -0.25f;
      float const dv = (k & 2u) != 0 ? 0.25f : -0.25f;
      Eigen::Vector3f const shifted = ray + du * (right - ray) + dv * (down - ray);
      around.x[k] = shifted.x();
      around.y[k] = shifted.y();
      around.z[k] = shifted.z();
    }
    auto const found = nearest(visible(y), candidates_, around);
    four const grey = shade(visible(y), found, 0, [&](facing const& f, std::size_t) {
      return measure(f, ray, right, down);
    });
    float sum = 0;
    int samples = 0;
    for (std::size_t k = 0; k < 4; ++k) {
      if (found.id[k] < 0) { continue; }
      sum += grey[k];
      ++samples;
    }
    if (samples > 0) { out_[at(x, y)] = sum / static_cast<float>(samples); }
  }

  view const& v_;
  std::vector<std::vector<facing>> visible_;
  int w_, h_;
  std::vector<float> out_;
  std::vector<std::int16_t> ids_;  // of the surface that a pixel's centre sees
  std::vector<int> candidates_;
};

}  // namespace

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

std::vector<float> trace(view const& v, std::vector<placed_surfaces> const& all) {
  return tracer(v, {face(all)}).run();
}

std::vector<float> trace_rows(view const& v,
                              std::function<std::vector<placed_surfaces>(int row)> const& at) {
  std::vector<std::vector<facing>> rows;
  for (int y = 0; y < v.camera.height; ++y) { rows.push_back(face(at(y))); }
  return tracer(v, std::move(rows)).run();
}

image expose(view const& v, std::vector<float> const& radiance, float gain, float sigma,
             std::vector<float> const& normal, std::uint64_t noise_key) {
  image out;
  out.width = v.camera.width;
  out.height = v.camera.height;
  out.pixels.resize(radiance.size());
  std::uint64_t bits = 0;
  for (std::size_t i = 0; i < radiance.size(); ++i) {
    if ((i & 3u) == 0) { bits = detail::mix(noise_key + i * 0x9e3779b97f4a7c15ULL); }
    float const noise = sigma * normal[bits & 4095u];
    bits >>= 16;
    float const rounded = radiance[i] * (gain * v.light[i]) + noise + 0.5f;
    out.pixels[i] = static_cast<std::uint8_t>(std::min(std::max(rounded, 0.0f), 255.0f));
  }
  return out;
}

}  // namespace seq::generated
