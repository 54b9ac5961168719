// SPDX-License-Identifier: Apache-2.0
/// @file How the node is doing, as diagnostic_msgs/DiagnosticStatus has it.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "ft_ros2/estimate.hpp"

namespace ft_ros2 {

struct health {
  enum level_type : unsigned char { ok = 0, warning = 1, error = 2 };  ///< DiagnosticStatus's
  level_type level = ok;
  std::string message;
  std::vector<std::pair<std::string, std::string>> values;
};

/// Counts frames between two reports.
class health_counter {
public:
  /// @param ms what the frame took, milliseconds
  void take(estimate const& e, double ms) {
    ++frames_;
    tracked_ += e.tracked ? 1 : 0;
    maps_begun_ += e.map_begun ? 1 : 0;
    ms_ += ms;
    if (!e.tracked) { reason_ = e.reason; }
    last_ = e;
    std::string text = e.warning;
    if (!e.imu_warning.empty()) { text += (text.empty() ? "" : "; ") + e.imu_warning; }
    if (!text.empty()) { warning_ = text; }
  }
  /// A frame that was not tracked, such as one of another size or before camera_info.
  void refuse(std::string const& why) { refused_ = why; }

  /// Of the frames since the last report.
  health report() {
    health h;
    if (!refused_.empty()) {
      h = {tracked_ > 0 ? health::warning : health::error, refused_, {}};
    } else if (frames_ == 0) {
      h = {health::error, "no images", {}};
    } else if (tracked_ == 0) {
      h = {health::error, "the camera is not tracked: " + reason_, {}};
    } else if (tracked_ < frames_) {
      h = {health::warning, "frames without a pose: " + reason_, {}};
    } else {
      h = {warning_.empty() ? health::ok : health::warning,
           warning_.empty() ? "tracking" : "poses may be wrong: " + warning_,
           {}};
    }
    auto const add = [&](char const* name, std::string const& value) {
      h.values.emplace_back(name, value);
    };
    add("frames", std::to_string(frames_));
    add("tracked", std::to_string(tracked_));
    add("milliseconds a frame", std::to_string(frames_ > 0 ? ms_ / frames_ : 0.0));
    add("inliers", std::to_string(last_.inliers));
    add("map points", std::to_string(last_.map_points));
    add("map", std::to_string(last_.map_id));
    add("maps begun", std::to_string(maps_begun_));
    if (!last_.imu_state.empty()) { add("IMU", last_.imu_state); }
    if (!warning_.empty()) { add("warning", warning_); }
    *this = {};
    return h;
  }

private:
  int frames_ = 0, tracked_ = 0, maps_begun_ = 0;
  double ms_ = 0;
  estimate last_;
  std::string reason_, warning_, refused_;
};

}  // namespace ft_ros2
