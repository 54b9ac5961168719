// SPDX-License-Identifier: Apache-2.0
// Poses with an IMU through the shim: the stage's own answers to the bit, frames that are refused,
// and verify.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <functional>
#include <limits>
#include <memory>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "integration/orbslam3/front_end.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/heard.hpp"
#include "tests/integration/orbslam3/inertial_frames.hpp"
#include "tests/integration/orbslam3/inertial_problems.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"

namespace orbslam3_test {

namespace inertial_shim {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;
using front_end = ft::orbslam3::front_end<stand_in::types>;
using verifier = ft::orbslam3::verifier<stand_in::types>;
using ft::orbslam3::difference;
using ft::orbslam3::stage;

class inertial_poses : public on_executor {};

TEST_P(inertial_poses, are_those_of_the_stage_to_the_bit) {
  for (sensor const kind : all_sensors) {
    for (bool const quirks : {true, false}) {
      random_problems const p(kind, quirks);
      accelerator gpu(make(p.setup.settings), p.setup.settings);
      int flagged = 0;
      for (std::size_t i = 0; i < p.batch.size(); ++i) {
        SCOPED_TRACE(std::string(name_of(kind)) + " problem " + std::to_string(i));
        inertial_moment at(p.setup, p.batch, i, 20 + i);
        auto* const before = at.last.mpcpi;
        int const n = gpu.inertial_pose_optimization(at.current, stage_of(p.batch, i));
        expect_answer(p.batch, i, at.current, n);
        flagged += p.batch.count[i] - n;
        // A prior is used once.
        EXPECT_EQ(before == nullptr, stage_of(p.batch, i) == stage::pose_inertial_last_keyframe);
        EXPECT_EQ(at.last.mpcpi, nullptr);
        gpu.reset();
      }
      EXPECT_GT(flagged, 20);
    }
  }
}

TEST_P(inertial_poses, from_a_keyframe_leave_the_last_frames_prior_alone) {
  random_problems const p(sensor::stereo);
  accelerator gpu(make(p.setup.settings), p.setup.settings);
  inertial_moment at(p.setup, p.batch, 4);
  auto* const prior = at.last.mpcpi = constraint_of(p.batch.prior[4]);
  gpu.inertial_pose_optimization(at.current, stage::pose_inertial_last_keyframe);
  EXPECT_EQ(at.last.mpcpi, prior);
  EXPECT_NE(at.current.mpcpi, prior);
}

/// Keypoints without a point, points that mapping moves, other mounts: nothing stays from the call
/// before.
TEST_P(inertial_poses, follow_what_changes_between_calls) {
  random_problems p(sensor::fisheye_stereo);
  accelerator gpu(make(p.setup.settings), p.setup.settings);
  std::size_t const i = 7;
  inertial_moment at(p.setup, p.batch, i);
  auto const repeat = [&] {
    at.set_state(at.current, p.batch.start[i]);
    delete std::exchange(at.current.mpcpi, nullptr);
    delete std::exchange(at.last.mpcpi, constraint_of(p.batch.prior[i]));
    int const n = gpu.inertial_pose_optimization(at.current, stage_of(p.batch, i));
    p.batch.result.clear();
    optimize_directly(p.setup, p.batch);
    expect_answer(p.batch, i, at.current, n);
  };
  repeat();
  for (std::size_t k = 0; k < 60; ++k) {
    p.batch.observations[i][k].point.x += 0.01f;
    at.map[k]->SetWorldPos(vector_of(p.batch.observations[i][k].point));
    p.batch.distance[i][k] = at.map[k]->mTrackDepth = k % 2 == 0 ? 5.0f : 15.0f;
  }
  repeat();
  p.setup.mount.T_cb.t.x += 0.02f;
  auto const T_bc = p.setup.mount.T_cb.inverse();
  p.setup.mount.T_bc = T_bc;
  at.current.mImuCalib.mTcb = pose_of(p.setup.mount.T_cb);
  at.current.mImuCalib.mTbc = pose_of(p.setup.mount.T_bc);
  repeat();
  // A keypoint loses its point, and its flag is nobody's.
  for (int const gone : {200, 3}) {
    auto const k = static_cast<std::size_t>(gone);
    at.current.mvpMapPoints[k] = nullptr;
    at.current.mvbOutlier[k] = true;
  }
  auto fewer = p.batch;
  for (auto const gone : {200, 3}) {
    fewer.observations[i].erase(fewer.observations[i].begin() + gone);
    fewer.distance[i].erase(fewer.distance[i].begin() + gone);
  }
  fewer.count[i] -= 2;
  optimize_directly(p.setup, fewer);
  at.set_state(at.current, p.batch.start[i]);
  delete std::exchange(at.current.mpcpi, nullptr);
  at.last.mpcpi = constraint_of(p.batch.prior[i]);
  EXPECT_EQ(gpu.inertial_pose_optimization(at.current, stage_of(p.batch, i)),
            fewer.result[i].tracked);
  auto const state = stored_state_of(at.current);
  EXPECT_EQ(std::memcmp(&state, &fewer.result[i].stored, sizeof state), 0);
  EXPECT_TRUE(at.current.mvbOutlier[3]);
  EXPECT_TRUE(at.current.mvbOutlier[200]);
}

// ---- frames that are refused --------------------------------------------------------------------

TEST_P(inertial_poses, that_lack_what_they_start_from_are_the_cpus) {
  static constexpr float nan = std::numeric_limits<float>::quiet_NaN();
  using change = std::function<void(inertial_moment&)>;
  change const of_last_frame[] = {
      [](inertial_moment& m) { m.current.mpPrevFrame = nullptr; },
      [](inertial_moment& m) { delete std::exchange(m.last.mpcpi, nullptr); },
      [](inertial_moment& m) { m.current.mpImuPreintegratedFrame = nullptr; },
      [](inertial_moment& m) { m.current.mpImuPreintegrated = nullptr; },
      [](inertial_moment& m) { m.since_last.C.setZero(); },  // no steps
      [](inertial_moment& m) { m.since_keyframe.C.setZero(); },
      [](inertial_moment& m) { m.since_last.NgaWalk.diagonal().setZero(); },
      [](inertial_moment& m) { m.since_last.dP.x() = nan; },
      [](inertial_moment& m) {
        m.current.SetVelocity({0, nan, 0});
      },
      [](inertial_moment& m) { m.last.mpcpi->H(4, 4) = static_cast<double>(nan); },
  };
  change const of_keyframe[] = {
      [](inertial_moment& m) { m.current.mpLastKeyFrame = nullptr; },
      [](inertial_moment& m) { m.current.mpImuPreintegrated = nullptr; },
      [](inertial_moment& m) { m.since_last.C(9, 9) = nan; },
      [](inertial_moment& m) { m.keyframe.imu_bias.bwy = nan; },
  };
  random_problems const p(sensor::stereo);
  heard said;
  front_end gpu(make(p.setup.settings), p.setup.settings, {});
  auto const refused = [&](std::size_t i, change const& spoil) {
    inertial_moment at(p.setup, p.batch, i);
    spoil(at);
    auto const before = stored_state_of(at.current);
    auto const flags = at.current.mvbOutlier;
    int calls = 0;
    EXPECT_EQ(gpu.inertial_pose_optimization(at.current, stage_of(p.batch, i),
                                             [&] {
                                               auto const now = stored_state_of(at.current);
                                               EXPECT_EQ(std::memcmp(&now, &before, sizeof now), 0);
                                               EXPECT_EQ(at.current.mvbOutlier, flags);
                                               EXPECT_EQ(at.current.mpcpi, nullptr);
                                               ++calls;
                                               return 123;
                                             }),
              123);
    EXPECT_EQ(calls, 1);
  };
  for (auto const& spoil : of_last_frame) { refused(7, spoil); }
  for (auto const& spoil : of_keyframe) { refused(6, spoil); }
  // The accelerator goes on.
  for (std::size_t const i : {6u, 7u}) {
    inertial_moment at(p.setup, p.batch, i, 30 + i);
    auto const never = []() -> int { throw std::runtime_error("the CPU was asked"); };
    int const n = gpu.inertial_pose_optimization(at.current, stage_of(p.batch, i), never);
    expect_answer(p.batch, i, at.current, n);
  }
  EXPECT_EQ(said.lines(), 0) << said.text();
}

TEST_P(inertial_poses, without_the_references_slip_need_no_integral_since_the_keyframe) {
  random_problems const p(sensor::stereo, false);
  accelerator gpu(make(p.setup.settings), p.setup.settings);
  inertial_moment at(p.setup, p.batch, 7);
  at.current.mpImuPreintegrated = nullptr;
  int const n = gpu.inertial_pose_optimization(at.current, stage::pose_inertial_last_frame);
  expect_answer(p.batch, 7, at.current, n);
}

TEST_P(inertial_poses, are_the_cpus_by_option_and_are_never_bypassed) {
  random_problems const p(sensor::stereo);
  ft::orbslam3::options o;
  ft::orbslam3::set_modes(o, "pose_inertial_last_frame", ft::orbslam3::stage_mode::host);
  front_end gpu(make(p.setup.settings), p.setup.settings, o);
  inertial_moment at(p.setup, p.batch, 7);
  EXPECT_EQ(
      gpu.inertial_pose_optimization(at.current, stage::pose_inertial_last_frame, [] { return 5; }),
      5);
  EXPECT_TRUE(gpu.uses(stage::pose_inertial_last_keyframe));
  for (auto const s : {stage::pose_inertial_last_frame, stage::pose_inertial_last_keyframe}) {
    EXPECT_THROW(
        ft::orbslam3::set_modes(o, ft::orbslam3::name_of(s), ft::orbslam3::stage_mode::bypass),
        ft::bad_argument);
  }
}

// ---- verify -------------------------------------------------------------------------------------

class inertial_verify : public on_executor {
protected:
  /// Runs problem i with verify; the CPU is another accelerator, whose answer `plant` changes.
  /// @return what differed
  static std::vector<std::string> verified(random_problems const& p, std::size_t i,
                                           std::function<int(stand_in::frame&)> const& plant) {
    auto const& s = p.setup.settings;
    accelerator gpu(make(s), s);
    accelerator cpu(make(s), s);
    std::vector<std::string> found;
    verifier both(gpu, [&](difference const& d) { found.emplace_back(d.what); });
    inertial_moment at(p.setup, p.batch, i);
    int calls = 0;
    int const n = both.inertial_pose_optimization(at.current, stage_of(p.batch, i), [&] {
      ++calls;
      return cpu.inertial_pose_optimization(at.current, stage_of(p.batch, i)) + plant(at.current);
    });
    EXPECT_EQ(calls, found.empty() ? 2 : 4);
    expect_answer(p.batch, i, at.current, n);
    EXPECT_EQ(at.last.mpcpi, nullptr);
    EXPECT_EQ(both.differences(), static_cast<long>(found.size()));
    return found;
  }
};

TEST_P(inertial_verify, finds_nothing_where_the_cpu_has_the_same_answer) {
  for (sensor const kind : all_sensors) {
    random_problems const p(kind);
    for (std::size_t i = 0; i < p.batch.size(); ++i) {
      SCOPED_TRACE(std::string(name_of(kind)) + " problem " + std::to_string(i));
      EXPECT_EQ(verified(p, i, [](stand_in::frame&) { return 0; }), std::vector<std::string>{});
    }
  }
}

TEST_P(inertial_verify, finds_each_difference_and_keeps_the_accelerators_answer) {
  random_problems const p(sensor::stereo);
  auto const only = [&](char const* what, std::function<int(stand_in::frame&)> const& plant) {
    for (std::size_t const i : {6u, 7u}) {
      EXPECT_EQ(verified(p, i, plant), std::vector<std::string>{what});
    }
  };
  only("observations without outliers", [](stand_in::frame&) { return 1; });
  only("outlier", [](stand_in::frame& f) {
    f.mvbOutlier[8] = !f.mvbOutlier[8];
    return 0;
  });
  only("translation entry", [](stand_in::frame& f) {
    Eigen::Vector3f const t = f.GetPose().translation() + Eigen::Vector3f(0, 0, 6e-6f);
    f.SetPose({f.GetPose().unit_quaternion(), t});
    return 0;
  });
  only("velocity entry", [](stand_in::frame& f) {
    f.SetVelocity(f.GetVelocity() + Eigen::Vector3f(0, 2e-5f, 0));
    return 0;
  });
  only("gyro bias entry", [](stand_in::frame& f) {
    f.mImuBias.bwz += 3e-8f;
    return 0;
  });
  only("accelerometer bias entry", [](stand_in::frame& f) {
    f.mImuBias.bax += 5e-6f;
    return 0;
  });
  only("information entry", [](stand_in::frame& f) {
    f.mpcpi->H(2, 2) *= 1.00001;
    return 0;
  });
  only("prior for the next frame", [](stand_in::frame& f) {
    delete std::exchange(f.mpcpi, nullptr);
    return 0;
  });
  // Nothing else than the rotation: two entries of it at least.
  auto const turned = verified(p, 7, [](stand_in::frame& f) {
    Eigen::Quaternionf const q(Eigen::AngleAxisf(1e-5f, Eigen::Vector3f::UnitX()));
    f.SetPose({(q * f.GetPose().unit_quaternion()).normalized(), f.GetPose().translation()});
    return 0;
  });
  EXPECT_GE(turned.size(), 2u);
  for (auto const& what : turned) { EXPECT_EQ(what, "rotation entry"); }
}

TEST_P(inertial_verify, leaves_roundings_within_the_tolerances) {
  random_problems const p(sensor::stereo);
  EXPECT_EQ(verified(p, 7,
                     [](stand_in::frame& f) {
                       f.SetVelocity(f.GetVelocity() + Eigen::Vector3f(0, 5e-6f, 0));
                       f.mImuBias.bwz += 5e-9f;
                       f.mpcpi->H(2, 2) *= 1.000001;
                       return 0;
                     }),
            std::vector<std::string>{});
}

/// A number that is not finite, which the CPU's code takes.
TEST_P(inertial_verify, keeps_the_cpus_answer_where_the_accelerator_refuses) {
  random_problems const p(sensor::stereo);
  for (bool const verify : {true, false}) {
    heard said;
    ft::orbslam3::options o;
    o.verify = verify;
    front_end gpu(make(p.setup.settings), p.setup.settings, o);
    inertial_moment at(p.setup, p.batch, 7);
    at.last.mpcpi->H(3, 3) = std::numeric_limits<double>::infinity();
    int const n = gpu.inertial_pose_optimization(at.current, stage::pose_inertial_last_frame, [&] {
      at.current.SetVelocity({1, 2, 3});
      delete std::exchange(at.last.mpcpi, nullptr);
      at.current.mpcpi = constraint_of(p.batch.prior[7]);
      return 44;
    });
    EXPECT_EQ(n, 44);
    EXPECT_EQ(at.current.GetVelocity(), Eigen::Vector3f(1, 2, 3));
    EXPECT_EQ(at.last.mpcpi, nullptr);
    EXPECT_NE(at.current.mpcpi, nullptr);
    std::ostringstream text;
    gpu.print(text);
    EXPECT_EQ(verify, text.str().find("pose_inertial_last_frame: 1 calls, 0 with differences, "
                                      "0 in all, 1 refused") != std::string::npos)
        << text.str();
  }
}

INSTANTIATE_TEST_SUITE_P(executors, inertial_poses, ::testing::ValuesIn(executors()),
                         executor_name);
INSTANTIATE_TEST_SUITE_P(executors, inertial_verify, ::testing::ValuesIn(executors()),
                         executor_name);

}  // namespace inertial_shim

}  // namespace orbslam3_test
