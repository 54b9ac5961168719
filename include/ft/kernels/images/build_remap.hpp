// SPDX-License-Identifier: Apache-2.0
/// @file Stage: maps for rectification, computed from two camera models or given by the caller.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <type_traits>
#include <vector>

#include "ft/cameras/camera_model.hpp"
#include "ft/containers/remap_table.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/views.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Item: a row of a map. Camera models have the scalar strict_double.
template <typename Source, typename Target>
struct fill_remap_row {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int y, Source const& source,
                                 mat3<strict_double> const& R_source_target, Target const& target,
                                 remap_table_view const& map) const {
    std::ptrdiff_t const row = static_cast<std::ptrdiff_t>(y) * map.sizes.width;
    for (int x = g.rank(); x < map.sizes.width; x += g.size()) {
      auto const p = transfer_pixel(target, R_source_target, source,
                                    {static_cast<double>(x), static_cast<double>(y)});
      remap_entry const e =
          p.valid ? make_remap_entry(p.pixel.x.value, p.pixel.y.value) : remap_entry::none();
      map.position[row + x] = e.position;
      map.fraction[row + x] = e.fraction;
    }
  }
};

}  // namespace detail

/// Computes map `entry` of a table from camera models: rotates each target pixel's ray into the
/// source camera, projects it there and rounds to 1/32 of a pixel (halves to even).
///
/// Target pixels without a ray, or without a projection in the source camera, get
/// remap_entry::none(). Computed in double; all executors agree. Asynchronous on `exec`; allocates
/// nothing; one launch.
/// @param source camera that took the images
/// @param target camera of the rectified images, any model
/// @param R_source_target rotates rays of the target camera into the source camera: the transpose
///   of R of OpenCV's initUndistortRectifyMap
/// @throws bad_argument for a null table, an entry outside it, an invalid camera, or a matrix that
///   is not a rotation
template <typename Exec, typename Source, typename Target>
void build_remap(Exec const& exec, Source const& source, mat3<double> const& R_source_target,
                 Target const& target, remap_table_view const& table, int entry = 0) {
  static_assert(is_camera_model_v<Source> && is_camera_model_v<Target>,
                "camera models as in cameras/camera_model.hpp");
  detail::require_table(table);
  detail::require_range("map of the remap table", entry, 0, table.batch - 1);
  source.check();
  target.check();
  detail::require_rotation(R_source_target);
  auto const from = target.template cast<strict_double>();
  auto const to = source.template cast<strict_double>();
  using stage = detail::fill_remap_row<std::decay_t<decltype(to)>, std::decay_t<decltype(from)>>;
  for_each_item<per_block<128>>(exec, table.sizes.height, stage{}, to,
                                detail::strict_rotation(R_source_target), from, table.slice(entry));
}

namespace detail {

template <typename T>
void require_map(image_view<T> const& map, remap_sizes const& sizes) {
  require(map.data != nullptr, "the given map is null");
  if (map.width != sizes.width || map.height != sizes.height) {
    throw bad_argument("ft: the given map is " + std::to_string(map.width) + "x" +
                       std::to_string(map.height) + ", the remap table " +
                       std::to_string(sizes.width) + "x" + std::to_string(sizes.height));
  }
  require(map.stride >= map.width, "the given map's stride is below its width");
}

/// Fills map `entry` with at(x, y), a remap_entry for every target pixel.
template <typename Exec, typename At>
void load_entries(Exec const& exec, remap_table_view const& table, int entry, At const& at) {
  auto const n = static_cast<std::size_t>(table.pixels());
  std::vector<remap_position> position(n);
  std::vector<std::uint16_t> fraction(n);
  std::size_t i = 0;
  for (int y = 0; y < table.sizes.height; ++y) {
    for (int x = 0; x < table.sizes.width; ++x, ++i) {
      remap_entry const e = at(x, y);
      position[i] = e.position;
      fraction[i] = e.fraction;
    }
  }
  remap_table_view const to = table.slice(entry);
  copy(exec, to.position, static_cast<remap_position const*>(position.data()), n);
  copy(exec, to.fraction, static_cast<std::uint16_t const*>(fraction.data()), n);
  exec.wait();
}

}  // namespace detail

/// Fills map `entry` of a table from source columns and rows in float, pixels, in host memory.
/// Rounds as cv::convertMaps(CV_16SC2) does; see make_remap_entry() for NaN and large numbers. For
/// set-up: allocates host memory and waits until the table is filled.
/// @throws bad_argument for null or differently sized maps, or an entry outside the table
template <typename Exec>
void load_remap(Exec const& exec, image_view<float const> const& map_x,
                image_view<float const> const& map_y, remap_table_view const& table,
                int entry = 0) {
  detail::require_table(table);
  detail::require_range("map of the remap table", entry, 0, table.batch - 1);
  detail::require_map(map_x, table.sizes);
  detail::require_map(map_y, table.sizes);
  detail::load_entries(exec, table, entry, [&](int x, int y) {
    return make_remap_entry(static_cast<double>(map_x(x, y)), static_cast<double>(map_y(x, y)));
  });
}

/// The same from a map in fixed point: OpenCV's CV_16SC2 and CV_16UC1, in host memory, strides in
/// elements. Only the lower 10 bits of a fraction count, as in cv::remap.
template <typename Exec>
void load_remap(Exec const& exec, image_view<remap_position const> const& position,
                image_view<std::uint16_t const> const& fraction, remap_table_view const& table,
                int entry = 0) {
  detail::require_table(table);
  detail::require_range("map of the remap table", entry, 0, table.batch - 1);
  detail::require_map(position, table.sizes);
  detail::require_map(fraction, table.sizes);
  detail::load_entries(exec, table, entry, [&](int x, int y) {
    return remap_entry{position(x, y), static_cast<std::uint16_t>(fraction(x, y) & 1023)};
  });
}

}  // namespace FT_ABI
}  // namespace ft
