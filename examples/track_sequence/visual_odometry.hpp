// SPDX-License-Identifier: Apache-2.0
/// @file ft::odometry behind the program's interface, for either executor and any rig.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <deque>
#include <ostream>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "examples/track_sequence/conversions.hpp"
#include "examples/track_sequence/odometry.hpp"
#include "examples/track_sequence/stage_sums.hpp"
#include "ft/cameras/check_calibration.hpp"
#include "ft/pipelines/explain.hpp"
#include "ft/pipelines/map_files.hpp"
#include "ft/pipelines/odometry.hpp"
#include "ft/pipelines/tracking_warnings.hpp"

namespace app {

/// The stages of a frame, in their order, and the whole.
template <typename Rig>
std::vector<std::string> stage_names_of() {
  std::vector<std::string> names = {"motion",
                                    "upload",
                                    "pyramid",
                                    "corners",
                                    "distribution",
                                    "blur",
                                    "order",
                                    "descriptors",
                                    "stereo",
                                    "search last frame",
                                    "pose last frame",
                                    "update local map",
                                    "search local map",
                                    "pose local map",
                                    "start",
                                    "keyframe",
                                    "result",
                                    "total"};
  names.erase(std::find(names.begin(), names.end(), ft::is_monocular_v<Rig> ? "stereo" : "start"));
  return names;
}

template <typename Exec, typename Rig>
class visual_odometry final : public odometry {
public:
  /// @throws ft::bad_argument
  visual_odometry(Exec const& exec, odometry_options const& options, std::string device)
      : options_(options),
        device_(std::move(device)),
        inner_(exec, rig_of<Rig>(options), odometry_params_of(options)),
        sums_(stage_names_of<Rig>()) {}

  frame_outcome track(std::int64_t time_ns, frame_pixels const& images) override {
    return timed(time_ns,
                 [&](std::int64_t stamp) { return inner_.track(images_of(images), stamp); });
  }
  void prefetch(frame_pixels const& images) override {
    double const start = now_ms();
    inner_.prefetch(images_of(images));
    prefetch_ms_ += now_ms() - start;
    handed_ms_.push_back(start);
  }
  void forget_prefetched() override {
    handed_ms_.clear();
    inner_.forget_prefetched();
  }
  frame_outcome track_prefetched(std::int64_t time_ns) override {
    return timed(time_ns, [&](std::int64_t stamp) { return inner_.track_prefetched(stamp); });
  }

  void add_imu(std::int64_t time_ns, std::array<double, 3> const& accel,
               std::array<double, 3> const& gyro) override {
    inner_.add_imu({time_ns, narrowed(accel), narrowed(gyro)});
  }

  std::vector<std::string> const& stage_names() const override { return sums_.names(); }

  std::vector<seen_keypoint> keypoints() const override {
    auto const& r = inner_.keypoints();
    std::vector<seen_keypoint> all;
    for (int i = 0; i < r.keypoints[0]; ++i) {
      all.push_back(
          {r.x[i], r.y[i], r.octave[i], r.depth[i], r.holder[i], inner_.matched()[i] != 0});
    }
    return all;
  }
  void write_map(std::ostream& to, rigid_pose const& T_file_world) const override {
    ft::odometry_map map = inner_.download_map();
    ft::pose const T = to_ft(T_file_world);
    for (auto& point : map.points) {
      point.position = T * point.position;
      point.normal = T.R * point.normal;
    }
    ft::write_ply(to, map);
  }
  int keyframes() const override { return last_.keyframes; }
  int map_points() const override { return last_.map_points; }
  int maps() const override { return last_.maps; }
  std::string device() const override { return device_; }
  std::vector<std::string> calibration_warnings() const override {
    std::vector<std::string> all;
    for (auto const& found : ft::check_calibration(inner_.rig(), options_.width, options_.height)) {
      all.push_back(std::string(ft::name_of(found.warning)) + ": " + found.text);
    }
    return all;
  }

private:
  /// @param track ft::tracking(std::int64_t stamp)
  template <typename Track>
  frame_outcome timed(std::int64_t time_ns, Track const& track) {
    double const start = now_ms();
    // A stamp that stands still or goes back is taken for one at the usual distance.
    bool const later = frames_ == 0 || time_ns > time_ns_;
    std::int64_t const stamp = later ? time_ns : time_ns_ + interval_ns_;
    if (frames_ > 0) { interval_ns_ = stamp - time_ns_; }
    time_ns_ = stamp;
    ++frames_;
    double handed = start;
    if (!handed_ms_.empty()) {
      handed = handed_ms_.front();
      handed_ms_.pop_front();
    }
    last_ = track(stamp);
    images_to_pose_ms_ = now_ms() - handed;
    sums_.reset();
    if (options_.measure_stages) {
      for (auto const& stage : inner_.stage_times()) { sums_.add(stage.name, 1e-3 * stage.us); }
    }
    sums_.add("total", now_ms() - start + std::exchange(prefetch_ms_, 0.0));
    return outcome();
  }
  frame_outcome outcome() const {
    frame_outcome out;
    auto const found = ft::explain(last_, inner_.params().rules);
    if (found.reason != ft::tracking_reason::none) { out.reason = ft::name_of(found.reason); }
    out.why = found.text;
    for (ft::tracking_notice const& said : ft::warnings_of(last_, inner_.params())) {
      // These have sentences of their own.
      if (said.warning == ft::tracking_warning::imu) { continue; }
      out.warnings.emplace_back(ft::name_of(said.warning), said.text);
    }
    out.map_id = last_.map_id;
    // The first frame of a later map is at a guessed place.
    out.tracked =
        last_.state == ft::tracking_state::tracking && found.reason != ft::tracking_reason::new_map;
    out.keyframe = last_.keyframe;
    out.metric = last_.metric;
    out.T_wc = from_ft(last_.T_world_camera);
    out.keypoints = last_.keypoints;
    out.stereo_matches = last_.stereo_points;
    out.inliers = last_.inliers;
    out.local_points = last_.local_points;
    out.imu = outcome_of(last_.imu, inner_.params().imu);
    out.stage_ms = sums_.ms();
    out.images_to_pose_ms = images_to_pose_ms_;
    return out;
  }
  typename ft::odometry<Exec, Rig>::images_type images_of(frame_pixels const& of) const {
    int const w = options_.width;
    int const h = options_.height;
    if constexpr (ft::is_monocular_v<Rig>) {
      return {of.left, w, h, w};
    } else if constexpr (std::is_same_v<Rig, ft::rgbd_rig<>>) {
      return {{of.left, w, h, w}, ft::image_view<std::uint16_t const>{of.depth, w, h, w}};
    } else {
      return {{of.left, w, h, w}, {of.right, w, h, w}};
    }
  }

  odometry_options options_;
  std::string device_;
  ft::odometry<Exec, Rig> inner_;
  stage_sums sums_;
  ft::tracking last_;
  std::int64_t time_ns_ = 0;      ///< of the last frame
  std::int64_t interval_ns_ = 1;  ///< time from the preceding frame to it
  double prefetch_ms_ = 0;        ///< in prefetch(), since the last frame
  std::deque<double> handed_ms_;  ///< when the prefetched frames were given
  double images_to_pose_ms_ = 0;  ///< of the last frame
  int frames_ = 0;
};

}  // namespace app
