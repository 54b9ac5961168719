// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/odometry_input.hpp"

#include <algorithm>

#include "examples/sequence/calibration.hpp"

namespace seq {
namespace {

ft::camera_kind odometry_camera_kind(camera_intrinsics const& c) {
  switch (c.model) {
    case lens::radial_tangential:
      return c.distortion.size() == 4   ? ft::camera_kind::radtan4
             : c.distortion.size() == 5 ? ft::camera_kind::radtan5
                                        : ft::camera_kind::radtan8;
    case lens::kannala_brandt:
      return ft::camera_kind::kannala_brandt;
    case lens::double_sphere:
      return ft::camera_kind::double_sphere;
    default:
      return ft::camera_kind::pinhole;
  }
}

/// @param of the images that are tracked: a pinhole where they were rectified
ft::camera_description odometry_camera(camera_intrinsics const& c) {
  auto camera = ft::camera_description::make(odometry_camera_kind(c), {c.fx, c.fy, c.cx, c.cy});
  std::copy(c.distortion.begin(), c.distortion.end(), camera.parameters + 4);
  camera.readout_s = c.readout_s;
  return camera;
}

ft::rig_description mixed_odometry_rig(sequence const& recording) {
  ft::rig_description all;
  all.kind = ft::rig_kind::multi;
  all.cameras = 0;
  all.depth_scale = recording.depth_unit();
  for (rig_camera const& c : rig_cameras(recording.rig())) {
    ft::camera_description& to = all.camera[all.cameras++];
    to = odometry_camera(c.camera);
    to.right = c.right;
    to.has_depth_image = c.has_depth;
    to.baseline = c.has_depth ? usual_virtual_baseline : 0;
    to.T_camera_body = odometry_pose(c.T_left_this.inverse());
  }
  return all;
}

float to_float(double v) { return static_cast<float>(v); }

}  // namespace

ft::rig_description odometry_rig(sequence const& recording) {
  stereo_rig const& rig = recording.rig();
  if (recording.mixed()) { return mixed_odometry_rig(recording); }
  auto const baseline = static_cast<double>(to_float(rig.baseline()));
  auto const left = odometry_camera(rig.left);
  if (recording.kind() == camera_kind::mono) { return ft::rig_description::monocular(left); }
  if (recording.kind() == camera_kind::rgbd) {
    return ft::rig_description::rgbd(left, baseline, recording.depth_unit());
  }
  if (recording.fisheye()) {
    return ft::rig_description::fisheye_pair(left, odometry_camera(rig.right),
                                             odometry_pose(rig.T_left_right.inverse()));
  }
  auto pair = ft::rig_description::rectified_pair(rig.left.fx, rig.left.fy, rig.left.cx,
                                                  rig.left.cy, baseline);
  pair.camera[0].readout_s = left.readout_s;
  return pair;
}

ft::odometry_params odometry_settings(sequence const& recording, int features) {
  orb_settings const& settings = recording.settings();
  ft::odometry_params p;
  ft::orb_params& orb = p.orb;
  orb.width = recording.rig().left.width;
  orb.height = recording.rig().left.height;
  if (recording.masked()) {
    orb.mask_width = orb.width;
    orb.mask_height = orb.height;
  }
  orb.features =
      features > 0 ? features : settings.features.value_or(orb.width > 1000 ? 2000 : 1200);
  orb.levels = settings.levels.value_or(8);
  orb.scale_factor = to_float(settings.scale_factor.value_or(1.2));
  orb.ini_threshold = settings.ini_threshold.value_or(20);
  orb.min_threshold = settings.min_threshold.value_or(7);
  p.rules.near_depth = to_float(settings.depth_threshold.value_or(50));
  p.map_slots = std::max(p.map_slots, 8 * orb.features);
  if (recording.mixed()) {  // of all cameras
    p.map_slots = std::max(1 << 15, p.map_slots);
    p.local_points = p.window_points = 12288;
  }
  if (recording.imu()) { p.imu = odometry_imu(recording); }
  return p;
}

ft::imu_params odometry_imu(sequence const& recording) {
  imu_recording const& imu = *recording.imu();
  imu_noise const& noise = imu.calibration.noise;
  ft::imu_params p;
  p.present = true;
  p.T_bc = odometry_pose(imu.T_imu_left);
  p.noise = {to_float(noise.gyro), to_float(noise.accel), to_float(noise.gyro_walk),
             to_float(noise.accel_walk), to_float(imu.calibration.rate_hz)};
  p.time_offset_s = imu.calibration.time_offset_s;
  return p;
}

ft::imu_measurement odometry_sample(imu_sample const& sample) {
  auto const narrowed = [](Eigen::Vector3d const& v) {
    return ft::vec3<float>{to_float(v.x()), to_float(v.y()), to_float(v.z())};
  };
  return {sample.time_ns, narrowed(sample.accel), narrowed(sample.gyro)};
}

ft::any_images odometry_images(stereo_frame const& frame) {
  auto const gray = [](image const& i) {
    return i.pixels.empty() ? ft::gray_view{}
                            : ft::gray_view{i.pixels.data(), i.width, i.height, i.width};
  };
  ft::any_images images{{gray(frame.left), gray(frame.right)}, {}};
  std::transform(frame.more.begin(), frame.more.end(), images.gray + 2, gray);
  auto const depth = [](depth_image const& i) -> ft::depth_view {
    if (i.pixels.empty()) { return {}; }
    return ft::image_view<std::uint16_t const>{i.pixels.data(), i.width, i.height, i.width};
  };
  images.depth = depth(frame.depth);
  std::transform(frame.depths.begin(), frame.depths.end(), images.depths, depth);
  return images;
}

void odometry_masks::set(ft::any_odometry& odometry, stereo_frame const& frame) {
  set_.resize(frame.masks.size());
  for (std::size_t c = 0; c < set_.size(); ++c) {
    if (frame.masks[c] == set_[c]) { continue; }
    set_[c] = frame.masks[c];
    ft::orb_params const& orb = odometry.params().orb;
    image all{orb.mask_width, orb.mask_height, {}};
    if (set_[c] == nullptr) {
      all.pixels.assign(static_cast<std::size_t>(all.width) * static_cast<std::size_t>(all.height),
                        255);
    }
    image const& mask = set_[c] != nullptr ? *set_[c] : all;
    odometry.set_mask(0, static_cast<int>(mixed_ ? 2 * c : c),
                      {mask.pixels.data(), mask.width, mask.height, mask.width});
  }
}

ft::rigid<double> odometry_pose(Eigen::Isometry3d const& T) {
  ft::rigid<double> p;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) { p.R.m[3 * r + c] = T.linear()(r, c); }
  }
  p.t = {T.translation().x(), T.translation().y(), T.translation().z()};
  return p;
}

stamped_pose stamped(std::int64_t time_ns, ft::rigid<double> const& T) {
  stamped_pose s;
  s.time_ns = time_ns;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) { s.T_world_camera.linear()(r, c) = T.R.m[3 * r + c]; }
  }
  s.T_world_camera.translation() = Eigen::Vector3d(T.t.x, T.t.y, T.t.z);
  return s;
}

}  // namespace seq
