// SPDX-License-Identifier: Apache-2.0
/// @file A part of an odometry: keypoints that the caller has found.
#pragma once

#include <memory>

#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/rgbd_rig.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/soa.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/images/undistort.hpp"
#include "ft/kernels/keypoints/gather_features.hpp"
#include "ft/kernels/keypoints/take_keypoints.hpp"
#include "ft/kernels/odometry/image_changes.hpp"
#include "ft/kernels/stereo/by_descriptors.hpp"
#include "ft/kernels/stereo/rectified.hpp"
#include "ft/pipelines/detail/odometry_memory.hpp"
#include "ft/pipelines/detail/odometry_part.hpp"
#include "ft/pipelines/detail/odometry_stages.hpp"
#include "ft/pipelines/detail/staged_features.hpp"
#include "ft/types/features.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Item: a rig whose frame has no images. Nothing is said about them, and the next ones are
/// compared with none.
struct pass_over_images {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int b, int images,
                                 image_changes_view const& changes, seen_counts* seen) const {
    for (int i = b * images; i < (b + 1) * images; ++i) {
      changes.of[i] = {};
      changes.begun[i] = 0;
    }
    seen[b].light = {};
    seen[b].changes = {};
  }
};

/// Where keypoints of a rig that are given get their depths from.
enum class given_depths {
  not_taken,  ///< keypoints of such a rig are not taken
  pair,       ///< partners, given or found
  image,      ///< given depths
  none
};
template <typename Rig>
inline constexpr given_depths given_depths_of = given_depths::not_taken;
template <>
inline constexpr given_depths given_depths_of<rectified_rig> = given_depths::pair;
template <typename Camera>
inline constexpr given_depths given_depths_of<rgbd_rig<Camera>> = given_depths::image;
template <typename Camera>
inline constexpr given_depths given_depths_of<monocular_rig<Camera>> = given_depths::none;

/// The part. Its launches replace those of images: keypoints, their grids and their partners.
template <typename Exec, typename Rig>
class odometry_features final : public odometry_part<Exec, Rig> {
  using stages_type = odometry_stages<Exec, Rig>;
  static constexpr given_depths depths = given_depths_of<Rig>;

public:
  /// @throws bad_argument, std::bad_alloc, cuda_error
  explicit odometry_features(stages_type const& s)
      : staged_(s.capacity(), Rig::images, s.batch, limits(s)) {
    memory_ = owner<memory, Exec::space>([&](carver& c, memory& m) {
      carve(c, m.pixels, s.capacity(), Rig::images * s.batch);
      carve(c, m.gathered, s.capacity(), Rig::images * s.batch, s.batch);
      if (depths == given_depths::pair) { carve(c, m.proposals, s.capacity(), s.batch); }
    });
  }
  allocated_bytes bytes() const override {
    return allocated_bytes{memory_.bytes(), 0} + staged_.bytes();
  }

  bool take_features(int b, given_features const& given) override {
    staged_.take(b, given);
    return true;
  }
  void queue_features(Exec const& exec, stages_type const& s) const override {
    keypoints_view const keypoints = s.extractor.keypoints();
    gather_features(exec, staged_.limits(), Rig::images, staged_.given(), memory_->gathered);
    take_keypoints(exec, s.geometry(), sources(), keypoints, memory_->pixels);
    for_each_item<per_thread>(exec, s.batch, pass_over_images{}, int{Rig::images}, s.own.changes,
                              s.own.seen);
    if constexpr (stages_type::undistorts) {
      s.undistort(exec);
    } else {
      build_grid<nearest_cell>(exec, with_columns(keypoints, memory_->pixels), 0, Rig::images,
                               s.batch, s.memory.frame.grids);
    }
    find_partners(exec, s);
  }

private:
  struct memory {
    pixels_view pixels;  ///< by which keypoints are sorted into grids
    taken_keypoints_view gathered;
    partner_proposals proposals;
  };

  taken_sources sources() const { return {staged_.view(), memory_->gathered, staged_.given()}; }
  static feature_limits limits(stages_type const& s) {
    feature_limits l;
    l.width = s.params.orb.width;
    l.height = s.params.orb.height;
    l.geometry = s.geometry();
    l.right = depths == given_depths::pair;
    l.depths = depths != given_depths::none;
    if constexpr (depths == given_depths::image) {
      l.min_depth = s.matcher.params().min_depth;
      l.max_depth = s.matcher.params().max_depth;
    }
    return l;
  }
  void find_partners(Exec const& exec, stages_type const& s) const {
    stereo_matches_view const matches = s.matcher.matches();
    if constexpr (depths == given_depths::none) {
      s.matcher.match_sorted(exec, s.extractor);  // none has any
    } else {
      auto const& pair = s.rig.pair(0);
      if constexpr (depths == given_depths::pair) {
        sort_right_rows(exec, with_columns(s.extractor.keypoints(), memory_->pixels),
                        s.matcher.right_rows());
        stereo_params params;
        params.bf = pair.bf();
        params.max_disparity = pair.bf() / pair.baseline_length().value;
        match_by_descriptors(exec, s.geometry(), s.extractor.keypoints(), s.matcher.right_rows(),
                             params, memory_->proposals, matches);
      }
      take_partners(exec, s.geometry(), sources(), s.unmoved_keypoints(), Rig::images, pair.bf(),
                    matches);
    }
  }

  staged_features<Exec> staged_;
  owner<memory, Exec::space> memory_;
};

/// @return null without odometry_params::own_features
/// @throws bad_argument as own_features says
template <typename Exec, typename Rig>
std::unique_ptr<odometry_part<Exec, Rig>> make_part(own_features const&, Exec const&,
                                                    odometry_stages<Exec, Rig>& s) {
  if (!s.settings.own_features) { return nullptr; }
  if constexpr (given_depths_of<Rig> != given_depths::not_taken) {
    return std::make_unique<odometry_features<Exec, Rig>>(s);
  } else {
    throw bad_argument(
        "ft: params.own_features: keypoints of the caller are taken by a rectified_rig, an "
        "rgbd_rig or a monocular_rig, not by this rig");
  }
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
