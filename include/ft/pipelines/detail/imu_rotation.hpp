// SPDX-License-Identifier: Apache-2.0
/// @file How an IMU is turned from where its calibration says.
///
/// With a rotation by an angle about an axis, a vector s is seen that was g; so s - g = c x (s + g)
/// / 2, with c = 2 tan(angle / 2) axis (Cayley's form: exact). Here g is how the gyroscope turned
/// between two images, and s how the images did. The least squares for c and the gyroscope's bias
/// are linear. The tangent of half a turn is infinite: so g is also turned by half a turn about
/// each axis before. Of a quaternion's four parts one is at least a half, so that one of the four
/// angles that remain is at most 120 degrees; the one that suits the turns best counts, unless
/// another rotation suits them about as well. Turning about one axis alone does not tell the
/// rotation about it; nor are swapped axes told, which are no rotation.
///
/// Turns that overlap may share their errors, as those of a map that drifts, or not, as those of
/// single images. What remains of overlapping turns tells which: the covariance grows by the sum of
/// its autocorrelations (Newey and West, "A simple, positive semi-definite, heteroskedasticity and
/// autocorrelation consistent covariance matrix", Econometrica 1987, unweighted).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/math/positive_definite.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/math/so3.hpp"
#include "ft/pipelines/detail/overlapping_turns.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The estimator of one camera. Allocates nothing.
class imu_rotation {
public:
  /// How a body turned between two times.
  struct turn {
    std::int64_t from_ns, to_ns;
    strict_vec3d seen;      ///< by the images, rad, in the IMU's frame as T_bc says
    strict_vec3d measured;  ///< by the gyroscope, rad
  };

  void clear() { *this = {}; }
  /// @param t ends after those before it @param keep share of their weight that remains
  void add(turn const& t, real64 keep) {
    kept_turn const now = kept_turn::of_turn(t);
    kept_turn const before = last_.sum_after(t.from_ns);
    last_.keep(now);
    count_ = keep * count_ + real64(1.0);
    turned_ = keep * turned_ + dot(t.seen, t.seen);
    for (std::size_t h = 0; h < halves; ++h) {
      each_[h].add(now.of[h], now.of[h], keep);
      shared_[h].add(now.of[h], before.of[h], keep);
    }
  }
  imu_misalignment estimate() const {
    imu_misalignment out;
    if (!(count_ > real64(fewest))) { return out; }
    std::array<branch, halves> all;
    std::size_t best = 0;
    for (std::size_t h = 0; h < halves; ++h) {
      all[h] = solve(h);
      if (all[h].rest < all[best].rest) { best = h; }
    }
    if (!(all[best].rest < real64(most_rest) * turned_)) { return out; }
    for (branch const& other : all) {
      if (rivals(other, all[best])) { return out; }
    }
    out.sigma = all[best].sigma.value;
    out.turn = all[best].turn.template cast<double>();
    out.known = out.sigma < most_sigma;
    return out;
  }

private:
  static constexpr int most = 16;                 ///< turns that overlap a later one are fewer
  static constexpr std::size_t halves = 4;        ///< none, half a turn about x, y and z
  static constexpr double fewest = 30;            ///< turns: fewer tell nothing
  static constexpr double most_sigma = 1.745e-3;  ///< rad: 0.1 degree
  static constexpr double most_rest = 0.01;       ///< of squared turns: more, and it is no rotation
  static constexpr double clear_rest = 2;         ///< of two rotations, to tell the better one

  /// off = J (c, bias)
  struct equations {
    real64 J[3][6], off[3];

    void add(equations const& e) {
      for (int r = 0; r < 3; ++r) {
        off[r] = off[r] + e.off[r];
        for (int i = 0; i < 6; ++i) { J[r][i] = J[r][i] + e.J[r][i]; }
      }
    }
  };
  struct kept_turn {
    std::int64_t to_ns;
    equations of[halves];

    static kept_turn of_turn(turn const& t) {
      strict_vec3d const& g = t.measured;
      return {t.to_ns,
              {equations_of(t, g), equations_of(t, {g.x, -g.y, -g.z}),
               equations_of(t, {-g.x, g.y, -g.z}), equations_of(t, {-g.x, -g.y, g.z})}};
    }
    void add(kept_turn const& t) {
      for (std::size_t h = 0; h < halves; ++h) { of[h].add(t.of[h]); }
    }
  };
  /// Of pairs of turns: products of what remains with some x, as a quadratic form of it.
  struct sums {
    real64 v[43] = {};

    real64 right(int i) const { return v[1 + i]; }
    real64 matrix(int i, int j) const { return v[7 + 6 * i + j]; }
    void add(equations const& a, equations const& b, real64 keep) {
      for (real64& x : v) { x = keep * x; }
      for (int r = 0; r < 3; ++r) {
        v[0] = v[0] + a.off[r] * b.off[r];
        for (int i = 0; i < 6; ++i) {
          v[1 + i] = v[1 + i] + (a.J[r][i] * b.off[r] + b.J[r][i] * a.off[r]);
          for (int j = 0; j < 6; ++j) {
            v[7 + 6 * i + j] = v[7 + 6 * i + j] + a.J[r][i] * b.J[r][j];
          }
        }
      }
    }
    real64 product(real64 const (&x)[6]) const {
      real64 sum = v[0];
      for (int i = 0; i < 6; ++i) {
        real64 row = -right(i);
        for (int j = 0; j < 6; ++j) { row = row + matrix(i, j) * x[j]; }
        sum = sum + x[i] * row;
      }
      return sum;
    }
  };

  static equations equations_of(turn const& t, strict_vec3d const& g) {
    strict_vec3d const off = t.seen - g;
    strict_mat3d const M = cross_matrix(scaled(t.seen + g, real64(-0.5)));
    real64 const duration = static_cast<double>(t.to_ns - t.from_ns) * 1e-9;
    equations e{{}, {off.x, off.y, off.z}};
    for (int r = 0; r < 3; ++r) {
      for (int i = 0; i < 3; ++i) {
        e.J[r][i] = M.m[3 * r + i];
        e.J[r][3 + i] = i == r ? duration : real64(0.0);
      }
    }
    return e;
  }
  /// A solution, and what remains with it.
  struct branch {
    real64 rest = std::numeric_limits<double>::infinity();  ///< there is none
    real64 sigma = 0.0;                                     ///< rad
    strict_vec3d turn;                                      ///< rotation vector
  };
  /// Whether it suits the turns about as well, and is another rotation: those about one axis alone
  /// suit several, and noise would choose.
  static bool rivals(branch const& other, branch const& best) {
    if (!(other.rest < real64(clear_rest) * best.rest)) { return false; }
    strict_mat3d const R = rotation_exp(other.turn).transposed() * rotation_exp(best.turn);
    return real64(3.0) - (R.m[0] + R.m[4] + R.m[8]) > real64(1.0);  // by 60 degrees and more
  }
  /// The trace of a covariance of c, as one of the rotation: c = 2 tan(angle / 2) axis grows faster
  /// than the angle.
  static real64 angular(double const (&of_c)[36], strict_vec3d const& c) {
    real64 const all = of_c[0] + of_c[7] + of_c[14];
    real64 const square = dot(c, c), grows = real64(1.0) + real64(0.25) * square;
    real64 const cc[3] = {c.x, c.y, c.z};
    real64 along = 0.0;
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) { along = along + cc[i] * real64(of_c[6 * i + j]) * cc[j]; }
    }
    along = square > real64(0.0) ? along / square : all;
    return (all - along) / grows + along / (grows * grows);
  }
  /// After half a turn h.
  branch solve(std::size_t h) const {
    branch out;
    real64 upper[21];
    for (int i = 0, n = 0; i < 6; ++i) {
      for (int j = i; j < 6; ++j) { upper[n++] = each_[h].matrix(i, j); }
    }
    double inverse[36];
    if (!invert_6(upper, inverse)) { return out; }
    real64 x[6];
    for (int i = 0; i < 6; ++i) {
      x[i] = 0.0;
      for (int j = 0; j < 6; ++j) {
        x[i] = x[i] + real64(0.5 * inverse[6 * i + j]) * each_[h].right(j);
      }
    }
    out.rest = max_of(each_[h].product(x), real64(1e-12));
    real64 const degrees = real64(3.0) * count_ - real64(6.0);
    real64 const shared = shared_[h].product(x);
    real64 const variance = max_of(out.rest + shared + shared, out.rest) / degrees;
    out.sigma = scalar::sqrt(variance * angular(inverse, {x[0], x[1], x[2]}));
    out.turn = rotation_vector_of({x[0], x[1], x[2]}, h);
    return out;
  }
  /// Of half a turn h and then a turn by c, as a product of quaternions: no angle is too large.
  static strict_vec3d rotation_vector_of(strict_vec3d const& c, std::size_t h) {
    strict_vec3d axis = scaled(c, real64(0.5));
    real64 w = 1.0;
    if (h > 0) {
      strict_vec3d const half{real64(h == 1 ? 1.0 : 0.0), real64(h == 2 ? 1.0 : 0.0),
                              real64(h == 3 ? 1.0 : 0.0)};
      w = -dot(axis, half);
      axis = half + cross(axis, half);
    }
    if (w < real64(0.0)) { w = -w, axis = -axis; }
    real64 const n = norm(axis);
    return n > real64(0.0) ? scaled(axis, real64(2.0) * strict_atan2(n, w) / n) : axis;
  }

  overlapping_turns<kept_turn, most> last_;
  std::array<sums, halves> each_, shared_;  ///< of turns with themselves, with earlier ones
  real64 count_ = 0.0;                      ///< of turns
  real64 turned_ = 0.0;                     ///< sum of their squares
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
