// SPDX-License-Identifier: Apache-2.0
#include "bench/words_runner.hpp"

namespace bench {

std::unique_ptr<words_runner> make_host_words(words_case const& what) {
  return make_words_runner_of<ft::host_exec>(what);
}

}  // namespace bench
