// SPDX-License-Identifier: Apache-2.0
/// @file Stage: pose-only optimisation. Levenberg-Marquardt over the camera's pose with robust
/// reprojection errors, mono and stereo. Source: specification section 11; Nielsen, "Damping
/// parameter in Marquardt's method", 1999.
///
/// All in double with products kept apart and sums in a fixed order: the same pose, to the last
/// bit, on every executor (up to the camera model's own use of trigonometric functions).
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/search_by_projection.hpp"

namespace ft {
inline namespace FT_ABI {

/// A map point seen at a keypoint.
struct observation {
  vec3<float> point;  ///< world frame, metres
  float u, v;         ///< pixels
  float right_u;      ///< column in the right image of a rectified pair; negative = none
  float inv_sigma2;   ///< weight, 1 / pixels^2
  int right_camera;   ///< 1 = seen by the right camera of a fisheye pair
};

struct pose_params {
  int rounds = 4;
  int steps = 10;   ///< per round
  int trials = 10;  ///< of the damping, per step
  double small_step =
      1e-6;  ///< a round ends after a step shorter than this in every component; rad, m
  double chi2_mono = 5.991;    ///< 95 % of 2 degrees of freedom
  double chi2_stereo = 7.815;  ///< 95 % of 3
};

namespace detail {

using real = strict_double;
using transform = rigid<strict_double>;

/// exp of a twist (rotation first), by series and repeated squaring: no library function.
FT_HOST_DEVICE inline transform exp_se3(real const (&d)[6]) {
  vec3<real> w{d[0], d[1], d[2]};
  vec3<real> u{d[3], d[4], d[5]};
  real theta2 = dot(w, w);
  int halvings = 0;
  while (theta2 > 0.25 && halvings < 60) {
    w = {w.x * 0.5, w.y * 0.5, w.z * 0.5};
    u = {u.x * 0.5, u.y * 0.5, u.z * 0.5};
    theta2 = theta2 * 0.25;
    ++halvings;
  }
  // sin(t)/t, (1 - cos t)/t^2, (t - sin t)/t^3
  real a = 0.0;
  real b = 0.0;
  real c = 0.0;
  real term = 1.0;
  FT_UNROLL
  for (int k = 0; k < 10; ++k) {
    double const n = 2.0 * k;
    a = a + term;
    b = b + term * (1.0 / (n + 2.0));
    term = term * (1.0 / ((n + 2.0) * (n + 3.0)));
    c = c + term;
    term = -(term * theta2);
  }
  // Terms so far: 1/(2k+1)! in a, 1/(2k+2)! = that / (2k+2) in b, and so on.
  mat3<real> const W{{0.0, -w.z, w.y, w.z, 0.0, -w.x, -w.y, w.x, 0.0}};
  mat3<real> const W2 = W * W;
  transform t;
  mat3<real> V;
  for (int i = 0; i < 9; ++i) {
    real const one = i % 4 == 0 ? 1.0 : 0.0;
    t.R.m[i] = one + a * W.m[i] + b * W2.m[i];
    V.m[i] = one + b * W.m[i] + c * W2.m[i];
  }
  t.t = V * u;
  for (; halvings > 0; --halvings) { t = t * t; }
  return t;
}

/// Solves the symmetric positive definite system A x = b of size 6 by LDL^T; A as upper triangle by
/// rows. False where A is not positive definite.
FT_HOST_DEVICE inline bool solve_6(double const (&upper)[21], double damping, double const (&b)[6],
                                   real (&x)[6]) {
  real L[6][6];
  real D[6];
  int at = 0;
  for (int i = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j) { L[j][i] = upper[at++]; }
    L[i][i] = L[i][i] + damping;
  }
  for (int j = 0; j < 6; ++j) {
    real d = L[j][j];
    for (int k = 0; k < j; ++k) { d = d - L[j][k] * L[j][k] * D[k]; }
    if (!(d > 0.0)) { return false; }
    D[j] = d;
    for (int i = j + 1; i < 6; ++i) {
      real v = L[i][j];
      for (int k = 0; k < j; ++k) { v = v - L[i][k] * L[j][k] * D[k]; }
      L[i][j] = v / d;
    }
  }
  for (int i = 0; i < 6; ++i) {
    real v = b[i];
    for (int k = 0; k < i; ++k) { v = v - L[i][k] * x[k]; }
    x[i] = v;
  }
  for (int i = 0; i < 6; ++i) { x[i] = x[i] / D[i]; }
  for (int i = 5; i >= 0; --i) {
    for (int k = i + 1; k < 6; ++k) { x[i] = x[i] - L[k][i] * x[k]; }
  }
  return true;
}

}  // namespace detail

/// Reprojection error of one observation, its chi-square and Jacobian. @tparam Rig rectified_rig or
/// stereo_rig
template <typename Rig>
struct reprojection {
  using real = detail::real;

  real error[3];         ///< measured minus predicted; the third only with a right column
  int rows;              ///< 2 or 3
  vec3<real> in_body;    ///< point in the left camera's frame
  vec3<real> in_camera;  ///< point in the seeing camera's frame

  FT_HOST_DEVICE reprojection(Rig const& rig, detail::transform const& T_cw, observation const& o) {
    in_body = T_cw * vec3<real>{static_cast<double>(o.point.x), static_cast<double>(o.point.y),
                                static_cast<double>(o.point.z)};
    in_camera = in_body;
    rows = 2;
    error[2] = 0.0;
    if constexpr (Rig::rectified) {
      auto const& c = rig.camera;
      real u;
      real v;
      if (o.right_u >= 0) {
        rows = 3;
        real const iz = static_cast<double>(static_cast<float>((1.0 / in_body.z).value));
        u = real(static_cast<double>(c.fx)) * in_body.x * iz + static_cast<double>(c.cx);
        v = real(static_cast<double>(c.fy)) * in_body.y * iz + static_cast<double>(c.cy);
        error[2] =
            real(static_cast<double>(o.right_u)) - (u - real(static_cast<double>(rig.bf)) * iz);
      } else {
        u = real(static_cast<double>(c.fx)) * in_body.x / in_body.z + static_cast<double>(c.cx);
        v = real(static_cast<double>(c.fy)) * in_body.y / in_body.z + static_cast<double>(c.cy);
      }
      error[0] = real(static_cast<double>(o.u)) - u;
      error[1] = real(static_cast<double>(o.v)) - v;
    } else {
      projection<real> p;
      if (o.right_camera != 0) {
        in_camera = rig.T_rl.template cast<real>() * in_body;
        p = rig.right.template cast<real>().project(in_camera);
      } else {
        p = rig.left.template cast<real>().project(in_camera);
      }
      error[0] = real(static_cast<double>(o.u)) - p.pixel.x;
      error[1] = real(static_cast<double>(o.v)) - p.pixel.y;
    }
  }

  FT_HOST_DEVICE real chi2(observation const& o) const {
    return (error[0] * error[0] + error[1] * error[1] + error[2] * error[2]) *
           static_cast<double>(o.inv_sigma2);
  }

  /// d prediction / d twist, twist added on the left: rows of 6.
  FT_HOST_DEVICE void jacobian(Rig const& rig, observation const& o, real (&J)[3][6]) const {
    real P[3][3];  // d prediction / d point in the left camera's frame
    if constexpr (Rig::rectified) {
      auto const j = rig.camera.template cast<real>().project_jacobian(in_body);
      for (int k = 0; k < 3; ++k) {
        P[0][k] = j.m[k];
        P[1][k] = j.m[3 + k];
        P[2][k] = j.m[k];
      }
      P[2][2] = P[2][2] + real(static_cast<double>(rig.bf)) / (in_body.z * in_body.z);
    } else {
      mat23<real> j;
      if (o.right_camera != 0) {
        j = rig.right.template cast<real>().project_jacobian(in_camera);
        mat3<real> const R = rig.T_rl.template cast<real>().R;
        for (int r = 0; r < 2; ++r) {
          for (int k = 0; k < 3; ++k) {
            P[r][k] =
                j.m[3 * r] * R.m[k] + j.m[3 * r + 1] * R.m[3 + k] + j.m[3 * r + 2] * R.m[6 + k];
          }
        }
      } else {
        j = rig.left.template cast<real>().project_jacobian(in_camera);
        for (int r = 0; r < 2; ++r) {
          for (int k = 0; k < 3; ++k) { P[r][k] = j.m[3 * r + k]; }
        }
      }
      for (int k = 0; k < 3; ++k) { P[2][k] = 0.0; }
    }
    static_cast<void>(o);
    vec3<real> const p = in_body;
    for (int r = 0; r < 3; ++r) {
      J[r][0] = P[r][2] * p.y - P[r][1] * p.z;
      J[r][1] = P[r][0] * p.z - P[r][2] * p.x;
      J[r][2] = P[r][1] * p.x - P[r][0] * p.y;
      J[r][3] = P[r][0];
      J[r][4] = P[r][1];
      J[r][5] = P[r][2];
    }
  }
};

/// One camera's observations and results.
struct pose_problem {
  observation const* observations;
  int count;
  pose const* start;       ///< T_cw
  pose* result;            ///< T_cw; the start where nothing can be done
  unsigned char* outlier;  ///< [count]
  int* inliers;
};

/// Optimises one pose. Groups of one thread or of 128.
template <typename Rig>
struct optimize_pose {
  static constexpr int terms = 28;  ///< cost, 6 of the gradient, 21 of the upper triangle
  struct scratch {
    ordered_sum_scratch<terms> sums;
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, Rig const& rig, pose_problem const& problem,
                                 pose_params const& params) const {
    using detail::real;
    int const n = problem.count;
    if (n < 3) {
      for (int i = g.rank(); i < n; i += g.size()) { problem.outlier[i] = 0; }
      if (g.rank() == 0) {
        *problem.result = *problem.start;
        *problem.inliers = 0;
      }
      return;
    }
    detail::transform const start = problem.start->template cast<strict_double>();
    // All start as inliers but those without a number: one NaN would spoil every sum.
    for (int i = g.rank(); i < n; i += g.size()) {
      observation const& o = problem.observations[i];
      problem.outlier[i] =
          static_cast<unsigned char>(!scalar::is_finite(reprojection<Rig>(rig, start, o).chi2(o)));
    }
    g.sync();
    detail::transform T = start;
    int inliers = 0;
    for (int round = 0; round < params.rounds; ++round) {
      bool const robust = round + 1 < params.rounds;
      T = run_round(g, s, rig, problem, params, start, robust);
      int good = 0;
      for (int i = g.rank(); i < n; i += g.size()) {
        observation const& o = problem.observations[i];
        reprojection<Rig> const r(rig, T, o);
        // Written so that a NaN is an outlier.
        bool const in = r.chi2(o) <= (r.rows == 3 ? params.chi2_stereo : params.chi2_mono);
        problem.outlier[i] = static_cast<unsigned char>(!in);
        good += static_cast<int>(in);
      }
      g.sync();
      inliers = g.reduce(good, sum_op{});
    }
    if (g.rank() == 0) {
      *problem.result = T.template cast<float>();
      *problem.inliers = inliers;
    }
  }

private:
  /// Cost, gradient and curvature over the inliers at T.
  template <typename Group>
  FT_HOST_DEVICE static void linearize(Group g, scratch& s, Rig const& rig,
                                       pose_problem const& problem, pose_params const& params,
                                       detail::transform const& T, bool robust,
                                       double (&sums)[terms]) {
    using detail::real;
    ordered_sum<terms>(
        g, s.sums, problem.count,
        [&](int i, double* acc) {
          if (problem.outlier[i] != 0) { return; }
          observation const& o = problem.observations[i];
          reprojection<Rig> const r(rig, T, o);
          real const chi2 = r.chi2(o);
          real const limit = r.rows == 3 ? params.chi2_stereo : params.chi2_mono;
          real weight = static_cast<double>(o.inv_sigma2);
          real cost = chi2;
          if (robust && chi2 > limit) {  // Huber
            real const delta = scalar::sqrt(limit);
            real const root = scalar::sqrt(chi2);
            cost = 2.0 * root * delta - limit;
            weight = weight * (delta / root);
          }
          acc[0] += cost.value;
          real J[3][6];
          r.jacobian(rig, o, J);
          int at = 7;
          for (int a = 0; a < 6; ++a) {
            real gradient = J[0][a] * r.error[0] + J[1][a] * r.error[1];
            if (r.rows == 3) { gradient = gradient + J[2][a] * r.error[2]; }
            acc[1 + a] += (weight * gradient).value;
            for (int b = a; b < 6; ++b) {
              real h = J[0][a] * J[0][b] + J[1][a] * J[1][b];
              if (r.rows == 3) { h = h + J[2][a] * J[2][b]; }
              acc[at++] += (weight * h).value;
            }
          }
        },
        sums);
  }

  template <typename Group>
  FT_HOST_DEVICE static detail::transform run_round(Group g, scratch& s, Rig const& rig,
                                                    pose_problem const& problem,
                                                    pose_params const& params,
                                                    detail::transform const& start, bool robust) {
    using detail::real;
    detail::transform T = start;
    double now[terms];
    linearize(g, s, rig, problem, params, T, robust, now);
    double largest = 0;
    {
      int at = 7;
      for (int a = 0; a < 6; ++a) {
        largest = max_of(largest, now[at]);
        at += 6 - a;
      }
    }
    double lambda = (real(1e-5) * largest).value;
    double growth = 2;
    for (int step = 0; step < params.steps; ++step) {
      bool accepted = false;
      for (int trial = 0; trial < params.trials && !accepted; ++trial) {
        double H[21];
        double b[6];
        for (int k = 0; k < 21; ++k) { H[k] = now[7 + k]; }
        for (int k = 0; k < 6; ++k) { b[k] = now[1 + k]; }
        real d[6];
        bool const solved = detail::solve_6(H, lambda, b, d);
        if (solved) {
          detail::transform const next = detail::exp_se3(d) * T;
          // The trial point is linearised at once: an accepted step needs it next.
          double trial_sums[terms];
          linearize(g, s, rig, problem, params, next, robust, trial_sums);
          real expected = 1e-3;
          for (int k = 0; k < 6; ++k) { expected = expected + d[k] * (real(lambda) * d[k] + b[k]); }
          real const gain = (real(now[0]) - trial_sums[0]) / expected;
          if (gain > 0.0 && scalar::is_finite(real(trial_sums[0]))) {
            real const m = real(2.0) * gain - 1.0;
            real const factor =
                max_of(real(1.0 / 3.0), min_of(real(1.0) - m * m * m, real(2.0 / 3.0)));
            lambda = (real(lambda) * factor).value;
            growth = 2;
            T = next;
            for (int k = 0; k < terms; ++k) { now[k] = trial_sums[k]; }
            accepted = true;
            bool small = true;
            for (int k = 0; k < 6; ++k) { small = small && scalar::abs(d[k]) < params.small_step; }
            if (small) { return T; }
          }
        }
        if (!accepted) {
          lambda = (real(lambda) * growth).value;
          growth *= 2;
          if (!scalar::is_finite(lambda)) { return T; }
        }
      }
      if (!accepted) { break; }
    }
    return T;
  }
};

/// Observations of a frame: every keypoint that holds a map point, in the order of keypoint
/// numbers.
struct observations_view {
  observation* items = nullptr;      ///< [batch][capacity]
  int* number = nullptr;             ///< [batch][capacity] keypoint number of an observation
  unsigned char* outlier = nullptr;  ///< [batch][capacity]
  int* count = nullptr;              ///< [batch]
  int* inliers = nullptr;            ///< [batch]
  int capacity = 0;
};

inline void carve(carver& c, observations_view& v, int capacity, int batch) {
  std::size_t const b = static_cast<std::size_t>(batch);
  std::size_t const n = detail::checked_mul(b, static_cast<std::size_t>(capacity));
  v.capacity = capacity;
  v.items = c.take<observation>(n);
  v.number = c.take<int>(n);
  v.outlier = c.take<unsigned char>(n);
  v.count = c.take<int>(b);
  v.inliers = c.take<int>(b);
}

/// One frame: gathers the observations, optimises the pose, and lets keypoints go of outliers.
template <typename Rig>
struct optimize_frame_pose {
  using scratch = typename optimize_pose<Rig>::scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, Rig const& rig,
                                 frame_view const& frame, map_points_view const& map,
                                 pyramid_geometry const& geometry, pose_params const& params,
                                 pose const* start, pose* result,
                                 observations_view const& out) const {
    map_points_view const points = map.slice(b);
    int* const holder = frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers();
    std::ptrdiff_t const at = static_cast<std::ptrdiff_t>(b) * out.capacity;
    int n = 0;
    for (int c = 0; c < frame.cameras; ++c) {
      keypoints_view const kp = frame.camera(b, c);
      for (int base = 0; base < *kp.count; base += g.size()) {
        int const k = base + g.rank();
        int const number = c * frame.capacity() + k;
        int const slot = k < *kp.count ? holder[number] : -1;
        int total = 0;
        int const place = n + g.exclusive_scan(static_cast<int>(slot >= 0), total);
        if (slot >= 0) {
          float const right =
              Rig::rectified && frame.right_x != nullptr
                  ? frame.right_x[static_cast<std::ptrdiff_t>(b) * frame.capacity() + k]
                  : -1.0f;
          out.items[at + place] = {get<field::position>(points, slot),
                                   get<field::x>(kp, k),
                                   get<field::y>(kp, k),
                                   right,
                                   geometry.inv_sigma2[get<field::octave>(kp, k)],
                                   c};
          out.number[at + place] = number;
        }
        n += total;
      }
    }
    g.sync();
    if (g.rank() == 0) { out.count[b] = n; }
    optimize_pose<Rig>{}(
        g, s, rig,
        pose_problem{out.items + at, n, start + b, result + b, out.outlier + at, out.inliers + b},
        params);
    g.sync();
    for (int i = g.rank(); i < n; i += g.size()) {
      if (out.outlier[at + i] != 0) { holder[out.number[at + i]] = -1; }
    }
  }
};

/// Pose of every frame from the map points that its keypoints hold; outliers are released.
/// Asynchronous on `exec`; allocates nothing; one launch. @param start,result [batch] T_cw, may be
/// the same
/// @param out capacity at least frame.numbers()
template <typename Exec, typename Rig>
void optimize_poses(Exec const& exec, Rig const& rig, frame_view const& frame,
                    map_points_view const& map, pyramid_geometry const& geometry,
                    pose_params const& params, pose const* start, pose* result,
                    observations_view const& out) {
  for_each_item<per_block<sum_lanes>>(exec, frame.batch, optimize_frame_pose<Rig>{}, rig, frame,
                                      map, geometry, params, start, result, out);
}

}  // namespace FT_ABI
}  // namespace ft
