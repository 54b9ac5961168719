// SPDX-License-Identifier: Apache-2.0
/// @file Times per stage, as the paper reports them: kernels, transfers, the host's wrapping,
/// total.
#pragma once

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <ostream>
#include <string>

#include "integration/orbslam3/device_tracker.hpp"
#include "integration/orbslam3/options.hpp"

namespace ft {
namespace orbslam3 {

/// Histogram of times with 16 classes for each power of two: percentiles to 3 %, without an
/// allocation.
class time_histogram {
public:
  void add(double microseconds) {
    ++counts_[static_cast<std::size_t>(class_of(microseconds))];
    ++all_;
    maximum_ = std::max(maximum_, microseconds);
  }
  /// Microseconds: the middle of the percentile's class. @param share 0.5 for the median
  double percentile(double share) const {
    auto const wanted = static_cast<long>(std::ceil(share * static_cast<double>(all_)));
    long below = 0;
    for (int c = 0; c < classes; ++c) {
      below += counts_[static_cast<std::size_t>(c)];
      if (below >= wanted && below > 0) { return std::min(middle(c), maximum_); }
    }
    return 0;
  }
  double maximum() const { return maximum_; }

private:
  static constexpr int steps = 16;            ///< classes per power of two
  static constexpr int classes = 24 * steps;  ///< 1 us to 16 s
  static int class_of(double t) {
    double const place = t > 1 ? std::log2(t) * steps : 0;
    return std::min(static_cast<int>(place), classes - 1);
  }
  static double middle(int c) { return std::exp2((c + 0.5) / steps); }

  std::array<int, classes> counts_{};
  long all_ = 0;
  double maximum_ = 0;
};

/// Of all calls of one stage, microseconds.
struct stage_statistics {
  long calls = 0;
  double kernel = 0;
  double transfer = 0;
  double wrap = 0;   ///< host time outside of the device's calls
  double total = 0;  ///< host time from call to return
  time_histogram totals;
};

using statistics = std::array<stage_statistics, stage_count>;

/// A line per stage that was called: percentiles and the maximum of the whole call, means of its
/// parts.
inline std::ostream& print(std::ostream& out, statistics const& all) {
  for (int i = 0; i < stage_count; ++i) {
    stage_statistics const& s = all[static_cast<std::size_t>(i)];
    if (s.calls == 0) { continue; }
    auto const n = static_cast<double>(s.calls);
    out << name_of(static_cast<stage>(i)) << ": " << s.calls << " calls, p50 "
        << s.totals.percentile(0.5) << " us, p99 " << s.totals.percentile(0.99) << ", maximum "
        << s.totals.maximum() << "; mean " << s.total / n << ": kernel " << s.kernel / n
        << ", transfer " << s.transfer / n << ", wrap " << s.wrap / n << "\n";
  }
  return out;
}

/// Times one call of a stage. Without statistics it reads no clock.
class stage_timer {
public:
  stage_timer(stage_statistics* sums, device_tracker& device) : sums_(sums), device_(&device) {
    if (sums_ != nullptr) { begin_ = clock::now(); }
  }
  stage_timer(stage_timer const&) = delete;
  stage_timer& operator=(stage_timer const&) = delete;
  ~stage_timer() {
    if (sums_ == nullptr) { return; }
    double const total = microseconds(begin_, clock::now());
    ++sums_->calls;
    sums_->total += total;
    sums_->totals.add(total);
    sums_->wrap += total - on_device_;
  }

  /// Runs a device call that waits.
  template <typename Call>
  auto on_device(Call const& call) {
    struct span {
      stage_timer* timer;
      clock::time_point begin;
      ~span() {
        if (timer->sums_ != nullptr) { timer->add(begin, timer->device_->times()); }
      }
    };
    span const around{this, sums_ != nullptr ? clock::now() : clock::time_point{}};
    return call();
  }
  /// Runs a device call whose result has its times.
  template <typename Call>
  auto on_device_timed(Call const& call) {
    auto const begin = sums_ != nullptr ? clock::now() : clock::time_point{};
    auto const result = call();
    if (sums_ != nullptr) { add(begin, result.times); }
    return result;
  }

private:
  using clock = std::chrono::steady_clock;
  static double microseconds(clock::time_point a, clock::time_point b) {
    return std::chrono::duration<double, std::micro>(b - a).count();
  }
  void add(clock::time_point begin, device_times const& times) {
    on_device_ += microseconds(begin, clock::now());
    sums_->kernel += times.kernel;
    sums_->transfer += times.transfer;
  }
  stage_statistics* sums_;
  device_tracker* device_;
  clock::time_point begin_;
  double on_device_ = 0;
};

}  // namespace orbslam3
}  // namespace ft
