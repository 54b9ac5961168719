// SPDX-License-Identifier: Apache-2.0
/// @file A ROS 2 node around ft_ros2::tracker: a rectified stereo pair, and an IMU if there is one,
/// in; odometry, path, tf and diagnostics out. A component: it may share a process. README.md has
/// its topics and parameters.
#include <tf2_ros/buffer.h>
#include <tf2_ros/transform_broadcaster.h>
#include <tf2_ros/transform_listener.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <diagnostic_msgs/msg/diagnostic_array.hpp>
#include <exception>
#include <functional>
#include <geometry_msgs/msg/pose_stamped.hpp>
#include <geometry_msgs/msg/transform_stamped.hpp>
#include <image_transport/subscriber_filter.hpp>
#include <limits>
#include <memory>
#include <nav_msgs/msg/odometry.hpp>
#include <nav_msgs/msg/path.hpp>
#include <optional>
#include <rclcpp/rclcpp.hpp>
#include <rclcpp_components/register_node_macro.hpp>
#include <sensor_msgs/msg/camera_info.hpp>
#include <sensor_msgs/msg/image.hpp>
#include <sensor_msgs/msg/imu.hpp>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#if __has_include(<message_filters/synchronizer.hpp>)  // Jazzy and newer
#include <message_filters/sync_policies/approximate_time.hpp>
#include <message_filters/synchronizer.hpp>
#else
#include <message_filters/sync_policies/approximate_time.h>
#include <message_filters/synchronizer.h>
#endif

#include "ft_ros2/health.hpp"
#include "ft_ros2/images.hpp"
#include "ft_ros2/quaternions.hpp"
#include "ft_ros2/tracker.hpp"

namespace ft_ros2 {
namespace {

using sensor_msgs::msg::CameraInfo;
using sensor_msgs::msg::Image;
using sensor_msgs::msg::Imu;

std::int64_t nanoseconds(builtin_interfaces::msg::Time const& t) {
  return std::int64_t{1'000'000'000} * t.sec + t.nanosec;
}

projection_info info_of(CameraInfo const& m) {
  return {static_cast<int>(m.width), static_cast<int>(m.height), m.p};
}

transform transform_of(geometry_msgs::msg::Transform const& m) {
  auto const& q = m.rotation;
  auto const& t = m.translation;
  return {matrix_of({q.x, q.y, q.z, q.w}), {t.x, t.y, t.z}};
}

}  // namespace

class stereo_node : public rclcpp::Node {
public:
  explicit stereo_node(rclcpp::NodeOptions const& options)
      : rclcpp::Node("ft_stereo_odometry", options), buffer_(get_clock()), listener_(buffer_) {
    map_frame_ = declare_parameter<std::string>("map_frame", "map");
    odom_frame_ = declare_parameter<std::string>("odom_frame", "odom");
    base_frame_ = declare_parameter<std::string>("base_frame", "base_link");
    publish_tf_ = declare_parameter("publish_tf", true);
    path_length_ = static_cast<std::size_t>(
        std::max<std::int64_t>(0, declare_parameter("path_length", std::int64_t{5000})));
    read_settings();

    odometry_out_ = create_publisher<nav_msgs::msg::Odometry>("odometry", rclcpp::QoS(10));
    diagnostics_out_ =
        create_publisher<diagnostic_msgs::msg::DiagnosticArray>("/diagnostics", rclcpp::QoS(1));
    diagnose_ = create_wall_timer(std::chrono::seconds(1), [this] { diagnose(); });
    path_out_ = create_publisher<nav_msgs::msg::Path>("path", rclcpp::QoS(1));
    broadcaster_ = std::make_unique<tf2_ros::TransformBroadcaster>(*this);

    auto const latest = rclcpp::SensorDataQoS();
    left_info_in_ = create_subscription<CameraInfo>(
        "left/camera_info", latest, [this](CameraInfo::ConstSharedPtr m) { left_info_ = m; });
    right_info_in_ = create_subscription<CameraInfo>(
        "right/camera_info", latest, [this](CameraInfo::ConstSharedPtr m) { right_info_ = m; });
    if (use_imu_) {
      imu_in_ = create_subscription<Imu>("imu", rclcpp::SensorDataQoS().keep_last(400),
                                         [this](Imu::ConstSharedPtr m) { on_imu(*m); });
    }
    std::string const transport = declare_parameter<std::string>("image_transport", "raw");
    left_in_.subscribe(this, "left/image_rect", transport, rmw_qos_profile_sensor_data);
    right_in_.subscribe(this, "right/image_rect", transport, rmw_qos_profile_sensor_data);
    pairs_ = std::make_unique<synchronizer>(policy(5), left_in_, right_in_);
    pairs_->registerCallback(
        std::bind(&stereo_node::on_images, this, std::placeholders::_1, std::placeholders::_2));
  }

private:
  using policy = message_filters::sync_policies::ApproximateTime<Image, Image>;
  using synchronizer = message_filters::Synchronizer<policy>;

  void read_settings() {
    settings_.features = static_cast<int>(declare_parameter("features", std::int64_t{1200}));
    settings_.threads = static_cast<int>(declare_parameter("threads", std::int64_t{0}));
    settings_.loops = declare_parameter("loops", false);
    settings_.gpu = is_gpu(declare_parameter<std::string>("device", "host"));
    double const apart_s = declare_parameter("max_time_difference", 0.005);
    if (!(apart_s >= 0 && apart_s <= 1)) {
      throw std::runtime_error("max_time_difference is " + std::to_string(apart_s) +
                               " s, must be in [0, 1]");
    }
    max_apart_ns_ = static_cast<std::int64_t>(1e9 * apart_s);
    use_imu_ = declare_parameter("use_imu", false);
    imu_.gyro_noise = declare_parameter("gyro_noise", imu_.gyro_noise);
    imu_.accel_noise = declare_parameter("accel_noise", imu_.accel_noise);
    imu_.gyro_walk = declare_parameter("gyro_walk", imu_.gyro_walk);
    imu_.accel_walk = declare_parameter("accel_walk", imu_.accel_walk);
    imu_.rate_hz = declare_parameter("imu_rate", imu_.rate_hz);
  }

  void on_imu(Imu const& m) {
    guarded([&] { add(m); });
    if (left_ && imu_ns_ >= nanoseconds(left_->header.stamp)) { track_waiting(); }
  }
  void add(Imu const& m) {
    imu_id_ = m.header.frame_id;
    imu_ns_ = nanoseconds(m.header.stamp);
    if (!tracker_) { return; }
    auto const& a = m.linear_acceleration;
    auto const& w = m.angular_velocity;
    tracker_->add_imu(imu_ns_, {a.x, a.y, a.z}, {w.x, w.y, w.z});
  }
  /// Samples that have come while a frame was tracked, which the executor hands over one at a time.
  void add_arrived() {
    Imu m;
    rclcpp::MessageInfo info;
    while (imu_in_ && imu_in_->take(m, info)) {
      guarded([&] { add(m); });
    }
  }

  /// A frame waits for the samples up to its time, but not longer than until the next frame.
  void on_images(Image::ConstSharedPtr const& left, Image::ConstSharedPtr const& right) {
    add_arrived();
    if (left_) { track_waiting(); }
    left_ = left;
    right_ = right;
    if (!use_imu_ || imu_ns_ >= nanoseconds(left->header.stamp)) { track_waiting(); }
  }

  void track_waiting() {
    Image::ConstSharedPtr const left = std::exchange(left_, nullptr);
    Image::ConstSharedPtr const right = std::exchange(right_, nullptr);
    guarded([&] {
      require_one_time(nanoseconds(left->header.stamp), nanoseconds(right->header.stamp));
      if (!tracker_) { begin(*left); }
      take(*left, left_grey_);
      take(*right, right_grey_);
      auto const begin = std::chrono::steady_clock::now();
      estimate const e =
          tracker_->track(left_grey_.data(), right_grey_.data(), nanoseconds(left->header.stamp));
      health_.take(
          e, std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin)
                 .count());
      if (!e.warning.empty()) {
        RCLCPP_WARN_THROTTLE(get_logger(), steady_, 10000, "%s", e.warning.c_str());
      }
      if (!e.imu_warning.empty()) {
        RCLCPP_WARN_THROTTLE(get_logger(), steady_, 10000, "%s", e.imu_warning.c_str());
      }
      if (e.begun_anew) {
        path_.poses.clear();
        warn("the times of frames went back: all begins anew");
      }
      if (e.tracked) {
        publish(e, left->header.stamp);
      } else {
        warn(("the camera is not tracked: " + e.reason).c_str());
      }
    });
  }

  void require_one_time(std::int64_t left_ns, std::int64_t right_ns) const {
    std::int64_t const apart = std::abs(left_ns - right_ns);
    if (apart > max_apart_ns_) {
      throw std::runtime_error(
          "left and right are " + std::to_string(1e-9 * static_cast<double>(apart)) +
          " s apart, more than max_time_difference: both are taken at one time");
    }
  }

  /// @throws std::runtime_error while something is not known that the tracker needs
  void begin(Image const& left) {
    std::string missing;
    if (!left_info_) { missing += " left/camera_info"; }
    if (!right_info_) { missing += " right/camera_info"; }
    if (use_imu_ && imu_id_.empty()) { missing += " imu, with a frame_id"; }
    if (!missing.empty()) { throw std::runtime_error("waiting for" + missing); }
    std::string const& camera = left.header.frame_id;
    settings_.pair = pair_of(static_cast<int>(left.width), static_cast<int>(left.height),
                             info_of(*left_info_), info_of(*right_info_));
    settings_.T_base_camera = lookup(base_frame_, camera);
    if (use_imu_) {
      imu_.T_imu_camera = lookup(imu_id_, camera);
      settings_.imu = imu_;
    }
    tracker_ = std::make_unique<tracker>(settings_);
    RCLCPP_INFO(get_logger(), "tracking %dx%d images, baseline %.4f m", settings_.pair.width,
                settings_.pair.height, settings_.pair.baseline);
  }

  /// Points of `from` to `to`. @throws tf2::TransformException while tf does not know
  transform lookup(std::string const& to, std::string const& from) const {
    return transform_of(buffer_.lookupTransform(to, from, tf2::TimePointZero).transform);
  }

  void take(Image const& m, std::vector<std::uint8_t>& grey) const {
    if (static_cast<int>(m.width) != settings_.pair.width ||
        static_cast<int>(m.height) != settings_.pair.height) {
      throw std::runtime_error(
          "an image is " + size_text(static_cast<int>(m.width), static_cast<int>(m.height)) +
          ", the first one was " + size_text(settings_.pair.width, settings_.pair.height));
    }
    to_grey({m.data.data(), m.data.size(), settings_.pair.width, settings_.pair.height, m.step},
            m.encoding, grey);
  }

  void publish(estimate const& e, builtin_interfaces::msg::Time const& stamp) {
    nav_msgs::msg::Odometry odometry;
    odometry.header.stamp = stamp;
    odometry.header.frame_id = odom_frame_;
    odometry.child_frame_id = base_frame_;
    auto& pose = odometry.pose.pose;
    pose.position.x = e.T_odom_base.t[0];
    pose.position.y = e.T_odom_base.t[1];
    pose.position.z = e.T_odom_base.t[2];
    std::array<double, 4> const q = quaternion_of(e.T_odom_base.R);
    pose.orientation.x = q[0];
    pose.orientation.y = q[1];
    pose.orientation.z = q[2];
    pose.orientation.w = q[3];
    std::copy(e.covariance.begin(), e.covariance.end(), odometry.pose.covariance.begin());
    if (e.moving_known) {
      auto& twist = odometry.twist.twist;
      twist.linear.x = e.linear[0];
      twist.linear.y = e.linear[1];
      twist.linear.z = e.linear[2];
      twist.angular.x = e.angular[0];
      twist.angular.y = e.angular[1];
      twist.angular.z = e.angular[2];
    } else {
      odometry.twist.covariance[0] = -1;  // not known
    }
    odometry_out_->publish(odometry);
    if (publish_tf_) {
      send_transform(odometry.header, base_frame_, e.T_odom_base);
      if (settings_.loops) {
        auto map = odometry.header;
        map.frame_id = map_frame_;
        send_transform(map, odom_frame_, e.T_map_odom);
      }
    }
    if (path_length_ > 0) { extend_path(odometry); }
  }

  void send_transform(std_msgs::msg::Header const& header, std::string const& child,
                      transform const& T) {
    geometry_msgs::msg::TransformStamped m;
    m.header = header;
    m.child_frame_id = child;
    m.transform.translation.x = T.t[0];
    m.transform.translation.y = T.t[1];
    m.transform.translation.z = T.t[2];
    std::array<double, 4> const q = quaternion_of(T.R);
    m.transform.rotation.x = q[0];
    m.transform.rotation.y = q[1];
    m.transform.rotation.z = q[2];
    m.transform.rotation.w = q[3];
    broadcaster_->sendTransform(m);
  }

  void diagnose() {
    health const h = health_.report();
    diagnostic_msgs::msg::DiagnosticArray all;
    all.header.stamp = now();
    diagnostic_msgs::msg::DiagnosticStatus status;
    status.level = h.level;
    status.name = std::string(get_fully_qualified_name()) + ": tracking";
    status.message = h.message;
    for (auto const& [name, value] : h.values) {
      diagnostic_msgs::msg::KeyValue line;
      line.key = name;
      line.value = value;
      status.values.push_back(line);
    }
    all.status.push_back(status);
    diagnostics_out_->publish(all);
  }

  /// A full path loses every second pose.
  void extend_path(nav_msgs::msg::Odometry const& odometry) {
    geometry_msgs::msg::PoseStamped at;
    at.header = odometry.header;
    at.pose = odometry.pose.pose;
    path_.header = odometry.header;
    path_.poses.push_back(at);
    if (path_.poses.size() > path_length_) {
      std::size_t kept = 0;
      for (std::size_t i = 0; i < path_.poses.size(); i += 2) {
        path_.poses[kept++] = path_.poses[i];
      }
      path_.poses.resize(kept);
    }
    if (path_out_->get_subscription_count() > 0) { path_out_->publish(path_); }
  }

  /// What is wrong with a message is said, at most every two seconds.
  template <typename F>
  void guarded(F const& f) {
    try {
      f();
    } catch (std::exception const& e) {
      health_.refuse(e.what());
      warn(e.what());
    }
  }
  void warn(char const* text) { RCLCPP_WARN_THROTTLE(get_logger(), steady_, 2000, "%s", text); }

  rclcpp::Clock steady_{RCL_STEADY_TIME};  ///< of what is logged: that of a bag may go back
  std::string map_frame_, odom_frame_, base_frame_, imu_id_;
  bool publish_tf_ = true, use_imu_ = false;
  std::size_t path_length_ = 0;
  imu_settings imu_;
  tracker_settings settings_;
  std::int64_t max_apart_ns_ = 0, imu_ns_ = std::numeric_limits<std::int64_t>::min();
  std::unique_ptr<tracker> tracker_;
  health_counter health_;
  CameraInfo::ConstSharedPtr left_info_, right_info_;
  Image::ConstSharedPtr left_, right_;  ///< wait for the IMU
  std::vector<std::uint8_t> left_grey_, right_grey_;
  nav_msgs::msg::Path path_;

  tf2_ros::Buffer buffer_;
  tf2_ros::TransformListener listener_;
  std::unique_ptr<tf2_ros::TransformBroadcaster> broadcaster_;
  rclcpp::Publisher<nav_msgs::msg::Odometry>::SharedPtr odometry_out_;
  rclcpp::Publisher<nav_msgs::msg::Path>::SharedPtr path_out_;
  rclcpp::Publisher<diagnostic_msgs::msg::DiagnosticArray>::SharedPtr diagnostics_out_;
  rclcpp::TimerBase::SharedPtr diagnose_;
  rclcpp::Subscription<CameraInfo>::SharedPtr left_info_in_, right_info_in_;
  rclcpp::Subscription<Imu>::SharedPtr imu_in_;
  image_transport::SubscriberFilter left_in_, right_in_;
  std::unique_ptr<synchronizer> pairs_;
};

}  // namespace ft_ros2

RCLCPP_COMPONENTS_REGISTER_NODE(ft_ros2::stereo_node)
