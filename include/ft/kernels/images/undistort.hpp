// SPDX-License-Identifier: Apache-2.0
/// @file Stage: undistorts keypoints, and the bounds of an image.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <type_traits>

#include "ft/cameras/camera_model.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/soa.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// Only positions. Any container with field::x and field::y converts to it, keypoints included.
using pixels_view = soa_view<field::x, field::y>;
template <memory_space Space>
using pixels = soa<Space, field::x, field::y>;

/// Output of undistort_keypoints().
struct undistorted_view {
  pixels_view positions;          ///< same shape as the input, may alias it; gets the counts
  std::uint8_t* valid = nullptr;  ///< [batch][capacity] 1 or 0; may be null
};

namespace detail {

/// @throws bad_argument for a view without memory or entries, or with more entries than an int
/// holds
inline void require_pixels(char const* name, pixels_view const& v) {
  if (array_of<field::x>(v) == nullptr || array_of<field::y>(v) == nullptr || v.count == nullptr) {
    throw bad_argument(std::string("ft: the ") + name + " are null");
  }
  if (v.capacity < 1 || v.batch < 1 || v.capacity > std::numeric_limits<int>::max() / v.batch) {
    throw bad_argument(std::string("ft: the ") + name + " have capacity " +
                       std::to_string(v.capacity) + " and batch " + std::to_string(v.batch) +
                       ", each must be 1 or more and their product fit an int");
  }
}

template <typename A, typename B>
void require_same_shape(char const* names, A const& a, B const& b) {
  if (a.capacity != b.capacity || a.batch != b.batch) {
    throw bad_argument(std::string("ft: ") + names + " have capacities " +
                       std::to_string(a.capacity) + " and " + std::to_string(b.capacity) +
                       ", batches " + std::to_string(a.batch) + " and " + std::to_string(b.batch) +
                       ", must be equal");
  }
}

/// Item: a keypoint. Camera models have the scalar strict_double.
template <typename Source, typename Target>
struct undistort_keypoint {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, Source const& camera,
                                 mat3<strict_double> const& R_target_source, Target const& target,
                                 pixels_view const& raw, undistorted_view const& to) const {
    pixels_view const& out = to.positions;
    int const image = item / raw.capacity;
    int const i = item % raw.capacity;
    int const count = raw.count[image];
    if (i == 0 && out.count != raw.count) { out.count[image] = count; }
    if (i >= count) { return; }
    float const x = raw.x(item);
    float const y = raw.y(item);
    auto const p = transfer_pixel(camera, R_target_source, target,
                                  {static_cast<double>(x), static_cast<double>(y)});
    auto const u = static_cast<float>(p.pixel.x.value);
    auto const v = static_cast<float>(p.pixel.y.value);
    bool const good = p.valid && scalar::is_finite(u) && scalar::is_finite(v);
    out.x(item) = good ? u : x;
    out.y(item) = good ? v : y;
    if (to.valid != nullptr) { to.valid[item] = static_cast<std::uint8_t>(good); }
  }
};

}  // namespace detail

/// Computes where keypoints would be in an image of the camera `target`: rotates the ray of each
/// keypoint by `R_target_source` and projects it.
///
/// Computed in double and rounded to float once, so that host and device agree. The rounding also
/// hides the last bit of an arc tangent or tangent in a model. A keypoint that has no ray in
/// `camera` or no projection in `target` keeps its raw position and is marked invalid. Entries past
/// a count are not written. Asynchronous on `exec`; allocates nothing; one launch.
/// @param raw extracted positions, pixels
/// @throws bad_argument for null views, different shapes, an invalid camera, or a matrix that is
///   not a rotation
template <typename Exec, typename Source, typename Target>
void undistort_keypoints(Exec const& exec, Source const& camera, Target const& target,
                         mat3<double> const& R_target_source, pixels_view const& raw,
                         undistorted_view const& out) {
  static_assert(is_camera_model_v<Source> && is_camera_model_v<Target>,
                "camera models as in cameras/camera_model.hpp");
  camera.check();
  target.check();
  detail::require_rotation(R_target_source);
  detail::require_pixels("raw keypoints", raw);
  detail::require_pixels("undistorted keypoints", out.positions);
  detail::require_same_shape("raw and undistorted keypoints", raw, out.positions);
  auto const from = camera.template cast<strict_double>();
  auto const to = target.template cast<strict_double>();
  using stage =
      detail::undistort_keypoint<std::decay_t<decltype(from)>, std::decay_t<decltype(to)>>;
  for_each_item<per_thread>(exec, raw.batch * raw.capacity, stage{}, from,
                            detail::strict_rotation(R_target_source), to, raw, out);
}

/// The same without rotation.
template <typename Exec, typename Source, typename Target>
void undistort_keypoints(Exec const& exec, Source const& camera, Target const& target,
                         pixels_view const& raw, undistorted_view const& out) {
  undistort_keypoints(exec, camera, target, mat3<double>::identity(), raw, out);
}

/// A rectangle of pixels, as grid_geometry::over() takes it.
struct image_bounds {
  float min_x, min_y, max_x, max_y;
};

/// Bounds of the undistorted image, from its four corners (0, 0), (width, 0), (0, height) and
/// (width, height): from the smaller x of the left ones to the larger x of the right ones, and
/// likewise for y. If every corner stays within 1e-6 pixels, the bounds are exactly the image's.
/// Runs on the host; allocates nothing.
/// @param R_target_source as in undistort_keypoints()
/// @throws bad_argument for sizes out of range, an invalid camera, a corner without a ray (as with
///   very wide lenses, whose images are used undistorted), or bounds without area
template <typename Source, typename Target>
image_bounds undistorted_bounds(Source const& camera, Target const& target, int width, int height,
                                mat3<double> const& R_target_source = mat3<double>::identity()) {
  detail::require_range("image width", width, 1, 16384);
  detail::require_range("image height", height, 1, 16384);
  camera.check();
  target.check();
  detail::require_rotation(R_target_source);
  auto const from = camera.template cast<strict_double>();
  auto const to = target.template cast<strict_double>();
  auto const R = detail::strict_rotation(R_target_source);
  double x[4];
  double y[4];
  bool moved = false;
  for (int i = 0; i < 4; ++i) {
    double const u = i % 2 == 0 ? 0.0 : width;
    double const v = i / 2 == 0 ? 0.0 : height;
    auto const p = detail::transfer_pixel(from, R, to, {u, v});
    if (!p.valid) {
      throw bad_argument("ft: the image corner (" + std::to_string(static_cast<int>(u)) + ", " +
                         std::to_string(static_cast<int>(v)) +
                         ") has no place in the undistorted image");
    }
    x[i] = p.pixel.x.value;
    y[i] = p.pixel.y.value;
    moved = moved || std::abs(x[i] - u) > 1e-6 || std::abs(y[i] - v) > 1e-6;
  }
  if (!moved) { return {0, 0, static_cast<float>(width), static_cast<float>(height)}; }
  image_bounds const b{
      static_cast<float>(min_of(x[0], x[2])), static_cast<float>(min_of(y[0], y[1])),
      static_cast<float>(max_of(x[1], x[3])), static_cast<float>(max_of(y[2], y[3]))};
  detail::require(b.min_x < b.max_x && b.min_y < b.max_y,
                  "the undistorted image bounds have no area");
  return b;
}

}  // namespace FT_ABI
}  // namespace ft
