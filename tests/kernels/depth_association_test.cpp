// SPDX-License-Identifier: Apache-2.0
// Depth of keypoints from depth images against a plain reading of the rule, on every executor.
#include "ft/kernels/images/depth_association.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <random>
#include <vector>

#include "tests/support/backends.hpp"

namespace depth_association_test {

struct answer {
  float right_x = -1, depth = -1;
  int score = -1;
};

constexpr float nan = std::numeric_limits<float>::quiet_NaN();
constexpr float inf = std::numeric_limits<float>::infinity();

template <typename Backend>
class depth_association_unit : public test::on_backend<Backend> {
protected:
  Backend backend;
  using exec_type = typename Backend::exec_type;
  using pixels = ft::pixels<exec_type::space>;
  using matches = ft::stereo_matches<exec_type::space>;

  void expect(ft::stereo_matches_view const& got, std::vector<answer> const& want) {
    auto const& exec = backend.exec;
    auto const right_x = test::column<ft::field::right_x>(exec, got);
    auto const depth = test::column<ft::field::depth>(exec, got);
    auto const score = test::column<ft::field::score>(exec, got);
    ASSERT_EQ(right_x.size(), want.size());
    for (std::size_t i = 0; i < want.size(); ++i) {
      EXPECT_EQ(right_x[i], want[i].right_x) << i;
      EXPECT_EQ(depth[i], want[i].depth) << i;
      EXPECT_EQ(score[i], want[i].score) << i;
    }
  }
  /// One image of one row, keypoint i at column i.
  template <typename T>
  void expect_row(std::vector<T> const& row, ft::depth_params const& params,
                  std::vector<answer> const& want) {
    auto const n = static_cast<int>(row.size());
    std::vector<float> x(row.size());
    for (std::size_t i = 0; i < row.size(); ++i) { x[i] = static_cast<float>(i); }
    pixels const kp(n);
    test::set_pixels(backend.exec, kp.view(), x, std::vector<float>(row.size(), 0), {n});
    matches const out(n);
    auto const depth = test::to_exec(backend.exec, row);
    ft::associate_depth(
        backend.exec, kp.view(), kp.view(),
        ft::depth_images_view<T>{
            depth.data(), n, 1, static_cast<std::ptrdiff_t>(n * static_cast<int>(sizeof(T))), 0, 1},
        params, out.view());
    expect(out.view(), want);
  }

  /// Random images and keypoints, pitches with a rest, against a loop.
  template <typename T>
  void expect_loop(ft::depth_params const& params, unsigned seed) {
    constexpr int capacity = 700;
    constexpr int batch = 3;
    constexpr int width = 67;
    constexpr int height = 41;
    constexpr std::ptrdiff_t row = width + 3;
    constexpr std::ptrdiff_t image = row * height + 5;
    std::mt19937 random(seed);
    std::vector<T> values(static_cast<std::size_t>(image * batch));
    for (T& v : values) {
      v = static_cast<T>(random() % 3 == 0 ? 0
                                           : static_cast<double>(random() % 60000u) /
                                                 (sizeof(T) == 2 ? 1 : 6000));
      if (sizeof(T) == 4 && random() % 10 == 0) {
        float const odd[] = {nan, inf, -inf, -1.5f, -0.0f, 1e-42f, 3e38f};
        v = static_cast<T>(odd[random() % 7]);
        if (sizeof(T) == 2) { v = 0; }
      }
    }
    std::uniform_real_distribution<float> px(-5, width + 5);
    std::uniform_real_distribution<float> py(-5, height + 5);
    std::vector<float> x(capacity * batch);
    std::vector<float> y(x.size());
    std::vector<float> ux(x.size());
    for (std::size_t i = 0; i < x.size(); ++i) {
      x[i] = i % 50 == 0 ? nan : px(random);
      y[i] = i % 50 == 1 ? -inf : py(random);
      ux[i] = i % 50 == 2 ? nan : x[i] + 3.3f * px(random);
    }
    std::vector<int> const count{capacity, 0, 333};
    std::vector<answer> want(x.size());
    int found = 0;
    for (int b = 0; b < batch; ++b) {
      for (int i = 0; i < count[static_cast<std::size_t>(b)]; ++i) {
        auto const at = static_cast<std::size_t>(b * capacity + i);
        if (!(std::fabs(x[at]) < 1000 && std::fabs(y[at]) < 1000)) { continue; }
        int const column = static_cast<int>(x[at]);
        int const line = static_cast<int>(y[at]);
        if (x[at] <= -1 || y[at] <= -1 || column >= width || line >= height) { continue; }
        volatile float const d =
            static_cast<float>(values[static_cast<std::size_t>(b * image + line * row + column)]) *
            params.scale;
        if (!(d > 0) || !std::isfinite(d) || d < params.min_depth || d > params.max_depth) {
          continue;
        }
        volatile float const disparity = params.bf / d;
        float const right = ux[at] - disparity;
        if (!std::isfinite(right)) { continue; }
        want[at] = {right, d, 0};
        ++found;
      }
    }
    EXPECT_GT(found, 200);
    auto const& exec = backend.exec;
    pixels const raw(capacity, batch);
    pixels const undistorted(capacity, batch);
    test::set_pixels(backend.exec, raw.view(), x, y, count);
    test::set_pixels(backend.exec, undistorted.view(), ux, y, count);
    auto const depth = test::to_exec(exec, values);
    constexpr auto size = static_cast<std::ptrdiff_t>(sizeof(T));
    matches const out(capacity, batch);
    ft::associate_depth(
        exec, raw.view(), undistorted.view(),
        ft::depth_images_view<T>{depth.data(), width, height, row * size, image * size, batch},
        params, out.view());
    EXPECT_EQ(test::from_exec(exec, static_cast<int const*>(out.view().count), 3), count);
    expect(out.view(), want);

    // The same images by a table of their places.
    std::vector<ft::depth_source> places;
    for (std::ptrdiff_t b = 0; b < batch; ++b) {
      places.push_back({depth.data() + b * image, row * size, sizeof(T) == 4 ? 1 : 0});
    }
    auto const table = test::to_exec(exec, places);
    matches const again(capacity, batch);
    ft::associate_depth(exec, raw.view(), undistorted.view(),
                        ft::depth_sources_view{table.data(), width, height, batch}, params,
                        again.view());
    expect(again.view(), want);
  }
};
TYPED_TEST_SUITE(depth_association_unit, test::backends);

TYPED_TEST(depth_association_unit, float_depths_are_those_of_a_loop) {
  this->template expect_loop<float>({40.0f}, 1);
  this->template expect_loop<float>({386.1448f, 0.73f, 0.5f, 5.25f}, 2);
}

TYPED_TEST(depth_association_unit, sixteen_bit_depths_are_scaled) {
  this->template expect_loop<std::uint16_t>({40.0f, 1 / 5000.0f}, 3);
  this->template expect_loop<std::uint16_t>({21.5f, 0.001f, 0.3f, 40.0f}, 4);
}

TYPED_TEST(depth_association_unit, what_is_no_positive_number_in_range_gives_no_match) {
  answer const none;
  this->template expect_row<float>(
      {1.0f, 0.0f, -0.0f, -2.0f, nan, inf, -inf, 2.0f, 1e-42f, 4.0f}, {8.0f},
      {{-8, 1, 0}, none, none, none, none, none, none, {3, 2, 0}, none, {7, 4, 0}});
  // Both limits belong to the range.
  this->template expect_row<float>({0.9375f, 1.0f, 1.5f, 2.0f, 2.0625f}, {1.0f, 1, 1, 2},
                                   {none, {0, 1, 0}, {2 - 1 / 1.5f, 1.5f, 0}, {2.5f, 2, 0}, none});
  this->template expect_row<std::uint16_t>(
      {0, 1, 65535}, {16.0f, 0.5f}, {none, {-31, 0.5f, 0}, {2 - 16 / 32767.5f, 32767.5f, 0}});
}

TYPED_TEST(depth_association_unit, positions_are_truncated_towards_zero) {
  auto const& exec = this->backend.exec;
  auto const depth = test::to_exec(exec, std::vector<float>{1, 2, 4, 8, 16, 32});  // 3 x 2
  std::vector<float> const x{0.99f, 1.0f, 2.999f, 3.0f, -0.5f, -1.0f,
                             1.0f,  1.0f, 1.0f,   nan,  3e9f,  -3e9f};
  std::vector<float> const y{0.99f, 1.5f, 0.0f,  0.0f, -0.5f, 0.0f,
                             -1.0f, 2.0f, 1.99f, 0.0f, 0.0f,  0.0f};
  std::vector<float> const want{1, 16, 4, -1, 1, -1, -1, -1, 16, -1, -1, -1};
  auto const n = static_cast<int>(x.size());
  typename TestFixture::pixels const kp(n);
  test::set_pixels(this->backend.exec, kp.view(), x, y, {n});
  typename TestFixture::matches const out(n);
  ft::associate_depth(exec, kp.view(), kp.view(),
                      ft::depth_images_view<float>{depth.data(), 3, 2, 12, 0, 1}, {1.0f},
                      out.view());
  EXPECT_EQ(test::column<ft::field::depth>(exec, out.view()), want);
}

TYPED_TEST(depth_association_unit, bad_input_throws_before_anything_is_queued) {
  auto const& exec = this->backend.exec;
  typename TestFixture::pixels const kp(6, 2);
  typename TestFixture::pixels const other(5, 2);
  typename TestFixture::matches const out(6, 2);
  typename TestFixture::matches const small(6, 1);
  test::set_pixels(this->backend.exec, kp.view(), std::vector<float>(12, 1),
                   std::vector<float>(12, 1), {6, 6});
  auto const memory = test::to_exec(exec, std::vector<float>(64, 1));
  using images = ft::depth_images_view<float>;
  images const good{memory.data(), 5, 4, 20, 80, 2};
  ft::depth_params const p{10.0f};
  auto const k = kp.view();
  auto const o = out.view();
  EXPECT_NO_THROW(ft::associate_depth(exec, k, k, good, p, o));
  EXPECT_THROW(ft::associate_depth(exec, {}, k, good, p, o), ft::bad_argument);
  EXPECT_THROW(ft::associate_depth(exec, k, {}, good, p, o), ft::bad_argument);
  EXPECT_THROW(ft::associate_depth(exec, k, k, good, p, {}), ft::bad_argument);
  EXPECT_THROW(ft::associate_depth(exec, k, other.view(), good, p, o), ft::bad_argument);
  EXPECT_THROW(ft::associate_depth(exec, k, k, good, p, small.view()), ft::bad_argument);
  for (images const& bad :
       {images{}, images{nullptr, 5, 4, 20, 80, 2}, images{memory.data(), 0, 4, 20, 80, 2},
        images{memory.data(), 5, 16385, 20, 80, 2}, images{memory.data(), 5, 4, 16, 80, 2},
        images{memory.data(), 5, 4, 22, 80, 2}, images{memory.data(), 5, 4, 20, 82, 2},
        images{memory.data(), 5, 4, 20, -80, 2}, images{memory.data(), 5, 4, 20, 80, 1}}) {
    EXPECT_THROW(ft::associate_depth(exec, k, k, bad, p, o), ft::bad_argument);
  }
  auto const table = test::to_exec(exec, std::vector<ft::depth_source>(2, {memory.data(), 20, 1}));
  ft::depth_sources_view const placed{table.data(), 5, 4, 2};
  EXPECT_NO_THROW(ft::associate_depth(exec, k, k, placed, p, o));
  EXPECT_THROW(ft::associate_depth(exec, k, k, ft::depth_sources_view{nullptr, 5, 4, 2}, p, o),
               ft::bad_argument);
  EXPECT_THROW(ft::associate_depth(exec, k, k, ft::depth_sources_view{table.data(), 5, 4, 1}, p, o),
               ft::bad_argument);
  for (ft::depth_params const& bad : {ft::depth_params{},
                                      {nan},
                                      {inf},
                                      {-1.0f},
                                      {1, 0},
                                      {1, nan},
                                      {1, -1},
                                      {1, 1, nan},
                                      {1, 1, -1},
                                      {1, 1, inf},
                                      {1, 1, 2, 1},
                                      {1, 1, 0, nan}}) {
    EXPECT_THROW(ft::associate_depth(exec, k, k, good, bad, o), ft::bad_argument);
  }
  exec.wait();
}

}  // namespace depth_association_test
