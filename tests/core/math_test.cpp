// SPDX-License-Identifier: Apache-2.0
// Arithmetic that must be the same on every executor: products kept apart, roundings, poses, small
// solvers.
#include "ft/core/arithmetic.hpp"
#include "ft/core/bits.hpp"
#include "ft/types/poses.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <bitset>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <random>
#include <utility>
#include <vector>

#include "ft/containers/keypoints.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/blur.hpp"
#include "ft/math/positive_definite.hpp"
#include "ft/math/se3.hpp"
#include "tests/support/backends.hpp"

namespace math_test {

// ---- functors
// ------------------------------------------------------------------------------------

struct arc_tangents {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, float const* y, float const* x,
                                 float* out) const {
    out[i] = ft::scalar::quick_atan2(ft::strict_float(y[i]), ft::strict_float(x[i])).value;
  }
};

/// tan(y), atan2(y, x), sin(y) and cos(y) of strict_double.
struct own_functions {
  static constexpr int count = 4;
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, double const* y, double const* x,
                                 double* out) const {
    ft::strict_double const v = y[i];
    out[count * i] = ft::scalar::tan(v).value;
    out[count * i + 1] = ft::scalar::atan2(v, ft::strict_double(x[i])).value;
    out[count * i + 2] = ft::scalar::sin(v).value;
    out[count * i + 3] = ft::scalar::cos(v).value;
  }
};

constexpr int scalar_functions = 6;

/// The functions for camera models, each of scalar S, at one value.
template <typename S>
struct all_scalar_functions {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, float const* values, float* out) const {
    S const v = S(values[i]);
    float* const to = out + scalar_functions * i;
    to[0] = ft::to_plain(ft::scalar::sin(v));
    to[1] = ft::to_plain(ft::scalar::cos(v));
    to[2] = ft::to_plain(ft::scalar::tan(v));
    to[3] = ft::to_plain(ft::scalar::exp(v));
    to[4] = ft::to_plain(ft::scalar::log(v));
    to[5] = ft::to_plain(ft::scalar::atan2(v, S(0.75f)));
  }
};

template <typename T>
struct sum_of_product {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, T const* a, T const* b, T const* c,
                                 T* out) const {
    using real = ft::strict<T>;
    out[4 * i] = (real(a[i]) * b[i] + c[i]).value;
    out[4 * i + 1] = (real(c[i]) - real(a[i]) * b[i]).value;
    real accumulated = c[i];
    accumulated += real(a[i]) * b[i];
    out[4 * i + 2] = accumulated.value;
    out[4 * i + 3] = (real(a[i]) / b[i] + c[i]).value;
  }
};

struct round_values {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, float const* values, int* even,
                                 int* away) const {
    even[i] = ft::round_to_even(values[i]);
    away[i] = ft::round_away(values[i]);
  }
};

struct count_bits {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, ft::descriptor const* d, int* bits,
                                 int* distances) const {
    bits[i] = ft::popcount(d[i].words[i % 8]);
    distances[i] = ft::hamming(d[i], d[i / 2]);
  }
};

struct exponential {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, double const* twists,
                                 ft::rigid<double>* out) const {
    ft::strict_double d[6];
    for (int k = 0; k < 6; ++k) { d[k] = twists[6 * i + k]; }
    out[i] = ft::detail::exp_se3(d).template cast<double>();
  }
};
struct exponential_in_float {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, float const* twists,
                                 ft::rigid<float>* out) const {
    ft::strict_float d[6];
    for (int k = 0; k < 6; ++k) { d[k] = twists[6 * i + k]; }
    out[i] = ft::detail::exp_se3(d).template cast<float>();
  }
};

/// A system of six equations: matrix as upper triangle by rows, right side.
struct system_6 {
  double upper[21];
  double right[6];
};
struct solution_6 {
  double x[6];
  int solved;
};
struct solve {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, system_6 const* systems, double damping,
                                 solution_6* out) const {
    ft::strict_double x[6] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    double terms[27];
    for (int k = 0; k < 6; ++k) { terms[k] = systems[i].right[k]; }
    for (int k = 0; k < 21; ++k) { terms[6 + k] = systems[i].upper[k]; }
    out[i].solved = static_cast<int>(ft::detail::solve_6(terms, ft::strict_double(damping), x));
    for (int k = 0; k < 6; ++k) { out[i].x[k] = x[k].value; }
  }
};

// ---- references
// ----------------------------------------------------------------------------------

using wide = long double;

/// Rodrigues' formula with the left Jacobian of the translation.
inline ft::rigid<double> exponential_by_rodrigues(double const* d) {
  wide const w[3] = {d[0], d[1], d[2]};
  wide const u[3] = {d[3], d[4], d[5]};
  wide const theta = std::sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]);
  wide const t2 = theta * theta;
  wide a = 1 - t2 / 6 + t2 * t2 / 120;
  wide b = 0.5L - t2 / 24 + t2 * t2 / 720;
  wide c = 1.0L / 6 - t2 / 120 + t2 * t2 / 5040;
  if (theta > 1e-3L) {
    a = std::sin(theta) / theta;
    wide const s = std::sin(theta / 2);
    b = 2 * s * s / t2;
    c = (theta - std::sin(theta)) / (t2 * theta);
  }
  wide const W[9] = {0, -w[2], w[1], w[2], 0, -w[0], -w[1], w[0], 0};
  ft::rigid<double> T{};
  wide t[3] = {0, 0, 0};
  for (int r = 0; r < 3; ++r) {
    for (int k = 0; k < 3; ++k) {
      wide square = 0;
      for (int m = 0; m < 3; ++m) { square += W[3 * r + m] * W[3 * m + k]; }
      wide const one = r == k ? 1 : 0;
      T.R.m[3 * r + k] = static_cast<double>(one + a * W[3 * r + k] + b * square);
      t[r] += (one + b * W[3 * r + k] + c * square) * u[k];
    }
  }
  T.t = {static_cast<double>(t[0]), static_cast<double>(t[1]), static_cast<double>(t[2])};
  return T;
}

/// Gaussian elimination with pivots.
inline std::vector<wide> solve_by_elimination(system_6 const& s, double damping) {
  wide m[6][7];
  int at = 0;
  for (int i = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j) { m[i][j] = m[j][i] = s.upper[at++]; }
    m[i][i] += damping;
    m[i][6] = s.right[i];
  }
  for (int k = 0; k < 6; ++k) {
    int pivot = k;
    for (int i = k + 1; i < 6; ++i) {
      if (std::abs(m[i][k]) > std::abs(m[pivot][k])) { pivot = i; }
    }
    std::swap(m[k], m[pivot]);
    for (int i = 0; i < 6; ++i) {
      if (i == k) { continue; }
      wide const factor = m[i][k] / m[k][k];
      for (int j = k; j < 7; ++j) { m[i][j] -= factor * m[k][j]; }
    }
  }
  std::vector<wide> x;
  for (int i = 0; i < 6; ++i) { x.push_back(m[i][6] / m[i][i]); }
  return x;
}

inline double largest_difference(ft::rigid<double> const& a, ft::rigid<double> const& b) {
  double worst =
      std::max({std::abs(a.t.x - b.t.x), std::abs(a.t.y - b.t.y), std::abs(a.t.z - b.t.z)});
  for (int i = 0; i < 9; ++i) { worst = std::max(worst, std::abs(a.R.m[i] - b.R.m[i])); }
  return worst;
}

// ---- tests
// ---------------------------------------------------------------------------------------

template <typename Backend>
class math_unit : public test::on_backend<Backend> {
protected:
  Backend backend;

  template <typename T>
  void check_products() {
    constexpr std::size_t n = 2000;
    std::mt19937 random(3);
    std::uniform_real_distribution<T> value(T(0.5), T(2));
    std::vector<T> a(n);
    std::vector<T> b(n);
    std::vector<T> c(n);
    for (std::size_t i = 0; i < n; ++i) {
      a[i] = value(random);
      b[i] = value(random);
      c[i] = i % 2 == 0 ? -a[i] * b[i]
                        : value(random);  // half of them cancel: only a fused sum is not 0
    }
    auto const d_a = test::to_exec(backend.exec, a);
    auto const d_b = test::to_exec(backend.exec, b);
    auto const d_c = test::to_exec(backend.exec, c);
    ft::buffer<T, Backend::exec_type::space> d_out(4 * n);
    ft::for_each_item<ft::per_thread>(backend.exec, static_cast<int>(n), sum_of_product<T>{},
                                      d_a.data(), d_b.data(), d_c.data(), d_out.data());
    auto const out = test::from_exec(backend.exec, d_out);
    int fused_differs = 0;
    for (std::size_t i = 0; i < n; ++i) {
      T volatile product = a[i] * b[i];
      T volatile sum = product + c[i];
      T volatile difference = c[i] - product;
      T volatile quotient = a[i] / b[i];
      T volatile with_quotient = quotient + c[i];
      EXPECT_EQ(out[4 * i], sum);
      EXPECT_EQ(out[4 * i + 1], difference);
      EXPECT_EQ(out[4 * i + 2], sum);
      EXPECT_EQ(out[4 * i + 3], with_quotient);
      fused_differs += static_cast<int>(std::fma(a[i], b[i], c[i]) != sum);
    }
    EXPECT_GT(fused_differs, static_cast<int>(n) / 4)
        << "the data must be able to tell a fused product";
  }
};
TYPED_TEST_SUITE(math_unit, test::backends);

TYPED_TEST(math_unit, strict_products_are_not_fused) {
  this->template check_products<float>();
  this->template check_products<double>();
}

TYPED_TEST(math_unit, roundings_are_those_of_the_standard_library) {
  std::vector<float> values{0.0f,        -0.0f,       0.49999997f,   -0.49999997f,   8388607.5f,
                            -8388607.5f, 16777216.0f, 2147483520.0f, -2147483520.0f, 1e-40f};
  for (int i = -2000; i <= 2000; ++i) {
    float const halved = static_cast<float>(i) + 0.5f;
    values.insert(values.end(), {halved, std::nextafter(halved, -1e9f),
                                 std::nextafter(halved, 1e9f), static_cast<float>(i)});
  }
  std::mt19937 random(5);
  for (int i = 0; i < 2000; ++i) {
    values.push_back(std::uniform_real_distribution<float>(-1e5f, 1e5f)(random));
  }
  auto const d_values = test::to_exec(this->backend.exec, values);
  auto const d_even = test::to_exec(this->backend.exec, std::vector<int>(values.size(), -7));
  auto const d_away = test::to_exec(this->backend.exec, std::vector<int>(values.size(), -7));
  ft::for_each_item<ft::per_thread>(this->backend.exec, static_cast<int>(values.size()),
                                    round_values{}, d_values.data(), d_even.data(), d_away.data());
  auto const even = test::from_exec(this->backend.exec, d_even);
  auto const away = test::from_exec(this->backend.exec, d_away);
  for (std::size_t i = 0; i < values.size(); ++i) {
    EXPECT_EQ(even[i], static_cast<int>(std::lrint(values[i]))) << values[i];
    EXPECT_EQ(away[i], static_cast<int>(std::lround(values[i]))) << values[i];
  }
}

TYPED_TEST(math_unit, functions_of_floats_are_rounded_once) {
  float const infinity = std::numeric_limits<float>::infinity();
  std::vector<float> values{0.0f,
                            -0.0f,
                            1.0f,
                            -1.0f,
                            1e-40f,
                            -1e-40f,
                            1e30f,
                            -1e30f,
                            88.72284f,
                            88.72283f,
                            -103.97f,
                            -103.98f,
                            -87.33f,
                            infinity,
                            -infinity,
                            1.5707964f,
                            std::numeric_limits<float>::quiet_NaN()};
  std::mt19937 random(21);
  std::uniform_real_distribution<float> angle(-7, 7);
  std::uniform_real_distribution<float> exponent(-30, 30);
  for (int i = 0; i < 20000; ++i) {
    values.push_back(angle(random));
    values.push_back(std::exp(exponent(random)));
  }
  auto const d_values = test::to_exec(this->backend.exec, values);
  auto const count = scalar_functions * values.size();
  auto const d_plain = test::to_exec(this->backend.exec, std::vector<float>(count, -7.0f));
  auto const d_strict = test::to_exec(this->backend.exec, std::vector<float>(count, -7.0f));
  auto const items = static_cast<int>(values.size());
  auto const* const in = d_values.data();
  ft::for_each_item<ft::per_thread>(this->backend.exec, items, all_scalar_functions<float>{}, in,
                                    d_plain.data());
  ft::for_each_item<ft::per_thread>(this->backend.exec, items,
                                    all_scalar_functions<ft::strict_float>{}, in, d_strict.data());
  auto const plain = test::from_exec(this->backend.exec, d_plain);
  auto const strict = test::from_exec(this->backend.exec, d_strict);
  for (std::size_t i = 0; i < values.size(); ++i) {
    long double const v = static_cast<long double>(values[i]);
    long double const exact[scalar_functions] = {std::sin(v), std::cos(v), std::tan(v),
                                                 std::exp(v), std::log(v), std::atan2(v, 0.75L)};
    for (std::size_t k = 0; k < scalar_functions; ++k) {
      auto const want = static_cast<float>(exact[k]);
      float const got = plain[scalar_functions * i + k];
      float const got_strict = strict[scalar_functions * i + k];
      if (std::isnan(want)) {
        EXPECT_TRUE(std::isnan(got) && std::isnan(got_strict)) << k << " of " << values[i];
      } else {
        EXPECT_EQ(got, want) << k << " of " << values[i];
        EXPECT_EQ(got_strict, want) << k << " of " << values[i];
      }
    }
  }
}

/// Within 4 units in the last place of the exact value, and the same bits as on the host.
TYPED_TEST(math_unit, tan_and_atan2_of_strict_doubles_are_near_and_the_same_everywhere) {
  std::vector<double> y;
  std::vector<double> x;
  std::mt19937 random(22);
  std::uniform_real_distribution<double> unit(-1, 1);
  for (int i = 0; i < 40000; ++i) {
    y.push_back(unit(random) * std::exp2(static_cast<int>(random() % 24u) - 10));
    x.push_back(unit(random) * std::exp2(static_cast<int>(random() % 40u) - 20));
  }
  constexpr double infinite = std::numeric_limits<double>::infinity();
  for (double const a : {0.0, -0.0, 1.0, -1.0, 1e-320, 1e305, infinite, -infinite,
                         std::numeric_limits<double>::quiet_NaN()}) {
    for (double const b : {0.0, -0.0, 1.0, -3.0, 1e305, infinite, -infinite}) {
      y.push_back(a);
      x.push_back(b);
    }
  }
  auto const d_y = test::to_exec(this->backend.exec, y);
  auto const d_x = test::to_exec(this->backend.exec, x);
  auto const d_out =
      test::to_exec(this->backend.exec, std::vector<double>(own_functions::count * y.size(), -7.0));
  ft::for_each_item<ft::per_thread>(this->backend.exec, static_cast<int>(y.size()), own_functions{},
                                    d_y.data(), d_x.data(), d_out.data());
  auto const out =
      test::from_exec(this->backend.exec, d_out.data(), own_functions::count * y.size());
  auto const is_near = [](double got, long double exact) {
    double const want = static_cast<double>(exact);
    if (std::isnan(want)) { return std::isnan(got); }
    double const unit_in_last_place = std::nextafter(std::abs(want), infinite) - std::abs(want);
    return got == want || std::abs(got - exact) <= 4 * static_cast<long double>(unit_in_last_place);
  };
  for (std::size_t i = 0; i < y.size(); ++i) {
    double const tangent = out[own_functions::count * i];
    double const angle = out[own_functions::count * i + 1];
    double const sine = out[own_functions::count * i + 2];
    double const cosine = out[own_functions::count * i + 3];
    // The long tangent itself is too coarse for huge angles.
    if (std::abs(y[i]) < 1e5) {
      EXPECT_TRUE(is_near(tangent, std::tan(static_cast<long double>(y[i])))) << y[i];
      double const here = ft::scalar::tan(ft::strict_double(y[i])).value;
      EXPECT_TRUE(here == tangent) << y[i];
      auto const exact = static_cast<long double>(y[i]);
      EXPECT_LE(std::abs(sine - std::sin(exact)), 4e-16L) << y[i];
      EXPECT_LE(std::abs(cosine - std::cos(exact)), 4e-16L) << y[i];
      EXPECT_TRUE(is_near(sine, std::sin(exact)) || std::abs(sine) < 1e-3) << y[i];
      EXPECT_TRUE(is_near(cosine, std::cos(exact)) || std::abs(cosine) < 1e-3) << y[i];
      EXPECT_TRUE(sine == ft::scalar::sin(ft::strict_double(y[i])).value) << y[i];
      EXPECT_TRUE(cosine == ft::scalar::cos(ft::strict_double(y[i])).value) << y[i];
    }
    EXPECT_TRUE(
        is_near(angle, std::atan2(static_cast<long double>(y[i]), static_cast<long double>(x[i]))))
        << y[i] << " " << x[i];
    EXPECT_EQ(std::signbit(angle), std::signbit(std::atan2(y[i], x[i]))) << y[i] << " " << x[i];
    double const here = ft::scalar::atan2(ft::strict_double(y[i]), ft::strict_double(x[i])).value;
    EXPECT_TRUE(here == angle || std::isnan(angle)) << y[i] << " " << x[i];
  }
}

TEST(scalar_unit, functions_of_doubles_are_those_of_the_standard_library) {
  for (double const v : {0.0, -0.3, 0.7, 1.5, 6.2}) {
    EXPECT_EQ(ft::scalar::sin(v), std::sin(v));
    EXPECT_EQ(ft::scalar::cos(v), std::cos(v));
    EXPECT_EQ(ft::scalar::exp(ft::strict_double(v)).value, std::exp(v));
    EXPECT_EQ(ft::scalar::log(ft::strict_double(v + 1)).value, std::log(v + 1));
  }
}

TYPED_TEST(math_unit, the_quick_arc_tangent_is_near_and_the_same_everywhere) {
  std::vector<float> y;
  std::vector<float> x;
  std::mt19937 random(8);
  std::uniform_real_distribution<double> angle(1e-6, 3.14159265);
  std::uniform_real_distribution<double> exponent(-20, 20);
  for (int i = 0; i < 20000; ++i) {
    double const a = angle(random);
    double const size = std::exp(exponent(random));
    y.push_back(static_cast<float>(size * std::sin(a)));
    x.push_back(static_cast<float>(size * std::cos(a)));
  }
  for (float const v : {0.0f, -0.0f, 1.0f, -1.0f, 1e-30f, 1e30f}) {
    y.push_back(1.0f);
    x.push_back(v);
  }
  auto const d_y = test::to_exec(this->backend.exec, y);
  auto const d_x = test::to_exec(this->backend.exec, x);
  auto const d_out = test::to_exec(this->backend.exec, std::vector<float>(y.size(), -7.0f));
  ft::for_each_item<ft::per_thread>(this->backend.exec, static_cast<int>(y.size()), arc_tangents{},
                                    d_y.data(), d_x.data(), d_out.data());
  auto const out = test::from_exec(this->backend.exec, d_out.data(), y.size());
  for (std::size_t i = 0; i < y.size(); ++i) {
    double const want = std::atan2(static_cast<double>(y[i]), static_cast<double>(x[i]));
    EXPECT_LT(std::abs(static_cast<double>(out[i]) - want), 4e-7) << y[i] << ", " << x[i];
    EXPECT_EQ(out[i],
              ft::scalar::quick_atan2(ft::strict_float(y[i]), ft::strict_float(x[i])).value);
  }
}

TYPED_TEST(math_unit, popcount_and_hamming_count_bits) {
  std::mt19937 random(9);
  std::vector<ft::descriptor> d(300);
  for (auto& one : d) {
    for (auto& word : one.words) { word = static_cast<std::uint32_t>(random()); }
  }
  for (auto& word : d[8].words) { word = 0; }
  for (int k = 0; k < 8; ++k) {
    d[4].words[k] = 0xffffffffu;
  }  // item 8 compares 8 and 4: all bits differ
  auto const d_d = test::to_exec(this->backend.exec, d);
  auto const d_bits = test::to_exec(this->backend.exec, std::vector<int>(d.size(), -1));
  auto const d_distances = test::to_exec(this->backend.exec, std::vector<int>(d.size(), -1));
  ft::for_each_item<ft::per_thread>(this->backend.exec, static_cast<int>(d.size()), count_bits{},
                                    d_d.data(), d_bits.data(), d_distances.data());
  auto const bits = test::from_exec(this->backend.exec, d_bits);
  auto const distances = test::from_exec(this->backend.exec, d_distances);
  for (std::size_t i = 0; i < d.size(); ++i) {
    std::size_t different = 0;
    for (int k = 0; k < 8; ++k) {
      different += std::bitset<32>(d[i].words[k] ^ d[i / 2].words[k]).count();
    }
    EXPECT_EQ(bits[i], static_cast<int>(std::bitset<32>(d[i].words[i % 8]).count()));
    EXPECT_EQ(distances[i], static_cast<int>(different));
  }
  EXPECT_EQ(distances[0], 0);
  EXPECT_EQ(distances[8], 256);
}

TYPED_TEST(math_unit, exp_of_a_twist_is_rodrigues_formula) {
  std::vector<double> twists;
  std::vector<double> angles;
  std::mt19937 random(15);
  std::normal_distribution<double> normal;
  for (double const angle :
       {0.0, 1e-300, 1e-160, 1e-12, 1e-8, 1e-5, 1e-3, 0.1, 0.4999, 0.5, 0.5001, 1.0,
        1.5707963267948966, 3.0, 3.141592653589793, 3.2, 6.283185307179586, 10.0, 100.0}) {
    for (int k = 0; k < 20; ++k) {
      double axis[3] = {normal(random), normal(random), normal(random)};
      if (k < 3) {
        for (int j = 0; j < 3; ++j) { axis[j] = j == k ? 1.0 : 0.0; }
      }
      double const length = std::sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]);
      for (double const v : axis) { twists.push_back(angle * v / length); }
      for (int j = 0; j < 3; ++j) { twists.push_back(normal(random)); }
      angles.push_back(angle);
    }
  }
  auto const d_twists = test::to_exec(this->backend.exec, twists);
  ft::buffer<ft::rigid<double>, TypeParam::exec_type::space> d_out(angles.size());
  ft::for_each_item<ft::per_thread>(this->backend.exec, static_cast<int>(angles.size()),
                                    exponential{}, d_twists.data(), d_out.data());
  auto const out = test::from_exec(this->backend.exec, d_out);
  for (std::size_t i = 0; i < angles.size(); ++i) {
    // Squaring doubles the error with every halving of the angle.
    double const tolerance = 1e-14 * std::max(1.0, 4 * angles[i]);
    EXPECT_LT(largest_difference(out[i], exponential_by_rodrigues(&twists[6 * i])), tolerance)
        << "angle " << angles[i];
  }
}

TYPED_TEST(math_unit, exp_of_many_turns_in_float_is_a_rotation_still) {
  std::vector<float> twists;
  std::mt19937 random(16);
  std::normal_distribution<float> normal;
  for (float const angle : {5.0f, 9.0f, 284.0f, 1e4f, 1e6f}) {
    for (int k = 0; k < 20; ++k) {
      float const axis[3] = {normal(random), normal(random), normal(random)};
      float const length = std::sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]);
      for (float const v : axis) { twists.push_back(angle * v / length); }
      for (int j = 0; j < 3; ++j) { twists.push_back(normal(random)); }
    }
  }
  std::size_t const n = twists.size() / 6;
  auto const d_twists = test::to_exec(this->backend.exec, twists);
  ft::buffer<ft::rigid<float>, TypeParam::exec_type::space> d_out(n);
  ft::for_each_item<ft::per_thread>(this->backend.exec, static_cast<int>(n), exponential_in_float{},
                                    d_twists.data(), d_out.data());
  auto const out = test::from_exec(this->backend.exec, d_out);
  for (std::size_t i = 0; i < n; ++i) {
    auto const R = out[i].template cast<double>().R;
    auto const product = R * R.transposed();
    for (int k = 0; k < 9; ++k) {
      EXPECT_NEAR(product.m[k], k % 4 == 0 ? 1.0 : 0.0, 1e-5) << "twist " << i;
    }
  }
}

TYPED_TEST(math_unit, solve_6_agrees_with_gaussian_elimination) {
  std::mt19937 random(21);
  std::normal_distribution<double> normal;
  for (double const damping : {0.0, 1e-3, 10.0}) {
    std::vector<system_6> systems(100);
    for (auto& s : systems) {
      double rows[12][6];
      for (auto& row : rows) {
        for (int k = 0; k < 6; ++k) { row[k] = normal(random) * (k < 3 ? 100.0 : 1.0); }
      }
      int at = 0;
      for (int i = 0; i < 6; ++i) {
        for (int j = i; j < 6; ++j) {
          s.upper[at] = 0;
          for (auto const& row : rows) { s.upper[at] += row[i] * row[j]; }
          ++at;
        }
        s.right[i] = normal(random) * 100.0;
      }
    }
    auto const d_systems = test::to_exec(this->backend.exec, systems);
    ft::buffer<solution_6, TypeParam::exec_type::space> d_out(systems.size());
    ft::for_each_item<ft::per_thread>(this->backend.exec, static_cast<int>(systems.size()), solve{},
                                      d_systems.data(), damping, d_out.data());
    auto const out = test::from_exec(this->backend.exec, d_out);
    for (std::size_t i = 0; i < systems.size(); ++i) {
      EXPECT_EQ(out[i].solved, 1);
      auto const want = solve_by_elimination(systems[i], damping);
      wide size = 0;
      for (wide const v : want) { size = std::max(size, std::abs(v)); }
      for (std::size_t k = 0; k < 6; ++k) {
        EXPECT_LT(std::abs(static_cast<double>(out[i].x[k] - want[k])),
                  1e-9 * static_cast<double>(size));
      }
    }
  }
}

TYPED_TEST(math_unit, solve_6_refuses_what_is_not_positive_definite) {
  system_6 identity{};
  for (int const at : {0, 6, 11, 15, 18, 20}) { identity.upper[at] = 1; }
  std::vector<system_6> systems{identity};  // the only one that can be solved
  systems.push_back(system_6{});            // all zeros
  for (int const at : {0, 6, 11, 15, 18, 20}) {
    for (double const v : {0.0, -1.0, std::numeric_limits<double>::quiet_NaN()}) {
      systems.push_back(identity);
      systems.back().upper[at] = v;
    }
  }
  systems.push_back(identity);
  systems.back().upper[1] = 1.5;  // indefinite although its diagonal is positive
  auto const d_systems = test::to_exec(this->backend.exec, systems);
  ft::buffer<solution_6, TypeParam::exec_type::space> d_out(systems.size());
  ft::for_each_item<ft::per_thread>(this->backend.exec, static_cast<int>(systems.size()), solve{},
                                    d_systems.data(), 0.0, d_out.data());
  auto const out = test::from_exec(this->backend.exec, d_out);
  for (std::size_t i = 0; i < systems.size(); ++i) {
    EXPECT_EQ(out[i].solved, i == 0 ? 1 : 0) << i;
  }
}

// ---- host only
// -----------------------------------------------------------------------------------

inline ft::rigid<double> random_motion(std::mt19937& random) {
  std::normal_distribution<double> normal;
  double twist[6];
  for (double& v : twist) { v = normal(random); }
  return exponential_by_rodrigues(twist);
}

TEST(rigid_unit, inverse_centre_and_composition) {
  std::mt19937 random(25);
  for (int i = 0; i < 100; ++i) {
    auto const T_ab = random_motion(random);
    auto const T_bc = random_motion(random);
    auto const identity = ft::rigid<double>::identity();
    EXPECT_LT(largest_difference(T_ab * T_ab.inverse(), identity), 1e-14);
    EXPECT_LT(largest_difference(T_ab.inverse() * T_ab, identity), 1e-14);
    EXPECT_LT(largest_difference((T_ab * T_bc).inverse(), T_bc.inverse() * T_ab.inverse()), 1e-13);
    ft::vec3<double> const p{0.3 * i, -1.0, 2.0};
    auto const by_steps = T_ab * (T_bc * p);
    auto const at_once = (T_ab * T_bc) * p;
    EXPECT_NEAR(by_steps.x, at_once.x, 1e-12);
    EXPECT_NEAR(by_steps.y, at_once.y, 1e-12);
    EXPECT_NEAR(by_steps.z, at_once.z, 1e-12);
    auto const origin = T_ab * T_ab.centre();  // the camera's centre is its own origin
    EXPECT_NEAR(origin.x, 0, 1e-13);
    EXPECT_NEAR(origin.y, 0, 1e-13);
    EXPECT_NEAR(origin.z, 0, 1e-13);
    EXPECT_LT(largest_difference(T_ab.cast<ft::strict_double>().cast<double>(), T_ab), 1e-300);
    EXPECT_LT(largest_difference(T_ab.cast<float>().cast<double>(), T_ab), 1e-6);
  }
}

TEST(rigid_unit, acts_as_matrix_then_offset) {
  ft::rigid<double> const quarter_turn{{{0, -1, 0, 1, 0, 0, 0, 0, 1}}, {1, 2, 3}};
  auto const p = quarter_turn * ft::vec3<double>{10, 20, 30};
  EXPECT_EQ(p.x, -20 + 1);
  EXPECT_EQ(p.y, 10 + 2);
  EXPECT_EQ(p.z, 30 + 3);
}

TEST(rigid_unit, orthonormalized_is_a_rotation_near_the_given_matrix) {
  std::mt19937 random(12);
  std::uniform_real_distribution<double> noise(-0.01, 0.01);
  for (int k = 0; k < 200; ++k) {
    auto const T = random_motion(random);
    auto bent = T;
    for (double& v : bent.R.m) { v += k == 0 ? 0 : noise(random); }
    auto const got = bent.orthonormalized();
    EXPECT_LT(largest_difference(got, T), 0.05);
    EXPECT_EQ(got.t.x, T.t.x);
    auto const RRt = got.R * got.R.transposed();
    for (int i = 0; i < 9; ++i) { EXPECT_NEAR(RRt.m[i], i % 4 == 0 ? 1 : 0, 1e-14); }
    auto const& m = got.R.m;
    EXPECT_NEAR(m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) +
                    m[2] * (m[3] * m[7] - m[4] * m[6]),
                1, 1e-14);
    if (k == 0) { EXPECT_LT(largest_difference(got, T), 1e-14) << "a rotation stays what it is"; }
  }
}

TEST(rigid_unit, a_prediction_with_constant_velocity_stays_a_rotation) {
  std::mt19937 random(13);
  auto T = random_motion(random).cast<float>();
  T.R.m[0] += 1e-6f;
  ft::pose velocity = ft::pose::identity();
  for (int i = 0; i < 1000; ++i) {
    ft::pose const next = (velocity * T).orthonormalized();
    velocity = (next * T.inverse()).orthonormalized();
    T = next;
  }
  auto const RRt = T.R * T.R.transposed();
  for (int i = 0; i < 9; ++i) { EXPECT_NEAR(RRt.m[i], i % 4 == 0 ? 1 : 0, 1e-6); }
}

TEST(reflect_unit, walks_back_and_forth_without_repeating_the_edge) {
  for (int n = 1; n <= 9; ++n) {
    // The sequence 0 1 .. n-1 n-2 .. 1 0 1 .. around any start.
    int const period = n == 1 ? 1 : 2 * n - 2;
    for (int i = -40; i <= 40; ++i) {
      int const phase = ((i % period) + period) % period;
      EXPECT_EQ(ft::detail::reflect_101(i, n), phase < n ? phase : period - phase)
          << i << " of " << n;
    }
  }
}

TEST(scalar_unit, finite_means_neither_nan_nor_infinite) {
  float const infinity = std::numeric_limits<float>::infinity();
  EXPECT_TRUE(ft::scalar::is_finite(0.0f));
  EXPECT_TRUE(ft::scalar::is_finite(std::numeric_limits<float>::max()));
  EXPECT_TRUE(ft::scalar::is_finite(ft::strict_float(-1.0f)));
  EXPECT_FALSE(ft::scalar::is_finite(infinity));
  EXPECT_FALSE(ft::scalar::is_finite(-infinity));
  EXPECT_FALSE(ft::scalar::is_finite(std::numeric_limits<float>::quiet_NaN()));
  EXPECT_FALSE(ft::scalar::is_finite(ft::strict_double(std::numeric_limits<double>::quiet_NaN())));
}

TEST(scalar_unit, ceil_div_and_clamp) {
  for (int a = 0; a < 50; ++a) {
    for (int b = 1; b < 10; ++b) {
      EXPECT_EQ(ft::ceil_div(a, b), static_cast<int>(std::ceil(static_cast<double>(a) / b)));
    }
  }
  EXPECT_EQ(ft::clamp(5, 0, 3), 3);
  EXPECT_EQ(ft::clamp(-5, 0, 3), 0);
  EXPECT_EQ(ft::clamp(2, 0, 3), 2);
}

}  // namespace math_test
