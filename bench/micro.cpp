// SPDX-License-Identifier: Apache-2.0
// Single stages on Google Benchmark, over image size x features x batch x executor, and the camera
// models over their functions. Times are manual: the wall clock on the host, events that are nodes
// of a recorded graph on a device. Each iteration runs a whole frame, with other images than
// the preceding one.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <map>
#include <memory>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "bench/clock.hpp"
#include "bench/runner.hpp"
#include "bench/scene.hpp"

namespace {

struct size_axis {
  bench::rig_type rig;
  int width, height;
};

struct point {
  bench::backend_type backend;
  size_axis size;
  int features;
  int batch;

  auto key() const {
    return std::make_tuple(backend, size.rig, size.width, size.height, features, batch);
  }
};

/// The runner of the last benchmarks. Benchmarks are registered so that neighbours share it.
class workshop {
public:
  /// @throws bench::no_memory, std::runtime_error
  bench::frame_runner& get(point const& p) {
    if (runner_ && p.key() == runner_key_) { return *runner_; }
    runner_.reset();
    auto const scene_key = std::make_tuple(p.size.rig, p.size.width, p.size.height);
    if (!scene_ || scene_key != scene_key_) {
      scene_ = std::make_unique<bench::scene>(bench::make_scene(
          p.size.rig, p.size.width, p.size.height, images, p.features, local_points));
      scene_key_ = scene_key;
    }
    scene_->features = p.features;
    bench::frame_options o;
    o.backend = p.backend;
    o.batch = p.batch;
    o.measure_stages = true;
    runner_ = bench::make_frame_runner(*scene_, o);
    runner_key_ = p.key();
    runner_->stage_times(0);
    return *runner_;
  }
  int next_frame() { return frame_++; }

private:
  static constexpr int images = 16;
  static constexpr int local_points = 3000;
  std::unique_ptr<bench::scene> scene_;
  std::tuple<bench::rig_type, int, int> scene_key_;
  std::unique_ptr<bench::frame_runner> runner_;
  decltype(std::declval<point const&>().key()) runner_key_;
  int frame_ = 1;
};

workshop& shop() {
  static workshop w;
  return w;
}

void run_stage(benchmark::State& state, point const& p, std::string const& stage) {
  try {
    auto& runner = shop().get(p);
    for (auto _ : state) {
      bool found = false;
      for (auto const& s : runner.stage_times(shop().next_frame())) {
        if (s.name != stage) { continue; }
        state.SetIterationTime(1e-6 * s.us);
        found = true;
      }
      if (!found) {
        state.SkipWithError("no such stage");
        break;
      }
    }
    state.SetItemsProcessed(state.iterations() * p.batch);
  } catch (std::exception const& e) { state.SkipWithError(e.what()); }
}

void run_frame(benchmark::State& state, point const& p) {
  try {
    auto& runner = shop().get(p);
    for (auto _ : state) {
      runner.prepare(shop().next_frame());
      double const start = bench::now_us();
      runner.launch(bench::call_type::whole);
      runner.wait();
      state.SetIterationTime(1e-6 * (bench::now_us() - start));
    }
    state.SetItemsProcessed(state.iterations() * p.batch);
  } catch (std::exception const& e) { state.SkipWithError(e.what()); }
}

void run_camera(benchmark::State& state, bench::camera_runner& runner, int number, int points) {
  try {
    runner.select(number);
    runner.run(0, 4);
    int first = 0;
    for (auto _ : state) { state.SetIterationTime(1e-6 * runner.run(first++, 1)); }
    state.SetItemsProcessed(state.iterations() * points);
  } catch (std::exception const& e) { state.SkipWithError(e.what()); }
}

void run_window(benchmark::State& state, bench::window_case const& what) {
  try {
    auto const runner = bench::make_window_runner(what);
    runner->run();
    for (auto _ : state) { state.SetIterationTime(1e-6 * runner->run()); }
    if (!(runner->gained() > 0)) { state.SkipWithError("nothing was adjusted"); }
    state.SetItemsProcessed(state.iterations() * what.batch);
  } catch (std::exception const& e) { state.SkipWithError(e.what()); }
}

void run_matching(benchmark::State& state, bench::matching_case const& what) {
  try {
    auto const runner = bench::make_matching_runner(what);
    runner->run();
    for (auto _ : state) { state.SetIterationTime(1e-6 * runner->run()); }
    if (!(runner->matched_share() > 0.4)) { state.SkipWithError("little was matched"); }
    state.SetItemsProcessed(state.iterations() * what.rows * what.rows);
  } catch (std::exception const& e) { state.SkipWithError(e.what()); }
}

/// Descriptors of each model, all with all.
void add_matching(std::vector<bench::backend_type> const& backends, int device_iterations,
                  int host_iterations) {
  for (auto const b : backends) {
    for (char const* const model : bench::matching_models) {
      for (int const rows : {1000, 8000}) {
        for (bool const mutual : {false, true}) {
          bench::matching_case const what{b, 0, model, rows, mutual};
          std::string const name = std::string("match/") + model + "/rows:" + std::to_string(rows) +
                                   (mutual ? "/mutual/" : "/one_way/") + name_of(b);
          benchmark::RegisterBenchmark(name.c_str(),
                                       [what](benchmark::State& s) { run_matching(s, what); })
              ->UseManualTime()
              ->Unit(benchmark::kMicrosecond)
              ->Iterations(b == bench::backend_type::host ? host_iterations : device_iterations);
        }
      }
    }
  }
}

/// Bundle adjustments: the default window alone and in a batch, larger ones.
void add_windows(std::vector<bench::backend_type> const& backends, int device_iterations,
                 int host_iterations) {
  for (auto const b : backends) {
    bool const host = b == bench::backend_type::host;
    std::vector<bench::window_case> cases{{b, 0, 1, 13, 5, 2000, 3}, {b, 0, 1, 15, 5, 4000, 3}};
    if (!host) {
      cases.push_back({b, 0, 64, 13, 5, 2000, 3});
      cases.push_back({b, 0, 1, 64, 5, 4000, 3});
    }
    for (auto const& w : cases) {
      std::string const name =
          "window/views:" + std::to_string(w.views) + "/fixed:" + std::to_string(w.fixed) +
          "/points:" + std::to_string(w.points) + "/steps:" + std::to_string(w.steps) +
          "/batch:" + std::to_string(w.batch) + "/" + name_of(b);
      benchmark::RegisterBenchmark(name.c_str(), [w](benchmark::State& s) { run_window(s, w); })
          ->UseManualTime()
          ->Unit(benchmark::kMicrosecond)
          ->Iterations(host ? host_iterations : device_iterations);
    }
  }
}

/// Removes "--ft_NAME=VALUE" from the arguments.
int take_option(int& argc, char** argv, std::string const& name, int value) {
  std::string const start = "--ft_" + name + "=";
  for (int i = 1; i < argc; ++i) {
    std::string const argument = argv[i];
    if (argument.rfind(start, 0) != 0) { continue; }
    char* end = nullptr;
    long const given = std::strtol(argv[i] + start.size(), &end, 10);
    if (*end != 0 || given < 1 || given > 1000000) {
      std::cerr << "ft_microbench: " << argument << ": must be a number from 1 to 1000000\n";
      std::exit(1);
    }
    value = static_cast<int>(given);
    for (int k = i; k + 1 < argc; ++k) { argv[k] = argv[k + 1]; }
    --argc;
    break;
  }
  return value;
}

}  // namespace

int main(int argc, char** argv) {
  for (int i = 1; i < argc; ++i) {
    if (std::string(argv[i]) == "--help") {
      std::printf(
          "ft_microbench: single stages of ft over image size, features, batch, executor\n"
          "          [--ft_device_iterations=<n>]  frames a benchmark on a device (200)\n"
          "          [--ft_host_iterations=<n>]    and on the host (8)\n");
    }
  }
  int const device_iterations = take_option(argc, argv, "device_iterations", 200);
  int const host_iterations = take_option(argc, argv, "host_iterations", 8);
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) { return 1; }

  std::vector<std::string> const stages{"upload",
                                        "pyramid",
                                        "corners",
                                        "distribution",
                                        "blur",
                                        "order",
                                        "descriptors",
                                        "stereo",
                                        "search last frame",
                                        "pose last frame",
                                        "search local map",
                                        "pose local map",
                                        "result"};
  using bench::backend_type;
  using bench::rig_type;
  std::vector<backend_type> backends{backend_type::host};
  std::string const gpu = bench::cuda_description();
  if (!gpu.empty()) {
    backends.push_back(backend_type::cuda);
    benchmark::AddCustomContext("gpu", gpu);
  }
  std::vector<point> points;
  for (size_axis const& size :
       {size_axis{rig_type::rectified, 640, 480}, size_axis{rig_type::rectified, 752, 480},
        size_axis{rig_type::rectified, 1241, 376}, size_axis{rig_type::rectified, 1920, 1080},
        size_axis{rig_type::fisheye, 512, 512}}) {
    for (int features : {500, 1000, 1200, 2000}) {
      bool const fisheye = size.rig == rig_type::fisheye;
      if (fisheye != (features == 1000)) { continue; }
      for (auto const b : backends) {
        points.push_back({b, size, features, 1});
        if (b == backend_type::cuda && size.width == 752 && features == 1200) {
          points.push_back({b, size, features, 8});
          points.push_back({b, size, features, 64});
        }
      }
    }
  }
  for (point const& p : points) {
    std::string const axes = std::string("/") + name_of(p.size.rig) + "/" +
                             std::to_string(p.size.width) + "x" + std::to_string(p.size.height) +
                             "/features:" + std::to_string(p.features) +
                             "/batch:" + std::to_string(p.batch) + "/" + name_of(p.backend);
    int const iterations = p.backend == backend_type::cuda ? device_iterations : host_iterations;
    auto const add = [&](std::string const& name, auto const& function) {
      std::string plain = name + axes;
      std::replace(plain.begin(), plain.end(), ' ', '_');
      benchmark::RegisterBenchmark(plain.c_str(), function)
          ->UseManualTime()
          ->Unit(benchmark::kMicrosecond)
          ->Iterations(iterations);
    };
    add("frame", [p](benchmark::State& s) { run_frame(s, p); });
    for (std::string const& stage : stages) {
      add(stage, [p, stage](benchmark::State& s) { run_stage(s, p, stage); });
    }
  }
  add_windows(backends, device_iterations, host_iterations);
  add_matching(backends, device_iterations, host_iterations);
  std::vector<std::unique_ptr<bench::camera_runner>> cameras;
  try {
    for (auto const b : backends) {
      int const count = b == backend_type::cuda ? 1 << 20 : 1 << 14;
      cameras.push_back(bench::make_camera_runner(b, 1, count, 4));
      auto const& cases = cameras.back()->cases();
      for (std::size_t k = 0; k < cases.size(); ++k) {
        std::string const name =
            cases[k].op + "/" + cases[k].model + "/" + cases[k].scalar + "/" + name_of(b);
        bench::camera_runner* const runner = cameras.back().get();
        benchmark::RegisterBenchmark(name.c_str(),
                                     [runner, k, count](benchmark::State& s) {
                                       run_camera(s, *runner, static_cast<int>(k), count);
                                     })
            ->UseManualTime()
            ->Unit(benchmark::kMicrosecond)
            ->Iterations(100);
      }
    }
    benchmark::RunSpecifiedBenchmarks();
  } catch (std::exception const& e) {
    std::cerr << "ft_microbench: " << e.what() << "\n";
    return 1;
  }
  benchmark::Shutdown();
  return 0;
}
