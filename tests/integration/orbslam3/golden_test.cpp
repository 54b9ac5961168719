// SPDX-License-Identifier: Apache-2.0
// Recorded answers of the reference through the shim: features, stereo, both searches, frustum and
// pose, of frames that the device has extracted and of frames that came from the CPU.
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "integration/orbslam3/accelerator.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/recorded.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"

namespace orbslam3_test {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;
using ft::orbslam3::stage;
using point_list = std::vector<std::unique_ptr<stand_in::map_point>>;

class recorded_answers : public on_executor {
protected:
  void SetUp() override {
    on_executor::SetUp();
    if (recorded_folders().empty()) {
      GTEST_SKIP() << "no recorded answers here; FT_DATA names the folder that holds golden/";
    }
  }
  static void for_each_sequence(std::function<void(recorded const&)> const& body) {
    for (auto const& folder : recorded_folders()) {
      SCOPED_TRACE(folder);
      body(recorded(folder));
    }
  }
  static void for_each_pair(std::function<void(recorded const&, accelerator&, int)> const& body) {
    for_each_sequence([&](recorded const& r) {
      accelerator gpu(make(r.settings()), r.settings());
      for (int k = 1; r.has_pair(k); ++k) {
        SCOPED_TRACE("pair " + std::to_string(k));
        gpu.reset();
        body(r, gpu, k);
      }
    });
  }
};

void expect_keypoints(std::vector<stand_in::keypoint> const& got,
                      std::vector<stand_in::keypoint> const& want) {
  ASSERT_EQ(got.size(), want.size());
  for (std::size_t i = 0; i < got.size(); ++i) {
    ASSERT_EQ(got[i].pt.x, want[i].pt.x) << i;
    ASSERT_EQ(got[i].pt.y, want[i].pt.y) << i;
    ASSERT_EQ(got[i].size, want[i].size) << i;
    ASSERT_EQ(got[i].angle, want[i].angle) << i;
    ASSERT_EQ(got[i].response, want[i].response) << i;
    ASSERT_EQ(got[i].octave, want[i].octave) << i;
  }
}
void expect_rows(stand_in::matrix const& got, stand_in::matrix const& want) {
  ASSERT_EQ(got.rows, want.rows);
  ASSERT_EQ(got.cols, want.cols);
  for (int i = 0; i < got.rows; ++i) {
    auto const row = static_cast<std::size_t>(i);
    ASSERT_EQ(std::memcmp(got.data + row * static_cast<std::size_t>(got.step),
                          want.data + row * static_cast<std::size_t>(want.step), 32),
              0)
        << "row " << i;
  }
}
void expect_stereo(stand_in::frame const& got, stand_in::frame const& want, bool fisheye) {
  if (fisheye) {
    EXPECT_EQ(got.mvLeftToRightMatch, want.mvLeftToRightMatch);
    EXPECT_EQ(got.mvRightToLeftMatch, want.mvRightToLeftMatch);
  } else {
    EXPECT_EQ(got.mvuRight, want.mvuRight);
    EXPECT_EQ(got.mvDepth, want.mvDepth);
  }
}
/// Which map point each keypoint holds, as rows of the recorded table.
std::vector<int> holders(stand_in::frame const& f, unsigned long first) {
  std::vector<int> rows;
  for (auto const* p : f.mvpMapPoints) {
    rows.push_back(p == nullptr ? -1 : static_cast<int>(p->mnId - first));
  }
  return rows;
}
void hold(stand_in::frame& f, std::vector<std::int32_t> const& rows, point_list const& map) {
  ASSERT_EQ(rows.size(), f.mvpMapPoints.size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    f.mvpMapPoints[i] = rows[i] < 0 ? nullptr : map[static_cast<std::size_t>(rows[i])].get();
  }
}
TEST_P(recorded_answers, are_found_from_the_images_features_and_stereo) {
  for_each_sequence([](recorded const& r) {
    accelerator gpu(make(r.settings()), r.settings());
    for (int k = 0; k < r.frames(); ++k) {
      SCOPED_TRACE("frame " + std::to_string(k));
      auto const want = r.frame(k);
      stand_in::frame f;
      f.mnId = static_cast<unsigned long>(k);
      gpu.extract(r.image(k, 0), r.image(k, 1), f);
      expect_keypoints(f.mvKeys, want.mvKeys);
      expect_keypoints(f.mvKeysRight, want.mvKeysRight);
      expect_rows(f.mDescriptors, want.mDescriptors);
      expect_rows(f.mDescriptorsRight, want.mDescriptorsRight);
      EXPECT_EQ(f.N, want.N);
      EXPECT_EQ(f.Nleft, want.Nleft);
      EXPECT_EQ(f.Nright, want.Nright);
      if (r.fisheye()) {
        EXPECT_EQ(f.monoLeft, want.monoLeft);
        EXPECT_EQ(f.monoRight, want.monoRight);
      }
      gpu.compute_stereo(f);
      expect_stereo(f, want, r.fisheye());
    }
  });
}

/// Frames k - 1 and k, extracted by the device or, by the reference's CPU, loaded.
struct frame_pair {
  stand_in::frame last;
  stand_in::frame current;

  frame_pair(recorded const& r, accelerator& gpu, int k, bool extract) {
    for (int i = k - 1; i <= k; ++i) {
      stand_in::frame& f = i < k ? last : current;
      f = r.frame(i);
      if (!extract) { continue; }
      gpu.extract(r.image(i, 0), r.image(i, 1), f);
      if (!r.fisheye()) { f.mvKeysUn = f.mvKeys; }
      gpu.compute_stereo(f);
    }
  }
};

TEST_P(recorded_answers, of_the_search_in_the_last_frame) {
  for_each_pair([](recorded const& r, accelerator& gpu, int k) {
    for (bool const extract : {true, false}) {
      frame_pair f(r, gpu, k, extract);
      auto const map = r.map(k, 100);
      hold(f.last, r.ints("pair", k, "last_mp").data, map);
      auto const outlier = r.bytes("pair", k, "last_outlier");
      for (int i = 0; i < outlier.rows(); ++i) {
        f.last.mvbOutlier[static_cast<std::size_t>(i)] = outlier(i) != 0;
      }
      f.last.SetPose(r.pose(k, "Tlw"));
      f.current.SetPose(r.pose(k, "Tcw_pred"));
      auto const setting = r.floats("pair", k, "sbp_last_th_nnratio_n");
      int const matches = gpu.search_by_projection(f.current, f.last, setting(0), false);
      EXPECT_EQ(matches, static_cast<int>(setting(2)));
      EXPECT_EQ(holders(f.current, 100), r.ints("pair", k, "sbp_last").data);
      gpu.reset();
    }
  });
}

TEST_P(recorded_answers, of_frustum_and_search_in_the_local_map) {
  for_each_pair([](recorded const& r, accelerator& gpu, int k) {
    for (bool const extract : {true, false}) {
      frame_pair f(r, gpu, k, extract);
      auto const map = r.map(k, 7);
      hold(f.current, r.ints("pair", k, "cur_mp_before_local").data, map);
      f.current.SetPose(r.pose(k, "Tcw_local"));
      auto const local = r.ints("pair", k, "local_mp");
      auto const skip = r.bytes("pair", k, "local_skip");
      auto const in_view = r.ints("pair", k, "local_inview");
      auto const level = r.ints("pair", k, "local_level");
      auto const seen = r.floats("pair", k, "local_proj");
      auto const seen_right = r.fisheye() ? r.floats("pair", k, "local_projR") : test::npy<float>{};
      std::vector<stand_in::map_point*> points;
      for (int i = 0; i < local.rows(); ++i) {
        auto* const p = map[static_cast<std::size_t>(local(i))].get();
        points.push_back(p);
        if (skip(i) == 0) { continue; }
        p->mnLastFrameSeen = f.current.mnId;
        p->mbTrackInView = in_view(i, 0) != 0;
        p->mTrackProjX = seen(i, 0);
        p->mTrackProjY = seen(i, 1);
        p->mTrackProjXR = seen(i, 2);
        p->mTrackViewCos = seen(i, 3);
        p->mTrackDepth = seen(i, 4);
        p->mnTrackScaleLevel = level(i, 0);
        if (r.fisheye()) {
          p->mbTrackInViewR = in_view(i, 1) != 0;
          p->mTrackProjXR = seen_right(i, 0);
          p->mTrackProjYR = seen_right(i, 1);
          p->mTrackViewCosR = seen_right(i, 2);
          p->mnTrackScaleLevelR = level(i, 1);
        }
      }
      auto const setting = r.floats("pair", k, "sbp_local_th_nnratio_n");
      int const matches = gpu.search_local_points(f.current, points, setting(0));
      EXPECT_EQ(matches, static_cast<int>(setting(2)));
      EXPECT_EQ(holders(f.current, 7), r.ints("pair", k, "cur_mp_after_local").data);
      for (int i = 0; i < local.rows(); ++i) {
        auto& p = *points[static_cast<std::size_t>(i)];
        if (skip(i) != 0) { continue; }
        ASSERT_EQ(p.mbTrackInView, in_view(i, 0) != 0) << i;
        ASSERT_EQ(p.mbTrackInViewR, in_view(i, 1) != 0) << i;
        ASSERT_EQ(p.visible(), 1 + static_cast<int>(in_view(i, 0) != 0 || in_view(i, 1) != 0));
        if (p.mbTrackInView) {
          ASSERT_EQ(p.mnTrackScaleLevel, level(i, 0)) << i;
          ASSERT_NEAR(p.mTrackProjX, seen(i, 0), 1e-3) << i;
          ASSERT_NEAR(p.mTrackProjY, seen(i, 1), 1e-3) << i;
          ASSERT_NEAR(p.mTrackViewCos, seen(i, 3), 1e-5) << i;
          ASSERT_NEAR(p.mTrackDepth, seen(i, 4), 1e-4) << i;
          if (!r.fisheye()) { ASSERT_NEAR(p.mTrackProjXR, seen(i, 2), 1e-3) << i; }
          auto const drawn = f.current.mmProjectPoints.find(p.mnId);
          ASSERT_NE(drawn, f.current.mmProjectPoints.end()) << i;
          ASSERT_EQ(drawn->second.x, p.mTrackProjX);
        }
        if (p.mbTrackInViewR) {
          ASSERT_EQ(p.mnTrackScaleLevelR, level(i, 1)) << i;
          ASSERT_NEAR(p.mTrackProjXR, seen_right(i, 0), 1e-3) << i;
          ASSERT_NEAR(p.mTrackProjYR, seen_right(i, 1), 1e-3) << i;
        }
      }
      gpu.reset();
    }
  });
}

TEST_P(recorded_answers, of_both_pose_optimisations) {
  for_each_pair([](recorded const& r, accelerator& gpu, int k) {
    for (std::string const po : {"po1_", "po2_"}) {
      for (bool const extract : {true, false}) {
        frame_pair f(r, gpu, k, extract);
        auto const map = r.map(k, 0);
        auto const keypoint = r.ints("pair", k, po + "kp");
        auto const point = r.ints("pair", k, po + "mp");
        auto const outlier = r.bytes("pair", k, po + "outlier");
        auto const where = r.floats("pair", k, po + "Xw");
        for (int i = 0; i < keypoint.rows(); ++i) {
          auto* const p = map[static_cast<std::size_t>(point(i))].get();
          p->SetWorldPos({where(i, 0), where(i, 1), where(i, 2)});
          f.current.mvpMapPoints[static_cast<std::size_t>(keypoint(i))] = p;
        }
        f.current.SetPose(r.pose(k, po + "Tin"));
        int const inliers = gpu.pose_optimization(
            f.current, po == "po1_" ? stage::pose_last_frame : stage::pose_local_map);
        EXPECT_EQ(inliers, r.ints("pair", k, po + "inliers")(0));
        for (int i = 0; i < keypoint.rows(); ++i) {
          ASSERT_EQ(f.current.mvbOutlier[static_cast<std::size_t>(keypoint(i))], outlier(i) != 0)
              << po << i;
        }
        auto const want = r.pose(k, po + "Tout");
        EXPECT_LT(
            (f.current.GetPose().rotationMatrix() - want.rotationMatrix()).cwiseAbs().maxCoeff(),
            1e-4f);
        EXPECT_LT((f.current.GetPose().translation() - want.translation()).cwiseAbs().maxCoeff(),
                  1e-4f);
        gpu.reset();
      }
    }
  });
}

INSTANTIATE_TEST_SUITE_P(executors, recorded_answers, ::testing::ValuesIn(executors()),
                         executor_name);

}  // namespace orbslam3_test
