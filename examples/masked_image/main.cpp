// SPDX-License-Identifier: Apache-2.0
// Keeps keypoints out of a part of the image. The mask is small, like the output of a segmentation
// network, and is stretched over the image. Every image may have a different mask.
//   masked_image [OUT.png]
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <string>
#include <vector>

#include "examples/common/picture.hpp"
#include "examples/common/run.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/pipelines/orb_extractor.hpp"

/// 0 in the lower fifth, where a robot sees itself, and in a box; 255 elsewhere.
demo::grey_image make_mask(int width, int height) {
  demo::grey_image mask{width, height, {}};
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      bool const robot = 5 * y >= 4 * height;
      bool const box = 4 * x >= width && 2 * x < width && 4 * y >= height && 2 * y < height;
      mask.pixels.push_back(static_cast<std::uint8_t>(robot || box ? 0 : 255));
    }
  }
  return mask;
}

template <typename Exec>
int extract(Exec const& exec, demo::grey_image const& image, std::string const& path) {
  demo::grey_image const mask = make_mask(94, 60);

  // The size of the masks is a parameter, so that their memory is allocated at construction.
  ft::orb_params params = demo::params_for(image);
  params.mask_width = mask.width;
  params.mask_height = mask.height;
  ft::orb_extractor<Exec> orb(exec, params, 1);
  orb.set_mask(exec, 0, demo::view(mask));  // until the next mask
  orb.upload(exec, 0, demo::view(image));
  orb.extract(exec);
  auto const found = ft::download(exec, orb.keypoints());

  // The mask at the size of the image, to draw and to check.
  std::vector<std::uint8_t> allowed;
  for (int y = 0; y < image.height; ++y) {
    for (int x = 0; x < image.width; ++x) {
      allowed.push_back(mask.pixels[static_cast<std::size_t>(
          y * mask.height / image.height * mask.width + x * mask.width / image.width)]);
    }
  }
  demo::picture picture(image);
  picture.shade(allowed, {200, 0, 0});
  int outside = 0;
  for (int i = 0; i < *found.view().count; ++i) {
    float const x = found.view().x(i);
    float const y = found.view().y(i);
    picture.disc(x, y, 2, {0, 255, 0});
    // A keypoint of a coarse level covers as many pixels as its scale: only those of the finest
    // level are exact.
    if (found.view().octave(i) == 0) {
      outside += static_cast<int>(
          allowed[static_cast<std::size_t>(y) * static_cast<std::size_t>(image.width) +
                  static_cast<std::size_t>(x)] == 0);
    }
  }
  picture.write_png(path);
  std::printf("%d keypoints, %d of the finest level where none should be, in %s\n",
              *found.view().count, outside, path.c_str());
  return demo::verdict(*found.view().count > 500 && outside == 0);
}

int main(int argc, char** argv) {
  return demo::run([&](auto const& exec) {
    return extract(exec, demo::scene(100).render(60).left, argc > 1 ? argv[1] : "masked.png");
  });
}
