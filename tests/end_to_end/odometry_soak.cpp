// SPDX-License-Identifier: Apache-2.0
// An odometry for many frames, with a small map: a camera goes to and fro before a wall, with
// dropped, doubled, black and noisy frames, and begins anew now and then. Poses must be finite,
// what is bounded must stay so, memory must stay as it was, and a camera that begins anew must give
// the bits that it gave before.
//
//     odometry_soak [FRAMES]
//
// On a GPU where nvcc compiles it (-x cu), else on the host's threads. Nothing but ft is needed.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include "ft/pipelines/odometry.hpp"
#include "tests/end_to_end/soak_scene.hpp"
#include "tests/support/process_memory.hpp"

namespace odometry_soak {

using namespace soak_scene;

constexpr int lap = 240;          ///< frames to and fro
constexpr int life = 2000;        ///< frames until the camera begins anew
constexpr int undisturbed = 100;  ///< frames of these without a mishap, at first
constexpr std::int64_t period = 50'000'000;

ft::odometry_params params() {
  ft::odometry_params p;
  p.orb.width = width;
  p.orb.height = height;
  p.orb.features = 400;
  p.orb.levels = 6;
  p.map_slots = 1500;
  p.local_points = 1024;
  p.keyframes = 24;
  p.window_points = 1024;
  return p;
}

/// Metres to the right of the start.
double place(int frame) { return 1.5 * (1 - std::cos(frame * 6.283185307 / lap)); }

struct gallery {
  std::vector<image> left, right;
  image black = image(pixels);
  image noisy[2] = {noise(0), noise(1)};

  gallery() {
    for (int i = 0; i <= lap / 2; ++i) {
      left.push_back(render(place(i), 0));
      right.push_back(render(place(i) + 0.2, 0));
    }
  }
  static ft::gray_view view(image const& i) { return {i.data(), width, height, width}; }
  /// The way back shows the same images.
  ft::stereo_images at(int frame) const {
    int const f = frame % lap;
    auto const i = static_cast<std::size_t>(std::min(f, lap - f));
    return {view(left[i]), view(right[i])};
  }
};

void check(bool good, char const* what, int frame) {
  if (!good) { throw std::runtime_error(std::string(what) + " at frame " + std::to_string(frame)); }
}

void check_answer(ft::tracking const& t, ft::odometry_params const& p, int frame) {
  auto const& T = t.T_world_camera;
  check(std::isfinite(T.t.x + T.t.y + T.t.z), "a position that is not finite", frame);
  auto const RRt = T.R * T.R.transposed();
  for (int i = 0; i < 9; ++i) {
    check(std::abs(RRt.m[i] - (i % 4 == 0 ? 1 : 0)) < 1e-9, "no rotation", frame);
  }
  for (int i = 0; i < 6; ++i) { check(t.covariance[7 * i] >= 0, "a negative variance", frame); }
  check(t.map_points >= 0 && t.map_points <= p.map_slots, "too many map points", frame);
  check(t.local_points >= 0 && t.local_points <= p.local_points, "too many local points", frame);
  check(t.inliers >= 0 && t.inliers <= t.keypoints, "too many inliers", frame);
}

struct outcome {
  int tracked = 0, most_points = 0, lives = 0;
  double worst = 0;  ///< error of the undisturbed frames, metres
  test::usage growth;

  bool flat() const {
    return growth.resident <= 8 << 20 && growth.heap <= 256 << 10 && growth.device <= 2 << 20;
  }
};

template <typename Exec>
outcome run(Exec const& exec, int frames) {
  gallery const seen;
  ft::odometry<Exec> odometry(exec, rig(), params());
  outcome r;
  std::mt19937 random(7);
  std::uint64_t first_seen = 0;
  digest seen_now;
  test::usage warm;
  std::int64_t time = 0;
  int at = 0;
  int dark = 0;
  int noisy = 0;
  for (int n = 0; n < frames; ++n) {
    int const age = n % life;
    if (age == 0) {
      if (n > 0) { odometry.reset(); }
      at = dark = noisy = 0;
      time = 0;
      seen_now = {};
    }
    if (age >= undisturbed) {
      auto const k = random() % 1000;
      if (k < 50) { at += 1 + static_cast<int>(random() % 4); }  // dropped
      if (k >= 50 && k < 80) { --at; }                           // doubled
      if (k >= 80 && k < 85) { dark = 1 + static_cast<int>(random() % 20); }
      if (k >= 85 && k < 88) { noisy = 1 + static_cast<int>(random() % 8); }
    }
    ft::stereo_images images = seen.at(at++);
    if (dark > 0 && dark-- > 0) { images = {seen.view(seen.black), seen.view(seen.black)}; }
    if (noisy > 0 && noisy-- > 0) { images = {seen.view(seen.noisy[0]), seen.view(seen.noisy[1])}; }
    ft::tracking const t = odometry.track(images, time += period);
    check_answer(t, odometry.params(), n);
    r.tracked += static_cast<int>(t.state == ft::tracking_state::tracking);
    r.most_points = std::max(r.most_points, t.map_points);
    if (age < undisturbed) {
      auto const& p = t.T_world_camera.t;
      double const error = std::hypot(p.x - place(age), p.y, p.z);
      r.worst = std::max(r.worst, error);
      seen_now.add(&t.T_world_camera, 1);
    }
    if (age + 1 == undisturbed) {
      if (n < life) { first_seen = seen_now.value(); }
      check(seen_now.value() == first_seen, "other poses than in the first life", n);
      ++r.lives;
    }
    if (n % 500 == 499) {
      auto const map = odometry.download_map();
      auto const most = static_cast<std::size_t>(odometry.params().keyframes);
      check(map.keyframes.size() <= most, "too many keyframes", n);
      // A keyframe's own points come with the next frame.
      check(t.keyframe || static_cast<int>(map.points.size()) == t.map_points, "other map points",
            n);
    }
    if (n == std::min(frames / 4, 5000)) { warm = test::measure(); }
  }
  test::usage const end = test::measure();
  r.growth = {end.resident - warm.resident, end.heap - warm.heap, end.device - warm.device};
  return r;
}

template <typename Exec>
int run_and_tell(Exec const& exec, int frames) {
  outcome const r = run(exec, frames);
  std::printf("%d frames, %d tracked, %d lives with the same bits, at most %d map points\n", frames,
              r.tracked, r.lives, r.most_points);
  std::printf("largest error without mishaps: %.4f m\n", r.worst);
  std::printf("growth after the warm-up, KiB: resident %lld, heap %lld, device %lld: %s\n",
              r.growth.resident / 1024, r.growth.heap / 1024, r.growth.device / 1024,
              r.flat() ? "flat" : "MEMORY GROWS");
  bool const good = r.flat() && r.tracked > frames * 3 / 4 && r.worst < 0.05;
  return good ? EXIT_SUCCESS : EXIT_FAILURE;
}

}  // namespace odometry_soak

int main(int argc, char** argv) {
  try {
    int const frames = argc > 1 ? std::atoi(argv[1]) : 2000;
    if (frames < 200) { throw std::runtime_error("200 frames or more"); }
    return soak_scene::on_backend(
        [&](auto const& exec) { return odometry_soak::run_and_tell(exec, frames); });
  } catch (std::exception const& e) {
    std::fprintf(stderr, "odometry_soak: %s\n", e.what());
    return EXIT_FAILURE;
  }
}
