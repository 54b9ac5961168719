// SPDX-License-Identifier: Apache-2.0
/// @file The half of examples/ros2 that knows nothing of ROS.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

#include "examples/ros2/include/ft_ros2/base_frame.hpp"
#include "examples/ros2/include/ft_ros2/health.hpp"
#include "examples/ros2/include/ft_ros2/images.hpp"
#include "examples/ros2/include/ft_ros2/quaternions.hpp"
#include "examples/ros2/include/ft_ros2/tracker.hpp"
#include "examples/sequence/generator.hpp"
#include "examples/sequence/grey.hpp"

namespace ros2_tracker_test {

using ft_ros2::base_frame;
using ft_ros2::estimate;
using ft_ros2::rigid;

Eigen::Isometry3d eigen_of(ft_ros2::transform const& T) {
  Eigen::Isometry3d e = Eigen::Isometry3d::Identity();
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) { e.linear()(r, c) = T.R[static_cast<std::size_t>(3 * r + c)]; }
    e.translation()(r) = T.t[static_cast<std::size_t>(r)];
  }
  return e;
}
ft_ros2::transform plain(Eigen::Isometry3d const& T) {
  ft_ros2::transform p;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) { p.R[static_cast<std::size_t>(3 * r + c)] = T.linear()(r, c); }
    p.t[static_cast<std::size_t>(r)] = T.translation()(r);
  }
  return p;
}
rigid ft_of(Eigen::Isometry3d const& T) { return ft_ros2::rigid_of(plain(T)); }

Eigen::Isometry3d pose(Eigen::Vector3d const& turn, Eigen::Vector3d const& t) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  double const angle = turn.norm();
  if (angle > 0) { T.linear() = Eigen::AngleAxisd(angle, turn / angle).toRotationMatrix(); }
  T.translation() = t;
  return T;
}

/// A camera that looks forward from a place on a robot: x right, y down, z forward.
Eigen::Isometry3d mounted() {
  Eigen::Isometry3d T = pose({0, 0, 0}, {0.3, 0.05, 0.2});
  T.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  return T;
}

// ---- poses of the base

TEST(BaseFrame, CarriesTheCamera) {
  base_frame base(plain(mounted()));
  // The base drives 2 m ahead and turns left by 90 degrees: the camera moves with it.
  Eigen::Isometry3d const T_odom_base = pose({0, 0, M_PI / 2}, {2, 0, 0});
  Eigen::Isometry3d const T_world_camera = mounted().inverse() * T_odom_base * mounted();
  estimate e;
  std::array<double, 36> const none{};
  base.take(ft_of(T_world_camera), none.data(), 1000, e);
  EXPECT_LT((eigen_of(e.T_odom_base).matrix() - T_odom_base.matrix()).norm(), 1e-12);
  EXPECT_FALSE(e.moving_known);
}

TEST(BaseFrame, VelocitiesAreThoseOfTheBase) {
  base_frame base(plain(mounted()));
  std::array<double, 36> const none{};
  double const rate = 0.8;   // rad/s about the vertical
  double const speed = 1.5;  // m/s ahead, on a circle
  estimate e;
  for (int i = 0; i < 3; ++i) {
    double const a = rate * 0.001 * i;
    Eigen::Isometry3d const T =
        pose({0, 0, a}, {speed / rate * std::sin(a), speed / rate * (1 - std::cos(a)), 0});
    base.take(ft_of(mounted().inverse() * T * mounted()), none.data(), 1'000'000 * i, e);
  }
  ASSERT_TRUE(e.moving_known);
  EXPECT_NEAR(e.linear[0], speed, 1e-3);
  EXPECT_NEAR(e.linear[1], 0, 1e-3);
  EXPECT_NEAR(e.angular[0], 0, 1e-6);
  EXPECT_NEAR(e.angular[2], rate, 1e-6);
  base.skip();
  estimate after;
  base.take(rigid::identity(), none.data(), 5'000'000, after);
  EXPECT_FALSE(after.moving_known);
}

// Each column of the map from twists to the base's errors, by finite differences.
TEST(BaseFrame, CovarianceIsMovedToTheBase) {
  Eigen::Isometry3d const T = pose({0.3, -0.5, 0.8}, {1, -2, 0.5});
  Eigen::Matrix<double, 6, 6> A = Eigen::Matrix<double, 6, 6>::Zero();
  for (int i = 0; i < 36; ++i) { A(i / 6, i % 6) = std::sin(1.0 + i); }
  Eigen::Matrix<double, 6, 6> const C = A * A.transpose();
  auto const base_of = [](Eigen::Isometry3d const& T_wc) {
    return Eigen::Isometry3d(mounted() * T_wc * mounted().inverse());
  };
  double const h = 1e-6;
  Eigen::Matrix<double, 6, 6> J;
  for (int k = 0; k < 6; ++k) {
    Eigen::Matrix<double, 6, 1> x = Eigen::Matrix<double, 6, 1>::Zero();
    x(k) = h;
    Eigen::Isometry3d const moved = base_of(T * pose(x.head<3>(), x.tail<3>()));
    J.block<3, 1>(0, k) = (moved.translation() - base_of(T).translation()) / h;
    Eigen::AngleAxisd const turn(moved.linear() * base_of(T).linear().transpose());
    J.block<3, 1>(3, k) = turn.angle() * turn.axis() / h;
  }
  Eigen::Matrix<double, 6, 6> const wanted = J * C * J.transpose();
  Eigen::Matrix<double, 6, 6, Eigen::RowMajor> const given = C;
  base_frame base(plain(mounted()));
  estimate e;
  base.take(ft_of(T), given.data(), 1000, e);
  for (int i = 0; i < 36; ++i) {
    EXPECT_NEAR(e.covariance[static_cast<std::size_t>(i)], wanted(i / 6, i % 6),
                1e-4 * wanted.norm());
  }
}

TEST(BaseFrame, CorrectionsOfTheCamerasWorldAreThoseOfOdom) {
  base_frame const base(plain(mounted()));
  // The camera's world is corrected by B^-1 C B where odom is by C.
  Eigen::Isometry3d const C = pose({0.1, -0.2, 0.7}, {1, 2, -0.5});
  auto const given = base.correction(ft_of(mounted().inverse() * C * mounted()));
  EXPECT_LT((eigen_of(given).matrix() - C.matrix()).norm(), 1e-12);
}

// ---- diagnostics

TEST(Health, SaysWhatWasSinceTheLastReport) {
  ft_ros2::health_counter counter;
  EXPECT_EQ(counter.report().level, ft_ros2::health::error);
  estimate good;
  good.tracked = true;
  good.inliers = 120;
  counter.take(good, 4);
  counter.take(good, 6);
  auto const fine = counter.report();
  EXPECT_EQ(fine.level, ft_ros2::health::ok);
  EXPECT_EQ(fine.message, "tracking");
  auto const value = [](ft_ros2::health const& h, std::string const& name) {
    for (auto const& [key, text] : h.values) {
      if (key == name) { return text; }
    }
    return std::string();
  };
  EXPECT_EQ(value(fine, "frames"), "2");
  EXPECT_EQ(std::stod(value(fine, "milliseconds a frame")), 5);
  EXPECT_EQ(value(fine, "inliers"), "120");
  EXPECT_EQ(value(fine, "maps begun"), "0");
  EXPECT_EQ(value(fine, "IMU"), "");  // there is none
  estimate begun = good;
  begun.map_begun = true;
  begun.imu_state = "initialising: few keyframes";
  counter.take(begun, 5);
  begun.map_begun = false;
  counter.take(begun, 5);
  auto const again = counter.report();
  EXPECT_EQ(value(again, "maps begun"), "1");
  EXPECT_EQ(value(again, "IMU"), "initialising: few keyframes");
  estimate doubtful = good;
  doubtful.warning = "blurred: why";
  counter.take(doubtful, 5);
  auto const doubted = counter.report();
  EXPECT_EQ(doubted.level, ft_ros2::health::warning);
  EXPECT_NE(doubted.message.find("blurred"), std::string::npos);
  estimate lost;
  lost.reason = "the image is dark";
  counter.take(good, 5);
  counter.take(lost, 5);
  EXPECT_EQ(counter.report().message, "frames without a pose: the image is dark");
  counter.take(lost, 5);
  auto const none = counter.report();
  EXPECT_EQ(none.level, ft_ros2::health::error);
  EXPECT_EQ(none.message, "the camera is not tracked: the image is dark");
  counter.refuse("an image has another size");
  ft_ros2::health const refused = counter.report();
  EXPECT_EQ(refused.message, "an image has another size");
  EXPECT_EQ(refused.level, ft_ros2::health::error);
  counter.refuse("an image has another size");
  counter.take(good, 5);
  ft_ros2::health const beside = counter.report();
  EXPECT_EQ(beside.message, "an image has another size");
  EXPECT_EQ(beside.level, ft_ros2::health::warning);
  estimate rejected = good;
  rejected.imu_warning = "samples are missing";
  for (int i = 0; i < 3; ++i) { counter.take(rejected, 5); }
  EXPECT_EQ(value(counter.report(), "warning"), "samples are missing");
  rejected.warning = "blurred: why";
  for (int i = 0; i < 2; ++i) { counter.take(rejected, 5); }
  EXPECT_EQ(value(counter.report(), "warning"), "blurred: why; samples are missing");
  EXPECT_EQ(counter.report().message, "no images");
}

// ---- messages

// About every axis by small angles, by half a turn and almost so: all four branches.
TEST(Quaternions, AreThoseOfTheMatrix) {
  for (double const angle : {0.0, 1e-9, 0.3, 2.0, 3.1, M_PI}) {
    for (Eigen::Vector3d axis :
         {Eigen::Vector3d(1, 0.1, 0), Eigen::Vector3d(0, -1, 0.2), Eigen::Vector3d(0.1, 0.2, 1)}) {
      axis.normalize();
      Eigen::Quaterniond const wanted(Eigen::AngleAxisd(angle, axis));
      auto const R = plain(pose(angle * axis, {0, 0, 0})).R;
      auto const q = ft_ros2::quaternion_of(R);
      double const agreement =
          q[0] * wanted.x() + q[1] * wanted.y() + q[2] * wanted.z() + q[3] * wanted.w();
      EXPECT_NEAR(std::abs(agreement), 1, 1e-12) << angle;  // the sign is free
      auto const back = ft_ros2::matrix_of(q);
      for (std::size_t i = 0; i < 9; ++i) { EXPECT_NEAR(back[i], R[i], 1e-12) << angle; }
    }
  }
}

TEST(Images, BecomeGrey) {
  std::vector<std::uint8_t> const padded{10, 20, 30, 40, 50, 60, 0, 0,  //
                                         70, 80, 90, 1,  2,  3,  0, 0};
  std::vector<std::uint8_t> grey;
  ft_ros2::to_grey({padded.data(), padded.size(), 2, 2, 8}, "rgb8", grey);
  EXPECT_EQ(grey, (std::vector<std::uint8_t>{seq::grey_of(10, 20, 30), seq::grey_of(40, 50, 60),
                                             seq::grey_of(70, 80, 90), seq::grey_of(1, 2, 3)}));
  ft_ros2::to_grey({padded.data(), padded.size(), 2, 2, 8}, "bgr8", grey);
  EXPECT_EQ(grey[0], seq::grey_of(30, 20, 10));
  ft_ros2::to_grey({padded.data(), padded.size(), 2, 2, 8}, "mono8", grey);
  EXPECT_EQ(grey, (std::vector<std::uint8_t>{10, 20, 70, 80}));
  ft_ros2::to_grey({padded.data(), padded.size(), 2, 2, 8}, "bgra8", grey);
  EXPECT_EQ(grey[1], seq::grey_of(0, 60, 50));
}

TEST(Images, ThatCannotBeAreRefused) {
  std::vector<std::uint8_t> const bytes(16), small(15);
  std::vector<std::uint8_t> grey;
  EXPECT_THROW(ft_ros2::to_grey({bytes.data(), 16, 4, 4, 4}, "mono16", grey), std::runtime_error);
  EXPECT_THROW(ft_ros2::to_grey({bytes.data(), 16, 4, 4, 3}, "mono8", grey), std::runtime_error);
  EXPECT_THROW(ft_ros2::to_grey({small.data(), 15, 4, 4, 4}, "mono8", grey), std::runtime_error);
  EXPECT_THROW(ft_ros2::to_grey({bytes.data(), 16, 0, 4, 4}, "mono8", grey), std::runtime_error);
  EXPECT_NO_THROW(ft_ros2::to_grey({bytes.data(), 16, 4, 4, 4}, "mono8", grey));
}

TEST(CameraInfo, SaysThePair) {
  ft_ros2::projection_info const left{752, 480, {435, 0, 367, 0, 0, 436, 252, 0, 0, 0, 1, 0}};
  ft_ros2::projection_info right = left;
  right.P[3] = -435 * 0.11;
  auto const pair = ft_ros2::pair_of(752, 480, left, right);
  EXPECT_EQ(pair.fy, 436);
  EXPECT_NEAR(pair.baseline, 0.11, 1e-12);
  EXPECT_THROW(ft_ros2::pair_of(752, 480, left, left), std::runtime_error);   // no baseline
  EXPECT_THROW(ft_ros2::pair_of(752, 480, right, left), std::runtime_error);  // exchanged
  EXPECT_THROW(ft_ros2::pair_of(752, 480, {752, 480, {}}, right), std::runtime_error);
  EXPECT_THROW(ft_ros2::pair_of(376, 240, left, right), std::runtime_error);  // binned images
  right.P[2] += 5;
  EXPECT_THROW(ft_ros2::pair_of(752, 480, left, right), std::runtime_error);  // not rectified
}

// ---- all of it

TEST(Tracker, FollowsAGeneratedRobot) {
  seq::generator_options options;
  options.width = 320;
  options.height = 208;
  options.frames = 12;
  seq::generator const source(options);
  ft_ros2::tracker_settings settings;
  auto const& camera = source.rig().left;
  settings.pair = {camera.width, camera.height,          camera.fx, camera.fy, camera.cx,
                   camera.cy,    source.rig().baseline()};
  settings.T_base_camera = plain(mounted());
  settings.features = 400;
  settings.threads = 1;
  ft_ros2::tracker tracker(settings);
  Eigen::Isometry3d const first = source.T_world_camera(0);
  for (int i = 0; i < source.size(); ++i) {
    seq::stereo_frame const frame = source.render(i);
    estimate const e =
        tracker.track(frame.left.pixels.data(), frame.right.pixels.data(), frame.time_ns);
    ASSERT_TRUE(e.tracked) << i;
    EXPECT_EQ(e.moving_known, i > 0);
    EXPECT_EQ(e.map_begun, i == 0);
    EXPECT_EQ(e.map_id, 1);
    EXPECT_EQ(e.imu_state, "");
    Eigen::Isometry3d const truth =
        mounted() * first.inverse() * source.T_world_camera(i) * mounted().inverse();
    EXPECT_LT((eigen_of(e.T_odom_base).translation() - truth.translation()).norm(), 0.02) << i;
    EXPECT_EQ(e.map_points >= 50, i > 0);  // the first frame begins the map
    EXPECT_EQ(e.inliers > 15, i > 0);
    EXPECT_EQ(e.keyframe || i > 0, true);
  }
  seq::stereo_frame const frame = source.render(0);
  EXPECT_THROW(tracker.track(frame.left.pixels.data(), frame.right.pixels.data(), frame.time_ns),
               std::runtime_error);  // goes back in time
  std::vector<std::uint8_t> const black(frame.left.pixels.size());
  EXPECT_FALSE(tracker.track(black.data(), black.data(), source.time_ns(11) + 50'000'000).tracked);
}

TEST(Tracker, SaysWhatIsWrongWithTheImu) {
  ft_ros2::tracker_settings settings;
  settings.pair = {320, 208, 200, 200, 160, 104, 0.1};
  settings.imu.emplace();  // 200 Hz
  settings.threads = 1;
  std::vector<std::uint8_t> const grey(320 * 208, 90);
  std::array<double, 3> const up = {0, -9.81, 0};
  auto const warning_after = [&](std::int64_t step_ns, double strange) {
    ft_ros2::tracker tracker(settings);
    std::int64_t const end = 1'000'000'000;
    for (std::int64_t t = step_ns; t <= end; t += step_ns) {
      tracker.add_imu(t, t == 40 * step_ns ? std::array<double, 3>{strange, 0, 0} : up, {0, 0, 0});
    }
    estimate const e = tracker.track(grey.data(), grey.data(), end);
    EXPECT_EQ(e.imu_state.rfind("initialising: ", 0), 0u) << e.imu_state;
    return e.imu_warning;
  };
  EXPECT_EQ(warning_after(5'000'000, 1), "");
  std::string const slow = warning_after(20'000'000, 1);
  EXPECT_EQ(slow, "samples of the IMU come at 50 Hz, rate_hz says 200");
  std::string const both = warning_after(20'000'000, 1e7);
  EXPECT_EQ(both.rfind("samples of the IMU come at 50 Hz, rate_hz says 200; ", 0), 0u) << both;
  EXPECT_NE(both.find("left out: 1 that are not finite"), std::string::npos) << both;
}

}  // namespace ros2_tracker_test
