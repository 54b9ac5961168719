// SPDX-License-Identifier: Apache-2.0
/// @file Checks that a calibration can be inverted on the pixels of its image.
#pragma once

#include <cmath>
#include <limits>
#include <string>

#include "ft/cameras/camera_model.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"

namespace ft {
inline namespace FT_ABI {

/// Round trips of a camera model on a grid of pixels of an image.
struct image_domain {
  static constexpr double tolerance = 1e-6;  ///< pixels, round trips in double

  int pixels = 0;    ///< tested
  int with_ray = 0;  ///< of `pixels`: unproject() gives a valid ray
  /// Of `with_ray`: the ray's projection is valid and within `tolerance` of the pixel.
  int returned = 0;
  /// Largest distance between a pixel and its ray's projection, pixels; infinity if a valid ray has
  /// no valid projection.
  double worst_error = 0;
  double worst_x = 0;  ///< the pixel of worst_error
  double worst_y = 0;

  /// Share of the pixels with a valid ray, 0 to 1.
  double share_with_ray() const { return pixels > 0 ? static_cast<double>(with_ray) / pixels : 0; }
};

/// Unprojects and projects, in double, a grid of at most 65 x 65 pixels evenly spread over the
/// image, including its first and last rows and columns. Host; allocates nothing.
/// @param width,height pixels, in [1, 16384]
/// @throws bad_argument for a calibration that its check() rejects, or a size out of range
template <typename Camera>
image_domain inspect_image_domain(Camera const& camera, int width, int height) {
  detail::require_range("image width", width, 1, 16384);
  detail::require_range("image height", height, 1, 16384);
  camera.check();
  auto const wide = camera.template cast<double>();
  int const columns = min_of(width, 65);
  int const rows = min_of(height, 65);
  image_domain found;
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      double const x = columns > 1 ? (width - 1.0) * column / (columns - 1) : 0.0;
      double const y = rows > 1 ? (height - 1.0) * row / (rows - 1) : 0.0;
      ++found.pixels;
      auto const ray = wide.unproject({x, y});
      if (!ray.valid) { continue; }
      ++found.with_ray;
      auto const seen = wide.project(ray.direction);
      double error = std::numeric_limits<double>::infinity();
      if (seen.valid && std::isfinite(seen.pixel.x) && std::isfinite(seen.pixel.y)) {
        error = std::hypot(seen.pixel.x - x, seen.pixel.y - y);
      }
      if (error <= image_domain::tolerance) { ++found.returned; }
      if (error > found.worst_error) {
        found.worst_error = error;
        found.worst_x = x;
        found.worst_y = y;
      }
    }
  }
  return found;
}

/// Rejects a calibration that does not describe its image: a valid ray that does not return to its
/// pixel, or too few pixels with a ray. Host; see inspect_image_domain().
/// @param least_share of the pixels, 0 to 1. The default accepts fisheyes with dark corners, and
///   those whose model has no rays beyond 90 degrees. A circle that touches two sides of a 4:3
///   image covers 0.59 of it; that of a 16:9 image covers 0.44 and needs a smaller value. Use 1 if
///   the lens illuminates the whole image: then a distortion that folds back anywhere is rejected.
/// @throws bad_argument with the numbers
template <typename Camera>
void require_invertible(Camera const& camera, int width, int height, double least_share = 0.5) {
  detail::require_range("least share of pixels with a ray", least_share, 0.0, 1.0);
  image_domain const found = inspect_image_domain(camera, width, height);
  std::string const which = std::string("ft: camera ") + Camera::name + " on an image of " +
                            std::to_string(width) + " x " + std::to_string(height) + " pixels: ";
  if (found.returned < found.with_ray) {
    throw bad_argument(which + std::to_string(found.with_ray - found.returned) + " of " +
                       std::to_string(found.with_ray) +
                       " rays do not project back to their pixel; the worst, of pixel (" +
                       detail::number_text(found.worst_x) + ", " +
                       detail::number_text(found.worst_y) + "), misses it by " +
                       detail::number_text(found.worst_error) + " pixels, must be at most " +
                       detail::number_text(double{image_domain::tolerance}));
  }
  if (!(found.share_with_ray() >= least_share)) {
    throw bad_argument(which + "the share of pixels with a valid ray is " +
                       detail::number_text(found.share_with_ray()) + " (" +
                       std::to_string(found.with_ray) + " of " + std::to_string(found.pixels) +
                       "), must be at least " + detail::number_text(least_share));
  }
}

}  // namespace FT_ABI
}  // namespace ft
