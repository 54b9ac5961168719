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
#include "ft/kernels/grid.hpp"
#include "integration/orbslam3/frame_exchange.hpp"
#include "integration/orbslam3/helper_threads.hpp"
#include "integration/orbslam3/options.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft::orbslam3 {

/// Fills grids on the host: nearly all of the time goes into taking memory for a thousand lists,
/// which is shared among threads, and which a device could not do. To work out the cells takes a
/// few microseconds, and a grid from the device would have to be transferred.
class cell_lists {
public:
  explicit cell_lists(helper_threads& helpers) : helpers_(&helpers) {}

  /// Replaces the contents of all cells: indices of keypoints, ascending. Keypoints outside of the
  /// cells are left out.
  /// @param image bounds that the cells cover, pixels
  /// @param grid [column][row]
  template <typename Keypoint, typename List, std::size_t Columns, std::size_t Rows>
  void fill(bounds const& image, std::vector<Keypoint> const& keypoints,
            List (&grid)[Columns][Rows]) {
    sort(grid_geometry::over(image.min_x, image.min_y, image.max_x, image.max_y,
                             static_cast<int>(Columns), static_cast<int>(Rows)),
         keypoints);
    constexpr int parts = static_cast<int>((Columns + columns_at_a_time - 1) / columns_at_a_time);
    helpers_->share(parts, [&](int part) {
      std::size_t const begin = static_cast<std::size_t>(part) * columns_at_a_time;
      for (std::size_t x = begin; x < begin + columns_at_a_time && x < Columns; ++x) {
        for (std::size_t y = 0; y < Rows; ++y) {
          std::size_t const cell = x * Rows + y;
          grid[x][y].assign(sorted_.begin() + (cell == 0 ? 0 : end_[cell - 1]),
                            sorted_.begin() + end_[cell]);
        }
      }
    });
  }

private:
  static constexpr std::size_t columns_at_a_time = 4;

  /// Fills sorted_, the indices cell by cell, and end_, where each cell ends in it.
  template <typename Keypoint>
  void sort(grid_geometry const& geometry, std::vector<Keypoint> const& keypoints) {
    std::size_t const n = keypoints.size();
    cell_.resize(n);
    sorted_.resize(n);
    end_.assign(static_cast<std::size_t>(geometry.cells()), 0);
    for (std::size_t i = 0; i < n; ++i) {
      int const c = nearest_cell::of(geometry, keypoints[i].pt.x, keypoints[i].pt.y);
      cell_[i] = c;
      if (c >= 0) { ++end_[static_cast<std::size_t>(c)]; }
    }
    std::ptrdiff_t before = 0;
    for (std::ptrdiff_t& e : end_) {
      std::ptrdiff_t const here = e;
      e = before;
      before += here;
    }
    for (std::size_t i = 0; i < n; ++i) {
      if (cell_[i] < 0) { continue; }
      std::ptrdiff_t& at = end_[static_cast<std::size_t>(cell_[i])];
      sorted_[static_cast<std::size_t>(at++)] = i;
    }
  }

  helper_threads* helpers_;
  std::vector<int> cell_;  ///< by keypoint, -1 = none
  std::vector<std::ptrdiff_t> end_;
  std::vector<std::size_t> sorted_;
};

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
      level.create(frames_.levels().height[l], frames_.levels().width[l], grey_type);
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
    stage_timer const timer(sums(stage::undistort));
    detail::require(can_undistort(frame), "the frame's keypoints are not undistorted here");
    frames_.fill_undistorted(frame);
  }
  /// Frame::AssignFeaturesToGrid: mGrid, and mGridRight for two cameras. For frames from extract()
  /// and from the CPU. Runs on the host, see cell_lists.
  void assign_to_grid(frame_type& frame) {
    stage_timer const timer(sums(stage::grid));
    bounds const image = frames_.bounds_of(frame);
    cells_.fill(image, frames_.keys(frame, 0), frame.mGrid);
    if (frames_.two_cameras()) { cells_.fill(image, frames_.keys(frame, 1), frame.mGridRight); }
  }

  // ---- stereo

  /// Frame::ComputeStereoMatches: mvuRight and mvDepth of a frame that extract() has filled.
  /// @throws bad_argument for another frame
  void compute_stereo_matches(frame_type& frame) {
    stage_timer const timer(sums(stage::stereo));
    int const b = frames_.extracted(frame);
    if (!frames_.has_stereo(b)) {
      device_->match_stereo(b);
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
    stage_timer const timer(sums(stage::stereo));
    detail::require(!left.empty() && !right.empty(), "the pyramids are empty");
    gray_view const images[2] = {view_of(left.front()), view_of(right.front())};
    int const b = frames_.load(frame, frame.mvKeys, true, -1);
    device_->build_pyramids(images[0], images[1]);
    device_->match_stereo(b);
    frames_.set_stereo(b);
    frames_.fill_stereo(b, frame);
  }

  /// Frame::ComputeStereoFishEyeMatches: partners, depths and points. For frames from extract() and
  /// from the CPU.
  void compute_stereo_fisheye_matches(frame_type& frame) {
    stage_timer const timer(sums(stage::stereo));
    int b = frames_.find(frame);
    if (b < 0) { b = frames_.load(frame, frame.mvKeys, true, -1); }
    if (!frames_.has_stereo(b)) {
      device_->match_stereo(b);
      frames_.set_stereo(b);
    }
    frames_.fill_fisheye_stereo(b, frame);
  }

protected:
  feature_stages(std::unique_ptr<device_tracker> device, settings const& s, options const& o)
      : device_(std::move(device)), settings_(s), options_(o) {}
  ~feature_stages() = default;

  call_times* sums(stage s) {
    return options_.statistics ? &statistics_[static_cast<std::size_t>(s)] : nullptr;
  }

  std::unique_ptr<device_tracker> device_;
  settings settings_;
  options options_;
  statistics statistics_{};
  frame_exchange<frame_type> frames_{*device_, settings_};

private:
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
    stage_timer const timer(sums(stage::extract));
    extraction_request const request =
        frames_.begin_extraction(frame, left, right, uses(stage::undistort));
    device_->extract(request);
    frames_.prepare(frame);
    device_->wait_for_features();
    frames_.took(request.buffer, frame);
  }

  cell_lists cells_{device_->helpers()};
};

}  // namespace ft::orbslam3
