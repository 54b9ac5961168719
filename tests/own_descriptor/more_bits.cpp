// SPDX-License-Identifier: Apache-2.0
// 488 bits, as many bytes as AKAZE has.
#define FT_DESCRIPTOR more_bits
#include <cstring>
#include <string>

#include "ft/descriptors/binary_descriptor.hpp"

struct more_bits : ft::binary_descriptor<488> {
  static constexpr char const* name = "more_bits";
};

#include "tests/own_descriptor/follow.hpp"

namespace own_descriptor_test {

/// Most of ORB's bits twice.
answers track_more_bits(given_walk const& given, std::string const& orb_map) {
  return follow(given, pair_of(given), orb_map, [](orb_bytes const& orb) {
    more_bits own{};
    std::memcpy(own.words, orb, sizeof orb);
    std::memcpy(own.words + 8, orb, 61 - sizeof orb);
    return own;
  });
}

}  // namespace own_descriptor_test
