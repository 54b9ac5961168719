// SPDX-License-Identifier: Apache-2.0
// How a map of one camera begins: who looks for a start, the unit of length, and what is handed
// over to the second frame.
#include "ft/kernels/monocular/begin_map.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <random>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/monocular_rig.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/plain_frames.hpp"

namespace begin_map_test {

constexpr int batch = 3;
constexpr int capacity = 64;

/// Everything that the stages read and write.
struct room_view {
  ft::map_beginnings begins;
  ft::start_report* report = nullptr;
  ft::odometry_input* inputs = nullptr;
  ft::camera_track* tracks = nullptr;
  ft::detail::start_progress* progress = nullptr;
  ft::two_view_reconstructions views;
  ft::initial_matches_view matches;
  int* first_count = nullptr;
  std::int64_t* time_ns = nullptr;
};
inline void carve(ft::carver& c, room_view& v) {
  ft::carve(c, v.begins, capacity, batch);
  v.report = c.take<ft::start_report>(batch);
  v.inputs = c.take<ft::odometry_input>(batch);
  v.tracks = c.take<ft::camera_track>(batch);
  v.progress = c.take<ft::detail::start_progress>(batch);
  ft::carve(c, v.views, batch, capacity);
  ft::carve(c, v.matches, capacity, batch);
  v.first_count = c.take<int>(batch);
  v.time_ns = c.take<std::int64_t>(batch);
  v.begins.report = v.report;
}

template <typename Exec>
struct room {
  Exec const& exec;
  test::mirrored<Exec, room_view> own;
  test::mirrored<Exec, test::frames_view> frames;
  ft::pyramid_geometry geometry = ft::pyramid_geometry::make(640, 480, 4, 1.2f);

  explicit room(Exec const& executor)
      : exec(executor),
        own([](ft::carver& c, room_view& v) { carve(c, v); }),
        frames([](ft::carver& c, test::frames_view& v) { carve(c, v, capacity, 1, 1, batch); }) {
    for (int b = 0; b < batch; ++b) {
      own.host.report[b] = {};
      own.host.inputs[b] = {};
      own.host.tracks[b] = ft::camera_track::initial();
      own.host.progress[b] = {1, 5, 0.25};
      own.host.first_count[b] = 0;
      own.host.time_ns[b] = 100 + b;
      *keypoints(b).count = 0;
    }
  }
  ft::keypoints_view keypoints(int b) const { return frames.host.frame().camera(b, 0); }
  void push() {
    own.push(exec);
    frames.push(exec);
  }
  void pull() {
    own.pull(exec);
    frames.pull(exec);
  }
  template <typename Rig>
  void open(Rig const& rig, int patience) {
    push();
    ft::detail::beginning_input<Rig> const in{
        rig, frames.device.frame(), geometry, own.device.inputs, own.device.tracks, patience};
    ft::for_each_item<ft::per_thread>(exec, batch * capacity, ft::detail::open_beginning<Rig>{}, in,
                                      own.device.progress, own.device.begins);
    pull();
  }
  void scale() {
    push();
    ft::for_each_item<ft::per_block<256>>(
        exec, batch, ft::detail::scale_beginning{}, own.device.views,
        static_cast<int const*>(own.device.first_count),
        static_cast<std::int64_t const*>(own.device.time_ns), own.device.begins);
    pull();
  }
  void hand_over() {
    push();
    ft::for_each_item<ft::per_thread>(
        exec, batch * capacity, ft::detail::hand_over_point{}, own.device.matches,
        static_cast<int const*>(own.device.first_count), own.device.begins, frames.device.frame());
    pull();
  }
};

template <typename Backend>
class begin_map : public test::on_backend<Backend> {
protected:
  Backend backend;
};
TYPED_TEST_SUITE(begin_map, test::backends);

TYPED_TEST(begin_map, is_looked_for_without_a_map_and_where_a_camera_is_lost_for_long) {
  room<typename TypeParam::exec_type> r(this->backend.exec);
  for (int b = 0; b < batch; ++b) { *r.keypoints(b).count = 10 + b; }
  r.own.host.tracks[1].state = ft::tracking_state::tracking;
  r.own.host.tracks[2].state = ft::tracking_state::recovering;
  r.own.host.tracks[2].lost_with_features = 4;
  r.own.host.inputs[2].reset = 1;
  auto const rig = ft::monocular_rig<>::make({400.0f, 410.0f, 320.0f, 240.0f});
  r.open(rig, 5);
  EXPECT_EQ(r.own.host.begins.count[0], 10) << "it has no map";
  EXPECT_EQ(r.own.host.begins.count[1], 0) << "it is tracked";
  EXPECT_EQ(r.own.host.begins.count[2], 0) << "it may still be found";
  EXPECT_EQ(r.own.host.progress[0].attempts, 5);
  EXPECT_EQ(r.own.host.progress[2].attempts, 0) << "it begins anew";
  EXPECT_EQ(r.own.host.progress[2].has_first, 0);
  r.own.host.tracks[2].lost_with_features = 5;
  r.open(rig, 5);
  EXPECT_EQ(r.own.host.begins.count[2], 12) << "its patience is over";
}

TYPED_TEST(begin_map, takes_pixels_to_a_pinhole_of_the_same_focal_lengths) {
  room<typename TypeParam::exec_type> r(this->backend.exec);
  using camera = ft::kannala_brandt<float>;
  camera const wide{190.0f, 191.0f, 320.0f, 240.0f, 0.01f, -0.002f, 0.0005f, -0.0001f};
  ft::keypoints_view const kp = r.keypoints(1);
  std::mt19937 random(5);
  std::uniform_real_distribution<float> across(-1, 1);
  std::vector<ft::vec2<double>> expected;
  for (int i = 0; i < 40; ++i) {
    ft::vec3<double> const p{static_cast<double>(across(random)),
                             static_cast<double>(across(random)), 1};
    auto const seen = wide.cast<double>().project(p);
    kp.octave(i) = i % 4;
    kp.x(i) = static_cast<float>(seen.pixel.x);
    kp.y(i) = static_cast<float>(seen.pixel.y);
    expected.push_back({190.0 * p.x + 320.0, 191.0 * p.y + 240.0});
  }
  *kp.count = 40;
  r.open(ft::monocular_rig<camera>::make(wide), 5);
  for (int i = 0; i < 40; ++i) {
    auto const e = expected[static_cast<std::size_t>(i)];
    EXPECT_NEAR(static_cast<double>(r.own.host.begins.pixels.x(capacity + i)), e.x, 2e-3) << i;
    EXPECT_NEAR(static_cast<double>(r.own.host.begins.pixels.y(capacity + i)), e.y, 2e-3) << i;
  }
}

/// Reconstructions of all cameras: the first one has started, the second one took a first frame.
template <typename Room>
void reconstruct(Room& r, unsigned seed, int n) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> away(2, 40);
  auto const& own = r.own.host;
  for (int b = 0; b < batch; ++b) {
    own.first_count[b] = n;
    own.begins.order[b] = ft::keyframe_order::begin_map;
    own.begins.first_ns[b] = -7;
    own.views.result[b] = {};
    own.views.result[b].T_21.R = ft::mat3<float>::identity();
    own.views.result[b].T_21.t = {0.6f, 0.0f, 0.8f};
    for (int i = 0; i < capacity; ++i) {
      int const at = b * capacity + i;
      own.views.point[at] = {0.5f * away(random), -1.0f, away(random)};
      own.views.flags[at] = static_cast<std::uint8_t>(i % 3 == 0 ? ft::two_view_flag::point : 7u);
      own.begins.depth[at] = -5;
      own.begins.holder[at] = 3;
    }
  }
  own.report[0].outcome = ft::start_outcome::started;
  own.report[1].outcome = ft::start_outcome::took_first;
  own.report[2].outcome = ft::start_outcome::no_motion;
}

TYPED_TEST(begin_map, has_the_median_depth_as_its_unit) {
  for (int const n : {1 + 1, 9, 50, capacity}) {
    room<typename TypeParam::exec_type> r(this->backend.exec);
    reconstruct(r, static_cast<unsigned>(n), n);
    r.scale();
    auto const& own = r.own.host;
    std::vector<float> before;
    std::vector<float> depths;
    for (int i = 0; i < n; ++i) {
      if (i % 3 == 0) {
        EXPECT_EQ(own.begins.depth[i], -1.0f) << "it has no certain depth";
        continue;
      }
      before.push_back(own.views.point[i].z);
      depths.push_back(own.begins.depth[i]);
      EXPECT_EQ(own.begins.depth[i], own.begins.point[i].z);
      EXPECT_NEAR(own.begins.point[i].x / own.begins.point[i].z,
                  own.views.point[i].x / own.views.point[i].z, 1e-5f);
    }
    std::sort(before.begin(), before.end());
    std::sort(depths.begin(), depths.end());
    std::size_t const middle = (depths.size() - 1) / 2;
    EXPECT_NEAR(depths[middle], 1.0f, 1e-6f);
    EXPECT_NEAR(own.begins.T_21[0].t.x, 0.6 / static_cast<double>(before[middle]), 1e-7);
    EXPECT_NEAR(own.begins.T_21[0].t.z, 0.8 / static_cast<double>(before[middle]), 1e-7);
    for (int i = 0; i < n; ++i) { EXPECT_EQ(own.begins.holder[i], -1); }
  }
}

TYPED_TEST(begin_map, of_others_changes_no_more_than_the_first_frame_s_time) {
  room<typename TypeParam::exec_type> r(this->backend.exec);
  reconstruct(r, 11, 30);
  r.scale();
  auto const& begins = r.own.host.begins;
  EXPECT_EQ(begins.first_ns[0], -7);
  EXPECT_EQ(begins.first_ns[1], 101) << "it took the frame as its first one";
  EXPECT_EQ(begins.first_ns[2], -7);
  for (int b = 0; b < batch; ++b) { EXPECT_EQ(begins.order[b], ft::keyframe_order::none); }
  for (int i = capacity; i < batch * capacity; ++i) {
    EXPECT_EQ(begins.depth[i], -5.0f);
    EXPECT_EQ(begins.holder[i], 3);
  }
}

TYPED_TEST(begin_map, gives_matches_the_points_of_the_first_frame) {
  room<typename TypeParam::exec_type> r(this->backend.exec);
  auto const& own = r.own.host;
  int* const holder = r.frames.host.holder;
  for (int b = 0; b < batch; ++b) {
    own.first_count[b] = 4;
    own.begins.order[b] = b == 1 ? ft::keyframe_order::none : ft::keyframe_order::begin_map;
    for (int i = 0; i < capacity; ++i) {
      own.matches.match[b * capacity + i] = i < 6 ? 10 + i : -1;
      own.begins.holder[b * capacity + i] = i == 2 ? -1 : 20 * b + i;
      holder[b * capacity + i] = -1;
    }
  }
  own.matches.match[0] = -1;
  r.hand_over();
  auto const held = [&](int b, int i) { return holder[b * capacity + i]; };
  EXPECT_EQ(held(0, 10), -1) << "keypoint 0 has no match";
  EXPECT_EQ(held(0, 11), 1);
  EXPECT_EQ(held(0, 12), -1) << "keypoint 2 has no point";
  EXPECT_EQ(held(0, 13), 3);
  EXPECT_EQ(held(0, 14), -1) << "there are four keypoints";
  EXPECT_EQ(held(2, 10), 40);
  for (int i = 0; i < capacity; ++i) { EXPECT_EQ(held(1, i), -1) << "no map begins there"; }
}

TYPED_TEST(begin_map, has_the_bits_of_the_host) {
  room<typename TypeParam::exec_type> r(this->backend.exec);
  ft::host_exec const alone(1);
  room<ft::host_exec> plain(alone);
  reconstruct(r, 21, 61);
  reconstruct(plain, 21, 61);
  r.scale();
  plain.scale();
  for (int i = 0; i < 61; ++i) {
    ASSERT_EQ(r.own.host.begins.point[i].x, plain.own.host.begins.point[i].x);
    ASSERT_EQ(r.own.host.begins.depth[i], plain.own.host.begins.depth[i]);
  }
  EXPECT_EQ(r.own.host.begins.T_21[0].t.x, plain.own.host.begins.T_21[0].t.x);
}

}  // namespace begin_map_test
