// SPDX-License-Identifier: Apache-2.0
#include <stdexcept>

#include "tests/conformance/backends.hpp"
#include "tests/conformance/golden_case.hpp"

namespace conformance {

table run_host(std::string const& folder) {
  return plain(test::run_golden(ft::host_exec(), folder));
}

#if !FT_APP_HAS_CUDA
bool cuda_available() { return false; }
table run_cuda(std::string const&) {
  throw std::runtime_error("this program was built without CUDA");
}
#endif

}  // namespace conformance
