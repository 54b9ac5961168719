// SPDX-License-Identifier: Apache-2.0
/// @file Memory spaces, owning buffers, and the carver that lays out a pipeline's one arena.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <new>
#include <string>
#include <type_traits>
#include <utility>

#include "ft/core/config.hpp"
#include "ft/core/cuda_handles.hpp"
#include "ft/core/error.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

enum class memory_space {
  host,    ///< ordinary memory
  pinned,  ///< host memory that the device copies from and to asynchronously
  device,  ///< the current CUDA device's memory
};

namespace detail {

inline constexpr std::size_t alignment = 256;

#if defined(FT_NEW_MEMORY_SEED)
/// Pseudo-random words (splitmix64), different for every allocation of a thread and the same on
/// every run.
class garbage {
public:
  garbage() {
    static thread_local std::uint64_t allocations = 0;
    state_ = static_cast<std::uint64_t>(FT_NEW_MEMORY_SEED) + (++allocations << 32);
  }
  void write(void* to, std::size_t bytes) {
    auto* const target = static_cast<unsigned char*>(to);
    std::size_t at = 0;
    for (; bytes - at >= sizeof(std::uint64_t); at += sizeof(std::uint64_t)) {
      std::uint64_t const word = next();
      std::memcpy(target + at, &word, sizeof word);
    }
    if (at == bytes) { return; }
    std::uint64_t const word = next();
    std::memcpy(target + at, &word, bytes - at);
  }

private:
  std::uint64_t next() {
    std::uint64_t z = state_ += 0x9e3779b97f4a7c15u;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
  }
  std::uint64_t state_;
};
#endif

/// With FT_NEW_MEMORY_SEED defined (a debugging aid, for a whole program) new memory is filled with
/// pseudo-random bytes. This makes reads of uninitialised memory reproducible. A constant byte
/// would not do: two such reads would still agree with each other.
template <memory_space Space>
void* fill_new(void* p, std::size_t bytes) {
#if defined(FT_NEW_MEMORY_SEED)
  garbage words;
  if constexpr (Space != memory_space::device) {
    words.write(p, bytes);
  } else {
#if defined(__CUDACC__)
    // On a stream of its own, because another thread may be recording a graph.
    unsigned char some[1 << 14];
    for (std::size_t at = 0; at < bytes; at += sizeof some) {
      std::size_t const size = bytes - at < sizeof some ? bytes - at : sizeof some;
      words.write(some, size);
      throw_on_error(cudaMemcpyAsync(static_cast<unsigned char*>(p) + at, some, size,
                                     cudaMemcpyHostToDevice, cudaStreamPerThread),
                     "cudaMemcpyAsync");
    }
    throw_on_error(cudaStreamSynchronize(cudaStreamPerThread), "cudaStreamSynchronize");
#endif
  }
#endif
  static_cast<void>(bytes);
  return p;
}

template <memory_space Space>
void* allocate(std::size_t bytes) {
  if constexpr (Space == memory_space::host) {
    return fill_new<Space>(::operator new(bytes, std::align_val_t(alignment)), bytes);
  } else {
#if defined(__CUDACC__)
    void* p = nullptr;
    if constexpr (Space == memory_space::pinned) {
      throw_on_error(cudaMallocHost(&p, bytes), "cudaMallocHost");
    } else {
      throw_on_error(cudaMalloc(&p, bytes), "cudaMalloc");
    }
    return fill_new<Space>(p, bytes);
#else
    static_assert(Space == memory_space::host, "pinned and device memory need a CUDA compiler");
    return nullptr;
#endif
  }
}

/// Never throws: tolerates a runtime that is already unloaded.
template <memory_space Space>
void deallocate(void* p) noexcept {
  if (p == nullptr) { return; }
  if constexpr (Space == memory_space::host) {
    ::operator delete(p, std::align_val_t(alignment));
  } else {
#if defined(__CUDACC__)
    if constexpr (Space == memory_space::pinned) {
      static_cast<void>(cudaFreeHost(p));
    } else {
      static_cast<void>(cudaFree(p));
    }
#endif
  }
}

}  // namespace detail

/// `size` elements of T in one space; move-only. Elements are not initialised.
/// Allocates on construction only. @throws std::bad_alloc, cuda_error
template <typename T, memory_space Space>
class buffer {
  static_assert(std::is_trivially_copyable<T>::value, "moved between spaces as bytes");

public:
  static constexpr memory_space space = Space;

  buffer() = default;
  explicit buffer(std::size_t size)
      : data_(size == 0
                  ? nullptr
                  : static_cast<T*>(detail::allocate<Space>(detail::checked_mul(size, sizeof(T))))),
        size_(size) {}
  buffer(buffer&& other) noexcept
      : data_(std::exchange(other.data_, nullptr)), size_(std::exchange(other.size_, 0)) {}
  buffer& operator=(buffer&& other) noexcept {
    if (this != &other) {
      detail::deallocate<Space>(data_);
      data_ = std::exchange(other.data_, nullptr);
      size_ = std::exchange(other.size_, 0);
    }
    return *this;
  }
  buffer(buffer const&) = delete;
  buffer& operator=(buffer const&) = delete;
  ~buffer() { detail::deallocate<Space>(data_); }

  T* data() const noexcept { return data_; }
  std::size_t size() const noexcept { return size_; }
  std::size_t bytes() const noexcept { return size_ * sizeof(T); }

private:
  T* data_ = nullptr;
  std::size_t size_ = 0;
};

namespace detail {

/// The sides of an array, [entries][...]. @throws bad_argument if the product overflows
struct extent {
  std::size_t entries;   ///< of the first axis, such as a batch
  std::size_t each = 1;  ///< elements of one of them

  template <typename First, typename... Others>
  extent(First first, Others... others)  // NOLINT(google-explicit-constructor)
      : entries(static_cast<std::size_t>(first)) {
    ((each = checked_mul(each, static_cast<std::size_t>(others))), ...);
  }
  std::size_t size() const { return checked_mul(entries, each); }
};

}  // namespace detail

/// Hands out aligned pieces of one block. Run a layout once on a default carver to learn `used()`,
/// then again on the block: the same calls give the same pieces.
class carver {
public:
  carver() = default;
  explicit carver(std::byte* base) : base_(base) {}

  template <typename T>
  T* take(std::size_t count) {
    std::size_t const start =
        (used_ + detail::alignment - 1) / detail::alignment * detail::alignment;
    std::size_t const bytes = detail::checked_mul(count, sizeof(T));
    if (start < used_ || start + bytes < start) { throw bad_argument("ft: arena size overflow"); }
    T* const piece = base_ == nullptr ? nullptr : reinterpret_cast<T*>(base_ + start);
    used_ = start + bytes;
    return piece;
  }
  /// Places arrays of one extent, one after the other: `c.place({batch, slots}, v.found, v.seen)`.
  template <typename... Ts>
  void place(detail::extent const& of_each, Ts*&... arrays) {
    ((arrays = take<Ts>(of_each.size())), ...);
  }
  std::size_t used() const { return used_; }

private:
  std::byte* base_ = nullptr;
  std::size_t used_ = 0;
};

/// One block of memory, carved once by a layout function `void(carver&)`.
template <memory_space Space>
class arena {
public:
  arena() = default;
  template <typename Layout>
  explicit arena(Layout&& layout) {
    carver measure;
    layout(measure);
    block_ = buffer<std::byte, Space>(measure.used() + detail::alignment);
    carver place(block_.data());
    layout(place);
  }
  std::size_t bytes() const { return block_.bytes(); }
  std::byte* data() const { return block_.data(); }

private:
  buffer<std::byte, Space> block_;
};

/// A view, and the arena that its arrays lie in; move-only. One that was moved from has neither.
template <typename View, memory_space Space>
class owner {
public:
  owner() = default;
  /// @param layout void(carver&, View&) that places the view's arrays; runs twice
  /// @param view initial values of what the layout does not set
  /// @throws std::bad_alloc, cuda_error, and what the layout throws
  template <typename Layout>
  explicit owner(Layout const& layout, View const& view = {})
      : view_(view), arena_([&](carver& c) { layout(c, view_); }) {}
  owner(owner&& other) noexcept
      : view_(std::exchange(other.view_, {})), arena_(std::move(other.arena_)) {}
  owner& operator=(owner&& other) noexcept {
    view_ = std::exchange(other.view_, {});
    arena_ = std::move(other.arena_);
    return *this;
  }
  owner(owner const&) = delete;
  owner& operator=(owner const&) = delete;
  ~owner() = default;

  View const& view() const { return view_; }  ///< empty after a move
  View const* operator->() const { return &view_; }
  std::size_t bytes() const { return arena_.bytes(); }
  /// @throws bad_argument if there is no memory, so that pipelines can refuse calls
  void require_made(char const* object) const {
    if (bytes() == 0) {
      throw bad_argument(std::string("ft: the ") + object + " was never made, or was moved from");
    }
  }

private:
  View view_;
  arena<Space> arena_;
};

}  // namespace FT_ABI
}  // namespace ft
