// SPDX-License-Identifier: Apache-2.0
#include <nanobind/stl/vector.h>

#include <limits>

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
    c.model = nb::cast<std::string>(h["model"]);
    c.camera = nb::cast<std::vector<double>>(h["camera"]);
    nb::object const right = h["right"];
    if (!right.is_none()) { c.right = whole(right, "right", 0); }
    c.baseline = number(h["baseline"], "baseline");
    c.readout_s = number(h["readout_s"], "readout_s");
    c.has_depth = nb::cast<bool>(h["has_depth"]);
    c.T_camera_body = kept.matrix(h["T_camera_body"], "T_camera_body");
    r.cameras.push_back(c);
  }
  r.T_right_left = kept.matrix(d["T_right_left"], "T_right_left");
  r.baseline = number(d["baseline"], "baseline");
  r.readout_s = number(d["readout_s"], "readout_s");
  nb::object const scale = d["depth_scale"];
  if (!scale.is_none()) {
    r.depth_scale = number(scale, "depth_scale");
    if (!(*r.depth_scale > 0)) {
      throw argument_error("depth_scale is " + text_of(scale) + ", must be above 0, or None");
    }
  }
  r.min_depth = number(d["min_depth"], "min_depth");
  nb::object const most = d["max_depth"];
  r.max_depth =
      most.is_none() ? std::numeric_limits<double>::infinity() : number(most, "max_depth");
  r.raw_width = whole(d["raw_width"], "size[0]");
  r.raw_height = whole(d["raw_height"], "size[1]");
  return r;
}

std::vector<std::string> image_names(rig const& of) {
  if (of.kind == "rgbd") { return {"the grey image", "the depth image"}; }
  if (of.kind == "multi") {
    std::vector<std::string> names;
    for (std::size_t c = 0; c < of.cameras.size(); ++c) {
      std::string const which = "image of camera " + std::to_string(c);
      if (of.cameras[c].has_depth) {
        names.push_back("the " + which);
        names.push_back("the depth " + which);
      } else if (of.cameras[c].baseline > 0) {
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
  auto const get = [&](char const* name) { return whole(options[name], name); };
  feature_options o;
  o.width = get("width");
  o.height = get("height");
  o.features = get("features");
  o.levels = get("levels");
  o.scale_factor = number(options["scale_factor"], "scale_factor");
  o.ini_threshold = get("ini_threshold");
  o.min_threshold = get("min_threshold");
  o.corner_ratio = number(options["corner_ratio"], "corner_ratio");
  o.mask_width = get("mask_width");
  o.mask_height = get("mask_height");
  o.std_sort = nb::cast<bool>(options["std_sort"]);
  o.threads = get("threads");
  return o;
}

}  // namespace ftpy
