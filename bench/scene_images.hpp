// SPDX-License-Identifier: Apache-2.0
/// @file What the runners of frames share: a scene's images where an executor reads them.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <new>
#include <string>

#include "bench/runner.hpp"
#include "bench/scene.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/views.hpp"

namespace bench {
inline namespace FT_ABI {

/// All images of a scene in staging memory, rows padded.
template <typename Exec>
class scene_images {
public:
  /// @param images of a frame: left, right, then those of the second pair
  scene_images(scene const& s, int images)
      : width_(s.width),
        height_(s.height),
        stride_((s.width + 63) / 64 * 64),
        images_(images),
        frames_(static_cast<int>(s.frames.size())) {
    auto const stride = static_cast<std::size_t>(stride_);
    auto const width = static_cast<std::size_t>(width_);
    auto const height = static_cast<std::size_t>(height_);
    auto const per_frame = static_cast<std::size_t>(images);
    pixels_ = ft::buffer<std::uint8_t, ft::staging_space<Exec>>(per_frame * s.frames.size() *
                                                                stride * height);
    std::fill(pixels_.data(), pixels_.data() + pixels_.size(), std::uint8_t{0});
    std::uint8_t* to = pixels_.data();
    for (scene_frame const& f : s.frames) {
      for (std::size_t i = 0; i < per_frame; ++i) {
        auto const& from = i == 0 ? f.left : i == 1 ? f.right : f.aside[i - 2];
        for (std::size_t y = 0; y < height; ++y, to += stride) {
          std::copy_n(from.data() + y * width, width, to);
        }
      }
    }
  }

  ft::gray_view view(int frame, int image) const {
    auto const bytes = static_cast<std::ptrdiff_t>(stride_) * height_;
    return {pixels_.data() + (static_cast<std::ptrdiff_t>(images_) * frame + image) * bytes, width_,
            height_, stride_};
  }
  /// The frame that camera b sees as its i-th: back and forth over the scene, so that consecutive
  /// frames are neighbours. @param i at least -1
  int frame_of(int i, int b) const {
    int const period = std::max(1, 2 * frames_ - 2);
    int const k = (i + b + period) % period;
    return k < frames_ ? k : period - k;
  }

private:
  int width_, height_, stride_, images_, frames_;
  ft::buffer<std::uint8_t, ft::staging_space<Exec>> pixels_;  ///< [frames][images][height][stride_]
};

/// make(). @throws no_memory where host, device or pinned memory is short
template <typename Make>
auto made_in_memory(Make const& make) {
  try {
    return make();
  } catch (std::bad_alloc const&) {
    throw no_memory("host memory is short");
  } catch (ft::cuda_error const& e) {
    if (std::string(e.what()).find("cudaErrorMemoryAllocation") == std::string::npos) { throw; }
    throw no_memory("device or pinned memory is short");
  }
}

}  // namespace FT_ABI
}  // namespace bench
