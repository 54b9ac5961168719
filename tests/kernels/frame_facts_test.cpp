// SPDX-License-Identifier: Apache-2.0
// What the observations of a frame say about its pose: counts, and what neighbours' errors share.
#include "ft/kernels/odometry/frame_facts.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/math/so3.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/random.hpp"

namespace frame_facts_test {

constexpr int width = 640, height = 480;
using blocks = ft::detail::error_blocks;

struct erring {
  ft::observation at;
  float x, y;  ///< standard deviations
  float move;  ///< of the keypoint, squared
};

struct sum_errors {
  using scratch = blocks;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int, erring const* of, int n,
                                 int* common) const {
    s.clear(g);
    for (int i = g.rank(); i < n; i += g.size()) {
      s.add(of[i].at, ft::strict_float(of[i].x), ft::strict_float(of[i].y), of[i].move, width,
            height);
    }
    g.sync();
    int const shared = s.common(g);
    if (g.rank() == 0) { *common = shared; }
  }
};

template <typename Backend>
class FrameFacts : public test::on_backend<Backend> {
public:
  int common(std::vector<erring> const& of) {
    Backend backend;
    auto const from = test::to_exec(backend.exec, of);
    auto const to = test::to_exec(backend.exec, std::vector<int>(1));
    ft::for_each_item<ft::per_block<128>>(backend.exec, 1, sum_errors{},
                                          static_cast<erring const*>(from.data()),
                                          static_cast<int>(of.size()), to.data());
    return test::from_exec(backend.exec, to.data(), 1)[0];
  }
};
TYPED_TEST_SUITE(FrameFacts, test::backends);

int block_of(ft::observation const& o) {
  int const column = static_cast<int>(o.u) * blocks::columns / width;
  int const row = static_cast<int>(o.v) * blocks::rows / height;
  return (o.camera * blocks::rows + row) * blocks::columns + column;
}

/// The definition, pair by pair.
double shared_by_pairs(std::vector<erring> const& of) {
  auto const whole = [](float v) { return std::trunc(16.0 * static_cast<double>(v)); };
  double products = 0, squares = 0;
  for (std::size_t i = 0; i < of.size(); ++i) {
    for (std::size_t j = 0; j < of.size(); ++j) {
      if (i == j || block_of(of[i].at) != block_of(of[j].at)) { continue; }
      products += whole(of[i].x) * whole(of[j].x) + whole(of[i].y) * whole(of[j].y);
      squares += whole(of[i].x) * whole(of[i].x) + whole(of[i].y) * whole(of[i].y) +
                 std::trunc(256.0 * static_cast<double>(of[i].move));
    }
  }
  return products / squares;
}

/// Errors of n keypoints. @param share what neighbours have in common, of the length
std::vector<erring> errors_of(int n, double share, unsigned seed) {
  test::generator random(seed);
  float shared[2 * blocks::columns * blocks::rows][2];
  for (auto& of : shared) {
    for (float& v : of) { v = random.real(-1, 1); }
  }
  std::vector<erring> all;
  for (int i = 0; i < n; ++i) {
    erring e{};
    e.at.camera = random.below(2);
    e.at.u = random.real(0, width - 1);
    e.at.v = random.real(0, height - 1);
    auto const& of = shared[block_of(e.at)];
    auto const a = static_cast<float>(share), b = static_cast<float>(std::sqrt(1 - share * share));
    e.x = a * of[0] + b * random.real(-1, 1);
    e.y = a * of[1] + b * random.real(-1, 1);
    all.push_back(e);
  }
  return all;
}

TYPED_TEST(FrameFacts, NeighboursShareNothingOfErrorsOfTheirOwn) {
  for (unsigned seed = 1; seed < 6; ++seed) {
    auto const own = errors_of(800, 0, seed);
    EXPECT_NEAR(this->common(own), 1024 * shared_by_pairs(own), 1.01);
    EXPECT_LT(std::abs(this->common(own)), 64) << "pairs: about 3300";
    auto const half = errors_of(800, 0.75, seed);
    EXPECT_NEAR(this->common(half), 1024 * shared_by_pairs(half), 1.01);
    EXPECT_GT(this->common(half), 400);
    EXPECT_LT(this->common(half), 750);
  }
}

TYPED_TEST(FrameFacts, KeypointsThatWereMovedShareAsTheyDidBefore) {
  test::generator random(9);
  for (unsigned seed = 1; seed < 6; ++seed) {
    auto moved = errors_of(800, 0.75, seed);
    int const before = this->common(moved);
    for (erring& e : moved) { e.move = random.chance(20) ? 0.0f : random.real(0.5f, 2); }
    EXPECT_NEAR(this->common(moved), 1024 * shared_by_pairs(moved), 1.01);
    EXPECT_LT(this->common(moved), before * 3 / 4);
  }
}

TYPED_TEST(FrameFacts, NothingIsSaidOfFewPairsOrOfImpossibleErrors) {
  EXPECT_EQ(this->common({}), 0);
  auto few = errors_of(60, 1, 3);
  EXPECT_EQ(this->common(few), 0);
  auto all = errors_of(800, 0.75, 4);
  int const before = this->common(all);
  for (float const bad : {std::numeric_limits<float>::quiet_NaN(), 1e30f, -1e30f}) {
    all[7].x = all[8].y = bad;
    EXPECT_NEAR(this->common(all), before, 12);
  }
}

// ---- of observations

struct facts_of {
  using scratch = ft::detail::facts_scratch;
  template <typename Group, typename Rig>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int, Rig const& rig,
                                 ft::observations_view const& of, ft::pose const* T_cw,
                                 ft::pose const* last, ft::pose const* uncorrected,
                                 ft::pyramid_geometry const& geometry, ft::frame_facts* out) const {
    ft::frame_facts const f = ft::detail::weigh_observations(g, s, 0, rig, of, *T_cw, *last,
                                                             *uncorrected, geometry, 0.0f, nullptr);
    if (g.rank() == 0) { *out = f; }
  }
};

template <typename Exec, typename Rig>
ft::frame_facts weigh(Exec const& exec, Rig const& rig, std::vector<ft::observation> const& all,
                      std::vector<unsigned char> const& outlier, double moved,
                      double corrected = 0) {
  auto const items = test::to_exec(exec, all);
  auto const flags = test::to_exec(exec, outlier);
  auto const count = test::to_exec(exec, std::vector<int>{static_cast<int>(all.size())});
  auto const now = test::to_exec(exec, std::vector<ft::pose>{ft::pose::identity()});
  ft::rigid<double> T = ft::rigid<double>::identity();
  T.t.x = moved;
  auto const last = test::to_exec(exec, std::vector<ft::pose>{T.cast<float>()});
  T.t.x = corrected;
  auto const uncorrected = test::to_exec(exec, std::vector<ft::pose>{T.cast<float>()});
  auto const out = test::to_exec(exec, std::vector<ft::frame_facts>(1));
  ft::observations_view view;
  view.items = items.data();
  view.outlier = flags.data();
  view.count = count.data();
  view.capacity = static_cast<int>(all.size());
  ft::for_each_item<ft::per_block<128>>(
      exec, 1, facts_of{}, rig, view, static_cast<ft::pose const*>(now.data()),
      static_cast<ft::pose const*>(last.data()), static_cast<ft::pose const*>(uncorrected.data()),
      ft::pyramid_geometry::make(width, height, 1, 1.2f), out.data());
  return test::from_exec(exec, static_cast<ft::frame_facts const*>(out.data()), 1)[0];
}

/// Points 2 m away, seen without error. @param right whether there is a right column
std::vector<ft::observation> seen_points(int n, bool right) {
  test::generator random(11);
  std::vector<ft::observation> all;
  for (int i = 0; i < n; ++i) {
    ft::observation o{};
    o.point = {random.real(-3, 3), random.real(-2, 2), 2};
    o.u = 100 * o.point.x + 320;
    o.v = 100 * o.point.y + 240;
    o.right_u = right ? o.u - 10 : -1;
    o.inv_sigma2 = 1;
    all.push_back(o);
  }
  return all;
}

TYPED_TEST(FrameFacts, CountWhatMovesAndWhoseDepthsAgree) {
  TypeParam backend;
  auto const rig = ft::rectified_rig::make({200.0f, 200.0f, 320.0f, 240.0f}, 0.1);
  auto all = seen_points(300, true);
  std::vector<unsigned char> outlier(300, 0);
  for (std::size_t i = 0; i < 40; ++i) { outlier[i] = 1; }
  ft::frame_facts const rest = weigh(backend.exec, rig, all, outlier, 0.0024);  // 0.24 pixels
  EXPECT_EQ(rest.matches, 300);
  EXPECT_EQ(rest.resting, 260);
  EXPECT_EQ(rest.flowing, 0);
  EXPECT_EQ(rest.with_disparity, 300);
  EXPECT_EQ(rest.off_disparity, 0);
  EXPECT_EQ(rest.common_disparity, 0);
  EXPECT_EQ(rest.shifted, 0);
  for (std::size_t i = 0; i < 90; ++i) { all[i].right_u += 3; }
  ft::frame_facts const moving = weigh(backend.exec, rig, all, outlier, 0.025);  // 2.5 pixels
  EXPECT_EQ(moving.resting, 0);
  EXPECT_EQ(moving.flowing, 260);
  EXPECT_EQ(moving.off_disparity, 90);
  // A correction of 0.9 and of 1.1 pixels.
  EXPECT_EQ(weigh(backend.exec, rig, all, outlier, 0.025, 0.009).shifted, 0);
  EXPECT_EQ(weigh(backend.exec, rig, all, outlier, 0.025, -0.011).shifted, 260);
  // The right image is of another time: all disparities of a side err alike.
  for (ft::observation& o : all) { o.right_u = o.u - 10 + (o.u < 320 ? 1.5f : -1.5f); }
  ft::frame_facts const late = weigh(backend.exec, rig, all, outlier, 0.025);
  EXPECT_GT(late.common_disparity, 1000);
  EXPECT_LT(std::abs(late.common), 128);
}

TYPED_TEST(FrameFacts, OfAPairThatIsNotRectifiedTheRightCameraCounts) {
  TypeParam backend;
  ft::pinhole<float> const camera{200.0f, 200.0f, 320.0f, 240.0f};
  ft::stereo_rig<ft::pinhole<float>, ft::pinhole<float>> rig{camera, camera, ft::pose::identity()};
  rig.T_rl.t.x = -0.1f;
  auto all = seen_points(100, false);
  std::vector<unsigned char> outlier(100, 0);
  for (std::size_t i = 50; i < 100; ++i) {
    all[i].camera = 1;
    all[i].u -= 10;
    outlier[i] = i % 2 == 0 ? 1 : 0;
  }
  ft::frame_facts const f = weigh(backend.exec, rig, all, outlier, 0);
  EXPECT_EQ(f.matches, 100);
  EXPECT_EQ(f.with_disparity, 50);
  EXPECT_EQ(f.off_disparity, 25);
}

/// A correction moves the camera that it belongs to, and no other one.
TYPED_TEST(FrameFacts, CountWhatTheLastAdjustmentShifted) {
  TypeParam backend;
  auto const rig = ft::rectified_rig::make({200.0f, 200.0f, 320.0f, 240.0f}, 0.1);
  auto const seen = seen_points(200, true);
  // Of the pose before the correction, as apply_window() has it: T_cw = T_before C.
  ft::rigid<double> const T_cw{ft::mat3<double>::identity(), {0.4, -0.1, 0.2}};
  ft::rigid<double> const before{ft::mat3<double>::identity(), {0.4, -0.1 - 0.015, 0.2}};
  ft::rigid<double> const turned{
      ft::detail::rotation_exp(ft::vec3<ft::strict_double>{0.0, 0.0, 0.5}).template cast<double>(),
      {3, 1, -2}};
  std::vector<ft::observation> all;
  for (int b = 0; b < 3; ++b) {
    // The last camera's world is turned, which changes nothing.
    auto const to_world = (b == 2 ? T_cw * turned : T_cw).inverse();
    for (ft::observation o : seen) {
      o.point = (to_world * o.point.template cast<double>()).template cast<float>();
      all.push_back(o);
    }
  }
  std::vector<ft::camera_track> tracks(3, ft::camera_track::initial());
  for (auto& t : tracks) { t.plan = ft::search_plan::follow; }
  std::vector<ft::pose> const poses{T_cw.cast<float>(), T_cw.cast<float>(),
                                    (T_cw * turned).template cast<float>()};
  auto const C = before.inverse() * T_cw;
  std::vector<ft::rigid<double>> const corrections{ft::rigid<double>::identity(), C,
                                                   turned.inverse() * C * turned};
  auto const items = test::to_exec(backend.exec, all);
  auto const flags = test::to_exec(backend.exec, std::vector<unsigned char>(all.size(), 0));
  auto const count = test::to_exec(backend.exec, std::vector<int>(3, 200));
  auto const at = test::to_exec(backend.exec, poses);
  auto const by = test::to_exec(backend.exec, corrections);
  auto const of = test::to_exec(backend.exec, tracks);
  auto const out = test::to_exec(backend.exec, std::vector<ft::frame_facts>(3));
  ft::observations_view view;
  view.items = items.data();
  view.outlier = flags.data();
  view.count = count.data();
  view.capacity = 200;
  ft::detail::weighed_frames<ft::rectified_rig> const in{
      rig,       view,      at.data(),
      at.data(), by.data(), ft::pyramid_geometry::make(width, height, 1, 1.2f)};
  ft::weigh_frames(backend.exec, 3, in, of.data(), out.data());
  auto const facts =
      test::from_exec(backend.exec, static_cast<ft::frame_facts const*>(out.data()), 3);
  EXPECT_EQ(facts[0].shifted, 0);
  EXPECT_EQ(facts[0].stepped, 0);
  EXPECT_EQ(facts[1].shifted, 200) << "by 1.5 pixels";
  EXPECT_EQ(facts[2].shifted, 200);
  EXPECT_NEAR(facts[1].stepped, 0.015, 1e-6);
  EXPECT_NEAR(facts[2].stepped, 0.015, 1e-6);
  EXPECT_EQ(facts[1].resting, 200);
}

}  // namespace frame_facts_test
