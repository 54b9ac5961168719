// SPDX-License-Identifier: Apache-2.0
// New points of one camera's keyframes: points at known places, seen by three keyframes and a
// frame.
#include "ft/kernels/map/triangulate_points.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <random>
#include <vector>

#include "ft/cameras/monocular_rig.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/plain_frames.hpp"

namespace triangulate_points_test {

using rig_type = ft::monocular_rig<ft::pinhole<float>>;
constexpr int keyframes = 3;
constexpr int held = 20;      ///< points of the map, which all views see
constexpr int fresh = 60;     ///< points that no keypoint holds
constexpr int capacity = 96;  ///< keypoints
constexpr int slots = 64;

rig_type rig() { return rig_type::make({400.0f, 410.0f, 320.0f, 240.0f}); }

/// The camera's way: to the right, each step 0.3 m. View 3 is the frame.
ft::rigid<double> T_cw(int view) {
  ft::rigid<double> T = ft::rigid<double>::identity();
  T.t = {-0.3 * view, 0.02 * view, 0};
  return T;
}

struct rays_view {
  ft::keyframe_rays_view rays;
  ft::triangulated_view out;
  ft::keyframe_order* begins = nullptr;
};
inline void carve(ft::carver& c, rays_view& v, int batch) {
  ft::keyframes_capacity const size{keyframes + 1, 1, capacity};
  ft::carve(c, v.rays, size, batch);
  ft::carve(c, v.out, size, batch);
  v.begins = c.take<ft::keyframe_order>(static_cast<std::size_t>(batch));
}

struct world {
  std::vector<ft::vec3<double>> points;  ///< the held ones first
  std::vector<ft::descriptor> orb;

  explicit world(unsigned seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> across(-1.5, 1.5);
    std::uniform_real_distribution<double> away(3, 6);
    for (int i = 0; i < held + fresh; ++i) {
      points.push_back({across(random) + 0.5, across(random), away(random)});
      ft::descriptor d{};
      for (auto& w : d.words) { w = static_cast<std::uint32_t>(random()); }
      orb.push_back(d);
    }
  }
};

struct keypoint {
  float x, y;
  int point;
};
/// Points that a view sees, in an order of its own.
std::vector<keypoint> seen(world const& w, int view) {
  std::vector<keypoint> all;
  for (int i = 0; i < held + fresh; ++i) {
    int const n = (i * 7 + 11 * view) % (held + fresh);
    ft::vec3<double> const p = T_cw(view) * w.points[static_cast<std::size_t>(n)];
    auto const c = rig().camera.cast<double>();
    all.push_back({static_cast<float>(c.fx * p.x / p.z + c.cx),
                   static_cast<float>(c.fy * p.y / p.z + c.cy), n});
  }
  return all;
}

/// A map of three keyframes and a frame on an executor.
template <typename Exec>
struct room {
  Exec const& exec;
  world const& w;
  test::mirrored<Exec, ft::odometry_map_view> map;
  test::mirrored<Exec, test::frames_view> frames;
  test::mirrored<Exec, rays_view> rays;
  ft::pyramid_geometry geometry = ft::pyramid_geometry::make(640, 480, 4, 1.2f);

  room(Exec const& executor, world const& of)
      : exec(executor),
        w(of),
        map([](ft::carver& c, ft::odometry_map_view& v) {
          carve(c, v, {slots, {keyframes + 1, 1, capacity}}, 1);
        }),
        frames([](ft::carver& c, test::frames_view& v) { carve(c, v, capacity, 1, 1, 1); }),
        rays([](ft::carver& c, rays_view& v) { carve(c, v, 1); }) {
    clear(exec, map.device);
    map.pull(exec);
    fill_points();
    for (int k = 0; k < keyframes; ++k) { fill_keyframe(k); }
    fill_frame();
    rays.host.begins[0] = ft::keyframe_order::none;
  }
  void fill_points() {
    auto const& r = map.host.records;
    for (int s = 0; s < held; ++s) {
      r.number[s] = s + 1;
      for (int k = 0; k < keyframes; ++k) { r.mask(0, s)[0] |= std::uint64_t{1} << k; }
    }
    r.made[0] = r.alive[0] = r.used[0] = held;
  }
  void fill_keyframe(int k) {
    auto const& kf = map.host.keyframes;
    auto const all = seen(w, k);
    kf.made[0] = kf.count[0] = k + 1;
    kf.T_cw[k] = T_cw(k);
    kf.keypoints[k] = static_cast<int>(all.size());
    rays.host.rays.number[k] = k + 1;
    for (std::size_t i = 0; i < all.size(); ++i) {
      auto const at = kf.at(0, k, static_cast<int>(i));
      bool const is_held = all[i].point < held;
      kf.x[at] = all[i].x;
      kf.y[at] = all[i].y;
      kf.octave[at] = 0;
      kf.holder[at] = is_held ? all[i].point : -1;
      kf.holder_number[at] = is_held ? all[i].point + 1 : 0;
      auto const c = rig().camera.cast<double>();
      ft::vec3<double> d{(static_cast<double>(all[i].x) - c.cx) / c.fx,
                         (static_cast<double>(all[i].y) - c.cy) / c.fy, 1};
      double const length = std::sqrt(ft::dot(d, d));
      rays.host.rays.ray[at] = ft::scaled(d, 1 / length).cast<float>();
      rays.host.rays.orb[at] = w.orb[static_cast<std::size_t>(all[i].point)];
    }
  }
  void fill_frame() {
    auto const all = seen(w, keyframes);
    ft::keypoints_view const kp = frames.host.keypoints.slice(0);
    *kp.count = static_cast<int>(all.size());
    for (std::size_t n = 0; n < all.size(); ++n) {
      int const i = static_cast<int>(n);
      kp.x(i) = all[n].x;
      kp.y(i) = all[n].y;
      kp.octave(i) = 0;
      kp.orb(i) = w.orb[static_cast<std::size_t>(all[n].point)];
      frames.host.holder[i] = all[n].point < held ? all[n].point : -1;
    }
    frames.host.order[0] = ft::keyframe_order::add;
    frames.host.T_cw[0] = T_cw(keyframes);
  }
  ft::triangulation_input<rig_type> input() const {
    ft::triangulation_input<rig_type> in{};
    in.rig = rig();
    in.frame = frames.device.frame();
    in.order = frames.device.order;
    in.begins = rays.device.begins;
    in.T_cw = frames.device.T_cw;
    in.geometry = geometry;
    return in;
  }
  void run() {
    map.push(exec);
    frames.push(exec);
    rays.push(exec);
    bin_keyframes();
    ft::triangulate_points(exec, input(), map.device, rays.device.rays, rays.device.out);
    rays.pull(exec);
  }
  /// Sorts the rays of all keyframes.
  void bin_keyframes() {
    test::mirrored<Exec, rays_view> orders([](ft::carver& c, rays_view& v) { carve(c, v, 1); });
    orders.host.begins[0] = ft::keyframe_order::add;
    orders.push(exec);
    for (int k = 0; k < keyframes; ++k) {
      map.host.keyframes.made[0] = k + 1;
      map.push(exec);
      ft::bin_rays(exec, {orders.device.begins, map.device.keyframes, geometry, 2.5f / 400},
                   rays.device.rays);
      exec.wait();
    }
    rays.pull(exec);
  }
  /// The new points of the frame, by point of the world; -1 = none.
  std::vector<int> found() const {
    auto const all = seen(w, keyframes);
    std::vector<int> keypoint_of(w.points.size(), -1);
    for (std::size_t i = 0; i < all.size(); ++i) {
      if (rays.host.out.keypoint[i] < 0) { continue; }
      keypoint_of[static_cast<std::size_t>(all[i].point)] = static_cast<int>(i);
    }
    return keypoint_of;
  }
};

template <typename Backend>
class triangulate_points : public test::on_backend<Backend> {
protected:
  Backend backend;
};
TYPED_TEST_SUITE(triangulate_points, test::backends);

TYPED_TEST(triangulate_points, finds_points_where_they_are) {
  world const w(3);
  room<typename TypeParam::exec_type> r(this->backend.exec, w);
  r.run();
  auto const found = r.found();
  for (int n = 0; n < held; ++n) {
    EXPECT_EQ(found[static_cast<std::size_t>(n)], -1) << "a keypoint that holds a point";
  }
  for (int n = held; n < held + fresh; ++n) {
    int const i = found[static_cast<std::size_t>(n)];
    ASSERT_GE(i, 0) << n;
    ft::vec3<double> const p = T_cw(keyframes) * w.points[static_cast<std::size_t>(n)];
    auto const& got = r.rays.host.out.point[i];
    EXPECT_NEAR(static_cast<double>(got.x), p.x, 1e-3);
    EXPECT_NEAR(static_cast<double>(got.y), p.y, 1e-3);
    EXPECT_NEAR(static_cast<double>(got.z), p.z, 2e-3);
    EXPECT_EQ(r.rays.host.out.depth[i], got.z);
    EXPECT_EQ(r.rays.host.out.keyframe[i], 1) << "the widest angle is that to the first keyframe";
    EXPECT_EQ(seen(w, 0)[static_cast<std::size_t>(r.rays.host.out.keypoint[i])].point, n);
  }
}

TYPED_TEST(triangulate_points, of_two_keypoints_with_one_match_the_nearer_descriptor_has_it) {
  world const w(4);
  room<typename TypeParam::exec_type> r(this->backend.exec, w);
  ft::keypoints_view const kp = r.frames.host.keypoints.slice(0);
  auto const all = seen(w, keyframes);
  int first = 0;
  while (all[static_cast<std::size_t>(first)].point < held) { ++first; }
  int const copy = *kp.count;
  *kp.count = copy + 1;
  kp.x(copy) = kp.x(first);
  kp.y(copy) = kp.y(first);
  kp.octave(copy) = 0;
  kp.orb(copy) = kp.orb(first);
  r.frames.host.holder[copy] = -1;
  r.run();
  EXPECT_GE(r.rays.host.out.keypoint[first], 0) << "of equals the first";
  EXPECT_EQ(r.rays.host.out.keypoint[copy], -1);
  EXPECT_EQ(r.rays.host.out.depth[copy], -1.0f);
  kp.orb(first).words[2] ^= 1u;
  r.run();
  EXPECT_EQ(r.rays.host.out.keypoint[first], -1);
  EXPECT_GE(r.rays.host.out.keypoint[copy], 0);
}

TYPED_TEST(triangulate_points, refuses_what_does_not_fit) {
  world w(5);
  int const off_line = held;          // a keypoint far from its epipolar lines
  int const other = held + 1;         // another descriptor than in the keyframes
  int const far = held + 2;           // hardly any angle between its rays
  int const other_octave = held + 3;  // as large as something much nearer
  w.points[far] = {1, 0, 4000};
  room<typename TypeParam::exec_type> r(this->backend.exec, w);
  ft::keypoints_view const kp = r.frames.host.keypoints.slice(0);
  auto const all = seen(w, keyframes);
  for (int i = 0; i < *kp.count; ++i) {
    int const n = all[static_cast<std::size_t>(i)].point;
    if (n == off_line) { kp.y(i) += 30; }
    if (n == other) { kp.orb(i).words[0] = ~kp.orb(i).words[0], kp.orb(i).words[5] ^= 0xffffffffu; }
    if (n == other_octave) {
      kp.octave(i) = 3;
      r.geometry.scale[3] = 8;
    }
  }
  r.run();
  auto const found = r.found();
  for (int const n : {off_line, other, far, other_octave}) {
    EXPECT_EQ(found[static_cast<std::size_t>(n)], -1) << n - held;
  }
  EXPECT_GE(found[held + 4], 0);
}

TYPED_TEST(triangulate_points, of_frames_that_become_no_keyframes_or_begin_a_map_are_none) {
  world const w(6);
  room<typename TypeParam::exec_type> r(this->backend.exec, w);
  r.frames.host.order[0] = ft::keyframe_order::none;
  r.run();
  for (int i = 0; i < capacity; ++i) { EXPECT_EQ(r.rays.host.out.keypoint[i], -1); }
  r.frames.host.order[0] = ft::keyframe_order::add;
  r.rays.host.begins[0] = ft::keyframe_order::begin_map;
  r.run();
  for (int i = 0; i < capacity; ++i) { EXPECT_EQ(r.rays.host.out.keypoint[i], -1); }
}

TYPED_TEST(triangulate_points, have_the_bits_of_the_host) {
  world const w(7);
  room<typename TypeParam::exec_type> r(this->backend.exec, w);
  ft::host_exec const exec(1);
  room<ft::host_exec> plain(exec, w);
  r.run();
  plain.run();
  int const n = *r.frames.host.keypoints.slice(0).count;
  for (int i = 0; i < n; ++i) {
    ASSERT_EQ(r.rays.host.out.keypoint[i], plain.rays.host.out.keypoint[i]);
    ASSERT_EQ(r.rays.host.out.keyframe[i], plain.rays.host.out.keyframe[i]);
    if (r.rays.host.out.keypoint[i] < 0) { continue; }
    ASSERT_EQ(std::memcmp(&r.rays.host.out.point[i], &plain.rays.host.out.point[i],
                          sizeof(ft::vec3<float>)),
              0);
  }
}

// Cells far from a line have none of its matches: visiting all of them gives the same points.
TYPED_TEST(triangulate_points, are_the_same_if_all_cells_are_visited) {
  for (unsigned seed = 10; seed < 20; ++seed) {
    world w(seed);
    // Descriptors that many keypoints have, and lines that pass near many keypoints.
    for (std::size_t i = held; i < w.orb.size(); ++i) { w.orb[i] = w.orb[held + i % 3]; }
    room<typename TypeParam::exec_type> r(this->backend.exec, w);
    r.run();
    auto const near = r.found();
    for (int k = 0; k < keyframes; ++k) {
      int visited = 0;
      for (int c = 0; c < ft::ray_cells; ++c) {
        float& reach = r.rays.host.rays.cell[k * ft::ray_cells + c].reach;
        visited += static_cast<int>(reach >= 0);
        EXPECT_LT(reach, 0.2f);
        if (reach >= 0) { reach = 10; }
      }
      EXPECT_GT(visited, 30);
      EXPECT_EQ(r.rays.host.rays.first[(k + 1) * (ft::ray_cells + 1) - 1], held + fresh);
    }
    r.rays.push(r.exec);
    ft::triangulate_points(r.exec, r.input(), r.map.device, r.rays.device.rays, r.rays.device.out);
    r.rays.pull(r.exec);
    EXPECT_EQ(near, r.found());
    EXPECT_GT(std::count_if(near.begin(), near.end(), [](int i) { return i >= 0; }), 5);
  }
}

TYPED_TEST(triangulate_points, enter_the_keyframe_that_they_were_made_with) {
  world const w(8);
  room<typename TypeParam::exec_type> r(this->backend.exec, w);
  r.run();
  // As insert_keyframe leaves the map: the frame is keyframe 4, new points have slots.
  auto const& kf = r.map.host.keyframes;
  kf.made[0] = kf.count[0] = keyframes + 1;
  auto const all = seen(w, keyframes);
  kf.keypoints[keyframes] = static_cast<int>(all.size());
  for (std::size_t i = 0; i < all.size(); ++i) {
    auto const at = kf.at(0, keyframes, static_cast<int>(i));
    kf.x[at] = all[i].x;
    kf.y[at] = all[i].y;
    kf.octave[at] = 0;
  }
  int slot = held;
  for (std::size_t i = 0; i < all.size() && slot < slots; ++i) {
    if (r.rays.host.out.keypoint[i] < 0) { continue; }
    r.frames.host.holder[i] = slot;
    r.map.host.records.number[slot] = 100 + slot;
    r.map.host.records.mask(0, slot)[0] = std::uint64_t{1} << keyframes;
    ++slot;
  }
  for (int i = 0; i < kf.keypoints[0]; ++i) { kf.aligned[kf.at(0, 0, i)] = 1; }  // of other points
  r.map.push(r.exec);
  r.frames.push(r.exec);
  ft::enter_partners(r.exec, r.input(), true, r.map.device, r.rays.device.rays, r.rays.device.out);
  r.map.pull(r.exec);
  r.rays.pull(r.exec);
  EXPECT_EQ(r.rays.host.rays.number[keyframes], keyframes + 1);
  auto const first_view = seen(w, 0);
  int entered = 0;
  for (std::size_t i = 0; i < first_view.size(); ++i) {
    auto const at = kf.at(0, 0, static_cast<int>(i));
    int const s = kf.holder[at];
    if (s < held) { continue; }
    ++entered;
    EXPECT_EQ(kf.holder_number[at], 100 + s);
    EXPECT_EQ(kf.aligned[at], 0) << "where no patch of this point was";
    EXPECT_EQ(r.map.host.records.mask(0, s)[0], (std::uint64_t{1} << keyframes) | 1u);
    EXPECT_EQ(r.map.host.points.slice(0).observations(s), 2);
  }
  EXPECT_EQ(entered, slot - held);
  for (std::size_t i = 0; i < all.size(); ++i) {
    auto const at = kf.at(0, keyframes, static_cast<int>(i));
    auto const& ray = r.rays.host.rays.ray[at];
    EXPECT_NEAR(static_cast<double>(ft::dot(ray, ray)), 1.0, 1e-6);
  }
}

}  // namespace triangulate_points_test
