// SPDX-License-Identifier: Apache-2.0
/// @file The host executor's stages on one thread, each next to OpenCV's nearest counterpart.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "bench/scene.hpp"

namespace bench {

struct plain_image {
  std::uint8_t const* data = nullptr;
  int width = 0, height = 0, stride = 0;
};
struct plain_keypoint {
  float x = 0, y = 0;  ///< in its level
  float angle = 0;     ///< degrees
  int level = 0;
};

/// Inputs and outputs of the stages for one image, in ft's memory; OpenCV reads the same.
struct host_stage_image {
  plain_image captured;             ///< input of rectification
  std::vector<plain_image> levels;  ///< of the pyramid
  std::vector<plain_keypoint> keypoints;
  std::uint8_t const* descriptors = nullptr;  ///< 32 bytes a keypoint
};

struct host_stage_input {
  host_stage_image images[2];                 ///< left and right
  std::int16_t const* map_position[2] = {};   ///< x and y of the source pixel, row-major
  std::uint16_t const* map_fraction[2] = {};  ///< 32 * (y part) + (x part)
  int features = 0;
  float scale_factor = 0;
  int ini_threshold = 0;
  int min_threshold = 0;
};

struct host_stage {
  std::string name;
  std::string counterpart;  ///< in OpenCV; empty without one
  std::string difference;   ///< differences of OpenCV's function
  std::function<void()> ours;
  std::function<void()> theirs;  ///< empty without a counterpart, and in builds without OpenCV
};

/// The stages over pairs of a rectified scene.
class host_stages {
public:
  host_stages() = default;
  host_stages(host_stages const&) = delete;
  host_stages& operator=(host_stages const&) = delete;
  virtual ~host_stages() = default;
  virtual std::vector<host_stage> const& all() const = 0;
  /// Computes all inputs of pair `i`, in the memory of the preceding pair: as in a tracker, a stage
  /// finds its input in the caches.
  virtual void prepare(int i) = 0;
};

std::unique_ptr<host_stages> make_host_stages(scene const& s);

/// OpenCV's side, on one thread.
struct opencv_side {
  std::vector<host_stage> stages;  ///< one per name it supports; none without OpenCV
  std::function<void()> prepare;   ///< to be called after the input has changed
};
/// @param input must outlive the calls
opencv_side make_opencv_side(host_stage_input const& input);
/// "OpenCV 4.x.y"; empty in builds without it.
std::string opencv_description();
/// The instruction set that this program was compiled for, as far as the compiler reports it.
std::string instruction_set();

}  // namespace bench
