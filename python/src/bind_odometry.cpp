// SPDX-License-Identifier: Apache-2.0
#include <nanobind/stl/map.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <map>
#include <sstream>

#include "ft/any_odometry.hpp"
#include "ft/pipelines/explain.hpp"
#include "ft/pipelines/imu_warnings.hpp"
#include "ft/pipelines/tracking_warnings.hpp"
#include "python/src/arrays.hpp"
#include "python/src/given_features.hpp"

namespace ftpy {

namespace {

class bound_odometry {
public:
  bound_odometry(nb::handle of, nb::handle options, nb::handle inertial,
                 std::string const& device) {
    auto const get = [&](char const* name) { return whole(options[name], name); };
    rig const r = rig_of(of);
    ft::odometry_params p;
    feature_options const orb = feature_options_of(options);
    p.orb = orb_params_of(orb);
    width_ = p.orb.width;
    height_ = p.orb.height;
    batch_ = get("batch");
    p.rules.near_depth = narrow(number(options["near_depth"], "near_depth"));
    p.map_slots = get("map_slots");
    p.keyframes = get("keyframes");
    p.local_points = get("local_points");
    int const moving = get("window_moving");
    p.window = {moving, get("window_fixed")};
    p.window_points = get("window_points");
    p.measure_stages = nb::cast<bool>(options["measure_stages"]);
    p.loops.present = nb::cast<bool>(options["loops"]);
    p.rules.localize_only = nb::cast<bool>(options["localize_only"]);
    p.own_features = nb::cast<bool>(options["own_features"]);
    if (!inertial.is_none()) { p.imu = imu_of(inertial); }
    is_multi_ = r.kind == "multi";
    for (std::string const& name : image_names(r)) {
      is_depth_.push_back(name.rfind("the depth ", 0) == 0);
    }
    has_depth_scale_ = r.depth_scale.has_value();
    if (r.kind == "distorted" && r.raw_width > 0) {
      width_ = r.raw_width;
      height_ = r.raw_height;
    }
    gpu_ = on_gpu(device);
    ft::device where;
    where.gpu = gpu_ ? ft::device::current_gpu : ft::device::host;
    where.threads = orb.threads;
    ft::place_options places;
    places.vocabulary = nb::cast<std::string>(options["vocabulary"]);
    places.candidates = get("candidates");
    auto const named = nb::cast<std::string>(options["descriptors"]);
    ft::descriptor_kind kind = ft::descriptor_kind::orb;
    if (named == "bits_512") { kind = ft::descriptor_kind::bits_512; }
    if (named == "int8_128") { kind = ft::descriptor_kind::int8_128; }
    if (kind != ft::descriptor_kind::orb) { descriptor_bytes_ = named == "bits_512" ? 64 : 128; }
    {
      nb::gil_scoped_release const released;
      inner_ = std::make_unique<ft::any_odometry>(translated(
          [&] { return ft::make_odometry(where, description_of(r), p, batch_, places, kind); }));
    }
    for (int i = 0; i < batch_; ++i) {
      for (std::string const& name : image_names(r)) {
        names_.push_back(batch_ > 1 ? name + " of camera pair " + std::to_string(i) : name);
      }
    }
  }

  /// @param given sequences of the arrays of a rig
  std::vector<tracking> track(nb::sequence const& given, nb::handle at, std::uintptr_t stream) {
    arrays kept(gpu_);
    std::vector<std::int64_t> const time_ns = times(at, "time_ns");
    std::vector<ft::any_images> const images = images_of(kept, given);
    require_number(images.size(), time_ns.size(), static_cast<std::size_t>(batch_));
    nb::gil_scoped_release const released;
    return translated([&] {
      wait_for(kept, stream);
      return described(inner_->track(images.data(), time_ns.data()));
    });
  }
  /// @param given sequences of the features of a rig, each a dict of arrays or None
  std::vector<tracking> track_features(nb::sequence const& given, nb::handle at,
                                       std::uintptr_t stream) {
    arrays kept(gpu_);
    std::vector<std::int64_t> const time_ns = times(at, "time_ns");
    std::vector<ft::given_features> const features =
        given_features_of(kept, given, batch_ > 1, descriptor_bytes_);
    require_number(features.size(), time_ns.size(), static_cast<std::size_t>(batch_));
    nb::gil_scoped_release const released;
    return translated([&] {
      wait_for(kept, stream);
      return described(inner_->track(features.data(), time_ns.data()));
    });
  }
  std::vector<std::int64_t> track_timed(nb::sequence const& given, nb::handle at,
                                        std::uintptr_t stream) {
    arrays kept(gpu_);
    std::vector<std::int64_t> const time_ns = times(at, "time_ns");
    std::vector<ft::any_images> const images = images_of(kept, given);
    auto const batch = static_cast<std::size_t>(batch_);
    require_number(images.size(), time_ns.size(), images.size() / batch * batch);
    nb::gil_scoped_release const released;
    return translated([&] {
      wait_for(kept, stream);
      std::vector<std::int64_t> spent;
      for (std::size_t i = 0; i < images.size(); i += batch) {
        auto const begin = std::chrono::steady_clock::now();
        inner_->track(images.data() + i, time_ns.data() + i);
        auto const end = std::chrono::steady_clock::now();
        spent.push_back(std::chrono::duration_cast<std::chrono::nanoseconds>(end - begin).count());
      }
      return spent;
    });
  }
  void add_imu(nb::handle time_ns, nb::handle accel, nb::handle gyro, int b) {
    ft::imu_measurement const sample{nanoseconds(time_ns, "time_ns"), measured(accel, "accel"),
                                     measured(gyro, "gyro")};
    translated([&] { inner_->add_imu(sample, b); });
  }
  void predict(nb::handle T_world_camera, int b) {
    arrays kept;
    auto const T = to_ft(kept.matrix(T_world_camera, "T_world_camera"));
    translated([&] { inner_->predict(T, b); });
  }
  void reset(int b) {
    translated([&] { inner_->reset(b); });
  }
  void set_mask(nb::handle mask, int camera, int b) {
    arrays kept;
    image const v = kept.mask(mask, "mask");
    nb::gil_scoped_release const released;
    translated([&] { inner_->set_mask(b, camera, to_ft(v)); });
  }
  nb::dict keypoints(int b) const {
    require_camera(b);
    ft::tracked_frame_view const& r = inner_->keypoints();
    std::vector<float> x, y, depth;
    std::vector<int> camera, octave, point;
    std::vector<std::uint8_t> matched;
    auto const index = [](int i) { return static_cast<std::size_t>(i); };
    auto const append = [](auto& to, auto const* from, std::size_t n) {
      to.insert(to.end(), from, from + n);
    };
    unsigned char const* const is_matched = inner_->matched();
    for (int c = 0; c < r.depth_cameras; ++c) {
      std::size_t const n = index(r.keypoints[b * r.cameras + c]);
      std::size_t const first = index(b) * index(r.numbers()) + index(c) * index(r.capacity);
      std::size_t const first_depth =
          (index(b) * index(r.depth_cameras) + index(c)) * index(r.capacity);
      append(x, r.x + first, n);
      append(y, r.y + first, n);
      append(octave, r.octave + first, n);
      append(point, r.holder + first, n);
      append(depth, r.depth + first_depth, n);
      append(matched, is_matched + first, n);
      camera.insert(camera.end(), n, c);
    }
    nb::dict d;
    d["x"] = to_numpy(std::move(x));
    d["y"] = to_numpy(std::move(y));
    d["camera"] = to_numpy(std::move(camera));
    d["octave"] = to_numpy(std::move(octave));
    d["depth"] = to_numpy(std::move(depth));
    d["point"] = to_numpy(std::move(point));
    d["matched"] = to_numpy(std::move(matched)).attr("astype")("bool");
    return d;
  }
  nb::dict map(int b) const {
    ft::odometry_map from;
    {
      nb::gil_scoped_release const released;
      from = translated([&] { return inner_->download_map(b); });
    }
    std::vector<float> position, normal;
    std::vector<int> number, seen;
    for (auto const& p : from.points) {
      position.insert(position.end(), {p.position.x, p.position.y, p.position.z});
      normal.insert(normal.end(), {p.normal.x, p.normal.y, p.normal.z});
      number.push_back(p.number);
      seen.push_back(p.keyframes);
    }
    std::vector<std::int64_t> time_ns;
    std::vector<double> poses;
    for (auto const& k : from.keyframes) {
      time_ns.push_back(k.time_ns);
      pose const T = from_ft(k.T_world_camera);
      poses.insert(poses.end(), T.begin(), T.end());
    }
    std::size_t const points = number.size();
    std::size_t const keyframes = time_ns.size();
    nb::dict d;
    d["position"] = to_numpy(std::move(position), {points, 3});
    d["normal"] = to_numpy(std::move(normal), {points, 3});
    d["number"] = to_numpy(std::move(number));
    d["keyframes_that_see_it"] = to_numpy(std::move(seen));
    d["keyframe_time_ns"] = to_numpy(std::move(time_ns));
    d["keyframe_T_world_camera"] = to_numpy(std::move(poses), {keyframes, 4, 4});
    return d;
  }
  nb::dict placed_keyframes(int b) const {
    std::vector<std::int64_t> time_ns;
    std::vector<int> map;
    std::vector<double> tracked, placed, scale;
    std::vector<std::uint8_t> loaded;
    for (auto const& k : translated([&] { return inner_->placed_keyframes(b); })) {
      time_ns.push_back(k.time_ns);
      map.push_back(k.map);
      pose const T_odom = from_ft(k.T_odom_camera), T_world = from_ft(k.T_world_camera);
      tracked.insert(tracked.end(), T_odom.begin(), T_odom.end());
      placed.insert(placed.end(), T_world.begin(), T_world.end());
      scale.push_back(k.scale);
      loaded.push_back(k.loaded ? 1 : 0);
    }
    std::size_t const n = time_ns.size();
    nb::dict d;
    d["time_ns"] = to_numpy(std::move(time_ns));
    d["map"] = to_numpy(std::move(map));
    d["T_odom_camera"] = to_numpy(std::move(tracked), {n, 4, 4});
    d["T_world_camera"] = to_numpy(std::move(placed), {n, 4, 4});
    d["scale"] = to_numpy(std::move(scale));
    d["loaded"] = to_numpy(std::move(loaded)).attr("astype")("bool");
    return d;
  }
  nb::dict closed_loops(int b) const {
    std::vector<int> from, to, inliers;
    std::vector<std::int64_t> from_ns, to_ns;
    std::vector<double> measured, scale;
    for (auto const& l : translated([&] { return inner_->closed_loops(b); })) {
      from.push_back(l.from);
      to.push_back(l.to);
      from_ns.push_back(l.from_time_ns);
      to_ns.push_back(l.to_time_ns);
      pose const T = from_ft(l.T_from_to);
      measured.insert(measured.end(), T.begin(), T.end());
      scale.push_back(l.scale);
      inliers.push_back(l.inliers);
    }
    std::size_t const n = from.size();
    nb::dict d;
    d["from_keyframe"] = to_numpy(std::move(from));
    d["to_keyframe"] = to_numpy(std::move(to));
    d["from_time_ns"] = to_numpy(std::move(from_ns));
    d["to_time_ns"] = to_numpy(std::move(to_ns));
    d["T_from_to"] = to_numpy(std::move(measured), {n, 4, 4});
    d["scale"] = to_numpy(std::move(scale));
    d["inliers"] = to_numpy(std::move(inliers));
    return d;
  }
  nb::dict stage_times_us() const {
    nb::dict d;
    for (auto const& stage : translated([&] { return inner_->stage_times(); })) {
      d[stage.name] = stage.us;
    }
    return d;
  }
  ft::map_snapshot snapshot_map(int b) const {
    nb::gil_scoped_release const released;
    return translated([&] { return inner_->snapshot_map(b); });
  }
  void load_map(nb::bytes const& bytes, int b) {
    std::istringstream from(std::string(bytes.c_str(), bytes.size()));
    nb::gil_scoped_release const released;
    translated([&] { inner_->load_map(from, b); });
  }
  std::size_t memory_bytes() const { return inner_->memory_bytes().executor; }
  int batch() const { return batch_; }

private:
  /// @param t [batch]
  std::vector<tracking> described(ft::tracking const* t) {
    std::vector<tracking> all;
    for (int b = 0; b < batch_; ++b) {
      all.push_back({t[b], ft::explain(t[b], inner_->params().rules),
                     ft::imu_warnings(t[b].imu, inner_->params().imu),
                     ft::warnings_of(t[b], inner_->params()),
                     inner_->params().imu.present
                         ? std::optional(ft::explain_imu(t[b].imu, inner_->params().imu))
                         : std::nullopt});
    }
    return all;
  }
  static ft::imu_params imu_of(nb::handle given) {
    arrays kept;
    ft::imu_params p;
    p.present = true;
    p.T_bc = to_ft(kept.matrix(given.attr("T_imu_camera"), "T_imu_camera"));
    auto const get = [&](char const* name) { return narrow(number(given.attr(name), name)); };
    float const gyro = get("gyro_noise");
    float const accel = get("accel_noise");
    float const gyro_walk = get("gyro_walk");
    float const accel_walk = get("accel_walk");
    p.noise = {gyro, accel, gyro_walk, accel_walk, get("rate_hz")};
    p.time_offset_s = number(given.attr("time_offset_s"), "time_offset_s");
    return p;
  }
  /// What a sensor measured. Numbers that a float cannot hold are infinite: the odometry counts
  /// such samples, a recording is not to end there.
  static ft::vec3<float> measured(nb::handle given, std::string const& name) {
    std::vector<nb::object> const items = items_of(given, name);
    if (items.size() != 3) {
      throw argument_error(name + " has " + std::to_string(items.size()) + " numbers, must have 3");
    }
    double v[3];
    for (std::size_t i = 0; i < 3; ++i) {
      v[i] = any_number(items[i], name + "[" + std::to_string(i) + "]");
      if (!(std::abs(v[i]) <= static_cast<double>(std::numeric_limits<float>::max()))) {
        v[i] = std::numeric_limits<double>::infinity();
      }
    }
    return {narrow(v[0]), narrow(v[1]), narrow(v[2])};
  }
  std::vector<ft::any_images> images_of(arrays& kept, nb::sequence const& given) const {
    std::size_t const of_rig = names_.size() / static_cast<std::size_t>(batch_);
    std::vector<ft::any_images> all;
    for (nb::handle const h : given) {
      if (nb::len(h) != of_rig) {
        throw argument_error("a frame of " + std::to_string(nb::len(h)) + " images, must be " +
                             std::to_string(of_rig) + " of this rig");
      }
      ft::any_images f;
      std::size_t const first = all.size() * of_rig % names_.size();
      ft::gray_view* next = f.gray;
      ft::depth_view* next_depth = is_multi_ ? f.depths : &f.depth;
      for (std::size_t i = 0; i < of_rig; ++i) {
        std::string const& name = names_[first + i];
        bool const missing = is_multi_ && nb::object(h[i]).is_none();
        if (is_depth_[i]) {
          ft::depth_view& to = *next_depth++;
          if (!missing) { to = depth_of(kept, h[i], name); }
        } else {
          ft::gray_view& to = *next++;
          if (missing) { continue; }
          to = to_ft(kept.framed(h[i], name));
          require_size(to.width, to.height, name);
        }
      }
      all.push_back(f);
    }
    return all;
  }
  ft::depth_view depth_of(arrays& kept, nb::handle given, std::string const& name) const {
    depth_image const d = kept.depth(given, name);
    require_size(d.width, d.height, name);
    if (!d.is_float && !has_depth_scale_) {
      throw argument_error(name +
                           " is uint16 and the rig has no depth_scale, metres per unit: 0.001 for "
                           "millimetres, 1 / 5000 for TUM's images");
    }
    ft::depth_view view;
    view.data = d.data;
    view.width = d.width;
    view.height = d.height;
    view.pitch = d.pitch;
    view.is_float = d.is_float;
    return view;
  }
  void wait_for(arrays const& kept, std::uintptr_t stream) {
    if (kept.on_device()) { inner_->wait_for(reinterpret_cast<void*>(stream)); }
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

  owned<ft::any_odometry> inner_;
  std::vector<std::string> names_;  ///< [batch][images of the rig]
  int width_ = 0, height_ = 0, batch_ = 1;
  std::vector<bool> is_depth_;  ///< [images of the rig]
  bool is_multi_ = false;
  bool has_depth_scale_ = false;
  bool gpu_ = false;
  int descriptor_bytes_ = 32;
};

/// The file as bytes. Others run meanwhile.
nb::bytes bytes_of(ft::map_snapshot const& snapshot) {
  std::string bytes;
  {
    nb::gil_scoped_release const released;
    std::ostringstream to;
    translated([&] { snapshot.write(to); });
    bytes = to.str();
  }
  return nb::bytes(bytes.data(), bytes.size());
}

}  // namespace

void bind_odometry(nb::module_& m) {
  bind_tracking(m);
  nb::class_<ft::map_snapshot>(m, "MapSnapshot", "A map as it was at Odometry.snapshot_map().")
      .def("tobytes", &bytes_of, "What load_map() takes. Other threads of Python go on meanwhile.");
  nb::class_<bound_odometry>(m, "OdometryPipeline", "See ft.Odometry.")
      .def(nb::init<nb::handle, nb::handle, nb::handle, std::string const&>(),
           nb::arg("rig").none(), nb::arg("options"), nb::arg("imu").none(), nb::arg("device"))
      .def("track", &bound_odometry::track, nb::arg("images"), nb::arg("time_ns").none(),
           nb::arg("stream") = 0)
      .def("track_features", &bound_odometry::track_features, nb::arg("features"),
           nb::arg("time_ns").none(), nb::arg("stream") = 0)
      .def("track_timed", &bound_odometry::track_timed, nb::arg("images"),
           nb::arg("time_ns").none(), nb::arg("stream") = 0,
           "track() of several frames in turn, for the bench: what each took in C++, nanoseconds.")
      .def("add_imu", &bound_odometry::add_imu, nb::arg("time_ns").none(), nb::arg("accel").none(),
           nb::arg("gyro").none(), nb::arg("b") = 0)
      .def("predict", &bound_odometry::predict, nb::arg("T_world_camera").none(), nb::arg("b") = 0)
      .def("reset", &bound_odometry::reset, nb::arg("b") = 0)
      .def("set_mask", &bound_odometry::set_mask, nb::arg("mask").none(), nb::arg("camera") = 0,
           nb::arg("b") = 0)
      .def("keypoints", &bound_odometry::keypoints, nb::arg("b") = 0)
      .def("map", &bound_odometry::map, nb::arg("b") = 0)
      .def("placed_keyframes", &bound_odometry::placed_keyframes, nb::arg("b") = 0)
      .def("closed_loops", &bound_odometry::closed_loops, nb::arg("b") = 0)
      .def("stage_times_us", &bound_odometry::stage_times_us)
      .def("snapshot_map", &bound_odometry::snapshot_map, nb::arg("b") = 0)
      .def("load_map", &bound_odometry::load_map, nb::arg("bytes"), nb::arg("b") = 0)
      .def_prop_ro("memory_bytes", &bound_odometry::memory_bytes)
      .def_prop_ro("batch", &bound_odometry::batch);
}

}  // namespace ftpy
