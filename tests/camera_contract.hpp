// SPDX-License-Identifier: Apache-2.0
/// @file What a camera model must do to work in ft, as tests that a user runs on a model of hers.
///
/// Describe the model in one structure and name it, at global scope of one source file:
///
///     struct my_lens : camera_contract::description<my_model> {
///       static constexpr int width = 640, height = 480;
///       static my_model<double> parameters() { return {...}; }   // a real calibration
///     };
///     FT_CAMERA_CONTRACT(my_model, my_lens);
///
/// Compiled as C++ the tests run on the host; as CUDA on host and GPU, and the two are compared bit
/// for bit. Without a device the GPU's tests skip, with FT_REQUIRE_GPU=1 in the environment they
/// fail. A program is compiled by one of the two compilers, not by both. Needs ft and GoogleTest.
#pragma once

#include <gtest/gtest.h>

#include "tests/camera_contract/description.hpp"
#include "tests/camera_contract/model_tests.hpp"
#include "tests/camera_contract/stage_tests.hpp"
#if defined(__CUDACC__)
#include "tests/camera_contract/gpu_tests.hpp"
#endif

/// Runs the contract's tests on a described model. @param name prefix of the tests' names
/// @param lens the description, by its full name; at global scope, once per name
#if defined(__CUDACC__)
#define FT_CAMERA_CONTRACT(name, lens)                                                    \
  namespace camera_contract {                                                             \
  inline namespace FT_ABI {                                                               \
  INSTANTIATE_TYPED_TEST_SUITE_P(name, camera_model, settings<lens>, executor_name);      \
  INSTANTIATE_TYPED_TEST_SUITE_P(name, camera_in_stages, settings<lens>, executor_name);  \
  INSTANTIATE_TYPED_TEST_SUITE_P(name, camera_on_gpu, gpu_settings<lens>, executor_name); \
  }                                                                                       \
  }                                                                                       \
  static_assert(true, "")
#else
#define FT_CAMERA_CONTRACT(name, lens)                                                   \
  namespace camera_contract {                                                            \
  inline namespace FT_ABI {                                                              \
  INSTANTIATE_TYPED_TEST_SUITE_P(name, camera_model, settings<lens>, executor_name);     \
  INSTANTIATE_TYPED_TEST_SUITE_P(name, camera_in_stages, settings<lens>, executor_name); \
  }                                                                                      \
  }                                                                                      \
  static_assert(true, "")
#endif
