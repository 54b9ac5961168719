// SPDX-License-Identifier: Apache-2.0
/// @file Vectors, matrices and poses to and from Eigen's types, and SE3 groups like Sophus' by
/// template; the only header that includes Eigen. For scalars float and double: Eigen sums in
/// another order than ft, so `strict` scalars are not supported.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <type_traits>

#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// A view of the same memory as Eigen's column vector or row-major matrix, to read or write. Valid
/// as long as the argument. Arrays of ft's types map in the same way.
template <typename S>
auto as_eigen(vec3<S>& v) {
  static_assert(std::is_floating_point<S>::value && sizeof v == 3 * sizeof(S), "no padding");
  return Eigen::Map<Eigen::Matrix<S, 3, 1>>(&v.x);
}
template <typename S>
auto as_eigen(vec3<S> const& v) {
  static_assert(std::is_floating_point<S>::value && sizeof v == 3 * sizeof(S), "no padding");
  return Eigen::Map<Eigen::Matrix<S, 3, 1> const>(&v.x);
}
template <typename S>
auto as_eigen(mat3<S>& m) {
  static_assert(std::is_floating_point<S>::value, "float or double");
  return Eigen::Map<Eigen::Matrix<S, 3, 3, Eigen::RowMajor>>(m.m);
}
template <typename S>
auto as_eigen(mat3<S> const& m) {
  static_assert(std::is_floating_point<S>::value, "float or double");
  return Eigen::Map<Eigen::Matrix<S, 3, 3, Eigen::RowMajor> const>(m.m);
}
// A map into a temporary would dangle.
template <typename S>
void as_eigen(vec3<S> const&& v) = delete;
template <typename S>
void as_eigen(mat3<S> const&& m) = delete;

/// Any expression of three rows and one column.
template <typename Derived, typename S = typename Derived::Scalar>
vec3<S> vec3_from_eigen(Eigen::MatrixBase<Derived> const& v) {
  EIGEN_STATIC_ASSERT_VECTOR_SPECIFIC_SIZE(Derived, 3)
  vec3<S> r;
  as_eigen(r) = v;
  return r;
}
/// Any 3 x 3 expression, in any storage order.
template <typename Derived, typename S = typename Derived::Scalar>
mat3<S> mat3_from_eigen(Eigen::MatrixBase<Derived> const& m) {
  EIGEN_STATIC_ASSERT_MATRIX_SPECIFIC_SIZE(Derived, 3, 3)
  mat3<S> r;
  as_eigen(r) = m;
  return r;
}

/// A rigid motion as Eigen's isometry, and back. The entries are copied unchanged: a rotation that
/// is not orthonormal stays so. To change the scalar: `T.cast<double>()`, on either side.
template <typename S>
Eigen::Transform<S, 3, Eigen::Isometry> to_isometry(rigid<S> const& T) {
  Eigen::Transform<S, 3, Eigen::Isometry> r = Eigen::Transform<S, 3, Eigen::Isometry>::Identity();
  r.linear() = as_eigen(T.R);
  r.translation() = as_eigen(T.t);
  return r;
}
template <typename S, int Mode, int Options>
rigid<S> from_isometry(Eigen::Transform<S, 3, Mode, Options> const& T) {
  static_assert(Mode == Eigen::Isometry, "a rigid motion");
  return {mat3_from_eigen(T.linear()), vec3_from_eigen(T.translation())};
}

/// The rotation as a unit quaternion.
template <typename S>
Eigen::Quaternion<S> to_quaternion(mat3<S> const& R) {
  return Eigen::Quaternion<S>(Eigen::Matrix<S, 3, 3>(as_eigen(R))).normalized();
}
/// A rigid motion from a rotation and a translation. @param q is normalised; must not be zero
template <typename Rotation, typename Translation>
rigid<typename Rotation::Scalar> from_quaternion(Eigen::QuaternionBase<Rotation> const& q,
                                                 Eigen::MatrixBase<Translation> const& t) {
  return {mat3_from_eigen(q.normalized().toRotationMatrix()), vec3_from_eigen(t)};
}

/// A rigid motion as a Lie group element with Sophus' interface, `to_se3<Sophus::SE3f>(T_cw)`, and
/// back. @tparam SE3 has Scalar, a constructor from a unit quaternion and a translation,
/// rotationMatrix() and translation()
template <typename SE3, typename S>
SE3 to_se3(rigid<S> const& T) {
  using scalar_type = typename SE3::Scalar;
  Eigen::Matrix<scalar_type, 3, 1> const t = as_eigen(T.t).template cast<scalar_type>();
  return SE3(to_quaternion(T.R).template cast<scalar_type>().normalized(), t);
}
template <typename SE3>
rigid<typename SE3::Scalar> from_se3(SE3 const& T) {
  return {mat3_from_eigen(T.rotationMatrix()), vec3_from_eigen(T.translation())};
}

}  // namespace FT_ABI
}  // namespace ft
