// SPDX-License-Identifier: Apache-2.0
#include "bench/runner.hpp"

namespace bench {

std::unique_ptr<frame_runner> make_host_rectified(scene const& s, frame_options const& how);
std::unique_ptr<frame_runner> make_host_fisheye(scene const& s, frame_options const& how);
std::unique_ptr<odometry_runner> make_host_odometry(scene const& s, frame_options const& how);
std::unique_ptr<camera_runner> make_host_cameras(int threads, int points, int sets);
std::unique_ptr<window_runner> make_host_windows(window_case const& what);
std::unique_ptr<matching_runner> make_host_matching(matching_case const& what);
std::unique_ptr<inertial_runner> make_host_inertial(inertial_case const& what);
std::unique_ptr<words_runner> make_host_words(words_case const& what);

#if FT_BENCH_HAS_CUDA
std::unique_ptr<frame_runner> make_cuda_rectified(scene const& s, frame_options const& how);
std::unique_ptr<frame_runner> make_cuda_fisheye(scene const& s, frame_options const& how);
std::unique_ptr<odometry_runner> make_cuda_odometry(scene const& s, frame_options const& how);
std::unique_ptr<camera_runner> make_cuda_cameras(int points, int sets);
std::unique_ptr<window_runner> make_cuda_windows(window_case const& what);
std::unique_ptr<matching_runner> make_cuda_matching(matching_case const& what);
std::unique_ptr<inertial_runner> make_cuda_inertial(inertial_case const& what);
std::unique_ptr<words_runner> make_cuda_words(words_case const& what);
#else
namespace {
[[noreturn]] void no_cuda() { throw std::runtime_error("built without CUDA"); }
std::unique_ptr<frame_runner> make_cuda_rectified(scene const&, frame_options const&) { no_cuda(); }
std::unique_ptr<frame_runner> make_cuda_fisheye(scene const&, frame_options const&) { no_cuda(); }
std::unique_ptr<odometry_runner> make_cuda_odometry(scene const&, frame_options const&) {
  no_cuda();
}
std::unique_ptr<camera_runner> make_cuda_cameras(int, int) { no_cuda(); }
std::unique_ptr<window_runner> make_cuda_windows(window_case const&) { no_cuda(); }
std::unique_ptr<matching_runner> make_cuda_matching(matching_case const&) { no_cuda(); }
std::unique_ptr<inertial_runner> make_cuda_inertial(inertial_case const&) { no_cuda(); }
std::unique_ptr<words_runner> make_cuda_words(words_case const&) { no_cuda(); }
}  // namespace
std::string cuda_description() { return {}; }
int cuda_devices() { return 0; }
void use_cuda_device(int) { no_cuda(); }
double device_bytes_in_use() { no_cuda(); }
#endif

std::unique_ptr<frame_runner> make_frame_runner(scene const& s, frame_options const& how) {
  bool const rectified = s.rig == rig_type::rectified;
  if (how.backend == backend_type::host) {
    return rectified ? make_host_rectified(s, how) : make_host_fisheye(s, how);
  }
  return rectified ? make_cuda_rectified(s, how) : make_cuda_fisheye(s, how);
}

std::unique_ptr<odometry_runner> make_odometry_runner(scene const& s, frame_options const& how) {
  return how.backend == backend_type::host ? make_host_odometry(s, how)
                                           : make_cuda_odometry(s, how);
}

std::unique_ptr<camera_runner> make_camera_runner(backend_type backend, int host_threads,
                                                  int points, int sets) {
  return backend == backend_type::host ? make_host_cameras(host_threads, points, sets)
                                       : make_cuda_cameras(points, sets);
}

std::unique_ptr<window_runner> make_window_runner(window_case const& what) {
  return what.backend == backend_type::host ? make_host_windows(what) : make_cuda_windows(what);
}

std::unique_ptr<matching_runner> make_matching_runner(matching_case const& what) {
  return what.backend == backend_type::host ? make_host_matching(what) : make_cuda_matching(what);
}

std::unique_ptr<inertial_runner> make_inertial_runner(inertial_case const& what) {
  return what.backend == backend_type::host ? make_host_inertial(what) : make_cuda_inertial(what);
}

std::unique_ptr<words_runner> make_words_runner(words_case const& what) {
  return what.backend == backend_type::host ? make_host_words(what) : make_cuda_words(what);
}

}  // namespace bench
