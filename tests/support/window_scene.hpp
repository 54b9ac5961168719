// SPDX-License-Identifier: Apache-2.0
/// @file Windows of a moving camera pair with known views and points, and an adjustment of them.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <random>
#include <vector>

#include "ft/containers/window_problem.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/window/adjust_window.hpp"
#include "tests/support/example_rigs.hpp"
#include "tests/support/memory.hpp"

namespace test {

/// Pixel of a point given in the frame of the pose, from the models' equations, and for a
/// rectified pair its column in the right image.
template <typename Number>
struct window_image {
  Number x, y, right_x;
};
template <typename Number>
window_image<Number> image_of(ft::rectified_rig const& rig, ft::vec3<Number> const& p, int) {
  auto const c = rig.camera.cast<double>();
  Number const x = c.fx * p.x / p.z + c.cx;
  return {x, c.fy * p.y / p.z + c.cy, x - static_cast<double>(rig.bf()) / p.z};
}
template <typename Number>
ft::vec3<Number> moved(motion const& T, ft::vec3<Number> const& p) {
  auto const& m = T.R.m;
  return {m[0] * p.x + m[1] * p.y + m[2] * p.z + T.t.x,
          m[3] * p.x + m[4] * p.y + m[5] * p.z + T.t.y,
          m[6] * p.x + m[7] * p.y + m[8] * p.z + T.t.z};
}
template <typename Number>
window_image<Number> image_of(three_camera_rig const& rig, ft::vec3<Number> const& p, int camera) {
  ft::rig_camera const& of = rig.of[camera];
  ft::rectified_rig const pair{of.camera, of.baseline};
  auto image = image_of(pair, moved(of.T_cb.cast<double>(), p), 0);
  if (of.single()) { image.right_x = Number(-1e9); }
  return image;
}
/// z in the frame of a camera of a rectified rig.
inline double depth_in(ft::rectified_rig const&, ft::vec3<double> const& p, int) { return p.z; }
inline double depth_in(fisheye_rig const&, ft::vec3<double> const& p, int) { return p.z; }
inline double depth_in(three_camera_rig const& rig, ft::vec3<double> const& p, int camera) {
  return moved(rig.of[camera].T_cb.cast<double>(), p).z;
}
template <typename Number>
window_image<Number> image_of(fisheye_rig const& rig, ft::vec3<Number> p, int camera) {
  using std::atan2;
  using std::sqrt;
  if (camera == 1) { p = moved(rig.T_rl.cast<double>(), p); }
  auto const c = camera == 0 ? rig.left.cast<double>() : rig.right.cast<double>();
  Number const radius = sqrt(p.x * p.x + p.y * p.y);
  Number const a = atan2(radius, p.z);
  Number const a2 = a * a;
  Number const r = a * (1.0 + a2 * (c.k1 + a2 * (c.k2 + a2 * (c.k3 + a2 * c.k4))));
  return {c.fx * r * p.x / radius + c.cx, c.fy * r * p.y / radius + c.cy, Number(-1.0)};
}

/// A problem in host memory, and the truth behind it.
struct window_scene {
  int fixed = 0;
  int cameras = 1;
  std::vector<motion> T_cw, true_T_cw;
  std::vector<ft::vec3<double>> position, true_position;
  std::vector<ft::window_observation> seen;  ///< [points][views][cameras]
  std::vector<unsigned char> wrong;          ///< the same shape; 1 = an error made on purpose
  std::vector<ft::window_link> links;        ///< [views] from the view before; empty = none
  std::vector<double> centre_information;    ///< [views][views]; empty = none, likewise
  std::vector<ft::vec3<double>> centre_goal;

  int views() const { return static_cast<int>(T_cw.size()); }
  int points() const { return static_cast<int>(position.size()); }
  std::size_t at(int p, int v, int c) const {
    return static_cast<std::size_t>((p * views() + v) * cameras + c);
  }
};

struct window_shape {
  int views = 6;
  int fixed = 2;
  int points = 150;
  int track = 5;           ///< most views that see a point
  double noise = 0;        ///< of pixels at octave 0, standard deviation
  double wrong = 0;        ///< share of observations that are 20 to 50 pixels off
  double start_error = 1;  ///< times 1 cm, 0.5 degrees and 3 cm of a point
  int shortest = 2;        ///< fewest views that see a point
};

/// A pair that moves sideways and forward with points in front of it.
template <typename Rig>
window_scene make_window(Rig const& rig, window_shape const& shape, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> unit(-1, 1);
  std::normal_distribution<double> normal;
  window_scene s;
  s.fixed = shape.fixed;
  s.cameras = Rig::cameras;
  motion const base = turn({0.3, -0.7, 0.2}, {0.5, -0.2, 1.1});
  for (int v = 0; v < shape.views; ++v) {
    double const a = 0.02 * v;
    s.true_T_cw.push_back(turn({0.3 * a, a, -0.2 * a}, {-0.08 * v, 0.02 * v, -0.05 * v}) * base);
    double const e = v < shape.fixed ? 0 : shape.start_error;
    s.T_cw.push_back(
        turn({0.008 * e * unit(random), 0.008 * e * unit(random), 0.008 * e * unit(random)},
             {0.01 * e * unit(random), 0.01 * e * unit(random), 0.01 * e * unit(random)}) *
        s.true_T_cw.back());
  }
  auto const all = static_cast<std::size_t>(shape.points * shape.views * s.cameras);
  s.seen.assign(all, {0, 0, -1, 0});
  s.wrong.assign(all, 0);
  for (int p = 0; p < shape.points; ++p) {
    auto const more = static_cast<unsigned>(shape.track - shape.shortest + 1);
    int const length = std::min(shape.views, shape.shortest + static_cast<int>(random() % more));
    int const first = static_cast<int>(random() % static_cast<unsigned>(shape.views - length + 1));
    double const depth = 2 + 3 * (1 + unit(random));
    auto const middle = static_cast<std::size_t>(first + length / 2);
    ft::vec3<double> const local{0.6 * depth * unit(random), 0.5 * depth * unit(random), depth};
    ft::vec3<double> const X = s.true_T_cw[middle].inverse() * local;
    double const e = 0.03 * shape.start_error;
    s.true_position.push_back(X);
    s.position.push_back({X.x + e * unit(random), X.y + e * unit(random), X.z + e * unit(random)});
    double const sigma = std::pow(1.2, static_cast<double>(random() % 5u));
    for (int v = first; v < first + length; ++v) {
      for (int c = 0; c < s.cameras; ++c) {
        ft::vec3<double> const x = s.true_T_cw[static_cast<std::size_t>(v)] * X;
        if (!(x.z > 0.3) || random() % 8 == 0) { continue; }
        auto const image = image_of(rig, x, c);
        bool const wrong = 0.5 * (unit(random) + 1) < shape.wrong;
        double const off = wrong ? 35 + 15 * unit(random) : 0;
        double const dx = shape.noise * sigma * normal(random) + off;
        double const dy = shape.noise * sigma * normal(random);
        double const dr = 0.25 * shape.noise * sigma * normal(random);
        auto& o = s.seen[s.at(p, v, c)];
        o.x = static_cast<float>(image.x + dx);
        o.y = static_cast<float>(image.y + dy);
        bool const stereo = Rig::rectified && random() % 3 != 0 && image.right_x + dx + dr >= 0;
        o.right_x = stereo ? static_cast<float>(image.right_x + dx + dr) : -1.0f;
        o.inv_sigma2 = static_cast<float>(1 / (sigma * sigma));
        s.wrong[s.at(p, v, c)] = wrong ? 1 : 0;
      }
    }
  }
  return s;
}

/// Measures the motion between views.
/// @param error of a rotation, rad, and of a translation, m: at most, along each axis
inline void link_views(window_scene& s, double error, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> of(-error, error);
  s.links.assign(s.T_cw.size(), {motion{{{std::nan("")}}, {}}, 0, 0});  // the first is not read
  for (std::size_t v = 1; v < s.T_cw.size(); ++v) {
    motion const off = turn({of(random), of(random), of(random)}, {of(random), of(random), 0.0});
    double const weight = 1e4 * static_cast<double>(1 + random() % 4u);
    s.links[v] = {off * (s.true_T_cw[v] * s.true_T_cw[v - 1].inverse()), weight, 2 * weight};
  }
}
/// The cost of the links that end at a moving view, by a plain reading of the rules.
inline double link_costs(window_scene const& s, std::vector<motion> const& T_cw) {
  double sum = 0;
  for (auto v = static_cast<std::size_t>(std::max(1, s.fixed)); v < s.links.size(); ++v) {
    ft::window_link const& link = s.links[v];
    auto const R_wi = T_cw[v - 1].R.transposed();
    auto const A = R_wi * (link.motion.R.transposed() * T_cw[v].R);
    ft::vec3<double> const e{(A.m[7] - A.m[5]) / 2, (A.m[2] - A.m[6]) / 2, (A.m[3] - A.m[1]) / 2};
    auto const d = T_cw[v].centre() - T_cw[v - 1].centre() - R_wi * link.motion.centre();
    sum += link.rotation_weight * ft::dot(e, e) + link.translation_weight * ft::dot(d, d);
  }
  return sum;
}

/// A cost of centres that are off by up to `error`, m, as of errors that views share. With some
/// entries that are 0, as between views that nothing joins.
inline void hold_centres(window_scene& s, double error, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> of(-1, 1);
  auto const n = s.T_cw.size();
  s.links.resize(n, {motion::identity(), 0, 0});
  s.centre_information.assign(n * n, 0);
  for (std::size_t k = 0; k < 2 * n; ++k) {  // sums of squares of a few views' errors
    std::vector<double> row(n);
    for (std::size_t v = k / 3; v < std::min(n, k / 3 + 4); ++v) { row[v] = 100 * of(random); }
    for (std::size_t i = 0; i < n * n; ++i) { s.centre_information[i] += row[i / n] * row[i % n]; }
  }
  for (motion const& T : s.true_T_cw) {
    s.centre_goal.push_back(
        T.centre() + ft::vec3<double>{error * of(random), error * of(random), error * of(random)});
  }
}
inline double centre_costs(window_scene const& s, std::vector<motion> const& T_cw) {
  double sum = 0;
  auto const n = T_cw.size();
  for (std::size_t i = 0; i < s.centre_information.size(); ++i) {
    sum += s.centre_information[i] * ft::dot(T_cw[i / n].centre() - s.centre_goal[i / n],
                                             T_cw[i % n].centre() - s.centre_goal[i % n]);
  }
  return sum;
}

struct window_result {
  std::vector<motion> T_cw;
  std::vector<ft::vec3<double>> position;
  std::vector<unsigned char> outlier;
  ft::window_outcome outcome;
};

inline bool same_bits(window_result const& a, window_result const& b) {
  return same_bits(a.T_cw, b.T_cw) && same_bits(a.position, b.position) &&
         same_bits(a.outlier, b.outlier) &&
         std::memcmp(&a.outcome.first_cost, &b.outcome.first_cost, sizeof(double)) == 0 &&
         std::memcmp(&a.outcome.last_cost, &b.outcome.last_cost, sizeof(double)) == 0 &&
         a.outcome.steps == b.outcome.steps && a.outcome.valid == b.outcome.valid;
}
/// Until nothing is gained any more.
inline ft::window_params thorough(int steps) {
  ft::window_params params;
  params.steps = steps;
  params.enough = 0;
  return params;
}

/// The robust cost and the outliers of a result, by a plain reading of the rules.
struct window_judgement {
  double cost = 0;
  std::vector<unsigned char> outlier;
};
template <typename Rig>
window_judgement judge(Rig const& rig, window_scene const& s, std::vector<motion> const& T_cw,
                       std::vector<ft::vec3<double>> const& position,
                       ft::window_params const& params = {}) {
  window_judgement j;
  j.cost = link_costs(s, T_cw) + centre_costs(s, T_cw);
  auto const count = [&](bool has_image, double chi2) {
    double const robust =
        chi2 <= params.huber2 ? chi2 : 2 * std::sqrt(params.huber2 * chi2) - params.huber2;
    j.cost += has_image ? robust : params.no_image;
    return !has_image || chi2 >= params.outlier2;
  };
  for (int p = 0; p < s.points(); ++p) {
    for (int v = 0; v < s.views(); ++v) {
      ft::vec3<double> const x =
          T_cw[static_cast<std::size_t>(v)] * position[static_cast<std::size_t>(p)];
      for (int c = 0; c < s.cameras; ++c) {
        bool const has_image = !Rig::rectified || depth_in(rig, x, c) > 0;
        auto const& o = s.seen[s.at(p, v, c)];
        j.outlier.push_back(0);
        if (!(o.inv_sigma2 > 0)) { continue; }
        auto const image = image_of(rig, x, c);
        double const w = static_cast<double>(o.inv_sigma2);
        double const dx = image.x - static_cast<double>(o.x);
        double const dy = image.y - static_cast<double>(o.y);
        if (count(has_image, w * (dx * dx + dy * dy))) { j.outlier.back() |= ft::outlying_pixel; }
        if (!Rig::rectified || o.right_x < 0) { continue; }
        double const dd =
            image.x - image.right_x - (static_cast<double>(o.x) - static_cast<double>(o.right_x));
        if (count(has_image, params.disparity_weight * w * dd * dd)) {
          j.outlier.back() |= ft::outlying_right;
        }
      }
    }
  }
  return j;
}

/// The least cost with one moving view turned or moved by 1e-5 along any axis.
template <typename Rig>
double least_cost_nearby(Rig const& rig, window_scene const& s, window_result const& r) {
  double least = std::numeric_limits<double>::infinity();
  for (auto v = static_cast<std::size_t>(s.fixed); v < r.T_cw.size(); ++v) {
    for (int k = 0; k < 12; ++k) {
      double step[6] = {};
      step[k / 2] = k % 2 == 0 ? 1e-5 : -1e-5;
      auto T_cw = r.T_cw;
      T_cw[v] = turn({step[0], step[1], step[2]}, {step[3], step[4], step[5]}) * T_cw[v];
      least = std::min(least, judge(rig, s, T_cw, r.position).cost);
    }
  }
  return least;
}

/// Adjusts problems as one batch. Unused entries hold NaN, which nobody may read.
/// @param room capacities; 0 = as many as the largest problem has
template <typename Exec, typename Rig>
std::vector<window_result> adjust(Exec const& exec, Rig const& rig,
                                  std::vector<window_scene> const& scenes,
                                  ft::window_params const& params,
                                  std::vector<int> const& selected = {},
                                  ft::window_capacity room = {0, 0, 0, false}) {
  int moving = 1;
  for (auto const& s : scenes) {
    room.views = std::max(room.views, s.views());
    room.points = std::max(room.points, s.points());
    room.cameras = std::max(room.cameras, s.cameras);
    room.links = room.links || !s.links.empty();
    moving = std::max(moving, s.views() - s.fixed);
  }
  room.points = std::max(room.points, 1);
  moving = std::max(1, std::min(moving, room.views));
  int const batch = static_cast<int>(scenes.size());
  ft::window_problem_view host, there;
  ft::window_workspace work;
  ft::arena<ft::memory_space::host> const here(
      [&](ft::carver& c) { ft::carve(c, host, room, batch); });
  ft::arena<Exec::space> const memory([&](ft::carver& c) {
    ft::carve(c, there, room, batch);
    ft::carve(c, work, there, moving);
  });
  double const nan = std::nan("");
  std::fill_n(host.T_cw, batch * room.views, motion{{{nan, nan, nan}}, {nan, nan, nan}});
  std::fill_n(host.position, batch * room.points, ft::vec3<double>{nan, nan, nan});
  std::size_t const sightings = static_cast<std::size_t>(host.sighting(batch, 0, 0, 0));
  float const nanf = std::nanf("");
  std::fill_n(host.seen, sightings, ft::window_observation{nanf, nanf, nanf, nanf});
  std::fill_n(host.outlier, sightings, static_cast<unsigned char>(77));
  for (int b = 0; b < batch; ++b) {
    auto const& s = scenes[static_cast<std::size_t>(b)];
    host.view_count[b] = s.views();
    host.fixed_count[b] = s.fixed;
    host.point_count[b] = s.points();
    host.outcome[b] = {-1, -1, -1, -1};
    std::copy(s.T_cw.begin(), s.T_cw.end(), host.T_cw + host.view(b, 0));
    std::copy(s.position.begin(), s.position.end(), host.position + host.point(b, 0));
    if (room.links) {
      ft::window_link* const to = host.link + host.view(b, 0);
      std::fill_n(to, room.views, ft::window_link{motion::identity(), 0, 0});
      std::copy(s.links.begin(), s.links.end(), to);
      double* const information = host.centre_information + host.view(b, 0) * room.views;
      std::fill_n(information, room.views * room.views, nan);
      std::fill_n(host.centre_goal + host.view(b, 0), room.views, ft::vec3<double>{});
      std::copy(s.centre_goal.begin(), s.centre_goal.end(), host.centre_goal + host.view(b, 0));
      for (int v = 0; v < s.views(); ++v) {
        for (int u = 0; u < s.views(); ++u) {
          auto const i = static_cast<std::size_t>(v * s.views() + u);
          information[v * room.views + u] =
              s.centre_information.empty() ? 0 : s.centre_information[i];
        }
      }
    }
    for (int p = 0; p < s.points(); ++p) {
      for (int v = 0; v < s.views(); ++v) {
        for (int c = 0; c < s.cameras; ++c) {
          host.seen[host.sighting(b, p, v, c)] = s.seen[s.at(p, v, c)];
        }
      }
    }
  }
  auto const every = [&](auto const& move) {
    auto const n = static_cast<std::size_t>(batch);
    move(&ft::window_problem_view::view_count, n);
    move(&ft::window_problem_view::fixed_count, n);
    move(&ft::window_problem_view::point_count, n);
    move(&ft::window_problem_view::T_cw, n * static_cast<std::size_t>(room.views));
    if (room.links) {
      auto const all = n * static_cast<std::size_t>(room.views);
      move(&ft::window_problem_view::link, all);
      move(&ft::window_problem_view::centre_goal, all);
      move(&ft::window_problem_view::centre_information,
           all * static_cast<std::size_t>(room.views));
    }
    move(&ft::window_problem_view::position, n * static_cast<std::size_t>(room.points));
    move(&ft::window_problem_view::seen, sightings);
    move(&ft::window_problem_view::outlier, sightings);
    move(&ft::window_problem_view::outcome, n);
  };
  every([&](auto member, std::size_t n) { ft::copy(exec, there.*member, host.*member, n); });
  ft::buffer<int, Exec::space> flags(selected.size());
  ft::copy(exec, flags.data(), selected.data(), selected.size());
  ft::adjust_window(exec, rig, there, selected.empty() ? nullptr : flags.data(), params, work);
  every([&](auto member, std::size_t n) { ft::copy(exec, host.*member, there.*member, n); });
  exec.wait();

  std::vector<window_result> results;
  for (int b = 0; b < batch; ++b) {
    auto const& s = scenes[static_cast<std::size_t>(b)];
    window_result r;
    r.T_cw.assign(host.T_cw + host.view(b, 0), host.T_cw + host.view(b, s.views()));
    r.position.assign(host.position + host.point(b, 0), host.position + host.point(b, s.points()));
    r.outcome = host.outcome[b];
    for (int p = 0; p < s.points(); ++p) {
      for (int v = 0; v < s.views(); ++v) {
        for (int c = 0; c < s.cameras; ++c) {
          r.outlier.push_back(host.outlier[host.sighting(b, p, v, c)]);
        }
      }
    }
    results.push_back(r);
  }
  return results;
}

}  // namespace test
