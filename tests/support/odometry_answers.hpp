// SPDX-License-Identifier: Apache-2.0
/// @file Compares what odometries answer, to the bit.
#pragma once

#include <gtest/gtest.h>

#include <cstddef>
#include <cstring>
#include <vector>

#include "ft/pipelines/odometry_types.hpp"

namespace test {

inline bool same(ft::tracking const& a, ft::tracking const& b) {
  return std::memcmp(&a.T_world_camera, &b.T_world_camera, sizeof a.T_world_camera) == 0 &&
         a.state == b.state && a.keyframe == b.keyframe && a.inliers == b.inliers &&
         a.keypoints == b.keypoints && a.stereo_points == b.stereo_points &&
         a.local_points == b.local_points && a.left_out == b.left_out &&
         a.map_points == b.map_points && a.maps == b.maps && a.keyframes == b.keyframes &&
         std::memcmp(a.covariance, b.covariance, sizeof a.covariance) == 0;
}

inline void expect_same(std::vector<ft::tracking> const& a, std::vector<ft::tracking> const& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    EXPECT_TRUE(same(a[i], b[i])) << "frame " << i << ": " << a[i].inliers << " and "
                                  << b[i].inliers << " inliers, " << a[i].map_points << " and "
                                  << b[i].map_points << " map points";
  }
}

}  // namespace test
