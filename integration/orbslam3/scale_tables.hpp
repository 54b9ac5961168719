// SPDX-License-Identifier: Apache-2.0
/// @file Frame's tables of scales.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

#include "ft/kernels/pyramid/build_pyramid.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft {
namespace orbslam3 {

class scale_tables {
public:
  explicit scale_tables(settings const& s)
      : levels_(s.levels), factor_(s.scale_factor), log_factor_(std::log(s.scale_factor)) {
    auto const g = pyramid_geometry::make(s.width, s.height, s.levels, s.scale_factor);
    scale_.assign(g.scale, g.scale + s.levels);
    inv_scale_.assign(g.inv_scale, g.inv_scale + s.levels);
    sigma2_.assign(g.sigma2, g.sigma2 + s.levels);
    inv_sigma2_.assign(g.inv_sigma2, g.inv_sigma2 + s.levels);
    for (int l = 0; l < s.levels; ++l) {
      patch_size_.push_back(static_cast<float>(g.patch_size(l)));
    }
  }

  template <typename Frame>
  void fill(Frame& frame) const {
    frame.mnScaleLevels = levels_;
    frame.mfScaleFactor = factor_;
    frame.mfLogScaleFactor = log_factor_;
    frame.mvScaleFactors = scale_;
    frame.mvInvScaleFactors = inv_scale_;
    frame.mvLevelSigma2 = sigma2_;
    frame.mvInvLevelSigma2 = inv_sigma2_;
  }
  /// KeyPoint::size in an octave, pixels.
  float patch_size(int octave) const { return patch_size_[static_cast<std::size_t>(octave)]; }

private:
  int levels_;
  float factor_;
  float log_factor_;
  std::vector<float> scale_, inv_scale_, sigma2_, inv_sigma2_, patch_size_;
};

}  // namespace orbslam3
}  // namespace ft
