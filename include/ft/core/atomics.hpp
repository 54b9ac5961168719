// SPDX-License-Identifier: Apache-2.0
/// @file Atomic operations on integers, relaxed.
///
/// Sums, minima and maxima do not depend on the order of the calls.
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

}  // namespace FT_ABI
}  // namespace ft
