// SPDX-License-Identifier: Apache-2.0
/// @file The covariance of a pose from its information matrix.
#pragma once

#include <algorithm>
#include <limits>

#include "ft/core/config.hpp"
#include "ft/math/positive_definite.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Writes infinite variances without covariances.
inline void unknown_covariance(double (&out)[36]) {
  for (int i = 0; i < 36; ++i) {
    out[i] = i % 7 == 0 ? std::numeric_limits<double>::infinity() : 0.0;
  }
}

/// The variance of unit weight: how large the squared errors of inliers are beside those that the
/// information matrix assumes, one pixel of an octave. That assumption counts like so many numbers.
inline double variance_of(frame_facts const& facts) {
  constexpr double assumed = 20;
  double const misfit = static_cast<double>(facts.misfit) / frame_facts::misfit_one;
  return (misfit + assumed) / (std::max(facts.rows - 6, 0) + assumed);
}

/// Inverts an information matrix. The covariance of one that is not positive definite is unknown.
/// @param upper its upper triangle by rows @param variance of unit weight
inline void invert_information(float const* upper, double variance, double (&out)[36]) {
  if (!invert_6(upper, out)) {
    unknown_covariance(out);
    return;
  }
  for (double& v : out) { v *= variance; }
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
