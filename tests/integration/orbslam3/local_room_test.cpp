// SPDX-License-Identifier: Apache-2.0
// Memory for local maps grows with the largest one.
#include <gtest/gtest.h>

#include <cstddef>
#include <vector>

#include "integration/orbslam3/accelerator.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/plain_search.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"

namespace orbslam3_test {

class local_maps_that_grow : public on_executor {};

TEST_P(local_maps_that_grow, are_searched_as_those_that_had_room) {
  scene s(sensor::stereo, 8, 3000);
  s.settings.most_keypoints = 6000;
  s.settings.local_points = 10;  // room for 1024
  plain_search const plain(s.settings);
  ft::orbslam3::accelerator<stand_in::types> gpu(make(s.settings), s.settings);
  auto const all = s.local_map();
  ASSERT_GT(all.size(), 2500u);
  for (std::size_t const points :
       {std::size_t{600}, std::size_t{1100}, all.size(), std::size_t{50}}) {
    std::vector<stand_in::map_point*> const local(all.begin(),
                                                  all.begin() + static_cast<long>(points));
    stand_in::frame want = s.current;
    int const n = plain.search_local(want, local, 1);
    stand_in::frame got = s.current;
    EXPECT_EQ(gpu.search_local_points(got, local, 1), n);
    EXPECT_EQ(got.mvpMapPoints, want.mvpMapPoints);
  }
}

INSTANTIATE_TEST_SUITE_P(executors, local_maps_that_grow, ::testing::ValuesIn(executors()),
                         executor_name);

}  // namespace orbslam3_test
