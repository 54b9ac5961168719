// SPDX-License-Identifier: Apache-2.0
/// @file Inputs of the section `words`, without types of ft: a vocabulary, bags of words of a long
/// way, frames and keyframes that see known points, pairs of frames of one camera. The same for the
/// same seed.
#pragma once

#include <cstdint>
#include <vector>

namespace bench {

/// Laid out as ft::descriptor.
struct bits_256 {
  std::uint32_t words[8];
};

/// The vocabulary of golden_words called synth_k10_L6, or the same rule with other levels. Arrays
/// over the nodes, as in ft::vocabulary_arrays.
struct drawn_tree {
  static constexpr int branching = 10;
  int levels = 0;
  std::vector<int> parent, word;
  std::vector<double> weight;
  std::vector<bits_256> orb;

  /// A million words (6 levels) take seconds: made at the first call. Not thread-safe.
  static drawn_tree const& of(int levels);
};

/// Descriptors near words of the tree, each equally likely: the worst case for caches.
std::vector<bits_256> draw_descriptors(drawn_tree const& tree, int count, unsigned seed);

/// The distinct words of a frame, ascending; values add up to 1.
struct drawn_bag {
  std::vector<std::uint32_t> word;
  std::vector<double> value;
};
/// The most words of a bag.
inline constexpr int bag_capacity = 1200;

/// Keyframe `number` of a way: 1000 words, of which 700 are the preceding one's as well, and up to
/// 150 that are frequent everywhere.
drawn_bag draw_keyframe_bag(int words, int number);
/// A frame a third of the way behind that keyframe: a fifth of its words are not those of the way.
drawn_bag draw_query_bag(int words, int number, unsigned seed);

struct drawn_image {
  std::vector<float> x, y, angle;
  std::vector<int> octave;
  std::vector<bits_256> orb;

  int size() const { return static_cast<int>(x.size()); }
};

/// A pinhole camera of 752 x 480 pixels.
struct drawn_camera {
  static constexpr int width = 752, height = 480, levels = 8;
  static constexpr float scale = 1.2f;
  static constexpr float focal = 435.0f, cx = 367.2f, cy = 252.2f;
};

/// A map point, metres.
struct drawn_point {
  float x, y, z;
  float min_distance, max_distance;
  bits_256 orb;
};

/// A frame of 1200 keypoints, and keyframes of as many, of which 480 hold points of the map. The
/// last keyframe sees the frame's place; the others only look alike.
struct drawn_place {
  static constexpr int features = 1200, held = 480;
  drawn_image frame;
  std::vector<drawn_image> keyframes;    ///< their positions are not drawn
  std::vector<std::vector<int>> holder;  ///< [keyframes][features] point, -1 = none
  std::vector<drawn_point> points;
};
/// @param seen of the points of the last keyframe, those that the frame sees
drawn_place draw_place(drawn_tree const& tree, int keyframes, int seen, unsigned seed);

/// Two frames of one camera that moved sideways, of 6000 keypoints: five times as many as are
/// tracked. Half of the first one's are seen again, if the second image has room for them.
struct drawn_pair {
  static constexpr int features = 6000;
  drawn_image first, second;
};
drawn_pair draw_pair(unsigned seed);

}  // namespace bench
