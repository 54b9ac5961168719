// SPDX-License-Identifier: Apache-2.0
// Threads that share the host's part of a call.
#include "integration/orbslam3/helper_threads.hpp"

#include <gtest/gtest.h>

#include <chrono>
#include <cstddef>
#include <stdexcept>
#include <thread>
#include <vector>

namespace orbslam3_test {

TEST(helper_threads, do_every_part_once_and_report_what_fails) {
  for (int const count : {0, 1, 3}) {
    ft::orbslam3::helper_threads helpers(count);
    for (int round = 0; round < 200; ++round) {
      if (round % 3 == 0) { helpers.wake(std::chrono::milliseconds(round % 2)); }
      if (round % 50 == 0) { std::this_thread::sleep_for(std::chrono::milliseconds(2)); }  // asleep
      std::vector<int> done(37, 0);
      helpers.share(37, [&](int i) { ++done[static_cast<std::size_t>(i)]; });
      EXPECT_EQ(done, std::vector<int>(37, 1));
    }
    EXPECT_THROW(helpers.share(9,
                               [](int i) {
                                 if (i == 5) { throw std::runtime_error("part 5"); }
                               }),
                 std::runtime_error);
    int parts = 0;
    helpers.share(1, [&](int) { ++parts; });
    helpers.share(0, [&](int) { ++parts; });
    EXPECT_EQ(parts, 1);
  }
}

}  // namespace orbslam3_test
