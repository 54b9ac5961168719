// SPDX-License-Identifier: Apache-2.0
/// @file The parts of a rig with one camera, whose maps begin from motion.
#pragma once

#include <cstddef>
#include <vector>

#include "ft/cameras/monocular_rig.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keyframes.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/images/undistort.hpp"
#include "ft/kernels/keypoints/order.hpp"
#include "ft/kernels/map/insert_keyframe.hpp"
#include "ft/kernels/map/triangulate_points.hpp"
#include "ft/kernels/monocular/begin_map.hpp"
#include "ft/pipelines/detail/odometry_memory.hpp"
#include "ft/pipelines/detail/rig_parts.hpp"
#include "ft/pipelines/monocular_start.hpp"
#include "ft/types/images.hpp"
#include "ft/types/odometry_params.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The images of the next frame of a batch of cameras.
template <typename Exec, typename Camera>
class rig_input<Exec, monocular_rig<Camera>> {
public:
  using images_type = gray_view;
  static constexpr bool overlaps_pyramid = true;

  rig_input() = default;
  rig_input(Exec const&, monocular_rig<Camera> const&, pyramid_geometry const& geometry, int batch)
      : images_(geometry, {0, 1}, batch) {}

  frame_images<Exec> const& images() const { return images_; }
  allocated_bytes allocated() const { return images_.allocated(); }
  /// @throws bad_argument for an image that is null or of another size
  void take(int b, gray_view const& given) { images_.take(b, 0, given); }
  /// Enqueues the copy of the images into level 0 of the pyramids.
  void upload(Exec const& exec, extraction<Exec> const& to) const {
    to.upload(exec, images_.sources(), {}, {});
  }

private:
  frame_images<Exec> images_;
};

/// Item: a keypoint. It has no depth.
struct clear_depth {
  using scratch = no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, stereo_matches_view const& out) const {
    array_of<field::right_x>(out)[item] = -1.0f;
    array_of<field::depth>(out)[item] = -1.0f;
  }
};

/// A stereo_matcher of keypoints without depth.
template <typename Exec>
class no_matcher {
public:
  no_matcher() = default;
  explicit no_matcher(orb_extractor<Exec> const& extractor) {
    memory_ = owner<stereo_matches_view, Exec::space>([&](carver& c, stereo_matches_view& m) {
      carve(c, m, extractor.capacity(), extractor.batch());
    });
  }
  void match_sorted(Exec const& exec, orb_extractor<Exec> const& extractor) const {
    for_each_item<per_thread>(exec, extractor.capacity() * extractor.batch(), clear_depth{},
                              memory_.view());
  }
  std::size_t bytes() const { return memory_.bytes(); }
  stereo_matches_view matches() const { return memory_.view(); }
  float const* depth() const { return array_of<field::depth>(memory_.view()); }
  static fisheye_matches_view fisheye_matches() { return {}; }

private:
  owner<stereo_matches_view, Exec::space> memory_;
};
template <typename Exec>
keypoint_grids<false> grids_of(no_matcher<Exec> const&, feature_grid_view const& cells) {
  return {cells, {}};
}

template <typename Camera>
struct rig_parts<monocular_rig<Camera>> {
  using rig_type = monocular_rig<Camera>;
  using searched_rig = rig_type;
  template <typename Exec>
  using input = rig_input<Exec, rig_type>;
  template <typename Exec>
  using matcher = no_matcher<Exec>;
  static constexpr bool undistorts = false;
  static constexpr bool refines_positions = false;
  static constexpr double disparity_weight = 0;
  static constexpr bool starts_from_motion = true;

  static rig_type const& searched(rig_type const& rig) { return rig; }
  static absent_images absent(rig_type const&) { return {}; }
  template <typename Exec>
  static matcher<Exec> make_matcher(rig_type const&, orb_extractor<Exec> const& extractor,
                                    input<Exec> const&) {
    return matcher<Exec>(extractor);
  }
  static image_bounds bounds(rig_type const&, int width, int height) {
    return {0, 0, static_cast<float>(width), static_cast<float>(height)};
  }
};

/// How maps begin and points are made. Nothing of it, for rigs with depths.
template <typename Exec, typename Rig>
class map_beginning {
public:
  static allocated_bytes bytes() { return {}; }
};

/// That of one camera. All stages are asynchronous on their executor and allocate nothing.
template <typename Exec, typename Camera>
class map_beginning<Exec, monocular_rig<Camera>> {
  using rig_type = monocular_rig<Camera>;

public:
  static constexpr float farthest = 1e6f;  ///< all points are near

  /// Waits. @throws bad_argument, std::bad_alloc, cuda_error
  void take(Exec const& exec, rig_type const& rig, monocular_start_params const& params,
            keyframes_view const& ring, grid_geometry const& grid) {
    ring_ = {ring.positions, ring.cameras, ring.capacity};
    batch_ = ring.batch;
    memory_ = owner<memory, Exec::space>([&](carver& c, memory& m) {
      auto const b = static_cast<std::size_t>(ring.batch);
      carve(c, m.begins, ring.capacity, ring.batch);
      carve(c, m.rays, ring_, ring.batch);
      carve(c, m.points, ring_, ring.batch);
      m.first.held = c.take<int>(b);
      m.first.left_out = c.take<int>(b);
    });
    std::vector<pinhole<float>> const cameras(static_cast<std::size_t>(ring.batch),
                                              rig.undistorted());
    start_ = monocular_start<Exec>(exec, params, cameras, grid, ring.capacity);
  }
  void initialize(Exec const& exec) const {
    for (int b = 0; b < batch_; ++b) { forget(exec, b); }
    auto const n = static_cast<std::size_t>(batch_);
    fill_bytes(exec, memory_->begins.order, 0, n * sizeof(keyframe_order));
    fill_bytes(exec, memory_->begins.pixels.count, 0, n * sizeof(int));
  }
  /// The keyframes of camera b get no points from now on.
  void forget(Exec const& exec, int b) const {
    forget_rays(exec, memory_->rays, ring_.positions, b);
  }
  allocated_bytes bytes() const { return {memory_.bytes() + start_.bytes(), 0}; }
  map_beginnings begins() const {
    map_beginnings v = memory_->begins;
    v.report = start_.reports();
    return v;
  }
  triangulated_view const& points() const { return memory_->points; }

  /// Looks for the second of two frames, for cameras without a map and those that are lost.
  void look(Exec const& exec, rig_type const& rig, frame_view const& frame,
            pyramid_geometry const& geometry, odometry_memory<Exec> const& own,
            tracking_rules const& rules) {
    int const numbers = frame.batch * frame.capacity();
    map_beginnings const begins = this->begins();
    beginning_input<rig_type> const in{rig,           frame, geometry, own.inputs, own.state.tracks,
                                       rules.patience};
    for_each_item<per_thread>(exec, numbers, open_beginning<rig_type>{}, in, start_.progress(),
                              begins);
    start_frames frames;
    frames.keypoints = frame.keypoints;
    frames.keypoints.count = begins.count;
    frames.pixels = begins.pixels;
    start_.add(exec, frames);
    for_each_item<per_block<256>>(exec, frame.batch, scale_beginning{}, start_.reconstructions(),
                                  static_cast<int const*>(start_.first().count),
                                  static_cast<std::int64_t const*>(own.state.time_ns), begins);
  }
  /// Makes keyframes of the first frames of maps that begin, with their points.
  void insert_first(Exec const& exec, rig_type const& rig, frame_view const& frame,
                    pyramid_geometry const& geometry, odometry_memory<Exec> const& own) const {
    map_beginnings const begins = this->begins();
    keyframe_input<rig_type> in{};
    in.rig = rig;
    in.frame = frame;
    in.frame.keypoints = start_.first();
    in.frame.keypoint_step = 1;
    in.frame.holder = begins.holder;
    in.order = begins.order;
    in.T_cw = begins.first_T_cw;
    in.time_ns = begins.first_ns;
    in.depth = begins.depth;
    in.point = begins.point;
    in.geometry = geometry;
    keyframe_params p;
    p.near_depth = farthest;
    p.wanted_near_points = 0;
    insert_keyframe(exec, in, p, own.map, memory_->first, own.keyframe_work);
    triangulation_input<rig_type> t = input_of(rig, in.frame, geometry, own);
    t.order = begins.order;
    enter_partners(exec, t, false, own.map, memory_->rays, memory_->points);
    for_each_item<per_thread>(exec, frame.batch * frame.capacity(), hand_over_point{},
                              start_.matches(), static_cast<int const*>(start_.first().count),
                              begins, frame);
  }
  /// @param has_imu an IMU keeps the scale of the map
  void triangulate(Exec const& exec, rig_type const& rig, frame_view const& frame,
                   pyramid_geometry const& geometry, odometry_memory<Exec> const& own,
                   bool has_imu) const {
    triangulation_input<rig_type> in = input_of(rig, frame, geometry, own);
    in.params.needs_support = !has_imu;
    triangulate_points(exec, in, own.map, memory_->rays, memory_->points);
  }
  void enter(Exec const& exec, rig_type const& rig, frame_view const& frame,
             pyramid_geometry const& geometry, odometry_memory<Exec> const& own) const {
    enter_partners(exec, input_of(rig, frame, geometry, own), true, own.map, memory_->rays,
                   memory_->points);
  }

private:
  struct memory {
    map_beginnings begins;
    keyframe_rays_view rays;
    triangulated_view points;
    keyframe_result first;
  };

  triangulation_input<rig_type> input_of(rig_type const& rig, frame_view const& frame,
                                         pyramid_geometry const& geometry,
                                         odometry_memory<Exec> const& own) const {
    triangulation_input<rig_type> in{};
    in.rig = rig;
    in.frame = frame;
    in.order = own.state.order;
    in.begins = memory_->begins.order;
    in.T_cw = own.state.T_cw;
    in.geometry = geometry;
    return in;
  }

  keyframes_capacity ring_;
  int batch_ = 0;
  owner<memory, Exec::space> memory_;
  monocular_start<Exec> start_;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
