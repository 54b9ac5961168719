// SPDX-License-Identifier: Apache-2.0
/// @file Pipeline: ORB keypoints and descriptors of a batch of images, in memory allocated once.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <string>
#include <vector>

#include "ft/containers/corners.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/stage_clock.hpp"
#include "ft/kernels/keypoints/describe_corners.hpp"
#include "ft/pipelines/check_params.hpp"
#include "ft/pipelines/detail/extraction.hpp"
#include "ft/pipelines/detail/frame_schedule.hpp"
#include "ft/types/images.hpp"
#include "ft/types/orb_params.hpp"

namespace ft {
inline namespace FT_ABI {

/// Extracts ORB features of `batch` images at once. The constructor allocates all memory. extract()
/// is asynchronous on the executor, allocates nothing and never waits. Not thread-safe; instances
/// are independent. Move-only. A moved-from extractor refuses every call with bad_argument, and its
/// views must not be used.
template <typename Exec>
class orb_extractor {
public:
  static constexpr memory_space space = Exec::space;

  orb_extractor() = default;
  /// Waits for the upload of its tables.
  /// @param batch images per call
  /// @param overlaps one per image (fisheye pairs), or none. Columns in pixels, both ends included,
  ///   infinity allowed. Keypoints inside come last; mono_count() counts the others. An overlap may
  ///   reach beyond the image; one outside the image holds no keypoint
  /// @param absent images that are never uploaded: they cost nothing and have no keypoints
  /// @throws bad_argument naming the value and the limit, also for an overlap with a NaN or with
  ///   its left end right of its right one; std::bad_alloc or cuda_error if memory is short
  orb_extractor(Exec const& exec, orb_params const& params, int batch,
                std::vector<stereo_overlap> const& overlaps = {}, absent_images const& absent = {})
      : params_(checked(params, batch, overlaps)) {
    detail::require_range("period of absent images", absent.period, 1, 32);
    detail::extraction<Exec> s;
    s.pyramid.absent = absent;
    s.geometry =
        pyramid_geometry::make(params.width, params.height, params.levels, params.scale_factor);
    s.geometry.exact = params.exact_positions;
    s.thresholds = {params.ini_threshold, params.min_threshold};
    s.ties = params.ties;
    s.corner_ratio = params.corner_ratio;
    s.refines = params.refine_positions;
    s.blur_tiles = blur_layout::make(s.geometry);
    corner_layout const cells = corner_layout::make(s.geometry);
    distribution_layout const quad =
        distribution_layout::make(s.geometry, params.features, params.start_features);
    detail::require_items("keypoints of a batch", static_cast<std::size_t>(batch),
                          static_cast<std::size_t>(quad.total));
    std::vector<resize_tap> taps(static_cast<std::size_t>(s.geometry.taps));
    make_resize_taps(s.geometry, taps.data());
    std::vector<tile_span> spans;
    s.tiles = make_pyramid_tiles(s.geometry, taps.data(), spans);
    tile_span* tile_spans = nullptr;
    auto const b = static_cast<std::size_t>(batch);
    auto const layout = [&](carver& c, detail::extraction<Exec>& v) {
      carve(c, v.pyramid, v.geometry, batch);
      carve(c, v.blurred, v.geometry, batch);
      carve(c, v.corners, cells, batch);
      carve(c, v.masks, params.mask_width, params.mask_height, batch);
      carve(c, v.kept, quad, cells, batch);
      if (params.start_features != 0) { v.kept.wants_more = c.take<int>(b); }
      carve(c, v.keypoints, max_of(quad.total, 1), batch);
      v.taps = c.take<resize_tap>(taps.size());
      v.tiles.spans = tile_spans = c.take<tile_span>(spans.size());
      v.pattern = c.take<pattern_pair>(256);
      v.overlaps = c.take<stereo_overlap>(b);
      v.place = c.take<int>(b * static_cast<std::size_t>(quad.total));
      v.mono_count = c.take<int>(b);
      carve(c, v.arrivals, v.geometry, batch);
    };
    stages_ = owner<detail::extraction<Exec>, space>(layout, s);
    std::vector<stereo_overlap> all(overlaps);
    all.resize(b);
    copy(exec, stages_->taps, static_cast<resize_tap const*>(taps.data()), taps.size());
    copy(exec, tile_spans, static_cast<tile_span const*>(spans.data()), spans.size());
    copy(exec, stages_->pattern, orb_pattern, std::size_t{256});
    copy(exec, stages_->overlaps, static_cast<stereo_overlap const*>(all.data()), b);
    stages_->initialize(exec);
    exec.wait();
  }

  /// Enqueues the copy of image `i` into the pyramid's level 0. Asynchronous for pinned memory.
  /// @throws bad_argument for a null image, another size or a stride below the width
  void upload(Exec const& exec, int i, gray_view image) {
    detail::require_range("image index", i, 0, batch() - 1);
    detail::require(image.data != nullptr, "the image is null");
    require_size("image", image, params_.width, params_.height);
    copy_image(exec, stages_->pyramid.level(i, 0), image);
  }

  /// Enqueues the copy of the mask of image `i`, which holds until the next one. Keypoints come
  /// from where the mask is not 0; without a mask, from everywhere. See corner_masks_view for masks
  /// and pyramid levels. Asynchronous for pinned memory; allocates nothing.
  /// @param mask of params().mask_width x mask_height pixels
  /// @throws bad_argument for a null mask, another size, a stride below the width, or an extractor
  ///   made without masks
  void set_mask(Exec const& exec, int i, gray_view mask) {
    detail::require_range("image index", i, 0, batch() - 1);
    detail::require(has_masks(), "the extractor was made without masks: its mask_width is 0");
    detail::require(mask.data != nullptr, "the mask is null");
    require_size("mask", mask, stages_->masks.width, stages_->masks.height);
    copy_image(exec, stages_->masks.mask(i), mask);
  }

  /// Enqueues all stages over the uploaded images.
  void extract(Exec const& exec) {
    stages_.require_made("extractor");
    detail::stage_line<Exec> line(exec, clock_);
    stages_->build_levels(line.then("pyramid"));
    detail::queue_features(line, stages());
    line.end();
  }
  /// Enqueues the upload of all images, concurrent with their pyramids, and all stages.
  /// @param sources [batch] addresses and strides of the images, in host memory that the executor's
  ///   threads can read. Read when the launches run
  void extract_from(Exec const& exec, image_source const* sources) {
    extract_from(exec, sources, no_grids{});
  }
  /// The same, and sorts the keypoints into grids. @param grids keypoint_grids or no_grids
  template <typename Grids>
  void extract_from(Exec const& exec, image_source const* sources, Grids const& grids) {
    stages_.require_made("extractor");
    detail::stage_line<Exec> line(exec, clock_);
    detail::extraction_with<Exec, Grids> const with{stages(), sources, grids};
    detail::queue_images(line, with, false);
    line.end();
  }
  /// A copy of the keypoints in memory that the host reads. Waits, and allocates.
  /// @throws std::bad_alloc, cuda_error
  auto download(Exec const& exec) const { return ft::download(exec, keypoints()); }

  /// Enqueues only the pyramid and its blur: for describe_keypoints() in images whose own keypoints
  /// are not needed.
  void build_levels(Exec const& exec) {
    build_pyramids(exec);
    stages_->blur(exec);
  }
  /// Enqueues the description of keypoints from elsewhere in the images of the last extract() or
  /// build_levels(), as the function describe_keypoints() does.
  /// @param keypoints executor memory, one batch entry per image, any capacity
  /// @throws bad_argument for another batch
  void describe_keypoints(Exec const& exec, described_view const& keypoints) const {
    stages_.require_made("extractor");
    detail::require_range("batch of keypoints", keypoints.batch, batch(), batch());
    ft::describe_keypoints(exec, stages_->described_in(), keypoints);
  }

  /// Enqueues only the pyramids of the uploaded images, for callers with keypoints of their own.
  void build_pyramids(Exec const& exec) {
    stages_.require_made("extractor");
    stages_->build_levels(exec);
  }

  // Views into executor memory, valid as long as the extractor.
  keypoints_view keypoints() const { return stages_->keypoints; }  ///< one batch entry per image
  /// [batch], keypoints outside the stereo overlap
  int const* mono_count() const { return stages_->mono_count; }
  image_pyramid_view pyramid() const { return stages_->pyramid; }
  image_pyramid_view blurred() const { return stages_->blurred; }
  corners_view corners() const { return stages_->corners; }
  distribution_view distribution() const { return stages_->kept; }

  orb_params const& params() const { return params_; }
  pyramid_geometry const& geometry() const { return stages_->geometry; }
  int batch() const { return stages_->pyramid.batch; }
  /// Most keypoints that an image can yield.
  int capacity() const { return stages_->keypoints.capacity; }
  std::size_t bytes() const { return stages_.bytes(); }  ///< of executor memory

  /// For pipelines that run other stages between or concurrently with these.
  detail::extraction<Exec> const& stages() const { return stages_.view(); }

private:
  bool has_masks() const { return stages_->has_masks(); }

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
    check(p);
    detail::require_range("batch", batch, 1, 4096);
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
  owner<detail::extraction<Exec>, space> stages_;
  stage_clock<Exec> clock_;  ///< not enabled
};

}  // namespace FT_ABI
}  // namespace ft
