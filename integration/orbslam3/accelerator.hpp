// SPDX-License-Identifier: Apache-2.0
/// @file The shim between ORB-SLAM3's tracking and ft.
///
/// A template over the system's own types, compiled inside it; see README.md in this folder.
#pragma once

#include <cstddef>
#include <memory>
#include <mutex>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "ft/core/error.hpp"
#include "integration/orbslam3/cell_lists.hpp"
#include "integration/orbslam3/conversions.hpp"
#include "integration/orbslam3/depth_stereo.hpp"
#include "integration/orbslam3/device_tracker.hpp"
#include "integration/orbslam3/frame_changes.hpp"
#include "integration/orbslam3/frame_exchange.hpp"
#include "integration/orbslam3/held_points.hpp"
#include "integration/orbslam3/inertial_poses.hpp"
#include "integration/orbslam3/local_map.hpp"
#include "integration/orbslam3/local_room.hpp"
#include "integration/orbslam3/map_mirror.hpp"
#include "integration/orbslam3/options.hpp"
#include "integration/orbslam3/statistics.hpp"
#include "integration/orbslam3/word_stages.hpp"

namespace ft {
namespace orbslam3 {

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
    device_->measure(o.statistics);
    if (!reads_map(options_)) { mirror_.changes().close(); }
  }

  /// Whether the accelerator computes a stage; otherwise ORB-SLAM3's own code is called.
  bool uses(stage s) const { return options_[s] != stage_mode::host; }
  options const& chosen() const { return options_; }

  // ---- features

  /// Extracts two images into a frame: keypoints, descriptors, counts and scale tables. Needs
  /// frame.mnId, mK, mDistCoef and the bounds.
  /// @tparam Image with data, cols, rows, step: a CV_8UC1 cv::Mat
  /// @throws bad_argument for an image of another size
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

  /// On request: a pyramid of the last extraction, as ORBextractor::mvImagePyramid but without the
  /// border around the levels. @param image 0 left, 1 right
  template <typename Image>
  void download_pyramid(int image, std::vector<Image>& levels) {
    levels.resize(static_cast<std::size_t>(settings_.levels));
    for (int l = 0; l < settings_.levels; ++l) {
      Image level;
      level.create(device_->level_height(l), device_->level_width(l), grey_type);
      device_->download_level(image, l, level.data, static_cast<std::size_t>(level.step));
      levels[static_cast<std::size_t>(l)] = level;
    }
  }

  /// Whether the frame is the last one that extract() filled.
  bool extracted(frame_type const& frame) const { return frames_.is_extracted(frame); }

  // ---- undistortion and grid

  /// Whether undistort() can be called: extract() has filled the frame last. Other conditions: the
  /// frame has no distortion, or it has one image and 4 or 5 coefficients.
  bool can_undistort(frame_type const& frame) const { return frames_.is_undistorted(frame); }
  /// Frame::UndistortKeyPoints: mvKeysUn. extract() has computed the positions.
  /// @throws bad_argument unless can_undistort()
  void undistort(frame_type& frame) {
    stage_timer timer(sums(stage::undistort), *device_);
    detail::require(can_undistort(frame), "the frame's keypoints are not undistorted here");
    frames_.fill_undistorted(frame);
  }
  /// Frame::AssignFeaturesToGrid: mGrid, and mGridRight for two cameras. For frames from extract()
  /// and from the CPU. Runs on the host, see cell_lists.
  void assign_to_grid(frame_type& frame) {
    stage_timer timer(sums(stage::grid), *device_);
    bounds const image = frames_.bounds_of(frame);
    cells_.fill(image, frames_.keys(frame, 0), frame.mGrid);
    if (frames_.two_cameras()) { cells_.fill(image, frames_.keys(frame, 1), frame.mGridRight); }
  }

  // ---- stereo

  /// Frame::ComputeStereoMatches: mvuRight and mvDepth of a frame that extract() has filled.
  /// @throws bad_argument for another frame
  void compute_stereo_matches(frame_type& frame) {
    stage_timer timer(sums(stage::stereo), *device_);
    int const b = frames_.extracted(frame);
    if (!frames_.has_stereo(b)) {
      timer.on_device([&] { device_->match_stereo(b); });
      frames_.set_stereo(b);
    }
    frames_.fill_stereo(b, frame);
  }
  /// The same for a frame that the CPU has extracted. @param left,right the extractors'
  /// mvImagePyramid; level 0 is used
  template <typename Image>
  void compute_stereo_matches(frame_type& frame, std::vector<Image> const& left,
                              std::vector<Image> const& right) {
    stage_timer timer(sums(stage::stereo), *device_);
    detail::require(!left.empty() && !right.empty(), "the pyramids are empty");
    int const b = frames_.load(frame, frame.mvKeys, true, -1);
    timer.on_device([&] {
      device_->build_pyramids(view_of(left.front()), view_of(right.front()));
      device_->match_stereo(b);
    });
    frames_.set_stereo(b);
    frames_.fill_stereo(b, frame);
  }

  /// Frame::ComputeStereoFishEyeMatches: partners, depths and points. For frames from extract() and
  /// from the CPU.
  void compute_stereo_fisheye_matches(frame_type& frame) {
    stage_timer timer(sums(stage::stereo), *device_);
    int b = frames_.find(frame);
    if (b < 0) { b = frames_.load(frame, frame.mvKeys, true, -1); }
    if (!frames_.has_stereo(b)) {
      timer.on_device([&] { device_->match_stereo(b); });
      frames_.set_stereo(b);
    }
    frames_.fill_fisheye_stereo(b, frame);
  }

  /// Frame::ComputeStereoFromRGBD: mvuRight and mvDepth from the depth image. Runs on the host: it
  /// reads one pixel per keypoint, and sending the image would take longer.
  /// @param depth metres, CV_32F
  template <typename Image>
  void compute_stereo_from_depth(frame_type& frame, Image const& depth) {
    stage_timer timer(sums(stage::stereo), *device_);
    fill_stereo_from_depth(frame, depth, settings_.bf);
  }

  // ---- tracking

  /// ORBmatcher(0.9, true).SearchByProjection(current, last, th, mono): searches the map points of
  /// the last frame's inliers in the current frame. Returns the number of matches.
  /// @throws bad_argument if the current frame holds map points: ORB-SLAM3 clears them first
  int search_by_projection(frame_type& current, frame_type const& last, float th, bool mono) {
    stage_timer timer(sums(stage::search_last_frame), *device_);
    for (map_point const* const held : current.mvpMapPoints) {
      detail::require(held == nullptr, "the current frame holds map points before the search");
    }
    map_call_end const end(mirror_);
    mirror_.begin_call();
    last_frame_request request;
    request.current = frames_.bind(current, frames_.find(last));
    request.last = frames_.bind_last(last, request.current);
    held_.send(request.last, last, true);
    mirror_.flush();
    request.T_cw = transform_of(current.GetPose());
    rotation_of(current.GetPose(), request.rotation);
    request.T_lw = transform_of(last.GetPose());
    request.image = frames_.bounds_of(current);
    request.window_radius = th;
    request.ignore_motion_direction = mono;
    int const matches = timer.on_device([&] { return device_->search_last_frame(request); });
    held_.write_matches(request.current, current);
    return matches;
  }

  /// The rest of Tracking::SearchLocalPoints after its loop over the frame's own points: tests all
  /// `points` that are neither bad nor seen in this frame against the frustum, calls
  /// IncreaseVisible() and stores the tracked values of those in view, then does
  /// ORBmatcher(0.8).SearchByProjection(frame, points, th, far_points, far_threshold). Returns the
  /// number of matches. If no point is in view, nothing is searched and the result is 0.
  /// Allocates and waits if !has_room_for(points.size()).
  int search_local_points(frame_type& frame, std::vector<map_point*> const& points, float th,
                          bool far_points = false, float far_threshold = 50.0f) {
    stage_timer timer(sums(stage::search_local_map), *device_);
    device_->helpers().wake();
    room_.follow(static_cast<int>(points.size()));
    map_call_end const end(mirror_);
    mirror_.begin_call();
    local_map_request request;
    request.buffer = frames_.bind(frame, -1);
    held_.send(request.buffer, frame, false);
    int const tested = local_.gather(request, frame, points, far_points, far_threshold);
    mirror_.flush();
    if (tested == 0) { return 0; }
    request.T_cw = transform_of(frame.GetPose());
    centres_of(frame, device_->cameras(), request.centres);
    request.image = frames_.bounds_of(frame);
    request.radius_factor = th;
    request.max_distance = far_points ? far_threshold : 0.0f;
    auto const seen = timer.on_device([&] { return device_->search_local_map(request); });
    local_.write_sights(frame, points, seen);
    int const matches = timer.on_device([&] { return device_->local_matches(); });
    // The original then searches nothing, not even the points that skip the frustum test.
    if (seen.count == 0) { return 0; }
    held_.write_matches(request.buffer, frame);
    return matches;
  }

  /// Whether search_local_points() of so many points allocates nothing. When a local map uses more
  /// than half of the memory, another thread doubles it. This is therefore false only for a local
  /// map that has more than doubled at once, until that thread has finished.
  bool has_room_for(std::size_t points) { return room_.follow(static_cast<int>(points)); }

  /// Optimizer::PoseOptimization(&frame): pose, mvbOutlier; returns the number of inliers.
  /// @param which stage this call is: pose_last_frame, pose_local_map (which options may bypass),
  ///   pose_reference_keyframe or pose_relocalization
  int pose_optimization(frame_type& frame, stage which) {
    stage_timer timer(sums(which), *device_);
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
    transform const start = transform_of(frame.GetPose());
    pose_result const result = timer.on_device([&] { return device_->optimize_pose(b, start); });
    held_.write_outliers(b, frame);
    frame.SetPose(pose_of<std::decay_t<decltype(frame.GetPose())>>(result.T_cw));
    return result.inliers;
  }

  /// Optimizer::PoseInertialOptimizationLastFrame(&frame) and ...LastKeyFrame(&frame), with
  /// bRecInit false: pose, velocity, bias, mpcpi, mvbOutlier; returns the number of observations
  /// without outliers. Of the last frame mpcpi is deleted, if it was read.
  ///
  /// Returns inertial_refused, and changes nothing, if the last keyframe, the last frame, its
  /// prior or an integral is not there, an integral has no steps, or a number is not finite.
  /// @param which pose_inertial_last_frame or pose_inertial_last_keyframe
  int inertial_pose_optimization(frame_type& frame, stage which) {
    stage_timer timer(sums(which), *device_);
    bool const from_last = which == stage::pose_inertial_last_frame;
    if (!can_optimize_inertial(frame, which)) { return inertial_refused; }
    inertial_request request = inertial_request_of(frame, from_last);
    map_call_end const end(mirror_);
    request.buffer = held_.bind(frame);
    float* const distance = device_->point_distances();
    frames_.for_each_number(frame, [&](std::size_t i, int number) {
      distance[number] = held_.holds(frame, i) ? frame.mvpMapPoints[i]->mTrackDepth : 0.0f;
    });
    auto const result = timer.on_device([&] { return device_->optimize_inertial_pose(request); });
    if (result.refused) { return inertial_refused; }
    held_.write_outliers(request.buffer, frame);
    take_inertial_result(frame, from_last, result);
    return result.tracked;
  }
  /// Whether the frame has what it would start from.
  bool can_optimize_inertial(frame_type const& frame, stage which) const {
    return has_inertial_start(frame, which == stage::pose_inertial_last_frame,
                              settings_.reference_quirks);
  }

  // ---- words

  /// Reads the vocabulary of compute_bow(): DBoW2's text, beside which ft's binary form is written,
  /// or that form. Takes a second or so for a text of a million nodes. Before other threads call.
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
    stage_timer timer(sums(stage::transform), *device_);
    transform_frame(*device_, timer, frame);
  }

  /// ORBmatcher(ratio, orientation_check).SearchByBoW(&keyframe, frame, matches): `matches` gets an
  /// entry for each keypoint of the frame. Returns their number.
  ///
  /// Returns words_refused, and changes nothing, if one of both has no words or no descriptors,
  /// more keypoints than there is room for, or words of keypoints that it does not have.
  template <typename KeyFrame>
  int search_by_bow(KeyFrame& keyframe, frame_type const& frame, std::vector<map_point*>& matches,
                    float ratio, bool orientation_check = true) {
    stage_timer timer(sums(stage::search_by_bow), *device_);
    std::vector<map_point*> const points = keyframe.GetMapPointMatches();
    if (!put_word_search(*device_, keyframe, frame, points)) { return words_refused; }
    word_matches const found = timer.on_device_timed([&] {
      return device_->search_by_words({ratio, orientation_check});
    });
    matches.assign(static_cast<std::size_t>(frame.mDescriptors.rows), nullptr);
    for (std::size_t i = 0; i < matches.size(); ++i) {
      int const from = found.match[i];
      if (from >= 0) { matches[i] = points[static_cast<std::size_t>(from)]; }
    }
    return found.count;
  }

  // ---- map

  /// For the hooks: `point` has new values, which are visible under its lock. From any thread.
  void map_point_changed(map_point* point) { mirror_.changes().push(point); }
  /// The queue of changed points, for code that does not include the accelerator.
  change_queue<map_point>& changes() { return mirror_.changes(); }

  /// Must be called before a map point is deleted, such as the temporary ones of Tracking's
  /// localisation mode, and not under its locks. From any thread.
  void forget(map_point const* point) { mirror_.forget(point); }

  /// Forgets frames and map points. For Tracking::Reset and ResetActiveMap, which restart the
  /// numbers of frames.
  void reset() {
    frames_.clear();
    mirror_.clear();
  }

  // ---- inputs and outputs of frames

  statistics const& times() const { return statistics_; }
  void reset_times() { statistics_ = {}; }
  traffic bytes() const { return device_->bytes(); }
  void reset_bytes() { device_->reset_bytes(); }
  map_mirror<map_point> const& mirror() const { return mirror_; }

private:
  using map_call_end = typename map_mirror<map_point>::call_end;

  template <typename Image>
  static grey_image view_of(Image const& image) {
    return {image.data, image.cols, image.rows,
            static_cast<int>(static_cast<std::size_t>(image.step))};
  }
  static bool reads_map(options const& o) {
    for (int i = 0; i < stage_count; ++i) {
      auto const s = static_cast<stage>(i);
      if (orbslam3::reads_map(s) && o[s] == stage_mode::device) { return true; }
    }
    return false;
  }
  stage_statistics* sums(stage s) {
    return options_.statistics ? &statistics_[static_cast<std::size_t>(s)] : nullptr;
  }

  void extract_images(grey_image const& left, grey_image const& right, frame_type& frame) {
    stage_timer timer(sums(stage::extract), *device_);
    extraction_request const request =
        frames_.begin_extraction(frame, left, right, uses(stage::undistort));
    timer.on_device([&] { device_->extract(request); });
    frames_.prepare(frame);
    timer.on_device([&] { device_->wait_for_features(); });
    frames_.took(request.buffer, frame);
  }

  std::unique_ptr<device_tracker> device_;
  settings settings_;
  options options_;
  map_mirror<map_point> mirror_;
  frame_exchange<frame_type> frames_{*device_, settings_};
  held_points<Types> held_{*device_, mirror_, frames_};
  local_map<Types> local_{*device_, mirror_, settings_, options_.fill_projections};
  local_room room_{*device_};
  cell_lists cells_{device_->helpers()};
  std::mutex words_mutex_;  ///< of transform_words() and its statistics
  statistics statistics_{};
};

}  // namespace orbslam3
}  // namespace ft
