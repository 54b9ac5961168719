// SPDX-License-Identifier: Apache-2.0
// The section of words, relocalisation and the start with one camera.
#include <cstdio>
#include <vector>

#include "bench/sections.hpp"
#include "examples/sequence/report.hpp"

namespace bench {

namespace {

/// Times a case, and adds its row to the results.
void time_case(context const& c, char const* name, words_case const& what) {
  auto const runner = make_words_runner(what);
  // All inputs are checked, before and after.
  int found = 0;
  auto const check = [&] {
    for (int i = 0; i < words_runner::inputs; ++i) {
      runner->run();
      found = runner->found();
    }
  };
  check();
  for (int i = 0; i < c.how.warm_up_on(what.backend); ++i) { runner->run(); }
  std::vector<double> us;
  for (int i = 0; i < c.how.frames_on(what.backend); ++i) { us.push_back(runner->run()); }
  check();
  auto const t = seq::summarise(us);
  (*c.out)["words"].push_back({{"name", name},
                               {"backend", name_of(what.backend)},
                               {"host_threads", what.backend == backend_type::host ? 1 : 0},
                               {"count", what.count},
                               {"calls", us.size()},
                               {"mean_us", t.mean},
                               {"p50_us", t.p50},
                               {"p99_us", t.p99},
                               {"found", found}});
  std::printf(" %10.1f %10.1f", t.p50, t.p99);
  if (what.backend == backend_type::host) { std::printf(" %8d", found); }
  std::fflush(stdout);
}

}  // namespace

void words_section(context const& c, backend_type b) {
  struct named {
    char const* name;
    words_stage stage;
    int count;
  };
  constexpr named cases[] = {
      {"transform of frames", words_stage::transform, 1},
      {"transform of frames", words_stage::transform, 64},
      {"query of keyframes", words_stage::query, 5000},
      {"search by words in keyframes", words_stage::search, 1},
      {"search by words in keyframes", words_stage::search, 11},
      {"poses of candidates", words_stage::solve, 10},
      {"relocalisation among candidates", words_stage::relocalize, 10},
      {"two views", words_stage::two_views, 1},
      {"start: grid, search, two views", words_stage::start, 1},
  };
  bool const cuda = b == backend_type::cuda;
  std::printf("\nWords, relocalisation, the start with one camera; microseconds of a call\n");
  std::printf("%-34s %6s", "what", "count");
  if (cuda) { std::printf(" %10s %10s", "cuda p50", "p99"); }
  std::printf(" %10s %10s %8s\n", "1 core p50", "p99", "found");
  for (named const& n : cases) {
    words_case what;
    what.stage = n.stage;
    what.count = n.count;
    std::printf("%-34s %6d", n.name, n.count);
    if (cuda) {
      what.backend = backend_type::cuda;
      time_case(c, n.name, what);
      what.backend = backend_type::host;
    }
    time_case(c, n.name, what);
    std::printf("\n");
  }
}

}  // namespace bench
