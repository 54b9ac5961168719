// SPDX-License-Identifier: Apache-2.0
/// @file The shim on host threads: for machines without a GPU, and for tests.
#pragma once

#include <memory>

#include "integration/orbslam3/make_tracker_on.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

/// @param threads as in host_exec; 0 = all
/// @throws bad_argument for invalid settings
inline std::unique_ptr<device_tracker> make_host_tracker(settings const& s, int threads = 0) {
  return make_tracker_on(host_exec(threads), s);
}

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
