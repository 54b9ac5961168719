// SPDX-License-Identifier: Apache-2.0
/// @file Poses and trajectories of the sequence tools as arrays, and back.
#pragma once

#include <Eigen/Dense>
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "examples/sequence/types.hpp"
#include "python/src/arrays.hpp"

namespace ftpy {

inline pose plain(Eigen::Isometry3d const& T) {
  pose m{};
  for (int r = 0; r < 4; ++r) {
    for (int c = 0; c < 4; ++c) { m[static_cast<std::size_t>(4 * r + c)] = T.matrix()(r, c); }
  }
  return m;
}

/// Times (n) and poses (n, 4, 4).
inline nb::tuple arrays_of(seq::trajectory const& t) {
  std::vector<std::int64_t> time;
  std::vector<double> T;
  for (auto const& p : t) {
    time.push_back(p.time_ns);
    pose const m = plain(p.T_world_camera);
    T.insert(T.end(), m.begin(), m.end());
  }
  std::size_t const n = time.size();
  return nb::make_tuple(to_numpy(std::move(time)), to_numpy(std::move(T), {n, 4, 4}));
}

/// Whether T has a rotation, be it of single precision.
inline bool is_rigid(Eigen::Isometry3d const& T) {
  Eigen::Matrix3d const R = T.linear();
  return (R.transpose() * R - Eigen::Matrix3d::Identity()).norm() < 1e-3 && R.determinant() > 0;
}

inline seq::trajectory trajectory_of(nb::handle time_ns, nb::handle poses,
                                     std::string const& name) {
  arrays kept;
  std::vector<std::int64_t> const time = times(time_ns, name + ": time_ns");
  double const* m = kept.doubles(poses, name, {time.size(), 4, 4});
  seq::trajectory t;
  for (std::size_t i = 0; i < time.size(); ++i, m += 16) {
    if (i > 0 && time[i] <= time[i - 1]) {
      throw argument_error(name + ": times must ascend, number " + std::to_string(i) + " is " +
                           std::to_string(time[i]) + " after " + std::to_string(time[i - 1]));
    }
    seq::stamped_pose p;
    p.time_ns = time[i];
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 4; ++c) { p.T_world_camera.matrix()(r, c) = m[4 * r + c]; }
    }
    bool const last_row = m[12] == 0 && m[13] == 0 && m[14] == 0 && m[15] == 1;
    if (!last_row || !p.T_world_camera.matrix().allFinite() || !is_rigid(p.T_world_camera)) {
      throw argument_error(name + ": pose " + std::to_string(i) +
                           " is no rigid motion: a rotation, a finite translation, and 0 0 0 1");
    }
    t.push_back(p);
  }
  return t;
}

}  // namespace ftpy
