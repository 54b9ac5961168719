// SPDX-License-Identifier: Apache-2.0
/// @file The executors that the shim's tests run on. The tests see the interface alone: the host's
/// side is compiled once, in host_maker.cpp, the device's in cuda_backend.cu, and executors.cpp
/// has the one that the program was built with.
#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <vector>

#include "integration/orbslam3/plain_types.hpp"

namespace orbslam3_test {

std::unique_ptr<ft::orbslam3::device_tracker> make_host(ft::orbslam3::settings const& s);
bool cuda_found();
std::unique_ptr<ft::orbslam3::device_tracker> make_cuda(ft::orbslam3::settings const& s);

/// Base of tests over executors, by name: "host" or "cuda". Without a device the tests on "cuda"
/// skip; with FT_REQUIRE_GPU=1 they fail.
class on_executor : public ::testing::TestWithParam<std::string> {
protected:
  void SetUp() override;
  static std::unique_ptr<ft::orbslam3::device_tracker> make(ft::orbslam3::settings const& s);
};

std::vector<std::string> executors();

inline std::string executor_name(::testing::TestParamInfo<std::string> const& info) {
  return info.param;
}

}  // namespace orbslam3_test
