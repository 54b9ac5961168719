// SPDX-License-Identifier: Apache-2.0
/// @file What the soaks share: a camera before a wall, a digest of results, the executor.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <string>
#include <vector>

#if defined(__GLIBC__)
#include <malloc.h>
#endif

#include "ft/cameras/stereo_rig.hpp"
#include "ft/core/execution.hpp"

namespace soak_scene {

constexpr int width = 320;
constexpr int height = 240;
constexpr std::size_t pixels = static_cast<std::size_t>(width) * height;

using image = std::vector<std::uint8_t>;

inline ft::rectified_rig rig() { return ft::rectified_rig::make({200, 200, 159.5f, 119.5f}, 0.2f); }

inline image noise(unsigned seed) {
  std::mt19937 random(seed);
  image out(pixels);
  for (auto& p : out) { p = static_cast<std::uint8_t>(random()); }
  return out;
}

/// Blocks of several sizes, each with a grey of its own, at (s, t) texels.
inline std::uint8_t texture(double s, double t) {
  unsigned grey = 0;
  for (int const block : {37, 17, 7}) {
    auto const x = static_cast<unsigned>(static_cast<int>(std::floor(s)) / block);
    auto const y = static_cast<unsigned>(static_cast<int>(std::floor(t)) / block);
    unsigned h = x * 73856093u ^ y * 19349663u ^ static_cast<unsigned>(block) * 83492791u;
    h = (h ^ h >> 13) * 0x5bd1e995u;
    grey += (h ^ h >> 15) % 86;
  }
  return static_cast<std::uint8_t>(grey);
}

/// A tilted wall, 2 to 4 m away, from a camera at `x` metres to the right of the start.
inline image render(double x, double z) {
  auto const camera = rig().camera.cast<double>();
  image out(pixels);
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      auto const d = camera.unproject({static_cast<double>(u), static_cast<double>(v)}).direction;
      double const depth = (3 - 0.3 * x - z) / (0.3 * d.x + 0.1 * d.y + 1);
      out[static_cast<std::size_t>(v * width + u)] =
          texture((x + depth * d.x + 100) * 90, (depth * d.y + 100) * 90);
    }
  }
  return out;
}

/// FNV-1a over words of memory.
class digest {
public:
  template <typename T>
  void add(T const* data, std::size_t count) {
    auto const* bytes = reinterpret_cast<unsigned char const*>(data);
    for (std::size_t i = 0; i < count * sizeof(T); ++i) {
      value_ = (value_ ^ bytes[i]) * 1099511628211ull;
    }
  }
  std::uint64_t value() const { return value_ == 0 ? 1 : value_; }

private:
  std::uint64_t value_ = 14695981039346656037ull;
};

/// Calls run(exec) on the device where nvcc compiles this, else on the host's threads.
/// @return its result; 77 without a device, or a failure where FT_REQUIRE_GPU=1
template <typename Run>
int on_backend(Run const& run) {
  // Large blocks go back to the system when they are freed: else the allocator, which learns from
  // the first ones to keep them, holds pages of trackers that are gone, and they look like growth.
#if defined(__GLIBC__)
  mallopt(M_MMAP_THRESHOLD, 1 << 16);
  mallopt(M_TRIM_THRESHOLD, 1 << 16);
#endif
#if defined(__CUDACC__)
  int devices = 0;
  if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
    std::puts("no CUDA device was found: nothing was run");
    char const* const required = std::getenv("FT_REQUIRE_GPU");
    return required != nullptr && std::string(required) == "1" ? EXIT_FAILURE : 77;
  }
  cudaStream_t stream = nullptr;
  ft::throw_on_error(cudaStreamCreateWithFlags(&stream, cudaStreamNonBlocking),
                     "cudaStreamCreateWithFlags");
  int const status = run(ft::cuda_exec(stream));
  static_cast<void>(cudaStreamDestroy(stream));
  return status;
#else
  return run(ft::host_exec());
#endif
}

}  // namespace soak_scene
