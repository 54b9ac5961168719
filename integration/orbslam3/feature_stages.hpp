// SPDX-License-Identifier: Apache-2.0
/// @file The stages of a frame's constructor: features, undistortion, grid and stereo.
#pragma once

#include <chrono>
#include <cstddef>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "ft/core/error.hpp"
#include "integration/orbslam3/cell_lists.hpp"
#include "integration/orbslam3/depth_stereo.hpp"
#include "integration/orbslam3/device_tracker.hpp"
#include "integration/orbslam3/frame_exchange.hpp"
#include "integration/orbslam3/options.hpp"
#include "integration/orbslam3/statistics.hpp"

namespace ft {
namespace orbslam3 {

/// Base of the accelerator: owns the device, and what all stages share.
/// @tparam Types with `frame`: ORB_SLAM3::Frame
template <typename Types>
class feature_stages {
public:
  using frame_type = typename Types::frame;

  /// Whether the accelerator computes a stage; otherwise ORB-SLAM3's own code is called.
  bool uses(stage s) const { return options_[s] != stage_mode::host; }
  options const& chosen() const { return options_; }

  // ---- features

  /// Wakes the threads that share the copy of the images, for an extract() within two milliseconds.
  void expect_images() { device_->helpers().wake(std::chrono::milliseconds(2)); }

  /// Extracts two images into a frame: keypoints, descriptors, counts and scale tables. Needs
  /// frame.mnId, mK, mDistCoef and the bounds.
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
  /// @throws frame_refused as extract()
  template <typename Image>
  void compute_stereo_matches(frame_type& frame, std::vector<Image> const& left,
                              std::vector<Image> const& right) {
    stage_timer timer(sums(stage::stereo), *device_);
    detail::require(!left.empty() && !right.empty(), "the pyramids are empty");
    grey_image const images[2] = {view_of(left.front()), view_of(right.front())};
    int const b = frames_.load(frame, frame.mvKeys, true, -1);
    timer.on_device([&] {
      device_->build_pyramids(images[0], images[1]);
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

protected:
  feature_stages(std::unique_ptr<device_tracker> device, settings const& s, options const& o)
      : device_(std::move(device)), settings_(s), options_(o) {
    device_->measure(o.statistics);
  }
  ~feature_stages() = default;

  stage_statistics* sums(stage s) {
    return options_.statistics ? &statistics_[static_cast<std::size_t>(s)] : nullptr;
  }

  std::unique_ptr<device_tracker> device_;
  settings settings_;
  options options_;
  statistics statistics_{};
  frame_exchange<frame_type> frames_{*device_, settings_};

private:
  template <typename Image>
  grey_image view_of(Image const& image) const {
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
  void extract_images(grey_image const& left, grey_image const& right, frame_type& frame) {
    stage_timer timer(sums(stage::extract), *device_);
    extraction_request const request =
        frames_.begin_extraction(frame, left, right, uses(stage::undistort));
    timer.on_device([&] { device_->extract(request); });
    frames_.prepare(frame);
    timer.on_device([&] { device_->wait_for_features(); });
    frames_.took(request.buffer, frame);
  }

  cell_lists cells_{device_->helpers()};
};

}  // namespace orbslam3
}  // namespace ft
