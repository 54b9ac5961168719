// SPDX-License-Identifier: Apache-2.0
// Pose graphs: derivatives, graphs with a known answer, recorded graphs with a known optimum, equal
// bits on both executors, starts, robust kernels, graphs that cannot be optimised.
#include "ft/pipelines/pose_graph.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <limits>
#include <string>
#include <vector>

#include "ft/pipelines/pose_graph_files.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/effort.hpp"
#include "tests/support/pose_graph_checks.hpp"
#include "tests/support/pose_graphs.hpp"
#include "tests/support/refusals.hpp"

namespace pose_graph_test {

using ft::pose_graph_start;
using test::distance;
using test::make_graph;
using test::same_bits;

template <typename Backend>
class pose_graphs : public test::on_backend<Backend> {
protected:
  Backend backend;

  ft::pose_graph_report optimize(ft::pose_graph& graph, pose_graph_start start) {
    return test::optimize(backend.exec, graph, start);
  }
};
TYPED_TEST_SUITE(pose_graphs, test::backends);

/// Sum of e^T W e in plain numbers, with the quaternion by its half angle.
inline double plain_chi2(ft::pose_graph const& graph) {
  double sum = 0;
  for (auto const& edge : graph.edges) {
    auto const D = edge.T_from_to.inverse() *
                   (graph.T_world_pose[static_cast<std::size_t>(edge.from)].inverse() *
                    graph.T_world_pose[static_cast<std::size_t>(edge.to)]);
    auto const& m = D.R.m;
    double const w = std::sqrt(std::max(0.0, 1 + m[0] + m[4] + m[8])) / 2;
    double e[6] = {D.t.x, D.t.y, D.t.z, 0, 0, 0};
    if (w > 1e-3) {
      e[3] = (m[7] - m[5]) / (4 * w);
      e[4] = (m[2] - m[6]) / (4 * w);
      e[5] = (m[3] - m[1]) / (4 * w);
    }
    int at = 0;
    for (int i = 0; i < 6; ++i) {
      for (int j = i; j < 6; ++j) {
        sum += (i == j ? 1 : 2) * edge.information[at++] * e[i] * e[j];
      }
    }
  }
  return sum;
}

TEST(PoseGraphEdge, DerivativesAreThoseOfDifferences) {
  test::random_motions any(7);
  double const h = 1e-6;
  for (int round = 0; round < 50; ++round) {
    ft::pose_graph_edge edge;
    edge.T_from_to = any(0.8, 2);
    ft::rigid<double> const T[2] = {any(1, 3), any(1, 3)};
    ft::detail::edge_error const here(edge, T[0], T[1]);
    if (here.q.w < ft::strict_double(0.1)) { continue; }  // the sign of the quaternion may change
    ft::strict_double J[2][36];
    ft::detail::edge_jacobians(here, J);
    for (int which = 0; which < 2; ++which) {
      for (int k = 0; k < 6; ++k) {
        auto const error_after = [&](double size) {
          ft::vec3<double> const d{k % 3 == 0 ? size : 0, k % 3 == 1 ? size : 0,
                                   k % 3 == 2 ? size : 0};
          ft::vec3<double> const zero{0, 0, 0};
          ft::rigid<double> moved[2] = {T[0], T[1]};
          moved[which] =
              moved[which] * ft::rigid<double>{test::turned_by(k < 3 ? zero : d), k < 3 ? d : zero};
          return ft::detail::edge_error(edge, moved[0], moved[1]);
        };
        auto const after = error_after(h);
        auto const before = error_after(-h);
        for (int row = 0; row < 6; ++row) {
          EXPECT_NEAR(J[which][6 * row + k].value,
                      (after.e[row].value - before.e[row].value) / (2 * h), 1e-8)
              << which << ' ' << row << ' ' << k;
        }
      }
    }
  }
}

TYPED_TEST(pose_graphs, exact_measurements_give_the_truth) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    auto made = make_graph({60, 20}, seed);
    for (auto& e : made.graph.edges) {
      e.T_from_to = (made.truth[static_cast<std::size_t>(e.from)].inverse() *
                     made.truth[static_cast<std::size_t>(e.to)])
                        .orthonormalized();
    }
    test::random_motions any(seed);
    for (std::size_t i = 1; i < made.truth.size(); ++i) {
      made.graph.T_world_pose[i] = made.truth[i] * any(0.05, 0.1);
    }
    for (auto const start : {pose_graph_start::given, pose_graph_start::chordal}) {
      auto graph = made.graph;
      auto const report = this->optimize(graph, start);
      EXPECT_TRUE(report.started);
      for (std::size_t i = 0; i < made.truth.size(); ++i) {
        ASSERT_LT(distance(graph.T_world_pose[i], made.truth[i]), 1e-5) << seed << ' ' << i;
      }
    }
  }
}

TYPED_TEST(pose_graphs, result_is_a_minimum) {
  for (unsigned seed = 11; seed <= 13; ++seed) {
    test::random_motions any(seed);
    test::expect_minimum(this->backend.exec, make_graph({120, 60}, seed).graph, plain_chi2,
                         [&](auto& T) { T = T * any(1e-4, 1e-4); });
  }
}

TYPED_TEST(pose_graphs, executors_agree_to_the_bit) {
  test::graph_shape const shapes[] = {{2, 0},
                                      {3, 1},
                                      {9, 2},
                                      {33, 5},
                                      {40, 200},
                                      {300, 15},
                                      {400, 500, 0.01, 0.02, 20},
                                      {700, 60},
                                      {1000, 50},
                                      {600, 900, 0.02, 0.05, 25}};
  unsigned seed = 20;
  for (auto const& shape : shapes) {
    if (!test::whole_effort() && shape.poses > 100) { continue; }
    for (auto const start :
         {pose_graph_start::given, pose_graph_start::odometry, pose_graph_start::chordal}) {
      ++seed;
      test::expect_bits_of_host(this->backend.exec, make_graph(shape, seed).graph, start, seed);
    }
  }
}

TYPED_TEST(pose_graphs, fixed_poses_and_parts_stay) {
  auto made = make_graph({50, 10}, 3);
  auto& graph = made.graph;
  graph.fixed.assign(50, 0);
  graph.fixed[7] = graph.fixed[31] = 1;
  // A second part of three poses, which no edge joins with the first.
  test::random_motions any(9);
  for (int k = 0; k < 3; ++k) {
    graph.T_world_pose.push_back(any(1, 1));
    graph.fixed.push_back(0);
  }
  for (int k = 50; k < 52; ++k) {
    ft::pose_graph_edge e;
    e.from = k + 1;
    e.to = k;
    e.T_from_to = any(0.5, 1);
    graph.edges.push_back(e);
  }
  graph.T_world_pose.push_back(any(1, 1));  // without edges
  graph.fixed.push_back(0);
  for (auto const start :
       {pose_graph_start::given, pose_graph_start::odometry, pose_graph_start::chordal}) {
    auto moved = graph;
    auto const report = this->optimize(moved, start);
    EXPECT_TRUE(report.converged);
    EXPECT_TRUE(report.started);
    for (std::size_t const i : {7u, 31u, 50u, 53u}) {
      EXPECT_EQ(distance(moved.T_world_pose[i], graph.T_world_pose[i]), 0) << i;
    }
    auto const left = moved.T_world_pose[51] * graph.edges[graph.edges.size() - 2].T_from_to;
    EXPECT_LT(distance(left, moved.T_world_pose[50]), 1e-6);
    EXPECT_GT(distance(moved.T_world_pose[20], graph.T_world_pose[20]), 1e-6);
  }
}

TYPED_TEST(pose_graphs, robust_kernels_ignore_a_false_loop) {
  for (auto const kernel : {ft::robust_kernel::huber, ft::robust_kernel::cauchy}) {
    auto made = make_graph({80, 40, 0.002, 0.005, 0, false}, 5);
    auto clean = made.graph;
    this->optimize(clean, pose_graph_start::given);
    auto graph = made.graph;
    ft::pose_graph_edge wrong = graph.edges.back();
    wrong.from = 3;
    wrong.to = 60;
    wrong.T_from_to = ft::rigid<double>::identity();
    graph.edges.push_back(wrong);
    auto plain = graph;
    this->optimize(plain, pose_graph_start::given);
    for (auto& e : graph.edges) {
      e.kernel = kernel;
      e.width = 4;
    }
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

/// Turned about an axis of the world, and moved.
inline ft::rigid<double> with_heading(ft::rigid<double> const& T, ft::vec3<double> turn,
                                      ft::vec3<double> shift) {
  return ft::rigid<double>{test::turned_by(turn) * T.R, T.t + shift}.orthonormalized();
}

TYPED_TEST(pose_graphs, with_gravity_headings_and_positions_become_the_truth) {
  ft::vec3<double> const up{0.6, 0, -0.8};
  auto made = make_graph({60, 20}, 4);
  test::random_motions any(4);
  for (std::size_t i = 1; i < made.truth.size(); ++i) {
    double const turn = 0.2 * any.number();
    made.graph.T_world_pose[i] =
        with_heading(made.truth[i], {turn * up.x, turn * up.y, turn * up.z}, any.vector(0.2));
  }
  for (auto& e : made.graph.edges) {
    e.T_from_to = (made.truth[static_cast<std::size_t>(e.from)].inverse() *
                   made.truth[static_cast<std::size_t>(e.to)])
                      .orthonormalized();
  }
  ft::pose_graph_params params;
  params.gravity = {9.81 * up.x, 9.81 * up.y, 9.81 * up.z};
  ft::optimize_pose_graph(this->backend.exec, made.graph, params);
  for (std::size_t i = 0; i < made.truth.size(); ++i) {
    ASSERT_LT(distance(made.graph.T_world_pose[i], made.truth[i]), 1e-5) << i;
  }
}

TYPED_TEST(pose_graphs, with_gravity_angles_against_it_stay_and_the_rest_is_a_minimum) {
  ft::vec3<double> const up{0.36, 0.48, 0.8};
  for (unsigned seed = 31; seed <= 33; ++seed) {
    auto made = make_graph({120, 60}, seed);
    auto& graph = made.graph;
    auto const given = graph.T_world_pose;
    auto host = graph;
    ft::pose_graph_params params;
    params.gravity = up;
    auto const report = ft::optimize_pose_graph(this->backend.exec, graph, params);
    EXPECT_TRUE(report.converged);
    EXPECT_LT(report.last_chi2, 0.9 * report.first_chi2);
    double const least = plain_chi2(graph);
    for (std::size_t i = 0; i < given.size(); ++i) {
      auto const before = given[i].R.transposed() * up;
      auto const now = graph.T_world_pose[i].R.transposed() * up;
      auto const d = now - before;
      EXPECT_LT(std::sqrt(ft::dot(d, d)), 1e-12) << i;
    }
    test::random_motions any(seed);
    for (int round = 0; round < 30; ++round) {
      auto moved = graph;
      for (std::size_t i = 1; i < moved.T_world_pose.size(); ++i) {
        double const turn = 1e-4 * any.number();
        moved.T_world_pose[i] = with_heading(
            moved.T_world_pose[i], {turn * up.x, turn * up.y, turn * up.z}, any.vector(1e-4));
      }
      EXPECT_GT(plain_chi2(moved), least);
    }
    ft::optimize_pose_graph(ft::host_exec(1), host, params);
    EXPECT_TRUE(same_bits(graph.T_world_pose, host.T_world_pose));
  }
}

TYPED_TEST(pose_graphs, gravity_that_means_nothing_is_refused) {
  auto made = make_graph({5, 2}, 1);
  ft::pose_graph_params params;
  params.gravity = {0, 0, std::numeric_limits<double>::quiet_NaN()};
  EXPECT_THROW(ft::optimize_pose_graph(this->backend.exec, made.graph, params), ft::bad_argument);
  params.gravity = {1e-12, 0, 0};
  EXPECT_THROW(ft::optimize_pose_graph(this->backend.exec, made.graph, params), ft::bad_argument);
  params.gravity = {0, 0, -9.81};
  params.start = pose_graph_start::chordal;
  EXPECT_THROW(ft::optimize_pose_graph(this->backend.exec, made.graph, params), ft::bad_argument);
}

TYPED_TEST(pose_graphs, recorded_graphs_reach_their_optimum) {
  char const* const data = std::getenv("FT_DATA");
  std::string const folder =
      std::string(data != nullptr ? data : "../shared") + "/data/pose_graphs/";
  if (!std::ifstream(folder + "smallGrid3D.g2o")) {
    GTEST_SKIP() << "no recorded pose graphs: set FT_DATA to the folder of data/pose_graphs";
  }
  struct known {
    char const* name;
    double chi2;
  };
  for (known const& k : {known{"smallGrid3D", 458.1538}, known{"parking-garage", 1.238691},
                         known{"sphere2500", 727.1497}}) {
    if (!test::whole_effort() && std::string(k.name) != "smallGrid3D") { continue; }
    for (auto const start : {pose_graph_start::given, pose_graph_start::chordal}) {
      auto graph = ft::read_g2o(folder + k.name + ".g2o");
      auto const report = this->optimize(graph, start);
      EXPECT_TRUE(report.converged) << k.name;
      EXPECT_NEAR(report.last_chi2, k.chi2, 1e-6 * k.chi2) << k.name;
      EXPECT_NEAR(report.last_chi2, plain_chi2(graph), 1e-8 * k.chi2) << k.name;
    }
  }
}

TYPED_TEST(pose_graphs, motions_that_agree_exactly_are_met_and_that_is_the_end) {
  ft::pose_graph graph;
  ft::rigid<double> step = ft::rigid<double>::identity();
  step.t = {1, 0, 0};
  for (int i = 0; i < 6; ++i) {
    graph.T_world_pose.push_back(ft::rigid<double>::identity());
    graph.T_world_pose.back().t = {1.0 * i, 0.1 * i * i, 0};  // off
    ft::pose_graph_edge e;
    e.from = i;
    e.to = (i + 1) % 6;
    e.T_from_to = step;
    if (i == 5) { e.T_from_to.t.x = -5; }
    graph.edges.push_back(e);
  }
  auto const report = ft::optimize_pose_graph(this->backend.exec, graph);
  EXPECT_GT(report.given_cost, 0.1);
  EXPECT_LT(report.last_cost, 1e-20 * report.given_cost);
  EXPECT_TRUE(report.converged);
  EXPECT_LT(report.steps, 20);
}

TYPED_TEST(pose_graphs, graphs_with_nothing_to_do) {
  ft::pose_graph empty;
  EXPECT_TRUE(this->optimize(empty, pose_graph_start::chordal).converged);
  auto made = make_graph({5, 2}, 1);
  auto graph = made.graph;
  graph.fixed.assign(5, 1);
  auto const report = this->optimize(graph, pose_graph_start::chordal);
  EXPECT_TRUE(same_bits(graph.T_world_pose, made.graph.T_world_pose));
  EXPECT_EQ(report.last_cost, report.given_cost);
  ft::pose_graph_params params;
  params.steps = 0;
  graph = made.graph;
  EXPECT_FALSE(ft::optimize_pose_graph(this->backend.exec, graph, params).converged);
  EXPECT_TRUE(same_bits(graph.T_world_pose, made.graph.T_world_pose));
  // Edges that say nothing leave the poses, and the start cannot be made.
  for (auto& e : graph.edges) {
    for (double& v : e.information) { v = 0; }
  }
  EXPECT_FALSE(this->optimize(graph, pose_graph_start::chordal).started);
  EXPECT_TRUE(same_bits(graph.T_world_pose, made.graph.T_world_pose));
}

TYPED_TEST(pose_graphs, what_no_edge_tells_of_stays_and_the_rest_moves) {
  // Of the last pose only its place is measured, not where it looks.
  auto made = make_graph({30, 12}, 3);
  auto& graph = made.graph;
  ft::pose_graph_edge e = graph.edges.front();
  e.from = 4;
  e.to = static_cast<int>(graph.T_world_pose.size());
  for (double& v : e.information) { v = 0; }
  for (int i = 0, at = 0; i < 3; ++i) {
    e.information[at] = 100;
    at += 6 - i;
  }
  graph.edges.push_back(e);
  graph.T_world_pose.push_back(ft::rigid<double>::identity());
  auto without = make_graph({30, 12}, 3).graph;
  auto const report = this->optimize(graph, pose_graph_start::given);
  this->optimize(without, pose_graph_start::given);
  EXPECT_TRUE(report.converged);
  EXPECT_LT(report.last_chi2, report.first_chi2);
  for (std::size_t i = 0; i < without.T_world_pose.size(); ++i) {
    EXPECT_LT(distance(graph.T_world_pose[i], without.T_world_pose[i]), 1e-5) << i;
  }
}

TYPED_TEST(pose_graphs, a_start_that_fails_harms_no_later_step) {
  // Rotations are not measured, so that there is no chordal start.
  for (int poses : {9, 21, 30}) {
    auto made = make_graph({poses, 12}, 7);
    auto graph = made.graph;
    for (auto& e : graph.edges) {
      for (int i = 0, at = 0; i < 6; at += 6 - i, ++i) {
        for (int j = i; j < 6; ++j) {
          if (i >= 3 || j >= 3) { e.information[at + j - i] = 0; }
        }
      }
    }
    auto same = graph;
    auto const given = this->optimize(same, pose_graph_start::given);
    auto const report = this->optimize(graph, pose_graph_start::chordal);
    EXPECT_LT(given.last_chi2, given.first_chi2) << poses;
    EXPECT_LT(report.last_chi2, report.given_chi2) << poses;
  }
}

TYPED_TEST(pose_graphs, a_very_wide_kernel_is_none) {
  auto made = make_graph({40, 15}, 9);
  auto plain = made.graph;
  auto const none = this->optimize(plain, pose_graph_start::given);
  for (auto& e : made.graph.edges) {
    e.kernel = ft::robust_kernel::cauchy;
    e.width = 1e9;
  }
  auto const wide = this->optimize(made.graph, pose_graph_start::given);
  EXPECT_NEAR(wide.last_cost, none.last_cost, 1e-9 * none.last_cost);
  EXPECT_GT(wide.steps, 1);
}

TYPED_TEST(pose_graphs, a_step_that_is_damped_away_is_no_end) {
  auto made = make_graph({40, 15}, 9);
  ft::pose_graph_params params;
  params.first_damping = 1e9;
  params.enough = 1e-6;
  params.steps = 1;
  EXPECT_FALSE(ft::optimize_pose_graph(this->backend.exec, made.graph, params).converged);
}

TYPED_TEST(pose_graphs, bad_graphs_are_refused) {
  auto const made = make_graph({5, 2}, 1);
  auto const refused = [&](auto const& damage, std::string const& part) {
    auto graph = made.graph;
    damage(graph);
    test::expect_refused([&] { ft::optimize_pose_graph(this->backend.exec, graph); }, part);
  };
  double const nan = std::numeric_limits<double>::quiet_NaN();
  refused([](ft::pose_graph& g) { g.edges[2].to = 5; }, "(edge 2)");
  refused([](ft::pose_graph& g) { g.edges[1].from = -1; }, "(edge 1)");
  refused([](ft::pose_graph& g) { g.edges[1].to = g.edges[1].from; }, "with itself");
  refused([&](ft::pose_graph& g) { g.edges[0].information[4] = nan; }, "information is nan");
  refused([&](ft::pose_graph& g) { g.edges[0].information[0] = -1; }, "negative eigenvalue");
  refused(
      [&](ft::pose_graph& g) {  // units differ: small beside another one, and negative
        for (double& v : g.edges[0].information) { v = 0; }
        for (int i = 0, at = 0; i < 6; at += 6 - i, ++i) {
          g.edges[0].information[at] = i < 3 ? 1e10 : i < 5 ? 5 : -5;
        }
      },
      "negative eigenvalue");
  refused([&](ft::pose_graph& g) { g.edges[0].T_from_to.t.y = nan; }, "translation is nan");
  refused([&](ft::pose_graph& g) { g.T_world_pose[3].R.m[0] = 2; }, "(pose 3)");
  refused([&](ft::pose_graph& g) { g.fixed.assign(4, 0); }, "`fixed`");
  refused(
      [&](ft::pose_graph& g) {
        g.edges[0].kernel = ft::robust_kernel::huber;
        g.edges[0].width = 0;
      },
      "width");
  refused(
      [&](ft::pose_graph& g) {
        g.edges[0].kernel = ft::robust_kernel::cauchy;
        g.edges[0].width = 1e150;
      },
      "width");
  ft::pose_graph_params params;
  params.enough = nan;
  auto graph = made.graph;
  EXPECT_THROW(ft::optimize_pose_graph(this->backend.exec, graph, params), ft::bad_argument);
}

}  // namespace pose_graph_test
