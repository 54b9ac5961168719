// SPDX-License-Identifier: Apache-2.0
#include "examples/track_sequence/tracking_run.hpp"

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <deque>
#include <exception>
#include <iostream>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "examples/sequence/read_ahead.hpp"
#include "examples/track_sequence/interrupt.hpp"

namespace app {
namespace {

constexpr std::size_t most_cloud_points = 8000;

/// Selects frames for the report, spread over the run.
bool is_sample(int i, int frames) {
  constexpr int samples = 6;
  if (frames <= samples) { return true; }
  for (int k = 0; k < samples; ++k) {
    if (i == (2 * k + 1) * frames / (2 * samples)) { return true; }
  }
  return false;
}

seq::sample_frame sample_of(int index, seq::image picture, std::vector<seen_keypoint> const& now,
                            std::vector<seen_keypoint> const& before, double scale_factor) {
  std::map<int, seen_keypoint const*> seen_before;
  for (auto const& k : before) {
    if (k.point >= 0) { seen_before[k.point] = &k; }
  }
  seq::sample_frame s;
  s.index = index;
  s.picture = std::move(picture);
  for (auto const& k : now) {
    seq::sample_frame::keypoint drawn;
    drawn.x = k.x;
    drawn.y = k.y;
    drawn.octave = k.octave;
    drawn.size = static_cast<float>(31.0 * std::pow(scale_factor, k.octave));
    drawn.depth = k.depth;
    drawn.matched = k.matched;
    auto const at = seen_before.find(k.point);
    if (k.matched && at != seen_before.end()) {
      drawn.from_x = at->second->x;
      drawn.from_y = at->second->y;
    }
    s.keypoints.push_back(drawn);
  }
  return s;
}

/// The frames to be tracked, in their order. The odometry gets the images of each one early.
class upcoming_frames {
public:
  /// @param prefetch frames that the odometry may have at a time; 0 = none
  upcoming_frames(seq::read_ahead& reader, int frames, timed_odometry& odometry,
                  seq::odometry_masks& masks, int prefetch)
      : reader_(reader),
        frames_(frames),
        odometry_(odometry),
        masks_(masks),
        prefetch_(static_cast<std::size_t>(prefetch)) {}
  upcoming_frames(upcoming_frames const&) = delete;
  upcoming_frames& operator=(upcoming_frames const&) = delete;
  /// The odometry no longer reads the frames that it has not tracked.
  ~upcoming_frames() {
    try {
      odometry_.forget_prefetched();
    } catch (std::exception const&) {}  // what it could not compute is not asked for
  }

  /// @throws what the reading of frame i threw
  seq::stereo_frame take(int i) {
    if (prefetch_ == 0) { return reader_.take(i); }
    while (given_.size() < prefetch_ && next_ < frames_ && !failure_) { give(next_++); }
    if (given_.empty()) { std::rethrow_exception(failure_); }
    seq::stereo_frame frame = std::move(given_.front());
    given_.pop_front();
    return frame;
  }

private:
  void give(int i) {
    try {
      seq::stereo_frame frame = reader_.take(i);
      masks_.set(odometry_.odometry(), frame);
      odometry_.prefetch(seq::odometry_images(frame));
      given_.push_back(std::move(frame));
    } catch (...) { failure_ = std::current_exception(); }
  }

  seq::read_ahead& reader_;
  int frames_;
  timed_odometry& odometry_;
  seq::odometry_masks& masks_;
  std::size_t prefetch_;
  std::deque<seq::stereo_frame> given_;
  int next_ = 0;
  std::exception_ptr failure_;  ///< of the frame after those that are given
};

}  // namespace

tracking_run::tracking_run(arguments const& a, seq::sequence const& sequence,
                           odometry_setup const& setup, timed_odometry& odometry,
                           seq::run_report& report)
    : arguments_(a),
      sequence_(sequence),
      odometry_(odometry),
      masks_(sequence),
      report_(report),
      scale_factor_(setup.scale_factor),
      prefetch_(setup.params.prefetch),
      left_lens_(sequence.rig().left) {
  if (a.loops) { report.loops.emplace(); }
  if (!a.load_map.empty()) { report.loaded_map = {a.load_map, 0}; }
  if (!a.record.empty()) { recording_.emplace(a.record, sequence, report.stages); }
}

double tracking_run::arrival_ms(int i) const {
  return static_cast<double>(sequence_.time_ns(i) - sequence_.time_ns(0)) / 1e6;
}

/// Whether the frame came while another was processed. Only the last such frame is taken.
bool tracking_run::dropped(int i) const {
  return arguments_.realtime && arrival_ms(i) < busy_until_ms_ && i + 1 < sequence_.size() &&
         arrival_ms(i + 1) <= busy_until_ms_;
}

void tracking_run::track_all() {
  using clock = std::chrono::steady_clock;
  int const frames = sequence_.size();
  seq::progress progress(std::cout, isatty(STDOUT_FILENO) != 0, "track", frames);
  auto const begin = clock::now();
  seq::read_ahead reader([this](int i) { return sequence_.load(i); }, frames,
                         *arguments_.read_ahead);
  upcoming_frames upcoming(reader, frames, odometry_, masks_, prefetch_);
  auto const stop = [this](int i, std::string const& why) {
    report_.stopped_at = i;
    report_.stopped_by = why;
  };
  for (int i = 0; i < frames && !report_.stopped_at; ++i) {
    if (char const* const signal = interrupted()) {
      stop(i, signal);
    } else if (dropped(i)) {
      ++report_.dropped;
    } else {
      std::optional<seq::stereo_frame> frame;
      try {
        frame = upcoming.take(i);
      } catch (std::exception const& e) { stop(i, e.what()); }
      if (!frame) { continue; }
      track(i, std::move(*frame));
      if (!arguments_.quiet) {
        progress.step(i + 1, report_.records.back().tracked ? std::string() : "lost");
      }
    }
  }
  if (!arguments_.quiet) { progress.finish(); }
  if (report_.loops) {
    report_.loops->tracked = path_.as_tracked();
    report_.loops->online = report_.estimate;
    auto const placed = odometry_.odometry().placed_keyframes();
    report_.estimate = path_.by(placed);
    std::set<int> maps;
    for (ft::placed_keyframe const& k : placed) {
      if (!k.loaded) { maps.insert(k.map); }
    }
    report_.loops->maps = static_cast<int>(maps.size());
    report_.loops->edges = edges_of(placed, odometry_.odometry().closed_loops());
  }
  report_.wall_s = std::chrono::duration<double>(clock::now() - begin).count();
}

void tracking_run::track(int i, seq::stereo_frame frame) {
  add_imu(frame.time_ns);
  if (prefetch_ == 0) { masks_.set(odometry_.odometry(), frame); }
  frame_outcome const outcome = prefetch_ > 0
                                    ? odometry_.track_prefetched(frame.time_ns)
                                    : odometry_.track(seq::odometry_images(frame), frame.time_ns);
  ft::tracking const& found = outcome.found;
  busy_until_ms_ = std::max(busy_until_ms_, arrival_ms(i)) + outcome.stage_ms.back();
  add_record(i, frame.time_ns, outcome);
  if (recording_) {
    recording_->add(report_.records.back(), found.T_world_camera, frame.left, odometry_.keypoints(),
                    corrected_now(found));
  }
  if (outcome.tracked && found.metric && !report_.metric) {
    report_.metric = true;
    report_.estimate.clear();  // poses of an unknown scale
  }
  // A map of its own, which is not joined with the loaded one, has a larger number.
  if (report_.loaded_map && report_.loaded_map->found_after == 0 && outcome.tracked &&
      found.map_id <= 1) {
    report_.loaded_map->found_after = report_.frames;
    report_.estimate.clear();  // poses in another world
  }
  if (outcome.tracked && found.metric == report_.metric) {
    report_.estimate.push_back(seq::stamped(frame.time_ns, found.T_world_camera));
    path_.add(frame.time_ns, found.T_odom_camera);
  }
  if (report_.loops) {
    report_.loops->closed += found.loops_closed;
    report_.loops->corrections += static_cast<int>(found.loops_closed > 0);
  }
  if (outcome.tracked && found.keyframe) { add_points(found.T_world_camera); }
  add_sample(i, std::move(frame.left));
}

/// Nothing where the correction is that of the frame before.
std::optional<corrected_keyframes> tracking_run::corrected_now(ft::tracking const& found) {
  auto const same = [](ft::rigid<double> const& a, ft::rigid<double> const& b) {
    auto const d = a.t - b.t;
    return std::equal(a.R.m, a.R.m + 9, b.R.m) && ft::dot(d, d) == 0;
  };
  if (same(found.T_world_odom, T_world_odom_)) { return {}; }
  T_world_odom_ = found.T_world_odom;
  ft::any_odometry const& odometry = odometry_.odometry();
  return corrected_keyframes{odometry.placed_keyframes(), odometry.closed_loops()};
}

/// Hands the IMU's samples on, up to the first one that is not before the frame, by its clock. A
/// recording has what comes soon after, too: its clock may be ahead by more.
void tracking_run::add_imu(std::int64_t to_ns) {
  report_.with_imu = sequence_.imu().has_value();
  if (!report_.with_imu) { return; }
  auto const& samples = sequence_.imu()->samples;
  double const offset_s =
      arguments_.imu_time_offset_s.value_or(sequence_.imu()->calibration.time_offset_s);
  std::int64_t const until_ns = to_ns + std::llround(1e9 * (offset_s + 0.08));
  bool more = true;
  while (more && next_sample_ < samples.size()) {
    auto const& s = samples[next_sample_++];
    odometry_.odometry().add_imu(seq::odometry_sample(s));
    more = s.time_ns < until_ns;
  }
}

void tracking_run::add_record(int i, std::int64_t time_ns, frame_outcome const& outcome) {
  ft::tracking const& found = outcome.found;
  ++report_.frames;
  report_.tracked += static_cast<int>(outcome.tracked);
  report_.lost += static_cast<int>(!outcome.tracked);
  seq::frame_record record;
  record.index = i;
  record.time_ns = time_ns;
  record.tracked = outcome.tracked;
  record.keyframe = found.keyframe;
  record.metric = found.metric;
  record.keypoints = found.keypoints;
  record.stereo_matches = found.stereo_points;
  record.inliers = found.inliers;
  record.local_points = found.local_points;
  record.images_to_pose_ms = outcome.images_to_pose_ms;
  record.reason = outcome.reason;
  record.why = outcome.why;
  record.imu_warnings = outcome.imu_warnings;
  record.warnings = outcome.warnings;
  record.map_id = found.map_id;
  record.map_begun = found.map_begun;
  if (outcome.imu) {
    record.imu_state = ft::name_of(outcome.imu->state);
    if (outcome.imu->state != ft::imu_state::used) { record.imu_reason = outcome.imu->reason; }
    record.imu_why = outcome.imu->text;
    if (found.imu.clock.known) { record.imu_clock_offset_s = found.imu.clock.offset_s; }
    ft::imu_misalignment const& off = found.imu.misalignment;
    if (off.known) { record.imu_turn = Eigen::Vector3d(off.turn.x, off.turn.y, off.turn.z); }
  }
  if (outcome.tracked) {
    for (int row = 0; row < 6; ++row) {  // the upper triangle
      double const* const begin = found.covariance + 6 * row;
      record.covariance.insert(record.covariance.end(), begin + row, begin + 6);
    }
  }
  if (arguments_.timing) {
    record.stage_ms = outcome.stage_ms;
  } else {
    record.stage_ms = {outcome.stage_ms.back()};
  }
  if (found.imu.known) {
    auto const vector = [](auto const& v) {
      auto const wide = v.template cast<double>();
      return Eigen::Vector3d(wide.x, wide.y, wide.z);
    };
    record.imu = seq::imu_record{found.imu.optimized, vector(found.imu.velocity),
                                 vector(found.imu.bias.gyro), vector(found.imu.bias.accel),
                                 vector(found.imu.gravity)};
  }
  report_.records.push_back(std::move(record));
}

void tracking_run::add_sample(int i, seq::image picture) {
  bool const sample = is_sample(i, sequence_.size());
  if (!sample && !is_sample(i + 1, sequence_.size())) { return; }
  auto now = odometry_.keypoints();
  if (sample) {
    bool const adjacent = before_index_ == i - 1;
    report_.samples.push_back(sample_of(i, std::move(picture), now,
                                        adjacent ? before_ : std::vector<seen_keypoint>(),
                                        scale_factor_));
  }
  before_ = std::move(now);
  before_index_ = i;
}

/// Adds the points that a keyframe begins, where they are then, to the report's cloud. When that is
/// full, every second one goes, and of those to come as many are left out.
void tracking_run::add_points(ft::rigid<double> const& T_wc) {
  for (seen_keypoint const& k : odometry_.keypoints()) {
    if (k.point < 0 || k.matched || !(k.depth > 0) || points_seen_++ % points_step_ != 0) {
      continue;
    }
    auto const ray = left_lens_.unproject({static_cast<double>(k.x), static_cast<double>(k.y)});
    if (!ray.valid) { continue; }
    auto const depth = static_cast<double>(k.depth);
    auto const p = T_wc * ft::vec3<double>{depth * ray.pixel.x(), depth * ray.pixel.y(), depth};
    report_.cloud.emplace_back(static_cast<float>(p.x), static_cast<float>(p.y),
                               static_cast<float>(p.z));
    if (report_.cloud.size() < most_cloud_points) { continue; }
    std::size_t kept = 0;
    for (std::size_t i = 0; i < report_.cloud.size(); i += 2) {
      report_.cloud[kept++] = report_.cloud[i];
    }
    report_.cloud.resize(kept);
    points_step_ *= 2;
  }
}

}  // namespace app
