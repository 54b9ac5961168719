// SPDX-License-Identifier: Apache-2.0
// Pose optimisation on scenes with a known pose, on inputs that cannot be solved, and its
// derivatives.
#include "ft/kernels/pose/optimize_frame.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/core/execution.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/example_rigs.hpp"

namespace pose_test {

using test::example_rig;
using test::fisheye_rig;
using test::motion;
using test::three_camera_rig;
using test::turn;
inline constexpr float nan = std::numeric_limits<float>::quiet_NaN();
inline constexpr float infinity = std::numeric_limits<float>::infinity();

/// Pixel of a point given in the frame of the pose, in double.
inline ft::vec2<double> pixel_of(ft::rectified_rig const& rig, ft::vec3<double> p, int) {
  return rig.camera.cast<double>().project(p).pixel;
}
inline ft::vec2<double> pixel_of(fisheye_rig const& rig, ft::vec3<double> p, int camera) {
  return camera == 0 ? rig.left.cast<double>().project(p).pixel
                     : rig.right.cast<double>().project(rig.T_rl.cast<double>() * p).pixel;
}

inline ft::vec2<double> pixel_of(three_camera_rig const& rig, ft::vec3<double> p, int camera) {
  auto const& of = rig.of[camera];
  return of.camera.cast<double>().project(of.T_cb.cast<double>() * p).pixel;
}
/// Difference of the columns in a rectified pair, pixels.
inline double disparity_of(ft::rectified_rig const& rig, ft::vec3<double> p, int) {
  return static_cast<double>(rig.bf()) / p.z;
}
inline double disparity_of(three_camera_rig const& rig, ft::vec3<double> p, int camera) {
  auto const& of = rig.of[camera];
  return static_cast<double>(of.bf()) / (of.T_cb.cast<double>() * p).z;
}
struct scene {
  std::vector<ft::observation> observations;
  std::vector<unsigned char> outlier;  ///< made one on purpose
  motion truth;
  ft::pose start;
};

/// Points seen from a known pose by the cameras in turn; of a rectified pair every second in
/// stereo; some with a wrong pixel.
template <typename Rig>
scene make_scene(Rig const& rig, int n, double share_of_outliers, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> unit(-1, 1);
  scene s;
  s.truth = turn({0.3, -0.7, 0.2}, 0.8, {0.5, -0.2, 1.1});
  s.start = (turn({unit(random), unit(random), unit(random)}, 0.04, {0.05, -0.04, 0.06}) * s.truth)
                .template cast<float>();
  for (int i = 0; i < n; ++i) {
    double const depth = 2 + 5 * (1 + unit(random));
    ft::vec3<double> const seen{0.6 * depth * unit(random), 0.5 * depth * unit(random), depth};
    ft::vec3<double> const world = s.truth.inverse() * seen;
    int const second = i % 2;
    ft::observation o{};
    o.point = {static_cast<float>(world.x), static_cast<float>(world.y),
               static_cast<float>(world.z)};
    bool const bad = std::uniform_real_distribution<double>(0, 1)(random) < share_of_outliers;
    double const error_u = bad ? (unit(random) > 0 ? 1 : -1) * (30 + 20 * unit(random)) : 0;
    double const error_v = bad ? (unit(random) > 0 ? 1 : -1) * (30 + 20 * unit(random)) : 0;
    o.camera = i % Rig::cameras;
    auto const pixel = pixel_of(rig, seen, o.camera);
    o.u = static_cast<float>(pixel.x + error_u);
    o.v = static_cast<float>(pixel.y + error_v);
    o.right_u = -1;
    if constexpr (Rig::rectified) {
      double const right = pixel.x - disparity_of(rig, seen, o.camera);
      bool const stereo = second != 0 && !rig.pair(o.camera).single();
      if (stereo && right >= 0) { o.right_u = static_cast<float>(right); }
    }
    o.inv_sigma2 = static_cast<float>(std::pow(1.44, -(i % 5)));
    s.observations.push_back(o);
    s.outlier.push_back(static_cast<unsigned char>(bad));
  }
  return s;
}

struct result {
  ft::pose pose;
  std::vector<unsigned char> outlier;
  int inliers;
};

/// Largest difference of entries.
inline double distance(ft::pose const& a, motion const& b) {
  auto const wide = a.cast<double>();
  double worst = std::max(
      {std::abs(wide.t.x - b.t.x), std::abs(wide.t.y - b.t.y), std::abs(wide.t.z - b.t.z)});
  for (int i = 0; i < 9; ++i) { worst = std::max(worst, std::abs(wide.R.m[i] - b.R.m[i])); }
  return worst;
}
inline bool same_bits(ft::pose const& a, ft::pose const& b) {
  bool same = a.t.x == b.t.x && a.t.y == b.t.y && a.t.z == b.t.z;
  for (int i = 0; i < 9; ++i) { same = same && a.R.m[i] == b.R.m[i]; }
  return same;
}
inline bool is_rigid(ft::pose const& a) {
  auto const product = a.cast<double>().R * a.cast<double>().R.transposed();
  for (int i = 0; i < 9; ++i) {
    if (!(std::abs(product.m[i] - (i % 4 == 0 ? 1.0 : 0.0)) < 1e-5)) { return false; }  // NaN, too
  }
  return std::isfinite(a.t.x) && std::isfinite(a.t.y) && std::isfinite(a.t.z);
}
inline int number_of_inliers(std::vector<unsigned char> const& outlier) {
  return static_cast<int>(std::count(outlier.begin(), outlier.end(), 0));
}

/// What an observation says of a pose, in double and by the cameras' models alone.
struct seen_error {
  double chi2;
  bool stereo;
};
template <typename Rig>
seen_error error_of(Rig const& rig, motion const& T_cw, ft::observation const& o) {
  ft::vec3<double> const seen = T_cw * ft::vec3<double>{o.point.x, o.point.y, o.point.z};
  auto const pixel = pixel_of(rig, seen, o.camera);
  double const u = static_cast<double>(o.u) - pixel.x;
  double const v = static_cast<double>(o.v) - pixel.y;
  double sum = u * u + v * v;
  bool stereo = false;
  if constexpr (Rig::rectified) {
    stereo = o.right_u >= 0;
    double const right =
        static_cast<double>(o.right_u) - (pixel.x - disparity_of(rig, seen, o.camera));
    if (stereo) { sum += right * right; }
  }
  return {sum * static_cast<double>(o.inv_sigma2), stereo};
}
/// The sum that a robust round makes least: Huber's, over all observations.
template <typename Rig>
double robust_cost(Rig const& rig, motion const& T_cw, std::vector<ft::observation> const& all) {
  double sum = 0;
  for (auto const& o : all) {
    seen_error const e = error_of(rig, T_cw, o);
    double const limit = e.stereo ? 7.815 : 5.991;
    sum += e.chi2 <= limit ? e.chi2 : 2 * std::sqrt(limit * e.chi2) - limit;
  }
  return sum;
}
/// How much less the robust cost is 1e-3 rad or m away in any of the 6 directions; 0 = not at all.
template <typename Rig>
double robust_descent(Rig const& rig, motion const& T_cw, std::vector<ft::observation> const& all) {
  double const here = robust_cost(rig, T_cw, all);
  double least = here;
  for (int k = 0; k < 12; ++k) {
    double const side = k % 2 == 0 ? 1 : -1;
    double const d[3] = {k / 2 % 3 == 0 ? side : 0, k / 2 % 3 == 1 ? side : 0,
                         k / 2 % 3 == 2 ? side : 0};
    motion const step = k < 6 ? turn({d[0], d[1], d[2]}, 1e-3, {0, 0, 0})
                              : turn({0, 0, 0}, {1e-3 * d[0], 1e-3 * d[1], 1e-3 * d[2]});
    least = std::min(least, robust_cost(rig, step * T_cw, all));
  }
  return here - least;
}

/// Analytic and numeric derivatives of one observation.
struct derivatives {
  double analytic[3][6];
  double numeric[3][6];
  double error[3];
  int rows;
};
template <typename Rig>
struct differentiate {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, Rig const& rig,
                                 ft::observation const* observations, ft::pose const& T_cw,
                                 double step, derivatives* out) const {
    using real = ft::strict_double;
    ft::observation const o = observations[i];
    auto const T = T_cw.template cast<real>();
    ft::detail::reprojection<Rig, real, true> const here(rig, T, o);
    auto const P = here.derivative(rig, o);
    auto const row = [&](int r) {
      return ft::vec3<real>{P.m[3 * r], P.m[3 * r + 1], P.m[3 * r + 2]};
    };
    auto const& p = here.in_body;
    derivatives& d = out[i];
    d.rows = here.rows;
    for (int r = 0; r < 3; ++r) {
      d.error[r] = here.error[r].value;
      // A small twist (w, t) moves the point by w x p + t.
      auto const by_point = row(r);
      auto const by_turn = cross(p, by_point);
      real const J[6] = {by_turn.x, by_turn.y, by_turn.z, by_point.x, by_point.y, by_point.z};
      for (int k = 0; k < 6; ++k) { d.analytic[r][k] = J[k].value; }
    }
    for (int k = 0; k < 6; ++k) {
      real twist[6] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
      twist[k] = step;
      ft::detail::reprojection<Rig> const ahead(rig, ft::detail::exp_se3(twist) * T, o);
      twist[k] = -step;
      ft::detail::reprojection<Rig> const behind(rig, ft::detail::exp_se3(twist) * T, o);
      // Errors are measured minus predicted.
      for (int r = 0; r < 3; ++r) {
        d.numeric[r][k] = ((behind.error[r] - ahead.error[r]) / (2 * step)).value;
      }
    }
  }
};

template <typename Backend>
class pose_unit : public test::on_backend<Backend> {
protected:
  static constexpr ft::memory_space space = Backend::exec_type::space;
  Backend backend;

  template <typename Rig>
  result solve(Rig const& rig, std::vector<ft::observation> const& observations,
               ft::pose const& start) {
    auto const& exec = backend.exec;
    auto const n = observations.size();
    auto const d_observations = test::to_exec(exec, observations);
    auto const d_start = test::to_exec(exec, std::vector<ft::pose>{start});
    auto const d_result = test::to_exec(exec, std::vector<ft::pose>{ft::pose{}});
    auto const d_outlier = test::to_exec(exec, std::vector<unsigned char>(n + 1, 77));
    auto const d_inliers = test::to_exec(exec, std::vector<int>{-1});
    ft::optimize_pose(exec, rig,
                      {d_observations.data(), static_cast<int>(n), d_start.data(), d_result.data(),
                       d_outlier.data(), d_inliers.data()});
    result r;
    r.pose = test::from_exec(exec, d_result.data(), 1)[0];
    r.outlier = test::from_exec(exec, d_outlier);
    EXPECT_EQ(r.outlier.back(), 77) << "nothing is written past the end";
    r.outlier.pop_back();
    r.inliers = test::from_exec(exec, d_inliers.data(), 1)[0];
    EXPECT_EQ(r.inliers, n < 3 ? 0 : number_of_inliers(r.outlier))
        << "the number is that of the flags";
    return r;
  }

  template <typename Rig>
  void check_recovery() {
    auto const rig = example_rig<Rig>();
    for (int const n : {3, 4, 10, 127, 255, 256, 257, 600, 1500}) {
      auto const s = make_scene(rig, n, 0, static_cast<unsigned>(n));
      auto const r = solve(rig, s.observations, s.start);
      EXPECT_LT(distance(r.pose, s.truth), n < 10 ? 1e-2 : 1e-3) << n;
      EXPECT_EQ(r.inliers, n);
    }
    for (unsigned seed = 0; seed < 5; ++seed) {
      auto const s = make_scene(rig, seed == 0 ? 1500 : 200, 0.2, seed);
      auto const r = solve(rig, s.observations, s.start);
      EXPECT_LT(distance(r.pose, s.truth), 1e-3) << seed;
      EXPECT_EQ(r.outlier, s.outlier) << seed;
      EXPECT_TRUE(is_rigid(r.pose));
    }
  }

  template <typename Rig>
  void check_too_few() {
    auto const rig = example_rig<Rig>();
    auto const s = make_scene(rig, 2, 0, 1);
    for (std::size_t n = 0; n < 3; ++n) {
      std::vector<ft::observation> const few(
          s.observations.begin(), s.observations.begin() + static_cast<std::ptrdiff_t>(n));
      auto const r = solve(rig, few, s.start);
      EXPECT_EQ(r.inliers, 0);
      EXPECT_TRUE(same_bits(r.pose, s.start)) << "the pose is left alone";
      for (auto const flag : r.outlier) { EXPECT_EQ(flag, 0); }
    }
  }

  /// One of the observations is false. With nine the answer is that of the first, robust round;
  /// with ten it is that of the others alone.
  template <typename Rig>
  void check_first_round_alone() {
    auto const rig = example_rig<Rig>();
    for (unsigned seed = 0; seed < 8; ++seed) {
      for (int const n : {3, 8, 9, 10, 11}) {
        SCOPED_TRACE(std::to_string(n) + " observations, seed " + std::to_string(seed));
        auto s = make_scene(rig, n, 0, 40 + seed);
        s.observations[1].u += 20;
        auto const r = solve(rig, s.observations, s.start);
        motion const found = r.pose.template cast<double>();
        if (n >= 10) {
          EXPECT_LT(distance(r.pose, s.truth), 1e-3);
          EXPECT_GT(robust_descent(rig, found, s.observations), 1e-3);
        } else if (n > 3) {
          EXPECT_EQ(robust_descent(rig, found, s.observations), 0);
        }
        for (std::size_t i = 0; i < s.observations.size(); ++i) {
          seen_error const e = error_of(rig, found, s.observations[i]);
          double const limit = e.stereo ? 7.815 : 5.991;
          if (std::abs(e.chi2 - limit) < 0.05) { continue; }
          EXPECT_EQ(r.outlier[i], e.chi2 > limit ? 1 : 0) << i << ": " << e.chi2;
        }
      }
    }
  }

  /// Observations that no pose explains.
  template <typename Rig>
  void check_points_behind() {
    auto const rig = example_rig<Rig>();
    auto s = make_scene(rig, 60, 0, 3);
    for (auto& o : s.observations) {
      ft::vec3<double> const seen = s.truth * ft::vec3<double>{o.point.x, o.point.y, o.point.z};
      ft::vec3<double> const world =
          s.truth.inverse() * ft::vec3<double>{seen.x, seen.y + 1.0, -seen.z};
      o.point = {static_cast<float>(world.x), static_cast<float>(world.y),
                 static_cast<float>(world.z)};
    }
    auto const r = solve(rig, s.observations, s.start);
    EXPECT_TRUE(is_rigid(r.pose));
    EXPECT_LT(r.inliers, 30);
  }

  /// One bad observation among 100 good ones, at `at`.
  template <typename Rig>
  result solve_with(scene& s, std::size_t at, ft::observation const& bad) {
    s.observations[at] = bad;
    return solve(example_rig<Rig>(), s.observations, s.start);
  }
  template <typename Rig>
  std::vector<ft::observation> bad_observations(ft::observation const& good) {
    std::vector<ft::observation> all(7, good);
    all[0].point = {nan, nan, nan};
    all[1].point.z = nan;
    all[2].point.x = infinity;
    all[3].u = nan;
    all[4].v = -infinity;
    all[5].inv_sigma2 = nan;
    all[6].point.y = -infinity;
    return all;
  }
  template <typename Rig>
  void check_bad_observation_is_flagged() {
    auto const rig = example_rig<Rig>();
    auto const s = make_scene(rig, 100, 0, 4);
    for (std::size_t const at : {0u, 1u, 99u}) {
      for (auto const& bad : bad_observations<Rig>(s.observations[at])) {
        auto copy = s;
        auto const r = solve_with<Rig>(copy, at, bad);
        EXPECT_TRUE(is_rigid(r.pose));
        EXPECT_EQ(r.outlier[at], 1);
      }
    }
  }
  template <typename Rig>
  void check_bad_observation_spoils_nothing() {
    auto const rig = example_rig<Rig>();
    auto const s = make_scene(rig, 100, 0, 5);
    for (auto const& bad : bad_observations<Rig>(s.observations[7])) {
      auto copy = s;
      auto const r = solve_with<Rig>(copy, 7, bad);
      EXPECT_LT(distance(r.pose, s.truth), 1e-3);
      EXPECT_EQ(r.inliers, 99);
    }
  }

  template <typename Rig>
  void check_jacobian(double step, double tolerance, bool stereo) {
    auto const& exec = backend.exec;
    auto const rig = example_rig<Rig>();
    auto s = make_scene(rig, 100, 0, 6);
    for (auto& o : s.observations) {
      if (!stereo) { o.right_u = -1; }
    }
    auto const n = s.observations.size();
    auto const d_observations = test::to_exec(exec, s.observations);
    auto const d_out = test::to_exec(exec, std::vector<derivatives>(n, derivatives{}));
    ft::for_each_item<ft::per_thread>(exec, static_cast<int>(n), differentiate<Rig>{}, rig,
                                      d_observations.data(), s.start, step, d_out.data());
    auto const out = test::from_exec(exec, d_out);
    int with_three = 0;
    for (std::size_t i = 0; i < n; ++i) {
      EXPECT_EQ(out[i].rows, s.observations[i].right_u >= 0 ? 3 : 2);
      with_three += static_cast<int>(out[i].rows == 3);
      for (int r = 0; r < out[i].rows; ++r) {
        double size = 0;
        for (int k = 0; k < 6; ++k) { size = std::max(size, std::abs(out[i].analytic[r][k])); }
        for (int k = 0; k < 6; ++k) {
          EXPECT_NEAR(out[i].analytic[r][k], out[i].numeric[r][k], tolerance * size)
              << "observation " << i << " row " << r << " column " << k;
        }
      }
    }
    EXPECT_EQ(with_three > 20, stereo);
  }

  /// Frames of a batch, from keypoints that hold map points; the last has nine, one of them false.
  template <typename Rig>
  void check_frames() {
    auto const& exec = backend.exec;
    auto const rig = example_rig<Rig>();
    auto const geometry = ft::pyramid_geometry::make(752, 480, 8, 1.2f);
    constexpr int batch = 3;
    constexpr int capacity = 160;
    constexpr int points = 300;
    constexpr int cameras = Rig::rectified ? 1 : 2;
    constexpr int numbers = cameras * capacity;
    std::vector<scene> scenes;
    ft::keypoints<ft::memory_space::host> const kp(capacity, 2 * batch);
    ft::map_points<ft::memory_space::host> const map(points, batch);
    std::vector<int> holder(batch * numbers, -1);
    std::vector<float> right_x(batch * capacity, -1.0f);
    for (int b = 0; b < batch; ++b) {
      bool const few = b == 2;
      scenes.push_back(
          make_scene(rig, few ? 9 : 200 + b, few ? 0 : 0.1, static_cast<unsigned>(20 + b)));
      auto& all = scenes.back().observations;
      if (few) { all[1].u += 20; }
      for (int c = 0; c < 2; ++c) { kp.view().count[2 * b + c] = 0; }
      map.view().count[b] = points;
      for (std::size_t i = 0; i < all.size(); ++i) {
        int const c = all[i].camera;
        if (!Rig::rectified || i < capacity) {
          auto const view = kp.view().slice(2 * b + c);
          int const k = (*view.count)++;
          view.x(k) = all[i].u;
          view.y(k) = all[i].v;
          view.octave(k) = static_cast<int>(i % 8);
          all[i].inv_sigma2 = geometry.inv_sigma2[i % 8];
          int const slot = points - 1 - static_cast<int>(i);
          map.view().slice(b).position(slot) = all[i].point;
          // Every tenth keypoint holds no point.
          holder[static_cast<std::size_t>(b * numbers + c * capacity + k)] =
              k % 10 == 9 ? -1 : slot;
          right_x[static_cast<std::size_t>(b * capacity + k)] = c == 0 ? all[i].right_u : -1.0f;
        }
      }
    }
    ft::keypoints<space> const d_kp(capacity, 2 * batch);
    ft::map_points<space> const d_map(points, batch);
    ft::copy(exec, d_kp.view(), kp.view());
    ft::copy(exec, d_map.view(), map.view());
    exec.wait();
    auto const d_holder = test::to_exec(exec, holder);
    auto const d_right = test::to_exec(exec, right_x);
    auto const d_start = test::to_exec(
        exec, std::vector<ft::pose>{scenes[0].start, scenes[1].start, scenes[2].start});
    auto const d_result = test::to_exec(exec, std::vector<ft::pose>(batch));
    ft::observations_view observations;
    ft::arena<space> const memory(
        [&](ft::carver& c) { ft::carve(c, observations, numbers, batch); });
    ft::frame_view frame;
    frame.keypoints = d_kp.view();
    frame.cameras = cameras;
    frame.batch = batch;
    frame.right_x = Rig::rectified ? d_right.data() : nullptr;
    frame.holder = d_holder.data();
    ft::optimize_frame_poses(exec, rig, {frame, d_map.view(), geometry},
                             {d_start.data(), d_result.data(), observations});
    auto const got = test::from_exec(exec, d_result);
    auto const after = test::from_exec(exec, d_holder);
    auto const counts = test::from_exec(exec, static_cast<int const*>(observations.count), batch);
    auto const inliers =
        test::from_exec(exec, static_cast<int const*>(observations.inliers), batch);
    auto& nine = scenes[2].observations;
    std::stable_partition(nine.begin(), nine.end(), [](auto const& o) { return !o.camera; });
    auto const alone = solve(rig, nine, scenes[2].start);
    EXPECT_TRUE(same_bits(got[2], alone.pose));
    EXPECT_LT(robust_descent(rig, got[2].template cast<double>(), nine), 0.02);
    EXPECT_EQ(counts[2], 9);
    EXPECT_EQ(inliers[2], alone.inliers);
    for (int b = 0; b < 2; ++b) {
      auto const at = static_cast<std::size_t>(b);
      EXPECT_LT(distance(got[at], scenes[at].truth), 1e-3);
      // A keypoint lets go of its point exactly where that is an outlier.
      int held = 0;
      int kept = 0;
      int seen[2] = {0, 0};
      for (std::size_t i = 0; i < scenes[at].observations.size(); ++i) {
        int const c = scenes[at].observations[i].camera;
        if (Rig::rectified && i >= capacity) { break; }
        auto const number = static_cast<std::size_t>(b * numbers + c * capacity + seen[c]++);
        bool const drop = holder[number] < 0 || scenes[at].outlier[i] != 0;
        EXPECT_EQ(after[number], drop ? -1 : holder[number])
            << "frame " << b << " observation " << i;
        held += static_cast<int>(holder[number] >= 0);
        kept += static_cast<int>(!drop);
      }
      EXPECT_EQ(counts[at], held);
      EXPECT_EQ(inliers[at], kept);
    }
  }
};
TYPED_TEST_SUITE(pose_unit, test::backends);

TYPED_TEST(pose_unit, recovers_a_rectified_pose) {
  this->template check_recovery<ft::rectified_rig>();
}
TYPED_TEST(pose_unit, recovers_the_pose_of_three_cameras) {
  this->template check_recovery<three_camera_rig>();
}
TYPED_TEST(pose_unit, recovers_a_fisheye_pose) { this->template check_recovery<fisheye_rig>(); }
TYPED_TEST(pose_unit, fewer_than_three_observations_change_nothing) {
  this->template check_too_few<ft::rectified_rig>();
  this->template check_too_few<fisheye_rig>();
}
TYPED_TEST(pose_unit, fewer_than_ten_rectified_observations_have_the_first_round_alone) {
  this->template check_first_round_alone<ft::rectified_rig>();
}
TYPED_TEST(pose_unit, fewer_than_ten_fisheye_observations_have_the_first_round_alone) {
  this->template check_first_round_alone<fisheye_rig>();
}
TYPED_TEST(pose_unit, fewer_than_ten_observations_of_three_cameras_have_the_first_round_alone) {
  this->template check_first_round_alone<three_camera_rig>();
}
TYPED_TEST(pose_unit, points_behind_the_camera_give_a_pose_still) {
  this->template check_points_behind<ft::rectified_rig>();
  this->template check_points_behind<fisheye_rig>();
}
TYPED_TEST(pose_unit, a_rectified_observation_that_is_no_number_is_an_outlier) {
  this->template check_bad_observation_is_flagged<ft::rectified_rig>();
}
TYPED_TEST(pose_unit, a_fisheye_observation_that_is_no_number_is_an_outlier) {
  this->template check_bad_observation_is_flagged<fisheye_rig>();
}
TYPED_TEST(pose_unit, a_rectified_observation_that_is_no_number_spoils_no_other) {
  this->template check_bad_observation_spoils_nothing<ft::rectified_rig>();
}
TYPED_TEST(pose_unit, a_fisheye_observation_that_is_no_number_spoils_no_other) {
  this->template check_bad_observation_spoils_nothing<fisheye_rig>();
}
TYPED_TEST(pose_unit, an_error_beyond_the_range_of_float_spoils_no_other) {
  auto const rig = example_rig<ft::rectified_rig>();
  auto s = make_scene(rig, 50, 0, 7);
  auto const clean = this->solve(rig, s.observations, s.start);
  ft::observation far = s.observations[10];
  far.right_u = -1;
  far.u = 1e25f;  // a number in double, its square none in float
  s.observations.push_back(far);
  auto const r = this->solve(rig, s.observations, s.start);
  EXPECT_EQ(r.outlier[50], 1);
  EXPECT_EQ(r.inliers, clean.inliers);
  EXPECT_EQ(r.pose.t.x, clean.pose.t.x);
  EXPECT_EQ(r.pose.t.y, clean.pose.t.y);
  EXPECT_EQ(r.pose.t.z, clean.pose.t.z);
}
TYPED_TEST(pose_unit, a_fisheye_point_that_is_no_number_is_not_at_the_principal_point) {
  auto const rig = example_rig<fisheye_rig>();
  auto s = make_scene(rig, 50, 0, 7);
  s.start = s.truth.template cast<float>();  // so that this observation alone is in question
  s.observations[10].point = {nan, nan, nan};
  s.observations[10].camera = 0;
  s.observations[10].u = rig.left.cx;
  s.observations[10].v = rig.left.cy;
  auto const r = this->solve(rig, s.observations, s.start);
  EXPECT_EQ(r.outlier[10], 1);
  EXPECT_EQ(r.inliers, 49);
}
TYPED_TEST(pose_unit, the_rectified_mono_jacobian_is_the_derivative) {
  this->template check_jacobian<ft::rectified_rig>(1e-5, 1e-6, false);
}
TYPED_TEST(pose_unit, the_rectified_stereo_jacobian_is_the_derivative) {
  // The prediction uses 1/z rounded to float: a wide step keeps that rounding out of the
  // difference.
  this->template check_jacobian<ft::rectified_rig>(2e-3, 1e-3, true);
}
TYPED_TEST(pose_unit, the_jacobian_of_three_cameras_is_the_derivative) {
  this->template check_jacobian<three_camera_rig>(1e-5, 1e-6, false);
  this->template check_jacobian<three_camera_rig>(2e-3, 1e-3, true);
}
TYPED_TEST(pose_unit, the_fisheye_jacobian_is_the_derivative_for_both_cameras) {
  this->template check_jacobian<fisheye_rig>(1e-5, 1e-6, false);
}
TYPED_TEST(pose_unit, an_observation_adds_its_squared_jacobian) {
  if (TypeParam::exec_type::asynchronous) { GTEST_SKIP() << "a function of the host's, too"; }
  std::mt19937 random(29);
  std::uniform_real_distribution<float> any(-2.0f, 2.0f);
  using number = ft::strict_float;
  for (int round = 0; round < 200; ++round) {
    bool const rectified = round % 3 == 0;
    bool const displaced = round % 3 == 1;
    ft::vec3<number> const p{any(random), any(random), any(random)};
    ft::mat3<number> P;
    for (auto& v : P.m) { v = any(random); }
    if (rectified) {
      P.m[1] = P.m[3] = P.m[7] = 0.0f;
      P.m[6] = P.m[0];
    }
    ft::vec3<number> const W{std::abs(any(random)), std::abs(any(random)),
                             round % 3 != 2 && round % 4 == 0 ? std::abs(any(random)) : 0.0f};
    ft::vec3<number> const e{any(random), any(random), any(random)};
    float sums[ft::detail::pose_terms] = {};
    ft::detail::add_motion_terms(p,
                                 rectified   ? ft::detail::rectified_equations(P, W, e)
                                 : displaced ? ft::detail::displaced_equations(P, W, e)
                                             : ft::detail::monocular_equations(P, W, e),
                                 sums);
    double const x[3] = {p.x.value, p.y.value, p.z.value};
    double const w[3] = {W.x.value, W.y.value, W.z.value};
    double const error[3] = {e.x.value, e.y.value, e.z.value};
    double J[3][6];
    for (int r = 0; r < 3; ++r) {
      for (int k = 0; k < 3; ++k) {
        int const a = (k + 1) % 3;
        int const b = (k + 2) % 3;
        J[r][k] = static_cast<double>(P.m[3 * r + b].value) * x[a] -
                  static_cast<double>(P.m[3 * r + a].value) * x[b];
        J[r][3 + k] = P.m[3 * r + k].value;
      }
    }
    int at = 6;
    for (int a = 0; a < 6; ++a) {
      double gradient = 0;
      for (int r = 0; r < 3; ++r) { gradient += w[r] * J[r][a] * error[r]; }
      EXPECT_NEAR(sums[a], gradient, 1e-4) << a;
      for (int b = a; b < 6; ++b) {
        double curvature = 0;
        for (int r = 0; r < 3; ++r) { curvature += w[r] * J[r][a] * J[r][b]; }
        EXPECT_NEAR(sums[at++], curvature, 1e-4) << a << ", " << b;
      }
    }
  }
}
TYPED_TEST(pose_unit, rectified_frames_let_go_of_outliers) {
  this->template check_frames<ft::rectified_rig>();
}
TYPED_TEST(pose_unit, fisheye_frames_let_go_of_outliers) {
  this->template check_frames<fisheye_rig>();
}

/// A little below and above each limit; in pairs that pull the pose in opposite directions.
TYPED_TEST(pose_unit, outliers_are_beyond_95_percent_of_their_degrees_of_freedom) {
  auto const rig = example_rig<ft::rectified_rig>();
  auto s = make_scene(rig, 300, 0, 31);
  s.start = s.truth.template cast<float>();
  std::size_t const clean = s.observations.size();
  auto const place =
      static_cast<std::ptrdiff_t>(std::find_if(s.observations.begin(), s.observations.end(),
                                               [](auto const& o) { return o.right_u >= 0; }) -
                                  s.observations.begin());
  std::vector<unsigned char> want(clean, 0);
  auto const add_pair = [&](bool stereo, double chi2, bool outlier) {
    for (double const side : {-1.0, 1.0}) {
      auto o = s.observations[static_cast<std::size_t>(place)];
      o.inv_sigma2 = 1;
      if (!stereo) { o.right_u = -1; }
      o.v += static_cast<float>(side * std::sqrt(chi2));
      s.observations.push_back(o);
      want.push_back(static_cast<unsigned char>(outlier));
    }
  };
  add_pair(false, 5.97, false);
  add_pair(false, 6.01, true);
  add_pair(true, 7.79, false);
  add_pair(true, 7.84, true);
  auto const r = this->solve(rig, s.observations, s.start);
  EXPECT_LT(distance(r.pose, s.truth), 1e-5);
  EXPECT_EQ(r.outlier, want);
}

TYPED_TEST(pose_unit, a_perfect_start_stays) {
  auto const rig = example_rig<ft::rectified_rig>();
  auto const s = make_scene(rig, 50, 0, 8);
  auto const r = this->solve(rig, s.observations, s.truth.template cast<float>());
  EXPECT_LT(distance(r.pose, s.truth), 1e-5);
  EXPECT_EQ(r.inliers, 50);
}

TYPED_TEST(pose_unit, repeated_runs_give_the_same_bits) {
  auto const rig = example_rig<fisheye_rig>();
  auto const s = make_scene(rig, 333, 0.2, 9);
  auto const first = this->solve(rig, s.observations, s.start);
  auto const second = this->solve(rig, s.observations, s.start);
  EXPECT_TRUE(same_bits(first.pose, second.pose));
  EXPECT_EQ(first.outlier, second.outlier);
}

}  // namespace pose_test
