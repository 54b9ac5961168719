// SPDX-License-Identifier: Apache-2.0
/// @file Atomic operations of a device with acquire and release semantics: libcu++'s.
#pragma once

#include <cuda/atomic>

#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

using device_atomic = cuda::atomic_ref<unsigned, cuda::thread_scope_device>;

__device__ inline void increment_release(unsigned* address) {
  device_atomic(*address).fetch_add(1u, cuda::memory_order_release);
}
__device__ inline unsigned load_acquire(unsigned const* address) {
  return device_atomic(*const_cast<unsigned*>(address)).load(cuda::memory_order_acquire);
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
