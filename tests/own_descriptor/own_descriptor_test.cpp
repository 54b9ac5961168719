// SPDX-License-Identifier: Apache-2.0
// Odometries of other descriptors than ORB's, in one program with ORB's: of the same bits they have
// its answers, of others they track, and what they cannot do is refused.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <sstream>
#include <string>
#include <vector>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/descriptors/binary_descriptor.hpp"
#include "ft/descriptors/descriptor_model.hpp"
#include "ft/descriptors/vector_descriptor.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/own_descriptor/units.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/room.hpp"
#include "tests/support/room_features.hpp"

namespace own_descriptor_test {

using test::room::pair_features;
using test::room::stereo_frame;

std::vector<stereo_frame> const& walk() {
  static auto const frames = test::room::make_walk(test::room::rig(), 0, 12);
  return frames;
}

/// The walk's keypoints, and what ORB's odometry answers to them.
template <typename Exec>
struct orb_walk {
  std::vector<pair_features> features;
  given_walk given;
  std::vector<ft::tracking> answers;
  std::string map;  ///< at the end

  /// @param partners whether right columns are given, or right keypoints
  orb_walk(Exec const& exec, bool partners) {
    auto const rig = test::room::rig();
    given.params = test::room::odometry_params(4096);
    given.params.own_features = true;
    given.fx = rig.camera.fx;
    given.cx = rig.camera.cx;
    given.cy = rig.camera.cy;
    given.baseline = static_cast<float>(rig.baseline);
    features = test::room::extract(exec, rig, given.params.orb, walk());
    ft::odometry<Exec> odo(exec, rig, given.params, 1, ft::own_features{});
    for (auto const& f : features) {
      given.frames.push_back(partners ? f.with_partners() : f.without_partners());
      auto const n = static_cast<std::int64_t>(given.frames.size());
      answers.push_back(odo.track(given.frames.back(), 50'000'000 * n));
    }
    std::ostringstream to;
    odo.save_map(to);
    map = to.str();
  }
};

void expect_tracked(std::vector<ft::tracking> const& all, std::size_t first) {
  for (std::size_t i = 0; i < all.size(); ++i) {
    auto const T_0w = walk()[0].T_cw.cast<double>();
    auto const T_wc = walk()[first + i].T_cw.cast<double>().inverse();
    auto const d = all[i].T_world_camera.t - (T_0w * T_wc).t;
    EXPECT_EQ(all[i].state, ft::tracking_state::tracking) << i;
    EXPECT_LT(std::sqrt(ft::dot(d, d)), 0.03) << i;
  }
}

void expect_refusals(answers const& a, std::string const& name) {
  EXPECT_NE(a.of_images.find("are the caller's: track(given_features)"), std::string::npos)
      << a.of_images;
  EXPECT_NE(a.of_prefetch.find("no prefetch"), std::string::npos) << a.of_prefetch;
  EXPECT_NE(a.of_places.find("words are those of ORB"), std::string::npos) << a.of_places;
  EXPECT_NE(a.of_bytes.find("descriptor_bytes is 31, must be "), std::string::npos) << a.of_bytes;
  EXPECT_NE(a.of_other_map.find("the map was made with"), std::string::npos) << a.of_other_map;
  EXPECT_NE(a.map.find("descriptor: " + name + " of "), std::string::npos);
}

template <typename Backend>
class own_descriptor : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(own_descriptor, test::backends);

TYPED_TEST(own_descriptor, of_the_same_bits_has_the_answers_of_orb) {
  TypeParam backend;
  for (bool const partners : {true, false}) {
    orb_walk<typename TypeParam::exec_type> const orb(backend.exec, partners);
    answers const own = track_plain_bits(orb.given, orb.map);
    test::expect_same(own.frames, orb.answers);
    expect_tracked(own.frames, 0);
    expect_tracked(own.loaded, 6);
    expect_refusals(own, "plain_bits");
    EXPECT_NE(own.of_other_map.find("'' where this odometry has 'descriptor'"), std::string::npos)
        << own.of_other_map;
    // And the other way round.
    ft::odometry<typename TypeParam::exec_type> odo(backend.exec, test::room::rig(),
                                                    orb.given.params, 1, ft::own_features{});
    std::istringstream from(own.map);
    EXPECT_THROW(odo.load_map(from), ft::error);
  }
}

TYPED_TEST(own_descriptor, of_488_bits_tracks_a_pair) {
  TypeParam backend;
  orb_walk<typename TypeParam::exec_type> const orb(backend.exec, false);
  answers const own = track_more_bits(orb.given, orb.map);
  expect_tracked(own.frames, 0);
  expect_tracked(own.loaded, 6);
  expect_refusals(own, "more_bits");
}

TYPED_TEST(own_descriptor, of_numbers_tracks_a_camera_with_depths) {
  TypeParam backend;
  orb_walk<typename TypeParam::exec_type> const orb(backend.exec, true);
  given_walk given = orb.given;
  for (auto& f : given.frames) { f.left.right_x = nullptr; }
  answers const own = track_small_numbers(given, orb.map);
  expect_tracked(own.frames, 0);
  expect_tracked(own.loaded, 6);
  expect_refusals(own, "small_numbers");
}

// ---- distances as searches compare them

template <int Bits>
using bits_scale = ft::detail::search_scale<ft::binary_descriptor<Bits>>;

TEST(search_scale, takes_integers_of_nine_bits_as_they_are) {
  for (int d = 0; d <= 256; ++d) { ASSERT_EQ(bits_scale<256>::of(d), d); }
  for (int d = 0; d <= 488; ++d) { ASSERT_EQ(bits_scale<488>::of(d), d); }
  EXPECT_EQ(bits_scale<256>::most, 256);
  EXPECT_EQ(bits_scale<488>::most, 488);
  for (int limit = 0; limit <= 256; ++limit) { ASSERT_EQ(bits_scale<256>::limit(limit), limit); }
  EXPECT_EQ(bits_scale<488>::limit(100), 190);
}

TEST(search_scale, counts_others_in_steps) {
  using scale = bits_scale<1024>;  // 256 are near
  for (int d = 0; d <= 1024; ++d) { ASSERT_EQ(scale::of(d), d / 2 < 510 ? d / 2 : 510); }
  EXPECT_EQ(scale::limit(64), 128);
  EXPECT_EQ(scale::limit(256), 509);
  EXPECT_EQ(scale::of(std::numeric_limits<int>::max()), 510);
}

struct far_numbers : ft::vector_descriptor<float, 64> {
  static constexpr ft::descriptor_rules<float> rules{-1, 1e7f, 3, 9, 10};
};

TEST(search_scale, counts_floats_and_takes_what_is_no_number_for_the_farthest) {
  using scale = ft::detail::search_scale<far_numbers>;  // 128 steps in 3
  EXPECT_EQ(scale::of(-1.1f), 0);
  EXPECT_EQ(scale::of(0.0f), 0);
  EXPECT_EQ(scale::of(0.03f), 1);
  EXPECT_EQ(scale::of(3.0f), 128);
  EXPECT_EQ(scale::of(11.9f), 507);
  constexpr float infinity = std::numeric_limits<float>::infinity();
  for (float const v :
       {12.0f, 1e7f, infinity, -infinity, std::numeric_limits<float>::quiet_NaN()}) {
    EXPECT_EQ(scale::of(v), 510);
  }
  EXPECT_EQ(scale::limit(100), 200);
}

TEST(search_scale, tells_products_of_rows_apart) {
  using of_bytes = ft::vector_descriptor<std::int8_t, 128, ft::dot_product>;
  using bytes = ft::detail::search_scale<of_bytes>;
  int const near = of_bytes::rules.near;
  EXPECT_EQ(bytes::of(of_bytes::rules.least), 0);
  EXPECT_EQ(bytes::of(near / 2), 63);
  EXPECT_EQ(bytes::of(near), 128);
  EXPECT_EQ(bytes::of(2 * near), 256);
  EXPECT_EQ(bytes::of(of_bytes::rules.greatest), 510);
  using floats = ft::detail::search_scale<ft::vector_descriptor<float, 64, ft::dot_product>>;
  EXPECT_EQ(floats::of(-0.1f), 0);
  EXPECT_EQ(floats::of(0.2450001f), 128);
  EXPECT_EQ(floats::of(1.0f), 510);
}

TEST(search_scale, of_rows_that_do_not_keep_the_rules_stays_in_its_range) {
  EXPECT_EQ(bits_scale<256>::of(-5), 0);
  EXPECT_EQ(bits_scale<256>::of(std::numeric_limits<int>::max()), 256);
  EXPECT_EQ(bits_scale<1024>::of(std::numeric_limits<int>::min()), 0);
}

#if !defined(__CUDACC__)
TEST(own_descriptor, a_frame_may_have_a_left_image_alone) {
  float const positions[] = {100, 100, 200, 150};
  EXPECT_EQ(keypoints_of_a_frame(2, positions, 1), 2);
}
#endif

}  // namespace own_descriptor_test
