// SPDX-License-Identifier: Apache-2.0
/// @file Writes the result of a frame to host memory, and the state for the next frame.
#pragma once

#include <cstddef>
#include <cstring>

#include "ft/cameras/multi_rig.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/soa.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/upload.hpp"
#include "ft/pipelines/detail/frame_memory.hpp"
#include "ft/pipelines/tracker_types.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The outcome of a frame's last search and pose optimisation.
struct frame_outcome {
  pose const* T_cw = nullptr;    ///< [batch]
  int const* matches = nullptr;  ///< [batch][searches]
  int const* inliers = nullptr;  ///< [batch]; null without pose optimisation
  int searches = 1;              ///< of a rig

  FT_HOST_DEVICE int all_matches(int b) const {
    int all = matches[b * searches];
    for (int s = 1; s < searches; ++s) { all += matches[b * searches + s]; }
    return all;
  }
};

/// Item: a keypoint number of a batch entry. Writes matches and poses to host memory, and keeps
/// them for the next frame.
struct pack_matches {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, frame_view const& frame,
                                 frame_outcome const& found, tracked_frame_view const& out,
                                 last_state const& last) const {
    int const b = item / frame.numbers();
    int const number = item % frame.numbers();
    int const c = number / frame.capacity();
    if (number == 0) {
      pose const T_cw = found.T_cw[b];
      out.T_cw[b] = T_cw;
      last.T_cw[b] = T_cw;
      int const matches = found.all_matches(b);
      out.matches[b] = matches;
      out.inliers[b] = found.inliers != nullptr ? found.inliers[b] : matches;
    }
    bool const there = number % frame.capacity() < *frame.camera(b, c).count;
    int const holder = there ? frame.holder[item] : -1;
    out.holder[item] = holder;
    last.holder[item] = holder;
  }
};

/// Item: a keypoint number of a batch entry. Writes keypoints to host memory, and keeps those
/// columns that the next frame's search needs.
template <typename Rig>
struct pack_keypoints {
  using scratch = no_scratch;

  /// @param depth [batch][capacity] metres, for a multi_rig [batch][cameras * capacity]
  /// @param point [batch][capacity], unrectified pairs
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, Rig const& rig, frame_view const& frame,
                                 float const* depth, vec3<float> const* point,
                                 tracked_frame_view const& out, last_state const& last) const {
    int const b = item / frame.numbers();
    int const number = item % frame.numbers();
    int const c = number / frame.capacity();
    int const i = number % frame.capacity();
    keypoints_view const kp = frame.camera(b, c);
    auto const kept = last.keypoints.slice(frame.image(b, c));
    if (i == 0) { out.keypoints[b * frame.cameras + c] = *kept.count = *kp.count; }
    bool const there = i < *kp.count;
    float const x = there ? kp.x(i) : 0.0f;
    float const y = there ? kp.y(i) : 0.0f;
    out.x[item] = x;
    out.y[item] = y;
    int const octave = there ? kp.octave(i) : 0;
    out.octave[item] = octave;
    if (there) {
      kept.octave(i) = octave;
      kept.angle(i) = kp.angle(i);
    }
    out.partner[item] = there && frame.partner != nullptr ? frame.partner[item] : -1;
    if (!Rig::rectified && c != 0) { return; }
    std::ptrdiff_t const at =
        Rig::rectified ? item : static_cast<std::ptrdiff_t>(b) * frame.capacity() + i;
    float const z = there ? depth[at] : -1.0f;
    out.depth[at] = z;
    if constexpr (Rig::rectified) {
      auto r = rig.pair(c).camera.template cast<strict_float>().unproject({x, y}).direction;
      if constexpr (is_mixed_v<Rig>) { r = {r.x / r.z, r.y / r.z, 1.0f}; }
      auto const p = rig.to_body(c, vec3<strict_float>{r.x * z, r.y * z, z});
      out.point[at] = z > 0 ? vec3<float>{p.x.value, p.y.value, p.z.value} : vec3<float>{0, 0, 0};
    } else {
      out.point[at] = z > 0 ? point[at] : vec3<float>{0, 0, 0};
    }
  }
};

/// Item: an entry of the local map of a batch entry. Writes whether a camera sees it.
struct pack_visibility {
  using scratch = no_scratch;

  /// @param seen [cameras][batch][local_points] @param count [batch] length of the local map
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

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
