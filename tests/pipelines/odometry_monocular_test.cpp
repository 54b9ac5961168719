// SPDX-License-Identifier: Apache-2.0
// One camera from nothing: a map that begins from motion, in a batch and alone, darkness, and what
// is refused.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <vector>

#include "ft/cameras/monocular_rig.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/room.hpp"

namespace odometry_monocular_test {

using test::room::stereo_frame;
constexpr std::int64_t period = 50'000'000;
using rig_type = ft::monocular_rig<ft::pinhole<float>>;

rig_type rig() { return rig_type::make(test::room::rig().camera); }

ft::odometry_params params() {
  auto p = test::room::odometry_params(8192);
  p.orb.features = 1000;
  return p;
}

std::vector<stereo_frame> const& walk() {
  static auto const frames = test::room::make_walk(test::room::rig(), 0, 30);
  return frames;
}

/// Root mean square error of the positions from frame `from` on, as a share of the path. The pose
/// of that frame is taken as true, and the scale is the one that fits best.
double error_of(std::vector<ft::tracking> const& all, std::size_t from,
                std::vector<stereo_frame> const& frames) {
  auto const truth = [&](std::size_t i) {
    auto const T = frames[from].T_cw.cast<double>() * frames[i].T_cw.cast<double>().inverse();
    return T.t;
  };
  auto const T_fw = all[from].T_world_camera.inverse();
  auto const seen = [&](std::size_t i) { return (T_fw * all[i].T_world_camera).t; };
  double both = 0, own = 0, path = 0;
  for (std::size_t i = from + 1; i < all.size(); ++i) {
    both += ft::dot(seen(i), truth(i));
    own += ft::dot(seen(i), seen(i));
    auto const step = truth(i) - truth(i - 1);
    path += std::sqrt(ft::dot(step, step));
  }
  double const scale = both / own;
  double sum = 0;
  for (std::size_t i = from; i < all.size(); ++i) {
    auto const d = ft::scaled(seen(i), scale) - truth(i);
    sum += ft::dot(d, d);
  }
  return std::sqrt(sum / static_cast<double>(all.size() - from)) / path;
}

/// The first frame with a map.
std::size_t begin_of(std::vector<ft::tracking> const& all) {
  std::size_t i = 0;
  while (i < all.size() && all[i].state == ft::tracking_state::initialising) { ++i; }
  return i;
}

template <typename Exec>
std::vector<ft::tracking> run(ft::odometry<Exec, rig_type>& odo,
                              std::vector<stereo_frame> const& frames, std::int64_t time = 0) {
  std::vector<ft::tracking> all;
  for (auto const& f : frames) {
    all.push_back(odo.track(test::room::view(f.left), time += period));
  }
  return all;
}

template <typename Backend>
class monocular_odometry : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(monocular_odometry, test::backends);

TYPED_TEST(monocular_odometry, has_no_prefetch) {
  TypeParam backend;
  auto p = params();
  p.prefetch = 1;
  using odometry = ft::odometry<typename TypeParam::exec_type, rig_type>;
  EXPECT_THROW(odometry(backend.exec, rig(), p), ft::bad_argument);
}

TYPED_TEST(monocular_odometry, begins_from_motion_and_follows_a_walk) {
  TypeParam backend;
  ft::odometry<decltype(backend.exec), rig_type> odo(backend.exec, rig(), params());
  auto const all = run(odo, walk());
  std::size_t const begin = begin_of(all);
  ASSERT_LT(begin, 20u);
  EXPECT_EQ(all[begin].keyframes, 2);
  EXPECT_FALSE(all[begin].metric);
  for (std::size_t i = begin; i < all.size(); ++i) {
    EXPECT_EQ(all[i].state, ft::tracking_state::tracking) << i;
    EXPECT_EQ(all[i].maps, 1) << i;
    EXPECT_EQ(all[i].left_out, 0) << i;
  }
  EXPECT_GT(all.back().keyframes, 2);
  EXPECT_LT(error_of(all, begin, walk()), 0.01);
}

TYPED_TEST(monocular_odometry, has_the_answers_of_the_host) {
  TypeParam backend;
  ft::odometry<decltype(backend.exec), rig_type> odo(backend.exec, rig(), params());
  ft::host_exec const host(1);
  ft::odometry<ft::host_exec, rig_type> other(host, rig(), params());
  auto const all = run(odo, walk());
  auto const expected = run(other, walk());
  for (std::size_t i = 0; i < all.size(); ++i) {
    EXPECT_EQ(all[i].state, expected[i].state) << i;
    EXPECT_EQ(all[i].inliers, expected[i].inliers) << i;
    EXPECT_EQ(all[i].map_points, expected[i].map_points) << i;
    for (int k = 0; k < 9; ++k) {
      EXPECT_EQ(all[i].T_world_camera.R.m[k], expected[i].T_world_camera.R.m[k]) << i;
    }
    EXPECT_EQ(all[i].T_world_camera.t.x, expected[i].T_world_camera.t.x) << i;
    EXPECT_EQ(all[i].T_world_camera.t.y, expected[i].T_world_camera.t.y) << i;
    EXPECT_EQ(all[i].T_world_camera.t.z, expected[i].T_world_camera.t.z) << i;
  }
}

TYPED_TEST(monocular_odometry, begins_anew_after_a_reset_with_the_same_answers) {
  TypeParam backend;
  ft::odometry<decltype(backend.exec), rig_type> odo(backend.exec, rig(), params());
  auto const frames = walk();
  auto const first = run(odo, frames);
  odo.reset();
  auto const again = run(odo, frames);
  ASSERT_EQ(begin_of(first), begin_of(again));
  for (std::size_t i = 0; i < first.size(); ++i) {
    EXPECT_EQ(first[i].state, again[i].state) << i;
    EXPECT_EQ(first[i].map_points, again[i].map_points) << i;
    EXPECT_EQ(first[i].T_world_camera.t.x, again[i].T_world_camera.t.x) << i;
    EXPECT_EQ(first[i].T_world_camera.t.z, again[i].T_world_camera.t.z) << i;
  }
}

TYPED_TEST(monocular_odometry, tracks_a_batch_as_each_camera_alone) {
  TypeParam backend;
  using odometry_type = ft::odometry<decltype(backend.exec), rig_type>;
  auto const ahead = walk();
  std::vector<stereo_frame> const later(ahead.begin() + 2, ahead.end());
  odometry_type one(backend.exec, rig(), params());
  odometry_type other(backend.exec, rig(), params());
  auto const alone = run(one, {ahead.begin(), ahead.end() - 2});
  auto const beside = run(other, later);
  // On a device, images of eight cameras are uploaded in parts.
  int const batch = backend.exec.asynchronous ? 8 : 2;
  odometry_type both(backend.exec, rig(), params(), batch);
  std::int64_t time = 0;
  for (std::size_t i = 0; i < later.size(); ++i) {
    time += period;
    std::vector<ft::gray_view> images;
    for (int b = 0; b < batch; ++b) {
      images.push_back(test::room::view(b % 2 == 0 ? ahead[i].left : later[i].left));
    }
    std::vector<std::int64_t> const times(images.size(), time);
    ft::tracking const* const got = both.track(images.data(), times.data());
    for (int b = 0; b < batch; ++b) {
      ft::tracking const& expected = b % 2 == 0 ? alone[i] : beside[i];
      EXPECT_EQ(got[b].state, expected.state) << i;
      EXPECT_EQ(got[b].inliers, expected.inliers) << i;
      EXPECT_EQ(got[b].map_points, expected.map_points) << i;
      EXPECT_EQ(got[b].T_world_camera.t.x, expected.T_world_camera.t.x) << i;
      EXPECT_EQ(got[b].T_world_camera.t.z, expected.T_world_camera.t.z) << i;
    }
  }
}

TYPED_TEST(monocular_odometry, is_found_again_after_darkness) {
  TypeParam backend;
  auto frames = walk();
  frames.resize(26);
  ft::odometry<decltype(backend.exec), rig_type> odo(backend.exec, rig(), params());
  frames[1].left.assign(frames[1].left.size(), 0);
  frames[23].left.assign(frames[23].left.size(), 0);
  auto const all = run(odo, frames);
  std::size_t const begin = begin_of(all);
  ASSERT_LT(begin, 22u);
  EXPECT_EQ(all[23].state, ft::tracking_state::recovering);
  EXPECT_EQ(all[25].state, ft::tracking_state::tracking);
  EXPECT_EQ(all[25].maps, 1);
}

TYPED_TEST(monocular_odometry, refuses_what_it_cannot_use) {
  TypeParam backend;
  using odometry_type = ft::odometry<decltype(backend.exec), rig_type>;
  auto p = params();
  p.orb.start_features = p.orb.features - 1;
  EXPECT_THROW(odometry_type(backend.exec, rig(), p), ft::bad_argument);
  EXPECT_THROW(rig_type::make({0.0f, 300.0f, 0.0f, 0.0f}), ft::bad_argument);
  odometry_type odo(backend.exec, rig(), params());
  EXPECT_THROW(odo.track(ft::gray_view{}, 1), ft::bad_argument);
}

}  // namespace odometry_monocular_test
