// SPDX-License-Identifier: Apache-2.0
/// @file Inputs and outputs of a frame_tracker.
#pragma once

#include <cstddef>
#include <iterator>

#include "ft/core/config.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

/// Slots of map points in host memory. Converts from anything with data() and size(), which must
/// live until the call that takes the slots returns.
struct slot_list {
  int const* data = nullptr;
  int count = 0;

  slot_list() = default;
  slot_list(int const* first, int n) : data(first), count(n) {}
  template <typename Slots>
  slot_list(Slots const& slots)  // NOLINT(google-explicit-constructor): it is a view of them
      : data(slots.data()), count(static_cast<int>(slots.size())) {}
};

/// Inputs for one frame of one rig.
struct frame_input {
  /// T_cw expected for this frame, from a motion model or an IMU. Must be finite. Not checked to be
  /// a rotation.
  pose T_predicted = pose::identity();
  /// The local map, in search order, at most tracker_params::local_points slots. A slot that is
  /// outside the map or was never written is not in view.
  slot_list local_slots{};
};

/// A keypoint of a tracked frame.
struct tracked_keypoint {
  int number;         ///< in its camera's image
  vec2<float> pixel;  ///< position
  int octave;
  int slot;     ///< of the map point matched to it, an inlier; -1 = none
  float depth;  ///< metres, -1 = no stereo match; of left keypoints
  vec3<float>
      point;    ///< left camera's frame, or the body's of a multi_rig, metres; 0 without depth
  int partner;  ///< number of its stereo partner in the other image, of unrectified pairs;
                ///< -1 = none
};

/// The keypoints of one camera of a tracked frame, as a range of tracked_keypoint.
class tracked_keypoints {
public:
  class iterator {
  public:
    using iterator_category = std::input_iterator_tag;
    using value_type = tracked_keypoint;
    using difference_type = std::ptrdiff_t;
    using pointer = void;
    using reference = tracked_keypoint;

    iterator(tracked_keypoints const& of, int i) : of_(&of), i_(i) {}
    tracked_keypoint operator*() const { return (*of_)[i_]; }
    iterator& operator++() {
      ++i_;
      return *this;
    }
    iterator operator++(int) {
      iterator const before = *this;
      ++i_;
      return before;
    }
    bool operator==(iterator const& other) const { return i_ == other.i_; }
    bool operator!=(iterator const& other) const { return i_ != other.i_; }

  private:
    tracked_keypoints const* of_;
    int i_;
  };

  tracked_keypoints(tracked_frame_view const& result, int b, int camera)
      : r_(result), b_(b), camera_(camera) {}

  int size() const { return camera_ < r_.cameras ? r_.keypoints[b_ * r_.cameras + camera_] : 0; }
  iterator begin() const { return {*this, 0}; }
  iterator end() const { return {*this, size()}; }
  /// @param i below size()
  tracked_keypoint operator[](int i) const {
    std::ptrdiff_t const at =
        static_cast<std::ptrdiff_t>(b_) * r_.numbers() + camera_ * r_.capacity + i;
    tracked_keypoint k{i, {r_.x[at], r_.y[at]}, r_.octave[at], r_.holder[at], -1, {0, 0, 0}, -1};
    int const partner = r_.partner[at];
    if (partner >= 0) { k.partner = partner - (partner < r_.capacity ? 0 : r_.capacity); }
    if (camera_ < r_.depth_cameras) {
      std::ptrdiff_t const left =
          (static_cast<std::ptrdiff_t>(b_) * r_.depth_cameras + camera_) * r_.capacity + i;
      k.depth = r_.depth[left];
      k.point = r_.point[left];
    }
    return k;
  }

private:
  tracked_frame_view r_;
  int b_;
  int camera_;
};

/// The result of one rig. Valid until the tracker's next call.
class tracked_frame {
public:
  tracked_frame(tracked_frame_view const& result, int b) : r_(result), b_(b) {}

  pose const& T_cw() const { return r_.T_cw[b_]; }
  int matches() const { return r_.matches[b_]; }  ///< keypoints matched by the last search
  /// Of the last pose optimisation; matches() if there was none.
  int inliers() const { return r_.inliers[b_]; }
  tracked_keypoints left() const { return {r_, b_, 0}; }
  /// Empty for a rectified pair, whose right keypoints are not tracked.
  tracked_keypoints right() const { return {r_, b_, 1}; }
  /// Of camera c of the rig.
  tracked_keypoints camera(int c) const { return {r_, b_, c}; }
  /// Whether entry i of the local map passed the frustum test.
  bool in_view(int i) const {
    return r_.in_view[static_cast<std::ptrdiff_t>(b_) * r_.local_points + i] != 0;
  }

private:
  tracked_frame_view r_;
  int b_;
};

}  // namespace FT_ABI
}  // namespace ft
