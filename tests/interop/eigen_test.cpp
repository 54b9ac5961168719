// SPDX-License-Identifier: Apache-2.0
// Bridges to Eigen: maps share memory, conversions keep every entry, and both sides' products
// agree.
#include "ft/interop/eigen.hpp"

#include <gtest/gtest.h>

#include <limits>

#include "ft/types/poses.hpp"

namespace eigen_test {

template <typename S>
class eigen_interop : public ::testing::Test {
protected:
  static Eigen::Matrix<S, 3, 3> rotation() {
    using vector = Eigen::Matrix<S, 3, 1>;
    return Eigen::AngleAxis<S>(S(0.7), vector(S(0.2), S(-0.5), S(0.8)).normalized())
        .toRotationMatrix();
  }
  static Eigen::Transform<S, 3, Eigen::Isometry> motion() {
    auto T = Eigen::Transform<S, 3, Eigen::Isometry>::Identity();
    T.linear() = rotation();
    T.translation() = Eigen::Matrix<S, 3, 1>(S(1.5), S(-2.25), S(0.125));
    return T;
  }
  static S tolerance() { return 16 * std::numeric_limits<S>::epsilon(); }
};
using scalars = ::testing::Types<float, double>;
TYPED_TEST_SUITE(eigen_interop, scalars);

TYPED_TEST(eigen_interop, maps_share_memory) {
  using S = TypeParam;
  ft::vec3<S> v{1, 2, 3};
  ft::as_eigen(v) *= S(2);
  EXPECT_EQ(v.x, S(2));
  EXPECT_EQ(v.z, S(6));
  ft::vec3<S> const& fixed = v;
  EXPECT_EQ(ft::as_eigen(fixed).data(), &v.x);
  ft::mat3<S> m{{1, 2, 3, 4, 5, 6, 7, 8, 9}};
  EXPECT_EQ(ft::as_eigen(m)(0, 2), S(3));
  EXPECT_EQ(ft::as_eigen(m)(2, 0), S(7));
  ft::as_eigen(m).transposeInPlace();
  EXPECT_EQ(m.m[2], S(7));
}

TYPED_TEST(eigen_interop, expressions_of_any_storage_order_come_in) {
  using S = TypeParam;
  Eigen::Matrix<S, 3, 3> columns;
  columns << 1, 2, 3, 4, 5, 6, 7, 8, 9;
  auto const m = ft::mat3_from_eigen(columns);
  for (int i = 0; i < 9; ++i) { EXPECT_EQ(m.m[i], S(i + 1)); }
  auto const v = ft::vec3_from_eigen(columns.col(1) + columns.row(0).transpose());
  EXPECT_EQ(v.x, S(3));
  EXPECT_EQ(v.y, S(7));
  EXPECT_EQ(v.z, S(11));
}

TYPED_TEST(eigen_interop, isometries_go_there_and_back_without_loss) {
  using S = TypeParam;
  auto const T = this->motion();
  ft::rigid<S> const mine = ft::from_isometry(T);
  auto const back = ft::to_isometry(mine);
  EXPECT_TRUE((back.matrix().array() == T.matrix().array()).all());
  ft::vec3<S> const p{S(0.5), S(-1), S(4)};
  ft::vec3<S> const q = mine * p;
  EXPECT_LT((ft::as_eigen(q) - T * ft::as_eigen(p)).norm(), this->tolerance());
  ft::vec3<S> const r = mine.inverse() * p;
  EXPECT_LT((ft::as_eigen(r) - T.inverse() * ft::as_eigen(p)).norm(), this->tolerance());
}

TYPED_TEST(eigen_interop, quaternions_are_unit_and_of_the_same_rotation) {
  using S = TypeParam;
  auto const T = ft::from_isometry(this->motion());
  auto const q = ft::to_quaternion(T.R);
  EXPECT_NEAR(q.norm(), S(1), this->tolerance());
  Eigen::Quaternion<S> const longer(2 * q.w(), 2 * q.x(), 2 * q.y(), 2 * q.z());
  auto const back = ft::from_quaternion(longer, ft::as_eigen(T.t));
  for (int i = 0; i < 9; ++i) { EXPECT_NEAR(back.R.m[i], T.R.m[i], this->tolerance()); }
  EXPECT_EQ(back.t.y, T.t.y);
}

/// What Sophus::SE3 has.
template <typename S>
struct lie_group {
  using Scalar = S;
  Eigen::Quaternion<S> q;
  Eigen::Matrix<S, 3, 1> t;
  lie_group(Eigen::Quaternion<S> const& rotation, Eigen::Matrix<S, 3, 1> const& translation)
      : q(rotation), t(translation) {}
  Eigen::Matrix<S, 3, 3> rotationMatrix() const { return q.toRotationMatrix(); }
  Eigen::Matrix<S, 3, 1> const& translation() const { return t; }
};

TYPED_TEST(eigen_interop, se3_of_either_scalar) {
  using S = TypeParam;
  auto const T = ft::from_isometry(this->motion());
  auto const expect_same = [&](auto const& got) {
    for (int i = 0; i < 9; ++i) { EXPECT_NEAR(double(got.R.m[i]), double(T.R.m[i]), 2e-6); }
    EXPECT_EQ(double(got.t.x), double(T.t.x));  // exact in float
  };
  expect_same(ft::from_se3(ft::to_se3<lie_group<float>>(T)));
  expect_same(ft::from_se3(ft::to_se3<lie_group<double>>(T)));
  auto const same = ft::to_se3<lie_group<S>>(T);
  EXPECT_NEAR(same.q.norm(), S(1), this->tolerance());
}

}  // namespace eigen_test
