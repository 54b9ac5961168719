// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/generator.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <string>

#include "examples/sequence/detail/random.hpp"
#include "examples/sequence/detail/simulated_imu.hpp"
#include "examples/sequence/generated/constants.hpp"
#include "examples/sequence/generated/hiding.hpp"
#include "examples/sequence/generated/render.hpp"
#include "examples/sequence/generated/rig.hpp"
#include "examples/sequence/generated/room.hpp"
#include "examples/sequence/generated/route.hpp"
#include "examples/sequence/generated/view.hpp"
#include "examples/sequence/parallel.hpp"

namespace seq {
namespace {

using detail::key;
using detail::random_stream;
using generated::motion;
using generated::motion_at;
using generated::pi;
using generated::surface;
using generated::view;

constexpr double gravity = 9.81;
constexpr std::int64_t first_time_ns = 1'600'000'000'000'000'000;

}  // namespace

struct generator::impl {
  generator_options options;
  stereo_rig rig;
  std::vector<surface> surfaces;
  generated::hiding_surfaces hiding;
  generated::spline route;
  std::array<view, 2> views;
  std::vector<view> further;
  std::vector<float> normal;
  std::vector<std::int64_t> imu_times;
  double gain_phase = 0;

  void check_frame(int i) const {
    if (i < 0 || i >= options.frames) {
      throw error("generator: frame " + std::to_string(i) + "; must be 0 to " +
                  std::to_string(options.frames - 1));
    }
  }
  void check_camera(int c) const {
    if (c != 0 && c != 1) {
      throw error("generator: camera " + std::to_string(c) + "; must be 0 or 1");
    }
  }
  void build_scene(double duration_s) {
    auto const& o = options;
    if (o.scene == scene_kind::corridor) {
      constexpr double beyond = 20;  // metres to the wall at the end
      double const length = generated::driven(duration_s, o.speed) + beyond;
      surfaces = generated::build_corridor(key(o.seed, 1), length, o.repeat);
      route =
          generated::plan_drive(key(o.seed, 2), duration_s, o.speed, o.look_aside, o.fast_turns);
    } else {
      surfaces = generated::furnish(key(o.seed, 1));
      route = generated::plan_route(key(o.seed, 2), duration_s, o.fast_turns);
    }
  }
  std::int64_t time_ns(int i) const {
    return first_time_ns + static_cast<std::int64_t>(std::llround(i * 1e9 / options.fps));
  }
  static double seconds(std::int64_t time) {
    return static_cast<double>(time - first_time_ns) * 1e-9;
  }
  motion camera_motion(std::int64_t time) const { return motion_at(route, seconds(time)); }
  Eigen::Isometry3d pose(int i, int camera) const {
    return camera_motion(time_ns(i)).T_world_camera *
           views[static_cast<std::size_t>(camera)].T_left_this;
  }
  // Seconds after the stamp of a frame at which a row is seen.
  double row_delay(camera_intrinsics const& c, double row) const {
    return options.readout_s * (row / std::max(c.height - 1, 1) - 0.5);
  }
  Eigen::Isometry3d T_world_left(int i, double delay) const {
    return motion_at(route, std::max(seconds(time_ns(i)) + delay, 0.0)).T_world_camera;
  }
  /// @param T_left_other see generator::render @param first_noise number of the first image's noise
  stereo_frame render(int i, Eigen::Isometry3d const& T_left_other, std::size_t first_noise) const;
  /// @param number of the noise
  image picture(int i, view const& v, Eigen::Isometry3d const& T_left_other,
                std::size_t number) const;
  /// Of the nearest surface along a ray, in lengths of `direction`; the largest double = there is
  /// none.
  double nearest(Eigen::Vector3d const& start, Eigen::Vector3d const& direction) const;
  depth_image depths(int i, view const& v) const;
  bool within(std::vector<time_span> const& spans, int i) const {
    double const t = seconds(time_ns(i));
    return std::any_of(spans.begin(), spans.end(), [t](time_span const& s) {
      return t >= s.from_s - 1e-9 && t < s.to_s - 1e-9;
    });
  }
  // Instants that an image is the mean of, no more than about a pixel apart; 1 without exposure.
  int exposure_steps(double t) const {
    motion const m = motion_at(route, t);
    double const nearest_m = 0.8;
    double const pixels_per_s = rig.left.fx * (m.turning.norm() + m.velocity.norm() / nearest_m);
    return static_cast<int>(std::clamp(std::ceil(pixels_per_s * options.exposure_s), 1.0, 64.0));
  }
  // Mean light at each pixel of a camera during the exposure of frame i.
  std::vector<float> collect_light(int i, view const& v,
                                   Eigen::Isometry3d const& T_left_other) const;
  // Gyro and accelerometer without bias and noise, body frame.
  imu_sample ideal_imu(std::int64_t time) const {
    motion const m = camera_motion(time);
    Eigen::Isometry3d const T_world_body = m.T_world_camera * rig.T_body_left.inverse();
    Eigen::Matrix3d const R_body_world = T_world_body.linear().transpose();
    Eigen::Vector3d const arm = T_world_body.translation() - m.T_world_camera.translation();
    Eigen::Vector3d const acceleration =
        m.acceleration + m.spin_up.cross(arm) + m.turning.cross(m.turning.cross(arm));
    return {time, R_body_world * m.turning,
            R_body_world * (acceleration + Eigen::Vector3d(0, 0, gravity))};
  }
  detail::simulated_imu imu_errors() const {
    imu_noise n = options.imu;
    for (double* d : {&n.gyro, &n.accel, &n.gyro_walk, &n.accel_walk}) {
      *d *= options.imu_noise_scale;
    }
    return {n, options.imu_rate, options.gyro_bias * options.imu_noise_scale,
            options.accel_bias * options.imu_noise_scale, options.seed};
  }
};

generator::generator(generator_options const& options) : impl_(std::make_unique<impl>()) {
  impl& m = *impl_;
  m.options = generated::complete(options);
  auto const& o = m.options;
  m.rig = generated::make_rig(o);
  double const duration = (o.frames - 1) / o.fps;
  m.build_scene(duration + 0.1);
  m.hiding = generated::hide(key(o.seed, 5), o.hiding, m.rig.left, duration);
  m.views[0] = generated::make_view(m.rig.left, Eigen::Isometry3d::Identity(), o.vignetting);
  m.views[1] = generated::make_view(m.rig.right, m.rig.T_left_right, o.vignetting);
  for (further_camera const& c : o.further) {
    m.further.push_back(generated::make_view(c.camera, c.T_left_this, o.vignetting));
  }
  m.normal = generated::normal_table();
  m.gain_phase = random_stream(key(o.seed, 3)).uniform(0, 2 * pi);
  std::int64_t const last = m.time_ns(o.frames - 1);
  for (std::int64_t i = 0;; ++i) {
    auto const time = first_time_ns + static_cast<std::int64_t>(
                                          std::llround(static_cast<double>(i) * 1e9 / o.imu_rate));
    if (time > last) { break; }
    m.imu_times.push_back(time);
  }

  // small pictures need no fine textures
  double const detail = std::clamp(m.rig.left.fx / 435.0, 0.2, 1.5);
  auto const paint_all = [&](std::vector<surface>& surfaces, std::uint64_t kind) {
    int const count = static_cast<int>(surfaces.size());
    parallel_for(count, o.threads, [&](int k) {
      // the largest surfaces come last in the list: start with them
      auto const i = static_cast<std::size_t>(count - 1 - k);
      surface& s = surfaces[i];
      std::uint64_t const number = s.paint >= 0 ? static_cast<std::uint64_t>(s.paint) : i;
      s.skin = generated::paint(key(o.seed, kind, number), s.width, s.height,
                                s.texels_per_m * detail, s.brightness);
    });
  };
  paint_all(m.surfaces, 4);
  std::uint64_t kind = 6;
  for (auto* surfaces : m.hiding.all()) { paint_all(*surfaces, kind++); }
}

generator::generator(generator&&) noexcept = default;
generator& generator::operator=(generator&&) noexcept = default;
generator::~generator() = default;

generator_options const& generator::options() const { return impl_->options; }
stereo_rig const& generator::rig() const { return impl_->rig; }
int generator::size() const { return impl_->options.frames; }

std::int64_t generator::time_ns(int i) const {
  impl_->check_frame(i);
  return impl_->time_ns(i);
}

Eigen::Isometry3d generator::T_world_camera(int i) const {
  impl_->check_frame(i);
  return impl_->pose(i, 0);
}

stereo_frame generator::render(int i) const {
  return impl_->render(i, Eigen::Isometry3d::Identity(), 0);
}

stereo_frame generator::render(int i, Eigen::Isometry3d const& T_left_other) const {
  return impl_->render(i, T_left_other, 2);
}

bool generator::dropped(int i) const {
  impl_->check_frame(i);
  return impl_->within(impl_->options.dropped, i);
}

std::vector<float> generator::impl::collect_light(int i, view const& v,
                                                  Eigen::Isometry3d const& T_left_other) const {
  if (within(options.blind, i)) { return std::vector<float>(v.rays.size(), 0.0f); }
  double const t = seconds(time_ns(i));
  auto const placed = [&](double when) {
    when = std::max(when, 0.0);
    Eigen::Isometry3d const T_world_left = motion_at(route, when).T_world_camera;
    Eigen::Isometry3d const T_left_camera = T_left_other * v.T_left_this;
    std::vector<generated::placed_surfaces> seen;
    generated::place(hiding, options.hiding, when, motion_at(route, 0).T_world_camera, T_world_left,
                     T_left_camera, seen);
    seen.push_back({&surfaces, (T_world_left * T_left_camera).inverse()});
    return seen;
  };
  auto const at = [&](double when) {
    if (options.readout_s == 0) { return generated::trace(v, placed(when)); }
    return generated::trace_rows(v, [&](int y) { return placed(when + row_delay(v.camera, y)); });
  };
  int const count = exposure_steps(t);
  std::vector<float> sum = at(t + options.exposure_s * (0.5 / count - 0.5));
  for (int k = 1; k < count; ++k) {
    auto const more = at(t + options.exposure_s * ((k + 0.5) / count - 0.5));
    for (std::size_t p = 0; p < sum.size(); ++p) { sum[p] += more[p]; }
  }
  for (float& value : sum) { value /= static_cast<float>(count); }
  return sum;
}

stereo_frame generator::impl::render(int i, Eigen::Isometry3d const& T_left_other,
                                     std::size_t first_noise) const {
  impl const& m = *this;
  m.check_frame(i);
  stereo_frame out;
  out.time_ns = m.time_ns(i);
  out.left = picture(i, m.views[0], T_left_other, first_noise);
  out.right = picture(i, m.views[1], T_left_other, first_noise + 1);
  return out;
}

image generator::impl::picture(int i, view const& v, Eigen::Isometry3d const& T_left_other,
                               std::size_t number) const {
  double const t = seconds(time_ns(i));
  double const gain =
      options.exposure_change ? 1.0 + 0.2 * std::sin(2 * pi * t / 6.5 + gain_phase) : 1.0;
  return generated::expose(v, collect_light(i, v, T_left_other), static_cast<float>(gain),
                           static_cast<float>(options.noise_sigma), normal,
                           key(options.seed, 1000 + static_cast<std::uint64_t>(i), number));
}

double generator::impl::nearest(Eigen::Vector3d const& start,
                                Eigen::Vector3d const& direction) const {
  double best = std::numeric_limits<double>::max();
  for (surface const& s : surfaces) {
    double const towards = s.normal.dot(direction);
    if (towards >= 0) { continue; }
    double const far = s.normal.dot(s.origin - start) / towards;
    if (far <= 0 || far >= best) { continue; }
    Eigen::Vector3d const d = start + far * direction - s.origin;
    double const a = d.dot(s.along);
    double const b = d.dot(s.up);
    if (a >= 0 && b >= 0 && a <= s.width && b <= s.height) { best = far; }
  }
  return best;
}

depth_image generator::impl::depths(int i, view const& v) const {
  depth_image out;
  out.width = v.camera.width;
  out.height = v.camera.height;
  out.pixels.reserve(v.rays.size());
  auto r = v.rays.begin();
  for (int y = 0; y < out.height; ++y) {
    Eigen::Isometry3d const T = T_world_left(i, row_delay(v.camera, y)) * v.T_left_this;
    for (int x = 0; x < out.width; ++x, ++r) {
      Eigen::Vector3d const ray = r->cast<double>();
      double const z = 1000 * ray.z() * nearest(T.translation(), T.linear() * ray);
      out.pixels.push_back(z > 0 && z < 65535 ? static_cast<std::uint16_t>(std::lround(z)) : 0);
    }
  }
  return out;
}

further_image generator::render_further(int i, int k) const {
  impl const& m = *impl_;
  m.check_frame(i);
  if (k < 0 || k >= static_cast<int>(m.further.size())) {
    throw error("generator: further camera " + std::to_string(k) + "; there are " +
                std::to_string(m.further.size()));
  }
  auto const at = static_cast<std::size_t>(k);
  further_image out;
  out.grey = m.picture(i, m.further[at], Eigen::Isometry3d::Identity(), 4 + at);
  if (m.options.further[at].has_depth) { out.depth = m.depths(i, m.further[at]); }
  return out;
}

trajectory generator::ground_truth() const {
  trajectory out;
  for (int i = 0; i < size(); ++i) { out.push_back({impl_->time_ns(i), impl_->pose(i, 0)}); }
  return out;
}

std::vector<body_state> generator::body_ground_truth() const {
  impl const& m = *impl_;
  auto const biases = m.imu_errors().biases(m.imu_times.size());
  std::vector<std::int64_t> times = m.imu_times;
  for (int i = 0; i < size(); ++i) { times.push_back(m.time_ns(i)); }
  std::sort(times.begin(), times.end());
  times.erase(std::unique(times.begin(), times.end()), times.end());

  std::vector<body_state> out;
  std::size_t imu = 0;
  for (std::int64_t time : times) {
    while (imu + 1 < m.imu_times.size() && m.imu_times[imu + 1] <= time) { ++imu; }
    motion const at = m.camera_motion(time);
    body_state s;
    s.time_ns = time;
    s.T_world_body = at.T_world_camera * m.rig.T_body_left.inverse();
    s.velocity = at.velocity +
                 at.turning.cross(s.T_world_body.translation() - at.T_world_camera.translation());
    s.gyro_bias = biases[imu].gyro;
    s.accel_bias = biases[imu].accel;
    out.push_back(s);
  }
  return out;
}

std::vector<imu_sample> generator::imu() const {
  std::vector<imu_sample> out;
  for (std::int64_t const time : impl_->imu_times) { out.push_back(impl_->ideal_imu(time)); }
  impl_->imu_errors().add_to(out);
  return out;
}

std::optional<Eigen::Vector3d> generator::surface_point(int i, int camera, double u,
                                                        double v) const {
  impl const& m = *impl_;
  m.check_frame(i);
  m.check_camera(camera);
  generated::view const& seen = m.views[static_cast<std::size_t>(camera)];
  auto const ray = generated::unproject(seen.camera, u, v);
  if (!ray) { return std::nullopt; }
  Eigen::Isometry3d const pose = m.T_world_left(i, m.row_delay(seen.camera, v)) * seen.T_left_this;
  Eigen::Vector3d const start = pose.translation();
  Eigen::Vector3d const direction = pose.linear() * *ray;
  double const best = m.nearest(start, direction);
  if (best == std::numeric_limits<double>::max()) { return std::nullopt; }
  return Eigen::Vector3d(best * *ray);
}

double generator::depth(int i, double u, double v) const {
  auto const point = surface_point(i, 0, u, v);
  return point ? point->z() : -1.0;
}

std::optional<Eigen::Vector2d> generator::project(int camera, Eigen::Vector3d const& point) const {
  impl_->check_camera(camera);
  camera_intrinsics const& c = impl_->views[static_cast<std::size_t>(camera)].camera;
  if (!(point.z() > 1e-9)) { return std::nullopt; }
  if (c.model == lens::pinhole) {
    return Eigen::Vector2d(c.fx * point.x() / point.z() + c.cx,
                           c.fy * point.y() / point.z() + c.cy);
  }
  double const side = point.head<2>().norm();
  double const angle = std::atan2(side, point.z());
  if (!(angle < generated::fisheye_limit)) { return std::nullopt; }
  double const scale =
      side > 1e-12 ? generated::kannala_brandt(c.distortion, angle) / side : 1.0 / point.z();
  return Eigen::Vector2d(c.fx * scale * point.x() + c.cx, c.fy * scale * point.y() + c.cy);
}

double generator::clearance(int i) const {
  impl const& m = *impl_;
  m.check_frame(i);
  double best = std::numeric_limits<double>::max();
  for (int c = 0; c < 2; ++c) {
    Eigen::Vector3d const centre = m.pose(i, c).translation();
    for (surface const& s : m.surfaces) { best = std::min(best, generated::distance(s, centre)); }
  }
  return best;
}

}  // namespace seq
