// SPDX-License-Identifier: Apache-2.0
/// @file What a descriptor must do to work in ft, as tests that a user runs on a model of hers.
///
/// Describe the model in one structure and name it, at global scope of one source file:
///
///     struct my_rows : descriptor_contract::description<my_descriptor> {
///       static my_descriptor draw(std::mt19937& random) { return {...}; }  // a row as there may
///       be
///     };
///     FT_DESCRIPTOR_CONTRACT(my_descriptor, my_rows);
///
/// Compiled as C++ the tests run on the host; as CUDA on host and GPU, and the two are compared bit
/// for bit. Without a device the GPU's tests skip, with FT_REQUIRE_GPU=1 in the environment they
/// fail. A program is compiled by one of the two compilers, not by both. Needs ft and GoogleTest.
#pragma once

#include <gtest/gtest.h>

#include "tests/descriptor_contract/model_tests.hpp"

/// Runs the contract's tests on a described model. @param name prefix of the tests' names
/// @param rows the description, by its full name; at global scope, once per name
#define FT_DESCRIPTOR_CONTRACT(name, rows)                                                \
  namespace descriptor_contract {                                                         \
  inline namespace FT_ABI {                                                               \
  INSTANTIATE_TYPED_TEST_SUITE_P(name, descriptor_model, settings<rows>, executor_name);  \
  INSTANTIATE_TYPED_TEST_SUITE_P(name, descriptor_stages, settings<rows>, executor_name); \
  }                                                                                       \
  }                                                                                       \
  static_assert(true, "")
