// SPDX-License-Identifier: Apache-2.0
// OpenCV's side of host_stages.hpp. Output images and lists are kept between calls, like ft's.
#include <array>
#include <cstddef>
#include <memory>
#include <opencv2/core.hpp>
#include <opencv2/core/utility.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>

#include "bench/host_stages.hpp"

namespace bench {

namespace {

cv::Mat mat_of(plain_image const& v) {
  return {v.height, v.width, CV_8U, const_cast<std::uint8_t*>(v.data),
          static_cast<std::size_t>(v.stride)};
}

class opencv_calls {
public:
  explicit opencv_calls(host_stage_input const& input) : input_(input) {
    cv::setNumThreads(1);
    auto const levels = static_cast<int>(input.images[0].levels.size());
    for (auto& side : outputs_) { side.resize(static_cast<std::size_t>(levels)); }
    whole_ = cv::ORB::create(input.features, input.scale_factor, levels, 19, 0, 2,
                             cv::ORB::FAST_SCORE, 31, input.ini_threshold);
    one_level_ = cv::ORB::create(input.features, input.scale_factor, 1, 19, 0, 2,
                                 cv::ORB::FAST_SCORE, 31, input.ini_threshold);
    prepare();
  }

  void prepare() {
    for (std::size_t side = 0; side < 2; ++side) {
      auto const& image = input_.images[side];
      keypoints_[side].assign(image.levels.size(), {});
      for (auto const& k : image.keypoints) {
        keypoints_[side][static_cast<std::size_t>(k.level)].emplace_back(k.x, k.y, 31.0f, k.angle,
                                                                         1.0f, 0);
      }
      descriptors_[side] = cv::Mat(static_cast<int>(image.keypoints.size()), 32, CV_8U,
                                   const_cast<std::uint8_t*>(image.descriptors));
    }
  }

  void remap() {
    for_each_side([&](host_stage_image const& image, std::size_t side) {
      cv::Mat const from = mat_of(image.captured);
      cv::Mat const position(from.rows, from.cols, CV_16SC2,
                             const_cast<std::int16_t*>(input_.map_position[side]));
      cv::Mat const fraction(from.rows, from.cols, CV_16UC1,
                             const_cast<std::uint16_t*>(input_.map_fraction[side]));
      cv::remap(from, rectified_[side], position, fraction, cv::INTER_LINEAR, cv::BORDER_CONSTANT);
    });
  }
  void pyramid() {
    for_each_side([&](host_stage_image const& image, std::size_t side) {
      cv::Mat from = mat_of(image.levels.front());
      for (std::size_t l = 1; l < image.levels.size(); ++l) {
        cv::Mat& to = outputs_[side][l];
        cv::resize(from, to, cv::Size(image.levels[l].width, image.levels[l].height), 0, 0,
                   cv::INTER_LINEAR);
        from = to;
      }
    });
  }
  void blur() {
    for_each_side([&](host_stage_image const& image, std::size_t side) {
      for (std::size_t l = 0; l < image.levels.size(); ++l) {
        cv::GaussianBlur(mat_of(image.levels[l]), blurred_[side][l], cv::Size(7, 7), 2, 2,
                         cv::BORDER_REFLECT_101);
      }
    });
  }
  /// The same cells as ft's: the strict threshold, and the lenient one if that finds nothing.
  void corners_by_cells() {
    for_each_side([&](host_stage_image const& image, std::size_t) {
      for (auto const& level : image.levels) {
        found_.clear();
        find_in_cells(mat_of(level));
      }
    });
  }
  void corners_of_levels() {
    for_each_side([&](host_stage_image const& image, std::size_t) {
      for (auto const& level : image.levels) {
        cv::FAST(mat_of(level), found_, input_.min_threshold, true);
      }
    });
  }
  void describe() {
    for_each_side([&](host_stage_image const& image, std::size_t side) {
      for (std::size_t l = 0; l < image.levels.size(); ++l) {
        found_ = keypoints_[side][l];
        one_level_->detectAndCompute(mat_of(image.levels[l]), cv::noArray(), found_, words_, true);
      }
    });
  }
  void extract() {
    for_each_side([&](host_stage_image const& image, std::size_t) {
      whole_->detectAndCompute(mat_of(image.levels.front()), cv::noArray(), found_, words_);
    });
  }
  void nearest() { matcher_.match(descriptors_[0], descriptors_[1], matches_); }
  void two_nearest() { matcher_.knnMatch(descriptors_[0], descriptors_[1], two_matches_, 2); }

private:
  template <typename Call>
  void for_each_side(Call const& call) {
    for (std::size_t side = 0; side < 2; ++side) { call(input_.images[side], side); }
  }
  void find_in_cells(cv::Mat const& level) {
    constexpr int border = 16;
    constexpr int cell = 35;
    int const width = level.cols - 2 * border;
    int const height = level.rows - 2 * border;
    int const cols = width / cell;
    int const rows = height / cell;
    if (cols <= 0 || rows <= 0) { return; }
    int const w = (width + cols - 1) / cols;
    int const h = (height + rows - 1) / rows;
    for (int y = border; y + 7 <= level.rows - border; y += h) {
      for (int x = border; x + 7 <= level.cols - border; x += w) {
        cv::Mat const patch = level(cv::Rect(x, y, std::min(w + 6, level.cols - border - x),
                                             std::min(h + 6, level.rows - border - y)));
        cv::FAST(patch, cell_found_, input_.ini_threshold, true);
        if (cell_found_.empty()) { cv::FAST(patch, cell_found_, input_.min_threshold, true); }
        for (auto& k : cell_found_) {
          k.pt.x += static_cast<float>(x - border);
          k.pt.y += static_cast<float>(y - border);
          found_.push_back(k);
        }
      }
    }
  }

  host_stage_input const& input_;
  std::array<std::vector<cv::Mat>, 2> outputs_;
  std::array<std::array<cv::Mat, 16>, 2> blurred_;
  std::array<cv::Mat, 2> rectified_;
  std::array<std::vector<std::vector<cv::KeyPoint>>, 2> keypoints_;  ///< of each level
  std::array<cv::Mat, 2> descriptors_;
  cv::Ptr<cv::ORB> whole_;
  cv::Ptr<cv::ORB> one_level_;
  cv::BFMatcher matcher_{cv::NORM_HAMMING};
  std::vector<cv::KeyPoint> found_, cell_found_;
  cv::Mat words_;
  std::vector<cv::DMatch> matches_;
  std::vector<std::vector<cv::DMatch>> two_matches_;
};

}  // namespace

opencv_side make_opencv_side(host_stage_input const& input) {
  auto const calls = std::make_shared<opencv_calls>(input);
  opencv_side side;
  side.prepare = [calls] { calls->prepare(); };
  auto const add = [&](char const* name, char const* counterpart, char const* difference,
                       void (opencv_calls::*call)()) {
    side.stages.push_back(
        {name, counterpart, difference, {}, [calls, call] { ((*calls).*call)(); }});
  };
  add("rectification", "remap, CV_16SC2", "the same pixels", &opencv_calls::remap);
  add("pyramid", "resize, level after level", "the same pixels", &opencv_calls::pyramid);
  add("corners", "FAST, cell by cell", "the same corners", &opencv_calls::corners_by_cells);
  add("corners, no cells", "FAST, level by level",
      "one threshold, the lenient one; suppression across cells", &opencv_calls::corners_of_levels);
  add("blur", "GaussianBlur 7x7", "the same pixels", &opencv_calls::blur);
  add("blur, orientation, descriptors", "ORB::compute, level by level",
      "pads each level; takes the orientations as given", &opencv_calls::describe);
  add("extraction, whole", "ORB::detectAndCompute",
      "strict threshold only; the strongest corners of a level, no quadtree",
      &opencv_calls::extract);
  add("stereo, rectified", "BFMatcher::match",
      "all pairs where ft looks along rows; no refinement, no depth", &opencv_calls::nearest);
  add("stereo, two cameras", "BFMatcher::knnMatch, k = 2", "no ratio test, no triangulation",
      &opencv_calls::two_nearest);
  return side;
}

std::string opencv_description() { return std::string("OpenCV ") + cv::getVersionString(); }

}  // namespace bench
