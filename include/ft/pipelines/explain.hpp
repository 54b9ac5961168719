// SPDX-License-Identifier: Apache-2.0
/// @file Why a frame was not tracked, or why its pose is to be doubted, in words; what the state of
/// its IMU is, and why.
#pragma once

#include <cstdint>
#include <cstdio>
#include <string>

#include "ft/core/config.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

enum class tracking_reason : int {
  none = 0,  ///< the frame's pose comes from the map, or the frame begins the first map
  // The frame has a pose, which is to be doubted.
  new_map,      ///< it begins a later map, at a guessed place
  imu_only,     ///< no image agrees: it is where the IMU says
  depth_scale,  ///< most depths are beyond distant_baselines: a wrong unit or baseline
  // The frame has no pose.
  not_started,          ///< no frame was given yet, or none since the map was loaded
  dark,                 ///< an image is nearly black
  bright,               ///< an image is nearly white
  low_texture,          ///< an image has hardly any contrast
  blurred,              ///< too few corners in images that have contrast
  no_depth,             ///< hardly any keypoint finds a depth in the depth image
  stereo_inconsistent,  ///< hardly any keypoint has a stereo match: images exchanged, or the
                        ///< calibration is another one's
  images_missing,       ///< cameras of a rig gave no image or no depth image, and what is there
                        ///< tells too little
  few_depths,           ///< too few keypoints have a depth to begin a map
  awaits_motion,        ///< one camera: the map begins when the camera has moved sideways
  images_repeat,        ///< images are those of the frame before while the IMU moves
  few_matches,          ///< too few keypoints agree with the map, wherever it was tried
};

/// The state as a word, such as "recovering".
inline char const* name_of(tracking_state state) {
  constexpr char const* names[] = {"initialising", "tracking", "recovering", "lost"};
  int const i = static_cast<int>(state);
  return i >= 0 && i <= static_cast<int>(tracking_state::lost) ? names[i] : "unknown";
}

/// The reason as a word, such as "stereo_inconsistent".
inline char const* name_of(tracking_reason reason) {
  constexpr char const* names[] = {"none",
                                   "new_map",
                                   "imu_only",
                                   "depth_scale",
                                   "not_started",
                                   "dark",
                                   "bright",
                                   "low_texture",
                                   "blurred",
                                   "no_depth",
                                   "stereo_inconsistent",
                                   "images_missing",
                                   "few_depths",
                                   "awaits_motion",
                                   "images_repeat",
                                   "few_matches"};
  constexpr int count = sizeof names / sizeof *names;
  static_assert(count == static_cast<int>(tracking_reason::few_matches) + 1, "one a reason");
  int const i = static_cast<int>(reason);
  return i >= 0 && i < count ? names[i] : "unknown";
}

/// A reason, and a sentence that has the numbers; no full stop at its end.
struct tracking_explanation {
  tracking_reason reason = tracking_reason::none;
  std::string text;  ///< empty for `none`
};

/// Limits of explain(). Grey values are from 0 to 255.
struct explanation_limits {
  double dark_mean = 16;
  double bright_mean = 239;
  double least_deviation = 5;       ///< of grey values
  int few_keypoints = 120;          ///< of all cameras, with less than which an image is blurred
  double least_stereo_share = 0.1;  ///< of the keypoints, with a match in the other image
};

namespace detail {

inline std::string one_decimal(double v) {
  char text[40];
  std::snprintf(text, sizeof text, "%.1f", v);
  return text;
}

/// Why the images of a frame have too few corners, or `none`.
inline tracking_explanation explain_light(tracking const& t, explanation_limits const& limits) {
  if (t.light.image < 0) { return {}; }
  std::string const image = "image " + std::to_string(t.light.image) + " is ";
  std::string const mean = "its mean grey value is " + one_decimal(t.light.mean) + " of 255";
  if (t.light.mean < limits.dark_mean) {
    return {tracking_reason::dark, image + "nearly black: " + mean};
  }
  if (t.light.mean > limits.bright_mean) {
    return {tracking_reason::bright, image + "nearly white: " + mean};
  }
  if (t.light.deviation < limits.least_deviation) {
    return {tracking_reason::low_texture, image + "almost uniform: its grey values deviate by " +
                                              one_decimal(t.light.deviation) + " from their mean"};
  }
  return {};
}

/// Which images of a rig were not given: "image 0, image 3, depth image of camera 2".
inline std::string missing_text(tracking const& t) {
  std::string all;
  auto const name = [&](std::uint32_t missing, char const* what) {
    for (int i = 0; i < 32; ++i) {
      if ((missing >> i & 1u) == 0) { continue; }
      all += (all.empty() ? "" : ", ") + (what + std::to_string(i));
    }
  };
  name(t.missing_images, "image ");
  name(t.missing_depths, "depth image of camera ");
  return all;
}

/// "12 of 800 keypoints"
inline std::string of_keypoints(int n, tracking const& t) {
  return std::to_string(n) + " of " + std::to_string(t.keypoints) + " keypoints";
}

/// Why too few keypoints have a depth.
inline tracking_explanation explain_depths(tracking const& t, tracking_rules const& rules,
                                           explanation_limits const& limits) {
  bool const hardly_any = t.stereo_points < limits.least_stereo_share * t.keypoints;
  if (hardly_any && t.depths == depth_origin::depth_image) {
    return {tracking_reason::no_depth,
            of_keypoints(t.stereo_points, t) +
                " have a depth: the depth image is empty there, or depth_scale, min_depth or "
                "max_depth are not those of the sensor"};
  }
  if (hardly_any && t.depths == depth_origin::stereo) {
    return {tracking_reason::stereo_inconsistent,
            of_keypoints(t.stereo_points, t) +
                " have a stereo match: left and right may be exchanged, or the calibration is that "
                "of other cameras"};
  }
  return {tracking_reason::few_depths, of_keypoints(t.stereo_points, t) +
                                           " have a depth; a map needs " +
                                           std::to_string(rules.min_stereo_points)};
}

/// Why one camera has no map yet.
inline tracking_explanation explain_start(tracking const& t) {
  std::string why;
  switch (t.start) {
    case start_outcome::no_motion:
      why = std::to_string(t.start_matches) +
            " keypoints match the first frame's, but their motion is not clear yet";
      break;
    case start_outcome::few_matches:
      why = "only " + std::to_string(t.start_matches) +
            " keypoints match the first frame's: the start begins again";
      break;
    case start_outcome::forgot_first:
    case start_outcome::waiting:
      why = "the frame has too few keypoints to begin with: " + std::to_string(t.keypoints);
      break;
    default:
      why = "it is the first frame of a start";
  }
  return {tracking_reason::awaits_motion,
          "one camera begins a map when it has moved sideways: " + why};
}

/// Of a frame that has a pose.
inline tracking_explanation explain_doubt(tracking const& t) {
  if (t.map_begun && t.maps > 1) {
    return {tracking_reason::new_map, "map " + std::to_string(t.maps) +
                                          " begins at a guessed place: the camera was not found in "
                                          "the one before"};
  }
  if (t.inliers == 0 && !t.map_begun && t.depths != depth_origin::motion) {
    return {tracking_reason::imu_only, "no image agrees with the map: the pose is the IMU's alone"};
  }
  if (2 * t.distant_points > t.stereo_points) {
    return {tracking_reason::depth_scale,
            std::to_string(t.distant_points) + " of " + std::to_string(t.stereo_points) +
                " depths are beyond " + std::to_string(static_cast<int>(distant_baselines)) +
                " baselines: is the unit of depths, or of the baseline, metres?"};
  }
  return {};
}

}  // namespace detail

/// Says why a frame was not tracked or, of one that was, why its pose is to be doubted. Host;
/// allocates the text. An image of a wrong size has no tracking: its track() throws.
/// @param t what track() returned @param rules those of the odometry
inline tracking_explanation explain(tracking const& t, tracking_rules const& rules = {},
                                    explanation_limits const& limits = {}) {
  if (t.state == tracking_state::tracking) { return detail::explain_doubt(t); }
  bool const without_images = t.light.image < 0;  // or keypoints of the caller
  if (without_images && t.keypoints == 0) {
    return {tracking_reason::not_started, t.state == tracking_state::initialising
                                              ? "no frame was given yet, or no keypoint"
                                              : "no frame was given since the map was loaded"};
  }
  bool const few_keypoints = t.keypoints < limits.few_keypoints;
  bool const few_depths =
      t.depths != depth_origin::motion && t.stereo_points < rules.min_stereo_points;
  if (few_keypoints || few_depths) {
    auto light = detail::explain_light(t, limits);
    if (light.reason != tracking_reason::none) { return light; }
    if ((t.missing_images | t.missing_depths) != 0) {
      return {tracking_reason::images_missing,
              "the frame came without " + detail::missing_text(t) + ": only " +
                  std::to_string(t.keypoints) + " keypoints, " + std::to_string(t.stereo_points) +
                  " with a depth"};
    }
  }
  if (few_keypoints) {
    return {tracking_reason::blurred,
            "only " + std::to_string(t.keypoints) +
                (without_images ? " keypoints were given"
                                : " keypoints: the image is blurred, shows little texture, or few "
                                  "keypoints are asked for")};
  }
  if (few_depths) { return detail::explain_depths(t, rules, limits); }
  if (t.state == tracking_state::initialising && t.depths == depth_origin::motion) {
    return detail::explain_start(t);
  }
  tracking_evidence const& e = t.evidence;
  if (e.facts.frozen != 0) {
    return {tracking_reason::images_repeat,
            std::to_string(e.same) + " of " + std::to_string(e.images) +
                " images are those of the frame before, and the IMU has moved: " +
                (t.imu.predicted ? "the pose is the IMU's alone"
                                 : "the pose is a guess, for the IMU says nothing any more")};
  }
  return {
      tracking_reason::few_matches,
      std::to_string(t.agreed) + " keypoints agree with the pose that was tried last; " +
          std::to_string(t.state == tracking_state::recovering || t.state == tracking_state::lost
                             ? rules.min_recovered
                             : rules.min_inliers) +
          " are asked for, and " + std::to_string(t.local_points) +
          " points of the map were searched"};
}

/// Whether an IMU is used. From each of them there is a way to each other one.
enum class imu_state : int {
  initialising,  ///< gravity, velocity and biases are not known
  known,         ///< they are; the frame's pose was not optimised with the IMU
  used,          ///< the frame's pose was optimised with it
};

/// The state as a word.
inline char const* name_of(imu_state state) {
  constexpr char const* names[] = {"initialising", "known", "used"};
  int const i = static_cast<int>(state);
  return i >= 0 && i <= static_cast<int>(imu_state::used) ? names[i] : "unknown";
}

/// The status as a word, such as "little_motion".
inline char const* name_of(initialization_status status) {
  constexpr char const* names[] = {"initialized", "at_rest",       "few_keyframes", "no_integral",
                                   "not_finite",  "little_motion", "inconsistent"};
  constexpr int count = sizeof names / sizeof *names;
  static_assert(count == static_cast<int>(initialization_status::inconsistent) + 1, "one a status");
  int const i = static_cast<int>(status);
  return i >= 0 && i < count ? names[i] : "unknown";
}

/// The status as a word, such as "no_samples".
inline char const* name_of(integration_status status) {
  constexpr char const* names[] = {"integrated", "no_samples", "one_sample",  "no_steps",
                                   "unordered",  "not_finite", "gap",         "repeated",
                                   "wrong_rate", "too_many",   "contradicted"};
  constexpr int count = sizeof names / sizeof *names;
  static_assert(count == static_cast<int>(integration_status::contradicted) + 1, "one a status");
  int const i = static_cast<int>(status);
  return i >= 0 && i < count ? names[i] : "unknown";
}

/// The state of an IMU, and why it is not `used`; no full stop at the text's end.
struct imu_explanation {
  imu_state state = imu_state::initialising;
  /// A name of an integration_status, if the frame's samples are not usable; else of the
  /// initialization_status that keeps the IMU from being known, or "no_pose". "none" if it is used.
  char const* reason = "none";
  std::string text;  ///< empty if it is used
};

namespace detail {

/// Why samples say nothing of a motion. @pre they are not usable
inline std::string unusable_text(integration_status status, imu_params const& params) {
  switch (status) {
    case integration_status::no_samples:
      return "there are no samples since the frame before";
    case integration_status::one_sample:
      return "there is one sample alone since the frame before";
    case integration_status::no_steps:
      return "all samples are older than the frame before";
    case integration_status::unordered:
      return "it is the first frame, or times of samples do not ascend";
    case integration_status::not_finite:
      return "a sample or a time is not finite";
    case integration_status::gap:
      return "for more than " + one_decimal(params.selection.longest_gap_s) +
             " s there is no sample";
    case integration_status::wrong_rate:
      return "samples come much more or much less often than rate_hz says";
    case integration_status::too_many:
      return "there are more samples than the " + std::to_string(params.samples) +
             " of imu_params::samples";
    default:
      return "many matches of images contradict the samples";
  }
}

/// Why gravity, velocity and biases are not known though samples are usable.
inline std::string unknown_imu_text(initialization_status status, imu_params const& params) {
  switch (status) {
    case initialization_status::few_keyframes:
      return std::to_string(params.initialization.least_keyframes) +
             " keyframes in a row with usable samples are asked for";
    case initialization_status::no_integral:
      return "samples between two keyframes are not usable";
    case initialization_status::not_finite:
      return "a pose or an integral of samples is not finite";
    case initialization_status::little_motion:
      return "velocity, gravity or biases are uncertain: the motion is too little, or the samples "
             "do not suit the images";
    case initialization_status::inconsistent:
      return "the samples contradict the images";
    default:
      return "what was found is not in use yet";
  }
}

}  // namespace detail

/// Says whether the IMU is used, and why not. Host; allocates the text.
/// @param t of a frame @param params of the odometry
inline imu_explanation explain_imu(imu_tracking const& t, imu_params const& params = {}) {
  if (t.optimized) { return {imu_state::used, "none", {}}; }
  imu_state const state = t.known ? imu_state::known : imu_state::initialising;
  if (!usable(t.samples)) {
    return {state, name_of(t.samples), detail::unusable_text(t.samples, params)};
  }
  if (t.known) {
    return {state, "no_pose", "the frame's matches gave no pose that agrees with the samples"};
  }
  return {state, name_of(t.estimate), detail::unknown_imu_text(t.estimate, params)};
}

}  // namespace FT_ABI
}  // namespace ft
