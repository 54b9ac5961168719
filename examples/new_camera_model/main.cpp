// SPDX-License-Identifier: Apache-2.0
// Renders a pair of images of a textured wall and its surroundings as two stereographic cameras see
// them, extracts keypoints, matches them, and compares the points with the scene. Runs on a GPU if
// compiled as CUDA and a device is found, else on the host.
#include <ft/cameras/stereo_rig.hpp>
#include <ft/pipelines/orb_extractor.hpp>
#include <ft/pipelines/stereo_matcher.hpp>
#include <ft/version.hpp>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <vector>

#include "stereographic.hpp"

using fisheye_pair = ft::stereo_rig<stereographic<float>, stereographic<float>>;
using direction = ft::vec3<float>;

constexpr int width = 640;
constexpr int height = 640;

/// The inside of a ball of radius 2.5 m around (0, 0, 1): distance along a ray of length 1 from
/// `from`.
float distance(direction from, direction ray) {
  direction const c{from.x, from.y, from.z - 1};
  float const along = ft::dot(c, ray);
  return std::sqrt(along * along - ft::dot(c, c) + 6.25f) - along;
}

/// Grey blocks of 40 cm and of 13 cm in space.
std::uint8_t grey(direction p) {
  auto const block = [&](float size) {
    unsigned h = 2166136261u;
    for (float const v : {p.x, p.y, p.z}) {
      h = (h ^ static_cast<unsigned>(static_cast<int>(std::floor(v / size)))) * 16777619u;
    }
    return (h ^ h >> 15) % 97u;
  };
  return static_cast<std::uint8_t>(30 + block(0.4f) + block(0.13f));
}

/// @param T_lc the camera's frame to the left camera's
std::vector<std::uint8_t> render(stereographic<float> const& camera, ft::pose const& T_lc) {
  std::vector<std::uint8_t> image;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      auto const r = camera.unproject({static_cast<float>(x), static_cast<float>(y)});
      direction const d = T_lc.R * r.direction;
      float const t = distance(T_lc.t, d);
      image.push_back(grey({T_lc.t.x + t * d.x, T_lc.t.y + t * d.y, T_lc.t.z + t * d.z}));
    }
  }
  return image;
}

struct keypoint_depth {
  float x, y, depth;
};

template <typename Exec>
std::vector<keypoint_depth> depths(Exec const& exec, fisheye_pair const& cameras,
                                   ft::gray_view left, ft::gray_view right) {
  ft::orb_params params;
  params.width = width;
  params.height = height;
  // The columns of each image that both cameras see: here all of them.
  ft::stereo_overlap const whole{0, width};
  ft::orb_extractor<Exec> orb(exec, params, 2, {whole, whole});
  ft::stereo_matcher<Exec, fisheye_pair> stereo(cameras, orb);
  orb.upload(exec, 0, left);
  orb.upload(exec, 1, right);
  orb.extract(exec);
  stereo.match(exec, orb);

  ft::keypoints<ft::staging_space<Exec>> const keypoints(orb.capacity(), 2);
  std::vector<float> depth(static_cast<std::size_t>(orb.capacity()));
  ft::copy(exec, keypoints.view(), orb.keypoints());
  ft::copy(exec, depth.data(), stereo.depth(), depth.size());
  exec.wait();
  std::vector<keypoint_depth> found;
  for (int i = 0; i < keypoints.view().count[0]; ++i) {
    found.push_back(
        {keypoints.view().x(i), keypoints.view().y(i), depth[static_cast<std::size_t>(i)]});
  }
  return found;
}

int main() {
  stereographic<float> const camera{134.1f, 134.3f, 319.2f, 320.9f};
  // The right camera is 0.4 m to the right and looks 2 degrees to the left.
  float const c = std::cos(0.035f);
  float const s = std::sin(0.035f);
  ft::mat3<float> const R{{c, 0, s, 0, 1, 0, -s, 0, c}};
  fisheye_pair const cameras{camera, camera, {R, -(R * direction{0.4f, 0, 0})}};
  auto const left = render(camera, ft::pose::identity());
  auto const right = render(camera, cameras.T_rl.inverse());
  ft::gray_view const l{left.data(), width, height, width};
  ft::gray_view const r{right.data(), width, height, width};

  char const* where = "host";
  std::vector<keypoint_depth> found;
#if defined(__CUDACC__)
  cudaStream_t stream = nullptr;
  if (cudaStreamCreate(&stream) == cudaSuccess) {
    where = "GPU";
    found = depths(ft::cuda_exec(stream), cameras, l, r);
    cudaStreamDestroy(stream);
  } else {
    found = depths(ft::host_exec(), cameras, l, r);
  }
#else
  found = depths(ft::host_exec(), cameras, l, r);
#endif

  std::vector<float> errors;
  for (auto const& k : found) {
    if (!(k.depth > 0)) { continue; }
    auto const ray = camera.unproject({k.x, k.y}).direction;
    float const truth = distance({0, 0, 0}, ray) * ray.z;
    errors.push_back(std::abs(k.depth - truth) / truth);
  }
  std::sort(errors.begin(), errors.end());
  float const median = errors.empty() ? 1.0f : errors[errors.size() / 2];
  std::printf("ft %d.%d.%d, %s: %zu keypoints, %zu with depth, median error %.1f %%\n",
              ft::version_major, ft::version_minor, ft::version_patch, where, found.size(),
              errors.size(), 100 * static_cast<double>(median));
  return errors.size() >= 100 && median < 0.05f ? 0 : 1;
}
