// SPDX-License-Identifier: Apache-2.0
/// @file Stage: the order of keypoints. Each kept corner gets its place in the output. Source:
/// specification section 4.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "ft/containers/corners.hpp"
#include "ft/containers/feature_grid.hpp"
#include "ft/containers/frame_arrivals.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/distribution/layout.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/types/orb_params.hpp"

namespace ft {
inline namespace FT_ABI {

/// Inputs and outputs of the ordering of a batch of images, all in executor memory.
struct ordering_view {
  pyramid_geometry geometry;
  distribution_view kept;
  stereo_overlap const* overlaps = nullptr;  ///< [batch]
  keypoints_view out;                        ///< angles and descriptors are not written
  int* mono_count = nullptr;  ///< [batch] gets the number of keypoints outside the overlap
  int* place = nullptr;  ///< [batch][kept.layout.total] gets the place of each corner's keypoint
  /// Signals a concurrent describe_corners() that the places of an image are written. Only images
  /// whose overlap is neither empty nor the whole image are signalled.
  frame_arrivals arrivals;
};

/// For order_corners() without feature grids; see below.
struct no_grids {
  no_grids from(int /*image*/) const { return {}; }
};

namespace detail {

/// Work that a group does with the keypoints of its image while it orders them: here none. Other
/// fillers of order_image have the same members.
struct no_filler {
  using scratch = no_scratch;

  /// Part of the prologue of order_image.
  template <typename Group>
  FT_HOST_DEVICE void prepare(Group, scratch&, int, keypoints_view const&) const {}
  /// Called for each keypoint before its place is known. The result is passed to keep().
  template <typename Group>
  FT_HOST_DEVICE std::uint32_t count(Group, scratch&, int, keypoints_view const&, float,
                                     float) const {
    return 0;
  }
  /// Called for each keypoint with its place.
  FT_HOST_DEVICE void keep(scratch&, int, std::uint32_t) const {}
  /// Called once all keypoints are written.
  template <typename Group>
  FT_HOST_DEVICE void fill(Group, scratch&, int, keypoints_view const&, int) const {}
};

/// One image: writes its keypoints, except angles and descriptors. Keypoints outside the overlap
/// come first, level by level in list order. Those inside fill the array from its end backwards.
/// @tparam Filler further work on them, see no_filler
template <typename Filler>
struct order_image {
  Filler filler;
  std::size_t extra = 0;              ///< unused shared memory that keeps other blocks off the SM
  static constexpr int known = 2048;  ///< slots whose levels are computed in the prologue
  struct scratch {
    typename Filler::scratch filler;
    int before[max_levels + 1];  ///< corners on lower levels
    std::uint8_t level[known];   ///< of a slot; read by the thread that wrote it
  };
  /// Blocks per multiprocessor. The launch has one block per image; a limit for more would only
  /// cost registers.
  static constexpr int resident_blocks = 1;

  std::size_t extra_bytes() const { return extra; }

  template <typename Group>
  FT_HOST_DEVICE void prologue(Group g, scratch& s, int image, ordering_view const& v) const {
    FT_NO_UNROLL
    for (int i = g.rank(); i < known; i += g.size()) {
      s.level[i] = static_cast<std::uint8_t>(v.kept.layout.level_of(i));
    }
    filler.prepare(g, s.filler, image, v.out);
    v.arrivals.reset_placed(g, image);
  }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int image, ordering_view const& v) const {
    distribution_layout const& layout = v.kept.layout;
    stereo_overlap const overlap = v.overlaps[image];
    // Prefetches corners before their count is known.
    slot_place of[together];
    fetch(g, s, of, image, 0, v.kept);
    sum_lower_levels(g, s, v.kept.kept_count + image * layout.levels, layout.levels);
    g.sync();
    int const all = s.before[layout.levels];
    int stereo = 0;  // corners inside the overlap in lower slots
    for (int base = 0; base < layout.total; base += together * g.size()) {
      std::uint32_t entry[together] = {};
      unsigned inside = 0;  // 16 bits per slot
      FT_UNROLL
      for (int k = 0; k < together; ++k) {
        of[k].locate(layout, s.before, v.geometry, overlap);
        inside |= static_cast<unsigned>(of[k].inside) << (16 * k);
        if (of[k].valid) { entry[k] = filler.count(g, s.filler, image, v.out, of[k].x, of[k].y); }
      }
      int total = 0;
      int const lower = g.exclusive_scan(static_cast<int>(inside), total);
      FT_UNROLL
      for (int k = 0; k < together; ++k) {
        int const stereo_rank = stereo + (lower >> (16 * k) & 0xffff);
        stereo += total >> (16 * k) & 0xffff;
        if (!of[k].valid) { continue; }
        int const at = of[k].inside ? all - 1 - stereo_rank : of[k].rank - stereo_rank;
        v.place[image * layout.total + of[k].slot] = at;
        of[k].write(v.out, image * v.out.capacity + at);
        filler.keep(s.filler, at, entry[k]);
      }
      if (base + together * g.size() < layout.total) {
        fetch(g, s, of, image, base + together * g.size(), v.kept);
      }
    }
    if (g.rank() == 0) {
      v.out.count[image] = all;
      v.mono_count[image] = all - stereo;
    }
    // For all other images describe_corner computes the places itself: a signal has to wait for
    // this group's stores.
    int const width = v.geometry.width[0];
    if (!overlap.has_none(width) && !overlap.has_all(width)) { v.arrivals.tell_placed(g, image); }
    filler.fill(g, s.filler, image, v.out, all);
  }

private:
  static constexpr int together = 2;  ///< slots per thread whose loads are in flight together

  /// The kept corner of a slot, and its place.
  struct slot_place {
    int slot;
    int level = 0;
    int rank = 0;  ///< among all corners of the image
    bool valid = false;
    bool inside = false;  ///< the overlap
    /// The corner as loaded. Unpacking waits for the load, so it is done as late as possible.
    std::uint64_t word = 0;
    corner c{};
    float x = 0;
    float y = 0;

    slot_place() = default;
    FT_HOST_DEVICE explicit slot_place(int at) : slot(at) {}
    FT_HOST_DEVICE void locate(distribution_layout const& layout, int const* before,
                               pyramid_geometry const& geometry, stereo_overlap const& overlap) {
      std::memcpy(&c, &word, sizeof c);
      rank = before[level] + slot - layout.first[level];
      valid = slot < layout.total && rank < before[level + 1];
      x = static_cast<float>(c.x + corner_border);
      y = static_cast<float>(c.y + corner_border);
      if (level > 0) {
        x = mul(x, geometry.scale[level]);
        y = mul(y, geometry.scale[level]);
      }
      inside = valid && x >= overlap.left && x <= overlap.right;
    }
    FT_HOST_DEVICE void write(keypoints_view const& out, int to) const {
      out.x(to) = x;
      out.y(to) = y;
      out.response(to) = static_cast<float>(c.response);
      out.octave(to) = level;
    }
  };

  /// Loads the corners of the slots base + k * threads + rank.
  template <typename Group>
  FT_HOST_DEVICE static void fetch(Group g, scratch const& s, slot_place (&of)[together], int image,
                                   int base, distribution_view const& kept) {
    distribution_layout const& layout = kept.layout;
    FT_UNROLL
    for (int k = 0; k < together; ++k) {
      int const slot = base + k * g.size() + g.rank();
      of[k] = slot_place(slot);
      // Slots past the end repeat the last one, so that no load depends on a branch.
      int const held = max_of(min_of(slot, layout.total - 1), 0);
      of[k].word = corner_word(kept.kept + image * layout.total + held);
      bool const precomputed = Group::max_threads > 1 && slot < known;
      of[k].level = precomputed ? static_cast<int>(s.level[slot]) : layout.level_of(slot);
    }
  }

  /// Fills `s.before`.
  template <typename Group>
  FT_HOST_DEVICE static void sum_lower_levels(Group g, scratch& s, int const* counts, int levels) {
    for (int l = g.rank(); l <= max_levels; l += g.size()) {
      int sum = 0;
      FT_UNROLL
      for (int k = 0; k < max_levels; ++k) { sum += k < min_of(l, levels) ? counts[k] : 0; }
      s.before[l] = sum;
    }
  }

  FT_HOST_DEVICE static std::uint64_t corner_word(corner const* at) {
    static_assert(sizeof(corner) == 8 && alignof(corner) == 8, "a corner is a word");
#if defined(__CUDA_ARCH__)
    return *reinterpret_cast<unsigned long long const*>(at);
#else
    std::uint64_t word;
    std::memcpy(&word, at, sizeof word);
    return word;
#endif
  }
};

template <typename Exec, typename Filler>
void order_with(Exec const& exec, ordering_view const& v, Filler const& filler) {
  constexpr int threads = 1024;
  using op = order_image<Filler>;
  // All shared memory of a multiprocessor, so that no other block is resident on it.
  std::size_t const extra = extra_scratch<threads, op>(exec, v.out.batch);
  for_each_item<per_block<threads>>(exec, v.out.batch, op{filler, extra}, v);
}

}  // namespace detail

/// Writes the keypoints of a batch of images in the contract's order, except angles and
/// descriptors. Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec>
void order_corners(Exec const& exec, ordering_view const& v, no_grids const& = {}) {
  detail::order_with(exec, v, detail::no_filler{});
}

// Stage: the order of keypoints, and their feature grids, in one launch.
//
// The group that orders the keypoints of an image has their coordinates in registers when it
// computes their places. In the same pass it counts them into the cells of the image's grid, and
// it lists the cells at the end. This saves a launch compared with order_corners() followed by
// build_grid(), with the same results. Sources: specification sections 4 and 7.

/// The grids into which the keypoints of stereo pairs are sorted. Image 2b is the left one of pair
/// b.
/// @tparam Rectified left images go to `cells`, one grid a pair, right ones to `right_rows`;
///   otherwise image i goes to grid i of `cells`
template <bool Rectified>
struct keypoint_grids {
  feature_grid_view cells;
  feature_grid_view right_rows;  ///< one column of image rows; rectified pairs only

  /// Those of the images from `image` on, the left one of a pair.
  keypoint_grids from(int image) const {
    if constexpr (Rectified) {
      return {cells.slice(image / 2), right_rows.slice(image / 2)};
    } else {
      return {cells.slice(image), right_rows};
    }
  }
};

namespace detail {

/// Fills the grids of keypoint_grids from the keypoints that order_image writes.
template <bool Rectified>
struct grid_filler {
  using scratch = grid_scratch;
  keypoint_grids<Rectified> grids;

  template <typename Group>
  FT_HOST_DEVICE void prepare(Group g, scratch& s, int image, keypoints_view const& all) const {
    with_grid<Group>(image, all, [&](auto fill, feature_grid_view const& grid, bool in_scratch) {
      if (in_scratch) { fill.clear(g, s, grid.geometry); }
    });
  }
  template <typename Group>
  FT_HOST_DEVICE std::uint32_t count(Group, scratch& s, int image, keypoints_view const& all,
                                     float x, float y) const {
    std::uint32_t entry = 0;
    with_grid<Group>(image, all, [&](auto fill, feature_grid_view const& grid, bool in_scratch) {
      if (in_scratch) { entry = fill.count(s, grid.geometry, x, y); }
    });
    return entry;
  }
  FT_HOST_DEVICE void keep(scratch& s, int keypoint, std::uint32_t entry) const {
    if (keypoint < scratch::size) { s.entry[keypoint] = entry; }
  }
  template <typename Group>
  FT_HOST_DEVICE void fill(Group g, scratch& s, int image, keypoints_view const& all, int n) const {
    with_grid<Group>(image, all, [&](auto fill, feature_grid_view const& grid, bool in_scratch) {
      if (in_scratch) {
        fill.sort(g, s, n, grid);
      } else {
        g.sync();
        fill(g, s, 0, all.slice(image), 0, 1, grid);
      }
    });
  }

private:
  /// Calls f(fill_grid, the image's grid, whether all keypoints of the image fit into scratch).
  template <typename Group, typename F>
  FT_HOST_DEVICE void with_grid(int image, keypoints_view const& all, F const& f) const {
    auto const call = [&](auto fill, feature_grid_view const& grid) {
      f(fill, grid, scratch::template serves<Group>(grid.geometry, all.capacity));
    };
    if (!Rectified) {
      call(fill_grid<nearest_cell>{}, grids.cells.slice(image));
    } else if (image % 2 == 0) {
      call(fill_grid<nearest_cell>{}, grids.cells.slice(image / 2));
    } else {
      call(fill_grid<row_cell>{}, grids.right_rows.slice(image / 2));
    }
  }
};

}  // namespace detail

/// order_corners(), and fills the grids with the keypoints. Asynchronous on `exec`; allocates
/// nothing; one launch.
template <typename Exec, bool Rectified>
void order_corners(Exec const& exec, ordering_view const& v,
                   keypoint_grids<Rectified> const& grids) {
  detail::order_with(exec, v, detail::grid_filler<Rectified>{grids});
}

}  // namespace FT_ABI
}  // namespace ft
