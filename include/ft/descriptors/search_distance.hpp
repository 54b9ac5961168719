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
/// exactly. Others are counted in steps of 1 / 128 of `rules.near`, rounded down; below 0, as
/// products of long rows may be, counts as 0; what is four times as far, infinite or no number, is
/// 510.
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
  /// Also of rows that do not keep the rules, which may come from files.
  FT_HOST_DEVICE FT_INLINE static int of(distance_type d) {
    static_assert(D::rules.near > 0, "what is near is above 0");
    if constexpr (is_exact) {
      return d < 0 ? 0 : d < most ? d : most;
    } else if constexpr (std::is_same<distance_type, int>::value) {
      long long const steps = static_cast<long long>(d) * 128 / D::rules.near;
      return steps < 0 ? 0 : steps < farthest ? static_cast<int>(steps) : farthest;
    } else {
      if (!scalar::is_finite(strict_float(d))) { return farthest; }
      constexpr float per_unit = 128.0f / D::rules.near;
      float const steps = (strict_float(d) * strict_float(per_unit)).value;
      if (!(steps < static_cast<float>(farthest))) { return farthest; }
      return steps > 0 ? static_cast<int>(steps) : 0;
    }
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
