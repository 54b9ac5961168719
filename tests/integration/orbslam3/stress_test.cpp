// SPDX-License-Identifier: Apache-2.0
// Tracking through the shim while a mapping thread adds, moves, describes anew, replaces and
// deletes points. To be run under ThreadSanitizer as well. What is found while points change
// depends on when; what is found once they rest does not.
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <memory>
#include <mutex>
#include <random>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "integration/orbslam3/accelerator.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/plain_search.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/integration/orbslam3/watched_device.hpp"
#include "tests/support/effort.hpp"

namespace orbslam3_test {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;
using ft::orbslam3::change_detection;
using ft::orbslam3::stage;

struct push_changes final : stand_in::hooks {
  accelerator* gpu = nullptr;
  void changed(stand_in::map_point* point) override { gpu->map_point_changed(point); }
};

/// A map: a list under a lock, and every point that is not deleted. Points that left the list are
/// deleted by the mapping thread once tracking has let go of them.
class living_map {
public:
  living_map(std::vector<std::unique_ptr<stand_in::map_point>> points, stand_in::hooks& hooks)
      : hooks_(&hooks), all_(std::move(points)) {
    for (auto& p : all_) {
      p->observer = hooks_;
      listed_.push_back(p.get());
      next_id_ = std::max(next_id_, p->mnId + 1);
    }
  }

  std::vector<stand_in::map_point*> list() {
    std::lock_guard<std::mutex> const lock(mutex_);
    return listed_;
  }

  /// By the tracker where it holds no points but those of its last frame: lets go of those that
  /// left the list.
  void release(stand_in::frame& last) {
    std::lock_guard<std::mutex> const lock(mutex_);
    for (stand_in::map_point* const p : retired_) {
      std::replace(last.mvpMapPoints.begin(), last.mvpMapPoints.end(), p,
                   static_cast<stand_in::map_point*>(nullptr));
      unused_.push_back(p);
    }
    retired_.clear();
  }
  /// By the mapping thread. Returns the number of points.
  int delete_unused(accelerator& gpu) {
    std::vector<stand_in::map_point*> unused;
    {
      std::lock_guard<std::mutex> const lock(mutex_);
      unused.swap(unused_);
    }
    for (stand_in::map_point* const p : unused) { destroy(p, gpu); }
    return static_cast<int>(unused.size());
  }
  /// By the mapping thread: a point that nobody lists, changed and deleted at once.
  void make_temporary(std::mt19937& random, accelerator& gpu) {
    add(*any(random), random, false);
    stand_in::map_point* const p = all_.back().get();
    p->SetWorldPos(p->GetWorldPos());
    destroy(p, gpu);
  }

  /// One thing that the mapping thread does.
  void change(std::mt19937& random) {
    stand_in::map_point* const p = any(random);
    std::uniform_real_distribution<float> small(-0.01f, 0.01f);
    switch (random() % 6) {
      case 0:
        p->SetWorldPos(p->GetWorldPos() + Eigen::Vector3f(small(random), small(random), 0));
        break;
      case 1:
        p->set_view(p->GetNormal(), 0.2f, p->raw_max_distance() * 1.01f);
        break;
      case 2:
        p->set_descriptor(bits(random).data());
        break;
      case 3:
        add(*p, random);
        break;
      case 4:
        p->Replace(any(random));
        erase(p);
        break;
      default:
        p->SetBadFlag();
        erase(p);
        add(*p, random);
    }
  }

private:
  static std::vector<unsigned char> bits(std::mt19937& random) {
    std::vector<unsigned char> d(32);
    for (auto& b : d) { b = static_cast<unsigned char>(random()); }
    return d;
  }
  stand_in::map_point* any(std::mt19937& random) {
    std::lock_guard<std::mutex> const lock(mutex_);
    return listed_[random() % listed_.size()];
  }
  void destroy(stand_in::map_point const* p, accelerator& gpu) {
    gpu.forget(p);
    auto const at =
        std::find_if(all_.begin(), all_.end(), [p](auto const& q) { return q.get() == p; });
    std::swap(*at, all_.back());
    all_.pop_back();
  }
  void add(stand_in::map_point& like, std::mt19937& random, bool listed = true) {
    auto p = std::make_unique<stand_in::map_point>();
    p->observer = hooks_;
    p->SetWorldPos(like.GetWorldPos() + Eigen::Vector3f(0.02f, 0, 0));
    p->set_view(like.GetNormal(), 0.2f, like.raw_max_distance());
    auto const descriptor = like.GetDescriptor();
    p->set_descriptor(descriptor.data);
    p->set_observations(static_cast<int>(random() % 4));
    std::lock_guard<std::mutex> const lock(mutex_);
    p->mnId = next_id_++;
    if (listed) { listed_.push_back(p.get()); }
    all_.push_back(std::move(p));
  }
  void erase(stand_in::map_point* p) {
    std::lock_guard<std::mutex> const lock(mutex_);
    if (listed_.size() < 100) { return; }
    for (auto& listed : listed_) {
      if (listed != p) { continue; }
      listed = listed_.back();
      listed_.pop_back();
      retired_.push_back(p);
      return;
    }
  }

  std::mutex mutex_;
  stand_in::hooks* hooks_;
  std::vector<std::unique_ptr<stand_in::map_point>> all_;
  std::vector<stand_in::map_point*> listed_;
  std::vector<stand_in::map_point*> retired_;  ///< not listed; tracking may hold them
  std::vector<stand_in::map_point*> unused_;
  unsigned long next_id_ = 0;
};

class shim_beside_mapping : public on_executor {
protected:
  /// What the tracker does with a last frame's points before it searches them.
  static void follow_replaced(stand_in::frame& last) {
    for (auto*& p : last.mvpMapPoints) {
      if (p == nullptr) { continue; }
      if (auto* const by = p->GetReplaced()) { p = by; }
    }
  }

  void track_while_mapping(sensor kind, change_detection detection, int frames) {
    scene s(kind, 6);
    s.settings.most_keypoints = 2000;
    s.settings.map_points = 128;  // grows on the way
    ft::orbslam3::options o;
    o.detection = detection;
    auto device = std::make_unique<watched_device>(make(s.settings));
    traffic& sent = device->sent;
    accelerator gpu(std::move(device), s.settings, o);
    push_changes hooks;
    hooks.gpu = &gpu;
    living_map map(std::move(s.map), hooks);
    std::atomic<bool> stop{false};
    std::atomic<long> changes{0};
    std::atomic<long> deleted{0};
    std::thread mapping([&] {
      std::mt19937 random(11);
      while (!stop) {
        map.change(random);
        if (changes % 4 == 0) { map.make_temporary(random, gpu); }
        deleted += map.delete_unused(gpu);
        ++changes;
      }
    });
    stand_in::frame last = s.last;
    long matches = 0;
    for (int k = 0; k < frames || changes < 500; ++k) {
      stand_in::frame f = s.current;
      f.mnId = static_cast<unsigned long>(100 + k);
      follow_replaced(last);
      map.release(last);
      matches += gpu.search_by_projection(f, last, 15, false);
      gpu.pose_optimization(f, stage::pose_last_frame);
      mark_own_points(f);
      auto const local = map.list();
      std::set<stand_in::map_point const*> const known(local.begin(), local.end());
      auto const before = f.mvpMapPoints;
      matches += gpu.search_local_points(f, local, 2);
      for (std::size_t i = 0; i < before.size(); ++i) {
        auto const* const now = f.mvpMapPoints[i];
        ASSERT_TRUE(now == before[i] || known.count(now) == 1) << "a point of another slot";
      }
      gpu.pose_optimization(f, stage::pose_local_map);
      if (k % 5 == 4) { f.SetPose(s.current.GetPose()); }
      last = f;
    }
    stop = true;
    mapping.join();
    EXPECT_GT(deleted, 20);
    EXPECT_GT(matches, frames);

    // At rest: what a plain loop finds, and nothing is left to send.
    stand_in::frame want = s.current;
    stand_in::frame got = s.current;
    want.mnId = got.mnId = 100000;
    auto const local = map.list();
    int const n = plain_search(s.settings).search_local(want, local, 2);
    EXPECT_EQ(gpu.search_local_points(got, local, 2), n);
    EXPECT_EQ(got.mvpMapPoints, want.mvpMapPoints);
    sent = {};
    got.mvpMapPoints = s.current.mvpMapPoints;
    gpu.search_local_points(got, local, 2);
    EXPECT_EQ(sent.map, 0u);
  }
};

TEST_P(shim_beside_mapping, follows_the_map_by_comparing) {
  for (sensor const kind : {sensor::stereo, sensor::fisheye_stereo}) {
    SCOPED_TRACE(name_of(kind));
    track_while_mapping(kind, change_detection::compare, test::effort(60));
  }
}

TEST_P(shim_beside_mapping, follows_the_map_by_hooks) {
  for (sensor const kind : {sensor::stereo, sensor::fisheye_stereo}) {
    SCOPED_TRACE(name_of(kind));
    track_while_mapping(kind, change_detection::hooks, test::effort(60));
  }
}

INSTANTIATE_TEST_SUITE_P(executors, shim_beside_mapping, ::testing::ValuesIn(executors()),
                         executor_name);

}  // namespace orbslam3_test
