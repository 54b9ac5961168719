// SPDX-License-Identifier: Apache-2.0
/// @file The sections of ft_bench. Each prints its table and adds its arrays to the results.
#pragma once

#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "bench/runner.hpp"
#include "bench/scene.hpp"

namespace bench {

struct settings {
  int warm_up = 0;  ///< 0: 100 on a device, 3 on the host
  int frames = 0;   ///< 0: 1000 and 48
  std::vector<int> batches;
  std::vector<int> streams;
  int images = 16;
  std::string sequence;  ///< recorded frames, instead of generated ones
  int features = 1200;
  int fisheye_features = 1000;
  int local_points = 3000;
  int points = 0;  ///< of the camera models; 0: 2^20 and 2^16
  int gpus = 0;    ///< 0: all

  int warm_up_on(backend_type b) const {
    return warm_up > 0 ? warm_up : (b == backend_type::cuda ? 100 : 3);
  }
  int frames_on(backend_type b) const {
    return frames > 0 ? frames : (b == backend_type::cuda ? 1000 : 48);
  }
};

/// Scenes are rendered at their first use.
class scenes {
public:
  explicit scenes(settings const& how) : how_(how) {}
  scene const& get(rig_type rig);

private:
  settings how_;
  std::map<rig_type, std::unique_ptr<scene>> made_;
};

struct context {
  settings how;
  scenes* all_scenes;
  nlohmann::json* out;
};

void cameras_section(context const& c, backend_type b);
/// Whole frames of one pair: array "rows" for the rectified rig, "fisheye" for the other.
void frame_section(context const& c, backend_type b, rig_type rig);
void stages_section(context const& c, backend_type b, rig_type rig);
void batch_section(context const& c, backend_type b);
void streams_section(context const& c, backend_type b);
void graph_section(context const& c, backend_type b);
void kernels_section(context const& c, backend_type b);
/// @param with_host also measures the frame on the host, next to a device
void ablation_section(context const& c, backend_type b, bool with_host);
/// Frames with either tie rule of the quadtree, in turn: array "tie_rules".
void tie_rules_section(context const& c, backend_type b);

/// ft::odometry, one camera and batches: array "odometry".
void odometry_section(context const& c, backend_type b);
/// Stages of ft::odometry, in all frames and in those that become keyframes: array "map_stages".
void map_stages_section(context const& c, backend_type b);
/// A batch of a tracker and of an odometry on each of several devices: array "gpus".
void gpus_section(context const& c);

/// Poses with an IMU, and integrals, one and many: array "inertial".
void inertial_section(context const& c, backend_type b);

/// Stages of words, relocalisation and the start with one camera, next to a device with one host
/// thread as well: array "words".
void words_section(context const& c, backend_type b);

/// The host executor's stages on one thread next to OpenCV's: array "host_stages".
void host_stages_section(context const& c);

}  // namespace bench
