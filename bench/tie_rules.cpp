// SPDX-License-Identifier: Apache-2.0
// The cost of the quadtree's tie rule std_sort: frames with each rule in turn.
#include <algorithm>
#include <cstddef>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "bench/clock.hpp"
#include "bench/sections.hpp"
#include "examples/sequence/report.hpp"

namespace bench {

namespace {

constexpr int rules = 2;
constexpr char const* rule_names[rules] = {"stable", "std_sort"};

/// Times of one rule, microseconds.
struct rule_times {
  std::vector<double> frame;         ///< in one call
  std::vector<double> distribution;  ///< only that stage
};

double time_frame(frame_runner& r, int i) {
  r.prepare(i);
  double const start = now_us();
  r.launch(call_type::whole);
  r.wait();
  return now_us() - start;
}

std::vector<rule_times> time_rules(scene const& s, backend_type b, int warm_up, int frames) {
  std::vector<std::unique_ptr<frame_runner>> runners;
  std::vector<std::unique_ptr<frame_runner>> measuring;
  for (int rule = 0; rule < rules; ++rule) {
    frame_options o;
    o.backend = b;
    o.std_sort_ties = rule == 1;
    runners.push_back(make_frame_runner(s, o));
    o.measure_stages = true;
    measuring.push_back(make_frame_runner(s, o));
  }
  std::vector<rule_times> times(rules);
  for (int i = 0; i < warm_up + frames; ++i) {
    for (int k = 0; k < rules; ++k) {
      auto const rule = static_cast<std::size_t>((i + k) % rules);  // each of them is first in turn
      double const us = time_frame(*runners[rule], i);
      if (i >= warm_up) { times[rule].frame.push_back(us); }
    }
  }
  for (int i = 0; i < std::max(1, frames / 4); ++i) {
    for (std::size_t rule = 0; rule < rules; ++rule) {
      for (auto const& stage : measuring[rule]->stage_times(i)) {
        if (stage.name == "distribution") { times[rule].distribution.push_back(stage.us); }
      }
    }
  }
  return times;
}

}  // namespace

void tie_rules_section(context const& c, backend_type b) {
  std::printf("\nTie rules of the quadtree, frames in turn\n%-10s %-5s %-9s %10s %10s %14s %10s\n",
              "rig", "on", "rule", "frame p50", "p99 us", "quadtree p50", "p99 us");
  for (rig_type rig : {rig_type::rectified, rig_type::fisheye}) {
    auto const times = time_rules(c.all_scenes->get(rig), b, c.how.warm_up_on(b),
                                  std::max(1, c.how.frames_on(b) / 2));
    for (std::size_t rule = 0; rule < rules; ++rule) {
      auto const frame = seq::summarise(times[rule].frame);
      auto const stage = seq::summarise(times[rule].distribution);
      std::printf("%-10s %-5s %-9s %10.1f %10.1f %14.1f %10.1f\n", name_of(rig), name_of(b),
                  rule_names[rule], frame.p50, frame.p99, stage.p50, stage.p99);
      (*c.out)["tie_rules"].push_back({{"rig", name_of(rig)},
                                       {"backend", name_of(b)},
                                       {"rule", rule_names[rule]},
                                       {"frames", times[rule].frame.size()},
                                       {"frame_p50_us", frame.p50},
                                       {"frame_p99_us", frame.p99},
                                       {"distribution_p50_us", stage.p50},
                                       {"distribution_p99_us", stage.p99}});
    }
    std::fflush(stdout);
  }
}

}  // namespace bench
