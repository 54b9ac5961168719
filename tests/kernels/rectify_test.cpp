// SPDX-License-Identifier: Apache-2.0
// Remap tables and the rectification stage against a plain reading of the rule, on every executor.
#include "ft/kernels/images/rectify.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/remap_table.hpp"
#include "ft/kernels/images/build_remap.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <random>
#include <utility>
#include <vector>

#include "ft/cameras/double_sphere.hpp"
#include "ft/cameras/field_of_view.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/cameras/unified.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

namespace rectify_test {

struct table_content {
  std::vector<ft::remap_position> position;
  std::vector<std::uint16_t> fraction;

  int x_32nds(std::size_t i) const { return 32 * position[i].x + (fraction[i] & 31); }
  int y_32nds(std::size_t i) const { return 32 * position[i].y + (fraction[i] >> 5); }
  bool none(std::size_t i) const {
    return position[i].x == -32768 && position[i].y == -32768 && fraction[i] == 0;
  }
};

template <typename Exec>
table_content content(Exec const& exec, ft::remap_table_view const& v) {
  auto const n = static_cast<std::size_t>(v.pixels()) * static_cast<std::size_t>(v.batch);
  return {test::from_exec(exec, static_cast<ft::remap_position const*>(v.position), n),
          test::from_exec(exec, static_cast<std::uint16_t const*>(v.fraction), n)};
}

inline bool same(table_content const& a, table_content const& b) {
  return a.fraction == b.fraction &&
         std::equal(a.position.begin(), a.position.end(), b.position.begin(), b.position.end(),
                    [](auto p, auto q) { return p.x == q.x && p.y == q.y; });
}

/// Positions inside, on the borders, just outside and far outside.
inline table_content random_table(ft::remap_sizes const& s, unsigned seed) {
  std::mt19937 random(seed);
  auto const coordinate = [&](int n) -> std::int16_t {
    switch (random() % 8) {
      case 0:
        return static_cast<std::int16_t>(-1);
      case 1:
        return static_cast<std::int16_t>(n - 1);
      case 2:
        return static_cast<std::int16_t>(static_cast<int>(random() % 65536u) - 32768);
      case 3:
        return static_cast<std::int16_t>(static_cast<int>(random() % 5u) - 2);
      default:
        return static_cast<std::int16_t>(static_cast<int>(random() % static_cast<unsigned>(n)));
    }
  };
  table_content t;
  for (int i = 0; i < s.width * s.height; ++i) {
    std::int16_t const x = coordinate(s.source_width);
    t.position.push_back({x, coordinate(s.source_height)});
    t.fraction.push_back(static_cast<std::uint16_t>(random() % 4 == 0 ? 0 : random() % 1024));
  }
  return t;
}

/// The rule: weights in 1/32768, rounded; what is outside has the border's value.
inline int weighted_mean(std::vector<std::uint8_t> const& image, int w, int h, int x, int y,
                         int fraction, int border) {
  auto const pixel = [&](int px, int py) -> int {
    return px < 0 || py < 0 || px >= w || py >= h
               ? border
               : image[static_cast<std::size_t>(py) * static_cast<std::size_t>(w) +
                       static_cast<std::size_t>(px)];
  };
  int const fx = fraction % 32;
  int const fy = fraction / 32;
  int const sum = 32 * (32 - fx) * (32 - fy) * pixel(x, y) + 32 * fx * (32 - fy) * pixel(x + 1, y) +
                  32 * (32 - fx) * fy * pixel(x, y + 1) + 32 * fx * fy * pixel(x + 1, y + 1);
  return (sum + (1 << 14)) >> 15;
}

inline ft::kannala_brandt<double> fisheye() {
  return {190.97847715128717,     190.9733070521226,     254.93170605935475,
          256.8974428996504,      0.0034823894022493434, 0.0007150348452162257,
          -0.0020532361418706202, 0.00020293673591811182};
}
inline ft::mat3<double> turn_y(double a) {
  return {{std::cos(a), 0, std::sin(a), 0, 1, 0, -std::sin(a), 0, std::cos(a)}};
}
inline ft::mat3<double> turn_z(double a) {
  return {{std::cos(a), -std::sin(a), 0, std::sin(a), std::cos(a), 0, 0, 0, 1}};
}

TEST(remap_entry_unit, positions_are_rounded_to_32nds_with_halves_to_even) {
  struct expectation {
    double value;
    int whole, part;
  };
  double const inf = std::numeric_limits<double>::infinity();
  for (expectation const& e : {expectation{0, 0, 0},
                               {5, 5, 0},
                               {5.5, 5, 16},
                               {1 / 64.0, 0, 0},
                               {3 / 64.0, 0, 2},
                               {5 / 64.0, 0, 2},
                               {63 / 64.0, 1, 0},
                               {0.0157, 0, 1},
                               {-1 / 64.0, 0, 0},
                               {-3 / 64.0, -1, 30},
                               {-1 / 32.0, -1, 31},
                               {-1, -1, 0},
                               {-1.25, -2, 24},
                               {32767.5, 32767, 16},
                               {40000.5, 32767, 16},
                               {-40000.5, -32768, 16},
                               {67108863.0, 32767, 0},
                               {67108864.0, -32768, 0},
                               {-67108864.0, -32768, 0},
                               {1e300, -32768, 0},
                               {-1e300, -32768, 0},
                               {inf, -32768, 0},
                               {-inf, -32768, 0},
                               {std::nan(""), -32768, 0}}) {
    ft::remap_entry const x = ft::make_remap_entry(e.value, 7.25);
    EXPECT_EQ(x.position.x, e.whole) << e.value;
    EXPECT_EQ(x.fraction & 31, e.part) << e.value;
    EXPECT_EQ(x.position.y, 7) << e.value;
    EXPECT_EQ(x.fraction >> 5, 8) << e.value;
    ft::remap_entry const y = ft::make_remap_entry(-3.75, e.value);
    EXPECT_EQ(y.position.y, e.whole) << e.value;
    EXPECT_EQ(y.fraction >> 5, e.part) << e.value;
    EXPECT_EQ(y.position.x, -4) << e.value;
    EXPECT_EQ(y.fraction & 31, 8) << e.value;
  }
}

template <typename Backend>
class rectify_unit : public test::on_backend<Backend> {
protected:
  using exec_type = typename Backend::exec_type;
  using table_owner = ft::remap_table<exec_type::space>;
  using pyramid = ft::image_pyramid<exec_type::space>;
  Backend backend;

  void load(ft::remap_table_view const& to, int entry, table_content const& from) {
    int const w = to.sizes.width;
    ft::load_remap(
        backend.exec,
        ft::image_view<ft::remap_position const>{from.position.data(), w, to.sizes.height, w},
        ft::image_view<std::uint16_t const>{from.fraction.data(), w, to.sizes.height, w}, to,
        entry);
  }
};
TYPED_TEST_SUITE(rectify_unit, test::backends);

TYPED_TEST(rectify_unit, every_pixel_is_the_weighted_mean_of_its_neighbours) {
  auto const& exec = this->backend.exec;
  struct shape {
    ft::remap_sizes sizes;
    int source_stride, target_stride, maps, batch;
    int border;
  };
  unsigned seed = 1;
  for (shape const& s : {shape{{64, 48, 64, 48}, 64, 64, 1, 1, 0},
                         {{131, 67, 97, 101}, 99, 137, 2, 4, 0},
                         {{301, 33, 40, 30}, 41, 301, 3, 3, 77},
                         {{1, 1, 1, 1}, 1, 1, 1, 2, 255},
                         {{17, 1, 1, 9}, 3, 19, 1, 3, 9},
                         {{5, 200, 300, 2}, 303, 6, 2, 2, 0}}) {
    auto const& z = s.sizes;
    auto const from_step = static_cast<std::ptrdiff_t>(s.source_stride) * z.source_height + 5;
    auto const to_step = static_cast<std::ptrdiff_t>(s.target_stride) * z.height + 3;
    std::vector<std::vector<std::uint8_t>> images;
    std::vector<std::uint8_t> raw(static_cast<std::size_t>(from_step * s.batch), 201);
    for (int b = 0; b < s.batch; ++b) {
      images.push_back(test::random_image(z.source_width, z.source_height, ++seed));
      for (int y = 0; y < z.source_height; ++y) {
        std::copy_n(images.back().begin() + static_cast<std::ptrdiff_t>(y) * z.source_width,
                    z.source_width, raw.begin() + b * from_step + y * s.source_stride);
      }
    }
    typename TestFixture::table_owner const table(z, s.maps);
    std::vector<table_content> maps;
    for (int m = 0; m < s.maps; ++m) {
      maps.push_back(random_table(z, ++seed));
      this->load(table.view(), m, maps.back());
    }
    auto const source = test::to_exec(exec, raw);
    auto const target = test::to_exec(
        exec, std::vector<std::uint8_t>(static_cast<std::size_t>(to_step * s.batch), 42));
    ft::rectify(
        exec, {source.data(), z.source_width, z.source_height, s.source_stride, from_step, s.batch},
        table.view(), {target.data(), z.width, z.height, s.target_stride, to_step, s.batch},
        static_cast<std::uint8_t>(s.border));
    auto const got =
        test::from_exec(exec, static_cast<std::uint8_t const*>(target.data()), target.size());
    std::vector<std::uint8_t> want(got.size(), 42);
    for (int b = 0; b < s.batch; ++b) {
      auto const& map = maps[static_cast<std::size_t>(b % s.maps)];
      std::size_t i = 0;
      for (int y = 0; y < z.height; ++y) {
        for (int x = 0; x < z.width; ++x, ++i) {
          want[static_cast<std::size_t>(b * to_step + y * s.target_stride + x)] =
              static_cast<std::uint8_t>(weighted_mean(
                  images[static_cast<std::size_t>(b)], z.source_width, z.source_height,
                  map.position[i].x, map.position[i].y, map.fraction[i], s.border));
        }
      }
    }
    EXPECT_EQ(got, want) << z.width << "x" << z.height << ", bytes beside the rows included";
  }
}

TYPED_TEST(rectify_unit, a_pyramids_level_0_can_be_the_target) {
  auto const& exec = this->backend.exec;
  constexpr int batch = 4;
  ft::remap_sizes const z{90, 70, 101, 83};
  auto const raw_geometry = ft::pyramid_geometry::make(z.source_width, z.source_height, 1, 1.2f);
  auto const geometry = ft::pyramid_geometry::make(z.width, z.height, 3, 1.2f);
  typename TestFixture::pyramid const raw(raw_geometry, batch);
  typename TestFixture::pyramid const rectified(geometry, batch);
  ft::fill_bytes(exec, rectified.view().data, 3, static_cast<std::size_t>(geometry.bytes) * batch);
  std::vector<std::vector<std::uint8_t>> images;
  for (int b = 0; b < batch; ++b) {
    images.push_back(
        test::random_image(z.source_width, z.source_height, 50u + static_cast<unsigned>(b)));
    ft::copy_image(exec, raw.view().level(b, 0),
                   {images.back().data(), z.source_width, z.source_height, z.source_width});
  }
  typename TestFixture::table_owner const table(z, 2);  // left and right of every pair
  table_content const maps[2] = {random_table(z, 60), random_table(z, 61)};
  this->load(table.view(), 0, maps[0]);
  this->load(table.view(), 1, maps[1]);
  ft::rectify(exec, ft::level_images(raw.view(), 0), table.view(),
              ft::level_images(rectified.view(), 0));
  for (int b = 0; b < batch; ++b) {
    auto const level = rectified.view().level(b, 0);
    auto const rows = test::from_exec(exec, static_cast<std::uint8_t const*>(level.data),
                                      static_cast<std::size_t>(level.stride * level.height));
    std::size_t i = 0;
    for (int y = 0; y < z.height; ++y) {
      for (int x = 0; x < z.width; ++x, ++i) {
        auto const& map = maps[b % 2];
        ASSERT_EQ(
            rows[static_cast<std::size_t>(y * level.stride + x)],
            weighted_mean(images[static_cast<std::size_t>(b)], z.source_width, z.source_height,
                          map.position[i].x, map.position[i].y, map.fraction[i], 0))
            << "image " << b << " (" << x << ", " << y << ")";
      }
    }
    auto const next = rectified.view().level(b, 1);
    EXPECT_EQ(test::from_exec(exec, static_cast<std::uint8_t const*>(next.data), 1)[0], 3)
        << "level 1 is not touched";
  }
}

TYPED_TEST(rectify_unit, the_map_of_a_camera_to_itself_is_the_identity) {
  auto const& exec = this->backend.exec;
  ft::remap_sizes const z{512, 300, 512, 512};
  typename TestFixture::table_owner const table(z, 2);
  ft::pinhole<float> const ideal{458.654f, 457.296f, 367.215f, 248.375f};
  auto const R = ft::mat3<double>::identity();
  ft::build_remap(exec, ideal, R, ideal, table.view(), 0);
  ft::build_remap(exec, fisheye(), R, fisheye(), table.view(), 1);
  auto const got = content(exec, table.view());
  std::size_t i = 0;
  int kept = 0;
  for (int map = 0; map < 2; ++map) {
    for (int y = 0; y < z.height; ++y) {
      for (int x = 0; x < z.width; ++x, ++i) {
        if (map == 1 && std::hypot(x - 254.9, y - 256.9) > 270) { continue; }  // near 90 degrees
        ++kept;
        ASSERT_TRUE(got.position[i].x == x && got.position[i].y == y && got.fraction[i] == 0)
            << "map " << map << " (" << x << ", " << y << ")";
      }
    }
  }
  EXPECT_GT(kept, 280000);
}

TYPED_TEST(rectify_unit, a_map_holds_the_nearest_32nd_of_the_fisheye_equation) {
  auto const& exec = this->backend.exec;
  ft::remap_sizes const z{333, 257, 512, 512};
  typename TestFixture::table_owner const table(z);
  auto const cam = fisheye();
  ft::pinhole<double> const wanted{150.25, 149.5, 170.1, 120.7};
  ft::mat3<double> const R = turn_y(0.2) * turn_z(-0.3);
  ft::build_remap(exec, cam, R, wanted, table.view());
  auto const got = content(exec, table.view());
  std::size_t i = 0;
  int not_nearest = 0;
  for (int y = 0; y < z.height; ++y) {
    for (int x = 0; x < z.width; ++x, ++i) {
      double const a = (x - wanted.cx) / wanted.fx;
      double const b = (y - wanted.cy) / wanted.fy;
      double const px = R.m[0] * a + R.m[1] * b + R.m[2];
      double const py = R.m[3] * a + R.m[4] * b + R.m[5];
      double const pz = R.m[6] * a + R.m[7] * b + R.m[8];
      double const rho = std::hypot(px, py);
      double const t = std::atan2(rho, pz);
      double const r = t + cam.k1 * std::pow(t, 3) + cam.k2 * std::pow(t, 5) +
                       cam.k3 * std::pow(t, 7) + cam.k4 * std::pow(t, 9);
      double const u = cam.fx * r * px / rho + cam.cx;
      double const v = cam.fy * r * py / rho + cam.cy;
      ASSERT_NEAR(got.x_32nds(i) / 32.0, u, 1 / 64.0 + 1e-9) << x << ", " << y;
      ASSERT_NEAR(got.y_32nds(i) / 32.0, v, 1 / 64.0 + 1e-9) << x << ", " << y;
      not_nearest += static_cast<int>(got.x_32nds(i) != static_cast<int>(std::nearbyint(u * 32)) ||
                                      got.y_32nds(i) != static_cast<int>(std::nearbyint(v * 32)));
    }
  }
  EXPECT_EQ(not_nearest, 0);
}

TYPED_TEST(rectify_unit, the_rotation_turns_target_rays_into_the_source) {
  auto const& exec = this->backend.exec;
  ft::remap_sizes const z{41, 41, 41, 41};
  typename TestFixture::table_owner const table(z);
  ft::pinhole<double> const cam{32, 32, 20, 20};
  ft::mat3<double> const quarter{{0, -1, 0, 1, 0, 0, 0, 0, 1}};  // x to y
  ft::build_remap(exec, cam, quarter, cam, table.view());
  auto const got = content(exec, table.view());
  for (int y = 0; y < 41; ++y) {
    for (int x = 0; x < 41; ++x) {
      auto const i = static_cast<std::size_t>(41 * y + x);
      ASSERT_EQ(got.x_32nds(i), 32 * (20 - (y - 20)));
      ASSERT_EQ(got.y_32nds(i), 32 * (20 + (x - 20)));
    }
  }
}

TYPED_TEST(rectify_unit, pixels_without_a_source_get_the_border_value) {
  auto const& exec = this->backend.exec;
  ft::remap_sizes const z{60, 40, 60, 40};
  typename TestFixture::table_owner const table(z);
  ft::pinhole<double> const cam{10, 10, 30, 20};
  double const halved = 3.14159265358979323846 / 2;
  ft::build_remap(exec, cam, turn_y(halved), cam, table.view());  // left half looks backwards
  auto const got = content(exec, table.view());
  int none = 0;
  for (std::size_t i = 0; i < got.position.size(); ++i) {
    auto const x = static_cast<int>(i % 60);
    if (x < 30) { EXPECT_FALSE(got.none(i)) << x; }
    if (x > 30) { EXPECT_TRUE(got.none(i)) << x; }
    none += static_cast<int>(got.none(i));
  }
  EXPECT_GE(none, 29 * 40);
  auto const source = test::to_exec(exec, std::vector<std::uint8_t>(60 * 40, 200));
  auto const target = test::to_exec(exec, std::vector<std::uint8_t>(60 * 40, 1));
  ft::rectify(exec, {source.data(), 60, 40, 60, 0, 1}, table.view(),
              {target.data(), 60, 40, 60, 0, 1}, 17);
  auto const pixels =
      test::from_exec(exec, static_cast<std::uint8_t const*>(target.data()), target.size());
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    if (got.none(i)) { EXPECT_EQ(pixels[i], 17); }
  }
  EXPECT_EQ(std::count(pixels.begin(), pixels.end(), 1), 0);
}

TYPED_TEST(rectify_unit, a_map_is_the_same_on_every_executor) {
  auto const& exec = this->backend.exec;
  ft::host_exec const reference(1);
  ft::remap_sizes const z{752, 480, 752, 480};
  typename TestFixture::table_owner const table(z);
  ft::remap_table<ft::memory_space::host> const expected(z);
  ft::pinhole<double> const wanted{301.7, 300.9, 370.3, 241.9};
  ft::mat3<double> const R = turn_y(-0.05) * turn_z(0.02);
  auto const expect_same = [&](auto const& source, auto const& target) {
    ft::build_remap(exec, source, R, target, table.view());
    ft::build_remap(reference, source, R, target, expected.view());
    auto const got = content(exec, table.view());
    EXPECT_TRUE(same(got, content(reference, expected.view()))) << source.name << target.name;
    int seen = 0;
    for (std::size_t i = 0; i < got.position.size(); ++i) {
      seen += static_cast<int>(!got.none(i));
    }
    EXPECT_GT(seen, 752 * 480 / 3) << source.name << target.name;
  };
  auto const expect_both = [&](auto const& camera) {
    expect_same(camera, wanted);
    expect_same(wanted, camera);
  };
  expect_both(fisheye());
  expect_both(ft::radtan4<double>{
      458.654, 457.296, 367.215, 248.375, {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05}});
  expect_both(ft::radtan8<double>{
      600, 601, 380, 241, {0.35, -0.21, 0.0004, -0.0003, 0.011, 0.66, -0.14, -0.02}});
  expect_both(ft::double_sphere<double>{300, 301, 376, 240, -0.18, 0.59});
  expect_both(ft::unified<double>{400, 401, 376, 240, 0.6, {}});
  expect_both(ft::extended_unified<double>{400, 401, 376, 240, 0.6, 1.1});
  expect_both(ft::field_of_view<double>{380, 381, 376, 240, 0.92});
}

TYPED_TEST(rectify_unit, float_maps_are_converted_and_their_strides_respected) {
  auto const& exec = this->backend.exec;
  ft::remap_sizes const z{13, 7, 50, 50};
  typename TestFixture::table_owner const table(z, 2);
  std::mt19937 random(5);
  std::uniform_real_distribution<float> position(-70.0f, 120.0f);
  std::vector<float> x(20 * 7);
  std::vector<float> y(17 * 7);
  std::generate(x.begin(), x.end(), [&] { return position(random); });
  std::generate(y.begin(), y.end(), [&] { return position(random); });
  x[3] = std::numeric_limits<float>::quiet_NaN();
  y[4] = std::numeric_limits<float>::infinity();
  x[5] = -std::numeric_limits<float>::max();
  this->load(table.view(), 0, random_table(z, 9));
  auto const before = content(exec, table.view().slice(0));
  ft::load_remap(exec, ft::image_view<float const>{x.data(), 13, 7, 20},
                 ft::image_view<float const>{y.data(), 13, 7, 17}, table.view(), 1);
  EXPECT_TRUE(same(content(exec, table.view().slice(0)), before)) << "the other map stays";
  auto const got = content(exec, table.view().slice(1));
  for (int row = 0; row < 7; ++row) {
    for (int column = 0; column < 13; ++column) {
      auto const i = static_cast<std::size_t>(13 * row + column);
      float const u = x[static_cast<std::size_t>(20 * row + column)];
      float const v = y[static_cast<std::size_t>(17 * row + column)];
      bool const usual = std::fabs(u) < 1000 && std::fabs(v) < 1000;
      EXPECT_EQ(usual, row != 0 || column < 3 || column > 5);
      if (usual) {
        EXPECT_EQ(got.x_32nds(i), static_cast<int>(std::nearbyint(u * 32.0f)));
        EXPECT_EQ(got.y_32nds(i), static_cast<int>(std::nearbyint(v * 32.0f)));
      } else {
        EXPECT_EQ(std::min(got.position[i].x, got.position[i].y), -32768);
      }
    }
  }
}

TYPED_TEST(rectify_unit, of_a_given_fraction_the_lower_10_bits_count) {
  auto const& exec = this->backend.exec;
  typename TestFixture::table_owner const table({2, 1, 4, 4});
  this->load(table.view(), 0, {{{1, 2}, {-3, 4}}, {0xffff, 0x8401}});
  auto const got = content(exec, table.view());
  EXPECT_EQ(got.fraction, (std::vector<std::uint16_t>{1023, 1}));
  EXPECT_EQ(got.position[1].x, -3);
  EXPECT_EQ(got.position[1].y, 4);
}

TYPED_TEST(rectify_unit, an_owner_moves_and_leaves_nothing_behind) {
  typename TestFixture::table_owner a({8, 4, 8, 4}, 3);
  auto const view = a.view();
  EXPECT_EQ(view.batch, 3);
  EXPECT_GE(a.bytes(), 3u * 8 * 4 * 6);
  typename TestFixture::table_owner b(std::move(a));
  EXPECT_EQ(b.view().position, view.position);
  EXPECT_EQ(a.view().position, nullptr);  // NOLINT(bugprone-use-after-move)
  EXPECT_EQ(a.view().batch, 0);
}

TYPED_TEST(rectify_unit, bad_input_throws_before_anything_is_queued) {
  auto const& exec = this->backend.exec;
  using owner = typename TestFixture::table_owner;
  EXPECT_THROW(owner({0, 4, 4, 4}), ft::bad_argument);
  EXPECT_THROW(owner({4, -1, 4, 4}), ft::bad_argument);
  EXPECT_THROW(owner({4, 4, 16385, 4}), ft::bad_argument);
  EXPECT_THROW(owner({4, 4, 4, 0}), ft::bad_argument);
  EXPECT_THROW(owner({4, 4, 4, 4}, 0), ft::bad_argument);
  EXPECT_THROW(owner({4, 4, 4, 4}, 4097), ft::bad_argument);

  owner const maps({8, 6, 10, 9}, 2);
  auto const t = maps.view();
  ft::pinhole<double> const good{100, 100, 4, 3};
  auto const nan = std::nan("");
  auto const I = ft::mat3<double>::identity();
  EXPECT_NO_THROW(ft::build_remap(exec, good, I, good, t, 1));
  EXPECT_THROW(ft::build_remap(exec, good, I, good, t, 2), ft::bad_argument);
  EXPECT_THROW(ft::build_remap(exec, good, I, good, t, -1), ft::bad_argument);
  EXPECT_THROW(ft::build_remap(exec, good, I, good, ft::remap_table_view{}), ft::bad_argument);
  EXPECT_THROW(ft::build_remap(exec, ft::pinhole<double>{nan, 1, 1, 1}, I, good, t),
               ft::bad_argument);
  EXPECT_THROW(ft::build_remap(exec, good, I, ft::pinhole<double>{1, 1, nan, 1}, t),
               ft::bad_argument);
  for (ft::mat3<double> const& R :
       {ft::mat3<double>{{nan, 0, 0, 0, 1, 0, 0, 0, 1}},
        ft::mat3<double>{{1, 0, 0, 0, 1, 0, 0, 0, -1}},
        ft::mat3<double>{{2, 0, 0, 0, 2, 0, 0, 0, 2}}, ft::mat3<double>{}}) {
    EXPECT_THROW(ft::build_remap(exec, good, R, good, t), ft::bad_argument);
  }

  std::vector<float> const map(8 * 6, 1.0f);
  ft::image_view<float const> const m{map.data(), 8, 6, 8};
  EXPECT_NO_THROW(ft::load_remap(exec, m, m, t, 1));
  EXPECT_THROW(ft::load_remap(exec, m, m, t, 2), ft::bad_argument);
  EXPECT_THROW(ft::load_remap(exec, m, m, ft::remap_table_view{}), ft::bad_argument);
  EXPECT_THROW(ft::load_remap(exec, m, {nullptr, 8, 6, 8}, t), ft::bad_argument);
  EXPECT_THROW(ft::load_remap(exec, {map.data(), 6, 8, 8}, m, t), ft::bad_argument);
  EXPECT_THROW(ft::load_remap(exec, {map.data(), 8, 6, 7}, m, t), ft::bad_argument);

  auto const memory = test::to_exec(exec, std::vector<std::uint8_t>(1000, 5));
  using source_view = ft::image_batch_view<std::uint8_t const>;
  using target_view = ft::image_batch_view<std::uint8_t>;
  std::uint8_t* const p = memory.data();
  ft::load_remap(exec, m, m, t, 0);
  source_view const from{p, 10, 9, 10, 90, 2};
  target_view const to{p + 500, 8, 6, 8, 48, 2};
  EXPECT_NO_THROW(ft::rectify(exec, from, t, to));
  auto const refuses = [&](source_view const& a, ft::remap_table_view const& b,
                           target_view const& c) {
    EXPECT_THROW(ft::rectify(exec, a, b, c), ft::bad_argument);
  };
  refuses({nullptr, 10, 9, 10, 90, 2}, t, to);
  refuses(from, t, {nullptr, 8, 6, 8, 48, 2});
  refuses(from, ft::remap_table_view{}, to);
  refuses({p, 9, 9, 10, 90, 2}, t, to);
  refuses({p, 10, 8, 10, 90, 2}, t, to);
  refuses({p, 10, 9, 9, 90, 2}, t, to);
  refuses({p, 10, 9, 10, -90, 2}, t, to);
  refuses(from, t, {p + 500, 8, 5, 8, 48, 2});
  refuses(from, t, {p + 500, 8, 6, 7, 48, 2});
  refuses(from, t, {p + 500, 8, 6, 8, 47, 2});
  refuses(from, t, {p + 500, 8, 6, 8, 48, 1});
  refuses({p, 10, 9, 10, 90, 1}, t, {p + 500, 8, 6, 8, 48, 1});
  refuses({p, 10, 9, 10, 90, 3}, t, {p + 500, 8, 6, 8, 48, 3});
  refuses({p, 10, 9, 10, 90, 0}, t, {p + 500, 8, 6, 8, 48, 0});
  EXPECT_THROW(ft::level_images(ft::image_pyramid_view{}, 0), ft::bad_argument);
  exec.wait();
}

}  // namespace rectify_test
