// SPDX-License-Identifier: Apache-2.0
/// @file ft::odometry behind the bindings' interface, for any executor and rig.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <fstream>
#include <sstream>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "ft/containers/vocabulary_files.hpp"
#include "ft/pipelines/explain.hpp"
#include "ft/pipelines/imu_warnings.hpp"
#include "ft/pipelines/odometry.hpp"
#include "python/src/conversions.hpp"
#include "python/src/vocabulary_of.hpp"

namespace ftpy {

inline ft::odometry_params odometry_params_of(odometry_options const& o) {
  ft::odometry_params p;
  p.orb = orb_params_of(o.orb);
  p.rules.near_depth = narrow(o.near_depth);
  p.map_slots = o.map_slots;
  p.keyframes = o.keyframes;
  p.local_points = o.local_points;
  p.window = {o.window_moving, o.window_fixed};
  p.window_points = o.window_points;
  p.measure_stages = o.measure_stages;
  if (o.inertial) {
    imu const& i = *o.inertial;
    p.imu.present = true;
    p.imu.T_bc = to_ft(i.T_imu_camera);
    p.imu.noise = {narrow(i.gyro_noise), narrow(i.accel_noise), narrow(i.gyro_walk),
                   narrow(i.accel_walk), narrow(i.rate_hz)};
    p.imu.time_offset_s = i.time_offset_s;
  }
  return p;
}

inline char const* name_of(ft::tracking_state s) {
  switch (s) {
    case ft::tracking_state::initialising:
      return "initialising";
    case ft::tracking_state::tracking:
      return "tracking";
    case ft::tracking_state::recovering:
      return "recovering";
    case ft::tracking_state::lost:
      break;
  }
  return "lost";
}

inline tracking plain(ft::tracking const& t, ft::odometry_params const& params) {
  auto const wide = [](ft::vec3<float> v) {
    return std::array<double, 3>{static_cast<double>(v.x), static_cast<double>(v.y),
                                 static_cast<double>(v.z)};
  };
  tracking r;
  r.T_world_camera = from_ft(t.T_world_camera);
  r.state = name_of(t.state);
  auto const why = ft::explain(t, params.rules);
  if (why.reason != ft::tracking_reason::none) {
    r.reason = ft::name_of(why.reason);
    r.explanation = why.text;
  }
  r.metric = t.metric;
  r.keyframe = t.keyframe;
  r.inliers = t.inliers;
  r.keypoints = t.keypoints;
  r.stereo_points = t.stereo_points;
  r.local_points = t.local_points;
  r.left_out = t.left_out;
  r.map_points = t.map_points;
  r.maps = t.maps;
  r.keyframes = t.keyframes;
  std::copy(t.covariance, t.covariance + 36, r.covariance.begin());
  r.imu_known = t.imu.known;
  r.imu_optimized = t.imu.optimized;
  r.velocity = {t.imu.velocity.x, t.imu.velocity.y, t.imu.velocity.z};
  r.gravity = {t.imu.gravity.x, t.imu.gravity.y, t.imu.gravity.z};
  r.gyro_bias = wide(t.imu.bias.gyro);
  r.accel_bias = wide(t.imu.bias.accel);
  r.imu_predicted = t.imu.predicted;
  r.imu_rate_hz = t.imu.rate_hz;
  r.imu_newest_s = t.imu.newest_s;
  r.imu_time_offset_s = t.imu.time_offset_s;
  if (t.imu.clock.known) { r.imu_clock = {{t.imu.clock.offset_s, t.imu.clock.sigma_s}}; }
  r.imu_left_out = {{"disordered", t.imu.left_out.disordered},
                    {"out_of_range", t.imu.left_out.out_of_range},
                    {"crowded_out", t.imu.left_out.crowded_out}};
  r.imu_warnings = ft::imu_warnings(t.imu, params.imu);
  return r;
}

template <typename Rig>
class odometry_of final : public odometry, private executor {
  using inner_type = ft::odometry<exec_type, Rig>;
  using images_type = typename inner_type::images_type;

public:
  odometry_of(Rig const& rig, odometry_options const& o)
      : executor(o.orb.threads), inner_(exec, rig, odometry_params_of(o), o.batch) {}

  void wait_for(std::uintptr_t stream) override { wait_for_stream(stream); }
  std::vector<tracking> track(std::vector<frame_images> const& images,
                              std::vector<std::int64_t> const& time_ns) override {
    return translated([&] {
      std::vector<images_type> given;
      for (frame_images const& f : images) { given.push_back(images_of(f)); }
      ft::tracking const* const t = inner_.track(given.data(), time_ns.data());
      std::vector<tracking> all;
      for (std::size_t b = 0; b < images.size(); ++b) {
        all.push_back(plain(t[b], inner_.params()));
      }
      return all;
    });
  }
  void add_imu(int b, std::int64_t time_ns, std::array<double, 3> const& accel,
               std::array<double, 3> const& gyro) override {
    auto const vector = [](std::array<double, 3> const& v) {
      return ft::vec3<float>{narrow(v[0]), narrow(v[1]), narrow(v[2])};
    };
    translated([&] { inner_.add_imu({time_ns, vector(accel), vector(gyro)}, b); });
  }
  void predict(int b, pose const& T) override {
    translated([&] { inner_.predict(to_ft(T), b); });
  }
  void reset(int b) override {
    translated([&] { inner_.reset(b); });
  }
  void set_mask(int b, int camera, image const& mask) override {
    translated([&] { inner_.set_mask(b, camera, to_ft(mask)); });
  }
  void recognize_places(std::string const& file, int candidates) override {
    translated([&] {
      words_ = ft::upload(exec, vocabulary_of(file).view());
      ft::place_recovery how;
      how.candidates = candidates;
      inner_.recognize_places(words_.view(), how);
    });
  }
  tracked_keypoints keypoints(int b) const override {
    ft::tracked_frame_view const& r = inner_.keypoints();
    auto const index = [](int i) { return static_cast<std::size_t>(i); };
    tracked_keypoints k;
    auto const append = [](auto& to, auto const* from, std::size_t n) {
      to.insert(to.end(), from, from + n);
    };
    for (int c = 0; c < r.depth_cameras; ++c) {
      std::size_t const n = index(r.keypoints[b * r.cameras + c]);
      std::size_t const first = index(b) * index(r.numbers()) + index(c) * index(r.capacity);
      std::size_t const first_depth =
          (index(b) * index(r.depth_cameras) + index(c)) * index(r.capacity);
      append(k.x, r.x + first, n);
      append(k.y, r.y + first, n);
      append(k.octave, r.octave + first, n);
      append(k.point, r.holder + first, n);
      append(k.depth, r.depth + first_depth, n);
      append(k.matched, inner_.matched() + first, n);
      k.camera.insert(k.camera.end(), n, c);
    }
    return k;
  }
  map_arrays map(int b) const override {
    return translated([&] {
      map_arrays m;
      ft::odometry_map const from = inner_.download_map(b);
      for (auto const& p : from.points) {
        m.position.insert(m.position.end(), {p.position.x, p.position.y, p.position.z});
        m.normal.insert(m.normal.end(), {p.normal.x, p.normal.y, p.normal.z});
        m.number.push_back(p.number);
        m.seen.push_back(p.keyframes);
      }
      for (auto const& k : from.keyframes) {
        m.keyframe_time_ns.push_back(k.time_ns);
        pose const T = from_ft(k.T_world_camera);
        m.keyframe_pose.insert(m.keyframe_pose.end(), T.begin(), T.end());
      }
      return m;
    });
  }
  std::vector<std::pair<std::string, double>> stage_times() const override {
    return translated([&] {
      std::vector<std::pair<std::string, double>> all;
      for (auto const& stage : inner_.stage_times()) {
        all.emplace_back(stage.name, 1e-3 * stage.us);
      }
      return all;
    });
  }
  std::string save_map(int b) const override {
    return translated([&] {
      std::ostringstream to;
      inner_.save_map(to, b);
      return to.str();
    });
  }
  void load_map(int b, std::string const& bytes) override {
    translated([&] {
      std::istringstream from(bytes);
      inner_.load_map(from, b);
    });
  }
  std::size_t memory_bytes() const override { return inner_.memory_bytes().executor; }
  std::vector<std::int64_t> track_timed(std::vector<frame_images> const& images,
                                        std::vector<std::int64_t> const& time_ns) override {
    return translated([&] {
      std::vector<images_type> given;
      for (frame_images const& f : images) { given.push_back(images_of(f)); }
      auto const batch = static_cast<std::size_t>(inner_.batch());
      std::vector<std::int64_t> spent;
      for (std::size_t i = 0; i < given.size(); i += batch) {
        auto const begin = std::chrono::steady_clock::now();
        inner_.track(given.data() + i, time_ns.data() + i);
        auto const end = std::chrono::steady_clock::now();
        spent.push_back(std::chrono::duration_cast<std::chrono::nanoseconds>(end - begin).count());
      }
      return spent;
    });
  }

private:
  images_type images_of(frame_images const& f) const {
    if constexpr (std::is_same_v<images_type, ft::rgbd_images>) {
      depth_image const& d = f.depth;
      ft::depth_view v;
      v.data = d.data;
      v.width = d.width;
      v.height = d.height;
      v.pitch = d.pitch;
      v.is_float = d.is_float;
      return {to_ft(f.grey[0]), v};
    } else if constexpr (std::is_same_v<images_type, ft::gray_view>) {
      return to_ft(f.grey[0]);
    } else if constexpr (std::is_same_v<images_type, ft::stereo_images>) {
      return {to_ft(f.grey[0]), to_ft(f.grey[1])};
    } else {
      images_type all;
      std::size_t i = 0;
      for (int c = 0; c < Rig::cameras; ++c) {
        ft::rig_camera const& camera = inner_.rig().of[c];
        if (camera.used) { all.of[2 * c] = to_ft(f.grey[i++]); }
        if (!camera.single()) { all.of[2 * c + 1] = to_ft(f.grey[i++]); }
      }
      return all;
    }
  }

  ft::vocabulary<exec_type::space> words_;
  inner_type inner_;
};

}  // namespace ftpy
