// SPDX-License-Identifier: Apache-2.0
// Distances of the library's descriptors against their definitions, in double and bit by bit, and
// numbers of 16 bits against all that there are.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <type_traits>
#include <vector>

#include "ft/containers/keypoints.hpp"
#include "ft/descriptors/binary_descriptor.hpp"
#include "ft/descriptors/vector_descriptor.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/descriptor_rows.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/random.hpp"

namespace descriptor_models_test {

using test::at;

/// Item: a pair of rows.
template <typename D>
struct compare_rows {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, D const* a, D const* b,
                                 ft::descriptor_distance<D>* out) const {
    out[i] = D::distance(a[i], b[i]);
  }
};
template <typename D, typename Exec>
auto distances_by(Exec const& exec, std::vector<D> const& a, std::vector<D> const& b) {
  auto const x = test::to_exec(exec, a);
  auto const y = test::to_exec(exec, b);
  ft::buffer<ft::descriptor_distance<D>, Exec::space> const out(a.size());
  ft::for_each_item<ft::per_thread>(exec, static_cast<int>(a.size()), compare_rows<D>{},
                                    static_cast<D const*>(x.data()),
                                    static_cast<D const*>(y.data()), out.data());
  return test::from_exec(exec, out.data(), a.size());
}

template <int Bits>
int plain_distance(ft::binary_descriptor<Bits> const& a, ft::binary_descriptor<Bits> const& b) {
  int sum = 0;
  for (int i = 0; i < Bits; ++i) {
    sum += static_cast<int>((a.words[i / 32] ^ b.words[i / 32]) >> (i % 32) & 1u);
  }
  return sum;
}

/// A number of 16 bits, from its sign, exponent and fraction.
double plain_value(std::uint16_t bits) {
  int const exponent = bits >> 10 & 31, fraction = bits & 1023;
  double v = exponent == 0 ? std::ldexp(fraction, -24) : std::ldexp(1024 + fraction, exponent - 25);
  if (exponent == 31) {
    v = fraction == 0 ? std::numeric_limits<double>::infinity()
                      : std::numeric_limits<double>::quiet_NaN();
  }
  return bits >> 15 != 0 ? -v : v;
}
double plain_value(ft::float16 v) { return plain_value(v.bits); }
double plain_value(float v) { return static_cast<double>(v); }
double plain_value(std::int8_t v) { return v; }

template <typename T, int N, typename Metric>
double plain_distance(ft::vector_descriptor<T, N, Metric> const& a,
                      ft::vector_descriptor<T, N, Metric> const& b) {
  double squares = 0, products = 0;
  for (int i = 0; i < N; ++i) {
    double const x = plain_value(a.of[i]), y = plain_value(b.of[i]);
    squares += (x - y) * (x - y);
    products += x * y;
  }
  if (std::is_same<Metric, ft::squared_distance>::value) { return squares; }
  return (std::is_same<T, std::int8_t>::value ? 127 * 127 : 1) - products;
}

template <typename D, typename Exec>
void distances_are_those_of_the_definition(Exec const& exec, double tolerance) {
  test::generator random(4);
  auto a = test::random_rows<D>(random, 300);
  auto b = test::random_rows<D>(random, 300);
  b[7] = a[7];
  auto const got = distances_by(exec, a, b);
  auto const again = distances_by(exec, b, a);
  for (std::size_t i = 0; i < a.size(); ++i) {
    ASSERT_NEAR(static_cast<double>(got[i]), static_cast<double>(plain_distance(a[i], b[i])),
                tolerance);
    ASSERT_EQ(got[i], again[i]) << "not symmetric";
    ASSERT_EQ(got[i], D::distance(a[i], b[i])) << "not the host's bits";
  }
}

template <typename Backend>
class DescriptorModels : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(DescriptorModels, test::backends);

TYPED_TEST(DescriptorModels, DistancesOfBits) {
  TypeParam backend;
  distances_are_those_of_the_definition<ft::binary_descriptor<8>>(backend.exec, 0);
  distances_are_those_of_the_definition<ft::binary_descriptor<128>>(backend.exec, 0);
  distances_are_those_of_the_definition<ft::binary_descriptor<256>>(backend.exec, 0);
  distances_are_those_of_the_definition<ft::binary_descriptor<264>>(backend.exec, 0);
  distances_are_those_of_the_definition<ft::binary_descriptor<488>>(backend.exec, 0);
  distances_are_those_of_the_definition<ft::binary_descriptor<512>>(backend.exec, 0);
}

TYPED_TEST(DescriptorModels, DistancesOfNumbers) {
  TypeParam backend;
  using ft::dot_product;
  distances_are_those_of_the_definition<ft::vector_descriptor<float, 3>>(backend.exec, 1e-5);
  distances_are_those_of_the_definition<ft::vector_descriptor<float, 128>>(backend.exec, 1e-4);
  distances_are_those_of_the_definition<ft::vector_descriptor<float, 128, dot_product>>(
      backend.exec, 1e-4);
  distances_are_those_of_the_definition<ft::vector_descriptor<ft::float16, 31>>(backend.exec, 1e-4);
  distances_are_those_of_the_definition<ft::vector_descriptor<ft::float16, 128>>(backend.exec,
                                                                                 1e-4);
  distances_are_those_of_the_definition<ft::vector_descriptor<ft::float16, 128, dot_product>>(
      backend.exec, 1e-4);
  distances_are_those_of_the_definition<ft::vector_descriptor<std::int8_t, 5>>(backend.exec, 0);
  distances_are_those_of_the_definition<ft::vector_descriptor<std::int8_t, 128>>(backend.exec, 0);
  distances_are_those_of_the_definition<ft::vector_descriptor<std::int8_t, 128, dot_product>>(
      backend.exec, 0);
}

TYPED_TEST(DescriptorModels, IntegersAreExactInFloats) {
  TypeParam backend;
  using D = ft::vector_descriptor<float, 128>;
  using H = ft::vector_descriptor<ft::float16, 128>;
  test::generator random(6);
  std::vector<D> a(200), b(200);
  std::vector<H> c(200), d(200);
  for (std::size_t i = 0; i < a.size(); ++i) {
    for (std::size_t k = 0; k < 128; ++k) {
      a[i].of[k] = static_cast<float>(random.below(256));
      b[i].of[k] = static_cast<float>(random.below(256));
      c[i].of[k] = ft::float16::nearest(a[i].of[k]);
      d[i].of[k] = ft::float16::nearest(b[i].of[k]);
    }
  }
  auto const got = distances_by(backend.exec, a, b);
  auto const of_halves = distances_by(backend.exec, c, d);
  for (std::size_t i = 0; i < a.size(); ++i) {
    ASSERT_EQ(static_cast<double>(got[i]), plain_distance(a[i], b[i]));
    ASSERT_EQ(static_cast<double>(of_halves[i]), plain_distance(a[i], b[i]));
  }
}

TYPED_TEST(DescriptorModels, RowsAreAtNoDistanceFromThemselves) {
  TypeParam backend;
  test::generator random(8);
  using H = ft::vector_descriptor<ft::float16, 100>;
  auto const halves = test::random_rows<H>(random, 200);
  for (float const d : distances_by(backend.exec, halves, halves)) { EXPECT_EQ(d, 0); }
  using B = ft::binary_descriptor<488>;
  auto const bits = test::random_rows<B>(random, 200);
  auto others = bits;
  for (auto& row : others) { row.words[15] ^= 0xffffff00u; }
  for (int const d : distances_by(backend.exec, bits, others)) {
    EXPECT_EQ(d, 0) << "bits past the last one count";
  }
}

/// Item: a number of 16 bits, and one between it and the next.
struct convert_numbers {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, float const* in, float* value,
                                 std::uint16_t* nearest) const {
    value[i] = static_cast<float>(ft::float16{static_cast<std::uint16_t>(i & 0xffff)});
    nearest[i] = ft::float16::nearest(in[i]).bits;
  }
};

TYPED_TEST(DescriptorModels, NumbersOf16Bits) {
  TypeParam backend;
  constexpr int all = 1 << 16, kinds = 6;
  auto const value = [](int i) { return plain_value(static_cast<std::uint16_t>(i)); };
  // Each number, the middle to the next one and its neighbours, and some between.
  std::vector<float> in;
  for (int kind = 0; kind < kinds; ++kind) {
    for (int i = 0; i < all; ++i) {
      bool const finite = (i & 0x7fff) < 0x7bff;
      auto const v = static_cast<float>(value(i));
      auto const middle = static_cast<float>(finite ? (value(i) + value(i + 1)) / 2 : value(i));
      float const given[kinds] = {v,
                                  middle,
                                  std::nextafter(middle, 0.0f),
                                  std::nextafter(middle, 2 * middle),
                                  finite ? v + 0.3f * (static_cast<float>(value(i + 1)) - v) : v,
                                  i % 2 == 0 ? 65519.996f : -65520.0f};
      in.push_back(given[kind]);
    }
  }
  auto const there = test::to_exec(backend.exec, in);
  ft::buffer<float, TypeParam::exec_type::space> const values(in.size());
  ft::buffer<std::uint16_t, TypeParam::exec_type::space> const nearest(in.size());
  ft::for_each_item<ft::per_thread>(backend.exec, static_cast<int>(in.size()), convert_numbers{},
                                    static_cast<float const*>(there.data()), values.data(),
                                    nearest.data());
  auto const got = test::from_exec(backend.exec, values.data(), in.size());
  auto const back = test::from_exec(backend.exec, nearest.data(), in.size());
  std::vector<double> positive;
  for (int i = 0; i < 0x7c00; ++i) { positive.push_back(value(i)); }
  positive.push_back(65536);  // infinity's place
  for (std::size_t i = 0; i < in.size(); ++i) {
    double const want = value(static_cast<int>(i) & 0xffff);
    ASSERT_TRUE(static_cast<double>(got[i]) == want || (std::isnan(got[i]) && std::isnan(want)));
    if (std::isnan(in[i])) {
      ASSERT_TRUE(std::isnan(plain_value(back[i])));
      continue;
    }
    double const size = std::min(std::abs(static_cast<double>(in[i])), 65536.0);
    auto const above = std::lower_bound(positive.begin(), positive.end(), size);
    auto k = above - positive.begin();
    if (k > 0) {
      double const up = *above - size, down = size - positive[at(k - 1)];
      k -= static_cast<int>(down < up || (down == up && k % 2 == 1));
    }
    auto const sign = std::signbit(in[i]) ? 0x8000 : 0;
    ASSERT_EQ(back[i], k + sign) << in[i];
  }
}

TYPED_TEST(DescriptorModels, OrbIsOneOfThem) {
  static_assert(std::is_same<ft::descriptor, ft::binary_descriptor<256>>::value, "ORB's");
  test::generator random(2);
  for (int i = 0; i < 500; ++i) {
    auto const a = random.descriptor();
    auto const b = random.flipped(a, i % 256);
    EXPECT_EQ(ft::descriptor::distance(a, b), ft::hamming(a, b));
  }
}

TEST(DescriptorRows, FromBytes) {
  unsigned char bytes[61];
  for (std::size_t i = 0; i < 61; ++i) { bytes[i] = static_cast<unsigned char>(3 * i + 7); }
  auto const row = ft::binary_descriptor<488>::from_bytes(bytes);
  EXPECT_EQ(std::memcmp(row.words, bytes, 61), 0);
  EXPECT_EQ(row.words[15] >> 8, 0u);
}

// What misses a part of the contract is no model.
struct no_rules {
  static constexpr char const* name = "no_rules";
  FT_HOST_DEVICE static int distance(no_rules const&, no_rules const&) { return 0; }
};
struct other_distance {
  static constexpr char const* name = "other_distance";
  static constexpr ft::descriptor_rules<float> rules{0, 1, 1, 1, 1};
  FT_HOST_DEVICE static int distance(other_distance const&, other_distance const&) { return 0; }
};
struct default_value {
  static constexpr char const* name = "default_value";
  static constexpr ft::descriptor_rules<int> rules{0, 1, 1, 1, 1};
  int of = 0;
  FT_HOST_DEVICE static int distance(default_value const&, default_value const&) { return 0; }
};
struct double_distance {
  static constexpr char const* name = "double_distance";
  static constexpr ft::descriptor_rules<double> rules{0, 1, 1, 1, 1};
  FT_HOST_DEVICE static double distance(double_distance const&, double_distance const&) {
    return 0;
  }
};
struct parts_alone {
  static constexpr char const* name = "parts_alone";
  static constexpr ft::descriptor_rules<int> rules{0, 1, 1, 1, 1};
  static constexpr int parts = 2;
  FT_HOST_DEVICE static int distance(parts_alone const&, parts_alone const&) { return 0; }
};
static_assert(!ft::is_descriptor_model_v<no_rules>, "rules");
static_assert(!ft::is_descriptor_model_v<other_distance>, "a distance of the rules' type");
static_assert(!ft::is_descriptor_model_v<default_value>, "no default values");
static_assert(!ft::is_descriptor_model_v<double_distance>, "int or float");
static_assert(!ft::is_descriptor_model_v<parts_alone>, "all of the parts' members");
static_assert(!ft::is_descriptor_model_v<int>, "a structure");

}  // namespace descriptor_models_test
