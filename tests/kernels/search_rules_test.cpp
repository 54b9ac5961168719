// SPDX-License-Identifier: Apache-2.0
// The numbers in the rules of both searches, each at its edge: octaves of the local map's windows,
// how far is forward, with how many matches the search from the last frame is repeated. Sections 9
// and 10 of the specification.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <string>
#include <vector>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/feature_grid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/search/assignment.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/last_frame.hpp"
#include "ft/kernels/search/local_map.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "tests/support/backends.hpp"

namespace search_rules_test {

constexpr int width = 640;
constexpr int height = 480;
constexpr int levels = 8;
constexpr float depth = 5;

ft::rectified_rig rig() { return ft::rectified_rig::make({400, 400, 320, 240}, 0.25f); }

/// Map points so far from each other that each has one keypoint in its window, or none. All have
/// the same descriptor.
struct scene {
  std::vector<float> x, y;      ///< where a point is seen from the origin, pixels
  std::vector<float> aside;     ///< how far right of that its keypoint is
  std::vector<int> octave;      ///< of the keypoint
  int last_octave = 0;          ///< of the keypoints of the last frame
  float predicted_level = 0;    ///< of the points; a fraction is rounded up
  float ahead = 0;              ///< the last camera sees the current one so far ahead, metres
  int retry_below = 0;          ///< see last_search_params
  bool from_last_frame = true;  ///< or in the local map
  bool turned = false;          ///< last_search::rotations say half a turn about the axis
  float centre_z = 0;           ///< of local_search::centres

  void add(float offset, int level) {
    auto const i = static_cast<int>(x.size());
    x.push_back(40.0f + 70.0f * static_cast<float>(i % 8));
    y.push_back(40.0f + 70.0f * static_cast<float>(i / 8));
    aside.push_back(offset);
    octave.push_back(level);
  }
};

/// Which points found their keypoints.
template <typename Exec>
std::vector<bool> search(Exec const& exec, scene const& s) {
  int const n = static_cast<int>(s.x.size());
  auto const size = static_cast<std::size_t>(n);
  auto const g = ft::pyramid_geometry::make(width, height, levels, 1.2f);
  ft::keypoints<Exec::space> const kp(n, 1);
  ft::map_points<Exec::space> const map(n, 1);
  ft::frame_view frame;
  ft::last_frame_view last;
  ft::search_buffers buffers;
  ft::arena<Exec::space> const memory([&](ft::carver& c) {
    carve(c, frame.grids, ft::grid_geometry::over(0, 0, width, height), n, 1);
    carve(c, last.keypoints, n, 1);
    carve(c, buffers.windows, n, 1, 1);
    carve(c, buffers.work, n, n, 1, 1);
  });
  std::vector<float> keypoint_x, max_distance;
  std::vector<ft::vec3<float>> position, normal;
  std::vector<int> slots;
  for (std::size_t i = 0; i < size; ++i) {
    keypoint_x.push_back(s.x[i] + s.aside[i]);
    ft::vec3<float> const p{(s.x[i] - 320) / 400 * depth, (s.y[i] - 240) / 400 * depth, depth};
    float const distance = std::sqrt(ft::dot(p, p));
    position.push_back(p);
    normal.push_back({p.x / distance, p.y / distance, p.z / distance});
    max_distance.push_back(distance * std::pow(1.2f, s.predicted_level));
    slots.push_back(static_cast<int>(i));
  }
  auto const put = [&](auto* to, auto const& values) {
    ft::copy(exec, to, values.data(), values.size());
    exec.wait();
  };
  ft::fill_bytes(exec, ft::array_of<ft::field::orb>(kp.view()), 0, size * sizeof(ft::descriptor));
  ft::fill_bytes(exec, ft::array_of<ft::field::orb>(map.view()), 0, size * sizeof(ft::descriptor));
  put(ft::array_of<ft::field::x>(kp.view()), keypoint_x);
  put(ft::array_of<ft::field::y>(kp.view()), s.y);
  put(ft::array_of<ft::field::angle>(kp.view()), std::vector<float>(size, 0));
  put(ft::array_of<ft::field::octave>(kp.view()), s.octave);
  put(kp.view().count, std::vector<int>{n});
  put(ft::array_of<ft::field::angle>(last.keypoints), std::vector<float>(size, 0));
  put(ft::array_of<ft::field::octave>(last.keypoints), std::vector<int>(size, s.last_octave));
  put(last.keypoints.count, std::vector<int>{n});
  put(ft::array_of<ft::field::position>(map.view()), position);
  put(ft::array_of<ft::field::normal>(map.view()), normal);
  put(ft::array_of<ft::field::min_distance>(map.view()), std::vector<float>(size, 0));
  put(ft::array_of<ft::field::max_distance>(map.view()), max_distance);
  put(ft::array_of<ft::field::observations>(map.view()), std::vector<int>(size, 1));
  put(map.view().count, std::vector<int>{n});
  auto const d_slots = test::to_exec(exec, slots);
  auto const d_count = test::to_exec(exec, std::vector<int>{n});
  auto const d_holder = test::to_exec(exec, std::vector<int>(size, -1));
  ft::pose last_pose = ft::pose::identity();
  last_pose.t.z = s.ahead;
  auto const poses = test::to_exec(exec, std::vector<ft::pose>{ft::pose::identity(), last_pose});
  frame.keypoints = kp.view();
  frame.keypoint_step = last.keypoint_step = 1;
  frame.holder = d_holder.data();
  last.holder = d_slots.data();
  ft::build_grid<ft::nearest_cell>(exec, frame.keypoints, 0, 1, 1, frame.grids);
  if (s.from_last_frame) {
    ft::last_search<ft::rectified_rig> search;
    search.rig = rig();
    search.T_cw = poses.data();
    search.last_T_cw = poses.data() + 1;
    search.last = last;
    search.geometry = g;
    search.params.retry_below = s.retry_below;
    search.params.max_x = width;
    search.params.max_y = height;
    auto const half_turn = test::to_exec(exec, std::vector<ft::quaternion<float>>{{0, 0, 1, 0}});
    if (s.turned) { search.rotations = half_turn.data(); }
    ft::search_last_frame(exec, search, frame, map.view(), buffers);
    exec.wait();
  } else {
    ft::local_search<ft::rectified_rig> local;
    local.rig = rig();
    local.T_cw = poses.data();
    local.slots = d_slots.data();
    local.slot_count = d_count.data();
    local.frustum.max_x = width;
    local.frustum.max_y = height;
    local.frustum.log_scale_factor = ft::log_rounded(1.2f);
    local.frustum.levels = levels;
    local.geometry = g;
    auto const centre = test::to_exec(exec, std::vector<ft::vec3<float>>{{0, 0, s.centre_z}});
    local.centres = centre.data();
    ft::search_local_map(exec, local, frame, map.view(), buffers);
    exec.wait();
  }
  auto const holder = test::from_exec(exec, static_cast<int const*>(d_holder.data()), size);
  std::vector<bool> found;
  for (std::size_t i = 0; i < size; ++i) {
    EXPECT_TRUE(holder[i] == -1 || holder[i] == static_cast<int>(i));
    found.push_back(holder[i] >= 0);
  }
  return found;
}

/// One point for each octave: those from `low` to `high` are found.
template <typename Exec>
void expect_octaves(Exec const& exec, scene s, int low, int high) {
  for (int octave = 0; octave < levels; ++octave) { s.add(0, octave); }
  auto const found = search(exec, s);
  for (int octave = 0; octave < levels; ++octave) {
    EXPECT_EQ(found[static_cast<std::size_t>(octave)], octave >= low && octave <= high) << octave;
  }
}

template <typename Backend>
class search_rules : public test::on_backend<Backend> {
protected:
  Backend backend;
};
TYPED_TEST_SUITE(search_rules, test::backends);

TYPED_TEST(search_rules, the_local_map_looks_at_the_predicted_octave_and_the_finer_one) {
  for (int const level : {0, 1, 3, 7}) {
    SCOPED_TRACE("level " + std::to_string(level));
    scene s;
    s.from_last_frame = false;
    s.predicted_level = static_cast<float>(level) - 0.5f;
    // For a level of 0 or 1 nothing lies below; without a lower limit the upper one still holds.
    expect_octaves(this->backend.exec, s, level - 1, level);
  }
}

TYPED_TEST(search_rules, points_of_the_last_frame_are_rotated_by_quaternions_where_given) {
  scene s;
  s.x = {100, 320};
  s.y = {100, 240};  // the second one is on the axis
  s.aside = {0, 0};
  s.octave = {0, 0};
  EXPECT_EQ(search(this->backend.exec, s), (std::vector<bool>{true, true}));
  s.turned = true;
  EXPECT_EQ(search(this->backend.exec, s), (std::vector<bool>{false, true}));
  s.aside[0] = 640 - 2 * s.x[0];  // where half a turn takes it
  s.y[0] = 240;
  EXPECT_EQ(search(this->backend.exec, s), (std::vector<bool>{true, true}));
}

TYPED_TEST(search_rules, distances_are_from_the_callers_centre_of_the_camera) {
  scene s;
  s.from_last_frame = false;
  s.add(0, 0);
  EXPECT_EQ(search(this->backend.exec, s), std::vector<bool>{true});
  s.centre_z = -4 * depth;  // beyond 1.2 times the longest distance
  EXPECT_EQ(search(this->backend.exec, s), std::vector<bool>{false});
}

TYPED_TEST(search_rules, forward_is_farther_than_the_baseline) {
  struct expected {
    float share;  ///< of the baseline
    int low, high;
  };
  for (auto const& e :
       {expected{0, 2, 4}, expected{0.99f, 2, 4}, expected{1, 2, 4}, expected{1.01f, 3, 7},
        expected{-0.99f, 2, 4}, expected{-1, 2, 4}, expected{-1.01f, 0, 3}}) {
    SCOPED_TRACE(std::to_string(e.share) + " baselines ahead");
    scene s;
    s.last_octave = 3;
    s.ahead = e.share * rig().baseline_length().value;
    expect_octaves(this->backend.exec, s, e.low, e.high);
  }
}

TYPED_TEST(search_rules, as_many_matches_as_wanted_are_enough) {
  for (int const near : {1, 19, 20, 21}) {
    scene s;
    for (int i = 0; i < near; ++i) { s.add(0, 0); }
    for (int i = 0; i < 5; ++i) { s.add(10, 0); }  // found with twice the radius of 7
    for (int const more : {-1, 0, 1}) {
      SCOPED_TRACE(std::to_string(near) + " matches, wanted are " + std::to_string(near + more));
      s.retry_below = near + more;
      auto const found = search(this->backend.exec, s);
      for (int i = 0; i < near + 5; ++i) {
        EXPECT_EQ(found[static_cast<std::size_t>(i)], i < near || more > 0) << i;
      }
    }
  }
}

}  // namespace search_rules_test
