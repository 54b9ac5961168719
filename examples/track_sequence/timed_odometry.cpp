// SPDX-License-Identifier: Apache-2.0
#include "examples/track_sequence/timed_odometry.hpp"

#include <algorithm>
#include <cstddef>
#include <utility>

#include "ft/pipelines/explain.hpp"
#include "ft/pipelines/imu_warnings.hpp"
#include "ft/pipelines/map_files.hpp"
#include "ft/pipelines/tracking_warnings.hpp"

namespace app {
namespace {

/// The stages of a frame, in their order, and the whole.
std::vector<std::string> stage_names_of(ft::rig_description const& rig) {
  std::vector<std::string> names = {"motion",
                                    "upload",
                                    "pyramid",
                                    "corners",
                                    "distribution",
                                    "blur",
                                    "order",
                                    "descriptors",
                                    "stereo",
                                    "rolling shutter",
                                    "search last frame",
                                    "pose last frame",
                                    "update local map",
                                    "search local map",
                                    "pose local map",
                                    "start",
                                    "result",
                                    "keyframe",
                                    "total"};
  bool const monocular = rig.kind == ft::rig_kind::monocular;
  names.erase(std::find(names.begin(), names.end(), monocular ? "stereo" : "start"));
  bool const rolls = std::any_of(rig.camera, rig.camera + rig.cameras,
                                 [](auto const& camera) { return camera.readout_s > 0; });
  if (!rolls) { names.erase(std::find(names.begin(), names.end(), "rolling shutter")); }
  return names;
}

}  // namespace

timed_odometry::timed_odometry(ft::any_odometry odometry, ft::rig_description const& rig)
    : odometry_(std::move(odometry)), sums_(stage_names_of(rig)) {}

frame_outcome timed_odometry::track(ft::any_images const& images, std::int64_t time_ns) {
  return timed([&] { return odometry_.track(images, later_than_before(time_ns)); });
}

void timed_odometry::prefetch(ft::any_images const& images) {
  double const start = now_ms();
  odometry_.prefetch(images);
  prefetch_ms_ += now_ms() - start;
  handed_ms_.push_back(start);
}

void timed_odometry::forget_prefetched() {
  handed_ms_.clear();
  odometry_.forget_prefetched();
}

frame_outcome timed_odometry::track_prefetched(std::int64_t time_ns) {
  return timed([&] { return odometry_.track_prefetched(later_than_before(time_ns)); });
}

std::int64_t timed_odometry::later_than_before(std::int64_t time_ns) {
  bool const later = frames_ == 0 || time_ns > time_ns_;
  std::int64_t const stamp = later ? time_ns : time_ns_ + interval_ns_;
  if (frames_ > 0) { interval_ns_ = stamp - time_ns_; }
  time_ns_ = stamp;
  ++frames_;
  return stamp;
}

/// @param track ft::tracking()
template <typename Track>
frame_outcome timed_odometry::timed(Track const& track) {
  double const start = now_ms();
  double handed = start;
  if (!handed_ms_.empty()) {
    handed = handed_ms_.front();
    handed_ms_.pop_front();
  }
  frame_outcome out;
  out.found = track();
  out.images_to_pose_ms = now_ms() - handed;
  sums_.reset();
  ft::odometry_params const& params = odometry_.params();
  if (params.measure_stages) {
    for (auto const& stage : odometry_.stage_times()) { sums_.add(stage.name, 1e-3 * stage.us); }
  }
  sums_.add("total", now_ms() - start + std::exchange(prefetch_ms_, 0.0));
  out.stage_ms = sums_.ms();
  auto const why = ft::explain(out.found, params.rules);
  if (why.reason != ft::tracking_reason::none) { out.reason = ft::name_of(why.reason); }
  out.why = why.text;
  // The first frame of a later map is at a guessed place.
  out.tracked =
      out.found.state == ft::tracking_state::tracking && why.reason != ft::tracking_reason::new_map;
  out.imu_warnings = ft::imu_warnings(out.found.imu, params.imu);
  if (params.imu.present) { out.imu = ft::explain_imu(out.found.imu, params.imu); }
  for (ft::tracking_notice const& said : ft::warnings_of(out.found, params)) {
    // These have sentences of their own.
    if (said.warning == ft::tracking_warning::imu) { continue; }
    out.warnings.emplace_back(ft::name_of(said.warning), said.text);
  }
  return out;
}

std::vector<seen_keypoint> timed_odometry::keypoints() const {
  ft::tracked_frame_view const& r = odometry_.keypoints();
  unsigned char const* const matched = odometry_.matched();
  std::vector<seen_keypoint> all;
  for (int i = 0; i < r.keypoints[0]; ++i) {
    all.push_back({r.x[i], r.y[i], r.octave[i], r.depth[i], r.holder[i], matched[i] != 0});
  }
  return all;
}

void timed_odometry::write_map(std::ostream& to, ft::pose const& T_file_odom, float scale) const {
  ft::odometry_map map = odometry_.download_map();
  for (auto& point : map.points) {
    point.position = T_file_odom * ft::scaled(point.position, scale);
    point.normal = T_file_odom.R * point.normal;
  }
  ft::write_ply(to, map);
}

}  // namespace app
