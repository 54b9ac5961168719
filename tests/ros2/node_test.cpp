// SPDX-License-Identifier: Apache-2.0
/// @file The ROS 2 node of examples/ros2, with stand-ins for ROS.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "examples/ros2/src/stereo_node.cpp"
#include "examples/sequence/generator.hpp"

namespace ros2_node_test {

using diagnostic_msgs::msg::DiagnosticArray;
using nav_msgs::msg::Odometry;
using nav_msgs::msg::Path;
using sensor_msgs::msg::CameraInfo;
using sensor_msgs::msg::Image;
using sensor_msgs::msg::Imu;

constexpr std::int64_t period_ns = 50'000'000;
constexpr std::int64_t begin_ns = 7'000'000'000;

seq::generator const& walk() {
  static seq::generator const made([] {
    seq::generator_options options;
    options.width = 320;
    options.height = 208;
    options.frames = 12;
    return options;
  }());
  return made;
}

std_msgs::msg::Header header(std::int64_t time_ns, std::string const& frame) {
  return {{static_cast<std::int32_t>(time_ns / 1'000'000'000),
           static_cast<std::uint32_t>(time_ns % 1'000'000'000)},
          frame};
}

Image message(seq::image const& from, std::int64_t time_ns) {
  Image m;
  m.header = header(time_ns, "left_optical");
  m.width = static_cast<std::uint32_t>(from.width);
  m.height = static_cast<std::uint32_t>(from.height);
  m.step = m.width;
  m.encoding = "mono8";
  m.data = from.pixels;
  return m;
}

CameraInfo info(double baseline) {
  auto const& c = walk().rig().left;
  CameraInfo m;
  m.width = static_cast<std::uint32_t>(c.width);
  m.height = static_cast<std::uint32_t>(c.height);
  m.p = {c.fx, 0, c.cx, -c.fx * baseline, 0, c.fy, c.cy, 0, 0, 0, 1, 0};
  return m;
}

/// A node whose camera looks ahead from the base, with what it was given.
class Node : public testing::Test {
protected:
  Node() {
    tf2_ros::Buffer::known().clear();
    tf2_ros::Buffer::known()[{"base_link", "left_optical"}].rotation = {-0.5, 0.5, -0.5, 0.5};
    tf2_ros::Buffer::known()[{"imu_frame", "left_optical"}] = {};
  }
  void make(std::map<std::string, rclcpp::NodeOptions::value> parameters = {}) {
    parameters["threads"] = std::int64_t{1};
    parameters["features"] = std::int64_t{400};
    node = std::make_unique<ft_ros2::stereo_node>(rclcpp::NodeOptions{parameters});
  }
  void give_info() {
    node->give("left/camera_info", info(0));
    node->give("right/camera_info", info(walk().rig().baseline()));
    node->spin();
  }
  /// Frame i of the walk arrives. @param late_ns the right image's stamp
  void arrive(int i, std::int64_t time_ns, std::int64_t late_ns = 0) {
    seq::stereo_frame const frame = walk().render(i);
    node->give("left/image_rect", message(frame.left, time_ns));
    node->give("right/image_rect", message(frame.right, time_ns + late_ns));
  }
  void frames(int from, int to, std::int64_t first_ns = begin_ns) {
    for (int i = from; i < to; ++i) {
      arrive(i, first_ns + i * period_ns);
      node->spin();
    }
  }
  void sample(std::int64_t time_ns) {
    Imu m;
    m.header = header(time_ns, "imu_frame");
    m.linear_acceleration.y = -9.81;
    node->give("imu", m);
  }
  std::vector<Odometry> const& poses() { return node->published<Odometry>("odometry").sent; }
  DiagnosticArray const& health() {
    node->tick();
    return node->published<DiagnosticArray>("/diagnostics").sent.back();
  }
  std::string message_of_health() { return health().status.at(0).message; }

  std::unique_ptr<ft_ros2::stereo_node> node;
};

TEST_F(Node, PublishesPosesPathAndTransforms) {
  make();
  give_info();
  frames(0, 12);
  ASSERT_EQ(poses().size(), 12u);
  Odometry const& last = poses().back();
  EXPECT_EQ(last.header.frame_id, "odom");
  EXPECT_EQ(last.child_frame_id, "base_link");
  EXPECT_EQ(last.header.stamp.sec, 7);
  EXPECT_EQ(last.header.stamp.nanosec, 550'000'000u);
  // z of the camera is x of the base, x is -y, y is -z.
  Eigen::Vector3d const t =
      (walk().T_world_camera(0).inverse() * walk().T_world_camera(11)).translation();
  EXPECT_NEAR(last.pose.pose.position.x, t.z(), 0.02);
  EXPECT_NEAR(last.pose.pose.position.y, -t.x(), 0.02);
  EXPECT_NEAR(last.pose.pose.position.z, -t.y(), 0.02);
  EXPECT_GT(last.pose.covariance[0], 0);
  EXPECT_EQ(poses().front().twist.covariance[0], -1);
  ASSERT_EQ(node->transforms.size(), 12u);
  EXPECT_EQ(node->transforms.back().child_frame_id, "base_link");
  EXPECT_EQ(node->published<Path>("path").sent.back().poses.size(), 12u);
  EXPECT_EQ(message_of_health(), "tracking");
  EXPECT_EQ(message_of_health(), "no images");
}

TEST_F(Node, SaysWhatItWaitsFor) {
  make({{"use_imu", true}});
  node->give("left/camera_info", info(0));
  frames(0, 2);
  EXPECT_EQ(message_of_health(), "waiting for right/camera_info imu, with a frame_id");
  give_info();
  sample(begin_ns + 10 * period_ns);
  tf2_ros::Buffer::known().clear();
  frames(2, 3);
  EXPECT_EQ(message_of_health(), "tf knows no base_link");
  EXPECT_TRUE(poses().empty());
}

TEST_F(Node, RefusesCameraInfoOfOtherImages) {
  make();
  CameraInfo twice = info(0);
  twice.width *= 2;
  twice.height *= 2;
  node->give("left/camera_info", twice);
  node->give("right/camera_info", info(0.1));
  frames(0, 1);
  EXPECT_EQ(message_of_health().rfind("CameraInfo is of 640x416 images, these are 320x208", 0), 0u);
}

TEST_F(Node, RefusesImagesOfTwoTimesAndOfAnotherSize) {
  make();
  give_info();
  frames(0, 2);
  arrive(2, begin_ns + 2 * period_ns, 6'000'000);
  node->spin();
  EXPECT_EQ(message_of_health().rfind("left and right are 0.006000 s apart", 0), 0u);
  Image half = message(walk().render(2).left, begin_ns + 3 * period_ns);
  half.height /= 2;
  node->give("left/image_rect", half);
  node->give("right/image_rect", half);
  node->spin();
  EXPECT_EQ(message_of_health(), "an image is 320x104, the first one was 320x208");
  frames(4, 5);
  EXPECT_EQ(poses().size(), 3u);
}

TEST_F(Node, SaysWhyAFrameIsNotTracked) {
  make();
  give_info();
  Image black = message(walk().render(0).left, begin_ns);
  std::fill(black.data.begin(), black.data.end(), std::uint8_t{3});
  node->give("left/image_rect", black);
  node->give("right/image_rect", black);
  node->spin();
  EXPECT_TRUE(poses().empty());
  std::string const said = message_of_health();
  EXPECT_EQ(said.rfind("the camera is not tracked: ", 0), 0u) << said;
  EXPECT_NE(said.find("nearly black"), std::string::npos) << said;
}

TEST_F(Node, BeginsAnewWhereTimesGoBack) {
  make({{"loops", true}});
  give_info();
  frames(4, 12);
  frames(4, 12, begin_ns - 4'000'000'000);
  ASSERT_EQ(poses().size(), 16u);
  EXPECT_NEAR(poses()[8].pose.pose.position.x, 0, 1e-9);
  EXPECT_NEAR(poses()[15].pose.pose.position.x, poses()[7].pose.pose.position.x, 1e-12);
  EXPECT_EQ(node->published<Path>("path").sent.back().poses.size(), 8u);
  arrive(3, begin_ns - 4'000'000'000 + 3 * period_ns);  // swapped, not another run
  node->spin();
  EXPECT_EQ(poses().size(), 16u);
}

// One sample of a wrong time does not begin all anew, and a frame that waits is one of the run
// before.
TEST_F(Node, BeginsAnewWithAnImu) {
  make({{"use_imu", true}});
  give_info();
  sample(begin_ns);
  node->spin();
  auto const follow = [&](int first, int last, std::int64_t begin) {
    for (int i = first; i < last; ++i) {
      for (int k = 9; k >= 0; --k) { sample(begin + i * period_ns - k * 5'000'000); }
      arrive(i, begin + i * period_ns);
      node->spin();
    }
  };
  follow(4, 9, begin_ns);
  sample(begin_ns + 3'600'000'000'000);
  follow(9, 11, begin_ns);
  ASSERT_EQ(poses().size(), 7u);
  auto const x = [&](std::size_t i) { return poses()[i].pose.pose.position.x; };
  EXPECT_GT(std::abs(x(6)), 1e-8);  // 0 in a frame that begins anew
  arrive(11, begin_ns + 11 * period_ns);
  node->spin();
  follow(4, 8, begin_ns - 4'000'000'000);
  ASSERT_EQ(poses().size(), 12u);
  EXPECT_GT(std::abs(x(7)), 1e-8);
  EXPECT_NEAR(x(8), 0, 1e-9);
  EXPECT_NEAR(x(11), x(3), 1e-3);
}

// The executor hands over one sample for each image, and an IMU may be later than its images.
TEST_F(Node, AFrameWaitsForItsSamples) {
  make({{"use_imu", true}});
  give_info();
  sample(begin_ns - period_ns);
  node->spin();
  arrive(0, begin_ns);
  node->spin();
  EXPECT_TRUE(poses().empty());
  sample(begin_ns);
  node->spin();
  EXPECT_EQ(poses().size(), 1u);
  for (int i = 1; i < 3; ++i) {
    arrive(i, begin_ns + i * period_ns);
    for (int k = 9; k >= 0; --k) { sample(begin_ns + i * period_ns - k * 5'000'000); }
  }
  node->spin();
  EXPECT_EQ(poses().size(), 3u);
  arrive(3, begin_ns + 3 * period_ns);  // an IMU that is silent delays by one frame
  node->spin();
  EXPECT_EQ(poses().size(), 3u);
  arrive(4, begin_ns + 4 * period_ns);
  node->spin();
  EXPECT_EQ(poses().size(), 4u);
}

TEST_F(Node, MakesNoPathThatNobodyReads) {
  make();
  node->published<Path>("path").readers = 0;
  give_info();
  frames(0, 2);
  EXPECT_EQ(poses().size(), 2u);
  EXPECT_TRUE(node->published<Path>("path").sent.empty());
}

TEST_F(Node, RefusesAnUnknownDevice) {
  EXPECT_THROW(make({{"device", std::string("gpu")}}), std::runtime_error);
  EXPECT_THROW(make({{"max_time_difference", -0.001}}), std::runtime_error);
  EXPECT_THROW(make({{"max_time_difference", std::nan("")}}), std::runtime_error);
}

}  // namespace ros2_node_test
