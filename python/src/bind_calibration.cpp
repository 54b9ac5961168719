// SPDX-License-Identifier: Apache-2.0
#include <nanobind/stl/pair.h>
#include <nanobind/stl/vector.h>

#include <algorithm>

#include "ft/cameras/check_calibration.hpp"
#include "library/rigs.hpp"
#include "python/src/arrays.hpp"
#include "python/src/conversions.hpp"

namespace ftpy {
namespace {

using found = std::vector<std::pair<std::string, std::string>>;

found findings_of(std::vector<ft::calibration_finding> const& given) {
  found all;
  for (auto const& f : given) { all.emplace_back(ft::name_of(f.warning), f.text); }
  return all;
}

template <typename Rig>
found check(Rig const& rig, int width, int height) {
  return findings_of(ft::check_calibration(rig, width, height));
}

/// Makes no rig, for that throws what is to be found.
found check_rig(rig const& r, int width, int height) {
  if (r.kind == "fisheye") { return check(fisheye_of(r), width, height); }
  if (r.kind == "distorted") { return check(distorted_of(r), width, height); }
  if (r.kind == "multi") {
    bool const pinholes = std::all_of(r.cameras.begin(), r.cameras.end(), [](rig_camera const& c) {
      return c.model == "pinhole" && c.right < 0 && !c.has_depth;
    });
    if (pinholes) { return check(multi_of<ft::most_cameras>(r), width, height); }
    return check(ft::library::host::mixed_of<ft::most_cameras>(description_of(r)), width, height);
  }
  if (r.kind == "monocular_fisheye") {
    ft::monocular_rig<ft::kannala_brandt<float>> rig;
    rig.camera = camera_of<ft::kannala_brandt<float>>(r.left, "fisheye");
    return check(rig, width, height);
  }
  if (r.kind == "monocular") {
    ft::monocular_rig<ft::pinhole<float>> rig;
    rig.camera = camera_of<ft::pinhole<float>>(r.left, "pinhole");
    return check(rig, width, height);
  }
  if (r.kind == "rectified") {
    ft::rectified_rig rig;
    rig.camera = camera_of<ft::pinhole<float>>(r.left, "left");
    rig.baseline = r.baseline;
    return check(rig, width, height);
  }
  auto const depth = [&](auto const& camera) {
    ft::rgbd_rig<std::decay_t<decltype(camera)>> rig;
    rig.camera = camera;
    rig.baseline = r.baseline;
    rig.depth_scale = narrow(r.depth_scale.value_or(0));
    return check(rig, width, height);
  };
  if (r.left.size() == 4) { return depth(camera_of<ft::pinhole<float>>(r.left, "depth")); }
  return depth(camera_of<ft::radtan8<float>>(r.left, "depth"));
}

}  // namespace

void bind_calibration(nb::module_& m) {
  m.def(
      "check_calibration",
      [](nb::handle of, nb::handle width, nb::handle height) {
        rig const r = rig_of(of);
        int const w = whole(width, "width");
        int const h = whole(height, "height");
        nb::gil_scoped_release const released;
        try {
          return check_rig(r, w, h);
        } catch (ft::bad_argument const& e) {
          if (w < 1 || h < 1) { throw; }
          return found{{"refused", e.what()}};
        }
      },
      nb::arg("rig").none(), nb::arg("width").none(), nb::arg("height").none(),
      "See ft.check_calibration.");
}

}  // namespace ftpy
