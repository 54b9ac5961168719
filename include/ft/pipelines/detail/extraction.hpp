// SPDX-License-Identifier: Apache-2.0
/// @file The stages of ORB extraction on the memory of an orb_extractor. frame_schedule.hpp defines
/// which of them run concurrently.
#pragma once

#include <cstddef>
#include <vector>

#include "ft/containers/corners.hpp"
#include "ft/containers/frame_arrivals.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/recording.hpp"
#include "ft/kernels/blur.hpp"
#include "ft/kernels/corners/detect_corners.hpp"
#include "ft/kernels/corners/mask.hpp"
#include "ft/kernels/distribution/distribute_corners.hpp"
#include "ft/kernels/keypoints/describe_corners.hpp"
#include "ft/kernels/keypoints/drop_edges.hpp"
#include "ft/kernels/keypoints/order.hpp"
#include "ft/kernels/keypoints/refine_positions.hpp"
#include "ft/kernels/pyramid/build_pyramid.hpp"
#include "ft/kernels/pyramid/tile_layout.hpp"
#include "ft/kernels/upload.hpp"
#include "ft/types/orb_params.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Views into an extractor's memory, and a function that enqueues each stage. All are asynchronous
/// on their executor and allocate nothing.
template <typename Exec>
struct extraction {
  pyramid_geometry geometry;
  blur_layout blur_tiles;
  corner_params thresholds;
  tie_rule ties = tie_rule::stable;
  float corner_ratio = 0;  ///< of drop_edges(); 0 = none are dropped
  bool refines = false;    ///< positions
  image_pyramid_view pyramid;
  image_pyramid_view blurred;
  corners_view corners;
  corner_masks_view masks;
  distribution_view kept;
  keypoints_view keypoints;
  resize_tap* taps = nullptr;
  pyramid_tiles tiles;
  pattern_pair* pattern = nullptr;
  stereo_overlap* overlaps = nullptr;
  int* place = nullptr;
  int* mono_count = nullptr;
  frame_arrivals arrivals;
  int first = 0;  ///< image of the batch, of which the views are those from there on

  /// The stages of a part of the batch. @param from, count multiples of the images of a rig
  extraction part(int from, int count) const {
    extraction p = *this;
    p.first = first + from;
    p.pyramid = entries_of(pyramid, from, count);
    p.blurred = entries_of(blurred, from, count);
    p.corners = entries_of(corners, from, count);
    p.masks = entries_of(masks, from, count);
    p.kept = entries_of(kept, from, count);
    if (kept.wants_more != nullptr) { p.kept.wants_more += from; }
    p.keypoints = entries_of(keypoints, from, count);
    p.overlaps += from;
    p.place += static_cast<std::ptrdiff_t>(from) * kept.layout.total;
    p.mono_count += from;
    p.arrivals = entries_of(arrivals, from, count);
    return p;
  }

  description_source described_in() const { return {pyramid, blurred, pattern}; }
  bool drops_edges() const { return corner_ratio > 0; }
  bool refines_positions() const { return refines; }
  bool has_masks() const { return masks.data != nullptr; }
  /// Whether tiles of the pyramid wait for their rows while later rows are still being uploaded.
  bool pyramid_overlaps_upload() const { return Exec::asynchronous && tiles.groups == 1; }

  /// Uploads images and, with the first ones, two blocks from host memory.
  /// @param sources [batch]
  void upload(Exec const& exec, image_source const* sources, block_source const& a,
              block_source const& b) const {
    frame_arrivals const told = pyramid_overlaps_upload() ? arrivals : frame_arrivals{};
    bool const blocks = first == 0;
    receive_images(exec, sources + first, pyramid, blocks ? a : block_source{},
                   blocks ? b : block_source{}, told);
  }
  /// The pyramid while upload() runs, if pyramid_overlaps_upload().
  void pyramid_of_upload(Exec const& exec) const {
    build_pyramid(exec, pyramid, taps, tiles, arrivals);
  }
  /// The pyramid of uploaded images. Both forms give the same pixels. Long rows suit a CPU, few
  /// launches suit a device.
  void build_levels(Exec const& exec) const {
    if constexpr (Exec::asynchronous) {
      build_pyramid(exec, pyramid, taps, tiles);
    } else {
      build_pyramid(exec, pyramid, taps);
    }
  }
  void detect(Exec const& exec) const {
    detect_corners(exec, pyramid, thresholds, corners);
    if (has_masks()) { mask_corners(exec, geometry, masks, corners); }
  }
  void distribute(Exec const& exec) const { distribute_corners(exec, corners, kept, ties); }
  void drop_edges(Exec const& exec) const { ft::drop_edges(exec, pyramid, corner_ratio, kept); }
  void blur(Exec const& exec) const { blur_pyramid(exec, pyramid, blurred, blur_tiles); }
  /// Orders the keypoints and writes their positions.
  /// @param grids into which they are sorted: keypoint_grids or no_grids
  template <typename Grids>
  void order(Exec const& exec, Grids const& grids) const {
    order_corners(exec,
                  ordering_view{geometry, kept, overlaps, keypoints, mono_count, place, arrivals},
                  grids);
  }
  void order(Exec const& exec) const { order(exec, no_grids{}); }
  void describe(Exec const& exec) const {
    describe_corners(exec,
                     describing_view{described_in(), kept, place, keypoints, arrivals, overlaps});
  }
  /// Moves keypoints, which are in their grids already, by up to half a pixel of their levels.
  void refine(Exec const& exec) const { refine_positions(exec, pyramid, keypoints); }

  /// Initialises memory that is read before the first image has written it.
  void initialize(Exec const& exec) const {
    auto const b = static_cast<std::size_t>(pyramid.batch);
    auto const bytes = static_cast<std::size_t>(geometry.bytes) * b;
    // Whole words are read, including the padding at the ends of rows.
    fill_bytes(exec, pyramid.data, 0, bytes);
    fill_bytes(exec, blurred.data, 0, bytes);
    // All stages prefetch corners and keypoints before their count is known.
    fill(exec, keypoints, 0);
    clear_corners(exec, corners);
    fill_bytes(exec, kept.kept, 0,
               static_cast<std::size_t>(keypoints.capacity) * b * sizeof(corner));
    if (kept.wants_more != nullptr) { fill_bytes(exec, kept.wants_more, 0, b * sizeof(int)); }
    if (has_masks()) {
      fill_bytes(
          exec, masks.data, 255,
          b * static_cast<std::size_t>(masks.width) * static_cast<std::size_t>(masks.height));
    }
  }
};

/// Parts of a batch of rigs whose images are uploaded one after the other: the device finds the
/// keypoints of those that are there while the bus has the next ones.
template <typename Exec>
class image_parts {
public:
  /// @param rigs of the batch @param images of a rig @param recorded whether frames are; else a
  ///   launch on a branch would not have the priority of the caller's stream
  void make(int rigs, int images, bool recorded) {
    images_ = images;
    rigs_ = rigs;
    // Below eight rigs the launches of more parts cost what is gained; above eight parts little is.
    int const count = Exec::asynchronous && recorded && rigs >= 8 ? min_of(rigs / 2, 8) : 1;
    branches_ = std::vector<side_branch<Exec>>(count > 1 ? static_cast<std::size_t>(count) : 0);
    for (auto& b : branches_) { b.make(); }
  }
  int count() const { return max_of(static_cast<int>(branches_.size()), 1); }
  /// First image of part k; of k = count() the number of images.
  int first(int k) const { return images_ * (k * rigs_ / count()); }
  side_branch<Exec>& branch(int k) { return branches_[static_cast<std::size_t>(k)]; }

private:
  int rigs_ = 0;
  int images_ = 0;
  std::vector<side_branch<Exec>> branches_;
};

/// The stages with images from host memory and the caller's grids.
template <typename Exec, typename Grids>
struct extraction_with {
  extraction<Exec> stages;
  image_source const* sources;
  Grids grids;

  static constexpr bool in_parts = false;  ///< queue_images()
  void upload(Exec const& exec, bool /*with_local*/) const { stages.upload(exec, sources, {}, {}); }
  bool pyramid_overlaps_upload() const { return stages.pyramid_overlaps_upload(); }
  void pyramid_of_upload(Exec const& exec) const { stages.pyramid_of_upload(exec); }
  void build_levels(Exec const& exec) const { stages.build_levels(exec); }
  void detect(Exec const& exec) const { stages.detect(exec); }
  void distribute(Exec const& exec) const { stages.distribute(exec); }
  bool drops_edges() const { return stages.drops_edges(); }
  void drop_edges(Exec const& exec) const { stages.drop_edges(exec); }
  void blur(Exec const& exec) const { stages.blur(exec); }
  void order(Exec const& exec) const { stages.order(exec, grids); }
  void describe(Exec const& exec) const { stages.describe(exec); }
  bool refines_positions() const { return stages.refines; }
  void refine(Exec const& exec) const { stages.refine(exec); }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
