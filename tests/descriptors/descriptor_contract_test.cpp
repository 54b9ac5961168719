// SPDX-License-Identifier: Apache-2.0
// The library's descriptors keep the contract. A new one: a description and a line at the end.
#include "tests/descriptor_contract.hpp"

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <random>
#include <type_traits>

#include "ft/containers/keypoints.hpp"
#include "ft/descriptors/binary_descriptor.hpp"
#include "ft/descriptors/vector_descriptor.hpp"

namespace descriptor_contract_test {

template <int Bits>
struct bits : descriptor_contract::description<ft::binary_descriptor<Bits>> {
  static ft::binary_descriptor<Bits> draw(std::mt19937& random) {
    ft::binary_descriptor<Bits> row;
    for (auto& word : row.words) { word = static_cast<std::uint32_t>(random()); }
    return row;
  }
};

/// Rows of length 1, or 127.
template <typename T, int N, typename Metric = ft::squared_distance>
struct numbers : descriptor_contract::description<ft::vector_descriptor<T, N, Metric>> {
  static ft::vector_descriptor<T, N, Metric> draw(std::mt19937& random) {
    std::normal_distribution<float> normal;
    float of[N];
    float squares = 0;
    for (float& v : of) {
      v = normal(random);
      squares += v * v;
    }
    ft::vector_descriptor<T, N, Metric> row;
    for (std::size_t i = 0; i < N; ++i) {
      float const v = of[i] / std::sqrt(squares);
      if constexpr (std::is_same<T, float>::value) {
        row.of[i] = v;
      } else if constexpr (std::is_same<T, ft::float16>::value) {
        row.of[i] = ft::float16::nearest(v);
      } else {
        row.of[i] = static_cast<std::int8_t>(std::lround(127 * v));
      }
    }
    return row;
  }
};

/// SIFT's rows have a length of 512: rules of its own.
struct sift : ft::vector_descriptor<float, 128> {
  static constexpr char const* name = "sift";
  static constexpr ft::descriptor_rules<float> rules{0, 1e7f, 62500, 16, 25};
};
struct sift_rows : descriptor_contract::description<sift> {
  static sift draw(std::mt19937& random) {
    sift row;
    for (float& v : row.of) { v = static_cast<float>(random() % 90); }
    return row;
  }
};

}  // namespace descriptor_contract_test

using orb_rows = descriptor_contract_test::bits<256>;
using bits_128_rows = descriptor_contract_test::bits<128>;
using bits_488_rows = descriptor_contract_test::bits<488>;
using float_rows = descriptor_contract_test::numbers<float, 64>;
using float_product_rows = descriptor_contract_test::numbers<float, 64, ft::dot_product>;
using half_rows = descriptor_contract_test::numbers<ft::float16, 64>;
using int8_rows = descriptor_contract_test::numbers<std::int8_t, 64>;

static_assert(std::is_same<orb_rows::model, ft::descriptor>::value, "ORB's");

FT_DESCRIPTOR_CONTRACT(orb, orb_rows);
FT_DESCRIPTOR_CONTRACT(bits_128, bits_128_rows);
FT_DESCRIPTOR_CONTRACT(bits_488, bits_488_rows);
FT_DESCRIPTOR_CONTRACT(floats, float_rows);
FT_DESCRIPTOR_CONTRACT(float_products, float_product_rows);
FT_DESCRIPTOR_CONTRACT(halves, half_rows);
FT_DESCRIPTOR_CONTRACT(int8s, int8_rows);
FT_DESCRIPTOR_CONTRACT(sift, descriptor_contract_test::sift_rows);
