// SPDX-License-Identifier: Apache-2.0
/// @file Tracks a sequence with cuVSLAM's odometry, on the frames that ft gets: a camera pair, one
/// camera, or one with depth images. See README.md here.
#include "bench/peers/at_rate.hpp"
#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/reader.hpp"

#include <cuvslam2.h>

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <fstream>
#include <iostream>
#include <optional>
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
  rig.cameras = {to_camera(pair.left, Eigen::Isometry3d::Identity())};
  if (sequence.kind() == seq::camera_kind::stereo) {
    rig.cameras.push_back(to_camera(pair.right, pair.T_left_right));
  }
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

cuvslam::Odometry::Config config_of(seq::sequence const& sequence, bool asynchronous) {
  cuvslam::Odometry::Config config = cuvslam::Odometry::GetDefaultConfig();
  config.async_sba = asynchronous;
  using mode = cuvslam::Odometry::OdometryMode;
  if (sequence.kind() == seq::camera_kind::mono) {
    config.odometry_mode = mode::Mono;
  } else if (sequence.kind() == seq::camera_kind::rgbd) {
    config.odometry_mode = mode::RGBD;
    config.rgbd_settings.depth_camera_id = 0;
    config.rgbd_settings.depth_scale_factor = static_cast<float>(1 / sequence.depth_unit());
  } else {
    config.rectified_stereo_camera = sequence.rig().rectified();
    config.odometry_mode = sequence.imu() ? mode::Inertial : mode::Multicamera;
  }
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

cuvslam::Image to_image(seq::depth_image const& depth, std::int64_t time_ns) {
  cuvslam::Image out{};
  out.pixels = depth.pixels.data();
  out.width = depth.width;
  out.height = depth.height;
  out.pitch = depth.width * 2;
  out.encoding = cuvslam::ImageData::Encoding::MONO;
  out.data_type = cuvslam::ImageData::DataType::UINT16;
  out.timestamp_ns = time_ns;
  return out;
}

/// Tracks one frame after the other, with the samples of the IMU up to each one.
class client {
public:
  client(seq::sequence const& sequence, bool asynchronous)
      : sequence_(sequence), odometry_(rig_of(sequence), config_of(sequence, asynchronous)) {}

  seq::trajectory track_all() {
    seq::trajectory poses;
    for (int i = 0; i < sequence_.size(); ++i) {
      seq::stereo_frame const frame = sequence_.load(i);
      add_imu(frame.time_ns);
      auto const begin = std::chrono::steady_clock::now();
      auto const found = track(frame, frame.time_ns);
      std::chrono::duration<double, std::milli> const took =
          std::chrono::steady_clock::now() - begin;
      ms_.push_back(took.count());
      if (found.world_from_rig) {
        poses.push_back({frame.time_ns, from_pose(found.world_from_rig->pose)});
      }
    }
    return poses;
  }
  cuvslam::PoseEstimate track(seq::stereo_frame const& frame, std::int64_t time_ns) {
    cuvslam::Odometry::ImageSet images{to_image(frame.left, time_ns, 0)};
    cuvslam::Odometry::ImageSet depths;
    if (sequence_.kind() == seq::camera_kind::stereo) {
      images.push_back(to_image(frame.right, time_ns, 1));
    } else if (sequence_.kind() == seq::camera_kind::rgbd) {
      depths.push_back(to_image(frame.depth, time_ns));
    }
    return odometry_.Track(images, {}, depths);
  }
  std::vector<double> const& ms() const { return ms_; }

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
  std::vector<double> ms_;
};

struct arguments {
  std::string folder, trajectory, json;
  seq::open_options open;
  bool asynchronous = false;
  double hz = 0, seconds = 20;  ///< of run_at_rate(); 0 = one frame after the other
};

std::optional<arguments> read_arguments(std::vector<std::string> const& words) {
  if (words.size() < 2) { return {}; }
  arguments out;
  out.folder = words[0];
  out.trajectory = words[1];
  out.open.rig = seq::camera_kind::stereo;
  for (std::size_t i = 2; i < words.size(); ++i) {
    if (words[i] == "--imu") {
      out.open.read_imu = true;
      continue;
    }
    if (words[i] == "--async") {
      out.asynchronous = true;
      continue;
    }
    if (i + 1 == words.size()) { return {}; }
    std::string const& option = words[i];
    std::string const& value = words[++i];
    if (option == "--rig" && value == "mono") {
      out.open.rig = seq::camera_kind::mono;
    } else if (option == "--rig" && value == "rgbd") {
      out.open.rig = seq::camera_kind::rgbd;
    } else if (option == "--json") {
      out.json = value;
    } else if (option == "--hz") {
      out.hz = std::stod(value);
    } else if (option == "--seconds") {
      out.seconds = std::stod(value);
    } else if (option != "--rig" || value != "stereo") {
      return {};
    }
  }
  bool const pair = out.open.rig == seq::camera_kind::stereo;
  if (out.open.read_imu && !pair) { return {}; }
  return out;
}

/// ATE after rigid alignment; of one camera with its scale fitted first.
std::optional<double> ate_of(seq::sequence const& sequence, seq::trajectory poses) {
  seq::trajectory const& truth = sequence.ground_truth();
  if (sequence.kind() == seq::camera_kind::mono) {
    auto const scale = seq::scale_to(poses, truth);
    if (!scale) { return {}; }
    poses = seq::scaled(poses, *scale);
  }
  return seq::evaluate(poses, truth, sequence.ground_truth_has_orientation()).ate_rmse_m;
}

/// One line of JSON.
void write_json(std::ostream& out, std::optional<double> ate, seq::trajectory const& poses,
                std::vector<double> const& ms) {
  out << "{\"frames\": " << ms.size() << ", \"lost\": " << ms.size() - poses.size()
      << ", \"ms_p50\": " << peers::percentile(ms, 50)
      << ", \"ms_p99\": " << peers::percentile(ms, 99) << ", \"ate_m\": ";
  if (ate) {
    out << *ate;
  } else {
    out << "null";
  }
  out << "}\n";
}

}  // namespace

int main(int argc, char** argv) {
  try {
    auto const asked = read_arguments({argv + 1, argv + argc});
    if (!asked) {
      std::cerr << "usage: cuvslam_client FOLDER TRAJECTORY.txt [--rig stereo|mono|rgbd] [--imu]"
                   " [--async] [--json FILE] [--hz RATE [--seconds S]]\n";
      return 2;
    }
    auto const sequence = seq::sequence::open(asked->folder, asked->open);
    if (asked->open.read_imu && !sequence.imu()) {
      throw seq::error(asked->folder + ": has no IMU");
    }
    if (sequence.size() == 0) { throw seq::error(asked->folder + ": has no frames"); }
    cuvslam::WarmUpGPU();
    client tracker(sequence, asked->asynchronous);
    if (asked->hz > 0) {
      int lost = 0;
      peers::run_at_rate(sequence, asked->hz, asked->seconds,
                         [&](seq::stereo_frame const& frame, std::int64_t time_ns) {
                           lost += tracker.track(frame, time_ns).world_from_rig ? 0 : 1;
                         });
      if (lost > 0) { std::cerr << lost << " frames lost\n"; }
      return 0;
    }
    seq::trajectory const poses = tracker.track_all();
    seq::write_tum(asked->trajectory, poses);
    auto const ate = ate_of(sequence, poses);
    write_json(std::cout, ate, poses, tracker.ms());
    if (!asked->json.empty()) {
      std::ofstream file(asked->json);
      write_json(file, ate, poses, tracker.ms());
      if (!file.flush()) { throw seq::error(asked->json + ": cannot be written"); }
    }
  } catch (std::exception const& e) {
    std::cerr << "cuvslam_client: " << e.what() << "\n";
    return 1;
  }
  return 0;
}
