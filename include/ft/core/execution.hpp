// SPDX-License-Identifier: Apache-2.0
/// @file Executors: where a stage runs. A stage is a functor (core/stage.hpp), and
/// for_each_item<Shape>(exec, items, op, args...) runs it on `host_exec` or `cuda_exec`.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/core/config.hpp"
#include "ft/core/cuda_executor.hpp"
#include "ft/core/host_executor.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/stage.hpp"
#include "ft/core/views.hpp"

namespace ft {
inline namespace FT_ABI {

/// Copies elements rather than bytes. Asynchronous if the executor is; allocates nothing.
template <typename Exec, typename T>
void copy(Exec const& exec, T* to, T const* from, std::size_t count) {
  copy_bytes(exec, to, from, count * sizeof(T));
}

/// Copies the pixels of an image to another one of the same size. Asynchronous if the executor is;
/// allocates nothing.
template <typename Exec>
void copy_image(Exec const& exec, image_view<std::uint8_t> const& to, gray_view const& from) {
  copy_rows(exec, {to.data, static_cast<std::size_t>(to.stride)},
            {from.data, static_cast<std::size_t>(from.stride)},
            static_cast<std::size_t>(from.width), from.height);
}

/// The memory space of staging memory, which transfers of an executor use: pinned next to a device,
/// plain otherwise.
template <typename Exec>
inline constexpr memory_space staging_space =
    Exec::space == memory_space::device ? memory_space::pinned : memory_space::host;

}  // namespace FT_ABI
}  // namespace ft
