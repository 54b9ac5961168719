// SPDX-License-Identifier: Apache-2.0
/// @file Poses from points and pixels by RANSAC: the problems, the rule's numbers, the results, and
/// the working memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/relocalization.hpp"

namespace ft {
inline namespace FT_ABI {

/// Correspondences of one problem.
struct pnp_problem {
  int count = 0;
  vec2<float> const* pixel = nullptr;
  vec3<float> const* point = nullptr;
  float const* max_error2 = nullptr;
  vec3<double> const* ray = nullptr;
};

/// A batch of problems: pixels of keypoints, and the points in the world that they may show. In
/// executor memory.
struct pnp_problems_view {
  int problems = 0;
  int capacity = 0;               ///< correspondences of a problem
  int* count = nullptr;           ///< [problems]; what exceeds the capacity is ignored
  std::uint64_t* seed = nullptr;  ///< [problems] of the samples
  /// [problems] 0: the stages leave this problem and its result as they are. Null: all are solved.
  /// Not placed by carve().
  int const* active = nullptr;

  vec2<float>* pixel = nullptr;  ///< [problems][capacity] undistorted
  vec3<float>* point = nullptr;  ///< [problems][capacity] in the world, metres
  float* max_error2 = nullptr;   ///< [problems][capacity] squared error of an inlier, pixels^2
  vec3<double>* ray = nullptr;   ///< [problems][capacity] of the pixel, any length: pnp_rays()
  int* keypoint = nullptr;       ///< [problems][capacity] for the caller; no solver reads it

  FT_HOST_DEVICE std::ptrdiff_t at(int problem) const {
    return static_cast<std::ptrdiff_t>(problem) * capacity;
  }
  FT_HOST_DEVICE bool is_active(int problem) const {
    return active == nullptr || active[problem] != 0;
  }
  FT_HOST_DEVICE pnp_problem of(int problem) const {
    std::ptrdiff_t const first = at(problem);
    return {clamp(count[problem], 0, capacity), pixel + first, point + first, max_error2 + first,
            ray + first};
  }
};
static_assert(std::is_trivially_copyable<pnp_problems_view>::value, "passed to kernels");

/// @throws bad_argument for a size below 0, or more correspondences than an int can count
inline void carve(carver& c, pnp_problems_view& v, int problems, int capacity) {
  constexpr int most = 1 << 30;
  detail::require_range("pose problems", problems, 0, most);
  detail::require_range("correspondences of a pose problem", capacity, 0, most);
  v.problems = problems;
  v.capacity = capacity;
  detail::require_items("pose problems", static_cast<std::size_t>(problems),
                        static_cast<std::size_t>(capacity));
  c.place({problems}, v.count, v.seed);
  c.place({problems, capacity}, v.pixel, v.point, v.max_error2, v.ray, v.keypoint);
}

/// Correspondences of a sample.
inline constexpr int pnp_sample = 6;

/// @throws bad_argument naming the value and the limit
inline void check(pnp_params const& p) {
  detail::require_range("min_inliers", p.min_inliers, pnp_sample, 1 << 30);
  detail::require_range("min_share", p.min_share, 0.0f, 1.0f);
  detail::require_range("confidence", p.confidence, 0.0, 1.0 - 1e-12);
  detail::require_range("max_iterations", p.max_iterations, 1, 1 << 20);
  detail::require_range("iterations_of_call", p.iterations_of_call, 1, 1 << 20);
}

/// Numbers of the rule for a number of correspondences.
struct pnp_limits {
  int inliers;     ///< a pose has more, to be returned at once, or as many, to be kept
  int iterations;  ///< planned
};

namespace detail {

/// ceil(log(1 - confidence) / log(1 - share^3)), limited: the fewest samples of which one is good
/// with that probability. By products, whose bits do not depend on a library.
FT_HOST_DEVICE inline int pnp_iterations(float share, pnp_params const& params) {
  strict_double const e = static_cast<double>(share);
  strict_double const bad = strict_double(1.0) - e * e * e;
  strict_double const wanted = 1.0 - params.confidence;
  strict_double rest = bad;
  int k = 1;
  for (; k < params.max_iterations && !(rest <= wanted); ++k) { rest *= bad; }
  return k;
}

}  // namespace detail

/// The rule's numbers. The cube of the share is the reference's, whose samples once were of three.
FT_HOST_DEVICE inline pnp_limits pnp_limits_of(int count, pnp_params const& params) {
  strict_float const n = static_cast<float>(count);
  int const m =
      max_of(static_cast<int>((n * strict_float(params.min_share)).value), params.min_inliers);
  if (count <= m) { return {m, 1}; }
  float const share = (strict_float(static_cast<float>(m)) / n).value;
  return {m, detail::pnp_iterations(max_of(params.min_share, share), params)};
}

enum class pnp_status : int {
  found,      ///< a hypothesis had more inliers than the limit; the next call seeks another one
  exhausted,  ///< no more: the best hypothesis with as many inliers as the limit, of all calls
  no_pose,    ///< no more, and none with as many
  too_few,    ///< no more: fewer correspondences than the limit; no pose
};
FT_HOST_DEVICE constexpr bool has_pose(pnp_status s) {
  return s == pnp_status::found || s == pnp_status::exhausted;
}
/// Whether the iterations that were planned are over.
FT_HOST_DEVICE constexpr bool no_more(pnp_status s) { return s != pnp_status::found; }

/// Answer of one call for one problem.
struct pnp_result {
  pose T_cw;          ///< the identity without a pose
  int inliers;        ///< 0 without a pose
  int done;           ///< iterations of all calls
  pnp_status status;  ///< of this call
};

struct pnp_results_view {
  int problems = 0;
  int capacity = 0;                ///< correspondences of a problem
  pnp_result* result = nullptr;    ///< [problems]
  std::uint8_t* inlier = nullptr;  ///< [problems][capacity] 1 for an inlier; without a pose all 0
};
static_assert(std::is_trivially_copyable<pnp_results_view>::value, "passed to kernels");

inline void carve(carver& c, pnp_results_view& v, int problems, int capacity) {
  v.problems = problems;
  v.capacity = capacity;
  c.place({problems}, v.result);
  c.place({problems, capacity}, v.inlier);
}

namespace detail {

/// What is kept of a problem between calls. All bytes 0: nothing is done.
struct pnp_state {
  int done;          ///< iterations that calls have gone through
  int evaluated;     ///< iterations whose hypotheses are known; at least `done`
  int kept_inliers;  ///< 0: no pose is kept
  rigid<double> kept;
};

}  // namespace detail

/// Working memory of the solver, in executor memory; kept between the calls for a batch. Hypothesis
/// h has slot h mod `hypotheses`.
struct pnp_workspace {
  int problems = 0;
  int capacity = 0;
  int hypotheses = 0;                  ///< of a problem: as many as one call may need
  detail::pnp_state* state = nullptr;  ///< [problems]
  rigid<double>* T_cw = nullptr;       ///< [problems][hypotheses]; NaN without a solution
  int* inliers = nullptr;              ///< [problems][hypotheses]
  int* listed = nullptr;               ///< [problems][capacity] inliers, of refine_pnp()

  FT_HOST_DEVICE std::ptrdiff_t slot(int problem, int h) const {
    return static_cast<std::ptrdiff_t>(problem) * hypotheses + h % hypotheses;
  }
};
static_assert(std::is_trivially_copyable<pnp_workspace>::value, "passed to kernels");

/// Hypotheses of a problem that one call may need.
inline int pnp_hypotheses(pnp_params const& params) {
  return max_of(detail::pnp_iterations(params.min_share, params), params.iterations_of_call);
}

/// @throws bad_argument for parameters out of range
inline void carve(carver& c, pnp_workspace& w, pnp_problems_view const& problems,
                  pnp_params const& params = {}) {
  check(params);
  w.problems = problems.problems;
  w.capacity = problems.capacity;
  w.hypotheses = pnp_hypotheses(params);
  detail::require_items("pose hypotheses", static_cast<std::size_t>(w.problems),
                        static_cast<std::size_t>(w.hypotheses));
  c.place({w.problems}, w.state);
  c.place({w.problems, w.hypotheses}, w.T_cw, w.inliers);
  c.place({w.problems, w.capacity}, w.listed);
}

}  // namespace FT_ABI
}  // namespace ft
