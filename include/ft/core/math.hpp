// SPDX-License-Identifier: Apache-2.0
/// @file Small vectors, poses, and arithmetic that is the same on every executor.
///
/// Compilers may fuse `a * b + c` into one rounding, and host and device compilers choose
/// differently. `strict<T>` is a T whose products are always rounded on their own; formulas written
/// with it give the same bits everywhere. Division and square root are correctly rounded. Where a
/// fused product is wanted, call `fma` on plain numbers.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>
#include <type_traits>
#if defined(__SSE2__) && !defined(__CUDA_ARCH__)
#include <emmintrin.h>
#endif

#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Keeps a product apart from the sum that follows, on hosts whose compilers may fuse the two.
template <typename T>
FT_HOST_DEVICE inline T keep_apart(T value) {
#if !defined(__CUDA_ARCH__)
#if defined(__FMA__) && defined(__x86_64__)
  asm("" : "+x"(value));
#elif defined(__aarch64__)
  asm("" : "+w"(value));
#endif
#endif
  return value;
}

FT_HOST_DEVICE inline float mul(float a, float b) {
#if defined(__CUDA_ARCH__)
  return __fmul_rn(a, b);
#else
  return keep_apart(a * b);
#endif
}
FT_HOST_DEVICE inline double mul(double a, double b) {
#if defined(__CUDA_ARCH__)
  return __dmul_rn(a, b);
#else
  return keep_apart(a * b);
#endif
}
FT_HOST_DEVICE inline float div(float a, float b) {
#if defined(__CUDA_ARCH__)
  return __fdiv_rn(a, b);
#else
  return a / b;
#endif
}
FT_HOST_DEVICE inline double div(double a, double b) {
#if defined(__CUDA_ARCH__)
  return __ddiv_rn(a, b);
#else
  return a / b;
#endif
}
/// 1 / a, correctly rounded.
FT_HOST_DEVICE inline float reciprocal(float a) {
#if defined(__CUDA_ARCH__)
  return __frcp_rn(a);
#else
  return 1.0f / a;
#endif
}
FT_HOST_DEVICE inline double reciprocal(double a) {
#if defined(__CUDA_ARCH__)
  return __drcp_rn(a);
#else
  return 1.0 / a;
#endif
}
FT_HOST_DEVICE inline float square_root(float a) {
#if defined(__CUDA_ARCH__)
  return __fsqrt_rn(a);
#else
  return std::sqrt(a);
#endif
}
FT_HOST_DEVICE inline double square_root(double a) {
#if defined(__CUDA_ARCH__)
  return __dsqrt_rn(a);
#else
  return std::sqrt(a);
#endif
}

}  // namespace detail

/// A number whose products are never fused with a following sum. Converts implicitly from T,
/// explicitly
/// (`.value`) to T.
template <typename T>
struct strict {
  T value;

  strict() = default;
  FT_HOST_DEVICE constexpr strict(T v) : value(v) {}  // NOLINT(google-explicit-constructor)
  FT_HOST_DEVICE explicit constexpr operator T() const { return value; }

  friend FT_HOST_DEVICE strict operator+(strict a, strict b) { return {a.value + b.value}; }
  friend FT_HOST_DEVICE strict operator-(strict a, strict b) { return {a.value - b.value}; }
  friend FT_HOST_DEVICE strict operator*(strict a, strict b) {
    return {detail::mul(a.value, b.value)};
  }
  friend FT_HOST_DEVICE strict operator/(strict a, strict b) {
    return {detail::div(a.value, b.value)};
  }
  friend FT_HOST_DEVICE strict operator-(strict a) { return {-a.value}; }
  FT_HOST_DEVICE strict& operator+=(strict b) { return *this = *this + b; }
  FT_HOST_DEVICE strict& operator-=(strict b) { return *this = *this - b; }
  FT_HOST_DEVICE strict& operator*=(strict b) { return *this = *this * b; }
  friend FT_HOST_DEVICE bool operator<(strict a, strict b) { return a.value < b.value; }
  friend FT_HOST_DEVICE bool operator>(strict a, strict b) { return a.value > b.value; }
  friend FT_HOST_DEVICE bool operator<=(strict a, strict b) { return a.value <= b.value; }
  friend FT_HOST_DEVICE bool operator>=(strict a, strict b) { return a.value >= b.value; }
  friend FT_HOST_DEVICE bool operator==(strict a, strict b) { return a.value == b.value; }
  friend FT_HOST_DEVICE bool operator!=(strict a, strict b) { return a.value != b.value; }
};

using strict_float = strict<float>;
using strict_double = strict<double>;

/// The number behind a scalar: T for T and for strict<T>.
template <typename T>
struct plain_scalar {
  using type = T;
};
template <typename T>
struct plain_scalar<strict<T>> {
  using type = T;
};
template <typename T>
using plain_scalar_t = typename plain_scalar<T>::type;

template <typename T>
FT_HOST_DEVICE T to_plain(T v) {
  return v;
}
template <typename T>
FT_HOST_DEVICE T to_plain(strict<T> v) {
  return v.value;
}

/// Functions that cameras and solvers call on any scalar: float, double, strict of either.
namespace scalar {

template <typename S>
FT_HOST_DEVICE S sqrt(S v) {
  return S(detail::square_root(to_plain(v)));
}
/// 1 / v to the bit, in fewer instructions on a GPU.
template <typename S>
FT_HOST_DEVICE S reciprocal(S v) {
  return S(detail::reciprocal(to_plain(v)));
}
template <typename S>
FT_HOST_DEVICE S abs(S v) {
  return v < S(0) ? -v : v;
}
/// Computed in double; for float scalars rounded once, so that host and device agree.
template <typename S>
FT_HOST_DEVICE S atan2(S y, S x) {
  using P = plain_scalar_t<S>;
  return S(
      static_cast<P>(::atan2(static_cast<double>(to_plain(y)), static_cast<double>(to_plain(x)))));
}
/// The same for y > 0, for float scalars in float, with an error below 4e-7. Source: Abramowitz and
/// Stegun, "Handbook of mathematical functions", 4.4.49.
template <typename S>
FT_HOST_DEVICE S quick_atan2(S y, S x) {
  if constexpr (!std::is_same<plain_scalar_t<S>, float>::value) {
    return atan2(y, x);
  } else {
    S const size = abs(x);
    bool const steep = y > size;
    S const t = steep ? size / y : y / size;
    S const t2 = t * t;
    constexpr float terms[] = {0.0028662257f,  -0.0161657367f, 0.0429096138f,
                               -0.0752896400f, 0.1065626393f,  -0.1420889944f,
                               0.1999355085f,  -0.3333314528f, 1.0f};
    S sum = S(terms[0]);
    FT_UNROLL
    for (int i = 1; i < 9; ++i) { sum = sum * t2 + S(terms[i]); }
    S angle = sum * t;
    if (steep) { angle = S(1.57079633f) - angle; }
    return x < S(0) ? S(3.14159265f) - angle : angle;
  }
}
template <typename S>
FT_HOST_DEVICE S tan(S v) {
  using P = plain_scalar_t<S>;
  return S(static_cast<P>(::tan(static_cast<double>(to_plain(v)))));
}
template <typename S>
FT_HOST_DEVICE bool is_finite(S v) {
  using P = plain_scalar_t<S>;
  P const p = to_plain(v);
  return p - p == P(0);
}

}  // namespace scalar

template <typename S>
struct vec2 {
  S x, y;
};

template <typename S>
struct vec3 {
  S x, y, z;

  friend FT_HOST_DEVICE vec3 operator+(vec3 a, vec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
  friend FT_HOST_DEVICE vec3 operator-(vec3 a, vec3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
  friend FT_HOST_DEVICE vec3 operator-(vec3 a) { return {-a.x, -a.y, -a.z}; }
};

template <typename S>
FT_HOST_DEVICE S dot(vec3<S> a, vec3<S> b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}

/// 3 x 3, row-major.
template <typename S>
struct mat3 {
  S m[9];

  FT_HOST_DEVICE static mat3 identity() {
    return {{S(1), S(0), S(0), S(0), S(1), S(0), S(0), S(0), S(1)}};
  }
  FT_HOST_DEVICE mat3 transposed() const {
    return {{m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]}};
  }
  friend FT_HOST_DEVICE vec3<S> operator*(mat3 const& a, vec3<S> v) {
    return {a.m[0] * v.x + a.m[1] * v.y + a.m[2] * v.z, a.m[3] * v.x + a.m[4] * v.y + a.m[5] * v.z,
            a.m[6] * v.x + a.m[7] * v.y + a.m[8] * v.z};
  }
  friend FT_HOST_DEVICE mat3 operator*(mat3 const& a, mat3 const& b) {
    mat3 c;
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        c.m[3 * i + j] =
            a.m[3 * i] * b.m[j] + a.m[3 * i + 1] * b.m[3 + j] + a.m[3 * i + 2] * b.m[6 + j];
      }
    }
    return c;
  }
};

/// A rigid motion x -> R x + t. Named `T_ab`, it maps coordinates in frame b to frame a; lengths in
/// metres.
template <typename S>
struct rigid {
  mat3<S> R;
  vec3<S> t;

  FT_HOST_DEVICE static rigid identity() { return {mat3<S>::identity(), {S(0), S(0), S(0)}}; }
  FT_HOST_DEVICE vec3<S> operator*(vec3<S> p) const { return R * p + t; }
  friend FT_HOST_DEVICE rigid operator*(rigid const& a, rigid const& b) {
    return {a.R * b.R, a.R * b.t + a.t};
  }
  FT_HOST_DEVICE rigid inverse() const {
    mat3<S> const Rt = R.transposed();
    return {Rt, -(Rt * t)};
  }
  /// Where the origin of the source frame's camera is: for T_cw the camera's centre in the world.
  FT_HOST_DEVICE vec3<S> centre() const { return -(R.transposed() * t); }
  /// The same motion with rows of R made orthogonal and of length 1 (Gram-Schmidt). inverse() takes
  /// R for a rotation: a pose that is fed back through products and inverses, as a prediction with
  /// constant velocity is, doubles what R lacks of that with every frame unless this is called.
  FT_HOST_DEVICE rigid orthonormalized() const {
    auto const scaled = [](vec3<S> v, S s) { return vec3<S>{v.x * s, v.y * s, v.z * s}; };
    auto const unit = [&](vec3<S> v) { return scaled(v, S(1) / scalar::sqrt(dot(v, v))); };
    vec3<S> const a = unit({R.m[0], R.m[1], R.m[2]});
    vec3<S> const second{R.m[3], R.m[4], R.m[5]};
    vec3<S> const b = unit(second - scaled(a, dot(a, second)));
    return {{{a.x, a.y, a.z, b.x, b.y, b.z, a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z,
              a.x * b.y - a.y * b.x}},
            t};
  }
  template <typename U>
  FT_HOST_DEVICE rigid<U> cast() const {
    using P = plain_scalar_t<U>;
    rigid<U> r;
    for (int i = 0; i < 9; ++i) { r.R.m[i] = U(static_cast<P>(to_plain(R.m[i]))); }
    r.t = {U(static_cast<P>(to_plain(t.x))), U(static_cast<P>(to_plain(t.y))),
           U(static_cast<P>(to_plain(t.z)))};
    return r;
  }
};

using pose = rigid<float>;  ///< T_cw unless a name says otherwise: world to camera

/// Nearest integer, halves to even (cv::cvRound); |v| below 2^31.
FT_HOST_DEVICE inline int round_to_even(float v) {
#if defined(__CUDA_ARCH__)
  return __float2int_rn(v);
#elif defined(__SSE2__)
  return _mm_cvtss_si32(_mm_set_ss(v));
#else
  return static_cast<int>(std::lrint(v));
#endif
}

/// Nearest integer, halves away from zero (std::round); 0 for NaN and what no int can hold.
FT_HOST_DEVICE inline int round_away(float v) {
  if (!(::fabsf(v) < 2147483648.0f)) { return 0; }
  float const t = ::truncf(v);
  float const rest = ::fabsf(v - t);  // exact
  return static_cast<int>(t) + (rest >= 0.5f ? (v < 0 ? -1 : 1) : 0);
}

FT_HOST_DEVICE inline int popcount(std::uint32_t v) {
#if defined(__CUDA_ARCH__)
  return __popc(v);
#else
  return __builtin_popcount(v);
#endif
}

/// Number of the lowest bit that is set, of a value above 0.
FT_HOST_DEVICE inline int trailing_zeros(std::uint32_t v) {
#if defined(__CUDA_ARCH__)
  return __ffs(static_cast<int>(v)) - 1;
#else
  return __builtin_ctz(v);
#endif
}

template <typename T>
FT_HOST_DEVICE constexpr T min_of(T a, T b) {
  return b < a ? b : a;
}
template <typename T>
FT_HOST_DEVICE constexpr T max_of(T a, T b) {
  return a < b ? b : a;
}
template <typename T>
FT_HOST_DEVICE constexpr T clamp(T v, T low, T high) {
  return v < low ? low : (high < v ? high : v);
}
FT_HOST_DEVICE constexpr int ceil_div(int a, int b) { return (a + b - 1) / b; }

}  // namespace FT_ABI
}  // namespace ft
