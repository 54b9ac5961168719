// SPDX-License-Identifier: Apache-2.0
/// @file The half of the node that knows nothing of ROS: images and time stamps in, poses of the
/// robot out.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

#include "ft/any_odometry.hpp"
#include "ft/pipelines/explain.hpp"
#include "ft/pipelines/imu_warnings.hpp"
#include "ft/pipelines/tracking_warnings.hpp"
#include "ft_ros2/base_frame.hpp"
#include "ft_ros2/estimate.hpp"

namespace ft_ros2 {

/// @throws std::runtime_error for another name
inline bool is_gpu(std::string const& device) {
  if (device == "cuda" || device == "host") { return device == "cuda"; }
  throw std::runtime_error("device is '" + device + "', must be host or cuda");
}

inline ft::odometry_params params_of(tracker_settings const& s) {
  auto const f = [](double v) { return static_cast<float>(v); };
  ft::odometry_params p;
  p.orb.width = s.pair.width;
  p.orb.height = s.pair.height;
  p.orb.features = s.features;
  p.loops.present = s.loops;
  if (s.imu) {
    p.imu.present = true;
    p.imu.T_bc = rigid_of(s.imu->T_imu_camera);
    p.imu.noise = {f(s.imu->gyro_noise), f(s.imu->accel_noise), f(s.imu->gyro_walk),
                   f(s.imu->accel_walk), f(s.imu->rate_hz)};
  }
  return p;
}

inline ft::any_odometry odometry_of(tracker_settings const& s) {
  auto const& p = s.pair;
  auto const baseline = static_cast<double>(static_cast<float>(p.baseline));
  ft::device where;
  where.gpu = s.gpu ? ft::device::current_gpu : ft::device::host;
  where.threads = s.threads;
  return ft::make_odometry(
      where, ft::rig_description::rectified_pair(p.fx, p.fy, p.cx, p.cy, baseline), params_of(s));
}

class tracker {
public:
  /// @throws std::runtime_error for settings that cannot be, and for a GPU without CUDA
  explicit tracker(tracker_settings const& s)
      : pair_(s.pair), base_(s.T_base_camera), loops_(s.loops), odometry_(odometry_of(s)) {}

  /// Waits for the pose. @param left,right grey, width x height bytes without padding
  /// @param time_ns later than that of the frame before, or a second before it or more, such as of
  /// a bag that is played again: all begins anew @throws std::runtime_error if it is not
  estimate track(std::uint8_t const* left, std::uint8_t const* right, std::int64_t time_ns) {
    follow_clock(time_ns);
    int const w = pair_.width;
    int const h = pair_.height;
    ft::tracking const t = odometry_.track({{{left, w, h, w}, {right, w, h, w}}}, time_ns);
    // The first frame of a later map is at a guessed place.
    bool const guessed = t.map_begun && t.maps > 1;
    estimate e;
    e.tracked = t.state == ft::tracking_state::tracking && !guessed;
    e.begun_anew = std::exchange(begun_anew_, false);
    if (!e.tracked) { e.reason = ft::explain(t, odometry_.params().rules).text; }
    e.keyframe = t.keyframe;
    e.inliers = t.inliers;
    e.map_points = t.map_points;
    e.map_id = t.map_id;
    e.map_begun = t.map_begun;
    if (odometry_.params().imu.present) {
      ft::imu_explanation const imu = ft::explain_imu(t.imu, odometry_.params().imu);
      e.imu_state = ft::name_of(imu.state) + (imu.text.empty() ? "" : ": " + imu.text);
    }
    for (ft::tracking_notice const& said : ft::warnings_of(t, odometry_.params())) {
      if (said.warning == ft::tracking_warning::imu) { continue; }
      e.warning += (e.warning.empty() ? "" : "; ") + std::string(ft::name_of(said.warning)) + ": " +
                   said.text;
    }
    for (std::string const& said : ft::imu_warnings(t.imu, odometry_.params().imu)) {
      e.imu_warning += (e.imu_warning.empty() ? "" : "; ") + said;
    }
    if (loops_) { e.T_map_odom = base_.correction(t.T_world_odom); }
    if (e.tracked) {
      base_.take(loops_ ? t.T_odom_camera : t.T_world_camera, t.covariance, time_ns, e);
    } else {
      base_.skip();
    }
    return e;
  }
  /// Specific force and angular rate, before the first frame that is later.
  void add_imu(std::int64_t time_ns, std::array<double, 3> const& accel,
               std::array<double, 3> const& gyro) {
    auto const narrowed = [](std::array<double, 3> const& v) {
      return ft::vec3<double>{v[0], v[1], v[2]}.cast<float>();
    };
    odometry_.add_imu({time_ns, narrowed(accel), narrowed(gyro)});
  }

private:
  /// Forgets all where the times of frames go back by a second or more. Those of samples decide
  /// nothing: one of them may be wrong.
  void follow_clock(std::int64_t time_ns) {
    if (newest_ns_ && time_ns <= *newest_ns_ - 1'000'000'000) {
      odometry_.reset();
      base_.skip();
      newest_ns_.reset();
      begun_anew_ = true;
    }
    newest_ns_ = std::max(time_ns, newest_ns_.value_or(time_ns));
  }

  rectified_pair pair_;
  base_frame base_;
  bool loops_ = false, begun_anew_ = false;
  std::optional<std::int64_t> newest_ns_;  ///< of frames
  ft::any_odometry odometry_;
};

}  // namespace ft_ros2
