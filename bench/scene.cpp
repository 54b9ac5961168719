// SPDX-License-Identifier: Apache-2.0
#include "bench/scene.hpp"

#include <Eigen/Geometry>
#include <cstddef>

#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/generator.hpp"
#include "examples/sequence/parallel.hpp"
#include "examples/sequence/reader.hpp"

namespace bench {

namespace {

plain_pose plain(Eigen::Isometry3d const& T) {
  plain_pose p;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) { p.R[3 * r + c] = static_cast<float>(T.linear()(r, c)); }
    p.t[r] = static_cast<float>(T.translation()(r));
  }
  return p;
}

plain_camera plain(seq::camera_intrinsics const& c) {
  plain_camera p{static_cast<float>(c.fx),
                 static_cast<float>(c.fy),
                 static_cast<float>(c.cx),
                 static_cast<float>(c.cy),
                 {0, 0, 0, 0}};
  for (std::size_t i = 0; i < 4 && i < c.distortion.size(); ++i) {
    p.k[i] = static_cast<float>(c.distortion[i]);
  }
  return p;
}

/// A scene without frames.
scene scene_of(seq::stereo_rig const& rig, int features, int local_points) {
  scene s;
  s.width = rig.left.width;
  s.height = rig.left.height;
  s.left = plain(rig.left);
  s.right = plain(rig.right);
  s.T_rl = plain(rig.T_left_right.inverse());
  s.baseline = static_cast<float>(rig.baseline());
  s.features = features;
  s.local_points = local_points;
  return s;
}

/// @param first frame of the scene
scene_imu imu_of(seq::generator const& g, int first, int images) {
  scene_imu imu;
  auto const& o = g.options();
  imu.T_imu_left = plain(g.rig().T_body_left);
  imu.gyro_noise = static_cast<float>(o.imu.gyro);
  imu.accel_noise = static_cast<float>(o.imu.accel);
  imu.gyro_walk = static_cast<float>(o.imu.gyro_walk);
  imu.accel_walk = static_cast<float>(o.imu.accel_walk);
  imu.rate_hz = static_cast<float>(o.imu_rate);
  std::int64_t const begin = g.time_ns(first);
  for (auto const& from : g.imu()) {
    if (from.time_ns < begin || from.time_ns > g.time_ns(first + images - 1)) { continue; }
    scene_imu_sample to{from.time_ns - begin, {}, {}};
    for (int i = 0; i < 3; ++i) {
      to.accel[i] = static_cast<float>(from.accel[i]);
      to.gyro[i] = static_cast<float>(from.gyro[i]);
    }
    imu.samples.push_back(to);
  }
  return imu;
}

}  // namespace

scene make_scene(rig_type type, int width, int height, int images, int features, int local_points) {
  seq::generator_options options;
  options.rig = type == rig_type::fisheye ? seq::rig_kind::fisheye : seq::rig_kind::pinhole;
  options.width = width;
  options.height = height;
  seq::generator const generator(options);
  auto const& rig = generator.rig();
  scene s = scene_of(rig, features, local_points);
  s.rig = type;
  bool const four = type == rig_type::four_cameras;
  Eigen::Isometry3d T_left_aside = Eigen::Isometry3d::Identity();
  T_left_aside.rotate(Eigen::AngleAxisd(1.2, Eigen::Vector3d::UnitY()));  // to the right
  T_left_aside.translation() = Eigen::Vector3d(0.2, 0, -0.1);
  s.T_al = plain(T_left_aside.inverse());
  s.frames.resize(static_cast<std::size_t>(images));
  constexpr int first = 60;  // in motion
  s.imu = imu_of(generator, first, images);
  seq::parallel_for(images, 0, [&](int k) {
    auto frame = generator.render(first + k);
    auto& f = s.frames[static_cast<std::size_t>(k)];
    f.left = std::move(frame.left.pixels);
    f.right = std::move(frame.right.pixels);
    f.T_cw = plain(generator.T_world_camera(first + k).inverse());
    if (!four) { return; }
    auto aside = generator.render(first + k, T_left_aside);
    f.aside[0] = std::move(aside.left.pixels);
    f.aside[1] = std::move(aside.right.pixels);
  });
  return s;
}

scene read_scene(std::string const& folder, int images, int features, int local_points) {
  seq::open_options options;
  options.keep_fisheye = false;
  options.max_frames = images;
  seq::sequence const sequence = seq::sequence::open(folder, options);
  if (!sequence.ground_truth_has_orientation() || sequence.ground_truth().empty()) {
    throw seq::error(folder + ": no ground truth with orientations, which the bench's map needs");
  }
  scene s = scene_of(sequence.rig(), features, local_points);
  for (int k = 0; k < sequence.size(); ++k) {
    auto const pose = seq::interpolate(sequence.ground_truth(), sequence.time_ns(k));
    if (!pose) { continue; }
    seq::stereo_frame frame = sequence.load(k);
    s.frames.push_back(
        {std::move(frame.left.pixels), std::move(frame.right.pixels), {}, plain(pose->inverse())});
  }
  if (s.frames.size() < 2) {
    throw seq::error(folder + ": fewer than two frames with ground truth");
  }
  return s;
}

}  // namespace bench
