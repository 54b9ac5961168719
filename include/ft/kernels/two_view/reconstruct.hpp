// SPDX-License-Identifier: Apache-2.0
/// @file Stage: the motion between two images of one camera, and points, from matched keypoints:
/// how a map starts with one camera. Source: Mur-Artal, Montiel and Tardos, "ORB-SLAM: a versatile
/// and accurate monocular SLAM system", T-RO 2015, section IV.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/two_view/detail/check_motions.hpp"
#include "ft/kernels/two_view/detail/try_samples.hpp"
#include "ft/kernels/two_view/problem.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

// Third step of a reconstruction from two views: the best homography and fundamental matrix,
// the choice between them, and the motions that the model leaves possible. Source of the choice:
// Mur-Artal, Montiel and Tardos, "ORB-SLAM: a versatile and accurate monocular SLAM system", T-RO
// 2015, section IV.

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
    strict_mat3d M{};
    if (found) {
      std::ptrdiff_t const at =
          homography ? c.sample[0] : std::ptrdiff_t{params.samples} + c.sample[1];
      M = w.model[first + at].cast<real64>();
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
    real64 const H = c.score[0];
    real64 const F = c.score[1];
    bool const any = H + F > real64(0.0);
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
    real64 const weight = try_sample::weight_of(params);
    int count = 0;
    for (int i = g.rank(); i < w.prepared[pair].matches; i += g.size()) {
      bool const both = agreement_with(error, w.matched[from + i], weight).both;
      w.inlier[from + i] = static_cast<std::uint8_t>(both);
      count += static_cast<int>(both);
    }
    return g.reduce(count, sum_op{});
  }
};

/// The motion with most points.
struct motion_choice {
  two_view_status status;
  int motion;  ///< the first of equals
};

/// Last step. Item: a pair of images.
struct finish_pair {
  struct scratch {
    motion_choice taken;
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int pair, two_view_params const& params,
                                 two_view_workspace const& w,
                                 two_view_reconstructions const& out) const {
    std::ptrdiff_t const from = std::ptrdiff_t{pair} * w.capacity;
    for (int i = g.rank(); i < w.capacity; i += g.size()) {
      out.point[from + i] = {0, 0, 0};
      out.flags[from + i] = 0;
    }
    if (g.rank() == 0) {
      s.taken = choose(w.chosen[pair], w.checked + std::ptrdiff_t{w.most_motions} * pair, params);
      out.result[pair] = describe(s.taken, pair, w);
    }
    g.sync();  // also before keypoints that other threads have cleared are written
    if (w.chosen[pair].model == two_view_model::none) { return; }
    bool const made = s.taken.status == two_view_status::reconstructed;
    checked_point const* const points =
        w.point + (std::ptrdiff_t{w.most_motions} * pair + s.taken.motion) * w.capacity;
    for (int i = g.rank(); i < w.prepared[pair].matches; i += g.size()) {
      std::ptrdiff_t const to = from + w.keypoint[from + i];
      unsigned flags = w.inlier[from + i] != 0 ? two_view_flag::inlier : 0u;
      if (made && points[i].key != no_point_key) {
        out.point[to] = points[i].X;
        flags |= two_view_flag::point;
        if (check_motion::is_triangulated(points[i])) { flags |= two_view_flag::triangulated; }
      }
      out.flags[to] = static_cast<std::uint8_t>(flags);
    }
  }

private:
  FT_HOST_DEVICE static motion_choice choose(chosen_model const& c, checked_motion const* checked,
                                             two_view_params const& params) {
    int at = 0;
    for (int k = 1; k < c.motions; ++k) {
      if (checked[k].points > checked[at].points) { at = k; }
    }
    if (c.status != two_view_status::reconstructed) { return {c.status, at}; }
    int const best = checked[at].points;
    double const share = mul(0.9, static_cast<double>(c.inliers));
    bool const homography = c.model == two_view_model::homography;
    bool const enough = homography ? best > params.min_points && best > share
                                   : best >= max_of(static_cast<int>(share), params.min_points);
    if (!enough) { return {two_view_status::too_few_points, at}; }
    for (int k = 0; k < c.motions; ++k) {
      double const points = checked[k].points;
      bool const rival =
          homography ? points >= mul(0.75, double(best)) : points > mul(0.7, double(best));
      if (k != at && rival) { return {two_view_status::ambiguous, at}; }
    }
    float const parallax = checked[at].parallax;
    bool const wide_enough =
        homography ? parallax >= params.min_parallax_deg : parallax > params.min_parallax_deg;
    return {wide_enough ? two_view_status::reconstructed : two_view_status::little_parallax, at};
  }

  FT_HOST_DEVICE static two_view_result describe(motion_choice const& taken, int pair,
                                                 two_view_workspace const& w) {
    chosen_model const& c = w.chosen[pair];
    two_view_result r{};
    r.status = taken.status;
    r.model = c.model;
    r.T_21 = pose::identity();
    r.matches = w.prepared[pair].matches;
    r.inliers = c.inliers;
    r.score_H = static_cast<float>(c.score[0]);
    r.score_F = static_cast<float>(c.score[1]);
    r.ratio = static_cast<float>(c.ratio);
    r.sample_H = c.sample[0];
    r.sample_F = c.sample[1];
    r.motions = c.motions;
    std::ptrdiff_t const first = std::ptrdiff_t{w.most_motions} * pair;
    for (int k = 0; k < c.motions; ++k) {
      r.points_of[k] = w.checked[first + k].points;
      r.parallax_of[k] = w.checked[first + k].parallax;
    }
    if (c.motions > 0) { r.parallax = r.parallax_of[taken.motion]; }
    mat3<double> const* const models = w.model + std::ptrdiff_t{2} * pair * w.samples;
    if (r.sample_H >= 0) { r.H_21 = models[r.sample_H].cast<float>(); }
    if (r.sample_F >= 0) { r.F_21 = models[w.samples + r.sample_F].cast<float>(); }
    if (taken.status == two_view_status::reconstructed) {
      r.T_21 = w.motion[first + taken.motion].cast<float>();
      r.points = w.checked[first + taken.motion].points;
      r.triangulated = w.checked[first + taken.motion].triangulated;
    }
    return r;
  }
};

}  // namespace detail

/// Reconstructs a batch of pairs of images. Translations have length 1.
///
/// Samples of eight matches make homographies and fundamental matrices. A match adds to the score
/// of a model what its squared errors, in units of their variance, are below a limit, in both
/// images. The model with the better score says which motions are possible; that which puts most of
/// the matches in front of both cameras is taken, if no other one comes near and the rays are not
/// almost parallel. Good points whose rays are almost parallel are among the points, but not
/// triangulated.
///
/// Bad input has a status of its own (two_view_status). Keypoints without a match count in the
/// normalisation of pixels, so they must be finite. Computed in double; the same bits on every
/// executor. Asynchronous on `exec`; allocates nothing; five launches.
/// @throws bad_argument for null views, other shapes than the workspace's, or parameters out of
///   range
template <typename Exec>
void reconstruct_two_views(Exec const& exec, two_view_input const& in,
                           two_view_params const& params, two_view_reconstructions const& out,
                           two_view_workspace const& workspace) {
  detail::require_two_views(in, params, out, workspace);
  int const pairs = in.first.batch;
  for_each_item<per_block<sum_lanes>>(exec, pairs, detail::prepare_pair{}, in, workspace);
  for_each_item<per_warp>(exec, 2 * pairs * params.samples, detail::try_sample{}, in, params,
                          workspace);
  for_each_item<per_block<256>>(exec, pairs, detail::choose_model{}, in, params, workspace);
  for_each_item<per_block<256>>(exec, pairs * workspace.most_motions, detail::check_motion{}, in,
                                params, workspace);
  for_each_item<per_block<256>>(exec, pairs, detail::finish_pair{}, params, workspace, out);
}

}  // namespace FT_ABI
}  // namespace ft
