// SPDX-License-Identifier: Apache-2.0
/// @file Shared by the programs that solve what a file has: their options, executor and times.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <stdexcept>
#include <string>
#include <vector>

#include "examples/common/run.hpp"
#include "ft/core/cuda_handles.hpp"
#include "ft/core/execution.hpp"

namespace demo {

struct solver_options {
  std::string in, out, backend;
  int repeat = 1;
  int threads = 0;
};

inline int whole(std::string const& name, std::string const& text, long least) {
  char* end = nullptr;
  long const v = std::strtol(text.c_str(), &end, 10);
  if (text.empty() || *end != '\0' || v < least || v > 1000000) {
    throw std::invalid_argument(name + " " + text + " is not a whole number in range");
  }
  return static_cast<int>(v);
}

/// @param things what a file has, for a message
/// @param more whether it took another option: bool(solver_options&, word, value)
template <typename More>
solver_options parse(int argc, char** argv, std::string const& things, More const& more) {
  solver_options o;
  for (int i = 1; i < argc; ++i) {
    std::string const word = argv[i];
    if (word.rfind("--", 0) != 0) {
      if (!o.in.empty()) {
        throw std::invalid_argument("two " + things + " are named: " + o.in + ", " + word);
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
    } else if (word == "--repeat") {
      o.repeat = whole(word, value, 1);
    } else if (!more(o, word, value)) {
      throw std::invalid_argument(word + " " + value + " is not known");
    }
  }
  return o;
}

/// Calls work(executor, its name): a GPU's, where the program was compiled as CUDA, there is one
/// and the options do not say otherwise; else the host's. @return the program's exit status
template <typename Work>
int solve(solver_options const& o, std::string const& program, Work const& work) {
#if defined(__CUDACC__)
  if (o.backend != "host") {
    bool const found = has_device();
    if (!found && o.backend == "cuda") { throw std::runtime_error("no CUDA device was found"); }
    if (found) {
      ft::stream const mine;
      return work(ft::cuda_exec(mine.get()), "GPU") ? EXIT_SUCCESS : EXIT_FAILURE;
    }
  }
#else
  if (o.backend == "cuda") {
    throw std::runtime_error("this program was compiled for the host: use " + program + "_cuda");
  }
#endif
  return work(ft::host_exec(o.threads), "host") ? EXIT_SUCCESS : EXIT_FAILURE;
}

/// Of one call, in ms.
template <typename Step>
double timed(Step const& step) {
  auto const begin = std::chrono::steady_clock::now();
  step();
  auto const end = std::chrono::steady_clock::now();
  return std::chrono::duration<double, std::milli>(end - begin).count();
}

inline void print_times(char const* where, std::vector<double> times) {
  double const first = times.front();
  std::sort(times.begin(), times.end());
  std::printf("on the %s: first call %.2f ms; of %zu: least %.2f ms, median %.2f ms\n", where,
              first, times.size(), times.front(), times[times.size() / 2]);
}

}  // namespace demo
