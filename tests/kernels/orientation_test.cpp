// SPDX-License-Identifier: Apache-2.0
// The arc tangent of the orientation stage, and the intensity centroid against plain sums.
#include "ft/kernels/keypoints/orientation.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <random>
#include <string>
#include <vector>

#include "ft/containers/soa.hpp"
#include "ft/core/execution.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

namespace orientation_test {

struct arc_tangent {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, float const* y, float const* x,
                                 float* out) const {
    out[i] = ft::fast_atan2_degrees(y[i], x[i]);
  }
};

struct turn {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, float const* angle,
                                 ft::rotation* out) const {
    out[i] = ft::rotation_by(angle[i]);
  }
};

/// With fused multiply-add and without.
struct two_turns {
  ft::rotation fused, apart;
};
/// Cosine and sine of the floats with every `stride`th pattern of bits from `first` on.
struct turn_bits {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, std::uint32_t first, std::uint32_t stride,
                                 two_turns* out) const {
    std::uint32_t const bits =
        ft::min_of(first + static_cast<std::uint32_t>(i) * stride, 0x40c90fdbu);
    float radians = 0;
    std::memcpy(&radians, &bits, sizeof radians);
    out[i] = {ft::detail::rotation_of<true>(radians), ft::detail::rotation_of<false>(radians)};
  }
};

/// Whether the C library has the routines whose bits are expected.
inline bool has_arms_routines() {
#if defined(__GLIBC__)
  return __GLIBC__ > 2 || (__GLIBC__ == 2 && __GLIBC_MINOR__ >= 28);
#else
  return false;
#endif
}

struct spot {
  int x, y;
};
/// Writes what every thread of the group gets, as seen by its last.
struct orient {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int i, ft::gray_view const& image,
                                 spot const* spots, float* out) const {
    float const angle = ft::orientation(g, image, spots[i].x, spots[i].y);
    if (g.rank() == g.size() - 1) { out[i] = angle; }
  }
};

template <typename Backend>
class orientation_unit : public test::on_backend<Backend> {
protected:
  Backend backend;

  std::vector<float> angles(std::vector<float> const& y, std::vector<float> const& x) {
    auto const d_y = test::to_exec(backend.exec, y);
    auto const d_x = test::to_exec(backend.exec, x);
    auto const d_out = test::to_exec(backend.exec, std::vector<float>(x.size(), -1.0f));
    ft::for_each_item<ft::per_thread>(backend.exec, static_cast<int>(x.size()), arc_tangent{},
                                      d_y.data(), d_x.data(), d_out.data());
    return test::from_exec(backend.exec, d_out);
  }

  template <typename Shape>
  std::vector<float> orientations(std::vector<std::uint8_t> const& image, int width,
                                  std::vector<spot> const& spots) {
    auto const d_image = test::to_exec(backend.exec, image);
    auto const d_spots = test::to_exec(backend.exec, spots);
    auto const d_out = test::to_exec(backend.exec, std::vector<float>(spots.size(), -1.0f));
    ft::gray_view const view{d_image.data(), width, static_cast<int>(image.size()) / width, width};
    ft::for_each_item<Shape>(backend.exec, static_cast<int>(spots.size()), orient{}, view,
                             d_spots.data(), d_out.data());
    return test::from_exec(backend.exec, d_out);
  }
};
TYPED_TEST_SUITE(orientation_unit, test::backends);

TYPED_TEST(orientation_unit, the_arc_tangent_is_near_the_true_one) {
  std::vector<float> y;
  std::vector<float> x;
  std::mt19937 random(2);
  std::uniform_real_distribution<float> value(-1e6f, 1e6f);
  for (int i = 0; i < 5000; ++i) {
    y.push_back(std::round(value(random)));
    x.push_back(std::round(value(random)));
  }
  for (int i = 0; i < 3600; ++i) {
    double const angle = i * 0.1 * 3.14159265358979 / 180;
    y.push_back(static_cast<float>(1000 * std::sin(angle)));
    x.push_back(static_cast<float>(1000 * std::cos(angle)));
  }
  auto const got = this->angles(y, x);
  for (std::size_t i = 0; i < x.size(); ++i) {
    double want = std::atan2(static_cast<double>(y[i]), static_cast<double>(x[i])) * 180 /
                  3.14159265358979323846;
    if (want < 0) { want += 360; }
    double const difference = std::remainder(static_cast<double>(got[i]) - want, 360.0);
    EXPECT_LT(std::abs(difference), 0.02) << y[i] << ", " << x[i];
    EXPECT_GE(got[i], 0.0f);
    EXPECT_LE(got[i], 360.0f);
  }
}

TYPED_TEST(orientation_unit, the_arc_tangent_is_exact_on_the_axes) {
  auto const got =
      this->angles({0, 7, 0, -7, 0, 1e6f, -1e6f, 0, -0.0f}, {7, 0, -7, 0, 0, 0, 0, 1e6f, 5});
  EXPECT_EQ(got, (std::vector<float>{0, 90, 180, 270, 0, 90, 270, 0, 0}));
}

TYPED_TEST(orientation_unit, cosine_and_sine_are_those_of_the_c_library) {
  if (!has_arms_routines()) { GTEST_SKIP() << "the C library is not glibc 2.28 or later"; }
  std::vector<float> angles;
  for (int i = 0; i <= 720; ++i) { angles.push_back(0.5f * static_cast<float>(i)); }
  std::mt19937 random(5);
  std::uniform_real_distribution<float> any(0.0f, 360.0f);
  for (int i = 0; i < 200000; ++i) { angles.push_back(any(random)); }
  auto const& exec = this->backend.exec;
  auto const d_angles = test::to_exec(exec, angles);
  auto const d_out = test::to_exec(exec, std::vector<ft::rotation>(angles.size()));
  ft::for_each_item<ft::per_thread>(exec, static_cast<int>(angles.size()), turn{}, d_angles.data(),
                                    d_out.data());
  auto const got = test::from_exec(exec, d_out);
  int otherwise = 0;
  for (std::size_t i = 0; i < angles.size(); ++i) {
    float const radians = angles[i] * static_cast<float>(3.14159265358979323846 / 180.0);
    ASSERT_EQ(got[i].cosine, std::cos(radians)) << angles[i];
    ASSERT_EQ(got[i].sine, std::sin(radians)) << angles[i];
    otherwise += static_cast<int>(got[i].cosine != static_cast<float>(std::cos(double{radians})));
  }
  EXPECT_GT(otherwise, 1000) << "rounded doubles would do";
}

/// Every 4001st float of [0, 2 pi]; all with FT_TEST_ALL_FLOATS=1, which takes minutes.
TYPED_TEST(orientation_unit, cosine_and_sine_of_all_floats_are_those_of_the_c_library) {
  if (!has_arms_routines()) { GTEST_SKIP() << "the C library is not glibc 2.28 or later"; }
  char const* const all = std::getenv("FT_TEST_ALL_FLOATS");
  std::uint32_t const stride = all != nullptr && std::string(all) == "1" ? 1 : 4001;
  constexpr std::uint32_t last = 0x40c90fdb;  // 2 pi
  constexpr int at_once = 1 << 20;
  auto const& exec = this->backend.exec;
  ft::buffer<two_turns, TypeParam::exec_type::space> const d_out(at_once);
  std::size_t compared = 0;
  for (std::uint64_t first = 0; first <= last; first += std::uint64_t{at_once} * stride) {
    ft::for_each_item<ft::per_thread>(exec, at_once, turn_bits{}, static_cast<std::uint32_t>(first),
                                      stride, d_out.data());
    auto const got = test::from_exec(exec, d_out);
    for (std::size_t i = 0; i < at_once && first + i * stride <= last; ++i) {
      auto const bits = static_cast<std::uint32_t>(first + i * stride);
      float radians = 0;
      std::memcpy(&radians, &bits, sizeof radians);
      ft::rotation const want{std::cos(radians), std::sin(radians)};
      bool const equal = got[i].fused.cosine == want.cosine && got[i].fused.sine == want.sine &&
                         got[i].apart.cosine == want.cosine && got[i].apart.sine == want.sine;
      ASSERT_TRUE(equal) << radians;
      ++compared;
    }
  }
  EXPECT_EQ(compared, last / stride + 1);
}

TYPED_TEST(orientation_unit, is_the_direction_of_the_centroid) {
  constexpr int width = 200;
  constexpr int height = 120;
  auto const image = test::random_image(width, height, 31);
  std::vector<spot> spots{{15, 15}, {width - 16, height - 16}, {15, height - 16}, {width - 16, 15}};
  std::mt19937 random(3);
  for (int i = 0; i < 200; ++i) {
    spots.push_back({15 + static_cast<int>(random() % (width - 30u)),
                     15 + static_cast<int>(random() % (height - 30u))});
  }
  int const half_width[16] = {15, 15, 15, 15, 14, 14, 14, 13, 13, 12, 11, 10, 9, 8, 6, 3};
  std::vector<float> m01;
  std::vector<float> m10;
  for (auto const& s : spots) {
    long sum_y = 0;
    long sum_x = 0;
    for (int v = -15; v <= 15; ++v) {
      for (int u = -half_width[std::abs(v)]; u <= half_width[std::abs(v)]; ++u) {
        int const grey = image[static_cast<std::size_t>((s.y + v) * width + s.x + u)];
        sum_y += v * grey;
        sum_x += u * grey;
      }
    }
    m01.push_back(static_cast<float>(sum_y));
    m10.push_back(static_cast<float>(sum_x));
  }
  auto const want = this->angles(m01, m10);
  EXPECT_EQ(this->template orientations<ft::per_thread>(image, width, spots), want);
  EXPECT_EQ(this->template orientations<ft::per_warp>(image, width, spots), want);
  EXPECT_EQ(this->template orientations<ft::per_block<64>>(image, width, spots), want);
}

TYPED_TEST(orientation_unit, points_to_the_brighter_side) {
  constexpr int side = 41;
  auto const ramp = [](int dx, int dy) {
    std::vector<std::uint8_t> image;
    for (int y = 0; y < side; ++y) {
      for (int x = 0; x < side; ++x) {
        image.push_back(static_cast<std::uint8_t>(128 + 3 * (dx * (x - 20) + dy * (y - 20))));
      }
    }
    return image;
  };
  std::vector<spot> const centre{{20, 20}};
  EXPECT_EQ(this->template orientations<ft::per_warp>(ramp(1, 0), side, centre)[0], 0.0f);
  EXPECT_EQ(this->template orientations<ft::per_warp>(ramp(0, 1), side, centre)[0], 90.0f);
  EXPECT_EQ(this->template orientations<ft::per_warp>(ramp(-1, 0), side, centre)[0], 180.0f);
  EXPECT_EQ(this->template orientations<ft::per_warp>(ramp(0, -1), side, centre)[0], 270.0f);
  std::vector<std::uint8_t> const flat(side * side, 200);
  EXPECT_EQ(this->template orientations<ft::per_warp>(flat, side, centre)[0], 0.0f)
      << "no direction: 0";
}

}  // namespace orientation_test
