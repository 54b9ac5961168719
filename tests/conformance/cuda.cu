// SPDX-License-Identifier: Apache-2.0
#include "tests/conformance/backends.hpp"
#include "tests/conformance/golden_case.hpp"

namespace conformance {

bool cuda_available() {
  int devices = 0;
  bool const found = cudaGetDeviceCount(&devices) == cudaSuccess && devices > 0;
  static_cast<void>(cudaGetLastError());
  return found;
}

table run_cuda(std::string const& folder) {
  cudaStream_t stream = nullptr;
  ft::throw_on_error(cudaStreamCreateWithFlags(&stream, cudaStreamNonBlocking), "cudaStreamCreate");
  auto const t = test::run_golden(ft::cuda_exec(stream), folder);
  ft::throw_on_error(cudaStreamDestroy(stream), "cudaStreamDestroy");
  return plain(t);
}

}  // namespace conformance
