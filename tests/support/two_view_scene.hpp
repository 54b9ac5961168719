// SPDX-License-Identifier: Apache-2.0
/// @file Scenes seen by one camera from two places, and their reconstruction on an executor.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <random>
#include <utility>
#include <vector>

#include "ft/cameras/pinhole.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/two_view/reconstruct.hpp"
#include "ft/types/poses.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/plain_inertial.hpp"

namespace test {

struct two_view_pixel {
  float x, y;
};

struct two_view_scene {
  ft::pinhole<float> camera{450, 455, 370, 250};
  std::uint64_t seed = 1;
  ft::rigid<double> T_21 = ft::rigid<double>::identity();
  std::vector<ft::vec3<double>> X;  ///< of the keypoints of the first image
  std::vector<two_view_pixel> first;
  std::vector<two_view_pixel> second;
  std::vector<int> match;  ///< per keypoint of the first image
};

enum class scene_kind { general, plane, rotation };

struct scene_options {
  scene_kind kind = scene_kind::general;
  int points = 200;
  double noise_px = 0;
  int wrong = 0;      ///< percent of matches with a keypoint anywhere
  int unmatched = 0;  ///< further keypoints in both images
};

inline two_view_pixel project(ft::pinhole<float> const& c, ft::vec3<double> p) {
  auto const m = c.cast<double>();
  return {static_cast<float>(m.fx * p.x / p.z + m.cx), static_cast<float>(m.fy * p.y / p.z + m.cy)};
}

inline two_view_scene make_two_views(std::mt19937& random, scene_options const& o) {
  auto const real = [&](double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
  };
  std::normal_distribution<double> normal;
  two_view_scene s;
  s.seed = random();
  ft::vec3<double> const w{real(-0.1, 0.1), real(-0.1, 0.1), real(-0.1, 0.1)};
  double const side = real(-1, 1) < 0 ? -1 : 1;
  s.T_21 = {plain_exp(w), {side * real(0.7, 1.0), real(-0.4, 0.4), real(-0.3, 0.3)}};
  if (o.kind == scene_kind::rotation) { s.T_21.t = {0, 0, 0}; }
  double const a = real(-0.5, 0.5);
  double const b = real(-0.5, 0.5);
  int const matched = o.points;
  int const n = matched + o.unmatched;
  std::vector<int> place(static_cast<std::size_t>(n));
  std::iota(place.begin(), place.end(), 0);
  std::shuffle(place.begin(), place.end(), random);
  s.second.resize(place.size());
  for (int i = 0; i < n; ++i) {
    double const x = real(-2.5, 2.5);
    double const y = real(-1.5, 1.5);
    double const z = o.kind == scene_kind::plane ? 6 + a * x + b * y : real(4, 9);
    ft::vec3<double> const X{x, y, z};
    auto const noisy = [&](two_view_pixel p) {
      return two_view_pixel{p.x + static_cast<float>(o.noise_px * normal(random)),
                            p.y + static_cast<float>(o.noise_px * normal(random))};
    };
    auto const at = static_cast<std::size_t>(place[static_cast<std::size_t>(i)]);
    bool const wrong = real(0, 100) < o.wrong;
    s.X.push_back(X);
    s.first.push_back(noisy(project(s.camera, X)));
    s.second[at] =
        wrong ? two_view_pixel{static_cast<float>(real(0, 740)), static_cast<float>(real(0, 500))}
              : noisy(project(s.camera, s.T_21 * X));
    s.match.push_back(i < matched ? static_cast<int>(at) : -1);
  }
  return s;
}

/// What a reconstruction wrote, workspace included.
struct two_view_outcome {
  ft::two_view_result result;
  std::vector<ft::vec3<float>> points;
  std::vector<std::uint8_t> flags;
  std::vector<ft::mat3<double>> models;
  std::vector<double> scores;
  std::vector<ft::rigid<double>> motions;
  std::vector<ft::detail::checked_point> checked;  ///< [8][matches]
};

namespace two_view_detail {

template <typename Exec>
ft::soa<Exec::space, ft::field::x, ft::field::y> pixels(
    Exec const& exec, std::vector<two_view_scene> const& scenes,
    std::vector<two_view_pixel> two_view_scene::*which) {
  std::size_t most = 1;
  for (auto const& s : scenes) { most = std::max(most, (s.*which).size()); }
  std::vector<float> x(most * scenes.size(), 777.0f);  // entries past a count
  std::vector<float> y(most * scenes.size(), -777.0f);
  std::vector<int> count;
  for (std::size_t b = 0; b < scenes.size(); ++b) {
    auto const& from = scenes[b].*which;
    for (std::size_t i = 0; i < from.size(); ++i) {
      x[b * most + i] = from[i].x;
      y[b * most + i] = from[i].y;
    }
    count.push_back(static_cast<int>(from.size()));
  }
  ft::soa<Exec::space, ft::field::x, ft::field::y> to(static_cast<int>(most),
                                                      static_cast<int>(scenes.size()));
  set_pixels(exec, to.view(), x, y, count);
  return to;
}

}  // namespace two_view_detail

/// Reconstructs all scenes as one batch.
template <typename Exec>
std::vector<two_view_outcome> reconstruct(Exec const& exec,
                                          std::vector<two_view_scene> const& scenes,
                                          ft::two_view_params const& params = {}) {
  auto const first = two_view_detail::pixels(exec, scenes, &two_view_scene::first);
  auto const second = two_view_detail::pixels(exec, scenes, &two_view_scene::second);
  auto const capacity = static_cast<std::size_t>(first.capacity());
  int const pairs = first.batch();
  std::vector<int> match(capacity * scenes.size(), 3);
  std::vector<ft::pinhole<float>> cameras;
  std::vector<std::uint64_t> seeds;
  for (std::size_t b = 0; b < scenes.size(); ++b) {
    std::copy(scenes[b].match.begin(), scenes[b].match.end(),
              match.begin() + static_cast<std::ptrdiff_t>(b * capacity));
    cameras.push_back(scenes[b].camera);
    seeds.push_back(scenes[b].seed);
  }
  auto const d_match = to_exec(exec, match);
  auto const d_cameras = to_exec(exec, cameras);
  auto const d_seeds = to_exec(exec, seeds);
  ft::owner<ft::two_view_reconstructions, Exec::space> const out(
      [&](ft::carver& c, auto& v) { carve(c, v, pairs, first.capacity()); });
  ft::owner<ft::two_view_workspace, Exec::space> const work(
      [&](ft::carver& c, auto& v) { carve(c, v, pairs, first.capacity(), params.samples); });
  ft::reconstruct_two_views(
      exec, {first.view(), second.view(), d_match.data(), d_cameras.data(), d_seeds.data()}, params,
      out.view(), work.view());
  std::vector<two_view_outcome> outcomes;
  auto const tries = 2 * static_cast<std::size_t>(params.samples);
  for (std::size_t b = 0; b < scenes.size(); ++b) {
    auto const n = scenes[b].first.size();
    two_view_outcome o{from_exec(exec, out->result + b, 1)[0],
                       from_exec(exec, out->point + b * capacity, n),
                       from_exec(exec, out->flags + b * capacity, n),
                       from_exec(exec, work->model + b * tries, tries),
                       from_exec(exec, work->score + b * tries, tries),
                       from_exec(exec, work->motion + b * 8, 8),
                       {}};
    auto const matches = static_cast<std::size_t>(o.result.matches);
    for (std::size_t k = 0; k < 8; ++k) {
      auto const of = from_exec(exec, work->point + (b * 8 + k) * capacity, matches);
      o.checked.insert(o.checked.end(), of.begin(), of.end());
    }
    outcomes.push_back(std::move(o));
  }
  return outcomes;
}

/// Angle between two vectors, rad.
inline double angle_between(ft::vec3<double> a, ft::vec3<double> b) {
  auto const c = cross(a, b);
  return std::atan2(std::sqrt(dot(c, c)), dot(a, b));
}
/// Degrees between rotations, and between directions of translation.
inline double rotation_error(ft::pose const& got, ft::rigid<double> const& want) {
  return angle_of(got.R.cast<double>(), want.R) * 57.29577951308232;
}
inline double direction_error(ft::pose const& got, ft::rigid<double> const& want) {
  return angle_between(got.t.cast<double>(), want.t) * 57.29577951308232;
}

}  // namespace test
