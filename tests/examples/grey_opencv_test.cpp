// SPDX-License-Identifier: Apache-2.0
// Colour to grey against OpenCV's cvtColor.
#include "examples/sequence/grey.hpp"

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <vector>

namespace {

/// As OpenCV has it, from red first and from blue first.
void expect_grey_of_opencv(cv::Mat const& rgb) {
  std::vector<std::uint8_t> grey(rgb.total());
  seq::grey_of_rgb(rgb.data, grey.size(), grey.data());
  cv::Mat const ours(rgb.size(), CV_8UC1, grey.data());
  cv::Mat expected;
  cv::cvtColor(rgb, expected, cv::COLOR_RGB2GRAY);
  ASSERT_EQ(cv::countNonZero(ours != expected), 0);
  cv::Mat bgr;
  cv::cvtColor(rgb, bgr, cv::COLOR_RGB2BGR);
  cv::cvtColor(bgr, expected, cv::COLOR_BGR2GRAY);
  ASSERT_EQ(cv::countNonZero(ours != expected), 0);
}

TEST(grey_oracle, every_colour_is_converted_as_by_opencv) {
  cv::Mat slice(256, 256, CV_8UC3);  // of one red
  for (int red = 0; red < 256; ++red) {
    for (int green = 0; green < 256; ++green) {
      for (int blue = 0; blue < 256; ++blue) {
        slice.at<cv::Vec3b>(green, blue) =
            cv::Vec3b(static_cast<std::uint8_t>(red), static_cast<std::uint8_t>(green),
                      static_cast<std::uint8_t>(blue));
      }
    }
    expect_grey_of_opencv(slice);
  }
}

TEST(grey_oracle, images_of_any_width_are_converted_as_by_opencv) {
  std::mt19937 random(5);  // OpenCV has vector code for the most of a row and another for the rest
  for (int width = 1; width < 150; ++width) {
    cv::Mat picture(7, width, CV_8UC3);
    for (std::size_t i = 0; i < 3 * picture.total(); ++i) {
      picture.data[i] = static_cast<std::uint8_t>(random() & 255u);
    }
    expect_grey_of_opencv(picture);
  }
}

}  // namespace
