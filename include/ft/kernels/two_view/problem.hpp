// SPDX-License-Identifier: Apache-2.0
/// @file Inputs, parameters and workspace of the reconstruction from two views.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <type_traits>

#include "ft/cameras/pinhole.hpp"
#include "ft/containers/soa.hpp"
#include "ft/containers/two_views.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/images/undistort.hpp"
#include "ft/kernels/inertial/wide_rotation.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// @throws bad_argument naming the value and the limit
inline void check(two_view_params const& p) {
  detail::require_range("two_view_params::samples", p.samples, 1, two_view_params::most_samples);
  detail::require_range("two_view_params::sigma_px", p.sigma_px, 1e-6f, 1e6f);
  // Outside [0, 1]: always the one or the other.
  detail::require_range("two_view_params::homography_ratio", p.homography_ratio, -1.0f, 2.0f);
  detail::require_range("two_view_params::min_points", p.min_points, 1, 1 << 24);
  detail::require_range("two_view_params::min_parallax_deg", p.min_parallax_deg, 0.0f, 180.0f);
}

/// Pairs of images with matched keypoints. Positions are undistorted; those of very wide lenses are
/// projected into a pinhole camera.
struct two_view_input {
  pixels_view first;           ///< pixels; batch = pairs
  pixels_view second;          ///< pixels; the same batch
  int const* match = nullptr;  ///< [pairs][first.capacity] keypoint of the second image, or below 0
  pinhole<float> const* camera = nullptr;  ///< [pairs]
  std::uint64_t const* seed = nullptr;     ///< [pairs] of the samples
};
static_assert(std::is_trivially_copyable<two_view_input>::value, "passed to kernels");

namespace detail {

/// A match. Pixels of the first and of the second image.
struct matched_pixels {
  float x1, y1, x2, y2;
};

/// x -> (x - mean) * scale.
struct pixel_normalization {
  wide mean_x, mean_y, scale_x, scale_y;
};

/// What is known of a pair before samples are drawn.
struct prepared_pair {
  two_view_status status;  ///< reconstructed: go on
  int matches;
  pixel_normalization first, second;
};

/// The model taken.
struct chosen_model {
  two_view_status status;
  two_view_model model;
  int sample[2];  ///< of the best homography and fundamental matrix, or -1
  double score[2];
  double ratio;
  int inliers;
  int motions;
};

/// What the inliers say about a motion.
struct checked_motion {
  int points;
  int triangulated;
  float parallax;  ///< degrees
};

/// A point of a match by a motion.
struct checked_point {
  vec3<float> X;
  /// Of the cosine between its rays, increasing with it; all ones without a good point.
  std::uint32_t key;
};

}  // namespace detail

/// Workspace of reconstruct_two_views().
struct two_view_workspace {
  static constexpr int most_motions = two_view_result::most_motions;

  int pairs = 0;
  int capacity = 0;
  int samples = 0;
  detail::prepared_pair* prepared = nullptr;  ///< [pairs]
  detail::matched_pixels* matched = nullptr;  ///< [pairs][capacity]
  int* keypoint = nullptr;                    ///< [pairs][capacity] of a match, first image
  std::uint8_t* inlier = nullptr;             ///< [pairs][capacity] of matches
  mat3<double>* model = nullptr;              ///< [pairs][2][samples] homographies, then F
  double* score = nullptr;                    ///< [pairs][2][samples]
  detail::chosen_model* chosen = nullptr;     ///< [pairs]
  rigid<double>* motion = nullptr;            ///< [pairs][8]
  detail::checked_motion* checked = nullptr;  ///< [pairs][8]
  detail::checked_point* point = nullptr;     ///< [pairs][8][capacity] of matches
};
static_assert(std::is_trivially_copyable<two_view_workspace>::value, "passed to kernels");

/// @param capacity keypoints of a first image @param samples as in two_view_params
inline void carve(carver& c, two_view_workspace& v, int pairs, int capacity, int samples) {
  v.pairs = pairs;
  v.capacity = capacity;
  v.samples = samples;
  auto const p = static_cast<std::size_t>(pairs);
  auto const n = detail::checked_mul(p, static_cast<std::size_t>(capacity));
  auto const tries = detail::checked_mul(2 * p, static_cast<std::size_t>(samples));
  constexpr auto motions = static_cast<std::size_t>(two_view_workspace::most_motions);
  v.prepared = c.take<detail::prepared_pair>(p);
  v.matched = c.take<detail::matched_pixels>(n);
  v.keypoint = c.take<int>(n);
  v.inlier = c.take<std::uint8_t>(n);
  v.model = c.take<mat3<double>>(tries);
  v.score = c.take<double>(tries);
  v.chosen = c.take<detail::chosen_model>(p);
  v.motion = c.take<rigid<double>>(detail::checked_mul(p, motions));
  v.checked = c.take<detail::checked_motion>(detail::checked_mul(p, motions));
  v.point = c.take<detail::checked_point>(detail::checked_mul(n, motions));
}

namespace detail {

/// @throws bad_argument for what reconstruct_two_views() refuses
inline void require_two_views(two_view_input const& in, two_view_params const& params,
                              two_view_reconstructions const& out,
                              two_view_workspace const& workspace) {
  check(params);
  require_pixels("keypoints of the first images", in.first);
  require_pixels("keypoints of the second images", in.second);
  require_range("batch of the second images", in.second.batch, in.first.batch, in.first.batch);
  require(in.match != nullptr && in.camera != nullptr && in.seed != nullptr,
          "matches, cameras or seeds are null");
  require(out.result != nullptr && out.point != nullptr && out.flags != nullptr &&
              workspace.prepared != nullptr,
          "the reconstructions or their workspace are null");
  require_range("pairs of the reconstructions", out.pairs, in.first.batch, in.first.batch);
  require_range("capacity of the reconstructions", out.capacity, in.first.capacity,
                in.first.capacity);
  require_range("pairs of the workspace", workspace.pairs, in.first.batch, in.first.batch);
  require_range("capacity of the workspace", workspace.capacity, in.first.capacity,
                in.first.capacity);
  require_range("samples of the workspace", workspace.samples, params.samples, params.samples);
  auto const pairs = static_cast<std::size_t>(in.first.batch);
  require_items("pairs and samples", pairs, 2 * static_cast<std::size_t>(params.samples));
  require_items("pairs and motions", pairs,
                static_cast<std::size_t>(two_view_workspace::most_motions));
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
