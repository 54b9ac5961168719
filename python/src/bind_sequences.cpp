// SPDX-License-Identifier: Apache-2.0
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>

#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/reader.hpp"
#include "python/src/trajectories.hpp"

namespace ftpy {
namespace {

std::vector<double> values_of(seq::camera_intrinsics const& c) {
  std::vector<double> v{c.fx, c.fy, c.cx, c.cy};
  v.insert(v.end(), c.distortion.begin(), c.distortion.end());
  return v;
}

nb::object array_of(seq::image image) {
  auto const h = static_cast<std::size_t>(image.height);
  auto const w = static_cast<std::size_t>(image.width);
  return to_numpy(std::move(image.pixels), {h, w});
}

nb::object array_of(seq::depth_image depth) {
  auto const h = static_cast<std::size_t>(depth.height);
  auto const w = static_cast<std::size_t>(depth.width);
  return to_numpy(std::move(depth.pixels), {h, w});
}

char const* kind_of(seq::sequence const& s) {
  switch (s.kind()) {
    case seq::camera_kind::mono:
      return "mono";
    case seq::camera_kind::rgbd:
      return "rgbd";
    default:
      return "stereo";
  }
}

/// @param name auto, stereo, mono, rgbd or mixed
seq::camera_kind kind_named(std::string const& name) {
  if (name == "auto") { return seq::camera_kind::any; }
  if (name == "stereo") { return seq::camera_kind::stereo; }
  if (name == "mono") { return seq::camera_kind::mono; }
  if (name == "rgbd") { return seq::camera_kind::rgbd; }
  if (name == "mixed") { return seq::camera_kind::mixed; }
  throw argument_error("rig is '" + name + "', must be auto, stereo, mono, rgbd or mixed");
}

/// Of a mixed rig.
nb::list cameras_of(seq::stereo_rig const& rig) {
  nb::list all;
  for (seq::rig_camera const& c : seq::rig_cameras(rig)) {
    nb::dict d;
    d["model"] = c.camera.model == seq::lens::radial_tangential ? "RadTan"
                 : c.camera.model == seq::lens::kannala_brandt  ? "KannalaBrandt"
                 : c.camera.model == seq::lens::double_sphere   ? "DoubleSphere"
                                                                : "Pinhole";
    d["camera"] = values_of(c.camera);
    d["T_camera_body"] = to_numpy(plain(c.T_left_this.inverse()));
    d["has_depth"] = c.has_depth;
    d["readout_s"] = c.camera.readout_s;
    d["right"] = c.right < 0 ? nb::object(nb::none()) : nb::object(nb::int_(c.right));
    all.append(d);
  }
  return all;
}

nb::dict rig_dict(seq::sequence const& s) {
  seq::stereo_rig const& r = s.rig();
  nb::dict d;
  d["kind"] = kind_of(s);
  d["fisheye"] = s.fisheye();
  d["left"] = values_of(r.left);
  d["right"] = values_of(r.right);
  d["T_right_left"] = to_numpy(plain(r.T_left_right.inverse()));
  d["baseline"] = r.baseline();
  d["readout_s"] = r.left.readout_s;
  d["depth_unit"] = s.depth_unit();
  d["width"] = r.left.width;
  d["height"] = r.left.height;
  d["cameras"] = s.mixed() ? cameras_of(r) : nb::list();
  return d;
}

nb::dict settings_dict(seq::sequence const& s) {
  auto const& from = s.settings();
  nb::dict d;
  auto const put = [&](char const* name, auto const& value) {
    if (value) { d[name] = *value; }
  };
  put("features", from.features);
  put("levels", from.levels);
  put("scale_factor", from.scale_factor);
  put("ini_threshold", from.ini_threshold);
  put("min_threshold", from.min_threshold);
  put("near_depth", from.depth_threshold);
  return d;
}

nb::object imu_dict(seq::sequence const& s) {
  if (!s.imu()) { return nb::none(); }
  auto const& i = *s.imu();
  std::vector<std::int64_t> time;
  std::vector<double> accel;
  std::vector<double> gyro;
  for (auto const& sample : i.samples) {
    time.push_back(sample.time_ns);
    accel.insert(accel.end(), {sample.accel.x(), sample.accel.y(), sample.accel.z()});
    gyro.insert(gyro.end(), {sample.gyro.x(), sample.gyro.y(), sample.gyro.z()});
  }
  std::size_t const n = time.size();
  nb::dict d;
  d["T_imu_camera"] = to_numpy(plain(i.T_imu_left));
  d["gyro_noise"] = i.calibration.noise.gyro;
  d["accel_noise"] = i.calibration.noise.accel;
  d["gyro_walk"] = i.calibration.noise.gyro_walk;
  d["accel_walk"] = i.calibration.noise.accel_walk;
  d["rate_hz"] = i.calibration.rate_hz;
  d["time_offset_s"] = i.calibration.time_offset_s;
  d["time_ns"] = to_numpy(std::move(time));
  d["accel"] = to_numpy(std::move(accel), {n, 3});
  d["gyro"] = to_numpy(std::move(gyro), {n, 3});
  return d;
}

/// @param options a dict of ft.read_sequence
seq::sequence opened(std::string const& folder, nb::dict const& options) {
  seq::open_options o;
  o.calibration = nb::cast<std::string>(options["calibration"]);
  o.keep_fisheye = nb::cast<bool>(options["keep_fisheye"]);
  o.max_frames = whole(options["max_frames"], "max_frames", 0);
  o.read_imu = nb::cast<bool>(options["imu"]);
  o.rig = kind_named(nb::cast<std::string>(options["rig"]));
  o.times = nb::cast<std::string>(options["times"]);
  o.masks = nb::cast<std::vector<std::string>>(options["masks"]);
  nb::object const rate = options["fps"];
  if (!rate.is_none()) {
    o.fps = number(rate, "fps");
    if (!(o.fps >= 1e-3 && o.fps <= 1e5)) {
      throw argument_error("fps is " + text_of(rate) + ", must be in [0.001, 1e+05]");
    }
  }
  nb::object const apart = options["max_time_difference_ns"];
  if (!apart.is_none()) {
    o.max_time_difference_ns = nanoseconds(apart, "max_time_difference_ns");
    if (*o.max_time_difference_ns < 0) {
      throw argument_error("max_time_difference_ns is " + text_of(apart) + ", must be at least 0");
    }
  }
  nb::object const bits = options["image_bits"];
  if (!bits.is_none()) {
    o.image_bits = whole(bits, "image_bits", 8);
    if (o.image_bits > 16) {
      throw argument_error("image_bits is " + text_of(bits) + ", must be in [8, 16]");
    }
  }
  nb::object const unit = options["depth_unit"];
  if (!unit.is_none()) {
    o.depth_unit = number(unit, "depth_unit");
    if (!(o.depth_unit >= 1e-9 && o.depth_unit <= 1e3)) {
      throw argument_error("depth_unit is " + text_of(unit) +
                           ", must be in [1e-09, 1000] metres per unit");
    }
  }
  nb::gil_scoped_release const released;
  return seq::sequence::open(folder, o);
}

/// The array of an image, or None where a camera has none.
template <typename Image>
nb::object array_or_none(Image&& image) {
  return image.pixels.empty() ? nb::none() : nb::object(array_of(std::move(image)));
}

/// The images of a frame: those of a rig in its order, depths behind their camera's; left and
/// right, one, or one and its depths.
nb::tuple images_of(seq::sequence const& s, seq::stereo_frame f) {
  nb::object const left = array_of(std::move(f.left));
  if (s.kind() == seq::camera_kind::mono) { return nb::make_tuple(left); }
  if (s.kind() == seq::camera_kind::stereo) {
    nb::list cameras;
    cameras.append(left);
    cameras.append(array_of(std::move(f.right)));
    for (seq::image& more : f.more) { cameras.append(array_or_none(std::move(more))); }
    std::vector<int> const& with_depth = s.rig().depth_cameras;
    nb::list all;
    for (std::size_t c = 0; c < nb::len(cameras); ++c) {
      all.append(cameras[c]);
      auto const at = std::find(with_depth.begin(), with_depth.end(), static_cast<int>(c));
      if (at == with_depth.end()) { continue; }
      auto const d = static_cast<std::size_t>(at - with_depth.begin());
      all.append(array_or_none(std::move(f.depths[d])));
    }
    return nb::tuple(all);
  }
  return nb::make_tuple(left, array_of(std::move(f.depth)));
}

/// Of the cameras in turn.
nb::tuple masks_of(seq::stereo_frame const& f) {
  nb::list all;
  for (auto const& mask : f.masks) {
    all.append(mask == nullptr ? nb::none() : nb::object(array_of(*mask)));
  }
  return nb::tuple(all);
}

nb::dict errors_of(seq::trajectory_error const& e) {
  auto const number = [](std::optional<double> const& v) -> nb::object {
    return v ? nb::object(nb::float_(*v)) : nb::object(nb::none());
  };
  nb::dict d;
  d["pairs"] = e.pairs;
  d["path_m"] = e.path_m;
  d["ate_m"] = number(e.ate_rmse_m);
  d["rpe_m"] = number(e.rpe_rmse_m);
  d["ate_deg"] = number(e.ate_rotation_rmse_deg);
  d["ate_rotation_missing"] = e.ate_rotation_missing.empty()
                                  ? nb::object(nb::none())
                                  : nb::object(nb::str(e.ate_rotation_missing.c_str()));
  d["rpe_deg"] = number(e.rpe_rotation_rmse_deg);
  d["T_truth_estimate"] = to_numpy(plain(e.T_truth_estimate));
  return d;
}

}  // namespace

void bind_sequences(nb::module_& m) {
  nb::class_<seq::sequence>(m, "SequenceFiles", "See ft.read_sequence.")
      .def_static("open", opened, nb::arg("folder"), nb::arg("options"))
      .def("__len__", &seq::sequence::size)
      .def_prop_ro("name", &seq::sequence::name)
      .def_prop_ro("layout", &seq::sequence::layout)
      .def(
          "describe",
          [](seq::sequence const& s, bool imu) {
            std::vector<std::pair<std::string, std::string>> lines;
            for (auto const& [name, text] : seq::describe(s, imu)) {
              lines.emplace_back(name, text);
            }
            return lines;
          },
          nb::arg("imu"))
      .def_prop_ro("rig", rig_dict)
      .def_prop_ro("warnings", &seq::sequence::warnings)
      .def_prop_ro("depth_unit_from", &seq::sequence::depth_unit_from)
      .def_prop_ro("settings", settings_dict)
      .def_prop_ro("masked", &seq::sequence::masked)
      .def_prop_ro("has_body_frame", &seq::sequence::has_body_frame)
      .def_prop_ro("imu", imu_dict)
      .def_prop_ro("ground_truth",
                   [](seq::sequence const& s) { return arrays_of(s.ground_truth()); })
      .def_prop_ro("ground_truth_has_orientation", &seq::sequence::ground_truth_has_orientation)
      .def(
          "load",
          [](seq::sequence const& s, int i) {
            if (i < 0 || i >= s.size()) { throw nb::index_error("no such frame"); }
            seq::stereo_frame f;
            {
              nb::gil_scoped_release const released;
              f = s.load(i);
            }
            std::int64_t const time_ns = f.time_ns;
            nb::tuple const masks = masks_of(f);
            return nb::make_tuple(time_ns, images_of(s, std::move(f)), masks);
          },
          nb::arg("i"));
  m.def(
      "evaluate_arrays",
      [](nb::handle time, nb::handle poses, nb::handle truth_time, nb::handle truth,
         bool orientation, nb::handle interval_s) {
        seq::trajectory const estimate = trajectory_of(time, poses, "the estimate");
        seq::trajectory const reference = trajectory_of(truth_time, truth, "the ground truth");
        if (reference.empty()) {
          throw argument_error(
              "the ground truth is empty: errors need one, and not every sequence has one");
        }
        try {
          nb::dict d = errors_of(
              seq::evaluate(estimate, reference, orientation, number(interval_s, "interval_s")));
          auto const fit = seq::fit_scale(estimate, reference);
          d["scale"] = fit && fit->same_shape() ? nb::object(nb::float_(fit->scale))
                                                : nb::object(nb::none());
          return d;
        } catch (seq::error const& e) { throw argument_error(e.what()); }
      },
      nb::arg("time_ns").none(), nb::arg("poses").none(), nb::arg("truth_time_ns").none(),
      nb::arg("truth").none(), nb::arg("orientation"), nb::arg("interval_s").none());
  m.def(
      "write_tum",
      [](std::string const& file, nb::handle time, nb::handle poses) {
        seq::write_tum(file, trajectory_of(time, poses, "the trajectory"));
      },
      nb::arg("file"), nb::arg("time_ns").none(), nb::arg("poses").none(),
      "Writes poses (n, 4, 4) in TUM format.");
  m.def(
      "write_kitti",
      [](std::string const& file, nb::handle time, nb::handle poses) {
        seq::write_kitti_poses(file, trajectory_of(time, poses, "the trajectory"));
      },
      nb::arg("file"), nb::arg("time_ns").none(), nb::arg("poses").none(),
      "Writes poses (n, 4, 4) in KITTI's format: 12 numbers a line.");
  m.def(
      "read_tum", [](std::string const& file) { return arrays_of(seq::read_tum(file)); },
      nb::arg("file"), "Times (n) and poses (n, 4, 4) of a file in TUM format.");
}

}  // namespace ftpy
