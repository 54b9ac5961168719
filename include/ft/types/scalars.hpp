// SPDX-License-Identifier: Apache-2.0
/// @file Scalars whose arithmetic gives the same bits on every executor; see core/arithmetic.hpp.
#pragma once

#include <cmath>

#include "ft/core/config.hpp"

namespace ft {
inline namespace v0 {

/// Products, quotients and roots that are rounded on their own.
namespace rounded {

/// Hides a product from the compiler, so that it is not fused with the sum that follows. Needed on
/// hosts with fused multiply-add only.
template <typename T>
FT_HOST_DEVICE FT_INLINE T keep_apart(T value) {
#if !defined(__CUDA_ARCH__)
#if defined(__FMA__) && defined(__x86_64__)
  asm("" : "+x"(value));
#elif defined(__aarch64__)
  asm("" : "+w"(value));
#endif
#endif
  return value;
}

FT_HOST_DEVICE FT_INLINE float mul(float a, float b) {
#if defined(__CUDA_ARCH__)
  return __fmul_rn(a, b);
#else
  return keep_apart(a * b);
#endif
}
FT_HOST_DEVICE FT_INLINE double mul(double a, double b) {
#if defined(__CUDA_ARCH__)
  return __dmul_rn(a, b);
#else
  return keep_apart(a * b);
#endif
}
FT_HOST_DEVICE FT_INLINE float div(float a, float b) {
#if defined(__CUDA_ARCH__)
  return __fdiv_rn(a, b);
#else
  return a / b;
#endif
}
FT_HOST_DEVICE FT_INLINE double div(double a, double b) {
#if defined(__CUDA_ARCH__)
  return __ddiv_rn(a, b);
#else
  return a / b;
#endif
}
/// 1 / a, correctly rounded.
FT_HOST_DEVICE FT_INLINE float reciprocal(float a) {
#if defined(__CUDA_ARCH__)
  return __frcp_rn(a);
#else
  return 1.0f / a;
#endif
}
FT_HOST_DEVICE FT_INLINE double reciprocal(double a) {
#if defined(__CUDA_ARCH__)
  return __drcp_rn(a);
#else
  return 1.0 / a;
#endif
}
FT_HOST_DEVICE FT_INLINE float square_root(float a) {
#if defined(__CUDA_ARCH__)
  return __fsqrt_rn(a);
#else
  return std::sqrt(a);
#endif
}
FT_HOST_DEVICE FT_INLINE double square_root(double a) {
#if defined(__CUDA_ARCH__)
  return __dsqrt_rn(a);
#else
  return std::sqrt(a);
#endif
}

}  // namespace rounded

/// A number whose products are never fused with a following sum.
/// Converts implicitly from T and explicitly (`.value`) to T.
template <typename T>
struct strict {
  T value;

  strict() = default;
  FT_HOST_DEVICE FT_INLINE constexpr strict(T v)
      : value(v) {}  // NOLINT(google-explicit-constructor)
  FT_HOST_DEVICE FT_INLINE explicit constexpr operator T() const { return value; }

  friend FT_HOST_DEVICE FT_INLINE strict operator+(strict a, strict b) {
    return {a.value + b.value};
  }
  friend FT_HOST_DEVICE FT_INLINE strict operator-(strict a, strict b) {
    return {a.value - b.value};
  }
  friend FT_HOST_DEVICE FT_INLINE strict operator*(strict a, strict b) {
    return {rounded::mul(a.value, b.value)};
  }
  friend FT_HOST_DEVICE FT_INLINE strict operator/(strict a, strict b) {
    return {rounded::div(a.value, b.value)};
  }
  friend FT_HOST_DEVICE FT_INLINE strict operator-(strict a) { return {-a.value}; }
  FT_HOST_DEVICE FT_INLINE strict& operator+=(strict b) { return *this = *this + b; }
  FT_HOST_DEVICE FT_INLINE strict& operator-=(strict b) { return *this = *this - b; }
  FT_HOST_DEVICE FT_INLINE strict& operator*=(strict b) { return *this = *this * b; }
  friend FT_HOST_DEVICE FT_INLINE bool operator<(strict a, strict b) { return a.value < b.value; }
  friend FT_HOST_DEVICE FT_INLINE bool operator>(strict a, strict b) { return a.value > b.value; }
  friend FT_HOST_DEVICE FT_INLINE bool operator<=(strict a, strict b) { return a.value <= b.value; }
  friend FT_HOST_DEVICE FT_INLINE bool operator>=(strict a, strict b) { return a.value >= b.value; }
  friend FT_HOST_DEVICE FT_INLINE bool operator==(strict a, strict b) { return a.value == b.value; }
  friend FT_HOST_DEVICE FT_INLINE bool operator!=(strict a, strict b) { return a.value != b.value; }
};

using strict_float = strict<float>;
using strict_double = strict<double>;

/// The built-in type of a scalar: T for T and for strict<T>.
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
FT_HOST_DEVICE FT_INLINE T to_plain(T v) {
  return v;
}
template <typename T>
FT_HOST_DEVICE FT_INLINE T to_plain(strict<T> v) {
  return v.value;
}

}  // namespace v0
}  // namespace ft
