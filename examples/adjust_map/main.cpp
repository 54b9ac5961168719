// SPDX-License-Identifier: Apache-2.0
// Adjusts a map in the text format of "Bundle adjustment in the large" (BAL).
//   adjust_map [IN.txt] [--out OUT.txt] [--backend host|cuda] [--huber WIDTH] [--steps N]
//              [--threads N] [--repeat N]
// Without IN.txt: twelve views of a wall, made here. Compiled as CUDA it runs on a GPU where there
// is one; as C++ on the host.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <stdexcept>
#include <string>
#include <vector>

#include "examples/common/solver.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/containers/bundle.hpp"
#include "ft/pipelines/adjust_map.hpp"
#include "ft/pipelines/bundle_files.hpp"

using camera = ft::radtan4<double>;

double positive(std::string const& name, std::string const& text) {
  char* end = nullptr;
  double const v = std::strtod(text.c_str(), &end);
  if (text.empty() || *end != '\0' || !(v >= 0 && v < 1e50)) {
    throw std::invalid_argument(name + " " + text + " is not a number in range");
  }
  return v;
}

/// The options of adjust_map alone.
bool take(demo::solver_options& o, ft::map_params& params, std::string const& word,
          std::string const& value) {
  if (word == "--huber") {
    params.huber = positive(word, value);
  } else if (word == "--steps") {
    params.steps = demo::whole(word, value, 0);
  } else if (word == "--threads") {
    o.threads = demo::whole(word, value, 0);
  } else {
    return false;
  }
  return true;
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
bool adjust(Exec const& exec, char const* where, demo::solver_options const& o,
            ft::map_params const& params) {
  ft::bundle<camera> const given = o.in.empty() ? wall() : ft::read_bal(o.in);
  ft::bundle<camera> map;
  ft::map_report report;
  std::vector<double> times;
  for (int k = 0; k < o.repeat; ++k) {
    map = given;
    times.push_back(demo::timed([&] { report = ft::adjust_map(exec, map, params); }));
  }
  std::printf("%zu views, %zu points, %zu observations, %.1f MB\n", map.T_cw.size(),
              map.position.size(), map.pixel.size(), static_cast<double>(report.bytes) * 1e-6);
  std::printf("cost %.10g, after %d steps (%d refused, %lld of conjugate gradients) %.10g: %s\n",
              report.first_cost, report.steps, report.refused, report.solver_steps,
              report.last_cost, text_of(report.outcome));
  std::printf("without an image: %d observations, after it %d\n", report.first_without_image,
              report.last_without_image);
  demo::print_times(where, times);
  if (!o.out.empty()) { ft::write_bal(o.out, map); }
  return report.outcome == ft::map_outcome::converged;
}

int main(int argc, char** argv) {
  return demo::guarded([&] {
    ft::map_params params;
    auto const o = demo::parse(argc, argv, "maps", [&](auto& more, auto const&... option) {
      return take(more, params, option...);
    });
    return demo::solve(o, "adjust_map", [&](auto const& exec, char const* where) {
      return adjust(exec, where, o, params);
    });
  });
}
