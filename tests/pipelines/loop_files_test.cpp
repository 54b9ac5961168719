// SPDX-License-Identifier: Apache-2.0
// What loops know, as a file: it comes back as it was, and numbers that later stages cannot follow
// are refused though the file is whole.
#include "ft/pipelines/detail/loop_files.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <functional>
#include <sstream>
#include <string>
#include <vector>

#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "tests/support/random.hpp"

namespace loop_files_test {

using ft::detail::loop_path;
using saved = ft::detail::saved_loops<ft::memory_space::host>;
constexpr int rows = 8, points = 16, cameras = 2;

/// Five keyframes of two maps, the second joined with the first, and two loops.
struct known {
  ft::host_exec exec;
  ft::owner<ft::loop_archive_view, ft::memory_space::host> archive{
      [](ft::carver& c, ft::loop_archive_view& v) { carve(c, v, rows, points); }};
  loop_path path;

  known() {
    test::generator random(3);
    ft::loop_archive_view const& a = archive.view();
    path.reserve(rows, 2);
    path.gravity = {0.1, 9.8, -0.2};
    for (int i = 0; i < 5; ++i) {
      ft::detail::path_keyframe k;
      k.row = 6 - i;
      k.map = i < 3 ? 4 : 5;
      k.part = 4;
      k.time_ns = 100 * i;
      k.step = 0.5 * i;
      k.T_odom_camera.t = {0.1 * i, 0, 1};
      k.T_world_camera.t = {0.2 * i, 0, 1};
      put_information(k.information);
      path.keyframes.push_back(k);
      a.count[k.row] = i == 1 ? 0 : points - i;
      for (int p = 0; p < a.count[k.row]; ++p) {
        auto const at = a.at(k.row) + p;
        a.orb[at] = random.descriptor();
        a.point[at] = {random.real(-1, 1), random.real(-1, 1), random.real(1, 5)};
        a.x[at] = random.real(0, 100);
        a.y[at] = random.real(0, 100);
        a.right_x[at] = -1;
        a.inv_sigma2[at] = 1;
        a.camera[at] = p < 6 ? 0 : 1;
      }
    }
    for (int const from : {0, 1}) {
      ft::detail::path_loop l;
      l.from = from;
      l.to = 4;
      l.inliers = 5 + from;
      put_information(l.information);
      path.loops.push_back(l);
    }
  }
  static void put_information(double (&to)[21]) {
    for (int i = 0, at = 0; i < 6; at += 6 - i, ++i) { to[at] = 10 + i; }
  }
  std::string text() const {
    std::ostringstream file;
    ft::detail::loop_writer(exec, archive.view(), path)(file);
    return file.str();
  }
  saved read(std::string const& text, int most = rows) const {
    std::istringstream file(text);
    return ft::detail::read_loops<ft::host_exec>(archive.view(), {most, 16, cameras, path.scaled},
                                                 file);
  }
};

TEST(LoopFiles, ComeBackAsTheyWere) {
  known const k;
  saved const got = k.read(k.text());
  ASSERT_EQ(got.keyframes.size(), 5u);
  ASSERT_EQ(got.loops.size(), 2u);
  EXPECT_EQ(got.gravity.y, 9.8);
  for (int i = 0; i < 5; ++i) {
    auto const& was = k.path.at(i);
    auto const& is = got.keyframes[static_cast<std::size_t>(i)];
    EXPECT_EQ(is.row, i);
    EXPECT_EQ(is.map, was.map - 4) << "the last map is map 1";
    EXPECT_EQ(is.part, 1);
    EXPECT_EQ(is.time_ns, was.time_ns);
    EXPECT_EQ(is.step, was.step);
    EXPECT_EQ(std::memcmp(&is.T_odom_camera, &was.T_odom_camera, sizeof was.T_odom_camera), 0);
    EXPECT_EQ(std::memcmp(&is.T_world_camera, &was.T_world_camera, sizeof was.T_world_camera), 0);
    EXPECT_EQ(std::memcmp(is.information, was.information, sizeof was.information), 0);
    ft::loop_archive_view const &a = k.archive.view(), &b = got.archive.view();
    int const n = a.count[was.row];
    ASSERT_EQ(b.count[i], n);
    for (int p = 0; p < n; ++p) {
      EXPECT_EQ(std::memcmp(a.orb + a.at(was.row) + p, b.orb + b.at(i) + p, 32), 0);
      EXPECT_EQ(a.point[a.at(was.row) + p].z, b.point[b.at(i) + p].z);
      EXPECT_EQ(a.x[a.at(was.row) + p], b.x[b.at(i) + p]);
      EXPECT_EQ(a.camera[a.at(was.row) + p], b.camera[b.at(i) + p]);
    }
  }
  EXPECT_EQ(got.loops[1].from, 1);
  EXPECT_EQ(got.loops[1].to, 4);
  EXPECT_EQ(got.loops[1].inliers, 6);
}

TEST(LoopFiles, TheScalesOfOneCameraComeBack) {
  known k;
  k.path.scaled = true;
  k.path.keyframes[3].T_world_camera.scale = 1.25;
  k.path.loops[1].T_from_to.scale = 0.75;
  k.path.loops[1].scale_information = 7;
  saved const got = k.read(k.text());
  EXPECT_EQ(got.keyframes[3].T_world_camera.scale, 1.25);
  EXPECT_EQ(got.loops[1].T_from_to.scale, 0.75);
  EXPECT_EQ(got.loops[1].scale_information, 7);
}

TEST(LoopFiles, NumbersThatNobodyCanFollowAreRefused) {
  using change = std::function<void(known&)>;
  auto const of_point = [](known& k, int p) { return k.archive->at(6) + p; };
  std::vector<change> const changes = {
      [](known& k) { k.path.loops[0].from = 4; },
      [](known& k) { k.path.loops[0].from = -1; },
      [](known& k) { k.path.loops[1].to = 5; },
      [](known& k) { k.path.loops[1].to = 0; },
      [](known& k) { k.path.loops[1].inliers = -1; },
      [](known& k) { k.path.loops[1].inliers = 1 << 20; },
      [](known& k) { k.path.loops[0].information[1] = 1e30; },
      [](known& k) { k.path.loops[0].information[0] = std::nan(""); },
      [](known& k) { k.path.keyframes[2].information[6] = -1; },
      [](known& k) { k.path.keyframes[2].steps = 0; },
      [](known& k) { k.path.keyframes[0].steps = k.path.keyframes[1].steps = 1 << 30; },
      [](known& k) { k.path.keyframes[0].map = 1 << 30; },
      [](known& k) { k.path.keyframes[2].map = 3; },
      [](known& k) { k.path.keyframes[2].part = 5; },
      [](known& k) { k.path.keyframes[2].part = -(1 << 30); },
      [](known& k) { k.path.keyframes[1].step = -1; },
      [](known& k) { k.path.keyframes[1].T_odom_camera.t.x = 1e300; },
      [](known& k) { k.path.keyframes[1].T_world_camera.R.m[0] = -1; },
      [](known& k) { k.path.keyframes[1].T_world_camera.scale = 1.5; },
      [](known& k) {
        k.path.scaled = true;
        k.path.keyframes[1].T_world_camera.scale = 0;
      },
      [](known& k) { k.path.loops[1].T_from_to.scale = 0.5; },
      [](known& k) { k.path.loops[1].scale_information = -1; },
      [](known& k) {
        k.path.gravity = {1e-10, 0, 0};
      },
      [](known& k) { k.path.gravity.x = std::nan(""); },
      [&](known& k) { k.archive->x[of_point(k, 3)] = 1e9f; },
      [&](known& k) { k.archive->y[of_point(k, 3)] = std::nanf(""); },
      [&](known& k) { k.archive->point[of_point(k, 0)].z = 1e20f; },
      [&](known& k) { k.archive->inv_sigma2[of_point(k, 0)] = 0; },
      [&](known& k) { k.archive->right_x[of_point(k, 0)] = std::nanf(""); },
      [&](known& k) { k.archive->camera[of_point(k, 9)] = cameras; },
      [&](known& k) { k.archive->camera[of_point(k, 9)] = 0; },
      [&](known& k) { k.archive->camera[of_point(k, 0)] = -1; },
  };
  EXPECT_NO_THROW(known().read(known().text()));
  for (std::size_t i = 0; i < changes.size(); ++i) {
    known k;
    changes[i](k);
    EXPECT_THROW(k.read(k.text()), ft::error) << "change " << i;
  }
}

TEST(LoopFiles, OtherSizesAreRefused) {
  known const k;
  std::string const whole = k.text();
  EXPECT_NO_THROW(k.read(whole, 5));
  EXPECT_THROW(k.read(whole, 4), ft::error) << "more keyframes than there is room for";
  EXPECT_THROW(k.read(whole + "x"), ft::error) << "a byte more";
  for (std::size_t n = 0; n < whole.size(); n += 1 + n / 8) {
    EXPECT_THROW(k.read(whole.substr(0, n)), ft::error) << n;
  }
  std::string huge = whole;
  huge[30] = 1;  // 2^48 bytes follow
  EXPECT_THROW(k.read(huge), ft::error);
}

}  // namespace loop_files_test
