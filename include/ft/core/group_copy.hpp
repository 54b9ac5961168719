// SPDX-License-Identifier: Apache-2.0
/// @file Copies of objects by groups.
#pragma once

#include <cstdint>
#include <type_traits>

#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {

/// Copies an object, a word each by the threads of a group. The copy is complete after the group's
/// next sync().
/// @tparam T trivially copyable, of whole words
template <typename T, typename Group>
FT_HOST_DEVICE void copy_object(Group g, T& to, T const& from) {
  static_assert(std::is_trivially_copyable<T>::value, "copied by words");
  static_assert(sizeof(T) % sizeof(std::uint32_t) == 0 && alignof(T) % alignof(std::uint32_t) == 0,
                "of whole words");
#if defined(__CUDA_ARCH__)
  using word = std::uint32_t __attribute__((__may_alias__));
  auto const* const words = reinterpret_cast<word const*>(&from);
  auto* const copies = reinterpret_cast<word*>(&to);
  for (int i = g.rank(); i < static_cast<int>(sizeof(T) / sizeof(word)); i += g.size()) {
    copies[i] = words[i];
  }
#else
  if (g.rank() == 0) { to = from; }
#endif
}

}  // namespace FT_ABI
}  // namespace ft
