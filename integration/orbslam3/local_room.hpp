// SPDX-License-Identifier: Apache-2.0
/// @file Allocates memory for growing local maps in a thread, concurrently with tracking.
#pragma once

#include <atomic>
#include <exception>
#include <thread>

#include "integration/orbslam3/device_tracker.hpp"

namespace ft {
namespace orbslam3 {

/// Used by the tracking thread.
class local_room {
public:
  explicit local_room(device_tracker& device) : device_(&device) {}
  local_room(local_room const&) = delete;
  local_room& operator=(local_room const&) = delete;
  ~local_room() {
    if (thread_.joinable()) { thread_.join(); }
  }

  /// Call before the search of a local map. If it needs more than half of the memory, a thread
  /// starts to allocate memory for twice as many points.
  /// @return whether there was memory for `points` before that
  bool follow(int points) {
    int const room = device_->local_room();
    int const wanted = 2 * points;
    if (wanted > room && wanted > attempted_ && !busy_) {
      if (thread_.joinable()) { thread_.join(); }
      attempted_ = wanted;
      busy_ = true;
      thread_ = std::thread([this, wanted] {
        try {
          device_->prepare_local(wanted);
        } catch (std::exception const&) {  // a larger local map tries again
        }
        busy_ = false;
      });
    }
    return points <= room;
  }

private:
  device_tracker* device_;
  int attempted_ = 0;  ///< points
  std::atomic<bool> busy_{false};
  std::thread thread_;
};

}  // namespace orbslam3
}  // namespace ft
