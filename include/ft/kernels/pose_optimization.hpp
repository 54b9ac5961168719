// SPDX-License-Identifier: Apache-2.0
/// @file Stage: pose-only optimisation. Levenberg-Marquardt over the camera's pose with robust
/// reprojection errors, mono and stereo. Source: specification section 11; Nielsen, "Damping
/// parameter in Marquardt's method", 1999.
///
/// With products kept apart and sums in a fixed order: the same pose, to the last bit, on every
/// executor (up to the camera model's own use of trigonometric functions).
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/geometry.hpp"
#include "ft/core/ordered_sum.hpp"

namespace ft {
inline namespace FT_ABI {

/// A map point seen at a keypoint. Aligned, so that a GPU loads it in two pieces.
struct alignas(16) observation {
  vec3<float> point;  ///< world frame, metres
  float u, v;         ///< pixels
  float right_u;      ///< column in the right image of a rectified pair; negative = none
  float inv_sigma2;   ///< weight, 1 / pixels^2
  int right_camera;   ///< 1 = seen by the right camera of a fisheye pair
};

struct pose_params {
  int rounds = 4;
  /// With fewer observations, outliers included, the first round is the only one.
  int enough_observations = 10;
  int steps = 10;   ///< per round
  int trials = 10;  ///< of the damping, per step
  /// A round ends with a step shorter than this in every component, rad and m; that one is taken
  /// without a look at where it leads.
  float small_step = 1e-4f;
  double chi2_mono = 5.991;    ///< 95 % of 2 degrees of freedom
  double chi2_stereo = 7.815;  ///< 95 % of 3
};

namespace detail {

using real = strict_double;
using transform = rigid<strict_double>;

/// I + a W + b W^2 with W = [w]x, so that W^2 = w w^T - (w.w) I.
template <typename Real>
FT_HOST_DEVICE mat3<Real> one_plus(Real a, Real b, vec3<Real> w, Real theta2) {
  vec3<Real> const aw{a * w.x, a * w.y, a * w.z};
  vec3<Real> const bw{b * w.x, b * w.y, b * w.z};
  Real const xy = bw.x * w.y;
  Real const xz = bw.x * w.z;
  Real const yz = bw.y * w.z;
  Real const rest = Real(1) - b * theta2;
  return {{rest + bw.x * w.x, xy - aw.z, xz + aw.y, xy + aw.z, rest + bw.y * w.y, yz - aw.x,
           xz - aw.y, yz + aw.x, rest + bw.z * w.z}};
}

/// exp of a twist (rotation first), by series and repeated squaring: no library function.
template <typename Real>
FT_HOST_DEVICE rigid<Real> exp_se3(Real const (&d)[6]) {
  using plain = plain_scalar_t<Real>;
  vec3<Real> w{d[0], d[1], d[2]};
  vec3<Real> u{d[3], d[4], d[5]};
  Real theta2 = dot(w, w);
  int halvings = 0;
  FT_NO_UNROLL
  while (theta2 > Real(plain(1) / 64) && halvings < 60) {
    Real const half = Real(plain(1) / 2);
    w = {w.x * half, w.y * half, w.z * half};
    u = {u.x * half, u.y * half, u.z * half};
    theta2 = theta2 * Real(plain(1) / 4);
    ++halvings;
  }
  // sin(t)/t, (1 - cos t)/t^2, (t - sin t)/t^3: series in t^2, from the innermost bracket. What is
  // left out is below 1e-16 of the result.
  Real a = Real(1);
  Real b = Real(1);
  Real c = Real(1);
  FT_UNROLL
  for (int k = 5; k > 0; --k) {
    double const n = 2.0 * k;
    a = Real(1) - theta2 * Real(static_cast<plain>(1.0 / (n * (n + 1.0)))) * a;
    b = Real(1) - theta2 * Real(static_cast<plain>(1.0 / ((n + 1.0) * (n + 2.0)))) * b;
    c = Real(1) - theta2 * Real(static_cast<plain>(1.0 / ((n + 2.0) * (n + 3.0)))) * c;
  }
  b = b * Real(static_cast<plain>(1.0 / 2.0));
  c = c * Real(static_cast<plain>(1.0 / 6.0));
  rigid<Real> t;
  t.R = one_plus(a, b, w, theta2);
  t.t = one_plus(b, c, w, theta2) * u;
  // Each product doubles what R lacks of a rotation: of many turns nothing would be left in float.
  constexpr int harmless = 6;
  bool const many = halvings > harmless;
  FT_NO_UNROLL
  for (; halvings > 0; --halvings) {
    t = t * t;
    if (many) { t = t.orthonormalized(); }
  }
  return t;
}

/// A symmetric matrix of size 3: its upper triangle by rows.
template <typename Real>
struct symmetric_3 {
  Real xx, xy, xz, yy, yz, zz;

  FT_HOST_DEVICE vec3<Real> operator*(vec3<Real> v) const {
    return {xx * v.x + xy * v.y + xz * v.z, xy * v.x + yy * v.y + yz * v.z,
            xz * v.x + yz * v.y + zz * v.z};
  }
  /// By cofactors: one division, short chains. False where it is not positive definite.
  FT_HOST_DEVICE bool invert(symmetric_3& inverse) const {
    symmetric_3 const c{yy * zz - yz * yz, yz * xz - xy * zz, xy * yz - yy * xz,
                        xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy};
    Real const determinant = xx * c.xx + xy * c.xy + xz * c.xz;
    if (!(xx > Real(0) && c.zz > Real(0) && determinant > Real(0))) { return false; }
    Real const scale = scalar::reciprocal(determinant);
    inverse = {c.xx * scale, c.xy * scale, c.xz * scale, c.yy * scale, c.yz * scale, c.zz * scale};
    return true;
  }
};

/// Solves the symmetric positive definite system (A + damping I) x = b of size 6 in blocks of 3
/// (Schur complement). @param terms b, then A as upper triangle by rows. False where the matrix is
/// not positive definite. @tparam Real that it is solved in
template <typename Real, typename Number>
FT_HOST_DEVICE bool solve_6(Number const* terms, Real damping, Real (&x)[6]) {
  using plain = plain_scalar_t<Real>;
  auto const at = [&](int i) { return Real(static_cast<plain>(terms[6 + i])); };
  auto const b = [&](int i) { return Real(static_cast<plain>(terms[i])); };
  symmetric_3<Real> const A{at(0) + damping, at(1), at(2),
                            at(6) + damping, at(7), at(11) + damping};
  symmetric_3<Real> const C{at(15) + damping, at(16), at(17),
                            at(18) + damping, at(19), at(20) + damping};
  // Columns of the upper right block.
  vec3<Real> const B[3] = {{at(3), at(8), at(12)}, {at(4), at(9), at(13)}, {at(5), at(10), at(14)}};
  symmetric_3<Real> A_inverse;
  if (!A.invert(A_inverse)) { return false; }
  vec3<Real> const w[3] = {A_inverse * B[0], A_inverse * B[1], A_inverse * B[2]};
  symmetric_3<Real> const S{C.xx - dot(B[0], w[0]), C.xy - dot(B[0], w[1]), C.xz - dot(B[0], w[2]),
                            C.yy - dot(B[1], w[1]), C.yz - dot(B[1], w[2]), C.zz - dot(B[2], w[2])};
  symmetric_3<Real> S_inverse;
  if (!S.invert(S_inverse)) { return false; }
  vec3<Real> const first{b(0), b(1), b(2)};
  vec3<Real> const y = S_inverse * vec3<Real>{b(3) - dot(w[0], first), b(4) - dot(w[1], first),
                                              b(5) - dot(w[2], first)};
  vec3<Real> const z = A_inverse * first;
  x[0] = z.x - (w[0].x * y.x + w[1].x * y.y + w[2].x * y.z);
  x[1] = z.y - (w[0].y * y.x + w[1].y * y.y + w[2].y * y.z);
  x[2] = z.z - (w[0].z * y.x + w[1].z * y.y + w[2].z * y.z);
  x[3] = y.x;
  x[4] = y.y;
  x[5] = y.z;
  return true;
}

}  // namespace detail

/// Reprojection error of one observation, its chi-square and its derivative. @tparam Rig
/// rectified_rig or stereo_rig @tparam Real strict_float or strict_double @tparam Differentiate
/// whether derivative() will be asked
template <typename Rig, typename Real = strict_double, bool Differentiate = false>
struct reprojection {
  using plain = plain_scalar_t<Real>;
  static constexpr plain infinitely_far = std::numeric_limits<plain>::infinity();

  Real error[3];         ///< measured minus predicted; the third only with a right column
  int rows;              ///< 2 or 3
  vec3<Real> in_body;    ///< point in the left camera's frame
  vec3<Real> in_camera;  ///< point in the seeing camera's frame
  Real iz = Real(0);     ///< 1 / z of a rectified pair
  bool valid = true;     ///< the camera model holds at the point

  FT_HOST_DEVICE reprojection(Rig const& rig, rigid<Real> const& T_cw, observation const& o) {
    in_body = T_cw * vec3<Real>{real(o.point.x), real(o.point.y), real(o.point.z)};
    in_camera = in_body;
    rows = 2;
    error[2] = Real(0);
    if constexpr (Rig::rectified) {
      auto const& c = rig.camera;
      Real const inverse = scalar::reciprocal(in_body.z);
      bool const stereo = o.right_u >= 0;
      iz = stereo ? real(static_cast<float>(inverse.value)) : inverse;
      Real const u = real(c.fx) * in_body.x * iz + real(c.cx);
      Real const v = real(c.fy) * in_body.y * iz + real(c.cy);
      error[0] = real(o.u) - u;
      error[1] = real(o.v) - v;
      if (stereo) {
        rows = 3;
        error[2] = real(o.right_u) - (u - real(rig.bf) * iz);
      }
    } else {
      projection<Real> p;
      if (o.right_camera != 0) {
        in_camera = rig.T_rl.template cast<Real>() * in_body;
        p = project(rig.right.template cast<Real>());
      } else {
        p = project(rig.left.template cast<Real>());
      }
      valid = p.valid;
      error[0] = real(o.u) - p.pixel.x;
      error[1] = real(o.v) - p.pixel.y;
    }
  }

  /// Infinite where there is no projection: an outlier, and no place for a trial pose.
  FT_HOST_DEVICE Real chi2(observation const& o) const {
    if (!valid) { return Real(infinitely_far); }
    return (error[0] * error[0] + error[1] * error[1] + error[2] * error[2]) * real(o.inv_sigma2);
  }

  /// d prediction / d point in the left camera's frame.
  FT_HOST_DEVICE void derivative(Rig const& rig, observation const& o, Real (&P)[3][3]) const {
    Real const zero = Real(0);
    if constexpr (Rig::rectified) {
      static_cast<void>(o);
      auto const& c = rig.camera;
      Real const du = real(c.fx) * iz;
      Real const dv = real(c.fy) * iz;
      P[0][0] = P[2][0] = du;
      P[1][1] = dv;
      P[0][1] = P[1][0] = P[2][1] = zero;
      P[0][2] = -(du * (in_body.x * iz));
      P[1][2] = -(dv * (in_body.y * iz));
      P[2][2] = P[0][2] + real(rig.bf) * (iz * iz);
    } else {
      static_assert(Differentiate, "asked for when it was made");
      auto const& j = camera_derivative.m;
      bool const right = o.right_camera != 0;
      mat3<Real> const R = rig.T_rl.template cast<Real>().R;
      for (int r = 0; r < 2; ++r) {
        for (int k = 0; k < 3; ++k) {
          P[r][k] = right
                        ? j[3 * r] * R.m[k] + j[3 * r + 1] * R.m[3 + k] + j[3 * r + 2] * R.m[6 + k]
                        : j[3 * r + k];
        }
      }
      P[2][0] = P[2][1] = P[2][2] = zero;
    }
  }

private:
  FT_HOST_DEVICE static Real real(float v) { return Real(static_cast<plain>(v)); }

  template <typename Camera>
  FT_HOST_DEVICE projection<Real> project(Camera const& camera) {
    if constexpr (Differentiate) {
      return project_and_differentiate(camera, in_camera, camera_derivative);
    } else {
      return camera.project(in_camera);
    }
  }

  mat23<Real> camera_derivative;  ///< d pixel / d in_camera, of unrectified cameras
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

/// 6 of the gradient, 21 of the upper triangle, the cost.
inline constexpr int pose_terms = 28;

/// Adds an observation to the normal equations: gradient, then upper triangle by rows. A small
/// twist (w, t) moves the point p by w x p + t; so with M = P^T W P and f = P^T W e the blocks of
/// the curvature are [p]x M [p]x^T, [p]x M and M, and those of the gradient p x f and f.
/// @param P d prediction / d p @param rectified P[0][1], P[1][0] and P[2][1] are 0
template <typename Number>
FT_HOST_DEVICE void add_motion_terms(vec3<Number> p, Number const (&P)[3][3], vec3<Number> const& W,
                                     vec3<Number> const& e, bool rectified,
                                     float (&sums)[pose_terms]) {
  Number M[3][3];
  vec3<Number> f;
  if (rectified) {
    Number const w0 = W.x * P[0][0];
    Number const w2 = W.z * P[2][0];
    Number const w1 = W.y * P[1][1];
    Number const w02 = W.x * P[0][2];
    Number const w12 = W.y * P[1][2];
    Number const w22 = W.z * P[2][2];
    M[0][0] = w0 * P[0][0] + w2 * P[2][0];
    M[0][1] = Number(0.0f);
    M[0][2] = w02 * P[0][0] + w22 * P[2][0];
    M[1][1] = w1 * P[1][1];
    M[1][2] = w12 * P[1][1];
    M[2][2] = w02 * P[0][2] + w12 * P[1][2] + w22 * P[2][2];
    f = {w0 * e.x + w2 * e.z, w1 * e.y, w02 * e.x + w12 * e.y + w22 * e.z};
  } else {  // two rows
    vec3<Number> const u{W.x * P[0][0], W.x * P[0][1], W.x * P[0][2]};
    vec3<Number> const v{W.y * P[1][0], W.y * P[1][1], W.y * P[1][2]};
    M[0][0] = u.x * P[0][0] + v.x * P[1][0];
    M[0][1] = u.x * P[0][1] + v.x * P[1][1];
    M[0][2] = u.x * P[0][2] + v.x * P[1][2];
    M[1][1] = u.y * P[0][1] + v.y * P[1][1];
    M[1][2] = u.y * P[0][2] + v.y * P[1][2];
    M[2][2] = u.z * P[0][2] + v.z * P[1][2];
    f = {u.x * e.x + v.x * e.y, u.y * e.x + v.y * e.y, u.z * e.x + v.z * e.y};
  }
  M[1][0] = M[0][1];
  M[2][0] = M[0][2];
  M[2][1] = M[1][2];
  auto const add = [&](int at, Number v) { sums[at] += v.value; };
  add(0, p.y * f.z - p.z * f.y);
  add(1, p.z * f.x - p.x * f.z);
  add(2, p.x * f.y - p.y * f.x);
  add(3, f.x);
  add(4, f.y);
  add(5, f.z);
  Number G[3][3];  // [p]x M
  FT_UNROLL
  for (int k = 0; k < 3; ++k) {
    G[0][k] = p.y * M[2][k] - p.z * M[1][k];
    G[1][k] = p.z * M[0][k] - p.x * M[2][k];
    G[2][k] = p.x * M[1][k] - p.y * M[0][k];
  }
  add(6, p.y * G[0][2] - p.z * G[0][1]);
  add(7, p.z * G[0][0] - p.x * G[0][2]);
  add(8, p.x * G[0][1] - p.y * G[0][0]);
  add(12, p.z * G[1][0] - p.x * G[1][2]);
  add(13, p.x * G[1][1] - p.y * G[1][0]);
  add(17, p.x * G[2][1] - p.y * G[2][0]);
  FT_UNROLL
  for (int k = 0; k < 3; ++k) {
    add(9 + k, G[0][k]);
    add(14 + k, G[1][k]);
    add(18 + k, G[2][k]);
    add(21 + k, M[0][k]);
  }
  add(24, M[1][1]);
  add(25, M[1][2]);
  add(26, M[2][2]);
}

/// Levenberg-Marquardt as a machine that one thread keeps: it names a trial motion, is told the
/// sums there, and names the next.
struct damped_descent {
  /// Costs that differ by less than this part are the same: they are sums of float residuals.
  static constexpr float noise = 1e-5f;

  using real = strict_float;
  rigid<real> D;      ///< the best motion so far, from the camera's frame at the start
  rigid<real> trial;  ///< where the sums are wanted next
  real step[6];
  real cost;      ///< at the best
  real expected;  ///< decrease of the cost
  real damping;
  real growth;
  int steps_left;
  int trials_left;
  bool running;  ///< false = done, `D` is the answer

  /// @param sums without any motion
  FT_HOST_DEVICE void begin(sum_terms<pose_terms> const& sums, pose_params const& params) {
    D = rigid<real>::identity();
    trial = D;
    steps_left = params.steps;
    float largest = 0;
    int at = 6;
    for (int a = 0; a < 6; ++a) {
      largest = max_of(largest, sums.of[at]);
      at += 6 - a;
    }
    damping = real(1e-5f) * largest;
    growth = 2.0f;
    cost = sums.of[pose_terms - 1];
    trials_left = params.trials;
    running = steps_left > 0;
  }

  /// Whether the trial is the best now. @param sums there
  FT_HOST_DEVICE bool judge(sum_terms<pose_terms> const& sums, pose_params const& params) {
    real const there = sums.of[pose_terms - 1];
    real const decrease = cost - there;
    if (!(decrease > -(real(noise) * cost) && scalar::is_finite(there))) {
      refuse();
      return false;
    }
    real const m = real(2.0f) * (decrease / expected) - 1.0f;
    damping =
        damping * max_of(real(1.0f / 3.0f), min_of(real(1.0f) - m * m * m, real(2.0f / 3.0f)));
    growth = 2.0f;
    D = trial;
    cost = there;
    trials_left = params.trials;
    running = --steps_left > 0;
    return true;
  }

  /// Names the next trial, or ends. @param best the sums at the best
  FT_HOST_DEVICE void propose(sum_terms<pose_terms> const& best, pose_params const& params) {
    while (running && !solve_6(best.of, damping, step)) { refuse(); }
    if (!running) { return; }
    expected = 1e-3f;
    bool small = true;
    for (int k = 0; k < 6; ++k) {
      expected = expected + step[k] * (damping * step[k] + best.of[k]);
      small = small && scalar::abs(step[k]) < params.small_step;
    }
    trial = exp_se3(step) * D;
    if (!small) { return; }
    // Short because it was cut short: a longer one was no better.
    if (trials_left == params.trials) { D = trial; }
    running = false;
  }

private:
  /// After a trial that was no better: more damping, while any is left.
  FT_HOST_DEVICE void refuse() {
    damping = damping * growth;
    growth = growth * 2.0f;
    running = --trials_left > 0 && scalar::is_finite(damping);
  }
};

}  // namespace detail

/// Optimises one pose. Groups of one thread or of sum_lanes.
///
/// The points are carried into the camera's frame at the start in double, once; the motion from
/// there is sought in float, whose errors are those of the residual's own float 1 / z. Who is an
/// outlier is decided in double, at the pose of the motion found.
template <typename Rig>
struct optimize_pose {
  static constexpr int terms = detail::pose_terms;
  /// So many observations are kept in block scratch, others are looked up each time.
  static constexpr int scratch_size = 1024;
  struct scratch {
    ordered_sum_scratch<terms> sums;
    sum_terms<terms> best;  ///< sums at the best motion so far
    detail::damped_descent descent;
    alignas(16) detail::transform T;  ///< what the last round found; at first the start
    /// What sums need of an observation, in pieces that are loaded at once.
    struct alignas(16) {
      vec3<float> point;  ///< in the camera's frame at the start
      float weight;       ///< 0 = does not count in this round
    } place[scratch_size];
    struct alignas(16) {
      float u, v, third;  ///< column in the right image, or 1 = seen by the right camera
      unsigned flags;
    } pixel[scratch_size];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, Rig const& rig, pose_problem const& problem,
                                 pose_params const& params) const {
    if (g.rank() == 0) { s.T = problem.start->template cast<strict_double>(); }
    g.sync();
    FT_NO_UNROLL
    for (int i = g.rank(); i < problem.count; i += g.size()) {
      prepare(s, i, rig, problem, problem.observations[i]);
    }
    solve(g, s, rig, problem, params);
  }

  /// Takes in observation i, once s.T is the start: in the thread that will look at it, which is i
  /// modulo the group's size. @param o observation i of the problem
  FT_HOST_DEVICE static void prepare(scratch& s, int i, Rig const& rig, pose_problem const& problem,
                                     observation const& o) {
    reprojection<Rig> const r(rig, s.T, o);
    bool const usable = r.chi2(o) < largest_chi2;
    if (i < scratch_size) {
      s.place[i] = {narrowed(r.in_body), usable ? o.inv_sigma2 : 0.0f};
      s.pixel[i] = {o.u, o.v, Rig::rectified ? o.right_u : static_cast<float>(o.right_camera), 0};
    }
    set_flags(s, i, problem, usable ? 0 : unusable);
  }

  /// Optimises once all observations are prepared.
  template <typename Group>
  FT_HOST_DEVICE static void solve(Group g, scratch& s, Rig const& rig, pose_problem const& problem,
                                   pose_params const& params) {
    int const n = problem.count;
    bool const enough = n >= 3 && params.rounds > 0;
    int const rounds = n < params.enough_observations ? 1 : params.rounds;
    bool changed = true;
    FT_NO_UNROLL
    for (int round = 0; enough && round < rounds; ++round) {
      bool const robust = round + 1 < params.rounds;
      // The same observations and the same kernel give the same pose again.
      if (!changed && robust) { continue; }
      run_round(g, s, rig, problem, params, robust);
      bool changes = false;
      FT_NO_UNROLL
      for (int i = g.rank(); i < n; i += g.size()) {
        changes = classify(s, i, rig, problem, params) || changes;
      }
      if (robust) { changed = g.any(changes); }
    }
    int good = 0;
    FT_NO_UNROLL
    for (int i = g.rank(); i < n; i += g.size()) {
      unsigned const flag = enough ? flags(s, i, problem) & outlier : 0;
      set_flags(s, i, problem, flag);
      problem.outlier[i] = static_cast<unsigned char>(flag);
      good += static_cast<int>(flag == 0);
    }
    good = g.reduce(good, sum_op{});
    if (g.rank() == 0) {
      *problem.result = enough ? s.T.template cast<float>() : *problem.start;
      *problem.inliers = enough ? good : 0;
    }
  }

  /// What the problem's `outlier` says, for the thread of observation i.
  FT_HOST_DEVICE static bool is_outlier(scratch const& s, int i, pose_problem const& problem) {
    return (flags(s, i, problem) & outlier) != 0;
  }

private:
  static constexpr unsigned outlier = 1;
  /// Without a number at the start, or with one that the sums in float cannot hold: out of all
  /// sums, which one of them would spoil.
  static constexpr unsigned unusable = 2;
  static constexpr double largest_chi2 = 1e30;

  FT_HOST_DEVICE static unsigned flags(scratch const& s, int i, pose_problem const& problem) {
    return i < scratch_size ? s.pixel[i].flags : problem.outlier[i];
  }
  FT_HOST_DEVICE static void set_flags(scratch& s, int i, pose_problem const& problem,
                                       unsigned flags) {
    if (i < scratch_size) {
      s.pixel[i].flags = flags;
    } else {
      problem.outlier[i] = static_cast<unsigned char>(flags);
    }
  }
  FT_HOST_DEVICE static vec3<float> narrowed(vec3<detail::real> p) {
    return {static_cast<float>(p.x.value), static_cast<float>(p.y.value),
            static_cast<float>(p.z.value)};
  }

  /// Observation i with its point in the camera's frame at the start; of weight 0 where it does not
  /// count.
  FT_HOST_DEVICE static observation prepared(scratch const& s, int i, pose_problem const& problem) {
    if (i < scratch_size) {
      auto const place = s.place[i];
      auto const pixel = s.pixel[i];
      return {place.point, pixel.u,      pixel.v,
              pixel.third, place.weight, Rig::rectified ? 0 : static_cast<int>(pixel.third)};
    }
    observation o = problem.observations[i];
    auto const start = problem.start->template cast<strict_double>();
    o.point = narrowed(start * vec3<detail::real>{static_cast<double>(o.point.x),
                                                  static_cast<double>(o.point.y),
                                                  static_cast<double>(o.point.z)});
    if (problem.outlier[i] != 0) { o.inv_sigma2 = 0; }
    return o;
  }

  /// Whether observation i is an outlier at s.T, for its flag and the next round. True if that is
  /// new.
  FT_HOST_DEVICE static bool classify(scratch& s, int i, Rig const& rig,
                                      pose_problem const& problem, pose_params const& params) {
    observation const o = problem.observations[i];
    reprojection<Rig> const r(rig, s.T, o);
    // Written so that a NaN is too far.
    bool const far = !(r.chi2(o) <= (r.rows == 3 ? params.chi2_stereo : params.chi2_mono));
    unsigned const before = flags(s, i, problem);
    unsigned const after = (before & unusable) | (far ? outlier : 0);
    set_flags(s, i, problem, after);
    if (i < scratch_size) { s.place[i].weight = after != 0 ? 0.0f : o.inv_sigma2; }
    return before != after;
  }

  /// Gradient, curvature and cost after motion D, over the observations that count; then `then()`.
  template <typename Group, typename Then>
  FT_HOST_DEVICE static void linearize(Group g, scratch& s, Rig const& rig,
                                       pose_problem const& problem, pose_params const& params,
                                       rigid<strict_float> const& D, bool robust,
                                       Then const& then) {
    using real = strict_float;
    real const limit_mono = static_cast<float>(params.chi2_mono);
    real const limit_stereo = static_cast<float>(params.chi2_stereo);
    auto const add = [&](int i, sum_terms<terms>& acc) {
      observation const o = prepared(s, i, problem);
      if (!(o.inv_sigma2 > 0)) { return; }
      reprojection<Rig, real, true> const r(rig, D, o);
      real const chi2 = r.chi2(o);
      real const limit = r.rows == 3 ? limit_stereo : limit_mono;
      real weight = o.inv_sigma2;
      real cost = chi2;
      if (robust && chi2 > limit) {  // Huber
        real const product = scalar::sqrt(limit * chi2);
        cost = real(2.0f) * product - limit;
        weight = weight * (limit / product);
      }
      acc.of[terms - 1] += cost.value;
      real P[3][3];
      r.derivative(rig, o, P);
      // A row that is not there has no weight.
      vec3<real> const weights{weight, weight, r.rows == 3 ? weight : real(0.0f)};
      detail::add_motion_terms(r.in_body, P, weights, {r.error[0], r.error[1], r.error[2]},
                               Rig::rectified, acc.of);
    };
    ordered_sum<terms>(g, s.sums, problem.count, add, then);
  }

  /// Finds the best pose for the observations that count.
  template <typename Group>
  FT_HOST_DEVICE static void run_round(Group g, scratch& s, Rig const& rig,
                                       pose_problem const& problem, pose_params const& params,
                                       bool robust) {
    auto D = rigid<strict_float>::identity();
    FT_NO_UNROLL
    for (bool first = true, running = true; running; first = false) {
      linearize(g, s, rig, problem, params, D, robust, [&] {
        // On copies: loads from scratch at once, not one after another between stores.
        detail::damped_descent next = s.descent;
        sum_terms<terms> sums = s.sums.total;
        bool better = true;
        if (first) {
          next.begin(sums, params);
        } else {
          better = next.judge(sums, params);
        }
        if (better) {
          s.best = sums;
        } else {
          sums = s.best;
        }
        next.propose(sums, params);
        s.descent = next;
        if (!next.running) {
          s.T =
              next.D.template cast<strict_double>() * problem.start->template cast<strict_double>();
        }
      });
      running = s.descent.running;
      D = s.descent.trial;
    }
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
  using solver = optimize_pose<Rig>;
  struct scratch {
    typename solver::scratch pose;
    int number[solver::scratch_size];  ///< keypoint number of an observation
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, Rig const& rig,
                                 frame_view const& frame, map_points_view const& map,
                                 pyramid_geometry const& geometry, pose_params const& params,
                                 pose const* start, pose* result,
                                 observations_view const& out) const {
    map_points_view const points = map.slice(b);
    int* const holder = frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers();
    std::ptrdiff_t const at = static_cast<std::ptrdiff_t>(b) * out.capacity;
    int const first = *frame.camera(b, 0).count;
    int const all = first + (frame.cameras > 1 ? *frame.camera(b, 1).count : 0);
    if (g.rank() == 0) { s.pose.T = start[b].template cast<strict_double>(); }
    int const n = list_observations(g, s, first, all, frame.capacity(), holder, out.number + at);
    pose_problem const problem{out.items + at, n, start + b, result + b, out.outlier + at,
                               out.inliers + b};
    auto const number_of = [&](int i) {
      return i < solver::scratch_size ? s.number[i] : out.number[at + i];
    };
    FT_NO_UNROLL
    for (int i = g.rank(); i < n; i += g.size()) {
      int const number = number_of(i);
      int const c = number < frame.capacity() ? 0 : 1;
      int const k = number - c * frame.capacity();
      keypoints_view const kp = frame.camera(b, c);
      float const right = Rig::rectified && frame.right_x != nullptr
                              ? frame.right_x[static_cast<std::ptrdiff_t>(b) * frame.capacity() + k]
                              : -1.0f;
      observation const o{get<field::position>(points, holder[number]),
                          get<field::x>(kp, k),
                          get<field::y>(kp, k),
                          right,
                          geometry.inv_sigma2[get<field::octave>(kp, k)],
                          c};
      out.items[at + i] = o;
      solver::prepare(s.pose, i, rig, problem, o);
    }
    if (g.rank() == 0) { out.count[b] = n; }
    solver::solve(g, s.pose, rig, problem, params);
    FT_NO_UNROLL
    for (int i = g.rank(); i < n; i += g.size()) {
      if (solver::is_outlier(s.pose, i, problem)) { holder[number_of(i)] = -1; }
    }
  }

private:
  /// Lists the numbers of the keypoints that hold a point. Returns how many. @param first keypoints
  /// of the first camera @param all of both
  template <typename Group>
  FT_HOST_DEVICE static int list_observations(Group g, scratch& s, int first, int all, int capacity,
                                              int const* holder, int* listed) {
    // Each part takes a run of keypoints: one scan, over the parts, gives all their places.
    auto const part = g.part();
    int const run = ceil_div(all, g.size()) * part.size();
    int const from = g.part_index() * run;
    int const to = min_of(from + run, all);
    auto const number_of = [&](int k) { return k < first ? k : k - first + capacity; };
    auto const holds = [&](int k) { return k < to && holder[number_of(k)] >= 0; };
    int mine = 0;
    constexpr int at_once = 4;  // loads
    FT_NO_UNROLL
    for (int k = from + part.rank(); k < to; k += at_once * part.size()) {
      FT_UNROLL
      for (int j = 0; j < at_once; ++j) { mine += static_cast<int>(holds(k + j * part.size())); }
    }
    int n = 0;
    int place = part.shuffle(g.exclusive_scan(mine, n), 0);
    FT_NO_UNROLL
    for (int k = from + part.rank(); k - part.rank() < to; k += part.size()) {
      bool const held = holds(k);
      int count = 0;
      int const i = place + part.exclusive_count(held, count);
      if (held) {
        listed[i] = number_of(k);
        if (i < solver::scratch_size) { s.number[i] = number_of(k); }
      }
      place += count;
    }
    g.sync();
    return n;
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
