// SPDX-License-Identifier: Apache-2.0
// Kept keyframes that look like one of them: votes against a plain count, poses against the true
// ones, scales of one camera, and the same bits on both executors.
#include "ft/kernels/loops/match_keyframes.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <vector>

#include "ft/cameras/monocular_rig.hpp"
#include "ft/containers/loop_archive.hpp"
#include "ft/core/error.hpp"
#include "ft/kernels/loops/keep_keyframe.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/example_rigs.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/plain_map.hpp"
#include "tests/support/random.hpp"

namespace match_keyframes_test {

using test::at;
constexpr int rows = 6;
constexpr int points = 150;
constexpr int query = 5;  ///< row
constexpr int alike = 2;  ///< the row that shows the same place

struct arrays {
  ft::loop_archive_view archive;
  ft::loop_workspace work;
  int* row = nullptr;    ///< [rows - 1] all but the query
  int* votes = nullptr;  ///< likewise
  ft::loop_match* found = nullptr;
};

using one_camera = ft::monocular_rig<ft::pinhole<float>>;
constexpr float unit = 0.6f;  ///< of the query in units of the row, of one camera

template <typename Rig>
Rig make_rig() {
  if constexpr (ft::is_monocular_v<Rig>) {
    return {test::example_rig<ft::rectified_rig>().camera};
  } else {
    return test::example_rig<Rig>();
  }
}
/// The camera of place i in a row.
template <typename Rig>
int camera_of(Rig const&, int i) {
  if constexpr (Rig::rectified) {
    return i * Rig::cameras / points;
  } else {
    return 0;
  }
}
template <typename Rig>
ft::vec3<double> in_camera(Rig const& rig, int c, ft::vec3<double> const& p) {
  if constexpr (Rig::rectified) { return rig.to_camera(c, p); }
  return p;
}
template <typename Rig>
ft::vec3<double> in_body(Rig const& rig, int c, ft::vec3<double> const& p) {
  if constexpr (Rig::rectified) { return rig.to_body(c, p); }
  return p;
}

/// Rows of random points; one of them sees `common` of the query's from another pose.
template <typename Exec, typename Rig>
struct scene {
  Exec const& exec;
  Rig rig = make_rig<Rig>();
  test::motion T_query_row = test::turn({0.1, 1, 0.2}, 0.25, {0.3, -0.05, 0.2});
  test::mirrored<Exec, arrays> data;

  scene(Exec const& on, unsigned seed, int common, int full = points)
      : exec(on), data([](ft::carver& c, arrays& v) {
          carve(c, v.archive, rows, points);
          carve(c, v.work, rows, points);
          c.place({rows}, v.row, v.votes, v.found);
        }) {
    put(seed, common, full);
    data.push(exec);
    arrays const& there = data.device;
    ft::vote_for_rows(exec, there.archive, {query, there.row, rows - 1}, 64, there.votes);
    ft::match_keyframes(exec, rig, there.archive, {query, there.row, rows - 1}, 7, {}, there.work,
                        there.found);
    data.pull(exec);
  }
  double off() const {
    auto const d = data.host.found[alike].T_query_row.centre() - T_query_row.centre();
    return std::sqrt(ft::dot(d, d));
  }

private:
  void put(unsigned seed, int common, int full) {
    test::generator random(seed);
    ft::loop_archive_view const& a = data.host.archive;
    for (int r = 0; r < rows; ++r) {
      a.count[r] = full;
      for (int i = 0; i < points; ++i) { put_point(random, r, i); }
    }
    for (int i = 0; i < common; ++i) { see_again(random, i); }
    for (int i = 0; i < rows - 1; ++i) { data.host.row[i] = i; }
  }
  void put_point(test::generator& random, int r, int i) {
    ft::loop_archive_view const& a = data.host.archive;
    std::ptrdiff_t const k = a.at(r) + i;
    int const c = camera_of(rig, i);
    ft::vec2<float> const pixel{random.real(150, 400), random.real(150, 350)};
    auto const ray = test::model_of(rig, c).unproject(pixel).direction;
    float const depth = random.real(2, 6) / ray.z;
    ft::vec3<float> const seen{ray.x * depth, ray.y * depth, ray.z * depth};
    a.point[k] = in_body(rig, c, seen.template cast<double>()).template cast<float>();
    a.x[k] = pixel.x;
    a.y[k] = pixel.y;
    a.right_x[k] = -1;
    a.inv_sigma2[k] = 1;
    a.camera[k] = c;
    a.orb[k] = random.descriptor();
  }
  /// Point i of the row is seen by the query.
  void see_again(test::generator& random, int i) {
    ft::loop_archive_view const& a = data.host.archive;
    std::ptrdiff_t const from = a.at(alike) + i, to = a.at(query) + (i * 7) % points;
    auto const p = T_query_row * a.point[from].template cast<double>();
    int const c = a.camera[to];
    auto const seen = test::model_of(rig, c).project(in_camera(rig, c, p).template cast<float>());
    a.point[to] = p.template cast<float>();
    if constexpr (ft::is_monocular_v<Rig>) {
      // Depths are known within some percent; one in eight is wrong.
      float const error = i % 8 == 0 ? random.real(0.2f, 4) : random.real(0.93f, 1.07f);
      a.point[to] = ft::scaled(a.point[to], error / unit);
    }
    a.x[to] = seen.pixel.x + random.real(-0.5f, 0.5f);
    a.y[to] = seen.pixel.y + random.real(-0.5f, 0.5f);
    a.orb[to] = random.flipped(a.orb[from], 12);
  }
};

/// The votes of a row, one distance after the other.
int plain_votes(ft::loop_archive_view const& a, int row, int asked) {
  int votes = 0;
  int const n = std::min(asked, a.count[query]);
  for (int s = 0; s < n; ++s) {
    ft::descriptor const& mine = a.orb[a.at(query) + s * a.count[query] / n];
    int best = 1000, second = 1000;
    for (int k = 0; k < a.count[row]; ++k) {
      int const d = ft::hamming(mine, a.orb[a.at(row) + k]);
      second = std::min(second, std::max(best, d));
      best = std::min(best, d);
    }
    votes += static_cast<int>(best <= 64 && 10 * best < 9 * second);
  }
  return votes;
}

template <typename Backend>
class MatchKeyframes : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(MatchKeyframes, test::backends);

TYPED_TEST(MatchKeyframes, CountsTheVotesOfEachRow) {
  TypeParam backend;
  for (unsigned seed = 1; seed < 5; ++seed) {
    for (int const full : {0, 1, 40, points}) {
      scene<typename TypeParam::exec_type, ft::rectified_rig> const s(backend.exec, seed, 90, full);
      for (int r = 0; r + 1 < rows; ++r) {
        EXPECT_EQ(s.data.host.votes[r], plain_votes(s.data.host.archive, r, 64)) << r << full;
      }
      if (full == points) { EXPECT_GE(s.data.host.votes[alike], 30); }
    }
  }
}

template <typename Rig, typename Exec>
void finds_the_pose(Exec const& exec) {
  for (unsigned seed = 1; seed < 6; ++seed) {
    SCOPED_TRACE(seed);
    scene<Exec, Rig> const s(exec, seed, 80);
    auto const& found = s.data.host.found[alike];
    EXPECT_GE(found.matches, 70);
    EXPECT_GE(found.inliers, 65);
    EXPECT_LT(s.off(), 0.02);
    EXPECT_GT(found.information[0], 0);
    EXPECT_EQ(found.scale, 1);
    EXPECT_EQ(found.scale_sigma, 0);
    for (int r = 0; r + 1 < rows; ++r) {
      if (r != alike) { EXPECT_LT(s.data.host.found[r].inliers, 12) << r; }
    }
  }
}
TYPED_TEST(MatchKeyframes, FindsThePoseOfThePlaceAndNoOther) {
  TypeParam backend;
  finds_the_pose<ft::rectified_rig>(backend.exec);
  finds_the_pose<test::fisheye_rig>(backend.exec);
  finds_the_pose<test::three_camera_rig>(backend.exec);
}

TYPED_TEST(MatchKeyframes, FindsTheScaleOfOneCamera) {
  TypeParam backend;
  double squares = 0;
  for (unsigned seed = 1; seed < 9; ++seed) {
    SCOPED_TRACE(seed);
    scene<typename TypeParam::exec_type, one_camera> const s(backend.exec, seed, 80);
    auto const& found = s.data.host.found[alike];
    EXPECT_GE(found.matches, 70);
    EXPECT_GE(found.inliers, 55);
    EXPECT_LE(found.inliers, 76) << "of points with a wrong depth";
    EXPECT_LT(s.off(), 0.02);
    double const error = std::log(found.scale * static_cast<double>(unit));
    EXPECT_GT(found.scale_sigma, 0.002);
    EXPECT_LT(found.scale_sigma, 0.01);
    EXPECT_LT(std::abs(error), 4 * found.scale_sigma);
    squares += error * error / (found.scale_sigma * found.scale_sigma);
    for (int r = 0; r + 1 < rows; ++r) {
      if (r != alike) { EXPECT_LT(s.data.host.found[r].inliers, 12) << r; }
    }
  }
  EXPECT_LT(squares / 8, 3);
  EXPECT_GT(squares / 8, 0.1);
}

TYPED_TEST(MatchKeyframes, FewPointsHaveNoPose) {
  TypeParam backend;
  for (int const full : {0, 1, 3, 7}) {
    scene<typename TypeParam::exec_type, ft::rectified_rig> const s(backend.exec, 3, full, full);
    for (int r = 0; r + 1 < rows; ++r) { EXPECT_EQ(s.data.host.found[r].inliers, 0); }
  }
}

template <typename Rig, typename Exec>
void expect_the_bits_of_the_host(Exec const& exec) {
  ft::host_exec const host;
  for (unsigned seed = 11; seed < 16; ++seed) {
    scene<Exec, Rig> const a(exec, seed, 60);
    scene<ft::host_exec, Rig> const b(host, seed, 60);
    auto const& x = a.data.host.found[alike];
    auto const& y = b.data.host.found[alike];
    EXPECT_GT(x.inliers, 0);
    EXPECT_EQ(x.matches, y.matches);
    EXPECT_EQ(x.inliers, y.inliers);
    EXPECT_EQ(std::memcmp(&x.T_query_row, &y.T_query_row, sizeof x.T_query_row), 0);
    EXPECT_EQ(std::memcmp(x.information, y.information, sizeof x.information), 0);
    EXPECT_EQ(x.scale, y.scale);
    EXPECT_EQ(x.scale_sigma, y.scale_sigma);
  }
}

TYPED_TEST(MatchKeyframes, BothExecutorsHaveTheSameBits) {
  TypeParam backend;
  expect_the_bits_of_the_host<ft::rectified_rig>(backend.exec);
  expect_the_bits_of_the_host<test::three_camera_rig>(backend.exec);
  expect_the_bits_of_the_host<one_camera>(backend.exec);
}

TYPED_TEST(MatchKeyframes, RefusesMoreRowsThanThereIsMemoryFor) {
  TypeParam backend;
  scene<typename TypeParam::exec_type, ft::rectified_rig> const s(backend.exec, 1, 0);
  arrays const& there = s.data.device;
  EXPECT_THROW(ft::match_keyframes(backend.exec, s.rig, there.archive, {query, there.row, rows + 1},
                                   7, {}, there.work, there.found),
               ft::bad_argument);
  auto const too_few = [](ft::carver& c, ft::loop_archive_view& v) { carve(c, v, 3, points); };
  using owner_type = ft::owner<ft::loop_archive_view, ft::memory_space::host>;
  EXPECT_THROW(owner_type{too_few}, ft::bad_argument);
}

// ---- what is kept of a frame

struct frame_arrays {
  ft::keypoints_view keypoints;
  float* depth = nullptr;
  float* right_x = nullptr;
  ft::loop_archive_view archive;
};
constexpr int capacity = 700;

/// Keeps keypoints of which each third has no depth. @return the archive's row 1
template <typename Exec>
ft::loop_archive_view keep(Exec const& exec, test::mirrored<Exec, frame_arrays>& data, int count) {
  auto const rig = test::example_rig<ft::rectified_rig>();
  test::generator random(5);
  frame_arrays const& v = data.host;
  for (int k = 0; k < capacity; ++k) {
    auto const left = v.keypoints.slice(0);
    left.x(k) = random.real(20, 300);
    left.y(k) = random.real(20, 200);
    left.octave(k) = k % 3;
    left.orb(k) = random.descriptor();
    v.depth[k] = k % 3 == 1 ? -1.0f : random.real(1, 9);
    v.right_x[k] = k % 3 == 1 ? -1.0f : left.x(k) - 5;
  }
  v.keypoints.count[0] = count;
  v.keypoints.count[1] = 0;
  data.push(exec);
  ft::keyframe_input<ft::rectified_rig> in{};
  in.rig = rig;
  in.frame.keypoints = data.device.keypoints;
  in.frame.right_x = data.device.right_x;
  in.depth = data.device.depth;
  in.geometry = ft::pyramid_geometry::make(640, 480, 3, 1.2f);
  ft::keep_keyframe(exec, in, 0, 1, data.device.archive);
  data.pull(exec);
  return data.host.archive;
}
template <typename Exec>
test::mirrored<Exec, frame_arrays> frame_memory() {
  return test::mirrored<Exec, frame_arrays>([](ft::carver& c, frame_arrays& v) {
    carve(c, v.keypoints, capacity, 2);
    c.place({capacity}, v.depth, v.right_x);
    carve(c, v.archive, 4, points);
  });
}

TYPED_TEST(MatchKeyframes, KeepsKeypointsWithADepthSpreadOverTheirOrder) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  auto const geometry = ft::pyramid_geometry::make(640, 480, 3, 1.2f);
  for (int const count : {0, 1, 2, 60, 225, 226, 699, 700}) {
    SCOPED_TRACE(count);
    auto data = frame_memory<exec_type>();
    ft::loop_archive_view const a = keep(backend.exec, data, count);
    std::vector<int> with_depth;
    for (int k = 0; k < count; ++k) {
      if (k % 3 != 1) { with_depth.push_back(k); }
    }
    int const all = static_cast<int>(with_depth.size());
    ASSERT_EQ(a.count[1], std::min(all, points));
    auto const left = data.host.keypoints.slice(0);
    int before = -1;
    for (int i = 0; i < a.count[1]; ++i) {
      int k = before + 1;  // the next one with that descriptor
      while (k < count && std::memcmp(&a.orb[a.at(1) + i], &left.orb(k), 32) != 0) { ++k; }
      ASSERT_LT(k, count);
      EXPECT_NE(k % 3, 1);
      EXPECT_LE(k - before, 2 + 3 * all / (2 * a.count[1]) + 1);
      before = k;
      int const octave = k % 3;
      EXPECT_EQ(a.x[a.at(1) + i], geometry.column(left.x(k), octave));
      EXPECT_EQ(a.y[a.at(1) + i], geometry.row(left.y(k), octave));
      EXPECT_EQ(a.right_x[a.at(1) + i], geometry.column(left.x(k) - 5, octave));
      EXPECT_EQ(a.inv_sigma2[a.at(1) + i], geometry.inv_sigma2[octave]);
      EXPECT_GT(a.point[a.at(1) + i].z, 0);
    }
  }
}

struct held_arrays {
  int* holder = nullptr;
  ft::map_points_view points;
  ft::rigid<double>* T_cw = nullptr;
  float* depth = nullptr;
  ft::vec3<float>* point = nullptr;
};

TYPED_TEST(MatchKeyframes, PlacesTheMapPointsThatKeypointsHold) {
  TypeParam backend;
  constexpr int slots = 40;
  test::mirrored<typename TypeParam::exec_type, held_arrays> data(
      [](ft::carver& c, held_arrays& v) {
        c.place({capacity}, v.holder, v.depth, v.point);
        c.place({1}, v.T_cw);
        carve(c, v.points, slots, 1);
      });
  test::generator random(9);
  held_arrays const& h = data.host;
  h.T_cw[0] = test::turn({0.2, 1, -0.1}, 0.7, {0.3, -0.2, 1.5});
  for (int s = 0; s < slots; ++s) {
    ft::get<ft::field::position>(h.points, s) = {random.real(-1, 1), random.real(-1, 1),
                                                 random.real(1, 4)};
  }
  for (int k = 0; k < capacity; ++k) { h.holder[k] = k % 3 == 0 ? -1 : k % slots; }
  data.push(backend.exec);
  ft::keyframe_input<one_camera> in{};
  in.frame.keypoints.capacity = capacity;
  in.frame.holder = data.device.holder;
  in.T_cw = data.device.T_cw;
  ft::place_held_points(backend.exec, in, data.device.points, data.device.depth, data.device.point);
  data.pull(backend.exec);
  for (int k = 0; k < capacity; ++k) {
    if (h.holder[k] < 0) {
      EXPECT_EQ(h.depth[k], -1) << k;
      continue;
    }
    auto const want =
        h.T_cw[0] * ft::get<ft::field::position>(h.points, k % slots).template cast<double>();
    auto const d = want - h.point[k].template cast<double>();
    EXPECT_LT(ft::dot(d, d), 1e-12) << k;
    EXPECT_EQ(h.depth[k], h.point[k].z) << k;
  }
}

}  // namespace match_keyframes_test
