// SPDX-License-Identifier: Apache-2.0
/// @file Copies many small arrays at once between staging memory and executor memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"

namespace ft {
namespace orbslam3 {
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

  /// Makes the copies; asynchronous where the executor is. Returns the bytes.
  std::size_t flush(Exec const& exec) {
    std::size_t const bytes = 4 * static_cast<std::size_t>(all_.words);
    if constexpr (Exec::asynchronous) {
      for_each_item<per_thread>(exec, all_.words, move_word{}, all_);
    } else {
      for (int s = 0; s < all_.count; ++s) {
        word_segment const& segment = all_.segment[s];
        copy(exec, segment.to, segment.from, static_cast<std::size_t>(segment.words));
      }
    }
    all_.count = 0;
    all_.words = 0;
    moved_ += bytes;
    return bytes;
  }

  /// Bytes moved since the last take.
  std::size_t take_bytes() {
    std::size_t const bytes = moved_;
    moved_ = 0;
    return bytes;
  }

private:
  word_segments all_;
  std::size_t moved_ = 0;
};

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
