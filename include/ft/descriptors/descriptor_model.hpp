// SPDX-License-Identifier: Apache-2.0
/// @file The contract of a descriptor, the traits that check it, and its distances as the searches
/// of an odometry compare them.
///
/// A descriptor is a plain struct: what is stored of one keypoint, a row of an array.
///
///     struct my_descriptor {
///       static constexpr char const* name = "my_descriptor";
///       static constexpr ft::descriptor_rules<int> rules{0, 128, 32, 9, 10};
///       std::uint32_t words[4];
///
///       FT_HOST_DEVICE static int distance(my_descriptor const& a, my_descriptor const& b);
///     };
///
/// It is trivially copyable and has no default values. distance() is symmetric, smaller for what
/// is more alike, and the same on host and device: of integers, or of floats in strict arithmetic
/// (core/arithmetic.hpp). A distance that is not a number, or infinite, is no match; nor is
/// an int's largest one.
///
/// A distance that is a sum over parts of the rows may say so. Kernels then keep parts in shared
/// memory, and each is read once for many pairs; for descriptors above 64 bytes that is faster.
/// Such a model has, besides:
///
///       static constexpr int parts;            // of a row
///       static constexpr bool uses_own_sums;   // whether distance_of() reads aa and bb
///       using part = ...;                      // up to 128 bytes, without default values
///       using sum = ...;                       // likewise; sum{} is that of no parts
///       FT_HOST_DEVICE static part part_of(my_descriptor const& row, int i);
///       FT_HOST_DEVICE static void add(sum& s, part const& a, part const& b);
///       FT_HOST_DEVICE static int distance_of(sum const& ab, sum const& aa, sum const& bb);
///
/// and its distance() is ft::distance_by_parts(a, b): parts are added in ascending order.
#pragma once

#include <cstddef>
#include <cstring>
#include <type_traits>
#include <utility>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {

/// What the distances of a descriptor are like. @tparam Distance int or float
template <typename Distance>
struct descriptor_rules {
  using distance_type = Distance;
  Distance least;     ///< no distance is below
  Distance greatest;  ///< or above
  Distance near;      ///< two descriptors of one point are usually at most that far apart
  int ratio_num;      ///< a match is clear if its distance is below ratio_num / ratio_den of the
  int ratio_den;      ///< second best
};

/// The type of a descriptor's distances.
template <typename D>
using descriptor_distance = typename std::decay_t<decltype(D::rules)>::distance_type;

// ---- the contract

namespace detail {

template <typename D>
using descriptor_names = decltype(D::rules.least, D::rules.greatest, D::rules.near,
                                  D::rules.ratio_num, D::rules.ratio_den, D::name);
template <typename D>
using descriptor_comparison =
    decltype(D::distance(std::declval<D const&>(), std::declval<D const&>()));
template <typename D>
using descriptor_parts = decltype(D::parts);
template <typename D>
using descriptor_sums =
    decltype(D::uses_own_sums, D::part_of(std::declval<D const&>(), 0),
             D::add(std::declval<typename D::sum&>(), std::declval<typename D::part const&>(),
                    std::declval<typename D::part const&>()),
             D::distance_of(std::declval<typename D::sum const&>(),
                            std::declval<typename D::sum const&>(),
                            std::declval<typename D::sum const&>()));

template <template <typename> class Expression, typename D, typename = void>
inline constexpr bool descriptor_has = false;
template <template <typename> class Expression, typename D>
inline constexpr bool descriptor_has<Expression, D, std::void_t<Expression<D>>> = true;

template <typename D>
inline constexpr bool is_plain_row =
    std::is_trivially_copyable<D>::value&& std::is_trivially_default_constructible<D>::value;

/// Whether distances are ints or floats, and distance() gives what the rules are of.
template <typename D, typename = void>
inline constexpr bool has_distance = false;
template <typename D>
inline constexpr bool
    has_distance<D, std::void_t<descriptor_comparison<D>, descriptor_distance<D>>> =
        std::is_same<descriptor_comparison<D>, descriptor_distance<D>>::value &&
        (std::is_same<descriptor_comparison<D>, int>::value ||
         std::is_same<descriptor_comparison<D>, float>::value);

template <typename D, bool = descriptor_has<descriptor_sums, D>>
inline constexpr bool has_plain_parts = true;
template <typename D>
inline constexpr bool has_plain_parts<D, true> =
    is_plain_row<typename D::part>&& is_plain_row<typename D::sum> &&
    sizeof(typename D::part) <= 128 && sizeof(typename D::sum) <= 128;

/// Whether a model has all that its parts need, or no parts.
template <typename D>
inline constexpr bool has_whole_parts =
    !descriptor_has<descriptor_parts, D> || descriptor_has<descriptor_sums, D>;

}  // namespace detail

/// Whether a type satisfies the contract above.
template <typename D>
inline constexpr bool is_descriptor_model_v = detail::descriptor_has<detail::descriptor_names, D>&&
    detail::is_plain_row<D>&& detail::has_distance<D>&& detail::has_whole_parts<D>;

/// Instantiating it makes the compiler name the part of the contract that a type misses.
template <typename D>
struct assert_descriptor_model {
  static_assert(detail::descriptor_has<detail::descriptor_names, D>,
                "a descriptor needs: name, and descriptor_rules<int or float> rules");
  static_assert(detail::is_plain_row<D>,
                "a descriptor is trivially copyable and has no default values");
  static_assert(!detail::descriptor_has<detail::descriptor_names, D> || detail::has_distance<D>,
                "a descriptor needs: static Distance distance(D const&, D const&), where Distance "
                "is that of its rules, int or float");
  static_assert(detail::has_whole_parts<D>,
                "a descriptor with parts needs: part, sum, uses_own_sums, part_of(), add() and "
                "distance_of()");
  static_assert(detail::has_plain_parts<D>,
                "part and sum have at most 128 bytes each, and no default values");
  /// Always true: if the contract is not met, the assertions above are the error.
  static constexpr bool value = true;
};

/// The distance of two descriptors that have parts.
template <typename D>
FT_HOST_DEVICE descriptor_distance<D> distance_by_parts(D const& a, D const& b) {
  typename D::sum ab{}, aa{}, bb{};
  for (int i = 0; i < D::parts; ++i) {
    auto const of_a = D::part_of(a, i);
    auto const of_b = D::part_of(b, i);
    D::add(ab, of_a, of_b);
    if constexpr (D::uses_own_sums) {
      D::add(aa, of_a, of_a);
      D::add(bb, of_b, of_b);
    }
  }
  return D::distance_of(ab, aa, bb);
}

namespace detail {

/// The alignment of a row of so many bytes, for loads of 16 bytes where they fit.
constexpr std::size_t row_alignment(std::size_t bytes, std::size_t least) {
  for (std::size_t a = 16; a > least; a /= 2) {
    if (bytes % a == 0) { return a; }
  }
  return least;
}

/// The i-th of the parts that a row consists of; on a device by loads of 16 bytes where the row is
/// aligned to them.
template <typename Part>
FT_HOST_DEVICE FT_INLINE Part part_at(void const* row, int i) {
#if defined(__CUDA_ARCH__)
  return static_cast<Part const*>(row)[i];
#else
  Part p;
  std::memcpy(&p, static_cast<unsigned char const*>(row) + static_cast<std::size_t>(i) * sizeof p,
              sizeof p);
  return p;
#endif
}

/// How a kernel reads a model: by its parts.
template <typename D, bool = descriptor_has<descriptor_parts, D>>
struct row_parts {
  static constexpr int parts = D::parts;
  static constexpr bool uses_own_sums = D::uses_own_sums;
  using part = typename D::part;
  using sum = typename D::sum;

  FT_HOST_DEVICE FT_INLINE static part part_of(D const& row, int i) { return D::part_of(row, i); }
  FT_HOST_DEVICE FT_INLINE static void add(sum& s, part const& a, part const& b) {
    D::add(s, a, b);
  }
  FT_HOST_DEVICE FT_INLINE static descriptor_distance<D> distance_of(sum const& ab, sum const& aa,
                                                                     sum const& bb) {
    return D::distance_of(ab, aa, bb);
  }
};

/// A model without parts is its own part, or, above 64 bytes, stays where it is.
template <typename D>
struct row_parts<D, false> {
  static constexpr int parts = 1;
  static constexpr bool uses_own_sums = false;
  static constexpr bool is_copied = sizeof(D) <= 64;
  using part = std::conditional_t<is_copied, D, D const*>;
  using sum = descriptor_distance<D>;

  FT_HOST_DEVICE FT_INLINE static part part_of(D const& row, int) {
    if constexpr (is_copied) {
      return row;
    } else {
      return &row;
    }
  }
  FT_HOST_DEVICE FT_INLINE static void add(sum& s, part const& a, part const& b) {
    if constexpr (is_copied) {
      s = D::distance(a, b);
    } else {
      s = D::distance(*a, *b);
    }
  }
  FT_HOST_DEVICE FT_INLINE static sum distance_of(sum const& ab, sum const&, sum const&) {
    return ab;
  }
};

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
