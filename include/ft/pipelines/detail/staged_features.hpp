// SPDX-License-Identifier: Apache-2.0
/// @file A caller's keypoints of the next frame: checked, the best of them, in staging memory.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>
#include <type_traits>
#include <vector>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/keypoints/gather_features.hpp"
#include "ft/kernels/keypoints/take_keypoints.hpp"
#include "ft/types/features.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Checks one image's features. @throws bad_argument, naming the image
class feature_check {
public:
  /// @param name such as "left image"
  feature_check(image_features const& of, char const* name, int b, feature_limits const& limits)
      : of_(of), name_(name), b_(b), limits_(limits) {}

  void all() const {
    constexpr int most = 1 << 24;
    if (of_.count < 0 || of_.count > most) {
      refuse("count is " + std::to_string(of_.count) + ", must be in [0, " + std::to_string(most) +
             "]");
    }
    arrays();
    for (int i = 0; !of_.on_device && i < of_.count; ++i) { keypoint(i); }
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
  }
  void no_partners() const {
    if (of_.right_x != nullptr || of_.depth != nullptr) {
      refuse("right_x or depth is given, they belong to the left image");
    }
  }

private:
  void arrays() const {
    if (of_.count > 0 && of_.descriptor_bytes != static_cast<int>(sizeof(descriptor))) {
      refuse("descriptor_bytes is " + std::to_string(of_.descriptor_bytes) + ", must be " +
             std::to_string(sizeof(descriptor)));
    }
    if (of_.count > 0 && of_.positions == nullptr) { refuse("positions is null"); }
    if (of_.count > 0 && of_.descriptors == nullptr) { refuse("descriptors is null"); }
    if (of_.on_device && reinterpret_cast<std::uintptr_t>(of_.descriptors) % alignof(descriptor)) {
      refuse("descriptors on the device are not aligned to " + std::to_string(alignof(descriptor)) +
             " bytes");
    }
    if (of_.octave != nullptr && of_.deviation != nullptr) {
      refuse("octave and deviation are given, must be one of them: an octave says both");
    }
  }
  void keypoint(int i) const {
    switch (fault_of(of_, i, limits_)) {
      case feature_fault::none:
        return;
      case feature_fault::position:
        refuse("position " + std::to_string(i) + " is (" + number_text(of_.positions[2 * i]) +
               ", " + number_text(of_.positions[2 * i + 1]) + "), must be in [0, " +
               std::to_string(limits_.width) + ") x [0, " + std::to_string(limits_.height) + ")");
      case feature_fault::octave:
        refuse("octave " + std::to_string(i) + " is " + std::to_string(of_.octave[i]) +
               ", must be in [0, " + std::to_string(limits_.geometry.levels - 1) + "]");
      case feature_fault::deviation:
        number(of_.deviation, i, "deviation", least_deviation, most_number);
      case feature_fault::angle:
        number(of_.angle, i, "angle", 0, 360);
      case feature_fault::score:
        number(of_.score, i, "score", -most_number, most_number);
      case feature_fault::depth:
        refuse("depth " + std::to_string(i) + " is " + number_text(of_.depth[i]) +
               ", must be below " + number_text(taken_keypoints_view::farthest) + " m; NaN = none");
    }
  }
  [[noreturn]] void number(float const* array, int i, char const* what, float low,
                           float high) const {
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
    memory_ = owner<memory, staging>([&](carver& c, memory& m) {
      carve(c, m.taken, capacity, images * rigs, rigs);
      c.place({images * rigs}, m.given);
    });
    std::fill_n(memory_->taken.keypoints.count, images * rigs, 0);
    std::fill_n(memory_->taken.of_levels, images * rigs, 0);
    std::fill_n(memory_->taken.partners, rigs, 0);
    std::fill_n(memory_->given, images * rigs, image_features{});
  }
  taken_keypoints_view const& view() const { return memory_->taken; }
  image_features const* given() const { return memory_->given; }  ///< [images of all rigs]
  feature_limits const& limits() const { return limits_; }
  allocated_bytes bytes() const { return {0, memory_.bytes()}; }

  /// Takes the features of rig b. Allocates nothing. @throws bad_argument; then they are not taken
  void take(int b, given_features const& given) {
    int const named = view().keypoints.batch > images_ ? b : -1;
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
    image_features const left_there = reachable(given.left);
    image_features const right_there =
        images_ == 1 || has_partners ? image_features{} : reachable(given.right);
    write(images_ * b, left_there);
    if (!given.left.on_device) { write_partners(b, given.left); }
    if (images_ > 1) { write(images_ * b + 1, right_there); }
  }

private:
  struct memory {
    taken_keypoints_view taken;
    image_features* given;
  };

  /// @param array replaced by the address through which stages read it
  template <typename T>
  static void reach(T const*& array) {
    if (array == nullptr) { return; }
    if constexpr (!std::is_void<T>::value) {
      require(reinterpret_cast<std::uintptr_t>(array) % alignof(T) == 0,
              "image_features::on_device: an array is not aligned as its numbers are");
    }
    array = static_cast<T const*>(Exec::host_address(array));
    require(array != nullptr,
            "image_features::on_device: an array is not in memory that the device reads");
  }
  /// The same with the addresses through which stages read arrays in executor memory.
  static image_features reachable(image_features from) {
    if (!from.on_device || from.count == 0) { return from; }
    reach(from.positions);
    reach(from.descriptors);
    reach(from.octave);
    reach(from.deviation);
    reach(from.angle);
    reach(from.score);
    reach(from.right_x);
    reach(from.depth);
    return from;
  }
  /// The indices of those that are taken, ascending, in best_. @return their number
  int choose(image_features const& from) {
    int const capacity = view().keypoints.capacity;
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
    memory_->given[image] = from;
    if (from.on_device) { return; }
    keypoints_view const to = view().keypoints.slice(image);
    view().of_levels[image] = from.level_positions ? 1 : 0;
    int const n = *to.count = choose(from);
    for (int k = 0; k < n; ++k) {
      copy_keypoint(from, best_[static_cast<std::size_t>(k)], limits_.geometry, to, k);
    }
  }
  /// @pre write() has chosen the keypoints
  void write_partners(int b, image_features const& from) {
    int const n = view().keypoints.count[images_ * b];
    view().partners[b] = partners_of(from);
    auto const first = static_cast<std::ptrdiff_t>(b) * view().keypoints.capacity;
    for (int k = 0; k < n; ++k) {
      copy_partner(from, best_[static_cast<std::size_t>(k)], limits_, view(), first + k);
    }
  }

  feature_limits limits_;
  int images_ = 0;         ///< of a rig
  std::vector<int> best_;  ///< [capacity]
  owner<memory, staging> memory_;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
