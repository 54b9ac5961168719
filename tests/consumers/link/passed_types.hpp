// SPDX-License-Identifier: Apache-2.0
/// @file What two units hand each other: passive types of ft, which have one name in every
/// compiler.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "ft/types/errors.hpp"
#include "ft/types/images.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/relocalization.hpp"
#include "ft/types/tracking.hpp"

#define FT_PASSED FT_VISIBLE  // the giver may be a shared library that hides its symbols

FT_PASSED ft::odometry_params given_params();
FT_PASSED ft::tracking given_tracking(ft::imu_measurement const& sample);
/// Sizes of all types, as the giver sees them.
FT_PASSED std::vector<std::size_t> given_sizes();
/// left * right^-1, of products that are rounded on their own.
FT_PASSED ft::rigid<double> given_product(ft::rigid<double> const& left,
                                          ft::rigid<double> const& right);
/// The grey value of a pixel of the right image.
FT_PASSED int given_pixel(ft::stereo_images const& images, int x, int y);
/// Replaces the map's points by one.
FT_PASSED void give_map(ft::odometry_map& map, std::vector<ft::stage_time>& times);
/// @throws bad_argument from a check of the library, in the giver's backend
FT_PASSED void give_bad_argument(ft::place_recovery const& recovery);
/// Calls, and says whether a bad_argument was caught.
FT_PASSED bool given_catch(void (*call)());

static std::vector<std::size_t> sizes_of_types() {
  return {sizeof(ft::odometry_params), sizeof(ft::tracker_params),  sizeof(ft::imu_params),
          sizeof(ft::tracking_rules),  sizeof(ft::place_recovery),  sizeof(ft::tracking),
          sizeof(ft::imu_tracking),    sizeof(ft::imu_measurement), sizeof(ft::downloaded_point),
          sizeof(ft::odometry_map),    sizeof(ft::stage_time),      sizeof(ft::rgbd_images),
          sizeof(ft::rig_images<32>),  sizeof(ft::rigid<double>),   sizeof(ft::relocalization),
          alignof(ft::tracking),       alignof(ft::odometry_params)};
}

static ft::rigid<double> product(ft::rigid<double> const& left, ft::rigid<double> const& right) {
  return (left.cast<ft::strict_double>() * right.cast<ft::strict_double>().inverse())
      .cast<double>();
}
