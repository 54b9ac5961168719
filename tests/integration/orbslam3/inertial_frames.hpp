// SPDX-License-Identifier: Apache-2.0
/// @file Problems of poses with an IMU as frames, keyframes and integrals of the stand-in types.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cstddef>
#include <cstring>
#include <memory>
#include <stdexcept>
#include <utility>
#include <vector>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/inertial.hpp"
#include "ft/kernels/pyramid/build_pyramid.hpp"
#include "integration/orbslam3/inertial_poses.hpp"
#include "integration/orbslam3/options.hpp"
#include "tests/integration/orbslam3/constructors.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/support/inertial_poses.hpp"

namespace orbslam3_test {

/// Where the problems of a batch come from.
struct inertial_setup {
  ft::orbslam3::settings settings;
  ft::imu_mount mount{};
  float gyro_walk = 1.9e-12f;  ///< variance that each step adds
};

template <int Rows, int Columns, typename T>
Eigen::Matrix<T, Rows, Columns> matrix_of(T const* rows) {
  return Eigen::Map<Eigen::Matrix<T, Rows, Columns, Eigen::RowMajor> const>(rows);
}
inline Eigen::Vector3f vector_of(ft::vec3<float> v) { return {v.x, v.y, v.z}; }
inline Eigen::Vector3d vector_of(ft::vec3<double> v) { return {v.x, v.y, v.z}; }
inline stand_in::se3 pose_of(ft::rigid<float> const& T) {
  return {matrix_of<3, 3>(T.R.m), vector_of(T.t)};
}
inline stand_in::se3 pose_of(ft::stored_inertial_state const& s) {
  return {Eigen::Quaternionf(s.q_cw.w, s.q_cw.x, s.q_cw.y, s.q_cw.z), vector_of(s.t_cw)};
}
inline stand_in::bias bias_of(ft::imu_bias const& b) {
  return {b.accel.x, b.accel.y, b.accel.z, b.gyro.x, b.gyro.y, b.gyro.z};
}
inline ft::stored_inertial_state stored_state_of(stand_in::frame& f) {
  return ft::orbslam3::state_of(f);
}

inline stand_in::preintegrated integral_of(ft::preintegrated const& from, float gyro_walk) {
  stand_in::preintegrated to;
  to.dT = from.dT;
  to.dR = matrix_of<3, 3>(from.dR.m);
  to.dV = vector_of(from.dV);
  to.dP = vector_of(from.dP);
  to.JRg = matrix_of<3, 3>(from.JRg.m);
  to.JVg = matrix_of<3, 3>(from.JVg.m);
  to.JVa = matrix_of<3, 3>(from.JVa.m);
  to.JPg = matrix_of<3, 3>(from.JPg.m);
  to.JPa = matrix_of<3, 3>(from.JPa.m);
  to.C.topLeftCorner<9, 9>() = matrix_of<9, 9>(from.C);
  for (int i = 0; i < 6; ++i) { to.C(9 + i, 9 + i) = from.walk[i]; }
  to.NgaWalk.diagonal().setConstant(gyro_walk);
  to.b = bias_of(from.bias);
  to.avgA = vector_of(from.mean_accel);
  to.avgW = vector_of(from.mean_gyro);
  return to;
}
inline stand_in::pose_constraint* constraint_of(ft::inertial_prior const& from) {
  if (from.known == 0) { return nullptr; }
  auto const H = matrix_of<15, 15>(from.information);
  auto const& s = from.state;
  auto* const to = new stand_in::pose_constraint(
      matrix_of<3, 3>(s.R.m), vector_of(s.p), vector_of(s.v), vector_of(s.bg), vector_of(s.ba), H);
  to->H = H;
  return to;
}

/// The octave of a weight. @throws std::runtime_error if it is none
inline int octave_of(ft::pyramid_geometry const& g, int levels, float inv_sigma2) {
  float const* const found = std::find(g.inv_sigma2, g.inv_sigma2 + levels, inv_sigma2);
  if (found == g.inv_sigma2 + levels) { throw std::runtime_error("a weight of no octave"); }
  return static_cast<int>(found - g.inv_sigma2);
}

/// A frame with all that it points to.
class inertial_moment {
public:
  stand_in::frame last, current;
  stand_in::key_frame keyframe;
  stand_in::preintegrated since_last, since_keyframe;
  std::vector<std::unique_ptr<stand_in::map_point>> map;

  /// Problem i of a batch, whose observations are ordered by camera.
  inertial_moment(inertial_setup const& setup, test::inertial_pose_batch const& b, std::size_t i,
                  unsigned long id = 20)
      : since_last(integral_of(b.integral[i], setup.gyro_walk)),
        since_keyframe(integral_of(b.since_keyframe[i], setup.gyro_walk)) {
    bool const from_last = b.from_last_frame[i] != 0;
    last.mnId = id - 1;
    current.mnId = id;
    set_state(last, b.first[i]);
    set_state(current, b.start[i]);
    keyframe.T_cw = pose_of(b.first[i]);
    keyframe.velocity = vector_of(b.first[i].v);
    keyframe.imu_bias = bias_of(b.first[i].bias);
    for (auto* const f : {&last, &current}) {
      f->mImuCalib.mTbc = pose_of(setup.mount.T_bc);
      f->mImuCalib.mTcb = pose_of(setup.mount.T_cb);
    }
    if (from_last) { last.mpcpi = constraint_of(b.prior[i]); }
    current.mpPrevFrame = &last;
    current.mpLastKeyFrame = &keyframe;
    current.mpImuPreintegratedFrame = &since_last;
    current.mpImuPreintegrated = from_last ? &since_keyframe : &since_last;
    observe(setup.settings, b.observations[i], b.distance[i]);
  }
  inertial_moment(inertial_moment const&) = delete;
  inertial_moment& operator=(inertial_moment const&) = delete;
  ~inertial_moment() {
    delete last.mpcpi;
    delete current.mpcpi;
  }

  static void set_state(stand_in::frame& f, ft::stored_inertial_state const& s) {
    f.SetPose(pose_of(s));
    f.SetVelocity(vector_of(s.v));
    f.mImuBias = bias_of(s.bias);
  }

private:
  void observe(ft::orbslam3::settings const& s, std::vector<ft::observation> const& seen,
               std::vector<float> const& distance) {
    auto const g = ft::pyramid_geometry::make(s.width, s.height, s.levels, s.scale_factor);
    stand_in::frame& f = current;
    for (std::size_t k = 0; k < seen.size(); ++k) {
      ft::observation const& o = seen[k];
      stand_in::keypoint p;
      p.pt.x = o.u;
      p.pt.y = o.v;
      p.octave = octave_of(g, s.levels, o.inv_sigma2);
      p.angle = static_cast<float>(k % 360);
      (o.camera == 0 ? f.mvKeys : f.mvKeysRight).push_back(p);
      if (o.camera == 0) { f.mvuRight.push_back(o.right_u); }
      auto point = std::make_unique<stand_in::map_point>();
      point->mnId = 10000 * f.mnId + k;
      point->SetWorldPos(vector_of(o.point));
      point->set_descriptor(std::vector<unsigned char>(32).data());
      point->mTrackDepth = distance[k];
      f.mvpMapPoints.push_back(point.get());
      map.push_back(std::move(point));
    }
    f.mvKeysUn = f.mvKeys;
    f.mDescriptors.create(static_cast<int>(f.mvKeys.size()), 32, 0);
    f.mDescriptorsRight.create(static_cast<int>(f.mvKeysRight.size()), 32, 0);
    stand_in::set_no_pair(f);
    f.N = static_cast<int>(seen.size());
    if (s.images == 2 && s.left.kind == ft::orbslam3::lens::kannala_brandt) {
      f.Nleft = static_cast<int>(f.mvKeys.size());
      f.Nright = static_cast<int>(f.mvKeysRight.size());
      f.mvuRight.clear();
    }
    f.mvDepth = f.mvuRight;
    f.mnMaxX = static_cast<float>(s.width);
    f.mnMaxY = static_cast<float>(s.height);
    // Flags of earlier stages count for nothing.
    f.mvbOutlier.assign(seen.size(), true);
  }
};

inline ft::orbslam3::stage stage_of(test::inertial_pose_batch const& b, std::size_t i) {
  using ft::orbslam3::stage;
  return b.from_last_frame[i] != 0 ? stage::pose_inertial_last_frame
                                   : stage::pose_inertial_last_keyframe;
}

}  // namespace orbslam3_test
