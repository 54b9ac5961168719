// SPDX-License-Identifier: Apache-2.0
// Kept keyframes of a place that repeats: what is known of the motion tells its parts apart, and
// where that is not known well enough nothing is matched.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstring>

#include "ft/containers/loop_archive.hpp"
#include "ft/kernels/loops/match_keyframes.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/example_rigs.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/plain_map.hpp"
#include "tests/support/random.hpp"

namespace match_within_bounds_test {

constexpr int places = 70;
constexpr int points = 2 * places;  ///< of a row: each place, and what looks like it
constexpr float period = 1.5f;      ///< metres to the right
enum row_of { query, alike, rows };

struct arrays {
  ft::loop_archive_view archive;
  ft::loop_workspace work;
  int* row = nullptr;               ///< [1]
  ft::loop_bound* bound = nullptr;  ///< [1]
  ft::loop_match* found = nullptr;  ///< [1]
};

/// A row sees each place twice, a period apart; the query sees it once.
template <typename Exec>
struct facade {
  Exec const& exec;
  ft::rectified_rig rig = test::example_rig<ft::rectified_rig>();
  test::motion T_query_row = test::turn({0.1, 1, 0.2}, 0.2, {0.3, -0.05, 0.2});
  test::mirrored<Exec, arrays> data;

  facade(Exec const& on, unsigned seed)
      : exec(on), data([](ft::carver& c, arrays& v) {
          carve(c, v.archive, 4, points);
          carve(c, v.work, rows, points);
          c.place({1}, v.row, v.bound, v.found);
        }) {
    test::generator random(seed);
    ft::loop_archive_view const& a = data.host.archive;
    a.count[query] = places;
    a.count[alike] = points;
    data.host.row[0] = alike;
    for (int i = 0; i < places; ++i) {
      ft::vec3<float> const p{random.real(-1, 1), random.real(-1, 1), random.real(2.5f, 4)};
      ft::descriptor const d = random.descriptor();
      put(a.at(alike) + i, p, d);
      put(a.at(alike) + places + i, {p.x + period, p.y, p.z}, d);
      put(a.at(query) + i, (T_query_row * p.cast<double>()).cast<float>(), random.flipped(d, 12));
    }
  }
  /// @param known as it is taken to be: off by so many metres to the right
  ft::loop_match const& match(double known, float shift, float turn, bool is_bound = true) {
    test::motion T = T_query_row;
    T.t = T.t + T.R * ft::vec3<double>{known, 0, 0};
    data.host.bound[0] = {T.cast<float>(), shift, turn};
    data.push(exec);
    arrays const& there = data.device;
    ft::match_keyframes(exec, rig, there.archive,
                        {query, there.row, 1, true, is_bound ? there.bound : nullptr}, 7, {},
                        there.work, there.found);
    data.pull(exec);
    return data.host.found[0];
  }

private:
  void put(std::ptrdiff_t k, ft::vec3<float> const& p, ft::descriptor const& d) {
    ft::loop_archive_view const& a = data.host.archive;
    auto const pixel = rig.camera.project(p).pixel;
    a.point[k] = p;
    a.x[k] = pixel.x;
    a.y[k] = pixel.y;
    a.right_x[k] = -1;
    a.inv_sigma2[k] = 1;
    a.camera[k] = 0;
    a.orb[k] = d;
  }
};

template <typename Backend>
class MatchWithinBounds : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(MatchWithinBounds, test::backends);

TYPED_TEST(MatchWithinBounds, WhatRepeatsIsToldApartWhereTheMotionIsKnown) {
  TypeParam backend;
  for (unsigned seed = 1; seed < 5; ++seed) {
    SCOPED_TRACE(seed);
    facade<typename TypeParam::exec_type> f(backend.exec, seed);
    EXPECT_LT(f.match(0, 0, 0, false).matches, 5) << "each has a rival";
    for (double const known : {-0.3, 0.0, 0.3}) {
      ft::loop_match const& found = f.match(known, 0.4f, 0.05f);
      EXPECT_GE(found.matches, places - 5) << known;
      EXPECT_GE(found.inliers, places - 5) << known;
      auto const off = found.T_query_row.centre() - f.T_query_row.centre();
      EXPECT_LT(std::sqrt(ft::dot(off, off)), 0.01) << known;
    }
  }
}

TYPED_TEST(MatchWithinBounds, WhatRepeatsWithinTheBoundIsNotMatched) {
  TypeParam backend;
  for (unsigned seed = 1; seed < 5; ++seed) {
    SCOPED_TRACE(seed);
    facade<typename TypeParam::exec_type> f(backend.exec, seed);
    EXPECT_LT(f.match(0, 2, 0).matches, 5) << "both are near enough";
    EXPECT_LT(f.match(0, 0.1f, 1).matches, 5) << "for a turn, too";
    EXPECT_LT(f.match(-0.75, 1, 0).matches, 5) << "between both";
    EXPECT_LT(f.match(-0.75, 0.2f, 0).matches, 5) << "neither is";
  }
}

TYPED_TEST(MatchWithinBounds, BothExecutorsHaveTheSameBits) {
  TypeParam backend;
  ft::host_exec const host;
  for (unsigned seed = 11; seed < 15; ++seed) {
    for (float const shift : {0.2f, 0.9f, 1.2f}) {
      facade<typename TypeParam::exec_type> a(backend.exec, seed);
      facade<ft::host_exec> b(host, seed);
      ft::loop_match const& x = a.match(0.1, shift, 0.03f);
      ft::loop_match const& y = b.match(0.1, shift, 0.03f);
      EXPECT_EQ(x.matches, y.matches);
      EXPECT_EQ(x.inliers, y.inliers);
      if (x.inliers == 0) { continue; }
      EXPECT_EQ(std::memcmp(&x.T_query_row, &y.T_query_row, sizeof x.T_query_row), 0);
      EXPECT_EQ(std::memcmp(x.information, y.information, sizeof x.information), 0);
    }
  }
}

TEST(LoopBound, AllowsWhatIsNearTheRayOfThePoint) {
  ft::loop_bound bound;
  bound.T_query_row = ft::pose::identity();
  bound.T_query_row.t = {1, 0, 0};
  bound.shift = 0.5f;
  // A row's point that the query is expected to see straight ahead, 4 m away.
  EXPECT_TRUE(bound.allows({-1, 0, 4}, {0, 0, 1}));
  EXPECT_TRUE(bound.allows({-0.51f, 0, 4}, {0, 0, 9})) << "whatever the depth that the query has";
  EXPECT_FALSE(bound.allows({-0.49f, 0, 4}, {0, 0, 9}));
  EXPECT_FALSE(bound.allows({-1, 0, -4}, {0, 0, 9})) << "behind";
  EXPECT_TRUE(bound.allows({-1, 0, -0.4f}, {0, 0, 9})) << "the motion may be off by more";
  bound.turn = 0.1f;  // 0.4 m more there
  EXPECT_TRUE(bound.allows({-0.15f, 0, 4}, {0, 0, 1}));
  EXPECT_FALSE(bound.allows({-0.05f, 0, 4}, {0, 0, 1}));
}

}  // namespace match_within_bounds_test
