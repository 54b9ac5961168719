// SPDX-License-Identifier: Apache-2.0
/// @file Compares what odometries answer, to the bit.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <sstream>
#include <string>
#include <vector>

#include "ft/types/poses.hpp"
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

inline bool same(ft::rigid<double> const& a, ft::rigid<double> const& b) {
  return std::memcmp(&a, &b, sizeof a) == 0;
}

/// An odometry's map as a file.
template <typename Odometry>
std::string saved(Odometry const& odo) {
  std::ostringstream to;
  odo.save_map(to);
  return to.str();
}
template <typename Odometry>
void load(Odometry& odo, std::string const& map) {
  std::istringstream from(map);
  odo.load_map(from);
}

inline void expect_same(std::vector<ft::tracking> const& a, std::vector<ft::tracking> const& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    EXPECT_TRUE(same(a[i], b[i])) << "frame " << i << ": " << a[i].inliers << " and "
                                  << b[i].inliers << " inliers, " << a[i].map_points << " and "
                                  << b[i].map_points << " map points";
  }
}

/// Tracks frames, whose images are all given as early as the odometry takes them.
/// @param images_of images_of(i) of frame i, valid until the end
template <typename Odometry, typename ImagesOf>
std::vector<ft::tracking> track_all(Odometry& odo, std::size_t frames, std::int64_t period,
                                    ImagesOf const& images_of) {
  std::vector<ft::tracking> all;
  std::size_t given = 0;
  auto const ahead = static_cast<std::size_t>(odo.params().prefetch);
  for (std::size_t i = 0; i < frames; ++i) {
    auto const time = period * static_cast<std::int64_t>(i + 1);
    if (ahead == 0) {
      all.push_back(odo.track(images_of(i), time));
      continue;
    }
    for (; given < frames && given < i + ahead; ++given) { odo.prefetch(images_of(given)); }
    all.push_back(odo.track_prefetched(time));
  }
  return all;
}

/// How far the camera is from its place, metres. The world is the first frame's camera.
inline double error_of(ft::rigid<double> const& T_world_camera, ft::pose const& now,
                       ft::pose const& first) {
  auto const d = T_world_camera.t - (first.cast<double>() * now.cast<double>().inverse()).t;
  return std::sqrt(ft::dot(d, d));
}
template <typename Frame>
double error_of(ft::tracking const& t, Frame const& now, Frame const& first) {
  return error_of(t.T_world_camera, now.T_cw, first.T_cw);
}

}  // namespace test
