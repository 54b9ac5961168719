// SPDX-License-Identifier: Apache-2.0
/// @file What of an odometry follows from the read-out times of its cameras.
#pragma once

#include "ft/cameras/distorted_pair.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/containers/frame.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/images/undistort.hpp"
#include "ft/kernels/keypoints/rolling_shutter.hpp"
#include "ft/kernels/odometry/state.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// When the rows of a rig's images are read. @param height of the images that are searched
template <typename Rig>
sensor_rows<Rig::cameras> rows_of(Rig const& rig, int height) {
  sensor_rows<Rig::cameras> rows;
  for (float& s : rows.readout_s) { s = rig.readout_s; }
  rows.height = height;
  return rows;
}
template <int N, typename Camera>
sensor_rows<N> rows_of(multi_rig<N, Camera> const& rig, int height) {
  sensor_rows<N> rows;
  for (int c = 0; c < N; ++c) { rows.readout_s[c] = rig.of[c].readout_s; }
  rows.height = height;
  return rows;
}
template <typename Left, typename Right>
auto rows_of(distorted_pair<Left, Right> const& rig, int height) {
  rectified_rows<typename distorted_pair<Left, Right>::left_type> rows;
  rows.camera = rig.left;
  rows.target = rig.target.camera;
  rows.R_camera_target = rig.R_left.transposed();
  rows.rows.readout_s[0] = rig.readout_s;
  rows.rows.height = rig.height > 0 ? rig.height : height;
  return rows;
}

/// Whether the rows of some camera are read one after the other.
template <typename Rig>
bool has_rolling_shutter(Rig const& rig) {
  return rig.readout_s > 0;
}
template <int N, typename Camera>
bool has_rolling_shutter(multi_rig<N, Camera> const& rig) {
  for (Camera const& c : rig.of) {
    if (c.readout_s > 0) { return true; }
  }
  return false;
}

/// Moves the keypoints of rolling shutters. Without any it has no memory, and nothing is launched.
template <typename Exec, typename Rig>
class rolling_keypoints {
  using rows_type = decltype(rows_of(Rig{}, 0));

public:
  rolling_keypoints() = default;
  rolling_keypoints(Rig const& rig, int height, int capacity, int batch)
      : rows_(rows_of(rig, height)) {
    if (!has_rolling_shutter(rig)) { return; }
    memory_ = owner<memory, Exec::space>([&](carver& c, memory& m) {
      carve(c, m.moved, capacity, Rig::images * batch);
      c.place({batch}, m.motion);
    });
    present_ = true;
  }

  bool present() const { return present_; }
  std::size_t bytes() const { return present_ ? memory_.bytes() : 0; }  ///< of executor memory
  /// Where keypoints are moved to. @pre present()
  pixels_view moved() const { return memory_->moved; }

  /// After the prediction.
  void find_velocities(Exec const& exec, odometry_input const* inputs,
                       odometry_state_view const& state) const {
    find_body_velocities(exec, inputs, state, memory_->motion);
  }
  /// After the first pose.
  void refine_velocities(Exec const& exec, first_poses const& found,
                         odometry_state_view const& state) const {
    refine_body_velocities(exec, found, state, memory_->motion);
  }
  /// After depths and partners. Two launches.
  /// @param in the frame as it was found; what is this object's is set
  template <typename Searched>
  void move(Exec const& exec, rolling_frames<Searched, rows_type> in) const {
    in.rows = rows_;
    in.motion = memory_->motion;
    in.moved = memory_->moved;
    move_to_middle_rows(exec, in);
    frame_view const& frame = in.frame;
    build_grid<nearest_cell>(exec, with_columns(frame.keypoints, memory_->moved), 0,
                             frame.camera_step, frame.batch * frame.cameras, frame.grids);
  }
  template <typename Searched>
  using frames = rolling_frames<Searched, rows_type>;

private:
  struct memory {
    pixels_view moved;
    shutter_motion* motion = nullptr;
  };
  bool present_ = false;
  rows_type rows_{};
  owner<memory, Exec::space> memory_;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
