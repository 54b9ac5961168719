// SPDX-License-Identifier: Apache-2.0
// ft and OpenCV together, in both directions: corners of cv::goodFeaturesToTrack get ft's
// descriptors, and ft's own keypoints become cv::KeyPoint with a matrix of descriptors.
// cv::BFMatcher matches both kinds between the images of a rectified pair, where correct matches
// lie in the same row.
#include <cmath>
#include <cstdio>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "examples/common/run.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/interop/opencv.hpp"
#include "ft/pipelines/orb_extractor.hpp"

struct features {
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;  ///< a row of 32 bytes each
};

using extractor = ft::orb_extractor<ft::host_exec>;

/// Corners of OpenCV with ft's angle and descriptor.
features described_by_ft(ft::host_exec const& exec, extractor& orb, cv::Mat const& image) {
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(image, corners, 1000, 0.01, 7);
  std::vector<cv::KeyPoint> from_opencv;
  for (auto const& p : corners) { from_opencv.emplace_back(p, 31.0f); }

  ft::keypoints<ft::memory_space::host> keypoints(1000);
  ft::from_opencv(from_opencv, keypoints.view());
  orb.upload(exec, 0, ft::as_view(image));  // the pixels of the cv::Mat, in place
  orb.build_levels(exec);                   // no corners are needed
  orb.describe_keypoints(exec, keypoints.view());
  return {ft::to_opencv(keypoints.view(), orb.geometry()),
          ft::descriptors_to_opencv(keypoints.view())};
}

/// ft's keypoints as types of OpenCV.
features extracted_by_ft(ft::host_exec const& exec, extractor& orb, cv::Mat const& image) {
  orb.upload(exec, 0, ft::as_view(image));
  orb.extract(exec);
  auto const keypoints = orb.keypoints().slice(0);
  return {ft::to_opencv(keypoints, orb.geometry()), ft::descriptors_to_opencv(keypoints)};
}

/// Matches, and prints how many matches lie in the same row. @return whether most do
bool match(char const* name, features const& left, features const& right) {
  std::vector<cv::DMatch> matches;
  cv::BFMatcher(cv::NORM_HAMMING, true).match(left.descriptors, right.descriptors, matches);
  int close = 0;
  int right_row = 0;
  for (auto const& m : matches) {
    auto const& a = left.keypoints[static_cast<std::size_t>(m.queryIdx)];
    auto const& b = right.keypoints[static_cast<std::size_t>(m.trainIdx)];
    if (m.distance > 40 || a.angle < 0 || b.angle < 0) { continue; }  // -1: not described
    ++close;
    right_row += static_cast<int>(std::abs(a.pt.y - b.pt.y) <= 0.1f * a.size);
  }
  std::printf("%s: %zu and %zu keypoints, %d close matches, %d of them in the same row\n", name,
              left.keypoints.size(), right.keypoints.size(), close, right_row);
  return close > 150 && right_row > 0.9 * close;
}

int main() {
  return demo::guarded([] {
    auto pair = demo::scene(100).render(60);
    auto const matrix = [](demo::grey_image& image) {
      return cv::Mat(image.height, image.width, CV_8UC1, image.pixels.data());
    };
    cv::Mat const left = matrix(pair.left);
    cv::Mat const right = matrix(pair.right);
    ft::host_exec const exec;
    extractor orb(exec, demo::params_for(pair.left), 1);
    bool const corners = match("OpenCV's corners, ft's descriptors",
                               described_by_ft(exec, orb, left), described_by_ft(exec, orb, right));
    bool const orbs = match("ft's keypoints, OpenCV's matcher", extracted_by_ft(exec, orb, left),
                            extracted_by_ft(exec, orb, right));
    return demo::verdict(corners && orbs);
  });
}
