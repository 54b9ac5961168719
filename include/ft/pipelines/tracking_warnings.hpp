// SPDX-License-Identifier: Apache-2.0
/// @file What is to be told of a frame although it is tracked: names, sentences, and when.
#pragma once

#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "ft/core/config.hpp"
#include "ft/pipelines/imu_warnings.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

/// The warning as a word, such as "two_motions".
inline char const* name_of(tracking_warning warning) {
  constexpr char const* names[] = {
      "new_map",     "doubtful_pose", "two_motions", "images_repeat", "stereo_inconsistent",
      "depth_scale", "dark",          "bright",      "low_texture",   "blurred",
      "imu",         "imu_not_used"};
  static_assert(sizeof names / sizeof *names == tracking_warnings, "one a warning");
  int const i = static_cast<int>(warning);
  return i >= 0 && i < tracking_warnings ? names[i] : "unknown";
}

/// Limits of warnings. Grey values are from 0 to 255.
struct warning_limits {
  /// Bits, of a pose that follows the one before: a wrong one has them once in 2^32 frames. One of
  /// a lost camera, which tries many, needs tracking_rules::min_evidence.
  int least_evidence = 32;
  /// Of the variance of errors, what neighbours share: then half of their length is common to
  /// them, and the pose is wrong, or points or calibration are. Of a right pose it is about 0.
  double common_errors = 0.25;
  /// Likewise of disparities, most of it. Points share the error of the keyframe that measured
  /// them.
  double common_disparities = 0.5;
  /// A share above its limit is a fault that goes on while it comes back to this part of the limit
  /// within stays_ns: right poses never begin it.
  double goes_on = 0.5;
  double dark_mean = 16;
  double bright_mean = 239;
  double least_deviation = 5;       ///< of grey values
  int few_keypoints = 120;          ///< of all cameras, with less than which an image is blurred
  double least_stereo_share = 0.3;  ///< of keypoints of a rectified pair with a stereo match
  double stereo_drop = 0.65;        ///< or of that share, as a share of the usual one
  double ambiguous_share = 0.125;   ///< of depths, above which the scene repeats along the rows
  double rows_apart = 1;   ///< pixels, of partners: half of what is searched, in the finest octave
  int moving_points = 20;  ///< that move otherwise than the rest, at least
  double moving_share = 1.0 / 16;      ///< and as a share of all that are fixed to a camera
  std::int64_t stays_ns = 1000000000;  ///< a doubt about a pose is one about the second after it
};

namespace detail {

/// Whether many keypoints of a frame are fixed to a camera.
inline bool has_fixed(tracking const& t, warning_limits const& limits) {
  int const n = t.evidence.facts.dragged;
  return n >= limits.moving_points && n >= limits.moving_share * (t.stereo_points + n);
}

/// Whether keypoints of a frame move otherwise than its pose says: what is fixed to a camera, or
/// all of the image while the pose stands still.
inline bool has_two_motions(tracking const& t, warning_limits const& limits) {
  tracking_evidence const& e = t.evidence;
  if (has_fixed(t, limits) || e.facts.apart > 0) { return true; }
  return t.inliers > 0 && !t.map_begun && 8 * (t.inliers - e.facts.resting) < t.inliers &&
         3 * e.moved > e.textured && e.textured >= 16;
}

/// Whether an adjustment took back an error. The unit of one camera drifts, which moves it, too:
/// see drifting_unit.
inline bool was_shifted(tracking const& t) {
  return t.depths != depth_origin::motion && 2 * t.evidence.facts.shifted > t.inliers;
}

/// Whether an adjustment moved one camera by more than the motion over a second may be wrong: by 2
/// % of its path, at the camera's speed, and three deviations; of a metric map also by 5 cm. While
/// a map has few views, a turn and a motion sideways look alike, and a doubt in pixels would be one
/// about each adjustment.
class drifting_unit {
public:
  /// @param t its warnings are not read
  bool judge(tracking const& t, std::int64_t time_ns) {
    bool const goes_on = t.state == tracking_state::tracking && !t.map_begun && seconds_ >= 0 &&
                         t.metric == metric_ && time_ns > time_ns_;
    auto const at = t.T_odom_camera.t;
    bool const stepped = goes_on && seconds_ > 0 && t.inliers > 0 && is_far(t);
    if (goes_on) {
      double const dt = 1e-9 * static_cast<double>(time_ns - time_ns_);
      double const kept = std::exp(-dt);  // the last second counts most
      path_ = kept * path_ + std::sqrt(dot(at - at_, at - at_));
      seconds_ = kept * seconds_ + dt;
    } else {
      path_ = 0;
      seconds_ = t.state == tracking_state::tracking ? 0 : -1;
    }
    metric_ = t.metric;
    time_ns_ = time_ns;
    at_ = at;
    return stepped;
  }

private:
  bool is_far(tracking const& t) const {
    double const* const c = t.covariance;
    double const deviation = std::sqrt(c[21] + c[28] + c[35]);
    double const step = static_cast<double>(t.evidence.facts.stepped);
    return step > 0.02 * path_ / seconds_ && step > 3 * deviation && (!t.metric || step > 0.05);
  }

  double path_ = 0, seconds_ = -1;  ///< weighted; below 0 seconds: no frame before
  bool metric_ = false;
  std::int64_t time_ns_ = 0;
  vec3<double> at_{0, 0, 0};
};

inline bool has_odd_stereo(tracking const& t, warning_limits const& limits) {
  frame_facts const& f = t.evidence.facts;
  if (f.with_disparity >= limits.moving_points && 4 * f.off_disparity > f.with_disparity) {
    return true;
  }
  int const n = t.evidence.ambiguous;
  if (n >= limits.moving_points && n > limits.ambiguous_share * t.stereo_points) { return true; }
  if (t.depths != depth_origin::stereo) { return false; }
  if (t.stereo_points >= limits.moving_points &&
      std::abs(t.evidence.rows_apart) > limits.rows_apart) {
    return true;
  }
  if (t.keypoints < limits.few_keypoints) { return false; }
  double const share = t.evidence.stereo_share;
  return (t.evidence.rectified && share < limits.least_stereo_share) ||
         share < limits.stereo_drop * t.evidence.usual_stereo_share;
}

/// What the light of a frame's images and the number of its keypoints say.
inline void add_light_warnings(tracking const& t, warning_limits const& limits, warning_set& all) {
  if (t.light.image < 0) { return; }
  if (t.light.mean < limits.dark_mean) {
    all.add(tracking_warning::dark);
  } else if (t.light.mean > limits.bright_mean) {
    all.add(tracking_warning::bright);
  } else if (t.light.deviation < limits.least_deviation) {
    all.add(tracking_warning::low_texture);
  } else if (t.keypoints < limits.few_keypoints) {
    all.add(tracking_warning::blurred);
  }
}

/// A share of errors that neighbours have in common, from frame to frame.
class lasting_share {
public:
  /// @param share in 1 / 1024 @param limit as a part of 1
  /// @return whether it is above its limit, or has been, and the fault goes on
  bool judge(int share, double limit, std::int64_t time_ns, warning_limits const& limits) {
    bool const began = last_ns_ >= 0 && time_ns - last_ns_ <= limits.stays_ns;
    bool const there = share > 1024 * limit * (began ? limits.goes_on : 1.0);
    if (there) { last_ns_ = time_ns; }
    return there;
  }

private:
  std::int64_t last_ns_ = -1;
};

/// What is kept of a camera to judge its next frame by.
class frame_warnings {
public:
  /// Writes `warnings` and the shares of stereo matches of a frame.
  /// @param t the rest is known @param first 1st frame of a camera
  void judge(tracking& t, std::int64_t time_ns, bool first, odometry_params const& params) {
    if (first) { *this = {}; }
    if (t.map_begun) { errors_ = disparities_ = {}; }
    warning_limits const limits{};
    tracking_evidence& e = t.evidence;
    if (t.keypoints > 0) {
      e.stereo_share = static_cast<double>(t.stereo_points + e.facts.fixed) / t.keypoints;
    }
    e.usual_stereo_share = usual_share_;
    warning_set& all = t.warnings;
    all = {};
    add_light_warnings(t, limits, all);
    // Nor do its pairs have the usual share of depths where images are missing.
    bool const unlit = !all.empty() || (t.missing_images | t.missing_depths) != 0;
    // Half of a pair is the image that is searched, where an IMU is believed more for that.
    if (e.streaked > 0 && 2 * e.streaked >= e.images) { all.add(tracking_warning::blurred); }
    if (t.map_begun && t.maps > 1) { all.add(tracking_warning::new_map); }
    if (2 * t.distant_points > t.stereo_points) { all.add(tracking_warning::depth_scale); }
    if (repeats(t)) { all.add(tracking_warning::images_repeat); }
    bool const drifted = t.depths == depth_origin::motion && unit_.judge(t, time_ns);
    if (t.state == tracking_state::tracking) {
      bool const found_again = lost_before_ && !t.map_begun;
      frame_facts const& f = e.facts;
      bool const in_doubt =
          t.inliers > 0 && (errors_.judge(f.common, limits.common_errors, time_ns, limits) ||
                            f.evidence < limits.least_evidence || was_shifted(t) || drifted);
      bool const errs_in_depth =
          !unlit && t.depths == depth_origin::stereo &&
          disparities_.judge(f.common_disparity, limits.common_disparities, time_ns, limits);
      bool const is_odd = errs_in_depth || (!unlit && has_odd_stereo(t, limits));
      if (found_again || in_doubt) { all.add(tracking_warning::doubtful_pose); }
      if (has_two_motions(t, limits)) { all.add(tracking_warning::two_motions); }
      if (is_odd) { all.add(tracking_warning::stereo_inconsistent); }
    }
    lost_before_ = t.state == tracking_state::recovering || t.state == tracking_state::lost;
    if (params.imu.present && !imu_warnings(t.imu, params.imu).empty()) {
      all.add(tracking_warning::imu);
    }
    if (params.imu.present && idle_.judge(t, time_ns, params.imu)) {
      all.add(tracking_warning::imu_not_used);
    }
    if (!all.has(tracking_warning::stereo_inconsistent) && !unlit) {
      double const gain = usual_share_ > 0 ? 0.125 : 1;
      usual_share_ += gain * (e.stereo_share - usual_share_);
    }
    for (tracking_warning const w :
         {tracking_warning::new_map, tracking_warning::doubtful_pose, tracking_warning::two_motions,
          tracking_warning::images_repeat, tracking_warning::stereo_inconsistent,
          tracking_warning::blurred}) {
      auto& said = said_ns_[static_cast<int>(w)];
      if (all.has(w)) { said = time_ns; }
      if (said >= 0 && time_ns - said <= limits.stays_ns) { all.add(w); }
    }
  }

private:
  /// Whether images are those of the frame before though the camera moves.
  bool repeats(tracking const& t) {
    tracking_evidence const& e = t.evidence;
    bool const all_same = e.images > 0 && e.same == e.images && e.textured > 0;
    vec3<double> const v = t.imu.velocity;
    bool const moves = e.facts.moving != 0 || (t.imu.known && dot(v, v) > 0.01);
    // Nothing says that a map's first images repeat, until those after them have moved.
    bool const moved = same_before_ && !all_same && 2 * e.facts.flowing > t.inliers;
    same_before_ = all_same;
    repeats_ = all_same && (repeats_ || moves);
    return repeats_ || moved || (e.same > 0 && e.same < e.images && e.textured > 0);
  }

  idle_imu idle_;
  lasting_share errors_, disparities_;
  drifting_unit unit_;
  double usual_share_ = 0;
  bool repeats_ = false;
  bool same_before_ = false;
  bool lost_before_ = false;
  std::int64_t said_ns_[tracking_warnings] = {-1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1};
};

inline std::string share_of(double part, double of) {
  return std::to_string(of > 0 && part > 0 ? static_cast<int>(100 * part / of) : 0) + " %";
}

inline std::string tenths(double v) {
  int const n = static_cast<int>(std::lround(10 * std::abs(v)));
  return (v < 0 ? "-" : "") + std::to_string(n / 10) + "." + std::to_string(n % 10);
}

/// What to ask of a pair that does not fit. Images that never had many matches are not late ones.
inline std::string stereo_question(tracking_evidence const& e) {
  bool const had_many = e.usual_stereo_share >= warning_limits{}.least_stereo_share;
  return had_many ? "are both images taken at the same time, and is the calibration that of these "
                    "cameras and of their lens?"
                  : "are left and right exchanged, is the calibration that of these cameras and of "
                    "their lens, and are both images taken at the same time?";
}

}  // namespace detail

/// A warning, and a sentence that has the numbers; no full stop at its end.
struct tracking_notice {
  tracking_warning warning = tracking_warning::new_map;
  std::string text;
};

/// The sentence of a warning that a frame has. Host; allocates it.
inline std::string text_of(tracking_warning w, tracking const& t, odometry_params const& params) {
  tracking_evidence const& e = t.evidence;
  frame_facts const& f = e.facts;
  auto const number = [](double v) { return std::to_string(static_cast<int>(v)); };
  std::string const light = "image " + std::to_string(t.light.image) + ": its grey values are " +
                            number(t.light.mean) + " of 255 and deviate by " +
                            number(t.light.deviation);
  switch (w) {
    case tracking_warning::new_map:
      return "map " + std::to_string(t.map_id) +
             " begins at a guessed place, in this frame or in the last second";
    case tracking_warning::doubtful_pose:
      return std::to_string(t.inliers) + " of " + std::to_string(t.local_points) +
             " map points agree with the pose, " + std::to_string(f.evidence) + " bits of " +
             "evidence where " + std::to_string(warning_limits{}.least_evidence) +
             " are asked for, and of the variance of errors neighbours share " +
             detail::share_of(f.common, 1024) + ", of " +
             detail::share_of(warning_limits{}.common_errors, 1) +
             " at most, or a lost camera was found again, or an adjustment of the map moved " +
             std::to_string(f.shifted) +
             " of them by a pixel, or one camera by 2 % of the path of a second; in this frame or "
             "in the last second, or they shared more " +
             "once and half of that since";
    case tracking_warning::two_motions:
      return std::to_string(f.dragged) + " keypoints are fixed to the camera while it moves, " +
             std::to_string(f.apart) + " agree with another motion than that of the pose, or " +
             detail::share_of(e.moved, e.textured) + " of the images changed while " +
             std::to_string(f.resting) + " of " + std::to_string(t.inliers) +
             " keypoints that agree with the pose stand still, in this frame or one of the " +
             "second before";
    case tracking_warning::images_repeat:
      return std::to_string(e.same) + " of " + std::to_string(e.images) +
             " images are those of the frame before while the camera moves, in this frame or one " +
             "of the second before";
    case tracking_warning::stereo_inconsistent:
      return detail::share_of(e.stereo_share, 1) +
             " of the keypoints have a stereo match, usually " +
             detail::share_of(e.usual_stereo_share, 1) + ", and " +
             std::to_string(f.off_disparity) + " of " + std::to_string(f.with_disparity) +
             " do not agree with the map; of the variance of their errors neighbours share " +
             detail::share_of(f.common_disparity, 1024) + ": " + detail::stereo_question(e) + " " +
             std::to_string(e.ambiguous) + " depths may be others, for their rows repeat, and " +
             "rows in right images are those in left ones plus " + detail::tenths(e.rows_apart) +
             " pixels on average";
    case tracking_warning::depth_scale:
      return std::to_string(t.distant_points) + " of " + std::to_string(t.stereo_points) +
             " depths are beyond " + number(static_cast<double>(distant_baselines)) + " baselines";
    case tracking_warning::dark:
      return "nearly black is " + light;
    case tracking_warning::bright:
      return "nearly white is " + light;
    case tracking_warning::low_texture:
      return "almost uniform is " + light;
    case tracking_warning::blurred:
      return std::to_string(t.keypoints) + " keypoints, and " + std::to_string(e.streaked) +
             " of " + std::to_string(e.images) +
             " images are sharp in one direction only, in this frame; or it was so in the last "
             "second: blurred, or without texture";
    case tracking_warning::imu_not_used:
      return detail::unused_imu_text(t.imu, params.imu);
    case tracking_warning::imu:
      break;
  }
  std::string all;
  for (std::string const& said : imu_warnings(t.imu, params.imu)) {
    all += (all.empty() ? "" : "; ") + said;
  }
  return all;
}

/// The warnings of a frame, each with its sentence. A doubt about a pose is told for a second: it
/// is one about the motion since then. Host; allocates.
/// @param t what track() returned @param params of the odometry
inline std::vector<tracking_notice> warnings_of(tracking const& t, odometry_params const& params) {
  std::vector<tracking_notice> out;
  for (int i = 0; i < tracking_warnings; ++i) {
    auto const w = static_cast<tracking_warning>(i);
    if (t.warnings.has(w)) { out.push_back({w, text_of(w, t, params)}); }
  }
  return out;
}

}  // namespace FT_ABI
}  // namespace ft
