// SPDX-License-Identifier: Apache-2.0
/// @file The bytes of a stream that a file says it has.
#pragma once

#include <cstddef>
#include <cstring>
#include <istream>
#include <memory>
#include <utility>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

struct file_bytes {
  std::unique_ptr<char[]> data;  // a vector would write it twice
  std::size_t size = 0;
};

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

/// The next bytes of a stream: `most`, or those before its end if there are fewer. Memory grows
/// with what comes, not with what a file says. @throws std::bad_alloc
inline file_bytes read_up_to(std::istream& from, std::size_t most) {
  // One more than is left, so that the end is met without another block.
  std::size_t room = min_of(most, max_of(bytes_left(from), std::size_t{1} << 12) + 1);
  file_bytes file{std::unique_ptr<char[]>(new char[room]), 0};
  while (true) {
    from.read(file.data.get() + file.size, static_cast<std::streamsize>(room - file.size));
    file.size += static_cast<std::size_t>(from.gcount());
    if (file.size < room || room == most) { return file; }
    std::size_t const wanted = most - room < room ? most : 2 * room;
    std::unique_ptr<char[]> larger(new char[wanted]);
    std::memcpy(larger.get(), file.data.get(), file.size);
    file.data = std::move(larger);
    room = wanted;
  }
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
