// SPDX-License-Identifier: Apache-2.0
// The contract of camera models, on every executor and for every scalar. A new model: one line in
// `models`, one in `example`.
#include "ft/cameras/camera_model.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <string>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/soa.hpp"
#include "ft/core/execution.hpp"
#include "tests/support/backends.hpp"

namespace camera_test {

/// Real calibrations (EuRoC's left camera, TUM-VI's) and how far off the axis their images reach.
template <template <typename> class Model>
struct example;
template <>
struct example<ft::pinhole> {
  static constexpr int width = 752;
  static constexpr int height = 480;
  static constexpr bool sees_behind = false;
  static ft::pinhole<double> camera() { return {458.654, 457.296, 367.215, 248.375}; }
};
template <>
struct example<ft::kannala_brandt> {
  static constexpr int width = 512;
  static constexpr int height = 512;
  static constexpr bool sees_behind = true;
  static ft::kannala_brandt<double> camera() {
    return {190.97847715128717,     190.9733070521226,     254.93170605935475,
            256.8974428996504,      0.0034823894022493434, 0.0007150348452162257,
            -0.0020532361418706202, 0.00020293673591811182};
  }
};

/// Numbers are exchanged as double: exact for every scalar.
struct point3 {
  double x, y, z;
};
struct answers {
  double u, v;
  int projected;
  double x, y, z;  ///< ray of (u, v)
  int unprojected;
  double jacobian[6];
};

/// Projects a point, unprojects the pixel, takes the Jacobian at the point.
template <typename Camera>
struct ask {
  using scratch = ft::no_scratch;
  using scalar = typename Camera::scalar_type;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, Camera const& camera, point3 const* points,
                                 answers* out) const {
    using plain = ft::plain_scalar_t<scalar>;
    ft::vec3<scalar> const p{scalar(static_cast<plain>(points[i].x)),
                             scalar(static_cast<plain>(points[i].y)),
                             scalar(static_cast<plain>(points[i].z))};
    auto const seen = camera.project(p);
    auto const back = camera.unproject(seen.pixel);
    auto const j = camera.project_jacobian(p);
    answers a{};
    a.u = static_cast<double>(ft::to_plain(seen.pixel.x));
    a.v = static_cast<double>(ft::to_plain(seen.pixel.y));
    a.projected = static_cast<int>(seen.valid);
    a.x = static_cast<double>(ft::to_plain(back.direction.x));
    a.y = static_cast<double>(ft::to_plain(back.direction.y));
    a.z = static_cast<double>(ft::to_plain(back.direction.z));
    a.unprojected = static_cast<int>(back.valid);
    for (int k = 0; k < 6; ++k) { a.jacobian[k] = static_cast<double>(ft::to_plain(j.m[k])); }
    out[i] = a;
  }
};

/// Rays of pixels given as x, y.
template <typename Camera>
struct lift {
  using scratch = ft::no_scratch;
  using scalar = typename Camera::scalar_type;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, Camera const& camera, point3 const* pixels,
                                 answers* out) const {
    using plain = ft::plain_scalar_t<scalar>;
    auto const back = camera.unproject(
        {scalar(static_cast<plain>(pixels[i].x)), scalar(static_cast<plain>(pixels[i].y))});
    auto const seen = camera.project(back.direction);
    answers a{};
    a.x = static_cast<double>(ft::to_plain(back.direction.x));
    a.y = static_cast<double>(ft::to_plain(back.direction.y));
    a.z = static_cast<double>(ft::to_plain(back.direction.z));
    a.unprojected = static_cast<int>(back.valid);
    a.u = static_cast<double>(ft::to_plain(seen.pixel.x));
    a.v = static_cast<double>(ft::to_plain(seen.pixel.y));
    a.projected = static_cast<int>(seen.valid);
    out[i] = a;
  }
};

/// One model as a type.
template <template <typename> class Model>
struct model {
  template <typename Scalar>
  using camera = Model<Scalar>;
  using data = example<Model>;
};
/// Backend and model of a suite.
template <typename Backend, typename Model>
struct setting {
  using backend = Backend;
  using tested = Model;
};

using pinhole_model = model<ft::pinhole>;
using kannala_brandt_model = model<ft::kannala_brandt>;
#if defined(__CUDACC__)
using settings = ::testing::Types<
    setting<test::host_backend, pinhole_model>, setting<test::host_backend, kannala_brandt_model>,
    setting<test::cuda_backend, pinhole_model>, setting<test::cuda_backend, kannala_brandt_model>>;
#else
using settings = ::testing::Types<setting<test::host_backend, pinhole_model>,
                                  setting<test::host_backend, kannala_brandt_model>>;
#endif

template <typename Setting>
class camera_unit : public test::on_backend<typename Setting::backend> {
protected:
  typename Setting::backend backend;
  using data = typename Setting::tested::data;
  template <typename Scalar>
  using camera = typename Setting::tested::template camera<Scalar>;

  template <typename Scalar, template <typename> class Op>
  std::vector<answers> run(std::vector<point3> const& input) {
    auto const& exec = backend.exec;
    camera<Scalar> const c = data::camera().template cast<Scalar>();
    auto const d_input = test::to_exec(exec, input);
    auto const d_out = test::to_exec(exec, std::vector<answers>(input.size(), answers{}));
    ft::for_each_item<ft::per_thread>(exec, static_cast<int>(input.size()), Op<camera<Scalar>>{}, c,
                                      static_cast<point3 const*>(d_input.data()), d_out.data());
    return test::from_exec(exec, static_cast<answers const*>(d_out.data()), input.size());
  }
  template <typename Scalar>
  std::vector<answers> ask_about(std::vector<point3> const& points) {
    return run<Scalar, ask>(points);
  }
  template <typename Scalar>
  std::vector<answers> lift_pixels(std::vector<point3> const& pixels) {
    return run<Scalar, lift>(pixels);
  }

  /// All over the image, its corners included.
  static std::vector<point3> pixels() {
    std::vector<point3> all;
    for (int y = 0; y <= 24; ++y) {
      for (int x = 0; x <= 24; ++x) {
        all.push_back({x * (data::width - 1) / 24.0, y * (data::height - 1) / 24.0, 0});
      }
    }
    return all;
  }
  /// In front of the camera, near and far, at all angles that its image shows.
  static std::vector<point3> points() {
    std::vector<point3> all;
    auto const c = data::camera();
    for (auto const& p : pixels()) {
      auto const r = c.unproject({p.x, p.y});
      if (!r.valid) { continue; }
      for (double const depth : {0.3, 5.0, 80.0}) {
        all.push_back({r.direction.x * depth, r.direction.y * depth, r.direction.z * depth});
      }
    }
    return all;
  }
};
TYPED_TEST_SUITE(camera_unit, settings);

TYPED_TEST(camera_unit, keeps_the_contract) {
  using tested = typename TestFixture::template camera<float>;
  EXPECT_TRUE(ft::is_camera_model_v<tested>);
  EXPECT_TRUE(ft::is_camera_model_v<typename TestFixture::template camera<double>>);
  EXPECT_TRUE(ft::is_camera_model_v<typename TestFixture::template camera<ft::strict_float>>);
  EXPECT_EQ(sizeof(tested), sizeof(float) * static_cast<std::size_t>(tested::num_params))
      << "the parameters and nothing else";
  EXPECT_GT(std::string(tested::name).size(), 0u);
}

TYPED_TEST(camera_unit, a_pixel_survives_the_round_trip) {
  auto const pixels = this->pixels();
  auto const check = [&](std::vector<answers> const& got, double tolerance) {
    std::size_t valid = 0;
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      if (got[i].unprojected == 0) { continue; }
      ++valid;
      EXPECT_EQ(got[i].projected, 1);
      EXPECT_EQ(got[i].z, 1.0);
      EXPECT_NEAR(got[i].u, pixels[i].x, tolerance);
      EXPECT_NEAR(got[i].v, pixels[i].y, tolerance);
    }
    EXPECT_GT(valid, pixels.size() * 9 / 10);
  };
  check(this->template lift_pixels<double>(pixels), 1e-9);
  check(this->template lift_pixels<ft::strict_double>(pixels), 1e-9);
  // Coordinates up to 752 have a spacing of 6e-5 in float.
  check(this->template lift_pixels<float>(pixels), 1e-3);
  check(this->template lift_pixels<ft::strict_float>(pixels), 1e-3);
}

TYPED_TEST(camera_unit, a_ray_points_at_its_point) {
  auto const points = this->points();
  auto const got = this->template ask_about<double>(points);
  for (std::size_t i = 0; i < points.size(); ++i) {
    EXPECT_EQ(got[i].projected, 1);
    EXPECT_EQ(got[i].unprojected, 1);
    double const x = points[i].x / points[i].z;
    double const y = points[i].y / points[i].z;
    EXPECT_NEAR(got[i].x, x, 1e-9 * std::max(1.0, std::abs(x) * std::abs(x)));
    EXPECT_NEAR(got[i].y, y, 1e-9 * std::max(1.0, std::abs(y) * std::abs(y)));
  }
}

TYPED_TEST(camera_unit, the_jacobian_is_the_derivative) {
  auto const c = TestFixture::data::camera();
  auto points = this->points();
  if (TestFixture::data::sees_behind) { points.push_back({1.0, 0.3, -0.2}); }
  points.push_back({1e-7, -2e-7, 1.0});  // next to the axis
  auto const got = this->template ask_about<double>(points);
  auto const in_float = this->template ask_about<float>(points);
  for (std::size_t i = 0; i < points.size(); ++i) {
    double const x[3] = {points[i].x, points[i].y, points[i].z};
    double const size = std::sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
    // Entries are about focal length over distance; the step is small against the distance.
    double const scale = c.fx / std::min(size, std::max(std::abs(x[2]), 0.2 * size));
    double const h = 1e-6 * size;
    for (int k = 0; k < 3; ++k) {
      double ahead[3] = {x[0], x[1], x[2]};
      double behind[3] = {x[0], x[1], x[2]};
      ahead[k] += h;
      behind[k] -= h;
      auto const a = c.project({ahead[0], ahead[1], ahead[2]}).pixel;
      auto const b = c.project({behind[0], behind[1], behind[2]}).pixel;
      auto const at = static_cast<std::size_t>(k);
      EXPECT_NEAR(got[i].jacobian[at], (a.x - b.x) / (2 * h), 1e-6 * scale) << i << " " << k;
      EXPECT_NEAR(got[i].jacobian[3 + at], (a.y - b.y) / (2 * h), 1e-6 * scale) << i << " " << k;
      EXPECT_NEAR(in_float[i].jacobian[at], got[i].jacobian[at], 1e-4 * scale) << i << " " << k;
      EXPECT_NEAR(in_float[i].jacobian[3 + at], got[i].jacobian[3 + at], 1e-4 * scale)
          << i << " " << k;
    }
  }
}

TYPED_TEST(camera_unit, on_the_axis_everything_is_the_principal_point) {
  auto const c = TestFixture::data::camera();
  for (auto const& got : {this->template ask_about<double>({{0, 0, 2}})[0],
                          this->template ask_about<float>({{0, 0, 2}})[0]}) {
    EXPECT_EQ(got.projected, 1);
    EXPECT_NEAR(got.u, c.cx, 1e-4);
    EXPECT_NEAR(got.v, c.cy, 1e-4);
    EXPECT_EQ(got.unprojected, 1);
    EXPECT_EQ(got.x, 0);
    EXPECT_EQ(got.y, 0);
    EXPECT_EQ(got.z, 1);
    EXPECT_NEAR(got.jacobian[0], c.fx / 2, 1e-4);
    EXPECT_EQ(got.jacobian[1], 0);
    EXPECT_EQ(got.jacobian[2], 0);
    EXPECT_EQ(got.jacobian[3], 0);
    EXPECT_NEAR(got.jacobian[4], c.fy / 2, 1e-4);
    EXPECT_EQ(got.jacobian[5], 0);
  }
}

TYPED_TEST(camera_unit, float_and_double_agree) {
  auto const points = this->points();
  auto const wide = this->template ask_about<double>(points);
  auto const narrow = this->template ask_about<float>(points);
  auto const strict = this->template ask_about<ft::strict_float>(points);
  for (std::size_t i = 0; i < points.size(); ++i) {
    for (auto const& got : {narrow[i], strict[i]}) {
      EXPECT_EQ(got.projected, wide[i].projected);
      EXPECT_NEAR(got.u, wide[i].u, 1e-3);
      EXPECT_NEAR(got.v, wide[i].v, 1e-3);
    }
  }
}

TYPED_TEST(camera_unit, strict_floats_are_the_same_bits_everywhere) {
  auto const points = this->points();
  auto const got = this->template ask_about<ft::strict_float>(points);
  auto const c = TestFixture::data::camera().template cast<ft::strict_float>();
  ft::single_group const g;
  ask<typename TestFixture::template camera<ft::strict_float>> const here{};
  ft::no_scratch scratch;
  std::vector<answers> want(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    here(g, scratch, static_cast<int>(i), c, points.data(), want.data());
    EXPECT_EQ(got[i].u, want[i].u) << i;
    EXPECT_EQ(got[i].v, want[i].v) << i;
  }
}

TYPED_TEST(camera_unit, behind_the_camera) {
  auto const got =
      this->template ask_about<float>({{0.3, 0.2, -1.0}, {0, 0, -1}, {0.3, 0.2, 0}, {0, 0, 0}});
  bool const sees = TestFixture::data::sees_behind;
  EXPECT_EQ(got[0].projected, static_cast<int>(sees));
  EXPECT_EQ(got[1].projected, 0) << "straight behind no pixel is the right one";
  EXPECT_EQ(got[2].projected, static_cast<int>(sees)) << "at 90 degrees";
  EXPECT_EQ(got[3].projected, 0) << "the centre itself";
  for (auto const& a : got) {
    EXPECT_TRUE(std::isfinite(a.u)) << "a pixel of an invalid projection is finite";
    EXPECT_TRUE(std::isfinite(a.v));
  }
}

TYPED_TEST(camera_unit, a_nan_is_never_a_valid_pixel) {
  double const nan = std::numeric_limits<double>::quiet_NaN();
  std::vector<point3> const points{{nan, nan, nan}, {0.1, 0.2, nan}, {nan, 0.2, 1}, {0.1, nan, 1},
                                   {nan, nan, 1},   {0, 0, nan},     {nan, 0, -1}};
  auto const got = this->template ask_about<float>(points);
  auto const wide = this->template ask_about<ft::strict_double>(points);
  for (std::size_t i = 0; i < points.size(); ++i) {
    EXPECT_FALSE(got[i].projected == 1 && std::isfinite(got[i].u) && std::isfinite(got[i].v))
        << "point " << i << " became the pixel " << got[i].u << ", " << got[i].v;
    EXPECT_FALSE(wide[i].projected == 1 && std::isfinite(wide[i].u) && std::isfinite(wide[i].v))
        << "point " << i << " became the pixel " << wide[i].u << ", " << wide[i].v;
  }
}

TYPED_TEST(camera_unit, a_pixel_that_is_no_number_has_no_ray) {
  double const nan = std::numeric_limits<double>::quiet_NaN();
  double const infinity = std::numeric_limits<double>::infinity();
  auto const got = this->template lift_pixels<float>(
      {{nan, 1, 0}, {1, nan, 0}, {infinity, 1, 0}, {1, -infinity, 0}});
  for (auto const& a : got) { EXPECT_EQ(a.unprojected, 0); }
}

TYPED_TEST(camera_unit, calibrations_that_cannot_be_throw) {
  using tested = typename TestFixture::template camera<float>;
  float const nan = std::numeric_limits<float>::quiet_NaN();
  tested const good = TestFixture::data::camera().template cast<float>();
  EXPECT_NO_THROW(good.check());
  for (float const bad : {0.0f, -1.0f, nan, std::numeric_limits<float>::infinity(), 1e9f}) {
    tested c = good;
    c.fx = bad;
    EXPECT_THROW(c.check(), ft::bad_argument) << bad;
    c = good;
    c.fy = bad;
    EXPECT_THROW(c.check(), ft::bad_argument) << bad;
  }
  tested c = good;
  c.cx = nan;
  EXPECT_THROW(c.check(), ft::bad_argument);
  c = good;
  c.cy = nan;
  EXPECT_THROW(c.check(), ft::bad_argument);
}

TEST(kannala_brandt_unit, beyond_a_right_angle_rays_are_not_valid) {
  // fx = 100 and no distortion: 200 pixels off the centre are 2 rad off the axis, clamped to 90
  // degrees.
  ft::kannala_brandt<double> const c{100, 100, 0, 0, 0, 0, 0, 0};
  EXPECT_TRUE(c.unproject({150, 0}).valid);
  EXPECT_FALSE(c.unproject({200, 0}).valid);
  EXPECT_FALSE(c.unproject({0, -158}).valid);
}

TEST(kannala_brandt_unit, a_radius_that_no_angle_has_gives_no_valid_ray) {
  // theta - 0.2 theta^3 grows up to theta = 1.29 only, where it is 0.861.
  ft::kannala_brandt<double> const c{100, 100, 0, 0, -0.2, 0, 0, 0};
  int valid = 0;
  for (int u = 1; u <= 150; ++u) {
    auto const lifted = c.unproject({static_cast<double>(u), 0});
    if (!lifted.valid) { continue; }
    ++valid;
    EXPECT_NEAR(c.project(lifted.direction).pixel.x, u, 1e-6)
        << "valid, but not the ray of its pixel";
  }
  EXPECT_GE(valid, 85);
}

TEST(kannala_brandt_unit, without_distortion_the_radius_is_the_angle) {
  ft::kannala_brandt<double> const c{100, 200, 10, 20, 0, 0, 0, 0};
  for (double const angle : {0.1, 0.7, 1.5, 2.5}) {
    auto const seen = c.project({3 * std::sin(angle), 0, 3 * std::cos(angle)});
    EXPECT_TRUE(seen.valid);
    EXPECT_NEAR(seen.pixel.x, 10 + 100 * angle, 1e-12 * 1000);
    EXPECT_NEAR(seen.pixel.y, 20, 1e-12);
  }
}

TEST(kannala_brandt_unit, coefficients_must_be_finite) {
  auto c = example<ft::kannala_brandt>::camera();
  c.k3 = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(c.check(), ft::bad_argument);
}

TEST(pinhole_unit, is_a_division_and_an_offset) {
  ft::pinhole<double> const c{100, 200, 10, 20};
  auto const seen = c.project({1, -2, 4});
  EXPECT_TRUE(seen.valid);
  EXPECT_EQ(seen.pixel.x, 35);
  EXPECT_EQ(seen.pixel.y, -80);
}

TEST(rectified_rig_unit, checks_its_baseline) {
  ft::pinhole<float> const c{400, 400, 320, 240};
  auto const rig = ft::rectified_rig::make(c, 0.1f);
  EXPECT_EQ(rig.bf, 0.1f * 400.0f);
  EXPECT_NO_THROW(rig.check());
  for (float const bad : {0.0f, -0.1f, std::numeric_limits<float>::quiet_NaN(),
                          std::numeric_limits<float>::infinity()}) {
    EXPECT_THROW(ft::rectified_rig::make(c, bad).check(), ft::bad_argument) << bad;
  }
  auto broken = rig;
  broken.bf = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THROW(broken.check(), ft::bad_argument);
}

TEST(stereo_rig_unit, checks_its_cameras_and_its_motion) {
  using rig_type = ft::stereo_rig<ft::kannala_brandt<float>, ft::pinhole<float>>;
  float const nan = std::numeric_limits<float>::quiet_NaN();
  rig_type const good{example<ft::kannala_brandt>::camera().cast<float>(),
                      example<ft::pinhole>::camera().cast<float>(),
                      {ft::mat3<float>::identity(), {-0.3f, 0, 0.4f}}};
  EXPECT_NO_THROW(good.check());
  EXPECT_FLOAT_EQ(good.baseline_length().value, 0.5f);
  auto const refused = [&](auto change) {
    rig_type rig = good;
    change(rig);
    EXPECT_THROW(rig.check(), ft::bad_argument);
  };
  refused([](auto& r) { r.left.fx = -1; });
  refused([](auto& r) { r.right.fy = 0; });
  refused([&](auto& r) { r.left.k1 = nan; });
  refused([&](auto& r) { r.T_rl.t.y = nan; });
  refused([](auto& r) { r.T_rl.t = {0, 0, 0}; });
  refused([&](auto& r) { r.T_rl.R.m[5] = nan; });
  refused([](auto& r) { r.T_rl.R.m[0] = 1.1f; });
  refused([](auto& r) { r.T_rl.R.m[1] = 0.1f; });
  refused([](auto& r) { r.T_rl.R = {{0, 0, 0, 0, 0, 0, 0, 0, 0}}; });
}

TEST(stereo_rig_unit, a_mirror_is_no_rotation) {
  ft::stereo_rig<ft::pinhole<float>, ft::pinhole<float>> rig{
      example<ft::pinhole>::camera().cast<float>(),
      example<ft::pinhole>::camera().cast<float>(),
      {ft::mat3<float>::identity(), {-0.1f, 0, 0}}};
  rig.T_rl.R.m[0] = -1;
  EXPECT_THROW(rig.check(), ft::bad_argument);
}

}  // namespace camera_test
