// SPDX-License-Identifier: Apache-2.0
// The evidence of a lost camera's matches: against the formula in double, and against plain loops
// over points and keypoints.
#include "ft/kernels/odometry/recovery_evidence.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/odometry/frame_facts.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/plain_map.hpp"
#include "tests/support/random.hpp"

namespace recovery_evidence_test {

struct drawn {
  int k, n, p;
};

/// n KL(k / n || p) in bits.
double expected_bits(drawn const& d) {
  double const p = std::clamp(d.p, 1, 65535) / 65536.0;
  double const n = d.n;
  double const k = std::min(d.k, d.n);
  if (d.n < 1 || k <= n * p) { return 0; }
  double const rest = k < n ? (n - k) * std::log2((n - k) / (n * (1 - p))) : 0.0;
  return k * std::log2(k / (n * p)) + rest;
}

struct evidence_of {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, drawn const* from,
                                 std::int64_t* bits) const {
    bits[i] = ft::detail::binomial_evidence(from[i].k, from[i].n, from[i].p);
  }
};

template <typename Backend>
class RecoveryEvidence : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(RecoveryEvidence, test::backends);

TYPED_TEST(RecoveryEvidence, IsTheFormulaInIntegers) {
  TypeParam backend;
  std::vector<drawn> all{{0, 0, 100},
                         {5, 0, 100},
                         {0, 10, 100},
                         {10, 10, 0},
                         {10, 10, 70000},
                         {30, 20, 655},
                         {20, 25, 3000},
                         {20, 900, 3000},
                         {1, 1, 1},
                         {1 << 24, 1 << 24, 1},
                         {1 << 23, 1 << 24, 655},
                         {900, 1000, 65535},
                         {100, 1000, 6553},
                         {101, 1000, 6553}};
  test::generator random(3);
  for (int i = 0; i < 1000; ++i) {
    int const n = random.from_to(1, 5000);
    all.push_back({random.from_to(0, n), n, random.from_to(0, 65536)});
  }
  auto const from = test::to_exec(backend.exec, all);
  auto const to = test::to_exec(backend.exec, std::vector<std::int64_t>(all.size()));
  ft::for_each_item<ft::per_thread>(backend.exec, static_cast<int>(all.size()), evidence_of{},
                                    static_cast<drawn const*>(from.data()), to.data());
  auto const bits = test::from_exec(backend.exec, to.data(), all.size());
  for (std::size_t i = 0; i < all.size(); ++i) {
    double const got = static_cast<double>(bits[i]) / 65536;
    EXPECT_NEAR(got, expected_bits(all[i]), 1e-4 * std::max(all[i].n, 1))
        << all[i].k << " of " << all[i].n << " with " << all[i].p;
  }
  double const limit = ft::tracking_rules{}.min_evidence;
  EXPECT_GT(static_cast<double>(bits[6]) / 65536, limit) << "20 of 25";
  EXPECT_EQ(bits[7], 0) << "20 of 900";
}

constexpr int points = 60;
constexpr int keypoints = 400;
constexpr int width = 320;
constexpr int height = 240;

struct arrays {
  ft::keypoints_view keypoints;
  ft::feature_grid_view grid;
  ft::map_points_view map;
  ft::pose* T_cw = nullptr;
  int* slots = nullptr;
  int* count = nullptr;
  int* inliers = nullptr;
  std::int64_t* bits = nullptr;
  ft::visibility* seen = nullptr;
  ft::detail::chance_counts* chances = nullptr;
  ft::search_windows_view windows;
};

TYPED_TEST(RecoveryEvidence, CountsWhatAWrongPoseWouldMatch) {
  TypeParam backend;
  auto const rig = ft::rectified_rig::make({200.0f, 200.0f, 160.0f, 120.0f}, 0.1);
  auto const cells = ft::grid_geometry::over(0, 0, width, height);
  test::mirrored<typename TypeParam::exec_type, arrays> data([&](ft::carver& c, arrays& v) {
    carve(c, v.keypoints, keypoints, 2);
    carve(c, v.grid, cells, keypoints, 1);
    carve(c, v.map, points, 1);
    v.T_cw = c.take<ft::pose>(1);
    v.slots = c.take<int>(points);
    v.count = c.take<int>(1);
    v.inliers = c.take<int>(1);
    v.bits = c.take<std::int64_t>(1);
    v.seen = c.take<ft::visibility>(points);
    v.chances = c.take<ft::detail::chance_counts>(1);
    carve(c, v.windows, points, 1, 1);
  });
  auto const geometry = ft::pyramid_geometry::make(width, height, 4, 1.2f);
  test::generator random(8);
  arrays const& v = data.host;
  v.keypoints.count[0] = keypoints;
  v.keypoints.count[1] = 0;
  for (int i = 0; i < keypoints; ++i) {
    v.keypoints.x(i) = random.real(0, width - 6);  // the grid has no cell for the last ones
    v.keypoints.y(i) = random.real(0, height - 6);
    v.keypoints.octave(i) = random.below(4);
    v.keypoints.orb(i) = {};
    // Bits that differ from a point's: 64 are like it, 160 are not.
    int const different = random.below(3) == 0 ? 5 : 2;
    for (int w = 0; w < different; ++w) { v.keypoints.orb(i).words[w] = ~0u; }
  }
  *v.T_cw = ft::pose::identity();
  *v.count = points;
  for (int i = 0; i < points; ++i) {
    v.slots[i] = i % 10 == 9 ? -1 : i;
    bool const behind = i % 10 == 8;
    v.map.position(i) = {random.real(-1.2f, 1.2f), random.real(-0.9f, 0.9f), behind ? -4.0f : 4.0f};
    v.map.normal(i) = {0, 0, 1};
    v.map.max_distance(i) = 4.5f;
    v.map.min_distance(i) = 1;
    v.map.observations(i) = 1;
    v.map.orb(i) = {};
  }
  // The plain definition.
  int seen = 0;
  double by_chance = 0;
  for (int i = 0; i < points; ++i) {
    auto const at = v.map.position(i);
    if (v.slots[i] < 0 || at.z < 0) { continue; }
    ++seen;
    double const x = 200.0 * static_cast<double>(at.x / at.z) + 160;
    double const y = 200.0 * static_cast<double>(at.y / at.z) + 120;
    double const distance = std::sqrt(static_cast<double>(ft::dot(at, at)));
    int const level =
        std::max(0, static_cast<int>(std::ceil(std::log(4.5 / distance) / std::log(1.2))));
    double const side = 24 * std::pow(1.2, level);
    for (int k = 0; k < keypoints; ++k) {
      int const octave = v.keypoints.octave(k);
      bool const near = std::abs(static_cast<double>(v.keypoints.x(k)) - x) < side &&
                        std::abs(static_cast<double>(v.keypoints.y(k)) - y) < side;
      bool const like = v.keypoints.orb(k).words[4] == 0;
      if (!near || !like || octave < level - 1 || octave > level) { continue; }
      by_chance += 3.14159265 * 5.991 * std::pow(1.44, octave) / (4 * side * side);
    }
  }
  *v.inliers = seen / 2;
  data.push(backend.exec);
  arrays const& there = data.device;
  ft::build_grid<ft::nearest_cell>(backend.exec, there.keypoints, 0, 2, 1, there.grid);
  ft::frame_view frame;
  frame.keypoints = there.keypoints;
  frame.grids = there.grid;
  ft::local_search<ft::rectified_rig> search;
  search.rig = rig;
  search.T_cw = there.T_cw;
  search.slots = there.slots;
  search.slot_count = there.count;
  search.geometry = geometry;
  search.frustum.max_x = width;
  search.frustum.max_y = height;
  search.frustum.levels = 4;
  search.frustum.log_scale_factor = ft::log_rounded(1.2f);
  ft::weigh_recoveries(backend.exec, search, points, frame, there.map, there.inliers, there.bits);
  data.pull(backend.exec);
  ASSERT_GT(by_chance, 1) << "there is something to count";
  double const p = by_chance / seen;
  double const want = expected_bits({seen / 2, seen, static_cast<int>(p * 65536)});
  EXPECT_NEAR(static_cast<double>(*data.host.bits) / 65536, want, 0.005 * want);

  // The same of a camera that is not lost, from what its search has listed.
  search.seen = there.seen;
  ft::find_visible_points(backend.exec, search, there.map, there.windows);
  search.T_cw = nullptr;
  ft::count_chances_of_frames(backend.exec, frame, search, points, there.map, there.chances);
  data.pull(backend.exec);
  ft::detail::chance_counts const& n = *data.host.chances;
  EXPECT_EQ(n.points, seen);
  EXPECT_EQ(n.sampled, seen);
  EXPECT_NEAR(static_cast<double>(n.by_chance) / 65536, by_chance, 0.01 * by_chance);
  EXPECT_EQ(n.bits(seen / 2), *data.host.bits);
}

}  // namespace recovery_evidence_test
