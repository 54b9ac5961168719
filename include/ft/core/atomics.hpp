// SPDX-License-Identifier: Apache-2.0
/// @file Atomic operations on integers: relaxed ones, whose sums, minima and maxima do not depend
/// on the order of the calls, and a counter and a flag with release and acquire semantics.
#pragma once

#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {

/// Adds; returns the old value.
FT_HOST_DEVICE inline int atomic_add(int* address, int value) {
#if defined(__CUDA_ARCH__)
  return atomicAdd(address, value);
#else
  return __atomic_fetch_add(address, value, __ATOMIC_RELAXED);
#endif
}

FT_HOST_DEVICE inline unsigned long long atomic_add(unsigned long long* address,
                                                    unsigned long long value) {
#if defined(__CUDA_ARCH__)
  return atomicAdd(address, value);
#else
  return __atomic_fetch_add(address, value, __ATOMIC_RELAXED);
#endif
}

/// Stores; returns the old value.
FT_HOST_DEVICE inline int atomic_exchange(int* address, int value) {
#if defined(__CUDA_ARCH__)
  return atomicExch(address, value);
#else
  return __atomic_exchange_n(address, value, __ATOMIC_RELAXED);
#endif
}

FT_HOST_DEVICE inline unsigned long long atomic_exchange(unsigned long long* address,
                                                         unsigned long long value) {
#if defined(__CUDA_ARCH__)
  return atomicExch(address, value);
#else
  return __atomic_exchange_n(address, value, __ATOMIC_RELAXED);
#endif
}

/// Stores the smaller of the two; returns the old value.
template <typename T>
FT_HOST_DEVICE T atomic_min(T* address, T value) {
#if defined(__CUDA_ARCH__)
  return atomicMin(address, value);
#else
  T seen = __atomic_load_n(address, __ATOMIC_RELAXED);
  while (value < seen && !__atomic_compare_exchange_n(address, &seen, value, true, __ATOMIC_RELAXED,
                                                      __ATOMIC_RELAXED)) {}
  return seen;
#endif
}

/// Stores the larger of the two.
template <typename T>
FT_HOST_DEVICE void atomic_max(T* address, T value) {
#if defined(__CUDA_ARCH__)
  atomicMax(address, value);
#else
  T seen = __atomic_load_n(address, __ATOMIC_RELAXED);
  while (seen < value && !__atomic_compare_exchange_n(address, &seen, value, true, __ATOMIC_RELAXED,
                                                      __ATOMIC_RELAXED)) {}
#endif
}

/// Sets a flag to 1 with release semantics, for the whole system: a host that sees it by is_set()
/// sees what this thread has written before, and what others have that it has synchronised with.
FT_HOST_DEVICE inline void set_flag(int* address) {
#if defined(__CUDA_ARCH__)
  asm volatile("st.release.sys.s32 [%0], %1;" : : "l"(address), "r"(1) : "memory");
#else
  __atomic_store_n(address, 1, __ATOMIC_RELEASE);
#endif
}
/// Of the host.
inline bool is_set(int const* address) { return __atomic_load_n(address, __ATOMIC_ACQUIRE) != 0; }

/// Adds 1 with release semantics, for the whole device: writes that come before are visible to
/// threads that see the sum through atomic_load_acquire(). In PTX, which is what cuda::atomic_ref
/// gives: its header takes nvcc two seconds a unit.
FT_HOST_DEVICE inline void atomic_increment_release(unsigned* address) {
#if defined(__CUDA_ARCH__)
  asm volatile("red.release.gpu.add.u32 [%0], %1;" : : "l"(address), "r"(1u) : "memory");
#else
  __atomic_fetch_add(address, 1u, __ATOMIC_RELEASE);
#endif
}
FT_HOST_DEVICE inline unsigned atomic_load_acquire(unsigned const* address) {
#if defined(__CUDA_ARCH__)
  unsigned value;
  asm volatile("ld.acquire.gpu.b32 %0, [%1];" : "=r"(value) : "l"(address) : "memory");
  return value;
#else
  return __atomic_load_n(address, __ATOMIC_ACQUIRE);
#endif
}

}  // namespace FT_ABI
}  // namespace ft
