// SPDX-License-Identifier: Apache-2.0
#include "units.hpp"

int second_count(unsigned char const* pixels, int width, int height) {
  return count_on_all(pixels, width, height);
}
