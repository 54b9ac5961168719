// SPDX-License-Identifier: Apache-2.0
#include "python/src/odometry_of.hpp"

namespace ftpy::FTPY_DEVICE {

std::unique_ptr<odometry> make_rectified_odometry(odometry_options const& o) {
  return translated([&]() -> std::unique_ptr<odometry> {
    auto const rig = rectified_of(o.of);
    return std::make_unique<odometry_of<std::decay_t<decltype(rig)>>>(rig, o);
  });
}

}  // namespace ftpy::FTPY_DEVICE
