// SPDX-License-Identifier: Apache-2.0
/// @file Map points that other threads have changed.
#pragma once

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

namespace ft::orbslam3 {

/// push() may be called from any thread, also under the locks of a map point: it takes one more
/// lock and calls nothing else. Map points are not dereferenced here.
template <typename MapPoint>
class change_queue {
public:
  /// `point` has changed. Threads that lock it after this call see the new values.
  void push(MapPoint* point) {
    std::lock_guard<std::mutex> const lock(mutex_);
    if (closed_) { return; }
    changed_.push_back(point);
    if (awaited_) {
      awaited_ = false;
      pushed_.notify_one();
    }
  }
  /// Takes the first `most` points that were pushed and not yet taken, in order, repeated ones
  /// included.
  void take(std::vector<MapPoint*>& into, std::size_t most) {
    into.clear();
    std::lock_guard<std::mutex> const lock(mutex_);
    std::size_t const n = std::min(most, changed_.size() - first_);
    auto const from = changed_.begin() + static_cast<std::ptrdiff_t>(first_);
    into.assign(from, from + static_cast<std::ptrdiff_t>(n));
    first_ += n;
    if (first_ < changed_.size()) { return; }
    changed_.clear();
    first_ = 0;
  }
  /// Removes `point`, which is about to be deleted.
  void forget(MapPoint const* point) {
    std::lock_guard<std::mutex> const lock(mutex_);
    auto const from = changed_.begin() + static_cast<std::ptrdiff_t>(first_);
    changed_.erase(std::remove(from, changed_.end(), point), changed_.end());
  }
  /// Blocks until the queue has a point. Returns false after stop().
  bool await() {
    std::unique_lock<std::mutex> lock(mutex_);
    while (first_ == changed_.size() && !stopped_) {
      awaited_ = true;
      pushed_.wait(lock);
    }
    return !stopped_;
  }
  void stop() {
    std::lock_guard<std::mutex> const lock(mutex_);
    stopped_ = true;
    pushed_.notify_all();
  }
  /// Ignores all later pushes: for a tracker that takes no more points, or is gone.
  void close() {
    std::lock_guard<std::mutex> const lock(mutex_);
    closed_ = true;
    changed_ = {};
    first_ = 0;
  }
  /// Number of points not yet taken.
  std::size_t size() {
    std::lock_guard<std::mutex> const lock(mutex_);
    return changed_.size() - first_;
  }

private:
  std::mutex mutex_;
  std::condition_variable pushed_;
  std::vector<MapPoint*> changed_;
  std::size_t first_ = 0;  ///< not taken yet
  bool awaited_ = false;
  bool stopped_ = false;
  bool closed_ = false;
};

/// A member of ORB_SLAM3::Map: where changes of its points go. Each system has maps of its own, so
/// two systems in one process do not meet. The queues live as long as the map: of a tracker that is
/// gone a closed one stays. From any thread.
template <typename MapPoint>
class map_changes {
public:
  /// `point` has changed, see change_queue::push(). Nothing happens where no tracker listens.
  void push(MapPoint* point) {
    if (change_queue<MapPoint>* const to = to_.load(std::memory_order_acquire)) { to->push(point); }
  }
  /// From now on changes go to `queue`, and no longer to an earlier one.
  void send_to(std::shared_ptr<change_queue<MapPoint>> queue) {
    std::lock_guard<std::mutex> const lock(mutex_);
    if (queue.get() == to_.load(std::memory_order_relaxed)) { return; }
    to_.store(queue.get(), std::memory_order_release);
    kept_.push_back(std::move(queue));  // a push may be in an earlier one
  }

private:
  std::atomic<change_queue<MapPoint>*> to_{nullptr};
  std::mutex mutex_;
  std::vector<std::shared_ptr<change_queue<MapPoint>>> kept_;
};

}  // namespace ft::orbslam3
