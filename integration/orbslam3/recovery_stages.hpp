// SPDX-License-Identifier: Apache-2.0
/// @file Words and relocalisation between ORB-SLAM3's members and the device's arrays.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <utility>
#include <vector>

#include "ft/core/error.hpp"
#include "integration/orbslam3/frame_exchange.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft::orbslam3 {

namespace word_detail {

/// Nleft of a frame, NLeft of a keyframe: -1 where there is one camera.
template <typename Frame>
auto left_keypoints(Frame const& f, int) -> decltype(static_cast<int>(f.Nleft)) {
  return f.Nleft;
}
template <typename KeyFrame>
auto left_keypoints(KeyFrame const& f, long) -> decltype(static_cast<int>(f.NLeft)) {
  return f.NLeft;
}

/// The keypoints that a frame's descriptors belong to, in their order.
template <typename Frame>
struct described_keypoints {
  Frame const* frame;
  int left;  ///< -1 = one camera

  explicit described_keypoints(Frame const& f) : frame(&f), left(left_keypoints(f, 0)) {}

  /// Whether there are as many descriptors, and no more than `capacity`.
  bool complete(int capacity) const {
    std::size_t const n =
        left < 0 ? frame->mvKeysUn.size() : frame->mvKeys.size() + frame->mvKeysRight.size();
    bool const split = left < 0 || frame->mvKeys.size() == static_cast<std::size_t>(left);
    return split && n <= static_cast<std::size_t>(capacity) &&
           static_cast<std::size_t>(frame->mDescriptors.rows) == n;
  }
  int count() const { return frame->mDescriptors.rows; }
  float angle(int i) const {
    auto const at = static_cast<std::size_t>(i);
    if (left < 0) { return frame->mvKeysUn[at].angle; }
    auto const first_right = static_cast<std::size_t>(left);
    return at < first_right ? frame->mvKeys[at].angle : frame->mvKeysRight[at - first_right].angle;
  }
};

template <typename Matrix>
descriptor_rows rows_of(Matrix const& m) {
  return {m.data, static_cast<std::size_t>(m.step), m.rows};
}
/// Whether a matrix has descriptors, of which at most `capacity` rows.
template <typename Matrix>
bool has_descriptors(Matrix const& m, int capacity) {
  return m.data != nullptr && m.rows > 0 && m.rows <= capacity && m.cols == 32 && m.type() == 0;
}

/// BowVector and FeatureVector of DBoW2, from arrays.
template <typename Bag, typename Groups>
void fill(word_lists const& from, Bag& bag, Groups& groups) {
  Bag new_bag;
  for (int w = 0; w < from.words; ++w) {
    new_bag.emplace_hint(new_bag.end(), from.word[w], from.value[w]);
  }
  Groups new_groups;
  for (int k = 0; k < from.groups; ++k) {
    using list = typename Groups::mapped_type;
    new_groups.emplace_hint(new_groups.end(), from.node[k],
                            list(from.keypoint + from.start[k], from.keypoint + from.start[k + 1]));
  }
  bag = std::move(new_bag);
  groups = std::move(new_groups);
}

/// A FeatureVector as arrays.
/// @return false for a keypoint that is not there, or in two groups
template <typename Groups>
bool put_groups(Groups const& groups, word_arrays& to) {
  std::vector<bool> grouped(static_cast<std::size_t>(to.keypoints));
  int at = 0;
  to.groups = 0;
  to.start[0] = 0;
  for (auto const& [node, keypoints] : groups) {
    if (keypoints.empty()) { continue; }
    for (auto const i : keypoints) {
      if (i >= grouped.size() || grouped[i]) { return false; }
      grouped[i] = true;
      to.keypoint[at++] = static_cast<int>(i);
    }
    to.node[to.groups] = static_cast<std::uint32_t>(node);
    to.start[++to.groups] = at;
  }
  return true;
}

/// All of a side but the holders.
/// @return false if its members do not fit together
template <typename Frame>
bool put_side(Frame const& frame, word_arrays& to) {
  described_keypoints<Frame> const keypoints(frame);
  if (!has_descriptors(frame.mDescriptors, to.capacity) || !keypoints.complete(to.capacity)) {
    return false;
  }
  to.keypoints = keypoints.count();
  to.first_right = keypoints.left;
  descriptor_rows const rows = rows_of(frame.mDescriptors);
  for (int i = 0; i < to.keypoints; ++i) {
    to.angle[i] = keypoints.angle(i);
    std::memcpy(to.descriptor + 8 * i, rows.data + static_cast<std::size_t>(i) * rows.step, 32);
  }
  return put_groups(frame.mFeatVec, to);
}

}  // namespace word_detail

/// Keypoints of a frame that may have words.
inline int word_capacity(device_tracker const& device) {
  return device.cameras() * device.capacity();
}

/// Whether a frame or keyframe has descriptors that can be transformed. From any thread.
template <typename Frame>
bool can_transform(device_tracker const& device, Frame const& frame) {
  return device.has_vocabulary() &&
         word_detail::has_descriptors(frame.mDescriptors, word_capacity(device));
}

/// Fills mBowVec and mFeatVec.
/// @throws bad_argument unless can_transform()
template <typename Frame>
void transform_frame(device_tracker& device, Frame& frame) {
  detail::require(device.has_vocabulary(), "there is no vocabulary");
  detail::require(can_transform(device, frame),
                  "the frame has no descriptors, or more than there is room for");
  word_lists const lists = device.transform_words(word_detail::rows_of(frame.mDescriptors));
  word_detail::fill(lists, frame.mBowVec, frame.mFeatVec);
}

/// Takes both sides of a search to the device. The holder of a keyframe's keypoint is its own
/// number where its map point is there and not bad.
/// @param points the keyframe's GetMapPointMatches()
/// @return whether a search is possible: both have descriptors and words, and these name keypoints
template <typename KeyFrame, typename Frame, typename MapPoint>
bool put_word_search(device_tracker& device, KeyFrame const& keyframe, Frame const& frame,
                     std::vector<MapPoint*> const& points) {
  if (keyframe.mFeatVec.empty() || frame.mFeatVec.empty()) { return false; }
  word_arrays& from = device.words_of(word_side::keyframe);
  if (!word_detail::put_side(keyframe, from) ||
      !word_detail::put_side(frame, device.words_of(word_side::frame)) ||
      points.size() != static_cast<std::size_t>(from.keypoints)) {
    return false;
  }
  for (int i = 0; i < from.keypoints; ++i) {
    MapPoint* const p = points[static_cast<std::size_t>(i)];
    from.holder[i] = p != nullptr && !p->isBad() ? i : -1;
  }
  return true;
}

/// Whether a keyframe's points can be searched in a frame: both have an entry for the point of each
/// keypoint, the frame has descriptors, and there is room.
/// @param points entries of the keyframe
template <typename Frame, typename KeyFrame>
bool can_search_keyframe(frame_exchange<Frame> const& frames, Frame const& frame,
                         KeyFrame const& keyframe, std::size_t points) {
  auto const size = [&](auto const& of, int camera) {
    return static_cast<std::size_t>(frames.count(of, camera));
  };
  auto const has_room = [&](auto const& of) {
    return frames.keys(of, 0).size() == size(of, 0) && frames.fits(of);
  };
  std::size_t const left = size(frame, 0);
  std::size_t const all = left + size(frame, 1);
  auto const rows = static_cast<std::size_t>(frame.mDescriptors.rows);
  bool const described =
      rows == all ||
      (rows == left && static_cast<std::size_t>(frame.mDescriptorsRight.rows) == size(frame, 1));
  return has_room(frame) && has_room(keyframe) && described && frame.mvpMapPoints.size() == all &&
         points == size(keyframe, 0) + size(keyframe, 1) && frames.bounds_of(frame).have_area();
}

}  // namespace ft::orbslam3
