// SPDX-License-Identifier: Apache-2.0
// Relocalisation's search for a keyframe's points and its poses by RANSAC through the shim: against
// plain loops, mixed with other calls, and with input that is refused.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <functional>
#include <limits>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "integration/orbslam3/frame_fields.hpp"
#include "integration/orbslam3/front_end.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/heard.hpp"
#include "tests/integration/orbslam3/lost_frame.hpp"
#include "tests/integration/orbslam3/plain_recovery.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/integration/orbslam3/watched_device.hpp"

namespace orbslam3_test {

namespace recovery_shim {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;
using front_end = ft::orbslam3::front_end<stand_in::types>;
using ft::orbslam3::call_refused;
using ft::orbslam3::pnp_progress;
using ft::orbslam3::stage;

class recovery : public on_executor {};

int never() { throw std::runtime_error("the CPU was asked"); }

// ---- the search for a keyframe's points ---------------------------------------------------------

/// In turn for the coarse and the narrow search, from a frame that holds nothing and one that holds
/// points, those found left out.
TEST_P(recovery, searches_a_keyframes_points_as_plain_loops_do) {
  int taken = 0;
  int kept = 0;
  for (sensor const kind : all_sensors) {
    for (unsigned const seed : {3u, 4u}) {
      SCOPED_TRACE(std::string(name_of(kind)) + " seed " + std::to_string(seed));
      lost_frame v(kind, seed);
      plain_keyframe_search const plain(v.settings);
      accelerator gpu(make(v.settings), v.settings);
      auto want = v.frame;
      point_set found;
      for (auto const& [th, farthest] : {std::pair{10.0f, 100}, std::pair{3.0f, 64}}) {
        int const n = plain.run(want, v.keyframe, found, th, farthest);
        EXPECT_EQ(gpu.search_keyframe(v.frame, v.keyframe, found, th, farthest), n);
        ASSERT_EQ(v.frame.mvpMapPoints, want.mvpMapPoints);
        taken += n;
        for (std::size_t i = 0; i < want.mvpMapPoints.size(); ++i) {
          auto*& p = want.mvpMapPoints[i];
          if (i % 3 == 0) { p = nullptr; }
          if (p == nullptr) { continue; }
          ++kept;
          if (i % 2 == 0) { found.insert(p); }
        }
        v.frame.mvpMapPoints = want.mvpMapPoints;
      }
    }
  }
  EXPECT_GT(taken, 1000);
  EXPECT_GT(kept, 300);
}

TEST_P(recovery, search_drops_matches_that_turn_otherwise_only_if_it_is_asked_to) {
  lost_frame v(sensor::stereo);
  auto other = v.settings;
  other.orientation_check = false;
  auto free = v.frame;
  accelerator checks(make(v.settings), v.settings);
  accelerator takes_all(make(other), other);
  int const n = checks.search_keyframe(v.frame, v.keyframe, point_set{}, 10, 100);
  EXPECT_GT(takes_all.search_keyframe(free, v.keyframe, point_set{}, 10, 100), n + 5);
}

/// Mapping moves points and marks them bad; a keyframe with fewer keypoints follows.
TEST_P(recovery, searches_anew_in_every_call) {
  lost_frame v(sensor::stereo);
  plain_keyframe_search const plain(v.settings);
  accelerator gpu(make(v.settings), v.settings);
  auto const expect_plain = [&](stand_in::key_frame& k) {
    auto want = v.frame;
    auto got = v.frame;
    int const n = plain.run(want, k, {}, 10, 100);
    EXPECT_EQ(gpu.search_keyframe(got, k, point_set{}, 10, 100), n);
    EXPECT_EQ(got.mvpMapPoints, want.mvpMapPoints);
    return n;
  };
  int const all = expect_plain(v.keyframe);
  EXPECT_GT(all, 50);
  for (std::size_t i = 0; i < v.world.map.size(); i += 5) {
    auto& p = *v.world.map[i];
    p.SetWorldPos(p.GetWorldPos() + Eigen::Vector3f(0.5f, 0, 0));
    v.world.map[i + 1]->SetBadFlag();
  }
  int const fewer = expect_plain(v.keyframe);
  EXPECT_LT(fewer, all);
  stand_in::key_frame small = v.keyframe;
  small.mvKeys.resize(40);
  small.mvKeysUn.resize(40);
  small.points.resize(40);
  EXPECT_LT(expect_plain(small), fewer);
  EXPECT_EQ(expect_plain(v.keyframe), fewer);
}

/// The keyframe takes the place of the last frame on the device, which is sent again if it is
/// needed.
TEST_P(recovery, search_leaves_other_calls_their_answers) {
  for (sensor const kind : {sensor::stereo, sensor::fisheye_stereo}) {
    SCOPED_TRACE(name_of(kind));
    lost_frame v(kind);
    accelerator alone(make(v.settings), v.settings);
    accelerator mixed(make(v.settings), v.settings);
    auto want = v.world.current;
    int const n = alone.search_by_projection(want, v.world.last, 7, false);
    int const inliers = alone.pose_optimization(want, stage::pose_last_frame);
    auto got = v.world.current;
    mixed.search_keyframe(v.frame, v.keyframe, point_set{}, 10, 100);
    EXPECT_EQ(mixed.search_by_projection(got, v.world.last, 7, false), n);
    auto searched = got;
    EXPECT_GT(mixed.search_keyframe(searched, v.keyframe, point_set{}, 3, 64), 0);
    EXPECT_EQ(mixed.pose_optimization(got, stage::pose_last_frame), inliers);
    EXPECT_EQ(got.mvpMapPoints, want.mvpMapPoints);
    EXPECT_EQ(got.mvbOutlier, want.mvbOutlier);
    EXPECT_EQ(got.GetPose().rotationMatrix(), want.GetPose().rotationMatrix());
    EXPECT_EQ(got.GetPose().translation(), want.GetPose().translation());
  }
}

TEST_P(recovery, search_finds_nothing_from_a_pose_that_is_no_number) {
  lost_frame v(sensor::monocular);
  accelerator gpu(make(v.settings), v.settings);
  v.frame.SetPose({Eigen::Matrix3f::Identity(),
                   Eigen::Vector3f(0, std::numeric_limits<float>::quiet_NaN(), 0)});
  EXPECT_EQ(gpu.search_keyframe(v.frame, v.keyframe, point_set{}, 10, 100), 0);
  EXPECT_EQ(v.held(), 0);
}

TEST_P(recovery, searches_that_do_not_fit_are_the_cpus) {
  lost_frame good(sensor::fisheye_stereo);
  front_end gpu(make(good.settings), good.settings, {});
  struct broken {
    stand_in::frame frame;
    stand_in::key_frame keyframe;
  };
  using change = std::function<void(broken&)>;
  change const spoilt[] = {
      [](broken& v) { v.frame.mDescriptors = {}; },
      [](broken& v) { v.frame.mDescriptors.resize(10); },
      [](broken& v) { v.frame.mvpMapPoints.clear(); },
      [](broken& v) { v.frame.mnMaxX = v.frame.mnMinX; },
      [](broken& v) { v.keyframe.points.pop_back(); },
      [](broken& v) { v.keyframe.mvKeysRight.pop_back(); },
      [](broken& v) {
        v.keyframe.mvKeys.resize(100000);
        v.keyframe.points.resize(100000 + v.keyframe.mvKeysRight.size());
      },
  };
  for (auto const& spoil : spoilt) {
    broken v{good.frame, good.keyframe};
    spoil(v);
    auto const before = v.frame.mvpMapPoints;
    int calls = 0;
    EXPECT_EQ(gpu.search_keyframe(v.frame, v.keyframe, point_set{}, 10, 100,
                                  [&] {
                                    EXPECT_EQ(v.frame.mvpMapPoints, before);
                                    ++calls;
                                    return 321;
                                  }),
              321);
    EXPECT_EQ(calls, 1);
  }
  EXPECT_GT(gpu.search_keyframe(good.frame, good.keyframe, point_set{}, 10, 100, never), 0);
}

// ---- poses by RANSAC ----------------------------------------------------------------------------

TEST_P(recovery, poses_are_near_and_their_inliers_are_counted_by_plain_loops) {
  for (sensor const kind : all_sensors) {
    SCOPED_TRACE(name_of(kind));
    lost_frame v(kind);
    accelerator gpu(make(v.settings), v.settings);
    auto const matches = v.matches();
    pnp_progress progress;
    pose_variables to;
    ASSERT_EQ(gpu.solve_pnp(v.frame, matches, progress, to.answer()), 1);
    EXPECT_GT(progress.done, 0);
    EXPECT_EQ(progress.seed, 0u);
    Eigen::Matrix3f const apart =
        to.T_cw.topLeftCorner<3, 3>() - v.frame.GetPose().rotationMatrix();
    EXPECT_LT(apart.norm(), 0.05f);
    EXPECT_LT((to.T_cw.topRightCorner<3, 1>() - v.frame.GetPose().translation()).norm(), 0.2f);
    ASSERT_EQ(to.inliers.size(), matches.size());
    int given = 0;
    int flagged = 0;
    for (std::size_t i = 0; i < matches.size(); ++i) {
      flagged += static_cast<int>(to.inliers[i]);
      if (matches[i] == nullptr || matches[i]->isBad() || i >= v.left_keys().size()) {
        EXPECT_FALSE(to.inliers[i]) << i;
        continue;
      }
      ++given;
      float const share =
          error_share(v.settings.left, to.T_cw, matches[i]->GetWorldPos(), v.left_keys()[i]);
      if (std::abs(share - 1) < 1e-2f) { continue; }  // another rounding decides
      EXPECT_EQ(to.inliers[i], share < 1) << i;
    }
    EXPECT_EQ(flagged, to.count);
    EXPECT_GT(to.count, std::max(given / 2, 10));
    EXPECT_GT(given, 60);
  }
}

/// Only the caller keeps how far a candidate has come: two candidates in turn, and one alone.
TEST_P(recovery, poses_of_candidates_do_not_depend_on_the_calls_in_between) {
  lost_frame a(sensor::stereo, 3);
  lost_frame b(sensor::stereo, 4);
  accelerator gpu(make(a.settings), a.settings);
  std::vector<stand_in::map_point*> const of_a = a.matches();
  std::vector<stand_in::map_point*> of_b = b.matches();
  for (std::size_t i = 0; i < of_b.size(); i += 9) {
    std::swap(of_b[i], of_b[of_b.size() - 1 - i]);
  }
  auto const calls_of = [&](lost_frame const& v, std::vector<stand_in::map_point*> const& matches,
                            std::function<void()> const& between) {
    std::vector<pose_variables> all(5);
    pnp_progress progress;
    for (auto& to : all) {
      to.found = gpu.solve_pnp(v.frame, matches, progress, to.answer());
      between();
    }
    return all;
  };
  auto const alone = calls_of(b, of_b, [] {});
  pnp_progress other;
  pose_variables ignored;
  auto const mixed =
      calls_of(b, of_b, [&] { gpu.solve_pnp(a.frame, of_a, other, ignored.answer()); });
  int found = 0;
  for (std::size_t k = 0; k < alone.size(); ++k) {
    EXPECT_EQ(alone[k], mixed[k]) << k;
    found += alone[k].found;
  }
  EXPECT_GT(found, 0);
  EXPECT_FALSE(alone[0].T_cw == alone[1].T_cw && alone[0].found == 1) << "it did not go on";
}

TEST_P(recovery, poses_of_another_frame_or_seed_have_other_samples) {
  lost_frame v(sensor::stereo);
  accelerator gpu(make(v.settings), v.settings);
  auto const matches = v.matches();
  auto const pose = [&](unsigned long id, std::uint64_t seed) {
    v.frame.mnId = id;
    pnp_progress progress;
    progress.seed = seed;
    pose_variables to;
    EXPECT_EQ(gpu.solve_pnp(v.frame, matches, progress, to.answer()), 1);
    return to.T_cw;
  };
  EXPECT_EQ(pose(7, 0), pose(7, 0));
  EXPECT_EQ(pose(7, 2), pose(9, 0));
  EXPECT_NE(pose(7, 0), pose(8, 0));
  EXPECT_NE(pose(7, 0), pose(7, 1));
}

TEST_P(recovery, too_few_matches_have_no_pose_and_no_more) {
  lost_frame v(sensor::monocular);
  front_end gpu(make(v.settings), v.settings, {});
  auto const all = v.matches();
  for (int const given : {0, 1, 3, 5, 6, 9}) {
    SCOPED_TRACE(given);
    std::vector<stand_in::map_point*> few(all.size(), nullptr);
    int n = 0;
    for (std::size_t i = 0; i < all.size() && n < given; ++i) {
      if (all[i] == nullptr || all[i]->isBad()) { continue; }
      few[i] = all[i];
      ++n;
    }
    ASSERT_EQ(n, given);
    pnp_progress progress;
    pose_variables to;
    EXPECT_FALSE(gpu.solve_pnp(v.frame, few, progress, to.answer(), never));
    EXPECT_TRUE(to.no_more);
    EXPECT_EQ(to.count, 0);
    EXPECT_EQ(to.inliers, std::vector<bool>(all.size(), false));
  }
  pnp_progress progress;
  pose_variables to;
  EXPECT_FALSE(gpu.solve_pnp(v.frame, {}, progress, to.answer(), never));
  EXPECT_TRUE(to.no_more);
}

TEST_P(recovery, points_and_pixels_that_are_no_numbers_are_no_inliers) {
  lost_frame v(sensor::stereo);
  accelerator gpu(make(v.settings), v.settings);
  auto const matches = v.matches();
  float const nan = std::numeric_limits<float>::quiet_NaN();
  std::vector<std::size_t> spoilt;
  for (std::size_t i = 0; i < matches.size() && spoilt.size() < 20; i += 3) {
    if (matches[i] == nullptr || matches[i]->isBad()) { continue; }
    spoilt.push_back(i);
    if (spoilt.size() % 2 == 0) {
      v.frame.mvKeysUn[i].pt.y = nan;
    } else {
      matches[i]->SetWorldPos({nan, std::numeric_limits<float>::infinity(), 1});
    }
  }
  ASSERT_EQ(spoilt.size(), 20u);
  pnp_progress progress;
  pose_variables to;
  ASSERT_EQ(gpu.solve_pnp(v.frame, matches, progress, to.answer()), 1);
  EXPECT_TRUE(to.T_cw.allFinite());
  for (std::size_t const i : spoilt) { EXPECT_FALSE(to.inliers[i]) << i; }
  for (auto& k : v.frame.mvKeysUn) { k.pt.x = nan; }
  progress = {};
  while (!to.no_more) {
    EXPECT_EQ(gpu.solve_pnp(v.frame, matches, progress, to.answer()), 0);
    ASSERT_LT(progress.done, 300);
  }
}

TEST_P(recovery, poses_that_do_not_fit_are_the_cpus) {
  lost_frame good(sensor::stereo);
  front_end gpu(make(good.settings), good.settings, {});
  auto const matches = good.matches();
  std::function<void(stand_in::frame&)> const spoilt[] = {
      [](stand_in::frame& f) { f.mvLevelSigma2.clear(); },
      [&](stand_in::frame& f) {
        for (auto& k : f.mvKeysUn) { k.octave = -1; }
      },
      [&](stand_in::frame& f) { f.mvKeysUn.resize(100000); },
  };
  auto many = matches;
  many.resize(100000);
  for (auto const& spoil : spoilt) {
    auto f = good.frame;
    spoil(f);
    pnp_progress progress;
    pose_variables to;
    int calls = 0;
    EXPECT_TRUE(gpu.solve_pnp(f, many, progress, to.answer(), [&] {
      ++calls;
      to.count = 77;
      return true;
    }));
    EXPECT_EQ(calls, 1);
    EXPECT_EQ(to.count, 77);
    EXPECT_EQ(progress.done, 0);
  }
  pnp_progress progress;
  pose_variables to;
  EXPECT_TRUE(gpu.solve_pnp(good.frame, matches, progress, to.answer(), never));
}

// ---- switches -----------------------------------------------------------------------------------

TEST_P(recovery, is_the_cpus_by_option_and_after_a_failure) {
  lost_frame v(sensor::stereo);
  auto const matches = v.matches();
  auto const by_cpu = [&](front_end& gpu) {
    int calls = 0;
    pnp_progress progress;
    pose_variables to;
    EXPECT_TRUE(gpu.solve_pnp(v.frame, matches, progress, to.answer(), [&] {
      ++calls;
      return true;
    }));
    EXPECT_EQ(gpu.search_keyframe(v.frame, v.keyframe, point_set{}, 10, 100,
                                  [&] {
                                    ++calls;
                                    return 5;
                                  }),
              5);
    EXPECT_EQ(v.held(), 0);
    return calls;
  };
  ft::orbslam3::options o;
  ft::orbslam3::set_modes(o, "search_keyframe,solve_pnp", ft::orbslam3::stage_mode::host);
  front_end off(make(v.settings), v.settings, o);
  EXPECT_EQ(by_cpu(off), 2);
  for (char const* const name : {"search_keyframe", "solve_pnp"}) {
    EXPECT_THROW(ft::orbslam3::set_modes(o, name, ft::orbslam3::stage_mode::bypass),
                 ft::bad_argument);
  }
  for (std::string const fails : {"solve_pnp", "search_keyframe"}) {
    heard said;
    auto device = std::make_unique<watched_device>(make(v.settings));
    device->on_call = [&](std::string const& call) {
      if (call == fails) { throw ft::cuda_error("ft: the device is lost"); }
    };
    front_end lost(std::move(device), v.settings, {});
    if (fails == "solve_pnp") {
      EXPECT_EQ(by_cpu(lost), 2);
    } else {
      EXPECT_EQ(lost.search_keyframe(v.frame, v.keyframe, point_set{}, 10, 100, [] { return 5; }),
                5);
      EXPECT_EQ(by_cpu(lost), 2);
    }
    EXPECT_EQ(said.lines(), 1) << said.text();
    EXPECT_FALSE(lost.uses(stage::extract));
  }
}

TEST_P(recovery, has_statistics) {
  lost_frame v(sensor::stereo);
  ft::orbslam3::options o;
  o.statistics = true;
  front_end gpu(make(v.settings), v.settings, o);
  pnp_progress progress;
  pose_variables to;
  EXPECT_TRUE(gpu.solve_pnp(v.frame, v.matches(), progress, to.answer(), never));
  EXPECT_GT(gpu.search_keyframe(v.frame, v.keyframe, point_set{}, 10, 100, never), 0);
  std::ostringstream times;
  gpu.print(times);
  EXPECT_NE(times.str().find("search_keyframe: 1 calls, p50 "), std::string::npos) << times.str();
  EXPECT_NE(times.str().find("solve_pnp: 1 calls, p50 "), std::string::npos) << times.str();
}

INSTANTIATE_TEST_SUITE_P(executors, recovery, ::testing::ValuesIn(executors()), executor_name);

}  // namespace recovery_shim

}  // namespace orbslam3_test
