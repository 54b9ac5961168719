// SPDX-License-Identifier: Apache-2.0
// Reconstruction from two views: known scenes, a plain reading of scores, choices and checks, input
// that has no answer, batches.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <random>
#include <set>
#include <vector>

#include "ft/kernels/two_view/reconstruct.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"
#include "tests/support/two_view_scene.hpp"

namespace two_view_test {

using ft::two_view_flag;
using ft::two_view_model;
using ft::two_view_status;
using test::at;
using test::make_two_views;
using test::reconstruct;
using test::scene_kind;
using test::two_view_outcome;
using test::two_view_scene;
using vec3d = ft::vec3<double>;

double length(vec3d v) { return std::sqrt(dot(v, v)); }

template <typename Backend>
class TwoViews : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(TwoViews, test::backends);

/// Largest relative error of points with a depth, in units of the distance between the cameras.
double worst_point(two_view_outcome const& got, two_view_scene const& scene) {
  double worst = 0;
  double const unit = 1 / length(scene.T_21.t);
  for (std::size_t i = 0; i < got.points.size(); ++i) {
    if ((got.flags[i] & two_view_flag::triangulated) == 0) { continue; }
    vec3d const X = scene.X[i];
    vec3d const want{X.x * unit, X.y * unit, X.z * unit};
    worst = std::max(worst, length(got.points[i].cast<double>() - want) / length(want));
  }
  return worst;
}
int count_flags(two_view_outcome const& got, unsigned flag) {
  return static_cast<int>(std::count_if(got.flags.begin(), got.flags.end(),
                                        [&](unsigned f) { return (f & flag) != 0; }));
}

TYPED_TEST(TwoViews, FindTheMotionAndThePointsOfAScene) {
  TypeParam backend;
  std::mt19937 random(1);
  std::vector<two_view_scene> scenes;
  for (int i = 0; i < test::effort(8); ++i) {
    scenes.push_back(make_two_views(random, {scene_kind::general, 150 + 20 * i, 0, 0, 10 * i}));
  }
  auto const got = reconstruct(backend.exec, scenes);
  for (std::size_t i = 0; i < scenes.size(); ++i) {
    auto const& r = got[i].result;
    ASSERT_EQ(r.status, two_view_status::reconstructed) << i;
    EXPECT_EQ(r.model, two_view_model::fundamental);
    EXPECT_EQ(r.matches, 150 + 20 * static_cast<int>(i));
    EXPECT_EQ(r.inliers, r.matches);
    EXPECT_EQ(r.points, r.matches);
    EXPECT_EQ(r.motions, 4);
    EXPECT_GT(r.parallax, 1.0f);
    // Pixels are rounded to 3e-5, as floats.
    EXPECT_LT(test::rotation_error(r.T_21, scenes[i].T_21), 1e-3);
    EXPECT_LT(test::direction_error(r.T_21, scenes[i].T_21), 5e-3);
    EXPECT_NEAR(length(r.T_21.t.template cast<double>()), 1, 1e-6);
    EXPECT_LT(worst_point(got[i], scenes[i]), 1e-3);
    EXPECT_EQ(count_flags(got[i], two_view_flag::inlier), r.inliers);
    EXPECT_EQ(count_flags(got[i], two_view_flag::point), r.points);
    EXPECT_EQ(count_flags(got[i], two_view_flag::triangulated), r.triangulated);
    for (std::size_t k = 0; k < got[i].points.size(); ++k) {
      if (scenes[i].match[k] >= 0) { continue; }
      EXPECT_EQ(got[i].flags[k], 0u);
      EXPECT_EQ(length(got[i].points[k].template cast<double>()), 0);
    }
  }
}

TYPED_TEST(TwoViews, FindTheMotionAndThePointsOfAPlane) {
  TypeParam backend;
  std::mt19937 random(2);
  std::vector<two_view_scene> scenes;
  for (int i = 0; i < 12; ++i) {  // most are ambiguous
    scenes.push_back(make_two_views(random, {scene_kind::plane, 150 + 20 * i, 0, 0, 10 * i}));
  }
  ft::two_view_params params;
  params.homography_ratio = 0.45f;  // of planes both scores are almost equal
  auto const got = reconstruct(backend.exec, scenes, params);
  int made = 0;
  for (std::size_t i = 0; i < scenes.size(); ++i) {
    auto const& r = got[i].result;
    EXPECT_EQ(r.model, two_view_model::homography);
    EXPECT_EQ(r.inliers, r.matches);
    EXPECT_EQ(r.motions, 8);
    // The motion itself is always among the possible ones.
    double nearest = 1e9;
    for (auto const& m : got[i].motions) {
      auto const T = m.template cast<float>();
      nearest = std::min(nearest, test::rotation_error(T, scenes[i].T_21) +
                                      test::direction_error(T, scenes[i].T_21));
    }
    EXPECT_LT(nearest, 1e-2) << i;
    if (r.status == two_view_status::ambiguous) { continue; }  // some planes have two solutions
    ASSERT_EQ(r.status, two_view_status::reconstructed) << i;
    ++made;
    EXPECT_LT(test::rotation_error(r.T_21, scenes[i].T_21), 5e-3);
    EXPECT_LT(test::direction_error(r.T_21, scenes[i].T_21), 1e-2);
    EXPECT_EQ(r.points, r.matches);
    EXPECT_LT(worst_point(got[i], scenes[i]), 1e-3);
  }
  EXPECT_GE(made, 1);
}

TYPED_TEST(TwoViews, WithstandNoiseAndWrongMatches) {
  TypeParam backend;
  std::mt19937 random(3);
  std::vector<two_view_scene> scenes;
  for (int i = 0; i < test::effort(6); ++i) {
    scenes.push_back(make_two_views(random, {scene_kind::general, 400, 0.15, 5 * i, 50}));
  }
  auto const got = reconstruct(backend.exec, scenes);
  std::size_t made = 0;
  for (std::size_t i = 0; i < scenes.size(); ++i) {
    auto const& r = got[i].result;
    EXPECT_EQ(r.model, two_view_model::fundamental);
    // A model of eight noisy matches may have no motion that suits most of them.
    if (r.status == two_view_status::too_few_points) { continue; }
    ASSERT_EQ(r.status, two_view_status::reconstructed) << i;
    ++made;
    EXPECT_LT(test::rotation_error(r.T_21, scenes[i].T_21), 2.0);
    EXPECT_LT(test::direction_error(r.T_21, scenes[i].T_21), 10.0);
    // Wrong matches are near an epipolar line by chance only.
    int right = 0;
    int wrong = 0;
    for (std::size_t k = 0; k < got[i].flags.size(); ++k) {
      if (scenes[i].match[k] < 0) { continue; }
      auto const p = scenes[i].second[at(scenes[i].match[k])];
      auto const q = test::project(scenes[i].camera, scenes[i].T_21 * scenes[i].X[k]);
      bool const good = std::hypot(p.x - q.x, p.y - q.y) < 3;
      bool const inlier = (got[i].flags[k] & two_view_flag::inlier) != 0;
      right += static_cast<int>(inlier && good);
      wrong += static_cast<int>(inlier && !good);
    }
    EXPECT_GT(right, 250) << i;
    EXPECT_LT(wrong, 25) << i;
  }
  EXPECT_GE(2 * made, scenes.size());
}

// ---- a plain reading of the rules ---------------------------------------------------------------

vec3d times(ft::mat3<double> const& M, vec3d v) { return M * v; }
double point_distance2(vec3d a, vec3d b) {
  return std::pow(a.x / a.z - b.x, 2) + std::pow(a.y / a.z - b.y, 2);
}
double line_distance2(vec3d line, vec3d p) {
  return std::pow(dot(line, p), 2) / (line.x * line.x + line.y * line.y);
}
/// By the formula with minors.
ft::mat3<double> plain_inverse(ft::mat3<double> const& M) {
  auto const& m = M.m;
  double const det = m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) +
                     m[2] * (m[3] * m[7] - m[4] * m[6]);
  ft::mat3<double> r{
      {m[4] * m[8] - m[5] * m[7], m[2] * m[7] - m[1] * m[8], m[1] * m[5] - m[2] * m[4],
       m[5] * m[6] - m[3] * m[8], m[0] * m[8] - m[2] * m[6], m[2] * m[3] - m[0] * m[5],
       m[3] * m[7] - m[4] * m[6], m[1] * m[6] - m[0] * m[7], m[0] * m[4] - m[1] * m[3]}};
  for (double& v : r.m) { v /= det; }
  return r;
}

struct plain_score {
  double sum = 0;
  double doubt = 0;  ///< what errors next to a limit may change
  int inliers = 0;
};
plain_score score_plainly(two_view_scene const& s, ft::mat3<double> const& M, bool homography,
                          double sigma) {
  plain_score score;
  double const limit = homography ? 5.991 : 3.841;
  auto const inverse = plain_inverse(M);
  for (std::size_t i = 0; i < s.match.size(); ++i) {
    if (s.match[i] < 0) { continue; }
    auto const p = s.first[i];
    auto const q = s.second[at(s.match[i])];
    vec3d const x1{static_cast<double>(p.x), static_cast<double>(p.y), 1};
    vec3d const x2{static_cast<double>(q.x), static_cast<double>(q.y), 1};
    double const errors[2] = {
        homography ? point_distance2(times(inverse, x2), x1)
                   : line_distance2(times(M.transposed(), x2), x1),
        homography ? point_distance2(times(M, x1), x2) : line_distance2(times(M, x1), x2)};
    bool both = true;
    for (double const e : errors) {
      double const c = e / (sigma * sigma);
      if (c <= limit) { score.sum += 5.991 - c; }
      both = both && c <= limit;
      if (std::abs(c - limit) < 1e-6) { score.doubt += 6; }
    }
    score.inliers += static_cast<int>(both);
  }
  return score;
}

TYPED_TEST(TwoViews, ScoreAsTheRuleSays) {
  TypeParam backend;
  std::mt19937 random(4);
  for (double const sigma : {1.0, 2.5}) {
    ft::two_view_params params;
    params.samples = 40;
    params.sigma_px = static_cast<float>(sigma);
    auto const scene = make_two_views(random, {scene_kind::plane, 120, 0.5, 20, 10});
    auto const got = reconstruct(backend.exec, {scene}, params)[0];
    int best[2] = {-1, -1};
    double top[2] = {0, 0};
    for (int k = 0; k < 80; ++k) {
      auto const want = score_plainly(scene, got.models[at(k)], k < 40, sigma);
      EXPECT_NEAR(got.scores[at(k)], want.sum, want.doubt + 1e-7 * want.sum + 1e-7) << k;
      if (got.scores[at(k)] > top[k / 40]) {
        top[k / 40] = got.scores[at(k)];
        best[k / 40] = k % 40;
      }
    }
    auto const& r = got.result;
    EXPECT_EQ(r.sample_H, best[0]);
    EXPECT_EQ(r.sample_F, best[1]);
    EXPECT_NEAR(static_cast<double>(r.ratio), top[0] / (top[0] + top[1]), 1e-6);
    bool const homography = top[0] / (top[0] + top[1]) > 0.5;
    EXPECT_EQ(r.model, homography ? two_view_model::homography : two_view_model::fundamental);
    auto const& model = got.models[at(homography ? best[0] : 40 + best[1])];
    EXPECT_EQ(r.inliers, score_plainly(scene, model, homography, sigma).inliers);
  }
}

TYPED_TEST(TwoViews, MakeSingularFundamentalMatrices) {
  TypeParam backend;
  std::mt19937 random(5);
  ft::two_view_params params;
  params.samples = 30;
  auto const scene = make_two_views(random, {scene_kind::general, 60, 3.0, 30, 5});
  auto const got = reconstruct(backend.exec, {scene}, params)[0];
  for (int k = 0; k < 30; ++k) {
    auto const& m = got.models[at(30 + k)].m;
    // Of matrices with columns of length 1, so that pixels do not matter.
    double sizes = 1;
    for (int c = 0; c < 3; ++c) { sizes *= length({m[c], m[3 + c], m[6 + c]}); }
    double const det = m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) +
                       m[2] * (m[3] * m[7] - m[4] * m[6]);
    EXPECT_LT(std::abs(det), 1e-12 * sizes) << k;
    EXPECT_GT(sizes, 0) << k;
  }
}

/// The good points of a motion, and their parallax, from the points that the stage triangulated.
TYPED_TEST(TwoViews, CheckPointsAsTheRuleSays) {
  TypeParam backend;
  std::mt19937 random(6);
  for (int round = 0; round < test::effort(6); ++round) {
    bool const plane = round % 2 == 1;
    auto const scene = make_two_views(
        random, {plane ? scene_kind::plane : scene_kind::general, 90 + 40 * round, 0.7, 10, 10});
    ft::two_view_params params;
    params.homography_ratio = plane ? -1.0f : 2.0f;
    auto const got = reconstruct(backend.exec, {scene}, params)[0];
    auto const n = at(got.result.matches);
    ASSERT_EQ(got.result.motions, plane ? 8 : 4);
    for (int k = 0; k < got.result.motions; ++k) {
      auto const& T = got.motions[at(k)];
      vec3d const centre = T.centre();
      std::vector<double> cosines;
      std::size_t j = 0;
      for (std::size_t i = 0; i < scene.match.size(); ++i) {
        if (scene.match[i] < 0) { continue; }
        auto const& p = got.checked[at(k) * n + j++];
        if ((got.flags[i] & two_view_flag::inlier) == 0) {
          EXPECT_EQ(p.key, ft::detail::no_point_key);
          continue;
        }
        vec3d const X = p.X.template cast<double>();
        vec3d const X2 = T * X;
        double const c = dot(X, X - centre) / (length(X) * length(X - centre));
        auto const q1 = test::project(scene.camera, X);
        auto const q2 = test::project(scene.camera, X2);
        auto const& s1 = scene.first[i];
        auto const& s2 = scene.second[at(scene.match[i])];
        double const error =
            std::max(std::hypot(q1.x - s1.x, q1.y - s1.y), std::hypot(q2.x - s2.x, q2.y - s2.y));
        bool const close = std::abs(error - 2) < 1e-3 || std::abs(c - 0.99998) < 1e-7 ||
                           std::abs(X.z) < 1e-3 || std::abs(X2.z) < 1e-3 || length(X) > 1e5;
        bool const good = p.key != ft::detail::no_point_key;
        if (good) { cosines.push_back(c); }
        if (close) { continue; }
        EXPECT_EQ(good, error <= 2 && (c >= 0.99998 || (X.z > 0 && X2.z > 0))) << k << " " << i;
      }
      EXPECT_EQ(got.result.points_of[k], static_cast<int>(cosines.size()));
      std::sort(cosines.begin(), cosines.end());
      double const want =
          cosines.empty()
              ? 0.0
              : std::acos(std::min(1.0, cosines[std::min<std::size_t>(50, cosines.size() - 1)])) *
                    57.29577951308232;
      EXPECT_NEAR(static_cast<double>(got.result.parallax_of[k]), want, 1e-4 + 0.02 / (1 + want));
    }
  }
}

/// What becomes of the motions that were checked.
two_view_status decide_plainly(ft::two_view_result const& r, ft::two_view_params const& params) {
  if (r.motions == 0) { return two_view_status::no_motion; }
  std::vector<int> points(r.points_of, r.points_of + r.motions);
  auto const best = std::max_element(points.begin(), points.end());
  float const parallax = r.parallax_of[best - points.begin()];
  std::vector<int> others;
  for (auto p = points.begin(); p != points.end(); ++p) {
    if (p != best) { others.push_back(*p); }
  }
  int const second = *std::max_element(others.begin(), others.end());
  if (r.model == two_view_model::homography) {
    if (!(*best > params.min_points && *best > 0.9 * r.inliers)) {
      return two_view_status::too_few_points;
    }
    if (!(second < 0.75 * *best)) { return two_view_status::ambiguous; }
    return parallax >= params.min_parallax_deg ? two_view_status::reconstructed
                                               : two_view_status::little_parallax;
  }
  if (*best < std::max(static_cast<int>(0.9 * r.inliers), params.min_points)) {
    return two_view_status::too_few_points;
  }
  if (second > 0.7 * *best) { return two_view_status::ambiguous; }
  return parallax > params.min_parallax_deg ? two_view_status::reconstructed
                                            : two_view_status::little_parallax;
}

TYPED_TEST(TwoViews, DecideAsTheRuleSays) {
  TypeParam backend;
  std::mt19937 random(12);
  std::vector<two_view_scene> scenes;
  for (int i = 0; i < 30; ++i) {
    scene_kind const kinds[] = {scene_kind::general, scene_kind::plane, scene_kind::rotation};
    scenes.push_back(make_two_views(random, {kinds[i % 3], 60 + 2 * i, 0.1 * (i % 5), 10, 0}));
  }
  std::set<two_view_status> seen;
  for (float const ratio : {-1.0f, 0.5f, 2.0f}) {
    for (float const parallax : {1.0f, 7.0f}) {
      ft::two_view_params params;
      params.samples = 20;
      params.homography_ratio = ratio;
      params.min_parallax_deg = parallax;
      params.min_points = 40;
      for (auto const& got : reconstruct(backend.exec, scenes, params)) {
        auto const& r = got.result;
        seen.insert(r.status);
        EXPECT_EQ(r.status, decide_plainly(r, params));
        EXPECT_EQ(r.points, r.status == two_view_status::reconstructed
                                ? *std::max_element(r.points_of, r.points_of + r.motions)
                                : 0);
      }
    }
  }
  EXPECT_EQ(seen.count(two_view_status::reconstructed), 1u);
  EXPECT_EQ(seen.count(two_view_status::too_few_points), 1u);
  EXPECT_EQ(seen.count(two_view_status::ambiguous), 1u);
  EXPECT_EQ(seen.count(two_view_status::little_parallax), 1u);
}

// ---- no answer ----------------------------------------------------------------------------------

TYPED_TEST(TwoViews, OfARotationHaveNoReconstruction) {
  TypeParam backend;
  std::mt19937 random(7);
  for (double const noise : {0.0, 0.3}) {
    for (float const ratio : {-1.0f, 0.5f, 2.0f}) {
      auto const scene = make_two_views(random, {scene_kind::rotation, 300, noise, 5, 10});
      ft::two_view_params params;
      params.homography_ratio = ratio;
      auto const got = reconstruct(backend.exec, {scene}, params)[0];
      EXPECT_NE(got.result.status, two_view_status::reconstructed);
      EXPECT_EQ(count_flags(got, two_view_flag::point), 0);
      EXPECT_EQ(got.result.points, 0);
      EXPECT_EQ(length(got.result.T_21.t.template cast<double>()), 0);
    }
  }
}

/// Scenes that stay without a model, each with its status.
struct refused {
  two_view_scene scene;
  two_view_status status;
};
std::vector<refused> refused_scenes() {
  std::mt19937 random(8);
  auto const fresh = [&] { return make_two_views(random, {scene_kind::general, 100, 0, 0, 20}); };
  float const nan = std::numeric_limits<float>::quiet_NaN();
  float const infinity = std::numeric_limits<float>::infinity();
  std::vector<refused> all;
  auto const add = [&](two_view_status status, auto const& change) {
    all.push_back({fresh(), status});
    change(all.back().scene);
  };
  add(two_view_status::too_few_matches, [](auto& s) { s = {}; });
  add(two_view_status::too_few_matches,
      [](auto& s) { std::fill(s.match.begin() + 7, s.match.end(), -1); });
  add(two_view_status::too_few_matches,
      [](auto& s) { std::fill(s.match.begin(), s.match.end(), std::numeric_limits<int>::min()); });
  add(two_view_status::bad_match, [](auto& s) { s.match[40] = 120; });
  add(two_view_status::bad_match, [](auto& s) { s.match[119] = std::numeric_limits<int>::max(); });
  add(two_view_status::bad_camera, [](auto& s) { s.camera.fx = 0; });
  add(two_view_status::bad_camera, [&](auto& s) { s.camera.cy = nan; });
  add(two_view_status::bad_camera, [&](auto& s) { s.camera.fy = infinity; });
  add(two_view_status::not_finite, [&](auto& s) { s.first[110].x = nan; });  // has no match
  add(two_view_status::not_finite, [&](auto& s) { s.second[3].y = infinity; });
  add(two_view_status::degenerate, [](auto& s) {
    for (auto& p : s.first) { p = {100, 100}; }
  });
  add(two_view_status::degenerate, [](auto& s) {
    for (auto& p : s.second) { p.y = 33.3f; }
  });
  add(two_view_status::degenerate, [](auto& s) {
    for (auto& p : s.first) { p.y = 0.37f * p.x + 11; }
  });
  return all;
}

TYPED_TEST(TwoViews, OfBadInputHaveAStatus) {
  TypeParam backend;
  for (auto const& [scene, status] : refused_scenes()) {
    for (float const ratio : {-1.0f, 0.5f, 2.0f}) {
      ft::two_view_params params;
      params.homography_ratio = ratio;
      params.samples = 20;
      auto const got = reconstruct(backend.exec, {scene}, params)[0];
      EXPECT_EQ(got.result.status, status);
      EXPECT_EQ(got.result.model, two_view_model::none);
      EXPECT_EQ(got.result.sample_H, -1);
      EXPECT_EQ(got.result.inliers, 0);
      for (auto const f : got.flags) { EXPECT_EQ(f, 0u); }
    }
  }
}

TYPED_TEST(TwoViews, OfEightMatchesHaveTooFewPoints) {
  TypeParam backend;
  std::mt19937 random(9);
  auto const scene = make_two_views(random, {scene_kind::general, 8, 0, 0, 0});
  ft::two_view_params params;
  auto got = reconstruct(backend.exec, {scene}, params)[0];
  EXPECT_EQ(got.result.status, two_view_status::too_few_points);
  EXPECT_EQ(got.result.inliers, 8);
  params.min_points = 8;
  got = reconstruct(backend.exec, {scene}, params)[0];
  EXPECT_EQ(got.result.status, two_view_status::reconstructed);
  EXPECT_LT(test::rotation_error(got.result.T_21, scene.T_21), 1e-2);
}

TYPED_TEST(TwoViews, WithoutAnyAgreementHaveNoModel) {
  TypeParam backend;
  std::mt19937 random(10);
  auto const scene = make_two_views(random, {scene_kind::general, 12, 0, 100, 0});
  ft::two_view_params params;
  params.samples = 1;
  params.sigma_px = 1e-6f;
  params.homography_ratio = -1;
  // Eight wrong matches have no homography.
  auto const got = reconstruct(backend.exec, {scene}, params)[0];
  EXPECT_EQ(got.result.status, two_view_status::no_model);
  EXPECT_EQ(got.result.score_H, 0.0f);
  EXPECT_EQ(got.result.sample_H, -1);
}

// ---- batches and arguments ----------------------------------------------------------------------

template <typename T>
bool same_bits(std::vector<T> const& a, std::vector<T> const& b) {
  return a.size() == b.size() &&
         (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(T)) == 0);
}

TYPED_TEST(TwoViews, OfABatchAreThoseOfEachPair) {
  TypeParam backend;
  std::mt19937 random(11);
  std::vector<two_view_scene> scenes;
  auto const bad = refused_scenes();
  for (std::size_t i = 0; i < 5; ++i) {
    auto const kind = i % 2 == 0 ? scene_kind::general : scene_kind::plane;
    scenes.push_back(make_two_views(random, {kind, 100 + 30 * static_cast<int>(i), 0.4, 10, 5}));
    scenes.push_back(bad[2 * i].scene);
  }
  ft::two_view_params params;
  params.samples = 50;
  auto const together = reconstruct(backend.exec, scenes, params);
  for (std::size_t i = 0; i < scenes.size(); ++i) {
    auto const alone = reconstruct(backend.exec, {scenes[i]}, params)[0];
    EXPECT_EQ(std::memcmp(&together[i].result, &alone.result, sizeof alone.result), 0) << i;
    EXPECT_TRUE(same_bits(together[i].points, alone.points)) << i;
    EXPECT_TRUE(same_bits(together[i].flags, alone.flags)) << i;
    EXPECT_TRUE(same_bits(together[i].scores, alone.scores)) << i;
  }
}

TYPED_TEST(TwoViews, RefuseBadArguments) {
  TypeParam backend;
  using space = decltype(backend.exec);
  ft::soa<space::space, ft::field::x, ft::field::y> const first(10, 2);
  ft::soa<space::space, ft::field::x, ft::field::y> const second(12, 2);
  ft::buffer<int, space::space> const match(20);
  ft::buffer<ft::pinhole<float>, space::space> const cameras(2);
  ft::buffer<std::uint64_t, space::space> const seeds(2);
  ft::two_view_params const params;
  ft::owner<ft::two_view_reconstructions, space::space> const out(
      [](ft::carver& c, auto& v) { carve(c, v, 2, 10); });
  ft::owner<ft::two_view_workspace, space::space> const work(
      [](ft::carver& c, auto& v) { carve(c, v, 2, 10, 200); });
  ft::two_view_input const good{first.view(), second.view(), match.data(), cameras.data(),
                                seeds.data()};
  auto const refuses = [&](auto const& change) {
    auto in = good;
    auto p = params;
    auto o = out.view();
    auto w = work.view();
    change(in, p, o, w);
    EXPECT_THROW(ft::reconstruct_two_views(backend.exec, in, p, o, w), ft::bad_argument);
  };
  refuses([](auto& in, auto&, auto&, auto&) { in.match = nullptr; });
  refuses([](auto& in, auto&, auto&, auto&) { in.camera = nullptr; });
  refuses([](auto& in, auto&, auto&, auto&) { in.seed = nullptr; });
  refuses([](auto& in, auto&, auto&, auto&) { in.first = {}; });
  refuses([](auto& in, auto&, auto&, auto&) { in.second.batch = 1; });
  refuses([](auto&, auto& p, auto&, auto&) { p.samples = 0; });
  refuses([](auto&, auto& p, auto&, auto&) { p.samples = 199; });
  refuses([](auto&, auto& p, auto&, auto&) { p.sigma_px = std::nanf(""); });
  refuses([](auto&, auto& p, auto&, auto&) { p.homography_ratio = 3; });
  refuses([](auto&, auto& p, auto&, auto&) { p.min_points = 0; });
  refuses([](auto&, auto& p, auto&, auto&) { p.min_parallax_deg = -1; });
  refuses([](auto&, auto&, auto& o, auto&) { o = {}; });
  refuses([](auto&, auto&, auto& o, auto&) { o.capacity = 12; });
  refuses([](auto&, auto&, auto&, auto& w) { w = {}; });
  refuses([](auto&, auto&, auto&, auto& w) { w.pairs = 1; });
}

}  // namespace two_view_test
