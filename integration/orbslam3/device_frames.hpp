// SPDX-License-Identifier: Apache-2.0
/// @file Frames in executor memory, and their copies in host memory.
#pragma once

#include <cstddef>
#include <cstring>

#include "ft/containers/feature_grid.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/grid.hpp"
#include "integration/orbslam3/executor_calls.hpp"
#include "integration/orbslam3/plain_types.hpp"
#include "integration/orbslam3/rigs.hpp"

namespace ft::orbslam3 {
inline namespace FT_ABI {

struct device_frame {
  keypoints_view keypoints;  ///< left, right
  stereo_matches_view matches;
  fisheye_matches_view fisheye;
  feature_grid_view grids;
  int* mono = nullptr;
  int* holder = nullptr;
  bounds grid_bounds{};
  bool grid_made = false;
};

/// @tparam Rig rectified_rig or fisheye_rig
template <typename Exec, typename Rig>
class device_frames {
public:
  static constexpr int buffers = device_tracker::buffers;
  static constexpr int searched = searched_cameras<Rig>;

  device_frames() = default;
  /// Enqueues the initial zeros. @param keypoints most per image
  device_frames(Exec const& exec, settings const& s, int keypoints) : capacity_(keypoints) {
    has_right_ = s.bf != 0;
    memory_ = arena<Exec::space>([&](carver& c) {
      for (device_frame& f : frames_) {
        carve(c, f.keypoints, capacity_, 2);
        carve(c, f.matches, capacity_, 1);
        carve(c, f.fisheye, capacity_, 1);
        carve(c, f.grids, grid_geometry::over(0, 0, 1, 1), capacity_, searched);
        f.mono = c.take<int>(2);
        f.holder = c.take<int>(2 * static_cast<std::size_t>(capacity_));
      }
    });
    host_memory_ = arena<staging_space<Exec>>([&](carver& c) {
      for (frame_arrays& a : arrays_) { carve_arrays(c, a, capacity_); }
    });
    std::memset(host_memory_.data(), 0, host_memory_.bytes());
    fill_bytes(exec, memory_.data(), 0, memory_.bytes());
  }

  int capacity() const { return capacity_; }
  int numbers() const { return searched * capacity_; }
  device_frame& operator[](int b) { return frames_[b]; }
  device_frame const& operator[](int b) const { return frames_[b]; }
  frame_arrays const& arrays(int b) const { return arrays_[b]; }

  /// Adds a part of the host's copy to the next upload.
  void send(Exec const& exec, word_mover<Exec>& up, int b, frame_part part) {
    device_frame& f = frames_[b];
    frame_arrays const& a = arrays_[b];
    auto const both = [&](auto* to, auto const* from) {
      for (int c = 0; c < 2; ++c) {
        up.add(exec, to + c * capacity_, from + c * capacity_, a.count[c]);
      }
    };
    switch (part) {
      case frame_part::keypoints:
        both(array_of<field::orb>(f.keypoints), reinterpret_cast<descriptor const*>(a.descriptor));
        up.add(exec, f.mono, a.mono, 2);
        send(exec, up, b, frame_part::octaves);
        send(exec, up, b, frame_part::positions);
        break;
      case frame_part::octaves:
        up.add(exec, f.keypoints.count, a.count, 2);
        both(array_of<field::angle>(f.keypoints), a.angle);
        both(array_of<field::octave>(f.keypoints), a.octave);
        break;
      case frame_part::positions:
        both(array_of<field::x>(f.keypoints), a.x);
        both(array_of<field::y>(f.keypoints), a.y);
        f.grid_made = false;
        break;
      case frame_part::right_x:
        up.add(exec, array_of<field::right_x>(f.matches), a.right_x, a.count[0]);
        break;
      case frame_part::partner:
        up.add(exec, f.fisheye.partner, a.partner, numbers());
        break;
      case frame_part::holder:
        up.add(exec, f.holder, a.holder, numbers());
        break;
    }
  }

  frame_view view(int b) const {
    device_frame const& f = frames_[b];
    frame_view v;
    v.keypoints = f.keypoints;
    v.cameras = searched;
    v.grids = f.grids;
    v.holder = f.holder;
    if constexpr (Rig::rectified) {
      v.right_x = has_right_ ? array_of<field::right_x>(f.matches) : nullptr;
    } else {
      v.partner = f.fisheye.partner;
    }
    return v;
  }
  static grid_geometry cells(bounds const& image) {
    return grid_geometry::over(image.min_x, image.min_y, image.max_x, image.max_y);
  }
  bool needs_grid(int b, bounds const& image) const {
    return !frames_[b].grid_made || !(frames_[b].grid_bounds == image);
  }
  /// States that the grid of frame `b` now covers `image`.
  void has_grid(int b, bounds const& image) {
    device_frame& f = frames_[b];
    f.grids.geometry = cells(image);
    f.grid_bounds = image;
    f.grid_made = true;
  }
  /// Enqueues the grid unless it is already built.
  void make_grid(Exec const& exec, int b, bounds const& image) {
    if (!needs_grid(b, image)) { return; }
    has_grid(b, image);
    build_grid<nearest_cell>(exec, frames_[b].keypoints, 0, 1, searched, frames_[b].grids);
  }

private:
  static void carve_arrays(carver& c, frame_arrays& a, int capacity) {
    a.capacity = capacity;
    c.place(2, a.count, a.mono);
    c.place({2, capacity}, a.x, a.y, a.angle, a.response, a.octave, a.partner, a.holder);
    c.place(capacity, a.right_x, a.depth, a.point);
    c.place({2, capacity, 8}, a.descriptor);
  }

  int capacity_ = 0;
  bool has_right_ = false;
  device_frame frames_[buffers];
  frame_arrays arrays_[buffers];
  arena<Exec::space> memory_;
  arena<staging_space<Exec>> host_memory_;
};

}  // namespace FT_ABI
}  // namespace ft::orbslam3
