// SPDX-License-Identifier: Apache-2.0
/// @file Loads frames on other threads ahead of the one that uses them.
#pragma once

#include <condition_variable>
#include <cstddef>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

#include "examples/sequence/types.hpp"

namespace seq {

/// Hands out frames in order while threads load those that follow. What a frame's loading throws is
/// rethrown where that frame is taken.
///
/// At most `ahead` frames beyond the one that is taken are loaded or being loaded. take() is called
/// by one thread at a time.
class read_ahead {
public:
  using loader = std::function<stereo_frame(int)>;

  /// @param load called from several threads at once, for each frame at most once
  /// @param frames how many there are; frame numbers are 0 to frames - 1
  /// @param ahead frames in the queue; 0 = none, take() loads
  /// @param threads 0 = as default_threads() says, at most `ahead`; fewer if the system refuses
  /// more
  /// @throws seq::error if a number is below 0
  read_ahead(loader load, int frames, int ahead, int threads = 0);
  /// Begins no further frame; waits for those that are being loaded.
  ~read_ahead();
  read_ahead(read_ahead const&) = delete;
  read_ahead& operator=(read_ahead const&) = delete;

  /// Waits for frame i. Frames before it that were not taken are left out, with their errors.
  /// @param i above that of the last call
  /// @throws seq::error if i is not; what load(i) throws
  stereo_frame take(int i);

  /// One less than the machine has, at least 1, at most 32.
  static int default_threads();

private:
  struct slot {
    int index = -1;  ///< of the frame that it holds
    stereo_frame frame;
    std::exception_ptr failure;
  };
  void work();
  slot& slot_of(int i) { return slots_[static_cast<std::size_t>(i) % slots_.size()]; }

  loader load_;
  int frames_;
  int ahead_;
  int first_ = 0;  ///< lowest frame that can still be taken
  int next_ = 0;   ///< first frame that no thread has begun
  bool stop_ = false;
  std::vector<slot> slots_;  ///< frame i is in slot i modulo their number
  std::mutex guard_;         ///< of the four above
  std::condition_variable room_;
  std::condition_variable loaded_;
  std::vector<std::thread> threads_;
};

}  // namespace seq
