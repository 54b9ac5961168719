// SPDX-License-Identifier: Apache-2.0
/// @file How far the clock of an IMU is from that of the images.
///
/// Between two images the camera turns by what the gyroscope measured between the same two moments
/// of its own clock. For offsets on a grid the squared differences of both turns are summed, with
/// the gyroscope's bias eliminated; the least sum tells the offset, and its curvature how certain
/// that is, with the autocorrelations of what remains (see imu_rotation): turns that overlap share
/// the errors of a map that drifts. Turning at a constant rate tells nothing. Neither gravity nor
/// the accelerometer is needed. (The idea of Kelly and Sukhatme, "A general framework for temporal
/// calibration of multiple proprioceptive and exteroceptive sensors", ISER 2010, with a bias.)
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/math/so3.hpp"
#include "ft/pipelines/detail/imu_rotation.hpp"
#include "ft/pipelines/detail/overlapping_turns.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The last samples of a gyroscope as the rotation since the first one, or since the last gap or
/// spike. add() allocates nothing.
class turn_history {
public:
  static constexpr double jerk = 5;  ///< rad/s from sample to sample: no body turns so
  static constexpr std::int64_t longest_gap_ns = 100'000'000;

  void reserve(std::size_t samples) { ring_.resize(samples); }
  void clear() { count_ = 0; }
  /// @param time_ns after that of the sample before
  void add(std::int64_t time_ns, vec3<float> gyro) {
    if (ring_.empty()) { return; }
    entry next{
        time_ns,
        strict_mat3d::identity(),
        {static_cast<double>(gyro.x), static_cast<double>(gyro.y), static_cast<double>(gyro.z)}};
    if (count_ > 0) {
      entry const& last = at(count_ - 1);
      std::int64_t const step = saturated_difference(time_ns, last.time_ns);
      strict_vec3d const jump = next.rate - last.rate;
      if (step <= 0 || step > longest_gap_ns || dot(jump, jump) > real64(jerk * jerk)) {
        count_ = 0;
      } else {
        next.R = nearest_rotation(last.R *
                                  rotation_exp(scaled(last.rate + next.rate, half_seconds(step))));
      }
    }
    ring_[index(count_++)] = next;
  }
  bool covers(std::int64_t from_ns, std::int64_t to_ns) const {
    return count_ > 1 && at(oldest()).time_ns <= from_ns && at(count_ - 1).time_ns >= to_ns;
  }
  bool reaches(std::int64_t time_ns) const {
    return count_ > 0 && at(count_ - 1).time_ns >= time_ns;
  }
  /// @param time_ns within what it covers
  strict_mat3d at_time(std::int64_t time_ns) const {
    std::size_t low = oldest(), high = count_ - 1;
    while (high - low > 1) {
      std::size_t const middle = low + (high - low) / 2;
      (at(middle).time_ns <= time_ns ? low : high) = middle;
    }
    entry const& a = at(low);
    entry const& b = at(high);
    real64 const into = seconds(time_ns - a.time_ns);
    real64 const share = into / seconds(b.time_ns - a.time_ns);
    strict_vec3d const mean = a.rate + scaled(b.rate - a.rate, real64(0.5) * share);
    return a.R * rotation_exp(scaled(mean, into));
  }

private:
  struct entry {
    std::int64_t time_ns;
    strict_mat3d R;
    strict_vec3d rate;
  };
  static real64 seconds(std::int64_t ns) { return real64(static_cast<double>(ns) * 1e-9); }
  static real64 half_seconds(std::int64_t ns) { return real64(static_cast<double>(ns) * 0.5e-9); }
  std::size_t index(std::size_t i) const { return i % ring_.size(); }
  entry const& at(std::size_t i) const { return ring_[index(i)]; }
  std::size_t oldest() const { return count_ > ring_.size() ? count_ - ring_.size() : 0; }

  std::vector<entry> ring_;
  std::size_t count_ = 0;  ///< since the last gap
};

/// The estimator of one camera. Allocates nothing after reserve().
class imu_clock {
public:
  static constexpr std::int64_t step_ns = 5'000'000;  ///< of the grid
  static constexpr int reach = 30;                    ///< steps of the grid on either side
  static constexpr std::int64_t reach_ns = step_ns * reach;

  /// @param rate_hz of the samples @param middle_ns of the grid
  void reserve(double rate_hz, std::int64_t middle_ns) {
    middle_ns_ = used_ns_ = middle_ns;
    turns_.reserve(static_cast<std::size_t>(min_of(max_of(1.5 * rate_hz, 256.0), 16384.0)));
  }
  void clear() {
    turns_.clear();
    forget();
  }
  /// A sample of the gyroscope, on its own clock.
  void add(std::int64_t time_ns, vec3<float> gyro) { turns_.add(time_ns, gyro); }
  /// The attitude of the IMU at an image, as the images tell it. A turn from an earlier one enters
  /// as soon as the samples reach beyond it.
  /// @param R body to world @param follows whether the world is that of the image before
  void add_attitude(std::int64_t time_ns, mat3<double> const& R, bool follows) {
    if (!follows) { seen_ = 0; }
    // The longest turn: its rate changes most, and its errors are no larger.
    attitude const now{time_ns, R.cast<real64>()};
    auto const age = [&](int i) {
      return saturated_difference(time_ns, attitudes_[static_cast<std::size_t>(i)].time_ns);
    };
    int drop = 0;
    while (drop < seen_ && (seen_ - drop == images || age(drop) > longest_turn_ns)) { ++drop; }
    seen_ -= drop;
    for (int i = 0; i < seen_; ++i) {
      attitudes_[static_cast<std::size_t>(i)] = attitudes_[static_cast<std::size_t>(i + drop)];
    }
    if (seen_ > 0) {
      if (waiting_ == pending) { take_front(false); }
      attitude const& first = attitudes_[0];
      pairs_[static_cast<std::size_t>(waiting_++)] = {first.time_ns, time_ns,
                                                      rotation_log(first.R.transposed() * now.R)};
    }
    attitudes_[static_cast<std::size_t>(seen_++)] = now;
    while (waiting_ > 0 && turns_.reaches(on_its_clock(pairs_[0].to_ns, reach_ns))) {
      take_front(true);
    }
  }
  imu_clock_offset estimate() const;
  imu_misalignment misalignment() const { return rotation_.estimate(); }
  /// What is in use from now on. The clock's estimate begins anew with another turn, that of the
  /// rotation with another offset.
  void use(std::int64_t offset_ns, mat3<double> const& by) {
    strict_mat3d const R = by.cast<real64>();
    bool same = true;
    for (int i = 0; i < 9; ++i) { same = same && R.m[i].value == turn_.m[i].value; }
    if (!same) { forget_turns(); }
    if (offset_ns != used_ns_) { rotation_.clear(); }
    turn_ = R;
    used_ns_ = offset_ns;
  }

private:
  static constexpr int pending = 64;
  static constexpr int points = 2 * reach + 1;
  static constexpr int images = 16;  ///< a turn spans fewer
  static constexpr std::int64_t longest_turn_ns = 260'000'000;
  /// Share of the weights of earlier turns that remains with a new one.
  static constexpr double memory = 0.995;
  /// Fewer turns tell nothing; nor do turns that differ by more than this, rad.
  static constexpr double fewest = 30, strange = 0.1;
  struct attitude {
    std::int64_t time_ns;
    strict_mat3d R;
  };
  struct turn {
    std::int64_t from_ns, to_ns;
    strict_vec3d seen;
  };
  struct sums {
    real64 squares = 0.0;                 ///< of differences
    strict_vec3d by_time{0.0, 0.0, 0.0};  ///< of differences times their duration
    /// Of products with the sum of the differences of earlier turns that overlap, and what a bias
    /// changes of it.
    real64 shared = 0.0;
    strict_vec3d shared_by_time{0.0, 0.0, 0.0};
  };
  using differences = std::array<strict_vec3d, points>;
  struct taken_turn {
    std::int64_t to_ns = 0;
    real64 duration = 0.0;
    differences off{};

    void add(taken_turn const& t) {
      duration = duration + t.duration;
      for (std::size_t j = 0; j < points; ++j) { off[j] = off[j] + t.off[j]; }
    }
  };

  std::int64_t on_its_clock(std::int64_t time_ns, std::int64_t later_ns) const {
    return saturated_difference(time_ns, -(middle_ns_ + later_ns));
  }
  void forget_turns() {
    sums_.fill({});
    weight_ = times_ = shared_times_ = 0.0;
    last_.clear();
  }
  void forget() {
    waiting_ = seen_ = 0;
    rotation_.clear();
    forget_turns();
  }
  strict_vec3d measured(std::int64_t from, std::int64_t to) const {
    return rotation_log(turns_.at_time(from).transposed() * turns_.at_time(to));
  }
  void take_front(bool use) {
    if (use) { take(pairs_[0]); }
    --waiting_;
    for (int i = 0; i < waiting_; ++i) {
      pairs_[static_cast<std::size_t>(i)] = pairs_[static_cast<std::size_t>(i) + 1];
    }
  }
  void take(turn const& t) {
    std::int64_t const from = on_its_clock(t.from_ns, 0), to = on_its_clock(t.to_ns, 0);
    if (!turns_.covers(from - reach_ns, to + reach_ns)) { return; }
    taken_turn now;
    now.to_ns = to;
    real64 const duration = now.duration = static_cast<double>(to - from) * 1e-9;
    real64 least = 1e30;
    for (int j = 0; j < points; ++j) {
      std::int64_t const d = (j - reach) * step_ns;
      strict_vec3d const r = t.seen - turn_ * measured(from + d, to + d);
      now.off[static_cast<std::size_t>(j)] = r;
      least = min_of(least, dot(r, r));
    }
    real64 const keep = memory;
    add_rotation(t, from, to, keep);
    if (!(least < real64(strange * strange))) { return; }
    weight_ = keep * weight_ + real64(1.0);
    times_ = keep * times_ + duration * duration;
    taken_turn const before = last_.sum_after(from);
    shared_times_ = keep * shared_times_ + duration * before.duration;
    for (std::size_t j = 0; j < points; ++j) {
      sums& s = sums_[j];
      strict_vec3d const &r = now.off[j], &r0 = before.off[j];
      s.squares = keep * s.squares + dot(r, r);
      s.by_time = scaled(s.by_time, keep) + scaled(r, duration);
      s.shared = keep * s.shared + dot(r, r0);
      s.shared_by_time =
          scaled(s.shared_by_time, keep) + (scaled(r0, duration) + scaled(r, before.duration));
    }
    last_.keep(now);
  }
  /// However the IMU is turned, both turn by one angle.
  void add_rotation(turn const& t, std::int64_t from, std::int64_t to, real64 keep) {
    std::int64_t const aside = saturated_difference(used_ns_, middle_ns_);
    if (aside < -reach_ns || aside > reach_ns) { return; }
    strict_vec3d const g = measured(from + aside, to + aside);
    if (!(scalar::abs(norm(t.seen) - norm(g)) < real64(strange))) { return; }
    rotation_.add({t.from_ns, t.to_ns, t.seen, g}, keep);
  }
  /// What remains of the squares with the bias that suits them best.
  real64 cost(int j) const {
    sums const& s = sums_[static_cast<std::size_t>(j)];
    return s.squares - dot(s.by_time, s.by_time) / times_;
  }
  /// What remains of the products with earlier turns.
  real64 shared(int j) const {
    sums const& s = sums_[static_cast<std::size_t>(j)];
    strict_vec3d const bias = scaled(s.by_time, real64(1.0) / times_);
    return s.shared - dot(bias, s.shared_by_time) + dot(bias, bias) * shared_times_;
  }

  turn_history turns_;
  std::int64_t middle_ns_ = 0;
  std::int64_t used_ns_ = 0;                      ///< offset in use
  strict_mat3d turn_ = strict_mat3d::identity();  ///< of samples, in use
  imu_rotation rotation_;
  std::array<attitude, images> attitudes_{};  ///< the last ones, oldest first
  int seen_ = 0;                              ///< of them
  std::array<turn, pending> pairs_{};
  int waiting_ = 0;
  std::array<sums, points> sums_{};
  real64 weight_ = 0.0, times_ = 0.0;  ///< turns; the sum of their squared durations
  real64 shared_times_ = 0.0;          ///< of their products with those of overlapping ones
  overlapping_turns<taken_turn, images> last_;
};

inline imu_clock_offset imu_clock::estimate() const {
  imu_clock_offset out;
  if (!(weight_ > real64(fewest))) { return out; }
  int best = 0;
  for (int j = 1; j < points; ++j) {
    if (cost(j) < cost(best)) { best = j; }
  }
  if (best == 0 || best == points - 1) { return out; }  // too far, or nothing is told
  real64 const before = cost(best - 1), at = cost(best), after = cost(best + 1);
  real64 const bend = before + after - (at + at);
  if (!(bend > real64(0.0))) { return out; }
  real64 const aside = real64(0.5) * (before - after) / bend;
  real64 const least = at - real64(0.25) * (before - after) * aside;
  real64 const step = static_cast<double>(step_ns) * 1e-9;
  // The sum grows by bend / 2 over a step: in units of a turn's variance, by one over a deviation.
  real64 const degrees = real64(3.0) * weight_ - real64(4.0);
  real64 const rest = max_of(least, real64(1e-12));
  // A parabola, as the sum of squares is.
  real64 const s0 = shared(best - 1), s1 = shared(best), s2 = shared(best + 1);
  real64 const common = s1 + real64(0.5) * aside * (s2 - s0 + aside * (s0 + s2 - (s1 + s1)));
  real64 const variance = max_of(rest + common + common, rest) / degrees;
  real64 const sigma = step * scalar::sqrt(real64(2.0) * variance / bend);
  out.offset_s = ((real64(static_cast<double>(best - reach)) + aside) * step).value +
                 static_cast<double>(middle_ns_) * 1e-9;
  out.sigma_s = sigma.value;
  // A motion that repeats itself has several minima.
  bool alone = true;
  for (int j = 1; j + 1 < points; ++j) {
    bool const minimum = cost(j) <= cost(j - 1) && cost(j) <= cost(j + 1);
    alone = alone && (!minimum || std::abs(j - best) <= 1 || cost(j) > real64(2.0) * least);
  }
  if (!alone) { return {}; }
  out.known = out.sigma_s < 1e-3;
  return out;
}

/// Standard deviation of the offset in use until there is an estimate, s: stamps of the begin or
/// the end of an exposure, or of the arrival of an image, are off by as much.
inline constexpr double unknown_clock_s = 0.01;

/// How well the offset in use is known, s. What an estimate says that it is off by counts wholly.
/// @param used_s the offset in use
inline double sigma_of_clock(imu_clock_offset const& found, double used_s) {
  if (!(found.sigma_s > 0)) { return unknown_clock_s; }
  return max_of(min_of(found.sigma_s, unknown_clock_s), std::abs(found.offset_s - used_s));
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
