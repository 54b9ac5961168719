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
#include <limits>

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
      1e-4;  ///< a round ends after a step shorter than this in every component; rad, m
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
  // sin(t)/t, (1 - cos t)/t^2, (t - sin t)/t^3: series in t^2, from the innermost bracket.
  real a = 1.0;
  real b = 1.0;
  real c = 1.0;
  FT_UNROLL
  for (int k = 9; k > 0; --k) {
    double const n = 2.0 * k;
    a = real(1.0) - theta2 * (1.0 / (n * (n + 1.0))) * a;
    b = real(1.0) - theta2 * (1.0 / ((n + 1.0) * (n + 2.0))) * b;
    c = real(1.0) - theta2 * (1.0 / ((n + 2.0) * (n + 3.0))) * c;
  }
  b = b * 0.5;
  c = c * (1.0 / 6.0);
  mat3<real> const W{{0.0, -w.z, w.y, w.z, 0.0, -w.x, -w.y, w.x, 0.0}};
  mat3<real> const W2 = W * W;
  transform t;
  mat3<real> V;
  for (int i = 0; i < 9; ++i) {
    real const one = i % 4 == 0 ? 1.0 : 0.0;
    t.R.m[i] = one + (a * W.m[i] + b * W2.m[i]);
    V.m[i] = one + (b * W.m[i] + c * W2.m[i]);
  }
  t.t = V * u;
  for (; halvings > 0; --halvings) { t = t * t; }
  return t;
}

/// A symmetric matrix of size 3: its upper triangle by rows.
struct symmetric_3 {
  real xx, xy, xz, yy, yz, zz;

  FT_HOST_DEVICE vec3<real> operator*(vec3<real> v) const {
    return {xx * v.x + xy * v.y + xz * v.z, xy * v.x + yy * v.y + yz * v.z,
            xz * v.x + yz * v.y + zz * v.z};
  }
  /// By cofactors: one division, short chains. False where it is not positive definite.
  FT_HOST_DEVICE bool invert(symmetric_3& inverse) const {
    symmetric_3 const c{yy * zz - yz * yz, yz * xz - xy * zz, xy * yz - yy * xz,
                        xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy};
    real const determinant = xx * c.xx + xy * c.xy + xz * c.xz;
    if (!(xx > 0.0 && c.zz > 0.0 && determinant > 0.0)) { return false; }
    real const scale = real(1.0) / determinant;
    inverse = {c.xx * scale, c.xy * scale, c.xz * scale, c.yy * scale, c.yz * scale, c.zz * scale};
    return true;
  }
};

/// Solves the symmetric positive definite system (A + damping I) x = b of size 6 in blocks of 3
/// (Schur complement); A as upper triangle by rows. False where it is not positive definite.
template <typename Number>
FT_HOST_DEVICE bool solve_6(Number const (&upper)[21], double damping, Number const (&b)[6],
                            real (&x)[6]) {
  auto const at = [&](int i) { return real(static_cast<double>(upper[i])); };
  symmetric_3 const P{at(0) + damping, at(1), at(2), at(6) + damping, at(7), at(11) + damping};
  symmetric_3 const R{at(15) + damping, at(16), at(17), at(18) + damping, at(19), at(20) + damping};
  // Rows of the upper right block, and its columns.
  vec3<real> const column[3] = {
      {at(3), at(8), at(12)}, {at(4), at(9), at(13)}, {at(5), at(10), at(14)}};
  vec3<real> const b1{static_cast<double>(b[0]), static_cast<double>(b[1]),
                      static_cast<double>(b[2])};
  symmetric_3 P_inverse;
  if (!P.invert(P_inverse)) { return false; }
  vec3<real> const w[3] = {P_inverse * column[0], P_inverse * column[1], P_inverse * column[2]};
  symmetric_3 const S{R.xx - dot(column[0], w[0]), R.xy - dot(column[0], w[1]),
                      R.xz - dot(column[0], w[2]), R.yy - dot(column[1], w[1]),
                      R.yz - dot(column[1], w[2]), R.zz - dot(column[2], w[2])};
  symmetric_3 S_inverse;
  if (!S.invert(S_inverse)) { return false; }
  vec3<real> const y = S_inverse * vec3<real>{real(static_cast<double>(b[3])) - dot(w[0], b1),
                                              real(static_cast<double>(b[4])) - dot(w[1], b1),
                                              real(static_cast<double>(b[5])) - dot(w[2], b1)};
  vec3<real> const z = P_inverse * b1;
  x[0] = z.x - (w[0].x * y.x + w[1].x * y.y + w[2].x * y.z);
  x[1] = z.y - (w[0].y * y.x + w[1].y * y.y + w[2].y * y.z);
  x[2] = z.z - (w[0].z * y.x + w[1].z * y.y + w[2].z * y.z);
  x[3] = y.x;
  x[4] = y.y;
  x[5] = y.z;
  return true;
}

}  // namespace detail

/// Reprojection error of one observation, its chi-square and Jacobian. @tparam Rig rectified_rig or
/// stereo_rig
template <typename Rig>
struct reprojection {
  using real = detail::real;
  static constexpr double infinitely_far = std::numeric_limits<double>::infinity();

  real error[3];         ///< measured minus predicted; the third only with a right column
  int rows;              ///< 2 or 3
  vec3<real> in_body;    ///< point in the left camera's frame
  vec3<real> in_camera;  ///< point in the seeing camera's frame
  bool valid = true;     ///< the camera model holds at the point

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
      valid = p.valid;
      error[0] = real(static_cast<double>(o.u)) - p.pixel.x;
      error[1] = real(static_cast<double>(o.v)) - p.pixel.y;
    }
  }

  /// Infinite where there is no projection: an outlier, and no place for a trial pose.
  FT_HOST_DEVICE real chi2(observation const& o) const {
    if (!valid) { return infinitely_far; }
    return (error[0] * error[0] + error[1] * error[1] + error[2] * error[2]) *
           static_cast<double>(o.inv_sigma2);
  }

  /// d prediction / d twist, twist added on the left: rows of 6. @tparam Scalar of the evaluation
  template <typename Scalar>
  FT_HOST_DEVICE void jacobian(Rig const& rig, observation const& o, Scalar (&J)[3][6]) const {
    using P_type = plain_scalar_t<Scalar>;
    auto const narrowed = [](vec3<real> v) {
      return vec3<Scalar>{Scalar(static_cast<P_type>(v.x.value)),
                          Scalar(static_cast<P_type>(v.y.value)),
                          Scalar(static_cast<P_type>(v.z.value))};
    };
    vec3<Scalar> const p = narrowed(in_body);
    Scalar P[3][3];  // d prediction / d point in the left camera's frame
    if constexpr (Rig::rectified) {
      auto const j = rig.camera.template cast<Scalar>().project_jacobian(p);
      for (int k = 0; k < 3; ++k) {
        P[0][k] = j.m[k];
        P[1][k] = j.m[3 + k];
        P[2][k] = j.m[k];
      }
      P[2][2] = P[2][2] + Scalar(static_cast<P_type>(rig.bf)) / (p.z * p.z);
    } else {
      mat23<Scalar> j;
      vec3<Scalar> const q = narrowed(in_camera);
      if (o.right_camera != 0) {
        j = rig.right.template cast<Scalar>().project_jacobian(q);
        mat3<Scalar> const R = rig.T_rl.template cast<Scalar>().R;
        for (int r = 0; r < 2; ++r) {
          for (int k = 0; k < 3; ++k) {
            P[r][k] =
                j.m[3 * r] * R.m[k] + j.m[3 * r + 1] * R.m[3 + k] + j.m[3 * r + 2] * R.m[6 + k];
          }
        }
      } else {
        j = rig.left.template cast<Scalar>().project_jacobian(q);
        for (int r = 0; r < 2; ++r) {
          for (int k = 0; k < 3; ++k) { P[r][k] = j.m[3 * r + k]; }
        }
      }
      for (int k = 0; k < 3; ++k) { P[2][k] = Scalar(0); }
    }
    static_cast<void>(o);
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

namespace detail {

inline constexpr int pose_terms = 27;  ///< 6 of the gradient, 21 of the upper triangle

/// Levenberg-Marquardt as a machine that one thread keeps: it names a trial pose, is told the sums
/// there, and names the next.
struct damped_descent {
  transform T;      ///< the best pose so far
  transform trial;  ///< where the sums are wanted next
  sum_terms<pose_terms> at_best;
  real step[6];
  double damping;
  double growth;
  double expected;  ///< decrease of the cost
  int steps_left;
  int trials_left;
  bool accepted;  ///< the last trial became the best
  bool running;   ///< false = done, `T` is the answer

  FT_HOST_DEVICE void begin(transform const& start, sum_terms<pose_terms> const& sums,
                            pose_params const& params) {
    T = start;
    at_best = sums;
    accepted = true;
    double largest = 0;
    int at = 6;
    for (int a = 0; a < 6; ++a) {
      largest = max_of(largest, static_cast<double>(sums.narrow[at]));
      at += 6 - a;
    }
    damping = (real(1e-5) * largest).value;
    growth = 2;
    steps_left = params.steps;
    trials_left = params.trials;
    running = steps_left > 0;
  }

  FT_HOST_DEVICE void judge(sum_terms<pose_terms> const& sums, pose_params const& params) {
    real const gain = (real(at_best.wide) - sums.wide) / real(expected);
    accepted = gain > 0.0 && scalar::is_finite(real(sums.wide));
    if (accepted) {
      real const m = real(2.0) * gain - 1.0;
      real const factor = max_of(real(1.0 / 3.0), min_of(real(1.0) - m * m * m, real(2.0 / 3.0)));
      damping = (real(damping) * factor).value;
      growth = 2;
      T = trial;
      at_best = sums;
      bool small = true;
      for (int k = 0; k < 6; ++k) { small = small && scalar::abs(step[k]) < params.small_step; }
      trials_left = params.trials;
      running = --steps_left > 0 && !small;
    } else {
      refuse();
    }
  }

  /// Names the next trial pose, or ends.
  FT_HOST_DEVICE void propose() {
    float H[21];
    float b[6];
    for (int k = 0; k < 6; ++k) { b[k] = at_best.narrow[k]; }
    for (int k = 0; k < 21; ++k) { H[k] = at_best.narrow[6 + k]; }
    while (running && !solve_6(H, damping, b, step)) { refuse(); }
    if (!running) { return; }
    real sum = 1e-3;
    for (int k = 0; k < 6; ++k) {
      sum = sum + step[k] * (real(damping) * step[k] + static_cast<double>(b[k]));
    }
    expected = sum.value;
    trial = exp_se3(step) * T;
  }

private:
  /// After a trial that was no better: more damping, while any is left.
  FT_HOST_DEVICE void refuse() {
    damping = (real(damping) * growth).value;
    growth *= 2;
    running = --trials_left > 0 && scalar::is_finite(damping);
  }
};

}  // namespace detail

/// Optimises one pose. Groups of one thread or of sum_lanes.
///
/// Residuals, chi-squares and the cost are in double: they decide. Derivatives and the normal
/// equations, whose errors only change the length of the way, are in float; the equations are
/// solved in double.
template <typename Rig>
struct optimize_pose {
  static constexpr int terms = detail::pose_terms;
  struct scratch {
    ordered_sum_scratch<terms> sums;
    detail::damped_descent descent;
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, Rig const& rig, pose_problem const& problem,
                                 pose_params const& params) const {
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
    // Bits of a flag: outlier in this round; too far at the last trial pose; too far at the best.
    for (int i = g.rank(); i < n; i += g.size()) { problem.outlier[i] = 0; }
    detail::transform T = start;
    bool changed = true;
    for (int round = 0; round < params.rounds; ++round) {
      bool const robust = round + 1 < params.rounds;
      // The same observations and the same kernel give the same pose again.
      if (!changed && robust) { continue; }
      T = run_round(g, s, rig, problem, params, start, robust);
      // What the flags say of the round's best pose becomes the next round's set.
      int changes = 0;
      for (int i = g.rank(); i < n; i += g.size()) {
        unsigned const flags = problem.outlier[i];
        unsigned const out = (flags & too_far_at_best) != 0 ? outlier : 0;
        changes += static_cast<int>(out != (flags & outlier));
        problem.outlier[i] = static_cast<unsigned char>(out);
      }
      changed = g.reduce(changes, sum_op{}) > 0;
    }
    int good = 0;
    for (int i = g.rank(); i < n; i += g.size()) {
      good += static_cast<int>(problem.outlier[i] == 0);
    }
    good = g.reduce(good, sum_op{});
    if (g.rank() == 0) {
      *problem.result = T.template cast<float>();
      *problem.inliers = params.rounds > 0 ? good : 0;
    }
  }

private:
  static constexpr unsigned outlier = 1;
  static constexpr unsigned too_far_at_trial = 2;
  static constexpr unsigned too_far_at_best = 4;

  /// Cost, gradient and curvature over the inliers at T, in s.sums.total. Notes of every
  /// observation whether it is too far away there. @param first of a round: observations without a
  /// number stay out of it, as one NaN would spoil every sum
  template <typename Group>
  FT_HOST_DEVICE static void linearize(Group g, scratch& s, Rig const& rig,
                                       pose_problem const& problem, pose_params const& params,
                                       detail::transform const& T, bool robust, bool first) {
    using detail::real;
    using narrow = strict_float;
    bool const accepted = !first && s.descent.accepted;
    ordered_sum<terms>(g, s.sums, problem.count, [&](int i, sum_terms<terms>& acc) {
      observation const& o = problem.observations[i];
      reprojection<Rig> const r(rig, T, o);
      real const chi2 = r.chi2(o);
      real const limit = r.rows == 3 ? params.chi2_stereo : params.chi2_mono;
      unsigned flags = settled_flags(problem.outlier[i], accepted) & ~too_far_at_trial;
      if (first && !scalar::is_finite(chi2)) { flags |= outlier; }
      if (!(chi2 <= limit)) { flags |= too_far_at_trial; }  // written so that a NaN is too far
      problem.outlier[i] = static_cast<unsigned char>(flags);
      if ((flags & outlier) != 0) { return; }
      narrow weight = o.inv_sigma2;
      real cost = chi2;
      if (robust && chi2 > limit) {  // Huber
        real const product = scalar::sqrt(limit * chi2);
        cost = 2.0 * product - limit;
        weight = weight * static_cast<float>((product / chi2).value);
      }
      acc.wide += cost.value;
      narrow J[3][6];
      r.jacobian(rig, o, J);
      // A row that is not there has no weight.
      narrow const weights[3] = {weight, weight, r.rows == 3 ? weight : narrow(0.0f)};
      narrow const error[3] = {static_cast<float>(r.error[0].value),
                               static_cast<float>(r.error[1].value),
                               static_cast<float>(r.error[2].value)};
      constexpr int rows = Rig::rectified ? 3 : 2;
      int at = 6;
      FT_UNROLL
      for (int a = 0; a < 6; ++a) {
        narrow weighted[rows];
        narrow gradient = 0.0f;
        FT_UNROLL
        for (int k = 0; k < rows; ++k) {
          weighted[k] = weights[k] * J[k][a];
          gradient = gradient + weighted[k] * error[k];
        }
        acc.narrow[a] += gradient.value;
        FT_UNROLL
        for (int b = a; b < 6; ++b) {
          narrow h = weighted[0] * J[0][b];
          FT_UNROLL
          for (int k = 1; k < rows; ++k) { h = h + weighted[k] * J[k][b]; }
          acc.narrow[at++] += h.value;
        }
      }
    });
  }

  /// If the last trial pose has become the best, its flags have, too.
  FT_HOST_DEVICE static unsigned settled_flags(unsigned flags, bool accepted) {
    if (!accepted) { return flags; }
    return (flags & outlier) | ((flags & too_far_at_trial) != 0 ? too_far_at_best : 0);
  }

  template <typename Group>
  FT_HOST_DEVICE static detail::transform run_round(Group g, scratch& s, Rig const& rig,
                                                    pose_problem const& problem,
                                                    pose_params const& params,
                                                    detail::transform const& start, bool robust) {
    detail::transform here = start;
    FT_NO_UNROLL
    for (bool first = true;; first = false) {
      linearize(g, s, rig, problem, params, here, robust, first);
      if (g.rank() == 0) {
        if (first) {
          s.descent.begin(start, s.sums.total, params);
        } else {
          s.descent.judge(s.sums.total, params);
        }
        s.descent.propose();
      }
      g.sync();
      if (!s.descent.running) { break; }
      here = s.descent.trial;
    }
    for (int i = g.rank(); i < problem.count; i += g.size()) {
      problem.outlier[i] =
          static_cast<unsigned char>(settled_flags(problem.outlier[i], s.descent.accepted));
    }
    detail::transform const T = s.descent.T;
    g.sync();
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
