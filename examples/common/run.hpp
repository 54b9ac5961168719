// SPDX-License-Identifier: Apache-2.0
/// @file Shared by the examples: their executor, and small conversions. The same source runs on the
/// host if a C++ compiler compiles it, and on a GPU if nvcc does.
#pragma once

#include <cstdio>
#include <cstdlib>
#include <exception>
#include <string>

#include "examples/common/scene.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/views.hpp"
#include "ft/pipelines/orb_extractor.hpp"

namespace demo {

/// The exit status that ctest takes as "skipped".
constexpr int skipped = 77;

inline ft::gray_view view(grey_image const& image) {
  return {image.pixels.data(), image.width, image.height, image.width};
}

inline ft::orb_params params_for(grey_image const& image) {
  ft::orb_params params;
  params.width = image.width;
  params.height = image.height;
  return params;
}

#if defined(__CUDACC__)

inline bool has_device() {
  int devices = 0;
  return cudaGetDeviceCount(&devices) == cudaSuccess && devices > 0;
}

/// Prints that no device was found. @return skipped; a failure if FT_REQUIRE_GPU=1
inline int no_device() {
  std::puts("no CUDA device was found: nothing was run");
  char const* const required = std::getenv("FT_REQUIRE_GPU");
  return required != nullptr && std::string(required) == "1" ? EXIT_FAILURE : skipped;
}

#endif

/// Runs the body of an example and prints its exceptions. @return the program's exit status
template <typename Body>
int guarded(Body const& body) {
  try {
    return body();
  } catch (std::exception const& e) {
    std::fprintf(stderr, "%s\n", e.what());
    return EXIT_FAILURE;
  }
}

/// Calls work(executor): a stream of a GPU if compiled as CUDA, else the host's threads.
template <typename Work>
int run(Work const& work) {
  return guarded([&] {
#if defined(__CUDACC__)
    if (!has_device()) { return no_device(); }
    ft::stream const mine;
    return work(ft::cuda_exec(mine.get()));
#else
    return work(ft::host_exec());
#endif
  });
}

/// Prints whether an example got the expected result. @return the program's exit status
inline int verdict(bool good) {
  if (!good) { std::puts("that is not what was expected"); }
  return good ? EXIT_SUCCESS : EXIT_FAILURE;
}

}  // namespace demo
