// SPDX-License-Identifier: Apache-2.0
/// @file Pipeline: the tracking of stereo frames against a map, on memory taken once.
#pragma once

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
#include "ft/core/geometry.hpp"
#include "ft/core/recording.hpp"
#include "ft/core/side_branch.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/keypoints/order_and_grid.hpp"
#include "ft/kernels/map_updates.hpp"
#include "ft/kernels/pose/optimize_frame.hpp"
#include "ft/kernels/search/assignment.hpp"
#include "ft/kernels/search/clear_holders.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/last_frame.hpp"
#include "ft/kernels/search/local_map.hpp"
#include "ft/kernels/search/windows.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "ft/kernels/upload.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "ft/pipelines/stereo_matcher.hpp"

namespace ft {
inline namespace FT_ABI {

struct tracker_params {
  orb_params orb;
  int map_slots = 1 << 16;     ///< map points on the device at a time, per camera pair
  int local_points = 1 << 13;  ///< points of one local-map search
  int updates = 1 << 13;       ///< map points that one update_map() can send
  float last_th = 7;           ///< search radius at scale 1 from the last frame, pixels
  int enough_matches = 20;     ///< with fewer, the search is repeated with twice the radius
  bool optimize_last = true;   ///< pose optimisation after the search from the last frame
  bool optimize_local = true;  ///< and after the search in the local map
  /// Columns of the left and the right image that see the same, as orb_extractor takes them: pairs
  /// that are not rectified only. The default is the whole image; where one of the two lies outside
  /// its image no keypoint has a stereo partner.
  stereo_overlap overlap[2] = {{0, 1e9f}, {0, 1e9f}};
};

/// What the host reads after a frame. Keypoints are left ones, for two unrectified cameras followed
/// by right ones: keypoint k of camera c has number c * capacity + k.
struct tracked_frame_view {
  int* keypoints = nullptr;  ///< [batch][cameras]
  pose* T_cw = nullptr;      ///< [batch]
  int* matches = nullptr;    ///< [batch] keypoints given a point by the last search
  int* inliers = nullptr;  ///< [batch] of the last pose optimisation; matches where there was none
  float* x = nullptr;      ///< [batch][cameras * capacity] pixels
  float* y = nullptr;      ///< likewise
  int* octave = nullptr;   ///< likewise
  int* holder = nullptr;   ///< likewise: slot of the map point held, -1 = none
  float* depth = nullptr;  ///< [batch][capacity] of left keypoints, metres, -1 = no stereo match
  vec3<float>* point =
      nullptr;             ///< [batch][capacity] in the left camera's frame; 0 = no stereo match
  int* partner = nullptr;  ///< [batch][cameras * capacity] number of the stereo partner, -1 = none
  unsigned char* in_view =
      nullptr;  ///< [batch][local_points] 1 = passed the frustum test of track_local()
  int capacity = 0;
  int cameras = 1;
  int local_points = 0;
};

namespace detail {

inline void carve(carver& c, tracked_frame_view& v, int capacity, int batch, int cameras,
                  int local_points) {
  auto const b = static_cast<std::size_t>(batch);
  std::size_t const n = checked_mul(b, static_cast<std::size_t>(capacity));
  std::size_t const numbers = n * static_cast<std::size_t>(cameras);
  v.capacity = capacity;
  v.cameras = cameras;
  v.local_points = local_points;
  v.keypoints = c.take<int>(b * static_cast<std::size_t>(cameras));
  v.T_cw = c.take<pose>(b);
  v.matches = c.take<int>(b);
  v.inliers = c.take<int>(b);
  v.x = c.take<float>(numbers);
  v.y = c.take<float>(numbers);
  v.octave = c.take<int>(numbers);
  v.holder = c.take<int>(numbers);
  v.partner = c.take<int>(numbers);
  v.depth = c.take<float>(n);
  v.point = c.take<vec3<float>>(n);
  v.in_view = c.take<unsigned char>(checked_mul(b, static_cast<std::size_t>(local_points)));
}

/// What the host gives for a frame before the search from the last one.
struct motion_input {
  pose* predicted = nullptr;   ///< [batch] T_cw
  pose* last = nullptr;        ///< [batch] T_cw of the last frame
  int* last_holder = nullptr;  ///< [batch][cameras * capacity]
  int* stamp = nullptr;        ///< [batch] number of this frame
};

inline void carve(carver& c, motion_input& v, int numbers, int batch) {
  auto const b = static_cast<std::size_t>(batch);
  v.predicted = c.take<pose>(b);
  v.last = c.take<pose>(b);
  v.stamp = c.take<int>(b);
  v.last_holder = c.take<int>(b * static_cast<std::size_t>(numbers));
}

/// And before the search in the local map.
struct local_input {
  int* count = nullptr;  ///< [batch]
  int* slots = nullptr;  ///< [batch][local_points]
};

inline void carve(carver& c, local_input& v, int points, int batch) {
  auto const b = static_cast<std::size_t>(batch);
  v.count = c.take<int>(b);
  v.slots = c.take<int>(b * static_cast<std::size_t>(points));
}

/// A layout in executor memory with a twin beside the host, which is moved as one block.
template <typename View, memory_space Device, memory_space Host>
struct twin {
  View device;
  View host;
  arena<Device> device_memory;
  arena<Host> host_memory;

  twin() = default;
  template <typename... Sizes>
  explicit twin(int capacity, Sizes... sizes)
      : device_memory([&](carver& c) { carve(c, device, capacity, sizes...); }),
        host_memory([&](carver& c) { carve(c, host, capacity, sizes...); }) {
    std::memset(host_memory.data(), 0, host_memory.bytes());
  }
  block_source source() const {
    // An arena is longer than what is carved from it, by more than the quad that is cut off.
    static_assert(alignment >= 2 * sizeof(receive_parts::quad), "all that is carved is copied");
    return {device_memory.data(), host_memory.data(),
            static_cast<int>(host_memory.bytes() / sizeof(receive_parts::quad))};
  }
};

}  // namespace detail

/// Writes what the search found, and the poses, where the host reads it.
struct pack_matches {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, frame_view const& frame,
                                 pose const* poses, int const* matches, int const* inliers,
                                 tracked_frame_view const& out) const {
    int const b = item / frame.numbers();
    int const number = item % frame.numbers();
    int const c = number / frame.capacity();
    if (number == 0) {
      out.T_cw[b] = poses[b];
      out.matches[b] = matches[b];
      out.inliers[b] = inliers != nullptr ? inliers[b] : matches[b];
    }
    bool const there = number % frame.capacity() < *frame.camera(b, c).count;
    out.holder[item] = there ? frame.holder[item] : -1;
  }
};

/// Writes the keypoints where the host reads them, and keeps what the next frame's search needs of
/// them: after this frame's.
template <typename Rig>
struct pack_keypoints {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, Rig const& rig, frame_view const& frame,
                                 float const* depth, fisheye_matches_view const& fisheye,
                                 tracked_frame_view const& out,
                                 soa_view<field::angle, field::octave> const& last) const {
    int const b = item / frame.numbers();
    int const number = item % frame.numbers();
    int const c = number / frame.capacity();
    int const i = number % frame.capacity();
    keypoints_view const kp = frame.camera(b, c);
    auto const kept = last.slice(frame.keypoint_step * b + c);
    if (i == 0) { out.keypoints[b * frame.cameras + c] = *kept.count = *kp.count; }
    bool const there = i < *kp.count;
    float const x = there ? get<field::x>(kp, i) : 0.0f;
    float const y = there ? get<field::y>(kp, i) : 0.0f;
    out.x[item] = x;
    out.y[item] = y;
    int const octave = there ? get<field::octave>(kp, i) : 0;
    out.octave[item] = octave;
    if (there) {
      get<field::octave>(kept, i) = octave;
      get<field::angle>(kept, i) = get<field::angle>(kp, i);
    }
    out.partner[item] = there && frame.partner != nullptr ? frame.partner[item] : -1;
    if (c != 0) { return; }
    std::ptrdiff_t const at = static_cast<std::ptrdiff_t>(b) * frame.capacity() + i;
    float const z = there ? depth[at] : -1.0f;
    out.depth[at] = z;
    if constexpr (Rig::rectified) {
      auto const r = rig.camera.template cast<strict_float>().unproject({x, y}).direction;
      out.point[at] =
          z > 0 ? vec3<float>{(r.x * z).value, (r.y * z).value, z} : vec3<float>{0, 0, 0};
    } else {
      out.point[at] = z > 0 ? fisheye.point[at] : vec3<float>{0, 0, 0};
    }
  }
};

/// Writes which points of the local map a camera has in view.
struct pack_visibility {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, visibility const* seen,
                                 int const* count, int batch, int cameras,
                                 tracked_frame_view const& out) const {
    int const i = item % out.local_points;
    bool in_view = false;
    for (int c = 0; c < cameras && i < count[item / out.local_points]; ++c) {
      in_view = in_view ||
                seen[static_cast<std::ptrdiff_t>(c) * batch * out.local_points + item].level >= 0;
    }
    out.in_view[item] = static_cast<unsigned char>(in_view);
  }
};

/// Tracks `batch` stereo cameras of the same kind, each against its own map. Per frame:
///
///     upload images -> track_motion(): extraction, grid, stereo, search from the last frame, pose
///                   -> [host: choose the local map] -> track_local(): frustum, search, pose
///
/// or extract() alone where there is no last frame. All memory is taken by the constructor. The
/// calls are asynchronous on the executor, allocate nothing and never wait; the host fills the
/// input views before a call and reads result() after exec.wait(). It must not touch either in
/// between. Counts stay in executor memory: launches are sized by capacity. Move-only; one that was
/// moved from refuses every call with bad_argument, and its views are no longer its own. Not
/// thread-safe; instances are independent.
/// @tparam Rig rectified_rig, or stereo_rig of any two cameras: then both images are searched
template <typename Exec, typename Rig = rectified_rig>
class frame_tracker {
public:
  static constexpr memory_space space = Exec::space;
  static constexpr memory_space staging = staging_space<Exec>;
  static constexpr int cameras = Rig::rectified ? 1 : 2;  ///< whose keypoints are searched

  frame_tracker() = default;
  /// @param batch camera pairs. Waits for its own set-up. @throws bad_argument, std::bad_alloc,
  /// cuda_error
  frame_tracker(Exec const& exec, Rig const& rig, tracker_params const& params, int batch = 1)
      : rig_(rig), params_(params), batch_(batch) {
    rig.check();
    detail::require_range("batch of camera pairs", batch, 1, 2048);
    detail::require_range("map_slots", params.map_slots, 1, 1 << 26);
    detail::require_range("local_points", params.local_points, 1, 1 << 24);
    detail::require_range("updates", params.updates, 1, 1 << 24);
    detail::require_range("last_th", params.last_th, 0.1f, 1000.0f);
    std::vector<stereo_overlap> overlaps;
    for (int i = 0; !Rig::rectified && i < 2 * batch; ++i) {
      overlaps.push_back(params.overlap[i % 2]);
    }
    extractor_ = orb_extractor<Exec>(exec, params.orb, 2 * batch, overlaps);
    matcher_ = stereo_matcher<Exec, Rig>(rig, extractor_);
    int const capacity = extractor_.capacity();
    auto const b = static_cast<std::size_t>(batch);
    detail::require_items("keypoints of a batch", 2 * b, static_cast<std::size_t>(capacity));
    detail::require_items("local map points of a batch", b,
                          static_cast<std::size_t>(params.local_points));
    auto const slots = detail::checked_mul(b, static_cast<std::size_t>(params.map_slots));
    grid_geometry const cells = grid_geometry::over(0, 0, static_cast<float>(params.orb.width),
                                                    static_cast<float>(params.orb.height));
    int const numbers = cameras * capacity;
    int const windows = lists_early() ? numbers : max_of(numbers, params.local_points);
    arena_ = arena<space>([&](carver& c) {
      carve(c, map_, params.map_slots, batch);
      carve(c, frame_.grids, cells, capacity, cameras * batch);
      carve(c, last_keypoints_, capacity, 2 * batch);
      carve(c, last_windows_, numbers, batch, cameras);
      carve(c, local_windows_, params.local_points, batch, cameras);
      carve(c, work_, windows, capacity, batch, cameras);
      if (lists_early()) { carve(c, local_work_, params.local_points, capacity, batch, cameras); }
      carve(c, observations_, numbers, batch);
      frame_.holder = c.take<int>(b * static_cast<std::size_t>(numbers));
      stamps_ = c.take<int>(slots);
      poses_ = c.take<pose>(b);
      visible_ = c.take<visibility>(b * static_cast<std::size_t>(cameras) *
                                    static_cast<std::size_t>(params.local_points));
      updates_ = c.take<point_update>(static_cast<std::size_t>(params.updates));
    });
    if (!lists_early()) { local_work_ = work_; }
    staged_updates_ = buffer<point_update, staging>(static_cast<std::size_t>(params.updates));
    images_ = buffer<std::uint8_t, staging>(detail::checked_mul(2 * b, staged_bytes()));
    std::memset(images_.data(), 0, images_.bytes());
    sources_ = buffer<image_source, staging>(2 * b);
    for (int i = 0; i < 2 * batch; ++i) { use_own_memory(i / 2, i % 2); }
    given_.assign(2 * b, false);
    result_memory_ = arena<staging>([&](carver& c) {
      detail::carve(c, result_, capacity, batch, cameras, params.local_points);
    });
    std::memset(result_memory_.data(), 0, result_memory_.bytes());
    motion_ = detail::twin<detail::motion_input, space, staging>(numbers, batch);
    local_ = detail::twin<detail::local_input, space, staging>(params.local_points, batch);
    frame_.keypoints = extractor_.keypoints();
    frame_.batch = batch;
    frame_.cameras = cameras;
    if constexpr (Rig::rectified) {
      frame_.right_x = array_of<field::right_x>(matcher_.matches());
    } else {
      frame_.partner = matcher_.fisheye_matches().partner;
    }
    last_.cameras = cameras;
    frustum_.max_x = static_cast<float>(params.orb.width);
    frustum_.max_y = static_cast<float>(params.orb.height);
    frustum_.log_scale_factor = log_rounded(params.orb.scale_factor);
    frustum_.levels = params.orb.levels;
    last_.keypoints = last_keypoints_;
    last_.holder = motion_.device.last_holder;
    // 0 is no frame's number; nothing is held, nothing was seen before; a map point that was never
    // written has NaN for a position, and no camera sees it.
    fill_bytes(exec, array_of<field::position>(map_), 0xff, slots * sizeof(vec3<float>));
    fill_bytes(exec, stamps_, 0, slots * sizeof(int));
    // Before any frame: empty grids, no motion.
    fill_bytes(exec, frame_.grids.start, 0,
               b * static_cast<std::size_t>(cameras * (cells.cells() + 1)) * sizeof(int));
    fill_bytes(exec, frame_.holder, 0xff, b * static_cast<std::size_t>(numbers) * sizeof(int));
    fill_bytes(exec, poses_, 0, b * sizeof(pose));
    fill_bytes(exec, motion_.device_memory.data(), 0, motion_.device_memory.bytes());
    fill_bytes(exec, local_.device_memory.data(), 0, local_.device_memory.bytes());
    // Candidates are read beside how many there are.
    fill_bytes(exec, work_.list, 0xff, work_.list_bytes());
    fill_bytes(exec, local_work_.list, 0xff, local_work_.list_bytes());
    fill_bytes(exec, last_keypoints_.count, 0, 2 * b * sizeof(int));
    exec.wait();
    match_branch_.make();
    view_branch_.make();
    extract_recording_.record(exec, [this](Exec const& e) { queue_extract(e, no_mark{}); });
    motion_recording_.record(exec, [this](Exec const& e) { queue_track_motion(e, no_mark{}); });
    local_recording_.record(exec, [this](Exec const& e) { upload_local(e, {}, false, no_mark{}); });
    track_recording_.record(exec, [this](Exec const& e) { queue_track(e, no_mark{}); });
  }

  // ---- inputs, in host memory (pinned beside a device)

  /// Copies an image to where uploads start. @param camera 0 left, 1 right of pair `b`
  /// @throws bad_argument as orb_extractor::upload
  void set_image(int b, int camera, gray_view image) {
    require_image(b, camera, image);
    auto const& p = params_.orb;
    std::uint8_t* const to = staged_image(b, camera);
    for (int y = 0; y < p.height; ++y) {
      std::memcpy(to + static_cast<std::ptrdiff_t>(y) * staged_stride(), image.row(y),
                  static_cast<std::size_t>(p.width));
    }
  }
  /// Frames take an image from where it lies, without a copy by the host: a camera's buffer. Until
  /// the next call for this camera, or set_image() or staged_image(); it must stay as it is while a
  /// frame is queued. @param image rows of `stride` readable bytes, address and stride multiples of
  /// 16; beside a device in memory that it reads: cudaMallocHost, cudaHostRegister
  /// @throws bad_argument as set_image(), and for memory that cannot be read in this way
  void borrow_image(int b, int camera, gray_view image) {
    require_image(b, camera, image);
    detail::require(
        image.stride % 16 == 0 && reinterpret_cast<std::uintptr_t>(image.data) % 16 == 0,
        "a borrowed image needs an address and a stride that are multiples of 16");
    auto const* const last = image.row(image.height - 1) + (image.stride - 1);
    auto const* const data = static_cast<std::uint8_t const*>(Exec::host_address(image.data));
    detail::require(data != nullptr && Exec::host_address(last) != nullptr,
                    "the device cannot read a borrowed image: is its memory pinned?");
    source_of(b, camera) = {data, image.stride};
    given_[source_number(b, camera)] = true;
  }
  /// Queues the copy of a camera's mask: keypoints come from where it is not 0, until the next
  /// mask. Not while a frame is queued on another stream. @throws bad_argument as
  /// orb_extractor::set_mask
  void set_mask(Exec const& exec, int b, int camera, gray_view mask) {
    require_camera(b, camera);
    extractor_.set_mask(exec, 2 * b + camera, mask);
  }
  /// For callers that decode straight into the staging memory: height rows of staged_stride()
  /// bytes, from where frames take the image from now on. @throws bad_argument for a camera that
  /// there is not
  std::uint8_t* staged_image(int b, int camera) {
    require_camera(b, camera);
    given_[source_number(b, camera)] = true;
    return use_own_memory(b, camera);
  }
  int staged_stride() const { return geometry().stride[0]; }
  /// [batch] T_cw expected for the next frame. Tracking refuses one that is not finite; whether it
  /// is a rotation is not looked at.
  pose* predicted() { return motion_.host.predicted; }
  /// [batch] T_cw of the last frame, likewise
  pose* last_pose() { return motion_.host.last; }
  /// [batch][cameras * capacity()] slots of the last frame's inliers
  int* last_holder() { return motion_.host.last_holder; }
  /// [batch] the frame's number, above 0 and rising
  int* stamp() { return motion_.host.stamp; }
  /// [batch] at most params().local_points
  int* local_count() { return local_.host.count; }
  /// [batch][local_points] in search order; a slot that was never written is not in view
  int* local_slots() { return local_.host.slots; }

  /// Queues the writing of map points, each slot at most once. Must not follow another one before
  /// exec.wait().
  /// @param updates in host memory
  /// @throws bad_argument for more than params().updates points, a slot outside the map, or a NaN
  void update_map(Exec const& exec, int b, point_update const* updates, int count) {
    detail::require_range("camera pair", b, 0, batch() - 1);
    detail::require_range("map updates", count, 0, params_.updates);
    for (int i = 0; i < count; ++i) {
      detail::require_range("map slot", updates[i].slot, 0, params_.map_slots - 1);
      updates[i].check();
      staged_updates_.data()[i] = updates[i];
    }
    copy(exec, updates_, static_cast<point_update const*>(staged_updates_.data()),
         static_cast<std::size_t>(count));
    for_each_item<per_thread>(exec, count, apply_updates{},
                              static_cast<point_update const*>(updates_), map_.slice(b));
  }

  // ---- the frame

  // A call with the executor alone is, on a device, one launch of a graph recorded by the
  // constructor; with more arguments stage after stage is queued, and mark(name) called after each.

  /// Queues: images up, features, grid, stereo; result down with nothing held.
  /// @throws bad_argument where a camera was never given an image
  void extract(Exec const& exec) {
    check_images();
    extract_recording_.replay(exec, [this](Exec const& e) { queue_extract(e, no_mark{}); });
  }
  template <typename Mark>
  void extract(Exec const& exec, Mark&& mark) {
    check_images();
    queue_extract(exec, mark);
  }

  /// Queues: images and motion up, features, grid, stereo, search from the last frame (repeated
  /// with twice the radius where it finds too little), pose; result down.
  /// @throws bad_argument where a camera was never given an image, or predicted() or last_pose() is
  /// not finite
  void track_motion(Exec const& exec) {
    check_images();
    check_motion();
    motion_recording_.replay(exec, [this](Exec const& e) { queue_track_motion(e, no_mark{}); });
  }
  template <typename Mark>
  void track_motion(Exec const& exec, Mark&& mark) {
    check_images();
    check_motion();
    queue_track_motion(exec, mark);
  }

  /// Both in one, with nothing for the host in between: for callers who choose the local map before
  /// the frame. Queues what track_motion() and then track_local() do, but for the result down in
  /// the middle.
  /// @throws bad_argument as track_motion(), and for more local points than params().local_points
  void track(Exec const& exec) {
    check_frame();
    track_recording_.replay(exec, [this](Exec const& e) { queue_track(e, no_mark{}); });
  }
  template <typename Mark>
  void track(Exec const& exec, Mark&& mark) {
    check_frame();
    queue_track(exec, mark);
  }

  /// Queues: local map up, frustum, search, pose; result down. Follows track_motion().
  /// @throws bad_argument for more local points than params().local_points
  void track_local(Exec const& exec) {
    check_local_counts();
    local_recording_.replay(exec, [this](Exec const& e) { upload_local(e, {}, false, no_mark{}); });
  }
  /// The same with parameters of its own, stage by stage.
  /// @param restart forget what the frame's keypoints hold and start from predicted(), uploaded
  /// anew: for a frame after extract(), or another try with another pose; needs a new stamp() where
  /// there was one
  /// @throws bad_argument for more local points than params().local_points, or to restart from a
  /// pose that is not finite
  template <typename Mark = no_mark>
  void track_local(Exec const& exec, local_search_params const& search, bool restart = false,
                   Mark&& mark = {}) {
    check_local_counts();
    if (restart) { check_motion(); }
    upload_local(exec, search, restart, mark);
  }

  // ---- results

  /// The last queued call's result, in host memory: valid after exec.wait(), until the next call.
  tracked_frame_view const& result() const { return result_; }
  /// Queues a copy of the left descriptors of pair b. @param to host memory @param count how many,
  /// as in result().keypoints @throws bad_argument for more than capacity()
  void download_descriptors(Exec const& exec, int b, descriptor* to, int count) const {
    detail::require_range("camera pair", b, 0, batch() - 1);
    detail::require_range("descriptors", count, 0, capacity());
    copy(exec, to, static_cast<descriptor const*>(array_of<field::orb>(frame_.camera(b, 0))),
         static_cast<std::size_t>(count));
  }

  int capacity() const { return extractor_.capacity(); }
  int batch() const { return batch_; }
  /// That track() fetches from the host for a frame of all pairs.
  std::size_t input_bytes() const {
    return 2 * static_cast<std::size_t>(batch_) * staged_bytes() + motion_.host_memory.bytes() +
           local_.host_memory.bytes();
  }
  tracker_params const& params() const { return params_; }
  Rig const& rig() const { return rig_; }
  pyramid_geometry const& geometry() const { return extractor_.geometry(); }
  orb_extractor<Exec> const& extractor() const { return extractor_; }
  stereo_matcher<Exec, Rig> const& matcher() const { return matcher_; }
  map_points_view map() const { return map_; }
  frame_view const& frame() const { return frame_; }

private:
  void check_local_counts() const {
    batch_.require_made("tracker");
    for (int b = 0; b < batch_; ++b) {
      detail::require_range("local map points", local_.host.count[b], 0, params_.local_points);
    }
  }

  void check_images() const {
    batch_.require_made("tracker");
    for (std::size_t i = 0; i < given_.size(); ++i) {
      if (!given_[i]) {
        throw bad_argument("ft: camera " + std::to_string(i % 2) + " of pair " +
                           std::to_string(i / 2) + " was never given an image");
      }
    }
  }
  void check_motion() const {
    batch_.require_made("tracker");
    auto const check = [](char const* name, pose const& T) {
      for (float const v : T.R.m) { detail::require_finite(name, v); }
      for (float const v : {T.t.x, T.t.y, T.t.z}) { detail::require_finite(name, v); }
    };
    for (int b = 0; b < batch_; ++b) {
      check("an entry of a predicted pose", motion_.host.predicted[b]);
      check("an entry of a last pose", motion_.host.last[b]);
    }
  }
  void check_frame() const {
    check_local_counts();
    check_images();
    check_motion();
  }

  template <typename Mark>
  void queue_extract(Exec const& exec, Mark&& mark) {
    features(exec, mark, false);
    if constexpr (branches<Mark>) {
      matcher_.match_prepared(exec, extractor_);
      matcher_.finish(exec, extractor_);
    }
    clear_holders(exec, frame_);
    fill_bytes(exec, work_.matches, 0, static_cast<std::size_t>(batch_) * sizeof(int));
    download(exec, motion_.device.predicted, work_.matches, nullptr);
    mark("download");
  }
  template <typename Mark>
  void queue_track_motion(Exec const& exec, Mark&& mark) {
    queue_motion(exec, mark, false);
    download(exec, pose_of_motion(), work_.matches,
             params_.optimize_last ? observations_.inliers : nullptr);
    mark("download");
  }
  /// @param with_local the local map goes up with the rest
  template <typename Mark>
  void queue_motion(Exec const& exec, Mark&& mark, bool with_local) {
    features(exec, mark, with_local);
    auto const& input = motion_.device;
    last_search_params search;
    search.th = params_.last_th;
    search.retry_below = params_.enough_matches;
    search.max_x = frustum_.max_x;
    search.max_y = frustum_.max_y;
    auto const search_on = [&](Exec const& lists, auto const& listed) {
      search_last_frame(lists, rig_, input.predicted, input.last, frame_, last_, map_, search,
                        geometry(), last_windows_, work_, point_stamps{input.stamp, stamps_},
                        listed);
    };
    if constexpr (!branches<Mark>) {
      search_on(exec, [](Exec const&) {});
    } else if constexpr (Rig::rectified) {
      // The lists need no stereo matches, the choice from them does.
      matcher_.match_prepared(exec, extractor_);
      search_on(detail::with_order(exec, detail::launch_order::concurrent),
                [&](Exec const& e) { matcher_.finish(e, extractor_); });
    } else {
      // Nor does the choice for two cameras. The lists begin first.
      auto&& branch = match_branch_.fork(exec);
      search_on(exec, [&](Exec const&) { matcher_.match_prepared(branch, extractor_); });
    }
    mark("search last frame");
    if (params_.optimize_last) {
      optimize_frame_poses(exec, rig_, {frame_, map_, geometry()},
                           {input.predicted, poses_, observations_});
      mark("pose last frame");
    }
    if constexpr (branches<Mark> && !Rig::rectified) {
      if (!(with_local && lists_early())) { match_branch_.join(exec); }
    }
  }

  /// Recordings and calls without marks have side branches.
  template <typename Mark>
  static constexpr bool branches = std::is_same<std::decay_t<Mark>, no_mark>::value;

  template <typename Mark>
  void queue_track(Exec const& exec, Mark&& mark) {
    queue_motion(exec, mark, true);
    queue_local(exec, {}, mark, branches<Mark> && lists_early());
  }

  /// The pose that the search in the local map begins with, [batch].
  pose const* pose_of_motion() const {
    return params_.optimize_last ? poses_ : motion_.device.predicted;
  }
  /// Whether the local map is looked for from where the search from the last frame is: then its
  /// candidates are listed while that one chooses.
  bool lists_early() const { return !params_.optimize_last; }

  /// After the local map's slots and the poses are there. @param early the launch ahead is the
  /// choice of the search from the last frame
  template <typename Mark>
  void queue_local(Exec const& exec, local_search_params const& params, Mark&& mark, bool early) {
    local_search<Rig> search;
    search.rig = rig_;
    search.poses = pose_of_motion();
    search.slots = local_.device.slots;
    search.slot_count = local_.device.count;
    search.stamps = {motion_.device.stamp, stamps_};
    search.frustum = frustum_;
    search.params = params;
    search.seen = visible_;
    auto const write_visibility = [this](Exec const& e) {
      for_each_item<per_thread>(e, batch_ * params_.local_points, pack_visibility{},
                                static_cast<visibility const*>(visible_),
                                static_cast<int const*>(local_.device.count), batch(), int{cameras},
                                result_);
    };
    if constexpr (branches<Mark>) {
      auto const write_beside = [&](Exec const& e) {
        if (early && !Rig::rectified) { match_branch_.join(e); }
        auto&& branch = view_branch_.fork(e);
        write_visibility(branch);
        write_keypoints(branch);
      };
      search_local_map(exec, search, frame_, map_, geometry(), search_params{}, local_windows_,
                       local_work_, write_beside, early);
    } else {
      find_visible_points(exec, search, map_, geometry(), local_windows_);
      write_visibility(exec);
      mark("frustum");
      search_by_projection(exec, frame_, map_, local_windows_, search_params{}, local_work_);
      mark("search local map");
    }
    if (params_.optimize_local) {
      optimize_frame_poses(exec, rig_, {frame_, map_, geometry()},
                           {pose_of_motion(), poses_, observations_});
      mark("pose local map");
    }
    if constexpr (branches<Mark>) {
      view_branch_.join(exec);
    } else {
      write_keypoints(exec);
    }
    write_matches(exec, params_.optimize_local ? poses_ : pose_of_motion(), local_work_.matches,
                  params_.optimize_local ? observations_.inliers : nullptr);
    mark("download");
  }
  template <typename Mark>
  void upload_local(Exec const& exec, local_search_params const& params, bool restart,
                    Mark&& mark) {
    receive(exec, local_.source(), restart ? motion_.source() : block_source{});
    if (restart) {
      clear_holders(exec, frame_);
      if (params_.optimize_last) {
        copy(exec, poses_, static_cast<pose const*>(motion_.device.predicted),
             static_cast<std::size_t>(batch_));
      }
    }
    queue_local(exec, params, mark, false);
  }

  std::size_t staged_bytes() const {
    return static_cast<std::size_t>(geometry().stride[0]) *
           static_cast<std::size_t>(params_.orb.height);
  }

  static std::size_t source_number(int b, int camera) {
    return 2 * static_cast<std::size_t>(b) + static_cast<std::size_t>(camera);
  }
  image_source& source_of(int b, int camera) { return sources_.data()[source_number(b, camera)]; }
  std::uint8_t* use_own_memory(int b, int camera) {
    std::uint8_t* const data = images_.data() + source_number(b, camera) * staged_bytes();
    source_of(b, camera) = {data, staged_stride()};
    return data;
  }
  void require_camera(int b, int camera) const {
    detail::require_range("camera pair", b, 0, batch() - 1);
    detail::require_range("camera", camera, 0, 1);
  }
  void require_image(int b, int camera, gray_view image) const {
    require_camera(b, camera);
    detail::require(image.data != nullptr, "the image is null");
    auto const& p = params_.orb;
    detail::require(
        image.width == p.width && image.height == p.height && image.stride >= image.width,
        "the image's size is not the tracker's, or its stride is below its width");
  }

  /// Fetches inputs alone.
  void receive(Exec const& exec, block_source const& first, block_source const& second) {
    image_pyramid_view none = extractor_.pyramid();
    none.batch = 0;
    receive_images(exec, nullptr, none, first, second);
  }

  /// Stage by stage with the stereo matches, in a recording with what they need of the keypoints.
  /// @param with_local the local map comes with the images
  template <typename Mark>
  void features(Exec const& exec, Mark& mark, bool with_local) {
    batch_.require_made("tracker");
    block_source const local = with_local ? local_.source() : block_source{};
    if constexpr (branches<Mark>) {
      extractor_.receive_and_extract(
          exec, sources_.data(), motion_.source(), local, matcher_.clearing(),
          keypoint_grids<Rig::rectified>{frame_.grids, matcher_.right_rows()});
    } else {
      receive_images(exec, sources_.data(), extractor_.pyramid(), motion_.source(), local);
      mark("upload");
      extractor_.extract(exec, mark);
      constexpr int step = Rig::rectified ? 2 : 1;
      build_grid<nearest_cell>(exec, extractor_.keypoints(), 0, step, cameras * batch_,
                               frame_.grids);
      mark("grid");
      matcher_.match(exec, extractor_);
      mark("stereo");
    }
  }

  void download(Exec const& exec, pose const* poses, int const* matches, int const* inliers) {
    write_keypoints(exec);
    write_matches(detail::with_order(exec, detail::launch_order::concurrent), poses, matches,
                  inliers);
  }
  void write_keypoints(Exec const& exec) {
    for_each_item<per_thread>(exec, batch_ * frame_.numbers(), pack_keypoints<Rig>{}, rig_, frame_,
                              matcher_.depth(), matcher_.fisheye_matches(), result_,
                              last_keypoints_);
  }
  void write_matches(Exec const& exec, pose const* poses, int const* matches, int const* inliers) {
    for_each_item<per_thread>(exec, batch_ * frame_.numbers(), pack_matches{}, frame_, poses,
                              matches, inliers, result_);
  }

  Rig rig_{};
  tracker_params params_;
  detail::moved_count batch_;
  orb_extractor<Exec> extractor_;
  stereo_matcher<Exec, Rig> matcher_;
  frame_view frame_;
  last_frame_view last_;
  soa_view<field::angle, field::octave> last_keypoints_;
  map_points_view map_;
  search_windows_view last_windows_;
  search_windows_view local_windows_;
  search_workspace work_;
  search_workspace local_work_;  ///< the same, where nothing is listed early
  observations_view observations_;
  frustum_params frustum_;
  int* stamps_ = nullptr;
  pose* poses_ = nullptr;
  visibility* visible_ = nullptr;
  point_update* updates_ = nullptr;
  arena<space> arena_;
  buffer<point_update, staging> staged_updates_;
  buffer<std::uint8_t, staging> images_;
  buffer<image_source, staging> sources_;  ///< [batch][2]
  std::vector<bool> given_;                ///< [batch][2] whether a caller named an image
  tracked_frame_view result_;              ///< in staging memory, which a device writes to directly
  arena<staging> result_memory_;
  detail::twin<detail::motion_input, space, staging> motion_;
  detail::twin<detail::local_input, space, staging> local_;
  side_branch<Exec> match_branch_;
  side_branch<Exec> view_branch_;
  recording<Exec> extract_recording_;
  recording<Exec> motion_recording_;
  recording<Exec> local_recording_;
  recording<Exec> track_recording_;
};

}  // namespace FT_ABI
}  // namespace ft
