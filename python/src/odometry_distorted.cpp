// SPDX-License-Identifier: Apache-2.0
#include "ft/cameras/distorted_pair.hpp"
#include "python/src/odometry_of.hpp"

namespace ftpy::FTPY_DEVICE {

std::unique_ptr<odometry> make_distorted_odometry(odometry_options const& o) {
  using camera = ft::radtan8<float>;
  return translated([&]() -> std::unique_ptr<odometry> {
    auto rig = ft::distorted_pair<camera>::make(
        camera_of<camera>(o.of.left, "left"), camera_of<camera>(o.of.right, "right"),
        to_ft(o.of.T_right_left).cast<float>(),
        camera_of<ft::pinhole<float>>(o.of.wanted, "wanted"));
    rig.width = o.of.raw_width;
    rig.height = o.of.raw_height;
    return std::make_unique<odometry_of<ft::distorted_pair<camera>>>(rig, o);
  });
}

}  // namespace ftpy::FTPY_DEVICE
