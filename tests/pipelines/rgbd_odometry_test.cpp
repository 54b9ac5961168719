// SPDX-License-Identifier: Apache-2.0
// Odometry with a grey and a depth image a frame: a camera that walks through a rendered room.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "ft/cameras/radtan.hpp"
#include "ft/cameras/rgbd_rig.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/allocation_count.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/refusals.hpp"
#include "tests/support/room.hpp"

namespace rgbd_odometry_test {

using test::error_of;
using test::room::at;
using test::room::height;
using test::room::image;
using test::room::width;
constexpr std::int64_t period = 50'000'000;
constexpr float units = 5000;  ///< of a 16-bit depth image, per metre

using plain_rig = ft::rgbd_rig<>;
using distorted_rig = ft::rgbd_rig<ft::radtan5<float>>;

plain_rig plain() { return plain_rig::make(test::room::rig().camera, 0.25, 1 / units); }
distorted_rig distorted() {
  return distorted_rig::make({300, 301, 239.5f, 179.5f, {-0.2f, 0.05f, 5e-4f, -4e-4f, -0.005f}},
                             0.25, 1 / units);
}

struct rgbd_frame {
  image gray;
  std::vector<std::uint16_t> depth;
  std::vector<float> metres;  ///< the same, before it was rounded to units
  ft::pose T_cw;              ///< true

  ft::rgbd_images images() const {
    return {test::room::view(gray),
            ft::image_view<std::uint16_t const>{depth.data(), width, height, width}};
  }
  ft::rgbd_images images_in_metres() const {
    return {test::room::view(gray),
            ft::image_view<float const>{metres.data(), width, height, width}};
  }
};

template <typename Camera>
std::vector<rgbd_frame> make_walk(Camera const& camera, unsigned seed, int frames) {
  auto const walls = test::room::make_walls(seed);
  std::vector<rgbd_frame> walk;
  for (int i = 0; i < frames; ++i) {
    auto const step = static_cast<float>(i) * (seed % 2 == 0 ? 1.0f : -1.0f);
    float const c = std::cos(0.012f * step);
    float const s = std::sin(0.012f * step);
    ft::pose const T_wc{{{c, 0, s, 0, 1, 0, -s, 0, c}},
                        {0.02f * step, -0.01f * step, 0.05f * static_cast<float>(i)}};
    ft::pose const T_cw = T_wc.inverse();
    rgbd_frame f{test::room::render(camera, walls, T_cw), {}, {}, T_cw};
    for (int v = 0; v < height; ++v) {
      for (int u = 0; u < width; ++u) {
        auto const p =
            test::room::look(camera, T_wc, static_cast<float>(u), static_cast<float>(v)).point;
        auto const z = static_cast<float>((T_cw.cast<double>() * p).z);
        f.metres.push_back(z);
        f.depth.push_back(static_cast<std::uint16_t>(std::lround(units * z)));
      }
    }
    walk.push_back(std::move(f));
  }
  return walk;
}

std::vector<rgbd_frame> const& walk(plain_rig const& rig, unsigned seed = 0) {
  static std::vector<std::vector<rgbd_frame>> walks(2);
  auto& w = walks.at(seed);
  if (w.empty()) { w = make_walk(rig.camera, seed, seed == 0 ? 24 : 10); }
  return w;
}
std::vector<rgbd_frame> const& walk(distorted_rig const& rig, unsigned = 0) {
  static auto const w = make_walk(rig.camera, 0, 24);
  return w;
}

ft::odometry_params params() { return test::room::odometry_params(4096); }

template <typename Exec, typename Rig>
std::vector<ft::tracking> run(Exec const& exec, Rig const& rig, ft::odometry_params const& p,
                              std::vector<rgbd_frame> const& frames) {
  ft::odometry<Exec, Rig> odo(exec, rig, p);
  return test::track_all(odo, frames.size(), period,
                         [&](std::size_t i) { return frames[i].images(); });
}

template <typename Backend>
class rgbd_odometry : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(rgbd_odometry, test::backends);

template <typename Exec, typename Rig>
void follows_a_walk(Exec const& exec, Rig const& rig) {
  auto const& frames = walk(rig);
  auto const all = run(exec, rig, params(), frames);
  for (std::size_t i = 0; i < all.size(); ++i) {
    EXPECT_EQ(all[i].state, ft::tracking_state::tracking) << i;
    EXPECT_LT(error_of(all[i], frames[i], frames[0]), 0.02) << i;
    EXPECT_EQ(all[i].inliers >= 50, i > 0) << i;
    // Walls everywhere; what looks fixed to the camera has lost its depth.
    EXPECT_EQ(all[i].stereo_points + all[i].evidence.facts.fixed, all[i].keypoints) << i;
    EXPECT_LE(10 * all[i].evidence.facts.fixed, all[i].keypoints) << i;
  }
  EXPECT_GE(all.back().keyframes, 2);
  EXPECT_EQ(all.back().maps, 1);
}

TYPED_TEST(rgbd_odometry, follows_a_walk) {
  TypeParam backend;
  follows_a_walk(backend.exec, plain());
}

TYPED_TEST(rgbd_odometry, follows_a_walk_with_a_distorted_camera) {
  TypeParam backend;
  follows_a_walk(backend.exec, distorted());
}

TYPED_TEST(rgbd_odometry, keypoints_have_the_depth_of_the_image) {
  TypeParam backend;
  auto const rig = plain();
  auto const& frame = walk(rig)[0];
  ft::odometry<typename TypeParam::exec_type, plain_rig> odo(backend.exec, rig, params());
  odo.track(frame.images(), period);
  auto const& found = odo.keypoints();
  ASSERT_GT(found.keypoints[0], 300);
  for (int i = 0; i < found.keypoints[0]; ++i) {
    int const pixel = static_cast<int>(found.y[i]) * width + static_cast<int>(found.x[i]);
    float const z = static_cast<float>(frame.depth[at(pixel)]) / units;
    EXPECT_NEAR(found.depth[i], z, 1e-6f * z);
    EXPECT_NEAR(found.point[i].x, z * (found.x[i] - rig.camera.cx) / rig.camera.fx, 1e-4f);
    EXPECT_NEAR(found.point[i].y, z * (found.y[i] - rig.camera.cy) / rig.camera.fy, 1e-4f);
  }
}

/// With the rays of the undistorted camera the points lie on the walls of the room.
TYPED_TEST(rgbd_odometry, keypoints_of_a_distorted_camera_are_undistorted) {
  TypeParam backend;
  auto const rig = distorted();
  auto const& frame = walk(rig)[0];
  ft::odometry<typename TypeParam::exec_type, distorted_rig> odo(backend.exec, rig, params());
  odo.track(frame.images(), period);
  auto const& found = odo.keypoints();
  ASSERT_GT(found.keypoints[0], 300);
  float outermost = width;
  for (int i = 0; i < found.keypoints[0]; ++i) {
    auto const p = frame.T_cw.inverse() * found.point[i];
    float const d = std::min({std::abs(std::abs(p.x) - 3), std::abs(std::abs(p.y) - 1.5f),
                              std::abs(p.z + 2), std::abs(p.z - 6)});
    EXPECT_LT(d, 0.03f) << "at the border a pixel is 2.5 cm of the farthest wall";
    EXPECT_NEAR(found.point[i].x, found.depth[i] * (found.x[i] - rig.camera.cx) / rig.camera.fx,
                1e-4f);
    outermost = std::min(outermost, found.x[i]);
  }
  EXPECT_LT(outermost, 12) << "corners are 19 pixels from the border before they are undistorted";
}

TYPED_TEST(rgbd_odometry, takes_depth_in_metres) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  TypeParam backend;
  auto rig = plain();
  auto const in_units = run(backend.exec, rig, params(), walk(rig));
  rig.depth_scale = 1;
  ft::odometry<typename TypeParam::exec_type, plain_rig> odo(backend.exec, rig, params());
  std::vector<ft::tracking> all;
  for (auto const& f : walk(rig)) {
    // What a 16-bit image holds, as a float: the answers are those of that image.
    auto rounded = f;
    for (std::size_t i = 0; i < rounded.metres.size(); ++i) {
      rounded.metres[i] = static_cast<float>(f.depth[i]) * (1 / units);
    }
    all.push_back(
        odo.track(rounded.images_in_metres(), period * static_cast<std::int64_t>(all.size() + 1)));
  }
  test::expect_same(all, in_units);
}

TYPED_TEST(rgbd_odometry, a_batch_gives_what_its_cameras_give_alone) {
  TypeParam backend;
  auto const rig = plain();
  // On a device, images of eight cameras are uploaded in parts.
  unsigned const batch = TypeParam::exec_type::asynchronous ? 8 : 2;
  std::vector<std::vector<ft::tracking>> together(batch);
  ft::odometry<typename TypeParam::exec_type, plain_rig> odo(backend.exec, rig, params(),
                                                             static_cast<int>(batch));
  for (std::size_t i = 0; i < walk(rig, 1).size(); ++i) {
    std::vector<ft::rgbd_images> images;
    for (unsigned b = 0; b < batch; ++b) { images.push_back(walk(rig, b % 2)[i].images()); }
    std::vector<std::int64_t> const times(batch, static_cast<std::int64_t>(i + 1) * period);
    ft::tracking const* const t = odo.track(images.data(), times.data());
    for (std::size_t b = 0; b < batch; ++b) { together[b].push_back(t[b]); }
  }
  for (unsigned b = 0; b < batch; ++b) {
    SCOPED_TRACE("camera " + std::to_string(b));
    auto const& frames = walk(rig, b % 2);
    test::expect_same(together[b],
                      run(backend.exec, rig, params(), {frames.begin(), frames.begin() + 10}));
  }
}

/// A sensor that sees nothing nearer than 1 m, farther than 4 m, and in every fifth column.
TYPED_TEST(rgbd_odometry, prefetch_changes_no_answer) {
  TypeParam backend;
  auto p = params();
  p.prefetch = 2;
  auto const check = [&](auto const& rig) {
    auto frames = walk(rig);
    frames.resize(8);
    test::expect_same(run(backend.exec, rig, p, frames), run(backend.exec, rig, params(), frames));
  };
  check(plain());
  check(distorted());
}

TYPED_TEST(rgbd_odometry, goes_on_with_holes_in_the_depth) {
  TypeParam backend;
  auto rig = plain();
  rig.depth_scale = 1;
  rig.max_depth = 4;
  auto frames = walk(rig);
  ft::odometry<typename TypeParam::exec_type, plain_rig> odo(backend.exec, rig, params());
  std::int64_t time = 0;
  for (auto& f : frames) {
    constexpr float none[] = {std::numeric_limits<float>::quiet_NaN(), 0, -1,
                              std::numeric_limits<float>::infinity()};
    for (int i = 0; i < width * height; ++i) {
      if (i % width % 5 == 0) { f.metres[at(i)] = none[i % 4]; }
    }
    auto const t = odo.track(f.images_in_metres(), time += period);
    EXPECT_EQ(t.state, ft::tracking_state::tracking);
    EXPECT_LT(error_of(t, f, frames[0]), 0.03);
    EXPECT_LT(t.stereo_points, t.keypoints * 9 / 10);
    auto const& found = odo.keypoints();
    for (int i = 0; i < found.keypoints[0]; ++i) {
      if (static_cast<int>(found.x[i]) % 5 == 0) { EXPECT_EQ(found.depth[i], -1.0f); }
      EXPECT_LE(found.depth[i], 4.0f);
    }
  }
}

TYPED_TEST(rgbd_odometry, waits_for_depth) {
  TypeParam backend;
  auto const rig = plain();
  auto frames = walk(rig);
  for (std::size_t i = 0; i < 2; ++i) {
    std::fill(frames[i].depth.begin(), frames[i].depth.end(), std::uint16_t{0});
  }
  auto const all = run(backend.exec, rig, params(), frames);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(all[i].state, ft::tracking_state::initialising);
    EXPECT_EQ(all[i].stereo_points, 0);
  }
  EXPECT_EQ(all[2].state, ft::tracking_state::tracking);
}

TYPED_TEST(rgbd_odometry, refuses_bad_images_and_goes_on) {
  TypeParam backend;
  auto const rig = plain();
  auto const& frames = walk(rig);
  auto const good = run(backend.exec, rig, params(), {frames.begin(), frames.begin() + 3});
  ft::odometry<typename TypeParam::exec_type, plain_rig> odo(backend.exec, rig, params());
  std::vector<ft::tracking> all;
  for (std::size_t i = 0; i < 3; ++i) {
    std::int64_t const now = static_cast<std::int64_t>(i + 1) * period;
    auto const images = frames[i].images();
    auto bad = images;
    bad.gray.data = nullptr;
    EXPECT_THROW(odo.track(bad, now), ft::bad_argument);
    bad = images;
    bad.gray.height -= 1;
    EXPECT_THROW(odo.track(bad, now), ft::bad_argument);
    bad = images;
    bad.depth = {};
    EXPECT_THROW(odo.track(bad, now), ft::bad_argument);
    bad = images;
    bad.depth.width -= 1;
    EXPECT_THROW(odo.track(bad, now), ft::bad_argument);
    bad = images;
    bad.depth.height += 1;
    EXPECT_THROW(odo.track(bad, now), ft::bad_argument);
    bad = images;
    bad.depth.pitch = 2 * width - 2;
    EXPECT_THROW(odo.track(bad, now), ft::bad_argument);
    all.push_back(odo.track(images, now));
  }
  test::expect_same(all, good);
}

TYPED_TEST(rgbd_odometry, images_of_16_bits_need_a_scale) {
  TypeParam backend;
  auto rig = plain();
  rig.depth_scale = plain_rig{}.depth_scale;  // none
  ft::odometry<typename TypeParam::exec_type, plain_rig> odo(backend.exec, rig, params());
  test::expect_refused([&] { odo.track(walk(rig)[0].images(), period); },
                       "needs rgbd_rig::depth_scale");
  // Floats are metres.
  auto const t = odo.track(walk(rig)[0].images_in_metres(), period);
  EXPECT_EQ(t.state, ft::tracking_state::tracking);
  EXPECT_EQ(t.distant_points, 0);
}

/// The message of a frame with a wrong image.
template <typename Odometry, typename Images>
std::string message_of(Odometry& odo, Images const& images) {
  return test::refusal([&] { odo.track(images, period); });
}

TYPED_TEST(rgbd_odometry, messages_of_sizes_have_both_and_the_image) {
  TypeParam backend;
  ft::odometry<typename TypeParam::exec_type, plain_rig> odo(backend.exec, plain(), params());
  auto const images = walk(plain())[0].images();
  auto bad = images;
  bad.depth.width = 470;
  EXPECT_EQ(message_of(odo, bad), "ft: the depth image is 470x360, wanted 480x360");
  bad = images;
  bad.gray.height = 350;
  EXPECT_EQ(message_of(odo, bad), "ft: the image is 480x350, wanted 480x360");
  bad = images;
  bad.gray.data = nullptr;
  EXPECT_EQ(message_of(odo, bad), "ft: the image is null");
  bad = images;
  bad.depth.pitch = 958;
  EXPECT_EQ(message_of(odo, bad),
            "ft: the depth image has 958 bytes from row to row, must be at least 960");

  ft::odometry stereo(backend.exec, test::room::rig(), params());
  ft::stereo_images pair{images.gray, images.gray};
  pair.right.width = 470;
  EXPECT_EQ(message_of(stereo, pair), "ft: the right image is 470x360, wanted 480x360");
  pair = {images.gray, images.gray};
  pair.left.stride = 479;
  EXPECT_EQ(message_of(stereo, pair),
            "ft: the left image has a stride of 479, must be at least its width of 480");
  ft::odometry two(backend.exec, test::room::rig(), params(), 2);
  ft::stereo_images batch[2] = {{images.gray, images.gray}, {images.gray, images.gray}};
  batch[1].left.height = 1;
  std::int64_t const times[2] = {period, period};
  EXPECT_EQ(test::refusal([&] { two.track(batch, times); }),
            "ft: the left image of camera pair 1 is 480x1, wanted 480x360");
}

TYPED_TEST(rgbd_odometry, refuses_bad_rigs) {
  TypeParam backend;
  auto const make = [&](plain_rig const& rig) {
    ft::odometry<typename TypeParam::exec_type, plain_rig>(backend.exec, rig, params());
  };
  EXPECT_NO_THROW(make(plain()));
  auto rig = plain();
  rig.baseline = 0;
  EXPECT_THROW(make(rig), ft::bad_argument);
  rig = plain();
  rig.depth_scale = -0.001f;
  EXPECT_THROW(make(rig), ft::bad_argument);
  rig = plain();
  rig.min_depth = 2;
  rig.max_depth = 1;
  EXPECT_THROW(make(rig), ft::bad_argument);
  rig = plain();
  rig.camera.fx = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THROW(make(rig), ft::bad_argument);
  EXPECT_THROW(plain_rig::make({300, 300, 200, 200}, -0.1), ft::bad_argument);
}

#if !defined(__CUDACC__)

template <typename Rig>
void allocates_nothing_in_a_frame(Rig const& rig) {
  auto const& frames = walk(rig);
  ft::odometry odo(ft::host_exec(1), rig, params());
  test::allocation_count const allocations;
  auto const one = std::make_unique<int>(1);
  if (allocations.so_far() == 0) { GTEST_SKIP() << "this program does not count allocations"; }
  std::int64_t time = 0;
  ft::tracking last;
  for (auto const& f : frames) { last = odo.track(f.images(), time += period); }
  EXPECT_EQ(allocations.so_far(), *one);
  EXPECT_GE(last.keyframes, 2);
}

TEST(RgbdOdometryOnTheHost, AllocatesNothingInAFrame) {
  allocates_nothing_in_a_frame(plain());
  allocates_nothing_in_a_frame(distorted());
}

#else

TEST(RgbdOdometryParity, HostAndDeviceGiveTheSameBits) {
  if (!test::cuda_backend::available()) { GTEST_SKIP() << "no CUDA device"; }
  test::cuda_backend backend;
  test::expect_same(run(backend.exec, plain(), params(), walk(plain())),
                    run(ft::host_exec(), plain(), params(), walk(plain())));
  test::expect_same(run(backend.exec, distorted(), params(), walk(distorted())),
                    run(ft::host_exec(), distorted(), params(), walk(distorted())));
}

#endif

}  // namespace rgbd_odometry_test
