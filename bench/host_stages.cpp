// SPDX-License-Identifier: Apache-2.0
#include "bench/host_stages.hpp"

#include <cmath>
#include <cstddef>
#include <utility>

#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/remap_table.hpp"
#include "ft/kernels/images/build_remap.hpp"
#include "ft/kernels/images/rectify.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "ft/pipelines/stereo_matcher.hpp"

namespace bench {

#if !FT_BENCH_HAS_OPENCV
opencv_side make_opencv_side(host_stage_input const&) { return {}; }
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

class host_stages_of final : public host_stages {
public:
  explicit host_stages_of(scene const& s) : scene_(s) {
    orb_.width = s.width;
    orb_.height = s.height;
    orb_.features = s.features;
    make_maps();
    make_memory();
    prepare(0);
    opencv_ = make_opencv_side(input_);
    list_stages();
  }
  std::vector<host_stage> const& all() const override { return stages_; }
  void prepare(int i) override {
    auto const& frame = scene_.frames[static_cast<std::size_t>(i)];
    int const w = scene_.width;
    for (int side = 0; side < 2; ++side) {
      captured_[side] = {(side == 0 ? frame.left : frame.right).data(), w, scene_.height, w};
      extractor_.upload(exec_, side, captured_[side]);
    }
    extractor_.extract(exec_);
    fill_input();
    if (opencv_.prepare) { opencv_.prepare(); }
  }

private:
  /// A target camera equal to the scene's, and a slightly rotated source camera with a wide lens.
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

  void make_memory() {
    // Both cameras see all of both images: every keypoint is compared with every other.
    extractor_ = {exec_, orb_, 2, {{0, 1e9f}, {0, 1e9f}}};
    auto const& c = scene_.left;
    ft::pinhole<float> const camera{c.fx, c.fy, c.cx, c.cy};
    rectified_ = {ft::rectified_rig::make(camera, scene_.baseline), extractor_};
    ft::pose T_rl = ft::pose::identity();
    T_rl.t.x = -scene_.baseline;
    two_cameras_ = {pinhole_pair{camera, camera, T_rl}, extractor_};
    rectified_images_ = ft::image_pyramid<ft::memory_space::host>(
        ft::pyramid_geometry::make(scene_.width, scene_.height, 1, 1.2f), 2);
    taps_.resize(static_cast<std::size_t>(extractor_.geometry().taps));
    ft::make_resize_taps(extractor_.geometry(), taps_.data());
    blur_ = ft::blur_layout::make(extractor_.geometry());
    place_.resize(2 * static_cast<std::size_t>(extractor_.distribution().layout.total));
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

  void fill_input() {
    auto const as_plain = [](ft::gray_view v) {
      return plain_image{v.data, v.width, v.height, v.stride};
    };
    for (int side = 0; side < 2; ++side) {
      host_stage_image& image = input_.images[side];
      image = {};
      image.captured = as_plain(captured_[side]);
      for (int l = 0; l < extractor_.geometry().levels; ++l) {
        image.levels.push_back(as_plain(extractor_.pyramid().level(side, l)));
      }
      auto const found = extractor_.keypoints().slice(side);
      for (int k = 0; k < *found.count; ++k) {
        int const level = found.octave(k);
        float const scale = extractor_.geometry().scale[level];
        image.keypoints.push_back({std::round(found.x(k) / scale), std::round(found.y(k) / scale),
                                   found.angle(k), level});
      }
      image.descriptors =
          reinterpret_cast<std::uint8_t const*>(ft::array_of<ft::field::orb>(found));
    }
  }

  void list_stages() {
    auto const add = [&](std::string const& name, std::function<void()> call) {
      host_stage stage{name, {}, {}, std::move(call), {}};
      for (auto const& other : opencv_.stages) {
        if (other.name != name) { continue; }
        stage.counterpart = other.counterpart;
        stage.difference = other.difference;
        stage.theirs = other.theirs;
      }
      stages_.push_back(std::move(stage));
    };
    auto const pyramid = extractor_.pyramid();
    auto const blurred = extractor_.blurred();
    auto const corners = extractor_.corners();
    auto const kept = extractor_.distribution();
    ft::corner_params const thresholds{orb_.ini_threshold, orb_.min_threshold};
    add("rectification", [this] {
      auto const to = ft::level_images(rectified_images_.view(), 0);
      for (int side = 0; side < 2; ++side) {
        auto const& from = captured_[side];
        ft::rectify(exec_, {from.data, from.width, from.height, from.stride, 0, 1},
                    maps_.view().slice(side),
                    {to[side].data, to.width, to.height, to.stride, 0, 1});
      }
    });
    add("pyramid", [=] { ft::build_pyramid(exec_, pyramid, taps_.data()); });
    auto const detect = [=] { ft::detect_corners(exec_, pyramid, thresholds, corners); };
    add("corners", detect);
    add("corners, no cells", detect);
    add("distribution", [=] { ft::distribute_corners(exec_, corners, kept); });
    auto const blur = [=] { ft::blur_pyramid(exec_, pyramid, blurred, blur_); };
    add("blur", blur);
    add("orientation, descriptors", [this] { describe(); });
    add("blur, orientation, descriptors", [=] {
      blur();
      describe();
    });
    add("extraction, whole", [this] { extractor_.extract(exec_); });
    add("stereo, rectified", [this] { rectified_.match(exec_, extractor_); });
    add("stereo, two cameras", [this] { two_cameras_.match(exec_, extractor_); });
  }

  void describe() {
    ft::stereo_overlap const overlaps[2] = {{0, 1e9f}, {0, 1e9f}};
    int mono_count[2];
    ft::order_corners(exec_, ft::ordering_view{extractor_.geometry(),
                                               extractor_.distribution(),
                                               overlaps,
                                               extractor_.keypoints(),
                                               mono_count,
                                               place_.data(),
                                               {}});
    ft::description_source const from{extractor_.pyramid(), extractor_.blurred(), ft::orb_pattern};
    ft::describe_corners(
        exec_,
        ft::describing_view{
            from, extractor_.distribution(), place_.data(), extractor_.keypoints(), {}, nullptr});
  }

  scene const& scene_;
  ft::host_exec exec_{1};
  ft::orb_params orb_;
  ft::gray_view captured_[2];
  ft::orb_extractor<ft::host_exec> extractor_;
  ft::stereo_matcher<ft::host_exec> rectified_;
  ft::stereo_matcher<ft::host_exec, pinhole_pair> two_cameras_;
  ft::image_pyramid<ft::memory_space::host> rectified_images_;
  ft::remap_table<ft::memory_space::host> maps_;
  std::vector<ft::resize_tap> taps_;
  ft::blur_layout blur_;
  std::vector<int> place_;
  host_stage_input input_;
  opencv_side opencv_;
  std::vector<host_stage> stages_;
};

}  // namespace

std::unique_ptr<host_stages> make_host_stages(scene const& s) {
  return std::make_unique<host_stages_of>(s);
}

}  // namespace bench
