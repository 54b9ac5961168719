// SPDX-License-Identifier: Apache-2.0
/// @file What an odometry consists of, and how it runs a frame.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "ft/cameras/image_domain.hpp"
#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/cameras/rgbd_rig.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/recording.hpp"
#include "ft/core/stage_clock.hpp"
#include "ft/pipelines/check_params.hpp"
#include "ft/pipelines/detail/odometry_adjustment.hpp"
#include "ft/pipelines/detail/odometry_download.hpp"
#include "ft/pipelines/detail/odometry_part.hpp"
#include "ft/pipelines/detail/odometry_prefetch.hpp"
#include "ft/pipelines/detail/odometry_recovery.hpp"
#include "ft/pipelines/detail/odometry_schedule.hpp"
#include "ft/pipelines/detail/odometry_stages.hpp"
#include "ft/pipelines/tracker_types.hpp"
#include "ft/pipelines/tracking_warnings.hpp"
#include "ft/types/features.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/loops.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/orb_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// @throws bad_argument for a pose that is not finite or not a rotation
inline void require_motion(rigid<double> const& T) {
  require_rotation(T.R, "the rotation of a predicted pose");
  double const t[3] = {T.t.x, T.t.y, T.t.z};
  for (double const v : t) { require_finite("an entry of a predicted pose", v); }
}

template <typename Rig>
constexpr depth_origin depths_of(Rig const&) {
  return depth_origin::stereo;
}
template <typename Camera>
constexpr depth_origin depths_of(rgbd_rig<Camera> const&) {
  return depth_origin::depth_image;
}
template <int N, typename Camera>
constexpr depth_origin depths_of(multi_rig<N, Camera> const&) {
  return depth_origin::some_pairs;
}
template <typename Camera>
constexpr depth_origin depths_of(monocular_rig<Camera> const&) {
  return depth_origin::motion;
}

inline tracker_params tracker_params_of(odometry_params const& p) {
  tracker_params t;
  t.orb = p.orb;
  t.map_slots = p.map_slots;
  t.local_points = p.local_points;
  t.window_radius = p.window_radius;
  t.enough_matches = p.enough_matches;
  t.use_graphs = p.use_graphs;
  t.overlap[0] = p.overlap[0];
  t.overlap[1] = p.overlap[1];
  return t;
}

/// At a fixed address: recordings, the adjustments and the prefetch refer to it.
template <typename Exec, typename Rig>
struct odometry_engine {
  using stages_type = odometry_stages<Exec, Rig>;
  using parts_of_rig = rig_parts<Rig>;
  using prefetch_type = odometry_prefetch<Exec, Rig>;

  /// The launches of a frame, and their times.
  struct frame_launches {
    stage_clock<Exec> clock;
    recording<Exec> graph;
  };

  Exec exec;
  Rig rig;
  odometry_params given;  ///< the caller's; those of the stages follow from them
  stages_type stages;
  std::vector<std::array<frame_launches, 3>> launches;  ///< [set of features][extent]
  stage_clock<Exec> const* last_clock = nullptr;        ///< of the last frame
  std::vector<tracking> results;
  std::vector<std::int64_t> times;   ///< of the last frames
  std::vector<unsigned char> begun;  ///< whether there was one
  std::vector<frame_warnings> warnings;
  long long frame = 0;
  int stamp = 0;
  odometry_adjustments<Exec, Rig> adjustments;
  std::unique_ptr<prefetch_type> prefetch;  ///< or none
  work_mark<Exec> frame_end;                ///< of the last frame

  /// Which parts are named.
  struct named_parts {
    bool inertial, loops, own_features;
  };
  /// Plugs them in. A function, so that one constructor is compiled for all that a program names.
  using plug_parts = std::function<void(odometry_engine&)>;

  /// @throws bad_argument, std::bad_alloc, cuda_error
  odometry_engine(Exec const& e, Rig const& of, odometry_params const& params, int batch,
                  named_parts const& with, plug_parts const& plug_all)
      : exec(e),
        rig(checked(of, params, batch, with)),
        given(params),
        launches(static_cast<std::size_t>(params.prefetch) + 1),
        results(static_cast<std::size_t>(batch)),
        times(results.size()),
        begun(results.size()),
        warnings(results.size()),
        adjustments(prepared(params, batch, plug_all), stages.own, stages.plugged, stages.rig,
                    params) {
    if (params.measure_stages) {
      for (auto& of_set : launches) {
        for (auto& of_extent : of_set) { of_extent.clock.enable(); }
      }
    }
    if (params.prefetch > 0) { prefetch = std::make_unique<prefetch_type>(exec, rig, stages); }
    last_clock = &launches_of(frame_extent::whole).clock;
    frame_end.make();
    record();
  }
  /// How many of the parts are of that type.
  template <typename Part, typename... Plugged>
  static constexpr int count_of = (0 + ... + int{std::is_same_v<Plugged, Part>});

  /// @param plugged parts, by their public names @throws likewise
  template <typename... Plugged>
  static std::unique_ptr<odometry_engine> made(Exec const& e, Rig const& of,
                                               odometry_params const& params, int batch,
                                               Plugged const&... plugged) {
    constexpr int counts[] = {count_of<inertial, Plugged...>, count_of<places, Plugged...>,
                              count_of<loops, Plugged...>, count_of<own_features, Plugged...>};
    constexpr bool known = counts[0] + counts[1] + counts[2] + counts[3] == sizeof...(Plugged);
    static_assert(known,
                  "the last arguments of an odometry are its parts: ft::inertial, ft::places, "
                  "ft::loops or ft::own_features, and no type of yours");
    static_assert(counts[0] <= 1 && counts[1] <= 1 && counts[2] <= 1 && counts[3] <= 1,
                  "a part is plugged in once");
    if constexpr (known) {
      return std::make_unique<odometry_engine>(
          e, of, params, batch, named_parts{counts[0] > 0, counts[2] > 0, counts[3] > 0},
          [&](odometry_engine& to) { (to.plug(make_part(plugged, to.exec, to.stages)), ...); });
    } else {
      return nullptr;
    }
  }
  void plug(std::unique_ptr<odometry_part<Exec, Rig>> part) {
    if (part == nullptr) { return; }
    // An IMU is the first one: others ask what it knows.
    bool const is_first = part->samples(0) != nullptr;
    auto const at = is_first ? stages.plugged.begin() : stages.plugged.end();
    stages.plugged.insert(at, std::move(part));
  }
  /// Waits for the end of the last frame, which uses the memory and the recordings.
  ~odometry_engine() {
    try {
      frame_end.wait();
    } catch (cuda_error const&) {}  // the memory of the device is lost
  }
  odometry_engine(odometry_engine const&) = delete;
  odometry_engine& operator=(odometry_engine const&) = delete;

  /// Records the launches of frames. Not while frames are given.
  void record() {
    if (!stages.settings.use_graphs) { return; }
    frame_end.wait();
    record_extents();
    if (prefetch == nullptr) { return; }
    prefetch->for_each_set(stages, [&] { record_extents(); });
  }

  /// @throws bad_argument for a camera pair that does not exist
  void require_pair(int b) const { require_range("camera pair", b, 0, stages.batch - 1); }
  /// What has to be right before a frame changes anything.
  /// @throws bad_argument for a time that is not after the camera's last one; what parts have to
  ///   throw
  void require_later(std::int64_t const* time_ns) const {
    for (auto const& part : stages.plugged) { part->rethrow(); }
    for (int b = 0; b < stages.batch; ++b) {
      auto const i = static_cast<std::size_t>(b);
      require(
          !stages.settings.rules.localize_only || results[i].state != tracking_state::initialising,
          "rules.localize_only tracks in a loaded map: load_map() comes before a frame");
      if (begun[i] != 0 && time_ns[b] <= times[i]) {
        throw bad_argument("ft: the time of camera pair " + std::to_string(b) + " is " +
                           std::to_string(time_ns[b]) + " ns, must be after " +
                           std::to_string(times[i]));
      }
    }
  }
  /// @throws bad_argument if there are no keypoints of images
  void require_images() const {
    require(describes_images,
            "keypoints of this odometry's FT_DESCRIPTOR are the caller's: track(given_features)");
  }
  /// Takes the features of the next frame. @param features [batch]
  /// @throws bad_argument also without own_features; then no frame has changed
  void take_features(given_features const* features) {
    bool taken = false;
    for (auto const& part : stages.plugged) {
      for (int b = 0; b < stages.batch; ++b) {
        taken = part->take_features(b, features[b]) || taken;
      }
    }
    require(taken, "the odometry was made without odometry_params::own_features");
  }
  /// Runs a frame and waits for its outputs; not for its keyframe, which enters the map meanwhile,
  /// unless a part needs it. @param time_ns [batch]
  tracking const* track(std::int64_t const* time_ns, frame_extent extent) {
    set_inputs(time_ns, extent);
    adjustments.end_before(exec, frame);
    frame_launches& now = launches_of(extent);
    now.graph.replay(exec, [&](Exec const& e) { queue(e, extent); });
    frame_end.set(exec);
    last_clock = &now.clock;
    if (stages.parts_tell_with_outputs()) {
      exec.wait_until([this] { return outputs_are_complete(); });
    } else {
      exec.wait();
    }
    for (auto const& p : stages.plugged) { p->after_frame(exec, stages); }
    adjustments.begin_after(frame, frame_end);
    take_outputs(time_ns);
    ++frame;
    return results.data();
  }

private:
  bool outputs_are_complete() const {
    odometry_output const* const out = stages.own.outputs;
    return std::all_of(out, out + stages.batch, [](auto const& o) { return is_set(&o.complete); });
  }
  frame_launches& launches_of(frame_extent extent) {
    return launches[static_cast<std::size_t>(stages.features_number())]
                   [static_cast<std::size_t>(extent)];
  }
  /// All that frames with the stages' set of features may have.
  void record_extents() {
    if (describes_images) { record(frame_extent::whole); }
    if (prefetch != nullptr) { record(frame_extent::prefetched); }
    if (given.own_features) { record(frame_extent::given); }
  }
  void record(frame_extent extent) {
    launches_of(extent).graph.record(exec, [&](Exec const& to) { queue(to, extent); });
  }
  void queue(Exec const& to, frame_extent extent) {
    stage_line<Exec> line(to, launches_of(extent).clock);
    queue_odometry(line, stages, extent);
  }

  /// Takes all memory and initialises it.
  Exec const& prepared(odometry_params const& params, int batch, plug_parts const& plug_all) {
    stages.settings = params;
    if (params.imu.present) {
      stages.settings.rules.keyframe_period_s = params.imu.keyframe_period_s;
    }
    stages.settings.orb.start_features = start_features(params.orb);
    if (!(params.orb.corner_ratio > 0) && !stages_type::starts_from_motion) {
      stages.settings.orb.corner_ratio = odometry_corner_ratio;
    }
    stages.settings.orb.exact_positions = true;
    stages.settings.orb.refine_positions = parts_of_rig::refines_positions;
    stages.pose_settings.disparity_weight = parts_of_rig::disparity_weight;
    stages.prepare_features(exec, parts_of_rig::searched(rig), tracker_params_of(stages.settings),
                            batch, parts_of_rig::absent(rig));
    stages.input = typename parts_of_rig::template input<Exec>(exec, rig, stages.geometry(), batch);
    stages.matcher = parts_of_rig::make_matcher(rig, stages.extractor, stages.input);
    image_bounds const seen = parts_of_rig::bounds(rig, params.orb.width, params.orb.height);
    stages.frustum.min_x = seen.min_x;
    stages.frustum.min_y = seen.min_y;
    stages.frustum.max_x = seen.max_x;
    stages.frustum.max_y = seen.max_y;
    stages.rolling = rolling_keypoints<Exec, Rig>(rig, params.orb.height, stages.capacity(), batch);
    stages.take_all_memory(exec, params.adjustment_delay);
    stages.initialize_all(exec);
    exec.wait();
    plug_all(*this);
    return exec;
  }

  void set_inputs(std::int64_t const* time_ns, frame_extent extent) {
    if (stamp > std::numeric_limits<int>::max() - 4) {
      stages.forget_frame_numbers(exec);
      stamp = 0;
    }
    stamp += 2;  // a frame has two numbers: see search_start
    for (int b = 0; b < stages.batch; ++b) {
      stages.own.inputs[b].time_ns = time_ns[b];
      stages.own.inputs[b].stamp = stamp;
      bool const has_images = extent != frame_extent::given;
      stages.own.missing[b] = has_images ? stages.input.images().missing(b) : 0;
      stages.own.outputs[b].complete = 0;
      auto const i = static_cast<std::size_t>(b);
      for (auto const& p : stages.plugged) {
        p->before_frame(b, begun[i] != 0, times[i], time_ns[b]);
      }
    }
  }
  void take_outputs(std::int64_t const* time_ns) {
    for (int b = 0; b < stages.batch; ++b) {
      auto const i = static_cast<std::size_t>(b);
      times[i] = time_ns[b];
      bool const first = begun[i] == 0;
      begun[i] = 1;
      stages.own.inputs[b].predicted = stages.own.inputs[b].reset = 0;
      results[i] = tracking_of(stages.own.outputs[b]);
      results[i].depths = depths_of(rig);
      results[i].evidence.rectified = Rig::rectified;
      results[i].missing_images = stages.own.missing[b];
      results[i].missing_depths = missing_depths_of(stages.input, b);
      results[i].metric = !stages_type::starts_from_motion;
      results[i].T_odom_camera = results[i].T_world_camera;
      for (auto const& p : stages.plugged) { p->describe(b, time_ns[b], results[i]); }
      warnings[i].judge(results[i], time_ns[b], first, stages.settings);
    }
  }

  /// @return 0 where all images have as many features
  static int start_features(orb_params const& p) {
    if (!stages_type::starts_from_motion) { return 0; }
    return p.start_features != 0 ? p.start_features : min_of(5 * p.features, 1 << 20);
  }
  static Rig const& checked(Rig const& rig, odometry_params const& p, int batch,
                            named_parts const& with) {
    rig.check();
    require(rig.baseline_length() > 0.0f, "an odometry needs a rig with a stereo pair");
    require_range("batch of camera pairs", batch, 1, 2048);
    ft::check(p);
    require(with.inertial || !p.imu.present,
            "params.imu needs its part: odometry(exec, rig, params, batch, ft::inertial{})");
    require(!with.inertial || p.imu.present,
            "the part ft::inertial needs params.imu: its member present is false");
    require(with.loops == p.loops.present,
            "params.loops and the part ft::loops need each other: "
            "odometry(exec, rig, params, 1, ft::loops{}) with params.loops.present");
    require(with.own_features || !p.own_features,
            "params.own_features needs its part: odometry(exec, rig, params, batch, "
            "ft::own_features{})");
    require(describes_images || (p.own_features && p.prefetch == 0),
            "an odometry of another FT_DESCRIPTOR than ORB's has params.own_features and no "
            "prefetch: its keypoints are the caller's");
    require(!(p.prefetch > 0 && stages_type::starts_from_motion),
            "one camera has no prefetch: the keypoints of a frame depend on the frame before it");
    if (!stages_type::starts_from_motion) {
      require_range("orb.start_features of a rig that sees depths", p.orb.start_features, 0, 0);
    }
    require(parts_of_rig::refines_positions || !p.orb.refine_positions,
            "orb.refine_positions is true, only an odometry of camera pairs refines positions");
    return rig;
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
