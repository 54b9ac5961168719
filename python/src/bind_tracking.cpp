// SPDX-License-Identifier: Apache-2.0
#include <nanobind/stl/map.h>
#include <nanobind/stl/vector.h>

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "python/src/arrays.hpp"

namespace ftpy {

namespace {

/// Numbers of the bits that are set.
std::vector<int> bits_of(std::uint32_t set) {
  std::vector<int> all;
  for (int i = 0; i < 32; ++i) {
    if ((set >> i & 1u) != 0) { all.push_back(i); }
  }
  return all;
}

using bound_tracking = nb::class_<tracking>;

/// A member of ft::tracking as it is.
template <typename Member>
void told(bound_tracking& bound, char const* name, Member ft::tracking::*member, char const* what) {
  bound.def_prop_ro(
      name, [member](tracking const& t) { return t.of.*member; }, what);
}
/// Of ft::imu_tracking.
template <typename Member>
void told(bound_tracking& bound, char const* name, Member ft::imu_tracking::*member,
          char const* what) {
  bound.def_prop_ro(
      name, [member](tracking const& t) { return t.of.imu.*member; }, what);
}

void bind_pose(bound_tracking& bound) {
  bound.def_prop_ro(
      "T_world_camera", [](tracking const& t) { return to_numpy(from_ft(t.of.T_world_camera)); },
      "(4, 4) float64: maps points of the left camera, or of the body of a MultiRig, to the world, "
      "which is that of the first frame with a map; metres if `metric`.");
  bound.def_prop_ro(
      "T_odom_camera", [](tracking const& t) { return to_numpy(from_ft(t.of.T_odom_camera)); },
      "(4, 4) float64: the same as it was tracked, which never jumps where a loop is closed; "
      "T_world_camera is T_world_odom @ T_odom_camera, with its translation times odom_scale");
  bound.def_prop_ro(
      "T_world_odom", [](tracking const& t) { return to_numpy(from_ft(t.of.T_world_odom)); },
      "(4, 4) float64: what loops have corrected so far");
  told(bound, "odom_scale", &ft::tracking::odom_scale,
       "with loops and one camera without an IMU, whose unit of length drifts: how many units of "
       "the world one of the odometry's is, which T_odom_camera's position is multiplied by first; "
       "else 1");
  told(bound, "loops_closed", &ft::tracking::loops_closed,
       "loops whose correction enters with this frame");
  bound.def_prop_ro(
      "state", [](tracking const& t) { return ft::name_of(t.of.state); },
      "initialising, tracking, recovering or lost");
  bound.def_prop_ro("tracked",
                    [](tracking const& t) { return t.of.state == ft::tracking_state::tracking; });
  bound.def_prop_ro(
      "reason", [](tracking const& t) { return reason_of(t); },
      "why the frame is not tracked, or its pose to be doubted, a word such as 'dark' or "
      "'few_matches', see ft::tracking_reason; empty without a reason");
  bound.def_prop_ro(
      "explanation",
      [](tracking const& t) {
        return t.why.reason == ft::tracking_reason::none ? std::string() : t.why.text;
      },
      "the same as a sentence that has the numbers");
  bound.def_prop_ro(
      "missing_images", [](tracking const& t) { return bits_of(t.of.missing_images); },
      "images of a MultiRig that were None in this frame: 2 c is that of camera c, 2 c + 1 the "
      "right one of its rectified pair");
  bound.def_prop_ro(
      "missing_depths", [](tracking const& t) { return bits_of(t.of.missing_depths); },
      "cameras of a MultiRig whose depth image was None in this frame");
  told(bound, "map_id", &ft::tracking::map_id,
       "number of the map that the pose is in, from 1 on; 0 without a map");
  told(bound, "map_begun", &ft::tracking::map_begun,
       "whether the frame begins a map; if `maps` is above 1, at a guessed place");
  bound.def_prop_ro(
      "warnings",
      [](tracking const& t) {
        nb::dict all;
        for (auto const& said : t.warnings) {
          all[ft::name_of(said.warning)] = nb::str(said.text.c_str());
        }
        return all;
      },
      "dict: what is to be told of the frame although it may be tracked, a sentence by name such "
      "as 'two_motions' or 'doubtful_pose', see ft::tracking_warning; empty without");
}

void bind_counts(bound_tracking& bound) {
  told(bound, "metric", &ft::tracking::metric,
       "whether lengths are metres; False with one camera alone, whose unit is the median depth of "
       "the first points");
  told(bound, "keyframe", &ft::tracking::keyframe, "whether the frame became a keyframe");
  told(bound, "inliers", &ft::tracking::inliers, "keypoints that agree with the pose");
  told(bound, "keypoints", &ft::tracking::keypoints, "of the left images");
  told(bound, "stereo_points", &ft::tracking::stereo_points, "of these, with a depth");
  told(bound, "local_points", &ft::tracking::local_points, "map points that were searched");
  told(bound, "left_out", &ft::tracking::left_out,
       "map points for which there was no room; those of a keyframe come with the next frame");
  told(bound, "map_points", &ft::tracking::map_points,
       "in the map before the frame's own keyframe");
  told(bound, "maps", &ft::tracking::maps, "begun so far");
  told(bound, "keyframes", &ft::tracking::keyframes, "made so far");
  bound.def_prop_ro(
      "covariance",
      [](tracking const& t) {
        return to_numpy(std::vector<double>(t.of.covariance, t.of.covariance + 36), {6, 6});
      },
      "(6, 6) float64 of a small rotation, then translation, in the camera's frame: rad, m");
}

void bind_imu(bound_tracking& bound) {
  told(bound, "imu_known", &ft::imu_tracking::known, "gravity, velocity and biases are known");
  bound.def_prop_ro(
      "imu_state",
      [](tracking const& t) { return std::string(t.imu ? ft::name_of(t.imu->state) : ""); },
      "initialising (imu_known is False), known (the pose was not optimised with the IMU) or used "
      "(it was); empty without an IMU");
  bound.def_prop_ro(
      "imu_reason",
      [](tracking const& t) {
        bool const none = !t.imu || t.imu->state == ft::imu_state::used;
        return std::string(none ? "" : t.imu->reason);
      },
      "why the IMU is not used: imu_samples if they are not usable, else imu_estimate, or "
      "'no_pose'; empty if it is used");
  bound.def_prop_ro(
      "imu_explanation", [](tracking const& t) { return t.imu ? t.imu->text : std::string(); },
      "the same as a sentence");
  bound.def_prop_ro(
      "imu_estimate", [](tracking const& t) { return std::string(ft::name_of(t.of.imu.estimate)); },
      "what the last estimate of gravity, velocity and biases came to, a word such as "
      "'few_keyframes' or 'little_motion', see ft::initialization_status");
  bound.def_prop_ro(
      "imu_samples", [](tracking const& t) { return std::string(ft::name_of(t.of.imu.samples)); },
      "what the samples since the last frame are, a word such as 'integrated', 'no_samples' or "
      "'contradicted', see ft::integration_status");
  told(bound, "imu_unused_s", &ft::imu_tracking::unused_s,
       "time of tracking in which the samples could have been used and were not, less that in "
       "which they were since, seconds; 0 without an IMU");
  told(bound, "imu_optimized", &ft::imu_tracking::optimized, "the pose was optimised with the IMU");
  told(bound, "imu_predicted", &ft::imu_tracking::predicted,
       "the pose was predicted with the IMU, not by predict()");
  told(bound, "imu_rate_hz", &ft::imu_tracking::rate_hz,
       "at which the last samples came, by their times; 0 = unknown");
  told(bound, "imu_newest_s", &ft::imu_tracking::newest_s,
       "time of the newest sample since the frame's, seconds; 0 = there is none");
  told(bound, "imu_time_offset_s", &ft::imu_tracking::time_offset_s,
       "by which the IMU's clock is taken to be ahead of that of the images, seconds: "
       "Imu.time_offset_s, or what was found");
  bound.def_prop_ro(
      "imu_clock",
      [](tracking const& t) -> nb::object {
        ft::imu_clock_offset const& clock = t.of.imu.clock;
        if (!clock.known) { return nb::none(); }
        return nb::make_tuple(clock.offset_s, clock.sigma_s);
      },
      "(offset, standard deviation) of the IMU's clock as found by how camera and IMU turn, "
      "seconds; None while that tells it not within a millisecond");
  bound.def_prop_ro(
      "imu_turn_in_use", [](tracking const& t) { return to_numpy(t.of.imu.turn); },
      "(3,) in use: rotation vector by which samples are turned before they are used, from the "
      "IMU's frame as they come to that which T_bc says, rad; zeros until a turn was found, "
      "without an IMU, and of one camera");
  bound.def_prop_ro(
      "imu_misalignment",
      [](tracking const& t) -> nb::object {
        ft::imu_misalignment const& off = t.of.imu.misalignment;
        if (!off.known) { return nb::none(); }
        return nb::make_tuple(to_numpy(std::vector<double>{off.turn.x, off.turn.y, off.turn.z}),
                              off.sigma);
      },
      "(rotation vector, standard deviation) by which the IMU is turned from where T_bc says, as "
      "imu_turn_in_use, found by how camera and IMU turn, rad; None while that does not tell it "
      "within 0.1 degree");
  bound.def_prop_ro(
      "imu_left_out",
      [](tracking const& t) {
        auto const& n = t.of.imu.left_out;
        return std::map<std::string, long long>{{"disordered", n.disordered},
                                                {"out_of_range", n.out_of_range},
                                                {"crowded_out", n.crowded_out},
                                                {"frozen", n.frozen},
                                                {"spikes", n.spikes}};
      },
      "dict: samples that were left out so far, by 'disordered' (a time that is not after that of "
      "the sample before), 'out_of_range' (not finite, or at the sensor's range), 'crowded_out' "
      "(too many waited for their frame), 'frozen' (the one before to the bit, from a sensor that "
      "has shown noise), 'spikes' (single rates of turning that no body has)");
  bound.def_ro(
      "imu_warnings", &tracking::imu_warnings,
      "list of str: what is likely wrong with the samples of the IMU, a sentence each: left out, "
      "at another rate than Imu.rate_hz, contradicted by the images, on another clock");
  bound.def_prop_ro(
      "velocity", [](tracking const& t) { return to_numpy(t.of.imu.velocity); },
      "(3,) of the IMU in the world, m/s");
  bound.def_prop_ro(
      "gravity", [](tracking const& t) { return to_numpy(t.of.imu.gravity); },
      "(3,) in the world, m/s^2");
  bound.def_prop_ro(
      "gyro_bias", [](tracking const& t) { return to_numpy(t.of.imu.bias.gyro.cast<double>()); },
      "(3,) rad/s");
  bound.def_prop_ro(
      "accel_bias", [](tracking const& t) { return to_numpy(t.of.imu.bias.accel.cast<double>()); },
      "(3,) m/s^2");
}

}  // namespace

void bind_tracking(nb::module_& m) {
  bound_tracking bound(m, "Tracking", "What is known about a camera after a frame.");
  bind_pose(bound);
  bind_counts(bound);
  bind_imu(bound);
  bound.def("__repr__", [](tracking const& t) {
    ft::vec3<double> const& at = t.of.T_world_camera.t;
    std::string const reason = reason_of(t);
    std::string const why = reason.empty() ? "" : " (" + reason + ")";
    return std::string("<ft.Tracking ") + ft::name_of(t.of.state) + why + ", " +
           std::to_string(t.of.inliers) + " inliers, at " + std::to_string(at.x) + " " +
           std::to_string(at.y) + " " + std::to_string(at.z) + (t.of.metric ? " m>" : ">");
  });
}

}  // namespace ftpy
