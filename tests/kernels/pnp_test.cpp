// SPDX-License-Identifier: Apache-2.0
// Poses from pixels and points: known poses, the rule read plainly over many calls, batches, bits,
// and input that has no pose.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <random>
#include <vector>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/kernels/pnp/solve_pnp.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/pnp_scene.hpp"

namespace pnp_test {

using ft::pnp_status;
using test::at;
using test::make_pnp_scene;
using test::pnp_scene;
using test::pnp_scene_params;

template <typename Exec>
using batch = test::pnp_batch<Exec>;

/// Squared error of correspondence i, pixels^2, in double. Behind a pinhole camera, too.
template <typename Camera>
double error2(Camera const& camera, ft::rigid<double> const& T_cw, pnp_scene const& s, int i) {
  auto seen = T_cw * s.point[at(i)].cast<double>();
  constexpr bool mirrored = std::is_same<Camera, ft::pinhole<double>>::value;
  if (mirrored && seen.z < 0) { seen = -seen; }
  auto const p = camera.project(seen).pixel;
  double const x = p.x - static_cast<double>(s.pixel[at(i)].x);
  double const y = p.y - static_cast<double>(s.pixel[at(i)].y);
  return x * x + y * y;
}
/// Inliers must be those of the pose, but where the error is within rounding of the limit.
template <typename Camera>
void expect_inliers(Camera const& camera, ft::pnp_result const& r, pnp_scene const& s,
                    std::vector<std::uint8_t> const& inlier) {
  int count = 0;
  for (int i = 0; i < s.size(); ++i) {
    double const limit = static_cast<double>(s.max_error2[at(i)]);
    double const e = error2(camera, r.T_cw.cast<double>(), s, i);
    if (std::abs(e - limit) > 0.02 * limit) { EXPECT_EQ(inlier[at(i)] != 0, e < limit) << i; }
    count += inlier[at(i)];
  }
  EXPECT_EQ(r.inliers, count);
}
void expect_pose(ft::pose const& got, ft::rigid<double> const& want, double angle, double metres) {
  EXPECT_LT(test::angle_between_rotations(got.cast<double>().R, want.R), angle);
  auto const d = got.cast<double>().t - want.t;
  EXPECT_LT(std::sqrt(dot(d, d)), metres);
}

template <typename Backend>
class Pnp : public test::on_backend<Backend> {
protected:
  Backend backend;

  template <typename Camera>
  void expect_known_poses(Camera const& camera, pnp_scene_params const& params, unsigned seed) {
    std::mt19937 random(seed);
    std::vector<pnp_scene> scenes;
    for (int k = 0; k < 8; ++k) { scenes.push_back(make_pnp_scene(random, camera, params)); }
    batch<typename Backend::exec_type> b(backend.exec, scenes, {});
    ft::pnp_rays(backend.exec, camera, b.problems());
    ft::solve_pnp(backend.exec, camera, b.problems(), {}, b.results(), b.work());
    for (int k = 0; k < 8; ++k) {
      ASSERT_EQ(b.result(k).status, pnp_status::found);
      EXPECT_GT(b.result(k).inliers, scenes[at(k)].size() / 2);
      expect_inliers(camera, b.result(k), scenes[at(k)], b.inliers(k));
    }
    ft::refine_pnp(backend.exec, camera, b.problems(), b.results(), b.results(), b.work());
    for (int k = 0; k < 8; ++k) {
      SCOPED_TRACE(k);
      auto const& s = scenes[at(k)];
      expect_inliers(camera, b.result(k), s, b.inliers(k));
      auto const inlier = b.inliers(k);
      for (int i = 0; i < s.size(); ++i) { EXPECT_EQ(inlier[at(i)], s.good[at(i)]) << i; }
      // Pixels are rounded to 3e-5.
      expect_pose(b.result(k).T_cw, s.T_cw, 1e-6 + 0.003 * params.noise,
                  1e-5 + 0.03 * params.noise);
    }
  }
};
TYPED_TEST_SUITE(Pnp, test::backends);

TYPED_TEST(Pnp, finds_poses_that_are_known) {
  pnp_scene_params params;
  this->expect_known_poses(test::pnp_camera(), params, 1);
  this->expect_known_poses(test::pnp_fisheye(), params, 2);
}
TYPED_TEST(Pnp, finds_poses_among_outliers) {
  pnp_scene_params params;
  params.points = 150;
  params.outliers = 0.3;
  this->expect_known_poses(test::pnp_camera(), params, 3);
  params.outliers = 0.2;
  params.noise = 0.3;
  params.points = 300;
  this->expect_known_poses(test::pnp_camera(), params, 4);
}
TYPED_TEST(Pnp, finds_poses_before_a_plane_of_the_world) {
  pnp_scene_params params;
  params.plane = true;
  params.outliers = 0.1;
  this->expect_known_poses(test::pnp_camera(), params, 5);
  this->expect_known_poses(test::pnp_fisheye(), params, 6);
}
TYPED_TEST(Pnp, counts_points_behind_a_pinhole_camera) {
  pnp_scene_params params;
  params.points = 60;
  params.behind = 0.15;
  std::mt19937 random(7);
  auto const camera = test::pnp_camera();
  auto const s = make_pnp_scene(random, camera, params);
  batch<typename TypeParam::exec_type> b(this->backend.exec, {s}, {});
  ft::pnp_rays(this->backend.exec, camera, b.problems());
  ft::solve_pnp(this->backend.exec, camera, b.problems(), {}, b.results(), b.work());
  ASSERT_EQ(b.result(0).status, pnp_status::found);
  expect_pose(b.result(0).T_cw, s.T_cw, 1e-4, 1e-3);
  expect_inliers(camera, b.result(0), s, b.inliers(0));
  int behind = 0;
  auto const inlier = b.inliers(0);
  for (int i = 0; i < s.size(); ++i) {
    behind += static_cast<int>(inlier[at(i)] != 0 &&
                               (s.T_cw * s.point[at(i)].template cast<double>()).z < 0);
  }
  EXPECT_GT(behind, 0);
}

// ---- the rule -----------------------------------------------------------------------------------

struct plain_limits {
  int m, K;
};
plain_limits limits_of(int n, ft::pnp_params const& p) {
  int const m = std::max(static_cast<int>(static_cast<float>(n) * p.min_share), p.min_inliers);
  if (n <= m) { return {m, 1}; }
  auto const e =
      static_cast<double>(std::max(p.min_share, static_cast<float>(m) / static_cast<float>(n)));
  double const k = std::ceil(std::log(1 - p.confidence) / std::log(1 - e * e * e));
  return {m, std::clamp(static_cast<int>(std::min(k, 1e6)), 1, p.max_iterations)};
}

TEST(PnpLimits, are_those_of_the_formula) {
  std::vector<ft::pnp_params> all(4);
  all[1].min_share = 0.2f;
  all[2].confidence = 0.999;
  all[2].min_inliers = 6;
  all[3].min_share = 0.15f;
  all[3].max_iterations = 5000;
  for (auto const& p : all) {
    for (int n = 1; n < 3000; ++n) {
      auto const got = ft::pnp_limits_of(n, p);
      auto const want = limits_of(n, p);
      ASSERT_EQ(got.inliers, want.m) << n;
      ASSERT_EQ(got.iterations, want.K) << n;
      ASSERT_LE(got.iterations, ft::pnp_hypotheses(p)) << n;
    }
  }
  EXPECT_EQ(ft::pnp_limits_of(20, {}).iterations, 35);
  EXPECT_EQ(ft::pnp_limits_of(10, {}).iterations, 1);
  EXPECT_EQ(ft::pnp_limits_of(9, {}).inliers, 10);
}

/// One call as the rule says it, hypothesis by hypothesis.
struct plain_ransac {
  plain_limits limits;
  std::vector<int> counts;
  int done = 0;
  int kept = -1;

  struct answer {
    bool pose, no_more;
    int hypothesis;
  };
  answer call(int iterations) {
    int in_call = 0;
    while (done < limits.K || in_call < iterations) {
      int const h = done;
      ++done;
      ++in_call;
      int const c = counts.at(at(h));
      if (c >= limits.m && (kept < 0 || c > counts[at(kept)])) { kept = h; }
      if (c > limits.m) { return {true, false, h}; }
    }
    return {kept >= 0, true, kept};
  }
};

TYPED_TEST(Pnp, calls_go_on_as_the_rule_does_one_after_the_other) {
  auto const& exec = this->backend.exec;
  auto const camera = test::pnp_camera();
  std::mt19937 random(8);
  ft::pnp_params params;
  ft::pnp_params long_call = params;  // as many hypotheses at once
  long_call.iterations_of_call = 160;
  std::vector<pnp_scene> scenes;
  for (int const n : {10, 11, 12, 15, 20, 30, 60}) {
    for (double const outliers : {0.0, 0.2, 0.45}) {
      pnp_scene_params p;
      p.points = n;
      p.outliers = outliers;
      p.noise = 0.8;
      scenes.push_back(make_pnp_scene(random, camera, p));
    }
  }
  batch<typename TypeParam::exec_type> all(exec, scenes, long_call);
  batch<typename TypeParam::exec_type> b(exec, scenes, params);
  ft::pnp_rays(exec, camera, all.problems());
  ft::pnp_rays(exec, camera, b.problems());
  ft::solve_pnp(exec, camera, all.problems(), long_call, all.results(), all.work());
  std::vector<plain_ransac> rules;
  for (int k = 0; k < static_cast<int>(scenes.size()); ++k) {
    rules.push_back({limits_of(scenes[at(k)].size(), params), all.counts(k)});
  }
  ft::start_pnp(exec, b.work());
  int seen[4] = {0, 0, 0, 0};
  for (int call = 0; call < 20; ++call) {
    ft::continue_pnp(exec, camera, b.problems(), params, b.results(), b.work());
    for (int k = 0; k < static_cast<int>(scenes.size()); ++k) {
      SCOPED_TRACE(std::to_string(k) + " call " + std::to_string(call));
      auto const got = b.result(k);
      auto const want = rules[at(k)].call(params.iterations_of_call);
      ASSERT_EQ(ft::has_pose(got.status), want.pose);
      ASSERT_EQ(ft::no_more(got.status), want.no_more);
      ASSERT_EQ(got.done, rules[at(k)].done);
      ASSERT_EQ(got.inliers, want.pose ? rules[at(k)].counts[at(want.hypothesis)] : 0);
      auto const T = want.pose ? all.poses(k)[at(want.hypothesis)].template cast<float>()
                               : ft::pose::identity();
      ASSERT_EQ(std::memcmp(&got.T_cw, &T, sizeof T), 0);
      expect_inliers(camera, got, scenes[at(k)], b.inliers(k));
      ++seen[static_cast<int>(got.status)];
    }
  }
  // All kinds of answers, some of them far behind the plan.
  EXPECT_GT(seen[static_cast<int>(pnp_status::found)], 50);
  EXPECT_GT(seen[static_cast<int>(pnp_status::exhausted)], 10);
  EXPECT_GT(seen[static_cast<int>(pnp_status::no_pose)], 10);
}

/// Everything that a run leaves, as bytes.
template <typename Exec>
std::vector<std::vector<unsigned char>> run(Exec const& exec, std::vector<pnp_scene> const& scenes,
                                            bool fisheye, int capacity) {
  batch<Exec> b(exec, scenes, {}, capacity);
  std::vector<std::vector<unsigned char>> out(scenes.size());
  auto const add = [](std::vector<unsigned char>& to, auto const* data, std::size_t count) {
    auto const* const bytes = reinterpret_cast<unsigned char const*>(data);
    to.insert(to.end(), bytes, bytes + count * sizeof *data);
  };
  auto const collect = [&] {
    for (int k = 0; k < static_cast<int>(scenes.size()); ++k) {
      auto const result = b.result(k);
      auto const inlier = b.inliers(k);
      add(out[at(k)], &result, 1);
      add(out[at(k)], inlier.data(), at(scenes[at(k)].size()));
      for (int i = scenes[at(k)].size(); i < b.problems().capacity; ++i) {
        EXPECT_EQ(inlier[at(i)], 0);
      }
    }
  };
  auto const solve = [&](auto const& camera) {
    ft::pnp_rays(exec, camera, b.problems());
    ft::start_pnp(exec, b.work());
    for (int call = 0; call < 3; ++call) {
      ft::continue_pnp(exec, camera, b.problems(), {}, b.results(), b.work());
      collect();
    }
    ft::refine_pnp(exec, camera, b.problems(), b.results(), b.results(), b.work());
    collect();
    for (int k = 0; k < static_cast<int>(scenes.size()); ++k) {
      int const known = std::min(ft::pnp_limits_of(scenes[at(k)].size(), {}).iterations, 35);
      if (scenes[at(k)].size() < 10) { continue; }
      add(out[at(k)], b.counts(k).data(), at(known));
      add(out[at(k)], b.poses(k).data(), at(known));
    }
  };
  if (fisheye) {
    solve(test::pnp_fisheye());
  } else {
    solve(test::pnp_camera());
  }
  return out;
}

std::vector<pnp_scene> mixed_scenes(bool fisheye) {
  std::mt19937 random(9);
  std::vector<pnp_scene> scenes;
  for (int const n : {100, 0, 9, 10, 31, 33, 12, 64, 200, 1}) {
    pnp_scene_params p;
    p.points = n;
    p.outliers = 0.35;
    p.noise = 0.5;
    p.plane = n == 64;
    scenes.push_back(fisheye ? make_pnp_scene(random, test::pnp_fisheye(), p)
                             : make_pnp_scene(random, test::pnp_camera(), p));
  }
  auto& poisoned = scenes[5];
  poisoned.point[3].x = std::numeric_limits<float>::quiet_NaN();
  poisoned.pixel[7].y = std::numeric_limits<float>::quiet_NaN();
  poisoned.point[11].z = std::numeric_limits<float>::infinity();
  return scenes;
}

TYPED_TEST(Pnp, a_batch_has_the_bits_of_single_problems_and_of_the_host) {
  for (bool const fisheye : {false, true}) {
    auto const scenes = mixed_scenes(fisheye);
    auto const together = run(this->backend.exec, scenes, fisheye, 0);
    ft::host_exec const host(1);
    for (std::size_t k = 0; k < scenes.size(); ++k) {
      auto const alone =
          run(host, {scenes[k]}, fisheye, scenes[k].size() + 3 * static_cast<int>(k));
      EXPECT_EQ(together[k], alone[0]) << k;
    }
  }
}

TYPED_TEST(Pnp, leaves_problems_alone_that_are_not_active) {
  auto const& exec = this->backend.exec;
  auto const camera = test::pnp_camera();
  std::mt19937 random(10);
  pnp_scene_params p;
  p.outliers = 0.3;
  std::vector<pnp_scene> scenes;
  for (int k = 0; k < 3; ++k) { scenes.push_back(make_pnp_scene(random, camera, p)); }
  batch<typename TypeParam::exec_type> b(exec, scenes, {});
  ft::pnp_rays(exec, camera, b.problems());
  ft::solve_pnp(exec, camera, b.problems(), {}, b.results(), b.work());
  auto const before = b.result(1);
  auto const mask = b.inliers(1);
  auto const active = test::to_exec(exec, std::vector<int>{1, 0, 1});
  b.problems().active = active.data();
  ft::continue_pnp(exec, camera, b.problems(), {}, b.results(), b.work());
  ft::refine_pnp(exec, camera, b.problems(), b.results(), b.results(), b.work());
  auto const after = b.result(1);
  EXPECT_EQ(std::memcmp(&before, &after, sizeof before), 0);
  EXPECT_EQ(mask, b.inliers(1));
  EXPECT_GT(b.result(0).done, 1);
  EXPECT_GT(b.result(2).done, 1);
  // And goes on later where it was.
  b.problems().active = nullptr;
  ft::continue_pnp(exec, camera, b.problems(), {}, b.results(), b.work());
  EXPECT_GT(b.result(1).done, before.done);
}

// ---- bad input ----------------------------------------------------------------------------------

TYPED_TEST(Pnp, gives_no_pose_where_there_is_none) {
  auto const& exec = this->backend.exec;
  auto const camera = test::pnp_camera();
  std::mt19937 random(11);
  pnp_scene_params p;
  p.points = 40;
  std::vector<pnp_scene> scenes(8, make_pnp_scene(random, camera, p));
  float const nan = std::numeric_limits<float>::quiet_NaN();
  for (int i = 0; i < 40; ++i) {
    auto const f = static_cast<float>(i);
    scenes[0].point[at(i)] = {nan, nan, nan};
    scenes[1].pixel[at(i)] = {nan, nan};
    scenes[2].point[at(i)] = {1.0f, 2.0f, 3.0f};                      // all the same
    scenes[3].point[at(i)] = {0.0f, 0.0f, 0.0f};                      // the origin
    scenes[4].point[at(i)] = {0.1f * f, 0.2f * f + 1.0f, -0.3f * f};  // a line; pixels are not
    scenes[5].point[at(i)] = {1e38f, -1e38f, 1e38f * (f - 20.0f) / 20.0f};
    scenes[6].max_error2[at(i)] = nan;
    scenes[7].max_error2[at(i)] = -1.0f;
  }
  batch<typename TypeParam::exec_type> b(exec, scenes, {});
  ft::pnp_rays(exec, camera, b.problems());
  ft::solve_pnp(exec, camera, b.problems(), {}, b.results(), b.work());
  for (int k = 0; k < 8; ++k) {
    auto const r = b.result(k);
    EXPECT_EQ(r.status, pnp_status::no_pose) << k;
    EXPECT_EQ(r.inliers, 0) << k;
    EXPECT_EQ(r.done, 35) << k;
    EXPECT_EQ(r.T_cw.R.m[0], 1.0f) << k;
    auto const inlier = b.inliers(k);
    EXPECT_EQ(std::count(inlier.begin(), inlier.end(), 0), 40) << k;
  }
  // Nothing to refine: nothing changes.
  ft::refine_pnp(exec, camera, b.problems(), b.results(), b.results(), b.work());
  EXPECT_EQ(b.result(2).status, pnp_status::no_pose);
  EXPECT_EQ(b.result(2).T_cw.t.x, 0.0f);
}

TYPED_TEST(Pnp, takes_counts_for_what_they_can_be) {
  auto const& exec = this->backend.exec;
  auto const camera = test::pnp_camera();
  std::mt19937 random(12);
  auto const s = make_pnp_scene(random, camera, {});
  batch<typename TypeParam::exec_type> b(exec, {s, s, s, s}, {});
  ft::pnp_rays(exec, camera, b.problems());
  b.put(b.problems().count, std::vector<int>{-5, 9, 2000000000, 100});
  ft::solve_pnp(exec, camera, b.problems(), {}, b.results(), b.work());
  for (int k = 0; k < 2; ++k) {
    EXPECT_EQ(b.result(k).status, pnp_status::too_few);
    EXPECT_EQ(b.result(k).done, 0);
    EXPECT_EQ(b.result(k).inliers, 0);
  }
  auto const a = b.result(2);
  auto const c = b.result(3);
  EXPECT_EQ(a.status, pnp_status::found);
  EXPECT_EQ(std::memcmp(&a, &c, sizeof a), 0);
}

TEST(PnpEdges, refuse_what_does_not_fit) {
  ft::host_exec const exec(1);
  auto const camera = test::pnp_camera();
  std::mt19937 random(13);
  batch<ft::host_exec> b(exec, {make_pnp_scene(random, camera, {})}, {});
  ft::pnp_rays(exec, camera, b.problems());
  auto const solve = [&](ft::pnp_params const& params, ft::pnp_results_view const& results,
                         ft::pnp_workspace const& work) {
    ft::solve_pnp(exec, camera, b.problems(), params, results, work);
  };
  EXPECT_NO_THROW(solve({}, b.results(), b.work()));
  ft::pnp_params params;
  params.min_inliers = 5;
  EXPECT_THROW(solve(params, b.results(), b.work()), ft::bad_argument);
  params = {};
  params.min_share = 1.5f;
  EXPECT_THROW(solve(params, b.results(), b.work()), ft::bad_argument);
  params.min_share = 0.3f;  // more hypotheses than there is memory for
  EXPECT_THROW(solve(params, b.results(), b.work()), ft::bad_argument);
  auto results = b.results();
  results.capacity += 1;
  EXPECT_THROW(solve({}, results, b.work()), ft::bad_argument);
  auto work = b.work();
  work.problems = 2;
  EXPECT_THROW(solve({}, b.results(), work), ft::bad_argument);
  ft::carver c;
  ft::pnp_problems_view many;
  EXPECT_THROW(carve(c, many, 1 << 20, 1 << 20), ft::bad_argument);
  EXPECT_THROW(carve(c, many, -1, 10), ft::bad_argument);
  // No problems: nothing to do.
  batch<ft::host_exec> none(exec, {}, {});
  EXPECT_NO_THROW(ft::solve_pnp(exec, camera, none.problems(), {}, none.results(), none.work()));
}

}  // namespace pnp_test
