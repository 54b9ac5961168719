// SPDX-License-Identifier: Apache-2.0
/// @file Pipeline: stereo odometry. Images in, poses out.
#pragma once

#include <cstddef>
#include <cstdint>
#include <istream>
#include <memory>
#include <ostream>
#include <vector>

#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/stage_clock.hpp"
#include "ft/pipelines/detail/mixed_parts.hpp"
#include "ft/pipelines/detail/monocular_parts.hpp"
#include "ft/pipelines/detail/odometry_download.hpp"
#include "ft/pipelines/detail/odometry_engine.hpp"
#include "ft/pipelines/detail/odometry_features.hpp"
#include "ft/pipelines/detail/odometry_files.hpp"
#include "ft/pipelines/detail/odometry_inertial.hpp"
#include "ft/pipelines/detail/odometry_loops.hpp"
#include "ft/pipelines/detail/odometry_recovery.hpp"
#include "ft/pipelines/detail/rectifying_parts.hpp"
#include "ft/pipelines/detail/rgbd_parts.hpp"
#include "ft/pipelines/detail/rig_parts.hpp"
#include "ft/types/features.hpp"
#include "ft/types/images.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/loops.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

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
  using engine = detail::odometry_engine<Exec, Rig>;
  using input_type = typename detail::rig_parts<Rig>::template input<Exec>;

public:
  static constexpr memory_space space = Exec::space;
  static constexpr int cameras = engine::stages_type::cameras;  ///< whose keypoints are searched
  /// stereo_images, rgbd_images of an rgbd_rig, rig_images of a multi_rig, or gray_view of a
  /// monocular_rig
  using images_type = typename input_type::images_type;

  odometry() = default;
  /// Waits for its own set-up. On the host it starts a thread, which sleeps unless keyframes are
  /// adjusted.
  /// Parts are plugged in here, and a program compiles those that it names:
  ///
  ///     ft::odometry odo(exec, rig, params, 1, ft::inertial{});             // params.imu
  ///     ft::odometry odo(exec, rig, params, 1, ft::places{words.view()});
  ///     ft::odometry odo(exec, rig, params, 1, ft::loops{});                // params.loops
  ///     ft::odometry odo(exec, rig, params, 1, ft::own_features{});         // params.own_features
  ///
  /// @param batch camera pairs @param plugged inertial, places, loops, or own_features; there are
  ///   no others
  /// @throws bad_argument also for odometry_params::imu without inertial, and for inertial without
  ///   it; likewise for odometry_params::loops and loops; std::bad_alloc, cuda_error
  template <typename... Plugged>
  odometry(Exec const& exec, Rig const& rig, odometry_params const& params, int batch,
           Plugged const&... plugged)
      : engine_(engine::made(exec, rig, params, batch, plugged...)) {}
  odometry(Exec const& exec, Rig const& rig, odometry_params const& params)
      : odometry(exec, rig, params, 1) {}

  /// Tracks the next frame of all cameras. Returns as soon as what it returns is known; on a device
  /// a keyframe enters the map meanwhile, on the executor's stream, unless a part other than
  /// ft::inertial is plugged in. Images are not read any more. Allocates nothing.
  /// @param images [batch] @param time_ns [batch] when the images were taken; ascending
  /// @return [batch] valid until the next call
  /// @throws bad_argument for an image that is null or of another size, or for a time that is not
  ///   after the camera's last one; then nothing has changed. Of a multi_rig of several cameras or
  ///   a mixed_rig images may be null, but not all: tracking::missing_images, missing_depths
  tracking const* track(images_type const* images, std::int64_t const* time_ns) {
    engine& p = made();
    p.require_images();
    p.require_later(time_ns);
    for (int b = 0; b < p.stages.batch; ++b) { p.stages.input.take(b, images[b]); }
    forget_prefetched();
    return p.track(time_ns, detail::frame_extent::whole);
  }
  /// The same for a batch of one. @throws bad_argument likewise, and for a larger batch
  tracking track(images_type const& images, std::int64_t time_ns) {
    require_single();
    return *track(&images, &time_ns);
  }

  /// Tracks the next frame by keypoints of the caller, see given_features, instead of images: what
  /// depends on images alone, tracking::light and warnings about them, is not there. Needs
  /// own_features. Returns when the frame is complete; allocates nothing.
  /// @param features [batch] @param time_ns [batch] when they were seen; ascending
  /// @return [batch] valid until the next call
  /// @throws bad_argument for features as image_features says, naming the first, for a time that is
  ///   not after the camera's last one, or without own_features; then nothing has changed
  tracking const* track(given_features const* features, std::int64_t const* time_ns) {
    engine& p = made();
    p.require_later(time_ns);
    p.take_features(features);
    forget_prefetched();
    return p.track(time_ns, detail::frame_extent::given);
  }
  /// The same for a batch of one. @throws bad_argument likewise, and for a larger batch
  tracking track(given_features const& features, std::int64_t time_ns) {
    require_single();
    return *track(&features, &time_ns);
  }

  /// Gives the images of a frame before it is tracked. Keypoints and stereo are computed beside the
  /// frames before it: on a stream of their own, or on threads of the host. That gives more frames
  /// a second, each of them later; answers are those of track():
  ///
  ///     for (int i = 0, given = 0; i < frames; ++i) {
  ///       while (given < min(frames, i + params.prefetch)) { odo.prefetch(images(given++)); }
  ///       ft::tracking const t = odo.track_prefetched(time_ns(i));
  ///     }
  ///
  /// Asynchronous; allocates nothing. track() and forget_prefetched() forget the frames that were
  /// given.
  /// @param images [batch] unchanged until their frame has been tracked or is forgotten
  /// @throws bad_argument for an image that is null or of another size, or if
  ///   odometry_params::prefetch frames are given and not yet tracked
  void prefetch(images_type const* images) {
    engine& p = made_for_prefetch();
    p.prefetch->give(images, p.stages.batch);
  }
  /// The same for a batch of one. @throws bad_argument likewise, and for a larger batch
  void prefetch(images_type const& images) {
    require_single();
    prefetch(&images);
  }
  /// Forgets the frames that were given, and waits until their images are no longer read. Without
  /// odometry_params::prefetch there are none.
  void forget_prefetched() {
    engine& p = made();
    if (p.prefetch != nullptr) { p.prefetch->forget(p.exec); }
  }
  /// track() of the frame whose images were given first.
  /// @throws bad_argument if none were given, or as track() for a time
  tracking const* track_prefetched(std::int64_t const* time_ns) {
    engine& p = made_for_prefetch();
    p.prefetch->require_given();
    p.require_later(time_ns);
    p.prefetch->use(p.exec, p.stages);
    return p.track(time_ns, detail::frame_extent::prefetched);
  }
  /// The same for a batch of one. @throws bad_argument likewise, and for a larger batch
  tracking track_prefetched(std::int64_t time_ns) {
    require_single();
    return *track_prefetched(&time_ns);
  }

  /// Predicts the pose of camera pair b in its next frame, from wheels or an IMU, instead of the
  /// motion model and of ft::inertial; imu_tracking::predicted is false then. A camera that is lost
  /// is searched for there, too. Where there is no map yet, before the first frame or after
  /// reset(), the prediction is forgotten: the map begins at the origin.
  /// @throws bad_argument for a pose that is not finite or not a rotation, or for a pair that does
  ///   not exist
  void predict(rigid<double> const& T_world_camera, int b = 0) {
    engine& p = made(b);
    detail::require_motion(T_world_camera);
    odometry_input& in = p.stages.own.inputs[b];
    tracking const& last = p.results[static_cast<std::size_t>(b)];
    rigid<double> T_odom_camera = last.T_world_odom.inverse() * T_world_camera;
    T_odom_camera.t = scaled(T_odom_camera.t, 1 / last.odom_scale);
    in.T_cw = T_odom_camera.inverse();
    in.predicted = 1;
  }
  /// A sample of camera pair b's IMU. Samples of one IMU come in order; a frame uses those that
  /// came before its track() call. May be called from another thread, also during track(). A sample
  /// that is not after the one before, not finite or beyond the sensor's range is left out and
  /// counted: imu_tracking::left_out, imu_warnings(). After 16 in a row that are behind and ascend
  /// the time of the one before them was wrong, and samples go on from there.
  /// @throws bad_argument without odometry_params::imu, or for a pair that does not exist;
  ///   std::bad_alloc
  void add_imu(imu_measurement const& sample, int b = 0) {
    engine& p = made();
    detail::require(p.given.imu.present, "the odometry was made without an IMU");
    p.require_pair(b);
    for (auto const& part : p.stages.plugged) {
      if (detail::sample_queue* const to = part->samples(b)) { to->add(sample); }
    }
  }
  /// Camera pair b begins anew with its next frame: no map, no motion, any time stamp.
  /// @throws bad_argument for a pair that does not exist
  void reset(int b = 0) {
    engine& p = made(b);
    auto const i = static_cast<std::size_t>(b);
    p.stages.own.inputs[b].reset = 1;
    p.stages.own.inputs[b].predicted = 0;
    p.begun[i] = 0;
    p.results[i] = {};
    p.stages.expect_start(p.exec, b, true);
    p.stages.forget_images(p.exec, b);
    for (auto const& part : p.stages.plugged) { part->reset(b); }
  }
  /// Copies the mask of a camera, which holds until the next one. Keypoints come from where it is
  /// not 0. Of frames that were given by prefetch() already: as they were then.
  /// @throws bad_argument as orb_extractor::set_mask
  void set_mask(int b, int camera, gray_view mask) {
    engine& p = made();
    auto const& images = p.stages.input.images();
    images.require_camera(b, camera);
    int const i = images.number(b, camera);
    p.stages.extractor.set_mask(p.exec, i, mask);
    if (p.prefetch != nullptr) {
      p.prefetch->for_each_extractor([&](auto& e) { e.set_mask(p.exec, i, mask); });
    }
    p.exec.wait();
  }

  /// What the last track() returned for camera pair b.
  tracking const& last(int b = 0) const { return made(b).results[static_cast<std::size_t>(b)]; }
  /// Keypoints of the last frame, in host memory, valid until the next track(). Those of a keyframe
  /// hold its new map points, too. The visibility of local map points is not reported. Waits for
  /// the end of the frame. @throws cuda_error
  tracked_frame_view const& keypoints() const {
    made().frame_end.wait();
    return made().stages.memory.result;
  }
  /// [batch][cameras * capacity] 1 = the keypoint was matched to a map point from before its frame.
  /// Waits likewise.
  unsigned char const* matched() const {
    made().frame_end.wait();
    return made().stages.own.matched;
  }
  /// The map of camera pair b; with localize_only and ft::loops the part of it around the camera.
  /// Waits, and allocates. Empty if there is none.
  /// @throws bad_argument for a pair that does not exist; std::bad_alloc, cuda_error
  odometry_map download_map(int b = 0) const {
    engine const& p = made(b);
    if (p.results[static_cast<std::size_t>(b)].state == tracking_state::initialising) { return {}; }
    return detail::download_odometry_map(p.exec, p.stages.own.map, b);
  }
  /// Keyframes as loops have corrected them, oldest first; see loop_params::keyframes. Empty
  /// without ft::loops. Allocates. @throws bad_argument for a pair that does not exist;
  /// std::bad_alloc
  std::vector<placed_keyframe> placed_keyframes(int b = 0) const {
    std::vector<placed_keyframe> all;
    for (auto const& part : made(b).stages.plugged) { part->list_placed(all); }
    return all;
  }
  /// The loops between them, in the order in which they were closed. Likewise.
  std::vector<closed_loop> closed_loops(int b = 0) const {
    std::vector<closed_loop> all;
    for (auto const& part : made(b).stages.plugged) { part->list_closed(all); }
    return all;
  }
  /// Copies the map of camera pair b, with ft::loops also the keyframes that are kept, and their
  /// loops. Waits for the copy, and allocates. To write it, on a thread if you like, takes some
  /// ten times as long. @throws bad_argument for a pair that does not exist or has no map;
  /// std::bad_alloc, cuda_error
  map_snapshot snapshot_map(int b = 0) const { return detail::snapshot_of(made(b), b); }
  /// Writes a snapshot_map(), in the format of pipelines/detail/odometry_files.hpp, with its
  /// errors. @throws error if the stream fails
  void save_map(std::ostream& to, int b = 0) const { snapshot_map(b).write(to); }
  /// Replaces the map of camera pair b by a saved one. The camera is searched for in it, near its
  /// newest keyframes, as one that was lost; predict() says where else. With ft::loops it is found
  /// anywhere: a frame is looked up among the kept keyframes, for which it waits, and searched for
  /// near the newest ones only where it looks like none; it is tracked in the map, whose keyframes
  /// around it become the newest ones, or in a new one that is joined with it. After
  /// tracking_rules::patience frames it begins a map of its own, until two of its frames are
  /// recognised: up to 30 are looked for, one after the other, which each wait for the search of
  /// the one before; then keyframes alone. With localize_only each frame that is not found is
  /// looked up, without a map of its own. Any time stamp may follow. What was known about an IMU is
  /// forgotten. Reads no more of the stream than the file's head says. Waits, and allocates.
  /// @throws error, with nothing changed, for a file that is truncated or damaged, has numbers out
  ///   of range or, where the stream can be positioned, bytes after its end, and naming what
  ///   differs for one that was made with another rig, image size, pyramid or capacity, or by
  ///   another version of the format; bad_argument for a pair that does not exist
  void load_map(std::istream& from, int b = 0) { detail::load_into(made(b), from, b); }
  /// Time of each stage of the last frame, without what was computed before it by prefetch(); see
  /// frame_tracker::stage_times. Allocates.
  /// @throws bad_argument without odometry_params::measure_stages
  std::vector<stage_time> stage_times() const {
    detail::require(made().stages.settings.measure_stages,
                    "stage times need odometry_params::measure_stages");
    made().frame_end.wait();
    return made().last_clock->times();
  }

  /// Memory taken for all camera pairs, without what CUDA takes for graphs and streams.
  allocated_bytes memory_bytes() const {
    engine const& p = made();
    allocated_bytes all = p.stages.bytes() + p.stages.own.bytes() + p.stages.input.allocated() +
                          p.stages.beginning.bytes() +
                          (p.prefetch != nullptr ? p.prefetch->bytes() : allocated_bytes{});
    for (auto const& part : p.stages.plugged) { all = all + part->bytes(); }
    return all;
  }
  int batch() const { return made().stages.batch; }
  int capacity() const { return made().stages.capacity(); }  ///< keypoints of an image
  /// As they were given to the constructor.
  odometry_params const& params() const { return made().given; }
  Rig const& rig() const { return made().rig; }
  Exec const& executor() const { return made().exec; }
  pyramid_geometry const& geometry() const { return made().stages.geometry(); }
  /// Executor memory, for stages of yours on the executor: its stream may still be busy with the
  /// last frame.
  odometry_map_view map() const { return made().stages.own.map; }

private:
  engine& made_for_prefetch() const {
    detail::require(made().prefetch != nullptr,
                    "the odometry was made without odometry_params::prefetch");
    return *engine_;
  }
  void require_single() const {
    detail::require(made().stages.batch == 1,
                    "an odometry of several camera pairs needs arrays of images and times");
  }
  engine& made() const {
    detail::require(engine_ != nullptr, "the odometry was never made, or was moved from");
    return *engine_;
  }
  engine& made(int b) const {
    made().require_pair(b);
    return *engine_;
  }

  std::unique_ptr<engine> engine_;
};

}  // namespace FT_ABI
}  // namespace ft
