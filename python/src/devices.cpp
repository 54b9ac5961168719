// SPDX-License-Identifier: Apache-2.0
// Without CUDA there are no devices, and nothing to make on them.
#include "python/src/api.hpp"

#if !FT_PYTHON_HAS_CUDA
namespace ftpy {

std::vector<std::string> cuda_devices() { return {}; }

namespace cuda {
namespace {
[[noreturn]] void refuse() {
  throw argument_error("device 'cuda': the package was built without CUDA");
}
}  // namespace

std::unique_ptr<features> make_features(feature_options const&, int, rig const&) { refuse(); }
std::unique_ptr<odometry> make_rectified_odometry(odometry_options const&) { refuse(); }
std::unique_ptr<odometry> make_distorted_odometry(odometry_options const&) { refuse(); }
std::unique_ptr<odometry> make_fisheye_odometry(odometry_options const&) { refuse(); }
std::unique_ptr<odometry> make_rgbd_odometry(odometry_options const&) { refuse(); }
std::unique_ptr<odometry> make_monocular_odometry(odometry_options const&) { refuse(); }
std::unique_ptr<odometry> make_multi_odometry(odometry_options const&) { refuse(); }
std::unique_ptr<rectifier> make_rectifier(rig const&, int, int, int) { refuse(); }
std::unique_ptr<places> make_places(place_options const&) { refuse(); }

}  // namespace cuda
}  // namespace ftpy
#endif
