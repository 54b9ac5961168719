// SPDX-License-Identifier: Apache-2.0
// Comparisons of floats with decimal literals: on which side of its edge a value is depends on
// whether the literal is a float or a double.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <random>
#include <vector>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/soa.hpp"
#include "ft/kernels/map/triangulate_points.hpp"
#include "ft/kernels/pose/optimize_pose.hpp"
#include "ft/kernels/stereo/fisheye.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/example_rigs.hpp"

namespace decimal_limits_test {

inline float above(float v) { return std::nextafter(v, 1e30f); }
inline float below(float v) { return std::nextafter(v, -1e30f); }
inline bool is_float(double v) { return static_cast<double>(static_cast<float>(v)) == v; }

template <typename Backend>
class decimal_limits : public test::on_backend<Backend> {
protected:
  static constexpr ft::memory_space space = Backend::exec_type::space;
  Backend backend;

  /// Whether a left keypoint and the first of two right ones are taken for one point, which they
  /// show with an error of `off` pixels.
  bool are_partners(ft::fisheye_stereo_params const& params, ft::vec3<double> point, int octave,
                    double off = 0) {
    auto const& exec = backend.exec;
    auto const rig = test::example_rig<test::fisheye_rig>();
    auto const geometry = ft::pyramid_geometry::make(512, 512, 8, 1.2f);
    ft::keypoints<ft::memory_space::host> const kp(2, 2);
    auto const l = rig.left.cast<double>().project(point).pixel;
    auto const r = rig.right.cast<double>().project(rig.T_rl.cast<double>() * point).pixel;
    for (int c = 0; c < 2; ++c) {
      auto const view = kp.view().slice(c);
      *view.count = c + 1;
      for (int k = 0; k <= c; ++k) {
        view.x(k) = static_cast<float>(c == 0 ? l.x : r.x) / geometry.scale[octave];
        view.y(k) = static_cast<float>(c == 0 ? l.y : r.y + off) / geometry.scale[octave];
        view.octave(k) = octave;
        for (auto& w : view.orb(k).words) { w = k == 0 ? 0 : 0xffffffffu; }
      }
    }
    ft::keypoints<space> const d_kp(2, 2);
    ft::copy(exec, d_kp.view(), kp.view());
    ft::fisheye_matches_view out;
    ft::arena<space> const memory([&](ft::carver& c) { ft::carve(c, out, 2, 1); });
    auto const none_before = test::to_exec(exec, std::vector<int>{0, 0});
    ft::match_stereo_fisheye(
        exec, ft::fisheye_stereo<test::fisheye_rig>{rig, geometry, none_before.data(), params},
        d_kp.view(), out);
    return test::from_exec(exec, static_cast<int const*>(out.partner), 1)[0] == 2;
  }

  /// The least double between `refused` and `taken` that is taken.
  template <typename Takes>
  static double edge(double refused, double taken, Takes const& takes) {
    EXPECT_FALSE(takes(refused));
    EXPECT_TRUE(takes(taken));
    while (std::nextafter(refused, taken) < taken) {
      double const middle = refused + (taken - refused) / 2;
      (takes(middle) ? taken : refused) = middle;
    }
    return taken;
  }

  /// Whether an observation is an inlier at the start. Its error is that of its row, pixels.
  bool is_inlier(float error, float inv_sigma2, bool stereo) {
    auto const& exec = backend.exec;
    auto const rig = ft::rectified_rig::make({100.0f, 100.0f, 0.0f, 0.0f}, 0.5f);
    // At (1, 0, 1) m, which is in column 100 without any rounding, in the right image in column 50.
    ft::observation const o{{1, 0, 1}, 100, error, stereo ? 50.0f : -1.0f, inv_sigma2, 0};
    std::vector<ft::observation> const all(3, o);
    auto const observations = test::to_exec(exec, all);
    auto const start = test::to_exec(exec, std::vector<ft::pose>{ft::pose::identity()});
    auto const result = test::to_exec(exec, std::vector<ft::pose>(1));
    auto const outlier = test::to_exec(exec, std::vector<unsigned char>(3));
    auto const inliers = test::to_exec(exec, std::vector<int>(1));
    ft::pose_params params;
    params.steps = 0;
    ft::optimize_pose(exec, rig,
                      ft::pose_problem{observations.data(), 3, start.data(), result.data(),
                                       outlier.data(), inliers.data()},
                      params);
    return test::from_exec(exec, inliers.data(), 1)[0] == 3;
  }
};
TYPED_TEST_SUITE(decimal_limits, test::backends);

TYPED_TEST(decimal_limits, the_cosine_of_fisheye_rays_is_compared_in_double) {
  ft::fisheye_stereo_params params;
  EXPECT_EQ(params.max_cosine, 0.9998);
  EXPECT_GT(static_cast<double>(0.9998f), params.max_cosine) << "such a pair is refused";
  EXPECT_LT(static_cast<double>(below(0.9998f)), params.max_cosine);
  for (double const x : {0.1, -0.3, 0.7}) {
    double const at = TestFixture::edge(0.5, 1.0, [&](double limit) {
      params.max_cosine = limit;
      return this->are_partners(params, {x, 0.2, 1.5}, 0);
    });
    EXPECT_TRUE(is_float(at)) << at << ": the cosine itself";
  }
}

TYPED_TEST(decimal_limits, the_error_of_a_fisheye_point_is_compared_in_double) {
  ft::fisheye_stereo_params params;
  EXPECT_EQ(params.chi2, 5.991);
  for (int const octave : {0, 1, 4}) {
    auto const geometry = ft::pyramid_geometry::make(512, 512, 8, 1.2f);
    double const sigma2 = geometry.sigma2[octave];
    double const at = TestFixture::edge(0.0, 1000.0, [&](double limit) {
      params.chi2 = limit;
      return this->are_partners(params, {0.3, 0.2, 1.5}, octave, 2.0);
    });
    // The limit's product with sigma2 in double reaches the error, a float; the next one below
    // does not, and is no other float.
    double const error = static_cast<double>(static_cast<float>(at * sigma2));
    EXPECT_GE(at * sigma2, error);
    EXPECT_LT(std::nextafter(at, 0.0) * sigma2, error);
    EXPECT_EQ(is_float(at), octave == 0);
  }
}

/// The reference keeps the limits in floats, and rounds chi-square to one.
TYPED_TEST(decimal_limits, chi_square_of_a_pose_is_compared_in_float) {
  for (bool const stereo : {false, true}) {
    float const limit = stereo ? 7.815f : 5.991f;
    ASSERT_GT(static_cast<double>(limit), stereo ? 7.815 : 5.991) << "doubles would tell another";
    EXPECT_TRUE(this->is_inlier(1, limit, stereo));
    EXPECT_TRUE(this->is_inlier(1, below(limit), stereo));
    EXPECT_FALSE(this->is_inlier(1, above(limit), stereo));
    // Products between the limit and the next float.
    double const middle = (static_cast<double>(limit) + static_cast<double>(above(limit))) / 2;
    std::mt19937 random(stereo ? 2 : 1);
    std::uniform_real_distribution<float> any(1.0f, 2.0f);
    int rounded_down = 0;
    int rounded_up = 0;
    for (int i = 0; i < 1000; ++i) {
      float const error = any(random);
      double const squared = static_cast<double>(error) * static_cast<double>(error);
      auto const weight = static_cast<float>(middle / squared);
      double const chi2 = squared * static_cast<double>(weight);
      if (!(chi2 > static_cast<double>(limit) && chi2 < static_cast<double>(above(limit)))) {
        continue;
      }
      if (chi2 == middle) { continue; }
      ++(chi2 < middle ? rounded_down : rounded_up);
      EXPECT_EQ(this->is_inlier(error, weight, stereo), chi2 < middle) << chi2;
    }
    EXPECT_GT(rounded_down, 10);
    EXPECT_GT(rounded_up, 10);
  }
}

/// Where both sides are whole numbers a literal's type changes nothing.
TEST(decimal_limits_of_whole_numbers, are_the_same_in_float_and_double) {
  for (int a = 0; a <= 256; ++a) {
    for (int b = 0; b <= 256; ++b) {
      auto const fa = static_cast<float>(a);
      auto const fb = static_cast<float>(b);
      ASSERT_EQ(10 * a < 7 * b, a < 0.7 * b) << a << " " << b;    // fisheye partners
      ASSERT_EQ(fa > 0.8f * fb, a > 0.8 * b) << a << " " << b;    // local map
      ASSERT_EQ(fa < 0.75f * fb, a < 0.75 * b) << a << " " << b;  // words
      ASSERT_EQ(fa < 0.9f * fb, a < 0.9 * b) << a << " " << b;    // first matches
    }
  }
  for (int most = 0; most <= 20000; ++most) {
    auto const f = static_cast<float>(most);
    ASSERT_EQ(static_cast<int>(std::ceil(0.1f * f)), static_cast<int>(std::ceil(0.1 * most)));
    ASSERT_EQ(static_cast<int>(0.8f * f), static_cast<int>(0.8 * most));
  }
  for (int median = 0; median <= 11 * 11 * 255; ++median) {  // sums of differences
    float const limit = 1.5f * 1.4f * static_cast<float>(median);
    ASSERT_EQ(std::ceil(static_cast<double>(limit)), std::ceil(1.5 * 1.4 * median)) << median;
  }
}

/// u_left - 0.01 of a disparity of 0.
TEST(decimal_limits_of_columns, are_the_same_in_float_and_double) {
  int different = 0;
  for (float u = 16.0f; u < 16384.0f; u = above(u)) {
    if (u > 20.0f && u < 16000.0f) { u += 0.37f; }  // all at both ends, and every so often one
    different += static_cast<int>(u - 0.01f != static_cast<float>(static_cast<double>(u) - 0.01));
  }
  EXPECT_EQ(different, 0);
}

TEST(decimal_limits_of_triangulation, are_doubles) {
  ft::triangulation_params const params;
  EXPECT_EQ(params.max_cosine, 0.9998);
  EXPECT_EQ(params.chi2, 5.991);
  EXPECT_EQ(params.octave_slack, 1.8);
}

}  // namespace decimal_limits_test
