// SPDX-License-Identifier: Apache-2.0
/// @file Cameras that look at random points: pixels and points of pose problems, some of which do
/// not belong together.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <random>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/pnp/problem.hpp"
#include "ft/types/poses.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/random.hpp"

namespace test {

inline ft::pinhole<double> pnp_camera() { return {458.0, 457.0, 367.0, 248.0}; }
inline ft::kannala_brandt<double> pnp_fisheye() {
  return {190.978, 190.973, 254.932, 256.897, 0.00348, 0.000715, -0.00205, 0.000203};
}

/// The rotation by `angle` about an axis of any length (Rodrigues).
inline ft::mat3<double> rotation_about(ft::vec3<double> axis, double angle) {
  double const n = std::sqrt(dot(axis, axis));
  double const x = axis.x / n;
  double const y = axis.y / n;
  double const z = axis.z / n;
  double const c = std::cos(angle);
  double const s = std::sin(angle);
  double const d = 1 - c;
  return {{c + d * x * x, d * x * y - s * z, d * x * z + s * y, d * x * y + s * z, c + d * y * y,
           d * y * z - s * x, d * x * z - s * y, d * y * z + s * x, c + d * z * z}};
}
/// Angle between two rotations, rad.
inline double angle_between_rotations(ft::mat3<double> const& a, ft::mat3<double> const& b) {
  ft::mat3<double> const turn = a.transposed() * b;
  auto const& m = turn.m;
  ft::vec3<double> const axis{m[7] - m[5], m[2] - m[6], m[3] - m[1]};
  return std::atan2(std::sqrt(dot(axis, axis)), m[0] + m[4] + m[8] - 1);
}

/// How a scene is made.
struct pnp_scene_params {
  int points = 100;
  double outliers = 0;  ///< share
  double noise = 0;     ///< standard deviation, pixels
  bool plane = false;   ///< all points on z = 0 of the world
  double behind = 0;    ///< share of points behind a pinhole camera, seen as mirror images
};

/// Correspondences, and where they come from.
struct pnp_scene {
  ft::rigid<double> T_cw;
  std::uint64_t seed;
  std::vector<ft::vec2<float>> pixel;
  std::vector<ft::vec3<float>> point;
  std::vector<float> max_error2;
  std::vector<int> good;  ///< 1: pixel and point belong together

  int size() const { return static_cast<int>(point.size()); }
};

/// @tparam Camera of double
template <typename Camera>
pnp_scene make_pnp_scene(std::mt19937& random, Camera const& camera,
                         pnp_scene_params const& params) {
  auto const real = [&](double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
  };
  std::normal_distribution<double> normal(0, 1);
  pnp_scene scene;
  scene.seed = random();
  // Towards the plane z = 0 where the points are on it, at an angle: the rule's scale of a plane
  // straight before the camera is too far off.
  scene.T_cw.R = params.plane
                     ? rotation_about({real(-1, 1), real(0.5, 1), real(-0.3, 0.3)}, real(0.6, 0.9))
                     : rotation_about({real(-1, 1), real(-1, 1), real(-1, 1)}, real(0.1, 2.5));
  scene.T_cw.t = {real(-1, 1), real(-1, 1), params.plane ? real(4, 6) : real(-2, 2)};
  ft::rigid<double> const T_wc = scene.T_cw.inverse();
  while (scene.size() < params.points) {
    double const depth = real(2, 12);
    ft::vec3<double> const ray{real(-0.7, 0.7), real(-0.45, 0.45), 1};
    double const side = real(0, 1) < params.behind ? -1 : 1;
    ft::vec3<double> X = T_wc * scaled(ray, side * depth);
    if (params.plane) {
      ft::vec3<double> const along = T_wc.R * ray;
      X = T_wc.t + scaled(along, -T_wc.t.z / along.z);
      X.z = 0;
    }
    ft::vec3<float> const point = X.cast<float>();
    ft::vec3<double> const seen = scene.T_cw * point.cast<double>();
    if (params.plane && !(seen.z > 0.5 && seen.z < 50)) { continue; }
    auto const at = camera.project(scaled(seen, seen.z < 0 ? -1.0 : 1.0)).pixel;
    bool const good = real(0, 1) >= params.outliers;
    ft::vec2<double> pixel{at.x + params.noise * normal(random),
                           at.y + params.noise * normal(random)};
    if (!good) {
      double const angle = real(0, 6.28);
      double const far = real(40, 300);
      pixel = {at.x + far * std::cos(angle), at.y + far * std::sin(angle)};
    }
    scene.pixel.push_back({static_cast<float>(pixel.x), static_cast<float>(pixel.y)});
    scene.point.push_back(point);
    scene.max_error2.push_back(5.991f * static_cast<float>(std::pow(1.44, random() % 3u)));
    scene.good.push_back(static_cast<int>(good));
  }
  return scene;
}

/// Scenes as a batch of problems on an executor, with results and working memory.
template <typename Exec>
class pnp_batch {
public:
  pnp_batch(Exec const& exec, std::vector<pnp_scene> const& scenes, ft::pnp_params const& params,
            int capacity = 0)
      : exec_(exec) {
    for (auto const& s : scenes) { capacity = std::max(capacity, s.size()); }
    int const problems = static_cast<int>(scenes.size());
    memory_ = ft::arena<Exec::space>([&](ft::carver& c) {
      carve(c, problems_, problems, capacity);
      carve(c, results_, problems, capacity);
      carve(c, work_, problems_, params);
    });
    for (int b = 0; b < problems; ++b) {
      auto const& s = scenes[at(b)];
      std::ptrdiff_t const first = problems_.at(b);
      put(problems_.count + b, std::vector<int>{s.size()});
      put(problems_.seed + b, std::vector<std::uint64_t>{s.seed});
      put(problems_.pixel + first, s.pixel);
      put(problems_.point + first, s.point);
      put(problems_.max_error2 + first, s.max_error2);
    }
  }

  template <typename T>
  void put(T* to, std::vector<T> const& values) const {
    ft::copy(exec_, to, values.data(), values.size());
    exec_.wait();
  }
  ft::pnp_problems_view& problems() { return problems_; }
  ft::pnp_results_view const& results() const { return results_; }
  ft::pnp_workspace const& work() const { return work_; }

  ft::pnp_result result(int b) const { return from_exec(exec_, results_.result + b, 1)[0]; }
  std::vector<std::uint8_t> inliers(int b) const {
    return from_exec(exec_, results_.inlier + problems_.at(b), at(problems_.capacity));
  }
  /// Numbers of inliers of the hypotheses of a problem's slots.
  std::vector<int> counts(int b) const {
    return from_exec(exec_, work_.inliers + work_.slot(b, 0), at(work_.hypotheses));
  }
  std::vector<ft::rigid<double>> poses(int b) const {
    return from_exec(exec_, work_.T_cw + work_.slot(b, 0), at(work_.hypotheses));
  }

private:
  Exec const& exec_;
  ft::pnp_problems_view problems_;
  ft::pnp_results_view results_;
  ft::pnp_workspace work_;
  ft::arena<Exec::space> memory_;
};

}  // namespace test
