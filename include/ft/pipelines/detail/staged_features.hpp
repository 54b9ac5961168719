// SPDX-License-Identifier: Apache-2.0
/// @file A caller's keypoints of the next frame: checked, the best of them, in staging memory.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <limits>
#include <string>
#include <vector>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/keypoints/take_keypoints.hpp"
#include "ft/types/features.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// What features may be given.
struct feature_limits {
  int width = 0, height = 0;  ///< of the images
  pyramid_geometry geometry;
  bool right = false;   ///< the rig has a right image, and keypoints may have a column there
  bool depths = false;  ///< they may have a depth
  /// Without a right image depths must be given.
  bool needs_depths() const { return depths && !right; }
  float min_depth = 0, max_depth = std::numeric_limits<float>::infinity();
};

/// Checks one image's features. @throws bad_argument, naming the image
class feature_check {
public:
  /// @param name such as "left image"
  feature_check(image_features const& of, char const* name, int b, feature_limits const& limits)
      : of_(of), name_(name), b_(b), limits_(limits) {}

  void all() const {
    if (of_.count < 0) { refuse("count is " + std::to_string(of_.count) + ", must be 0 or more"); }
    arrays();
    for (int i = 0; i < of_.count; ++i) { keypoint(i); }
  }
  /// Of the image whose keypoints may have partners.
  void partners() const {
    if (!limits_.right && of_.right_x != nullptr) {
      refuse("right_x is given, the rig has no pair");
    }
    if (!limits_.depths && of_.depth != nullptr) {
      refuse("depth is given, a rig of one camera takes none");
    }
    if (limits_.needs_depths() && of_.depth == nullptr && of_.count > 0) {
      refuse("depth is null: an rgbd_rig needs it, NaN = none");
    }
    for (int i = 0; of_.depth != nullptr && i < of_.count; ++i) {
      float const z = of_.depth[i];
      if (z >= taken_keypoints_view::farthest && z <= std::numeric_limits<float>::max()) {
        refuse("depth " + std::to_string(i) + " is " + number_text(z) + ", must be below " +
               number_text(taken_keypoints_view::farthest) + " m; NaN = none");
      }
    }
  }
  void no_partners() const {
    if (of_.right_x != nullptr || of_.depth != nullptr) {
      refuse("right_x or depth is given, they belong to the left image");
    }
  }

private:
  void arrays() const {
    if (of_.descriptor_bytes != static_cast<int>(sizeof(descriptor))) {
      refuse("descriptor_bytes is " + std::to_string(of_.descriptor_bytes) + ", must be " +
             std::to_string(sizeof(descriptor)));
    }
    if (of_.count > 0 && of_.positions == nullptr) { refuse("positions is null"); }
    if (of_.count > 0 && of_.descriptors == nullptr) { refuse("descriptors is null"); }
    if (of_.octave != nullptr && of_.deviation != nullptr) {
      refuse("octave and deviation are given, must be one of them: an octave says both");
    }
  }
  void keypoint(int i) const {
    float const x = of_.positions[2 * i];
    float const y = of_.positions[2 * i + 1];
    auto const inside = [](float v, int size) { return v >= 0 && v < static_cast<float>(size); };
    if (!(inside(x, limits_.width) && inside(y, limits_.height))) {  // NaN, too
      refuse("position " + std::to_string(i) + " is (" + number_text(x) + ", " + number_text(y) +
             "), must be in [0, " + std::to_string(limits_.width) + ") x [0, " +
             std::to_string(limits_.height) + ")");
    }
    if (of_.octave != nullptr && !(of_.octave[i] >= 0 && of_.octave[i] < limits_.geometry.levels)) {
      refuse("octave " + std::to_string(i) + " is " + std::to_string(of_.octave[i]) +
             ", must be in [0, " + std::to_string(limits_.geometry.levels - 1) + "]");
    }
    number(of_.deviation, i, "deviation", std::numeric_limits<float>::min(),
           std::numeric_limits<float>::max());
    number(of_.angle, i, "angle", 0, 360);
    number(of_.score, i, "score", std::numeric_limits<float>::lowest(),
           std::numeric_limits<float>::max());
  }
  void number(float const* array, int i, char const* what, float low, float high) const {
    if (array == nullptr || (array[i] >= low && array[i] <= high)) { return; }
    refuse(std::string(what) + " " + std::to_string(i) + " is " + number_text(array[i]) +
           ", must be in [" + number_text(low) + ", " + number_text(high) + "]");
  }
  [[noreturn]] void refuse(std::string const& text) const {
    throw bad_argument("ft: the features of the " + std::string(name_) +
                       (b_ < 0 ? "" : " of camera pair " + std::to_string(b_)) + ": " + text);
  }

  image_features const& of_;
  char const* name_;
  int b_;  ///< -1 = there is one rig
  feature_limits const& limits_;
};

/// Owns the staging memory of a batch.
template <typename Exec>
class staged_features {
  static constexpr memory_space staging = staging_space<Exec>;

public:
  /// @param images of a rig @throws bad_argument, std::bad_alloc, cuda_error
  staged_features(int capacity, int images, int rigs, feature_limits const& limits)
      : limits_(limits), images_(images), best_(static_cast<std::size_t>(capacity)) {
    memory_ = owner<taken_keypoints_view, staging>(
        [&](carver& c, taken_keypoints_view& v) { carve(c, v, capacity, images * rigs, rigs); });
    std::fill_n(memory_->keypoints.count, images * rigs, 0);
    std::fill_n(memory_->of_levels, images * rigs, 0);
    std::fill_n(memory_->partners, rigs, 0);
  }
  taken_keypoints_view const& view() const { return memory_.view(); }
  allocated_bytes bytes() const { return {0, memory_.bytes()}; }

  /// Takes the features of rig b. Allocates nothing. @throws bad_argument; then they are not taken
  void take(int b, given_features const& given) {
    int const named = memory_->keypoints.batch > images_ ? b : -1;
    feature_check const left(given.left, images_ == 1 ? "image" : "left image", named, limits_);
    left.all();
    left.partners();
    bool const has_partners = given.left.right_x != nullptr || given.left.depth != nullptr;
    if (images_ == 1) {
      require(given.right.count == 0, "features of a right image are given, the rig has none");
    } else if (!has_partners) {
      feature_check const right(given.right, "right image", named, limits_);
      right.all();
      right.no_partners();
    }
    write(images_ * b, given.left);
    write_partners(b, given.left);
    if (images_ > 1) { write(images_ * b + 1, has_partners ? image_features{} : given.right); }
  }

private:
  /// The indices of those that are taken, ascending, in best_. @return their number
  int choose(image_features const& from) {
    int const capacity = memory_->keypoints.capacity;
    int const n = std::min(from.count, capacity);
    auto const first = best_.begin();
    for (int i = 0; i < n; ++i) { best_[static_cast<std::size_t>(i)] = i; }
    if (from.score == nullptr || n == from.count) { return n; }
    // A heap whose first one is the worst.
    auto const better = [&](int i, int k) {
      return from.score[i] > from.score[k] || (from.score[i] == from.score[k] && i < k);
    };
    std::make_heap(first, best_.end(), better);
    for (int i = n; i < from.count; ++i) {
      if (!better(i, best_.front())) { continue; }
      std::pop_heap(first, best_.end(), better);
      best_.back() = i;
      std::push_heap(first, best_.end(), better);
    }
    std::sort(first, best_.end());
    return n;
  }
  void write(int image, image_features const& from) {
    keypoints_view const to = memory_->keypoints.slice(image);
    memory_->of_levels[image] = from.level_positions ? 1 : 0;
    int const n = *to.count = choose(from);
    for (int k = 0; k < n; ++k) {
      int const i = best_[static_cast<std::size_t>(k)];
      to.x(k) = from.positions[2 * i];
      to.y(k) = from.positions[2 * i + 1];
      to.octave(k) = octave_of(from, i);
      to.angle(k) = from.angle != nullptr ? from.angle[i] : 0.0f;
      to.response(k) = from.score != nullptr ? from.score[i] : 0.0f;
      std::memcpy(&to.orb(k),
                  static_cast<unsigned char const*>(from.descriptors) +
                      static_cast<std::ptrdiff_t>(i) * from.descriptor_bytes,
                  sizeof(descriptor));
    }
  }
  /// @pre write() has chosen the keypoints
  void write_partners(int b, image_features const& from) {
    int const capacity = memory_->keypoints.capacity;
    int const n = memory_->keypoints.count[images_ * b];
    memory_->partners[b] = (from.right_x != nullptr ? taken_keypoints_view::has_right : 0) +
                           (from.depth != nullptr ? taken_keypoints_view::has_depth : 0);
    auto const first = static_cast<std::ptrdiff_t>(b) * capacity;
    for (int k = 0; k < n; ++k) {
      int const i = best_[static_cast<std::size_t>(k)];
      if (from.right_x != nullptr) { memory_->right_x[first + k] = from.right_x[i]; }
      if (from.depth == nullptr) { continue; }
      float const z = from.depth[i];
      bool const seen = z >= limits_.min_depth && z <= limits_.max_depth;
      memory_->depth[first + k] = seen ? z : -1.0f;
    }
  }
  /// The octave that was given, or the one whose deviation is nearest, as a ratio.
  int octave_of(image_features const& from, int i) const {
    if (from.octave != nullptr) { return from.octave[i]; }
    int octave = 0;
    if (from.deviation == nullptr) { return octave; }
    pyramid_geometry const& g = limits_.geometry;
    auto const wide = [](float v) { return static_cast<double>(v); };
    double const square = wide(from.deviation[i]) * wide(from.deviation[i]);
    while (octave + 1 < g.levels && square > wide(g.scale[octave]) * wide(g.scale[octave + 1])) {
      ++octave;
    }
    return octave;
  }

  feature_limits limits_;
  int images_ = 0;         ///< of a rig
  std::vector<int> best_;  ///< [capacity]
  owner<taken_keypoints_view, staging> memory_;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
