// SPDX-License-Identifier: Apache-2.0
/// @file The shim between ORB-SLAM3's tracking and ft.
///
/// A template over the system's own types, compiled inside it; see README.md in this folder.
#pragma once

#include <cstddef>
#include <memory>
#include <mutex>
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
#include "integration/orbslam3/inertial_poses.hpp"
#include "integration/orbslam3/local_map.hpp"
#include "integration/orbslam3/local_room.hpp"
#include "integration/orbslam3/map_mirror.hpp"
#include "integration/orbslam3/options.hpp"
#include "integration/orbslam3/statistics.hpp"

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
    device_->meanwhile([this] { return local_.work_ahead(); });
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
    send_holders(request.last, last, true);
    mirror_.flush();
    request.T_cw = transform_of(current.GetPose());
    rotation_of(current.GetPose(), request.rotation);
    request.T_lw = transform_of(last.GetPose());
    request.image = frames_.bounds_of(current);
    request.window_radius = th;
    request.ignore_motion_direction = mono;
    int const matches = timer.on_device([&] { return device_->search_last_frame(request); });
    write_matches(request.current, current);
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
    send_holders(request.buffer, frame, false);
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
    write_matches(request.buffer, frame);
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
    int const b = bind_with_points(frame);
    transform const start = transform_of(frame.GetPose());
    pose_result const result = timer.on_device([&] { return device_->optimize_pose(b, start); });
    write_outliers(b, frame);
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
    request.buffer = bind_with_points(frame);
    float* const distance = device_->point_distances();
    frames_.for_each_number(frame, [&](std::size_t i, int number) {
      distance[number] = holds(frame, i) ? frame.mvpMapPoints[i]->mTrackDepth : 0.0f;
    });
    auto const result = timer.on_device([&] { return device_->optimize_inertial_pose(request); });
    if (result.refused) { return inertial_refused; }
    write_outliers(request.buffer, frame);
    take_inertial_result(frame, from_last, result);
    return result.tracked;
  }
  /// Whether the frame has what it would start from.
  bool can_optimize_inertial(frame_type const& frame, stage which) const {
    return has_inertial_start(frame, which == stage::pose_inertial_last_frame,
                              settings_.reference_quirks);
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
      bool const of_images = s < stage::search_last_frame;
      if (!of_images && o[s] == stage_mode::device) { return true; }
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

  static bool holds(frame_type const& frame, std::size_t i) {
    return i < frame.mvpMapPoints.size() && frame.mvpMapPoints[i] != nullptr;
  }
  /// Collects the slots of the points that a frame's keypoints hold.
  /// @return whether they have changed
  bool gather_holders(int b, frame_type const& frame, bool inliers_only) {
    frame_arrays const& a = device_->frame(b);
    bool changed = false;
    frames_.for_each_number(frame, [&](std::size_t i, int number) {
      prefetch_number(frame.mvpMapPoints, i + 16);
      bool const held = holds(frame, i) && !(inliers_only && frame.mvbOutlier[i]);
      int const slot = held ? mirror_.visit(frame.mvpMapPoints[i], a.holder[number]) : -1;
      replace(a.holder[number], slot, changed);
    });
    return changed;
  }
  void send_holders(int b, frame_type const& frame, bool inliers_only) {
    if (gather_holders(b, frame, inliers_only)) { device_->send(b, frame_part::holder); }
  }
  /// The buffer of a frame and of the points that it holds, for a pose. As in the original, map
  /// points are locked while they are read. The lock is not held while waiting for the device.
  int bind_with_points(frame_type const& frame) {
    int const b = frames_.bind(frame, -1);
    bool changed = false;
    {
      std::unique_lock<std::mutex> const lock(map_point::mGlobalMutex);
      mirror_.begin_call();
      changed = gather_holders(b, frame, false);
    }
    if (changed) { device_->send(b, frame_part::holder); }
    mirror_.flush();
    return b;
  }
  /// Flags the keypoints whose points a pose has released, and no other that holds a point.
  void write_outliers(int b, frame_type& frame) const {
    frame_arrays const& a = device_->frame(b);
    frames_.for_each_number(frame, [&](std::size_t i, int number) {
      if (holds(frame, i)) { frame.mvbOutlier[i] = a.holder[number] < 0; }
    });
  }
  /// Copies the device's matches to the frame's keypoints.
  void write_matches(int b, frame_type& frame) const {
    frame_arrays const& a = device_->frame(b);
    frames_.for_each_number(frame, [&](std::size_t i, int number) {
      if (a.holder[number] >= 0) { frame.mvpMapPoints[i] = mirror_.owner(a.holder[number]); }
    });
  }

  std::unique_ptr<device_tracker> device_;
  settings settings_;
  options options_;
  map_mirror<map_point> mirror_;
  frame_exchange<frame_type> frames_{*device_, settings_};
  local_map<Types> local_{*device_, mirror_, settings_, options_.fill_projections};
  local_room room_{*device_};
  cell_lists cells_{device_->helpers()};
  statistics statistics_{};
};

}  // namespace orbslam3
}  // namespace ft
