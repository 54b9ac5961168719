// SPDX-License-Identifier: Apache-2.0
#define FT_DESCRIPTOR ft_bits_512
#include "ft/descriptors/binary_descriptor.hpp"

struct ft_bits_512 : ft::binary_descriptor<512> {
  static constexpr char const* name = "bits_512";
};

#include "library/described.hpp"
