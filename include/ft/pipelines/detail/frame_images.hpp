// SPDX-License-Identifier: Apache-2.0
/// @file Addresses of the images of a tracker's next frame in host memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/views.hpp"
#include "ft/kernels/upload.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

struct staged_images {
  int batch = 0;                    ///< rigs
  std::uint8_t* pixels = nullptr;   ///< [batch][images][image]
  image_source* sources = nullptr;  ///< [batch][images]
};

/// Which images of a frame no camera has: the right ones of single cameras, and both of those that
/// are not used.
template <typename Rig>
absent_images absent_images_of(Rig const& rig) {
  absent_images absent{0, Rig::images};
  if constexpr (Rig::rectified) {
    for (int c = 0; c < Rig::cameras; ++c) {
      absent.mask |= static_cast<std::uint32_t>(rig.pair(c).single()) << (2 * c + 1);
      if constexpr (Rig::cameras > 1) {
        absent.mask |= static_cast<std::uint32_t>(!rig.pair(c).used) << (2 * c);
      }
    }
  }
  return absent;
}

/// Pixels.
struct image_size {
  int width, height;
};

/// @param name such as "right image" @throws bad_argument with both sizes
inline void require_size(char const* name, image_size given, image_size wanted) {
  if (given.width == wanted.width && given.height == wanted.height) { return; }
  throw bad_argument(std::string("ft: the ") + name + " is " + std::to_string(given.width) + "x" +
                     std::to_string(given.height) + ", wanted " + std::to_string(wanted.width) +
                     "x" + std::to_string(wanted.height));
}

/// The images of a frame of a rig of several cameras, each of which may miss one.
/// @throws bad_argument for an image of another size, or if there is none
template <typename Images, typename Given>
void take_some(Images& images, int b, int count, Given const& given) {
  bool any = false;
  for (int i = 0; i < count; ++i) {
    any = any || (given[i].data != nullptr && !images.absent(images.number(b, i)));
  }
  require(any, "all images of the frame are null: a rig needs one of its cameras' images");
  for (int i = 0; i < count; ++i) {
    if (images.absent(images.number(b, i))) { continue; }
    if (given[i].data == nullptr) {
      images.leave_out(b, i);
    } else {
      images.take(b, i, given[i]);
    }
  }
}

/// Staging memory for the images of rigs, and the address from which frames fetch each image: that
/// memory, or a buffer of the caller. Images that no camera has are never fetched.
template <typename Exec>
class frame_images {
public:
  static constexpr memory_space staging = staging_space<Exec>;

  frame_images() = default;
  /// @param absent its period is the number of a rig's images
  frame_images(pyramid_geometry const& geometry, absent_images const& absent, int batch)
      : width_(geometry.width[0]),
        height_(geometry.height[0]),
        stride_(geometry.stride[0]),
        images_(absent.period),
        absent_(absent) {
    std::size_t const n = static_cast<std::size_t>(images_) * static_cast<std::size_t>(batch);
    memory_ = owner<staged_images, staging>([&](carver& c, staged_images& s) {
      s.batch = batch;
      s.pixels = c.take<std::uint8_t>(checked_mul(n, image_bytes()));
      s.sources = c.take<image_source>(n);
    });
    std::memset(memory_->pixels, 0, n * image_bytes());
    given_.assign(n, false);
    missing_.assign(static_cast<std::size_t>(batch), 0);
    for (int i = 0; i < images_ * batch; ++i) {
      memory_->sources[i] = {};
      if (!absent.has(i)) { use_own_memory(i); }
    }
  }

  void set(int b, int camera, gray_view image) {
    require_image(b, camera, image);
    std::uint8_t* const to = staged(b, camera);
    for (int y = 0; y < height_; ++y) {
      std::memcpy(to + static_cast<std::ptrdiff_t>(y) * stride_, image.row(y),
                  static_cast<std::size_t>(width_));
    }
  }
  void borrow(int b, int camera, gray_view image) {
    require_image(b, camera, image);
    require(image.stride % 16 == 0 && reinterpret_cast<std::uintptr_t>(image.data) % 16 == 0,
            "a borrowed image needs an address and a stride that are multiples of 16");
    auto const* const last = image.row(image.height - 1) + (image.stride - 1);
    auto const* const data = static_cast<std::uint8_t const*>(Exec::host_address(image.data));
    require(data != nullptr && Exec::host_address(last) != nullptr,
            "the device cannot read a borrowed image: is its memory pinned?");
    memory_->sources[number(b, camera)] = {data, image.stride};
    mark_given(b, camera);
  }
  /// borrow(), where the executor can read the pixels in place, otherwise set(). Unlike borrow() it
  /// asks for no readable bytes past a row's last pixel.
  void take(int b, int camera, gray_view image) {
    require_image(b, camera, image);
    bool const whole = image.width % 16 == 0 && image.stride % 16 == 0 &&
                       reinterpret_cast<std::uintptr_t>(image.data) % 16 == 0;
    void const* const from = whole ? Exec::host_address(image.data) : nullptr;
    if (from == nullptr ||
        Exec::host_address(image.row(image.height - 1) + (image.width - 1)) == nullptr) {
      set(b, camera, image);
      return;
    }
    memory_->sources[number(b, camera)] = {static_cast<std::uint8_t const*>(from), image.stride};
    mark_given(b, camera);
  }
  std::uint8_t* staged(int b, int camera) {
    require_camera(b, camera);
    mark_given(b, camera);
    return use_own_memory(number(b, camera));
  }
  /// The camera has no image in this frame: a black one stands for it.
  void leave_out(int b, int camera) {
    std::memset(staged(b, camera), 0, image_bytes());
    missing_[static_cast<std::size_t>(b)] |= 1u << camera;
  }
  /// Bit i: image i of rig b is one that was left out.
  std::uint32_t missing(int b) const { return missing_[static_cast<std::size_t>(b)]; }

  /// @throws bad_argument
  void require_camera(int b, int camera) const {
    require_range("camera pair", b, 0, memory_->batch - 1);
    require_range("camera", camera, 0, images_ - 1);
    require(!absent(number(b, camera)),
            "the rig has no such image: its camera is single, or not used");
  }
  void require_made() const { memory_.require_made("tracker"); }
  /// Number of an image in the batch.
  int number(int b, int camera) const { return images_ * b + camera; }
  /// Whether no camera has image i of the batch.
  bool absent(int i) const { return absent_.has(i); }
  /// @throws bad_argument if a camera has no image yet
  void require_given() const {
    require_made();
    for (std::size_t i = 0; i < given_.size(); ++i) {
      if (!given_[i] && !absent(static_cast<int>(i))) {
        auto const n = static_cast<std::size_t>(images_);
        throw bad_argument("ft: camera " + std::to_string(i % n) + " of pair " +
                           std::to_string(i / n) + " was never given an image");
      }
    }
  }

  int batch() const { return memory_->batch; }
  image_source const* sources() const { return memory_->sources; }  ///< [batch][images]
  /// Of all images that are fetched.
  std::size_t bytes() const {
    std::size_t fetched = 0;
    for (int i = 0; i < images_ * batch(); ++i) { fetched += absent(i) ? 0 : 1; }
    return fetched * image_bytes();
  }

  allocated_bytes allocated() const { return {0, memory_.bytes()}; }

private:
  std::size_t image_bytes() const {
    return static_cast<std::size_t>(stride_) * static_cast<std::size_t>(height_);
  }
  void mark_given(int b, int camera) {
    given_[static_cast<std::size_t>(number(b, camera))] = true;
    missing_[static_cast<std::size_t>(b)] &= ~(1u << camera);
  }
  std::uint8_t* use_own_memory(int image) {
    std::uint8_t* const data = memory_->pixels + static_cast<std::size_t>(image) * image_bytes();
    memory_->sources[image] = {data, stride_};
    return data;
  }
  /// "left image", "image 3", with the pair in a batch of several.
  std::string name(int b, int camera) const {
    std::string const which = images_ == 1   ? "image"
                              : images_ == 2 ? (camera == 0 ? "left image" : "right image")
                                             : "image " + std::to_string(camera);
    return batch() == 1 ? which : which + " of camera pair " + std::to_string(b);
  }
  void require_image(int b, int camera, gray_view image) const {
    require_camera(b, camera);
    if (image.data == nullptr) { throw bad_argument("ft: the " + name(b, camera) + " is null"); }
    if (image.width != width_ || image.height != height_) {  // no text of a name otherwise
      require_size(name(b, camera).c_str(), {image.width, image.height}, {width_, height_});
    }
    if (image.stride < image.width) {
      throw bad_argument("ft: the " + name(b, camera) + " has a stride of " +
                         std::to_string(image.stride) + ", must be at least its width of " +
                         std::to_string(image.width));
    }
  }

  int width_ = 0;
  int height_ = 0;
  int stride_ = 0;
  int images_ = 0;  ///< of a rig
  owner<staged_images, staging> memory_;
  std::vector<bool> given_;
  std::vector<std::uint32_t> missing_;  ///< [batch]
  absent_images absent_;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
