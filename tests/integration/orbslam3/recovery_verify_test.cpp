// SPDX-License-Identifier: Apache-2.0
// Verify of relocalisation's search: what counts as a difference, and whose answer stays.
#include <gtest/gtest.h>

#include <cstddef>
#include <functional>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include "integration/orbslam3/front_end.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/heard.hpp"
#include "tests/integration/orbslam3/plain_recovery.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/integration/orbslam3/two_views.hpp"

namespace orbslam3_test {

namespace recovery_verify_shim {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;
using front_end = ft::orbslam3::front_end<stand_in::types>;
using verifier = ft::orbslam3::verifier<stand_in::types>;
using ft::orbslam3::difference;
using list = std::vector<std::string>;

class recovery_verify : public on_executor {
protected:
  recovery_verify() : v(sensor::stereo) {}
  void SetUp() override {
    on_executor::SetUp();
    if (!IsSkipped()) { gpu = std::make_unique<accelerator>(make(v.settings), v.settings); }
  }
  /// The search, whose CPU's answer `plant` changes. @return what differed
  list searched(std::function<int(stand_in::frame&)> const& plant) {
    list found;
    verifier both(*gpu, [&](difference const& d) { found.emplace_back(d.what); });
    plain_keyframe_search const plain(v.settings);
    auto want = v.frame;
    int const n = plain.run(want, v.keyframe, {}, 10, 100);
    auto f = v.frame;
    int calls = 0;
    EXPECT_EQ(both.search_keyframe(f, v.keyframe, point_set{}, 10, 100,
                                   [&] {
                                     ++calls;
                                     int const cpu = plain.run(f, v.keyframe, {}, 10, 100);
                                     return cpu + plant(f);
                                   }),
              n);
    EXPECT_EQ(calls, found.empty() ? 2 : 4);
    EXPECT_EQ(f.mvpMapPoints, want.mvpMapPoints) << "the accelerator's answer stays";
    return found;
  }

  lost_frame v;
  std::unique_ptr<accelerator> gpu;
};

TEST_P(recovery_verify, finds_nothing_where_the_cpu_searches_alike) {
  EXPECT_EQ(searched([](stand_in::frame&) { return 0; }), list{});
}

TEST_P(recovery_verify, finds_each_difference_of_a_search) {
  EXPECT_EQ(searched([](stand_in::frame&) { return 1; }), list{"matches"});
  EXPECT_EQ(searched([](stand_in::frame& f) {
              for (auto*& p : f.mvpMapPoints) {
                if (p == nullptr) { continue; }
                p = nullptr;
                break;
              }
              return 0;
            }),
            list{"map point of keypoint"});
}

TEST_P(recovery_verify, keeps_the_cpus_answer_where_the_accelerator_refuses) {
  ft::orbslam3::options o;
  o.verify = true;
  heard said;
  front_end both(make(v.settings), v.settings, o);
  v.keyframe.points.pop_back();
  auto* const planted = v.world.map[0].get();
  EXPECT_EQ(both.search_keyframe(v.frame, v.keyframe, point_set{}, 10, 100,
                                 [&] {
                                   v.frame.mvpMapPoints[3] = planted;
                                   return 1;
                                 }),
            1);
  EXPECT_EQ(v.frame.mvpMapPoints[3], planted);
  EXPECT_EQ(v.held(), 1);
  std::ostringstream summary;
  both.print(summary);
  EXPECT_NE(summary.str().find(
                "verify: search_keyframe: 1 calls, 0 with differences, 0 in all, 1 refused"),
            std::string::npos)
      << summary.str();
}

INSTANTIATE_TEST_SUITE_P(executors, recovery_verify, ::testing::ValuesIn(executors()),
                         executor_name);

}  // namespace recovery_verify_shim

}  // namespace orbslam3_test
