// SPDX-License-Identifier: Apache-2.0
// Rigs whose keypoints are searched as those of a rectified pair: one unit, for they share most of
// what the compiler makes of an odometry.
#include "ft/cameras/rgbd_rig.hpp"
#include "python/src/odometry_of.hpp"

namespace ftpy::FTPY_DEVICE {
namespace {

template <typename Rig>
std::unique_ptr<odometry> make(Rig const& rig, odometry_options const& o) {
  return std::make_unique<odometry_of<Rig>>(rig, o);
}

}  // namespace

std::unique_ptr<odometry> make_rectified_odometry(odometry_options const& o) {
  return translated([&] { return make(rectified_of(o.of), o); });
}

std::unique_ptr<odometry> make_distorted_odometry(odometry_options const& o) {
  return translated([&] { return make(distorted_of(o.of), o); });
}

std::unique_ptr<odometry> make_rgbd_odometry(odometry_options const& o) {
  return translated([&] {
    auto const with = [&](auto const& camera) {
      using rig_type = ft::rgbd_rig<std::decay_t<decltype(camera)>>;
      rig_type rig = rig_type::make(camera, o.of.baseline, narrow(o.of.depth_scale.value_or(0)));
      rig.min_depth = narrow(o.of.min_depth);
      rig.max_depth = narrow(o.of.max_depth);
      rig.check();
      return make(rig, o);
    };
    if (o.of.left.size() == 4) { return with(camera_of<ft::pinhole<float>>(o.of.left, "depth")); }
    return with(camera_of<ft::radtan8<float>>(o.of.left, "depth"));
  });
}

}  // namespace ftpy::FTPY_DEVICE
