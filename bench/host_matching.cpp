// SPDX-License-Identifier: Apache-2.0
#include "bench/matching_runner.hpp"

namespace bench {

std::unique_ptr<matching_runner> make_host_matching(matching_case const& what) {
  return make_matching<ft::host_exec>(what);
}

}  // namespace bench
