// SPDX-License-Identifier: Apache-2.0
/// @file How calls of a tracker on an executor begin, wait and are counted.
#pragma once

#include <cstddef>
#include <utility>

#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "integration/orbslam3/call_clock.hpp"
#include "integration/orbslam3/device_tracker.hpp"
#include "integration/orbslam3/stream_mark.hpp"
#include "integration/orbslam3/word_mover.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

/// Base of a tracker on an executor.
template <typename Exec>
class executor_calls : public device_tracker {
public:
  explicit executor_calls(Exec exec) : exec_(std::move(exec)) {}

  void settle() override {
    if (in_flight_) { wait(); }
  }
  traffic bytes() const override { return bytes_; }
  void reset_bytes() override { bytes_ = {}; }
  device_times times() const override { return times_; }

protected:
  /// Marks the start of a call, before its first launch.
  void start() {
    settle();
    if (!started_) { clock_.mark(exec_, 0); }
    started_ = true;
  }
  /// Uploads the collected data. @param staged bytes that the call's own first launch transfers
  void begin(std::size_t staged = 0) {
    start();
    bool const collected = up_.flush(exec_) > 0;
    if (collected || staged > 0) { ++bytes_.uploads; }
    bytes_.frame += up_.take_bytes() + staged;
    if (staged == 0) { clock_.mark(exec_, 1); }
  }
  void count_download(std::size_t bytes) {
    ++bytes_.downloads;
    bytes_.results += bytes;
  }
  /// @param bytes that are being downloaded
  void finish(std::size_t bytes) {
    count_download(bytes);
    clock_.mark(exec_, 3);
    wait();
    times_ = clock_.read();
  }
  void wait() {
    exec_.wait();
    change_queued_ = false;
    started_ = false;
    in_flight_ = false;
  }

  Exec exec_;
  word_mover<Exec> up_;
  call_clock<Exec> clock_;
  traffic bytes_;
  device_times times_;
  bool in_flight_ = false;  ///< the last call left work that it did not wait for
  bool change_queued_ = false;
  bool started_ = false;
};

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
