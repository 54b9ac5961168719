// SPDX-License-Identifier: Apache-2.0
// Sightings: against a plain loop; each point once a frame, whatever holds it.
#include "ft/kernels/map/count_sightings.hpp"

#include <gtest/gtest.h>

#include <cstddef>
#include <random>
#include <set>
#include <vector>

#include "tests/support/backends.hpp"
#include "tests/support/random_maps.hpp"

namespace count_sightings_test {

struct frame_arrays {
  ft::keypoints_view keypoints;
  int* holder = nullptr;
  int* frame = nullptr;
  int* seen = nullptr;
  ft::sightings* kind = nullptr;
  ft::visibility* visible = nullptr;
  ft::local_map_view local;
};

constexpr int batch = 3;
constexpr int slots = 300;
constexpr int keypoints = 80;
constexpr int local_points = 120;

inline void randomize(std::mt19937& random, frame_arrays const& v, int cameras, int frame) {
  for (int b = 0; b < batch; ++b) {
    v.frame[b] = frame;
    v.kind[b] = static_cast<ft::sightings>(random() % 3);
    for (int s = 0; s < slots; ++s) {
      v.seen[b * slots + s] = frame - static_cast<int>(random() % 4);
    }
    for (int n = 0; n < cameras * keypoints; ++n) {
      v.holder[b * cameras * keypoints + n] = static_cast<int>(random() % (slots + 20)) - 10;
    }
    for (int c = 0; c < 2; ++c) {
      v.keypoints.count[2 * b + c] = static_cast<int>(random() % (keypoints + 1));
    }
    v.local.count[b] = static_cast<int>(random() % (local_points + 1));
    for (int i = 0; i < local_points; ++i) {
      int const slot = 2 * i;  // each once
      v.local.slots[b * local_points + i] = slot;
      for (int c = 0; c < cameras; ++c) {
        bool const stamped = v.seen[b * slots + slot] == frame;  // the search skips these
        v.visible[(c * batch + b) * local_points + i].level =
            stamped ? -1 : static_cast<int>(random() % 3) - 1;
      }
    }
  }
}

inline void count(test::plain_map& m, frame_arrays const& v, int cameras, int b) {
  if (v.kind[b] == ft::sightings::none) { return; }
  std::set<int> in_view;
  std::set<int> found;
  for (int s = 0; s < slots; ++s) {
    if (v.seen[b * slots + s] == v.frame[b]) { in_view.insert(s); }
  }
  for (int c = 0; c < cameras; ++c) {
    for (int i = 0; i < v.local.count[b]; ++i) {
      if (v.visible[(c * batch + b) * local_points + i].level >= 0) {
        in_view.insert(v.local.slots[b * local_points + i]);
      }
    }
    for (int i = 0; i < v.keypoints.count[2 * b + c]; ++i) {
      found.insert(v.holder[(b * cameras + c) * keypoints + i]);
    }
  }
  for (int s = 0; s < slots; ++s) {
    auto& p = m.points[test::index(s)];
    if (p.number == 0) { continue; }
    if (v.kind[b] == ft::sightings::all) { p.visible += static_cast<int>(in_view.count(s)); }
    p.found += static_cast<int>(found.count(s));
  }
}

template <typename Backend>
class CountSightings : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(CountSightings, test::backends);

TYPED_TEST(CountSightings, AreThoseOfAPlainLoop) {
  using exec_type = typename TypeParam::exec_type;
  TypeParam backend;
  for (int cameras = 1; cameras <= 2; ++cameras) {
    std::mt19937 random(static_cast<unsigned>(cameras));
    test::mirrored<exec_type, ft::odometry_map_view> map(
        [&](ft::carver& c, ft::odometry_map_view& v) {
          carve(c, v, {slots, {10, cameras, 100}}, batch);
        });
    test::mirrored<exec_type, frame_arrays> in([&](ft::carver& c, frame_arrays& v) {
      carve(c, v.keypoints, keypoints, 2 * batch);
      v.holder = c.take<int>(test::index(batch * cameras * keypoints));
      v.frame = c.take<int>(batch);
      v.seen = c.take<int>(batch * slots);
      v.kind = c.take<ft::sightings>(batch);
      v.visible = c.take<ft::visibility>(test::index(cameras * batch * local_points));
      v.local.capacity = local_points;
      v.local.slots = c.take<int>(batch * local_points);
      v.local.count = c.take<int>(batch);
    });
    clear(backend.exec, map.device);
    map.pull(backend.exec);
    std::vector<test::plain_map> expected;
    for (int b = 0; b < batch; ++b) {
      test::random_map_sizes const size{slots, 10, cameras, 100, 10, 60};
      expected.push_back(test::random_map(random, size));
      test::write_map(expected.back(), map.host, b);
    }
    map.push(backend.exec);
    for (int frame = 1; frame <= 20; ++frame) {
      randomize(random, in.host, cameras, frame);
      in.push(backend.exec);
      ft::frame_view view;
      view.keypoints = in.device.keypoints;
      view.cameras = cameras;
      view.batch = batch;
      view.holder = in.device.holder;
      ft::count_sightings(backend.exec, view,
                          {in.device.kind, in.device.visible, in.device.local,
                           ft::point_stamps{in.device.frame, in.device.seen}},
                          map.device);
      for (int b = 0; b < batch; ++b) { count(expected[test::index(b)], in.host, cameras, b); }
    }
    map.pull(backend.exec);
    for (int b = 0; b < batch; ++b) {
      test::expect_same_map(test::read_map(map.host, b), expected[test::index(b)], 0);
    }
  }
}

}  // namespace count_sightings_test
