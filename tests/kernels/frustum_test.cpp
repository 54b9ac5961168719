// SPDX-License-Identifier: Apache-2.0
// Visibility of map points: every reason of section 8 of the specification to reject one, the
// predicted level, and the search windows that follow.
#include "ft/kernels/search/frustum.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <random>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "tests/support/backends.hpp"

namespace frustum_test {

using fisheye_rig = ft::stereo_rig<ft::kannala_brandt<float>, ft::kannala_brandt<float>>;
inline constexpr float nan = std::numeric_limits<float>::quiet_NaN();
inline constexpr int width = 640;
inline constexpr int height = 480;

struct map_point {
  ft::vec3<float> position;
  ft::vec3<float> normal;
  float min_distance, max_distance;
};

/// Facing the camera at the origin, seen from near and far.
inline map_point facing(float x, float y, float z) {
  float const length = std::sqrt(x * x + y * y + z * z);
  return {{x, y, z}, {x / length, y / length, z / length}, 0.1f, 100.0f};
}

inline ft::frustum_params bounds(int levels = 8) {
  ft::frustum_params p;
  p.max_x = width;
  p.max_y = height;
  p.log_scale_factor = ft::log_rounded(1.2f);
  p.levels = levels;
  return p;
}

template <typename Camera>
struct look {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int slot, Camera const& camera,
                                 ft::pose const& T_cw, ft::map_points_view const& map, float bf,
                                 ft::frustum_params const& params, ft::visibility* out) const {
    out[slot] = ft::test_visibility(camera, ft::viewpoint::of(T_cw), map, slot, bf, params);
  }
};

template <typename Backend>
class frustum_unit : public test::on_backend<Backend> {
protected:
  static constexpr ft::memory_space space = Backend::exec_type::space;
  Backend backend;
  ft::pinhole<float> const camera{400, 400, 320, 240};

  ft::map_points<space> upload(std::vector<map_point> const& points, int batch = 1) {
    int const n = static_cast<int>(points.size());
    ft::map_points<ft::memory_space::host> const staging(n, batch);
    for (int b = 0; b < batch; ++b) {
      auto const v = staging.view().slice(b);
      *v.count = n;
      for (int i = 0; i < n; ++i) {
        auto const& p = points[static_cast<std::size_t>(i)];
        v.position(i) = p.position;
        v.normal(i) = p.normal;
        v.min_distance(i) = p.min_distance;
        v.max_distance(i) = p.max_distance;
        v.observations(i) = 1;
        v.orb(i) = ft::descriptor{};
      }
    }
    ft::map_points<space> map(n, batch);
    ft::copy(backend.exec, map.view(), staging.view());
    backend.exec.wait();
    return map;
  }

  template <typename Camera>
  std::vector<ft::visibility> look_at(std::vector<map_point> const& points, Camera const& c,
                                      ft::pose const& T_cw = ft::pose::identity(), float bf = 0,
                                      ft::frustum_params const& params = bounds()) {
    auto const& exec = backend.exec;
    auto const map = upload(points);
    auto const d_out =
        test::to_exec(exec, std::vector<ft::visibility>(points.size(), ft::visibility{}));
    ft::for_each_item<ft::per_thread>(exec, static_cast<int>(points.size()), look<Camera>{}, c,
                                      T_cw, map.view(), bf, params, d_out.data());
    return test::from_exec(exec, static_cast<ft::visibility const*>(d_out.data()), points.size());
  }
  ft::visibility look_at(map_point const& point) {
    return look_at(std::vector<map_point>{point}, camera)[0];
  }
};
TYPED_TEST_SUITE(frustum_unit, test::backends);

TYPED_TEST(frustum_unit, a_point_in_view_is_projected) {
  auto const v =
      this->look_at({facing(0.5f, -0.25f, 2.0f)}, this->camera, ft::pose::identity(), 40.0f)[0];
  EXPECT_GE(v.level, 0);
  EXPECT_FLOAT_EQ(v.x, 420);
  EXPECT_FLOAT_EQ(v.y, 190);
  EXPECT_FLOAT_EQ(v.right_x, 400);
  EXPECT_FLOAT_EQ(v.distance, std::sqrt(0.25f + 0.0625f + 4.0f));
  EXPECT_NEAR(v.cosine, 1, 1e-6);
}

TYPED_TEST(frustum_unit, points_behind_are_rejected) {
  auto behind = facing(0.1f, 0.1f, -2.0f);
  EXPECT_EQ(this->look_at(behind).level, -1);
  behind.position.z = 0;
  EXPECT_EQ(this->look_at(behind).level, -1) << "in the plane of the camera nothing is projected";
  // A fisheye camera could project them; the depth alone rejects.
  ft::kannala_brandt<float> const fisheye{200, 200, 320, 240, 0, 0, 0, 0};
  EXPECT_GE(this->look_at({facing(1.0f, 0.1f, 0.2f)}, fisheye)[0].level, 0);
  EXPECT_EQ(this->look_at({facing(1.0f, 0.1f, -0.2f)}, fisheye)[0].level, -1);
}

TYPED_TEST(frustum_unit, points_outside_the_image_are_rejected_and_those_on_its_rim_are_not) {
  // All numbers are exact in float: a pixel is 1 / 64 at depth 4.
  ft::pinhole<float> const exact{256, 256, 320, 240};
  struct expectation {
    float x, y;
    bool seen;
  };
  for (expectation const e : {expectation{-5, 0, true},
                              {-5.015625f, 0, false},
                              {5, 0, true},
                              {5.015625f, 0, false},
                              {0, -3.75f, true},
                              {0, -3.765625f, false},
                              {0, 3.75f, true},
                              {0, 3.765625f, false},
                              {5, 3.75f, true},
                              {-5.015625f, -3.765625f, false}}) {
    EXPECT_EQ(this->look_at({facing(e.x, e.y, 4)}, exact)[0].level >= 0, e.seen)
        << e.x << ", " << e.y;
  }
  // Bounds other than the image's.
  auto p = bounds();
  p.min_x = 100;
  EXPECT_EQ(this->look_at({facing(-2.3f, 0, 4)}, this->camera, ft::pose::identity(), 0, p)[0].level,
            -1);
}

TYPED_TEST(frustum_unit, points_too_near_or_too_far_are_rejected) {
  auto point = facing(0, 0, 10);
  struct expectation {
    float low, high;
    bool seen;
  };
  // Looked for from 0.8 times the least distance to 1.2 times the largest; the point is 10 away.
  for (expectation const e : {expectation{12.4f, 50, true},
                              {12.6f, 50, false},
                              {1, 8.4f, true},
                              {1, 8.3f, false},
                              {0, 1e9f, true},
                              {nan, 50, false},
                              {1, nan, false}}) {
    point.min_distance = e.low;
    point.max_distance = e.high;
    EXPECT_EQ(this->look_at(point).level >= 0, e.seen) << e.low << " " << e.high;
  }
}

TYPED_TEST(frustum_unit, points_seen_from_the_side_are_rejected) {
  for (float const degrees : {0.0f, 30.0f, 59.9f, 60.1f, 90.0f, 180.0f}) {
    auto point = facing(0, 0, 5);
    float const a = degrees * 3.14159265f / 180;
    point.normal = {std::sin(a), 0, std::cos(a)};
    auto const v = this->look_at(point);
    EXPECT_EQ(v.level >= 0, degrees < 60) << degrees;
    if (v.level >= 0) { EXPECT_NEAR(v.cosine, std::cos(a), 1e-6); }
  }
}

TYPED_TEST(frustum_unit, nan_is_rejected_wherever_it_is) {
  auto const good = facing(0.1f, 0.2f, 5);
  ASSERT_GE(this->look_at(good).level, 0);
  std::vector<map_point> bad(5, good);
  bad[0].position.x = nan;
  bad[1].position.y = nan;
  bad[2].position.z = nan;
  bad[3].normal.y = nan;
  bad[4].max_distance = nan;
  ft::kannala_brandt<float> const fisheye{200, 200, 320, 240, 0, 0, 0, 0};
  for (auto const& v : this->look_at(bad, this->camera)) { EXPECT_EQ(v.level, -1); }
  for (auto const& v : this->look_at(bad, fisheye)) { EXPECT_EQ(v.level, -1); }
  auto T = ft::pose::identity();
  T.t.x = nan;
  EXPECT_EQ(this->look_at({good}, this->camera, T)[0].level, -1);
  T = ft::pose::identity();
  T.R.m[4] = nan;
  EXPECT_EQ(this->look_at({good}, this->camera, T)[0].level, -1);
}

TYPED_TEST(frustum_unit, the_level_follows_the_distance) {
  // At max_distance / 1.2^k the ratio is 1.2^k; a little nearer is the next level up.
  for (int k = 0; k < 12; ++k) {
    for (double const nudge : {1.01, 0.99}) {
      auto point = facing(0, 0, 10);
      double const ratio = std::pow(1.2, k) * nudge;
      point.max_distance = static_cast<float>(10 * ratio);
      int const want =
          std::clamp(static_cast<int>(std::ceil(std::log(ratio) / std::log(1.2))), 0, 7);
      EXPECT_EQ(this->look_at(point).level, want) << k << " " << nudge;
    }
  }
  auto point = facing(0, 0, 10);
  point.max_distance = 9;  // farther than ever seen, inside the tolerance: the lowest level
  EXPECT_EQ(this->look_at(point).level, 0);
  point.max_distance = 1e6f;
  EXPECT_EQ(this->look_at(point).level, 7);
  EXPECT_EQ(this->look_at({point}, this->camera, ft::pose::identity(), 0, bounds(3))[0].level, 2);
}

/// Straight ahead, so that the distance is z.
inline map_point ahead(float z, float min_distance, float max_distance) {
  return {{0, 0, z}, {0, 0, 1}, min_distance, max_distance};
}

/// The reference multiplies floats: with 0.8 and 1.2 in double other points would be seen.
TYPED_TEST(frustum_unit, limits_of_distance_are_products_of_floats) {
  std::mt19937 random(3);
  std::uniform_real_distribution<float> exponent(-3, 6);
  constexpr float none = 0;
  std::vector<map_point> points;
  std::vector<bool> seen;
  int otherwise = 0;
  auto const add = [&](float z, float least, float most, bool is_seen) {
    points.push_back(ahead(z, least, most));
    seen.push_back(is_seen);
    double const d = z;
    bool const in_double = d >= 0.8 * least && d <= 1.2 * most;
    otherwise += static_cast<int>(in_double != is_seen);
  };
  for (int i = 0; i < 500; ++i) {
    float const limit = std::exp2(exponent(random));
    float const low = 0.8f * limit;
    float const high = 1.2f * limit;
    add(high, none, limit, true);
    add(std::nextafter(high, 1e30f), none, limit, false);
    add(low, limit, 1e6f, true);
    add(std::nextafter(low, none), limit, 1e6f, false);
  }
  EXPECT_GT(otherwise, 100);
  auto const got = this->look_at(points, this->camera);
  for (std::size_t i = 0; i < points.size(); ++i) {
    ASSERT_EQ(got[i].level >= 0, seen[i]) << points[i].position.z;
  }
}

/// Quotients, logarithms and the rounding up are the reference's in float. A camera that stands
/// still sees its points where octaves change, and there double gives others.
TYPED_TEST(frustum_unit, levels_on_the_edge_are_those_of_floats) {
  std::mt19937 random(4);
  std::uniform_real_distribution<float> exponent(-3, 6);
  float const log_scale = std::log(1.2f);
  std::vector<map_point> points;
  std::vector<int> levels;
  int otherwise = 0;
  for (int i = 0; i < 4000; ++i) {
    float const z = std::exp2(exponent(random));
    float most = z * std::pow(1.2f, static_cast<float>(1 + i % 6));
    for (int step = i % 17; step < 8; ++step) { most = std::nextafter(most, 0.0f); }
    for (int step = 8; step < i % 17; ++step) { most = std::nextafter(most, 1e30f); }
    points.push_back(ahead(z, 0, most));
    levels.push_back(std::clamp(static_cast<int>(std::ceil(std::log(most / z) / log_scale)), 0, 7));
    double const in_double = std::ceil(std::log(double{most} / z) / double{log_scale});
    otherwise += static_cast<int>(static_cast<int>(in_double) != levels.back());
  }
  EXPECT_GT(otherwise, 10);
  auto const got = this->look_at(points, this->camera);
  for (std::size_t i = 0; i < points.size(); ++i) {
    ASSERT_EQ(got[i].level, levels[i]) << points[i].position.z << " " << points[i].max_distance;
  }
}

TYPED_TEST(frustum_unit, distance_and_angle_are_measured_from_the_centre_of_the_camera) {
  // Half a turn about y at (1, 2, 3): looks along -z of the world.
  ft::pose T_cw{{{-1, 0, 0, 0, 1, 0, 0, 0, -1}}, {1, -2, 3}};
  map_point const point{{1, 2, -1}, {0, 0, -1}, 0.1f, 100};
  auto const v = this->look_at({point}, this->camera, T_cw)[0];
  EXPECT_GE(v.level, 0);
  EXPECT_FLOAT_EQ(v.x, 320);
  EXPECT_FLOAT_EQ(v.y, 240);
  EXPECT_FLOAT_EQ(v.distance, 4);
  EXPECT_FLOAT_EQ(v.cosine, 1);
}

TEST(window_of_unit, radius_levels_and_slot) {
  auto const g = ft::pyramid_geometry::make(width, height, 8, 1.2f);
  ft::visibility v{100, 200, 90, 0.999f, 5, 3};
  auto w = ft::window_of(v, 17, 1, true, g);
  EXPECT_EQ(w.x, 100);
  EXPECT_EQ(w.y, 200);
  EXPECT_EQ(w.right_x, 90);
  EXPECT_EQ(w.radius, 2.5f * g.scale[3]);
  EXPECT_EQ(w.min_level, 2);
  EXPECT_EQ(w.max_level, 3);
  EXPECT_EQ(w.slot, 17);
  EXPECT_TRUE(w.check_right);
  v.cosine = std::nextafter(0.998f, 0.0f);  // not above the limit
  w = ft::window_of(v, 0, 3, false, g);
  EXPECT_EQ(w.radius, 4.0f * 3.0f * g.scale[3]);
  EXPECT_FALSE(w.check_right);
  v.level = 0;
  w = ft::window_of(v, 0, 1, false, g);
  EXPECT_EQ(w.radius, 4.0f);
  EXPECT_EQ(w.min_level, -1);
  EXPECT_EQ(w.max_level, 0);
  EXPECT_EQ(ft::search_window::none().slot, -1);
}

/// The stage on a local map, two batch entries of different poses.
template <typename Rig, ft::memory_space Space, typename Exec>
struct local_map_run {
  int capacity = 0;
  int cameras = 0;
  std::vector<ft::search_window> windows;
  std::vector<ft::visibility> seen;
  std::vector<int> count;

  local_map_run(Exec const& exec, Rig const& rig, std::vector<ft::pose> const& poses,
                ft::map_points_view const& map, std::vector<int> const& slots,
                std::vector<int> const& slot_count, std::vector<int> const& stamps,
                std::vector<int> const& stamp, ft::local_search_params const& search) {
    int const batch = static_cast<int>(poses.size());
    capacity = static_cast<int>(slots.size()) / batch;
    cameras = Rig::rectified ? 1 : 2;
    auto const g = ft::pyramid_geometry::make(width, height, 8, 1.2f);
    ft::search_windows_view out;
    ft::arena<Space> const memory(
        [&](ft::carver& c) { ft::carve(c, out, capacity, batch, cameras); });
    auto const n = static_cast<std::size_t>(cameras) * slots.size();
    ft::search_window untouched = ft::search_window::none();
    untouched.slot = -77;
    std::vector<ft::search_window> const blank(n, untouched);
    ft::copy(exec, out.windows, blank.data(), n);
    auto const d_poses = test::to_exec(exec, poses);
    auto const d_slots = test::to_exec(exec, slots);
    auto const d_count = test::to_exec(exec, slot_count);
    auto const d_stamps = test::to_exec(exec, stamps);
    auto const d_stamp = test::to_exec(exec, stamp);
    auto const d_seen =
        test::to_exec(exec, std::vector<ft::visibility>(n, ft::visibility{0, 0, 0, 0, 0, -77}));
    using rig_type = std::decay_t<decltype(rig)>;
    ft::find_visible_points(
        exec,
        ft::local_search<rig_type>{rig,
                                   d_poses.data(),
                                   d_slots.data(),
                                   d_count.data(),
                                   {d_stamp.data(), stamps.empty() ? nullptr : d_stamps.data()},
                                   bounds(),
                                   g,
                                   search,
                                   d_seen.data()},
        map, out);
    windows = test::from_exec(exec, static_cast<ft::search_window const*>(out.windows), n);
    seen = test::from_exec(exec, static_cast<ft::visibility const*>(d_seen.data()), n);
    count =
        test::from_exec(exec, static_cast<int const*>(out.count), static_cast<std::size_t>(batch));
  }
  ft::search_window const& window(int camera, int b, int i) const {
    return windows[static_cast<std::size_t>(
        (camera * static_cast<int>(count.size()) + b) * capacity + i)];
  }
  ft::visibility const& visible(int camera, int b, int i) const {
    return seen[static_cast<std::size_t>((camera * static_cast<int>(count.size()) + b) * capacity +
                                         i)];
  }
};

/// 0.998 as a double lies between these two floats.
TEST(window_of_a_visible_point, is_small_from_a_cosine_of_0_998_as_a_double) {
  auto const g = ft::pyramid_geometry::make(width, height, 8, 1.2f);
  ft::visibility v{100, 100, 90, 0.998f, 5, 0};
  EXPECT_EQ(ft::window_of(v, 0, 1, true, g).radius, 2.5f);
  v.cosine = std::nextafter(0.998f, 0.0f);
  EXPECT_EQ(ft::window_of(v, 0, 1, true, g).radius, 4.0f);
}

TYPED_TEST(frustum_unit, windows_of_a_local_map) {
  auto const& exec = this->backend.exec;
  std::vector<map_point> points;
  for (int i = 0; i < 10; ++i) { points.push_back(facing(0.1f * static_cast<float>(i), 0, 5)); }
  points[3].position.z = -5;  // never in view
  points[6] = facing(0, 0, 30);
  auto const map = this->upload(points, 2);
  auto turned = ft::pose::identity();  // half a turn: all but point 3 are behind
  turned.R = {{-1, 0, 0, 0, 1, 0, 0, 0, -1}};
  ft::local_search_params search;
  search.radius_factor = 3;
  search.max_distance = 20;
  // Entries past the count hold valid slots, which must not be looked at.
  std::vector<int> const slots{9, 3, -1, 5, 6, 100, 4, 2, 2, /**/ 0, 3, 1, 1, 1, 1, 1, 1, 1};
  std::vector<int> stamps(20, 0);
  stamps[5] = 41;       // matched in this frame already: skipped
  stamps[9] = 40;       // in an earlier one: not
  stamps[10 + 9] = 41;  // another batch entry's
  auto const rig = ft::rectified_rig::make(this->camera, 0.1f);
  local_map_run<ft::rectified_rig, TestFixture::space, typename TypeParam::exec_type> const run(
      exec, rig, {ft::pose::identity(), turned}, map.view(), slots, {7, 2}, stamps, {41, 41},
      search);
  EXPECT_EQ(run.count, (std::vector<int>{7, 2}));
  std::vector<int> found;
  for (int b = 0; b < 2; ++b) {
    for (int i = 0; i < 9; ++i) { found.push_back(run.window(0, b, i).slot); }
  }
  // Point 6 is in view but farther than the limit; 100 is no slot.
  EXPECT_EQ(found, (std::vector<int>{9, -1, -1, -1, -1, -1, 4, -77, -77, /**/ -1, -1, -77, -77, -77,
                                     -77, -77, -77, -77}));
  EXPECT_GE(run.visible(0, 0, 4).level, 0);
  EXPECT_EQ(run.visible(0, 0, 1).level, -1);
  EXPECT_EQ(run.visible(0, 0, 3).level, -1);
  EXPECT_EQ(run.visible(0, 1, 1).level, -1) << "in front, but its normal points away";
  auto const& w = run.window(0, 0, 0);
  EXPECT_NEAR(w.x, 320 + 400 * 0.9 / 5, 1e-3);
  EXPECT_NEAR(w.x - w.right_x, 40.0 / 5, 1e-3);
  EXPECT_TRUE(w.check_right);
  EXPECT_EQ(w.radius, 7.5f * ft::pyramid_geometry::make(width, height, 8, 1.2f).scale[w.max_level]);
}

TYPED_TEST(frustum_unit, the_right_fisheye_camera_has_its_own_view) {
  auto const& exec = this->backend.exec;
  ft::kannala_brandt<float> const left{200, 200, 320, 240, 0.01f, 0, 0, 0};
  ft::kannala_brandt<float> const right{210, 210, 300, 250, 0, 0.01f, 0, 0};
  // The right camera stands 0.5 m to the right and looks 20 degrees further right.
  float const c = std::cos(0.35f);
  float const s = std::sin(0.35f);
  ft::pose const T_rl{{{c, 0, -s, 0, 1, 0, s, 0, c}}, {-0.5f * c, 0, -0.5f * s}};
  fisheye_rig const rig{left, right, T_rl};
  std::vector<map_point> points;
  std::mt19937 random(2);
  std::uniform_real_distribution<float> unit(-1, 1);
  for (int i = 0; i < 200; ++i) {
    points.push_back(facing(8 * unit(random), 4 * unit(random), 2 + 3 * unit(random)));
  }
  auto const map = this->upload(points);
  std::vector<int> slots;
  for (int i = 0; i < 200; ++i) { slots.push_back(i); }
  ft::local_search_params search;
  search.radius_factor = 3;
  local_map_run<fisheye_rig, TestFixture::space, typename TypeParam::exec_type> const run(
      exec, rig, {ft::pose::identity()}, map.view(), slots, {200}, {}, {0}, search);
  auto const by_left = this->look_at(points, left);
  auto const by_right = this->look_at(points, right, T_rl);
  auto const g = ft::pyramid_geometry::make(width, height, 8, 1.2f);
  int different = 0;
  for (int i = 0; i < 200; ++i) {
    auto const at = static_cast<std::size_t>(i);
    EXPECT_EQ(run.visible(0, 0, i).level, by_left[at].level);
    EXPECT_EQ(run.visible(1, 0, i).level, by_right[at].level);
    EXPECT_EQ(run.visible(0, 0, i).x, by_left[at].x);
    EXPECT_EQ(run.visible(1, 0, i).x, by_right[at].x);
    EXPECT_EQ(run.visible(1, 0, i).distance, by_right[at].distance);
    different += static_cast<int>((by_left[at].level >= 0) != (by_right[at].level >= 0));
    auto const& w = run.window(1, 0, i);
    EXPECT_EQ(w.slot, by_right[at].level >= 0 ? i : -1);
    if (w.slot >= 0) {  // the factor is the left camera's
      EXPECT_EQ(w.radius,
                (by_right[at].cosine >= 0.998f ? 2.5f : 4.0f) * g.scale[by_right[at].level]);
      EXPECT_FALSE(w.check_right);
    }
    auto const& l = run.window(0, 0, i);
    if (l.slot >= 0) {
      EXPECT_FLOAT_EQ(l.radius,
                      (by_left[at].cosine >= 0.998f ? 7.5f : 12.0f) * g.scale[by_left[at].level]);
    }
  }
  EXPECT_GT(different, 10) << "the cameras must not see the same";
}

}  // namespace frustum_test
