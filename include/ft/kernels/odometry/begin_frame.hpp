// SPDX-License-Identifier: Apache-2.0
/// @file Stages: the beginning of a frame of an odometry, which reads the host's inputs and
/// predicts the pose.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// Where a predicted frame is written, executor memory.
struct predicted_frames {
  pose* T_cw;       ///< [batch] predicted
  pose* last_T_cw;  ///< [batch] of the last frame, which an adjustment may have moved
  int* stamp;       ///< [batch] number of the frame
};

namespace detail {

/// Item: a camera. Reads its inputs.
struct read_odometry_input {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int b, odometry_input const* inputs,
                                 odometry_state_view const& state) const {
    odometry_input const& in = inputs[b];
    camera_track& t = state.tracks[b];
    if (in.reset != 0) {
      t.leave_map();
      int const adjusting = t.adjusting;
      t = camera_track::initial();
      t.adjusting = adjusting;
      state.T_cw[b] = rigid<double>::identity();
    }
    state.apply[b] = in.window != 0 && t.adjusting == 1 ? 1 : 0;
    if (in.window != 0) { t.adjusting = 0; }
  }
};

/// Item: a camera. Predicts its pose.
struct predict_frame {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int b, odometry_input const* inputs,
                                 tracking_rules const& rules, odometry_state_view const& state,
                                 predicted_frames const& out) const {
    odometry_input const& in = inputs[b];
    camera_track& t = state.tracks[b];
    t.interval_ns = t.begun != 0 ? saturated_difference(in.time_ns, t.time_ns) : 0;
    t.time_ns = state.time_ns[b] = in.time_ns;
    t.begun = 1;
    t.looked_up = in.looked_up;
    rigid<double> const last = state.T_cw[b];
    t.predicted =
        in.predicted != 0 ? in.T_cw : t.velocity.predict(last, t.interval_ns, rules.motion);
    out.T_cw[b] = t.predicted.template cast<float>();
    out.last_T_cw[b] = last.template cast<float>();
    out.stamp[b] = in.stamp;
  }
};

}  // namespace detail

/// Reads the inputs of a frame: resets cameras, and tells which adjustments end with this frame
/// (`state.apply`). Asynchronous on `exec`; allocates nothing; one launch.
/// @param inputs [batch] host memory that the executor's threads can read
template <typename Exec>
void read_odometry_inputs(Exec const& exec, odometry_input const* inputs,
                          odometry_state_view const& state) {
  for_each_item<per_thread>(exec, state.batch, detail::read_odometry_input{}, inputs, state);
}

/// Predicts the pose of every camera in its next frame, with constant velocity or from the host's
/// input. Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec>
void predict_frames(Exec const& exec, odometry_input const* inputs, tracking_rules const& rules,
                    odometry_state_view const& state, predicted_frames const& out) {
  for_each_item<per_thread>(exec, state.batch, detail::predict_frame{}, inputs, rules, state, out);
}

}  // namespace FT_ABI
}  // namespace ft
