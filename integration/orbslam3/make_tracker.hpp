// SPDX-License-Identifier: Apache-2.0
/// @file Defines ft::orbslam3::make_tracker(), which front_end.hpp calls. Included in one unit of
/// the program that contains nothing else: a .cu file for CUDA, a .cpp file without.
#pragma once

#include <cstdlib>
#include <iostream>
#include <memory>
#include <string>

#include "ft/core/error.hpp"
#include "integration/orbslam3/executor_tracker.hpp"

namespace ft::orbslam3 {

std::unique_ptr<device_tracker> make_tracker(settings const& s);

/// On the current GPU. On host threads if there is no GPU, if it fails, if the unit was compiled
/// without CUDA, or with FT_ORBSLAM3_DEVICE=host. Prints the choice on stderr.
/// @throws bad_argument for invalid settings
std::unique_ptr<device_tracker> make_tracker(settings const& s) {
  char const* const chosen = std::getenv("FT_ORBSLAM3_DEVICE");
  std::string reason = "FT_ORBSLAM3_DEVICE=host";
  if (chosen == nullptr || std::string(chosen) != "host") {
#if defined(__CUDACC__)
    try {
      int device = 0;
      cudaDeviceProp properties;
      cudaError_t status = cudaGetDevice(&device);
      if (status == cudaSuccess) { status = cudaGetDeviceProperties(&properties, device); }
      if (status != cudaSuccess) {
        static_cast<void>(cudaGetLastError());
        throw cuda_error(cudaGetErrorString(status));
      }
      auto tracker = make_cuda_tracker(s);
      std::cerr << "ft: tracking on " << properties.name << "\n";
      return tracker;
    } catch (cuda_error const& e) { reason = e.what(); }
#else
    reason = "compiled without CUDA";
#endif
  }
  std::cerr << "ft: tracking on host threads (" << reason << ")\n";
  return make_host_tracker(s);
}

}  // namespace ft::orbslam3
