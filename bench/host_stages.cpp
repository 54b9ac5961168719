// SPDX-License-Identifier: Apache-2.0
#include "bench/host_stages.hpp"

#include <cmath>
#include <cstddef>
#include <utility>

#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/kernels/rectify.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "ft/pipelines/stereo_matcher.hpp"

namespace bench {

#if !FT_BENCH_HAS_OPENCV
std::vector<host_stage> opencv_stages(host_stage_input const&) { return {}; }
std::string opencv_description() { return {}; }
#endif

std::string instruction_set() {
#if defined(__AVX512BW__)
  return "AVX-512";
#elif defined(__AVX2__)
  return "AVX2";
#elif defined(__SSE4_2__)
  return "SSE4.2";
#elif defined(__SSE2__)
  return "SSE2";
#else
  return "as the compiler has it";
#endif
}

namespace {

using pinhole_pair = ft::stereo_rig<ft::pinhole<float>, ft::pinhole<float>>;

/// One pair's memory.
struct pair_stages {
  ft::orb_extractor<ft::host_exec> orb;
  ft::stereo_matcher<ft::host_exec> rectified;
  ft::stereo_matcher<ft::host_exec, pinhole_pair> two_cameras;
  ft::image_pyramid<ft::memory_space::host> rectified_images;
};

class host_stages_of final : public host_stages {
public:
  explicit host_stages_of(scene const& s) : scene_(s) {
    orb_.width = s.width;
    orb_.height = s.height;
    orb_.features = s.features;
    make_maps();
    pairs_.reserve(s.frames.size());
    for (auto const& frame : s.frames) { add_pair(frame); }
    fill_input();
    list_stages();
  }
  std::vector<host_stage> const& all() const override { return stages_; }

private:
  /// A target camera as the scene's, a source with a wide lens that is turned a little.
  void make_maps() {
    auto const& c = scene_.left;
    ft::remap_sizes const sizes{scene_.width, scene_.height, scene_.width, scene_.height};
    maps_ = ft::remap_table<ft::memory_space::host>(sizes, 2);
    for (int side = 0; side < 2; ++side) {
      double const k = side == 0 ? -0.28 : -0.27;
      ft::radtan4<double> source{c.fx, c.fy, c.cx, c.cy, k, 0.07, 2e-4, 2e-5};
      ft::pinhole<double> target{c.fx, c.fy, c.cx, c.cy};
      double const angle = side == 0 ? 0.01 : -0.01;
      double const sine = std::sin(angle);
      double const cosine = std::cos(angle);
      ft::mat3<double> const R{{cosine, -sine, 0, sine, cosine, 0, 0, 0, 1}};
      ft::build_remap(exec_, source, R, target, maps_.view(), side);
    }
  }

  void add_pair(scene_frame const& frame) {
    pairs_.emplace_back();
    pair_stages& p = pairs_.back();
    // All of both images is seen by both: every keypoint is compared with every other.
    p.orb = {exec_, orb_, 2, {{0, 1e9f}, {0, 1e9f}}};
    auto const& c = scene_.left;
    ft::pinhole<float> const camera{c.fx, c.fy, c.cx, c.cy};
    p.rectified = {ft::rectified_rig::make(camera, scene_.baseline), p.orb};
    ft::pose T_rl = ft::pose::identity();
    T_rl.t.x = -scene_.baseline;
    p.two_cameras = {pinhole_pair{camera, camera, T_rl}, p.orb};
    p.rectified_images = ft::image_pyramid<ft::memory_space::host>(
        ft::pyramid_geometry::make(scene_.width, scene_.height, 1, 1.2f), 2);
    int const w = scene_.width;
    p.orb.upload(exec_, 0, {frame.left.data(), w, scene_.height, w});
    p.orb.upload(exec_, 1, {frame.right.data(), w, scene_.height, w});
    p.orb.extract(exec_);
    taps_.resize(static_cast<std::size_t>(p.orb.geometry().taps));
    ft::make_resize_taps(p.orb.geometry(), taps_.data());
    blur_ = ft::blur_layout::make(p.orb.geometry());
    place_.resize(2 * static_cast<std::size_t>(p.orb.distribution().layout.total));
  }

  void fill_input() {
    auto const as_plain = [](ft::gray_view v) {
      return plain_image{v.data, v.width, v.height, v.stride};
    };
    for (std::size_t i = 0; i < 2 * pairs_.size(); ++i) {
      auto const& orb = pairs_[i / 2].orb;
      auto const& frame = scene_.frames[i / 2];
      auto const in_pair = static_cast<int>(i % 2);
      host_stage_image image;
      image.captured = {(in_pair == 0 ? frame.left : frame.right).data(), scene_.width,
                        scene_.height, scene_.width};
      for (int l = 0; l < orb.geometry().levels; ++l) {
        image.levels.push_back(as_plain(orb.pyramid().level(in_pair, l)));
      }
      auto const found = orb.keypoints().slice(in_pair);
      for (int k = 0; k < *found.count; ++k) {
        int const level = ft::get<ft::field::octave>(found, k);
        float const scale = orb.geometry().scale[level];
        image.keypoints.push_back({std::round(ft::get<ft::field::x>(found, k) / scale),
                                   std::round(ft::get<ft::field::y>(found, k) / scale),
                                   ft::get<ft::field::angle>(found, k), level});
      }
      image.descriptors =
          reinterpret_cast<std::uint8_t const*>(ft::array_of<ft::field::orb>(found));
      input_.images.push_back(std::move(image));
    }
    for (int side = 0; side < 2; ++side) {
      auto const map = maps_.view().slice(side);
      input_.map_position[side] = &map.position->x;
      input_.map_fraction[side] = map.fraction;
    }
    input_.features = orb_.features;
    input_.scale_factor = orb_.scale_factor;
    input_.ini_threshold = orb_.ini_threshold;
    input_.min_threshold = orb_.min_threshold;
  }

  void list_stages() {
    auto const opencv = opencv_stages(input_);
    auto const add = [&](std::string const& name, pair_call call) {
      host_stage stage{name, {}, {}, std::move(call), {}};
      for (auto const& other : opencv) {
        if (other.name != name) { continue; }
        stage.counterpart = other.counterpart;
        stage.difference = other.difference;
        stage.theirs = other.theirs;
      }
      stages_.push_back(std::move(stage));
    };
    auto const at = [this](int i) -> pair_stages& { return pairs_[static_cast<std::size_t>(i)]; };
    ft::corner_params const thresholds{orb_.ini_threshold, orb_.min_threshold};
    add("rectification", [this, at](int i) {
      auto const& frame = scene_.frames[static_cast<std::size_t>(i)];
      auto const to = ft::level_images(at(i).rectified_images.view(), 0);
      for (int side = 0; side < 2; ++side) {
        ft::rectify(exec_,
                    {(side == 0 ? frame.left : frame.right).data(), scene_.width, scene_.height,
                     scene_.width, 0, 1},
                    maps_.view().slice(side),
                    {to[side].data, to.width, to.height, to.stride, 0, 1});
      }
    });
    add("pyramid",
        [this, at](int i) { ft::build_pyramid(exec_, at(i).orb.pyramid(), taps_.data()); });
    add("corners", [this, at, thresholds](int i) {
      ft::detect_corners(exec_, at(i).orb.pyramid(), thresholds, at(i).orb.corners());
    });
    add("corners, no cells", [this, at, thresholds](int i) {
      ft::detect_corners(exec_, at(i).orb.pyramid(), thresholds, at(i).orb.corners());
    });
    add("distribution", [this, at](int i) {
      ft::distribute_corners(exec_, at(i).orb.corners(), at(i).orb.distribution());
    });
    add("blur", [this, at](int i) {
      ft::blur_pyramid(exec_, at(i).orb.pyramid(), at(i).orb.blurred(), blur_);
    });
    add("orientation, descriptors", [this, at](int i) { describe(at(i)); });
    add("blur, orientation, descriptors", [this, at](int i) {
      ft::blur_pyramid(exec_, at(i).orb.pyramid(), at(i).orb.blurred(), blur_);
      describe(at(i));
    });
    add("extraction, whole", [this, at](int i) { at(i).orb.extract(exec_); });
    add("stereo, rectified", [this, at](int i) { at(i).rectified.match(exec_, at(i).orb); });
    add("stereo, two cameras", [this, at](int i) { at(i).two_cameras.match(exec_, at(i).orb); });
  }

  void describe(pair_stages& p) {
    ft::stereo_overlap const overlaps[2] = {{0, 1e9f}, {0, 1e9f}};
    int mono_count[2];
    ft::describe_corners(exec_, p.orb.pyramid(), p.orb.blurred(), p.orb.distribution(), overlaps,
                         ft::detail::orb_pattern, p.orb.keypoints(), mono_count, place_.data());
  }

  scene const& scene_;
  ft::host_exec exec_{1};
  ft::orb_params orb_;
  ft::remap_table<ft::memory_space::host> maps_;
  std::vector<pair_stages> pairs_;
  std::vector<ft::resize_tap> taps_;
  ft::blur_layout blur_;
  std::vector<int> place_;
  host_stage_input input_;
  std::vector<host_stage> stages_;
};

}  // namespace

std::unique_ptr<host_stages> make_host_stages(scene const& s) {
  return std::make_unique<host_stages_of>(s);
}

}  // namespace bench
