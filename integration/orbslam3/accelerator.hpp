// SPDX-License-Identifier: Apache-2.0
/// @file The shim between ORB-SLAM3's tracking and ft.
///
/// A template over the system's own types, compiled inside it; see README.md beside this file.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <mutex>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/depth_association.hpp"
#include "integration/orbslam3/device_tracker.hpp"
#include "integration/orbslam3/map_mirror.hpp"
#include "integration/orbslam3/options.hpp"
#include "integration/orbslam3/statistics.hpp"

namespace ft {
namespace orbslam3 {

/// Of a GeometricCamera: GetType() 0 is a pinhole, 1 Kannala-Brandt. @throws bad_argument for
/// others
template <typename Camera>
camera_parameters parameters_of(Camera& camera) {
  auto const type = camera.GetType();
  detail::require(type == 0u || type == 1u, "the camera's type is neither 0 nor 1");
  camera_parameters p;
  p.kind = type == 0u ? lens::pinhole : lens::kannala_brandt;
  for (int i = 0; i < (type == 0u ? 4 : 8); ++i) {
    p.values[i] = static_cast<float>(camera.getParameter(i));
  }
  return p;
}

/// Of a Sophus::SE3f.
template <typename Pose>
transform transform_of(Pose const& pose) {
  Eigen::Matrix3f const R = pose.rotationMatrix();
  Eigen::Vector3f const t = pose.translation();
  transform T;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) { T.R[3 * r + c] = R(r, c); }
    T.t[r] = t(r);
  }
  return T;
}
/// To a Sophus::SE3f, through a unit quaternion.
template <typename Pose>
Pose pose_of(transform const& T) {
  Eigen::Matrix3f R;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) { R(r, c) = T.R[3 * r + c]; }
  }
  return Pose(Eigen::Quaternionf(R).normalized(), Eigen::Vector3f(T.t[0], T.t[1], T.t[2]));
}

/// The stages of one tracker. Made once; belongs to the tracking thread, but for
/// map_point_changed(), which any thread may call. Several may exist. All calls wait for their
/// results. What the device has of a frame from an earlier call is not sent again; a frame that was
/// extracted by the CPU is sent at its first use.
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
    held_before_.reserve(2 * static_cast<std::size_t>(device_->capacity()));
  }

  /// Whether a stage is the accelerator's; where not, ORB-SLAM3's own code is called.
  bool uses(stage s) const { return options_[s] != stage_mode::host; }
  options const& chosen() const { return options_; }

  // ---- features

  /// Two images in; keypoints, descriptors, counts and scale tables of the frame. Needs
  /// frame.mnId. @tparam Image with data, cols, rows, step: a CV_8UC1 cv::Mat
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

  // ---- stereo

  /// Frame::ComputeStereoMatches: mvuRight and mvDepth of a frame that extract() has filled.
  /// @throws bad_argument for another frame
  void compute_stereo_matches(frame_type& frame) {
    stage_timer timer(sums(stage::stereo), *device_);
    int const b = extracted(frame);
    if (!resident_[b].stereo) {
      timer.on_device([&] { device_->match_stereo(b); });
      resident_[b].stereo = true;
    }
    fill_stereo(b, frame);
  }
  /// The same for a frame that the CPU has extracted. @param left,right the extractors'
  /// mvImagePyramid; level 0 is used
  template <typename Image>
  void compute_stereo_matches(frame_type& frame, std::vector<Image> const& left,
                              std::vector<Image> const& right) {
    stage_timer timer(sums(stage::stereo), *device_);
    detail::require(!left.empty() && !right.empty(), "the pyramids are empty");
    int const b = load(frame, frame.mvKeys, true, -1);
    timer.on_device([&] {
      device_->build_pyramids(view_of(left.front()), view_of(right.front()));
      device_->match_stereo(b);
    });
    resident_[b].stereo = true;
    fill_stereo(b, frame);
  }

  /// Frame::ComputeStereoFishEyeMatches: partners, depths and points. For frames from extract() and
  /// from the CPU.
  void compute_stereo_fisheye_matches(frame_type& frame) {
    stage_timer timer(sums(stage::stereo), *device_);
    int b = find(frame);
    if (b < 0) { b = load(frame, frame.mvKeys, true, -1); }
    if (!resident_[b].stereo) {
      timer.on_device([&] { device_->match_stereo(b); });
      resident_[b].stereo = true;
    }
    fill_fisheye_stereo(b, frame);
  }

  /// Frame::ComputeStereoFromRGBD: mvuRight and mvDepth by the depth image. On the host: it reads a
  /// pixel per keypoint, and sending the image would take longer.
  /// @param depth metres, CV_32F
  template <typename Image>
  void compute_stereo_from_depth(frame_type& frame, Image const& depth) {
    stage_timer timer(sums(stage::stereo), *device_);
    int const n = static_cast<int>(frame.mvKeys.size());
    frame.mvuRight.assign(frame.mvKeys.size(), -1.0f);
    frame.mvDepth.assign(frame.mvKeys.size(), -1.0f);
    if (n == 0) { return; }
    using columns = soa<memory_space::host, field::x, field::y>;
    columns raw(n);
    columns undistorted(n);
    stereo_matches<memory_space::host> found(n);
    auto const put = [n](columns const& to, auto const& keys) {
      for (int i = 0; i < n; ++i) {
        get<field::x>(to.view(), i) = keys[static_cast<std::size_t>(i)].pt.x;
        get<field::y>(to.view(), i) = keys[static_cast<std::size_t>(i)].pt.y;
      }
      *to.view().count = n;
    };
    put(raw, frame.mvKeys);
    put(undistorted, frame.mvKeysUn);
    depth_images_view<float> const image{
        reinterpret_cast<float const*>(depth.data),
        depth.cols,
        depth.rows,
        static_cast<std::ptrdiff_t>(static_cast<std::size_t>(depth.step)),
        0,
        1};
    depth_params params;
    params.bf = settings_.bf;
    associate_depth(host_exec(1), raw.view(), undistorted.view(), image, params, found.view());
    for (int i = 0; i < n; ++i) {
      frame.mvuRight[static_cast<std::size_t>(i)] = get<field::right_x>(found.view(), i);
      frame.mvDepth[static_cast<std::size_t>(i)] = get<field::depth>(found.view(), i);
    }
  }

  // ---- tracking

  /// ORBmatcher(0.9, true).SearchByProjection(current, last, th, mono): map points of the last
  /// frame's inliers in the current one. Returns the number of matches.
  /// @throws bad_argument where the current frame holds map points: ORB-SLAM3 clears them first
  int search_by_projection(frame_type& current, frame_type const& last, float th, bool mono) {
    stage_timer timer(sums(stage::search_last_frame), *device_);
    for (map_point const* const held : current.mvpMapPoints) {
      detail::require(held == nullptr, "the current frame holds map points before the search");
    }
    mirror_.begin_call();
    last_frame_request request;
    request.current = bind(current, find(last));
    request.last = bind_last(last, request.current);
    gather_holders(request.last, last, true);
    mirror_.flush();
    request.T_cw = transform_of(current.GetPose());
    request.T_lw = transform_of(last.GetPose());
    request.image = bounds_of(current);
    request.th = th;
    request.mono = mono;
    int const matches = timer.on_device([&] { return device_->search_last_frame(request); });
    write_matches(request.current, current);
    return matches;
  }

  /// The rest of Tracking::SearchLocalPoints after its loop over the frame's own points: frustum of
  /// all `points` that are neither bad nor seen in this frame, IncreaseVisible() and tracked values
  /// of those in view, then ORBmatcher(0.8).SearchByProjection(frame, points, th, far_points,
  /// far_threshold). Returns the number of matches.
  int search_local_points(frame_type& frame, std::vector<map_point*> const& points, float th,
                          bool far_points = false, float far_threshold = 50.0f) {
    stage_timer timer(sums(stage::search_local_map), *device_);
    mirror_.begin_call();
    local_map_request request;
    request.buffer = bind(frame, -1);
    gather_holders(request.buffer, frame, false);
    gather_local(request, frame, points, far_points, far_threshold);
    mirror_.flush();
    request.T_cw = transform_of(frame.GetPose());
    request.image = bounds_of(frame);
    request.th = th;
    request.far_distance = far_points ? far_threshold : 0.0f;
    int const matches = timer.on_device([&] { return device_->search_local_map(request); });
    write_sights(frame, points);
    write_matches(request.buffer, frame);
    return matches;
  }

  /// Optimizer::PoseOptimization(&frame): pose, mvbOutlier; returns the number of inliers.
  /// @param which pose_last_frame or pose_local_map: where options may say bypass
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
    int b = 0;
    {
      // As the original: nobody moves points while they are read.
      std::unique_lock<std::mutex> const lock(map_point::mGlobalMutex);
      mirror_.begin_call();
      b = bind(frame, -1);
      gather_holders(b, frame, false);
    }
    mirror_.flush();
    frame_arrays const& a = device_->frame(b);
    held_before_.assign(a.holder, a.holder + 2 * a.capacity);
    transform const start = transform_of(frame.GetPose());
    pose_result const result = timer.on_device([&] { return device_->optimize_pose(b, start); });
    for_each_number(frame, [&](std::size_t i, int number) {
      if (held_before_[static_cast<std::size_t>(number)] >= 0 && a.holder[number] < 0) {
        frame.mvbOutlier[i] = true;
      }
    });
    frame.SetPose(pose_of<std::decay_t<decltype(frame.GetPose())>>(result.T_cw));
    return result.inliers;
  }

  // ---- map

  /// For the hooks: `point` has new values, which its lock shows. From any thread.
  void map_point_changed(map_point* point) { mirror_.changes().push(point); }
  /// What to push to, for code that should not see the accelerator.
  change_queue<map_point>& changes() { return mirror_.changes(); }

  /// Forgets frames and map points. For Tracking::Reset and ResetActiveMap, which begin to number
  /// frames anew.
  void reset() {
    for (auto& r : resident_) { r = {}; }
    mirror_.clear();
  }

  // ---- what it takes

  statistics const& times() const { return statistics_; }
  void reset_times() { statistics_ = {}; }
  traffic bytes() const { return device_->bytes(); }
  void reset_bytes() { device_->reset_bytes(); }
  map_mirror<map_point> const& mirror() const { return mirror_; }

private:
  static constexpr int grey_type = 0;  ///< CV_8UC1

  struct resident {
    bool there = false;
    unsigned long id = 0;
    bool extracted = false;  ///< by extract()
    bool stereo = false;     ///< computed on the device
    bool full = false;       ///< positions and descriptors, not only what a last frame needs
    bool checked = false;    ///< positions and stereo are those of the frame
  };

  template <typename Image>
  static grey_image view_of(Image const& image) {
    return {image.data, image.cols, image.rows,
            static_cast<int>(static_cast<std::size_t>(image.step))};
  }
  static bool two_cameras(frame_type const& frame) { return frame.Nleft != -1; }
  static bounds bounds_of(frame_type const& frame) {
    return {frame.mnMinX, frame.mnMinY, frame.mnMaxX, frame.mnMaxY};
  }
  /// Positions that are searched.
  static auto const& keys(frame_type const& frame, int camera) {
    return camera == 1 ? frame.mvKeysRight : two_cameras(frame) ? frame.mvKeys : frame.mvKeysUn;
  }
  static int count(frame_type const& frame, int camera) {
    if (camera == 1) { return two_cameras(frame) ? frame.Nright : 0; }
    return two_cameras(frame) ? frame.Nleft : frame.N;
  }
  stage_statistics* sums(stage s) {
    return options_.statistics ? &statistics_[static_cast<std::size_t>(s)] : nullptr;
  }
  /// Calls visit(index in the frame, number on the device) for all keypoints that may hold points.
  template <typename Visit>
  void for_each_number(frame_type const& frame, Visit const& visit) const {
    int const n = count(frame, 0);
    for (int i = 0; i < n; ++i) { visit(static_cast<std::size_t>(i), i); }
    int const right = count(frame, 1);
    for (int i = 0; i < right; ++i) {
      visit(static_cast<std::size_t>(n + i), device_->capacity() + i);
    }
  }

  // ---- frames

  void extract_images(grey_image const& left, grey_image const& right, frame_type& frame) {
    stage_timer timer(sums(stage::extract), *device_);
    int const b = 1 - newest_;
    resident_[b] = {};
    timer.on_device([&] { device_->extract(b, left, right); });
    resident& r = resident_[b];
    r.there = r.extracted = r.full = true;
    r.id = frame.mnId;
    r.stereo = settings_.images == 2 && settings_.stereo_with_extraction;
    newest_ = b;
    frame_arrays const& a = device_->frame(b);
    fill_features(a, 0, frame.mvKeys, frame.mDescriptors);
    frame.monoLeft = a.mono[0];
    frame.N = a.count[0];
    frame.Nleft = -1;
    frame.Nright = -1;
    if (settings_.images == 2) {
      fill_features(a, 1, frame.mvKeysRight, frame.mDescriptorsRight);
      frame.monoRight = a.mono[1];
    }
    if (device_->cameras() == 2) {
      frame.Nleft = a.count[0];
      frame.Nright = a.count[1];
      frame.N = a.count[0] + a.count[1];
    }
    fill_scale_tables(frame);
  }

  template <typename Keypoint, typename Matrix>
  void fill_features(frame_arrays const& a, int image, std::vector<Keypoint>& keypoints,
                     Matrix& descriptors) const {
    int const n = a.count[image];
    int const first = image * a.capacity;
    keypoints.resize(static_cast<std::size_t>(n));
    for (int i = 0; i < n; ++i) {
      Keypoint& k = keypoints[static_cast<std::size_t>(i)];
      int const at = first + i;
      k.pt.x = a.x[at];
      k.pt.y = a.y[at];
      k.octave = a.octave[at];
      k.size = patch_size_[static_cast<std::size_t>(k.octave)];
      k.angle = a.angle[at];
      k.response = a.response[at];
    }
    descriptors.create(n, 32, grey_type);
    for (int i = 0; i < n; ++i) {
      std::memcpy(descriptors.data +
                      static_cast<std::size_t>(i) * static_cast<std::size_t>(descriptors.step),
                  a.descriptor + 8 * (first + i), 32);
    }
  }

  void fill_scale_tables(frame_type& frame) const {
    frame.mnScaleLevels = settings_.levels;
    frame.mfScaleFactor = settings_.scale_factor;
    frame.mfLogScaleFactor = std::log(settings_.scale_factor);
    frame.mvScaleFactors = tables_.scale;
    frame.mvInvScaleFactors = tables_.inv_scale;
    frame.mvLevelSigma2 = tables_.sigma2;
    frame.mvInvLevelSigma2 = tables_.inv_sigma2;
  }

  /// The buffer that has a frame, -1 = none.
  int find(frame_type const& frame) const {
    for (int const b : {newest_, 1 - newest_}) {
      resident const& r = resident_[b];
      if (r.there && r.id == frame.mnId && looks_like(b, frame)) { return b; }
    }
    return -1;
  }
  /// Numbers of frames begin anew with each reset, so that the number alone does not tell.
  bool looks_like(int b, frame_type const& frame) const {
    frame_arrays const& a = device_->frame(b);
    int const n = count(frame, 0);
    if (a.count[0] != n || (two_cameras(frame) && a.count[1] != frame.Nright)) { return false; }
    for (int const i : {0, n / 2, n - 1}) {
      if (i >= 0 && i < n && a.angle[i] != frame.mvKeys[static_cast<std::size_t>(i)].angle) {
        return false;
      }
    }
    return true;
  }
  int extracted(frame_type const& frame) const {
    int const b = find(frame);
    detail::require(b >= 0 && b == newest_ && resident_[b].extracted,
                    "the frame is not the one that was extracted last: give the pyramids");
    return b;
  }

  /// The buffer with all of a frame. @param keep a buffer that stays as it is, -1 = none
  int bind(frame_type const& frame, int keep) {
    int b = find(frame);
    if (b < 0 || !resident_[b].full) { b = load(frame, keys(frame, 0), two_cameras(frame), keep); }
    if (!resident_[b].checked) { check(b, frame); }
    return b;
  }
  /// The buffer with what the search needs of a last frame.
  int bind_last(frame_type const& frame, int keep) {
    int b = find(frame);
    if (b >= 0 && b != keep) { return b; }
    b = 1 - keep;
    resident_[b] = {};
    frame_arrays const& a = device_->frame(b);
    for (int c = 0; c < 2; ++c) {
      put_count(a, c, count(frame, c));
      put_angles(a, c, count(frame, c), keys(frame, c));
    }
    device_->send(b, frame_part::octaves);
    resident_[b].there = true;
    resident_[b].id = frame.mnId;
    return b;
  }

  /// Sends a frame that was not extracted here. @param left keypoints of the left image: as
  /// extracted for stereo, undistorted for the searches @param right with those of the right one
  template <typename Keypoints>
  int load(frame_type const& frame, Keypoints const& left, bool right, int keep) {
    int const there = find(frame);
    int const b = there >= 0 ? there : keep >= 0 ? 1 - keep : 1 - newest_;
    resident_[b] = {};
    frame_arrays const& a = device_->frame(b);
    put_keypoints(a, 0, left, frame.mDescriptors, 0);
    if (right) {
      bool const joined = two_cameras(frame) && frame.mDescriptors.rows == frame.N;
      put_keypoints(a, 1, frame.mvKeysRight, joined ? frame.mDescriptors : frame.mDescriptorsRight,
                    joined ? frame.Nleft : 0);
    } else {
      put_count(a, 1, 0);
    }
    a.mono[0] = frame.monoLeft;
    a.mono[1] = frame.monoRight;
    device_->send(b, frame_part::keypoints);
    resident_[b].there = true;
    resident_[b].full = true;
    resident_[b].id = frame.mnId;
    newest_ = b;
    return b;
  }
  void put_count(frame_arrays const& a, int image, int n) const {
    if (n > a.capacity) {
      throw bad_argument("ft: the frame has " + std::to_string(n) +
                         " keypoints in an image, there is room for " + std::to_string(a.capacity) +
                         ": see settings::most_keypoints");
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

  /// Sends what the CPU has computed differently: undistorted positions, stereo.
  void check(int b, frame_type const& frame) {
    frame_arrays const& a = device_->frame(b);
    bool moved = false;
    for (int c = 0; c < (two_cameras(frame) ? 2 : 1); ++c) {
      auto const& all = keys(frame, c);
      for (int i = 0; i < a.count[c]; ++i) {
        int const at = c * a.capacity + i;
        auto const& pt = all[static_cast<std::size_t>(i)].pt;
        replace(a.x[at], pt.x, moved);
        replace(a.y[at], pt.y, moved);
      }
    }
    if (moved) { device_->send(b, frame_part::positions); }
    if (settings_.left.kind == lens::kannala_brandt) {
      check_partners(b, frame);
    } else if (settings_.bf != 0) {
      bool changed = false;
      for (int i = 0; i < a.count[0]; ++i) {
        auto const at = static_cast<std::size_t>(i);
        float const u = at < frame.mvuRight.size() ? frame.mvuRight[at] : -1.0f;
        replace(a.right_x[i], u, changed);
      }
      if (changed) { device_->send(b, frame_part::right_x); }
    }
    resident_[b].checked = true;
  }
  void check_partners(int b, frame_type const& frame) {
    frame_arrays const& a = device_->frame(b);
    bool changed = false;
    auto const of = [](std::vector<int> const& partners, int i) {
      auto const at = static_cast<std::size_t>(i);
      return at < partners.size() ? partners[at] : -1;
    };
    for (int i = 0; i < a.capacity; ++i) {
      int const j = i < a.count[0] ? of(frame.mvLeftToRightMatch, i) : -1;
      int const back = i < a.count[1] ? of(frame.mvRightToLeftMatch, i) : -1;
      replace(a.partner[i], j < 0 ? -1 : a.capacity + j, changed);
      replace(a.partner[a.capacity + i], back, changed);
    }
    if (changed) { device_->send(b, frame_part::partner); }
  }
  /// @param changed set where the value was another
  template <typename T>
  static void replace(T& value, T const& now, bool& changed) {
    if (std::memcmp(&value, &now, sizeof now) == 0) { return; }
    value = now;
    changed = true;
  }

  void fill_stereo(int b, frame_type& frame) const {
    frame_arrays const& a = device_->frame(b);
    frame.mvuRight.assign(a.right_x, a.right_x + a.count[0]);
    frame.mvDepth.assign(a.depth, a.depth + a.count[0]);
  }
  void fill_fisheye_stereo(int b, frame_type& frame) const {
    frame_arrays const& a = device_->frame(b);
    auto const left = static_cast<std::size_t>(a.count[0]);
    frame.mvLeftToRightMatch.resize(left);
    frame.mvStereo3Dpoints.resize(left);
    frame.mvuRight.assign(left, -1.0f);
    frame.mvDepth.assign(a.depth, a.depth + a.count[0]);
    for (int i = 0; i < a.count[0]; ++i) {
      auto const at = static_cast<std::size_t>(i);
      frame.mvLeftToRightMatch[at] = a.partner[i] < 0 ? -1 : a.partner[i] - a.capacity;
      float const* const p = a.point + 3 * i;
      frame.mvStereo3Dpoints[at] =
          typename std::decay_t<decltype(frame.mvStereo3Dpoints)>::value_type(p[0], p[1], p[2]);
    }
    frame.mvRightToLeftMatch.assign(a.partner + a.capacity, a.partner + a.capacity + a.count[1]);
  }

  // ---- map points

  /// The slots of the points that a frame's keypoints hold; sent where they are others than before.
  void gather_holders(int b, frame_type const& frame, bool inliers_only) {
    frame_arrays const& a = device_->frame(b);
    bool changed = false;
    for_each_number(frame, [&](std::size_t i, int number) {
      map_point* const point = i < frame.mvpMapPoints.size() ? frame.mvpMapPoints[i] : nullptr;
      bool const held = point != nullptr && !(inliers_only && frame.mvbOutlier[i]);
      int const slot = held ? mirror_.visit(point, a.holder[number]) : -1;
      replace(a.holder[number], slot, changed);
    });
    if (changed) { device_->send(b, frame_part::holder); }
  }
  /// What the device gave to the frame's keypoints.
  void write_matches(int b, frame_type& frame) const {
    frame_arrays const& a = device_->frame(b);
    for_each_number(frame, [&](std::size_t i, int number) {
      if (a.holder[number] >= 0) { frame.mvpMapPoints[i] = mirror_.owner(a.holder[number]); }
    });
  }

  void gather_local(local_map_request& request, frame_type const& frame,
                    std::vector<map_point*> const& points, bool far_points, float far_threshold) {
    int const n = static_cast<int>(points.size());
    slots_ = device_->local_slots(n);
    likely_.resize(points.size(), -1);
    recorded_.clear();
    bool changed = false;
    for (int i = 0; i < n; ++i) {
      prefetch(points, i);
      map_point* const point = points[static_cast<std::size_t>(i)];
      int& slot = likely_[static_cast<std::size_t>(i)];
      slot = mirror_.visit(point, slot);
      bool const bad = mirror_.bad(slot);
      bool const tested = !bad && point->mnLastFrameSeen != frame.mnId;
      replace(slots_[i], tested ? slot : -1, changed);
      if (tested || bad || !settings_.reference_quirks) { continue; }
      if (!far_points || point->mTrackDepth <= far_threshold) { record(frame, *point, i, slot); }
    }
    request.slots_changed = changed;
    request.points = n;
    request.recorded = static_cast<int>(recorded_.size());
    if (request.recorded > 0) {
      std::memcpy(device_->recorded_sights(request.recorded), recorded_.data(),
                  recorded_.size() * sizeof(recorded_sight));
    }
  }
  /// A point that is not tested, but was seen by an earlier test and is searched there.
  void record(frame_type const& frame, map_point const& p, int index, int slot) {
    if (p.mbTrackInView) {
      recorded_.push_back({index,
                           0,
                           slot,
                           {p.mTrackProjX, p.mTrackProjY, p.mTrackProjXR, p.mTrackViewCos,
                            p.mTrackDepth, p.mnTrackScaleLevel}});
    }
    if (two_cameras(frame) && p.mbTrackInViewR) {
      recorded_.push_back({index,
                           1,
                           slot,
                           {p.mTrackProjXR, p.mTrackProjYR, 0.0f, p.mTrackViewCosR, p.mTrackDepthR,
                            p.mnTrackScaleLevelR}});
    }
  }

  /// The tracked values of all points that were tested.
  void write_sights(frame_type& frame, std::vector<map_point*> const& points) {
    drawn_.clear();
    sight const* const left = device_->sights();
    sight const* const right = left + points.size();
    bool const two = two_cameras(frame);
    for (std::size_t i = 0; i < points.size(); ++i) {
      prefetch(points, static_cast<int>(i));
      if (slots_[i] < 0) { continue; }
      map_point& p = *points[i];
      p.mbTrackInView = left[i].level >= 0;
      p.mbTrackInViewR = two && right[i].level >= 0;
      if (p.mbTrackInView) {
        p.mTrackProjX = left[i].x;
        p.mTrackProjY = left[i].y;
        p.mTrackDepth = left[i].distance;
        p.mnTrackScaleLevel = left[i].level;
        p.mTrackViewCos = left[i].cosine;
        if (!two) { p.mTrackProjXR = left[i].right_x; }
        if (options_.fill_projections) { drawn_.push_back({p.mnId, i}); }
      }
      if (p.mbTrackInViewR) {
        p.mTrackProjXR = right[i].x;
        p.mTrackProjYR = right[i].y;
        p.mTrackDepthR = right[i].distance;
        p.mnTrackScaleLevelR = right[i].level;
        p.mTrackViewCosR = right[i].cosine;
      }
      if (p.mbTrackInView || p.mbTrackInViewR) { p.IncreaseVisible(1); }
    }
    draw(frame);
  }
  /// In the order of the map, where a node goes in next to the one before.
  void draw(frame_type& frame) {
    using place = typename std::decay_t<decltype(frame.mmProjectPoints)>::mapped_type;
    sight const* const left = device_->sights();
    std::sort(drawn_.begin(), drawn_.end());
    for (auto const& [id, i] : drawn_) {
      frame.mmProjectPoints.insert_or_assign(frame.mmProjectPoints.end(), id,
                                             place(left[i].x, left[i].y));
    }
  }
  /// Map points lie all over the heap: the one that comes soon is fetched while this one is read.
  static void prefetch(std::vector<map_point*> const& points, int i) {
#if defined(__GNUC__)
    auto const soon = static_cast<std::size_t>(i) + 8;
    if (soon < points.size()) {
      __builtin_prefetch(&points[soon]->mnId);
      __builtin_prefetch(&points[soon]->mnLastFrameSeen);
    }
#else
    static_cast<void>(points);
    static_cast<void>(i);
#endif
  }

  struct scale_tables {
    std::vector<float> scale, inv_scale, sigma2, inv_sigma2;

    explicit scale_tables(settings const& s) {
      auto const g = pyramid_geometry::make(s.width, s.height, s.levels, s.scale_factor);
      scale.assign(g.scale, g.scale + s.levels);
      inv_scale.assign(g.inv_scale, g.inv_scale + s.levels);
      sigma2.assign(g.sigma2, g.sigma2 + s.levels);
      inv_sigma2.assign(g.inv_sigma2, g.inv_sigma2 + s.levels);
    }
  };
  static std::vector<float> patch_sizes(settings const& s) {
    auto const g = pyramid_geometry::make(s.width, s.height, s.levels, s.scale_factor);
    std::vector<float> sizes;
    for (int l = 0; l < s.levels; ++l) { sizes.push_back(static_cast<float>(g.patch_size(l))); }
    return sizes;
  }

  std::unique_ptr<device_tracker> device_;
  settings settings_;
  options options_;
  scale_tables tables_{settings_};
  std::vector<float> patch_size_ = patch_sizes(settings_);
  map_mirror<map_point> mirror_;
  resident resident_[device_tracker::buffers];
  int newest_ = 0;
  int* slots_ = nullptr;
  std::vector<int> likely_;  ///< slots of the last local map: most are in the same place again
  std::vector<recorded_sight> recorded_;
  std::vector<std::pair<unsigned long, std::size_t>> drawn_;  ///< map point, place in the local map
  std::vector<int> held_before_;
  statistics statistics_{};
};

}  // namespace orbslam3
}  // namespace ft
