// SPDX-License-Identifier: Apache-2.0
#include "bench/matching_runner.hpp"

namespace bench {

std::unique_ptr<matching_runner> make_cuda_matching(matching_case const& what) {
  return make_matching<ft::cuda_exec>(what);
}

}  // namespace bench
