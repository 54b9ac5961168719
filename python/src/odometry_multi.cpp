// SPDX-License-Identifier: Apache-2.0
#include "python/src/odometry_of.hpp"

namespace ftpy::FTPY_DEVICE {
namespace {

template <int N>
std::unique_ptr<odometry> make(odometry_options const& o) {
  return std::make_unique<odometry_of<ft::multi_rig<N>>>(multi_of<N>(o.of), o);
}

}  // namespace

std::unique_ptr<odometry> make_multi_odometry(odometry_options const& o) {
  return translated([&]() -> std::unique_ptr<odometry> {
    // Two sizes for all numbers: each one takes the compiler a minute.
    return o.of.cameras.size() <= 4 ? make<4>(o) : make<most_cameras>(o);
  });
}

}  // namespace ftpy::FTPY_DEVICE
