// SPDX-License-Identifier: Apache-2.0
/// @file Stage: clears the holders of keypoints.
#pragma once

#include "ft/containers/frame.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Item: a keypoint. Clears its holder.
struct clear_holder {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, frame_view const& frame) const {
    frame.holder[item] = -1;
  }
};

}  // namespace detail

/// Clears the holders of all frames. Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec>
void clear_holders(Exec const& exec, frame_view const& frame) {
  for_each_item<per_thread>(exec, frame.batch * frame.numbers(), detail::clear_holder{}, frame);
}

}  // namespace FT_ABI
}  // namespace ft
