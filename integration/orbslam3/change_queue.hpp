// SPDX-License-Identifier: Apache-2.0
/// @file Map points that other threads have changed, for the tracking thread to look at.
#pragma once

#include <cstddef>
#include <mutex>
#include <utility>
#include <vector>

namespace ft {
namespace orbslam3 {

/// push() from any thread, also under the locks of a map point: it takes one more, and calls
/// nothing. take() from the tracking thread. Map points are not looked at here.
template <typename MapPoint>
class change_queue {
public:
  /// `point` has changed, and its lock shows the new values to whoever takes it after.
  void push(MapPoint* point) {
    std::lock_guard<std::mutex> const lock(mutex_);
    if (!closed_) { changed_.push_back(point); }
  }
  /// All that were pushed since the last call, in order, repeated ones too.
  void take(std::vector<MapPoint*>& into) {
    into.clear();
    std::lock_guard<std::mutex> const lock(mutex_);
    std::swap(changed_, into);
  }
  /// From now on nothing is kept: for a tracker that takes no more.
  void close() {
    std::lock_guard<std::mutex> const lock(mutex_);
    closed_ = true;
    changed_ = {};
  }
  /// Points that wait to be taken.
  std::size_t size() {
    std::lock_guard<std::mutex> const lock(mutex_);
    return changed_.size();
  }

private:
  std::mutex mutex_;
  std::vector<MapPoint*> changed_;
  bool closed_ = false;
};

}  // namespace orbslam3
}  // namespace ft
