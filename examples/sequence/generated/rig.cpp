// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/generated/rig.hpp"

#include <Eigen/Geometry>

#include <algorithm>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "examples/sequence/generated/constants.hpp"

namespace seq::generated {
namespace {

template <typename Value>
void check(char const* name, Value value, Value low, Value high, bool zero_is_default = false) {
  if (zero_is_default && value == Value(0)) { return; }
  if (value >= low && value <= high) { return; }  // NaN fails
  std::ostringstream text;
  text << "generator: " << name << " is " << value << "; must be " << low << " to " << high;
  if (zero_is_default) { text << ", or 0 for the default"; }
  throw error(text.str());
}

void check_span(char const* name, time_span const& s) {
  check((std::string(name) + ": from_s").c_str(), s.from_s, 0.0, 1e6);
  if (!(s.to_s > s.from_s && s.to_s <= 1e6)) {
    std::ostringstream text;
    text << "generator: " << name << ": to_s is " << s.to_s << "; must be above " << s.from_s
         << " and at most 1e+06";
    throw error(text.str());
  }
}

void check_hiding(generator_options const& o) {
  hiding_things const& h = o.hiding;
  double const most = 80;
  check("hiding.bonnet", h.bonnet, 0.0, most);
  check("hiding.dirt", h.dirt, 0.0, most);
  check("hiding.companion", h.companion, 0.0, most);
  check("hiding.crossing", h.crossing, 0.0, most);
  check("hiding.crossing_speed", h.crossing_speed, 0.0, 10.0);
  if (o.rig != rig_kind::pinhole && h.bonnet + h.dirt + h.companion + h.crossing > 0) {
    throw error("generator: things that hide parts of the image need the pinhole rig");
  }
}

void check_further(std::vector<further_camera> const& all) {
  check("number of further cameras", all.size(), std::size_t{0}, std::size_t{14});
  for (std::size_t k = 0; k < all.size(); ++k) {
    camera_intrinsics const& c = all[k].camera;
    check("further: width", c.width, 32, 4096);
    check("further: height", c.height, 32, 4096);
    check("further: fx", c.fx, 1.0, 1e5);
    check("further: fy", c.fy, 1.0, 1e5);
    check("further: right_of", all[k].right_of, -1, static_cast<int>(k) - 1);
    bool const pinhole = c.model == lens::pinhole;
    if (!pinhole && (c.model != lens::kannala_brandt || c.distortion.size() != 4)) {
      throw error(
          "generator: a further camera must be a pinhole, or Kannala-Brandt with four "
          "coefficients");
    }
  }
}

Eigen::Matrix3d small_rotation(double x, double y, double z) {
  Eigen::Vector3d const r(radians(x), radians(y), radians(z));
  return Eigen::AngleAxisd(r.norm(), r.normalized()).toRotationMatrix();
}

}  // namespace

generator_options complete(generator_options o) {
  check("width", o.width, 32, 4096, true);
  check("height", o.height, 32, 4096, true);
  check("frames", o.frames, 1, 100000);
  check("fps", o.fps, 1.0, 1000.0);
  check("noise_sigma", o.noise_sigma, 0.0, 50.0);
  check("baseline", o.baseline, 0.02, 0.3, true);
  check("imu_rate", o.imu_rate, 10.0, 10000.0);
  check("imu_noise_scale", o.imu_noise_scale, 0.0, 100.0);
  check("imu.gyro", o.imu.gyro, 0.0, 1.0);
  check("imu.accel", o.imu.accel, 0.0, 10.0);
  check("imu.gyro_walk", o.imu.gyro_walk, 0.0, 1.0);
  check("imu.accel_walk", o.imu.accel_walk, 0.0, 10.0);
  check("gyro_bias", o.gyro_bias, 0.0, 1.0);
  check("accel_bias", o.accel_bias, 0.0, 10.0);
  check("exposure_s", o.exposure_s, 0.0, 0.1);
  check("readout_s", o.readout_s, 0.0, 0.1);
  for (auto const& s : o.blind) { check_span("blind", s); }
  for (auto const& s : o.dropped) { check_span("dropped", s); }
  for (auto const& f : o.fast_turns) {
    check_span("fast_turns", f.when);
    check("fast_turns: degrees", f.degrees, -360.0, 360.0);
    // the spline's knots must resolve it
    check("fast_turns: length in seconds", f.when.to_s - f.when.from_s, 0.2, 1e6);
  }
  check("speed", o.speed, 0.0, 40.0);
  check("look_aside", o.look_aside, -180.0, 180.0);
  check("repeat", o.repeat, 0.2, 100.0, true);
  check_hiding(o);
  check_further(o.further);
  check("threads", o.threads, 1, 256, true);
  if (o.rig != rig_kind::pinhole && o.rig != rig_kind::fisheye) {
    throw error("generator: unknown rig " + std::to_string(static_cast<int>(o.rig)));
  }
  bool const fisheye = o.rig == rig_kind::fisheye;
  int const width = fisheye ? 512 : 752;
  int const height = fisheye ? 512 : 480;
  if (o.width == 0 && o.height == 0) {
    o.width = width;
    o.height = height;
  } else if (o.height == 0) {
    o.height = std::max(32, (o.width * height + width / 2) / width);
  } else if (o.width == 0) {
    o.width = std::min(4096, (o.height * width + height / 2) / height);
  }
  if (o.baseline == 0) { o.baseline = fisheye ? 0.101 : 0.11; }
  return o;
}

stereo_rig make_rig(generator_options const& o) {
  stereo_rig rig;
  rig.fps = o.fps;
  auto const lens_of = [&](double fx, double fy, double shift_x, double shift_y, lens model,
                           std::vector<double> distortion) {
    camera_intrinsics c;
    c.model = model;
    c.width = o.width;
    c.height = o.height;
    c.fx = fx;
    c.fy = fy;
    c.cx = 0.5 * (o.width - 1) + shift_x;
    c.cy = 0.5 * (o.height - 1) + shift_y;
    c.distortion = std::move(distortion);
    c.readout_s = o.readout_s;
    return c;
  };
  if (o.rig == rig_kind::pinhole) {
    double const scale = o.width / 752.0;
    rig.left = lens_of(435 * scale, 435 * scale, -8.3 * scale, 12.4 * scale, lens::pinhole, {});
    rig.right = rig.left;
    rig.T_left_right.translation() = Eigen::Vector3d(o.baseline, 0, 0);
  } else {
    double const scale = o.width / 512.0;
    rig.left = lens_of(190.98 * scale, 190.97 * scale, -0.57 * scale, 1.39 * scale,
                       lens::kannala_brandt, {0.0034, 0.0007, -0.0020, 0.0002});
    rig.right = lens_of(190.44 * scale, 190.43 * scale, -2.91 * scale, -0.36 * scale,
                        lens::kannala_brandt, {0.0031, 0.0011, -0.0023, 0.0003});
    rig.T_left_right.linear() = small_rotation(-0.25, 1.1, 0.4);
    rig.T_left_right.translation() =
        o.baseline * Eigen::Vector3d(0.101, -0.0021, -0.0012).normalized();
  }
  rig.T_body_left.linear() =
      Eigen::AngleAxisd(pi / 2, Eigen::Vector3d::UnitZ()).toRotationMatrix() *
      small_rotation(1.4, 0.3, -0.8);
  rig.T_body_left.translation() = Eigen::Vector3d(-0.021, -0.064, 0.0098);
  return rig;
}

}  // namespace seq::generated

namespace seq {

void use_mixed_rig(generator_options& options) {
  options.rig = rig_kind::fisheye;
  options.width = options.height = 512;
  options.further.clear();
  stereo_rig const pair = generated::make_rig(generated::complete(options));
  auto const turned = [](double degrees, double x, double y, double z) {
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    T.linear() =
        Eigen::AngleAxisd(generated::radians(degrees), Eigen::Vector3d::UnitY()).toRotationMatrix();
    T.translation() = Eigen::Vector3d(x, y, z);
    return T;
  };
  camera_intrinsics pinhole;
  pinhole.width = pinhole.height = 512;
  pinhole.fx = pinhole.fy = 300;
  pinhole.cx = 258.2;
  pinhole.cy = 251.7;
  Eigen::Isometry3d const aside = turned(80, 0.12, 0.01, -0.05);
  options.further = {{pair.left, aside, -1, false},
                     {pair.right, aside * pair.T_left_right, 0, false},
                     {pinhole, turned(-40, -0.04, 0.03, 0.01), -1, false},
                     {pinhole, turned(-95, -0.1, 0, -0.06), -1, true}};
}

}  // namespace seq
