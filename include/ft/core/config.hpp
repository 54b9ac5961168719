// SPDX-License-Identifier: Apache-2.0
/// @file Macros that the other headers share.
#pragma once

#if (defined(_MSVC_LANG) ? _MSVC_LANG : __cplusplus) < 201703L
#error "ft needs C++17 or newer: compile with -std=c++17"
#endif

// Fast-math arithmetic ignores NaN, which ft's tests rely on, and reorders sums: every search may
// silently find nothing. nvcc defines no macro for its own --use_fast_math, which breaks the same
// rules.
#if !defined(FT_ALLOW_FAST_MATH) &&                                                       \
    (defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__) || \
     defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__))
#error \
    "ft needs standard floating point: compile without -ffast-math, -Ofast and their parts, or define FT_ALLOW_FAST_MATH to take any answer"
#endif

#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 700
#error "ft needs compute capability 7.0 or newer: its kernels load and add with acquire and release"
#endif

/// Marks a function that runs on both executors. Empty unless the compiler is a CUDA compiler.
/// FT_ABI names the inline namespace: a host unit and a CUDA unit of one program keep separate
/// instantiations, so neither breaks the other's one-definition rule. The types of ft/types are
/// passive: they have one name, v0, in all units, and call nothing that has another. FT_HIDDEN
/// keeps kernels and the functions that launch them private to each shared library. FT_VISIBLE is
/// for exceptions, which are caught in any.
#if defined(__CUDACC__)
#define FT_HOST_DEVICE __host__ __device__
#define FT_BACKEND cuda
#else
#define FT_HOST_DEVICE
#define FT_BACKEND host
#endif
/// A unit whose odometries compare another descriptor than ORB's defines FT_DESCRIPTOR as the name
/// of a structure at global scope, see containers/keypoints.hpp; its instantiations are its own,
/// too.
#define FT_JOIN_NAMES(a, b, c) a##b##c
#define FT_JOINED(a, b, c) FT_JOIN_NAMES(a, b, c)
#if defined(FT_DESCRIPTOR)
#define FT_ABI FT_JOINED(FT_JOINED(v0_, FT_BACKEND, _), FT_DESCRIPTOR, )
#else
#define FT_ABI FT_JOINED(v0_, FT_BACKEND, )
#define FT_WITHOUT_DESCRIPTOR  // keypoints.hpp refuses one that is defined later
#endif

#if defined(__GNUC__)
#define FT_HIDDEN __attribute__((visibility("hidden")))
#define FT_VISIBLE __attribute__((visibility("default")))
#else
#define FT_HIDDEN
#define FT_VISIBLE
#endif

/// FT_WIDE marks a host function that is compiled, with everything it calls, for AVX2 and POPCNT in
/// programs that are built for older processors. FT_HAS_WIDE tells whether the compiler supports
/// that. Results stay the same: no fused products come with these instructions.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__AVX2__)
#define FT_WIDE __attribute__((target("avx2,popcnt"), flatten))
#define FT_HAS_WIDE 1
#else
#define FT_WIDE
#define FT_HAS_WIDE 0
#endif

/// Marks the inner functions of such a stage: inlined on the host, so that they are compiled for
/// wide vectors with the stage. Compilers without FT_WIDE need no such mark.
#if defined(__GNUC__) && !defined(__CUDA_ARCH__)
#define FT_INLINE inline __attribute__((always_inline))
#else
#define FT_INLINE inline
#endif

/// FT_STAGES_ELSEWHERE, defined before ft is included: the unit calls stages, which are most of
/// what a compiler makes of ft, but does not compile them. Another unit of the program has to call
/// the same stages without it, or the static library ft::odometry does; the linker names those that
/// nobody has. FT_OUT_OF_LINE marks what such a unit calls: compiled as it is written, for any
/// caller.
#if defined(__clang__)
#define FT_OUT_OF_LINE __attribute__((noinline))
#elif defined(__GNUC__)
#define FT_OUT_OF_LINE __attribute__((noipa))
#else
#define FT_OUT_OF_LINE
#endif

/// FT_STAGES_ALONE, of ft's own library: the unit compiles all host stages that its functions call,
/// and not the functions, if these are inline and nobody calls them. With FT_STAGES_ELSEWHERE the
/// same text is the other half. So stages are optimised, and what launches them a few times a frame
/// takes the compiler little.
#if defined(FT_STAGES_ALONE)
#define FT_EMITTED __attribute__((used))
#else
#define FT_EMITTED
#endif

#if defined(__CUDA_ARCH__)
#define FT_UNROLL _Pragma("unroll")
#define FT_NO_UNROLL _Pragma("unroll 1")
#else
#define FT_UNROLL
#define FT_NO_UNROLL
#endif
