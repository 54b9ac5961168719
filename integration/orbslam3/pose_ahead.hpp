// SPDX-License-Identifier: Apache-2.0
/// @file Decides when a pose optimisation is started before it is asked for.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "integration/orbslam3/plain_types.hpp"

namespace ft {
namespace orbslam3 {

/// Tracking optimises the pose after a search: from the pose that was searched from, with the
/// matches that were found. Optimisation can therefore start behind the search, while the host
/// still works on the matches. Its result counts if the call that comes is the expected one and
/// nothing that it read has changed; otherwise it is dropped. After a kind of search whose
/// optimisation did not come, the next ones are not started until it comes again.
class pose_ahead {
public:
  enum class after { last_frame, local_map };

  /// A search begins, and with it another expectation.
  /// @return whether optimisation is to be started behind it
  bool expect(after search, int buffer, pose const& T_cw) {
    search_ = search;
    buffer_ = buffer;
    T_cw_ = T_cw;
    expected_ = true;
    started_ = comes_after(search);
    return started_;
  }
  /// The buffer of an optimisation that was started, -1 = none.
  int started() const { return expected_ && started_ ? buffer_ : -1; }

  /// An optimisation is asked for. @return whether it is the one that was started
  bool take(int buffer, pose const& T_cw) {
    if (!expected_ || buffer != buffer_ || std::memcmp(&T_cw, &T_cw_, sizeof T_cw) != 0) {
      return false;
    }
    comes_after(search_) = true;
    expected_ = false;
    return started_;
  }
  /// Data of a buffer have changed.
  void changed(int buffer) { expected_ = expected_ && buffer != buffer_; }
  /// What the optimisation reads has changed.
  void forget() { expected_ = false; }
  /// Tracking goes on without it.
  void give_up() {
    if (started() >= 0) { comes_after(search_) = false; }
    expected_ = false;
  }

  /// Whether a change moves a point that is held. @param words as of device_tracker::change_map()
  bool moves_held(map_change const& change, std::uint32_t const* words, int const* holder,
                  int numbers) {
    if (change.count[map_change::position] == 0) { return false; }
    mark(holder, numbers, 1);
    bool moved = false;
    for (int i = 0; i < change.count[map_change::position] && !moved; ++i) {
      std::uint32_t const slot = words[i * map_change::words_of(map_change::position)];
      moved = slot < held_.size() && held_[slot] != 0;
    }
    mark(holder, numbers, 0);
    return moved;
  }

private:
  bool& comes_after(after search) { return comes_[static_cast<int>(search)]; }
  void mark(int const* holder, int numbers, unsigned char value) {
    for (int i = 0; i < numbers; ++i) {
      if (holder[i] < 0) { continue; }
      auto const slot = static_cast<std::size_t>(holder[i]);
      if (slot >= held_.size()) { held_.resize(2 * slot + 1); }
      held_[slot] = value;
    }
  }

  bool comes_[2] = {true, true};
  after search_ = after::last_frame;
  int buffer_ = 0;
  pose T_cw_ = pose::identity();
  bool expected_ = false;
  bool started_ = false;
  std::vector<unsigned char> held_;  ///< by slot; all 0 between calls
};

}  // namespace orbslam3
}  // namespace ft
