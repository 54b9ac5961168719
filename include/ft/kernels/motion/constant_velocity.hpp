// SPDX-License-Identifier: Apache-2.0
/// @file Prediction of a pose with constant velocity: the last motion continues, scaled by the
/// elapsed time.
#pragma once

#include <cstdint>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/math/se3.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// The motion T scaled in length: exp(share * log(T)), along the same screw.
FT_HOST_DEVICE inline rigid<strict_double> part_of_motion(rigid<strict_double> const& T,
                                                          strict_double share) {
  twist const all = log_se3(T);
  strict_double const d[6] = {share * all.w.x, share * all.w.y, share * all.w.z,
                              share * all.u.x, share * all.u.y, share * all.u.z};
  return exp_se3(d);
}

}  // namespace detail

/// The last motion of a camera, for a prediction with constant velocity. All functions give the
/// same bits on every executor.
struct constant_velocity {
  rigid<double> motion;      ///< T_cw of a frame times the inverse of the one before
  std::int64_t interval_ns;  ///< time between the two; 0 or below = unknown

  FT_HOST_DEVICE static constant_velocity at_rest() { return {rigid<double>::identity(), 0}; }
  FT_HOST_DEVICE bool known() const { return interval_ns > 0; }

  /// T_cw after `interval` ns more. If an interval is unknown or not above 0, that of the last
  /// motion is used.
  /// @pre the motion turns by less than half a turn
  FT_HOST_DEVICE rigid<double> predict(rigid<double> const& T_cw, std::int64_t interval,
                                       motion_params const& params = {}) const {
    using real = strict_double;
    auto M = motion.cast<real>();
    if (interval > 0 && interval_ns > 0) {
      real const share =
          real(static_cast<double>(interval)) / real(static_cast<double>(interval_ns));
      if (!(scalar::abs(share - real(1)) < real(params.even))) {
        M = detail::part_of_motion(M, min_of(share, real(params.longest)));
      }
    }
    return (M * T_cw.cast<real>()).cast<double>();
  }
  /// States that the camera moved from one pose to the other in `interval` ns.
  FT_HOST_DEVICE void observe(rigid<double> const& from, rigid<double> const& to,
                              std::int64_t interval) {
    using real = strict_double;
    motion = (to.cast<real>() * from.cast<real>().inverse()).orthonormalized().cast<double>();
    interval_ns = interval;
  }
  /// Forgets the motion: predicts none.
  FT_HOST_DEVICE void rest() { *this = at_rest(); }
  /// The camera was not seen for `interval` ns: the motion that is believed to go on shrinks by the
  /// share of params.memory that this is. Nothing happens if the interval is not above 0.
  FT_HOST_DEVICE void slow_down(std::int64_t interval, motion_params const& params = {}) {
    using real = strict_double;
    if (interval <= 0) { return; }
    real const gone = real(static_cast<double>(interval)) / (real(1e9) * real(params.memory));
    real const share = max_of(real(1) - gone, real(0));
    motion = detail::part_of_motion(motion.cast<real>(), share).cast<double>();
  }
};

}  // namespace FT_ABI
}  // namespace ft
