// SPDX-License-Identifier: Apache-2.0
/// @file Frame::mmProjectPoints: the positions of map points in an image, which the viewer draws.
#pragma once

#include <algorithm>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <mutex>
#include <new>
#include <thread>
#include <vector>

namespace ft {
namespace orbslam3 {

/// Making the nodes of a map takes longer than the search of a local map. Most points are in view
/// in the next frame again, so a thread makes the nodes for that between two frames; they then get
/// their positions, and the frame gets the whole map. begin(), put() for each point, move_to(): one
/// thread at a time.
/// @tparam Map std::map from a map point's mnId to a place
template <typename Map>
class drawn_points {
public:
  using key = typename Map::key_type;
  using place = typename Map::mapped_type;

  /// @param slots of the mirror; more are possible
  explicit drawn_points(int slots = 0) : nodes_(static_cast<std::size_t>(slots)) {}
  drawn_points(drawn_points const&) = delete;
  drawn_points& operator=(drawn_points const&) = delete;
  ~drawn_points() {
    {
      std::lock_guard<std::mutex> const lock(mutex_);
      ended_ = true;
    }
    changed_.notify_all();
    if (maker_.joinable()) { maker_.join(); }
  }

  /// Waits for the nodes of this frame. Before the first put().
  void begin() {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [this] { return !making_; });
  }

  /// Adds a point; of equal ids the last one counts. @param slot of the point in the mirror
  void put(int slot, key id, place const& at) {
    auto const s = static_cast<std::size_t>(slot);
    if (s >= nodes_.size()) { nodes_.resize(std::max(s + 1, 2 * nodes_.size())); }
    node& n = nodes_[s];
    if (n.round != round_ || n.at->first != id) {
      missing_.push_back({id, missing_.size(), slot, at});
      return;
    }
    n.at->second = at;
    used_ += static_cast<std::size_t>(!n.used);
    n.used = true;
  }

  /// Moves the points since begin() into a map, and has the nodes for the next frame made.
  void move_to(Map& to) {
    if (used_ < shown_.size() || !missing_.empty()) { follow(); }
    if (to.empty()) {
      to.swap(next_);
    } else {
      for (auto const& [id, at] : next_) { to.insert_or_assign(id, at); }
      next_.clear();
    }
    ++round_;
    used_ = 0;
    {
      std::lock_guard<std::mutex> const lock(mutex_);
      making_ = !shown_.empty();
    }
    if (!maker_.joinable()) {
      maker_ = std::thread([this] { make(); });
    }
    changed_.notify_all();
  }

private:
  struct node {
    typename Map::iterator at{};
    std::uint32_t round = 0;  ///< valid in this one
    bool used = false;
  };
  struct shown {
    key id;
    int slot;
  };
  struct added {
    key id;
    std::size_t order;
    int slot;
    place at;
  };

  /// The thread: makes a node for each point of the last frame.
  void make() {
    std::unique_lock<std::mutex> lock(mutex_);
    for (;;) {
      changed_.wait(lock, [this] { return making_ || ended_; });
      if (ended_) { return; }
      lock.unlock();
      try {
        make_nodes();
      } catch (std::bad_alloc const&) {  // put() makes them
        next_.clear();
        shown_.clear();
        ++round_;
      }
      lock.lock();
      making_ = false;
      changed_.notify_all();
    }
  }

  void make_nodes() {
    for (shown const& s : shown_) {
      auto const at = next_.emplace_hint(next_.end(), s.id, place());
      nodes_[static_cast<std::size_t>(s.slot)] = {at, round_, false};
    }
  }

  /// Removes the nodes that were not used, and makes those that are missing.
  void follow() {
    other_.clear();
    for (shown const& s : shown_) {
      node const& n = nodes_[static_cast<std::size_t>(s.slot)];
      if (n.used && n.at->first == s.id) {
        other_.push_back(s);
      } else {
        next_.erase(s.id);
      }
    }
    std::sort(missing_.begin(), missing_.end(), [](added const& a, added const& b) {
      return a.id != b.id ? a.id < b.id : a.order < b.order;
    });
    auto const kept = static_cast<std::ptrdiff_t>(other_.size());
    auto hint = missing_.empty() ? next_.end() : next_.lower_bound(missing_.front().id);
    for (added const& m : missing_) {
      hint = std::next(next_.insert_or_assign(hint, m.id, m.at));
      other_.push_back({m.id, m.slot});
    }
    auto const earlier = [](shown const& a, shown const& b) { return a.id < b.id; };
    std::inplace_merge(other_.begin(), other_.begin() + kept, other_.end(), earlier);
    auto const same = [](shown const& a, shown const& b) { return a.id == b.id; };
    other_.erase(std::unique(other_.begin(), other_.end(), same), other_.end());
    shown_.swap(other_);
    missing_.clear();
  }

  Map next_;
  std::uint32_t round_ = 1;
  std::size_t used_ = 0;      ///< nodes of this frame
  std::vector<shown> shown_;  ///< by the last frame, by id
  std::vector<shown> other_;
  std::vector<node> nodes_;  ///< by slot
  std::vector<added> missing_;

  std::mutex mutex_;  ///< of the three below; all else belongs to the thread while making_
  std::condition_variable changed_;
  bool making_ = false;
  bool ended_ = false;
  std::thread maker_;
};

}  // namespace orbslam3
}  // namespace ft
