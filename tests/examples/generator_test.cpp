// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/generator.hpp"

#include "examples/sequence/asl_writer.hpp"
#include "examples/sequence/image_io.hpp"
#include "examples/sequence/parallel.hpp"
#include "examples/sequence/reader.hpp"
#include "tests/support/effort.hpp"

#include <gtest/gtest.h>

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <limits>
#include <sstream>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

namespace {

namespace fs = std::filesystem;
using seq::generator;
using seq::generator_options;
using seq::rig_kind;

generator_options small(rig_kind rig = rig_kind::pinhole) {
  generator_options o;
  o.rig = rig;
  o.width = 160;
  return o;
}

// Nothing that changes a surface's grey value from one picture to the next.
generator_options plain(rig_kind rig) {
  generator_options o;
  o.rig = rig;
  o.width = rig == rig_kind::pinhole ? 376 : 320;
  o.noise_sigma = 0;
  o.exposure_change = false;
  o.vignetting = false;
  return o;
}

TEST(generator, further_cameras_see_the_same_scene) {
  auto o = plain(rig_kind::fisheye);
  o.frames = 3;
  generator const pair(o);
  seq::camera_intrinsics pinhole;
  pinhole.width = 96;
  pinhole.height = 64;
  pinhole.fx = pinhole.fy = 60;
  pinhole.cx = 47;
  pinhole.cy = 33;
  o.further = {{pair.rig().right, pair.rig().T_left_right, -1, false},
               {pinhole, Eigen::Isometry3d::Identity(), -1, true}};
  generator const all(o);
  EXPECT_EQ(all.render_further(2, 0).grey.pixels, all.render(2).right.pixels);
  EXPECT_EQ(all.render(2).left.pixels, pair.render(2).left.pixels);
  EXPECT_TRUE(all.render_further(2, 0).depth.pixels.empty());
  auto const seen = all.render_further(2, 1);
  ASSERT_EQ(seen.depth.pixels.size(), 96u * 64u);
  for (int v = 0; v < 64; v += 7) {
    for (int u = 0; u < 96; u += 7) {
      double const z = seen.depth.pixels[static_cast<std::size_t>(96 * v + u)] / 1000.0;
      Eigen::Vector3d const point(z * (u - 47) / 60.0, z * (v - 33) / 60.0, z);
      auto const pixel = all.project(0, point);
      ASSERT_TRUE(pixel);
      EXPECT_NEAR(all.depth(2, pixel->x(), pixel->y()), z, 2e-3) << u << " " << v;
    }
  }
  EXPECT_THROW(all.render_further(0, 2), seq::error);
  o.further[0].right_of = 0;
  EXPECT_THROW(generator{o}, seq::error);
}

TEST(generator, a_mixed_rig_has_two_fisheye_pairs_a_pinhole_and_a_depth_camera) {
  generator_options o;
  o.frames = 2;
  seq::use_mixed_rig(o);
  generator const g(o);
  ASSERT_EQ(g.options().further.size(), 4u);
  EXPECT_EQ(g.options().further[1].right_of, 0);
  EXPECT_EQ(g.options().further[0].camera.model, seq::lens::kannala_brandt);
  EXPECT_EQ(g.options().further[2].camera.model, seq::lens::pinhole);
  EXPECT_TRUE(g.options().further[3].has_depth);
  for (auto const& c : g.options().further) {
    EXPECT_EQ(c.camera.width, g.options().width);
    EXPECT_EQ(c.camera.height, g.options().height);
  }
}

class folder {
public:
  explicit folder(std::string const& name)
      : path_(fs::temp_directory_path() /
              ("ft_generator_" + name + "_" + std::to_string(::getpid()))) {
    fs::remove_all(path_);
    fs::create_directories(path_);
  }
  ~folder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  folder(folder const&) = delete;
  folder& operator=(folder const&) = delete;
  std::string operator/(std::string const& name) const { return (path_ / name).string(); }

private:
  fs::path path_;
};

std::string contents(fs::path const& path) {
  std::ifstream in(path, std::ios::binary);
  std::ostringstream out;
  out << in.rdbuf();
  return out.str();
}

std::vector<std::vector<double>> numbers(std::string const& path, std::string& header) {
  std::ifstream in(path);
  std::vector<std::vector<double>> rows;
  std::string line;
  std::getline(in, header);
  while (std::getline(in, line)) {
    std::istringstream cells(line);
    std::string cell;
    rows.emplace_back();
    while (std::getline(cells, cell, ',')) { rows.back().push_back(std::stod(cell)); }
  }
  return rows;
}

std::optional<double> bilinear(seq::image const& picture, Eigen::Vector2d const& at) {
  if (!(at.x() >= 0 && at.y() >= 0 && at.x() < picture.width - 1 && at.y() < picture.height - 1)) {
    return std::nullopt;
  }
  int const x = static_cast<int>(at.x());
  int const y = static_cast<int>(at.y());
  double const a = at.x() - x;
  double const b = at.y() - y;
  auto const* p = picture.row(y) + x;
  auto const* q = picture.row(y + 1) + x;
  return (1 - b) * ((1 - a) * p[0] + a * p[1]) + b * ((1 - a) * q[0] + a * q[1]);
}

struct shot {
  int frame;
  int camera;
  seq::image picture;
};

shot taken(generator const& g, int frame, int camera) {
  auto pair = g.render(frame);
  return {frame, camera, camera == 0 ? std::move(pair.left) : std::move(pair.right)};
}

// Mean absolute grey difference between shot `a` and shot `b` warped onto it with the exact
// geometry, the warped position shifted by `shift` pixels.
double warp_difference(generator const& g, shot const& a, shot const& b,
                       Eigen::Vector2d const& shift, int* used = nullptr) {
  auto const pose = [&](shot const& s) {
    return s.camera == 0 ? g.T_world_camera(s.frame)
                         : Eigen::Isometry3d(g.T_world_camera(s.frame) * g.rig().T_left_right);
  };
  Eigen::Isometry3d const T_b_a = pose(b).inverse() * pose(a);
  double sum = 0;
  int count = 0;
  for (int v = 4; v < a.picture.height - 4; v += 3) {
    for (int u = 4; u < a.picture.width - 4; u += 3) {
      auto const point = g.surface_point(a.frame, a.camera, u, v);
      // the outermost ring of a fisheye is darkened
      if (!point || point->z() < 0.2 * point->norm()) { continue; }
      Eigen::Vector3d const moved = T_b_a * *point;
      auto const pixel = g.project(b.camera, moved);
      if (!pixel || moved.z() < 0.2 * moved.norm()) { continue; }
      auto const value = bilinear(b.picture, *pixel + shift);
      if (!value) { continue; }
      auto const seen = g.surface_point(b.frame, b.camera, pixel->x(), pixel->y());
      if (!seen || (*seen - moved).norm() > 0.01) { continue; }  // hidden there
      sum += std::abs(*value - a.picture.row(v)[u]);
      ++count;
    }
  }
  if (used != nullptr) { *used = count; }
  return count > 0 ? sum / count : 1e9;
}

void expect_aligned(generator const& g, int frame_a, int camera_a, int frame_b, int camera_b) {
  shot const a = taken(g, frame_a, camera_a);
  shot const b = taken(g, frame_b, camera_b);
  int used = 0;
  double const exact = warp_difference(g, a, b, {0, 0}, &used);
  EXPECT_GT(used, 2000);
  EXPECT_LT(exact, 4.5);
  for (Eigen::Vector2d const& shift : {Eigen::Vector2d(0.5, 0), Eigen::Vector2d(-0.5, 0),
                                       Eigen::Vector2d(0, 0.5), Eigen::Vector2d(0, -0.5)}) {
    EXPECT_GT(warp_difference(g, a, b, shift), 1.5 * exact)
        << "frames " << frame_a << " " << frame_b << " shift " << shift.transpose();
  }
}

// The pictures of a pair, and those of a camera that moves on.
void expect_all_aligned(generator const& g) {
  std::vector<int> frames{130, 5, 60, 210, 280};
  frames.resize(static_cast<std::size_t>(test::effort(5)));
  for (int i : frames) {
    expect_aligned(g, i, 0, i, 1);
    expect_aligned(g, i, 0, i + 1, 0);
  }
}

// Pixels with 9 neighbours in a row on the circle of 16 brighter or darker by `threshold`, per
// cell.
std::vector<int> corner_cells(seq::image const& picture, int threshold, int columns, int rows) {
  constexpr int dx[16] = {0, 1, 2, 3, 3, 3, 2, 1, 0, -1, -2, -3, -3, -3, -2, -1};
  constexpr int dy[16] = {-3, -3, -2, -1, 0, 1, 2, 3, 3, 3, 2, 1, 0, -1, -2, -3};
  std::vector<int> cells(static_cast<std::size_t>(columns * rows), 0);
  for (int y = 3; y < picture.height - 3; ++y) {
    for (int x = 3; x < picture.width - 3; ++x) {
      int const centre = picture.row(y)[x];
      int bright = 0;
      int dark = 0;
      bool corner = false;
      for (int k = 0; k < 25 && !corner; ++k) {
        int const value = picture.row(y + dy[k & 15])[x + dx[k & 15]];
        bright = value > centre + threshold ? bright + 1 : 0;
        dark = value < centre - threshold ? dark + 1 : 0;
        corner = bright >= 9 || dark >= 9;
      }
      if (corner) {
        ++cells[static_cast<std::size_t>((y * rows / picture.height) * columns +
                                         x * columns / picture.width)];
      }
    }
  }
  return cells;
}

void expect_equal(seq::stereo_frame const& a, seq::stereo_frame const& b) {
  EXPECT_EQ(a.time_ns, b.time_ns);
  EXPECT_EQ(a.left.width, b.left.width);
  EXPECT_TRUE(a.left.pixels == b.left.pixels);
  EXPECT_TRUE(a.right.pixels == b.right.pixels);
}

// Integrates samples by the trapezoidal rule.
struct body_integral {
  Eigen::Vector3d p, v;
  Eigen::Matrix3d R;

  explicit body_integral(seq::body_state const& at)
      : p(at.T_world_body.translation()), v(at.velocity), R(at.T_world_body.linear()) {}
  void step(seq::imu_sample const& from, seq::imu_sample const& to) {
    double const dt = static_cast<double>(to.time_ns - from.time_ns) * 1e-9;
    Eigen::Vector3d const turn = 0.5 * (from.gyro + to.gyro) * dt;
    Eigen::Matrix3d next = R;
    if (turn.norm() > 0) {
      next = R * Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix();
    }
    Eigen::Vector3d const a =
        0.5 * (R * from.accel + next * to.accel) + Eigen::Vector3d(0, 0, -9.81);
    p += v * dt + 0.5 * a * dt * dt;
    v += a * dt;
    R = next;
  }
};

TEST(generator, same_bytes_whatever_the_threads) {
  for (rig_kind rig : {rig_kind::pinhole, rig_kind::fisheye}) {
    auto options = small(rig);
    options.threads = 1;
    generator const one(options);
    options.threads = 5;
    generator const many(options);
    std::vector<seq::stereo_frame> frames(12);
    seq::parallel_for(12, 4,
                      [&](int i) { frames[static_cast<std::size_t>(i)] = many.render(i * 20); });
    for (int i = 0; i < 12; ++i) {
      expect_equal(one.render(i * 20), frames[static_cast<std::size_t>(i)]);
    }
    auto const a = one.imu();
    auto const b = many.imu();
    ASSERT_EQ(a.size(), b.size());
    for (std::size_t i = 0; i < a.size(); ++i) {
      EXPECT_EQ(a[i].time_ns, b[i].time_ns);
      EXPECT_TRUE(a[i].gyro == b[i].gyro);
      EXPECT_TRUE(a[i].accel == b[i].accel);
    }
  }
}

TEST(generator, a_longer_sequence_begins_like_a_shorter_one) {
  auto options = small();
  options.frames = 3;
  generator const brief(options);
  options.frames = 900;
  generator const lengthy(options);
  expect_equal(brief.render(2), lengthy.render(2));
  EXPECT_TRUE(brief.T_world_camera(2).matrix() == lengthy.T_world_camera(2).matrix());
  EXPECT_TRUE(brief.imu().back().accel == lengthy.imu()[brief.imu().size() - 1].accel);
}

TEST(generator, seeds_and_noise_make_a_difference) {
  auto options = small();
  generator const one(options);
  options.seed = 2;
  generator const two(options);
  EXPECT_FALSE(one.render(0).left.pixels == two.render(0).left.pixels);
  // frames 2 and 3 are seen from the same place: they differ by noise (and exposure) only
  EXPECT_LT((one.T_world_camera(2).matrix() - one.T_world_camera(3).matrix()).norm(), 1e-12);
  auto const a = one.render(2).left;
  auto const b = one.render(3).left;
  EXPECT_FALSE(a.pixels == b.pixels);
  double sum = 0;
  double squares = 0;
  auto const n = static_cast<double>(a.pixels.size());
  for (std::size_t i = 0; i < a.pixels.size(); ++i) {
    double const d = static_cast<double>(a.pixels[i]) - b.pixels[i];
    sum += d;
    squares += d * d;
  }
  // two noisy pictures, each rounded; exposure moves little in 50 ms
  EXPECT_NEAR(std::sqrt(squares / n - (sum / n) * (sum / n)), std::sqrt(2 * (4 + 1.0 / 12)), 0.4);
}

TEST(generator, route_has_all_that_a_tracker_should_meet) {
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    generator_options options;
    options.width = 64;
    options.seed = seed;
    generator const g(options);
    auto const truth = g.ground_truth();
    ASSERT_EQ(truth.size(), 300u);
    double path = 0;
    double top_speed = 0;
    double top_turn = 0;
    int still = 0;
    int longest_still = 0;
    int pauses = 0;
    for (std::size_t i = 1; i < truth.size(); ++i) {
      auto const& a = truth[i - 1].T_world_camera;
      auto const& b = truth[i].T_world_camera;
      double const step = (b.translation() - a.translation()).norm();
      double const turn =
          Eigen::AngleAxisd(a.linear().transpose() * b.linear()).angle() * 180 / 3.14159265;
      path += step;
      top_speed = std::max(top_speed, step * options.fps);
      top_turn = std::max(top_turn, turn * options.fps);
      still = step < 1e-9 && turn < 1e-5 ? still + 1 : 0;
      pauses += still == 10 ? 1 : 0;
      longest_still = std::max(longest_still, still);
    }
    EXPECT_GE(path, 20.0);
    EXPECT_LE(top_speed, 2.5);
    EXPECT_GE(top_turn, 75);
    EXPECT_LE(top_turn, 110);
    EXPECT_GE(pauses, 3);
    EXPECT_LE(longest_still, 20);

    double nearest = 1e9;
    int close = 0;
    for (int i = 0; i < g.size(); ++i) {
      double const c = g.clearance(i);
      nearest = std::min(nearest, c);
      close += c < 0.9 ? 1 : 0;
    }
    EXPECT_GT(nearest, 0.7);
    EXPECT_LT(nearest, 0.85);
    EXPECT_GE(close, 20);
  }
}

TEST(generator, never_meets_a_surface_lap_after_lap) {
  generator_options options;
  options.width = 64;
  options.frames = 1200;
  options.baseline = 0.3;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    options.seed = seed;
    generator const g(options);
    for (int i = 0; i < g.size(); ++i) { ASSERT_GT(g.clearance(i), 0.5) << i << " seed " << seed; }
  }
}

TEST(generator, room_is_closed_and_full_of_corners) {
  generator_options options;
  options.exposure_change = false;
  options.noise_sigma = 0;
  generator const closed(options);
  options.noise_sigma = 2;
  generator const noisy(options);
  int const step = 14 * 23 / test::effort(14);
  for (int i = 0; i < 300; i += step) {
    auto const picture = closed.render(i).left;
    EXPECT_GT(*std::min_element(picture.pixels.begin(), picture.pixels.end()), 0) << "frame " << i;
    auto const cells = corner_cells(noisy.render(i).left, 15, 8, 5);
    int total = 0;
    int filled = 0;
    for (int count : cells) {
      total += count;
      filled += count >= 10 ? 1 : 0;
    }
    EXPECT_GT(total, 1500) << "frame " << i;
    EXPECT_GE(filled, 38) << "frame " << i;
  }
}

TEST(generator, pinhole_pictures_agree_with_the_geometry) {
  generator const g(plain(rig_kind::pinhole));
  EXPECT_TRUE(g.rig().rectified());
  EXPECT_NEAR(g.rig().baseline(), 0.11, 1e-12);
  expect_all_aligned(g);
}

TEST(generator, fisheye_pictures_agree_with_the_geometry) {
  generator const g(plain(rig_kind::fisheye));
  EXPECT_FALSE(g.rig().rectified());
  EXPECT_NEAR(g.rig().baseline(), 0.101, 1e-12);
  expect_all_aligned(g);
}

TEST(generator, depth_and_projection) {
  for (rig_kind rig : {rig_kind::pinhole, rig_kind::fisheye}) {
    generator const g(small(rig));
    auto const& c = g.rig().left;
    for (int v = 0; v < c.height; v += 7) {
      for (int u = 0; u < c.width; u += 7) {
        for (int camera : {0, 1}) {
          auto const point = g.surface_point(10, camera, u, v);
          if (!point) {
            EXPECT_EQ(rig, rig_kind::fisheye);
            continue;
          }
          auto const pixel = g.project(camera, *point);
          ASSERT_TRUE(pixel);
          EXPECT_NEAR(pixel->x(), u, 1e-9);
          EXPECT_NEAR(pixel->y(), v, 1e-9);
          EXPECT_LT(point->norm(), 16);  // the room's diagonal
          if (camera == 0) { EXPECT_EQ(g.depth(10, u, v), point->z()); }
        }
      }
    }
    EXPECT_FALSE(g.project(0, {0, 0, -1}));
    EXPECT_FALSE(g.project(0, {std::nan(""), 0, std::nan("")}));
  }
  generator const fisheye(small(rig_kind::fisheye));
  EXPECT_EQ(fisheye.depth(0, 0, 0), -1);  // a corner outside the lens' circle
}

TEST(generator, imu_integrates_to_the_ground_truth) {
  auto options = small();
  options.width = 64;
  options.imu_noise_scale = 0;
  generator const g(options);
  auto const imu = g.imu();
  auto const truth = g.body_ground_truth();  // at 20 Hz frames every time is an IMU time
  ASSERT_EQ(imu.size(), truth.size());
  ASSERT_EQ(imu.size(), 299u * 10 + 1);
  body_integral at(truth[0]);
  for (std::size_t i = 1; i < imu.size(); ++i) {
    at.step(imu[i - 1], imu[i]);
    ASSERT_LT((at.v - truth[i].velocity).norm(), 0.01) << "sample " << i;
    ASSERT_LT((at.p - truth[i].T_world_body.translation()).norm(), 0.03) << "sample " << i;
    ASSERT_LT(Eigen::AngleAxisd(at.R.transpose() * truth[i].T_world_body.linear()).angle(), 2e-3);
  }
  // the body's poses are the camera's, moved by the extrinsics
  Eigen::Isometry3d const T = truth[10].T_world_body * g.rig().T_body_left;
  EXPECT_LT((T.matrix() - g.T_world_camera(1).matrix()).norm(), 1e-12);
}

// Ideal samples against differences of the very poses that the images are rendered from. At 10 kHz
// those are off by less than 1e-5 of what they stand for; at knots of the route, where the
// acceleration has a corner, by more.
TEST(generator, rates_and_specific_force_are_derivatives_of_the_poses) {
  for (rig_kind rig : {rig_kind::pinhole, rig_kind::fisheye}) {
    auto options = small(rig);
    options.width = 64;
    options.frames = 70;
    options.imu_noise_scale = 0;
    options.imu_rate = 10000;
    options.fast_turns = {{{1.5, 2.0}, 60}};
    generator const g(options);
    auto const imu = g.imu();
    auto const truth = g.body_ground_truth();
    ASSERT_EQ(imu.size(), truth.size());
    constexpr double h = 1e-4;
    double gyro = 0;
    double accel = 0;
    double velocity = 0;
    double fastest = 0;
    for (std::size_t i = 1; i + 1 < imu.size(); ++i) {
      auto const& before = truth[i - 1].T_world_body;
      auto const& here = truth[i].T_world_body;
      auto const& after = truth[i + 1].T_world_body;
      Eigen::Matrix3d const turn = before.linear().transpose() * after.linear();
      // vee(turn - turn^T) / 2 is the axis times the sine of the angle
      Eigen::Vector3d const rate = Eigen::Vector3d(turn(2, 1) - turn(1, 2), turn(0, 2) - turn(2, 0),
                                                   turn(1, 0) - turn(0, 1)) /
                                   (4 * h);
      gyro = std::max(gyro, (rate - imu[i].gyro).norm());
      fastest = std::max(fastest, imu[i].gyro.norm());
      Eigen::Vector3d const v = (after.translation() - before.translation()) / (2 * h);
      velocity = std::max(velocity, (v - truth[i].velocity).norm());
      if (i % 500 == 0) { continue; }  // a knot
      Eigen::Vector3d const a =
          (after.translation() - 2 * here.translation() + before.translation()) / (h * h);
      Eigen::Vector3d const force = here.linear().transpose() * (a + Eigen::Vector3d(0, 0, 9.81));
      accel = std::max(accel, (force - imu[i].accel).norm());
    }
    EXPECT_LT(gyro, 1e-5);
    EXPECT_LT(accel, 1e-4);
    EXPECT_LT(velocity, 1e-5);
    EXPECT_NEAR(fastest, 3.14159 / 0.5 * 60 * 3.14159 / 180,
                0.7);  // the fast turn's, and the route's
  }
}

TEST(generator, fast_samples_integrate_to_the_ground_truth_within_a_millimetre) {
  auto options = small();
  options.width = 64;
  options.imu_noise_scale = 0;
  options.imu_rate = 1000;
  options.fast_turns = {{{9.0, 9.6}, -90}};
  generator const g(options);
  auto const imu = g.imu();
  auto const truth = g.body_ground_truth();
  ASSERT_EQ(imu.size(), truth.size());
  body_integral at(truth[0]);
  for (std::size_t i = 1; i < imu.size(); ++i) {
    at.step(imu[i - 1], imu[i]);
    ASSERT_LT((at.v - truth[i].velocity).norm(), 2e-4) << "sample " << i;
    ASSERT_LT((at.p - truth[i].T_world_body.translation()).norm(), 1e-3) << "sample " << i;
    ASSERT_LT(Eigen::AngleAxisd(at.R.transpose() * truth[i].T_world_body.linear()).angle(), 5e-5);
  }
}

TEST(generator, motion_is_smooth) {
  auto options = small();
  options.width = 64;
  options.imu_noise_scale = 0;
  options.imu_rate = 1000;
  generator const g(options);
  auto const imu = g.imu();
  for (std::size_t i = 1; i < imu.size(); ++i) {
    ASSERT_LT((imu[i].accel - imu[i - 1].accel).norm(), 0.15) << i;  // no steps in acceleration
    ASSERT_LT((imu[i].gyro - imu[i - 1].gyro).norm(), 0.02) << i;
  }
  // standing still at the start: gravity only
  EXPECT_NEAR(imu[100].accel.norm(), 9.81, 1e-9);
  EXPECT_NEAR(imu[100].gyro.norm(), 0, 1e-9);
}

TEST(generator, imu_noise_has_the_stated_size) {
  auto options = small();
  options.width = 64;
  generator const noisy(options);
  options.imu_noise_scale = 0;
  generator const ideal(options);
  auto const a = noisy.imu();
  auto const b = ideal.imu();
  auto const states = noisy.body_ground_truth();
  double gyro = 0;
  double accel = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    gyro += (a[i].gyro - b[i].gyro - states[i].gyro_bias).squaredNorm() / 3;
    accel += (a[i].accel - b[i].accel - states[i].accel_bias).squaredNorm() / 3;
  }
  seq::imu_noise const n;
  auto const count = static_cast<double>(a.size());
  EXPECT_NEAR(std::sqrt(gyro / count) / (n.gyro * std::sqrt(200.0)), 1, 0.05);
  EXPECT_NEAR(std::sqrt(accel / count) / (n.accel * std::sqrt(200.0)), 1, 0.05);
  EXPECT_GT(states[0].gyro_bias.norm(), 0);
  EXPECT_FALSE(states[0].accel_bias == states.back().accel_bias);
}

// Statistics of an axis of white noise: the standard deviation, and the correlation of neighbours.
struct noise_figures {
  double squares = 0, products = 0, last = 0;
  int count = 0;
  void add(double x) {
    squares += x * x;
    products += x * last;
    last = x;
    ++count;
  }
  double deviation() const { return std::sqrt(squares / count); }
  double correlation() const { return products / squares; }
};

TEST(generator, imu_noise_is_white_and_biases_walk_as_set) {
  for (double const rate : {100.0, 1000.0}) {
    auto options = small();
    options.width = 64;
    options.frames = 400;
    options.imu_rate = rate;
    options.imu = {1e-3, 2e-2, 3e-4, 4e-3};
    options.imu_noise_scale = 2;
    options.gyro_bias = 0;
    generator const noisy(options);
    options.imu_noise_scale = 0;
    generator const ideal(options);
    auto const a = noisy.imu();
    auto const b = ideal.imu();
    std::vector<seq::body_state> states;  // at the samples' times
    for (auto const& s : noisy.body_ground_truth()) {
      if (states.size() < a.size() && s.time_ns == a[states.size()].time_ns) {
        states.push_back(s);
      }
    }
    ASSERT_EQ(states.size(), a.size());
    EXPECT_TRUE(states[0].gyro_bias.isZero(0));
    EXPECT_GT(states[0].accel_bias.norm(), 0);
    for (int axis = 0; axis < 3; ++axis) {
      noise_figures gyro, accel, gyro_walk, accel_walk;
      for (std::size_t i = 0; i < a.size(); ++i) {
        gyro.add((a[i].gyro - b[i].gyro - states[i].gyro_bias)[axis]);
        accel.add((a[i].accel - b[i].accel - states[i].accel_bias)[axis]);
        if (i == 0) { continue; }
        gyro_walk.add((states[i].gyro_bias - states[i - 1].gyro_bias)[axis]);
        accel_walk.add((states[i].accel_bias - states[i - 1].accel_bias)[axis]);
      }
      // four standard deviations of these figures
      double const n = static_cast<double>(a.size());
      double const slack = 4 / std::sqrt(2 * n);
      EXPECT_NEAR(gyro.deviation() / (2e-3 * std::sqrt(rate)), 1, slack);
      EXPECT_NEAR(accel.deviation() / (4e-2 * std::sqrt(rate)), 1, slack);
      EXPECT_NEAR(gyro_walk.deviation() / (6e-4 / std::sqrt(rate)), 1, slack);
      EXPECT_NEAR(accel_walk.deviation() / (8e-3 / std::sqrt(rate)), 1, slack);
      for (auto const* f : {&gyro, &accel, &gyro_walk, &accel_walk}) {
        EXPECT_LT(std::abs(f->correlation()), 4 / std::sqrt(n));
      }
    }
  }
}

TEST(generator, a_covered_lens_gives_black_images) {
  auto options = small();
  options.frames = 12;
  options.blind = {{0.2, 0.3}, {0.5, 9}};
  generator const covered(options);
  options.blind.clear();
  generator const open(options);
  for (int i = 0; i < 12; ++i) {
    auto const frame = covered.render(i);
    if (i == 4 || i == 5 || i >= 10) {
      for (auto const* picture : {&frame.left, &frame.right}) {
        EXPECT_LT(*std::max_element(picture->pixels.begin(), picture->pixels.end()), 12) << i;
        EXPECT_GT(*std::max_element(picture->pixels.begin(), picture->pixels.end()), 0) << i;
      }
      EXPECT_FALSE(frame.left.pixels == frame.right.pixels);  // noise of its own
    } else {
      expect_equal(frame, open.render(i));
    }
  }
}

TEST(generator, an_exposure_is_the_mean_of_its_instants) {
  auto options = plain(rig_kind::pinhole);
  options.width = 160;
  options.fps = 1000;
  options.frames = 6801;
  generator const sharp(options);
  options.exposure_s = 0.010;
  generator const exposed(options);
  constexpr int turning = 6700;  // at about 80 degrees a second
  auto const blurred = exposed.render(turning).left;
  auto const centre = sharp.render(turning).left;
  std::vector<double> mean(blurred.pixels.size(), 0.0);
  for (int k = -5; k <= 5; ++k) {
    auto const picture = sharp.render(turning + k).left;
    double const weight = k == -5 || k == 5 ? 0.05 : 0.1;
    for (std::size_t p = 0; p < mean.size(); ++p) { mean[p] += weight * picture.pixels[p]; }
  }
  double off = 0;
  double moved = 0;
  for (std::size_t p = 0; p < mean.size(); ++p) {
    off += std::abs(mean[p] - blurred.pixels[p]) / static_cast<double>(mean.size());
    moved += std::abs(mean[p] - centre.pixels[p]) / static_cast<double>(mean.size());
  }
  EXPECT_LT(off, 0.6);  // both are rounded
  EXPECT_GT(moved, 2.0);
  // standing still, nothing is blurred
  expect_equal(exposed.render(100), sharp.render(100));
}

TEST(generator, a_row_is_seen_at_its_own_time) {
  auto options = plain(rig_kind::pinhole);
  options.width = 160;
  options.height = 101;
  options.fps = 1000;
  options.frames = 6801;
  generator const global(options);
  options.readout_s = 0.020;
  generator const rolling(options);
  EXPECT_EQ(global.rig().left.readout_s, 0);
  EXPECT_EQ(rolling.rig().right.readout_s, 0.020);
  constexpr int turning = 6700;  // at about 80 degrees a second
  auto const seen = rolling.render(turning);
  double moved = 0;
  for (int ms : {-10, -5, 0, 3, 10}) {  // rows 0 to 100: 5 a millisecond
    int const row = 50 + 5 * ms;
    auto const at_row = global.render(turning + ms);
    auto const at_middle = global.render(turning);
    for (auto const& [a, b, c] : {std::tuple(&seen.left, &at_row.left, &at_middle.left),
                                  std::tuple(&seen.right, &at_row.right, &at_middle.right)}) {
      int other = 0;
      for (int x = 0; x < 160; ++x) {
        // outlines have samples of their own, which depend on the rows beside
        other += std::abs(a->row(row)[x] - b->row(row)[x]) > 2 ? 1 : 0;
        moved += std::abs(a->row(row)[x] - c->row(row)[x]) / 160.0;
      }
      EXPECT_LT(other, 6) << ms;
    }
    EXPECT_NEAR(rolling.depth(turning, 80, row), global.depth(turning + ms, 80, row), 1e-6);
  }
  EXPECT_GT(moved, 10);
  // standing still, it is the same
  expect_equal(rolling.render(100), global.render(100));
}

TEST(generator, a_fast_turn_ends_where_it_began) {
  auto options = small();
  options.width = 64;
  options.frames = 60;
  generator const steady(options);
  options.fast_turns = {{{1.0, 2.0}, 50}};
  generator const turning(options);
  for (int i = 0; i < 60; ++i) {
    auto const a = steady.T_world_camera(i);
    auto const b = turning.T_world_camera(i);
    EXPECT_LT((a.translation() - b.translation()).norm(), 1e-12);
    Eigen::AngleAxisd const between(b.linear() * a.linear().transpose());
    if (i < 19 || i > 41) { EXPECT_LT(between.angle(), 1e-6) << i; }
    if (i == 30) {
      EXPECT_NEAR(between.angle() * 180 / 3.14159265, 50, 1.0);
      EXPECT_GT(between.axis().z(), 0.999);
    }
  }
}

TEST(generator, exposure_changes_when_asked) {
  auto options = small();
  options.noise_sigma = 0;
  generator const changing(options);
  options.exposure_change = false;
  generator const steady(options);
  double low = 1e9;
  double high = 0;
  for (int i = 0; i < 300; i += 10) {
    auto const a = changing.render(i).left;
    auto const b = steady.render(i).left;
    double sum_a = 0;
    double sum_b = 0;
    for (std::size_t k = 0; k < a.pixels.size(); ++k) {
      sum_a += a.pixels[k];
      sum_b += b.pixels[k];
    }
    low = std::min(low, sum_a / sum_b);
    high = std::max(high, sum_a / sum_b);
  }
  EXPECT_NEAR(low, 0.8, 0.03);
  EXPECT_NEAR(high, 1.2, 0.03);
}

TEST(generator, odd_sizes_and_rates) {
  for (auto const& size : {std::pair<int, int>{33, 47}, {640, 32}, {32, 640}, {101, 0}, {0, 99}}) {
    for (rig_kind rig : {rig_kind::pinhole, rig_kind::fisheye}) {
      generator_options options;
      options.rig = rig;
      options.width = size.first;
      options.height = size.second;
      options.frames = 2;
      options.fps = 29.97;
      generator const g(options);
      auto const frame = g.render(1);
      EXPECT_EQ(frame.left.width, g.options().width);
      EXPECT_EQ(frame.right.height, g.options().height);
      EXPECT_EQ(frame.left.pixels.size(), static_cast<std::size_t>(g.options().width) *
                                              static_cast<std::size_t>(g.options().height));
      EXPECT_EQ(g.body_ground_truth().size(),
                g.imu().size() + 1);  // frame 1 is between two samples
    }
  }
  generator_options one;
  one.width = 64;
  one.frames = 1;
  EXPECT_EQ(generator(one).imu().size(), 1u);
}

TEST(generator, refuses_bad_options) {
  auto const message = [](auto const& change) -> std::string {
    generator_options o;
    o.width = 64;
    change(o);
    try {
      generator const g(o);
    } catch (seq::error const& e) { return e.what(); }
    return {};
  };
  EXPECT_EQ(message([](auto& o) { o.width = 31; }),
            "generator: width is 31; must be 32 to 4096, or 0 for the default");
  EXPECT_EQ(message([](auto& o) { o.frames = 0; }), "generator: frames is 0; must be 1 to 100000");
  EXPECT_NE(message([](auto& o) { o.width = 4097; }), "");
  EXPECT_NE(message([](auto& o) { o.height = -1; }), "");
  EXPECT_NE(message([](auto& o) { o.frames = 100001; }), "");
  EXPECT_NE(message([](auto& o) { o.fps = 0; }), "");
  EXPECT_NE(message([](auto& o) { o.fps = std::numeric_limits<double>::quiet_NaN(); }), "");
  EXPECT_NE(message([](auto& o) { o.fps = std::numeric_limits<double>::infinity(); }), "");
  EXPECT_NE(message([](auto& o) { o.noise_sigma = -1; }), "");
  EXPECT_NE(message([](auto& o) { o.baseline = 0.5; }), "");
  EXPECT_NE(message([](auto& o) { o.baseline = -0.1; }), "");
  EXPECT_NE(message([](auto& o) { o.imu_rate = 0; }), "");
  EXPECT_NE(message([](auto& o) { o.imu_noise_scale = -1; }), "");
  EXPECT_NE(message([](auto& o) { o.threads = -1; }), "");
  EXPECT_NE(message([](auto& o) { o.imu.gyro = -1; }), "");
  EXPECT_NE(message([](auto& o) { o.imu.accel_walk = std::nan(""); }), "");
  EXPECT_NE(message([](auto& o) { o.gyro_bias = 2; }), "");
  EXPECT_NE(message([](auto& o) { o.accel_bias = -1; }), "");
  EXPECT_NE(message([](auto& o) { o.exposure_s = 0.2; }), "");
  EXPECT_NE(message([](auto& o) { o.readout_s = 0.2; }), "");
  EXPECT_NE(message([](auto& o) { o.readout_s = -0.01; }), "");
  EXPECT_EQ(message([](auto& o) {
              o.blind = {{2, 1}};
            }),
            "generator: blind: to_s is 1; must be above 2 and at most 1e+06");
  EXPECT_NE(message([](auto& o) { o.blind = {{std::nan(""), 1}}; }), "");
  EXPECT_NE(message([](auto& o) { o.dropped = {{-1, 1}}; }), "");
  EXPECT_NE(message([](auto& o) { o.fast_turns = {{{1, 1.1}, 10}}; }), "");
  EXPECT_NE(message([](auto& o) { o.fast_turns = {{{1, 2}, 400}}; }), "");
  EXPECT_NE(message([](auto& o) { o.rig = static_cast<rig_kind>(7); }), "");
  EXPECT_EQ(message([](auto&) {}), "");

  auto options = small();
  options.frames = 3;
  generator const g(options);
  EXPECT_THROW(g.render(3), seq::error);
  EXPECT_THROW(g.render(-1), seq::error);
  EXPECT_THROW(g.time_ns(3), seq::error);
  EXPECT_THROW(g.T_world_camera(-1), seq::error);
  EXPECT_THROW(g.surface_point(0, 2, 1, 1), seq::error);
  EXPECT_THROW(g.clearance(3), seq::error);
}

TEST(asl_writer, what_is_written_reads_back) {
  for (rig_kind rig : {rig_kind::pinhole, rig_kind::fisheye}) {
    folder const place("read_back");
    auto options = small(rig);
    options.frames = 12;
    generator const g(options);
    int calls = 0;
    int last = 0;
    seq::write_asl(g, place / "s", {}, [&](int done) {
      ++calls;
      last = done;
    });
    EXPECT_EQ(calls, 12);
    EXPECT_EQ(last, 12);
    EXPECT_FALSE(fs::exists(place / "s.partial"));

    seq::open_options reading;
    reading.read_imu = true;
    auto const back = seq::sequence::open(place / "s", reading);
    EXPECT_EQ(back.layout(), "euroc");
    EXPECT_EQ(back.fisheye(), rig == rig_kind::fisheye);
    ASSERT_EQ(back.size(), 12);
    auto const& r = back.rig();
    EXPECT_EQ(r.left.width, g.rig().left.width);
    EXPECT_EQ(r.left.height, g.rig().left.height);
    EXPECT_NEAR(r.baseline(), g.rig().baseline(), 1e-12);
    EXPECT_NEAR(r.fps, 20, 1e-9);
    if (rig == rig_kind::fisheye) {
      EXPECT_EQ(r.left.model, seq::lens::kannala_brandt);
      EXPECT_EQ(r.left.distortion, g.rig().left.distortion);
      EXPECT_EQ(r.right.distortion, g.rig().right.distortion);
      EXPECT_EQ(r.right.fx, g.rig().right.fx);
      EXPECT_EQ(r.right.cy, g.rig().right.cy);
      EXPECT_LT((r.T_left_right.matrix() - g.rig().T_left_right.matrix()).norm(), 1e-12);
      EXPECT_LT((r.T_body_left.matrix() - g.rig().T_body_left.matrix()).norm(), 1e-12);
      for (int i : {0, 11}) { expect_equal(back.load(i), g.render(i)); }
      auto const& truth = back.ground_truth();
      ASSERT_FALSE(truth.empty());
      EXPECT_TRUE(back.ground_truth_has_orientation());
      for (int i = 0; i < 12; ++i) {
        auto const same = std::find_if(truth.begin(), truth.end(), [&](auto const& pose) {
          return pose.time_ns == g.time_ns(i);
        });
        ASSERT_NE(same, truth.end());
        EXPECT_LT((same->T_world_camera.matrix() - g.T_world_camera(i).matrix()).norm(), 1e-9);
      }
    }
    for (int i = 0; i < 12; ++i) { EXPECT_EQ(back.time_ns(i), g.time_ns(i)); }
    auto const name = std::to_string(g.time_ns(7)) + ".png";
    EXPECT_TRUE(seq::read_image(place / "s/mav0/cam1/data/" + name).pixels ==
                g.render(7).right.pixels);

    ASSERT_TRUE(back.imu());
    EXPECT_EQ(back.imu()->calibration.rate_hz, 200);
    EXPECT_EQ(back.imu()->calibration.noise.gyro, 1.7e-4);
    EXPECT_EQ(back.imu()->calibration.noise.accel_walk, 3e-3);
    EXPECT_LT((back.imu()->T_imu_left.matrix() - back.rig().T_body_left.matrix()).norm(), 1e-15);
    ASSERT_EQ(back.imu()->samples.size(), g.imu().size());
    EXPECT_TRUE(back.imu()->samples.back().gyro == g.imu().back().gyro);
    EXPECT_TRUE(back.imu()->samples.back().accel == g.imu().back().accel);
    EXPECT_EQ(back.imu()->samples.back().time_ns, g.imu().back().time_ns);

    std::string header;
    auto const imu = numbers(place / "s/mav0/imu0/data.csv", header);
    EXPECT_EQ(header,
              "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
              "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]");
    auto const samples = g.imu();
    ASSERT_EQ(imu.size(), samples.size());
    for (std::size_t i = 0; i < imu.size(); ++i) {
      ASSERT_EQ(imu[i].size(), 7u);
      EXPECT_EQ(imu[i][2], samples[i].gyro.y());
      EXPECT_EQ(imu[i][6], samples[i].accel.z());
    }
    auto const truth = numbers(place / "s/mav0/state_groundtruth_estimate0/data.csv", header);
    auto const states = g.body_ground_truth();
    ASSERT_EQ(truth.size(), states.size());
    for (std::size_t i = 0; i < truth.size(); ++i) {
      auto const& row = truth[i];
      ASSERT_EQ(row.size(), 17u);
      EXPECT_EQ(row[1], states[i].T_world_body.translation().x());
      Eigen::Quaterniond const q(row[4], row[5], row[6], row[7]);
      EXPECT_LT((q.toRotationMatrix() - states[i].T_world_body.linear()).norm(), 1e-12);
      EXPECT_EQ(row[8], states[i].velocity.x());
      EXPECT_EQ(row[13], states[i].gyro_bias.z());
      EXPECT_EQ(row[16], states[i].accel_bias.z());
    }
    EXPECT_NE(contents(place / "s/generated.txt").find("seed: 1\n"), std::string::npos);
    EXPECT_EQ(contents(place / "s/mav0/cam0/data.csv").substr(0, 26),
              "#timestamp [ns],filename\n1");
  }
}

TEST(asl_writer, dropped_frames_and_an_imu_that_is_not_wanted_are_left_out) {
  folder const place("dropped");
  auto options = small();
  options.frames = 8;
  options.dropped = {{0.1, 0.2}};
  options.imu_noise_scale = 0;
  generator const g(options);
  seq::asl_options writing;
  writing.imu = false;
  int last = 0;
  seq::write_asl(g, place / "s", writing, [&](int done) { last = done; });
  EXPECT_EQ(last, 8);
  EXPECT_FALSE(fs::exists(place / "s/mav0/imu0"));
  seq::open_options reading;
  reading.read_imu = true;
  auto const back = seq::sequence::open(place / "s", reading);
  EXPECT_FALSE(back.imu());
  ASSERT_EQ(back.size(), 6);
  EXPECT_EQ(back.time_ns(1), g.time_ns(1));
  EXPECT_EQ(back.time_ns(2), g.time_ns(4));
  EXPECT_TRUE(back.unpaired().left == 0 && back.unpaired().right == 0);
  EXPECT_FALSE(fs::exists(place / ("s/mav0/cam0/data/" + std::to_string(g.time_ns(2)) + ".png")));

  seq::write_asl(g, place / "with", {});
  auto const ideal = seq::sequence::open(place / "with", reading);
  ASSERT_TRUE(ideal.imu());
  EXPECT_EQ(ideal.imu()->calibration.noise.accel, 2e-3);  // what a filter is told of ideal samples
}

TEST(asl_writer, same_files_whatever_the_threads) {
  folder const place("threads");
  auto options = small();
  options.frames = 9;
  generator const g(options);
  seq::asl_options one;
  one.threads = 1;
  seq::asl_options many;
  many.threads = 4;
  seq::write_asl(g, place / "one", one);
  seq::write_asl(g, place / "many/", many);
  int files = 0;
  for (auto const& entry : fs::recursive_directory_iterator(place / "one")) {
    if (!entry.is_regular_file()) { continue; }
    auto const other = fs::path(place / "many") / fs::relative(entry.path(), place / "one");
    EXPECT_TRUE(contents(entry.path()) == contents(other)) << other;
    ++files;
  }
  EXPECT_EQ(files, 2 * 9 + 8 + 1);
}

TEST(asl_writer, leaves_nothing_that_looks_finished) {
  folder const place("interrupted");
  auto options = small();
  options.frames = 6;
  generator const g(options);
  struct stop : std::runtime_error {
    using std::runtime_error::runtime_error;
  };
  EXPECT_THROW(seq::write_asl(g, place / "s", {},
                              [](int done) {
                                if (done == 3) { throw stop("enough"); }
                              }),
               stop);
  EXPECT_FALSE(fs::exists(place / "s"));
  EXPECT_FALSE(fs::exists(place / "s.partial"));

  // the remains of a killed run are replaced, other people's folders are not
  fs::create_directories(place / "s.partial/mav0");
  EXPECT_THROW(seq::write_asl(g, place / "s"), seq::error);
  EXPECT_TRUE(fs::exists(place / "s.partial/mav0"));
  std::ofstream(place / "s.partial/generated.txt") << "rig: pinhole\n";
  seq::write_asl(g, place / "s");
  EXPECT_TRUE(fs::exists(place / "s/mav0/cam0/data.csv"));
  EXPECT_THROW(seq::write_asl(g, place / "s"), seq::error);  // is there already

  fs::create_directories(place / "empty");
  seq::write_asl(g, place / "empty");
  EXPECT_TRUE(fs::exists(place / "empty/mav0/cam0/data.csv"));

  EXPECT_THROW(seq::write_asl(g, ""), seq::error);
  EXPECT_THROW(seq::write_asl(g, "."), seq::error);
  EXPECT_THROW(seq::write_asl(g, "/"), seq::error);
  EXPECT_THROW(seq::write_asl(g, place / "s/generated.txt/x"), seq::error);
  seq::asl_options bad;
  bad.png_compression = 10;
  EXPECT_THROW(seq::write_asl(g, place / "t", bad), seq::error);
  bad = {};
  bad.threads = -1;
  EXPECT_THROW(seq::write_asl(g, place / "t", bad), seq::error);
  EXPECT_FALSE(fs::exists(place / "t"));
}

TEST(parallel_for, runs_every_task_once_and_passes_errors_on) {
  for (int threads : {0, 1, 3, 16}) {
    std::vector<std::atomic<int>> seen(50);
    seq::parallel_for(50, threads, [&](int i) { ++seen[static_cast<std::size_t>(i)]; });
    for (auto const& count : seen) { EXPECT_EQ(count, 1); }
    EXPECT_THROW(seq::parallel_for(50, threads,
                                   [](int i) {
                                     if (i == 20) { throw std::logic_error("20"); }
                                   }),
                 std::logic_error);
  }
  seq::parallel_for(0, 4, [](int) { FAIL(); });
}

}  // namespace
