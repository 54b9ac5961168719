// SPDX-License-Identifier: Apache-2.0
/// @file The program's odometry on a stream of its own.
#pragma once

#include "examples/track_sequence/visual_odometry.hpp"

namespace app {

/// A stream that is destroyed after all users of it.
class owned_stream {
public:
  owned_stream() {
    ft::throw_on_error(cudaStreamCreateWithFlags(&stream_, cudaStreamNonBlocking),
                       "cudaStreamCreate");
  }
  owned_stream(owned_stream const&) = delete;
  owned_stream& operator=(owned_stream const&) = delete;
  ~owned_stream() { static_cast<void>(cudaStreamDestroy(stream_)); }
  cudaStream_t get() const { return stream_; }

private:
  cudaStream_t stream_ = nullptr;
};

template <typename Rig>
class cuda_odometry final : public odometry {
public:
  explicit cuda_odometry(odometry_options const& options)
      : inner_(ft::cuda_exec(stream_.get()), options, cuda_device_name()) {}
  frame_outcome track(std::int64_t time_ns, frame_pixels const& images) override {
    return inner_.track(time_ns, images);
  }
  void prefetch(frame_pixels const& images) override { inner_.prefetch(images); }
  void forget_prefetched() override { inner_.forget_prefetched(); }
  frame_outcome track_prefetched(std::int64_t time_ns) override {
    return inner_.track_prefetched(time_ns);
  }
  void add_imu(std::int64_t time_ns, std::array<double, 3> const& accel,
               std::array<double, 3> const& gyro) override {
    inner_.add_imu(time_ns, accel, gyro);
  }
  std::vector<std::string> const& stage_names() const override { return inner_.stage_names(); }
  std::vector<seen_keypoint> keypoints() const override { return inner_.keypoints(); }
  void write_map(std::ostream& to, rigid_pose const& T_file_world) const override {
    inner_.write_map(to, T_file_world);
  }
  int keyframes() const override { return inner_.keyframes(); }
  int map_points() const override { return inner_.map_points(); }
  int maps() const override { return inner_.maps(); }
  std::string device() const override { return inner_.device(); }
  std::vector<std::string> calibration_warnings() const override {
    return inner_.calibration_warnings();
  }

private:
  owned_stream stream_;
  visual_odometry<ft::cuda_exec, Rig> inner_;
};

}  // namespace app
