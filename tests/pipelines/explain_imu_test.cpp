// SPDX-License-Identifier: Apache-2.0
// Whether an IMU is used, and why not: each state and each reason.
#include <gtest/gtest.h>

#include <cstddef>
#include <set>
#include <string>

#include "ft/pipelines/explain.hpp"

namespace explain_imu_test {

using estimate = ft::initialization_status;
using samples = ft::integration_status;

ft::imu_tracking imu_of(bool known, bool optimized, samples s, estimate e) {
  ft::imu_tracking t;
  t.known = known;
  t.optimized = optimized;
  t.samples = s;
  t.estimate = e;
  return t;
}

void expect(ft::imu_tracking const& t, ft::imu_state state, std::string const& reason,
            std::string const& words) {
  ft::imu_explanation const found = ft::explain_imu(t);
  EXPECT_EQ(found.state, state) << reason;
  EXPECT_EQ(found.reason, reason);
  EXPECT_NE(found.text.find(words), std::string::npos) << found.text;
}

TEST(explain_imu, samples_that_are_not_usable_come_first) {
  expect(imu_of(false, false, samples::no_samples, estimate::few_keyframes),
         ft::imu_state::initialising, "no_samples", "no samples since");
  expect(imu_of(true, false, samples::gap, estimate::initialized), ft::imu_state::known, "gap",
         "more than 0.1 s");
  expect(imu_of(true, false, samples::contradicted, estimate::initialized), ft::imu_state::known,
         "contradicted", "contradict");
}

TEST(explain_imu, what_is_not_known_has_the_reason_of_its_estimate) {
  expect(imu_of(false, false, samples::integrated, estimate::few_keyframes),
         ft::imu_state::initialising, "few_keyframes", "8 keyframes in a row");
  expect(imu_of(false, false, samples::repeated, estimate::little_motion),
         ft::imu_state::initialising, "little_motion", "uncertain");
  expect(imu_of(false, false, samples::integrated, estimate::inconsistent),
         ft::imu_state::initialising, "inconsistent", "contradict");
}

TEST(explain_imu, what_is_used_needs_no_reason) {
  expect(imu_of(true, false, samples::integrated, estimate::at_rest), ft::imu_state::known,
         "no_pose", "no pose");
  ft::imu_explanation const used =
      ft::explain_imu(imu_of(true, true, samples::integrated, estimate::at_rest));
  EXPECT_EQ(used.state, ft::imu_state::used);
  EXPECT_STREQ(used.reason, "none");
  EXPECT_EQ(used.text, "");
}

// Two names that are one would hide a reason.
TEST(explain_imu, each_name_and_each_sentence_is_another) {
  std::set<std::string> words, texts;
  int statuses = 0;
  for (int s = 0; s <= static_cast<int>(samples::contradicted); ++s) {
    auto const status = static_cast<samples>(s);
    words.insert(ft::name_of(status));
    if (ft::usable(status)) { continue; }
    ++statuses;
    texts.insert(ft::explain_imu(imu_of(false, false, status, estimate::initialized)).text);
  }
  EXPECT_EQ(words.size(), 11U);
  std::set<std::string> estimates;
  for (int e = 0; e <= static_cast<int>(estimate::inconsistent); ++e) {
    auto const status = static_cast<estimate>(e);
    estimates.insert(ft::name_of(status));
    if (status == estimate::initialized || status == estimate::at_rest) { continue; }
    ++statuses;
    texts.insert(ft::explain_imu(imu_of(false, false, samples::integrated, status)).text);
  }
  EXPECT_EQ(estimates.size(), 7U);
  EXPECT_EQ(texts.size(), static_cast<std::size_t>(statuses));
  std::set<std::string> states;
  for (auto const s : {ft::imu_state::initialising, ft::imu_state::known, ft::imu_state::used}) {
    states.insert(ft::name_of(s));
  }
  EXPECT_EQ(states, (std::set<std::string>{"initialising", "known", "used"}));
}

}  // namespace explain_imu_test
