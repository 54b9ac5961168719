// SPDX-License-Identifier: Apache-2.0
/// @file Random problems of poses with an IMU for every kind of sensor, and the stage's own
/// answers.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <utility>
#include <vector>

#include "ft/core/execution.hpp"
#include "ft/kernels/inertial/optimize_inertial_pose.hpp"
#include "ft/kernels/pyramid/build_pyramid.hpp"
#include "integration/orbslam3/inertial_poses.hpp"
#include "integration/orbslam3/rigs.hpp"
#include "tests/integration/orbslam3/inertial_frames.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/support/inertial_scene.hpp"

namespace orbslam3_test {

/// The stage itself, on the host.
inline void optimize_directly(inertial_setup const& setup, test::inertial_pose_batch& b) {
  ft::inertial_pose_params params;
  params.reference_quirks = setup.settings.reference_quirks;
  auto const run = [&](auto const& rig) {
    test::optimize(ft::host_exec(1), rig, setup.mount, params, b);
  };
  if (setup.settings.left.kind == ft::orbslam3::lens::pinhole) {
    run(ft::orbslam3::rig_of<ft::rectified_rig>(setup.settings));
  } else {
    run(ft::orbslam3::rig_of<ft::orbslam3::fisheye_rig>(setup.settings));
  }
}

/// Orders observations as keypoints are, with weights of octaves.
inline void as_keypoints(inertial_setup const& setup, test::inertial_pose_batch& b) {
  auto const& s = setup.settings;
  auto const g = ft::pyramid_geometry::make(s.width, s.height, s.levels, s.scale_factor);
  for (std::size_t i = 0; i < b.size(); ++i) {
    std::vector<std::pair<ft::observation, float>> all;
    for (std::size_t k = 0; k < b.observations[i].size(); ++k) {
      all.emplace_back(b.observations[i][k], b.distance[i][k]);
    }
    std::stable_partition(all.begin(), all.end(),
                          [](auto const& o) { return o.first.camera == 0; });
    for (std::size_t k = 0; k < all.size(); ++k) {
      ft::observation& o = all[k].first;
      o.inv_sigma2 =
          *std::min_element(g.inv_sigma2, g.inv_sigma2 + s.levels, [&](float x, float y) {
            return std::abs(x - o.inv_sigma2) < std::abs(y - o.inv_sigma2);
          });
      if (s.bf == 0) { o.right_u = -1; }
      b.observations[i][k] = o;
      b.distance[i][k] = all[k].second;
    }
  }
}

template <typename Rig>
void add_problems(inertial_setup& setup, test::inertial_pose_batch& b, unsigned seed) {
  test::inertial_scene<Rig> scene(seed);
  setup.mount = scene.mount;
  int const counts[] = {0, 6, 40, 250};
  for (int i = 0; i < 8; ++i) {
    test::inertial_shape shape;
    shape.observations = counts[i / 2];
    shape.from_last_frame = i % 2 == 1;
    shape.pixel_noise = 0.7;
    shape.outliers_percent = 15;
    scene.add(b, shape);
    // Since the keyframe the walk is another one: three times as long.
    if (!shape.from_last_frame) { continue; }
    for (float& w : b.since_keyframe.back().walk) { w *= 3; }
    b.since_keyframe.back().steps *= 3;
  }
}

/// Problems of one kind of sensor, and their answers by the stage itself.
struct random_problems {
  inertial_setup setup;
  test::inertial_pose_batch batch;

  explicit random_problems(sensor kind, bool quirks = true, unsigned seed = 4) {
    auto& s = setup.settings;
    s.width = 752;
    s.height = 480;
    s.features = 500;
    s.most_keypoints = 300;
    s.map_points = 2048;
    s.local_points = 1024;
    s.images = kind == sensor::stereo || kind == sensor::fisheye_stereo ? 2 : 1;
    s.reference_quirks = quirks;
    using ft::orbslam3::lens;
    if (kind == sensor::fisheye_stereo || kind == sensor::fisheye_monocular) {
      auto const rig = test::inertial_rig<test::inertial_fisheye_rig>();
      s.left.kind = s.right.kind = lens::kannala_brandt;
      std::memcpy(s.left.values, &rig.left, sizeof s.left.values);
      std::memcpy(s.right.values, &rig.right, sizeof s.right.values);
      s.T_rl = rig.T_rl;
      add_problems<test::inertial_fisheye_rig>(setup, batch, seed);
    } else {
      auto const rig = test::inertial_rig<ft::rectified_rig>();
      std::memcpy(s.left.values, &rig.camera, 4 * sizeof(float));
      s.bf = kind == sensor::monocular ? 0.0f : 0.11f * rig.camera.fx;
      add_problems<ft::rectified_rig>(setup, batch, seed);
    }
    as_keypoints(setup, batch);
    if (kind == sensor::fisheye_monocular) { keep_left_camera(); }
    optimize_directly(setup, batch);
  }

private:
  void keep_left_camera() {
    for (std::size_t i = 0; i < batch.size(); ++i) {
      auto& seen = batch.observations[i];
      auto const right = std::find_if(seen.begin(), seen.end(),
                                      [](ft::observation const& o) { return o.camera != 0; });
      seen.erase(right, seen.end());
      batch.distance[i].resize(seen.size());
      batch.count[i] = static_cast<int>(seen.size());
    }
  }
};

/// Expects in a frame what the stage answered to problem i, to the bit.
inline void expect_answer(test::inertial_pose_batch const& b, std::size_t i, stand_in::frame& f,
                          int tracked) {
  ft::inertial_pose_result const& want = b.result[i];
  EXPECT_EQ(tracked, want.tracked);
  auto const state = stored_state_of(f);
  EXPECT_EQ(std::memcmp(&state, &want.stored, sizeof state), 0);
  for (int k = 0; k < b.count[i]; ++k) {
    ASSERT_EQ(f.mvbOutlier[static_cast<std::size_t>(k)], b.outlier[b.at(i, k)] != 0) << k;
  }
  ASSERT_NE(f.mpcpi, nullptr);
  auto const prior = ft::orbslam3::prior_of(*f.mpcpi);
  EXPECT_EQ(std::memcmp(&prior, &b.next_prior[i], offsetof(ft::inertial_prior, known)), 0);
}

}  // namespace orbslam3_test
