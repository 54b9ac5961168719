// SPDX-License-Identifier: Apache-2.0
// Odometry with rigs of cameras of several models, in a rendered room.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "ft/cameras/any_camera.hpp"
#include "ft/cameras/mixed_rig.hpp"
#include "ft/core/error.hpp"
#include "ft/pipelines/explain.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/mixed_rig_walk.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/room.hpp"

namespace mixed_rig_odometry_test {

using test::error_of;
using namespace test::rigs;
using camera = ft::mixed_rig_camera;

template <typename Backend>
class mixed_rig_odometry : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(mixed_rig_odometry, test::backends);

/// One size of rig, so that an odometry is compiled once: cameras that are not named are not used.
constexpr int cameras = 6;
using rig_type = ft::mixed_rig<cameras>;

rig_type rig_of(std::vector<camera> const& some) {
  rig_type rig;
  std::fill_n(rig.of, cameras, camera::none());
  std::copy(some.begin(), some.end(), rig.of);
  return rig;
}
/// The fisheye cameras of the room's pair, at T_lb.
std::vector<camera> fisheyes(ft::pose const& T_lb) {
  auto const pair = test::room::fisheye();
  return {camera::single(any::of(pair.left), T_lb),
          camera::single(any::of(pair.right), pair.T_rl * T_lb)};
}
camera pinhole(ft::pose const& T_cb) {
  return camera::single(any::of(test::room::rig().camera), T_cb);
}
camera depth_camera(ft::pose const& T_cb) {
  return camera::with_depth(
      any::of(ft::radtan5<float>{280, 281, 238, 181, {-0.1f, 0.02f, 0.0005f, -0.0003f, 0.0f}}), 0.1,
      0, T_cb);
}
ft::pose ahead() { return turned(0.1f, {0.1f, 0.02f, 0.2f}); }
ft::pose aside() { return turned(1.4f, {0.3f, 0, -0.1f}); }

/// Two fisheye pairs, one pinhole and one camera with a depth image.
rig_type whole() {
  auto all = fisheyes(ahead());
  auto const second = fisheyes(aside());
  all.insert(all.end(), second.begin(), second.end());
  all.push_back(pinhole(turned(-0.4f, {-0.1f, 0, 0})));
  all.push_back(depth_camera(turned(-1.2f, {-0.2f, 0.05f, 0})));
  rig_type rig = rig_of(all);
  ft::pair_up(rig, 0, 1);
  ft::pair_up(rig, 2, 3);
  return rig;
}

struct run {
  std::vector<ft::tracking> frames;
  double rms = 0;  ///< metres
};

template <typename Exec>
run follow(Exec const& exec, rig_type const& rig, std::vector<mixed_frame> const& walk) {
  ft::odometry<Exec, rig_type> odo(exec, rig, test::room::odometry_params(8192));
  run r;
  std::int64_t time = 0;
  for (mixed_frame const& f : walk) {
    r.frames.push_back(odo.track(views_of<cameras>(f), time += 50'000'000));
    double const e = error_of(r.frames.back(), f, walk[0]);
    r.rms += e * e / static_cast<double>(walk.size());
  }
  r.rms = std::sqrt(r.rms);
  return r;
}
void expect_tracked(run const& r) {
  for (std::size_t f = 0; f < r.frames.size(); ++f) {
    EXPECT_EQ(r.frames[f].state, ft::tracking_state::tracking) << f;
  }
}

TYPED_TEST(mixed_rig_odometry, two_fisheye_pairs_a_pinhole_and_a_depth_camera_give_one_pose) {
  TypeParam backend;
  auto const rig = whole();
  auto const walk = make_mixed_walk(rig, 0, 16);
  auto const all = follow(backend.exec, rig, walk);
  expect_tracked(all);
  EXPECT_GE(all.frames.back().keyframes, 2);
  // Each part that has depths of its own, alone: the other cameras are not used.
  double best = 1;
  std::string alone;
  int const parts[3][2] = {{0, 1}, {2, 3}, {5, 5}};
  for (auto const& [first, last] : parts) {
    rig_type part = rig;
    for (int c = 0; c < cameras; ++c) {
      if (c < first || c > last) { part.of[c] = camera::none(); }
    }
    auto const r = follow(backend.exec, part, walk);
    expect_tracked(r);
    EXPECT_LT(r.rms, 0.02) << first;
    best = std::min(best, r.rms);
    alone += std::to_string(1000 * r.rms) + " ";
  }
  EXPECT_LT(all.rms, 0.01);
  EXPECT_LE(all.rms, best);
  this->RecordProperty("rms_mm", std::to_string(1000 * all.rms));
  this->RecordProperty("rms_mm_alone", alone);
}

/// On a device, images of eight rigs are uploaded in parts.
TYPED_TEST(mixed_rig_odometry, a_batch_gives_what_its_rigs_give_alone) {
  TypeParam backend;
  int const batch = TypeParam::exec_type::asynchronous ? 8 : 2;
  auto const rig = whole();
  std::vector<mixed_frame> const walks[2]{make_mixed_walk(rig, 0, 4), make_mixed_walk(rig, 1, 4)};
  run const alone[2]{follow(backend.exec, rig, walks[0]), follow(backend.exec, rig, walks[1])};
  ft::odometry<typename TypeParam::exec_type, rig_type> odo(
      backend.exec, rig, test::room::odometry_params(8192), batch);
  for (std::size_t f = 0; f < walks[0].size(); ++f) {
    std::vector<ft::mixed_images<cameras>> images;
    for (int b = 0; b < batch; ++b) { images.push_back(views_of<cameras>(walks[b % 2][f])); }
    std::vector<std::int64_t> const times(images.size(),
                                          static_cast<std::int64_t>(f + 1) * 50'000'000);
    ft::tracking const* const t = odo.track(images.data(), times.data());
    for (int b = 0; b < batch; ++b) {
      EXPECT_TRUE(test::same(t[b], alone[b % 2].frames[f])) << "rig " << b << ", frame " << f;
    }
  }
}

TYPED_TEST(mixed_rig_odometry, a_fisheye_pair_is_as_exact_as_a_stereo_rig) {
  TypeParam backend;
  auto rig = rig_of(fisheyes(ft::pose::identity()));
  ft::pair_up(rig, 0, 1);
  auto const walk = make_mixed_walk(rig, 1, 12);
  auto const mixed = follow(backend.exec, rig, walk);
  expect_tracked(mixed);
  ft::odometry<typename TypeParam::exec_type, test::room::fisheye_rig> odo(
      backend.exec, test::room::fisheye(), test::room::odometry_params(8192));
  double sum = 0;
  std::int64_t time = 0;
  for (mixed_frame const& f : walk) {
    auto const t = odo.track({test::room::view(f.images[0]), test::room::view(f.images[2])},
                             time += 50'000'000);
    double const e = error_of(t, f, walk[0]);
    sum += e * e;
  }
  double const pair = std::sqrt(sum / static_cast<double>(walk.size()));
  EXPECT_LT(mixed.rms, std::max(1.25 * pair, 0.002));
  this->RecordProperty("rms_mm", std::to_string(1000 * mixed.rms));
  this->RecordProperty("rms_mm_of_a_stereo_rig", std::to_string(1000 * pair));
}

// Kannala-Brandt cameras call an arc tangent in double, which may differ in its last place.
TYPED_TEST(mixed_rig_odometry, without_arc_tangents_gives_the_bits_of_the_host) {
  TypeParam backend;
  auto const pair = test::room::rig();
  auto rig = rig_of({camera::rectified(pair.camera, pair.baseline, ahead()), depth_camera(aside()),
                     pinhole(turned(-0.4f, {-0.1f, 0, 0})), pinhole(turned(-0.4f, {0.1f, 0, 0}))});
  ft::pair_up(rig, 2, 3);
  auto const walk = make_mixed_walk(rig, 2, 8);
  auto const here = follow(backend.exec, rig, walk);
  expect_tracked(here);
  EXPECT_LT(here.rms, 0.02);
  auto params = test::room::odometry_params(8192);
  params.prefetch = 2;
  ft::odometry<typename TypeParam::exec_type, rig_type> prefetching(backend.exec, rig, params);
  test::expect_same(test::track_all(prefetching, walk.size(), 50'000'000,
                                    [&](std::size_t i) { return views_of<cameras>(walk[i]); }),
                    here.frames);
  auto const host = follow(ft::host_exec(1), rig, walk);
  for (std::size_t f = 0; f < walk.size(); ++f) {
    EXPECT_TRUE(test::same(here.frames[f], host.frames[f])) << f;
  }
}

TYPED_TEST(mixed_rig_odometry, refuses_depths_of_an_unknown_unit_and_rigs_without_depths) {
  TypeParam backend;
  using odometry = ft::odometry<typename TypeParam::exec_type, rig_type>;
  auto const rig = rig_of({depth_camera(ft::pose::identity())});
  auto const walk = make_mixed_walk(rig, 0, 1);
  odometry odo(backend.exec, rig, test::room::odometry_params(2048));
  auto images = views_of<cameras>(walk[0]);
  std::vector<std::uint16_t> const integers(walk[0].depths[0].size(), 1000);
  images.depth[0] = ft::image_view<std::uint16_t const>{integers.data(), test::room::width,
                                                        test::room::height, test::room::width};
  EXPECT_THROW(odo.track(images, 1), ft::bad_argument) << "the unit is not known";
  EXPECT_THROW(odometry(backend.exec, rig_of(fisheyes(ahead())), test::room::odometry_params(2048)),
               ft::bad_argument);
}

TYPED_TEST(mixed_rig_odometry, goes_on_while_cameras_miss_images_and_depths) {
  TypeParam backend;
  auto const rig = whole();
  auto const walk = make_mixed_walk(rig, 1, 12);
  ft::odometry<typename TypeParam::exec_type, rig_type> odo(backend.exec, rig,
                                                            test::room::odometry_params(8192));
  std::int64_t time = 0;
  for (std::size_t f = 0; f < walk.size(); ++f) {
    auto images = views_of<cameras>(walk[f]);
    std::uint32_t missing = 0;
    if (f > 0) {
      missing = 1u << 2 * (f % cameras);
      images.of[2 * (f % cameras)] = {};
      if (f % 2 == 0) { images.depth[5] = {}; }
    }
    auto const t = odo.track(images, time += 50'000'000);
    EXPECT_EQ(t.state, ft::tracking_state::tracking) << f;
    EXPECT_EQ(t.missing_images, missing) << f;
    EXPECT_EQ(t.missing_depths, f > 0 && f % 2 == 0 ? 1u << 5 : 0u) << f;
    EXPECT_LT(error_of(t, walk[f], walk[0]), 0.02) << f;
  }
  auto images = views_of<cameras>(walk[0]);
  for (auto& of : images.of) { of = {}; }
  EXPECT_THROW(odo.track(images, time + 1), ft::bad_argument);
}

TYPED_TEST(mixed_rig_odometry, says_which_depth_image_is_missing) {
  TypeParam backend;
  auto const rig = rig_of({pinhole(aside()), depth_camera(ft::pose::identity())});
  auto const walk = make_mixed_walk(rig, 1, 4);
  auto params = test::room::odometry_params(8192);
  params.prefetch = 1;
  ft::odometry<typename TypeParam::exec_type, rig_type> odo(backend.exec, rig, params);
  auto const track = [&](std::size_t f, bool depth) {
    auto images = views_of<cameras>(walk[f]);
    if (!depth) { images.depth[1] = {}; }
    if (f % 2 == 0) { return odo.track(images, 50'000'000 * static_cast<std::int64_t>(f + 1)); }
    odo.prefetch(images);
    return odo.track_prefetched(50'000'000 * static_cast<std::int64_t>(f + 1));
  };
  auto const none = track(0, false);
  EXPECT_EQ(none.state, ft::tracking_state::initialising);
  EXPECT_EQ(none.missing_depths, 0b10u);
  auto const why = ft::explain(none);
  EXPECT_EQ(why.reason, ft::tracking_reason::images_missing);
  EXPECT_NE(why.text.find("depth image of camera 1"), std::string::npos) << why.text;
  bool const there[] = {true, true, false};  // of the following frames
  for (std::size_t f = 1; f < 4; ++f) {
    auto const t = track(f, there[f - 1]);
    EXPECT_EQ(t.state, ft::tracking_state::tracking) << f;
    EXPECT_EQ(t.missing_depths, there[f - 1] ? 0u : 0b10u) << f;
    EXPECT_EQ(t.missing_images, 0u) << f;
  }
}

TEST(mixed_rig, refuses_what_is_no_rig) {
  auto const refused = [](auto const& change) {
    rig_type rig = whole();
    rig.check();
    change(rig);
    EXPECT_THROW(rig.check(), ft::bad_argument);
  };
  refused([](rig_type& r) { r.of[1].left = -1; });
  refused([](rig_type& r) { r.of[0].right = 3; });
  refused([](rig_type& r) { r.of[0].right = cameras; });
  refused([](rig_type& r) { r.of[1].has_depth_image = true; });
  refused([](rig_type& r) { r.of[0].has_right_image = true; });
  refused([](rig_type& r) { r.of[0].baseline = 0; });
  refused([](rig_type& r) { r.of[4].baseline = 0.1; });
  refused([](rig_type& r) { r.of[5].depth_scale = -1; });
  refused([](rig_type& r) { r.of[5].max_depth = -1; });
  refused([](rig_type& r) { r.of[2].T_cb.R.m[0] = 2; });
  refused([](rig_type& r) { r.of[2].camera.kind = 1; });
  refused([](rig_type& r) { r.of[1] = camera::none(); });
  refused([](rig_type& r) { r.of[1].T_cb.t.x += 0.01f; });  // after pair_up()
  rig_type rig = whole();
  EXPECT_THROW(ft::pair_up(rig, 0, 0), ft::bad_argument);
  EXPECT_THROW(ft::pair_up(rig, 0, cameras), ft::bad_argument);
  rig.of[4].T_cb = rig.of[5].T_cb;
  EXPECT_THROW(ft::pair_up(rig, 4, 5), ft::bad_argument);
}

}  // namespace mixed_rig_odometry_test
