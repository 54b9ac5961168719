// SPDX-License-Identifier: Apache-2.0
/// @file The part of an odometry that tracks with IMUs.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

#include "ft/containers/inertial.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/inertial/optimize_inertial_pose.hpp"
#include "ft/kernels/inertial/preintegrate.hpp"
#include "ft/kernels/inertial/select_samples.hpp"
#include "ft/kernels/inertial/stored_state.hpp"
#include "ft/kernels/odometry/begin_inertial.hpp"
#include "ft/kernels/odometry/inertial_track.hpp"
#include "ft/kernels/odometry/keep_inertial.hpp"
#include "ft/kernels/odometry/link_window.hpp"
#include "ft/kernels/odometry/scale_map.hpp"
#include "ft/kernels/odometry/take_inertial.hpp"
#include "ft/math/so3.hpp"
#include "ft/pipelines/detail/odometry_memory.hpp"
#include "ft/pipelines/detail/odometry_part.hpp"
#include "ft/pipelines/detail/odometry_stages.hpp"
#include "ft/pipelines/detail/sample_queue.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// What a caller is told of an IMU.
inline imu_tracking imu_tracking_of(inertial_track const& t) {
  imu_tracking out;
  out.samples = t.status;
  out.known = t.known();
  out.estimate = t.estimate;
  if (!out.known) { return out; }
  auto const widen = [](vec3<float> v) {
    return vec3<double>{static_cast<double>(v.x), static_cast<double>(v.y),
                        static_cast<double>(v.z)};
  };
  out.predicted = t.source != inertial_source::none && t.given == 0;
  out.optimized = t.follows != 0;
  out.velocity = widen(t.last.v);
  out.gravity = widen(t.gravity);
  out.bias = t.last.bias;
  return out;
}

/// Memory and stages.
template <typename Exec, typename Rig>
class odometry_inertial final : public odometry_part<Exec, Rig> {
public:
  using stages_type = odometry_stages<Exec, Rig>;

  allocated_bytes bytes() const override { return {memory_.bytes(), staging_memory_.bytes()}; }

  /// Waits. @param s with all memory @throws bad_argument, std::bad_alloc, cuda_error
  odometry_inertial(Exec const& exec, stages_type const& s) {
    take(s.settings, stages_type::starts_from_motion, s.memory.observations.capacity, s.batch);
    initialize(exec);
    exec.wait();
  }

  /// Forgets what is known about the IMU of camera pair b. Waits. @param last of its map, whose
  /// number is 1
  void forget(Exec const& exec, int b, tracking& last) override {
    queue(b).clear();
    outputs_[b] = inertial_track::initial();
    if (view_.seeks_scale && last.metric) { outputs_[b].metric = outputs_[b].map = 1; }
    copy(exec, view_.tracks + b, static_cast<inertial_track const*>(outputs_ + b), std::size_t{1});
    fill_bytes(exec, view_.prior + b, 0, sizeof(inertial_prior));
    // No interval before has an integral.
    auto const n = static_cast<std::size_t>(view_.positions);
    fill_bytes(exec, view_.between + static_cast<std::size_t>(b) * n, 0xff,
               n * sizeof(preintegrated));
    exec.wait();
  }
  void reset(int b) override { queue(b).clear(); }
  sample_queue* samples(int b) override { return &queue(b); }
  /// Its samples and times.
  void before_frame(int b, bool begun, std::int64_t from_ns, std::int64_t to_ns) override {
    auto const i = static_cast<std::size_t>(b);
    if (!begun) {
      base_ns_[i] = from_ns = to_ns;
      offset_ns_[i] = nanoseconds(params_.time_offset_s);
      turn_[i] = {};
      queue(b).use(offset_ns_[i], turn_[i].R);
      seen_map_[i] = 0;
    }
    auto const seconds = [&](std::int64_t t) {
      return static_cast<double>(saturated_difference(t, base_ns_[i])) * 1e-9;
    };
    imu_sample* const to = samples_ + i * static_cast<std::size_t>(params_.samples);
    auto const early_ns = static_cast<std::int64_t>(params_.selection.early_s * 1e9);
    imu_clock_offset const clock = queue(b).clock();
    bool anew = correct_clock(b, clock);
    anew = correct_rotation(b) || anew;
    if (anew) { queue(b).use(offset_ns_[i], turn_[i].R); }
    auto const on_its_clock = [&](std::int64_t t) {
      return saturated_difference(t, -offset_ns_[i]);
    };
    int const n = queue(b).take(
        on_its_clock(base_ns_[i]), on_its_clock(saturated_difference(to_ns, early_ns)),
        turn_[i].made ? &turn_[i].of_samples : nullptr, params_.samples, to);
    inputs_[b] = {seconds(from_ns), seconds(to_ns), min_of(n, params_.samples), anew ? 1 : 0,
                  clock_sigma(b, clock)};
  }
  void after_frame(Exec const&, stages_type const& s) override {
    for (int b = 0; b < batch_; ++b) {
      looked_up_[static_cast<std::size_t>(b)] = s.own.inputs[b].looked_up;
    }
  }
  void describe(int b, std::int64_t time_ns, tracking& of) override {
    auto const i = static_cast<std::size_t>(b);
    // The pose of one that was looked up came after what is known of its attitude.
    bool const told = of.state == tracking_state::tracking && looked_up_[i] == 0;
    int const map = told ? of.maps : 0;
    imu_tracking& out = of.imu;
    of.metric = of.metric || outputs_[b].metric != 0;
    out = imu_tracking_of(outputs_[b]);
    if (params_.estimate_time_offset || params_.estimate_rotation) {
      add_attitude(b, map, time_ns);
    }
    queue(b).describe(saturated_difference(time_ns, -offset_ns_[i]), out);
    if (params_.estimate_rotation) { out.misalignment = queue(b).misalignment(); }
    out.turn = turn_[i].vector;
    out.time_offset_s = static_cast<double>(offset_ns_[i]) * 1e-9;
  }

  // ---- stages, in order

  bool launches() const override { return true; }
  /// Before an adjustment is applied, which changes the biases.
  void after_inputs(Exec const& exec, stages_type const& s) const override {
    begin_inertial_frames(exec, s.own.inputs, inputs_, samples_, view_);
  }
  /// Integrates samples.
  void beside_adjusted_map(Exec const& exec, stages_type const&) const override {
    select_samples(exec, view_.samples, view_.intervals, params_.selection, view_.steps);
    preintegrate(exec, view_.steps, {view_.starts, 2 * batch_}, variances_, view_.integrals);
  }
  void after_adjusted_map(Exec const& exec, stages_type const& s) const override {
    auto const& own = s.own;
    apply_inertial_estimates(exec, own.state.apply, own.map.keyframes, windows_, view_);
    if (view_.seeks_scale) {
      scale_maps(exec, view_.scaling, own.map, own.state, own.sources.correction, own.patches);
    }
  }
  void after_prediction(Exec const& exec, stages_type const& s) const override {
    predict_inertial_frames(exec, {s.own.inputs, mount_, s.own.map.keyframes}, s.own.state,
                            s.predictions(), view_);
  }
  /// The pose again, with the IMU.
  void after_pose(Exec const& exec, stages_type const& s) const override {
    auto const& seen = s.memory.observations;
    inertial_pose_params how;
    how.step_tolerance = 1e-4;              // the next step would be a hundredth of it or less
    how.first_round = inertial_rounds - 1;  // the pose without the IMU has found outliers
    how.outliers_given = true;
    how.marginalizes = false;
    optimize_inertial_poses(exec, s.rig, mount_, problems(s), how);
    take_inertial_poses(
        exec, {seen, s.own.state, s.memory.frame, s.own.information, s.memory.poses, s.own.changes},
        view_);
  }
  /// Marginalises: needed by the next frame alone.
  void beside_decision(Exec const& exec, stages_type const& s) const override {
    marginalize_inertial_poses(exec, s.rig, mount_, problems(s));
  }
  void before_outputs(Exec const& exec, stages_type const& s) const override {
    keep_inertial_states(exec, s.own.state, view_, outputs_);
  }
  bool tells_with_outputs() const override { return true; }
  void beside_window(Exec const& exec, stages_type const& s) const override {
    keep_inertial_keyframes(exec, s.own.state, s.own.map.keyframes, view_);
  }
  void beside_result(Exec const& exec, stages_type const& s) const override {
    auto const& own = s.own;
    gather_inertial_windows(exec, own.state.gather, own.map.keyframes, own.window, own.sources,
                            view_, windows_);
    link_windows(exec, own.state.gather, own.map.keyframes, {mount_, {}}, own.window, own.sources,
                 view_);
  }
  /// Estimates biases, gravity and velocities.
  void after_adjustment(Exec const& exec, int const* selected,
                        window_problem_view const& problem) const override {
    inertial_estimation how{mount_, params_.initialization, params_.initialization, {}};
    how.metric.known_scale = true;
    how.joined = without_bias_prior(how.metric);
    how.unscaled.known_scale = false;
    how.unscaled.position_sigma = params_.scale_position_sigma;
    how.unscaled.max_scale_sigma = params_.scale_sigma;
    estimate_inertial_windows(exec, selected, problem, how, windows_);
  }

private:
  /// @param observations of a frame @param seeks_scale whether maps begin without a scale
  void take(odometry_params const& p, bool seeks_scale, int observations, int batch) {
    imu_params const& params = params_ = p.imu;
    require(params.initialization.known_scale || seeks_scale,
            "the scale of this odometry's map is known");
    view_.seeks_scale = seeks_scale;
    view_.accel_sigma = params.accel_sigma;
    if (!(params_.selection.rate_hz > 0)) { params_.selection.rate_hz = params.noise.rate_hz; }
    view_.mount = mount_ = mount_of(params.T_bc);
    variances_ = variances_of(params.noise);
    batch_ = batch;
    views_ = p.window.moving + p.window.fixed;
    if (seeks_scale) { views_ = max_of(views_, params.scale_keyframes); }
    memory_ = arena<Exec::space>([&](carver& c) {
      carve(c, view_, {p.keyframes, params.samples, observations}, batch);
      carve(c, windows_, views_, batch);
    });
    auto const b = static_cast<std::size_t>(batch);
    staging_memory_ = arena<staging>([&](carver& c) {
      inputs_ = c.take<inertial_input>(b);
      outputs_ = c.take<inertial_track>(b);
      samples_ = c.take<imu_sample>(b * static_cast<std::size_t>(params.samples));
    });
    std::memset(staging_memory_.data(), 0, staging_memory_.bytes());
    queues_ = std::make_unique<sample_queue[]>(b);
    for (int i = 0; i < batch; ++i) { queue(i).set_limits(params); }
    base_ns_.assign(b, 0);
    offset_ns_.assign(b, nanoseconds(params.time_offset_s));
    turn_.assign(b, {});
    seen_map_.assign(b, 0);
    looked_up_.assign(b, 0);
  }
  void initialize(Exec const& exec) {
    fill_bytes(exec, memory_.data(), 0, memory_.bytes());
    for (int b = 0; b < batch_; ++b) { outputs_[b] = inertial_track::initial(); }
    fill_bytes(exec, view_.between, 0xff,
               static_cast<std::size_t>(batch_ * view_.positions) * sizeof(preintegrated));
    copy(exec, view_.tracks, static_cast<inertial_track const*>(outputs_),
         static_cast<std::size_t>(batch_));
  }

  sample_queue& queue(int b) { return queues_[static_cast<std::size_t>(b)]; }
  /// Smaller changes of the offset are not made: standard deviations, and seconds.
  static constexpr double clear_sigmas = 4, clear_change_s = 1.5e-3;
  static constexpr double clear_turn = 0.3 / 57.295779513082321;  ///< rad
  /// Larger ones are mistakes of the calibration, or of what was found: not made by guess.
  static constexpr double large_turn = 0.5;  ///< rad
  static std::int64_t nanoseconds(double s) { return std::llround(s * 1e9); }

  /// What the images alone tell of the IMU's attitude.
  void add_attitude(int b, int maps, std::int64_t time_ns) {
    int& last = seen_map_[static_cast<std::size_t>(b)];
    mat3<strict_double> const R_wc = outputs_[b].seen.R.template cast<strict_double>().transposed();
    mat3<strict_double> const R_cb = params_.T_bc.R.template cast<strict_double>().transposed();
    if (maps > 0) { queue(b).add_attitude(time_ns, (R_wc * R_cb).cast<double>(), last == maps); }
    last = maps;
  }
  /// @return whether the offset in use has changed. That of one camera is only told: how its map
  /// has turned is too uncertain, and an IMU that begins anew knows no scale for long.
  bool correct_clock(int b, imu_clock_offset const& found) {
    if (view_.seeks_scale) { return false; }
    std::int64_t& used = offset_ns_[static_cast<std::size_t>(b)];
    double const change = std::abs(found.offset_s - static_cast<double>(used) * 1e-9);
    if (!(found.sigma_s > 0) || !(change > max_of(clear_sigmas * found.sigma_s, clear_change_s))) {
      return false;
    }
    used = nanoseconds(found.offset_s);
    return true;
  }
  /// Likewise, whether the turn of the samples has changed.
  bool correct_rotation(int b) {
    if (!params_.estimate_rotation || view_.seeks_scale) { return false; }
    imu_misalignment const found = queue(b).misalignment();
    turn_in_use& used = turn_[static_cast<std::size_t>(b)];
    strict_mat3d const R = rotation_exp(found.turn.template cast<real64>());
    double const change = chord_between(used.R.template cast<real64>(), R);
    if (!(found.sigma > 0) || !(change > max_of(clear_sigmas * found.sigma, clear_turn)) ||
        (change > large_turn && !found.known)) {
      return false;
    }
    used = {R.template cast<double>(), R.template cast<float>(), found.turn, true};
    return true;
  }
  /// Of two rotations, rad, where it is small; of larger ones the chord, up to 2 at half a turn,
  /// whose rotation vector rounding may turn round or lose.
  static double chord_between(strict_mat3d const& a, strict_mat3d const& b) {
    strict_mat3d const R = a.transposed() * b;
    return std::sqrt(std::fmax(0, 3 - (R.m[0] + R.m[4] + R.m[8]).value));
  }
  /// A given offset is exact where it is not to be estimated.
  float clock_sigma(int b, imu_clock_offset const& found) const {
    if (!params_.estimate_time_offset) { return 0; }
    double const used = static_cast<double>(offset_ns_[static_cast<std::size_t>(b)]) * 1e-9;
    return static_cast<float>(sigma_of_clock(found, used));
  }
  static constexpr memory_space staging = staging_space<Exec>;
  /// Of samples, into the IMU's frame as T_bc has it.
  struct turn_in_use {
    mat3<double> R = mat3<double>::identity();
    mat3<float> of_samples = mat3<float>::identity();
    vec3<double> vector = {0, 0, 0};
    bool made = false;
  };

  inertial_poses problems(stages_type const& s) const {
    observations_view const& seen = s.memory.observations;
    inertial_poses poses = view_.poses;
    poses.observations = seen.items;
    poses.count = seen.count;
    poses.outlier = seen.outlier;
    poses.number = seen.number;
    poses.moves = s.moves;
    poses.numbers = s.memory.frame.numbers();
    return poses;
  }

  imu_params params_;
  imu_mount mount_{};
  imu_variances variances_{};
  int batch_ = 0;
  int views_ = 0;
  inertial_view view_;
  inertial_windows windows_;
  inertial_track* outputs_ = nullptr;  ///< [batch] staging memory, which a device writes
  inertial_input* inputs_ = nullptr;   ///< [batch] staging memory, which a device reads
  imu_sample* samples_ = nullptr;      ///< [batch][samples] likewise
  arena<Exec::space> memory_;
  arena<staging> staging_memory_;
  std::unique_ptr<sample_queue[]> queues_;
  std::vector<std::int64_t> base_ns_;
  std::vector<std::int64_t> offset_ns_;  ///< of the clocks, in use
  std::vector<turn_in_use> turn_;
  std::vector<int> looked_up_;  ///< odometry_input::looked_up of the last frame
  std::vector<int> seen_map_;   ///< number of the map that the last frame was tracked in; 0 = none
};

template <typename Exec, typename Rig>
std::unique_ptr<odometry_part<Exec, Rig>> make_part(inertial const&, Exec const& exec,
                                                    odometry_stages<Exec, Rig> const& stages) {
  return std::make_unique<odometry_inertial<Exec, Rig>>(exec, stages);
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
