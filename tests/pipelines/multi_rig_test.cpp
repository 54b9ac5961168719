// SPDX-License-Identifier: Apache-2.0
// Rigs of several cameras: one pose from all of them, in a rendered room.
#include "ft/cameras/multi_rig.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "ft/pipelines/frame_tracker.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/multi_rig_walk.hpp"
#include "tests/support/room.hpp"
#include "tests/support/tracking.hpp"

namespace multi_rig_test {

using test::snapshot;
using test::room::at;
using test::room::image;
using namespace test::rigs;

template <typename Tracker>
void set_images(Tracker& tracker, int b, rig_frame const& f) {
  for (std::size_t i = 0; i < f.images.size(); ++i) {
    if (!f.images[i].empty()) {
      tracker.set_image(b, static_cast<int>(i), test::room::view(f.images[i]));
    }
  }
}

/// Map points of all keypoints with depth, in slots of their own, and the holders.
struct seen_points {
  std::vector<ft::point_update> points;
  std::vector<int> slots;
  std::vector<int> holders;  ///< [numbers]
};

template <typename Tracker, typename Exec>
seen_points points_of(Tracker const& tracker, Exec const& exec, int b, ft::pose const& T_cw) {
  seen_points all;
  ft::pose const T_wc = T_cw.inverse();
  auto const& g = tracker.geometry();
  all.holders.assign(at(Tracker::cameras * tracker.capacity()), -1);
  for (int c = 0; c < Tracker::cameras; ++c) {
    auto const keypoints = tracker.frame(b).camera(c);
    std::vector<ft::descriptor> orb(at(keypoints.size()));
    tracker.download_descriptors(exec, b, c, orb.data(), keypoints.size());
    exec.wait();
    for (ft::tracked_keypoint const k : keypoints) {
      if (!(k.depth > 0)) { continue; }
      ft::vec3<float> const p = T_wc * k.point;
      ft::vec3<float> const d = p - T_wc.t;
      float const distance = std::sqrt(ft::dot(d, d));
      float const farthest = distance * g.scale[k.octave];
      int const slot = static_cast<int>(all.points.size());
      all.points.push_back({slot,
                            1,
                            p,
                            {d.x / distance, d.y / distance, d.z / distance},
                            farthest / g.scale[g.levels - 1],
                            farthest,
                            orb[at(k.number)]});
      all.slots.push_back(slot);
      all.holders[at(c * tracker.capacity() + k.number)] = slot;
    }
  }
  return all;
}

ft::tracker_params params() {
  auto p = test::room::params();
  p.local_points = p.updates = p.map_slots;
  return p;
}

/// The first frame of each walk creates the map, the others are tracked from the last pose.
/// @param walks one a batch entry
/// @return per frame from the second on and batch entry
template <typename Rig, typename Exec>
std::vector<snapshot> track(Exec const& exec, Rig const& rig,
                            std::vector<std::vector<rig_frame> const*> const& walks) {
  auto const batch = static_cast<int>(walks.size());
  ft::frame_tracker<Exec, Rig> tracker(exec, rig, params(), batch);
  std::vector<seen_points> maps;
  std::vector<snapshot> all;
  for (std::size_t f = 0; f < walks[0]->size(); ++f) {
    for (int b = 0; b < batch; ++b) { set_images(tracker, b, (*walks[at(b)])[f]); }
    if (f == 0) {
      tracker.extract(exec);
      exec.wait();
      for (int b = 0; b < batch; ++b) {
        ft::pose const T_cw = (*walks[at(b)])[0].T_cw;
        maps.push_back(points_of(tracker, exec, b, T_cw));
        auto const& map = maps.back();
        tracker.update_map(exec, b, map.points.data(), static_cast<int>(map.points.size()));
        tracker.set_last(exec, b, T_cw, map.holders);
        exec.wait();
      }
      continue;
    }
    std::vector<ft::frame_input> in;
    for (int b = 0; b < batch; ++b) {
      in.push_back({f == 1 ? (*walks[at(b)])[0].T_cw : tracker.frame(b).T_cw(), maps[at(b)].slots});
    }
    tracker.track(exec, in.data());
    exec.wait();
    for (int b = 0; b < batch; ++b) {
      all.push_back(test::take(tracker, b, tracker.result().local_points));
    }
  }
  return all;
}

/// Distance of the body from its true place, metres.
float error_of(ft::pose const& T_cw, ft::pose const& truth) {
  auto const d = T_cw.inverse().t - truth.inverse().t;
  return std::sqrt(ft::dot(d, d));
}

/// Keypoints of camera c that hold a point.
int held(snapshot const& s, int c) {
  auto const capacity = static_cast<std::ptrdiff_t>(s.x.size() / s.keypoints.size());
  auto const first = s.holder.begin() + c * capacity;
  return static_cast<int>(std::count_if(first, first + capacity, [](int h) { return h >= 0; }));
}

template <typename Backend>
class multi_rig : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(multi_rig, test::backends);

TYPED_TEST(multi_rig, of_one_pair_gives_the_bits_of_a_rectified_rig) {
  TypeParam backend;
  ft::multi_rig<1> const one{{pair_at(ft::pose::identity())}};
  auto const first = make_walk(one, 0, 4);
  auto const second = make_walk(one, 1, 4);
  auto const a = track(backend.exec, one, {&first, &second});
  auto const b = track(backend.exec, test::room::rig(), {&first, &second});
  ASSERT_EQ(a.size(), 6u);
  EXPECT_GT(a.back().inliers, 100);
  test::room::expect_same(a, b);
}

TYPED_TEST(multi_rig, of_two_pairs_gives_one_pose_that_is_as_exact_as_the_better_one) {
  TypeParam backend;
  auto const rig = two_pairs();
  double square[3] = {};  // of errors: of the rig, and of each pair alone
  for (unsigned seed = 0; seed < 3; ++seed) {
    auto const walk = make_walk(rig, seed, 4);
    auto const both = track(backend.exec, rig, {&walk});
    std::vector<snapshot> alone[2];
    for (std::size_t c = 0; c < 2; ++c) {
      auto part = walk;
      for (auto& f : part) { f.images = {f.images[2 * c], f.images[2 * c + 1]}; }
      alone[c] = track(backend.exec, ft::multi_rig<1>{{rig.of[c]}}, {&part});
    }
    for (std::size_t f = 0; f < both.size(); ++f) {
      SCOPED_TRACE("walk " + std::to_string(seed) + " frame " + std::to_string(f + 1));
      auto const& truth = walk[f + 1].T_cw;
      EXPECT_LT(error_of(both[f].T_cw, truth), 0.012f);
      for (int c = 0; c < 2; ++c) { EXPECT_GT(held(both[f], c), 80) << c; }
      EXPECT_EQ(both[f].inliers, held(both[f], 0) + held(both[f], 1));
      float const e[3] = {error_of(both[f].T_cw, truth), error_of(alone[0][f].T_cw, truth),
                          error_of(alone[1][f].T_cw, truth)};
      for (int k = 0; k < 3; ++k) { square[k] += static_cast<double>(e[k] * e[k]); }
    }
  }
  EXPECT_LE(square[0], std::min(square[1], square[2]));
  this->RecordProperty("rms_mm", std::to_string(1000 * std::sqrt(square[0] / 9)));
}

TYPED_TEST(multi_rig, tracks_while_one_of_its_pairs_is_black) {
  TypeParam backend;
  auto const rig = two_pairs();
  auto const whole = make_walk(rig, 2, 4);
  for (std::size_t c = 0; c < 2; ++c) {
    SCOPED_TRACE("pair " + std::to_string(c));
    auto const walk = blackened(whole, c);
    auto const seen = track(backend.exec, rig, {&walk});
    for (std::size_t f = 0; f < seen.size(); ++f) {
      EXPECT_EQ(held(seen[f], static_cast<int>(c)), 0);
      EXPECT_GT(seen[f].inliers, 80);
      EXPECT_LT(error_of(seen[f].T_cw, walk[f + 1].T_cw), 0.02f);
    }
  }
}

TYPED_TEST(multi_rig, a_single_camera_tracks_the_points_of_a_pair) {
  TypeParam backend;
  ft::multi_rig<2> const rig{
      {single_at(turned(-0.05f, {-0.2f, 0.03f, 0.1f})), pair_at(turned(0.05f, {0.1f, 0, 0}))}};
  auto const walk = make_walk(rig, 1, 4);
  auto const seen = track(backend.exec, rig, {&walk});
  for (std::size_t f = 0; f < seen.size(); ++f) {
    EXPECT_GT(held(seen[f], 0), 30) << f;
    EXPECT_GT(held(seen[f], 1), 80) << f;
    EXPECT_LT(error_of(seen[f].T_cw, walk[f + 1].T_cw), 0.015f) << f;
    auto const capacity = static_cast<std::ptrdiff_t>(seen[f].x.size() / 2);
    EXPECT_TRUE(std::none_of(seen[f].depth.begin(), seen[f].depth.begin() + capacity,
                             [](float d) { return d > 0; }));
  }
}

TYPED_TEST(multi_rig, a_batch_gives_what_its_rigs_give_alone) {
  TypeParam backend;
  auto const rig = two_pairs();
  std::vector<std::vector<rig_frame>> walks;
  for (unsigned seed = 0; seed < 3; ++seed) { walks.push_back(make_walk(rig, seed, 3)); }
  // On a device, images of nine rigs are uploaded in parts.
  for (std::size_t const batch : {3u, 9u}) {
    std::vector<std::vector<rig_frame> const*> of;
    for (std::size_t b = 0; b < batch; ++b) { of.push_back(&walks[b % 3]); }
    auto const together = track(backend.exec, rig, of);
    ASSERT_EQ(together.size(), 2 * batch);
    for (std::size_t b = 0; b < 3; ++b) {
      auto const alone = track(backend.exec, rig, {&walks[b]});
      for (std::size_t k = b; k < batch; k += 3) {
        test::room::expect_same(alone, {together[k], together[batch + k]});
      }
    }
    if (!backend.exec.asynchronous) { break; }
  }
}

TYPED_TEST(multi_rig, gives_the_bits_of_the_host) {
  TypeParam backend;
  ft::multi_rig<3> const rig{{pair_at(turned(0.1f, {0.1f, 0.02f, 0.2f})),
                              single_at(turned(-0.1f, {-0.2f, 0, 0.1f})),
                              pair_at(turned(1.4f, {0.3f, 0, -0.1f}))}};
  auto const walk = make_walk(rig, 0, 4);
  auto const here = track(backend.exec, rig, {&walk});
  EXPECT_GT(here.back().inliers, 200);
  test::room::expect_same(here, track(ft::host_exec{}, rig, {&walk}));
}

TYPED_TEST(multi_rig, cameras_that_are_not_used_change_nothing) {
  TypeParam backend;
  auto const two = two_pairs();
  ft::multi_rig<3> const three{{two.of[0], two.of[1], ft::rig_camera::none()}};
  auto walk = make_walk(two, 0, 4);
  auto const expected = track(backend.exec, two, {&walk});
  for (rig_frame& f : walk) { f.images.resize(6); }
  auto const seen = track(backend.exec, three, {&walk});
  ASSERT_EQ(seen.size(), expected.size());
  for (std::size_t f = 0; f < seen.size(); ++f) {
    SCOPED_TRACE("frame " + std::to_string(f + 1));
    EXPECT_GT(seen[f].inliers, 200);
    EXPECT_EQ(seen[f].inliers, expected[f].inliers);
    EXPECT_EQ(seen[f].keypoints[2], 0);
    for (int c = 0; c < 2; ++c) { EXPECT_EQ(held(seen[f], c), held(expected[f], c)) << c; }
    for (int k = 0; k < 9; ++k) { EXPECT_EQ(seen[f].T_cw.R.m[k], expected[f].T_cw.R.m[k]) << k; }
    EXPECT_EQ(seen[f].T_cw.t.x, expected[f].T_cw.t.x);
    EXPECT_EQ(seen[f].T_cw.t.y, expected[f].T_cw.t.y);
    EXPECT_EQ(seen[f].T_cw.t.z, expected[f].T_cw.t.z);
  }
  ft::frame_tracker<decltype(backend.exec), ft::multi_rig<3>> tracker(backend.exec, three,
                                                                      params());
  EXPECT_THROW(tracker.set_image(0, 4, test::room::view(walk[0].images[0])), ft::bad_argument);
}

TEST(multi_rig_errors, name_what_is_wrong) {
  ft::host_exec const exec;
  ft::multi_rig<2> const rig{
      {pair_at(ft::pose::identity()), single_at(turned(0.5f, {0.1f, 0, 0}))}};
  ft::frame_tracker<ft::host_exec, ft::multi_rig<2>> tracker(exec, rig, params());
  image const black(at(test::room::width) * at(test::room::height));
  auto const view = test::room::view(black);
  for (int i = 0; i < 2; ++i) { tracker.set_image(0, i, view); }
  EXPECT_THROW(tracker.extract(exec), ft::bad_argument) << "no image of camera 1";
  EXPECT_THROW(tracker.set_image(0, 3, view), ft::bad_argument) << "a single camera's right one";
  EXPECT_THROW(tracker.set_image(0, 4, view), ft::bad_argument);
  tracker.set_image(0, 2, view);
  EXPECT_NO_THROW(tracker.extract(exec));

  ft::multi_rig<1> const alone{{single_at(ft::pose::identity())}};
  EXPECT_NO_THROW(alone.check());

  auto const refused = [](ft::rig_camera const& c) {
    EXPECT_THROW(ft::multi_rig<1>{{c}}.check(), ft::bad_argument);
  };
  auto wrong = pair_at(ft::pose::identity());
  EXPECT_NO_THROW(wrong.check());
  wrong.baseline = -0.1;
  refused(wrong);
  wrong = pair_at(ft::pose::identity());
  wrong.T_cb.R.m[0] = -1;  // a reflection
  refused(wrong);
  wrong.T_cb.R.m[0] = 1.1f;
  refused(wrong);
  wrong = pair_at(ft::pose::identity());
  wrong.T_cb.t.x = std::nanf("");
  refused(wrong);
  wrong = pair_at(ft::pose::identity());
  wrong.camera.fx = 0;
  refused(wrong);
}

}  // namespace multi_rig_test
