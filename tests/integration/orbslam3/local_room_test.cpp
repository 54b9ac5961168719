// SPDX-License-Identifier: Apache-2.0
// Memory for local maps is allocated by another thread before a call needs it.
#include "integration/orbslam3/local_map.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <cstddef>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "integration/orbslam3/front_end.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/heard.hpp"
#include "tests/integration/orbslam3/plain_search.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/integration/orbslam3/watched_device.hpp"

namespace orbslam3_test {

using grown_shim = ft::orbslam3::front_end<stand_in::types>;

class local_maps_that_grow : public on_executor {};

/// Counts allocations for local maps in the tracking thread.
class counting_device final : public watched_device {
public:
  using watched_device::watched_device;
  std::atomic<int> prepared_by_tracking{0};
  int taken_in_calls = 0;

  void prepare_local(int points) override {
    prepared_by_tracking += static_cast<int>(std::this_thread::get_id() == tracking_);
    watched_device::prepare_local(points);
  }
  int* local_slots(int points) override {
    taken_in_calls += static_cast<int>(points > local_room());
    return watched_device::local_slots(points);
  }

private:
  std::thread::id tracking_ = std::this_thread::get_id();
};

void wait_for_room(ft::orbslam3::device_tracker const& device, int points) {
  auto const end = std::chrono::steady_clock::now() + std::chrono::seconds(60);
  while (device.local_room() < points && std::chrono::steady_clock::now() < end) {
    std::this_thread::yield();
  }
  ASSERT_GE(device.local_room(), points);
}

TEST_P(local_maps_that_grow, have_their_memory_taken_outside_of_calls) {
  scene s(sensor::stereo, 8, 3000);
  s.settings.most_keypoints = 6000;
  s.settings.local_points = 10;  // room for 1024
  plain_search const plain(s.settings);
  auto owned = std::make_unique<counting_device>(make(s.settings));
  counting_device& device = *owned;
  heard said;
  grown_shim gpu(std::move(owned), s.settings, {});
  auto const all = s.local_map();
  ASSERT_GT(all.size(), 2500u);
  int by_cpu = 0;
  auto const search = [&](std::size_t points) {
    std::vector<stand_in::map_point*> const local(all.begin(),
                                                  all.begin() + static_cast<long>(points));
    stand_in::frame want = s.current;
    int const n = plain.search_local(want, local, 1);
    stand_in::frame got = s.current;
    EXPECT_EQ(gpu.search_local_points(got, local, 1, false, 50,
                                      [&] {
                                        ++by_cpu;
                                        return plain.search_local(got, local, 1);
                                      }),
              n);
    EXPECT_EQ(got.mvpMapPoints, want.mvpMapPoints);
  };
  search(600);
  wait_for_room(device, 1200);
  search(1100);  // grows step by step
  wait_for_room(device, 2200);
  EXPECT_EQ(by_cpu, 0);
  EXPECT_EQ(said.lines(), 0);
  EXPECT_EQ(device.taken_in_calls, 0);
  EXPECT_EQ(device.prepared_by_tracking, 0);
}

TEST_P(local_maps_that_grow, at_once_are_left_to_the_cpu_until_there_is_room) {
  scene s(sensor::stereo, 8, 3000);
  s.settings.most_keypoints = 6000;
  s.settings.local_points = 10;
  auto owned = std::make_unique<counting_device>(make(s.settings));
  counting_device& device = *owned;
  heard said;
  grown_shim gpu(std::move(owned), s.settings, {});
  auto const local = s.local_map();
  auto const search = [&](stand_in::frame& f) {
    return gpu.search_local_points(f, local, 1, false, 50, [] { return -7; });
  };
  stand_in::frame first = s.current;
  EXPECT_EQ(search(first), -7);
  EXPECT_EQ(said.lines(), 1);
  EXPECT_TRUE(said.has(std::to_string(local.size()))) << said.text();
  EXPECT_TRUE(said.has("local_points")) << said.text();
  wait_for_room(device, static_cast<int>(local.size()));
  stand_in::frame want = s.current;
  int const n = plain_search(s.settings).search_local(want, local, 1);
  stand_in::frame got = s.current;
  EXPECT_EQ(search(got), n);
  EXPECT_EQ(got.mvpMapPoints, want.mvpMapPoints);
  EXPECT_EQ(said.lines(), 1);
  EXPECT_EQ(device.taken_in_calls, 0);
  EXPECT_EQ(device.prepared_by_tracking, 0);
}

INSTANTIATE_TEST_SUITE_P(executors, local_maps_that_grow, ::testing::ValuesIn(executors()),
                         executor_name);

}  // namespace orbslam3_test
