// SPDX-License-Identifier: Apache-2.0
/// @file Bundles: views, points, and where the views see the points.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// A map to adjust, in host memory: arrays by views, by points and by observations.
/// @tparam Camera any camera model, of any scalar, such as pinhole<double>
template <typename Camera>
struct bundle {
  std::vector<Camera> cameras;
  /// [cameras] of rectified pairs: metres along the camera's x axis to a right camera that is like
  /// it, 0 to 1e6; 0: it has none. Empty: none has.
  std::vector<double> baseline;

  // [views]
  std::vector<rigid<double>> T_cw;   ///< metres
  std::vector<int> camera_of_view;   ///< index into `cameras`; empty: all have the first one
  std::vector<unsigned char> fixed;  ///< whether the view stays; none, or empty: the first does

  // [points]
  std::vector<vec3<double>> position;  ///< world, metres

  // [observations], in any order
  std::vector<int> observing_view;
  std::vector<int> observed_point;
  std::vector<vec2<double>> pixel;
  /// Column in the right image, pixels; NaN: not seen there. Empty: none is. It gives the map its
  /// scale, and counts as a third coordinate of the observation.
  std::vector<double> right_x;
  std::vector<double> sigma;  ///< standard deviation of a coordinate, pixels; empty: 1
};

namespace detail {

template <typename Camera>
void check_views(bundle<Camera> const& map) {
  std::size_t const views = map.T_cw.size();
  require(map.camera_of_view.empty() || map.camera_of_view.size() == views,
          "`camera_of_view` of a bundle has as many entries as there are views, or none");
  require(map.fixed.empty() || map.fixed.size() == views,
          "`fixed` of a bundle has as many entries as there are views, or none");
  require(views == 0 || !map.cameras.empty(), "a bundle with views has no camera");
  int const cameras = static_cast<int>(map.cameras.size());
  require(map.baseline.empty() || map.baseline.size() == map.cameras.size(),
          "`baseline` of a bundle has as many entries as there are cameras, or none");
  for (std::size_t i = 0; i < map.cameras.size(); ++i) {
    check_named("camera", i, [&] {
      map.cameras[i].check();
      if (!map.baseline.empty()) { require_range("baseline", map.baseline[i], 0.0, 1e6); }
    });
  }
  for (std::size_t i = 0; i < views; ++i) {
    check_named("view", i, [&] {
      rigid<double> const& T = map.T_cw[i];
      require_rotation(T.R);
      for (double const v : {T.t.x, T.t.y, T.t.z}) { require_finite("translation", v); }
      if (!map.camera_of_view.empty()) {
        require_range("camera of a view", map.camera_of_view[i], 0, cameras - 1);
      }
    });
  }
}

/// Whether an observation has a right image.
template <typename Camera>
bool has_right(bundle<Camera> const& map, std::size_t observation) {
  return !map.right_x.empty() && !std::isnan(map.right_x[observation]);
}

/// @param observation whose view is in range
template <typename Camera>
void check_right(bundle<Camera> const& map, std::size_t observation) {
  if (!has_right(map, observation)) { return; }
  require_finite("right_x", map.right_x[observation]);
  auto const view = static_cast<std::size_t>(map.observing_view[observation]);
  int const camera = map.camera_of_view.empty() ? 0 : map.camera_of_view[view];
  require(!map.baseline.empty() && map.baseline[static_cast<std::size_t>(camera)] > 0,
          "`right_x` is there, but the view's camera has no baseline");
}

template <typename Camera>
void check_observations(bundle<Camera> const& map) {
  std::size_t const count = map.observing_view.size();
  require(map.observed_point.size() == count && map.pixel.size() == count,
          "arrays of a bundle's observations differ in length");
  require(map.sigma.empty() || map.sigma.size() == count,
          "`sigma` of a bundle has as many entries as there are observations, or none");
  require(map.right_x.empty() || map.right_x.size() == count,
          "`right_x` of a bundle has as many entries as there are observations, or none");
  int const views = static_cast<int>(map.T_cw.size());
  int const points = static_cast<int>(map.position.size());
  for (std::size_t i = 0; i < count; ++i) {
    check_named("observation", i, [&] {
      require_range("view of an observation", map.observing_view[i], 0, views - 1);
      require_range("point of an observation", map.observed_point[i], 0, points - 1);
      require_finite("pixel", map.pixel[i].x);
      require_finite("pixel", map.pixel[i].y);
      if (!map.sigma.empty()) { require_range("sigma", map.sigma[i], 1e-6, 1e6); }
      check_right(map, i);
    });
  }
}

/// @throws bad_argument for a point that is not seen in two images
template <typename Camera>
void check_tracks(bundle<Camera> const& map) {
  constexpr int unseen = -1;
  constexpr int seen_twice = -2;
  std::vector<int> seen(map.position.size(), unseen);
  for (std::size_t i = 0; i < map.observing_view.size(); ++i) {
    int& by = seen[static_cast<std::size_t>(map.observed_point[i])];
    int const view = map.observing_view[i];
    if (has_right(map, i)) {
      by = seen_twice;
    } else if (by == unseen) {
      by = view;
    } else if (by != view) {
      by = seen_twice;
    }
  }
  for (std::size_t p = 0; p < seen.size(); ++p) {
    check_named("point", p, [&] {
      require(seen[p] == seen_twice,
              "a point is seen in no right image, and from less than two views");
    });
  }
}

}  // namespace detail

/// @throws bad_argument for a bundle that cannot be adjusted; the message names the camera, the
///   view, the point or the observation
template <typename Camera>
void check(bundle<Camera> const& map) {
  constexpr std::size_t most = 1 << 28;  // indices have 32 bits
  detail::require_range("views of a bundle", map.T_cw.size(), std::size_t{0}, most / 256);
  detail::require_range("points of a bundle", map.position.size(), std::size_t{0}, most);
  detail::require_range("observations of a bundle", map.observing_view.size(), std::size_t{0},
                        most);
  detail::check_views(map);
  for (std::size_t i = 0; i < map.position.size(); ++i) {
    detail::check_named("point", i, [&] {
      vec3<double> const& X = map.position[i];
      for (double const v : {X.x, X.y, X.z}) { detail::require_finite("position", v); }
    });
  }
  detail::check_observations(map);
  detail::check_tracks(map);
}

}  // namespace FT_ABI
}  // namespace ft
