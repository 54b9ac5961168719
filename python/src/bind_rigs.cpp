// SPDX-License-Identifier: Apache-2.0
#include <nanobind/stl/vector.h>

#include <algorithm>
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

namespace {

ft::camera_description camera_of(std::vector<double> values, ft::camera_kind kind,
                                 char const* which) {
  complete(values,
           kind == ft::camera_kind::pinhole          ? 4
           : kind == ft::camera_kind::kannala_brandt ? 8
                                                     : 12,
           which);
  ft::camera_description c;
  c.kind = kind;
  std::copy(values.begin(), values.end(), c.parameters);
  return c;
}

/// The camera of a rig of several.
ft::camera_description camera_of(rig_camera const& given) {
  using ft::camera_kind;
  camera_kind kind = camera_kind::pinhole;
  for (camera_kind const k :
       {camera_kind::radtan8, camera_kind::kannala_brandt, camera_kind::double_sphere}) {
    if (given.model == ft::name_of(k)) { kind = k; }
  }
  ft::camera_description c;
  if (kind == camera_kind::double_sphere) {
    c.kind = kind;
    std::copy(given.camera.begin(), given.camera.end(), c.parameters);
  } else {
    c = camera_of(given.camera, kind, "rig's");
  }
  c.baseline = given.baseline;
  c.right = given.right;
  c.has_depth_image = given.has_depth;
  c.readout_s = given.readout_s;
  c.T_camera_body = to_ft(given.T_camera_body);
  return c;
}

ft::rig_description pair_of(rig const& r, ft::rig_kind of, ft::camera_kind kind) {
  ft::rig_description rig;
  rig.kind = of;
  rig.cameras = 2;
  rig.camera[0] = camera_of(r.left, kind, "left");
  rig.camera[1] = camera_of(r.right, kind, "right");
  rig.camera[1].T_camera_body = to_ft(r.T_right_left);
  return rig;
}

ft::rig_description without_readout(rig const& r) {
  using ft::camera_kind;
  if (r.kind == "rectified") {
    ft::rig_description rig;
    rig.camera[0] = camera_of(r.left, camera_kind::pinhole, "left");
    rig.camera[0].baseline = r.baseline;
    return rig;
  }
  if (r.kind == "distorted") {
    auto rig = pair_of(r, ft::rig_kind::distorted_pair, camera_kind::radtan8);
    auto const wanted = camera_of(r.wanted, camera_kind::pinhole, "wanted");
    std::copy(wanted.parameters, wanted.parameters + 4, rig.rectified);
    rig.raw_width = r.raw_width;
    rig.raw_height = r.raw_height;
    return rig;
  }
  if (r.kind == "fisheye") {
    return pair_of(r, ft::rig_kind::fisheye_pair, camera_kind::kannala_brandt);
  }
  if (r.kind == "monocular") {
    return ft::rig_description::monocular(camera_of(r.left, camera_kind::pinhole, "pinhole"));
  }
  if (r.kind == "monocular_fisheye") {
    return ft::rig_description::monocular(
        camera_of(r.left, camera_kind::kannala_brandt, "fisheye"));
  }
  if (r.kind == "multi") {
    ft::rig_description rig;
    rig.kind = ft::rig_kind::multi;
    rig.cameras = static_cast<int>(cameras_of(r));
    ft::camera_description* to = rig.camera;
    for (rig_camera const& c : r.cameras) { *to++ = camera_of(c); }
    rig.depth_scale = r.depth_scale.value_or(0);
    rig.min_depth = r.min_depth;
    rig.max_depth = r.max_depth;
    return rig;
  }
  auto const kind = r.left.size() == 4 ? camera_kind::pinhole : camera_kind::radtan8;
  auto rig = ft::rig_description::rgbd(camera_of(r.left, kind, "depth"), r.baseline,
                                       r.depth_scale.value_or(0));
  rig.min_depth = r.min_depth;
  rig.max_depth = r.max_depth;
  return rig;
}

}  // namespace

ft::rig_description description_of(rig const& r) {
  ft::rig_description rig = without_readout(r);
  for (int c = 0; c < rig.cameras && rig.kind != ft::rig_kind::multi; ++c) {
    rig.camera[c].readout_s = r.readout_s;
  }
  return rig;
}

}  // namespace ftpy
