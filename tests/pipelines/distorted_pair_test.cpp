// SPDX-License-Identifier: Apache-2.0
// Odometry of a distorted pair: the geometry of its rectification, and the same answers as from
// images that were rectified before.
#include "ft/cameras/distorted_pair.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/kernels/images/build_remap.hpp"
#include "ft/kernels/images/rectify.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/refusals.hpp"
#include "tests/support/room.hpp"

namespace distorted_pair_test {

using test::room::at;
using test::room::height;
using test::room::image;
using test::room::stereo_frame;
using test::room::width;
constexpr std::int64_t period = 50'000'000;

using lens = ft::radtan4<float>;
using rig_type = ft::distorted_pair<lens>;

lens left_lens() { return {300, 301, 238, 181, {-0.21f, 0.06f, 4e-4f, -3e-4f}}; }
lens right_lens() { return {302, 300, 242, 178, {-0.2f, 0.05f, -3e-4f, 2e-4f}}; }

/// A right camera that is turned by 2 degrees, and a little above and ahead.
ft::pose T_right_left() {
  float const c = std::cos(0.03f), s = std::sin(0.03f), cx = std::cos(0.015f),
              sx = std::sin(0.015f);
  ft::mat3<float> const about_y{{c, 0, s, 0, 1, 0, -s, 0, c}};
  ft::mat3<float> const about_x{{1, 0, 0, 0, cx, -sx, 0, sx, cx}};
  return ft::pose{about_y * about_x, {0.25f, -0.006f, 0.004f}}.inverse();
}
rig_type rig() {
  return rig_type::make(left_lens(), right_lens(), T_right_left(), {290, 290, 239.5f, 179.5f});
}

ft::odometry_params params() { return test::room::odometry_params(4096); }

/// The walk of raw cameras: 24 frames, 10 of the second one. @param seed 0 or 1
std::vector<stereo_frame> const& walk(unsigned seed = 0) {
  static std::vector<std::vector<stereo_frame>> walks(2);
  auto& w = walks.at(seed);
  if (w.empty()) {
    ft::stereo_rig<lens, lens> const raw{left_lens(), right_lens(), T_right_left()};
    w = test::room::make_walk(raw, seed, seed == 0 ? 24 : 10);
  }
  return w;
}

template <typename Exec, typename Rig>
std::vector<ft::tracking> run(Exec const& exec, Rig const& of, ft::odometry_params const& p,
                              std::vector<stereo_frame> const& frames) {
  ft::odometry<Exec, Rig> odo(exec, of, p);
  return test::track_all(odo, frames.size(), period,
                         [&](std::size_t i) { return images_of(frames[i]); });
}

// ---- the rig ----------------------------------------------------------------------------------

/// A point is seen in the same row of both rectified cameras, bf / z further left in the right one.
TEST(DistortedPair, RowsCorrespond) {
  auto const of = rig();
  auto const T_rl = T_right_left().cast<double>();
  auto const camera = of.target.camera.cast<double>();
  for (int i = 0; i < 27; ++i) {
    ft::vec3<double> const p{i % 3 - 1.1, i / 3 % 3 - 0.9, 2.0 + 1.5 * (i / 9)};
    ft::vec3<double> const in_left = of.R_left * p;
    ft::vec3<double> const in_right = of.R_right * (T_rl * p);
    auto const l = camera.project(in_left);
    auto const r = camera.project(in_right);
    EXPECT_NEAR(l.pixel.y, r.pixel.y, 1e-3);
    EXPECT_NEAR(l.pixel.x - r.pixel.x, static_cast<double>(of.target.bf()) / in_left.z, 1e-3);
  }
}

TEST(DistortedPair, TurnsBothCamerasAlike) {
  auto const of = rig();
  // About the baseline one is turned up as far as the other one down; neither is turned far.
  EXPECT_NEAR(of.R_left.m[5], -of.R_right.m[5], 1e-9);
  EXPECT_GT(std::abs(of.R_left.m[5]), 0.005);
  EXPECT_GT(of.R_left.m[8], 0.998);
  EXPECT_GT(of.R_right.m[8], 0.998);
  EXPECT_NEAR(of.target.baseline, std::sqrt(0.25 * 0.25 + 0.006 * 0.006 + 0.004 * 0.004), 1e-6);
}

TEST(DistortedPair, RefusesPairsThatAreNotSideBySide) {
  auto const make = [](ft::pose const& T_rl) {
    rig_type::make(left_lens(), right_lens(), T_rl, {290, 290, 239.5f, 179.5f});
  };
  EXPECT_NO_THROW(make(T_right_left()));
  EXPECT_THROW(make(T_right_left().inverse()), ft::bad_argument) << "exchanged";
  auto above = ft::pose::identity();
  above.t = {0, -0.2f, 0};
  EXPECT_THROW(make(above), ft::bad_argument);
  EXPECT_THROW(make(ft::pose::identity()), ft::bad_argument);
  auto no_rotation = T_right_left();
  no_rotation.R.m[0] = 2;
  EXPECT_THROW(make(no_rotation), ft::bad_argument);
}

// ---- the odometry -----------------------------------------------------------------------------

template <typename Backend>
class distorted_pair_odometry : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(distorted_pair_odometry, test::backends);

TYPED_TEST(distorted_pair_odometry, refuses_a_lens_that_folds_in_either_image) {
  TypeParam backend;
  using odometry = ft::odometry<typename TypeParam::exec_type, rig_type>;
  for (auto const side : {&rig_type::left, &rig_type::right}) {
    auto folded = rig();
    (folded.*side).distortion[0] = -5;
    auto const said = test::refusal([&] { odometry(backend.exec, folded, params()); });
    EXPECT_NE(said.find("480 x 360"), std::string::npos) << said;
    EXPECT_NE(said.find("must be at least 0.25"), std::string::npos) << said;
  }
  // Of an image that ends before the fold, it is a lens like others.
  auto small = rig();
  small.left.distortion[0] = -0.5f;
  small.left.distortion[1] = 0;
  EXPECT_NO_THROW(odometry(backend.exec, small, params()));
}

TYPED_TEST(distorted_pair_odometry, follows_a_walk) {
  TypeParam backend;
  auto const& frames = walk();
  auto const all = run(backend.exec, rig(), params(), frames);
  // The true poses are those of the raw left camera.
  ft::rigid<double> const T_rectified_raw{rig().R_left, {0, 0, 0}};
  for (std::size_t i = 0; i < all.size(); ++i) {
    EXPECT_EQ(all[i].state, ft::tracking_state::tracking) << i;
    auto const T = T_rectified_raw *
                   (frames[0].T_cw.template cast<double>() *
                    frames[i].T_cw.template cast<double>().inverse()) *
                   T_rectified_raw.inverse();
    auto const d = all[i].T_world_camera.t - T.t;
    EXPECT_LT(std::sqrt(ft::dot(d, d)), 0.02) << i;
    EXPECT_EQ(all[i].inliers >= 50, i > 0) << i;
    EXPECT_GT(all[i].stereo_points, 100) << i;
  }
  EXPECT_GE(all.back().keyframes, 2);
}

/// Images that are rectified outside, through the same maps.
template <typename Exec, typename Rig>
std::vector<stereo_frame> rectified_outside(Exec const& exec, Rig const& of,
                                            std::vector<stereo_frame> const& frames) {
  auto const pixels = at(width) * at(height);
  ft::remap_table<Exec::space> const table({width, height, width, height}, 2);
  ft::build_remap(exec, of.left, of.R_left.transposed(), of.target.camera, table.view(), 0);
  ft::build_remap(exec, of.right, of.R_right.transposed(), of.target.camera, table.view(), 1);
  std::vector<stereo_frame> out;
  for (auto const& f : frames) {
    image both(f.left);
    both.insert(both.end(), f.right.begin(), f.right.end());
    auto const raw = test::to_exec(exec, both);
    auto const to = test::to_exec(exec, image(2 * pixels));
    ft::image_batch_view<std::uint8_t const> const source{
        raw.data(), width, height, width, static_cast<std::ptrdiff_t>(pixels), 2};
    ft::image_batch_view<std::uint8_t> const target{
        to.data(), width, height, width, static_cast<std::ptrdiff_t>(pixels), 2};
    ft::rectify(exec, source, table.view(), target);
    auto const all = test::from_exec(exec, static_cast<std::uint8_t const*>(to.data()), 2 * pixels);
    auto const middle = all.begin() + static_cast<std::ptrdiff_t>(pixels);
    out.push_back({image(all.begin(), middle), image(middle, all.end()), f.T_cw});
  }
  return out;
}

TYPED_TEST(distorted_pair_odometry, gives_what_images_give_that_were_rectified_before) {
  TypeParam backend;
  auto const inside = run(backend.exec, rig(), params(), walk());
  auto const images = rectified_outside(backend.exec, rig(), walk());
  EXPECT_NE(images[0].left, walk()[0].left);
  test::expect_same(inside, run(backend.exec, rig().target, params(), images));
  auto p = params();
  p.use_graphs = false;
  p.measure_stages = true;
  test::expect_same(inside, run(backend.exec, rig(), p, walk()));
}

TYPED_TEST(distorted_pair_odometry, a_batch_gives_what_its_pairs_give_alone) {
  TypeParam backend;
  ft::odometry<typename TypeParam::exec_type, rig_type> odo(backend.exec, rig(), params(), 2);
  std::vector<std::vector<ft::tracking>> together(2);
  for (std::size_t i = 0; i < walk(1).size(); ++i) {
    std::vector<ft::stereo_images> images;
    for (unsigned b = 0; b < 2; ++b) {
      images.push_back({test::room::view(walk(b)[i].left), test::room::view(walk(b)[i].right)});
    }
    auto const now = static_cast<std::int64_t>(i + 1) * period;
    std::int64_t const times[2]{now, now};
    ft::tracking const* const t = odo.track(images.data(), times);
    for (std::size_t b = 0; b < 2; ++b) { together[b].push_back(t[b]); }
  }
  for (unsigned b = 0; b < 2; ++b) {
    SCOPED_TRACE("pair " + std::to_string(b));
    auto const end = walk(b).begin() + 10;
    test::expect_same(together[b], run(backend.exec, rig(), params(), {walk(b).begin(), end}));
  }
}

/// Raw images of another size than the rectified ones.
TYPED_TEST(distorted_pair_odometry, rectified_images_may_have_another_size) {
  TypeParam backend;
  auto of = rig();
  of.width = width;
  of.height = height;
  of.target.camera = {220, 220, 179.5f, 129.5f};
  auto p = params();
  p.orb.width = 360;
  p.orb.height = 260;
  auto const all = run(backend.exec, of, p, walk());
  for (auto const& t : all) { EXPECT_EQ(t.state, ft::tracking_state::tracking); }
  auto const d = walk()[23].T_cw.inverse().t - walk()[0].T_cw.inverse().t;
  auto const found = all[23].T_world_camera.t;
  EXPECT_NEAR(std::sqrt(ft::dot(found, found)), std::sqrt(static_cast<double>(ft::dot(d, d))),
              0.03);
}

TYPED_TEST(distorted_pair_odometry, refuses_bad_input) {
  TypeParam backend;
  using odometry = ft::odometry<typename TypeParam::exec_type, rig_type>;
  auto of = rig();
  of.width = width + 16;
  of.height = height;
  odometry odo(backend.exec, of, params());
  auto const& f = walk()[0];
  ft::stereo_images const images = images_of(f);
  EXPECT_THROW(odo.track(images, period), ft::bad_argument) << "not of the raw images' size";
  of.height = 0;
  EXPECT_THROW(odometry(backend.exec, of, params()), ft::bad_argument);
  of = rig();
  of.R_right.m[0] = 3;
  EXPECT_THROW(odometry(backend.exec, of, params()), ft::bad_argument);
  of = rig();
  of.target.baseline = 0;
  EXPECT_THROW(odometry(backend.exec, of, params()), ft::bad_argument);
  odometry good(backend.exec, rig(), params());
  auto none = images;
  none.right.data = nullptr;
  EXPECT_THROW(good.track(none, period), ft::bad_argument);
  EXPECT_EQ(good.track(images, period).state, ft::tracking_state::tracking);
}

TYPED_TEST(distorted_pair_odometry, prefetch_changes_no_answer) {
  TypeParam backend;
  auto p = params();
  p.prefetch = 2;
  test::expect_same(run(backend.exec, rig(), p, walk(1)),
                    run(backend.exec, rig(), params(), walk(1)));
}

#if defined(__CUDACC__)

TEST(DistortedPairParity, HostAndDeviceGiveTheSameBits) {
  if (!test::cuda_backend::available()) { GTEST_SKIP() << "no CUDA device"; }
  test::cuda_backend backend;
  test::expect_same(run(backend.exec, rig(), params(), walk()),
                    run(ft::host_exec(), rig(), params(), walk()));
}

#endif

}  // namespace distorted_pair_test
