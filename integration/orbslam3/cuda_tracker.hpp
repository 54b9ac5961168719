// SPDX-License-Identifier: Apache-2.0
/// @file The shim on a GPU. Include it in one .cu file of the program, which defines a plain
/// function for the other units:
///
///     #include "integration/orbslam3/cuda_tracker.hpp"
///
///     std::unique_ptr<ft::orbslam3::device_tracker> make_gpu_tracker(
///         ft::orbslam3::settings const& s) {
///       return ft::orbslam3::make_cuda_tracker(s);
///     }
#pragma once

#include <memory>

#include "ft/core/cuda_handles.hpp"
#include "integration/orbslam3/executor_tracker.hpp"
#include "integration/orbslam3/make_tracker_on.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

namespace stream_detail {

/// The stream is declared first, so that it is destroyed last.
template <typename Rig>
class streaming_tracker final : stream, public executor_tracker<cuda_exec, Rig> {
public:
  explicit streaming_tracker(settings const& s)
      : executor_tracker<cuda_exec, Rig>(cuda_exec(stream::get()), s) {}
};

}  // namespace stream_detail

/// On the current device, with a stream of its own.
/// @throws bad_argument for invalid settings, cuda_error without a device or memory
inline std::unique_ptr<device_tracker> make_cuda_tracker(settings const& s) {
  if (s.left.kind == lens::pinhole) {
    return std::make_unique<stream_detail::streaming_tracker<rectified_rig>>(s);
  }
  return std::make_unique<stream_detail::streaming_tracker<fisheye_rig>>(s);
}

/// On a stream of the caller, which must outlive the tracker.
inline std::unique_ptr<device_tracker> make_cuda_tracker(settings const& s, cudaStream_t stream) {
  return make_tracker_on(cuda_exec(stream), s);
}

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
