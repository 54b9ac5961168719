// SPDX-License-Identifier: Apache-2.0
/// @file Third step of a reconstruction from two views: the best homography and fundamental matrix,
/// the choice between them, and the motions that the model leaves possible. Source of the choice:
/// Mur-Artal, Montiel and Tardos, "ORB-SLAM: a versatile and accurate monocular SLAM system", T-RO
/// 2015, section IV.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/two_view/motions.hpp"
#include "ft/kernels/two_view/problem.hpp"
#include "ft/kernels/two_view/transfer_error.hpp"
#include "ft/kernels/two_view/try_samples.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

struct scored_sample {
  double score;
  int sample;
  int unused;  ///< for whole 8-byte words
};
/// The larger score, the lower sample of equals.
struct better_sample {
  FT_HOST_DEVICE scored_sample operator()(scored_sample const& a, scored_sample const& b) const {
    if (a.score != b.score) { return a.score > b.score ? a : b; }
    return a.sample < b.sample ? a : b;
  }
};

/// Item: a pair of images.
struct choose_model {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int pair, two_view_input const& in,
                                 two_view_params const& params, two_view_workspace const& w) const {
    prepared_pair const& p = w.prepared[pair];
    std::ptrdiff_t const first = std::ptrdiff_t{2} * pair * params.samples;
    chosen_model c{};
    for (int model = 0; model < 2; ++model) {
      scored_sample const best = best_of(g, w.score + first + model * params.samples, params);
      c.sample[model] = best.score > 0 ? best.sample : -1;
      c.score[model] = best.score;
    }
    take(c, p, params);
    bool const found = c.status == two_view_status::reconstructed;
    bool const homography = c.model == two_view_model::homography;
    wide_mat3 M{};
    if (found) {
      std::ptrdiff_t const at =
          homography ? c.sample[0] : std::ptrdiff_t{params.samples} + c.sample[1];
      M = w.model[first + at].cast<wide>();
    }
    auto const mark = [&](auto const& error) { return mark_inliers(g, pair, w, error, params); };
    c.inliers = homography ? mark(homography_error(M)) : found ? mark(fundamental_error(M)) : 0;
    if (g.rank() == 0) {
      auto const camera = wide_camera(in.camera[pair]);
      rigid<double>* const out = w.motion + std::ptrdiff_t{w.most_motions} * pair;
      if (found) {
        c.motions = homography ? motions_of_homography(M, camera, out)
                               : motions_of_fundamental(M, camera, out);
        if (c.motions == 0) { c.status = two_view_status::no_motion; }
      }
      w.chosen[pair] = c;
    }
  }

private:
  template <typename Group>
  FT_HOST_DEVICE static scored_sample best_of(Group g, double const* scores,
                                              two_view_params const& params) {
    scored_sample best{-1.0, params.samples, 0};
    for (int i = g.rank(); i < params.samples; i += g.size()) {
      best = better_sample{}(best, {scores[i], i, 0});
    }
    return g.reduce(best, better_sample{});
  }

  FT_HOST_DEVICE static void take(chosen_model& c, prepared_pair const& p,
                                  two_view_params const& params) {
    wide const H = c.score[0];
    wide const F = c.score[1];
    bool const any = H + F > wide(0.0);
    c.ratio = any ? (H / (H + F)).value : 0.0;
    c.status = p.status;
    if (p.status != two_view_status::reconstructed) { return; }
    bool const homography = c.ratio > static_cast<double>(params.homography_ratio);
    if (c.sample[homography ? 0 : 1] < 0) {
      c.status = two_view_status::no_model;
      return;
    }
    c.model = homography ? two_view_model::homography : two_view_model::fundamental;
  }

  template <typename Group, typename Error>
  FT_HOST_DEVICE static int mark_inliers(Group g, int pair, two_view_workspace const& w,
                                         Error const& error, two_view_params const& params) {
    std::ptrdiff_t const from = std::ptrdiff_t{pair} * w.capacity;
    wide const weight = try_sample::weight_of(params);
    int count = 0;
    for (int i = g.rank(); i < w.prepared[pair].matches; i += g.size()) {
      bool const both = agreement_with(error, w.matched[from + i], weight).both;
      w.inlier[from + i] = static_cast<std::uint8_t>(both);
      count += static_cast<int>(both);
    }
    return g.reduce(count, sum_op{});
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
