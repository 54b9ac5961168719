// SPDX-License-Identifier: Apache-2.0
#include <nanobind/stl/map.h>
#include <nanobind/stl/vector.h>

#include <cmath>
#include <limits>

#include "python/src/arrays.hpp"

namespace ftpy {

namespace {

std::unique_ptr<odometry> make(odometry_options const& o, bool gpu) {
  std::string const& kind = o.of.kind;
#define FTPY_MAKE(name) gpu ? cuda::name(o) : host::name(o)
  if (kind == "rectified") { return FTPY_MAKE(make_rectified_odometry); }
  if (kind == "distorted") { return FTPY_MAKE(make_distorted_odometry); }
  if (kind == "fisheye") { return FTPY_MAKE(make_fisheye_odometry); }
  if (kind == "multi") { return FTPY_MAKE(make_multi_odometry); }
  if (kind.rfind("monocular", 0) == 0) { return FTPY_MAKE(make_monocular_odometry); }
  return FTPY_MAKE(make_rgbd_odometry);
#undef FTPY_MAKE
}

class bound_odometry {
public:
  bound_odometry(nb::handle of, nb::handle options, nb::handle inertial,
                 std::string const& device) {
    auto const get = [&](char const* name) { return whole(options[name], name); };
    odometry_options o;
    o.of = rig_of(of);
    o.orb = feature_options_of(options);
    width_ = o.orb.width;
    height_ = o.orb.height;
    o.batch = batch_ = get("batch");
    o.near_depth = number(options["near_depth"], "near_depth");
    o.map_slots = get("map_slots");
    o.keyframes = get("keyframes");
    o.local_points = get("local_points");
    o.window_moving = get("window_moving");
    o.window_fixed = get("window_fixed");
    o.window_points = get("window_points");
    o.measure_stages = nb::cast<bool>(options["measure_stages"]);
    if (!inertial.is_none()) { o.inertial = imu_of(inertial); }
    is_rgbd_ = o.of.kind == "rgbd";
    has_depth_scale_ = o.of.depth_scale.has_value();
    if (o.of.kind == "distorted" && o.of.raw_width > 0) {
      width_ = o.of.raw_width;
      height_ = o.of.raw_height;
    }
    gpu_ = on_gpu(device);
    {
      nb::gil_scoped_release const released;
      inner_ = make(o, gpu_);
    }
    for (int i = 0; i < batch_; ++i) {
      for (std::string const& name : image_names(o.of)) {
        names_.push_back(batch_ > 1 ? name + " of camera pair " + std::to_string(i) : name);
      }
    }
  }

  /// @param given sequences of the arrays of a rig
  std::vector<tracking> track(nb::sequence const& given, nb::handle at, std::uintptr_t stream) {
    arrays kept(gpu_);
    std::vector<std::int64_t> const time_ns = times(at, "time_ns");
    std::vector<frame_images> const images = images_of(kept, given);
    require_number(images.size(), time_ns.size(), static_cast<std::size_t>(batch_));
    nb::gil_scoped_release const released;
    if (kept.on_device()) { inner_->wait_for(stream); }
    return inner_->track(images, time_ns);
  }
  std::vector<std::int64_t> track_timed(nb::sequence const& given, nb::handle at,
                                        std::uintptr_t stream) {
    arrays kept(gpu_);
    std::vector<std::int64_t> const time_ns = times(at, "time_ns");
    std::vector<frame_images> const images = images_of(kept, given);
    auto const batch = static_cast<std::size_t>(batch_);
    require_number(images.size(), time_ns.size(), images.size() / batch * batch);
    nb::gil_scoped_release const released;
    if (kept.on_device()) { inner_->wait_for(stream); }
    return inner_->track_timed(images, time_ns);
  }
  void add_imu(nb::handle time_ns, nb::handle accel, nb::handle gyro, int b) {
    inner_->add_imu(b, nanoseconds(time_ns, "time_ns"), measured(accel, "accel"),
                    measured(gyro, "gyro"));
  }
  void predict(nb::handle T_world_camera, int b) {
    arrays kept;
    inner_->predict(b, kept.matrix(T_world_camera, "T_world_camera"));
  }
  void reset(int b) { inner_->reset(b); }
  void set_mask(nb::handle mask, int camera, int b) {
    arrays kept;
    image const v = kept.mask(mask, "mask");
    nb::gil_scoped_release const released;
    inner_->set_mask(b, camera, v);
  }
  void recognize_places(std::string const& vocabulary, nb::handle candidates) {
    int const n = whole(candidates, "candidates");
    nb::gil_scoped_release const released;
    inner_->recognize_places(vocabulary, n);
  }
  nb::dict keypoints(int b) const {
    require_camera(b);
    tracked_keypoints k = inner_->keypoints(b);
    nb::dict d;
    d["x"] = to_numpy(std::move(k.x));
    d["y"] = to_numpy(std::move(k.y));
    d["camera"] = to_numpy(std::move(k.camera));
    d["octave"] = to_numpy(std::move(k.octave));
    d["depth"] = to_numpy(std::move(k.depth));
    d["point"] = to_numpy(std::move(k.point));
    d["matched"] = to_numpy(std::move(k.matched)).attr("astype")("bool");
    return d;
  }
  nb::dict map(int b) const {
    map_arrays m;
    {
      nb::gil_scoped_release const released;
      m = inner_->map(b);
    }
    std::size_t const points = m.number.size();
    std::size_t const keyframes = m.keyframe_time_ns.size();
    nb::dict d;
    d["position"] = to_numpy(std::move(m.position), {points, 3});
    d["normal"] = to_numpy(std::move(m.normal), {points, 3});
    d["number"] = to_numpy(std::move(m.number));
    d["keyframes_that_see_it"] = to_numpy(std::move(m.seen));
    d["keyframe_time_ns"] = to_numpy(std::move(m.keyframe_time_ns));
    d["keyframe_T_world_camera"] = to_numpy(std::move(m.keyframe_pose), {keyframes, 4, 4});
    return d;
  }
  nb::dict stage_times() const {
    nb::dict d;
    for (auto const& [name, ms] : inner_->stage_times()) { d[name.c_str()] = ms; }
    return d;
  }
  nb::bytes save_map(int b) const {
    std::string bytes;
    {
      nb::gil_scoped_release const released;
      bytes = inner_->save_map(b);
    }
    return nb::bytes(bytes.data(), bytes.size());
  }
  void load_map(nb::bytes const& bytes, int b) {
    std::string const copy(bytes.c_str(), bytes.size());
    nb::gil_scoped_release const released;
    inner_->load_map(b, copy);
  }
  std::size_t memory_bytes() const { return inner_->memory_bytes(); }
  int batch() const { return batch_; }

private:
  static imu imu_of(nb::handle given) {
    arrays kept;
    imu i;
    i.T_imu_camera = kept.matrix(given.attr("T_imu_camera"), "T_imu_camera");
    auto const get = [&](char const* name) { return number(given.attr(name), name); };
    i.gyro_noise = get("gyro_noise");
    i.accel_noise = get("accel_noise");
    i.gyro_walk = get("gyro_walk");
    i.accel_walk = get("accel_walk");
    i.rate_hz = get("rate_hz");
    i.time_offset_s = get("time_offset_s");
    return i;
  }
  /// What a sensor measured. Numbers that a float cannot hold are infinite: the odometry counts
  /// such samples, a recording is not to end there.
  static std::array<double, 3> measured(nb::handle given, std::string const& name) {
    std::vector<nb::object> const items = items_of(given, name);
    if (items.size() != 3) {
      throw argument_error(name + " has " + std::to_string(items.size()) + " numbers, must have 3");
    }
    std::array<double, 3> v{};
    for (std::size_t i = 0; i < 3; ++i) {
      v[i] = any_number(items[i], name + "[" + std::to_string(i) + "]");
      if (!(std::abs(v[i]) <= static_cast<double>(std::numeric_limits<float>::max()))) {
        v[i] = std::numeric_limits<double>::infinity();
      }
    }
    return v;
  }
  std::vector<frame_images> images_of(arrays& kept, nb::sequence const& given) const {
    std::size_t const of_rig = names_.size() / static_cast<std::size_t>(batch_);
    std::vector<frame_images> all;
    for (nb::handle const h : given) {
      if (nb::len(h) != of_rig) {
        throw argument_error("a frame of " + std::to_string(nb::len(h)) + " images, must be " +
                             std::to_string(of_rig) + " of this rig");
      }
      frame_images f;
      std::size_t const first = all.size() * of_rig % names_.size();
      for (std::size_t i = 0; i < of_rig; ++i) {
        std::string const& name = names_[first + i];
        if (is_rgbd_ && i == 1) {
          f.depth = kept.depth(h[i], name);
          require_size(f.depth.width, f.depth.height, name);
          if (!f.depth.is_float && !has_depth_scale_) {
            throw argument_error(name +
                                 " is uint16 and the rig has no depth_scale, metres per unit: "
                                 "0.001 for millimetres, 1 / 5000 for TUM's images");
          }
        } else {
          f.grey.push_back(kept.framed(h[i], name));
          require_size(f.grey.back().width, f.grey.back().height, name);
        }
      }
      all.push_back(std::move(f));
    }
    return all;
  }
  static void require_number(std::size_t frames, std::size_t times, std::size_t wanted) {
    if (frames == wanted && times == wanted) { return; }
    throw argument_error(std::to_string(frames) + " frames and " + std::to_string(times) +
                         " times, must be " + std::to_string(wanted) + " of each");
  }
  void require_size(int width, int height, std::string const& name) const {
    if (width == width_ && height == height_) { return; }
    throw argument_error(name + " has shape (" + std::to_string(height) + ", " +
                         std::to_string(width) + "), must have (" + std::to_string(height_) + ", " +
                         std::to_string(width_) + ")");
  }
  void require_camera(int b) const {
    if (b >= 0 && b < batch_) { return; }
    throw argument_error("camera pair " + std::to_string(b) + " does not exist, there are " +
                         std::to_string(batch_));
  }

  owned<odometry> inner_;
  std::vector<std::string> names_;  ///< [batch][images of the rig]
  int width_ = 0, height_ = 0, batch_ = 1;
  bool is_rgbd_ = false;
  bool has_depth_scale_ = false;
  bool gpu_ = false;
};

void bind_tracking(nb::module_& m) {
  nb::class_<tracking>(m, "Tracking", "What is known about a camera after a frame.")
      .def_prop_ro(
          "T_world_camera", [](tracking const& t) { return to_numpy(t.T_world_camera); },
          "(4, 4) float64: maps points of the left camera, or of the body of a MultiRig, to the "
          "world, which is that of the first frame with a map; metres if `metric`.")
      .def_ro("state", &tracking::state, "initialising, tracking, recovering or lost")
      .def_prop_ro("tracked", [](tracking const& t) { return t.state == "tracking"; })
      .def_ro("reason", &tracking::reason,
              "why the frame is not tracked, or its pose to be doubted, a word such as 'dark' or "
              "'few_matches', see ft::tracking_reason; empty without a reason")
      .def_ro("explanation", &tracking::explanation, "the same as a sentence that has the numbers")
      .def_ro("metric", &tracking::metric,
              "whether lengths are metres; False with one camera alone, whose unit is the median "
              "depth of the first points")
      .def_ro("keyframe", &tracking::keyframe, "whether the frame became a keyframe")
      .def_ro("inliers", &tracking::inliers, "keypoints that agree with the pose")
      .def_ro("keypoints", &tracking::keypoints, "of the left images")
      .def_ro("stereo_points", &tracking::stereo_points, "of these, with a depth")
      .def_ro("local_points", &tracking::local_points, "map points that were searched")
      .def_ro("left_out", &tracking::left_out, "map points for which there was no room")
      .def_ro("map_points", &tracking::map_points, "in the map")
      .def_ro("maps", &tracking::maps, "begun so far")
      .def_ro("keyframes", &tracking::keyframes, "made so far")
      .def_prop_ro(
          "covariance",
          [](tracking const& t) {
            return to_numpy(std::vector<double>(t.covariance.begin(), t.covariance.end()), {6, 6});
          },
          "(6, 6) float64 of a small rotation, then translation, in the camera's frame: rad, m")
      .def_ro("imu_known", &tracking::imu_known, "gravity, velocity and biases are known")
      .def_ro("imu_optimized", &tracking::imu_optimized, "the pose was optimised with the IMU")
      .def_ro("imu_predicted", &tracking::imu_predicted, "the pose was predicted with the IMU")
      .def_ro("imu_rate_hz", &tracking::imu_rate_hz,
              "at which the last samples came, by their times; 0 = unknown")
      .def_ro("imu_newest_s", &tracking::imu_newest_s,
              "time of the newest sample since the frame's, seconds; 0 = there is none")
      .def_ro("imu_time_offset_s", &tracking::imu_time_offset_s,
              "by which the IMU's clock is taken to be ahead of that of the images, seconds: "
              "Imu.time_offset_s, or what was found")
      .def_prop_ro(
          "imu_clock",
          [](tracking const& t) -> nb::object {
            if (!t.imu_clock) { return nb::none(); }
            return nb::make_tuple((*t.imu_clock)[0], (*t.imu_clock)[1]);
          },
          "(offset, standard deviation) of the IMU's clock as found by how camera and IMU turn, "
          "seconds; None while that tells it not within a millisecond")
      .def_ro("imu_left_out", &tracking::imu_left_out,
              "dict: samples that were left out so far, by 'disordered' (a time that is not after "
              "that of the sample before), 'out_of_range' (not finite, or at the sensor's range), "
              "'crowded_out' (too many waited for their frame)")
      .def_ro("imu_warnings", &tracking::imu_warnings,
              "list of str: what is likely wrong with the samples of the IMU, a sentence each: "
              "left out, at another rate than Imu.rate_hz, contradicted by the images, on another "
              "clock")
      .def_prop_ro(
          "velocity", [](tracking const& t) { return to_numpy(t.velocity); },
          "(3,) of the IMU in the world, m/s")
      .def_prop_ro(
          "gravity", [](tracking const& t) { return to_numpy(t.gravity); },
          "(3,) in the world, m/s^2")
      .def_prop_ro(
          "gyro_bias", [](tracking const& t) { return to_numpy(t.gyro_bias); }, "(3,) rad/s")
      .def_prop_ro(
          "accel_bias", [](tracking const& t) { return to_numpy(t.accel_bias); }, "(3,) m/s^2")
      .def("__repr__", [](tracking const& t) {
        pose const& T = t.T_world_camera;
        std::string const why = t.reason.empty() ? "" : " (" + t.reason + ")";
        return "<ft.Tracking " + t.state + why + ", " + std::to_string(t.inliers) +
               " inliers, at " + std::to_string(T[3]) + " " + std::to_string(T[7]) + " " +
               std::to_string(T[11]) + (t.metric ? " m>" : ">");
      });
}

}  // namespace

void bind_odometry(nb::module_& m) {
  bind_tracking(m);
  nb::class_<bound_odometry>(m, "OdometryPipeline", "See ft.Odometry.")
      .def(nb::init<nb::handle, nb::handle, nb::handle, std::string const&>(),
           nb::arg("rig").none(), nb::arg("options"), nb::arg("imu").none(), nb::arg("device"))
      .def("track", &bound_odometry::track, nb::arg("images"), nb::arg("time_ns").none(),
           nb::arg("stream") = 0)
      .def("track_timed", &bound_odometry::track_timed, nb::arg("images"),
           nb::arg("time_ns").none(), nb::arg("stream") = 0,
           "track() of several frames in turn, for the bench: what each took in C++, nanoseconds.")
      .def("add_imu", &bound_odometry::add_imu, nb::arg("time_ns").none(), nb::arg("accel").none(),
           nb::arg("gyro").none(), nb::arg("b") = 0)
      .def("predict", &bound_odometry::predict, nb::arg("T_world_camera").none(), nb::arg("b") = 0)
      .def("reset", &bound_odometry::reset, nb::arg("b") = 0)
      .def("set_mask", &bound_odometry::set_mask, nb::arg("mask").none(), nb::arg("camera") = 0,
           nb::arg("b") = 0)
      .def("recognize_places", &bound_odometry::recognize_places, nb::arg("vocabulary"),
           nb::arg("candidates").none() = 16)
      .def("keypoints", &bound_odometry::keypoints, nb::arg("b") = 0)
      .def("map", &bound_odometry::map, nb::arg("b") = 0)
      .def("stage_times", &bound_odometry::stage_times)
      .def("save_map", &bound_odometry::save_map, nb::arg("b") = 0)
      .def("load_map", &bound_odometry::load_map, nb::arg("bytes"), nb::arg("b") = 0)
      .def_prop_ro("memory_bytes", &bound_odometry::memory_bytes)
      .def_prop_ro("batch", &bound_odometry::batch);
}

}  // namespace ftpy
