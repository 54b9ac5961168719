// SPDX-License-Identifier: Apache-2.0
/// @file The masks of a recording's cameras on disk. Not API.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "examples/sequence/types.hpp"

namespace seq::detail {

/// The masks of one camera: one for all frames, one for each, or none.
class camera_masks {
public:
  using mask = std::shared_ptr<image const>;  ///< of loaded images, 0 or 255; null = none
  /// What makes a raw image one of those that are loaded; empty = nothing is to be done.
  using move_image = std::function<image(image const&)>;

  camera_masks() = default;
  /// @param path an image, or a folder with masks named as the camera's images are, with any
  ///   extension or with .png behind their whole name; empty = none
  /// @param images of the frames @param warnings says how many frames have no mask
  /// @throws seq::error for a path that is not there, another size, or a folder without a mask
  ///   for any frame
  camera_masks(std::string const& path, std::vector<std::string> const& images,
               camera_intrinsics const& raw, move_image move, std::vector<std::string>& warnings);

  bool empty() const { return fixed_ == nullptr && files_.empty(); }
  /// Of frame i. Reads a file if each frame has one. @throws seq::error
  mask of(std::size_t i) const;

private:
  image read(std::string const& path) const;

  camera_intrinsics raw_;
  move_image move_;
  mask fixed_;
  std::vector<std::string> files_;  ///< of the frames; empty text = none
};

}  // namespace seq::detail
