// SPDX-License-Identifier: Apache-2.0
// The map of drawn points, against one that is filled point by point.
#include "integration/orbslam3/drawn_points.hpp"

#include <gtest/gtest.h>

#include <cstddef>
#include <map>
#include <random>
#include <utility>
#include <vector>

namespace drawn_points_test {

using place = std::pair<float, float>;
using drawn = std::map<unsigned long, place>;

/// Points in slots, of which some are in view; slots are given to other points from time to time.
struct moving_view {
  std::mt19937 random{3};
  std::vector<unsigned long> id;
  unsigned long next = 0;

  explicit moving_view(std::size_t slots) {
    for (std::size_t s = 0; s < slots; ++s) { id.push_back(next++); }
  }
  bool one_in(unsigned n) { return random() % n == 0; }
  /// Fills `to` and returns what the map must be.
  drawn show(ft::orbslam3::drawn_points<drawn>& to, unsigned changes) {
    drawn want;
    to.begin();
    for (std::size_t s = 0; s < id.size(); ++s) {
      if (changes > 0 && one_in(changes)) { id[s] = next++; }
      bool const in_view = changes == 0 ? s % 3 != 0 : (s + next) % 5 != 0;
      for (int times = in_view ? 1 + static_cast<int>(s % 50 == 1) : 0; times > 0; --times) {
        place const at{static_cast<float>(random() % 1000), static_cast<float>(s)};
        to.put(static_cast<int>(s), id[s], at);
        want[id[s]] = at;
      }
    }
    return want;
  }
};

TEST(drawn_points, are_those_of_a_plain_map) {
  for (unsigned const changes : {0u, 200u, 20u, 2u}) {
    moving_view view(700);
    ft::orbslam3::drawn_points<drawn> points;
    for (int frame = 0; frame < 60; ++frame) {
      drawn to;
      drawn const want = view.show(points, frame % 7 == 0 ? 0 : changes);
      points.move_to(to);
      EXPECT_EQ(to, want) << "frame " << frame << ", changes " << changes;
    }
  }
}

TEST(drawn_points, join_those_that_a_map_has) {
  moving_view view(40);
  ft::orbslam3::drawn_points<drawn> points;
  for (int frame = 0; frame < 3; ++frame) {
    drawn to{{7, {1.0f, 2.0f}}, {5000, {3.0f, 4.0f}}};
    drawn want = to;
    for (auto const& [id, at] : view.show(points, 0)) { want[id] = at; }
    points.move_to(to);
    EXPECT_EQ(to, want);
  }
}

TEST(drawn_points, may_be_none) {
  ft::orbslam3::drawn_points<drawn> points;
  drawn to;
  points.begin();
  points.move_to(to);
  EXPECT_TRUE(to.empty());
  points.begin();
  points.put(3, 12, {1.0f, 1.0f});
  points.move_to(to);
  EXPECT_EQ(to, (drawn{{12, {1.0f, 1.0f}}}));
  to.clear();
  points.begin();
  points.move_to(to);  // its node was made, and it is not in view any more
  EXPECT_TRUE(to.empty());
}

TEST(drawn_points, end_while_nodes_are_made) {
  for (int round = 0; round < 20; ++round) {
    moving_view view(2000);
    ft::orbslam3::drawn_points<drawn> points;
    drawn to;
    drawn const want = view.show(points, 0);
    points.move_to(to);
    EXPECT_EQ(to, want);
  }
}

}  // namespace drawn_points_test
