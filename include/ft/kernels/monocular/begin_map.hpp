// SPDX-License-Identifier: Apache-2.0
/// @file Stages: how a map of one camera begins from a reconstruction of two of its frames.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/two_views.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/map/detail/select_new_points.hpp"
#include "ft/kernels/map/keyframe_input.hpp"
#include "ft/kernels/monocular/start_rules.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

/// The beginnings of maps. Executor memory.
struct map_beginnings {
  start_report const* report = nullptr;  ///< [batch]
  rigid<double>* T_21 = nullptr;         ///< [batch] first frame to the current one, scaled
  rigid<double>* first_T_cw = nullptr;   ///< [batch] of the first frame, if it becomes a keyframe
  std::int64_t* first_ns = nullptr;      ///< [batch] when the first frame was taken
  keyframe_order* order = nullptr;       ///< [batch] of the first frame: begin_map, or none
  int* count = nullptr;          ///< [batch] keypoints of a frame that may begin a map, else 0
  pixels_view pixels;            ///< of the frame, in a pinhole of the same focal lengths
  float* depth = nullptr;        ///< [batch][capacity] of the first frame's keypoints, -1 = none
  vec3<float>* point = nullptr;  ///< [batch][capacity] in the first camera's frame
  int* holder = nullptr;         ///< [batch][capacity] slots of the first frame's keypoints
  int patience = 0;              ///< of tracking_rules, for looks_for_start()
  int* wants_more = nullptr;     ///< [batch] written: distribution_view::wants_more of next frames
};

/// Whether a map may begin with the next frame of a camera.
FT_HOST_DEVICE inline bool looks_for_start(camera_track const& t, int patience) {
  return !t.has_map() || t.lost_with_features >= patience;
}

inline void carve(carver& c, map_beginnings& v, int capacity, int batch) {
  c.place({batch}, v.T_21, v.first_T_cw, v.first_ns, v.order, v.count);
  carve(c, v.pixels, capacity, batch);
  c.place({batch, capacity}, v.depth, v.point, v.holder);
}

namespace detail {

/// Inputs of open_beginning.
template <typename Rig>
struct beginning_input {
  Rig rig;
  frame_view frame;
  pyramid_geometry geometry;
  odometry_input const* inputs = nullptr;  ///< [batch]
  camera_track const* tracks = nullptr;    ///< [batch]
  int patience = 0;                        ///< of tracking_rules
};

/// Item: a keypoint. Its pixel in a pinhole; and which cameras look for a start.
template <typename Rig>
struct open_beginning {
  using scratch = no_scratch;

  /// @param progress [batch] that of a camera that begins anew is cleared
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, beginning_input<Rig> const& in,
                                 start_progress* progress, map_beginnings const& out) const {
    using real = strict_double;
    auto const& [rig, frame, geometry, inputs, tracks, patience] = in;
    int const b = item / frame.capacity();
    int const i = item % frame.capacity();
    keypoints_view const kp = frame.camera(b, 0);
    int const n = *kp.count;
    if (i == 0) {
      out.count[b] = looks_for_start(tracks[b], patience) ? n : 0;
      if (inputs[b].reset != 0) { progress[b] = start_progress{}; }
    }
    if (i >= n) { return; }
    int const octave = kp.octave(i);
    float const x = geometry.column(kp.x(i), octave);
    float const y = geometry.row(kp.y(i), octave);
    auto const seen = rig.camera.template cast<real>().unproject(
        {real(static_cast<double>(x)), real(static_cast<double>(y))});
    auto const d = seen.direction;
    real const u = real(static_cast<double>(rig.camera.fx)) * (d.x / d.z) +
                   real(static_cast<double>(rig.camera.cx));
    real const v = real(static_cast<double>(rig.camera.fy)) * (d.y / d.z) +
                   real(static_cast<double>(rig.camera.cy));
    bool const good =
        seen.valid && d.z > real(0) && scalar::abs(u) < real(1e5) && scalar::abs(v) < real(1e5);
    out.pixels.x(item) = good ? static_cast<float>(u.value) : x;
    out.pixels.y(item) = good ? static_cast<float>(v.value) : y;
  }
};

/// Item: a camera. Scales its reconstruction.
struct scale_beginning {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, two_view_reconstructions const& views,
                                 int const* first_count, std::int64_t const* time_ns,
                                 map_beginnings const& out) const {
    start_outcome const outcome = out.report[b].outcome;
    if (g.rank() == 0) {
      out.order[b] = keyframe_order::none;
      if (outcome == start_outcome::took_first) { out.first_ns[b] = time_ns[b]; }
    }
    if (outcome != start_outcome::started) { return; }
    auto const first = static_cast<std::ptrdiff_t>(b) * views.capacity;
    int const n = first_count[b];
    auto const bits_of = [&](int i) {
      bool const is = (views.flags[first + i] & two_view_flag::triangulated) != 0;
      return is ? depth_bits(views.point[first + i].z) : 0;
    };
    auto const up_to = [&](int limit) {
      int count = 0;
      for (int i = g.rank(); i < n; i += g.size()) {
        int const bits = bits_of(i);
        count += static_cast<int>(bits != 0 && bits <= limit);
      }
      return g.reduce(count, sum_op{});
    };
    int const half = (up_to(any_depth) + 1) / 2;
    int low = 1;
    int high = any_depth;
    while (low < high) {
      int const middle = low + (high - low) / 2;
      if (up_to(middle) >= half) {
        high = middle;
      } else {
        low = middle + 1;
      }
    }
    float median = 1;
    memcpy(&median, &low, sizeof median);
    strict_float const scale = strict_float(1.0f) / strict_float(median);
    for (int i = g.rank(); i < n; i += g.size()) {
      bool const is = bits_of(i) != 0;
      vec3<float> const p = views.point[first + i];
      out.point[first + i] = {(p.x * scale).value, (p.y * scale).value, (p.z * scale).value};
      out.depth[first + i] = is ? out.point[first + i].z : -1.0f;
      out.holder[first + i] = -1;
    }
    if (g.rank() == 0) {
      auto T = views.result[b].T_21.template cast<strict_double>().orthonormalized();
      strict_double const s = static_cast<double>(scale.value);
      T.t = {T.t.x * s, T.t.y * s, T.t.z * s};
      out.T_21[b] = T.template cast<double>();
    }
  }
};

/// Item: a keypoint of a first frame that became a keyframe. Its match holds the same point.
struct hand_over_point {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, initial_matches_view const& matches,
                                 int const* first_count, map_beginnings const& in,
                                 frame_view const& frame) const {
    int const b = item / matches.capacity;
    int const i = item % matches.capacity;
    if (in.order[b] != keyframe_order::begin_map || i >= first_count[b]) { return; }
    int const m = matches.match[item];
    if (m < 0 || in.holder[item] < 0) { return; }
    frame.holder[static_cast<std::ptrdiff_t>(b) * frame.numbers() + m] = in.holder[item];
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
