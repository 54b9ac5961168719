// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <cstdint>
#include <memory>

#include "ft/core/cuda_handles.hpp"
#include "ft_ros2/tracker_of.hpp"

namespace ft_ros2 {
namespace {

/// With a stream of its own, which outlives the odometry.
class cuda_tracker final : public tracker {
public:
  explicit cuda_tracker(tracker_settings const& settings)
      : inner_(ft::cuda_exec(stream_.get()), settings) {}
  estimate track(std::uint8_t const* left, std::uint8_t const* right,
                 std::int64_t time_ns) override {
    return inner_.track(left, right, time_ns);
  }
  void add_imu(std::int64_t time_ns, std::array<double, 3> const& accel,
               std::array<double, 3> const& gyro) override {
    inner_.add_imu(time_ns, accel, gyro);
  }

private:
  ft::stream stream_;
  tracker_of<ft::cuda_exec> inner_;
};

}  // namespace

std::unique_ptr<tracker> make_cuda_tracker(tracker_settings const& settings) {
  return std::make_unique<cuda_tracker>(settings);
}

}  // namespace ft_ros2
