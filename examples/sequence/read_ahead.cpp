// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/read_ahead.hpp"

#include <algorithm>
#include <string>
#include <system_error>
#include <utility>

namespace seq {

int read_ahead::default_threads() {
  return std::clamp(static_cast<int>(std::thread::hardware_concurrency()) - 1, 1, 32);
}

read_ahead::read_ahead(loader load, int frames, int ahead, int threads)
    : load_(std::move(load)), frames_(frames), ahead_(ahead) {
  for (auto const& [name, value] :
       {std::pair("frames", frames), {"ahead", ahead}, {"threads", threads}}) {
    if (value < 0) {
      throw error(std::string("read_ahead: ") + name + " = " + std::to_string(value) +
                  ": must be at least 0");
    }
  }
  ahead_ = std::min(ahead, frames);
  slots_.resize(static_cast<std::size_t>(ahead_));
  int const wanted = std::min(threads > 0 ? threads : default_threads(), ahead_);
  try {
    for (int i = 0; i < wanted; ++i) {
      threads_.emplace_back([this] { work(); });
    }
  } catch (std::system_error const&) {  // fewer threads; without any take() loads
    if (threads_.empty()) { ahead_ = 0; }
  }
}

read_ahead::~read_ahead() {
  {
    std::lock_guard<std::mutex> const lock(guard_);
    stop_ = true;
  }
  room_.notify_all();
  for (auto& thread : threads_) { thread.join(); }
}

void read_ahead::work() {
  std::unique_lock<std::mutex> lock(guard_);
  for (;;) {
    room_.wait(lock, [this] { return stop_ || next_ >= frames_ || next_ < first_ + ahead_; });
    if (stop_ || next_ >= frames_) { return; }
    int const i = next_++;
    lock.unlock();
    slot done;
    done.index = i;
    try {
      done.frame = load_(i);
    } catch (...) { done.failure = std::current_exception(); }
    lock.lock();
    if (i < first_) { continue; }  // left out meanwhile
    slot_of(i) = std::move(done);
    loaded_.notify_all();
  }
}

stereo_frame read_ahead::take(int i) {
  if (i < first_ || i >= frames_) {
    throw error("read_ahead: frame " + std::to_string(i) + " of " + std::to_string(frames_) +
                ", must be at least " + std::to_string(first_));
  }
  if (ahead_ == 0) {
    first_ = i + 1;
    return load_(i);
  }
  slot taken;
  {
    std::unique_lock<std::mutex> lock(guard_);
    first_ = i;
    next_ = std::max(next_, i);
    room_.notify_all();
    loaded_.wait(lock, [&] { return slot_of(i).index == i; });
    taken = std::move(slot_of(i));
    first_ = i + 1;
  }
  room_.notify_all();
  if (taken.failure) { std::rethrow_exception(taken.failure); }
  return std::move(taken.frame);
}

}  // namespace seq
