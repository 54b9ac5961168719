// SPDX-License-Identifier: Apache-2.0
/// @file Time per stage: wall clock where stages are synchronous, events on the stream where they
/// are not.
#pragma once

#include <chrono>
#include <cstddef>
#include <map>
#include <string>
#include <vector>

#include "ft/core/execution.hpp"

namespace app {

/// Sums of milliseconds by stage, for one frame at a time.
class stage_sums {
public:
  explicit stage_sums(std::vector<std::string> const& names)
      : names_(names), ms_(names.size(), 0.0) {
    for (std::size_t i = 0; i < names.size(); ++i) { index_[names[i]] = i; }
  }
  void reset() { ms_.assign(ms_.size(), 0.0); }
  void add(std::string const& stage, double ms) { ms_[index_.at(stage)] += ms; }
  std::vector<double> const& ms() const { return ms_; }
  std::vector<std::string> const& names() const { return names_; }

private:
  std::vector<std::string> names_;
  std::map<std::string, std::size_t> index_;
  std::vector<double> ms_;
};

inline double now_ms() {
  return std::chrono::duration<double, std::milli>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

template <typename Exec>
class stage_timer;

template <>
class stage_timer<ft::host_exec> {
public:
  explicit stage_timer(ft::host_exec const&) {}
  void start() { last_ = now_ms(); }
  void mark(char const* stage, stage_sums& sums) {
    double const now = now_ms();
    sums.add(stage, now - last_);
    last_ = now;
  }
  void collect(stage_sums&) {}

private:
  double last_ = 0;
};

#if defined(__CUDACC__)
template <>
class stage_timer<ft::cuda_exec> {
public:
  explicit stage_timer(ft::cuda_exec const& exec) : stream_(exec.stream) {
    for (auto& e : events_) { ft::throw_on_error(cudaEventCreate(&e), "cudaEventCreate"); }
  }
  stage_timer(stage_timer const&) = delete;
  stage_timer& operator=(stage_timer const&) = delete;
  ~stage_timer() {
    for (auto& e : events_) { static_cast<void>(cudaEventDestroy(e)); }
  }
  void start() {
    used_ = 0;
    record();
  }
  void mark(char const* stage, stage_sums&) {
    if (used_ < most) {
      names_[used_ - 1] = stage;
      record();
    }
  }
  /// After the stream is done.
  void collect(stage_sums& sums) {
    for (int i = 0; i + 1 < used_; ++i) {
      float ms = 0;
      ft::throw_on_error(cudaEventElapsedTime(&ms, events_[i], events_[i + 1]),
                         "cudaEventElapsedTime");
      sums.add(names_[i], static_cast<double>(ms));
    }
    used_ = 0;
  }

private:
  static constexpr int most = 32;
  void record() {
    ft::throw_on_error(cudaEventRecord(events_[used_++], stream_), "cudaEventRecord");
  }
  cudaStream_t stream_;
  cudaEvent_t events_[most];
  char const* names_[most] = {};
  int used_ = 0;
};
#endif

}  // namespace app
