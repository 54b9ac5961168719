// SPDX-License-Identifier: Apache-2.0
// The map's mirror between calls: what its reader takes up, and how much room it needs.
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <memory>
#include <thread>
#include <vector>

#include "integration/orbslam3/map_mirror.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/integration/orbslam3/watched_device.hpp"
#include "tests/support/effort.hpp"

namespace orbslam3_test {

using ft::orbslam3::change_detection;
using mirror = ft::orbslam3::map_mirror<stand_in::map_point>;

struct push_to final : stand_in::hooks {
  explicit push_to(mirror& m) : to(&m) {}
  void changed(stand_in::map_point* point) override { to->changes().push(point); }
  mirror* to;
};

class map_mirror : public on_executor {
protected:
  void SetUp() override {
    on_executor::SetUp();
    if (!IsSkipped() && !HasFatalFailure()) {
      device_ = std::make_unique<watched_device>(make(settings_for(sensor::stereo)));
    }
  }

  /// As a constructor and those who call it: `pushes` of them, then the number.
  std::unique_ptr<stand_in::map_point> new_point(stand_in::hooks* hooks, int pushes) {
    auto p = std::make_unique<stand_in::map_point>();
    unsigned char const bits[32] = {1, 2, 3};
    p->set_descriptor(bits);
    p->observer = hooks;
    for (int i = 0; i < pushes; ++i) { p->SetWorldPos({1, 2, static_cast<float>(3 + i)}); }
    p->mnId = next_id_++;
    return p;
  }
  static void call(mirror& m, std::vector<stand_in::map_point*> const& points) {
    mirror::call_end const end(m);
    m.begin_call();
    for (auto* p : points) { m.visit(p); }
    m.flush();
  }
  /// Until it holds, at most ten seconds.
  template <typename Condition>
  static bool eventually(Condition const& condition) {
    for (int i = 0; i < 10000; ++i) {
      if (condition()) { return true; }
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return condition();
  }

  std::unique_ptr<watched_device> device_;
  unsigned long next_id_ = 0;
};

TEST_P(map_mirror, takes_up_new_points_without_a_call_once_their_constructor_is_done) {
  mirror m(*device_, change_detection::hooks, 1000);
  push_to hooks(m);
  call(m, {});
  auto const pushed_once = new_point(&hooks, 1);
  EXPECT_TRUE(eventually([&] { return m.changes().size() == 0; }));
  auto const pushed_twice = new_point(&hooks, 2);
  EXPECT_TRUE(eventually([&] { return m.size() == 1; }));
  device_->sent = {};
  call(m, {pushed_twice.get()});
  EXPECT_EQ(device_->sent.map, 4u * ft::orbslam3::map_change::point_words);
  EXPECT_EQ(m.size(), 1);
  call(m, {pushed_twice.get(), pushed_once.get()});
  EXPECT_EQ(m.size(), 2);
  m.forget(pushed_once.get());
  m.forget(pushed_twice.get());
  EXPECT_EQ(m.size(), 0);
}

TEST_P(map_mirror, grows_where_all_its_points_are_in_use) {
  mirror m(*device_, change_detection::hooks, 400);
  push_to hooks(m);
  call(m, {});
  std::vector<std::unique_ptr<stand_in::map_point>> points;
  for (int i = 0; i < 410; ++i) { points.push_back(new_point(&hooks, 2)); }
  EXPECT_TRUE(eventually([&] { return m.size() == 410; }));
  EXPECT_EQ(m.capacity(), 800);
  std::vector<stand_in::map_point*> all;
  for (auto const& p : points) { all.push_back(p.get()); }
  call(m, all);
  EXPECT_EQ(m.size(), 410);
  for (auto const& p : points) { m.forget(p.get()); }
}

/// Localisation mode: points that live for a frame. By comparing nothing says that they are gone.
TEST_P(map_mirror, does_not_grow_in_ten_thousand_frames_of_temporary_points) {
  for (auto const detection : {change_detection::compare, change_detection::hooks}) {
    mirror m(*device_, detection, 4096);
    push_to hooks(m);
    std::vector<std::unique_ptr<stand_in::map_point>> lasting;
    for (int i = 0; i < 300; ++i) { lasting.push_back(new_point(&hooks, 0)); }
    for (int frame = 0; frame < test::effort(10000); ++frame) {
      std::vector<stand_in::map_point*> seen;
      for (int i = 0; i < 50; ++i) {
        seen.push_back(lasting[static_cast<std::size_t>(frame * 50 + i) % lasting.size()].get());
      }
      std::vector<std::unique_ptr<stand_in::map_point>> temporary;
      for (int i = 0; i < 40; ++i) {
        temporary.push_back(new_point(&hooks, 1));
        seen.push_back(temporary.back().get());
      }
      call(m, seen);
      if (detection == change_detection::hooks) {
        for (auto const& p : temporary) { m.forget(p.get()); }
      }
    }
    EXPECT_EQ(m.capacity(), 4096);
    for (auto const& p : lasting) { m.forget(p.get()); }
  }
}

/// For the sanitizers: nobody reads a point that was forgotten.
TEST_P(map_mirror, lets_points_be_deleted_while_its_reader_works) {
  mirror m(*device_, change_detection::hooks, 1000);
  push_to hooks(m);
  call(m, {});
  std::atomic<bool> stop{false};
  std::vector<std::thread> mappers;
  for (int t = 0; t < 2; ++t) {
    mappers.emplace_back([&] {
      while (!stop) {
        auto p = std::make_unique<stand_in::map_point>();
        p->observer = &hooks;
        for (int i = 0; i < 4; ++i) { p->SetWorldPos({1, 2, static_cast<float>(i)}); }
        m.forget(p.get());
      }
    });
  }
  for (int i = 0; i < test::effort(300); ++i) { call(m, {}); }
  stop = true;
  for (auto& t : mappers) { t.join(); }
  EXPECT_EQ(m.size(), 0);
}

INSTANTIATE_TEST_SUITE_P(executors, map_mirror, ::testing::ValuesIn(executors()), executor_name);

}  // namespace orbslam3_test
