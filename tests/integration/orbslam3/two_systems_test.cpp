// SPDX-License-Identifier: Apache-2.0
// Two systems in one process: each map's changes reach its own tracker, and trackers and maps are
// destroyed in any order. To be run under AddressSanitizer and valgrind as well.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "integration/orbslam3/front_end.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/plain_search.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/support/effort.hpp"

namespace orbslam3_test {

using front_end = ft::orbslam3::front_end<stand_in::types>;

/// Of ORB_SLAM3::Map: its points tell it of their changes.
struct map_of_points final : stand_in::hooks {
  ft::orbslam3::map_changes<stand_in::map_point> mChanges;
  void changed(stand_in::map_point* point) override { mChanges.push(point); }
};

/// A scene with a map and a tracker, each of which may go first.
struct two_part_system {
  scene world;
  plain_search plain;
  std::unique_ptr<map_of_points> map = std::make_unique<map_of_points>();
  std::unique_ptr<front_end> tracker;
  unsigned long frames = 0;

  two_part_system(unsigned seed, std::unique_ptr<ft::orbslam3::device_tracker> device)
      : world(sensor::stereo, seed, 300), plain(world.settings) {
    for (auto& p : world.map) { p->observer = map.get(); }
    ft::orbslam3::options o;
    o.detection = ft::orbslam3::change_detection::hooks;
    tracker = std::make_unique<front_end>(std::move(device), world.settings, o);
    watch();
  }
  void watch() { tracker->watch(std::vector<map_of_points*>{map.get()}); }
  void drop_map() {
    for (auto& p : world.map) { p->observer = nullptr; }
    map.reset();
  }
  void move(float by) {
    for (std::size_t i = 0; i < world.map.size(); i += 2) {
      auto& p = *world.map[i];
      p.SetWorldPos(p.GetWorldPos() + Eigen::Vector3f(by, -by, 0));
    }
  }
  /// Matches of the last frame's points, by the tracker and by plain loops: 0 where they differ.
  int found() {
    stand_in::frame want = world.current;
    stand_in::frame got = world.current;
    got.mnId += ++frames;
    int const n = plain.search_last(want, world.last, 15, false);
    int const by_tracker =
        tracker->search_by_projection(got, world.last, 15, false, [] { return -1; });
    return n == by_tracker && got.mvpMapPoints == want.mvpMapPoints ? n : 0;
  }
};

class two_systems : public on_executor {
protected:
  static std::unique_ptr<two_part_system> system(unsigned seed) {
    return std::make_unique<two_part_system>(seed, make(settings_for(sensor::stereo)));
  }
};

TEST_P(two_systems, take_the_changes_of_their_own_maps) {
  auto const a = system(4);
  auto const b = system(5);
  for (int round = 0; round < 6; ++round) {
    EXPECT_GT(a->found(), 50) << round;
    EXPECT_GT(b->found(), 50) << round;
    a->move(round % 2 == 0 ? 0.02f : -0.02f);
    if (round % 3 == 0) { b->move(0.01f); }
  }
}

TEST_P(two_systems, are_destroyed_in_any_order) {
  std::array<int, 4> order{0, 1, 2, 3};
  int const every = test::whole_effort() ? 1 : 7;
  int permutation = 0;
  do {
    if (permutation++ % every != 0) { continue; }
    auto const a = system(4);
    auto const b = system(5);
    two_part_system* const all[] = {a.get(), b.get()};
    for (int const part : order) {
      for (auto* const s : all) {
        s->move(0.001f);
        if (s->tracker != nullptr && s->map != nullptr) { EXPECT_GT(s->found(), 50); }
      }
      two_part_system& s = *all[part / 2];
      if (part % 2 == 0) {
        s.tracker.reset();
      } else {
        s.drop_map();
      }
    }
  } while (std::next_permutation(order.begin(), order.end()));
}

TEST_P(two_systems, make_another_tracker_while_mapping_goes_on) {
  auto const a = system(4);
  auto const b = system(5);
  std::atomic<bool> stop{false};
  std::thread mapping([&] {
    while (!stop) {
      a->move(0.0f);
      b->move(0.0f);
    }
  });
  for (int round = 0; round < 4; ++round) {
    two_part_system& s = round % 2 == 0 ? *a : *b;
    s.tracker.reset();
    ft::orbslam3::options o;
    o.detection = ft::orbslam3::change_detection::hooks;
    s.tracker = std::make_unique<front_end>(make(s.world.settings), s.world.settings, o);
    s.watch();
    EXPECT_GT(a->found(), 50);
    EXPECT_GT(b->found(), 50);
  }
  stop = true;
  mapping.join();
}

INSTANTIATE_TEST_SUITE_P(executors, two_systems, ::testing::ValuesIn(executors()), executor_name);

TEST(map_changes, go_to_the_last_queue_and_nowhere_without_one) {
  ft::orbslam3::map_changes<int> changes;
  int point = 0;
  changes.push(&point);
  auto first = std::make_shared<ft::orbslam3::change_queue<int>>();
  auto const second = std::make_shared<ft::orbslam3::change_queue<int>>();
  changes.send_to(first);
  changes.send_to(first);
  changes.push(&point);
  EXPECT_EQ(first->size(), 1u);
  changes.send_to(second);
  changes.push(&point);
  EXPECT_EQ(first->size(), 1u);
  EXPECT_EQ(second->size(), 1u);
  std::weak_ptr<ft::orbslam3::change_queue<int>> const kept = first;
  first.reset();
  EXPECT_FALSE(kept.expired());  // a push may be in it
  second->close();
  changes.push(&point);
  EXPECT_EQ(second->size(), 0u);
  changes.send_to(nullptr);
  changes.push(&point);
}

}  // namespace orbslam3_test
