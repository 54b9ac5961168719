// SPDX-License-Identifier: Apache-2.0
// Cameras with any parameters on any point and pixel, and poses from any observations: nothing may
// fault, what a model calls valid is a number, and a pose is the start or a rigid motion.
#include <cmath>
#include <cstring>
#include <type_traits>
#include <vector>

#include "ft/cameras/double_sphere.hpp"
#include "ft/cameras/field_of_view.hpp"
#include "ft/cameras/image_domain.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/cameras/unified.hpp"
#include "ft/kernels/pose/optimize_pose.hpp"
#include "tests/fuzz/input.hpp"

namespace {

/// A model is its parameters and nothing else, so any numbers make one.
template <typename Camera>
Camera any_camera(fuzz::input& in) {
  constexpr int n = static_cast<int>(sizeof(Camera) / sizeof(float));
  static_assert(n == ft::num_params_v<Camera> && std::is_trivially_copyable<Camera>::value,
                "made of its parameters");
  float values[n];
  for (int i = 0; i < n; ++i) { values[i] = i < 4 ? in.number(50, 400) : in.number(-1, 1.5f); }
  Camera camera;
  std::memcpy(&camera, values, sizeof camera);
  return camera;
}

template <typename Camera>
void use(fuzz::input& in) {
  auto const camera = any_camera<Camera>(in);
  bool const good = fuzz::accepted<ft::bad_argument>([&] { camera.check(); });
  for (int i = 0; i < 8; ++i) {
    bool const plain = in.flag();
    auto const number = [&](float range) {
      return plain ? in.number(-range, range) : in.bits<float>();
    };
    ft::vec3<float> const p{number(5), number(5), number(5)};
    auto const at = camera.project(p);
    static_cast<void>(camera.project_with_jacobian(p));
    ft::vec2<float> const pixel{number(800), number(600)};
    auto const ray = camera.unproject(pixel);
    bool const sane = std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z) &&
                      std::fabs(p.x) + std::fabs(p.y) + std::fabs(p.z) < 1e3f;
    if (good && plain && sane && at.valid) {
      fuzz::require(!std::isnan(at.pixel.x) && !std::isnan(at.pixel.y),
                    "the pixel of a valid projection is a number");
    }
    if (good && plain && ray.valid) {
      fuzz::require(!std::isnan(ray.direction.x) && !std::isnan(ray.direction.y) &&
                        !std::isnan(ray.direction.z),
                    "a valid ray is made of numbers");
    }
    auto const wide = camera.template cast<double>();
    static_cast<void>(wide.project(
        {static_cast<double>(p.x), static_cast<double>(p.y), static_cast<double>(p.z)}));
    static_cast<void>(wide.unproject({static_cast<double>(pixel.x), static_cast<double>(pixel.y)}));
  }
  if (good) {
    fuzz::accepted<ft::bad_argument>(
        [&] { ft::require_invertible(camera, in.within(0, 64), in.within(0, 48), 0.25); });
  }
}

bool is_start(ft::pose const& a, ft::pose const& b) { return std::memcmp(&a, &b, sizeof a) == 0; }

bool is_rigid(ft::pose const& T) {
  auto const RRt = T.cast<double>().R * T.cast<double>().R.transposed();
  for (int i = 0; i < 9; ++i) {
    if (!(std::fabs(RRt.m[i] - (i % 4 == 0 ? 1 : 0)) < 1e-4)) { return false; }
  }
  return true;
}

template <typename Rig>
void solve(fuzz::input& in, Rig const& rig) {
  int const n = in.within(0, 30);
  std::vector<ft::observation> seen(static_cast<std::size_t>(n));
  for (auto& o : seen) {
    o.point = {in.number(-3, 3), in.number(-3, 3), in.number(0, 8)};
    o.u = in.number(0, 320);
    o.v = in.number(0, 240);
    o.right_u = in.number(-10, 320);
    o.inv_sigma2 = in.number(0.1f, 1);
    o.camera = in.within(0, 1);
  }
  ft::pose start = ft::pose::identity();
  start.t = {in.number(-1, 1), in.number(-1, 1), in.number(-1, 1)};
  ft::pose result{};
  std::vector<unsigned char> outlier(seen.size() + 1, 7);
  int inliers = -1;
  ft::pose_problem const problem{seen.data(), n, &start, &result, outlier.data(), &inliers};
  static ft::host_exec const exec(1);
  ft::optimize_pose(exec, rig, problem);
  int kept = 0;
  for (int i = 0; i < n; ++i) {
    auto const flag = outlier[static_cast<std::size_t>(i)];
    fuzz::require(flag <= 1, "every observation is judged");
    kept += flag == 0;
  }
  fuzz::require(outlier.back() == 7, "no flag is written behind the last");
  fuzz::require(inliers == (n < 3 ? 0 : kept), "inliers are what is not an outlier");
  fuzz::require(is_start(result, start) || is_rigid(result),
                "a pose is the start or a rigid motion");
}

using fisheye = ft::stereo_rig<ft::kannala_brandt<float>, ft::kannala_brandt<float>>;
using mixed = ft::stereo_rig<ft::double_sphere<float>, ft::radtan5<float>>;

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(std::uint8_t const* data, std::size_t size) {
  fuzz::input in(data, size);
  ft::pose const T_rl{{{1, 0, 0, 0, 1, 0, 0, 0, 1}}, {-0.1f, 0, 0}};
  switch (in.within(0, 11)) {
    case 0:
      use<ft::pinhole<float>>(in);
      break;
    case 1:
      use<ft::radtan4<float>>(in);
      break;
    case 2:
      use<ft::radtan5<float>>(in);
      break;
    case 3:
      use<ft::radtan8<float>>(in);
      break;
    case 4:
      use<ft::kannala_brandt<float>>(in);
      break;
    case 5:
      use<ft::double_sphere<float>>(in);
      break;
    case 6:
      use<ft::unified<float>>(in);
      break;
    case 7:
      use<ft::extended_unified<float>>(in);
      break;
    case 8:
      use<ft::field_of_view<float>>(in);
      break;
    case 9:
      solve(in, ft::rectified_rig::make({180, 180, 160, 120}, 0.1f));
      break;
    case 10:
      solve(in, fisheye{{141, 140, 159, 119, -0.012f, 0.003f, -0.002f, 0.0003f},
                        {141, 140, 159, 119, -0.012f, 0.003f, -0.002f, 0.0003f},
                        T_rl});
      break;
    default:
      solve(in, mixed{{118, 118, 159, 120, -0.2f, 0.59f},
                      {168, 167, 161, 119, {-0.21f, 0.06f, 4e-4f, -3e-4f, -0.008f}},
                      T_rl});
  }
  return 0;
}
