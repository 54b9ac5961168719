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

/// Numbers of the bits that are set.
std::vector<int> bits_of(std::uint32_t set) {
  std::vector<int> all;
  for (int i = 0; i < 32; ++i) {
    if ((set >> i & 1u) != 0) { all.push_back(i); }
  }
  return all;
}

void bind_tracking(nb::module_& m) {
  nb::class_<tracking>(m, "Tracking", "What is known about a camera after a frame.")
      .def_prop_ro(
          "T_world_camera",
          [](tracking const& t) { return to_numpy(from_ft(t.of.T_world_camera)); },
          "(4, 4) float64: maps points of the left camera, or of the body of a MultiRig, to the "
          "world, which is that of the first frame with a map; metres if `metric`.")
      .def_prop_ro(
          "T_odom_camera", [](tracking const& t) { return to_numpy(from_ft(t.of.T_odom_camera)); },
          "(4, 4) float64: the same as it was tracked, which never jumps where a loop is closed; "
          "T_world_camera is T_world_odom @ T_odom_camera, with its translation times odom_scale")
      .def_prop_ro(
          "T_world_odom", [](tracking const& t) { return to_numpy(from_ft(t.of.T_world_odom)); },
          "(4, 4) float64: what loops have corrected so far")
      .def_prop_ro(
          "odom_scale", [](tracking const& t) { return t.of.odom_scale; },
          "with loops and one camera without an IMU, whose unit of length drifts: how many units "
          "of "
          "the world one of the odometry's is, which T_odom_camera's position is multiplied by "
          "first; else 1")
      .def_prop_ro(
          "loops_closed", [](tracking const& t) { return t.of.loops_closed; },
          "loops whose correction enters with this frame")
      .def_prop_ro(
          "state", [](tracking const& t) { return ft::name_of(t.of.state); },
          "initialising, tracking, recovering or lost")
      .def_prop_ro("tracked",
                   [](tracking const& t) { return t.of.state == ft::tracking_state::tracking; })
      .def_prop_ro(
          "reason", [](tracking const& t) { return reason_of(t); },
          "why the frame is not tracked, or its pose to be doubted, a word such as 'dark' or "
          "'few_matches', see ft::tracking_reason; empty without a reason")
      .def_prop_ro(
          "explanation",
          [](tracking const& t) {
            return t.why.reason == ft::tracking_reason::none ? std::string() : t.why.text;
          },
          "the same as a sentence that has the numbers")
      .def_prop_ro(
          "missing_images", [](tracking const& t) { return bits_of(t.of.missing_images); },
          "images of a MultiRig that were None in this frame: 2 c is that of camera c, 2 c + 1 the "
          "right one of its rectified pair")
      .def_prop_ro(
          "missing_depths", [](tracking const& t) { return bits_of(t.of.missing_depths); },
          "cameras of a MultiRig whose depth image was None in this frame")
      .def_prop_ro(
          "map_id", [](tracking const& t) { return t.of.map_id; },
          "number of the map that the pose is in, from 1 on; 0 without a map")
      .def_prop_ro(
          "map_begun", [](tracking const& t) { return t.of.map_begun; },
          "whether the frame begins a map; if `maps` is above 1, at a guessed place")
      .def_prop_ro(
          "warnings",
          [](tracking const& t) {
            nb::dict all;
            for (auto const& said : t.warnings) {
              all[ft::name_of(said.warning)] = nb::str(said.text.c_str());
            }
            return all;
          },
          "dict: what is to be told of the frame although it may be tracked, a sentence by name "
          "such as 'two_motions' or 'doubtful_pose', see ft::tracking_warning; empty without")
      .def_prop_ro(
          "metric", [](tracking const& t) { return t.of.metric; },
          "whether lengths are metres; False with one camera alone, whose unit is the median "
          "depth of the first points")
      .def_prop_ro(
          "keyframe", [](tracking const& t) { return t.of.keyframe; },
          "whether the frame became a keyframe")
      .def_prop_ro(
          "inliers", [](tracking const& t) { return t.of.inliers; },
          "keypoints that agree with the pose")
      .def_prop_ro(
          "keypoints", [](tracking const& t) { return t.of.keypoints; }, "of the left images")
      .def_prop_ro(
          "stereo_points", [](tracking const& t) { return t.of.stereo_points; },
          "of these, with a depth")
      .def_prop_ro(
          "local_points", [](tracking const& t) { return t.of.local_points; },
          "map points that were searched")
      .def_prop_ro(
          "left_out", [](tracking const& t) { return t.of.left_out; },
          "map points for which there was no room; those of a keyframe come with the next frame")
      .def_prop_ro(
          "map_points", [](tracking const& t) { return t.of.map_points; },
          "in the map before the frame's own keyframe")
      .def_prop_ro(
          "maps", [](tracking const& t) { return t.of.maps; }, "begun so far")
      .def_prop_ro(
          "keyframes", [](tracking const& t) { return t.of.keyframes; }, "made so far")
      .def_prop_ro(
          "covariance",
          [](tracking const& t) {
            return to_numpy(std::vector<double>(t.of.covariance, t.of.covariance + 36), {6, 6});
          },
          "(6, 6) float64 of a small rotation, then translation, in the camera's frame: rad, m")
      .def_prop_ro(
          "imu_known", [](tracking const& t) { return t.of.imu.known; },
          "gravity, velocity and biases are known")
      .def_prop_ro(
          "imu_state",
          [](tracking const& t) { return std::string(t.imu ? ft::name_of(t.imu->state) : ""); },
          "initialising (imu_known is False), known (the pose was not optimised with the IMU) or "
          "used (it was); empty without an IMU")
      .def_prop_ro(
          "imu_reason",
          [](tracking const& t) {
            bool const none = !t.imu || t.imu->state == ft::imu_state::used;
            return std::string(none ? "" : t.imu->reason);
          },
          "why the IMU is not used: imu_samples if they are not usable, else imu_estimate, or "
          "'no_pose'; empty if it is used")
      .def_prop_ro(
          "imu_explanation", [](tracking const& t) { return t.imu ? t.imu->text : std::string(); },
          "the same as a sentence")
      .def_prop_ro(
          "imu_estimate",
          [](tracking const& t) { return std::string(ft::name_of(t.of.imu.estimate)); },
          "what the last estimate of gravity, velocity and biases came to, a word such as "
          "'few_keyframes' or 'little_motion', see ft::initialization_status")
      .def_prop_ro(
          "imu_samples",
          [](tracking const& t) { return std::string(ft::name_of(t.of.imu.samples)); },
          "what the samples since the last frame are, a word such as 'integrated', 'no_samples' or "
          "'contradicted', see ft::integration_status")
      .def_prop_ro(
          "imu_unused_s", [](tracking const& t) { return t.of.imu.unused_s; },
          "time of tracking in which the samples could have been used and were not, less that in "
          "which they were since, seconds; 0 without an IMU")
      .def_prop_ro(
          "imu_optimized", [](tracking const& t) { return t.of.imu.optimized; },
          "the pose was optimised with the IMU")
      .def_prop_ro(
          "imu_predicted", [](tracking const& t) { return t.of.imu.predicted; },
          "the pose was predicted with the IMU, not by predict()")
      .def_prop_ro(
          "imu_rate_hz", [](tracking const& t) { return t.of.imu.rate_hz; },
          "at which the last samples came, by their times; 0 = unknown")
      .def_prop_ro(
          "imu_newest_s", [](tracking const& t) { return t.of.imu.newest_s; },
          "time of the newest sample since the frame's, seconds; 0 = there is none")
      .def_prop_ro(
          "imu_time_offset_s", [](tracking const& t) { return t.of.imu.time_offset_s; },
          "by which the IMU's clock is taken to be ahead of that of the images, seconds: "
          "Imu.time_offset_s, or what was found")
      .def_prop_ro(
          "imu_clock",
          [](tracking const& t) -> nb::object {
            ft::imu_clock_offset const& clock = t.of.imu.clock;
            if (!clock.known) { return nb::none(); }
            return nb::make_tuple(clock.offset_s, clock.sigma_s);
          },
          "(offset, standard deviation) of the IMU's clock as found by how camera and IMU turn, "
          "seconds; None while that tells it not within a millisecond")
      .def_prop_ro(
          "imu_turn_in_use", [](tracking const& t) { return to_numpy(t.of.imu.turn); },
          "(3,) in use: rotation vector by which samples are turned before they are used, from the "
          "IMU's frame as they come to that which T_bc says, rad; zeros until a turn was found, "
          "without an IMU, and of one camera")
      .def_prop_ro(
          "imu_misalignment",
          [](tracking const& t) -> nb::object {
            ft::imu_misalignment const& off = t.of.imu.misalignment;
            if (!off.known) { return nb::none(); }
            return nb::make_tuple(to_numpy(std::vector<double>{off.turn.x, off.turn.y, off.turn.z}),
                                  off.sigma);
          },
          "(rotation vector, standard deviation) by which the IMU is turned from where T_bc says, "
          "as imu_turn_in_use, found by how camera and IMU turn, rad; None while that does not "
          "tell it "
          "within 0.1 degree")
      .def_prop_ro(
          "imu_left_out",
          [](tracking const& t) {
            auto const& n = t.of.imu.left_out;
            return std::map<std::string, long long>{{"disordered", n.disordered},
                                                    {"out_of_range", n.out_of_range},
                                                    {"crowded_out", n.crowded_out},
                                                    {"frozen", n.frozen},
                                                    {"spikes", n.spikes}};
          },
          "dict: samples that were left out so far, by 'disordered' (a time that is not after "
          "that of the sample before), 'out_of_range' (not finite, or at the sensor's range), "
          "'crowded_out' (too many waited for their frame), 'frozen' (the one before to the bit, "
          "from a sensor that has shown noise), 'spikes' (single rates of turning that no body "
          "has)")
      .def_ro("imu_warnings", &tracking::imu_warnings,
              "list of str: what is likely wrong with the samples of the IMU, a sentence each: "
              "left out, at another rate than Imu.rate_hz, contradicted by the images, on another "
              "clock")
      .def_prop_ro(
          "velocity", [](tracking const& t) { return to_numpy(t.of.imu.velocity); },
          "(3,) of the IMU in the world, m/s")
      .def_prop_ro(
          "gravity", [](tracking const& t) { return to_numpy(t.of.imu.gravity); },
          "(3,) in the world, m/s^2")
      .def_prop_ro(
          "gyro_bias",
          [](tracking const& t) { return to_numpy(t.of.imu.bias.gyro.cast<double>()); },
          "(3,) rad/s")
      .def_prop_ro(
          "accel_bias",
          [](tracking const& t) { return to_numpy(t.of.imu.bias.accel.cast<double>()); },
          "(3,) m/s^2")
      .def("__repr__", [](tracking const& t) {
        ft::vec3<double> const& at = t.of.T_world_camera.t;
        std::string const reason = reason_of(t);
        std::string const why = reason.empty() ? "" : " (" + reason + ")";
        return std::string("<ft.Tracking ") + ft::name_of(t.of.state) + why + ", " +
               std::to_string(t.of.inliers) + " inliers, at " + std::to_string(at.x) + " " +
               std::to_string(at.y) + " " + std::to_string(at.z) + (t.of.metric ? " m>" : ">");
      });
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
