// SPDX-License-Identifier: Apache-2.0
/// @file What relocalisation asks of the device, as plain structures, the same for every compiler.
#pragma once

#include <cstdint>

#include "integration/orbslam3/plain_types.hpp"

namespace ft {
namespace orbslam3 {

struct keyframe_search_request {
  int frame = 0;     ///< buffer of the frame, with the points that it holds
  int keyframe = 0;  ///< buffer with counts and angles of the keyframe; holders: what is searched
  transform T_cw;    ///< of the frame
  bounds image{};
  float window_radius = 10;  ///< half side of a window at scale 1, pixels
  int max_hamming = 100;     ///< largest Hamming distance of a match, bits
};

/// Correspondences of a pose in host memory, to be filled in by the caller.
struct pnp_arrays {
  int capacity = 0;
  int count = 0;                ///< at most capacity
  float* pixel = nullptr;       ///< [count][2] undistorted
  float* point = nullptr;       ///< [count][3] in the world, metres
  float* max_error2 = nullptr;  ///< [count] squared error of an inlier, pixels^2
};

/// How far the RANSAC of one candidate has come. Default constructed before its first call; each
/// call moves it on.
struct pnp_progress {
  std::uint64_t seed = 0;  ///< of the samples, to which the frame's number is added
  int done = 0;            ///< iterations
  int kept_inliers = 0;    ///< of the best pose so far, 0 = none
  double kept[12] = {};    ///< that pose: R by rows, then t
};

/// Answer of one call.
struct pnp_found {
  bool any = false;      ///< whether there is a pose
  bool no_more = false;  ///< as many iterations are made as were planned
  transform T_cw;
  int inliers = 0;
  unsigned char const* inlier = nullptr;  ///< [count] 1 = inlier; until the next call
  device_times times;
};

}  // namespace orbslam3
}  // namespace ft
