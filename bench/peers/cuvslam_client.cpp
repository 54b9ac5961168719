// SPDX-License-Identifier: Apache-2.0
/// @file Tracks a camera pair of a sequence with cuVSLAM's odometry, on the frames that ft gets:
/// cuvslam_client FOLDER TRAJECTORY.txt [--imu]. See README.md here.
#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/reader.hpp"

#include <cuvslam2.h>

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <iostream>
#include <string>
#include <vector>

namespace {

cuvslam::Pose to_pose(Eigen::Isometry3d const& T) {
  Eigen::Quaternionf const q(Eigen::Quaterniond(T.linear()).normalized().cast<float>());
  Eigen::Vector3f const p = T.translation().cast<float>();
  return {{q.x(), q.y(), q.z(), q.w()}, {p.x(), p.y(), p.z()}};
}

Eigen::Isometry3d from_pose(cuvslam::Pose const& pose) {
  auto const& q = pose.rotation;
  auto const& p = pose.translation;
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() =
      Eigen::Quaternionf(q[3], q[0], q[1], q[2]).cast<double>().normalized().toRotationMatrix();
  T.translation() = Eigen::Vector3f(p[0], p[1], p[2]).cast<double>();
  return T;
}

/// The rig's frame is the left camera's.
cuvslam::Camera to_camera(seq::camera_intrinsics const& c, Eigen::Isometry3d const& T_left_camera) {
  cuvslam::Camera out{};
  out.size = {c.width, c.height};
  out.principal = {static_cast<float>(c.cx), static_cast<float>(c.cy)};
  out.focal = {static_cast<float>(c.fx), static_cast<float>(c.fy)};
  out.rig_from_camera = to_pose(T_left_camera);
  if (c.model == seq::lens::kannala_brandt) {
    out.distortion.model = cuvslam::Distortion::Model::Fisheye;
    for (double const k : c.distortion) {
      out.distortion.parameters.push_back(static_cast<float>(k));
    }
  }
  return out;
}

cuvslam::Rig rig_of(seq::sequence const& sequence) {
  cuvslam::Rig rig;
  seq::stereo_rig const& pair = sequence.rig();
  rig.cameras = {to_camera(pair.left, Eigen::Isometry3d::Identity()),
                 to_camera(pair.right, pair.T_left_right)};
  if (sequence.imu()) {
    auto const& imu = *sequence.imu();
    seq::imu_noise const& n = imu.calibration.noise;
    rig.imus.push_back({to_pose(imu.T_imu_left.inverse()), static_cast<float>(n.gyro),
                        static_cast<float>(n.gyro_walk), static_cast<float>(n.accel),
                        static_cast<float>(n.accel_walk),
                        static_cast<float>(imu.calibration.rate_hz)});
  }
  return rig;
}

cuvslam::Odometry::Config config_of(seq::sequence const& sequence) {
  cuvslam::Odometry::Config config = cuvslam::Odometry::GetDefaultConfig();
  config.async_sba = false;  // the same poses on each run
  config.rectified_stereo_camera = sequence.rig().rectified();
  config.odometry_mode = sequence.imu() ? cuvslam::Odometry::OdometryMode::Inertial
                                        : cuvslam::Odometry::OdometryMode::Multicamera;
  return config;
}

cuvslam::Image to_image(seq::image const& image, std::int64_t time_ns, std::uint32_t camera) {
  cuvslam::Image out{};
  out.pixels = image.pixels.data();
  out.width = image.width;
  out.height = image.height;
  out.pitch = image.width;
  out.encoding = cuvslam::ImageData::Encoding::MONO;
  out.data_type = cuvslam::ImageData::DataType::UINT8;
  out.timestamp_ns = time_ns;
  out.camera_index = camera;
  return out;
}

/// Tracks the frames one after the other, with the samples of the IMU up to each one.
class client {
public:
  explicit client(seq::sequence const& sequence)
      : sequence_(sequence), odometry_(rig_of(sequence), config_of(sequence)) {}

  seq::trajectory track_all() {
    seq::trajectory poses;
    for (int i = 0; i < sequence_.size(); ++i) {
      seq::stereo_frame const frame = sequence_.load(i);
      add_imu(frame.time_ns);
      auto const begin = std::chrono::steady_clock::now();
      auto const found = odometry_.Track(
          {to_image(frame.left, frame.time_ns, 0), to_image(frame.right, frame.time_ns, 1)});
      ms_ += std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin)
                 .count();
      if (found.world_from_rig) {
        poses.push_back({frame.time_ns, from_pose(found.world_from_rig->pose)});
      }
    }
    return poses;
  }
  double ms() const { return ms_; }

private:
  void add_imu(std::int64_t to_ns) {
    if (!sequence_.imu()) { return; }
    auto const& samples = sequence_.imu()->samples;
    for (; next_ < samples.size() && samples[next_].time_ns <= to_ns; ++next_) {
      auto const& s = samples[next_];
      auto const plain = [](Eigen::Vector3d const& v) -> cuvslam::Vector3f {
        return {static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z())};
      };
      odometry_.RegisterImuMeasurement(0, {s.time_ns, plain(s.accel), plain(s.gyro)});
    }
  }

  seq::sequence const& sequence_;
  cuvslam::Odometry odometry_;
  std::size_t next_ = 0;
  double ms_ = 0;
};

}  // namespace

int main(int argc, char** argv) {
  bool const with_imu = argc == 4 && std::string(argv[3]) == "--imu";
  if (argc != 3 && !with_imu) {
    std::cerr << "usage: cuvslam_client FOLDER TRAJECTORY.txt [--imu]\n";
    return 2;
  }
  try {
    seq::open_options options;
    options.rig = seq::camera_kind::stereo;
    options.read_imu = with_imu;
    auto const sequence = seq::sequence::open(argv[1], options);
    if (with_imu && !sequence.imu()) { throw seq::error(std::string(argv[1]) + ": has no IMU"); }
    cuvslam::WarmUpGPU();
    client tracker(sequence);
    seq::trajectory const poses = tracker.track_all();
    seq::write_tum(argv[2], poses);
    auto const error =
        seq::evaluate(poses, sequence.ground_truth(), sequence.ground_truth_has_orientation());
    std::cout << sequence.size() << " frames, " << poses.size() << " tracked, "
              << tracker.ms() / sequence.size() << " ms a frame";
    if (error.ate_rmse_m) { std::cout << ", ATE " << *error.ate_rmse_m << " m"; }
    std::cout << "\n";
  } catch (std::exception const& e) {
    std::cerr << "cuvslam_client: " << e.what() << "\n";
    return 1;
  }
  return 0;
}
