// SPDX-License-Identifier: Apache-2.0
// Adjusts a map in the text format of "Bundle adjustment in the large" (BAL).
//   adjust_map [IN.txt] [--out OUT.txt] [--backend host|cuda] [--huber WIDTH] [--steps N]
//              [--threads N] [--repeat N]
// Without IN.txt: twelve views of a wall, made here. Compiled as CUDA it runs on a GPU where there
// is one; as C++ on the host.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <stdexcept>
#include <string>
#include <vector>

#include "ft/cameras/radtan.hpp"
#include "ft/containers/bundle.hpp"
#include "ft/core/cuda_handles.hpp"
#include "ft/core/execution.hpp"
#include "ft/pipelines/adjust_map.hpp"
#include "ft/pipelines/bundle_files.hpp"

using camera = ft::radtan4<double>;

struct options {
  std::string in, out, backend;
  ft::map_params params;
  int threads = 0;
  int repeat = 1;
};

int whole(std::string const& name, std::string const& text, long least) {
  char* end = nullptr;
  long const v = std::strtol(text.c_str(), &end, 10);
  if (text.empty() || *end != '\0' || v < least || v > 1000000) {
    throw std::invalid_argument(name + " " + text + " is not a whole number in range");
  }
  return static_cast<int>(v);
}

double positive(std::string const& name, std::string const& text) {
  char* end = nullptr;
  double const v = std::strtod(text.c_str(), &end);
  if (text.empty() || *end != '\0' || !(v >= 0 && v < 1e50)) {
    throw std::invalid_argument(name + " " + text + " is not a number in range");
  }
  return v;
}

options parse(int argc, char** argv) {
  options o;
  for (int i = 1; i < argc; ++i) {
    std::string const word = argv[i];
    if (word.rfind("--", 0) != 0) {
      if (!o.in.empty()) {
        throw std::invalid_argument("two maps are named: " + o.in + ", " + word);
      }
      o.in = word;
      continue;
    }
    if (i + 1 == argc) { throw std::invalid_argument(word + " needs a value"); }
    std::string const value = argv[++i];
    if (word == "--out") {
      o.out = value;
    } else if (word == "--backend" && (value == "host" || value == "cuda")) {
      o.backend = value;
    } else if (word == "--huber") {
      o.params.huber = positive(word, value);
    } else if (word == "--steps") {
      o.params.steps = whole(word, value, 0);
    } else if (word == "--threads") {
      o.threads = whole(word, value, 0);
    } else if (word == "--repeat") {
      o.repeat = whole(word, value, 1);
    } else {
      throw std::invalid_argument(word + " " + value + " is not known");
    }
  }
  return o;
}

/// Views along a wall of points, each a little off.
ft::bundle<camera> wall() {
  ft::bundle<camera> map;
  map.cameras.push_back({400, 400, 0, 0, {-0.05, 0.01, 0, 0}});
  for (int v = 0; v < 12; ++v) {
    map.T_cw.push_back(ft::rigid<double>::identity());
    map.T_cw.back().t = {-0.2 * v, 0, 0};
  }
  for (int p = 0; p < 60; ++p) {
    ft::vec3<double> const X{0.2 * (p % 12), 0.3 * (p / 12 - 2), 4 + 0.5 * std::sin(1.0 * p)};
    for (int v = std::max(0, p % 12 - 3); v < std::min(12, p % 12 + 4); ++v) {
      map.observing_view.push_back(v);
      map.observed_point.push_back(p);
      auto const image = map.cameras[0].project(map.T_cw[static_cast<std::size_t>(v)] * X);
      map.pixel.push_back({image.pixel.x + 0.3 * std::sin(7.0 * p + v),
                           image.pixel.y + 0.3 * std::cos(5.0 * p + 3 * v)});
    }
    map.position.push_back({X.x, X.y, X.z + 0.2 * std::cos(3.0 * p)});
  }
  for (int v = 2; v < 12; ++v) {
    map.T_cw[static_cast<std::size_t>(v)].t.y = 0.02 * std::sin(2.0 * v);
  }
  map.fixed.assign(12, 0);
  map.fixed[0] = map.fixed[1] = 1;
  return map;
}

char const* text_of(ft::map_outcome outcome) {
  switch (outcome) {
    case ft::map_outcome::converged:
      return "converged";
    case ft::map_outcome::out_of_steps:
      return "out of steps";
    case ft::map_outcome::stuck:
      return "stuck";
  }
  return "";
}

template <typename Exec>
bool adjust(Exec const& exec, char const* where, options const& o) {
  ft::bundle<camera> const given = o.in.empty() ? wall() : ft::read_bal(o.in);
  ft::bundle<camera> map;
  ft::map_report report;
  std::vector<double> times;
  for (int k = 0; k < o.repeat; ++k) {
    map = given;
    auto const begin = std::chrono::steady_clock::now();
    report = ft::adjust_map(exec, map, o.params);
    auto const end = std::chrono::steady_clock::now();
    times.push_back(std::chrono::duration<double, std::milli>(end - begin).count());
  }
  std::printf("%zu views, %zu points, %zu observations, %.1f MB\n", map.T_cw.size(),
              map.position.size(), map.pixel.size(), static_cast<double>(report.bytes) * 1e-6);
  std::printf("cost %.10g, after %d steps (%d refused, %lld of conjugate gradients) %.10g: %s\n",
              report.first_cost, report.steps, report.refused, report.solver_steps,
              report.last_cost, text_of(report.outcome));
  std::printf("without an image: %d observations, after it %d\n", report.first_without_image,
              report.last_without_image);
  double const first = times.front();
  std::sort(times.begin(), times.end());
  std::printf("on the %s: first call %.2f ms; of %d: least %.2f ms, median %.2f ms\n", where, first,
              o.repeat, times.front(), times[times.size() / 2]);
  if (!o.out.empty()) { ft::write_bal(o.out, map); }
  return report.outcome == ft::map_outcome::converged;
}

bool run(options const& o) {
#if defined(__CUDACC__)
  if (o.backend != "host") {
    int devices = 0;
    bool const found = cudaGetDeviceCount(&devices) == cudaSuccess && devices > 0;
    if (!found && o.backend == "cuda") { throw std::runtime_error("no CUDA device was found"); }
    if (found) {
      ft::stream const mine;
      return adjust(ft::cuda_exec(mine.get()), "GPU", o);
    }
  }
#else
  if (o.backend == "cuda") {
    throw std::runtime_error("this program was compiled for the host: use adjust_map_cuda");
  }
#endif
  return adjust(ft::host_exec(o.threads), "host", o);
}

int main(int argc, char** argv) {
  try {
    return run(parse(argc, argv)) ? EXIT_SUCCESS : EXIT_FAILURE;
  } catch (std::exception const& e) {
    std::fprintf(stderr, "%s\n", e.what());
    return EXIT_FAILURE;
  }
}
