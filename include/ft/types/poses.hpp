// SPDX-License-Identifier: Apache-2.0
/// @file Small vectors, matrices, rigid motions and similarities.
#pragma once

#include "ft/core/config.hpp"
#include "ft/types/scalars.hpp"

namespace ft {
inline namespace v0 {

template <typename S>
struct vec2 {
  S x, y;
};

template <typename S>
struct vec3 {
  S x, y, z;

  friend FT_HOST_DEVICE FT_INLINE vec3 operator+(vec3 a, vec3 b) {
    return {a.x + b.x, a.y + b.y, a.z + b.z};
  }
  friend FT_HOST_DEVICE FT_INLINE vec3 operator-(vec3 a, vec3 b) {
    return {a.x - b.x, a.y - b.y, a.z - b.z};
  }
  friend FT_HOST_DEVICE FT_INLINE vec3 operator-(vec3 a) { return {-a.x, -a.y, -a.z}; }
  template <typename U>
  FT_HOST_DEVICE FT_INLINE vec3<U> cast() const {
    using P = plain_scalar_t<U>;
    return {U(static_cast<P>(to_plain(x))), U(static_cast<P>(to_plain(y))),
            U(static_cast<P>(to_plain(z)))};
  }
};

/// Sums of three products are x0 + (x1 + x2) here and below, as in Eigen: systems that use Eigen
/// without fused multiply-add compute the same bits.
template <typename S>
FT_HOST_DEVICE FT_INLINE S dot(vec3<S> a, vec3<S> b) {
  return a.x * b.x + (a.y * b.y + a.z * b.z);
}
template <typename S>
FT_HOST_DEVICE FT_INLINE vec3<S> cross(vec3<S> a, vec3<S> b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/// A rotation. Of unit length.
template <typename S>
struct quaternion {
  S x, y, z, w;

  /// v rotated: v + 2 w (q x v) + 2 q x (q x v), in this order, as in Sophus.
  friend FT_HOST_DEVICE FT_INLINE vec3<S> operator*(quaternion const& q, vec3<S> v) {
    vec3<S> const axis{q.x, q.y, q.z};
    vec3<S> const halved = cross(axis, v);
    vec3<S> const turned = halved + halved;
    return v + vec3<S>{q.w * turned.x, q.w * turned.y, q.w * turned.z} + cross(axis, turned);
  }
};

/// 3 x 3, row-major.
template <typename S>
struct mat3 {
  S m[9];

  FT_HOST_DEVICE FT_INLINE static constexpr mat3 identity() {
    return {{S(1), S(0), S(0), S(0), S(1), S(0), S(0), S(0), S(1)}};
  }
  FT_HOST_DEVICE FT_INLINE mat3 transposed() const {
    return {{m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]}};
  }
  friend FT_HOST_DEVICE FT_INLINE vec3<S> operator*(mat3 const& a, vec3<S> v) {
    return {a.m[0] * v.x + (a.m[1] * v.y + a.m[2] * v.z),
            a.m[3] * v.x + (a.m[4] * v.y + a.m[5] * v.z),
            a.m[6] * v.x + (a.m[7] * v.y + a.m[8] * v.z)};
  }
  friend FT_HOST_DEVICE FT_INLINE mat3 operator*(mat3 const& a, mat3 const& b) {
    mat3 c;
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        c.m[3 * i + j] =
            a.m[3 * i] * b.m[j] + (a.m[3 * i + 1] * b.m[3 + j] + a.m[3 * i + 2] * b.m[6 + j]);
      }
    }
    return c;
  }
  template <typename U>
  FT_HOST_DEVICE FT_INLINE mat3<U> cast() const {
    using P = plain_scalar_t<U>;
    mat3<U> c;
    for (int i = 0; i < 9; ++i) { c.m[i] = U(static_cast<P>(to_plain(m[i]))); }
    return c;
  }
};

template <typename S>
FT_HOST_DEVICE FT_INLINE vec3<S> scaled(vec3<S> v, S s) {
  return {v.x * s, v.y * s, v.z * s};
}
template <typename S>
FT_HOST_DEVICE FT_INLINE mat3<S> scaled(mat3<S> const& a, S s) {
  mat3<S> c;
  FT_UNROLL
  for (int i = 0; i < 9; ++i) { c.m[i] = a.m[i] * s; }
  return c;
}

/// A rigid motion x -> R x + t, in metres. Named `T_ab`, it maps coordinates in frame b to frame a.
template <typename S>
struct rigid {
  mat3<S> R;
  vec3<S> t;

  FT_HOST_DEVICE FT_INLINE static constexpr rigid identity() {
    return {mat3<S>::identity(), {S(0), S(0), S(0)}};
  }
  FT_HOST_DEVICE FT_INLINE vec3<S> operator*(vec3<S> p) const { return R * p + t; }
  friend FT_HOST_DEVICE FT_INLINE rigid operator*(rigid const& a, rigid const& b) {
    return {a.R * b.R, a.R * b.t + a.t};
  }
  FT_HOST_DEVICE FT_INLINE rigid inverse() const {
    mat3<S> const Rt = R.transposed();
    return {Rt, -(Rt * t)};
  }
  /// Origin of the target frame in the source frame: for T_cw the camera's centre in the world.
  FT_HOST_DEVICE FT_INLINE vec3<S> centre() const { return -(R.transposed() * t); }
  /// The same motion with orthonormal rows of R (Gram-Schmidt). inverse() assumes that R is a
  /// rotation. A pose that is fed back through products and inverses, such as a prediction with
  /// constant velocity, doubles its error of orthonormality every frame unless this is called.
  FT_HOST_DEVICE FT_INLINE rigid orthonormalized() const {
    vec3<S> const a = unit({R.m[0], R.m[1], R.m[2]});
    vec3<S> const second{R.m[3], R.m[4], R.m[5]};
    vec3<S> const b = unit(second - scaled(a, dot(a, second)));
    return {{{a.x, a.y, a.z, b.x, b.y, b.z, a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z,
              a.x * b.y - a.y * b.x}},
            t};
  }
  template <typename U>
  FT_HOST_DEVICE FT_INLINE rigid<U> cast() const {
    return {R.template cast<U>(), t.template cast<U>()};
  }

private:
  FT_HOST_DEVICE FT_INLINE static vec3<S> unit(vec3<S> v) {
    return scaled(v, S(1) / S(rounded::square_root(to_plain(dot(v, v)))));
  }
};

/// A similarity x -> scale R x + t. Named `T_ab`, it maps coordinates in frame b to frame a: a unit
/// of b is `scale` units of a.
template <typename S>
struct similarity {
  mat3<S> R;
  vec3<S> t;
  S scale;  ///< above 0

  FT_HOST_DEVICE FT_INLINE static constexpr similarity identity() {
    return {mat3<S>::identity(), {S(0), S(0), S(0)}, S(1)};
  }
  FT_HOST_DEVICE FT_INLINE vec3<S> operator*(vec3<S> p) const { return scaled(R * p, scale) + t; }
  friend FT_HOST_DEVICE FT_INLINE similarity operator*(similarity const& a, similarity const& b) {
    return {a.R * b.R, a * b.t, a.scale * b.scale};
  }
  FT_HOST_DEVICE FT_INLINE similarity inverse() const {
    mat3<S> const Rt = R.transposed();
    S const shrink = S(1) / scale;
    return {Rt, -scaled(Rt * t, shrink), shrink};
  }
  /// As that of rigid.
  FT_HOST_DEVICE FT_INLINE similarity orthonormalized() const {
    return {rigid<S>{R, t}.orthonormalized().R, t, scale};
  }
  template <typename U>
  FT_HOST_DEVICE FT_INLINE similarity<U> cast() const {
    using P = plain_scalar_t<U>;
    return {R.template cast<U>(), t.template cast<U>(), U(static_cast<P>(to_plain(scale)))};
  }
};

using pose = rigid<float>;  ///< T_cw unless a name says otherwise: world to camera

}  // namespace v0
}  // namespace ft
