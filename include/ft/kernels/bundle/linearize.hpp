// SPDX-License-Identifier: Apache-2.0
/// @file Errors of a bundle's observations, their robust costs and their derivatives.
#pragma once

#include <cstddef>

#include "ft/cameras/camera_model.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/core/stage.hpp"
#include "ft/kernels/bundle/system.hpp"
#include "ft/math/positive_definite.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// What an observation costs.
struct observation_rule {
  double huber;     ///< standard deviations from which the cost grows linearly; 0: none
  double no_image;  ///< cost of an observation whose point has no image

  FT_HOST_DEVICE bool is_far(real64 chi2) const {
    real64 const width = huber;
    return width > real64(0.0) && chi2 > width * width;
  }
  FT_HOST_DEVICE real64 cost(real64 chi2) const {
    if (!is_far(chi2)) { return chi2; }
    real64 const width = huber;
    return real64(2.0) * (width * scalar::sqrt(chi2)) - width * width;
  }
  /// Derivative of the cost by chi2.
  FT_HOST_DEVICE real64 weight(real64 chi2) const {
    return is_far(chi2) ? real64(huber) / scalar::sqrt(chi2) : real64(1.0);
  }
  /// Along its error the cost of a far observation grows linearly: its second derivative there is
  /// 0, that of the weighted square is not. Half of both is taken from C: fewer steps than with the
  /// weights alone, while C keeps its rank.
  FT_HOST_DEVICE void flatten(real64 chi2, real64 squared_pixels, real64 w, strict_vec3d const& f,
                              symmetric_3<real64>& C) const {
    if (!is_far(chi2)) { return; }
    real64 const share = real64(0.5) / (squared_pixels * w);
    strict_vec3d const h = scaled(f, share);
    C = {C.xx - h.x * f.x, C.xy - h.x * f.y, C.xz - h.x * f.z,
         C.yy - h.y * f.y, C.yz - h.y * f.z, C.zz - h.z * f.z};
  }
};

/// One item: a view. Costs of its observations, and how many have no image.
/// @tparam Camera of strict_double
template <typename Camera>
struct measure_view {
  using scratch = ordered_sum_scratch<3, double>;
  observation_rule rule;

  template <typename Group, typename Given>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, bundle_system_view const& A,
                                 Given const* cameras, rigid<double> const* T_cw,
                                 vec3<double> const* position) const {
    Camera const camera = cameras[A.camera[item]].template cast<real64>();
    auto const T = T_cw[item].cast<real64>();
    int const begin = A.view_begin[item];
    ordered_sum(g, s, A.view_begin[item + 1] - begin, [&](int k, sum_terms<3, double>& acc) {
      int const o = begin + k;
      strict_vec3d const p = T * position[A.point[o]].template cast<real64>();
      auto const image = camera.project(p);
      real64 const x = image.pixel.x - real64(A.pixel[o].x);
      real64 const y = image.pixel.y - real64(A.pixel[o].y);
      real64 squared = x * x + y * y;
      bool valid = image.valid;
      if (has_right(A, o)) {
        auto const right = camera.project(from_right(A, item, p));
        real64 const r = right.pixel.x - real64(A.right_x[o]);
        squared += r * r;
        valid = valid && right.valid;
      }
      real64 const chi2 = real64(A.weight[o]) * squared;
      if (valid && scalar::is_finite(chi2)) {
        acc.of[0] += rule.cost(chi2).value;
        acc.of[1] += chi2.value;
      } else {
        acc.of[0] += rule.no_image;
        acc.of[2] += 1;
      }
    });
    if (g.rank() == 0) {
      for (int k = 0; k < 3; ++k) { entry<3>(A.cost, item)[k] = s.total.of[k]; }
    }
  }
};

/// One item: a view. Curvatures and gradients of its observations, and their sums of the view.
/// @tparam Camera of strict_double
template <typename Camera>
struct linearize_view {
  using scratch = ordered_sum_scratch<12, double>;
  observation_rule rule;

  template <typename Group, typename Given>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, bundle_system_view const& A,
                                 Given const* cameras, rigid<double> const* T_cw,
                                 vec3<double> const* position) const {
    Camera const camera = cameras[A.camera[item]].template cast<real64>();
    auto const T = T_cw[item].cast<real64>();
    strict_vec3d const centre = T.centre();
    int const begin = A.view_begin[item];
    ordered_sum(g, s, A.view_begin[item + 1] - begin, [&](int k, sum_terms<12, double>& acc) {
      strict_vec3d const X = position[A.point[begin + k]].template cast<real64>();
      add(camera, T, X, X - centre, A, item, begin + k, acc);
    });
    if (g.rank() != 0) { return; }
    A.centre[item] = centre.template cast<double>();
    int const place = A.place[item];
    if (place < 0) { return; }
    for (int k = 0; k < 6; ++k) {
      entry<6>(A.view_diagonal, place)[k] = s.total.of[k];
      entry<6>(A.view_right, place)[k] = s.total.of[6 + k];
    }
  }

private:
  /// Of an observation's column in the right image, with its derivative by the point's position.
  struct right_error {
    bool there;
    bool valid = false;
    real64 error = 0.0;
    strict_vec3d slope{0.0, 0.0, 0.0};

    FT_HOST_DEVICE right_error(Camera const& lens, rigid<real64> const& T,
                               strict_vec3d const& in_view, bundle_system_view const& A, int view,
                               int o)
        : there(has_right(A, o)) {
      if (!there) { return; }
      auto const at = lens.project_with_jacobian(from_right(A, view, in_view));
      auto const& J = at.jacobian.m;
      valid = at.value.valid;
      error = at.value.pixel.x - real64(A.right_x[o]);
      slope = row_times({J[0], J[1], J[2]}, T.R);
    }
    FT_HOST_DEVICE void add(real64 w, symmetric_3<real64>& C, strict_vec3d& f) const {
      strict_vec3d const& c = slope;
      strict_vec3d const r = scaled(c, w);
      C = {C.xx + r.x * c.x, C.xy + r.x * c.y, C.xz + r.x * c.z,
           C.yy + r.y * c.y, C.yz + r.y * c.z, C.zz + r.z * c.z};
      f = f + scaled(r, error);
    }
  };

  FT_HOST_DEVICE void add(Camera const& camera, rigid<real64> const& T, strict_vec3d const& X,
                          strict_vec3d const& d, bundle_system_view const& A, int view, int o,
                          sum_terms<12, double>& acc) const {
    strict_vec3d const in_view = T * X;
    auto const at = camera.project_with_jacobian(in_view);
    real64 const ex = at.value.pixel.x - real64(A.pixel[o].x);
    real64 const ey = at.value.pixel.y - real64(A.pixel[o].y);
    auto const& J = at.jacobian.m;
    strict_vec3d const a = row_times({J[0], J[1], J[2]}, T.R);
    strict_vec3d const b = row_times({J[3], J[4], J[5]}, T.R);
    real64 squared = ex * ex + ey * ey;
    real64 bound = dot(a, a) + dot(b, b);
    bool valid = at.value.valid;
    right_error const right(camera, T, in_view, A, view, o);
    if (right.there) {
      squared += right.error * right.error;
      bound += dot(right.slope, right.slope);
      valid = valid && right.valid;
    }
    real64 const chi2 = real64(A.weight[o]) * squared;
    bool const seen = valid && scalar::is_finite(chi2 + bound);
    real64 const zero = 0.0;
    symmetric_3<real64> C{zero, zero, zero, zero, zero, zero};
    strict_vec3d f{zero, zero, zero};
    if (seen) {
      real64 const w = real64(A.weight[o]) * rule.weight(chi2);
      strict_vec3d const p = scaled(a, w);
      strict_vec3d const q = scaled(b, w);
      C = {p.x * a.x + q.x * b.x, p.x * a.y + q.x * b.y, p.x * a.z + q.x * b.z,
           p.y * a.y + q.y * b.y, p.y * a.z + q.y * b.z, p.z * a.z + q.z * b.z};
      f = scaled(p, ex) + scaled(q, ey);
      if (right.there) { right.add(w, C, f); }
      rule.flatten(chi2, squared, w, f, C);
    }
    double* const curvature = entry<6>(A.curvature, o);
    store_3(curvature, {C.xx, C.xy, C.xz});
    store_3(curvature + 3, {C.yy, C.yz, C.zz});
    store_3(entry<3>(A.gradient, o), f);
    acc.of[0] += turned(C.yy, C.zz, C.yz, d.z, d.y).value;
    acc.of[1] += turned(C.zz, C.xx, C.xz, d.x, d.z).value;
    acc.of[2] += turned(C.xx, C.yy, C.xy, d.y, d.x).value;
    acc.of[3] += C.xx.value;
    acc.of[4] += C.yy.value;
    acc.of[5] += C.zz.value;
    strict_vec3d const t = cross(d, f);
    acc.of[6] -= t.x.value;
    acc.of[7] -= t.y.value;
    acc.of[8] -= t.z.value;
    acc.of[9] -= f.x.value;
    acc.of[10] -= f.y.value;
    acc.of[11] -= f.z.value;
  }
  /// (-u, v) times ((a, c), (c, b)) times its transpose.
  FT_HOST_DEVICE static real64 turned(real64 a, real64 b, real64 c, real64 u, real64 v) {
    return a * (u * u) + b * (v * v) - real64(2.0) * (c * (u * v));
  }
};

/// One item: a point. Sums over its observations.
struct linearize_point {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, bundle_system_view const& A) const {
    real64 sum[9];
    FT_UNROLL
    for (int k = 0; k < 9; ++k) { sum[k] = 0.0; }
    for (int at = A.point_begin[item]; at < A.point_begin[item + 1]; ++at) {
      int const o = A.sighting[at];
      FT_UNROLL
      for (int k = 0; k < 6; ++k) { sum[k] += real64(entry<6>(A.curvature, o)[k]); }
      FT_UNROLL
      for (int k = 0; k < 3; ++k) { sum[6 + k] -= real64(entry<3>(A.gradient, o)[k]); }
    }
    FT_UNROLL
    for (int k = 0; k < 6; ++k) { entry<6>(A.point_matrix, item)[k] = sum[k].value; }
    FT_UNROLL
    for (int k = 0; k < 3; ++k) { entry<3>(A.point_right, item)[k] = sum[6 + k].value; }
  }
};

/// One item: a point. Its damped factor, and where it would move if the views stayed.
struct factor_point {
  using scratch = no_scratch;
  double damping;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, bundle_system_view const& A) const {
    point_solver const H =
        point_solver::of(load_symmetric(entry<6>(A.point_matrix, item)), damping);
    H.store(entry<6>(A.point_factor, item));
    store_3(entry<3>(A.point_start, item), H.solve(load_3(entry<3>(A.point_right, item))));
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
