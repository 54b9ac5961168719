// SPDX-License-Identifier: Apache-2.0
/// @file What an accelerometer says about the centres of a window's views, whatever their
/// velocities.
#pragma once

#include <cstddef>

#include "ft/containers/window_problem.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

// Between two views, T apart, positions p, velocities v and an error a of the acceleration follow
//
//     p' = p + T v + T^2/2 a + P + e_p,   v' = v + T a + V + e_v,   a' = a + e_a,
//
// for each axis of the world alike, with P and V from the integral and errors e that have nothing
// in common with those of other steps. The squared weighted errors of all steps, smallest over the
// velocities and errors of the acceleration, are a quadratic cost of the positions: v and a of each
// view are eliminated in the order of time. Positions that follow P and V alone cost nothing.

/// From one view to the next.
struct chain_step {
  vec3<double> P, V;  ///< metres, m/s
  vec3<double> arm;   ///< from the centre of the view at the end to the body there, world
  double T;           ///< seconds; 0 = nothing is known
  double pp, pv, vv;  ///< covariance of (e_p, e_v): m^2, m^2/s, m^2/s^2
  double aa;          ///< variance of e_a, (m/s^2)^2
};

struct chain_scratch {
  chain_step steps[max_window_views];  ///< to a view from the one before; the first is not read
  vec3<double> first_arm;              ///< as chain_step::arm, of the first view
  /// Rows of v, a, v', a' in the information, by columns: the views' positions, then these four.
  double row[4][max_window_views + 4];
  double step[6][6];  ///< information of (p, v, a, p', v', a') by one step
};

/// Builds the cost of the centres of one problem. All threads of a group call with one object.
template <typename Group>
class centre_chain {
public:
  using real = strict_double;

  FT_HOST_DEVICE centre_chain(Group g, chain_scratch& s, window_problem_view const& problem, int b)
      : g_(g),
        s_(s),
        views_(problem.view_count[b]),
        stride_(problem.views),
        Q_(problem.centre_information + problem.view(b, 0) * problem.views),
        T_cw_(problem.T_cw + problem.view(b, 0)),
        goal_(problem.centre_goal + problem.view(b, 0)) {}

  /// After a barrier behind the writing of the scratch.
  /// @param sigma of the error of the acceleration, m/s^2
  FT_HOST_DEVICE void build(double sigma) {
    for (int k = g_.rank(); k < views_ * stride_; k += g_.size()) { Q_[k] = 0; }
    for (int k = g_.rank(); k < 4 * (max_window_views + 4); k += g_.size()) {
      s_.row[k / (max_window_views + 4)][k % (max_window_views + 4)] = 0;
    }
    g_.sync();
    double const known = (real(1.0) / (real(sigma) * real(sigma))).value;
    if (g_.rank() == 0) {
      place_goals();
      at(1, views_ + 1) = known;
    }
    for (int k = 1; k < views_; ++k) {
      if (!(s_.steps[k].T > 0)) {  // nothing joins the two: the chain begins anew
        end(k - 1);
        if (g_.rank() == 0) { at(1, views_ + 1) = known; }
        g_.sync();
        continue;
      }
      add_step(k);
      end(k);
      shift();
    }
    end(views_ - 1);
  }

private:
  /// An entry of the rows of v, a, v', a'. @param column of a view, or views_ + such a row
  FT_HOST_DEVICE double& at(int row, int column) const { return s_.row[row][column]; }

  FT_HOST_DEVICE void place_goals() const {
    vec3<real> body{0.0, 0.0, 0.0}, v{0.0, 0.0, 0.0};
    bool follows = false;
    for (int k = 0; k < views_; ++k) {
      chain_step const& step = s_.steps[k];
      vec3<real> const arm = k == 0 ? s_.first_arm.cast<real>() : step.arm.cast<real>();
      vec3<real> const now = T_cw_[k].cast<real>().centre() + arm;
      bool const joined = k > 0 && step.T > 0;
      if (joined) {
        vec3<real> const P = step.P.cast<real>();
        if (!follows) { v = scaled(now - body - P, real(1.0) / real(step.T)); }
        body = body + scaled(v, real(step.T)) + P;
        v = v + step.V.cast<real>();
      } else {
        body = now;
      }
      follows = joined;
      goal_[k] = (body - arm).template cast<double>();
    }
  }
  /// Adds the information of the step to view k.
  FT_HOST_DEVICE void add_step(int k) const {
    chain_step const& step = s_.steps[k];
    for (int e = g_.rank(); e < 36; e += g_.size()) {
      s_.step[e / 6][e % 6] = information(step, e / 6, e % 6);
    }
    g_.sync();
    int const column[6] = {k - 1, views_, views_ + 1, k, views_ + 2, views_ + 3};
    for (int e = g_.rank(); e < 36; e += g_.size()) {
      int const r = e / 6;
      int const c = e % 6;
      bool const position = r % 3 == 0;
      double& to = position && c % 3 == 0 ? Q_[column[r] * stride_ + column[c]]
                   : position             ? at(row_of(c), column[r])
                                          : at(row_of(r), column[c]);
      if (position && c % 3 != 0) { continue; }  // as the entry across the diagonal
      to = (real(to) + real(s_.step[r][c])).value;
    }
    g_.sync();
  }
  /// Row of the variable 1, 2, 4, 5 of a step.
  FT_HOST_DEVICE static int row_of(int variable) {
    return variable < 3 ? variable - 1 : variable - 2;
  }

  /// Entry of J^T W J, J by the variables of a step, W the inverse of its covariance.
  FT_HOST_DEVICE static double information(chain_step const& s, int i, int j) {
    real const T = s.T;
    real const half = real(0.5) * T * T;
    auto const derivative = [&](int error, int variable) {
      real const by_p[6] = {-1.0, -T, -half, 1.0, 0.0, 0.0};
      real const by_v[6] = {0.0, -1.0, -T, 0.0, 1.0, 0.0};
      real const by_a[6] = {0.0, 0.0, -1.0, 0.0, 0.0, 1.0};
      return error == 0 ? by_p[variable] : error == 1 ? by_v[variable] : by_a[variable];
    };
    real const pp = s.pp, pv = s.pv, vv = s.vv;
    real const scale = real(1.0) / (pp * vv - pv * pv);
    real const p_i = derivative(0, i), v_i = derivative(1, i);
    real const p_j = derivative(0, j), v_j = derivative(1, j);
    real const moved = scale * (vv * (p_i * p_j) - pv * (p_i * v_j + v_i * p_j) + pp * (v_i * v_j));
    return (moved + derivative(2, i) * derivative(2, j) / real(s.aa)).value;
  }
  /// Eliminates v and a. @param last view that has an entry
  FT_HOST_DEVICE void end(int last) const {
    for (int pivot = 0; pivot < 2; ++pivot) { eliminate(pivot, last); }
  }
  FT_HOST_DEVICE void eliminate(int pivot, int last) const {
    // The positions of views 0 to last, then the rows.
    int const count = last + 1 + 4;
    auto const column = [&](int n) { return n <= last ? n : views_ + n - last - 1; };
    real const own = at(pivot, views_ + pivot);
    if (own > real(0.0)) {
      real const inverse = real(1.0) / own;
      for (int e = g_.rank(); e < count * count; e += g_.size()) {
        int const r = column(e / count);
        int const c = column(e % count);
        if (r == views_ + pivot || c == views_ + pivot) { continue; }
        if (r < views_ && c >= views_) { continue; }  // kept in the other's row
        double& to = r < views_ ? Q_[r * stride_ + c] : at(r - views_, c);
        to = (real(to) - (real(at(pivot, r)) * real(at(pivot, c))) * inverse).value;
      }
    }
    g_.sync();
    for (int n = g_.rank(); n < count; n += g_.size()) {
      at(pivot, column(n)) = 0;
      if (column(n) >= views_) { at(column(n) - views_, views_ + pivot) = 0; }
    }
    g_.sync();
  }
  /// v' and a' become v and a.
  FT_HOST_DEVICE void shift() const {
    for (int n = g_.rank(); n < views_ + 2; n += g_.size()) {
      int const from = n < views_ ? n : n + 2;
      for (int r = 0; r < 2; ++r) { at(r, n) = at(r + 2, from); }
    }
    g_.sync();
    for (int n = g_.rank(); n < views_ + 4; n += g_.size()) {
      for (int r = 2; r < 4; ++r) { at(r, n) = 0; }
      if (n >= views_ + 2) { at(0, n) = at(1, n) = 0; }
    }
    g_.sync();
  }

  Group g_;
  chain_scratch& s_;
  int views_, stride_;
  double* Q_;
  rigid<double> const* T_cw_;
  vec3<double>* goal_;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
