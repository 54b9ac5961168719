// SPDX-License-Identifier: Apache-2.0
/// @file How an IMU is turned from where its calibration says.
///
/// With a rotation by an angle about an axis, a vector s is seen that was g; so s - g = c x (s + g)
/// / 2, with c = 2 tan(angle / 2) axis (Cayley's form: exact). Here g is how the gyroscope turned
/// between two images, and s how the images did. The least squares for c and the gyroscope's bias
/// are linear. Turning about one axis alone does not tell the rotation about it; nor is a rotation
/// by nearly half a turn told, whose tangent is infinite, or swapped axes, which are none.
///
/// Turns that overlap may share their errors, as those of a map that drifts, or not, as those of
/// single images. What remains of overlapping turns tells which: the covariance grows by the sum of
/// its autocorrelations (Newey and West, "A simple, positive semi-definite, heteroskedasticity and
/// autocorrelation consistent covariance matrix", Econometrica 1987, unweighted).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/math/positive_definite.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/math/so3.hpp"
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
    equations const now = equations_of(t);
    equations before{};  // the sum of those that overlap
    for (int k = 0; k < kept_; ++k) {
      if (last_[at(k)].to_ns > now.from_ns) { before.add(last_[at(k)]); }
    }
    for (int k = kept_ < most ? kept_++ : most - 1; k > 0; --k) { last_[at(k)] = last_[at(k - 1)]; }
    last_[0] = now;
    count_ = keep * count_ + real64(1.0);
    turned_ = keep * turned_ + dot(t.seen, t.seen);
    each_.add(now, now, keep);
    shared_.add(now, before, keep);
  }
  imu_misalignment estimate() const {
    imu_misalignment out;
    if (!(count_ > real64(fewest))) { return out; }
    real64 const degrees = real64(3.0) * count_ - real64(6.0);
    real64 upper[21];
    for (int i = 0, n = 0; i < 6; ++i) {
      for (int j = i; j < 6; ++j) { upper[n++] = each_.matrix(i, j); }
    }
    double inverse[36];
    if (!invert_6(upper, inverse)) { return out; }
    real64 x[6];
    for (int i = 0; i < 6; ++i) {
      x[i] = 0.0;
      for (int j = 0; j < 6; ++j) {
        x[i] = x[i] + real64(0.5 * inverse[6 * i + j]) * each_.right(j);
      }
    }
    real64 const rest = max_of(each_.product(x), real64(1e-12));
    if (!(rest < real64(most_rest) * turned_)) { return out; }
    real64 const shared = shared_.product(x);
    real64 const variance = max_of(rest + shared + shared, rest) / degrees;
    out.sigma = scalar::sqrt(variance * real64(inverse[0] + inverse[7] + inverse[14])).value;
    out.turn = rotation_log(rotation_of({x[0], x[1], x[2]})).template cast<double>();
    out.known = out.sigma < most_sigma;
    return out;
  }

private:
  static constexpr int most = 16;                 ///< turns that overlap a later one are fewer
  static constexpr double fewest = 30;            ///< turns: fewer tell nothing
  static constexpr double most_sigma = 1.745e-3;  ///< rad: 0.1 degree
  static constexpr double most_rest = 0.01;       ///< of squared turns: more, and it is no rotation

  /// off = J (c, bias)
  struct equations {
    std::int64_t from_ns, to_ns;
    real64 J[3][6], off[3];

    void add(equations const& e) {
      for (int r = 0; r < 3; ++r) {
        off[r] = off[r] + e.off[r];
        for (int i = 0; i < 6; ++i) { J[r][i] = J[r][i] + e.J[r][i]; }
      }
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

  static std::size_t at(int k) { return static_cast<std::size_t>(k); }
  static equations equations_of(turn const& t) {
    strict_vec3d const off = t.seen - t.measured;
    strict_mat3d const M = cross_matrix(scaled(t.seen + t.measured, real64(-0.5)));
    real64 const duration = static_cast<double>(t.to_ns - t.from_ns) * 1e-9;
    equations e{t.from_ns, t.to_ns, {}, {off.x, off.y, off.z}};
    for (int r = 0; r < 3; ++r) {
      for (int i = 0; i < 3; ++i) {
        e.J[r][i] = M.m[3 * r + i];
        e.J[r][3 + i] = i == r ? duration : real64(0.0);
      }
    }
    return e;
  }
  static strict_mat3d rotation_of(strict_vec3d c) {
    strict_mat3d const C = cross_matrix(c);
    strict_mat3d const CC = C * C;
    real64 const scale = real64(1.0) / (real64(1.0) + real64(0.25) * dot(c, c));
    strict_mat3d R = strict_mat3d::identity();
    for (int i = 0; i < 9; ++i) { R.m[i] = R.m[i] + scale * (C.m[i] + real64(0.5) * CC.m[i]); }
    return R;
  }

  std::array<equations, most> last_{};  ///< newest first
  int kept_ = 0;                        ///< of them
  sums each_, shared_;                  ///< of turns with themselves, with overlapping earlier ones
  real64 count_ = 0.0;                  ///< of turns
  real64 turned_ = 0.0;                 ///< sum of their squares
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
