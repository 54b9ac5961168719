// SPDX-License-Identifier: Apache-2.0
/// @file Pipeline: ORB keypoints and descriptors of a batch of images, on memory taken once.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <string>
#include <vector>

#include "ft/containers/corners.hpp"
#include "ft/containers/frame_arrivals.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/blur.hpp"
#include "ft/kernels/corners/detect_corners.hpp"
#include "ft/kernels/corners/mask.hpp"
#include "ft/kernels/distribution/distribute_corners.hpp"
#include "ft/kernels/keypoints/describe_corners.hpp"
#include "ft/kernels/keypoints/describe_keypoints.hpp"
#include "ft/kernels/keypoints/order.hpp"
#include "ft/kernels/keypoints/order_and_grid.hpp"
#include "ft/kernels/pyramid/build_pyramid.hpp"
#include "ft/kernels/pyramid/resize_taps.hpp"
#include "ft/kernels/pyramid/tile_layout.hpp"
#include "ft/kernels/upload.hpp"

namespace ft {
inline namespace FT_ABI {

/// For callers that do not time stages.
struct no_mark {
  void operator()(char const*) const {}
};

struct orb_params {
  int width = 0;  ///< of every image, pixels
  int height = 0;
  int features = 1200;  ///< wanted per image; a few more may come
  int levels = 8;
  float scale_factor = 1.2f;
  int ini_threshold = 20;  ///< corner threshold, grey levels
  int min_threshold = 7;   ///< used in cells that stay empty at ini_threshold
  /// Pixels of a mask, any size up to 16384 a side: it is stretched over its image. 0 = no masks
  int mask_width = 0;
  int mask_height = 0;
  tie_rule ties =
      tie_rule::stable;  ///< std_sort: keypoints as ORB-SLAM3 with libstdc++ orders them
};

/// Extracts ORB features of `batch` images at once. All memory is taken by the constructor;
/// extract() is asynchronous on the executor, allocates nothing and never waits. Not thread-safe;
/// any number of instances may work side by side. Move-only; one that was moved from refuses every
/// call with bad_argument, and its views are no longer its own.
template <typename Exec>
class orb_extractor {
public:
  static constexpr memory_space space = Exec::space;

  orb_extractor() = default;
  /// @param batch images per call
  /// @param overlaps one per image (fisheye pairs), or none. Columns in pixels, both ends included,
  ///   infinity allowed; keypoints inside come last, mono_count() counts the others. An overlap may
  ///   reach beyond the image; one that lies outside of it holds no keypoint
  /// Waits for the upload of its tables. @throws bad_argument naming the value and the limit, also
  ///   for an overlap with a NaN or with its left end right of its right one; std::bad_alloc or
  ///   cuda_error where memory is short
  orb_extractor(Exec const& exec, orb_params const& params, int batch,
                std::vector<stereo_overlap> const& overlaps = {})
      : params_(checked(params, batch, overlaps)),
        geometry_(pyramid_geometry::make(params.width, params.height, params.levels,
                                         params.scale_factor)),
        batch_(batch) {
    corner_layout const cells = corner_layout::make(geometry_);
    distribution_layout const quad = distribution_layout::make(geometry_, params.features);
    detail::require_items("keypoints of a batch", static_cast<std::size_t>(batch),
                          static_cast<std::size_t>(quad.total));
    blur_layout_ = blur_layout::make(geometry_);
    std::vector<resize_tap> taps(static_cast<std::size_t>(geometry_.taps));
    make_resize_taps(geometry_, taps.data());
    std::vector<tile_span> spans;
    tiles_ = make_pyramid_tiles(geometry_, taps.data(), spans);
    tile_span* tile_spans = nullptr;
    auto const b = static_cast<std::size_t>(batch);
    arena_ = arena<space>([&](carver& c) {
      carve(c, pyramid_, geometry_, batch);
      carve(c, blurred_, geometry_, batch);
      carve(c, corners_, cells, batch);
      carve(c, masks_, params.mask_width, params.mask_height, batch);
      carve(c, distribution_, quad, cells, batch);
      carve(c, keypoints_, max_of(quad.total, 1), batch);
      taps_ = c.take<resize_tap>(static_cast<std::size_t>(geometry_.taps));
      tile_spans = c.take<tile_span>(spans.size());
      pattern_ = c.take<pattern_pair>(256);
      overlaps_ = c.take<stereo_overlap>(b);
      place_ = c.take<int>(b * static_cast<std::size_t>(quad.total));
      mono_count_ = c.take<int>(b);
      carve(c, arrivals_, geometry_, batch);
    });
    tiles_.spans = tile_spans;
    std::vector<stereo_overlap> all(overlaps);
    all.resize(b);
    copy(exec, taps_, static_cast<resize_tap const*>(taps.data()), taps.size());
    copy(exec, tile_spans, static_cast<tile_span const*>(spans.data()), spans.size());
    copy(exec, pattern_, detail::orb_pattern, std::size_t{256});
    copy(exec, overlaps_, static_cast<stereo_overlap const*>(all.data()), b);
    // Whole words are read, so that what fills up rows has to be there.
    fill_bytes(exec, pyramid_.data, 0, static_cast<std::size_t>(geometry_.bytes) * b);
    fill_bytes(exec, blurred_.data, 0, static_cast<std::size_t>(geometry_.bytes) * b);
    // Corners and keypoints are read ahead of how many there are, in all stages.
    fill(exec, keypoints_, 0);
    clear_corners(exec, corners_);
    fill_bytes(exec, distribution_.kept, 0,
               static_cast<std::size_t>(max_of(quad.total, 1)) * b * sizeof(corner));
    clear_arrivals(exec);
    if (has_masks()) { fill_bytes(exec, masks_.data, 255, mask_bytes() * b); }
    exec.wait();
  }

  /// Queues the copy of image `i` into the pyramid's level 0. Pinned memory makes it asynchronous.
  /// @throws bad_argument for a null image, another size or a stride below the width
  void upload(Exec const& exec, int i, gray_view image) {
    detail::require_range("image index", i, 0, batch() - 1);
    detail::require(image.data != nullptr, "the image is null");
    require_size("image", image, params_.width, params_.height);
    auto const to = pyramid_.level(i, 0);
    copy_rows(exec, to.data, static_cast<std::size_t>(to.stride), image.data,
              static_cast<std::size_t>(image.stride), static_cast<std::size_t>(image.width),
              image.height);
  }

  /// Queues the copy of the mask of image `i`, which holds until the next one: keypoints come from
  /// where it is not 0. At first everything is allowed. See corner_masks_view for how a mask meets
  /// the pyramid's levels. Pinned memory makes it asynchronous; allocates nothing.
  /// @param mask of params().mask_width x mask_height pixels
  /// @throws bad_argument for a null mask, another size, a stride below the width, or where the
  /// extractor was made without masks
  void set_mask(Exec const& exec, int i, gray_view mask) {
    detail::require_range("image index", i, 0, batch() - 1);
    detail::require(has_masks(), "the extractor was made without masks: its mask_width is 0");
    detail::require(mask.data != nullptr, "the mask is null");
    require_size("mask", mask, masks_.width, masks_.height);
    auto const to = masks_.mask(i);
    copy_rows(exec, to.data, static_cast<std::size_t>(to.stride), mask.data,
              static_cast<std::size_t>(mask.stride), static_cast<std::size_t>(mask.width),
              mask.height);
  }

  /// Queues all stages over the uploaded images; the blur beside the distribution.
  void extract(Exec const& exec) {
    resize(exec);
    extract_from_pyramid(exec, no_items{}, no_grids{});
  }
  /// Queues the fetching of all images and of two blocks as receive_images(), then the same. The
  /// pyramid's tiles are made of rows that are there while the next ones are fetched.
  /// @param also small items beside the distribution, which leaves most of a device idle; see
  /// with_small_items
  /// @param grids to fill with the keypoints: keypoint_grids or no_grids
  template <typename Also, typename Grids>
  void receive_and_extract(Exec const& exec, image_source const* sources, block_source const& first,
                           block_source const& second, Also const& also, Grids const& grids) {
    batch_.require_made("extractor");
    bool const overlap = Exec::asynchronous && tiles_.groups == 1;
    if (overlap) {
      receive_images(exec, sources, pyramid_, first, second, arrivals_);
      build_pyramid(exec, pyramid_, taps_, tiles_, arrivals_);
    } else {
      receive_images(exec, sources, pyramid_, first, second);
      resize(exec);
    }
    extract_from_pyramid(exec, also, grids);
  }
  /// The same, one stage after the other. @param mark called with a stage's name once it is queued
  template <typename Mark>
  void extract(Exec const& exec, Mark&& mark) {
    resize(exec);
    mark("pyramid");
    detect(exec);
    mark("corners");
    distribute(exec);
    mark("distribution");
    blur_pyramid(exec, pyramid_, blurred_, blur_layout_);
    mark("blur");
    order(exec, {}, no_grids{});
    describe(exec, {});
    mark("descriptors");
  }

  /// Queues the pyramid and its blur alone, for describe_keypoints() of images of which no
  /// keypoints are wanted.
  void build_levels(Exec const& exec) {
    resize(exec);
    blur_pyramid(exec, pyramid_, blurred_, blur_layout_);
  }
  /// Queues the description of keypoints from elsewhere, as the function of that name, in the
  /// images of the last extract() or build_levels(). @param keypoints executor memory, one batch
  /// entry per image, any capacity @throws bad_argument for another batch
  void describe_keypoints(Exec const& exec, described_view const& keypoints) const {
    batch_.require_made("extractor");
    detail::require_range("batch of keypoints", keypoints.batch, batch(), batch());
    ft::describe_keypoints(exec, pyramid_, blurred_, pattern_, keypoints);
  }

  /// Queues the pyramids of the uploaded images alone, for callers with keypoints of their own.
  void build_pyramids(Exec const& exec) { resize(exec); }

  // Views into executor memory, valid as long as the extractor.
  keypoints_view keypoints() const { return keypoints_; }  ///< one batch entry per image
  int const* mono_count() const { return mono_count_; }    ///< [batch], outside the stereo overlap
  image_pyramid_view pyramid() const { return pyramid_; }
  image_pyramid_view blurred() const { return blurred_; }
  corners_view corners() const { return corners_; }
  distribution_view distribution() const { return distribution_; }

  orb_params const& params() const { return params_; }
  pyramid_geometry const& geometry() const { return geometry_; }
  int batch() const { return batch_; }
  int capacity() const { return keypoints_.capacity; }  ///< most keypoints that an image can yield
  std::size_t bytes() const { return arena_.bytes(); }  ///< of executor memory

private:
  /// The blur runs beside the quadtree, where most of a device is idle, and the description beside
  /// the order, of which it may need the places in the end.
  /// @param also small items there
  template <typename Also, typename Grids>
  void extract_from_pyramid(Exec const& exec, Also const& also, Grids const& grids) {
    detect(exec);
    distribute(exec);
    blur_pyramid(detail::with_order(exec, detail::launch_order::concurrent), pyramid_, blurred_,
                 blur_layout_, clear_arrivals_and<Also>{arrivals_, also});
    order(exec, arrivals_, grids);
    describe(detail::with_order(exec, detail::launch_order::concurrent), arrivals_);
  }
  void clear_arrivals(Exec const& exec) {
    for_each_item<per_thread>(exec, arrivals_.counters(), clear_arrival{}, arrivals_);
  }

  /// Both ways give the same pixels: long rows suit a processor, few launches a device.
  void resize(Exec const& exec) {
    batch_.require_made("extractor");
    if constexpr (Exec::asynchronous) {
      build_pyramid(exec, pyramid_, taps_, tiles_);
    } else {
      build_pyramid(exec, pyramid_, taps_);
    }
  }
  template <typename Grids>
  void order(Exec const& exec, frame_arrivals const& arrivals, Grids const& grids) {
    order_corners(exec,
                  ordering_view{geometry_, distribution_, overlaps_, keypoints_, mono_count_,
                                place_, arrivals},
                  grids);
  }
  void detect(Exec const& exec) {
    detect_corners(exec, pyramid_, {params_.ini_threshold, params_.min_threshold}, corners_);
    if (has_masks()) { mask_corners(exec, geometry_, masks_, corners_); }
  }
  void distribute(Exec const& exec) {
    distribute_corners(exec, corners_, distribution_, params_.ties);
  }
  bool has_masks() const { return masks_.data != nullptr; }
  std::size_t mask_bytes() const {
    return static_cast<std::size_t>(masks_.width) * static_cast<std::size_t>(masks_.height);
  }
  void describe(Exec const& exec, frame_arrivals const& arrivals) {
    describe_corners(exec, pyramid_, blurred_, distribution_, pattern_, place_, keypoints_,
                     arrivals, overlaps_);
  }

  /// @throws bad_argument for another size or a stride below the width
  static void require_size(std::string const& name, gray_view view, int width, int height) {
    if (view.width != width || view.height != height) {
      throw bad_argument("ft: the " + name + " is " + std::to_string(view.width) + "x" +
                         std::to_string(view.height) + ", the extractor was made for " +
                         std::to_string(width) + "x" + std::to_string(height));
    }
    detail::require_range((name + " stride").c_str(), view.stride, view.width,
                          std::numeric_limits<int>::max());
  }

  static orb_params const& checked(orb_params const& p, int batch,
                                   std::vector<stereo_overlap> const& overlaps) {
    detail::require_range("ini_threshold", p.ini_threshold, 0, 255);
    detail::require_range("min_threshold", p.min_threshold, 0, 255);
    detail::require_range("batch", batch, 1, 4096);
    detail::require_range("mask_width", p.mask_width, 0, max_image_side);
    detail::require_range("mask_height", p.mask_height, 0, max_image_side);
    detail::require((p.mask_width == 0) == (p.mask_height == 0),
                    "mask_width and mask_height are both 0 or both above it");
    detail::require(overlaps.empty() || overlaps.size() == static_cast<std::size_t>(batch),
                    "give one stereo overlap per image, or none");
    for (std::size_t i = 0; i < overlaps.size(); ++i) {
      if (!(overlaps[i].left <= overlaps[i].right)) {  // also rejects NaN
        throw bad_argument("ft: the stereo overlap of image " + std::to_string(i) + " is [" +
                           detail::number_text(overlaps[i].left) + ", " +
                           detail::number_text(overlaps[i].right) +
                           "], its left end must not be above its right end");
      }
    }
    return p;
  }

  orb_params params_;
  pyramid_geometry geometry_;
  blur_layout blur_layout_;
  detail::moved_count batch_;
  image_pyramid_view pyramid_;
  image_pyramid_view blurred_;
  corners_view corners_;
  corner_masks_view masks_;
  distribution_view distribution_;
  keypoints_view keypoints_;
  resize_tap* taps_ = nullptr;
  pyramid_tiles tiles_;
  pattern_pair* pattern_ = nullptr;
  stereo_overlap* overlaps_ = nullptr;
  int* place_ = nullptr;
  int* mono_count_ = nullptr;
  frame_arrivals arrivals_;
  arena<space> arena_;
};

}  // namespace FT_ABI
}  // namespace ft
