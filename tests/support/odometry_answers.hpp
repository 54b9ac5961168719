// SPDX-License-Identifier: Apache-2.0
/// @file Compares what odometries answer, to the bit.
#pragma once

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "ft/types/tracking.hpp"

namespace test {

inline bool same(ft::tracking const& a, ft::tracking const& b) {
  return std::memcmp(&a.T_world_camera, &b.T_world_camera, sizeof a.T_world_camera) == 0 &&
         a.state == b.state && a.keyframe == b.keyframe && a.inliers == b.inliers &&
         a.keypoints == b.keypoints && a.stereo_points == b.stereo_points &&
         a.local_points == b.local_points && a.left_out == b.left_out &&
         a.map_points == b.map_points && a.maps == b.maps && a.keyframes == b.keyframes &&
         a.map_begun == b.map_begun && a.agreed == b.agreed &&
         a.distant_points == b.distant_points && a.depths == b.depths &&
         a.light.image == b.light.image && a.light.mean == b.light.mean &&
         a.light.deviation == b.light.deviation && a.start == b.start &&
         a.start_matches == b.start_matches &&
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

/// Tracks frames whose images were all given as early as the odometry takes them.
/// @param images_of images_of(i) of frame i, valid until the end
template <typename Odometry, typename ImagesOf>
std::vector<ft::tracking> track_prefetched(Odometry& odo, std::size_t frames, std::int64_t period,
                                           ImagesOf const& images_of) {
  std::vector<ft::tracking> all;
  std::size_t given = 0;
  auto const ahead = static_cast<std::size_t>(odo.params().prefetch);
  for (std::size_t i = 0; i < frames; ++i) {
    for (; given < frames && given < i + ahead; ++given) { odo.prefetch(images_of(given)); }
    all.push_back(odo.track_prefetched(period * static_cast<std::int64_t>(i + 1)));
  }
  return all;
}

}  // namespace test
