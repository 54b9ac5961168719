// SPDX-License-Identifier: Apache-2.0
/// @file What is likely wrong with the samples of an IMU, in words.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <string>
#include <vector>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

/// A sentence for each of: samples that come more or less often than the calibration says, by a
/// factor of 1.5; samples that were left out, and why; images that contradict the IMU; a clock that
/// is far from that of the images; an IMU that is turned from where T_bc says. Each has what was
/// found and what was expected. Empty where nothing is wrong.
/// @param t of a frame @param params of the odometry
inline std::vector<std::string> imu_warnings(imu_tracking const& t, imu_params const& params) {
  std::vector<std::string> out;
  auto const text = [](double v) {
    char digits[32];
    std::snprintf(digits, sizeof digits, "%.4g", v);
    return std::string(digits);
  };
  float const stated =
      params.selection.rate_hz > 0 ? params.selection.rate_hz : params.noise.rate_hz;
  double const share = t.rate_hz / static_cast<double>(stated);
  if (t.rate_hz > 0 && (share > 1.5 || share * 1.5 < 1)) {
    out.push_back("samples of the IMU come at " + text(t.rate_hz) + " Hz, rate_hz says " +
                  text(static_cast<double>(stated)));
  }
  auto const tell = [&](long long count, std::string const& why) {
    if (count > 0) { out.push_back("samples of the IMU left out: " + std::to_string(count) + why); }
  };
  tell(t.left_out.disordered, " whose times are not after that of the sample before");
  tell(t.left_out.out_of_range, " that are not finite or reach the sensor's range of " +
                                    text(static_cast<double>(params.max_accel)) + " m/s^2 and " +
                                    text(static_cast<double>(params.max_gyro)) + " rad/s");
  tell(t.left_out.frozen, " that repeat the one before, though the sensor's noise differs");
  tell(t.left_out.spikes, " whose rate of turning is another one than before and after");
  tell(t.left_out.crowded_out,
       " of more than " + std::to_string(params.waiting) + " that waited for their frame");
  imu_clock_offset const& clock = t.clock;
  constexpr double least_s = 2e-3;
  bool const corrected = std::abs(t.time_offset_s - params.time_offset_s) > least_s;
  double const off = clock.offset_s - params.time_offset_s;
  if (corrected || (clock.known && std::abs(off) > std::fmax(4 * clock.sigma_s, least_s))) {
    // In whole milliseconds, so that the sentence does not change with every frame.
    double const ms = std::round(1e3 * (corrected ? t.time_offset_s : clock.offset_s));
    out.push_back("the IMU's clock is " + text(std::abs(ms)) + " ms " +
                  (ms < 0 ? "behind" : "ahead of") + " that of the images, time_offset_s says " +
                  text(1e3 * params.time_offset_s) + " ms");
  }
  vec3<double> const& turn = dot(t.turn, t.turn) > 0 ? t.turn : t.misalignment.turn;
  double const degrees = std::sqrt(dot(turn, turn)) * 57.295779513082321;
  if (dot(t.turn, t.turn) > 0 || (t.misalignment.known && degrees > 1)) {
    // In halves, so that the sentence does not change with every frame.
    out.push_back("the IMU is turned by " + text(0.5 * std::round(2 * degrees)) +
                  " degrees from where T_bc says");
  }
  if (t.samples == integration_status::contradicted) {
    out.push_back(
        "the images contradict the IMU: its samples since the last keyframe are not used");
  } else if (t.newest_s < 0 && (t.samples == integration_status::one_sample ||
                                t.samples == integration_status::no_steps)) {
    out.push_back("samples of the IMU come too late: the newest one is " + text(-t.newest_s) +
                  " s before its image, time_offset_s says " + text(1e3 * params.time_offset_s) +
                  " ms");
  } else if (!usable(t.samples) && std::abs(t.newest_s) > params.selection.longest_gap_s) {
    out.push_back("the newest sample of the IMU is " + text(std::abs(t.newest_s)) + " s " +
                  (t.newest_s > 0 ? "after" : "before") +
                  " its image, and none are usable: the clocks of images and IMU may differ");
  }
  return out;
}

/// The time of tracking that an IMU has until it is said that it is not used, s: twice that in
/// which the keyframes of an estimate are made. A right one needs it once, to begin and to come
/// back.
/// @param metric whether the unit of the map is known; not of one camera, before its IMU tells it
inline double longest_unused_s(imu_params const& params, bool metric) {
  int const least = params.initialization.least_keyframes;
  int const keyframes = metric ? least : std::max(least, params.scale_keyframes);
  return 2 * keyframes * params.keyframe_period_s;
}

namespace detail {

/// The sentence of tracking_warning::imu_not_used.
inline std::string unused_imu_text(imu_tracking const& t, imu_params const& params) {
  bool const contradicts = t.samples == integration_status::contradicted ||
                           t.estimate == initialization_status::inconsistent;
  std::string why = "its samples contradict the images";
  if (!contradicts && t.estimate == initialization_status::little_motion) {
    why =
        "its velocity, gravity and biases remain uncertain, for the motion is too little or "
        "its samples do not suit the images";
  } else if (!contradicts) {
    why = "there were no " + std::to_string(params.initialization.least_keyframes) +
          " keyframes in a row whose samples suit the images";
  }
  char time[32];
  std::snprintf(time, sizeof time, "%.3g", t.unused_s);
  return "the IMU is not used, for " + std::string(time) + " s of tracking or more: " + why +
         "; check T_bc and the axes, time_offset_s and the clocks, the units m/s^2 and rad/s";
}

/// What is kept of an IMU to tell whether it is used.
class idle_imu {
public:
  /// Writes imu_tracking::unused_s. @return whether the IMU is not used, though it has had the time
  /// for it, half of it in motion: a camera at rest tells little of an IMU. One camera's has told
  /// the unit of the map when it is known, so it is right, and what it contradicts later is the map
  bool judge(tracking& t, std::int64_t time_ns, imu_params const& params) {
    imu_tracking& imu = t.imu;
    // At a low rate of images keyframes take longer.
    double const passed =
        any_ ? std::fmin(static_cast<double>(saturated_difference(time_ns, last_ns_)) * 1e-9,
                         params.keyframe_period_s)
             : 0.0;
    bool const told_unit = t.depths == depth_origin::motion && t.metric;
    // Where the offset of the clocks or a turn was corrected the IMU has begun anew.
    vec3<double> const turned = imu.turn - turn_;
    if (told_unit || imu.time_offset_s != offset_s_ || dot(turned, turned) > 0) {
      unused_s_ = moving_s_ = 0;
    }
    any_ = true;
    last_ns_ = time_ns;
    offset_s_ = imu.time_offset_s;
    turn_ = imu.turn;
    double const most = longest_unused_s(params, t.metric);
    bool const sees = t.state == tracking_state::tracking && t.inliers > 0;
    bool const could = usable(imu.samples) || imu.samples == integration_status::contradicted;
    double const counted = imu.optimized ? -passed : sees && could && !told_unit ? passed : 0.0;
    auto const add = [&](double& sum, double most_of_it) {
      sum = std::fmin(std::fmax(sum + counted, 0.0), most_of_it);
    };
    add(unused_s_, most);
    if (imu.optimized || t.evidence.facts.moving != 0) { add(moving_s_, 0.5 * most); }
    imu.unused_s = unused_s_;
    constexpr double rounding = 1e-6;
    return sees && could && !imu.optimized && unused_s_ > most - rounding &&
           moving_s_ > 0.5 * most - rounding;
  }

private:
  bool any_ = false;
  std::int64_t last_ns_ = 0;
  double offset_s_ = 0;
  vec3<double> turn_ = {0, 0, 0};
  double unused_s_ = 0;
  double moving_s_ = 0;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
