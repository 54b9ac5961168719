// SPDX-License-Identifier: Apache-2.0
// Keypoints of OpenCV described by ft, against cv::ORB's descriptors of the same keypoints.
#include "ft/kernels/keypoints/describe_corners.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "ft/core/execution.hpp"
#include "ft/interop/opencv.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

namespace describe_oracle_test {

TEST(describe_oracle, descriptors_of_the_finest_level_are_opencvs_but_for_roundings) {
  constexpr int width = 320;
  constexpr int height = 240;
  auto pixels = test::random_image(width, height, 21);
  cv::Mat const image(height, width, CV_8UC1, pixels.data());
  ft::orb_params params;
  params.width = width;
  params.height = height;
  ft::host_exec const exec;
  ft::orb_extractor<ft::host_exec> orb(exec, params, 1);
  orb.upload(exec, 0, ft::as_view(image));
  orb.build_levels(exec);

  // Whole pixels, in OpenCV's reach: 31 from the border.
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(image, corners, 300, 0.01, 5);
  std::vector<cv::KeyPoint> points;
  for (auto const& c : corners) {
    if (c.x > 32 && c.x < width - 33 && c.y > 32 && c.y < height - 33) {
      points.emplace_back(c, 31.0f, -1.0f, 0.0f, 0);
    }
  }
  ASSERT_GT(points.size(), 100u);
  ft::keypoints<ft::memory_space::host> keypoints(static_cast<int>(points.size()));
  ft::from_opencv(points, keypoints.view());
  orb.describe_keypoints(exec, keypoints.view());

  // OpenCV is given ft's angles: it takes them as they are.
  auto described = ft::to_opencv(keypoints.view(), orb.geometry());
  cv::Mat want;
  cv::ORB::create(1000, 1.2f, 8)->compute(image, described, want);
  ASSERT_EQ(described.size(), points.size()) << "OpenCV has described all of them";
  cv::Mat const got = ft::descriptors_to_opencv(keypoints.view());
  // Rotated pattern points that lie between two pixels may be rounded either way: cosine and sine
  // have other last bits. Descriptors of other places differ in about 128 bits.
  double different = 0;
  for (int i = 0; i < want.rows; ++i) {
    double const bits = cv::norm(want.row(i), got.row(i), cv::NORM_HAMMING);
    EXPECT_LE(bits, 8) << "keypoint " << i;
    different += bits;
  }
  EXPECT_LT(different, 0.01 * 256 * want.rows);
}

}  // namespace describe_oracle_test
