// SPDX-License-Identifier: Apache-2.0
/// @file Prediction of the next pose: the last motion continues, scaled by the elapsed time.
#pragma once

#include <cstdint>

#include "examples/track_sequence/odometry.hpp"

namespace app {

/// The motion T scaled in length: exp(share * log(T)) in SE(3), along the same screw.
/// @pre T turns by less than half a turn
rigid_pose part_of_motion(rigid_pose const& T, double share);

/// Constant velocity from the last two tracked frames. No member waits.
class motion_model {
public:
  /// Time stamps whose distances differ by less than this share count as evenly spaced, and the
  /// motion is repeated bit for bit. Recorded cameras jitter by less, and the motion of a car or
  /// drone changes by as much from frame to frame.
  static constexpr double even = 0.05;
  /// A prediction covers at most this many motions; a longer gap needs a wide search.
  static constexpr double longest = 5;

  /// T_cw after `interval_ns` more. If an interval is unknown or not above 0, that of the last
  /// motion is used.
  rigid_pose predict(rigid_pose const& T_cw, std::int64_t interval_ns) const;

  /// States that the camera moved from one pose to the other in `interval_ns`.
  void observe(rigid_pose const& from, rigid_pose const& to, std::int64_t interval_ns);
  void rest();       ///< forgets the motion: predicts none
  void slow_down();  ///< half the motion in the same interval

private:
  rigid_pose motion_;  ///< T_cw of a frame times the inverse of the last one
  std::int64_t interval_ns_ = 0;
};

}  // namespace app
