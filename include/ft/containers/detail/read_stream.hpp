// SPDX-License-Identifier: Apache-2.0
/// @file All bytes of a stream at once.
#pragma once

#include <cstddef>
#include <cstring>
#include <istream>
#include <memory>
#include <utility>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

struct file_bytes {
  std::unique_ptr<char[]> data;  // a vector would write it twice
  std::size_t size = 0;
};

inline void require_readable(std::istream const& from) {
  if (!from) { throw error("ft: the vocabulary cannot be read from this stream"); }
}

/// Bytes of a stream from where it is to its end; 0 if it cannot tell.
inline std::size_t bytes_left(std::istream& from) {
  auto const here = from.tellg();
  std::size_t left = 0;
  if (here != std::istream::pos_type(-1) && from.seekg(0, std::ios::end)) {
    auto const bytes = static_cast<std::streamoff>(from.tellg() - here);
    left = bytes > 0 ? static_cast<std::size_t>(bytes) : 0;
    from.seekg(here);
  }
  from.clear();
  return left;
}

/// The rest of a stream. @throws error if it cannot be read; std::bad_alloc
inline file_bytes read_all(std::istream& from) {
  // One more, so that the end is met without another block.
  std::size_t room = max_of(bytes_left(from), std::size_t{1} << 12) + 1;
  file_bytes file{std::unique_ptr<char[]>(new char[room]), 0};
  while (true) {
    from.read(file.data.get() + file.size, static_cast<std::streamsize>(room - file.size));
    file.size += static_cast<std::size_t>(from.gcount());
    if (file.size < room) { break; }
    std::unique_ptr<char[]> larger(new char[2 * room]);
    std::memcpy(larger.get(), file.data.get(), file.size);
    file.data = std::move(larger);
    room *= 2;
  }
  if (from.bad()) { throw error("ft: the vocabulary cannot be read from this stream"); }
  return file;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
