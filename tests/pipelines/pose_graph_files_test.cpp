// SPDX-License-Identifier: Apache-2.0
// Pose graphs in g2o's format: what is written reads back, damaged files are refused by line.
#include "ft/pipelines/pose_graph_files.hpp"

#include <gtest/gtest.h>

#include <clocale>
#include <cmath>
#include <complex>
#include <cstddef>
#include <sstream>
#include <string>
#include <vector>

#include "ft/kernels/graph/edges.hpp"
#include "ft/math/sim3.hpp"
#include "tests/support/pose_graphs.hpp"
#include "tests/support/refusals.hpp"

namespace pose_graph_files_test {

constexpr char const* information = "4 0 0 0 0 0 5 0 0 0 0 6 0 0 0 7 0 0 8 0 9";

inline ft::pose_graph read(std::string const& text) {
  std::istringstream in(text);
  return ft::read_g2o(in);
}

inline std::string good() {
  return std::string(
             "# a comment\n"
             "VERTEX_SE3:QUAT 7 1 2 3 0 0 0 1\n"
             "\n"
             "EDGE_SE3:QUAT 7 3 1e0 +0.5 -0.25 0 0 0.70710678 0.70710678 ") +
         information + " \r\nVERTEX_SE3:QUAT 3 4 5 6 0 0 0 -1\nFIX 7\n";
}

TEST(PoseGraphFiles, AreReadAsTheyAreWritten) {
  auto const graph = read(good());
  ASSERT_EQ(graph.T_world_pose.size(), 2u);
  ASSERT_EQ(graph.edges.size(), 1u);
  EXPECT_EQ(graph.ids[0], 7);
  EXPECT_EQ(graph.ids[1], 3);
  EXPECT_EQ(graph.fixed[0], 1);
  EXPECT_EQ(graph.fixed[1], 0);
  EXPECT_EQ(graph.T_world_pose[1].t.y, 5);
  EXPECT_EQ(graph.T_world_pose[1].R.m[0], 1);
  auto const& edge = graph.edges[0];
  EXPECT_EQ(edge.from, 0);
  EXPECT_EQ(edge.to, 1);
  EXPECT_EQ(edge.T_from_to.t.x, 1);
  EXPECT_EQ(edge.T_from_to.t.y, 0.5);
  EXPECT_NEAR(edge.T_from_to.R.m[3], 1, 1e-12);  // a quarter turn about z
  EXPECT_EQ(edge.information[0], 4);
  EXPECT_EQ(edge.information[20], 9);
}

TEST(PoseGraphFiles, HavePointsInALocaleOfCommas) {
  if (std::setlocale(LC_NUMERIC, "de_DE.UTF-8") == nullptr) {
    GTEST_SKIP() << "the locale de_DE.UTF-8 is not installed";
  }
  std::stringstream file;
  ft::write_g2o(file, test::make_graph({4, 1}, 1).graph);
  std::setlocale(LC_NUMERIC, "C");
  EXPECT_EQ(file.str().find(','), std::string::npos);
  EXPECT_EQ(ft::read_g2o(file).T_world_pose.size(), 4u);
}

TEST(PoseGraphFiles, RoundTripsKeepNumbers) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    auto graph = test::make_graph({40, 20}, seed).graph;
    test::random_motions any(seed);
    for (auto& T : graph.T_world_pose) { T = any(2, 100); }  // also of more than half a turn
    graph.fixed.assign(40, 0);
    graph.fixed[3] = 1;
    std::stringstream file;
    ft::write_g2o(file, graph);
    auto const back = ft::read_g2o(file);
    ASSERT_EQ(back.T_world_pose.size(), graph.T_world_pose.size());
    ASSERT_EQ(back.edges.size(), graph.edges.size());
    EXPECT_EQ(back.fixed, graph.fixed);
    for (std::size_t i = 0; i < 40; ++i) {
      EXPECT_EQ(back.T_world_pose[i].t.x, graph.T_world_pose[i].t.x);
      for (int k = 0; k < 9; ++k) {
        EXPECT_NEAR(back.T_world_pose[i].R.m[k], graph.T_world_pose[i].R.m[k], 1e-14);
      }
    }
    for (std::size_t e = 0; e < graph.edges.size(); ++e) {
      EXPECT_EQ(back.edges[e].from, graph.edges[e].from);
      EXPECT_EQ(back.edges[e].to, graph.edges[e].to);
      for (int k = 0; k < 21; ++k) {
        EXPECT_EQ(back.edges[e].information[k], graph.edges[e].information[k]);
      }
    }
  }
}

// ---- poses with scales

inline std::string good_similarities() {
  return std::string(
             "VERTEX_SIM3:EXPMAP 7 0 0 0 1 2 3 0 500 500 320 240\n"
             "VERTEX_SIM3:EXPMAP 3 0 0 1.5 4 5 6 0.7\n"
             "EDGE_SIM3:EXPMAP 7 3 0 0 0 1 0 0 -0.7 ") +
         "4 0 0 0 0 0 0 5 0 0 0 0 0 6 0 0 0 0 7 1 0 0 8 0 0 9 0 10\nFIX 7\n";
}
inline ft::similarity_graph read_similarities(std::string const& text) {
  std::istringstream in(text);
  return ft::read_g2o_similarities(in);
}

TEST(SimilarityGraphFiles, AreReadAsG2oWritesThem) {
  auto const graph = read_similarities(good_similarities());
  ASSERT_EQ(graph.T_world_pose.size(), 2u);
  ASSERT_EQ(graph.edges.size(), 1u);
  EXPECT_EQ(graph.ids[1], 3);
  EXPECT_EQ(graph.fixed[0], 1);
  auto const& first = graph.T_world_pose[0];
  EXPECT_EQ(first.t.y, 2);
  EXPECT_EQ(first.scale, 1);
  // A turn of 1.5 rad about z, a scale of e^0.7: in the plane the integral is that of numbers.
  auto const& T = graph.T_world_pose[1];
  std::complex<double> const turn(0.7, 1.5);
  auto const t = (std::exp(turn) - 1.0) / turn * std::complex<double>(4, 5);
  EXPECT_NEAR(T.scale, std::exp(0.7), 1e-14);
  EXPECT_NEAR(T.R.m[3], std::sin(1.5), 1e-14);
  EXPECT_NEAR(T.t.x, t.real(), 1e-13);
  EXPECT_NEAR(T.t.y, t.imag(), 1e-13);
  EXPECT_NEAR(T.t.z, 6 * (std::exp(0.7) - 1) / 0.7, 1e-13);
  // The measurement is from the first to the second.
  auto const& edge = graph.edges[0];
  EXPECT_EQ(edge.from, 0);
  EXPECT_EQ(edge.to, 1);
  EXPECT_NEAR(edge.T_from_to.scale, std::exp(-0.7), 1e-14);
  // Translation first; rotations count four times, as the quaternion has half of the angle.
  double const diagonal[7] = {7, 8, 9, 16, 20, 24, 10};
  for (int i = 0, at = 0; i < 7; at += 7 - i, ++i) { EXPECT_EQ(edge.information[at], diagonal[i]); }
  EXPECT_EQ(edge.information[1], 1);
}

TEST(SimilarityGraphFiles, RoundTripsKeepNumbers) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    auto graph = test::make_similarity_graph({40, 20}, seed).graph;
    test::random_motions any(seed);
    for (auto& T : graph.T_world_pose) {
      auto const placed = any(2, 100);  // also of more than half a turn
      T = {placed.R, placed.t, std::exp(any.number())};
    }
    graph.fixed.assign(40, 0);
    graph.fixed[3] = 1;
    std::stringstream file;
    ft::write_g2o(file, graph);
    auto const back = ft::read_g2o_similarities(file);
    ASSERT_EQ(back.T_world_pose.size(), graph.T_world_pose.size());
    ASSERT_EQ(back.edges.size(), graph.edges.size());
    EXPECT_EQ(back.fixed, graph.fixed);
    for (std::size_t i = 0; i < 40; ++i) {
      EXPECT_LT(test::distance(back.T_world_pose[i], graph.T_world_pose[i]), 1e-11) << i;
    }
    for (std::size_t e = 0; e < graph.edges.size(); ++e) {
      EXPECT_EQ(back.edges[e].from, graph.edges[e].from);
      EXPECT_EQ(back.edges[e].to, graph.edges[e].to);
      EXPECT_LT(test::distance(back.edges[e].T_from_to, graph.edges[e].T_from_to), 1e-13);
      for (int k = 0; k < 28; ++k) {
        EXPECT_EQ(back.edges[e].information[k], graph.edges[e].information[k]);
      }
    }
  }
}

/// A file's information is that of the logarithm: both errors of a small motion cost the same.
TEST(SimilarityGraphFiles, InformationIsThatOfTheLogarithm) {
  auto graph = test::make_similarity_graph({12, 0}, 4).graph;
  for (auto& e : graph.edges) { e.T_from_to = ft::similarity<double>::identity(); }
  std::stringstream file;
  ft::write_g2o(file, graph);
  test::random_motions any(4);
  std::size_t edges = 0;
  std::string tag;
  for (std::string line; std::getline(file, line);) {
    std::istringstream words(line);
    std::vector<double> numbers;
    words >> tag;
    for (double v; words >> v;) { numbers.push_back(v); }
    if (tag != "EDGE_SIM3:EXPMAP") { continue; }
    ASSERT_EQ(numbers.size(), 2u + 7 + 28);
    ft::strict_double x[7];
    for (auto& v : x) { v = 1e-5 * any.number(); }
    auto const T = ft::detail::exp_sim3(x).cast<double>();
    double from_file = 0;
    std::size_t at = 9;
    for (int i = 0; i < 7; ++i) {
      for (int j = i; j < 7; ++j) {
        from_file += (i == j ? 1 : 2) * numbers[at++] * x[i].value * x[j].value;
      }
    }
    auto const start = ft::similarity<double>::identity();
    ft::detail::edge_error<ft::similarity<double>> const error(graph.edges[edges], start, T);
    double const own = ft::detail::squared_error(graph.edges[edges], error.e).value;
    EXPECT_NEAR(own, from_file, 1e-4 * from_file);
    ++edges;
  }
  EXPECT_EQ(edges, graph.edges.size());
}

inline void expect_refused(std::string text, std::string const& from, std::string const& to,
                           std::string const& part, bool similarities) {
  text.replace(text.find(from), from.size(), to);
  test::expect_refused<ft::error>(
      [&] { similarities ? void(read_similarities(text)) : void(read(text)); }, part);
}

TEST(SimilarityGraphFiles, DamagedOnesAreRefusedByLine) {
  auto const refused = [](std::string const& from, std::string const& to, std::string const& part) {
    expect_refused(good_similarities(), from, to, part, true);
  };
  refused("VERTEX_SIM3:EXPMAP 7", "VERTEX_SIM3:QUAT 7", "line 1: there is 'VERTEX_SIM3:QUAT'");
  refused("VERTEX_SIM3:EXPMAP 7", "VERTEX_SE3:QUAT 7",
          "which is not VERTEX_SIM3:EXPMAP, EDGE_SIM3");
  refused(" 500 500 320 240", " 500 500 320", "line 1: there is no number of the camera");
  refused(" 500 500 320 240", " 500 500 320 240 1", "line 1: there is '1' after the last number");
  refused("3 0 500 500 320 240", "3", "line 1: there is no logarithm of the scale");
  refused("0.7\n", "120\n", "line 2: the logarithm of the scale is 120");
  refused("0.7\n", "nan\n", "line 2: 'nan' is not a finite number: logarithm of the scale");
  refused("0 0 1.5", "5 0 5", "line 2: the rotation vector has the length 7.07");
  refused("4 5 6 0.7", "4 1e308 6 114", "line 2: the translation is too large");
  refused("9 0 10", "9 0", "line 3: there is no entry of the information matrix");
  refused("9 0 10", "9 0 -10", "line 3: the information matrix has a negative eigenvalue");
  refused(" 4 0 0", " 1e308 0 0", "line 3: an entry of the information matrix is too large");
  refused("EDGE_SIM3:EXPMAP 7 3", "EDGE_SIM3:EXPMAP 7 4", "line 3: there is no pose 4");
  EXPECT_THROW(ft::read_g2o_similarities("/nowhere/at/all.g2o"), ft::error);
  expect_refused(good(), "EDGE_SE3:QUAT", "EDGE_SIM3:EXPMAP", "which is not VERTEX_SE3:QUAT",
                 false);
}

TEST(PoseGraphFiles, DamagedOnesAreRefusedByLine) {
  auto const refused = [](std::string const& from, std::string const& to, std::string const& part) {
    expect_refused(good(), from, to, part, false);
  };
  refused("VERTEX_SE3:QUAT 7", "VERTEX_SE2 7", "line 2: there is 'VERTEX_SE2'");
  refused("7 1 2 3", "-7 1 2 3", "line 2: the number of a pose");
  refused("QUAT 7 1 2 3", "QUAT 7.0 2 3", "line 2: the number of a pose");
  refused("7 1 2 3", "7 1 +-2 3", "line 2: '+-2' is not a finite number: y");
  refused("7 1 2 3 0 0 0 1", "7 1 2 3 0 0 0", "line 2: there is no part of the quaternion");
  refused("7 1 2 3 0 0 0 1", "7 1 2 3 0 0 0 0", "line 2: the quaternion has the length 0");
  refused("7 1 2 3 0 0 0 1", "7 1 2 3 0 0 0 1 9", "line 2: there is '9' after the last number");
  refused("7 1 2 3", "7 1 nan 3", "line 2: 'nan' is not a finite number: y");
  refused("7 1 2 3", "7 1 2x 3", "line 2: '2x' is not a finite number: y");
  refused("QUAT 3 4 5 6", "QUAT 7 4 5 6", "line 5: pose 7 is there twice");
  refused("EDGE_SE3:QUAT 7 3", "EDGE_SE3:QUAT 7 4", "line 4: there is no pose 4");
  refused("EDGE_SE3:QUAT 7 3", "EDGE_SE3:QUAT 7 7", "line 4: an edge joins pose 7 with itself");
  refused(" 9 ", " ", "line 4: there is no entry of the information matrix");
  refused(" 9 ", " -9 ", "line 4: the information matrix has a negative eigenvalue");
  refused("FIX 7", "FIX 8", "line 6: there is no pose 8");
  EXPECT_THROW(ft::read_g2o("/nowhere/at/all.g2o"), ft::error);
  EXPECT_TRUE(read("").T_world_pose.empty());
}

}  // namespace pose_graph_files_test
