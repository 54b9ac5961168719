// SPDX-License-Identifier: Apache-2.0
/// @file The covariance of a pose from its information matrix.
#pragma once

#include <limits>

#include "ft/core/config.hpp"
#include "ft/math/positive_definite.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Writes infinite variances without covariances.
inline void unknown_covariance(double (&out)[36]) {
  for (int i = 0; i < 36; ++i) {
    out[i] = i % 7 == 0 ? std::numeric_limits<double>::infinity() : 0.0;
  }
}

/// Inverts an information matrix. The covariance of one that is not positive definite is unknown.
/// @param upper its upper triangle by rows
inline void invert_information(float const* upper, double (&out)[36]) {
  if (!invert_6(upper, out)) { unknown_covariance(out); }
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
