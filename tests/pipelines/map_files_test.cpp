// SPDX-License-Identifier: Apache-2.0
// A map as PLY and as a TUM trajectory, read back by readers of these formats.
#include "ft/pipelines/map_files.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <locale>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "tests/support/ply_file.hpp"

namespace map_files_test {

using test::ply_file;

ft::odometry_map random_points(int count) {
  std::mt19937 random(7);
  std::uniform_real_distribution<float> real(-50, 50);
  ft::odometry_map map;
  for (int i = 0; i < count; ++i) {
    ft::downloaded_point p{};
    p.position = {real(random), real(random), 1e-7f * real(random)};
    p.normal = {0.36f, -0.48f, 0.8f};
    p.slot = 3 * i;
    map.points.push_back(p);
  }
  map.points[0].position.x = std::numeric_limits<float>::denorm_min();
  return map;
}

TEST(MapFiles, PointsAreReadBack) {
  auto const map = random_points(100);
  std::vector<std::uint8_t> colours;
  for (int i = 0; i < 300; ++i) { colours.push_back(static_cast<std::uint8_t>(i * 7)); }
  for (int variant = 0; variant < 8; ++variant) {
    SCOPED_TRACE(variant);
    ft::ply_options options;
    options.binary = variant % 2 == 0;
    options.normals = variant / 2 % 2 == 0;
    options.colours = variant / 4 == 0 ? colours.data() : nullptr;
    std::ostringstream out;
    ft::write_ply(out, map, options);
    ply_file const file(out.str());
    EXPECT_EQ(file.format, options.binary ? "binary_little_endian" : "ascii");
    std::vector<std::string> names{"x", "y", "z"};
    if (options.normals) { names.insert(names.end(), {"nx", "ny", "nz"}); }
    if (options.colours != nullptr) { names.insert(names.end(), {"red", "green", "blue"}); }
    EXPECT_EQ(file.names, names);
    EXPECT_TRUE(file.at_end);
    ASSERT_EQ(file.vertices.size(), map.points.size());
    for (std::size_t i = 0; i < map.points.size(); ++i) {
      auto const& p = map.points[i];
      std::vector<float> real{p.position.x, p.position.y, p.position.z};
      if (options.normals) { real.insert(real.end(), {p.normal.x, p.normal.y, p.normal.z}); }
      EXPECT_EQ(file.vertices[i].real, real);
      for (std::size_t c = 0; options.colours != nullptr && c < 3; ++c) {
        EXPECT_EQ(file.vertices[i].byte[c], colours[3 * i + c]);
      }
    }
  }
}

TEST(MapFiles, EmptyMapsAreFiles) {
  std::ostringstream points, poses;
  ft::write_ply(points, {});
  ply_file const file(points.str());
  EXPECT_TRUE(file.vertices.empty());
  EXPECT_TRUE(file.at_end);
  ft::write_tum(poses, {});
  EXPECT_EQ(poses.str().find('\n'), poses.str().size() - 1) << "a comment";
  EXPECT_EQ(poses.str()[0], '#');
}

/// A keyframe turned by `angle` about an axis of unit length. Source: Rodrigues' formula.
ft::downloaded_keyframe keyframe(std::int64_t time_ns, ft::vec3<double> axis, double angle) {
  double const c = std::cos(angle), s = std::sin(angle);
  auto const [x, y, z] = axis;
  double const d = 1 - c;
  ft::mat3<double> const R{{c + x * x * d, x * y * d - z * s, x * z * d + y * s, x * y * d + z * s,
                            c + y * y * d, y * z * d - x * s, x * z * d - y * s, y * z * d + x * s,
                            c + z * z * d}};
  return {1, time_ns, {R, {1.5, -2.25, 1e-9 * angle}}};
}

TEST(MapFiles, KeyframesAreReadBack) {
  double const pi = std::acos(-1.0);
  struct turn {
    std::int64_t time_ns;
    char const* stamp;
    ft::vec3<double> axis;
    double angle;
  };
  // Near half turns each component is the largest one.
  std::vector<turn> const turns{{0, "0.000000000", {0, 0, 1}, 0},
                                {5, "0.000000005", {0.6, 0, 0.8}, 1.2},
                                {1403636579763555584, "1403636579.763555584", {1, 0, 0}, pi},
                                {2'000'000'000, "2.000000000", {0, 1, 0}, pi - 0.01},
                                {2'000'000'001, "2.000000001", {0, 0, 1}, -pi + 0.01},
                                {-1'500'000'000, "-1.500000000", {0, -0.6, 0.8}, 3.1}};
  ft::odometry_map map;
  for (auto const& t : turns) { map.keyframes.push_back(keyframe(t.time_ns, t.axis, t.angle)); }
  std::ostringstream out;
  ft::write_tum(out, map);
  std::istringstream in(out.str());
  std::string line;
  std::getline(in, line);
  EXPECT_EQ(line[0], '#');
  for (auto const& t : turns) {
    SCOPED_TRACE(t.stamp);
    std::string stamp;
    double x = 0, y = 0, z = 0, q[4] = {};
    in >> stamp >> x >> y >> z >> q[0] >> q[1] >> q[2] >> q[3];
    ASSERT_TRUE(static_cast<bool>(in));
    EXPECT_EQ(stamp, t.stamp);
    EXPECT_EQ(x, 1.5);
    EXPECT_EQ(y, -2.25);
    EXPECT_NEAR(z, 1e-9 * t.angle, 6e-10);
    // The half angle; w >= 0 chooses one of the two quaternions of a rotation.
    double const sign = std::cos(t.angle / 2) < 0 ? -1 : 1;
    double const s = sign * std::sin(t.angle / 2);
    EXPECT_NEAR(q[0], s * t.axis.x, 1e-9);
    EXPECT_NEAR(q[1], s * t.axis.y, 1e-9);
    EXPECT_NEAR(q[2], s * t.axis.z, 1e-9);
    EXPECT_NEAR(q[3], sign * std::cos(t.angle / 2), 1e-9);
  }
  EXPECT_FALSE(in >> line) << "nothing follows";
}

/// Numbers as in "1.234,5".
struct grouped : std::numpunct<char> {
  char do_decimal_point() const override { return ','; }
  char do_thousands_sep() const override { return '.'; }
  std::string do_grouping() const override { return "\3"; }
};

TEST(MapFiles, LocalesChangeNothing) {
  auto map = random_points(2000);
  map.keyframes.push_back(keyframe(1'234'567'000'000'001, {1, 0, 0}, 1));
  ft::ply_options text;
  text.binary = false;
  std::ostringstream points, poses;
  ft::write_ply(points, map, text);
  ft::write_tum(poses, map);
  std::locale const before = std::locale::global({std::locale::classic(), new grouped});
  std::ostringstream other_points, other_poses;
  ft::write_ply(other_points, map, text);
  ft::write_tum(other_poses, map);
  std::locale::global(before);
  EXPECT_EQ(other_points.str(), points.str());
  EXPECT_EQ(other_poses.str(), poses.str());
}

TEST(MapFiles, FailingStreamsAreErrors) {
  std::ostringstream out;
  out.setstate(std::ios::badbit);
  EXPECT_THROW(ft::write_ply(out, random_points(3)), ft::error);
  EXPECT_THROW(ft::write_tum(out, {}), ft::error);
}

}  // namespace map_files_test
