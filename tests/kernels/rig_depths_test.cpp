// SPDX-License-Identifier: Apache-2.0
// Depths in rigs of cameras of several models: pairs against the stages of one pair, depth images
// against a loop; on every executor the bits of the host.
#include "ft/kernels/stereo/rig_depths.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <random>
#include <vector>

#include "ft/cameras/double_sphere.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/mixed_rig.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/memory.hpp"

namespace rig_depths_test {

constexpr int width = 512;
constexpr int height = 400;
constexpr int levels = 4;
constexpr int capacity = 160;
constexpr int points = 120;  ///< that both cameras of the pair see
constexpr int rigs = 2;
constexpr int cameras = 3;
constexpr int left_camera = 2;  ///< the right one comes first
constexpr int right_camera = 0;
using rig_type = ft::mixed_rig<cameras>;
using any = ft::any_camera<float>;
using host_keypoints = ft::keypoints<ft::memory_space::host>;

rig_type make_rig() {
  using camera = ft::mixed_rig_camera;
  auto const I = ft::pose::identity();
  ft::pose T_right = I;
  T_right.t = {-0.2f, 0.003f, 0.001f};
  rig_type rig;
  rig.of[right_camera] = camera::single(
      any::of(ft::radtan4<float>{210, 211, 255, 199, {-0.05f, 0.004f, 0.0002f, -0.0001f}}),
      T_right);
  rig.of[1] = camera::with_depth(
      any::of(ft::double_sphere<float>{220, 221, 256, 200, -0.17f, 0.59f}), 0.1, 0.001f, I);
  rig.of[1].min_depth = 0.5f;
  rig.of[1].max_depth = 20;
  rig.of[left_camera] = camera::single(
      any::of(ft::kannala_brandt<float>{200, 201, 254, 201, -0.01f, 0.003f, -0.002f, 0.0003f}), I);
  ft::pair_up(rig, left_camera, right_camera);
  rig.check();
  return rig;
}
ft::any_pair pair_of(rig_type const& rig) {
  return {rig.of[left_camera].camera, rig.of[right_camera].camera,
          ft::pair_motion(rig, left_camera)};
}

/// Keypoints of all cameras: both of the pair see the same points, in another order, with nearly
/// equal descriptors; the rest is clutter.
host_keypoints make_keypoints(rig_type const& rig, ft::pyramid_geometry const& geometry,
                              unsigned seed) {
  host_keypoints all(capacity, 2 * cameras * rigs);
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> unit(0, 1);
  for (int image = 0; image < 2 * cameras * rigs; ++image) {
    ft::keypoints_view const v = all.view().slice(image);
    *v.count = image % 2 == 0 ? capacity : 0;
    for (int i = 0; i < capacity; ++i) {
      v.x(i) = 20 + unit(random) * (width - 40);
      v.y(i) = 20 + unit(random) * (height - 40);
      v.octave(i) = static_cast<int>(random() % levels);
      for (auto& word : v.orb(i).words) { word = static_cast<std::uint32_t>(random()); }
    }
  }
  auto const of_pair = pair_of(rig);
  for (int b = 0; b < rigs; ++b) {
    ft::keypoints_view const l = all.view().slice(2 * (cameras * b + left_camera));
    ft::keypoints_view const r = all.view().slice(2 * (cameras * b + right_camera));
    for (int i = 0; i < points; ++i) {
      int const j = (7 * i + 3) % points;
      float const z = 0.5f + 3 * unit(random);
      ft::vec3<float> const p{z * (unit(random) - 0.4f), z * (unit(random) - 0.5f), z};
      auto const a = of_pair.left.project(p).pixel;
      auto const c = of_pair.right.project(of_pair.T_rl * p).pixel;
      l.octave(i) = r.octave(j) = static_cast<int>(random() % levels);
      l.x(i) = geometry.level_column(a.x, l.octave(i));
      l.y(i) = geometry.level_row(a.y, l.octave(i));
      r.x(j) = geometry.level_column(c.x, r.octave(j));
      r.y(j) = geometry.level_row(c.y, r.octave(j));
      r.orb(j) = l.orb(i);
      r.orb(j).words[i % 8] ^= 1u << (random() % 32);
    }
  }
  return all;
}

struct pair_result {
  std::vector<int> partner;
  std::vector<float> depth, x, y;
};

template <typename Backend>
class rig_depths : public test::on_backend<Backend> {
protected:
  Backend backend;

  static ft::pyramid_geometry geometry_of(bool exact) {
    auto g = ft::pyramid_geometry::make(width, height, levels, 1.2f);
    g.exact = exact;
    return g;
  }
  /// @param pixels of the pyramid: partners are refined; may be empty
  template <typename Exec>
  static pair_result run_pair(Exec const& exec, host_keypoints const& given,
                              ft::pyramid_geometry const& geometry,
                              std::vector<std::uint8_t> const& pixels) {
    rig_type const rig = make_rig();
    ft::keypoints<Exec::space> const keypoints(capacity, 2 * cameras * rigs);
    ft::copy(exec, keypoints.view(), given.view());
    std::size_t const n = std::size_t{rigs} * cameras * capacity;
    auto const partner = test::to_exec(exec, std::vector<int>(n, -1));
    auto const depth = test::to_exec(exec, std::vector<float>(n, -1));
    ft::pair_of_rig const place{left_camera, right_camera, cameras,
                                const_cast<int*>(partner.data()), const_cast<float*>(depth.data())};
    ft::match_pair(exec, {pair_of(rig), geometry, nullptr, {}}, place, keypoints.view());
    if (!pixels.empty()) {
      ft::image_pyramid<Exec::space> const pyramid(geometry, 2 * cameras * rigs);
      ft::copy(exec, pyramid.view().data, pixels.data(), pixels.size());
      ft::refine_pair(exec, pair_of(rig), place, pyramid.view(), keypoints.view());
      exec.wait();
    }
    return {test::from_exec(exec, static_cast<int const*>(partner.data()), n),
            test::from_exec(exec, static_cast<float const*>(depth.data()), n),
            test::column<ft::field::x>(exec, keypoints.view()),
            test::column<ft::field::y>(exec, keypoints.view())};
  }
};
TYPED_TEST_SUITE(rig_depths, test::backends);

TEST(mixed_rig_camera, not_used_has_no_other_image) {
  ft::mixed_rig_camera camera = ft::mixed_rig_camera::none();
  EXPECT_NO_THROW(camera.check());
  camera.has_depth_image = true;
  camera.baseline = 0.1;
  EXPECT_THROW(camera.check(), ft::bad_argument);
}

TYPED_TEST(rig_depths, of_a_pair_are_those_of_match_stereo_fisheye) {
  auto const& exec = this->backend.exec;
  auto const geometry = this->geometry_of(false);
  rig_type const rig = make_rig();
  auto const given = make_keypoints(rig, geometry, 1);
  auto const found = this->run_pair(exec, given, geometry, {});
  for (int b = 0; b < rigs; ++b) {
    host_keypoints alone(capacity, 2);
    for (int side = 0; side < 2; ++side) {
      int const c = side == 0 ? left_camera : right_camera;
      auto const from = given.view().slice(2 * (cameras * b + c));
      auto const to = alone.view().slice(side);
      *to.count = *from.count;
      for (int i = 0; i < capacity; ++i) {
        to.x(i) = from.x(i);
        to.y(i) = from.y(i);
        to.octave(i) = from.octave(i);
        to.orb(i) = from.orb(i);
      }
    }
    std::vector<int> const none(2, 0);
    ft::owner<ft::fisheye_matches_view, ft::memory_space::host> const memory(
        [&](ft::carver& c, ft::fisheye_matches_view& v) { ft::carve(c, v, capacity, 1); });
    ft::match_stereo_fisheye(
        ft::host_exec(1), ft::fisheye_stereo<ft::any_pair>{pair_of(rig), geometry, none.data(), {}},
        alone.view(), memory.view());
    int matched = 0;
    std::size_t const first = static_cast<std::size_t>(b) * cameras * capacity;
    for (int i = 0; i < capacity; ++i) {
      auto const l = first + static_cast<std::size_t>(left_camera * capacity + i);
      auto const r = first + static_cast<std::size_t>(right_camera * capacity + i);
      int const partner = memory->partner[i];
      int const back = memory->partner[capacity + i];
      EXPECT_EQ(found.partner[l], partner < 0 ? -1 : partner - capacity + right_camera * capacity);
      EXPECT_EQ(found.partner[r], back < 0 ? -1 : back + left_camera * capacity);
      EXPECT_EQ(found.depth[l], memory->depth[i]) << i;
      EXPECT_EQ(found.depth[r], -1) << "right keypoints have none";
      matched += static_cast<int>(partner >= 0);
    }
    EXPECT_GT(matched, points * 3 / 4);
  }
}

TYPED_TEST(rig_depths, of_pairs_have_the_bits_of_the_host) {
  auto const geometry = this->geometry_of(true);
  auto const given = make_keypoints(make_rig(), geometry, 2);
  std::vector<std::uint8_t> pixels(static_cast<std::size_t>(2 * cameras * rigs) *
                                   static_cast<std::size_t>(geometry.bytes));
  std::mt19937 random(3);
  for (auto& p : pixels) { p = static_cast<std::uint8_t>(random()); }
  for (bool const refined : {false, true}) {
    auto const of = refined ? pixels : std::vector<std::uint8_t>();
    auto const here = this->run_pair(this->backend.exec, given, geometry, of);
    auto const host = this->run_pair(ft::host_exec(1), given, geometry, of);
    EXPECT_EQ(here.partner, host.partner);
    EXPECT_TRUE(test::same_bits(here.depth, host.depth));
    EXPECT_TRUE(test::same_bits(here.x, host.x));
    EXPECT_TRUE(test::same_bits(here.y, host.y));
  }
}

TYPED_TEST(rig_depths, of_depth_images_are_those_of_a_loop) {
  auto const& exec = this->backend.exec;
  auto const geometry = this->geometry_of(true);
  rig_type const rig = make_rig();
  auto const given = make_keypoints(rig, geometry, 4);
  std::vector<std::uint16_t> image(std::size_t{width} * height);
  std::mt19937 random(5);
  for (auto& p : image) { p = static_cast<std::uint16_t>(random() % 30000); }
  auto const depth = test::to_exec(exec, image);
  std::vector<ft::depth_source> places(std::size_t{rigs} * cameras);
  for (int b = 0; b < rigs; ++b) {
    places[static_cast<std::size_t>(cameras * b + 1)] = {depth.data(), 2 * width, 0};
  }
  auto const table = test::to_exec(exec, places);
  ft::keypoints<TypeParam::exec_type::space> const keypoints(capacity, 2 * cameras * rigs);
  ft::copy(exec, keypoints.view(), given.view());
  ft::stereo_matches<TypeParam::exec_type::space> const out(capacity, cameras * rigs);
  std::size_t const n = std::size_t{rigs} * cameras * capacity;
  std::vector<float> const before(n, -7);
  ft::copy(exec, ft::array_of<ft::field::depth>(out.view()), before.data(), n);
  ft::copy(exec, ft::array_of<ft::field::right_x>(out.view()), before.data(), n);
  ft::read_rig_depths(exec, rig, geometry, keypoints.view(),
                      {table.data(), width, height, cameras * rigs}, out.view());
  auto const depths = test::column<ft::field::depth>(exec, out.view());
  auto const right = test::column<ft::field::right_x>(exec, out.view());
  int some = 0;
  for (std::size_t k = 0; k < n; ++k) {
    auto const entry = static_cast<int>(k) / capacity;
    int const i = static_cast<int>(k) % capacity;
    auto const from = given.view().slice(2 * entry);
    float want = -7;
    if (entry % cameras == 1) {
      int const octave = from.octave(i);
      float const x = geometry.column(from.x(i), octave);
      auto const row = static_cast<std::size_t>(std::lround(geometry.row(from.y(i), octave)));
      float const d =
          static_cast<float>(image[row * width + static_cast<std::size_t>(std::lround(x))]) *
          0.001f;
      if (d >= 0.5f && d <= 20) { want = geometry.level_depth(d, octave); }
      if (want > 0) {
        // The disparity of a pair with the camera's baseline, in the input image.
        float const disparity = 0.1f * 220 / d;
        if (x - disparity > 0.01f) {
          EXPECT_NEAR(x - geometry.column(right[k], octave), disparity, 1e-3f * disparity) << k;
        } else if (x - disparity < -0.01f) {
          EXPECT_EQ(right[k], -1) << k;
        }
        ++some;
      }
    }
    EXPECT_EQ(depths[k], want) << k;
    if (want < 0) { EXPECT_EQ(right[k], -7) << k; }
  }
  EXPECT_GT(some, rigs * capacity / 2);
}

}  // namespace rig_depths_test
