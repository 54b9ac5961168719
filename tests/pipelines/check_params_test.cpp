// SPDX-License-Identifier: Apache-2.0
// Settings are checked by check(), which names what is wrong; what contradicts itself is refused.
#include "ft/pipelines/check_params.hpp"

#include <gtest/gtest.h>

#include <cstddef>
#include <limits>
#include <string>
#include <type_traits>

#include "ft/cameras/distorted_pair.hpp"
#include "ft/cameras/mixed_rig.hpp"
#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/cameras/rgbd_rig.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "tests/support/refusals.hpp"

namespace check_params_test {

template <typename Params>
std::string refusal(Params const& p) {
  return test::refusal([&] { ft::check(p); });
}

ft::odometry_params sized() {
  ft::odometry_params p;
  p.orb.width = 752;
  p.orb.height = 480;
  return p;
}
ft::odometry_params with_imu() {
  ft::odometry_params p = sized();
  p.imu.present = true;
  return p;
}

TEST(check_params, takes_the_defaults) {
  EXPECT_EQ(refusal(sized().orb), "");
  ft::tracker_params tracker;
  tracker.orb = sized().orb;
  EXPECT_EQ(refusal(tracker), "");
  EXPECT_EQ(refusal(sized()), "");
  EXPECT_EQ(refusal(with_imu()), "");
  EXPECT_EQ(refusal(ft::tracking_rules{}), "");
  EXPECT_EQ(refusal(ft::place_recovery{}), "");
}

TEST(check_params, names_the_value_and_the_limits) {
  auto const said = [](auto const& change) {
    ft::odometry_params p = with_imu();
    change(p);
    return refusal(p);
  };
  EXPECT_EQ(said([](auto& p) { p.window.fixed = -1; }),
            "ft: window.fixed is -1, must be in [0, 54]");
  // What is nested is checked, too.
  EXPECT_EQ(said([](auto& p) { p.orb.ini_threshold = 256; }),
            "ft: orb.ini_threshold is 256, must be in [0, 255]");
  EXPECT_EQ(said([](auto& p) { p.start.two_views.samples = 0; }),
            "ft: start.two_views.samples is 0, must be in [1, 65536]");
  EXPECT_EQ(said([](auto& p) { p.keyframes = 14; }),
            "ft: window.moving + window.fixed (at most keyframes) is 15, must be in [1, 14]");
  EXPECT_EQ(said([](auto& p) { p.orb.levels = 40; }), "ft: orb.levels is 40, must be in [1, 16]");
  EXPECT_EQ(said([](auto& p) {
              p.orb.width = 1;
              p.orb.height = 3;
            }),
            "ft: orb.levels is 8, too many for an image of 1 x 3 pixels and scale_factor 1.2");
  EXPECT_EQ(said([](auto& p) { p.orb.mask_width = 4; }),
            "ft: orb.mask_width is 4 and mask_height is 0, must be both 0 or both above it");
  EXPECT_EQ(said([](auto& p) { p.orb.min_threshold = 21; }),
            "ft: orb.min_threshold (at most ini_threshold) is 21, must be in [0, 20]");
  EXPECT_EQ(said([](auto& p) {
              p.overlap[0] = {500, 100};
            }),
            "ft: overlap[0] is [500, 100], its left end must not be above its right end");
  EXPECT_EQ(said([](auto& p) { p.imu.T_bc.R.m[1] = 0.5; }),
            "ft: the rotation of imu.T_bc is not a rotation: the product of its rows 0 and 0 is "
            "1.25, must be 1");
  EXPECT_EQ(said([](auto& p) { p.imu.T_bc.R.m[0] = -1; }),
            "ft: the rotation of imu.T_bc is not a rotation but a reflection: its determinant is "
            "-1, must be 1");
  EXPECT_EQ(said([](auto& p) { p.imu.noise.rate_hz = 0; }),
            "ft: imu.noise.rate_hz is 0, must be in [1, 100000]");
  ft::place_recovery places;
  places.relocalization.pnp.min_share = 2;
  EXPECT_EQ(refusal(places), "ft: min_share is 2, must be in [0, 1]");
}

/// Where a value means off, or the default, it stays allowed.
TEST(check_params, takes_values_that_mean_off) {
  auto p = with_imu();
  p.orb.start_features = p.orb.mask_width = p.orb.mask_height = 0;
  p.orb.corner_ratio = 0;
  p.rules.min_evidence = p.rules.wanted_near_points = p.rules.new_near_points = 0;
  p.rules.keyframe_period_s = 0;
  p.enough_matches = 0;
  p.window.fixed = p.local_map.neighbours = p.adjustment.steps = 0;
  p.adjustment.no_image = p.adjustment.disparity_weight = 0;
  p.adjustment.first_damping = p.adjustment.enough = 0;
  p.start.two_views.homography_ratio = -1;
  p.imu.accel_sigma = p.imu.scale_sigma = 0;
  p.imu.selection.rate_hz = 0;
  p.imu.selection.longest_gap_s = std::numeric_limits<double>::infinity();
  p.imu.initialization.max_tilt_sigma = std::numeric_limits<float>::infinity();
  p.imu.time_offset_s = -1;
  p.overlap[0] = {0, std::numeric_limits<float>::infinity()};
  p.overlap[1] = {};
  EXPECT_EQ(refusal(p), "");
}

// ---- every setting

template <typename Visit, typename... Members>
void visit_all(Visit const& visit, std::string names, Members&... members) {
  auto const next = [&] {
    std::string const first = names.substr(0, names.find(','));
    names.erase(0, first.size() + 2);  // and ", "
    return first;
  };
  (visit(next(), members), ...);
}

/// Calls visit(name, member) for every member. One that is added to the structure has to be added
/// here: the structured binding does not compile without it.
#define SETTINGS_OF(PARAMS, ...)                          \
  template <typename Visit>                               \
  void each_setting(PARAMS& params, Visit const& visit) { \
    auto& [__VA_ARGS__] = params;                         \
    visit_all(visit, #__VA_ARGS__, __VA_ARGS__);          \
  }
SETTINGS_OF(ft::vec3<double>, x, y, z)
SETTINGS_OF(ft::mat3<double>, m)
SETTINGS_OF(ft::rigid<double>, R, t)
SETTINGS_OF(ft::stereo_overlap, left, right)
SETTINGS_OF(ft::orb_params, width, height, features, start_features, levels, scale_factor,
            ini_threshold, min_threshold, corner_ratio, mask_width, mask_height, exact_positions,
            refine_positions, ties)
SETTINGS_OF(ft::motion_params, even, longest, memory)
SETTINGS_OF(ft::tracking_rules, min_stereo_points, min_motion_inliers, min_inliers, min_recovered,
            min_evidence, first_wide_search, later_wide_search, patience, wanted_near_points,
            new_near_points, keep_share, unrectified_keep_share, keyframe_period_s, near_depth,
            far_depth, matches_without_window, doubtful_share, min_support, matched_search, motion,
            localize_only)
SETTINGS_OF(ft::local_map_params, keyframes, neighbours)
SETTINGS_OF(ft::window_selection, moving, fixed)
SETTINGS_OF(ft::window_params, steps, huber2, outlier2, no_image, disparity_weight, first_damping,
            enough)
SETTINGS_OF(ft::start_rules, min_keypoints, min_matches, inertial, longest_gap_s, seed)
SETTINGS_OF(ft::initial_match_params, window_radius, max_hamming, ratio, orientation_check)
SETTINGS_OF(ft::two_view_params, samples, sigma_px, homography_ratio, min_points, min_parallax_deg)
SETTINGS_OF(ft::monocular_start_params, rules, matching, two_views)
SETTINGS_OF(ft::imu_noise, gyro, accel, gyro_walk, accel_walk, rate_hz)
SETTINGS_OF(ft::selection_params, early_s, longest_gap_s, rate_hz)
SETTINGS_OF(ft::initialization_params, gravity, known_scale, least_keyframes, position_sigma,
            rotation_sigma, accel_bias_sigma, rest_distance, rest_angle, max_gyro_sigma,
            max_tilt_sigma, max_velocity_sigma, max_scale_sigma, max_position_rms, max_rotation_rms)
SETTINGS_OF(ft::imu_params, present, T_bc, noise, samples, waiting, max_accel, max_gyro,
            time_offset_s, estimate_time_offset, estimate_rotation, selection, initialization,
            scale_position_sigma, scale_sigma, scale_keyframes, accel_sigma, keyframe_period_s)
SETTINGS_OF(ft::loop_params, present, keyframes, points, recent, groups, votes, min_votes,
            min_inliers, min_share, max_drift, max_turn, max_scale_drift)
SETTINGS_OF(ft::odometry_params, orb, rules, map_slots, keyframes, local_points, local_map,
            window_radius, enough_matches, window, window_points, adjustment, adjustment_delay,
            start, imu, loops, own_features, align_keypoints, use_graphs, measure_stages, prefetch,
            overlap)
SETTINGS_OF(ft::tracker_params, orb, map_slots, local_points, updates, window_radius,
            enough_matches, optimize_last, optimize_local, use_graphs, measure_stages, overlap)
#undef SETTINGS_OF

/// Sets every number of `params` to what it cannot be, one after the other, and expects that
/// check(whole) names it. @param path of `params` in `whole` @return how many numbers there are
template <typename Whole, typename Params>
int refuse_each(Whole const& whole, Params& params, std::string const& path) {
  if constexpr (std::is_array<Params>::value) {
    int numbers = 0;
    for (std::size_t i = 0; i < std::extent<Params>::value; ++i) {
      numbers += refuse_each(whole, params[i], path + "[" + std::to_string(i) + "]");
    }
    return numbers;
  } else if constexpr (std::is_class<Params>::value) {
    int numbers = 0;
    each_setting(params, [&](std::string const& name, auto& member) {
      numbers += refuse_each(whole, member, path.empty() ? name : path + "." + name);
    });
    return numbers;
  } else if constexpr (std::is_floating_point<Params>::value || std::is_same<Params, int>::value) {
    Params const good = params;
    params =
        std::is_same<Params, int>::value ? Params(-1) : std::numeric_limits<Params>::quiet_NaN();
    std::string name = path;
    for (char const* of_whole : {".R.m[", ".left", ".right"}) {  // of which the whole is named
      name = name.substr(0, name.find(of_whole));
    }
    EXPECT_NE(refusal(whole).find(name), std::string::npos)
        << path << " is not checked; said was: " << refusal(whole);
    params = good;
    return 1;
  } else {
    return 0;  // true, false, a choice, a seed
  }
}

/// A setting that is added without a check makes this fail.
TEST(check_params, names_every_number_that_cannot_be) {
  auto p = with_imu();
  p.loops.present = true;
  ASSERT_EQ(refusal(p), "");
  EXPECT_GT(refuse_each(p, p, ""), 100);
  ft::tracker_params tracker;
  tracker.orb = p.orb;
  ASSERT_EQ(refusal(tracker), "");
  EXPECT_GT(refuse_each(tracker, tracker, ""), 15);
}

/// Read-out times are settings of rigs, whose check() names them.
template <typename Rig>
void expect_readout_is_checked(Rig rig) {
  EXPECT_NO_THROW(rig.check());
  auto& s = [&]() -> float& {
    if constexpr (Rig::searches > 1) {
      return rig.of[1].readout_s;
    } else {
      return rig.readout_s;
    }
  }();
  for (float const good : {0.0f, 0.033f, 0.1f}) {
    s = good;
    EXPECT_NO_THROW(rig.check()) << good;
  }
  for (float const bad : {-1e-3f, 0.11f, std::numeric_limits<float>::quiet_NaN(),
                          std::numeric_limits<float>::infinity()}) {
    s = bad;
    std::string const said = test::refusal([&] { rig.check(); });
    EXPECT_EQ(said.rfind("ft: readout_s is ", 0), 0u) << said;
    EXPECT_NE(said.find("must be in [0, 0.1]"), std::string::npos) << said;
  }
}

TEST(check_params, names_readouts_that_cannot_be) {
  using camera = ft::pinhole<float>;
  camera const c{400, 400, 320, 240};
  ft::pose T = ft::pose::identity();
  T.t.x = -0.1f;
  expect_readout_is_checked(ft::rectified_rig::make(c, 0.1));
  expect_readout_is_checked(ft::stereo_rig<camera, camera>{c, c, T});
  expect_readout_is_checked(ft::distorted_pair<camera>::make(c, c, T, c));
  expect_readout_is_checked(ft::rgbd_rig<>::make(c, 0.1));
  expect_readout_is_checked(ft::monocular_rig<>::make(c));
  ft::multi_rig<2> multi{};
  multi.of[0] = {c, 0.1};
  multi.of[1] = {c, 0, T};
  expect_readout_is_checked(multi);
  ft::mixed_rig<2> mixed{};
  mixed.of[0] = ft::mixed_rig_camera::rectified(c, 0.1, T);
  mixed.of[1] = ft::mixed_rig_camera::single(ft::any_camera<float>::of(c), T);
  expect_readout_is_checked(mixed);
}

TEST(check_params, refuses_periods_that_are_none) {
  for (double const period : {-1.0, 1e7, std::numeric_limits<double>::quiet_NaN(),
                              std::numeric_limits<double>::infinity()}) {
    ft::odometry_params p = sized();
    p.rules.keyframe_period_s = period;
    EXPECT_NE(refusal(p).find("rules.keyframe_period_s is "), std::string::npos) << period;
  }
}

/// With an IMU its period holds: another one in the rules would be ignored.
TEST(check_params, refuses_two_periods_of_keyframes) {
  auto p = with_imu();
  p.imu.keyframe_period_s = 0.5;
  EXPECT_EQ(refusal(p), "");
  p.rules.keyframe_period_s = 0.5;
  EXPECT_EQ(refusal(p), "");
  p.rules.keyframe_period_s = 0.75;
  std::string const said = refusal(p);
  EXPECT_NE(said.find("rules.keyframe_period_s"), std::string::npos) << said;
  EXPECT_NE(said.find("is 0.75, must be in [0.5, 0.5]"), std::string::npos) << said;
  p.imu.present = false;
  EXPECT_EQ(refusal(p), "");
}

TEST(check_params, asks_nothing_of_an_imu_that_is_not_there) {
  ft::odometry_params p = sized();
  p.imu.samples = 0;
  EXPECT_EQ(refusal(p), "");
  p.imu.present = true;
  EXPECT_EQ(refusal(p), "ft: imu.samples is 0, must be in [2, 1048576]");
}

}  // namespace check_params_test
