// SPDX-License-Identifier: Apache-2.0
/// @file Finds a camera anywhere among the keyframes of a loaded map that stays as it is.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include "ft/containers/loop_archive.hpp"
#include "ft/containers/odometry_map.hpp"
#include "ft/containers/point_patches.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/loops/order_keyframes.hpp"
#include "ft/kernels/loops/page_keyframes.hpp"
#include "ft/kernels/odometry/match_without_window.hpp"
#include "ft/kernels/odometry/recovery_evidence.hpp"
#include "ft/kernels/odometry/settle_lost.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/pipelines/detail/loop_frames.hpp"
#include "ft/pipelines/detail/loop_path.hpp"
#include "ft/pipelines/detail/odometry_download.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// What a loop_localizer takes of an odometry, in executor memory.
struct localized_frame {
  odometry_map_view const& map;
  point_patches_view const& patches;  ///< of its points
  pose_proposal const* proposals;
  pose* T_cw;
  int const* inliers;
  float* radius_factor;
  local_map_mode* mode;
  tracking_rules rules;
  bool starts_from_motion;  ///< maps do
};

/// Tracks the frame of a camera that was not found in a loaded map around the place that it may be
/// at: in that map, or in a page, the keyframes that are kept around the place. With
/// tracking_rules::localize_only the page is the odometry's map from then on, else a new map begins
/// in the frame. Compiled once for all rigs: stage_localizer launches what depends on them.
template <typename Exec>
class loop_localizer {
protected:
  static constexpr memory_space space = Exec::space;

public:
  loop_localizer(localized_frame const& frame, loop_archive_view const& archive)
      : archive_(archive), frame_(frame), map_(frame.map) {
    keyframes_view const& k = map_.keyframes;
    most_ = min_of(k.positions, map_.records.slots / archive.points);
    memory_ = owner<memory, space>([&](carver& c, memory& m) {
      c.place({most_}, m.page);
      c.place({max_keyframes}, m.votes, m.places);
      c.place({1}, m.evidence, m.begins);
    });
    staging_ = owner<staging, staging_space<Exec>>([&](carver& c, staging& s) {
      c.place({most_}, s.page);
      c.place({max_keyframes}, s.votes, s.places);
      c.place({1}, s.T_cw, s.radius_factor, s.mode, s.outcome, s.evidence, s.inliers, s.proposal);
    });
  }

  loop_localizer(loop_localizer const&) = delete;
  loop_localizer& operator=(loop_localizer const&) = delete;
  virtual ~loop_localizer() = default;

  /// A map was loaded. Waits, and allocates.
  /// @param path its keyframes @param archive their rows, in host memory
  void load(Exec const& exec, loop_path const& path, loop_archive_view const& archive) {
    keyframes_view const& k = map_.keyframes;
    loaded_ = owner<odometry_map_view, space>([&](carver& c, odometry_map_view& v) {
      carve(c, v, {map_.records.slots, {k.positions, k.cameras, k.capacity}}, 1);
    });
    copy_columns(exec, loaded_.view(), map_);
    int const made = downloaded(exec, k.made, 1)[0], count = downloaded(exec, k.count, 1)[0];
    auto const ring = static_cast<std::size_t>(k.positions);
    auto const times = downloaded(exec, k.time_ns, ring);
    auto const T_cw = downloaded(exec, k.T_cw, ring);
    ring_.clear();
    for (int number = made - count + 1; number <= made; ++number) {
      int const p = k.position(number);
      ring_.push_back({p, view_of(T_cw[static_cast<std::size_t>(p)].inverse()), 0});
    }
    farthest_first_ = ring_;
    kept_.clear();
    listed_.clear();
    for (int i = 0; i < path.size(); ++i) {
      path_keyframe const& of = path.at(i);
      double const far = median_distance(archive, of.row), scale = of.T_world_camera.scale;
      kept_keyframe keyframe{view_of(without_scale(of.T_world_camera)),
                             view_of(of.T_odom_camera),
                             path.T_world_odom(i),
                             scale * far,
                             far,
                             -1,
                             0};
      double nearest = std::numeric_limits<double>::infinity();
      for (ring_keyframe const& r : ring_) {
        auto const p = static_cast<std::size_t>(r.position);
        // Sessions may have the same times. Adjustments move a keyframe little.
        double const off = keyframe.in_odom.off(r.seen, far);
        if (times[p] != of.time_ns || off >= nearest || off > 0.25 * far) { continue; }
        nearest = off;
        keyframe.in_loaded = r.position;
        // Adjustments have moved it since it was made, and its points with it.
        bool const moved = !path.loops.empty() && i + 1 < path.size();
        if (moved) { keyframe.T_world_odom = of.T_world_camera * with_scale(T_cw[p]); }
      }
      kept_.push_back(keyframe);
      if (of.part == path.keyframes.back().part) { listed_.push_back(i); }
    }
    order_ = listed_;
    at_.clear();
    show_as_loaded();
  }
  /// The map goes on, and is its own.
  void forget() { loaded_ = {}; }
  odometry_map_view const& loaded() const { return loaded_.view(); }
  allocated_bytes bytes() const { return {memory_.bytes() + loaded_.bytes(), staging_.bytes()}; }

  /// Whether the camera is outside of the keyframes in the map.
  bool leaves(similarity<double> const& T_world_camera) const {
    camera_view const from = view_of(without_scale(T_world_camera));
    constexpr double none = std::numeric_limits<double>::infinity();
    double best = none, least = none, far = 0;
    for (int const i : listed_) {
      kept_keyframe const& k = kept(i);
      double const off = k.in_world.off(from, k.far);
      if (off <= best) {
        best = off;
        far = k.far;
      }
      if (at_[static_cast<std::size_t>(i)] >= 0) { least = std::min(least, off); }
    }
    return is_outside(least, best, far);
  }

  /// Tracks the frame in the loaded map, or in a page of it, around a pose, if what is found there
  /// is evident. The loaded map has better points, and is taken where a camera would not leave it.
  /// Waits. @param T_world_odom of a page; in the loaded map that of the nearest keyframe holds
  /// @param wide factor on the radius of the first search
  /// @return whether the frame is tracked
  bool place(Exec const& exec, loop_path const& path, similarity<double> const& T_world_camera,
             similarity<double> const& T_world_odom, float wide) {
    if (listed_.empty()) { return false; }
    sort_by_distance(T_world_camera);
    int const in_loaded = nearest_in_loaded();
    if (in_loaded >= 0) {
      show_loaded(exec);
      if (search_around(exec, in_map(correction(in_loaded), T_world_camera), wide)) { return true; }
    }
    // One camera begins a map by its motion.
    if (frame_.starts_from_motion && !localize_only()) { return false; }
    show_page(exec, path, T_world_odom, min_of(most_, static_cast<int>(order_.size())));
    if (search_around(exec, in_map(T_world_odom, T_world_camera), wide)) { return true; }
    show_loaded(exec);
    return false;
  }
  /// The pose that the frame's matches anywhere in the image have given, if there is one. Waits.
  std::optional<rigid<double>> proposed(Exec const& exec) const {
    pose_proposal* const to = staging_->proposal;
    copy(exec, to, frame_.proposals, 1);
    exec.wait();
    return to->adopted != 0 ? std::optional<rigid<double>>(to->T_cw) : std::nullopt;
  }
  /// Of the path, to the pose of the last place().
  int nearest() const { return order_[0]; }
  /// The keyframe of the path, of those in the loaded map, that a camera in it is nearest to; -1 in
  /// a page.
  int beside(rigid<double> const& T_odom_camera) const {
    if (is_page_) { return -1; }
    camera_view const from = view_of(T_odom_camera);
    double best = std::numeric_limits<double>::infinity();
    int nearest = -1;
    for (int const i : listed_) {
      kept_keyframe const& k = kept(i);
      double const off = k.in_loaded < 0 ? best : k.in_odom.off(from, k.far_in_map);
      if (off < best) {
        best = off;
        nearest = i;
      }
    }
    return nearest;
  }
  /// T_world_odom there.
  similarity<double> correction(int i) const { return kept(i).T_world_odom.orthonormalized(); }
  /// The keyframes of the loaded map that are nearest to a camera become its newest ones: the
  /// adjustment of the next keyframe is tied to them, a lost camera is searched for beside them,
  /// and the farthest ones leave first. Waits.
  void order(Exec const& exec, rigid<double> const& T_odom_camera) {
    show_loaded(exec);
    exec.wait();  // for what is staged
    camera_view const from = view_of(T_odom_camera);
    double const far = kept(nearest()).far_in_map;
    for (ring_keyframe& r : farthest_first_) { r.off = r.seen.off(from, far); }
    std::sort(farthest_first_.begin(), farthest_first_.end(), [](auto const& a, auto const& b) {
      return a.off > b.off || (!(b.off > a.off) && a.position < b.position);
    });
    std::fill_n(staging_->places, max_keyframes, -1);
    for (std::size_t i = 0; i < ring_.size(); ++i) {
      staging_->places[farthest_first_[i].position] = ring_[i].position;
    }
    copy(exec, memory_->places, static_cast<int const*>(staging_->places),
         std::size_t{max_keyframes});
    order_keyframes(exec, loaded_.view(), memory_->places, map_);
    clear(exec, frame_.patches);
    is_ordered_ = true;
    for (int const i : listed_) {
      int const p = kept(i).in_loaded;
      if (p >= 0) { at_[static_cast<std::size_t>(i)] = staging_->places[p]; }
    }
    exec.wait();
  }

protected:
  /// What was found becomes the frame's result.
  struct decision {
    place_outcome const* outcome;
    std::int64_t const* evidence;
    keyframe_order* begins;
  };
  /// The map becomes a page of n keyframes.
  virtual void page(Exec const& exec, paged_keyframe const* keyframes, int n) const = 0;
  /// Searches the local map, and optimises the pose. @param votes of keyframes by position
  virtual void search_local_map(Exec const& exec, int const* votes) const = 0;
  virtual void weigh(Exec const& exec, std::int64_t* evidence) const = 0;
  /// Waits.
  virtual void settle(Exec const& exec, decision const& by) const = 0;

  loop_archive_view archive_;

private:
  struct memory {
    paged_keyframe* page = nullptr;    ///< [most_]
    int* votes = nullptr;              ///< [max_keyframes] of keyframes by position
    int* places = nullptr;             ///< [max_keyframes] of order_keyframes()
    std::int64_t* evidence = nullptr;  ///< [1]
    keyframe_order* begins = nullptr;  ///< [1]
  };
  struct staging {
    paged_keyframe* page = nullptr;  ///< [most_]
    int* votes = nullptr;            ///< [max_keyframes]
    int* places = nullptr;           ///< [max_keyframes]
    pose* T_cw = nullptr;
    float* radius_factor = nullptr;
    local_map_mode* mode = nullptr;
    place_outcome* outcome = nullptr;
    std::int64_t* evidence = nullptr;
    int* inliers = nullptr;
    pose_proposal* proposal = nullptr;
  };

  struct ring_keyframe {
    int position;
    camera_view seen;  ///< in the odometry's frame
    double off;        ///< of order()
  };
  struct kept_keyframe {
    camera_view in_world, in_odom;
    similarity<double> T_world_odom;  ///< of a camera beside it in the loaded map
    double far;                       ///< median distance of what it sees, metres
    double far_in_map;                ///< the same in the unit of its map
    int in_loaded;                    ///< position in the loaded map, -1 = none
    double off;                       ///< of sort_by_distance()
  };
  kept_keyframe const& kept(int i) const { return kept_[static_cast<std::size_t>(i)]; }

  static pose in_map(similarity<double> const& T_world_odom,
                     similarity<double> const& T_world_camera) {
    auto const T = (T_world_odom.inverse() * T_world_camera).orthonormalized();
    return without_scale(T).inverse().template cast<float>();
  }
  /// Lists the keyframes of the newest one's part by how far they and what they look at are from a
  /// camera and what it looks at.
  void sort_by_distance(similarity<double> const& T_world_camera) {
    camera_view const from = view_of(without_scale(T_world_camera));
    for (kept_keyframe& k : kept_) { k.off = k.in_world.off(from, k.far); }
    std::sort(order_.begin(), order_.end(), [this](int a, int b) {
      return kept(a).off < kept(b).off || (!(kept(b).off < kept(a).off) && a > b);
    });
  }

  /// Whether a camera is outside of some keyframes: a kept one is nearer by half, and they are off
  /// by more than a quarter of the distance of what it sees.
  static bool is_outside(double least, double best, double far) {
    return least > 2 * best && least > 0.25 * far;
  }
  /// In order_, of those in the loaded map; -1 where the camera is outside of them.
  int nearest_in_loaded() const {
    kept_keyframe const& best = kept(nearest());
    for (int const i : order_) {
      if (kept(i).in_loaded < 0) { continue; }
      return is_outside(kept(i).off, best.off, best.far) ? -1 : i;
    }
    return -1;
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
    page(exec, memory_->page, n);
    clear(exec, frame_.patches);
    is_page_ = true;
  }
  void show_loaded(Exec const& exec) {
    if (is_page_ || is_ordered_) {
      copy_columns(exec, map_, loaded_.view());
      clear(exec, frame_.patches);
    }
    show_as_loaded();
  }
  void show_as_loaded() {
    at_.resize(kept_.size());
    for (std::size_t i = 0; i < kept_.size(); ++i) { at_[i] = kept_[i].in_loaded; }
    is_page_ = is_ordered_ = false;
  }
  /// In the map, first with a wide radius, then from where that has led to. @return whether what is
  /// found there is evident, as settle_lost_frames() judges it: a frame that was tracked before
  /// stays tracked without
  bool search_around(Exec const& exec, pose const& T_cw, float wide) const {
    search_twice(exec, T_cw, wide);
    bool const begins = is_page_ && !localize_only();
    *staging_->outcome = begins ? place_outcome::begins_map : place_outcome::known;
    settle(exec, {staging_->outcome, memory_->evidence, memory_->begins});
    tracking_rules const& rules = frame_.rules;
    return *staging_->inliers >= rules.min_recovered && is_enough(*staging_->evidence, rules);
  }
  void search_twice(Exec const& exec, pose const& T_cw, float wide) const {
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
    copy(exec, frame_.T_cw, static_cast<pose const*>(staging_->T_cw), 1);
    search(exec, wide);
    search(exec, 1);
    // Before a map begins, which the points are not of.
    weigh(exec, memory_->evidence);
    copy(exec, staging_->evidence, static_cast<std::int64_t const*>(memory_->evidence), 1);
    copy(exec, staging_->inliers, frame_.inliers, 1);
  }
  /// From memory.poses, of which the optimised pose takes the place.
  void search(Exec const& exec, float radius_factor) const {
    exec.wait();  // for what is staged
    *staging_->radius_factor = radius_factor;
    *staging_->mode = local_map_mode::given;
    copy(exec, frame_.radius_factor, static_cast<float const*>(staging_->radius_factor), 1);
    copy(exec, frame_.mode, static_cast<local_map_mode const*>(staging_->mode), 1);
    search_local_map(exec, memory_->votes);
  }
  bool localize_only() const { return frame_.rules.localize_only; }

  localized_frame frame_;
  odometry_map_view const& map_;
  int most_ = 0;  ///< keyframes of a page
  owner<odometry_map_view, space> loaded_;
  owner<memory, space> memory_;
  owner<staging, staging_space<Exec>> staging_;
  bool is_page_ = false;             ///< the map is none of the loaded one now
  bool is_ordered_ = false;          ///< it is the loaded one with its keyframes in another order
  std::vector<ring_keyframe> ring_;  ///< of the loaded map, the oldest first
  std::vector<ring_keyframe> farthest_first_;  ///< the same, of order()
  // Of the keyframes of the path, which stay until the map goes on:
  std::vector<kept_keyframe> kept_;
  std::vector<int> listed_;  ///< those of the newest one's part
  std::vector<int> order_;   ///< the same, of sort_by_distance()
  std::vector<int> at_;      ///< of all, position in the map now, -1 = none
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
