// SPDX-License-Identifier: Apache-2.0
/// @file Stage: depths of keypoints from a registered depth image (RGB-D), as stereo matches with a
/// virtual right camera. Source: Mur-Artal and Tardos, "ORB-SLAM2: an open-source SLAM system for
/// monocular, stereo and RGB-D cameras", T-RO 2017, section III.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <type_traits>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/views.hpp"
#include "ft/kernels/images/undistort.hpp"

namespace ft {
inline namespace FT_ABI {

/// Depth images of a batch, registered to the grey ones. @tparam T float or std::uint16_t
template <typename T>
struct depth_images_view {
  static_assert(std::is_same<T, float>::value || std::is_same<T, std::uint16_t>::value,
                "depth is float or 16-bit unsigned");
  T const* data = nullptr;
  int width = 0;
  int height = 0;
  std::ptrdiff_t pitch = 0;  ///< bytes from row to row
  std::ptrdiff_t step = 0;   ///< bytes from image to image
  int batch = 0;

  /// A pixel of image b. @pre inside the image
  FT_HOST_DEVICE T at(int b, int x, int y) const {
    char const* const row = reinterpret_cast<char const*>(data) + b * step + y * pitch;
    return reinterpret_cast<T const*>(row)[x];
  }
};
static_assert(std::is_trivially_copyable<depth_images_view<float>>::value, "passed to kernels");

/// Where the pixels of a depth image are.
struct depth_source {
  void const* data = nullptr;  ///< memory that the executor's threads can read
  std::ptrdiff_t pitch = 0;    ///< bytes from row to row
  int is_float = 0;
};

/// Depth images of a batch, each in a place and a format of its own.
struct depth_sources_view {
  depth_source const* of = nullptr;  ///< [batch]
  int width = 0;
  int height = 0;
  int batch = 0;

  /// A pixel of image b. @pre inside the image
  FT_HOST_DEVICE float at(int b, int x, int y) const {
    depth_source const& from = of[b];
    char const* const row = static_cast<char const*>(from.data) + y * from.pitch;
    if (from.is_float != 0) { return reinterpret_cast<float const*>(row)[x]; }
    return static_cast<float>(reinterpret_cast<std::uint16_t const*>(row)[x]);
  }
};
static_assert(std::is_trivially_copyable<depth_sources_view>::value, "passed to kernels");

/// Parameters of associate_depth().
struct depth_params {
  float bf = 0;         ///< virtual baseline times fx of the undistorted camera, metres * pixels
  float scale = 1;      ///< metres per unit of the depth image: 1 / 5000 for 16-bit images of TUM
  float min_depth = 0;  ///< metres; smaller depths give no match
  float max_depth =
      std::numeric_limits<float>::infinity();  ///< metres; larger depths give no match
};

/// @throws bad_argument naming the value and the limit
inline void check(depth_params const& p) {
  detail::require_range("baseline x fx", p.bf, 1e-9f, 1e12f);
  detail::require_range("depth scale", p.scale, 1e-9f, 1e9f);
  detail::require_range("min_depth", p.min_depth, 0.0f, std::numeric_limits<float>::max());
  detail::require_range("max_depth", p.max_depth, p.min_depth,
                        std::numeric_limits<float>::infinity());
}

namespace detail {

/// Item: a keypoint.
/// @tparam Images depth_images_view or depth_sources_view
template <typename Images>
struct associate_keypoint_depth {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, pixels_view const& raw,
                                 pixels_view const& undistorted, Images const& images,
                                 depth_params const& params, stereo_matches_view const& out) const {
    int const image = item / raw.capacity;
    int const i = item % raw.capacity;
    int const count = raw.count[image];
    if (i == 0) { out.count[image] = count; }
    float depth = -1;
    float right_x = -1;
    int score = -1;
    if (i < count) {
      float const u = raw.x(item);
      float const v = raw.y(item);
      // Inside after truncation. NaN is outside.
      if (u > -1.0f && u < static_cast<float>(images.width) && v > -1.0f &&
          v < static_cast<float>(images.height)) {
        auto const value =
            static_cast<float>(images.at(image, static_cast<int>(u), static_cast<int>(v)));
        strict_float const d = strict_float(value) * params.scale;
        strict_float const column = undistorted.x(item) - params.bf / d;
        if (d > 0.0f && d >= params.min_depth && d <= params.max_depth && scalar::is_finite(d) &&
            scalar::is_finite(column)) {
          depth = d.value;
          right_x = column.value;
          score = 0;
        }
      }
    }
    out.depth(item) = depth;
    out.right_x(item) = right_x;
    out.score(item) = score;
  }
};

/// @throws bad_argument for what associate_depth() refuses, except of the images' memory
template <typename Images>
void require_association(pixels_view const& raw, pixels_view const& undistorted,
                         Images const& images, depth_params const& params,
                         stereo_matches_view const& out) {
  check(params);
  require_pixels("raw keypoints", raw);
  require_pixels("undistorted keypoints", undistorted);
  require_same_shape("raw and undistorted keypoints", raw, undistorted);
  require(array_of<field::right_x>(out) != nullptr && array_of<field::depth>(out) != nullptr &&
              array_of<field::score>(out) != nullptr && out.count != nullptr,
          "the matches are null");
  require_same_shape("keypoints and matches", raw, out);
  require_range("depth image width", images.width, 1, max_image_side);
  require_range("depth image height", images.height, 1, max_image_side);
  if (images.batch != raw.batch) {
    throw bad_argument("ft: " + std::to_string(images.batch) + " depth images for " +
                       std::to_string(raw.batch) + " images of keypoints, must be as many");
  }
}

}  // namespace detail

/// Computes depth and virtual right column of every keypoint, in strict float.
///
/// The depth is the pixel at the raw position, coordinates truncated towards zero, times the scale.
/// If it is positive, finite and within [min_depth, max_depth], right_x is the undistorted column
/// minus bf / depth and the score is 0. A right_x below 0 means that the virtual camera does not
/// see the point: it has a depth, but counts as monocular in later stages. All other entries get
/// -1, -1, -1: keypoints outside the depth image, NaN positions, and entries past a count.
/// Asynchronous on `exec`; allocates nothing; one launch.
/// @param raw extracted positions
/// @param undistorted the same keypoints from undistort_keypoints(), or `raw` again for a camera
///   without distortion
/// @param out same shape
/// @throws bad_argument for null views, different shapes, sizes or parameters out of range, rows
///   that overlap, or a pitch that is not a multiple of a pixel
template <typename Exec, typename T>
void associate_depth(Exec const& exec, pixels_view const& raw, pixels_view const& undistorted,
                     depth_images_view<T> const& images, depth_params const& params,
                     stereo_matches_view const& out) {
  detail::require(images.data != nullptr, "the depth images are null");
  detail::require_association(raw, undistorted, images, params, out);
  constexpr auto pixel = static_cast<std::ptrdiff_t>(sizeof(T));
  detail::require(images.pitch >= images.width * pixel,
                  "the depth images' pitch is below their width in bytes");
  detail::require(images.pitch % pixel == 0 && images.step % pixel == 0 && images.step >= 0 &&
                      reinterpret_cast<std::uintptr_t>(images.data) % sizeof(T) == 0,
                  "the depth images' address, pitch and step must be multiples of a pixel");
  for_each_item<per_thread>(exec, raw.batch * raw.capacity,
                            detail::associate_keypoint_depth<depth_images_view<T>>{}, raw,
                            undistorted, images, params, out);
}

/// The same with images that lie anywhere; the table of their places is read when the launch runs.
/// @pre each place of the table is that of an image of the stated size
template <typename Exec>
void associate_depth(Exec const& exec, pixels_view const& raw, pixels_view const& undistorted,
                     depth_sources_view const& images, depth_params const& params,
                     stereo_matches_view const& out) {
  detail::require(images.of != nullptr, "the table of depth images is null");
  detail::require_association(raw, undistorted, images, params, out);
  for_each_item<per_thread>(exec, raw.batch * raw.capacity,
                            detail::associate_keypoint_depth<depth_sources_view>{}, raw,
                            undistorted, images, params, out);
}

}  // namespace FT_ABI
}  // namespace ft
