// SPDX-License-Identifier: Apache-2.0
// Frames whose matches agree with two motions: which one is kept, what the other one leaves, and
// the same bits on both executors.
#include "ft/kernels/odometry/split_motions.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "tests/support/backends.hpp"
#include "tests/support/example_rigs.hpp"
#include "tests/support/plain_map.hpp"
#include "tests/support/random.hpp"

namespace split_motions_test {

constexpr int capacity = 900;
constexpr int width = 640, height = 480;

struct arrays {
  ft::keypoints_view keypoints;
  ft::observations_view observations;
  ft::odometry_state_view state;
  ft::windowless_workspace work;
  int* holder = nullptr;
  ft::pose* T_cw = nullptr;
  float* information = nullptr;
  float* depth = nullptr;
  float* moves = nullptr;
};

/// A frame before a room, and a thing in the middle of its image that has moved. Depths in metres.
struct scene {
  int rest = 350;
  int thing = 250;
  int free = 200;                           ///< keypoints without a point
  double moved = 0.06;                      ///< metres, the thing to the left
  double half_wide = 160, half_high = 120;  ///< pixels, of the thing
  float near = 1.5f, far = 5;               ///< the rest
  float depth = 2;                          ///< the thing
  int common = 129;          ///< errors that neighbours shared in the last frame, 1 / 1024
  float noise = 0.3f;        ///< pixels
  bool lately = false;       ///< there were two motions half a second ago
  std::uint64_t places = 0;  ///< parts of the image where the other one was then
  int seen_by = -1;          ///< whose image; -1 = the camera's
  double left_out = 0;       ///< share of the rest's matches that the pose before left out
  float wrong_by = 0.03f;    ///< metres, the pose before
  bool aligned = false;      ///< every second keypoint was moved to its point's patch
  unsigned seed = 1;
};

template <typename Exec, typename Rig>
struct room {
  Exec const& exec;
  Rig rig = test::example_rig<Rig>();
  int camera;
  test::mirrored<Exec, arrays> data;
  std::vector<int> of_thing;  ///< of each keypoint of the camera

  room(Exec const& on, scene const& s, int c = 0)
      : exec(on), camera(c), data([](ft::carver& to, arrays& v) {
          constexpr int numbers = Rig::cameras * capacity;
          carve(to, v.keypoints, capacity, Rig::images);
          carve(to, v.observations, numbers, 1);
          carve(to, v.state, 1);
          carve(to, v.work, numbers, 1);
          v.holder = to.take<int>(numbers);
          v.T_cw = to.take<ft::pose>(1);
          v.information = to.take<float>(ft::information_terms);
          v.depth = to.take<float>(numbers);
          v.moves = to.take<float>(numbers);
        }) {
    put(s);
    data.push(exec);
    arrays const& there = data.device;
    ft::motions_of_frames<Rig> in{};
    in.rig = rig;
    in.frame.keypoints = there.keypoints;
    in.frame.cameras = Rig::cameras;
    in.frame.keypoint_step = Rig::images;
    in.frame.camera_step = Rig::images / Rig::cameras;
    in.frame.holder = there.holder;
    in.observations = there.observations;
    in.T_cw = there.T_cw;
    in.information = there.information;
    in.depth = there.depth;
    in.depth_cameras = Rig::rectified ? Rig::cameras : 1;
    in.geometry = ft::pyramid_geometry::make(width, height, 1, 1.2f);
    in.moves = s.aligned ? there.moves : nullptr;
    ft::split_motions(exec, in, there.state, there.work);
    data.pull(exec);
  }
  ft::camera_track const& track() const { return data.host.state.tracks[0]; }
  /// Distance of the pose from the true one, the identity, metres.
  double off() const {
    auto const t = data.host.T_cw[0].t;
    return std::sqrt(double{t.x} * t.x + double{t.y} * t.y + double{t.z} * t.z);
  }
  bool holds(int k) const { return data.host.holder[camera * capacity + k] >= 0; }
  /// Keypoints without a point in the parts of the image that the thing fills.
  int free_where_filled(scene const& s) const {
    int n = 0;
    auto const keypoints = data.host.keypoints.slice(camera * (Rig::images / Rig::cameras));
    for (int k = s.rest + s.thing; k < s.rest + s.thing + s.free; ++k) {
      bool const is =
          std::abs(keypoints.x(k) - width / 2) < 160 && std::abs(keypoints.y(k) - height / 2) < 80;
      n += static_cast<int>(is);
    }
    return n;
  }
  bool has_depth(int k) const { return data.host.depth[camera * capacity + k] > 0; }

private:
  void put(scene const& s) {
    arrays const& v = data.host;
    test::generator random(s.seed);
    std::fill_n(v.holder, Rig::cameras * capacity, -1);
    std::fill_n(v.depth, Rig::cameras * capacity, 2.0f);
    std::fill_n(v.moves, Rig::cameras * capacity, -1.0f);
    std::fill_n(v.keypoints.count, Rig::images, 0);
    std::fill_n(v.information, ft::information_terms, 0.0f);
    auto const keypoints = v.keypoints.slice(camera * (Rig::images / Rig::cameras));
    int n = 0;
    while (n < s.rest + s.thing + s.free) {
      ft::vec2<float> const pixel{random.real(20, width - 20), random.real(20, height - 20)};
      bool const middle = std::abs(pixel.x - width / 2) < s.half_wide &&
                          std::abs(pixel.y - height / 2) < s.half_high;
      bool const free = n >= s.rest + s.thing;
      bool const thing = free ? middle : n >= s.rest;
      auto const ray = test::model_of(rig, camera).unproject(pixel).direction;
      // Within 80 degrees of the axis.
      if ((!free && thing != middle) || !(ray.z > 0.17f * std::sqrt(ft::dot(ray, ray)))) {
        continue;
      }
      of_thing.push_back(thing ? 1 : 0);
      keypoints.octave(n) = 0;
      keypoints.x(n) = pixel.x + random.real(-s.noise, s.noise);
      keypoints.y(n) = pixel.y + random.real(-s.noise, s.noise);
      if (!free) {
        float const depth =
            (thing ? s.depth * random.real(0.95f, 1.05f) : random.real(s.near, s.far)) /
            std::sqrt(ft::dot(ray, ray));
        ft::vec3<float> point{ray.x * depth, ray.y * depth, ray.z * depth};
        if constexpr (Rig::rectified) { point = rig.to_body(camera, point); }
        if (thing) { point.x += static_cast<float>(s.moved); }
        v.observations.items[n] = {point, keypoints.x(n), keypoints.y(n), -1.0f, 1.0f, camera};
        v.observations.number[n] = camera * capacity + n;
        v.observations.outlier[n] = 0;
        if (s.aligned && n % 2 == 0) {
          v.moves[camera * capacity + n] = 0.5f;
          v.observations.items[n].inv_sigma2 = ft::weight_of_aligned;
        }
        v.holder[camera * capacity + n] = 7 * n;
        if (!thing && n < s.left_out * s.rest) {
          v.observations.outlier[n] = 1;
          v.holder[camera * capacity + n] = -1;
        }
      }
      ++n;
    }
    *keypoints.count = n;
    v.observations.count[0] = v.observations.inliers[0] = s.rest + s.thing;
    v.T_cw[0] = ft::pose::identity();
    v.T_cw[0].t.x = s.wrong_by;
    ft::camera_track t = ft::camera_track::initial();
    t.state = ft::tracking_state::tracking;
    t.plan = ft::search_plan::follow;
    t.time_ns = 5000000000;
    t.facts.common = s.common;
    t.facts.apart = 33;
    t.apart = s.lately ? 1 : 0;
    t.apart_ns = t.time_ns - 500000000;
    t.apart_blocks = s.places;
    t.apart_camera = s.seen_by < 0 ? camera : s.seen_by;
    v.state.tracks[0] = t;
  }
};

template <typename Backend>
class SplitMotions : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(SplitMotions, test::backends);

template <typename Rig, typename Exec>
void keeps_the_rest(Exec const& exec, int camera) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    SCOPED_TRACE(seed);
    scene s;
    s.seed = seed;
    room<Exec, Rig> const r(exec, s, camera);
    EXPECT_LT(r.off(), 0.004);
    EXPECT_GE(r.track().facts.apart, 200);
    EXPECT_EQ(r.track().apart, 1);
    EXPECT_EQ(r.track().apart_ns, r.track().time_ns);
    int held[2] = {}, with_depth[2] = {}, free[2] = {};
    for (int k = 0; k < s.rest + s.thing + s.free; ++k) {
      int const thing = r.of_thing[static_cast<std::size_t>(k)];
      held[thing] += static_cast<int>(r.holds(k));
      if (k < s.rest + s.thing) { continue; }
      ++free[thing];
      with_depth[thing] += static_cast<int>(r.has_depth(k));
    }
    EXPECT_GE(held[0], 345);
    EXPECT_LE(held[1], 5);
    EXPECT_EQ(r.data.host.observations.inliers[0], held[0] + held[1]);
    // The thing does not end where parts of the image do.
    EXPECT_LT(with_depth[1], free[1] / 4);
    EXPECT_GT(with_depth[0], 3 * free[0] / 4);
    EXPECT_GT(r.data.host.information[0], 0.0f);
  }
}
TYPED_TEST(SplitMotions, ThePoseIsThatOfTheRestForEachKindOfRig) {
  TypeParam backend;
  keeps_the_rest<ft::rectified_rig>(backend.exec, 0);
  keeps_the_rest<test::fisheye_rig>(backend.exec, 0);
  for (int c = 0; c < 3; ++c) { keeps_the_rest<test::three_camera_rig>(backend.exec, c); }
}

TYPED_TEST(SplitMotions, LooksWhereNeighboursErredAlikeOrMotionsWereTwoLately) {
  TypeParam backend;
  using room_type = room<typename TypeParam::exec_type, ft::rectified_rig>;
  scene s;
  s.common = 96;
  room_type const calm(backend.exec, s);
  EXPECT_EQ(calm.track().facts.apart, 0);
  EXPECT_NEAR(calm.off(), s.wrong_by, 1e-6);
  EXPECT_TRUE(calm.holds(s.rest + 3));
  s.lately = true;
  room_type const lately(backend.exec, s);
  EXPECT_GE(lately.track().facts.apart, 200);
  EXPECT_LT(lately.off(), 0.004);
}

TYPED_TEST(SplitMotions, OneMotionIsLeftAsItIs) {
  TypeParam backend;
  using room_type = room<typename TypeParam::exec_type, ft::rectified_rig>;
  for (unsigned seed = 1; seed <= 8; ++seed) {
    SCOPED_TRACE(seed);
    scene s;
    s.seed = seed;
    s.noise = 0.7f;
    s.moved = seed % 2 == 0 ? 0.0 : 0.06;
    if (seed % 2 != 0) { s.thing = 15; }  // too few
    room_type const r(backend.exec, s);
    EXPECT_EQ(r.track().facts.apart, 0);
    EXPECT_EQ(r.track().apart, 0);
    EXPECT_EQ(r.data.host.T_cw[0].t.x, s.wrong_by);
    EXPECT_EQ(r.data.host.observations.inliers[0], s.rest + s.thing);
  }
}

// What has more matches, in more parts of the image, is a thing if it hides the rest.
TYPED_TEST(SplitMotions, TheSceneIsWhatIsBehind) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  scene s;
  s.rest = 220;
  s.thing = 400;
  s.half_wide = 250;
  s.half_high = 180;
  s.depth = 1.4f;
  for (s.seed = 1; s.seed <= 4; ++s.seed) {
    SCOPED_TRACE(s.seed);
    scene hides = s;
    hides.near = 2;
    EXPECT_LT((room<exec_type, ft::rectified_rig>(backend.exec, hides).off()), 0.005);
    EXPECT_LT((room<exec_type, test::fisheye_rig>(backend.exec, hides).off()), 0.005);
    scene beside = s;  // at the same distance: spread over the image decides
    beside.near = 1.33f;
    beside.far = 1.47f;
    EXPECT_NEAR((room<exec_type, ft::rectified_rig>(backend.exec, beside).off()), s.moved, 0.005);
    scene hidden;  // in less parts of the image, through a gap
    hidden.seed = s.seed;
    hidden.depth = 5;
    hidden.near = 1.2f;
    hidden.far = 2;
    EXPECT_NEAR((room<exec_type, ft::rectified_rig>(backend.exec, hidden).off()), s.moved, 0.008);
  }
}

/// Parts of the image, of 8 x 6: those that the thing is in, and those that it fills.
constexpr std::uint64_t middle = std::uint64_t{0x3c3c3c3c} << 8;
constexpr std::uint64_t filled = std::uint64_t{0x3c3c} << 16;

TYPED_TEST(SplitMotions, WhereTheOtherMotionIsIsKept) {
  TypeParam backend;
  scene s;
  s.seen_by = 0;
  room<typename TypeParam::exec_type, test::three_camera_rig> const r(backend.exec, s, 2);
  EXPECT_EQ(r.track().apart_camera, 2);
  EXPECT_EQ(r.track().apart_blocks & ~middle, 0u);
  EXPECT_EQ(r.track().apart_blocks & filled, filled);
}

// The last pose followed the thing, and the rest's points are held no more.
TYPED_TEST(SplitMotions, AMotionThatWasLeftOutIsToldButNotTaken) {
  TypeParam backend;
  using room_type = room<typename TypeParam::exec_type, ft::rectified_rig>;
  scene s;
  s.left_out = 0.6;
  room_type const r(backend.exec, s);
  EXPECT_EQ(r.data.host.T_cw[0].t.x, s.wrong_by);
  EXPECT_EQ(r.data.host.observations.inliers[0], s.rest + s.thing);
  EXPECT_EQ(r.data.host.information[0], 0.0f);
  EXPECT_GE(r.track().facts.apart, 200);
  EXPECT_EQ(r.track().apart_ns, r.track().time_ns);
  for (int k = 0; k < s.rest + s.thing + s.free; ++k) {
    bool const was = k >= s.left_out * s.rest && k < s.rest + s.thing;
    EXPECT_EQ(r.holds(k), was);
    EXPECT_TRUE(r.has_depth(k));
  }
  s.left_out = 0.4;
  room_type const most(backend.exec, s);
  EXPECT_LT(most.off(), 0.004);
  EXPECT_LT(most.data.host.observations.inliers[0], s.rest + 10);
}

// Where a thing was half a second ago, keypoints have depths and hold no points.
template <typename Rig, typename Exec>
int told_of(Exec const& exec, scene const& s, int camera = 0) {
  room<Exec, Rig> const r(exec, s, camera);
  EXPECT_EQ(r.track().apart_ns == r.track().time_ns, r.track().facts.apart > 0);
  EXPECT_EQ(r.data.host.T_cw[0].t.x, s.wrong_by);
  if (r.track().facts.apart > 0) { EXPECT_EQ(r.track().facts.apart, r.free_where_filled(s)); }
  return r.track().facts.apart;
}
TYPED_TEST(SplitMotions, AMotionGoesOnWhereMostHoldsNoPoint) {
  TypeParam backend;
  auto const& exec = backend.exec;
  using pair = ft::rectified_rig;
  scene s;
  s.common = 0;
  s.thing = 0;
  s.free = 400;
  s.lately = true;
  s.places = filled;
  EXPECT_GE(told_of<pair>(exec, s), 60);
  EXPECT_GE(told_of<test::three_camera_rig>(exec, s, 2), 60);
  s.seen_by = 1;
  EXPECT_EQ(told_of<test::three_camera_rig>(exec, s, 2), 0);
  s.seen_by = -1;
  s.places = 0;
  EXPECT_EQ(told_of<pair>(exec, s), 0);
  s.places = filled;
  s.free = 60;  // too few of them are there
  EXPECT_EQ(told_of<pair>(exec, s), 0);
  s.free = 400;
  s.moved = 0;
  s.thing = 20;
  EXPECT_GE(told_of<pair>(exec, s), 60);
  s.thing = 120;  // most hold points again
  EXPECT_EQ(told_of<pair>(exec, s), 0);
  s.thing = 0;
  s.lately = false;
  EXPECT_EQ(told_of<pair>(exec, s), 0);
}

// Half of the rest counts 16 times, half once.
TYPED_TEST(SplitMotions, KeypointsThatWereMovedCountInTheInformation) {
  TypeParam backend;
  using room_type = room<typename TypeParam::exec_type, ft::rectified_rig>;
  scene s;
  s.noise = 0.05f;
  room_type const corners(backend.exec, s);
  s.aligned = true;
  room_type const moved(backend.exec, s);
  float const weight = (ft::aligned_at_last * ft::weight_of_aligned + 1) / 2;
  for (int i : {0, 6, 11, 15, 18, 20}) {  // the diagonal
    float const ratio = moved.data.host.information[i] / corners.data.host.information[i];
    EXPECT_NEAR(ratio, weight, 0.15f * weight) << i;
  }
}

TYPED_TEST(SplitMotions, BothExecutorsHaveTheSameBits) {
  TypeParam backend;
  ft::host_exec const host;
  for (unsigned seed = 11; seed < 15; ++seed) {
    scene s;
    s.seed = seed;
    s.aligned = seed % 2 == 0;
    room<typename TypeParam::exec_type, test::fisheye_rig> const a(backend.exec, s);
    room<ft::host_exec, test::fisheye_rig> const b(host, s);
    EXPECT_EQ(a.track().facts.apart, b.track().facts.apart);
    EXPECT_EQ(std::memcmp(a.data.host.T_cw, b.data.host.T_cw, sizeof(ft::pose)), 0);
    std::size_t const terms = sizeof(float) * ft::information_terms;
    EXPECT_EQ(std::memcmp(a.data.host.information, b.data.host.information, terms), 0);
    EXPECT_EQ(std::memcmp(a.data.host.holder, b.data.host.holder, sizeof(int) * capacity), 0);
    EXPECT_EQ(std::memcmp(a.data.host.depth, b.data.host.depth, sizeof(float) * capacity), 0);
  }
}

}  // namespace split_motions_test
