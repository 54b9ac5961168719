// SPDX-License-Identifier: Apache-2.0
/// @file Samples of an IMU that wait for their frame.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <mutex>
#include <vector>

#include "ft/containers/inertial.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/pipelines/detail/imu_clock.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// How often the samples of an IMU come: the median of the last times between two of them.
class measured_rate {
public:
  void add(std::int64_t interval_ns) {
    last_[static_cast<std::size_t>(count_++ % size)] = interval_ns;
  }
  /// Hz; 0 = too few
  double hz() const {
    if (count_ < fewest) { return 0; }
    std::array<std::int64_t, size> sorted = last_;
    auto const n = static_cast<std::ptrdiff_t>(std::min(count_, size));
    std::nth_element(sorted.begin(), sorted.begin() + n / 2, sorted.begin() + n);
    return 1e9 / static_cast<double>(sorted[static_cast<std::size_t>(n / 2)]);
  }

private:
  static constexpr long long size = 64;
  static constexpr long long fewest = 8;
  std::array<std::int64_t, size> last_{};
  long long count_ = 0;
};

/// Tells when a sensor has stopped to measure. Noise makes each sample another one; the same one
/// again, bit by bit, `fewest` times and more, is a sensor that is stuck, or a driver that repeats
/// what it has. One that repeated itself before, as a simulator without noise does, or a driver
/// with a higher rate than its sensor's, tells nothing by it.
class stuck_sensor {
public:
  static constexpr int fewest = 3;  ///< repetitions, of which chance makes fewer
  static constexpr int noisy = 64;  ///< samples without a repetition show that there is noise

  /// @return repetitions so far, where the sample is one of a sensor that is stuck; else 0
  int add(imu_measurement const& m) {
    if (any_ && same(m, last_)) {
      ++repeated_;
      return changed_ >= noisy && repeated_ >= fewest ? repeated_ : 0;
    }
    bool const was_stuck = changed_ >= noisy && repeated_ >= fewest;
    if (repeated_ > 0 && !was_stuck) { changed_ = 0; }
    changed_ = std::min(changed_ + 1, noisy);
    repeated_ = 0;
    last_ = m;
    any_ = true;
    return 0;
  }
  static bool same(imu_measurement const& a, imu_measurement const& b) {
    return same(a.accel, b.accel) && same(a.gyro, b.gyro);
  }

private:
  static bool same(vec3<float> a, vec3<float> b) { return a.x == b.x && a.y == b.y && a.z == b.z; }

  imu_measurement last_{};
  bool any_ = false;
  int changed_ = 0;   ///< samples in a row that were other ones, before the repetitions
  int repeated_ = 0;  ///< the last sample
};

/// Finds single rates of turning that no body has between those of the samples before and after: a
/// bit error, or another device's interference.
class turn_spikes {
public:
  /// Nearer than so many samples, several are a vibration.
  static constexpr int apart = 16;

  /// @return whether the sample before was a spike: its neighbours agree, and are near in time
  bool add(std::int64_t time_ns, vec3<float> gyro) {
    std::int64_t const step = saturated_difference(time_ns, newest_ns_);
    bool const near = any_ && step > 0 && step <= turn_history::longest_gap_ns;
    bool const spike = near && suspect_ && is_jump(newest_, gyro) && !is_jump(before_, gyro);
    if (spike) {
      since_ = 0;
    } else {
      before_ = newest_;
      since_ = std::min(since_ + 1, apart);
    }
    suspect_ = near && since_ == apart && is_jump(before_, gyro);
    newest_ = gyro;
    newest_ns_ = time_ns;
    any_ = true;
    return spike;
  }
  /// Whether the newest sample may be one: the next will tell.
  bool suspects() const { return suspect_; }

private:
  static bool is_jump(vec3<float> from, vec3<float> to) {
    vec3<double> const d = to.cast<double>() - from.cast<double>();
    return dot(d, d) > turn_history::jerk * turn_history::jerk;
  }

  vec3<float> before_{}, newest_{};  ///< rad/s
  std::int64_t newest_ns_ = 0;
  int since_ = apart - 1;  ///< samples since the last spike, at most `apart`
  bool any_ = false;
  bool suspect_ = false;
};

/// Samples of one IMU that wait for their frame. Any thread may add; one takes.
class sample_queue {
public:
  /// So many samples in a row whose times ascend, all before that of a sample that came earlier,
  /// show that this one's time was wrong, or that the clock was set back.
  static constexpr int enough_behind = 16;

  /// Before the first sample.
  void set_limits(imu_params const& p) {
    capacity_ = static_cast<std::size_t>(p.waiting);
    max_accel_ = p.max_accel;
    max_gyro_ = p.max_gyro;
    finds_offset_ = p.estimate_time_offset;
    if (p.estimate_time_offset || p.estimate_rotation) {
      clock_.reserve(static_cast<double>(p.noise.rate_hz), std::llround(p.time_offset_s * 1e9));
    }
  }
  /// Takes a sample, or leaves it out and counts it. @throws std::bad_alloc
  void add(imu_measurement const& m) {
    std::lock_guard<std::mutex> const lock(mutex_);
    if (!within(m.accel, max_accel_) || !within(m.gyro, max_gyro_)) {
      ++left_out_.out_of_range;
      return;
    }
    if (any_ && m.time_ns <= last_ns_ && !shows_wrong_clock(m.time_ns)) {
      ++left_out_.disordered;
      return;
    }
    if (int const repeated = stuck_.add(m); repeated > 0) {
      leave_out_repetitions(m, repeated);
      return;
    }
    if (spikes_.add(m.time_ns, m.gyro)) {
      ++left_out_.spikes;
      if (waiting_.size() > first_ && waiting_.back().time_ns == last_ns_) { waiting_.pop_back(); }
    }
    if (any_ && m.time_ns > last_ns_) { rate_.add(saturated_difference(m.time_ns, last_ns_)); }
    any_ = true;
    behind_ = 0;
    last_ns_ = m.time_ns;
    clock_.add(m.time_ns, m.gyro);
    waiting_.push_back(m);
    if (waiting_.size() - first_ <= capacity_) { return; }
    ++left_out_.crowded_out;
    if (++first_ >= capacity_) { drop_until(waiting_.begin() + at(first_)); }
  }
  /// Copies the samples up to the first one at `to_ns` or later, and drops those before it. A
  /// newest one that may be a spike waits.
  /// @param base_ns time 0 of the copies, as to_ns on the IMU's clock @param turn of the copies, or
  /// null @return their number; above `capacity`, no more are copied
  int take(std::int64_t base_ns, std::int64_t to_ns, mat3<float> const* turn, int capacity,
           imu_sample* to) {
    std::lock_guard<std::mutex> const lock(mutex_);
    auto const late = std::find_if(waiting_.begin() + at(first_), waiting_.end(),
                                   [&](imu_measurement const& m) { return m.time_ns >= to_ns; });
    auto end = late == waiting_.end() ? late : late + 1;
    bool const newest = end == waiting_.end() && waiting_.size() > first_;
    if (newest && spikes_.suspects() && waiting_.back().time_ns == last_ns_) { --end; }
    int n = 0;
    for (auto m = waiting_.begin() + at(first_); m != end; ++m, ++n) {
      if (n < capacity) {
        to[n] = {static_cast<double>(saturated_difference(m->time_ns, base_ns)) * 1e-9, m->accel,
                 m->gyro};
        if (turn != nullptr) {
          to[n].accel = *turn * m->accel;
          to[n].gyro = *turn * m->gyro;
        }
      }
    }
    drop_until(std::min(late, end));
    return n;
  }
  /// See imu_clock.
  void add_attitude(std::int64_t time_ns, mat3<double> const& R, bool follows) {
    std::lock_guard<std::mutex> const lock(mutex_);
    clock_.add_attitude(time_ns, R, follows);
  }
  imu_clock_offset clock() {
    std::lock_guard<std::mutex> const lock(mutex_);
    return finds_offset_ ? clock_.estimate() : imu_clock_offset{};
  }
  imu_misalignment misalignment() {
    std::lock_guard<std::mutex> const lock(mutex_);
    return clock_.misalignment();
  }
  /// See imu_clock.
  void use(std::int64_t offset_ns, mat3<double> const& turn) {
    std::lock_guard<std::mutex> const lock(mutex_);
    clock_.use(offset_ns, turn);
  }
  /// What is told of the samples. @param time_ns of the frame, on the IMU's clock
  void describe(std::int64_t time_ns, imu_tracking& out) {
    std::lock_guard<std::mutex> const lock(mutex_);
    if (finds_offset_) { out.clock = clock_.estimate(); }
    out.left_out = left_out_;
    out.rate_hz = rate_.hz();
    out.newest_s = any_ ? static_cast<double>(saturated_difference(last_ns_, time_ns)) * 1e-9 : 0.0;
  }
  void clear() {
    std::lock_guard<std::mutex> const lock(mutex_);
    waiting_.clear();
    first_ = 0;
    any_ = false;
    behind_ = 0;
    rate_ = {};
    stuck_ = {};
    spikes_ = {};
    left_out_ = {};
    clock_.clear();
  }
  std::size_t size() {
    std::lock_guard<std::mutex> const lock(mutex_);
    return waiting_.size() - first_;
  }

private:
  static std::ptrdiff_t at(std::size_t i) { return static_cast<std::ptrdiff_t>(i); }
  /// Written so that a NaN is not.
  static bool within(vec3<float> v, float limit) {
    return std::abs(v.x) < limit && std::abs(v.y) < limit && std::abs(v.z) < limit;
  }
  /// @param time_ns not after that of the last sample @return whether the samples go on from here
  bool shows_wrong_clock(std::int64_t time_ns) {
    behind_ = behind_ > 0 && time_ns > behind_ns_ ? behind_ + 1 : 1;
    behind_ns_ = time_ns;
    if (behind_ < enough_behind) { return false; }
    while (waiting_.size() > first_ && waiting_.back().time_ns >= time_ns) { waiting_.pop_back(); }
    return true;
  }
  /// @param repeated how often the sample was there before: those of them that wait leave, too
  void leave_out_repetitions(imu_measurement const& m, int repeated) {
    ++left_out_.frozen;
    for (int i = 1; repeated == stuck_sensor::fewest && i < repeated; ++i) {
      if (waiting_.size() <= first_ || !stuck_sensor::same(waiting_.back(), m)) { return; }
      waiting_.pop_back();
      ++left_out_.frozen;
    }
  }
  void drop_until(std::vector<imu_measurement>::iterator end) {
    waiting_.erase(waiting_.begin(), end);
    first_ = 0;
  }

  std::mutex mutex_;
  std::vector<imu_measurement> waiting_;  ///< from `first_` on, oldest first
  std::size_t first_ = 0;
  std::size_t capacity_ = 1;
  float max_accel_ = 0, max_gyro_ = 0;
  std::int64_t last_ns_ = 0;    ///< of the newest sample
  std::int64_t behind_ns_ = 0;  ///< of the last one that was left out for its time
  int behind_ = 0;              ///< such ones in a row whose times ascend
  bool any_ = false;
  measured_rate rate_;
  stuck_sensor stuck_;
  turn_spikes spikes_;
  imu_left_out left_out_;
  imu_clock clock_;
  bool finds_offset_ = false;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
