// SPDX-License-Identifier: Apache-2.0
/// @file Pipeline: depth of the left keypoints of a batch of stereo pairs, on memory taken once.
#pragma once

#include <cstddef>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/matches.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/stereo_rectified.hpp"
#include "ft/pipelines/orb_extractor.hpp"

namespace ft {
inline namespace FT_ABI {

/// Rectified stereo: images 2 b and 2 b + 1 of an extractor are pair b. match() is asynchronous on the
/// executor, allocates nothing and never waits. Move-only; not thread-safe; instances are independent.
template <typename Exec>
class stereo_matcher {
public:
  static constexpr memory_space space = Exec::space;

  stereo_matcher() = default;
  /// @throws bad_argument for a rig that cannot be, or an extractor with an odd batch
  stereo_matcher(rectified_rig const& rig, orb_extractor<Exec> const& extractor) {
    rig.check();
    detail::require(extractor.batch() >= 2 && extractor.batch() % 2 == 0,
                    "stereo needs an extractor with an even number of images");
    params_.bf = rig.bf;
    params_.max_disparity = rig.bf / rig.baseline;
    int const pairs = extractor.batch() / 2;
    grid_geometry rows;
    rows.cols = 1;
    rows.rows = extractor.params().height;
    arena_ = arena<space>([&](carver& c) {
      carve(c, matches_, extractor.capacity(), pairs);
      carve(c, right_rows_, rows, extractor.capacity(), pairs);
    });
  }

  /// Queues the matching of the extractor's current images.
  void match(Exec const& exec, orb_extractor<Exec> const& extractor) {
    match_stereo_rectified(exec, extractor.pyramid(), extractor.keypoints(), params_, matches_, right_rows_);
  }

  stereo_matches_view matches() const { return matches_; }  ///< one batch entry per pair, executor memory
  stereo_params const& params() const { return params_; }

private:
  stereo_params params_;
  stereo_matches_view matches_;
  feature_grid_view right_rows_;
  arena<space> arena_;
};

}  // namespace FT_ABI
}  // namespace ft
