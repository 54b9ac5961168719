// SPDX-License-Identifier: Apache-2.0
/// @file Readable names of kernels.
#pragma once

#include <cstddef>
#include <string>

namespace bench {

/// The functor's name and the shape of a demangled kernel of ft:
///
///     void ft::v0_cuda::detail::per_block_kernel<512, ft::v0_cuda::check<3>, int>(...)
///
/// gives "check<3> (per_block)". Other names are returned unchanged.
inline std::string short_kernel_name(std::string const& demangled) {
  std::string const marker = "_kernel<";
  std::size_t const at = demangled.find(marker);
  if (at == std::string::npos) { return demangled; }
  std::size_t const shape_begin = demangled.find_last_of(": ", at);
  std::string const shape =
      demangled.substr(shape_begin == std::string::npos ? 0 : shape_begin + 1,
                       at - (shape_begin == std::string::npos ? 0 : shape_begin + 1));
  // The template's arguments at depth 1: the functor is the first, or follows a number.
  std::string op;
  int depth = 1;
  for (std::size_t i = at + marker.size(); i < demangled.size() && depth > 0; ++i) {
    char const c = demangled[i];
    if (c == '<' || c == '(') { ++depth; }
    if (c == '>' || c == ')') { --depth; }
    if (depth == 0 || (depth == 1 && c == ',')) {
      while (!op.empty() && op.front() == ' ') { op.erase(0, 1); }
      bool const number = op.find_first_not_of("0123456789()int ") == std::string::npos;
      if (!number) { break; }
      op.clear();
      continue;
    }
    op += c;
  }
  for (std::string const space : {"ft::v0_cuda::", "detail::"}) {
    for (std::size_t i = op.find(space); i != std::string::npos; i = op.find(space)) {
      op.erase(i, space.size());
    }
  }
  return op + " (" + shape + ")";
}

}  // namespace bench
