// SPDX-License-Identifier: Apache-2.0
/// @file Places of the depth images of a tracker's next frame.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>

#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/views.hpp"
#include "ft/kernels/images/depth_association.hpp"
#include "ft/kernels/upload.hpp"
#include "ft/pipelines/detail/frame_images.hpp"
#include "ft/pipelines/detail/frame_memory.hpp"
#include "ft/types/images.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The places of the depth images of a batch.
struct depth_places {
  depth_source* of = nullptr;  ///< [entries]
};
inline void carve(carver& c, depth_places& v, int entries) {
  v.of = c.take<depth_source>(static_cast<std::size_t>(entries));
}

/// Of a depth image only the pixels of keypoints are read, so it is not uploaded: it stays where it
/// is, or is copied to staging memory if the executor cannot read it there.
template <typename Exec>
class depth_input {
public:
  static constexpr memory_space staging = staging_space<Exec>;

  depth_input() = default;
  /// @param entries of the table of places @param images at most, that are given
  depth_input(int width, int height, int entries, int images)
      : places_(entries), width_(width), height_(height), entries_(entries) {
    if (Exec::asynchronous && images > 0) {
      staged_ = buffer<float, staging>(
          checked_mul(static_cast<std::size_t>(images), static_cast<std::size_t>(pixels())));
    }
  }

  depth_sources_view view() const { return {places_.device.of, width_, height_, entries_}; }
  block_source source() const { return places_.source(); }
  allocated_bytes allocated() const {
    return places_.allocated() + allocated_bytes{0, staged_.bytes()};
  }
  /// @param scaled whether the unit of images of 16 bits is known
  /// @throws bad_argument for an image that is null or of another size or format
  void require_depth(depth_view const& depth, bool scaled) const {
    require(depth.data != nullptr, "the depth image is null");
    require(depth.is_float || scaled,
            "a depth image of 16 bits needs rgbd_rig::depth_scale, metres per unit: 0.001 for "
            "millimetres");
    require_size("depth image", {depth.width, depth.height}, {width_, height_});
    auto const row = static_cast<std::ptrdiff_t>(width_) * pixel_bytes(depth);
    if (depth.pitch < row) {
      throw bad_argument("ft: the depth image has " + std::to_string(depth.pitch) +
                         " bytes from row to row, must be at least " + std::to_string(row));
    }
  }
  /// @param image number of the image among those that are given
  void take(int entry, int image, depth_view const& depth) {
    places_.host.of[entry] = place_of(image, depth);
  }
  /// Says that an entry has no image.
  void leave_out(int entry) { places_.host.of[entry] = {}; }

private:
  std::ptrdiff_t pixels() const { return static_cast<std::ptrdiff_t>(width_) * height_; }
  static std::ptrdiff_t pixel_bytes(depth_view const& depth) {
    return depth.is_float ? std::ptrdiff_t{sizeof(float)} : std::ptrdiff_t{sizeof(std::uint16_t)};
  }
  depth_source place_of(int image, depth_view const& depth) const {
    auto const* const first = static_cast<char const*>(depth.data);
    std::ptrdiff_t const row = width_ * pixel_bytes(depth);
    char const* const last = first + (height_ - 1) * depth.pitch + (row - 1);
    void const* const there = Exec::host_address(first);
    if (there != nullptr && Exec::host_address(last) != nullptr) {
      return {there, depth.pitch, depth.is_float ? 1 : 0};
    }
    auto* const to = reinterpret_cast<char*>(staged_.data() + image * pixels());
    for (int y = 0; y < height_; ++y) {
      std::memcpy(to + y * row, first + y * depth.pitch, static_cast<std::size_t>(row));
    }
    return {to, row, depth.is_float ? 1 : 0};
  }

  twin<depth_places, Exec::space, staging> places_;
  int width_ = 0;
  int height_ = 0;
  int entries_ = 0;
  buffer<float, staging> staged_;  ///< [images][image], large enough for both formats
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
