// SPDX-License-Identifier: Apache-2.0
// Graphs of poses with scales: derivatives, loops with a drift that is known, equal bits on both
// executors, starts, robust kernels, what a graph of rigid motions has in common with them.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <string>
#include <vector>

#include "ft/pipelines/pose_graph.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/effort.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/pose_graph_checks.hpp"
#include "tests/support/pose_graphs.hpp"
#include "tests/support/refusals.hpp"

namespace similarity_graph_test {

using ft::pose_graph_start;
using test::distance;
using test::make_similarity_graph;
using motion = ft::similarity<double>;

template <typename Backend>
class similarity_graphs : public test::on_backend<Backend> {
protected:
  Backend backend;

  ft::pose_graph_report optimize(ft::similarity_graph& graph, pose_graph_start start) {
    return test::optimize(backend.exec, graph, start);
  }
};
TYPED_TEST_SUITE(similarity_graphs, test::backends);

inline motion const& at(std::vector<motion> const& T, int i) {
  return T[static_cast<std::size_t>(i)];
}

/// Sum of e^T W e in plain numbers, with the quaternion by its half angle.
inline double plain_chi2(ft::similarity_graph const& graph) {
  double sum = 0;
  for (auto const& edge : graph.edges) {
    auto const& T = graph.T_world_pose;
    auto const D = edge.T_from_to.inverse() * (at(T, edge.from).inverse() * at(T, edge.to));
    auto const& m = D.R.m;
    double const w = std::sqrt(std::max(0.0, 1 + m[0] + m[4] + m[8])) / 2;
    double const e[7] = {D.t.x,
                         D.t.y,
                         D.t.z,
                         (m[7] - m[5]) / (4 * w),
                         (m[2] - m[6]) / (4 * w),
                         (m[3] - m[1]) / (4 * w),
                         std::log(D.scale)};
    for (int i = 0, own = 0; i < 7; ++i) {
      for (int j = i; j < 7; ++j) {
        sum += (i == j ? 1 : 2) * edge.information[own++] * e[i] * e[j];
      }
    }
  }
  return sum;
}

static_assert(ft::similarity_edge().information[0] == 1 &&
                  ft::similarity_edge().information[1] == 0 &&
                  ft::similarity_edge().information[27] == 1,
              "at first the identity");

TEST(SimilarityEdge, DerivativesAreThoseOfDifferences) {
  test::random_motions any(8);
  auto const scaled_motion = [&](double angle, double length) {
    auto const T = any(angle, length);
    return motion{T.R, T.t, std::exp(0.5 * any.number())};
  };
  double const h = 1e-6;
  int rounds = 0;
  for (int round = 0; round < 50; ++round) {
    ft::similarity_edge edge;
    edge.T_from_to = scaled_motion(0.8, 2);
    motion const T[2] = {scaled_motion(1, 3), scaled_motion(1, 3)};
    ft::detail::edge_error<motion> const here(edge, T[0], T[1]);
    if (here.q.w < ft::strict_double(0.1)) { continue; }  // the sign of the quaternion may change
    ++rounds;
    ft::strict_double J[2][49];
    ft::detail::edge_jacobians(here, J);
    for (int which = 0; which < 2; ++which) {
      for (int k = 0; k < 7; ++k) {
        auto const error_after = [&](double size) {
          double d[7] = {};
          d[k] = size;
          motion moved[2] = {T[0], T[1]};
          moved[which] =
              moved[which] *
              motion{test::turned_by({d[3], d[4], d[5]}), {d[0], d[1], d[2]}, std::exp(d[6])};
          return ft::detail::edge_error<motion>(edge, moved[0], moved[1]);
        };
        auto const after = error_after(h);
        auto const before = error_after(-h);
        for (int row = 0; row < 7; ++row) {
          double const want = (after.e[row].value - before.e[row].value) / (2 * h);
          EXPECT_NEAR(J[which][7 * row + k].value, want, 1e-8 * std::max(1.0, std::abs(want)))
              << which << ' ' << row << ' ' << k;
        }
      }
    }
  }
  EXPECT_GT(rounds, 30);
}

/// A graph whose measurements fit its truth.
inline test::generated_similarity_graph exact_graph(test::graph_shape const& shape, unsigned seed) {
  auto made = make_similarity_graph(shape, seed);
  for (auto& e : made.graph.edges) {
    e.T_from_to = (at(made.truth, e.from).inverse() * at(made.truth, e.to)).orthonormalized();
  }
  return made;
}

TYPED_TEST(similarity_graphs, exact_measurements_give_the_truth) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    auto made = exact_graph({60, 20}, seed);
    test::random_motions any(seed);
    for (std::size_t i = 1; i < made.truth.size(); ++i) {
      auto const noise = any(0.05, 0.1);
      made.graph.T_world_pose[i] =
          made.truth[i] * motion{noise.R, noise.t, std::exp(0.1 * any.number())};
    }
    for (auto const start :
         {pose_graph_start::given, pose_graph_start::odometry, pose_graph_start::chordal}) {
      auto graph = made.graph;
      auto const report = this->optimize(graph, start);
      EXPECT_TRUE(report.started);
      if (start != pose_graph_start::given) { EXPECT_LT(report.first_chi2, 1e-9); }
      for (std::size_t i = 0; i < made.truth.size(); ++i) {
        ASSERT_LT(distance(graph.T_world_pose[i], made.truth[i]), 1e-5) << seed << ' ' << i;
      }
    }
  }
}

TYPED_TEST(similarity_graphs, with_gravity_headings_positions_and_scales_become_the_truth) {
  ft::vec3<double> const up{0.6, 0, -0.8};
  auto made = exact_graph({60, 20}, 4);
  test::random_motions any(4);
  for (std::size_t i = 1; i < made.truth.size(); ++i) {
    double const turn = 0.2 * any.number();
    auto const& T = made.truth[i];
    made.graph.T_world_pose[i] =
        motion{test::turned_by({turn * up.x, turn * up.y, turn * up.z}) * T.R,
               T.t + any.vector(0.2), T.scale * std::exp(0.1 * any.number())}
            .orthonormalized();
  }
  ft::pose_graph_params params;
  params.gravity = {9.81 * up.x, 9.81 * up.y, 9.81 * up.z};
  ft::optimize_pose_graph(this->backend.exec, made.graph, params);
  for (std::size_t i = 0; i < made.truth.size(); ++i) {
    ASSERT_LT(distance(made.graph.T_world_pose[i], made.truth[i]), 1e-5) << i;
  }
}

/// A circle that one camera sees: each measured step is in units of the pose that it starts from,
/// which shrink by a hundredth a step, and odometry does not notice. The loop's measurement does.
struct drifting_circle {
  static constexpr int poses = 100;
  ft::similarity_graph graph;
  std::vector<motion> truth;

  drifting_circle() {
    double const pi = 3.141592653589793;
    for (int i = 0; i < poses; ++i) {
      double const a = 2 * pi * i / poses;
      truth.push_back(
          {test::turned_by({0, 0, a}), {20 * std::cos(a), 20 * std::sin(a), 0}, std::pow(0.99, i)});
    }
    graph.T_world_pose.push_back(truth.front());
    for (int i = 0; i < poses; ++i) {
      bool const loop = i + 1 == poses;
      ft::similarity_edge e;
      e.from = i;
      e.to = loop ? 0 : i + 1;
      e.T_from_to = (at(truth, e.from).inverse() * at(truth, e.to)).orthonormalized();
      e.information[27] = loop ? 1e8 : 1;  // the scale
      if (!loop) {
        e.T_from_to.scale = 1;
        graph.T_world_pose.push_back((graph.T_world_pose.back() * e.T_from_to).orthonormalized());
      }
      graph.edges.push_back(e);
    }
  }
};

/// Root of the mean squared distance of positions, m.
inline double position_error(std::vector<motion> const& T, std::vector<motion> const& truth) {
  double sum = 0;
  for (std::size_t i = 0; i < T.size(); ++i) {
    auto const d = T[i].t - truth[i].t;
    sum += ft::dot(d, d);
  }
  return std::sqrt(sum / static_cast<double>(T.size()));
}

TYPED_TEST(similarity_graphs, a_loop_takes_the_drift_of_the_scale_back) {
  // Drift at a constant rate is what the odometry's edges share evenly, so the answer is the truth.
  drifting_circle const made;
  EXPECT_GT(position_error(made.graph.T_world_pose, made.truth), 5);
  for (auto const start :
       {pose_graph_start::given, pose_graph_start::odometry, pose_graph_start::chordal}) {
    auto graph = made.graph;
    auto const report = this->optimize(graph, start);
    EXPECT_TRUE(report.converged);
    EXPECT_LT(position_error(graph.T_world_pose, made.truth), 1e-3);
    for (std::size_t i = 0; i < made.truth.size(); ++i) {
      EXPECT_NEAR(graph.T_world_pose[i].scale / made.truth[i].scale, 1, 1e-4) << i;
    }
  }
  // Rigid motions cannot.
  ft::pose_graph rigid;
  for (auto const& T : made.graph.T_world_pose) { rigid.T_world_pose.push_back({T.R, T.t}); }
  for (auto const& e : made.graph.edges) {
    ft::pose_graph_edge r;
    r.from = e.from;
    r.to = e.to;
    r.T_from_to = {e.T_from_to.R, e.T_from_to.t};
    rigid.edges.push_back(r);
  }
  ft::optimize_pose_graph(this->backend.exec, rigid);
  std::vector<motion> moved;
  for (auto const& T : rigid.T_world_pose) { moved.push_back({T.R, T.t, 1}); }
  EXPECT_GT(position_error(moved, made.truth), 1);
}

TYPED_TEST(similarity_graphs, result_is_a_minimum) {
  for (unsigned seed = 11; seed <= 12; ++seed) {
    test::random_motions any(seed);
    test::expect_minimum(this->backend.exec, make_similarity_graph({120, 60}, seed).graph,
                         plain_chi2, [&](motion& T) {
                           auto const step = any(1e-4, 1e-4);
                           T = T * motion{step.R, step.t, std::exp(1e-4 * any.number())};
                         });
  }
}

TYPED_TEST(similarity_graphs, executors_agree_to_the_bit) {
  // From sparse to dense parts of several tiles.
  test::graph_shape const shapes[] = {
      {2, 0}, {3, 1}, {9, 2}, {33, 5}, {40, 200}, {90, 300}, {400, 500, 0.01, 0.02, 20}, {700, 60}};
  unsigned seed = 40;
  for (auto const& shape : shapes) {
    if (!test::whole_effort() && shape.poses > 100) { continue; }
    for (auto const start :
         {pose_graph_start::given, pose_graph_start::odometry, pose_graph_start::chordal}) {
      ++seed;
      test::expect_bits_of_host(this->backend.exec, make_similarity_graph(shape, seed).graph, start,
                                seed);
    }
  }
}

TYPED_TEST(similarity_graphs, fixed_poses_keep_their_scales) {
  auto made = make_similarity_graph({50, 10}, 3);
  auto& graph = made.graph;
  graph.fixed.assign(50, 0);
  graph.fixed[7] = graph.fixed[31] = 1;
  for (auto const start :
       {pose_graph_start::given, pose_graph_start::odometry, pose_graph_start::chordal}) {
    auto moved = graph;
    auto const report = this->optimize(moved, start);
    EXPECT_TRUE(report.converged);
    EXPECT_TRUE(report.started);
    for (std::size_t const i : {7u, 31u}) {
      EXPECT_EQ(distance(moved.T_world_pose[i], graph.T_world_pose[i]), 0) << i;
    }
    EXPECT_NE(moved.T_world_pose[20].scale, graph.T_world_pose[20].scale);
  }
  // Without a fixed one that is the first.
  graph.fixed.clear();
  auto moved = graph;
  this->optimize(moved, pose_graph_start::chordal);
  EXPECT_EQ(distance(moved.T_world_pose[0], graph.T_world_pose[0]), 0);
}

TYPED_TEST(similarity_graphs, robust_kernels_ignore_a_false_scale) {
  for (auto const kernel : {ft::robust_kernel::huber, ft::robust_kernel::cauchy}) {
    auto made = make_similarity_graph({80, 40, 0.002, 0.005, 0, false}, 5);
    auto wrong = made.graph.edges.back();
    wrong.from = 3;
    wrong.to = 60;
    wrong.T_from_to = at(made.truth, 3).inverse() * at(made.truth, 60);
    wrong.T_from_to.scale *= 10;
    auto plain = made.graph;
    plain.edges.push_back(wrong);
    this->optimize(plain, pose_graph_start::given);
    for (auto& e : made.graph.edges) {
      e.kernel = kernel;
      e.width = 4;
    }
    auto clean = made.graph;
    this->optimize(clean, pose_graph_start::given);
    wrong.kernel = kernel;
    wrong.width = 4;
    auto graph = made.graph;
    graph.edges.push_back(wrong);
    this->optimize(graph, pose_graph_start::given);
    double worst = 0;
    double worst_plain = 0;
    for (std::size_t i = 0; i < 80; ++i) {
      worst = std::max(worst, distance(graph.T_world_pose[i], clean.T_world_pose[i]));
      worst_plain = std::max(worst_plain, distance(plain.T_world_pose[i], clean.T_world_pose[i]));
    }
    EXPECT_LT(worst, 0.1 * worst_plain);
  }
}

/// Scales of 1 that are held are rigid motions: the same errors, and the same answer.
TYPED_TEST(similarity_graphs, held_scales_give_the_answer_of_rigid_motions) {
  auto rigid = test::make_graph({60, 25}, 6).graph;
  ft::similarity_graph graph;
  for (auto const& T : rigid.T_world_pose) { graph.T_world_pose.push_back({T.R, T.t, 1}); }
  for (auto const& edge : rigid.edges) {
    ft::similarity_edge e;
    e.from = edge.from;
    e.to = edge.to;
    e.T_from_to = {edge.T_from_to.R, edge.T_from_to.t, 1};
    for (int i = 0, own = 0, rigid_at = 0; i < 6; ++i) {
      for (int j = i; j < 6; ++j) { e.information[own++] = edge.information[rigid_at++]; }
      e.information[own++] = 0;
    }
    e.information[27] = 1e14;
    graph.edges.push_back(e);
  }
  ft::pose_graph_params params;
  params.enough = 1e-13;
  auto const want = ft::optimize_pose_graph(this->backend.exec, rigid, params);
  auto const report = ft::optimize_pose_graph(this->backend.exec, graph, params);
  EXPECT_NEAR(report.first_chi2, want.first_chi2, 1e-12 * want.first_chi2);
  EXPECT_NEAR(report.last_chi2, want.last_chi2, 1e-6 * want.last_chi2);
  for (std::size_t i = 0; i < rigid.T_world_pose.size(); ++i) {
    auto const& T = rigid.T_world_pose[i];
    EXPECT_LT(distance(graph.T_world_pose[i], {T.R, T.t, 1}), 1e-5) << i;
  }
}

TYPED_TEST(similarity_graphs, scales_that_no_edge_tells_of_stay_at_the_start) {
  auto made = make_similarity_graph({30, 12, 0.01, 0.02, 0, false}, 3);
  for (auto& e : made.graph.edges) { e.information[27] = 0; }
  auto graph = made.graph;
  ft::pose_graph_params params;
  params.start = pose_graph_start::chordal;
  params.steps = 0;
  EXPECT_TRUE(ft::optimize_pose_graph(this->backend.exec, graph, params).started);
  for (std::size_t i = 0; i < graph.T_world_pose.size(); ++i) {
    EXPECT_EQ(graph.T_world_pose[i].scale, made.graph.T_world_pose[i].scale) << i;
  }
}

TYPED_TEST(similarity_graphs, bad_graphs_are_refused) {
  auto const made = make_similarity_graph({5, 2}, 1);
  auto const refused = [&](auto const& damage, std::string const& part) {
    auto graph = made.graph;
    damage(graph);
    test::expect_refused([&] { ft::optimize_pose_graph(this->backend.exec, graph); }, part);
  };
  double const nan = std::numeric_limits<double>::quiet_NaN();
  refused([](auto& g) { g.T_world_pose[3].scale = 0; }, "(pose 3)");
  refused([](auto& g) { g.T_world_pose[2].scale = -1; }, "a scale must be in");
  refused([&](auto& g) { g.edges[1].T_from_to.scale = nan; }, "(edge 1)");
  refused([](auto& g) { g.edges[1].T_from_to.scale = 1e60; }, "a scale must be in");
  refused([](auto& g) { g.T_world_pose[3].R.m[0] = 2; }, "(pose 3)");
  refused([&](auto& g) { g.edges[0].information[27] = nan; }, "information is nan");
  refused([](auto& g) { g.edges[0].information[27] = -1; }, "negative eigenvalue");
  refused([](auto& g) { g.edges[0].information[6] = 1e9; }, "negative eigenvalue");
}

}  // namespace similarity_graph_test
