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

/// What f() returns; mistakes of the caller as argument_error.
template <typename F>
auto translated(F&& f) {
  try {
    return f();
  } catch (ft::bad_argument const& e) {
    std::string const text = e.what();
    throw argument_error(text.rfind("ft: ", 0) == 0 ? text.substr(4) : text);
  }
}

inline float narrow(double v) { return static_cast<float>(v); }

inline ft::gray_view to_ft(image const& v) { return {v.data, v.width, v.height, v.stride}; }

inline ft::rigid<double> to_ft(pose const& m) {
  ft::rigid<double> T;
  for (std::size_t r = 0; r < 3; ++r) {
    for (std::size_t c = 0; c < 3; ++c) { T.R.m[3 * r + c] = m[4 * r + c]; }
  }
  T.t = {m[3], m[7], m[11]};
  return T;
}
inline pose from_ft(ft::rigid<double> const& T) {
  pose m{};
  for (std::size_t r = 0; r < 3; ++r) {
    for (std::size_t c = 0; c < 3; ++c) { m[4 * r + c] = T.R.m[3 * r + c]; }
  }
  m[3] = T.t.x;
  m[7] = T.t.y;
  m[11] = T.t.z;
  m[15] = 1;
  return m;
}

/// The parameters of a model in its own order. Distortion may be left out, and is 0 then.
template <typename Camera>
Camera camera_of(std::vector<double> values, char const* which) {
  constexpr std::size_t most = sizeof(Camera) / sizeof(float);
  if constexpr (most == 12) { complete_radtan(values, "the " + std::string(which) + " camera"); }
  if (values.size() != 4 && values.size() != most) {
    throw argument_error("the " + std::string(which) + " camera has " +
                         std::to_string(values.size()) + " parameters, must have 4" +
                         (most > 4 ? " or " + std::to_string(most) : ": fx, fy, cx, cy"));
  }
  values.resize(most);
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

inline ft::orb_params orb_params_of(feature_options const& o) {
  ft::orb_params p;
  p.width = o.width;
  p.height = o.height;
  p.features = o.features;
  p.levels = o.levels;
  p.scale_factor = narrow(o.scale_factor);
  p.ini_threshold = o.ini_threshold;
  p.min_threshold = o.min_threshold;
  p.mask_width = o.mask_width;
  p.mask_height = o.mask_height;
  p.ties = o.std_sort ? ft::tie_rule::std_sort : ft::tie_rule::stable;
  return p;
}

using kannala_brandt_rig = ft::stereo_rig<ft::kannala_brandt<float>, ft::kannala_brandt<float>>;

inline ft::rectified_rig rectified_of(rig const& r) {
  return ft::rectified_rig::make(camera_of<ft::pinhole<float>>(r.left, "left"), r.baseline);
}
constexpr int most_cameras = 16;  ///< of a multi_rig

/// @tparam N at least as many as there are; the others are not used
template <int N>
ft::multi_rig<N> multi_of(rig const& r) {
  std::size_t const n = r.cameras.size();
  if (n < 1 || n > most_cameras) {
    throw argument_error("the rig has " + std::to_string(n) + " cameras, must have 1 to " +
                         std::to_string(most_cameras));
  }
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
