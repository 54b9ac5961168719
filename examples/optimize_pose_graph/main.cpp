// SPDX-License-Identifier: Apache-2.0
// Optimises a pose graph in g2o's text format.
//   optimize_pose_graph IN.g2o [--out OUT.g2o] [--backend host|cuda] [--start
//   file|odometry|chordal]
//                       [--steps N] [--repeat N]
// Without IN.g2o: a loop of a hundred poses, made here. Poses have scales where the file has
// VERTEX_SIM3:EXPMAP. Compiled as CUDA it runs on a GPU where there is one; as C++ on the host.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "examples/common/solver.hpp"
#include "ft/containers/pose_graph.hpp"
#include "ft/pipelines/pose_graph.hpp"
#include "ft/pipelines/pose_graph_files.hpp"

/// The options of optimize_pose_graph alone.
bool take(ft::pose_graph_params& params, std::string const& word, std::string const& value) {
  if (word == "--start" && value == "file") {
    params.start = ft::pose_graph_start::given;
  } else if (word == "--start" && value == "odometry") {
    params.start = ft::pose_graph_start::odometry;
  } else if (word == "--start" && value == "chordal") {
    params.start = ft::pose_graph_start::chordal;
  } else if (word == "--steps") {
    params.steps = demo::whole(word, value, 0);
  } else {
    return false;
  }
  return true;
}

/// A circle whose measured turns are a little too small, and the loop that tells.
ft::pose_graph circle() {
  ft::pose_graph graph;
  double const turn = 0.98 * 2 * 3.14159265358979 / 100;
  ft::rigid<double> const step{
      {{std::cos(turn), -std::sin(turn), 0, std::sin(turn), std::cos(turn), 0, 0, 0, 1}},
      {1, 0, 0}};
  graph.T_world_pose.push_back(ft::rigid<double>::identity());
  for (int i = 1; i < 100; ++i) {
    graph.T_world_pose.push_back((graph.T_world_pose.back() * step).orthonormalized());
    ft::pose_graph_edge edge;
    edge.from = i - 1;
    edge.to = i;
    edge.T_from_to = step;
    graph.edges.push_back(edge);
  }
  ft::pose_graph_edge loop;
  loop.from = 99;
  loop.to = 0;
  loop.T_from_to = step;
  graph.edges.push_back(loop);
  return graph;
}

/// A file, read once: it may be a pipe.
std::string text_of(std::string const& path) {
  std::ifstream in(path);
  std::ostringstream text;
  if (!in || (in.peek() != std::ifstream::traits_type::eof() && !(text << in.rdbuf()))) {
    throw std::runtime_error(path + ": cannot be read");
  }
  return text.str();
}

/// Whether a file's poses have scales: what its first pose or edge is.
bool has_scales(std::string const& text) {
  std::istringstream in(text);
  std::string tag;
  for (std::string line; std::getline(in, line);) {
    tag = line.substr(0, line.find(':'));
    if (tag.rfind("VERTEX_", 0) == 0 || tag.rfind("EDGE_", 0) == 0) { break; }
  }
  return tag == "VERTEX_SIM3" || tag == "EDGE_SIM3";
}

template <typename Graph>
Graph with_poses(Graph graph, std::string const& path) {
  if (graph.T_world_pose.empty()) { throw std::runtime_error(path + ": it has no poses"); }
  return graph;
}

template <typename Exec, typename Graph>
bool optimize(Exec const& exec, char const* where, demo::solver_options const& o,
              ft::pose_graph_params const& params, Graph const& given) {
  Graph graph;
  ft::pose_graph_report report;
  std::vector<double> times;
  for (int k = 0; k < o.repeat; ++k) {
    graph = given;
    times.push_back(demo::timed([&] { report = ft::optimize_pose_graph(exec, graph, params); }));
  }
  std::printf("%zu poses, %zu edges, %lld blocks, %d poses dense, %.1f MB\n",
              graph.T_world_pose.size(), graph.edges.size(), report.blocks, report.dense_poses,
              static_cast<double>(report.bytes) * 1e-6);
  std::printf("chi2 %.7g, at the start %.7g, after %d steps %.10g%s\n", report.given_chi2,
              report.first_chi2, report.steps, report.last_chi2,
              report.converged ? "" : " (not converged)");
  if (!report.started) { std::puts("the start has no solution: the file's poses were taken"); }
  demo::print_times(where, times);
  if (!o.out.empty()) { ft::write_g2o(o.out, graph); }
  return report.converged;
}

template <typename Exec>
bool optimize(Exec const& exec, char const* where, demo::solver_options const& o,
              ft::pose_graph_params const& params) {
  if (o.in.empty()) { return optimize(exec, where, o, params, circle()); }
  std::string const text = text_of(o.in);
  std::istringstream in(text);
  try {
    if (has_scales(text)) {
      return optimize(exec, where, o, params, with_poses(ft::read_g2o_similarities(in), o.in));
    }
    return optimize(exec, where, o, params, with_poses(ft::read_g2o(in), o.in));
  } catch (ft::error const& e) { throw std::runtime_error(o.in + ": " + e.what()); }
}

int main(int argc, char** argv) {
  return demo::guarded([&] {
    ft::pose_graph_params params;
    auto const o = demo::parse(argc, argv, "graphs", [&](auto&, auto const&... option) {
      return take(params, option...);
    });
    return demo::solve(o, "optimize_pose_graph", [&](auto const& exec, auto* where) {
      return optimize(exec, where, o, params);
    });
  });
}
