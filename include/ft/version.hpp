// SPDX-License-Identifier: Apache-2.0
/// @file The version. CMake reads it from here, so it is changed only here.
#pragma once

#define FT_VERSION_MAJOR 0
#define FT_VERSION_MINOR 1
#define FT_VERSION_PATCH 0

namespace ft {

inline constexpr int version_major = FT_VERSION_MAJOR;
inline constexpr int version_minor = FT_VERSION_MINOR;
inline constexpr int version_patch = FT_VERSION_PATCH;

}  // namespace ft
