// SPDX-License-Identifier: Apache-2.0
/// @file Exceptions of the library. Caught in any unit of a program, whatever compiler made it.
#pragma once

#include <stdexcept>

#include "ft/core/config.hpp"

namespace ft {
inline namespace v0 {

/// Base of everything ft throws.
class FT_VISIBLE error : public std::runtime_error {
public:
  using std::runtime_error::runtime_error;
};

/// An argument out of range; the message names it, its value and the limit.
class FT_VISIBLE bad_argument : public error {
public:
  using error::error;
};

/// A CUDA call failed; the message contains the call and CUDA's description.
class FT_VISIBLE cuda_error : public error {
public:
  using error::error;
};

}  // namespace v0
}  // namespace ft
