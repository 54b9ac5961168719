// SPDX-License-Identifier: Apache-2.0
// What follows for lost cameras of an odometry after their places were looked up.
#include "ft/kernels/odometry/settle_lost.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "tests/support/backends.hpp"
#include "tests/support/plain_map.hpp"

namespace settle_lost_test {

constexpr int capacity = 8;
constexpr int held = 5;  ///< keypoints that hold a point after the look-up; as many are there

struct arrays {
  ft::keypoints_view keypoints;
  int* holder = nullptr;
  ft::place_outcome* outcome = nullptr;
  ft::pose* found_T_cw = nullptr;
  int* found_inliers = nullptr;
  std::int64_t* found_evidence = nullptr;
  ft::pose* T_cw = nullptr;
  int* inliers = nullptr;
  int* matches = nullptr;
  unsigned char* matched = nullptr;
  ft::keyframe_order* begins = nullptr;
  ft::odometry_state_view state;
};

constexpr std::int64_t plain = std::int64_t{ft::tracking_rules{}.min_evidence} << 16;

/// What a camera comes with, and becomes.
struct camera {
  ft::place_outcome outcome;
  int found_inliers;
  int lost_with_features;
  int gather = 0;
  int adjusting = 0;
  std::int64_t evidence = plain;
};

/// Cameras that were lost at x = 1 m, and found, if so, at x = 5 m.
template <typename Exec>
struct room {
  Exec const& exec;
  int batch;
  ft::tracking_rules rules;
  test::mirrored<Exec, arrays> data;

  room(Exec const& on, std::vector<camera> const& cameras)
      : exec(on), batch(static_cast<int>(cameras.size())), data([&](ft::carver& c, arrays& v) {
          auto const n = cameras.size();
          carve(c, v.keypoints, capacity, static_cast<int>(n));
          v.holder = c.take<int>(n * capacity);
          v.outcome = c.take<ft::place_outcome>(n);
          v.found_T_cw = c.take<ft::pose>(n);
          v.found_inliers = c.take<int>(n);
          v.found_evidence = c.take<std::int64_t>(n);
          v.T_cw = c.take<ft::pose>(n);
          v.inliers = c.take<int>(n);
          v.matches = c.take<int>(n);
          v.matched = c.take<unsigned char>(n * capacity);
          v.begins = c.take<ft::keyframe_order>(n);
          carve(c, v.state, static_cast<int>(n));
        }) {
    for (std::size_t b = 0; b < cameras.size(); ++b) { put(b, cameras[b]); }
    data.push(exec);
    arrays const& there = data.device;
    ft::looked_up_frames in{};
    in.frame.keypoints = there.keypoints;
    in.frame.batch = batch;
    in.frame.keypoint_step = in.frame.cameras = 1;
    in.frame.holder = there.holder;
    in.outcome = there.outcome;
    in.found_T_cw = there.found_T_cw;
    in.found_inliers = there.found_inliers;
    in.found_evidence = there.found_evidence;
    in.T_cw = there.T_cw;
    in.inliers = there.inliers;
    in.matches = there.matches;
    in.matched = there.matched;
    in.begins = there.begins;
    ft::settle_lost_frames(exec, rules, in, there.state);
    data.pull(exec);
  }
  int holders(int b) const {
    int const* const of = data.host.holder + b * capacity;
    return static_cast<int>(std::count_if(of, of + capacity, [](int h) { return h >= 0; }));
  }
  int matched(int b) const {
    unsigned char const* const of = data.host.matched + b * capacity;
    return static_cast<int>(std::count(of, of + capacity, 1));
  }

private:
  void put(std::size_t b, camera const& from) {
    arrays const& v = data.host;
    v.keypoints.count[b] = capacity - 2;
    for (std::size_t i = 0; i < capacity; ++i) {
      // A number beyond the count is garbage.
      v.holder[b * capacity + i] = i < held || i == capacity - 1 ? static_cast<int>(i) : -1;
      v.matched[b * capacity + i] = 7;
    }
    v.outcome[b] = from.outcome;
    v.found_T_cw[b] = ft::pose::identity();
    v.found_T_cw[b].t.x = 5;
    v.found_inliers[b] = from.found_inliers;
    v.found_evidence[b] = from.evidence;
    v.T_cw[b] = ft::pose::identity();
    v.inliers[b] = v.matches[b] = 0;
    v.begins[b] = ft::keyframe_order::add;
    ft::camera_track t = ft::camera_track::initial();
    t.state = ft::tracking_state::recovering;
    t.lost_frames = 9;
    t.lost_with_features = from.lost_with_features;
    t.maps = 1;
    t.keyframes = t.map_keyframes = 4;
    t.adjusting = from.adjusting;
    v.state.tracks[b] = t;
    v.state.T_cw[b] = ft::rigid<double>::identity();
    v.state.T_cw[b].t.x = 1;
    v.state.order[b] = ft::keyframe_order::none;
    v.state.gather[b] = from.gather;
  }
};

template <typename Backend>
class SettleLost : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(SettleLost, test::backends);

using outcome = ft::place_outcome;

TYPED_TEST(SettleLost, ACameraThatIsFoundIsTracked) {
  TypeParam backend;
  int const enough = ft::tracking_rules{}.min_recovered;
  room<typename TypeParam::exec_type> r(backend.exec,
                                        {{outcome::known, enough, 4},
                                         {outcome::known, enough - 1, 4},
                                         {outcome::known, 10 * enough, 4, 0, 0, plain - 1}});
  arrays const& v = r.data.host;
  EXPECT_EQ(v.state.tracks[0].state, ft::tracking_state::tracking);
  EXPECT_EQ(v.state.tracks[0].lost_frames, 0);
  EXPECT_EQ(v.state.tracks[0].lost_with_features, 0);
  EXPECT_FALSE(v.state.tracks[0].velocity.known());
  EXPECT_EQ(v.state.T_cw[0].t.x, 5);
  EXPECT_EQ(v.T_cw[0].t.x, 5);
  EXPECT_EQ(v.inliers[0], enough);
  EXPECT_EQ(v.matches[0], held);
  EXPECT_EQ(r.holders(0), held);
  EXPECT_EQ(r.matched(0), held);
  EXPECT_EQ(v.state.tracks[2].state, ft::tracking_state::recovering) << "too little evidence";
  EXPECT_EQ(v.inliers[2], 0);
  // With fewer inliers it is not found.
  EXPECT_EQ(v.state.tracks[1].state, ft::tracking_state::recovering);
  EXPECT_EQ(v.state.tracks[1].lost_frames, 9);
  EXPECT_EQ(v.state.T_cw[1].t.x, 1);
  EXPECT_EQ(v.inliers[1], 0);
  EXPECT_EQ(r.holders(1), 0);
  EXPECT_EQ(r.matched(1), 0);
  for (int b = 0; b < 2; ++b) { EXPECT_EQ(v.begins[b], ft::keyframe_order::none); }
}

TYPED_TEST(SettleLost, AMapBeginsWhereThePlaceIsKnown) {
  TypeParam backend;
  int const enough = ft::tracking_rules{}.min_recovered;
  room<typename TypeParam::exec_type> r(
      backend.exec, {{outcome::begins_map, enough, 0, 1, 1}, {outcome::begins_map, enough - 1, 0}});
  arrays const& v = r.data.host;
  EXPECT_EQ(v.state.tracks[0].state, ft::tracking_state::tracking);
  EXPECT_EQ(v.state.tracks[0].maps, 2);
  EXPECT_EQ(v.state.tracks[0].keyframes, 5);
  EXPECT_EQ(v.state.tracks[0].keyframe.t.x, 5);
  EXPECT_EQ(v.state.T_cw[0].t.x, 5);
  EXPECT_EQ(v.inliers[0], enough);
  EXPECT_EQ(v.begins[0], ft::keyframe_order::begin_map);
  EXPECT_EQ(v.state.order[0], ft::keyframe_order::begin_map);
  EXPECT_EQ(v.state.gather[0], 0);
  EXPECT_EQ(v.state.tracks[1].state, ft::tracking_state::recovering);
  EXPECT_EQ(v.state.tracks[1].maps, 1);
  EXPECT_EQ(v.state.T_cw[1].t.x, 1);
  EXPECT_EQ(v.begins[1], ft::keyframe_order::none);
}

TYPED_TEST(SettleLost, ANewMapBeginsWhenPatienceIsAtItsEnd) {
  TypeParam backend;
  int const patience = ft::tracking_rules{}.patience;
  room<typename TypeParam::exec_type> r(backend.exec, {{outcome::unknown, 99, patience - 1},
                                                       {outcome::unknown, 99, patience},
                                                       {outcome::unknown, 99, patience, 1, 1},
                                                       {outcome::unknown, 99, patience, 0, 1},
                                                       {outcome::known, 99, patience}});
  arrays const& v = r.data.host;
  for (int b = 0; b < r.batch; ++b) {
    SCOPED_TRACE(b);
    bool const begins = b >= 1 && b <= 3;
    auto const order = begins ? ft::keyframe_order::begin_map : ft::keyframe_order::none;
    EXPECT_EQ(v.begins[b], order);
    EXPECT_EQ(v.state.order[b], order);
    EXPECT_EQ(v.state.gather[b], 0);
    EXPECT_EQ(v.state.tracks[b].maps, begins ? 2 : 1);
    EXPECT_EQ(v.state.tracks[b].keyframes, begins ? 5 : 4);
    EXPECT_EQ(v.state.tracks[b].map_keyframes, begins ? 1 : 4);
    EXPECT_EQ(v.state.tracks[b].state == ft::tracking_state::tracking, b != 0);
  }
  // An adjustment that only was gathered does not begin; one in flight is of a map that is gone.
  EXPECT_EQ(v.state.tracks[2].adjusting, 0);
  EXPECT_EQ(v.state.tracks[3].adjusting, 2);
}

TYPED_TEST(SettleLost, OtherCamerasStayAsTheyAre) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(
      backend.exec, {{outcome::not_lost, 99, 99, 1, 1}, {outcome::known, 99, 0, 1, 1}});
  arrays const& v = r.data.host;
  EXPECT_EQ(v.state.tracks[0].lost_frames, 9);
  EXPECT_EQ(v.state.T_cw[0].t.x, 1);
  EXPECT_EQ(v.holder[capacity - 1], capacity - 1);
  EXPECT_EQ(v.matched[0], 7);
  EXPECT_EQ(v.begins[0], ft::keyframe_order::none);
  // An adjustment of a camera that is found goes on.
  for (int b = 0; b < 2; ++b) {
    EXPECT_EQ(v.state.gather[b], 1);
    EXPECT_EQ(v.state.tracks[b].adjusting, 1);
  }
}

}  // namespace settle_lost_test
