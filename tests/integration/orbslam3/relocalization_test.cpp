// SPDX-License-Identifier: Apache-2.0
// The lines of integration/orbslam3/README.md in a function of Tracking::Relocalization's shape,
// with a vocabulary and two candidates: on the accelerator alone, and compared with the CPU's
// loops.
#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <set>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "integration/orbslam3/front_end.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/heard.hpp"
#include "tests/integration/orbslam3/plain_recovery.hpp"
#include "tests/integration/orbslam3/plain_words.hpp"
#include "tests/integration/orbslam3/pose_solver.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/integration/orbslam3/two_views.hpp"
#include "tests/support/plain_vocabulary.hpp"

namespace orbslam3_test {

namespace relocalization_shim {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;
using Gpu = ft::orbslam3::front_end<stand_in::types>;
using ft::orbslam3::stage;
using MapPoint = stand_in::map_point;

/// ORB-SLAM3's own code, in plain loops; the optimiser is another accelerator's.
class cpu_code {
public:
  cpu_code(plain_words const& words, accelerator& other, ft::orbslam3::settings const& s)
      : words_(words), other_(&other), search_(s), up_(s.levels_up) {}

  void ComputeBoW(stand_in::frame& f) const {
    if (f.mBowVec.empty()) { words_.transform(f, up_); }
  }
  static int SearchByBoW(stand_in::key_frame const& k, stand_in::frame const& f,
                         std::vector<MapPoint*>& matches) {
    return plain_word_search(k, f, 0.75f, true).run(matches);
  }
  int PoseOptimization(stand_in::frame& f) const {
    return other_->pose_optimization(f, stage::pose_keyframe);
  }
  int SearchByProjection(stand_in::frame& f, stand_in::key_frame const& k,
                         std::set<MapPoint*> const& found, float th, int distance) const {
    return search_.run(f, k, found, th, distance);
  }

private:
  plain_words words_;
  accelerator* other_;
  plain_keyframe_search search_;
  int up_;
};

/// Tracking, with the names of its members and variables.
struct tracking {
  Gpu* mpGpu;
  stand_in::frame& mCurrentFrame;
  std::vector<stand_in::key_frame*> vpCandidateKFs;
  cpu_code const* cpu;  ///< null: is never asked
  ft::orbslam3::settings const& settings;
  int winner = -1;

  cpu_code const& own_code() const {
    if (cpu == nullptr) { throw std::runtime_error("the CPU was asked"); }
    return *cpu;
  }
  int OptimizePose(stage which) {
    return mpGpu->pose_optimization(mCurrentFrame, which,
                                    [&] { return own_code().PoseOptimization(mCurrentFrame); });
  }

  bool Relocalization() {
    mpGpu->compute_bow(mCurrentFrame, [&] { own_code().ComputeBoW(mCurrentFrame); });
    std::size_t const nKFs = vpCandidateKFs.size();
    std::vector<std::vector<MapPoint*>> vvpMapPointMatches(nKFs);
    std::vector<std::unique_ptr<pose_solver>> vpPnPsolvers;
    std::vector<bool> vbDiscarded(nKFs);
    for (std::size_t i = 0; i < nKFs; ++i) {
      auto* const pKF = vpCandidateKFs[i];
      int const nmatches = mpGpu->search_by_bow(
          *pKF, mCurrentFrame, vvpMapPointMatches[i], 0.75f, true,
          [&] { return own_code().SearchByBoW(*pKF, mCurrentFrame, vvpMapPointMatches[i]); });
      vbDiscarded[i] = nmatches < 15;
      vpPnPsolvers.push_back(
          std::make_unique<pose_solver>(settings, mCurrentFrame, vvpMapPointMatches[i], 99));
    }
    for (int round = 0; round < 4; ++round) {
      for (std::size_t i = 0; i < nKFs; ++i) {
        if (vbDiscarded[i]) { continue; }
        pose_variables to;
        bool const bTcw = vpPnPsolvers[i]->iterate(to);
        if (to.no_more) { vbDiscarded[i] = true; }
        if (!bTcw) { continue; }
        mCurrentFrame.SetPose({to.T_cw.topLeftCorner<3, 3>(), to.T_cw.topRightCorner<3, 1>()});
        if (Accept(*vpCandidateKFs[i], vvpMapPointMatches[i], to.inliers)) {
          winner = static_cast<int>(i);
          return true;
        }
      }
    }
    return false;
  }

private:
  bool Accept(stand_in::key_frame& pKF, std::vector<MapPoint*> const& matches,
              std::vector<bool> const& vbInliers) {
    std::set<MapPoint*> sFound;
    for (std::size_t j = 0; j < vbInliers.size(); ++j) {
      mCurrentFrame.mvpMapPoints[j] = vbInliers[j] ? matches[j] : nullptr;
      if (vbInliers[j]) { sFound.insert(matches[j]); }
    }
    if (OptimizePose(stage::pose_keyframe) < 10) { return false; }
    for (std::size_t j = 0; j < vbInliers.size(); ++j) {
      if (mCurrentFrame.mvbOutlier[j]) { mCurrentFrame.mvpMapPoints[j] = nullptr; }
    }
    // Also with enough inliers: this test is about the calls.
    int nadditional = mpGpu->search_keyframe(mCurrentFrame, pKF, sFound, 10, 100, [&] {
      return own_code().SearchByProjection(mCurrentFrame, pKF, sFound, 10, 100);
    });
    EXPECT_GT(nadditional, 0);
    int const nGood = OptimizePose(stage::pose_keyframe);
    sFound = {mCurrentFrame.mvpMapPoints.begin(), mCurrentFrame.mvpMapPoints.end()};
    nadditional = mpGpu->search_keyframe(mCurrentFrame, pKF, sFound, 3, 64, [&] {
      return own_code().SearchByProjection(mCurrentFrame, pKF, sFound, 3, 64);
    });
    EXPECT_GE(nadditional, 0);
    return nGood >= 50;
  }
};

class relocalization : public on_executor {
protected:
  relocalization()
      : path((std::filesystem::temp_directory_path() /
              ("ft_relocalization_" + std::to_string(reinterpret_cast<std::uintptr_t>(this))))
                 .string()) {
    test::generator random(7);
    vocabulary = test::random_vocabulary(random, 6, 4, 3);
    int words = 0;
    for (int& w : vocabulary.word) { w = w < 0 ? -1 : words++; }  // as lines of the text
    write_text(path, vocabulary);
  }
  ~relocalization() override { std::filesystem::remove(path); }
  /// Two candidates, of which the first sees another place.
  void relocalize(sensor kind, bool verify) {
    lost_frame v(kind, 3);
    lost_frame elsewhere(kind, 8);
    plain_words const words(vocabulary);
    words.transform(v.keyframe, v.settings.levels_up);
    words.transform(elsewhere.keyframe, v.settings.levels_up);
    auto const truth = v.frame.GetPose();
    v.frame.SetPose({});
    ft::orbslam3::options o;
    o.vocabulary = path;
    o.verify = verify;
    heard said;
    Gpu gpu(make(v.settings), v.settings, o);
    accelerator other(make(v.settings), v.settings);
    cpu_code const cpu(words, other, v.settings);
    tracking t{
        &gpu, v.frame, {&elsewhere.keyframe, &v.keyframe}, verify ? &cpu : nullptr, v.settings};
    EXPECT_TRUE(t.Relocalization());
    EXPECT_EQ(t.winner, 1);
    auto const found = v.frame.GetPose();
    EXPECT_LT((found.rotationMatrix() - truth.rotationMatrix()).norm(), 0.02f);
    EXPECT_LT((found.translation() - truth.translation()).norm(), 0.05f);
    if (verify) { expect_no_differences(gpu); }
    EXPECT_TRUE(gpu.uses(stage::extract)) << said.text();
  }
  static void expect_no_differences(Gpu& gpu) {
    std::ostringstream summary;
    gpu.print(summary);
    EXPECT_NE(summary.str().find("1 frames, 0 with differences"), std::string::npos)
        << summary.str();
    for (char const* const name : {"transform: 1 calls", "search_by_bow: 2 calls",
                                   "search_keyframe: 2 calls", "pose_keyframe: 2 calls"}) {
      EXPECT_NE(summary.str().find(name), std::string::npos) << summary.str();
    }
  }
  std::string path;
  test::plain_vocabulary vocabulary;
};

TEST_P(relocalization, is_the_accelerators_alone) {
  for (sensor const kind : all_sensors) {
    SCOPED_TRACE(name_of(kind));
    relocalize(kind, false);
  }
}
TEST_P(relocalization, is_the_cpus_to_verify) {
  for (sensor const kind : {sensor::stereo, sensor::monocular, sensor::fisheye_stereo}) {
    SCOPED_TRACE(name_of(kind));
    relocalize(kind, true);
  }
}

INSTANTIATE_TEST_SUITE_P(executors, relocalization, ::testing::ValuesIn(executors()),
                         executor_name);

}  // namespace relocalization_shim

}  // namespace orbslam3_test
