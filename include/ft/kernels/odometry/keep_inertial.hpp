// SPDX-License-Identifier: Apache-2.0
/// @file Stages: the end of a frame of an odometry with an IMU, and the estimation of gravity and
/// biases from its keyframes.
#pragma once

#include <cstddef>

#include "ft/containers/inertial.hpp"
#include "ft/containers/keyframes.hpp"
#include "ft/containers/window_problem.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/inertial/initialization.hpp"
#include "ft/kernels/inertial/initialize.hpp"
#include "ft/kernels/inertial/join_windows.hpp"
#include "ft/kernels/inertial/predict.hpp"
#include "ft/kernels/inertial/stored_state.hpp"
#include "ft/kernels/map/gather_window.hpp"
#include "ft/kernels/odometry/begin_inertial.hpp"
#include "ft/kernels/odometry/inertial_track.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// Estimations of gravity and biases from the keyframes of adjustments. Executor memory.
struct inertial_windows {
  int views = 0;                       ///< keyframes at most: those of an adjustment, and earlier
                                       ///< ones where the unit of their poses is unknown
  rigid<double>* T_wc = nullptr;       ///< [batch][views] of these poses the last are adjusted
  preintegrated* integrals = nullptr;  ///< [batch][views] from each keyframe to the next one
  int* counts = nullptr;               ///< [batch] keyframes; 0 = nothing is estimated
  int* from = nullptr;                 ///< [batch] the first after which no integral is missing
  int* seeks_scale = nullptr;          ///< [batch] 1 = the unit of the poses is unknown
  int* newest = nullptr;               ///< [batch] number of the last of them
  joined_windows* joined = nullptr;    ///< [batch] windows of the map, in metres
  inertial_initialization* results = nullptr;  ///< [batch]
  int* usable = nullptr;                       ///< [batch] 1 = the result is to be taken over
};

inline void carve(carver& c, inertial_windows& v, int views, int batch) {
  v.views = views;
  c.place({batch, views}, v.T_wc, v.integrals);
  c.place({batch}, v.counts, v.from, v.seeks_scale, v.newest, v.joined, v.results, v.usable);
}

/// How estimates are made.
struct inertial_estimation {
  imu_mount mount;
  initialization_params metric;    ///< of maps in metres
  initialization_params unscaled;  ///< of those whose unit is unknown
  initialization_params joined;    ///< `metric` without_bias_prior()
};

namespace detail {

/// Share of the weights of earlier estimates that remains with a new one.
inline constexpr float inertial_memory = 0.98f;

/// Item: a camera whose frame is judged. Keeps its state, and tells it.
struct keep_inertial_state {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, odometry_state_view const& state,
                                 inertial_view const& v, inertial_track* out) const {
    if (g.rank() == 0) { keep(b, state, v); }
    g.sync();
    copy_object(g, out[b], v.tracks[b]);
  }

private:
  FT_HOST_DEVICE static void keep(int b, odometry_state_view const& state, inertial_view const& v) {
    inertial_track& t = v.tracks[b];
    camera_track const& track = state.tracks[b];
    keyframe_order const order = state.order[b];
    bool const tracked =
        track.has_map() && track.lost_frames == 0 && order != keyframe_order::begin_map;
    bool const optimized = tracked && t.optimized != 0;
    t.begins = v.seeks_scale && track.maps != t.map ? 1 : 0;
    if (t.begins != 0) { forget_map(t, track.maps); }
    if (optimized) {
      t.last = v.poses.result[b].stored;
      t.moves = 1;
    } else {
      if (t.source == inertial_source::none) {
        t.moves = 0;
      } else {
        t.last = t.predicted;
        t.moves = 1;
      }
      t.last = at_pose(t.last, state.T_cw[b]);
    }
    t.follows = optimized ? 1 : 0;
    if (order == keyframe_order::none) { return; }
    t.keyframe = t.last;
    t.keyframe_moves = t.moves;
    t.keyframe_rate = t.rate;
    t.restarts = 1;
  }
  /// A new map has a unit of its own: of what was known the biases are left, to integrate with.
  FT_HOST_DEVICE static void forget_map(inertial_track& t, int map) {
    inertial_track const old = t;
    t = inertial_track::initial();
    t.last.bias = t.keyframe.bias = old.last.bias;
    t.restarts = old.restarts;
    t.status = old.status;
    t.seen = old.seen;
    t.sees = old.sees;
    t.gyro_agrees = old.gyro_agrees;
    t.stale = old.stale;
    t.rate = old.rate;
    t.clock_sigma = old.clock_sigma;
    t.map = map;
    t.begins = 1;
  }
};

/// Item: a camera whose keyframe has entered the map. Keeps its integral, and where a map begins.
struct keep_inertial_keyframe {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, odometry_state_view const& state,
                                 keyframes_view const& keyframes, inertial_view const& v) const {
    inertial_track& t = v.tracks[b];
    if (t.begins != 0 && keyframes.count[b] > 0 && g.rank() == 0) {
      int const first = keyframes.position(keyframes.oldest(b));
      t.origin = keyframes.T_cw[keyframes.at(b, first)]
                     .template cast<strict_double>()
                     .centre()
                     .template cast<double>();
    }
    keyframe_order const order = state.order[b];
    if (order == keyframe_order::none) { return; }
    auto const at = v.at(b, keyframes.position(keyframes.made[b]));
    copy_object(g, v.between[at], v.from_keyframe(b));
    g.sync();
    if (g.rank() != 0) { return; }
    if (t.begins != 0 || order == keyframe_order::begin_map) {
      v.between[at].status = integration_status::no_samples;
    }
    v.motion[at] = {t.last.v, t.moves, t.weak, t.rate};
  }
};

/// Item: a camera. Gathers the integrals between the keyframes of its adjustment.
struct gather_integrals {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, int const* flags,
                                 keyframes_view const& keyframes,
                                 window_problem_view const& problem,
                                 window_sources_view const& sources, inertial_view const& v,
                                 inertial_windows const& out) const {
    if (flags[b] == 0) { return; }
    int const views = problem.view_count[b];
    bool const seeks_scale = v.seeks_scale && v.tracks[b].metric == 0;
    int const first_number = sources.keyframe[problem.view(b, 0)];
    int const before = min_of(first_number - keyframes.oldest(b), out.views - views);
    int const earlier = seeks_scale ? before : 0;
    int const count = earlier + views;
    auto const first = static_cast<std::ptrdiff_t>(b) * out.views;
    auto const at = [&](int k) {
      return keyframes.at(b, keyframes.position(first_number - earlier + k));
    };
    for (int k = g.rank(); k < earlier; k += g.size()) {
      out.T_wc[first + k] =
          keyframes.T_cw[at(k)].template cast<strict_double>().inverse().template cast<double>();
    }
    for (int k = 1 + g.part_index(); k < count; k += g.parts()) {
      copy_object(g.part(), out.integrals[first + k - 1], v.between[at(k)]);
    }
    // Keyframes before an interval without an integral say nothing of those after it.
    int from = 0;
    for (int k = 1 + g.rank(); k < count; k += g.size()) {
      if (!usable(v.between[at(k)].status)) { from = max_of(from, k); }
    }
    from = g.reduce(from, max_op{});
    int weak = 0;
    for (int k = from + 1 + g.rank(); k < count; k += g.size()) { weak += v.motion[at(k)].weak; }
    weak = g.reduce(weak, sum_op{});
    if (g.rank() == 0) {
      // Keyframes with few inliers stand where the IMU has led: they say nothing new about it.
      out.counts[b] = weak > 0 && v.tracks[b].known() ? 0 : count;
      out.from[b] = from;
      out.seeks_scale[b] = seeks_scale ? 1 : 0;
      out.newest[b] = sources.keyframe[problem.view(b, views - 1)];
      // A new map, or a camera that was reset.
      if (v.tracks[b].estimates == 0) { out.joined[b] = joined_windows::none(); }
    }
  }
};

/// Item: a camera. Estimates its gravity and biases.
struct estimate_window {
  using scratch = initialization_scratch;
  inertial_estimation how;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, int const* selected,
                                 window_problem_view const& problem,
                                 inertial_windows const& v) const {
    if (selected[b] == 0) { return; }
    if (v.counts[b] == 0) {
      if (g.rank() == 0) { v.usable[b] = 0; }
      return;
    }
    auto const first = static_cast<std::ptrdiff_t>(b) * v.views;
    int const views = problem.view_count[b];
    int const earlier = v.counts[b] - views;
    for (int k = g.rank(); k < views; k += g.size()) {
      v.T_wc[first + earlier + k] =
          problem.T_cw[problem.view(b, k)].template cast<strict_double>().inverse().cast<double>();
    }
    g.sync();
    int const from = v.from[b];
    initialization_window const window{v.T_wc + first + from, v.integrals + first + from,
                                       v.counts[b] - from, how.mount};
    bool const known = estimate(g, s, b, window, v, v.results[b]);
    if (g.rank() == 0) { v.usable[b] = known ? 1 : 0; }
  }

private:
  template <typename Group>
  FT_HOST_DEVICE bool estimate(Group g, scratch& s, int b, initialization_window const& window,
                               inertial_windows const& v, inertial_initialization& found) const {
    bool const seeks_scale = v.seeks_scale[b] != 0;
    // One call, so that it is inlined, and these are registers.
    initialization_params const params = seeks_scale ? how.unscaled : how.metric;
    initialize_window_by(g, s, window, params, nullptr, found);
    if (seeks_scale) { return found.succeeded(); }
    // An uncertain window has a small weight. Alone it is none.
    bool const uncertain = found.status == initialization_status::little_motion &&
                           found.tilt_sigma > 0 && v.joined[b].count > 0;
    if (!found.succeeded() && !uncertain) { return false; }
    bool const joined =
        join_window_by(g, s, window, how.metric, how.joined, inertial_memory, v.joined[b], found);
    return joined || found.succeeded();
  }
};

/// Item: a camera whose adjustment ends with this frame. Takes its estimate over.
struct apply_inertial_estimate {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int b, int const* flags,
                                 keyframes_view const& keyframes, inertial_windows const& windows,
                                 inertial_view const& v) const {
    inertial_initialization const& found = windows.results[b];
    inertial_track& t = v.tracks[b];
    v.scaling[b] = {1, t.origin};
    bool const stale = flags[b] != 0 && t.stale != 0;
    if (stale) { t.stale = 0; }
    if (stale || flags[b] == 0) { return; }
    if (windows.counts[b] != 0) { t.estimate = found.status; }
    if (windows.usable[b] == 0) { return; }
    if (windows.seeks_scale[b] != 0) {
      v.scaling[b].factor = found.scale;
      t.metric = 1;
    }
    ++t.estimates;
    t.gravity = found.gravity.template cast<float>();
    t.bias.accel = found.newest.ba.template cast<float>();
    mix(t.bias.gyro, t.gyro_weight, found.newest.bg, found.gyro_bias_sigma);
    if (!found.succeeded()) { return; }  // uncertain
    t.keyframe.bias = t.last.bias = t.bias;
    if (!find_velocity(b, found, t, keyframes, windows.newest[b], v)) { return; }
    t.keyframe_moves = 1;
    keyframe_motion& newest = v.motion[v.at(b, keyframes.position(keyframes.made[b]))];
    newest.v = t.keyframe.v;
    newest.moves = 1;
  }

private:
  /// Adds an estimate to a weighted mean.
  FT_HOST_DEVICE void mix(vec3<float>& value, float& weight, vec3<double> const& found,
                          float sigma) const {
    using real = strict_float;
    real const own = real(1.0f) / (real(sigma) * real(sigma) + real(1e-12f));
    if (!scalar::is_finite(own)) { return; }
    real const all = real(inertial_memory) * real(weight) + own;
    vec3<real> const old = value.cast<real>();
    vec3<real> const now{static_cast<float>(found.x), static_cast<float>(found.y),
                         static_cast<float>(found.z)};
    value = (old + scaled(now - old, own / all)).template cast<float>();
    weight = all.value;
  }
  /// The velocity at the newest keyframe, which may have been made since the adjustment began.
  /// @return false where an integral since then is missing
  FT_HOST_DEVICE static bool find_velocity(int b, inertial_initialization const& found,
                                           inertial_track& t, keyframes_view const& keyframes,
                                           int number, inertial_view const& v) {
    inertial_state<float> now{found.newest.R.cast<float>(), found.newest.p.cast<float>(),
                              found.newest.v.cast<float>(), t.bias.gyro, t.bias.accel};
    for (int k = number + 1; k <= keyframes.made[b]; ++k) {
      preintegrated const& link = v.between[v.at(b, keyframes.position(k))];
      if (!usable(link.status)) { return false; }
      now = predict_state(now, link, t.gravity);
    }
    t.keyframe.v = now.v;
    return true;
  }
};

}  // namespace detail

/// Keeps the states of all cameras after a frame is judged. Asynchronous on `exec`; allocates
/// nothing; one launch.
/// @param out [batch] host memory that the executor's threads can write: the states
template <typename Exec>
void keep_inertial_states(Exec const& exec, odometry_state_view const& state,
                          inertial_view const& v, inertial_track* out) {
  for_each_item<per_warp>(exec, v.batch, detail::keep_inertial_state{}, state, v, out);
}

/// Keeps the integrals of new keyframes, which are in the map, after keep_inertial_states().
/// Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec>
void keep_inertial_keyframes(Exec const& exec, odometry_state_view const& state,
                             keyframes_view const& keyframes, inertial_view const& v) {
  for_each_item<per_warp>(exec, v.batch, detail::keep_inertial_keyframe{}, state, keyframes, v);
}

/// Gathers the integrals between the keyframes of adjustments that begin, after gather_window().
/// Asynchronous on `exec`; allocates nothing; one launch.
/// @param flags [batch] 1 = gather
template <typename Exec>
void gather_inertial_windows(Exec const& exec, int const* flags, keyframes_view const& keyframes,
                             window_problem_view const& problem, window_sources_view const& sources,
                             inertial_view const& v, inertial_windows const& out) {
  for_each_item<per_block<512>>(exec, v.batch, detail::gather_integrals{}, flags, keyframes,
                                problem, sources, v, out);
}

/// Estimates gravity and biases from adjusted keyframes. Asynchronous on `exec`; allocates nothing;
/// one launch.
/// @param selected [batch] cameras that are 0 are not touched
template <typename Exec>
void estimate_inertial_windows(Exec const& exec, int const* selected,
                               window_problem_view const& problem, inertial_estimation const& how,
                               inertial_windows const& v) {
  for_each_item<per_block<32>>(exec, problem.batch, detail::estimate_window{how}, selected, problem,
                               v);
}

/// Takes estimates over: gravity and the accelerometer's bias from all windows, the gyroscope's
/// bias as a mean of the latest estimates, and the velocity of the newest keyframe. The first
/// estimate for a map without a scale has one: it is in `v.scaling`, and scale_maps() has to
/// follow. Asynchronous on `exec`; allocates nothing; one launch.
/// @param flags [batch] 1 = the adjustment ends with this frame
template <typename Exec>
void apply_inertial_estimates(Exec const& exec, int const* flags, keyframes_view const& keyframes,
                              inertial_windows const& windows, inertial_view const& v) {
  for_each_item<per_thread>(exec, v.batch, detail::apply_inertial_estimate{}, flags, keyframes,
                            windows, v);
}

}  // namespace FT_ABI
}  // namespace ft
