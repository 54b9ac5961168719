// SPDX-License-Identifier: Apache-2.0
// Keypoints that are moved to where an image looks as another one did: images of a plane, whose
// points are seen at known places.
#include "ft/kernels/odometry/align_keypoints.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ft/cameras/stereo_rig.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/plain_map.hpp"
#include "tests/support/random.hpp"

namespace align_keypoints_test {

constexpr int batch = 3, capacity = 120, slots = 300, width = 320, height = 240, levels = 4;
constexpr int unseen = 2;  // the batch entry whose first frame is no keyframe
constexpr float distance = 4;
constexpr float disparity = 9;

/// Grey value of the plane z = distance, as smooth as an image is.
double grey(double x, double y) {
  return 128 + 40 * std::sin(9 * x + 2) * std::cos(11 * y) + 35 * std::sin(23 * x - 13 * y) +
         30 * std::cos(17 * y + 19 * x + 1);
}

struct arrays {
  ft::image_pyramid_view images;
  ft::keypoints_view keypoints;
  ft::odometry_map_view map;
  ft::point_patches_view patches;
  int* claim = nullptr;
  int* holder = nullptr;
  float* right_x = nullptr;
  ft::pixels_view aligned;
  float* aligned_right_x = nullptr;
  float* moves = nullptr;
  ft::keyframe_order* order = nullptr;
  ft::rigid<double>* exact_T_cw = nullptr;
  ft::pose* T_cw = nullptr;
};

struct pixel {
  double u, v;
};

template <typename Exec>
struct plane_scene {
  ft::rectified_rig rig = ft::rectified_rig::make({250, 240, 161, 118}, 0.1f);
  ft::pyramid_geometry geometry = ft::pyramid_geometry::make(width, height, levels, 1.2f);
  test::mirrored<Exec, arrays> data;
  Exec const& exec;

  explicit plane_scene(Exec const& e)
      : data([&](ft::carver& c, arrays& v) {
          carve(c, v.images, geometry, batch);
          carve(c, v.keypoints, capacity, batch);
          carve(c, v.map, {slots, {4, 1, capacity}}, batch);
          carve(c, v.patches, slots, batch);
          v.claim = c.take<int>(batch * slots);
          v.holder = c.take<int>(batch * capacity);
          v.right_x = c.take<float>(batch * capacity);
          carve(c, v.aligned, capacity, batch);
          v.aligned_right_x = c.take<float>(batch * capacity);
          v.moves = c.take<float>(batch * capacity);
          v.order = c.take<ft::keyframe_order>(batch);
          v.exact_T_cw = c.take<ft::rigid<double>>(batch);
          v.T_cw = c.take<ft::pose>(batch);
        }),
        exec(e) {}

  /// Renders the plane of all frames as a camera at T sees it.
  void look_from(ft::rigid<double> const& T, double contrast = 1) {
    arrays& v = data.host;
    ft::rigid<double> const back = T.inverse();
    for (int b = 0; b < batch; ++b) {
      v.exact_T_cw[b] = T;
      v.T_cw[b] = T.cast<float>();
      for (int l = 0; l < levels; ++l) {
        auto const level = v.images.level(b, l);
        double const scale = static_cast<double>(geometry.scale[l]);
        for (int y = 0; y < level.height; ++y) {
          for (int x = 0; x < level.width; ++x) {
            ft::vec3<double> const ray = back.R * unprojected({scale * x, scale * y});
            double const s = (static_cast<double>(distance) - back.t.z) / ray.z;
            double const value = grey(back.t.x + s * ray.x, back.t.y + s * ray.y);
            level.row(y)[x] = static_cast<std::uint8_t>(128 + contrast * (value - 128) + 0.5);
          }
        }
      }
    }
  }
  ft::vec3<double> unprojected(pixel p) const {
    auto const& c = rig.camera;
    return {(p.u - static_cast<double>(c.cx)) / static_cast<double>(c.fx),
            (p.v - static_cast<double>(c.cy)) / static_cast<double>(c.fy), 1};
  }
  pixel seen_from(ft::rigid<double> const& T, ft::vec3<float> const& point) const {
    auto const& c = rig.camera;
    ft::vec3<double> const p = T * point.cast<double>();
    return {static_cast<double>(c.fx) * p.x / p.z + static_cast<double>(c.cx),
            static_cast<double>(c.fy) * p.y / p.z + static_cast<double>(c.cy)};
  }
  /// Random keypoints of a camera at the origin, each with its own point.
  void begin(test::generator& random) {
    arrays& v = data.host;
    clear(ft::host_exec{}, v.map);
    clear(ft::host_exec{}, v.patches);
    look_from(ft::rigid<double>::identity());
    for (int b = 0; b < batch; ++b) {
      v.order[b] = b == unseen ? ft::keyframe_order::none : ft::keyframe_order::add;
      v.map.keyframes.made[b] = 2;
      auto const kp = v.keypoints.slice(b);
      *kp.count = capacity - b;
      for (int i = 0; i < capacity; ++i) {
        int const slot = 2 * i + b;
        pixel const p{random.real(40, width - 40), random.real(40, height - 40)};
        kp.x(i) = static_cast<float>(p.u);
        kp.y(i) = static_cast<float>(p.v);
        kp.octave(i) = random.below(levels);
        v.holder[b * capacity + i] = slot;
        v.claim[b * slots + slot] = i;
        v.map.records.number[b * slots + slot] = 100 + i;
        ft::vec3<double> const at = ft::scaled(unprojected(p), static_cast<double>(distance));
        v.map.points.slice(b).position(slot) = at.cast<float>();
      }
    }
  }
  ft::frame_view frame() const {
    ft::frame_view f{};
    f.keypoints = data.device.keypoints;
    f.keypoint_step = 1;
    f.batch = batch;
    f.right_x = data.device.right_x;
    f.holder = data.device.holder;
    return f;
  }
  void keep() {
    data.push(exec);
    ft::keyframe_input<ft::rectified_rig> in{};
    in.rig = rig;
    in.frame = frame();
    in.order = data.device.order;
    in.T_cw = data.device.exact_T_cw;
    in.geometry = geometry;
    ft::keyframe_workspace work{};
    work.claim = data.device.claim;
    ft::keep_patches(exec, in, data.device.images, data.device.map, work, data.device.patches);
    data.pull(exec);
  }
  void align() {
    data.push(exec);
    arrays const& v = data.device;
    ft::align_keypoints(
        exec, ft::frames_to_align<ft::rectified_rig>{
                  rig, frame(), v.images, v.map.points, v.map.records.number, v.patches, v.T_cw,
                  nullptr, v.aligned, v.aligned_right_x, v.moves});
    data.pull(exec);
  }
  /// Keypoints up to `off` pixels of their levels from where a camera at T sees their points.
  void place(test::generator& random, ft::rigid<double> const& T, float off) {
    arrays& v = data.host;
    for (int b = 0; b < batch; ++b) {
      auto const kp = v.keypoints.slice(b);
      for (int i = 0; i < capacity; ++i) {
        pixel const p = seen_from(T, v.map.points.slice(b).position(v.holder[b * capacity + i]));
        float const most = off * geometry.scale[kp.octave(i)];
        kp.x(i) = static_cast<float>(p.u) + random.real(-most, most);
        kp.y(i) = static_cast<float>(p.v) + random.real(-most, most);
        v.right_x[b * capacity + i] = i % 3 == 0 ? -1.0f : kp.x(i) - disparity;
      }
    }
  }
  /// Column, row, right column and way of each keypoint. @param found where corners were found
  std::vector<float> positions(bool found = false) const {
    arrays const& v = data.host;
    std::vector<float> all;
    for (int b = 0; b < batch; ++b) {
      for (int i = 0; i < *v.keypoints.slice(b).count; ++i) {
        int const n = b * capacity + i;
        float const x = found ? v.keypoints.slice(b).x(i) : v.aligned.slice(b).x(i);
        float const y = found ? v.keypoints.slice(b).y(i) : v.aligned.slice(b).y(i);
        float const right = found ? v.right_x[n] : v.aligned_right_x[n];
        all.insert(all.end(), {x, y, right, found ? -1.0f : v.moves[n]});
      }
    }
    return all;
  }
};

/// A camera that moved, turned about all axes, and came nearer by a tenth.
ft::rigid<double> moved_camera() {
  double const a = 0.12, c = std::cos(a), s = std::sin(a), tilt = 0.03;
  ft::mat3<double> const roll{{c, -s, 0, s, c, 0, 0, 0, 1}};
  ft::mat3<double> const pan{
      {std::cos(tilt), 0, std::sin(tilt), 0, 1, 0, -std::sin(tilt), 0, std::cos(tilt)}};
  return {roll * pan, {0.1, -0.05, -0.4}};
}

template <typename Exec>
std::vector<float> align_moved(Exec const& exec, unsigned seed, plane_scene<Exec>& s) {
  static_cast<void>(exec);
  test::generator random(seed);
  s.begin(random);
  s.keep();
  s.look_from(moved_camera());
  s.place(random, moved_camera(), 1.5f);
  s.align();
  return s.positions();
}

template <typename Backend>
class AlignKeypoints : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(AlignKeypoints, test::backends);

TYPED_TEST(AlignKeypoints, FindTheirPoints) {
  TypeParam backend;
  plane_scene s(backend.exec);
  int moved = 0, off = 0;
  for (unsigned seed = 1; seed <= 3; ++seed) {
    align_moved(backend.exec, seed, s);
    arrays const& v = s.data.host;
    for (int b = 0; b < batch; ++b) {
      auto const kp = v.keypoints.slice(b);
      for (int i = 0; i < capacity; ++i) {
        int const n = b * capacity + i;
        if (i >= *kp.count) { continue; }
        if (b == unseen) { EXPECT_EQ(v.moves[n], -1.0f); }
        if (v.moves[n] < 0) { continue; }
        pixel const want = s.seen_from(moved_camera(), v.map.points.slice(b).position(v.holder[n]));
        double const scale = static_cast<double>(s.geometry.scale[kp.octave(i)]);
        auto const at = v.aligned.slice(b);
        double const dx = (static_cast<double>(at.x(i)) - want.u) / scale;
        double const dy = (static_cast<double>(at.y(i)) - want.v) / scale;
        ++moved;
        off += std::hypot(dx, dy) < 0.1 ? 0 : 1;
        if (v.right_x[n] < 0) {
          EXPECT_EQ(v.aligned_right_x[n], v.right_x[n]);
        } else {
          EXPECT_NEAR(at.x(i) - v.aligned_right_x[n], disparity, 1e-4f);
        }
      }
    }
  }
  // The rest is where the plane has no corner, or beside the image.
  EXPECT_GT(moved, 3 * 2 * capacity * 3 / 4);
  EXPECT_LT(off, moved / 50);
}

TYPED_TEST(AlignKeypoints, HaveTheSameBitsEverywhere) {
  TypeParam backend;
  plane_scene s(backend.exec);
  ft::host_exec const host;
  plane_scene on_host(host);
  for (unsigned seed = 11; seed <= 14; ++seed) {
    EXPECT_EQ(align_moved(backend.exec, seed, s), align_moved(host, seed, on_host));
  }
}

/// A camera at rest: a keypoint that is where its patch was kept has a place, no way to it.
TYPED_TEST(AlignKeypoints, ThatAreAtTheirPlacesAlreadyHaveOne) {
  TypeParam backend;
  plane_scene s(backend.exec);
  test::generator random(7);
  s.begin(random);
  s.keep();
  s.align();
  arrays const& v = s.data.host;
  int found = 0;
  for (int b = 0; b < batch; ++b) {
    auto const kp = v.keypoints.slice(b);
    for (int i = 0; i < *kp.count; ++i) {
      float const move = v.moves[b * capacity + i];
      EXPECT_EQ(move, b != unseen && move >= 0 ? 0.0f : -1.0f);
      found += move >= 0 ? 1 : 0;
      EXPECT_EQ(v.aligned.slice(b).x(i), kp.x(i));
      EXPECT_EQ(v.aligned.slice(b).y(i), kp.y(i));
    }
  }
  EXPECT_GT(found, 2 * capacity * 3 / 4);
}

TYPED_TEST(AlignKeypoints, StayWithoutAPatchOfTheirPoint) {
  TypeParam backend;
  plane_scene s(backend.exec);
  test::generator random(5);
  s.begin(random);
  s.keep();
  arrays& v = s.data.host;
  s.place(random, ft::rigid<double>::identity(), 1);
  for (int b = 0; b < batch; ++b) {
    for (int i = 0; i < capacity; ++i) {
      int const n = b * capacity + i;
      if (i % 2 == 0) { v.map.records.number[b * slots + v.holder[n]] += 1000; }  // another point
      if (i % 2 == 1) { v.holder[n] = -1; }
    }
  }
  for (int n = 0; n < batch * capacity; ++n) { v.moves[n] = 7; }
  s.align();
  EXPECT_EQ(s.positions(), s.positions(true));
}

TYPED_TEST(AlignKeypoints, StayInImagesThatAreFlatOrOfAnotherPlace) {
  TypeParam backend;
  plane_scene s(backend.exec);
  for (bool const flat : {true, false}) {
    test::generator random(6);
    s.begin(random);
    if (flat) { s.look_from(ft::rigid<double>::identity(), 0); }
    s.keep();
    s.place(random, ft::rigid<double>::identity(), 1);
    // Three times as near: no patch of a level looks the same.
    if (!flat) { s.look_from({ft::mat3<double>::identity(), {0, 0, -2.8}}); }
    s.align();
    EXPECT_EQ(s.positions(), s.positions(true));
  }
}

TYPED_TEST(AlignKeypoints, KeepTheirFirstPatch) {
  TypeParam backend;
  plane_scene s(backend.exec);
  test::generator random(8);
  s.begin(random);
  s.keep();
  arrays& v = s.data.host;
  std::vector<ft::point_patch> first(v.patches.patch, v.patches.patch + batch * slots);
  std::vector<int> const numbers(v.patches.number, v.patches.number + batch * slots);
  s.look_from(moved_camera());
  s.keep();
  int kept = 0;
  for (int n = 0; n < batch * slots; ++n) {
    EXPECT_EQ(v.patches.number[n], numbers[static_cast<std::size_t>(n)]);
    if (v.patches.number[n] == 0) { continue; }
    ++kept;
    auto const& a = first[static_cast<std::size_t>(n)];
    auto const& b = v.patches.patch[n];
    EXPECT_TRUE(std::equal(a.grey, a.grey + sizeof a.grey, b.grey));
    EXPECT_EQ(a.across.x, b.across.x);
    EXPECT_GE(b.x, 0.0f);
    EXPECT_LT(b.x, 1.0f);
  }
  EXPECT_EQ(kept, (capacity - 0) + (capacity - 1));
  // Those that gave a patch count as aligned in their keyframe, number 2 of a ring of 4.
  ft::keyframes_view const& k = v.map.keyframes;
  int aligned = 0;
  for (int b = 0; b < batch; ++b) {
    for (int i = 0; i < *v.keypoints.slice(b).count; ++i) {
      aligned += k.aligned[k.at(b, 1, i)] == 1 ? 1 : 0;
    }
  }
  EXPECT_EQ(aligned, kept);
}

}  // namespace align_keypoints_test
