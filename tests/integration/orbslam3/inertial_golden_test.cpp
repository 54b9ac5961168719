// SPDX-License-Identifier: Apache-2.0
// Recorded chains of the reference's poses with an IMU through the shim.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "integration/orbslam3/accelerator.hpp"
#include "integration/orbslam3/rigs.hpp"
#include "tests/conformance/inertial_case.hpp"
#include "tests/conformance/inertial_steps.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/inertial_frames.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/support/effort.hpp"

namespace orbslam3_test {

namespace inertial_golden {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;

/// The folders of golden_inertial that are chains; FT_TEST_EFFORT keeps a share of them.
std::vector<std::string> recorded_chains() {
  char const* const data = std::getenv("FT_DATA");
  std::string const root = std::string(data == nullptr ? "../shared" : data) + "/golden_inertial";
  std::vector<std::string> found;
  if (!std::filesystem::is_directory(root)) { return found; }
  for (auto const& entry : std::filesystem::directory_iterator(root)) {
    if (test::is_inertial_chain(entry.path().string())) { found.push_back(entry.path().string()); }
  }
  std::sort(found.begin(), found.end());
  auto const all = static_cast<int>(found.size());
  auto const step = all == 0 ? 1 : static_cast<std::size_t>(all / test::effort(all));
  std::vector<std::string> kept;
  for (std::size_t i = 0; i < found.size(); i += step) { kept.push_back(found[i]); }
  return kept;
}

inertial_setup setup_of(test::inertial_chain const& chain) {
  inertial_setup setup;
  auto const& c = chain.calibration;
  std::ifstream file(chain.folder + "/params.json");
  auto const json = nlohmann::json::parse(file);
  setup.mount = c.mount;
  setup.gyro_walk = c.variances.walk[0];
  auto& s = setup.settings;
  s.width = json["image"][0];
  s.height = json["image"][1];
  s.features = 500;
  s.most_keypoints = 1000;
  s.map_points = 2048;
  s.local_points = 1024;
  s.images = c.family == "mono" ? 1 : 2;
  s.bf = c.bf;
  std::size_t const n = c.family == "fisheye" ? 8 : 4;
  std::copy_n(c.camera.begin(), n, s.left.values);
  if (c.family == "fisheye") {
    s.left.kind = s.right.kind = ft::orbslam3::lens::kannala_brandt;
    std::copy_n(c.camera.begin() + 8, 8, s.right.values);
    s.T_rl = c.T_rl;
  }
  return setup;
}

test::inertial_pose_batch inputs_of(test::inertial_chain const& chain, int s) {
  test::inertial_pose_batch b;
  test::add_recorded_step(b, chain, s);
  return b;
}

void expect_state(stand_in::frame& f, test::inertial_chain const& chain, int s,
                  test::inertial_state_distance const& limit) {
  auto const& mount = chain.calibration.mount;
  auto const d =
      test::distance_between(test::wide_state_of(stored_state_of(f), mount),
                             test::wide_state_of(test::state_at(chain.out_state, s).stored, mount));
  EXPECT_LE(d.turn, limit.turn);
  EXPECT_LE(d.position, limit.position);
  EXPECT_LE(d.velocity, limit.velocity);
  EXPECT_LE(d.gyro_bias, limit.gyro_bias);
  EXPECT_LE(d.accel_bias, limit.accel_bias);
}

class recorded_chain : public on_executor {
protected:
  void SetUp() override {
    on_executor::SetUp();
    if (recorded_chains().empty()) {
      GTEST_SKIP() << "no recorded chains here; FT_DATA names the folder that holds "
                      "golden_inertial/";
    }
  }
  /// Flags and number are the recorded ones.
  static void expect_decisions(test::inertial_chain const& chain, int s, stand_in::frame const& f,
                               int tracked) {
    EXPECT_EQ(tracked, chain.ret(s));
    for (int i = 0; i < chain.observation_count(s); ++i) {
      ASSERT_EQ(f.mvbOutlier[static_cast<std::size_t>(i)],
                chain.outlier(chain.obs_start(s) + i) != 0)
          << i;
    }
  }
};

TEST_P(recorded_chain, is_found_step_by_step) {
  for (auto const& folder : recorded_chains()) {
    test::inertial_chain const chain(folder);
    auto const setup = setup_of(chain);
    accelerator gpu(make(setup.settings), setup.settings);
    for (int s = 0; s < chain.count(); ++s) {
      SCOPED_TRACE(folder + " step " + std::to_string(s));
      auto const b = inputs_of(chain, s);
      inertial_moment at(setup, b, 0, static_cast<unsigned long>(20 + s));
      EXPECT_EQ(ft::orbslam3::inertial_steps(at.current, chain.mode(s) != 0), b.integral[0].steps);
      int const n = gpu.inertial_pose_optimization(at.current, stage_of(b, 0));
      expect_decisions(chain, s, at.current, n);
      expect_state(at.current, chain, s, {2e-6, 2e-6, 1e-5, 1e-8, 3e-6});
      ASSERT_NE(at.current.mpcpi, nullptr);
      auto const prior = ft::orbslam3::prior_of(*at.current.mpcpi);
      auto const want = chain.prior(s, true);
      for (int k = 0; k < 225 && b.integral[0].steps > 1; ++k) {
        double const size =
            std::sqrt(want.information[k / 15 * 16] * want.information[k % 15 * 16]);
        ASSERT_NEAR(prior.information[k], want.information[k], 2e-6 * size) << k;
      }
      gpu.reset();
    }
  }
}

TEST_P(recorded_chain, is_found_from_the_shims_own_answers) {
  for (auto const& folder : recorded_chains()) {
    test::inertial_chain const chain(folder);
    auto const setup = setup_of(chain);
    accelerator gpu(make(setup.settings), setup.settings);
    std::unique_ptr<inertial_moment> before;
    for (int s = 0; s < chain.count(); ++s) {
      SCOPED_TRACE(folder + " step " + std::to_string(s));
      auto const b = inputs_of(chain, s);
      auto at = std::make_unique<inertial_moment>(setup, b, 0, static_cast<unsigned long>(20 + s));
      if (before != nullptr && chain.mode(s) != 0) { at->current.mpPrevFrame = &before->current; }
      int const n = gpu.inertial_pose_optimization(at->current, stage_of(b, 0));
      expect_decisions(chain, s, at->current, n);
      expect_state(at->current, chain, s, {3e-5, 2e-4, 1e-3, 1e-6, 1e-3});
      if (before != nullptr && chain.mode(s) != 0) {
        EXPECT_EQ(before->current.mpcpi, nullptr);
        at->current.mpPrevFrame = nullptr;
      }
      before = std::move(at);
      gpu.reset();
    }
  }
}

INSTANTIATE_TEST_SUITE_P(executors, recorded_chain, ::testing::ValuesIn(executors()),
                         executor_name);

}  // namespace inertial_golden

}  // namespace orbslam3_test
