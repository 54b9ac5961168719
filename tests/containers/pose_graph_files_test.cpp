// SPDX-License-Identifier: Apache-2.0
// Pose graphs in g2o's format: what is written reads back, damaged files are refused by line.
#include "ft/containers/pose_graph_files.hpp"

#include <gtest/gtest.h>

#include <clocale>
#include <cmath>
#include <cstddef>
#include <sstream>
#include <string>

#include "tests/support/pose_graphs.hpp"

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
    test::random_motion any(seed);
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

TEST(PoseGraphFiles, DamagedOnesAreRefusedByLine) {
  auto const refused = [](std::string const& from, std::string const& to, std::string const& part) {
    std::string text = good();
    text.replace(text.find(from), from.size(), to);
    try {
      read(text);
      ADD_FAILURE() << "not refused: " << part;
    } catch (ft::error const& e) {
      EXPECT_NE(std::string(e.what()).find(part), std::string::npos) << e.what();
    }
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
