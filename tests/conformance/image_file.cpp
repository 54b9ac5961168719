// SPDX-License-Identifier: Apache-2.0
#include "tests/conformance/image_file.hpp"

#include <filesystem>
#include <utility>

#include "examples/sequence/image_io.hpp"
#include "tests/support/npy.hpp"

namespace test {

grey_pixels read_grey(std::string const& path) {
  if (std::filesystem::path(path).extension() == ".npy") {
    auto array = read_npy<std::uint8_t>(path);
    return {array.cols(), array.rows(), std::move(array.data)};
  }
  auto image = seq::read_image(path);
  return {image.width, image.height, std::move(image.pixels)};
}

}  // namespace test
