// SPDX-License-Identifier: Apache-2.0
#define FT_DESCRIPTOR plain_bits
#include <cstring>
#include <string>

#include "ft/descriptors/binary_descriptor.hpp"

struct plain_bits : ft::binary_descriptor<256> {
  static constexpr char const* name = "plain_bits";
};

#include "tests/own_descriptor/follow.hpp"

namespace own_descriptor_test {

answers track_plain_bits(given_walk const& given, std::string const& orb_map) {
  return follow(given, pair_of(given), orb_map, [](orb_bytes const& orb) {
    plain_bits own;
    std::memcpy(own.words, orb, sizeof orb);
    return own;
  });
}

}  // namespace own_descriptor_test
