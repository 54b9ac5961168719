// SPDX-License-Identifier: Apache-2.0
// How much memory this process holds. Included after a header of ft.
#pragma once

#include <cstddef>
#include <cstdio>

#if defined(__linux__)
#include <unistd.h>
#endif
#if defined(__GLIBC__)
#include <malloc.h>
#endif

#include "ft/core/execution.hpp"

namespace test {

struct usage {
  long long resident = 0;  ///< bytes, 0 = not known here
  long long heap = 0;      ///< bytes that malloc has given out
  long long device = 0;    ///< bytes in use on the device, by everyone
};

inline usage measure() {
  usage u;
#if defined(__linux__)
  if (std::FILE* const file = std::fopen("/proc/self/statm", "r")) {
    long long size = 0;
    long long resident = 0;
    if (std::fscanf(file, "%lld %lld", &size, &resident) == 2) {
      u.resident = resident * static_cast<long long>(sysconf(_SC_PAGESIZE));
    }
    std::fclose(file);
  }
#endif
#if defined(__GLIBC__)
#if __GLIBC_PREREQ(2, 33)
  auto const heap = mallinfo2();
  u.heap = static_cast<long long>(heap.uordblks + heap.hblkhd);
#endif
#endif
#if defined(__CUDACC__)
  std::size_t free = 0;
  std::size_t total = 0;
  ft::throw_on_error(cudaMemGetInfo(&free, &total), "cudaMemGetInfo");
  u.device = static_cast<long long>(total - free);
#endif
  return u;
}

}  // namespace test
