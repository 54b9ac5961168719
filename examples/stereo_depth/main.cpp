// SPDX-License-Identifier: Apache-2.0
// Matches the keypoints of a rectified stereo pair and draws them in the colour of their depth.
// The room is generated, so the depths can be compared with the truth.
//   stereo_depth [OUT.png]
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "examples/common/picture.hpp"
#include "examples/common/run.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "ft/pipelines/stereo_matcher.hpp"

constexpr int frame = 60;

template <typename Exec>
int match(Exec const& exec, demo::scene const& scene, std::string const& path) {
  auto const images = scene.render(frame);
  auto const [fx, fy, cx, cy] = scene.intrinsics();
  auto const rig = ft::rectified_rig::make({fx, fy, cx, cy}, scene.baseline());

  // A batch of two images: 0 is the left one of the pair, 1 the right one. The same launches
  // extract both.
  ft::orb_extractor<Exec> orb(exec, demo::params_for(images.left), 2);
  ft::stereo_matcher<Exec> stereo(rig, orb);
  orb.upload(exec, 0, demo::view(images.left));
  orb.upload(exec, 1, demo::view(images.right));
  orb.extract(exec);
  stereo.match(exec, orb);

  auto const keypoints = ft::download(exec, orb.keypoints());
  auto const matches = ft::download(exec, stereo.matches());

  demo::picture picture(images.left);
  std::vector<float> errors;
  auto const left = keypoints.view().slice(0);
  for (int i = 0; i < *left.count; ++i) {
    float const depth = matches.view().depth(i);
    if (!(depth > 0)) { continue; }  // -1 = no match
    float const x = left.x(i);
    float const y = left.y(i);
    picture.disc(x, y, 4, demo::by_depth(depth, 2, 10));
    float const truth =
        static_cast<float>(scene.depth(frame, static_cast<double>(x), static_cast<double>(y)));
    errors.push_back(std::abs(depth - truth) / truth);
  }
  picture.write_png(path);
  if (errors.empty()) { return demo::verdict(false); }

  std::sort(errors.begin(), errors.end());
  float const median = errors[errors.size() / 2];
  std::printf("%zu of %d keypoints with depth in %s, median error %.1f %%\n", errors.size(),
              *left.count, path.c_str(), 100 * static_cast<double>(median));
  return demo::verdict(errors.size() > 300 && median < 0.03f);
}

int main(int argc, char** argv) {
  return demo::run([&](auto const& exec) {
    return match(exec, demo::scene(100), argc > 1 ? argv[1] : "stereo_depth.png");
  });
}
