// SPDX-License-Identifier: Apache-2.0
// Small images of any size, stride and content through extractor, stereo and tracker, with any
// parameters: refused with bad_argument, or worked through with results that are sound.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <iterator>
#include <vector>

#include "ft/pipelines/frame_tracker.hpp"
#include "tests/fuzz/input.hpp"

namespace {

using extractor = ft::orb_extractor<ft::host_exec>;
using tracker = ft::frame_tracker<ft::host_exec>;

/// One thread: the pool's scheduling is not what is looked at here.
ft::host_exec const& exec() {
  static ft::host_exec const one(1);
  return one;
}

ft::orb_params any_params(fuzz::input& in) {
  ft::orb_params p;
  p.width = in.within(-1, 100);
  p.height = in.within(-1, 80);
  p.features = in.within(0, 15) > 0 ? in.within(0, 600) : in.bits<int>() % 200000;
  p.levels = in.within(0, 17);
  p.scale_factor = in.number(1.0f, 2.1f);
  p.ini_threshold = in.within(-1, 256);
  p.min_threshold = in.within(-1, p.ini_threshold + 1);
  if (in.flag()) {
    p.mask_width = in.within(-1, 40);
    p.mask_height = in.within(-1, 40);
  }
  return p;
}

/// Rows of `stride` bytes; what the input does not fill repeats it, in blocks that have corners.
std::vector<std::uint8_t> any_pixels(fuzz::input& in, int stride, int height) {
  std::vector<std::uint8_t> pixels(static_cast<std::size_t>(stride) *
                                   static_cast<std::size_t>(height));
  std::uint8_t const block = static_cast<std::uint8_t>(1 + in.bits<std::uint8_t>() % 12);
  std::uint8_t const seed = in.bits<std::uint8_t>();
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    std::size_t const x = i % static_cast<std::size_t>(stride) / block;
    std::size_t const y = i / static_cast<std::size_t>(stride) / block;
    std::size_t const k = x * 31 + y * 17 + seed;
    pixels[i] = in.left() > 0 ? in.data()[k * k % in.left()] : static_cast<std::uint8_t>(k * k);
  }
  return pixels;
}

void check_keypoints(extractor const& orb, int image) {
  auto const kp = orb.keypoints().slice(image);
  auto const& p = orb.params();
  fuzz::require(*kp.count >= 0 && *kp.count <= kp.capacity, "counts are at most the capacity");
  fuzz::require(orb.mono_count()[image] >= 0 && orb.mono_count()[image] <= *kp.count,
                "keypoints outside an overlap are part of all");
  for (int i = 0; i < *kp.count; ++i) {
    float const x = kp.x(i);
    float const y = kp.y(i);
    float const angle = kp.angle(i);
    int const octave = kp.octave(i);
    fuzz::require(
        x >= 0 && x < static_cast<float>(p.width) && y >= 0 && y < static_cast<float>(p.height),
        "keypoints lie in the image");
    fuzz::require(angle >= 0 && angle <= 360, "angles are degrees");
    fuzz::require(octave >= 0 && octave < p.levels, "octaves are levels");
  }
}

void stereo(fuzz::input& in, extractor& orb) {
  ft::pinhole<float> const camera{in.number(1, 300), in.number(1, 300), in.number(0, 160),
                                  in.number(0, 120)};
  float const baseline = in.number(0, 1);
  fuzz::accepted<ft::bad_argument>([&] {
    auto const rig = ft::rectified_rig::make(camera, baseline);
    ft::stereo_matcher<ft::host_exec> matcher(rig, orb);
    matcher.match(exec(), orb);
    auto const found = matcher.matches();
    for (int i = 0; i < *orb.keypoints().count; ++i) {
      float const depth = found.depth(i);
      fuzz::require(depth == -1 || depth > 0, "a depth is positive or -1");
    }
  });
}

ft::pose any_pose(fuzz::input& in) {
  ft::pose T = ft::pose::identity();
  if (in.flag()) {
    for (float& v : T.R.m) { v = in.number(-1, 1); }
  }
  T.t = {in.number(-1, 1), in.number(-1, 1), in.number(-1, 1)};
  return T;
}

bool is_finite(ft::pose const& T) {
  return std::all_of(std::begin(T.R.m), std::end(T.R.m),
                     [](float v) { return std::isfinite(v); }) &&
         std::isfinite(T.t.x) && std::isfinite(T.t.y) && std::isfinite(T.t.z);
}

ft::point_update any_point(fuzz::input& in, int slot) {
  ft::point_update u{};
  u.slot = slot;
  u.observations = in.within(-1, 3);
  u.position = {in.number(-2, 2), in.number(-2, 2), in.number(-1, 8)};
  u.normal = {in.number(-1, 1), in.number(-1, 1), in.number(-1, 1)};
  u.min_distance = in.number(0, 4);
  u.max_distance = in.number(0, 20);
  u.orb = in.bits<ft::descriptor>();
  return u;
}

void track(fuzz::input& in, ft::orb_params const& orb) {
  ft::tracker_params p;
  p.orb = orb;
  p.map_slots = in.within(1, 60);
  p.local_points = in.within(1, 60);
  p.updates = in.within(1, 60);
  p.window_radius = in.number(0.1f, 40);
  p.enough_matches = in.within(-1, 40);
  auto const rig = ft::rectified_rig::make({90, 90, 80, 60}, 0.1f);
  fuzz::accepted<ft::bad_argument>([&] {
    tracker t(exec(), rig, p);
    for (int frame = 0; frame < 2; ++frame) {
      for (int camera = 0; camera < 2; ++camera) {
        auto const pixels = any_pixels(in, orb.width, orb.height);
        t.set_image(0, camera, {pixels.data(), orb.width, orb.height, orb.width});
      }
      std::vector<ft::point_update> points;
      for (int slot = in.within(0, 3); slot < p.map_slots && slot < p.updates; slot += 2) {
        points.push_back(any_point(in, slot));
      }
      fuzz::accepted<ft::bad_argument>(
          [&] { t.update_map(exec(), 0, points.data(), static_cast<int>(points.size())); });
      ft::pose const predicted = any_pose(in);
      ft::pose const last = any_pose(in);
      std::vector<int> holders;
      for (int k = 0; k < t.capacity(); ++k) { holders.push_back(k % (p.map_slots + 2) - 1); }
      int const local = in.within(-1, p.local_points + 1);
      std::vector<int> slots(static_cast<std::size_t>(p.local_points + 1));
      for (int i = 0; i < p.local_points; ++i) {
        slots[static_cast<std::size_t>(i)] = in.within(-2, 62);
      }
      bool const replaced =
          fuzz::accepted<ft::bad_argument>([&] { t.set_last(exec(), 0, last, holders); });
      fuzz::require(replaced == is_finite(last),
                    "a last pose is refused where it is not finite, and only there");
      bool const queued = fuzz::accepted<ft::bad_argument>([&] {
        t.track(exec(), {predicted, {slots.data(), local}});
      });
      fuzz::require(
          queued == (local >= 0 && local <= t.params().local_points && is_finite(predicted)),
          "a frame is refused where the local map does not fit or a pose is not finite, and only "
          "there");
      if (!queued) { continue; }
      auto const& r = t.result();
      fuzz::require(r.keypoints[0] >= 0 && r.keypoints[0] <= t.capacity(), "counts fit");
      fuzz::require(r.inliers[0] >= 0 && r.inliers[0] <= r.keypoints[0], "inliers are keypoints");
      for (int k = 0; k < r.capacity; ++k) {
        fuzz::require(r.holder[k] >= -1 && r.holder[k] < p.map_slots, "holders are map slots");
      }
    }
  });
}

void extract(fuzz::input& in, ft::orb_params const& p) {
  fuzz::accepted<ft::bad_argument>([&] {
    std::vector<ft::stereo_overlap> overlaps;
    if (in.flag()) {
      for (int i = 0; i < 2; ++i) { overlaps.push_back({in.number(-9, 99), in.number(0, 200)}); }
    }
    extractor orb(exec(), p, 2, overlaps);
    int const stride = p.width + in.within(-1, 9);
    int const rows = p.height + (in.within(0, 7) == 0 ? 1 : 0);  // now and then another size
    auto const pixels = any_pixels(in, ft::max_of(stride, p.width), rows);
    for (int i = 0; i < 2; ++i) {
      bool const taken = fuzz::accepted<ft::bad_argument>([&] {
        orb.upload(exec(), i, {pixels.data(), p.width, rows, stride});
      });
      fuzz::require(taken == (stride >= p.width && rows == p.height),
                    "an image is refused for its size or stride alone");
    }
    if (p.mask_width > 0) {
      auto const mask = any_pixels(in, p.mask_width, p.mask_height);
      orb.set_mask(exec(), 0, {mask.data(), p.mask_width, p.mask_height, p.mask_width});
    }
    orb.extract(exec());
    for (int i = 0; i < 2; ++i) { check_keypoints(orb, i); }
    stereo(in, orb);
  });
}

}  // namespace

// A tracker extracts by itself, so each input takes one of both ways.
extern "C" int LLVMFuzzerTestOneInput(std::uint8_t const* data, std::size_t size) {
  fuzz::input in(data, size);
  ft::orb_params const p = any_params(in);
  if (in.flag()) {
    track(in, p);
  } else {
    extract(in, p);
  }
  return 0;
}
