// SPDX-License-Identifier: Apache-2.0
/// @file Stage: what follows for a lost camera after its place was looked up.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/frame.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/map/keyframe_input.hpp"
#include "ft/kernels/odometry/judge_frame.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// Whether the place of a camera was looked up, and known.
enum class place_outcome : int {
  not_lost = 0,
  unknown = 1,
  known = 2,
  begins_map = 3  ///< known, and a new map begins there
};

/// Frames of cameras, of which some were lost and looked up. Executor memory, unless said
/// otherwise.
struct looked_up_frames {
  frame_view frame;
  bool begins_maps = true;                 ///< those that stay lost may begin a map
  place_outcome const* outcome = nullptr;  ///< [batch] memory that the executor's threads read
  pose const* found_T_cw = nullptr;        ///< [batch] of frames whose place is known
  int const* found_inliers = nullptr;      ///< [batch] likewise
  std::int64_t const* found_evidence = nullptr;  ///< [batch] likewise, 1 / 65536 bits
  // Written, for cameras that were lost.
  pose* T_cw = nullptr;              ///< [batch]
  int* inliers = nullptr;            ///< [batch]
  int* matches = nullptr;            ///< [batch]
  unsigned char* matched = nullptr;  ///< [batch][numbers] as in searched_frames
  keyframe_order* begins = nullptr;  ///< [batch] begin_map for new maps; of all cameras
};

namespace detail {

/// Item: a camera.
struct settle_lost_camera {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, tracking_rules const& rules,
                                 looked_up_frames const& in,
                                 odometry_state_view const& state) const {
    if (g.rank() == 0) { in.begins[b] = keyframe_order::none; }
    if (in.outcome[b] == place_outcome::not_lost) { return; }
    bool const begins = in.outcome[b] == place_outcome::begins_map;
    bool const found = (begins || in.outcome[b] == place_outcome::known) &&
                       in.found_inliers[b] >= rules.min_recovered &&
                       is_enough(in.found_evidence[b], rules);
    int held = 0;
    auto const first = static_cast<std::ptrdiff_t>(b) * in.frame.numbers();
    for (int i = g.rank(); i < in.frame.numbers(); i += g.size()) {
      int const c = i / in.frame.capacity();
      bool const there = i - c * in.frame.capacity() < *in.frame.camera(b, c).count;
      int& holder = in.frame.holder[first + i];
      if (!found || !there) { holder = -1; }
      in.matched[first + i] = holder >= 0 ? 1 : 0;
      held += static_cast<int>(holder >= 0);
    }
    held = g.reduce(held, sum_op{});
    if (g.rank() != 0) { return; }
    camera_track t = state.tracks[b];
    if (found && t.state == tracking_state::tracking) {  // its motion is known
      auto const T = in.found_T_cw[b].template cast<strict_double>();
      state.T_cw[b] = T.orthonormalized().template cast<double>();
    } else if (found) {
      keep_pose(t, state.T_cw[b], in.found_T_cw[b]);
      t.plan = search_plan::recover;  // what was searched is told
      t.facts = {};
    }
    if (found) {
      in.T_cw[b] = state.T_cw[b].template cast<float>();
      in.inliers[b] = t.agreed = in.found_inliers[b];
      t.facts.matches = in.found_inliers[b];
      t.facts.evidence = static_cast<int>(in.found_evidence[b] / evidence_one);
      in.matches[b] = held;
      if (begins) { begin(t, b, in, state); }
    } else if (in.begins_maps && !rules.localize_only && t.lost_with_features >= rules.patience) {
      begin(t, b, in, state);
    }
    if (!found && t.state != tracking_state::tracking) { in.inliers[b] = 0; }
    state.tracks[b] = t;
  }

private:
  FT_HOST_DEVICE static void begin(camera_track& t, int b, looked_up_frames const& in,
                                   odometry_state_view const& state) {
    // The adjustment of the old map that this frame gathered is not begun.
    if (state.gather[b] != 0) { t.adjusting = 0; }
    state.gather[b] = 0;
    begin_map(t);
    note_keyframe(t, state.T_cw[b]);
    in.begins[b] = state.order[b] = keyframe_order::begin_map;
  }
};

}  // namespace detail

/// Lost cameras whose place is known are tracked at the pose that was found, if it has
/// min_recovered inliers and min_evidence; of place_outcome::begins_map they begin a map there. The
/// others begin a new map if `patience` is at its end,
/// as judge_frames() decides without a look-up. Keypoints of a frame that is not found hold
/// nothing. Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec>
void settle_lost_frames(Exec const& exec, tracking_rules const& rules, looked_up_frames const& in,
                        odometry_state_view const& state) {
  for_each_item<per_block<256>>(exec, state.batch, detail::settle_lost_camera{}, rules, in, state);
}

}  // namespace FT_ABI
}  // namespace ft
