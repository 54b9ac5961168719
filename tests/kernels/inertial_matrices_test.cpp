// SPDX-License-Identifier: Apache-2.0
// Small matrices of poses with an IMU: eigenvalues, inverses and Schur complements against plain
// elimination, and where rank is missing against matrices whose eigenvectors are known.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <random>
#include <vector>

#include "ft/core/execution.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/inertial/detail/information.hpp"
#include "tests/support/backends.hpp"

namespace inertial_matrices_test {

using wide = ft::strict_double;
using matrix = std::vector<double>;  ///< row-major, square

inline int side(matrix const& m) {
  return static_cast<int>(std::lround(std::sqrt(static_cast<double>(m.size()))));
}
inline double at(matrix const& m, int i, int j) {
  return m[static_cast<std::size_t>(i * side(m) + j)];
}

/// U diag(values) U^T, where U is a product of random reflections.
inline matrix with_eigenvalues(std::vector<double> const& values, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::size_t const n = values.size();
  matrix U(n * n, 0.0);
  for (std::size_t i = 0; i < n; ++i) { U[i * n + i] = 1; }
  for (std::size_t r = 0; r < n; ++r) {
    std::vector<double> v(n);
    double square = 0;
    for (double& x : v) {
      x = normal(random);
      square += x * x;
    }
    for (std::size_t i = 0; i < n; ++i) {
      double along = 0;
      for (std::size_t j = 0; j < n; ++j) { along += U[i * n + j] * v[j]; }
      for (std::size_t j = 0; j < n; ++j) { U[i * n + j] -= 2 * along * v[j] / square; }
    }
  }
  matrix m(n * n, 0.0);
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = 0; j < n; ++j) {
      for (std::size_t k = 0; k < n; ++k) {
        m[i * n + j] += U[std::max(i, j) * n + k] * values[k] * U[std::min(i, j) * n + k];
      }
    }
  }
  return m;
}

/// Eliminates the first `count` rows and columns by plain elimination.
inline matrix plain_schur(matrix m, int count) {
  int const n = side(m);
  auto const entry = [&](int i, int j) -> double& {
    return m[static_cast<std::size_t>(i * n + j)];
  };
  for (int k = 0; k < count; ++k) {
    for (int i = k + 1; i < n; ++i) {
      double const factor = entry(i, k) / entry(k, k);
      for (int j = k; j < n; ++j) { entry(i, j) -= factor * entry(k, j); }
    }
  }
  matrix rest;
  for (int i = count; i < n; ++i) {
    for (int j = count; j < n; ++j) { rest.push_back(entry(i, j)); }
  }
  return rest;
}
inline void expect_near(matrix const& got, matrix const& want, double relative) {
  ASSERT_EQ(got.size(), want.size());
  double largest = 0;
  for (double const v : want) { largest = std::max(largest, std::abs(v)); }
  for (std::size_t k = 0; k < got.size(); ++k) {
    EXPECT_NEAR(got[k], want[k], relative * largest) << k;
  }
}

/// One item: one state eliminated from 30 x 30 matrices, then clipped.
struct eliminate_and_clip {
  using scratch = ft::detail::information_scratch;
  bool eliminates;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int, double const* from, double* out) const {
    for (int k = g.rank(); k < 900; k += g.size()) { s.system.a[k / 30][k % 30] = from[k]; }
    g.sync();
    if (eliminates) { ft::detail::eliminate_first_state(g, s); }
    ft::detail::write_information(g, s, 15, out);
  }
};
/// One item: a covariance.
struct invert {
  using scratch = ft::detail::information_scratch;
  bool as_they_are;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int, ft::preintegrated const* from,
                                 wide* out) const {
    ft::detail::information_of(g, s, *from, as_they_are, out);
  }
};

template <typename Backend>
class inertial_matrices : public test::on_backend<Backend> {
protected:
  Backend backend;

  matrix marginal(matrix const& H, bool eliminates = true) {
    auto const from = test::to_exec(backend.exec, H);
    auto const out = test::to_exec(backend.exec, matrix(225));
    ft::for_each_item<ft::per_block<ft::sum_lanes>>(backend.exec, 1, eliminate_and_clip{eliminates},
                                                    static_cast<double const*>(from.data()),
                                                    out.data());
    return test::from_exec(backend.exec, static_cast<double const*>(out.data()), 225);
  }
  /// @param C 9 x 9
  matrix information(matrix const& C, int steps, bool as_they_are) {
    ft::preintegrated integral{};
    for (std::size_t k = 0; k < 81; ++k) { integral.C[k] = static_cast<float>(C[k]); }
    integral.steps = steps;
    auto const from = test::to_exec(backend.exec, std::vector<ft::preintegrated>{integral});
    auto const out = test::to_exec(backend.exec, std::vector<wide>(81));
    ft::for_each_item<ft::per_block<ft::sum_lanes>>(
        backend.exec, 1, invert{as_they_are}, static_cast<ft::preintegrated const*>(from.data()),
        out.data());
    auto const got = test::from_exec(backend.exec, static_cast<wide const*>(out.data()), 81);
    matrix m;
    for (wide const v : got) { m.push_back(v.value); }
    return m;
  }
};
TYPED_TEST_SUITE(inertial_matrices, test::backends);

inline std::vector<double> spread(int n, double from, double to) {
  std::vector<double> values;
  for (int k = 0; k < n; ++k) { values.push_back(from * std::pow(to / from, k / (n - 1.0))); }
  return values;
}

TYPED_TEST(inertial_matrices, the_rest_of_a_definite_matrix_is_its_schur_complement) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    auto const H = with_eigenvalues(spread(30, 1, 1e6), seed);
    expect_near(this->marginal(H), plain_schur(H, 15), 1e-12);
  }
}

TYPED_TEST(inertial_matrices, directions_without_information_are_not_inverted) {
  // The first state's own matrix has rank 12; the coupling lies in its range.
  auto values = spread(15, 10, 1e4);
  for (std::size_t k = 0; k < 3; ++k) { values[k] = 0; }
  auto inverted = values;
  for (double& v : inverted) { v = v == 0 ? 0 : 1 / v; }
  auto const A = with_eigenvalues(values, 7);
  auto const pseudo = with_eigenvalues(inverted, 7);
  auto const D = with_eigenvalues(spread(15, 1e4, 1e5), 8);
  std::mt19937 random(9);
  std::normal_distribution<double> normal;
  matrix B(225, 0.0);  // A times anything
  for (int j = 0; j < 15; ++j) {
    double x[15];
    for (double& v : x) { v = 0.3 * normal(random); }
    for (int i = 0; i < 15; ++i) {
      for (int k = 0; k < 15; ++k) {
        B[static_cast<std::size_t>(15 * i + j)] += at(A, i, k) * x[k];
      }
    }
  }
  matrix H(900);
  matrix want(225);
  for (int i = 0; i < 15; ++i) {
    for (int j = 0; j < 15; ++j) {
      auto const put = [&](int r, int c, double v) { H[static_cast<std::size_t>(30 * r + c)] = v; };
      put(i, j, at(A, i, j));
      put(i, 15 + j, at(B, i, j));
      put(15 + i, j, at(B, j, i));
      put(15 + i, 15 + j, at(D, i, j));
      double sum = at(D, i, j);
      for (int k = 0; k < 15; ++k) {
        for (int m = 0; m < 15; ++m) { sum -= at(B, k, i) * at(pseudo, k, m) * at(B, m, j); }
      }
      want[static_cast<std::size_t>(15 * i + j)] = sum;
    }
  }
  expect_near(this->marginal(H), want, 1e-9);
}

TYPED_TEST(inertial_matrices, negative_information_is_set_to_zero) {
  auto values = spread(15, 1, 1e3);
  values[0] = -0.5;
  values[4] = -3;
  auto const S = with_eigenvalues(values, 11);
  for (double& v : values) { v = std::max(v, 0.0); }
  matrix H(900, 0.0);
  for (int i = 0; i < 15; ++i) {
    for (int j = 0; j < 15; ++j) {
      H[static_cast<std::size_t>(30 * (15 + i) + 15 + j)] = at(S, i, j);
    }
  }
  expect_near(this->marginal(H, false), with_eigenvalues(values, 11), 1e-12);
}

TYPED_TEST(inertial_matrices, information_is_the_inverse_of_a_covariance) {
  auto const values = spread(9, 1e-6, 1e-3);
  auto inverted = values;
  for (double& v : inverted) { v = 1 / v; }
  // The covariance is rounded to float.
  expect_near(this->information(with_eigenvalues(values, 13), 10, false),
              with_eigenvalues(inverted, 13), 1e-3);
}

TYPED_TEST(inertial_matrices, one_step_has_information_in_six_directions) {
  auto values = spread(9, 1e-6, 1e-3);
  auto inverted = values;
  for (double& v : inverted) { v = 1 / v; }
  for (std::size_t k = 0; k < 3; ++k) {
    values[k] = k == 1 ? -1e-9 : 1e-9;  // what rounding leaves
    inverted[k] = 0;
  }
  auto const C = with_eigenvalues(values, 17);
  expect_near(this->information(C, 1, false), with_eigenvalues(inverted, 17), 1e-4);
  // As it is, two of the three are large information.
  auto const got = this->information(C, 1, true);
  double trace = 0;
  for (int i = 0; i < 9; ++i) { trace += at(got, i, i); }
  EXPECT_GT(trace, 1e8);
}

}  // namespace inertial_matrices_test
