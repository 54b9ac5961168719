// SPDX-License-Identifier: Apache-2.0
/// @file What is likely wrong with the samples of an IMU, in words.
#pragma once

#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "ft/core/config.hpp"
#include "ft/types/imu.hpp"

namespace ft {
inline namespace FT_ABI {

/// A sentence for each of: samples that come more or less often than the calibration says, by a
/// factor of 1.5; samples that were left out, and why; images that contradict the IMU; a clock that
/// is far from that of the images. Each has what was found and what was expected. Empty where
/// nothing is wrong.
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
  tell(t.left_out.crowded_out,
       " of more than " + std::to_string(params.waiting) + " that waited for their frame");
  imu_clock_offset const& clock = t.clock;
  double const off = clock.offset_s - params.time_offset_s;
  if (clock.known && std::abs(off) > std::fmax(4 * clock.sigma_s, 2e-3)) {
    // In whole milliseconds, so that the sentence does not change with every frame.
    double const ms = std::round(1e3 * clock.offset_s);
    out.push_back("the IMU's clock is " + text(std::abs(ms)) + " ms " +
                  (ms < 0 ? "behind" : "ahead of") + " that of the images, time_offset_s says " +
                  text(1e3 * params.time_offset_s) + " ms");
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

}  // namespace FT_ABI
}  // namespace ft
