// SPDX-License-Identifier: Apache-2.0
// Bridges to OpenCV: what goes in comes out, and what does not fit throws.
#include "ft/interop/opencv.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <opencv2/core.hpp>
#include <vector>

namespace interop_test {

inline std::vector<cv::KeyPoint> some_keypoints(int n) {
  std::vector<cv::KeyPoint> all;
  for (int i = 0; i < n; ++i) {
    auto const v = static_cast<float>(i);
    all.emplace_back(v + 0.25f, 2 * v + 0.5f, 31.0f, 3 * v, 4 * v, i % 8);
  }
  return all;
}

TEST(opencv_interop, keypoints_come_back_as_they_went_in) {
  ft::keypoints<ft::memory_space::host> keypoints(20, 2);
  auto const entry = keypoints.view().slice(1);
  auto const in = some_keypoints(20);
  ft::from_opencv(in, entry);
  auto const geometry = ft::pyramid_geometry::make(640, 480, 8, 1.2f);
  auto const out = ft::to_opencv(entry, geometry);
  ASSERT_EQ(out.size(), in.size());
  for (std::size_t i = 0; i < in.size(); ++i) {
    EXPECT_EQ(out[i].pt, in[i].pt);
    EXPECT_EQ(out[i].angle, in[i].angle);
    EXPECT_EQ(out[i].response, in[i].response);
    EXPECT_EQ(out[i].octave, in[i].octave);
    EXPECT_NEAR(out[i].size, 31 * std::pow(1.2, in[i].octave), 1) << "the patch of the octave";
  }
  ft::from_opencv({}, entry);
  EXPECT_TRUE(ft::to_opencv(entry, geometry).empty());
  EXPECT_EQ(ft::descriptors_to_opencv(entry).rows, 0);
}

TEST(opencv_interop, more_keypoints_than_fit_throw) {
  ft::keypoints<ft::memory_space::host> keypoints(20);
  *keypoints.view().count = 7;
  EXPECT_THROW(ft::from_opencv(some_keypoints(21), keypoints.view()), ft::bad_argument);
  EXPECT_EQ(*keypoints.view().count, 7) << "nothing was written";
}

TEST(opencv_interop, descriptors_are_rows_of_32_bytes) {
  ft::keypoints<ft::memory_space::host> keypoints(3);
  ft::from_opencv(some_keypoints(3), keypoints.view());
  for (int i = 0; i < 3; ++i) {
    for (unsigned w = 0; w < 8; ++w) {
      keypoints.view().orb(i).words[w] = 0x01020304u * (w + 1) + unsigned(i);
    }
  }
  cv::Mat const rows = ft::descriptors_to_opencv(keypoints.view());
  ASSERT_EQ(rows.rows, 3);
  ASSERT_EQ(rows.cols, 32);
  ASSERT_EQ(rows.type(), CV_8UC1);
  for (int i = 0; i < 3; ++i) {
    for (int b = 0; b < 32; ++b) {
      unsigned const word = 0x01020304u * (unsigned(b) / 4 + 1) + unsigned(i);
      EXPECT_EQ(rows.at<std::uint8_t>(i, b), word >> (8 * (b % 4)) & 255u) << "lowest byte first";
    }
  }
}

TEST(opencv_interop, images_keep_their_stride) {
  cv::Mat const whole(50, 80, CV_8UC1, cv::Scalar(3));
  cv::Mat const part = whole(cv::Rect(10, 5, 30, 20));
  auto const view = ft::as_view(part);
  EXPECT_EQ(view.data, whole.ptr(5) + 10);
  EXPECT_EQ(view.width, 30);
  EXPECT_EQ(view.height, 20);
  EXPECT_EQ(view.stride, 80);
  EXPECT_THROW(ft::as_view(cv::Mat(5, 5, CV_8UC3)), ft::bad_argument);
  EXPECT_THROW(ft::as_view(cv::Mat(5, 5, CV_16UC1)), ft::bad_argument);
}

}  // namespace interop_test
