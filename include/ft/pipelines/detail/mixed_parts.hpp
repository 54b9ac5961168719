// SPDX-License-Identifier: Apache-2.0
/// @file The parts of a rig of cameras of the models of any_camera.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "ft/cameras/image_domain.hpp"
#include "ft/cameras/mixed_rig.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/keypoints/order.hpp"
#include "ft/kernels/stereo/rig_depths.hpp"
#include "ft/pipelines/detail/depth_input.hpp"
#include "ft/pipelines/detail/frame_images.hpp"
#include "ft/pipelines/detail/frame_memory.hpp"
#include "ft/pipelines/detail/rig_parts.hpp"
#include "ft/pipelines/stereo_matcher.hpp"
#include "ft/types/images.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The images of the next frame of a batch of mixed rigs.
template <typename Exec, int N>
class rig_input<Exec, mixed_rig<N>> {
public:
  using images_type = mixed_images<N>;
  static constexpr bool overlaps_pyramid = true;

  rig_input() = default;
  rig_input(Exec const&, mixed_rig<N> const& rig, pyramid_geometry const& geometry, int batch)
      : images_(geometry, absent_images_of(rig), batch) {
    for (int c = 0; c < N; ++c) {
      scaled_[c] = rig.of[c].depth_scale != 0;
      number_[c] = rig.of[c].has_depth_image ? depth_cameras_++ : -1;
    }
    depths_ =
        depth_input<Exec>(geometry.width[0], geometry.height[0], N * batch, depth_cameras_ * batch);
    missing_.assign(static_cast<std::size_t>(batch), 0);
  }

  frame_images<Exec> const& images() const { return images_; }
  depth_sources_view depths() const { return depths_.view(); }
  allocated_bytes allocated() const { return images_.allocated() + depths_.allocated(); }
  /// Bit c: the depth image of camera c of rig b is null.
  std::uint32_t missing_depths(int b) const { return missing_[static_cast<std::size_t>(b)]; }
  /// @throws bad_argument for an image of another size; null means that the camera has none
  void take(int b, images_type const& given) {
    auto const has_depth = [&](int c) { return number_[c] >= 0 && given.depth[c].data != nullptr; };
    for (int c = 0; c < N; ++c) {
      if (has_depth(c)) { depths_.require_depth(given.depth[c], scaled_[c]); }
    }
    take_some(images_, b, 2 * N, given.of);
    std::uint32_t& missing = missing_[static_cast<std::size_t>(b)];
    missing = 0;
    for (int c = 0; c < N; ++c) {
      if (has_depth(c)) {
        depths_.take(N * b + c, depth_cameras_ * b + number_[c], given.depth[c]);
      } else if (number_[c] >= 0) {
        depths_.leave_out(N * b + c);
        missing |= 1u << c;
      }
    }
  }
  /// Enqueues the copy of the images, and of the places of the depth images.
  void upload(Exec const& exec, extraction<Exec> const& to) const {
    to.upload(exec, images_.sources(), depths_.source(), {});
  }

private:
  frame_images<Exec> images_;
  depth_input<Exec> depths_;
  bool scaled_[N] = {};
  int number_[N] = {};  ///< of a camera among those with a depth image; -1 = it has none
  int depth_cameras_ = 0;
  std::vector<std::uint32_t> missing_;  ///< [batch]
};

template <typename Exec, int N>
std::uint32_t missing_depths_of(rig_input<Exec, mixed_rig<N>> const& input, int b) {
  return input.missing_depths(b);
}

/// Depths of the keypoints of mixed rigs: those of rectified pairs by a stereo_matcher, then those
/// of the other pairs, then those of depth images.
template <typename Exec, int N>
class mixed_matcher {
public:
  mixed_matcher() = default;
  /// @throws bad_argument for cameras that cannot be inverted in their images
  mixed_matcher(mixed_rig<N> const& rig, orb_extractor<Exec> const& extractor,
                depth_sources_view const& depths)
      : rig_(rig), rows_(rig, extractor, column_rule::least_squares), depths_(depths) {
    memory_ = owner<memory, Exec::space>([&](carver& c, memory& m) {
      c.place({extractor.batch() / 2, extractor.capacity()}, m.partner);
    });
    partners_ = static_cast<std::size_t>(extractor.batch() / 2) *
                static_cast<std::size_t>(extractor.capacity());
    for (int c = 0; c < N; ++c) {
      mixed_rig_camera const& camera = rig.of[c];
      has_depths_ = has_depths_ || camera.has_depth_image;
      if (camera.used) {
        require_invertible(camera.camera, extractor.params().width, extractor.params().height,
                           0.25);
      }
      if (camera.right < 0) { continue; }
      pairs_.push_back({c, {camera.camera, rig.of[camera.right].camera, pair_motion(rig, c)}});
    }
  }

  /// Only the first launch is concurrent with its predecessor if `exec` says so.
  void match_sorted(Exec const& exec, orb_extractor<Exec> const& extractor) {
    rows_.match_sorted(exec, extractor);
    Exec const serial = with_order(exec, launch_order::serial);
    if (!pairs_.empty()) { fill_bytes(serial, memory_->partner, 0xff, partners_ * sizeof(int)); }
    for (pair const& p : pairs_) {
      match_pair(serial, {p.rig, extractor.geometry(), nullptr, {}}, place_of(p),
                 extractor.keypoints());
    }
    if (has_depths_) {
      read_rig_depths(serial, rig_, extractor.geometry(), extractor.keypoints(), depths_,
                      rows_.matches());
    }
  }
  void refine_partners(Exec const& exec, orb_extractor<Exec> const& extractor) const {
    for (pair const& p : pairs_) {
      refine_pair(exec, p.rig, place_of(p), extractor.pyramid(), extractor.keypoints());
    }
  }
  /// [batch][cameras * capacity] as in frame_view; null without pairs that are not rectified
  int const* partners() const { return pairs_.empty() ? nullptr : memory_->partner; }
  feature_grid_view right_rows() const { return rows_.right_rows(); }
  std::size_t bytes() const { return rows_.bytes() + memory_.bytes(); }  ///< of executor memory
  stereo_params const& params(int c = 0) const { return rows_.params(c); }
  stereo_matches_view matches() const { return rows_.matches(); }
  float const* depth() const { return rows_.depth(); }
  static fisheye_matches_view fisheye_matches() { return {}; }

private:
  struct memory {
    int* partner = nullptr;
  };
  struct pair {
    int left;
    any_pair rig;
  };
  pair_of_rig place_of(pair const& p) const {
    return {p.left, rig_.of[p.left].right, N, memory_->partner,
            array_of<field::depth>(rows_.matches())};
  }

  mixed_rig<N> rig_{};
  stereo_matcher<Exec, mixed_rig<N>> rows_;
  depth_sources_view depths_;
  std::vector<pair> pairs_;
  bool has_depths_ = false;
  std::size_t partners_ = 0;
  owner<memory, Exec::space> memory_;
};

template <typename Exec, int N>
keypoint_grids<true> grids_of(mixed_matcher<Exec, N> const& matcher,
                              feature_grid_view const& cells) {
  return {cells, matcher.right_rows()};
}

template <int N>
struct rig_parts<mixed_rig<N>> {
  using searched_rig = mixed_rig<N>;
  template <typename Exec>
  using input = rig_input<Exec, mixed_rig<N>>;
  template <typename Exec>
  using matcher = mixed_matcher<Exec, N>;
  static constexpr bool undistorts = false;
  static constexpr bool refines_positions = true;
  static constexpr double disparity_weight = 0;
  static constexpr bool starts_from_motion = false;

  static mixed_rig<N> const& searched(mixed_rig<N> const& rig) { return rig; }
  static absent_images absent(mixed_rig<N> const& rig) { return absent_images_of(rig); }
  template <typename Exec>
  static matcher<Exec> make_matcher(mixed_rig<N> const& rig, orb_extractor<Exec> const& extractor,
                                    input<Exec> const& in) {
    return {rig, extractor, in.depths()};
  }
  static image_bounds bounds(mixed_rig<N> const&, int width, int height) {
    return {0, 0, static_cast<float>(width), static_cast<float>(height)};
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
