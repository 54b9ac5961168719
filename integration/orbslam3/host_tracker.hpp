// SPDX-License-Identifier: Apache-2.0
/// @file The shim on host threads: for machines without a GPU, and for tests.
#pragma once

#include <memory>

#include "integration/orbslam3/executor_tracker.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

/// @param threads as host_exec takes them; 0 = all. @throws bad_argument for settings that cannot
/// be
inline std::unique_ptr<device_tracker> make_host_tracker(settings const& s, int threads = 0) {
  return make_tracker_on(host_exec(threads), s);
}

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
