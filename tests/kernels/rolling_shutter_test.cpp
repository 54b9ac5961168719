// SPDX-License-Identifier: Apache-2.0
// Keypoints of rolling shutters: points are seen by a camera that moves, each at the time of the
// row in which it is found, and moved to where the camera sees them at the middle row's time.
#include "ft/kernels/keypoints/rolling_shutter.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "ft/cameras/distorted_pair.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/pipelines/detail/rolling_parts.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/random.hpp"

namespace rolling_shutter_test {

using vec = ft::vec3<double>;
using motion = ft::rigid<double>;

constexpr int width = 640, height = 480, levels = 4, capacity = 64;
constexpr int points = 50;
constexpr float readout = 0.03f;

/// The motion of a body after t seconds, T_cw there times the inverse of that of the frame, by many
/// small steps.
motion moved(ft::body_velocity const& v, double t) {
  constexpr int steps = 2000;
  double const h = t / steps;
  motion T = motion::identity();
  for (int i = 0; i < steps; ++i) {
    ft::mat3<double> const W{
        {1, -h * v.w.z, h * v.w.y, h * v.w.z, 1, -h * v.w.x, -h * v.w.y, h * v.w.x, 1}};
    T = motion{W, {h * v.u.x, h * v.u.y, h * v.u.z}} * T;
    if (i % 100 == 99) { T = T.orthonormalized(); }
  }
  return T.orthonormalized();
}

struct sight {
  double x, y;    ///< where the camera sees the point when its row is read
  double z;       ///< depth then
  double x0, y0;  ///< where it sees it when the middle row is read
  double z0;
};

/// @param T_cb body to camera @param point body's frame at the middle row's time
/// @param row_of a pixel's row in the sensor
template <typename Camera, typename Row>
bool see(Camera const& camera, motion const& T_cb, ft::body_velocity const& v, vec const& point,
         Row const& row_of, sight& out) {
  auto const at = [&](double t) {
    vec const p = T_cb * (moved(v, t) * point);
    auto const seen = camera.project(p);
    return sight{seen.pixel.x, seen.pixel.y, p.z, 0, 0, 0};
  };
  sight const middle = at(0);
  sight now = middle;
  for (int i = 0; i < 8; ++i) {
    now = at(static_cast<double>(readout) * (row_of(now.x, now.y) / (height - 1) - 0.5));
  }
  out = {now.x, now.y, now.z, middle.x, middle.y, middle.z};
  auto const inside = [](double x, double y) {
    return x > 5 && x < width - 6 && y > 5 && y < height - 6;
  };
  return inside(now.x, now.y) && middle.z > 0.2 && now.z > 0.2;
}

ft::pyramid_geometry geometry() {
  auto g = ft::pyramid_geometry::make(width, height, levels, 1.2f);
  g.exact = true;
  return g;
}

/// What a stage gives, of all keypoints of all cameras.
struct answer {
  std::vector<float> x, y, depth, right_x, point;
};

/// The frames of a test in host memory. Images are those of the rig's cameras, two a camera but of
/// a stereo_rig.
template <typename Rig>
struct frames {
  Rig rig;
  int batch = 2;
  std::vector<ft::body_velocity> velocity;
  std::vector<ft::body_velocity> before;  ///< by which the keypoints were moved; or none
  std::vector<float> x, y;                ///< [images][capacity]
  std::vector<float> raw_x, raw_y;        ///< where they were before, if they were moved
  std::vector<int> octave, count;
  std::vector<float> depth, right_x;    ///< [batch][numbers]
  std::vector<int> partner;             ///< likewise, or none
  std::vector<ft::vec3<float>> points;  ///< [batch][capacity], or none
  std::vector<int> holder;              ///< [batch][numbers], or none
  std::vector<ft::vec3<float>> held;    ///< [batch][capacity] map points, if there are holders
  std::vector<ft::pose> T_cw;           ///< [batch] likewise
  std::vector<int> inliers = {30, 30};

  explicit frames(Rig const& of) : rig(of) {
    auto const n = test::at(batch * Rig::images * capacity);
    x.assign(n, 7);
    y.assign(n, 9);
    octave.assign(n, 0);
    count.assign(test::at(batch * Rig::images), 0);
    depth.assign(test::at(batch * Rig::cameras * capacity), -1);
    right_x = depth;
    velocity.assign(test::at(batch), {{0.4, -0.9, 0.3}, {0.5, -0.2, 0.8}});
  }
  int image(int b, int c) const { return Rig::images * b + Rig::images / Rig::cameras * c; }
  std::size_t at(int b, int c, int i) const { return test::at(image(b, c) * capacity + i); }
  static std::size_t number(int b, int c, int i) {
    return test::at((b * Rig::cameras + c) * capacity + i);
  }
  void place(int b, int c, int i, sight const& s, int level) {
    auto const g = geometry();
    x[at(b, c, i)] = g.level_column(static_cast<float>(s.x), level);
    y[at(b, c, i)] = g.level_row(static_cast<float>(s.y), level);
    octave[at(b, c, i)] = level;
    int& n = count[test::at(image(b, c))];
    n = n > i + 1 ? n : i + 1;
  }

  template <typename Exec, typename Rows>
  answer run(Exec const& exec, Rows const& rows) const {
    ft::keypoints<Exec::space> const keypoints(capacity, batch * Rig::images);
    ft::pixels<Exec::space> const to(capacity, batch * Rig::images);
    ft::pixels<Exec::space> const sensor(capacity, batch * Rig::images);
    if (!before.empty()) { test::set_pixels(exec, sensor.view(), raw_x, raw_y, count); }
    test::set_pixels(exec, keypoints.view(), x, y, count);
    test::set_pixels(exec, to.view(), std::vector<float>(x.size(), -5), y, count);
    ft::copy(exec, ft::array_of<ft::field::octave>(keypoints.view()), octave.data(), octave.size());
    std::vector<ft::shutter_motion> all;
    ft::body_velocity const rest{{0, 0, 0}, {0, 0, 0}};
    for (auto const& once : velocity) { all.push_back({rest, once}); }
    if (!before.empty()) {
      for (std::size_t b = 0; b < all.size(); ++b) { all[b].before = before[b]; }
    }
    auto const v = test::to_exec(exec, all);
    auto const d = test::to_exec(exec, depth);
    auto const r = test::to_exec(exec, right_x);
    auto const other = test::to_exec(exec, partner);
    auto const p = test::to_exec(exec, points);
    ft::rolling_frames<Rig, Rows> in{};
    in.rig = rig;
    in.rows = rows;
    in.geometry = geometry();
    in.frame.keypoints = keypoints.view();
    in.frame.keypoint_step = Rig::images;
    in.frame.camera_step = Rig::images / Rig::cameras;
    in.frame.cameras = Rig::cameras;
    in.frame.batch = batch;
    in.frame.partner = partner.empty() ? nullptr : other.data();
    in.raw = before.empty() ? ft::pixels_view(keypoints.view()) : sensor.view();
    in.motion = v.data();
    in.moved = to.view();
    in.depth = const_cast<float*>(d.data());
    in.right_x = const_cast<float*>(r.data());
    in.point = points.empty() ? nullptr : const_cast<ft::vec3<float>*>(p.data());
    ft::map_points<Exec::space> const map(capacity, batch);
    ft::copy(exec, ft::array_of<ft::field::position>(map.view()), held.data(), held.size());
    auto const slots = test::to_exec(exec, holder);
    auto const poses = test::to_exec(exec, T_cw);
    auto const agreed = test::to_exec(exec, inliers);
    if (!holder.empty()) {
      in.frame.holder = const_cast<int*>(slots.data());
      in.held = {map.view(), {poses.data(), agreed.data(), 20}};
    }
    ft::move_to_middle_rows(exec, in);
    answer out{test::column<ft::field::x>(exec, to.view()),
               test::column<ft::field::y>(exec, to.view()),
               test::from_exec(exec, d),
               test::from_exec(exec, r.data(), depth.size()),
               {}};
    for (auto const& q : test::from_exec(exec, p)) {
      out.point.insert(out.point.end(), {q.x, q.y, q.z});
    }
    return out;
  }
};

/// The answer of an executor, which has the bits of the host.
template <typename Backend, typename Frames, typename Rows>
answer answered(Frames const& f, Rows const& rows) {
  Backend backend;
  answer const a = f.run(backend.exec, rows);
  answer const b = f.run(ft::host_exec(1), rows);
  EXPECT_TRUE(test::same_bits(a.x, b.x) && test::same_bits(a.y, b.y));
  EXPECT_TRUE(test::same_bits(a.depth, b.depth) && test::same_bits(a.right_x, b.right_x));
  EXPECT_TRUE(test::same_bits(a.point, b.point));
  return a;
}

double row_of_pixel(double, double y) { return y < 0 ? 0 : y > height - 1 ? height - 1 : y; }

template <int N = 1>
ft::sensor_rows<N> rows_of_sensor() {
  ft::sensor_rows<N> rows;
  for (float& s : rows.readout_s) { s = readout; }
  rows.height = height;
  return rows;
}

vec random_point(test::generator& random) {
  auto const real = [&](float low, float high) {
    return static_cast<double>(random.real(low, high));
  };
  double const z = real(0.6f, 9);
  return {z * real(-0.6f, 0.6f), z * real(-0.45f, 0.45f), z};
}

ft::pinhole<float> plain_camera() { return {400, 410, 319.5f, 239.5f}; }

void expect_near(ft::body_velocity const& v, ft::body_velocity const& wanted, double most) {
  EXPECT_NEAR(v.w.x, wanted.w.x, most);
  EXPECT_NEAR(v.w.y, wanted.w.y, most);
  EXPECT_NEAR(v.w.z, wanted.w.z, most);
  EXPECT_NEAR(v.u.x, wanted.u.x, most);
  EXPECT_NEAR(v.u.y, wanted.u.y, most);
  EXPECT_NEAR(v.u.z, wanted.u.z, most);
}

template <typename Backend>
class rolling_shutter : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(rolling_shutter, test::backends);

template <typename Rig>
void expect_at_middle(answer const& a, frames<Rig> const& f, int b, int c, int i, sight const& s) {
  auto const g = geometry();
  auto const k = f.at(b, c, i);
  EXPECT_NEAR(static_cast<double>(g.column(a.x[k], f.octave[k])), s.x0, 2e-3) << i;
  EXPECT_NEAR(static_cast<double>(g.row(a.y[k], f.octave[k])), s.y0, 2e-3) << i;
}

TYPED_TEST(rolling_shutter, pair_sees_its_points_as_at_the_middle) {
  auto const rig = ft::rectified_rig::make(plain_camera(), 0.12);
  frames<ft::rectified_rig> f(rig);
  auto const g = geometry();
  test::generator random(1);
  std::vector<sight> all;
  for (int b = 0; b < f.batch; ++b) {
    f.velocity[test::at(b)].w.y = b == 0 ? -0.9 : 2.5;  // the second one turns fast
    for (int i = 0; i < points; ++i) {
      sight s{};
      while (!see(plain_camera().cast<double>(), motion::identity(), f.velocity[test::at(b)],
                  random_point(random), row_of_pixel, s)) {}
      int const level = random.below(levels);
      f.place(b, 0, i, s, level);
      auto const k = f.number(b, 0, i);
      f.depth[k] = g.level_depth(static_cast<float>(s.z), level);
      double const right = s.x - static_cast<double>(rig.bf()) / s.z;
      f.right_x[k] = right < 0 ? -1 : g.level_column(static_cast<float>(right), level);
      all.push_back(s);
    }
  }
  answer const a = answered<TypeParam>(f, rows_of_sensor());
  double most = 0;
  for (int b = 0; b < f.batch; ++b) {
    for (int i = 0; i < points; ++i) {
      sight const& s = all[test::at(b * points + i)];
      expect_at_middle(a, f, b, 0, i, s);
      most = std::max(most, std::abs(s.x - s.x0));
      auto const k = f.number(b, 0, i);
      int const level = f.octave[f.at(b, 0, i)];
      EXPECT_NEAR(static_cast<double>(g.depth(a.depth[k], level)), s.z0, 1e-4 * s.z0);
      double const right = s.x0 - static_cast<double>(rig.bf()) / s.z0;
      if (f.right_x[k] < 0 || right < -4e-3) {
        EXPECT_EQ(a.right_x[k], -1);
      } else if (right > 4e-3) {
        EXPECT_NEAR(static_cast<double>(g.column(a.right_x[k], level)), right, 4e-3);
      }
    }
    // Nothing is written behind the last keypoint, nor of the right image.
    EXPECT_EQ(a.x[f.at(b, 0, points)], -5);
    EXPECT_EQ(a.x[test::at((f.image(b, 0) + 1) * capacity)], -5);
  }
  EXPECT_GT(most, 8) << "pixels: the shutter is seen";
}

/// What has no depth is turned alone, as is right where the camera only turns.
TYPED_TEST(rolling_shutter, points_without_depth_are_infinitely_far) {
  using rig_type = ft::monocular_rig<ft::kannala_brandt<float>>;
  ft::kannala_brandt<float> const lens{250, 251, 318, 241, 0.01f, -0.003f, 0.002f, -0.0004f};
  frames<rig_type> f(rig_type::make(lens));
  test::generator random(2);
  std::vector<sight> all;
  for (int b = 0; b < f.batch; ++b) {
    f.velocity[test::at(b)] = {{1.5, -2, 0.7}, {0, 0, 0}};
    for (int i = 0; i < points; ++i) {
      sight s{};
      while (!see(lens.cast<double>(), motion::identity(), f.velocity[test::at(b)],
                  random_point(random), row_of_pixel, s)) {}
      f.place(b, 0, i, s, random.below(levels));
      all.push_back(s);
    }
    f.velocity[test::at(b)].u = {0, 0, 1};  // does not matter
  }
  answer const a = answered<TypeParam>(f, rows_of_sensor());
  for (int b = 0; b < f.batch; ++b) {
    for (int i = 0; i < points; ++i) {
      expect_at_middle(a, f, b, 0, i, all[test::at(b * points + i)]);
      EXPECT_EQ(a.depth[f.number(b, 0, i)], -1);
    }
  }
}

TYPED_TEST(rolling_shutter, at_rest_moves_nothing) {
  frames<ft::rectified_rig> f(ft::rectified_rig::make(plain_camera(), 0.12));
  f.velocity.assign(2, {{0, 0, 0}, {0, 0, 0}});
  test::generator random(3);
  for (int b = 0; b < f.batch; ++b) {
    f.count[test::at(f.image(b, 0))] = capacity;
    for (int i = 0; i < capacity; ++i) {
      f.x[f.at(b, 0, i)] = random.real(-3, width + 3);
      f.y[f.at(b, 0, i)] = random.real(-3, height + 3);
      f.octave[f.at(b, 0, i)] = random.below(levels);
      f.depth[f.number(b, 0, i)] = random.real(-1, 9);
    }
  }
  answer const a = answered<TypeParam>(f, rows_of_sensor());
  EXPECT_TRUE(test::same_bits(a.depth, f.depth));
  for (int b = 0; b < f.batch; ++b) {
    for (int i = 0; i < capacity; ++i) {
      EXPECT_EQ(a.x[f.at(b, 0, i)], f.x[f.at(b, 0, i)]);
      EXPECT_EQ(a.y[f.at(b, 0, i)], f.y[f.at(b, 0, i)]);
    }
  }
}

/// Once they hold map points, keypoints without a depth are moved anew, with the depths of these.
TYPED_TEST(rolling_shutter, points_that_are_held_have_a_depth) {
  using rig_type = ft::monocular_rig<ft::pinhole<float>>;
  frames<rig_type> f(rig_type::make(plain_camera()));
  test::generator random(9);
  std::vector<sight> all;
  motion const T_cw{ft::pose{{{0, 0, 1, 0, 1, 0, -1, 0, 0}}, {0.3f, -2, 5}}.cast<double>()};
  f.T_cw.assign(2, T_cw.cast<float>());
  f.held.assign(test::at(2 * capacity), {});
  f.holder.assign(test::at(2 * capacity), -1);
  for (int b = 0; b < f.batch; ++b) {
    f.velocity[test::at(b)] = {{0.3, -0.8, 0.2}, {3, -1, 0.5}};
    for (int i = 0; i < points; ++i) {
      sight s{};
      vec p{};
      do {
        p = random_point(random);
      } while (!see(plain_camera().cast<double>(), motion::identity(), f.velocity[test::at(b)], p,
                    row_of_pixel, s));
      f.place(b, 0, i, s, random.below(levels));
      auto const k = f.number(b, 0, i);
      f.holder[k] = i % 3 == 0 ? -1 : points - 1 - i;
      f.held[test::at(b * capacity + points - 1 - i)] = (T_cw.inverse() * p).cast<float>();
      all.push_back(s);
    }
  }
  frames<rig_type> first = f;
  first.holder.clear();
  answer const alone = answered<TypeParam>(first, rows_of_sensor());
  frames<rig_type> second = f;
  second.before = f.velocity;
  second.raw_x = f.x;
  second.raw_y = f.y;
  second.x = alone.x;
  second.y = alone.y;
  second.inliers[1] = 19;  // a pose that says nothing
  answer const a = answered<TypeParam>(second, rows_of_sensor());
  auto const g = geometry();
  double most = 0;
  for (int b = 0; b < f.batch; ++b) {
    for (int i = 0; i < points; ++i) {
      auto const k = f.at(b, 0, i);
      sight const& s = all[test::at(b * points + i)];
      if (b == 1 || f.holder[f.number(b, 0, i)] < 0) {
        EXPECT_EQ(a.x[k], alone.x[k]) << i;
        continue;
      }
      // Its depth is that at the middle row's time.
      EXPECT_NEAR(static_cast<double>(g.column(a.x[k], f.octave[k])), s.x0, 0.3) << i;
      EXPECT_NEAR(static_cast<double>(g.row(a.y[k], f.octave[k])), s.y0, 0.3) << i;
      most =
          std::max(most, std::abs(static_cast<double>(g.column(alone.x[k], f.octave[k])) - s.x0));
      EXPECT_EQ(a.depth[f.number(b, 0, i)], -1);
    }
  }
  EXPECT_GT(most, 4) << "pixels: the depth is seen";
}

/// Two cameras on a body, which are not at its origin, each with a time of its own.
TYPED_TEST(rolling_shutter, cameras_of_a_rig_move_with_their_body) {
  using rig_type = ft::multi_rig<2>;
  rig_type rig{};
  rig.of[0] = {plain_camera(), 0.1, ft::pose::identity()};
  motion T{{{0, 0, -1, 0, 1, 0, 1, 0, 0}}, {0.2, 0.1, -0.3}};
  rig.of[1] = {plain_camera(), 0, T.cast<float>()};
  frames<rig_type> f(rig);
  auto const g = geometry();
  test::generator random(4);
  std::vector<sight> all(test::at(2 * 2 * points));
  for (int b = 0; b < f.batch; ++b) {
    for (int c = 0; c < 2; ++c) {
      motion const T_cb = c == 0 ? motion::identity() : T;
      for (int i = 0; i < points; ++i) {
        sight s{};
        while (!see(plain_camera().cast<double>(), T_cb, f.velocity[test::at(b)],
                    T_cb.inverse() * random_point(random), row_of_pixel, s)) {}
        f.place(b, c, i, s, random.below(levels));
        f.depth[f.number(b, c, i)] =
            g.level_depth(static_cast<float>(s.z), f.octave[f.at(b, c, i)]);
        all[test::at((2 * b + c) * points + i)] = s;
      }
    }
  }
  answer const a = answered<TypeParam>(f, rows_of_sensor<2>());
  for (int b = 0; b < f.batch; ++b) {
    for (int c = 0; c < 2; ++c) {
      for (int i = 0; i < points; ++i) {
        expect_at_middle(a, f, b, c, i, all[test::at((2 * b + c) * points + i)]);
      }
    }
  }
  auto rows = rows_of_sensor<2>();
  rows.readout_s[1] = 0;
  answer const first = answered<TypeParam>(f, rows);
  EXPECT_EQ(first.x[f.at(0, 0, 3)], a.x[f.at(0, 0, 3)]);
  EXPECT_NEAR(static_cast<double>(first.x[f.at(0, 1, 3)]), static_cast<double>(f.x[f.at(0, 1, 3)]),
              1e-3);
}

/// Both keypoints of a match have the depth of the point that the left one has.
TYPED_TEST(rolling_shutter, partners_of_two_cameras_share_their_point) {
  using lens = ft::kannala_brandt<float>;
  using rig_type = ft::stereo_rig<lens, lens>;
  lens const camera{250, 251, 318, 241, 0.01f, -0.003f, 0.002f, -0.0004f};
  motion T{{{1, 0, 0, 0, 1, 0, 0, 0, 1}}, {-0.15, 0.01, 0.02}};
  frames<rig_type> f(rig_type{camera, camera, T.cast<float>()});
  f.partner.assign(test::at(f.batch * 2 * capacity), -1);
  f.points.assign(test::at(f.batch * capacity), {0, 0, 0});
  test::generator random(5);
  std::vector<sight> all;
  for (int b = 0; b < f.batch; ++b) {
    auto const& v = f.velocity[test::at(b)];
    for (int i = 0; i < points; ++i) {
      sight l{}, r{};
      vec p{};
      do {
        p = random_point(random);
      } while (!see(camera.cast<double>(), motion::identity(), v, p, row_of_pixel, l) ||
               !see(camera.cast<double>(), T, v, p, row_of_pixel, r));
      int const level = random.below(levels);
      f.place(b, 0, i, l, level);
      f.place(b, 1, i, r, level);
      auto const seen =
          moved(v, static_cast<double>(readout) * (row_of_pixel(0, l.y) / (height - 1) - 0.5)) * p;
      f.points[test::at(b * capacity + i)] = seen.cast<float>();
      f.partner[f.number(b, 0, i)] = capacity + i;
      f.partner[f.number(b, 1, i)] = i;
      all.push_back(l);
      all.push_back(r);
    }
  }
  answer const a = answered<TypeParam>(f, rows_of_sensor<2>());
  for (int b = 0; b < f.batch; ++b) {
    for (int i = 0; i < points; ++i) {
      sight const& l = all[test::at(2 * (b * points + i))];
      sight const& r = all[test::at(2 * (b * points + i) + 1)];
      expect_at_middle(a, f, b, 0, i, l);
      EXPECT_NEAR(static_cast<double>(a.point[test::at(3 * (b * capacity + i) + 2)]), l.z0, 1e-3);
      // The right one's row is read at another time, at which its depth is a little different.
      auto const k = f.at(b, 1, i);
      EXPECT_NEAR(static_cast<double>(geometry().column(a.x[k], f.octave[k])), r.x0, 0.02);
      EXPECT_NEAR(static_cast<double>(geometry().row(a.y[k], f.octave[k])), r.y0, 0.02);
    }
  }
}

/// A row of a rectified image is that of the sensor behind it.
TYPED_TEST(rolling_shutter, rows_of_rectified_images_are_those_of_the_sensor) {
  using lens = ft::radtan8<float>;
  lens raw{};
  raw.fx = 380;
  raw.fy = 381;
  raw.cx = 322;
  raw.cy = 237;
  raw.distortion[0] = -0.2f;
  raw.distortion[1] = 0.04f;
  ft::pose T_rl = ft::pose::identity();
  T_rl.t = {-0.12f, 0.004f, 0.002f};
  auto pair = ft::distorted_pair<lens>::make(raw, raw, T_rl, plain_camera());
  pair.readout_s = readout;
  auto const rows = ft::detail::rows_of(pair, height);
  frames<ft::rectified_rig> f(pair.target);
  auto const row_of = [&](double x, double y) {
    auto const ray = plain_camera().cast<double>().unproject({x, y});
    auto const p = raw.cast<double>().project(pair.R_left.transposed() * ray.direction);
    return row_of_pixel(0, p.pixel.y);
  };
  auto const g = geometry();
  test::generator random(6);
  std::vector<sight> all;
  for (int b = 0; b < f.batch; ++b) {
    for (int i = 0; i < points; ++i) {
      sight s{};
      while (!see(plain_camera().cast<double>(), motion::identity(), f.velocity[test::at(b)],
                  random_point(random), row_of, s)) {}
      f.place(b, 0, i, s, random.below(levels));
      f.depth[f.number(b, 0, i)] = g.level_depth(static_cast<float>(s.z), f.octave[f.at(b, 0, i)]);
      all.push_back(s);
    }
  }
  answer const a = answered<TypeParam>(f, rows);
  for (int b = 0; b < f.batch; ++b) {
    for (int i = 0; i < points; ++i) {
      expect_at_middle(a, f, b, 0, i, all[test::at(b * points + i)]);
    }
  }
}

/// A frame's velocity is that from the last pose to the predicted one.
TYPED_TEST(rolling_shutter, velocities_are_those_of_the_prediction) {
  TypeParam backend;
  constexpr int batch = 5;
  std::vector<ft::camera_track> tracks(batch, ft::camera_track::initial());
  std::vector<ft::odometry_input> inputs(batch, ft::odometry_input{});
  ft::body_velocity const v{{0.3, -0.5, 0.2}, {1.0, -0.4, 0.6}};
  motion const last{{{0, -1, 0, 1, 0, 0, 0, 0, 1}}, {3, 4, 5}};
  for (ft::camera_track& t : tracks) {
    t.state = ft::tracking_state::tracking;
    t.interval_ns = 50'000'000;
    t.predicted = moved(v, 0.05) * last;
  }
  tracks[1].interval_ns = 0;                           // the first frame
  tracks[2].state = ft::tracking_state::initialising;  // no map
  tracks[3].state = ft::tracking_state::recovering;    // lost: what it did before
  tracks[4].state = ft::tracking_state::recovering;
  inputs[4].predicted = 1;  // lost: the caller knows a place, not the motion
  ft::buffer<ft::shutter_motion, TypeParam::exec_type::space> out(batch);
  auto const t = test::to_exec(backend.exec, tracks);
  auto const T = test::to_exec(backend.exec, std::vector<motion>(batch, last));
  auto const in = test::to_exec(backend.exec, inputs);
  ft::odometry_state_view state;
  state.tracks = const_cast<ft::camera_track*>(t.data());
  state.T_cw = const_cast<motion*>(T.data());
  state.batch = batch;
  ft::find_body_velocities(backend.exec, in.data(), state, out.data());
  auto const found = test::from_exec(backend.exec, out);
  for (int const b : {0, 3}) { expect_near(found[test::at(b)].now, v, 1e-4); }
  for (int const b : {1, 2, 4}) { expect_near(found[test::at(b)].now, {}, 0); }
  for (auto const& m : found) { expect_near(m.before, {}, 0); }
}

/// That of the first pose, and its change since the last motion.
TYPED_TEST(rolling_shutter, velocities_are_those_of_the_first_pose) {
  TypeParam backend;
  constexpr int batch = 4;
  std::vector<ft::camera_track> tracks(batch, ft::camera_track::initial());
  ft::body_velocity const predicted{{0.3, -0.5, 0.2}, {1.0, -0.4, 0.6}};
  ft::body_velocity const v{{0, 0.4, 0}, {0.5, 0, 0}};
  ft::body_velocity const slower{{0, 0.3, 0}, {0.2, 0, 0}};
  motion const last{{{0, -1, 0, 1, 0, 0, 0, 0, 1}}, {3, 4, 5}};
  for (ft::camera_track& t : tracks) {
    t.state = ft::tracking_state::tracking;
    t.interval_ns = 50'000'000;
  }
  tracks[1].velocity = {moved(slower, 0.1), 100'000'000};
  tracks[3].state = ft::tracking_state::recovering;
  std::vector<int> const inliers{20, 20, 19, 20};
  auto const t = test::to_exec(backend.exec, tracks);
  auto const T = test::to_exec(backend.exec, std::vector<motion>(batch, last));
  auto const seen = test::to_exec(
      backend.exec, std::vector<ft::pose>(batch, (moved(v, 0.05) * last).cast<float>()));
  auto const agree = test::to_exec(backend.exec, inliers);
  ft::body_velocity const rest{};
  auto const out =
      test::to_exec(backend.exec, std::vector<ft::shutter_motion>(batch, {rest, predicted}));
  ft::odometry_state_view state;
  state.tracks = const_cast<ft::camera_track*>(t.data());
  state.T_cw = const_cast<motion*>(T.data());
  state.batch = batch;
  ft::refine_body_velocities(backend.exec, {seen.data(), agree.data(), 20}, state,
                             const_cast<ft::shutter_motion*>(out.data()));
  auto const found = test::from_exec(backend.exec, out);
  for (auto const& m : found) { expect_near(m.before, predicted, 0); }
  expect_near(found[0].now, v, 1e-4);
  // From the middle of 0.1 s to the end of the 0.05 s after them: by half of the change and a
  // sixth.
  expect_near(found[1].now, {{0, 0.4 + 0.1 / 3, 0}, {0.5 + 0.3 / 3, 0, 0}}, 1e-4);
  expect_near(found[2].now, predicted, 0);
  expect_near(found[3].now, predicted, 0);
}

/// In two steps, the first by another velocity, as in one.
TYPED_TEST(rolling_shutter, a_second_motion_replaces_the_first) {
  auto const rig = ft::rectified_rig::make(plain_camera(), 0.12);
  frames<ft::rectified_rig> f(rig);
  auto const g = geometry();
  test::generator random(7);
  for (int b = 0; b < f.batch; ++b) {
    for (int i = 0; i < points; ++i) {
      sight s{};
      while (!see(plain_camera().cast<double>(), motion::identity(), f.velocity[test::at(b)],
                  random_point(random), row_of_pixel, s)) {}
      f.place(b, 0, i, s, random.below(levels));
      int const level = f.octave[f.at(b, 0, i)];
      auto const k = f.number(b, 0, i);
      f.depth[k] = i % 3 == 0 ? -1 : g.level_depth(static_cast<float>(s.z), level);
      double const right = s.x - static_cast<double>(rig.bf()) / s.z;
      f.right_x[k] = f.depth[k] < 0 ? -1 : g.level_column(static_cast<float>(right), level);
    }
  }
  answer const at_once = answered<TypeParam>(f, rows_of_sensor());
  frames<ft::rectified_rig> first = f;
  for (auto& v : first.velocity) { v = {{-0.2, 0.5, 0}, {0.1, 0.3, -0.4}}; }
  answer const a = answered<TypeParam>(first, rows_of_sensor());
  frames<ft::rectified_rig> second = f;
  second.before = first.velocity;
  second.raw_x = f.x;
  second.raw_y = f.y;
  second.x = a.x;
  second.y = a.y;
  second.depth = a.depth;
  second.right_x = a.right_x;
  answer const two = answered<TypeParam>(second, rows_of_sensor());
  for (int b = 0; b < f.batch; ++b) {
    for (int i = 0; i < points; ++i) {
      auto const k = f.at(b, 0, i);
      auto const n = f.number(b, 0, i);
      EXPECT_NEAR(two.x[k], at_once.x[k], 1e-3f);
      EXPECT_NEAR(two.y[k], at_once.y[k], 1e-3f);
      EXPECT_NEAR(two.depth[n], at_once.depth[n], 1e-4f);
      EXPECT_NEAR(two.right_x[n], at_once.right_x[n], 1e-2f);
    }
  }
}

}  // namespace rolling_shutter_test
