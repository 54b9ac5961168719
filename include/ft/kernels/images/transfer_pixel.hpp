// SPDX-License-Identifier: Apache-2.0
/// @file Maps pixels between two cameras that differ by a rotation only.
#pragma once

#include <cmath>

#include "ft/cameras/camera_model.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The ray of a pixel of `from`, rotated by `R_to_from` and projected by `to`. Valid where both
/// models are defined and the result is finite. With cameras of strict_double all executors give
/// the same bits, except for the last bit of an arc tangent or tangent in a camera model.
template <typename From, typename To>
FT_HOST_DEVICE projection<strict_double> transfer_pixel(From const& from,
                                                        mat3<strict_double> const& R_to_from,
                                                        To const& to, vec2<strict_double> pixel) {
  auto const seen = from.unproject(pixel);
  auto const projected = to.project(R_to_from * seen.direction);
  bool const finite = scalar::is_finite(projected.pixel.x) && scalar::is_finite(projected.pixel.y);
  return {projected.pixel, seen.valid && projected.valid && finite};
}

inline mat3<strict_double> strict_rotation(mat3<double> const& R) {
  mat3<strict_double> strict;
  for (int i = 0; i < 9; ++i) { strict.m[i] = R.m[i]; }
  return strict;
}

/// @throws bad_argument unless all products of rows are those of a rotation to 1e-3, and for
///   reflections
inline void require_rotation(mat3<double> const& R) {
  for (double v : R.m) { require_finite("rotation", v); }
  mat3<double> const RRt = R * R.transposed();
  for (int i = 0; i < 9; ++i) {
    require(std::abs(RRt.m[i] - (i % 4 == 0 ? 1.0 : 0.0)) < 1e-3,
            "the matrix is not a rotation: its rows are not orthonormal");
  }
  auto const& m = R.m;
  require(m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) +
                  m[2] * (m[3] * m[7] - m[4] * m[6]) >
              0,
          "the matrix is not a rotation but a reflection");
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
