// SPDX-License-Identifier: Apache-2.0
/// @file Tests of the stages and of a tracker with the model. Part of tests/camera_contract.hpp.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/pose/optimize_frame.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/last_frame.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "ft/kernels/stereo/fisheye.hpp"
#include "ft/pipelines/frame_tracker.hpp"
#include "tests/camera_contract/room.hpp"
#include "tests/camera_contract/scenes.hpp"

namespace camera_contract {
inline namespace FT_ABI {

template <typename Setting>
class camera_in_stages : public on_executor<Setting> {
protected:
  using base = on_executor<Setting>;
  using lens = typename base::lens;
  using exec_type = typename base::exec_type;
  using model_type = typename base::template model_of<float>;
  using rig_type = ft::stereo_rig<model_type, model_type>;
  static constexpr ft::memory_space space = exec_type::space;

  static rig_type rig() {
    auto const c = lens::parameters().template cast<float>();
    return {c, c, rig_motion()};
  }
  stage_frame<exec_type> load(scene const& s, std::vector<int> const& holders = {}) const {
    return stage_frame<exec_type>(this->exec(), s, lens::width, lens::height, holders);
  }
  /// Rendered once per program.
  static walk const& frames() {
    static walk const w = make_walk(base::functions());
    return w;
  }

  template <typename Tracker>
  tracked take(Tracker const& tracker) const {
    auto const& r = tracker.result();
    tracked t;
    t.keypoints = r.keypoints[0];
    t.inliers = r.inliers[0];
    t.T_cw = r.T_cw[0];
    auto const n = at(t.keypoints);
    t.x.assign(r.x, r.x + n);
    t.y.assign(r.y, r.y + n);
    t.depth.assign(r.depth, r.depth + n);
    t.octave.assign(r.octave, r.octave + n);
    t.partner.assign(r.partner, r.partner + n);
    t.point.assign(r.point, r.point + n);
    t.orb.resize(n);
    tracker.download_descriptors(this->exec(), 0, t.orb.data(), t.keypoints);
    this->exec().wait();
    return t;
  }
};
TYPED_TEST_SUITE_P(camera_in_stages);

TYPED_TEST_P(camera_in_stages, points_are_visible_where_they_project_into_the_image) {
  auto const camera = TestFixture::functions();
  auto s = make_scene(camera, 400, 0, 11);
  scatter(s, 12);
  auto const want = expected_views(camera, s);
  auto const frame = this->load(s);
  auto const& exec = this->exec();
  int const n = frame.capacity;
  ft::search_windows_view windows;
  ft::arena<TestFixture::space> const memory([&](ft::carver& c) { carve(c, windows, n, 1, 2); });
  std::vector<int> slots;
  for (int i = 0; i < n; ++i) { slots.push_back(i); }
  auto const poses = to_exec(exec, std::vector<ft::pose>{s.T_cw});
  auto const d_slots = to_exec(exec, slots);
  auto const count = to_exec(exec, std::vector<int>{n});
  auto const seen = to_exec(exec, std::vector<ft::visibility>(at(2 * n), ft::visibility{}));
  ft::frustum_params params;
  params.max_x = static_cast<float>(camera.width);
  params.max_y = static_cast<float>(camera.height);
  params.log_scale_factor = ft::log_rounded(1.2f);
  params.levels = 8;
  ft::local_search<std::decay_t<decltype(TestFixture::rig())>> search;
  search.rig = TestFixture::rig();
  search.T_cw = poses.data();
  search.slots = d_slots.data();
  search.slot_count = count.data();
  search.frustum = params;
  search.geometry = frame.geometry;
  search.seen = seen.data();
  ft::find_visible_points(exec, search, frame.map.view(), windows);
  auto const got = from_exec(exec, static_cast<ft::visibility const*>(seen.data()), at(2 * n));
  int in_view = 0;
  int out_of_view = 0;
  for (int i = 0; i < 2 * n; ++i) {
    if (want[at(i)] == expected::doubtful) { continue; }
    bool const should = want[at(i)] == expected::seen;
    vector const p = i < n ? s.in_left[at(i)] : s.in_right[at(i - n)];
    ASSERT_EQ(got[at(i)].level >= 0, should) << p.x << ", " << p.y << ", " << p.z;
    (should ? in_view : out_of_view) += 1;
    if (!should) { continue; }
    auto const pixel = camera.project(p).pixel;
    ASSERT_NEAR(static_cast<double>(got[at(i)].x), pixel.x, 3 * TestFixture::lens::float_pixels);
    ASSERT_NEAR(static_cast<double>(got[at(i)].y), pixel.y, 3 * TestFixture::lens::float_pixels);
  }
  EXPECT_GT(in_view, 200);
  EXPECT_GT(out_of_view, 100);
}

TYPED_TEST_P(camera_in_stages, points_of_the_last_frame_find_their_keypoints) {
  auto const camera = TestFixture::functions();
  auto const s = make_scene(camera, 300, 100, 21);
  auto const frame = this->load(s);
  auto const& exec = this->exec();
  int const n = frame.capacity;
  // The last frame held every point at a left keypoint; this one is not quite where it is expected.
  auto const predicted =
      (turn({1, 0.5, -0.3}, 0.003, {0.003, -0.002, 0.003}) * s.T_cw.template cast<double>())
          .template cast<float>();
  ft::soa<ft::memory_space::host, ft::field::angle, ft::field::octave> const staging(n, 2);
  ft::soa<TestFixture::space, ft::field::angle, ft::field::octave> const last_keypoints(n, 2);
  std::vector<int> last_holder(at(2 * n), -1);
  for (int i = 0; i < 2 * n; ++i) {
    staging.view().angle(i) = 0;
    staging.view().octave(i) = 0;
    if (i < n) { last_holder[at(i)] = i; }
  }
  staging.view().count[0] = n;
  staging.view().count[1] = 0;
  ft::copy(exec, last_keypoints.view(), staging.view());
  auto const holder = to_exec(exec, last_holder);
  ft::last_frame_view last;
  last.keypoints = last_keypoints.view();
  last.cameras = 2;
  last.holder = holder.data();
  ft::search_buffers buffers;
  ft::arena<TestFixture::space> const memory([&](ft::carver& c) {
    carve(c, buffers.windows, 2 * n, 1, 2);
    carve(c, buffers.work, 2 * n, n, 1, 2);
  });
  auto const pose = to_exec(exec, std::vector<ft::pose>{predicted});
  ft::last_search<std::decay_t<decltype(TestFixture::rig())>> search;
  search.rig = TestFixture::rig();
  search.T_cw = pose.data();
  search.last_T_cw = pose.data();
  search.last = last;
  search.geometry = frame.geometry;
  search.params.window_radius = static_cast<float>(std::max(7.0, 0.02 * camera.focal()));
  search.params.max_x = static_cast<float>(camera.width);
  search.params.max_y = static_cast<float>(camera.height);
  ft::search_last_frame(exec, search, frame.view, frame.map.view(), buffers);
  EXPECT_EQ(frame.holders(exec), own_points(s));
  EXPECT_EQ(from_exec(exec, static_cast<int const*>(buffers.work.matches), 1)[0],
            static_cast<int>(s.left.size() + s.right.size()));
}

TYPED_TEST_P(camera_in_stages, a_stereo_pair_gives_its_points_back) {
  auto const camera = TestFixture::functions();
  auto const s = make_scene(camera, 400, 0, 31);
  auto const frame = this->load(s);
  auto const& exec = this->exec();
  int const n = frame.capacity;
  ft::fisheye_matches_view out;
  ft::arena<TestFixture::space> const memory([&](ft::carver& c) { carve(c, out, n, 1); });
  auto const before_overlap = to_exec(exec, std::vector<int>{0, 0});
  ft::fisheye_stereo<std::decay_t<decltype(TestFixture::rig())>> const stereo{
      TestFixture::rig(), frame.geometry, before_overlap.data(), {}};
  ft::match_stereo_fisheye(exec, stereo, frame.keypoints.view(), out);
  auto const partner = from_exec(exec, static_cast<int const*>(out.partner), at(2 * n));
  auto const point = from_exec(exec, static_cast<ft::vec3<float> const*>(out.point), at(n));
  auto const depth = from_exec(exec, static_cast<float const*>(out.depth), at(n));
  int found = 0;
  for (int i = 0; i < n; ++i) {
    auto const r =
        std::find_if(s.right.begin(), s.right.end(), [&](mark const& m) { return m.point == i; });
    double const cosine = std::cos(parallax(s, i));
    vector const p = s.in_left[at(i)];
    bool const ahead = s.in_right[at(i)].z > 0.05 * length(p);
    if (r != s.right.end() && (std::abs(cosine - stereo.params.max_cosine) < 1e-5 || !ahead)) {
      continue;  // at a limit of the stage
    }
    bool const should = r != s.right.end() && cosine < stereo.params.max_cosine;
    ASSERT_EQ(partner[at(i)], should ? n + static_cast<int>(r - s.right.begin()) : -1)
        << p.x << ", " << p.y << ", " << p.z;
    if (!should) { continue; }
    ++found;
    // What pixels rounded to float leave, at this distance and parallax.
    double const tolerance = 10 * TestFixture::lens::float_pixels / camera.focal() * length(p) /
                             std::sin(parallax(s, i));
    auto const& got = point[at(i)];
    ASSERT_LT(length(vector{got.x, got.y, got.z} - p), tolerance)
        << got.x << ", " << got.y << ", " << got.z << " instead of " << p.x << ", " << p.y << ", "
        << p.z;
    ASSERT_EQ(depth[at(i)], got.z);
  }
  EXPECT_GT(found, 100);
}

TYPED_TEST_P(camera_in_stages, pose_optimization_finds_the_pose) {
  auto const camera = TestFixture::functions();
  auto s = make_scene(camera, 250, 0, 41);
  auto const holders = own_points(s);
  auto kept = holders;
  for (std::size_t i = 0; i < s.left.size(); i += 10) {  // keypoints of something else
    s.left[i].pixel.x += i % 20 == 0 ? 40 : -40;
    kept[i] = -1;
  }
  auto const frame = this->load(s, holders);
  auto const& exec = this->exec();
  ft::observations_view observations;
  ft::arena<TestFixture::space> const memory(
      [&](ft::carver& c) { carve(c, observations, 2 * frame.capacity, 1); });
  auto const start =
      (turn({0.4, -1, 0.3}, 0.04, {0.05, -0.04, 0.06}) * s.T_cw.template cast<double>())
          .template cast<float>();
  auto const pose = to_exec(exec, std::vector<ft::pose>{start});
  ft::optimize_frame_poses(exec, TestFixture::rig(), {frame.view, frame.map.view(), frame.geometry},
                           {pose.data(), pose.data(), observations});
  auto const found = from_exec(exec, static_cast<ft::pose const*>(pose.data()), 1)[0];
  EXPECT_LT(difference(found, s.T_cw), 1e-4);
  EXPECT_EQ(frame.holders(exec), kept) << "the false keypoints are let go, and no others";
}

TYPED_TEST_P(camera_in_stages, a_tracker_follows_the_camera) {
  using data = typename TestFixture::lens;
  auto const& exec = this->exec();
  auto const camera = TestFixture::functions();
  auto const& frames = TestFixture::frames();
  ft::tracker_params params;
  params.orb.width = data::width;
  params.orb.height = data::height;
  params.orb.features = 800;
  params.map_slots = params.local_points = params.updates = 4000;
  ft::frame_tracker<typename TestFixture::exec_type, typename TestFixture::rig_type> tracker(
      exec, TestFixture::rig(), params);
  ASSERT_LE(tracker.capacity(), params.map_slots);
  auto const set_images = [&](int f) {
    tracker.set_image(0, 0, {frames.left[f].data(), data::width, data::height, data::width});
    tracker.set_image(0, 1, {frames.right[f].data(), data::width, data::height, data::width});
  };
  set_images(0);
  // The pose that the keypoints of the first frame hold for.
  tracker.set_last(exec, 0, frames.T_cw[0], std::vector<int>(at(2 * tracker.capacity()), -1));
  tracker.extract(exec);
  exec.wait();
  auto const first = this->take(tracker);
  check_depths(camera, first, frames.T_cw[0]);
  if (this->HasFatalFailure()) { return; }
  auto const points = map_of(first, frames.T_cw[0], tracker.geometry());
  tracker.update_map(exec, 0, points.data(), static_cast<int>(points.size()));
  exec.wait();
  std::vector<int> holders(at(2 * tracker.capacity()), -1);
  std::vector<int> local_slots;
  for (auto const& point : points) {
    holders[at(point.slot)] = point.slot;
    int const partner = first.partner[at(point.slot)];
    if (partner >= 0) { holders[at(partner)] = point.slot; }
    local_slots.push_back(point.slot);
  }
  tracker.set_last(exec, 0, frames.T_cw[0], holders);
  set_images(1);
  tracker.track_motion(exec, frames.T_cw[0]);
  exec.wait();
  check_pose(camera, this->take(tracker), frames.T_cw[1]);
  tracker.track_local(exec, local_slots);
  exec.wait();
  check_pose(camera, this->take(tracker), frames.T_cw[1]);
}

REGISTER_TYPED_TEST_SUITE_P(camera_in_stages, points_are_visible_where_they_project_into_the_image,
                            points_of_the_last_frame_find_their_keypoints,
                            a_stereo_pair_gives_its_points_back, pose_optimization_finds_the_pose,
                            a_tracker_follows_the_camera);

}  // namespace FT_ABI
}  // namespace camera_contract
