// SPDX-License-Identifier: Apache-2.0
/// @file Arithmetic that gives the same bits on every executor.
///
/// Compilers may fuse `a * b + c` into one rounding, and host and device compilers choose
/// differently. `strict<T>` is a T whose products are always rounded on their own, so formulas
/// written with it give the same bits everywhere. Division and square root are correctly rounded.
/// Call `fma` on plain numbers where a fused product is wanted.
#pragma once

#include <cmath>
#include <cstdint>
#include <type_traits>
#if defined(__SSE2__) && !defined(__CUDA_ARCH__)
#include <emmintrin.h>
#endif

#include "ft/core/config.hpp"
#include "ft/types/scalars.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {
using rounded::div;
using rounded::mul;
using rounded::reciprocal;
using rounded::square_root;
}  // namespace detail

namespace detail {

template <typename S>
FT_HOST_DEVICE double widened(S v) {
  return static_cast<double>(to_plain(v));
}
template <typename S>
FT_HOST_DEVICE S narrowed(double v) {
  return S(static_cast<plain_scalar_t<S>>(v));
}

/// The angle of (x, y), as ::atan2. Equal bits on every executor. The angle is reduced to at most
/// pi/8 from an axis or a diagonal; there a polynomial, fitted to the arc tangent at Chebyshev
/// nodes, has an error below 3 units in the last place.
FT_HOST_DEVICE inline strict_double strict_atan2(strict_double y, strict_double x) {
  double const a = ::fabs(x.value);
  double const b = ::fabs(y.value);
  if (!(a > 0 && b > 0 && a <= 1e300 && b <= 1e300)) {  // an axis, infinite or NaN: exact cases
    return ::atan2(y.value, x.value);
  }
  constexpr double terms[] = {-0.019175404711104935, 0.03923044778479309,  -0.050854078345894844,
                              0.05858140904866328,   -0.06664510525508936, 0.07692183125376892,
                              -0.0909090457530649,   0.11111111015187018,  -0.14285714284665682,
                              0.19999999999995516,   -0.3333333333333333};
  strict_double const large = b < a ? a : b;
  strict_double const small = b < a ? b : a;
  bool const diagonal = small > strict_double(0.41421356237309503) * large;
  strict_double const t = (diagonal ? small - large : small) / (diagonal ? small + large : large);
  strict_double const t2 = t * t;
  strict_double sum = terms[0];
  FT_UNROLL
  for (int i = 1; i < 11; ++i) { sum = t2 * sum + strict_double(terms[i]); }
  strict_double angle = t + t * (t2 * sum);
  if (diagonal) { angle = strict_double(0.7853981633974483) + angle; }
  if (a < b) { angle = strict_double(1.5707963267948966) - angle; }
  if (x.value < 0) { angle = strict_double(3.141592653589793) - angle; }
  return y.value < 0 ? -angle : angle;
}

struct sine_and_cosine {
  strict_double sine, cosine;
};

/// Sine and cosine of an angle by their series on [-pi/4, pi/4], with errors below 4e-16. Equal
/// bits on every executor for angles below 1e5.
FT_HOST_DEVICE inline sine_and_cosine strict_sin_cos(strict_double v) {
  if (!(::fabs(v.value) < 1e5)) { return {::sin(v.value), ::cos(v.value)}; }
  double const turns = ::rint((v * strict_double(0.6366197723675814)).value);
  // pi / 2 in three parts; the first two have 33 bits, so their products are exact.
  strict_double const n = turns;
  strict_double const r = ((v - n * strict_double(1.57079632673412561417)) -
                           n * strict_double(6.07710050630396597660e-11)) -
                          n * strict_double(2.02226624879595063154e-21);
  strict_double const r2 = r * r;
  strict_double s = 1.0;
  strict_double c = 1.0;
  FT_UNROLL
  for (int k = 9; k > 0; --k) {
    double const m = 2.0 * k;
    s = strict_double(1.0) - r2 * strict_double(1.0 / (m * (m + 1.0))) * s;
    c = strict_double(1.0) - r2 * strict_double(1.0 / (m * (m - 1.0))) * c;
  }
  s = r * s;
  int const quarter = static_cast<int>(static_cast<long long>(turns) & 3);
  strict_double const sine = quarter % 2 == 0 ? s : c;
  strict_double const cosine = quarter % 2 == 0 ? c : s;
  return {quarter < 2 ? sine : -sine, quarter == 0 || quarter == 3 ? cosine : -cosine};
}

/// The tangent of an angle, with an error below 4 units in the last place. Equal bits on every
/// executor for angles below 1e5.
FT_HOST_DEVICE inline strict_double strict_tan(strict_double v) {
  if (!(::fabs(v.value) < 1e5)) { return ::tan(v.value); }
  sine_and_cosine const at = strict_sin_cos(v);
  return at.sine / at.cosine;
}

}  // namespace detail

/// Functions for camera models and solvers, on any scalar: float, double, strict of either.
///
/// sqrt and reciprocal are correctly rounded. sin, cos, tan, exp, log and atan2 are computed in
/// double. For float scalars the result is rounded once, which hides the last bits where libraries
/// differ: host and device agree. For double scalars those last bits stay, but for sin, cos, tan
/// and atan2 of strict_double, which are ft's own.
namespace scalar {

template <typename S>
FT_HOST_DEVICE S sqrt(S v) {
  return S(detail::square_root(to_plain(v)));
}
/// The same bits as 1 / v, in fewer instructions on a device.
template <typename S>
FT_HOST_DEVICE S reciprocal(S v) {
  return S(detail::reciprocal(to_plain(v)));
}
template <typename S>
FT_HOST_DEVICE S abs(S v) {
  return v < S(0) ? -v : v;
}
template <typename S>
FT_HOST_DEVICE S sin(S v) {
  if constexpr (std::is_same<S, strict_double>::value) {
    return detail::strict_sin_cos(v).sine;
  } else {
    return detail::narrowed<S>(::sin(detail::widened(v)));
  }
}
template <typename S>
FT_HOST_DEVICE S cos(S v) {
  if constexpr (std::is_same<S, strict_double>::value) {
    return detail::strict_sin_cos(v).cosine;
  } else {
    return detail::narrowed<S>(::cos(detail::widened(v)));
  }
}
template <typename S>
FT_HOST_DEVICE S tan(S v) {
  if constexpr (std::is_same<S, strict_double>::value) {
    return detail::strict_tan(v);
  } else {
    return detail::narrowed<S>(::tan(detail::widened(v)));
  }
}
template <typename S>
FT_HOST_DEVICE S exp(S v) {
  return detail::narrowed<S>(::exp(detail::widened(v)));
}
/// The natural logarithm.
template <typename S>
FT_HOST_DEVICE S log(S v) {
  return detail::narrowed<S>(::log(detail::widened(v)));
}
template <typename S>
FT_HOST_DEVICE S atan2(S y, S x) {
  if constexpr (std::is_same<S, strict_double>::value) {
    return detail::strict_atan2(y, x);
  } else {
    return detail::narrowed<S>(::atan2(detail::widened(y), detail::widened(x)));
  }
}
/// atan2 for y > 0. Float scalars are computed in float, with an error below 4e-7. Source:
/// Abramowitz and Stegun, "Handbook of mathematical functions", 4.4.49.
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
/// False for NaN and infinity.
template <typename S>
FT_HOST_DEVICE bool is_finite(S v) {
  using P = plain_scalar_t<S>;
  P const p = to_plain(v);
  return p - p == P(0);
}

}  // namespace scalar

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

/// Nearest integer, halves away from zero (std::round); 0 for NaN and out of range.
FT_HOST_DEVICE inline int round_away(float v) {
  if (!(::fabsf(v) < 2147483648.0f)) { return 0; }
  int const t = static_cast<int>(v);
  float const rest = v - static_cast<float>(t);  // exact
  return t + static_cast<int>(rest >= 0.5f) - static_cast<int>(rest <= -0.5f);
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

namespace detail {

/// a - b, or the nearest number that there is: of times in ns, which may be any.
FT_HOST_DEVICE constexpr std::int64_t saturated_difference(std::int64_t a, std::int64_t b) {
  constexpr std::int64_t most = INT64_MAX;
  constexpr std::int64_t least = INT64_MIN;
  if (b < 0) { return a > most + b ? most : a - b; }
  return a < least + b ? least : a - b;
}

/// Division by a number known at run time, as a multiplication. Exact while i * n is below 2^31.
struct small_divider {
  std::uint32_t factor;
  small_divider() = default;
  FT_HOST_DEVICE explicit small_divider(int n)
      : factor(0x80000000u / static_cast<unsigned>(n) + 1) {}
  FT_HOST_DEVICE int operator()(int i) const {
    return static_cast<int>(static_cast<std::uint64_t>(static_cast<unsigned>(i)) * factor >> 31);
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
