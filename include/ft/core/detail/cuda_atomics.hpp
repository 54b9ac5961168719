// SPDX-License-Identifier: Apache-2.0
/// @file Atomic operations of a device with acquire and release semantics, at the scope of the
/// device. In PTX, which is what cuda::atomic_ref gives: its header takes nvcc two seconds a unit.
#pragma once

#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

__device__ inline void increment_release(unsigned* address) {
  asm volatile("red.release.gpu.add.u32 [%0], %1;" : : "l"(address), "r"(1u) : "memory");
}
__device__ inline unsigned load_acquire(unsigned const* address) {
  unsigned value;
  asm volatile("ld.acquire.gpu.b32 %0, [%1];" : "=r"(value) : "l"(address) : "memory");
  return value;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
