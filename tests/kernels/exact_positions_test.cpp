// SPDX-License-Identifier: Apache-2.0
// Where keypoints of higher levels are in the input image: blobs whose places are known, and poses
// from points that are seen at levels.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/kernels/pose/optimize_frame.hpp"
#include "ft/kernels/pyramid/build_pyramid.hpp"
#include "ft/kernels/pyramid/tile_layout.hpp"
#include "tests/support/backends.hpp"

namespace exact_positions_test {

using ft::memory_space;

/// The middle of the grey of a level.
std::pair<double, double> centroid(ft::image_view<std::uint8_t> level) {
  double sum = 0;
  double x = 0;
  double y = 0;
  for (int v = 0; v < level.height; ++v) {
    for (int u = 0; u < level.width; ++u) {
      double const grey = level.row(v)[u];
      sum += grey;
      x += grey * u;
      y += grey * v;
    }
  }
  return {x / sum, y / sum};
}

TEST(exact_positions, are_those_of_a_blob_at_every_level) {
  ft::host_exec const exec(1);
  std::vector<std::pair<int, int>> const sizes = {{752, 480}, {512, 512}, {333, 257}};
  for (auto const& [width, height] : sizes) {
    auto g = ft::pyramid_geometry::make(width, height, 8, 1.2f);
    g.exact = true;
    ft::image_pyramid<memory_space::host> const pyramid(g);
    std::vector<ft::resize_tap> taps(static_cast<std::size_t>(g.taps));
    ft::make_resize_taps(g, taps.data());
    double const x = width - 60.3;
    double const y = height - 71.8;
    auto const image = pyramid.view().level(0, 0);
    for (int v = 0; v < height; ++v) {
      for (int u = 0; u < width; ++u) {
        double const r2 = (u - x) * (u - x) + (v - y) * (v - y);
        image.row(v)[u] = static_cast<std::uint8_t>(std::lrint(250 * std::exp(-r2 / 200)));
      }
    }
    ft::build_pyramid(exec, pyramid.view(), taps.data());
    for (int l = 0; l < g.levels; ++l) {
      SCOPED_TRACE(std::to_string(width) + " pixels, level " + std::to_string(l));
      auto const [u, v] = centroid(pyramid.view().level(0, l));
      float const scaled_u = static_cast<float>(u) * g.scale[l];
      float const scaled_v = static_cast<float>(v) * g.scale[l];
      EXPECT_NEAR(g.column(scaled_u, l), x, 0.05);
      EXPECT_NEAR(g.row(scaled_v, l), y, 0.05);
      if (l == 7) { EXPECT_GT(std::hypot(scaled_u - x, scaled_v - y), 0.8) << "without"; }
    }
  }
}

TEST(exact_positions, depths_belong_to_their_columns) {
  auto g = ft::pyramid_geometry::make(751, 333, 8, 1.2f);
  g.exact = true;
  constexpr float bf = 43.5f;
  for (int l = 0; l < g.levels; ++l) {
    float const disparity = g.column(700, l) - g.column(690, l);
    EXPECT_NEAR(g.depth(bf / 10, l), bf / disparity, 2e-4) << l;
  }
}

template <typename Backend>
class exact_positions_of : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(exact_positions_of, test::backends);

/// Points seen at the levels of a pyramid, without noise: the pose is exact with exact positions
/// alone.
TYPED_TEST(exact_positions_of, give_the_pose_of_a_frame) {
  using exec_type = typename TypeParam::exec_type;
  constexpr memory_space space = exec_type::space;
  TypeParam backend;
  constexpr int n = 240;
  auto const rig = ft::rectified_rig::make({400.0f, 400.0f, 370.0f, 240.0f}, 0.2f);
  auto g = ft::pyramid_geometry::make(752, 480, 8, 1.2f);
  ft::keypoints<memory_space::host> const seen(n, 2);
  ft::map_points<memory_space::host> const map(n, 1);
  std::vector<float> right(n);
  std::vector<int> holder(n);
  std::mt19937 random(5);
  std::uniform_real_distribution<double> any(0, 1);
  auto const k = seen.view().slice(0);
  *k.count = n;
  *seen.view().slice(1).count = 0;
  *map.view().count = n;
  for (int i = 0; i < n; ++i) {
    int const l = i % 8;
    // The pixel (u, v) of a level is the mean of pixels around this one.
    double const wide = static_cast<double>(g.width[0]) / g.width[l];
    double const high = static_cast<double>(g.height[0]) / g.height[l];
    double const u = 20 + any(random) * (g.width[l] - 40);
    double const v = 20 + any(random) * (g.height[l] - 40);
    double const x = (u + 0.5) * wide - 0.5;
    double const y = (v + 0.5) * high - 0.5;
    double const z = 2 + 8 * any(random);
    double const disparity = static_cast<double>(rig.bf()) / z;
    map.view().position(i) = {static_cast<float>(z * (x - 370) / 400),
                              static_cast<float>(z * (y - 240) / 400), static_cast<float>(z)};
    auto const scale = static_cast<double>(g.scale[l]);
    k.x(i) = static_cast<float>(u * scale);
    k.y(i) = static_cast<float>(v * scale);
    k.octave(i) = l;
    right[static_cast<std::size_t>(i)] = static_cast<float>((u - disparity / wide) * scale);
    holder[static_cast<std::size_t>(i)] = i;
  }
  auto const& exec = backend.exec;
  ft::keypoints<space> const d_seen(n, 2);
  ft::map_points<space> const d_map(n, 1);
  ft::copy(exec, d_seen.view(), seen.view());
  ft::copy(exec, d_map.view(), map.view());
  auto const d_right = test::to_exec(exec, right);
  ft::pose start = ft::pose::identity();
  start.t = {0.02f, -0.01f, 0.03f};
  auto const d_start = test::to_exec(exec, std::vector<ft::pose>{start});
  auto const d_result = test::to_exec(exec, std::vector<ft::pose>(1));
  ft::observations_view observations;
  ft::arena<space> const memory([&](ft::carver& c) { ft::carve(c, observations, n, 1); });
  std::vector<float> moves(n);  // a third has no patch, another is where it is to the bit
  for (std::size_t i = 0; i < moves.size(); ++i) { moves[i] = static_cast<float>(i % 3) - 1; }
  auto const d_moves = test::to_exec(exec, moves);
  auto const error = [&](bool exact, bool aligned = false) {
    g.exact = exact;
    auto const d_holder = test::to_exec(exec, holder);
    ft::frame_view frame;
    frame.keypoints = d_seen.view();
    frame.cameras = 1;
    frame.batch = 1;
    frame.right_x = d_right.data();
    frame.holder = d_holder.data();
    ft::frames_in_map in{frame, d_map.view(), g};
    if (aligned) { in.moves = d_moves.data(); }
    ft::optimize_frame_poses(exec, rig, in, {d_start.data(), d_result.data(), observations});
    auto const T = test::from_exec(exec, static_cast<ft::pose const*>(d_result.data()), 1)[0];
    // Length of the translation and of the rotation's axis times sine.
    float const off[6] = {T.t.x, T.t.y, T.t.z, T.R.m[1], T.R.m[2], T.R.m[5]};
    double sum = 0;
    for (float const d : off) { sum += static_cast<double>(d) * static_cast<double>(d); }
    return std::sqrt(sum);
  };
  EXPECT_LT(error(true), 1e-5);
  EXPECT_GT(error(false), 2e-4);
  // Keypoints at the places of their points' patches have their weight, moved or not.
  EXPECT_LT(error(true, true), 1e-5);
  auto const seen_as =
      test::from_exec(exec, static_cast<ft::observation const*>(observations.items), n);
  for (std::size_t i = 0; i < seen_as.size(); ++i) {
    float const corner = g.inv_sigma2[i % 8];
    EXPECT_EQ(seen_as[i].inv_sigma2, moves[i] < 0 ? corner : ft::weight_of_aligned * corner) << i;
  }
  // One in eight with a patch is 0.8 pixels off: it is no outlier, and counts less.
  for (int i = 4; i < n; i += 12) {
    float const off = 0.8f * g.scale[i % 8];
    k.x(i) += off;
    right[static_cast<std::size_t>(i)] += off;
  }
  ft::copy(exec, d_seen.view(), seen.view());
  ft::copy(exec, d_right.data(), right.data(), right.size());
  double const as_corners = error(true);
  EXPECT_GT(as_corners, 1e-4);
  EXPECT_LT(error(true, true), as_corners / 2);
  auto const outlier =
      test::from_exec(exec, static_cast<unsigned char const*>(observations.outlier), n);
  EXPECT_EQ(std::count(outlier.begin(), outlier.end(), 1), 0);
}

}  // namespace exact_positions_test
