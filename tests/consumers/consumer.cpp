// SPDX-License-Identifier: Apache-2.0
/// @file What a stranger's first program looks like. Every consumer project builds it, as C++ or as
/// CUDA.
#include <ft/ft.hpp>

#include <cstdio>

int main() {
  std::printf("ft %d.%d.%d\n", ft::version_major, ft::version_minor, ft::version_patch);
  return 0;
}
