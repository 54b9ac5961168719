// SPDX-License-Identifier: Apache-2.0
/// @file What the benches run on, as plain types; and the measurements they return.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace bench {

struct plain_pose {
  float R[9];
  float t[3];
};

struct scene_frame {
  std::vector<std::uint8_t> left, right;
  plain_pose T_cw;
};

struct scene {
  int width = 0, height = 0;
  float fx = 0, fy = 0, cx = 0, cy = 0, baseline = 0;
  int features = 1200;
  int local_points = 3000;
  std::vector<scene_frame> frames;  ///< neighbours in time
};

struct measurement {
  std::string name;
  std::string backend;
  int batch = 1;
  std::vector<double> us;  ///< per call
  int inliers = 0;
  int map_points = 0;
};

struct settings {
  int warm_up = 100;
  int frames = 1000;
  std::vector<int> batches;
  bool stages = true;
};

std::vector<measurement> run_host(scene const& s, settings const& how);
/// Empty where there is no device.
std::vector<measurement> run_cuda(scene const& s, settings const& how);
/// "name, driver x, runtime y"; empty without a device.
std::string cuda_description();

}  // namespace bench
