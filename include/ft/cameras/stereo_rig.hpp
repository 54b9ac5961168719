// SPDX-License-Identifier: Apache-2.0
/// @file Two cameras fixed to each other.
#pragma once

#include <cmath>

#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/geometry.hpp"

namespace ft {
inline namespace FT_ABI {

/// Two cameras of any models. `T_rl` maps left-camera points to the right camera; metres.
template <typename Left, typename Right>
struct stereo_rig {
  static constexpr bool rectified = false;
  using left_type = Left;
  using right_type = Right;
  Left left;
  Right right;
  pose T_rl;

  /// Distance of the two centres, metres.
  FT_HOST_DEVICE strict_float baseline_length() const {
    auto const t = T_rl.template cast<strict_float>().t;
    return scalar::sqrt(dot(t, t));
  }
  /// @throws bad_argument for an invalid camera, a motion that is not rigid, or a zero baseline
  void check() const {
    left.check();
    right.check();
    for (float v : T_rl.R.m) { detail::require_finite("rig rotation", v); }
    mat3<float> const RRt = T_rl.R * T_rl.R.transposed();
    for (int i = 0; i < 9; ++i) {
      detail::require(std::abs(RRt.m[i] - (i % 4 == 0 ? 1.0f : 0.0f)) < 1e-3f,
                      "the rig's rotation is not a rotation matrix");
    }
    auto const& m = T_rl.R.m;
    detail::require(m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) +
                            m[2] * (m[3] * m[7] - m[4] * m[6]) >
                        0,
                    "the rig's rotation is a reflection");
    float const length = baseline_length().value;
    detail::require_finite("rig translation", length);
    detail::require_range("baseline", length, 1e-6f, 1e6f);
  }
};

/// A rectified pair: one pinhole, rows correspond, the right camera `baseline` metres to the right.
struct rectified_rig {
  static constexpr bool rectified = true;
  pinhole<float> camera;
  float baseline = 0;  ///< metres
  float bf = 0;        ///< baseline times fx, metres * pixels

  FT_HOST_DEVICE strict_float baseline_length() const { return baseline; }
  /// @throws bad_argument as check()
  static rectified_rig make(pinhole<float> const& camera, float baseline) {
    rectified_rig const rig{camera, baseline, baseline * camera.fx};
    rig.check();
    return rig;
  }
  /// @throws bad_argument for an invalid camera or baseline
  void check() const {
    camera.check();
    detail::require_finite("baseline", baseline);
    detail::require_range("baseline", baseline, 1e-6f, 1e6f);
    detail::require_range("baseline x fx", bf, 1e-9f, 1e12f);
  }
};

}  // namespace FT_ABI
}  // namespace ft
