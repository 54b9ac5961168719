// SPDX-License-Identifier: Apache-2.0
/// @file Where the camera is next: the last motion goes on, by the time that has passed.
#pragma once

#include <cstdint>

#include "examples/track_sequence/odometry.hpp"

namespace app {

/// The motion T that is `share` times as long: exp(share * log(T)) in SE(3), the same screw.
/// @pre T turns by less than half a turn
rigid_pose part_of_motion(rigid_pose const& T, double share);

/// Constant velocity from the last two frames that were tracked. No member waits for anything.
class motion_model {
public:
  /// Stamps that differ by less than this share of the interval count as evenly spaced, and the
  /// motion goes on bit for bit: recorded cameras jitter by less, and a drive or flight changes its
  /// motion by as much from frame to frame.
  static constexpr double even = 0.05;
  /// No prediction goes further than so many motions; a longer gap is a matter of searching.
  static constexpr double longest = 5;

  /// T_cw after `interval_ns` more. Where an interval is unknown or not above 0, that of the last
  /// motion is taken.
  rigid_pose predict(rigid_pose const& T_cw, std::int64_t interval_ns) const;

  /// The camera went from one pose to the other in `interval_ns`.
  void observe(rigid_pose const& from, rigid_pose const& to, std::int64_t interval_ns);
  void rest();       ///< nothing is known: predict no motion
  void slow_down();  ///< half the motion in the same interval

private:
  rigid_pose motion_;  ///< T_cw of a frame times the inverse of the one before
  std::int64_t interval_ns_ = 0;
};

}  // namespace app
