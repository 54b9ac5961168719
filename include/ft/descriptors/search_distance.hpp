// SPDX-License-Identifier: Apache-2.0
/// @file Distances of descriptors as the searches of an odometry compare them.
#pragma once

#include <type_traits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/descriptors/descriptor_model.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// A search packs a candidate into 32 bits, 9 of which are its distance: an integer from 0 to 510.
/// Integers that fit are taken as they are, so binary descriptors of up to 510 bits are compared
/// exactly. Others are counted in steps of 1 / 128 of what the rules have between `least` and
/// `near`, rounded down; what is four times as far, or no number, is 510.
/// @tparam D a descriptor model
template <typename D>
struct search_scale {
  using distance_type = descriptor_distance<D>;
  static constexpr int farthest = 510;
  static constexpr bool is_exact = std::is_same<distance_type, int>::value && D::rules.least >= 0 &&
                                   D::rules.greatest <= farthest;
  static constexpr int near = is_exact ? static_cast<int>(D::rules.near) : 128;
  /// No search distance is above.
  static constexpr int most = is_exact ? static_cast<int>(D::rules.greatest) : farthest;

  /// A limit for this descriptor. @param of_orb that of ORB, bits of 256, of which 64 are near
  FT_HOST_DEVICE static constexpr int limit(int of_orb) {
    int const scaled = near * of_orb / 64;
    int const last = is_exact ? most : farthest - 1;  // 510 may be no number
    return scaled < last ? scaled : last;
  }
  FT_HOST_DEVICE FT_INLINE static int of(distance_type d) {
    if constexpr (is_exact) {
      return d;
    } else if constexpr (std::is_same<distance_type, int>::value) {
      constexpr long long least = D::rules.least;
      constexpr long long unit = D::rules.near - least;
      static_assert(unit > 0, "near is above least");
      long long const steps = (d - least) * 128 / unit;
      return steps < farthest ? static_cast<int>(steps) : farthest;
    } else {
      constexpr float least = D::rules.least;
      static_assert(D::rules.near > least, "near is above least");
      constexpr float per_unit = 128.0f / (D::rules.near - least);
      float const steps = ((strict_float(d) - strict_float(least)) * strict_float(per_unit)).value;
      if (!(steps < static_cast<float>(farthest))) { return farthest; }  // NaN, too
      return steps > 0 ? static_cast<int>(steps) : 0;
    }
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
