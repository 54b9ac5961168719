// SPDX-License-Identifier: Apache-2.0
#include "bench/measure.hpp"

namespace bench {

std::string cuda_description() {
  int devices = 0;
  cudaDeviceProp properties;
  int driver = 0;
  int runtime = 0;
  if (cudaGetDeviceCount(&devices) != cudaSuccess || devices < 1 ||
      cudaGetDeviceProperties(&properties, 0) != cudaSuccess ||
      cudaDriverGetVersion(&driver) != cudaSuccess ||
      cudaRuntimeGetVersion(&runtime) != cudaSuccess) {
    static_cast<void>(cudaGetLastError());
    return {};
  }
  auto const version = [](int v) {
    return std::to_string(v / 1000) + "." + std::to_string(v % 1000 / 10);
  };
  return std::string(properties.name) + ", driver for CUDA " + version(driver) + ", runtime " +
         version(runtime);
}

std::vector<measurement> run_cuda(scene const& s, settings const& how) {
  if (cuda_description().empty()) { return {}; }
  cudaStream_t stream = nullptr;
  ft::detail::check(cudaStreamCreateWithFlags(&stream, cudaStreamNonBlocking), "cudaStreamCreate");
  std::vector<measurement> out;
  measure(ft::cuda_exec(stream), "cuda", s, how, out);
  ft::detail::check(cudaStreamDestroy(stream), "cudaStreamDestroy");
  return out;
}

}  // namespace bench
