// SPDX-License-Identifier: Apache-2.0
// Pose graphs for measurements, and Ceres Solver on them.
//   pose_graphs make POSES LOOPS APART OUT.g2o    a walk; loops between poses about APART apart
//                                                 (0: any)
//   pose_graphs make_similarities ...             the same, of poses with scales that drift
//   pose_graphs ceres IN.g2o [THREADS [REPEAT]]   analytic derivatives, sparse Cholesky
// ft's own times: examples/optimize_pose_graph --repeat N.
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <string>

#include "ft/pipelines/pose_graph_files.hpp"
#include "tests/support/pose_graphs.hpp"

#if __has_include(<ceres/ceres.h>)
#include "bench/pose_graphs/ceres_solution.hpp"
#define FT_BENCH_HAS_CERES 1
#else
#define FT_BENCH_HAS_CERES 0
#endif

namespace {

int number(char const* text) { return std::atoi(text); }

int usage() {
  std::fputs(
      "pose_graphs make|make_similarities POSES LOOPS APART OUT.g2o\n"
      "pose_graphs ceres IN.g2o [THREADS [REPEAT]]\n",
      stderr);
  return EXIT_FAILURE;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    std::string const what = argc > 1 ? argv[1] : "";
    bool const scales = what == "make_similarities";
    if ((what == "make" || scales) && argc == 6) {
      test::graph_shape shape{number(argv[2]), number(argv[3])};
      shape.apart = number(argv[4]);
      if (scales) {
        ft::write_g2o(argv[5], test::make_similarity_graph(shape, 1).graph);
      } else {
        ft::write_g2o(argv[5], test::make_graph(shape, 1).graph);
      }
      return EXIT_SUCCESS;
    }
#if FT_BENCH_HAS_CERES
    if (what == "ceres" && argc >= 3 && argc <= 5) {
      auto const given = ft::read_g2o(argv[2]);
      int const threads = argc > 3 ? number(argv[3]) : 16;
      int const repeat = argc > 4 ? number(argv[4]) : 1;
      for (int k = 0; k < repeat; ++k) {
        auto graph = given;
        auto const found = bench::solve_by_ceres(graph, threads);
        std::printf("%zu poses, %zu edges, %d threads: chi2 %.10g, %d steps, %.2f ms (%s)\n",
                    graph.T_world_pose.size(), graph.edges.size(), threads, found.chi2, found.steps,
                    found.milliseconds, found.message.c_str());
        for (std::size_t s = 0; s < found.chi2_after.size(); ++s) {
          std::printf("  step %2zu: %10.2f ms, chi2 %.10g\n", s, found.milliseconds_after[s],
                      found.chi2_after[s]);
        }
      }
      return EXIT_SUCCESS;
    }
#endif
    return usage();
  } catch (std::exception const& e) {
    std::fprintf(stderr, "%s\n", e.what());
    return EXIT_FAILURE;
  }
}
