// SPDX-License-Identifier: Apache-2.0
/// @file Stage: rectification. A fixed-point map from target to source pixels, made from two camera
/// models or given, and the bilinear lookup through it: the pixels of
/// cv::remap(CV_16SC2 + CV_16UC1, INTER_LINEAR, BORDER_CONSTANT) on 8-bit images.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "ft/cameras/camera_model.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/math.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/views.hpp"
#include "ft/kernels/detail/transfer_pixel.hpp"

namespace ft {
inline namespace FT_ABI {

/// Equally sized images at equal distances. `stride` and `step` in elements.
template <typename T>
struct image_batch_view {
  T* data = nullptr;
  int width = 0;
  int height = 0;
  int stride = 0;           ///< from row to row
  std::ptrdiff_t step = 0;  ///< from image to image
  int batch = 0;

  FT_HOST_DEVICE image_view<T> operator[](int image) const {
    return {data + image * step, width, height, stride};
  }
  /// To a view that only reads.
  template <typename U, typename = std::enable_if_t<std::is_same<U, T const>::value &&
                                                    !std::is_const<T>::value>>
  FT_HOST_DEVICE operator image_batch_view<U>() const {  // NOLINT(google-explicit-constructor)
    return {data, width, height, stride, step, batch};
  }
};
static_assert(std::is_trivially_copyable<image_batch_view<std::uint8_t>>::value,
              "passed to kernels");

/// One level of every image of a pyramid; level 0 is where rectified images go for extraction. A
/// pyramid of one level is an owner of a batch of images.
inline image_batch_view<std::uint8_t> level_images(image_pyramid_view const& pyramid, int level) {
  detail::require_range("pyramid level", level, 0, pyramid.geometry.levels - 1);
  auto const first = pyramid.level(0, level);
  return {first.data,   first.width, first.height, first.stride, pyramid.geometry.bytes,
          pyramid.batch};
}

/// Upper left source pixel of a target pixel. The four neighbours may lie outside the source.
struct remap_position {
  std::int16_t x, y;
};

/// Source position in steps of 1/32 of a pixel. `fraction` is 32 * (y part) + (x part), 0 to 1023.
struct remap_entry {
  remap_position position;
  std::uint16_t fraction;

  /// A target pixel without a source: far outside every image, so that it gets the border value.
  FT_HOST_DEVICE static constexpr remap_entry none() { return {{-32768, -32768}, 0}; }
};

namespace detail {

/// Nearest multiple of 1/32, halves to even, counted in 1/32; the lowest int for NaN and what no
/// int can hold (as OpenCV's cvRound does on x86). Does not depend on the rounding mode.
FT_HOST_DEVICE inline int to_32nds(double v) {
  double const scaled = v * 32.0;  // exact
  if (!(scaled >= -2147483648.0 && scaled < 2147483647.5)) { return -2147483647 - 1; }
  double const below = ::floor(scaled);
  double const rest = scaled - below;  // exact
  int const i = static_cast<int>(below);
  return rest > 0.5 || (rest == 0.5 && (i & 1) != 0) ? i + 1 : i;
}

FT_HOST_DEVICE inline std::int16_t to_int16(int v) {
  return static_cast<std::int16_t>(clamp(v, -32768, 32767));
}

}  // namespace detail

/// Fixed point of a source position in pixels, (0, 0) = centre of the first pixel: what
/// cv::convertMaps(CV_16SC2) makes of a float map. NaN and numbers beyond an int, infinity
/// included, become the coordinate -32768.
FT_HOST_DEVICE inline remap_entry make_remap_entry(double x, double y) {
  int const ix = detail::to_32nds(x);
  int const iy = detail::to_32nds(y);
  // Division that rounds down, without shifting negative numbers.
  int const fx = ix & 31;
  int const fy = iy & 31;
  return {{detail::to_int16((ix - fx) / 32), detail::to_int16((iy - fy) / 32)},
          static_cast<std::uint16_t>(32 * fy + fx)};
}

/// What a table maps between, pixels; each 1 to 16384.
struct remap_sizes {
  int width = 0;  ///< of the target
  int height = 0;
  int source_width = 0;
  int source_height = 0;

  /// @throws bad_argument naming the value and the limit
  void check() const {
    detail::require_range("remap width", width, 1, max_image_side);
    detail::require_range("remap height", height, 1, max_image_side);
    detail::require_range("remap source width", source_width, 1, max_image_side);
    detail::require_range("remap source height", source_height, 1, max_image_side);
  }
};

/// Source position of every target pixel, row-major, one map per batch entry. Image i of a batch
/// goes through map `i % batch`: two maps serve any number of left and right images in turn.
struct remap_table_view {
  remap_sizes sizes;
  int batch = 0;
  remap_position* position = nullptr;  ///< [batch][height][width]
  std::uint16_t* fraction = nullptr;   ///< likewise

  FT_HOST_DEVICE std::ptrdiff_t pixels() const {
    return static_cast<std::ptrdiff_t>(sizes.width) * sizes.height;
  }
  /// Batch entry b alone.
  FT_HOST_DEVICE remap_table_view slice(int b) const {
    return {sizes, 1, position + b * pixels(), fraction + b * pixels()};
  }
};
static_assert(std::is_trivially_copyable<remap_table_view>::value, "passed to kernels");

inline constexpr int max_remap_batch = 4096;

namespace detail {

inline void require_table(remap_table_view const& table) {
  require(table.position != nullptr && table.fraction != nullptr, "the remap table is null");
  table.sizes.check();
  require_range("remap table's batch", table.batch, 1, max_remap_batch);
}

template <typename T>
void require_images(char const* name, image_batch_view<T> const& images, int width, int height) {
  if (images.data == nullptr) {
    throw bad_argument(std::string("ft: the ") + name + " images are null");
  }
  if (images.width != width || images.height != height) {
    throw bad_argument(std::string("ft: the ") + name + " images are " +
                       std::to_string(images.width) + "x" + std::to_string(images.height) +
                       ", the remap table is for " + std::to_string(width) + "x" +
                       std::to_string(height));
  }
  require_range("batch of images", images.batch, 1, max_remap_batch);
  require_range("image stride", images.stride, width, std::numeric_limits<int>::max());
  require(images.step >= 0, "the distance of two images is negative");
}

}  // namespace detail

/// Places a table into an arena. @throws bad_argument for sizes or a batch out of range
inline void carve(carver& c, remap_table_view& v, remap_sizes const& sizes, int batch) {
  sizes.check();
  detail::require_range("remap table's batch", batch, 1, max_remap_batch);
  v.sizes = sizes;
  v.batch = batch;
  std::size_t const n =
      detail::checked_mul(static_cast<std::size_t>(v.pixels()), static_cast<std::size_t>(batch));
  v.position = c.take<remap_position>(n);
  v.fraction = c.take<std::uint16_t>(n);
}

/// Owner of a table; move-only. Entries are not initialised.
template <memory_space Space>
class remap_table {
public:
  remap_table() = default;
  /// @param batch maps, 1 to 4096 @throws bad_argument, std::bad_alloc, cuda_error
  explicit remap_table(remap_sizes const& sizes, int batch = 1)
      : arena_([&](carver& c) { carve(c, view_, sizes, batch); }) {}
  remap_table(remap_table&& other) noexcept
      : view_(std::exchange(other.view_, {})), arena_(std::move(other.arena_)) {}
  remap_table& operator=(remap_table&& other) noexcept {
    view_ = std::exchange(other.view_, {});
    arena_ = std::move(other.arena_);
    return *this;
  }

  remap_table_view view() const { return view_; }
  std::size_t bytes() const { return arena_.bytes(); }

private:
  remap_table_view view_;
  arena<Space> arena_;
};

/// One row of a map from camera models of strict_double.
template <typename Source, typename Target>
struct fill_remap_row {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int y, Source const& source,
                                 mat3<strict_double> const& R_source_target, Target const& target,
                                 remap_table_view const& map) const {
    std::ptrdiff_t const row = static_cast<std::ptrdiff_t>(y) * map.sizes.width;
    for (int x = g.rank(); x < map.sizes.width; x += g.size()) {
      auto const p = detail::transfer_pixel(target, R_source_target, source,
                                            {static_cast<double>(x), static_cast<double>(y)});
      remap_entry const e =
          p.valid ? make_remap_entry(p.pixel.x.value, p.pixel.y.value) : remap_entry::none();
      map.position[row + x] = e.position;
      map.fraction[row + x] = e.fraction;
    }
  }
};

/// Map `entry` of a table from camera models: each target pixel's ray, turned into the source
/// camera and projected there, rounded to 1/32 of a pixel (halves to even). Target pixels without a
/// ray or without a place in the source camera get remap_entry::none(). Computed in double: the
/// same on every executor, but for models with an arc tangent or tangent, where an entry that is
/// within about 1e-13 pixels of a rounding limit may differ by 1/32. Asynchronous on `exec`;
/// allocates nothing; one launch.
/// @param source the camera that took the images @param target the camera wanted, any model
/// @param R_source_target turns rays of the target camera into the source camera (the transpose of
///   what OpenCV's initUndistortRectifyMap calls R)
/// @throws bad_argument for a null table, an entry outside it, a camera that cannot be, or a matrix
///   that is not a rotation
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
  using stage = fill_remap_row<std::decay_t<decltype(to)>, std::decay_t<decltype(from)>>;
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

/// Map `entry` from `at(x, y)`, a remap_entry for every target pixel.
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

/// Map `entry` of a table from source columns and rows in float, pixels, in host memory: what
/// cv::convertMaps(CV_16SC2) makes of them (see make_remap_entry for NaN and large numbers).
/// For set-up: allocates staging memory and waits until the table is filled.
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

/// Likewise from a map that is in fixed point already: OpenCV's CV_16SC2 and CV_16UC1, in host
/// memory, strides in elements. Of a fraction the lower 10 bits count, as in cv::remap.
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

/// One row of one target image.
struct rectify_row {
  static constexpr bool wide_on_host = true;
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item,
                                 image_batch_view<std::uint8_t const> const& source,
                                 remap_table_view const& table,
                                 image_batch_view<std::uint8_t> const& target,
                                 std::uint8_t border) const {
    int const image = item / target.height;
    int const y = item % target.height;
    auto const from = source[image];
    std::uint8_t* const out = target[image].row(y);
    remap_table_view const map = table.slice(image % table.batch);
    std::ptrdiff_t const first = static_cast<std::ptrdiff_t>(y) * target.width;
    int x = g.rank();
    if constexpr (Group::max_threads == 1) {
      for (; x + run <= target.width; x += run) {
        remap_position const* const positions = map.position + first + x;
        std::uint16_t const* const fractions = map.fraction + first + x;
        if (is_inner_run(positions, from)) {
          inner_run(from, positions, fractions, out + x);
        } else {
          for (int k = 0; k < run; ++k) {
            out[x + k] = pixel(from, positions[k], fractions[k], border);
          }
        }
      }
    }
    for (; x < target.width; x += g.size()) {
      out[x] = pixel(from, map.position[first + x], map.fraction[first + x], border);
    }
  }

private:
  static constexpr int run = 32;  ///< pixels that a thread alone takes together

  FT_HOST_DEVICE static std::uint8_t pixel(gray_view from, remap_position p, int fraction,
                                           std::uint8_t border) {
    int const fx = fraction & 31;
    int const fy = fraction >> 5 & 31;
    int p00 = border;
    int p10 = border;
    int p01 = border;
    int p11 = border;
    bool const left = p.x >= 0 && p.x < from.width;
    bool const right = p.x >= -1 && p.x + 1 < from.width;
    if (p.y >= 0 && p.y < from.height) {
      std::uint8_t const* const row = from.row(p.y);
      if (left) { p00 = row[p.x]; }
      if (right) { p10 = row[p.x + 1]; }
    }
    if (p.y >= -1 && p.y + 1 < from.height) {
      std::uint8_t const* const row = from.row(p.y + 1);
      if (left) { p01 = row[p.x]; }
      if (right) { p11 = row[p.x + 1]; }
    }
    return mixed(p00, p10, p01, p11, fx, fy);
  }

  /// Weights of 1024 in place of OpenCV's 32768: those are these times 32 (one of them less by 1 at
  /// whole pixels, which never changes the rounded sum), so the quotient is the same.
  FT_HOST_DEVICE FT_INLINE static std::uint8_t mixed(int p00, int p10, int p01, int p11, int fx,
                                                     int fy) {
    int const upper = p00 * (32 - fx) + p10 * fx;
    int const lower = p01 * (32 - fx) + p11 * fx;
    return static_cast<std::uint8_t>((upper * (32 - fy) + lower * fy + 512) >> 10);
  }

  /// Whether all four neighbours of all pixels of a run are in the image.
  FT_HOST_DEVICE FT_INLINE static bool is_inner_run(remap_position const* positions,
                                                    gray_view from) {
    int outside = 0;
    for (int k = 0; k < run; ++k) {
      int const x = positions[k].x;
      int const y = positions[k].y;
      outside |= x | y | (from.width - 2 - x) | (from.height - 2 - y);  // the sign of any
    }
    return outside >= 0 && from.stride <= 1 << 16;  // offsets fit into an int
  }

  /// The pixels of such a run: only the loads go one by one.
  FT_HOST_DEVICE FT_INLINE static void inner_run(gray_view from, remap_position const* positions,
                                                 std::uint16_t const* fractions,
                                                 std::uint8_t* out) {
    std::int32_t at[run];
    for (int k = 0; k < run; ++k) { at[k] = positions[k].y * from.stride + positions[k].x; }
    std::uint16_t upper[run];  // two neighbours in each
    std::uint16_t lower[run];
    for (int k = 0; k < run; ++k) {
      std::memcpy(upper + k, from.data + at[k], 2);
      std::memcpy(lower + k, from.data + from.stride + at[k], 2);
    }
    for (int k = 0; k < run; ++k) {
      out[k] = mixed(upper[k] & 255, upper[k] >> 8, lower[k] & 255, lower[k] >> 8,
                     fractions[k] & 31, fractions[k] >> 5 & 31);
    }
  }
};

/// Every image of `source` through its map into `target`, bilinear: the pixels of cv::remap with
/// INTER_LINEAR and BORDER_CONSTANT. A neighbour outside the source counts as `border`, so image
/// edges blend into it. Bytes beside the target's rows stay. Asynchronous on `exec`; allocates
/// nothing; one launch for the batch.
/// @param source,target images in the executor's memory, as many of the one as of the other; they
///   must not overlap
/// @param table image i goes through map i % table.batch
/// @throws bad_argument for null views, sizes that are not the table's, strides below the width,
///   batches that differ or are no multiple of the table's
template <typename Exec>
void rectify(Exec const& exec, image_batch_view<std::uint8_t const> const& source,
             remap_table_view const& table, image_batch_view<std::uint8_t> const& target,
             std::uint8_t border = 0) {
  detail::require_table(table);
  detail::require_images("source", source, table.sizes.source_width, table.sizes.source_height);
  detail::require_images("target", target, table.sizes.width, table.sizes.height);
  if (source.batch != target.batch || source.batch % table.batch != 0) {
    throw bad_argument("ft: " + std::to_string(source.batch) + " source and " +
                       std::to_string(target.batch) + " target images for " +
                       std::to_string(table.batch) +
                       " maps, must be as many and a multiple of the maps");
  }
  detail::require(target.batch == 1 || target.step >= static_cast<std::ptrdiff_t>(target.stride) *
                                                              (target.height - 1) +
                                                          target.width,
                  "the target images overlap: their distance is below an image's size");
  for_each_item<per_block<128>>(exec, target.batch * target.height, rectify_row{}, source, table,
                                target, border);
}

}  // namespace FT_ABI
}  // namespace ft
