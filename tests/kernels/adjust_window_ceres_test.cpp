// SPDX-License-Identifier: Apache-2.0
// Bundle adjustment of windows against Ceres Solver, on noisy observations with outliers: the same
// cost functions, written out again and differentiated automatically.
#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

#include "ft/kernels/window/adjust_window.hpp"
#include "tests/support/window_scene.hpp"

namespace adjust_window_ceres_test {

using test::motion;
using test::window_scene;

/// Weighted errors of an observation: two of a pixel, or one of a disparity.
template <typename Rig>
struct sighting {
  Rig rig;
  ft::window_observation seen;
  int camera;
  bool disparity;
  double scale;  ///< root of the weight

  template <typename T>
  bool operator()(T const* view, T const* point, T* error) const {
    T x[3];
    ceres::AngleAxisRotatePoint(view, point, x);
    ft::vec3<T> const p{x[0] + view[3], x[1] + view[4], x[2] + view[5]};
    auto const image = test::image_of(rig, p, camera);
    double const u = static_cast<double>(seen.x);
    double const v = static_cast<double>(seen.y);
    if (disparity) {
      error[0] = scale * (image.x - image.right_x - (u - static_cast<double>(seen.right_x)));
    } else {
      error[0] = scale * (image.x - u);
      error[1] = scale * (image.y - v);
    }
    return true;
  }
};

/// Weighted errors of a link: three of rotation, three of translation.
struct link_term {
  ft::window_link link;

  template <typename T>
  bool operator()(T const* before, T const* now, T* error) const {
    using matrix = ft::mat3<T>;
    auto const rotation = [](T const* view) {
      T c[9];  // Ceres' matrices are column-major
      ceres::AngleAxisToRotationMatrix(view, c);
      return matrix{{c[0], c[3], c[6], c[1], c[4], c[7], c[2], c[5], c[8]}};
    };
    auto const widen = [](double v) { return T(v); };
    matrix M;
    std::transform(link.motion.R.m, link.motion.R.m + 9, M.m, widen);
    auto const c = link.motion.centre();
    matrix const R_i = rotation(before).transposed();
    matrix const R_j = rotation(now);
    matrix const A = R_i * (M.transposed() * R_j);
    ft::vec3<T> const C_i = -(R_i * ft::vec3<T>{before[3], before[4], before[5]});
    ft::vec3<T> const C_j = -(R_j.transposed() * ft::vec3<T>{now[3], now[4], now[5]});
    ft::vec3<T> const d = C_j - C_i - R_i * ft::vec3<T>{T(c.x), T(c.y), T(c.z)};
    T const turn(std::sqrt(link.rotation_weight) / 2);
    T const shift(std::sqrt(link.translation_weight));
    error[0] = turn * (A.m[7] - A.m[5]);
    error[1] = turn * (A.m[2] - A.m[6]);
    error[2] = turn * (A.m[3] - A.m[1]);
    error[3] = shift * d.x;
    error[4] = shift * d.y;
    error[5] = shift * d.z;
    return true;
  }
};

struct solution {
  std::vector<motion> T_cw;
  std::vector<ft::vec3<double>> position;
};

/// The window as a problem of Ceres: dense Schur complement, until nothing is gained.
template <typename Rig>
solution solve_by_ceres(Rig const& rig, window_scene const& s, ft::window_params const& params) {
  std::vector<std::array<double, 6>> views;
  std::vector<std::array<double, 3>> points;
  for (auto const& T : s.T_cw) {
    views.emplace_back();
    auto const& m = T.R.m;  // Ceres' matrices are column-major
    double const R[9] = {m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]};
    ceres::RotationMatrixToAngleAxis(R, views.back().data());
    views.back()[3] = T.t.x;
    views.back()[4] = T.t.y;
    views.back()[5] = T.t.z;
  }
  for (auto const& X : s.position) { points.push_back({X.x, X.y, X.z}); }

  ceres::Problem problem;
  auto const add = [&](int p, int v, int c, bool disparity) {
    auto const& o = s.seen[s.at(p, v, c)];
    double const weight =
        static_cast<double>(o.inv_sigma2) * (disparity ? params.disparity_weight : 1);
    auto* const term = new sighting<Rig>{rig, o, c, disparity, std::sqrt(weight)};
    ceres::CostFunction* const cost =
        disparity ? static_cast<ceres::CostFunction*>(
                        new ceres::AutoDiffCostFunction<sighting<Rig>, 1, 6, 3>(term))
                  : new ceres::AutoDiffCostFunction<sighting<Rig>, 2, 6, 3>(term);
    problem.AddResidualBlock(cost, new ceres::HuberLoss(std::sqrt(params.huber2)),
                             views[static_cast<std::size_t>(v)].data(),
                             points[static_cast<std::size_t>(p)].data());
  };
  for (int p = 0; p < s.points(); ++p) {
    for (int v = 0; v < s.views(); ++v) {
      for (int c = 0; c < s.cameras; ++c) {
        auto const& o = s.seen[s.at(p, v, c)];
        if (!(o.inv_sigma2 > 0)) { continue; }
        add(p, v, c, false);
        if (o.right_x >= 0) { add(p, v, c, true); }
      }
    }
  }
  for (std::size_t v = 1; v < s.links.size(); ++v) {
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<link_term, 6, 6, 6>(new link_term{s.links[v]}), nullptr,
        views[v - 1].data(), views[v].data());
  }
  for (int v = 0; v < s.fixed; ++v) {
    double* const view = views[static_cast<std::size_t>(v)].data();
    if (problem.HasParameterBlock(view)) { problem.SetParameterBlockConstant(view); }
  }
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.max_num_iterations = 400;
  options.function_tolerance = 1e-15;
  options.gradient_tolerance = 1e-14;
  options.parameter_tolerance = 1e-14;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  EXPECT_TRUE(summary.IsSolutionUsable()) << summary.message;

  solution found;
  for (auto const& v : views) {
    double R[9];
    ceres::AngleAxisToRotationMatrix(v.data(), R);
    found.T_cw.push_back(
        {{{R[0], R[3], R[6], R[1], R[4], R[7], R[2], R[5], R[8]}}, {v[3], v[4], v[5]}});
  }
  for (auto const& x : points) { found.position.push_back({x[0], x[1], x[2]}); }
  return found;
}

inline double distance(ft::vec3<double> a, ft::vec3<double> b) {
  auto const d = a - b;
  return std::sqrt(ft::dot(d, d));
}

/// Both descents end close to one minimum. A cost that is above it by a share e of a unit leaves
/// the parameters within about sqrt(e) of their uncertainty, which here is some millimetres for a
/// view, centimetres for a point and metres for a point whose observations contradict each other.
/// Sums of costs are exact to about 1e-11, so views agree to 1e-6 m and points to 1e-4 m.
template <typename Rig>
void compare(test::window_shape const& shape, unsigned seed, bool linked = false) {
  auto const rig = test::example_rig<Rig>();
  auto s = test::make_window(rig, shape, seed);
  if (linked) { test::link_views(s, 0.01, seed); }
  ft::window_params params;
  params.steps = 200;
  params.enough = 0;
  auto const own = test::adjust(ft::host_exec(1), rig, {s}, params).front();
  ASSERT_EQ(own.outcome.valid, 1);
  auto const want = solve_by_ceres(rig, s, params);
  double const least = test::judge(rig, s, want.T_cw, want.position).cost;
  EXPECT_NEAR(own.outcome.last_cost, least, 1e-9 * least) << seed;
  double worst_view = 0;
  for (std::size_t v = 0; v < s.T_cw.size(); ++v) {
    worst_view = std::max(worst_view, distance(own.T_cw[v].centre(), want.T_cw[v].centre()));
  }
  EXPECT_LT(worst_view, 1e-6) << seed;
  double worst_point = 0;
  for (std::size_t p = 0; p < s.position.size(); ++p) {
    int views = 0;
    for (int v = 0; v < s.views(); ++v) {
      views += s.seen[s.at(static_cast<int>(p), v, 0)].inv_sigma2 > 0;
    }
    if (views < 3) { continue; }
    worst_point = std::max(worst_point, distance(own.position[p], want.position[p]));
  }
  EXPECT_LT(worst_point, 1e-4) << seed;
}

TEST(AdjustWindowCeres, RectifiedPairsAgree) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    compare<ft::rectified_rig>({8, 2, 200, 8, 0.7, 0.03, 1.0, 6}, seed);
  }
  compare<ft::rectified_rig>({2, 1, 60, 2, 0.7}, 5);
  compare<ft::rectified_rig>({12, 4, 300, 10, 1.0, 0.05, 1.0, 7}, 6);
}

TEST(AdjustWindowCeres, FisheyePairsAgree) {
  for (unsigned seed = 11; seed <= 14; ++seed) {
    compare<test::fisheye_rig>({8, 2, 200, 8, 0.7, 0.03, 1.0, 6}, seed);
  }
  compare<test::fisheye_rig>({3, 1, 60, 3, 0.7, 0, 1.0, 3}, 15);
}

TEST(AdjustWindowCeres, LinkedViewsAgree) {
  for (unsigned seed = 31; seed <= 33; ++seed) {
    compare<ft::rectified_rig>({8, 2, 200, 8, 0.7, 0.03, 1.0, 6}, seed, true);
    compare<test::fisheye_rig>({8, 1, 200, 8, 0.7, 0.03, 1.0, 6}, seed + 10, true);
  }
}

/// With the default number of steps most of what can be gained is gained.
TEST(AdjustWindowCeres, FewStepsAreNearTheMinimum) {
  auto const rig = test::example_rig<ft::rectified_rig>();
  for (unsigned seed = 21; seed <= 23; ++seed) {
    auto const s = test::make_window(rig, {10, 4, 300, 7, 0.7, 0.03}, seed);
    auto const want = solve_by_ceres(rig, s, {});
    double const least = test::judge(rig, s, want.T_cw, want.position).cost;
    auto const own = test::adjust(ft::host_exec(1), rig, {s}, {}).front();
    EXPECT_LE(own.outcome.steps, ft::window_params{}.steps);
    EXPECT_LT(own.outcome.last_cost - least, 0.02 * (own.outcome.first_cost - least));
  }
}

}  // namespace adjust_window_ceres_test
