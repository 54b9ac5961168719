// SPDX-License-Identifier: Apache-2.0
// Maps for measurements, and Ceres Solver on them.
//   ft_bundles make VIEWS POINTS OUT.txt [OUTLIERS]   laps of a circle; a share of false
//   observations ft_bundles ceres IN.txt [THREADS [HUBER]]         ITERATIVE_SCHUR with
//   SCHUR_JACOBI
// ft's own times: examples/adjust_map --repeat N.
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <string>

#include "bench/bundles/ceres_solution.hpp"
#include "ft/pipelines/bundle_files.hpp"
#include "tests/support/bundles.hpp"

namespace {

int usage() {
  std::fputs(
      "ft_bundles make VIEWS POINTS OUT.txt [OUTLIERS]\n"
      "ft_bundles ceres IN.txt [THREADS [HUBER]]\n",
      stderr);
  return EXIT_FAILURE;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    std::string const what = argc > 1 ? argv[1] : "";
    if (what == "make" && (argc == 5 || argc == 6)) {
      test::bundle_shape shape{std::atoi(argv[2]), std::atoi(argv[3])};
      if (argc == 6) { shape.outliers = std::atof(argv[5]); }
      auto map =
          test::make_bundle<ft::radtan4<double>>(shape, {{400, 400, 0, 0, {-0.05, 0.01, 0, 0}}}, 1)
              .map;
      ft::write_bal(argv[4], map);
      return EXIT_SUCCESS;
    }
    if (what == "ceres" && argc >= 3 && argc <= 5) {
      auto map = ft::read_bal(argv[2]);
      bench::ceres_choice choice;
      choice.threads = argc > 3 ? std::atoi(argv[3]) : 16;
      if (argc == 5) { choice.huber = std::atof(argv[4]); }
      auto const found = bench::solve_by_ceres(map, choice);
      std::printf(
          "%zu views, %zu points, %zu observations, %d threads: cost %.10g, %d steps, %.2f "
          "ms (%s)\n",
          map.T_cw.size(), map.position.size(), map.pixel.size(), choice.threads, found.cost,
          found.steps, found.milliseconds, found.message.c_str());
      return EXIT_SUCCESS;
    }
    return usage();
  } catch (std::exception const& e) {
    std::fprintf(stderr, "%s\n", e.what());
    return EXIT_FAILURE;
  }
}
