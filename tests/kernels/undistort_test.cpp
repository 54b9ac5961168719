// SPDX-License-Identifier: Apache-2.0
// Undistortion of keypoints against the fisheye equation read forwards, and bounds of images.
#include "ft/kernels/images/undistort.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <random>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "tests/support/backends.hpp"

namespace undistort_test {

inline ft::kannala_brandt<double> fisheye() {
  return {190.97847715128717,     190.9733070521226,     254.93170605935475,
          256.8974428996504,      0.0034823894022493434, 0.0007150348452162257,
          -0.0020532361418706202, 0.00020293673591811182};
}
inline ft::pinhole<double> ideal() { return {200.5, 199.25, 250.0, 260.0}; }
inline ft::mat3<double> turn_x(double a) {
  return {{1, 0, 0, 0, std::cos(a), -std::sin(a), 0, std::sin(a), std::cos(a)}};
}

struct pixel {
  double x, y;
};
/// The direction's pixel in the fisheye image, by the equation.
inline pixel seen(double x, double y) {
  auto const c = fisheye();
  double const rho = std::hypot(x, y);
  double const t = std::atan(rho);
  double const r = t + c.k1 * std::pow(t, 3) + c.k2 * std::pow(t, 5) + c.k3 * std::pow(t, 7) +
                   c.k4 * std::pow(t, 9);
  double const s = rho > 0 ? r / rho : 1;
  return {c.fx * s * x + c.cx, c.fy * s * y + c.cy};
}

template <typename Backend>
class undistort_unit : public test::on_backend<Backend> {
protected:
  Backend backend;
  using pixels = ft::pixels<Backend::exec_type::space>;
};
TYPED_TEST_SUITE(undistort_unit, test::backends);

TYPED_TEST(undistort_unit, keypoints_go_where_the_target_camera_sees_their_ray) {
  auto const& exec = this->backend.exec;
  constexpr int capacity = 300;
  constexpr int batch = 3;
  std::vector<int> const count{capacity, 0, 171};
  std::mt19937 random(3);
  std::uniform_real_distribution<double> direction(-2.0, 2.0);
  ft::mat3<double> const R = turn_x(0.1);
  std::vector<float> x(batch * capacity, -7);
  std::vector<float> y(batch * capacity, -8);
  std::vector<pixel> want(x.size());
  for (int b = 0; b < batch; ++b) {
    for (int i = 0; i < count[static_cast<std::size_t>(b)]; ++i) {
      auto const at = static_cast<std::size_t>(b * capacity + i);
      double const dx = i == 0 ? 0 : direction(random);
      double const dy = i == 0 ? 0 : direction(random);
      pixel const p = seen(dx, dy);
      x[at] = static_cast<float>(p.x);
      y[at] = static_cast<float>(p.y);
      double const ty = R.m[4] * dy + R.m[5];
      double const tz = R.m[7] * dy + R.m[8];
      want[at] = {ideal().fx * dx / tz + ideal().cx, ideal().fy * ty / tz + ideal().cy};
    }
  }
  typename TestFixture::pixels const raw(capacity, batch);
  typename TestFixture::pixels const out(capacity, batch);
  test::set_pixels(this->backend.exec, raw.view(), x, y, count);
  test::set_pixels(this->backend.exec, out.view(), std::vector<float>(x.size(), 99),
                   std::vector<float>(x.size(), 98), {-1, -1, -1});
  auto const valid = test::to_exec(exec, std::vector<std::uint8_t>(x.size(), 7));
  ft::undistort_keypoints(exec, fisheye(), ideal(), R, raw.view(), {out.view(), valid.data()});
  auto const u = test::column<ft::field::x>(exec, out.view());
  auto const v = test::column<ft::field::y>(exec, out.view());
  auto const good = test::from_exec(exec, valid.data(), valid.size());
  EXPECT_EQ(test::from_exec(exec, static_cast<int const*>(out.view().count), 3), count);
  for (int b = 0; b < batch; ++b) {
    for (int i = 0; i < capacity; ++i) {
      auto const at = static_cast<std::size_t>(b * capacity + i);
      if (i < count[static_cast<std::size_t>(b)]) {
        // Half a unit of the raw position's last place, 3e-5 at most, grows by up to 10 at the rim.
        EXPECT_NEAR(u[at], want[at].x, 1e-3) << b << ", " << i;
        EXPECT_NEAR(v[at], want[at].y, 1e-3) << b << ", " << i;
        EXPECT_EQ(good[at], 1);
      } else {
        EXPECT_EQ(u[at], 99) << "past the count";
        EXPECT_EQ(v[at], 98);
        EXPECT_EQ(good[at], 7);
      }
    }
  }
}

TYPED_TEST(undistort_unit, a_keypoint_without_a_ray_keeps_its_position_and_is_marked) {
  auto const& exec = this->backend.exec;
  float const nan = std::numeric_limits<float>::quiet_NaN();
  float const inf = std::numeric_limits<float>::infinity();
  // Behind 90 degrees in the corner, no numbers, beyond all numbers; then one that is good.
  std::vector<float> const x{600, nan, 100, inf, 3e38f, 300};
  std::vector<float> const y{600, 100, nan, 100, -3e38f, 200};
  typename TestFixture::pixels const raw(6);
  typename TestFixture::pixels const out(6);
  test::set_pixels(this->backend.exec, raw.view(), x, y, {6});
  auto const valid = test::to_exec(exec, std::vector<std::uint8_t>(6, 7));
  ft::undistort_keypoints(exec, fisheye(), ideal(), raw.view(), {out.view(), valid.data()});
  auto const u = test::column<ft::field::x>(exec, out.view());
  auto const v = test::column<ft::field::y>(exec, out.view());
  EXPECT_EQ(test::from_exec(exec, valid), (std::vector<std::uint8_t>{0, 0, 0, 0, 0, 1}));
  for (std::size_t i = 0; i < 5; ++i) {
    EXPECT_TRUE(u[i] == x[i] || (std::isnan(u[i]) && std::isnan(x[i]))) << i;
    EXPECT_TRUE(v[i] == y[i] || (std::isnan(v[i]) && std::isnan(y[i]))) << i;
  }
  EXPECT_NE(u[5], x[5]);

  // A ray that the target camera cannot see.
  ft::mat3<double> const back{{-1, 0, 0, 0, 1, 0, 0, 0, -1}};
  ft::undistort_keypoints(exec, fisheye(), ideal(), back, raw.view(), {out.view(), valid.data()});
  EXPECT_EQ(test::from_exec(exec, valid)[5], 0);
  EXPECT_EQ(test::column<ft::field::x>(exec, out.view())[5], 300);
}

TYPED_TEST(undistort_unit, it_works_in_place_on_keypoints_and_leaves_the_other_columns) {
  auto const& exec = this->backend.exec;
  ft::keypoints<TypeParam::exec_type::space> const kp(40, 2);
  std::vector<float> x(80);
  std::vector<float> y(80);
  std::vector<int> octave(80);
  for (int i = 0; i < 80; ++i) {
    auto const at = static_cast<std::size_t>(i);
    x[at] = static_cast<float>(40 + 5 * i);
    y[at] = static_cast<float>(450 - 5 * i);
    octave[at] = i % 8;
  }
  test::set_pixels(this->backend.exec, kp.view(), x, y, {40, 33});
  ft::copy(exec, ft::array_of<ft::field::octave>(kp.view()), octave.data(), octave.size());
  typename TestFixture::pixels const apart(40, 2);
  test::set_pixels(this->backend.exec, apart.view(), x, y, {0, 0});
  ft::undistort_keypoints(exec, fisheye(), ideal(), kp.view(), {apart.view(), nullptr});
  ft::undistort_keypoints(exec, fisheye(), ideal(), kp.view(), {kp.view(), nullptr});
  EXPECT_EQ(test::column<ft::field::x>(exec, kp.view()),
            test::column<ft::field::x>(exec, apart.view()));
  EXPECT_EQ(test::column<ft::field::y>(exec, kp.view()),
            test::column<ft::field::y>(exec, apart.view()));
  EXPECT_EQ(test::column<ft::field::octave>(exec, kp.view()), octave);
  EXPECT_NE(test::column<ft::field::x>(exec, kp.view()), x);
  EXPECT_EQ(test::from_exec(exec, static_cast<int const*>(kp.view().count), 2),
            (std::vector<int>{40, 33}));
}

TYPED_TEST(undistort_unit, answers_are_the_same_on_every_executor) {
  auto const& exec = this->backend.exec;
  ft::host_exec const reference(1);
  constexpr int n = 20000;
  std::mt19937 random(8);
  std::uniform_real_distribution<float> position(-20.0f, 540.0f);
  std::vector<float> x(n);
  std::vector<float> y(n);
  std::generate(x.begin(), x.end(), [&] { return position(random); });
  std::generate(y.begin(), y.end(), [&] { return position(random); });
  typename TestFixture::pixels const raw(n);
  typename TestFixture::pixels const out(n);
  test::set_pixels(this->backend.exec, raw.view(), x, y, {n});
  auto const valid = test::to_exec(exec, std::vector<std::uint8_t>(n));
  ft::pixels<ft::memory_space::host> const host(n);
  std::copy(x.begin(), x.end(), ft::array_of<ft::field::x>(host.view()));
  std::copy(y.begin(), y.end(), ft::array_of<ft::field::y>(host.view()));
  *host.view().count = n;
  std::vector<std::uint8_t> host_valid(n);
  auto const cam = fisheye().cast<float>();
  ft::mat3<double> const R = turn_x(-0.07);
  ft::undistort_keypoints(exec, cam, ideal(), R, raw.view(), {out.view(), valid.data()});
  ft::undistort_keypoints(reference, cam, ideal(), R, host.view(),
                          {host.view(), host_valid.data()});
  EXPECT_EQ(test::column<ft::field::x>(exec, out.view()),
            test::column<ft::field::x>(reference, host.view()));
  EXPECT_EQ(test::column<ft::field::y>(exec, out.view()),
            test::column<ft::field::y>(reference, host.view()));
  EXPECT_EQ(test::from_exec(exec, valid), host_valid);
  auto const good = std::count(host_valid.begin(), host_valid.end(), 1);
  EXPECT_GT(good, n / 2);
  EXPECT_LT(good, n) << "the corners have no ray";
}

TYPED_TEST(undistort_unit, bad_input_throws_before_anything_is_queued) {
  auto const& exec = this->backend.exec;
  typename TestFixture::pixels const raw(5, 2);
  typename TestFixture::pixels const other(5, 1);
  typename TestFixture::pixels const smaller(4, 2);
  test::set_pixels(this->backend.exec, raw.view(), std::vector<float>(10, 9),
                   std::vector<float>(10, 9), {0, 0});
  auto const r = raw.view();
  auto const run = [&](ft::pixels_view const& a, ft::pixels_view const& b) {
    ft::undistort_keypoints(exec, fisheye(), ideal(), a, {b, nullptr});
  };
  EXPECT_NO_THROW(run(r, r));
  EXPECT_THROW(run({}, r), ft::bad_argument);
  EXPECT_THROW(run(r, {}), ft::bad_argument);
  EXPECT_THROW(run(r, other.view()), ft::bad_argument);
  EXPECT_THROW(run(r, smaller.view()), ft::bad_argument);
  auto no_count = r;
  no_count.count = nullptr;
  EXPECT_THROW(run(no_count, r), ft::bad_argument);
  auto huge = r;
  huge.capacity = 1 << 20;
  huge.batch = 1 << 20;
  EXPECT_THROW(run(huge, huge), ft::bad_argument);
  auto empty = r;
  empty.batch = 0;
  EXPECT_THROW(run(empty, empty), ft::bad_argument);
  auto nan_camera = fisheye();
  nan_camera.k3 = std::nan("");
  EXPECT_THROW(ft::undistort_keypoints(exec, nan_camera, ideal(), r, {r, nullptr}),
               ft::bad_argument);
  EXPECT_THROW(ft::undistort_keypoints(exec, fisheye(), ft::pinhole<double>{}, r, {r, nullptr}),
               ft::bad_argument);
  EXPECT_THROW(
      ft::undistort_keypoints(exec, fisheye(), ideal(), ft::mat3<double>{}, r, {r, nullptr}),
      ft::bad_argument);
  exec.wait();
}

TEST(undistorted_bounds_unit, without_distortion_they_are_the_image) {
  ft::pinhole<float> const cam{458.654f, 457.296f, 367.215f, 248.375f};
  auto const b = ft::undistorted_bounds(cam, cam, 752, 480);
  EXPECT_EQ(b.min_x, 0.0f);
  EXPECT_EQ(b.min_y, 0.0f);
  EXPECT_EQ(b.max_x, 752.0f);
  EXPECT_EQ(b.max_y, 480.0f);
}

TEST(undistorted_bounds_unit, they_come_from_the_four_corners) {
  // Turned a little about the axis the corners differ; the target has another scale.
  ft::pinhole<double> const cam{100, 100, 60, 40};
  ft::pinhole<double> const target{50, 200, 10, 20};
  double const c = std::cos(0.1);
  double const s = std::sin(0.1);
  auto const b = ft::undistorted_bounds(cam, target, 120, 90, {{c, -s, 0, s, c, 0, 0, 0, 1}});
  auto const x = [&](double u, double v) { return 50 * (c * (u - 60) - s * (v - 40)) / 100 + 10; };
  auto const y = [&](double u, double v) { return 200 * (s * (u - 60) + c * (v - 40)) / 100 + 20; };
  EXPECT_NEAR(b.min_x, std::min(x(0, 0), x(0, 90)), 1e-5);
  EXPECT_NEAR(b.max_x, std::max(x(120, 0), x(120, 90)), 1e-5);
  EXPECT_NEAR(b.min_y, std::min(y(0, 0), y(120, 0)), 1e-5);
  EXPECT_NEAR(b.max_y, std::max(y(0, 90), y(120, 90)), 1e-5);
}

TEST(undistorted_bounds_unit, a_corner_without_a_ray_throws) {
  auto narrow = fisheye();
  narrow.cx = narrow.cy = 150;
  auto const b = ft::undistorted_bounds(narrow, ideal(), 300, 290);
  pixel const corner = seen((b.max_x - 250.0) / 200.5, (b.min_y - 260.0) / 199.25);
  EXPECT_LT(b.min_y, 0);
  EXPECT_NEAR(corner.x - fisheye().cx, 150, 1.5) << "the wider of the two right corners";
  EXPECT_NEAR(corner.y - fisheye().cy, -150, 1.5);
  EXPECT_THROW(ft::undistorted_bounds(fisheye(), ideal(), 512, 512), ft::bad_argument);
}

TEST(undistorted_bounds_unit, bad_input_throws) {
  auto const f = ideal();
  EXPECT_THROW(ft::undistorted_bounds(f, f, 0, 5), ft::bad_argument);
  EXPECT_THROW(ft::undistorted_bounds(f, f, 5, 16385), ft::bad_argument);
  EXPECT_THROW(ft::undistorted_bounds(ft::pinhole<double>{}, f, 5, 5), ft::bad_argument);
  EXPECT_THROW(ft::undistorted_bounds(f, f, 5, 5, ft::mat3<double>{}), ft::bad_argument);
  ft::mat3<double> const upside_down{{-1, 0, 0, 0, -1, 0, 0, 0, 1}};
  EXPECT_THROW(ft::undistorted_bounds(f, f, 500, 500, upside_down), ft::bad_argument) << "no area";
}

}  // namespace undistort_test
