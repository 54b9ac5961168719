// SPDX-License-Identifier: Apache-2.0
// What a generated sequence can be made of besides the room: a corridor, things that hide it.
#include "examples/sequence/generator.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdlib>
#include <limits>
#include <string>

namespace {

using seq::generator;
using seq::generator_options;

/// Nothing but the scene makes two pictures differ.
generator_options corridor(int frames = 101) {
  generator_options o;
  o.scene = seq::scene_kind::corridor;
  o.width = 188;
  o.frames = frames;
  o.noise_sigma = 0;
  o.exposure_change = false;
  o.vignetting = false;
  return o;
}

generator_options with(generator_options o, double seq::hiding_things::*what, double percent) {
  o.hiding.*what = percent;
  return o;
}

/// Share of the pixels that are `apart` grey levels or more apart, percent.
double differing(seq::image const& a, seq::image const& b, int apart = 1) {
  int count = 0;
  for (std::size_t i = 0; i < a.pixels.size(); ++i) {
    count += static_cast<int>(std::abs(a.pixels[i] - b.pixels[i]) >= apart);
  }
  return 100.0 * count / static_cast<double>(a.pixels.size());
}

TEST(generator_scenes, the_corridor_is_driven_at_the_speed_asked_for) {
  auto o = corridor();
  o.speed = 8;
  generator const g(o);
  auto const x = [&](int i) { return g.T_world_camera(i).translation().x(); };
  EXPECT_EQ(x(0), 0);
  EXPECT_EQ(x(8), 0) << "at rest for the first half second";
  EXPECT_NEAR((x(100) - x(60)) / 2.0, 8, 1e-9) << "m/s over two seconds";
  EXPECT_LT(std::abs(g.T_world_camera(100).translation().y()), 0.11) << "metres aside";
}

TEST(generator_scenes, the_corridor_is_closed) {
  for (double const repeat : {0.0, 1.7}) {
    auto o = corridor();
    o.repeat = repeat;
    for (double const aside : {0.0, 90.0, 180.0}) {
      o.look_aside = aside;
      generator const g(o);
      for (int const frame : {0, 100}) {
        auto const picture = g.render(frame).left;
        for (auto const grey : picture.pixels) { ASSERT_GT(grey, 5) << aside << " " << repeat; }
      }
    }
  }
}

TEST(generator_scenes, samples_of_the_imu_fit_the_drive) {
  auto o = corridor();
  o.speed = 8;
  o.imu_noise_scale = 0;
  generator const g(o);
  auto const states = g.body_ground_truth();
  auto const samples = g.imu();
  ASSERT_EQ(states.size(), samples.size());
  Eigen::Vector3d velocity = states.front().velocity;
  Eigen::Vector3d place = states.front().T_world_body.translation();
  for (std::size_t i = 0; i + 1 < samples.size(); ++i) {
    auto const world = [&](std::size_t k) -> Eigen::Vector3d {
      return states[k].T_world_body.linear() * samples[k].accel - Eigen::Vector3d(0, 0, 9.81);
    };
    double const dt = 1e-9 * static_cast<double>(samples[i + 1].time_ns - samples[i].time_ns);
    Eigen::Vector3d const mean = 0.5 * (world(i) + world(i + 1));
    place += dt * velocity + 0.5 * dt * dt * mean;
    velocity += dt * mean;
  }
  EXPECT_LT((place - states.back().T_world_body.translation()).norm(), 0.005) << "of 28 m";
}

TEST(generator_scenes, the_camera_looks_aside) {
  auto o = corridor(1);
  o.look_aside = 90;
  generator const g(o);
  Eigen::Vector3d const forward = g.T_world_camera(0).linear().col(2);
  EXPECT_LT((forward - Eigen::Vector3d::UnitY()).norm(), 1e-6);
  EXPECT_NEAR(g.depth(0, 94, 60), 2.5, 0.1) << "metres to the wall";
}

TEST(generator_scenes, a_repeated_corridor_looks_the_same_a_period_on) {
  auto o = corridor(1);
  o.speed = 40;  // a long one: its end is far
  o.frames = 60;
  Eigen::Isometry3d on = Eigen::Isometry3d::Identity();
  on.translation().z() = 1.5;
  auto const change = [&] {
    generator const g(o);
    return differing(g.render(0).left, g.render(0, on).left, 3);
  };
  EXPECT_GT(change(), 50);
  o.repeat = 1.5;
  EXPECT_LT(change(), 2);
  o.repeat = 2;
  EXPECT_GT(change(), 50);
}

TEST(generator_scenes, things_hide_the_share_asked_for_and_nothing_else) {
  using things = seq::hiding_things;
  auto o = corridor();
  o.width = 376;
  o.speed = 1;
  generator const bare(o);
  seq::image const pictures[] = {bare.render(0).left, bare.render(100).left};  // 3 m on
  for (auto const what : {&things::bonnet, &things::dirt, &things::companion, &things::crossing}) {
    for (double const percent : {25.0, 40.0}) {
      generator const hidden(with(o, what, percent));
      for (int const k : {0, 1}) {
        // its edges are up to a pixel more; some pixels happen to have the same grey value
        double const change = differing(pictures[k], hidden.render(100 * k).left);
        EXPECT_LT(change, 1.12 * percent) << k;
        EXPECT_GT(change, 0.85 * percent) << k;
      }
    }
  }
}

TEST(generator_scenes, what_is_fixed_to_the_camera_stays_where_it_is) {
  using things = seq::hiding_things;
  for (auto const what : {&things::bonnet, &things::dirt}) {
    auto o = corridor();
    generator const bare(o);
    generator const hidden(with(o, what, 40));
    auto const before = hidden.render(20).left;
    auto const after = hidden.render(100).left;
    EXPECT_GT(differing(before, after), 40);
    auto const uncovered = bare.render(20).left;
    int moved = 0;
    for (std::size_t i = 0; i < before.pixels.size(); ++i) {
      bool const covered = std::abs(before.pixels[i] - uncovered.pixels[i]) > 20;
      moved += static_cast<int>(covered && std::abs(before.pixels[i] - after.pixels[i]) > 60);
    }
    EXPECT_LT(moved, 150) << "the edges alone";
  }
}

TEST(generator_scenes, the_bonnet_is_the_lower_edge_60_cm_away_in_both_images) {
  auto o = with(corridor(1), &seq::hiding_things::bonnet, 25);
  generator const g(o);
  auto const frame = g.render(0);
  auto const rows = generator(corridor(1)).render(0).left;
  for (int y = 0; y < 88; ++y) { EXPECT_EQ(frame.left.row(y)[70], rows.row(y)[70]) << y; }
  double const disparity = g.rig().left.fx * g.rig().baseline() / 0.6;
  int const left = 120;
  double const right = left - disparity;
  auto const at = static_cast<int>(std::floor(right));
  double const share = right - at;
  double error = 0;
  for (int y = 95; y < 115; ++y) {
    double const seen = (1 - share) * frame.right.row(y)[at] + share * frame.right.row(y)[at + 1];
    error += std::abs(seen - frame.left.row(y)[left]) / 20;
  }
  EXPECT_LT(error, 12) << "grey levels: interpolated";
}

TEST(generator_scenes, a_crossing_thing_moves_to_the_left_at_its_speed) {
  auto o = with(corridor(41), &seq::hiding_things::crossing, 40);
  o.speed = 0;  // not even swaying
  generator const first(o);
  double const fx = first.rig().left.fx;
  o.hiding.crossing_speed = 4 * o.fps * 2 / fx;  // 4 pixels a frame, 2 m away
  generator const g(o);
  auto const before = g.render(10).left;
  auto const after = g.render(20).left;
  for (int y = 45; y < 75; y += 5) {
    for (int x = 50; x < 150; ++x) {
      EXPECT_NEAR(after.row(y)[x - 40], before.row(y)[x], 2) << x << " " << y;
    }
  }
  EXPECT_EQ(after.row(2)[50], before.row(2)[50]) << "the rest stands still";
}

TEST(generator_scenes, options_out_of_range_are_refused) {
  double const nan = std::numeric_limits<double>::quiet_NaN();
  auto const refused = [](generator_options const& o, std::string const& says) {
    try {
      generator const g(o);
      ADD_FAILURE() << "taken: " << says;
    } catch (seq::error const& e) {
      EXPECT_NE(std::string(e.what()).find(says), std::string::npos) << e.what();
    }
  };
  auto o = corridor(2);
  o.speed = -1;
  refused(o, "speed is -1; must be 0 to 40");
  o.speed = nan;
  refused(o, "speed is nan");
  o = corridor(2);
  o.repeat = 0.1;
  refused(o, "repeat is 0.1; must be 0.2 to 100, or 0 for the default");
  o = corridor(2);
  o.look_aside = 200;
  refused(o, "look_aside is 200; must be -180 to 180");
  using things = seq::hiding_things;
  refused(with(corridor(2), &things::bonnet, 81), "hiding.bonnet is 81; must be 0 to 80");
  refused(with(corridor(2), &things::dirt, nan), "hiding.dirt is nan");
  refused(with(corridor(2), &things::companion, -1), "hiding.companion is -1");
  refused(with(corridor(2), &things::crossing, 1e9), "hiding.crossing is 1e+09");
  refused(with(corridor(2), &things::crossing_speed, 11), "hiding.crossing_speed is 11");
  o = with(corridor(2), &things::bonnet, 25);
  o.rig = seq::rig_kind::fisheye;
  refused(o, "need the pinhole rig");
}

}  // namespace
