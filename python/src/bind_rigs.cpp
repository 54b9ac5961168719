// SPDX-License-Identifier: Apache-2.0
#include <nanobind/stl/vector.h>

#include "python/src/arrays.hpp"

namespace ftpy {

rig rig_of(nb::handle given) {
  if (!nb::hasattr(given, "_plain")) {
    throw argument_error(
        "the rig is none of ft.RectifiedPair, ft.DistortedPair, ft.FisheyePair, ft.RgbdCamera, "
        "ft.MonocularCamera and ft.MultiRig");
  }
  nb::object const d = given.attr("_plain")();
  arrays kept;
  rig r;
  r.kind = nb::cast<std::string>(d["kind"]);
  r.left = nb::cast<std::vector<double>>(d["left"]);
  r.right = nb::cast<std::vector<double>>(d["right"]);
  r.wanted = nb::cast<std::vector<double>>(d["wanted"]);
  for (nb::handle const h : d["cameras"]) {
    rig_camera c;
    c.camera = nb::cast<std::vector<double>>(h["camera"]);
    c.baseline = nb::cast<double>(h["baseline"]);
    c.T_camera_body = kept.matrix(h["T_camera_body"], "T_camera_body");
    r.cameras.push_back(c);
  }
  r.T_right_left = kept.matrix(d["T_right_left"], "T_right_left");
  r.baseline = nb::cast<double>(d["baseline"]);
  r.depth_scale = nb::cast<double>(d["depth_scale"]);
  r.raw_width = nb::cast<int>(d["raw_width"]);
  r.raw_height = nb::cast<int>(d["raw_height"]);
  return r;
}

std::vector<std::string> image_names(rig const& of) {
  if (of.kind == "rgbd") { return {"the grey image", "the depth image"}; }
  if (of.kind == "multi") {
    std::vector<std::string> names;
    for (std::size_t c = 0; c < of.cameras.size(); ++c) {
      std::string const which = "image of camera " + std::to_string(c);
      if (of.cameras[c].baseline > 0) {
        names.push_back("the left " + which);
        names.push_back("the right " + which);
      } else {
        names.push_back("the " + which);
      }
    }
    return names;
  }
  if (of.kind.rfind("monocular", 0) == 0) { return {"the image"}; }
  return {"the left image", "the right image"};
}

feature_options feature_options_of(nb::handle options) {
  auto const get = [&](char const* name) { return nb::cast<int>(options[name]); };
  feature_options o;
  o.width = get("width");
  o.height = get("height");
  o.features = get("features");
  o.levels = get("levels");
  o.scale_factor = nb::cast<double>(options["scale_factor"]);
  o.ini_threshold = get("ini_threshold");
  o.min_threshold = get("min_threshold");
  o.mask_width = get("mask_width");
  o.mask_height = get("mask_height");
  o.std_sort = nb::cast<bool>(options["std_sort"]);
  o.threads = get("threads");
  return o;
}

}  // namespace ftpy
