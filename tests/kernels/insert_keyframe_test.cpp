// SPDX-License-Identifier: Apache-2.0
// Keyframes: against a plain loop on random frames, with small rings and few slots; what stays true
// over long sequences; the same bits on every executor.
#include "ft/kernels/map/insert_keyframe.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <random>
#include <string>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/plain_frames.hpp"

namespace insert_keyframe_test {

using fisheye_rig = ft::stereo_rig<ft::kannala_brandt<float>, ft::kannala_brandt<float>>;

template <typename Rig>
Rig make_rig() {
  if constexpr (Rig::searches > 1) {
    // Exact rotations: a quarter and a half turn.
    ft::pose const quarter{{{0, 0, -1, 0, 1, 0, 1, 0, 0}}, {0.1f, -0.2f, 0.3f}};
    ft::pose const half{{{-1, 0, 0, 0, 1, 0, 0, 0, -1}}, {0, 0.1f, 0.4f}};
    return {{{{400.0f, 410.0f, 250.0f, 240.0f}, 0.12, ft::pose::identity()},
             {{390.0f, 400.0f, 255.0f, 245.0f}, 0.2, quarter},
             {{410.0f, 420.0f, 245.0f, 235.0f}, 0.05, half}}};
  } else if constexpr (Rig::rectified) {
    return ft::rectified_rig::make({400.0f, 410.0f, 250.0f, 240.0f}, 0.1);
  } else {
    Rig rig{};
    rig.T_rl = ft::pose::identity();
    rig.T_rl.t.x = -0.1f;
    return rig;
  }
}

struct sizes {
  int slots, positions, keypoints, batch;
};

/// A map, frames and the stage on an executor.
template <typename Exec, typename Rig>
struct room {
  static constexpr int cameras = Rig::cameras;
  Exec const& exec;
  sizes size;
  test::mirrored<Exec, ft::odometry_map_view> map;
  test::mirrored<Exec, test::frames_view> frames;
  test::mirrored<Exec, ft::keyframe_workspace> work;
  ft::keyframe_params params;
  ft::pyramid_geometry geometry = ft::pyramid_geometry::make(640, 480, 4, 1.2f);

  room(Exec const& executor, sizes const& s)
      : exec(executor),
        size(s),
        map([&](ft::carver& c, ft::odometry_map_view& v) {
          carve(c, v, {s.slots, {s.positions, cameras, s.keypoints}}, s.batch);
        }),
        frames([&](ft::carver& c, test::frames_view& v) {
          carve(c, v, s.keypoints, cameras, Rig::searches, s.batch);
        }),
        work([&](ft::carver& c, ft::keyframe_workspace& v) {
          carve(c, v, s.slots, s.keypoints, cameras, s.batch);
        }) {
    clear(exec, map.device);
    map.pull(exec);
    params.near_depth = 50;
    params.wanted_near_points = 12;
  }
  ft::keyframe_input<Rig> input(test::frames_view const& v) const {
    return {make_rig<Rig>(), v.frame(), v.order,  v.T_cw, v.time_ns,
            v.depth,         v.point,   geometry, v.moves};
  }
  void insert() {
    map.push(exec);
    frames.push(exec);
    ft::keyframe_result const out{frames.device.held, frames.device.left_out};
    ft::insert_keyframe(exec, input(frames.device), params, map.device, out, work.device);
    map.pull(exec);
    frames.pull(exec);
  }
};

/// Some points become old and seldom found.
inline void age_points(std::mt19937& random, ft::odometry_map_view const& map, int b) {
  for (int s = 0; s < map.records.slots; ++s) {
    auto const at = map.records.at(b, s);
    if (map.records.number[at] == 0) { continue; }
    map.records.visible[at] += static_cast<int>(random() % 5);
    map.records.found[at] += static_cast<int>(random() % 3);
  }
}

/// Inserts keyframes for a while, each compared with the plain loop.
template <typename Exec, typename Rig>
void compare(Exec const& exec, sizes const& size, int steps, unsigned seed) {
  std::mt19937 random(seed);
  room<Exec, Rig> r(exec, size);
  ft::host_exec const alone(1);
  room<ft::host_exec, Rig> other(alone, size);
  r.geometry.exact = other.geometry.exact = seed % 2 == 0;
  int left_out = 0;
  for (int step = 0; step < steps; ++step) {
    SCOPED_TRACE("step " + std::to_string(step));
    std::vector<test::plain_insertion<Rig>> expected;
    for (int b = 0; b < size.batch; ++b) {
      age_points(random, r.map.host, b);
      auto const before = test::read_map(r.map.host, b);
      test::randomize_frame(random, r.frames.host, b, before, step % 7 == 3 ? 0 : 60);
      auto& order = r.frames.host.order[b];
      order = random() % 4 == 0 ? ft::keyframe_order::none : ft::keyframe_order::add;
      if (random() % 40 == 0) { order = ft::keyframe_order::begin_map; }
      expected.emplace_back(r.input(r.frames.host), r.params, b, before);
      expected.back().run();
    }
    other.map.take(r.map);
    other.frames.take(r.frames);
    r.insert();
    other.insert();
    for (int b = 0; b < size.batch; ++b) {
      SCOPED_TRACE("batch entry " + std::to_string(b));
      auto const& e = expected[test::index(b)];
      auto const found = test::read_map(r.map.host, b);
      test::expect_same_map(found, e.map, 2e-6f);
      test::expect_consistent(found);
      test::expect_same_map(found, test::read_map(other.map.host, b), 0);
      int held = 0;
      for (int n = 0; n < r.frames.host.numbers(); ++n) {
        int const holder = r.frames.host.holder[b * r.frames.host.numbers() + n];
        EXPECT_EQ(holder, e.holder[test::index(n)]) << "keypoint " << n;
        held += static_cast<int>(n < Rig::searches * size.keypoints && holder >= 0);
      }
      if (r.frames.host.order[b] == ft::keyframe_order::none) { continue; }
      EXPECT_EQ(r.frames.host.held[b], held);
      EXPECT_EQ(r.frames.host.left_out[b], e.left_out);
      left_out += e.left_out;
    }
    if (::testing::Test::HasFailure()) { return; }
  }
  if (size.slots < size.keypoints) { EXPECT_GT(left_out, 0) << "slots are short"; }
  if (size.slots >= Rig::searches * size.keypoints) { EXPECT_EQ(left_out, 0); }
}

template <typename Backend>
class InsertKeyframe : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(InsertKeyframe, test::backends);

TYPED_TEST(InsertKeyframe, IsThatOfAPlainLoop) {
  using exec_type = typename TypeParam::exec_type;
  TypeParam backend;
  // Room for all, a full ring, few slots, fewer slots than keypoints, rings of several words.
  std::vector<sizes> const all = {{2000, 100, 40, 2}, {400, 5, 50, 2}, {90, 12, 40, 2},
                                  {20, 4, 50, 1},     {1, 2, 1, 1},    {3000, 150, 30, 1}};
  for (std::size_t i = 0; i < all.size(); ++i) {
    SCOPED_TRACE("case " + std::to_string(i));
    int const steps =
        std::max(20, test::effort(all[i].positions >= 100 ? 200 : 60));  // slots run short
    compare<exec_type, ft::rectified_rig>(backend.exec, all[i], steps, static_cast<unsigned>(i));
    compare<exec_type, fisheye_rig>(backend.exec, all[i], steps, 100 + static_cast<unsigned>(i));
    compare<exec_type, ft::multi_rig<3>>(backend.exec, all[i], steps,
                                         200 + static_cast<unsigned>(i));
    if (::testing::Test::HasFailure()) { return; }
  }
}

TYPED_TEST(InsertKeyframe, WithoutKeypointsOrPointsIsStillAKeyframe) {
  using exec_type = typename TypeParam::exec_type;
  TypeParam backend;
  std::mt19937 random(7);
  room<exec_type, ft::rectified_rig> r(backend.exec, {50, 3, 30, 1});
  auto& frames = r.frames.host;
  for (int step = 0; step < 6; ++step) {
    auto const before = test::read_map(r.map.host, 0);
    test::randomize_frame(random, frames, 0, before, 80);
    frames.order[0] = ft::keyframe_order::add;
    if (step == 3) {  // every point has been in view for long, and was never found again
      std::fill_n(r.map.host.records.visible, 50, 1000);
      std::fill_n(r.map.host.records.found, 50, 1);
    }
    if (step > 2) { frames.keypoints.count[0] = 0; }
    r.insert();
    auto const after = test::read_map(r.map.host, 0);
    test::expect_consistent(after);
    EXPECT_EQ(after.keyframes_made, step + 1);
    EXPECT_EQ(after.keyframes.size(), test::index(std::min(step + 1, 3)));
    if (step > 2) {
      EXPECT_EQ(after.alive(), 0);
      EXPECT_EQ(r.map.host.records.used[0], 0);
      EXPECT_EQ(frames.held[0], 0);
      EXPECT_EQ(frames.holder[0], -1);
    } else {
      EXPECT_GT(after.alive(), 0);
    }
  }
}

TYPED_TEST(InsertKeyframe, RefusesWhatDoesNotFit) {
  TypeParam backend;
  room<typename TypeParam::exec_type, ft::rectified_rig> r(backend.exec, {50, 3, 30, 1});
  auto const refused = [&](ft::keyframe_input<ft::rectified_rig> const& in) {
    EXPECT_THROW(ft::insert_keyframe(r.exec, in, r.params, r.map.device, {}, r.work.device),
                 ft::bad_argument);
  };
  auto in = r.input(r.frames.device);
  in.frame.cameras = 2;
  refused(in);
  in = r.input(r.frames.device);
  in.frame.keypoints.capacity = 31;
  refused(in);
  r.params.near_depth = 0;
  refused(r.input(r.frames.device));
}

}  // namespace insert_keyframe_test
