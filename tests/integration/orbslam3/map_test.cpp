// SPDX-License-Identifier: Apache-2.0
// What the shim sends and when, and how it follows a map that changes.
#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <new>
#include <random>
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

namespace orbslam3_test {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;
using ft::orbslam3::change_detection;
using ft::orbslam3::stage;

ft::orbslam3::settings with_room(ft::orbslam3::settings s) {
  s.most_keypoints = 2000;
  return s;
}
ft::orbslam3::options detecting(change_detection detection) {
  ft::orbslam3::options o;
  o.detection = detection;
  return o;
}
std::vector<unsigned long> ids(stand_in::frame const& f) {
  std::vector<unsigned long> all;
  for (auto const* p : f.mvpMapPoints) { all.push_back(p == nullptr ? 0 : p->mnId); }
  return all;
}

/// Tells an accelerator what the mapping thread does.
struct hook_into final : stand_in::hooks {
  accelerator* gpu = nullptr;
  void changed(stand_in::map_point* point) override { gpu->map_point_changed(point); }
};

class shim_traffic : public on_executor {};

TEST_P(shim_traffic, of_a_frame_in_which_nothing_changed_has_no_map_data) {
  for (auto const detection : {change_detection::compare, change_detection::hooks}) {
    scene s(sensor::stereo, 1, 1200);
    s.settings = with_room(s.settings);
    auto device = std::make_unique<watched_device>(make(s.settings));
    traffic& sent = device->sent;
    accelerator gpu(std::move(device), s.settings, detecting(detection));
    auto const local = s.local_map();
    auto const frame = [&] {
      stand_in::frame f = s.current;
      gpu.search_by_projection(f, s.last, 15, false);
      gpu.search_local_points(f, local, 1);
      gpu.pose_optimization(f, stage::pose_local_map);
      return ids(f);
    };
    auto const first = frame();
    EXPECT_EQ(sent.map, 1200u * 4 * (4 + 6 + 9 + 2));  // every point, once
    EXPECT_EQ(sent.slots, 1200);
    sent = {};
    EXPECT_EQ(frame(), first);
    EXPECT_EQ(sent.map, 0u);
    EXPECT_EQ(sent.images, 0);
    EXPECT_EQ(sent.slots, 0);
    // The current frame's holders, which were those of the whole frame and are empty again, are
    // cleared by the search.
    EXPECT_TRUE(sent.parts.empty());
  }
}

TEST_P(shim_traffic, of_a_change_is_the_changed_fields) {
  for (auto const detection : {change_detection::compare, change_detection::hooks}) {
    scene s(sensor::stereo, 2, 300);
    s.settings = with_room(s.settings);
    auto device = std::make_unique<watched_device>(make(s.settings));
    traffic& sent = device->sent;
    accelerator gpu(std::move(device), s.settings, detecting(detection));
    hook_into hook;
    hook.gpu = &gpu;
    for (auto& p : s.map) { p->observer = &hook; }
    auto const local = s.local_map();
    auto const bytes_after = [&](auto const& change) {
      change(*s.map[17]);
      sent = {};
      stand_in::frame f = s.current;
      gpu.search_local_points(f, local, 1);
      return sent.map;
    };
    bytes_after([](stand_in::map_point&) {});
    EXPECT_EQ(bytes_after([](stand_in::map_point&) {}), 0u);
    EXPECT_EQ(bytes_after([](auto& p) { p.SetWorldPos({1, 2, 3}); }), 16u);
    EXPECT_EQ(bytes_after([](auto& p) { p.SetWorldPos({1, 2, 3}); }), 0u);  // the same again
    EXPECT_EQ(bytes_after([](auto& p) { p.set_view({0, 0, 1}, 1, 9); }), 24u);
    EXPECT_EQ(bytes_after([&](auto& p) { p.set_descriptor(s.random_descriptor().data()); }), 36u);
    EXPECT_EQ(bytes_after([](auto& p) { p.set_observations(0); }), 8u);
    EXPECT_EQ(bytes_after([](auto& p) { p.set_observations(5); }), 8u);
    EXPECT_EQ(bytes_after([](auto& p) { p.set_observations(6); }), 0u);  // still some
    EXPECT_EQ(bytes_after([](auto& p) {
                p.SetWorldPos({3, 2, 1});
                p.set_view({1, 0, 0}, 1, 7);
                p.SetWorldPos({3, 2, 2});
              }),
              16u + 24u);
  }
}

TEST_P(shim_traffic, of_an_extracted_frame_is_its_images_and_then_nothing_of_it) {
  auto const s = settings_for(sensor::stereo);
  auto device = std::make_unique<watched_device>(make(s));
  traffic& sent = device->sent;
  accelerator gpu(std::move(device), s);
  scene world(sensor::stereo, 3);
  stand_in::matrix image;
  image.create(480, 640, 0);
  std::mt19937 random(5);
  for (int i = 0; i < 640 * 480; ++i) {
    image.data[i] = static_cast<unsigned char>((i / 13 % 7) * 30 + static_cast<int>(random() % 40));
  }
  stand_in::frame f;
  f.mnId = 3;
  f.mnMaxX = 640;
  f.mnMaxY = 480;
  gpu.extract(image, image, f);
  gpu.compute_stereo(f);
  ASSERT_GT(f.N, 500);
  EXPECT_EQ(sent.images, 1);
  EXPECT_TRUE(sent.parts.empty());
  f.mvKeysUn = f.mvKeys;
  f.mvpMapPoints.assign(static_cast<std::size_t>(f.N), nullptr);
  f.mvbOutlier.assign(static_cast<std::size_t>(f.N), false);
  sent = {};
  auto const local = world.local_map();
  gpu.search_local_points(f, local, 1);
  EXPECT_EQ(sent.images, 0);
  EXPECT_EQ(sent.slots, static_cast<int>(local.size()));
  // The holders, which are empty from now on.
  EXPECT_EQ(sent.parts, std::vector<ft::orbslam3::frame_part>{ft::orbslam3::frame_part::holder});
}

INSTANTIATE_TEST_SUITE_P(executors, shim_traffic, ::testing::ValuesIn(executors()), executor_name);

class shim_map : public on_executor {};

TEST_P(shim_map, follows_points_that_move_change_and_go) {
  for (auto const detection : {change_detection::compare, change_detection::hooks}) {
    scene s(sensor::stereo, 4);
    s.settings = with_room(s.settings);
    s.settings.map_points = 64;
    accelerator gpu(make(s.settings), s.settings, detecting(detection));
    hook_into hook;
    hook.gpu = &gpu;
    for (auto& p : s.map) { p->observer = &hook; }
    plain_search const plain(s.settings);
    std::mt19937 random(9);
    for (int round = 0; round < 12; ++round) {
      SCOPED_TRACE(round);
      for (int i = 0; i < 60; ++i) {
        auto& p = *s.map[random() % s.map.size()];
        switch (random() % 5) {
          case 0:
            p.SetWorldPos(p.GetWorldPos() + Eigen::Vector3f(0.01f, 0, -0.02f));
            break;
          case 1:
            p.set_view(p.GetNormal(), 0.5f, p.raw_max_distance() * 1.3f);
            break;
          case 2:
            p.set_descriptor(s.random_descriptor().data());
            break;
          case 3:
            p.set_observations(static_cast<int>(random() % 2));
            break;
          default:
            p.Replace(s.map.front().get());
            break;
        }
      }
      auto local = s.local_map();
      local.resize(local.size() / 2);
      stand_in::frame want = s.current;
      int const n = plain.search_local(want, local, 2);
      stand_in::frame got = s.current;
      EXPECT_EQ(gpu.search_local_points(got, local, 2), n);
      EXPECT_EQ(ids(got), ids(want));
    }
  }
}

TEST_P(shim_map, gives_slots_of_bad_points_to_new_ones) {
  auto const settings = with_room(settings_for(sensor::stereo));
  for (auto const detection : {change_detection::compare, change_detection::hooks}) {
    auto s = settings;
    s.map_points = 1000;
    accelerator gpu(make(s), s, detecting(detection));
    hook_into hook;
    hook.gpu = &gpu;
    std::vector<std::unique_ptr<stand_in::map_point>> all;
    for (unsigned generation = 0; generation < 8; ++generation) {
      scene world(sensor::stereo, 30 + generation, 600);
      for (auto& p : world.map) {
        p->mnId += 5000 * generation;
        p->observer = &hook;
      }
      auto const local = world.local_map();
      stand_in::frame want = world.current;
      int const n = plain_search(s).search_local(want, local, 2);
      stand_in::frame got = world.current;
      EXPECT_EQ(gpu.search_local_points(got, local, 2), n);
      EXPECT_EQ(ids(got), ids(want));
      for (auto& p : world.map) {
        p->SetBadFlag();
        all.push_back(std::move(p));
      }
      gpu.search_local_points(got, local, 2);  // sees that they are bad
    }
    EXPECT_EQ(gpu.mirror().capacity(), 1000);
  }
}

/// Localisation without mapping: points that live for a frame, deleted by the tracker.
TEST_P(shim_map, takes_temporary_points_that_are_deleted_without_growing) {
  for (auto const detection : {change_detection::compare, change_detection::hooks}) {
    scene s(sensor::stereo, 4);
    s.settings = with_room(s.settings);
    s.settings.map_points = 2000;
    accelerator gpu(make(s.settings), s.settings, detecting(detection));
    int const room = gpu.mirror().capacity();
    std::vector<std::unique_ptr<stand_in::map_point>> temporary;
    unsigned long next = 100000;
    for (int k = 0; k < 40; ++k) {
      stand_in::frame last = s.last;
      for (auto*& p : last.mvpMapPoints) {
        if (p == nullptr) { continue; }
        auto own = std::make_unique<stand_in::map_point>();
        own->mnId = next++;
        own->SetWorldPos(p->GetWorldPos());
        own->set_descriptor(p->GetDescriptor().data);
        p = own.get();
        temporary.push_back(std::move(own));
      }
      stand_in::frame want = s.current;
      int const n = plain_search(s.settings).search_last(want, last, 15, false);
      stand_in::frame got = s.current;
      EXPECT_EQ(gpu.search_by_projection(got, last, 15, false), n);
      EXPECT_EQ(got.mvpMapPoints, want.mvpMapPoints);
      for (auto& p : temporary) { gpu.forget(p.get()); }
      temporary.clear();
    }
    EXPECT_EQ(gpu.mirror().size(), 0);
    EXPECT_EQ(gpu.mirror().capacity(), room);
  }
}

TEST_P(shim_map, tells_a_new_point_from_a_deleted_one_at_the_same_address) {
  for (auto const detection : {change_detection::compare, change_detection::hooks}) {
    scene s(sensor::stereo, 4);
    s.settings = with_room(s.settings);
    accelerator gpu(make(s.settings), s.settings, detecting(detection));
    auto const local = s.local_map();
    stand_in::frame first = s.current;
    ASSERT_GT(gpu.search_local_points(first, local, 2), 50);
    scene other(sensor::stereo, 5);
    for (std::size_t i = 0; i < s.map.size(); ++i) {
      stand_in::map_point& like = *other.map[i];
      auto* const place = s.map[i].get();
      place->~map_point();
      new (place) stand_in::map_point;
      place->mnId = 50000 + i;
      place->SetWorldPos(like.GetWorldPos());
      place->set_view(like.GetNormal(), 0.2f, like.raw_max_distance());
      place->set_descriptor(like.GetDescriptor().data);
    }
    other.current.mnId = 12;
    stand_in::frame want = other.current;
    int const n = plain_search(s.settings).search_local(want, local, 2);
    EXPECT_GT(n, 50);
    EXPECT_EQ(gpu.search_local_points(other.current, local, 2), n);
    EXPECT_EQ(ids(other.current), ids(want));
  }
}

TEST_P(shim_map, is_not_locked_while_the_device_is_called) {
  scene s(sensor::stereo, 4);
  s.settings = with_room(s.settings);
  s.settings.map_points = 16;  // grows
  auto device = std::make_unique<watched_device>(make(s.settings));
  device->on_call = [](std::string const& call) {
    std::thread([&] {
      bool const free = stand_in::map_point::mGlobalMutex.try_lock();
      EXPECT_TRUE(free) << call << " while the map is locked";
      if (free) { stand_in::map_point::mGlobalMutex.unlock(); }
    }).join();
  };
  accelerator gpu(std::move(device), s.settings);
  plain_search(s.settings).search_last(s.current, s.last, 15, false);
  EXPECT_GT(gpu.pose_optimization(s.current, stage::pose_last_frame), 10);
  EXPECT_GT(gpu.mirror().capacity(), 16);
}

TEST_P(shim_map, keeps_no_changes_that_it_will_never_read) {
  scene s(sensor::stereo, 4);
  s.settings = with_room(s.settings);
  auto o = detecting(change_detection::hooks);
  ft::orbslam3::set_modes(o, "all", ft::orbslam3::stage_mode::host);
  o[stage::extract] = ft::orbslam3::stage_mode::device;
  accelerator gpu(make(s.settings), s.settings, o);
  for (auto& p : s.map) { gpu.map_point_changed(p.get()); }
  EXPECT_EQ(gpu.changes().size(), 0u);
  o[stage::pose_local_map] = ft::orbslam3::stage_mode::device;
  accelerator poses(make(s.settings), s.settings, o);
  for (auto& p : s.map) { poses.map_point_changed(p.get()); }
  EXPECT_EQ(poses.changes().size(), s.map.size());
  plain_search(s.settings).search_last(s.current, s.last, 15, false);
  poses.pose_optimization(s.current, stage::pose_local_map);
  EXPECT_EQ(poses.changes().size(), 0u);
}

TEST_P(shim_map, is_forgotten_by_a_reset) {
  scene s(sensor::stereo, 4);
  s.settings = with_room(s.settings);
  accelerator gpu(make(s.settings), s.settings);
  auto const local = s.local_map();
  stand_in::frame first = s.current;
  gpu.search_local_points(first, local, 1);
  EXPECT_GT(gpu.mirror().size(), 0);
  gpu.reset();
  EXPECT_EQ(gpu.mirror().size(), 0);
  // Other points under the same numbers, another frame under the same number.
  scene other(sensor::stereo, 5);
  stand_in::frame want = other.current;
  auto const others = other.local_map();
  int const n = plain_search(s.settings).search_local(want, others, 1);
  EXPECT_EQ(gpu.search_local_points(other.current, others, 1), n);
  EXPECT_EQ(ids(other.current), ids(want));
}

/// Limits at powers of the scale factor times the distance, where the float beside the stored one
/// is shown as the same product and gives another octave.
TEST_P(shim_map, predicts_octaves_from_the_stored_limit) {
  scene s(sensor::stereo, 5);
  s.settings.most_keypoints = 2000;
  auto const local = s.local_map();
  Eigen::Vector3f const centre = s.current.GetPose().inverse().translation();
  float const log_scale = std::log(s.settings.scale_factor);
  int edges = 0;
  for (std::size_t i = 0; i < local.size(); ++i) {
    stand_in::map_point& p = *local[i];
    float const distance = (p.GetWorldPos() - centre).norm();
    auto const octave = [&](float limit) {
      return std::ceil(std::log(limit / distance) / log_scale);
    };
    auto const other_octave = [&](float at) {  // of the float below, shown as the same product
      float const below = std::nextafter(at, 0.0f);
      return 1.2f * below == 1.2f * at && octave(below) != octave(at);
    };
    float limit = distance * std::pow(s.settings.scale_factor, static_cast<float>(1 + i % 6));
    for (int step = 0; step < 8; ++step) { limit = std::nextafter(limit, 0.0f); }
    for (int step = 0; step < 16 && !other_octave(limit); ++step) {
      limit = std::nextafter(limit, 1e30f);
    }
    p.set_view(p.GetNormal(), 0.01f, limit);
    edges += static_cast<int>(other_octave(limit));
  }
  ASSERT_GT(edges, 10);
  stand_in::frame want = s.current;
  int const n = plain_search(s.settings).search_local(want, local, 1);
  std::vector<int> octaves;
  for (auto const* p : local) { octaves.push_back(p->mbTrackInView ? p->mnTrackScaleLevel : -1); }
  accelerator gpu(make(s.settings), s.settings);
  EXPECT_EQ(gpu.search_local_points(s.current, local, 1), n);
  EXPECT_EQ(ids(s.current), ids(want));
  std::vector<int> got;
  for (auto const* p : local) { got.push_back(p->mbTrackInView ? p->mnTrackScaleLevel : -1); }
  EXPECT_EQ(got, octaves);
}

INSTANTIATE_TEST_SUITE_P(executors, shim_map, ::testing::ValuesIn(executors()), executor_name);

}  // namespace orbslam3_test
