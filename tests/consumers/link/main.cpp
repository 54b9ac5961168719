// SPDX-License-Identifier: Apache-2.0
#include <cstdio>

#include "tests/consumers/link/units.hpp"

int main() {
  int const first = first_unit();
  int const second = second_unit();
  if (first != link_sum || second != link_sum) {
    std::fprintf(stderr, "units say %d and %d, expected %d\n", first, second, link_sum);
    return 1;
  }
  return 0;
}
