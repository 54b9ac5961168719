// SPDX-License-Identifier: Apache-2.0
/// @file What is refused, and how that is said.
#pragma once

#include <gtest/gtest.h>

#include <string>

#include "ft/types/errors.hpp"

namespace test {

/// The message of the error that a call throws; empty if it throws none.
template <typename Error = ft::bad_argument, typename Call>
std::string refusal(Call const& call) {
  try {
    call();
  } catch (Error const& e) { return e.what(); }
  return {};
}

/// Fails where a call is accepted, or refused without this part of a message.
template <typename Error = ft::bad_argument, typename Call>
void expect_refused(Call const& call, std::string const& part) {
  std::string const said = refusal<Error>(call);
  EXPECT_FALSE(said.empty()) << "accepted: " << part;
  EXPECT_NE(said.find(part), std::string::npos) << said;
}

}  // namespace test
