// SPDX-License-Identifier: Apache-2.0
// The recorded answers of the CPU reference, stage by stage: FT_DATA names the folder that holds `golden`.
#include "tests/golden/conformance.hpp"

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

namespace {

std::vector<std::string> golden_folders() {
  std::vector<std::string> found;
  char const* const data = std::getenv("FT_DATA");
  std::string const root = std::string(data == nullptr ? "../shared" : data) + "/golden";
  if (!std::filesystem::is_directory(root)) { return found; }
  for (auto const& entry : std::filesystem::directory_iterator(root)) {
    if (entry.is_directory()) { found.push_back(entry.path().string()); }
  }
  std::sort(found.begin(), found.end());
  return found;
}

template <typename Backend>
class golden : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(golden, test::backends);

TYPED_TEST(golden, every_stage_gives_the_recorded_answers) {
  auto const folders = golden_folders();
  if (folders.empty()) { GTEST_SKIP() << "no golden files: set FT_DATA to the folder that holds them"; }
  TypeParam backend;
  test::conformance_table all;
  for (auto const& folder : folders) {
    test::conformance_table table;
    test::golden_sequence<typename TypeParam::exec_type>(backend.exec, folder).run(table);
    for (auto const& [stage, result] : table) {
      auto& sum = all[stage];
      sum.items += result.items;
      sum.identical += result.identical;
      sum.max_abs_diff = std::max(sum.max_abs_diff, result.max_abs_diff);
      EXPECT_EQ(result.identical, result.items) << stage << " of " << folder;
    }
  }
  test::print(all, std::string("golden files on ") + TypeParam::name);
  for (char const* stage : {"pyramid", "corners", "distribution", "orientation", "blur", "descriptor",
                            "keypoint_order", "grid", "stereo_rectified", "stereo_fisheye", "search_last_frame", "frustum",
                            "search_local_map", "pose_optimization"}) {
    EXPECT_GT(all[stage].items, 0) << stage << " was not compared";
  }
  // Projections and poses are rounded differently by other builds of the reference, too.
  EXPECT_LT(all["frustum"].max_abs_diff, 4e-3);
  EXPECT_LT(all["pose_optimization"].max_abs_diff, 1e-4);
}

}  // namespace
