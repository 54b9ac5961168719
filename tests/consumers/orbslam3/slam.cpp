// SPDX-License-Identifier: Apache-2.0
// What ORB-SLAM3's files have, with stand-ins for its types.
#include <cstdio>
#include <memory>

#include "ft/version.hpp"
#include "integration/orbslam3/front_end.hpp"
#include "stand_in.hpp"

struct Gpu;  // in the headers

struct Gpu : ft::orbslam3::front_end<stand_in::types> {
  using front_end::front_end;
};

int track_one_frame() {
  stand_in::matrix image;
  image.create(480, 640, 0);
  for (int i = 0; i < 640 * 480; ++i) {
    image.data[i] = static_cast<unsigned char>((i % 640 / 11 * 7919 ^ i / 640 / 9 * 104729) % 251);
  }
  stand_in::camera camera{0, {458, 457, 317, 243}};
  ft::orbslam3::extractor_parameters const features{1000, 1.2f, 8, 20, 7};
  auto const gpu = std::make_unique<Gpu>(
      [&] {
        stand_in::camera* const none = nullptr;
        stand_in::se3 const T_lr;
        return ft::orbslam3::settings_of<stand_in::types>(features, 1, image, 50.0f, &camera, none,
                                                          T_lr);
      },
      ft::orbslam3::change_detection::hooks);
  stand_in::frame frame;
  bool by_cpu = false;
  ft::orbslam3::extract(
      gpu.get(), frame, [&](int, stand_in::matrix const&) { by_cpu = true; }, image, image);
  std::printf("ft %d.%d.%d, C++ %ld, %d keypoints\n", ft::version_major, ft::version_minor,
              ft::version_patch, static_cast<long>(__cplusplus), frame.N);
  return !by_cpu && frame.N > 100 ? 0 : 1;
}
