// SPDX-License-Identifier: Apache-2.0
// Without CUDA there is nothing to make on a device.
#include "python/src/api.hpp"

#if !FT_PYTHON_HAS_CUDA
namespace ftpy {

namespace cuda {
namespace {
[[noreturn]] void refuse() {
  throw argument_error("device 'cuda': the package was built without CUDA");
}
}  // namespace

std::unique_ptr<features> make_features(feature_options const&, int, rig const&) { refuse(); }
std::unique_ptr<rectifier> make_rectifier(rig const&, int, int, int) { refuse(); }
std::unique_ptr<places> make_places(place_options const&) { refuse(); }

}  // namespace cuda
}  // namespace ftpy
#endif
