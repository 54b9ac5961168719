// SPDX-License-Identifier: Apache-2.0
// The whole tracker on every executor: known poses in a rendered room, bad input, frames without a
// corner, several trackers at a time, batches, memory and repeatability.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <memory>
#include <new>
#include <numeric>
#include <random>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/pipelines/frame_tracker.hpp"
#include "tests/support/allocation_count.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/room.hpp"
#include "tests/support/tracking.hpp"

#if !defined(__CUDACC__)  // nvcc has the global operators on the device as well: not to be replaced

// ---- allocations of one thread ----------------------------------------------------------------

namespace tracker_parity {

using test::allocation_count;
constexpr std::size_t plain = alignof(std::max_align_t);

}  // namespace tracker_parity

// These stand for the whole program's, and do what the library's do. Inlined, they would look to
// g++ as if memory of one function were given back to another.
#define FT_TEST_NOINLINE __attribute__((noinline))
FT_TEST_NOINLINE void* operator new(std::size_t n) {
  return tracker_parity::allocation_count::take_or_throw(n, tracker_parity::plain);
}
FT_TEST_NOINLINE void* operator new[](std::size_t n) {
  return tracker_parity::allocation_count::take_or_throw(n, tracker_parity::plain);
}
FT_TEST_NOINLINE void* operator new(std::size_t n, std::align_val_t a) {
  return tracker_parity::allocation_count::take_or_throw(n, static_cast<std::size_t>(a));
}
FT_TEST_NOINLINE void* operator new[](std::size_t n, std::align_val_t a) {
  return tracker_parity::allocation_count::take_or_throw(n, static_cast<std::size_t>(a));
}
FT_TEST_NOINLINE void* operator new(std::size_t n, std::nothrow_t const&) noexcept {
  return tracker_parity::allocation_count::take(n, tracker_parity::plain);
}
FT_TEST_NOINLINE void* operator new[](std::size_t n, std::nothrow_t const&) noexcept {
  return tracker_parity::allocation_count::take(n, tracker_parity::plain);
}
FT_TEST_NOINLINE void operator delete(void* p) noexcept { std::free(p); }
FT_TEST_NOINLINE void operator delete[](void* p) noexcept { std::free(p); }
FT_TEST_NOINLINE void operator delete(void* p, std::size_t) noexcept { std::free(p); }
FT_TEST_NOINLINE void operator delete[](void* p, std::size_t) noexcept { std::free(p); }
FT_TEST_NOINLINE void operator delete(void* p, std::align_val_t) noexcept { std::free(p); }
FT_TEST_NOINLINE void operator delete[](void* p, std::align_val_t) noexcept { std::free(p); }
FT_TEST_NOINLINE void operator delete(void* p, std::size_t, std::align_val_t) noexcept {
  std::free(p);
}
FT_TEST_NOINLINE void operator delete[](void* p, std::size_t, std::align_val_t) noexcept {
  std::free(p);
}
FT_TEST_NOINLINE void operator delete(void* p, std::nothrow_t const&) noexcept { std::free(p); }
FT_TEST_NOINLINE void operator delete[](void* p, std::nothrow_t const&) noexcept { std::free(p); }

#endif

namespace tracker_parity {

using namespace test::room;  // NOLINT(google-build-using-namespace)
using test::same_bits;
using test::snapshot;

/// Keypoints lie on whole pixels of their level: 0.7 pixels between two frames, 250 of them, at 4 m
/// and 300 pixels of focal length; rotation and translation trade off about tenfold: 6 mm. The
/// limit is three times that; a tracker that stays where it was predicted is off by 54 mm after a
/// frame.
void expect_pose(ft::pose const& got, ft::pose const& want) {
  auto const centre = got.centre() - want.centre();
  EXPECT_LT(std::sqrt(ft::dot(centre, centre)), 0.02f) << "metres off";
  auto const R = got.R * want.R.transposed();
  float const sine =
      0.5f * std::hypot(std::hypot(R.m[7] - R.m[5], R.m[2] - R.m[6]), R.m[3] - R.m[1]);
  EXPECT_LT(sine, 0.003f) << "radians off";
}

template <typename Backend>
class frame_tracker_test : public test::on_backend<Backend> {
protected:
  using exec_type = typename Backend::exec_type;
  using tracker_type = ft::frame_tracker<exec_type>;

  void SetUp() override {
    test::on_backend<Backend>::SetUp();
    if (!this->IsSkipped() && !this->HasFailure()) { backend_ = std::make_unique<Backend>(); }
  }
  exec_type const& exec() const { return backend_->exec; }

private:
  std::unique_ptr<Backend> backend_;  // made where there is a device only
};
TYPED_TEST_SUITE(frame_tracker_test, test::backends);

// ---- what it finds ----------------------------------------------------------------------------

/// What must hold of a walk whose frames are followed by track().
template <typename Tracker>
void check_walk(Tracker& tracker, std::vector<snapshot> const& seen,
                std::vector<stereo_frame> const& truth) {
  ASSERT_EQ(seen.size(), 5u);  // extract, then motion and local twice
  auto const& first = seen[0];
  EXPECT_GE(first.keypoints[0], 500);
  EXPECT_LE(first.keypoints[0], tracker.capacity());
  EXPECT_EQ(first.matches, 0);
  EXPECT_EQ(held(first), 0);
  EXPECT_GT(std::count_if(first.depth.begin(), first.depth.end(), [](float d) { return d > 0; }),
            200);
  for (std::size_t i = 0; i < first.depth.size(); ++i) {
    EXPECT_EQ(first.point[i].z, first.depth[i] > 0 ? first.depth[i] : 0.0f);
    if (Tracker::cameras == 2) { EXPECT_EQ(first.partner[i] >= 0, first.depth[i] > 0); }
  }
  std::vector<int> slots;  // of the map's points
  for (std::size_t i = 0; i < first.depth.size(); ++i) {
    if (first.depth[i] > 0) { slots.push_back(static_cast<int>(i)); }
  }
  for (std::size_t frame = 1; frame < 3; ++frame) {
    SCOPED_TRACE("frame " + std::to_string(frame));
    auto const& motion = seen[2 * frame - 1];
    auto const& local = seen[2 * frame];
    expect_pose(motion.T_cw, truth[frame].T_cw);
    expect_pose(local.T_cw, truth[frame].T_cw);
    EXPECT_GT(motion.matches, 120);
    EXPECT_GT(motion.inliers, motion.matches * 3 / 4);
    EXPECT_LE(motion.inliers, motion.matches);
    EXPECT_EQ(motion.inliers, held(motion));
    EXPECT_EQ(local.inliers, held(local));
    EXPECT_GE(local.inliers, motion.inliers * 9 / 10);
    EXPECT_EQ(motion.keypoints, local.keypoints);
    EXPECT_TRUE(same_bits(motion.x, local.x) && same_bits(motion.depth, local.depth));
    // Points that the search from the last frame found are not looked for again.
    int in_view = 0;
    for (std::size_t i = 0; i < local.in_view.size(); ++i) {
      in_view += local.in_view[i];
      if (local.in_view[i] == 0) { continue; }
      ASSERT_LT(i, slots.size());
      EXPECT_EQ(std::count(motion.holder.begin(), motion.holder.end(), slots[i]), 0);
    }
    EXPECT_GT(in_view, 0);
  }
}

TYPED_TEST(frame_tracker_test, finds_the_known_poses) {
  for (unsigned seed = 0; seed < 3; ++seed) {
    SCOPED_TRACE("walk " + std::to_string(seed));
    typename TestFixture::tracker_type tracker(this->exec(), rig(), params());
    auto const seen = track(tracker, this->exec(), {&walk(seed)});
    check_walk(tracker, seen, walk(seed));
  }
}

TYPED_TEST(frame_tracker_test, finds_the_known_poses_of_a_fisheye_pair) {
  auto const truth = make_walk(fisheye(), 4, 3);
  ft::frame_tracker<typename TestFixture::exec_type, fisheye_rig> tracker(this->exec(), fisheye(),
                                                                          params());
  auto const seen = track(tracker, this->exec(), {&truth});
  check_walk(tracker, seen, truth);
}

/// Points that one of two fisheye cameras has in its image, both, or none.
TYPED_TEST(frame_tracker_test, a_point_in_view_of_either_camera_is_in_view) {
  auto const& exec = this->exec();
  auto const rig = fisheye();
  std::vector<ft::point_update> points;
  std::vector<unsigned char> want;
  int right_alone = 0;
  int left_alone = 0;
  auto const inside = [](auto const& seen) {
    return seen.valid && seen.pixel.x >= 0 && seen.pixel.x <= width && seen.pixel.y >= 0 &&
           seen.pixel.y <= height;
  };
  for (float u = -80; u < width + 80; u += 7) {
    auto const d = rig.left.unproject({u, 180}).direction;
    float const length = std::sqrt(ft::dot(d, d));
    ft::vec3<float> const normal{d.x / length, d.y / length, d.z / length};
    ft::vec3<float> const p{0.5f * normal.x, 0.5f * normal.y, 0.5f * normal.z};
    bool const left = inside(rig.left.project(p));
    bool const right = inside(rig.right.project(rig.T_rl * p));
    right_alone += static_cast<int>(right && !left);
    left_alone += static_cast<int>(left && !right);
    want.push_back(static_cast<unsigned char>(left || right));
    points.push_back({static_cast<int>(points.size()), 1, p, normal, 0.1f, 10, {}});
  }
  ASSERT_GT(right_alone, 2);
  ASSERT_GT(left_alone, 2);
  ft::frame_tracker<typename TestFixture::exec_type, fisheye_rig> tracker(exec, rig, params());
  tracker.update_map(exec, 0, points.data(), static_cast<int>(points.size()));
  std::vector<int> slots(points.size());
  std::iota(slots.begin(), slots.end(), 0);
  exec.wait();
  tracker.relocalize(exec, {ft::pose::identity(), slots});
  exec.wait();
  auto seen = take(tracker, 0, true).in_view;
  seen.resize(want.size());
  EXPECT_EQ(seen, want);
}

TYPED_TEST(frame_tracker_test, counts_the_extractors_keypoints) {
  typename TestFixture::tracker_type tracker(this->exec(), rig(), params());
  set_images(tracker, 0, walk(0)[0]);
  tracker.extract(this->exec());
  this->exec().wait();
  auto const kp = tracker.extractor().keypoints();
  auto const counts = test::from_exec(this->exec(), static_cast<int const*>(kp.count), 2);
  auto const x = test::column<ft::field::x>(this->exec(), kp);
  auto const y = test::column<ft::field::y>(this->exec(), kp);
  auto const octave = test::column<ft::field::octave>(this->exec(), kp);
  ASSERT_EQ(tracker.result().keypoints[0], counts[0]);
  for (int i = 0; i < tracker.capacity(); ++i) {
    bool const there = i < counts[0];
    EXPECT_EQ(tracker.result().x[i], there ? x[at(i)] : 0.0f);
    EXPECT_EQ(tracker.result().y[i], there ? y[at(i)] : 0.0f);
    EXPECT_EQ(tracker.result().octave[i], there ? octave[at(i)] : 0);
    EXPECT_EQ(tracker.result().holder[i], -1);
  }
}

TYPED_TEST(frame_tracker_test, finds_the_pose_from_the_map_alone) {
  auto const& exec = this->exec();
  typename TestFixture::tracker_type tracker(exec, rig(), params());
  test::frame_inputs in(tracker);
  track(in, exec, {&walk(1)});
  set_images(tracker, 0, walk(1)[2]);
  in.predicted[0] = walk(1)[1].T_cw;  // the frame before's
  in.extract(exec);
  exec.wait();
  EXPECT_EQ(held(take(tracker, 0, false)), 0);
  ft::local_search_params search;
  search.radius_factor = 5;
  in.relocalize(exec, search);
  exec.wait();
  auto const once = take(tracker, 0, true);
  EXPECT_GT(once.inliers, 100);
  EXPECT_EQ(once.inliers, held(once));
  expect_pose(once.T_cw, walk(1)[2].T_cw);
  // Once more from the same start.
  in.relocalize(exec, search);
  exec.wait();
  expect_same(take(tracker, 0, true), once);
}

TYPED_TEST(frame_tracker_test, without_pose_optimisation_keeps_the_prediction) {
  auto const& exec = this->exec();
  auto p = params();
  p.optimize_last = p.optimize_local = false;
  typename TestFixture::tracker_type tracker(exec, rig(), p);
  auto const seen = track(tracker, exec, {&walk(0)});
  for (std::size_t i = 1; i < seen.size(); ++i) {
    EXPECT_EQ(std::memcmp(&seen[i].T_cw, &walk(0)[0].T_cw, sizeof(ft::pose)), 0);
    EXPECT_EQ(seen[i].inliers, seen[i].matches);
  }
  EXPECT_GT(seen[1].matches, 100);
  EXPECT_EQ(held(seen[1]), seen[1].matches);
}

/// A walk by all `calls`, from graphs and without, gives the same bits.
template <typename Rig, typename Exec>
void expect_same_by_all_calls(Exec const& exec, Rig const& rig, ft::tracker_params const& p,
                              std::vector<std::vector<stereo_frame> const*> const& walks,
                              int guests) {
  auto const all = [&](calls how, bool use_graphs = true) {
    auto with = p;
    with.use_graphs = use_graphs;
    ft::frame_tracker<Exec, Rig> tracker(exec, rig, with, static_cast<int>(walks.size()));
    return track(tracker, exec, walks,
                 [&](int b, int, stereo_frame const& f) { set_images(tracker, b, f); },
                 {how, guests, 3});
  };
  auto const halves = all(calls::halves);
  std::vector<snapshot> wanted;  // without the results in between
  for (std::size_t i = 0; i < halves.size(); ++i) {
    std::size_t const step = i / walks.size();
    if (step % 2 == 0) { wanted.push_back(halves[i]); }
  }
  int matches = 0;
  for (auto const& frame : wanted) { matches += frame.matches; }
  EXPECT_GT(matches, 60) << "the local map adds next to nothing";
  {
    SCOPED_TRACE("one call");
    expect_same(all(calls::whole), wanted);
  }
  if (!test::whole_effort()) { return; }  // the host knows no other launches
  SCOPED_TRACE("launch by launch");
  expect_same(all(calls::whole, false), wanted);
  expect_same(all(calls::halves, false), halves);
}

TYPED_TEST(frame_tracker_test, one_call_gives_the_bits_of_two_halves) {
  auto const fisheye_walk = make_walk(fisheye(), 0, 3);
  for (bool const optimize : test::both(true)) {
    for (int const guests : {5, 0}) {
      if (guests == 0 && test::effort(100) < 100) { continue; }
      SCOPED_TRACE((optimize ? "with" : "without") + std::string(" pose optimisation, ") +
                   (guests > 0 ? "some points" : "no point") + " without observations");
      auto p = params();
      p.optimize_last = p.optimize_local = optimize;
      expect_same_by_all_calls(this->exec(), rig(), p, {&walk(0), &walk(1), &walk(2)}, guests);
      expect_same_by_all_calls(this->exec(), fisheye(), p, {&fisheye_walk}, guests);
    }
  }
}

// ---- bad input --------------------------------------------------------------------------------

TYPED_TEST(frame_tracker_test, refuses_rigs_and_parameters_that_cannot_be) {
  using refused_type = typename TestFixture::tracker_type;
  float const nan = std::numeric_limits<float>::quiet_NaN();
  float const inf = std::numeric_limits<float>::infinity();
  auto const good = rig();
  auto const refused_rig = [&](auto change) {
    auto r = good;
    change(r);
    EXPECT_THROW(refused_type(this->exec(), r, params()), ft::bad_argument);
  };
  for (float const v : {nan, inf, 0.0f, -300.0f}) {
    refused_rig([&](auto& r) { r.camera.fx = v; });
    refused_rig([&](auto& r) { r.camera.fy = v; });
    refused_rig([&](auto& r) { r.baseline = v; });
  }
  for (float const v : {nan, inf, -inf}) {
    refused_rig([&](auto& r) { r.camera.cx = v; });
    refused_rig([&](auto& r) { r.camera.cy = v; });
  }
  EXPECT_THROW(refused_type(this->exec(), ft::rectified_rig::make(good.camera, 0.0f), params()),
               ft::bad_argument);
  EXPECT_THROW(refused_type(this->exec(), ft::rectified_rig{}, params()), ft::bad_argument);

  auto const refused = [&](auto change) {
    auto p = params();
    change(p);
    EXPECT_THROW(refused_type(this->exec(), good, p), ft::bad_argument);
  };
  refused([](auto& p) { p.orb.width = 0; });
  refused([](auto& p) { p.orb.height = -5; });
  refused([](auto& p) { p.orb.width = ft::max_image_side + 1; });
  refused([](auto& p) { p.orb.features = 0; });
  refused([](auto& p) { p.orb.levels = 0; });
  refused([](auto& p) { p.orb.levels = ft::max_levels + 1; });
  refused([](auto& p) { p.orb.scale_factor = 1.0f; });
  refused([&](auto& p) { p.orb.scale_factor = nan; });
  refused([](auto& p) { p.orb.ini_threshold = -1; });
  refused([](auto& p) { p.orb.min_threshold = 256; });
  refused([](auto& p) { p.map_slots = 0; });
  refused([](auto& p) { p.local_points = 0; });
  refused([](auto& p) { p.updates = 0; });
  refused([](auto& p) { p.window_radius = 0; });
  refused([&](auto& p) { p.window_radius = nan; });
  EXPECT_THROW(refused_type(this->exec(), good, params(), 0), ft::bad_argument);
  EXPECT_THROW(refused_type(this->exec(), good, params(), -1), ft::bad_argument);

  auto const refused_pair = [&](auto change) {
    auto r = fisheye();
    change(r);
    using pair_type = ft::frame_tracker<typename TestFixture::exec_type, fisheye_rig>;
    EXPECT_THROW(pair_type(this->exec(), r, params()), ft::bad_argument);
  };
  refused_pair([&](auto& r) { r.left.fx = nan; });
  refused_pair([&](auto& r) { r.right.fy = 0; });
  refused_pair([&](auto& r) { r.right.k3 = nan; });
  refused_pair([&](auto& r) { r.T_rl.R.m[4] = nan; });
  refused_pair([&](auto& r) { r.T_rl.R.m[4] = 2; });
  refused_pair([&](auto& r) { r.T_rl.t.y = inf; });
  refused_pair([&](auto& r) { r.T_rl.t = {0, 0, 0}; });
}

TYPED_TEST(frame_tracker_test, refuses_bad_input_and_stays_usable) {
  auto const& exec = this->exec();
  typename TestFixture::tracker_type tracker(exec, rig(), params());
  image const pixels(at(width + 1) * at(height + 1), 7);
  auto const refused_image = [&](int b, int camera, ft::gray_view v) {
    EXPECT_THROW(tracker.set_image(b, camera, v), ft::bad_argument);
  };
  refused_image(0, 0, {nullptr, width, height, width});
  refused_image(0, 0, {});
  refused_image(0, 0, {pixels.data(), width + 1, height, width + 1});
  refused_image(0, 0, {pixels.data(), width, height + 1, width});
  refused_image(0, 0, {pixels.data(), width - 1, height, width});
  refused_image(0, 0, {pixels.data(), height, width, height});
  refused_image(0, 0, {pixels.data(), width, height, width - 1});
  refused_image(0, 0, {pixels.data(), width, height, -width});
  refused_image(1, 0, {pixels.data(), width, height, width});
  refused_image(-1, 0, {pixels.data(), width, height, width});
  refused_image(0, 2, {pixels.data(), width, height, width});
  refused_image(0, -1, {pixels.data(), width, height, width});

  std::vector<ft::point_update> updates(at(params().updates) + 1, ft::point_update{});
  auto const refused_update = [&](int b, int count) {
    EXPECT_THROW(tracker.update_map(exec, b, updates.data(), count), ft::bad_argument);
  };
  refused_update(0, params().updates + 1);
  refused_update(0, -1);
  refused_update(1, 1);
  refused_update(-1, 1);
  updates[3].slot = params().map_slots;
  refused_update(0, 10);
  updates[3].slot = -1;
  refused_update(0, 10);
  tracker.update_map(exec, 0, updates.data(), 3);
  tracker.update_map(exec, 0, nullptr, 0);
  exec.wait();

  for (int const count : {params().local_points + 1, -1, std::numeric_limits<int>::max()}) {
    std::vector<int> const many(at(params().local_points) + 1);
    ft::slot_list const slots{many.data(), count};
    EXPECT_THROW(tracker.track_local(exec, slots), ft::bad_argument);
    EXPECT_THROW(tracker.relocalize(exec, {ft::pose::identity(), slots}), ft::bad_argument);
    EXPECT_THROW(tracker.track(exec, {ft::pose::identity(), slots}), ft::bad_argument);
  }
  std::vector<ft::descriptor> orb(at(tracker.capacity()) + 1);
  for (int const count : {tracker.capacity() + 1, -1}) {
    EXPECT_THROW(tracker.download_descriptors(exec, 0, orb.data(), count), ft::bad_argument);
  }
  EXPECT_THROW(tracker.download_descriptors(exec, 1, orb.data(), 1), ft::bad_argument);
  exec.wait();
  expect_same(track(tracker, exec, {&walk(2)}), track_alone(exec, 2));
}

TYPED_TEST(frame_tracker_test, accepts_images_with_a_stride) {
  auto const& exec = this->exec();
  typename TestFixture::tracker_type tracker(exec, rig(), params());
  auto const& f = walk(0)[0];
  constexpr int stride = width + 37;
  for (int camera = 0; camera < 2; ++camera) {
    image const& from = camera == 0 ? f.left : f.right;
    image padded(at(stride) * at(height), 255);
    for (int y = 0; y < height; ++y) {
      std::copy_n(from.begin() + y * width, width, padded.begin() + y * stride);
    }
    tracker.set_image(0, camera, {padded.data(), width, height, stride});
  }
  test::frame_inputs in(tracker);
  in.predicted[0] = f.T_cw;
  in.extract(exec);
  exec.wait();
  expect_same(take(tracker, 0, false), track_alone(exec, 0)[0]);
}

TYPED_TEST(frame_tracker_test, leaves_out_slots_outside_the_map) {
  auto const& exec = this->exec();
  typename TestFixture::tracker_type tracker(exec, rig(), params());
  test::frame_inputs in(tracker);
  set_images(tracker, 0, walk(0)[0]);
  in.predicted[0] = in.last_pose[0] = walk(0)[0].T_cw;
  in.extract(exec);
  exec.wait();
  for (int i = 0; i < tracker.capacity(); ++i) {
    in.last_holder[at(i)] = i % 2 == 0 ? params().map_slots + i : -2 - i;
  }
  in.track_motion(exec);
  exec.wait();
  EXPECT_EQ(tracker.result().matches[0], 0);
  for (int i = 0; i < params().local_points; ++i) {
    in.local_slots[at(i)] = i % 2 == 0 ? params().map_slots + i : -2 - i;
  }
  in.local_count[0] = params().local_points;
  in.track_local(exec);
  exec.wait();
  EXPECT_EQ(tracker.result().matches[0], 0);
  EXPECT_EQ(held(take(tracker, 0, true)), 0);
}

/// Its grid and what its keypoints hold are read, although nothing has written them.
TYPED_TEST(frame_tracker_test, finds_nothing_in_the_local_map_before_any_frame) {
  auto const& exec = this->exec();
  auto const first_call = [&](auto& tracker) {
    // A map in front of the camera, all of it in the search.
    std::vector<ft::point_update> points;
    std::vector<int> slots;
    for (int i = 0; i < 50; ++i) {
      float const x = 0.05f * static_cast<float>(i - 25);
      points.push_back({i, 1, {x, 0, 3}, {0, 0, 1}, 1, 10, {}});
      slots.push_back(i);
    }
    tracker.update_map(exec, 0, points.data(), 50);
    exec.wait();
    ft::local_search_params search;
    search.radius_factor = 20;
    tracker.relocalize(exec, {ft::pose::identity(), slots}, search);
    exec.wait();
    auto const got = take(tracker, 0, true);
    EXPECT_EQ(got.keypoints[0], 0);
    EXPECT_EQ(got.matches, 0);
    EXPECT_EQ(got.inliers, 0);
    EXPECT_EQ(held(got), 0);
    EXPECT_GT(std::count(got.in_view.begin(), got.in_view.end(), 1), 30);
    ft::pose const start = ft::pose::identity();
    EXPECT_EQ(std::memcmp(&got.T_cw, &start, sizeof start), 0);
  };
  typename TestFixture::tracker_type rectified(exec, rig(), params());
  first_call(rectified);
  ft::frame_tracker<typename TestFixture::exec_type, fisheye_rig> pair(exec, fisheye(), params());
  first_call(pair);
}

TYPED_TEST(frame_tracker_test, goes_through_frames_without_a_corner) {
  auto const& exec = this->exec();
  stereo_frame const black{image(at(width) * at(height), 0), image(at(width) * at(height), 0),
                           ft::pose::identity()};
  auto const expect_nothing = [](snapshot const& s, ft::pose const& pose) {
    EXPECT_EQ(s.keypoints[0], 0);
    EXPECT_EQ(s.matches, 0);
    EXPECT_EQ(s.inliers, 0);
    EXPECT_EQ(held(s), 0);
    EXPECT_EQ(std::memcmp(&s.T_cw, &pose, sizeof pose), 0) << "the pose is not the predicted one";
  };
  // First of all, and then right after a walk, when there are last keypoints and a map.
  typename TestFixture::tracker_type tracker(exec, rig(), params());
  test::frame_inputs in(tracker);
  for (int round = 0; round < 2; ++round) {
    SCOPED_TRACE("round " + std::to_string(round));
    set_images(tracker, 0, black);
    for (int call = 0; call < 3; ++call) {
      in.predicted[0] = walk(1)[2].T_cw;
      if (call == 1) {
        in.extract(exec);
      } else {
        in.track_motion(exec);
      }
      exec.wait();
      expect_nothing(take(tracker, 0, false), walk(1)[2].T_cw);
      in.track_local(exec);
      exec.wait();
      if (call != 1) { expect_nothing(take(tracker, 0, true), walk(1)[2].T_cw); }
      in.relocalize(exec);
      exec.wait();
      expect_nothing(take(tracker, 0, true), walk(1)[2].T_cw);
    }
    auto const after = track(in, exec, {&walk(1)});
    expect_same(after, track_alone(exec, 1));
  }
}

// ---- independence -----------------------------------------------------------------------------

TYPED_TEST(frame_tracker_test, two_trackers_in_two_threads) {
  if (!TypeParam::available()) { return; }
  std::vector<snapshot> alone[2] = {track_alone(this->exec(), 0), track_alone(this->exec(), 1)};
  std::vector<snapshot> together[2];
  std::vector<std::thread> threads;
  for (unsigned i = 0; i < 2; ++i) {
    threads.emplace_back([i, &together] {
      TypeParam own;
      for (int repeat = 0; repeat < 2; ++repeat) { together[i] = track_alone(own.exec, i); }
    });
  }
  for (auto& t : threads) { t.join(); }
  for (int i = 0; i < 2; ++i) {
    SCOPED_TRACE("thread " + std::to_string(i));
    expect_same(together[i], alone[i]);
  }
}

TYPED_TEST(frame_tracker_test, two_trackers_take_turns) {
  auto const& exec = this->exec();
  typename TestFixture::tracker_type a(exec, rig(), params());
  typename TestFixture::tracker_type b(exec, rig(), params());
  for (int i = 0; i < 2; ++i) {  // queued one behind the other, without waiting in between
    auto const& f = walk(static_cast<unsigned>(i))[0];
    auto& tracker = i == 0 ? a : b;
    set_images(tracker, 0, f);
    test::frame_inputs in(tracker);
    in.predicted[0] = f.T_cw;
    in.extract(exec);
  }
  exec.wait();
  expect_same(take(a, 0, false), track_alone(exec, 0)[0]);
  expect_same(take(b, 0, false), track_alone(exec, 1)[0]);
}

TYPED_TEST(frame_tracker_test, a_moved_tracker_goes_on) {
  auto const& exec = this->exec();
  typename TestFixture::tracker_type first(exec, rig(), params());
  track(first, exec, {&walk(0)});
  auto second = std::move(first);
  first = typename TestFixture::tracker_type(exec, rig(), params());
  expect_same(track(second, exec, {&walk(1)}), track_alone(exec, 1));
  expect_same(track(first, exec, {&walk(2)}), track_alone(exec, 2));
}

TYPED_TEST(frame_tracker_test, a_batch_is_that_many_trackers) {
  auto const& exec = this->exec();
  // On a device, images of nine cameras are uploaded in parts.
  for (std::size_t const batch : {3u, 9u}) {
    typename TestFixture::tracker_type tracker(exec, rig(), params(), static_cast<int>(batch));
    std::vector<decltype(&walk(0))> walks;
    for (unsigned b = 0; b < batch; ++b) { walks.push_back(&walk(b % 3)); }
    auto const together = track(tracker, exec, walks);
    for (unsigned b = 0; b < batch; ++b) {
      SCOPED_TRACE("camera " + std::to_string(b) + " of " + std::to_string(batch));
      std::vector<snapshot> mine;
      for (std::size_t s = b; s < together.size(); s += batch) { mine.push_back(together[s]); }
      expect_same(mine, track_alone(exec, b % 3));
    }
    if (!exec.asynchronous) { break; }
  }
}

TYPED_TEST(frame_tracker_test, twenty_runs_give_the_same_bits) {
  auto const& exec = this->exec();
  typename TestFixture::tracker_type tracker(exec, rig(), params());
  auto const first = track(tracker, exec, {&walk(0)});
  for (int run = 1; run < std::max(3, test::effort(20)); ++run) {
    SCOPED_TRACE("run " + std::to_string(run));
    expect_same(track(tracker, exec, {&walk(0)}), first);
    if (this->HasFailure()) { return; }
  }
}

// ---- borrowed images --------------------------------------------------------------------------

/// Where the cameras of a batch leave their images, two frames in turn: rows of another length than
/// the tracker's own, what is beyond the pixels is noise.
template <typename Exec>
class camera_memory {
public:
  /// @param stride bytes from row to row
  camera_memory(int image_width, int stride, int pairs)
      : width_(image_width),
        stride_(stride),
        pairs_(pairs),
        memory_(4 * at(pairs) * at(stride) * at(height)) {}

  /// Writes an image over the one of two frames before. @param rows of `width` pixels, of which the
  /// first count
  ft::gray_view put(int frame, int b, int camera, image const& rows) {
    std::uint8_t* const to =
        memory_.data() +
        (2 * (static_cast<std::ptrdiff_t>(frame % 2) * pairs_ + b) + camera) * stride_ * height;
    for (int y = 0; y < height; ++y) {
      std::uint8_t* const row = to + static_cast<std::ptrdiff_t>(y) * stride_;
      std::copy_n(rows.data() + static_cast<std::ptrdiff_t>(y) * width, width_, row);
      for (int x = width_; x < stride_; ++x) { row[x] = static_cast<std::uint8_t>(random_()); }
    }
    return {to, width_, height, stride_};
  }

private:
  int width_;
  int stride_;
  int pairs_;
  ft::buffer<std::uint8_t, ft::staging_space<Exec>> memory_;
  std::mt19937 random_{7};
};

ft::tracker_params params_of_width(int image_width) {
  auto p = params();
  p.orb.width = image_width;
  return p;
}

/// Two walks at a time with images of the left `image_width` columns. @param borrows of frame, pair
/// and camera: whether this image is borrowed or copied
template <typename Exec, typename Borrows>
std::vector<snapshot> track_two(Exec const& exec, int image_width, int stride,
                                Borrows const& borrows) {
  ft::frame_tracker<Exec> tracker(exec, rig(), params_of_width(image_width), 2);
  camera_memory<Exec> memory(image_width, stride, 2);
  return track(tracker, exec, {&walk(0), &walk(1)}, [&](int b, int frame, stereo_frame const& f) {
    for (int c = 0; c < 2; ++c) {
      image const& rows = c == 0 ? f.left : f.right;
      if (borrows(frame, b, c)) {
        tracker.borrow_image(b, c, memory.put(frame, b, c, rows));
      } else {
        tracker.set_image(b, c, {rows.data(), image_width, height, width});
      }
    }
  });
}

TYPED_TEST(frame_tracker_test, borrowed_images_give_the_bits_of_copied_ones) {
  auto const& exec = this->exec();
  // Rows that end with 16 bytes, and inside them: then bytes beyond the pixels come along.
  for (int const image_width : {469, 480}) {
    if (image_width == 480 && test::effort(100) < 100) { continue; }
    SCOPED_TRACE("width " + std::to_string(image_width));
    auto const copied = track_two(exec, image_width, 480, [](int, int, int) { return false; });
    ASSERT_GT(copied.back().inliers, 100);
    for (int const stride : {480, 496, 1024}) {
      if (stride == 496 && !test::whole_effort()) { continue; }
      SCOPED_TRACE("stride " + std::to_string(stride));
      expect_same(track_two(exec, image_width, stride, [](int, int, int) { return true; }), copied);
    }
    expect_same(track_two(exec, image_width, 528,
                          [](int frame, int b, int c) { return (frame + b + c) % 2 == 0; }),
                copied);
    expect_same(track_two(exec, image_width, 528,
                          [](int frame, int b, int c) { return frame == 1 ? b == 1 : c == 1; }),
                copied);
  }
}

TYPED_TEST(frame_tracker_test, an_image_stays_borrowed_until_the_next_call_for_its_camera) {
  auto const& exec = this->exec();
  auto const& frames = walk(2);
  auto const extracted = [&](auto& tracker) {
    tracker.extract(exec);
    exec.wait();
    return take(tracker, 0, false);
  };
  std::vector<snapshot> want;
  typename TestFixture::tracker_type copying(exec, rig(), params());
  for (auto const& f : frames) {
    set_images(copying, 0, f);
    want.push_back(extracted(copying));
  }
  ASSERT_FALSE(same_bits(want[0].x, want[1].x));
  ASSERT_FALSE(same_bits(want[1].x, want[2].x));

  camera_memory<typename TestFixture::exec_type> memory(width, width + 64, 1);
  typename TestFixture::tracker_type tracker(exec, rig(), params());
  set_images(tracker, 0, frames[2]);
  for (int c = 0; c < 2; ++c) {
    tracker.borrow_image(0, c, memory.put(0, 0, c, c == 0 ? frames[0].left : frames[0].right));
  }
  expect_same(extracted(tracker), want[0]);
  expect_same(extracted(tracker), want[0]);
  for (int c = 0; c < 2; ++c) {  // written by the camera, where the last one lay
    memory.put(0, 0, c, c == 0 ? frames[1].left : frames[1].right);
  }
  expect_same(extracted(tracker), want[1]);
  // What set_image() left in the tracker's own memory is still there.
  for (int c = 0; c < 2; ++c) { EXPECT_NE(tracker.staged_image(0, c), nullptr); }
  expect_same(extracted(tracker), want[2]);
  for (int c = 0; c < 2; ++c) {
    tracker.borrow_image(0, c, memory.put(1, 0, c, c == 0 ? frames[1].left : frames[1].right));
  }
  for (int c = 0; c < 2; ++c) {  // decoded straight into the tracker's
    image const& rows = c == 0 ? frames[0].left : frames[0].right;
    std::uint8_t* const to = tracker.staged_image(0, c);
    for (int y = 0; y < height; ++y) {
      std::copy_n(rows.data() + static_cast<std::ptrdiff_t>(y) * width, width,
                  to + static_cast<std::ptrdiff_t>(y) * tracker.staged_stride());
    }
  }
  expect_same(extracted(tracker), want[0]);
}

TYPED_TEST(frame_tracker_test, a_moved_tracker_keeps_what_it_borrowed) {
  auto const& exec = this->exec();
  camera_memory<typename TestFixture::exec_type> memory(width, width + 16, 1);
  typename TestFixture::tracker_type first(exec, rig(), params());
  auto const& f = walk(0)[1];
  set_images(first, 0, f);
  first.extract(exec);
  exec.wait();
  auto const want = take(first, 0, false);
  set_images(first, 0, walk(0)[2]);
  first.borrow_image(0, 0, memory.put(0, 0, 0, f.left));
  first.borrow_image(0, 1, memory.put(0, 0, 1, f.right));
  auto second = std::move(first);
  second.extract(exec);
  exec.wait();
  expect_same(take(second, 0, false), want);
}

TYPED_TEST(frame_tracker_test, refuses_images_that_it_cannot_borrow_and_keeps_the_one_it_has) {
  auto const& exec = this->exec();
  auto const& f = walk(0)[0];
  typename TestFixture::tracker_type tracker(exec, rig(), params(), 2);
  for (int b = 0; b < 2; ++b) { set_images(tracker, b, walk(1)[0]); }
  test::frame_inputs in(tracker);
  in.predicted = {walk(1)[0].T_cw, f.T_cw};
  camera_memory<typename TestFixture::exec_type> memory(width, width + 32, 1);
  auto const good = memory.put(0, 0, 0, f.left);
  tracker.borrow_image(1, 0, good);
  tracker.borrow_image(1, 1, memory.put(0, 0, 1, f.right));
  auto const refused = [&](int b, int camera, ft::gray_view v) {
    EXPECT_THROW(tracker.borrow_image(b, camera, v), ft::bad_argument);
  };
  int const stride = good.stride;
  refused(1, 0, {nullptr, width, height, stride});
  refused(1, 0, {});
  refused(1, 0, {good.data, width + 1, height, stride});
  refused(1, 0, {good.data, width - 1, height, stride});
  refused(1, 0, {good.data, width, height - 1, stride});
  refused(1, 0, {good.data, height, width, stride});
  refused(1, 0, {good.data, width, height, width - 16});
  refused(1, 0, {good.data, width, height, -stride});
  for (int const off : {1, 4, 8, 15}) {
    refused(1, 0, {good.data + off, width, height, stride});
    refused(1, 0, {good.data, width, height, stride - off});
  }
  refused(2, 0, good);
  refused(-1, 0, good);
  refused(1, 2, good);
  refused(1, -1, good);
  EXPECT_THROW(tracker.staged_image(2, 0), ft::bad_argument);
  EXPECT_THROW(tracker.staged_image(-1, 0), ft::bad_argument);
  EXPECT_THROW(tracker.staged_image(1, 2), ft::bad_argument);
  EXPECT_THROW(tracker.staged_image(1, -1), ft::bad_argument);
  in.extract(exec);
  exec.wait();
  expect_same(take(tracker, 0, false), track_alone(exec, 1)[0]);
  expect_same(take(tracker, 1, false), track_alone(exec, 0)[0]);
}

TYPED_TEST(frame_tracker_test, counts_the_bytes_that_a_frame_fetches) {
  for (int const pairs : {1, 3}) {
    typename TestFixture::tracker_type const tracker(this->exec(), rig(), params(), pairs);
    auto const b = at(pairs);
    std::size_t const images = 2 * b * at(tracker.staged_stride()) * at(height);
    std::size_t const inputs =
        b * (sizeof(ft::pose) + sizeof(int) * (2 + at(params().local_points)));
    EXPECT_GE(tracker.input_bytes(), images + inputs);
    EXPECT_LE(tracker.input_bytes(), images + inputs + 6 * 256) << "four pieces, and two ends";
  }
}

#if defined(__CUDACC__)

struct alignas(16) quad_of_pixels {
  std::uint8_t pixels[16];
};

/// What the device cannot read is refused on the calling thread; what it can is not, also where
/// that thread has not used the device yet.
TEST(borrowed_images, come_from_memory_that_the_device_reads) {
  if (!test::cuda_backend::available()) { GTEST_SKIP() << "no CUDA device"; }
  test::cuda_backend const backend;
  auto const& exec = backend.exec;
  auto const& f = walk(0)[0];
  ft::frame_tracker<ft::cuda_exec> tracker(exec, rig(), params());
  test::frame_inputs in(tracker);
  in.predicted[0] = f.T_cw;
  std::vector<quad_of_pixels> pageable(at(width) / sizeof(quad_of_pixels) * at(height));
  std::memcpy(pageable.data(), f.left.data(), f.left.size());
  auto const* const ordinary = reinterpret_cast<std::uint8_t const*>(pageable.data());
  camera_memory<ft::cuda_exec> memory(width, width, 1);
  ft::gray_view const views[2] = {memory.put(0, 0, 0, f.left), memory.put(0, 0, 1, f.right)};
  int refused = 0;
  std::string error;
  std::thread([&] {
    try {
      for (int c = 0; c < 2; ++c) {
        tracker.borrow_image(0, c, views[c]);
        try {
          tracker.borrow_image(0, c, {ordinary, width, height, width});
        } catch (ft::bad_argument const&) { ++refused; }
      }
    } catch (std::exception const& e) { error = e.what(); }
  }).join();
  EXPECT_EQ(error, "");
  EXPECT_EQ(refused, 2);
  EXPECT_THROW(tracker.borrow_image(0, 0, {ordinary, width, height, width}), ft::bad_argument);
  in.extract(exec);
  exec.wait();
  expect_same(take(tracker, 0, false), track_alone(exec, 0)[0]);
}

/// Memory is pinned as far as it was registered.
TEST(borrowed_images, lie_in_registered_memory_with_their_last_byte) {
  if (!test::cuda_backend::available()) { GTEST_SKIP() << "no CUDA device"; }
  test::cuda_backend const backend;
  auto const& exec = backend.exec;
  ft::frame_tracker<ft::cuda_exec> tracker(exec, rig(), params());
  auto const& f = walk(0)[0];
  test::frame_inputs in(tracker);
  in.predicted[0] = f.T_cw;
  std::size_t const bytes = f.left.size();
  ft::buffer<std::uint8_t, ft::memory_space::host> const memory(4 * bytes);
  std::copy(f.left.begin(), f.left.end(), memory.data());
  std::copy(f.right.begin(), f.right.end(), memory.data() + bytes);
  auto const borrow = [&](int camera, std::size_t from) {
    tracker.borrow_image(0, camera, {memory.data() + from, width, height, width});
  };
  ft::throw_on_error(cudaHostRegister(memory.data(), 2 * bytes, cudaHostRegisterDefault),
                     "cudaHostRegister");
  borrow(0, 0);
  borrow(1, bytes);
  EXPECT_THROW(borrow(1, bytes + bytes / 2), ft::bad_argument);
  EXPECT_THROW(borrow(1, 3 * bytes), ft::bad_argument);
  in.extract(exec);
  exec.wait();
  expect_same(take(tracker, 0, false), track_alone(exec, 0)[0]);
  ft::throw_on_error(cudaHostUnregister(memory.data()), "cudaHostUnregister");
  EXPECT_THROW(borrow(0, 0), ft::bad_argument);
}

#endif

// ---- memory -----------------------------------------------------------------------------------

#if !defined(__CUDACC__)

TEST(frame_tracker_memory, the_counter_counts) {
  auto count = std::make_unique<allocation_count>();
  auto const one = std::make_unique<int>(1);
  std::vector<int> const two(10, *one);
  ft::buffer<int, ft::memory_space::host> const three(10);
  EXPECT_EQ(count->so_far(), 3);
  count.reset();
  std::vector<int> const not_counted(static_cast<std::size_t>(two[0]));
  EXPECT_EQ(allocation_count().so_far(), 0);
}

TEST(frame_tracker_memory, a_frame_takes_nothing_from_the_heap) {
  ft::host_exec const exec(1);
  for (bool const measure : {false, true}) {
    SCOPED_TRACE(measure ? "with stage times" : "without stage times");
    auto p = params();
    p.measure_stages = measure;
    ft::frame_tracker<ft::host_exec> tracker(exec, rig(), p);
    test::frame_inputs in(tracker);
    track(in, exec, {&walk(0)});
    auto const points = [&] {
      set_images(tracker, 0, walk(0)[0]);
      tracker.extract(exec);
      return points_of(tracker, exec, 0);
    }();
    camera_memory<ft::host_exec> memory(width, width, 1);
    auto const lent = memory.put(0, 0, 0, walk(0)[0].left);
    ft::slot_list const slots{in.local_slots.data(), in.local_count[0]};
    ft::frame_input const input{in.predicted[0], slots};
    std::vector<std::pair<std::string, long>> taken;
    auto const during = [&](char const* name, auto call) {
      allocation_count const count;
      call();
      taken.emplace_back(name, count.so_far());
    };
    taken.reserve(10);
    during("extract", [&] { tracker.extract(exec); });
    during("set_last", [&] { tracker.set_last(exec, 0, in.last_pose[0], in.last_holder); });
    during("track", [&] { tracker.track(exec, input); });
    during("track_motion", [&] { tracker.track_motion(exec, input.T_predicted); });
    during("track_local", [&] { tracker.track_local(exec, slots); });
    during("relocalize", [&] { tracker.relocalize(exec, input); });
    int with_point = 0;
    during("frame", [&] {
      for (auto const& k : tracker.frame().left()) { with_point += static_cast<int>(k.slot >= 0); }
    });
    EXPECT_EQ(with_point, tracker.frame().inliers());
    during("update_map",
           [&] { tracker.update_map(exec, 0, points.data(), static_cast<int>(points.size())); });
    during("set_image", [&] { set_images(tracker, 0, walk(0)[0]); });
    during("borrow_image", [&] { tracker.borrow_image(0, 0, lent); });
    for (auto const& [name, allocations] : taken) { EXPECT_EQ(allocations, 0) << name; }
  }
}

#endif

/// Two threads on executors of one thread each: what a thread sanitizer can look at in full.
TEST(frame_tracker_memory, two_threads_share_nothing) {
  std::vector<snapshot> alone[2] = {track_alone(ft::host_exec(1), 0),
                                    track_alone(ft::host_exec(1), 1)};
  std::vector<snapshot> together[2];
  std::vector<std::thread> threads;
  for (unsigned i = 0; i < 2; ++i) {
    threads.emplace_back([i, &together] { together[i] = track_alone(ft::host_exec(1), i); });
  }
  for (auto& t : threads) { t.join(); }
  for (int i = 0; i < 2; ++i) { expect_same(together[i], alone[i]); }
}

#if defined(__CUDACC__)
TEST(frame_tracker_memory, a_frame_takes_nothing_from_the_device) {
  if (!test::cuda_backend::available()) { GTEST_SKIP() << "no CUDA device"; }
  test::cuda_backend backend;
  ft::frame_tracker<ft::cuda_exec> tracker(backend.exec, rig(), params());
  track(tracker, backend.exec, {&walk(0)});  // kernels are loaded on their first launch
  auto const free_bytes = [] {
    std::size_t free = 0;
    std::size_t total = 0;
    ft::throw_on_error(cudaMemGetInfo(&free, &total), "cudaMemGetInfo");
    return free;
  };
  std::size_t const before = free_bytes();
  for (int run = 1; run < 5; ++run) { track(tracker, backend.exec, {&walk(0)}); }
  EXPECT_EQ(free_bytes(), before);
}
#endif

}  // namespace tracker_parity
