// SPDX-License-Identifier: Apache-2.0
#define FT_DESCRIPTOR ft_int8_128
#include <cstdint>

#include "ft/descriptors/vector_descriptor.hpp"

/// Two descriptors of SIFT, which have a length of about 512, are of one point if their distance is
/// below 250.
struct ft_int8_128 : ft::vector_descriptor<std::int8_t, 128> {
  static constexpr char const* name = "int8_128";
  static constexpr ft::descriptor_rules<int> rules{0, 128 * 255 * 255, 62500, 16, 25};
};

#include "library/described.hpp"
