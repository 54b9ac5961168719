// SPDX-License-Identifier: Apache-2.0
/// @file Stage: the best keypoints of a caller whose arrays lie in executor memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/keypoints/take_keypoints.hpp"
#include "ft/types/features.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// What features may be given.
struct feature_limits {
  int width = 0, height = 0;  ///< of the images
  pyramid_geometry geometry;
  bool right = false;   ///< the rig has a right image, and keypoints may have a column there
  bool depths = false;  ///< they may have a depth
  float min_depth = 0, max_depth = std::numeric_limits<float>::infinity();

  /// Without a right image depths must be given.
  bool needs_depths() const { return depths && !right; }
};

/// Which number of a keypoint is out of range.
enum class feature_fault { none, position, octave, deviation, angle, score, depth };

inline constexpr float least_deviation = std::numeric_limits<float>::min();
inline constexpr float most_number = std::numeric_limits<float>::max();

FT_HOST_DEVICE inline feature_fault fault_of(image_features const& of, int i,
                                             feature_limits const& limits) {
  auto const inside = [](float v, int size) { return v >= 0 && v < static_cast<float>(size); };
  auto const within = [i](float const* array, float low, float high) {
    return array == nullptr || (array[i] >= low && array[i] <= high);
  };
  if (!(inside(of.positions[2 * i], limits.width) &&
        inside(of.positions[2 * i + 1], limits.height))) {
    return feature_fault::position;
  }
  if (of.octave != nullptr && !(of.octave[i] >= 0 && of.octave[i] < limits.geometry.levels)) {
    return feature_fault::octave;
  }
  if (!within(of.deviation, least_deviation, most_number)) { return feature_fault::deviation; }
  if (!within(of.angle, 0, 360)) { return feature_fault::angle; }
  if (!within(of.score, -most_number, most_number)) { return feature_fault::score; }
  bool const is_far = of.depth != nullptr && of.depth[i] >= taken_keypoints_view::farthest &&
                      of.depth[i] <= most_number;
  return is_far ? feature_fault::depth : feature_fault::none;
}

/// The octave that was given, or the one whose deviation is nearest, as a ratio.
FT_HOST_DEVICE inline int octave_of(image_features const& from, int i, pyramid_geometry const& g) {
  if (from.octave != nullptr) { return from.octave[i]; }
  int octave = 0;
  if (from.deviation == nullptr) { return octave; }
  auto const wide = [](float v) { return static_cast<double>(v); };
  double const square = wide(from.deviation[i]) * wide(from.deviation[i]);
  while (octave + 1 < g.levels && square > wide(g.scale[octave]) * wide(g.scale[octave + 1])) {
    ++octave;
  }
  return octave;
}

/// Keypoint i becomes keypoint k.
FT_HOST_DEVICE inline void copy_keypoint(image_features const& from, int i,
                                         pyramid_geometry const& geometry, keypoints_view const& to,
                                         int k) {
  to.x(k) = from.positions[2 * i];
  to.y(k) = from.positions[2 * i + 1];
  to.octave(k) = octave_of(from, i, geometry);
  to.angle(k) = from.angle != nullptr ? from.angle[i] : 0.0f;
  to.response(k) = from.score != nullptr ? from.score[i] : 0.0f;
#if defined(__CUDA_ARCH__)
  to.orb(k) = static_cast<descriptor const*>(from.descriptors)[i];
#else
  std::memcpy(&to.orb(k),
              static_cast<unsigned char const*>(from.descriptors) +
                  static_cast<std::ptrdiff_t>(i) * from.descriptor_bytes,
              sizeof(descriptor));
#endif
}
/// The same of its partner.
FT_HOST_DEVICE inline void copy_partner(image_features const& from, int i,
                                        feature_limits const& limits,
                                        taken_keypoints_view const& to, std::ptrdiff_t k) {
  if (from.right_x != nullptr) { to.right_x[k] = from.right_x[i]; }
  if (from.depth == nullptr) { return; }
  float const z = from.depth[i];
  to.depth[k] = z >= limits.min_depth && z <= limits.max_depth ? z : -1.0f;
}
FT_HOST_DEVICE inline int partners_of(image_features const& from) {
  return (from.right_x != nullptr ? taken_keypoints_view::has_right : 0) +
         (from.depth != nullptr ? taken_keypoints_view::has_depth : 0);
}

/// Item: an image.
struct gather_best {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int image, feature_limits const& limits,
                                 int images, image_features const* given,
                                 taken_keypoints_view const& to) const {
    image_features const from = given[image];
    if (!from.on_device) { return; }
    keypoints_view const mine = to.keypoints.slice(image);
    bool const has_partners = image % images == 0;
    int const rig = image / images;
    auto const is_usable = [&](int i) {
      return i < from.count && fault_of(from, i, limits) == feature_fault::none;
    };
    std::uint32_t const lowest = lowest_key(g, from, mine.capacity, is_usable);
    int room = mine.capacity;  // for keypoints of the lowest score
    room -= count(g, from, is_usable, [&](std::uint32_t key) { return key > lowest; });
    int taken = 0, equal = 0;
    for (int first = 0; first < from.count; first += g.size()) {
      int const i = first + g.rank();
      bool const usable = is_usable(i);
      std::uint32_t const key = usable ? key_of(from, i) : 0;
      bool const is_lowest = usable && key == lowest;
      int all_equal = 0, all_taken = 0;
      int const before = equal + g.exclusive_count(is_lowest, all_equal);
      bool const take = usable && (key > lowest || (is_lowest && before < room));
      int const k = taken + g.exclusive_count(take, all_taken);
      if (take) {
        copy_keypoint(from, i, limits.geometry, mine, k);
        if (has_partners) {
          copy_partner(from, i, limits, to, static_cast<std::ptrdiff_t>(rig) * mine.capacity + k);
        }
      }
      equal += all_equal;
      taken += all_taken;
    }
    if (g.rank() != 0) { return; }
    *mine.count = taken;
    to.of_levels[image] = from.level_positions ? 1 : 0;
    if (has_partners) { to.partners[rig] = partners_of(from); }
  }

private:
  /// Larger for higher scores, equal for equal ones.
  FT_HOST_DEVICE static std::uint32_t key_of(image_features const& from, int i) {
    if (from.score == nullptr) { return 0; }
    float const score = from.score[i] + 0.0f;  // -0 becomes 0
    std::uint32_t bits;
    memcpy(&bits, &score, sizeof bits);
    return (bits & 0x80000000u) != 0 ? ~bits : bits | 0x80000000u;
  }
  template <typename Group, typename Usable, typename Test>
  FT_HOST_DEVICE static int count(Group g, image_features const& from, Usable const& is_usable,
                                  Test const& test) {
    int n = 0;
    for (int i = g.rank(); i < from.count; i += g.size()) {
      n += is_usable(i) && test(key_of(from, i)) ? 1 : 0;
    }
    return g.reduce(n, sum_op{});
  }
  /// The greatest key that `capacity` keypoints have or exceed; 0 if there are fewer.
  template <typename Group, typename Usable>
  FT_HOST_DEVICE static std::uint32_t lowest_key(Group g, image_features const& from, int capacity,
                                                 Usable const& is_usable) {
    std::uint32_t lowest = 0;
    if (from.score == nullptr || from.count <= capacity) { return lowest; }
    for (std::uint32_t bit = 0x80000000u; bit != 0; bit >>= 1) {
      std::uint32_t const next = lowest | bit;
      int const n = count(g, from, is_usable, [&](std::uint32_t key) { return key >= next; });
      lowest = n >= capacity ? next : lowest;
    }
    return lowest;
  }
};

}  // namespace detail

/// Copies the keypoints of images whose features have `on_device`, as image_features says, and
/// leaves others. Asynchronous on `exec`; allocates nothing; one launch.
/// @param images of a rig; the first one's keypoints may have partners
/// @param given [to.keypoints.batch] staging or executor memory
template <typename Exec>
void gather_features(Exec const& exec, detail::feature_limits const& limits, int images,
                     image_features const* given, taken_keypoints_view const& to) {
  for_each_item<per_block<256>>(exec, to.keypoints.batch, detail::gather_best{}, limits, images,
                                given, to);
}

}  // namespace FT_ABI
}  // namespace ft
