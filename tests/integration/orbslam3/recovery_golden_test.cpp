// SPDX-License-Identifier: Apache-2.0
// Recorded searches for a keyframe's points and whole relocalisations of the reference through the
// shim.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "integration/orbslam3/accelerator.hpp"
#include "tests/conformance/golden_words_input.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/plain_recovery.hpp"
#include "tests/integration/orbslam3/pose_solver.hpp"
#include "tests/integration/orbslam3/recorded_recovery.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/support/npy.hpp"

namespace orbslam3_test {

namespace recovery_golden {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;
using ft::orbslam3::stage;

class recorded_recovery : public on_executor {
protected:
  void SetUp() override {
    on_executor::SetUp();
    if (!std::filesystem::is_directory(recorded_words())) {
      GTEST_SKIP() << "no recorded words here; FT_DATA names the folder that holds golden_words/";
    }
  }
};

std::string set_of_frame(std::string const& root, std::string const& name) {
  return test::words_frame(root, name).set;
}

TEST_P(recorded_recovery, searches_are_made) {
  std::string const root = recorded_words();
  int cases = 0;
  for (auto const& folder : test::cases_of(root, "reloc_proj")) {
    SCOPED_TRACE(folder);
    auto const said = test::words_case(folder);
    if (!said["check"].get<bool>()) { continue; }  // of rotations, as relocalisation always has it
    ++cases;
    auto const name = said["frame"].get<std::string>();
    auto const s = recorded_cameras(set_of_frame(root, name)).settings();
    recorded_keyframe from(root, said["kf"].get<std::string>());
    auto f = recorded_view(root, name);
    f.SetPose(pose_from(test::read_npy<float>(folder + "/Tcw.npy")));
    auto const rows = [&](char const* file) {
      return test::read_npy<std::int32_t>(folder + "/" + file + ".npy").data;
    };
    f.mvpMapPoints = from.points_of(rows("cur_mp_before"));
    point_set found;
    for (auto* p : from.points_of(rows("found"))) { found.insert(p); }
    accelerator gpu(make(s), s);
    EXPECT_EQ(gpu.search_keyframe(f, from.keyframe, found, said["th"].get<float>(),
                                  said["dmax"].get<int>()),
              rows("n")[0]);
    EXPECT_EQ(from.rows_of(f.mvpMapPoints), rows("cur_mp_after"));
  }
  EXPECT_GE(cases, 7);
}

// ---- whole relocalisations ----------------------------------------------------------------------

/// Tracking::Relocalization behind the choice of its candidates, with the shim's calls: section 6
/// of the specification. Its poses by RANSAC have the recorded draws. The steps are compared with a
/// recording.
class recorded_relocalization {
public:
  recorded_relocalization(accelerator& gpu, ft::orbslam3::settings s, std::string const& root,
                          std::string folder)
      : gpu_(gpu), settings_(std::move(s)), folder_(std::move(folder) + "/") {
    auto const said = test::words_case(folder_);
    frame_ = recorded_view(root, said["frame"].get<std::string>());
    unsigned long first = 0;
    for (auto const& name : said["candidates"]) {
      candidates_.emplace_back(root, name.get<std::string>(), first);
      first += candidates_.back().map.size();
    }
    log_ = test::read_npy<std::int32_t>(folder_ + "log_cand_stage_value.npy");
    poses_ = test::read_npy<float>(folder_ + "log_pose_qt.npy");
  }

  void run() {
    auto const n_match = rows("n_match");
    auto const seed = test::read_npy<std::uint64_t>(folder_ + "seed.npy").data[0];
    std::size_t const n = candidates_.size();
    std::vector<std::unique_ptr<pose_solver>> solvers(n);
    std::vector<bool> left(n);
    std::vector<std::vector<stand_in::map_point*>> matches(n);
    for (std::size_t c = 0; c < n; ++c) {
      left[c] = n_match[c] >= 15;
      matches[c] = candidates_[c].points_of(rows("match_" + std::to_string(c)));
      solvers[c] = std::make_unique<pose_solver>(settings_, frame_, matches[c], seed + c);
    }
    int winner = -1;
    for (int round = 0; round < 4 && winner < 0; ++round) {
      for (std::size_t c = 0; c < n && winner < 0; ++c) {
        if (!left[c]) { continue; }
        pose_variables to;
        bool const any = solvers[c]->iterate(to);
        left[c] = !to.no_more;
        candidate_ = static_cast<int>(c);
        step(0, any ? to.count : -1);
        if (any && accepts(to, matches[c])) { winner = candidate_; }
      }
    }
    EXPECT_EQ(steps_, log_.rows());
    auto const want = rows("ok_winner");
    EXPECT_EQ(winner >= 0, want[0] != 0);
    EXPECT_EQ(winner, want[1]);
    if (winner >= 0) { EXPECT_EQ(candidate().rows_of(frame_.mvpMapPoints), rows("mp_final")); }
  }
  int steps() const { return steps_; }

private:
  recorded_keyframe& candidate() { return candidates_[static_cast<std::size_t>(candidate_)]; }
  std::vector<std::int32_t> rows(std::string const& name) const {
    return test::read_npy<std::int32_t>(folder_ + name + ".npy").data;
  }

  bool accepts(pose_variables const& to, std::vector<stand_in::map_point*> const& matches) {
    frame_.SetPose({to.T_cw.topLeftCorner<3, 3>(), to.T_cw.topRightCorner<3, 1>()});
    point_set found;
    for (std::size_t i = 0; i < matches.size(); ++i) {
      frame_.mvpMapPoints[i] = to.inliers[i] ? matches[i] : nullptr;
      if (to.inliers[i]) { found.insert(matches[i]); }
    }
    int n = optimize();
    step(1, n);
    if (n < 10) { return false; }
    release_outliers();
    if (n >= 50) { return true; }
    int added = search(found, 10, 100);
    step(2, added);
    if (added + n < 50) { return false; }
    n = optimize();
    step(3, n);
    if (n <= 30 || n >= 50) { return n >= 50; }
    found = {frame_.mvpMapPoints.begin(), frame_.mvpMapPoints.end()};
    added = search(found, 3, 64);
    step(4, added);
    if (added + n < 50) { return false; }
    n = optimize();
    release_outliers();
    step(5, n);
    return n >= 50;
  }
  int optimize() { return gpu_.pose_optimization(frame_, stage::pose_keyframe); }
  int search(point_set const& found, float th, int farthest) {
    return gpu_.search_keyframe(frame_, candidate().keyframe, found, th, farthest);
  }
  void release_outliers() {
    for (std::size_t i = 0; i < frame_.mvpMapPoints.size(); ++i) {
      if (frame_.mvbOutlier[i]) { frame_.mvpMapPoints[i] = nullptr; }
    }
  }

  void step(int which, int value) {
    int const row = steps_++;
    SCOPED_TRACE("step " + std::to_string(row));
    ASSERT_LT(row, log_.rows());
    EXPECT_EQ(log_(row, 0), candidate_);
    EXPECT_EQ(log_(row, 1), which);
    EXPECT_EQ(log_(row, 2), value);
    if (which == 0) { return; }  // recorded is the frame's pose before
    Eigen::Quaternionf const q(poses_(row, 3), poses_(row, 0), poses_(row, 1), poses_(row, 2));
    Eigen::Matrix3f const turned = q.toRotationMatrix() - frame_.GetPose().rotationMatrix();
    EXPECT_LT(turned.cwiseAbs().maxCoeff(), 1e-4f);
    Eigen::Vector3f const t(poses_(row, 4), poses_(row, 5), poses_(row, 6));
    EXPECT_LT((t - frame_.GetPose().translation()).cwiseAbs().maxCoeff(), 1e-4f);
    std::string const number = std::to_string(states_++);
    EXPECT_EQ(candidate().rows_of(frame_.mvpMapPoints), rows("mp_" + number));
    auto const flags = test::read_npy<std::uint8_t>(folder_ + "outlier_" + number + ".npy").data;
    EXPECT_EQ(frame_.mvbOutlier, std::vector<bool>(flags.begin(), flags.end()));
  }

  accelerator& gpu_;
  ft::orbslam3::settings settings_;
  std::string folder_;
  stand_in::frame frame_;
  std::vector<recorded_keyframe> candidates_;
  test::npy<std::int32_t> log_;
  test::npy<float> poses_;
  int candidate_ = -1;
  int steps_ = 0;
  int states_ = 0;
};

TEST_P(recorded_recovery, relocalisations_go_step_by_step) {
  std::string const root = recorded_words();
  int cases = 0;
  int steps = 0;
  for (auto const& folder : test::cases_of(root, "reloc")) {
    SCOPED_TRACE(folder);
    ++cases;
    auto const name = test::words_case(folder)["frame"].get<std::string>();
    auto const s = recorded_cameras(set_of_frame(root, name)).settings();
    accelerator gpu(make(s), s);
    recorded_relocalization run(gpu, s, root, folder);
    run.run();
    steps += run.steps();
  }
  EXPECT_GE(cases, 10);
  EXPECT_GE(steps, 40);
}

INSTANTIATE_TEST_SUITE_P(executors, recorded_recovery, ::testing::ValuesIn(executors()),
                         executor_name);

}  // namespace recovery_golden

}  // namespace orbslam3_test
