// SPDX-License-Identifier: Apache-2.0
/// @file Keypoints with their descriptors, structure of arrays; one batch entry per image.
#pragma once

#include <cstdint>
#include <type_traits>

#include "ft/containers/soa.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/descriptors/binary_descriptor.hpp"
#include "ft/descriptors/descriptor_model.hpp"

namespace ft {
inline namespace FT_ABI {

/// What keypoints and map points have in this unit. ORB's 256 bits; bit i of byte j is test 8j+i.
/// Or, for keypoints of the caller, a descriptor model of any kind, for all headers of ft in a
/// unit:
///
///     #define FT_DESCRIPTOR akaze  // the first line, or an option of the compiler
///     #include "ft/descriptors/binary_descriptor.hpp"
///     struct akaze : ft::binary_descriptor<488> {
///       static constexpr char const* name = "akaze";
///     };
///     #include "ft/pipelines/odometry.hpp"
///
/// Units with other descriptors may be in one program.
#if defined(FT_DESCRIPTOR) && defined(FT_WITHOUT_DESCRIPTOR)
#error "FT_DESCRIPTOR is defined after a header of ft: define it before the first one"
#endif
#if defined(FT_DESCRIPTOR)
using descriptor = ::FT_DESCRIPTOR;
static_assert(assert_descriptor_model<descriptor>::value, "FT_DESCRIPTOR keeps the contract");
#else
using descriptor = binary_descriptor<256>;
#endif

/// Number of differing bits, 0..256.
FT_HOST_DEVICE inline int hamming(binary_descriptor<256> const& a,
                                  binary_descriptor<256> const& b) {
#if defined(__CUDA_ARCH__)
  int distance = 0;
  FT_UNROLL
  for (int i = 0; i < 8; ++i) { distance += popcount(a.words[i] ^ b.words[i]); }
  return distance;
#else
  return detail::differing_bits(a.words, b.words) +
         detail::differing_bits(a.words + 4, b.words + 4);
#endif
}

namespace field {
FT_FIELD(x, float);             ///< column in the input image, pixels
FT_FIELD(y, float);             ///< row in the input image, pixels
FT_FIELD(angle, float);         ///< degrees, [0, 360)
FT_FIELD(response, float);      ///< corner score
FT_FIELD(octave, int);          ///< pyramid level
FT_FIELD(orb, ft::descriptor);  ///< descriptor, ORB's or another
}  // namespace field

using keypoints_view =
    soa_view<field::x, field::y, field::angle, field::response, field::octave, field::orb>;
template <memory_space Space>
using keypoints =
    soa<Space, field::x, field::y, field::angle, field::response, field::octave, field::orb>;

// The two nearest of many descriptors.

namespace detail {

/// The nearest candidate so far, the lowest of equals, and the distance of the second nearest.
struct two_nearest {
  static constexpr int none = 1 << 16;  ///< above any distance
  int first = none;
  int index = 0x7fffffff;
  int second = none;

  /// @param at must exceed those of earlier calls
  FT_HOST_DEVICE void add(int distance, int at) {
    second = min_of(second, max_of(first, distance));
    index = distance < first ? at : index;
    first = min_of(first, distance);
  }
  /// Merges all threads' candidates; the result is in every thread.
  template <typename Group>
  FT_HOST_DEVICE two_nearest merged(Group g) const {
    two_nearest all;
    all.first = g.reduce(first, min_op{});
    all.index = g.reduce(first == all.first ? index : 0x7fffffff, min_op{});
    all.second = g.reduce(index == all.index ? second : first, min_op{});
    return all;
  }
};

/// Whether ft finds keypoints with such descriptors in images. Otherwise the caller gives them.
inline constexpr bool describes_images = std::is_same<descriptor, binary_descriptor<256>>::value;

using descriptor_scale = search_scale<descriptor>;

/// Distance of two descriptors, 0 to search_scale::most: of ORB hamming().
template <typename D>
FT_HOST_DEVICE FT_INLINE int search_distance(D const& a, D const& b) {
  if constexpr (std::is_same<D, binary_descriptor<256>>::value) {
    return hamming(a, b);
  } else {
    return search_scale<D>::of(D::distance(a, b));
  }
}
/// The same for loops that do little else.
template <typename D>
FT_HOST_DEVICE FT_INLINE int search_distance_by_adders(D const& a, D const& b) {
#if defined(__CUDA_ARCH__)
  if constexpr (std::is_same<D, binary_descriptor<256>>::value) {
    std::uint32_t d[8];
    FT_UNROLL
    for (int i = 0; i < 8; ++i) { d[i] = a.words[i] ^ b.words[i]; }
    return ones_by_adders(d);
  }
#endif
  return search_distance(a, b);
}

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
