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
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/images/undistort.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// @throws bad_argument naming the value and the limit
inline void check(two_view_params const& p) {
  detail::require_range("samples", p.samples, 1, two_view_params::most_samples);
  detail::require_range("sigma_px", p.sigma_px, 1e-6f, 1e6f);
  // Outside [0, 1]: always the one or the other.
  detail::require_range("homography_ratio", p.homography_ratio, -1.0f, 2.0f);
  detail::require_range("min_points", p.min_points, 1, 1 << 24);
  detail::require_range("min_parallax_deg", p.min_parallax_deg, 0.0f, 180.0f);
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
  real64 mean_x, mean_y, scale_x, scale_y;
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
  constexpr int motions = two_view_workspace::most_motions;
  v.pairs = pairs;
  v.capacity = capacity;
  v.samples = samples;
  c.place({pairs}, v.prepared);
  c.place({pairs, capacity}, v.matched, v.keypoint, v.inlier);
  c.place({2, pairs, samples}, v.model, v.score);
  c.place({pairs}, v.chosen);
  c.place({pairs, motions}, v.motion, v.checked);
  c.place({pairs, capacity, motions}, v.point);
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

// First step of a reconstruction from two views: the matches of each pair as a list, and how
// pixels are normalised. Source: Hartley, "In defense of the eight-point algorithm", PAMI 1997;
// here with mean absolute deviations, by axis.

/// Item: a pair of images. Sums are over all keypoints, matched or not.
struct prepare_pair {
  struct scratch {
    ordered_sum_scratch<4, double> sums;
    ordered_sum_scratch<10, double> moments;
  };
  /// Points are on a line if the product of their variances along and across it is below this share
  /// of the square of their sum. Rounding of positions to floats makes 1000 times less.
  static constexpr double flat = 1e-10;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int pair, two_view_input const& in,
                                 two_view_workspace const& w) const {
    prepared_pair p{};
    bool const all_there = list_matches(g, pair, in, w, p.matches);
    int const n1 = count_of(in.first, pair);
    int const n2 = count_of(in.second, pair);
    int const from1 = pair * in.first.capacity;
    int const from2 = pair * in.second.capacity;
    auto const over_keypoints = [&](auto const& term) {
      ordered_sum(g, s.sums, max_of(n1, n2), [&](int i, sum_terms<4, double>& acc) {
        if (i < n1) {
          acc.of[0] += term(in.first.x(from1 + i), 0);
          acc.of[1] += term(in.first.y(from1 + i), 1);
        }
        if (i < n2) {
          acc.of[2] += term(in.second.x(from2 + i), 2);
          acc.of[3] += term(in.second.y(from2 + i), 3);
        }
      });
    };
    real64 const n[4] = {double(n1), double(n1), double(n2), double(n2)};
    over_keypoints([](float v, int) { return static_cast<double>(v); });
    real64 mean[4];
    for (int k = 0; k < 4; ++k) { mean[k] = real64(s.sums.total.of[k]) / n[k]; }
    over_keypoints([&](float v, int k) {
      return scalar::abs(real64(static_cast<double>(v)) - mean[k]).value;
    });
    real64 scale[4];
    for (int k = 0; k < 4; ++k) { scale[k] = n[k] / real64(s.sums.total.of[k]); }
    p.first = {mean[0], mean[1], scale[0], scale[1]};
    p.second = {mean[2], mean[3], scale[2], scale[3]};
    bool const spread = spreads(g, s, w.matched + std::ptrdiff_t{pair} * w.capacity, p);
    p.status = all_there ? judge(p, in.camera[pair], spread) : two_view_status::bad_match;
    if (g.rank() == 0) { w.prepared[pair] = p; }
  }

private:
  FT_HOST_DEVICE static int count_of(pixels_view const& v, int pair) {
    return clamp(v.count[pair], 0, v.capacity);
  }

  /// Writes the matches in the order of the first image's keypoints. Returns whether all are
  /// keypoints of the second image.
  template <typename Group>
  FT_HOST_DEVICE static bool list_matches(Group g, int pair, two_view_input const& in,
                                          two_view_workspace const& w, int& count) {
    int const n1 = count_of(in.first, pair);
    int const n2 = count_of(in.second, pair);
    int const from1 = pair * in.first.capacity;
    int const from2 = pair * in.second.capacity;
    std::ptrdiff_t const to = std::ptrdiff_t{pair} * w.capacity;
    bool beyond = false;
    count = 0;
    for (int base = 0; base < n1; base += g.size()) {
      int const i = base + g.rank();
      int const m = i < n1 ? in.match[from1 + i] : -1;
      bool const taken = m >= 0 && m < n2;
      beyond = beyond || m >= n2;
      int more = 0;
      int const at = count + g.exclusive_count(taken, more);
      if (taken) {
        w.matched[to + at] = {in.first.x(from1 + i), in.first.y(from1 + i), in.second.x(from2 + m),
                              in.second.y(from2 + m)};
        w.keypoint[to + at] = i;
      }
      count += more;
    }
    return !g.any(beyond);  // and what was written is visible to the group
  }

  /// Whether the matched keypoints of both images have two dimensions.
  template <typename Group>
  FT_HOST_DEVICE static bool spreads(Group g, scratch& s, matched_pixels const* matched,
                                     prepared_pair const& p) {
    real64 const mean[4] = {p.first.mean_x, p.first.mean_y, p.second.mean_x, p.second.mean_y};
    ordered_sum(g, s.moments, p.matches, [&](int i, sum_terms<10, double>& acc) {
      matched_pixels const m = matched[i];
      float const xy[4] = {m.x1, m.y1, m.x2, m.y2};
      FT_UNROLL
      for (int image = 0; image < 2; ++image) {
        real64 const x = real64(static_cast<double>(xy[2 * image])) - mean[2 * image];
        real64 const y = real64(static_cast<double>(xy[2 * image + 1])) - mean[2 * image + 1];
        double* const sum = acc.of + 5 * image;
        sum[0] += x.value;
        sum[1] += y.value;
        sum[2] += (x * x).value;
        sum[3] += (x * y).value;
        sum[4] += (y * y).value;
      }
    });
    bool spread = true;
    for (int image = 0; image < 2; ++image) {
      double const* const sum = s.moments.total.of + 5 * image;
      real64 const count = double(p.matches);
      real64 const x = real64(sum[0]) / count;
      real64 const y = real64(sum[1]) / count;
      real64 const xx = real64(sum[2]) / count - x * x;
      real64 const xy = real64(sum[3]) / count - x * y;
      real64 const yy = real64(sum[4]) / count - y * y;
      real64 const trace = xx + yy;
      spread = spread && xx * yy - xy * xy > real64(flat) * (trace * trace);
    }
    return spread;
  }

  FT_HOST_DEVICE static two_view_status judge(prepared_pair const& p, pinhole<float> const& camera,
                                              bool spread) {
    if (p.matches < 8) { return two_view_status::too_few_matches; }
    if (!(camera.fx > 0 && camera.fy > 0) || !scalar::is_finite(camera.fx + camera.fy) ||
        !scalar::is_finite(camera.cx + camera.cy)) {
      return two_view_status::bad_camera;
    }
    auto const finite = [](pixel_normalization const& n) {
      return scalar::is_finite(n.mean_x + n.mean_y);
    };
    if (!finite(p.first) || !finite(p.second)) { return two_view_status::not_finite; }
    return spread ? two_view_status::reconstructed : two_view_status::degenerate;
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
