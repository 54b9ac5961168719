// SPDX-License-Identifier: Apache-2.0
/// @file The stages of a tracked frame on the memory of a frame_tracker. frame_schedule.hpp defines
/// which of them run concurrently.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "ft/containers/frame.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/recording.hpp"
#include "ft/kernels/images/undistort.hpp"
#include "ft/kernels/pose/optimize_frame.hpp"
#include "ft/kernels/search/assignment.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/last_frame.hpp"
#include "ft/kernels/search/local_map.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "ft/kernels/upload.hpp"
#include "ft/pipelines/detail/extraction.hpp"
#include "ft/pipelines/detail/frame_images.hpp"
#include "ft/pipelines/detail/frame_memory.hpp"
#include "ft/pipelines/detail/frame_packing.hpp"
#include "ft/pipelines/detail/rig_parts.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "ft/pipelines/stereo_matcher.hpp"
#include "ft/pipelines/tracker_types.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/orb_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/relocalization.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// One function per stage of a frame, which enqueues it. All are asynchronous on their executor and
/// allocate nothing.
template <typename Exec, typename Rig>
class frame_stages {
public:
  static constexpr bool rectified = Rig::rectified;
  static constexpr memory_space space = Exec::space;
  static constexpr memory_space staging = staging_space<Exec>;
  static constexpr int cameras = Rig::cameras;
  using parts_of_rig = rig_parts<Rig>;
  using searched_rig = typename parts_of_rig::searched_rig;
  static constexpr bool undistorts = parts_of_rig::undistorts;

  searched_rig rig{};
  tracker_params params;
  int batch = 0;
  orb_extractor<Exec> extractor;
  typename parts_of_rig::template matcher<Exec> matcher;
  frame_memory<Exec> memory;
  frustum_params frustum;
  local_search_params local_params;       ///< of the next search in the local map
  image_source const* sources = nullptr;  ///< [batch][images]
  float const* radius_factor = nullptr;   ///< of local_search; may be null
  float* information = nullptr;           ///< of frame_poses; may be null
  pose_params pose_settings;              ///< of both poses of a frame
  pixels_view moved;                      ///< of keypoints that are moved; or none

  // ---- images and keypoints

  static constexpr bool in_parts = Exec::asynchronous;
  int parts() const { return parts_.count(); }
  /// The stages of part k of the images.
  auto part(int k) const {
    auto const grids = grids_of(matcher, memory.frame.grids).from(parts_.first(k));
    return extraction_with<Exec, std::decay_t<decltype(grids)>>{
        features().part(parts_.first(k), parts_.first(k + 1) - parts_.first(k)), nullptr, grids};
  }
  side_branch<Exec>& branch_of_part(int k) { return parts_.branch(k); }
  /// Uploads images, and with the first ones motion and, on request, the local map.
  void upload_part(Exec const& exec, extraction<Exec> const& to, bool with_local) const {
    to.upload(exec, sources, memory.motion.source(),
              with_local ? memory.local.source() : block_source{});
  }
  void upload(Exec const& exec, bool with_local) const {
    upload_part(exec, features(), with_local);
  }
  bool pyramid_overlaps_upload() const { return features().pyramid_overlaps_upload(); }
  void pyramid_of_upload(Exec const& exec) const { features().pyramid_of_upload(exec); }
  void build_levels(Exec const& exec) const { features().build_levels(exec); }
  void detect(Exec const& exec) const { features().detect(exec); }
  void distribute(Exec const& exec) const { features().distribute(exec); }
  void blur(Exec const& exec) const { features().blur(exec); }
  void order(Exec const& exec) const {
    features().order(exec, grids_of(matcher, memory.frame.grids));
  }
  void describe(Exec const& exec) const { features().describe(exec); }
  bool drops_edges() const { return features().drops_edges(); }
  void drop_edges(Exec const& exec) const { features().drop_edges(exec); }
  bool refines_positions() const { return features().refines_positions(); }
  void refine(Exec const& exec) const { features().refine(exec); }

  // ---- stereo

  void match_stereo(Exec const& exec) { matcher.match_sorted(exec, extractor); }
  /// If keypoints are moved before they are searched: two launches.
  void undistort(Exec const& exec) const {
    if constexpr (undistorts) { matcher.undistort(exec, extractor, memory.frame.grids); }
  }
  /// Concurrent stereo matching of pairs that are not rectified.
  side_branch<Exec>& stereo_branch() { return stereo_branch_; }

  // ---- search from the last frame

  void list_last_frame(Exec const& exec) const {
    ft::list_last_frame(exec, last_input(), searched_frame(), memory.map, last_buffers());
  }
  void assign_last_frame(Exec const& exec) const {
    ft::assign_last_frame(exec, last_input(), searched_frame(), memory.map, last_buffers());
  }
  bool optimizes_last() const { return params.optimize_last; }
  void optimize_last(Exec const& exec) const {
    optimize(exec, in_map(), memory.motion.device.predicted);
  }
  void forget_matches(Exec const& exec) const {
    clear_holders(exec, memory.frame);
    fill_bytes(exec, memory.last_work.matches, 0,
               static_cast<std::size_t>(batch) * Rig::searches * sizeof(int));
  }

  // ---- search in the local map

  /// Whether the search in the local map begins at the predicted pose, as the search from the last
  /// frame does. Then its candidates are listed concurrently with that search's choice.
  bool lists_local_early() const { return !params.optimize_last; }
  void list_local_map(Exec const& exec) const {
    ft::list_local_map(exec, local_input(), searched_frame(), memory.map, local_buffers());
  }
  void list_local_map_early(Exec const& exec) const {
    ft::list_local_map_early(exec, local_input(), searched_frame(), memory.map, local_buffers());
  }
  void assign_local_map(Exec const& exec) const {
    assign_candidates<Rig::searches>(exec, searched_frame(), memory.map, local_input().matching(),
                                     local_buffers());
  }
  bool optimizes_local() const { return params.optimize_local; }
  void optimize_local(Exec const& exec) const {
    frames_in_map in = in_map();
    in.frame = aligned_frame();
    in.moves = moves;
    optimize(exec, in, pose_of_motion());
  }
  /// Uploads the local map and, for a restart, the motion, which then gives the initial pose.
  void upload_local(Exec const& exec, bool restart) const {
    image_pyramid_view none = extractor.pyramid();
    none.batch = 0;
    receive_images(exec, nullptr, none, memory.local.source(),
                   restart ? memory.motion.source() : block_source{});
    if (!restart) { return; }
    clear_holders(exec, memory.frame);
    if (optimizes_last()) {
      copy(exec, memory.poses, static_cast<pose const*>(memory.motion.device.predicted),
           static_cast<std::size_t>(batch));
    }
  }

  // ---- the result

  side_branch<Exec>& result_branch() { return result_branch_; }
  void pack_keypoints(Exec const& exec) const {
    for_each_item<per_thread>(exec, batch * memory.frame.numbers(),
                              detail::pack_keypoints<searched_rig>{}, rig, memory.frame,
                              matcher.depth(),
                              static_cast<vec3<float> const*>(matcher.fisheye_matches().point),
                              memory.result, memory.last);
  }
  void pack_visibility(Exec const& exec) const {
    for_each_item<per_thread>(exec, batch * params.local_points, detail::pack_visibility{},
                              static_cast<visibility const*>(memory.visible),
                              static_cast<int const*>(memory.local.device.count), batch,
                              int{cameras}, memory.result);
  }
  /// @param outcome result of the call's last search
  void pack_matches(Exec const& exec, frame_outcome const& outcome) const {
    for_each_item<per_thread>(exec, batch * memory.frame.numbers(), detail::pack_matches{},
                              memory.frame, outcome, memory.result, memory.last);
  }
  frame_outcome outcome_of_extract() const {
    return {memory.last.T_cw, memory.last_work.matches, nullptr, Rig::searches};
  }
  frame_outcome outcome_of_motion() const {
    return {pose_of_motion(), memory.last_work.matches,
            params.optimize_last ? memory.observations.inliers : nullptr, Rig::searches};
  }
  frame_outcome outcome_of_local() const {
    return {params.optimize_local ? memory.poses : pose_of_motion(), memory.local_work.matches,
            params.optimize_local ? memory.observations.inliers : nullptr, Rig::searches};
  }

  /// The frame and the points that its keypoints hold.
  frames_in_map in_map() const { return {memory.frame, memory.map, geometry(), fixed}; }
  unsigned char const* fixed = nullptr;  ///< as in frames_in_map
  float const* moves = nullptr;          ///< likewise, from the search in the local map on

  /// From then on keypoints are where align_keypoints() writes.
  void align_to(pixels_view const& positions, float const* right_x, float const* ways) {
    aligned_ = positions;
    aligned_right_x_ = right_x;
    moves = ways;
  }
  frame_view aligned_frame() const {
    frame_view f = memory.frame;
    if (moves == nullptr) { return f; }
    f.keypoints = with_columns(f.keypoints, aligned_);
    if (f.right_x != nullptr) { f.right_x = aligned_right_x_; }
    return f;
  }

  /// The search in the local map.
  local_search<searched_rig> local_input() const {
    local_search<searched_rig> search;
    search.rig = rig;
    search.T_cw = pose_of_motion();
    search.slots = memory.local.device.slots;
    search.slot_count = memory.local.device.count;
    search.stamps = stamps();
    search.frustum = frustum;
    search.geometry = geometry();
    search.params = local_params;
    search.radius_factor = radius_factor;
    search.seen = memory.visible;
    return search;
  }

  // ---- state

  /// Makes extractor and matcher. take_memory() and initialize() follow.
  /// @throws bad_argument, std::bad_alloc, cuda_error
  void prepare(Exec const& exec, Rig const& of, tracker_params const& p, int pairs) {
    prepare_features(exec, of, p, pairs, detail::absent_images_of(of));
    matcher = stereo_matcher<Exec, Rig>(rig, extractor);
  }
  /// Makes the extractor alone: the matcher is the caller's. @param absent as in orb_extractor
  void prepare_features(Exec const& exec, searched_rig const& of, tracker_params const& p,
                        int pairs, absent_images const& absent) {
    rig = of;
    params = p;
    batch = pairs;
    extractor = make_extractor(exec, absent);
    frustum.max_x = static_cast<float>(params.orb.width);
    frustum.max_y = static_cast<float>(params.orb.height);
    frustum.log_scale_factor = log_rounded(params.orb.scale_factor);
    frustum.levels = params.orb.levels;
  }
  /// An extractor of frames. @throws bad_argument, std::bad_alloc, cuda_error
  orb_extractor<Exec> make_extractor(Exec const& exec, absent_images const& absent) const {
    std::vector<stereo_overlap> overlaps;
    for (int i = 0; !rectified && i < Rig::images * batch; ++i) {
      overlaps.push_back(params.overlap[i % 2]);
    }
    return {exec, params.orb, Rig::images * batch, overlaps, absent};
  }
  /// @param images [batch][images]
  void take_memory(image_source const* images) {
    sources = images;
    memory.take(frame_shape::of<Rig>(capacity(), batch), params,
                grid_geometry::over(frustum.min_x, frustum.min_y, frustum.max_x, frustum.max_y),
                lists_local_early());
    point_frame_at_features();
    stereo_branch_.make();
    parts_.make(batch, Rig::images, params.use_graphs);
    result_branch_.make();
  }
  /// The keypoints where they were found, or where the undistorted camera sees them.
  keypoints_view unmoved_keypoints() const {
    if constexpr (undistorts) {
      return matcher.keypoints(extractor);
    } else {
      return extractor.keypoints();
    }
  }
  /// The frame's keypoints and stereo are those of the extractor and the matcher.
  void point_frame_at_features() {
    memory.frame.keypoints = unmoved_keypoints();
    if (moved.count != nullptr) {
      memory.frame.keypoints = with_columns(memory.frame.keypoints, moved);
    }
    if constexpr (rectified) {
      memory.frame.right_x = array_of<field::right_x>(matcher.matches());
    } else {
      memory.frame.partner = matcher.fisheye_matches().partner;
    }
  }
  void initialize(Exec const& exec) { memory.initialize(exec); }
  /// @param holders [cameras * capacity]
  void set_last(Exec const& exec, int b, pose const& T_cw, int const* holders) {
    memory.set_last(exec, b, T_cw, holders);
  }
  void forget_stamps(Exec const& exec) const { memory.forget_stamps(exec); }
  allocated_bytes bytes() const {
    return allocated_bytes{extractor.bytes() + matcher.bytes(), 0} + memory.bytes();
  }
  int capacity() const { return extractor.capacity(); }
  pyramid_geometry const& geometry() const { return extractor.geometry(); }

private:
  extraction<Exec> const& features() const { return extractor.stages(); }
  /// The frame, as its searches take it.
  frame_view searched_frame() const { return memory.frame.of_searches(Rig::searches); }
  search_buffers last_buffers() const { return {memory.last_windows, memory.last_work}; }
  search_buffers local_buffers() const { return {memory.local_windows, memory.local_work}; }
  point_stamps stamps() const { return {memory.motion.device.stamp, memory.stamps}; }
  /// The pose at which the search in the local map begins, [batch].
  pose const* pose_of_motion() const {
    return params.optimize_last ? memory.poses : memory.motion.device.predicted;
  }
  last_search<searched_rig> last_input() const {
    last_search<searched_rig> search;
    search.rig = rig;
    search.T_cw = memory.motion.device.predicted;
    search.last_T_cw = memory.last.T_cw;
    search.last.keypoints = memory.last.keypoints;
    search.last.keypoint_step = Rig::images / Rig::searches;
    search.last.cameras = cameras / Rig::searches;
    search.last.holder = memory.last.holder;
    search.geometry = geometry();
    search.params.window_radius = params.window_radius;
    search.params.retry_below = params.enough_matches;
    search.params.min_x = frustum.min_x;
    search.params.min_y = frustum.min_y;
    search.params.max_x = frustum.max_x;
    search.params.max_y = frustum.max_y;
    search.stamps = stamps();
    return search;
  }
  void optimize(Exec const& exec, frames_in_map const& in, pose const* start) const {
    optimize_frame_poses(exec, rig, in, {start, memory.poses, memory.observations, information},
                         pose_settings);
  }

  pixels_view aligned_;
  float const* aligned_right_x_ = nullptr;
  image_parts<Exec> parts_;
  side_branch<Exec> stereo_branch_;
  side_branch<Exec> result_branch_;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
