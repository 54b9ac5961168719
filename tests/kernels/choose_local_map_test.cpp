// SPDX-License-Identifier: Apache-2.0
// The local map: against a plain loop over maps of many sizes, with room for all points and not.
#include "ft/kernels/map/choose_local_map.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <map>
#include <random>
#include <set>
#include <utility>
#include <vector>

#include "tests/support/backends.hpp"
#include "tests/support/random_maps.hpp"

namespace choose_local_map_test {

struct frame_arrays {
  ft::keypoints_view keypoints;
  int* holder = nullptr;
  ft::local_map_mode* mode = nullptr;
  int* votes = nullptr;
  ft::local_map_view local;
  ft::local_map_workspace work;
};

struct outcome {
  std::vector<int> slots;
  int left_out = 0;
};

/// Keyframes in the order in which their points are taken.
inline std::vector<int> plain_order(test::plain_map const& m, std::vector<int> const& held,
                                    ft::local_map_mode mode, ft::local_map_params const& params,
                                    int const* given, int positions) {
  std::vector<int> order;
  if (m.keyframes.empty()) { return order; }
  order.push_back(m.keyframes.rbegin()->first);
  if (mode == ft::local_map_mode::newest) {
    for (auto k = m.keyframes.rbegin(); k != m.keyframes.rend(); ++k) { order.push_back(k->first); }
    order.resize(std::min(order.size(), test::index(params.keyframes + 1)));
    return order;
  }
  std::map<int, int> votes;
  for (auto const& k : m.keyframes) {
    int const mine = given[(k.first - 1) % positions];
    if (mode == ft::local_map_mode::given && mine > 0) { votes[k.first] = mine; }
  }
  for (int const slot : held) {
    if (mode == ft::local_map_mode::given) { break; }
    if (slot < 0 || slot >= static_cast<int>(m.points.size())) { continue; }
    for (int const n : m.points[test::index(slot)].seen_by) { ++votes[n]; }
  }
  std::vector<std::pair<int, int>> ranked;
  for (auto const& [n, v] : votes) { ranked.emplace_back(v, n); }
  std::sort(ranked.rbegin(), ranked.rend());
  ranked.resize(std::min(ranked.size(), test::index(params.keyframes)));
  for (auto const& r : ranked) { order.push_back(r.second); }
  for (std::size_t i = 0; i < ranked.size() && i < test::index(params.neighbours); ++i) {
    int const neighbour = m.keyframes.at(ranked[i].second).neighbour;
    if (m.keyframes.count(neighbour) != 0) { order.push_back(neighbour); }
  }
  return order;
}

inline outcome plain_choice(test::plain_map const& m, std::vector<int> const& order, int capacity) {
  outcome out;
  std::set<int> taken;
  for (int const n : order) {
    for (int s = 0; s < static_cast<int>(m.points.size()); ++s) {
      if (m.points[test::index(s)].seen_by.count(n) == 0 || !taken.insert(s).second) { continue; }
      if (static_cast<int>(out.slots.size()) < capacity) {
        out.slots.push_back(s);
      } else {
        ++out.left_out;
      }
    }
  }
  std::sort(out.slots.begin(), out.slots.end());
  return out;
}

struct trial {
  test::random_map_sizes size;
  int capacity;
  ft::local_map_params params;
};

template <typename Exec>
void compare(Exec const& exec, trial const& t, unsigned seed) {
  constexpr int batch = 2;
  std::mt19937 random(seed);
  int const cameras = t.size.cameras;
  int const keypoints = t.size.keypoints;
  test::mirrored<Exec, ft::odometry_map_view> map([&](ft::carver& c, ft::odometry_map_view& v) {
    carve(c, v, {t.size.slots, {t.size.positions, cameras, keypoints}}, batch);
  });
  test::mirrored<Exec, frame_arrays> in([&](ft::carver& c, frame_arrays& v) {
    carve(c, v.keypoints, keypoints, 2 * batch);
    carve(c, v.work, t.size.slots, batch);
    v.holder = c.take<int>(test::index(batch * cameras * keypoints));
    v.mode = c.take<ft::local_map_mode>(batch);
    v.votes = c.take<int>(batch * std::size_t{ft::max_keyframes});
    v.local.capacity = t.capacity;
    v.local.slots = c.take<int>(test::index(batch * t.capacity));
    v.local.count = c.take<int>(batch);
    v.local.left_out = c.take<int>(batch);
  });
  std::vector<outcome> expected;
  for (int b = 0; b < batch; ++b) {
    auto const plain = test::random_map(random, t.size);
    test::write_map(plain, map.host, b);
    in.host.mode[b] =
        static_cast<ft::local_map_mode>(std::max(0, 2 - static_cast<int>(random() % 4)));
    int* const votes = in.host.votes + b * ft::max_keyframes;
    for (int p = 0; p < ft::max_keyframes; ++p) { votes[p] = static_cast<int>(random() % 5); }
    std::vector<int> held;
    for (int c = 0; c < 2; ++c) {
      in.host.keypoints.count[2 * b + c] = static_cast<int>(random() % test::index(keypoints + 1));
      for (int i = 0; c < cameras && i < keypoints; ++i) {
        // Points of one part of the map, other slots, none.
        int const slot = static_cast<int>(random() % test::index(t.size.slots / 3 + 1)) +
                         static_cast<int>(random() % 9 == 0) * t.size.slots / 2 - 1;
        in.host.holder[(b * cameras + c) * keypoints + i] = slot;
        if (i < in.host.keypoints.count[2 * b + c]) { held.push_back(slot); }
      }
    }
    auto const order =
        plain_order(plain, held, in.host.mode[b], t.params, votes, map.host.keyframes.positions);
    expected.push_back(plain_choice(plain, order, t.capacity));
  }
  map.push(exec);
  in.push(exec);
  ft::frame_view frame;
  frame.keypoints = in.device.keypoints;
  frame.cameras = cameras;
  frame.batch = batch;
  frame.holder = in.device.holder;
  ft::choose_local_map(exec, {frame, in.device.mode, t.params, in.device.votes}, map.device,
                       in.device.local, in.device.work);
  in.pull(exec);
  for (int b = 0; b < batch; ++b) {
    int const* const slots = in.host.local.slots + b * t.capacity;
    int const count = in.host.local.count[b];
    ASSERT_LE(count, t.capacity);
    EXPECT_EQ(std::vector<int>(slots, slots + count), expected[test::index(b)].slots);
    EXPECT_EQ(in.host.local.left_out[b], expected[test::index(b)].left_out);
  }
}

template <typename Backend>
class ChooseLocalMap : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(ChooseLocalMap, test::backends);

TYPED_TEST(ChooseLocalMap, IsThatOfAPlainLoop) {
  TypeParam backend;
  std::vector<trial> const trials = {{{1000, 20, 1, 200, 20, 70}, 1000, {5, 3}},  // room for all
                                     {{1000, 20, 2, 200, 20, 70}, 100, {5, 3}},   // not
                                     {{1000, 20, 1, 200, 20, 70}, 1, {5, 0}},     // for one point
                                     {{33, 2, 2, 10, 1, 100}, 10, {1, 1}},        // one keyframe
                                     {{500, 8, 1, 50, 0, 0}, 100, {30, 10}},      // an empty map
                                     {{1, 2, 1, 1, 2, 100}, 1, {64, 32}},  // one slot, one keypoint
                                     {{5000, 130, 1, 300, 130, 60}, 700, {30, 10}},
                                     {{5000, 256, 2, 300, 256, 90}, 4000, {64, 32}},
                                     {{40000, 64, 1, 900, 64, 50}, 2000, {30, 10}}};
  for (std::size_t i = 0; i < trials.size(); ++i) {
    for (int seed = 0; seed < test::effort(trials[i].size.slots > 10000 ? 4 : 30); ++seed) {
      SCOPED_TRACE("trial " + std::to_string(i) + ", seed " + std::to_string(seed));
      compare(backend.exec, trials[i], static_cast<unsigned>(seed));
      if (::testing::Test::HasFailure()) { return; }
    }
  }
}

TYPED_TEST(ChooseLocalMap, RefusesParametersOutOfRange) {
  TypeParam backend;
  ft::local_map_input in;
  in.frame.batch = 0;
  in.params.keyframes = 65;
  EXPECT_THROW(ft::choose_local_map(backend.exec, in, {}, {}, {}), ft::bad_argument);
  in.params = {30, 33};
  EXPECT_THROW(ft::choose_local_map(backend.exec, in, {}, {}, {}), ft::bad_argument);
}

}  // namespace choose_local_map_test
