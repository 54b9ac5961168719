// SPDX-License-Identifier: Apache-2.0
/// @file Numbers that the parts of a generated sequence share.
#pragma once

namespace seq::generated {

constexpr double pi = 3.14159265358979323846;

inline double radians(double degrees) { return degrees * pi / 180.0; }

}  // namespace seq::generated
