// SPDX-License-Identifier: Apache-2.0
/// @file Grey images of golden cases, behind plain types.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace test {

struct grey_pixels {
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> pixels;  ///< row by row
};

/// Reads a PNG, a JPEG, or an array in an .npy file. @throws std::runtime_error naming the file
grey_pixels read_grey(std::string const& path);

}  // namespace test
