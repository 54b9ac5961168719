// SPDX-License-Identifier: Apache-2.0
/// @file Poses with an IMU over an executor's frames and map: their memory and their launches.
#pragma once

#include <cstring>

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/inertial.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/inertial/optimize_inertial_pose.hpp"
#include "ft/kernels/pose/optimize_frame.hpp"
#include "integration/orbslam3/executor_calls.hpp"
#include "integration/orbslam3/plain_types.hpp"
#include "integration/orbslam3/rigs.hpp"

namespace ft::orbslam3 {
inline namespace FT_ABI {

/// Lists the points that a frame's keypoints hold, in the order of the keypoints' numbers.
/// @tparam Rectified whether keypoints have a column in a right image
template <bool Rectified>
struct list_held_points {
  using scratch = no_scratch;

  /// @param noted [numbers] distances of the points by keypoint @param distance [capacity] the same
  /// by observation
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int, frames_in_map const& in,
                                 float const* noted, observations_view const& out,
                                 float* distance) const {
    frame_view const& frame = in.frame;
    int so_far = 0;
    FT_NO_UNROLL
    for (int base = 0; base < frame.numbers(); base += g.size()) {
      int const number = base + g.rank();
      int const c = number / frame.capacity();
      int const k = number - c * frame.capacity();
      bool const there = number < frame.numbers() && k < *frame.camera(0, c).count;
      int const slot = there ? frame.holder[number] : -1;
      int total = 0;
      int const at = so_far + g.exclusive_scan(static_cast<int>(slot >= 0), total);
      if (slot >= 0) {
        keypoints_view const kp = frame.camera(0, c);
        int const octave = kp.octave(k);
        float const right = Rectified && frame.right_x != nullptr ? frame.right_x[number] : -1.0f;
        out.items[at] = {in.map.position(slot),
                         in.geometry.column(kp.x(k), octave),
                         in.geometry.row(kp.y(k), octave),
                         right < 0 ? right : in.geometry.column(right, octave),
                         in.geometry.inv_sigma2[octave],
                         c};
        out.number[at] = number;
        distance[at] = noted[number];
      }
      so_far += total;
    }
    if (g.rank() == 0) { *out.count = so_far; }
  }
};

/// Item: an observation. An outlier's keypoint releases its point.
struct release_outlier {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, observations_view const& seen,
                                 inertial_pose_result const* result, int* holder) const {
    bool const optimised = result->status == inertial_pose_status::optimised ||
                           result->status == inertial_pose_status::ended_early;
    if (optimised && item < *seen.count && seen.outlier[item] != 0) {
      holder[seen.number[item]] = -1;
    }
  }
};

/// @tparam Rig rectified_rig or fisheye_rig
template <typename Exec, typename Rig>
class device_inertial {
  static constexpr memory_space space = Exec::space;
  static constexpr memory_space staging = staging_space<Exec>;

  /// What it downloads.
  struct call_outputs {
    inertial_prior next_prior;
    inertial_pose_result result;
  };
  static_assert(sizeof(inertial_request) % 8 == 0 && sizeof(call_outputs) % 8 == 0,
                "moved as words");

public:
  /// Allocates memory and enqueues its initial values. @param keypoints per image
  device_inertial(Exec const& exec, Rig const& rig, settings const& s, int keypoints)
      : rig_(rig), numbers_(searched_cameras<Rig> * keypoints) {
    params_.reference_quirks = s.reference_quirks;
    memory_ = arena<space>([&](carver& c) {
      carve(c, seen_, numbers_, 1);
      c.place(numbers_, noted_, distance_);
      c.place({inertial_rounds, numbers_}, chi2_);
      c.place(1, inputs_, outputs_);
    });
    host_memory_ = arena<staging>([&](carver& c) {
      c.place(numbers_, staged_noted_);
      c.place(1, staged_, staged_outputs_);
    });
    std::memset(host_memory_.data(), 0, host_memory_.bytes());
    fill_bytes(exec, memory_.data(), 0, memory_.bytes());
  }

  /// [numbers] distances of the points that keypoints hold, staged for the next call.
  float* distances() { return staged_noted_; }

  /// Stages the rest. @return the number of mounts so far: what was recorded with another one is
  /// obsolete
  int set(inertial_request const& r) {
    if (std::memcmp(&r.mount, &mount_, sizeof mount_) != 0) { ++mounts_; }
    mount_ = r.mount;
    *staged_ = r;
    for (preintegrated* const i : {&staged_->integral, &staged_->since_keyframe}) {
      if (i->steps <= 0) { i->status = integration_status::no_steps; }
    }
    return mounts_;
  }

  // ---- launches

  void upload(Exec const& exec) const {
    word_mover<Exec> up;
    up.add(exec, inputs_, staged_, 1);
    up.add(exec, noted_, staged_noted_, numbers_);
    up.flush(exec);
  }
  void queue(Exec const& exec, frames_in_map const& in) const {
    for_each_item<per_block<256>>(exec, 1, list_held_points<Rig::rectified>{}, in,
                                  static_cast<float const*>(noted_), seen_, distance_);
    inertial_poses p{};
    p.problems = 1;
    p.capacity = numbers_;
    p.from_last_frame = &inputs_->from_last_frame;
    p.first = &inputs_->first;
    p.start = &inputs_->start;
    p.integral = &inputs_->integral;
    p.since_keyframe = &inputs_->since_keyframe;
    p.prior = &inputs_->prior;
    p.observations = seen_.items;
    p.distance = distance_;
    p.count = seen_.count;
    p.result = &outputs_->result;
    p.next_prior = &outputs_->next_prior;
    p.outlier = seen_.outlier;
    p.chi2 = chi2_;
    optimize_inertial_poses(exec, rig_, mount_, p, params_);
    for_each_item<per_thread>(exec, numbers_, release_outlier{}, seen_,
                              static_cast<inertial_pose_result const*>(p.result), in.frame.holder);
  }
  void download(Exec const& exec, int* holder, frame_view const& frame) const {
    word_mover<Exec> down;
    down.add(exec, staged_outputs_, outputs_, 1);
    down.add(exec, holder, frame.holder, frame.numbers());
    down.flush(exec);
  }

  /// Valid after exec.wait().
  inertial_result result() const {
    inertial_pose_result const& from = staged_outputs_->result;
    inertial_result r;
    r.refused = from.status != inertial_pose_status::optimised &&
                from.status != inertial_pose_status::ended_early;
    r.tracked = from.tracked;
    r.state = from.stored;
    r.prior = staged_outputs_->next_prior;
    return r;
  }

private:
  Rig rig_;
  int numbers_;
  inertial_pose_params params_;
  imu_mount mount_{};
  int mounts_ = 0;
  observations_view seen_;
  float* noted_ = nullptr;
  float* distance_ = nullptr;
  float* chi2_ = nullptr;
  inertial_request* inputs_ = nullptr;
  call_outputs* outputs_ = nullptr;
  float* staged_noted_ = nullptr;
  inertial_request* staged_ = nullptr;
  call_outputs* staged_outputs_ = nullptr;
  arena<space> memory_;
  arena<staging> host_memory_;
};

}  // namespace FT_ABI
}  // namespace ft::orbslam3
