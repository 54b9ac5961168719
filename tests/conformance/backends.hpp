// SPDX-License-Identifier: Apache-2.0
/// @file The comparison behind plain types, so that both executors live in one program.
#pragma once

#include <map>
#include <string>

namespace conformance {

struct figures {
  long items = 0;
  long identical = 0;
  double max_abs_diff = 0;
};
using table = std::map<std::string, figures>;

table run_host(std::string const& folder);
bool cuda_available();
/// @throws std::runtime_error where there is no CUDA device, or the program was built without CUDA
table run_cuda(std::string const& folder);

/// Figures of one folder on an executor, as plain types.
template <typename Table>
table plain(Table const& from) {
  table to;
  for (auto const& [name, r] : from) { to[name] = {r.items, r.identical, r.max_abs_diff}; }
  return to;
}

}  // namespace conformance
