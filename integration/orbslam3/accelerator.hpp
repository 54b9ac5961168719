// SPDX-License-Identifier: Apache-2.0
/// @file The shim between ORB-SLAM3's tracking and ft.
///
/// A template over the system's own types, compiled inside it; see docs/orbslam3.md.
#pragma once

#include <chrono>
#include <cstddef>
#include <memory>
#include <mutex>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "ft/core/error.hpp"
#include "integration/orbslam3/frame_exchange.hpp"
#include "integration/orbslam3/helper_threads.hpp"
#include "integration/orbslam3/inertial_poses.hpp"
#include "integration/orbslam3/local_map.hpp"
#include "integration/orbslam3/map_mirror.hpp"
#include "integration/orbslam3/options.hpp"
#include "integration/orbslam3/plain_types.hpp"
#include "integration/orbslam3/recovery_stages.hpp"
#include "integration/orbslam3/settings_of.hpp"

namespace ft::orbslam3 {

/// The stages of one tracker. Constructed once. Only the tracking thread may use it, except for
/// map_point_changed() and forget(), which any thread may call. Several may exist. All calls wait
/// for their results. Data of a frame that an earlier call left on the device are not sent again. A
/// frame that the CPU extracted is sent at its first use.
/// @tparam Types with `frame` and `map_point`: ORB_SLAM3::Frame, ORB_SLAM3::MapPoint
template <typename Types>
class accelerator {
public:
  using frame_type = typename Types::frame;
  using map_point = typename Types::map_point;

  /// @param device from make_cuda_tracker() or make_host_tracker(), made from the same settings
  accelerator(std::unique_ptr<device_tracker> device, settings const& s, options const& o = {})
      : device_(std::move(device)),
        settings_(s),
        options_(o),
        mirror_(*device_, o.detection, s.map_points) {
    if (!reads_map(options_)) { mirror_.changes().close(); }
  }

  /// Whether the accelerator computes a stage; otherwise ORB-SLAM3's own code is called.
  bool uses(stage s) const { return options_[s] != stage_mode::host; }
  options const& chosen() const { return options_; }

  // ---- features

  /// Wakes the threads that share the copy of the images, for an extract() within two milliseconds.
  void expect_images() { device_->helpers().wake(std::chrono::milliseconds(2)); }

  /// Extracts two images into a frame: keypoints, descriptors, counts and scale tables. Needs
  /// frame.mnId.
  /// @tparam Image with data, cols, rows, step: a CV_8UC1 cv::Mat
  /// @throws frame_refused for an image of another size or type
  template <typename Image>
  void extract(Image const& left, Image const& right, frame_type& frame) {
    detail::require(settings_.images == 2, "the settings are for one image");
    extract_images(view_of(left), view_of(right), frame);
  }
  /// One image: monocular, RGB-D.
  template <typename Image>
  void extract(Image const& image, frame_type& frame) {
    detail::require(settings_.images == 1, "the settings are for two images");
    extract_images(view_of(image), {}, frame);
  }
  /// Whether the keypoints of two fisheye cameras are searched.
  bool two_cameras() const { return frames_.two_cameras(); }
  /// Whether the frame is the last one that extract() filled.
  bool extracted(frame_type const& frame) const { return frames_.is_extracted(frame); }

  /// Frame::ComputeStereoMatches of a rectified pair, ComputeStereoFishEyeMatches of two fisheye
  /// cameras, for a frame that extract() has filled last.
  /// @throws bad_argument for another frame
  void compute_stereo(frame_type& frame) { frames_.take_stereo(frame); }

  // ---- tracking

  /// ORBmatcher(0.9, true).SearchByProjection(current, last, th, mono): searches the map points of
  /// the last frame's inliers in the current frame. Returns the number of matches.
  /// @throws bad_argument if the current frame holds map points: ORB-SLAM3 clears them first
  int search_by_projection(frame_type& current, frame_type const& last, float th, bool mono) {
    for (map_point const* const held : current.mvpMapPoints) {
      detail::require(held == nullptr, "the current frame holds map points before the search");
    }
    map_call_end const end(mirror_);
    mirror_.begin_call();
    search_request request = request_of(current, frames_.find(last), th);
    request.other = frames_.bind_last(last, request.buffer);
    held_.send(request.other, last, true);
    mirror_.flush();
    request.inputs.rotation = rotation_of(current.GetPose());
    request.inputs.T_lw = transform_of(last.GetPose());
    request.ignore_motion_direction = mono;
    int const matches = device_->search_last_frame(request);
    held_.write_matches(request.buffer, current);
    return matches;
  }

  /// The rest of Tracking::SearchLocalPoints after its loop over the frame's own points: tests all
  /// `points` that are neither bad nor seen in this frame against the frustum, calls
  /// IncreaseVisible() and stores the tracked values of those in view, then does
  /// ORBmatcher(0.8).SearchByProjection(frame, points, th, far_points, far_threshold). Returns the
  /// number of matches. If no point is in view, nothing is searched and the result is 0.
  /// Allocates for a local map that is larger than all before and than settings::local_points.
  int search_local_points(frame_type& frame, std::vector<map_point*> const& points, float th,
                          bool far_points = false, float far_threshold = 50.0f) {
    device_->helpers().wake();
    map_call_end const end(mirror_);
    mirror_.begin_call();
    search_request request = request_of(frame, -1, th);
    held_.send(request.buffer, frame, false);
    int const tested = local_.gather(request, frame, points, far_points, far_threshold);
    mirror_.flush();
    if (tested == 0) { return 0; }
    centres_of(frame, device_->cameras(), request.inputs.centres);
    request.max_distance = far_points ? far_threshold : 0.0f;
    int const seen = local_.write_sights(frame, points, device_->search_local_map(request));
    int const matches = device_->local_matches();
    // The original then searches nothing, not even the points that skip the frustum test.
    if (seen == 0) { return 0; }
    held_.write_matches(request.buffer, frame);
    return matches;
  }

  /// Optimizer::PoseOptimization(&frame): pose, mvbOutlier; returns the number of inliers.
  /// @param which stage this call is: pose_last_frame, pose_local_map (which options may bypass),
  ///   pose_keyframe
  int pose_optimization(frame_type& frame, stage which) {
    int held = 0;
    for (std::size_t i = 0; i < frame.mvpMapPoints.size(); ++i) {
      if (frame.mvpMapPoints[i] == nullptr) { continue; }
      frame.mvbOutlier[i] = false;
      ++held;
    }
    if (options_[which] == stage_mode::bypass) { return held; }
    if (held < 3) { return 0; }
    map_call_end const end(mirror_);
    int const b = held_.bind(frame);
    pose_result const result = device_->optimize_pose(b, exact_transform_of(frame.GetPose()));
    held_.write_outliers(b, frame);
    frame.SetPose(pose_of<std::decay_t<decltype(frame.GetPose())>>(result.T_cw));
    return result.inliers;
  }

  /// Optimizer::PoseInertialOptimizationLastFrame(&frame) and ...LastKeyFrame(&frame), with
  /// bRecInit false: pose, velocity, bias, mpcpi, mvbOutlier; returns the number of observations
  /// without outliers. Of the last frame mpcpi is deleted, if it was read.
  ///
  /// Returns call_refused, and changes nothing, if the last keyframe, the last frame, its
  /// prior or an integral is not there, an integral has no steps, or a number is not finite.
  /// @param which pose_inertial_last_frame or pose_inertial_last_keyframe
  int inertial_pose_optimization(frame_type& frame, stage which) {
    bool const from_last = which == stage::pose_inertial_last_frame;
    if (!has_inertial_start(frame, from_last, settings_.reference_quirks)) { return call_refused; }
    inertial_request request = inertial_request_of(frame, from_last);
    map_call_end const end(mirror_);
    request.buffer = held_.bind(frame);
    float* const distance = device_->point_distances();
    frames_.for_each_number(frame, [&](std::size_t i, int number) {
      distance[number] = held_.holds(frame, i) ? frame.mvpMapPoints[i]->mTrackDepth : 0.0f;
    });
    auto const result = device_->optimize_inertial_pose(request);
    if (result.refused) { return call_refused; }
    held_.write_outliers(request.buffer, frame);
    take_inertial_result(frame, from_last, result);
    return result.tracked;
  }

  // ---- words

  /// Reads the vocabulary of compute_bow(), which must be the system's: DBoW2's text, or ft's
  /// binary form. Takes a second or so for a text of a million nodes. Before other threads call.
  /// @throws error if there is none that can be read
  void load_vocabulary(std::string const& path) { device_->load_vocabulary(path); }

  /// Whether compute_bow() can be called: there are a vocabulary, and descriptors. From any thread.
  template <typename Frame>
  bool can_compute_bow(Frame const& frame) const {
    return can_transform(*device_, frame);
  }
  /// Frame::ComputeBoW, KeyFrame::ComputeBoW: mBowVec and mFeatVec, unless the frame has words.
  /// From any thread: mapping computes those of keyframes.
  /// @throws bad_argument unless can_compute_bow()
  template <typename Frame>
  void compute_bow(Frame& frame) {
    if (!frame.mBowVec.empty()) { return; }
    std::lock_guard<std::mutex> const lock(words_mutex_);
    transform_frame(*device_, frame);
  }

  /// ORBmatcher(ratio, orientation_check).SearchByBoW(&keyframe, frame, matches): `matches` gets an
  /// entry for each keypoint of the frame. Returns their number.
  ///
  /// Returns call_refused, and changes nothing, if one of both has no words or no descriptors,
  /// more keypoints than there is room for, or words of keypoints that it does not have.
  template <typename KeyFrame>
  int search_by_bow(KeyFrame& keyframe, frame_type const& frame, std::vector<map_point*>& matches,
                    float ratio, bool orientation_check = true) {
    std::vector<map_point*> const points = keyframe.GetMapPointMatches();
    if (!put_word_search(*device_, keyframe, frame, points)) { return call_refused; }
    words_search_params params;
    params.ratio = ratio;
    params.orientation_check = orientation_check;
    word_matches const found = device_->search_by_words(params);
    matches.assign(static_cast<std::size_t>(frame.mDescriptors.rows), nullptr);
    for (std::size_t i = 0; i < matches.size(); ++i) {
      int const from = found.match[i];
      if (from >= 0) { matches[i] = points[static_cast<std::size_t>(from)]; }
    }
    return found.count;
  }

  // ---- relocalisation

  /// ORBmatcher(0.9, true).SearchByProjection(frame, &keyframe, found, th, max_distance): searches
  /// the keyframe's points that are not in `found` in the frame, whose keypoints keep what they
  /// hold. Returns the number of keypoints that take a point.
  ///
  /// Returns call_refused, and changes nothing, unless can_search_keyframe().
  /// @param found with count(): std::set<MapPoint*>
  /// @param th half side of a window at scale 1, pixels
  /// @param max_distance largest Hamming distance of a match, bits
  template <typename KeyFrame, typename Found>
  int search_keyframe(frame_type& frame, KeyFrame& keyframe, Found const& found, float th,
                      int max_distance) {
    std::vector<map_point*> const points = keyframe.GetMapPointMatches();
    if (!can_search_keyframe(frames_, frame, keyframe, points.size())) { return call_refused; }
    map_call_end const end(mirror_);
    mirror_.begin_call();
    search_request request = request_of(frame, -1, th);
    request.other = frames_.send_angles(keyframe, request.buffer);
    held_.send(request.buffer, frame, false);
    held_.send_searched(request.other, keyframe, points, found);
    mirror_.flush();
    request.max_hamming = max_distance;
    int const matches = device_->search_keyframe(request);
    held_.write_matches(request.buffer, frame);
    return matches;
  }

  // ---- map

  /// For the hooks: `point` has new values, which are visible under its lock. From any thread.
  void map_point_changed(map_point* point) { mirror_.changes().push(point); }
  /// The queue of changed points, for code that does not include the accelerator.
  change_queue<map_point>& changes() { return mirror_.changes(); }
  /// The same, for maps, which may outlive this.
  std::shared_ptr<change_queue<map_point>> const& shared_changes() const {
    return mirror_.shared_changes();
  }

  /// Must be called before a map point is deleted, such as the temporary ones of Tracking's
  /// localisation mode, and not under its locks. From any thread.
  void forget(map_point const* point) { mirror_.forget(point); }

  /// Forgets frames and map points. For Tracking::Reset and ResetActiveMap, which restart the
  /// numbers of frames.
  void reset() {
    frames_.clear();
    mirror_.clear();
  }

  map_mirror<map_point> const& mirror() const { return mirror_; }
  map_mirror<map_point>& mirror() { return mirror_; }

private:
  using map_call_end = typename map_mirror<map_point>::call_end;

  static bool reads_map(options const& o) {
    for (int i = 0; i < stage_count; ++i) {
      auto const s = static_cast<stage>(i);
      if (orbslam3::reads_map(s) && o[s] == stage_mode::device) { return true; }
    }
    return false;
  }
  /// A search in a frame, which is sent. @param keep a buffer that must stay, -1 = none
  search_request request_of(frame_type& frame, int keep, float window) {
    search_request r;
    r.buffer = frames_.bind(frame, keep);
    r.inputs.T_cw = transform_of(frame.GetPose());
    r.image = frames_.bounds_of(frame);
    r.window = window;
    return r;
  }

  template <typename Image>
  gray_view view_of(Image const& image) const {
    if (image.cols != settings_.width || image.rows != settings_.height) {
      throw frame_refused("ft: the image is " + std::to_string(image.cols) + "x" +
                          std::to_string(image.rows) + ", the settings say " +
                          std::to_string(settings_.width) + "x" + std::to_string(settings_.height));
    }
    if (image.data == nullptr || image.type() != grey_type) {
      throw frame_refused("ft: the image's type is " + std::to_string(image.type()) +
                          " instead of CV_8UC1 (0), or it has no data");
    }
    return {image.data, image.cols, image.rows,
            static_cast<int>(static_cast<std::size_t>(image.step))};
  }
  void extract_images(gray_view const& left, gray_view const& right, frame_type& frame) {
    int const b = frames_.begin_extraction();
    device_->extract({b, left, right});
    frames_.prepare(frame);
    device_->wait_for_features();
    frames_.took(b, frame);
  }

  std::unique_ptr<device_tracker> device_;
  settings settings_;
  options options_;
  frame_exchange<frame_type> frames_{*device_, settings_};
  map_mirror<map_point> mirror_;
  held_points<Types> held_{*device_, mirror_, frames_};
  local_map<Types> local_{*device_, mirror_, settings_, options_.fills_projected_points};
  std::mutex words_mutex_;  ///< of transform_words()
};

}  // namespace ft::orbslam3
