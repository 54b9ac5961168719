// SPDX-License-Identifier: Apache-2.0
/// @file Pipeline: stereo odometry. Images in, poses out.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <istream>
#include <limits>
#include <memory>
#include <ostream>
#include <string>
#include <vector>

#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/containers/vocabulary.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/geometry.hpp"
#include "ft/core/recording.hpp"
#include "ft/core/stage_clock.hpp"
#include "ft/pipelines/detail/monocular_parts.hpp"
#include "ft/pipelines/detail/odometry_adjustment.hpp"
#include "ft/pipelines/detail/odometry_covariance.hpp"
#include "ft/pipelines/detail/odometry_download.hpp"
#include "ft/pipelines/detail/odometry_files.hpp"
#include "ft/pipelines/detail/odometry_recovery.hpp"
#include "ft/pipelines/detail/odometry_schedule.hpp"
#include "ft/pipelines/detail/odometry_stages.hpp"
#include "ft/pipelines/detail/rectifying_parts.hpp"
#include "ft/pipelines/detail/rgbd_parts.hpp"
#include "ft/pipelines/detail/rig_parts.hpp"
#include "ft/pipelines/odometry_types.hpp"

namespace ft {
inline namespace FT_ABI {

/// Tracks `batch` stereo cameras of the same kind, each in a map of its own that it makes:
///
///     ft::odometry<ft::host_exec> odo(exec, rig, params);
///     ft::tracking const t = odo.track({left, right}, time_ns);
///
/// A frame is one call, on a device one graph launch and one wait: keypoints, stereo, search from
/// the last frame, pose, choice of the local map, search in it, pose, keyframe. The newest
/// keyframes and their points are adjusted beside that, on a stream of their own or on a thread; a
/// result enters a fixed number of frames later. So the answers for a camera depend on its images
/// and time stamps, and of an IMU on the samples that came before each frame, not on the batch, the
/// executor or the time that anything takes.
///
/// The constructor allocates all memory; track() allocates none. The map is bounded: keyframes and
/// points leave with the oldest keyframe. See tracking_rules for states and keyframes.
///
/// Move-only. A moved-from odometry refuses every call with bad_argument. Not thread-safe;
/// instances are independent.
/// @tparam Rig rectified_rig; distorted_pair, whose images are rectified; stereo_rig of any two
///   cameras, whose images are searched as they are; rgbd_rig; multi_rig; or monocular_rig. "Camera
///   pair" means a rig below
template <typename Exec, typename Rig = rectified_rig>
class odometry {
  using stages_type = detail::odometry_stages<Exec, Rig>;
  using parts_of_rig = detail::rig_parts<Rig>;
  using input_type = typename parts_of_rig::template input<Exec>;
  using recovery_type =
      typename detail::recovery_of<Exec, typename parts_of_rig::searched_rig>::type;

public:
  static constexpr memory_space space = Exec::space;
  static constexpr int cameras = stages_type::cameras;  ///< whose keypoints are searched
  /// stereo_images, rgbd_images of an rgbd_rig, rig_images of a multi_rig, or gray_view of a
  /// monocular_rig
  using images_type = typename input_type::images_type;

  odometry() = default;
  /// Waits for its own set-up. On the host it starts a thread, which sleeps unless keyframes are
  /// adjusted.
  /// @param batch camera pairs
  /// @throws bad_argument, std::bad_alloc, cuda_error
  odometry(Exec const& exec, Rig const& rig, odometry_params const& params, int batch = 1)
      : parts_(std::make_unique<parts>(exec, rig, checked(rig, params, batch), batch)) {}

  /// Tracks the next frame of all cameras. Synchronous; allocates nothing.
  /// @param images [batch] @param time_ns [batch] when the images were taken; ascending
  /// @return [batch] valid until the next call
  /// @throws bad_argument for an image that is null or of another size, or for a time that is not
  ///   after the camera's last one; then nothing has changed
  tracking const* track(images_type const* images, std::int64_t const* time_ns) {
    parts& p = made();
    for (int b = 0; b < p.stages.batch; ++b) { p.require_later(b, time_ns[b]); }
    for (int b = 0; b < p.stages.batch; ++b) { p.stages.input.take(b, images[b]); }
    p.set_inputs(time_ns);
    p.adjustments.end_before(p.exec, p.frame);
    p.graph.replay(p.exec, [&](Exec const& e) { p.queue(e); });
    p.exec.wait();
    if (p.recovery != nullptr) { p.recovery->after_frame(p.exec, p.stages); }
    p.adjustments.begin_after(p.frame);
    p.take_outputs(time_ns);
    ++p.frame;
    return p.results.data();
  }
  /// The same for a batch of one. @throws bad_argument likewise, and for a larger batch
  tracking track(images_type const& images, std::int64_t time_ns) {
    detail::require(made().stages.batch == 1,
                    "an odometry of several camera pairs needs arrays of images and times");
    return *track(&images, &time_ns);
  }

  /// From now on, a camera whose frame was not found is also looked up among the keyframes of its
  /// map, by the words of a vocabulary. If it is found, it is `tracking` at once. Otherwise a new
  /// map may begin, in the frame in which it would without. track() waits for several steps in such
  /// a frame, one camera after the other. Call it before the first frame. Waits, and allocates.
  ///
  /// Words of a keyframe are computed after its frame, and leave with the keyframe. Files of maps
  /// have none: keyframes of a loaded map are not looked up.
  /// @param words in executor memory, valid as long as this
  /// @throws bad_argument after the first frame, for parameters out of range, a vocabulary without
  ///   words, an odometry with an IMU, or a multi_rig; std::bad_alloc, cuda_error
  void recognize_places(vocabulary_view const& words, place_recovery const& params = {}) {
    parts& p = made();
    detail::require(p.frame == 0, "places are recognised from the first frame on, not later");
    detail::require(!p.stages.has_imu(), "places are not recognised by an odometry with an IMU");
    p.recovery = std::make_unique<recovery_type>(p.exec, words, params, p.stages);
    p.stages.recognizes_places = true;
    p.record();
  }
  /// Predicts the pose of camera pair b in its next frame, instead of the motion model: from wheels
  /// or an IMU. A camera that is lost is searched for there, too.
  /// @throws bad_argument for a pose that is not finite or not a rotation, or for a pair that does
  ///   not exist
  void predict(rigid<double> const& T_world_camera, int b = 0) {
    parts& p = made();
    detail::require_range("camera pair", b, 0, p.stages.batch - 1);
    require_motion(T_world_camera);
    odometry_input& in = p.stages.own.inputs[b];
    in.T_cw = T_world_camera.inverse();
    in.predicted = 1;
  }
  /// A sample of camera pair b's IMU. Samples of one IMU come in order; a frame uses those that
  /// came before its track() call. May be called from another thread, also during track().
  /// @throws bad_argument without odometry_params::imu, for a pair that does not exist, for numbers
  ///   that are not finite, or for a time that is not after that of the sample before
  void add_imu(imu_measurement const& sample, int b = 0) {
    parts& p = made();
    detail::require(p.stages.has_imu(), "the odometry was made without an IMU");
    detail::require_range("camera pair", b, 0, p.stages.batch - 1);
    p.stages.inertial.queue(b).add(sample);
  }
  /// Camera pair b begins anew with its next frame: no map, no motion, any time stamp.
  /// @throws bad_argument for a pair that does not exist
  void reset(int b = 0) {
    parts& p = made();
    detail::require_range("camera pair", b, 0, p.stages.batch - 1);
    auto const i = static_cast<std::size_t>(b);
    p.stages.own.inputs[b].reset = 1;
    p.stages.own.inputs[b].predicted = 0;
    p.begun[i] = 0;
    p.results[i] = {};
    p.stages.expect_start(p.exec, b, true);
    if (p.stages.has_imu()) { p.stages.inertial.queue(b).clear(); }
  }
  /// Copies the mask of a camera, which holds until the next one. Keypoints come from where it is
  /// not 0. @throws bad_argument as orb_extractor::set_mask
  void set_mask(int b, int camera, gray_view mask) {
    parts& p = made();
    auto const& images = p.stages.input.images();
    images.require_camera(b, camera);
    p.stages.extractor.set_mask(p.exec, images.number(b, camera), mask);
    p.exec.wait();
  }

  /// What the last track() returned for camera pair b.
  tracking const& last(int b = 0) const {
    detail::require_range("camera pair", b, 0, made().stages.batch - 1);
    return made().results[static_cast<std::size_t>(b)];
  }
  /// Keypoints of the last frame, in host memory, valid until the next track(). Those of a keyframe
  /// hold its new map points, too. The visibility of local map points is not reported.
  tracked_frame_view const& keypoints() const { return made().stages.memory.result; }
  /// [batch][cameras * capacity] 1 = the keypoint was matched to a map point from before its frame.
  unsigned char const* matched() const { return made().stages.own.matched; }
  /// The map of camera pair b. Waits, and allocates. Empty if there is none.
  /// @throws bad_argument for a pair that does not exist; std::bad_alloc, cuda_error
  odometry_map download_map(int b = 0) const {
    parts const& p = made();
    detail::require_range("camera pair", b, 0, p.stages.batch - 1);
    if (p.results[static_cast<std::size_t>(b)].state == tracking_state::initialising) { return {}; }
    return detail::download_odometry_map(p.exec, p.stages.own.map, b);
  }
  /// Writes the map of camera pair b, in the format of pipelines/detail/odometry_files.hpp. Waits,
  /// and allocates. @throws bad_argument for a pair that does not exist or has no map; error if the
  /// stream fails; std::bad_alloc, cuda_error
  void save_map(std::ostream& to, int b = 0) const {
    parts const& p = made();
    detail::require_range("camera pair", b, 0, p.stages.batch - 1);
    detail::require(p.results[static_cast<std::size_t>(b)].state != tracking_state::initialising,
                    "the camera has no map to be saved");
    detail::save_odometry_map(p.exec, p.stages.own.map, b, p.stages.geometry().levels, to);
  }
  /// Replaces the map of camera pair b by a saved one. The camera is searched for in it, near its
  /// newest keyframes, as one that was lost; predict() says where else. Any time stamp may follow.
  /// What was known about an IMU is forgotten. Waits, and allocates.
  /// @throws error, with nothing changed, for a file that is truncated, damaged, or was written
  ///   with other capacities; bad_argument for a pair that does not exist
  void load_map(std::istream& from, int b = 0) {
    parts& p = made();
    detail::require_range("camera pair", b, 0, p.stages.batch - 1);
    detail::load_odometry_map(p.exec, p.stages.own.map, b, p.stages.geometry().levels, from);
    auto const i = static_cast<std::size_t>(b);
    p.results[i] = {};
    p.results[i].state = p.stages.enter_loaded_map(p.exec, b);
    p.stages.inertial.forget(p.exec, b);
    if constexpr (stages_type::starts_from_motion) { p.stages.beginning.forget(p.exec, b); }
    if (p.recovery != nullptr) { p.recovery->forget(p.exec, b); }
    p.begun[i] = 0;
    p.stages.own.inputs[b].predicted = p.stages.own.inputs[b].reset = 0;
  }
  /// Time of each stage of the last frame; see frame_tracker::stage_times. Allocates.
  /// @throws bad_argument without odometry_params::measure_stages
  std::vector<stage_time> stage_times() const {
    detail::require(made().stages.settings.measure_stages,
                    "stage times need odometry_params::measure_stages");
    return made().clock.times();
  }

  /// Memory taken for all camera pairs, without what CUDA takes for graphs and streams.
  allocated_bytes memory_bytes() const {
    parts const& p = made();
    return p.stages.bytes() + p.stages.own.bytes() + p.stages.inertial.bytes() +
           p.stages.input.allocated() + p.stages.beginning.bytes() +
           (p.recovery != nullptr ? p.recovery->bytes() : allocated_bytes{});
  }
  int batch() const { return made().stages.batch; }
  int capacity() const { return made().stages.capacity(); }  ///< keypoints of an image
  odometry_params const& params() const { return made().stages.settings; }
  Rig const& rig() const { return made().rig; }
  pyramid_geometry const& geometry() const { return made().stages.geometry(); }
  /// Executor memory, for user-defined stages.
  odometry_map_view map() const { return made().stages.own.map; }

private:
  /// At a fixed address: recordings and the adjustments refer to it.
  struct parts {
    Exec exec;
    Rig rig;
    stages_type stages;
    stage_clock<Exec> clock;
    recording<Exec> graph;
    std::vector<tracking> results;
    std::vector<std::int64_t> times;   ///< of the last frames
    std::vector<unsigned char> begun;  ///< whether there was one
    long long frame = 0;
    int stamp = 0;
    std::unique_ptr<recovery_type> recovery;  ///< or none
    /// last: it ends first
    detail::odometry_adjustments<Exec, typename parts_of_rig::searched_rig> adjustments;

    parts(Exec const& e, Rig const& of, odometry_params const& params, int batch)
        : exec(e),
          rig(of),
          results(static_cast<std::size_t>(batch)),
          times(results.size()),
          begun(results.size()),
          adjustments(prepared(params, batch), stages.own, stages.inertial, stages.rig, params) {
      if (params.measure_stages) { clock.enable(); }
      record();
    }
    parts(parts const&) = delete;
    parts& operator=(parts const&) = delete;

    /// Takes all memory and initialises it.
    Exec const& prepared(odometry_params const& params, int batch) {
      stages.settings = params;
      if (params.imu.present) {
        stages.settings.rules.keyframe_period_s = params.imu.keyframe_period_s;
      }
      stages.settings.orb.start_features = start_features(params.orb);
      stages.settings.orb.exact_positions = true;
      stages.settings.orb.refine_positions = parts_of_rig::refines_positions;
      stages.prepare_features(exec, parts_of_rig::searched(rig), tracker_params_of(stages.settings),
                              batch, parts_of_rig::absent(rig));
      stages.input = input_type(exec, rig, stages.geometry(), batch);
      stages.matcher = parts_of_rig::make_matcher(rig, stages.extractor, stages.input);
      image_bounds const seen = parts_of_rig::bounds(rig, params.orb.width, params.orb.height);
      stages.frustum.min_x = seen.min_x;
      stages.frustum.min_y = seen.min_y;
      stages.frustum.max_x = seen.max_x;
      stages.frustum.max_y = seen.max_y;
      stages.take_all_memory(exec, params.adjustment_delay);
      stages.initialize_all(exec);
      exec.wait();
      return exec;
    }
    void record() {
      if (!stages.settings.use_graphs) { return; }
      graph.record(exec, [&](Exec const& to) { queue(to); });
    }
    void queue(Exec const& to) {
      detail::stage_line<Exec> line(to, clock);
      detail::queue_odometry(line, stages);
    }

    void require_later(int b, std::int64_t time_ns) const {
      auto const i = static_cast<std::size_t>(b);
      if (begun[i] != 0 && time_ns <= times[i]) {
        throw bad_argument("ft: the time of camera pair " + std::to_string(b) + " is " +
                           std::to_string(time_ns) + " ns, must be after " +
                           std::to_string(times[i]));
      }
    }
    void set_inputs(std::int64_t const* time_ns) {
      if (stamp > std::numeric_limits<int>::max() - 4) {
        stages.forget_frame_numbers(exec);
        stamp = 0;
      }
      stamp += 2;  // a frame has two numbers: see search_start
      for (int b = 0; b < stages.batch; ++b) {
        stages.own.inputs[b].time_ns = time_ns[b];
        stages.own.inputs[b].stamp = stamp;
        auto const i = static_cast<std::size_t>(b);
        if (stages.has_imu()) { stages.inertial.set_input(b, begun[i] != 0, times[i], time_ns[b]); }
      }
    }
    void take_outputs(std::int64_t const* time_ns) {
      for (int b = 0; b < stages.batch; ++b) {
        auto const i = static_cast<std::size_t>(b);
        times[i] = time_ns[b];
        begun[i] = 1;
        stages.own.inputs[b].predicted = stages.own.inputs[b].reset = 0;
        results[i] = detail::tracking_of(stages.own.outputs[b]);
        results[i].metric = !stages_type::starts_from_motion;
        if (stages.has_imu()) {
          results[i].metric = results[i].metric || stages.inertial.outputs[b].metric != 0;
          results[i].imu = detail::imu_tracking_of(stages.inertial.outputs[b]);
        }
      }
    }
  };

  parts& made() const {
    detail::require(parts_ != nullptr, "the odometry was never made, or was moved from");
    return *parts_;
  }

  /// @return 0 where all images have as many features
  static int start_features(orb_params const& p) {
    if (!stages_type::starts_from_motion) { return 0; }
    return p.start_features != 0 ? p.start_features : min_of(5 * p.features, 1 << 20);
  }
  static tracker_params tracker_params_of(odometry_params const& p) {
    tracker_params t;
    t.orb = p.orb;
    t.map_slots = p.map_slots;
    t.local_points = p.local_points;
    t.window_radius = p.window_radius;
    t.enough_matches = p.enough_matches;
    t.overlap[0] = p.overlap[0];
    t.overlap[1] = p.overlap[1];
    return t;
  }

  static odometry_params const& checked(Rig const& rig, odometry_params const& p, int batch) {
    rig.check();
    detail::require(rig.baseline_length() > 0.0f, "an odometry needs a rig with a stereo pair");
    detail::require_range("batch of camera pairs", batch, 1, 2048);
    detail::require_odometry_params(p);
    return p;
  }
  static void require_motion(rigid<double> const& T) {
    for (double const v : T.R.m) { detail::require_finite("an entry of a predicted pose", v); }
    double const t[3] = {T.t.x, T.t.y, T.t.z};
    for (double const v : t) { detail::require_finite("an entry of a predicted pose", v); }
    mat3<double> const RRt = T.R * T.R.transposed();
    for (int i = 0; i < 9; ++i) {
      detail::require(std::abs(RRt.m[i] - (i % 4 == 0 ? 1.0 : 0.0)) < 1e-3,
                      "the rotation of a predicted pose is not a rotation matrix");
    }
  }

  std::unique_ptr<parts> parts_;
};

}  // namespace FT_ABI
}  // namespace ft
