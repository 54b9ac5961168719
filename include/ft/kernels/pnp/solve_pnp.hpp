// SPDX-License-Identifier: Apache-2.0
/// @file Stage: poses of cameras from pixels and points of which many do not belong together, by
/// RANSAC with MLPnP.
///
/// The rule is one of turns: a call tries samples one after the other until a pose has enough
/// inliers, and the next call goes on behind it. Here all samples of a call are tried at once, and
/// the first one with enough inliers is chosen afterwards, which gives the same answers. Sources:
/// Fischler and Bolles, "Random sample consensus", CACM 1981; Urban, Leitloff and Hinz, "MLPnP: a
/// real-time maximum likelihood solution to the perspective-n-point problem", ISPRS Annals 2016;
/// Mur-Artal, Montiel and Tardos, "ORB-SLAM", T-RO 2015, section V-E.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <type_traits>

#include "ft/cameras/camera_model.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/pnp/detail/refine_pose.hpp"
#include "ft/kernels/pnp/problem.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/relocalization.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Writes which correspondences agree with a pose; without one, none. Returns their number.
template <typename Group, typename Camera>
FT_HOST_DEVICE int mark_inliers(Group g, Camera const& camera, rigid<double> const* T_cw,
                                pnp_problem const& from, span<std::uint8_t> const& out) {
  int count = 0;
  rigid<real64> const T =
      T_cw == nullptr ? rigid<real64>::identity() : T_cw->template cast<real64>();
  FT_NO_UNROLL
  for (int i = g.rank(); i < out.size; i += g.size()) {
    bool const in = T_cw != nullptr && i < from.count && is_inlier(camera, T, from, i);
    out[i] = static_cast<std::uint8_t>(in);
    count += static_cast<int>(in);
  }
  return g.reduce(count, sum_op{});
}

/// Item: a problem. Goes through its hypotheses as one call of the rule does.
template <typename Camera>
struct choose_hypothesis {
  using scratch = no_scratch;
  Camera camera;  ///< of strict_float
  pnp_params params;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, pnp_problems_view const& problems,
                                 pnp_results_view const& out, pnp_workspace const& work) const {
    if (!problems.is_active(b)) { return; }
    pnp_problem const from = problems.of(b);
    pnp_limits const limits = pnp_limits_of(from.count, params);
    pnp_state state = work.state[b];
    pnp_result result{pose::identity(), 0, 0, pnp_status::too_few};
    rigid<double> T_cw;
    if (from.count >= limits.inliers) {
      int const end = needed_hypotheses(state, limits, params);
      int const winner = advance(g, work, b, end, limits.inliers, state);
      result.status = winner >= 0              ? pnp_status::found
                      : state.kept_inliers > 0 ? pnp_status::exhausted
                                               : pnp_status::no_pose;
      T_cw = winner >= 0 ? work.T_cw[work.slot(b, winner)] : state.kept;
      state.evaluated = end;
    }
    bool const any = has_pose(result.status);
    if (any) { result.T_cw = T_cw.template cast<float>(); }
    result.done = state.done;
    result.inliers =
        mark_inliers(g, camera, any ? &T_cw : nullptr, from,
                     {out.inlier + static_cast<std::ptrdiff_t>(b) * out.capacity, out.capacity});
    g.sync();  // all have read the state
    if (g.rank() == 0) {
      work.state[b] = state;
      out.result[b] = result;
    }
  }

private:
  /// Moves the state behind the first hypothesis before `end` with more than `limit` inliers, or to
  /// `end`. Keeps the hypothesis with the most inliers, at least `limit`, the first of equals.
  /// Returns the number of that first one, or -1.
  template <typename Group>
  FT_HOST_DEVICE static int advance(Group g, pnp_workspace const& work, int b, int end, int limit,
                                    pnp_state& state) {
    int winner = -1;
    unsigned long long best = 0;  // inliers, then the earlier one
    FT_NO_UNROLL
    for (int base = state.done; base < end && winner < 0; base += g.size()) {
      int const h = base + g.rank();
      int const count = h < end ? work.inliers[work.slot(b, h)] : 0;
      unsigned const winners = g.ballot(count > limit);
      if (winners != 0) { winner = base + trailing_zeros(winners); }
      if (count >= limit && (winner < 0 || h <= winner)) {
        auto const later = static_cast<unsigned>(h - state.done);
        best = max_of(best, static_cast<unsigned long long>(count) << 32 | (~later & 0xffffffffu));
      }
    }
    best = g.reduce(best, max_op{});
    int const most = static_cast<int>(best >> 32);
    if (most > state.kept_inliers) {
      int const h = state.done + static_cast<int>(~static_cast<unsigned>(best));
      state.kept_inliers = most;
      state.kept = work.T_cw[work.slot(b, h)];
    }
    state.done = winner < 0 ? end : winner + 1;
    return winner;
  }
};

/// Item: a correspondence.
template <typename Camera>
struct unproject_correspondence {
  using scratch = no_scratch;
  Camera camera;  ///< of strict_float

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item,
                                 pnp_problems_view const& problems) const {
    int const b = item / problems.capacity;
    if (!problems.is_active(b) || item - problems.at(b) >= problems.count[b]) { return; }
    vec2<float> const at = problems.pixel[item];
    problems.ray[item] =
        camera.unproject({at.x, at.y}).direction.template cast<float>().template cast<double>();
  }
};

inline void require_pnp(pnp_problems_view const& problems, pnp_results_view const& results) {
  require(problems.problems == 0 || (problems.count != nullptr && problems.seed != nullptr),
          "the pose problems are null");
  require(problems.problems == 0 || results.result != nullptr, "the results of poses are null");
  if (results.problems != problems.problems || results.capacity != problems.capacity) {
    throw bad_argument("ft: results for " + std::to_string(results.problems) + " x " +
                       std::to_string(results.capacity) + " correspondences, must be for " +
                       std::to_string(problems.problems) + " x " +
                       std::to_string(problems.capacity));
  }
}
inline void require_pnp(pnp_problems_view const& problems, pnp_workspace const& work) {
  if (work.problems != problems.problems || work.capacity != problems.capacity) {
    throw bad_argument("ft: working memory for " + std::to_string(work.problems) + " x " +
                       std::to_string(work.capacity) + " correspondences, must be for " +
                       std::to_string(problems.problems) + " x " +
                       std::to_string(problems.capacity));
  }
}

}  // namespace detail

/// Rays of the pixels, in strict float, with z = 1 where the camera model gives that. Asynchronous
/// on `exec`; allocates nothing; one launch.
/// @param problems `ray` is written, of active problems up to their counts
template <typename Exec, typename Camera>
void pnp_rays(Exec const& exec, Camera const& camera, pnp_problems_view const& problems) {
  auto const strict_camera = camera.template cast<strict_float>();
  for_each_item<per_thread>(
      exec, problems.problems * problems.capacity,
      detail::unproject_correspondence<std::decay_t<decltype(strict_camera)>>{strict_camera},
      problems);
}

/// Begins a batch of problems: no iteration is done. Asynchronous on `exec`; allocates nothing.
template <typename Exec>
void start_pnp(Exec const& exec, pnp_workspace const& work) {
  fill_bytes(exec, work.state, 0, static_cast<std::size_t>(work.problems) * sizeof *work.state);
}

/// The next call for each active problem: its first hypothesis, from where the call before ended,
/// with more inliers than max(min_share * count, min_inliers), with status `found`. After as many
/// iterations as are planned, but at least `iterations_of_call` of this call, it ends without: then
/// the pose is the one with the most inliers of all calls so far, if these are as many as that
/// limit, even if a call has returned it before. Further calls try `iterations_of_call` more each.
///
/// An inlier is seen, in float, at a squared distance below its max_error2. As in the reference, a
/// point behind a pinhole camera may be one, and the pose is that of six correspondences: it is not
/// improved by the others (refine_pnp() does that).
///
/// Fewer correspondences than the limit: too_few. A NaN, or points without a pose (fewer than four
/// different ones, a line), give hypotheses without inliers.
///
/// Asynchronous on `exec`; allocates nothing; two launches: a warp per hypothesis, a warp per
/// problem. Equal bits on every executor.
/// @param camera model of the pixels; its scalar does not matter
/// @param problems with rays: see pnp_rays()
/// @param out results of active problems
/// @param work kept since start_pnp(); made for these parameters, or for more iterations
/// @throws bad_argument naming the argument, its value and the limit
template <typename Exec, typename Camera>
void continue_pnp(Exec const& exec, Camera const& camera, pnp_problems_view const& problems,
                  pnp_params const& params, pnp_results_view const& out,
                  pnp_workspace const& work) {
  check(params);
  detail::require_pnp(problems, out);
  detail::require_pnp(problems, work);
  detail::require_range("hypotheses that a call may need", pnp_hypotheses(params), 1,
                        work.hypotheses);
  auto const strict_camera = camera.template cast<strict_float>();
  using camera_type = std::decay_t<decltype(strict_camera)>;
  for_each_item<per_warp>(exec, problems.problems * work.hypotheses,
                          detail::evaluate_hypothesis<camera_type>{strict_camera, params}, problems,
                          work);
  for_each_item<per_warp>(exec, problems.problems,
                          detail::choose_hypothesis<camera_type>{strict_camera, params}, problems,
                          out, work);
}

/// The first pose of each problem: start_pnp() and continue_pnp().
template <typename Exec, typename Camera>
void solve_pnp(Exec const& exec, Camera const& camera, pnp_problems_view const& problems,
               pnp_params const& params, pnp_results_view const& out, pnp_workspace const& work) {
  start_pnp(exec, work);
  continue_pnp(exec, camera, problems, params, out, work);
}

// Stage: poses from all inliers of a RANSAC's poses. Source: Urban, Leitloff and Hinz,
// "MLPnP: a real-time maximum likelihood solution to the perspective-n-point problem", ISPRS
// Annals 2016, without covariances.

namespace detail {

/// Item: a problem.
template <typename Camera>
struct refine_from_inliers {
  using scratch = mlpnp_scratch;
  Camera camera;  ///< of strict_float

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, pnp_problems_view const& problems,
                                 pnp_results_view const& coarse, pnp_results_view const& out,
                                 pnp_workspace const& work) const {
    if (!problems.is_active(b)) { return; }
    pnp_problem const from = problems.of(b);
    std::ptrdiff_t const first = problems.at(b);
    int* const listed = work.listed + first;
    std::uint8_t const* const inlier = coarse.inlier + first;
    int n = 0;
    FT_NO_UNROLL
    for (int base = 0; base < from.count; base += g.size()) {
      int const i = base + g.rank();
      bool const in = i < from.count && inlier[i] != 0;
      int more = 0;
      int const place = n + g.exclusive_count(in, more);
      if (in) { listed[place] = i; }
      n += more;
    }
    g.sync();
    pnp_result result = coarse.result[b];
    pnp_pose found{};
    found.valid = false;
    if (n >= pnp_sample) { found = mlpnp(g, s, {from.ray, from.point, listed, n}); }
    std::uint8_t* const marked = out.inlier + first;
    if (found.valid) {
      result.T_cw = found.T_cw.template cast<float>();
      result.inliers = mark_inliers(g, camera, &found.T_cw, from, {marked, out.capacity});
    } else {
      for (int i = g.rank(); i < out.capacity; i += g.size()) { marked[i] = inlier[i]; }
    }
    g.sync();  // all have read the coarse result
    if (g.rank() == 0) { out.result[b] = result; }
  }
};

}  // namespace detail

/// The pose of each active problem from all its inliers by MLPnP, and the inliers of that pose.
/// Status and number of iterations stay; with fewer than six inliers, or if they give no pose, the
/// pose stays, too. The reference does not use such a pose. Asynchronous on `exec`; allocates
/// nothing; one launch, a warp per problem. Equal bits on every executor.
/// @param camera model of the pixels; its scalar does not matter
/// @param coarse results of solve_pnp() or continue_pnp()
/// @param out may be `coarse`
/// @throws bad_argument for views of other shapes
template <typename Exec, typename Camera>
void refine_pnp(Exec const& exec, Camera const& camera, pnp_problems_view const& problems,
                pnp_results_view const& coarse, pnp_results_view const& out,
                pnp_workspace const& work) {
  detail::require_pnp(problems, coarse);
  detail::require_pnp(problems, out);
  detail::require_pnp(problems, work);
  auto const strict_camera = camera.template cast<strict_float>();
  for_each_item<per_warp>(
      exec, problems.problems,
      detail::refine_from_inliers<std::decay_t<decltype(strict_camera)>>{strict_camera}, problems,
      coarse, out, work);
}

}  // namespace FT_ABI
}  // namespace ft
