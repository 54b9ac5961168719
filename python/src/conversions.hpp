// SPDX-License-Identifier: Apache-2.0
/// @file Plain types as types of ft, and the executor of a unit: host threads under a C++ compiler,
/// a stream of its own under nvcc.
#pragma once

#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include "ft/cameras/distorted_pair.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "ft/types/poses.hpp"
#include "python/src/api.hpp"

#if defined(__CUDACC__)
#define FTPY_DEVICE cuda
#else
#define FTPY_DEVICE host
#endif

namespace ftpy {

#if defined(__CUDACC__)
using exec_type = ft::cuda_exec;
/// A base class: it outlives the members of what derives from it.
struct executor {
  explicit executor(int) {}
  void wait_for_stream(std::uintptr_t stream) {
    written.record(reinterpret_cast<cudaStream_t>(stream));
    written.make_wait(own.get());
  }
  ft::stream own;
  ft::event written;
  ft::cuda_exec exec{own.get()};
  int device = current_device();

private:
  static int current_device() {
    int i = 0;
    ft::throw_on_error(cudaGetDevice(&i), "cudaGetDevice");
    return i;
  }
};
#else
using exec_type = ft::host_exec;
struct executor {
  explicit executor(int threads) : exec(threads) {}
  void wait_for_stream(std::uintptr_t) {}
  ft::host_exec exec;
  int device = 0;
};
#endif

/// The parameters of a model in its own order.
template <typename Camera>
Camera camera_of(std::vector<double> values, char const* which) {
  constexpr std::size_t most = sizeof(Camera) / sizeof(float);
  complete(values, most, which);
  Camera c{};
  c.fx = narrow(values[0]);
  c.fy = narrow(values[1]);
  c.cx = narrow(values[2]);
  c.cy = narrow(values[3]);
  if constexpr (most == 8) {
    c.k1 = narrow(values[4]);
    c.k2 = narrow(values[5]);
    c.k3 = narrow(values[6]);
    c.k4 = narrow(values[7]);
  } else if constexpr (most == 12) {
    for (std::size_t i = 4; i < most; ++i) { c.distortion[i - 4] = narrow(values[i]); }
  }
  return c;
}

using kannala_brandt_rig = ft::stereo_rig<ft::kannala_brandt<float>, ft::kannala_brandt<float>>;

inline ft::rectified_rig rectified_of(rig const& r) {
  return ft::rectified_rig::make(camera_of<ft::pinhole<float>>(r.left, "left"), r.baseline);
}

/// @tparam N at least as many as there are; the others are not used
template <int N>
ft::multi_rig<N> multi_of(rig const& r) {
  std::size_t const n = cameras_of(r);
  ft::multi_rig<N> all{};
  for (ft::rig_camera& c : all.of) { c = ft::rig_camera::none(); }
  for (std::size_t i = 0; i < n; ++i) {
    rig_camera const& given = r.cameras[i];
    all.of[i] = {camera_of<ft::pinhole<float>>(given.camera, "rig's"), given.baseline,
                 to_ft(given.T_camera_body).cast<float>()};
  }
  return all;
}
inline kannala_brandt_rig fisheye_of(rig const& r) {
  return {camera_of<ft::kannala_brandt<float>>(r.left, "left"),
          camera_of<ft::kannala_brandt<float>>(r.right, "right"),
          to_ft(r.T_right_left).cast<float>()};
}
inline ft::distorted_pair<ft::radtan8<float>> distorted_of(rig const& r) {
  using camera = ft::radtan8<float>;
  auto pair = ft::distorted_pair<camera>::make(
      camera_of<camera>(r.left, "left"), camera_of<camera>(r.right, "right"),
      to_ft(r.T_right_left).cast<float>(), camera_of<ft::pinhole<float>>(r.wanted, "wanted"));
  pair.width = r.raw_width;
  pair.height = r.raw_height;
  pair.check();
  return pair;
}

}  // namespace ftpy
