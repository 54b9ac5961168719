// SPDX-License-Identifier: Apache-2.0
/// @file The measurements, once for both executors.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "bench/frame_bench.hpp"
#include "examples/track_sequence/stage_timer.hpp"

namespace bench {

template <typename Exec>
void measure(Exec const& exec, std::string const& backend, scene const& s, settings const& how,
             std::vector<measurement>& out) {
  auto const add = [&](std::string name, int batch, std::vector<double> us,
                       frame_bench<Exec> const& b) {
    out.push_back(
        {std::move(name), backend, batch, std::move(us), b.mean_inliers(), b.map_points_});
  };
  for (bool optimize : {false, true}) {
    std::string const suffix = optimize ? ", with pose optimisation" : "";
    frame_bench<Exec> one(exec, s, 1, optimize);
    add("frame" + suffix, 1, one.run(how.warm_up, how.frames, false), one);
    add("frame in two halves" + suffix, 1, one.run(how.warm_up, how.frames, true), one);
  }
  for (int batch : how.batches) {
    frame_bench<Exec> many(exec, s, batch, true);
    add("batch of frames, with pose optimisation", batch,
        many.run(how.warm_up / 4, how.frames / 4, false), many);
  }
  if (how.stages) {
    frame_bench<Exec> one(exec, s, 1, true);
    std::vector<std::string> const names{"upload",
                                         "pyramid",
                                         "corners",
                                         "distribution",
                                         "blur",
                                         "descriptors",
                                         "grid",
                                         "stereo",
                                         "search last frame",
                                         "pose last frame",
                                         "frustum",
                                         "search local map",
                                         "pose local map",
                                         "download"};
    app::stage_sums sums(names);
    app::stage_timer<Exec> timer(exec);
    std::map<std::string, std::vector<double>> by_stage;
    for (int i = 0; i < how.warm_up + how.frames / 4; ++i) {
      one.prepare(i);
      sums.reset();
      timer.start();
      one.tracker().track(exec, [&](char const* stage) { timer.mark(stage, sums); });
      exec.wait();
      timer.collect(sums);
      one.remember();
      for (std::size_t k = 0; i >= how.warm_up && k < names.size(); ++k) {
        by_stage[names[k]].push_back(1000.0 * sums.ms()[k]);
      }
    }
    for (auto const& name : names) { add("stage: " + name, 1, by_stage[name], one); }
  }
}

}  // namespace bench
