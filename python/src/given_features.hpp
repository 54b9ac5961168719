// SPDX-License-Identifier: Apache-2.0
/// @file Keypoints of a caller, as ft.ImageFeatures has them.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "ft/types/features.hpp"
#include "python/src/arrays.hpp"

namespace ftpy {

/// @param given a dict of arrays, all on the device or none; those that are missing are None
/// @param bytes of a descriptor
inline ft::image_features image_features_of(arrays& kept, nb::handle given,
                                            std::string const& image, int bytes) {
  std::string const of = " of the features of " + image;
  ft::image_features f;
  f.descriptor_bytes = bytes;
  bool const there = nb::cast<bool>(given["on_device"]);
  f.descriptors = kept.rows_of_bytes(given["descriptors"], "descriptors" + of, f.descriptor_bytes,
                                     f.count, there && nb::cast<bool>(given["is_signed"]), there);
  f.on_device = there;
  auto const n = static_cast<std::size_t>(f.count);
  std::string const many = of + ", as many as descriptors,";
  f.positions =
      kept.numbers<float>(given["positions"], "positions" + many, "float32", {n, 2}, there);
  auto const column = [&](char const* name) -> float const* {
    nb::object const values = given[name];
    return values.is_none() ? nullptr
                            : kept.numbers<float>(values, name + many, "float32", {n}, there);
  };
  f.angle = column("angle");
  f.score = column("score");
  f.deviation = column("deviation");
  f.right_x = column("right_x");
  f.depth = column("depth");
  nb::object const octave = given["octave"];
  if (!octave.is_none()) {
    f.octave = kept.numbers<int>(octave, "octave" + many, "int32", {n}, there);
  }
  f.level_positions = nb::cast<bool>(given["level_positions"]);
  return f;
}

/// @param given of each rig a sequence: the features of its image, or of the left and the right one
/// @param bytes of a descriptor
inline std::vector<ft::given_features> given_features_of(arrays& kept, nb::sequence const& given,
                                                         bool several, int bytes) {
  std::vector<ft::given_features> all;
  for (nb::handle const h : given) {
    std::size_t const images = nb::len(h);
    if (images < 1 || images > 2) {
      throw argument_error("features of " + std::to_string(images) +
                           " images, must be those of one image, or of the left and the right");
    }
    std::string const rig = several ? " of camera pair " + std::to_string(all.size()) : "";
    ft::given_features f;
    f.left =
        image_features_of(kept, h[0], (images == 2 ? "the left image" : "the image") + rig, bytes);
    if (images == 2) { f.right = image_features_of(kept, h[1], "the right image" + rig, bytes); }
    all.push_back(f);
  }
  return all;
}

}  // namespace ftpy
