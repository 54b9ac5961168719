// SPDX-License-Identifier: Apache-2.0
/// @file Odometries of other descriptors, each in a unit of its own. Between units there are types
/// of ft/types alone, which are the same in all.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "ft/types/features.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/tracking.hpp"

namespace own_descriptor_test {

/// Frames with descriptors of ORB, of which a unit makes its own.
struct given_walk {
  ft::odometry_params params;
  std::vector<ft::given_features> frames;
  float fx, cx, cy, baseline;  ///< of the rig
};

struct answers {
  std::vector<ft::tracking> frames;
  std::vector<ft::tracking> loaded;  ///< of the second half, after a map that the first one saved
  std::string map;                   ///< that was saved
  std::string of_images, of_prefetch, of_places, of_bytes, of_other_map;  ///< what was refused
};

/// ORB's bits, but not ORB: a rectified pair.
answers track_plain_bits(given_walk const& given, std::string const& orb_map);
/// 488 bits: a rectified pair.
answers track_more_bits(given_walk const& given, std::string const& orb_map);
/// 128 numbers of int8: a camera with depths.
answers track_small_numbers(given_walk const& given, std::string const& orb_map);

/// By an odometry of 488 bits, on the host, of a frame whose right image has none.
int keypoints_of_a_frame(int count, float const* positions, std::int64_t time_ns);

}  // namespace own_descriptor_test
