// SPDX-License-Identifier: Apache-2.0
#include "bench/measure.hpp"

namespace bench {

std::vector<measurement> run_host(scene const& s, settings const& how) {
  std::vector<measurement> out;
  measure(ft::host_exec(), "host", s, how, out);
  return out;
}

#if !FT_BENCH_HAS_CUDA
std::vector<measurement> run_cuda(scene const&, settings const&) { return {}; }
std::string cuda_description() { return {}; }
#endif

}  // namespace bench
