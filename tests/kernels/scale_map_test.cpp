// SPDX-License-Identifier: Apache-2.0
// A map that gets another unit: points, keyframes, the camera and its last correction move about a
// place, so that every camera sees its points where it saw them.
#include "ft/kernels/odometry/scale_map.hpp"

#include <gtest/gtest.h>

#include <random>
#include <vector>

#include "tests/support/backends.hpp"
#include "tests/support/random_maps.hpp"

namespace scale_map_test {

constexpr int batch = 3, slots = 1500, positions = 12, keypoints = 40;
constexpr double factors[batch] = {2.5, 1, 0.3};
using motion = ft::rigid<double>;
using vector = ft::vec3<double>;

struct scaled_world {
  ft::odometry_map_view map;
  ft::odometry_state_view state;
  ft::map_scaling* scaling = nullptr;
  motion* correction = nullptr;
};

vector scaled_about(vector const& p, ft::map_scaling const& s) {
  return s.about + ft::scaled(p - s.about, s.factor);
}
void expect_near(vector const& a, vector const& b, double most) {
  EXPECT_NEAR(a.x, b.x, most);
  EXPECT_NEAR(a.y, b.y, most);
  EXPECT_NEAR(a.z, b.z, most);
}
/// Whether a pose sees the world in its new unit as it saw it in the old one.
void expect_scaled(motion const& before, motion const& after, ft::map_scaling const& s) {
  vector const p{0.7, -0.4, 3};
  expect_near(after * scaled_about(p, s), ft::scaled(before * p, s.factor), 1e-12);
}

template <typename Backend>
class scale_map : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(scale_map, test::backends);

TYPED_TEST(scale_map, cameras_see_what_they_saw) {
  using exec_type = typename TypeParam::exec_type;
  TypeParam backend;
  test::mirrored<exec_type, scaled_world> world([&](ft::carver& c, scaled_world& v) {
    carve(c, v.map, {slots, {positions, 1, keypoints}}, batch);
    carve(c, v.state, batch);
    v.scaling = c.take<ft::map_scaling>(batch);
    v.correction = c.take<motion>(batch);
  });
  clear(backend.exec, world.device.map);
  world.pull(backend.exec);
  std::mt19937 random(7);
  std::vector<test::plain_map> before;
  std::vector<motion> T_cw, keyframe, velocity, correction;
  for (int b = 0; b < batch; ++b) {
    before.push_back(test::random_map(random, {slots, positions, 1, keypoints, 9, 1200}));
    test::write_map(before.back(), world.host.map, b);
    for (auto* list : {&T_cw, &keyframe, &velocity, &correction}) {
      list->push_back(test::random_motion(random, 1, 3));
    }
    world.host.state.T_cw[b] = T_cw.back();
    ft::camera_track& t = world.host.state.tracks[b] = ft::camera_track::initial();
    t.keyframe = keyframe.back();
    t.velocity.motion = velocity.back();
    world.host.correction[b] = correction.back();
    world.host.scaling[b] = {factors[b], {1.5, -0.5, 0.25 * b}};
  }
  world.push(backend.exec);
  ft::scale_maps(backend.exec, world.device.scaling, world.device.map, world.device.state,
                 world.device.correction);
  world.pull(backend.exec);
  for (int b = 0; b < batch; ++b) {
    SCOPED_TRACE(b);
    auto const i = test::index(b);
    ft::map_scaling const s = world.host.scaling[b];
    test::plain_map want = before[i];
    for (test::plain_point& p : want.points) {
      if (p.number == 0 || factors[b] == 1) { continue; }
      p.position = scaled_about(p.position.template cast<double>(), s).template cast<float>();
      p.least *= static_cast<float>(s.factor);
      p.most *= static_cast<float>(s.factor);
    }
    auto found = test::read_map(world.host.map, b);
    for (auto& [number, f] : want.keyframes) {
      expect_scaled(f.T_cw, found.keyframes.at(number).T_cw, s);
      f.T_cw = found.keyframes.at(number).T_cw;
    }
    test::expect_same_map(found, want, 1e-5f);
    ft::camera_track const& t = world.host.state.tracks[b];
    expect_scaled(T_cw[i], world.host.state.T_cw[b], s);
    expect_scaled(keyframe[i], t.keyframe, s);
    expect_near(t.velocity.motion.t, ft::scaled(velocity[i].t, s.factor), 1e-12);
    // What moved a point moves it still.
    vector const p{0.2, 1.1, -2};
    expect_near(world.host.correction[b] * scaled_about(p, s), scaled_about(correction[i] * p, s),
                1e-12);
  }
}

}  // namespace scale_map_test
