// SPDX-License-Identifier: Apache-2.0
#include "tests/support/npy.hpp"

#include <gtest/gtest.h>

#include <cstdint>
#include <cstdio>
#include <fstream>
#include <stdexcept>
#include <string>

namespace npy_files {

std::string error_of(std::string const& path) {
  try {
    test::read_npy<std::uint8_t>(path);
  } catch (std::runtime_error const& e) { return e.what(); }
  return "";
}

TEST(npy_file, one_that_is_missing_is_called_missing) {
  EXPECT_EQ(error_of("/nowhere/at_all.npy"), "/nowhere/at_all.npy: missing");
}

TEST(npy_file, another_file_is_not_called_missing) {
  std::string const path = ::testing::TempDir() + "not_an_array.npy";
  std::ofstream(path) << "something else";
  EXPECT_EQ(error_of(path), path + ": not an npy 1.0 file");
  std::remove(path.c_str());
}

}  // namespace npy_files
