// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/evaluation.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstddef>
#include <fstream>
#include <random>
#include <string>
#include <vector>

#include "tests/support/sequence.hpp"

namespace {

using seq_test::contains;
using seq_test::message_of;
using seq_test::temp_folder;

constexpr std::int64_t start_ns = 1'403'715'274'512'143'104;

Eigen::Isometry3d make_pose(Eigen::Vector3d const& rotation, Eigen::Vector3d const& position) {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  double const angle = rotation.norm();
  if (angle > 0) { pose.linear() = Eigen::AngleAxisd(angle, rotation / angle).toRotationMatrix(); }
  pose.translation() = position;
  return pose;
}

Eigen::Isometry3d const world_shift = make_pose({0.4, -1.1, 2.0}, {5, -3, 12});

/// A winding path of `count` poses at 20 Hz.
seq::trajectory winding_path(int count) {
  seq::trajectory poses;
  for (int i = 0; i < count; ++i) {
    double const s = 0.05 * i;
    poses.push_back({start_ns + i * std::int64_t{50'000'000},
                     make_pose({0.2 * std::sin(s), 0.3 * s, 0.1 * std::cos(2 * s)},
                               {3 * std::sin(0.4 * s), std::cos(0.7 * s), 0.5 * s})});
  }
  return poses;
}

seq::trajectory moved(seq::trajectory poses, Eigen::Isometry3d const& by) {
  for (seq::stamped_pose& p : poses) { p.T_world_camera = by * p.T_world_camera; }
  return poses;
}

bool is_rotation(Eigen::Matrix3d const& m) {
  return m.allFinite() && (m * m.transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-9 &&
         m.determinant() > 0;
}

TEST(evaluate, recovers_a_known_alignment) {
  seq::trajectory const estimate = winding_path(300);
  seq::trajectory const truth = moved(estimate, world_shift);
  for (bool const orientation : {true, false}) {
    seq::trajectory_error const e = seq::evaluate(estimate, truth, orientation);
    EXPECT_EQ(e.pairs, 300);
    EXPECT_LT((e.T_truth_estimate.matrix() - world_shift.matrix()).norm(), 1e-9);
    EXPECT_LT(e.ate_rmse_m.value(), 1e-9);
    EXPECT_LT(e.rpe_rmse_m.value(), 1e-9);
    EXPECT_NEAR(e.path_m, e.truth_path_m, 1e-9);
    EXPECT_NEAR(e.path_m, e.estimate_path_m, 1e-9);
    double path = 0;
    for (std::size_t i = 1; i < estimate.size(); ++i) {
      path +=
          (estimate[i].T_world_camera.translation() - estimate[i - 1].T_world_camera.translation())
              .norm();
    }
    EXPECT_NEAR(e.path_m, path, 1e-12);
  }
}

TEST(evaluate, planar_paths_are_not_mirrored) {
  seq::trajectory estimate = winding_path(200);
  for (seq::stamped_pose& p : estimate) { p.T_world_camera.translation().y() = 0; }
  seq::trajectory_error const e = seq::evaluate(estimate, moved(estimate, world_shift), false);
  EXPECT_LT((e.T_truth_estimate.matrix() - world_shift.matrix()).norm(), 1e-8);
}

TEST(evaluate, mirrored_truth_still_gives_a_rotation) {
  seq::trajectory const estimate = winding_path(200);
  seq::trajectory truth = estimate;
  for (seq::stamped_pose& p : truth) { p.T_world_camera.translation().x() *= -1; }
  seq::trajectory_error const e = seq::evaluate(estimate, truth, false);
  EXPECT_TRUE(is_rotation(e.T_truth_estimate.linear()));
  EXPECT_GT(e.ate_rmse_m.value(), 0.1);
}

TEST(evaluate, noise_comes_out_as_its_standard_deviation) {
  constexpr double sigma = 0.02;  // metres, each axis
  seq::trajectory const truth = winding_path(4000);
  seq::trajectory estimate = moved(truth, world_shift);
  std::mt19937 random(11);
  std::normal_distribution<double> noise(0, sigma);
  for (seq::stamped_pose& p : estimate) {
    p.T_world_camera.translation() += Eigen::Vector3d(noise(random), noise(random), noise(random));
  }
  for (bool const orientation : {true, false}) {
    seq::trajectory_error const e = seq::evaluate(estimate, truth, orientation);
    EXPECT_NEAR(e.ate_rmse_m.value(), sigma * std::sqrt(3.0), 0.03 * sigma * std::sqrt(3.0));
    // Both ends carry noise; lengths only feel its part along the motion.
    double const expected = orientation ? sigma * std::sqrt(6.0) : sigma * std::sqrt(2.0);
    EXPECT_NEAR(e.rpe_rmse_m.value(), expected, 0.1 * expected);
  }
}

TEST(evaluate, constant_drift_is_the_rpe) {
  seq::trajectory const truth = winding_path(200);
  seq::trajectory estimate = truth;
  for (std::size_t i = 0; i < estimate.size(); ++i) {  // 1 cm/s along the world's z
    estimate[i].T_world_camera.translation().z() += 0.01 * 0.05 * static_cast<double>(i);
  }
  EXPECT_NEAR(seq::evaluate(estimate, truth, true, 1.0).rpe_rmse_m.value(), 0.01, 1e-9);
  EXPECT_NEAR(seq::evaluate(estimate, truth, true, 2.0).rpe_rmse_m.value(), 0.02, 1e-9);
}

TEST(evaluate, drift_is_a_share_of_the_path) {
  seq::trajectory truth;  // 20 m straight ahead, and an estimate that is 3 % too long
  for (int i = 0; i <= 200; ++i) {
    truth.push_back({50'000'000LL * i, make_pose({0, 0, 0}, {0.1 * i, 0, 0})});
  }
  seq::trajectory estimate = truth;
  for (seq::stamped_pose& p : estimate) { p.T_world_camera.translation().x() *= 1.03; }
  EXPECT_NEAR(seq::evaluate(estimate, truth, true).drift_percent.value(), 3, 1e-6);
  EXPECT_FALSE(seq::evaluate(estimate, truth, false).drift_percent);
  truth.resize(10);  // 0.9 m: a tenth is too short to speak of a drift
  EXPECT_FALSE(seq::evaluate(estimate, truth, true).drift_percent);
}

TEST(evaluate, absolute_errors_are_told_along_the_axes_of_the_truth) {
  seq::trajectory const truth = winding_path(4000);
  seq::trajectory estimate = truth;
  std::mt19937 random(12);
  std::normal_distribution<double> noise(0, 1);
  for (seq::stamped_pose& p : estimate) {
    p.T_world_camera.translation() +=
        Eigen::Vector3d(0.01 * noise(random), 0.02 * noise(random), 0.03 * noise(random));
  }
  for (seq::trajectory const& given : {estimate, moved(estimate, world_shift)}) {
    seq::trajectory_error const e = seq::evaluate(given, truth, true);
    Eigen::Vector3d const axes = e.ate_axes_m.value();
    EXPECT_LT((axes - Eigen::Vector3d(0.01, 0.02, 0.03)).cwiseAbs().maxCoeff(), 0.0015);
    EXPECT_NEAR(axes.norm(), *e.ate_rmse_m, 1e-12);
  }
}

TEST(evaluate, a_turn_of_the_camera_in_its_mount_is_a_rotation_error_alone) {
  seq::trajectory const truth = moved(winding_path(200), world_shift);
  double const degree = std::acos(-1.0) / 180;
  seq::trajectory const estimate =
      seq::poses_of(winding_path(200), make_pose({0, 3 * degree, 0}, {0, 0, 0}));
  seq::trajectory_error const e = seq::evaluate(estimate, truth, true);
  EXPECT_LT(*e.ate_rmse_m, 1e-9);
  EXPECT_NEAR(*e.ate_rotation_rmse_deg, 3, 1e-9);
  // without orientations nothing is said of them
  seq::trajectory_error const positions = seq::evaluate(estimate, truth, false);
  EXPECT_FALSE(positions.ate_rotation_rmse_deg);
  EXPECT_FALSE(positions.rpe_rotation_rmse_deg);
  EXPECT_TRUE(positions.ate_rmse_m);
}

/// A path of 2 mm says nothing of how to turn it: an error of a millimetre turns it about.
TEST(evaluate, a_rotation_that_positions_do_not_determine_is_not_told) {
  std::mt19937 random(7);
  std::normal_distribution<double> noise(0, 1);
  auto const jittered = [&](seq::trajectory poses, double sigma) {
    for (auto& p : poses) {
      p.T_world_camera.translation() +=
          sigma * Eigen::Vector3d(noise(random), noise(random), noise(random));
    }
    return poses;
  };
  seq::trajectory still = winding_path(200);
  for (auto& p : still) { p.T_world_camera = Eigen::Isometry3d::Identity(); }
  auto const lost = seq::evaluate(jittered(still, 5e-4), jittered(still, 5e-4), true);
  EXPECT_FALSE(lost.ate_rotation_rmse_deg);
  EXPECT_NE(lost.ate_rotation_missing.find("not determined"), std::string::npos);
  EXPECT_NE(lost.ate_rotation_missing.find(" m in the weaker direction"), std::string::npos);
  EXPECT_NEAR(*lost.ate_rmse_m, 5e-4 * std::sqrt(6.0), 1e-4);
  EXPECT_TRUE(lost.rpe_rotation_rmse_deg);  // it needs no alignment
  // Straight with noise: what turns about the line is the noise.
  seq::trajectory straight = still;
  for (std::size_t i = 0; i < straight.size(); ++i) {
    straight[i].T_world_camera.translation().x() = 0.1 * static_cast<double>(i);
  }
  EXPECT_FALSE(seq::evaluate(jittered(straight, 0.01), jittered(straight, 0.01), true)
                   .ate_rotation_rmse_deg);
  // An error along the line says nothing about it.
  seq::trajectory wide = straight;
  for (std::size_t i = 0; i < wide.size(); ++i) {
    wide[i].T_world_camera.translation().y() = 0.05 * std::sin(0.1 * static_cast<double>(i));
  }
  seq::trajectory longer = wide;
  for (auto& p : longer) { p.T_world_camera.translation().x() *= 1.05; }
  auto const along = seq::evaluate(longer, wide, true);
  EXPECT_GT(*along.ate_rmse_m, 0.1);
  EXPECT_LT(along.ate_rotation_rmse_deg.value(), 0.1);
  // Where the positions coincide, or lie on a line exactly, the orientations tell.
  EXPECT_NEAR(*seq::evaluate(still, still, true).ate_rotation_rmse_deg, 0, 1e-9);
  EXPECT_NEAR(*seq::evaluate(straight, straight, true).ate_rotation_rmse_deg, 0, 1e-9);
  // A path wider than its error.
  auto const path = winding_path(200);
  auto const good = seq::evaluate(jittered(path, 0.01), path, true);
  EXPECT_LT(good.ate_rotation_rmse_deg.value(), 2);
  EXPECT_EQ(good.ate_rotation_missing, "");
  // Without orientations nothing is missing.
  EXPECT_EQ(seq::evaluate(jittered(still, 5e-4), still, false).ate_rotation_missing, "");
}

TEST(evaluate, a_steady_turn_is_the_relative_rotation_error) {
  seq::trajectory const truth = winding_path(200);
  seq::trajectory estimate = truth;
  double const degree = std::acos(-1.0) / 180;
  for (std::size_t i = 0; i < estimate.size(); ++i) {  // 0.1 degrees a frame, 20 frames a second
    Eigen::Isometry3d const turn =
        make_pose({0, 0, 0.1 * degree * static_cast<double>(i)}, {0, 0, 0});
    estimate[i].T_world_camera = turn * truth[i].T_world_camera;
  }
  seq::trajectory_error const e = seq::evaluate(estimate, truth, true);
  EXPECT_NEAR(*e.rpe_rotation_rmse_deg, 2, 1e-9);
}

TEST(evaluate, the_span_of_relative_errors_is_one_number_or_none) {
  seq::trajectory const truth = winding_path(100);
  EXPECT_EQ(seq::evaluate(truth, truth, true).rpe_span, 20);
  EXPECT_EQ(seq::evaluate(truth, truth, true, 0.5).rpe_span, 10);
  seq::trajectory gap = truth;
  gap.erase(gap.begin() + 40, gap.begin() + 45);
  EXPECT_TRUE(seq::evaluate(gap, truth, true).rpe_rmse_m);
  EXPECT_FALSE(seq::evaluate(gap, truth, true).rpe_span);
  gap = truth;
  gap.erase(gap.begin() + 10, gap.begin() + 90);  // no pair that is a second apart
  EXPECT_FALSE(seq::evaluate(gap, truth, true).rpe_span);
}

TEST(evaluate, static_paths_are_well_defined) {
  seq::trajectory truth = winding_path(50);
  for (seq::stamped_pose& p : truth) { p.T_world_camera = make_pose({0.1, 0.2, 0.3}, {1, 2, 3}); }
  std::mt19937 random(2);
  std::normal_distribution<double> tiny(0, 1e-8);
  for (bool const jitter : {false, true}) {
    seq::trajectory estimate = moved(truth, world_shift.inverse());
    for (seq::stamped_pose& p : estimate) {
      if (jitter) {
        p.T_world_camera.translation() += Eigen::Vector3d(tiny(random), tiny(random), tiny(random));
      }
    }
    seq::trajectory_error const e = seq::evaluate(estimate, truth, true);
    // Orientations decide where positions cannot.
    EXPECT_LT((e.T_truth_estimate.matrix() - world_shift.matrix()).norm(), 1e-5);
    EXPECT_LT(e.ate_rmse_m.value(), 1e-6);
    EXPECT_LT(e.rpe_rmse_m.value(), 1e-6);
    seq::trajectory_error const positions = seq::evaluate(estimate, truth, false);
    EXPECT_TRUE(is_rotation(positions.T_truth_estimate.linear()));
    EXPECT_LT(positions.ate_rmse_m.value(), 1e-6);
  }
  // The estimate stands still, the truth moves.
  seq::trajectory const path = winding_path(50);
  seq::trajectory_error const e = seq::evaluate(truth, path, false);
  EXPECT_TRUE(is_rotation(e.T_truth_estimate.linear()));
  EXPECT_TRUE(std::isfinite(e.ate_rmse_m.value()));
}

TEST(evaluate, collinear_paths_are_well_defined) {
  seq::trajectory estimate = winding_path(100);
  for (std::size_t i = 0; i < estimate.size(); ++i) {
    estimate[i].T_world_camera =
        make_pose({0.3, 0, 0.1}, Eigen::Vector3d(1, -2, 0.5) * (0.1 * static_cast<double>(i)));
  }
  seq::trajectory const truth = moved(estimate, world_shift);
  seq::trajectory_error const with = seq::evaluate(estimate, truth, true);
  EXPECT_LT((with.T_truth_estimate.matrix() - world_shift.matrix()).norm(), 1e-7);
  seq::trajectory_error const without = seq::evaluate(estimate, truth, false);
  EXPECT_TRUE(is_rotation(without.T_truth_estimate.linear()));
  EXPECT_LT(without.ate_rmse_m.value(), 1e-7);
  // Opposite directions: half a turn.
  seq::trajectory reversed = estimate;
  for (seq::stamped_pose& p : reversed) { p.T_world_camera.translation() *= -1; }
  seq::trajectory_error const half_turn = seq::evaluate(estimate, reversed, false);
  EXPECT_TRUE(is_rotation(half_turn.T_truth_estimate.linear()));
  EXPECT_LT(half_turn.ate_rmse_m.value(), 1e-7);
}

TEST(evaluate, few_pairs_and_no_overlap) {
  seq::trajectory const path = winding_path(40);
  seq::trajectory_error const none = seq::evaluate({}, path, true);
  EXPECT_EQ(none.pairs, 0);
  EXPECT_FALSE(none.ate_rmse_m || none.rpe_rmse_m);
  EXPECT_EQ(none.path_m, 0);
  seq::trajectory_error const no_truth = seq::evaluate(path, {}, true);
  EXPECT_EQ(no_truth.pairs, 0);
  EXPECT_GT(no_truth.path_m, 0);
  EXPECT_EQ(no_truth.T_truth_estimate.matrix(), Eigen::Matrix4d::Identity());
  for (int n : {1, 2}) {
    seq::trajectory const few(path.begin(), path.begin() + n);
    seq::trajectory_error const e = seq::evaluate(few, path, true);
    EXPECT_EQ(e.pairs, n);
    EXPECT_FALSE(e.ate_rmse_m.has_value());
    EXPECT_TRUE(is_rotation(e.T_truth_estimate.linear()));
  }
  // Three pairs within 0.1 s: an ATE, no pair one second apart.
  seq::trajectory const three(path.begin(), path.begin() + 3);
  EXPECT_TRUE(seq::evaluate(three, path, true).ate_rmse_m.has_value());
  EXPECT_FALSE(seq::evaluate(three, path, true).rpe_rmse_m.has_value());
  EXPECT_TRUE(seq::evaluate(three, path, true, 0.1).rpe_rmse_m.has_value());
}

TEST(evaluate, path_counts_all_poses_and_pairs_only_those_with_truth) {
  seq::trajectory const path = winding_path(40);
  seq::trajectory const late(path.begin() + 20, path.end());
  seq::trajectory_error const e = seq::evaluate(path, late, true);
  EXPECT_EQ(e.pairs, 20);
  EXPECT_GT(e.path_m, 1.5 * e.estimate_path_m);
  EXPECT_NEAR(e.truth_path_m, e.estimate_path_m, 1e-9);
}

TEST(evaluate, rejects_bad_input) {
  seq::trajectory const path = winding_path(10);
  seq::trajectory bad = path;
  bad[3].T_world_camera.translation().x() = std::nan("");
  EXPECT_TRUE(contains(message_of([&] { seq::evaluate(bad, path, true); }), "pose 3"));
  EXPECT_TRUE(contains(message_of([&] { seq::evaluate(path, bad, true); }), "ground truth"));
  bad = path;
  bad[4].time_ns = bad[3].time_ns;
  EXPECT_TRUE(contains(message_of([&] { seq::evaluate(bad, path, true); }), "must increase"));
  EXPECT_THROW(seq::evaluate(path, path, true, 0), seq::error);
  EXPECT_THROW(seq::evaluate(path, path, true, std::nan("")), seq::error);
}

TEST(interpolate, between_samples_at_them_and_outside) {
  seq::trajectory const path{
      {1'000'000'000, make_pose({0, 0, 0}, {0, 0, 0})},
      {1'400'000'000, make_pose({0, 0, 0.8}, {4, -8, 2})},
      {2'400'000'000, make_pose({0, 0, 0.8}, {5, 5, 5})},
  };
  Eigen::Isometry3d const middle = seq::interpolate(path, 1'100'000'000).value();
  EXPECT_LT((middle.matrix() - make_pose({0, 0, 0.2}, {1, -2, 0.5}).matrix()).norm(), 1e-12);
  EXPECT_EQ(seq::interpolate(path, 1'000'000'000)->matrix(), path[0].T_world_camera.matrix());
  EXPECT_EQ(seq::interpolate(path, 2'400'000'000)->matrix(), path[2].T_world_camera.matrix());
  EXPECT_FALSE(seq::interpolate(path, 999'999'999).has_value());
  EXPECT_FALSE(seq::interpolate(path, 2'400'000'001).has_value());
  EXPECT_FALSE(seq::interpolate(path, 1'900'000'000).has_value());  // gap of one second
  EXPECT_TRUE(seq::interpolate(path, 1'900'000'000, 1'000'000'000).has_value());
  EXPECT_FALSE(seq::interpolate({}, 5).has_value());
}

TEST(interpolate, takes_the_short_way_round) {
  seq::trajectory const path{{0, make_pose({0, 0, 3.0}, {0, 0, 0})},
                             {100, make_pose({0, 0, -3.0}, {0, 0, 0})}};
  Eigen::Isometry3d const middle = seq::interpolate(path, 50).value();
  EXPECT_LT((middle.matrix() - make_pose({0, 0, 3.14159265358979}, {0, 0, 0}).matrix()).norm(),
            1e-9);
}

TEST(tum, written_poses_are_read_back) {
  temp_folder const folder;
  seq::trajectory const path = moved(winding_path(100), world_shift);
  std::string const file = folder.path("trajectory.txt");
  seq::write_tum(file, path);
  seq::trajectory const back = seq::read_tum(file);
  ASSERT_EQ(back.size(), path.size());
  for (std::size_t i = 0; i < path.size(); ++i) {
    EXPECT_EQ(back[i].time_ns, path[i].time_ns);
    EXPECT_LT((back[i].T_world_camera.matrix() - path[i].T_world_camera.matrix()).norm(), 1e-8);
  }
}

TEST(tum, the_comment_says_whose_poses_they_are) {
  temp_folder const folder;
  seq::write_tum(folder.path("t.txt"), winding_path(1), "body");
  std::ifstream file(folder.path("t.txt"));
  std::string first;
  std::getline(file, first);
  EXPECT_TRUE(contains(first, "body to world"));
}

TEST(kitti_poses, are_the_upper_rows_of_the_matrix) {
  temp_folder const folder;
  seq::trajectory const poses = winding_path(5);
  seq::write_kitti_poses(folder.path("poses.txt"), poses);
  std::ifstream file(folder.path("poses.txt"));
  for (seq::stamped_pose const& pose : poses) {
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 4; ++column) {
        double value = 0;
        file >> value;
        EXPECT_NEAR(value, pose.T_world_camera.matrix()(row, column), 1e-8);
      }
    }
  }
  std::string rest;
  EXPECT_FALSE(file >> rest);

  seq::trajectory broken = poses;
  broken[2].T_world_camera.translation().x() = std::nan("");
  EXPECT_TRUE(contains(
      message_of([&] { seq::write_kitti_poses(folder.path("broken.txt"), broken); }), "finite"));
  EXPECT_TRUE(contains(
      message_of([&] { seq::write_kitti_poses(folder.path("no/such/file"), poses); }), "no/such"));
}

TEST(trajectories, at_times_of_leaves_out_what_has_no_reference) {
  seq::trajectory const reference = winding_path(10);
  seq::trajectory asked{reference[3], reference[7]};
  asked[0].time_ns += 25'000'000;  // halfway to the next
  asked.push_back({start_ns + 60'000'000'000, {}});
  seq::trajectory const found = seq::at_times_of(asked, reference);
  ASSERT_EQ(found.size(), 2u);
  EXPECT_EQ(found[0].time_ns, asked[0].time_ns);
  Eigen::Vector3d const middle =
      (reference[3].T_world_camera.translation() + reference[4].T_world_camera.translation()) / 2;
  EXPECT_LT((found[0].T_world_camera.translation() - middle).norm(), 1e-12);
  EXPECT_TRUE(found[1].T_world_camera.isApprox(reference[7].T_world_camera));
}

TEST(scale, is_found_whatever_the_worlds_are) {
  seq::trajectory truth, estimate;
  Eigen::Isometry3d moved = Eigen::Isometry3d::Identity();
  moved.linear() = Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  moved.translation() = Eigen::Vector3d(4, -5, 6);
  for (int i = 0; i < 20; ++i) {
    double const t = 0.3 * i;
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.translation() = Eigen::Vector3d(std::sin(t), t, 0.2 * t * t);
    truth.push_back({i * 100'000'000LL, moved * pose});
    pose.translation() *= 0.25;
    // Poses without ground truth are left out.
    estimate.push_back({(i - 2) * 100'000'000LL, pose});
  }
  EXPECT_FALSE(seq::scale_to({estimate.begin(), estimate.begin() + 4}, truth));
  for (auto& pose : estimate) { pose.time_ns += 200'000'000; }
  auto const scale = seq::scale_to(estimate, truth);
  ASSERT_TRUE(scale.has_value());
  EXPECT_NEAR(*scale, 4.0, 1e-9);
  EXPECT_NEAR(*seq::evaluate(seq::scaled(estimate, *scale), truth, false).ate_rmse_m, 0.0, 1e-9);

  for (auto& pose : estimate) { pose.T_world_camera.translation().setZero(); }
  EXPECT_FALSE(seq::scale_to(estimate, truth)) << "a path of no length has every scale";
}

TEST(scale, is_not_told_where_one_of_them_stands_still_anywhere) {
  seq::trajectory const walk = winding_path(10);
  for (double const x : {0.0, 1.0, 0.1, 1e3 / 3}) {
    seq::trajectory still = walk;
    for (seq::stamped_pose& p : still) {
      p.T_world_camera.translation() = Eigen::Vector3d(x, -x, x / 7);
    }
    EXPECT_FALSE(seq::scale_to(walk, still)) << x;
    EXPECT_FALSE(seq::scale_to(still, walk)) << x;
  }
}

TEST(tum, reads_comments_order_and_formats) {
  temp_folder const folder;
  seq::trajectory const poses = seq::read_tum(
      folder.write("t.txt",
                   "\xEF\xBB\xBF# time ...\r\n\r\n1.5 1 2 3 0 0 0 1\r\n  # more\n"
                   "5e-1\t-1e0 2 3 0 0 0 -1 \n1403715274.512143104 0 0 0 0.0 1 0 0\n"));
  ASSERT_EQ(poses.size(), 3U);
  EXPECT_EQ(poses[0].time_ns, 500'000'000);
  EXPECT_EQ(poses[0].T_world_camera.translation().x(), -1);
  EXPECT_EQ(poses[0].T_world_camera.linear(), Eigen::Matrix3d::Identity());
  EXPECT_EQ(poses[1].time_ns, 1'500'000'000);
  EXPECT_EQ(poses[2].time_ns, start_ns);
  EXPECT_EQ(poses[2].T_world_camera.linear()(0, 0), -1);
}

TEST(tum, bad_lines_are_named) {
  temp_folder const folder;
  for (auto const& [text, expected] : std::vector<std::pair<std::string, std::string>>{
           {"1 2 3\n", ":1: 3 numbers"},
           {"# c\n1 1 2 3 0 0 0 1 9\n", ":2: 9 numbers"},
           {"1 1 2 x 0 0 0 1\n", ":1: 'x' is not a number"},
           {"1 1 2 nan 0 0 0 1\n", ":1: 'nan' is not finite"},
           {"nan 1 2 3 0 0 0 1\n", ":1: time nan"},
           {"1403715274512143104 1 2 3 0 0 0 1\n", "nanoseconds?"},
           {"1 1 2 3 0 0 0 0\n", ":1: quaternion norm is 0"},
       }) {
    std::string const path = folder.write("t.txt", text);
    std::string const message = message_of([&] { seq::read_tum(path); });
    EXPECT_TRUE(contains(message, expected) && contains(message, path)) << message;
  }
  EXPECT_TRUE(contains(message_of([&] { seq::read_tum(folder.path("none")); }), "no such file"));
  EXPECT_TRUE(contains(message_of([&] { seq::read_tum(folder.path()); }), "no such file"));
  EXPECT_TRUE(seq::read_tum(folder.write("empty.txt", "")).empty());
  EXPECT_THROW(seq::write_tum(folder.path("none/t.txt"), {}), seq::error);
  seq::trajectory bad = winding_path(1);
  bad[0].T_world_camera.translation().x() = std::nan("");
  EXPECT_THROW(seq::write_tum(folder.path("bad.txt"), bad), seq::error);
}

}  // namespace
