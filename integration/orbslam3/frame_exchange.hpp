// SPDX-License-Identifier: Apache-2.0
/// @file Frames between ORB-SLAM3 and the device: the buffers and the frames in them, the data to
/// send, and the transfer of extraction and stereo results into a frame.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>
#include <type_traits>
#include <vector>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/error.hpp"
#include "integration/orbslam3/frame_fields.hpp"
#include "integration/orbslam3/helper_threads.hpp"
#include "integration/orbslam3/plain_types.hpp"
#include "integration/orbslam3/settings_of.hpp"

namespace ft::orbslam3 {

inline constexpr int grey_type = 0;  ///< CV_8UC1

/// A frame that the accelerator cannot take: images of another size or type, or more keypoints than
/// there is room for. Nothing has changed, and the next frame may be taken.
class frame_refused : public bad_argument {
public:
  using bad_argument::bad_argument;
};

/// The device's buffers and the frames in them.
template <typename Frame>
class frame_exchange {
public:
  frame_exchange(device_tracker& device, settings const& s) : device_(&device), settings_(s) {}

  pyramid_geometry const& levels() const { return levels_; }
  static bounds bounds_of(Frame const& frame) {
    return {frame.mnMinX, frame.mnMinY, frame.mnMaxX, frame.mnMaxY};
  }
  /// Whether the keypoints of two cameras are searched. Decided by the settings: a frame's
  /// constructor calls stereo before it sets Nleft.
  bool two_cameras() const { return device_->cameras() == 2; }
  /// The keypoints with the positions that are searched. @param frame or keyframe, likewise below
  template <typename Any>
  auto const& keys(Any const& frame, int camera) const {
    return camera == 1 ? frame.mvKeysRight : two_cameras() ? frame.mvKeys : frame.mvKeysUn;
  }
  template <typename Any>
  int count(Any const& frame, int camera) const {
    if (camera == 1 && !two_cameras()) { return 0; }
    return static_cast<int>(camera == 1 ? frame.mvKeysRight.size() : frame.mvKeys.size());
  }
  template <typename Any>
  bool fits(Any const& frame) const {
    return std::max(count(frame, 0), count(frame, 1)) <= device_->capacity();
  }
  /// Calls visit(index in the frame, number on the device) for all keypoints that may hold points.
  template <typename Any, typename Visit>
  void for_each_number(Any const& frame, Visit const& visit) const {
    int const n = count(frame, 0);
    for (int i = 0; i < n; ++i) { visit(static_cast<std::size_t>(i), i); }
    int const right = count(frame, 1);
    for (int i = 0; i < right; ++i) {
      visit(static_cast<std::size_t>(n + i), device_->capacity() + i);
    }
  }

  /// The buffer that the next extraction fills. It holds no frame until took().
  int begin_extraction() {
    int const b = 1 - newest_;
    resident_[b] = {};
    return b;
  }
  /// Fills what does not depend on the images, and takes the frame's memory for as many keypoints
  /// as the last extraction found and a few more: done while the device extracts.
  void prepare(Frame& frame) const {
    fill_scale_tables(levels_, settings_.scale_factor, frame);
    frame_arrays const& a = device_->frame(newest_);
    for (int c = 0; c < settings_.images; ++c) {
      auto const room = static_cast<std::size_t>(a.count[c] + a.count[c] / 8);
      auto& keypoints = c == 0 ? frame.mvKeys : frame.mvKeysRight;
      auto& descriptors = c == 0 ? frame.mDescriptors : frame.mDescriptorsRight;
      keypoints.resize(room);
      descriptors.create(static_cast<int>(room), 32, grey_type);
    }
  }
  /// Fills the frame from the extraction in buffer `b`.
  void took(int b, Frame& frame) {
    resident& r = resident_[b];
    r.there = r.extracted = r.full = true;
    r.id = frame.mnId;
    newest_ = b;
    frame_arrays const& a = device_->frame(b);
    device_->helpers().share(2 * settings_.images, [&](int part) {
      switch (part) {
        case 0:
          return fill_keypoints(a, 0, frame.mvKeys);
        case 1:
          return fill_descriptors(a, 0, frame.mDescriptors);
        case 2:
          return fill_keypoints(a, 1, frame.mvKeysRight);
        default:
          return fill_descriptors(a, 1, frame.mDescriptorsRight);
      }
    });
    frame.monoLeft = a.mono[0];
    frame.N = a.count[0];
    frame.Nleft = -1;
    frame.Nright = -1;
    if (settings_.images == 2) { frame.monoRight = a.mono[1]; }
    if (device_->cameras() == 2) {
      frame.Nleft = a.count[0];
      frame.Nright = a.count[1];
      frame.N = a.count[0] + a.count[1];
    }
  }

  /// The buffer that holds a frame, -1 = none.
  int find(Frame const& frame) const {
    for (int const b : {newest_, 1 - newest_}) {
      resident const& r = resident_[b];
      if (r.there && r.id == frame.mnId && looks_like(b, frame)) { return b; }
    }
    return -1;
  }
  /// Frame numbers restart with each reset, so the number alone does not identify a frame.
  bool looks_like(int b, Frame const& frame) const {
    frame_arrays const& a = device_->frame(b);
    int const n = count(frame, 0);
    if (a.count[0] != n || (two_cameras() && a.count[1] != count(frame, 1))) { return false; }
    for (int const i : {0, n / 2, n - 1}) {
      if (i >= 0 && i < n && a.angle[i] != frame.mvKeys[static_cast<std::size_t>(i)].angle) {
        return false;
      }
    }
    return true;
  }
  bool is_extracted(Frame const& frame) const {
    int const b = find(frame);
    return b >= 0 && b == newest_ && resident_[b].extracted;
  }
  /// Waits for the stereo matches that the last extraction has enqueued, and fills them in.
  void take_stereo(Frame& frame) {
    detail::require(is_extracted(frame), "the frame is not the one that was extracted last");
    detail::require(settings_.images == 2, "stereo needs settings with two images");
    device_->settle();
    resident_[newest_].settled = true;
    two_cameras() ? fill_fisheye_stereo(frame) : fill_stereo(frame);
  }

  /// The buffer with all of a frame. @param keep a buffer that must not be reused, -1 = none
  int bind(Frame const& frame, int keep) {
    require_keys(frame);
    int b = find(frame);
    if (b < 0 || !resident_[b].full) { b = load(frame, keep); }
    if (!resident_[b].checked) { check(b, frame); }
    return b;
  }
  /// The buffer with those parts of a last frame that the search needs.
  int bind_last(Frame const& frame, int keep) {
    require_keys(frame);
    int b = find(frame);
    if (b >= 0 && b != keep) { return b; }
    b = send_angles(frame, keep);
    resident_[b].there = true;
    resident_[b].id = frame.mnId;
    return b;
  }
  /// Sends counts, angles and octaves of a frame or a keyframe. Returns the buffer, which then
  /// holds no frame.
  template <typename Any>
  int send_angles(Any const& frame, int keep) {
    int const b = 1 - keep;
    resident_[b] = {};
    frame_arrays const& a = device_->frame(b);
    for (int c = 0; c < 2; ++c) {
      put_count(a, c, count(frame, c));
      put_angles(a, c, count(frame, c), keys(frame, c));
    }
    device_->send(b, frame_part::octaves);
    return b;
  }

  void clear() {
    for (auto& r : resident_) { r = {}; }
  }

private:
  struct resident {
    bool there = false;
    unsigned long id = 0;
    bool extracted = false;  ///< by extract()
    bool settled = false;    ///< nothing of the extraction is in flight
    bool full = false;       ///< positions and descriptors, not only the parts of a last frame
    bool checked = false;    ///< positions and stereo are equal to the frame's
  };

  /// Sends a frame that was not extracted here.
  int load(Frame const& frame, int keep) {
    int const there = find(frame);
    int const b = there >= 0 ? there : keep >= 0 ? 1 - keep : 1 - newest_;
    resident_[b] = {};
    frame_arrays const& a = device_->frame(b);
    auto const& left = keys(frame, 0);
    put_keypoints(a, 0, left, frame.mDescriptors, 0);
    if (two_cameras()) {
      // The constructor of Frame puts both into one matrix after stereo.
      int const n = static_cast<int>(left.size());
      bool const joined = frame.mDescriptors.rows == n + static_cast<int>(frame.mvKeysRight.size());
      put_keypoints(a, 1, frame.mvKeysRight, joined ? frame.mDescriptors : frame.mDescriptorsRight,
                    joined ? n : 0);
    } else {
      put_count(a, 1, 0);
    }
    a.mono[0] = two_cameras() ? frame.monoLeft : 0;
    a.mono[1] = two_cameras() ? frame.monoRight : 0;
    device_->send(b, frame_part::keypoints);
    resident_[b].there = true;
    resident_[b].full = true;
    resident_[b].id = frame.mnId;
    newest_ = b;
    return b;
  }

  void fill_stereo(Frame& frame) const {
    frame_arrays const& a = device_->frame(newest_);
    frame.mvuRight.assign(a.right_x, a.right_x + a.count[0]);
    frame.mvDepth.assign(a.depth, a.depth + a.count[0]);
  }
  void fill_fisheye_stereo(Frame& frame) const {
    frame_arrays const& a = device_->frame(newest_);
    auto const left = static_cast<std::size_t>(a.count[0]);
    frame.mvLeftToRightMatch.resize(left);
    frame.mvStereo3Dpoints.resize(left);
    frame.mvuRight.assign(left, -1.0f);
    frame.mvDepth.assign(a.depth, a.depth + a.count[0]);
    for (int i = 0; i < a.count[0]; ++i) {
      auto const at = static_cast<std::size_t>(i);
      frame.mvLeftToRightMatch[at] = a.partner[i] < 0 ? -1 : a.partner[i] - a.capacity;
      vec3<float> const& p = a.point[i];
      frame.mvStereo3Dpoints[at] =
          typename std::decay_t<decltype(frame.mvStereo3Dpoints)>::value_type(p.x, p.y, p.z);
    }
    frame.mnCloseMPs = 0;  // the original's value: it counts none
    frame.mvRightToLeftMatch.assign(a.partner + a.capacity, a.partner + a.capacity + a.count[1]);
  }

  template <typename Keypoint>
  void fill_keypoints(frame_arrays const& a, int image, std::vector<Keypoint>& keypoints) const {
    int const n = a.count[image];
    int const first = image * a.capacity;
    keypoints.resize(static_cast<std::size_t>(n));
    for (int i = 0; i < n; ++i) {
      Keypoint& k = keypoints[static_cast<std::size_t>(i)];
      int const at = first + i;
      k.pt.x = a.x[at];
      k.pt.y = a.y[at];
      k.octave = a.octave[at];
      k.size = static_cast<float>(levels_.patch_size(k.octave));
      k.angle = a.angle[at];
      k.response = a.response[at];
    }
  }
  template <typename Matrix>
  void fill_descriptors(frame_arrays const& a, int image, Matrix& descriptors) const {
    int const n = a.count[image];
    std::uint32_t const* const from = a.descriptor + 8 * (image * a.capacity);
    if (n == 0) {
      descriptors = Matrix{};  // as the original's: it has no columns either
      return;
    }
    if (n <= descriptors.rows) {
      descriptors.resize(static_cast<std::size_t>(n));  // keeps the memory
    } else {
      descriptors.create(n, 32, grey_type);
    }
    auto const step = static_cast<std::size_t>(descriptors.step);
    if (step == 32) {
      std::memcpy(descriptors.data, from, 32 * static_cast<std::size_t>(n));
      return;
    }
    for (int i = 0; i < n; ++i) {
      std::memcpy(descriptors.data + static_cast<std::size_t>(i) * step, from + 8 * i, 32);
    }
  }

  void put_count(frame_arrays const& a, int image, int n) const {
    if (n > a.capacity) {
      throw frame_refused("ft: the frame has " + std::to_string(n) +
                          " keypoints in an image, there is room for " +
                          std::to_string(a.capacity) + ": see settings::most_keypoints");
    }
    a.count[image] = n;
  }
  template <typename Keypoints>
  static void put_angles(frame_arrays const& a, int image, int n, Keypoints const& keypoints) {
    for (int i = 0; i < n; ++i) {
      auto const& k = keypoints[static_cast<std::size_t>(i)];
      a.angle[image * a.capacity + i] = k.angle;
      a.octave[image * a.capacity + i] = k.octave;
    }
  }
  template <typename Keypoints, typename Matrix>
  void put_keypoints(frame_arrays const& a, int image, Keypoints const& keypoints,
                     Matrix const& descriptors, int first_row) const {
    int const n = static_cast<int>(keypoints.size());
    put_count(a, image, n);
    put_angles(a, image, n, keypoints);
    detail::require(n == 0 || descriptors.rows >= first_row + n,
                    "there are fewer descriptors than keypoints");
    for (int i = 0; i < n; ++i) {
      int const at = image * a.capacity + i;
      auto const& k = keypoints[static_cast<std::size_t>(i)];
      a.x[at] = k.pt.x;
      a.y[at] = k.pt.y;
      std::memcpy(a.descriptor + 8 * at,
                  descriptors.data + static_cast<std::size_t>(first_row + i) *
                                         static_cast<std::size_t>(descriptors.step),
                  32);
    }
  }

  /// extract() leaves mvKeysUn empty.
  void require_keys(Frame const& frame) const {
    detail::require(keys(frame, 0).size() == frame.mvKeys.size(),
                    "mvKeysUn and mvKeys differ in length: undistort the frame's keypoints first");
  }

  /// Sends the values that the CPU has computed differently: undistorted positions, stereo.
  void check(int b, Frame const& frame) {
    if (!resident_[b].settled) { device_->settle(); }
    frame_arrays const& a = device_->frame(b);
    bool moved = false;
    for (int c = 0; c < (two_cameras() ? 2 : 1); ++c) {
      replace_positions(a, c, keys(frame, c), moved);
    }
    if (moved) { device_->send(b, frame_part::positions); }
    if (settings_.left.kind == lens::kannala_brandt) {
      if (replace_partners(a, frame.mvLeftToRightMatch, frame.mvRightToLeftMatch)) {
        device_->send(b, frame_part::partner);
      }
    } else if (settings_.bf != 0 && replace_right_columns(a, frame.mvuRight)) {
      device_->send(b, frame_part::right_x);
    }
    resident_[b].checked = true;
  }

  device_tracker* device_;
  settings settings_;
  pyramid_geometry levels_ = pyramid_geometry::make(settings_.width, settings_.height,
                                                    settings_.levels, settings_.scale_factor);
  resident resident_[device_tracker::buffers];
  int newest_ = 0;
};

}  // namespace ft::orbslam3
