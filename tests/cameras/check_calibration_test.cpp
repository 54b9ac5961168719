// SPDX-License-Identifier: Apache-2.0
// Signs of a wrong calibration: each of them, for each kind of rig, and none of real ones.
#include "ft/cameras/check_calibration.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/mixed_rig.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/cameras/unified.hpp"

namespace check_calibration_test {

using warning = ft::calibration_warning;
constexpr float nan = std::numeric_limits<float>::quiet_NaN();
constexpr float infinity = std::numeric_limits<float>::infinity();

using lens = ft::radtan4<float>;
using fisheye = ft::kannala_brandt<float>;

/// The warnings of a rig of 752x480, as words with spaces between them.
template <typename Rig>
std::string words(Rig const& rig, int width = 752, int height = 480) {
  std::string all;
  for (auto const& found : ft::check_calibration(rig, width, height)) {
    EXPECT_FALSE(found.text.empty());
    all += (all.empty() ? "" : " ") + std::string(ft::name_of(found.warning));
  }
  return all;
}
/// Whether a text is in one of the findings.
template <typename Rig>
bool says(Rig const& rig, std::string const& text, int width = 752, int height = 480) {
  std::string all;
  for (auto const& found : ft::check_calibration(rig, width, height)) { all += found.text + "\n"; }
  EXPECT_NE(all.find(text), std::string::npos) << all;
  return all.find(text) != std::string::npos;
}

// EuRoC's, TUM-VI's and a T265's, as their files have them.
lens euroc_left() {
  return {458.654f, 457.296f, 367.215f, 248.375f, {-0.2834f, 0.0740f, 0.0002f, 1.76e-5f}};
}
lens euroc_right() {
  return {457.587f, 456.134f, 379.999f, 255.238f, {-0.2837f, 0.0745f, -0.0001f, -3.56e-5f}};
}
fisheye tumvi() {
  return {190.978f, 190.973f, 254.932f, 256.897f, 0.00348f, 0.000715f, -0.00205f, 0.000203f};
}
fisheye t265() {
  return {286.18f, 286.38f, 418.31f, 400.84f, -0.0091f, 0.0455f, -0.0422f, 0.0075f};
}
ft::pinhole<float> kitti() { return {718.856f, 718.856f, 607.193f, 185.216f}; }

ft::pose beside(float baseline) {
  auto T = ft::pose::identity();
  T.t.x = -baseline;
  return T;
}
ft::distorted_pair<lens> euroc() {
  return ft::distorted_pair<lens>::make(euroc_left(), euroc_right(), beside(0.11f),
                                        {435, 435, 375, 239});
}
template <typename Camera>
ft::stereo_rig<Camera, Camera> pair_of(Camera const& camera, float baseline = 0.1f) {
  return {camera, camera, beside(baseline)};
}

TEST(CheckCalibration, RealOnesHaveNoWarning) {
  EXPECT_EQ(words(euroc()), "");
  EXPECT_EQ(words(pair_of(euroc_left())), "");
  EXPECT_EQ(words(pair_of(tumvi()), 512, 512), "");
  EXPECT_EQ(words(pair_of(t265(), 0.064f), 848, 800), "");
  EXPECT_EQ(words(ft::rectified_rig::make(kitti(), 0.537), 1241, 376), "");
  EXPECT_EQ(words(ft::monocular_rig<lens>::make(euroc_right())), "");
  EXPECT_EQ(words(ft::monocular_rig<ft::unified<float>>::make({1000, 1000, 376, 240, 1.2f, {}}),
                  752, 480),
            "");
  EXPECT_EQ(words(ft::rgbd_rig<>::make({525, 525, 319.5f, 239.5f}, 0.08, 0.0002f), 640, 480), "");
  EXPECT_EQ(words(ft::rgbd_rig<>::make({525, 525, 319.5f, 239.5f}, 0.08), 640, 480), "");
  ft::multi_rig<3> const rig{
      {{kitti(), 0.5, ft::pose::identity()}, {kitti(), 0, beside(1)}, ft::rig_camera::none()}};
  EXPECT_EQ(words(rig, 1241, 376), "");
}

TEST(CheckCalibration, NamesAreDistinctWords) {
  EXPECT_STREQ(ft::name_of(warning::not_finite), "not_finite");
  EXPECT_STREQ(ft::name_of(warning::folds), "folds");
  EXPECT_STREQ(ft::name_of(warning::depth_scale), "depth_scale");
  EXPECT_STREQ(ft::name_of(static_cast<warning>(99)), "unknown");
}

TEST(CheckCalibration, Baselines) {
  auto const of = [](double baseline) { return ft::rectified_rig{kitti(), baseline}; };
  auto const found = [&](double baseline) { return words(of(baseline), 1241, 376); };
  EXPECT_EQ(found(2), "");
  EXPECT_EQ(found(2.001), "baseline_long");
  EXPECT_TRUE(says(of(537), "is 537 m, above 2 m: are these millimetres?", 1241, 376));
  EXPECT_EQ(found(0.005), "");
  EXPECT_EQ(found(0.0049), "baseline_short");
  EXPECT_EQ(found(0), "baseline_short");
  EXPECT_EQ(found(-0.5), "baseline_short");
  EXPECT_EQ(found(nan), "not_finite");
  EXPECT_EQ(found(infinity), "not_finite");
  EXPECT_EQ(words(pair_of(euroc_left(), 110)), "baseline_long");
  auto distorted = euroc();
  distorted.target.baseline = 110;
  EXPECT_EQ(words(distorted), "baseline_long");
  EXPECT_EQ(words(ft::rgbd_rig<>{{525, 525, 320, 240}, 80}, 640, 480), "baseline_long");
  ft::multi_rig<2> const rig{{{kitti(), 537, ft::pose::identity()}, {kitti(), 0, beside(1500)}}};
  EXPECT_EQ(words(rig, 1241, 376), "baseline_long baseline_long");
  EXPECT_TRUE(says(rig, "camera 1 is 1500 m from the body", 1241, 376));
}

TEST(CheckCalibration, AnotherSizesCalibration) {
  // Of the whole image, for the half and the double one.
  auto const rig = ft::monocular_rig<lens>{euroc_left()};
  EXPECT_EQ(words(rig, 376, 240), "principal_point");
  EXPECT_EQ(words(rig, 1504, 960).substr(0, 15), "principal_point");
  EXPECT_TRUE(says(
      rig,
      "(367.215, 248.375) is not within 20 % of the sides from the centre of images of 376x240",
      376, 240));
  // The centre of the half image lies on a quarter of the whole one.
  auto const centred = [](float cx, float cy) {
    return words(ft::monocular_rig<ft::pinhole<float>>{{300, 300, cx, cy}}, 640, 480);
  };
  EXPECT_EQ(centred(160, 120), "principal_point");
  EXPECT_EQ(centred(160, 240), "principal_point");  // an image with the other one beside it
  EXPECT_EQ(centred(320, 480), "principal_point");
  EXPECT_EQ(centred(193, 145), "");
  EXPECT_EQ(centred(447, 335), "");
  EXPECT_EQ(words(ft::monocular_rig<lens>{euroc_left()}, 480, 752), "principal_point");  // turned
  auto const of = [](float fx, float fy) {
    return ft::monocular_rig<ft::pinhole<float>>{{fx, fy, 320, 240}};
  };
  EXPECT_EQ(words(of(76.8f, 76.8f), 640, 480), "");
  EXPECT_EQ(words(of(76, 76), 640, 480), "focal_length");  // 153 degrees
  EXPECT_EQ(words(of(5121, 5121), 640, 480), "focal_length");
  EXPECT_EQ(words(of(3.6f, 3.6f), 640, 480), "focal_length");  // millimetres
  EXPECT_EQ(words(of(500, 900), 640, 480), "focal_length");
  EXPECT_EQ(words(of(900, 500), 640, 480), "focal_length");
  EXPECT_EQ(words(of(0, 500), 640, 480), "refused");
  EXPECT_EQ(words(of(nan, 500), 640, 480), "not_finite");
}

TEST(CheckCalibration, LensesThatFoldOrAreNotFinite) {
  auto folded = euroc_left();
  folded.distortion[0] = -5;
  EXPECT_EQ(words(pair_of(folded)), "folds folds");
  EXPECT_EQ(words(ft::monocular_rig<lens>{folded}), "folds");
  EXPECT_EQ(words(ft::rgbd_rig<lens>::make(folded, 0.1)), "folds");
  auto distorted = euroc();
  distorted.right = folded;
  EXPECT_EQ(words(distorted), "folds");
  EXPECT_TRUE(says(distorted, "right camera: only"));
  // The corners alone.
  folded.distortion[0] = -0.4f;
  folded.distortion[1] = 0;
  EXPECT_EQ(words(ft::monocular_rig<lens>{folded}), "folds");
  folded.distortion[1] = nan;
  EXPECT_EQ(words(ft::monocular_rig<lens>{folded}), "not_finite");
  EXPECT_TRUE(says(ft::monocular_rig<lens>{folded}, "camera: k2 is nan"));
  folded.distortion[1] = infinity;
  EXPECT_EQ(words(pair_of(folded)), "not_finite not_finite");
}

TEST(CheckCalibration, RotationsOfPairs) {
  auto rig = pair_of(tumvi());
  auto const found = [&] { return words(rig, 512, 512); };
  float const c = std::cos(1.1f), s = std::sin(1.1f);  // 63 degrees
  rig.T_rl.R = {{c, 0, s, 0, 1, 0, -s, 0, c}};
  EXPECT_EQ(found(), "rotation");
  rig.T_rl.R = {{0.99f, 0, 0, 0, 1, 0, 0, 0, 1}};
  EXPECT_EQ(found(), "refused");
  rig.T_rl.R = {{-1, 0, 0, 0, 1, 0, 0, 0, 1}};
  EXPECT_EQ(found(), "refused");  // a reflection
  rig.T_rl.R.m[4] = nan;
  EXPECT_EQ(found(), "not_finite");
  rig = pair_of(tumvi());
  rig.T_rl = rig.T_rl.inverse();
  EXPECT_EQ(found(), "baseline_direction");
  rig.T_rl.t = {0, 0, 0};
  EXPECT_EQ(found(), "refused");
  rig.T_rl.t = {0, 0.1f, 0};  // one above the other
  EXPECT_EQ(found(), "");
  auto distorted = euroc();
  distorted.R_left = {{c, 0, s, 0, 1, 0, -s, 0, c}};
  EXPECT_EQ(words(distorted), "rotation");
  distorted.R_left.m[0] = 3;
  EXPECT_EQ(words(distorted), "refused");
  ft::multi_rig<1> several{{{kitti(), 0.5, ft::pose::identity()}}};
  several.of[0].T_cb.R.m[0] = 2;
  EXPECT_EQ(words(several, 1241, 376), "refused");
  several.of[0].T_cb.t.x = infinity;
  EXPECT_EQ(words(several, 1241, 376), "not_finite");
  several.of[0] = {kitti(), -0.5, ft::pose::identity()};
  EXPECT_EQ(words(several, 1241, 376), "refused");
}

TEST(CheckCalibration, PairsOfMixedRigs) {
  auto const mounted = [](float x) {
    return ft::mixed_rig_camera::single(ft::any_camera<float>::of(tumvi()), beside(x));
  };
  ft::mixed_rig<2> rig{{mounted(0), mounted(0.1f)}};
  ft::pair_up(rig, 0, 1);
  EXPECT_EQ(words(rig, 512, 512), "");
  rig.of[1].T_cb.t.x = -0.2f;
  EXPECT_EQ(words(rig, 512, 512), "refused");
  EXPECT_TRUE(says(rig, "call pair_up() when T_cb is set", 512, 512));
  ft::pair_up(rig, 0, 1);
  EXPECT_EQ(words(rig, 512, 512), "");
  rig.of[1].left = -1;
  EXPECT_TRUE(says(rig, "do not name each other as a pair", 512, 512));
  rig.of[0].camera.fx = nan;  // told once
  EXPECT_EQ(words(rig, 512, 512), "not_finite");
}

TEST(CheckCalibration, ScalesOfDepth) {
  auto const found = [](float scale) {
    ft::rgbd_rig<> rig{{525, 525, 320, 240}, 0.08};
    rig.depth_scale = scale;
    return words(rig, 640, 480);
  };
  EXPECT_EQ(found(1), "");
  EXPECT_EQ(found(0.001f), "");
  EXPECT_EQ(found(1000), "depth_scale");
  EXPECT_EQ(found(5000), "depth_scale");
  EXPECT_EQ(found(1e-7f), "depth_scale");
  EXPECT_EQ(found(-0.001f), "depth_scale");
  EXPECT_EQ(found(nan), "not_finite");
}

TEST(CheckCalibration, SizesThatCannotBeThrow) {
  auto const rig = euroc();
  EXPECT_THROW(ft::check_calibration(rig, 0, 480), ft::bad_argument);
  EXPECT_THROW(ft::check_calibration(rig, 752, -1), ft::bad_argument);
  EXPECT_THROW(ft::check_calibration(rig, 16385, 480), ft::bad_argument);
  EXPECT_EQ(words(ft::monocular_rig<lens>{euroc_left()}, 1, 1).substr(0, 12), "focal_length");
}

}  // namespace check_calibration_test
