// SPDX-License-Identifier: Apache-2.0
// Corrections of a path in slices: how long one is by counts alone, that they end where one go
// ends, and that an odometry whose corrections take several frames does not depend on the machine.
#include "ft/pipelines/detail/loop_correction.hpp"

#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "ft/core/execution.hpp"
#include "ft/pipelines/detail/loop_files.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/effort.hpp"
#include "tests/support/example_rigs.hpp"
#include "tests/support/random.hpp"
#include "tests/support/room.hpp"

namespace loop_correction_test {

using ft::detail::loop_path;
using ft::detail::with_scale;
using ft::detail::without_scale;
using test::at;
constexpr double whole_turn = 6.283185307179586;

float const certain[21] = {1e4f, 0, 0, 0, 0,    0, 1e4f, 0,    0, 0,   0,
                           1e4f, 0, 0, 0, 1e4f, 0, 0,    1e4f, 0, 1e4f};

/// A small motion by chance.
test::motion shake(test::generator& random, double by) {
  auto const any = [&] { return by * static_cast<double>(random.real(-1, 1)); };
  return test::turn({0, 0, 1}, any(), {any(), any(), any()});
}

/// Laps of 40 keyframes with motions that are off by chance, and loops between laps: each from a
/// keyframe one lap before. @param wrong how far a loop may be off, metres and rad
loop_path laps(int keyframes, int loops, double wrong, bool scaled = false) {
  test::generator random(5);
  constexpr int lap = 40;
  auto const place = [](int i) {
    double const a = whole_turn * i / lap;
    return test::turn({0, 1, 0}, a, {2 - 2 * std::cos(a), 0.0, 2 * std::sin(a)});
  };
  loop_path path;
  path.scaled = scaled;
  test::motion T = place(0);
  for (int i = 0; i < keyframes; ++i) {
    ft::detail::path_keyframe k;
    if (i > 0) { T = T * (place(i - 1).inverse() * place(i)) * shake(random, 0.01); }
    k.row = i;
    k.map = k.part = 1;
    k.T_odom_camera = T.orthonormalized();
    k.T_world_camera = with_scale(k.T_odom_camera);
    ft::detail::edge_information(certain, 1, k.information);
    path.keyframes.push_back(k);
  }
  for (int n = 0; n < loops; ++n) {
    ft::detail::path_loop l;
    l.to = lap + n % (keyframes - lap);
    l.from = l.to - lap;
    auto const measured = place(l.from).inverse() * place(l.to) * shake(random, wrong);
    l.T_from_to = with_scale(measured.orthonormalized());
    ft::detail::edge_information(certain, 1, l.information);
    l.scale_information = 1e4;
    path.loops.push_back(l);
  }
  return path;
}
double cost(loop_path const& path) {
  auto graph = ft::detail::path_graph<ft::similarity<double>>::of(path);
  ft::pose_graph_params params;
  params.steps = 0;
  return ft::optimize_pose_graph(ft::host_exec(), graph, params).given_cost;
}

TEST(LoopCorrection, SlicesEndWhereOneGoEnds) {
  for (bool const scaled : {false, true}) {
    loop_path const start = laps(100, 50, 0.3, scaled);  // many of them are outliers
    loop_path once = start;
    ft::detail::optimize(ft::host_exec(), once);
    EXPECT_EQ(once.damping, 0);
    loop_path path = start;
    double last = cost(path);
    int slices = 0;
    do {
      ft::detail::optimize(ft::host_exec(), path, 2);
      double const now = cost(path);
      EXPECT_LE(now, last * (1 + 1e-12));
      last = now;
      ++slices;
    } while (path.damping > 0 && slices < 50);
    EXPECT_GT(slices, 2);
    EXPECT_LT(slices, 50);
    EXPECT_LT(last, 0.9 * cost(start));
    EXPECT_NEAR(last, cost(once), 1e-4 * cost(once));
  }
}

// Every second keyframe looks back: an undamped step turns it too far, and is refused.
TEST(LoopCorrection, ARefusedStepIsNotTriedAgain) {
  loop_path path = laps(60, 10, 0.01);
  for (std::size_t i = 1; i < path.keyframes.size(); i += 2) {
    auto& T = path.keyframes[i].T_world_camera;
    T = with_scale(
        (without_scale(T) * test::turn({0.1, 1, 0.2}, 2.9, {0, 0, 0})).orthonormalized());
  }
  double const first = cost(path);
  int refused = 0;
  int steps = 0;
  do {
    double const before = cost(path), damping = path.damping;
    ft::detail::optimize(ft::host_exec(), path, 1);
    if (path.damping > 0 && cost(path) == before) {
      EXPECT_GT(path.damping, damping);
      ++refused;
    }
    ++steps;
  } while (path.damping > 0 && steps < 300);
  EXPECT_GT(refused, 0) << "this tests nothing";
  EXPECT_LT(steps, 300);
  EXPECT_LT(cost(path), 0.1 * first);
}

TEST(LoopCorrection, ASliceIsAsLongAsItsCountsSay) {
  std::int64_t last = 0;
  for (int const loops : {1, 20, 80, 200}) {
    auto const graph = ft::detail::path_graph<test::motion>::of(laps(160, loops, 0.01));
    std::int64_t const ns =
        ft::detail::nanoseconds_of_step(graph, ft::detail::elimination_order(graph));
    EXPECT_GT(ns, last);
    last = ns;
  }
  auto const few = slice_of(laps(45, 1, 0.01));
  EXPECT_EQ(few.frames, 0) << "it enters with its search";
  auto const more = slice_of(laps(300, 100, 0.01));
  EXPECT_GT(more.frames, 0);
  auto const many = slice_of(laps(1500, 3000, 0.01));
  EXPECT_GT(many.frames, 5 * more.frames);
  EXPECT_EQ(many.steps, few.steps);
  // Where one loop has moved everything does not matter.
  auto const elsewhere = slice_of(laps(300, 100, 0.3));
  EXPECT_EQ(elsewhere.steps, more.steps);
  EXPECT_EQ(elsewhere.frames, more.frames);
}

TEST(LoopCorrection, WithoutEdgesItHasEnded) {
  loop_path path = laps(41, 0, 0);
  for (std::size_t i = 0; i < path.keyframes.size(); ++i) {
    path.keyframes[i].map = static_cast<int>(i);
  }
  path.damping = ft::detail::first_path_damping;
  EXPECT_EQ(slice_of(path).frames, 0);
  ft::detail::optimize(ft::host_exec(), path, slice_of(path).steps);
  EXPECT_EQ(path.damping, 0);
}

template <typename Backend>
class LoopSlices : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(LoopSlices, test::backends);

constexpr int lap = 42;
constexpr int frames = 3 * lap;

/// Laps on a circle of 1.2 m, looking outwards.
std::vector<test::room::stereo_frame> const& walk() {
  static auto const all = [] {
    auto const rig = test::room::rig();
    auto const walls = test::room::make_walls(0);
    std::vector<test::room::stereo_frame> made;
    for (int i = 0; i < lap; ++i) {
      float const yaw = static_cast<float>(whole_turn * i / lap);
      float const c = std::cos(yaw), s = std::sin(yaw);
      ft::pose const T_wc{{{c, 0, s, 0, 1, 0, -s, 0, c}}, {0.6f * s, 0, 1.2f + 0.6f * c}};
      made.push_back(test::room::see(rig, walls, T_wc.inverse()));
    }
    return made;
  }();
  return all;
}

struct answers {
  std::vector<ft::tracking> told;
  ft::detail::correction_slice slice;  ///< of the path at the end
  int closed = 0;
};
template <typename Exec>
answers run(Exec const& exec, int pause_ms) {
  auto p = test::room::odometry_params(8192);
  p.window = {4, 2};
  p.keyframes = 12;  // the odometry itself has forgotten where it began
  p.local_map.keyframes = 8;
  p.loops.present = true;
  p.loops.recent = 20;
  ft::odometry<Exec> odo(exec, test::room::rig(), p, 1, ft::loops{});
  answers a;
  for (int i = 0; i < frames; ++i) {
    auto const& f = walk()[at(i % lap)];
    a.told.push_back(
        odo.track({test::room::view(f.left), test::room::view(f.right)}, (i + 1) * 50'000'000LL));
    a.closed += a.told.back().loops_closed;
    std::this_thread::sleep_for(std::chrono::milliseconds(pause_ms));
  }
  std::stringstream file;
  odo.save_map(file);
  std::istringstream loops(file.str().substr(file.str().rfind("ft loop archive")));
  ft::owner<ft::loop_archive_view, ft::memory_space::host> like(
      [&](ft::carver& c, ft::loop_archive_view& v) { carve(c, v, 2000, p.loops.points); });
  auto const saved =
      ft::detail::read_loops<ft::host_exec>(like.view(), {2000, 1 << 20, 1, false}, loops);
  loop_path path;
  path.keyframes = saved.keyframes;
  path.loops = saved.loops;
  a.slice = slice_of(path);
  return a;
}

TYPED_TEST(LoopSlices, TheMachinesSpeedIsNotSeen) {
  TypeParam backend;
  answers const at_once = run(backend.exec, 0);
  EXPECT_GT(at_once.closed, 4);
  EXPECT_GT(at_once.slice.frames, 0) << "corrections enter with their searches: tests nothing";
  if (!test::whole_effort()) { return; }  // a second run tells sanitizers nothing more
  answers const later = run(ft::host_exec(1), 8);
  ASSERT_EQ(at_once.told.size(), later.told.size());
  int corrections = 0;
  for (std::size_t i = 0; i < later.told.size(); ++i) {
    ft::tracking const& a = at_once.told[i];
    ft::tracking const& b = later.told[i];
    EXPECT_EQ(a.loops_closed, b.loops_closed) << i;
    EXPECT_EQ(std::memcmp(&a.T_world_odom, &b.T_world_odom, sizeof a.T_world_odom), 0) << i;
    EXPECT_EQ(std::memcmp(&a.T_world_camera, &b.T_world_camera, sizeof a.T_world_camera), 0) << i;
    bool const moved = i > 0 && std::memcmp(&a.T_world_odom, &at_once.told[i - 1].T_world_odom,
                                            sizeof a.T_world_odom) != 0;
    EXPECT_TRUE(!(a.loops_closed > 0) || moved) << i;
    corrections += static_cast<int>(moved);
  }
  EXPECT_GT(corrections, 2);
}

}  // namespace loop_correction_test
