// SPDX-License-Identifier: Apache-2.0
/// @file Batches of poses with an IMU: their inputs and results in the host's memory.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "ft/containers/inertial.hpp"
#include "ft/kernels/inertial/optimize_inertial_pose.hpp"
#include "tests/support/memory.hpp"

namespace test {

/// Inputs and results of a batch of optimisations, in the host's memory.
struct inertial_pose_batch {
  std::vector<int> from_last_frame, count;
  std::vector<ft::stored_inertial_state> first, start;
  std::vector<ft::preintegrated> integral, since_keyframe;
  std::vector<ft::inertial_prior> prior;
  std::vector<std::vector<ft::observation>> observations;
  std::vector<std::vector<float>> distance;
  std::vector<float> moves;  ///< of inertial_poses, keypoint i is observation i; empty: none
  // Results.
  int capacity = 0;
  std::vector<ft::inertial_pose_result> result;
  std::vector<ft::inertial_prior> next_prior;
  std::vector<unsigned char> outlier;  ///< input, too: see inertial_pose_params::outliers_given
  std::vector<float> chi2;

  std::size_t size() const { return count.size(); }
  std::size_t at(std::size_t b, int i) const {
    return b * static_cast<std::size_t>(capacity) + static_cast<std::size_t>(i);
  }
  float chi2_of(std::size_t b, int round, int i) const {
    auto const r = b * ft::inertial_rounds + static_cast<std::size_t>(round);
    return chi2[r * static_cast<std::size_t>(capacity) + static_cast<std::size_t>(i)];
  }
};

/// Optimises a batch on an executor, in one stage or in two: see
/// inertial_pose_params::marginalizes.
template <typename Exec, typename Rig>
void optimize(Exec const& exec, Rig const& rig, ft::imu_mount const& mount,
              ft::inertial_pose_params const& params, inertial_pose_batch& b) {
  for (int const n : b.count) { b.capacity = std::max(b.capacity, n); }
  auto const places = b.size() * static_cast<std::size_t>(b.capacity);
  std::vector<ft::observation> seen(places);
  std::vector<float> distance(places);
  for (std::size_t p = 0; p < b.size(); ++p) {
    std::copy(b.observations[p].begin(), b.observations[p].end(),
              seen.begin() + static_cast<std::ptrdiff_t>(b.at(p, 0)));
    std::copy(b.distance[p].begin(), b.distance[p].end(),
              distance.begin() + static_cast<std::ptrdiff_t>(b.at(p, 0)));
  }
  auto const from = to_exec(exec, b.from_last_frame);
  auto const count = to_exec(exec, b.count);
  auto const first = to_exec(exec, b.first);
  auto const start = to_exec(exec, b.start);
  auto const integral = to_exec(exec, b.integral);
  auto const since = to_exec(exec, b.since_keyframe);
  auto const prior = to_exec(exec, b.prior);
  auto const d_seen = to_exec(exec, seen);
  auto const d_distance = to_exec(exec, distance);
  ft::buffer<ft::inertial_pose_result, Exec::space> result(b.size());
  ft::buffer<ft::inertial_prior, Exec::space> next(b.size());
  if (b.outlier.size() != places) { b.outlier.assign(places, 0); }
  auto const outlier = to_exec(exec, b.outlier);
  auto const chi2 = to_exec(exec, std::vector<float>(ft::inertial_rounds * places));
  std::vector<int> number(places);
  for (std::size_t i = 0; i < places; ++i) {
    number[i] = static_cast<int>(i % static_cast<std::size_t>(b.capacity));
  }
  auto const d_number = to_exec(exec, number);
  auto const moves = to_exec(exec, b.moves);
  ft::inertial_poses const poses{static_cast<int>(b.size()),
                                 b.capacity,
                                 from.data(),
                                 first.data(),
                                 start.data(),
                                 integral.data(),
                                 nullptr,
                                 since.data(),
                                 prior.data(),
                                 d_seen.data(),
                                 d_distance.data(),
                                 count.data(),
                                 result.data(),
                                 next.data(),
                                 outlier.data(),
                                 chi2.data(),
                                 d_number.data(),
                                 b.moves.empty() ? nullptr : moves.data(),
                                 b.capacity};
  ft::optimize_inertial_poses(exec, rig, mount, poses, params);
  if (!params.marginalizes) { ft::marginalize_inertial_poses(exec, rig, mount, poses, params); }
  b.result = from_exec(exec, result.data(), b.size());
  b.next_prior = from_exec(exec, next.data(), b.size());
  b.outlier = from_exec(exec, outlier.data(), places);
  b.chi2 = from_exec(exec, chi2.data(), ft::inertial_rounds * places);
}

}  // namespace test
