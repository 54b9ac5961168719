// SPDX-License-Identifier: Apache-2.0
/// @file What is said of a map file that was made elsewhere.
#include <gtest/gtest.h>

#include <algorithm>
#include <string>

#include "ft/pipelines/detail/map_origin.hpp"
#include "tests/support/refusals.hpp"

namespace map_origin_test {

TEST(MapOrigin, AStrangersTextIsShownInFewPlainCharacters) {
  auto const rig = ft::rectified_rig::make({200.0f, 200.0f, 120.0f, 90.0f}, 0.11f);
  ft::detail::map_origin const ours(rig, ft::orb_params{}, ft::odometry_map_view{});
  ours.require_same(ours.text());
  for (std::string const part : {"rig", "rectified pair"}) {
    std::string theirs = ours.text();
    theirs.replace(theirs.find(part), part.size(), "\x1b[2J\xff" + std::string(4000, 'x'));
    std::string const said = test::refusal<ft::error>([&] { ours.require_same(theirs); });
    EXPECT_NE(said.find("?[2J?xxx"), std::string::npos) << said;
    EXPECT_LT(said.size(), 250u);
    EXPECT_TRUE(std::all_of(said.begin(), said.end(), [](char c) { return c >= ' ' && c <= '~'; }));
  }
}

}  // namespace map_origin_test
