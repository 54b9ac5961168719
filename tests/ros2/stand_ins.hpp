// SPDX-License-Identifier: Apache-2.0
/// @file Of ROS 2, what the node of examples/ros2 takes, under the names and with the members that
/// Humble and Jazzy have. Topics end in the node itself: a test gives messages and reads what was
/// sent. A node is spun as by a single-threaded executor: in turn a message of each subscription.
#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <variant>
#include <vector>

namespace builtin_interfaces::msg {
struct Time {
  std::int32_t sec = 0;
  std::uint32_t nanosec = 0;
};
}  // namespace builtin_interfaces::msg

namespace std_msgs::msg {
struct Header {
  builtin_interfaces::msg::Time stamp;
  std::string frame_id;
};
}  // namespace std_msgs::msg

namespace geometry_msgs::msg {
struct Vector3 {
  double x = 0, y = 0, z = 0;
};
using Point = Vector3;
struct Quaternion {
  double x = 0, y = 0, z = 0, w = 1;
};
struct Transform {
  Vector3 translation;
  Quaternion rotation;
};
struct TransformStamped {
  std_msgs::msg::Header header;
  std::string child_frame_id;
  Transform transform;
};
struct Pose {
  Point position;
  Quaternion orientation;
};
struct PoseStamped {
  std_msgs::msg::Header header;
  Pose pose;
};
struct PoseWithCovariance {
  Pose pose;
  std::array<double, 36> covariance{};
};
struct Twist {
  Vector3 linear, angular;
};
struct TwistWithCovariance {
  Twist twist;
  std::array<double, 36> covariance{};
};
}  // namespace geometry_msgs::msg

namespace nav_msgs::msg {
struct Odometry {
  std_msgs::msg::Header header;
  std::string child_frame_id;
  geometry_msgs::msg::PoseWithCovariance pose;
  geometry_msgs::msg::TwistWithCovariance twist;
};
struct Path {
  std_msgs::msg::Header header;
  std::vector<geometry_msgs::msg::PoseStamped> poses;
};
}  // namespace nav_msgs::msg

namespace sensor_msgs::msg {
struct Image {
  using ConstSharedPtr = std::shared_ptr<Image const>;
  std_msgs::msg::Header header;
  std::uint32_t height = 0, width = 0;
  std::string encoding;
  std::uint32_t step = 0;
  std::vector<std::uint8_t> data;
};
struct CameraInfo {
  using ConstSharedPtr = std::shared_ptr<CameraInfo const>;
  std_msgs::msg::Header header;
  std::uint32_t height = 0, width = 0;
  std::array<double, 12> p{};
};
struct Imu {
  using ConstSharedPtr = std::shared_ptr<Imu const>;
  std_msgs::msg::Header header;
  geometry_msgs::msg::Vector3 angular_velocity, linear_acceleration;
};
}  // namespace sensor_msgs::msg

namespace diagnostic_msgs::msg {
struct KeyValue {
  std::string key, value;
};
struct DiagnosticStatus {
  unsigned char level = 0;
  std::string name, message, hardware_id;
  std::vector<KeyValue> values;
};
struct DiagnosticArray {
  std_msgs::msg::Header header;
  std::vector<DiagnosticStatus> status;
};
}  // namespace diagnostic_msgs::msg

struct rmw_qos_profile_t {};
constexpr rmw_qos_profile_t rmw_qos_profile_sensor_data{};

enum rcl_clock_type_t { RCL_STEADY_TIME };

namespace rclcpp {
struct QoS {
  explicit QoS(std::size_t wanted) : depth(wanted) {}
  QoS& keep_last(std::size_t wanted) {
    depth = wanted;
    return *this;
  }
  std::size_t depth;
};
struct SensorDataQoS : QoS {
  SensorDataQoS() : QoS(5) {}
};
struct MessageInfo {};
struct Clock {
  explicit Clock(rcl_clock_type_t) {}
};
using Logger = std::vector<std::string>*;  ///< gets the warnings

struct NodeOptions {
  using value = std::variant<bool, std::int64_t, double, std::string>;
  std::map<std::string, value> parameters;
};

struct SubscriptionBase {
  virtual ~SubscriptionBase() = default;
  virtual bool execute() = 0;
};
template <typename M>
struct Subscription : SubscriptionBase {
  using SharedPtr = std::shared_ptr<Subscription>;
  bool take(M& message, MessageInfo&) {
    if (waiting.empty()) { return false; }
    message = *waiting.front();
    waiting.pop_front();
    return true;
  }
  bool execute() override {
    if (waiting.empty()) { return false; }
    auto const message = waiting.front();
    waiting.pop_front();
    callback(message);
    return true;
  }
  std::function<void(std::shared_ptr<M const>)> callback;
  std::deque<std::shared_ptr<M const>> waiting;
  std::size_t depth = 0;
};
template <typename M>
struct Publisher {
  using SharedPtr = std::shared_ptr<Publisher>;
  void publish(M const& m) { sent.push_back(m); }
  std::size_t get_subscription_count() const { return readers; }
  std::vector<M> sent;
  std::size_t readers = 1;
};
struct TimerBase {
  using SharedPtr = std::shared_ptr<TimerBase>;
  std::function<void()> callback;
};

class Node {
public:
  Node(std::string name, NodeOptions options)
      : name_(std::move(name)), options_(std::move(options)) {}

  template <typename T>
  T declare_parameter(std::string const& name, T const& otherwise) {
    auto const found = options_.parameters.find(name);
    return found == options_.parameters.end() ? otherwise : std::get<T>(found->second);
  }
  template <typename M>
  std::shared_ptr<Publisher<M>> create_publisher(std::string const& topic, QoS const&) {
    auto const made = std::make_shared<Publisher<M>>();
    publishers_[topic] = made;
    return made;
  }
  template <typename M, typename F>
  std::shared_ptr<Subscription<M>> create_subscription(std::string const& topic, QoS const& qos,
                                                       F callback) {
    auto const made = std::make_shared<Subscription<M>>();
    made->callback = callback;
    made->depth = qos.depth;
    subscriptions_[topic] = made;
    return made;
  }
  TimerBase::SharedPtr create_wall_timer(std::chrono::seconds, std::function<void()> callback) {
    timer_ = std::make_shared<TimerBase>();
    timer_->callback = std::move(callback);
    return timer_;
  }
  std::shared_ptr<Clock> get_clock() const { return std::make_shared<Clock>(RCL_STEADY_TIME); }
  Logger get_logger() { return &said; }
  builtin_interfaces::msg::Time now() const { return {}; }
  char const* get_fully_qualified_name() const { return name_.c_str(); }

  // ---- of the test

  /// A message arrives; the oldest one leaves a full queue.
  template <typename M>
  void give(std::string const& topic, M const& m) {
    auto const to = std::dynamic_pointer_cast<Subscription<M>>(subscriptions_.at(topic));
    to->waiting.push_back(std::make_shared<M const>(m));
    if (to->waiting.size() > to->depth) { to->waiting.pop_front(); }
  }
  void spin() {
    for (bool any = true; any;) {
      any = false;
      for (auto const& [topic, subscription] : subscriptions_) {
        any = subscription->execute() || any;
      }
    }
  }
  void tick() { timer_->callback(); }
  template <typename M>
  Publisher<M>& published(std::string const& topic) {
    return *std::static_pointer_cast<Publisher<M>>(publishers_.at(topic));
  }
  bool subscribes(std::string const& topic) const { return subscriptions_.count(topic) == 1; }
  std::vector<std::string> said;
  std::vector<geometry_msgs::msg::TransformStamped> transforms;

private:
  std::string name_;
  NodeOptions options_;
  TimerBase::SharedPtr timer_;
  std::map<std::string, std::shared_ptr<SubscriptionBase>> subscriptions_;
  std::map<std::string, std::shared_ptr<void>> publishers_;
};
}  // namespace rclcpp

#define RCLCPP_INFO(logger, ...) static_cast<void>(logger)
#define RCLCPP_WARN_THROTTLE(logger, clock, ms, format, text) \
  (static_cast<void>(clock), (logger)->push_back(text))
#define RCLCPP_COMPONENTS_REGISTER_NODE(node)

namespace tf2 {
struct TransformException : std::runtime_error {
  using std::runtime_error::runtime_error;
};
constexpr int TimePointZero = 0;
}  // namespace tf2

namespace tf2_ros {
/// Knows what the test has put into `known`: (to, from).
struct Buffer {
  using key = std::pair<std::string, std::string>;
  explicit Buffer(std::shared_ptr<rclcpp::Clock> const&) {}
  geometry_msgs::msg::TransformStamped lookupTransform(std::string const& to,
                                                       std::string const& from, int) const {
    auto const found = known().find({to, from});
    if (found == known().end()) { throw tf2::TransformException("tf knows no " + to); }
    geometry_msgs::msg::TransformStamped m;
    m.transform = found->second;
    return m;
  }
  static std::map<key, geometry_msgs::msg::Transform>& known() {
    static std::map<key, geometry_msgs::msg::Transform> all;
    return all;
  }
};
struct TransformListener {
  explicit TransformListener(Buffer&) {}
};
struct TransformBroadcaster {
  explicit TransformBroadcaster(rclcpp::Node& node) : node_(node) {}
  void sendTransform(geometry_msgs::msg::TransformStamped const& m) {
    node_.transforms.push_back(m);
  }

private:
  rclcpp::Node& node_;
};
}  // namespace tf2_ros

namespace image_transport {
struct SubscriberFilter {
  void subscribe(rclcpp::Node* node, std::string const& topic, std::string const&,
                 rmw_qos_profile_t) {
    using sensor_msgs::msg::Image;
    subscription = node->create_subscription<Image>(
        topic, rclcpp::QoS(5), [this](Image::ConstSharedPtr m) { arrived(m); });
  }
  std::function<void(sensor_msgs::msg::Image::ConstSharedPtr)> arrived;
  rclcpp::Subscription<sensor_msgs::msg::Image>::SharedPtr subscription;
};
}  // namespace image_transport

namespace message_filters {
namespace sync_policies {
template <typename A, typename B>
struct ApproximateTime {
  using first = A;
  explicit ApproximateTime(std::uint32_t) {}
};
}  // namespace sync_policies
/// Pairs images as they come.
template <typename Policy>
class Synchronizer {
public:
  using pointer = typename Policy::first::ConstSharedPtr;
  template <typename Filter>
  Synchronizer(Policy const&, Filter& left, Filter& right) {
    left.arrived = [this](pointer m) { take(left_, m); };
    right.arrived = [this](pointer m) { take(right_, m); };
  }
  template <typename F>
  void registerCallback(F callback) {
    callback_ = callback;
  }

private:
  void take(std::deque<pointer>& to, pointer const& m) {
    to.push_back(m);
    if (left_.empty() || right_.empty()) { return; }
    pointer const left = left_.front();
    pointer const right = right_.front();
    left_.pop_front();
    right_.pop_front();
    callback_(left, right);
  }
  std::deque<pointer> left_, right_;
  std::function<void(pointer const&, pointer const&)> callback_;
};
}  // namespace message_filters
