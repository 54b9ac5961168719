// SPDX-License-Identifier: Apache-2.0
/// @file How calls on an executor move words, are recorded and wait.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <type_traits>
#include <vector>

#include "ft/core/config.hpp"
#include "ft/core/cuda_handles.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/recording.hpp"
#include "ft/types/tracking.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft::orbslam3 {
inline namespace FT_ABI {

struct word_segment {
  std::uint32_t const* from;
  std::uint32_t* to;
  int words;
};

struct word_segments {
  static constexpr int most = 18;
  word_segment segment[most];
  int count = 0;
  int words = 0;
};

/// One word of all segments.
struct move_word {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, word_segments const& all) const {
    for (int s = 0; s < all.count; ++s) {
      word_segment const& segment = all.segment[s];
      if (item < segment.words) {
        segment.to[item] = segment.from[item];
        return;
      }
      item -= segment.words;
    }
  }
};

/// Collects copies and makes them together: on a device by one launch, which reads and writes
/// pinned memory; on the host by plain copies.
template <typename Exec>
class word_mover {
public:
  /// @param count elements of a size that is a multiple of 4 bytes
  template <typename T>
  void add(Exec const& exec, T* to, std::remove_const_t<T> const* from, int count) {
    static_assert(std::is_trivially_copyable<T>::value && sizeof(T) % 4 == 0, "moved as words");
    if (count <= 0) { return; }
    if (all_.count == word_segments::most) { flush(exec); }
    int const words = count * static_cast<int>(sizeof(T) / 4);
    all_.segment[all_.count++] = {reinterpret_cast<std::uint32_t const*>(from),
                                  reinterpret_cast<std::uint32_t*>(to), words};
    all_.words += words;
  }

  /// Makes the copies; asynchronous where the executor is.
  void flush(Exec const& exec) {
    if constexpr (Exec::asynchronous) {
      for_each_item<per_thread>(exec, all_.words, move_word{}, all_);
    } else {
      for (int s = 0; s < all_.count; ++s) {
        word_segment const& segment = all_.segment[s];
        copy(exec, segment.to, segment.from, static_cast<std::size_t>(segment.words));
      }
    }
    all_ = {};
  }

private:
  word_segments all_;
};

/// An executor of its own for calls from any thread: on a device a stream. On the host all share
/// the thread pool of `beside`.
template <typename Exec>
class own_stream {
public:
  explicit own_stream(Exec const& beside) : exec_(beside) {}
  Exec const& exec() const { return exec_; }
  void enter() const {}

private:
  Exec exec_;
};

#if defined(__CUDACC__)
template <>
class own_stream<cuda_exec> {
public:
  explicit own_stream(cuda_exec const& /*beside*/) : exec_(stream_.get()) {
    throw_on_error(cudaGetDevice(&device_), "cudaGetDevice");
  }
  cuda_exec const& exec() const { return exec_; }
  /// Makes the device of the constructing thread the current one of this thread.
  void enter() const { throw_on_error(cudaSetDevice(device_), "cudaSetDevice"); }

private:
  stream stream_;
  cuda_exec exec_;
  int device_ = 0;
};
#endif

/// The parameters of a call's launches, apart from data in memory.
struct call_key {
  int call = 0;
  int buffer = 0;
  int size = 0;  ///< of the launches
  float values[6] = {};

  static call_key of(int call, int buffer, int size, bounds const& image, float a, float b) {
    return {call, buffer, size, {image.min_x, image.min_y, image.max_x, image.max_y, a, b}};
  }
  friend bool operator==(call_key const& a, call_key const& b) {
    return a.call == b.call && a.buffer == b.buffer && a.size == b.size &&
           std::memcmp(a.values, b.values, sizeof a.values) == 0;
  }
};

/// Replays the call of a key, and records it when the key is new. If there are more keys than
/// entries, which does not happen in tracking, calls are enqueued launch by launch.
template <typename Exec>
class call_graphs {
public:
  template <typename Queue>
  void replay(Exec const& exec, call_key const& key, Queue const& queue) {
    for (entry const& e : entries_) {
      if (e.key == key) { return e.graph.replay(exec, queue); }
    }
    if (!Exec::asynchronous || entries_.size() == most) { return queue(exec); }
    entries_.push_back({key, {}});
    entries_.back().graph.record(exec, queue);
    entries_.back().graph.replay(exec, queue);
  }
  /// To be called when the memory that the calls use has moved.
  void clear() { entries_.clear(); }

private:
  static constexpr std::size_t most = 64;
  struct entry {
    call_key key;
    recording<Exec> graph;
  };
  std::vector<entry> entries_;
};

/// Base of calls that depend on no frame: on a stream and with memory of their own, so what
/// tracking has started for the next call goes on.
template <typename Exec>
class own_calls {
protected:
  explicit own_calls(Exec const& beside) : stream_(beside) {}

  Exec const& exec() const { return stream_.exec(); }
  void enter() const { stream_.enter(); }
  /// Allocates zeros in executor memory and in staging memory. Waits.
  template <typename Layout, typename HostLayout>
  void allocate(Layout const& layout, HostLayout const& host_layout) {
    memory_ = arena<Exec::space>(layout);
    host_memory_ = arena<staging_space<Exec>>(host_layout);
    std::memset(host_memory_.data(), 0, host_memory_.bytes());
    fill_bytes(exec(), memory_.data(), 0, memory_.bytes());
    exec().wait();
  }
  /// A call that waits. @param send,fetch void(word_mover&): what is moved before and after
  template <typename Send, typename Compute, typename Fetch>
  void call(Send const& send, Compute const& compute, Fetch const& fetch) {
    word_mover<Exec> words;
    send(words);
    words.flush(exec());
    compute();
    fetch(words);
    words.flush(exec());
    exec().wait();
  }

private:
  own_stream<Exec> stream_;
  arena<Exec::space> memory_;
  arena<staging_space<Exec>> host_memory_;
};

}  // namespace FT_ABI
}  // namespace ft::orbslam3
