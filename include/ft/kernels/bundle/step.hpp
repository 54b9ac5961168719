// SPDX-License-Identifier: Apache-2.0
/// @file Steps of a bundle's views and points, and what became of them.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/core/stage.hpp"
#include "ft/kernels/bundle/conjugate_gradients.hpp"
#include "ft/kernels/bundle/system.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/math/so3.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// What is known of views and points.
struct bundle_verdict {
  double cost;           ///< robust
  double chi2;           ///< sum of squared weighted errors
  double without_image;  ///< observations
  double promised;       ///< by how much the linear system says that the step lowers the cost
  int solver_steps;      ///< of the conjugate gradients
};

/// One item: a view that moves.
struct move_view {
  using scratch = no_scratch;
  double damping;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, bundle_system_view const& A,
                                 rigid<double> const* from, rigid<double>* to) const {
    int const v = A.moving_view[item];
    double const* const x = entry<6>(A.solution, item);
    real64 promise = 0.0;
    bool stays = true;
    for (int k = 0; k < 6; ++k) {
      real64 const step = x[k];
      real64 const damped = real64(damping) * real64(entry<6>(A.view_diagonal, item)[k]);
      promise += step * (real64(entry<6>(A.view_right, item)[k]) + damped * step);
      stays = stays && x[k] == 0;
    }
    A.promise[item] = promise.value;
    if (stays) {  // to the bit
      to[v] = from[v];
      return;
    }
    strict_mat3d const R = from[v].R.template cast<real64>() * rotation_exp(load_3(x));
    strict_vec3d const centre = from[v].template cast<real64>().centre();
    to[v] =
        rigid<real64>{R, R * (load_3(x + 3) - centre)}.orthonormalized().template cast<double>();
  }
};

/// One item: a point. Where a camera would lose its image by the step, it makes a shorter one: far
/// points and outliers would leap behind cameras, from where no derivative leads back.
/// @tparam Camera of strict_double
template <typename Camera>
struct move_point {
  using scratch = no_scratch;
  static constexpr int halvings = 6;
  double damping;

  template <typename Group, typename Given>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, bundle_system_view const& A,
                                 Given const* cameras, rigid<double> const* T_cw,
                                 vec3<double> const* from, vec3<double>* to) const {
    strict_vec3d const X = from[item].template cast<real64>();
    strict_vec3d step =
        load_3(entry<3>(A.point_start, item)) - answer_of_point(item, A, X, A.solution);
    double const* const H = entry<6>(A.point_matrix, item);
    real64 const l = damping;
    strict_vec3d const damped{l * real64(H[0]) * step.x, l * real64(H[3]) * step.y,
                              l * real64(H[5]) * step.z};
    A.promise[A.moving + item] = dot(step, load_3(entry<3>(A.point_right, item)) + damped).value;
    FT_NO_UNROLL
    for (int k = 0; k < halvings && loses_image(item, A, cameras, T_cw, X + step); ++k) {
      step = scaled(step, real64(0.5));
    }
    to[item] = (X + step).template cast<double>();
  }

private:
  /// Whether a camera does not see the point that saw it before.
  template <typename Given>
  FT_HOST_DEVICE static bool loses_image(int p, bundle_system_view const& A, Given const* cameras,
                                         rigid<double> const* T_cw, strict_vec3d const& X) {
    bool lost = false;
    FT_NO_UNROLL
    for (int at = A.point_begin[p]; at < A.point_begin[p + 1] && !lost; ++at) {
      int const o = A.sighting[at];
      int const v = A.view[o];
      double const* const C = entry<6>(A.curvature, o);
      bool const seen = C[0] + C[3] + C[5] > 0;
      Camera const camera = cameras[A.camera[v]].template cast<real64>();
      strict_vec3d const in_view = T_cw[v].cast<real64>() * X;
      lost = seen && !camera.project(in_view).valid;
      if (seen && !lost && has_right(A, o)) {
        lost = !camera.project(from_right(A, v, in_view)).valid;
      }
    }
    return lost;
  }
};

/// One item: the verdict about views and points.
struct judge_bundle {
  struct scratch {
    ordered_sum_scratch<3, double> costs;
    ordered_sum_scratch<1, double> promise;
  };
  int promises;  ///< 0: there was no step

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int, bundle_system_view const& A,
                                 bundle_verdict* verdict) const {
    ordered_sum(g, s.costs, A.views, [&](int v, sum_terms<3, double>& acc) {
      for (int k = 0; k < 3; ++k) { acc.of[k] += entry<3>(A.cost, v)[k]; }
    });
    ordered_sum(g, s.promise, promises,
                [&](int k, sum_terms<1, double>& acc) { acc.of[0] += A.promise[k]; });
    if (g.rank() != 0) { return; }
    real64 const promised = s.promise.total.of[0];
    // A point that is not finite has no image, which has a cost: here it becomes none.
    real64 const cost = real64(s.costs.total.of[0]) + (promised - promised);
    *verdict = {cost.value, s.costs.total.of[1], s.costs.total.of[2], promised.value,
                promises > 0 ? A.state->steps : 0};
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
