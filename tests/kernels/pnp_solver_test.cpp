// SPDX-License-Identifier: Apache-2.0
// Parts of a pose from points: eigenvectors, 3 x 3 and 6 x 6 matrices, derivatives against finite
// differences.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <random>
#include <vector>

#include "ft/core/counter_draws.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/pnp/detail/linear_pose.hpp"
#include "ft/kernels/pnp/detail/refine_pose.hpp"
#include "ft/math/group_eigen.hpp"
#include "ft/math/small_matrices.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/pnp_scene.hpp"

namespace pnp_solver_test {

using ft::detail::real64;
using ft::detail::strict_mat3d;
using ft::detail::strict_vec3d;
using test::at;

constexpr int most = 12;

/// Item: a matrix.
struct diagonalize_each {
  using scratch = ft::detail::paired_eigen<most>;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, int const* sizes, double const* in,
                                 double* values, double* vectors) const {
    int const n = sizes[item];
    double const* const a = in + item * most * most;
    for (int k = g.rank(); k < n * n; k += g.size()) { s.a[k] = a[k]; }
    g.sync();
    s.diagonalize(g, n);
    for (int k = g.rank(); k < n * n; k += g.size()) {
      vectors[item * most * most + k] = s.v[k].value;
      if (k < n) { values[item * most + k] = s.value(k, n).value; }
    }
  }
};

struct eigen_system {
  std::vector<double> values, vectors;
};
template <typename Exec>
eigen_system diagonalize(Exec const& exec, std::vector<int> const& sizes,
                         std::vector<double> const& matrices) {
  auto const n = test::to_exec(exec, sizes);
  auto const a = test::to_exec(exec, matrices);
  auto const values = test::to_exec(exec, std::vector<double>(sizes.size() * most, 0.0));
  auto const vectors = test::to_exec(exec, std::vector<double>(sizes.size() * most * most, 0.0));
  ft::for_each_item<ft::per_warp>(exec, static_cast<int>(sizes.size()), diagonalize_each{},
                                  n.data(), a.data(), values.data(), vectors.data());
  return {test::from_exec(exec, values.data(), values.size()),
          test::from_exec(exec, vectors.data(), vectors.size())};
}

template <typename Backend>
class PairedEigen : public test::on_backend<Backend> {
protected:
  Backend backend;
};
TYPED_TEST_SUITE(PairedEigen, test::backends);

TYPED_TEST(PairedEigen, decomposes_matrices_of_any_size) {
  std::mt19937 random(1);
  std::normal_distribution<double> normal(0, 1);
  std::vector<int> sizes;
  std::vector<double> matrices;
  for (int round = 0; round < 60; ++round) {
    int const n = 2 + round % (most - 1);
    // Rows of very different sizes; every third matrix lacks a rank or more.
    int const rank = round % 3 == 0 ? std::max(1, n - 1 - round % 2) : n;
    std::vector<double> factor(at(n * n), 0.0);
    for (int r = 0; r < rank; ++r) {
      for (int c = 0; c < n; ++c) { factor[at(r * n + c)] = normal(random) * std::pow(3.0, c % 4); }
    }
    std::vector<double> a(at(most * most), 0.0);
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) {
        for (int r = 0; r < n; ++r) {
          double const sign = round % 4 == 1 && r == 0 ? -1 : 1;  // some are indefinite
          a[at(i * n + j)] += sign * factor[at(r * n + i)] * factor[at(r * n + j)];
        }
      }
    }
    sizes.push_back(n);
    matrices.insert(matrices.end(), a.begin(), a.end());
  }
  auto const got = diagonalize(this->backend.exec, sizes, matrices);
  for (int m = 0; m < static_cast<int>(sizes.size()); ++m) {
    int const n = sizes[at(m)];
    auto const a = [&](int i, int j) { return matrices[at(m * most * most + i * n + j)]; };
    auto const v = [&](int i, int k) { return got.vectors[at(m * most * most + i * n + k)]; };
    double size = 0;
    for (int i = 0; i < n; ++i) { size = std::max(size, std::abs(a(i, i))); }
    for (int i = 0; i < n; ++i) {
      for (int k = 0; k < n; ++k) {
        double image = 0;
        double product = 0;
        for (int j = 0; j < n; ++j) {
          image += a(i, j) * v(j, k);
          product += v(j, i) * v(j, k);
        }
        EXPECT_NEAR(image, got.values[at(m * most + k)] * v(i, k), 1e-13 * size) << m;
        EXPECT_NEAR(product, i == k ? 1.0 : 0.0, 1e-14 * n) << m;
      }
    }
  }
  // One thread has the same bits.
  auto const host = diagonalize(ft::host_exec(1), sizes, matrices);
  EXPECT_EQ(std::memcmp(host.vectors.data(), got.vectors.data(), got.vectors.size() * 8), 0);
  EXPECT_EQ(std::memcmp(host.values.data(), got.values.data(), got.values.size() * 8), 0);
}

TYPED_TEST(PairedEigen, leaves_diagonal_matrices_and_ends_without_numbers) {
  std::vector<double> matrices(3 * most * most, 0.0);
  for (int k = 0; k < most; ++k) { matrices[at(k * (most + 1))] = 5 - k; }
  for (int k = 0; k < 81; ++k) {
    matrices[at(2 * most * most + k)] = std::numeric_limits<double>::quiet_NaN();
  }
  auto const got = diagonalize(this->backend.exec, {most, 5, 9}, matrices);
  for (int k = 0; k < most; ++k) {
    EXPECT_EQ(got.values[at(k)], 5 - k);
    EXPECT_EQ(got.vectors[at(k * (most + 1))], 1.0);
  }
  for (int k = 0; k < 5; ++k) { EXPECT_EQ(got.values[at(most + k)], 0.0); }
  EXPECT_TRUE(std::isnan(got.values[at(2 * most)]));
}

strict_mat3d random_matrix(std::mt19937& random) {
  std::normal_distribution<double> normal(0, 1);
  strict_mat3d M;
  for (real64& k : M.m) { k = normal(random); }
  return M;
}

TEST(SmallMatrices, orthogonal_factor_is_the_nearest_rotation) {
  std::mt19937 random(2);
  for (int round = 0; round < 300; ++round) {
    strict_mat3d M = random_matrix(random);
    if (round % 3 == 1) {  // rank 2
      for (int c = 0; c < 3; ++c) { M.m[6 + c] = M.m[c] - M.m[3 + c]; }
    }
    if (round % 50 == 2) { M = {{2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0}}; }
    strict_mat3d const R = ft::detail::orthogonal_factor(M);
    strict_mat3d const one = R.transposed() * R;
    for (int k = 0; k < 9; ++k) { EXPECT_NEAR(one.m[k].value, k % 4 == 0 ? 1 : 0, 1e-13); }
    EXPECT_NEAR(ft::detail::determinant(R).value, 1, 1e-13);
    // Of M or -M: what is left of the rotation is symmetric. Of rank 2 that may be either sign of
    // the direction that M lacks.
    strict_mat3d const S = R.transposed() * M;
    if (round % 3 != 1) {
      EXPECT_NEAR(S.m[1].value, S.m[3].value, 1e-13);
      EXPECT_NEAR(S.m[2].value, S.m[6].value, 1e-13);
      EXPECT_NEAR(S.m[5].value, S.m[7].value, 1e-13);
      double const sign = ft::detail::determinant(M).value < 0 ? -1 : 1;
      if (std::abs(ft::detail::determinant(M).value) > 1e-6) {  // S definite
        EXPECT_GT(sign * S.m[0].value, 0);
        EXPECT_GT((S.m[0] * S.m[4] - S.m[1] * S.m[1]).value, 0);
      }
    }
  }
  strict_mat3d const none = ft::detail::orthogonal_factor({});
  EXPECT_FALSE(none.m[0].value == none.m[0].value);
}

TEST(SmallMatrices, rank_counts_pivots) {
  std::mt19937 random(3);
  EXPECT_EQ(ft::detail::rank_of(strict_mat3d::identity()), 3);
  EXPECT_EQ(ft::detail::rank_of(strict_mat3d{}), 0);
  std::normal_distribution<double> normal(0, 1);
  for (int zero = 0; zero < 3; ++zero) {
    for (int round = 0; round < 50; ++round) {
      strict_mat3d plane{};
      strict_mat3d line{};
      for (int p = 0; p < 6; ++p) {
        double x[3] = {normal(random), normal(random), normal(random)};
        x[zero] = 0;
        for (int e = 0; e < 9; ++e) {
          plane.m[e] += real64(x[e / 3]) * real64(x[e % 3]);
          if (p == 0) { line.m[e] = plane.m[e]; }
        }
      }
      EXPECT_EQ(ft::detail::rank_of(plane), 2);
      EXPECT_EQ(ft::detail::rank_of(line), 1);
      plane.m[4 * zero] = 1e-9;
      EXPECT_EQ(ft::detail::rank_of(plane), 3);
      plane.m[4 * zero] = 1e-18;
      EXPECT_EQ(ft::detail::rank_of(plane), 2);
    }
  }
}

TEST(SmallMatrices, cube_root_is_that_of_the_library) {
  std::mt19937 random(4);
  std::uniform_real_distribution<double> exponent(-290, 290);
  for (int round = 0; round < 20000; ++round) {
    double const v = std::pow(10.0, exponent(random));
    EXPECT_NEAR(ft::detail::cube_root(v).value / std::cbrt(v), 1, 1.2e-15);
  }
  EXPECT_EQ(ft::detail::cube_root(0.0).value, 0.0);
  EXPECT_EQ(ft::detail::cube_root(1.0).value, 1.0);
}

TEST(SmallMatrices, solves_normal_equations) {
  std::mt19937 random(5);
  std::normal_distribution<double> normal(0, 1);
  for (int round = 0; round < 100; ++round) {
    double J[9][6];
    for (auto& row : J) {
      for (double& k : row) { k = normal(random); }
    }
    double want[6];
    for (double& k : want) { k = normal(random); }
    real64 m[42];
    std::fill(m, m + 42, real64(std::nan("")));  // the lower triangle is not read
    for (int i = 0; i < 6; ++i) {
      double right = 0;
      for (int k = 0; k < 6; ++k) {
        double sum = 0;
        for (auto const& row : J) { sum += row[i] * row[k]; }
        if (k >= i) { m[7 * i + k] = sum; }
        right += sum * want[k];
      }
      m[7 * i + 6] = right;
    }
    real64 got[6];
    ft::detail::solve_symmetric_6(m, got);
    for (int k = 0; k < 6; ++k) { EXPECT_NEAR(got[k].value, want[k], 1e-9); }
  }
}

// ---- the pose -----------------------------------------------------------------------------------

TEST(PoseFromPoints, vectors_of_rotations) {
  std::mt19937 random(6);
  std::uniform_real_distribution<double> real(-1, 1);
  for (double const angle : {1e-4, 0.1, 1.0, 2.0, 3.0, 3.1}) {
    ft::vec3<double> axis{real(random), real(random), real(random)};
    auto const R = test::rotation_about(axis, angle);
    axis = scaled(axis, angle / std::sqrt(dot(axis, axis)));
    auto const w = ft::detail::rotation_vector(R.cast<real64>()).cast<double>();
    // Near half a turn the vector is the difference of R and its transpose, which vanishes.
    double const tolerance = 1e-13 + (angle > 2 ? 3e-16 / std::pow(std::sin(angle), 3) : 0.0);
    EXPECT_NEAR(w.x, axis.x, tolerance);
    EXPECT_NEAR(w.y, axis.y, tolerance);
    EXPECT_NEAR(w.z, axis.z, tolerance);
    auto const T = ft::detail::turned_by({axis.cast<real64>(), {1.0, 2.0, 3.0}}).T;
    for (int k = 0; k < 9; ++k) { EXPECT_NEAR(T.R.m[k].value, R.m[k], 1e-14); }
  }
  // As in the reference.
  EXPECT_TRUE(std::isnan(ft::detail::rotation_vector(strict_mat3d::identity()).x.value));
  EXPECT_TRUE(std::isnan(
      ft::detail::rotation_vector(scaled(strict_mat3d::identity(), real64(1.0 + 1e-12))).x.value));
}

TEST(PoseFromPoints, derivatives_are_those_of_finite_differences) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> real(-1, 1);
  for (double const turn : {1e-3, 0.05, 0.3, 1.0, 1.7}) {
    for (int round = 0; round < 40; ++round) {
      double x[6];
      for (int k = 0; k < 6; ++k) { x[k] = (k < 3 ? turn : 2.0) * real(random); }
      strict_vec3d const point{3 * real(random), 3 * real(random), 5 + 2 * real(random)};
      strict_vec3d const ray{real(random), real(random), 1.0};
      auto const rows = [&](double const(&at_x)[6], real64(&row)[14]) {
        ft::detail::pose_vector const v{{at_x[0], at_x[1], at_x[2]}, {at_x[3], at_x[4], at_x[5]}};
        ft::detail::direction_rows(ft::detail::turned_by(v), ray, point, row);
      };
      real64 row[14];
      rows(x, row);
      for (int k = 0; k < 6; ++k) {
        constexpr double h = 1e-5;
        double up[6];
        double down[6];
        std::copy(x, x + 6, up);
        std::copy(x, x + 6, down);
        up[k] += h;
        down[k] -= h;
        real64 above[14];
        real64 below[14];
        rows(up, above);
        rows(down, below);
        for (int r = 0; r < 14; r += 7) {
          double const slope = (above[r + 6] - below[r + 6]).value / (2 * h);
          EXPECT_NEAR(row[r + k].value, slope, 2e-9) << turn << " " << k;
        }
      }
    }
  }
}

TEST(PoseFromPoints, rows_are_what_the_direction_does_not_share_with_the_ray) {
  std::mt19937 random(8);
  std::uniform_real_distribution<double> real(-1, 1);
  for (int round = 0; round < 200; ++round) {
    strict_vec3d ray{real(random), real(random), real(random)};
    if (round < 3) {
      ray = {round == 0 ? 1.0 : 0.0, round == 1 ? 1.0 : 0.0, round == 2 ? 1.0 : 0.0};
    }
    strict_vec3d const point{real(random), real(random), real(random)};
    ft::detail::pose_vector const v{{0.1, 0.2, -0.3}, {1.0, -0.5, 3.0}};
    auto const pose = ft::detail::turned_by(v);
    real64 row[14];
    ft::detail::direction_rows(pose, ray, point, row);
    auto const u = ft::detail::unit(pose.T * point);
    auto const apart = cross(ft::detail::unit(ray), u);
    EXPECT_NEAR((row[6] * row[6] + row[13] * row[13]).value, dot(apart, apart).value, 1e-14);
  }
}

/// Six correspondences without error give the pose. From more of them, with noise, the squares of
/// the residuals are least: no pose nearby has a smaller sum.
TEST(PoseFromPoints, is_exact_and_least_squares) {
  std::mt19937 random(9);
  auto const camera = test::pnp_camera();
  auto const solve = [&](test::pnp_scene const& s, std::vector<int> const& index) {
    std::vector<ft::vec3<double>> rays;
    for (auto const& p : s.pixel) {
      rays.push_back(
          camera.unproject({static_cast<double>(p.x), static_cast<double>(p.y)}).direction);
    }
    ft::detail::mlpnp_scratch scratch;
    ft::detail::pnp_selection const from{rays.data(), s.point.data(), index.data(),
                                         static_cast<int>(index.size())};
    auto const found = ft::detail::mlpnp(ft::single_group{}, scratch, from);
    EXPECT_TRUE(found.valid);
    auto const cost = [&](ft::detail::pose_vector const& x) {
      double sum = 0;
      for (int i = 0; i < from.count; ++i) {
        real64 row[14];
        ft::detail::direction_rows(ft::detail::turned_by(x), from.ray_of(i), from.point_of(i), row);
        sum += (row[6] * row[6] + row[13] * row[13]).value;
      }
      return sum;
    };
    auto const w = ft::detail::rotation_vector(found.T_cw.R.cast<real64>());
    ft::detail::pose_vector const x{w, found.T_cw.t.cast<real64>()};
    double const least = cost(x);
    for (int k = 0; k < 12; ++k) {
      ft::detail::pose_vector other = x;
      real64* const part[6] = {&other.w.x, &other.w.y, &other.w.z,
                               &other.t.x, &other.t.y, &other.t.z};
      *part[k / 2] += real64(k % 2 == 0 ? 3e-5 : -3e-5);
      EXPECT_LT(least, cost(other));
    }
    return found.T_cw;
  };
  for (int round = 0; round < 20; ++round) {
    test::pnp_scene_params p;
    p.points = 40;
    auto const exact = make_pnp_scene(random, camera, p);
    auto const T = solve(exact, {0, 7, 12, 20, 33, 39});
    EXPECT_LT(test::angle_between_rotations(T.R, exact.T_cw.R), 3e-5);
    p.noise = 0.5;
    auto const noisy = make_pnp_scene(random, camera, p);
    std::vector<int> all;
    for (int i = 0; i < 40; ++i) { all.push_back(i); }
    auto const T2 = solve(noisy, all);
    EXPECT_LT(test::angle_between_rotations(T2.R, noisy.T_cw.R), 5e-3);
  }
}

}  // namespace pnp_solver_test
