// SPDX-License-Identifier: Apache-2.0
// Poses with an IMU: scenes with known states, inputs that cannot be solved, the rules about few
// observations and outliers, and derivatives against finite differences.
#include "ft/kernels/inertial/optimize_inertial_pose.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <functional>
#include <limits>
#include <vector>

#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/inertial_scene.hpp"

namespace inertial_pose_test {

using ft::inertial_pose_status;
using test::angle;
using test::as_tracked;
using test::inertial_pose_batch;
using test::inertial_scene;
using test::inertial_shape;
using test::last_state;
using test::length;
using test::noisy_batch;
using test::turn_of;
using test::with_outliers;
using vector = ft::vec3<double>;
using state = ft::inertial_state<double>;
using wide = ft::strict_double;
inline constexpr float nan = std::numeric_limits<float>::quiet_NaN();
inline constexpr float infinity = std::numeric_limits<float>::infinity();

template <typename Backend>
class inertial_pose : public test::on_backend<Backend> {
protected:
  Backend backend;

  template <typename Rig>
  void run(inertial_scene<Rig> const& scene, inertial_pose_batch& b, bool quirks = false) {
    ft::inertial_pose_params params;
    params.reference_quirks = quirks;
    test::optimize(backend.exec, scene.rig, scene.mount, params, b);
  }
};
TYPED_TEST_SUITE(inertial_pose, test::backends);

template <typename Rig, typename Run>
void find_true_states(Run const& run) {
  inertial_scene<Rig> scene(3);
  inertial_pose_batch b;
  std::vector<test::true_states> truth;
  for (int i = 0; i < test::effort(12); ++i) {
    inertial_shape shape;
    shape.from_last_frame = i % 2 == 1;
    shape.observations = 40 + 60 * i;
    shape.outliers_percent = i % 3 == 0 ? 20 : 0;
    truth.push_back(scene.add(b, shape));
  }
  run(scene, b);
  for (std::size_t i = 0; i < b.size(); ++i) {
    auto const& r = b.result[i];
    ASSERT_EQ(r.status, inertial_pose_status::optimised) << i;
    EXPECT_EQ(r.rounds, 4);
    auto const got = last_state(r);
    // Pixels and points are floats.
    EXPECT_LT(angle(got.R, truth[i].frame.R), 2e-5) << i;
    EXPECT_LT(length(got.p - truth[i].frame.p), 5e-5) << i;
    EXPECT_LT(length(got.v - truth[i].frame.v), 3e-4) << i;
    EXPECT_LT(length(got.bg - truth[i].frame.bg), 1e-4) << i;
    EXPECT_LT(length(got.ba - truth[i].frame.ba), 3e-3) << i;
    auto const stored = ft::body_state(r.stored, scene.mount);
    EXPECT_LT(length(stored.p.template cast<double>() - got.p), 2e-6);
    EXPECT_LT(angle(stored.R.template cast<double>(), got.R), 1e-6);
    int flagged = 0;
    for (int k = 0; k < b.count[i]; ++k) { flagged += b.outlier[b.at(i, k)]; }
    EXPECT_EQ(r.tracked, b.count[i] - flagged);
    EXPECT_GT(r.tracked, b.count[i] * 7 / 10);
    if (i % 3 != 0) { EXPECT_EQ(flagged, 0); }
    EXPECT_EQ(b.next_prior[i].known, 1);
    EXPECT_EQ(b.next_prior[i].state.p.x, got.p.x);
  }
}
TYPED_TEST(inertial_pose, true_states_are_found_with_a_rectified_pair) {
  find_true_states<ft::rectified_rig>([&](auto const& s, auto& b) { this->run(s, b); });
}
TYPED_TEST(inertial_pose, true_states_are_found_with_two_fisheye_cameras) {
  find_true_states<test::inertial_fisheye_rig>([&](auto const& s, auto& b) { this->run(s, b); });
}
TYPED_TEST(inertial_pose, true_states_are_found_with_three_cameras) {
  find_true_states<ft::multi_rig<3>>([&](auto const& s, auto& b) { this->run(s, b); });
}

TYPED_TEST(inertial_pose, one_camera_of_a_rig_is_a_rectified_pair) {
  inertial_scene<ft::rectified_rig> scene(5);
  inertial_pose_batch b = noisy_batch(scene, 4, with_outliers(15));
  this->run(scene, b);
  inertial_pose_batch other = b;
  ft::multi_rig<1> const rig{{{scene.rig.camera, scene.rig.baseline, ft::pose::identity()}}};
  test::optimize(this->backend.exec, rig, scene.mount, {}, other);
  EXPECT_EQ(b.outlier, other.outlier);
  for (std::size_t i = 0; i < b.size(); ++i) {
    EXPECT_EQ(b.result[i].tracked, other.result[i].tracked);
    EXPECT_LT(length(last_state(b.result[i]).p - last_state(other.result[i]).p), 1e-9);
    EXPECT_LT(length(last_state(b.result[i]).v - last_state(other.result[i]).v), 1e-9);
  }
}

// ---- few observations ---------------------------------------------------------------------------

TYPED_TEST(inertial_pose, without_observations_the_frame_is_where_the_imu_says) {
  inertial_scene<ft::rectified_rig> scene(7);
  inertial_pose_batch b;
  std::vector<test::true_states> truth;
  for (int i = 0; i < 2; ++i) {
    inertial_shape shape;
    shape.observations = 0;
    shape.from_last_frame = i == 1;
    truth.push_back(scene.add(b, shape));
  }
  this->run(scene, b);
  for (std::size_t i = 0; i < 2; ++i) {
    auto const& r = b.result[i];
    EXPECT_EQ(r.status, inertial_pose_status::optimised);
    EXPECT_EQ(r.tracked, 0);
    EXPECT_EQ(r.rounds, 1);
    auto const got = last_state(r);
    EXPECT_LT(angle(got.R, truth[i].frame.R), 1e-6);
    EXPECT_LT(length(got.p - truth[i].frame.p), 1e-6);
    EXPECT_LT(length(got.v - truth[i].frame.v), 1e-6);
    EXPECT_EQ(b.next_prior[i].known, 1);
  }
}

TYPED_TEST(inertial_pose, with_fewer_than_ten_terms_one_round_is_made) {
  inertial_scene<ft::rectified_rig> scene(8);
  inertial_pose_batch b;
  int const counts[] = {5, 6, 7, 5, 6, 7};
  int const rounds[] = {1, 1, 4, 1, 4, 4};
  for (int i = 0; i < 6; ++i) {
    inertial_shape shape;
    shape.observations = counts[i];
    shape.from_last_frame = i >= 3;
    scene.add(b, shape);
  }
  this->run(scene, b);
  for (std::size_t i = 0; i < 6; ++i) {
    EXPECT_EQ(b.result[i].rounds, rounds[i]) << i;
    EXPECT_EQ(b.result[i].tracked, counts[i]) << i;
  }
}

TYPED_TEST(inertial_pose, outliers_that_are_not_far_off_return_where_inliers_are_few) {
  inertial_scene<ft::rectified_rig> scene(9);
  inertial_pose_batch b;
  int const clean[] = {20, 40};
  for (int const n : clean) {
    inertial_shape shape;
    shape.observations = n + 3;
    scene.add(b, shape);
    auto& seen = b.observations.back();
    for (std::size_t k = 0; k < 3; ++k) {  // two that may return, one that may not
      seen[k].right_u = -1;
      seen[k].inv_sigma2 = 1;
      seen[k].u += k == 2 ? 30.0f : (k == 0 ? 3.9f : -3.9f);
      b.distance.back()[k] = 15;
    }
  }
  this->run(scene, b);
  EXPECT_EQ(b.result[0].inliers, 20);
  EXPECT_EQ(b.result[0].tracked, 22);
  EXPECT_EQ(b.outlier[b.at(0, 0)], 0);
  EXPECT_EQ(b.outlier[b.at(0, 1)], 0);
  EXPECT_EQ(b.outlier[b.at(0, 2)], 1);
  EXPECT_EQ(b.result[1].inliers, 40);
  EXPECT_EQ(b.result[1].tracked, 40);
  for (int k = 0; k < 3; ++k) { EXPECT_EQ(b.outlier[b.at(1, k)], 1); }
}

TYPED_TEST(inertial_pose, near_points_without_depth_may_err_more) {
  inertial_scene<ft::rectified_rig> scene(10);
  inertial_pose_batch b;
  for (int i = 0; i < 2; ++i) {
    inertial_shape shape;
    shape.observations = 100;
    scene.add(b, shape);
    b.observations.back()[0].right_u = -1;
    b.observations.back()[0].inv_sigma2 = 1;
    b.observations.back()[0].v += 2.75f;  // 7.6, between 5.991 and 1.5 times that
    b.distance.back()[0] = i == 0 ? 9.9f : 10.0f;
  }
  this->run(scene, b);
  EXPECT_EQ(b.outlier[b.at(0, 0)], 0);
  EXPECT_EQ(b.outlier[b.at(1, 0)], 1);
}

// ---- inputs that cannot be solved ---------------------------------------------------------------

TYPED_TEST(inertial_pose, what_cannot_be_solved_is_refused) {
  struct bad {
    inertial_pose_status status;
    std::function<void(inertial_pose_batch&)> spoil;
  };
  auto const back = [](auto& v) -> auto& { return v.back(); };
  std::vector<bad> const all = {
      {inertial_pose_status::no_integral,
       [&](auto& b) { back(b.integral).status = ft::integration_status::no_samples; }},
      {inertial_pose_status::no_integral,
       [&](auto& b) { back(b.integral).status = ft::integration_status::gap; }},
      {inertial_pose_status::no_integral, [&](auto& b) { back(b.integral).steps = 0; }},
      {inertial_pose_status::not_finite, [&](auto& b) { back(b.integral).dT = 0; }},
      {inertial_pose_status::not_finite, [&](auto& b) { back(b.integral).dT = nan; }},
      {inertial_pose_status::not_finite, [&](auto& b) { back(b.integral).C[17] = infinity; }},
      {inertial_pose_status::not_finite, [&](auto& b) { back(b.integral).walk[4] = 0; }},
      {inertial_pose_status::not_finite, [&](auto& b) { back(b.integral).JPa.m[8] = nan; }},
      {inertial_pose_status::not_finite, [&](auto& b) { back(b.first).q_cw.w = nan; }},
      {inertial_pose_status::not_finite, [&](auto& b) { back(b.start).bias.accel.z = nan; }},
      {inertial_pose_status::not_finite,
       [&](auto& b) { back(b.prior).information[224] = static_cast<double>(nan); }},
      {inertial_pose_status::not_finite,
       [&](auto& b) { back(b.prior).state.ba.z = static_cast<double>(infinity); }},
      {inertial_pose_status::no_prior, [&](auto& b) { back(b.prior).known = 0; }},
  };
  inertial_scene<ft::rectified_rig> scene(11);
  inertial_pose_batch b;
  for (auto const& one : all) {
    inertial_shape shape;
    shape.from_last_frame = true;
    shape.observations = 30;
    scene.add(b, shape);
    one.spoil(b);
  }
  scene.add(b, {});  // a good one among them
  this->run(scene, b);
  for (std::size_t i = 0; i < all.size(); ++i) {
    auto const& r = b.result[i];
    EXPECT_EQ(r.status, all[i].status) << i;
    EXPECT_EQ(std::memcmp(&r.stored, &b.start[i], sizeof(r.stored)), 0) << i;
    EXPECT_EQ(r.tracked, 0);
    EXPECT_EQ(r.inliers, 0);
    EXPECT_EQ(r.rounds, 0);
    EXPECT_EQ(b.next_prior[i].known, 0);
    for (int k = 0; k < b.count[i]; ++k) { EXPECT_EQ(b.outlier[b.at(i, k)], 0); }
  }
  EXPECT_EQ(b.result.back().status, inertial_pose_status::optimised);
}

TYPED_TEST(inertial_pose, an_observation_that_is_not_finite_is_an_outlier) {
  inertial_scene<ft::rectified_rig> scene(12);
  inertial_pose_batch b;
  auto const truth = scene.add(b, {});
  auto& seen = b.observations.back();
  seen[0].u = nan;
  seen[1].point.z = infinity;
  seen[2].inv_sigma2 = nan;
  seen[3].right_u = infinity;
  b.distance.back()[4] = nan;
  this->run(scene, b);
  EXPECT_EQ(b.result[0].status, inertial_pose_status::optimised);
  EXPECT_EQ(b.result[0].tracked, b.count[0] - 4);
  for (int k = 0; k < 5; ++k) { EXPECT_EQ(b.outlier[b.at(0, k)], k < 4 ? 1 : 0); }
  EXPECT_LT(length(last_state(b.result[0]).p - truth.frame.p), 5e-5);
}

TYPED_TEST(inertial_pose, a_state_that_nothing_determines_stays) {
  inertial_scene<ft::rectified_rig> scene(13);
  inertial_pose_batch b;
  inertial_shape shape;
  shape.observations = 0;
  scene.add(b, shape);
  for (float& c : b.integral.back().C) { c = 0; }
  this->run(scene, b);
  EXPECT_EQ(b.result[0].status, inertial_pose_status::ended_early);
  auto const start = ft::body_state(b.start[0], scene.mount);
  EXPECT_LT(length(last_state(b.result[0]).p - start.p.cast<double>()), 1e-12);
  EXPECT_EQ(b.result[0].tracked, 0);
}

/// Some are off by a third of a pixel, which are no outliers.
TYPED_TEST(inertial_pose, aligned_keypoints_that_are_off_count_less) {
  inertial_scene<ft::rectified_rig> scene(13);
  inertial_pose_batch b;
  inertial_shape shape;
  shape.observations = 160;
  shape.imu_steps = 300;
  auto const truth = scene.add(b, shape);
  for (std::size_t i = 0; i < b.observations[0].size(); ++i) {
    ft::observation& o = b.observations[0][i];
    o.inv_sigma2 = ft::weight_of_aligned;
    if (i % 8 == 0) {
      o.u += 0.35f;
      o.right_u += o.right_u < 0 ? 0.0f : 0.35f;
    }
  }
  auto const error = [&] {
    this->run(scene, b);
    EXPECT_EQ(b.result[0].tracked, 160);
    return length(last_state(b.result[0]).p - truth.frame.p);
  };
  double const as_corners = error();
  b.moves.assign(160, 0.0f);
  EXPECT_GT(as_corners, 1e-4);
  EXPECT_LT(error(), as_corners / 2);
}

// ---- one body on all executors ------------------------------------------------------------------

template <typename Rig, typename Run>
void compare_with_one_thread(Run const& run, unsigned seed) {
  inertial_scene<Rig> scene(seed);
  inertial_pose_batch b;
  int const counts[] = {0, 4, 31, 32, 33, 150, 511, 512, 513, 1100};
  for (int i = 0; i < 20; ++i) {
    inertial_shape shape;
    shape.observations = counts[i / 2];
    shape.from_last_frame = i % 2 == 1;
    shape.pixel_noise = 1;
    shape.outliers_percent = 5 * i;
    shape.imu_steps = i % 5 == 4 ? 1 : 1 + 3 * i;
    scene.add(b, shape);
  }
  b.moves.resize(b.size() * 1100);
  for (std::size_t i = 0; i < b.moves.size(); ++i) { b.moves[i] = static_cast<float>(i % 3) - 1; }
  inertial_pose_batch alone = b;
  run(scene, b);
  test::optimize(ft::host_exec(1), scene.rig, scene.mount, {}, alone);
  for (std::size_t i = 0; i < b.size(); ++i) {
    auto const& x = b.result[i];
    auto const& y = alone.result[i];
    EXPECT_EQ(x.status, y.status) << i;
    EXPECT_EQ(x.tracked, y.tracked) << i;
    EXPECT_EQ(x.inliers, y.inliers) << i;
    ASSERT_EQ(x.rounds, y.rounds) << i;
    EXPECT_EQ(std::memcmp(&x.stored, &y.stored, sizeof(x.stored)), 0) << i;
    EXPECT_EQ(std::memcmp(x.round_state, y.round_state,
                          sizeof(state) * static_cast<std::size_t>(x.rounds)),
              0)
        << i;
    EXPECT_EQ(std::memcmp(&b.next_prior[i], &alone.next_prior[i], sizeof(double) * 246), 0) << i;
    for (int k = 0; k < b.count[i]; ++k) {
      ASSERT_EQ(b.outlier[b.at(i, k)], alone.outlier[b.at(i, k)]) << i << " " << k;
      for (int r = 0; r < x.rounds; ++r) {
        float const c = b.chi2_of(i, r, k);
        float const d = alone.chi2_of(i, r, k);
        ASSERT_EQ(std::memcmp(&c, &d, sizeof(c)), 0) << i << " " << k << " " << c << " " << d;
      }
    }
  }
}
TYPED_TEST(inertial_pose, all_executors_give_the_same_bits) {
  auto const run = [&](auto const& s, auto& b) { this->run(s, b); };
  for (unsigned seed = 20; seed < 20u + static_cast<unsigned>(test::effort(3)); ++seed) {
    compare_with_one_thread<ft::rectified_rig>(run, seed);
    compare_with_one_thread<test::inertial_fisheye_rig>(run, seed);
    compare_with_one_thread<ft::multi_rig<3>>(run, seed);
  }
}

// ---- derivatives --------------------------------------------------------------------------------

inline ft::detail::strict_vec3d widened(vector v) { return v.cast<wide>(); }
inline ft::detail::wide_state widened(state const& s) { return ft::detail::cast_state<wide>(s); }

/// A state after a small change: in the body's frame, of 15 unknowns.
inline state changed(state s, int unknown, double by) {
  double d[15] = {};
  d[unknown] = by;
  s.p = s.p + s.R * vector{d[3], d[4], d[5]};
  s.R = s.R * test::rotation_about({d[0], d[1], d[2]});
  s.v = s.v + vector{d[6], d[7], d[8]};
  s.bg = s.bg + vector{d[9], d[10], d[11]};
  s.ba = s.ba + vector{d[12], d[13], d[14]};
  return s;
}
inline ft::detail::inertial_rows rows_of(ft::detail::inertial_link const& link, state const& one,
                                         state const& two, ft::imu_mount const& mount) {
  ft::detail::inertial_rows rows;
  rows.clear(ft::single_group{});
  auto const m = ft::detail::pose_mount::of(mount);
  link.write_rotation(widened(one), widened(two), m, rows);
  link.write_motion(widened(one), widened(two), m, rows);
  return rows;
}

TEST(inertial_derivatives, those_of_an_integral_are_its_differences) {
  inertial_scene<ft::rectified_rig> scene(30);
  constexpr double h = 1e-6;
  for (int round = 0; round < 5; ++round) {
    inertial_pose_batch b;
    auto const truth = scene.add(b, {});
    auto const link = ft::detail::inertial_link::of(b.integral[0], ft::standard_gravity());
    state one = scene.disturbed(truth.first, 0.05);
    one.bg = one.bg + scene.vector(0.02);
    one.ba = one.ba + scene.vector(0.1);
    state const two = scene.disturbed(truth.frame, 0.05);
    auto const rows = rows_of(link, one, two, scene.mount);
    constexpr int error = ft::detail::unknown::all;
    auto const T_cb = scene.mount.T_cb.cast<double>();
    for (int column = 0; column < ft::detail::unknown::all; ++column) {
      auto const at = [&](double by) {
        if (column < 15) { return rows_of(link, changed(one, column, by), two, scene.mount); }
        // The frame moves in the frame of its pose.
        double d[9] = {};
        d[column - 15] = by;
        vector const turn = T_cb.R.transposed() * vector{d[0], d[1], d[2]};
        vector const shift =
            T_cb.R.transposed() * (vector{d[3], d[4], d[5]} - cross(T_cb.t, {d[0], d[1], d[2]}));
        state s = two;
        s.p = s.p + s.R * shift;
        s.R = s.R * test::rotation_about(turn);
        s.v = s.v + vector{d[6], d[7], d[8]};
        return rows_of(link, one, s, scene.mount);
      };
      auto const more = at(h);
      auto const less = at(-h);
      for (int r = 0; r < 9; ++r) {
        double const slope = (more.J[r][error] - less.J[r][error]).value / (2 * h);
        // Of a few angles in rad: Jr of the bias' turn is exact to second order.
        EXPECT_NEAR(rows.J[r][column].value, slope, 1e-6) << r << " " << column;
      }
    }
  }
}

TEST(inertial_derivatives, errors_of_an_integral_are_those_of_the_paper) {
  inertial_scene<ft::rectified_rig> scene(31);
  inertial_pose_batch b;
  auto const truth = scene.add(b, {});
  auto const link = ft::detail::inertial_link::of(b.integral[0], ft::standard_gravity());
  auto const at_truth = rows_of(link, truth.first, truth.frame, scene.mount);
  for (int r = 0; r < 9; ++r) { EXPECT_NEAR(at_truth.J[r][24].value, 0, 1e-6); }
  // A frame that is turned, shifted and faster errs by just that, in the first body's frame.
  vector const turn{0.02, -0.3, 0.1};
  state s = truth.frame;
  s.R = s.R * test::rotation_about(turn);
  s.v = s.v + truth.first.R * vector{1, 2, 3};
  s.p = s.p + truth.first.R * vector{4, 5, 6};
  auto const rows = rows_of(link, truth.first, s, scene.mount);
  double const want[9] = {turn.x, turn.y, turn.z, 1, 2, 3, 4, 5, 6};
  for (int r = 0; r < 9; ++r) { EXPECT_NEAR(rows.J[r][24].value, want[r], 1e-6) << r; }
}

TEST(inertial_derivatives, those_of_a_prior_are_its_differences) {
  inertial_scene<ft::rectified_rig> scene(32);
  constexpr double h = 1e-6;
  inertial_pose_batch b;
  auto const prior = scene.add(b, {}).first;
  state const now = scene.disturbed(prior, 0.2);
  ft::detail::prior_residual at{};
  at.set(widened(prior), widened(now));
  for (int column = 0; column < 15; ++column) {
    ft::detail::prior_residual more{};
    ft::detail::prior_residual less{};
    more.set(widened(prior), widened(changed(now, column, h)));
    less.set(widened(prior), widened(changed(now, column, -h)));
    for (int r = 0; r < 15; ++r) {
      double const slope = (more.error[r] - less.error[r]).value / (2 * h);
      wide unit[15] = {};
      unit[r] = 1.0;
      double const own = at.transposed_times(column, unit, 1).value;
      EXPECT_NEAR(own, slope, 1e-6) << r << " " << column;
    }
  }
}

template <typename Rig>
void compare_projections(unsigned seed) {
  inertial_scene<Rig> scene(seed);
  inertial_pose_batch b;
  inertial_shape shape;
  shape.observations = 60;
  scene.add(b, shape);
  auto const pose = ft::detail::pose_mount::of(scene.mount)
                        .pose_of(widened(state{
                            test::rotation_about({0.1, 0.2, -0.1}), {0.1, 0.2, 0.3}, {}, {}, {}}));
  for (auto o : b.observations[0]) {
    // In front of all cameras.
    auto const in_pose = vector{o.point.x, o.point.y, 8}.cast<wide>();
    o.point = (pose.inverse() * in_pose).template cast<float>();
    ft::detail::visual_residual<Rig> const r(scene.rig, pose, o);
    vector const p = r.in_pose.template cast<double>();
    auto const seen = test::image_in(scene.rig, o.camera, p);
    double const tolerance = Rig::rectified ? 1e-9 : 2e-4;  // angles are floats
    EXPECT_NEAR(r.error[0].value, static_cast<double>(o.u) - seen.pixel.x, tolerance);
    EXPECT_NEAR(r.error[1].value, static_cast<double>(o.v) - seen.pixel.y, tolerance);
    if (o.right_u >= 0) {
      EXPECT_EQ(r.rows, 3);
      EXPECT_NEAR(r.error[2].value, static_cast<double>(o.right_u) - seen.right_u, 1e-5);
    }
    constexpr double h = 1e-6;
    for (int k = 0; k < 3; ++k) {
      vector const step{k == 0 ? h : 0, k == 1 ? h : 0, k == 2 ? h : 0};
      auto const more = test::image_in(scene.rig, o.camera, p + step);
      auto const less = test::image_in(scene.rig, o.camera, p - step);
      EXPECT_NEAR(r.P.m[k].value, (more.pixel.x - less.pixel.x) / (2 * h), 2e-4);
      EXPECT_NEAR(r.P.m[3 + k].value, (more.pixel.y - less.pixel.y) / (2 * h), 2e-4);
      double const right = o.right_u >= 0 ? (more.right_u - less.right_u) / (2 * h) : 0;
      EXPECT_NEAR(r.P.m[6 + k].value, right, 2e-4);
    }
  }
}
TEST(inertial_derivatives, those_of_projections_are_their_differences) {
  compare_projections<ft::rectified_rig>(40);
  compare_projections<test::inertial_fisheye_rig>(41);
  compare_projections<ft::multi_rig<3>>(42);
}

TEST(wide_rotation_unit, logarithm_and_jacobians_belong_to_the_exponential) {
  using namespace ft::detail;
  for (double const size : {0.0, 1e-9, 1e-6, 1e-4, 0.01, 0.2, 0.26, 1.0, 2.0, 3.0}) {
    vector const w{0.36 * size, -0.48 * size, 0.8 * size};
    auto const E = rotation_exp(widened(w)).cast<double>();
    auto const want = test::rotation_about(w);
    for (int k = 0; k < 9; ++k) { EXPECT_NEAR(E.m[k], want.m[k], 1e-15) << size; }
    vector const log = rotation_log(rotation_exp(widened(w))).cast<double>();
    EXPECT_LT(length(log - w), 1e-12 + 1e-10 * size) << size;
    // Exp(w + d) = Exp(w) Exp(Jr d).
    constexpr double h = 1e-6;
    auto const J = rotation_jacobian(widened(w)).cast<double>();
    for (int k = 0; k < 3; ++k) {
      vector const d{k == 0 ? h : 0, k == 1 ? h : 0, k == 2 ? h : 0};
      auto const more = test::rotation_about(w + d);
      auto const less = test::rotation_about(w - d);
      vector const slope = turn_of(less.transposed() * more);
      double const tolerance = size < 1e-5 ? 1e-5 : 1e-8;
      EXPECT_NEAR(J.m[k], slope.x / (2 * h), tolerance) << size;
      EXPECT_NEAR(J.m[3 + k], slope.y / (2 * h), tolerance) << size;
      EXPECT_NEAR(J.m[6 + k], slope.z / (2 * h), tolerance) << size;
    }
    auto const product = J * inverse_rotation_jacobian(widened(w)).cast<double>();
    for (int k = 0; k < 9; ++k) { EXPECT_NEAR(product.m[k], k % 4 == 0 ? 1 : 0, 1e-13) << size; }
  }
}

}  // namespace inertial_pose_test
