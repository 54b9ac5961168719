// SPDX-License-Identifier: Apache-2.0
#include <stdexcept>

#include "ft_ros2/tracker_of.hpp"

namespace ft_ros2 {

std::unique_ptr<tracker> make_host_tracker(tracker_settings const& settings) {
  return std::make_unique<tracker_of<ft::host_exec>>(ft::host_exec(settings.threads), settings);
}

#if !FT_ROS2_HAS_CUDA
std::unique_ptr<tracker> make_cuda_tracker(tracker_settings const&) {
  throw std::runtime_error("this program was built without CUDA (-DUSE_CUDA=ON)");
}
#endif

}  // namespace ft_ros2
