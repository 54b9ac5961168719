// SPDX-License-Identifier: Apache-2.0
// Loops of one camera: a lap is closed with its scale, the odometry itself is not changed, both
// executors have the same bits, files keep the scales, and places that look alike stay apart.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <sstream>
#include <vector>

#include "ft/cameras/monocular_rig.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/random.hpp"
#include "tests/support/room.hpp"

namespace monocular_loops_test {

using test::at;
using test::same;
using image = test::room::image;
using rig_type = ft::monocular_rig<ft::pinhole<float>>;
constexpr std::int64_t period = 50'000'000;
constexpr int lap = 74;
constexpr int frames = lap + 12;

rig_type rig() { return rig_type::make(test::room::rig().camera); }

/// What a camera sees that looks along z at a wall in two depths. @param different pieces of 4 m,
/// after which it begins anew @param x, z of the camera
image see(std::vector<image> const& walls, int different, double x, double z) {
  auto const camera = rig().camera;
  constexpr double texels = 100;  // per metre
  image out(at(test::room::width) * at(test::room::height));
  for (int v = 0; v < test::room::height; ++v) {
    for (int u = 0; u < test::room::width; ++u) {
      auto const d = camera.unproject({static_cast<float>(u), static_cast<float>(v)}).direction;
      bool const upper = d.y < 0;
      double const depth = (upper ? 2 : 3) - z;
      double const s = texels * (20 + x + depth * static_cast<double>(d.x));
      double const t = texels * (20 + depth * static_cast<double>(d.y));
      int const piece = static_cast<int>(s) / test::room::wall_side % different;
      out[at(v) * at(test::room::width) + at(u)] =
          test::texture_at(walls[at(2 * piece + (upper ? 0 : 1))], test::room::wall_side, s, t);
    }
  }
  return out;
}
/// 4.5 m there, and back a little farther from the wall.
std::vector<image> const& walk() {
  static std::vector<image> const all = [] {
    auto const walls = test::room::make_walls(0);
    std::vector<image> made;
    for (int i = 0; i < frames; ++i) {
      double const x = 0.12 * (i < lap / 2 ? i : lap - i);
      made.push_back(i < lap ? see(walls, 3, x, 0.3 * std::sin(6.2831853 * i / lap))
                             : made[at(i - lap)]);
    }
    return made;
  }();
  return all;
}

ft::odometry_params params() {
  auto p = test::room::odometry_params(8192);
  p.orb.features = 1000;
  p.window = {4, 2};
  p.keyframes = 8;  // the odometry itself has forgotten where it began
  p.local_map.keyframes = 6;
  p.loops.present = true;
  p.loops.recent = 8;
  return p;
}

struct answers {
  std::vector<ft::tracking> told;
  std::vector<ft::placed_keyframe> placed;
  int closed = 0;
};
template <typename Odometry>
answers run(Odometry& odo, std::vector<image> const& images, int from = 0, int to = frames) {
  answers a;
  for (int i = from; i < to; ++i) {
    a.told.push_back(odo.track(test::room::view(images[at(i)]), (i + 1) * period));
    a.closed += a.told.back().loops_closed;
  }
  a.placed = odo.placed_keyframes();
  return a;
}
double length(ft::vec3<double> const& v) { return std::sqrt(ft::dot(v, v)); }

template <typename Backend>
class MonocularLoops : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(MonocularLoops, test::backends);

TYPED_TEST(MonocularLoops, ALapIsClosedWithItsScale) {
  TypeParam backend;
  ft::odometry<typename TypeParam::exec_type, rig_type> odo(backend.exec, rig(), params(), 1,
                                                            ft::loops{});
  answers const a = run(odo, walk());
  EXPECT_GT(a.closed, 0);
  ASSERT_GT(a.placed.size(), 10u);
  bool corrected = false;
  for (int i = 0; i < frames; ++i) {
    ft::tracking const& t = a.told[at(i)];
    corrected = corrected || t.loops_closed > 0;
    if (!corrected) { EXPECT_TRUE(same(t.T_odom_camera, t.T_world_camera)) << i; }
    EXPECT_EQ(t.odom_scale != 1, corrected) << i;
    auto const p = t.T_world_odom * ft::scaled(t.T_odom_camera.t, t.odom_scale);
    EXPECT_LT(length(p - t.T_world_camera.t), 1e-12) << i;
  }
  // Its last pose beside that of a lap before, as a share of the path's diameter.
  ft::tracking const& last = a.told.back();
  ASSERT_EQ(last.state, ft::tracking_state::tracking);
  double const off = length(last.T_world_camera.t - a.told[at(frames - 1 - lap)].T_world_camera.t);
  EXPECT_LT(off, 0.02 * length(a.told[at(lap / 2)].T_world_camera.t - last.T_world_camera.t));
  EXPECT_EQ(a.placed.front().scale, 1);
  EXPECT_EQ(a.placed.back().scale, last.odom_scale);
}

TYPED_TEST(MonocularLoops, BothExecutorsHaveTheSameBits) {
  TypeParam backend;
  ft::odometry<typename TypeParam::exec_type, rig_type> odo(backend.exec, rig(), params(), 1,
                                                            ft::loops{});
  ft::host_exec const host(1);
  ft::odometry<ft::host_exec, rig_type> other(host, rig(), params(), 1, ft::loops{});
  answers const a = run(odo, walk()), b = run(other, walk());
  EXPECT_GT(a.closed, 0);
  for (int i = 0; i < frames; ++i) {
    EXPECT_EQ(a.told[at(i)].loops_closed, b.told[at(i)].loops_closed) << i;
    EXPECT_TRUE(same(a.told[at(i)].T_world_camera, b.told[at(i)].T_world_camera)) << i;
    EXPECT_EQ(a.told[at(i)].odom_scale, b.told[at(i)].odom_scale) << i;
  }
  // A file keeps the scales.
  std::stringstream file;
  odo.save_map(file);
  other.load_map(file);
  auto const read = other.placed_keyframes();
  ASSERT_EQ(read.size(), a.placed.size());
  for (std::size_t k = 0; k < read.size(); ++k) {
    EXPECT_EQ(read[k].scale, a.placed[k].scale);
    EXPECT_TRUE(same(read[k].T_world_camera, a.placed[k].T_world_camera));
  }
  // A prediction is one in the world, whose unit is not the odometry's.
  ft::odometry<ft::host_exec, rig_type> third(host, rig(), params(), 1, ft::loops{});
  run(third, walk(), 0, frames - 1);
  third.predict(b.told.back().T_world_camera);
  answers const c = run(third, walk(), frames - 1, frames);
  EXPECT_LT(length(c.told[0].T_world_camera.t - b.told.back().T_world_camera.t), 1e-3);
}

/// Sideways along a wall that looks the same after 4 m.
std::vector<image> const& passage() {
  static std::vector<image> const all = [] {
    auto const walls = test::room::make_walls(1);
    std::vector<image> made;
    for (int i = 0; i < 75; ++i) { made.push_back(see(walls, 1, 0.1 * i, 0)); }
    return made;
  }();
  return all;
}

// The images after a period are those before it: nothing but how far the camera may have drifted
// tells them apart.
TYPED_TEST(MonocularLoops, ARepeatedStructureIsNoLoop) {
  TypeParam backend;
  using odometry = ft::odometry<typename TypeParam::exec_type, rig_type>;
  for (bool const anything_fits : {false, true}) {
    auto p = params();
    if (anything_fits) { p.loops.max_drift = 10; }
    odometry odo(backend.exec, rig(), p, 1, ft::loops{});
    answers const a = run(odo, passage(), 0, 75);
    EXPECT_EQ(a.told.back().state, ft::tracking_state::tracking);
    EXPECT_EQ(a.closed > 0, anything_fits) << "the provoked loop is not even a candidate";
  }
}

// Its frames have no depths while it is lost.
TYPED_TEST(MonocularLoops, ItIsFoundAnywhereInALoadedMapThatStays) {
  TypeParam backend;
  using odometry = ft::odometry<typename TypeParam::exec_type, rig_type>;
  odometry maps(backend.exec, rig(), params(), 1, ft::loops{});
  answers const mapped = run(maps, walk(), 0, lap - 8);
  std::ostringstream file;
  maps.save_map(file);
  auto p = params();
  p.rules.localize_only = true;
  odometry odo(backend.exec, rig(), p, 1, ft::loops{});
  // Not of its first second, in which its points are adjusted after their keyframes were kept.
  for (int const from : {26, 48, 58}) {
    std::istringstream again(file.str());
    odo.load_map(again);
    answers const a = run(odo, walk(), from, from + 3);
    ASSERT_EQ(a.told.back().state, ft::tracking_state::tracking) << from;
    EXPECT_EQ(a.told.back().maps, 1);
    ft::placed_keyframe nearest{};  // of the map
    for (ft::placed_keyframe const& k : mapped.placed) {
      if (k.time_ns <= (from + 3) * period) { nearest = k; }
    }
    auto const of_map = [&](ft::tracking const& t) {
      return (nearest.T_world_camera.inverse() * t.T_world_camera).t;
    };
    // What the map was made of saw it there, in the units of the map.
    auto const want = (nearest.T_odom_camera.inverse() * mapped.told[at(from + 2)].T_odom_camera).t;
    auto const got = of_map(a.told.back());
    double const unit = nearest.scale;
    ft::vec3<double> const d{got.x - unit * want.x, got.y - unit * want.y, got.z - unit * want.z};
    EXPECT_LT(length(d), 0.02 * unit) << from;
  }
  std::ostringstream after;
  odo.save_map(after);
  EXPECT_TRUE(after.str() == file.str()) << "the map has changed";
}

}  // namespace monocular_loops_test
