// SPDX-License-Identifier: Apache-2.0
/// @file Frames at a camera's rate, and the energy that the GPU takes meanwhile.
#pragma once

#include <dlfcn.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <iostream>
#include <thread>
#include <vector>

#include "examples/sequence/reader.hpp"

namespace peers {

/// The value that `percent` of the values do not exceed (nearest rank).
inline double percentile(std::vector<double> values, double percent) {
  std::sort(values.begin(), values.end());
  double const rank = std::ceil(percent / 100 * static_cast<double>(values.size()));
  return values[static_cast<std::size_t>(std::max(rank, 1.0)) - 1];
}

/// The counter of energy of the machine's first GPU: NVML's, opened at run time.
class gpu_energy {
public:
  /// @throws seq::error without NVML, or for a GPU without a counter
  gpu_energy() {
    void* const library = dlopen("libnvidia-ml.so.1", RTLD_NOW);
    if (library == nullptr) { throw seq::error("there is no NVML: libnvidia-ml.so.1"); }
    auto const begin = reinterpret_cast<int (*)()>(dlsym(library, "nvmlInit_v2"));
    auto const find = reinterpret_cast<int (*)(unsigned, void**)>(
        dlsym(library, "nvmlDeviceGetHandleByIndex_v2"));
    read_ = reinterpret_cast<int (*)(void*, unsigned long long*)>(
        dlsym(library, "nvmlDeviceGetTotalEnergyConsumption"));
    bool const found = begin != nullptr && find != nullptr && read_ != nullptr && begin() == 0 &&
                       find(0, &gpu_) == 0;
    if (!found) { throw seq::error("NVML has no counter of energy"); }
    joules();
  }
  /// Since the driver was loaded.
  double joules() const {
    unsigned long long millijoules = 0;
    if (read_(gpu_, &millijoules) != 0) { throw seq::error("the GPU has no counter of energy"); }
    return static_cast<double>(millijoules) / 1e3;
  }

private:
  void* gpu_ = nullptr;
  int (*read_)(void*, unsigned long long*) = nullptr;
};

/// Tracks frames of a sequence, forward and backward in turn, at a rate; before and after as long a
/// pause with the program at rest. Prints a line of JSON: watts of the GPU in both pauses and
/// meanwhile, millijoules of a frame beyond the pauses', ms of a frame.
/// @param track void(stereo_frame const&, time_ns) @param seconds of each of the three parts
template <typename Track>
void run_at_rate(seq::sequence const& sequence, double hz, double seconds, Track&& track) {
  using clock = std::chrono::steady_clock;
  std::vector<seq::stereo_frame> frames;
  for (int i = 0; i < sequence.size(); ++i) { frames.push_back(sequence.load(i)); }
  int const last = static_cast<int>(frames.size()) - 1;
  std::vector<double> ms;
  int given = 0;
  auto const track_for = [&](int count) {
    auto const begin = clock::now();
    ms.clear();
    for (int k = 0; k < count; ++k, ++given) {
      std::this_thread::sleep_until(begin + std::chrono::duration_cast<clock::duration>(
                                                std::chrono::duration<double>(k / hz)));
      int const i = last == 0 ? 0 : given % (2 * last);
      auto const time_ns = static_cast<std::int64_t>(std::llround(given * 1e9 / hz));
      auto const start = clock::now();
      track(frames[static_cast<std::size_t>(i <= last ? i : 2 * last - i)], time_ns);
      ms.push_back(std::chrono::duration<double, std::milli>(clock::now() - start).count());
    }
  };
  gpu_energy const gpu;
  auto const watts_of = [&](auto&& work) {
    auto const begin = clock::now();
    double const joules = gpu.joules();
    work();
    return (gpu.joules() - joules) / std::chrono::duration<double>(clock::now() - begin).count();
  };
  auto const rest = [&] { std::this_thread::sleep_for(std::chrono::duration<double>(seconds)); };
  track_for(static_cast<int>(2 * hz));
  double const before = watts_of(rest);
  double const busy = watts_of([&] { track_for(static_cast<int>(seconds * hz)); });
  double const after = watts_of(rest);
  std::cout << "{\"hz\": " << hz << ", \"frames\": " << ms.size()
            << ", \"watts_before\": " << before << ", \"watts\": " << busy
            << ", \"watts_after\": " << after
            << ", \"millijoules\": " << 1e3 * (busy - (before + after) / 2) / hz
            << ", \"ms_p50\": " << percentile(ms, 50) << ", \"ms_p99\": " << percentile(ms, 99)
            << "}\n";
}

}  // namespace peers
