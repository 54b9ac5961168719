// SPDX-License-Identifier: Apache-2.0
// Distances that are no small integers.
#define FT_DESCRIPTOR small_numbers
#include <cstdint>
#include <string>

#include "ft/descriptors/vector_descriptor.hpp"

/// Numbers are -60, 0 or 60, so 64 bits of ORB that differ are up to 64 times 60^2.
struct small_numbers : ft::vector_descriptor<std::int8_t, 128> {
  static constexpr char const* name = "small_numbers";
  static constexpr ft::descriptor_rules<int> rules{0, 128 * 120 * 120, 64 * 3600, 9, 10};
};

#include "tests/own_descriptor/follow.hpp"

namespace own_descriptor_test {

/// Two bits of ORB a number.
answers track_small_numbers(given_walk const& given, std::string const& orb_map) {
  auto const rig = ft::rgbd_rig<>::make(camera_of(given), static_cast<double>(given.baseline));
  return follow(given, rig, orb_map, [](orb_bytes const& orb) {
    small_numbers own;
    for (int i = 0; i < 128; ++i) {
      int const bits = orb[i / 4] >> (2 * (i % 4)) & 3;
      own.of[i] = static_cast<std::int8_t>(60 * ((bits & 1) + (bits >> 1)) - 60);
    }
    return own;
  });
}

}  // namespace own_descriptor_test
