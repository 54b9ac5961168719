// SPDX-License-Identifier: Apache-2.0
/// @file The memory of a tracker: working memory of the stages, inputs from the host, and results.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstring>

#include "ft/containers/frame.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/containers/soa.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/pose/optimize_frame.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "ft/kernels/upload.hpp"
#include "ft/pipelines/tracker_types.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

inline void carve(carver& c, tracked_frame_view& v, int batch) {
  auto const b = static_cast<std::size_t>(batch);
  std::size_t const n = checked_mul(b, static_cast<std::size_t>(v.capacity));
  std::size_t const numbers = n * static_cast<std::size_t>(v.cameras);
  v.keypoints = c.take<int>(b * static_cast<std::size_t>(v.cameras));
  v.T_cw = c.take<pose>(b);
  v.matches = c.take<int>(b);
  v.inliers = c.take<int>(b);
  v.x = c.take<float>(numbers);
  v.y = c.take<float>(numbers);
  v.octave = c.take<int>(numbers);
  v.holder = c.take<int>(numbers);
  v.partner = c.take<int>(numbers);
  std::size_t const with_depth = n * static_cast<std::size_t>(v.depth_cameras);
  v.depth = c.take<float>(with_depth);
  v.point = c.take<vec3<float>>(with_depth);
  v.in_view = c.take<unsigned char>(checked_mul(b, static_cast<std::size_t>(v.local_points)));
}

/// Frames are numbered from 1 to this and then from 1 again, with stamps forgotten in between.
inline constexpr int frame_numbers = 4096;

/// Host inputs of the search from the last frame.
struct motion_input {
  pose* predicted = nullptr;  ///< [batch] T_cw
  int* stamp = nullptr;       ///< [batch] number of this frame, 1 to frame_numbers
};

inline void carve(carver& c, motion_input& v, int batch) {
  v.predicted = c.take<pose>(static_cast<std::size_t>(batch));
  v.stamp = c.take<int>(static_cast<std::size_t>(batch));
}

/// Host inputs of the search in the local map.
struct local_input {
  int* count = nullptr;  ///< [batch]
  int* slots = nullptr;  ///< [batch][points]
};

inline void carve(carver& c, local_input& v, int batch, int points) {
  auto const b = static_cast<std::size_t>(batch);
  v.count = c.take<int>(b);
  v.slots = c.take<int>(b * static_cast<std::size_t>(points));
}

struct frame_shape {
  int capacity;           ///< keypoints of an image
  int batch;              ///< rigs
  int cameras;            ///< whose keypoints are searched
  int images = 2;         ///< of a rig
  int searches = 1;       ///< of a rig
  int depth_cameras = 1;  ///< whose keypoints may have a depth

  template <typename Rig>
  static frame_shape of(int capacity, int batch) {
    return {capacity,    batch,         Rig::cameras,
            Rig::images, Rig::searches, Rig::rectified ? Rig::cameras : 1};
  }
  int numbers() const { return cameras * capacity; }
  int all_searches() const { return batch * searches; }
  int cameras_of_search() const { return cameras / searches; }
};

/// State that a frame leaves in executor memory for the next one.
struct last_state {
  pose* T_cw = nullptr;   ///< [batch]
  int* holder = nullptr;  ///< [batch][cameras * capacity] slots of inliers
  soa_view<field::angle, field::octave> keypoints;
};

inline void carve(carver& c, last_state& v, frame_shape const& shape) {
  auto const b = static_cast<std::size_t>(shape.batch);
  v.T_cw = c.take<pose>(b);
  v.holder = c.take<int>(b * static_cast<std::size_t>(shape.numbers()));
  carve(c, v.keypoints, shape.capacity, shape.images * shape.batch);
}

/// A layout in executor memory with its copy in staging memory. Both are transferred as one block.
template <typename View, memory_space Device, memory_space Host>
struct twin {
  View device;
  View host;
  arena<Device> device_memory;
  arena<Host> host_memory;

  twin() = default;
  template <typename... Sizes>
  explicit twin(int batch, Sizes... sizes)
      : device_memory([&](carver& c) { carve(c, device, batch, sizes...); }),
        host_memory([&](carver& c) { carve(c, host, batch, sizes...); }) {
    std::memset(host_memory.data(), 0, host_memory.bytes());
  }
  allocated_bytes allocated() const { return {device_memory.bytes(), host_memory.bytes()}; }
  block_source source() const {
    // The padding of an arena exceeds the partial quad that the transfer cuts off.
    static_assert(alignment >= 2 * sizeof(receive_parts::quad), "all that is carved is copied");
    return {device_memory.data(), host_memory.data(),
            static_cast<int>(host_memory.bytes() / sizeof(receive_parts::quad))};
  }
};

/// Owns the memory of a tracker and holds the views into it. Executor memory, unless said
/// otherwise.
template <typename Exec>
struct frame_memory {
  static constexpr memory_space space = Exec::space;
  static constexpr memory_space staging = staging_space<Exec>;

  frame_view frame;
  map_points_view map;
  last_state last;
  search_windows_view last_windows;
  search_windows_view local_windows;
  search_workspace last_work;
  search_workspace local_work;  ///< last_work, unless the local map's candidates are listed early
  observations_view observations;
  int* stamps = nullptr;          ///< [batch][map slots]
  pose* poses = nullptr;          ///< [batch] optimised
  visibility* visible = nullptr;  ///< [cameras][batch][local points]
  twin<motion_input, space, staging> motion;
  twin<local_input, space, staging> local;
  tracked_frame_view result;  ///< staging memory, to which a device writes directly

  /// @param cells of the keypoints' grids @param early whether both searches are in flight at once
  /// @throws bad_argument, std::bad_alloc, cuda_error
  void take(frame_shape const& shape, tracker_params const& p, grid_geometry const& cells,
            bool early) {
    auto const b = static_cast<std::size_t>(shape.batch);
    require_items("keypoints of a batch", static_cast<std::size_t>(shape.images) * b,
                  static_cast<std::size_t>(shape.capacity));
    require_items("local map points of a batch", b, static_cast<std::size_t>(p.local_points));
    frame.batch = shape.batch;
    frame.cameras = shape.cameras;
    frame.keypoint_step = shape.images;
    frame.camera_step = shape.images / shape.cameras;
    take_device_memory(shape, p, cells, early);
    if (!early) { local_work = last_work; }
    result.capacity = shape.capacity;
    result.cameras = shape.cameras;
    result.depth_cameras = shape.depth_cameras;
    result.local_points = p.local_points;
    staging_memory_ = arena<staging>([&](carver& c) {
      carve(c, result, shape.batch);
      staged_T_cw_ = c.take<pose>(b);
      staged_holder_ = c.take<int>(b * static_cast<std::size_t>(shape.numbers()));
    });
    std::memset(staging_memory_.data(), 0, staging_memory_.bytes());
    motion = twin<motion_input, space, staging>(shape.batch);
    local = twin<local_input, space, staging>(shape.batch, p.local_points);
  }

  allocated_bytes bytes() const {
    return allocated_bytes{memory_.bytes(), staging_memory_.bytes()} + motion.allocated() +
           local.allocated();
  }

  /// State before the first frame: empty grids, no motion, no holders.
  void initialize(Exec const& exec) {
    auto const b = static_cast<std::size_t>(frame.batch);
    auto const numbers = b * static_cast<std::size_t>(result.numbers());
    auto const slots = b * static_cast<std::size_t>(map.capacity);
    auto const grids = b * static_cast<std::size_t>(frame.cameras);
    // The position of a map point that was never written is NaN, so no camera sees it.
    fill_bytes(exec, array_of<field::position>(map), 0xff, slots * sizeof(vec3<float>));
    forget_stamps(exec);
    fill_bytes(exec, frame.grids.start, 0,
               grids * static_cast<std::size_t>(frame.grids.geometry.cells() + 1) * sizeof(int));
    fill_bytes(exec, frame.holder, 0xff, numbers * sizeof(int));
    fill_bytes(exec, poses, 0, b * sizeof(pose));
    fill_bytes(exec, last.holder, 0xff, numbers * sizeof(int));
    fill_bytes(exec, last.keypoints.count, 0,
               b * static_cast<std::size_t>(frame.keypoint_step) * sizeof(int));
    std::fill_n(staged_T_cw_, frame.batch, pose::identity());
    copy(exec, last.T_cw, static_cast<pose const*>(staged_T_cw_), b);
    fill_bytes(exec, motion.device_memory.data(), 0, motion.device_memory.bytes());
    fill_bytes(exec, local.device_memory.data(), 0, local.device_memory.bytes());
    // Candidates are prefetched before their count is known.
    fill_bytes(exec, last_work.list, 0xff, last_work.list_bytes());
    fill_bytes(exec, local_work.list, 0xff, local_work.list_bytes());
  }

  /// Enqueues the copy of the state after the last frame of pair b. @param holders [numbers]
  void set_last(Exec const& exec, int b, pose const& T_cw, int const* holders) {
    auto const first = static_cast<std::ptrdiff_t>(b) * result.numbers();
    staged_T_cw_[b] = T_cw;
    std::copy_n(holders, result.numbers(), staged_holder_ + first);
    copy(exec, last.T_cw + b, static_cast<pose const*>(staged_T_cw_) + b, std::size_t{1});
    copy(exec, last.holder + first, static_cast<int const*>(staged_holder_) + first,
         static_cast<std::size_t>(result.numbers()));
  }
  /// Forgets in which frames map points were matched. No frame has the number 0.
  void forget_stamps(Exec const& exec) const {
    fill_bytes(exec, stamps, 0,
               static_cast<std::size_t>(frame.batch) * static_cast<std::size_t>(map.capacity) *
                   sizeof(int));
  }

private:
  void take_device_memory(frame_shape const& shape, tracker_params const& p,
                          grid_geometry const& cells, bool early) {
    int const batch = shape.batch;
    int const cameras = shape.cameras;
    int const capacity = shape.capacity;
    int const searches = shape.all_searches();
    int const searched = shape.cameras_of_search();
    int const last_points = searched * capacity;  // of a search
    int const windows = early ? last_points : max_of(last_points, p.local_points);
    auto const b = static_cast<std::size_t>(batch);
    memory_ = arena<space>([&](carver& c) {
      carve(c, map, p.map_slots, batch);
      carve(c, frame.grids, cells, capacity, cameras * batch);
      carve(c, last, shape);
      carve(c, last_windows, last_points, searches, searched);
      carve(c, local_windows, p.local_points, searches, searched);
      carve(c, last_work, windows, capacity, searches, searched);
      if (early) { carve(c, local_work, p.local_points, capacity, searches, searched); }
      carve(c, observations, shape.numbers(), batch);
      frame.holder = c.take<int>(b * static_cast<std::size_t>(shape.numbers()));
      stamps = c.take<int>(checked_mul(b, static_cast<std::size_t>(p.map_slots)));
      poses = c.take<pose>(b);
      visible = c.take<visibility>(b * static_cast<std::size_t>(cameras) *
                                   static_cast<std::size_t>(p.local_points));
    });
  }

  pose* staged_T_cw_ = nullptr;   ///< [batch]
  int* staged_holder_ = nullptr;  ///< [batch][numbers]
  arena<space> memory_;
  arena<staging> staging_memory_;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
