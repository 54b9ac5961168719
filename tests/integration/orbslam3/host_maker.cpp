// SPDX-License-Identifier: Apache-2.0
// The unit that a user without CUDA has: one line. The tests' own maker is beside it, so that the
// compiler makes the tracker once.
#include "integration/orbslam3/make_tracker.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/support/effort.hpp"

namespace orbslam3_test {

/// ThreadSanitizer does not see how the oneTBB library, which is not built with it, orders its
/// workers: every access in a parallel loop would be reported. One thread uses no pool, and leaves
/// what the shim itself shares between threads.
#if FT_TEST_TSAN
inline constexpr int host_threads = 1;
#else
inline constexpr int host_threads = 0;
#endif

std::unique_ptr<ft::orbslam3::device_tracker> make_host(ft::orbslam3::settings const& s) {
  return ft::orbslam3::make_host_tracker(s, host_threads);
}

}  // namespace orbslam3_test
