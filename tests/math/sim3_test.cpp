// SPDX-License-Identifier: Apache-2.0
// Similarities: the exponential of a matrix in long double, logarithms, equal bits on executors.
#include "ft/math/sim3.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <random>
#include <vector>

#include "ft/core/execution.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/memory.hpp"

namespace sim3_test {

using ft::strict_double;

/// Rotation, translation, logarithm of the scale.
struct tangent {
  double d[7];
};

struct matrix_4 {
  long double m[4][4];
};
inline matrix_4 product(matrix_4 const& a, matrix_4 const& b) {
  matrix_4 c{};
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < 4; ++j) {
      for (int k = 0; k < 4; ++k) { c.m[i][j] += a.m[i][k] * b.m[k][j]; }
    }
  }
  return c;
}

/// The exponential of [[w] + sigma I, u; 0, 0] by its series, squared eight times.
inline matrix_4 exponential(tangent const& x) {
  long double const s = x.d[6];
  long double const v[4][4] = {{s, -x.d[2], x.d[1], x.d[3]},
                               {x.d[2], s, -x.d[0], x.d[4]},
                               {-x.d[1], x.d[0], s, x.d[5]},
                               {0, 0, 0, 0}};
  matrix_4 X{};
  matrix_4 term{};
  matrix_4 sum{};
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < 4; ++j) { X.m[i][j] = v[i][j] / 256; }
    term.m[i][i] = sum.m[i][i] = 1;
  }
  for (int n = 1; n < 30; ++n) {
    term = product(term, X);
    for (int i = 0; i < 4; ++i) {
      for (int j = 0; j < 4; ++j) {
        term.m[i][j] /= n;
        sum.m[i][j] += term.m[i][j];
      }
    }
  }
  for (int k = 0; k < 8; ++k) { sum = product(sum, sum); }
  return sum;
}

/// Vectors that turn by up to 3 rad, some of them hardly, and scale by up to e^3.
inline std::vector<tangent> tangents() {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  std::vector<tangent> all(1);
  for (int i = 0; i < 600; ++i) {
    tangent x{};
    for (double& v : x.d) { v = normal(random); }
    double const length = std::sqrt(x.d[0] * x.d[0] + x.d[1] * x.d[1] + x.d[2] * x.d[2]);
    double const small = std::pow(10.0, -static_cast<double>(i / 50 % 6) * 2);
    double const angle = 3 * std::generate_canonical<double, 53>(random) * small;
    for (int k = 0; k < 3; ++k) { x.d[k] *= angle / length; }
    x.d[6] = std::max(-3.0, std::min(3.0, x.d[6] * (i % 3 == 0 ? 1e-7 : 1)));
    all.push_back(x);
  }
  return all;
}

inline ft::similarity<strict_double> exp_of(tangent const& x) {
  strict_double d[7];
  for (int k = 0; k < 7; ++k) { d[k] = x.d[k]; }
  return ft::detail::exp_sim3(d);
}

TEST(Similarities, ExponentialsAreThoseOfMatrices) {
  for (auto const& x : tangents()) {
    auto const T = exp_of(x).cast<double>();
    auto const want = exponential(x);
    double const t[3] = {T.t.x, T.t.y, T.t.z};
    double const size = std::max(1.0, T.scale) * 1e-14;
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) {
        EXPECT_NEAR(T.scale * T.R.m[3 * r + c], static_cast<double>(want.m[r][c]), size);
      }
      EXPECT_NEAR(t[r], static_cast<double>(want.m[r][3]), 10 * size);
    }
  }
}

TEST(Similarities, LogarithmsAreTheVectors) {
  for (auto const& x : tangents()) {
    strict_double d[7];
    ft::detail::log_sim3(exp_of(x), d);
    for (int k = 0; k < 7; ++k) { EXPECT_NEAR(d[k].value, x.d[k], 1e-13) << k; }
  }
}

TEST(Similarities, ProductsAndInversesMovePoints) {
  auto const all = tangents();
  ft::vec3<double> const p{0.3, -2, 5};
  for (std::size_t i = 0; i + 1 < all.size(); ++i) {
    auto const A = exp_of(all[i]).cast<double>();
    auto const B = exp_of(all[i + 1]).cast<double>();
    auto const once = (A * B) * p - A * (B * p);
    auto const back = A.inverse() * (A * p) - p;
    EXPECT_LT(std::sqrt(ft::dot(once, once)), 1e-11);
    EXPECT_LT(std::sqrt(ft::dot(back, back)), 1e-11);
  }
}

TEST(Similarities, ExponentialsOfNumbersAreExactToRounding) {
  std::mt19937 random(4);
  std::uniform_real_distribution<double> any(-707, 709);
  for (int i = 0; i < 20000; ++i) {
    double const v = i % 2 == 0 ? any(random) : any(random) * 1e-3;
    long double const want = std::exp(static_cast<long double>(v));
    long double const error = static_cast<long double>(ft::detail::strict_exp(v).value) - want;
    EXPECT_LT(std::abs(error / want), 2.3e-16L) << v;
  }
  EXPECT_EQ(ft::detail::strict_exp(0.0).value, 1);
  EXPECT_EQ(ft::detail::strict_exp(-1e9).value, 0);
  double const infinity = std::numeric_limits<double>::infinity();
  EXPECT_EQ(ft::detail::strict_exp(710.0).value, infinity);
  EXPECT_EQ(ft::detail::strict_exp(infinity).value, infinity);
  EXPECT_TRUE(std::isnan(ft::detail::strict_exp(std::nan("")).value));
}

struct there_and_back {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, tangent const* in,
                                 ft::similarity<double>* motion, tangent* out) const {
    strict_double d[7];
    for (int k = 0; k < 7; ++k) { d[k] = in[i].d[k]; }
    auto const T = ft::detail::exp_sim3(d);
    motion[i] = T.cast<double>();
    ft::detail::log_sim3(T, d);
    for (int k = 0; k < 7; ++k) { out[i].d[k] = d[k].value; }
  }
};

template <typename Backend>
class similarities : public test::on_backend<Backend> {
protected:
  Backend backend;
};
TYPED_TEST_SUITE(similarities, test::backends);

TYPED_TEST(similarities, executors_agree_to_the_bit) {
  auto const all = tangents();
  auto const& exec = this->backend.exec;
  auto const in = test::to_exec(exec, all);
  auto motion = test::to_exec(exec, std::vector<ft::similarity<double>>(all.size()));
  auto out = test::to_exec(exec, std::vector<tangent>(all.size()));
  ft::for_each_item<ft::per_thread>(exec, static_cast<int>(all.size()), there_and_back{},
                                    static_cast<tangent const*>(in.data()), motion.data(),
                                    out.data());
  std::vector<ft::similarity<double>> want_motion(all.size());
  std::vector<tangent> want(all.size());
  ft::for_each_item<ft::per_thread>(ft::host_exec(1), static_cast<int>(all.size()),
                                    there_and_back{}, all.data(), want_motion.data(), want.data());
  EXPECT_TRUE(test::same_bits(test::from_exec(exec, motion.data(), all.size()), want_motion));
  EXPECT_TRUE(test::same_bits(test::from_exec(exec, out.data(), all.size()), want));
}

}  // namespace sim3_test
