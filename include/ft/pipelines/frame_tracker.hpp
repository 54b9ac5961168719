// SPDX-License-Identifier: Apache-2.0
/// @file Pipeline: tracks stereo frames against a map, in memory allocated once.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>
#include <type_traits>
#include <vector>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/recording.hpp"
#include "ft/core/stage_clock.hpp"
#include "ft/kernels/upload.hpp"
#include "ft/pipelines/check_params.hpp"
#include "ft/pipelines/detail/frame_images.hpp"
#include "ft/pipelines/detail/frame_schedule.hpp"
#include "ft/pipelines/detail/frame_stages.hpp"
#include "ft/pipelines/detail/rolling_parts.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "ft/pipelines/stereo_matcher.hpp"
#include "ft/pipelines/tracker_types.hpp"
#include "ft/types/images.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

/// Tracks `batch` stereo cameras or rigs of the same kind, each against its own map. A frame is one
/// call:
///
///     set_image() or borrow_image() -> track(exec, {T_predicted, local map}) -> wait -> frame(b)
///
/// or two calls, if the local map depends on the matches of the first search:
///
///     track_motion(exec, T_predicted) -> wait, choose the local map -> track_local(exec, slots)
///
/// extract() computes keypoints and stereo only, for frames without a map. The pose of a frame and
/// the slots that its keypoints hold stay in executor memory for the next frame; set_last()
/// replaces them. The constructor allocates all memory. Calls are asynchronous on the executor,
/// allocate nothing and never wait. Results are valid after exec.wait(). The next call must follow
/// that wait, because it reuses the memory of inputs and results. Counts stay in executor memory:
/// launches are sized by capacity. On a device each call replays a graph that the constructor
/// recorded.
///
/// Move-only. A moved-from tracker refuses every call with bad_argument, and its views must not be
/// used. Not thread-safe; instances are independent.
/// @tparam Rig rectified_rig; stereo_rig of any two cameras, whose images are both searched; or
///   multi_rig, whose cameras give one pose, that of its body. "Camera pair" means a rig below
template <typename Exec, typename Rig = rectified_rig>
class frame_tracker {
  static_assert(std::is_same_v<typename detail::rig_parts<Rig>::searched_rig, Rig> &&
                    !is_mixed_v<Rig>,
                "only an odometry rectifies, undistorts or takes depth images");
  using stages_type = detail::frame_stages<Exec, Rig>;

public:
  static constexpr memory_space space = Exec::space;
  static constexpr memory_space staging = staging_space<Exec>;
  static constexpr int cameras = stages_type::cameras;  ///< whose keypoints are searched

  frame_tracker() = default;
  /// Waits for its own set-up.
  /// @param batch camera pairs
  /// @throws bad_argument, std::bad_alloc, cuda_error
  frame_tracker(Exec const& exec, Rig const& rig, tracker_params const& params, int batch = 1) {
    rig.check();
    detail::require(!detail::has_rolling_shutter(rig),
                    "readout_s is above 0: a frame_tracker takes global shutters, an odometry "
                    "knows the motion that rolling ones need");
    detail::require_range("batch of camera pairs", batch, 1, 2048);
    check(params);
    stages_.prepare(exec, rig, params, batch);
    images_ = detail::frame_images<Exec>(geometry(), detail::absent_images_of(rig), batch);
    stages_.take_memory(images_.sources());
    stages_.initialize(exec);
    updates_ = buffer<point_update, space>(static_cast<std::size_t>(params.updates));
    staged_updates_ = buffer<point_update, staging>(static_cast<std::size_t>(params.updates));
    exec.wait();
    for (int i = 0; i < call_count; ++i) {
      calls_[i].number = static_cast<call_number>(i);
      if (params.measure_stages) { calls_[i].clock.enable(); }
    }
    if (params.use_graphs) { record(exec); }
  }

  // ---- images

  /// Copies an image into the staging memory that uploads read.
  /// @param camera image of pair `b`: 0 left, 1 right; of a multi_rig 2 c left, 2 c + 1 right of
  /// its
  ///   camera c. A single camera has no right one
  /// @throws bad_argument as orb_extractor::upload
  void set_image(int b, int camera, gray_view image) { images_.set(b, camera, image); }
  /// Makes frames read an image in place, such as a camera's buffer, without a copy by the host.
  /// Holds until the next call for this camera, set_image() or staged_image(). The image must not
  /// change while a frame is in flight.
  /// @param image rows of `stride` readable bytes; address and stride are multiples of 16. Next to
  ///   a device the memory must be readable by it: cudaMallocHost, cudaHostRegister
  /// @throws bad_argument as set_image(), and for memory that the executor cannot read
  void borrow_image(int b, int camera, gray_view image) { images_.borrow(b, camera, image); }
  /// Staging memory of an image, for callers that decode straight into it: height rows of
  /// staged_stride() bytes. Frames read the image from there from now on.
  /// @throws bad_argument for a camera that does not exist
  std::uint8_t* staged_image(int b, int camera) { return images_.staged(b, camera); }
  int staged_stride() const { return geometry().stride[0]; }
  /// Enqueues the copy of a camera's mask, which holds until the next one. Keypoints come from
  /// where it is not 0. Must not be called while a frame is in flight on another stream.
  /// @throws bad_argument as orb_extractor::set_mask
  void set_mask(Exec const& exec, int b, int camera, gray_view mask) {
    images_.require_camera(b, camera);
    stages_.extractor.set_mask(exec, images_.number(b, camera), mask);
  }

  // ---- the map, and the state after the last frame

  /// Enqueues the writing of map points, each slot at most once. Two calls need an exec.wait() in
  /// between.
  /// @param updates in host memory
  /// @throws bad_argument for more than params().updates points, a slot outside the map, or a NaN
  void update_map(Exec const& exec, int b, point_update const* updates, int count) {
    detail::require_range("camera pair", b, 0, batch() - 1);
    detail::require_range("map updates", count, 0, params().updates);
    for (int i = 0; i < count; ++i) {
      detail::require_range("map slot", updates[i].slot, 0, params().map_slots - 1);
      updates[i].check();
      staged_updates_.data()[i] = updates[i];
    }
    copy(exec, updates_.data(), static_cast<point_update const*>(staged_updates_.data()),
         static_cast<std::size_t>(count));
    for_each_item<per_thread>(exec, count, apply_updates{},
                              static_cast<point_update const*>(updates_.data()), map().slice(b));
  }
  /// Replaces the state after the last frame of pair b: when map points were created from its
  /// keypoints, or its pose was corrected. Enqueues two copies. Two calls need an exec.wait() in
  /// between.
  /// @param holders [cameras * capacity()] slot of each keypoint's map point, -1 = none
  /// @throws bad_argument for a pose that is not finite or another number of holders
  void set_last(Exec const& exec, int b, pose const& T_cw, slot_list holders) {
    detail::require_range("camera pair", b, 0, batch() - 1);
    int const numbers = cameras * capacity();
    detail::require_range("holders of the last frame", holders.count, numbers, numbers);
    require_finite_pose("an entry of a last pose", T_cw);
    stages_.set_last(exec, b, T_cw, holders.data);
  }

  // ---- the frame

  /// Enqueues keypoints and stereo of the current images. No keypoint holds a map point afterwards;
  /// the last pose is kept.
  /// @throws bad_argument if a camera has no image yet
  void extract(Exec const& exec) {
    images_.require_given();
    run(exec, calls_[extracting]);
  }

  /// Enqueues a whole frame: keypoints, stereo, search from the last frame (repeated with twice the
  /// radius if it finds too few matches), pose, search in the local map, pose.
  /// @param inputs [batch] frame_input. Templates, here and below, so that {} is one input and not
  ///   a null array
  /// @throws bad_argument if a camera has no image yet, for a predicted pose that is not finite, or
  ///   for more local points than params().local_points
  template <typename Input>
  void track(Exec const& exec, Input const* inputs) {
    images_.require_given();
    set_inputs(exec, inputs);
    run(exec, calls_[whole]);
  }
  /// The same for a batch of one. @throws bad_argument likewise, and for a larger batch
  void track(Exec const& exec, frame_input const& input) {
    require_one();
    track(exec, &input);
  }

  /// Enqueues the first half of track(), up to the first pose. Its result replaces the last state,
  /// so use relocalize() to try the same frame again. @param T_predicted [batch]
  template <typename Pose>
  void track_motion(Exec const& exec, Pose const* T_predicted) {
    images_.require_given();
    set_predictions(exec, [&](int b) -> pose const& { return T_predicted[b]; });
    run(exec, calls_[motion]);
  }
  void track_motion(Exec const& exec, pose const& T_predicted) {
    require_one();
    track_motion(exec, &T_predicted);
  }

  /// Enqueues the second half: search in the local map, from the first half's pose, and pose.
  /// @param local_slots [batch]
  template <typename Slots>
  void track_local(Exec const& exec, Slots const* local_slots) {
    images_.require_made();
    set_local_slots([&](int b) -> slot_list const& { return local_slots[b]; });
    run(exec, calls_[local]);
  }
  void track_local(Exec const& exec, slot_list const& local_slots) {
    require_one();
    track_local(exec, &local_slots);
  }

  /// Enqueues a search in the local map and a pose optimisation for the current keypoints, from a
  /// given pose: after extract(), or to retry after a search that failed. Forgets what the
  /// keypoints hold.
  /// @param inputs [batch]
  /// @param search parameters of this call only
  template <typename Input>
  void relocalize(Exec const& exec, Input const* inputs, local_search_params const& search = {}) {
    images_.require_made();
    set_inputs(exec, inputs);
    stages_.local_params = search;
    enqueue(exec, calls_[restart]);
  }
  void relocalize(Exec const& exec, frame_input const& input,
                  local_search_params const& search = {}) {
    require_one();
    relocalize(exec, &input, search);
  }

  // ---- results: valid after exec.wait(), until the next call

  /// The result of pair b. @throws bad_argument for a pair that does not exist
  tracked_frame frame(int b = 0) const {
    detail::require_range("camera pair", b, 0, batch() - 1);
    return {result(), b};
  }
  /// The same as arrays, in host memory.
  tracked_frame_view const& result() const { return stages_.memory.result; }
  /// Time of each stage of the last call; empty before the first. Stages overlap, so each time is
  /// what the stage adds to the frame. Allocates.
  /// @throws bad_argument without params().measure_stages
  std::vector<stage_time> stage_times() const {
    images_.require_made();
    detail::require(params().measure_stages, "stage times need tracker_params::measure_stages");
    if (last_call_ == call_count) { return {}; }
    return calls_[last_call_].clock.times();
  }
  /// Enqueues a copy of the left descriptors of pair b.
  /// @param to host memory
  /// @param count number of descriptors, as in result().keypoints
  /// @throws bad_argument for more than capacity()
  void download_descriptors(Exec const& exec, int b, descriptor* to, int count) const {
    download_descriptors(exec, b, 0, to, count);
  }
  /// The same of camera c of pair b.
  void download_descriptors(Exec const& exec, int b, int c, descriptor* to, int count) const {
    detail::require_range("camera pair", b, 0, batch() - 1);
    detail::require_range("camera", c, 0, cameras - 1);
    detail::require_range("descriptors", count, 0, capacity());
    copy(exec, to, static_cast<descriptor const*>(array_of<field::orb>(features().camera(b, c))),
         static_cast<std::size_t>(count));
  }

  int capacity() const { return stages_.extractor.capacity(); }
  int batch() const { return images_.batch(); }
  /// Bytes that track() fetches from the host for a frame of all pairs.
  std::size_t input_bytes() const {
    return images_.bytes() + stages_.memory.motion.host_memory.bytes() +
           stages_.memory.local.host_memory.bytes();
  }
  tracker_params const& params() const { return stages_.params; }
  Rig const& rig() const { return stages_.rig; }
  pyramid_geometry const& geometry() const { return stages_.extractor.geometry(); }
  orb_extractor<Exec> const& extractor() const { return stages_.extractor; }
  stereo_matcher<Exec, Rig> const& matcher() const { return stages_.matcher; }
  /// Executor memory, for user-defined stages: the map, and the current frame.
  map_points_view map() const { return stages_.memory.map; }
  frame_view const& features() const { return stages_.memory.frame; }

private:
  enum call_number { extracting, motion, local, whole, restart, call_count };
  /// A call: the function that enqueues it, its graph, its stages' times.
  struct call {
    call_number number = extracting;
    recording<Exec> graph;
    stage_clock<Exec> clock;
  };

  void queue(Exec const& exec, call& c) {
    detail::stage_line<Exec> line(exec, c.clock);
    switch (c.number) {
      case extracting:
        return detail::queue_extract(line, stages_);
      case motion:
        return detail::queue_track_motion(line, stages_);
      case local:
        return detail::queue_track_local(line, stages_, false);
      case restart:
        return detail::queue_track_local(line, stages_, true);
      case whole:
      case call_count:
        return detail::queue_track(line, stages_);
    }
  }
  void run(Exec const& exec, call& c) {
    last_call_ = c.number;
    stages_.local_params = {};  // those of an earlier relocalize()
    c.graph.replay(exec, [&](Exec const& e) { queue(e, c); });
  }
  /// Enqueues a call launch by launch. Its recorded graph has the default parameters.
  void enqueue(Exec const& exec, call& c) {
    last_call_ = c.number;
    queue(exec, c);
  }
  void record(Exec const& exec) {
    for (call_number const n : {extracting, motion, local, whole}) {
      calls_[n].graph.record(exec, [&](Exec const& e) { queue(e, calls_[n]); });
    }
  }

  // ---- set-up

  // ---- inputs

  void set_inputs(Exec const& exec, frame_input const* inputs) {
    set_predictions(exec, [&](int b) -> pose const& { return inputs[b].T_predicted; });
    set_local_slots([&](int b) -> slot_list const& { return inputs[b].local_slots; });
  }
  template <typename PoseOf>
  void set_predictions(Exec const& exec, PoseOf const& pose_of) {
    for (int b = 0; b < batch(); ++b) {
      require_finite_pose("an entry of a predicted pose", pose_of(b));
    }
    if (frame_number_ == detail::frame_numbers) {
      stages_.forget_stamps(exec);
      frame_number_ = 0;
    }
    ++frame_number_;
    for (int b = 0; b < batch(); ++b) {
      stages_.memory.motion.host.predicted[b] = pose_of(b);
      stages_.memory.motion.host.stamp[b] = frame_number_;
    }
  }
  template <typename SlotsOf>
  void set_local_slots(SlotsOf const& slots_of) {
    for (int b = 0; b < batch(); ++b) {
      detail::require_range("local map points", slots_of(b).count, 0, params().local_points);
    }
    auto& to = stages_.memory.local.host;
    for (int b = 0; b < batch(); ++b) {
      slot_list const& slots = slots_of(b);
      to.count[b] = slots.count;
      std::copy_n(slots.data, slots.count,
                  to.slots + static_cast<std::ptrdiff_t>(b) * params().local_points);
    }
  }
  static void require_finite_pose(char const* name, pose const& T) {
    for (float const v : T.R.m) { detail::require_finite(name, v); }
    for (float const v : {T.t.x, T.t.y, T.t.z}) { detail::require_finite(name, v); }
  }
  void require_one() const {
    images_.require_made();
    detail::require(batch() == 1, "a tracker of several camera pairs needs an array of inputs");
  }

  stages_type stages_;
  call calls_[call_count];
  call_number last_call_ = call_count;  ///< none
  int frame_number_ = 0;
  detail::frame_images<Exec> images_;
  buffer<point_update, space> updates_;
  buffer<point_update, staging> staged_updates_;
};

}  // namespace FT_ABI
}  // namespace ft
