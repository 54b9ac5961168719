// SPDX-License-Identifier: Apache-2.0
/// @file What the tests of bundle adjustment share, of maps with and without right images.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/pipelines/adjust_map.hpp"
#include "tests/support/bundles.hpp"
#include "tests/support/memory.hpp"

namespace test {

inline std::vector<ft::pinhole<double>> one_camera() { return {{420, 410, 320, 240}}; }
inline std::vector<ft::radtan4<double>> two_lenses() {
  return {{400, 405, 310, 250, {-0.05, 0.01, 1e-3, -2e-3}}, {500, 500, 0, 0, {0.02, 0, 0, 0}}};
}

/// The cost in plain numbers, all points before their cameras, left ones and right ones.
template <typename Camera>
double plain_cost(ft::bundle<Camera> const& map, double huber) {
  double sum = 0;
  for (std::size_t o = 0; o < map.pixel.size(); ++o) {
    auto const v = static_cast<std::size_t>(map.observing_view[o]);
    auto const c = static_cast<std::size_t>(map.camera_of_view.empty() ? 0 : map.camera_of_view[v]);
    auto X = map.T_cw[v] * map.position[static_cast<std::size_t>(map.observed_point[o])];
    auto const camera = map.cameras[c].template cast<double>();
    auto const image = camera.project(X);
    EXPECT_TRUE(image.valid);
    double error = std::hypot(image.pixel.x - map.pixel[o].x, image.pixel.y - map.pixel[o].y);
    if (!map.right_x.empty() && !std::isnan(map.right_x[o])) {
      X.x -= map.baseline[c];
      error = std::hypot(error, camera.project(X).pixel.x - map.right_x[o]);
    }
    double const e = error / (map.sigma.empty() ? 1 : map.sigma[o]);
    sum += huber > 0 && e > huber ? 2 * huber * e - huber * huber : e * e;
  }
  return sum;
}

template <typename Camera>
bool same_bits(ft::bundle<Camera> const& a, ft::bundle<Camera> const& b) {
  return same_bits(a.T_cw, b.T_cw) && same_bits(a.position, b.position);
}

inline double distance(ft::vec3<double> a, ft::vec3<double> b) {
  auto const d = a - b;
  return std::sqrt(ft::dot(d, d));
}
template <typename Camera>
double worst_centre(ft::bundle<Camera> const& a, ft::bundle<Camera> const& b) {
  double worst = 0;
  for (std::size_t v = 0; v < a.T_cw.size(); ++v) {
    worst = std::max(worst, distance(a.T_cw[v].centre(), b.T_cw[v].centre()));
  }
  return worst;
}

/// Some steps have the bits of one thread of the host.
template <typename Exec, typename Camera>
void expect_bits_of_host(Exec const& exec, bundle_shape shape, int steps,
                         std::vector<Camera> const& cameras, unsigned seed) {
  shape.outliers = 0.05;
  auto one = make_bundle(shape, cameras, seed).map;
  if (seed % 2 == 0) { one.fixed.clear(); }
  auto other = one;
  ft::map_params params;
  params.huber = 2.5;
  params.steps = steps;
  auto const a = ft::adjust_map(exec, one, params);
  auto const b = ft::adjust_map(ft::host_exec(1), other, params);
  EXPECT_TRUE(same_bits(one, other)) << Camera::name << ' ' << seed;
  EXPECT_EQ(a.first_cost, b.first_cost);
  EXPECT_EQ(a.last_cost, b.last_cost);
  EXPECT_EQ(a.last_chi2, b.last_chi2);
  EXPECT_EQ(a.steps, b.steps);
  EXPECT_EQ(a.refused, b.refused);
  EXPECT_EQ(a.solver_steps, b.solver_steps);
  EXPECT_LT(a.last_cost, a.first_cost);
}
/// Of several models.
template <typename Exec>
void expect_bits_of_host(Exec const& exec, bundle_shape const& shape, int steps, unsigned seed) {
  using fisheye = ft::kannala_brandt<double>;
  expect_bits_of_host(exec, shape, steps, one_camera(), seed);
  expect_bits_of_host(exec, shape, steps, two_lenses(), seed);
  expect_bits_of_host(exec, shape, steps,
                      std::vector<ft::pinhole<float>>{{420.0f, 410.0f, 320.0f, 240.0f}}, seed);
  expect_bits_of_host(exec, shape, steps,
                      std::vector<fisheye>{{300, 300, 320, 240, 0.01, -0.002, 1e-4, 0}}, seed);
}

}  // namespace test
