// SPDX-License-Identifier: Apache-2.0
// Rolling shutters beside all else that an odometry has: every kind of rig, keypoints of the
// caller, frames given ahead, batches, loops and loaded maps. The body sways, so that the last row
// sees things up to 10 pixels from where the first one does. Where the rows' times are ignored, the
// path has several times the error.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "ft/any_odometry.hpp"
#include "ft/cameras/any_camera.hpp"
#include "ft/cameras/distorted_pair.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/radtan.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/rolling_walk.hpp"

namespace rolling_rigs_test {

using namespace test::rolling;

// ---- paths

ft::odometry_params params() {
  auto p = test::room::odometry_params(4096);
  p.prefetch = 2;
  return p;
}
ft::rig_description with_readout(ft::rig_description rig, double s) {
  for (int c = 0; c < rig.cameras; ++c) { rig.camera[c].readout_s = s; }
  return rig;
}

/// Of a rig all of whose frames are tracked. @param T_cb of the camera whose pose is told
double error_of(ft::rig_description const& rig, std::vector<pictures> const& walk,
                motion const& T_cb = motion::identity()) {
  auto odo = ft::make_odometry({}, rig, params());
  error_of_path error;
  for (int i = 0; i < swaying.frames; ++i) {
    auto const t = odo.track(images_of(walk[at(i)]), swaying.time_ns(i));
    EXPECT_EQ(t.state, ft::tracking_state::tracking) << i;
    error.add(t.T_world_camera, T_cb * swaying.truth(i) * T_cb.inverse());
  }
  return error.metric();
}
/// @param most of the error, metres
void expect_better(double treated, double ignored, double most) {
  EXPECT_LT(treated, most);
  EXPECT_LT(treated, 0.5 * ignored) << ignored;
}
void expect_better(ft::rig_description const& rig, std::vector<pictures> const& walk, double most,
                   motion const& T_cb = motion::identity()) {
  expect_better(error_of(rig, walk, T_cb), error_of(with_readout(rig, 0), walk, T_cb), most);
}

// ---- rigs

constexpr double cx = 239.5, cy = 179.5;
motion moved(double x, double y = 0, double z = 0) { return {matrix::identity(), {x, y, z}}; }
/// Body to a camera there that is turned about the body's y axis.
motion turned(double yaw, vector const& centre) { return pose_of(yaw, 0, centre).inverse(); }

any lens() { return any::of(ft::pinhole<float>{300, 300, 239.5f, 179.5f}); }
any fisheye() {
  return any::of(
      ft::kannala_brandt<float>{210, 211, 239.5f, 179.5f, -0.012f, 0.003f, -2e-3f, 3e-4f});
}
any distorted() {
  return any::of(
      ft::radtan8<float>{280, 281, 238, 181, {-0.21f, 0.06f, 4e-4f, -3e-4f, 0, 0, 0, 0}});
}
ft::camera_description description(any const& camera, motion const& T_cb = motion::identity(),
                                   double s = readout) {
  ft::camera_description c;
  for (auto const kind : {ft::camera_kind::kannala_brandt, ft::camera_kind::radtan8}) {
    if (camera.is(kind)) { c.kind = kind; }
  }
  auto const exact = camera.cast<double>();
  double const first[] = {exact.fx, exact.fy, exact.cx, exact.cy};
  std::copy(first, first + 4, c.parameters);
  std::copy(exact.more, exact.more + 8, c.parameters + 4);
  c.T_camera_body = T_cb;
  c.readout_s = s;
  return c;
}
ft::rig_description multi(std::vector<ft::camera_description> const& cameras) {
  ft::rig_description rig;
  rig.kind = ft::rig_kind::multi;
  rig.cameras = static_cast<int>(cameras.size());
  std::copy(cameras.begin(), cameras.end(), rig.camera);
  return rig;
}
ft::rig_description pair() {
  return with_readout(ft::rig_description::rectified_pair(focal, focal, cx, cy, baseline), readout);
}
std::vector<mounted> pair_at(motion const& T_cb, double s = readout) {
  return {{lens(), T_cb, s}, {lens(), moved(-baseline) * T_cb, s}};
}
std::vector<pictures> const& pair_walk() {
  static auto const all = walk_of(pair_at(motion::identity()));
  return all;
}

TEST(rolling_rigs, a_rectified_pair) { expect_better(pair(), pair_walk(), 0.01); }

TEST(rolling_rigs, a_fisheye_pair) {
  motion const T_rl = pose_of(-0.02, 0.01, {-0.25, 0.004, 0.002});
  expect_better(
      ft::rig_description::fisheye_pair(description(fisheye()), description(fisheye()), T_rl),
      walk_of({{fisheye()}, {fisheye(), T_rl}}), 0.01);
}

TEST(rolling_rigs, a_distorted_pair) {
  motion const T_rl = pose_of(-0.03, 0.015, {-0.25, 0.006, -0.004});
  ft::radtan8<float> const of{280, 281, 238, 181, {-0.21f, 0.06f, 4e-4f, -3e-4f, 0, 0, 0, 0}};
  ft::rig_description rig = multi({description(distorted()), description(distorted(), T_rl)});
  rig.kind = ft::rig_kind::distorted_pair;
  double const rectified[] = {270, 270, 239.5, 179.5};
  std::copy(rectified, rectified + 4, rig.rectified);
  auto const same = ft::distorted_pair<ft::radtan8<float>>::make(of, of, T_rl.cast<float>(),
                                                                 {270, 270, 239.5f, 179.5f});
  expect_better(rig, walk_of({{distorted()}, {distorted(), T_rl}}), 0.01, {same.R_left, {0, 0, 0}});
}

TEST(rolling_rigs, depth_images) {
  for (any const& camera : {lens(), distorted()}) {
    auto const rig = ft::rig_description::rgbd(description(camera), baseline);
    expect_better(rig, walk_of({{camera, motion::identity(), readout, true}}), 0.01);
  }
}

/// Its keypoints have the depths of map points alone. The unit of its map is any.
TEST(rolling_rigs, one_camera) {
  auto p = params();
  p.prefetch = 0;
  double sum[2] = {0, 0};
  for (any const& camera : {lens(), fisheye()}) {
    auto const walk = walk_of({{camera}}, beginning);
    double error[2];
    for (double const s : {readout, 0.0}) {
      auto odo = ft::make_odometry(
          {}, with_readout(ft::rig_description::monocular(description(camera)), s), p);
      error_of_path path;
      for (int i = 0; i < beginning.frames; ++i) {
        auto const t = odo.track(images_of(walk[at(i)]), beginning.time_ns(i));
        if (t.state != ft::tracking_state::tracking) { continue; }
        path.add(t.T_world_camera, beginning.truth(i));
      }
      EXPECT_GT(path.frames(), 30u);
      error[s > 0 ? 0 : 1] = path.scaled();
    }
    // How a map of one camera begins is a matter of chance: half is asked of both.
    EXPECT_LT(error[0], 0.025);
    EXPECT_LT(error[0], error[1]);
    for (int k = 0; k < 2; ++k) { sum[k] += error[k]; }
  }
  EXPECT_LT(sum[0], 0.5 * sum[1]);
}

/// A pair ahead, a single camera aside, and one with a global shutter, each at its own time.
TEST(rolling_rigs, cameras_with_readouts_of_their_own) {
  motion const ahead = turned(0.1, {0.1, 0.02, 0.2}), left = turned(-1, {-0.1, 0, 0}),
               right = turned(1.2, {0.2, 0, -0.1});
  auto first = description(lens(), ahead);
  first.baseline = baseline;
  auto const rig = multi({first, description(lens(), left, 0.02), description(lens(), right, 0)});
  auto cameras = pair_at(ahead);
  cameras.push_back({lens(), left, 0.02});
  cameras.push_back({lens(), right, 0});
  expect_better(rig, walk_of(cameras), 0.01);
}

/// A fisheye pair, and a distorted camera with depth images aside.
TEST(rolling_rigs, cameras_of_several_models) {
  motion const T_rl = pose_of(-0.02, 0.01, {-0.25, 0.004, 0.002});
  motion const aside = turned(-1.2, {-0.2, 0.05, 0});
  auto left = description(fisheye());
  left.right = 1;
  auto depth = description(distorted(), aside);
  depth.has_depth_image = true;
  depth.baseline = 0.1;
  expect_better(multi({left, description(fisheye(), T_rl), depth}),
                walk_of({{fisheye()}, {fisheye(), T_rl}, {distorted(), aside, readout, true}}),
                0.01);
}

/// A lens of another model below: both see a point in other rows, so at other times.
TEST(rolling_rigs, cameras_one_above_the_other) {
  motion const below = moved(0, -0.2);
  auto upper = description(fisheye());
  upper.right = 1;
  expect_better(multi({upper, description(fisheye(), below)}),
                walk_of({{fisheye()}, {fisheye(), below}}), 0.01);
}
TEST(rolling_rigs, a_pair_of_which_one_is_global) {
  motion const beside = moved(-baseline);
  auto left = description(fisheye());
  left.right = 1;
  expect_better(multi({left, description(fisheye(), beside, 0)}),
                walk_of({{fisheye()}, {fisheye(), beside, 0}}), 0.01);
}

// ---- frames given ahead, and batches

TEST(rolling_rigs, frames_given_ahead_have_the_same_answers) {
  auto whole = ft::make_odometry({}, pair(), params());
  auto ahead = ft::make_odometry({}, pair(), params());
  auto ignored = ft::make_odometry({}, with_readout(pair(), 0), params());
  std::vector<ft::tracking> all, other;
  for (int i = 0; i < swaying.frames; ++i) {
    all.push_back(whole.track(images_of(pair_walk()[at(i)]), swaying.time_ns(i)));
    other.push_back(ignored.track(images_of(pair_walk()[at(i)]), swaying.time_ns(i)));
  }
  EXPECT_FALSE(test::same(all.back(), other.back()));
  test::expect_same(all, test::track_all(ahead, pair_walk().size(), swaying.time_ns(0),
                                         [](std::size_t i) { return images_of(pair_walk()[i]); }));
}

TEST(rolling_rigs, a_batch_has_the_answers_of_each) {
  auto const back = walk_of(pair_at(motion::identity()), swaying_back);
  std::vector<pictures> const* const walks[] = {&pair_walk(), &back};
  auto both = ft::make_odometry({}, pair(), params(), 2);
  std::vector<ft::tracking> found[2];
  for (int i = 0; i < swaying.frames; ++i) {
    ft::any_images const images[] = {images_of(pair_walk()[at(i)]), images_of(back[at(i)])};
    std::int64_t const times[] = {swaying.time_ns(i), swaying.time_ns(i)};
    both.prefetch(images);
    ft::tracking const* const t = both.track_prefetched(times);
    for (int b = 0; b < 2; ++b) { found[b].push_back(t[b]); }
  }
  for (int b = 0; b < 2; ++b) {
    auto alone = ft::make_odometry({}, pair(), params());
    std::vector<ft::tracking> one;
    error_of_path error;
    for (int i = 0; i < swaying.frames; ++i) {
      one.push_back(alone.track(images_of((*walks[b])[at(i)]), swaying.time_ns(i)));
      error.add(one.back().T_world_camera, (b == 0 ? swaying : swaying_back).truth(i));
    }
    test::expect_same(found[b], one);
    EXPECT_LT(error.metric(), 0.01) << b;
  }
}

// ---- keypoints of the caller

/// @param give of a frame number, calls what it is given with the features
template <typename Give>
double error_of_given(ft::rig_description const& rig, way const& along, Give const& give) {
  bool const unit_is_known = rig.kind != ft::rig_kind::monocular;
  auto p = params();
  p.own_features = true;
  p.prefetch = 0;
  auto odo = ft::make_odometry({}, rig, p);
  error_of_path error;
  for (int i = 0; i < along.frames; ++i) {
    give(i, [&](ft::given_features const& f) {
      auto const t = odo.track(f, along.time_ns(i));
      if (unit_is_known) { EXPECT_EQ(t.state, ft::tracking_state::tracking) << i; }
      if (t.state == ft::tracking_state::tracking) { error.add(t.T_world_camera, along.truth(i)); }
    });
  }
  EXPECT_GT(error.frames(), 10u);
  return unit_is_known ? error.metric() : error.scaled();
}
template <typename Give>
void expect_better_given(ft::rig_description const& rig, way const& along, double most,
                         Give const& give) {
  expect_better(error_of_given(rig, along, give), error_of_given(with_readout(rig, 0), along, give),
                most);
}

TEST(rolling_rigs, keypoints_of_the_caller) {
  marks const all;
  auto const seen = [&](any const& camera, double x, int i) {
    return all.by(camera, moved(x), swaying, i);
  };
  // Partners are given as columns or depths, or are found.
  for (int const partners : {0, 1, 2}) {
    expect_better_given(pair(), swaying, 0.01, [&](int i, auto const& track) {
      auto const left = seen(lens(), 0, i), right = seen(lens(), -baseline, i);
      ft::given_features f{left.view(), right.view()};
      if (partners == 1) { f.left.right_x = left.right_x.data(); }
      if (partners == 2) { f.left.depth = left.depth.data(); }
      track(f);
    });
  }
  for (any const& camera : {lens(), distorted()}) {
    expect_better_given(ft::rig_description::rgbd(description(camera), baseline), swaying, 0.01,
                        [&](int i, auto const& track) {
                          auto const one = seen(camera, 0, i);
                          ft::given_features f{one.view(), {}};
                          f.left.depth = one.depth.data();
                          track(f);
                        });
  }
  expect_better_given(ft::rig_description::monocular(description(lens())), beginning, 0.04,
                      [&](int i, auto const& track) {
                        track({all.by(lens(), motion::identity(), beginning, i).view(), {}});
                      });
}

// ---- loops and loaded maps

TEST(rolling_rigs, loops_are_closed) {
  auto const walk = walk_of(pair_at(motion::identity()), circle);
  auto p = test::room::odometry_params(8192);
  p.window = {4, 2};
  p.keyframes = 12;  // the odometry itself has forgotten where it began
  p.local_map.keyframes = 8;
  p.loops.present = true;
  p.loops.recent = 20;
  double last[2], keyframes[2];
  for (double const s : {readout, 0.0}) {
    auto odo = ft::make_odometry({}, with_readout(pair(), s), p);
    ft::tracking t;
    int closed = 0;
    for (int i = 0; i < circle.frames; ++i) {
      t = odo.track(images_of(walk[at(i)]), circle.time_ns(i));
      EXPECT_EQ(t.state, ft::tracking_state::tracking) << i;
      closed += t.loops_closed;
    }
    if (s > 0) { EXPECT_GT(closed, 0); }
    error_of_path end, kept;
    end.add(t.T_world_camera, circle.truth(circle.frames - 1));
    for (auto const& k : odo.placed_keyframes()) {
      kept.add(k.T_world_camera, circle.truth(static_cast<int>(k.time_ns / circle.time_ns(0)) - 1));
    }
    last[s > 0 ? 0 : 1] = end.metric();
    keyframes[s > 0 ? 0 : 1] = kept.metric();
  }
  expect_better(last[0], last[1], 0.01);
  expect_better(keyframes[0], keyframes[1], 0.02);
}

TEST(rolling_rigs, a_loaded_map_is_gone_on_with) {
  std::stringstream map;
  auto before = ft::make_odometry({}, pair(), params());
  for (int i = 0; i < swaying.frames; ++i) {
    before.track(images_of(pair_walk()[at(i)]), swaying.time_ns(i));
  }
  before.save_map(map);
  double error[2];
  for (double const s : {readout, 0.0}) {
    auto odo = ft::make_odometry({}, with_readout(pair(), s), params());
    map.clear();
    map.seekg(0);
    odo.load_map(map);
    error_of_path path;
    for (int i = 0; i < swaying.frames; ++i) {
      auto const t =
          odo.track(images_of(pair_walk()[at(i)]), swaying.time_ns(i + 2 * swaying.frames));
      EXPECT_EQ(t.state, ft::tracking_state::tracking) << i;
      path.add(t.T_world_camera, swaying.truth(i));
    }
    error[s > 0 ? 0 : 1] = path.metric();
  }
  expect_better(error[0], error[1], 0.012);
}

}  // namespace rolling_rigs_test
