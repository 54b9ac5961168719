// SPDX-License-Identifier: Apache-2.0
/// @file Signs that a calibration is another camera's, or in other units, in words.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/distorted_pair.hpp"
#include "ft/cameras/image_domain.hpp"
#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/rgbd_rig.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

enum class calibration_warning : int {
  not_finite,          ///< a number is NaN or infinite
  refused,             ///< check() of the camera or the rig refuses it
  focal_length,        ///< not one of images of this size
  principal_point,     ///< farther from the image's centre than real ones
  folds,               ///< pixels of the image have no ray: the distortion folds inside it
  baseline_long,       ///< above 2 m: millimetres?
  baseline_short,      ///< below 5 mm: metres are asked for
  baseline_direction,  ///< the right camera is to the left of the left one: an inverse?
  rotation,            ///< cameras of a pair look apart
  depth_scale,         ///< more than a metre per unit, or less than a micrometre
};

/// The warning as a word, such as "principal_point".
inline char const* name_of(calibration_warning warning) {
  constexpr char const* names[] = {
      "not_finite",    "refused",        "focal_length",       "principal_point", "folds",
      "baseline_long", "baseline_short", "baseline_direction", "rotation",        "depth_scale"};
  constexpr int count = sizeof names / sizeof *names;
  static_assert(count == static_cast<int>(calibration_warning::depth_scale) + 1, "one a warning");
  int const i = static_cast<int>(warning);
  return i >= 0 && i < count ? names[i] : "unknown";
}

/// A warning, and a sentence that has the numbers; no full stop at its end.
struct calibration_finding {
  calibration_warning warning;
  std::string text;
};

/// Limits of check_calibration().
struct calibration_limits {
  double longest_baseline = 2;        ///< metres
  double shortest_baseline = 0.005;   ///< metres
  double least_focal_length = 0.12;   ///< by the longer side of the image, on the axis
  double largest_focal_length = 8;    ///< likewise
  double largest_focal_ratio = 1.5;   ///< of fx and fy, either way
  double largest_rotation = 60;       ///< degrees between the two cameras of a pair
  double least_share_with_ray = 0.4;  ///< of pixels; of radial-tangential lenses all
  /// Of the image's sides, from its centre to the principal point. One in the centre of an image
  /// of half the size, or of the double one, is a quarter of a side or more away.
  double largest_offset = 0.2;
};

namespace detail {

/// A number with six digits.
inline std::string brief(double v) {
  char text[40];
  std::snprintf(text, sizeof text, "%.6g", v);
  return text;
}

/// Collects what is found in a rig. Host.
class calibration_check {
public:
  calibration_check(int width, int height, calibration_limits const& limits)
      : width_(width), height_(height), limits_(limits) {
    require_range("image width", width, 1, 16384);
    require_range("image height", height, 1, 16384);
  }
  std::vector<calibration_finding> found;

  void add(calibration_warning warning, std::string const& text) {
    found.push_back({warning, text});
  }
  bool finite(std::string const& name, double value) {
    if (!std::isfinite(value)) {
      add(calibration_warning::not_finite, name + " is " + brief(value));
    }
    return std::isfinite(value);
  }
  /// @param which such as "left camera"
  template <typename Camera>
  void camera(std::string const& which, Camera const& camera, int width, int height) {
    auto const in_double = camera.template cast<double>();
    double values[num_params_v<Camera>];
    std::memcpy(values, &in_double, sizeof values);
    bool usable = true;
    for (int i = 0; i < num_params_v<Camera>; ++i) {
      usable = finite(which + ": " + Camera::parameters.of[i].name, values[i]) && usable;
    }
    if (!usable || refused([&] { camera.check(); }, which)) { return; }
    auto const axis = in_double.project_with_jacobian({0, 0, 1});
    if (axis.value.valid) {
      focal_lengths(which, axis.jacobian.m[0], axis.jacobian.m[4], width, height);
      principal_point(which, axis.value.pixel, width, height);
    }
    domain(which, camera, width, height);
  }
  template <typename Camera>
  void camera(std::string const& which, Camera const& of) {
    camera(which, of, width_, height_);
  }
  void baseline(std::string const& which, double length) {
    if (!finite(which, length)) { return; }
    if (length > limits_.longest_baseline) {
      add(calibration_warning::baseline_long, which + " is " + brief(length) + " m, above " +
                                                  brief(limits_.longest_baseline) +
                                                  " m: are these millimetres?");
    } else if (length < limits_.shortest_baseline) {
      add(calibration_warning::baseline_short,
          which + " is " + brief(length) + " m, below " + brief(limits_.shortest_baseline) + " m");
    }
  }
  /// The angle of a rotation between the cameras of a pair.
  void rotation(std::string const& which, mat3<double> const& R) {
    double const cosine = (R.m[0] + R.m[4] + R.m[8] - 1) / 2;
    double const degrees = std::acos(std::min(1.0, std::max(-1.0, cosine))) * 180 / std::acos(-1.0);
    if (degrees > limits_.largest_rotation) {
      add(calibration_warning::rotation, which + " is turned by " + brief(std::round(degrees)) +
                                             " degrees, above " + brief(limits_.largest_rotation) +
                                             ": is the rotation that of another pair?");
    }
  }
  /// Whether check() throws; its message is added. Not of what was found not to be finite.
  template <typename Check>
  bool refused(Check const& check, std::string const& which) {
    try {
      check();
      return false;
    } catch (bad_argument const& e) {
      std::string const text = e.what();
      std::string const prefix = "ft: ";
      add(calibration_warning::refused,
          which + ": " +
              (text.compare(0, prefix.size(), prefix) == 0 ? text.substr(prefix.size()) : text));
      return true;
    }
  }
  /// Whether nothing was found that check() refuses.
  bool usable() const {
    return std::none_of(found.begin(), found.end(), [](calibration_finding const& f) {
      return f.warning == calibration_warning::refused ||
             f.warning == calibration_warning::not_finite;
    });
  }
  bool finite_motion(std::string const& which, pose const& T) {
    bool usable = true;
    for (float const v : T.R.m) { usable = usable && std::isfinite(v); }
    usable = usable && std::isfinite(T.t.x) && std::isfinite(T.t.y) && std::isfinite(T.t.z);
    if (!usable) {
      add(calibration_warning::not_finite, which + " has a number that is not finite");
    }
    return usable;
  }

private:
  static std::string size_text(int width, int height) {
    return std::to_string(width) + "x" + std::to_string(height);
  }
  void focal_lengths(std::string const& which, double fx, double fy, int width, int height) {
    double const side = std::max(width, height);
    double const f[2] = {fx, fy};
    for (int i = 0; i < 2; ++i) {
      double const low = limits_.least_focal_length * side;
      double const high = limits_.largest_focal_length * side;
      if (!(f[i] >= low && f[i] <= high)) {
        add(calibration_warning::focal_length,
            which + ": the focal length is " + brief(f[i]) + " pixels along " +
                (i == 0 ? "x" : "y") + ", for images of " + size_text(width, height) +
                " it should be in [" + brief(low) + ", " + brief(high) + "]");
        return;
      }
    }
    if (std::max(fx, fy) > limits_.largest_focal_ratio * std::min(fx, fy)) {
      add(calibration_warning::focal_length, which + ": the focal lengths are " + brief(fx) +
                                                 " and " + brief(fy) +
                                                 " pixels, they should differ by a factor of " +
                                                 brief(limits_.largest_focal_ratio) + " at most");
    }
  }
  void principal_point(std::string const& which, vec2<double> p, int width, int height) {
    double const most = limits_.largest_offset;
    if (std::fabs(p.x - 0.5 * width) <= most * width &&
        std::fabs(p.y - 0.5 * height) <= most * height) {
      return;
    }
    add(calibration_warning::principal_point,
        which + ": the principal point (" + brief(p.x) + ", " + brief(p.y) + ") is not within " +
            brief(100 * most) + " % of the sides from the centre of images of " +
            size_text(width, height) + ": is the calibration that of another size?");
  }
  template <typename Camera>
  void domain(std::string const& which, Camera const& camera, int width, int height) {
    image_domain const seen = inspect_image_domain(camera, width, height);
    bool const radial = std::strncmp(Camera::name, "radtan", 6) == 0;
    double const least = radial ? 1.0 : limits_.least_share_with_ray;
    if (seen.returned == seen.with_ray && seen.share_with_ray() >= least) { return; }
    add(calibration_warning::folds,
        which + ": only " + std::to_string(seen.returned) + " of " + std::to_string(seen.pixels) +
            " pixels spread over images of " + size_text(width, height) +
            " have a ray: the distortion folds inside the image");
  }

  int width_;
  int height_;
  calibration_limits limits_;
};

inline void check_rig(calibration_check& c, rectified_rig const& rig, int /*width*/,
                      int /*height*/) {
  c.camera("rectified camera", rig.camera);
  c.baseline("the baseline", rig.baseline);
}
template <typename Left, typename Right>
void check_rig(calibration_check& c, stereo_rig<Left, Right> const& rig, int, int) {
  c.camera("left camera", rig.left);
  c.camera("right camera", rig.right);
  if (!c.finite_motion("T_rl", rig.T_rl)) { return; }
  // What the cameras say was found already.
  stereo_rig<pinhole<float>, pinhole<float>> const plain{{1, 1, 0, 0}, {1, 1, 0, 0}, rig.T_rl};
  if (c.refused([&] { plain.check(); }, "T_rl")) { return; }
  rigid<double> const T = rig.T_rl.template cast<double>();
  c.baseline("the baseline", static_cast<double>(rig.baseline_length().value));
  c.rotation("the right camera", T.R);
  vec3<double> const centre = T.centre();
  double const length = std::sqrt(dot(centre, centre));
  if (centre.x < -0.7 * length) {
    c.add(calibration_warning::baseline_direction,
          "the right camera is at x = " + brief(centre.x) +
              " m of the left one, to its left: are the cameras exchanged, or is T_rl inverted?");
  }
}
template <typename Left, typename Right>
void check_rig(calibration_check& c, distorted_pair<Left, Right> const& rig, int width,
               int height) {
  bool const own_size = rig.width > 0 && rig.height > 0;
  c.camera("left camera", rig.left, own_size ? rig.width : width, own_size ? rig.height : height);
  c.camera("right camera", rig.right, own_size ? rig.width : width, own_size ? rig.height : height);
  check_rig(c, rig.target, width, height);
  for (int i = 0; i < 2; ++i) {
    std::string const which = i == 0 ? "R_left" : "R_right";
    pose const T{(i == 0 ? rig.R_left : rig.R_right).template cast<float>(), {0, 0, 0}};
    if (!c.finite_motion(which, T)) { continue; }
    rig_camera const turned{{1, 1, 0, 0}, 0, T, true};
    if (!c.refused([&] { turned.check(); }, which)) {
      c.rotation(which, T.R.template cast<double>());
    }
  }
}
template <typename Camera>
void check_rig(calibration_check& c, rgbd_rig<Camera> const& rig, int, int) {
  c.camera("camera", rig.camera);
  c.baseline("the baseline of the virtual pair", rig.baseline);
  if (!c.finite("depth_scale", static_cast<double>(rig.depth_scale))) { return; }
  if (rig.depth_scale > 1 || (rig.depth_scale != 0 && rig.depth_scale < 1e-6f)) {
    c.add(calibration_warning::depth_scale,
          "depth_scale is " + brief(static_cast<double>(rig.depth_scale)) +
              " m per unit, it should be in [1e-06, 1]: is it units per metre?");
  }
}
template <typename Camera>
void check_rig(calibration_check& c, monocular_rig<Camera> const& rig, int, int) {
  c.camera("camera", rig.camera);
}
template <int N, typename Camera>
void check_rig(calibration_check& c, multi_rig<N, Camera> const& rig, int, int) {
  for (int i = 0; i < N; ++i) {
    Camera const& of = rig.of[i];
    if (!of.used) { continue; }
    std::string const which = "camera " + std::to_string(i);
    c.camera(which, of.camera);
    if (of.baseline > 0) { c.baseline(which + ": the baseline", of.baseline); }
    if (!c.finite_motion(which + ": T_cb", of.T_cb)) { continue; }
    rig_camera const plain{{1, 1, 0, 0}, 0, of.T_cb, true};
    if (c.refused([&] { plain.check(); }, which)) { continue; }
    double const away = std::sqrt(static_cast<double>(dot(of.T_cb.t, of.T_cb.t)));
    constexpr double farthest = 20;  // metres: a long vehicle
    if (away > farthest) {
      c.add(calibration_warning::baseline_long, which + " is " + brief(away) +
                                                    " m from the body, above " + brief(farthest) +
                                                    " m: are these millimetres?");
    }
  }
  if (c.usable()) {
    c.refused([&] { rig.check(); }, "the rig");
  }
}

}  // namespace detail

/// Looks for signs that a calibration is another camera's, another size's or in other units: wrong
/// calibrations are tracked without an error, and wrongly. Also finds what check() refuses, all of
/// it. Host; for set-up: allocates.
/// @param rig rectified_rig, stereo_rig, distorted_pair, rgbd_rig, monocular_rig, multi_rig or
/// mixed_rig
/// @param width,height pixels of the images that are searched; those that come in, but for a
///   distorted_pair that has a size of its own
/// @return nothing for an ordinary calibration
/// @throws bad_argument for a size out of [1, 16384] alone
template <typename Rig>
std::vector<calibration_finding> check_calibration(Rig const& rig, int width, int height,
                                                   calibration_limits const& limits = {}) {
  detail::calibration_check check(width, height, limits);
  detail::check_rig(check, rig, width, height);
  return std::move(check.found);
}

}  // namespace FT_ABI
}  // namespace ft
