// SPDX-License-Identifier: Apache-2.0
// Loops where they must not be closed, starts in a loaded map, and times beside large maps, on
// rendered walls. On a GPU where nvcc compiles it (-x cu), else on the host. Rows of JSON; what was
// not as wanted goes to stderr, one line each.
//
//     loop_cases check                       a few: fails with a wrong loop, where no revisit
//                                            is found or many images are lost, or a start is not
//     loop_cases trials COUNT JOBS [KIND [SEED]]  of kinds 0, 1 a third each, of 2, 3 a sixth; or
//     of
//                                            one, -1: of all; of seeds SEED, SEED + 1, ...
//     loop_cases starts COUNT JOBS [SEED]    the map grows; of seeds SEED, SEED + 1, ...
//     loop_cases localize COUNT JOBS [SEED]  the map stays as it is
//     loop_cases alike COUNT JOBS [SEED]     both, in stretches that look the same
//     same loop_cases flat FRAMES MS KEYFRAMES... a frame each MS milliseconds; 0: without loops
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <string>

#include "tests/end_to_end/loops/flat.hpp"
#include "tests/end_to_end/loops/starts.hpp"
#include "tests/end_to_end/loops/trials.hpp"

namespace {

/// Calls run(exec) with an executor of its own: a thread, or a stream.
struct executor_maker {
  template <typename Run>
  void operator()(Run const& run) const {
#if defined(__CUDACC__)
    ft::stream const own;
    run(ft::cuda_exec(own.get()));
#else
    run(ft::host_exec(1));
#endif
  }
};

int usage() {
  std::fputs(
      "loop_cases check\nloop_cases trials|starts|localize|alike COUNT JOBS\nloop_cases flat "
      "FRAMES MS "
      "KEYFRAMES...\n",
      stderr);
  return EXIT_FAILURE;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    std::string const what = argc > 1 ? argv[1] : "";
    if (what == "check") {
      bool const right = loop_cases::run_trials(6, 2, executor_maker()) == 0 &&
                         loop_cases::run_starts(2, 2, executor_maker(), false) == 0 &&
                         loop_cases::run_starts(2, 2, executor_maker(), true) == 0 &&
                         loop_cases::run_alike_starts(2, 2, executor_maker(), true) == 0;
      return right ? EXIT_SUCCESS : EXIT_FAILURE;
    }
    if (argc < 4) { return usage(); }
    int const count = std::atoi(argv[2]), jobs = std::atoi(argv[3]);
    if (what == "trials" && argc <= 6) {
      auto const seed = static_cast<unsigned>(argc == 6 ? std::atoi(argv[5]) : 0);
      loop_cases::run_trials(count, jobs, executor_maker(), argc > 4 ? std::atoi(argv[4]) : -1,
                             seed);
    } else if ((what == "starts" || what == "localize") && argc <= 5) {
      auto const seed = static_cast<unsigned>(argc == 5 ? std::atoi(argv[4]) : 0);
      loop_cases::run_starts(count, jobs, executor_maker(), what == "localize", seed);
    } else if (what == "alike" && argc <= 5) {
      auto const seed = static_cast<unsigned>(argc == 5 ? std::atoi(argv[4]) : 0);
      for (bool const localize_only : {false, true}) {
        loop_cases::run_alike_starts(count, jobs, executor_maker(), localize_only, seed);
      }
    } else if (what == "flat" && argc > 4) {
      for (int i = 4; i < argc; ++i) {
        soak_scene::on_backend([&](auto const& exec) {
          loop_cases::run_flat(exec, std::atoi(argv[i]), count, jobs);
          return EXIT_SUCCESS;
        });
      }
    } else {
      return usage();
    }
    return EXIT_SUCCESS;
  } catch (std::exception const& e) {
    std::fprintf(stderr, "loop_cases: %s\n", e.what());
    return EXIT_FAILURE;
  }
}
