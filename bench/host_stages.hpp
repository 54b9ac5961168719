// SPDX-License-Identifier: Apache-2.0
/// @file The host executor's stages on one thread, each beside what OpenCV has nearest to it.
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

/// What stages read and write of one image, owned by ft's side; OpenCV reads the same.
struct host_stage_image {
  plain_image captured;             ///< what rectification reads
  std::vector<plain_image> levels;  ///< of the pyramid
  std::vector<plain_keypoint> keypoints;
  std::uint8_t const* descriptors = nullptr;  ///< 32 bytes a keypoint
};

/// Images 2 i and 2 i + 1 are pair i; all through the map of their side.
struct host_stage_input {
  std::vector<host_stage_image> images;
  std::int16_t const* map_position[2] = {};   ///< x and y of the source pixel, row-major
  std::uint16_t const* map_fraction[2] = {};  ///< 32 * (y part) + (x part)
  int features = 0;
  float scale_factor = 0;
  int ini_threshold = 0;
  int min_threshold = 0;
};

/// A call for pair `i`.
using pair_call = std::function<void(int)>;

struct host_stage {
  std::string name;
  std::string counterpart;  ///< in OpenCV; empty where there is none
  std::string difference;   ///< what OpenCV does more, less or otherwise
  pair_call ours;
  pair_call theirs;  ///< empty where there is none, and in builds without OpenCV
};

/// The stages over all pairs of a rectified scene. Everything is computed once before.
class host_stages {
public:
  host_stages() = default;
  host_stages(host_stages const&) = delete;
  host_stages& operator=(host_stages const&) = delete;
  virtual ~host_stages() = default;
  virtual std::vector<host_stage> const& all() const = 0;
};

std::unique_ptr<host_stages> make_host_stages(scene const& s);

/// Of OpenCV, on one thread; one for each name that it has. Empty in builds without OpenCV.
/// @param input outlives the calls
std::vector<host_stage> opencv_stages(host_stage_input const& input);
/// "OpenCV 4.x.y"; empty in builds without it.
std::string opencv_description();
/// The instruction set that this program was compiled for, as far as the compiler tells.
std::string instruction_set();

}  // namespace bench
