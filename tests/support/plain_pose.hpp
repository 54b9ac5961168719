// SPDX-License-Identifier: Apache-2.0
/// @file Pose optimisation for a rectified pair in plain double, as specification section 11 says,
/// with nothing shared with the library's: the answer that its tests expect.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/types/poses.hpp"
#include "tests/support/example_rigs.hpp"

namespace test {

struct plain_pose_round {
  motion T;
  int steps;
  std::vector<unsigned char> outlier;
};

class plain_pose {
public:
  plain_pose(ft::rectified_rig const& rig, std::vector<ft::observation> const& all,
             motion const& start)
      : rig_(rig), all_(all), start_(start), outlier_(all.size(), 0) {}

  /// All rounds. Empty with fewer than 3 observations.
  std::vector<plain_pose_round> run() {
    std::vector<plain_pose_round> rounds;
    for (int round = 0; all_.size() >= 3 && round < (all_.size() < 10 ? 1 : 4); ++round) {
      rounds.push_back(descend(round < 3));
      for (std::size_t i = 0; i < all_.size(); ++i) {
        row_set const r = rows_of(rounds.back().T, all_[i]);
        // The reference stores both in floats.
        outlier_[i] = static_cast<float>(r.chi2) > (r.rows == 3 ? 7.815f : 5.991f) ? 1 : 0;
      }
      rounds.back().outlier = outlier_;
    }
    return rounds;
  }

  /// How far the nearest observation is from its limit at a pose, as a share of the limit.
  double nearest_limit(motion const& T) const {
    double least = 1e300;
    for (auto const& o : all_) {
      row_set const r = rows_of(T, o);
      double const limit = r.rows == 3 ? 7.815 : 5.991;
      least = std::min(least, std::abs(r.chi2 - limit) / limit);
    }
    return least;
  }

private:
  using six = std::array<double, 6>;
  struct row_set {
    int rows;
    double error[3];
    six J[3];  ///< derivatives of the prediction by the twist, rotation first
    double chi2;
  };
  struct system {
    six b{};
    std::array<six, 6> H{};
    double cost = 0;
  };

  row_set rows_of(motion const& T, ft::observation const& o) const {
    auto const d = [](float v) { return static_cast<double>(v); };
    ft::vec3<double> const p = T * ft::vec3<double>{d(o.point.x), d(o.point.y), d(o.point.z)};
    bool const stereo = o.right_u >= 0;
    double const inverse = 1.0 / p.z;
    double const iz = stereo ? static_cast<double>(static_cast<float>(inverse)) : inverse;
    double const fx = d(rig_.camera.fx);
    double const fy = d(rig_.camera.fy);
    double const bf = d(rig_.bf());
    row_set r{};
    r.rows = stereo ? 3 : 2;
    double const u = fx * p.x * iz + d(rig_.camera.cx);
    double const v = fy * p.y * iz + d(rig_.camera.cy);
    r.error[0] = d(o.u) - u;
    r.error[1] = d(o.v) - v;
    r.error[2] = stereo ? d(o.right_u) - (u - bf * iz) : 0;
    double const P[3][3] = {
        {fx * inverse, 0, -fx * p.x * inverse * inverse},
        {0, fy * inverse, -fy * p.y * inverse * inverse},
        {fx * inverse, 0, -fx * p.x * inverse * inverse + bf * inverse * inverse}};
    for (int k = 0; k < r.rows; ++k) {
      r.J[k] = {p.y * P[k][2] - p.z * P[k][1],
                p.z * P[k][0] - p.x * P[k][2],
                p.x * P[k][1] - p.y * P[k][0],
                P[k][0],
                P[k][1],
                P[k][2]};
      r.chi2 += r.error[k] * r.error[k];
    }
    r.chi2 *= d(o.inv_sigma2);
    return r;
  }

  system sums(motion const& T, bool robust) const {
    system s;
    for (std::size_t i = 0; i < all_.size(); ++i) {
      if (outlier_[i] != 0) { continue; }
      row_set const r = rows_of(T, all_[i]);
      double weight = static_cast<double>(all_[i].inv_sigma2);
      double const root = static_cast<float>(std::sqrt(r.rows == 3 ? 7.815 : 5.991));
      double const limit = root * root;
      double cost = r.chi2;
      if (robust && r.chi2 > limit) {
        cost = 2 * std::sqrt(limit * r.chi2) - limit;
        weight *= std::sqrt(limit / r.chi2);
      }
      s.cost += cost;
      for (int k = 0; k < r.rows; ++k) {
        for (std::size_t a = 0; a < 6; ++a) {
          s.b[a] += weight * r.J[k][a] * r.error[k];
          for (std::size_t c = 0; c < 6; ++c) { s.H[a][c] += weight * r.J[k][a] * r.J[k][c]; }
        }
      }
    }
    return s;
  }

  /// By Cholesky. False if H is not positive definite.
  static bool solve(std::array<six, 6> H, six b, six& x) {
    for (std::size_t i = 0; i < 6; ++i) {
      for (std::size_t j = 0; j <= i; ++j) {
        double sum = H[i][j];
        for (std::size_t k = 0; k < j; ++k) { sum -= H[i][k] * H[j][k]; }
        if (i == j && !(sum > 0)) { return false; }
        H[i][j] = i == j ? std::sqrt(sum) : sum / H[j][j];
      }
    }
    for (std::size_t i = 0; i < 6; ++i) {
      for (std::size_t k = 0; k < i; ++k) { b[i] -= H[i][k] * b[k]; }
      b[i] /= H[i][i];
    }
    for (std::size_t i = 6; i-- > 0;) {
      for (std::size_t k = i + 1; k < 6; ++k) { b[i] -= H[k][i] * b[k]; }
      b[i] /= H[i][i];
    }
    x = b;
    return true;
  }

  static motion exponential(six const& d) {
    ft::vec3<double> const w{d[0], d[1], d[2]};
    ft::vec3<double> const u{d[3], d[4], d[5]};
    double const t2 = dot(w, w);
    double const t = std::sqrt(t2);
    double const b = t < 1e-4 ? 0.5 : (1 - std::cos(t)) / t2;
    double const c = t < 1e-4 ? 1.0 / 6 : (t - std::sin(t)) / (t2 * t);
    ft::vec3<double> const wu = cross(w, u);
    motion T = turn(w, {0, 0, 0});
    T.t = u + ft::scaled(wu, b) + ft::scaled(cross(w, wu), c);
    return T;
  }

  /// One round.
  plain_pose_round descend(bool robust) const {
    motion T = start_;
    system at = sums(T, robust);
    double lambda = 0;
    for (std::size_t k = 0; k < 6; ++k) { lambda = std::max(lambda, 1e-5 * at.H[k][k]); }
    double growth = 2;
    int small_gains = 0;
    int steps = 0;
    bool running = true;
    while (running && steps < 10 && small_gains < 3) {
      running = false;
      for (int trial = 0; trial < 10 && !running && std::isfinite(lambda); ++trial) {
        auto H = at.H;
        for (std::size_t k = 0; k < 6; ++k) { H[k][k] += lambda; }
        six d{};
        double expected = 1e-3;
        system there;
        motion moved = T;
        bool good = solve(H, at.b, d);
        if (good) {
          for (std::size_t k = 0; k < 6; ++k) { expected += d[k] * (lambda * d[k] + at.b[k]); }
          moved = exponential(d) * T;
          there = sums(moved, robust);
          good = std::isfinite(there.cost) && there.cost < at.cost;
        }
        if (!good) {
          lambda *= growth;
          growth *= 2;
          continue;
        }
        double const gain = 2 * (at.cost - there.cost) / expected - 1;
        lambda *= std::max(1.0 / 3, std::min(1 - gain * gain * gain, 2.0 / 3));
        growth = 2;
        small_gains = (at.cost - there.cost) * 1e3 < at.cost ? small_gains + 1 : 0;
        T = moved;
        at = there;
        ++steps;
        running = true;
      }
    }
    return {T, steps, {}};
  }

  ft::rectified_rig rig_;
  std::vector<ft::observation> all_;
  motion start_;
  std::vector<unsigned char> outlier_;
};

}  // namespace test
