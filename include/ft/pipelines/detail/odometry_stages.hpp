// SPDX-License-Identifier: Apache-2.0
/// @file The stages of a frame of an odometry, on its memory.
#pragma once

#include <algorithm>

#include "ft/cameras/multi_rig.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/map/choose_local_map.hpp"
#include "ft/kernels/map/count_sightings.hpp"
#include "ft/kernels/map/gather_window.hpp"
#include "ft/kernels/map/insert_keyframe.hpp"
#include "ft/kernels/odometry/align_keypoints.hpp"
#include "ft/kernels/odometry/frame_facts.hpp"
#include "ft/kernels/odometry/judge_frame.hpp"
#include "ft/kernels/odometry/match_without_window.hpp"
#include "ft/kernels/odometry/plan_search.hpp"
#include "ft/kernels/odometry/propose_pose.hpp"
#include "ft/kernels/odometry/refine_proposal.hpp"
#include "ft/kernels/odometry/split_motions.hpp"
#include "ft/pipelines/detail/monocular_parts.hpp"
#include "ft/pipelines/detail/odometry_download.hpp"
#include "ft/pipelines/detail/odometry_first_stages.hpp"
#include "ft/pipelines/detail/odometry_memory.hpp"
#include "ft/pipelines/detail/odometry_packing.hpp"
#include "ft/pipelines/detail/odometry_part.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The stages of a tracked frame, and those that choose its local map and keep its map. All are
/// asynchronous on their executor and allocate nothing.
template <typename Exec, typename Rig>
class odometry_stages : public odometry_first_stages<Exec, Rig> {
  using base = odometry_first_stages<Exec, Rig>;

public:
  using base::cameras;
  using base::memory;
  using base::own;
  using base::settings;

  odometry_part_list<Exec, Rig> plugged;
  /// Whether lost cameras begin a new map after the frame, not in it.
  bool recognizes_places = false;
  static constexpr bool starts_from_motion = rig_parts<Rig>::starts_from_motion;
  map_beginning<Exec, Rig> beginning;  ///< empty unless it starts from motion

  // ---- parts, at points of the schedule

  using part_type = odometry_part<Exec, Rig>;
  /// A point of the frame's launches.
  using part_launch = void (part_type::*)(Exec const&, odometry_stages const&) const;

  bool parts_launch() const {
    return std::any_of(plugged.begin(), plugged.end(), [](auto const& p) { return p->launches(); });
  }
  bool parts_tell_with_outputs() const {
    return std::all_of(plugged.begin(), plugged.end(),
                       [](auto const& p) { return p->tells_with_outputs(); });
  }
  void launch_parts(Exec const& exec, part_launch at) const {
    for (auto const& p : plugged) { ((*p).*at)(exec, *this); }
  }
  side_branch<Exec>& part_branch() { return part_branch_; }

  // ---- the local map

  void plan_search(Exec const& exec) const {
    search_start<typename base::searched_rig> start{this->rig, memory.observations.inliers,
                                                    memory.poses, memory.motion.device.stamp,
                                                    own.windowless.proposals};
    start.fixed = own.fixed;
    // The matcher's own memory: nothing else reads it at that time.
    start.depth = const_cast<float*>(this->matcher.depth());
    start.depth_cameras = memory.result.depth_cameras;
    start.changes = own.changes.of;
    plan_searches(exec, settings.rules, memory.frame, own.state, start);
  }
  /// Matches anywhere in the image, and the pose that most of them agree with: three launches.
  void search_without_window(Exec const& exec) const {
    windowless_search<typename base::searched_rig> in{};
    in.rig = this->rig;
    in.frame = memory.frame;
    in.map = own.map;
    in.last_holder = memory.last.holder;
    in.geometry = this->geometry();
    in.inliers = memory.observations.inliers;
    in.T_cw = memory.poses;
    in.fixed = own.fixed;
    match_without_window(exec, in, settings.rules, own.state, own.windowless);
    propose_poses(exec, in, settings.rules, own.state, own.windowless);
    refine_proposals(exec, in, settings.rules, own.state, own.windowless, this->pose_settings);
  }
  /// @param votes as in local_map_input
  void choose_local(Exec const& exec, int const* votes = nullptr) const {
    choose_local_map(exec, {memory.frame, own.state.mode, settings.local_map, votes}, own.map,
                     local_map(), own.local_work);
  }

  /// Whether keypoints are moved to where images look as they did.
  bool aligns() const {
    return settings.align_keypoints && !settings.own_features && !base::undistorts &&
           !this->rolls();
  }
  void align_matches(Exec const& exec) const {
    frames_to_align<typename base::searched_rig> in{};
    in.rig = this->rig;
    in.frame = memory.frame;
    in.images = this->extractor.pyramid();
    in.map = own.map.points;
    in.numbers = own.map.records.number;
    in.patches = own.patches;
    in.T_cw = memory.poses;
    in.tracks = own.state.tracks;
    in.aligned = own.aligned;
    in.right_x = memory.frame.right_x == nullptr ? nullptr : own.aligned_right_x;
    in.moves = own.moves;
    align_keypoints(exec, in);
  }

  /// After the last pose, and after all that reads depths beside it.
  void split_motions(Exec const& exec) const {
    motions_of_frames<typename base::searched_rig> in{};
    in.rig = this->rig;
    in.frame = memory.frame;
    in.observations = memory.observations;
    in.T_cw = memory.poses;
    in.information = own.information;
    in.depth = const_cast<float*>(this->matcher.depth());  // its own memory, as in plan_search()
    in.depth_cameras = memory.result.depth_cameras;
    in.geometry = this->geometry();
    in.moves = this->moves;
    ft::split_motions(exec, in, own.state, own.windowless, this->pose_settings);
  }

  // ---- the end

  void judge(Exec const& exec) const {
    searched_frames<typename base::searched_rig> in{};
    in.rig = this->rig;
    in.frame = memory.frame;
    in.depth = this->matcher.depth();
    in.inliers = memory.observations.inliers;
    in.T_cw = memory.poses;
    in.matched = own.matched;
    in.local = this->local_input();
    in.local_capacity = this->params.local_points;
    in.map = memory.map;
    if constexpr (starts_from_motion) {
      in.begins = beginning.begins();
      in.begins.patience = settings.rules.patience;
      in.begins.wants_more = this->extractor.stages().kept.wants_more;
    }
    in.begins_maps = !recognizes_places;
    judge_frames(exec, settings.rules, in, own.state);
  }
  /// Beside the judgement.
  void weigh(Exec const& exec) const {
    weigh_frames(
        exec, own.state.batch,
        weighed_frames<typename base::searched_rig>{
            this->rig, memory.observations, memory.poses, memory.last.T_cw, own.sources.correction,
            this->geometry(), pose_limits::of(this->pose_settings).disparity_root, this->moves},
        own.state.tracks, own.weighed);
  }
  /// Beside the search in the local map.
  void count_chances(Exec const& exec) const {
    count_chances_of_frames(exec, memory.frame, this->local_input(), this->params.local_points,
                            memory.map, own.chances);
  }
  void count_points(Exec const& exec) const {
    sightings_input in;
    in.kind = own.state.counts;
    in.seen = memory.visible;
    in.local = local_map();
    in.stamps = {memory.motion.device.stamp, memory.stamps};
    count_sightings(exec, memory.frame, in, own.map);
  }
  void look_for_start(Exec const& exec) {
    if constexpr (starts_from_motion) {
      beginning.look(exec, this->rig, memory.frame, this->geometry(), own, settings.rules);
    }
  }
  void insert_first(Exec const& exec) const {
    if constexpr (starts_from_motion) {
      beginning.insert_first(exec, this->rig, memory.frame, this->geometry(), own);
    }
  }
  void triangulate(Exec const& exec) const {
    if constexpr (starts_from_motion) {
      beginning.triangulate(exec, this->rig, memory.frame, this->geometry(), own,
                            settings.imu.present);
    }
  }
  void enter_new_points(Exec const& exec) const {
    if constexpr (starts_from_motion) {
      beginning.enter(exec, this->rig, memory.frame, this->geometry(), own);
    }
  }
  void insert(Exec const& exec) const { insert(exec, own.state.order); }
  /// The frame as one that may become a keyframe, by the order of the state.
  keyframe_input<typename base::searched_rig> as_keyframe() const {
    keyframe_input<typename base::searched_rig> in{};
    in.rig = this->rig;
    in.frame = this->aligned_frame();
    in.order = own.state.order;
    in.T_cw = own.state.T_cw;
    in.time_ns = own.state.time_ns;
    in.depth = this->matcher.depth();
    in.point = this->matcher.fisheye_matches().point;
    if constexpr (is_mixed_v<Rig>) { in.frame.partner = this->matcher.partners(); }
    in.geometry = this->geometry();
    in.moves = this->moves;
    return in;
  }
  /// @param order [batch] instead of that of the state
  void insert(Exec const& exec, keyframe_order const* order) const {
    auto in = as_keyframe();
    in.order = order;
    keyframe_params p;
    p.near_depth = max_of(settings.rules.near_depth, settings.rules.far_depth);
    p.wanted_near_points = settings.rules.wanted_near_points;
    if constexpr (starts_from_motion) {
      in.depth = beginning.points().depth;
      in.point = beginning.points().point;
      p.near_depth = beginning.farthest;
      p.wanted_near_points = 0;
    }
    insert_keyframe(exec, in, p, own.map, own.keyframe_out, own.keyframe_work);
    if (aligns()) {
      keep_patches(exec, in, this->extractor.pyramid(), own.map, own.keyframe_work, own.patches);
    }
  }
  void gather(Exec const& exec) const {
    gather_window(exec, {own.state.gather, this->geometry(), settings.window}, own.map, own.window,
                  own.sources);
  }
  /// What the host waits for. The frame's keyframe has not entered the map yet.
  void pack_outputs(Exec const& exec) const { pack_outputs(exec, own.weighed); }
  /// @param weighed null = camera_track::facts are complete
  void pack_outputs(Exec const& exec, frame_facts const* weighed) const {
    tracking_facts facts{memory.observations.inliers,
                         own.information,
                         memory.local.device.count,
                         own.local_left_out,
                         own.map.records.alive,
                         own.seen,
                         own.chances,
                         weighed};
    if constexpr (starts_from_motion) { facts.start = beginning.begins().report; }
    for_each_item<per_block<64>>(exec, own.state.batch, pack_tracking{}, own.state, facts,
                                 own.outputs);
  }
  /// After the keyframe and the window; pack_matches() follows.
  void keep_counts(Exec const& exec) const {
    for_each_item<per_thread>(exec, own.state.batch, keep_map_counts{}, own.state, own.keyframe_out,
                              own.sources.left_out, memory.poses);
  }

  // ---- state

  allocated_bytes bytes() const {
    return base::bytes() + allocated_bytes{this->grid_memory_.bytes() + this->rolling.bytes(), 0};
  }
  /// @param runs adjustments in flight, at most
  void take_all_memory(Exec const& exec, int runs) {
    if (this->rolls()) { this->moved = this->rolling.moved(); }
    base::take_memory(this->input.images().sources());
    own.take(frame_shape::of<Rig>(this->capacity(), this->batch), settings, runs);
    if constexpr (Rig::images > 2 || is_mixed_v<Rig>) { own.may_miss_images(); }
    if constexpr (starts_from_motion) {
      beginning.take(exec, this->rig, settings.start, own.map.keyframes,
                     memory.frame.grids.geometry);
    }
    memory.map = own.map.points;
    this->radius_factor = own.state.radius_factor;
    this->information = own.information;
    this->fixed = own.fixed;
    if (aligns()) { this->align_to(own.aligned, own.aligned_right_x, own.moves); }
    if constexpr (base::searched_rig::rectified && !starts_from_motion) {
      this->fixed_disparity_ = this->rig.pair(0).camera.fx / settings.rules.near_depth;
    }
    this->beginning_branch_.make();
    part_branch_.make();
    static_cast<void>(exec);
  }
  /// Forgets in which frames map points were matched. No frame has the number 0.
  void forget_frame_numbers(Exec const& exec) const {
    memory.forget_stamps(exec);
    fill_bytes(exec, own.map.records.found_frame, 0,
               static_cast<std::size_t>(own.map.records.slots) *
                   static_cast<std::size_t>(own.map.records.batch) * sizeof(int));
  }
  void initialize_all(Exec const& exec) {
    memory.initialize(exec);
    own.initialize(exec);
    if constexpr (starts_from_motion) { beginning.initialize(exec); }
    for (int b = 0; b < this->batch; ++b) { expect_start(exec, b, true); }
  }
  /// Says whether a map of camera b may begin with the next frame. Asynchronous.
  void expect_start([[maybe_unused]] Exec const& exec, [[maybe_unused]] int b,
                    [[maybe_unused]] bool expected) const {
    if constexpr (starts_from_motion) {
      fill_bytes(exec, this->extractor.stages().kept.wants_more + b, expected ? 1 : 0, sizeof(int));
    }
  }

  /// Forgets how the images of camera b changed. Asynchronous.
  void forget_images(Exec const& exec, int b) const {
    fill_bytes(exec, own.changes.begun + b * this->images_of_rig(), 0,
               static_cast<std::size_t>(this->images_of_rig()) * sizeof(int));
  }

  /// Makes camera b one that was lost in the map that it has. Waits, and allocates.
  /// @param anywhere loops look for it; one camera without depths begins a map at once, which they
  ///   may join with it
  /// @return its state
  tracking_state enter_loaded_map(Exec const& exec, int b, bool anywhere) const {
    keyframes_view const& k = own.map.keyframes;
    int const made = downloaded(exec, k.made + b, 1)[0];
    camera_track const before = downloaded(exec, own.state.tracks + b, 1)[0];
    buffer<camera_track, base::staging> const t(1);
    buffer<rigid<double>, base::staging> const T_cw(1);
    *t.data() = camera_track::initial();
    t.data()->adjusting = before.adjusting != 0 ? 2 : 0;
    *T_cw.data() = rigid<double>::identity();
    if (made > 0) {
      *T_cw.data() = downloaded(exec, k.T_cw + k.at(b, k.position(made)), 1)[0];
      t.data()->state = tracking_state::recovering;
      t.data()->lost_frames = 1;
      // The places to try repeat after so many frames: the first one is that of the newest
      // keyframe.
      constexpr int places = 60;
      if (anywhere && starts_from_motion) {
        t.data()->lost_with_features = ceil_div(settings.rules.patience, places) * places;
      }
      t.data()->keyframe = t.data()->predicted = *T_cw.data();
      t.data()->maps = 1;
      t.data()->keyframes = made;
      t.data()->map_keyframes = downloaded(exec, k.count + b, 1)[0];
    }
    tracking_state const state = t.data()->state;
    copy(exec, own.state.tracks + b, static_cast<camera_track const*>(t.data()), std::size_t{1});
    copy(exec, own.state.T_cw + b, static_cast<rigid<double> const*>(T_cw.data()), std::size_t{1});
    expect_start(exec, b, state == tracking_state::initialising);
    forget_images(exec, b);
    fill_bytes(exec, own.patches.number + own.patches.at(b, 0), 0,
               static_cast<std::size_t>(own.patches.slots) * sizeof(int));
    exec.wait();
    return state;
  }

private:
  local_map_view local_map() const {
    local_map_view v;
    v.capacity = this->params.local_points;
    v.slots = memory.local.device.slots;
    v.count = memory.local.device.count;
    v.left_out = own.local_left_out;
    return v;
  }

  side_branch<Exec> part_branch_;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
