// SPDX-License-Identifier: Apache-2.0
/// @file Random bundles.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <random>
#include <vector>

#include "ft/containers/bundle.hpp"
#include "ft/types/poses.hpp"
#include "tests/support/pose_graphs.hpp"

namespace test {

struct bundle_shape {
  int views;
  int points;
  int track = 5;              ///< mean number of views of a point
  double noise = 0.5;         ///< standard deviation of pixels
  double outliers = 0;        ///< share of observations that are off by up to 60 pixels
  double view_error = 0.01;   ///< of the start, rad, and in metres twice that
  double point_error = 0.05;  ///< of the start, m
  double baseline = 0;        ///< of all cameras, m; then 3 of 4 observations have a right image
};

template <typename Camera>
struct generated_bundle {
  ft::bundle<Camera> map;  ///< with the errors of the start
  ft::bundle<Camera> truth;
};

/// Adds the right column of the last observation, or that there is none.
template <typename Camera>
void see_right(bundle_shape const& shape, double sigma, ft::bundle<Camera>& map,
               random_motions& any) {
  auto const v = static_cast<std::size_t>(map.observing_view.back());
  auto const& camera = map.cameras[static_cast<std::size_t>(map.camera_of_view[v])];
  auto p = map.T_cw[v] * map.position.back();
  p.x -= shape.baseline;
  double const x = camera.template cast<double>().project(p).pixel.x;
  bool const seen = any.random() % 4 != 0;
  map.right_x.push_back(seen ? x + shape.noise * sigma * any.number() : std::nan(""));
}

/// A camera on a circle that looks outward at points 2 to 6 m away: a part of the circle, or laps.
/// A point is seen by views that are near each other on the circle.
template <typename Camera>
generated_bundle<Camera> make_bundle(bundle_shape const& shape, std::vector<Camera> const& cameras,
                                     unsigned seed) {
  random_motions any(seed);
  auto const uniform = [&] { return std::uniform_real_distribution<double>(-1, 1)(any.random); };
  double const full = 6.283185307179586;
  ft::bundle<Camera> map;
  map.cameras = cameras;
  if (shape.baseline > 0) { map.baseline.assign(cameras.size(), shape.baseline); }
  std::vector<double> heading;
  double const span = full * std::min(1.0, shape.views / 100.0);  // of the circle
  int const laps = 1 + shape.views / 100;
  for (int v = 0; v < shape.views; ++v) {
    double const a = std::fmod(span * laps * v / shape.views, span);
    heading.push_back(a);
    ft::vec3<double> const out{std::cos(a), 0, std::sin(a)};
    ft::rigid<double> const T_wc{
        ft::mat3<double>{{out.z, 0, out.x, 0, 1, 0, -out.x, 0, out.z}} *
            turned_by(any.vector(0.05)),
        {2 * out.x + 0.1 * uniform(), 0.3 * uniform(), 2 * out.z + 0.1 * uniform()}};
    map.T_cw.push_back(T_wc.inverse().orthonormalized());
    map.camera_of_view.push_back(v % static_cast<int>(cameras.size()));
  }
  double const reach = std::min(0.5, 1.25 * span * shape.track / (2 * shape.views));
  while (static_cast<int>(map.position.size()) < shape.points) {
    double const a = span * 0.5 * (uniform() + 1);
    double const far = 6 + 2 * uniform();
    ft::vec3<double> const X{far * std::cos(a), 1.5 * uniform(), far * std::sin(a)};
    std::vector<int> views;
    for (int v = 0; v < shape.views; ++v) {
      double const apart = std::abs(std::remainder(heading[static_cast<std::size_t>(v)] - a, full));
      if (apart <= reach && any.random() % 5 != 0) { views.push_back(v); }
    }
    if (views.size() < 2) { continue; }
    int const p = static_cast<int>(map.position.size());
    map.position.push_back(X);
    for (int const v : views) {
      auto const i = static_cast<std::size_t>(v);
      auto const& camera = map.cameras[static_cast<std::size_t>(map.camera_of_view[i])];
      auto const image = camera.template cast<double>().project(map.T_cw[i] * X);
      double const sigma = any.random() % 2 == 0 ? 1 : 1.5;
      bool const wrong = 0.5 * (uniform() + 1) < shape.outliers;
      double const off = wrong ? 60 : 0;
      map.observing_view.push_back(v);
      map.observed_point.push_back(p);
      map.pixel.push_back({image.pixel.x + shape.noise * sigma * any.number() + off * uniform(),
                           image.pixel.y + shape.noise * sigma * any.number() + off * uniform()});
      map.sigma.push_back(sigma);
      if (shape.baseline > 0) { see_right(shape, sigma, map, any); }
    }
  }
  map.fixed.assign(map.T_cw.size(), 0);
  map.fixed[0] = map.fixed[1] = 1;
  generated_bundle<Camera> made{map, map};
  for (std::size_t v = 2; v < map.T_cw.size(); ++v) {
    made.map.T_cw[v] =
        (any(shape.view_error, 2 * shape.view_error) * map.T_cw[v]).orthonormalized();
  }
  for (auto& X : made.map.position) { X = X + any.vector(shape.point_error); }
  return made;
}

}  // namespace test
