// SPDX-License-Identifier: Apache-2.0
// Formulas that several stages share give the bits that each stage had when it wrote them itself.
// The references are those texts.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <random>
#include <vector>

#include "ft/core/execution.hpp"
#include "ft/math/group_eigen.hpp"
#include "ft/math/jacobi.hpp"
#include "ft/math/positive_definite.hpp"
#include "ft/math/quaternion.hpp"
#include "ft/math/se3.hpp"
#include "ft/math/so3.hpp"
#include "tests/support/backends.hpp"

namespace one_formula_test {

using real = ft::strict_double;
using single = ft::strict_float;
constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr double infinity = std::numeric_limits<double>::infinity();

/// Bits, of one NaN for all.
inline std::uint64_t bits(double v) {
  std::uint64_t b = 0;
  if (std::isnan(v)) { return ~b; }
  std::memcpy(&b, &v, sizeof b);
  return b;
}
inline std::uint64_t bits(real v) { return bits(v.value); }
inline std::uint64_t bits(single v) { return bits(static_cast<double>(v.value)); }

template <typename S, int N>
void expect_same(S const (&a)[N], S const (&b)[N]) {
  for (int k = 0; k < N; ++k) { ASSERT_EQ(bits(a[k]), bits(b[k])) << "number " << k; }
}

/// Sizes from denormal to infinite, most of them around 1.
inline double any(std::mt19937& random) {
  std::normal_distribution<double> normal;
  static double const special[] = {0.0, -0.0, 1.0, 1e-200, 1e200, 1e-310, infinity, nan};
  unsigned const kind = random() % 64;
  if (kind < 8) { return special[kind]; }
  double const v = normal(random);
  return kind < 24 ? v * std::pow(10.0, static_cast<double>(random() % 17) - 8) : v;
}

// ---- rotations
// ------------------------------------------------------------------------------------

/// The series that exponentials had, each with a number of terms of its own.
template <typename Real>
void series(int terms, Real d2, Real (&out)[3]) {
  using plain = ft::plain_scalar_t<Real>;
  Real a = Real(1);
  Real b = Real(1);
  Real c = Real(1);
  for (int k = terms; k > 0; --k) {
    double const n = 2.0 * k;
    a = Real(1) - d2 * Real(static_cast<plain>(1.0 / (n * (n + 1.0)))) * a;
    b = Real(1) - d2 * Real(static_cast<plain>(1.0 / ((n + 1.0) * (n + 2.0)))) * b;
    c = Real(1) - d2 * Real(static_cast<plain>(1.0 / ((n + 2.0) * (n + 3.0)))) * c;
  }
  out[0] = a;
  out[1] = b * Real(static_cast<plain>(0.5));
  out[2] = c * Real(static_cast<plain>(1.0 / 6.0));
}

TEST(OneFormula, rotation_terms_in_float) {
  std::mt19937 random(1);
  for (int round = 0; round < 20000; ++round) {
    single const d2 = static_cast<float>(std::abs(any(random)));
    single want[3];
    if (d2 < single(1.0f)) {
      series(5, d2, want);
    } else {
      single const d = ft::scalar::sqrt(d2);
      single const s = ft::scalar::sin(d);
      want[0] = s / d;
      want[1] = (single(1.0f) - ft::scalar::cos(d)) / d2;
      want[2] = (d - s) / (d * d2);
    }
    auto const t = ft::detail::terms_of_rotation(d2);
    single const got[3] = {t.a, t.b, t.c};
    expect_same(got, want);
  }
}

TEST(OneFormula, rotation_terms_in_double) {
  std::mt19937 random(2);
  for (int round = 0; round < 20000; ++round) {
    real const d2 = std::abs(any(random));
    real want[3];
    if (d2 < real(1.0 / 16)) {
      series(6, d2, want);
    } else {
      real const d = ft::scalar::sqrt(d2);
      auto const at = ft::detail::strict_sin_cos(d);
      want[0] = at.sine / d;
      want[1] = (real(1.0) - at.cosine) / d2;
      want[2] = (d - at.sine) / (d * d2);
    }
    auto const t = ft::detail::terms_of_rotation(d2);
    real const got[3] = {t.a, t.b, t.c};
    expect_same(got, want);
    // MLPnP has a rotation and its derivative from these, for the smallest angles as well.
    ft::vec3<real> const w{any(random), any(random), any(random)};
    real const w2 = dot(w, w);
    auto const terms = ft::detail::terms_of_rotation(w2);
    auto const E = ft::detail::one_plus(terms.a, terms.b, w, w2);
    auto const J = ft::detail::one_plus(-terms.b, terms.c, w, w2);
    auto const both = ft::detail::rotation_exp_and_jacobian(w);
    expect_same(both.E.m, E.m);
    expect_same(both.Jr.m, J.m);
    expect_same(ft::detail::rotation_exp(w).m, E.m);
  }
}

template <typename Real>
ft::rigid<Real> exponential(Real const (&d)[6]) {
  using plain = ft::plain_scalar_t<Real>;
  ft::vec3<Real> w{d[0], d[1], d[2]};
  ft::vec3<Real> u{d[3], d[4], d[5]};
  Real theta2 = dot(w, w);
  int halvings = 0;
  for (; theta2 > Real(plain(1) / 64) && halvings < 60; ++halvings) {
    w = scaled(w, Real(plain(1) / 2));
    u = scaled(u, Real(plain(1) / 2));
    theta2 = theta2 * Real(plain(1) / 4);
  }
  Real s[3];
  series(5, theta2, s);
  ft::rigid<Real> t;
  t.R = ft::detail::one_plus(s[0], s[1], w, theta2);
  t.t = ft::detail::one_plus(s[1], s[2], w, theta2) * u;
  bool const many = halvings > 6;
  for (; halvings > 0; --halvings) {
    t = t * t;
    if (many) { t = t.orthonormalized(); }
  }
  return t;
}

template <typename Real>
void compare_exponentials(unsigned seed) {
  using plain = ft::plain_scalar_t<Real>;
  std::mt19937 random(seed);
  for (int round = 0; round < 5000; ++round) {
    Real d[6];
    for (Real& v : d) { v = static_cast<plain>(any(random)); }
    auto const want = exponential(d);
    auto const got = ft::detail::exp_se3(d);
    expect_same(got.R.m, want.R.m);
    Real const a[3] = {got.t.x, got.t.y, got.t.z};
    Real const b[3] = {want.t.x, want.t.y, want.t.z};
    expect_same(a, b);
  }
}
TEST(OneFormula, exponential_of_a_twist) {
  compare_exponentials<real>(3);
  compare_exponentials<single>(4);
}

/// As files of maps had it, in double.
ft::quaternion<double> plain_quaternion(ft::mat3<double> const& R) {
  auto const& m = R.m;
  double const trace = m[0] + m[4] + m[8];
  ft::quaternion<double> q;
  if (trace >= m[0] && trace >= m[4] && trace >= m[8]) {
    q = {m[7] - m[5], m[2] - m[6], m[3] - m[1], 1 + trace};
  } else if (m[0] >= m[4] && m[0] >= m[8]) {
    q = {1 + m[0] - m[4] - m[8], m[1] + m[3], m[2] + m[6], m[7] - m[5]};
  } else if (m[4] >= m[8]) {
    q = {m[1] + m[3], 1 - m[0] + m[4] - m[8], m[5] + m[7], m[2] - m[6]};
  } else {
    q = {m[2] + m[6], m[5] + m[7], 1 - m[0] - m[4] + m[8], m[3] - m[1]};
  }
  double const length = std::sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w);
  double const scale = (q.w < 0 ? -1 : 1) / length;
  return {q.x * scale, q.y * scale, q.z * scale, q.w * scale};
}

TEST(OneFormula, quaternion_of_a_rotation) {
  std::mt19937 random(5);
  for (int round = 0; round < 20000; ++round) {
    ft::vec3<real> const w{any(random), any(random), any(random)};
    auto const R = ft::detail::rotation_exp(w).cast<double>();
    auto const want = plain_quaternion(R);
    auto const got = ft::detail::quaternion_of(R);
    double const a[4] = {got.x, got.y, got.z, got.w};
    double const b[4] = {want.x, want.y, want.z, want.w};
    expect_same(a, b);
  }
}

// ---- Jacobi rotations
// -----------------------------------------------------------------------------

template <int N>
void random_symmetric(std::mt19937& random, real (&a)[N * N]) {
  bool const scarce = random() % 4 == 0;
  for (int i = 0; i < N; ++i) {
    for (int j = i; j < N; ++j) {
      bool const none = scarce && random() % 2 == 0;
      a[i * N + j] = a[j * N + i] = none ? 0.0 : any(random);
    }
  }
}

/// A sweep as small_eigen and symmetric_eigen had it, row-major, n x n.
bool cyclic_sweep(real* a, real* v, int n) {
  bool turned = false;
  for (int p = 0; p + 1 < n; ++p) {
    for (int q = p + 1; q < n; ++q) {
      real const pq = a[p * n + q];
      real const pp = a[p * n + p];
      real const qq = a[q * n + q];
      real const size = ft::scalar::abs(pq);
      bool const negligible = ft::scalar::abs(pp) + size == ft::scalar::abs(pp) &&
                              ft::scalar::abs(qq) + size == ft::scalar::abs(qq);
      if (negligible || !ft::scalar::is_finite(pq)) { continue; }
      real const theta = (qq - pp) / (pq + pq);
      real const root = ft::scalar::sqrt(theta * theta + real(1.0));
      real const t = ft::scalar::is_finite(root)
                         ? real(theta < real(0.0) ? -1.0 : 1.0) / (ft::scalar::abs(theta) + root)
                         : real(0.5) / theta;
      real const c = ft::scalar::reciprocal(ft::scalar::sqrt(t * t + real(1.0)));
      real const s = t * c;
      a[p * n + p] = pp - t * pq;
      a[q * n + q] = qq + t * pq;
      a[p * n + q] = a[q * n + p] = 0.0;
      for (int k = 0; k < n; ++k) {
        real const vp = v[k * n + p];
        real const vq = v[k * n + q];
        v[k * n + p] = c * vp - s * vq;
        v[k * n + q] = s * vp + c * vq;
        if (k == p || k == q) { continue; }
        real const kp = a[k * n + p];
        real const kq = a[k * n + q];
        a[k * n + p] = a[p * n + k] = c * kp - s * kq;
        a[k * n + q] = a[q * n + k] = s * kp + c * kq;
      }
      turned = true;
    }
  }
  return turned;
}

template <int N>
void diagonalize_by_sweeps(real (&a)[N * N], real (&v)[N * N]) {
  for (int k = 0; k < N * N; ++k) { v[k] = k % (N + 1) == 0 ? 1.0 : 0.0; }
  for (int sweep = 0; sweep < 24 && cyclic_sweep(a, v, N); ++sweep) {}
}

template <int N>
void compare_small(unsigned seed) {
  std::mt19937 random(seed);
  for (int round = 0; round < 2000; ++round) {
    real a[N * N];
    real v[N * N];
    ft::detail::small_eigen<N> got;
    random_symmetric<N>(random, a);
    for (int k = 0; k < N * N; ++k) { got.a[k] = a[k]; }
    diagonalize_by_sweeps<N>(a, v);
    got.diagonalize();
    expect_same(got.a, a);
    expect_same(got.v, v);
  }
}
TEST(OneFormula, eigenvectors_by_one_thread) {
  compare_small<3>(6);
  compare_small<4>(7);
}

struct group_diagonalize {
  using scratch = ft::detail::symmetric_eigen;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int i, int n, double* matrix,
                                 double* vectors) const {
    double* const a = matrix + i * n * n;
    for (int k = g.rank(); k < n * n; k += g.size()) { s.a[k] = a[k]; }
    g.sync();
    s.diagonalize(g, n);
    for (int k = g.rank(); k < n * n; k += g.size()) {
      a[k] = s.a[k].value;
      vectors[i * n * n + k] = s.v[k].value;
    }
  }
};

template <typename Backend>
class one_formula : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(one_formula, test::backends);

TYPED_TEST(one_formula, eigenvectors_by_a_group) {
  constexpr int n = 15;
  constexpr int count = 100;
  std::mt19937 random(8);
  std::vector<double> in;
  std::vector<double> want;
  for (int i = 0; i < count; ++i) {
    real a[n * n];
    real v[n * n];
    random_symmetric<n>(random, a);
    for (real const x : a) { in.push_back(x.value); }
    diagonalize_by_sweeps<n>(a, v);
    for (int k = 0; k < n * n; ++k) {
      want.push_back(a[k].value);
      want.push_back(v[k].value);
    }
  }
  TypeParam backend;
  auto const a = test::to_exec(backend.exec, in);
  auto const v = test::to_exec(backend.exec, std::vector<double>(in.size()));
  ft::for_each_item<ft::per_block<64>>(backend.exec, count, group_diagonalize{}, n, a.data(),
                                       v.data());
  auto const back = [&](double const* from) {
    return test::from_exec(backend.exec, from, in.size());
  };
  auto const values = back(a.data());
  auto const vectors = back(v.data());
  for (std::size_t k = 0; k < in.size(); ++k) {
    ASSERT_EQ(bits(values[k]), bits(want[2 * k])) << k;
    ASSERT_EQ(bits(vectors[k]), bits(want[2 * k + 1])) << k;
  }
}

/// As the triangulation of stereo pairs had it.
bool turn_4(int P, int Q, real (&a)[4][4], real (&e)[4][4]) {
  real const off = a[P][Q];
  real const apart = a[Q][Q] - a[P][P];
  if (ft::scalar::abs(off) <= real(1.0 / (1ull << 60)) * ft::scalar::abs(apart)) { return false; }
  real const twice = off + off;
  real const root = ft::scalar::sqrt(apart * apart + twice * twice);
  real const t = apart >= 0.0 ? twice / (apart + root) : twice / (apart - root);
  real const c = real(1.0) / ft::scalar::sqrt(t * t + 1.0);
  real const s = t * c;
  for (int k = 0; k < 4; ++k) {
    real const kp = a[k][P];
    real const kq = a[k][Q];
    a[k][P] = c * kp - s * kq;
    a[k][Q] = s * kp + c * kq;
  }
  for (int k = 0; k < 4; ++k) {
    real const pk = a[P][k];
    real const qk = a[Q][k];
    a[P][k] = c * pk - s * qk;
    a[Q][k] = s * pk + c * qk;
    real const ep = e[k][P];
    real const eq = e[k][Q];
    e[k][P] = c * ep - s * eq;
    e[k][Q] = s * ep + c * eq;
  }
  return true;
}

TEST(OneFormula, smallest_eigenvector_of_four_rows) {
  std::mt19937 random(9);
  for (int round = 0; round < 5000; ++round) {
    real flat[16];
    random_symmetric<4>(random, flat);
    real a[4][4];
    real b[4][4];
    real e[4][4];
    for (int k = 0; k < 16; ++k) {
      a[k / 4][k % 4] = b[k / 4][k % 4] = flat[k];
      e[k / 4][k % 4] = k % 5 == 0 ? 1.0 : 0.0;
    }
    for (int sweep = 0; sweep < 10; ++sweep) {
      bool turned = false;
      for (int p = 0; p < 3; ++p) {
        for (int q = p + 1; q < 4; ++q) { turned = turn_4(p, q, b, e) || turned; }
      }
      if (!turned) { break; }
    }
    int best = 0;
    for (int i = 1; i < 4; ++i) {
      if (b[i][i] < b[best][best]) { best = i; }
    }
    real const want[4] = {e[0][best], e[1][best], e[2][best], e[3][best]};
    real got[4];
    ft::detail::smallest_eigenvector_4(a, got);
    if (!std::isnan(b[0][0].value)) { expect_same(got, want); }
  }
}

/// The angle as paired_eigen and orthogonal_factor had it.
TEST(OneFormula, angle_by_the_root) {
  std::mt19937 random(10);
  for (int round = 0; round < 50000; ++round) {
    real const pq = any(random);
    real const pp = any(random);
    real const qq = any(random);
    real const d = qq - pp;
    real const twice = pq + pq;
    real const root = ft::scalar::sqrt(d * d + twice * twice);
    real const t = twice / (d < real(0.0) ? d - root : d + root);
    real const c = ft::scalar::reciprocal(ft::scalar::sqrt(t * t + real(1.0)));
    real const vp = any(random);
    real const vq = any(random);
    real const want[5] = {t, c, t * c, c * vp - t * c * vq, t * c * vp + c * vq};
    auto const r = ft::detail::jacobi_rotation::with(ft::detail::tangent_by_root(pq, pp, qq));
    real p = vp;
    real q = vq;
    r.turn(p, q);
    real const got[5] = {r.tangent, r.cosine, r.sine, p, q};
    expect_same(got, want);
  }
}

// ---- positive definite systems
// --------------------------------------------------------------------

/// A + damping I, A = B^T B of rank 4 to 6, or anything symmetric; then the right-hand side.
void random_system(std::mt19937& random, float (&terms)[27]) {
  std::normal_distribution<double> normal;
  double B[6][6] = {};
  int const rank = 4 + static_cast<int>(random() % 3);
  for (int i = 0; i < rank; ++i) {
    for (double& v : B[i]) { v = normal(random); }
  }
  bool const indefinite = random() % 4 == 0;
  int at = 0;
  for (; at < 6; ++at) { terms[at] = static_cast<float>(normal(random)); }
  for (int i = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j) {
      double sum = 0;
      for (auto const& row : B) { sum += row[i] * row[j]; }
      terms[at++] = static_cast<float>(indefinite ? normal(random) : sum);
    }
  }
}

/// As the pose optimisation had it.
template <typename Real>
bool solve_by_factors(float const* terms, Real damping, Real (&x)[6]) {
  using plain = ft::plain_scalar_t<Real>;
  Real A[6][6];
  Real b[6];
  int next = 6;
  for (int i = 0; i < 6; ++i) {
    b[i] = Real(static_cast<plain>(terms[i]));
    for (int j = i; j < 6; ++j) { A[i][j] = Real(static_cast<plain>(terms[next++])); }
    A[i][i] = A[i][i] + damping;
  }
  bool positive = true;
  for (int k = 0; k < 6; ++k) {
    positive = positive && A[k][k] > Real(0);
    Real const inverse = ft::scalar::reciprocal(A[k][k]);
    for (int i = k + 1; i < 6; ++i) {
      Real const factor = A[k][i] * inverse;
      for (int j = i; j < 6; ++j) { A[i][j] = A[i][j] - factor * A[k][j]; }
      b[i] = b[i] - factor * b[k];
      A[k][i] = factor;
    }
    b[k] = b[k] * inverse;
  }
  for (int k = 5; k >= 0; --k) {
    x[k] = b[k];
    for (int j = 5; j > k; --j) { x[k] = x[k] - A[k][j] * x[j]; }
  }
  return positive;
}

template <typename Real>
void compare_solutions(unsigned seed) {
  std::mt19937 random(seed);
  for (int round = 0; round < 20000; ++round) {
    float terms[27];
    random_system(random, terms);
    Real const damping = round % 3 == 0 ? Real(0) : Real(1e-3f);
    Real want[6];
    Real got[6];
    bool const solvable = solve_by_factors(terms, damping, want);
    EXPECT_EQ(ft::detail::solve_6(terms, damping, got), solvable);
    // In float a rank that is too low may show as a pivot near 0: such numbers are not used.
    if (solvable) { expect_same(got, want); }
  }
}
TEST(OneFormula, solution_of_a_pose_step) {
  compare_solutions<real>(11);
  compare_solutions<single>(12);
}

/// As MLPnP had it.
TEST(OneFormula, solution_by_elimination) {
  std::mt19937 random(13);
  for (int round = 0; round < 20000; ++round) {
    float terms[27];
    random_system(random, terms);
    real m[42];
    real a[6][7];
    int next = 6;
    for (int i = 0; i < 6; ++i) {
      for (int j = 0; j < 6; ++j) { m[7 * i + j] = j < i ? nan : double{terms[next++]}; }
      m[7 * i + 6] = double{terms[i]};
      for (int j = i; j < 7; ++j) { a[i][j] = m[7 * i + j]; }
    }
    real inverse[6];
    for (int i = 0; i < 6; ++i) {
      inverse[i] = ft::scalar::reciprocal(a[i][i]);
      for (int j = i + 1; j < 6; ++j) {
        real const f = a[i][j] * inverse[i];
        for (int k = j; k < 7; ++k) { a[j][k] -= f * a[i][k]; }
      }
    }
    real want[6];
    for (int i = 5; i >= 0; --i) {
      real sum = a[i][6];
      for (int k = i + 1; k < 6; ++k) { sum -= a[i][k] * want[k]; }
      want[i] = sum * inverse[i];
    }
    real got[6];
    ft::detail::solve_symmetric_6(m, got);
    expect_same(got, want);
  }
}

}  // namespace one_formula_test
