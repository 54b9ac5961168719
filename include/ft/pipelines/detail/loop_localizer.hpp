// SPDX-License-Identifier: Apache-2.0
/// @file Finds a camera anywhere among the keyframes of a loaded map that stays as it is.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "ft/containers/loop_archive.hpp"
#include "ft/containers/odometry_map.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/loops/page_keyframes.hpp"
#include "ft/kernels/odometry/recovery_evidence.hpp"
#include "ft/kernels/odometry/settle_lost.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "ft/pipelines/detail/loop_path.hpp"
#include "ft/pipelines/detail/odometry_download.hpp"
#include "ft/pipelines/detail/odometry_stages.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The map of an odometry that has tracking_rules::localize_only is the loaded one until the camera
/// is placed elsewhere: then a page of it, the keyframes that are kept around that place.
template <typename Exec, typename Rig>
class loop_localizer {
  using stages_type = odometry_stages<Exec, Rig>;
  static constexpr memory_space space = Exec::space;

public:
  loop_localizer(stages_type const& stages, loop_archive_view const& archive)
      : stages_(stages), archive_(archive) {
    keyframes_view const& k = stages.own.map.keyframes;
    int const slots = stages.own.map.records.slots;
    most_ = min_of(k.positions, slots / archive.points);
    loaded_ = owner<odometry_map_view, space>([&](carver& c, odometry_map_view& v) {
      carve(c, v, {slots, {k.positions, k.cameras, k.capacity}}, 1);
    });
    memory_ = owner<memory, space>([&](carver& c, memory& m) {
      c.place({most_}, m.page);
      c.place({max_keyframes}, m.votes);
      c.place({1}, m.evidence, m.begins);
    });
    staging_ = owner<staging, staging_space<Exec>>([&](carver& c, staging& s) {
      c.place({most_}, s.page);
      c.place({max_keyframes}, s.votes);
      c.place({1}, s.T_cw, s.radius_factor, s.mode, s.outcome, s.evidence, s.inliers);
    });
  }

  /// A map was loaded. Waits, and allocates.
  /// @param path its keyframes @param archive their rows, in host memory
  void load(Exec const& exec, loop_path const& path, loop_archive_view const& archive) {
    odometry_map_view const& map = stages_.own.map;
    copy_columns(exec, loaded_.view(), map);
    keyframes_view const& k = map.keyframes;
    int const made = downloaded(exec, k.made, 1)[0], count = downloaded(exec, k.count, 1)[0];
    auto const times = downloaded(exec, k.time_ns, static_cast<std::size_t>(k.positions));
    in_loaded_.assign(path.keyframes.size(), -1);
    far_.clear();
    for (int i = 0; i < path.size(); ++i) {
      for (int number = made - count + 1; number <= made; ++number) {
        int const p = k.position(number);
        bool const is = times[static_cast<std::size_t>(p)] == path.at(i).time_ns;
        if (is) { in_loaded_[static_cast<std::size_t>(i)] = p; }
      }
      far_.push_back(path.at(i).T_world_camera.scale * distance(archive, path.at(i).row));
    }
    order_.reserve(far_.size());
    off_.assign(far_.size(), 0);
    at_ = in_loaded_;
    is_page_ = false;
  }
  odometry_map_view const& loaded() const { return loaded_.view(); }
  allocated_bytes bytes() const { return {memory_.bytes() + loaded_.bytes(), staging_.bytes()}; }

  /// Whether the camera leaves what is in the map: where a kept keyframe is nearer by half, and all
  /// that are in it are off by more than a quarter of the distance of what they see.
  bool leaves(loop_path const& path, similarity<double> const& T_world_camera) {
    if (sort_by_distance(path, T_world_camera, 1) == 0) { return false; }
    auto const best = static_cast<std::size_t>(order_[0]);
    double least = std::numeric_limits<double>::infinity();
    for (int const i : order_) {
      auto const k = static_cast<std::size_t>(i);
      if (at_[k] >= 0) { least = std::min(least, off_[k]); }
    }
    return least > 2 * off_[best] && least > 0.25 * far_[best];
  }

  /// Tracks the frame in the loaded map, or in a page of it, around a pose, if what is found there
  /// is evident. The loaded map has better points, and is taken where it has the nearest keyframe.
  /// Waits. @return whether the frame is tracked
  bool place(Exec const& exec, loop_path const& path, similarity<double> const& T_world_camera,
             similarity<double> const& T_world_odom) {
    int const n = sort_by_distance(path, T_world_camera, most_);
    if (n == 0) { return false; }
    auto const T = (T_world_odom.inverse() * T_world_camera).orthonormalized();
    pose const T_cw = without_scale(T).inverse().template cast<float>();
    if (in_loaded_[static_cast<std::size_t>(order_[0])] >= 0) {
      show_loaded(exec);
      if (search_around(exec, T_cw)) { return true; }
    }
    show_page(exec, path, T_world_odom, n);
    if (search_around(exec, T_cw)) { return true; }
    show_loaded(exec);
    return false;
  }

private:
  struct memory {
    paged_keyframe* page = nullptr;    ///< [most_]
    int* votes = nullptr;              ///< [max_keyframes] of keyframes by position
    std::int64_t* evidence = nullptr;  ///< [1]
    keyframe_order* begins = nullptr;  ///< [1]
  };
  struct staging {
    paged_keyframe* page = nullptr;  ///< [most_]
    int* votes = nullptr;            ///< [max_keyframes]
    pose* T_cw = nullptr;
    float* radius_factor = nullptr;
    local_map_mode* mode = nullptr;
    place_outcome* outcome = nullptr;
    std::int64_t* evidence = nullptr;
    int* inliers = nullptr;
  };

  /// Median distance of the points of a row; 0 without any.
  static double distance(loop_archive_view const& archive, int row) {
    std::vector<float> all;
    for (std::ptrdiff_t i = archive.at(row); i < archive.at(row) + archive.count[row]; ++i) {
      all.push_back(dot(archive.point[i], archive.point[i]));
    }
    if (all.empty()) { return 0; }
    auto const middle = all.begin() + static_cast<std::ptrdiff_t>(all.size() / 2);
    std::nth_element(all.begin(), middle, all.end());
    return std::sqrt(static_cast<double>(*middle));
  }

  /// Lists the keyframes of the newest one's part by how far they and what they look at are from a
  /// camera and what it looks at. @return how many are listed, at most so many
  int sort_by_distance(loop_path const& path, similarity<double> const& T_world_camera, int most) {
    order_.clear();
    vec3<double> const ahead{0, 0, 1};
    for (int i = 0; i < path.size(); ++i) {
      if (path.at(i).part != path.keyframes.back().part) { continue; }
      auto const& T = path.at(i).T_world_camera;
      double const far = far_[static_cast<std::size_t>(i)];
      auto const off = T.t - T_world_camera.t;
      auto const looks = off + scaled(T.R * ahead - T_world_camera.R * ahead, far);
      off_[static_cast<std::size_t>(i)] = std::sqrt(dot(off, off)) + std::sqrt(dot(looks, looks));
      order_.push_back(i);
    }
    std::sort(order_.begin(), order_.end(), [this](int a, int b) {
      double const of_a = off_[static_cast<std::size_t>(a)];
      double const of_b = off_[static_cast<std::size_t>(b)];
      return of_a < of_b || (!(of_b < of_a) && a > b);
    });
    return min_of(most, static_cast<int>(order_.size()));
  }

  /// The map becomes a page of the first n keyframes in order_.
  void show_page(Exec const& exec, loop_path const& path, similarity<double> const& T_world_odom,
                 int n) {
    exec.wait();  // for what is staged
    auto const T_odom_world = T_world_odom.inverse();
    at_.assign(at_.size(), -1);
    for (int k = 0; k < n; ++k) {  // the nearest one is the newest one
      int const i = order_[static_cast<std::size_t>(n - 1 - k)];
      path_keyframe const& of = path.at(i);
      auto const T = (T_odom_world * of.T_world_camera).orthonormalized();
      staging_->page[k] = {of.row, of.time_ns, without_scale(T).inverse(), T};
      at_[static_cast<std::size_t>(i)] = k;
    }
    copy(exec, memory_->page, static_cast<paged_keyframe const*>(staging_->page),
         static_cast<std::size_t>(n));
    page_keyframes(exec, stages_.rig, stages_.geometry(), archive_, memory_->page, n,
                   stages_.own.map);
    is_page_ = true;
  }
  void show_loaded(Exec const& exec) {
    if (is_page_) { copy_columns(exec, stages_.own.map, loaded_.view()); }
    at_ = in_loaded_;
    is_page_ = false;
  }
  /// In the map, first with a wide radius, then from where that has led to. @return whether what is
  /// found there is evident, as settle_lost_frames() judges it: a frame that was tracked before
  /// stays tracked without
  bool search_around(Exec const& exec, pose const& T_cw) const {
    exec.wait();  // for what is staged
    std::fill_n(staging_->votes, max_keyframes, 0);
    int votes = static_cast<int>(order_.size());
    for (int const i : order_) {
      int const position = at_[static_cast<std::size_t>(i)];
      if (position >= 0) { staging_->votes[position] = votes; }
      --votes;
    }
    copy(exec, memory_->votes, static_cast<int const*>(staging_->votes),
         std::size_t{max_keyframes});
    *staging_->T_cw = T_cw;
    copy(exec, stages_.memory.poses, static_cast<pose const*>(staging_->T_cw), 1);
    search(exec, stages_.settings.rules.first_wide_search);
    search(exec, 1);
    settle(exec);
    tracking_rules const& rules = stages_.settings.rules;
    return *staging_->inliers >= rules.min_recovered && is_enough(*staging_->evidence, rules);
  }
  /// From memory.poses, of which the optimised pose takes the place.
  void search(Exec const& exec, float radius_factor) const {
    exec.wait();  // for what is staged
    *staging_->radius_factor = radius_factor;
    *staging_->mode = local_map_mode::given;
    odometry_state_view const& state = stages_.own.state;
    copy(exec, state.radius_factor, static_cast<float const*>(staging_->radius_factor), 1);
    copy(exec, state.mode, static_cast<local_map_mode const*>(staging_->mode), 1);
    stages_.forget_stamps(exec);
    clear_holders(exec, stages_.memory.frame);
    stages_.choose_local(exec, memory_->votes);
    stages_.list_local_map(exec);
    stages_.assign_local_map(exec);
    stages_.optimize_local(exec);
  }
  /// What the frame's searches say becomes its result.
  void settle(Exec const& exec) const {
    *staging_->outcome = place_outcome::known;
    looked_up_frames in;
    in.frame = stages_.memory.frame;
    in.outcome = staging_->outcome;
    in.found_T_cw = in.T_cw = stages_.memory.poses;
    in.found_inliers = in.inliers = stages_.memory.observations.inliers;
    in.found_evidence = memory_->evidence;
    in.matches = stages_.memory.local_work.matches;
    in.matched = stages_.own.matched;
    in.begins = memory_->begins;
    weigh_recoveries(exec, stages_.local_input(), stages_.params.local_points, stages_.memory.frame,
                     stages_.memory.map, in.found_inliers, memory_->evidence);
    copy(exec, staging_->evidence, static_cast<std::int64_t const*>(memory_->evidence), 1);
    copy(exec, staging_->inliers, static_cast<int const*>(in.found_inliers), 1);
    settle_lost_frames(exec, stages_.settings.rules, in, stages_.own.state);
    stages_.keep_counts(exec);
    stages_.pack_matches(exec, stages_.outcome_of_local());
    stages_.pack_outputs(exec, nullptr);
    exec.wait();
  }

  stages_type const& stages_;
  loop_archive_view archive_;
  int most_ = 0;  ///< keyframes of a page
  owner<odometry_map_view, space> loaded_;
  owner<memory, space> memory_;
  owner<staging, staging_space<Exec>> staging_;
  bool is_page_ = false;  ///< the map is none of the loaded one now
  // Of the keyframes of the path:
  std::vector<int> in_loaded_;  ///< position in the loaded map, -1 = none
  std::vector<int> at_;         ///< position in the map now, likewise
  std::vector<double> far_;     ///< median distance of what each sees
  std::vector<double> off_;     ///< of sort_by_distance()
  std::vector<int> order_;      ///< of sort_by_distance()
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
