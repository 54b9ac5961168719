// SPDX-License-Identifier: Apache-2.0
// The order of a frame's keypoints, which is what its indices mean to the rest of the system.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <vector>

#include "integration/orbslam3/accelerator.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

namespace orbslam3_test {

namespace keypoint_order {

constexpr int width = 1200;
constexpr int height = 300;

class extracted_order : public on_executor {
protected:
  static stand_in::frame extract(ft::orbslam3::settings s) {
    s.width = width;
    s.height = height;
    if (s.left.kind == ft::orbslam3::lens::kannala_brandt) { s.left.values[2] = width / 2; }
    auto const pixels = test::random_image(width, height, 5);
    stand_in::matrix image;
    image.create(height, width, 0);
    for (int y = 0; y < height; ++y) {
      std::memcpy(image.data + y * static_cast<int>(image.step), pixels.data() + y * width, width);
    }
    ft::orbslam3::accelerator<stand_in::types> gpu(make(s), s);
    stand_in::frame f;
    gpu.extract(image, f);
    return f;
  }
  static void expect_order(stand_in::frame const& got, stand_in::frame const& forwards,
                           std::vector<std::size_t> const& from) {
    ASSERT_EQ(got.mvKeys.size(), from.size());
    for (std::size_t i = 0; i < from.size(); ++i) {
      ASSERT_EQ(got.mvKeys[i].pt.x, forwards.mvKeys[from[i]].pt.x) << i;
      ASSERT_EQ(got.mvKeys[i].pt.y, forwards.mvKeys[from[i]].pt.y) << i;
      ASSERT_EQ(got.mvKeys[i].octave, forwards.mvKeys[from[i]].octave) << i;
    }
  }
};

TEST_P(extracted_order, of_a_monocular_frame_ends_with_the_first_1000_columns_in_reverse) {
  stand_in::frame const forwards = extract(settings_for(sensor::rgbd));
  EXPECT_EQ(forwards.monoLeft, forwards.N) << "RGB-D has no overlap";
  std::vector<std::size_t> from;
  auto const n = static_cast<std::size_t>(forwards.N);
  for (std::size_t i = 0; i < n; ++i) {
    if (forwards.mvKeys[i].pt.x > 1000) { from.push_back(i); }
  }
  auto const beyond = static_cast<int>(from.size());
  ASSERT_GT(beyond, 50);
  for (std::size_t i = n; i-- > 0;) {
    if (forwards.mvKeys[i].pt.x <= 1000) { from.push_back(i); }
  }
  for (sensor const kind : {sensor::monocular, sensor::fisheye_monocular}) {
    SCOPED_TRACE(name_of(kind));
    auto const s = settings_for(kind);
    stand_in::frame const got = extract(s);
    EXPECT_EQ(got.monoLeft, beyond);
    expect_order(got, forwards, from);
  }
}

TEST_P(extracted_order, is_that_of_std_sort_unless_asked_otherwise) {
  auto s = settings_for(sensor::rgbd);
  EXPECT_EQ(s.ties, ft::tie_rule::std_sort);
  stand_in::frame const by_std_sort = extract(s);
  s.ties = ft::tie_rule::stable;
  stand_in::frame const stable = extract(s);
  int other = 0;
  for (std::size_t i = 0; i < std::min(by_std_sort.mvKeys.size(), stable.mvKeys.size()); ++i) {
    auto const& a = by_std_sort.mvKeys[i].pt;
    auto const& b = stable.mvKeys[i].pt;
    other += static_cast<int>(a.x != b.x || a.y != b.y);
  }
  EXPECT_GT(other, 20);
}

INSTANTIATE_TEST_SUITE_P(executors, extracted_order, ::testing::ValuesIn(executors()),
                         executor_name);

}  // namespace keypoint_order

}  // namespace orbslam3_test
