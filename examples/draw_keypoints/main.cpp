// SPDX-License-Identifier: Apache-2.0
// Extracts the ORB keypoints of an image and draws them: circles as large as the described patch,
// with a line in the direction of the orientation.
//   draw_keypoints [IMAGE.pgm [OUT.png]]   8 bits; without IMAGE, one of a generated room
#include <cmath>
#include <cstdio>
#include <string>

#include "examples/common/picture.hpp"
#include "examples/common/run.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/pipelines/orb_extractor.hpp"

template <typename Exec>
int draw(Exec const& exec, demo::grey_image const& image, std::string const& path) {
  // All memory is allocated here, for one image of this size; extract() allocates none.
  ft::orb_params params = demo::params_for(image);
  params.features = 500;
  ft::orb_extractor<Exec> orb(exec, params, 1);

  // On a GPU these calls are enqueued on the executor's stream; download() waits.
  orb.upload(exec, 0, demo::view(image));
  orb.extract(exec);
  auto const found = ft::download(exec, orb.keypoints());

  demo::picture picture(image);
  auto const keypoints = found.view();
  int per_level[ft::max_levels] = {};
  for (int i = 0; i < *keypoints.count; ++i) {
    float const x = keypoints.x(i);
    float const y = keypoints.y(i);
    int const octave = keypoints.octave(i);
    float const angle = keypoints.angle(i) * 3.14159265f / 180;
    float const radius = 0.25f * static_cast<float>(orb.geometry().patch_size(octave));
    demo::colour const c = demo::rainbow(static_cast<float>(octave) / 7);
    picture.circle(x, y, radius, c);
    picture.line(x, y, x + radius * std::cos(angle), y + radius * std::sin(angle), c);
    ++per_level[octave];
  }
  picture.write_png(path);

  std::printf("%d keypoints in %s:", *keypoints.count, path.c_str());
  for (int l = 0; l < params.levels; ++l) { std::printf(" %d", per_level[l]); }
  std::printf(" per level\n");
  return *keypoints.count;
}

int main(int argc, char** argv) {
  return demo::run([&](auto const& exec) {
    bool const given = argc > 1;
    std::string const path = argc > 2 ? argv[2] : "keypoints.png";
    auto const image = given ? demo::read_pgm(argv[1]) : demo::scene(100).render(60).left;
    int const found = draw(exec, image, path);
    return demo::verdict(given || (found >= 500 && found < 550));
  });
}
