// SPDX-License-Identifier: Apache-2.0
/// @file Rotations as messages have them: unit quaternions x, y, z, w.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace ft_ros2 {

inline std::array<double, 9> matrix_of(std::array<double, 4> const& q) {
  auto const [x, y, z, w] = q;
  return {1 - 2 * (y * y + z * z), 2 * (x * y - z * w),     2 * (x * z + y * w),
          2 * (x * y + z * w),     1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
          2 * (x * z - y * w),     2 * (y * z + x * w),     1 - 2 * (x * x + y * y)};
}

/// Shepperd, "Quaternion from rotation matrix", 1978: the largest of the four first.
inline std::array<double, 4> quaternion_of(std::array<double, 9> const& R) {
  double const trace = R[0] + R[4] + R[8];
  std::array<double, 4> const size{R[0], R[4], R[8], trace};
  auto const i =
      static_cast<std::size_t>(std::max_element(size.begin(), size.end()) - size.begin());
  std::array<double, 4> q{R[7] - R[5], R[2] - R[6], R[3] - R[1], 1 + trace};
  if (i < 3) {
    std::size_t const j = (i + 1) % 3;
    std::size_t const k = (i + 2) % 3;
    q[3] = R[3 * k + j] - R[3 * j + k];
    q[i] = 1 + 2 * R[4 * i] - trace;
    q[j] = R[3 * i + j] + R[3 * j + i];
    q[k] = R[3 * i + k] + R[3 * k + i];
  }
  double const length = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  for (double& v : q) { v /= length; }
  return q;
}

}  // namespace ft_ros2
