// SPDX-License-Identifier: Apache-2.0
// An odometry that only finds itself in a loaded map: poses are those of one that goes on, the map
// stays byte for byte, and a camera that is elsewhere stays lost.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "ft/cameras/monocular_rig.hpp"
#include "ft/core/error.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/random.hpp"
#include "tests/support/room.hpp"

namespace localize_only_test {

using test::at;
using test::load;
using test::same;
using test::saved;
using one_camera = ft::monocular_rig<ft::pinhole<float>>;
constexpr std::int64_t period = 50'000'000;
constexpr int mapped = 26;  ///< frames
constexpr int from = 18;    ///< a camera that is localised begins here

ft::odometry_params params(bool localize_only) {
  auto p = test::room::odometry_params(8192);
  p.orb.features = 1000;
  p.window = {4, 2};
  p.rules.localize_only = localize_only;
  return p;
}
std::vector<test::room::stereo_frame> const& walk(unsigned room) {
  static std::vector<test::room::stereo_frame> const all[] = {
      test::room::make_walk(test::room::rig(), 0, mapped),
      test::room::make_walk(test::room::rig(), 1, mapped)};
  return all[room];
}
auto images(ft::rectified_rig const&, test::room::stereo_frame const& f) {
  return test::room::images_of(f);
}
auto images(one_camera const&, test::room::stereo_frame const& f) {
  return test::room::view(f.left);
}

/// Frames of a room at times that go on. @return what is told of each
template <typename Odometry>
std::vector<ft::tracking> follow(Odometry& odo, unsigned room, int begin, int end,
                                 std::int64_t& time) {
  std::vector<ft::tracking> told;
  for (int i = begin; i < end; ++i) {
    told.push_back(odo.track(images(odo.rig(), walk(room)[at(i)]), time += period));
  }
  return told;
}

template <typename Backend>
class LocalizeOnly : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(LocalizeOnly, test::backends);

template <typename Exec, typename Rig>
void finds_itself(Exec const& exec, Rig const& rig) {
  using odometry = ft::odometry<Exec, Rig>;
  std::int64_t time = 0;
  odometry maps(exec, rig, params(false));
  auto const mapping = follow(maps, 0, 0, mapped, time);
  std::string const map = saved(maps);

  odometry goes_on(exec, rig, params(false));
  odometry localizes(exec, rig, params(true));
  load(goes_on, map);
  load(localizes, map);
  std::int64_t there = 0, here = 0;
  auto const other = follow(goes_on, 0, from, mapped, there);
  auto const told = follow(localizes, 0, from, mapped, here);
  bool has_grown = false;  // what both saw before is the same
  for (std::size_t i = 0; i < told.size(); ++i) {
    ft::tracking const& t = told[i];
    ASSERT_EQ(t.state, ft::tracking_state::tracking) << i;
    EXPECT_FALSE(t.keyframe || t.map_begun) << i;
    EXPECT_EQ(t.map_id, 1);
    EXPECT_EQ(t.keyframes, mapping.back().keyframes);
    if (!has_grown) {
      EXPECT_TRUE(same(t.T_world_camera, other[i].T_world_camera)) << i;
      EXPECT_EQ(t.inliers, other[i].inliers) << i;
    }
    has_grown = has_grown || other[i].keyframe;
    auto const d = t.T_world_camera.t - mapping[at(from) + i].T_world_camera.t;
    EXPECT_LT(std::sqrt(ft::dot(d, d)), 0.02) << i;
  }
  EXPECT_TRUE(saved(localizes) == map) << "the map has changed";

  // Elsewhere it is lost for as long as that lasts, and then found again.
  for (ft::tracking const& t : follow(localizes, 1, 0, 12, here)) {
    EXPECT_NE(t.state, ft::tracking_state::tracking);
    EXPECT_EQ(t.maps, 1);
  }
  EXPECT_EQ(localizes.last().state, ft::tracking_state::lost);
  EXPECT_EQ(follow(localizes, 0, from, mapped, here).back().state, ft::tracking_state::tracking);
  EXPECT_TRUE(saved(localizes) == map) << "the map has changed";
}
TYPED_TEST(LocalizeOnly, APairFindsItselfAndTheMapStays) {
  TypeParam backend;
  finds_itself(backend.exec, test::room::rig());
}
TYPED_TEST(LocalizeOnly, OneCameraFindsItselfAndTheMapStays) {
  TypeParam backend;
  finds_itself(backend.exec, one_camera::make(test::room::rig().camera));
}

TYPED_TEST(LocalizeOnly, WithoutALoadedMapThereIsNothingToBeFoundIn) {
  TypeParam backend;
  using odometry = ft::odometry<typename TypeParam::exec_type>;
  auto const rig = test::room::rig();
  std::int64_t time = 0;
  odometry maps(backend.exec, rig, params(false));
  follow(maps, 0, 0, 4, time);
  odometry odo(backend.exec, rig, params(true));
  EXPECT_THROW(follow(odo, 0, 0, 1, time), ft::bad_argument);
  load(odo, saved(maps));
  EXPECT_EQ(follow(odo, 0, 3, 4, time).back().state, ft::tracking_state::tracking);
  odo.reset();
  EXPECT_THROW(follow(odo, 0, 0, 1, time), ft::bad_argument);
}

}  // namespace localize_only_test
