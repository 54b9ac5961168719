// SPDX-License-Identifier: Apache-2.0
/// @file Two cameras fixed to each other.
#pragma once

#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/math.hpp"

namespace ft {
inline namespace FT_ABI {

/// Any two camera models. `T_rl` maps left-camera points to the right camera; metres.
template <typename Left, typename Right>
struct stereo_rig {
  static constexpr bool rectified = false;
  using left_type = Left;
  using right_type = Right;
  Left left;
  Right right;
  pose T_rl;
};

/// A rectified pair: one pinhole, rows correspond, the right camera `baseline` metres to the right.
struct rectified_rig {
  static constexpr bool rectified = true;
  pinhole<float> camera;
  float baseline = 0;  ///< metres
  float bf = 0;        ///< baseline times fx, metres x pixels

  static rectified_rig make(pinhole<float> const& camera, float baseline) {
    return {camera, baseline, baseline * camera.fx};
  }
  /// @throws bad_argument for a camera or a baseline that cannot be
  void check() const {
    camera.check();
    detail::require_finite("baseline", baseline);
    detail::require_range("baseline", baseline, 1e-6f, 1e6f);
    detail::require_range("baseline x fx", bf, 1e-9f, 1e12f);
  }
};

}  // namespace FT_ABI
}  // namespace ft
