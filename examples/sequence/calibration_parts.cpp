// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <initializer_list>

#include "examples/sequence/detail/calibration_checks.hpp"
#include "examples/sequence/detail/text.hpp"

namespace seq::detail {
namespace {

bool is_one_of(std::string const& name, std::initializer_list<char const*> names) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

}  // namespace

void set_camera_matrix(camera_intrinsics& camera, std::vector<double> const& m,
                       std::string const& path, std::string const& key) {
  check_number(m[0], focal_limits, path, key + "[0] (fx)");
  check_number(m[4], focal_limits, path, key + "[4] (fy)");
  double const rest = std::max(
      {std::fabs(m[1]), std::fabs(m[3]), std::fabs(m[6]), std::fabs(m[7]), std::fabs(m[8] - 1)});
  if (!(rest <= 1e-3)) {
    throw error(path + ": " + key + ": not of the form fx 0 cx 0 fy cy 0 0 1: off by " +
                to_text(rest) + ", at most 0.001 allowed");
  }
  camera.fx = m[0];
  camera.fy = m[4];
  camera.cx = m[2];
  camera.cy = m[5];
}

void set_distortion(camera_intrinsics& camera, std::string const& model,
                    std::vector<double> coefficients, std::string const& path,
                    std::string const& key) {
  for (double const k : coefficients) { check_number(k, coefficient_limits, path, key); }
  auto const zero_from = [&](std::size_t i) {
    return i >= coefficients.size() ||
           std::all_of(coefficients.begin() + static_cast<std::ptrdiff_t>(i), coefficients.end(),
                       [](double k) { return k == 0; });
  };
  std::size_t const n = coefficients.size();
  auto const fail = [&](std::string const& wanted) {
    throw error(path + ": " + key + " has " + std::to_string(n) + " numbers, must have " + wanted +
                " for the model " + model);
  };
  if (is_one_of(model,
                {"radtan", "radtan8", "radial-tangential", "plumb_bob", "rational_polynomial"})) {
    camera.model = lens::radial_tangential;
    if (n > 8 && !zero_from(8)) {
      throw error(
          path + ": " + key + ": of " + std::to_string(n) +
          " coefficients those after the 8th (thin prism, tilt) are not zero, and not known");
    }
    if (n > 8) { coefficients.resize(8); }
    if (n == 0) { coefficients.resize(4); }
    if (n != 0 && n != 4 && n != 5 && n < 8) { fail("4, 5 or 8"); }
  } else if (is_one_of(model, {"equidistant", "fisheye", "kb4", "kannala_brandt"})) {
    camera.model = lens::kannala_brandt;
    if (n > 4 && zero_from(4)) { coefficients.resize(4); }
    if (coefficients.size() != 4) { fail("4"); }
  } else if (model == "fov") {
    camera.model = lens::field_of_view;
    if (n != 1) { fail("1"); }
  } else if (is_one_of(model, {"none", "None", ""})) {
    if (!zero_from(0)) {
      throw error(path + ": " + key + " are not zero, but the distortion model is none");
    }
    camera.model = lens::pinhole;
    coefficients.clear();
  } else {
    throw error(
        path + ": distortion model " + model +
        ": must be radtan (plumb_bob), rational_polynomial, equidistant (fisheye), fov or none");
  }
  camera.distortion = std::move(coefficients);
  drop_zero_distortion(camera);
}

void check_baseline(stereo_rig const& rig, std::string const& path, std::string const& key) {
  if (rig.baseline() > max_baseline) {
    throw error(path + ": " + key + ": the cameras are " + to_text(rig.baseline()) +
                " m apart, at most " + to_text(max_baseline) +
                " allowed: are these millimetres? Metres are expected");
  }
}

}  // namespace seq::detail
