// SPDX-License-Identifier: Apache-2.0
/// @file Counts allocations of one thread.
#pragma once

#include <cstddef>
#include <cstdlib>
#include <new>

namespace test {

/// Counts what the calling thread takes from the heap while one of these lives. Only in programs
/// whose operator new is that of tests/pipelines/tracker_test.cpp; in others it counts nothing.
class allocation_count {
public:
  allocation_count() {
    total() = 0;
    taken() = 0;
    counting() = true;
  }
  allocation_count(allocation_count const&) = delete;
  allocation_count& operator=(allocation_count const&) = delete;
  ~allocation_count() { counting() = false; }
  long so_far() const { return total(); }
  std::size_t bytes() const { return taken(); }

  static void* take(std::size_t bytes, std::size_t alignment) {
    if (counting()) {
      ++total();
      taken() += bytes;
    }
    void* p = nullptr;
    std::size_t const size = bytes == 0 ? 1 : bytes;
    if (alignment <= alignof(std::max_align_t)) {
      p = std::malloc(size);
    } else {
      p = std::aligned_alloc(alignment, (size + alignment - 1) / alignment * alignment);
    }
    return p;
  }
  static void* take_or_throw(std::size_t bytes, std::size_t alignment) {
    void* const p = take(bytes, alignment);
    if (p == nullptr) { throw std::bad_alloc(); }
    return p;
  }

private:
  static bool& counting() {
    thread_local bool value = false;
    return value;
  }
  static long& total() {
    thread_local long value = 0;
    return value;
  }
  static std::size_t& taken() {
    thread_local std::size_t value = 0;
    return value;
  }
};

}  // namespace test
