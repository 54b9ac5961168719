// SPDX-License-Identifier: Apache-2.0
/// @file Stereo visual odometry built from ft's stages, for either executor and either kind of rig.
///
/// Per frame:
/// - predict the pose with constant velocity over the elapsed time;
/// - features, stereo, search from the last frame, pose;
/// - local map of the keyframes that share points (chosen on the host), frustum, search, pose;
/// - if too few points are left: a new keyframe, and a bundle adjustment of the newest keyframes
///   and points (on the host).
///
/// A lost camera is searched for around the last poses with a wide search. If that fails for long,
/// a new map is begun.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "examples/track_sequence/conversions.hpp"
#include "examples/track_sequence/motion_model.hpp"
#include "examples/track_sequence/odometry.hpp"
#include "examples/track_sequence/sparse_map.hpp"
#include "examples/track_sequence/stage_sums.hpp"
#include "ft/pipelines/frame_tracker.hpp"

namespace app {

namespace vo {

constexpr int min_stereo_points = 60;    ///< to begin a map
constexpr int min_inliers = 20;          ///< to call a frame tracked
constexpr int min_motion_inliers = 10;   ///< to trust the pose from the last frame
constexpr int min_recovered = 30;        ///< to call a lost camera found
constexpr float wide_searches[]{6, 20};  ///< factors on the local search's radius when lost
constexpr int patience = 5;              ///< lost frames with features before a new map is begun
constexpr int wanted_near_points = 100;  ///< near points that a keyframe should have at least
constexpr int new_near_points = 70;      ///< a keyframe is made if this many could be added
constexpr double keep_share = 0.75;      ///< minimal share of the last keyframe's tracked points

}  // namespace vo

template <typename Exec, typename Rig>
class visual_odometry final : public odometry {
  static constexpr int cameras = ft::frame_tracker<Exec, Rig>::cameras;

public:
  visual_odometry(Exec exec, odometry_options const& options, std::string device)
      : exec_(std::move(exec)),
        options_(options),
        device_(std::move(device)),
        tracker_(exec_, rig_of<Rig>(options), tracker_params_of(options)),
        map_(tracker_.params().map_slots,
             std::vector<float>(tracker_.geometry().scale,
                                tracker_.geometry().scale + options.levels)),
        sums_({"upload", "pyramid", "corners", "distribution", "blur", "order", "descriptors",
               "stereo", "search last frame", "pose last frame", "update local map",
               "search local map", "pose local map", "result", "keyframe", "total"}),
        descriptors_(static_cast<std::size_t>(tracker_.capacity())) {}

  frame_outcome track(std::int64_t time_ns, std::uint8_t const* left,
                      std::uint8_t const* right) override {
    sums_.reset();
    double const start = now_ms();
    interval_ns_ = time_ns - time_ns_;
    time_ns_ = time_ns;
    auto const& p = tracker_.params().orb;
    tracker_.set_image(0, 0, {left, p.width, p.height, p.width});
    tracker_.set_image(0, 1, {right, p.width, p.height, p.width});

    frame_outcome out;
    bool found = false;
    bool const has_map = map_.keyframe_count() > 0;
    if (has_map && lost_frames_ == 0) {
      found = track_from_last(out);
    } else {
      run([&] { tracker_.extract(exec_); });
    }
    if (has_map && !found) { found = recover(out); }
    finish(out, found, has_map);
    out.keypoints = tracker_.result().keypoints[0];
    out.stereo_matches = count([&](int i) { return tracker_.result().depth[i] > 0; });
    sums_.add("total", now_ms() - start);
    out.stage_ms = sums_.ms();
    return out;
  }

  std::vector<std::string> const& stage_names() const override { return sums_.names(); }

  std::vector<seen_keypoint> keypoints() const override {
    auto const& r = tracker_.result();
    std::vector<seen_keypoint> all;
    for (int i = 0; i < r.keypoints[0]; ++i) {
      auto const k = static_cast<std::size_t>(i);
      all.push_back({r.x[i], r.y[i], r.octave[i], r.depth[i], held_[k], matched_[k] != 0});
    }
    return all;
  }
  int keyframes() const override { return keyframes_made_; }
  int map_points() const override { return map_.point_count(); }
  int maps() const override { return maps_; }
  std::string device() const override { return device_; }

private:
  /// Enqueues a call of the tracker and waits for its result.
  template <typename Call>
  void run(Call const& call) {
    call();
    exec_.wait();
    for (auto const& stage : tracker_.stage_times()) { sums_.add(stage.name, 1e-3 * stage.us); }
  }
  template <typename Host>
  void timed(char const* stage, Host const& body) {
    double const start = now_ms();
    body();
    sums_.add(stage, now_ms() - start);
  }
  template <typename Condition>
  int count(Condition const& condition) const {
    int n = 0;
    for (int i = 0; i < tracker_.result().keypoints[0]; ++i) {
      n += static_cast<int>(condition(i));
    }
    return n;
  }

  bool track_from_last(frame_outcome& out) {
    run([&] { tracker_.track_motion(exec_, to_ft(motion_.predict(T_cw_, interval_ns_))); });
    if (tracker_.result().inliers[0] < vo::min_motion_inliers) { return false; }
    std::vector<int> held = holders();
    timed("update local map",
          [&] { local_ = map_.local_points(held, tracker_.params().local_points); });
    run([&] { tracker_.track_local(exec_, local_); });
    // Points matched from the last frame are not tested again: they are in view.
    for (int slot : held) { map_.count_visible(slot); }
    count_in_view();
    out.local_points = static_cast<int>(local_.size());
    out.inliers = tracker_.result().inliers[0];
    return out.inliers >= vo::min_inliers;
  }

  /// Wide searches around poses where the camera may be.
  bool recover(frame_outcome& out) {
    std::vector<rigid_pose> const guesses{motion_.predict(T_cw_, interval_ns_), T_cw_,
                                          map_.last_keyframe_pose()};
    for (float const width : vo::wide_searches) {
      for (auto const& guess : guesses) {
        if (is_at(guess, width, out)) { return true; }
      }
    }
    return false;
  }

  /// Whether a search for the newest points finds the camera near a pose.
  bool is_at(rigid_pose const& guess, float width, frame_outcome& out) {
    timed("update local map", [&] { local_ = map_.recent_points(tracker_.params().local_points); });
    ft::local_search_params wide;
    wide.radius_factor = width;
    run([&] { tracker_.relocalize(exec_, {to_ft(guess), local_}, wide); });
    out.local_points = static_cast<int>(local_.size());
    out.inliers = tracker_.result().inliers[0];
    return out.inliers >= vo::min_recovered;
  }

  void count_in_view() {
    for (std::size_t i = 0; i < local_.size(); ++i) {
      if (tracker_.frame().in_view(static_cast<int>(i))) { map_.count_visible(local_[i]); }
    }
  }
  /// Every map point that the frame's keypoints hold, once.
  std::vector<int> holders() const {
    auto const& r = tracker_.result();
    std::vector<int> held;
    for (int c = 0; c < cameras; ++c) {
      for (int i = 0; i < r.keypoints[c]; ++i) {
        int const slot = r.holder[c * r.capacity + i];
        if (slot >= 0) { held.push_back(slot); }
      }
    }
    std::sort(held.begin(), held.end());
    held.erase(std::unique(held.begin(), held.end()), held.end());
    return held;
  }

  void finish(frame_outcome& out, bool found, bool has_map) {
    auto const& r = tracker_.result();
    if (found) {
      rigid_pose const T = from_ft(r.T_cw[0]);
      if (lost_frames_ == 0) {
        motion_.observe(T_cw_, T, interval_ns_);
      } else {
        motion_.rest();
      }
      T_cw_ = T;
      lost_frames_ = 0;
      hold();
      for (int slot : holders()) { map_.count_found(slot); }
      out.tracked = true;
      timed("keyframe", [&] {
        if (needs_keyframe()) {
          insert_keyframe();
          out.keyframe = true;
        }
      });
    } else {
      held_.assign(static_cast<std::size_t>(cameras * tracker_.capacity()), -1);
      matched_.assign(held_.size(), 0);
      out.inliers = 0;
      int const depths = count([&](int i) { return r.depth[i] > 0; });
      bool const usable = depths >= vo::min_stereo_points;
      if (has_map) {
        T_cw_ = motion_.predict(T_cw_, interval_ns_);  // the best guess: the motion slows down
        motion_.slow_down();
        lost_frames_ += 1;
        lost_with_features_ = usable ? lost_with_features_ + 1 : 0;
      }
      if (usable && (!has_map || lost_with_features_ >= vo::patience)) {
        timed("keyframe", [&] {
          map_.clear();
          motion_.rest();
          lost_frames_ = 0;
          lost_with_features_ = 0;
          insert_keyframe();
        });
        ++maps_;
        out.keyframe = true;
        out.tracked = !has_map;  // a later map starts at a guessed pose
      }
    }
    out.T_cw = T_cw_;
  }

  void hold() {
    auto const& r = tracker_.result();
    held_.assign(static_cast<std::size_t>(cameras * tracker_.capacity()), -1);
    std::copy(r.holder, r.holder + cameras * r.capacity, held_.begin());
    matched_.resize(held_.size());
    std::transform(held_.begin(), held_.end(), matched_.begin(),
                   [](int slot) { return static_cast<unsigned char>(slot >= 0); });
  }

  double near() const { return options_.near_depth * options_.baseline; }

  bool needs_keyframe() const {
    auto const& r = tracker_.result();
    auto const is_near = [&](int i) {
      return r.depth[i] > 0 && static_cast<double>(r.depth[i]) < near();
    };
    int const tracked = count([&](int i) { return r.holder[i] >= 0; });
    int const near_tracked = count([&](int i) { return is_near(i) && r.holder[i] >= 0; });
    int const near_free = count([&](int i) { return is_near(i) && r.holder[i] < 0; });
    bool const short_of_near =
        near_tracked < vo::wanted_near_points && near_free > vo::new_near_points;
    return short_of_near || tracked < vo::keep_share * reference_tracked_;
  }

  void insert_keyframe() {
    auto const& r = tracker_.result();
    tracker_.download_descriptors(exec_, 0, descriptors_.data(), r.keypoints[0]);
    exec_.wait();
    std::vector<keyframe_feature> features(static_cast<std::size_t>(r.keypoints[0]));
    for (int i = 0; i < r.keypoints[0]; ++i) {
      auto& f = features[static_cast<std::size_t>(i)];
      f.slot = held_.empty() ? -1 : held_[static_cast<std::size_t>(i)];
      f.camera = {static_cast<double>(r.point[i].x), static_cast<double>(r.point[i].y),
                  static_cast<double>(r.point[i].z)};
      f.octave = r.octave[i];
      std::memcpy(f.orb.data(), &descriptors_[static_cast<std::size_t>(i)], sizeof f.orb);
    }
    map_.cull();
    for (auto& slot : held_) { slot = map_.alive(slot) ? slot : -1; }  // before slots are reused
    map_.insert(T_cw_, features, near(), vo::wanted_near_points);
    ++keyframes_made_;
    reference_tracked_ = 0;
    for (int i = 0; i < r.keypoints[0]; ++i) {
      int const slot = features[static_cast<std::size_t>(i)].slot;
      held_[static_cast<std::size_t>(i)] = slot;
      reference_tracked_ += static_cast<int>(slot >= 0);
      if (slot >= 0 && r.partner[i] >= 0) { held_[static_cast<std::size_t>(r.partner[i])] = slot; }
    }
    map_.adjust(options_, seen_points());
    T_cw_ = map_.last_keyframe_pose();
    send_changes();
    tracker_.set_last(exec_, 0, to_ft(T_cw_), held_);
    exec_.wait();
  }

  /// The map points that the frame's keypoints hold, each once in a camera.
  std::vector<seen_point> seen_points() const {
    auto const& r = tracker_.result();
    std::vector<seen_point> seen;
    for (int c = 0; c < cameras; ++c) {
      auto const first = static_cast<std::ptrdiff_t>(seen.size());
      for (int i = 0; i < r.keypoints[c]; ++i) {
        int const k = c * r.capacity + i;
        int const slot = held_[static_cast<std::size_t>(k)];
        if (slot >= 0) {
          seen.push_back(
              {slot, c, static_cast<double>(r.x[k]), static_cast<double>(r.y[k]), r.octave[k]});
        }
      }
      if constexpr (Rig::rectified) {
        double const bf = options_.baseline * options_.fx;
        for (int i = 0; i < r.keypoints[0]; ++i) {
          int const slot = held_[static_cast<std::size_t>(i)];
          if (slot >= 0 && r.depth[i] > 0) {
            seen.push_back({slot, 1, bf / static_cast<double>(r.depth[i]), 0, r.octave[i]});
          }
        }
      }
      std::stable_sort(seen.begin() + first, seen.end(), [](auto const& a, auto const& b) {
        return std::pair(a.camera, a.slot) < std::pair(b.camera, b.slot);
      });
      seen.erase(std::unique(seen.begin() + first, seen.end(),
                             [](auto const& a, auto const& b) {
                               return std::pair(a.camera, a.slot) == std::pair(b.camera, b.slot);
                             }),
                 seen.end());
    }
    return seen;
  }

  void send_changes() {
    std::vector<ft::point_update> updates;
    for (int slot : map_.take_changes()) {
      auto const& p = map_.point(slot);
      ft::point_update u;
      u.slot = slot;
      u.observations = map_.observations(slot);
      u.position = {p.position[0], p.position[1], p.position[2]};
      u.normal = {p.normal[0], p.normal[1], p.normal[2]};
      u.min_distance = p.min_distance;
      u.max_distance = p.max_distance;
      std::memcpy(u.orb.words, p.orb.data(), sizeof u.orb.words);
      updates.push_back(u);
    }
    for (std::size_t first = 0; first < updates.size();) {
      std::size_t const n =
          std::min(updates.size() - first, static_cast<std::size_t>(tracker_.params().updates));
      tracker_.update_map(exec_, 0, updates.data() + first, static_cast<int>(n));
      exec_.wait();
      first += n;
    }
  }

  Exec exec_;
  odometry_options options_;
  std::string device_;
  ft::frame_tracker<Exec, Rig> tracker_;
  sparse_map map_;
  stage_sums sums_;
  std::vector<ft::descriptor> descriptors_;
  std::vector<int> held_;  ///< slot of each keypoint of the last frame, including new points
  std::vector<unsigned char> matched_;  ///< whether it was matched to an older map point
  std::vector<int> local_;              ///< slots of the local map
  rigid_pose T_cw_;
  motion_model motion_;
  std::int64_t time_ns_ = 0;      ///< of the last frame
  std::int64_t interval_ns_ = 0;  ///< time from the preceding frame to it
  int lost_frames_ = 0;
  int lost_with_features_ = 0;
  int reference_tracked_ = 0;
  int keyframes_made_ = 0;
  int maps_ = 0;
};

}  // namespace app
